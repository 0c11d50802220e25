"""`blocks study`."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ..fmi.exits import telling
from ..text.errors import Fault, FMUError, UsageError
from .option_values import assignments
from .options import Verbs, takes_json, takes_library, takes_several, takes_trust
from .output import emit, printable, say, tell_faults
from .stop_signals import INTERRUPTED, ended_at_once

if TYPE_CHECKING:
    from ..results.results import Results
    from ..studies.study import StudyResults, Verdict
    from ..studies.sweep import Sweep
    from ..studies.tuned import Tuning


def add(verbs: Verbs) -> None:
    study = verbs.add_parser(
        "study",
        help="compare runs with published numbers",
        description="Run a study: tables, figures, one report. Exit code 1 if a verdict differs from the "
        "expected verdict.",
    )
    study.add_argument("study", metavar="STUDY", help="a study file (JSON)")
    study.add_argument("--out", metavar="DIR", help="folder for report.html and the figures (default: out/NAME)")
    takes_several(study, "--set", "RUN.NAME=VALUE", "a parameter of one run: IADRC.torque=2", dest="parameters")
    takes_trust(study)
    forms = study.add_mutually_exclusive_group()
    forms.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    forms.add_argument("--latex", action="store_true", help="print it as a tabular of LaTeX (booktabs)")
    study.add_argument("--wide", action="store_true", help="print a row for each measure and a column for each run")
    takes_json(study)
    study.set_defaults(verb=_study)
    takes_library(study)


def _table(options: argparse.Namespace, made: StudyResults) -> str:
    """The table of all claims, in the form that is asked for."""
    from ..studies import report

    wide = bool(options.wide)
    if options.latex:
        return report.latex_table(made, wide=wide)
    return report.markdown_table(made, wide=wide) if options.markdown else printable(report.table_text(made, wide=wide))


def _study(options: argparse.Namespace) -> int:
    from ..results import plots
    from ..studies import study

    loaded = study.load(options.study)
    if find_spec("matplotlib") is None:  # settings that it cannot read cost figures, not the report
        plots.check_loads()
    folder = Path(options.out) if options.out else Path("out") / loaded.name
    parameters = assignments("--set", options.parameters, "IADRC.torque=2")
    begun = None if options.json else lambda name: say(f"running {name}")
    finished: dict[str, Results | Sweep | Tuning] = {}

    def ended(error: FMUError) -> int:
        """An FMU ends this process."""
        _tell_kept(options, finished, folder)
        tell_faults(error.faults, options.json)
        return error.exit_status

    try:
        with telling(ended):
            study_results = study.run(
                loaded,
                library=options.library,
                parameters=parameters,
                begun=begun,
                finished=finished.__setitem__,
                trust=options.trust,
            )
        return _reported(options, study_results, folder, finished)
    except BaseException:  # also an interruption while the report is made
        _tell_kept(options, finished, folder)
        raise


def _reported(
    options: argparse.Namespace,
    study_results: StudyResults,
    folder: Path,
    finished: dict[str, Results | Sweep | Tuning],
) -> int:
    """Report the outcome of the study, and write its report. finished: emptied once the report is written."""
    from ..server.static_page import zooming
    from ..studies import report

    sections: dict[str, Mapping[str, Results | Sweep | Tuning]]
    sections = {"runs": study_results.results, "sweeps": study_results.sweeps, "tunings": study_results.tunings}
    for section, made in sections.items():
        for name, results in made.items():
            tell_faults([replace(w, place=f"{section}.{name}.{w.place}") for w in results.warnings], options.json)
    for verdict in study_results.verdicts if options.json else ():
        emit(_claim_event(verdict))
    if study_results.missing:
        return _interrupted(options, study_results, folder)
    path, failure = None, None
    faults: list[Fault] = []
    try:
        path = report.write(
            study_results, folder, _command(options), draw=lambda diagram: diagram.draw(), faults=faults, zoom=zooming
        )
        finished.clear()
    except UsageError as error:  # what was computed is reported all the same
        failure = error
    tell_faults(faults, options.json)
    if options.json:
        emit(
            {
                "event": "done",
                "fine": study_results.is_fine,
                "reproduced": sum(v.verdict == "reproduced" for v in study_results.verdicts),
                "held": sum(v.verdict == "holds" for v in study_results.verdicts),
                "claims": sum(bool(v.verdict) for v in study_results.verdicts),
                "unexpected": sum(not v.is_expected for v in study_results.verdicts),
                "report": None if path is None else str(path),
                "seconds": round(study_results.seconds, 3),
            }
        )
    else:
        print(_table(options, study_results))
        aside = sys.stderr if options.markdown or options.latex else sys.stdout  # the table alone goes into a file
        print(report.summary_line(study_results), file=aside)
    if failure is not None:
        raise failure
    if not options.json:
        print(printable(f"report: {path}"), file=aside)
    if faults:
        return UsageError.exit_status
    return 0 if study_results.is_fine else 1


def _claim_event(v: Verdict) -> dict[str, object]:
    claim = v.claim
    entry: dict[str, object] = {
        "event": "claim",
        "run": claim.runs[0] if len(claim.runs) == 1 else None,
        "measure": claim.measure,
    }
    if claim.change:
        entry |= {"runs": list(claim.runs), "as": claim.change} if claim.runs else {"as": claim.change}
    if claim.tuning:
        entry |= {"tuning": claim.tuning, "scenario": claim.scenario or None}
    if claim.sweep:
        kind, level = claim.statistic
        entry |= {"sweep": claim.sweep, "scenario": claim.scenario or None}
        entry |= {"statistic": kind} if kind in ("mean", "deviation") else {kind: level}
    if claim.limit is not None:
        entry |= {claim.limit[0]: claim.limit[1]}
    entry |= {"value": v.value, "published": claim.published, "ratio": v.ratio, "verdict": v.verdict or None}
    return entry | {"expected": v.is_expected}


def _kept(results: Mapping[str, Results | Sweep | Tuning], folder: Path) -> dict[str, str]:
    """Write runs that are done as `NAME.csv` where there is no report: into its folder, else into a temporary one.

    Sweeps are written as Parquet, of tunings the report, into a folder NAME.
    """
    from ..studies import report_page

    paths: dict[str, str] = {}
    for name, made in results.items():
        with contextlib.suppress(UsageError, OSError):
            try:
                report_page.folder_for(folder)
                path = _saved(made, folder / name)
            except (UsageError, OSError):
                folder = Path(tempfile.mkdtemp(prefix="blocks-study-"))
                path = _saved(made, folder / name)
            paths[name] = str(path)
    return paths


def _saved(made: Results | Sweep | Tuning, path: Path) -> Path:
    from ..results.results import Results
    from ..studies.tuned import Tuning

    if isinstance(made, Tuning):
        return made.report(path)
    path = path.with_suffix(".csv" if isinstance(made, Results) else ".parquet")
    made.save(path)
    return path


def _tell_kept(options: argparse.Namespace, finished: Mapping[str, Results | Sweep | Tuning], folder: Path) -> None:
    kept = _kept(finished, folder)
    if kept:
        say("no report was written; the finished runs are kept")
    for name, path in kept.items():
        say(f"  {name} is in {path}")
    if kept and options.json:
        emit({"event": "kept", "kept": kept})


def _interrupted(options: argparse.Namespace, study_results: StudyResults, folder: Path) -> int:
    """Keep the runs that are done. There is no report of a part of a study: one that was there stays as it was."""

    ended_at_once()
    kept = _kept({**study_results.results, **study_results.sweeps, **study_results.tunings}, folder)
    if options.json:
        emit({"event": "done", "interrupted": True, "missing": list(study_results.missing), "kept": kept})
    elif study_results.verdicts:
        print(_table(options, study_results))
    say(f"interrupted: {', '.join(study_results.missing)} not run; no report was written")
    for name, path in kept.items():
        say(f"  {name} is in {path}")
    return INTERRUPTED


def _command(options: argparse.Namespace) -> str:
    given = [("--set", item) for item in options.parameters] + [("--library", item) for item in options.library]
    return shlex.join(["blocks", "study", options.study, *(word for pair in given for word in pair)])
