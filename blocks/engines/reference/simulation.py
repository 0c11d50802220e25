"""The run: from instant to instant by a method, recording and measuring on the way.

    sim = Simulation(plan, settings, inputs, log)
    sim.advance_to(stop)
    sim.results()

What a run is at any moment is its Snapshot; this class holds the current one and the recording. It is longer than other
modules because all that moves a run from one Snapshot to the next stands here: the loop, the steps, and their failures.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.motion import Motions, looked_at
from ...compile.plan import Plan, Reference
from ...compile.scheduler import schedule
from ...fmi.instance import Ended
from ...fmi.patience import patient
from ...model.settings import RunSettings
from ...results.results import Event, Results, Statistics
from ...text.available_memory import Watch
from ...text.errors import NOT_FINITE, OVERFLOW, Fault, FMUError, ModelError, SimulationError, UsageError
from ..run.history import NODES, POWERS, Past
from ..run.inputs import InputTable
from ..run.measures import Measures
from ..run.memory_estimate import no_room
from ..run.model_exchange import Foreigns
from ..run.recording import Recording
from ..run.saved_state import State, fit
from ..run.snapshot import Memory, Snapshot, frozen
from ..run.step_parts import BETWEEN_ROWS, CHECKS, LEFT_OUT, Look, Part, unseen_faults
from ..run.step_polynomial import NODES as LOBATTO
from ..run.step_polynomial import Interpolant
from ..run.time_grid import Grid, within_ulps
from . import event_location, stiff
from .event_update import Instants
from .methods import METHODS, Tableau, Trial, error_norm, first_step, trial
from .python_code import Compiled, Evaluator

__all__ = ["TO_AND_FRO", "Simulation", "check_range", "kept", "longest_step"]

Array = np.ndarray[Any, Any]
Row = tuple[float, ...]


def _nothing() -> None:
    """In the place of a look at Ctrl-C, where Python looks itself."""


# PI control of the step (Hairer, Norsett and Wanner, IV.2): the exponents of dopri5 with beta = 0.04.
_BETA = 0.04
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 10.0

# So many located crossings within so small a part of the run are Zeno or chattering; no model needs 1e9 of them.
_CROWD, _CROWD_PART = 1000, 1e-6
# A crossing that fires again within so many ulp of t is one too: soon after, time could not tell its firings apart.
_QUICK = 4096
# Chattering over a jump of a rate: steps of which a run would take so many are looked at, one of each window. Those
# of windows in a row must go to and fro over a jump; one does not, however stiff the model, where its rates are smooth.
_MANY, _WINDOW = 1e7, 512
TO_AND_FRO = 16
_HALVINGS = 20  # what is smooth over a step changes by a millionth of it within this part, and a jump stays
_AT_ONCE = 4096  # rows of the grid
MOST_BETWEEN = 100_000  # rows inside steps, in a run without a grid
_ENDS = np.array([1 / 1024, 1 / 256, 1 / 64, 1 / 16])
_ON_THE_WAY = np.array([*_ENDS, 0.25, 0.5, 0.75, *(1.0 - _ENDS[::-1]), 1.0])
_UNKNOWN: tuple[float, Array] = (math.nan, np.empty(0))


def check_range(plan: Plan, t: Fraction) -> None:
    """Raise ModelError (E119) where ticks could not be counted up to t."""
    if plan.rates and abs(t / plan.base) > 2**53:
        message = f"{float(t)} s are more than 2^53 base steps of {float(plan.base)} s."
        raise ModelError(Fault("E119", plan.name, message, "Choose periods with a coarser common base."))


def longest_step(plan: Plan, settings: RunSettings) -> float:
    """The longest step of an adaptive method: a fiftieth of the run, as a step that sees nothing learns nothing.

    Without states the error says nothing at all, so that what depends on time alone needs shorter ones.
    """
    if settings.stop is None or settings.stop <= settings.start:
        return math.inf
    return float(settings.stop - settings.start) / (50 if plan.states else 1000)


def kept(error: SimulationError | FMUError, results: Results) -> SimulationError | FMUError:
    """An error with the results up to it."""
    if isinstance(error, Ended):
        return error
    last = f"{results.t[-1]:.10g} s" if len(results.t) else "the start"
    faults = (replace(f, cure=f"{f.cure} Results up to {last} are kept.".strip()) for f in error.faults)
    return (FMUError if isinstance(error, FMUError) else SimulationError)(*faults, results=results)


class Simulation:
    """One run of a Plan under way.

    progress: called with t after each accepted step. Raises UsageError and ModelError at once where it cannot begin.
    """

    def __init__(
        self,
        plan: Plan,
        settings: RunSettings,
        inputs: InputTable,
        log: tuple[str, ...],
        *,
        progress: Callable[[float], None] | None = None,
        compiled: Compiled | None = None,
        resume: State | None = None,
        is_idle: bool = False,
        foreign: Foreigns | None = None,
    ) -> None:
        self.plan, self.settings, self.inputs, self.progress = plan, settings, inputs, progress
        self.compiled = compiled or Compiled(plan)
        self.asked: dict[tuple[Reference, ...], Evaluator] = {}
        self.log = log
        logged: list[Reference] = [ref for name in log for ref in plan.signal(name).references]
        self.recording = Recording(len(logged))
        self.watch = Watch()
        self.events: list[Event] = []
        self.atol = settings.atol * np.array(plan.nominal, dtype=float)
        self.steps = self.rejected = self.evaluations = self.instant_count = 0
        self.seconds = 0.0
        self.interrupted, self._look_up = False, _nothing
        self.crossed: deque[float] = deque(maxlen=_CROWD)
        self.fired: dict[int, float] = {}  # when each crossing fired last
        # Chattering: how many steps a run may need, how many lie between looks, the time of the last, what was found.
        self.many, self.window, self.paced, self.chatters = _MANY, _WINDOW, -math.inf, 0
        self.fixed = Grid.of(settings.start, settings.step) if settings.step is not None else None
        self.every = Grid.of(settings.start, settings.every) if settings.every is not None else None
        self.end = math.nan if settings.stop is None else float(settings.stop)
        self.row = 0  # the number of the next row of the recording grid
        self.longest = longest_step(plan, settings)
        start = settings.start
        # Times are computed from the start and from delays, whose rounding errors they carry along near 0.
        self.scale = max([abs(float(start)), *(history.delay for history in plan.histories)])
        check_range(plan, start)
        t = float(start)
        self.segment = inputs.segment(t)
        self.broken = t  # the last input breakpoint passed; it may lie some ulp after its instant
        self.outstanding = True  # whether the instant at the current time is still to come
        self.crossing = False  # whether a side has changed at the end of the last step
        self.changed = True  # whether an input or a parameter was set since the last instant
        self.left: Row | None = None  # what was to be seen before
        self.sides = _UNKNOWN  # a time, and the values of all crossings at it
        self.sloped: tuple[Snapshot | None, Any] = (None, None)  # where the Jacobian is known, and what it is
        self.located = _UNKNOWN  # a located crossing: its time, and how far beyond it each changed crossing then was
        self.instants = Instants(plan, self.compiled)
        self.instants.foreign = foreign if foreign is not None else Foreigns.of(plan, settings)
        theirs = frozenset(j for part in plan.foreign for j in part.crossings)
        self.resetting = np.array([bool(c.resets) or j in theirs for j, c in enumerate(plan.crossings)], dtype=bool)
        # An FMU's has no direction: that it is passed back at once is no Zeno, but that it is passed again downwards.
        self.directions = ["down" if j in theirs else cause.direction for j, cause in enumerate(plan.crossings)]
        self.measures = Measures(plan)
        self._derivatives = self.compiled.program("derivatives", plan.derivatives)
        self._measured = self.compiled.program("measured", self.measures.references)
        self._logged = self.compiled.program("logged", logged)
        self._remembered = self.compiled.program("remembered", [history.source for history in plan.histories])
        self._looked_at = looked_at(plan, self.measures.references, logged)
        self._motions = Motions(plan)
        self._looks: dict[str, tuple[Look, Evaluator]] = {}
        self.between = 0  # rows that were recorded inside steps
        if resume is not None:
            self._resume(resume, is_idle=is_idle)
        elif not is_idle:
            with self._guarded():
                self.begin()
        if not is_idle and self.now.past is not None:
            self.longest = min(self.longest, self.now.past.longest_step)

    def begin(self) -> None:
        """Values at the start, and the instant there. Raises SimulationError, without results."""
        plan, start = self.plan, self.settings.start
        t = float(start)
        ticks = tuple(max(0, math.ceil((start / plan.base - rate.offset) / rate.period)) for rate in plan.rates)
        self.now = replace(self.instants.start(t, self.segment.at(t), ticks, 1), exact=start)
        self._instant(is_start=True)

    @classmethod
    def idle(
        cls,
        plan: Plan,
        settings: RunSettings,
        inputs: InputTable,
        log: tuple[str, ...],
        resume: State | None = None,
        foreign: Foreigns | None = None,
    ) -> Simulation:
        """A run that has not begun, or stands where a saved one stood, and has recorded nothing: for another engine."""
        made = cls(plan, settings, inputs, log, resume=resume, is_idle=True, foreign=foreign)
        if resume is not None and made.now.past is not None:
            made.longest = min(made.longest, made.now.past.longest_step)
        return made

    def stand(self, *, outstanding: bool, crossing: bool, changed: bool, tries: int) -> None:
        """Go on for some steps as another engine would. Raises SimulationError where this one fails."""
        self.outstanding, self.crossing, self.changed = outstanding, crossing, changed
        end = self.settings.stop if self.settings.stop is not None else Fraction(self.now.t) + 1
        with np.errstate(all="ignore"):
            for _ in range(tries):
                if self.outstanding:
                    self._instant()
                elif self.now.t >= float(end):
                    return
                elif self.settings.method != "radau":
                    self._step(*self._next_instant(end, float(end)))

    def _resume(self, state: State, *, is_idle: bool) -> None:
        """Stand where a saved run stood; its last row is the first one here."""
        now, settings = state.snapshot, self.settings
        if now.past is not None:
            now = replace(now, past=now.past.own())
        if state.method != self._method:  # what another method kept from step to step is of no use
            now = replace(now, memory=Memory(), fixed=1)
            if self.fixed is not None:
                now = replace(now, fixed=self.fixed.after(now.t))
        same = all(
            ours.linear == theirs.linear and np.array_equal(ours.t, theirs.t) and np.array_equal(ours.u, theirs.u)
            for ours, theirs in zip(self.inputs.tracks, state.inputs.tracks, strict=True)
        )
        changed = not same or self.plan.parameters != state.parameters
        if changed:  # as if they were set now
            now = replace(now, memory=replace(now.memory, first=None))
        self.now, self.broken = now, state.broken
        self.segment = self.inputs.segment(max(now.t, self.broken))
        self.located, self.fired = state.located, dict(state.fired)
        self.crossed.extend(state.crossed)
        self.measures = self.measures.restored(state.measures)
        for number, blob in enumerate(state.steppers):
            self.instants.restore(number, blob)
        if state.foreign:
            self.instants.foreign.restore(self.plan, state.foreign, now.t)
        self.outstanding = self.changed = changed
        if now.t < float(settings.start) or (settings.stop is not None and now.t > self.end):
            message = f"the state is at t = {now.t} s, outside the run from {float(settings.start)} s to {self.end} s."
            raise UsageError(Fault("E506", self.plan.name, message, "Set another stop."))
        if self.every is not None:
            self.row = self.every.after(now.t)
        if not changed and not is_idle:
            self.recording.add(now.t, self._row())

    @property
    def t(self) -> float:
        """The time in s that the run has reached."""
        return self.now.t

    @property
    def _method(self) -> tuple[str, str]:
        return self.settings.method, str(self.settings.step)

    def state(self, overrides: Mapping[str, Any]) -> State:
        """What the rest of the run follows from. overrides: the raw values of parameters that were given or set."""
        if self.outstanding:
            with self._guarded():
                self._instant()
        return State(
            fit(self.plan),
            self._method,
            overrides,
            self.now,
            self.inputs,
            self.measures.saved(),
            self.broken,
            self.located,
            tuple(self.fired.items()),
            tuple(self.crossed),
            self.plan.parameters,
            tuple(self.instants.saved(number) for number in range(len(self.plan.steppers))),
            self.instants.foreign.saved(),
        )

    @property
    def over(self) -> Fault | None:
        """That an FMU ended the run (W206)."""
        return self.instants.foreign.over

    def advance_to(self, stop: Fraction) -> None:
        """Run up to and including the instant at `stop`, or to where an FMU ends the run.

        Raises SimulationError, with the results so far, where the numbers fail. After KeyboardInterrupt the run stands
        at the last accepted step and `interrupted` is set; it can go on from there.
        """
        check_range(self.plan, stop)
        self.interrupted = False
        end = float(stop)
        with self._guarded():
            try:
                with self._hearing():
                    while self.outstanding or (self.now.t < end and self.over is None):
                        if self.outstanding:
                            self._instant()
                        else:
                            self._proceed(*self._next_instant(stop, end))
            except KeyboardInterrupt:
                self.interrupted = True

    @contextmanager
    def _hearing(self) -> Iterator[None]:
        """An interrupt comes after a step or an instant, where FMUs stand where the run does; a second one at once."""
        if not self.plan.foreign:
            yield
            return
        try:
            with patient() as self._look_up:
                yield
        finally:
            self._look_up = _nothing

    def _listen(self) -> None:
        self._look_up()
        self.watch.look(self.recording.bytes)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Arithmetic as IEEE has it, the time that it takes, and failures that carry the results so far."""
        begun = time.perf_counter()
        failed: SimulationError | FMUError | None = None
        try:
            with np.errstate(all="ignore"):
                yield
        except (SimulationError, FMUError) as error:
            failed = error
        except MemoryError:
            failed = no_room(self.plan.name, self.now.t, self.recording.bytes)
        finally:
            self.seconds += time.perf_counter() - begun
        if failed is not None:
            raise kept(failed, self.results()) from None

    # --- instants ----------------------------------------------------------------------------------------------

    def _next_instant(self, stop: Fraction, end: float) -> tuple[float, Fraction | None]:
        """The time of the next tick, edge or stop; exactly, where it is a tick or the stop."""
        target, exact = end, stop
        if self.plan.rates:
            now = self.now
            count = min(rate.offset + n * rate.period for rate, n in zip(self.plan.rates, now.ticks, strict=True))
            tick = self.plan.tick_time(count)
            if tick <= end:
                target, exact = tick, count * self.plan.base
        edge = min((*self.now.events, self.inputs.next_break(self.broken), self._next_delayed()))
        if edge < target and not within_ulps(edge, target, self.scale):
            return edge, None
        return target, exact

    def _next_delayed(self) -> float:
        return math.inf if self.now.past is None else self.now.past.next_break()

    def _due_rates(self, exact: Fraction | None) -> frozenset[int]:
        """The rates whose next tick lies exactly here."""
        if exact is None:
            return frozenset()
        count = exact / self.plan.base
        pairs = zip(self.plan.rates, self.now.ticks, strict=True)
        return frozenset(k for k, (rate, n) in enumerate(pairs) if rate.offset + n * rate.period == count)

    def _instant(self, *, is_start: bool = False) -> None:
        """The instant at the current time, where everything that stands within 4 ulp happens."""
        now = self.now
        events = [i for i, event in enumerate(now.events) if within_ulps(event, now.t, self.scale)]
        left = None if is_start else self.left or self._row()
        crossed: list[Event] = []
        if self.crossing and self.plan.projections:
            # What was crossed in the step fires by what the step has seen, before its end is taken over.
            self.instants.inputs_later = self.segment.at(now.t + self.instants.later)
            now, crossed = self.instants.step_end(now, self.segment.at(now.t))
        past = now.past
        if past is not None:
            now = replace(now, past=past.after_breaks(now.t, self.scale))
        segment, broken, changed = self.segment, self.broken, self.changed
        hidden = self.instants.foreign.events
        while (edge := self.inputs.next_break(broken)) <= now.t or within_ulps(edge, now.t, self.scale):
            broken = edge
        if broken != self.broken:
            segment, changed = self.inputs.segment(max(now.t, broken)), True
        self.instants.inputs_later = segment.at(now.t + self.instants.later)
        after, fired = self.instants.instant(
            now, segment.at(now.t), events, self._due_rates(now.exact), changed=changed or now.past is not past
        )
        was = self.now  # also before what was crossed in the step
        same = np.array_equal(after.x, was.x) and (after.d, after.s, after.ticks) == (was.d, was.s, was.ticks)
        fresh = changed or not same or bool(crossed or fired) or self.instants.foreign.events != hidden
        if after.past is not None:
            after = replace(after, past=after.past.after_instant(now.t, changed=fresh))
        measures, sides = self.measures, self.sides
        memory = self.instants.memory(after, segment.at(now.t))
        if fresh or now.past is not past:
            # The rates at the start of the next step are other ones now; the proposed step may still serve.
            after = replace(after, memory=replace(after.memory, first=None))
            sides = _UNKNOWN
            if measures.count:
                measures = measures.after_instant(now.t, self._finite(self._measured, memory))
        self._record(left, memory)
        # An interrupt comes before all of this or after it.
        self.segment, self.broken, self.now, self.measures, self.sides = segment, broken, after, measures, sides
        self.outstanding, self.changed, self.left, self.crossing = False, False, None, False
        self.instants.later = 0.0
        self.instant_count += 1
        self.events += crossed + fired
        self._listen()

    def _memory(self, t: float, x: Array) -> tuple[Any, ...]:
        """The arguments of programs at another time and other states, with all else as it is."""
        now = self.now
        u, h = self.segment.at(t), now.delayed(t)
        return t, x.tolist(), now.d, now.s, self.plan.parameters, u, now.ticks, h, now.z, self.instants.foreign

    def _row(self) -> Row:
        return self._finite(self._logged, self._memory(self.now.t, self.now.x))

    def _record(self, left: Row | None, memory: tuple[Any, ...]) -> None:
        """Add a row where the grid or a jump asks for it, but none twice; in a jump, after that of the left values."""
        t, right = memory[0], self._finite(self._logged, memory)
        last, values = self.recording.last
        if self.over is not None:
            self.end = t
        if not self.settings.records_jumps:
            self._record_on_grid(t, right, last)
            return
        on_grid = t != last if self.every is None else t == self.every.time(self.row)
        if left is not None and left != right:
            if t != last:
                self.recording.add(t, left)
            if t != last or right != values:
                self.recording.add(t, right)
        elif on_grid or math.isnan(last) or (t == self.end and t != last):
            self.recording.add(t, right)
        if self.every is not None and on_grid:
            self.row += 1

    def _record_on_grid(self, t: float, right: Row, last: float) -> None:
        """Add a row where the grid asks for it, and at the stop; another instant at the time of the last changes it."""
        assert self.every is not None
        if within_ulps(t, point := self.every.time(self.row), self.scale):
            self.recording.add(t if t == self.end else point, right)
            self.row += 1
        elif within_ulps(t, last, self.scale):
            self.recording.replace_last(right)
        elif t == self.end or math.isnan(last):
            self.recording.add(t, right)

    def _finite(self, program: Evaluator, memory: tuple[Any, ...]) -> Row:
        """What a program gives. Raises SimulationError (E303) where it is not finite."""
        values = program(*memory)
        if not all(map(math.isfinite, values)):
            raise self._not_finite(memory, "is")
        return values

    # --- between instants --------------------------------------------------------------------------------------

    def _proceed(self, target: float, exact: Fraction | None) -> None:
        """Go on to `target`, or to the first crossing before it: an instant is then outstanding.

        Where `progress` reads a signal there, it happens at once, and what comes next is to be asked anew.
        """
        count = self.instant_count
        is_stiff = self.settings.method == "radau" and self.plan.states
        while not self.outstanding and self.instant_count == count:
            (self._stiff_steps if is_stiff else self._step)(target, exact)

    def _step(self, target: float, exact: Fraction | None) -> None:
        if self.fixed is not None:
            self._fixed_step(self.fixed, target, exact)
        else:
            self._adaptive_step(target, exact)

    def _rates(self, t: float, x: Array) -> Array:
        self.evaluations += 1
        now, segment = self.now, self.segment
        u = segment.base if segment.constant else segment.at(t)
        h = () if now.past is None else now.past.values(t)
        p, f = self.plan.parameters, self.instants.foreign
        rates = np.array(self._derivatives(t, x.tolist(), now.d, now.s, p, u, now.ticks, h, now.z, f))
        if self.plan.enabled:  # where a subdiagram is off, its states stay as they are
            sides = self.instants.state_sides
            rates[(sides >= 0) & (np.array((*now.s, 1.0))[sides] == 0.0)] = 0.0
        return rates

    def _first(self) -> Array:
        """The rates now. Raises SimulationError (E303) where they are not finite."""
        now = self.now
        if now.memory.first is not None:
            return now.memory.first
        first = self._rates(now.t, now.x)
        if not np.isfinite(first).all():
            raise self._not_finite(self._memory(now.t, now.x), "is")
        return first

    def _flow(self, tableau: Tableau, first: Array) -> Callable[[float], Array]:
        """The states after a step of any size from here."""
        now = self.now
        return lambda h: trial(tableau, self._rates, now.t, now.x, first, h).x1

    def _fixed_step(self, grid: Grid, target: float, exact: Fraction | None) -> None:
        """To the next point of the grid start + k step, or to the target where that comes first."""
        now, fixed, tableau = self.now, self.now.fixed, METHODS[self.settings.method]
        while (point := grid.time(fixed)) <= now.t:
            fixed += 1
        t1 = target if point >= target or within_ulps(point, target) else point
        if now.past is not None and t1 - now.t > now.past.longest_step:  # in equal parts that no delay is shorter than
            t1 = now.t + (t1 - now.t) / math.ceil((t1 - now.t) / now.past.longest_step)
        first = self._first()
        made = trial(tableau, self._rates, now.t, now.x, first, t1 - now.t)
        if not np.isfinite(made.x1).all():
            raise self._blown_up(made, "The step may be too large for the model.")
        flow = self._flow(tableau, first)
        self._accept(made.interpolant(), t1, made.x1, Memory(first=made.last), flow, target, exact, fixed)

    def _adaptive_step(self, target: float, exact: Fraction | None) -> None:
        now, rtol, tableau = self.now, self.settings.rtol, METHODS["dopri5"]
        first = self._first()
        left = target - now.t
        # h stays above the spacing of floats at t, or t + h == t and the run never ends.
        least = 16 * math.ulp(now.t)
        h = now.memory.h
        if h <= 0:
            h = first_step(self._rates, now.t, now.x, first, tableau.order, self.atol, rtol, left)
        h, grow = max(min(h, self.longest), least), _MOST
        while True:
            # The last step before the target is stretched a little rather than followed by a tiny one.
            t1 = target if h >= left / 1.01 else now.t + h
            step = t1 - now.t  # not h, from which t + h may be some ulp away
            made = trial(tableau, self._rates, now.t, now.x, first, step)
            error = error_norm(made.error, now.x, made.x1, self.atol, rtol)
            if error <= 1.0:
                break
            if h <= least or step <= least:
                raise self._too_small(made)
            self.rejected += 1
            grow = 1.0
            factor = max(_LEAST, _SAFETY * error ** (-1 / tableau.order)) if math.isfinite(error) else 0.1
            h = max(step * factor, least)
        factor = _SAFETY * now.memory.error**_BETA * max(error, 1e-10) ** -(1 / tableau.order - 0.75 * _BETA)
        proposed = step * min(grow, max(_LEAST, factor))
        if step < h:  # cut short by the target: the proposal before it still counts
            proposed = max(proposed, h)
        memory = Memory(proposed, max(error, 1e-4), made.last)
        self._paced(first, t1)
        flow = self._flow(tableau, first)
        self._accept(made.interpolant(), t1, made.x1, memory, flow, target, exact, now.fixed)

    def _paced(self, first: Array, t1: float) -> None:
        """Refuse a run that chatters over a jump of a rate, as that of dx = -sign(x), in steps that never end."""
        if (self.steps + 1) % self.window:
            return
        stop = t1 if math.isnan(self.end) else self.end
        span = max(stop - float(self.settings.start), 1e-3 * abs(t1), 1e-12)
        is_slow = (t1 - self.paced) * self.many < self.window * span
        self.paced = t1
        culprit = self._to_and_fro(first, t1 - self.now.t) if is_slow and not self.plan.foreign else None
        self.chatters = 0 if not is_slow else self.chatters + (culprit is not None)
        if culprit is None or self.chatters < TO_AND_FRO:
            return
        message = f"chatters at t = {self.now.t} s: its rate jumps to and fro, in steps that would not reach the stop."
        cure = "Make the jump a crossing with a hysteresis, as in Relay, or smooth it, as in tanh(x/eps)."
        raise SimulationError(Fault("E301", self.plan.states[culprit], message, cure))

    def _to_and_fro(self, first: Array, h: float) -> int | None:
        """The state whose rate jumps on the way along the rates from here, and jumps back on the way that follows.

        None where no rate jumps within h, or where what follows leads on.
        """
        now = self.now

        def rates(s: float, x: Array) -> Array:
            return self._rates(now.t + s, x)

        low, high, end = 0.0, h, rates(h, now.x + h * first)
        weights = self.atol + self.settings.rtol * np.abs(now.x)
        if not (len(first) and np.isfinite(end).all()):
            return None
        worst = int(np.argmax(np.abs(end - first) / weights))
        before, after = first, end
        jump = abs(after[worst] - before[worst])
        for _ in range(_HALVINGS):
            middle = low + (high - low) / 2
            made = rates(middle, now.x + middle * first)
            if abs(made[worst] - before[worst]) > abs(after[worst] - made[worst]):
                high, after = middle, made
            else:
                low, before = middle, made
        if not (abs(after[worst] - before[worst]) > 0.5 * jump > 0.0 and np.isfinite(after).all()):
            return None
        on = h / 256  # much more than the way by which the jump was passed
        back = rates(high + on, now.x + high * first + on * after)
        return worst if abs(back[worst] - before[worst]) < abs(back[worst] - after[worst]) else None

    def _slopes(self, t: float, x: Array) -> Any:
        """The Jacobian of the rates; that at a step's begin is kept, as the search for a crossing asks for it often."""
        now = self.now
        is_now = t == now.t and np.array_equal(x, now.x)
        if is_now and self.sloped[0] is now:
            return self.sloped[1]
        made = stiff.Slopes.of(self.compiled).at(self._memory(t, x), lambda x: self._rates(t, x))
        if is_now:
            self.sloped = (now, made)
        return made

    def _stiff_steps(self, target: float, exact: Fraction | None) -> None:
        """Steps of one integration by radau, up to an instant, or where a step was cut short or its end replaced."""
        self._first()
        begin, slopes, count = self.now, self._slopes, self.instant_count
        tolerances: dict[str, Any] = {"rtol": self.settings.rtol, "atol": self.atol, "longest": self.longest}
        try:
            run = stiff.Radau(self._rates, slopes, begin.t, begin.x, target, h=begin.memory.h, **tolerances)
            while not self.outstanding and self.instant_count == count:
                now = self.now
                dense, t1, x1 = run.step()

                def flow(h: float, now: Snapshot = now) -> Array:
                    return stiff.flow(self._rates, slopes, now.t, now.x, now.t + h, h=now.memory.h, **tolerances)

                self._accept(dense, t1, x1, Memory(h=run.proposed), flow, target, exact, now.fixed)
                if self.now.t < t1 or self.now.d != now.d or not np.array_equal(self.now.x, x1):
                    return  # what was replaced after the step is not where this integration stands
        except SimulationError:
            raise
        except ArithmeticError as error:
            raise self._stiff_failed(str(error)) from None

    def _accept(
        self,
        dense: Interpolant,
        t1: float,
        x1: Array,
        memory: Memory,
        flow: Callable[[float], Array],
        target: float,
        exact: Fraction | None,
        fixed: int,
    ) -> None:
        """Take an accepted step to (t1, x1), or the part of it before the first change of a side."""
        now, end, changed = self.now, t1, False
        if self.plan.projections and self.fixed is None:
            shorter = self._followed(dense, t1)
            if shorter < t1:
                t1, x1, memory = shorter, flow(shorter - now.t), replace(memory, first=None)
        if self.plan.crossings:
            t1, x1, changed = self._up_to_crossing(dense, t1, x1, flow, target)
            if t1 < end:
                # The old proposal is kept: what cut the step short was the crossing, not the error.
                memory = replace(memory, first=None)
        self._fill_grid(dense, t1, outstanding=changed or t1 == target)
        past = self._past_after(dense, t1, x1)
        after = replace(
            now, t=t1, exact=exact if t1 == target else None, x=frozen(x1), memory=memory, fixed=fixed, past=past
        )
        after = self.instants.with_solutions(after, self.segment.at(t1))
        measures = self.measures.after_step(now.t, t1, self._measured_parts(dense, t1, x1))
        outstanding = changed or t1 == target
        if self.plan.projections and not changed:
            after, moved = self._projected(after)
            outstanding = outstanding or moved
        if self.instants.foreign and self.instants.completed(after, self.segment.at(t1)):
            outstanding = True
        if not outstanding and self.every is None:
            self._record(None, self.instants.memory(after, self.segment.at(t1)))
        # An interrupt comes before all of this or after it.
        self.outstanding, self.crossing, self.now, self.measures = outstanding, changed, after, measures
        self.steps += 1
        self._listen()
        if self.progress is not None:
            self.progress(t1)

    def _past_after(self, dense: Interpolant, t1: float, x1: Array) -> Past | None:
        """What histories remember after a step to (t1, x1)."""
        now = self.now
        if now.past is None:
            return None

        def signals(t: float, x: Array) -> Row:
            return self._finite(self._remembered, self._memory(t, x))

        parts = self._parts("remembered", dense, now.t, t1, signals, x1=x1) if t1 > now.t else ()
        return now.past.after_step(t1, ((b, e, v.copy()) for b, e, v in self._in_time(parts, now.t, t1)))

    def _followed(self, dense: Interpolant, t1: float) -> float:
        """The end of a step, or an earlier time up to which projections follow it as closely as the tolerance asks.

        What one projection at the end gives is compared with what several give on the way. Some stand close to the
        ends: what turns soon after an instant, or shortly before the end, would else be stepped over.
        """
        now, settings = self.now, self.settings
        if self._look("projections")[0].turns and t1 > now.t:
            parts = self._parts("projections", dense, now.t, t1, self._measured_at)
            _, t1, _ = next(self._in_time(parts, now.t, t1))
        whole, first = t1 - now.t, math.inf
        while t1 - now.t > 64 * math.ulp(max(abs(now.t), abs(t1))):
            times = now.t + _ON_THE_WAY * (t1 - now.t)
            states = dense((times - dense.t0) / dense.h)
            once = self._projected_at(now, t1, states[-1])
            often = now
            for t, x in zip(times, states, strict=True):
                often = self._projected_at(often, float(t), x)
            ours, theirs = np.array((*once.x, *once.d)), np.array((*often.x, *often.d))
            real = np.ones(len(ours), dtype=bool)
            real[len(once.x) + np.array([*self.plan.integers], dtype=int)] = False
            allowed = settings.atol + settings.rtol * np.maximum(np.abs(ours), np.abs(theirs))
            errors = np.where(real, np.abs(ours - theirs) / allowed, 0.0)
            error = float(np.max(errors, initial=0.0))
            if error <= 1.0:
                return t1
            first = min(first, error)
            if t1 - now.t < 1e-7 * whole and error > 0.5 * first:
                name = (*self.plan.states, *self.plan.discretes)[int(np.argmax(errors))]
                message = f"at t = {now.t} s it changes with every step, however short that is."
                cure = 'Use every=period, an int, or a method with a fixed step: every="step" is for what converges.'
                raise SimulationError(Fault("E301", name, message, cure))
            t1 = now.t + (t1 - now.t) * max(0.1, 0.9 / math.sqrt(error))  # it falls with the square of the step
        return t1

    def _projected_at(self, before: Snapshot, t: float, x: Array) -> Snapshot:
        return self.instants.projected(replace(before, t=t, x=frozen(x)), self.segment.at(t))

    def _projected(self, accepted: Snapshot) -> tuple[Snapshot, bool]:
        """The end of a step after what is replaced there, and whether that changed a side."""
        u = self.segment.at(accepted.t)
        after = self.instants.projected(accepted, u)
        if after is accepted:
            return after, False
        values = np.array(self.instants.crossing_values(after, u))
        self.sides = (after.t, values)
        changed = bool(np.any((values >= 0) != (np.array(after.s) > 0)))
        return replace(after, memory=replace(after.memory, first=None)), changed

    # --- inside a step -----------------------------------------------------------------------------------------

    def _look(self, name: str) -> tuple[Look, Evaluator]:
        """How signals are looked at inside steps, and the program of their phases."""
        if name not in self._looks:
            motion, rtol = self._motions.of(self._looked_at[name]), self.settings.rtol
            tolerance: dict[str, Any] = {"atol": self.settings.atol, "rtol": rtol}
            count = motion.checks(name)
            if name == "crossings":
                look = Look(motion, NODES, CHECKS[:count], spans=1e-3, ignores_far=True, **tolerance)
            elif name == "measured":
                look = Look(motion, LOBATTO, CHECKS[2 : 2 + count], spans=10 * rtol, **tolerance)
            elif name == "remembered":
                look = Look(motion, NODES, CHECKS[:count], sizes=0.1, all_bent=True, **tolerance)
            else:
                look = Look(motion, None, most=0.125 if name == "logged" else 0.25)
            self._looks[name] = look, self.compiled.program(f"{name}_phases", motion.phases)
        return self._looks[name]

    def _parts(
        self,
        name: str,
        dense: Interpolant,
        t0: float,
        t1: float,
        values: Callable[[float, Array], Any],
        *,
        x1: Array | None = None,
        first: Array | None = None,
    ) -> Iterator[Part]:
        """The parts of a piece of a step. x1: the states at its end, where it is that of the step."""
        look, program = self._look(name)
        now, h = self.now, t1 - t0

        def at(theta: float) -> tuple[float, Array]:
            t = t0 if theta == 0.0 else t1 if theta == 1.0 else t0 + theta * h
            if t == now.t:
                return t, now.x
            if theta == 1.0 and x1 is not None:
                return t, x1
            return t, dense(np.array([((t0 - dense.t0) + theta * h) / dense.h]))[0]

        def phases(theta: float) -> Row:
            t, x = at(theta)
            return (*program(*self._memory(t, x)), *look.past_turns(now.past, t))

        return look.parts(t0, t1, lambda theta: values(*at(theta)), phases, first)

    def _in_time(self, parts: Iterable[Part], t0: float, t1: float) -> Iterator[tuple[float, float, Array]]:
        """Parts by their times."""
        begin = t0
        for part in parts:
            end = t1 if part.end == 1.0 else t0 + part.end * (t1 - t0)
            yield begin, end, part.table
            begin = end

    # --- crossings ---------------------------------------------------------------------------------------------

    def _crossing_values(self, t: float, x: Array) -> Array:
        values = np.array(self.instants.sides(*self._memory(t, x)))
        if np.isnan(values).any():
            raise self.instants.not_a_number(int(np.nonzero(np.isnan(values))[0][0]), t)
        return values

    def _up_to_crossing(
        self, dense: Interpolant, t1: float, x1: Array, flow: Callable[[float], Array], target: float
    ) -> tuple[float, Array, bool]:
        """The end of the step, or the first time in it at which a side has changed; the states; whether it has."""
        now, h = self.now, t1 - self.now.t

        def evaluate(theta: float) -> Array:
            return self._crossing_values(now.t + theta * h, dense(np.array([theta * h / dense.h]))[0])

        before = self.sides[1] if self.sides[0] == now.t else None
        sides, located = np.array(now.s) > 0, self.located
        found: tuple[float, float] | None = None
        first, was_first, is_whole = None, False, True
        for part in self._parts("crossings", dense, now.t, t1, self._crossing_values, x1=x1, first=before):
            found = event_location.first_change(part.table, sides, evaluate, part.begin, part.end)
            if first is None:
                first, was_first, is_whole = part.table.copy(), found is not None, part.end == 1.0
            if found is not None:
                break
        after = part.table[4].copy() if part.end == 1.0 else self._crossing_values(t1, x1)
        if found is not None:
            size = self._located(dense, flow, found, h, sides)
            if now.t + size < t1 and not within_ulps(now.t + size, target):
                # A time of its own after t, or the run would stand still.
                t1 = max(now.t + size, math.nextafter(now.t, math.inf))
                x1 = flow(t1 - now.t)
                after = self._crossing_values(t1, x1)
                self.located = (t1, np.where((after >= 0) != sides, np.abs(after), -1.0))
        changed = bool(np.any((after >= 0) != sides))
        if not (changed and (was_first or is_whole)) and located[0] == now.t:
            assert first is not None
            self._missed(first, sides, located[1])
        self.instants.later = 0.0
        if not changed and t1 == target:
            joined = self._joined(t1, x1, part.table, (part.end - part.begin) * h, sides)
            if joined is not None:
                x1, after, changed = *joined, True
                self.instants.later = 4 * math.ulp(t1)
        self.sides = (t1, after)
        # What has joined an instant fires there only if that does not turn it back: it counts when it passes again.
        for j in np.nonzero((after >= 0) != sides)[0] if not self.instants.later else ():
            self._crowded(t1, int(j), up=bool(after[j] >= 0))
        return t1, x1, changed

    def _joined(self, t1: float, x1: Array, values: Array, length: float, sides: Array) -> tuple[Array, Array] | None:
        """Where a crossing comes within 4 ulp after an instant at t1, to which it then belongs: states and crossings.

        values: those of the last part of the step, which is `length` long.
        """
        since = 8 * math.ulp(t1)
        slopes, after = POWERS[1:].T @ np.arange(1, 5) @ values / length, values[4]
        if self.plan.foreign or not np.any(np.where(sides, after <= -slopes * since, -after <= slopes * since)):
            return None
        x = frozen(x1 + 0.5 * since * self._rates(t1, x1))
        made = self._crossing_values(t1 + 0.5 * since, x)
        return (x, made) if np.any((made >= 0) != sides) else None

    def _located(
        self,
        dense: Interpolant,
        flow: Callable[[float], Array],
        found: tuple[float, float],
        h: float,
        sides: Array,
    ) -> float:
        """The size of the step to the first change of a side, to 4 ulp of t, its right end.

        First on the dense output, which is cheap; then on real steps around that place.
        """
        t0 = self.now.t

        def beyond(t: float, x: Array) -> float:
            return float(np.max(self.instants.distance(self._crossing_values(t, x), sides)))

        def on_dense(size: float) -> float:
            return beyond(t0 + size, dense(np.array([size / dense.h]))[0])

        def on_steps(size: float) -> float:
            t = t0 + size
            return beyond(t, flow(t - t0)) if t > t0 else -1.0

        resolution = 4 * math.ulp(max(abs(t0), abs(t0 + h)))
        last = found[1] * h
        low = high = event_location.narrowed(on_dense, found[0] * h, last, resolution)
        reach = max(1e-9 * h, resolution)
        if on_steps(low) >= 0:
            while low > 0 and on_steps(low) >= 0:
                high, low = low, max(0.0, low - reach)
                reach *= 100
        else:
            while high < last and on_steps(high) < 0:
                low, high = high, min(last, high + reach)
                reach *= 100
        return event_location.narrowed(on_steps, low, high, resolution)

    def _missed(self, values: Array, sides: Array, beyond: Array) -> None:
        """Refuse a flight too short to be seen.

        A located instant lies beyond its crossing by a rounding error. Where its resets turn the motion back, the
        crossing must be passed again at once; if it is not, it was passed twice within that rounding error.
        """
        slopes, unsure = event_location.slope(values)
        size = 1e-12 * np.abs(values).max(axis=0) + unsure
        # A crossing through infinity leaves the other side far away: nothing was missed there.
        error = np.minimum(2 * beyond, 1e3 * size)
        missed = (np.where(sides, -slopes, slopes) > size) & (np.abs(values[0]) <= error) & self.resetting
        if missed.any():
            message = f"at t = {self.now.t} s it is crossed again sooner than numbers can tell: Zeno."
            cure = "Give the block a state of rest."
            raise SimulationError(Fault("E304", self.instants.name(int(np.nonzero(missed)[0][0])), message, cure))

    def _crowded(self, t: float, crossing: int, *, up: bool) -> None:
        """Refuse a run whose crossings come ever faster: of one crossing within some ulp of t, or of all of them."""
        cure = "Give the block a state of rest, or the crossing a hysteresis."
        name = self.instants.name(crossing)
        if self.directions[crossing] in ("both", "up" if up else "down"):
            last = self.fired.get(crossing, -math.inf)
            self.fired[crossing] = t
            if 0 < t - last <= _QUICK * math.ulp(t):  # 0: the same firing, found anew after an interrupt
                message = f"fires ever faster, and at t = {t} s faster than time can tell: Zeno or chattering."
                raise SimulationError(Fault("E304", name, message, cure))
        if len(self.crossed) == _CROWD:
            stop = float(self.settings.stop) if self.settings.stop is not None else t
            span = max(stop - float(self.settings.start), 1e-3 * abs(t), 1e-12)
            if t - self.crossed[0] < _CROWD_PART * span:
                message = f"{_CROWD} crossings between t = {self.crossed[0]} s and {t} s: Zeno or chattering."
                raise SimulationError(Fault("E304", name, message, cure))
        self.crossed.append(t)

    # --- what is seen inside a step ----------------------------------------------------------------------------

    def _fill_grid(self, dense: Interpolant, t1: float, *, outstanding: bool) -> None:
        """Rows of the recording grid strictly inside a step. outstanding: whether an instant follows at its end."""
        if self.every is None:
            self._rows_between(dense, t1)
            return
        if self.steps % 64 == 0:
            self._turns_between_rows(dense, t1)
        if outstanding and not self.settings.records_jumps:  # the instant has the rows that belong to it
            point = self.every.time(self.every.after(math.nextafter(t1, -math.inf)) - 1)
            t1 = point if within_ulps(point, t1, self.scale) else t1
        # All of the step's rows each time, also after an interrupt: how many are evaluated together decides last bits.
        first = self.every.after(math.nextafter(self.now.t, -math.inf))
        while self.every.time(first) < t1:
            times: list[float] = []
            while len(times) < _AT_ONCE and (t := self.every.time(first + len(times))) < t1:
                times.append(t)
            theta = (np.array(times) - dense.t0) / dense.h
            for k, (t, x) in enumerate(zip(times, dense(theta), strict=True), first):
                if k >= self.row:
                    if t != self.recording.last[0]:
                        self.recording.add(t, self._finite(self._logged, self._memory(t, x)))
                    self.row = k + 1
            first += len(times)
            self.watch.look(self.recording.bytes)

    def _measured_parts(self, dense: Interpolant, t1: float, x1: Array) -> Any:
        """Pieces of a step in parts, as measures ask for them."""

        def parts(low: float, high: float, first: Array | None) -> Iterator[tuple[float, float, Array]]:
            end = x1 if high == t1 else None
            return self._in_time(
                self._parts("measured", dense, low, high, self._measured_at, x1=end, first=first), low, high
            )

        return parts

    def _rows_between(self, dense: Interpolant, t1: float) -> None:
        """Without a grid, rows inside a step where what is recorded turns faster than the steps follow each other."""
        now, (look, _) = self.now, self._look("logged")
        if not look.motion.phases or t1 <= now.t:
            return
        for _, t, _ in self._in_time(self._parts("logged", dense, now.t, t1, self._measured_at), now.t, t1):
            if t == t1 or t <= self.recording.last[0]:
                continue
            if self.between == MOST_BETWEEN:
                look.not_seen(t, 0, LEFT_OUT)
                return
            x = dense(np.array([(t - dense.t0) / dense.h]))[0]
            self.recording.add(t, self._finite(self._logged, self._memory(t, x)))
            self.between += 1
        self.watch.look(self.recording.bytes)

    def _turns_between_rows(self, dense: Interpolant, t1: float) -> None:
        """Note where what is recorded turns more than half a turn from row to row of the grid."""
        now, (look, program) = self.now, self._look("logged")
        if self.settings.every is not None and float(self.settings.every) >= self.end - float(self.settings.start):
            return  # the ends of the run alone are asked for
        if look.motion.phases and t1 > now.t and math.isnan(look.unseen.t):
            x1 = dense(np.array([(t1 - dense.t0) / dense.h]))[0]
            phases = [np.array(program(*self._memory(t, x))) for t, x in ((now.t, now.x), (t1, x1))]
            turns = np.abs(phases[1] - phases[0]) * float(self.settings.every or 0) / (t1 - now.t)
            if np.any(turns > 0.5):
                look.not_seen(now.t, int(np.nanargmax(turns)), BETWEEN_ROWS)

    def _unseen(self) -> tuple[Fault, ...]:
        """What was not seen inside steps (W304)."""
        found = {name: look.unseen for name, (look, _) in self._looks.items()}
        if all(math.isnan(unseen.t) for unseen in found.values()):
            return ()
        motions = {name: look.motion for name, (look, _) in self._looks.items()}
        return unseen_faults(self.plan, motions, found)

    def _measured_at(self, t: float, x: Array) -> Row:
        return self._finite(self._measured, self._memory(t, x))

    # --- failures ----------------------------------------------------------------------------------------------

    def _culprit(self, memory: tuple[Any, ...]) -> tuple[str, str, float, str] | None:
        """What is not finite first, in the order of computation: its name, what it is, its value, and the cure."""
        plan = self.plan
        for names, values in ((plan.states, memory[1]), (plan.discretes, memory[2])):
            for name, value in zip(names, values, strict=True):
                if not math.isfinite(value):
                    return name, "", value, OVERFLOW
        program = schedule(plan, [*(Reference("w", i) for i in range(len(plan.outputs))), *plan.derivatives])
        nodes = [node for step in program.order for node in step.nodes]
        for node, value in zip(nodes, self.compiled.program("everything", nodes)(*memory), strict=True):
            if not math.isfinite(value):
                what = "its derivative " if node.key.startswith("derivative") else ""
                return plan.node_name(node), what, value, self.compiled.cure([node], memory)
        return None

    def _not_finite(self, memory: tuple[Any, ...], verb: str, cure: str = "") -> SimulationError:
        for reference, value in zip(self.plan.unknowns, self.instants.solutions(*memory), strict=True):
            if not math.isfinite(value):
                return self.instants.unsolved(reference, memory[0])
        name, what, value, more = self._culprit(memory) or (self.plan.name, "a value ", math.nan, NOT_FINITE)
        message = f"{what}{verb} {value} at t = {memory[0]} s."
        return SimulationError(Fault("E303", name, message, f"{cure} {more}".lstrip()))

    def _blown_up(self, made: Trial, cure: str) -> SimulationError:
        """The error of a step that is not finite: what was so first, in its stages."""
        x, t1 = made.x0, made.t0 + made.h
        for i, c in enumerate(made.tableau.c):
            t = made.t0 + c * made.h
            if i > 0:
                x = made.x0 + made.h * (made.tableau.a[i - 1] @ made.k[:i])
            if not np.isfinite(x).all():
                break
            if not np.isfinite(made.k[i]).all():
                return self._not_finite(self._memory(t, x), "became", cure)
        bad = int(np.nonzero(~np.isfinite(x))[0][0])
        message = f"became {x[bad]} at t = {t1} s."
        return SimulationError(Fault("E303", self.plan.states[bad], message, f"{cure} {OVERFLOW}"))

    def _too_small(self, made: Trial) -> SimulationError:
        now, rtol = self.now, self.settings.rtol
        if not (np.isfinite(made.k).all() and np.isfinite(made.x1).all()):
            return self._blown_up(made, "The step was shortened until it could not be any more.")
        worst = int(np.argmax(np.abs(made.error) / (self.atol + rtol * np.abs(now.x))))
        message = f"at t = {now.t} s the step became too small to reach rtol {rtol}."
        cure = "The model may jump or chatter here: use a crossing, radau for stiff models, or a larger tolerance."
        return SimulationError(Fault("E301", self.plan.states[worst], message, cure))

    def _stiff_failed(self, message: str) -> SimulationError:
        now = self.now
        rates = self._rates(now.t, now.x)
        worst = int(np.argmax(np.abs(rates) / (self.atol + self.settings.rtol * np.abs(now.x))))
        step = 16 * math.ulp(now.t)
        following = self._memory(now.t + step, now.x + step * rates)
        if self._culprit(following) is not None:
            return self._not_finite(following, "became")
        cause = f"radau failed at t = {now.t} s, where this state changes fastest: {message}"
        return SimulationError(Fault("E308", self.plan.states[worst], cause, "Raise rtol and atol, or use dopri5."))

    # --- from outside ------------------------------------------------------------------------------------------

    def set_input(self, index: int, value: Array) -> None:
        """An input jumps now."""
        self._change()
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.now.t)

    def set_parameters(self, plan: Plan) -> None:
        """Tunable parameters change now; the plan is the same but for their values."""
        self._change()
        self.take(plan)

    def take(self, plan: Plan) -> None:
        """The values of parameters, and the tolerances that follow from them."""
        self.plan = self.instants.plan = plan
        self.atol = self.settings.atol * np.array(plan.nominal, dtype=float)

    def _change(self) -> None:
        # Rows of a step that was interrupted before it counted.
        self.recording.cut(self.now.t)
        if self.every is not None:
            self.row = min(self.row, self.every.after(self.now.t))
        if self.left is None:
            self.left = self._row()
        self.outstanding = self.changed = True

    def value(self, references: tuple[Reference, ...]) -> Row:
        """Values now."""
        if self.outstanding:
            with self._guarded():
                self._instant()
        if references not in self.asked:
            self.asked[references] = self.compiled.program(f"asked_{len(self.asked)}", references)
        return self.asked[references](*self._memory(self.now.t, self.now.x))

    def results(self) -> Results:
        """What was recorded up to now."""
        t, values = self.recording.arrays()
        columns, first = {}, 0
        for name in self.log:
            signal = self.plan.signal(name)
            columns[name] = (first, signal.shape, signal.unit)
            first += len(signal.references)
        statistics = Statistics(
            self.settings.method,
            "reference",
            self.steps,
            self.rejected,
            self.evaluations,
            self.instant_count,
            self.seconds,
        )
        now = getattr(self, "now", None)  # there is none where the start fails
        measures, uncovered = self.measures.results(-math.inf if now is None else now.t)
        return Results(
            self.plan.name, t, values, columns, tuple(self.events), measures, statistics, self.interrupted,
            warnings=(
                *self.instants.foreign.warnings, *uncovered, *self._unseen(),
                *(() if self.over is None else (self.over,)),
            ),
        )  # fmt: skip
