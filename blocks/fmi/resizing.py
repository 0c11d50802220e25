"""A description with other values of its structural parameters (FMI 3), which are sizes of arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace

from .model_description import Description, ModelVariable, Structure, Unknown


def resized(description: Description, sizes: Mapping[str, int]) -> tuple[Description, frozenset[str]]:
    """The description with these values of structural parameters, and the names of all variables that they change.

    Start values that do not fit the new size of an array are left out: nobody has given them.
    """
    replacements: dict[int, ModelVariable] = {}
    changed = set()
    for variable in description.variables:
        replacement = variable
        if variable.name in sizes:
            replacement = replace(variable, start=(sizes[variable.name],))
        elif any(size in sizes for size in variable.dimensions):
            shape = tuple(
                int(sizes.get(size, start)) if isinstance(size, str) else start
                for size, start in zip(variable.dimensions, variable.shape, strict=True)
            )
            fits = len(variable.start) in (1, math.prod(shape))
            replacement = replace(variable, shape=shape, start=variable.start if fits else ())
        replacements[id(variable)] = replacement
        if replacement is not variable:
            changed.add(replacement.name)

    def of(unknown: Unknown) -> Unknown:
        needs = unknown.dependencies
        needs = None if needs is None else tuple(replacements[id(needed)] for needed in needs)
        return replace(unknown, variable=replacements[id(unknown.variable)], dependencies=needs)

    known = {field.name: getattr(description.structure, field.name) for field in fields(Structure)}
    structure = Structure(
        states=tuple(replacements[id(state)] for state in known.pop("states")),
        **{name: tuple(map(of, unknowns)) for name, unknowns in known.items()},
    )
    names = {name: replacements[id(variable)] for name, variable in description.names.items()}
    variables = tuple(replacements[id(variable)] for variable in description.variables)
    return replace(description, variables=variables, structure=structure, names=names), frozenset(changed)
