"""Last touches to the heights: groups of items that are joined by straight wires move so that one more is straight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

__all__ = ["Link", "cost_of", "straightened"]

Link = tuple[int, float, float, bool]
"""(other item, its port's height minus the own port's, weight, whether it lies to the left)."""
Links = Mapping[int, Sequence[Link]]
PASSES = 4
MOST = 60  # items that move at once
BEND = 40.0  # a bend is as bad as this length


def cost_of(off: float, weight: float) -> float:
    """What a wire costs whose ends are at different heights."""
    off = abs(off)
    return weight * ((0.0 if off < 0.5 else BEND) + off)


def straightened(
    height: dict[int, float], links: Links, order: Sequence[Sequence[int]], gaps: Sequence[Sequence[float]]
) -> dict[int, float]:
    """Better heights that keep the gaps. gaps: the least height of each item over the first one of its column."""
    height = dict(height)
    columns = _Columns(order, gaps)
    groups: dict[int, set[int]] = {}
    for _ in range(PASSES):
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
    """The items that straight wires join to one. known: groups that were found since the last move."""
    if start in known:
        return known[start]
    found, ready = {start}, [start]
    for item in ready:
        for other, dy, _, _ in links[item]:
            if other not in found and abs(height[other] + dy - height[item]) < 0.5:
                found.add(other)
                ready.append(other)
    known.update(dict.fromkeys(found, found))
    return found


class _Columns:
    """What lies above and below each item, and how near it may come."""

    def __init__(self, order: Sequence[Sequence[int]], gaps: Sequence[Sequence[float]]) -> None:
        self.beside: dict[int, list[tuple[int, float]]] = {item: [] for items in order for item in items}
        for items, gap in zip(order, gaps, strict=True):
            for index in range(1, len(items)):
                least = gap[index] - gap[index - 1]
                self.beside[items[index]].append((items[index - 1], -least))
                self.beside[items[index - 1]].append((items[index], least))

    def pushed(self, item: int, shift: float, height: Mapping[int, float]) -> Iterator[int]:
        """The neighbors that are in the way when an item moves by a shift."""
        for other, least in self.beside[item]:
            if least * shift > 0 and (height[other] - height[item] - shift - least) * least < -1e-9:
                yield other


def _moved(
    group: set[int], height: dict[int, float], links: Links, columns: _Columns, groups: dict[int, set[int]]
) -> bool:
    """Move a group, with all that it pushes, to where wires cost less; whether there is such a place."""
    wanted = [height[o] + dy - height[item] for item in sorted(group) for o, dy, _, _ in links[item] if o not in group]
    best, gain, chosen = 0.0, 1e-6, group
    for shift in dict.fromkeys(wanted):
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
                    saved += cost_of(off, weight) - cost_of(off - shift, weight)
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
    made, ready = set(group), sorted(group)
    for item in ready:
        for other in columns.pushed(item, shift, height):
            if other not in made:
                new = _group(other, links, height, groups) - made
                made |= new
                ready += sorted(new)
        if len(made) > MOST:
            return None
    return made
