"""What a layout works on: nodes with ports, nets between ports, and the resulting paths. No names, no pictures."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

Point = tuple[float, float]
Path = tuple[Point, ...]
"""Corners of a wire from its source to one sink; every piece is horizontal or vertical."""
Piece = tuple[float, float, float]
"""(level, low, high): a horizontal piece at y = level, or a vertical one at x = level."""


@dataclass(frozen=True, slots=True)
class GraphNode:
    """A node around its center: what it needs to the left, right, above and below, and its ports.

    rooms: rectangles (left, top, right, bottom) that wires keep out of: its outline, its name, its marks. rank: -1 in
    the first column, 1 in the last, 0 where it fits. fixed: its center, where that is given. under: the input that is
    entered from below (at most one; -1: none).
    """

    left: float
    right: float
    above: float
    below: float
    rooms: tuple[tuple[float, float, float, float], ...]
    inputs: tuple[Point, ...]
    outputs: tuple[Point, ...]
    rank: int = 0
    fixed: Point | None = None
    under: int = -1


@dataclass(frozen=True, slots=True)
class Net:
    """A signal from an output (node, port) to inputs (node, port)."""

    source: tuple[int, int]
    sinks: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Graph:
    nodes: tuple[GraphNode, ...]
    nets: tuple[Net, ...]

    def edges(self) -> list[tuple[int, int]]:
        """(from, to) once for each wire, in order."""
        return [(net.source[0], sink[0]) for net in self.nets for sink in net.sinks]

    def parts(self) -> list[tuple[list[int], Graph, list[int]]]:
        """The components, each as its nodes, the graph of these, and the indices of its nets."""
        groups = self.components()
        home = {node: (group, place) for group, chosen in enumerate(groups) for place, node in enumerate(chosen)}
        kept: list[list[int]] = [[] for _ in groups]
        nets: list[list[Net]] = [[] for _ in groups]
        for index, net in enumerate(self.nets):
            group, place = home[net.source[0]]
            kept[group].append(index)
            nets[group].append(Net((place, net.source[1]), tuple((home[node][1], port) for node, port in net.sinks)))
        graphs = (
            Graph(tuple(self.nodes[node] for node in chosen), tuple(own))
            for chosen, own in zip(groups, nets, strict=True)
        )
        return list(zip(groups, graphs, kept, strict=True))

    def components(self) -> list[list[int]]:
        """Nodes that are joined by nets, in order of their first node."""
        root = list(range(len(self.nodes)))

        def find(node: int) -> int:
            while root[node] != node:
                root[node] = root[root[node]]
                node = root[node]
            return node

        for a, b in self.edges():
            a, b = find(a), find(b)
            root[max(a, b)] = min(a, b)
        groups: dict[int, list[int]] = {}
        for node in range(len(root)):
            groups.setdefault(find(node), []).append(node)
        return list(groups.values())


@dataclass(frozen=True, slots=True)
class Arranged:
    """A layout: the centers of the nodes, and for each net the path to each of its sinks."""

    centers: tuple[Point, ...]
    paths: tuple[tuple[Path, ...], ...]

    def moved(self, dx: float, dy: float) -> Arranged:
        return Arranged(
            tuple((x + dx, y + dy) for x, y in self.centers),
            tuple(tuple(tuple((x + dx, y + dy) for x, y in path) for path in net) for net in self.paths),
        )


def bounds(graph: Graph, arranged: Arranged) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of all nodes and wires; zeros where there is nothing."""
    xs, ys = [], []
    for node, (x, y) in zip(graph.nodes, arranged.centers, strict=True):
        xs += [x - node.left, x + node.right]
        ys += [y - node.above, y + node.below]
    for x, y in (point for paths in arranged.paths for path in paths for point in path):
        xs.append(x)
        ys.append(y)
    return min(xs, default=0.0), min(ys, default=0.0), max(xs, default=0.0), max(ys, default=0.0)


def simplified(points: Iterable[Point]) -> Path:
    """The path without repeated points and without points on a straight piece."""
    corners: list[Point] = []
    for point in points:
        if corners and corners[-1] == point:
            continue
        if len(corners) > 1 and _straight(corners[-2], corners[-1], point):
            corners.pop()
        corners.append(point)
    return tuple(corners)


def _straight(a: Point, b: Point, c: Point) -> bool:
    """Whether the path from b to c continues that from a to b."""
    return (a[0] == b[0] == c[0] and (b[1] - a[1]) * (c[1] - b[1]) > 0) or (
        a[1] == b[1] == c[1] and (b[0] - a[0]) * (c[0] - b[0]) > 0
    )


def merged(pieces: Iterable[Piece]) -> list[Piece]:
    """The pieces, with those that overlap or touch on one level joined."""
    joined: list[Piece] = []
    for level, low, high in sorted(pieces):
        if joined and joined[-1][0] == level and low <= joined[-1][2]:
            joined[-1] = (level, joined[-1][1], max(joined[-1][2], high))
        else:
            joined.append((level, low, high))
    return joined


def pieces(paths: Iterable[Path]) -> tuple[list[Piece], list[Piece]]:
    """The horizontal and the vertical pieces of a net, each place once."""
    flat: list[Piece] = []
    upright: list[Piece] = []
    for path in paths:
        for (x1, y1), (x2, y2) in pairwise(path):
            if y1 == y2:
                flat.append((y1, min(x1, x2), max(x1, x2)))
            else:
                upright.append((x1, min(y1, y2), max(y1, y2)))
    return merged(flat), merged(upright)


def junctions(paths: Sequence[Path]) -> list[Point]:
    """The points where three or four pieces of a net meet."""
    if len(paths) < 2:
        return []
    flat, upright = pieces(paths)
    corners = {point for path in paths for point in path[1:-1]}
    heights = [y for y, _, _ in flat]
    points = []
    for x, top, bottom in upright:
        for y, left, right in flat[bisect_left(heights, top) : bisect_right(heights, bottom)]:
            if left <= x <= right:
                ways = (left < x) + (x < right) + (top < y) + (y < bottom)
                if ways >= 3 and (x, y) in corners:
                    points.append((x, y))
    return points


def crossings(nets: Sequence[Sequence[Path]]) -> int:
    """How often wires of different nets cross."""
    levels = [pieces(paths) for paths in nets]
    count = 0
    for index, (_, upright) in enumerate(levels):
        for other, (flat, _) in enumerate(levels):
            if index != other:
                count += sum(
                    left < x < right and top < y < bottom for x, top, bottom in upright for y, left, right in flat
                )
    return count
