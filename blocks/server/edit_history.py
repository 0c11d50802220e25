"""The steps of files that are edited: where their texts before and after differ, so that all gestures can be kept."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ..editing.edits import Edit

MOST_BYTES = 64 * 2**20
"""What a history holds; the oldest steps are forgotten first."""


class _Part(NamedTuple):
    """What one text of a file has in place of what another one has, and the digests of both."""

    start: int
    texts: tuple[bytes, bytes]
    digests: tuple[bytes, bytes]

    @classmethod
    def of(cls, before: bytes, after: bytes) -> _Part:
        start = _same(before, after)
        end = _same(before[start:][::-1], after[start:][::-1])
        before_, after_ = (text[start : len(text) - end] for text in (before, after))
        return cls(start, (before_, after_), (_digest(before), _digest(after)))

    @property
    def undone(self) -> _Part:
        return _Part(self.start, self.texts[::-1], self.digests[::-1])

    def before(self, after: bytes) -> bytes | None:
        """The text before; None where another one stands there than that of after."""
        if _digest(after) != self.digests[1]:
            return None
        return after[: self.start] + self.texts[0] + after[self.start + len(self.texts[1]) :]


@dataclass(frozen=True)
class Step:
    """What was done, in words, and to which parts of which files."""

    what: str
    parts: Mapping[str, _Part]

    @classmethod
    def of(cls, what: str, texts: Mapping[str, str], were: Mapping[str, str]) -> Step:
        return cls(what, {file: _Part.of(_bytes(were[file]), _bytes(text)) for file, text in texts.items()})

    @property
    def undone(self) -> Step:
        return Step(self.what, {file: part.undone for file, part in self.parts.items()})

    def but(self, files: Collection[str]) -> Step:
        """The same without some files."""
        return Step(self.what, {file: part for file, part in self.parts.items() if file not in files})

    def back(self, now: Mapping[str, str | None]) -> tuple[Edit, list[str]]:
        """The edit that undoes it, of what the files hold now, and those that do not hold what it made of them."""
        texts, others = {}, []
        for file, part in self.parts.items():
            text = now[file]
            before = None if text is None else part.before(_bytes(text))
            if before is None:
                others.append(file)
            else:
                texts[file] = before.decode("utf-8", "surrogateescape")
        return Edit(texts, {file: now[file] or "" for file in texts}, ()), others

    @property
    def size(self) -> int:
        return sum(len(text) for part in self.parts.values() for text in part.texts)


class History:
    """done, undone: steps, the newest last."""

    def __init__(self) -> None:
        self.done: list[Step] = []
        self.undone: list[Step] = []

    def add(self, step: Step) -> None:
        """Take a new step in, after which nothing can be done again."""
        self.done.append(step)
        self.undone.clear()
        size = sum(step.size for step in self.done)
        while size > MOST_BYTES and len(self.done) > 1:
            size -= self.done.pop(0).size


def _same(a: bytes, b: bytes) -> int:
    """How many bytes two texts have in common at their beginnings."""
    low, high = 0, min(len(a), len(b))
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if a[low:middle] == b[low:middle] else (low, middle - 1)
    return low


def _digest(text: bytes) -> bytes:
    return hashlib.sha256(text).digest()


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")
