"""Values of Python as a diagram file would hold them.

A text such as "2 mH" that is given to a numeric parameter is a quantity, as on the command line. A file has one form of
quantities, {"value": 2, "unit": "mH"}, so that only what is given is read so.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from numbers import Rational
from typing import TYPE_CHECKING, Any

import numpy as np

from ..contract.sparse import edges_of
from ..text.errors import BlocksError, Fault, UsageError
from ..text.printable import quoted
from ..text.quantity_text import read_quantity

if TYPE_CHECKING:
    from .diagram import DiagramValue
    from .hierarchy import Resolver

__all__ = ["given_value", "given_values", "raw_of"]


def raw_of(value: Any) -> Any:
    """A value as the file would hold it. Raises UsageError (E501)."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if hasattr(value, "tocoo"):
        return edges_of(value)
    if isinstance(value, (str, bool, int, float)) or value is None:
        return value
    if isinstance(value, (list, tuple)):
        return [raw_of(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): raw_of(item) for key, item in value.items()}
    if isinstance(value, (Rational, Decimal)):
        return float(value)
    raise UsageError(Fault("E501", "", f"{quoted(repr(value))} is not a value that a diagram can hold."))


def given_value(value: Any, parameter: Any) -> Any:
    """A value that a parameter of a block type is given, as the file would hold it. Raises UsageError (E501)."""
    raw = raw_of(value)
    is_numeric = isinstance(raw, str) and parameter is not None and parameter.type != "string" and not parameter.members
    return read_quantity(raw) if is_numeric else raw


def given_values(diagram: DiagramValue, resolver: Resolver, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """Values by the paths of parameters, texts such as "2 mH" as quantities where the parameter is numeric."""
    texts = [path for path, raw in given.items() if isinstance(raw, str) and read_quantity(raw) is not raw]
    return {**given, **{path: _given_at(diagram, resolver, str(path).split("."), given[path]) for path in texts}}


def _given_at(diagram: DiagramValue, resolver: Resolver, path: list[str], raw: str) -> Any:
    """A number with a unit that is given to a parameter: a quantity, unless the parameter is a text, or not there."""
    name, *inner = path
    if not inner:
        known = diagram.parameters.get(name)
        known = known.get("value") if isinstance(known, Mapping) else known
        return raw if known is None or (isinstance(known, str) and known[:1] != "=") else read_quantity(raw)
    entry = diagram.blocks.get(name.partition("[")[0])
    if entry is None:
        return raw
    if entry.inner is not None:
        return _given_at(entry.inner, resolver, inner, raw)
    try:
        cls = entry.cls or (resolver.fmu(entry, diagram.folder) if entry.fmu else resolver(entry.type))
    except (BlocksError, KeyError):  # which flattening reports
        return raw
    return given_value(raw, cls.declaration.parameters.get(inner[0]))
