"""The native engine: a Plan in compiled code, with the meaning of the reference engine.

All that changes during a run lives in the C runtime; this class fills it, lets it go on, and takes out rows, events,
records for measures and snapshots. The runtime comes back every 0.05 s, so that progress is reported and Ctrl-C seen.
Where a run fails, the reference engine goes on from the last good moment, to find the message for C's error number.
"""

from __future__ import annotations

import ctypes
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from ...compile.c import runtime_layout
from ...compile.inputs import InputTable
from ...compile.motion import LOOKS, Motions, looked_at
from ...compile.plan import Plan, Reference
from ...compile.time_grid import Grid, within_ulps
from ...fmi.patience import patient
from ...host.available_memory import for_recording
from ...results.results import Event, Events, Statistics
from ...text.arrays import Array, frozen
from ...text.errors import BlocksError, Fault, SimulationError, UsageError
from ..run.engine import Recorded, ended_by, heard_by_python
from ..run.measures import Measures
from ..run.memory_estimate import COPIES
from ..run.saved_state import State, fit, standing
from ..run.snapshot import told_method
from ..run.step_parts import Unseen, unseen_faults
from ..run.stiffness import StateRates
from .model import Model, model_of
from .run_handle import Handle, array, track_table

if TYPE_CHECKING:
    from ..reference.reference_engine import ReferenceEngine
    from ..run.model_exchange import Foreigns
    from .fmu_bridge import NativeForeigns

Row = tuple[float, ...]

_DONE, _PAUSED, _FAILED, _NO_MEMORY = range(4)
_CODES = (
    "E303", "E303", "E303", "E301", "E303", "E305", "E306", "E307", "E309", "E304", "E301", "E310", "E303",
    "E308",
)  # fmt: skip
"""The code of each failure of runtime.h, by its number."""
_MEASURED = ("total", "span", "first", "begin", "target", "last")
_TRIED = 20  # steps in which the reference engine must fail as the native one did


class NativeEngine:
    """One run of a Plan under way, as `engines.run.engine.Engine` defines it.

    foreign: its FMUs for Model Exchange. is_silent: it records and measures nothing, as its caller does. model: that of
    a Plan that differs in values alone, where it is known.
    """

    def __init__(
        self,
        plan: Plan,
        inputs: InputTable,
        *,
        foreign: Foreigns | None = None,
        is_silent: bool = False,
        model: Model | None = None,
    ) -> None:
        self.plan, self.settings, self.inputs = plan, plan.settings, inputs
        self.model = model or model_of(plan, plan.log, plan.settings.method, is_quick=True)
        self.tracks: list[Array] = []
        self._oracle: ReferenceEngine | None = None
        self._failure: BaseException | None = None
        self._lock = threading.RLock()
        self._inside: int | None = None  # the thread in which a program of a stepper runs
        self._stop_exact: Fraction | None = None
        self._foreign: NativeForeigns | None = None
        if plan.foreign:
            from ..run.model_exchange import Foreigns
            from .fmu_bridge import NativeForeigns

            self._foreign = NativeForeigns(plan, foreign or Foreigns.of(plan), self.model.place)
        self._handle = self._made()
        self.sim, self._row = self._handle.sim, self._handle.row
        self._handle.setup.is_silent = int(is_silent)
        if is_silent:
            self._handle.setup.every.is_given = 0  # no row is made that nobody takes
        self._measured = self.model.measures_of(plan)
        self._is_clear = False
        self._clear()
        self._is_clear = True

    def _clear(self) -> None:
        """Nothing has run yet."""
        if self._is_clear:  # as it was made
            self._is_clear = False
            return
        self.model.library.blocks_reset(self.address)
        self._oracle = None
        self.told: list[Array] = []  # pieces of (t, cause)
        self._whole: Array | None = None  # rows that were taken from C, the last one included, which C has too
        # The first rows stand in memory that results may keep without a copy, where they do.
        shape = self._of_settings.expected, 1 + len(self.model.logged)
        self._first = np.empty(shape) if self.settings.records_jumps else self._handle.rows(shape)
        rows, begin, size = self._handle.sim.rows, self._first.ctypes.data, self._first.nbytes
        rows.next, rows.end, rows.bytes = begin, begin + size, float(size)

    def start(self) -> None:
        self._clear()
        self._set_start()
        if self._call(self.model.library.blocks_start, self.address):
            self.fail(start=True)

    def _set_start(self) -> None:
        """Set the values that C begins with."""
        plan, sim, start = self.plan, self.sim, self.settings.start
        sim.t = sim.broken = float(start)
        self._set_exact(start)
        for name, row in (("ticks", self._of_settings.ticks), ("p", plan.parameters), *self.model.begin):
            if len(row):
                self._row(name)[:] = row
        sim.crossing = int(plan.starting is True)
        if self._foreign is not None:
            self._foreign.begin(plan, sim.t)

    def at_start(self) -> Array:
        """Put it where it begins; the numbers of the next ticks."""
        self._clear()
        self._set_start()
        return self._row("ticks").copy()

    # --- the C side ------------------------------------------------------------------------------------------------

    def _made(self) -> Handle:
        """The C side for the settings."""
        plan, model = self.plan, self.model
        self._of_settings = of_settings = model.for_settings(plan)
        setup = runtime_layout.BlocksSetup.from_buffer_copy(of_settings.setup)
        self._atol = atol = of_settings.atol.copy()
        setup.atol = atol.ctypes.data
        setup.most_bytes = for_recording() / COPIES
        table = self._table(setup)
        callback = runtime_layout.CALLBACK(self._called) if plan.steppers else None
        if callback is not None:
            setup.callback = ctypes.cast(callback, ctypes.c_void_p).value
        keep = (model, atol, table, callback, setup)
        handle = Handle(model, setup, keep)
        memory = handle.sim.memory
        memory.n, memory.c = model.constants
        memory.f = None if self._foreign is None else self._foreign.address
        return handle

    def _table(self, setup: Any) -> Array:
        """The tracks of the inputs where C reads them."""
        if not self.inputs.tracks:
            return np.empty(0)
        table, self.tracks = track_table(self.inputs)
        setup.ntracks, setup.tracks = len(table), table.ctypes.data
        return table

    @property
    def address(self) -> int:
        """Of the C side."""
        return int(self._handle.address)

    def _set_exact(self, time: Fraction | None) -> None:
        sim = self.sim
        count = None if time is None else time / self.plan.base
        if time is None:
            sim.exact = 0
        elif self.plan.rates and count is not None and count.denominator == 1 and abs(count) <= 2**62:
            sim.exact, sim.count = 1, int(count)
        else:
            sim.exact, self._stop_exact = 2, time

    def _call(self, function: Callable[..., int], *arguments: object) -> int:
        """A function of the C side, for this thread alone."""
        with self._alone():
            return function(*arguments)

    def _alone(self) -> AbstractContextManager[object]:
        """Return what lets no other thread use the C side. Raises UsageError (E501) inside the run's own stepper."""
        if self._inside == threading.get_ident():  # other threads wait
            message = "a stepper cannot use the run that it is part of."
            raise UsageError(Fault("E501", self.plan.name, message, "Use the stepper's inputs and outputs."))
        return self._lock

    # --- going on --------------------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        return float(self.sim.t)

    @property
    def exact(self) -> Fraction | None:
        if self.sim.exact == 1:
            return self.sim.count * self.plan.base  # type: ignore[no-any-return]
        return self._stop_exact if self.sim.exact == 2 else None

    def proceed(self, stop: Fraction) -> bool:
        if self.over is not None:
            return True
        if self._foreign is not None:
            self._foreign.listen()
        end, model, begun = float(stop), self.model, time.perf_counter()
        library = self.take_code()
        with self._hearing() if self.plan.steppers or self.plan.foreign else _UNHEARD:
            status = self._call(library.blocks_advance, self.address, end, 0, 2)
        model.code.hurry(time.perf_counter() - begun)
        if self.sim.exact == 2 and self.sim.t == end and not self.sim.outstanding:
            self._stop_exact = stop
        if status in (_DONE, _PAUSED) and self.over is not None:
            self._record_end()
        if status == _DONE:
            return True
        self._drain()
        if status == _NO_MEMORY:
            raise MemoryError
        if status != _PAUSED:
            self.fail()
        return self.over is not None

    def take_code(self) -> ctypes.CDLL:
        """Return the code of the model, by which the run goes on."""
        library, setup = self.model.library, self._handle.setup
        if setup.model != self.model.address:
            setup.model = self.model.address
            library.blocks_take_model(self.address)
        return library

    def pause(self, every: float, at: float) -> None:
        self.sim.slice, self.sim.soft = every, at

    @property
    def over(self) -> Fault | None:
        foreign = None if self._foreign is None else self._foreign.over
        if foreign is not None or self.plan.ends is None or not self._row("s")[self.plan.ends]:
            return foreign
        return ended_by(self.settings.stop_when, self.t)

    def _record_end(self) -> None:
        """The last row, where something ended the run."""
        rows = self.recorded().t
        if len(rows) and within_ulps(float(rows[-1]), self.t, 0.0):
            return
        if self.model.library.blocks_record(self.address):
            self.fail()

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        return heard_by_python()  # `proceed` takes care while C runs; between, an interrupt comes at once

    @contextmanager
    def _hearing(self) -> Iterator[None]:
        """Where Python takes part in C, an interrupt is raised when C has come back, or in the program of a stepper.

        Python would else raise it on the way from C to such a program, or to what hears an FMU, where nobody can
        catch it.
        """
        with patient(lambda: self._inside is not None) as look_up:
            yield
            if self._failure is None:
                look_up()

    def _drain(self) -> None:
        """Take over the events that C has gathered."""
        with self._alone():
            self._take_over()

    def _take_over(self) -> None:
        sim = self.sim
        if sim.fired_events.used:
            pairs = array(sim.fired_events.data, sim.fired_events.used)
            self.told.append(pairs.reshape(-1, 2).copy())
            sim.fired_events.used = 0

    def _called(self, number: int, what: int, t: float, inputs: Any, outputs: Any) -> int:
        """Run a stepper by means of the reference engine."""
        try:
            try:
                self._inside = threading.get_ident()
                instants = self._reference().instants
                if what == 1:
                    instants.programs.pop(number, None)
                    return 0
                part = self.plan.steppers[number]
                count = sum(len(references) for _, references, _ in part.inputs)
                before = tuple(self._row("d").tolist())
                d = instants.stepped_with(number, t, tuple(inputs[k] for k in range(count)), before)
                for place, slot in enumerate(slot for _, slots, _ in part.outputs for slot in slots):
                    outputs[place] = d[slot]
                return 0
            finally:
                self._inside = None
        except BaseException as error:  # it is raised again when C has come back
            self._inside = None
            self._failure = error
            return 1

    def _witness(
        self, state: State | None = None, units: Foreigns | None = None, *, is_silent: bool = True
    ) -> ReferenceEngine:
        """The reference engine; where a run stood, or nowhere yet."""
        from ..reference.reference_engine import ReferenceEngine

        witness = ReferenceEngine(self.plan, self.inputs, foreign=units, is_silent=is_silent)
        if state is not None:
            witness.stand_at(state)
        return witness

    def _reference(self) -> ReferenceEngine:
        """The reference engine, which owns the programs of steppers."""
        if self._oracle is None:
            self._oracle = self._witness()
        return self._oracle

    def fail(self, *, start: bool = False) -> NoReturn:
        """Raise what stopped the run. Where the compiled code failed, the reference engine finds the message."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        if self._foreign is not None and (theirs := self._foreign.failure()) is not None:
            raise theirs
        told = self._in_words(start)
        raise (self._in_brief() if told is None else told) from None

    def _in_brief(self) -> SimulationError:
        """The error by the compiled code alone: the kind of the failure, and the name of a crossing."""
        sim = self.sim
        cure = "Run it with --engine reference for a more detailed message."
        return SimulationError(in_brief(self.plan, sim.failure, sim.culprit, self.t, cure))

    def _in_words(self, start: bool) -> SimulationError | None:
        """The error that the reference engine meets from here; None where it meets none."""
        from ..reference.chattering import TO_AND_FRO

        try:
            if start:
                self._witness(units=self._units(), is_silent=False).start()
                return None
            sim = self.sim
            state, units = self._state({}), self._units()
            witness = self._witness(state, units, is_silent=False)  # a recorded value may be the one that is not finite
            witness.rows.next = sim.row
            if sim.chatters == TO_AND_FRO:
                witness.pace.look_closely(sim.t)
            tries = _TRIED * (TO_AND_FRO if sim.chatters == TO_AND_FRO else 1)  # not every step holds a jump
            witness.stand(
                outstanding=bool(sim.outstanding),
                crossing=bool(sim.crossing),
                changed=bool(sim.changed),
                unprojected=self._unprojected(),
                tries=tries,
            )
        except SimulationError as error:
            return error
        except BlocksError:  # a stepper that cannot be saved has no second try
            return None
        return None

    # --- snapshots -------------------------------------------------------------------------------------------------

    def _unprojected(self) -> tuple[Array, tuple[float, ...]] | None:
        """Return the end of the last step before projections, if crossings are still to fire by it."""
        if self.sim.crossing != 2:
            return None
        values, place = self._row("unprojected"), self.model.place
        return frozen(values[: len(place)][place]), tuple(values[len(place) :].tolist())

    def snapshot(self, overrides: Mapping[str, object]) -> State:
        self._settle()
        state = self._state(overrides)
        return state if self._foreign is None else replace(state, foreign=self._foreign.adopt().saved())

    def _units(self) -> Foreigns | None:
        """The FMUs, for the reference engine."""
        return None if self._foreign is None else self._foreign.adopt()

    def _state(self, overrides: Mapping[str, object]) -> State:
        with self._alone():
            return self._state_now(overrides)

    def _state_now(self, overrides: Mapping[str, object]) -> State:
        self._drain()
        sim = self.sim
        place, (first, count) = self.model.place, (sim.crossed_first, sim.crossed_count)
        crossed = self._row("crossed")
        rows = {
            **{name: row.copy() for name, row in self._handle.filed().items()},
            "x": self._row("x")[place],
            "stiffness": np.array([sim.hits, sim.calm, sim.stiff_from]),
            "crossed": np.roll(crossed, -first)[:count],
            "parameters": np.array(self.plan.parameters),
            **self._measures().rows(),
        }
        if self.plan.histories:
            rows["past.parts"] = rows["past.parts"].reshape(-1, 6, len(self.plan.histories))
        if sim.has_first:
            rows["first"] = self._row("first")[place]
            if sim.ncarried:
                rows["carried"] = self.model.carried_order(self.plan).taken(self._row("carried"))
            elif sim.has_before:
                rows["before"] = self._row("before")[len(place) :][: len(self.plan.crossings)].copy()
        if sim.last_row:
            rows |= {"recorded": array(sim.last_row, self._first.shape[1]).copy(), "between": np.array(sim.between)}
        oracle = self._oracle
        blobs = [None if oracle is None else oracle.instants.saved(number) for number in range(len(self.plan.steppers))]
        method = self.settings.method, str(self.settings.step)
        return State(fit(self.plan), method, overrides, self.exact, rows, self.inputs, tuple(blobs))

    def go_on_from(self, state: State) -> None:
        """As `ReferenceEngine.go_on_from`."""
        self._clear()
        plan, sim = self.plan, self.sim
        if plan.steppers or plan.foreign:  # the reference engine has their side in Python
            reference = self._witness(state, None if self._foreign is None else self._foreign.foreign)
            if self._foreign is not None:
                self._foreign.give(plan)
            self._oracle = reference if plan.steppers else None
        rows, outstanding = standing(state, plan, self.inputs)
        self._make_room(rows)
        for name, values in self._handle.filed().items():
            values[...] = rows[name].reshape(values.shape)
        self._set_exact(state.exact)
        self._row("x")[:], self._row("p")[:] = rows["x"][self.model.order], plan.parameters
        hits, calm, sim.stiff_from = rows["stiffness"].tolist()
        sim.hits, sim.calm = int(hits), int(calm)
        if "first" in rows:
            self._row("first")[: len(rows["first"])] = rows["first"][self.model.order]
            sim.has_first = 1
            if sim.ncarried:
                row = self._row("carried")
                row[:] = 0.0  # nothing is known of steps before
                if "carried" in rows:
                    self.model.carried_order(plan).put(rows["carried"], row)
            elif "before" in rows:
                self._row("before")[len(rows["first"]) :][: len(rows["before"])] = rows["before"]
                sim.has_before = 1
        sim.crossed_count = len(rows["crossed"])
        self._row("crossed")[: sim.crossed_count] = rows["crossed"]
        self._put_measures(rows)
        settings = self.settings
        sim.row = 0 if settings.every is None else Grid.of(settings.start, settings.every).after(self.t)
        sim.outstanding = sim.changed = int(outstanding)
        self.model.library.blocks_reload(self.address)
        if "recorded" in rows:
            self._first[0], sim.between = rows["recorded"], int(rows["between"])
            sim.last_row = sim.rows.next
            sim.rows.next += self._first[0].nbytes
        elif not outstanding and self.model.library.blocks_record(self.address):
            self.fail()

    def _make_room(self, rows: Mapping[str, Array]) -> None:
        """Make room in C for what the histories of a state remember."""
        if self.plan.histories:
            past, sizes = self.sim.past, (len(rows["past.starts"]), len(rows["past.breaks"]))
            if self.model.library.blocks_past_room(self.address, *sizes):
                raise MemoryError
            past.known, past.broken = sizes

    def _measures(self) -> Measures:
        """The measures as C has them."""
        if not self._measured.count:
            return self._measured
        known = self._row("known")[: 1 + 2 * self._measured.count]
        return self._measured.kept(self._numbers_of_measures().copy(), self.paths(), known)

    def paths(self) -> dict[int, Array]:
        """The rows (parts, 7) that C keeps of measures that look back."""
        kept = {i: self._kept_measures()[i].path for i in self._measured.paths}
        return {i: array(path.data, path.used).reshape(-1, 7).copy() for i, path in kept.items()}

    def _kept_measures(self) -> Any:
        """Return what C keeps of each measure."""
        return (runtime_layout.BlocksMeasured * self._measured.count).from_address(self.sim.measured)

    def _numbers_of_measures(self) -> Array:
        """Return the numbers (m, 8) that `Measures.kept` takes, as C has them."""
        return np.frombuffer(self._kept_measures()).reshape(self._measured.count, -1)[:, :8]

    def _put_measures(self, saved: Mapping[str, Array]) -> None:
        if not self._measured.count:
            return
        columns = [saved[f"measures.{name}"] for name in (*_MEASURED, "extremes")]
        self._numbers_of_measures()[:] = np.column_stack(columns)
        known = saved["measures.known"]
        self._row("known")[: len(known)] = known
        for i in self._measured.paths:
            path, kept = saved[f"measures.path {i}"], self._kept_measures()[i].path
            if self.model.library.blocks_list_room(ctypes.addressof(kept), path.size):
                raise MemoryError
            array(kept.data, path.size)[:] = path.ravel()
            kept.used = path.size

    # --- from outside ------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Let an outstanding instant happen."""
        if self.sim.outstanding and self._call(self.model.library.blocks_settle, self.address):
            self._drain()
            if self.sim.failure == -1:
                raise MemoryError
            self.fail()

    def set_input(self, index: int, value: Array) -> None:
        with self._alone():
            self._set_input(index, value)

    def _set_input(self, index: int, value: Array) -> None:
        self._change()
        self.inputs = self.inputs.replaced(index, value)
        self._handle.keep = (*self._handle.keep[:2], self._table(self._handle.setup), *self._handle.keep[3:])
        self.model.library.blocks_reload(self.address)

    def set_parameters(self, plan: Plan) -> None:
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
        self._row("p")[:] = plan.parameters
        self._atol[:] = self.model.tolerances(plan)
        self.model.library.blocks_reload(self.address)

    def _change(self) -> None:
        if self.model.library.blocks_keep_left(self.address):
            self.fail()
        self.sim.outstanding = self.sim.changed = 1

    def values(self, references: tuple[Reference, ...]) -> Row:
        with self._alone():
            return self._values(references)

    def _values(self, references: tuple[Reference, ...]) -> Row:
        self._settle()
        if all(reference in self.model.columns for reference in references):
            row = np.empty(max(len(self.model.logged), 1))
            self.model.library.blocks_logged(self.address, row.ctypes.data)
            return tuple(float(row[self.model.columns[reference]]) for reference in references)
        state, units = self._state({}), self._units()
        return self._witness(state, units).values(references)

    @property
    def steps(self) -> int:
        return int(self.sim.steps)

    @property
    def tried(self) -> int:
        return int(self.sim.steps + self.sim.rejected)

    @property
    def blamed(self) -> Array:
        return self._row("blamed")[self.model.place]

    def state_rates(self) -> StateRates | None:
        if self.plan.foreign:
            return None
        order, place, library, t = self.model.order, self.model.place, self.model.library, self.t
        out = np.empty(len(place) + len(self.plan.crossings))  # crossings may stand behind the rates

        def rates(x: Array) -> Array:
            given = np.ascontiguousarray(x[order])
            with self._alone():
                counted = self.sim.evaluations
                library.blocks_rates(self.address, t, given.ctypes.data, out.ctypes.data)
                self.sim.evaluations = counted
            return out[place]

        x = self._row("x")[place]
        weights = self._atol[place] + self.settings.rtol * np.abs(x)
        return StateRates(self.plan.states, x, weights, rates, self.sim.instants, self.sim.longest)

    @property
    def recorded_bytes(self) -> float:
        rows = self.sim.rows
        return float(rows.bytes) - ((rows.end or 0) - (rows.next or 0))  # without the room for more of them

    def recorded(self) -> Recorded:
        with self._alone():
            return self._recorded()

    def _recorded(self) -> Recorded:
        self._take_over()
        sim, model = self.sim, self.model
        whole = self._rows()
        method = told_method(self.settings.method, sim.stiff_from)
        statistics = Statistics(method, "native", sim.steps, sim.rejected, sim.evaluations, sim.instants)
        pairs = np.concatenate(self.told) if self.told else _NO_PAIRS
        events = Events(pairs[:, 0].copy(), pairs[:, 1].astype(int), model.told_as)
        measures, uncovered = self._measures().results(self.t)
        warnings = (*self.warnings, *uncovered, *self._unseen())
        return Recorded(whole[:, 0], whole[:, 1:], events, measures, statistics, warnings)

    def _rows(self) -> Array:
        """All rows, (rows, 1 + columns); many of them are taken from C, and do not stand twice."""
        first, in_chunks = self._counts()
        if in_chunks:
            taken = self._taken(first, in_chunks, np.empty((256, self._first.shape[1])))
            self._whole = taken if self._whole is None else np.concatenate([self._whole[:-1], taken])
            self.sim.rows.bytes = float(self._whole.nbytes + self._first.nbytes)
            return self._whole
        last = self._first[:first]
        if self._whole is None:
            return last if self.settings.records_jumps else last.copy()  # what is set now changes its last row
        if first == 1 and last[0].tobytes() == self._whole[-1].tobytes():
            return self._whole
        return np.concatenate([self._whole[:-1], last])

    def _counts(self) -> tuple[int, int]:
        """How many rows stand in the first memory, and in chunks of C."""
        rows = self.sim.rows
        counts = [len(self._first)]
        if rows.nchunks:
            counts += array(rows.counts, rows.nchunks, ctypes.c_int64).tolist()
        counts[-1] -= ((rows.end or 0) - (rows.next or 0)) // (8 * self._first.shape[1])  # None: nothing is recorded
        return counts[0], sum(counts[1:])

    def _taken(self, first: int, in_chunks: int, then: Array) -> Array:
        """The rows that C has. then: where the last of them and the next ones stand."""
        taken = np.empty((first + in_chunks, self._first.shape[1]))
        begin, to, room = (part.ctypes.data for part in (self._first, taken, then))
        self.model.library.blocks_take_rows(self.address, begin, first, to, room, len(then))
        self._first = then
        return taken

    def taken(self) -> Array:
        with self._alone():
            self.sim.slice = min(self.sim.slice, 0.01)  # s: so few rows gather until the next moment
            first, in_chunks = self._counts()
            if not first:
                return self._first[:0]
            taken = self._taken(first, in_chunks, np.empty((4096, self._first.shape[1])))
            rows = taken if self._whole is None else np.concatenate([self._whole[:-1], taken])
            self.sim.rows.bytes, self._whole = float(self._first.nbytes), None
            return rows[:-1]

    def abandon(self) -> None:
        pass

    # --- as an island of a master --------------------------------------------------------------------------------

    def stand_at_start(self) -> None:
        """Values at the start with the inputs as they are; the instant there is outstanding."""
        self._clear()
        self._set_start()
        self.sim.slice = math.inf
        if self.model.library.blocks_begin(self.address):
            self.fail(start=True)

    def fired(self) -> list[Event]:
        """All events that fired."""
        self._take_over()
        pairs = np.concatenate(self.told) if self.told else np.empty((0, 2))
        return [Event(float(t), *self.model.told_as[int(k)]) for t, k in pairs]

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """The warnings of its FMUs."""
        return () if self._foreign is None else self._foreign.warnings

    def close(self) -> None:
        """Free its FMUs."""
        if self._foreign is not None:
            self._foreign.foreign.close()

    def _unseen(self) -> tuple[Fault, ...]:
        """What was not seen inside steps (W304)."""
        raws = self.sim.unseen
        if all(math.isnan(raw.t) for raw in raws):
            return ()
        by_look = {name: Unseen(raw.t, raw.what, raw.rows) for name, raw in zip(LOOKS, raws, strict=True)}
        plan, motions = self.plan, Motions(self.plan)
        asked = looked_at(plan, self._measured.references, self.model.logged)
        return unseen_faults(plan, {name: motions.of(asked[name]) for name in LOOKS}, by_look)


_UNHEARD = nullcontext()
_NO_PAIRS = np.empty((0, 2))


def in_brief(plan: Plan, failure: int, culprit: int, t: float, cure: str) -> Fault:
    """A failure of the runtime as a fault: its kind, and the name of a crossing."""
    from ...text.explanations import EXPLAINED  # an engine that does not fail needs none of it

    place, code = plan.name, _CODES[failure] if 0 <= failure < len(_CODES) else "E303"
    if code == "E304" and 0 <= culprit < len(plan.crossings):
        cause = plan.crossings[culprit]
        place = f"{plan.instances[cause.instance].path}.{cause.name}"
    return Fault(code, place, f"{EXPLAINED[code].title}, at t = {t} s.", cure)
