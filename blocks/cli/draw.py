"""`blocks draw`."""

from __future__ import annotations

import argparse
from typing import Any

from ..text.errors import Fault, UsageError
from .options import takes_library, takes_variants
from .values import variants_of

__all__ = ["add"]


def add(verbs: Any) -> None:
    drawing = verbs.add_parser(
        "draw", help="draw a diagram as SVG", description="Draw a diagram as SVG, with its faults marked on the blocks."
    )
    drawing.add_argument("diagram", metavar="DIAGRAM")
    drawing.add_argument("-o", "--out", metavar="FILE.svg", help="where to write it (default: stdout)")
    drawing.add_argument("--depth", metavar="N", type=int, default=1, help="levels of subdiagrams to show (default 1)")
    takes_variants(drawing)
    drawing.set_defaults(verb=_draw)
    takes_library(drawing)


def _draw(options: argparse.Namespace) -> int:
    from ..api.diagram import Diagram
    from ..text.atomic_write import write_atomically

    if not 1 <= options.depth <= 30:
        raise UsageError(Fault("E501", f"--depth {options.depth}", "is not a number of levels.", "Use 1 or more."))
    diagram = Diagram.load(options.diagram, library=options.library)
    text = diagram.draw(depth=options.depth, variants=variants_of(options.variants))
    if options.out in (None, "-"):
        print(text)
        return 0
    if not options.out.lower().endswith(".svg"):
        cure = "Name it FILE.svg; browsers and Inkscape turn it into others."
        raise UsageError(Fault("E501", options.out, "a drawing is an SVG.", cure))
    with write_atomically(options.out) as stream:
        stream.write(text)
    print(options.out)
    return 0
