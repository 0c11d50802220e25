"""A diagram as a picture: boxes, wires, dots and texts with their places, before any of it is SVG."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from ..text.errors import Fault
from .layout_graph import Path, Point
from .shapes import Shape, Text

_Made = TypeVar("_Made")


@dataclass(frozen=True, slots=True)
class Mark:
    """What became of a box or a wire from one diagram to another: kind is added, removed or changed.

    lines: what is written below the name of a box. tip: its tooltip. label: instead of its name.
    """

    kind: str
    lines: tuple[str, ...] = ()
    tip: str = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Marks:
    """The marks of a drawing of two diagrams in one; what has none is drawn pale.

    boxes: by path and kind ("block", "input", "output"). wires: by sink (path of the box, port). replaced: by the path
    of a diagram ("" or with a dot at its end), wires that others have replaced; see `parts_of`. opened: the paths of
    subdiagrams that are opened. notes: lines below the drawing.
    """

    boxes: Mapping[tuple[str, str], Mark]
    wires: Mapping[tuple[str, str], Mark]
    replaced: Mapping[str, Sequence[tuple[str, str, bool]]]
    opened: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Box:
    """A block, a terminal, or the frame around an opened subdiagram, by its center.

    kind: block, diagram, fmu, input, output or frame. inputs, outputs: the places of its ports, by name. texts: its
    texts, in place. tip: its tooltip. rate: a label of `rates`, or "". copies: how many there are, as written, or "".
    """

    path: str
    kind: str
    x: float
    y: float
    shape: Shape
    texts: tuple[Text, ...]
    tip: str = ""
    faults: tuple[Fault, ...] = ()
    rate: str = ""
    mark: Mark | None = None
    copies: str = ""

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of its outline."""
        w, h = self.shape.width / 2, self.shape.height / 2
        return self.x - w, self.y - h, self.x + w, self.y + h

    @property
    def inputs(self) -> dict[str, Point]:
        return {name: (self.x + dx, self.y + dy) for name, (dx, dy) in self.shape.inputs.items()}

    @property
    def outputs(self) -> dict[str, Point]:
        return {name: (self.x + dx, self.y + dy) for name, (dx, dy) in self.shape.outputs.items()}

    def moved(self, dx: float, dy: float) -> Box:
        texts = tuple(Text(t.x + dx, t.y + dy, t.text, t.size, t.anchor, t.style) for t in self.texts)
        return replace(self, x=self.x + dx, y=self.y + dy, texts=texts)


@dataclass(frozen=True, slots=True)
class Wire:
    """A wire from a port to a port. source, sink: (path of the box, port). net: the name of the signal."""

    net: str
    source: tuple[str, str]
    sink: tuple[str, str]
    points: Path
    wide: bool = False
    rate: str = ""
    mark: Mark | None = None


@dataclass(frozen=True, slots=True)
class Dot:
    """A point where a net branches."""

    net: str
    x: float
    y: float
    rate: str = ""


@dataclass(frozen=True, slots=True)
class Open:
    """An input that is not wired, though it must be."""

    path: str
    port: str
    x: float
    y: float


class Kept:
    """What was made for a picture, which the picture after an edit takes over where it is made of the same."""

    def __init__(self) -> None:
        self._made: dict[Hashable, tuple[Any, Any]] = {}

    def take(self, name: Hashable, of: object, make: Callable[[], _Made]) -> _Made:
        """The one of that name, made anew where it is to be made of something else than before."""
        known = self._made.get(name)
        if known is None or known[0] != of:
            known = self._made[name] = of, make()
        made: _Made = known[1]
        return made


@dataclass(frozen=True, slots=True)
class Picture:
    """Everything with its place; the top left corner is (0, 0).

    origin: where the position [0, 0] of the file's `layout` lies; None where its positions are not those of the file.
    routes: the wires by source and sink, from that origin. kept: what the next picture may take over.
    """

    title: str
    width: float
    height: float
    boxes: tuple[Box, ...] = ()
    wires: tuple[Wire, ...] = ()
    dots: tuple[Dot, ...] = ()
    opens: tuple[Open, ...] = ()
    elsewhere: tuple[Fault, ...] = ()
    marks: Marks | None = None
    origin: Point | None = None
    routes: Mapping[tuple[tuple[str, str], tuple[str, str]], Path] = field(default_factory=dict, repr=False)
    kept: Kept = field(default_factory=Kept, repr=False, compare=False)

    def moved(self, dx: float, dy: float) -> Picture:
        def box(one: Box) -> Box:
            return self.kept.take(("moved", one.kind, one.path), (one, dx, dy), lambda: one.moved(dx, dy))

        def wire(one: Wire) -> Wire:
            def make() -> Wire:
                return replace(one, points=tuple((x + dx, y + dy) for x, y in one.points))

            return self.kept.take(("moved", one.net, one.sink), (one, dx, dy), make)

        return replace(
            self,
            origin=(self.origin[0] + dx, self.origin[1] + dy) if self.origin else None,
            boxes=tuple(map(box, self.boxes)),
            wires=tuple(map(wire, self.wires)),
            dots=tuple(replace(dot, x=dot.x + dx, y=dot.y + dy) for dot in self.dots),
            opens=tuple(replace(mark, x=mark.x + dx, y=mark.y + dy) for mark in self.opens),
        )
