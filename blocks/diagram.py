"""A diagram as a frozen value: what a file says, no more and no less.

Values of parameters stay as written (numbers with their spelling, `"=..."` texts, `{"value": ..., "unit": ...}`),
so that a canonical file is written back byte for byte. What they mean is settled by `flatten`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .errors import Fault

__all__ = ["FORMAT", "NAME", "VERSION", "BlockEntry", "DiagramValue", "is_name"]

FORMAT = "blocks-diagram"
VERSION = 1
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,199}\Z", re.ASCII)
"""Names of blocks, parameters, inputs and outputs: identifiers of at most 200 characters."""

def is_name(text: str) -> bool:
    return bool(NAME.match(text))


@dataclass(frozen=True, slots=True)
class BlockEntry:
    """One block of a diagram: exactly one of `type`, `diagram` (a value or a file's path) and `fmu`.

    cls: the class, where the block was made in Python. loaded: the value of a diagram that is a file.
    """

    type: str = ""
    diagram: DiagramValue | str | None = None
    fmu: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    doc: Any = ""
    extras: Mapping[str, Any] = field(default_factory=dict)
    cls: Any = field(default=None, compare=False, repr=False)
    loaded: DiagramValue | None = field(default=None, compare=False, repr=False)

    @property
    def inner(self) -> DiagramValue | None:
        """The subdiagram's value, inline or loaded."""
        return self.diagram if isinstance(self.diagram, DiagramValue) else self.loaded


@dataclass(frozen=True, slots=True)
class DiagramValue:
    """A diagram: blocks, wires (sink -> source), inputs, outputs, parameters, run settings, measures, layout.

    file, positions, prefix: where it was read, for the places of faults; not part of the value.
    """

    name: str = "diagram"
    doc: Any = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    outputs: Mapping[str, Any] = field(default_factory=dict)
    blocks: Mapping[str, BlockEntry] = field(default_factory=dict)
    wires: Mapping[str, str] = field(default_factory=dict)
    run: Mapping[str, Any] = field(default_factory=dict)
    measures: Mapping[str, Any] = field(default_factory=dict)
    layout: Mapping[str, Any] = field(default_factory=dict)
    extras: Mapping[str, Any] = field(default_factory=dict)
    file: str = field(default="", compare=False, repr=False)
    folder: str = field(default="", compare=False, repr=False)  # where its relative paths begin
    positions: Mapping[Any, tuple[int, int]] = field(default_factory=dict, compare=False, repr=False)
    prefix: tuple[str | int, ...] = field(default=(), compare=False, repr=False)

    def fault(self, code: str, place: str, message: str, cure: str = "", path: tuple[str | int, ...] = ()) -> Fault:
        """A fault with its place in the file: that of `path`, or of the nearest thing around it."""
        full = (*self.prefix, *path)
        while full and full not in self.positions:
            full = full[:-1]
        line, column = self.positions.get(full, (0, 0))
        return Fault(code, place, message, cure, full, self.file, line, column)
