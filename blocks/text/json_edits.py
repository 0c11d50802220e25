"""A JSON text -> the text of another value, which differs where the values do, and nowhere else.

    edited(read('{"k": 2,   "on": true}'), {"k": 3, "on": true}, ...)    '{"k": 3,   "on": true}'

Spaces, line breaks, the spelling of numbers and escapes stay. What is new is written as its neighbours are: in a line
of its own, with their indentation, where they have one. Where a canonical text needs other line breaks after an edit,
as those of a block that gets its first variant, what stands there is written anew; a canonical text stays canonical.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from fractions import Fraction
from math import copysign
from typing import Any, NamedTuple, TypeAlias

from . import json_writer
from .json_document import Document, Path, Position
from .json_number import Number

_SPACE = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()
_CHARACTER = re.compile(
    r"\\u[dD][89abAB][0-9a-fA-F]{2}\\u[dD][c-fC-F][0-9a-fA-F]{2}|\\u[0-9a-fA-F]{4}|\\.|[^\\]", re.DOTALL
)


Lines: TypeAlias = Callable[[Path, Any], bool]


MOST_COMPARED = 250_000
"""Pairs of entries or characters that are compared; beyond, they are paired as they stand."""


class Splice(NamedTuple):
    """A change of a text: what stood at an offset, and what stands there now; "" where nothing does."""

    start: int
    old: str
    new: str


class _Item(NamedTuple):
    """An entry in the text of an object or a list. lead: the spaces before it; key: where its key stands, if any.

    start, end: of its value; after: where the spaces behind it end.
    """

    lead: str
    key: tuple[int, int]
    start: int
    end: int
    after: int


def same(a: Any, b: Any) -> bool:
    """Whether two values are written alike, but for the spelling of numbers; keys stand in the same order."""
    if a is b:
        return True
    if isinstance(a, Mapping):
        return isinstance(b, Mapping) and [*a] == [*b] and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return isinstance(b, (list, tuple)) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, (bool, str)) or a is None or isinstance(b, (bool, str)) or b is None:
        return type(a) is type(b) and bool(a == b)
    if isinstance(a, Number) and isinstance(b, Number) and a.text == b.text:
        return True
    return bool(a == b) and copysign(1.0, a) == copysign(1.0, b) and _exact(a) == _exact(b)


def _exact(number: object) -> Fraction:
    """What a number is in decimals, as times are taken."""
    return number.exact if isinstance(number, Number) else Fraction(repr(number))


def edited(
    document: Document, value: object, *, lines: Callable[[Any], Lines]
) -> tuple[str, tuple[Splice, ...]]:
    """The text of a document after its value is another one, and the changes, in the order of the text.

    lines: for a whole value, where its canonical text has a line for each entry (`json_writer.write`). Raises
    ModelError (E004, E008) for what no text can hold.
    """
    text = document.text
    start = _space(text, 0)
    end = _DECODER.raw_decode(text, start)[1]
    writing = _Editor(text, lines(document.value), lines(value))
    # What is new must keep the limits, wherever it stands; a text that is too large is refused when it is read.
    new = writing.value(start, end, document.value, value, (), (), "\n")
    return text[:start] + new + text[end:], tuple(sorted(writing.splices))


def _space(text: str, at: int) -> int:
    return _SPACE.match(text, at).end()  # type: ignore[union-attr]  # it matches always


@dataclass
class _Editor:
    text: str
    before: Lines
    after: Lines
    splices: list[Splice] = field(default_factory=list)

    def value(self, start: int, end: int, old: object, new: object, was: Path, path: Path, margin: str) -> str:
        """The text of a value in place of that from `start` to `end`, which stood at the path `was`."""
        if same(old, new):
            return self.text[start:end]
        if isinstance(old, str) and isinstance(new, str):
            return self.replaced(start, end, self.string(start, end, new))
        kind = Mapping if isinstance(old, Mapping) else list
        is_pair = isinstance(old, kind) and isinstance(new, kind)
        if not is_pair or not old or not new or self.is_written_anew(start, end, old, new, was, path, margin):
            return self.replaced(start, end, self.written(new, path, margin))
        return self.container(start, end, old, new, was, path)

    def is_written_anew(
        self, start: int, end: int, old: object, new: object, was: Path, path: Path, margin: str
    ) -> bool:
        """Whether the canonical form needs other line breaks now, and the text has them as it needed them before."""
        if not margin or self.before(was, old) == self.after(path, new):
            return False
        return self.written(old, was, margin, self.before) == self.text[start:end]

    def written(self, value: object, path: Path, margin: str, lines: Lines | None = None) -> str:
        return json_writer.piece(value, path, margin, self.unit if margin else "", one_per_line=lines or self.after)

    @property
    def unit(self) -> str:
        """The indentation of a level: that of the first line that has one."""
        first = re.search(r"\n([ \t]+)", self.text)
        return first[1] if first else " "

    def replaced(self, start: int, end: int, new: str) -> str:
        self.splices.append(Splice(start, self.text[start:end], new))
        return new

    def string(self, start: int, end: int, new: str) -> str:
        """A string in place of another one; characters that stay are spelled as they were."""
        raw = self.text[start:end]
        if "\\" not in raw:
            return json_writer.string(new)
        spelled = [match[0] for match in _CHARACTER.finditer(raw, 1, len(raw) - 1)]
        old = [json.loads(f'"{piece}"') for piece in spelled]
        pieces: list[str] = []
        k = 0
        for before, after in [*_kept(old, list(new)), (len(old), len(new))]:
            pieces += [json_writer.string(new[k:after])[1:-1], *spelled[before : before + 1]]
            k = after + 1
        return f'"{"".join(pieces)}"'

    # --- objects and lists -------------------------------------------------------------------------------------

    def items(self, start: int, has_keys: bool) -> Iterator[_Item]:
        at = start + 1
        while True:
            begin = first = _space(self.text, at)
            if has_keys:
                end = _DECODER.raw_decode(self.text, begin)[1]
                key = begin, end
                begin = _space(self.text, _space(self.text, end) + 1)  # behind the colon
            else:
                key = begin, begin
            end = _DECODER.raw_decode(self.text, begin)[1]
            after = _space(self.text, end)
            yield _Item(self.text[at:first], key, begin, end, after)
            if self.text[after] != ",":
                return
            at = after + 1

    def container(self, start: int, end: int, old: Any, new: Any, was: Path, path: Path) -> str:
        """An object or a list, neither empty before nor after."""
        has_keys = isinstance(old, Mapping)
        items = list(self.items(start, has_keys))
        old_keys: Sequence[Any] = [*old] if has_keys else range(len(old))
        new_keys: Sequence[Any] = [*new] if has_keys else range(len(new))
        first = items[0].lead
        lead = items[1].lead if len(items) > 1 else first if "\n" in first else " "
        break_ = re.search(r"\r?\n[ \t]*\Z", lead)
        margin = break_[0] if break_ else ""
        pieces: list[str] = []
        last = start + 1  # where what is inserted stands, for a reader of the changes

        def put(text: str, own: str) -> None:
            pieces.append((first if not pieces else own) + text)

        for removed, inserted in _paired(old, new):
            item = items[removed] if removed is not None else None
            if inserted is None:
                assert item is not None
                self.replaced(item.key[0], item.end, "")
                continue
            key = new_keys[inserted]
            if item is None:
                text = f"{json_writer.string(key)}: " if has_keys else ""
                text += self.written(new[key], (*path, key), margin)
                self.splices.append(Splice(last, "", text))
                put(text, lead)
                continue
            old_key = old_keys[removed]  # type: ignore[index]
            text, own = "", item.lead if removed else lead
            if has_keys:
                text = self.text[slice(*item.key)]
                text = text if old_key == key else self.replaced(*item.key, self.string(*item.key, key))
                text += self.text[item.key[1] : item.start]
            text += self.value(
                item.start, item.end, old[old_key], new[key], (*was, old_key), (*path, key), margin
            )
            last = item.end
            put(text + (self.text[item.end : item.after] if item is not items[-1] else ""), own)
        tail = self.text[items[-1].end : end]
        return self.text[start] + ",".join(pieces) + tail


def _paired(old: Any, new: Any) -> Iterator[tuple[int | None, int | None]]:
    """The places of entries before and after, in the order after: None where one is new, or gone.

    What stands between the same entries is the same one with another key, or another value.
    """
    if isinstance(old, Mapping):
        a, b = [*old], [*new]
        order = [key for key in a if key in new]
        if order == [key for key in b if key in old]:
            places = {key: k for k, key in enumerate(a)}, {key: k for k, key in enumerate(b)}
            blocks = [(places[0][key], places[1][key]) for key in order]
        else:
            blocks = _kept(a, b)
    else:
        a, b = ([json.dumps(entry) for entry in entries] for entries in (old, new))
        blocks = _kept(a, b)
    i = k = 0
    for before, after in [*blocks, (len(old), len(new))]:
        yield from _between(range(i, before), range(k, after))
        if before < len(old):
            yield before, after
        i, k = before + 1, after + 1


def _kept(a: Sequence[str], b: Sequence[str]) -> list[tuple[int, int]]:
    """The places of texts that stand in the same order in both; of very many, those at the begin and at the end."""
    most = min(len(a), len(b))
    start = next((k for k in range(most) if a[k] != b[k]), most)
    stop = next((k for k in range(most - start) if a[-1 - k] != b[-1 - k]), most - start)
    left = len(a) - stop, len(b) - stop
    kept = [(k, k) for k in range(start)]
    if (left[0] - start) * (left[1] - start) <= MOST_COMPARED:
        found = SequenceMatcher(None, a[start : left[0]], b[start : left[1]], autojunk=False).get_matching_blocks()
        kept += [(start + block.a + k, start + block.b + k) for block in found for k in range(block.size)]
    return kept + [(left[0] + k, left[1] + k) for k in range(stop)]


def _between(before: range, after: range) -> Iterator[tuple[int | None, int | None]]:
    for k in range(max(len(before), len(after))):
        yield (before[k] if k < len(before) else None), (after[k] if k < len(after) else None)


def position(text: str, offset: int) -> Position:
    """The line and the column of an offset, both from 1."""
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)
