"""The layered layout: columns, orders, heights, tracks, and the paths through them.

Feedback is found by depth-first search in file order, then signals flow to the right, column by column.

References: K. Sugiyama, S. Tagawa, M. Toda, Methods for visual understanding of hierarchical system structures,
IEEE Trans. SMC 11 (1981).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from .channels import Trunk, tracks_of
from .heights import heights_of
from .layout_graph import Arranged, Graph, Path, Point, bounds, crossings, simplified
from .order import Columns, Pin, columns_ordered

MARGIN = 16.0  # from a column to the first track
TRACK = 12.0  # from one track to the next
EMPTY = 34.0  # a channel without tracks
BETWEEN = 30.0  # between parts of a diagram that no wire joins
ASPECT = 2.0  # of a drawing with several parts, about
SMALL = 50  # blocks and passing wires, up to which many layouts are tried
MEDIUM = 120  # and up to which some are
LARGE = 200  # blocks of a whole diagram, above which each part of it is laid out once
SWEEPS = 12  # in which nodes move to other columns


def layered(graph: Graph, *, stacked: bool = False) -> Arranged:
    """Place all nodes and wires. The top left is (0, 0).

    Parts that no wire joins are put side by side on shelves, or, if `stacked`, below each other.
    """
    parts = []
    known: dict[Graph, Arranged] = {}  # parts alike are arranged once; what keeps wires away does not matter here
    for chosen, part, nets in graph.parts():
        bare = Graph(tuple(replace(node, rooms=(), fixed=None) for node in part.nodes), part.nets)
        if bare not in known:
            known[bare] = _best(bare, few=len(graph.nodes) > LARGE)
        parts.append((chosen, nets, part, known[bare]))
    sizes = [bounds(part, arranged) for _, _, part, arranged in parts]
    area = sum((right - left) * (bottom - top) for left, top, right, bottom in sizes)
    widest = max([right - left for left, _, right, _ in sizes] + [(area * ASPECT) ** 0.5])
    centers: list[Point] = [(0.0, 0.0)] * len(graph.nodes)
    paths: list[tuple[Path, ...]] = [()] * len(graph.nets)
    x = y = tall = 0.0
    for (chosen, nets, _, arranged), (left, top, right, bottom) in zip(parts, sizes, strict=True):
        if x and (stacked or x + right - left > widest + 1):
            x, y, tall = 0.0, y + tall + BETWEEN, 0.0
        arranged = arranged.moved(float(round(x - left)), float(round(y - top)))
        x, tall = x + right - left + BETWEEN, max(tall, bottom - top)
        for node, center in zip(chosen, arranged.centers, strict=True):
            centers[node] = center
        for net, ways in zip(nets, arranged.paths, strict=True):
            paths[net] = ways
    return Arranged(tuple(centers), tuple(paths))


def _best(graph: Graph, *, few: bool) -> Arranged:
    """The best of some layouts, unless few are wanted: feedback below or above, and other orders to begin with."""
    column = _columns_of(graph)
    columns = columns_ordered(graph, column, 1.0)
    best = _arranged(columns)
    size = len(graph.nodes) + len(columns.passing)
    if few or size > MEDIUM or size < 4:
        return best
    least = _cost(graph, best)
    for start in range(1, 12 if size <= SMALL else 4):
        candidate = _arranged(columns_ordered(graph, column, -1.0 if start % 2 else 1.0, start=start // 2))
        cost = _cost(graph, candidate)
        if cost < least - 1e-9:
            best, least = candidate, cost
    return best


def _cost(graph: Graph, arranged: Arranged) -> float:
    """What makes a drawing hard to read: crossings, bends, length, and room."""
    bends = length = 0.0
    for paths in arranged.paths:
        for path in paths:
            bends += len(path) - 2
            length += sum(abs(x1 - x2) + abs(y1 - y2) for (x1, y1), (x2, y2) in pairwise(path))
    _, top, _, bottom = bounds(graph, arranged)
    return 60 * crossings(arranged.paths) + 15 * bends + 0.3 * length + 0.5 * (bottom - top)


def _arranged(columns: Columns) -> Arranged:
    graph, count = columns.graph, len(columns.graph.nodes)
    height = heights_of(columns)
    trunks: list[dict[int, Trunk]] = []
    tracks = []
    for left, right in zip(columns.left, columns.right, strict=True):
        channel_trunks, number = tracks_of(_levels(left, height), _levels(right, height))
        trunks.append(channel_trunks)
        tracks.append(number)
    x = 0.0
    starts, across = [], []  # of the channels; of the columns
    for place in range(len(columns.order) + 1):
        outer = place in (0, len(columns.order))
        starts.append(x)
        x += 0.0 if outer and not tracks[place] else max(EMPTY, 2 * MARGIN + TRACK * (tracks[place] - 1))
        if place == len(columns.order):
            break
        nodes = [graph.nodes[item] for item in columns.order[place] if item < count]
        lefts, rights = max((n.left for n in nodes), default=0.0), max((n.right for n in nodes), default=0.0)
        across.append((x, lefts, rights))
        x += lefts + rights
    centers = []
    for node, place in zip(graph.nodes, columns.column, strict=True):
        at, lefts, rights = across[place]
        centers.append({-1: at + lefts + rights - node.right, 0: at + lefts, 1: at + node.left}[node.rank])
    where = [(float(round(cx)), height[index]) for index, cx in enumerate(centers)]
    router = _Router(columns, height, where, trunks, starts, tracks, x)
    return Arranged(tuple(where), tuple(router.paths(net) for net in range(len(graph.nets))))


def _levels(side: Mapping[int, Sequence[Pin]], height: Mapping[int, float]) -> dict[int, list[float]]:
    """The heights of the pins of each net."""
    return {net: [height[pin.item] + pin.dy for pin in pins] for net, pins in side.items()}


class _Router:
    """Follows each net through its channels, from the source outwards."""

    def __init__(
        self,
        columns: Columns,
        height: dict[int, float],
        centers: list[Point],
        trunks: list[dict[int, Trunk]],
        starts: list[float],
        tracks: list[int],
        end: float,
    ) -> None:
        self.columns, self.height, self.centers, self.trunks, self.starts = columns, height, centers, trunks, starts
        widths = [b - a for a, b in zip(starts, [*starts[1:], end], strict=True)]
        self.first = []
        for place, (start, count) in enumerate(zip(starts, tracks, strict=True)):
            room = widths[place] if place == len(starts) - 1 else self._room(place)
            self.first.append(round(start + max(0.0, room - TRACK * (count - 1)) / 2))
        self.passed = columns.passed

    def _room(self, place: int) -> float:
        """The width of a channel that has a column on its right."""
        items = [i for i in self.columns.order[place] if i < len(self.centers)]
        nodes = self.columns.graph.nodes
        return min((self.centers[i][0] - nodes[i].left for i in items), default=0.0) - self.starts[place]

    def x_of(self, place: int, trunk: Trunk) -> float:
        return float(self.first[place] + TRACK * trunk.track)

    def turn(
        self, place: int, net: int, way: list[Point], y: float, *, leftwards: bool, from_left: bool
    ) -> list[Point]:
        """The way through a channel to the height y on one of its sides."""
        trunk = self.trunks[place].get(net)
        if trunk is None:
            return way
        before = way[-1][1]
        parts = [trunk] if trunk.then is None else [trunk, trunk.then]
        begin, finish = (parts[0] if from_left else parts[-1]), (parts[0] if leftwards else parts[-1])
        x1, x2 = self.x_of(place, begin), self.x_of(place, finish)
        middle = [] if begin is finish else [(x1, trunk.joint), (x2, trunk.joint)]
        return [*way, (x1, before), *middle, (x2, y)]

    def level(self, index: int, place: int) -> float:
        """The height at which a net passes a column."""
        return self.height[self.passed[index, place]]

    def below(self, index: int, place: int, start: int, arrival: dict[int, list[Point]], y: float) -> list[Point]:
        """The way to a column in which the net turns up into a node."""
        if place >= start:
            return self.turn(place, index, arrival[place], y, leftwards=False, from_left=True)
        return self.turn(place + 1, index, arrival[place + 1], y, leftwards=True, from_left=place + 1 == start)

    def paths(self, index: int) -> tuple[Path, ...]:
        graph, net = self.columns.graph, self.columns.graph.nets[index]
        node, port = net.source
        dx, dy = graph.nodes[node].outputs[port]
        origin = (self.centers[node][0] + dx, self.centers[node][1] + dy)
        start = self.columns.column[node] + 1
        low, high = self.columns.spans[index]
        arrival: dict[int, list[Point]] = {start: [origin]}  # the way to the edge of each channel
        for place in range(start, high):
            y = self.level(index, place)
            arrival[place + 1] = self.turn(place, index, arrival[place], y, leftwards=False, from_left=True)
        for place in range(start, low, -1):
            y = self.level(index, place - 1)
            arrival[place - 1] = self.turn(place, index, arrival[place], y, leftwards=True, from_left=place == start)
        paths = []
        for sink, port in net.sinks:
            dx, dy = graph.nodes[sink].inputs[port]
            goal = (self.centers[sink][0] + dx, self.centers[sink][1] + dy)
            place = self.columns.column[sink]
            if graph.nodes[sink].under == port:
                y = self.height[self.columns.entries[index, sink]]
                paths.append(simplified([*self.below(index, place, start, arrival, y), (goal[0], y), goal]))
                continue
            way = self.turn(place, index, arrival[place], goal[1], leftwards=False, from_left=place >= start)
            paths.append(simplified([*way, goal]))
        return tuple(paths)


def _columns_of(graph: Graph) -> list[int]:
    """The column of each node, from 0 on."""
    count = len(graph.nodes)
    after, before = _forward(graph)
    column = _longest(after, before)
    last = max(column, default=0)
    ranks = [node.rank for node in graph.nodes]
    for node in range(count):
        if ranks[node] > 0:
            column[node] = last
    _tighten(column, after, before, ranks, last)
    if ranks and min(ranks) < 0:  # a column of its own for the inputs, and one for the outputs
        inner = [column[node] for node in range(count) if not ranks[node]]
        shift = 1 if inner and min(inner) == 0 else 0
        column = [0 if rank < 0 else value + shift for value, rank in zip(column, ranks, strict=True)]
    inner = [column[node] for node in range(count) if ranks[node] <= 0]
    end = max(inner, default=-1) + 1
    column = [end if rank > 0 else value for value, rank in zip(column, ranks, strict=True)]
    used = {value: index for index, value in enumerate(sorted(set(column)))}
    return [used[value] for value in column]


def _forward(graph: Graph) -> tuple[list[list[int]], list[list[int]]]:
    """Successors and predecessors without the edges that close a cycle; an edge counts once for each wire."""
    count = len(graph.nodes)
    targets: list[list[int]] = [[] for _ in range(count)]
    fed = [False] * count
    for a, b in graph.edges():
        targets[a].append(b)
        fed[b] = fed[b] or a != b
    after: list[list[int]] = [[] for _ in range(count)]
    before: list[list[int]] = [[] for _ in range(count)]
    state = [0] * count  # 0 new, 1 open, 2 done
    starts = [n for n in range(count) if graph.nodes[n].rank < 0] + [n for n in range(count) if not fed[n]]
    for start in (*starts, *range(count)):
        if state[start]:
            continue
        state[start] = 1
        stack = [(start, iter(targets[start]))]
        while stack:
            node, rest = stack[-1]
            target = next(rest, -1)
            if target < 0:
                state[node] = 2
                stack.pop()
                continue
            if state[target] != 1:
                after[node].append(target)
                before[target].append(node)
            if not state[target]:
                state[target] = 1
                stack.append((target, iter(targets[target])))
    return after, before


def _longest(after: list[list[int]], before: list[list[int]]) -> list[int]:
    """Each node right behind the last of its predecessors."""
    column = [0] * len(after)
    waiting = [len(nodes) for nodes in before]
    ready = [node for node, left in enumerate(waiting) if not left]
    for node in ready:
        for target in after[node]:
            column[target] = max(column[target], column[node] + 1)
            waiting[target] -= 1
            if not waiting[target]:
                ready.append(target)
    return column


def _tighten(column: list[int], after: list[list[int]], before: list[list[int]], ranks: list[int], last: int) -> None:
    """Move nodes so that wires become shorter: towards the side with more wires, as far as the other side allows."""
    order = sorted(range(len(column)), key=lambda node: -column[node])
    for _ in range(SWEEPS):
        moved = False
        for node in order:
            if ranks[node]:
                continue
            low = max((column[n] + 1 for n in before[node]), default=0)
            high = min((column[n] - 1 for n in after[node]), default=last)
            pull = len(after[node]) - len(before[node])
            best = high if pull > 0 and after[node] else low if pull < 0 else column[node]
            if best != column[node] and low <= best <= high:
                column[node], moved = best, True
        if not moved:
            return
