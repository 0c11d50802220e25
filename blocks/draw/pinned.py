"""A layout in which the places of some nodes are given: these are kept, and other nodes are put around them."""

from __future__ import annotations

from collections.abc import Sequence

from .layered import layered
from .layout_graph import Arranged, Graph, Path, Point
from .maze import Maze, TooFarApart

GAP = 44.0  # between blocks and the terminals beside them
BELOW = 24.0  # between blocks one above the other
BESIDE = 40.0  # between blocks side by side, and as much again as wires may need
GRID = 20.0
RINGS = 60


def pinned(graph: Graph, earlier: Sequence[Sequence[Path]] = ()) -> Arranged | None:
    """Keep the nodes with a place, put each other one where the layered layout has it relative to its neighbors.

    earlier: for each net and sink, a path that is kept where it still can be, or (). None where the places lie too
    far apart for wires between them.
    """
    centers = {index: node.fixed for index, node in enumerate(graph.nodes) if node.fixed is not None}
    rest = [index for index in range(len(graph.nodes)) if index not in centers]
    if any(not graph.nodes[index].rank for index in rest):
        free = layered(graph).centers
        for index in sorted((i for i in rest if not graph.nodes[i].rank), key=lambda i: (free[i], i)):
            centers[index] = _nearest(graph, index, _wanted(graph, index, centers, free), centers)
    for index in rest:
        if graph.nodes[index].rank:
            centers[index] = _terminal(graph, index, centers)
    places = tuple(centers[index] for index in range(len(graph.nodes)))
    try:
        return Arranged(places, Maze(graph, places).run(earlier))
    except TooFarApart:
        return None


def _wanted(graph: Graph, index: int, centers: dict[int, Point], free: tuple[Point, ...]) -> Point:
    """Where a node lies relative to the placed nodes that it is wired to, or to all placed ones."""
    edges = graph.edges()
    beside = [b if a == index else a for a, b in edges if index in (a, b)]
    near = [node for node in beside if node in centers and node != index] or list(centers)
    x = sum(centers[node][0] - free[node][0] for node in near) / len(near) + free[index][0]
    y = sum(centers[node][1] - free[node][1] for node in near) / len(near) + free[index][1]
    return round(x / 10) * 10.0, round(y / 10) * 10.0


def _fits(graph: Graph, index: int, at: Point, centers: dict[int, Point]) -> bool:
    """Whether a node has room at a place; terminals may touch."""
    node = graph.nodes[index]
    apart = 0.0 if node.rank else BELOW
    for other, (x, y) in centers.items():
        shape = graph.nodes[other]
        beside = 0.0 if node.rank else BESIDE + GRID / 2 * min(len(node.inputs) + len(shape.inputs), 12)
        level = at[0] - node.left - beside < x + shape.right and x - shape.left < at[0] + node.right + beside
        if level and at[1] - node.above - apart < y + shape.below and y - shape.above < at[1] + node.below + apart:
            return False
    return True


def _nearest(graph: Graph, index: int, wanted: Point, centers: dict[int, Point]) -> Point:
    """The free place next to the wanted one; below everything where there is none."""
    for ring in range(RINGS):
        steps = [
            (dx, dy) for dx in range(-ring, ring + 1) for dy in range(-ring, ring + 1) if abs(dx) + abs(dy) == ring
        ]
        for dx, dy in sorted(steps, key=lambda step: (abs(step[0]), step)):
            at = (wanted[0] + GRID * dx, wanted[1] + GRID * dy)
            if _fits(graph, index, at, centers):
                return at
    low = max(y + graph.nodes[other].below for other, (_, y) in centers.items())
    return wanted[0], low + graph.nodes[index].above + BELOW


def _terminal(graph: Graph, index: int, centers: dict[int, Point]) -> Point:
    """To the left or the right of all blocks, at the height of the port it is wired to, or the next free one below."""
    node = graph.nodes[index]
    blocks = {other: place for other, place in centers.items() if graph.nodes[other].rank != node.rank} or centers
    if node.rank > 0:
        x = max(place[0] + graph.nodes[other].right for other, place in blocks.items()) + GAP + node.left
    else:
        x = min(place[0] - graph.nodes[other].left for other, place in blocks.items()) - GAP - node.right
    y = min(place[1] for place in centers.values())
    for net in graph.nets:
        source, port = net.source
        for sink, entry in net.sinks:
            if sink == index and source in centers:
                y = centers[source][1] + graph.nodes[source].outputs[port][1]
            elif source == index and sink in centers:
                y = centers[sink][1] + graph.nodes[sink].inputs[entry][1]
    while not _fits(graph, index, (x, y), centers):
        y += GRID / 2
    return x, y
