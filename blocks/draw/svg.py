"""SVG of a picture: the same bytes for the same picture, no ids, no scripts, no fonts or files from elsewhere.

A page that shows a drawing finds everything by attributes, which are the same after an edit elsewhere; ids would have
to be unique on the page, which may hold several drawings:

- `data-origin="X Y"` of the svg: where the position [0, 0] of the file's `layout` lies. Without it, the positions in
  the drawing are not those of the file.
- `data-path` of a group: the path of a block or the name of a terminal; its kind is the first class (block, diagram,
  fmu, input, output, frame). `data-at="X Y"`: its center. `data-in`, `data-out`: its ports with their places from the
  center, as "DX DY NAME;DX DY NAME", with %25 and %3B for % and ; in names; the port of a terminal has no name.
- `data-net` of a wire or a dot: its signal, by the output that it leaves ("motor.omega", or an input of the diagram).
  `data-sink` of a wire: the input that it enters ("gain.u", or an output of the diagram).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from ..model.diagram_value import DiagramValue
from ..text.errors import Fault
from .compose import picture
from .diagram_parts import BEFORE, Ports
from .layout_graph import Path, Point
from .picture import Box, Kept, Mark, Marks, Picture, Wire
from .shapes import Pins, Text, num, polygon
from .style import RATES, style_of
from .text import cut, escaped, fitted, plain, width_of

MARGIN = 16.0
TITLE = 15.0
CORNER = 4.0  # radius of a wire's corner
NARROWEST = 220.0
LISTED = 6  # faults that no block shows


def svg(
    diagram: DiagramValue,
    ports: Callable[[str], Ports],
    *,
    depth: int = 1,
    faults: Sequence[Fault] = (),
    rates: Mapping[str, str] | None = None,
    title: str | None = None,
    marks: Marks | None = None,
) -> str:
    """The drawing of a diagram as an SVG document.

    ports: the ports of a block by its path; `ports_of` makes it from a resolver of types. depth: how many levels are
    drawn; 1 shows subdiagrams as boxes, 2 opens those of the first level. faults: shown on their blocks, or listed
    below. rates: labels ("1 ms") by the path of a block, by signal ("control.u") or by input; what has none, or
    "continuous", is drawn plain. title: instead of the diagram's name; "" for none. marks: what changed, where the
    diagram holds two in one.

    Positions of the file's `layout` are the centers of blocks and terminals, in pixels; the rest is laid out around
    them. A level in which subdiagrams are opened is laid out anew: frames need more room than the boxes had.
    """
    drawing = picture(diagram, ports, depth=depth, faults=faults, rates=rates, marks=marks)
    return rendered(drawing, diagram.name if title is None else title)


def rendered(made: Picture, title: str) -> str:
    """The SVG document of a picture."""
    title = cut(title, 120)
    labels = _labels(made)
    top = MARGIN + (TITLE + 12 if title else 0.0)
    notes = _notes(made)
    told = made.marks.notes if made.marks else ()
    width = max(made.width, NARROWEST, min(600.0, width_of(title, TITLE))) + 2 * MARGIN
    legend, legend_height = _legend(made, labels, top + made.height + 18, width)
    height = top + made.height + legend_height + 16 * len((*notes, *told)) + MARGIN
    picture_ = made.moved(MARGIN + max(0.0, (width - 2 * MARGIN - made.width) / 2), top)
    size = f'width="{num(width)}" height="{num(height)}"'
    view = f'viewBox="0 0 {num(width)} {num(height)}" {size}'
    view += f' data-origin="{_at(picture_.origin)}"' if picture_.origin else ""
    name = escaped(title or cut(made.title, 120))
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="blocks-diagram" {view} role="img" aria-label="{name}">',
        f"<style>{style_of(labels, marked=made.marks is not None)}</style>",
        f'<rect class="bg" {size}/>',
    ]
    if title:
        shown = fitted(title, TITLE, width - 2 * MARGIN)
        lines.append(f'<text class="title" x="{num(MARGIN)}" y="{num(MARGIN + TITLE - 2)}">{escaped(shown)}</text>')
    lines += _body(picture_, labels)
    lines += legend
    for index, note in enumerate((*notes, *told)):
        y = top + made.height + legend_height + 16 * index + 12
        style = "note" if index < len(notes) else "told listed"
        note = escaped(fitted(note, 11, width - 2 * MARGIN))
        lines.append(f'<text class="{style}" x="{num(MARGIN)}" y="{num(y)}">{note}</text>')
    return "\n".join([*lines, "</svg>", ""])


def _labels(drawing: Picture) -> dict[str, int]:
    """The sampled rates in order of appearance, each with the number of its pattern."""
    rates = (*(box.rate for box in drawing.boxes), *(wire.rate for wire in drawing.wires))
    sampled = dict.fromkeys(rate for rate in rates if _sampled(rate))
    return {rate: index % len(RATES) for index, rate in enumerate(sampled)}


def _sampled(rate: str) -> bool:
    return rate not in ("", "continuous")


def _notes(drawing: Picture) -> list[str]:
    shown = [plain(str(fault)[:400]) for fault in drawing.elsewhere[:LISTED]]
    more = len(drawing.elsewhere) - LISTED
    return [*shown, f"and {more} more"] if more > 0 else shown


def _body(drawing: Picture, labels: Mapping[str, int]) -> list[str]:
    """Frames, wires, blocks, dots: each covers what came before."""
    kept, wires = drawing.kept, dict[str, _Drawn]()

    def box_of(box: Box) -> list[str]:
        of = box, labels.get(box.rate), _marked(drawing, box.mark)
        return kept.take(("drawn", box.kind, box.path), of, lambda: _box(box, labels, of[2]))

    lines = [line for box in drawing.boxes if box.kind == "frame" for line in box_of(box)]
    dots: dict[str, set[Point]] = {}
    for dot in drawing.dots:
        dots.setdefault(dot.net, set()).add((dot.x, dot.y))
    glyphs = []
    # What stays comes first: a wire that was added or removed begins where it leaves the others of its net.
    for wire in sorted(drawing.wires, key=lambda wire: wire.mark is not None):
        net = wires.setdefault(wire.net, _Drawn())
        lines.append(net.line(wire, dots.get(wire.net, set()), labels, _marked(drawing, wire.mark), kept))
        if wire.mark:
            glyphs.append(_sign(*_spot(net.ink.fresh(wire.points)[0]), wire.mark))
        net.wires.append(wire)
    lines += [line for box in drawing.boxes if box.kind != "frame" for line in box_of(box)]
    dot_styles = _dot_styles(drawing)
    for dot in drawing.dots:
        style = f"dot{_rate(dot.rate, labels)}{dot_styles.get(dot.net, '')}"
        lines.append(f'<circle class="{style}" data-net="{_name(dot.net)}" cx="{num(dot.x)}" cy="{num(dot.y)}" r="3"/>')
    for mark in drawing.opens:
        tip = f"<title>{_name(f'{mark.path}.{mark.port}'.rstrip('.'))} is not wired</title>"
        lines.append(f'<circle class="open" cx="{num(mark.x)}" cy="{num(mark.y)}" r="4">{tip}</circle>')
    return lines + glyphs


def _marked(drawing: Picture, mark: Mark | None) -> str:
    """The class of what stays, was added, removed or changed; nothing where no two diagrams are compared."""
    return "" if drawing.marks is None else f" {mark.kind if mark else 'same'}"


def _dot_styles(drawing: Picture) -> dict[str, str]:
    """The class of the branches of each net: that of its wires, where they are of one kind."""
    kinds: dict[str, set[str]] = {}
    for wire in drawing.wires if drawing.marks is not None else ():
        kinds.setdefault(wire.net, set()).add(wire.mark.kind if wire.mark else "same")
    return {net: f" {min(net_kinds)}" if len(net_kinds) == 1 else " same" for net, net_kinds in kinds.items()}


def _rate(rate: str, labels: Mapping[str, int]) -> str:
    return f" r{labels[rate]}" if rate in labels else ""


def _wire(wire: Wire, earlier: _Ink, dots: set[Point], labels: Mapping[str, int], marked: str = "") -> str:
    """A wire from where it leaves the earlier ones of its net: ink on ink would look bolder."""
    style = "wire" + (" wide" if wire.wide else "") + _rate(wire.rate, labels) + marked
    (px, _), (x, y) = wire.points[-2], wire.points[-1]
    if px == x:  # from below
        head, end = polygon((x, y), (x - 3.5, y + 7), (x + 3.5, y + 7)), (x, y + 4)
    else:
        head, end = polygon((x, y), (x - 7, y - 3.5), (x - 7, y + 3.5)), (x - 4, y)
    points, behind = earlier.fresh((*wire.points[:-1], end))
    # The dashes go on as if the wire began at its source.
    offset = f' stroke-dashoffset="{num(behind)}"' if behind and wire.rate in labels else ""
    title = escaped(plain(wire.mark.tip[:600] if wire.mark else wire.net[:300]))
    line = f'<path class="run" d="{_rounded(points, dots)}"{offset}/>' if len(points) > 1 else ""
    path, port = wire.sink
    sink = f"{path}.{port.removeprefix(BEFORE)}" if port else path
    ends = f'data-net="{_name(wire.net)}" data-sink="{_name(sink)}"'
    return f'<g class="{style}" {ends}><title>{title}</title>{line}<path class="head" d="{head}"/></g>'


def _name(text: str) -> str:
    return escaped(plain(text[:300]))


def _at(point: Point) -> str:
    return f"{num(point[0])} {num(point[1])}"


def _ports(key: str, pins: Pins) -> str:
    """The attribute that lists ports with their places; nothing where there is none."""
    names = {name: name[:300].replace("%", "%25").replace(";", "%3B") for name in pins if not name.startswith(BEFORE)}
    listed = ";".join(_at(pins[name]) + (f" {text}" if text else "") for name, text in names.items())
    return f' {key}="{escaped(plain(listed))}"' if listed else ""


class _Ink:
    """The paths of a net that are drawn already, as a tree from their source."""

    def __init__(self) -> None:
        self.after: dict[Point, _Ink] = {}  # the corners that follow
        self.reach: dict[tuple[bool, bool], float] = {}  # how far ink goes in each direction

    def add(self, points: Path) -> None:
        here = self.after.setdefault(points[0], _Ink())
        for a, b in pairwise(points):
            way = _way(a, b)
            here.reach[way] = max(here.reach.get(way, 0.0), _length(a, b))
            here = here.after.setdefault(b, _Ink())

    def fresh(self, points: Path) -> tuple[Path, float]:
        """The part of a path after the longest prefix that has ink, and the length of that prefix."""
        here, length = self.after.get(points[0]), 0.0
        for index, (a, b) in enumerate(pairwise(points)):
            own = _length(a, b)
            common = min(own, here.reach.get(_way(a, b), 0.0)) if here else 0.0
            length += common
            if common < own:
                return (_toward(a, b, common) if common else a, *points[index + 1 :]), length
            here = here.after.get(b) if here else None
        return points[-1:], length


class _Drawn:
    """The wires of a net that are drawn already, and their ink, which is made when it is asked for."""

    def __init__(self) -> None:
        self.wires: list[Wire] = []
        self._ink, self._inked = _Ink(), 0
        self._last: object = None  # another one where the last line is another one than in the picture before

    @property
    def ink(self) -> _Ink:
        for wire in self.wires[self._inked :]:
            self._ink.add(wire.points)
        self._inked = len(self.wires)
        return self._ink

    def line(self, wire: Wire, dots: set[Point], labels: Mapping[str, int], marked: str, kept: Kept) -> str:
        """The next wire; that of the picture before, where it and those before it are the same."""
        of = wire, self._last, dots, labels.get(wire.rate), marked
        name = "drawn", wire.net, wire.sink
        text, self._last = kept.take(name, of, lambda: (_wire(wire, self.ink, dots, labels, marked), object()))
        return text


def _way(a: Point, b: Point) -> tuple[bool, bool]:
    """One of the four directions."""
    return a[0] == b[0], a < b


def _length(a: Point, b: Point) -> float:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def _rounded(points: Path, sharp: set[Point]) -> str:
    """A path with small round corners, but not where the net branches."""
    parts = [f"M{num(points[0][0])} {num(points[0][1])}"]
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        x, y = here
        room = min(abs(before[0] - x) + abs(before[1] - y), abs(after[0] - x) + abs(after[1] - y)) / 2
        radius = min(CORNER, room)
        if here in sharp or radius < 1:
            parts.append(f"L{num(x)} {num(y)}")
            continue
        (ax, ay), (bx, by) = _toward(here, before, radius), _toward(here, after, radius)
        parts.append(f"L{num(ax)} {num(ay)}Q{num(x)} {num(y)} {num(bx)} {num(by)}")
    parts.append(f"L{num(points[-1][0])} {num(points[-1][1])}")
    return "".join(parts)


def _toward(a: Point, b: Point, distance: float) -> Point:
    length = _length(a, b)
    return a[0] + (b[0] - a[0]) * distance / length, a[1] + (b[1] - a[1]) * distance / length


def _box(box: Box, labels: Mapping[str, int], marked: str = "") -> list[str]:
    """A group with the outline, the marks and the texts of a box."""
    bad = "" if not box.faults else " warned" if all(f.is_warning for f in box.faults) else " faulty"
    style = f"{box.kind}{bad}{_rate(box.rate, labels)}{marked}"
    ports = _ports("data-in", box.shape.inputs) + _ports("data-out", box.shape.outputs)
    lines = [f'<g class="{style}" data-path="{_name(box.path)}" data-at="{_at((box.x, box.y))}"{ports}>']
    changed = [plain(line[:400]) for line in box.mark.tip.split("\n")[:40]] if box.mark else []
    tip = "\n".join([*changed, *(plain(str(fault)[:400]) for fault in box.faults[:20]), box.tip]).strip()
    if tip:
        lines.append(f"<title>{escaped(tip)}</title>")
    lines += _stack(box) if box.copies else []
    if box.kind == "frame":
        left, top, _, _ = box.edges
        size = f'width="{num(box.shape.width)}" height="{num(box.shape.height)}"'
        inner = f'width="{num(box.shape.width - 6)}" height="{num(box.shape.height - 6)}"'
        lines.append(f'<rect class="face" x="{num(left)}" y="{num(top)}" {size} rx="3"/>')
        lines.append(f'<rect class="thin" x="{num(left + 3)}" y="{num(top + 3)}" {inner} rx="2"/>')
    elif box.shape.strokes:
        marks = "".join(f'<path class="{stroke.style}" d="{stroke.d}"/>' for stroke in box.shape.strokes)
        lines.append(f'<g transform="translate({num(box.x)} {num(box.y)})">{marks}</g>')
    lines += [_text(text) for text in box.texts]
    if box.faults:
        lines.append(_glyph(box))
    if box.mark:
        left, top, _, _ = box.edges
        lines.append(_sign(left, top, box.mark))
    return [*lines, "</g>"]


def _stack(box: Box) -> list[str]:
    """The edges of boxes behind a box that stands for copies, and how many there are."""
    left, top, right, bottom = box.edges
    edges = (f"M{num(left + o)} {num(top - o + 3)}v-3H{num(right + o)}V{num(bottom - o)}h-3" for o in (3, 6))
    count = escaped(cut(box.copies, 12))
    at = f'x="{num(right + 4)}" y="{num(top - 10)}" text-anchor="end"'
    return [f'<path class="thin" d="{"".join(edges)}"/>', f'<text class="label" {at}>\u00d7 {count}</text>']


_TILDE = "M-4 .8C-2.8 -2.6 -1.2 -1.9 0 0S2.8 2.6 4 -.8"
_SIGNS = {"added": "M-3.5 0h7M0 -3.5v7", "removed": "M-3.5 0h7", "changed": _TILDE}
_MEANINGS = {"added": "added", "removed": "removed", "changed": "changed, renamed", "same": "unchanged"}


def _sign(x: float, y: float, mark: Mark) -> str:
    """A disk with a plus, a minus or a tilde: what a mark says without its color."""
    disk = f'<circle class="disk" cx="{num(x)}" cy="{num(y)}" r="6.5"/>'
    sign = f'<path class="stroke" transform="translate({num(x)} {num(y)})" d="{_SIGNS[mark.kind]}"/>'
    title = f"<title>{escaped(plain(mark.tip[:600]))}</title>" if mark.tip else ""
    return f'<g class="sign-of {mark.kind}">{title}{disk}{sign}</g>'


def _spot(points: Path) -> Point:
    """The middle of the longest piece of a path."""
    if len(points) < 2:
        return points[0]
    (ax, ay), (bx, by) = max(pairwise(points), key=lambda piece: _length(*piece))
    return (ax + bx) / 2, (ay + by) / 2


def _glyph(box: Box) -> str:
    """A triangle with an exclamation mark at the upper left corner of a box."""
    left, top, _, _ = box.edges
    x, y = left + 6, top - 9.5
    outline = polygon((x, y - 5.5), (x + 6, y + 4.5), (x - 6, y + 4.5))
    bang = f"M{num(x)} {num(y - 2.5)}v3.5M{num(x)} {num(y + 2)}v1.2"
    return f'<path class="glyph" d="{outline}"/><path class="bang" d="{bang}"/>'


def _text(text: Text) -> str:
    place = f'x="{num(text.x)}" y="{num(text.y)}" font-size="{num(text.size)}"'
    anchor = "" if text.anchor == "start" else f' text-anchor="{text.anchor}"'
    return f'<text class="{text.style}" {place}{anchor}>{escaped(text.text)}</text>'


def _legend(drawing: Picture, labels: Mapping[str, int], y: float, width: float) -> tuple[list[str], float]:
    """Samples of wires of the sampled rates, or of what the marks mean, with texts, and the height that they take."""
    samples = [("", "continuous"), *((f" r{number}", name) for name, number in labels.items())] if labels else []
    begin, style, below = 0, "port", 30
    if drawing.marks:
        samples = [(f" {kind}", text) for kind, text in _MEANINGS.items()]
        begin, style, below = 16, "legend", 34  # behind the sign of the mark
    lines = []
    left, line = MARGIN, y
    for kind, name in samples:
        text = fitted(name, 11, 200)
        at = begin + (38 if begin else 36)
        wide = at + width_of(text, 11) + 20
        if left > MARGIN and left + wide > width - MARGIN:
            left, line = MARGIN, line + 18
        lines.append(f'<g class="wire{kind}"><path class="run" d="M{num(left + begin)} {num(line)}h30"/></g>')
        if kind.strip() in _SIGNS:
            lines.append(_sign(left + 7, line, Mark(kind.strip())))
        lines.append(_text(Text(left + at, line + 4, text, 11, "start", style)))
        left += wide
    return lines, line - y + below if samples else 0.0
