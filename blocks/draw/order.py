"""The order of nodes and passing wires in each column, by barycenters of ports and by swaps, for few crossings."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from .layout_graph import Graph

SWEEPS = 10
SWAPPED = 600  # items, above which no swaps are tried


@dataclass(frozen=True, slots=True)
class Pin:
    """Where a net touches a channel: an item of the column beside it, and the height above its center.

    share: from 0 to 1, the place among the ports of its side. main: whether it is the first one.
    """

    item: int
    dy: float
    share: float = 0.5
    main: bool = False


Ends = tuple[list[Pin], list[Pin]]
"""All pins of a net on one side of a channel, and those on the other side."""


@dataclass
class Columns:
    """Nodes and passing wires ("items") by column, and the pins of each net in each channel.

    Item n is the node n; items from len(nodes) on are wires that pass a column, (net, column). Channel c lies to the
    left of column c, the last one to the right of all; `left[c][net]` are its pins on the left side.
    """

    graph: Graph
    column: list[int]
    order: list[list[int]] = field(default_factory=list)
    passing: dict[int, tuple[int, int]] = field(default_factory=dict)
    left: list[dict[int, list[Pin]]] = field(default_factory=list)
    right: list[dict[int, list[Pin]]] = field(default_factory=list)
    feedback: dict[int, int] = field(default_factory=dict)  # passing item -> the node that it turns around
    spans: list[tuple[int, int]] = field(default_factory=list)  # first and last channel of each net
    passed: dict[tuple[int, int], int] = field(default_factory=dict)  # (net, column) -> passing item
    touch: dict[int, tuple[list[Ends], list[Ends]]] = field(default_factory=dict)  # right and left of each item
    under: dict[int, int] = field(default_factory=dict)  # item -> the node that it enters from below
    entries: dict[tuple[int, int], int] = field(default_factory=dict)  # (net, node entered from below) -> item

    def __post_init__(self) -> None:
        graph, count = self.graph, max(self.column, default=-1) + 1
        self.order = [[] for _ in range(count)]
        for node, place in enumerate(self.column):
            self.order[place].append(node)
        self.left = [{} for _ in range(count + 1)]
        self.right = [{} for _ in range(count + 1)]
        for index, net in enumerate(graph.nets):
            self._connect(index, net.source, net.sinks)
        self.touch = {item: ([], []) for items in self.order for item in items}
        for channel in range(count + 1):
            for side, (near, far) in enumerate(((self.left, self.right), (self.right, self.left))):
                for index, pins in near[channel].items():
                    for pin in pins:
                        self.touch[pin.item][side].append((pins, far[channel].get(index, [])))

    def _connect(self, index: int, source: tuple[int, int], sinks: Sequence[tuple[int, int]]) -> None:
        node, port = source
        start = self.column[node] + 1
        ends = [self._entry(sink, port, start) for sink, port in sinks]
        low, high = min(start, *ends), max(start, *ends)
        self.spans.append((low, high))
        ports = self.graph.nodes[node].outputs
        self.left[start].setdefault(index, []).append(Pin(node, ports[port][1], (port + 1) / (len(ports) + 1)))
        for place in range(low, high):
            self.passed[index, place] = self._pass(index, place, left=True, right=True)
        for sink, port in sinks:
            place = self.column[sink]
            if self.graph.nodes[sink].under == port:
                item = self.passed.get((index, place), -1)
                if item < 0 or item in self.under:
                    item = self._pass(index, place, left=place >= start, right=place < start)
                self.under[item] = sink
                self.entries[index, sink] = item
                continue
            ports = self.graph.nodes[sink].inputs
            pin = Pin(sink, ports[port][1], (port + 1) / (len(ports) + 1), port == 0)
            self.right[place].setdefault(index, []).append(pin)
            if low <= place < start and place == low and place < high:
                self.feedback[self.passed[index, place]] = sink
        if low < start:
            self.feedback[self.passed[index, start - 1]] = node

    def _entry(self, sink: int, port: int, start: int) -> int:
        """The channel from which a net that begins in the channel `start` reaches an input."""
        place = self.column[sink]
        return place + 1 if place < start and self.graph.nodes[sink].under == port else place

    def _pass(self, index: int, place: int, *, left: bool, right: bool) -> int:
        """A wire in a column, which reaches the channel on its left, that on its right, or both."""
        item = len(self.graph.nodes) + len(self.passing)
        self.passing[item] = (index, place)
        self.order[place].append(item)
        if left:
            self.right[place].setdefault(index, []).append(Pin(item, 0.0))
        if right:
            self.left[place + 1].setdefault(index, []).append(Pin(item, 0.0))
        return item


def columns_ordered(graph: Graph, column: list[int], side: float, *, start: int = 0) -> Columns:
    """Columns with few crossings.

    side: 1 for feedback below the blocks that it goes around, -1 above. start: 0 begins with the order of the file,
    1 with its reverse, others with one that is neither.
    """
    columns = Columns(graph, column)
    if start:
        # Multiplication by an odd number mixes the items alike in every process.
        keys = {item: -item if start == 1 else item * (2 * start + 1) * 40_503 % 65_536 for item in columns.touch}
        columns.order = [sorted(items, key=lambda item: (keys[item], item)) for items in columns.order]
    best = [list(items) for items in columns.order]
    fewest = _total(columns)
    for sweep in range(SWEEPS):
        _sweep(columns, rightwards=sweep % 2 == 0, side=side)
        if len(columns.passing) + len(graph.nodes) <= SWAPPED:
            _swap(columns)
        count = _total(columns)
        if count < fewest or (sweep == 0 and count == fewest):
            best, fewest = [list(items) for items in columns.order], count
    columns.order = best
    _join_from_below(columns)
    return columns


def _join_from_below(columns: Columns) -> None:
    """Put each wire that enters a node from below right below it."""
    for items in columns.order:
        for item in [item for item in items if item in columns.under]:
            items.remove(item)
            items.insert(items.index(columns.under[item]) + 1, item)


def _sweep(columns: Columns, *, rightwards: bool, side: float) -> None:
    places = range(len(columns.order))
    for place in places if rightwards else reversed(places):
        near, far, channel = (
            (columns.right, columns.left, place) if rightwards else (columns.left, columns.right, place + 1)
        )
        where = {item: float(index) for index, item in enumerate(columns.order[place])}
        beside = place - 1 if rightwards else place + 1
        across = (
            {item: float(index) for index, item in enumerate(columns.order[beside])}
            if 0 <= beside < len(columns.order)
            else {}
        )
        pulls: dict[int, list[float]] = {}
        for net, pins in near[channel].items():
            others = [across[pin.item] + pin.share - 0.5 for pin in far[channel].get(net, ())]
            if others:
                for pin in pins:
                    pulls.setdefault(pin.item, []).extend(value - (pin.share - 0.5) for value in others)
        keys = {item: sum(pulls[item]) / len(pulls[item]) if item in pulls else where[item] for item in where}
        for item, node in columns.feedback.items():
            if item in where and item not in pulls and node in where:
                keys[item] = keys[node] + 0.4 * side
        for item, node in columns.under.items():
            if item in where:
                keys[item] = keys[node] + 1e-6
        columns.order[place] = sorted(columns.order[place], key=lambda item: (keys[item], where[item]))


def _total(columns: Columns) -> int:
    return sum(_channel_crossings(columns, channel) for channel in range(len(columns.left)))


def _channel_crossings(columns: Columns, channel: int) -> int:
    """Crossings in a channel; each net counts as a star, and a turn crosses what leaves between its ends."""
    positions = []
    for column in (channel - 1, channel):
        items = columns.order[column] if 0 <= column < len(columns.order) else []
        positions.append({item: float(index) for index, item in enumerate(items)})
    edges: list[tuple[float, float]] = []
    turns: list[tuple[int, float, float]] = []
    ends: tuple[list[float], list[float]] = ([], [])
    for net in (*columns.left[channel], *(n for n in columns.right[channel] if n not in columns.left[channel])):
        lefts = sorted(positions[0][pin.item] + pin.share for pin in columns.left[channel].get(net, ()))
        rights = sorted(positions[1][pin.item] + pin.share for pin in columns.right[channel].get(net, ()))
        edges += [(lefts[0], value) for value in rights if lefts]
        for index, side in enumerate((lefts, rights)):
            ends[index].extend(side)
            if index == 0 or not lefts:
                turns += [(index, a, b) for a, b in pairwise(side)]
    count = 0
    seen: list[float] = []
    for _, right in sorted(edges):
        count += len(seen) - bisect_right(seen, right)
        insort(seen, right)
    for side in ends:
        side.sort()
    for index, a, b in turns:
        count += bisect_left(ends[index], b) - bisect_right(ends[index], a)
    return count


def _swap(columns: Columns) -> None:
    """Swap neighbors as long as crossings disappear."""
    where = {item: index for items in columns.order for index, item in enumerate(items)}
    for items in columns.order:
        for index in range(len(items) - 1):
            upper, lower = items[index], items[index + 1]
            if _between(columns, lower, upper, where) < _between(columns, upper, lower, where):
                items[index], items[index + 1] = lower, upper
                where[upper], where[lower] = index + 1, index


def _between(columns: Columns, upper: int, lower: int, where: Mapping[int, int]) -> int:
    """The crossings of the wires of two neighbors with each other, if the one is above the other."""
    count = 0
    middle = (where[upper] + where[lower]) / 2
    for a, b in zip(columns.touch[upper], columns.touch[lower], strict=True):
        across_a, _, down = _reach(a, where, middle)
        across_b, up, _ = _reach(b, where, middle)
        count += sum(p > q for p in across_a for q in across_b)
        count += down * len(b) + up * len(a)
    return count


def _reach(ends: Sequence[Ends], where: Mapping[int, int], middle: float) -> tuple[list[float], int, int]:
    """Where the wires of an item end across the channel, and how many turn back to its own side above and below."""
    across: list[float] = []
    up = down = 0
    for beside, far in ends:
        across += [where[pin.item] + pin.share for pin in far]
        for pin in beside:
            if abs(where[pin.item] - middle) > 0.6:
                up += where[pin.item] < middle
                down += where[pin.item] > middle
    return across, up, down
