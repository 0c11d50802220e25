"""The run: from instant to instant by a method, recording and measuring on the way.

    sim = Simulation(plan, settings, inputs)
    sim.advance_to(stop)
    sim.results()

What a run is at any moment is its Snapshot; this class holds the current one and the recording.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from ..errors import Fault, ModelError, SimulationError
from ..plan import Plan, Reference
from ..results import Event, Results, Statistics
from ..settings import RunSettings
from . import locate, stiff
from .inputs import InputTable
from .instant import Instants, within_ulps
from .measures import Measures
from .methods import METHODS, Interpolant, error_norm, first_step, trial
from .printed import Compiled
from .recording import Recording
from .snapshot import Memory, Snapshot

__all__ = ["Simulation"]

Array = np.ndarray[Any, Any]

# PI control of the step (Hairer, Norsett and Wanner, IV.2): the exponents of dopri5 with beta = 0.04.
_BETA = 0.04
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 10.0

# So many located crossings within so small a part of the run are Zeno or chattering; no model needs 1e9 of them.
_CROWD, _CROWD_PART = 1000, 1e-6


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
    ) -> None:
        begun = time.perf_counter()
        self.plan, self.settings, self.inputs, self.progress = plan, settings, inputs, progress
        self.compiled = compiled or Compiled(plan)
        self.instants = Instants(plan, self.compiled)
        self._derivatives = self.compiled.program("derivatives", plan.derivatives)
        self.measures = Measures(plan)
        self._measured = self.compiled.program("measured", self.measures.references)
        self.log = log
        logged: list[Reference] = [ref for name in log for ref in plan.signal(name).references]
        self._logged = self.compiled.program("logged", logged)
        self.recording = Recording(len(logged))
        self.events: list[Event] = []
        self.atol = settings.atol * np.array(plan.nominal, dtype=float)
        self.steps = self.rejected = self.evaluations = self.instant_count = 0
        self.seconds = 0.0
        self.interrupted = False
        self.crossed: deque[float] = deque(maxlen=_CROWD)
        self.grid = 0  # the number of the next row of the recording grid
        start = settings.start
        self._check_range(start)
        t = float(start)
        ticks = tuple(
            max(0, math.ceil((start / plan.base - rate.offset) / rate.period)) for rate in plan.rates
        )
        self.segment = inputs.segment(t)
        self.broken = t  # the last input breakpoint passed; it may lie some ulp after its instant
        self.target = t  # the instant that the current step leads to
        self.dirty = False  # an input or a parameter was set since the last instant
        self.longest = self._longest_step()
        self.left: tuple[float, ...] | None = None
        try:
            snapshot = self.instants.start(t, self.segment.at(t), ticks, 1)
            self.now = replace(snapshot, exact=start)
            due = self._due_rates(start)
            after, fired = self.instants.instant(self.now, self._u(), (), due)
        except SimulationError as error:
            raise self._failed(error) from None
        self._enter(after, fired)
        self.seconds += time.perf_counter() - begun

    def _longest_step(self) -> float:
        """The longest step of an adaptive method: a fiftieth of the run, as a step that sees nothing learns nothing.

        Without states the error says nothing at all, so that what depends on time alone needs shorter ones.
        """
        if self.settings.stop is None or self.settings.stop <= self.settings.start:
            return math.inf
        return float(self.settings.stop - self.settings.start) / (50 if self.plan.states else 1000)

    # --- time --------------------------------------------------------------------------------------------------

    def _check_range(self, t: Fraction) -> None:
        if self.plan.rates and abs(t / self.plan.base) > 2**53:
            raise ModelError(
                Fault("E119", self.plan.name, f"{float(t)} s are more than 2^53 base steps of {float(self.plan.base)} s.",
                      "Choose periods with a coarser common base.")  # fmt: skip
            )

    def _due_rates(self, exact: Fraction) -> frozenset[int]:
        """The rates whose next tick lies exactly here."""
        count = exact / self.plan.base
        return frozenset(
            k
            for k, (rate, n) in enumerate(zip(self.plan.rates, self.now.ticks, strict=True))
            if rate.offset + n * rate.period == count
        )

    def _next_tick(self) -> tuple[float, Fraction | None]:
        counts = [rate.offset + n * rate.period for rate, n in zip(self.plan.rates, self.now.ticks, strict=True)]
        if not counts:
            return math.inf, None
        count = min(counts)
        return self.plan.tick_time(count), count * self.plan.base

    def advance_to(self, stop: Fraction) -> None:
        """Run up to and including the instant at `stop`.

        Raises SimulationError, with the results so far, where the numbers fail. After KeyboardInterrupt the run stands
        at the last accepted step and `interrupted` is set.
        """
        begun = time.perf_counter()
        self._check_range(stop)
        end = float(stop)
        try:
            if self.dirty:
                self._settle()
            while self.now.t < end:
                self._to_next_instant(stop, end)
        except KeyboardInterrupt:
            self.interrupted = True
        except SimulationError as error:
            raise self._failed(error) from None
        finally:
            self.seconds += time.perf_counter() - begun

    def _to_next_instant(self, stop: Fraction, end: float) -> None:
        tick, exact = self._next_tick()
        target, which = (tick, exact) if tick <= end else (end, stop)
        edge = min((*self.now.events, self.inputs.next_break(self.broken)))
        if edge < target and not within_ulps(edge, target):
            target, which = edge, None
        self.target = target
        if self._integrate(target):
            self._instant(which, target)
        # else a crossing came first, and its instant is done

    def _instant(self, exact: Fraction | None, t: float) -> None:
        """The instant at t, where everything that stands within 4 ulp happens."""
        events = [i for i, event in enumerate(self.now.events) if within_ulps(event, t)]
        due = self._due_rates(exact) if exact is not None else frozenset()
        self.now = replace(self.now, t=t, exact=exact)
        self.left = self._row()
        passed = False
        while (edge := self.inputs.next_break(self.broken)) <= t or within_ulps(edge, t):
            self.broken, passed = edge, True
        if passed:
            self.segment = self.inputs.segment(max(t, self.broken))
        after, fired = self.instants.instant(self.now, self._u(), events, due)
        self._enter(replace(after) if passed else after, fired)

    # --- instants ----------------------------------------------------------------------------------------------

    def _u(self) -> tuple[float, ...]:
        return self.segment.at(self.now.t)

    def _memory(self) -> tuple[Any, ...]:
        return self.instants.memory(self.now, self._u())

    def _row(self) -> tuple[float, ...]:
        return self._logged(*self._memory())

    def _enter(self, after: Snapshot, fired: list[Event]) -> None:
        """Take the values after an instant, and record what it changed."""
        if after is not self.now:
            # The rates at the start of the next step are other ones now; the proposed step may still serve.
            after = replace(after, memory=replace(after.memory, first=None))
            self.measures.jumped()
        self.now = after
        self.events += fired
        self.instant_count += 1
        right = self._row()
        self._record(self.left, right)
        self.left = None

    def _record(self, left: tuple[float, ...] | None, right: tuple[float, ...]) -> None:
        t = self.now.t
        self._check_row(right)
        jump = left is not None and left != right
        every = self.settings.every
        on_grid = every is None or t == float(self.settings.start + self.grid * every)
        if jump and left is not None:
            self.recording.add(t, left)
        if jump or on_grid:
            self.recording.add(t, right)
        if every is not None and on_grid:
            self.grid += 1

    def _check_row(self, row: tuple[float, ...]) -> None:
        if all(map(math.isfinite, row)):
            return
        raise self._not_finite("is")

    def _not_finite(self, verb: str) -> SimulationError:
        """The error that names the first signal that is not finite, in the order of computation."""
        plan = self.plan
        memory = self._memory()
        for kind, names, values in (("state", plan.states, memory[1]), ("value", plan.discretes, memory[2])):
            for name, value in zip(names, values, strict=True):
                if not math.isfinite(value):
                    return SimulationError(Fault("E303", name, f"{verb} {value} at t = {self.now.t} s ({kind})."))
        program = plan.program([("w", i) for i in range(len(plan.outputs))])
        nodes = [(s.instance, key, element) for s in program.steps for key, element in s.results]
        nodes += plan.derivatives
        values = self.compiled.program("everything", nodes)(*memory)
        for node, value in zip(nodes, values, strict=True):
            if not math.isfinite(value):
                what = "the derivative of " if node[1].startswith("derivative") else ""
                return SimulationError(
                    Fault("E303", plan.node_name(node), f"{what}{plan.node_name(node)} {verb} {value} at t = {self.now.t} s.")
                )
        return SimulationError(Fault("E303", plan.name, f"a value {verb} not finite at t = {self.now.t} s."))

    # --- between instants --------------------------------------------------------------------------------------

    def _rates(self, t: float, x: Array) -> Array:
        self.evaluations += 1
        u = self.segment.base if self.segment.constant else self.segment.at(t)
        now = self.now
        return np.array(self._derivatives(t, x.tolist(), now.d, now.s, self.plan.parameters, u, now.ticks))

    def _integrate(self, target: float) -> bool:
        """Go on to `target`. False where a crossing was met before, whose instant is then done."""
        if self.settings.method == "radau" and len(self.plan.states):
            return self._integrate_stiff(target)
        while self.now.t < target:
            if not (self._fixed_step(target) if self.settings.is_fixed_step else self._adaptive_step(target)):
                return False
        return True

    def _first(self) -> Array:
        memory = self.now.memory
        return memory.first if memory.first is not None else self._rates(self.now.t, self.now.x)

    def _fixed_step(self, target: float) -> bool:
        """To the next point of the grid k * step, or to the target where that comes first."""
        now, settings = self.now, self.settings
        assert settings.step is not None
        fixed = now.fixed
        while (point := float(settings.start + fixed * settings.step)) <= now.t:
            fixed += 1
        t1 = min(point, target)
        tableau = METHODS[settings.method]
        made = trial(tableau, self._rates, now.t, now.x, self._first(), t1 - now.t)
        if not np.all(np.isfinite(made.x1)):
            self.now = replace(now, t=t1, x=made.x1)
            raise self._blown_up(now)

        def flow(h: float) -> Array:
            return trial(tableau, self._rates, now.t, now.x, made.k[0], h).x1

        return self._accept(made.interpolant(), t1, made.x1, Memory(first=made.last), flow, fixed)

    def _adaptive_step(self, target: float) -> bool:
        now, settings = self.now, self.settings
        tableau = METHODS["dopri5"]
        first = self._first()
        left = target - now.t
        h = now.memory.h
        if h <= 0:
            h = first_step(self._rates, now.t, now.x, first, tableau.order, self.atol, settings.rtol, left)
        h = min(h, self.longest)
        previous, grow, made = now.memory.error, _MOST, None
        while True:
            # The last step before the target is stretched a little rather than followed by a tiny one.
            step, t1 = (left, target) if h >= left / 1.01 else (h, now.t + h)
            if made is not None and step < 16 * math.ulp(now.t) and step < left:
                raise self._too_small(made)
            made = trial(tableau, self._rates, now.t, now.x, first, step)
            error = error_norm(made.error, now.x, made.x1, self.atol, settings.rtol)
            if error <= 1.0:
                break
            self.rejected += 1
            grow = 1.0
            h = step * (max(_LEAST, _SAFETY * error ** (-1 / tableau.order)) if math.isfinite(error) else 0.1)
        factor = _SAFETY * previous**_BETA * max(error, 1e-10) ** -(1 / tableau.order - 0.75 * _BETA)
        proposed = step * min(grow, max(_LEAST, factor))
        if step < h:  # cut short by the target: the proposal before it still counts
            proposed = max(proposed, h)

        def flow(size: float) -> Array:
            return trial(tableau, self._rates, now.t, now.x, first, size).x1

        memory = Memory(proposed, max(error, 1e-4), made.last)
        return self._accept(made.interpolant(), t1, made.x1, memory, flow, now.fixed)

    def _integrate_stiff(self, target: float) -> bool:
        now, settings = self.now, self.settings
        try:
            run = stiff.Radau(self._rates, now.t, now.x, target, settings.rtol, self.atol, now.memory.h)
            while self.now.t < target:
                begin = self.now
                dense, t1, x1 = run.step()

                def flow(h: float, begin: Snapshot = begin) -> Array:
                    end = begin.t + h
                    if h <= 0:
                        return begin.x
                    return stiff.flow(self._rates, begin.t, begin.x, end, settings.rtol, self.atol, begin.memory.h)

                if not self._accept(dense, t1, x1, Memory(h=run.proposed), flow, now.fixed):
                    return False
        except ArithmeticError as error:
            if isinstance(error, SimulationError):
                raise
            raise SimulationError(
                Fault("E308", self.plan.name, f"radau failed at t = {self.now.t} s: {error}", "Check for NaN, or raise rtol and atol.")
            ) from None
        return True

    def _accept(
        self, dense: Interpolant, t1: float, x1: Array, memory: Memory, flow: Callable[[float], Array], fixed: int
    ) -> bool:
        """Take an accepted step, unless a side changes inside: then take the part before, and do that instant."""
        now = self.now
        found = self._crossing(dense, t1, x1) if self.plan.crossings else None
        if found is not None:
            h, x1 = self._located(dense, flow, found, t1 - now.t)
            if now.t + h < t1:
                t1 = now.t + h
                memory = replace(memory, first=None)
                # The old proposal is kept: what cut the step short was the crossing, not the error.
        self.steps += 1
        self._fill_grid(dense, t1)
        if self.measures.count:
            self.measures.step(dense, t1, self._measured_at)
        self.now = replace(now, t=t1, exact=None, x=x1, memory=memory, fixed=fixed)
        if self.progress is not None:
            self.progress(t1)
        if found is not None and self._changed():
            self._crowded(t1)
            if t1 < self.target:
                self._instant(None, t1)
                return False
            return True  # the instant at the target takes it in
        if self.settings.every is None and t1 < self.target:
            self._record(None, self._row())
        return True

    def _changed(self) -> bool:
        values = self.instants.crossing_values(self.now, self._u())
        return tuple(float(value >= 0) for value in values) != self.now.s

    def _crossing_values(self, t: float, x: Array) -> Array:
        now = self.now
        memory = (t, x.tolist(), now.d, now.s, self.plan.parameters, self.segment.at(t), now.ticks)
        values = np.array(self.instants.sides(*memory))
        bad = np.nonzero(np.isnan(values))[0]
        if len(bad):
            raise self.instants.not_finite(int(bad[0]), t)
        return values

    def _crossing(self, dense: Interpolant, t1: float, x1: Array) -> tuple[float, float] | None:
        """The part of the step, as an interval of theta, in which a side changes first."""
        t0, h = self.now.t, t1 - self.now.t

        def evaluate(theta: float) -> Array:
            return self._crossing_values(t0 + theta * h, dense(np.array([theta]))[0])

        inner = dense(locate.NODES[1:4])
        values = np.array(
            [
                self._crossing_values(t0, self.now.x),
                *(self._crossing_values(t0 + theta * h, x) for theta, x in zip(locate.NODES[1:4], inner, strict=True)),
                self._crossing_values(t1, x1),
            ]
        )
        return locate.first_change(values, np.array(self.now.s) > 0, evaluate)

    def _located(self, dense: Interpolant, flow: Callable[[float], Array], found: tuple[float, float], h: float) -> tuple[float, Array]:
        """The size of the step to the first change of a side, and the states there, the step retaken to it.

        First on the dense output, which is cheap; then on real steps around that place, to 4 ulp of t.
        """
        t0 = self.now.t
        sides = np.array(self.now.s) > 0

        def beyond(size: float, x: Array) -> float:
            return float(np.max(self.instants.distance(self._crossing_values(t0 + size, x), sides)))

        def on_dense(size: float) -> float:
            return beyond(size, dense(np.array([size / h]))[0])

        def on_steps(size: float) -> float:
            return beyond(size, flow(size)) if size > 0 else -1.0

        resolution = 4 * math.ulp(t0 + h)
        guess = locate.narrowed(on_dense, found[0] * h, found[1] * h, resolution)
        reach = max(1e-9 * h, resolution)
        low, high = guess, guess
        while low > 0 and on_steps(low) >= 0:
            low = max(0.0, guess - reach) if guess - reach > 0 else 0.0
            reach *= 100
        reach = max(1e-9 * h, resolution)
        while high < found[1] * h and on_steps(high) < 0:
            high = min(found[1] * h, guess + reach)
            reach *= 100
        if on_steps(high) >= 0:
            high = locate.narrowed(on_steps, low, high, resolution)
        # t0 + high must be a time of its own after t0, or the run would stand still.
        t1 = max(t0 + high, math.nextafter(t0, math.inf))
        return t1 - t0, flow(t1 - t0)

    def _crowded(self, t: float) -> None:
        """Refuse a run whose crossings come ever faster."""
        if len(self.crossed) == _CROWD:
            stop = float(self.settings.stop) if self.settings.stop is not None else t
            span = max(stop - float(self.settings.start), 1e-3 * abs(t), 1e-12)
            if t - self.crossed[0] < _CROWD_PART * span:
                last = self.events[-1] if self.events else None
                place = f"{last.block}.{last.what}" if last else self.plan.name
                raise SimulationError(
                    Fault("E304", place, f"{_CROWD} crossings between t = {self.crossed[0]} s and {t} s: Zeno or chattering.",
                          "Give the block a state of rest, or the crossing a hysteresis.")  # fmt: skip
                )
        self.crossed.append(t)

    def _fill_grid(self, dense: Interpolant, t1: float) -> None:
        """Rows of the recording grid strictly inside a step."""
        every = self.settings.every
        if every is None:
            return
        times = []
        while (t := float(self.settings.start + self.grid * every)) < t1:
            times.append(t)
            self.grid += 1
        if times:
            theta = (np.array(times) - dense.t0) / dense.h
            now = self.now
            for t, x in zip(times, dense(theta), strict=True):
                memory = (t, x.tolist(), now.d, now.s, self.plan.parameters, self.segment.at(t), now.ticks)
                row = self._logged(*memory)
                if not all(map(math.isfinite, row)):
                    self.now = replace(now, t=t, x=x)
                    raise self._not_finite("became")
                self.recording.add(t, row)

    def _measured_at(self, t: float, x: Array) -> tuple[float, ...]:
        now = self.now
        return self._measured(t, x.tolist(), now.d, now.s, self.plan.parameters, self.segment.at(t), now.ticks)

    # --- failures ----------------------------------------------------------------------------------------------

    def _too_small(self, made: Any) -> SimulationError:
        now = self.now
        with np.errstate(all="ignore"):
            scaled = np.abs(made.error) / (self.atol + self.settings.rtol * np.abs(now.x))
        if not np.all(np.isfinite(made.k)):
            bad = int(np.nonzero(~np.isfinite(made.k).all(axis=0))[0][0])
            return SimulationError(
                Fault("E303", self.plan.states[bad], f"its derivative is not finite just after t = {now.t} s.",
                      "The step was shortened until it could not be any more.")  # fmt: skip
            )
        worst = int(np.argmax(scaled))
        return SimulationError(
            Fault("E301", self.plan.states[worst], f"at t = {now.t} s the step became too small to reach rtol {self.settings.rtol}.",
                  "The model may jump or chatter here: use a crossing, radau for stiff models, or a larger tolerance.")  # fmt: skip
        )

    def _blown_up(self, before: Snapshot) -> SimulationError:
        bad = int(np.nonzero(~np.isfinite(self.now.x))[0][0])
        value, t = self.now.x[bad], self.now.t
        self.now = before
        return SimulationError(
            Fault("E303", self.plan.states[bad], f"became {value} at t = {t} s.", "The step may be too large for the model.")
        )

    def _failed(self, error: SimulationError) -> SimulationError:
        """The error with all that was computed before it."""
        results = self.results()
        t = f"{results.t[-1]:.10g}" if len(results.t) else "the start"
        faults = [replace(f, cure=f"{f.cure} Results up to {t} s are kept.".strip()) for f in error.faults]
        return SimulationError(*faults, results=results)

    # --- from outside ------------------------------------------------------------------------------------------

    def set_input(self, index: int, value: Array) -> None:
        """An input jumps now."""
        if not self.dirty:
            self.left = self._row()
            self.dirty = True
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.now.t)

    def set_parameters(self, plan: Plan) -> None:
        """Tunable parameters change now; the plan is the same but for their values."""
        if not self.dirty:
            self.left = self._row()
            self.dirty = True
        self.plan = plan
        self.instants.plan = plan

    def _settle(self) -> None:
        """The instant at which inputs that were set take effect."""
        self.dirty = False
        after, fired = self.instants.instant(self.now, self._u(), (), frozenset())
        self._enter(replace(after), fired)

    def value(self, references: tuple[Reference, ...]) -> tuple[float, ...]:
        """Values now."""
        if self.dirty:
            self._settle()
        return self.compiled.program("asked", references)(*self._memory())

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
        return Results(
            self.plan.name, t, values, columns, tuple(self.events), self.measures.results(), statistics, self.interrupted
        )
