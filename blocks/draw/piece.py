"""A part with its shape: what is placed, and what the layout has to know of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil, floor, isfinite
from typing import Any

from ..text.json_number import is_number
from .diagram_parts import BEFORE, Part, Parts
from .layout_graph import Arranged, Graph, GraphNode, Net, Point, bounds
from .picture import Kept, Picture
from .shapes import PITCH, Shape, Text, block_shape, named_box
from .text import plain, shown

STUB = 14.0  # room for the arrow head before an input
FARTHEST = 100_000.0  # positions beyond this are ignored
ASIDE = 8.0  # between an input and the end of a wire that was replaced


@dataclass
class Piece:
    """A part with its shape, around its center, and what lies inside of it."""

    part: Part
    kind: str
    shape: Shape
    texts: list[Text] = field(default_factory=list)
    inside: Picture | None = None
    opens: list[tuple[str, float, float]] = field(default_factory=list)


def shape_of(part: Part) -> Shape:
    entry = part.entry
    assert entry is not None
    if part.kind == "diagram":
        title = entry.inner.name if entry.inner is not None else str(entry.diagram).rpartition("/")[2]
        return named_box(title, part.inputs, part.outputs, "diagram")
    if part.kind == "fmu":
        return named_box(entry.fmu.rpartition("/")[2].removesuffix(".fmu"), part.inputs, part.outputs, "fmu")
    defaults = part.ports.defaults

    def value(name: str) -> Any:
        return entry.parameters.get(name, defaults.get(name))

    return block_shape(entry.type, value, part.inputs, part.outputs)


def with_replaced(shape: Shape, part: Part) -> Shape:
    """The shape with a second place at each input whose wire has replaced another."""
    inputs = dict(shape.inputs)
    for name in part.replaced:
        x, y = shape.inputs[name]
        if name == shape.under:  # only one wire enters from below
            x, y = -shape.width / 2 * 0.87, shape.height / 4
        else:
            y += ASIDE
        inputs[BEFORE + name] = x, y
    return replace(shape, inputs=inputs) if part.replaced else shape


def tip(part: Part) -> str:
    """Name, type and parameters of a block, one per line."""
    entry = part.entry
    if entry is None:
        return ""
    what = entry.type or entry.fmu or (entry.inner.name if entry.inner is not None else str(entry.diagram))
    lines = [f"{part.path[:300]}: {what[:200]}"]
    if isinstance(entry.doc, str) and entry.doc:
        lines.append(entry.doc[:300])
    lines += [f"{key[:100]} = {shown(raw)}" for key, raw in list(entry.parameters.items())[:30]]
    return "\n".join(plain(line) for line in lines)


def graph_of(parts: Parts, pieces: Sequence[Piece], kept: Kept) -> Graph:
    """Nodes and nets for the layout. Positions of the file are centers; they hold while no subdiagram is opened."""

    def standing(piece: Piece, fixed: Point | None) -> GraphNode:
        name = "node", piece.kind, piece.part.path
        return kept.take(name, (piece, fixed), lambda: _node(piece, fixed))

    closed = all(piece.inside is None for piece in pieces)
    given: dict[int, Point] = {}
    if closed:
        place = {part.name: index for index, part in reversed(list(enumerate(parts.parts)))}
        for name, raw in parts.diagram.layout.items():
            point = _position(raw)
            if name in place and point is not None:
                given[place[name]] = point
    nodes = [standing(piece, given.get(index)) for index, piece in enumerate(pieces)]
    inputs = [{name: k for k, name in enumerate(piece.shape.inputs)} for piece in pieces]
    outputs = [{name: k for k, name in enumerate(piece.shape.outputs)} for piece in pieces]
    nets = []
    for signal in parts.signals:
        node, port = signal.source
        nets.append(Net((node, outputs[node][port]), tuple((sink, inputs[sink][p]) for sink, p in signal.sinks)))
    return Graph(tuple(nodes), tuple(nets))


def _position(raw: object) -> Point | None:
    if not isinstance(raw, Sequence) or isinstance(raw, str) or len(raw) != 2:
        return None
    if not all(map(is_number, raw)):
        return None
    x, y = float(raw[0]), float(raw[1])
    return (x, y) if isfinite(x) and isfinite(y) and max(abs(x), abs(y)) <= FARTHEST else None


def _node(piece: Piece, fixed: Point | None) -> GraphNode:
    shape = piece.shape
    x, y = shape.width / 2, shape.height / 2
    below = STUB if shape.under else 6.0
    rooms = [(-x - (STUB if shape.inputs else 6.0), -y - 6.0, x + (8.0 if shape.outputs else 6.0), y + below)]
    for text in piece.texts:
        left, top, right, bottom = text.box
        if top < -y or bottom > y or left < -x or right > x:
            rooms.append((left - 5, top - 3, right + 5, bottom + 4))
    lefts, tops, rights, bottoms = zip(*rooms, strict=True)
    rank = {"input": -1, "output": 1}.get(piece.kind, 0)
    return GraphNode(
        left=-min(lefts),
        right=max(rights),
        above=PITCH / 2 if rank else -min(tops),  # terminals side by side fit to ports side by side
        below=PITCH / 2 if rank else max(bottoms),
        rooms=tuple(rooms),
        inputs=tuple(shape.inputs.values()),
        outputs=tuple(shape.outputs.values()),
        rank=rank,
        fixed=fixed,
        under=list(shape.inputs).index(shape.under) if shape.under else -1,
    )


def extent(graph: Graph, arranged: Arranged) -> tuple[float, float, float, float]:
    left, top, right, bottom = bounds(graph, arranged)
    return floor(left) - 4.0, floor(top) - 4.0, ceil(right) + 4.0, ceil(bottom) + 4.0


def reachable(graph: Graph, arranged: Arranged) -> bool:
    """Whether each terminal can be reached from the left (an input) or from the right along a free line of its own."""
    levels: dict[int, list[float]] = {-1: [], 1: []}
    for index, (node, (x, y)) in enumerate(zip(graph.nodes, arranged.centers, strict=True)):
        if not node.rank:
            continue
        if any(abs(y - other) < 12 for other in levels[node.rank]):
            return False
        levels[node.rank].append(y)
        for other, (a, b) in enumerate(arranged.centers):
            beyond = (a - x) * node.rank > 0
            shape = graph.nodes[other]
            if other != index and beyond and b - shape.above < y + 4 and y - 4 < b + shape.below:
                return False
        for paths in arranged.paths:
            for path in paths:
                for (x1, y1), (x2, y2) in pairwise(path):
                    outside = (max(x1, x2) - x) * node.rank > 0 or (min(x1, x2) - x) * node.rank > 0
                    if outside and min(y1, y2) - 5 < y < max(y1, y2) + 5 and (y1 == y2 or (x1 - x) * node.rank > 0):
                        return False
    return True
