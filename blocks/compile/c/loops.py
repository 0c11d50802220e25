"""The calls of a program, and which of them are one loop.

A program is a list of `Call`s, each after those that it needs, and of `Copy`s. Equal calls that do not need each other
become the lanes of one loop; loops of one count become one where all that goes between them stays in its lane, so that
it never leaves a register.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from .functions import Function

__all__ = ["LEAST", "Call", "Copy", "Group", "Sink", "Unit", "Units", "Value", "is_affine"]

Value = tuple[str, Any]
"""A row of memory and an index in it (of q, n and v: or a name for what has no place yet; of c: an offset). Besides
("t", 0); ("r", number): what a call of this program gave; ("ge", number): 1 where that is not negative, else 0;
("offset", number): the number itself."""

LEAST = 4  # so many equal calls make a loop where all of their wires are regular
LEAST_IRREGULAR = 16  # and so many where they are not: registers are faster than short tables
MOST_CALLS, MOST_WEIGHT = 64, 1500  # calls and operations in one straight piece: gcc takes more than its share for more


@dataclass(frozen=True, slots=True)
class Sink:
    """Where a value goes: a place in `out`. condition: the side without which it is what `off` says.

    off: "zero", "side" (1 or -1, as the side `index` is), "inf", or "keep": then nothing is written.
    """

    index: int
    condition: int | None = None
    off: str = ""


@dataclass(slots=True, eq=False)
class Call:
    """One call: what it takes, the numbers of the values that it gives, and where these go.

    guard: the rates of which one must be due; (): it is always made. fallback: what stands for its values otherwise.
    """

    function: Function
    label: str
    order: int  # the instance
    arguments: list[Value]
    values: list[int]
    sinks: list[list[Sink]]
    guard: tuple[int, ...] = ()
    fallback: list[Value] | None = None


@dataclass(frozen=True, slots=True)
class Copy:
    """A value that goes to a place as it is."""

    value: Value
    sink: Sink


@dataclass(slots=True, eq=False)
class Group:
    """Equal calls: lanes of a loop, or one."""

    calls: list[Call]
    cluster: int = -1

    @property
    def is_loop(self) -> bool:
        return len(self.calls) > 1


@dataclass(slots=True, eq=False)
class Unit:
    """Groups that are printed together: one loop, or straight calls."""

    groups: list[Group]
    is_loop: bool
    rows: dict[str, None] = field(default_factory=dict)
    reads_memory: bool = False  # whether a function in it takes all of the memory
    due: bool = False


def is_affine(indices: Sequence[int], most: int | None = None) -> bool:
    """Whether indices are equally spaced, at most so far."""
    if len(indices) < 2:
        return True
    stride = indices[1] - indices[0]
    if most is not None and abs(stride) > most:
        return False
    return all(b - a == stride for a, b in pairwise(indices))


class Units:
    """The order of one program."""

    def __init__(self, calls: Sequence[Call]) -> None:
        self.calls = calls
        self.made: dict[int, tuple[Call, int]] = {
            value: (call, k) for call in calls for k, value in enumerate(call.values)
        }
        self.group_of: dict[Call, tuple[Group, int]] = {}

    def grouped(self, loops: bool) -> list[Group]:
        """The calls in groups; what needs each other is in different ones."""
        if not loops or len(self.calls) < LEAST:
            groups = [Group([call]) for call in self.calls]
        else:
            depth: dict[Call, int] = {}
            found: dict[object, list[Call]] = {}
            for call in self.calls:
                level = 0
                for row, index in call.arguments:
                    if row in ("r", "ge"):
                        level = max(level, depth[self.made[index][0]] + 1)
                depth[call] = level
                rows = tuple(row for row, _ in call.arguments)
                forms = tuple(tuple((s.condition is None, s.off) for s in sinks) for sinks in call.sinks)
                fallback = None if call.fallback is None else tuple(row for row, _ in call.fallback)
                key = (call.function.name, level, rows, forms, call.guard, fallback)
                found.setdefault(key, []).append(call)
            groups = []
            for group in found.values():
                if len(group) >= LEAST:
                    groups.append(Group(sorted(group, key=lambda call: call.order)))
                else:
                    groups += [Group([call]) for call in group]
        self.assign(groups)
        while True:
            bad = {g: None for g in groups if LEAST_IRREGULAR > len(g.calls) > 1 and not self.is_regular(g)}
            if not bad:
                return groups
            groups = [g for g in groups if g not in bad] + [Group([call]) for g in bad for call in g.calls]
            self.assign(groups)

    def assign(self, groups: Iterable[Group]) -> None:
        self.group_of = {call: (group, lane) for group in groups for lane, call in enumerate(group.calls)}

    def is_regular(self, group: Group) -> bool:
        """Whether all lanes find what they take and put what they give at regular places."""
        for k in range(len(group.calls[0].arguments)):
            column = [call.arguments[k] for call in group.calls]
            if column[0][0] in ("r", "ge"):
                if all(value == column[0] for value in column):
                    continue
                made = [self.group_of[self.made[index][0]] for _, index in column]
                if any(other is not made[0][0] or lane != i for i, (other, lane) in enumerate(made)):
                    return False
                if len(made[0][0].calls) != len(group.calls):
                    return False
            elif column[0][0] not in ("q", "n", "v", "p") and not is_affine([index for _, index in column]):
                return False
        first = group.calls[0]
        return all(
            is_affine([call.sinks[k][j].index for call in group.calls])
            for k, sinks in enumerate(first.sinks)
            for j in range(len(sinks))
        )

    def needs(self, group: Group) -> dict[Group, bool]:
        """The groups that a group reads, and whether each of its lanes reads the same lane there only."""
        found: dict[Group, bool] = {}
        for lane, call in enumerate(group.calls):
            for row, index in call.arguments:
                if row in ("r", "ge"):
                    other, its = self.group_of[self.made[index][0]]
                    found[other] = found.get(other, True) and its == lane and len(other.calls) == len(group.calls)
        return found

    def clustered(self, groups: list[Group]) -> list[list[Group]]:
        """Groups that become one loop: of one count, wired lane by lane, with nothing in between."""
        before = {group: self.needs(group) for group in groups}
        clusters: dict[int, list[Group]] = {}
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
    def fits(a: list[Group], b: list[Group], before: dict[Group, dict[Group, bool]]) -> bool:
        one, other = a[0].calls, b[0].calls
        if len(one) != len(other) or one[0].guard != other[0].guard:
            return False
        if any(g.calls[0].function.costly for g in a) != any(g.calls[0].function.costly for g in b):
            return False
        members = [*a, *b]
        return all(lanes for group in members for source, lanes in before[group].items() if source in members)

    @staticmethod
    def is_between(
        a: list[Group],
        b: list[Group],
        before: dict[Group, dict[Group, bool]],
        clusters: dict[int, list[Group]],
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
    def in_order(members: list[Group], before: dict[Group, dict[Group, bool]], order: dict[Group, int]) -> list[Group]:
        if len(members) == 1:
            return members
        made: list[Group] = []
        inside, done = set(members), set()
        waiting = sorted(members, key=order.__getitem__)
        while waiting:
            group = next(g for g in waiting if all(s in done or s not in inside for s in before[g]))
            waiting.remove(group)
            done.add(group)
            made.append(group)
        return made

    def units(self, loops: bool) -> list[Unit]:
        """The clusters in an order in which each comes after what it needs, straight calls in pieces."""
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
        made: list[Unit] = []
        count = weight = 0
        while heap:
            is_loop, _, k = heapq.heappop(heap)
            own = sum(group.calls[0].function.weight for group in clusters[k])
            full = count >= MOST_CALLS or weight + own > MOST_WEIGHT
            if is_loop or not made or made[-1].is_loop or full:
                made.append(Unit([], is_loop))
                count = weight = 0
            made[-1].groups += clusters[k]
            count, weight = count + 1, weight + own
            for user in users[k]:
                waiting[user] -= 1
                if waiting[user] == 0:
                    heapq.heappush(heap, rank[user])
        return made
