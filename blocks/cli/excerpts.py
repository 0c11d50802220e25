"""The lines of a file that faults speak of, as a terminal shows them.

     12 |   "motor.v": "control.w",
        |              ^^^^^^^^^^^
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from ..text.errors import Fault

__all__ = ["Excerpts"]

LARGEST = 16 * 2**20  # bytes, as much as a diagram file may have
MOST = 50
WIDTH = 100  # characters of a line
BEFORE = 40  # of them before the place, where a line is longer

# What stands at a place: a string, or a word, or one character.
_token = re.compile(r'"(?:[^"\\]|\\.)*"|[\w.+-]+|.', re.DOTALL).match


class Excerpts:
    """Lines of files by fault; each file is read once."""

    def __init__(self) -> None:
        self._files: dict[str, list[str]] = {}
        self._count = 0

    def of(self, fault: Fault) -> Iterator[str]:
        """Two lines for a fault whose line is known: what stands there, and where."""
        if not fault.line or self._count >= MOST:
            return
        lines = self._lines(fault.file)
        if fault.line > len(lines):
            return
        line, at = lines[fault.line - 1], fault.column - 1
        if not 0 <= at <= len(line):
            return
        self._count += 1
        found = _token(line, at)
        length = len(found[0]) if found else 1
        first = max(0, at - BEFORE) if len(line) > WIDTH else 0
        shown = "".join(c if c.isprintable() else " " for c in line[first : first + WIDTH])
        cut = "..." if first else ""
        shown = f"{cut}{shown}{'...' if first + WIDTH < len(line) else ''}"
        mark = " " * (at - first + len(cut)) + "^" * max(1, min(length, WIDTH - (at - first)))
        margin = max(4, len(str(fault.line)))
        yield f"  {fault.line:{margin}} | {shown}"
        yield f"  {'':{margin}} | {mark}"

    def _lines(self, file: str) -> list[str]:
        if file not in self._files:
            try:
                with open(file, "rb") as stream:
                    data = stream.read(LARGEST + 1)
                # The lines of the reader: they end at \n alone.
                self._files[file] = [] if len(data) > LARGEST else data.decode("utf-8", "replace").split("\n")
            except (OSError, ValueError):
                self._files[file] = []
        return self._files[file]
