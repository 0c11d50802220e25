"""Other values of parameters in a diagram that is built in Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ..model.block_ports import port_units
from ..model.diagram_value import DiagramValue
from ..model.document import block, entries
from ..model.hierarchy import Resolver
from ..model.raw_values import given_values, parameters_of
from ..model.values import in_unit
from ..model.variants import taken
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import legible


def with_parameter(value: DiagramValue, name: str, raw: Any, resolver: Resolver) -> DiagramValue:
    """Return a diagram with another value of a parameter. Arguments and errors as of `Diagram.set`."""
    known = dict.fromkeys(parameters_of(taken(value), resolver))
    for path, given in given_values(value, resolver, {name: raw}).items():
        if path not in known:
            cure = did_you_mean(path[:200], known) or "Give the path of a parameter, as in motor.Ra."
            raise UsageError(Fault("E106", legible(path), "there is no such parameter to set.", cure))
        value = _with(value, path.split("."), given, resolver)
    return value


def _with(value: DiagramValue, path: Sequence[str], raw: Any, resolver: Resolver) -> DiagramValue:
    name, *inner = path
    if not inner:
        old = value.parameters[name]
        if isinstance(old, dict) and "value" in old:  # with the unit of a plain number, and a text about it
            raw = {**old, "value": in_unit(raw, str(old.get("unit", "")), name)}
        read = entries(folder=value.folder, parameters={name: raw}).parameters
        return replace(value, parameters={**value.parameters, **read})
    whole = value.blocks[name]
    entry = whole.variants.get(whole.variant, whole)
    if entry.inner is None or len(inner) == 1:
        described = {"fmu": entry.fmu, **entry.options} if entry.fmu else {"type": entry.type or "Subdiagram"}
        given = {**entry.parameters, ".".join(inner): raw}
        entry = replace(entry, parameters=block(name, {**described, "parameters": given}, value.folder).parameters)
    elif isinstance(entry.diagram, DiagramValue):
        entry = replace(entry, diagram=_with(entry.diagram, inner, raw, resolver))
    else:
        message = "is a diagram in another file, so no block in it can be changed here."
        raise UsageError(Fault("E501", legible(name), message, f"Load {entry.diagram}, and set the value there."))
    if whole.variant in whole.variants:
        entry = replace(whole, variants={**whole.variants, whole.variant: entry})
    port_units(value, name, entry, resolver)  # raises if the value does not fit
    return replace(value, blocks={**value.blocks, name: entry})
