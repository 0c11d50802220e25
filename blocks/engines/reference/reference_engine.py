"""The reference engine: a Plan in plain Python, from instant to instant by a method. It is the meaning of every engine.

The state of a run at any moment is its Snapshot; this class holds the current one, the detection of Zeno behavior
(`chattering`), the rows (`rows`) and the measures. The module is longer than others because all that moves a run from
one Snapshot to the next stands here: the instants, the steps, and the crossings located inside them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.inputs import InputTable, Segment
from ...compile.plan import Plan, Reference
from ...compile.tableaus import METHODS, Tableau, end_apart
from ...compile.time_grid import Grid, within_ulps
from ...compile.upstream import remembers_inputs
from ...fmi.patience import patient
from ...results.results import Event, Statistics
from ...text.arrays import Array, frozen
from ...text.errors import Fault, SimulationError
from ..run.engine import Recorded, ended_by, heard_by_python
from ..run.history import POWERS, Past, has_jumped
from ..run.measures import Measures
from ..run.model_exchange import Foreigns
from ..run.saved_state import State, fit, standing
from ..run.snapshot import MethodMemory, Snapshot, told_method
from ..run.step_parts import longest_step
from ..run.step_polynomial import Interpolant
from ..run.stiffness import StateRates
from . import event_location, stiff
from .chattering import CrossingWatch, ProgressWatch
from .event_update import Instants
from .failures import Failures
from .inside_step import InsideStep, in_time
from .methods import Flow, StepRefused, Trial, error_norm, first_step, retaking, trial, worst
from .python_code import CompiledPrograms, Evaluator
from .rows import Row, RunRows
from .touches import Touches

Rates = Callable[[float, Array], Array]


# PI control of the step (Hairer, Norsett and Wanner, IV.2): the exponents of dopri5 with beta = 0.04.
_BETA = 0.04
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 10.0
# A run is stiff where so many steps say so, without so many in a row between (docs/semantics.md, "Methods").
_HITS, _CALM = 15, 6

_ENDS = np.array([1 / 1024, 1 / 256, 1 / 64, 1 / 16])
_ON_THE_WAY = np.array([*_ENDS, 0.25, 0.5, 0.75, *(1.0 - _ENDS[::-1]), 1.0])
_UNKNOWN: tuple[float, Array] = (math.nan, np.empty(0))
_KEPT = (
    "now", "segment", "inputs", "broken", "outstanding", "crossing", "unprojected", "changed", "left", "sides",
    "located", "touched", "steps", "rejected", "blamed", "evaluations", "instant_count", "events",
)  # fmt: skip


class ReferenceEngine:
    """One run of a Plan under way, as `engines.run.engine.Engine` defines it.

    compiled: the programs of the Plan, where there are some. foreign: its FMUs for Model Exchange. name: what results
    call it. is_silent: it records and measures nothing, as its caller does.
    """

    def __init__(
        self,
        plan: Plan,
        inputs: InputTable,
        *,
        compiled: CompiledPrograms | None = None,
        foreign: Foreigns | None = None,
        name: str = "reference",
        is_silent: bool = False,
    ) -> None:
        self.plan, self.settings, self.inputs, self.name = plan, plan.settings, inputs, name
        self.compiled = compiled or CompiledPrograms(plan)
        self.asked: dict[tuple[Reference, ...], Evaluator] = {}
        self.instants = Instants(plan, self.compiled)
        self.instants.foreign = foreign if foreign is not None else Foreigns.of(plan)
        self.logged: list[Reference] = [*plan.columns]
        self.is_silent = is_silent
        self.compiled_rates: Rates | None = None  # dx/dt by compiled code, in the place of the program
        measured = Measures(plan).references
        self._derivatives = self.compiled.program("derivatives", plan.derivatives)
        self._measured = self.compiled.program("measured", measured)
        self._logged = self.compiled.program("logged", self.logged)
        self._remembered = self.compiled.program("remembered", [history.source for history in plan.histories])
        self.fixed = Grid.of(self.settings.start, self.settings.step) if self.settings.step is not None else None
        self.scale = plan.time_scale
        self.remembers_inputs = remembers_inputs(plan)
        self.failures = Failures(plan, self.compiled, self.instants, self._memory)
        self._clear()

    def _clear(self) -> None:
        """Nothing has run yet."""
        plan, settings = self.plan, self.settings
        self.atol = settings.atol * np.array(plan.nominal, dtype=float)
        self.steps = self.rejected = self.evaluations = self.instant_count = 0
        self.blamed = np.zeros(len(plan.states), dtype=int)
        self.events: list[Event] = []
        self.longest = longest_step(plan)
        t = float(settings.start)
        self.has_begun = False
        self.instants.programs.clear()
        self.instants.later = 0.0
        self.instants.slack, self.instants.looseness = (), 1.0
        self.now = Snapshot(t, settings.start, np.empty(0), (), (), (), (), (), MethodMemory())
        self.segment = self.inputs.segment(t)
        self.broken = t  # the last input breakpoint passed; it may lie some ulp after its instant
        self.outstanding = True  # whether the instant at the current time is still to come
        self.crossing = False  # whether a side has changed at the end of the last step
        self.unprojected: Snapshot | None = None  # the end of that step before projections: crossings fire by it
        self.changed = True  # whether an input or a parameter was set since the last instant
        self.recourses = False  # whether inputs did not jump since, but go on by another extrapolation
        self.left: Row | None = None  # the row before an input or a parameter was set
        self.sides = _UNKNOWN  # a time, and the values of all crossings at it
        self.sloped: tuple[Snapshot | None, Array] = (None, np.empty(0))  # where the Jacobian is known, and what it is
        self.located = _UNKNOWN  # a located crossing: its time, and how far beyond it each changed crossing then was
        self.sure = _UNKNOWN  # the same of a longer step than the one at hand, from which a master went back
        self.touched = _UNKNOWN  # a time, and the values of crossings that touch 0 there; NaN of all others
        self.stiff: stiff.Radau | None = None  # the stiff method, and the factors that it has
        self.crossed, self.pace, self.measures = CrossingWatch(plan, self.instants), ProgressWatch(plan), Measures(plan)
        self.inside = InsideStep(plan, self.compiled, list(self.measures.references), self.logged, self._memory)
        self.rows = RunRows(plan, len(self.logged), self.inside, self._logged_at, self.scale, is_silent=self.is_silent)

    def start(self) -> None:
        """Values at the start, and the instant there."""
        self._clear()
        self.stand_at_start(self.segment.at(float(self.settings.start)))
        with np.errstate(all="ignore"):
            self.instant(is_start=True)

    def stand_at_start(self, u: Sequence[float]) -> None:
        """Values at the start with these inputs; the instant there is outstanding."""
        plan, start = self.plan, self.settings.start
        ticks = tuple(max(0, math.ceil((start / plan.base - rate.offset) / rate.period)) for rate in plan.rates)
        with np.errstate(all="ignore"):
            self.now = replace(self.instants.start(float(start), u, ticks, 1), exact=start)
        self.has_begun = True
        self._keep_in_delays()

    def _keep_in_delays(self) -> None:
        """No step is longer than the known past allows."""
        if self.now.past is not None:
            self.longest = min(self.longest, self.now.past.longest_step)

    def go_on_from(self, state: State) -> None:
        """Stand where a saved run stood; its last row is the first one here."""
        self.stand_at(state)
        if "recorded" in state.rows:
            t, *values = state.rows["recorded"].tolist()
            self.rows.between = int(state.rows["between"])
            self.rows.recording.add(t, values)
        elif not self.outstanding:
            with np.errstate(all="ignore"):
                self.rows.recording.add(self.now.t, self._row())

    def stand_at(self, state: State) -> None:
        """Stand where a saved run stood, with nothing recorded."""
        self._clear()
        rows, changed = standing(state, self.plan, self.inputs)
        now = Snapshot.of_rows(rows, state.exact, self.plan)
        self.now, self.broken, self.has_begun = now, float(rows["broken"]), True
        self.segment = self.inputs.segment(max(now.t, self.broken))
        self.located = float(rows["located_t"]), rows["located"]
        self.crossed.go_on(rows)
        self.measures = self.measures.restored(rows)
        for number, blob in enumerate(state.steppers):
            self.instants.restore(number, blob)
        if state.foreign:
            self.instants.foreign.restore(self.plan, state.foreign, now.t)
        self.outstanding = self.changed = changed
        self.rows.go_on(now.t)
        self._keep_in_delays()

    def stand(
        self, *, outstanding: bool, crossing: bool, changed: bool, unprojected: tuple[Array, tuple[float, ...]] | None,
        tries: int,
    ) -> None:  # fmt: skip
        """Go on for some steps as another engine would. Raises SimulationError where this one fails.

        unprojected: states and discretes before the projections of a step in which a side has changed.
        """
        self.outstanding, self.crossing, self.changed = outstanding, crossing, changed
        if unprojected is not None:
            self.unprojected = replace(self.now, x=unprojected[0], d=unprojected[1])
        end = self.settings.stop if self.settings.stop is not None else Fraction(self.now.t) + 1
        with np.errstate(all="ignore"):
            for _ in range(tries):
                if self.outstanding:
                    self.instant()
                elif self.now.t >= float(end):
                    return
                else:
                    self.step(*self.next_instant(end))

    @property
    def t(self) -> float:
        """The time in s that the run has reached."""
        return self.now.t

    @property
    def exact(self) -> Fraction | None:
        return self.now.exact

    @property
    def _method(self) -> tuple[str, str]:
        return self.settings.method, str(self.settings.step)

    def snapshot(self, overrides: Mapping[str, object]) -> State:
        self._settle()
        last = self.rows.recording.last
        located_t, located = self.located
        rows = {
            **self.now.rows(),
            "broken": np.array(self.broken),
            "located_t": np.array(located_t),
            "located": located if len(located) else np.full(len(self.plan.crossings), -1.0),
            **self.crossed.rows(),
            "parameters": np.array(self.plan.parameters),
            **self.measures.rows(),
        }
        if not math.isnan(last[0]):
            rows |= {"recorded": np.array([last[0], *last[1]]), "between": np.array(self.rows.between)}
        steppers = tuple(self.instants.saved(number) for number in range(len(self.plan.steppers)))
        foreign = self.instants.foreign.saved()
        return State(fit(self.plan), self._method, overrides, self.now.exact, rows, self.inputs, steppers, foreign)

    @property
    def over(self) -> Fault | None:
        foreign = self.instants.foreign.over
        return ended_by(self.settings.stop_when, self.now.t) if foreign is None and self._holds(self.now.s) else foreign

    def _holds(self, sides: Sequence[float]) -> bool:
        """Return whether the condition that ends the run holds."""
        return self.plan.ends is not None and len(sides) > 0 and sides[self.plan.ends] > 0

    def proceed(self, stop: Fraction) -> bool:
        end = float(stop)
        with np.errstate(all="ignore"):
            if self.outstanding:
                self.instant()
            elif self.now.t < end and self.over is None:
                self.step(*self.next_instant(stop))
        return not self.outstanding and (self.now.t >= end or self.over is not None)

    def pause(self, every: float, at: float) -> None:
        pass  # a moment is one step

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        # An interrupt comes after a step or an instant, where FMUs stand where the run does; a second one at once.
        return patient() if self.plan.foreign else heard_by_python()

    @property
    def tried(self) -> int:
        return self.steps + self.rejected

    @property
    def recorded_bytes(self) -> float:
        return self.rows.recording.bytes

    # --- instants ----------------------------------------------------------------------------------------------

    def next_instant(self, stop: Fraction) -> tuple[float, Fraction | None]:
        """The time of the next tick, edge or stop; exactly, where it is a tick or the stop."""
        end = float(stop)
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

    @property
    def due_rates(self) -> frozenset[int]:
        """The rates whose next tick lies exactly here."""
        exact = self.now.exact
        if exact is None:
            return frozenset()
        count = exact / self.plan.base
        pairs = zip(self.plan.rates, self.now.ticks, strict=True)
        return frozenset(k for k, (rate, n) in enumerate(pairs) if rate.offset + n * rate.period == count)

    @property
    def is_due(self) -> bool:
        """Whether something happens now by itself: a tick, an event, a crossing."""
        plan = self.plan
        if self.crossing or (plan.projections and plan.crossings) or plan.histories:
            return True
        return bool(self.due_rates or self.due_events)

    @property
    def due_events(self) -> list[int]:
        """The event times that stand here."""
        now = self.now
        return [i for i, event in enumerate(now.events) if within_ulps(event, now.t, self.scale)]

    def instant(self, *, is_start: bool = False) -> None:
        """The instant at the current time, where everything that stands within 4 ulp happens."""
        now = self.now
        events = self.due_events
        if not self.crossing:
            self.instants.loosen(now, self.segment.at(now.t))
        self.instants.looseness = 1.0
        self.instants.touched = self.touched
        has_left = self.settings.records_jumps and not is_start and not self.is_silent
        left = self.left or self._row() if has_left else None
        past = now.past
        if past is not None:
            now = replace(now, past=past.after_breaks(now.t))
        segment, broken, changed = self._inputs_now(now.t)
        hidden = self.instants.foreign.events
        self.instants.inputs_later = segment.at(now.t + self.instants.later)
        if changed and self.crossing and self.sides[0] == now.t:
            values = self.instants.sides_now(self.unprojected or now, segment.at(now.t))
            self.crossed.withdraw(now.t, np.not_equal(values, self.sides[1]))
        after, fired = self.instants.instant(
            now,
            segment.at(now.t),
            events,
            self.due_rates,
            changed=changed or now.past is not past,
            seen=self.unprojected,
        )
        # The sides that are known are those before projections, where these moved.
        happened = (after.s, after.ticks) != (now.s, now.ticks) or self.unprojected is not None
        happened = happened or bool(events or fired) or self.instants.foreign.events != hidden
        fresh = changed or happened or after.d != now.d or not np.array_equal(after.x, now.x)
        if after.past is not None:
            jumps = happened or (changed and not self.recourses)
            after = replace(after, past=self._past_to_keep(after.past, now, after, jumps=jumps))
        measures, sides = self.measures, self.sides
        memory = self.instants.memory(after, segment.at(now.t))
        if fresh or now.past is not past:
            # The rates at the start of the next step are other ones now; the proposed step may still serve.
            after = replace(after, memory=replace(after.memory, first=None, carried=None))
            sides = _UNKNOWN
            if measures.count:
                measures = measures.after_instant(now.t, self._finite(self._measured, memory))
        self._record(left, memory)
        # An interrupt comes before all of this or after it.
        self.segment, self.broken, self.now, self.measures, self.sides = segment, broken, after, measures, sides
        self.outstanding, self.changed, self.left, self.crossing, self.unprojected = False, False, None, False, None
        if not self.is_silent:  # an island may have the rest of the instant still before it
            self.instants.later = 0.0
        self.instant_count += 1
        self.events += fired

    def _inputs_now(self, t: float) -> tuple[Segment, float, bool]:
        """Return the segment of the inputs after the instant at t, where it began, and whether the inputs changed."""
        broken = self.broken
        while (edge := self.inputs.next_break(broken)) <= t or within_ulps(edge, t, self.scale):
            broken = edge
        if broken == self.broken:
            return self.segment, broken, self.changed
        return self.inputs.segment(max(t, broken)), broken, True

    def _past_to_keep(self, past: Past, now: Snapshot, after: Snapshot, *, jumps: bool) -> Past:
        """Return the past after an instant. jumps: something happened at it."""
        jumps = jumps or has_jumped(now.x, after.x) or has_jumped(np.array(now.d), np.array(after.d))
        if self.recourses and self.remembers_inputs and not jumps:
            past = past.after_course(now.t)
        return past.after_instant(now.t, changed=jumps)

    def _memory(self, t: float, x: Array) -> tuple[Any, ...]:
        """The arguments of programs at another time and other states, with all else as it is."""
        now = self.now
        u, h = self.segment.at(t), now.delayed(t)
        return t, x.tolist(), now.d, now.s, self.plan.parameters, u, now.ticks, h, now.z, self.instants.foreign

    def _logged_at(self, t: float, x: Array) -> Row:
        return self._finite(self._logged, self._memory(t, x))

    def _measured_at(self, t: float, x: Array) -> Row:
        return self._finite(self._measured, self._memory(t, x))

    def _row(self) -> Row:
        return self._finite(self._logged, self._memory(self.now.t, self.now.x))

    def _record(self, left: Row | None, memory: tuple[Any, ...]) -> None:
        if self.is_silent:
            return
        if self.over is not None or self._holds(memory[3]):
            self.rows.end = memory[0]
        if self.rows.wants(memory[0]):
            self.rows.at_instant(memory[0], left, self._finite(self._logged, memory))

    def _finite(self, program: Evaluator, memory: tuple[object, ...]) -> Row:
        """What a program gives. Raises SimulationError (E303) where it is not finite."""
        values = program(*memory)
        if not all(map(math.isfinite, values)):
            raise self.failures.not_finite(memory, "is")
        return values

    # --- between instants --------------------------------------------------------------------------------------

    def step(self, target: float, exact: Fraction | None) -> None:
        """One accepted step towards `target`, the next instant, or to the first crossing before it.

        An instant is outstanding at the end where there is one.
        """
        hits, calm, since = self.now.memory.stiffness
        if hits == _HITS and math.isnan(since):
            since = self.now.t
            self.now = replace(self.now, memory=replace(self.now.memory, stiffness=(hits, calm, since)))
        is_stiff = not math.isnan(since)
        if self.settings.method == "radau" or is_stiff:
            self._stiff_step(target, exact)
        elif self.fixed is not None:
            self._fixed_step(self.fixed, target, exact)
        else:
            self._adaptive_step(target, exact)

    def _rates(self, t: float, x: Array) -> Array:
        self.evaluations += 1
        if self.compiled_rates is not None:
            return self.compiled_rates(t, x)
        now, segment = self.now, self.segment
        u = segment.base if segment.constant else segment.at(t)
        h = () if now.past is None else now.past.values(t)
        p, f = self.plan.parameters, self.instants.foreign
        rates = np.array(self._derivatives(t, x.tolist(), now.d, now.s, p, u, now.ticks, h, now.z, f))
        if self.plan.enabled:  # where a subdiagram is off, its states stay as they are
            sides = self.instants.state_sides
            rates[(sides >= 0) & (np.array((*now.s, 1.0))[sides] == 0.0)] = 0.0
        return rates

    def _weights(self) -> Array:
        """What each state may be off by in a step from here."""
        weights: Array = self.atol + self.settings.rtol * np.abs(self.now.x)
        return weights

    def state_rates(self) -> StateRates | None:
        if self.plan.foreign:
            return None
        t = self.now.t

        def rates(x: Array) -> Array:
            counted = self.evaluations
            with np.errstate(all="ignore"):
                made = self._rates(t, x)
            self.evaluations = counted
            return made

        return StateRates(self.plan.states, self.now.x, self._weights(), rates, self.instant_count, self.longest)

    def _first(self) -> Array:
        """The rates now. Raises SimulationError (E303) where they are not finite."""
        now = self.now
        if now.memory.first is not None:
            return now.memory.first
        first = self._rates(now.t, now.x)
        if not np.isfinite(first).all():
            raise self.failures.not_finite(self._memory(now.t, now.x), "is")
        return first

    def _flow(self, tableau: Tableau, first: Array) -> Flow:
        """Return the flow from here."""
        now = self.now
        return retaking(tableau, self._rates, now.t, now.x, first, self.atol, self.settings.rtol)

    def _fixed_step(self, grid: Grid, target: float, exact: Fraction | None) -> None:
        """To the next point of the grid start + k step, or to the target where that comes first."""
        now, fixed, tableau = self.now, self.now.fixed, METHODS[self.settings.method]
        while (point := grid.time(fixed)) <= now.t:
            fixed += 1
        t1 = target if point >= target or within_ulps(point, target) else point
        if now.past is not None and t1 - now.t > now.past.longest_step:  # in equal parts that no delay is shorter than
            t1 = now.t + (t1 - now.t) / math.ceil((t1 - now.t) / now.past.longest_step)
        first = self._first()
        attempt = trial(tableau, self._rates, now.t, now.x, first, t1 - now.t)
        if not np.isfinite(attempt.x1).all():
            raise self.failures.blown_up(attempt, "The step may be too large for the model.")
        flow = self._flow(tableau, first)
        self._accept(
            attempt.interpolant(), t1, attempt.x1, MethodMemory(first=attempt.last), flow, target, exact, fixed
        )

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
            attempt = trial(tableau, self._rates, now.t, now.x, first, step)
            error = error_norm(attempt.error, now.x, attempt.x1, self.atol, rtol)
            if error <= 1.0:
                try:
                    self._accept_adaptive(attempt, t1, h, error, grow, target, exact)
                    return
                except StepRefused as refused:  # of the part before a crossing, or up to where projections follow
                    step, error, culprit = refused.step.h, refused.step.error, refused.step.culprit
            else:
                culprit = worst(attempt.error, now.x, attempt.x1, self.atol, rtol)
            if h <= least or step <= least:
                raise self.failures.too_small(attempt, self._weights())
            self.rejected += 1
            self.blamed[culprit] += 1
            grow = 1.0
            factor = max(_LEAST, _SAFETY * error ** (-1 / tableau.order)) if math.isfinite(error) else 0.1
            h = max(step * factor, least)

    def _accept_adaptive(
        self, attempt: Trial, t1: float, h: float, error: float, grow: float, target: float, exact: Fraction | None
    ) -> None:
        """Take a step to t1 whose error fits. h: the size that was proposed; grow: by how much the next may be larger.

        Raises StepRefused where it is retaken, and the error does not fit then.
        """
        now, tableau, step = self.now, attempt.tableau, attempt.h
        factor = _SAFETY * now.memory.error**_BETA * max(error, 1e-10) ** -(1 / tableau.order - 0.75 * _BETA)
        proposed = step * min(grow, max(_LEAST, factor))
        if step < h:  # cut short by the target: the proposal before it still counts
            proposed = max(proposed, h)
        memory = MethodMemory(proposed, max(error, 1e-4), attempt.last)
        if self.settings.method == "auto":
            memory = replace(memory, stiffness=self._stiffness(attempt))
        pace, first = self.pace.kept(), np.asarray(attempt.k[0])
        self.pace.step(self.steps + 1, now.t, t1, now.x, first, self._rates, self._weights(), self.rows.end)
        flow = self._flow(tableau, first)
        try:
            self._accept(attempt.interpolant(), t1, attempt.x1, memory, flow, target, exact, now.fixed)
        except StepRefused:
            self.pace.go_back(pace)
            raise

    def _stiffness(self, step: Trial) -> tuple[float, float, float]:
        """How many steps say that the run is stiff, and since when it is, after another one.

        Stability limits a step where h |df/dx|, as its last two stages have it, which both stand at its end, is near
        the edge. Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2.
        """
        hits, calm, _ = self.now.memory.stiffness
        weights = 1.0 / (self.atol + self.settings.rtol * np.abs(step.x1))
        rates = weights * (step.k[-1] - step.k[-2])
        states = weights * (end_apart(step.tableau) @ step.k[:-1])
        if float(rates @ rates) > 3.25**2 * float(states @ states):
            hits, calm = hits + 1, 0.0
        else:
            hits, calm = (0.0, calm + 1) if calm + 1 == _CALM else (hits, calm + 1)
        return hits, calm, math.nan

    def _slopes(self, t: float, x: Array) -> Array:
        """The Jacobian of the rates; that at a step's begin is kept, as the search for a crossing asks for it often."""
        now = self.now
        is_now = t == now.t and np.array_equal(x, now.x)
        if is_now and self.sloped[0] is now:
            return self.sloped[1]
        slopes: Array = stiff.Slopes.of(self.compiled).at(self._memory(t, x), lambda x: self._rates(t, x))
        if is_now:
            self.sloped = (now, slopes)
        return slopes

    def _stiff_step(self, target: float, exact: Fraction | None) -> None:
        """A step by radau. What it keeps from step to step counts while the rates at t do."""
        now, rtol, n = self.now, self.settings.rtol, len(self.now.x)
        slopes = stiff.Slopes.of(self.compiled)
        values = len(slopes.jacobian.indices)
        if self.stiff is None:
            self.stiff = stiff.Radau(self._rates, self._slopes, slopes.matrix, n)
        method = self.stiff
        first, carried = self._first(), stiff.Carried.nothing(n)
        if now.memory.first is not None and now.memory.carried is not None:
            carried = stiff.Carried.of_row(now.memory.carried, n, values)
        flow = method.flow(now.t, now.x, first, self.atol, rtol)
        is_taken, refused = False, None
        while not is_taken:
            try:
                made = method.step(
                    now.t, now.x, first, carried, now.memory.h, target, self.longest, self.atol, rtol, refused=refused
                )
            except SimulationError:
                raise
            except ArithmeticError as error:
                raise self.failures.stiff_failed(now.t, now.x, first, self._weights(), str(error)) from None
            finally:
                self.rejected += method.rejected
                self.blamed += method.blamed
                method.rejected, method.blamed[:] = 0, 0
            stiffness = now.memory.stiffness
            memory = MethodMemory(made.proposed, made.error, frozen(made.last), made.carried.row(values), stiffness)
            try:
                self._accept(made.dense, made.t1, made.x1, memory, flow, target, exact, now.fixed)
                is_taken = True
            except StepRefused as again:
                refused = again.step

    def _accept(
        self,
        dense: Interpolant,
        t1: float,
        x1: Array,
        memory: MethodMemory,
        flow: Flow,
        target: float,
        exact: Fraction | None,
        fixed: int,
    ) -> None:
        """Take an accepted step to (t1, x1), or the part of it before the first change of a side.

        Raises StepRefused where such a part is retaken, and its error is too large.
        """
        now, end, changed = self.now, t1, False
        if self.plan.projections and self.fixed is None:
            shorter = self._followed(dense, t1)
            if shorter < t1:
                t1, x1, memory = shorter, flow.retake(shorter - now.t), replace(memory, first=None, carried=None)
        if self.plan.crossings:
            t1, x1, changed = self._up_to_crossing(dense, t1, x1, flow, target)
            if t1 < end:
                # The old proposal is kept: what cut the step short was the crossing, not the error.
                memory = replace(memory, first=None, carried=None)
        self.rows.in_step(self.steps, now, dense, t1, outstanding=changed or t1 == target)
        past = self._past_after(dense, t1, x1)
        after = replace(
            now, t=t1, exact=exact if t1 == target else None, x=frozen(x1), memory=memory, fixed=fixed, past=past
        )
        after = self.instants.with_solutions(after, self.segment.at(t1))
        measures = self.measures.after_step(now.t, t1, self._measured_parts(dense, t1, x1))
        outstanding, unprojected = changed or t1 == target, None
        if self.plan.projections:
            before, (after, moved) = after, self._projected(after, changed=changed)
            outstanding = outstanding or moved
            if changed and after is not before:
                unprojected = before
        if self.instants.foreign and self.instants.completed(after, self.segment.at(t1)):
            outstanding = True
        if not outstanding and self.settings.every is None:
            self._record(None, self.instants.memory(after, self.segment.at(t1)))
        # An interrupt comes before all of this or after it.
        self.outstanding, self.crossing, self.now, self.measures = outstanding, changed, after, measures
        self.unprojected = unprojected
        self.steps += 1

    def _measured_parts(self, dense: Interpolant, t1: float, x1: Array) -> Any:
        """Pieces of a step in parts, as measures ask for them."""
        now = self.now

        def parts(low: float, high: float, first: Array | None) -> Iterator[tuple[float, float, Array]]:
            end = x1 if high == t1 else None
            pieces = self.inside.parts("measured", now, dense, low, high, self._measured_at, x1=end, first=first)
            return in_time(pieces, low, high)

        return parts

    def _past_after(self, dense: Interpolant, t1: float, x1: Array) -> Past | None:
        """What histories remember after a step to (t1, x1)."""
        now = self.now
        if now.past is None:
            return None

        def signals(t: float, x: Array) -> Row:
            return self._finite(self._remembered, self._memory(t, x))

        parts = self.inside.parts("remembered", now, dense, now.t, t1, signals, x1=x1) if t1 > now.t else ()
        return now.past.after_step(t1, ((b, e, v.copy()) for b, e, v in in_time(parts, now.t, t1)))

    def _followed(self, dense: Interpolant, t1: float) -> float:
        """The end of a step, or an earlier time up to which projections follow it as closely as the tolerance asks.

        One projection at the end is compared with several on the way. Some of these stand close to the ends: a turn
        soon after an instant, or shortly before the end, would else be missed.
        """
        now, settings = self.now, self.settings
        if self.inside.look("projections")[0].turns and t1 > now.t:
            parts = self.inside.parts("projections", now, dense, now.t, t1, self._measured_at)
            _, t1, _ = next(in_time(parts, now.t, t1))
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
                message = f"at t = {now.t} s it changes at every step, however short the step is."
                cure = 'Use every=period, an int, or a fixed step: with every="step", values must converge.'
                raise SimulationError(Fault("E301", name, message, cure))
            t1 = now.t + (t1 - now.t) * max(0.1, 0.9 / math.sqrt(error))  # it falls with the square of the step
        return t1

    def _projected_at(self, before: Snapshot, t: float, x: Array) -> Snapshot:
        return self.instants.projected(replace(before, t=t, x=frozen(x)), self.segment.at(t))

    def _projected(self, accepted: Snapshot, *, changed: bool) -> tuple[Snapshot, bool]:
        """The end of a step after the projections there, and whether these changed a side.

        changed: whether a side has changed in the step. It fires by the values seen there.
        """
        u = self.segment.at(accepted.t)
        after = self.instants.projected(accepted, u)
        if after is accepted or changed:
            return after, False
        values = np.array(self.instants.crossing_values(after, u))
        self.sides = (after.t, values)
        changed = self.instants.latched(after, values) != after.s
        return replace(after, memory=replace(after.memory, first=None, carried=None)), changed

    # --- crossings ---------------------------------------------------------------------------------------------

    def _crossing_values(self, t: float, x: Array) -> Array:
        values = np.array(self.instants.sides(*self._memory(t, x)))
        if np.isnan(values).any():
            raise self.instants.not_a_number(int(np.nonzero(np.isnan(values))[0][0]), t)
        return values

    def _up_to_crossing(
        self, dense: Interpolant, t1: float, x1: Array, flow: Flow, target: float
    ) -> tuple[float, Array, bool]:
        """The end of the step, or the first time in it at which a side has changed; the states; whether it has."""
        now, h = self.now, t1 - self.now.t
        self.instants.loosen(now, self.segment.at(now.t))
        self.instants.looseness = 2.0

        def evaluate(theta: float) -> Array:
            return self._crossing_values(now.t + theta * h, dense(np.array([theta * h / dense.h]))[0])

        def on_trial(theta: float) -> Array:
            x = dense(np.array([theta * h / dense.h]))[0]
            return np.array(self.instants.sides(*self._memory(now.t + theta * h, x)))

        before = self.sides[1] if self.sides[0] == now.t else None
        sides, located = np.array(now.s) > 0, self.located
        usual = now.memory.h if self.settings.step is None else float(self.settings.step)
        resolution = 4 * math.ulp(max(abs(now.t), abs(t1))) / h
        sure = self.sure[1] >= 0 if self.sure[0] == t1 else np.zeros(len(sides), dtype=bool)
        touches = Touches(sides, on_trial, resolution, usual / h, sure, is_closed=bool(self.plan.foreign))
        change: event_location.Found | None = None
        first, first_length, was_first, is_whole = None, 1.0, False, True
        for part in self.inside.parts("crossings", now, dense, now.t, t1, self._crossing_values, x1=x1, first=before):
            table, length = part.table, part.end - part.begin
            if first is None:
                touches.begin(table[0], 3.5 * math.ulp(now.t) / h)
            touches.enter(table, length)
            while True:
                change = event_location.first_change(table, sides, evaluate, touches.changed, part.begin, part.end)
                if change is None or not touches.found(change):
                    break
            if first is None:
                first, first_length = table.copy(), length
                was_first, is_whole = change is not None, part.end == 1.0
            if change is not None:
                break
        after = part.table[4].copy() if part.end == 1.0 else self._crossing_values(t1, x1)
        place = 1.0
        while change is not None:
            size = self._located(dense, flow.after, change, h, touches)
            is_cut = now.t + size < t1 and not within_ulps(now.t + size, target)
            # A time of its own after t, or the run would stand still.
            end = max(now.t + size, math.nextafter(now.t, math.inf)) if is_cut else t1
            x, place = (flow.retake(end - now.t), (end - now.t) / h) if is_cut else (x1, 1.0)
            after = self._crossing_values(end, x)
            if touches.judge(place, after, change) and is_cut and not np.any(touches.changed(place, after)):
                continue
            if is_cut:
                t1, x1 = end, x
                self.located = (t1, np.where(touches.changed(place, after), np.abs(after), -1.0))
            break
        fires = touches.changed(place, after)
        changed = bool(np.any(fires))
        if not (changed and (was_first or is_whole)) and located[0] == now.t:
            assert first is not None
            self.crossed.check_missed(now.t, first, sides, located[1], self._slopes_by_rates(first_length * h))
        self.instants.later = 0.0
        if t1 == target and (part.end == 1.0 or not changed):
            joined = self._joined(t1, x1, part.table, length, h, touches, ~fires)
            if joined is not None:
                x1, after, changed = *joined, True
                self.instants.later = 4 * math.ulp(t1)
        self.sides, self.touched = (t1, after), (t1, touches.kept(place, after))
        if not self.instants.later:
            self._count(t1, fires, after)
        return t1, x1, changed

    def _count(self, t: float, fires: Array, after: Array) -> None:
        """Count crossings that fire. One that joined an instant counts when it passes again: that may turn it back."""
        for j in np.nonzero(fires)[0]:
            self.crossed.add(t, int(j), up=bool(after[j] >= 0))

    def _slopes_by_rates(self, h: float) -> Callable[[], Array]:
        """How crossings begin to move from here, by the length h: along the rates, not along a polynomial of a step."""

        def slopes() -> Array:
            now, rates, size = self.now, self._first(), h / 1024
            near, far = (self._crossing_values(now.t + s, now.x + s * rates) for s in (size, 2 * size))
            return np.asarray(512 * (4 * near - far - 3 * self._crossing_values(now.t, now.x)))

        return slopes

    def _joined(
        self, t1: float, x1: Array, values: Array, length: float, h: float, touches: Touches, quiet: Array
    ) -> tuple[Array, Array] | None:
        """Where a crossing comes within 4 ulp after an instant at t1, to which it then belongs: states and crossings.

        values: those of the last part of the step, which is `length` of the step's h long. quiet: the crossings that
        have not changed their side up to t1.
        """
        since, sides = 8 * math.ulp(t1), touches.sides
        slopes, after = POWERS[1:].T @ np.arange(1, 5) @ values / (length * h), values[4]
        is_near = np.where(sides, after <= -slopes * since, -after <= slopes * since)
        if self.plan.foreign or not np.any(quiet & is_near):
            return None
        x = frozen(x1 + 0.5 * since * self._rates(t1, x1))
        crossings = self._crossing_values(t1 + 0.5 * since, x)
        return (x, crossings) if np.any(quiet & touches.joined(crossings)) else None

    def _located(
        self,
        dense: Interpolant,
        flow: Callable[[float], Array],
        change: event_location.Found,
        h: float,
        touches: Touches,
    ) -> float:
        """The size of the step to the first change of a side, to 4 ulp of t, its right end.

        First on the dense output, which is cheap; then on real steps around that place.
        """
        t0 = self.now.t

        def beyond(t: float, x: Array) -> float:
            distances = self.instants.distance(self._crossing_values(t, x), touches.sides)
            return float(np.max(np.where((t - t0) / h <= touches.until, -math.inf, distances)))

        def on_dense(size: float) -> float:
            return beyond(t0 + size, dense(np.array([size / dense.h]))[0])

        def on_steps(size: float) -> float:
            t = t0 + size
            return beyond(t, flow(t - t0)) if t > t0 else -1.0

        resolution = 4 * math.ulp(max(abs(t0), abs(t0 + h)))
        last = change.high * h
        low = high = event_location.narrowed(on_dense, change.low * h, last, resolution)
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

    # --- from outside ------------------------------------------------------------------------------------------

    def set_input(self, index: int, value: Array) -> None:
        self._change()
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.now.t)

    def set_parameters(self, plan: Plan) -> None:
        self._change()
        self.take(plan)

    def take(self, plan: Plan) -> None:
        """The values of parameters, and the tolerances that follow from them."""
        self.plan = self.instants.plan = plan
        self.atol = self.settings.atol * np.array(plan.nominal, dtype=float)

    def _change(self) -> None:
        # Rows of a step that was interrupted before it counted.
        self.rows.cut(self.now.t)
        if self.left is None and self.settings.records_jumps:
            self.left = self._row()
        self.outstanding = self.changed = True

    def _settle(self) -> None:
        """Let an outstanding instant happen."""
        if self.outstanding:
            with np.errstate(all="ignore"):
                self.instant()

    def values(self, references: tuple[Reference, ...]) -> Row:
        self._settle()
        if references not in self.asked:
            self.asked[references] = self.compiled.program(f"asked_{len(self.asked)}", references)
        return self.asked[references](*self._memory(self.now.t, self.now.x))

    def recorded(self) -> Recorded:
        t, values = self.rows.recording.arrays()
        method = told_method(self.settings.method, self.now.memory.stiffness[2])
        counts = (self.steps, self.rejected, self.evaluations, self.instant_count)
        statistics = Statistics(method, self.name, *counts)
        measures, uncovered = self.measures.results(self.now.t if self.has_begun else -math.inf)
        warnings = (*self.instants.foreign.warnings, *uncovered, *self.inside.unseen())
        return Recorded(t, values, tuple(self.events), measures, statistics, warnings)

    def taken(self) -> Array:
        return self.rows.recording.taken()[:-1]

    def abandon(self) -> None:
        pass

    # --- as an island of a master --------------------------------------------------------------------------------

    def hold(self, inputs: Any) -> None:
        """Inputs from now on, in the place of a table and of its segment."""
        self.inputs = self.segment = inputs

    def keep(self) -> Any:
        """All that changes, to go back to."""
        own = {name: copy.copy(getattr(self, name)) for name in _KEPT}
        return own, self.crossed.kept(), self.instants.foreign.keep()

    def go_back(self, kept: Any) -> None:
        own, crossed, hidden = kept
        self.instants.foreign.go_back(hidden)
        for name, value in own.items():
            setattr(self, name, copy.copy(value))
        self.crossed.go_back(crossed)

    def drop(self, kept: Any) -> None:
        """What was kept is not needed any more."""
        self.instants.foreign.drop(kept[2])
