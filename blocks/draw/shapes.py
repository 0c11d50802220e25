"""What a block looks like: outline, marks, texts, and where its ports are. The origin is the center of the outline."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil, inf, sqrt
from typing import Any

from ..text.json_number import is_number
from .pictograms import PICTOGRAMS
from .text import cut, fitted, shown, width_of

PITCH = 20.0
"""Distance between two ports of one side."""
HEADER = 11.0  # size of a type's name
LABEL = 10.0  # size of a port's name
WIDEST = 150.0  # of a text inside a block


def num(value: float) -> str:
    """A coordinate as text: at most two decimals, no trailing zeros, no negative zero."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


@dataclass(frozen=True, slots=True)
class Text:
    """A text at its baseline. anchor: start, middle or end. style: a class of the style sheet."""

    x: float
    y: float
    text: str
    size: float = LABEL
    anchor: str = "middle"
    style: str = "port"

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of the room it takes."""
        width = width_of(self.text, self.size)
        left = self.x - {"start": 0.0, "middle": width / 2, "end": width}[self.anchor]
        return left, self.y - 0.76 * self.size, left + width, self.y + 0.22 * self.size


@dataclass(frozen=True, slots=True)
class Stroke:
    """A path in the syntax of SVG, and a class of the style sheet: face, line, thin, solid, bar."""

    d: str
    style: str = "line"


Pins = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Shape:
    """An outline of `width` x `height` with the places of its ports, by name."""

    width: float
    height: float
    inputs: Pins
    outputs: Pins
    strokes: tuple[Stroke, ...] = ()
    texts: tuple[Text, ...] = ()
    under: str = ""  # the input that is entered from below


def even(value: float) -> float:
    """The next even whole number: halves of it are whole, so that lines are crisp."""
    return 2.0 * ceil(value / 2)


def polygon(*points: tuple[float, float]) -> str:
    return "M" + "L".join(f"{num(x)} {num(y)}" for x, y in points) + "Z"


def rectangle(width: float, height: float) -> str:
    x, y = width / 2, height / 2
    return polygon((-x, -y), (x, -y), (x, y), (-x, y))


def middle(text: str, y: float = 0.0, size: float = HEADER, style: str = "type", x: float = 0.0) -> Text:
    """A text whose capitals are centered at (x, y)."""
    return Text(x, y + 0.36 * size, text, size, "middle", style)


def spread(names: Sequence[str], x: float, pitch: float = PITCH, at: float = 0.0) -> dict[str, tuple[float, float]]:
    """Ports on a vertical line, around the height `at`."""
    first = at - pitch * (len(names) - 1) / 2
    return {name: (x, first + pitch * index) for index, name in enumerate(names)}


def boxed(width: float, height: float, inputs: Sequence[str], outputs: Sequence[str], *marks: Stroke | Text) -> Shape:
    """A rectangle with ports and marks, tall enough for its ports."""
    tall = max(height, PITCH * max(len(inputs), len(outputs)))
    strokes = (Stroke(rectangle(width, tall), "face"), *(m for m in marks if isinstance(m, Stroke)))
    texts = tuple(m for m in marks if isinstance(m, Text))
    return Shape(width, tall, spread(inputs, -width / 2), spread(outputs, width / 2), strokes, texts)


# --- the ordinary box ------------------------------------------------------------------------------------------


def named_box(header: str, inputs: Sequence[str], outputs: Sequence[str], kind: str = "") -> Shape:
    """A box with its type's name, and port names where there is more than one of a side. kind: "", fmu or diagram."""
    header = fitted(header, HEADER, WIDEST)
    extra = 32.0 if kind == "fmu" else 0.0
    head = width_of(header, HEADER) + extra
    rows = max(len(inputs), len(outputs))
    left, right = ([fitted(name, LABEL, WIDEST) for name in names] for names in (inputs, outputs))
    if rows < 2:
        width, height, at = max(60.0, head + 20), 40.0, 0.0
        texts: list[Text] = [middle(header, 0.0, x=extra / 2)]
        top = 0.0
    else:
        longest = [max((width_of(name, LABEL) for name in names), default=0.0) for names in (left, right)]
        width = max(70.0, head + 20, sum(longest) + 16 + (14 if all(longest) else 0) + (6 if kind == "diagram" else 0))
        height, at = PITCH * rows + 24, PITCH / 2
        top = -height / 2 + 13
        texts = [middle(header, top, x=extra / 2)]
    width = 10 * -(-width // 10)
    pins = spread(inputs, -width / 2, at=at), spread(outputs, width / 2, at=at)
    strokes = [Stroke(rectangle(width, height), "face")]
    if rows >= 2:
        inset = 8 if kind == "diagram" else 6
        for names, places, anchor, sign in ((left, pins[0], "start", 1), (right, pins[1], "end", -1)):
            texts += [
                Text(x + sign * inset, y + 3.5, name, LABEL, anchor)
                for name, (x, y) in zip(names, places.values(), strict=True)
            ]
    if kind == "fmu":
        x = -(head / 2)  # the mark is 26 wide
        strokes.append(Stroke(polygon((x, top - 6), (x + 26, top - 6), (x + 26, top + 6), (x, top + 6)), "solid"))
        texts.append(middle("FMU", top, 8.5, "tag", x + 13))
    elif kind == "diagram":
        strokes.append(Stroke(rectangle(width - 6, height - 6), "thin"))
    return Shape(width, height, *pins, tuple(strokes), tuple(texts))


def flag_shape(name: str, *, is_input: bool) -> Shape:
    """A terminal of the diagram: a flag with its name that points along the signal."""
    name = fitted(name, LABEL + 1, WIDEST)
    width, height = even(width_of(name, LABEL + 1) + 24), 16.0
    x, y = width / 2, height / 2
    outline = polygon((-x, -y), (x - 8, -y), (x, 0), (x - 8, y), (-x, y))
    pins: tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]
    pins = ({}, {"": (x, 0.0)}) if is_input else ({"": (-x, 0.0)}, {})
    return Shape(width, height, *pins, (Stroke(outline, "flag"),), (middle(name, 0, LABEL + 1, "flagname", -3),))


def frame_header(title: str, width: float) -> str:
    return fitted(title, HEADER, max(width, 40.0))


# --- symbols by type -------------------------------------------------------------------------------------------

Names = Sequence[str]
Values = Callable[[str], Any]
"""The raw value of a parameter by its name; None where it has none."""


def _gain(value: Values, inputs: Names, outputs: Names) -> Shape:
    text = fitted(shown(value("k") if value("k") is not None else "k"), HEADER, 66.0)
    width = max(50.0, even((width_of(text, HEADER) + 5) / 0.7))
    x, y = width / 2, 25.0
    face = Stroke(polygon((-x, -y), (x, 0), (-x, y)), "face")
    label = middle(text, 0, x=-x + max(0.36 * width, width_of(text, HEADER) / 2 + 4))
    return Shape(width, 2 * y, spread(inputs, -x), spread(outputs, x), (face,), (label,))


_SIGNS = {"+": "+", "-": "−", "*": "×", "/": "÷"}


def _sum(value: Values, inputs: Names, outputs: Names) -> Shape:
    given = value("signs")
    signs = [_SIGNS.get(c, "?") for c in given] if isinstance(given, str) else []
    signs += ["+"] * (len(inputs) - len(signs))
    if len(inputs) > 3:
        places = spread(inputs, 0).values()
        marks = [Text(-11, y + 4, s, 12, "middle", "sign") for s, (_, y) in zip(signs, places, strict=False)]
        return boxed(40, 40, inputs, outputs, *marks, middle("Σ", 0, 18, "big", 7))
    radius = 16.0 if len(inputs) < 3 else 20.0
    pins = {name: (-sqrt(radius**2 - y**2), y) for name, (_, y) in spread(inputs, 0, 14.0).items()}
    texts = [Text(x + 7, y + 4, s, 12, "middle", "sign") for s, (x, y) in zip(signs, pins.values(), strict=False)]
    if len(inputs) == 2:  # as in most block diagrams, the second one comes from below
        pins = {inputs[0]: (-radius, 0.0), inputs[1]: (0.0, radius)}
        texts = [Text(-9, 4, signs[0], 12, "middle", "sign"), Text(0, 13, signs[1], 12, "middle", "sign")]
    r = num(radius)
    face = Stroke(f"M-{r} 0A{r} {r} 0 1 1 {r} 0A{r} {r} 0 1 1 -{r} 0Z", "face")
    under = inputs[1] if len(inputs) == 2 else ""
    return Shape(2 * radius, 2 * radius, pins, spread(outputs, radius), (face,), tuple(texts), under)


def _product(value: Values, inputs: Names, outputs: Names) -> Shape:
    given = value("operations")
    signs = [_SIGNS.get(c, "?") for c in given] if isinstance(given, str) else []
    places = spread(inputs, 0).values()
    divides = "÷" in signs
    marks = [Text(-14, y + 4, s, 12, "middle", "sign") for s, (_, y) in zip(signs, places, strict=False) if divides]
    return boxed(44, 44, inputs, outputs, *marks, middle("×", 0, 22, "big", 5 if divides else 0))


def _fraction(above: str, below: str, inputs: Names, outputs: Names, size: float = 13.0) -> Shape:
    width = even(max(width_of(above, size), width_of(below, size)))
    line = Stroke(f"M{num(-width / 2 - 3)} 0H{num(width / 2 + 3)}")
    texts = (middle(above, -11, size), middle(below, 11, size))
    return boxed(max(50.0, even(width + 22)), 46, inputs, outputs, line, *texts)


def polynomial(coefficients: object, variable: str = "s") -> str:
    """[1, 0.2, 1] as s² + 0.2s + 1; empty where a coefficient is no number."""
    if not isinstance(coefficients, Sequence) or isinstance(coefficients, str) or len(coefficients) > 12:
        return ""
    terms: list[str] = []
    for index, raw in enumerate(coefficients):
        power = len(coefficients) - 1 - index
        if not is_number(raw):
            return ""
        if raw == 0:
            continue
        factor = shown(abs(raw)).lstrip("-")
        letter = "" if power == 0 else variable + ("" if power == 1 else str(power).translate(_RAISED))
        text = letter if letter and abs(raw) == 1 else factor + letter
        sign = ("− " if raw < 0 else "+ ") if terms else ("−" if raw < 0 else "")
        terms.append(sign + text)
    return " ".join(terms) or "0"


_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def _transfer_function(value: Values, inputs: Names, outputs: Names) -> Shape:
    above, below = (polynomial(value(name) if value(name) is not None else "") for name in ("num", "den"))
    size = 12.0
    if not above or not below or max(width_of(above, size), width_of(below, size)) > WIDEST:
        above, below = "num(s)", "den(s)"
    return _fraction(above, below, inputs, outputs, size)


def _state_space(value: Values, inputs: Names, outputs: Names) -> Shape:
    lines = (middle("x′ = Ax + Bu", -9, 11), middle("y = Cx + Du", 9, 11))
    names = [Text(50, y + 3.5, cut(name, 6), LABEL, "end") for name, (_, y) in spread(outputs, 0).items()]
    if len(outputs) < 2:
        return boxed(100, 46, inputs, outputs, *lines)
    moved = [Text(-13, line.y, line.text, line.size, "middle", line.style) for line in lines]
    return boxed(112, 46, inputs, outputs, *moved, *names)


def _constant(value: Values, inputs: Names, outputs: Names) -> Shape:
    text = fitted(shown(value("value") if value("value") is not None else "value"), HEADER, 80)
    return boxed(max(40.0, 10 * -(-(width_of(text, HEADER) + 14) // 10)), 30, inputs, outputs, middle(text))


def _sampled(mark: Stroke | Text, value: Values, inputs: Names, outputs: Names) -> Shape:
    """A box with its period, and a comb along its lower edge as the sign of a sampled block."""
    text = fitted(shown(value("period") if value("period") is not None else ""), 9, 70)
    width = max(50.0, 10 * -(-(width_of(text, 9) + 10) // 10))
    comb = Stroke("".join(f"M{num(x)} 26v-5" for x in range(int(-width / 2) + 5, int(width / 2), 5)), "thin")
    return boxed(width, 52, inputs, outputs, mark, comb, middle(text, 13.5, 9, "small"))


def _bar(value: Values, inputs: Names, outputs: Names) -> Shape:
    tall = PITCH * max(len(inputs), len(outputs), 2)
    face = Stroke(rectangle(6, tall), "bar")
    return Shape(6, tall, spread(inputs, -3), spread(outputs, 3), (face,))


_SYMBOLS: dict[str, tuple[Callable[[Values, Names, Names], Shape], float, float]] = {
    "Constant": (_constant, 0, 1),
    "Demux": (_bar, inf, inf),
    "Gain": (_gain, 1, 1),
    "Integrator": (lambda _, inputs, outputs: _fraction("1", "s", inputs, outputs, 14), 1, 1),
    "Mux": (_bar, inf, inf),
    "Product": (_product, 10_000, 1),
    "StateSpace": (_state_space, inf, inf),
    "Sum": (_sum, 10_000, 1),
    "TransferFunction": (_transfer_function, 1, 1),
    "UnitDelay": (partial(_sampled, middle("z⁻¹", -8, 15)), 1, 1),
    "ZeroOrderHold": (partial(_sampled, Stroke("M-16 1H-9V-6H-2V-13H5V-18H12V-11H17")), 1, 1),
}
"""What draws a type, for how many inputs and outputs at most."""


def block_shape(type_: str, value: Values, inputs: Names, outputs: Names) -> Shape:
    """The symbol of a block type; a box with its name where there is none, or where the ports are not as expected."""
    draw, most_in, most_out = _SYMBOLS.get(type_, (None, 1, 1))
    if (draw is None and type_ not in PICTOGRAMS) or len(inputs) > most_in or len(outputs) > most_out:
        return named_box(type_ or "?", inputs, outputs)
    if draw is None:
        return boxed(50, 40, inputs, outputs, *(Stroke(d, style) for style, d in PICTOGRAMS[type_]))
    return draw(value, inputs, outputs)
