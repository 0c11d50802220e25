"""What a JSON text holds: its value with the place of every part, and the limits that bind reader and writer alike."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from .printable import quoted

__all__ = ["AT_KEY", "Document", "Path", "Position", "nearest", "place_of"]

Path: TypeAlias = tuple[str | int, ...]
Position: TypeAlias = tuple[int, int]

AT_KEY = -1
"""Behind a path in `Document.places`: the place of its key. No list has such an index."""

LARGEST_TEXT = 16 * 1024 * 1024  # bytes in UTF-8
LARGEST_DEPTH = 64
LARGEST_COUNT = 1_000_000
LONGEST_STRING = 100_000
# A text of a million faults would otherwise take a gigabyte to report.
MOST_FAULTS = 1_000

_is_name = re.compile(r"[\w-]{1,60}").fullmatch


@dataclass(frozen=True)
class Document:
    """A JSON text that was read: its value, and where in the text every part of it stands.

    `value` is made of dict (in the order of the text), list, str, Number, bool and None. `positions` maps the path of
    every value (keys and indices from the root, whose path is `()`) to its line and column, both from 1, columns
    in characters; `key_positions` has the position of the key for every path that ends in one.
    """

    value: Any
    positions: Mapping[Path, Position]
    key_positions: Mapping[Path, Position]
    text: str
    file: str

    @property
    def places(self) -> Mapping[Path, Position]:
        """`positions`, and the positions of keys under their paths with AT_KEY behind."""
        return _Places(self.positions, self.key_positions)


class _Places(Mapping[Path, Position]):
    __slots__ = ("_keys", "_values")

    def __init__(self, values: Mapping[Path, Position], keys: Mapping[Path, Position]) -> None:
        self._values = values
        self._keys = keys

    def __getitem__(self, path: Path) -> Position:
        return self._keys[path[:-1]] if path and path[-1] == AT_KEY else self._values[path]

    def __iter__(self) -> Iterator[Path]:
        yield from self._values
        for path in self._keys:
            yield *path, AT_KEY

    def __len__(self) -> int:
        return len(self._values) + len(self._keys)


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
