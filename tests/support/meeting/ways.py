"""Ways to run a case, and how far their results must agree with the native run of it.

The classes of equality are those of "Engines" and "Snapshots" of docs/semantics.md: bit for bit between a run and a
row of a batch, a prepared run, a resumed run and an exported FMU; to rounding between engines with fixed steps; within
the tolerance otherwise.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from fmpy.fmi1 import FMICallException

import blocks
from blocks import Diagram, Results
from blocks.compile.toolchain.cache import VARIABLE
from blocks.engines.native import code
from blocks.engines.native import model as models
from blocks.text.errors import BlocksError

from .features import ADAPTIVE, EVERY, IMPLICIT, STOP, Case
from .own_blocks import OWN

Array = np.ndarray[Any, Any]

ROUNDING, TOLERANCE = 1e-9, 1e-5
"""How far signals may be apart, by their range. Fixed steps: 200 steps double an ulp at most 20 times in a stable
diagram. Adaptive steps: rtol is 1e-8, for some hundred steps, with some room for what crossings do to it."""


@dataclass(frozen=True)
class Outcome:
    """Signals on the grid by name, and what fired; or the error that ended the run."""

    signals: Mapping[str, Array]
    events: tuple[tuple[str, str, float], ...] = ()
    error: str = ""


@dataclass(frozen=True)
class Disagreement:
    """Where two results of a case differ."""

    way: str
    signal: str
    ours: str
    theirs: str

    def __str__(self) -> str:
        return f"{self.way}: {self.signal}: {self.ours} | {self.theirs}"


# --- diagrams --------------------------------------------------------------------------------------------------------


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-meeting-")


@functools.cache
def _place(fmus: str) -> Path:
    """Export FMUs to a folder of their own, once for equal ones."""
    folder = Path(_folder().name) / hashlib.sha256(fmus.encode()).hexdigest()[:12]
    folder.mkdir(exist_ok=True)
    for file, entry in json.loads(fmus).items():
        Diagram.from_json(entry["diagram"], library=OWN).export(folder / file, fmi=entry["fmi"])
    return folder


def diagram_of(case: Case, **settings: Any) -> Diagram:
    folder = _place(json.dumps(case["fmus"], sort_keys=True)) if case["fmus"] else ""
    document = {**case["diagram"], "run": {**case["diagram"]["run"], **settings}}
    return Diagram.from_json(json.dumps(document), folder=folder, library=OWN)


def given(case: Case) -> blocks.Case:
    """Return what all runs of a case have."""
    tables = case.get("inputs", {}).items()
    inputs = {name: tuple(value) if isinstance(value, list) else value for name, value in tables}
    return blocks.Case(inputs=inputs, trust=Path(_folder().name) if case["fmus"] else ())


def _outcome(run: Callable[[], Results]) -> Outcome:
    try:
        results = run()
    except BlocksError as error:
        return Outcome({}, error=str(error)[:300])
    events = tuple((event.block, event.what, event.t) for event in results.events)
    signals = {"t": np.asarray(results.t), **{name: np.asarray(results[name]) for name in results}}
    return Outcome(signals | {f"measure {name}": np.array([value]) for name, value in results.measures.items()}, events)


def run(case: Case, engine: str = "native", **words: Any) -> Outcome:
    return _outcome(lambda: diagram_of(case).run(given(case), engine=engine, **words))


# --- comparisons -----------------------------------------------------------------------------------------------------


def tolerance_of(case: Case) -> float:
    return TOLERANCE if case["diagram"]["run"]["method"] in ADAPTIVE else ROUNDING


def _apart(name: str, ours: Array, theirs: Array, times: Array, tolerance: float) -> tuple[str, str, str] | None:
    """Return where two signals differ by more than the tolerance allows: the name with the time, and both values."""
    if ours.shape != theirs.shape:
        return name, f"shape {ours.shape}", f"shape {theirs.shape}"
    a, b = ours.astype(float), theirs.astype(float)
    if tolerance == 0.0:
        wrong = (a != b) & ~(np.isnan(a) & np.isnan(b))
    else:
        size = max(1.0, float(np.max(np.abs(a), initial=0.0)))
        wrong = ~(np.abs(a - b) <= tolerance * size) & ~(np.isnan(a) & np.isnan(b))
    if not wrong.any():
        return None
    place = tuple(np.argwhere(wrong)[0])
    return f"{name} at {times[place[0]]:.6g} s", repr(float(a[place])), repr(float(b[place]))


def differences(
    way: str, ours: Outcome, theirs: Outcome, tolerance: float, *, events: bool = True
) -> list[Disagreement]:
    """Compare all signals that both outcomes have, and what fired."""
    if ours.error or theirs.error:
        if ours.error[:4] == theirs.error[:4]:
            return []
        return [Disagreement(way, "error", ours.error or "runs", theirs.error or "runs")]
    apart: list[Disagreement] = []
    for name in [name for name in ours.signals if name in theirs.signals]:
        found = _apart(name, ours.signals[name], theirs.signals[name], ours.signals["t"], tolerance)
        if found:
            apart.append(Disagreement(way, *found))
    if events and not apart:
        apart += _other_events(way, ours, theirs, tolerance)
    return apart


def _other_events(way: str, ours: Outcome, theirs: Outcome, tolerance: float) -> list[Disagreement]:
    """Compare what fired: in order, or block by block where times are known to a tolerance only.

    A block whose values are replaced after each step turns back at the end of a step, so its events follow the steps.
    If a reset moves an input by its rounding error, the input meets a Backlash that it pushes, or misses it, by chance.
    """
    fired, other = list(ours.events), list(theirs.events)
    if tolerance:
        fired, other = ([event for event in side if event[0] not in ("pa", "pb")] for side in (fired, other))
    if tolerance == TOLERANCE:
        fired, other = sorted(fired), sorted(other)
    for mine, its in zip(fired, other, strict=False):
        if mine[:2] != its[:2] or abs(mine[2] - its[2]) > max(tolerance, 0.0):
            return [Disagreement(way, "event", str(mine), str(its))]
    if len(fired) != len(other):
        more = (fired if len(fired) > len(other) else other)[min(len(fired), len(other))]
        return [Disagreement(way, "events", f"{len(fired)}", f"{len(other)}: first more {more}")]
    return []


def within(case: Case, outcome: Outcome, way: str) -> list[Disagreement]:
    """Compare the signals of one run that must be equal."""
    apart = []
    for a, b, how in case["same"] if not outcome.error else ():
        ours, theirs = _signal(outcome, a), _signal(outcome, b)
        if ours is None or theirs is None:
            continue
        tolerance = tolerance_of(case)
        if how == "exact":  # LAPACK, in the reference engine, solves equal equations to rounding
            tolerance = ROUNDING if way == "same, reference" and case["diagram"]["run"]["method"] in IMPLICIT else 0.0
        found = _apart(f"{a} = {b}", ours, theirs, outcome.signals["t"], tolerance)
        if found:
            apart.append(Disagreement(way, *found))
    return apart


def _signal(outcome: Outcome, name: str) -> Array | None:
    if name in outcome.signals:
        return outcome.signals[name]
    whole, _, index = name.partition("[")
    if whole not in outcome.signals:
        return None
    return np.asarray(outcome.signals[whole][:, int(index.removesuffix("]"))])


# --- ways ------------------------------------------------------------------------------------------------------------

Way = Callable[[Case, Outcome], Iterator[Disagreement]]
WAYS: dict[str, Way] = {}


def way(function: Way) -> Way:
    WAYS[function.__name__] = function
    return function


@way
def reference(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run by the reference engine."""
    other = run(case, "reference")
    yield from within(case, other, "same, reference")
    yield from differences("native | reference", base, other, tolerance_of(case))


@way
def values(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run a prepared model with other values as a run of its own; in a case of four, also as the reference engine."""
    if base.error:
        return
    other_values = case["values"]
    alone = run(case, parameters=other_values)
    model = diagram_of(case).prepare(given(case), engine="native")
    again = _outcome(lambda: model.run(parameters=other_values))
    yield from differences("run with values | prepared", alone, again, 0.0)
    yield from differences("base | prepared", base, _outcome(model.run), 0.0)
    yield from within(case, alone, "same, other values")
    if case["seed"] % 4 == 0:  # the reference engine takes as long as all other ways of a case
        other = run(case, "reference", parameters=other_values)
        yield from differences("native | reference, other values", alone, other, tolerance_of(case))


def _is_signal(name: str) -> bool:
    return name != "t" and not name.startswith("measure ")


def _rows(case: Case, base: Outcome, lanes: str) -> Iterator[tuple[Outcome, Outcome]]:
    """Give for each row of a batch a run of its own, and the row."""
    signals = [name for name in base.signals if _is_signal(name) and base.signals[name].dtype == float]
    diagram = diagram_of(case)
    measures = ["window"] if case["seed"] % 2 else None
    rows_of = diagram.batch(
        list(case["values"]), given(case), log=signals, engine="native", measures=measures, lanes=lanes
    )  # fmt: skip
    table = [[value * (1 + 0.01 * k) for value in case["values"].values()] for k in range(9 if lanes == "fast" else 2)]
    rows = rows_of(table, threads=1)
    for index, row in enumerate(table[:: 4 if lanes == "fast" else 1]):
        place = index * (4 if lanes == "fast" else 1)
        alone = run(case, parameters=dict(zip(case["values"], row, strict=True)), measures=measures)
        got = {"t": rows.t, **{name: rows.signals[name][place] for name in signals}}
        got |= {f"measure {name}": values[place : place + 1] for name, values in rows.measures.items()}
        failed = "" if rows.status[place] == "ok" else f"{rows.messages[place] or rows.status[place]}"
        yield alone, Outcome(got, error=failed)


@way
def batch(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run rows of a batch: bit for bit as single runs."""
    for alone, row in _rows(case, base, "exact") if not base.error else ():
        yield from differences("run | row of a batch", alone, row, 0.0, events=False)


@way
def lanes(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run rows in lanes: within the tolerance as single runs."""
    for alone, row in _rows(case, base, "fast") if not base.error else ():
        yield from differences("run | lane", alone, row, tolerance_of(case), events=False)


@way
def resumed(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Save a run at one of its stops and resume it, by the same engine and by the other."""
    if base.error:
        return
    stop = [0.6, 0.85, 1.0][case["seed"] % 3]
    diagram = diagram_of(case)
    whole = _outcome(lambda: diagram.run(given(case), engine="native", stops=[stop]))
    if whole.error:
        yield Disagreement("base | with a stop", "error", "runs", whole.error)
        return
    first = diagram.start(given(case), engine="native", stops=[stop])
    first.advance_to(stop)
    state = first.snapshot()
    late = whole.signals["t"] >= stop
    rest = Outcome(
        {name: values[late] if _is_signal(name) or name == "t" else values for name, values in whole.signals.items()},
        tuple(event for event in whole.events if event[2] > stop),
    )
    for engine, tolerance in (("native", 0.0), ("reference", tolerance_of(case))):
        going = given(case).without("inputs").updated(engine=engine, stops=[stop])  # those of the state go on
        later = _outcome(lambda: diagram.run(going, resume=state))  # noqa: B023
        yield from differences(f"whole | resumed at {stop} by {engine}", rest, later, tolerance)


@way
def replaced(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Begin by code without optimisation, and go on by the optimised code from half the time on."""
    if base.error:
        return
    with tempfile.TemporaryDirectory() as cache, ExitStack() as stack:
        stack.enter_context(mock.patch.dict(os.environ, {VARIABLE: cache}))
        for place, name, value in ((code, "QUICKLY", True), (code, "PATIENCE", 1e9), (models, "_MODELS", {})):
            stack.enter_context(mock.patch.object(place, name, value))

        def goes_on() -> Results:
            run = diagram_of(case).start(given(case), engine="native")
            run.advance_to(STOP / 2)
            code.PATIENCE = 0.0
            for model in models._MODELS.values():
                model.code.hurry(0.0)
                if model.code._optimising is not None:
                    model.code._optimising._thread.join()
            return run.finish()

        yield from differences("run | run whose code is replaced", base, _outcome(goes_on), 0.0)


@way
def ended(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """End a run by a condition: rows before the end are those of the whole run."""
    names = [name for name, values in base.signals.items() if _is_signal(name) and values.ndim == 1]
    if base.error or not names:
        return
    end, name = [0.63, 0.85, 1.07][case["seed"] % 3], names[case["seed"] % len(names)]
    is_coupled = case["row"]["fmu"] in ("cs2", "cs3")  # its master may step otherwise where something is crossed
    # It reads a signal, and crosses nothing before the end: a crossing would cut a step, and change the last bits.
    is_bool = diagram_of(case).flatten(given(case)).signals[name].type == "bool"
    holds = f"({name} or not {name})" if is_bool else f"{name} > -1e300"
    tolerance = tolerance_of(case)
    for engine in ("native", "reference"):
        other = run(case, engine, stop_when=f"t >= {end} and {holds}")
        if other.error or abs(other.signals["t"][-1] - end) > (0.011 if is_coupled else 1e-12):
            yield Disagreement(f"ended by {engine}", "t", f"{end}", other.error or str(other.signals["t"][-1]))
            continue
        if is_coupled:  # other communication points are another coupling error
            continue
        rows = [
            Outcome({key: values[side.signals["t"] < end] for key, values in side.signals.items() if values.ndim and
                     len(values) == len(side.signals["t"])})
            for side in (base, other)
        ]  # fmt: skip
        yield from differences(f"base | ended by {engine}", *rows, tolerance, events=False)


@way
def exported2(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run as an FMU of FMI 2 for Co-Simulation: bit for bit as a run that is advanced to the communication points."""
    yield from _exported(case, base, 2)


@way
def exported3(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Run as an FMU of FMI 3."""
    yield from _exported(case, base, 3)


def _error(call: Callable[[], Any]) -> str:
    try:
        call()
    except (BlocksError, FMICallException) as error:
        return str(error)[:300]
    return ""


def _exported(case: Case, base: Outcome, fmi: int) -> Iterator[Disagreement]:
    from tests.support import fmus

    if base.error:
        return
    diagram = diagram_of(case)
    log = list(filter(_is_signal, base.signals))
    fmu = fmus.exported(diagram, fmi, log=log)
    names = [name for name in log if name in fmu]
    alone = diagram.start(engine="native", log=log)
    points = [round(k * EVERY, 10) for k in range(1, round(STOP / EVERY) + 1)]
    ours: dict[str, list[Any]] = {name: [] for name in names}
    theirs: dict[str, list[Any]] = {name: [] for name in names}
    with fmu.instance() as one:
        one.begin(stop=STOP)
        for before, t in zip([0.0, *points], points, strict=False):
            error = _error(lambda: alone.advance_to(t))  # noqa: B023
            its = _error(lambda: one.step(before, t - before)) and one.errors[-1][:300]  # noqa: B023
            if error or its:
                if error[:4] != its[:4]:
                    yield Disagreement(f"run | FMU of FMI {fmi}", "error", error or "runs", its or "runs")
                return
            for name in names:
                ours[name].append(np.ravel(alone[name]))
                theirs[name].append(np.ravel(one[name]))
    first, second = (
        Outcome({"t": np.array(points), **{name: np.array(rows) for name, rows in side.items()}})
        for side in (ours, theirs)
    )
    yield from differences(f"run | FMU of FMI {fmi}", first, second, 0.0)


@way
def unread(case: Case, base: Outcome) -> Iterator[Disagreement]:
    """Add a part that nobody reads: it changes signals within the tolerance, and those of fixed steps not at all."""
    document = case["diagram"]
    kinds = {"FirstOrder": {"T": 0.05}}
    if document["run"]["method"] in ADAPTIVE:  # a fixed step that is cut has another error
        kinds |= {
            "TransportDelay": {"delay": 0.13}, "ZeroOrderHold": {"period": 0.07},
            "Relay": {"on_at": 0.11, "off_at": -0.1},
        }  # fmt: skip
    blocks = {f"unread_{type_}": {"type": type_, "parameters": given} for type_, given in kinds.items()}
    wires = {f"{name}.u": "wave.y" for name in blocks}
    more = {**document, "blocks": {**document["blocks"], **blocks}, "wires": {**document["wires"], **wires}}
    other = run({**case, "diagram": more})
    kept = tuple(event for event in other.events if not event[0].startswith("unread_"))
    yield from differences("base | with an unread part", base, Outcome(other.signals, kept, other.error),
                           tolerance_of(case))  # fmt: skip


def disagreements(case: Case) -> list[Disagreement]:
    """Run a case in its ways."""
    base = run(case)
    found = [Disagreement("native", "error", base.error, "should run")] if base.error else []
    found += within(case, base, "same, native")
    for name in dict.fromkeys(case["ways"]):
        found += WAYS[name](case, base)
    return found
