"""`blocks import`."""

from __future__ import annotations

import argparse
import os

from ..text.errors import Fault, UsageError
from .options import Verbs, takes_json, takes_several
from .output import emit, printable


def add(verbs: Verbs) -> None:
    importing = verbs.add_parser(
        "import",
        help="make a diagram of a Simulink model",
        description="Make a diagram of a Simulink model (.slx, .mdl), and report what was decided, left out and "
        "unknown. Nothing in the model is run. Exit code 1 if something is missing; the diagram is written all the "
        "same, and `blocks check` names what a person has to write.",
    )
    importing.add_argument("model", metavar="MODEL", help="a model: .slx or .mdl")
    importing.add_argument("-o", "--out", metavar="FILE", help="the diagram (default: MODEL.json in this folder)")
    takes_several(
        importing,
        "--workspace",
        "FILE",
        "variables of the model: a .mat file, or a .m file with assignments; may be repeated",
    )
    importing.add_argument("--force", action="store_true", help="replace the diagram if it is there")
    takes_json(importing)
    importing.set_defaults(verb=_import)


def _import(options: argparse.Namespace) -> int:
    from ..api.simulink_import import from_simulink

    name = os.path.splitext(os.path.basename(options.model))[0]
    out = options.out or f"{name}.json"
    if out == "-":
        raise UsageError(Fault("E501", "-o -", "stdout has the report.", "Give the name of a file."))
    if os.path.exists(out) and os.path.exists(options.model) and os.path.samefile(out, options.model):
        raise UsageError(Fault("E501", out, "is the model itself.", "Give the diagram another name."))
    if os.path.exists(options.model) and os.path.exists(out) and not options.force:
        raise UsageError(Fault("E501", out, "is there already.", "Give another name by -o, or replace it by --force."))
    diagram, report = from_simulink(options.model, options.workspace)
    diagram.save(out)
    if options.json:
        for line in report.to_json():
            emit(line)
        emit({"event": "done", "diagram": out, "whole": report.is_whole, "taken": len(report.taken)})
    else:
        print(printable(str(report)))
        print(printable(f"diagram in {out}"))
    return 0 if report.is_whole else 1
