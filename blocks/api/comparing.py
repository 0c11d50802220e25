"""Two diagrams beside each other, also where a file has faults."""

from __future__ import annotations

from ..editing.diff import Differences, differences
from ..model.block_types import Library, library_types
from ..model.diagram_value import DiagramValue
from ..model.document import load, loads
from ..model.resolver import resolver_of
from ..text.errors import Fault, ModelError

Readable = tuple[DiagramValue, tuple[Fault, ...]]
"""A diagram, and the faults of its file; of one with faults, what could be read of it."""


def nothing() -> Readable:
    """Return the stand-in for a file that does not exist."""
    return DiagramValue(""), ()


def readable(path: str, data: bytes | None = None, *, folder: str = "") -> Readable:
    """Return the diagram of a file.

    data: its bytes, where they do not come from there; then the paths in it begin in `folder`. Raises ModelError where
    nothing of it is a diagram.
    """
    try:
        return (load(path) if data is None else loads(data, file=path, folder=folder or ".")), ()
    except ModelError as error:
        if not isinstance(error.readable, DiagramValue):
            raise
        return error.readable, error.faults


def compared(
    a: DiagramValue, b: DiagramValue, *, names: tuple[str, str], doc: bool, library: Library = ()
) -> Differences:
    """Find the differences from a to b. names: of a and b. doc: also compare doc texts and keys "x-..."."""
    return differences(a, b, names=names, doc=doc, resolver=resolver_of(library_types(library)))
