"""The FMUs of a native run: their tables for C (fmu_bridge.h), and what goes between these and `run.model_exchange`."""

from __future__ import annotations

import ctypes as c
import math
from typing import Any

import numpy as np

from ...compile.c import runtime_layout
from ...compile.c.foreign_tables import FOREIGN_CALLS, ForeignTables
from ...compile.c.runtime_texts import packaged
from ...compile.c.structures import structures
from ...compile.plan import Plan
from ...fmi.exits import Ended
from ...fmi.types import NUMBERS, call_of, call_of_code, code_of, full_name
from ...text.arrays import Array
from ...text.errors import Fault, FMUError, SimulationError
from ..run.model_exchange import Foreigns, ModelExchangeUnit

_INITIALIZES, _CONTINUOUS, _AT_EVENT = 0, 1, 2
_MODES = ("initialization", "continuous", "event")
_GET, _SET, _ENDS = 100, 200, 1000
_STRUCTURES = structures(
    *packaged("fmu_bridge.h").values(), known=runtime_layout.STRUCTURES, BLOCKS_TYPES=len(NUMBERS) + 1
)
_FOREIGN, _FOREIGNS = (_STRUCTURES[name] for name in ("BlocksForeign", "BlocksForeigns"))
_VARIABLE = np.dtype(_STRUCTURES["BlocksVariable"])
_DOUBLES = (
    "x", "factors", "origins", "u", "had", "seen", "given", "raw", "values", "scales", "offsets", "followed",
)  # fmt: skip


class FmuArrays(ForeignTables):
    """What C reads and writes of one FMU."""

    def __init__(self, unit: ModelExchangeUnit, plan: Plan, place: Array) -> None:
        super().__init__(plan, unit.part, place)
        nx, nu = self.sizes["nx"], self.sizes["nu"]
        self.x, self.u, self.had, self.seen, self.given = (np.full(max(n, 1), math.nan) for n in (nx, nu, nu, nu, nu))
        self.raw, self.values = np.zeros(self.room), np.zeros(self.room)
        self.rows = np.array(self.variables, dtype=_VARIABLE)
        watched = self.sizes["nwatched"]
        self.followed, self.lags = np.full(watched + 1, math.nan), np.zeros(watched + 1, dtype=np.int32)
        self.arrays = {
            **{name: getattr(self, name) for name in _DOUBLES}, "lags": self.lags, "variables": self.rows,
            **{name: np.array([*getattr(self, name), 0], np.int32) for name in ("tunables", "crossings", "states")},
            "watched": np.array(self.watched, dtype=_VARIABLE),
        }  # fmt: skip


class NativeForeigns:
    """The FMUs of a run, for C. place: the place in the model of each state of the plan."""

    def __init__(self, plan: Plan, foreign: Foreigns, place: Array) -> None:
        self.foreign = foreign
        self.rows = [FmuArrays(unit, plan, place) for unit in foreign]
        self.units = (_FOREIGN * max(len(self.rows), 1))()
        self.taken = np.zeros(max(sum(rows.ninputs for rows in self.rows), 1))
        self.table = _FOREIGNS(len(self.rows), c.addressof(self.units), self.taken.ctypes.data)

    @property
    def address(self) -> int:
        return c.addressof(self.table)

    def begin(self, plan: Plan, t: float) -> None:
        """Up to initialization mode; the rest is done in C."""
        self.foreign.begin(plan, t)
        for unit, rows, table in zip(self.foreign, self.rows, self.units, strict=False):
            self._connect(unit, rows, table)
            table.mode, table.t, table.next_event = _INITIALIZES, t, math.inf
            # Tunable parameters are set already.
            rows.u[rows.tuned] = rows.had[rows.tuned] = [plan.parameters[k] for k in self._tunables(rows)]
        self.listen()

    def _tunables(self, rows: FmuArrays) -> list[int]:
        return rows.tunables

    def _connect(self, unit: ModelExchangeUnit, rows: FmuArrays, table: Any) -> None:
        """Fill the table of one instance, in which nothing is known to be set."""
        instance, fmi = unit.instance, rows.sizes["fmi"]
        assert instance is not None
        c.memset(c.addressof(table), 0, c.sizeof(table))
        table.component = instance.component
        for name, value in rows.sizes.items():
            setattr(table, name, value)
        for name, array in rows.arrays.items():
            setattr(table, name, array.ctypes.data)
        for k, name in enumerate(FOREIGN_CALLS):
            if name == "CompletedIntegratorStep" and not rows.sizes["completes"]:
                continue
            if name == "GetEventIndicators" and not rows.sizes["nz"]:
                continue
            table.calls[k] = instance.address(name)
        for variable in rows.used:
            code, call = code_of(variable.type, fmi), call_of(variable.type, fmi)
            table.get[code] = instance.address(f"Get{call}")
            if variable.causality in ("input", "parameter"):
                table.set[code] = instance.address(f"Set{call}")
        rows.lags[:] = 0
        for row in (rows.x, rows.u, rows.had, rows.seen, rows.given, rows.followed):
            row[:] = math.nan

    def listen(self) -> None:
        """From here on, their messages belong to the calls of C; an exception in their callbacks is raised now."""
        for unit in self.foreign:
            unit.one.forget_words()
            unit.one.raise_inside()

    # --- what C did, for Python, and the other way round ------------------------------------------------------------

    def adopt(self) -> Foreigns:
        """The units for the reference engine, which no longer knows what is set."""
        for unit, rows, table in zip(self.foreign, self.rows, self.units, strict=False):
            if unit.instance is None or table.mode == _INITIALIZES:
                continue
            unit.mode, unit.x, unit.is_stale = _MODES[table.mode], rows.x[: unit.n].tolist(), True
            unit.t = table.t if unit.mode == "event" else math.nan
            unit.u = rows.seen[: rows.ninputs].tolist()
            unit.seen, unit.next_event, unit.asks = tuple(unit.u), table.next_event, bool(table.asks)
            unit.had = [
                unit.u[first : first + size] if held else None
                for (_, first, size), held in zip(unit.variables, unit.is_held, strict=True)
            ]
            table.t, table.stale = math.nan, 1
            for variable in rows.rows:
                if not variable["held"]:
                    first, size = int(variable["first"]), int(variable["size"])
                    rows.had[first : first + size] = math.nan
        return self.foreign

    def give(self, plan: Plan) -> None:
        """After the reference engine, or after a state was restored: C no longer knows what is set."""
        for unit, rows, table in zip(self.foreign, self.rows, self.units, strict=False):
            self._connect(unit, rows, table)
            table.mode, table.t = (_AT_EVENT, unit.t) if unit.mode == "event" else (_CONTINUOUS, math.nan)
            table.next_event, table.asks = unit.next_event, int(unit.asks)
            n, table.stale, table.over = rows.ninputs, 1, int(unit.over is not None)
            rows.x[: unit.n] = unit.x
            rows.u[:n] = rows.seen[:n] = unit.u if unit.seen is None else unit.seen
            rows.u[rows.tuned] = rows.seen[rows.tuned] = rows.had[rows.tuned] = [
                plan.parameters[k] for k in self._tunables(rows)
            ]
            for variable in rows.rows:
                if variable["held"]:
                    first, size = int(variable["first"]), int(variable["size"])
                    rows.had[first : first + size] = rows.seen[first : first + size]
        self.listen()

    @property
    def over(self) -> Fault | None:
        """The warning that one of them ended the run (W206)."""
        for unit, table in zip(self.foreign, self.units, strict=False):
            if table.over and unit.over is None:
                unit.one.t = table.t
                unit.end(table.t)
        return self.foreign.over

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """Their warnings."""
        for unit, rows, table in zip(self.foreign, self.rows, self.units, strict=False):
            unit.lags = [int(lag) for lag in rows.lags[: len(unit.watched)]]
            unit.is_late |= bool(table.late)
        return self.foreign.warnings

    def failure(self) -> SimulationError | FMUError | None:
        """The error of the FMU that failed first, in its own words; None where none did."""
        for unit, rows, table in zip(self.foreign, self.rows, self.units, strict=False):
            if not table.status:
                continue
            t, status, call, fmi = table.t, table.status, table.call, rows.sizes["fmi"]
            if status >= _ENDS:
                unit.one.t = t
                return self._told(status, unit, t)
            name, about = "", ""
            if call >= _GET:
                name = ("Set" if call >= _SET else "Get") + call_of_code(call % 100, fmi)
                about = next((v.name for v in rows.used if v.reference == table.reference), "")
            else:
                name = FOREIGN_CALLS[call]
            try:
                unit.one.judge(full_name(name, fmi), status, t, about, has_begun=table.epoch > 0)
            except FMUError as error:
                return error
        return None

    def _told(self, status: int, unit: ModelExchangeUnit, t: float) -> SimulationError | FMUError:
        what, path, name = status - _ENDS, unit.part.path, unit.foreign.path.name
        if what == 0:
            unit.end(t)
            assert unit.over is not None
            return Ended(unit.over)
        if what == 1:
            message = f"at t = {t} s the event iteration of {name} does not end."
            return SimulationError(Fault("E305", path, message, "Report it to the FMU's vendor."))
        if what == 2:
            message = f"a state of {name} is not finite after an event at t = {t} s."
            return SimulationError(Fault("E303", path, message, "Try other inputs, or report it to the FMU's vendor."))
        message = f"{name} discards the end of an accepted step, at t = {t} s."
        return FMUError(Fault("E213", path, message, "Use smaller steps or tolerances."))
