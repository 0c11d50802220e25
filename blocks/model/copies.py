"""Copies: blocks of which one entry makes many, flattened once and written out where somebody asks for each.

A `Fleet` is a block with copies; one that lies in a copy of another fleet has that one as its `outer`. What holds for
all copies is known of one of them, and `lane` counts the copies through all outer fleets, the own number running
fastest.
Sources of wires are followed from a lane of the block that reads them:

    BlockSource    a block outside of all fleets, or in the same copy as the reader (or in a copy around it)
    EachSource     what enters a fleet: a source for each of its copies
    CopySource     what leaves a fleet: a source in one of its copies

Written out, the blocks stand in the order of the text: copy 0 with all that is in it, copy 1, and so on.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Generic, NamedTuple, TypeVar

from ..host.gc_pause import paused
from ..text.arrays import Array
from ..text.errors import Fault, ModelError
from ..text.printable import counted
from ..text.quantity_text import quantity_of

T = TypeVar("T")


@dataclass(eq=False, slots=True)
class Fleet:
    """The copies of one block: its path without numbers, how many there are in each copy of the fleet around it."""

    path: str
    count: int
    outer: Fleet | None = None

    @property
    def total(self) -> int:
        """How many copies there are in the whole diagram."""
        return self.count * (1 if self.outer is None else self.outer.total)

    def numbered(self, path: str, lane: int) -> str:
        """Return the path of something in this fleet, with the numbers of its copies: "robots[3].motor"."""
        whole = f"{self.path}[{lane % self.count}]{path[len(self.path) :]}"
        return whole if self.outer is None else self.outer.numbered(whole, lane // self.count)

    def copies(self, lane: int) -> list[Copy | None]:
        """Return the copies that something in a lane of this fleet is in, by the parts of a path."""
        outer = [] if self.outer is None else self.outer.copies(lane // self.count)
        between = self.path.count(".") - len(outer)
        return [*outer, *[None] * between, Copy(self, lane % self.count)]

    def around(self, other: Fleet | None, lane: int) -> int:
        """Return the lane of a fleet around this one that holds a lane of this one; of none: 0."""
        fleet: Fleet | None = self
        while fleet is not other:
            assert fleet is not None
            lane //= fleet.count
            fleet = fleet.outer
        return lane


class Copy(NamedTuple):
    """One copy of a block. is_first: it stands for all, and is shown without its number."""

    fleet: Fleet
    number: int
    is_first: bool = False


def labelled(name: str, copy: Copy | None) -> str:
    """Return the name of a block, as paths show it."""
    return name if copy is None or copy.is_first else f"{name}[{copy.number}]"


def stream_of(name: str, copy: Copy | None) -> str:
    """Return the name of a stream of a block: each copy has its own."""
    return name if copy is None else f"{name}[{copy.number}]"


class EachSource(NamedTuple):
    """An element that enters a fleet from outside: for each copy its source, as it is seen around the fleet."""

    fleet: Fleet
    sources: tuple[Any, ...]


class CopySource(NamedTuple):
    """An element that leaves a fleet: of one copy of it, a source that is seen inside."""

    fleet: Fleet
    number: int
    source: Any


class Later(Sequence[T], Generic[T]):
    """A long tuple that is made when an element of it is first asked for; its length is known before."""

    def __init__(self, size: int, make: Callable[[], Sequence[T]]) -> None:
        self._size, self._make = size, make

    @cached_property
    def _items(self) -> tuple[T, ...]:
        items = tuple(self._make())
        assert len(items) == self._size, (len(items), self._size)
        del self._make
        return items

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, index: Any) -> Any:
        return self._items[index]

    def __iter__(self) -> Iterator[T]:
        return iter(self._items)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, (tuple, Later)) and self._items == tuple(other)

    def __hash__(self) -> int:
        return hash(self._items)

    def __reduce__(self) -> Any:
        return tuple, (self._items,)


class LateCopies:
    """The copies of a fleet that is in no other, each looked into when somebody asks for it.

    look_into: given the number of a copy, notes what is other in it. seen: the copies of which that is known.
    """

    def __init__(self, count: int, look_into: Callable[[int], None]) -> None:
        self.count, self.seen, self._look_into = count, set[int](), look_into

    def look(self, number: int) -> None:
        """Look into a copy, unless that is done."""
        if number not in self.seen:
            self._look_into(number)
            self.seen.add(number)

    @paused()
    def look_at_all(self) -> None:
        """Look into all copies."""
        for number in range(self.count):
            self.look(number)


class InLanes(Mapping[int, T]):
    """By lane what is other in it, known once somebody asks for it.

    size: how many lanes each of the copies has. columns: by parameter its numbers in all lanes, an element for each.
    """

    def __init__(self, copies: LateCopies, size: int, columns: Mapping[str, Array]) -> None:
        self.copies, self.size, self.columns, self.known = copies, size, columns, dict[int, T]()

    def __setitem__(self, lane: int, other: T) -> None:
        self.known[lane] = other

    def __getitem__(self, lane: int) -> T:
        self.copies.look(lane // self.size)
        return self.known[lane]

    def __iter__(self) -> Iterator[int]:
        self.copies.look_at_all()
        return iter(sorted(self.known))

    def __len__(self) -> int:
        return len([*self])

    def __reduce__(self) -> Any:
        return dict, (dict(self),)


class _CopyByCopy:
    """Where blocks stand once they are written out: those of copy 0, then of copy 1. fleets: the innermost of each."""

    def __init__(self, fleets: Sequence[Fleet | None]) -> None:
        self.fleets = fleets
        self._first: dict[Fleet, int] = {}  # where the first copy begins, in a copy of the fleet around
        self._size: dict[Fleet, int] = {}  # how many blocks one copy has
        self._place: list[int] = []  # of each block, in its copy
        open_: list[Fleet] = []
        used = [0]  # blocks so far, in the copy of each open fleet
        for fleet in [*fleets, None]:
            chain = [] if fleet is None else _chain(fleet)
            while open_ and (len(chain) < len(open_) or chain[len(open_) - 1] is not open_[-1]):
                self._size[open_[-1]] = used.pop()
                used[-1] += self._size[open_[-1]] * open_.pop().count
            for inner in chain[len(open_) :]:
                self._first[inner] = used[-1]
                open_.append(inner)
                used.append(0)
            self._place.append(used[-1])
            used[-1] += 1
        self.size = self._place.pop()

    def place(self, block: int, lane: int) -> int:
        place, fleet = self._place[block], self.fleets[block]
        while fleet is not None:
            place += self._first[fleet] + lane % fleet.count * self._size[fleet]
            lane //= fleet.count
            fleet = fleet.outer
        return place


class Layout:
    """Where the blocks stand once they are written out.

    fleets: the innermost fleet of each block. The first ones, `ordered`, stand in the order of the text; then come
    those at which wires go into and out of subdiagrams, `gates`, each for all copies; the rest is copy by copy again.
    """

    def __init__(self, fleets: Sequence[Fleet | None], ordered: int, gates: int = 0) -> None:
        self.fleets = fleets
        self._ordered, self._edge = ordered, ordered + gates
        self._text = _CopyByCopy(fleets[:ordered])
        self.size = self._text.size
        self._gates: list[int] = []
        for fleet in fleets[ordered : self._edge]:
            self._gates.append(self.size)
            self.size += 1 if fleet is None else fleet.total
        self._before = self.size
        self._rest = _CopyByCopy(fleets[self._edge :])
        self.size += self._rest.size

    def place(self, block: int, lane: int) -> int:
        """Return the number of a block in a lane of its fleet, among those that are written out."""
        if block < self._ordered:
            return self._text.place(block, lane)
        if block < self._edge:
            return self._gates[block - self._ordered] + lane
        return self._before + self._rest.place(block - self._edge, lane)

    def lane(self, block: int, fleet: Fleet | None, lane: int) -> int:
        """Return the lane of a block that is read from a lane of a fleet in the same copy."""
        return 0 if fleet is None else fleet.around(self.fleets[block], lane)

    def each(self) -> Iterator[tuple[int, int]]:
        """Return the blocks with their lanes, in the order in which they are written out."""
        pairs: list[tuple[int, int]] = [(0, 0)] * self.size
        for block, fleet in enumerate(self.fleets):
            for lane in range(1 if fleet is None else fleet.total):
                pairs[self.place(block, lane)] = block, lane
        return iter(pairs)


def _chain(fleet: Fleet) -> list[Fleet]:
    """Return a fleet with those around it, from the outside."""
    return [fleet] if fleet.outer is None else [*_chain(fleet.outer), fleet]


# --- values ----------------------------------------------------------------------------------------------------


def own_value(raw: Any, depth: int, copies: Sequence[Copy]) -> object:
    """Return what a raw value says for one copy: an element, if it has more dimensions than the parameter, or itself.

    depth: the dimensions of the parameter. copies: of each fleet that the value is for, from the outside; lists for
    inner ones are the same in all copies of outer ones, unless there is a list of them. Raises ModelError (E110) where
    there is not an element for each copy.
    """
    if not copies:
        return raw
    if isinstance(raw, Mapping) and "csv" in raw:
        numbers = getattr(raw, "numbers", ())
        if depth > 0:
            return raw
        said: Any = {"value": own_value(list(numbers), depth, copies)}
        unit = getattr(raw, "unit", "") or raw.get("unit")
        return said | ({"unit": unit} if unit else {})
    if isinstance(raw, Mapping) and "value" in raw:
        value = own_value(raw["value"], depth, copies)
        return raw if value is raw["value"] else {**raw, "value": value}
    (fleet, number, _), inner = copies[0], copies[1:]
    if not _is_deeper(raw, depth + len(inner)):
        return own_value(raw, depth, inner)
    if len(raw) != fleet.count:
        copies_are = "is 1 copy" if fleet.count == 1 else f"are {fleet.count:,} copies"
        message = f"has {counted(len(raw), 'value')}, but there {copies_are} of {fleet.path}."
        raise ModelError(Fault("E110", "", message, "Give one value for all copies, or a list with one for each."))
    return own_value(raw[number], depth, inner)


def spellings(path: str) -> Iterator[str]:
    """Return the names under which a parameter in copies is set: by the numbers of all, then without some of them."""
    parts = [dict.fromkeys((part, part.partition("[")[0])) for part in path.split(".")]
    return map(".".join, product(*parts))


def unnumbered(path: str, copies: Sequence[Copy | None]) -> list[Copy]:
    """Return the copies around a parameter of which its name has no number. copies: by the parts of the name."""
    parts = zip(path.split("."), copies, strict=False)
    return [copy for part, copy in parts if copy is not None and not part.endswith("]")]


def named(pattern: str, known: Collection[str], fleets: Collection[str]) -> list[str]:
    """Return the parameters that a name or a pattern names: "*[3].motor.R*" -> ["cells[3].motor.Ra"].

    * stands for a part of one name, and [*] for all copies, as does no number. known: without numbers; other brackets
    belong to the names of an FMU's parameters ("den[1]"). fleets: the paths of blocks with copies.
    """
    labels = [part.partition("[") for part in pattern.split(".")]
    numbers = ["".join(label[1:]) for label in labels]
    plain = without_copies(pattern, fleets)
    # A number may belong to the name itself; it is tried first, as the pattern before it takes as little as it can.
    form = re.compile(r"\.".join(f"{_form(stem)}({_form(bracket + rest)})?" for stem, bracket, rest in labels))
    made = []
    for path in known if "*" in plain else [plain] if plain in known else []:
        match = form.fullmatch(path)
        if match is None:
            continue
        names = path.split(".")
        added = ["" if own else number for own, number in zip(match.groups(), numbers, strict=True)]
        if all(
            not number or (_NUMBER.fullmatch(number) and ".".join(names[: k + 1]) in fleets)
            for k, number in enumerate(added)
        ):
            made.append(".".join(name + number.replace("[*]", "") for name, number in zip(names, added, strict=True)))
    return made


def _form(pattern: str) -> str:
    return "[^.]*?".join(map(re.escape, pattern.split("*")))


def without_copies(path: str, fleets: Collection[str]) -> str:
    """Return the path of a parameter without the numbers of copies; brackets of its own name stay."""
    plain = ""
    for part in path.split("."):
        stem = part.partition("[")[0]
        plain += f"{stem if plain + stem in fleets else part}."
    return plain[:-1]


def depth_of(raw: object) -> int:
    """Return how many lists lie in each other in a raw value."""
    raw = quantity_of(raw).value
    return 1 + max(map(depth_of, raw), default=0) if isinstance(raw, (list, tuple)) else 0


def _is_deeper(raw: object, depth: int) -> bool:
    """Return whether more lists than `depth` lie in each other, looking no further than it must."""
    raw = quantity_of(raw).value
    return isinstance(raw, (list, tuple)) and (depth == 0 or any(_is_deeper(item, depth - 1) for item in raw))


def dimensions(shape: object) -> int:
    """Return the dimensions of a parameter of a block type by its declared shape; of one that a function gives: 1."""
    return len(shape) if isinstance(shape, tuple) else 1


_NUMBERS = re.compile(r"\[(0|[1-9][0-9]{0,6})\](?=\.)")
_NUMBER = re.compile(r"\[(\*|0|[1-9][0-9]{0,6})\]")


def alike(paths: Iterable[str]) -> list[str]:
    """Return names in order, those that differ in numbers of copies alone as one: "robots[*].motor (100 copies)"."""
    found: dict[str, list[str]] = {}
    for path in paths:
        found.setdefault(re.sub(r"\[[0-9]+\]", "[*]", path), []).append(path)
    return [own[0] if len(own) == 1 else f"{name} ({len(own):,} copies)" for name, own in found.items()]


def without_numbers(text: str) -> tuple[str, tuple[int, ...]]:
    """Return a name without the numbers of copies, and these: "robots[3].motor.i" -> ("robots[].motor.i", (3,))."""
    return _NUMBERS.sub("[]", text), tuple(map(int, _NUMBERS.findall(text)))
