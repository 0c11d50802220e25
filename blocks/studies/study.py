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
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..api.diagram import Diagram
from ..model.diagram_grammar import DOC, SIGNAL
from ..model.diagram_value import FaultList, beside, is_name
from ..model.flatten import FlatSignal, element_of
from ..model.project import Project, read_inside
from ..model.study_grammar import ASSUMED, CLAIM, FORMAT, ONE_SWEEP, ONE_TUNING, SETTINGS, STUDY, VERSION, named
from ..results.results import Results
from ..text import json_text, json_writer, units
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.grammar import Kind, Steps
from ..text.json_document import AT_KEY, Document, nearest, place_of
from ..text.json_number import Number
from ..text.printable import legible, quoted
from . import study_sweeps, study_tunings
from .study_sweeps import StudySweep, names_missing, run_sweep, statistic_of
from .study_tunings import StudyTuning, limits_of, run_tuning, values_of
from .sweep import Sweep
from .sweep_margins import margins_of
from .sweep_run import units_of_measures
from .tuned import Tuning


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a study: a diagram file with parameters, variants of blocks and settings of its own."""

    name: str
    diagram: str
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    doc: str
    variants: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Claim:
    """A measure beside a published number. `runs` has one name, or two for a change from the first to the second in %.

    sweep: the name of one, in the place of runs, with a scenario ("": the rows of all); statistic: what of its rows is
    claimed: ("quantile", q), ("mean", nan), ("deviation", nan) or ("share", part). limit: ("at_most", x) or
    ("at_least", x), in the place of a published number. change: "" for one run, "reduction" or "increase" for two.
    tuning: the name of one, in the place of runs; with a change it is that from before to after, else the value after.
    published: None where nothing was published (the value is shown, and not judged). tolerance: the largest
    |value/published - 1| that counts as reproduced.
    """

    runs: tuple[str, ...]
    measure: str
    change: str
    published: float | None
    unit: str
    source: str
    tolerance: float
    expected: str
    reason: str
    sweep: str = ""
    scenario: str = ""
    statistic: tuple[str, float] = ("", math.nan)
    limit: tuple[str, float] | None = None
    tuning: str = ""

    @property
    def many(self) -> str:
        """The sweep or the tuning that it is about."""
        return self.sweep or self.tuning

    @property
    def of(self) -> str:
        """The runs, the sweep or the tuning that it is about."""
        return "/".join(filter(None, (self.many, self.scenario))) if self.many else " / ".join(self.runs)

    @property
    def label(self) -> str:
        if self.sweep:
            kind, level = self.statistic
            return f"{self.measure}, {f'{100 * level:g} % quantile' if kind == 'quantile' else kind}"
        if not self.change:
            return self.measure
        first, second = self.runs or ("before", "after")
        return f"{self.measure}, {self.change} from {first} to {second}"


@dataclass(frozen=True, slots=True)
class Study:
    """A study as its file says it. folder: where the paths of its diagrams begin. positions: places in its text."""

    name: str
    title: str
    doc: tuple[str, ...]
    source: str
    runs: tuple[Run, ...]
    sweeps: tuple[StudySweep, ...]
    tunings: tuple[StudyTuning, ...]
    assumed: tuple[Mapping[str, str], ...]
    claims: tuple[Claim, ...]
    figures: tuple[Mapping[str, Any], ...]
    folder: str
    file: str
    positions: Mapping[Any, tuple[int, int]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def all_runs(self) -> tuple[Run | StudySweep | StudyTuning, ...]:
        """The runs, then the sweeps, then the tunings."""
        return *self.runs, *self.sweeps, *self.tunings

    def fault(self, code: str, place: str, message: str, cure: str = "", path: Steps = ()) -> Fault:
        """A fault with its place in the file: that of `path`, or of the nearest thing around it."""
        path = nearest(path, self.positions)
        line, column = self.positions.get(path, (0, 0))
        return Fault(code, place, message, cure, path, self.file, line, column)


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
    data = read_inside(path, Project(path.resolve().parent), Fault("E007", "", ""))
    document, first = json_text.meant(data, file=str(path))
    study = _StudyReader(document, path, list(first)).study()
    if first:
        raise ModelError(*first, readable=study)
    return study


def checked(path: str | Path, *, library: Any = ()) -> tuple[Study | None, list[Fault]]:
    """The study of a file, None where it cannot be read, and all faults: of its structure and of what it asks for."""
    try:
        study, first = load(path), tuple[Fault, ...]()
    except ModelError as error:
        study, first = error.readable, error.faults
    try:
        if study is not None:
            prepared(study, library=library)
    except ModelError as error:
        faults = FaultList()
        faults.update((*first, *beside(error.faults, first)))
        return study, faults.in_order()
    except Exception:
        if not first:  # a study that is half read may make anything fail
            raise
    return study, list(first)


def canonical(document: Document) -> tuple[str, int]:
    """The canonical text of a study's document, and its version.

    One run, claim, assumption and line of a figure a line; the keys of the study in their order, all others as they
    were. What it says may be wrong; its structure may not. Raises ModelError with the faults of that.
    """
    reader = _StudyReader(document, Path(document.file))
    with contextlib.suppress(ModelError):
        reader.study()
    wrong = [fault for fault in reader.faults if fault.code.startswith("E0")]
    if wrong:
        raise ModelError(*wrong)
    value = STUDY.ordered(document.value)
    return json_writer.write(value, one_per_line=STUDY.lines(value)), VERSION


def run(
    study: Study,
    *,
    library: Any = (),
    parameters: Mapping[str, Any] | None = None,
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
    extra = _by_run(study, parameters or {})
    diagrams, known = _prepared(study, library, parameters)
    for tuned in study.tunings:
        study_tunings.needs(tuned)
    found: dict[str, Any] = {}
    with contextlib.suppress(KeyboardInterrupt):
        for entry in study.all_runs:
            if begun is not None:
                begun(entry.name)
            diagram, given = diagrams[entry.name], {**entry.parameters, **extra.get(entry.name, {})}
            made: Results | Sweep | Tuning
            if isinstance(entry, Run):
                made = diagram.run(parameters=given, trust=trust, **dict(entry.settings))
            elif isinstance(entry, StudySweep):
                made = run_sweep(entry, diagram, given, trust)
            else:
                made = tuning = run_tuning(entry, diagram, given, trust)
                if any(r.interrupted for r in (*tuning.before.values(), *tuning.after.values())):
                    break
            if made.interrupted:
                break
            found[entry.name] = made
            if finished is not None:
                finished(entry.name, made)
    groups = (study.runs, study.sweeps, study.tunings)
    results, sweeps, tunings = ({each.name: found[each.name] for each in of if each.name in found} for of in groups)
    missing = tuple(entry.name for entry in study.all_runs if entry.name not in found)
    about = [claim for claim in study.claims if not {*claim.runs, claim.many} & {*missing}]
    verdicts = [judge(claim, results, sweeps, tunings, factor=_factor(claim, known)) for claim in about]
    for name, tuning in tunings.items():
        for scenario, text, limit, value in limits_of(tuning):
            constraint = Claim(
                (), text, "", None, "", "", 0.0, "holds", "", scenario=scenario, limit=limit, tuning=name
            )
            verdicts.append(_within(constraint, value, limit))
    seconds = time.perf_counter() - start
    return StudyResults(study, results, diagrams, tuple(verdicts), seconds, missing, sweeps, tunings)


def _by_run(study: Study, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Values by "RUN.path" as values by path, for each run. Raises ModelError (E106)."""
    values: dict[str, dict[str, Any]] = {}
    names = [entry.name for entry in study.all_runs]
    for key, value in parameters.items():
        name, _, path = key.partition(".")
        if name not in names or not path:
            cure = did_you_mean(name, names) or "Write RUN.PARAMETER. Example: IADRC.torque."
            raise ModelError(Fault("E106", legible(key), "does not begin with the name of a run.", cure))
        values.setdefault(name, {})[path] = value
    return values


def prepared(study: Study, *, library: Any = (), parameters: Mapping[str, Any] | None = None) -> dict[str, Diagram]:
    """The diagrams of a study by run, sweep or tuning, with variants; what can be wrong is found before any runs.

    parameters: as of `run`. Raises ModelError with the faults of all diagrams, of the values and settings that the
    runs give to them, and of claims about measures that they do not take, or in units of other quantities.
    """
    return _prepared(study, library, parameters)[0]


_Units = dict[str, dict[str, str]]
"""Of measures, by run or sweep: "1" where they have none, "" where it is not known."""


def _prepared(study: Study, library: Any, parameters: Mapping[str, Any] | None) -> tuple[dict[str, Diagram], _Units]:
    faults: dict[Fault, None] = {}
    measured: _Units = {}
    diagrams: dict[str, Diagram] = {}
    recorded: dict[str, dict[str, FlatSignal]] = {}
    extra = _by_run(study, parameters or {})
    for entry in study.runs:
        try:
            diagram = Diagram.load(Path(study.folder) / entry.diagram, library=library)
            diagram = diagram.with_variants(entry.variants) if entry.variants else diagram
            given = {**entry.parameters, **extra.get(entry.name, {})}
            flat = diagram.flatten(parameters=given, settings=entry.settings)
            diagrams[entry.name] = diagram
            measured[entry.name] = units_of_measures(flat, plain="1")
            elements = {signal: element_of(signal, flat.signals) for signal in flat.log}
            recorded[entry.name] = {signal: element for signal, element in elements.items() if element is not None}
        except (ModelError, UsageError) as error:
            for fault in error.faults:
                faults[fault if fault.file else _of_run(study, entry, fault)] = None
    sweeps = {entry.name: entry for entry in study.sweeps}
    many: dict[str, StudySweep | StudyTuning] = {entry.name: entry for entry in study.sweeps}
    many |= {entry.name: entry for entry in study.tunings}
    for each in many.values():
        path: Steps = ("sweeps" if isinstance(each, StudySweep) else "tunings", each.name)
        try:
            diagram = Diagram.load(Path(study.folder) / each.diagram, library=library)
            diagram = diagram.with_variants(each.variants) if each.variants else diagram
            diagrams[each.name] = diagram
            given = {**each.parameters, **extra.get(each.name, {})}
            if isinstance(each, StudySweep):
                found = [*study_sweeps.faults_of(each, diagram, given)]
            else:
                found = [*study_tunings.faults_of(each, diagram, given)]
            if not found:
                of_margins = each.options.get("margins", {}) if isinstance(each, StudySweep) else {}
                flat = diagram.flatten(parameters=given, settings=each.settings)
                measured[each.name] = units_of_measures(flat, plain="1")
                measured[each.name] |= {margin.name: margin.unit or "1" for margin in margins_of(of_margins)}
        except (ModelError, UsageError) as error:
            found = [(("diagram",), fault) for fault in error.faults]
        for inside, fault in found:
            if not fault.file:
                where = (*path, *inside)
                fault = study.fault(fault.code, place_of(where), fault.message, fault.cure, where)
            faults[fault] = None
    for k, claim in enumerate(study.claims):
        if claim.scenario and claim.sweep in sweeps and claim.scenario not in sweeps[claim.sweep].scenarios:
            message = f"the sweep {claim.sweep} has no scenario {quoted(claim.scenario)}."
            cure = f"Scenarios: {', '.join(sweeps[claim.sweep].scenarios) or 'none'}."
            faults[study.fault("E105", f"claims[{k}]", message, cure, ("claims", k, "scenario"))] = None
        for name in (*claim.runs, *filter(None, (claim.many,))):
            known: Collection[str] = diagrams[name].value.measures if name in diagrams else [claim.measure]
            known = many[name].measured(diagrams[name]) if name in many and name in diagrams else known
            if claim.measure not in known:
                cure = did_you_mean(claim.measure, known) or f"Measures: {', '.join(known) or 'none'}."
                message = f"the diagram of {name} has no measure {quoted(claim.measure)}."
                faults[study.fault("E105", f"claims[{k}]", message, cure, ("claims", k, "measure"))] = None
        try:
            _factor(claim, measured)
        except ModelError as error:
            for fault in error.faults:
                message = f"the unit of {claim.measure}: {fault.message}"
                faults[study.fault(fault.code, f"claims[{k}].unit", message, fault.cure, ("claims", k, "unit"))] = None
    for i, figure in enumerate(study.figures):
        entry_of = sweeps.get(figure.get("sweep", ""))
        if entry_of is not None and entry_of.name in diagrams:
            for fault in names_missing(entry_of, diagrams[entry_of.name], figure):
                faults[study.fault("E105", f"figures[{i}]", fault.message, fault.cure, ("figures", i))] = None
    for place, item in _drawn(study):
        known = recorded.get(item.get("run", ""), {})
        if known and "signal" in item and element_of(item["signal"], known) is None:
            cure = did_you_mean(item["signal"], known) or 'Add it to the "log" of the diagram or of the run.'
            message = f"the run {item['run']} does not record {quoted(item['signal'])}."
            faults[study.fault("E105", place_of(place), message, cure, (*place, "signal"))] = None
    if faults:
        raise ModelError(*faults)
    return diagrams, measured


def _factor(claim: Claim, measured: _Units) -> float:
    """What makes a measure, or a change in %, a number in the unit of the claim. Raises ModelError (E104, E114).

    1 where either unit is not known.
    """
    known = measured.get(claim.many or next(iter(claim.runs), ""), {})
    measure = claim.measure.rpartition(".")[2] if claim.tuning else claim.measure  # of a scenario
    if units.has_offset(claim.unit):
        message = f"{claim.unit} has an offset, but measures are differences, which have none."
        raise ModelError(Fault("E104", "", message, f"Write {units.difference(claim.unit)}."))
    return units.scale("%" if claim.change else known.get(measure, ""), claim.unit)


def _drawn(study: Study) -> Iterator[tuple[Steps, Mapping[str, Any]]]:
    """The lines and markers of all figures, with their places in the file."""
    for i, figure in enumerate(study.figures):
        for k, panel in enumerate(figure.get("panels", ())):
            for key in ("lines", "markers"):
                for j, item in enumerate(panel.get(key, ())):
                    yield ("figures", i, "panels", k, key, j), item


def _of_run(study: Study, entry: Run, fault: Fault) -> Fault:
    """A fault of what a run gives to its diagram, with its place in the study."""
    word = fault.place.removeprefix("run.")
    if not word:  # of the diagram's file
        path: Steps = ("runs", entry.name, "diagram")
        return study.fault(fault.code, ".".join(map(str, path)), fault.message, fault.cure, path)
    section = next((s for s in ("parameters", "settings", "variants") if word in getattr(entry, s)), "")
    path = ("runs", entry.name, *((section, word) if section else ()))
    return study.fault(fault.code, ".".join(map(str, (*path[:2], fault.place))), fault.message, fault.cure, path)


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


@dataclass
class _StudyReader:
    """Reads a study's document; faults are collected, so that one pass reports them all."""

    document: Document
    path: Path
    faults: list[Fault] = field(default_factory=list)

    def fault(self, code: str, path: Steps, message: str, cure: str = "", *, at_key: bool = False) -> None:
        path, known = (*path, AT_KEY) if at_key else path, self.document.places
        line, column = known.get(nearest(path, known), (1, 1))
        path = path[:-1] if path[-1:] == (AT_KEY,) else path
        place = legible(".".join(str(part) for part in path))
        self.faults.append(Fault(code, place, message, cure, path, str(self.path), line, column))

    def guess(self, word: str, known: Collection[str]) -> str:
        return did_you_mean(word[:200], known, quote='"')

    def study(self) -> Study:
        value = self.document.value
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            self.fault(
                "E006",
                ("format",),
                "the file is not a study.",
                f'Begin a study with {{"format": "{FORMAT}", "version": {VERSION}.',
            )
            raise ModelError(*self.faults)
        version = value.get("version")
        if not isinstance(version, Number) or float(version) != VERSION:
            if "version" not in value:
                self.fault("E009", (), 'the key "version" is missing.', f'Add "version": {VERSION}.')
            elif not isinstance(version, Number):
                self.fault("E005", ("version",), "must be a number.", f'Write "version": {VERSION}.')
            else:
                newer = "Update blocks."
                cure = newer if version > VERSION else f"This release reads version {VERSION}."
                self.fault("E005", ("version",), f"version {version!r} cannot be read.", cure)
            raise ModelError(*self.faults)
        STUDY.check(value, (), self)
        entries = _object(value, "runs")
        runs = tuple(self.run(name, entry) for name, entry in entries.items())
        swept, tuned = _object(value, "sweeps"), _object(value, "tunings")
        sweeps = [StudySweep.of(*item) for item in self.many("sweeps", ONE_SWEEP, entries)]
        tunings = [StudyTuning.of(*item) for item in self.many("tunings", ONE_TUNING, {**entries, **swept})]
        places: list[tuple[Steps, Any, str]] = []
        for k, claim in enumerate(_items(value, "claims")):
            places += [(("claims", k), name, "run") for name in named(claim) if "sweep" not in claim]
            places += [(("claims", k, what), claim[what], what) for what in ("sweep", "tuning") if what in claim]
        drawn = STUDY.by_key["figures"].kind.walk(value.get("figures"), ("figures",))
        places += [(found.path, found.value, found.refers) for found in drawn if found.refers in ("run", "sweep")]
        for path, name, what in places:
            known = {"run": entries, "sweep": swept, "tuning": tuned}[what]
            if isinstance(name, str) and name not in known:
                cure = did_you_mean(name[:200], known) or f"{what.capitalize()}s: {', '.join([*known][:20]) or 'none'}."
                self.fault("E105", path, f"there is no {what} {quoted(name)}.", cure)
        name, title = _text(value, "name") or self.path.stem, _text(value, "title")
        study = Study(
            name,
            title or name,
            _lines(value),
            _text(value, "source"),
            runs,
            tuple(sweeps),
            tuple(tunings),
            tuple({key: _text(entry, key) for key in ASSUMED.keys} for entry in _items(value, "assumed")),
            tuple(map(_claim, _items(value, "claims"))),
            tuple(_items(value, "figures")),
            str(self.path.parent),
            str(self.path),
            self.document.places,
        )
        if self.faults:
            raise ModelError(*sorted(self.faults, key=lambda fault: (fault.line, fault.column)), readable=study)
        return study

    def run(self, name: str, entry: Any) -> Run:
        path = ("runs", name)
        if not is_name(name):
            self.fault("E111", path, f"{quoted(name)} is not a name.", "Use letters, digits and _.")
        if not isinstance(entry, dict):
            return Run(name, "", {}, {}, "")
        settings = {key: value for key, value in _object(entry, "settings").items() if key in SETTINGS.keys}
        for key, value in _object(settings, "inputs").items():
            SIGNAL.check(value, (*path, "settings", "inputs", key), self)
        parameters, variants = _object(entry, "parameters"), _object(entry, "variants")
        return Run(name, _text(entry, "diagram"), parameters, settings, " ".join(_lines(entry)), variants)

    def many(self, section: str, kind: Kind, taken: Collection[str]) -> Iterator[tuple[str, dict[str, Any], str]]:
        """Name, entry and doc of each sweep or tuning that can be read. taken: names of runs, and of sweeps."""
        for name, entry in _object(self.document.value, section).items():
            path = (section, name)
            if not is_name(name):
                self.fault("E111", path, f"{quoted(name)} is not a name.", "Use letters, digits and _.")
            if name in taken:
                what = "run" if name in _object(self.document.value, "runs") else "sweep"
                self.fault("E109", path, f"the name is already used by a {what}.", "Choose another name.")
            if kind.fits(entry):
                yield name, entry, " ".join(_lines(entry))


def _claim(entry: Mapping[str, Any]) -> Claim:
    published, tolerance = _number(entry, "published"), _number(entry, "tolerance")
    change, expected = (
        _text(entry, key) if CLAIM.by_key[key].kind.fits(entry.get(key)) else "" for key in ("as", "expect")
    )
    unit, source, reason = (_text(entry, key) for key in ("unit", "source", "reason"))
    sweep, scenario = _text(entry, "sweep"), _text(entry, "scenario")
    runs, measure = () if sweep else tuple(map(str, named(entry))), _text(entry, "measure")
    levels = [(key, _number(entry, key)) for key in ("quantile", "share", "at_most", "at_least")]
    known = [(key, level) for key, level in levels if level is not None]
    told = (_text(entry, "statistic"), math.nan)
    statistic = next((pair for pair in known if pair[0] in ("quantile", "share")), told)
    limit = next((pair for pair in known if pair[0] in ("at_most", "at_least")), None)
    return Claim(
        runs, measure, change, published, unit, source, tolerance or 0.0, expected, reason,
        sweep, scenario, statistic, limit, _text(entry, "tuning"),
    )  # fmt: skip


def _object(value: Mapping[str, Any], key: str) -> dict[str, Any]:
    entry = value.get(key)
    return entry if isinstance(entry, dict) else {}


def _items(value: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    entry = value.get(key)
    return entry if isinstance(entry, list) and all(isinstance(item, dict) for item in entry) else []


def _text(value: Mapping[str, Any], key: str) -> str:
    entry = value.get(key)
    return entry if isinstance(entry, str) else ""


def _number(value: Mapping[str, Any], key: str) -> float | None:
    entry = value.get(key)
    return float(entry) if isinstance(entry, Number) else None


def _lines(value: Mapping[str, Any]) -> tuple[str, ...]:
    doc = value.get("doc", [])
    return ((doc,) if isinstance(doc, str) else tuple(doc)) if DOC.kind.fits(doc) else ()
