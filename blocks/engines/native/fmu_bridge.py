"""The FMUs of a native run: their tables for C (fmu_bridge.h), and what goes between these and `run.model_exchange`."""

from __future__ import annotations

import ctypes as c
import math
from typing import Any

import numpy as np

from ...compile.c.fmu_requests import TYPES, type_of
from ...compile.plan import Plan
from ...fmi.instance import Ended
from ...fmi.schema import Variable
from ...text.errors import Fault, FMUError, SimulationError
from ..run.model_exchange import Foreigns, Unit

__all__ = ["NativeForeigns"]

Array = np.ndarray[Any, Any]
_INITIALIZES, _CONTINUOUS = 0, 1
_CALLS = (
    "SetTime", "SetContinuousStates", "GetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators",
    "CompletedIntegratorStep", "EnterEventMode", "UpdateDiscreteStates", "EnterContinuousTimeMode",
    "ExitInitializationMode",
)  # fmt: skip
_CALLS_2 = {"GetContinuousStateDerivatives": "GetDerivatives", "UpdateDiscreteStates": "NewDiscreteStates"}
_TYPES_2 = {"Float64": "Real", "Int32": "Integer", "IntBoolean": "Boolean"}
_GET, _SET, _ENDS = 100, 200, 1000
_P, _I = c.c_void_p, c.c_int32
_VARIABLE = np.dtype(
    [("reference", np.uint32), *((name, np.int32) for name in ("type", "first", "size", "held"))], align=True
)


class _Unit(c.Structure):
    """BlocksForeign."""

    _fields_ = [
        ("component", _P),
        *((name, _I) for name in (
            "fmi", "nx", "nz", "nu", "nvariables", "ntunables", "ncrossings", "event", "completes", "mode", "asks",
            "due", "stale", "has_rates", "over", "nwatched", "looks", "status", "call", "reference",
        )),
        ("epoch", c.c_int64),
        *((name, c.c_double) for name in ("t", "next_event", "due_time")),
        *((name, _P) for name in (
            "x", "factors", "u", "had", "seen", "given", "raw", "values", "scales", "variables", "tunables",
            "crossings", "states", "watched", "followed", "lags",
        )),
        ("calls", _P * len(_CALLS)),
        ("get", _P * (len(TYPES) + 1)),
        ("set", _P * (len(TYPES) + 1)),
    ]  # fmt: skip


class _Units(c.Structure):
    """BlocksForeigns."""

    _fields_ = [("n", _I), ("units", _P), ("taken", _P)]


class _Rows:
    """What C reads and writes of one FMU."""

    def __init__(self, unit: Unit, plan: Plan, place: Array) -> None:
        opaque, part = unit.opaque, unit.part
        fmi, foreign = opaque.fmi, unit.foreign
        scales = [scale for *_, scale in opaque.inputs]
        variables = [
            (variable.reference, type_of(variable, fmi), first, size, int(held))
            for (variable, first, size), held in zip(unit.variables, unit.is_held, strict=True)
        ]
        tunables: list[int] = []
        self.used: list[Variable] = [variable for variable, _, _ in unit.variables]
        for name, first, size in unit.tunable:
            variable, scale = foreign.variables[name], foreign.scales.get(name, 1.0)
            variables.append((variable.reference, type_of(variable, fmi), len(scales), size, 1))
            self.used.append(variable)
            scales += [scale] * size
            tunables += range(first, first + size)
        self.used += [item.variable for item in opaque.items if item.variable is not None]
        nx, nu = len(opaque.states), len(scales)
        room = nx + nu + opaque.indicators + sum(unit.sizes.values()) + 8
        self.x, self.u, self.had, self.seen, self.given = (np.full(max(n, 1), math.nan) for n in (nx, nu, nu, nu, nu))
        self.raw, self.values = np.zeros(room), np.zeros(room)
        self.factors, self.scales = np.ones(max(nx, 1)), np.array([*scales, 1.0])
        self.factors[:nx] = unit.factors
        self.variables = np.array(variables, dtype=_VARIABLE)
        self.tunables = np.array(tunables or [0], dtype=np.int32)
        self.crossings = np.array(part.crossings or (0,), dtype=np.int32)
        self.states = np.array([int(place[i]) for i in part.states] or [0], dtype=np.int32)
        self.used += unit.watched
        watched = [(variable.reference, type_of(variable, fmi), 0, 1, 0) for variable in unit.watched]
        self.watched = np.array(watched or [(0,) * 5], dtype=_VARIABLE)
        self.followed = np.full(max(len(unit.watched), 1), math.nan)
        self.lags = np.zeros(max(len(unit.watched), 1), dtype=np.int32)
        self.sizes = {
            "nwatched": len(watched),
            "fmi": fmi, "nx": nx, "nz": opaque.indicators, "nu": nu, "nvariables": len(variables),
            "ntunables": len(tunables), "ncrossings": len(part.crossings), "event": part.event,
            "completes": int(unit.completes),
        }  # fmt: skip
        self.ninputs = nu - len(tunables)
        self.tuned = slice(self.ninputs, nu)


class NativeForeigns:
    """The FMUs of a run, for C. place: of each state of the plan, where the model has it."""

    def __init__(self, plan: Plan, foreign: Foreigns, place: Array) -> None:
        self.foreign = foreign
        self.rows = [_Rows(unit, plan, place) for unit in foreign]
        self.units = (_Unit * max(len(self.rows), 1))()
        self.taken = np.zeros(max(sum(rows.ninputs for rows in self.rows), 1))
        self.table = _Units(len(self.rows), c.addressof(self.units), self.taken.ctypes.data)

    @property
    def address(self) -> int:
        return c.addressof(self.table)

    def begin(self, plan: Plan, t: float) -> None:
        """Up to initialization mode; the rest is done in C."""
        self.foreign.begin(plan, t)
        for unit, rows, made in zip(self.foreign, self.rows, self.units, strict=False):
            self._connect(unit, rows, made)
            made.mode, made.t, made.next_event = _INITIALIZES, t, math.inf
            # Tunable parameters are set already.
            rows.u[rows.tuned] = rows.had[rows.tuned] = [plan.parameters[k] for k in self._tunables(rows)]
        self.listen()

    def _tunables(self, rows: _Rows) -> list[int]:
        return [int(k) for k in rows.tunables[: rows.sizes["ntunables"]]]

    def _connect(self, unit: Unit, rows: _Rows, made: Any) -> None:
        """The table of one instance, which knows of nothing that is set."""
        instance, fmi = unit.instance, rows.sizes["fmi"]
        assert instance is not None
        c.memset(c.addressof(made), 0, c.sizeof(made))
        made.component = instance.component
        for name, value in rows.sizes.items():
            setattr(made, name, value)
        for name in (
            "x", "factors", "u", "had", "seen", "given", "raw", "values", "scales", "variables", "tunables",
            "crossings", "states", "watched", "followed", "lags",
        ):  # fmt: skip
            setattr(made, name, getattr(rows, name).ctypes.data)
        for k, name in enumerate(_CALLS):
            if name == "CompletedIntegratorStep" and not rows.sizes["completes"]:
                continue
            if name == "GetEventIndicators" and not rows.sizes["nz"]:
                continue
            made.calls[k] = instance.address(f"fmi{fmi}{_CALLS_2.get(name, name) if fmi == 2 else name}")
        for variable in rows.used:
            kind = type_of(variable, fmi)
            word = (*TYPES, "IntBoolean")[kind]
            word = _TYPES_2[word] if fmi == 2 else word
            made.get[kind] = instance.address(f"fmi{fmi}Get{word}")
            if variable.causality in ("input", "parameter"):
                made.set[kind] = instance.address(f"fmi{fmi}Set{word}")
        rows.lags[:] = 0
        for row in (rows.x, rows.u, rows.had, rows.seen, rows.given, rows.followed):
            row[:] = math.nan

    def listen(self) -> None:
        """From here on, what they say belongs to the calls of C; what was raised while they said it is raised now."""
        for unit in self.foreign:
            raw = unit.raw
            raw.said_before = raw.said
            if raw.raised is not None:
                error, raw.raised = raw.raised, None
                raise error

    # --- what C did, for Python, and the other way round ------------------------------------------------------------

    def adopt(self) -> Foreigns:
        """The units for the reference engine, which knows no more of what is set."""
        for unit, rows, made in zip(self.foreign, self.rows, self.units, strict=False):
            if unit.call is None or made.mode != _CONTINUOUS:
                continue
            unit.mode, unit.t, unit.x, unit.is_stale = "continuous", math.nan, rows.x[: unit.n].tolist(), True
            unit.u = rows.seen[: rows.ninputs].tolist()
            unit.seen, unit.next_event, unit.asks = tuple(unit.u), made.next_event, bool(made.asks)
            unit.had = [
                unit.u[first : first + size] if held else None
                for (_, first, size), held in zip(unit.variables, unit.is_held, strict=True)
            ]
            made.t, made.stale = math.nan, 1
            for variable in rows.variables:
                if not variable["held"]:
                    first, size = int(variable["first"]), int(variable["size"])
                    rows.had[first : first + size] = math.nan
        return self.foreign

    def give(self, plan: Plan) -> None:
        """After the reference engine, or after a state was restored: C knows no more of what is set."""
        for unit, rows, made in zip(self.foreign, self.rows, self.units, strict=False):
            self._connect(unit, rows, made)
            made.mode, made.t, made.next_event, made.asks = _CONTINUOUS, math.nan, unit.next_event, int(unit.asks)
            n, made.stale, made.over = rows.ninputs, 1, int(unit.over is not None)
            rows.x[: unit.n] = unit.x
            rows.u[:n] = rows.seen[:n] = unit.u if unit.seen is None else unit.seen
            rows.u[rows.tuned] = rows.seen[rows.tuned] = rows.had[rows.tuned] = [
                plan.parameters[k] for k in self._tunables(rows)
            ]
            for variable in rows.variables:
                if variable["held"]:
                    first, size = int(variable["first"]), int(variable["size"])
                    rows.had[first : first + size] = rows.seen[first : first + size]
        self.listen()

    @property
    def over(self) -> Fault | None:
        """That one of them ended the run (W206)."""
        for unit, made in zip(self.foreign, self.units, strict=False):
            if made.over and unit.over is None:
                unit.raw.t = made.t
                unit.end(made.t)
        return self.foreign.over

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What they warned of."""
        for unit, rows in zip(self.foreign, self.rows, strict=False):
            unit.lags = [int(lag) for lag in rows.lags[: len(unit.watched)]]
        return self.foreign.warnings

    def failure(self) -> SimulationError | FMUError | None:
        """The error of the FMU that failed first, in its own words; None where none did."""
        for unit, rows, made in zip(self.foreign, self.rows, self.units, strict=False):
            if not made.status:
                continue
            raw, t = unit.raw, made.t
            raw.t, raw.has_begun = t, raw.has_begun or made.epoch > 0
            status, call = made.status, made.call
            if status >= _ENDS:
                return self._told(status, unit, t)
            prefix, word, about = f"fmi{rows.sizes['fmi']}", "", ""
            if call >= _GET:
                kind = (*TYPES, "IntBoolean")[call % 100]
                word = ("Set" if call >= _SET else "Get") + (_TYPES_2[kind] if rows.sizes["fmi"] == 2 else kind)
                about = next((v.name for v in rows.used if v.reference == made.reference), "")
            else:
                word = _CALLS_2.get(_CALLS[call], _CALLS[call]) if rows.sizes["fmi"] == 2 else _CALLS[call]
            try:
                raw.judge(prefix + word, status, about)
            except FMUError as error:
                return error
        return None

    def _told(self, status: int, unit: Unit, t: float) -> SimulationError | FMUError:
        what, path, name = status - _ENDS, unit.part.path, unit.foreign.path.name
        if what == 0:
            unit.end(t)
            assert unit.over is not None
            return Ended(unit.over)
        if what == 1:
            message = f"at t = {t} s the event iteration of {name} does not end."
            return SimulationError(Fault("E305", path, message, "Tell its maker."))
        if what == 2:
            message = f"a state of {name} is not finite after an event at t = {t} s."
            return SimulationError(Fault("E303", path, message, "Tell its maker; other inputs may help."))
        message = f"{name} discards what an accepted step came to, at t = {t} s."
        return FMUError(Fault("E213", path, message, "Use smaller steps or tolerances."))
