"""A run by the native engine: the counterpart of `engines.reference.simulation.Simulation`, with the same meaning.

All that changes during a run lives in the C runtime; this class fills it, lets it go on, and takes out rows, events,
records for measures and snapshots. The runtime comes back every 0.05 s, so that progress is told and Ctrl-C is heard.
Where a run fails, the reference engine goes on from the last good moment, to say in words what C says in numbers.
"""

from __future__ import annotations

import ctypes
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.motion import LOOKS, Motions, looked_at
from ...compile.plan import Node, Plan, Reference
from ...fmi.patience import patient
from ...results.results import Events, Results, Statistics
from ...text.available_memory import Watch, for_recording
from ...text.errors import CODES, BlocksError, Fault, SimulationError, UsageError
from ..reference.simulation import TO_AND_FRO, Simulation, check_range, kept, longest_step
from ..run.history import Past, Store
from ..run.inputs import InputTable
from ..run.measures import Measures
from ..run.memory_estimate import COPIES, no_room
from ..run.model_exchange import Foreigns
from ..run.saved_state import State, fit
from ..run.snapshot import Memory, Snapshot, frozen
from ..run.step_parts import Unseen, unseen_faults
from ..run.time_grid import Grid, within_ulps
from . import runtime_layout
from .fmu_bridge import NativeForeigns
from .model import MOST, model_of
from .rows import Handle, array, copied

__all__ = ["NativeSimulation", "grid_of", "why_not"]

Array = np.ndarray[Any, Any]
Row = tuple[float, ...]

_DONE, _PAUSED, _FAILED, _NO_MEMORY = range(4)
_CODES = (
    "E303", "E303", "E303", "E301", "E303", "E305", "E306", "E307", "E309", "E304", "E301", "E310", "E303",
)  # fmt: skip
"""The code of each failure of runtime.h, by its number."""
_CROWD = 1000
_TRIED = 20  # steps in which the reference engine must fail as the native one did


def why_not(plan: Plan, settings: Any) -> str:
    """Why a Plan cannot run natively with these settings, in words; "" where it can."""
    grids = [Grid.of(settings.start, step) for step in (settings.step, settings.every) if step is not None]
    numbers = [abs(n) for grid in grids for n in (grid.start, grid.step, grid.unit)]
    numbers += [plan.base.numerator, plan.base.denominator] if plan.rates else []
    if max(numbers, default=0) > 2**62:
        return "times are fractions of more than 62 bits"
    return ""


class NativeSimulation:
    """One run of a Plan under way; arguments and errors as of `Simulation`."""

    def __init__(
        self,
        plan: Plan,
        settings: Any,
        inputs: InputTable,
        log: tuple[str, ...],
        *,
        progress: Callable[[float], None] | None = None,
        resume: State | None = None,
        foreign: Foreigns | None = None,
    ) -> None:
        self.plan, self.settings, self.inputs, self.log, self.progress = plan, settings, inputs, log, progress
        self.model = model_of(plan, log, settings.method)
        self._tracks: list[Array] = []
        self._oracle: Simulation | None = None
        self._failure: BaseException | None = None
        self._lock = threading.RLock()
        self._is_inside = False  # whether a program of a stepper runs
        self.watch = Watch()
        self._stop_exact: Fraction | None = None
        check_range(plan, settings.start)
        self._foreign: NativeForeigns | None = None
        if plan.foreign:
            self._foreign = NativeForeigns(plan, foreign or Foreigns.of(plan, settings), self.model.place)
        self._handle = self._made(settings.start)
        self._views()
        self._empty()
        if resume is not None:
            self._resume(resume)
        else:
            self._start()

    def again(self) -> None:
        """Begin anew, as if nothing had run; what was recorded belongs to the results that were taken."""
        self.model.library.blocks_reset(self._handle.address)
        self._oracle = None
        self._empty()
        self._start()

    def _empty(self) -> None:
        """Nothing has run yet."""
        self.interrupted = False
        self.seconds = 0.0
        self.told: list[Array] = []  # pieces of (t, cause)
        self.measures = Measures(self.plan)
        # The first rows stand in memory that results may keep without a copy.
        self._first = np.empty((self._expected, 1 + len(self.model.logged)))
        rows, begin = self._handle.sim.rows, self._first.ctypes.data
        rows.next, rows.end, rows.bytes = begin, begin + self._first.nbytes, float(self._first.nbytes)

    def _start(self) -> None:
        plan, sim, start = self.plan, self._sim, self.settings.start
        sim.t = sim.broken = float(start)
        ticks = [max(0, math.ceil((start / plan.base - rate.offset) / rate.period)) for rate in plan.rates]
        self._ticks[:] = ticks
        self._set_exact(start)
        self._p[:] = plan.parameters
        self._z[:] = [plan.guesses.get(reference, 0.0) for reference in plan.unknowns]
        self._s[:] = [0.0 if isinstance(begin, Node) else float(begin.index) for begin in plan.s_start]
        self._located[:] = [float(isinstance(begin, Reference)) for begin in plan.s_start]
        sim.crossing = int(plan.starting is True)
        if self._foreign is not None:
            self._foreign.begin(plan, sim.t)
        status = self._timed(lambda: self.model.library.blocks_start(self._handle.address))
        if status:
            self._fail(status, start=True)

    # --- the C side ------------------------------------------------------------------------------------------------

    def _made(self, start: Fraction) -> Handle:
        """The C side for the settings."""
        plan, settings, model = self.plan, self.settings, self.model
        setup = runtime_layout.Setup()
        model.fill(setup)
        self._atol = atol = self._tolerances(plan)
        setup.atol = atol.ctypes.data
        setup.rtol, setup.plain_atol = settings.rtol, settings.atol
        longest = longest_step(plan, settings)
        if plan.histories:
            shortest = min(history.delay for history in plan.histories) / 1.02
            longest = shortest if settings.step is not None else min(longest, shortest)
        setup.longest = longest
        setup.scale = max([abs(float(start)), *(history.delay for history in plan.histories)])
        setup.end = math.nan if settings.stop is None else float(settings.stop)
        setup.start = float(start)
        setup.base_numerator, setup.base_denominator = plan.base.as_integer_ratio()
        stop = settings.stop if settings.stop is not None else start
        setup.fixed = grid_of(start, settings.step, stop)
        setup.every = grid_of(start, settings.every, stop)
        setup.has_jumps = int(settings.records_jumps)
        setup.most_bytes = for_recording() / COPIES
        table = self._table(setup)
        callback = runtime_layout.CALLBACK(self._called) if plan.steppers else runtime_layout.CALLBACK()
        setup.callback = callback
        keep = (model, atol, table, callback, setup)
        handle = Handle(model, setup, keep)
        memory = handle.sim.memory
        memory.n, memory.c = model.numbers.ctypes.data, model.tables.ctypes.data
        memory.f = None if self._foreign is None else self._foreign.address
        rows: Fraction | int = 256
        if settings.every is not None and settings.stop is not None:
            rows = (settings.stop - start) / settings.every + 64
        self._expected = int(min(rows, 2**26 // (8 * (1 + len(model.logged))) + 64))
        return handle

    def _tolerances(self, plan: Plan) -> Array:
        """The absolute tolerance of each state, in the order of C."""
        made: Array = self.settings.atol * np.array(plan.nominal, dtype=float)[self.model.order]
        return made

    def _table(self, setup: runtime_layout.Setup) -> Array:
        """The tracks of the inputs where C reads them."""
        self._tracks = []
        rows = []
        for track in self.inputs.tracks:
            t, u = np.ascontiguousarray(track.t, dtype=float), np.ascontiguousarray(track.u, dtype=float)
            self._tracks += [t, u]
            rows.append((t.ctypes.data, u.ctypes.data, len(t), u.shape[1], int(track.linear)))
        table = np.array(rows, dtype=runtime_layout.TRACK)
        setup.ntracks = len(rows)
        setup.tracks = table.ctypes.data
        return table

    def _views(self) -> None:
        """Rows of the C side as arrays."""
        plan, sim = self.plan, self._handle.sim
        self._sim, memory = sim, sim.memory
        nx, ns, ne = len(plan.states), len(plan.crossings), len(plan.events)
        self._d = array(memory.d, len(plan.discretes))
        self._s = array(memory.s, ns)
        self._p = array(memory.p, len(plan.parameters))
        self._z = array(memory.z, len(plan.unknowns))
        self._events, self._own = array(sim.events, ne), array(sim.own, ne)
        self._located = array(sim.located, ns)
        self._fired = array(sim.fired, ns)
        self._crossed = array(sim.crossed, _CROWD if ns else 0)
        self._ticks = array(sim.ticks, len(plan.rates), ctypes.c_int64)
        self._nx = nx

    @property
    def _x(self) -> Array:
        """The states in the order of the model; C swaps where they stand."""
        return array(self._sim.memory.x, self._nx)

    def _set_exact(self, time: Fraction | None) -> None:
        sim = self._sim
        count = None if time is None else time / self.plan.base
        if time is None:
            sim.exact = 0
        elif self.plan.rates and count is not None and count.denominator == 1 and abs(count) <= 2**62:
            sim.exact, sim.count = 1, int(count)
        else:
            sim.exact, self._stop_exact = 2, time

    def _timed(self, call: Callable[[], int]) -> int:
        with self._alone():
            begun = time.perf_counter()
            try:
                return call()
            finally:
                self.seconds += time.perf_counter() - begun

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """No other thread uses the C side meanwhile. Raises UsageError (E501) inside the run's own stepper."""
        with self._lock:
            if self._is_inside:  # this thread: others wait
                message = "a run cannot be used from inside one of its own steppers."
                raise UsageError(Fault("E501", self.plan.name, message, "Give the stepper inputs and outputs."))
            yield

    # --- going on --------------------------------------------------------------------------------------------------

    @property
    def now(self) -> Snapshot:
        """The run as it stands; an instant may be outstanding."""
        return self._snapshot()

    @property
    def t(self) -> float:
        return float(self._sim.t)

    def advance_to(self, stop: Fraction) -> None:
        """Run up to and including the instant at `stop`; see `Simulation.advance_to`."""
        check_range(self.plan, stop)
        self.interrupted = False
        library, address, end = self.model.library, self._handle.address, float(stop)
        try:
            while self.over is None:
                if self._foreign is not None:
                    self._foreign.listen()
                with self._hearing():
                    status = self._timed(lambda: library.blocks_advance(address, end, 0, 2))
                if self._sim.exact == 2 and self._sim.t == end and not self._sim.outstanding:
                    self._stop_exact = stop
                if self.progress is not None:
                    self.progress(self.t)
                if status in (_DONE, _PAUSED) and self.over is not None:
                    self._record_end()
                if status == _DONE:
                    return
                self._drain()
                if status != _PAUSED:
                    self._fail(status, stop)
                    return
                self.watch.look(self._filled)
        except KeyboardInterrupt:
            self.interrupted = True
        except MemoryError:
            self._fail(_NO_MEMORY)

    @property
    def over(self) -> Fault | None:
        """That an FMU ended the run (W206)."""
        return None if self._foreign is None else self._foreign.over

    def _record_end(self) -> None:
        """The last row, where an FMU ended the run."""
        rows = self.results().t
        if len(rows) and within_ulps(float(rows[-1]), self.t, 0.0):
            return
        if self.model.library.blocks_record(self._handle.address):
            self._fail(_FAILED)

    @contextmanager
    def _hearing(self) -> Iterator[None]:
        """An interrupt while C runs is raised when it has come back, or inside the program of a stepper.

        Python would else raise it on the way from C to such a program, or to what hears an FMU, where nobody can
        catch it.
        """
        if not (self.plan.steppers or self.plan.foreign):
            yield
            return
        with patient(lambda: self._is_inside) as look_up:
            yield
            if self._failure is None:
                look_up()

    def _drain(self) -> None:
        """Take over what C has gathered: events, and records for measures."""
        with self._alone():
            self._take_over()

    def _take_over(self) -> None:
        sim = self._sim
        if sim.fired_events.used:
            pairs = array(ctypes.addressof(sim.fired_events.data.contents), sim.fired_events.used)
            self.told.append(pairs.reshape(-1, 2).copy())
            sim.fired_events.used = 0
        if sim.records.used:
            width = 5 + 10 * self.measures.count
            records = array(ctypes.addressof(sim.records.data.contents), sim.records.used).reshape(-1, width)
            self.measures = self.measures.after_records(records)
            sim.records.used = 0

    def _called(self, number: int, what: int, t: float, inputs: Any, outputs: Any) -> int:
        """A stepper's turn, by the means of the reference engine."""
        try:
            try:
                self._is_inside = True
                instants = self._reference().instants
                if what == 1:
                    instants.programs.pop(number, None)
                    return 0
                part = self.plan.steppers[number]
                count = sum(len(references) for _, references, _ in part.inputs)
                d = instants.stepped_with(number, t, tuple(inputs[k] for k in range(count)), tuple(self._d.tolist()))
                for place, slot in enumerate(slot for _, slots, _ in part.outputs for slot in slots):
                    outputs[place] = d[slot]
                return 0
            finally:
                self._is_inside = False
        except BaseException as error:  # it is raised again when C has come back
            self._is_inside = False
            self._failure = error
            return 1

    def _reference(self) -> Simulation:
        """The reference engine, which owns the programs of steppers."""
        if self._oracle is None:
            self._oracle = Simulation.idle(self.plan, self.settings, self.inputs, self.log)
        return self._oracle

    def _fail(self, status: int, stop: Fraction | None = None, *, start: bool = False) -> None:
        """Raise what stopped the run, with the results so far."""
        failure, self._failure = self._failure, None
        if isinstance(failure, KeyboardInterrupt):
            raise failure
        results = self.results()
        if status == _NO_MEMORY:
            raise kept(no_room(self.plan.name, self.t, self._filled), results) from None
        if isinstance(failure, SimulationError):
            raise kept(failure, results) from None
        if failure is not None:
            raise failure
        if self._foreign is not None and (theirs := self._foreign.failure()) is not None:
            raise kept(theirs, results) from None
        told = self._in_words(start)
        if told is None:
            told = self._in_brief()
        raise kept(told, results) from None

    def _in_brief(self) -> SimulationError:
        """What the compiled code says by itself: the kind of the failure, and of a crossing its name."""
        sim, plan, place = self._sim, self.plan, self.plan.name
        code = _CODES[sim.failure] if 0 <= sim.failure < len(_CODES) else "E303"
        if code == "E304" and 0 <= sim.culprit < len(plan.crossings):
            cause = plan.crossings[sim.culprit]
            place = f"{plan.instances[cause.instance].path}.{cause.name}"
        cure = "The reference engine tells more (--engine reference)."
        return SimulationError(Fault(code, place, f"{CODES[code]}, at t = {self.t} s.", cure))

    def _in_words(self, start: bool) -> SimulationError | None:
        """The error that the reference engine meets from here; None where it meets none."""
        try:
            if start:
                with np.errstate(all="ignore"):
                    Simulation.idle(self.plan, self.settings, self.inputs, self.log, foreign=self._units()).begin()
                return None
            sim = self._sim
            state, units = self._state({}), self._units()
            witness = Simulation.idle(self.plan, self.settings, self.inputs, self.log, state, units)
            witness.row = sim.row
            if sim.chatters == TO_AND_FRO:  # each step is looked at, as one of many was here
                witness.many, witness.window, witness.paced, witness.chatters = 0.0, 1, sim.t, TO_AND_FRO - 1
            tries = _TRIED * (TO_AND_FRO if sim.chatters == TO_AND_FRO else 1)  # not every step holds a jump
            witness.stand(
                outstanding=bool(sim.outstanding), crossing=bool(sim.crossing), changed=bool(sim.changed), tries=tries
            )
        except SimulationError as error:
            return error
        except BlocksError:  # a stepper that cannot be saved has no second try
            return None
        return None

    # --- snapshots -------------------------------------------------------------------------------------------------

    def _snapshot(self) -> Snapshot:
        sim, plan = self._sim, self.plan
        x = frozen(self._x[self.model.place])
        first = None
        if sim.has_first:
            first = frozen(array(sim.k[0], self._nx)[self.model.place])
        exact = None
        if sim.exact == 1:
            exact = sim.count * plan.base
        elif sim.exact == 2:
            exact = self._stop_exact
        return Snapshot(
            sim.t,
            exact,
            x,
            tuple(self._d.tolist()),
            tuple(self._s.tolist()),
            tuple(self._ticks.tolist()),
            tuple(self._events.tolist()),
            tuple(self._own.tolist()),
            Memory(sim.h, sim.error, first),
            sim.fixed,
            self._past(),
            tuple(self._z.tolist()),
        )

    def _past(self) -> Past | None:
        histories = self.plan.histories
        if not histories:
            return None
        past, n = self._sim.past, len(histories)
        known, broken = past.known, past.broken
        starts, ends = (copied(place, known).tolist() for place in (past.starts, past.ends))
        parts = copied(past.parts, known * 6 * n).reshape(known, 6, n)
        breaks = list(zip(copied(past.breaks, broken).tolist(), past.orders[:broken], strict=True))
        store = Store(starts, ends, list(parts), breaks)
        passed = tuple(past.passed[:n])
        return Past(histories, store, known, broken, bool(past.open), passed, past.seen)

    def state(self, overrides: Mapping[str, Any]) -> State:
        """What the rest of the run follows from; see `Simulation.state`."""
        self._settle()
        made = self._state(overrides)
        return made if self._foreign is None else replace(made, foreign=self._foreign.adopt().saved())

    def _units(self) -> Foreigns | None:
        """The FMUs, for the reference engine."""
        return None if self._foreign is None else self._foreign.adopt()

    def _state(self, overrides: Mapping[str, Any]) -> State:
        with self._alone():
            return self._state_now(overrides)

    def _state_now(self, overrides: Mapping[str, Any]) -> State:
        self._drain()
        sim = self._sim
        first, count = sim.crossed_first, sim.crossed_count
        crossed = tuple(float(self._crossed[(first + k) % _CROWD]) for k in range(count))
        fired = tuple((j, float(t)) for j, t in enumerate(self._fired) if t > -math.inf)
        steppers = self.plan.steppers
        oracle = self._oracle
        blobs = tuple(None if oracle is None else oracle.instants.saved(number) for number in range(len(steppers)))
        located = np.empty(0) if math.isnan(sim.located_t) else self._located.copy()
        return State(
            fit(self.plan),
            (self.settings.method, str(self.settings.step)),
            overrides,
            self._snapshot(),
            self.inputs,
            self.measures.saved(),
            sim.broken,
            (sim.located_t, located),
            fired,
            crossed,
            self.plan.parameters,
            blobs,
        )

    def _resume(self, state: State) -> None:
        """Stand where a saved run stood; its last row is the first one here. The witness is `Simulation._resume`."""
        plan, sim, now = self.plan, self._sim, state.snapshot
        units = None if self._foreign is None else self._foreign.foreign
        reference = Simulation.idle(plan, self.settings, self.inputs, self.log, state, units)
        if self._foreign is not None:
            self._foreign.give(plan)
        self._oracle = reference if plan.steppers else None
        # What resuming means is said there: another method, other inputs or parameters, another grid.
        now, outstanding = reference.now, reference.outstanding
        sim.t, sim.broken = now.t, state.broken
        self._set_exact(now.exact)
        self._x[:] = now.x[self.model.order]
        self._d[:], self._s[:], self._p[:], self._z[:] = now.d, now.s, plan.parameters, now.z
        self._ticks[:] = now.ticks
        self._events[:], self._own[:] = now.events, now.own
        sim.h, sim.error, sim.fixed = now.memory.h, now.memory.error, now.fixed
        if now.memory.first is not None:
            array(sim.k[0], self._nx)[:] = now.memory.first[self.model.order]
            sim.has_first = 1
        sim.located_t, located = state.located
        self._located[:] = located if len(located) else -1.0
        for j, t in state.fired:
            self._fired[j] = t
        self._crossed[: len(state.crossed)] = state.crossed
        sim.crossed_count = len(state.crossed)
        self.measures = reference.measures
        known = self.measures.known
        if known is not None:
            array(sim.known, 1 + len(known[1]))[:] = (known[0], *known[1])
        self._put_past(now.past)
        sim.row = reference.row
        sim.outstanding = sim.changed = int(outstanding)
        self.model.library.blocks_reload(self._handle.address)
        if not outstanding and self.model.library.blocks_record(self._handle.address):
            self._fail(_FAILED)

    def _put_past(self, past: Past | None) -> None:
        if past is None:
            return
        ours, n = self._sim.past, len(past.histories)
        if self.model.library.blocks_past_room(self._handle.address, past.known, past.broken):
            raise MemoryError
        ours.known, ours.broken, ours.open, ours.seen = past.known, past.broken, int(past.open), past.seen
        store = past.store
        for place, values in ((ours.starts, store.starts), (ours.ends, store.ends)):
            if past.known:
                array(ctypes.addressof(place.contents), past.known)[:] = values[: past.known]
        if past.known:
            parts = np.array(store.parts[: past.known]).ravel()
            array(ctypes.addressof(ours.parts.contents), len(parts))[:] = parts
        for k, (t, order) in enumerate(store.breaks[: past.broken]):
            ours.breaks[k], ours.orders[k] = t, order
        for i in range(n):
            ours.passed[i] = past.passed[i]

    # --- from outside ------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        if self._sim.outstanding:
            status = self._timed(lambda: self.model.library.blocks_settle(self._handle.address))
            if status:
                self._drain()
                self._fail(_NO_MEMORY if self._sim.failure == -1 else status)

    def set_input(self, index: int, value: Array) -> None:
        """An input jumps now."""
        with self._alone():
            self._set_input(index, value)

    def _set_input(self, index: int, value: Array) -> None:
        self._change()
        self.inputs = self.inputs.replaced(index, value)
        self._handle.keep = (*self._handle.keep[:2], self._table(self._handle.setup), *self._handle.keep[3:])
        self.model.library.blocks_reload(self._handle.address)

    def set_parameters(self, plan: Plan) -> None:
        """Tunable parameters change now; the plan is the same but for their values."""
        with self._alone():
            self._set_parameters(plan)

    def _set_parameters(self, plan: Plan) -> None:
        self._change()
        if self._oracle is not None:
            self._oracle.take(plan)
        self.take(plan)

    def take(self, plan: Plan) -> None:
        """The values of parameters, and the tolerances that follow from them."""
        self.plan = plan
        self._p[:] = plan.parameters
        self._atol[:] = self._tolerances(plan)
        self.model.library.blocks_reload(self._handle.address)

    def _change(self) -> None:
        if self.model.library.blocks_keep_left(self._handle.address):
            self._fail(_FAILED)
        self._sim.outstanding = self._sim.changed = 1

    def value(self, references: tuple[Reference, ...]) -> Row:
        """Values now."""
        with self._alone():
            return self._value(references)

    def _value(self, references: tuple[Reference, ...]) -> Row:
        self._settle()
        if all(reference in self.model.columns for reference in references):
            row = np.empty(max(len(self.model.logged), 1))
            self.model.library.blocks_logged(self._handle.address, row.ctypes.data)
            return tuple(float(row[self.model.columns[reference]]) for reference in references)
        state, units = self._state({}), self._units()
        return Simulation.idle(self.plan, self.settings, self.inputs, self.log, state, units).value(references)

    @property
    def recorded_bytes(self) -> float:
        """What the rows take, and room for more of them."""
        return float(self._sim.rows.bytes)

    @property
    def _filled(self) -> float:
        """What the rows take."""
        rows = self._sim.rows
        return float(rows.bytes) - ((rows.end or 0) - (rows.next or 0))

    def results(self) -> Results:
        """What was recorded up to now."""
        with self._alone():
            return self._results()

    def _results(self) -> Results:
        self._drain()
        sim, model = self._sim, self.model
        width = 1 + len(model.logged)
        rows = sim.rows
        counts = [len(self._first), *(int(rows.counts[k]) for k in range(rows.nchunks))]
        counts[-1] -= ((rows.end or 0) - (rows.next or 0)) // (8 * width)  # None: nothing is recorded
        whole = self._first[: counts[0]]
        if not self.settings.records_jumps:
            whole = whole.copy()  # what is set now changes its last row
        if len(counts) > 1:
            places = [ctypes.addressof(rows.chunks[k].contents) for k in range(rows.nchunks)]
            more = (array(at, n * width).reshape(-1, width) for at, n in zip(places, counts[1:], strict=True))
            whole = np.concatenate([whole, *more])
        columns, first = {}, 0
        for name in self.log:
            signal = self.plan.signal(name)
            columns[name] = (first, signal.shape, signal.unit)
            first += len(signal.references)
        statistics = Statistics(
            self.settings.method, "native", sim.steps, sim.rejected, sim.evaluations, sim.instants, self.seconds
        )
        t, values = whole[:, 0], whole[:, 1:]
        pairs = np.concatenate(self.told) if self.told else np.empty((0, 2))
        events = Events(pairs[:, 0].copy(), pairs[:, 1].astype(int), tuple(model.told_as))
        measures, uncovered = self.measures.results(self.t)
        warnings = () if self._foreign is None else self._foreign.warnings
        uncovered = (*uncovered, *self._unseen(), *(() if self.over is None else (self.over,)))
        return Results(
            self.plan.name, t, values, columns, events, measures, statistics, self.interrupted,
            warnings=(*warnings, *uncovered),
        )  # fmt: skip

    def _unseen(self) -> tuple[Fault, ...]:
        """What was not seen inside steps (W304)."""
        found = {name: Unseen(made.t, made.what, made.rows) for name, made in zip(LOOKS, self._sim.unseen, strict=True)}
        if all(math.isnan(unseen.t) for unseen in found.values()):
            return ()
        plan, motions = self.plan, Motions(self.plan)
        asked = looked_at(plan, self.measures.references, self.model.logged)
        return unseen_faults(plan, {name: motions.of(asked[name]) for name in LOOKS}, found)


def grid_of(start: Fraction, step: Fraction | None, stop: Fraction) -> runtime_layout.Grid:
    if step is None:
        return runtime_layout.Grid()
    grid = Grid.of(start, step)
    most = abs(int(max(abs(start), abs(stop)) * grid.unit)) + 4 * grid.step
    return runtime_layout.Grid(grid.start, grid.step, grid.unit, int(max(most, grid.unit) < MOST), 1)
