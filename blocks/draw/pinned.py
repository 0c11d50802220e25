"""A layout in which the places of some nodes are given, and wires around blocks whose places are known.

The given places are kept, and other nodes are put around them. Wires take the cheapest paths on a lattice, net by net.
The lattice has a line every 10 units and one through every port. A path costs its length, its bends, and the wires it
crosses. Two nets never share a piece of a line; only where no other path is left, because blocks stand too close, does
a wire run over another one or through a block.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from heapq import heappop, heappush
from itertools import pairwise

from .graph import Arranged, Graph, Path, Point, simplified
from .layered import layered

__all__ = ["pinned"]

STEP = 10.0
CLEAR = 5.0  # lines of the lattice nearer to a port's line are left out
BEND = 30.0
BRANCH = 12.0
CROSSING = 25.0
MOST = 2_000_000  # points of the lattice
OVERLAP = 3_000.0
THROUGH = 8_000.0
ATTEMPTS = 4  # with other orders, as long as a wire finds no path of its own
ROUNDS = 2  # of rerouting each net
AGAIN = 60  # nets, above which none is rerouted
RIGHT, DOWN, LEFT, UP = range(4)
GAP = 44.0  # between blocks and the terminals beside them
BELOW = 24.0  # between blocks one above the other
BESIDE = 40.0  # between blocks side by side, and as much again as wires may need
GRID = 20.0
RINGS = 60


def pinned(graph: Graph) -> Arranged | None:
    """Keep the nodes with a place, put each other one where the layered layout has it relative to its neighbors.

    None where the places lie too far apart for wires between them.
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
        return Arranged(places, _Maze(graph, places).run())
    except _TooFarApart:
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


class _TooFarApart(Exception):
    """The nodes lie so far apart that the lattice between them would be too large."""


class _Maze:
    """The paths of all nets, for nodes at given places. Raises _TooFarApart."""

    def __init__(self, graph: Graph, centers: Sequence[Point]) -> None:
        self.graph, self.centers = graph, centers
        self.rooms = [
            (x + left, y + top, x + right, y + bottom)
            for node, (x, y) in zip(graph.nodes, centers, strict=True)
            for left, top, right, bottom in node.rooms
        ]
        self._lines()
        size = len(self.xs) * len(self.ys)
        self.wall = (bytearray(size), bytearray(size))  # of the piece to the right, and of the piece below
        for room in self.rooms:
            self._block(room)
        self.owner = ([0] * size, [0] * size)  # of the level line and of the upright line through a point: net + 1
        self.blocked: list[int] = []  # nets that found no path of their own in this round
        self.starts: list[int] = []
        self.ends: list[list[tuple[int, int]]] = []  # points, and the directions in which they are entered
        self._reserve()

    # --- the lattice -------------------------------------------------------------------------------------------

    def _lines(self) -> None:
        margin = STEP * (3 + min(len(self.graph.nets), 15))
        places = list(zip(self.graph.nodes, self.centers, strict=True))
        level = {y + port[1] for node, (_, y) in places for port in (*node.inputs, *node.outputs)}
        upright = {x + node.inputs[node.under][0] for node, (x, _) in places if node.under >= 0}
        self.xs = _lattice([(left - margin, right + margin) for left, _, right, _ in self.rooms], sorted(upright))
        self.ys = _lattice([(top - margin, bottom + margin) for _, top, _, bottom in self.rooms], sorted(level))
        self.wide = len(self.xs)
        if self.wide * len(self.ys) > MOST:
            raise _TooFarApart

    def _block(self, room: tuple[float, float, float, float]) -> None:
        """Forbid all pieces that enter the inside of a room."""
        left, top, right, bottom = room
        first, last = bisect_right(self.xs, left), bisect_left(self.xs, right)  # lines inside
        above, below = bisect_right(self.ys, top), bisect_left(self.ys, bottom)
        for row in range(above, below):
            for column in range(max(first - 1, 0), last):
                self.wall[0][row * self.wide + column] = 1
        for row in range(max(above - 1, 0), below):
            for column in range(first, last):
                self.wall[1][row * self.wide + column] = 1

    def _point(self, node: int, port: Point) -> Point:
        x, y = self.centers[node]
        return x + port[0], y + port[1]

    def _reserve(self) -> None:
        """Where each wire enters the lattice; the level line there is its own."""
        for index, net in enumerate(self.graph.nets):
            node, port = net.source
            x, y = self._point(node, self.graph.nodes[node].outputs[port])
            column = min(bisect_left(self.xs, x + 8), self.wide - 1)
            self.starts.append(self._at(column, y))
            goals = []
            for sink, port in net.sinks:
                x, y = self._point(sink, self.graph.nodes[sink].inputs[port])
                if self.graph.nodes[sink].under == port:
                    row = min(bisect_left(self.ys, y + 14), len(self.ys) - 1)
                    goals.append((row * self.wide + bisect_left(self.xs, x), UP))
                else:
                    goals.append((self._at(max(bisect_right(self.xs, x - 14) - 1, 0), y), RIGHT))
            self.ends.append(goals)
            self._keep(index)

    def _keep(self, index: int) -> None:
        self.owner[0][self.starts[index]] = index + 1
        for point, way in self.ends[index]:
            self.owner[way & 1][point] = index + 1

    def _at(self, column: int, y: float) -> int:
        return bisect_left(self.ys, y) * self.wide + column

    # --- all nets ----------------------------------------------------------------------------------------------

    def run(self) -> tuple[tuple[Path, ...], ...]:
        order = sorted(range(len(self.graph.nets)), key=lambda index: (self._span(index), index))
        ways: dict[int, list[list[int]]] = {}
        for attempt in range(ATTEMPTS):
            for index in ways:
                self._release(index, ways[index])
            ways.clear()
            for turn in range(1 + (ROUNDS if len(order) <= AGAIN else 0)):
                self.blocked = []
                for index in order:
                    if turn:
                        self._release(index, ways[index])
                    ways[index] = self._net(index)
            if not self.blocked or attempt == ATTEMPTS - 1:
                break
            first = set(self.blocked)  # those that found no path come first next time
            order.sort(key=lambda index: index not in first)
        return tuple(self._paths(index, ways[index]) for index in range(len(order)))

    def _span(self, index: int) -> float:
        (x, y), total = self._place(self.starts[index]), 0.0
        for end, _ in self.ends[index]:
            a, b = self._place(end)
            total += abs(a - x) + 2 * abs(b - y) + (1_000.0 if a < x else 0.0)
        return total

    def _place(self, point: int) -> Point:
        return self.xs[point % self.wide], self.ys[point // self.wide]

    def _release(self, index: int, ways: Sequence[Sequence[int]]) -> None:
        for way in ways:
            for point in way:
                for owner in self.owner:
                    if owner[point] == index + 1:
                        owner[point] = 0
        self._keep(index)

    def _net(self, index: int) -> list[list[int]]:
        """The path to each sink as points from the source on; nearer sinks first, later ones branch off."""
        start = self.starts[index]
        x, y = self._place(start)
        goals = self.ends[index]
        before: dict[int, int] = {}  # the tree: from a point to the one before it
        ways: list[list[int]] = [[] for _ in goals]

        def distance(k: int) -> float:
            a, b = self._place(goals[k][0])
            return abs(a - x) + abs(b - y)

        for k in sorted(range(len(goals)), key=lambda k: (distance(k), k)):
            new = self._way(index, start, before, *goals[k])
            for a, b in pairwise(new):
                if b not in before and b != start:
                    before[b] = a
                line = 0 if a // self.wide == b // self.wide else 1
                self.owner[line][a] = self.owner[line][b] = index + 1
            before.setdefault(start, -1)
            way = [goals[k][0]]
            while way[-1] != start:
                way.append(before[way[-1]])
            ways[k] = way[::-1]
        return ways

    def _way(self, index: int, start: int, before: dict[int, int], goal: int, entry: int) -> list[int]:
        """The cheapest path from the net's tree (at first its start) to a goal that is entered in one direction.

        A state is a point and a direction: 4 * point + way.
        """
        if goal in before or goal == start:
            return [goal]
        gx, gy = self._place(goal)
        far, deep = [abs(x - gx) for x in self.xs], [abs(y - gy) for y in self.ys]
        heap: list[tuple[float, int]] = []
        cost: dict[int, float] = {}
        origin: dict[int, int] = {}
        for point in before or (start,):
            row, column = divmod(point, self.wide)
            for way in range(4) if before else (RIGHT,):
                cost[point * 4 + way] = BRANCH if before else 0.0
                heappush(heap, (cost[point * 4 + way] + far[column] + deep[row], point * 4 + way))
        done: set[int] = set()
        while heap:
            _, state = heappop(heap)
            if state in done:
                continue
            done.add(state)
            if state == goal * 4 + entry:
                if cost[state] >= OVERLAP:
                    self.blocked.append(index)
                return _back(state, origin)
            begun = cost[state]
            for other, added in self._moves(index + 1, state):
                value = begun + added
                if value < cost.get(other, 1e30):
                    cost[other] = value
                    origin[other] = state
                    row, column = divmod(other // 4, self.wide)
                    heappush(heap, (value + far[column] + deep[row], other))
        return [start, goal]  # not reached: every state can be left

    def _moves(self, own: int, state: int) -> tuple[tuple[int, float], ...]:
        """The states that follow: a turn on the spot, or a step ahead; each with its cost."""
        point, way = divmod(state, 4)
        line = way & 1
        across = self.owner[1 - line]
        turn = BEND + (OVERLAP if across[point] not in (0, own) else 0.0)
        turns = (point * 4 + (way + 1) % 4, turn), (point * 4 + (way + 3) % 4, turn)
        row, column = divmod(point, self.wide)
        if way == RIGHT and column + 1 < self.wide:
            ahead, added = point + 1, self.xs[column + 1] - self.xs[column]
        elif way == LEFT and column:
            ahead, added = point - 1, self.xs[column] - self.xs[column - 1]
        elif way == DOWN and row + 1 < len(self.ys):
            ahead, added = point + self.wide, self.ys[row + 1] - self.ys[row]
        elif way == UP and row:
            ahead, added = point - self.wide, self.ys[row] - self.ys[row - 1]
        else:
            return turns
        if self.wall[line][min(point, ahead)]:
            added += THROUGH
        along = self.owner[line]
        if along[ahead] not in (0, own) or along[point] not in (0, own):
            added += OVERLAP
        if across[ahead] not in (0, own):
            added += CROSSING
        return *turns, (ahead * 4 + way, added)

    def _paths(self, index: int, ways: Sequence[Sequence[int]]) -> tuple[Path, ...]:
        net = self.graph.nets[index]
        node, port = net.source
        first = self._point(node, self.graph.nodes[node].outputs[port])
        paths = []
        for (sink, port), way in zip(net.sinks, ways, strict=True):
            last = self._point(sink, self.graph.nodes[sink].inputs[port])
            paths.append(simplified([first, *(self._place(point) for point in way), last]))
        return tuple(paths)


def _back(state: int, origin: dict[int, int]) -> list[int]:
    way = [state // 4]
    while state in origin:
        state = origin[state]
        if way[-1] != state // 4:
            way.append(state // 4)
    return way[::-1]


def _lattice(ranges: Sequence[tuple[float, float]], ports: Sequence[float]) -> list[float]:
    """Lines every `STEP` in some ranges, and those through ports instead of the ones close to them."""
    numbers: set[int] = set()
    for low, high in ranges:
        numbers.update(range(int(low // STEP), int(-(-high // STEP)) + 1))
    lines = list(ports)
    for number in numbers:
        line = STEP * number
        near = bisect_left(ports, line - CLEAR)
        if near == len(ports) or ports[near] > line + CLEAR:
            lines.append(line)
    return sorted(lines)
