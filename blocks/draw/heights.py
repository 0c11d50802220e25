"""Heights for the items of each column: wires straight where possible, nothing closer than it may be.

The sum of |bend| over all wires is lowered column by column. With the other columns held, the best heights of one
column are an isotonic regression in the 1-norm, which merging neighbors into pools solves exactly. At last, groups of
items that straight wires join move so that one more wire is straight.

References: R. E. Barlow et al., Statistical Inference under Order Restrictions, Wiley 1972 (pool adjacent violators).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from itertools import accumulate

from .order import Columns

BETWEEN_NODES = 22.0
BETWEEN_TERMINALS = 0.0
BESIDE_WIRE = 14.0  # a node and a wire that passes it
BETWEEN_WIRES = 12.0
SWEEPS = 14
PASSES = 4
LARGE = 600  # items, above which half of the sweeps and one pass are made
MOST = 60  # items that move at once
SHIFTS = 100  # ways that are tried for each of them
BEND = 40.0  # a bend is as bad as this length

Pull = tuple[float, float]  # wanted height, weight
Link = tuple[int, float, float, bool]
"""(other item, its port's height minus the own port's, weight, whether it lies to the left)."""
Links = Mapping[int, Sequence[Link]]


def heights_of(columns: Columns) -> dict[int, float]:
    """The height of the center of each item."""
    height = {item: 0.0 for items in columns.order for item in items}
    gaps = [_gaps(columns, items) for items in columns.order]
    for items, offsets in zip(columns.order, gaps, strict=True):
        middle = offsets[-1] / 2 if offsets else 0.0
        height |= {item: offset - middle for item, offset in zip(items, offsets, strict=True)}
    links = _links(columns)
    best, least = dict(height), _bends(links, height)
    count = len(columns.order)
    sweeps = SWEEPS if len(height) <= LARGE else SWEEPS // 2
    for sweep in range(sweeps):
        rightwards = sweep % 2 == 0
        both = 7 * sweep >= 4 * sweeps
        for place in range(count) if rightwards else reversed(range(count)):
            items = columns.order[place]
            pulls = [_pulls(links[item], height, None if both else rightwards) for item in items]
            for index, item in enumerate(items):
                pulls[index].append((height[item], 1e-3))
            for item, value in zip(items, _isotonic(pulls, gaps[place]), strict=True):
                height[item] = value
        now = _bends(links, height)
        if now < least - 1e-9:
            best, least = dict(height), now
    best = _straightened(best, links, columns.order, gaps)
    return {item: float(round(value)) for item, value in best.items()}


def _gaps(columns: Columns, items: Sequence[int]) -> list[float]:
    """The least height of each item over the first one."""
    offsets: list[float] = []
    for index, item in enumerate(items):
        if not index:
            offsets.append(0.0)
            continue
        offsets.append(offsets[-1] + _distance(columns, items[index - 1], item))
    return offsets


def _distance(columns: Columns, upper: int, lower: int) -> float:
    nodes = columns.graph.nodes
    below = nodes[upper].below if upper < len(nodes) else 0.0
    above = nodes[lower].above if lower < len(nodes) else 0.0
    passing = (upper >= len(nodes)) + (lower >= len(nodes))
    if not passing and nodes[upper].rank and nodes[lower].rank:
        return below + above + BETWEEN_TERMINALS
    return below + above + (BETWEEN_NODES, BESIDE_WIRE, BETWEEN_WIRES)[passing]


def _links(columns: Columns) -> dict[int, list[Link]]:
    """For each item, the ports it is wired to, and how much a straight wire is worth."""
    count = len(columns.graph.nodes)
    links: dict[int, list[Link]] = {item: [] for items in columns.order for item in items}
    for channel in range(len(columns.left)):
        for net, lefts in columns.left[channel].items():
            back = channel <= columns.column[columns.graph.nets[net].source[0]]
            rights = columns.right[channel].get(net, ())
            for a in lefts:
                for b in rights:
                    passing = (a.item >= count) + (b.item >= count)
                    # A long wire is straight first of all, but feedback makes way for blocks.
                    along = 1.5 if back else 5.0
                    weight = (3.0 if len(rights) == 1 else 1.2, 1.0 if back else 1.5, along)[passing]
                    weight *= 1.3 if b.main else 1.0
                    links[a.item].append((b.item, b.dy - a.dy, weight, False))
                    links[b.item].append((a.item, a.dy - b.dy, weight, True))
    for item, node in columns.feedback.items():
        if columns.under.get(item) == node:
            continue
        links[item].append((node, 0.0, 0.2, True))
        links[item].append((node, 0.0, 0.2, False))
    return links


def _pulls(links: Sequence[Link], height: dict[int, float], leftwards: bool | None) -> list[Pull]:
    """Where the neighbors on the left (or the right, or on both sides) want an item."""
    chosen = [(height[o] + dy, w) for o, dy, w, is_left in links if leftwards is None or is_left == leftwards]
    if not chosen and leftwards is not None:
        chosen = [(height[o] + dy, w * 0.5) for o, dy, w, _ in links]
    return chosen


def _bends(links: dict[int, list[Link]], height: dict[int, float]) -> float:
    """The cost of all bends: each one by itself, and a little by its height."""
    return sum(
        _cost_of(height[other] + dy - height[item], weight)
        for item, ends in links.items()
        for other, dy, weight, _ in ends
    )


def _isotonic(pulls: Sequence[list[Pull]], gaps: Sequence[float]) -> list[float]:
    """Heights as near to their pulls as the gaps allow."""
    pools: list[tuple[float, list[Pull], int]] = []  # value, pulls, number of items
    for own, gap in zip(pulls, gaps, strict=True):
        wanted = sorted((value - gap, weight) for value, weight in own)
        pool = (_median(wanted), wanted, 1)
        while pools and pools[-1][0] > pool[0]:
            _, earlier, count = pools.pop()
            wanted = sorted(earlier + pool[1])
            pool = (_median(wanted), wanted, count + pool[2])
        pools.append(pool)
    values = [value for value, _, count in pools for _ in range(count)]
    return [value + gap for value, gap in zip(values, gaps, strict=True)]


def _median(pulls: Sequence[Pull]) -> float:
    """The lower weighted median of sorted pulls."""
    reached = list(accumulate(weight for _, weight in pulls))
    return pulls[bisect_left(reached, reached[-1] / 2 - 1e-12)][0] if pulls else 0.0


def _cost_of(off: float, weight: float) -> float:
    """The cost of a wire whose ends are at different heights."""
    off = abs(off)
    return weight * ((0.0 if off < 0.5 else BEND) + off)


def _straightened(
    height: dict[int, float], links: Links, order: Sequence[Sequence[int]], gaps: Sequence[Sequence[float]]
) -> dict[int, float]:
    """Better heights that keep the gaps. gaps: the least height of each item over the first one of its column."""
    height = dict(height)
    columns = _Columns(order, gaps)
    groups: dict[int, set[int]] = {}
    for _ in range(PASSES if len(height) <= LARGE else 1):
        moved = False
        for start in height:
            group = _group(start, links, height, groups)
            for chosen in ({start}, group) if len(group) > 1 else (group,):
                if _moved(chosen, height, links, columns, groups):
                    groups.clear()
                    moved = True
        if not moved:
            break
    return height


def _group(start: int, links: Links, height: Mapping[int, float], known: dict[int, set[int]]) -> set[int]:
    """The items that straight wires join to `start`. known: groups computed since the last move."""
    if start in known:
        return known[start]
    group, ready = {start}, [start]
    for item in ready:
        for other, dy, _, _ in links[item]:
            if other not in group and abs(height[other] + dy - height[item]) < 0.5:
                group.add(other)
                ready.append(other)
        if len(group) > MOST:
            break  # it will not move
    known.update(dict.fromkeys(group, group))
    return group


class _Columns:
    """What lies above and below each item, and how near it may come."""

    def __init__(self, order: Sequence[Sequence[int]], gaps: Sequence[Sequence[float]]) -> None:
        self.beside: dict[int, list[tuple[int, float]]] = {item: [] for items in order for item in items}
        for items, gap in zip(order, gaps, strict=True):
            for index in range(1, len(items)):
                least = gap[index] - gap[index - 1]
                self.beside[items[index]].append((items[index - 1], -least))
                self.beside[items[index - 1]].append((items[index], least))


def _moved(
    group: set[int], height: dict[int, float], links: Links, columns: _Columns, groups: dict[int, set[int]]
) -> bool:
    """Move a group, with all that it pushes, to where wires cost less; whether there is such a place."""
    if len(group) > MOST:
        return False
    wanted = [height[o] + dy - height[item] for item in sorted(group) for o, dy, _, _ in links[item] if o not in group]
    best, gain, chosen = 0.0, 1e-6, group
    for shift in dict.fromkeys(wanted[:: 1 + len(wanted) // SHIFTS]):
        if abs(shift) < 1e-9:
            continue
        moving = _with_pushed(group, shift, height, links, columns, groups)
        if moving is None:
            continue
        saved = 0.0
        for item in moving:
            for other, dy, weight, _ in links[item]:
                if other not in moving:
                    off = height[other] + dy - height[item]
                    saved += _cost_of(off, weight) - _cost_of(off - shift, weight)
        if saved > gain:
            best, gain, chosen = shift, saved, moving
    for item in chosen if best else ():
        height[item] += best
    return bool(best)


def _with_pushed(
    group: set[int],
    shift: float,
    height: Mapping[int, float],
    links: Links,
    columns: _Columns,
    groups: dict[int, set[int]],
) -> set[int] | None:
    """A group with all that must move with it; None where that is too much."""
    moving, ready = set(group), sorted(group)
    for item in ready:
        for other, least in columns.beside[item]:
            in_the_way = least * shift > 0 and (height[other] - height[item] - shift - least) * least < -1e-9
            if in_the_way and other not in moving:
                new = _group(other, links, height, groups) - moving
                moving |= new
                ready += sorted(new)
        if len(moving) > MOST:
            return None
    return moving
