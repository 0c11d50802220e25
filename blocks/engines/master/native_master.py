"""The master in compiled code: one loop over function addresses, with the meaning of `engines.master.master`.

Python makes the units, initializes them and takes out what was recorded; from the start on C steps them. FMUs are
called through the addresses of their functions, native islands are runs of the native engine that record nothing.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ...compile.c import runtime_layout
from ...compile.c.master_tables import CALLS, CALLS_OF_FMI, CALLS_OF_RUNTIME, IS, Fields, MasterTables, master_files
from ...compile.c.runtime_texts import RUNTIME, packaged
from ...compile.c.structures import structures
from ...compile.coupling import CoupledUnit, Coupling, CouplingLoop
from ...compile.inputs import InputTable, Track
from ...compile.toolchain.compiler import TranslationUnit
from ...fmi.calls import ASKED, WARNING
from ...fmi.instance import PATIENCE, some
from ...fmi.loading import Loaded
from ...fmi.patience import patient
from ...fmi.trace import Tracer
from ...fmi.types import full_name
from ...host.available_memory import for_recording
from ...results.results import Event
from ...text.arrays import Array
from ...text.errors import Fault, FMUError
from ..native.run_handle import LARGEST_SPARE, MOST_SPARE, array, track_table
from ..run.memory_estimate import COPIES_OF_MASTER, no_room
from .coupled_run import CoupledRun
from .growth import circles
from .stepped_units import (
    FmuUnit,
    Running,
    acts_later,
    endless,
    endless_stops,
    endless_updates,
    foreigns,
    not_finite,
    stuck,
    too_short,
    unconverged,
    unsolved,
)

if TYPE_CHECKING:
    from ...compile.plan import Plan
    from ..native.code import Code
    from ..native.model import Model

_SPARE: list[tuple[Any, int]] = []  # memory for rows that no run has now
_P, _L, _D = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
_STRUCTURES = structures(master_files()["master.h"], known=runtime_layout.STRUCTURES)
(
    MasterLink, MasterGroup, MasterUnit, MasterQuick, MasterStage, MasterLoop, MasterPast, MasterGrowth, MasterElement,
    Master,
) = _KINDS = [kind for name, kind in _STRUCTURES.items() if name.startswith("Master")]  # fmt: skip
_STAND = ctypes.CFUNCTYPE(ctypes.c_int, _P)


def master_code() -> Code:
    """The compiled master, made once for each compiler. Raises CompilerError (E60x)."""
    from ..native.code import Code

    headers = master_files()
    text = headers["master.c"]
    runtime = TranslationUnit("runtime.c", packaged("runtime.c")["runtime.c"], packaged(*RUNTIME), is_shared=True)
    return Code([runtime, TranslationUnit("master.c", text, headers, is_shared=True)], _declare, is_quick=True)


def _declare(library: ctypes.CDLL) -> None:
    """Declare the types of its functions."""
    library.master_run.argtypes, library.master_changed.argtypes = [_P, _D], [_P, ctypes.c_int]
    library.master_open.argtypes = library.master_start.argtypes = library.master_close.argtypes = [_P]
    library.master_free.argtypes = [_P]
    library.master_close.restype = library.master_free.restype = None
    sizes = [*(_L * len(_KINDS)).in_dll(library, "master_sizes")]
    if sizes != [ctypes.sizeof(kind) for kind in _KINDS]:
        raise AssertionError(f"the structures of the master do not match its header: {sizes}")


def _calls(addresses: Mapping[int, int]) -> Any:
    """The functions of a unit by their numbers."""
    return (_P * len(CALLS))(*(addresses.get(k) for k in range(len(CALLS))))


class CoreUnit(Running):
    """Blocks with equations as a native run, whose inputs the master gives."""

    def __init__(self, unit: CoupledUnit, tracer: Tracer | None) -> None:
        from ..native.native_engine import NativeEngine  # FMUs alone need none

        assert unit.plan is not None
        self.unit, self.plan, self.u = unit, unit.plan, []
        n = len(unit.links)
        tracks = (Track(np.zeros(1), np.zeros((1, n)), False),) if n else ()
        self.engine = NativeEngine(self.plan, InputTable(tracks), foreign=foreigns(self.plan, tracer), is_silent=True)
        self.row = self.engine.tracks[1] if n else np.zeros((1, 1))
        self.can_save = not (self.plan.steppers or self.plan.foreign)
        self.engine.sim.keeps_past = 1
        self.taken: ctypes.CDLL | None = None  # the library whose functions the master calls
        self.raised: BaseException | None = None  # by the start of a native unit

    def start(self, t: float, stop: float | None) -> None:
        pass  # C begins it

    def stand(self, component: int | None) -> int:
        """Stand at the start with the inputs in the row; called by C, which gets 1 where that fails."""
        try:
            self.engine.stand_at_start()
        except BaseException as error:
            self.raised = error
            return 1
        return 0

    def functions(self) -> list[tuple[str, int]]:
        """The functions of the runtime that the master calls."""
        library = self.taken = self.engine.take_code()
        return [(name, ctypes.cast(getattr(library, f"blocks_{name}"), _P).value or 0) for name in CALLS_OF_RUNTIME]

    def take_parameters(self, unit: CoupledUnit) -> None:
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


@final
class NativeMaster(CoupledRun):
    """A run of a Coupling by compiled code. code: the compiled master, as `master_code` gives it."""

    name = "native"

    def __init__(
        self,
        coupling: Coupling,
        inputs: InputTable,
        open_unit: Callable[[Any], Loaded],
        code: Code,
        tracer: Tracer | None = None,
    ) -> None:
        self._c: Any = None
        self.code, self.library = code, code.library
        super().__init__(coupling, inputs, open_unit, tracer)
        # Compiled here, and kept, so that a compiler that fails does so before anything runs.
        self.models = [self._model(unit.plan) for unit in coupling.units if unit.plan is not None]

    def _model(self, plan: Plan) -> Model:
        from ..native.model import model_of

        return model_of(plan, plan.log, plan.settings.method, is_quick=True)

    def _clear(self) -> None:
        self._free()
        self.keep: list[Any] = []
        self.moves: list[tuple[str, str]] = []  # the calls that set and get: their names, and the variables
        super()._clear()

    def _free(self) -> None:
        """The rows that C has recorded."""
        m, self._c = self._c, None
        if m is not None:
            self.library.master_close(ctypes.byref(m))
        for rows in () if m is None else (m.rows, m.points):
            if rows.data and 8 * rows.capacity <= LARGEST_SPARE and len(_SPARE) < MOST_SPARE:
                _SPARE.append((rows.data, rows.capacity))
            elif rows.data:
                self.library.master_free(rows.data)

    def _unit(self, unit: CoupledUnit) -> Running:
        if unit.plan is not None:
            return CoreUnit(unit, self.tracer)
        with self.open_unit(unit) as loaded:
            update = ctypes.cast(self.library.master_intermediate, _P).value or 0
            return FmuUnit(unit, loaded, self.plan, update=update, tracer=self.tracer)

    # --- what C reads: a Place of MasterTables -------------------------------------------------------------------

    def array(self, values: Any, kind: str) -> int:
        buffer = np.ascontiguousarray(values, dtype=kind)
        if not buffer.size:
            buffer = np.zeros(1, dtype=kind)
        self.keep.append(buffer)
        return int(buffer.ctypes.data)

    def structures(self, kind: str, rows: Sequence[Mapping[str, Any]]) -> int:
        made = _STRUCTURES[kind]
        block = (made * max(len(rows), 1))(*(made(**row) for row in rows))
        self.keep.append(block)
        return ctypes.addressof(block)

    def function(self, k: int, name: str) -> int:
        running = self.units[k]
        assert isinstance(running, FmuUnit)
        return running.one.address(name)

    def order(self, k: int) -> Sequence[int]:
        running = self.units[k]
        assert isinstance(running, CoreUnit)
        order: Sequence[int] = running.engine.model.place.tolist()
        return order

    def unit(self, k: int) -> Fields:
        running = self.units[k]
        if isinstance(running, FmuUnit):
            return self._fmu(running)
        assert isinstance(running, CoreUnit)
        stand = _STAND(running.stand)
        self.keep.append(stand)
        return {
            "component": running.engine.address,
            "stand": ctypes.cast(stand, _P).value,
            "track": running.row.ctypes.data,
            "calls": _calls({CALLS.index(name): address for name, address in running.functions()}),
        }

    def _fmu(self, running: FmuUnit) -> Fields:
        unit, calls = running.unit, {}
        needed = {"DoStep", "ExitInitializationMode"}
        needed |= {"GetFMUState", "SetFMUState"} if running.can_save else set()
        needed |= {"EnterEventMode", "UpdateDiscreteStates", "EnterStepMode"} if unit.has_instants else set()
        for place, name in enumerate(CALLS_OF_FMI):
            try:
                calls[place] = running.one.address(name)
            except FMUError as error:
                if name in needed:
                    raise
                if name == "SetRealInputDerivatives" and running.way == "derivatives" and self.master.order:
                    running.lower(1, error.faults[0].message)
        way, takes = IS[running.way.upper()], running.takes
        return {"component": running.one.component, "calls": _calls(calls), "way": way, "takes": takes}

    def _c_tracks(self, m: Any) -> None:
        table, arrays = track_table(self.inputs)
        self.keep += [table, arrays]
        m.ntracks, m.tracks = len(table), table.ctypes.data

    def _begin(self) -> None:
        coupling, tables = self.plan, MasterTables(self.plan, self)
        m = self._c = Master(**tables.master())
        self.moves = [(name, some([slot.variable for slot in group])) for name, group in tables.moves]
        m.columns, m.ncolumns = tables.links(coupling.columns), len(coupling.columns)
        m.measured, m.nmeasured = tables.links(self.measured), len(self.measured)
        self._c_tracks(m)
        m.t, m.end, m.has_jumps = self.t, self.end, int(self.settings.records_jumps)
        if _SPARE:
            m.rows.data, m.rows.capacity = _SPARE.pop()
        m.slice, m.soft, m.most_bytes = 0.05, math.inf, for_recording() / COPIES_OF_MASTER
        m.patience = max((unit.one.timeout for unit in self.units if isinstance(unit, FmuUnit)), default=PATIENCE)
        if self.library.master_open(ctypes.byref(m)):
            raise MemoryError
        with patient() as look_up:
            status = self.library.master_start(ctypes.byref(m))
        look_up()
        exact = self.exact
        self._take_over()
        self.exact = exact
        for unit, running in zip(self._c_units, self.units, strict=True):
            running.can_save = bool(unit.can_save)
        if status == IS["FAILED"]:
            self._failed()
        for running in self.units:
            if isinstance(running, FmuUnit):
                running.one.hand_over(has_begun=True)
                running.one.forget_words()
                running.one.raise_inside()
        self._watch()

    def _watch(self) -> None:
        """Name to the master in C the elements that may grow without bound."""
        m = self._c
        watched = [
            {"size": abs(self.y[g]), "element": g, "circle": circle}
            for circle, elements in circles(self.plan, self._saving)
            for g in elements
        ]
        m.watched, m.nwatched = self.structures("MasterGrowth", watched), len(watched)
        m.grown, m.grown_t = self.array([-1] * len(watched), "int32"), self.array([0.0] * len(watched), "float64")

    @property
    def _c_units(self) -> Any:
        """The units as C has them."""
        m = self._c
        return (MasterUnit * m.nunits).from_address(m.units) if m is not None and m.owned else ()

    # --- going on ------------------------------------------------------------------------------------------------

    def _hurry(self, seconds: float) -> None:
        """Let blocks go on by optimised code if it is there. The master keeps its own, as FMUs call back into it."""
        self.code.hurry(seconds)
        for c_unit, running in zip(self._c_units, self.units, strict=True):
            if isinstance(running, CoreUnit):
                running.engine.model.code.hurry(seconds)
                if running.taken is not running.engine.model.library:
                    for name, address in running.functions():
                        c_unit.calls[CALLS.index(name)] = address

    def proceed(self, stop: Fraction) -> bool:
        with self._ending():
            if self.over is not None:
                return True
            begun = time.perf_counter()
            try:
                status = self.library.master_run(ctypes.byref(self._c), float(stop))
            finally:
                self._take_over()
            if status == IS["FAILED"]:
                self._failed()
            self._hurry(time.perf_counter() - begun)
            for running in self.units:  # an exception that was put off while an FMU called back
                if isinstance(running, FmuUnit):
                    running.one.raise_inside()
            return bool(status == IS["DONE"])
        return True

    def pause(self, every: float, at: float) -> None:
        self._c.slice, self._c.soft = every, at

    def _take_over(self) -> None:
        """Take over the state that C has reached."""
        m = self._c
        self.t, self.exact = m.t, None
        self.steps, self.rejected, self.instants, self.iterations = m.steps, m.rejected, m.instants, m.iterated
        self.y = array(m.y, m.nelements).tolist()
        for c_growth in (MasterGrowth * m.nwatched).from_address(m.watched) if m.nwatched else ():
            element = ctypes.c_int32.from_address(m.grown + 4 * c_growth.circle).value
            if element >= 0:
                self._tell_growth(element, c_growth.circle, array(m.grown_t, m.nwatched)[c_growth.circle])
        self.at = [c_unit.t for c_unit in self._c_units]
        for c_unit, running in zip(self._c_units, self.units, strict=True):
            if not math.isnan(c_unit.late_t):
                self.late.setdefault(self.units.index(running), acts_later(running.unit, c_unit.late_t))
            if c_unit.is_over and isinstance(running, FmuUnit) and running.over is None:
                running.end(c_unit.over_t)
            if c_unit.refused and isinstance(running, FmuUnit):
                self._lower(running, c_unit)
            if c_unit.warnings and isinstance(running, FmuUnit):
                c_unit.warnings = 0
                name, about = self._function(running, c_unit.warned)
                running.one.judge(name, WARNING, c_unit.warned_t, about)
                if not m.failure:  # else they belong to the failure
                    running.one.forget_words()

    @staticmethod
    def _lower(running: FmuUnit, c_unit: Any) -> None:
        """An FMU refused an order of derivatives."""
        status, c_unit.refused = c_unit.refused, 0
        try:
            running.one.judge("fmi2SetRealInputDerivatives", status, c_unit.refused_t)
        except FMUError as error:
            running.lower(c_unit.takes + 1, error.faults[0].message)

    @property
    def recorded_bytes(self) -> float:
        m = self._c
        return super().recorded_bytes + (0.0 if m is None else 8.0 * (m.rows.used + m.points.used))

    def _rows(self) -> tuple[Array, Array]:
        m = self._c
        if m is None or not m.rows.used:
            return self.recording.arrays()
        rows = array(m.rows.data, m.rows.used).reshape(-1, 1 + m.ncolumns)
        return rows[:, 0].copy(), rows[:, 1:].copy()

    def taken(self) -> Array:
        m = self._c
        if m is None or not m.rows.used:
            return super().taken()
        rows, width = np.column_stack(self._rows()), 1 + m.ncolumns
        array(m.rows.data, width)[:] = rows[-1]
        m.rows.used = width
        return rows[:-1]

    def _points(self) -> Array:
        m = self._c
        if m is None or not m.points.used:
            return np.empty(0)
        return array(m.points.data, m.points.used).reshape(-1, 2 + m.nmeasured).copy()

    def close(self) -> None:
        for unit, running in zip(self._c_units, self.units, strict=False):
            for whose, place in enumerate(unit.saved):
                if place and isinstance(running, FmuUnit):
                    running.one.free_state(place)
                    unit.saved[whose] = None
        super().close()

    def __del__(self) -> None:
        super().__del__()
        self._free()

    def _failed(self) -> None:
        """Raise what stopped the loop."""
        m, coupling = self._c, self.plan
        t, what = m.failed_t, m.failure
        running: Any = self.units[m.unit] if 0 <= m.unit < len(self.units) else None
        if what in (IS["STATUS"], IS["STUCK"], IS["TOO_EARLY"], IS["PENDING"]):
            one = running.one
            one.t = t
            if what == IS["STUCK"]:
                raise stuck(one, m.value)
            name, about = self._function(running, m.function)
            if what == IS["TOO_EARLY"]:
                raise one.broken(name, f"ended early, at {m.value:.10g} s, although early return was not allowed")
            if what == IS["PENDING"]:
                raise one.still_pending(m.patience)
            try:
                one.judge(name, m.status, t, about)
            except FMUError as error:
                is_of_state = m.function >= 0 and CALLS[m.function].endswith("FMUState")
                if not is_of_state or one.is_lost:
                    raise
                raise one.not_rolled_back(error) from None
        if what == IS["SIMULATION"]:
            running.engine.fail()
        if what == IS["NOT_BEGUN"]:
            raise running.raised
        if what == IS["NOT_FINITE"]:
            links = self.measured if m.function else coupling.columns
            raise not_finite(coupling, links[m.unit], m.value, t)
        if what == IS["NO_CONVERGENCE"]:
            raise unconverged(coupling, t, m.value)
        if what == IS["UNSOLVED"]:
            loops = [stage for stage in coupling.stages if isinstance(stage, CouplingLoop)]
            raise unsolved(coupling, loops[m.unit], m.value)
        if what == IS["ENDLESS"]:
            acting = np.flatnonzero(array(m.acting, m.nunits, ctypes.c_uint8)).tolist()
            raise endless(coupling, acting, t)
        if what == IS["ENDLESS_STOPS"]:
            raise endless_stops(running.unit, m.value)
        if what == IS["ENDLESS_UPDATES"]:
            raise endless_updates(running.unit, t)
        if what == IS["TOO_SMALL"]:
            raise too_short(coupling, m.function, t, m.value)
        raise no_room(coupling.name, t, self.recorded_bytes)

    def _function(self, running: FmuUnit, function: int) -> tuple[str, str]:
        """The name of the function that gave a status, and the variables that it moved."""
        unit = running.unit
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        if function >= 0:
            return full_name(CALLS[function], fmi), ASKED if CALLS[function] == "GetStatus" else ""
        return self.moves[-function - 1]

    # --- from outside --------------------------------------------------------------------------------------------

    def _changed(self, *, is_input: bool) -> None:
        if self.library.master_changed(ctypes.byref(self._c), is_input) == IS["FAILED"]:
            self._failed()
        self._take_over()

    def set_parameters(self, coupling: Coupling) -> None:
        with self._ending():
            self._put_parameters(coupling)
            self._changed(is_input=False)

    def set_input(self, index: int, value: Array) -> None:
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.t)
        with self._ending():
            self._c_tracks(self._c)  # the row before is recorded with the segment of the old ones
            self._changed(is_input=True)

