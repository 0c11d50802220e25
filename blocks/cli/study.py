"""`blocks study`."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..fmi.exits import telling
from ..text.errors import Fault, FMUError, UsageError
from .options import takes_library, takes_trust
from .output import emit, printable, say, tell_faults
from .signals import INTERRUPTED, ended_at_once
from .values import assignments

if TYPE_CHECKING:
    from ..results.results import Results
    from ..studies.study import StudyResults

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
    from ..studies import study

    loaded = study.load(options.study)
    folder = Path(options.out) if options.out else Path("out") / loaded.name
    parameters = assignments("--set", options.parameters, "IADRC.torque=2")
    begun = None if options.json else lambda name: say(f"running {name}")
    finished: dict[str, Results] = {}

    def ended(error: FMUError) -> int:
        """An FMU ends this process."""
        _tell_kept(options, _kept(finished, folder))
        tell_faults(error.faults, options.json)
        return error.exit_status

    try:
        with telling(ended):
            made = study.run(
                loaded,
                library=options.library,
                parameters=parameters,
                begun=begun,
                finished=finished.__setitem__,
                trust=options.trust,
            )
        return _reported(options, made, folder, finished)
    except BaseException:  # also an interruption while the report is made
        _tell_kept(options, _kept(finished, folder))
        raise


def _reported(options: argparse.Namespace, made: StudyResults, folder: Path, finished: dict[str, Results]) -> int:
    """Tell what became of the study, and write its report. finished: emptied when the report has what is in it."""
    from ..studies import report

    for name, results in made.results.items():
        tell_faults([replace(w, place=f"runs.{name}.{w.place}") for w in results.warnings], options.json)
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
    if made.missing:
        return _interrupted(options, made, folder)
    path, failure = None, None
    faults: list[Fault] = []
    try:
        path = report.write(made, folder, _command(options), draw=lambda diagram: diagram.draw(), faults=faults)
        finished.clear()
    except UsageError as error:  # what was computed is told all the same
        failure = error
    tell_faults(faults, options.json)
    if options.json:
        emit(
            {
                "event": "done",
                "fine": made.is_fine,
                "reproduced": sum(v.verdict == "reproduced" for v in made.verdicts),
                "claims": sum(bool(v.verdict) for v in made.verdicts),
                "unexpected": sum(not v.is_expected for v in made.verdicts),
                "report": None if path is None else str(path),
                "seconds": round(made.seconds, 3),
            }
        )
    else:
        print(report.markdown_table(made) if options.markdown else printable(report.table_text(made)))
        print(report.summary_line(made))
    if failure is not None:
        raise failure
    if not options.json:
        print(printable(f"report: {path}"))
    if faults:
        return UsageError.exit_status
    return 0 if made.is_fine else 1


def _kept(results: Mapping[str, Results], folder: Path) -> dict[str, str]:
    """Write runs that are done as `NAME.csv` where there is no report: into its folder, else into a temporary one."""
    from ..studies import report

    made: dict[str, str] = {}
    for name, one in results.items():
        try:
            report.folder_for(folder)
            one.save(folder / f"{name}.csv")
        except (UsageError, OSError):
            with contextlib.suppress(UsageError, OSError):
                folder = Path(tempfile.mkdtemp(prefix="blocks-study-"))
                one.save(folder / f"{name}.csv")
                made[name] = str(folder / f"{name}.csv")
        else:
            made[name] = str(folder / f"{name}.csv")
    return made


def _tell_kept(options: argparse.Namespace, kept: Mapping[str, str]) -> None:
    if kept:
        say("no report was written; the runs that are done are kept")
    for name, path in kept.items():
        say(f"  {name} is in {path}")
    if kept and options.json:
        emit({"event": "kept", "kept": dict(kept)})


def _interrupted(options: argparse.Namespace, made: StudyResults, folder: Path) -> int:
    """Keep the runs that are done. There is no report of a part of a study: one that was there stays as it was."""
    from ..studies import report

    ended_at_once()
    kept = _kept(made.results, folder)
    if options.json:
        emit({"event": "done", "interrupted": True, "missing": list(made.missing), "kept": kept})
    elif made.verdicts:
        print(report.markdown_table(made) if options.markdown else printable(report.table_text(made)))
    say(f"interrupted: {', '.join(made.missing)} not run; no report was written")
    for name, path in kept.items():
        say(f"  {name} is in {path}")
    return INTERRUPTED


def _command(options: argparse.Namespace) -> str:
    words = ["blocks", "study", options.study]
    for name in ("parameters", "library"):
        for item in getattr(options, name):
            words += ["--set" if name == "parameters" else "--library", item]
    return shlex.join(words)
