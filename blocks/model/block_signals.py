"""The values of a flat diagram that can be recorded, by name.

Blocks have many outputs, and few are asked for: a signal is made when it is. Of copies one is known for all; its key
has brackets without a number, "robots[].motor.i".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from ..contract.interface import Port
from ..text.element_names import indexed, matching
from ..text.units import OfUnits
from .copies import CopySource, Fleet, without_numbers
from .expansion import Expansion
from .wires import BlockSource, Source


@dataclass(frozen=True, slots=True)
class FlatSignal(OfUnits):
    """A value that can be recorded, by name: where its elements come from.

    units: in SI. declared: the units of its ports, in which plain numbers about it are meant.
    """

    name: str
    sources: tuple[Source, ...]
    shape: tuple[int, ...]
    units: tuple[str, ...]
    declared: tuple[str, ...]
    type: str


class Signals(Mapping[str, FlatSignal]):
    """Signals by name. expansion: of copies, once it is known; without it, sources are those of one copy."""

    def __init__(self) -> None:
        self._known: dict[str, FlatSignal | tuple[int, Port]] = {}
        self._fleets: dict[str, Fleet] = {}
        self._hidden: set[str] = set()  # recorded where they are named only
        self.expansion: Expansion | None = None
        self.moved: Callable[[tuple[Source, ...]], tuple[Source, ...]] = tuple  # to the parts of blocks

    def add(
        self, name: str, signal: FlatSignal | tuple[int, Port], fleet: Fleet | None = None, *, is_told: bool = True
    ) -> None:
        """Take in a signal, or an output of a block by the block's index; fleet: in whose copies it is.

        is_told: whether it is recorded where no log is given; one that is not gives way to others of its name.
        """
        key = _key(name, fleet)
        if not is_told and key in self._known:
            return
        self._known[key] = signal
        if fleet is not None:
            self._fleets[key] = fleet
        if not is_told:
            self._hidden.add(key)

    def hide(self, name: str, fleet: Fleet | None) -> None:
        self._hidden.add(_key(name, fleet))

    @property
    def told(self) -> Iterator[str]:
        """What is recorded where no log is given: nothing that is inside of copies."""
        return (name for name in self._known if name not in self._hidden and name not in self._fleets)

    def is_told(self, name: str) -> bool:
        return without_numbers(name)[0] not in self._hidden

    def lane(self, fleet: Fleet | None, numbers: tuple[int, ...]) -> int | None:
        """The lane that the numbers of copies in a name mean; None where there is no such copy."""
        counts = [one.count for one in _around(fleet)]
        if len(counts) != len(numbers) or any(k >= count for k, count in zip(numbers, counts, strict=True)):
            return None
        lane = 0
        for number, count in zip(numbers, counts, strict=True):
            lane = lane * count + number
        return lane

    def is_copy(self, fleet: Fleet | None, names: str, numbers: tuple[int, ...]) -> bool:
        """Whether a path without its numbers, with a point behind it, and these are those of something in a fleet."""
        counts = [one.count for one in _around(fleet)][: len(numbers)]
        return names.count("[]") == len(counts) and all(k < n for k, n in zip(numbers, counts, strict=False))

    def of_copies(self, name: str) -> tuple[FlatSignal, Fleet | None, int]:
        """A signal with sources as they are seen from a lane of a fleet, and these."""
        entry, fleet, lane = None if name in self._fleets else self._known.get(name), None, 0
        if entry is None:
            key, numbers = without_numbers(name)
            entry, fleet = self._known[key], self._fleets.get(key)
            own = self.lane(fleet, numbers)
            if own is None:
                raise KeyError(name)
            lane = own
        if isinstance(entry, FlatSignal):
            signal = replace(entry, name=name)
        else:
            index, port = entry
            sources = tuple(BlockSource(index, port.variable, port.first + k) for k in range(port.size))
            signal = FlatSignal(name, sources, port.shape, port.units, port.declared, port.type)
        return signal, fleet, lane

    def seen_outside(self, name: str) -> Source:
        """Return the source of a signal, or of an element, as it is seen outside of all copies."""
        signal = element_of(name, self)
        assert signal is not None
        _, fleet, lane = self.of_copies(name if name in self else indexed(name)[0])
        source: Any = signal.sources[0]
        while fleet is not None and self.expansion is None:
            count = fleet.count
            source, fleet, lane = CopySource(fleet, lane % count, source), fleet.outer, lane // count
        return source  # type: ignore[no-any-return]

    def __getitem__(self, name: str) -> FlatSignal:
        signal, fleet, lane = self.of_copies(name)
        sources = signal.sources
        if self.expansion is not None:
            sources = self.expansion.sources(sources, fleet, lane)
        is_same = sources is signal.sources and self.moved is tuple
        return signal if is_same else replace(signal, sources=self.moved(sources))

    def __contains__(self, name: object) -> bool:
        if name in self._known:
            return name not in self._fleets
        if not self._fleets or not isinstance(name, str):
            return False
        key, numbers = without_numbers(name)
        return key in self._fleets and self.lane(self._fleets[key], numbers) is not None

    def __iter__(self) -> Iterator[str]:
        for key in self._known:
            yield from self.names(key)

    def __len__(self) -> int:
        return len(self._known) + sum(fleet.total - 1 for fleet in self._fleets.values())

    def names(self, key: str, numbers: tuple[int, ...] = ()) -> Iterator[str]:
        """The names of a key in all copies. numbers: the first of them that are fixed."""
        if key not in self._fleets:
            return iter((key,))
        parts = key.split("[]")
        open_ = [range(one.count) for one in _around(self._fleets[key])][len(numbers) :]
        fixed = [(number,) for number in numbers]
        pairs = product(*fixed, *open_)
        return ("".join(f"{part}[{k}]" for part, k in zip(parts, each, strict=False)) + parts[-1] for each in pairs)

    def below(self, names: str, numbers: tuple[int, ...]) -> list[str]:
        """The names of what is recorded of something, by its path without numbers and with a point behind it."""
        keys = (key for key in self._known if key.startswith(names) and key not in self._hidden)
        return [name for key in keys for name in self.names(key, numbers)]

    def like(self, pattern: str) -> list[str]:
        """The names of what is recorded that a pattern names."""
        told = [key for key in self._known if key not in self._hidden]
        keys = matching(re.sub(r"\[[^]]*\](?=\.)", "[]", pattern), told)
        return matching(pattern, [name for key in keys for name in self.names(key)])


def element_of(name: str, signals: Mapping[str, FlatSignal]) -> FlatSignal | None:
    """A signal by name, or one element of it ("z[0]"); of a matrix, a row."""
    if name in signals:
        return signals[name]
    base, index = indexed(name)
    signal = signals.get(base)
    if signal is None or index is None or not signal.shape or index >= signal.shape[0]:
        return None
    row = math.prod(signal.shape[1:])
    k = slice(index * row, (index + 1) * row)
    return FlatSignal(name, signal.sources[k], signal.shape[1:], signal.units[k], signal.declared[k], signal.type)


def _around(fleet: Fleet | None) -> list[Fleet]:
    """The fleets around something, from the outside."""
    return [] if fleet is None else [*_around(fleet.outer), fleet]


def _key(name: str, fleet: Fleet | None) -> str:
    """A name with brackets where copies have their numbers."""
    while fleet is not None:
        name, fleet = f"{fleet.path}[]{name[len(fleet.path) :]}", fleet.outer
    return name
