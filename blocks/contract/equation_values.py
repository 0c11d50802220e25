"""What equations give for values of what they read: for symbols, from which a tape is made, and for numbers."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import DeclarationError, Fault
from .equations import Local, Output
from .interface import Interface
from .variables import Equation


class EquationValues:
    """The values that equations read, by name; locals are computed when first read.

    seen: what the other equations see of a local, by its name and what it gives.
    """

    def __init__(
        self,
        interface: Interface,
        known: Mapping[str, Any],
        made: Callable[[Any], Any],
        seen: Callable[[str, Any], Any] = lambda name, value: value,
    ) -> None:
        self.interface, self.known, self.made, self.seen = interface, dict(known), made, seen
        self.given: dict[str, Any] = {}  # by locals

    def __getitem__(self, name: str) -> Any:
        if name not in self.known:
            self.known[name] = self.seen(name, self.local(name))
        return self.known[name]

    def local(self, name: str) -> Any:
        """What the equation of a local gives."""
        if name not in self.given:
            self.given[name] = self.of(self.interface.declaration.locals[name].equation)
        return self.given[name]

    def of(self, equation: Equation) -> Any:
        """What an equation gives, as an array. Raises DeclarationError (E407), with the cause."""
        values = [self[name] for name in equation.reads]
        try:
            return self.made(equation.function(*values))
        except Exception as error:  # a user's function may raise anything; each is reported with its place
            cause = error.__cause__ if isinstance(error.__cause__, TypeError) else error  # numpy hides the refusal
            text = str(cause) if isinstance(cause, TypeError) else f"{type(error).__name__}: {error}"
            raise refusal(self.interface, equation, text, error) from error


def numeric(interface: Interface, values: Mapping[str, Any]) -> dict[str, Array]:
    """Every result of a type computed by its own Python functions on numbers: the witness of the tape.

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


def refusal(
    interface: Interface, equation: Equation, message: str, error: BaseException | None = None
) -> DeclarationError:
    """E407, with the line of the equation where the `error` came up, or where it begins, if that stands in a file."""
    fault = Fault("E407", f"{interface.name}.{equation.name}", f"cannot be traced: {message}")
    code = getattr(equation.function, "__code__", None)
    if code is None or not os.path.isfile(code.co_filename):
        return DeclarationError(fault)
    line, column = code.co_firstlineno, 0
    frame = error.__traceback__ if error is not None else None
    while frame is not None:
        if frame.tb_frame.f_code is code:
            line, column = frame.tb_lineno, [*code.co_positions()][frame.tb_lasti // 2][2] or 0
        frame = frame.tb_next
    return DeclarationError(fault.at(code.co_filename, line, column + 1))
