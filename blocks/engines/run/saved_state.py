"""A run at a stop, as a value that can be kept in a file, and from which a run can continue.

The file is a zip archive of JSON and of the bytes of rows of numbers. Reading it runs nothing: no pickle, no imports;
its size, its members and their kinds are bounded and checked.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ...compile.equation_record import Equations
from ...compile.inputs import InputTable
from ...compile.plan import Plan
from ...compile.time_grid import Grid
from ...host.plain_files import opened
from ...model.diagram_grammar import LARGEST_SEED
from ...text.arrays import Array
from ...text.errors import BlocksError, Fault, UsageError
from ...text.printable import legible, one_line
from .differences import of_equations, some
from .snapshot import MethodMemory
from .state_rows import check_rows, input_rows, inputs_of, recorded_width

FORMAT, VERSION = "blocks-state", 2
ENDING = "run.stop_when "
"""With this begin the names of the crossings and the discretes of the condition that ends a run."""
MOST_BYTES, MOST_MEMBERS = 2**28, 3  # states of version 1, which are refused by their version, have three
MOST_VALUES = 2**21
"""The most lists, objects and commas in the JSON of a state: in memory, `[],` takes 20 times as much as in the file."""
KINDS = ("<f8", "<i8", "<i4")


@dataclass(frozen=True)
class State:
    """All that the rest of a run follows from, besides the diagram and its settings.

    plan: what it fits. method: with its fixed step. overrides: the parameters that were given or set, as written.
    exact: the time as a fraction, if it is known. rows: see `state_rows`. steppers, foreign: what each program and each
    FMU gave to be saved (None: not begun yet). equations, seed, start: of the run; an engine alone does not know them.
    """

    plan: Mapping[str, Any]
    method: tuple[str, str]
    overrides: Mapping[str, Any]
    exact: Fraction | None
    rows: Mapping[str, Array]
    inputs: InputTable
    steppers: tuple[Any, ...] = ()
    foreign: tuple[Any, ...] = ()
    equations: Equations | None = None
    seed: int | None = None
    start: Fraction | None = None
    is_adapted: bool = False  # to another condition that ends the run

    @property
    def t(self) -> float:
        """The time in s."""
        return float(self.rows["t"])


def fit(plan: Plan) -> dict[str, Any]:
    """What a state of a Plan and another Plan must agree in, by what it is called in messages."""
    causes = {
        "crossings": _crossings(plan),
        "event times": [f"{plan.instances[c.instance].path}.{c.name}" for c in plan.events],
    }
    return {
        "states": list(plan.states),
        "discretes": _marked(plan.discretes, plan),
        **causes,
        "steppers": [part.path for part in plan.steppers],
        "delays": [f"{one.name} ({its.delay!r} s)" for one, its in zip(plan.histories, plan.delays, strict=True)],
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


def _crossings(plan: Plan) -> list[str]:
    """The crossings by their names; those of the condition that ends the run with its text."""
    names = [f"{plan.instances[cause.instance].path}.{cause.name}" for cause in plan.crossings]
    return _marked(names, plan)


def _marked(names: Iterable[str], plan: Plan) -> list[str]:
    """Return names of crossings or discretes; those of the condition that ends the run with its text.

    No other block has the path of the condition.
    """
    if plan.ends is None:
        return [*names]
    own = f"{plan.instances[plan.crossings[plan.ends].instance].path}."
    return [f"{ENDING}{plan.settings.stop_when}: {name}" if name.startswith(own) else name for name in names]


def adapted(state: State, plan: Plan) -> State:
    """Return a state of a run that another condition ends, or none, for a run of a Plan.

    The memory of the Plan's condition is that of signals at 0 at first: an instant at the beginning, to which its
    crossings fire, finds what it is.
    """
    ours, rows = {"crossings": _crossings(plan), "discretes": _marked(plan.discretes, plan)}, dict(state.rows)
    sides = [float(cause.direction == "down") for cause in plan.crossings]
    blanks: dict[str, dict[str, Any]] = {
        "crossings": {"s": sides, "located": -1.0, "fired": -math.inf},
        "discretes": {"d": 0.0},
    }
    changed: dict[str, list[str]] = {}
    for what, blank in blanks.items():
        theirs, own = state.plan.get(what), ours[what]
        if theirs == own:
            continue
        if not isinstance(theirs, list) or any(rows[name].shape != (len(theirs),) for name in blank):
            return state
        old = [j for j, name in enumerate(theirs) if not str(name).startswith(ENDING)]
        new = [j for j, name in enumerate(own) if not name.startswith(ENDING)]
        if [theirs[j] for j in old] != [own[j] for j in new]:
            return state
        changed[what] = own
        for name, value in blank.items():
            row = np.full(len(own), value)
            row[new] = rows[name][old]
            rows[name] = row
    if not changed:
        return state
    p = np.array(plan.parameters)
    formula = () if plan.ends is None else plan.instances[plan.crossings[plan.ends].instance - 1].arguments
    first = min((index for row, index in formula if row == "p"), default=len(p))  # its constants are the last in p
    rows["parameters"] = np.concatenate([rows["parameters"][:first], p[first:]])
    rows["crossed"] = rows["crossed"] if ours["crossings"] else np.empty(0)
    rows.pop("before", None)
    return replace(state, plan={**state.plan, **changed}, rows=rows, is_adapted=True)


def _fmus(plan: Plan) -> list[str]:
    known = [(part.path, part.foreign.description) for part in plan.foreign]
    return [f"{path} ({description.name} {description.token})" for path, description in known]


def check(kept: Mapping[str, object], plan: Plan, was: Equations | None, own: Equations) -> None:
    """Raise UsageError (E506) with every reason why the state of one Plan, by its `fit`, does not fit another.

    was, own: the equations that the state is of, and those of the Plan.
    """
    is_other = was is not None and (was.family is None or was.family is not own.family)
    ours, faults = fit(plan), list(of_equations(was.record, own.record)) if was is not None and is_other else []
    for what, names in ours.items():
        theirs = kept.get(what)
        if theirs == names:
            continue
        theirs = theirs if isinstance(theirs, list) else []
        old, new = {*theirs}, {*names}
        added, missing = [n for n in names if n not in old], [n for n in theirs if n not in new]
        parts = [f"the diagram has {some(added)}, which the state lacks"] if added else []
        parts += [f"the state has {some(missing)}, which the diagram lacks"] if missing else []
        text = "; ".join(parts) or "their order differs"
        faults.append(Fault("E506", what, f"the state does not fit the diagram: {text}.", "Start a new run."))
    if faults:
        raise UsageError(*faults)


def standing(state: State, plan: Plan, inputs: InputTable) -> tuple[dict[str, Array], bool]:
    """Return the rows of a state with which a run of a Plan continues, and whether anything was set there.

    Raises UsageError (E506) where that is outside of the run.
    """
    rows, t, settings = dict(state.rows), state.t, plan.settings
    end = math.inf if settings.stop is None else float(settings.stop)
    if not float(settings.start) <= t <= end:
        shown = math.nan if settings.stop is None else end
        message = f"the state is at t = {t} s, outside the run from {float(settings.start)} s to {shown} s."
        raise UsageError(Fault("E506", plan.name, message, "Set a later stop."))
    is_same = all(
        ours.linear == theirs.linear and np.array_equal(ours.t, theirs.t) and np.array_equal(ours.u, theirs.u)
        for ours, theirs in zip(inputs.tracks, state.inputs.tracks, strict=True)
    )
    is_changed = state.is_adapted or not is_same or not np.array_equal(rows["parameters"], np.array(plan.parameters))
    is_other = state.method != (settings.method, str(settings.step))
    if is_other:  # what another method kept from step to step is of no use
        blank = MethodMemory()
        fixed = 1 if settings.step is None else Grid.of(settings.start, settings.step).after(t)
        numbers = {"step": blank.h, "error": blank.error, "stiffness": blank.stiffness, "fixed": fixed}
        rows |= {name: np.array(number) for name, number in numbers.items()}
    for name in ("first", "carried", "before") if is_changed or is_other else ():  # as if values were set now
        rows.pop(name, None)
    return rows, is_changed


@contextmanager
def restoring(place: str, what: str) -> Iterator[None]:
    """Raise UsageError (E506), which names a block, if its part of a saved state cannot be restored."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # whatever a damaged value leads to, in a program of the user or an FMU too
        why = error.faults[0].message if isinstance(error, BlocksError) else f"{type(error).__name__}: {error}"
        message = f"{what} cannot be restored: {one_line(why).rstrip('.')}."
        raise UsageError(Fault("E506", place, message, "Use a state that was saved with it.")) from error


# --- files -------------------------------------------------------------------------------------------------------


def packed(state: State) -> bytes:
    """Return a state as the bytes of a file; the same each time."""
    assert state.equations is not None
    rows = {**state.rows, **input_rows(state.inputs)}
    tree = {
        "format": FORMAT,
        "version": VERSION,
        "plan": state.plan,
        "method": list(state.method),
        "overrides": state.overrides,
        "seed": state.seed,
        "start": None if state.start is None else str(state.start),
        "exact": None if state.exact is None else str(state.exact),
        "steppers": list(state.steppers),
        "foreign": list(state.foreign),
        "equations": state.equations.record,
        "rows": {name: [row.dtype.newbyteorder("<").str, list(row.shape)] for name, row in rows.items()},
    }
    data = b"".join(row.astype(row.dtype.newbyteorder("<")).tobytes() for row in rows.values())
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in (("state.json", json.dumps(tree, indent=1, allow_nan=False).encode()), ("rows", data)):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
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
                tree, data = _read(stream)
            if not isinstance(tree, dict) or tree.get("format") != FORMAT:
                raise ValueError(f'its format is not "{FORMAT}"')
            self._check_version(tree.get("version"))
            self.rows = _rows(tree["rows"], data)
            self.seed: int | None = tree["seed"]
            self.start = None if tree["start"] is None else _fraction(tree["start"])
            self.exact = None if tree["exact"] is None else _fraction(tree["exact"])
            if not isinstance(tree.get("overrides"), dict):
                raise ValueError("it has no parameters")
            self.overrides: Mapping[str, Any] = tree["overrides"]
        except OSError as error:
            raise UsageError(Fault("E506", self.place, f"cannot be read: {error.strerror}.")) from None
        except UsageError:
            raise
        except MemoryError:
            raise
        except Exception as error:  # whatever a damaged archive leads to
            raise self.refusal(str(error) or type(error).__name__) from None
        if self.seed is not None and (type(self.seed) is not int or not 0 <= self.seed <= LARGEST_SEED):
            raise self.refusal("its seed is not a whole number")
        self.tree = tree

    def _check_version(self, version: object) -> None:
        if version == VERSION and type(version) is int:
            return
        is_old = type(version) is int and version < VERSION
        message = f"version {legible(repr(version))} of saved states cannot be read."
        cure = "An older release of blocks saved it: start a new run." if is_old else "Use a newer release of blocks."
        raise UsageError(Fault("E506", self.place, message, cure))

    def refusal(self, why: str) -> UsageError:
        return UsageError(
            Fault("E506", self.place, f"is not a saved state: {one_line(why)}.", "Use a file that --save wrote.")
        )

    def fitted(self, plan: Plan, own: Equations) -> State:
        """Return the state, for the Plan and the equations that it must fit. Raises UsageError (E506)."""
        try:
            return self._state(plan, own)
        except (UsageError, MemoryError):
            raise
        except ValueError as error:
            raise self.refusal(str(error)) from None
        except Exception as error:  # whatever a damaged tree leads to
            raise self.refusal(f"{type(error).__name__}: {error}") from None

    def _state(self, plan: Plan, own: Equations) -> State:
        tree, equations = self.tree, Equations.read(self.tree["equations"])
        method = (str(tree["method"][0]), str(tree["method"][1]))
        steppers, foreign = tuple(tree["steppers"]), tuple(tree["foreign"])
        state = State(
            tree["plan"], method, self.overrides, self.exact, self.rows, InputTable(()), steppers, foreign,
            equations, self.seed, self.start,
        )  # fmt: skip
        state = adapted(state, plan)
        check(state.plan, plan, equations, own)
        recorded = state.rows.get("recorded")
        if recorded is not None and len(recorded) != recorded_width(plan):
            message = "the state does not fit the run: it was saved with other recorded signals."
            cure = "Record the same signals, or start a new run."
            raise UsageError(Fault("E506", "recorded signals", message, cure))
        check_rows(state.rows, self.exact, plan, method[0])
        if len(steppers) != len(plan.steppers) or len(foreign) != len(plan.foreign):
            raise ValueError("it has another number of programs or FMUs than the diagram")
        rows = {name: row for name, row in state.rows.items() if not name.startswith("inputs.")}
        return replace(state, rows=rows, inputs=inputs_of(state.rows, len(plan.inputs)))


def _read(stream: BinaryIO) -> tuple[object, bytes]:
    with zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        if len(members) > MOST_MEMBERS or sum(member.file_size for member in members) > MOST_BYTES:
            raise ValueError("it is too large")
        names = {member.filename for member in members}
        text = archive.read("state.json")
        if sum(map(text.count, (b"[", b"{", b","))) > MOST_VALUES:
            raise ValueError("it is too large")
        return json.loads(text), archive.read("rows") if "rows" in names else b""


def _rows(shapes: Mapping[str, Any], data: bytes) -> dict[str, Array]:
    """The rows of a file, by the kind and the shape that it gives for each."""
    rows, first = dict[str, Array](), 0
    for name, (kind, shape) in shapes.items():
        if kind not in KINDS or not all(type(size) is int and size >= 0 for size in shape):
            raise ValueError("a row has no shape")
        count, dtype = math.prod(shape), np.dtype(kind)
        if first + count * dtype.itemsize > len(data):
            raise ValueError("its rows are incomplete")
        values = np.frombuffer(data, dtype, count, first).astype(dtype.newbyteorder("=")).reshape(shape)
        rows[name] = values
        first += count * dtype.itemsize
    if first != len(data):
        raise ValueError("its rows are incomplete")
    return rows


def _fraction(text: object) -> Fraction:
    """An exact time as it is written: no decimals, whose exponents could be of any size."""
    if not isinstance(text, str) or not re.fullmatch(r"-?[0-9]{1,400}(/[1-9][0-9]{0,399})?", text):
        raise ValueError("its exact time is not a fraction")
    return Fraction(text)
