"""Which of the blocks that are gone stand there under another name.

Nodes are blocks and inputs of one level; edges are its wires. A node that both levels have by name is an anchor. The
others are colored by their content, and then by the colors at the other ends of their wires until nothing new is told
apart (color refinement: Weisfeiler and Leman 1968). One node of a color on either side is a rename. Of several, which
no wire tells apart, the first two by name are taken as a pair, and the coloring goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = ["Edge", "renames"]

MOST_WORK = 1_500_000
"""Ends of wires that are looked at; what is not paired by then counts as removed and added."""
MOST_PAIRS = 10_000

Edge = tuple[str, str, str, str]
"""A wire: node and port of its source, node and port of its sink."""


@dataclass
class _Side:
    """The nodes to be paired of one diagram, with their edges as (direction, own port, other node, other port)."""

    colors: dict[str, str]
    edges: dict[str, list[tuple[str, str, str, str]]]

    @classmethod
    def of(cls, content: Mapping[str, str], wires: Sequence[Edge]) -> _Side:
        edges: dict[str, list[tuple[str, str, str, str]]] = {name: [] for name in content}
        for source, out, sink, into in wires:
            if source in edges:
                edges[source].append(("to", out, sink, into))
            if sink in edges:
                edges[sink].append(("from", into, source, out))
        return cls(dict(content), edges)

    def signature(self, name: str) -> tuple[str, tuple[tuple[str, str, str, str], ...]]:
        around = ((way, own, self.colors.get(other, "=" + other), port) for way, own, other, port in self.edges[name])
        return self.colors[name], tuple(sorted(around))


def renames(
    gone: Mapping[str, str], come: Mapping[str, str], wires_a: Sequence[Edge], wires_b: Sequence[Edge]
) -> dict[str, str]:
    """New names by old ones. gone, come: digests of the content of nodes that only A and only B has.

    A node whose content is the same and at least half of whose wires are is renamed as well.
    """
    common = set(gone.values()) & set(come.values())
    sides = (_Side.of(gone, wires_a), _Side.of(come, wires_b))
    if not common:
        return {}
    made: dict[str, str] = {}
    work = MOST_WORK
    while work > 0:
        work = _refine(sides, work)
        pairs = _pairs(sides, made)
        if not pairs:
            break
        for old, new in pairs:
            made[old] = new
            sides[0].colors[old] = sides[1].colors[new] = f"pair {len(made)}"
    _add_similar(made, gone, come, sides)
    return made


def _refine(sides: tuple[_Side, _Side], work: int) -> int:
    """Split colors until none splits any more; what is left of the work."""
    count = 0
    while work > 0:
        names: dict[object, str] = {}
        colored = []
        for side in sides:
            signatures = {name: side.signature(name) for name in side.colors}
            colored.append({name: names.setdefault(made, f"#{len(names)}") for name, made in signatures.items()})
            work -= len(side.colors) + sum(map(len, side.edges.values()))
        for side, colors in zip(sides, colored, strict=True):
            side.colors = colors
        if len(names) == count:
            break
        count = len(names)
    return work


def _pairs(sides: tuple[_Side, _Side], made: Mapping[str, str]) -> list[tuple[str, str]]:
    """All pairs whose color no other node has, else one pair of those with as many nodes on either side."""
    done = set(made), set(made.values())
    classes: dict[str, tuple[list[str], list[str]]] = {}
    for index, side in enumerate(sides):
        for name in sorted(side.colors):
            if name not in done[index]:
                classes.setdefault(side.colors[name], ([], []))[index].append(name)
    even = [(old, new) for old, new in classes.values() if len(old) == len(new)]
    single = [(old[0], new[0]) for old, new in even if len(old) == 1]
    if single or not even:
        return single
    # The same choice whichever of the two diagrams comes first.
    old, new = min(even, key=lambda pair: sorted((pair[0][0], pair[1][0])))
    return [(old[0], new[0])]


def _add_similar(
    made: dict[str, str], gone: Mapping[str, str], come: Mapping[str, str], sides: tuple[_Side, _Side]
) -> None:
    """Pair nodes of the same content of whose wires at least half are the same, the most alike first."""
    while True:
        old = [name for name in gone if name not in made]
        taken = set(made.values())
        by_content: dict[str, list[str]] = {}
        for name in come:
            if name not in taken:
                by_content.setdefault(come[name], []).append(name)
        if sum(len(by_content.get(gone[name], ())) for name in old) > MOST_PAIRS:
            return
        found = []
        for name in old:
            mine = {(way, own, made.get(other, other), port) for way, own, other, port in sides[0].edges[name]}
            for candidate in by_content.get(gone[name], ()):
                theirs = set(sides[1].edges[candidate])
                alike = len(mine & theirs)
                if alike and 2 * alike >= max(len(mine), len(theirs)):
                    first, second = sorted((name, candidate))
                    found.append((-alike, first, second, name, candidate))
        if not found:
            return
        *_, name, candidate = min(found)
        made[name] = candidate
