"""The master in compiled code: one loop over function addresses, with the meaning of `engines.master.master`.

Python makes the units, initializes them and takes out what was recorded; from the start on C steps them. FMUs are
called through the addresses of their functions, native islands are runs of the native engine that record nothing.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from importlib.resources import files as resources
from typing import Any

import numpy as np

from ...compile.coupling import Coupling, Loop, Slot, Unit
from ...compile.toolchain.compiler import Unit as Text
from ...compile.toolchain.compiler import build, load
from ...fmi.calls import WARNING
from ...fmi.instance import PATIENCE, Loaded, some
from ...fmi.schema import Variable
from ...results.results import Event
from ...text.available_memory import for_recording
from ...text.errors import Fault, FMUError, SimulationError
from ..native import runtime_layout
from ..native.engine import NativeEngine, grid_of
from ..native.model import RUNTIME, model_of
from ..native.rows import array
from ..native.runtime_texts import packaged
from ..run.inputs import InputTable, Track
from ..run.memory_estimate import COPIES, no_room
from .islands import (
    Course,
    FmuUnit,
    Reached,
    Running,
    calls_of,
    foreigns,
    not_finite,
    slots_at,
    stuck,
    too_short,
    unconverged,
)
from .master import MOST_LEARNT, ReferenceMaster, Row

__all__ = ["NativeMaster", "master_library"]

Array = np.ndarray[Any, Any]
_P, _I, _L, _D = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_double
_ROWS = {"k": 0, "u": 1, "y": 2}
_NATIVE, _FMI2, _FMI3 = 1, 2, 3
_WAYS = {"hold": 0, "derivatives": 1, "intermediate": 2, "mean": 3, "exact": 4}
_ALGORITHMS = {"jacobi": 0, "gauss-seidel": 1, "iterated": 2}
_TYPES = {
    "Float64": 0, "Float32": 1, "Int8": 2, "UInt8": 3, "Int16": 4, "UInt16": 5, "Int32": 6, "UInt32": 7, "Int64": 8,
    "UInt64": 9, "Boolean": 10, "Enumeration": 8,
}  # fmt: skip
_BYTES = {0: 8, 1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 8, 9: 8, 10: 1, 11: 4}
_CALLS_2 = {
    0: "DoStep", 1: "GetFMUstate", 2: "SetFMUstate", 3: "FreeFMUstate", 4: "SetRealInputDerivatives",
    5: "GetRealStatus", 6: "GetBooleanStatus", 10: "GetStatus",
}  # fmt: skip
_CALLS_3 = {
    0: "DoStep", 1: "GetFMUState", 2: "SetFMUState", 3: "FreeFMUState", 7: "EnterEventMode", 8: "UpdateDiscreteStates",
    9: "EnterStepMode",
}  # fmt: skip
_CALLS_NATIVE = {10: "proceed", 11: "settle", 12: "is_due", 13: "logged", 14: "reload", 15: "next"}
_STATES, _DERIVATIVES = (1, 2, 3), 4
_COUNT = 16
(
    _FINE, _STATUS, _STUCK, _SIMULATION, _NOT_FINITE, _NO_CONVERGENCE, _UNSOLVED, _ENDLESS, _TOO_SMALL, _MEMORY,
    _TOO_EARLY, _PENDING,
) = range(12)  # fmt: skip
_DONE, _PAUSED, _FAILED = range(3)
_QUICK = 8 * ctypes.sizeof(_P) + 2 * ctypes.sizeof(ctypes.c_size_t) + 8  # bytes of what C keeps for a quick unit


class _Group(ctypes.Structure):
    _fields_ = [
        ("type", _I), ("is_moving", _I), ("number", _I), ("unused", _I), ("nreferences", _L), ("nvalues", _L),
        *((name, _P) for name in ("references", "buffer", "places", "scales", "move")),
    ]  # fmt: skip


class _Polynomials(ctypes.Structure):
    _fields_ = [("t0", _D), ("terms", _P)]


class _Unit(ctypes.Structure):
    _fields_ = [
        *((name, _I) for name in (
            "kind", "way", "ninputs", "noutputs", "nsets", "ngets", "nfed", "has_feed", "has_instants", "can_save",
            "event_mode", "has_moving", "is_unsure", "unused",
        )),
        ("component", _P),
        ("calls", _P * _COUNT),
        *((name, _P) for name in (
            "rows", "places", "constants", "moves", "outputs", "held", "sets", "gets", "fed", "inputs", "courses",
            "terms", "track", "given", "known",
        )),
        ("polynomials", _Polynomials),
        ("grid", runtime_layout.Grid),
        ("next", _L),
        *((name, _D) for name in ("t", "next_t", "begin", "reached", "kept_t")),
        ("saved", _P),
        ("bytes", _P),
        ("nbytes", _L),
        ("counted", _P),
        ("crossed_first", _L),
        ("crossed_count", _L),
        ("uncounted", _D),
        ("over_t", _D),
        ("refused_t", _D),
        *((name, _I) for name in ("is_over", "takes", "refused")),
        *((name, _I) for name in ("is_bent", "reads_inputs", "has_saved", "is_due", "warnings", "warned")),
        ("warned_t", _D),
    ]  # fmt: skip


class _Stage(ctypes.Structure):
    _fields_ = [
        *((name, _I) for name in ("unit", "is_plain", "loop", "nelements", "nsets", "unused")),
        ("elements", _P),
        ("sets", _P),
    ]  # fmt: skip


class _Loop(ctypes.Structure):
    _fields_ = [("n", _I), ("first_stage", _I), ("nstages", _I), ("elements", _P), ("work", _P)]


class _Past(ctypes.Structure):
    _fields_ = [("n", _I), ("t", _D * 3), ("y", _D * 3)]


class _Growth(ctypes.Structure):
    _fields_ = [
        *((name, _D) for name in ("size", "begin", "most")),
        ("points", _L),
        ("last", _L),
        *((name, _I) for name in ("misses", "element", "circle", "unused")),
    ]  # fmt: skip


class _Master(ctypes.Structure):
    _fields_ = [
        *((name, _I) for name in (
            "nunits", "nelements", "nstages", "nloops", "nordered", "algorithm", "order", "iterations", "ncolumns",
            "nmeasured", "is_uniform", "nu", "ntracks", "nexchanged", "is_controlled", "is_doubled", "has_instants",
            "needs_past",
        )),
        *((name, _P) for name in (
            "units", "stages", "loops", "ordered", "at_instants", "y", "left_y", "kept_y", "guess", "ends",
            "past", "old", "kept_past", "first_reader", "readers", "element_held", "element_jumps", "element_unit",
            "column_rows", "column_places", "column_constants", "measured_rows", "measured_places",
            "measured_constants", "exchanged", "tracks", "base", "aim", "begin", "finish",
        )),
        *((name, _D) for name in ("t", "broken", "end", "start", "h", "tolerance", "ratio", "span", "shortest")),
        ("every", runtime_layout.Grid),
        ("row", _L),
        ("has_jumps", _I),
        ("fresh", _I),
        ("has_inverse", _I),
        ("inverse_h", _D),
        *((name, _P) for name in ("inverse", "z", "f", "dz", "df", "work")),
        ("rows", runtime_layout.List),
        ("points", runtime_layout.List),
        ("left_row", _P),
        ("noise", _D),
        ("has_unsure", _L),
        ("depth", _L),
        *((name, _L) for name in ("crowd", "small", "worst")),
        ("slice", _D),
        ("most_bytes", _D),
        ("patience", _D),
        *((name, _L) for name in ("steps", "rejected", "instants", "iterated")),
        *((name, _I) for name in ("failure", "unit", "function", "status")),
        ("value", _D),
        ("failed_t", _D),
        *((name, _P) for name in ("due", "acting", "changed", "quick")),
        ("is_quick", _I),
        *((name, _I) for name in ("nwatched", "keeps", "unused")),
        *((name, _P) for name in ("watched", "grown", "grown_t")),
    ]  # fmt: skip


def master_library() -> ctypes.CDLL:
    """The compiled master, made once for each compiler. Raises CompilerError (E60x)."""
    own = resources(__package__) / "c"
    headers = {**packaged("runtime.h", "model.h"), "master.h": (own / "master.h").read_text(encoding="utf-8")}
    text = (own / "master.c").read_text(encoding="utf-8")
    runtime = Text("runtime.c", packaged("runtime.c")["runtime.c"], packaged(*RUNTIME), is_shared=True)
    library = load(build([runtime, Text("master.c", text, headers, is_shared=True)]))
    library.master_run.argtypes = [_P, _D]
    library.master_begun.argtypes = library.master_changed.argtypes = [_P]
    library.master_size.restype = library.master_state_bytes.restype = _L
    library.master_state_bytes.argtypes = [_P]
    sizes = [library.master_size(k) for k in range(8)]
    ours = [*(ctypes.sizeof(kind) for kind in (_Master, _Unit, _Group, _Stage, _Loop, _Past, _Growth)), _QUICK]
    if sizes != ours:
        raise AssertionError(f"the structures of the master and of native_master.py differ: {sizes}, {ours}")
    return library


class CoreUnit:
    """Blocks with equations as a native run, whose inputs the master gives."""

    can_save: bool

    def __init__(self, unit: Unit) -> None:
        assert unit.plan is not None
        self.unit, self.plan = unit, unit.plan
        n = len(unit.links)
        self.u = [0.0] * n
        tracks = (Track(np.zeros(1), np.zeros((1, n)), False),) if n else ()
        self.engine = NativeEngine(self.plan, InputTable(tracks), foreign=foreigns(self.plan), is_silent=True)
        self.row = self.engine.tracks[1] if n else np.zeros((1, 1))
        self.given = np.zeros(max(len(unit.references), 1))
        self.can_save = not (self.plan.steppers or self.plan.histories or self.plan.foreign)

    def start(self, t: float, stop: float | None) -> None:
        self.engine.stand_at_start()

    def finish_start(self) -> None:
        self.engine.stand_at_start()

    def put(self, places: Sequence[int], values: Sequence[float]) -> None:
        for place, value in zip(places, values, strict=True):
            self.u[place] = value
            self.row[0, place] = value
        if self.engine.sim.steps or self.engine.sim.instants:
            self.engine.model.library.blocks_reload(self.engine.address)
        else:
            self.engine.stand_at_start()

    def take(self, values: Sequence[float]) -> None:
        self.put(range(len(values)), values)

    def outputs(self) -> list[float]:
        if self.engine.model.library.blocks_logged(self.engine.address, self.given.ctypes.data):
            self.engine.fail()
        return self.given.tolist()[: len(self.unit.references)]

    def step(self, t: float, t1: float, exact: Fraction | None, courses: Sequence[Course]) -> Reached:
        raise AssertionError("compiled code makes the steps")

    def instant(self, *, is_due: bool) -> bool:
        library, address, sim = self.engine.model.library, self.engine.address, self.engine.sim
        library.blocks_reload(address)
        sim.changed = 0  # that it begins is nothing that is due
        was_due = bool(library.blocks_is_due(address))
        sim.outstanding = sim.changed = 1
        if library.blocks_settle(address):
            self.engine.fail()
        return was_due

    def save(self) -> Any:
        raise AssertionError("compiled code saves")

    def restore(self, saved: Any) -> None:
        raise AssertionError("compiled code restores")

    def forget(self, saved: Any) -> None:
        raise AssertionError("compiled code forgets")

    def take_parameters(self, unit: Unit) -> None:
        assert unit.plan is not None
        self.unit, self.plan = unit, unit.plan
        self.engine.take(unit.plan)

    def events(self) -> list[Event]:
        return self.engine.fired()

    @property
    def over(self) -> Fault | None:
        return self.engine.over

    def warnings(self) -> Sequence[Fault]:
        return self.engine.warnings

    def close(self) -> None:
        self.engine.close()


class NativeMaster(ReferenceMaster):
    """A run of a Coupling by compiled code. library: the compiled master, as `master_library` gives it."""

    name = "native"

    def __init__(
        self, coupling: Coupling, inputs: InputTable, open_unit: Callable[[Any], Loaded], library: ctypes.CDLL
    ) -> None:
        self._c: Any = None
        self.library = library
        super().__init__(coupling, inputs, open_unit)
        # Compiled here, and kept, so that a compiler that fails does so before anything runs.
        plans = (unit.plan for unit in coupling.units)
        self.models = [model_of(plan, plan.log, plan.settings.method) for plan in plans if plan is not None]

    def _clear(self) -> None:
        self._free()
        self.keep: list[Any] = []
        self.moves: list[tuple[str, str]] = []  # the calls that set and get: their names, and the variables
        super()._clear()

    def _free(self) -> None:
        """The rows that C has recorded."""
        m, self._c = self._c, None
        for rows in () if m is None else (m.rows, m.points):
            if rows.data:
                _FREE(rows.data)

    def start(self) -> None:
        super().start()
        with self._ending():
            self._hand_over()

    def _unit(self, unit: Unit) -> Running:
        if unit.plan is not None:
            return CoreUnit(unit)
        with self.open_unit(unit) as loaded:
            update = ctypes.cast(self.library.master_intermediate, _P).value or 0
            return FmuUnit(unit, loaded, self.settings, update=update)

    # --- what C reads --------------------------------------------------------------------------------------------

    def _array(self, values: Any, kind: Any = float) -> int:
        made = np.ascontiguousarray(values, dtype=kind)
        if not made.size:
            made = np.zeros(1, dtype=kind)
        self.keep.append(made)
        return int(made.ctypes.data)

    def _structures(self, kind: Any, made: Sequence[Any]) -> int:
        block = (kind * max(len(made), 1))(*made)
        self.keep.append(block)
        return ctypes.addressof(block)

    def _hand_over(self) -> None:
        """Everything as it stands at the start, in C's tables."""
        coupling, settings, master = self.plan, self.settings, self.master
        n = len(coupling.elements)
        self._first_rows = self.recording.arrays()
        m = self._c = _Master()
        m.nunits, m.nelements = len(coupling.units), n
        m.algorithm, m.order, m.iterations = _ALGORITHMS[master.algorithm], master.order, master.iterations
        m.is_controlled = int(master.tolerance is not None)
        m.needs_past = int(master.order > 0 or master.algorithm != "jacobi" or bool(m.is_controlled))
        m.is_doubled = int(bool(m.is_controlled) and all(unit.can_save for unit in self.units))
        m.has_instants = int(any(unit.has_instants or unit.plan is not None for unit in coupling.units))
        m.is_uniform = int(len({unit.step for unit in coupling.units}) == 1)
        units = [self._c_unit(k) for k in range(len(self.units))]
        m.units = self._structures(_Unit, units)
        self._c_stages(m)
        m.ordered, m.at_instants = self._array(coupling.order, np.int32), self._array(coupling.at_instants, np.int32)
        m.y = self._array(self.y)
        m.left_y, m.kept_y, m.guess = self._array(np.zeros(n)), self._array(np.zeros(3 * n)), self._array(np.zeros(n))
        m.ends = self._array(np.zeros(n))
        m.noise, m.has_unsure = 10 * self.solved_to, int(bool(self.unsure))
        past = []
        for points in self.past:
            one = _Past(n=len(points))
            for k, (t, y) in enumerate(reversed(points)):
                one.t[k], one.y[k] = t, y
            past.append(one)
        m.past = self._structures(_Past, past)
        m.old, m.kept_past = self._structures(_Past, past), self._structures(_Past, past)
        first = np.cumsum([0, *(len(readers) for readers in coupling.readers)])
        m.first_reader = self._array(first, np.int32)
        m.readers = self._array([k for readers in coupling.readers for k in readers], np.int32)
        m.element_held = self._array([e.held for e in coupling.elements], np.uint8)
        m.element_jumps = self._array([e.jumps for e in coupling.elements], np.uint8)
        m.element_unit = self._array([e.unit for e in coupling.elements], np.int32)
        for name, links in (("column", coupling.columns), ("measured", tuple(self.measured))):
            rows, places, constants = _split(links)
            setattr(m, f"{name}_rows", self._array(rows, np.int32))
            setattr(m, f"{name}_places", self._array(places, np.int32))
            setattr(m, f"{name}_constants", self._array(constants))
        m.ncolumns, m.nmeasured = len(coupling.columns), len(self.measured)
        exchanged = [g for g, readers in enumerate(coupling.readers) if readers]
        m.exchanged, m.nexchanged = self._array(exchanged, np.int32), len(exchanged)
        self._c_inputs(m)
        m.t = m.start = m.broken = self.t
        m.broken, m.end = self.broken, self.end
        m.tolerance = master.tolerance or 0.0
        m.ratio = settings.atol / settings.rtol
        m.span = 1.0 if math.isnan(self.end) else self.end - float(settings.start)
        m.shortest = float(min(unit.step for unit in coupling.units))
        stop = settings.stop if settings.stop is not None else settings.start
        m.every, m.row, m.fresh = grid_of(settings.start, settings.every, stop), 1, self.fresh
        m.has_jumps = int(settings.records_jumps)
        e = len(exchanged)
        m.inverse = self._array(np.zeros(e * e)) if 0 < e <= MOST_LEARNT else None
        m.z, m.f, m.dz, m.df = (self._array(np.zeros(e)) for _ in range(4))
        m.work = self._array(np.zeros(3 * e))
        m.left_row = self._array(np.zeros(2 * m.ncolumns + 2))
        m.slice, m.most_bytes = 0.05, for_recording() / COPIES
        m.patience = max((one.one.timeout for one in self.units if isinstance(one, FmuUnit)), default=PATIENCE)
        m.due, m.acting, m.changed = (self._array(np.zeros(m.nunits), np.uint8) for _ in range(3))
        watched = [_Growth(size=abs(self.y[g]), element=g, circle=one.circle) for g, one in self.growths.items()]
        m.watched, m.nwatched = self._structures(_Growth, watched), len(watched)
        m.grown, m.grown_t = self._array(np.full(len(watched), -1), np.int32), self._array(np.zeros(len(watched)))
        m.quick = self._array(np.zeros(_QUICK * m.nunits), np.uint8)
        self.library.master_begun(ctypes.byref(m))

    def _c_inputs(self, m: Any) -> None:
        rows = []
        for track in self.inputs.tracks:
            t, u = np.ascontiguousarray(track.t, dtype=float), np.ascontiguousarray(track.u, dtype=float)
            self.keep += [t, u]
            rows.append((t.ctypes.data, u.ctypes.data, len(t), u.shape[1], int(track.linear)))
        table = np.array(rows, dtype=runtime_layout.TRACK)
        self.keep.append(table)
        m.ntracks, m.tracks = len(rows), table.ctypes.data
        m.nu = sum(row[3] for row in rows)
        m.base, m.aim, m.begin, m.finish = (self._array(np.zeros(m.nu)) for _ in range(4))

    def _c_stages(self, m: Any) -> None:
        made: list[Any] = []
        loops: list[Any] = []
        for stage in self.plan.stages:
            inside = -1
            gets = (stage,)
            if isinstance(stage, Loop):
                inside, gets = len(loops), stage.gets  # type: ignore[assignment]
                k = len(stage.elements)
                loop = _Loop(n=k, first_stage=len(made), nstages=len(gets))
                loop.elements, loop.work = self._array(stage.elements, np.int32), self._array(np.zeros(k * (k + 5)))
                loops.append(loop)
            for get in gets:
                assert not isinstance(get, Loop)
                one = _Stage(unit=get.unit, is_plain=int(not get.inputs), loop=inside, nelements=len(get.elements))
                one.elements = self._array(get.elements, np.int32)
                running = self.units[get.unit]
                if isinstance(running, FmuUnit):
                    one.sets, one.nsets = self._sets(running, slots_at(running.unit, get.inputs))
                made.append(one)
        m.stages, m.nstages = self._structures(_Stage, made), len(made)
        m.loops, m.nloops = self._structures(_Loop, loops), len(loops)

    def _c_unit(self, k: int) -> Any:
        unit, running = self.plan.units[k], self.units[k]
        one = _Unit()
        n = len(unit.links)
        one.ninputs, one.noutputs = n, len(unit.outputs)
        one.has_feed = int(any(unit.feeds))
        one.has_instants, one.can_save = int(unit.has_instants), int(running.can_save)
        one.has_moving = int(any(unit.continuous))
        one.is_unsure = int(unit.is_assumed)
        one.reads_inputs = int(any(row == "u" for row, _ in unit.links))
        rows, places, constants = _split(unit.links)
        one.rows, one.places = self._array(rows, np.int32), self._array(places, np.int32)
        one.constants, one.moves = self._array(constants), self._array(unit.continuous, np.uint8)
        one.outputs = self._array(unit.outputs, np.int32)
        one.held = self._array([self.plan.elements[g].held for g in unit.outputs], np.uint8)
        one.inputs, one.courses = self._array(np.zeros(n)), self._array(np.zeros(3 * n))
        one.known = self._array(running.u)
        stop = self.settings.stop if self.settings.stop is not None else self.settings.start + 1000
        one.grid, one.next = grid_of(self.settings.start, unit.step, stop), 0
        one.t = one.next_t = self.t
        if isinstance(running, CoreUnit):
            self._c_native(one, running)
        else:
            assert isinstance(running, FmuUnit)
            self._c_fmu(one, running)
        return one

    def _c_native(self, one: Any, running: CoreUnit) -> None:
        one.kind, one.way, one.component = _NATIVE, _WAYS["exact"], running.engine.address
        library = running.engine.model.library
        for place, name in _CALLS_NATIVE.items():
            one.calls[place] = ctypes.cast(getattr(library, f"blocks_{name}"), _P).value
        n = one.ninputs
        one.terms = one.polynomials.terms = self._array(np.zeros(4 * max(n, 1)))
        one.track = running.row.ctypes.data
        one.given = self._array(np.zeros(one.noutputs))
        plan, one.uncounted = running.plan, -math.inf
        one.counted = self._array(np.zeros(2 * len(plan.crossings) + len(plan.events) + 1))
        size = self.library.master_state_bytes(ctypes.byref(one))
        one.nbytes = 8 * (size // 8 + 2)
        one.bytes = self._array(np.zeros(2 * one.nbytes // 8))

    def _c_fmu(self, one: Any, running: FmuUnit) -> None:
        unit = running.unit
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        one.kind, one.event_mode = _FMI2 if fmi == 2 else _FMI3, int(running.interface.event_mode)
        one.component = running.one.component
        for place, name in (_CALLS_2 if fmi == 2 else _CALLS_3).items():
            is_needed = place == 0 or (place in (7, 8, 9) and one.event_mode) or (place in (1, 2) and one.can_save)
            try:
                one.calls[place] = running.one.address(f"fmi{fmi}{name}")
            except FMUError as error:
                if is_needed:
                    raise
                if place == _DERIVATIVES and running.way == "derivatives" and self.master.order:
                    running.lower(1, error.faults[0].message)
        one.way, one.takes = _WAYS[running.way], running.takes
        one.sets, one.nsets = self._sets(running, unit.slots_in)
        one.fed, one.nfed = self._sets(running, slots_at(unit, {i for feed in unit.feeds for i in feed}))
        picks = dict(zip(unit.picks, unit.outputs, strict=True))
        gets = []
        for (name, _), group in calls_of(unit.slots_out, fmi).items():
            places = [picks.get(slot.first + e, -1) for slot in group for e in range(slot.size)]
            gets.append(self._group(running, "Get", name, group, places))
        one.gets, one.ngets = self._structures(_Group, gets), len(gets)

    def _sets(self, running: FmuUnit, slots: Sequence[Slot]) -> tuple[int, int]:
        """What sets these inputs, and how many calls it takes."""
        made = []
        for (name, moves), group in calls_of(slots, running.one.fmi, running.unit.continuous).items():
            places = [slot.first + e for slot in group for e in range(slot.size)]
            made.append(self._group(running, "Set", name, group, places))
            made[-1].is_moving = int(moves)
        return self._structures(_Group, made), len(made)

    def _group(self, running: FmuUnit, way: str, name: str, group: Sequence[Slot], places: Sequence[int]) -> Any:
        fmi = running.one.fmi
        scales = [slot.scale for slot in group for _ in range(slot.size)]
        made = _Group(type=_type_of(group[0].variable, fmi), nreferences=len(group), nvalues=len(places))
        made.references = self._array([slot.variable.reference for slot in group], np.uint32)
        # Behind the values of reals stand the orders of derivatives.
        made.buffer = self._array(np.zeros(2 * len(places) + 2))
        made.places = self._array(places, np.int32)
        made.scales = self._array(scales) if any(scale != 1.0 for scale in scales) else None
        call = f"fmi{fmi}{way}{name}"
        made.move, made.number = running.one.address(call), len(self.moves)
        self.moves.append((call, some([slot.variable for slot in group])))
        return made

    # --- going on ------------------------------------------------------------------------------------------------

    def proceed(self, stop: Fraction) -> bool:
        with self._ending():
            if self.over is not None:
                return True
            try:
                status = self.library.master_run(ctypes.byref(self._c), float(stop))
            finally:
                self._take_over()
            if status == _FAILED:
                self._failed()
            for running in self.units:  # what was put off while an FMU called back
                if isinstance(running, FmuUnit) and running.one._raw.raised is not None:
                    raised, running.one._raw.raised = running.one._raw.raised, None
                    raise raised
            return bool(status == _DONE)
        return True

    def _take_over(self) -> None:
        """What C has come to."""
        m = self._c
        self.t, self.exact = m.t, None
        self.steps, self.rejected, self.instants, self.iterations = m.steps, m.rejected, m.instants, m.iterated
        self.y = array(m.y, m.nelements).tolist()
        for one in (_Growth * m.nwatched).from_address(m.watched):
            element = ctypes.c_int32.from_address(m.grown + 4 * one.circle).value
            if element >= 0:
                self._tell_growth(element, one.circle, array(m.grown_t, m.nwatched)[one.circle])
        for one, running in zip((_Unit * m.nunits).from_address(m.units), self.units, strict=False):
            if one.is_over and isinstance(running, FmuUnit) and running.over is None:
                running.end(one.over_t)
            if one.refused and isinstance(running, FmuUnit):
                self._lower(running, one)
            if one.warnings and isinstance(running, FmuUnit):
                raw = running.one._raw
                raw.t, one.warnings = one.warned_t, 0
                name, about = self._function(running, one.warned)
                raw.judge(name, WARNING, about)
                if not m.failure:  # else they belong to it
                    raw.said_before = raw.said

    @staticmethod
    def _lower(running: FmuUnit, one: Any) -> None:
        """An FMU refused an order of derivatives."""
        raw, status = running.one._raw, one.refused
        raw.t, one.refused = one.refused_t, 0
        try:
            raw.judge("fmi2SetRealInputDerivatives", status)
        except FMUError as error:
            running.lower(one.takes + 1, error.faults[0].message)

    @property
    def recorded_bytes(self) -> float:
        m = self._c
        return super().recorded_bytes + (0.0 if m is None else 8.0 * (m.rows.used + m.points.used))

    def _grid(self, k: int) -> Fraction:
        raise AssertionError("compiled code keeps the grids")

    def _rows(self) -> tuple[Array, Array]:
        m = self._c
        t, values = self.recording.arrays() if m is None else self._first_rows
        if m is None or not m.rows.used:
            return t, values
        rows = array(ctypes.addressof(m.rows.data.contents), m.rows.used).reshape(-1, 1 + m.ncolumns)
        if not m.has_jumps and len(t) and t[-1] == rows[0, 0]:  # what was set at the start has changed its row
            t, values = t[:-1], values[:-1]
        return np.concatenate([t, rows[:, 0]]), np.concatenate([values, rows[:, 1:]])

    def _points(self) -> Array:
        m, before = self._c, np.array(self.points)
        if m is None or not m.points.used:
            return before
        rows = array(ctypes.addressof(m.points.data.contents), m.points.used).reshape(-1, 2 + m.nmeasured)
        return np.concatenate([before.reshape(-1, 2 + m.nmeasured), rows])

    def close(self) -> None:
        m = self._c
        if m is not None and m.units:
            units = (_Unit * m.nunits).from_address(m.units)
            for one, running in zip(units, self.units, strict=False):
                if one.kind != _NATIVE and not running.one._raw.is_lost:  # type: ignore[attr-defined]
                    for place in (one.saved, one.calls[_COUNT - 1]):
                        if place and one.calls[3] and running.one._raw.component:  # type: ignore[attr-defined]
                            handle = ctypes.c_void_p(place)
                            kind = ctypes.CFUNCTYPE(ctypes.c_int, _P, ctypes.POINTER(_P))
                            kind(one.calls[3])(running.one.component, ctypes.byref(handle))  # type: ignore[attr-defined]
                one.saved = None
                one.calls[_COUNT - 1] = None
        super().close()

    def __del__(self) -> None:
        super().__del__()
        self._free()

    def _failed(self) -> None:
        """Raise what stopped the loop."""
        m, coupling = self._c, self.plan
        t, what = m.failed_t, m.failure
        running: Any = self.units[m.unit] if 0 <= m.unit < len(self.units) else None
        place = coupling.units[m.unit].place if running is not None else coupling.name
        if what in (_STATUS, _STUCK, _TOO_EARLY, _PENDING):
            raw = running.one._raw
            raw.t = t
            if what == _STUCK:
                raise stuck(running.one, m.value)
            name, about = self._function(running, m.function)
            if what == _TOO_EARLY:
                raise running.one._broken(name, f"ended early, at {m.value:.10g} s, which was not allowed")
            if what == _PENDING:
                raw.is_pending = True
                raise running.one._broken(name, f"stayed pending for {m.patience:g} s")
            try:
                raw.judge(name, m.status, about)
            except FMUError as error:
                if m.function not in _STATES or raw.is_lost:
                    raise
                raise running.one.not_rolled_back(error) from None
        if what == _SIMULATION:
            running.engine.fail()
        if what == _NOT_FINITE:
            links = self.measured if m.function else coupling.columns
            raise not_finite(coupling, links[m.unit], m.value, t)
        if what == _NO_CONVERGENCE:
            raise unconverged(coupling.name, t, m.value, self.master)
        if what == _UNSOLVED:
            loops = [stage for stage in coupling.stages if isinstance(stage, Loop)]
            name = coupling.elements[loops[m.unit].elements[0]].name
            message = f"no values were found at t = {m.value} s that close the loop through it."
            cure = "Start nearer to a solution, or put a UnitDelay into it."
            raise SimulationError(Fault("E307", name, message, cure))
        if what == _ENDLESS:
            message = f"at t = {t} s instants cause each other without end."
            raise SimulationError(Fault("E305", place, message, "Put a delay between them."))
        if what == _TOO_SMALL:
            raise too_short(coupling, m.function, t, m.value, self.master.tolerance)
        raise no_room(coupling.name, t, self.recorded_bytes)

    def _function(self, running: FmuUnit, function: int) -> tuple[str, str]:
        """The name of the function that gave a status, and the variables that it moved."""
        unit = running.unit
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        if function >= 0:
            return f"fmi{fmi}{(_CALLS_2 if fmi == 2 else _CALLS_3)[function]}", ""
        return self.moves[-function - 1]

    # --- from outside --------------------------------------------------------------------------------------------

    def _changed(self) -> None:
        if self.library.master_changed(ctypes.byref(self._c)) == _FAILED:
            self._failed()
        self._take_over()

    def set_parameters(self, coupling: Coupling) -> None:
        with self._ending():
            self._put_parameters(coupling)
            self._changed()

    def set_input(self, index: int, value: Array) -> None:
        m = self._c
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.t)
        with self._ending():
            # The row before is recorded with the old inputs, which C still has.
            old = m.base, m.aim, m.begin, m.finish
            self._c_inputs(m)
            for ours, theirs in zip((m.base, m.aim, m.begin, m.finish), old, strict=True):
                ctypes.memmove(ours, theirs, 8 * m.nu)
            self._changed()

    def values(self, references: Any) -> Row:
        if self._c is not None:
            self.at = [one.t for one in (_Unit * self._c.nunits).from_address(self._c.units)]
        return super().values(references)


def _split(links: Sequence[Any]) -> tuple[list[int], list[int], list[float]]:
    rows = [_ROWS[row] for row, _ in links]
    places = [0 if row == "k" else place for row, place in links]
    return rows, places, [float(place) if row == "k" else 0.0 for row, place in links]


def _type_of(variable: Variable, fmi: int) -> int:
    if fmi == 2:
        return 0 if variable.type == "Float64" else 11
    return _TYPES[variable.type]


_FREE = ctypes.CDLL(None).free
_FREE.argtypes, _FREE.restype = [_P], None
