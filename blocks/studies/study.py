"""A study: several runs, their measures beside published numbers, and a verdict on each claim.

A study file names the runs (diagrams with parameters and settings), the claims (a measure of one run, or an
improvement from one run to another, beside the published value with its source, a tolerance and the verdict that is
expected), what was assumed, and the figures. It is judged by whether every claim has its expected verdict, so that a
number that cannot be reproduced is stated with its reason rather than left out.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..api.diagram import Diagram
from ..model import document as documents
from ..model.diagram import FaultList, beside, is_name
from ..model.flatten import FlatSignal, element_of
from ..model.migrations import STUDY, migrated
from ..model.project import Project
from ..results import plots
from ..results.results import Results
from ..text import json_text
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.json_text import AT_KEY, Number, nearest, place_of, quoted
from ..text.printable import legible

__all__ = [
    "FORMAT", "Claim", "Run", "Study", "StudyResults", "Verdict", "canonical", "checked", "load", "prepared", "run",
]  # fmt: skip

Steps = tuple[str | int, ...]
"""The place of something in a document: keys and indices from the root."""

FORMAT, VERSION = "blocks-study", 1
TOP = ("format", "version", "name", "title", "doc", "source", "runs", "assumed", "claims", "figures")
RUN = ("diagram", "parameters", "variants", "settings", "doc")
CLAIM = ("run", "runs", "measure", "as", "published", "unit", "source", "tolerance", "expect", "reason")
FIGURE = ("name", "title", "doc", "kind", "panels", "from", "to", "xlabel")
PANEL = ("lines", "ylabel", "markers", "band", "inset", "log", "height")
LINE = ("run", "signal", "label", "style", "scale")
MARKER = ("run", "signal", "label", "style", "scale", "x", "y")
ASSUMED = ("what", "why", "contradicts")
SETTINGS = tuple(key for key in documents.RUN if key != "doc")
EXPECTED = ("reproduced", "not reproduced")
CHANGES = ("reduction", "increase")
KINDS = ("time", "spectrum")
STYLES = range(len(plots.STYLES))


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
    """A study as its file says it. folder: where the paths of its diagrams begin. positions: places in its text."""

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
    positions: Mapping[Any, tuple[int, int]] = field(default_factory=dict, compare=False, repr=False)

    def fault(self, code: str, place: str, message: str, cure: str = "", path: Steps = ()) -> Fault:
        """A fault with its place in the file: that of `path`, or of the nearest thing around it."""
        path = nearest(path, self.positions)
        line, column = self.positions.get(path, (0, 0))
        return Fault(code, place, message, cure, path, self.file, line, column)


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
    """What a study gave. `is_fine` where every claim has the verdict that the file expects.

    missing: the runs that were not made, or not to their end, as Ctrl-C came before; claims about them are not judged.
    """

    study: Study
    results: Mapping[str, Results]
    diagrams: Mapping[str, Diagram]
    verdicts: tuple[Verdict, ...]
    seconds: float = 0.0
    missing: tuple[str, ...] = ()

    @property
    def is_fine(self) -> bool:
        return not self.missing and all(verdict.is_expected for verdict in self.verdicts)


def load(path: str | Path) -> Study:
    """The study of a file. Raises ModelError with all faults of its structure."""
    path = Path(path)
    data = documents.read_inside(path, Project(path.resolve().parent), Fault("E007", "", ""))
    document, first = json_text.meant(data, file=str(path))
    made = _Reader(document, path, list(first)).study()
    if first:
        raise ModelError(*first, readable=made)
    return made


def checked(path: str | Path, *, library: Any = ()) -> tuple[Study | None, list[Fault]]:
    """The study of a file, None where it cannot be read, and all faults: of its structure and of what it asks for."""
    try:
        made, first = load(path), tuple[Fault, ...]()
    except ModelError as error:
        made, first = error.readable, error.faults
    try:
        if made is not None:
            prepared(made, library=library)
    except ModelError as error:
        faults = FaultList()
        faults.update((*first, *beside(error.faults, first)))
        return made, faults.in_order()
    except Exception:
        if not first:  # what is half read may make anything fail
            raise
    return made, list(first)


def canonical(document: json_text.Document) -> tuple[str, int]:
    """The canonical text of a study's document, in the newest version, and the version that it has.

    One run, claim, assumption and line of a figure a line; the keys of the study in their order, all others as they
    were. What it says may be wrong; its structure may not. Raises ModelError with the faults of that.
    """
    reader = _Reader(document, Path(document.file))
    with contextlib.suppress(ModelError):
        reader.study()
    wrong = [fault for fault in reader.faults if fault.code.startswith("E0")]
    if wrong:
        raise ModelError(*wrong)
    value = reader.document.value
    keys = [key for key in (documents.SCHEMA, *TOP) if key in value]
    made = {key: value[key] for key in (*keys, *(key for key in value if key not in keys))}
    return json_text.write(made, one_per_line=_one_per_line), reader.version


def _one_per_line(path: Steps, value: Any) -> bool:
    """A line for each key of a study, run, claim, assumption, line of doc; for each of a figure, a panel and a line."""
    if path[:1] == ("figures",):
        return path[2:3] in ((), ("panels",)) and path[4:] in ((), ("lines",))
    return path in ((), ("doc",), ("runs",), ("assumed",), ("claims",))


def run(
    study: Study,
    *,
    library: Any = (),
    parameters: Mapping[str, Any] | None = None,
    begun: Callable[[str], None] | None = None,
    finished: Callable[[str, Results], None] | None = None,
    trust: Any = (),
) -> StudyResults:
    """Run everything and judge every claim.

    parameters: values by "RUN.path" ("IADRC.torque") in place of the file's. begun: called with each run's name.
    finished: called with its name and its results as soon as they are there, so that nothing is lost where a later run
    fails. trust: as of `Diagram.run`. Ctrl-C returns the runs that are done (`missing`). Raises ModelError, UsageError,
    and SimulationError.
    """
    import time

    start = time.perf_counter()
    extra = _by_run(study, parameters or {})
    diagrams = prepared(study, library=library, parameters=parameters)
    results: dict[str, Results] = {}
    with contextlib.suppress(KeyboardInterrupt):
        for entry in study.runs:
            if begun is not None:
                begun(entry.name)
            parameters = {**entry.parameters, **extra.get(entry.name, {})}
            made = diagrams[entry.name].run(parameters=parameters, trust=trust, **dict(entry.settings))
            if made.interrupted:
                break
            results[entry.name] = made
            if finished is not None:
                finished(entry.name, made)
    missing = tuple(entry.name for entry in study.runs if entry.name not in results)
    verdicts = tuple(judge(claim, results) for claim in study.claims if not {*claim.runs} & {*missing})
    return StudyResults(study, results, diagrams, verdicts, time.perf_counter() - start, missing)


def _by_run(study: Study, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Values by "RUN.path" as values by path, for each run. Raises ModelError (E106)."""
    made: dict[str, dict[str, Any]] = {}
    names = [entry.name for entry in study.runs]
    for key, value in parameters.items():
        name, _, path = key.partition(".")
        if name not in names or not path:
            cure = did_you_mean(name, names) or "Name a run and a parameter, as in IADRC.torque."
            raise ModelError(Fault("E106", legible(key), "there is no such run to set a parameter of.", cure))
        made.setdefault(name, {})[path] = value
    return made


def prepared(study: Study, *, library: Any = (), parameters: Mapping[str, Any] | None = None) -> dict[str, Diagram]:
    """The diagrams of a study by run, with their variants: all that can be wrong is found before the first one runs.

    parameters: as of `run`. Raises ModelError with the faults of all diagrams, of the values and settings that the
    runs give to them, and of claims about measures that they do not take.
    """
    faults: dict[Fault, None] = {}
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
            elements = {signal: element_of(signal, flat.signals) for signal in flat.log}
            recorded[entry.name] = {signal: made for signal, made in elements.items() if made is not None}
        except (ModelError, UsageError) as error:
            for fault in error.faults:
                faults[fault if fault.file else _of_run(study, entry, fault)] = None
    for k, claim in enumerate(study.claims):
        for name in claim.runs:
            known = diagrams[name].value.measures if name in diagrams else {claim.measure: None}
            if claim.measure not in known:
                cure = did_you_mean(claim.measure, known) or f"Measures: {', '.join(known) or 'none'}."
                message = f"the diagram of {name} has no measure {quoted(claim.measure)}."
                faults[study.fault("E105", f"claims[{k}]", message, cure, ("claims", k, "measure"))] = None
    for place, item in _drawn(study):
        known = recorded.get(item.get("run", ""), {})
        if known and "signal" in item and element_of(item["signal"], known) is None:
            cure = did_you_mean(item["signal"], known) or 'Name it in the "log" of the diagram or of the run.'
            message = f"the run {item['run']} does not record {quoted(item['signal'])}."
            faults[study.fault("E105", place_of(place), message, cure, (*place, "signal"))] = None
    if faults:
        raise ModelError(*faults)
    return diagrams


def _drawn(study: Study) -> Iterator[tuple[Steps, Mapping[str, Any]]]:
    """The lines and markers of all figures, with their places in the file."""
    for i, figure in enumerate(study.figures):
        for k, panel in enumerate(figure["panels"]):
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


@dataclass
class _Reader:
    """Reads a study's document; faults are collected, so that one pass tells them all."""

    document: json_text.Document
    path: Path
    faults: list[Fault] = field(default_factory=list)
    version: int = VERSION  # that the file has

    def fault(self, code: str, path: Steps, message: str, cure: str = "") -> None:
        known = self.document.places
        line, column = known.get(nearest(path, known), (1, 1))
        path = path[:-1] if path[-1:] == (AT_KEY,) else path
        place = legible(".".join(str(part) for part in path))
        self.faults.append(Fault(code, place, message, cure, path, str(self.path), line, column))

    def study(self) -> Study:
        value = self.document.value
        if not isinstance(value, dict) or value.get("format") != FORMAT:
            self.fault(
                "E006",
                ("format",),
                "this is not a study.",
                f'A study begins with {{"format": "{FORMAT}", "version": {VERSION}.',
            )
            raise ModelError(*self.faults)
        made = migrated(self.document, STUDY, VERSION)
        if made is None:
            version = value.get("version")
            if "version" not in value:
                self.fault("E009", (), 'the key "version" is missing.', f'Add "version": {VERSION}.')
            elif not isinstance(version, Number):
                self.fault("E005", ("version",), "must be a number.", f'Write "version": {VERSION}.')
            else:
                newer = "Update blocks (pip install -U blocks-cosim)."
                cure = newer if version > VERSION else f"This release reads version {VERSION}."
                self.fault("E005", ("version",), f"version {version!r} cannot be read.", cure)
            raise ModelError(*self.faults)
        self.document, self.version = made
        value = self.document.value
        self.keys(value, (), (documents.SCHEMA, *TOP))
        self.text(value, (), documents.SCHEMA)
        name = self.text(value, (), "name")
        if "name" in value and not is_name(name):  # of a folder, unless another is asked for
            self.fault("E111", ("name",), f"{quoted(name)} is not a name.", "Use letters, digits and _.")
        runs = tuple(self.run(name, entry) for name, entry in self.object(value, (), "runs").items())
        names = [r.name for r in runs]
        claims = [self.claim(entry, ("claims", i), names) for i, entry in enumerate(self.items(value, (), "claims"))]
        figures = self.items(value, (), "figures")
        for index, figure in enumerate(figures):
            self.figure(figure, ("figures", index), names)
        doc = self.lines(value, (), "doc")
        assumed = [self.assumption(entry, ("assumed", i)) for i, entry in enumerate(self.items(value, (), "assumed"))]
        title, source = self.text(value, (), "title"), self.text(value, (), "source")
        name = name or self.path.stem
        study = Study(name, title or name, doc, source, runs, tuple(assumed), tuple(claims), tuple(figures),
                      str(self.path.parent), str(self.path), self.document.places)  # fmt: skip
        if self.faults:
            raise ModelError(*self.faults, readable=study)
        return study

    # --- kinds of values ---------------------------------------------------------------------------------------

    def keys(self, value: Mapping[str, Any], path: Steps, known: tuple[str, ...]) -> None:
        for key in value:
            if key not in known and not key.startswith("x-"):
                cure = did_you_mean(key[:200], known, quote='"')
                cure = cure or f"Known: {', '.join(known)}; own keys begin with x-."
                self.fault("E003", (*path, key, AT_KEY), f"the key {quoted(key)} is not known here.", cure)

    def object(self, value: Mapping[str, Any], path: Steps, key: str) -> dict[str, Any]:
        entry = value.get(key, {})
        if not isinstance(entry, dict):
            self.fault("E004", (*path, key), "must be an object {...}.")
            return {}
        return entry

    def items(self, value: Mapping[str, Any], path: Steps, key: str) -> list[dict[str, Any]]:
        entry = value.get(key, [])
        if not isinstance(entry, list) or not all(isinstance(item, dict) for item in entry):
            self.fault("E004", (*path, key), "must be a list of objects.")
            return []
        return entry

    def text(self, value: Mapping[str, Any], path: Steps, key: str) -> str:
        entry = value.get(key, "")
        if not isinstance(entry, str):
            self.fault("E004", (*path, key), "must be a text.")
            return ""
        return entry

    def needed(self, value: Mapping[str, Any], path: Steps, key: str) -> str:
        """A text that must be there."""
        before = len(self.faults)
        made = self.text(value, path, key)
        if not made and len(self.faults) == before:
            self.fault("E009", path, f'the key "{key}" is missing.' if key not in value else f'"{key}" is empty.')
        return made

    def choice(self, value: Mapping[str, Any], path: Steps, key: str, known: tuple[str, ...]) -> str:
        entry = value.get(key, known[0])
        if not isinstance(entry, str) or entry not in known:
            self.fault("E004", (*path, key), f"must be {' or '.join(map(quoted, known))}.")
            return ""
        return entry if key in value else ""

    def lines(self, value: Mapping[str, Any], path: Steps, key: str) -> tuple[str, ...]:
        entry = value.get(key, [])
        entry = [entry] if isinstance(entry, str) else entry
        if not isinstance(entry, list) or not all(isinstance(line, str) for line in entry):
            self.fault("E004", (*path, key), "must be a text or a list of lines.")
            return ()
        return tuple(entry)

    def number(self, value: Mapping[str, Any], path: Steps, key: str) -> float | None:
        if key not in value:
            return None
        if not isinstance(value[key], Number):
            self.fault("E004", (*path, key), "must be a number.")
            return None
        return float(value[key])

    def numbers(self, value: Mapping[str, Any], path: Steps, key: str, count: int) -> None:
        entry = value.get(key, [Number("0")] * count)
        if not (isinstance(entry, list) and len(entry) == count and all(isinstance(item, Number) for item in entry)):
            self.fault("E004", (*path, key), f"must be a list of {count} numbers.")

    # --- parts of a study --------------------------------------------------------------------------------------

    def run(self, name: str, entry: Any) -> Run:
        path = ("runs", name)
        if not is_name(name):
            self.fault("E111", path, f"{quoted(name)} is not a name.", "Use letters, digits and _.")
        if not isinstance(entry, dict):
            self.fault("E004", path, 'must be an object such as {"diagram": "loop.json"}.')
            return Run(name, "", {}, {}, "")
        self.keys(entry, path, RUN)
        diagram = self.needed(entry, path, "diagram")
        parameters, settings = self.object(entry, path, "parameters"), self.object(entry, path, "settings")
        variants = self.object(entry, path, "variants")
        for key, value in parameters.items():
            if value is None or (isinstance(value, dict) and "value" not in value):
                what = 'must be a value, such as 0.2, "=kp" or {"value": 200, "unit": "mOhm"}.'
                self.fault("E004", (*path, "parameters", key), what)
        self.keys(settings, (*path, "settings"), SETTINGS)
        for key, value in self.object(settings, (*path, "settings"), "inputs").items():
            for code, spot, message in documents.input_faults(value, (*path, "settings", "inputs", key)):
                self.fault(code, spot, message)
        for block, variant in variants.items():
            if not isinstance(variant, str):
                self.fault("E004", (*path, "variants", block), "must be the name of a variant.")
        doc = " ".join(self.lines(entry, path, "doc"))
        settings = {key: value for key, value in settings.items() if key in SETTINGS}
        return Run(name, diagram, parameters, settings, doc, variants)

    def claim(self, entry: dict[str, Any], path: Steps, runs: list[str]) -> Claim:
        self.keys(entry, path, CLAIM)
        named = entry.get("runs", [entry.get("run")])
        wanted = 2 if "runs" in entry else 1
        if ("run" in entry) == ("runs" in entry) or not isinstance(named, list) or len(named) != wanted:
            self.fault("E009", path, 'a claim names one "run", or two "runs" in a list.')
            named = []
        for name in named:
            self.named(name, path, runs)
        change = self.choice(entry, path, "as", CHANGES)
        if named and (len(named) == 2) != ("as" in entry):
            self.fault("E004", path, 'two runs are compared "as" a "reduction" or an "increase"; one run has no "as".')
        published, tolerance = self.number(entry, path, "published"), self.number(entry, path, "tolerance")
        expected, reason = self.choice(entry, path, "expect", EXPECTED), self.text(entry, path, "reason")
        if published == 0:
            self.fault("E004", (*path, "published"), "must not be 0: there is no ratio to it.")
        if tolerance is not None and not 0 < tolerance < 1:
            self.fault("E004", (*path, "tolerance"), "must lie between 0 and 1, as in 0.05.")
        if "published" not in entry:
            if "expect" in entry or "tolerance" in entry:
                self.fault("E009", path, 'a claim with "expect" or "tolerance" needs the "published" number.')
        else:
            if "tolerance" not in entry:
                self.fault("E009", path, 'a claim states its "tolerance" between 0 and 1, as in 0.05.')
            if "expect" not in entry:
                self.fault("E009", path, 'a claim states what to "expect": "reproduced" or "not reproduced".')
            if expected == "not reproduced" and not reason:
                self.fault("E009", path, 'a number that is "not reproduced" needs its "reason".')
        measure = self.needed(entry, path, "measure")
        unit, source = self.text(entry, path, "unit"), self.text(entry, path, "source")
        names = tuple(map(str, named))
        return Claim(names, measure, change, published, unit, source, tolerance or 0.0, expected, reason)

    def named(self, name: Any, path: Steps, runs: list[str]) -> None:
        """Check that a run is there."""
        if not isinstance(name, str):
            self.fault("E004", path, "a run is named by a text.")
        elif name not in runs:
            cure = did_you_mean(name[:200], runs) or f"Runs: {', '.join(runs[:20]) or 'none'}."
            self.fault("E105", path, f"there is no run {quoted(name)}.", cure)

    def assumption(self, entry: dict[str, Any], path: Steps) -> dict[str, str]:
        self.keys(entry, path, ASSUMED)
        return {key: self.text(entry, path, key) for key in ASSUMED}

    def figure(self, entry: dict[str, Any], path: Steps, runs: list[str]) -> None:
        self.keys(entry, path, FIGURE)
        if not is_name(entry.get("name")):
            self.fault("E111", path, 'a figure needs a "name" of letters, digits and _.')
        for key in ("title", "xlabel"):
            self.text(entry, path, key)
        self.lines(entry, path, "doc")
        self.choice(entry, path, "kind", KINDS)
        for key in ("from", "to"):
            self.number(entry, path, key)
        if entry.get("panels", []) == []:
            self.fault("E009", path, "a figure needs panels.")
        for i, panel in enumerate(self.items(entry, path, "panels")):
            self.panel(panel, (*path, "panels", i), runs)

    def panel(self, panel: dict[str, Any], path: Steps, runs: list[str]) -> None:
        self.keys(panel, path, PANEL)
        self.text(panel, path, "ylabel")
        self.numbers(panel, path, "band", 2)
        self.numbers(panel, path, "inset", 4)
        if not isinstance(panel.get("log", False), bool):
            self.fault("E004", (*path, "log"), "must be true or false.")
        height = self.number(panel, path, "height")
        if height is not None and height <= 0:
            self.fault("E004", (*path, "height"), "must be above 0.")
        if panel.get("lines", []) == []:
            self.fault("E009", path, "a panel needs lines.")
        for key, known in (("lines", LINE), ("markers", MARKER)):
            for k, item in enumerate(self.items(panel, path, key)):
                spot = (*path, key, k)
                self.keys(item, spot, known)
                if key == "lines" or "signal" in item or "run" in item:
                    self.needed(item, spot, "signal")
                    if "run" in item:
                        self.named(item["run"], (*spot, "run"), runs)
                    else:
                        self.fault("E009", spot, 'the key "run" is missing.')
                elif not {"x", "y"} <= item.keys():
                    self.fault("E009", spot, 'a marker has "run" and "signal", or "x" and "y".')
                self.text(item, spot, "label")
                for word in ("scale", "x", "y"):
                    self.number(item, spot, word)
                style = item.get("style")
                if style is not None and not (isinstance(style, Number) and float(style) in map(float, STYLES)):
                    what = f"must be an integer from 0 to {STYLES[-1]}, or null for a dotted line."
                    self.fault("E004", (*spot, "style"), what)
