"""The layered layout: columns, orders, heights, tracks, and the paths through them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

from .channels import Trunk, tracks_of
from .graph import Arranged, Graph, Path, Point, crossings, simplified
from .heights import heights_of
from .layers import columns_of
from .order import Columns, Pin, columns_ordered

__all__ = ["layered"]

MARGIN = 16.0  # from a column to the first track
TRACK = 12.0  # from one track to the next
EMPTY = 34.0  # a channel without tracks
BETWEEN = 30.0  # between parts of a diagram that no wire joins
ASPECT = 2.0  # of a drawing with several parts, about
SMALL = 50  # blocks and passing wires, up to which many layouts are tried
MEDIUM = 120  # and up to which some are


def layered(graph: Graph, *, stacked: bool = False) -> Arranged:
    """Place all nodes and wires. The top left is (0, 0).

    Parts that no wire joins are put side by side on shelves, or, if `stacked`, below each other.
    """
    parts = []
    for chosen in graph.components():
        part, nets = graph.part(chosen)
        parts.append((chosen, nets, part, _best(part)))
    sizes = [_extent(part, made) for _, _, part, made in parts]
    area = sum((right - left) * (bottom - top) for left, top, right, bottom in sizes)
    widest = max([right - left for left, _, right, _ in sizes] + [(area * ASPECT) ** 0.5])
    centers: list[Point] = [(0.0, 0.0)] * len(graph.nodes)
    paths: list[tuple[Path, ...]] = [()] * len(graph.nets)
    x = y = tall = 0.0
    for (chosen, nets, _, made), (left, top, right, bottom) in zip(parts, sizes, strict=True):
        if x and (stacked or x + right - left > widest + 1):
            x, y, tall = 0.0, y + tall + BETWEEN, 0.0
        made = made.moved(float(round(x - left)), float(round(y - top)))
        x, tall = x + right - left + BETWEEN, max(tall, bottom - top)
        for node, center in zip(chosen, made.centers, strict=True):
            centers[node] = center
        for net, ways in zip(nets, made.paths, strict=True):
            paths[net] = ways
    return Arranged(tuple(centers), tuple(paths))


def _extent(graph: Graph, made: Arranged) -> tuple[float, float, float, float]:
    xs, ys = [], []
    for node, (x, y) in zip(graph.nodes, made.centers, strict=True):
        xs += [x - node.left, x + node.right]
        ys += [y - node.above, y + node.below]
    for paths in made.paths:
        for path in paths:
            xs += [x for x, _ in path]
            ys += [y for _, y in path]
    return min(xs), min(ys), max(xs), max(ys)


def _best(graph: Graph) -> Arranged:
    """The best of some layouts: feedback below or above, and other orders to begin with."""
    column = columns_of(graph)
    columns = columns_ordered(graph, column, 1.0)
    best = _arranged(columns)
    size = len(graph.nodes) + len(columns.passing)
    if size > MEDIUM or size < 4:
        return best
    least = _cost(graph, best)
    for start in range(1, 12 if size <= SMALL else 4):
        made = _arranged(columns_ordered(graph, column, -1.0 if start % 2 else 1.0, start=start // 2))
        cost = _cost(graph, made)
        if cost < least - 1e-9:
            best, least = made, cost
    return best


def _cost(graph: Graph, made: Arranged) -> float:
    """What makes a drawing hard to read: crossings, bends, length, and room."""
    bends = length = 0.0
    for paths in made.paths:
        for path in paths:
            bends += len(path) - 2
            length += sum(abs(x1 - x2) + abs(y1 - y2) for (x1, y1), (x2, y2) in pairwise(path))
    _, top, _, bottom = _extent(graph, made)
    return 60 * crossings(made.paths) + 15 * bends + 0.3 * length + 0.5 * (bottom - top)


def _arranged(columns: Columns) -> Arranged:
    graph, count = columns.graph, len(columns.graph.nodes)
    height = heights_of(columns)
    trunks: list[dict[int, Trunk]] = []
    tracks = []
    for left, right in zip(columns.left, columns.right, strict=True):
        made, number = tracks_of(_levels(left, height), _levels(right, height))
        trunks.append(made)
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
        made = []
        for sink, port in net.sinks:
            dx, dy = graph.nodes[sink].inputs[port]
            goal = (self.centers[sink][0] + dx, self.centers[sink][1] + dy)
            place = self.columns.column[sink]
            if graph.nodes[sink].under == port:
                y = self.height[self.columns.entries[index, sink]]
                made.append(simplified([*self.below(index, place, start, arrival, y), (goal[0], y), goal]))
                continue
            way = self.turn(place, index, arrival[place], goal[1], leftwards=False, from_left=place >= start)
            made.append(simplified([*way, goal]))
        return tuple(made)
