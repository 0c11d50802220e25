"""From a diagram to its picture, level by level."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil

from ..model.diagram_value import DiagramValue
from ..text.errors import Fault
from .diagram_parts import Net, Part, Parts, Ports, parts_of
from .layered import layered
from .layout_graph import Arranged, Graph, Point, junctions
from .picture import Box, Dot, Kept, Mark, Marks, Open, Picture, Wire
from .piece import Piece, extent, graph_of, reachable, shape_of, tip, with_replaced
from .pinned import pinned
from .shapes import HEADER, Shape, Text, flag_shape, frame_header
from .text import fitted, plain

NAME = 11.0  # size of a block's name
CODE = 10.0  # size of a fault's code
LONGEST_NAME = 150.0
LINE = 9.5  # size of a line that says what changed
LONGEST_LINE = 200.0
FRAME = 16.0  # between the border of an opened subdiagram and its inside
FRAME_TOP = 26.0
DEEPEST = 30


def picture(
    diagram: DiagramValue,
    ports: Callable[[str], Ports],
    *,
    depth: int = 1,
    faults: Sequence[Fault] = (),
    rates: Mapping[str, str] | None = None,
    marks: Marks | None = None,
    earlier: Picture | None = None,
) -> Picture:
    """The picture of a diagram; see `svg`. marks: of one that holds two diagrams.

    earlier: the picture before an edit of a diagram with positions: wires near which nothing changed run as in it. That
    takes a fraction of the time, but what comes out hangs on what came before, so that it is to be drawn without this
    when there is time.
    """
    located, elsewhere = _located(diagram, faults, min(depth, DEEPEST))
    drawer = _Drawer(ports, located, dict(rates or {}), marks, earlier)
    drawing = drawer.level(diagram, "", min(depth, DEEPEST))
    return replace(drawing, elsewhere=elsewhere, marks=marks, kept=drawer.kept)


# --- faults ----------------------------------------------------------------------------------------------------


def _located(
    diagram: DiagramValue, faults: Sequence[Fault], depth: int
) -> tuple[dict[str, list[Fault]], tuple[Fault, ...]]:
    """Faults by the path of the box that shows them, and those that no box does."""
    located: dict[str, list[Fault]] = {}
    elsewhere = []
    for fault in faults:
        path = _spot(diagram, fault.place.split("."), depth)
        steps = fault.path[1] if len(fault.path) > 1 and fault.path[0] in ("blocks", "wires") else ""
        path = path or _spot(diagram, str(steps).split("."), depth)
        if path:
            located.setdefault(path, []).append(fault)
        else:
            elsewhere.append(fault)
    return located, tuple(elsewhere)


def _spot(diagram: DiagramValue, steps: Sequence[str], depth: int) -> str:
    """The path of the innermost block that is drawn and that the steps lead to."""
    path: list[str] = []
    for step in steps:
        entry = diagram.blocks.get(step)
        if entry is None or len(path) >= depth:
            break
        path.append(step)
        if entry.inner is None:
            break
        diagram = entry.inner
    return ".".join(path)


# --- levels ----------------------------------------------------------------------------------------------------


class _Drawer:
    """Draws a level and, within its frames, the levels below."""

    def __init__(
        self,
        ports: Callable[[str], Ports],
        faults: Mapping[str, list[Fault]],
        rates: Mapping[str, str],
        marks: Marks | None,
        earlier: Picture | None,
    ) -> None:
        self.ports, self.faults, self.rates, self.compared = ports, faults, rates, marks
        self.earlier, self.kept = (earlier.routes, earlier.kept) if earlier else ({}, Kept())

    def level(self, diagram: DiagramValue, prefix: str, depth: int, *, stacked: bool = False) -> Picture:
        """One diagram with all that lies in it. stacked: its terminals must be free to the left and to the right."""
        replaced = self.compared.replaced.get(prefix, ()) if self.compared else ()
        parts = parts_of(diagram, self.ports, prefix, replaced)
        pieces = [self.piece_of(part, depth) for part in parts.parts]
        graph = graph_of(parts, pieces, self.kept)
        arranged = None
        if any(node.fixed for node in graph.nodes):
            known = [[self.earlier.get(ends, ()) for ends in _ends(parts, signal)] for signal in parts.signals]
            arranged = pinned(graph, known if self.earlier else ())
            if arranged is not None and stacked and not reachable(graph, arranged):
                arranged = None
        if arranged is None:
            return self.placed(parts, pieces, graph, layered(graph, stacked=stacked))
        left, top, _, _ = extent(graph, arranged)
        nets = zip(parts.signals, arranged.paths, strict=True)
        routes = {ends: path for net, paths in nets for ends, path in zip(_ends(parts, net), paths, strict=True)}
        return replace(self.placed(parts, pieces, graph, arranged), origin=(-left, -top), routes=routes)

    def placed(self, parts: Parts, pieces: Sequence[Piece], graph: Graph, arranged: Arranged) -> Picture:
        left, top, right, bottom = extent(graph, arranged)
        arranged = arranged.moved(-left, -top)
        boxes: list[Box] = []
        wires: list[Wire] = []
        dots: list[Dot] = []
        opens: list[Open] = []
        for piece, (x, y) in zip(pieces, arranged.centers, strict=True):
            part, path = piece.part, piece.part.path
            rate, mark = self.rates.get(path, ""), self.mark(part)
            make = partial(self.box, piece, rate, mark, x, y)
            boxes.append(self.kept.take(("box", piece.kind, path), (piece, rate, mark, x, y), make))
            opens += [Open(path, port, x + dx, y + dy) for port, dx, dy in piece.opens]
            if piece.inside is not None:
                inner = piece.inside.moved(x - piece.shape.width / 2 + FRAME, y - piece.shape.height / 2 + FRAME_TOP)
                boxes += inner.boxes
                wires += inner.wires
                dots += inner.dots
                opens += inner.opens
        for signal, paths in zip(parts.signals, arranged.paths, strict=True):
            rate = self.rate(parts, signal)
            for (source, sink), points in zip(_ends(parts, signal), paths, strict=True):
                mark = self.compared.wires.get(sink) if self.compared else None
                wires.append(Wire(signal.name, source, sink, points, signal.wide, rate, mark))
            dots += [Dot(signal.name, x, y, rate) for x, y in junctions(paths)]
        width, height = right - left, bottom - top
        return Picture(parts.diagram.name, width, height, tuple(boxes), tuple(wires), tuple(dots), tuple(opens))

    def box(self, piece: Piece, rate: str, mark: Mark | None, x: float, y: float) -> Box:
        part = piece.part
        faults = () if part.entry is None else tuple(self.faults.get(part.path, ()))
        copies = "" if part.entry is None or part.entry.copies is None else str(part.entry.copies).lstrip("=")
        about = tip(part), faults, rate, mark, copies
        return Box(part.path, piece.kind, 0.0, 0.0, piece.shape, tuple(piece.texts), *about).moved(x, y)

    def rate(self, parts: Parts, signal: Net) -> str:
        return self.rates.get(signal.name) or self.rates.get(parts.parts[signal.source[0]].path, "")

    def mark(self, part: Part) -> Mark | None:
        kind = part.kind if part.entry is None else "block"
        return self.compared.boxes.get((part.path, kind)) if self.compared else None

    def piece_of(self, part: Part, depth: int) -> Piece:
        """The piece of the picture before, where the part and its faults are those of before."""
        if self.compared is not None or depth > 1:
            return self.piece(part, depth)
        of = part, self.faults.get(part.path)
        return self.kept.take(("piece", part.kind, part.path), of, lambda: self.piece(part, depth))

    def piece(self, part: Part, depth: int) -> Piece:
        mark = self.mark(part)
        label = mark.label if mark and mark.label else part.name
        if part.entry is None:
            shape = with_replaced(flag_shape(label, is_input=part.kind == "input"), part)
            piece = Piece(part, part.kind, shape, list(shape.texts))
            if part.unwired:
                piece.opens.append(("", -shape.width / 2 - 5, 0.0))
            return piece
        inner = part.entry.inner
        is_open = self.compared is None or part.path in self.compared.opened
        if inner is not None and depth > 1 and inner.blocks and is_open:
            return self.frame(part, inner, depth)
        shape = with_replaced(shape_of(part), part)
        piece = Piece(part, part.kind, shape, list(shape.texts))
        name = fitted(label, NAME, LONGEST_NAME)
        beside, anchor = (7.0, "start") if shape.under else (0.0, "middle")  # of the wire that comes from below
        piece.texts.append(Text(beside, shape.height / 2 + 13, name, NAME, anchor, "name"))
        for index, line in enumerate(mark.lines if mark else ()):
            text = fitted(line, LINE, LONGEST_LINE)
            piece.texts.append(Text(beside, shape.height / 2 + 26 + 12 * index, text, LINE, anchor, "told"))
        self.marks(piece)
        return piece

    def marks(self, piece: Piece) -> None:
        """Unwired inputs, and the codes of faults above the box."""
        shape = piece.shape
        for port, (x, y) in shape.inputs.items():
            if port in piece.part.unwired:
                piece.opens.append((port, x, y + 5) if port == shape.under else (port, x - 5, y))
        codes = list(dict.fromkeys(fault.code for fault in self.faults.get(piece.part.path, ())))
        if codes:
            text = plain(" ".join(codes[:3]) + (f" +{len(codes) - 3}" if len(codes) > 3 else ""))
            warns = all(code.startswith("W") for code in codes)
            style = "warning" if warns else "fault"
            piece.texts.append(Text(-shape.width / 2 + 14, -shape.height / 2 - 6, text, CODE, "start", style))

    def frame(self, part: Part, inner: DiagramValue, depth: int) -> Piece:
        """An opened subdiagram; its ports are those of the flags inside."""
        inside = self.level(inner, part.path + ".", depth - 1, stacked=True)
        mark = self.mark(part)
        title = f"{plain((mark.label if mark and mark.label else part.name)[:100])}: {plain(inner.name[:100])}"
        title += "".join(f"   {line}" for line in (mark.lines if mark else ()))
        # Even sizes keep the ports at whole heights, so that wires through them stay straight.
        width = max(2.0 * ceil(inside.width / 2) + 2 * FRAME, 120.0)
        height = 2.0 * ceil(inside.height / 2) + FRAME_TOP + FRAME
        inputs: dict[str, Point] = {}
        outputs: dict[str, Point] = {}
        for box in inside.boxes:
            name = box.path.removeprefix(part.path + ".")
            x, y = box.x - width / 2 + FRAME, box.y - height / 2 + FRAME_TOP
            if box.kind == "input" and "." not in name:
                inputs[name] = (x - box.shape.width / 2, y)
            elif box.kind == "output" and "." not in name:
                outputs[name] = (x + box.shape.width / 2, y)
        for names, known, edge in ((part.inputs, inputs, -width / 2), (part.outputs, outputs, width / 2)):
            height = _invented(names, known, edge, height)
        shape = Shape(width, height, {n: inputs[n] for n in part.inputs}, {n: outputs[n] for n in part.outputs})
        shape = with_replaced(shape, part)
        header = frame_header(title, width - 20)
        piece = Piece(part, "frame", shape, inside=inside)
        piece.texts.append(Text(-width / 2 + 10, -height / 2 + 16, header, HEADER, "start", "frametitle"))
        self.marks(piece)
        return piece


def _ends(parts: Parts, net: Net) -> list[tuple[tuple[str, str], tuple[str, str]]]:
    """Source and sink of each wire of a net, as (path of the box, port)."""
    index, port = net.source
    return [((parts.parts[index].path, port), (parts.parts[sink].path, entry)) for sink, entry in net.sinks]


def _invented(names: Sequence[str], known: dict[str, Point], edge: float, height: float) -> float:
    """Place ports that the subdiagram lacks at the end of the frame; returns its new height."""
    for name in names:
        if name not in known:
            for other, (x, y) in list(known.items()):
                known[other] = (x, y - 10)
            known[name] = (edge, height / 2 - 10 + 10)
            height += 20
    return height
