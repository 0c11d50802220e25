"""Tracks in the channel between two columns: where each net turns, so that no two nets share a piece.

A net has pins on the left and on the right edge of the channel and one trunk (a vertical piece) that joins them. Two
nets with a pin at one height, one on each edge, may not cover each other: the net of the left pin takes the trunk
further left. Where such constraints form a ring, a net gets two trunks that are joined at a free height.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from itertools import pairwise

NEAR = 7.0
"""Heights nearer than this count as one."""
APART = 8.0
"""Trunks on one track keep this distance."""
MOST = 300  # trunks, above which crossings do not choose the order


@dataclass(eq=False)
class Trunk:
    """A vertical piece of a net. lefts, rights: heights of its horizontal pieces; track: its place from the left.

    then: the second trunk of a net that was split, joined to this one at the height `joint`.
    """

    net: int
    lefts: tuple[float, ...]
    rights: tuple[float, ...]
    track: int = 0
    then: Trunk | None = None
    joint: float = 0.0

    @property
    def top(self) -> float:
        return min(*self.lefts, *self.rights, float("inf"))

    @property
    def bottom(self) -> float:
        return max(*self.lefts, *self.rights, float("-inf"))


Heights = Mapping[int, Sequence[float]]


def tracks_of(lefts: Heights, rights: Heights) -> tuple[dict[int, Trunk], int]:
    """The trunk of each net that is not one straight piece, and the number of tracks."""
    trunks = []
    for net in (*lefts, *(net for net in rights if net not in lefts)):
        trunk = Trunk(net, tuple(lefts.get(net, ())), tuple(rights.get(net, ())))
        if trunk.top < trunk.bottom:
            trunks.append(trunk)
    taken = sorted({y for side in (lefts, rights) for heights in side.values() for y in heights})
    by_net = {trunk.net: trunk for trunk in trunks}
    order = _ordered(*_without_rings(trunks, taken))
    return by_net, _assign(order)


def _precedences(trunks: Sequence[Trunk]) -> list[list[int]]:
    """For each trunk, those that must lie to the right of it."""
    by_height: dict[int, list[tuple[float, int]]] = {}
    for index, trunk in enumerate(trunks):
        for y in trunk.rights:
            by_height.setdefault(int(y // NEAR), []).append((y, index))
    place = {trunk: index for index, trunk in enumerate(trunks)}
    after: list[list[int]] = []
    for index, trunk in enumerate(trunks):
        successors = {
            other: None
            for y in trunk.lefts
            for cell in range(int(y // NEAR) - 1, int(y // NEAR) + 2)
            for height, other in by_height.get(cell, ())
            if other != index and abs(height - y) < NEAR
        }
        if trunk.then is not None:
            successors[place[trunk.then]] = None
        after.append([other for other in successors if trunks[other].then is not trunk])
    return after


def _waiting(after: Sequence[Sequence[int]]) -> list[int]:
    """How many must lie to the left of each trunk."""
    waiting = [0] * len(after)
    for others in after:
        for other in others:
            waiting[other] += 1
    return waiting


def _in_rings(after: Sequence[Sequence[int]]) -> list[int]:
    """The trunks in rings, and those that follow them: what repeated removal of first trunks leaves."""
    waiting = _waiting(after)
    ready = [index for index, count in enumerate(waiting) if not count]
    for index in ready:
        for other in after[index]:
            waiting[other] -= 1
            if not waiting[other]:
                ready.append(other)
    return sorted(set(range(len(after))) - set(ready))


def _without_rings(trunks: list[Trunk], taken: list[float]) -> tuple[list[Trunk], list[list[int]]]:
    """Split trunks until the precedences have no ring."""
    trunks = list(trunks)
    while True:
        after = _precedences(trunks)
        rest = _in_rings(after)
        if not rest:
            return trunks, after
        inside = set(rest)
        whole = [i for i in rest if trunks[i].then is None and trunks[i].lefts and trunks[i].rights]
        index = max(whole, key=lambda i: (sum(other in inside for other in after[i]), -i))
        trunk = trunks[index]
        trunk.joint = _free(taken, (trunk.top + trunk.bottom) / 2)
        second = Trunk(trunk.net, (trunk.joint,), trunk.rights)
        trunk.rights, trunk.then = (trunk.joint,), second
        trunks.append(second)


def _free(taken: list[float], wanted: float) -> float:
    """A free height near the wanted one; it is added to those that are taken."""
    height = taken[-1] + 12.0
    for low, high in pairwise(taken):
        middle = float(round((low + high) / 2))
        if high - low > 12.0 and abs(middle - wanted) < abs(height - wanted):
            height = middle
    taken.append(height)
    taken.sort()
    return height


def _crossed(a: Trunk, b: Trunk) -> int:
    """How often a and b cross with a on the left."""
    over = sum(b.top < y < b.bottom for y in a.rights)
    return over + sum(a.top < y < a.bottom for y in b.lefts)


def _ordered(trunks: list[Trunk], after: list[list[int]]) -> list[Trunk]:
    """The trunks from left to right, as the precedences demand, and with few crossings."""
    count = len(trunks)
    gain: list[list[int]] = []
    if count <= MOST:
        gain = [[0] * count for _ in range(count)]
        for i in range(count):
            for j in range(i + 1, count):
                gain[i][j] = _crossed(trunks[i], trunks[j]) - _crossed(trunks[j], trunks[i])
                gain[j][i] = -gain[i][j]
    score = [sum(row) for row in gain] or [0] * count
    waiting = _waiting(after)
    ready = [(score[index], index) for index in range(count) if not waiting[index]]
    heapify(ready)
    ordered = []
    while ready:
        _, index = heappop(ready)
        ordered.append(trunks[index])
        for other, row in enumerate(gain):
            score[other] -= row[index]
        for other in after[index]:
            waiting[other] -= 1
            if not waiting[other]:
                heappush(ready, (score[other], other))
        if gain:
            ready = [(score[other], other) for _, other in ready]
            heapify(ready)
    return ordered


def _assign(ordered: Sequence[Trunk]) -> int:
    """Give each trunk the leftmost track that its predecessors leave; the number of tracks."""
    count = 0
    spans = [(trunk.top, trunk.bottom, trunk) for trunk in ordered]
    for index, (top, bottom, trunk) in enumerate(spans):
        top, bottom, trunk.track = top - APART, bottom + APART, 0
        for above, below, other in spans[:index]:
            if (above < bottom and top < below) or other.then is trunk:
                trunk.track = max(trunk.track, other.track + 1)
        count = max(count, trunk.track + 1)
    return count
