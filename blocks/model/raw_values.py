"""Values of Python as a diagram file would hold them.

A text such as "2 mH" that is given to a numeric parameter is a quantity, as on the command line. A file has one form of
quantities, {"value": 2, "unit": "mH"}, so that only what is given is read so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from decimal import Decimal
from numbers import Rational
from typing import TYPE_CHECKING, Any

import numpy as np

from ..contract.block import Block
from ..contract.sparse import edges_of
from ..text.errors import BlocksError, Fault, UsageError
from ..text.printable import legible, quoted
from ..text.quantity_text import quantity_of, read_quantity
from .copies import named
from .variants import taken

if TYPE_CHECKING:
    from .diagram_value import BlockEntry, DiagramValue
    from .hierarchy import Resolver


def raw_of(value: object) -> Any:
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
    message = f"{quoted(repr(value))} is not a value that a diagram can hold."
    raise UsageError(Fault("E501", "", message, "Give a number, a text, a bool or a list."))


def given_value(value: Any, parameter: Any) -> Any:
    """A value that a parameter of a block type is given, as the file would hold it. Raises UsageError (E501)."""
    raw = raw_of(value)
    is_numeric = parameter is not None and parameter.type != "string" and not parameter.members
    return _no_limit(_quantities(raw)) if is_numeric else raw


def given_values(diagram: DiagramValue, resolver: Resolver, given: Mapping[str, object]) -> Mapping[str, object]:
    """Values by the paths of parameters, texts such as "2 mH" as quantities where the parameter is numeric.

    A pattern gives its value to all parameters that it names, but those that are given by themselves; one that names
    none stays, and is refused where the diagram is flattened. Raises UsageError (E501) for two patterns of one.
    """
    patterns = [name for name in given if "*" in str(name)]
    if patterns:
        diagram = taken(diagram)
        known, fleets = dict.fromkeys(parameters_of(diagram, resolver)), {*_fleets(diagram)}
        by: dict[str, str] = {}
        for pattern in patterns:
            for path in named(pattern, known, fleets) or [pattern]:
                if path in by:
                    message = f"is given twice: by {legible(by[path])} and by {legible(pattern)}."
                    raise UsageError(Fault("E501", legible(path), message, "Give it once."))
                by[path] = pattern
        own = {name: name for name in given if "*" not in str(name)}
        given = {path: given[name] for path, name in (by | own).items()}
    given = {path: _no_limit(raw) for path, raw in given.items()}
    texts = [path for path, raw in given.items() if isinstance(raw, (str, list, tuple)) and _quantities(raw) != raw]
    return {**given, **{path: _given_at(diagram, resolver, str(path), given[path]) for path in texts}}


def _no_limit(raw: Any) -> object:
    """Return inf and -inf as a file has them, as texts, also in a list for copies; any other value as it is."""
    if type(raw) is float:  # the most frequent
        return f"{raw:f}" if math.isinf(raw) else raw
    if isinstance(raw, (np.ndarray, np.generic)) and raw.dtype.kind == "f" and np.isinf(raw).any():
        raw = raw.tolist()
    if type(raw) in (list, tuple):
        return type(raw)(map(_no_limit, raw))
    return f"{raw:f}" if isinstance(raw, float) and math.isinf(raw) else raw


def _quantities(raw: Any) -> object:
    """A text that is a quantity as the file would hold it, and lists of such, as of the values of copies."""
    return type(raw)(map(_quantities, raw)) if type(raw) in (list, tuple) else read_quantity(raw)


def _given_at(diagram: DiagramValue, resolver: Resolver, path: str, raw: object) -> Any:
    """A number with a unit that is given to a parameter: a quantity, unless the parameter is a text, or not there."""
    inner, cls, name = _opened(diagram, resolver, path)
    if cls is not None:
        return given_value(raw, cls.declaration.parameters.get(name))
    known = quantity_of(inner.parameters.get(name)).value
    return raw if known is None or (isinstance(known, str) and known[:1] != "=") else _quantities(raw)


def is_of_block(diagram: DiagramValue, resolver: Resolver, path: str) -> bool:
    """Return whether a path, with or without the numbers of copies, is that of a parameter of a block."""
    _, cls, name = _opened(diagram, resolver, path)
    return cls is not None and name in cls.declaration.settable


def _opened(diagram: DiagramValue, resolver: Resolver, path: str) -> tuple[DiagramValue, type[Block] | None, str]:
    """Return the diagram, the class of the block in it, and the rest of a path; None if the path leads to no block."""
    name, dot, rest = path.partition(".")
    entry = diagram.blocks.get(name.partition("[")[0]) if dot else None
    if entry is None:
        return diagram, None, path
    if entry.inner is not None:
        return _opened(entry.inner, resolver, rest)
    return diagram, _class_of(entry, diagram, resolver), rest


def _class_of(entry: BlockEntry, diagram: DiagramValue, resolver: Resolver) -> type[Block] | None:
    """The class of a block; None where there is none, which flattening reports."""
    try:
        return entry.cls or (resolver.fmu(entry, diagram.folder) if entry.fmu else resolver(entry.type))
    except (BlocksError, KeyError):
        return None


def parameters_of(diagram: DiagramValue, resolver: Resolver, prefix: str = "") -> Iterator[str]:
    """Yield the paths of all parameters of a diagram without variants, without the numbers of copies."""
    yield from (prefix + name for name in diagram.parameters)
    for name, entry in diagram.blocks.items():
        if entry.inner is not None:
            yield from parameters_of(entry.inner, resolver, f"{prefix}{name}.")
        elif (cls := _class_of(entry, diagram, resolver)) is not None:
            yield from (f"{prefix}{name}.{key}" for key in cls.declaration.settable)


def _fleets(diagram: DiagramValue, prefix: str = "") -> Iterator[str]:
    """The paths of all blocks with copies."""
    for name, entry in diagram.blocks.items():
        if entry.copies is not None:
            yield prefix + name
        if entry.inner is not None:
            yield from _fleets(entry.inner, f"{prefix}{name}.")
