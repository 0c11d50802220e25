"""A study as its file says it: runs, sweeps, tunings, claims, assumptions and figures; and its reader."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..api.case import Case
from ..api.diagram import Diagram
from ..model.diagram_grammar import DOC, SIGNAL
from ..model.diagram_value import is_name
from ..model.study_grammar import ASSUMED, CLAIM, FORMAT, ONE_SWEEP, ONE_TUNING, SETTINGS, STUDY, VERSION, named
from ..model.trust import Paths
from ..results.results import Results
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.grammar import Kind, Steps
from ..text.json_document import AT_KEY, Document, nearest
from ..text.json_number import Number
from ..text.printable import legible, quoted
from .study_sweeps import StudySweep
from .study_tunings import StudyTuning


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a study: a diagram file with parameters, variants of blocks and settings of its own."""

    name: str
    diagram: str
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    doc: str
    variants: Mapping[str, str] = field(default_factory=dict)

    def measured(self, diagram: Diagram) -> list[str]:
        """Return the measures that claims may name."""
        return [*diagram.value.measures]

    def made(self, diagram: Diagram, parameters: Mapping[str, object], trust: Paths) -> Results:
        """Return the results; of a run that Ctrl-C ended they are `interrupted`. Raises as `Diagram.run`."""
        return diagram.run(self.case(parameters, trust))

    def case(self, parameters: Mapping[str, object], trust: Paths = ()) -> Case:
        """Return what the run is of. parameters: its own, and those that were given on top."""
        return Case(parameters=parameters, trust=trust, **self.settings)


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

    def sweep(self, name: str) -> StudySweep | None:
        """Return the sweep of this name, or None."""
        return next((entry for entry in self.sweeps if entry.name == name), None)

    def fault(self, code: str, place: str, message: str, cure: str = "", path: Steps = ()) -> Fault:
        """A fault with its place in the file: that of `path`, or of the nearest thing around it."""
        path = nearest(path, self.positions)
        line, column = self.positions.get(path, (0, 0))
        return Fault(code, place, message, cure, path, self.file, line, column)


@dataclass
class StudyReader:
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
        count = len(self.faults)
        self.check_head(value)
        if len(self.faults) > count:
            raise ModelError(*self.faults)
        STUDY.check(value, (), self)
        entries = _object(value, "runs")
        runs = tuple(self.run(name, entry) for name, entry in entries.items())
        swept, tuned = _object(value, "sweeps"), _object(value, "tunings")
        sweeps = [StudySweep.of(*item) for item in self.many("sweeps", ONE_SWEEP, entries)]
        tunings = [StudyTuning.of(*item) for item in self.many("tunings", ONE_TUNING, {**entries, **swept})]
        self.check_names(value, {"run": entries, "sweep": swept, "tuning": tuned})
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

    def check_head(self, value: object) -> None:
        """Collect the faults of the format and the version."""
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            cure = f'Begin a study with {{"format": "{FORMAT}", "version": {VERSION}.'
            self.fault("E006", ("format",), "the file is not a study.", cure)
        elif "version" not in value:
            self.fault("E009", (), 'the key "version" is missing.', f'Add "version": {VERSION}.')
        elif not isinstance(version := value["version"], Number):
            self.fault("E005", ("version",), "must be a number.", f'Write "version": {VERSION}.')
        elif float(version) != VERSION:
            cure = "Update blocks." if version > VERSION else f"This release reads version {VERSION}."
            self.fault("E005", ("version",), f"version {version!r} cannot be read.", cure)

    def check_names(self, value: Mapping[str, object], entries: Mapping[str, Collection[str]]) -> None:
        """Collect the faults of claims and figures about runs, sweeps and tunings that are not there."""
        places: list[tuple[Steps, object, str]] = []
        for k, claim in enumerate(_items(value, "claims")):
            places += [(("claims", k), name, "run") for name in named(claim) if "sweep" not in claim]
            places += [(("claims", k, what), claim[what], what) for what in ("sweep", "tuning") if what in claim]
        drawn = STUDY.by_key["figures"].kind.walk(value.get("figures"), ("figures",))
        places += [(found.path, found.value, found.refers) for found in drawn if found.refers in ("run", "sweep")]
        for path, name, what in places:
            known = entries[what]
            if isinstance(name, str) and name not in known:
                cure = did_you_mean(name[:200], known) or f"{what.capitalize()}s: {', '.join([*known][:20]) or 'none'}."
                self.fault("E105", path, f"there is no {what} {quoted(name)}.", cure)

    def run(self, name: str, entry: object) -> Run:
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


def _claim(entry: Mapping[str, object]) -> Claim:
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


def _object(value: Mapping[str, object], key: str) -> dict[str, Any]:
    entry = value.get(key)
    return entry if isinstance(entry, dict) else {}


def _items(value: Mapping[str, object], key: str) -> list[dict[str, object]]:
    entry = value.get(key)
    return entry if isinstance(entry, list) and all(isinstance(item, dict) for item in entry) else []


def _text(value: Mapping[str, object], key: str) -> str:
    entry = value.get(key)
    return entry if isinstance(entry, str) else ""


def _number(value: Mapping[str, object], key: str) -> float | None:
    entry = value.get(key)
    return float(entry) if isinstance(entry, Number) else None


def _lines(value: Mapping[str, Any]) -> tuple[str, ...]:
    doc = value.get("doc", [])
    return ((doc,) if isinstance(doc, str) else tuple(doc)) if DOC.kind.fits(doc) else ()
