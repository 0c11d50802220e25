"""Drawing by size: blocks placed by hand, the same after one block was moved, and blocks without positions.

The reference is what `blocks check` does with the same text: reading it and looking for its faults.
"""

from __future__ import annotations

from dataclasses import replace

from blocks import Diagram
from blocks.draw import picture, ports_of, rendered
from blocks.model.block_types import library_types
from blocks.model.diagram_value import BlockEntry, DiagramValue
from blocks.model.document import dumps, loads
from blocks.model.resolver import resolver_of

from .linear import tell, timed
from .measure import on_one_core

__all__ = ["cascades", "main", "placed"]

ROWS = (("reference", "Gain"), ("error", "Sum"), ("law", "PID"), ("limit", "Saturation"), ("plant", "FirstOrder"))
ABREAST = 4
BEFORE = {15: 86, 100: 920, 500: 9_700}
CASCADES = {10: 9_200, 1: 12_100, 40: 4_400}
"""Milliseconds that these took before wires and parts were weighed by their number, on one machine, as a hint only."""
REPEATS = 3
HEAD = f"{'':62}{'least ms':>10}{'median':>10}{'x check':>10}"


def placed(loops: int) -> DiagramValue:
    """Loops of five blocks on a grid, four in a row; each follows the one before it, some see another one's plant."""
    blocks, wires, layout = {}, {}, {}
    for k in range(loops):
        for column, (name, type_) in enumerate(ROWS):
            blocks[f"{name}{k}"] = BlockEntry(type=type_ if k or column else "Step")
            layout[f"{name}{k}"] = [680 * (k % ABREAST) + 130 * column, 180 * (k // ABREAST)]
        if k:
            wires[f"reference{k}.u"] = f"plant{k - 1}.y"
        wires |= {
            f"error{k}.u1": f"reference{k}.y",
            f"error{k}.u2": f"plant{k}.y",
            f"law{k}.r": f"error{k}.y",
            f"law{k}.y": f"plant{k if k % 5 else k * 7 % loops}.y",
            f"limit{k}.u": f"law{k}.u",
            f"plant{k}.u": f"limit{k}.y",
        }
    return DiagramValue("placed", blocks=blocks, wires=wires, layout=layout)


def cascades(count: int, length: int = 10) -> DiagramValue:
    """PIDs in cascades, each of which is fed back from the integrator behind its last one."""
    blocks, wires = {}, {}
    for k in range(count):
        last = k - k % length + length - 1
        blocks[f"law{k}"] = BlockEntry(type="PID")
        wires[f"law{k}.r"] = f"law{k - 1}.u" if k % length else f"plant{last}.y"
        wires[f"law{k}.y"] = f"plant{last}.y"
        if k == last:
            blocks[f"plant{k}"] = BlockEntry(type="Integrator")
            wires[f"plant{k}.u"] = f"law{k}.u"
    return DiagramValue("cascades", blocks=blocks, wires=wires)


def _measure(label: str, value: DiagramValue, goal: float | None, *, moved: str = "") -> None:
    """Times of the drawing of a diagram, from its text to the SVG's, and of the one after a block was moved."""
    text, resolver = dumps(value), resolver_of(library_types())

    def check() -> None:
        Diagram.from_json(text).check()

    def draw() -> str:
        read = loads(text)
        return rendered(picture(read, ports_of(read, resolver)), read.name)

    checked, _ = timed(check, REPEATS)
    seconds, _ = timed(draw, REPEATS)
    tell(label, seconds, goal, checked)
    if moved:
        before = picture(value, ports_of(value, resolver))
        x, y = value.layout[moved]
        after = replace(value, layout={**value.layout, moved: [x + 20, y + 20]})
        edited = dumps(after)

        def draw_again() -> str:
            read = loads(edited)
            return rendered(picture(read, ports_of(read, resolver), earlier=before), read.name)

        seconds, _ = timed(draw_again, REPEATS)
        tell("  after one move", seconds, 150.0, checked)


def main() -> None:
    print(HEAD)
    with on_one_core():
        for blocks, was in BEFORE.items():
            value, goal = placed(blocks // len(ROWS)), 1_500.0 if blocks == 500 else None
            _measure(f"{blocks} placed blocks (before: {was:,} ms)", value, goal, moved=f"law{blocks // 10}")
        for length, was in CASCADES.items():
            label = f"1,000 PID blocks in cascades of {length} (before: {was:,} ms)"
            _measure(label, cascades(1_000, length), 1_000.0)
