"""Wires around blocks whose places are known: the cheapest paths on a lattice, net by net.

The lattice has a line every 10 units and one through every port. A path costs its length, its bends, and the wires it
crosses. Two nets never share a piece of a line; only where no other path is left, because blocks stand too close, does
a wire run over another one or through a block.

References: I. Pohl, Heuristic search viewed as path finding in a graph, Artificial Intelligence 1 (1970), weights what
lies ahead; M. Wybrow, K. Marriott, P. Stuckey, Orthogonal connector routing, Graph Drawing 2009, counts bends ahead.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import cache
from heapq import heapify, heappop, heappush
from itertools import pairwise

from .layout_graph import Graph, Path, Point, simplified

STEP = 10.0
CLEAR = 5.0  # lines of the lattice nearer to a port's line are left out
BEND = 30.0
BRANCH = 12.0
CROSSING = 25.0
MOST = 2_000_000  # points of the lattice
OVERLAP = 3_000.0
THROUGH = 8_000.0
SQUEEZED = 60.0  # through a block, where an end lies inside of one: there is no other path to look for
ROOM = 40  # points around an end that lies in no block, at least
ATTEMPTS = 4  # with other orders, as long as a wire finds no path of its own
ROUNDS = 2  # of rerouting each net
AGAIN = 60  # nets, above which only those are rerouted that found no path of their own
REPAIRS = 6  # of these, in turns
HASTE = 1.1  # weight of what lies ahead, above that number of nets: fewer states to look at for a few bends more
MORE_HASTE = 1.2  # after an edit
RIGHT, DOWN, LEFT, UP = range(4)
RIGHTWARDS, DOWNWARDS = (1, 0, -1, 0), (0, 1, 0, -1)


class TooFarApart(Exception):
    """The nodes lie so far apart that the lattice between them would be too large."""


class Maze:
    """The paths of all nets, for nodes at given places. Raises TooFarApart."""

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
        self.blocked: dict[int, set[int]] = {}  # nets that found no path of their own, and those that they ran over
        self.haste = 1.0
        self.shut: dict[int, bool] = {}  # points, and whether they lie inside of blocks
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
            raise TooFarApart
        across = [b - a for a, b in pairwise(self.xs)], [b - a for a, b in pairwise(self.ys)]
        # How far it is to the next line, by direction; 0 from the last one.
        self.steps = [*([*lengths, 0.0] for lengths in across), *([0.0, *lengths] for lengths in across)]

    def _block(self, room: tuple[float, float, float, float]) -> None:
        """Forbid all pieces that enter the inside of a room."""
        left, top, right, bottom = room
        first, last = bisect_right(self.xs, left), bisect_left(self.xs, right)  # lines inside
        above, below = bisect_right(self.ys, top), bisect_left(self.ys, bottom)
        entering = max(first - 1, 0)
        level, upright = b"\1" * (last - entering), b"\1" * (last - first)
        for begin in range(above * self.wide, below * self.wide, self.wide):
            self.wall[0][begin + entering : begin + entering + len(level)] = level
        for begin in range(max(above - 1, 0) * self.wide, below * self.wide, self.wide):
            self.wall[1][begin + first : begin + first + len(upright)] = upright

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

    def run(self, earlier: Sequence[Sequence[Path]] = ()) -> tuple[tuple[Path, ...], ...]:
        """For each net the path to each of its sinks. earlier: paths, or () for none, that
        are kept where they still can be.
        """
        kept = {index: self._kept(index, paths) for index, paths in enumerate(earlier) if all(paths)}
        ways = {index: found for index, found in kept.items() if found}
        rest = [index for index in range(len(self.graph.nets)) if index not in ways]
        rest.sort(key=lambda index: (self._span(index), index))
        if len(self.graph.nets) > AGAIN:
            self.haste = HASTE if not ways else MORE_HASTE
        if ways or len(rest) > AGAIN:
            self._each(rest, ways)
        else:
            self._all(rest, ways)
        return tuple(
            tuple(earlier[index]) if earlier and ways[index] is kept.get(index) else self._paths(index, ways[index])
            for index in range(len(self.graph.nets))
        )

    def _all(self, order: list[int], ways: dict[int, list[list[int]]]) -> None:
        """Route each net some times, and all of them in another order where one found no path of its own."""
        for attempt in range(ATTEMPTS):
            for index in ways:
                self._release(index, ways[index])
            ways.clear()
            for turn in range(1 + ROUNDS):
                self.blocked = {}
                for index in order:
                    if turn:
                        self._release(index, ways[index])
                    ways[index] = self._net(index)
            if not self.blocked or attempt == ATTEMPTS - 1:
                break
            first = set(self.blocked)  # those that found no path come first next time
            order.sort(key=lambda index: index not in first)

    def _each(self, order: Sequence[int], ways: dict[int, list[list[int]]]) -> None:
        """Route each net once, and again those that found no path of their own, before those that they ran over."""
        for index in order:
            ways[index] = self._net(index)
        for _ in range(REPAIRS):
            blocked, self.blocked = self.blocked, {}
            for index, others in blocked.items():
                again = (index, *sorted(others))
                for other in again:
                    self._release(other, ways[other])
                for other in again:
                    ways[other] = self._net(other)

    def _known(self, corner: Point) -> int:
        """The point of the lattice at a place; -1 where there is none."""
        column, row = bisect_left(self.xs, corner[0]), bisect_left(self.ys, corner[1])
        on = column < self.wide and row < len(self.ys) and (self.xs[column], self.ys[row]) == corner
        return row * self.wide + column if on else -1

    def _kept(self, index: int, paths: Sequence[Path]) -> list[list[int]] | None:
        """The points of earlier paths of a net, which are its own now; None where one does not lead as it did."""
        ways, runs = [], []
        for (goal, _), path, (first, last) in zip(self.ends[index], paths, self._tips(index), strict=True):
            way = [self.starts[index]]
            for point in (*(self._known(corner) for corner in path[1:-1]), goal):
                line = 0 if way[-1] // self.wide == point // self.wide else 1
                if point < 0 or (line and way[-1] % self.wide != point % self.wide):
                    return None
                low, high, step = min(way[-1], point), max(way[-1], point), self.wide if line else 1
                runs.append((line, slice(low, high, step), slice(low, high + 1, step)))
                step = step if point > way[-1] else -step
                way += range(way[-1] + step, point + step, step)
            if path != simplified((first, self._place(way[0]), *path[1:-1], self._place(goal), last)):
                return None
            ways.append(way)
        for line, pieces, points in runs:
            if 1 in self.wall[line][pieces] or not {0, index + 1}.issuperset(self.owner[line][points]):
                return None
        for line, pieces, points in runs:
            if self.wall[line][pieces]:
                self.owner[line][points] = [index + 1] * len(self.owner[line][points])
        return ways

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
                others = {self.owner[line][point] - 1 for point in (a, b)} - {-1, index}
                if others or (self.wall[line][min(a, b)] and not self._is_shut(start, goals[k][0])):
                    self.blocked.setdefault(index, set()).update(others)
                self.owner[line][a] = self.owner[line][b] = index + 1
            before.setdefault(start, -1)
            way = [goals[k][0]]
            while way[-1] != start:
                way.append(before[way[-1]])
            ways[k] = way[::-1]
        return ways

    def _way(self, index: int, start: int, before: dict[int, int], goal: int, entry: int) -> list[int]:
        """The cheapest path from the net's tree (at first its start) to a goal that is entered in one direction.

        A state is a point and a direction: 4 * point + way. Where there are many nets, bends and distance that lie
        ahead weigh a little more than their cost, so that fewer states are looked at (weighted A*).
        """
        if goal in before or goal == start:
            return [goal]
        own, wide = index + 1, self.wide
        through = SQUEEZED if self._is_shut(start, goal) else THROUGH
        far, deep, side, height, turns = self._ahead(goal, entry)
        heap: list[tuple[float, int]] = []
        cost: dict[int, float] = {}
        origin: dict[int, int] = {}
        for point in before or (start,):
            row, column = divmod(point, wide)
            for way in range(4) if before else (RIGHT,):
                cost[point * 4 + way] = begun = BRANCH if before else 0.0
                ahead = begun + far[column] + deep[row] + turns[way][side[column] + height[row]]
                heap.append((ahead, point * 4 + way))
        heapify(heap)
        finish = goal * 4 + entry
        done: set[int] = set()
        while heap:
            _, state = heappop(heap)
            if state in done:
                continue
            done.add(state)
            if state == finish:
                return _back(state, origin)
            begun = cost[state]
            point, way = state >> 2, state & 3
            row, column = divmod(point, wide)
            line = way & 1
            along, across = self.owner[line], self.owner[1 - line]
            rest, place = far[column] + deep[row], side[column] + height[row]
            value = begun + (BEND + OVERLAP if across[point] not in (0, own) else BEND)
            for turned in ((way + 1) & 3, (way + 3) & 3):
                other = state - way + turned
                if value < cost.get(other, 1e30):
                    cost[other] = value
                    origin[other] = state
                    heappush(heap, (value + rest + turns[turned][place], other))
            added = self.steps[way][row if line else column]
            if not added:
                continue
            next_, row, column = point + (1, wide, -1, -wide)[way], row + DOWNWARDS[way], column + RIGHTWARDS[way]
            if self.wall[line][point if point < next_ else next_]:
                added += through
            if along[next_] not in (0, own) or along[point] not in (0, own):
                added += OVERLAP
            if across[next_] not in (0, own):
                added += CROSSING
            value, other = begun + added, next_ * 4 + way
            if value < cost.get(other, 1e30):
                cost[other] = value
                origin[other] = state
                heappush(heap, (value + far[column] + deep[row] + turns[way][side[column] + height[row]], other))
        return [start, goal]  # not reached: every state can be left

    def _is_shut(self, *ends: int) -> bool:
        """Whether one of two points lies inside of blocks, so that no path leads out but through them."""
        for point in ends:
            if point not in self.shut:
                self.shut[point] = self._room(point) <= ROOM
        return any(self.shut[point] for point in ends)

    def _room(self, point: int) -> int:
        """How many points can be reached from one without a block in between; no more than some are counted."""
        seen, waiting, wide = {point}, [point], self.wide
        while waiting and len(seen) <= ROOM:
            here = waiting.pop()
            row, column = divmod(here, wide)
            for line, piece, other, is_there in (
                (0, here, here + 1, column + 1 < wide), (0, here - 1, here - 1, column > 0),
                (1, here, here + wide, row + 1 < len(self.ys)), (1, here - wide, here - wide, row > 0),
            ):  # fmt: skip
                if is_there and other not in seen and not self.wall[line][piece]:
                    seen.add(other)
                    waiting.append(other)
        return len(seen)

    def _ahead(self, goal: int, entry: int) -> tuple[list[float], list[float], list[int], list[int], list[list[float]]]:
        """What lies ahead at least: distances by column and by row; and bends by direction, and the place by both."""
        row, column = divmod(goal, self.wide)
        far = [abs(x - self.xs[column]) * self.haste for x in self.xs]
        deep = [abs(y - self.ys[row]) * self.haste for y in self.ys]
        side = [(other >= column) + (other > column) for other in range(self.wide)]
        height = [3 * ((other >= row) + (other > row)) for other in range(len(self.ys))]
        return far, deep, side, height, _turns(entry, self.haste)

    def _tips(self, index: int) -> list[tuple[Point, Point]]:
        """Where each wire of a net begins and ends."""
        (node, port), sinks = self.graph.nets[index].source, self.graph.nets[index].sinks
        first = self._point(node, self.graph.nodes[node].outputs[port])
        return [(first, self._point(sink, self.graph.nodes[sink].inputs[port])) for sink, port in sinks]

    def _paths(self, index: int, ways: Sequence[Sequence[int]]) -> tuple[Path, ...]:
        return tuple(
            simplified([first, *(self._place(point) for point in way), last])
            for (first, last), way in zip(self._tips(index), ways, strict=True)
        )


@cache
def _turns(entry: int, haste: float) -> list[list[float]]:
    """The least cost of bends to a goal that is entered in a direction: by the own direction, and by the place.

    The place is 0, 1 or 2 for points to the left of the goal, in its column or to the right of it, and 3 or 6 more in
    its row or below it. Where there is no haste, bends ahead are not counted.
    """
    made = []
    for way in range(4):
        costs = []
        for place in range(9):
            right, down = 1 - place % 3, 1 - place // 3  # towards the goal
            ahead, aside = (right, down) if entry == RIGHT else (-down, right)  # as if it were entered to the right
            turn = (way - entry) % 4
            if turn == 0:
                bends = 4 if ahead < 0 else 2 if aside else 0
            elif turn == 2:
                bends = 2
            else:
                bends = 3 if ahead < 0 or aside * (2 - turn) < 0 else 1
            costs.append(bends * BEND * haste if haste > 1.0 else 0.0)
        made.append(costs)
    return made


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
