"""The calls of a program, and which of them form one loop.

A program is a list of `Call`s, each after those that it needs, and of `Copy`s. Equal calls that do not need each other
become the lanes of one loop. Loops of equal count are merged where values between them stay in their lane, and so in a
register.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from ..folding import At
from .function_code import Function

Value = tuple[str, Any]
"""A row of memory and an index in it (in q, n and v: or a name for what has no place yet; in c: an offset). Also
("t", 0); ("r", number): a value of a call of this program; ("ge", number): 1 where that is not negative, else 0;
("offset", number): the number itself. In a plan of one copy a value is that of the own lane, unless its number is an
`At`, or it is ("at", (value, lane))."""


@dataclass(slots=True)
class Place:
    """The place of a value in memory: a row in C, and an index in it or one for each lane.

    It is no `Value`: in a plan of one copy numbers count the places of that copy, here those of the whole diagram.
    """

    row: str
    index: Any  # an int, or a range of them

LEAST = 4  # equal calls that make a loop where all of their wires are regular
LEAST_IRREGULAR = 16  # and where they are not: registers are faster than short tables
MOST_CALLS, MOST_WEIGHT = 64, 1500  # calls and operations in one straight piece: for more, gcc takes too long


@dataclass(frozen=True, slots=True)
class Sink:
    """Where a value goes: a place in `out`, or one for each lane.

    condition: where this side is 0, the value is what `off` says: "zero", "side" (1 or -1, as the side `index` is),
    "inf", or "keep": then nothing is written.
    """

    index: int | range
    condition: int | None = None
    off: str = ""


def at_of(sink: Sink) -> int:
    """The place of a sink that has one alone."""
    assert isinstance(sink.index, int)
    return sink.index


@dataclass(slots=True, eq=False)
class Call:
    """One call: its arguments, the numbers of its values, and where these go.

    guard: the rates of which one must be due; (): it is always made. fallback: what replaces its values otherwise.
    lanes: of copies: how many calls it stands for. gathers: it puts its arguments, one for each lane, side by side.
    """

    function: Function
    label: str
    order: int  # the instance
    arguments: list[Value]
    values: list[int]
    sinks: list[list[Sink]]
    guard: tuple[int, ...] = ()
    fallback: list[Value] | None = None
    lanes: int = 1
    gathers: bool = False


@dataclass(frozen=True, slots=True)
class Copy:
    """A value that is copied to a place."""

    value: Value
    sink: Sink


@dataclass(slots=True, eq=False)
class EqualCalls:
    """Equal calls: lanes of a loop, or a single one, which may stand for lanes itself."""

    calls: list[Call]
    cluster: int = -1

    @property
    def is_loop(self) -> bool:
        return self.count > 1 or self.calls[0].gathers

    @property
    def count(self) -> int:
        """The number of lanes."""
        return len(self.calls) if len(self.calls) > 1 else self.calls[0].lanes


@dataclass(slots=True, eq=False)
class CallSequence:
    """Groups that are printed together: one loop, or straight calls."""

    groups: list[EqualCalls]
    is_loop: bool
    rows: dict[str, None] = field(default_factory=dict)
    reads_memory: bool = False  # whether a function in it takes all of the memory
    due: bool = False


def is_affine(indices: Sequence[int], most: int | None = None) -> bool:
    """Whether indices are equally spaced, by `most` at most."""
    if len(indices) < 2:
        return True
    if isinstance(indices, range):
        return most is None or abs(indices.step) <= most
    stride = indices[1] - indices[0]
    if most is not None and abs(stride) > most:
        return False
    return all(b - a == stride for a, b in pairwise(indices))


def _in_lane(value: Value) -> tuple[object, int] | None:
    """A value of a certain copy: what it is in all copies, and the lane."""
    row, index = value
    if row == "at":
        return index  # type: ignore[no-any-return]
    return ((row, int(index)), index.lane) if type(index) is At else None


class CallOrder:
    """The order of one program."""

    def __init__(self, calls: Sequence[Call]) -> None:
        self.calls = calls
        self.made: dict[int, tuple[Call, int]] = {
            value: (call, k) for call in calls for k, value in enumerate(call.values)
        }
        self.group_of: dict[Call, tuple[EqualCalls, int]] = {}

    def grouped(self, loops: bool) -> list[EqualCalls]:
        """The calls in groups; none needs another of its group."""
        groups: list[EqualCalls] = []
        for group in self._by_form() if loops and len(self.calls) >= LEAST else [[call] for call in self.calls]:
            if len(group) >= LEAST and not any(call.lanes > 1 or call.gathers for call in group):
                groups.append(EqualCalls(sorted(group, key=lambda call: call.order)))
            else:
                groups += [EqualCalls([call]) for call in group]
        self.assign(groups)
        while True:
            bad = {g: None for g in groups if LEAST_IRREGULAR > len(g.calls) > 1 and not self.is_regular(g)}
            if not bad:
                return groups
            groups = [g for g in groups if g not in bad] + [EqualCalls([call]) for g in bad for call in g.calls]
            self.assign(groups)

    def _by_form(self) -> list[list[Call]]:
        """Return the calls of one form at one depth together."""
        depth: dict[Call, int] = {}
        by_form: dict[object, list[Call]] = {}
        for call in self.calls:
            needed = (self.made[index][0] for row, index in call.arguments if row in ("r", "ge"))
            level = depth[call] = max((depth[other] + 1 for other in needed), default=0)
            rows = tuple(f"at {value[1][0][0]}" if value[0] == "at" else value[0] for value in call.arguments)
            forms = tuple(tuple((s.condition is None, s.off) for s in sinks) for sinks in call.sinks)
            fallback = None if call.fallback is None else tuple(row for row, _ in call.fallback)
            key = (call.function.name, level, rows, forms, call.guard, fallback, call.lanes, call.gathers)
            by_form.setdefault(key, []).append(call)
        return [*by_form.values()]

    def assign(self, groups: Iterable[EqualCalls]) -> None:
        self.group_of = {call: (group, lane) for group in groups for lane, call in enumerate(group.calls)}

    def is_regular(self, group: EqualCalls) -> bool:
        """Whether all lanes read and write at regular places."""
        for k in range(len(group.calls[0].arguments)):
            column = [call.arguments[k] for call in group.calls]
            of_copies = [_in_lane(value) for value in column]
            if any(of_copies):  # values of certain copies: of one thing, evenly spaced
                known = [pair for pair in of_copies if pair is not None]
                if len(known) < len(column) or any(pair[0] != known[0][0] for pair in known):
                    return False
                if not is_affine([lane for _, lane in known]):
                    return False
            elif column[0][0] in ("r", "ge"):
                if all(value == column[0] for value in column):
                    continue
                producers = [self.group_of[self.made[index][0]] for _, index in column]
                if any(other is not producers[0][0] or lane != i for i, (other, lane) in enumerate(producers)):
                    return False
                if len(producers[0][0].calls) != len(group.calls):
                    return False
            elif column[0][0] not in ("q", "n", "v", "p") and not is_affine([index for _, index in column]):
                return False
        first = group.calls[0]
        return all(
            is_affine([at_of(call.sinks[k][j]) for call in group.calls])
            for k, sinks in enumerate(first.sinks)
            for j in range(len(sinks))
        )

    def needs(self, group: EqualCalls) -> dict[EqualCalls, bool]:
        """The groups that a group reads, and whether each lane reads only the same lane there."""
        sources: dict[EqualCalls, bool] = {}
        for lane, call in enumerate(group.calls):
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    other, its = self.group_of[self.made[index][0]]
                    is_own = its == lane and type(index) is int and not (call.gathers or other.calls[0].gathers)
                    is_own = is_own and len(other.calls) == len(group.calls) and other.count == group.count
                    sources[other] = sources.get(other, True) and is_own
        return sources

    def clustered(self, groups: list[EqualCalls]) -> list[list[EqualCalls]]:
        """Groups that become one loop: of equal count, wired lane by lane, with nothing in between."""
        before = {group: self.needs(group) for group in groups}
        clusters: dict[int, list[EqualCalls]] = {}
        for number, group in enumerate(groups):
            group.cluster = number
            clusters[number] = [group]
        for group in groups:
            if not group.is_loop:
                continue
            for other in before[group]:
                a, b = other.cluster, group.cluster
                if a == b or not other.is_loop or not self.fits(clusters[a], clusters[b], before):
                    continue
                if self.is_between(clusters[a], clusters[b], before, clusters):
                    continue
                for member in clusters[b]:
                    member.cluster = a
                clusters[a] += clusters.pop(b)
        order = {group: number for number, group in enumerate(groups)}
        return [self.in_order(members, before, order) for members in clusters.values()]

    @staticmethod
    def fits(a: list[EqualCalls], b: list[EqualCalls], before: dict[EqualCalls, dict[EqualCalls, bool]]) -> bool:
        calls_a, calls_b = a[0].calls, b[0].calls
        if a[0].count != b[0].count or len(calls_a) != len(calls_b) or calls_a[0].guard != calls_b[0].guard:
            return False
        if any(g.calls[0].function.costly for g in a) != any(g.calls[0].function.costly for g in b):
            return False
        members = [*a, *b]
        return all(lanes for group in members for source, lanes in before[group].items() if source in members)

    @staticmethod
    def is_between(
        a: list[EqualCalls],
        b: list[EqualCalls],
        before: dict[EqualCalls, dict[EqualCalls, bool]],
        clusters: dict[int, list[EqualCalls]],
    ) -> bool:
        """Whether one of two clusters needs the other through a third."""
        pair = {a[0].cluster, b[0].cluster}
        seen: set[int] = set()
        waiting = [s.cluster for group in (*a, *b) for s in before[group] if s.cluster not in pair]
        while waiting:
            number = waiting.pop()
            if number in pair:
                return True
            if number not in seen:
                seen.add(number)
                waiting += [s.cluster for group in clusters[number] for s in before[group] if s.cluster != number]
        return False

    @staticmethod
    def in_order(
        members: list[EqualCalls], before: dict[EqualCalls, dict[EqualCalls, bool]], order: dict[EqualCalls, int]
    ) -> list[EqualCalls]:
        if len(members) == 1:
            return members
        ordered: list[EqualCalls] = []
        inside, done = set(members), set()
        waiting = sorted(members, key=order.__getitem__)
        while waiting:
            group = next(g for g in waiting if all(s in done or s not in inside for s in before[g]))
            waiting.remove(group)
            done.add(group)
            ordered.append(group)
        return ordered

    def units(self, loops: bool) -> list[CallSequence]:
        """The clusters, each after what it needs, straight calls in pieces."""
        clusters = self.clustered(self.grouped(loops))
        number = {group: k for k, members in enumerate(clusters) for group in members}
        place = {call: k for k, call in enumerate(self.calls)}
        waiting, users = [0] * len(clusters), [[] for _ in clusters]  # type: ignore[var-annotated]
        for k, members in enumerate(clusters):
            sources = dict.fromkeys(number[s] for group in members for s in self.needs(group))
            sources.pop(k, None)
            waiting[k] = len(sources)
            for source in sources:
                users[source].append(k)
        rank = [(members[0].is_loop, place[members[0].calls[0]], k) for k, members in enumerate(clusters)]
        heap = [rank[k] for k in range(len(clusters)) if waiting[k] == 0]
        heapq.heapify(heap)
        sequences: list[CallSequence] = []
        count = weight = 0
        while heap:
            is_loop, _, k = heapq.heappop(heap)
            own = sum(group.calls[0].function.weight for group in clusters[k])
            full = count >= MOST_CALLS or weight + own > MOST_WEIGHT
            if is_loop or not sequences or sequences[-1].is_loop or full:
                sequences.append(CallSequence([], is_loop))
                count = weight = 0
            sequences[-1].groups += clusters[k]
            count, weight = count + 1, weight + own
            for user in users[k]:
                waiting[user] -= 1
                if waiting[user] == 0:
                    heapq.heappush(heap, rank[user])
        return sequences
