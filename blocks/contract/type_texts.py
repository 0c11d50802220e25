"""What a block type says of itself: the names of its formulas, and its docstring in pieces."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from ..text import docstrings
from ..text.errors import BlocksError
from ..text.formula_tree import Names
from .interface import Interface, Value
from .resolution import Resolved, resolve
from .variables import REQUIRED

NO_NAMES = Names(vectors=frozenset("rxyzu"))
"""For texts that belong to no block."""


def resolved_of(cls: Any, values: Mapping[str, Value] = MappingProxyType({})) -> Resolved | None:
    """A block type with its defaults and some values; what must be given is 1. None where that cannot be."""
    parameters = cls.declaration.parameters.items()
    given = {name: Value(1.0 if p.type != "string" else "1") for name, p in parameters if p.default is REQUIRED}
    optional = [name for name, p in parameters if p.default is None and p.shape == ()]
    for extra in ([], *([name] for name in optional), optional):  # where one of several must be given, or several
        try:
            return resolve(cls, {**given, **{name: Value(1.0) for name in extra}, **values})
        except BlocksError:
            continue
    return None


def interface_of(cls: object) -> Interface | None:
    """The ports and sizes of a block type with its defaults."""
    made = resolved_of(cls)
    return None if made is None else made.interface


def names_of(cls: Any) -> Names:
    """What the formulas of a block's docstring may read."""
    d, interface = cls.declaration, interface_of(cls)
    declared = {*d.readable, *d.event_times, *d.sizes}
    declared -= {name for name, p in d.parameters.items() if p.type == "string"}  # words, not numbers
    if interface is not None:
        declared |= {*interface.inputs, *interface.outputs}
    vectors = {name for name, variable in d.readable.items() if variable.shape != ()}
    return Names(frozenset(declared), frozenset(vectors))


def pieces_of(cls: Any) -> tuple[str, list[docstrings.Piece]]:
    """The summary and the rest of a block's docstring."""
    words = {choice for p in cls.declaration.parameters.values() for choice in p.choices}
    summary, _, rest = cls.declaration.doc.partition("\n")
    return summary, docstrings.paragraphs_of(rest, words)
