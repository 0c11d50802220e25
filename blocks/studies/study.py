"""A study: runs, sweeps and tunings, their measures beside published numbers or limits, and a verdict on each claim.

A study file names the runs (diagrams with parameters and settings), the sweeps and the tunings, the claims (a measure
of one run, an improvement from one run to another, a statistic of a sweep, or what a tuning reached, beside the
published value with its source, a tolerance and the verdict that is expected; or with a limit), what was assumed, and
the figures. It is judged by whether every claim has its expected verdict, so that a number that cannot be reproduced is
stated with its reason rather than left out.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..api.diagram import Diagram
from ..model.block_types import Library
from ..model.diagram_value import FaultList, beside
from ..model.project import Project, read_inside
from ..model.study_grammar import STUDY
from ..results.results import Results
from ..text import json_text, json_writer
from ..text.errors import Fault, ModelError
from ..text.json_document import IN_FILES, Document
from .study_checks import StudyChecks
from .study_reader import Claim, Study, StudyReader
from .study_sweeps import statistic_of
from .study_tunings import limits_of, needs, values_of
from .sweep import Sweep
from .tuned import Tuning


@dataclass(frozen=True, slots=True)
class Verdict:
    """A claim with what came out: the value, its ratio to the published one, and the verdict ("" where none is due).

    verdict: "reproduced" or "not reproduced"; of a limit "holds" or "fails". rows: how many of a sweep have a number,
    and how many it has; (0, 0) for runs.
    """

    claim: Claim
    value: float
    ratio: float
    verdict: str
    rows: tuple[int, int] = (0, 0)

    @property
    def is_expected(self) -> bool:
        return self.verdict == self.claim.expected


@dataclass(frozen=True)
class StudyResults:
    """What a study gave. `is_fine` where every claim has the verdict that the file expects.

    verdicts: on the claims, then on the constraints of tunings, which are expected to hold. sweeps, tunings: by name.
    missing: the runs, sweeps and tunings that were not made, or not finished, because of Ctrl-C; claims about
    them are not judged.
    """

    study: Study
    results: Mapping[str, Results]
    diagrams: Mapping[str, Diagram]
    verdicts: tuple[Verdict, ...]
    seconds: float = 0.0
    missing: tuple[str, ...] = ()
    sweeps: Mapping[str, Sweep] = field(default_factory=dict)
    tunings: Mapping[str, Tuning] = field(default_factory=dict)

    @property
    def is_fine(self) -> bool:
        return not self.missing and all(verdict.is_expected for verdict in self.verdicts)


def load(path: str | Path) -> Study:
    """The study of a file. Raises ModelError with all faults of its structure."""
    path = Path(path)
    data = read_inside(path, Project(path.resolve().parent), Fault("E007", "", ""), times=IN_FILES)
    document, first = json_text.meant(data, file=str(path), times=IN_FILES)
    study = StudyReader(document, path, list(first)).study()
    if first:
        raise ModelError(*first, readable=study)
    return study


def checked(path: str | Path, *, library: Library = ()) -> tuple[Study | None, list[Fault]]:
    """The study of a file, None where it cannot be read, and all faults: of its structure and of what it asks for."""
    try:
        study, first = load(path), tuple[Fault, ...]()
    except ModelError as error:
        study, first = error.readable, error.faults
    try:
        if study is not None:
            StudyChecks(study, library)
    except ModelError as error:
        faults = FaultList()
        faults.update((*first, *beside(error.faults, first)))
        return study, faults.in_order()
    except Exception:
        if not first:  # a study that is half read may make anything fail
            raise
    return study, list(first)


def canonical(document: Document) -> str:
    """The canonical text of a study's document.

    One run, claim, assumption and line of a figure a line; the keys of the study in their order, all others as they
    were. What it says may be wrong; its structure may not. Raises ModelError with the faults of that.
    """
    reader = StudyReader(document, Path(document.file))
    with contextlib.suppress(ModelError):
        reader.study()
    wrong = [fault for fault in reader.faults if fault.code.startswith("E0")]
    if wrong:
        raise ModelError(*wrong)
    value = STUDY.ordered(document.value)
    return json_writer.write(value, one_per_line=STUDY.lines(value))


def run(
    study: Study,
    *,
    library: Library = (),
    parameters: Mapping[str, object] | None = None,
    begun: Callable[[str], None] | None = None,
    finished: Callable[[str, Results | Sweep | Tuning], None] | None = None,
    trust: Any = (),
) -> StudyResults:
    """Run everything and judge every claim.

    parameters: values by "RUN.path" ("IADRC.torque") in place of the file's; also of sweeps and tunings. begun: called
    with each run's name. finished: called with its name and its results as soon as they are there, so that nothing is
    lost where a later run fails. trust: as of `Diagram.run`. Ctrl-C returns the runs that are done (`missing`). Raises
    ModelError, UsageError (E504 before the first run, where a tuning needs a package that is missing), and
    SimulationError.
    """
    import time

    start = time.perf_counter()
    checks = StudyChecks(study, library, parameters)
    for tuned in study.tunings:
        needs(tuned)
    found: dict[str, Any] = {}
    with contextlib.suppress(KeyboardInterrupt):
        for entry in study.all_runs:
            if begun is not None:
                begun(entry.name)
            made = entry.made(checks.diagrams[entry.name], checks.given(entry), trust)
            if made.interrupted:
                break
            found[entry.name] = made
            if finished is not None:
                finished(entry.name, made)
    groups = (study.runs, study.sweeps, study.tunings)
    results, sweeps, tunings = ({each.name: found[each.name] for each in of if each.name in found} for of in groups)
    missing = tuple(entry.name for entry in study.all_runs if entry.name not in found)
    about = [claim for claim in study.claims if not {*claim.runs, claim.many} & {*missing}]
    verdicts = [judge(claim, results, sweeps, tunings, factor=checks.factor(claim)) for claim in about]
    for name, tuning in tunings.items():
        for scenario, text, limit, value in limits_of(tuning):
            constraint = Claim((), text, "", None, "", "", 0.0, "holds", "", "", scenario, limit=limit, tuning=name)
            verdicts.append(_within(constraint, value, limit))
    seconds = time.perf_counter() - start
    return StudyResults(study, results, checks.diagrams, tuple(verdicts), seconds, missing, sweeps, tunings)


def judge(
    claim: Claim,
    results: Mapping[str, Results],
    sweeps: Mapping[str, Sweep] | None = None,
    tunings: Mapping[str, Tuning] | None = None,
    *,
    factor: float = 1.0,
) -> Verdict:
    """The verdict on one claim. factor: what makes its measure, or its change in %, a number in its unit."""
    rows = (0, 0)
    if claim.sweep:
        sweep = (sweeps or {})[claim.sweep]
        column = (sweep[claim.scenario] if claim.scenario else sweep).measures[claim.measure]
        rows = int(np.count_nonzero(~np.isnan(column))), len(column)
        values = [statistic_of(column * factor, claim.statistic, claim.limit)]
    elif claim.tuning:
        values = values_of((tunings or {})[claim.tuning], claim.measure)
    else:
        values = [results[name].measures[claim.measure] for name in claim.runs]
    value = values[-1] if claim.sweep else values[-1] * factor
    if claim.change:
        change = 100.0 * (values[1] - values[0]) / values[0] if values[0] else math.nan
        value = (-change if claim.change == "reduction" else change) * factor
    if claim.limit is not None:
        limit = ("at_least", claim.statistic[1]) if claim.statistic[0] == "share" else claim.limit
        return _within(claim, value, limit, rows)
    if claim.published is None:
        return Verdict(claim, value, math.nan, "", rows)
    ratio = value / claim.published
    fits = abs(ratio - 1.0) <= claim.tolerance  # false for NaN
    return Verdict(claim, value, ratio, "reproduced" if fits else "not reproduced", rows)


def _within(claim: Claim, value: float, limit: tuple[str, float], rows: tuple[int, int] = (0, 0)) -> Verdict:
    holds = value <= limit[1] if limit[0] == "at_most" else value >= limit[1]  # false for NaN
    return Verdict(claim, value, math.nan, "holds" if holds else "fails", rows)
