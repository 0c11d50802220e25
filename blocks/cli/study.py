"""`blocks study`."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from .options import takes_library, takes_trust
from .telling import emit, printable, say
from .values import assignments

__all__ = ["add"]


def add(verbs: Any) -> None:
    study = verbs.add_parser(
        "study",
        help="compare runs with published numbers",
        description="Run a study: tables, figures, one report. Exit code 1 where a verdict is not the expected one.",
    )
    study.add_argument("study", metavar="STUDY", help="a study file (JSON)")
    study.add_argument("--out", metavar="DIR", help="folder for report.html and the figures (default: out/NAME)")
    study.add_argument(
        "--set",
        metavar="RUN.NAME=VALUE",
        action="append",
        default=[],
        dest="parameters",
        help="a parameter of one run: IADRC.torque=2",
    )
    takes_trust(study)
    study.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    study.add_argument("--json", action="store_true", help="one JSON object per line")
    study.set_defaults(verb=_study)
    takes_library(study)


def _study(options: argparse.Namespace) -> int:
    from .. import report, study

    loaded = study.load(options.study)
    folder = Path(options.out) if options.out else Path("out") / loaded.name
    parameters = assignments("--set", options.parameters, "IADRC.torque=2")
    begun = None if options.json else lambda name: say(f"running {name}")
    made = study.run(loaded, library=options.library, parameters=parameters, begun=begun, trust=options.trust)
    for v in made.verdicts if options.json else ():
        claim = v.claim
        entry: dict[str, Any] = {
            "event": "claim",
            "run": None if claim.change else claim.runs[0],
            "measure": claim.measure,
        }
        if claim.change:
            entry |= {"runs": list(claim.runs), "as": claim.change}
        entry |= {"value": v.value, "published": claim.published, "ratio": v.ratio, "verdict": v.verdict or None}
        emit(entry | {"expected": v.is_expected})
    path = report.write(made, folder, _command(options), draw=lambda diagram: diagram.draw())
    if options.json:
        emit(
            {
                "event": "done",
                "fine": made.is_fine,
                "reproduced": sum(v.verdict == "reproduced" for v in made.verdicts),
                "claims": sum(bool(v.verdict) for v in made.verdicts),
                "unexpected": sum(not v.is_expected for v in made.verdicts),
                "report": str(path),
                "seconds": round(made.seconds, 3),
            }
        )
    else:
        print(report.markdown_table(made) if options.markdown else printable(report.table_text(made)))
        print(report.summary_line(made))
        print(f"report: {path}")
    return 0 if made.is_fine else 1


def _command(options: argparse.Namespace) -> str:
    words = ["blocks", "study", options.study]
    for name in ("parameters", "library"):
        for item in getattr(options, name):
            words += ["--set" if name == "parameters" else "--library", item]
    return shlex.join(words)
