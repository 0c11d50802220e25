"""The symbol of a block type, as drawings have it, alone: with its ports, and their names where the symbol has none."""

from __future__ import annotations

from typing import Any

from blocks.contract.interface import Interface
from blocks.draw.shapes import LABEL, Shape, Text, block_shape, num
from blocks.draw.style import RATES, style_of
from blocks.draw.text import escaped, width_of

__all__ = ["style_sheet", "symbol"]

STUB = 14.0
MARGIN = 2.0


def style_sheet() -> str:
    """The rules for all drawings of a page. Light or dark is what the reader has chosen, else what the system has."""
    light, _, dark = style_of({str(k): k for k in range(len(RATES))}).partition("@media (prefers-color-scheme:dark){")
    dark = dark.removesuffix("}")
    chosen = dark.replace(".blocks-diagram", 'body[data-theme="dark"] .blocks-diagram')
    system = dark.replace(".blocks-diagram", 'body:not([data-theme="light"]) .blocks-diagram')
    return f"{light}\n{chosen}\n@media (prefers-color-scheme:dark){{{system}}}\n"


def symbol(type_: str, interface: Interface, values: dict[str, Any]) -> str:
    """SVG. values: raw values of parameters that the symbol may show."""
    inputs, outputs = tuple(interface.inputs), tuple(interface.outputs)
    shape = block_shape(type_, values.get, inputs, outputs)
    parts = [f'<path class="{stroke.style}" d="{stroke.d}"/>' for stroke in shape.strokes]
    parts += [_text(text) for text in shape.texts]
    shown = {text.text for text in shape.texts}
    left, left_width = _stubs(shape.inputs, shape, shown, -1)
    right, right_width = _stubs(shape.outputs, shape, shown, 1)
    x, y = shape.width / 2 + MARGIN, shape.height / 2 + MARGIN
    below = max([y, *(py + STUB + MARGIN for _, py in shape.inputs.values() if py >= shape.height / 2)])
    top, height = -y, y + below
    width = 2 * x + left_width + right_width
    view = f"{num(-x - left_width)} {num(top)} {num(width)} {num(height)}"
    size = f'width="{num(width)}" height="{num(height)}"'
    label = escaped(f"symbol of {type_}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="blocks-diagram symbol" viewBox="{view}" {size} role="img" '
        f'aria-label="{label}"><g class="block">{"".join([*left, *right, *parts])}</g></svg>'
    )


def _stubs(pins: Any, shape: Shape, shown: set[str], side: int) -> tuple[list[str], float]:
    """Short wires at the ports of one side, with their names, and the room that they take."""
    made: list[str] = []
    width = 0.0
    for name, (x, y) in pins.items():
        if side < 0 and y >= shape.height / 2 - 0.01 and abs(x) < shape.width / 2:  # entered from below
            made.append(f'<path class="thin" d="M{num(x)} {num(y)}v{num(STUB)}"/>')
            made.append(_text(Text(x + 5, y + STUB, name, LABEL, "start")))
            continue
        reach = side * (shape.width / 2 + STUB)
        made.append(f'<path class="thin" d="M{num(x)} {num(y)}H{num(reach)}"/>')
        room = STUB
        if name not in shown:
            anchor = "end" if side < 0 else "start"
            made.append(_text(Text(reach + side * 3, y + 3.5, name, LABEL, anchor)))
            room += 3 + width_of(name, LABEL)
        width = max(width, room)
    return made, width


def _text(text: Text) -> str:
    anchor = "" if text.anchor == "start" else f' text-anchor="{text.anchor}"'
    place = f'x="{num(text.x)}" y="{num(text.y)}" font-size="{num(text.size)}"'
    return f'<text class="{text.style}" {place}{anchor}>{escaped(text.text)}</text>'
