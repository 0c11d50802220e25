"""What a JSON text holds: its value with the place of every part, and the limits that bind reader and writer alike."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from .printable import quoted

Path: TypeAlias = tuple[str | int, ...]
Position: TypeAlias = tuple[int, int]

AT_KEY = -1
"""Behind a path in `Document.places`: the place of its key. No list has such an index."""

LARGEST_TEXT = 16 * 1024 * 1024  # bytes in UTF-8
LARGEST_DEPTH = 160  # 30 subdiagrams in each other, each the variant of a block, need 5 each, and 10 for what they hold
LARGEST_COUNT = 1_000_000
LONGEST_STRING = 100_000
IN_FILES = 4
"""A file on this machine, and what blocks writes, may have this many times more bytes and values."""
# A text of a million faults would otherwise take a gigabyte to report.
MOST_FAULTS = 1_000

_is_name = re.compile(r"[\w-]{1,60}").fullmatch


@dataclass(frozen=True)
class Document:
    """A JSON text that was read: its value, and where in the text every part of it stands.

    `value` is made of dict (in the order of the text), list, str, Number, bool and None. `places` maps the path of
    every value (keys and indices from the root, whose path is `()`) to its line and column, both from 1, columns
    in characters, and the path of every value that has a key, with AT_KEY behind, to the place of that key.
    """

    value: Any
    places: Mapping[Path, Position]
    text: str
    file: str

    @property
    def positions(self) -> Mapping[Path, Position]:
        """The places of values, by path."""
        return _Part(self.places, ())

    @property
    def key_positions(self) -> Mapping[Path, Position]:
        """The places of keys, by the paths that end in them."""
        return _Part(self.places, (AT_KEY,))


class _Part(Mapping[Path, Position]):
    """The places under paths with `end` behind."""

    def __init__(self, places: Mapping[Path, Position], end: Path) -> None:
        self._places = places
        self._end = end

    def __getitem__(self, path: Path) -> Position:
        return self._places[*path, *self._end]

    def __iter__(self) -> Iterator[Path]:
        ends = bool(self._end)
        return (path[:-1] if ends else path for path in self._places if (path[-1:] == (AT_KEY,)) == ends)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def place_of(path: Path) -> str:
    """The path as a person reads it: blocks.motor, wires["error.u1"], log[0]; of a long one, its end."""
    place = ""
    for step in path:
        if isinstance(step, int):
            place += f"[{step}]"
        elif _is_name(step):
            place += f".{step}" if place else step
        else:
            place += f"[{quoted(step)}]"
    return place if len(place) <= 120 else "..." + place[-117:]


def nearest(path: Path, places: Mapping[Path, Position]) -> Path:
    """The path, or the longest beginning of it that has a place."""
    while path and path not in places:
        path = path[:-1]
    return path
