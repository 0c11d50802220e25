"""A run at a stop, as a value that can be kept in a file and gone on from.

The file is a zip archive of JSON and of one array of doubles. Reading it runs nothing: no pickle, no imports; its size,
its members and their kinds are bounded and checked.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ...compile.equation_record import Equations
from ...compile.inputs import InputTable, Track
from ...compile.jacobian import PlanJacobian
from ...compile.plan import Plan
from ...compile.tableaus import STIFF
from ...compile.time_grid import Grid
from ...model.diagram_grammar import LARGEST_SEED
from ...text.errors import Fault, UsageError
from ...text.plain_files import opened
from ...text.printable import legible, one_line
from .differences import of_equations, some
from .history import Past, Store
from .measures import Measures
from .snapshot import CARRIED_NUMBERS, MethodMemory, Snapshot, frozen

__all__ = ["Kept", "State", "check", "fit", "packed", "standing"]

Array = np.ndarray[Any, Any]

FORMAT, VERSION = "blocks-state", 1
MOST_BYTES, MOST_MEMBERS = 2**28, 3
MOST_CROSSED = 1000
"""So many times of crossings are remembered, by which chattering is seen."""


@dataclass(frozen=True)
class State:
    """All that the rest of a run follows from, besides the diagram and its settings.

    plan: what it fits. overrides: the parameters that were given or set, as written. broken, located, fired, crossed:
    what the Simulation keeps beside its Snapshot (the last input breakpoint, and the memory of the Zeno detection).
    """

    plan: Mapping[str, Any]
    method: tuple[str, str]  # the method and its fixed step
    overrides: Mapping[str, Any]
    snapshot: Snapshot
    inputs: InputTable
    measures: Mapping[str, Any]
    broken: float
    located: tuple[float, Array]
    fired: tuple[tuple[int, float], ...]
    crossed: tuple[float, ...]
    parameters: tuple[float, ...]  # values of p
    steppers: tuple[Any, ...] = ()  # what each gave to be saved; None: not begun yet
    foreign: tuple[Any, ...] = ()  # the same of FMUs
    equations: Equations | None = None  # those that it is of; None: of an older release, which did not say it
    seed: int | None = None  # of the run; None where it is not known
    start: Fraction | None = None  # of the run, from which its grids count; None where it is not known
    # The last row, and how many rows stand inside steps, where the rows of a file go on; None: rows begin anew.
    recorded: tuple[Array, int] | None = None


def fit(plan: Plan) -> dict[str, Any]:
    """What a state of a Plan and another Plan must agree in, by what it is called in messages."""
    causes = {
        "crossings": [f"{plan.instances[c.instance].path}.{c.name}" for c in plan.crossings],
        "event times": [f"{plan.instances[c.instance].path}.{c.name}" for c in plan.events],
    }
    return {
        "states": list(plan.states),
        "discretes": list(plan.discretes),
        **causes,
        "steppers": [part.path for part in plan.steppers],
        "delays": [f"{history.name} ({history.delay!r} s)" for history in plan.histories],
        "algebraic unknowns": [plan.node_name(plan.outputs[index]) for _, index in plan.unknowns],
        "rates": [f"{rate.offset} + n {rate.period}" for rate in plan.rates],
        "base step": [str(plan.base)],
        "inputs": [f"{name}{list(shape)}" for name, shape, *_ in plan.inputs],
        "measures": [
            f"{m.name} ({m.type} of {m.of}, {m.start} to {m.stop} s{f', {m.omega} rad/s' * (m.omega > 0)})"
            for m in plan.measures
        ],
        **({"FMUs": _fmus(plan)} if plan.foreign else {}),
    }


def _fmus(plan: Plan) -> list[str]:
    known = [(part.path, part.foreign.description) for part in plan.foreign]
    return [f"{path} ({description.name} {description.token})" for path, description in known]


def check(kept: Mapping[str, Any], plan: Plan, was: Equations | None = None, own: Equations | None = None) -> None:
    """Raise UsageError (E506) with every reason why the state of one Plan, by its `fit`, does not fit another.

    was, own: the equations that the state is of, and those of the Plan, where they are known.
    """
    is_other = was is not None and own is not None and (was.family is None or was.family is not own.family)
    ours, faults = fit(plan), list(of_equations(was, own)) if is_other else []  # type: ignore[arg-type]
    for what, names in ours.items():
        theirs = kept.get(what)
        if theirs == names:
            continue
        theirs = theirs if isinstance(theirs, list) else []
        added, missing = [n for n in names if n not in theirs], [n for n in theirs if n not in names]
        parts = [f"the diagram has {some(added)}, which the state lacks"] if added else []
        parts += [f"the state has {some(missing)}, which the diagram lacks"] if missing else []
        text = "; ".join(parts) or "their order differs"
        faults.append(Fault("E506", what, f"the state does not fit the diagram: {text}.", "Start a new run."))
    if faults:
        raise UsageError(*faults)


def standing(state: State, plan: Plan, inputs: InputTable) -> tuple[Snapshot, bool]:
    """Where a run of a Plan with these inputs stands when it goes on from a state, and whether anything was set there.

    Raises UsageError (E506) where that is outside of the run.
    """
    now, settings = state.snapshot, plan.settings
    end = math.inf if settings.stop is None else float(settings.stop)
    if not float(settings.start) <= now.t <= end:
        shown = math.nan if settings.stop is None else end
        message = f"the state is at t = {now.t} s, outside the run from {float(settings.start)} s to {shown} s."
        raise UsageError(Fault("E506", plan.name, message, "Set a later stop."))
    if now.past is not None:
        now = replace(now, past=now.past.own())
    if state.method != (settings.method, str(settings.step)):
        # What another method kept from step to step is of no use.
        fixed = 1 if settings.step is None else Grid.of(settings.start, settings.step).after(now.t)
        now = replace(now, memory=MethodMemory(), fixed=fixed)
    same = all(
        ours.linear == theirs.linear and np.array_equal(ours.t, theirs.t) and np.array_equal(ours.u, theirs.u)
        for ours, theirs in zip(inputs.tracks, state.inputs.tracks, strict=True)
    )
    changed = not same or plan.parameters != state.parameters
    if changed:  # as if they were set now
        now = replace(now, memory=replace(now.memory, first=None, carried=None))
    return now, changed


# --- to and from a tree of JSON values and arrays --------------------------------------------------------------


def packed(state: State) -> bytes:
    """A state as the bytes of a file; the same each time."""
    arrays: list[Array] = []

    def array(value: Any) -> dict[str, int]:
        arrays.append(np.ascontiguousarray(value, dtype="<f8"))
        return {"array": len(arrays) - 1}

    s = state.snapshot
    tree = {
        "format": FORMAT,
        "version": VERSION,
        "plan": state.plan,
        "method": list(state.method),
        "overrides": state.overrides,
        **({"seed": state.seed} if state.seed is not None else {}),
        **({"start": str(state.start)} if state.start is not None else {}),
        "t": array([s.t]),
        "exact": None if s.exact is None else str(s.exact),
        "x": array(s.x),
        "d": array(s.d),
        "s": array(s.s),
        "ticks": [str(n) for n in s.ticks],
        "events": array(s.events),
        "own": array(s.own),
        "memory": {
            "h": array([s.memory.h, s.memory.error]),
            "first": None if s.memory.first is None else array(s.memory.first),
            **({} if s.memory.carried is None else {"carried": array(s.memory.carried)}),
            **({"stiffness": array(s.memory.stiffness)} if state.method[0] == "auto" else {}),
        },
        "fixed": str(s.fixed),
        "z": array(s.z),
        "past": None if s.past is None else _past_tree(s.past, array),
        "inputs": [{"t": array(track.t), "u": array(track.u), "linear": track.linear} for track in state.inputs.tracks],
        "measures": {
            key: array(value) if isinstance(value, np.ndarray) else {name: array(rows) for name, rows in value.items()}
            for key, value in state.measures.items()
        },
        "broken": array([state.broken]),
        "located": [array([state.located[0]]), array(state.located[1])],
        "fired": [[index, array([t])] for index, t in state.fired],
        "crossed": array(state.crossed),
        "parameters": array(state.parameters),
        "steppers": list(state.steppers),
        **({"foreign": list(state.foreign)} if state.foreign else {}),
        **({} if state.equations is None else {"equations": state.equations.record}),
        **({} if state.recorded is None else {"recorded": [array(state.recorded[0]), state.recorded[1]]}),
    }
    return _zipped(tree, arrays)


def _past_tree(past: Past, array: Callable[[Any], dict[str, int]]) -> dict[str, Any]:
    return {
        "starts": array(past.store.starts[: past.known]),
        "ends": array(past.store.ends[: past.known]),
        "parts": array(np.array(past.store.parts[: past.known]).reshape(past.known, 6, len(past.histories))),
        "breaks": array(np.array(past.store.breaks[: past.broken]).reshape(past.broken, 2)),
        "open": past.open,
        "passed": list(past.passed),
        "seen": past.seen,
    }


def _zipped(tree: Mapping[str, Any], arrays: Sequence[Array]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:

        def add(name: str, data: bytes) -> None:
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)

        add("state.json", json.dumps(tree, indent=1, allow_nan=False).encode())
        add("arrays.json", json.dumps([list(array.shape) for array in arrays]).encode())
        add("arrays.f64", b"".join(array.tobytes() for array in arrays))
    return out.getvalue()


class Kept:
    """A state in a file: its parameters are known at once, the rest with the Plan that they make.

    Raises UsageError (E506) where it cannot be read.
    """

    def __init__(self, path: str | Path, data: bytes | None = None) -> None:
        """data: the bytes of the state, where the file holds more."""
        self.place = legible(str(path))
        try:
            with opened(path) if data is None else io.BytesIO(data) as stream:
                if data is None and os.fstat(stream.fileno()).st_size > MOST_BYTES:
                    raise ValueError("it is too large")
                self.tree, self.arrays = _read(stream)
        except OSError as error:
            raise UsageError(Fault("E506", self.place, f"cannot be read: {error.strerror}.")) from None
        except (zipfile.BadZipFile, zlib.error, KeyError, TypeError, ValueError, RuntimeError, EOFError) as error:
            raise self.refusal(str(error) or type(error).__name__) from None
        if not isinstance(self.tree, dict) or self.tree.get("format") != FORMAT:
            raise self.refusal(f'its format is not "{FORMAT}"')
        if self.tree.get("version") != VERSION or type(self.tree["version"]) is not int:
            message = f"version {legible(repr(self.tree.get('version')))} cannot be read."
            raise UsageError(Fault("E506", self.place, message, "Use a newer release of blocks."))
        if not isinstance(self.tree.get("overrides"), dict):
            raise self.refusal("it has no parameters")
        if self.seed is not None and (type(self.seed) is not int or not 0 <= self.seed <= LARGEST_SEED):
            raise self.refusal("its seed is not a whole number")
        try:
            self.start = _start(self.tree)
        except ValueError as error:
            raise self.refusal(str(error)) from None

    def refusal(self, why: str) -> UsageError:
        return UsageError(
            Fault("E506", self.place, f"is not a saved state: {one_line(why)}.", "Use a file that --save wrote.")
        )

    @property
    def overrides(self) -> Mapping[str, Any]:
        return dict(self.tree["overrides"])

    @property
    def seed(self) -> int | None:
        seed: int | None = self.tree.get("seed")
        return seed

    def fitted(self, plan: Plan, own: Equations) -> State:
        """The state, for the Plan and the equations that it must fit. Raises UsageError (E506)."""
        try:
            return _state(self.tree, _Arrays(self.arrays), plan, own)
        except (UsageError, MemoryError):
            raise
        except ValueError as error:
            raise self.refusal(str(error)) from None
        except Exception as error:  # whatever a damaged tree leads to
            raise self.refusal(f"{type(error).__name__}: {error}") from None


def _read(stream: BinaryIO) -> tuple[Any, list[Array]]:
    with zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        if len(members) > MOST_MEMBERS or sum(member.file_size for member in members) > MOST_BYTES:
            raise ValueError("it is too large")
        tree, shapes = json.loads(archive.read("state.json")), json.loads(archive.read("arrays.json"))
        flat = np.frombuffer(archive.read("arrays.f64"), dtype="<f8").astype(float)
    arrays, first = [], 0
    for shape in shapes:
        if not isinstance(shape, list) or not all(type(size) is int and size >= 0 for size in shape):
            raise ValueError("an array has no shape")
        size = math.prod(shape)
        arrays.append(flat[first : first + size].reshape(shape))
        first += size
    if first != len(flat):
        raise ValueError("its arrays are incomplete")
    return tree, arrays


def _fraction(text: Any) -> Fraction:
    """An exact time as it is written: no decimals, whose exponents could be of any size."""
    if not isinstance(text, str) or not re.fullmatch(r"-?[0-9]{1,400}(/[0-9]{1,400})?", text):
        raise ValueError("its exact time is not a fraction")
    return Fraction(text)


def _start(tree: Mapping[str, Any]) -> Fraction | None:
    return None if tree.get("start") is None else _fraction(tree["start"])


def _check_kept(memory: MethodMemory, method: str, plan: Plan) -> None:
    """Raise ValueError where what a stiff method keeps could not have come from a run: C uses its pivots as places."""
    carried, (hits, calm, since) = memory.carried, memory.stiffness
    if not all(0 <= n < 2**31 and float(n).is_integer() for n in (hits, calm)) or math.isinf(since):
        raise ValueError("a counter of its method has an impossible value")
    if carried is None:
        return
    if method not in STIFF or carried.ndim != 1 or not np.isfinite(carried).all():
        raise ValueError("the memory of its method has an impossible value")
    n = len(plan.states)
    size = CARRIED_NUMBERS + 3 * n + int(PlanJacobian(plan).indptr[-1])
    pivots = carried[size:]
    is_whole = len(carried) == size or (len(pivots) == n and np.array_equal(np.sort(pivots), np.arange(n)))
    if not is_whole or (carried[:CARRIED_NUMBERS] < 0).any():
        raise ValueError("the memory of its method does not fit its states")


def _check_values(state: State, plan: Plan) -> None:
    """Raise ValueError where numbers of a state could not have come from a run."""
    s, measures = state.snapshot, state.measures
    finite = (s.x, s.d, s.z, [s.t, s.memory.h, s.memory.error, state.broken], state.parameters)
    if not all(np.isfinite(np.asarray(part, dtype=float)).all() for part in finite):
        raise ValueError("it holds a number that is not finite")
    if np.isnan(s.events).any() or s.memory.h < 0 or not s.memory.error > 0:
        raise ValueError("it holds a number that is not possible there")
    if not set(s.s) <= {0.0, 1.0} or not all(0 <= n < 2**63 for n in (*s.ticks, s.fixed)):
        raise ValueError("a side or a count has an impossible value")
    if s.exact is not None and float(s.exact) != s.t:
        raise ValueError("its two times differ")
    for slot, members in plan.integers.items():
        if not (s.d[slot] in members if members else s.d[slot].is_integer()):
            raise ValueError(f"'{plan.discretes[slot]}' is {s.d[slot]}")
    first, located = s.memory.first, state.located[1]
    if first is not None and (first.shape != s.x.shape or not np.isfinite(first).all()):
        raise ValueError("its rates and its states differ in size")
    _check_kept(s.memory, state.method[0], plan)
    crossings = len(plan.crossings)
    if len(s.own) != len(plan.events) or located.shape not in ((0,), (crossings,)):
        raise ValueError("its arrays have other sizes than its names")
    if not all(0 <= index < crossings for index, _ in state.fired) or len(state.steppers) != len(plan.steppers):
        raise ValueError("its arrays have other sizes than its names")
    if len(state.crossed) > MOST_CROSSED:
        raise ValueError("it holds more past crossings than a run keeps")
    if len(state.parameters) != len(plan.parameters):
        message = f"the diagram has {len(plan.parameters)} numbers in parameters, the state has {len(state.parameters)}"
        text = f"the state does not fit the diagram: {message}."
        raise UsageError(Fault("E506", "parameters", text, "Start a new run."))
    if len(state.foreign) != len(plan.foreign):
        raise ValueError("its arrays have other sizes than its names")
    width = 1 + sum(len(plan.signal(name).references) for name in plan.log)
    if state.recorded is not None and (state.recorded[0].shape != (width,) or state.recorded[1] < 0):
        message = "the state does not fit the run: it was saved with other recorded signals."
        raise UsageError(Fault("E506", "recorded signals", message, "Record the same signals, or start a new run."))
    for track, (_, shape, *_) in zip(state.inputs.tracks, plan.inputs, strict=True):
        fits = track.t.ndim == 1 and track.u.shape == (len(track.t), math.prod(shape)) and len(track.t) > 0
        if not fits or not np.isfinite(track.u).all() or np.any(np.diff(track.t) < 0):
            raise ValueError("one of its inputs is not a table")
    for key, blank in Measures(plan).saved().items():
        ours = measures[key]
        if isinstance(blank, dict):
            fits = ours.keys() == blank.keys() and all(rows.ndim == 2 and rows.shape[1] == 7 for rows in ours.values())
        else:
            fits = ours.shape == blank.shape or (key == "known" and ours.shape == (1 + 2 * len(plan.measures),))
        if not fits:
            raise ValueError("its arrays have other sizes than its names")


@dataclass(frozen=True)
class _Arrays:
    """The arrays of a file, by their entries in its tree."""

    arrays: Sequence[Array]

    def array(self, entry: Any) -> Array:
        values: Array = self.arrays[entry["array"]]
        return values

    def numbers(self, entry: Any) -> tuple[float, ...]:
        values = self.array(entry)
        if values.ndim != 1:
            raise ValueError("an array does not have the shape of a row")
        return tuple(values.tolist())


def _past(raw: Mapping[str, Any], arrays: _Arrays, plan: Plan) -> Past:
    array, numbers = arrays.array, arrays.numbers
    breaks = [(float(t), int(order)) for t, order in array(raw["breaks"])]
    store = Store([*numbers(raw["starts"])], [*numbers(raw["ends"])], [*array(raw["parts"])], breaks)
    passed = tuple(int(n) for n in raw["passed"])
    past = Past(plan.histories, store, len(store.starts), len(breaks), bool(raw["open"]), passed, int(raw["seen"]))
    shapes = {(6, len(plan.histories)), *(part.shape for part in store.parts)}
    if len({len(store.starts), len(store.ends), len(store.parts)}) != 1 or len(shapes) != 1 or not breaks:
        raise ValueError("its past is incomplete")
    times = np.array([*store.starts, *store.ends, *(t for t, _ in breaks)])
    counts = (past.seen, *(order for _, order in breaks))
    if np.isnan(times).any() or not all(0 <= n < 2**31 for n in counts) or (any(passed) and not store.starts):
        raise ValueError("its past holds a number that is not possible there")
    if len(passed) != len(plan.histories) or not all(0 <= n <= len(breaks) for n in passed):
        raise ValueError("its past is incomplete")
    return past


def _snapshot(tree: Mapping[str, Any], arrays: _Arrays, past: Past | None, plan: Plan) -> Snapshot:
    array, numbers = arrays.array, arrays.numbers
    h, error = numbers(tree["memory"]["h"])
    first = tree["memory"]["first"]
    first, carried = (
        None if row is None else frozen(array(row).copy()) for row in (first, tree["memory"].get("carried"))
    )
    memory = MethodMemory(h, error, first, carried)
    if "stiffness" in tree["memory"]:
        hits, calm, since = numbers(tree["memory"]["stiffness"])
        memory = replace(memory, stiffness=(hits, calm, since))
    snapshot = Snapshot(
        numbers(tree["t"])[0],
        None if tree["exact"] is None else _fraction(tree["exact"]),
        frozen(array(tree["x"]).copy()),
        numbers(tree["d"]),
        numbers(tree["s"]),
        tuple(int(n) for n in tree["ticks"]),
        numbers(tree["events"]),
        numbers(tree["own"]),
        memory,
        int(tree["fixed"]),
        past,
        numbers(tree["z"]),
    )
    sizes = (
        (len(snapshot.x), len(plan.states)),
        (len(snapshot.d), len(plan.discretes)),
        (len(snapshot.s), len(plan.s_start)),
        (len(snapshot.ticks), len(plan.rates)),
        (len(snapshot.events), len(plan.events)),
        (len(snapshot.z), len(plan.unknowns)),
        (len(tree["inputs"]), len(plan.inputs)),
    )
    if any(ours != theirs for ours, theirs in sizes) or (past is None) != (not plan.histories):
        raise ValueError("its arrays have other sizes than its names")
    return snapshot


def _state(tree: Mapping[str, Any], arrays: _Arrays, plan: Plan, own: Equations) -> State:
    array, numbers = arrays.array, arrays.numbers
    raw = tree["past"]
    equations = Equations.read(tree.get("equations"))
    check(tree["plan"], plan, equations, own)
    past = None if raw is None else _past(raw, arrays, plan)
    snapshot = _snapshot(tree, arrays, past, plan)
    measures: dict[str, Any] = {
        key: array(value) if "array" in value else {name: array(rows) for name, rows in value.items()}
        for key, value in tree["measures"].items()
    }
    state = State(
        tree["plan"],
        (str(tree["method"][0]), str(tree["method"][1])),
        dict(tree["overrides"]),
        snapshot,
        InputTable(
            tuple(
                Track(array(track["t"]).copy(), array(track["u"]).copy(), bool(track["linear"]))
                for track in tree["inputs"]
            )
        ),
        measures,
        numbers(tree["broken"])[0],
        (numbers(tree["located"][0])[0], array(tree["located"][1])),
        tuple((int(index), numbers(t)[0]) for index, t in tree["fired"]),
        numbers(tree["crossed"]),
        numbers(tree["parameters"]),
        tuple(tree["steppers"]),
        tuple(tree.get("foreign", ())),
        equations,
        tree.get("seed"),
        _start(tree),
        None if tree.get("recorded") is None else (array(tree["recorded"][0]), int(tree["recorded"][1])),
    )
    _check_values(state, plan)
    return state
