"""`blocks draw`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..text.errors import Fault, UsageError
from .option_values import variants_of
from .options import Verbs, takes_library, takes_variants

if TYPE_CHECKING:
    from ..api.diagram import Diagram


def add(verbs: Verbs) -> None:
    drawing = verbs.add_parser(
        "draw",
        help="draw a diagram as SVG, or as a page with its results",
        description="Draw a diagram as SVG, with its faults marked on the blocks; with --html as a page in one file, "
        "with its subdiagrams, its equations and the results of a run, that needs no network.",
    )
    drawing.add_argument("diagram", metavar="DIAGRAM")
    drawing.add_argument("-o", "--out", metavar="FILE", help="the file to write (default: stdout)")
    drawing.add_argument("--depth", metavar="N", type=int, default=1, help="levels of subdiagrams to show (default 1)")
    page = "write a page that zooms and opens subdiagrams, as -o FILE.html does"
    drawing.add_argument("--html", action="store_true", help=page)
    given = drawing.add_mutually_exclusive_group()
    results = "with --html: show the signals of this result file (.csv, .parquet, .mat)"
    given.add_argument("--results", metavar="FILE", help=results)
    given.add_argument("--run", action="store_true", help="with --html: run the diagram, and show what it records")
    takes_variants(drawing)
    drawing.set_defaults(verb=_draw)
    takes_library(drawing)


def _draw(options: argparse.Namespace) -> int:
    from ..api.diagram import Diagram
    from ..text.atomic_write import write_atomically

    if not 1 <= options.depth <= 30:
        raise UsageError(Fault("E501", f"--depth {options.depth}", "must be 1 to 30: the number of levels to show."))
    options.html = options.html or (options.out or "").lower().endswith((".html", ".htm"))
    if not options.html and (options.results or options.run):
        what = "--run" if options.run else "--results"
        raise UsageError(Fault("E501", what, "works for a page only.", "Add --html, or -o FILE.html."))
    diagram = Diagram.load(options.diagram, library=options.library)
    text = _page(options, diagram) if options.html else _svg(options, diagram)
    if options.out in (None, "-"):
        print(text)
        return 0
    with write_atomically(options.out) as stream:
        stream.write(text)
    print(options.out)
    return 0


def _svg(options: argparse.Namespace, diagram: Diagram) -> str:
    if options.out not in (None, "-") and not options.out.lower().endswith(".svg"):
        cure = "Name it FILE.svg, or FILE.html for a page. A browser prints an SVG as PDF; Inkscape writes PNG and PDF."
        raise UsageError(Fault("E501", options.out, "the format is not supported: drawings are SVG.", cure))
    return diagram.draw(depth=options.depth, variants=variants_of(options.variants))


def _page(options: argparse.Namespace, diagram: Diagram) -> str:
    from ..results.results import Results
    from ..server.static_page import page_of

    if options.out not in (None, "-") and not options.out.lower().endswith((".html", ".htm")):
        raise UsageError(Fault("E501", options.out, "a page must be an HTML file.", "Name it FILE.html."))
    if options.depth != 1:
        raise UsageError(
            Fault(
                "E501",
                f"--depth {options.depth}",
                "has no effect on a page, which opens each subdiagram by a click.",
                "Leave --depth out.",
            )
        )
    variants = variants_of(options.variants)
    results = Results.load(options.results) if options.results else None
    if options.run:
        if diagram.value.run.get("stop") is None:
            cure = 'Set "stop" in the file\'s "run", or show the results of `blocks run`: --results FILE.'
            raise UsageError(Fault("E501", diagram.name, "the run has no stop time.", cure))
        results = diagram.run(variants=variants).smooth()
    return page_of(diagram, results, variants=variants)
