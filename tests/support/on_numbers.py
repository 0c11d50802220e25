"""The equations of a block type on plain numbers: the witness of its tape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from blocks.contract.equation_values import EquationValues
from blocks.contract.equations import Local, Output
from blocks.contract.interface import Interface

Array = np.ndarray[Any, Any]


def numeric(interface: Interface, values: Mapping[str, Any]) -> dict[str, Array]:
    """Return every result of a type, computed by its own Python functions on numbers.

    values: all that equations read, by name, including t and tick; bools as 0 and 1 or as they are. Returns arrays
    by result key. Raises DeclarationError (E407) where an equation fails on numbers.
    """
    declaration = interface.declaration
    known: dict[str, Any] = dict(interface.structural)
    for name, value in values.items():
        variable = declaration.readable.get(name)
        array = np.array(value, dtype=bool if variable is not None and variable.type == "bool" else float)
        if variable is not None and not isinstance(variable, Local):
            array = array.reshape(interface.shape(variable))
        array.setflags(write=False)
        known[name] = array[()]  # numpy's scalars: x / 0 is inf, and ~ of a bool is a bool
    table = EquationValues(interface, known, lambda value: np.asarray(value)[()])
    results: dict[str, Array] = {}
    for equation in declaration.equations:
        for role in equation.roles:
            variable = role.target
            assert variable is not None
            if isinstance(variable, Output) and variable.wiring:
                continue
            result = np.asarray(table[equation.name] if role.kind == "local" else table.of(equation), dtype=float)
            cause = f":{role.cause.name}" if role.cause is not None else ""
            shape = result.shape if role.kind == "local" else interface.shape(variable)
            results[f"{role.kind}:{variable.name}{cause}"] = np.broadcast_to(result, shape).ravel()
    return results
