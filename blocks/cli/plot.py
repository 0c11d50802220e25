"""`blocks plot`."""

from __future__ import annotations

import argparse
import os

from ..text.element_names import matching
from ..text.errors import Fault, UsageError
from .option_values import check_writable, look_of
from .options import Verbs, takes_several, takes_size
from .output import printable

MOST = 8
"""Signals of one figure: each has a panel."""


def add(verbs: Verbs) -> None:
    plot = verbs.add_parser(
        "plot",
        help="draw signals of result files over each other",
        description="Draw signals of result files (.csv, .parquet, .mat) over time, several files in one "
        "figure, in the units of the first file. The legend shows the names of the files.",
    )
    plot.add_argument("files", metavar="FILE", nargs="+", help="a result file; NAME=FILE gives it a name")
    signal = "draw this signal, or all that match a pattern (motor.*); may be repeated; without it, the first four"
    takes_several(plot, "--signal", "NAME", signal)
    plot.add_argument("-o", "--out", metavar="FILE", required=True, help="the file to write: .svg, .png, .pdf")
    takes_size(plot)
    plot.set_defaults(verb=_plot)


def _plot(options: argparse.Namespace) -> int:
    from ..results import plots
    from ..results.results import Results

    named = [item.partition("=") if not os.path.exists(item) else (item, "", "") for item in options.files]
    paths = [path or name for name, _, path in named]
    check_writable("--out", options.out, paths)
    plots.check_format(options.out)
    stems = [os.path.splitext(os.path.basename(path))[0] for path in paths]
    labels = [
        name if path else stem if stems.count(stem) == 1 else name
        for (name, _, path), stem in zip(named, stems, strict=True)
    ]
    if len(set(labels)) < len(labels):
        raise UsageError(Fault("E501", "FILE", "two files have the same name in the legend.", "Rename one: NAME=FILE."))
    runs = {label: Results.load(path) for label, path in zip(labels, paths, strict=True)}
    first, *others = runs
    names: dict[str, None] = {}
    known = [name for name, _, _ in runs[first].flat_columns()]
    for asked in options.signal:
        found = [name for name in known if name == asked or matching(asked, [name.partition("[")[0]])]
        names |= dict.fromkeys(found)
        if not found:
            cure = f"Signals: {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}."
            raise UsageError(Fault("E501", f"--signal {asked}", f"matches no signal of {first}.", cure))
    beside = {label: runs[label] for label in others}
    figure = runs[first].plot(*names, most=MOST if names else 4, label=first, beside=beside, **look_of(options))
    plots.save(figure, options.out)
    print(printable(options.out))
    return 0
