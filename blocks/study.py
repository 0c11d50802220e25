"""A study: several runs, their measures beside published numbers, and a verdict on each claim.

A study file names the runs (diagrams with parameters and settings), the claims (a measure of one run, or an
improvement from one run to another, beside the published value with its source, a tolerance and the verdict that is
expected), what was assumed, and the figures. It is judged by whether every claim has its expected verdict, so that a
number that cannot be reproduced is stated with its reason rather than left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import files, jsontext
from .api import Diagram
from .diagram import is_name
from .errors import Fault, ModelError, did_you_mean
from .jsontext import Number, quoted
from .results import Results

__all__ = ["FORMAT", "Claim", "Run", "Study", "StudyResults", "Verdict", "load", "run"]

FORMAT, VERSION = "blocks-study", 1
TOP = ("format", "version", "name", "title", "doc", "source", "runs", "assumed", "claims", "figures")
RUN = ("diagram", "parameters", "variants", "settings", "doc")
CLAIM = ("run", "runs", "measure", "as", "published", "unit", "source", "tolerance", "expect", "reason")
FIGURE = ("name", "title", "doc", "kind", "panels", "from", "to", "xlabel")
PANEL = ("lines", "ylabel", "markers", "band", "inset", "log", "height")
LINE = ("run", "signal", "label", "style", "scale")
MARKER = ("run", "signal", "label", "style", "scale", "x", "y")
EXPECTED = ("reproduced", "not reproduced")


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

    change: "" for one run, "reduction" or "increase" for two. published: None where nothing was published (the value is
    shown, and not judged). tolerance: the largest |value/published - 1| that counts as reproduced.
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

    @property
    def label(self) -> str:
        if not self.change:
            return self.measure
        return f"{self.measure}, {self.change} from {self.runs[0]} to {self.runs[1]}"


@dataclass(frozen=True, slots=True)
class Study:
    """A study as its file says it. folder: where the paths of its diagrams begin."""

    name: str
    title: str
    doc: tuple[str, ...]
    source: str
    runs: tuple[Run, ...]
    assumed: tuple[Mapping[str, str], ...]
    claims: tuple[Claim, ...]
    figures: tuple[Mapping[str, Any], ...]
    folder: str
    file: str


@dataclass(frozen=True, slots=True)
class Verdict:
    """A claim with what came out: the value, its ratio to the published one, and the verdict ("" where none is due)."""

    claim: Claim
    value: float
    ratio: float
    verdict: str

    @property
    def is_expected(self) -> bool:
        return self.verdict == self.claim.expected


@dataclass(frozen=True)
class StudyResults:
    """What a study gave. `is_fine` where every claim has the verdict that the file expects."""

    study: Study
    results: Mapping[str, Results]
    diagrams: Mapping[str, Diagram]
    verdicts: tuple[Verdict, ...]
    seconds: float = 0.0

    @property
    def is_fine(self) -> bool:
        return all(verdict.is_expected for verdict in self.verdicts)


def load(path: str | Path) -> Study:
    """The study of a file. Raises ModelError with all faults of its structure."""
    path = Path(path)
    data = files.read_inside(path, path.resolve().parent, Fault("E007", "", ""))
    return _Reader(jsontext.read(data, file=str(path)), path).study()


def run(
    study: Study,
    *,
    library: Any = (),
    parameters: Mapping[str, Any] | None = None,
    begun: Callable[[str], None] | None = None,
    trust: Any = (),
) -> StudyResults:
    """Run everything and judge every claim.

    parameters: values by "RUN.path" ("IADRC.torque") in place of the file's. begun: called with each run's name.
    trust: as of `Diagram.run`. Raises ModelError, UsageError, and SimulationError.
    """
    import time

    start = time.perf_counter()
    extra: dict[str, dict[str, Any]] = {}
    for key, value in (parameters or {}).items():
        name, _, path = key.partition(".")
        if name not in {r.name for r in study.runs} or not path:
            cure = did_you_mean(name, [r.name for r in study.runs]) or "Name a run and a parameter, as in IADRC.torque."
            raise ModelError(Fault("E106", key, "there is no such run to set a parameter of.", cure))
        extra.setdefault(name, {})[path] = value
    results: dict[str, Results] = {}
    diagrams: dict[str, Diagram] = {}
    for entry in study.runs:
        if begun is not None:
            begun(entry.name)
        diagram = Diagram.load(Path(study.folder) / entry.diagram, library=library)
        diagrams[entry.name] = diagram.with_variants(entry.variants) if entry.variants else diagram
        results[entry.name] = diagram.run(
            parameters={**entry.parameters, **extra.get(entry.name, {})},
            variants=entry.variants,
            trust=trust,
            **dict(entry.settings),
        )
    _check_measures(study, results)
    verdicts = tuple(judge(claim, results) for claim in study.claims)
    return StudyResults(study, results, diagrams, verdicts, time.perf_counter() - start)


def judge(claim: Claim, results: Mapping[str, Results]) -> Verdict:
    """What became of one claim."""
    values = [results[name].measures[claim.measure] for name in claim.runs]
    value = values[0]
    if claim.change:
        change = 100.0 * (values[1] - values[0]) / values[0] if values[0] else math.nan
        value = -change if claim.change == "reduction" else change
    if claim.published is None:
        return Verdict(claim, value, math.nan, "")
    ratio = value / claim.published
    fits = abs(ratio - 1.0) <= claim.tolerance  # false for NaN
    return Verdict(claim, value, ratio, "reproduced" if fits else "not reproduced")


def _check_measures(study: Study, results: Mapping[str, Results]) -> None:
    """Claims about measures that a diagram does not take are told before anything is judged."""
    faults = []
    for claim in study.claims:
        for name in claim.runs:
            known = results[name].measures
            if claim.measure not in known:
                cure = did_you_mean(claim.measure, known) or f"Measures: {', '.join(known) or 'none'}."
                faults.append(
                    Fault("E105", f"claims.{claim.measure}", f"the diagram of {name} has no such measure.", cure)
                )
    if faults:
        raise ModelError(*dict.fromkeys(faults))


@dataclass
class _Reader:
    """Reads a study's document; faults are collected, so that one pass tells them all."""

    document: jsontext.Document
    path: Path
    faults: list[Fault] = field(default_factory=list)

    def fault(self, code: str, path: tuple[str | int, ...], message: str, cure: str = "") -> None:
        known = self.document.positions
        at = path
        while at and at not in known:
            at = at[:-1]
        line, column = known.get(at, (1, 1))
        place = ".".join(str(part) for part in path)
        self.faults.append(Fault(code, place, message, cure, path, str(self.path), line, column))

    def study(self) -> Study:
        value = self.document.value
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            self.fault(
                "E006",
                ("format",),
                "this is not a study.",
                f'A study begins with {{"format": "{FORMAT}", "version": 1.',
            )
            raise ModelError(*self.faults)
        if value.get("version") != VERSION:
            self.fault("E005", ("version",), "this version cannot be read.", f"This release reads version {VERSION}.")
            raise ModelError(*self.faults)
        self.keys(value, (), TOP)
        runs = tuple(self.run(name, entry) for name, entry in self.table(value, "runs").items())
        names = [r.name for r in runs]
        claims = tuple(self.claim(entry, ("claims", i), names) for i, entry in enumerate(self.items(value, "claims")))
        figures = tuple(self.items(value, "figures"))
        for index, figure in enumerate(figures):
            self.figure(figure, ("figures", index), names)
        doc = self.lines(value, ("doc",))
        assumed = tuple(self.assumption(entry, ("assumed", i)) for i, entry in enumerate(self.items(value, "assumed")))
        if self.faults:
            raise ModelError(*self.faults)
        name = self.text(value, (), "name") or self.path.stem
        return Study(name, self.text(value, (), "title") or name, doc, self.text(value, (), "source"), runs, assumed,
                     claims, figures, str(self.path.parent), str(self.path))  # fmt: skip

    def keys(self, value: Mapping[str, Any], path: tuple[str | int, ...], known: tuple[str, ...]) -> None:
        for key in value:
            if key not in known and not key.startswith("x-"):
                cure = did_you_mean(key, known, quote='"') or f"Known: {', '.join(known)}."
                self.fault("E003", (*path, key), f"the key {quoted(key)} is not known here.", cure)

    def table(self, value: Mapping[str, Any], key: str) -> dict[str, Any]:
        entry = value.get(key, {})
        if not isinstance(entry, dict):
            self.fault("E004", (key,), "must be an object {...}.")
            return {}
        return entry

    def items(self, value: Mapping[str, Any], key: str, path: tuple[str | int, ...] = ()) -> list[dict[str, Any]]:
        entry = value.get(key, [])
        if not isinstance(entry, list) or not all(isinstance(item, dict) for item in entry):
            self.fault("E004", (*path, key), "must be a list of objects.")
            return []
        return entry

    def text(self, value: Mapping[str, Any], path: tuple[str | int, ...], key: str) -> str:
        entry = value.get(key, "")
        if not isinstance(entry, str):
            self.fault("E004", (*path, key), "must be a text.")
            return ""
        return entry

    def lines(self, value: Mapping[str, Any], path: tuple[str | int, ...]) -> tuple[str, ...]:
        entry = value.get(str(path[-1]), [])
        entry = [entry] if isinstance(entry, str) else entry
        if not isinstance(entry, list) or not all(isinstance(line, str) for line in entry):
            self.fault("E004", path, "must be a text or a list of lines.")
            return ()
        return tuple(entry)

    def number(self, value: Mapping[str, Any], path: tuple[str | int, ...], key: str) -> float | None:
        entry = value.get(key)
        if entry is not None and not isinstance(entry, Number):
            self.fault("E004", (*path, key), "must be a number.")
            return None
        return None if entry is None else float(entry)

    def run(self, name: str, entry: Any) -> Run:
        path = ("runs", name)
        if not is_name(name):
            self.fault("E111", path, f"{quoted(name)} is not a name.", "Use letters, digits and _.")
        if not isinstance(entry, dict):
            self.fault("E004", path, 'must be an object such as {"diagram": "loop.json"}.')
            return Run(name, "", {}, {}, "")
        self.keys(entry, path, RUN)
        diagram = self.text(entry, path, "diagram")
        if not diagram:
            self.fault("E009", path, 'the key "diagram" is missing.')
        parts = {}
        for key in ("parameters", "settings", "variants"):
            parts[key] = entry.get(key, {})
            if not isinstance(parts[key], dict):
                self.fault("E004", (*path, key), "must be an object {...}.")
                parts[key] = {}
        for block, variant in parts["variants"].items():
            if not isinstance(variant, str):
                self.fault("E004", (*path, "variants", block), "must be the name of a variant.")
        doc = " ".join(self.lines(entry, (*path, "doc")))
        return Run(name, diagram, parts["parameters"], parts["settings"], doc, parts["variants"])

    def claim(self, entry: dict[str, Any], path: tuple[str | int, ...], runs: list[str]) -> Claim:
        self.keys(entry, path, CLAIM)
        named = entry.get("runs", [entry.get("run")])
        if ("run" in entry) == ("runs" in entry) or not isinstance(named, list) or len(named) not in (1, 2):
            self.fault("E009", path, 'a claim names one "run", or two "runs" in a list.')
            named = []
        for name in named:
            if name not in runs:
                self.fault("E105", path, f"there is no run {name!r}.", did_you_mean(str(name), runs))
        change = self.text(entry, path, "as")
        if (len(named) == 2) != (change in ("reduction", "increase")):
            self.fault("E004", path, 'two runs are compared "as" a "reduction" or an "increase"; one run has no "as".')
        published, tolerance = self.number(entry, path, "published"), self.number(entry, path, "tolerance")
        expected, reason = self.text(entry, path, "expect"), self.text(entry, path, "reason")
        if published is None:
            if expected or tolerance is not None:
                self.fault("E009", path, 'a claim with "expect" or "tolerance" needs the "published" number.')
        else:
            if published == 0:
                self.fault("E004", (*path, "published"), "must not be 0: there is no ratio to it.")
            if tolerance is None or not 0 < tolerance < 1:
                self.fault("E009", path, 'a claim states its "tolerance" between 0 and 1, as in 0.05.')
            if expected not in EXPECTED:
                self.fault("E009", path, 'a claim states what to "expect": "reproduced" or "not reproduced".')
            if expected == "not reproduced" and not reason:
                self.fault("E009", path, 'a number that is "not reproduced" needs its "reason".')
        if not self.text(entry, path, "measure"):
            self.fault("E009", path, 'the key "measure" is missing.')
        unit, source = self.text(entry, path, "unit"), self.text(entry, path, "source")
        measure = str(entry.get("measure", ""))
        return Claim(tuple(named), measure, change, published, unit, source, tolerance or 0.0, expected, reason)

    def assumption(self, entry: dict[str, Any], path: tuple[str | int, ...]) -> dict[str, str]:
        self.keys(entry, path, ("what", "why", "contradicts"))
        return {key: self.text(entry, path, key) for key in ("what", "why", "contradicts")}

    def figure(self, entry: dict[str, Any], path: tuple[str | int, ...], runs: list[str]) -> None:
        self.keys(entry, path, FIGURE)
        if not is_name(self.text(entry, path, "name")):
            self.fault("E111", path, 'a figure needs a "name" of letters, digits and _.')
        if entry.get("kind", "time") not in ("time", "spectrum"):
            self.fault("E004", (*path, "kind"), 'must be "time" or "spectrum".')
        for key in ("from", "to"):
            self.number(entry, path, key)
        for i, panel in enumerate(self.items(entry, "panels", path)):
            spot = (*path, "panels", i)
            self.keys(panel, spot, PANEL)
            for key, known in (("lines", LINE), ("markers", MARKER)):
                for k, item in enumerate(self.items(panel, key, spot)):
                    self.keys(item, (*spot, key, k), known)
                    if "run" in item and item["run"] not in runs:
                        self.fault("E105", (*spot, key, k), f"there is no run {item['run']!r}.")
            if not panel.get("lines"):
                self.fault("E009", spot, "a panel needs lines.")
