"""A model of Simulink as a diagram file, and the report of what was taken, decided, left out and unknown."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from ..model.diagram_grammar import LEAST_RTOL
from ..text.errors import Fault, ModelError
from ..text.printable import counted, one_line
from . import rules_dynamic, rules_math, rules_wiring  # noqa: F401
from .matlab import Unread, Value
from .numbers import Given, Raw, Scope, Unknown, as_json, read_workspace, variables
from .reading import read_model
from .systems import Context, Mapped, Rule, legal, map_system
from .tags import with_tags
from .tree import Block, Model

_RULES = rules_math.RULES  # which the other modules of rules fill when they are loaded
_STIFF = {"ode15s", "ode23s", "ode23t", "ode23tb", "ode14x", "ode1be", "daessc"}
_FIXED = {"ode1": "euler", "ode2": "rk4", "ode3": "rk4", "ode4": "rk4", "ode5": "rk4", "ode8": "rk4"}
_AUTO = {"VariableStepAuto", "VariableStepDiscrete", "FixedStepAuto", "FixedStepDiscrete"}
KINDS = ("decided", "left out", "unknown")
DEFAULT_STOP = 10


class Entry(NamedTuple):
    """A line of the report. kind: one of KINDS. path: in the model. cure: what the user can do, or ""."""

    kind: str
    path: str
    what: str
    cure: str


class Taken(NamedTuple):
    """A block of the model that is in the diagram. name: its path there; "": it is no block there, as a Scope."""

    path: str
    kind: str
    name: str


@dataclass(frozen=True)
class Report:
    """Tells what an import did. taken: blocks. entries: lines about decisions, and about what is missing."""

    model: str
    taken: Sequence[Taken]
    entries: Sequence[Entry]

    def of(self, kind: str) -> list[Entry]:
        """Return the entries of a kind."""
        return [entry for entry in self.entries if entry.kind == kind]

    @property
    def is_whole(self) -> bool:
        """Whether nothing is missing in the diagram."""
        return not self.of("left out") and not self.of("unknown")

    def to_json(self) -> list[dict[str, str]]:
        """Return one object for each line."""
        taken = [{"event": "taken", "path": one.path, "type": one.kind, "name": one.name} for one in self.taken]
        return taken + [
            {"event": one.kind, "path": one.path, "what": one.what, "cure": one.cure} for one in self.entries
        ]

    def __str__(self) -> str:
        lines = [f"{self.model}: {counted(len(self.taken), 'block')} taken"]
        for kind in KINDS:
            found = self.of(kind)
            if found:
                lines.append(f"{kind} ({len(found)})")
                lines += [f"  {one.path}: {one.what}.{f' {one.cure}' if one.cure else ''}" for one in found]
        return "\n".join("".join(char if char.isprintable() else "?" for char in line) for line in lines)


class Imported(NamedTuple):
    """The document of a diagram file, and the report."""

    document: dict[str, Any]
    report: Report


def import_model(
    path: str | os.PathLike[str],
    workspace: Sequence[Given] = (),
    folder: str | os.PathLike[str] | None = None,
) -> Imported:
    """Make a diagram of a model. workspace: of its variables. folder: of what it refers to.

    Raises:
        ModelError: E007, E010 for a file that is no model, or a library.
        UsageError: E501 for a workspace that cannot be read.
    """
    model = _read(path)
    if model.kind == "Library":
        message = "it is a library: its blocks are parts of models, and it does not run."
        raise ModelError(Fault("E010", model.path.name, message, "Import a model that uses it."))
    base, unread = read_workspace(workspace)
    known, more = variables(model, base)
    entries = _unread([*unread, *more], model.name)
    cure = "Save it with the settings inside of the model." if model.unread else ""
    entries += [Entry("unknown", model.name, f"{part} is not read", cure) for part in model.unread]
    fallback, run, told = _settings(model, known)
    entries += [Entry("decided", model.name, *one) for one in told]
    scope = Scope(known)
    beside = model.path.parent if folder is None else Path(folder)
    shortest = fallback.value if fallback else float(f"{(run['stop'] - run.get('start', 0)) / 10_000:.2g}")
    context = Context(model, rule_of, _Opened(beside).open, beside, shortest, opened=(model.path.stem,))
    mapped = map_system(context, model.system, scope, {})
    context.fallback = fallback or _one_rate(mapped)
    if mapped.is_late or context.fallback:
        scope.used.clear()
        context.kept.clear()
        mapped = map_system(context, model.system, scope, {})
    return _finished(model, mapped, run, entries)


def _unread(lines: Sequence[tuple[str, Unread]], model: str) -> list[Entry]:
    """Return an entry for each file or callback with code that is not read and may give variables."""
    found: dict[str, list[Unread]] = {}
    for place, one in lines:
        if not one.text or "=" in one.text or re.match(r"\s*(load|run|evalin|assignin)\b", one.text):
            found.setdefault(place, []).append(one)
    entries, cure = [], "Save its variables in a .mat file if the model needs them."
    for place, rest in found.items():
        if not rest[0].text:
            entries.append(Entry("unknown", place, f"it is not read: {rest[0].why}", cure))
            continue
        first = f"first line {rest[0].line} ({one_line(rest[0].text)[:60]}): {rest[0].why}"
        entries.append(Entry("decided", place, f"{counted(len(rest), 'line')} not read, {first}", cure))
    return entries


def rule_of(block: Block) -> Rule | None:
    """Return the rule of a block."""
    if block.type != "Reference":
        return _RULES.get(block.type)
    source = block.values.get("SourceType", "").replace("\n", " ").strip()
    name = block.values.get("SourceBlock", "").rpartition("/")[2].replace("\n", " ").strip()
    for key in (f"Reference {source}", f"Reference {name}", _OF_LIBRARY.get(name, "")):
        if key in _RULES:
            return _RULES[key]
    return rules_wiring.linked if source in ("", "SubSystem") or "/" in block.values.get("SourceBlock", "") else None


_OF_LIBRARY = {
    "Ramp": "Ramp", "Repeating Sequence": "Reference Repeating table", "Chirp Signal": "Reference chirp",
    "PID Controller": "Reference PID 1dof", "Discrete PID Controller": "Reference PID 1dof",
    "PID Controller (2DOF)": "Reference PID 2dof",
    "XY Graph": "Reference XY scope.", "Compare To Zero": "Reference Compare To Zero",
}  # fmt: skip


def _read(path: str | os.PathLike[str]) -> Model:
    """Return a model whose tags do not cross the borders of systems."""
    model = read_model(path)
    return replace(model, system=with_tags(model))


class _Opened:
    """The models and libraries beside a model, each read once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.models: dict[str, Model | None] = {}

    def open(self, name: str) -> Model | None:
        if name not in self.models:
            self.models[name] = None
            for ending in (".slx", ".mdl"):
                path = self.folder / f"{name}{ending}"
                if re.fullmatch(r"\w+", name) and path.is_file():
                    self.models[name] = _read(path)
                    break
        return self.models[name]


def _one_rate(mapped: Mapped) -> Raw | None:
    """Return the period of the sampled blocks of a diagram, if they have one."""
    found: dict[str, Any] = {}
    left: list[Any] = [mapped.body]
    while left:
        one = left.pop()
        for entry in one.get("blocks", {}).values():
            if "diagram" in entry:
                left.append(entry["diagram"])
            period = entry.get("parameters", {}).get("period")
            if period is not None and entry.get("type") not in ("SquareWave", "Sawtooth"):
                found[repr(period)] = period
    if len(found) != 1:
        return None
    period = next(iter(found.values()))
    return Raw(period, float(period) if not isinstance(period, str) else math.nan)


def _settings(model: Model, known: Mapping[str, Value]) -> tuple[Raw | None, dict[str, Any], list[tuple[str, str]]]:
    """Return the step of a solver with fixed steps, the settings of the run, and what was decided about them."""
    scope, given, told = Scope(known), model.settings, []  # type: Scope, Mapping[str, str], list[tuple[str, str]]

    def number(key: str, default: float | None) -> float | None:
        text = given.get(key, "auto").strip()
        if text in ("auto", "", "-1"):
            return default
        try:
            return scope.raw(text).value
        except Unknown as unknown:
            told.append(
                (
                    f"{key} is not known ({unknown}): {default if default is not None else 'left out'}",
                    "Set it in `run`.",
                )
            )
            return default

    run: dict[str, Any] = {}
    start, stop = number("StartTime", 0.0) or 0.0, number("StopTime", float(DEFAULT_STOP))
    if stop is None or not math.isfinite(stop) or stop <= start:
        told.append(
            (f"its stop time is {given.get('StopTime')}: {DEFAULT_STOP} s after the start", "Set `stop` in `run`.")
        )
        stop = start + DEFAULT_STOP
    if start:
        run["start"] = as_json(start)
    run["stop"] = as_json(stop)
    solver = given.get("SolverName") or given.get("Solver") or "ode45"
    step = (
        number("FixedStep", None)
        if solver in _FIXED or "Fixed" in solver or given.get("SolverType") == "Fixed-step"
        else None
    )
    if solver in _FIXED:
        run["method"] = _FIXED[solver]
        if step is None:
            step = (stop - start) / 50
            told.append((f"its step is auto: {step:g} s, which is a fiftieth of the run", "Set `step` in `run`."))
        run["step"] = as_json(step)
        if solver not in ("ode1", "ode4"):
            told.append((f"its solver is {solver}: {run['method']}", "Set `method` in `run`."))
    elif solver in _STIFF:
        run["method"] = "radau"
        told.append((f"its solver is {solver}: radau", "Set `method` in `run`."))
    elif solver in _AUTO:
        run["method"] = "auto"
    elif solver not in ("ode45", "discrete"):
        told.append((f"its solver is {solver}: dopri5", "Set `method` in `run`."))
    for key, word, usual in (("RelTol", "rtol", 1e-6), ("AbsTol", "atol", 1e-9)):
        tolerance = number(key, None)
        if tolerance is not None and 0 < tolerance < usual:  # a looser one is no reason to compute less exactly
            run[word] = max(tolerance, LEAST_RTOL) if word == "rtol" else tolerance
    if run.get("method") not in _FIXED.values() and (longest := number("MaxStep", None)) is not None:
        told.append((f"its largest step of {longest:g} s is left out: steps follow from tolerances", ""))
    fallback = Raw(as_json(step), step) if step and step > 0 else None
    return fallback, run, told


def _finished(model: Model, mapped: Mapped, run: dict[str, Any], entries: list[Entry]) -> Imported:
    body = mapped.body
    doc = "\n".join(
        [f"From the Simulink model {model.name}.", *(_text_of(one.text) for one in model.system.annotations)]
    )
    outputs, inputs = body.get("outputs", {}), body.get("inputs", {})
    shown = [one for one in mapped.log if "." in one or one.partition("[")[0] in inputs]
    log = [*outputs, *dict.fromkeys(one for one in shown if one not in outputs.values())]
    if mapped.stops:
        run["stop_when"] = " or ".join(dict.fromkeys(mapped.stops))
    document: dict[str, Any] = {
        "format": "blocks-diagram",
        "version": 3,
        "name": legal(model.name, set()),
        "doc": doc.strip(),
    }
    document |= body
    document["run"] = run | ({"log": log} if log else {})
    layout = document.pop("layout", None)
    if layout:
        document["layout"] = layout
    entries += [Entry(note.kind, _path(block), note.what, note.cure) for block, note in mapped.notes]
    missing = {(entry.path) for entry in entries if entry.kind in ("left out", "unknown")}
    callbacks = [name for name in model.callbacks if name not in ("PreLoadFcn", "InitFcn")]
    callbacks += [name for block in model.system.walk() for name in block.callbacks]
    if callbacks:
        names = ", ".join(dict.fromkeys(callbacks))
        entries.append(Entry("decided", model.name, f"{counted(len(callbacks), 'callback')} not run: {names}", ""))
    if inputs:
        what = f"its inputs are 0 unless a run gives them: {', '.join(inputs)}"
        entries.append(Entry("decided", model.name, what, f"Give them by --input {next(iter(inputs))}=VALUE."))
    taken = [Taken(_path(block), block.type, name) for block, name in mapped.taken if _path(block) not in missing]
    report = Report(model.name, taken, list(dict.fromkeys(entries)))
    return Imported(document, report)


def _text_of(text: str) -> str:
    """Return the words of an annotation, which may be HTML."""
    if "<" in text and ("<html" in text.lower() or "<p" in text.lower() or "<!DOCTYPE" in text):
        text = re.sub(r"(?is)<(style|head|script).*?</\1>", "", text)
        text = (
            re.sub(r"<[^>]*>", "", text)
            .replace("&nbsp;", " ")
            .replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&amp;", "&")
        )
    return " ".join(text.split())[:2000]


def _path(block: Block) -> str:
    return "/".join(part.replace("\n", " ").replace("/", "//") for part in block.path)
