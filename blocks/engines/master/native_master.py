"""The master in compiled code: one loop over function addresses, with the meaning of `engines.master.master`.

Python makes the units, initializes them and takes out what was recorded; from the start on C steps them. FMUs are
called through the addresses of their functions, native islands are runs of the native engine that record nothing.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from importlib.resources import files as resources
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ...compile.c import runtime_layout
from ...compile.c.runtime_grid import grid_of
from ...compile.c.runtime_texts import RUNTIME, packaged
from ...compile.c.structures import constants, structures
from ...compile.coupling import CoupledUnit, Coupling, CouplingLoop, Get, Link, Slot
from ...compile.inputs import InputTable, Track
from ...compile.toolchain.compiler import TranslationUnit
from ...compile.upstream import changed_by, remembers_inputs
from ...fmi.calls import ASKED, WARNING
from ...fmi.instance import PATIENCE, some
from ...fmi.loading import Loaded
from ...fmi.types import code_of, full_name
from ...host.available_memory import for_recording
from ...results.results import Event
from ...text.arrays import Array
from ...text.errors import Fault, FMUError
from ..native.run_handle import LARGEST_SPARE, MOST_SPARE, array, track_table
from ..run.memory_estimate import COPIES_OF_MASTER, no_room
from .coupled_run import MOST_LEARNT, CoupledRun
from .limits import limits_header
from .policy import Policy
from .stepped_units import (
    FmuUnit,
    Running,
    acts_later,
    calls_of,
    endless,
    endless_stops,
    endless_updates,
    foreigns,
    not_finite,
    slots_at,
    stuck,
    too_short,
    unconverged,
    unsolved,
)

if TYPE_CHECKING:
    from ...compile.plan import Plan, Reference
    from ..native.code import Code
    from ..native.model import Model

_SPARE: list[tuple[Any, int]] = []  # memory for rows that no run has now
_P, _L, _D = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
_C = resources(__package__) / "c"
_HEADER = (_C / "master.h").read_text(encoding="utf-8")
_STRUCTURES = structures(_HEADER, known=runtime_layout.STRUCTURES)
(
    MasterLink, MasterGroup, MasterUnit, MasterQuick, MasterStage, MasterLoop, MasterPast, MasterGrowth, MasterElement,
    Master,
) = _KINDS = [kind for name, kind in _STRUCTURES.items() if name.startswith("Master")]  # fmt: skip
_NUMBERS = constants(_HEADER)
_IS = SimpleNamespace(**{name.removeprefix("MASTER_"): number for name, number in _NUMBERS.items()})
"""The constants of the header without their "MASTER_"."""
_CALLS = [name.removeprefix("CALL_") for name in _NUMBERS if name.startswith("CALL_") and name != "CALL_COUNT"]
_OF_FMI, _OF_RUNTIME = _CALLS[: _IS.CALLS_OF_FMI], _CALLS[_IS.CALLS_OF_FMI :]
_ROWS = {"k": _IS.CONSTANT, "u": _IS.INPUT, "y": _IS.ELEMENT}


def master_code() -> Code:
    """The compiled master, made once for each compiler. Raises CompilerError (E60x)."""
    from ..native.code import Code

    headers = {**packaged("runtime.h", "model.h", "fmu_types.h"), "master.h": _HEADER, "limits.h": limits_header()}
    text = (_C / "master.c").read_text(encoding="utf-8")
    runtime = TranslationUnit("runtime.c", packaged("runtime.c")["runtime.c"], packaged(*RUNTIME), is_shared=True)
    return Code([runtime, TranslationUnit("master.c", text, headers, is_shared=True)], _declare, is_quick=True)


def _declare(library: ctypes.CDLL) -> None:
    """Declare the types of its functions."""
    library.master_run.argtypes = [_P, _D]
    library.master_changed.argtypes, library.master_state_bytes.argtypes = [_P, ctypes.c_int], [_P]
    library.master_state_bytes.restype = _L
    library.master_free.argtypes, library.master_free.restype = [_P], None
    sizes = [*(_L * len(_KINDS)).in_dll(library, "master_sizes")]
    if sizes != [ctypes.sizeof(kind) for kind in _KINDS]:
        raise AssertionError(f"the structures of the master do not match its header: {sizes}")


class CoreUnit(Running):
    """Blocks with equations as a native run, whose inputs the master gives."""

    def __init__(self, unit: CoupledUnit) -> None:
        from ..native.native_engine import NativeEngine  # FMUs alone need none

        assert unit.plan is not None
        self.unit, self.plan = unit, unit.plan
        n = len(unit.links)
        self.u = [0.0] * n
        tracks = (Track(np.zeros(1), np.zeros((1, n)), False),) if n else ()
        self.engine = NativeEngine(self.plan, InputTable(tracks), foreign=foreigns(self.plan), is_silent=True)
        self.row = self.engine.tracks[1] if n else np.zeros((1, 1))
        self.given = np.zeros(max(len(unit.references), 1))
        self.can_save = not (self.plan.steppers or self.plan.foreign)
        self.engine.sim.keeps_past = 1
        self.taken: ctypes.CDLL | None = None  # the library whose functions the master calls

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

    def instant(self, *, is_due: bool) -> bool:
        library, address, sim = self.engine.model.library, self.engine.address, self.engine.sim
        library.blocks_reload(address)
        sim.changed = 0  # its start alone makes nothing due
        was_due = bool(library.blocks_is_due(address))
        sim.outstanding = sim.changed = 1
        if library.blocks_settle(address):
            self.engine.fail()
        return was_due

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
        self, coupling: Coupling, inputs: InputTable, open_unit: Callable[[Any], Loaded], code: Code
    ) -> None:
        self._c: Any = None
        self.code, self.library = code, code.library
        super().__init__(coupling, inputs, open_unit)
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
        for rows in () if m is None else (m.rows, m.points):
            if rows.data and 8 * rows.capacity <= LARGEST_SPARE and len(_SPARE) < MOST_SPARE:
                _SPARE.append((rows.data, rows.capacity))
            elif rows.data:
                self.library.master_free(rows.data)

    def start(self) -> None:
        super().start()
        with self._ending():
            self._hand_over()

    def _unit(self, unit: CoupledUnit) -> Running:
        if unit.plan is not None:
            return CoreUnit(unit)
        with self.open_unit(unit) as loaded:
            update = ctypes.cast(self.library.master_intermediate, _P).value or 0
            return FmuUnit(unit, loaded, self.plan, update=update)

    # --- what C reads --------------------------------------------------------------------------------------------

    def _array(self, values: Any, kind: Any = float) -> int:
        buffer = np.ascontiguousarray(values, dtype=kind)
        if not buffer.size:
            buffer = np.zeros(1, dtype=kind)
        self.keep.append(buffer)
        return int(buffer.ctypes.data)

    def _structures(self, kind: Any, structures: Sequence[Any]) -> int:
        block = (kind * max(len(structures), 1))(*structures)
        self.keep.append(block)
        return ctypes.addressof(block)

    def _hand_over(self) -> None:
        """Everything as it stands at the start, in C's tables."""
        coupling, settings = self.plan, self.settings
        n = len(coupling.elements)
        self._first_rows = self.recording.arrays()
        m = self._c = Master()
        for name in Policy.__slots__:
            setattr(m, name, getattr(self.policy, name))
        m.nunits, m.nelements, m.nexchanged = len(coupling.units), n, len(coupling.exchanged)
        m.needs_past = int(m.order > 0 or m.is_sequential or m.is_controlled)
        m.has_instants = int(any(unit.acts for unit in coupling.units))
        m.has_rigid = int(any(unit.is_rigid for unit in coupling.units))
        # To know what jumps, and what the inputs of rigid units were.
        m.needs_past |= m.has_instants | (m.has_rigid & int(bool(self.inputs.tracks)))
        m.is_uniform = int(len({unit.step for unit in coupling.units}) == 1)
        m.y = self._array(self.y)
        for name, size in (("left_y", n), ("kept_y", 3 * n), ("guess", n), ("ends", n)):
            setattr(m, name, self._array(np.zeros(size)))
        units = [self._c_unit(k) for k in range(m.nunits)]
        m.units = self._structures(MasterUnit, units)
        self._c_stages(m)
        m.ordered, m.at_instants = self._array(coupling.order, np.int32), self._array(coupling.at_instants, np.int32)
        m.has_unsure = int(bool(self.unsure))
        past = [MasterPast(n=1, t=(self.t,), y=(y,)) for y in self.y]
        m.past, m.old, m.kept_past = (self._structures(MasterPast, past) for _ in range(3))
        self._c_elements(m)
        m.columns, m.ncolumns = self._links(coupling.columns), len(coupling.columns)
        m.measured, m.nmeasured = self._links(self.measured), len(self.measured)
        m.exchanged = self._array(coupling.exchanged, np.int32)
        self._c_tracks(m)
        segment = self.segment
        m.base, m.aim, m.begin, m.finish = map(self._array, (segment.base, segment.aim, segment.begin, segment.end))
        m.ending = -1 if coupling.ends is None else coupling.ends
        m.t, m.start, m.broken, m.end = self.t, self.t, self.broken, self.end
        if _SPARE:
            m.rows.data, m.rows.capacity = _SPARE.pop()
        m.every, m.row, m.fresh = grid_of(settings.start, settings.every, settings.stop), 1, self.fresh
        m.has_jumps = int(settings.records_jumps)
        e = m.nexchanged
        m.inverse = self._array(np.zeros(e * e)) if 0 < e <= MOST_LEARNT else None
        m.z, m.f, m.dz, m.df = (self._array(np.zeros(e)) for _ in range(4))
        m.work = self._array(np.zeros(3 * e))
        m.left_row = self._array(np.zeros(2 * m.ncolumns + 2))
        m.slice, m.soft, m.most_bytes = 0.05, math.inf, for_recording() / COPIES_OF_MASTER
        m.patience = max((unit.one.timeout for unit in self.units if isinstance(unit, FmuUnit)), default=PATIENCE)
        m.due, m.acting, m.changed = (self._array(np.zeros(m.nunits), np.uint8) for _ in range(3))
        m.renewed = self._array(np.zeros(n), np.uint8)
        watched = [
            MasterGrowth(size=abs(self.y[g]), element=g, circle=growth.circle) for g, growth in self.growths.items()
        ]
        m.watched, m.nwatched = self._structures(MasterGrowth, watched), len(watched)
        m.grown, m.grown_t = self._array(np.full(len(watched), -1), np.int32), self._array(np.zeros(len(watched)))
        # Inputs held, one grid, no instants, and nothing to be converted or put in order.
        is_plain = all(isinstance(stage, Get) and not stage.inputs for stage in coupling.stages)
        if is_plain and m.is_uniform and not (m.needs_past or m.has_instants):
            quick = [self._quick(m, c_unit, unit.links) for c_unit, unit in zip(units, coupling.units, strict=True)]
            if None not in quick:
                m.quick = self._structures(MasterQuick, quick)

    def _quick(self, m: Any, c_unit: Any, links: Sequence[Link]) -> Any:
        """The calls of a unit whose inputs and outputs are reals that lie side by side; None: they are not."""
        quick = MasterQuick(component=c_unit.component, step=c_unit.calls[0], kind=c_unit.kind)
        if c_unit.kind == _IS.NATIVE or c_unit.nsets > 1 or c_unit.ngets > 1:
            return None
        for n, address in ((c_unit.nsets, c_unit.sets), (c_unit.ngets, c_unit.gets)):
            if not n:
                continue
            group = MasterGroup.from_address(address)
            places, is_set = array(group.places, group.nvalues, ctypes.c_int32).tolist(), address == c_unit.sets
            if group.type != code_of("Float64", 3) or group.nvalues != group.nreferences:
                return None
            rows = {links[place].row for place in places} if is_set else {"y"}
            if rows == {"k"}:  # set once: they stay
                scales = array(group.scales, len(places)) if group.scales else 1.0
                constants = np.array([links[place].index for place in places])
                constants = constants - (array(group.offsets, len(places)) if group.offsets else 0.0)
                array(group.buffer, len(places))[:] = constants / scales
                begin = group.buffer
            else:
                places = [links[place].index for place in places] if is_set else places
                is_together = places == [*range(places[0], places[0] + len(places))] and places[0] >= 0
                if rows != {"y"} or group.scales or group.offsets or not is_together:
                    return None
                begin = m.y + 8 * places[0]
            kind = "set" if is_set else "get"
            setattr(quick, kind, group.move)
            setattr(quick, f"{kind}_references", group.references)
            setattr(quick, f"n{kind}", group.nreferences)
            setattr(quick, f"{kind}_values", begin)
        return quick

    def _c_elements(self, m: Any) -> None:
        readers = self.plan.readers
        first = np.cumsum([0, *map(len, readers)]).tolist()
        elements = [
            MasterElement(e.unit, begin, int(e.held), int(e.jumps))
            for e, begin in zip(self.plan.elements, first, strict=False)
        ]
        m.elements = self._structures(MasterElement, [*elements, MasterElement(first_reader=first[-1])])
        m.readers = self._array([k for units in readers for k in units], np.int32)

    def _links(self, links: Sequence[Link]) -> int:
        rows = [
            MasterLink(_ROWS[row], 0, place) if row == "k" else MasterLink(_ROWS[row], place) for row, place in links
        ]
        return self._structures(MasterLink, rows)

    def _c_tracks(self, m: Any) -> None:
        table, arrays = track_table(self.inputs)
        self.keep += [table, arrays]
        m.ntracks, m.tracks = len(table), table.ctypes.data

    def _c_stages(self, m: Any) -> None:
        c_stages: list[object] = []
        loops: list[object] = []
        for stage in self.plan.stages:
            if isinstance(stage, CouplingLoop):
                k = len(stage.elements)
                loop = MasterLoop(n=k, first_stage=len(c_stages), nstages=len(stage.gets))
                loop.elements, loop.work = self._array(stage.elements, np.int32), self._array(np.zeros(k * (k + 5)))
                loops.append(loop)
            inside, gets = (-1, (stage,)) if isinstance(stage, Get) else (len(loops) - 1, stage.gets)
            for get in gets:
                c_stage = MasterStage(get.unit, not get.inputs, inside, len(get.elements))
                c_stage.elements = self._array(get.elements, np.int32)
                running = self.units[get.unit]
                if isinstance(running, FmuUnit):
                    c_stage.sets, c_stage.nsets = self._sets(running, slots_at(running.unit, get.inputs))
                c_stages.append(c_stage)
        m.stages, m.nstages = self._structures(MasterStage, c_stages), len(c_stages)
        m.loops = self._structures(MasterLoop, loops)

    def _c_unit(self, k: int) -> Any:
        unit, running = self.plan.units[k], self.units[k]
        c_unit = MasterUnit()
        n = len(unit.links)
        c_unit.ninputs, c_unit.noutputs = n, len(unit.outputs)
        c_unit.has_instants, c_unit.acts, c_unit.can_save = unit.has_instants, unit.acts, running.can_save
        c_unit.has_feed, c_unit.has_moving = any(unit.feeds), any(unit.continuous)
        c_unit.is_unsure, c_unit.reads_inputs = unit.is_assumed, unit.reads_inputs
        c_unit.is_rigid, c_unit.step, c_unit.late_t = unit.is_rigid, float(unit.step), math.nan
        c_unit.links, c_unit.moves = self._links(unit.links), self._array(unit.continuous, np.uint8)
        c_unit.outputs = self._array(unit.outputs, np.int32)
        c_unit.inputs, c_unit.courses = self._array(np.zeros(n)), self._array(np.zeros(3 * n))
        c_unit.known = self._array(running.u)
        c_unit.grid, c_unit.next = grid_of(self.settings.start, unit.step, self.settings.stop), 0
        c_unit.t = c_unit.next_t = self.t
        if isinstance(running, CoreUnit):
            self._c_native(c_unit, running, self.plan.seen[k])
        else:
            assert isinstance(running, FmuUnit)
            self._c_fmu(c_unit, running)
        return c_unit

    def _c_native(self, c_unit: Any, running: CoreUnit, seen: frozenset[Reference]) -> None:
        c_unit.kind, c_unit.way, c_unit.component = _IS.NATIVE, _IS.EXACT, running.engine.address
        self._c_code(c_unit, running)
        n = c_unit.ninputs
        c_unit.terms = c_unit.polynomials.terms = self._array(np.zeros(4 * max(n, 1)))
        c_unit.track = running.row.ctypes.data
        c_unit.given = self._array(np.zeros(c_unit.noutputs + n))
        plan, c_unit.uncounted = running.plan, -math.inf
        c_unit.remembers_inputs = remembers_inputs(plan)
        if not plan.foreign:
            self._c_follows(c_unit, running, seen)
        c_unit.counted = self._array(np.zeros(2 * len(plan.crossings) + len(plan.events) + 1))
        size = c_unit.saved_bytes = self.library.master_state_bytes(ctypes.byref(c_unit))
        for whose in range(len(c_unit.saved)):
            c_unit.saved[whose] = self._array(np.zeros(size // 8 + 2))

    def _c_code(self, c_unit: Any, running: CoreUnit) -> None:
        library = running.taken = running.engine.take_code()
        for place, name in enumerate(_OF_RUNTIME, start=len(_OF_FMI)):
            c_unit.calls[place] = ctypes.cast(getattr(library, f"blocks_{name}"), _P).value

    def _hurry(self, seconds: float) -> None:
        """Let blocks go on by optimised code if it is there. The master keeps its own, as FMUs call back into it."""
        self.code.hurry(seconds)
        for c_unit, running in zip((MasterUnit * self._c.nunits).from_address(self._c.units), self.units, strict=False):
            if isinstance(running, CoreUnit):
                running.engine.model.code.hurry(seconds)
                if running.taken is not running.engine.model.library:
                    self._c_code(c_unit, running)

    def _c_follows(self, c_unit: Any, running: CoreUnit, seen: frozenset[Reference]) -> None:
        """What instants of a unit must change to be seen outside, and what its outputs follow."""
        plan = running.plan
        c_unit.seen = self._array([not seen.isdisjoint(changed) for changed in changed_by(plan)], np.uint8)
        sizes = {
            "x": len(plan.states), "d": len(plan.discretes), "s": len(plan.crossings), "u": c_unit.ninputs,
            "h": len(plan.histories),
        }  # fmt: skip
        begins = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
        x_place = running.engine.model.place  # C orders the states by the types of their blocks
        follows = [
            sorted(begins[row] + (x_place[index] if row == "x" else index) for row, index in references if row in sizes)
            for references in running.unit.follows
        ]
        c_unit.follow_first = self._array(np.cumsum([0, *map(len, follows)]), np.int32)
        c_unit.follows = self._array([place for places in follows for place in places], np.int32)
        c_unit.stood = self._array(np.zeros(sizes["x"] + sizes["d"] + sizes["s"]))
        c_unit.passed = self._array(np.zeros(sizes["h"]), np.int64)
        c_unit.moved = self._array(np.zeros(sum(sizes.values())), np.uint8)

    def _c_fmu(self, c_unit: Any, running: FmuUnit) -> None:
        unit = running.unit
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        c_unit.kind, c_unit.component = getattr(_IS, f"FMI{fmi}"), running.one.component
        needed = {"DoStep"}
        needed |= {"GetFMUState", "SetFMUState"} if running.can_save else set()
        needed |= {"EnterEventMode", "UpdateDiscreteStates", "EnterStepMode"} if unit.has_instants else set()
        for place, name in enumerate(_OF_FMI):
            try:
                c_unit.calls[place] = running.one.address(name)
            except FMUError as error:
                if name in needed:
                    raise
                if name == "SetRealInputDerivatives" and running.way == "derivatives" and self.master.order:
                    running.lower(1, error.faults[0].message)
        c_unit.way, c_unit.takes = getattr(_IS, running.way.upper()), running.takes
        c_unit.sets, c_unit.nsets = self._sets(running, unit.slots_in)
        c_unit.fed, c_unit.nfed = self._sets(running, slots_at(unit, {i for feed in unit.feeds for i in feed}))
        picks = dict(zip(unit.picks, unit.outputs, strict=True))
        gets = []
        for (name, _), group in calls_of(unit.slots_out, fmi).items():
            places = [picks.get(slot.first + e, -1) for slot in group for e in range(slot.size)]
            gets.append(self._group(running, "Get", name, group, places))
        c_unit.gets, c_unit.ngets = self._structures(MasterGroup, gets), len(gets)

    def _sets(self, running: FmuUnit, slots: Sequence[Slot]) -> tuple[int, int]:
        """The address of the calls that set these inputs, and their number."""
        groups = []
        for (name, moves), group in calls_of(slots, running.one.fmi, running.unit.continuous).items():
            places = [slot.first + e for slot in group for e in range(slot.size)]
            groups.append(self._group(running, "Set", name, group, places))
            groups[-1].is_moving = int(moves)
        return self._structures(MasterGroup, groups), len(groups)

    def _group(self, running: FmuUnit, way: str, name: str, group: Sequence[Slot], places: Sequence[int]) -> Any:
        fmi = running.one.fmi
        scales = [slot.scale for slot in group for _ in range(slot.size)]
        offsets = [slot.offset for slot in group for _ in range(slot.size)]
        c_group = MasterGroup(type=code_of(group[0].variable.type, fmi), nreferences=len(group), nvalues=len(places))
        c_group.references = self._array([slot.variable.reference for slot in group], np.uint32)
        # The orders of derivatives follow the values of reals.
        c_group.buffer = self._array(np.zeros(2 * len(places) + 2))
        c_group.places = self._array(places, np.int32)
        c_group.scales = self._array(scales) if any(scale != 1.0 for scale in scales) else None
        c_group.offsets = self._array(offsets) if any(offsets) else None
        c_group.move, c_group.number = running.one.address(way + name), len(self.moves)
        self.moves.append((full_name(way + name, fmi), some([slot.variable for slot in group])))
        return c_group

    # --- going on ------------------------------------------------------------------------------------------------

    def proceed(self, stop: Fraction) -> bool:
        with self._ending():
            if self.over is not None:
                return True
            begun = time.perf_counter()
            try:
                status = self.library.master_run(ctypes.byref(self._c), float(stop))
            finally:
                self._take_over()
            if status == _IS.FAILED:
                self._failed()
            self._hurry(time.perf_counter() - begun)
            for running in self.units:  # an exception that was put off while an FMU called back
                if isinstance(running, FmuUnit):
                    running.one.raise_inside()
            return bool(status == _IS.DONE)
        return True

    def pause(self, every: float, at: float) -> None:
        self._c.slice, self._c.soft = every, at

    def _take_over(self) -> None:
        """Take over the state that C has reached."""
        m = self._c
        self.t, self.exact = m.t, None
        self.steps, self.rejected, self.instants, self.iterations = m.steps, m.rejected, m.instants, m.iterated
        self.y = array(m.y, m.nelements).tolist()
        for c_growth in (MasterGrowth * m.nwatched).from_address(m.watched):
            element = ctypes.c_int32.from_address(m.grown + 4 * c_growth.circle).value
            if element >= 0:
                self._tell_growth(element, c_growth.circle, array(m.grown_t, m.nwatched)[c_growth.circle])
        self.at = [c_unit.t for c_unit in (MasterUnit * m.nunits).from_address(m.units)]
        for c_unit, running in zip((MasterUnit * m.nunits).from_address(m.units), self.units, strict=False):
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
        t, values = self.recording.arrays() if m is None else self._first_rows
        if m is None or not m.rows.used:
            return t, values
        rows = array(m.rows.data, m.rows.used).reshape(-1, 1 + m.ncolumns)
        if not m.has_jumps and len(t) and t[-1] == rows[0, 0]:  # what was set at the start has changed its row
            t, values = t[:-1], values[:-1]
        return np.concatenate([t, rows[:, 0]]), np.concatenate([values, rows[:, 1:]])

    def taken(self) -> Array:
        m = self._c
        if m is None or not m.rows.used:
            return super().taken()
        rows, width = np.column_stack(self._rows()), 1 + m.ncolumns
        self._first_rows = np.empty(0), np.empty((0, m.ncolumns))
        array(m.rows.data, width)[:] = rows[-1]
        m.rows.used = width
        return rows[:-1]

    def _points(self) -> Array:
        m, before = self._c, np.array(self.points)
        if m is None or not m.points.used:
            return before
        rows = array(m.points.data, m.points.used).reshape(-1, 2 + m.nmeasured)
        return np.concatenate([before.reshape(-1, 2 + m.nmeasured), rows])

    def close(self) -> None:
        m = self._c
        if m is not None and m.units:
            units = (MasterUnit * m.nunits).from_address(m.units)
            for unit, running in zip(units, self.units, strict=False):
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
        if what in (_IS.STATUS, _IS.STUCK, _IS.TOO_EARLY, _IS.PENDING):
            one = running.one
            one.t = t
            if what == _IS.STUCK:
                raise stuck(one, m.value)
            name, about = self._function(running, m.function)
            if what == _IS.TOO_EARLY:
                raise one.broken(name, f"ended early, at {m.value:.10g} s, although early return was not allowed")
            if what == _IS.PENDING:
                raise one.still_pending(m.patience)
            try:
                one.judge(name, m.status, t, about)
            except FMUError as error:
                is_of_state = m.function >= 0 and _CALLS[m.function].endswith("FMUState")
                if not is_of_state or one.is_lost:
                    raise
                raise one.not_rolled_back(error) from None
        if what == _IS.SIMULATION:
            running.engine.fail()
        if what == _IS.NOT_FINITE:
            links = self.measured if m.function else coupling.columns
            raise not_finite(coupling, links[m.unit], m.value, t)
        if what == _IS.NO_CONVERGENCE:
            raise unconverged(coupling, t, m.value)
        if what == _IS.UNSOLVED:
            loops = [stage for stage in coupling.stages if isinstance(stage, CouplingLoop)]
            raise unsolved(coupling, loops[m.unit], m.value)
        if what == _IS.ENDLESS:
            acting = np.flatnonzero(array(m.acting, m.nunits, ctypes.c_uint8)).tolist()
            raise endless(coupling, acting, t)
        if what == _IS.ENDLESS_STOPS:
            raise endless_stops(running.unit, m.value)
        if what == _IS.ENDLESS_UPDATES:
            raise endless_updates(running.unit, t)
        if what == _IS.TOO_SMALL:
            raise too_short(coupling, m.function, t, m.value)
        raise no_room(coupling.name, t, self.recorded_bytes)

    def _function(self, running: FmuUnit, function: int) -> tuple[str, str]:
        """The name of the function that gave a status, and the variables that it moved."""
        unit = running.unit
        assert unit.foreign is not None
        fmi = unit.foreign.description.fmi
        if function >= 0:
            return full_name(_CALLS[function], fmi), ASKED if _CALLS[function] == "GetStatus" else ""
        return self.moves[-function - 1]

    # --- from outside --------------------------------------------------------------------------------------------

    def _changed(self, *, is_input: bool) -> None:
        if self.library.master_changed(ctypes.byref(self._c), is_input) == _IS.FAILED:
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

