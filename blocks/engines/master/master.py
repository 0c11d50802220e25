"""The master algorithm in plain Python: the meaning of co-simulation for every engine.

At a communication point all outputs are evaluated with the inputs of that point, in the order of their dependencies.
Over a step inputs follow polynomials through past values of what feeds them: extrapolated (jacobi), through the new
value of what was stepped before (gauss-seidel), or through the new values of all, until these do not change any more
(iterated). A unit has communication points of its own grid, and where something that it takes jumps. Times are
t0 + n H, as exact fractions, or what an instant inside a unit or the control of the error makes them.

References: M. Arnold, C. Clauss, T. Schierz, Error analysis and error estimates for co-simulation in FMI for Model
Exchange and Co-Simulation V2.0, 2013; R. Kuebler, W. Schiehlen, Two methods of simulator coupling, 2000.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, final

import numpy as np

from ...compile.coupling import CoupledUnit, Coupling
from ...compile.master_limits import CLOSE, CONVERGED, DEEPEST, JUMPED, MOST_LEARNT, MOST_PASSES, NEAR, ROUGH
from ...compile.master_policy import Policy
from ...compile.plan import Reference
from ...compile.time_grid import within_ulps
from ...text.arrays import Array
from .coupled_run import CoupledRun
from .exchange import Point, course_of
from .growth import Growth, circles
from .step_control import StepControl
from .stepped_units import (
    Course,
    FmuUnit,
    PlanUnit,
    Running,
    acts_later,
    course_at,
    endless,
    endless_stops,
    unconverged,
)


@final
class ReferenceMaster(CoupledRun):
    """A run of a Coupling in plain Python."""

    name = "reference"

    def _clear(self) -> None:
        super()._clear()
        self.control = StepControl()
        self.fresh = 0  # steps since something jumped
        self.set_aside: dict[int, Point] = {}  # past points that closer ones have replaced, by element
        self.waiting: dict[int, list[Course]] = {}  # courses of units that cannot stop where their inputs jumped
        self.growths: dict[int, Growth] = {}  # of the elements that are watched
        self.next = [1] * len(self.plan.units)  # the number of the next point of each unit's grid
        self.inverse: tuple[object, Array] | None = None
        self.ends: list[float] = []  # all elements at the end of the last step, before what happened there
        self.crowd = 0  # how many instants followed each other within some ulp
        self.depth = 0  # how many instants have cut the step under way short
        self.reached: dict[int, float] = {}  # up to where each unit went in the last sweep

    def _unit(self, unit: CoupledUnit) -> Running:
        if unit.plan is not None:
            return PlanUnit(unit, self.plan.seen[self.plan.units.index(unit)], self.tracer)
        with self.open_unit(unit) as loaded:
            return FmuUnit(unit, loaded, self.plan, tracer=self.tracer)

    def _begin(self) -> None:
        self.evaluate(self.t)
        for k, unit in enumerate(self.units):
            values = self._inputs(k, self.t)
            unit.put(range(len(values)), values)
        for unit in self.units:
            unit.finish_start()
        self.policy = Policy.of(self.plan, self._saving)
        self.evaluate(self.t)  # some FMUs compute their outputs only when they leave initialization
        self._instant(is_start=True)
        guessed = circles(self.plan, self._saving)
        self.growths = {g: Growth(number, abs(self.y[g])) for number, elements in guessed for g in elements}

    # --- going on ----------------------------------------------------------------------------------------------

    def proceed(self, stop: Fraction) -> bool:
        end = float(stop)
        with self._ending():
            if self.t < end and self.over is None:
                self._macro(stop, end)
        return self.t >= end or self.over is not None

    def pause(self, every: float, at: float) -> None:
        pass  # a moment is one step

    def _grid(self, k: int) -> Fraction:
        """The next point of a unit's grid."""
        step = self.plan.units[k].step
        begin = self.settings.start
        while float(begin + self.next[k] * step) <= self.at[k]:
            self.next[k] += 1
        return begin + self.next[k] * step

    def _can_stop(self, k: int, t: float) -> bool:
        """Return whether a unit can step to t: one whose steps must not differ stops at the points of its grid only."""
        return not self.plan.units[k].is_rigid or float(self._grid(k)) == t

    def _macro(self, stop: Fraction, end: float) -> None:
        """One step of the master, to the next communication point of any unit, or one try at it."""
        limit: Fraction = stop
        edge = self.inputs.next_break(self.broken)
        if edge < limit and not within_ulps(edge, float(limit)):
            limit = Fraction(edge)
        if self.policy.is_controlled:
            self.control.advance(self, limit)
            return
        target = min(self._grid(k) for k in range(len(self.units)))
        if float(target) >= float(limit):
            target = target if float(target) == float(limit) else limit  # a point of the grid keeps its exact name
            due = [k for k in range(len(self.units)) if self._can_stop(k, float(target))]
        else:
            # Units that may stop on the way go along, so that no unit that reads them is ahead.
            has = [unit.has_instants and not unit.is_rigid for unit in self.plan.units]
            due = [k for k in range(len(self.units)) if has[k] or self._grid(k) == target]
        self.go_to(target, due)

    def go_to(self, target: Fraction, due: Sequence[int]) -> bool:
        """Step units to the target, or all to the first instant inside one of them; whether nothing jumped."""
        t1 = float(target)
        due = [k for k in due if self.at[k] < t1]
        can = [k for k in due if self.units[k].can_save]
        # Deeper, what is crossed moves with each iteration.
        iterates = self.fresh < self.policy.iterated_steps and self.depth < DEEPEST
        has_instants = any(self.plan.units[k].has_instants for k in due)
        saved = {k: self.units[k].save() for k in can} if has_instants or iterates else {}
        old = [list(points) for points in self.past]
        try:
            early = self._sweep(t1, target, due, old)
            if early is None and iterates and can:
                early = self._iterate(t1, target, due, saved, old)
            if early is not None:
                return self._early(early, due, saved, old, iterates=iterates)
        finally:
            for k, state in saved.items():
                self.units[k].forget(state)
        self.past = old
        for k in due:
            self.at[k] = t1
            self.waiting.pop(k, None)
        self.t, self.exact = t1, target
        return self._arrived()

    def _early(
        self,
        early: tuple[int, float],
        due: Sequence[int],
        saved: dict[int, Any],
        old: list[list[Point]],
        *,
        iterates: bool,
    ) -> bool:
        """A unit came to an instant before the target: it, its readers and units that may stop sooner go only there.

        An FMU that stands there stays, where another try would be the same: some lose the instant when they go back.
        """
        first, te = early
        self.past = old
        was_over = self.units[first].over is not None
        if was_over and te <= self.t:  # nothing more is known of it than at the last point
            return True
        self.crowd = self.crowd + 1 if te - self.t <= NEAR * math.ulp(te) else 0
        if self.crowd > MOST_PASSES:
            raise endless_stops(self.plan.units[first], te)
        outputs = self.plan.units[first].outputs
        wanted = {k for g in outputs if self.plan.elements[g].jumps for k in self.plan.readers[g]} | {first}
        wanted |= {k for k, unit in enumerate(self.plan.units) if unit.has_instants}
        wanted |= set(due) if was_over else set()  # all go there
        others = [k for k, unit in enumerate(self.plan.units) if unit.has_instants and k != first]
        is_led = any(row == "y" for row, _ in self.plan.units[first].links)
        is_same = not iterates and not others and not (self.policy.is_sequential and is_led)
        stays = is_same and not was_over and isinstance(self.units[first], FmuUnit)
        for k in due:
            if k == first and stays:
                self.at[k] = te
                self.waiting.pop(k, None)
            elif k in saved:
                self.units[k].restore(saved[k])
            else:  # it cannot go back, and waits where it is
                self.at[k] = self.reached.get(k, self.at[k])
        rest = [k for k in sorted(wanted) if self.at[k] < te and self._can_stop(k, te)]
        if rest:
            self.depth += 1
            try:
                return self.go_to(Fraction(te), rest)
            finally:
                self.depth -= 1
        self.t, self.exact = te, Fraction(te)
        return self._arrived()

    def _sweep(
        self, t1: float, target: Fraction, due: Sequence[int], past: Sequence[list[Point]],
        guess: dict[int, float] | None = None,
    ) -> tuple[int, float] | None:  # fmt: skip
        """Step each unit once; returns the first that stopped early. guess: known exchanged values at t1."""
        order = [k for k in self.plan.order if k in due]
        sequential = self.policy.is_sequential or guess is not None
        view = [list(points) for points in past]
        self.reached = {}
        if guess is not None:
            for g, value in guess.items():
                view[g].append((t1, value))
        courses = {k: self._courses(k, self.at[k], view) for k in order} if not sequential else {}
        courses.update(self.waiting)
        y = list(self.y)
        for k in order:
            given = courses[k] if k in courses else self._courses(k, self.at[k], view)
            reached = self.units[k].step(self.at[k], t1, target, given)
            self.reached[k] = reached
            self.steps += 1
            if reached < t1:
                self.y = y
                return k, reached
            if sequential:
                # Its outputs now, with its inputs at the end of their courses.
                unit = self.plan.units[k]
                needs = sorted({i for feed in unit.feeds for i in feed})
                if needs:
                    self.units[k].put(needs, [course_at(given[i], t1 - self.at[k]) for i in needs])
                values = self.units[k].outputs()
                for g, value in zip(unit.outputs, values, strict=True):
                    if view[g] and view[g][-1][0] == t1:
                        view[g].pop()
                    view[g].append((t1, value))
        self.y = y
        return None

    def _iterate(
        self, t1: float, target: Fraction, due: Sequence[int], saved: dict[int, Any], old: list[list[Point]]
    ) -> tuple[int, float] | None:
        """Step again and again, with inputs through the values at the end, until these do not change."""
        again = [k for k in due if k in saved]
        at = list(self.at)

        def ends() -> dict[int, float]:
            y = list(self.y)
            for k in due:
                self.at[k] = t1
            self.evaluate(t1)
            values = {g: self.y[g] for g in self.plan.exchanged if self.plan.elements[g].unit in due}
            self.y, self.at = y, list(at)
            return values

        guess = ends()
        names = list(guess)
        z = np.array([guess[g] for g in names])
        inverse, before = self._inverse(names, t1 - self.t), None
        for passes in range(self.policy.iterations):
            self.iterations += 1
            for k in again:
                self.units[k].restore(saved[k])
            early = self._sweep(t1, target, again, old, dict(zip(names, z.tolist(), strict=True)))
            if early is not None:
                return early
            new = ends()
            f = np.array([new[g] for g in names]) - z
            if not np.isfinite(f).all():
                break
            size = np.maximum(np.abs(z), np.maximum([abs(self.y[g]) for g in names], 1e-3))
            change = float(np.max(np.abs(f) / size, initial=0.0))
            if change <= CONVERGED or (passes >= 6 and change <= self.policy.noise):
                return None
            if before is not None and inverse is not None:
                _update(inverse, z - before[0], f - before[1])
            before = z, f
            z = z + (f if inverse is None else inverse @ f)
        self.inverse = None
        raise unconverged(self.plan, self.t, t1)

    def _inverse(self, names: list[int], h: float) -> Array | None:
        """What a residual is multiplied by to get the next guess: at first 1, then what Broyden's method has learnt."""
        key = (tuple(names), h)
        if len(names) > MOST_LEARNT:
            return None
        if self.inverse is None or self.inverse[0] != key:
            self.inverse = (key, np.eye(len(names)))
        return self.inverse[1]

    def _arrived(self) -> bool:
        """At a communication point: outputs, instants, rows; whether nothing jumped."""
        t = self.t
        before = [list(points) for points in self.past]
        self.evaluate(t)
        self._watch(before)
        left_values = self.ends = list(self.y)
        left = self._row(self.plan.columns)
        self._measure(0.0)
        return self._instant(left=left, left_values=left_values, before=before)

    def _watch(self, past: Sequence[Sequence[Point]]) -> None:
        """Whether what is exchanged grows without bound. past: before the present point."""
        for g, growth in self.growths.items():
            points = past[g]
            if not points or points[-1][0] >= self.t or self.at[self.plan.elements[g].unit] != self.t:
                continue
            guess = course_of(points, self.policy.order, self.t)[0]
            if growth.grows(self.y[g], guess):
                self._tell_growth(g, growth.circle, self.t)

    # --- instants and rows --------------------------------------------------------------------------------------

    def _instant(
        self,
        *,
        is_start: bool = False,
        left: tuple[float, ...] | None = None,
        left_values: list[float] | None = None,
        before: list[list[Point]] | None = None,
        set_behind: dict[int, list[Course]] | None = None,
    ) -> bool:
        """What happens at t: in all units that stand here, until nothing changes.

        set_behind: where an input was set, the courses that `_behind` gave before.
        """
        t, coupling = self.t, self.plan
        behind = self._behind(before) if set_behind is None else set_behind
        at_break = self._passes_break()
        is_set = at_break or set_behind is not None
        bent, acted = self._act(left_values, before, at_break=is_set)
        here = [g for g, element in enumerate(coupling.elements) if self.at[element.unit] == t]
        moved = set(here) if left_values is None else {g for g in here if self.y[g] != left_values[g]}
        jumps = moved if left_values is None else {g for g in moved if self._has_jumped(g, left_values[g])}
        # Elements that jump, or follow what happened in their unit or an input that jumps, take a new course.
        renewed = jumps | (bent & set(here))
        jumped = {Reference("y", g) for g in jumps}
        for k, coupled in enumerate(coupling.units):
            if self.at[k] == t:
                new = [i for i, link in enumerate(coupled.links) if link in jumped or (is_set and link.row == "u")]
                renewed.update(coupled.following(new))
        self._wait(behind, renewed, jumps, at_break=is_set)
        is_new = is_late = False
        for g in here:
            unit = coupling.elements[g].unit
            is_followed = bool(coupling.readers[g] and not coupling.elements[g].held)
            if g in renewed:
                self.past[g] = [(t, self.y[g])]
                self.set_aside.pop(g, None)
                is_new = is_new or is_followed
            elif self._add_point(g, (CLOSE if unit in acted else ROUGH) * self._length(unit)):
                is_late = is_late or (is_followed and unit in acted)
        self.fresh = 0 if is_new else self.fresh + (not is_late)
        self._record(left, is_start=is_start)
        if moved or is_start or at_break:
            self._measure(1.0)
        return not is_new

    def _has_jumped(self, g: int, before: float) -> bool:
        """Return whether an element, which has another value than before the instant, differs by more than rounding."""
        now, aside = self.y[g], self.set_aside.get(g)
        points = [*self.past[g], *([] if aside is None else [aside])]
        size = max(abs(now), abs(before), *(abs(y) for _, y in points))
        return self.plan.elements[g].held or not abs(now - before) <= JUMPED * size

    def _add_point(self, g: int, apart: float) -> bool:
        """Add the present value to the past points of an element; return whether it replaces the last one.

        It does if it is closer than `apart`: a course through both would be one of their errors. The replaced point is
        set aside, and comes back once a point lies far enough from it: points do not grow old if all are close.
        """
        points, point, aside = self.past[g], (self.t, self.y[g]), self.set_aside.get(g)
        is_close = bool(points) and self.t - points[-1][0] < apart
        if is_close and (aside is None or self.t - aside[0] < apart):
            if points[-1][0] < self.t:
                self.set_aside.setdefault(g, points[-1])
            points[-1] = point
            return True
        if is_close and aside is not None:
            points[-1] = aside
        self.set_aside.pop(g, None)
        points.append(point)
        del points[:-3]
        return False

    def _length(self, k: int) -> float:
        """Return the length of a usual step of a unit."""
        return self.control.h if self.policy.is_controlled else float(self.plan.units[k].step)

    def _behind(self, before: list[list[Point]] | None) -> dict[int, list[Course]]:
        """Return the courses of the units that cannot stop at t, as they are before what happens there."""
        units = self.plan.units
        late = [k for k, at in enumerate(self.at) if at < self.t and units[k].is_rigid and k not in self.waiting]
        return {k: self._courses(k, self.at[k], self.past if before is None else before) for k in late}

    def _wait(self, behind: dict[int, list[Course]], renewed: set[int], jumps: set[int], *, at_break: bool) -> None:
        """Let units that lag behind keep their courses where an input takes a new one; warn of the first jump."""
        for k, courses in behind.items():
            links = self.plan.units[k].links
            read = {place for row, place in links if row == "y"}
            is_driven = at_break and self.plan.units[k].reads_inputs
            if is_driven or read & renewed:
                self.waiting[k] = courses
            if k not in self.late and (is_driven or read & jumps):
                self.late[k] = acts_later(self.plan.units[k], self.t)

    def _passes_break(self) -> bool:
        """Whether an input jumps or bends at t, from where on its next piece counts."""
        t, at_break = self.t, False
        while (edge := self.inputs.next_break(self.broken)) <= t or within_ulps(edge, t):
            self.broken, at_break = edge, True
            self.segment = self.inputs.segment(max(t, edge))
            self.evaluate(t)
        return at_break

    def _act(
        self, left_values: list[float] | None, before: list[list[Point]] | None, *, at_break: bool
    ) -> tuple[set[int], set[int]]:  # fmt: skip
        """Let instants happen in the units that stand at t, until nothing changes.

        at_break: inputs of the diagram jump or bend. Return the elements that bend, and the units where something
        happened.
        """
        t, coupling = self.t, self.plan
        has = [unit.has_instants for unit in coupling.units]
        acting = [k for k, unit in enumerate(coupling.units) if self.at[k] == t and unit.acts]
        acted: set[int] = set()
        arrived = set(acting)
        for k in acting:
            self.units[k].take(self._inputs(k, t))
            self.units[k].arrive(at_break=at_break)
        passes = 0
        while acting:
            if passes == MOST_PASSES:
                raise endless(coupling, acting, t)
            known = list(self.y)
            self.instants += self._in_turn(acting, acted, is_due=not passes)
            passes += 1
            self.evaluate(t)
            changed = [g for g, (a, b) in enumerate(zip(known, self.y, strict=True)) if a != b]
            jumped = {g for g in changed if self._has_jumped(g, known[g])}
            # An FMU would take a change by rounding for an event. Blocks go on from the values that they have here.
            readers = {k for g in changed for k in coupling.readers[g] if g in jumped or coupling.units[k].plan}
            # A unit that reads a jump and lags behind comes here with its old inputs.
            late = {k for k in readers if self.at[k] < t and not coupling.units[k].is_rigid}
            if late and left_values is not None and before is not None:
                self._catch_up(late, left_values, before, at_break=at_break)
                arrived |= {k for k in late if coupling.units[k].acts}
            acting = sorted(k for k in readers if self.at[k] == t and has[k])
        return {coupling.units[k].outputs[n] for k in arrived for n in self.units[k].bent(k in acted)}, acted

    def _in_turn(self, acting: Sequence[int], acted: set[int], *, is_due: bool) -> bool:
        """Let units act at t, one after the other in the order of wires. Return whether something happened.

        So a unit that ticks at t sees the new values of those before it. acted: gets the units in which something
        happened.
        """
        coupling, t, is_any = self.plan, self.t, False
        several = sum(coupling.units[k].has_instants for k in acting) > 1
        for k in sorted(acting, key=coupling.at_instants.index):
            self.units[k].take(self._inputs(k, t))
            if self.units[k].instant(is_due=is_due):
                is_any = True
                acted.add(k)
            if several and k in acted:
                self.evaluate(t)
        return is_any

    def _catch_up(
        self, late: set[int], left_values: list[float], before: list[list[Point]], *, at_break: bool
    ) -> None:  # fmt: skip
        """Step units that lag behind to t, with inputs as they were left of it."""
        t = self.t
        y, self.y = self.y, list(left_values)
        for k in sorted(late):
            self.units[k].step(self.at[k], t, Fraction(t), self._courses(k, self.at[k], before))
        for k in late:
            self.units[k].arrive(at_break=at_break)
            self.at[k] = t
        self.y = y
        self.evaluate(t)

    def _record(self, left: tuple[float, ...] | None, *, is_start: bool) -> None:
        t, right = self.t, self._row(self.plan.columns)
        every = self.settings.every
        on_grid = every is None
        end = self.end if self.over is None else t
        if every is not None and self.exact is not None:
            on_grid = ((self.exact - self.settings.start) / every).denominator == 1
        last = self.recording.last[0]
        if not self.settings.records_jumps:
            if t == last:
                self.recording.replace_last(right)
            elif on_grid or t == end:
                self.recording.add(t, right)
        elif left is not None and left != right:
            if t != last:
                self.recording.add(t, left)
            self.recording.add(t, right)
        elif (on_grid or t == end) and t != last:
            self.recording.add(t, right)

    # --- going back ---------------------------------------------------------------------------------------------

    def kept(self) -> dict[str, Any]:
        """All that a step changes, to go back to; it is dropped when it is not needed any more."""
        names = "t exact at next y past set_aside segment broken fresh instants"
        return {
            **{name: copy.deepcopy(getattr(self, name)) for name in names.split()},
            "rows": self.recording.rows,
            "points": len(self.points),
            "saved": [unit.save() for unit in self.units],
        }

    def go_back(self, kept: dict[str, Any]) -> None:
        for name, value in kept.items():
            if name not in ("rows", "points", "saved"):
                setattr(self, name, copy.deepcopy(value))
        self.recording.rows = kept["rows"]
        del self.points[kept["points"] :]
        for unit, saved in zip(self.units, kept["saved"], strict=True):
            unit.restore(saved)

    def drop(self, kept: dict[str, Any]) -> None:
        for unit, saved in zip(self.units, kept["saved"], strict=True):
            unit.forget(saved)

    # --- from outside ------------------------------------------------------------------------------------------

    def set_input(self, index: int, value: Array) -> None:
        left, values, behind = self._row(self.plan.columns), list(self.y), self._behind(None)
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.t)
        with self._ending():
            self.evaluate(self.t)
            self._instant(left=left, left_values=values, before=[list(p) for p in self.past], set_behind=behind)

    def set_parameters(self, coupling: Coupling) -> None:
        left, values = self._row(self.plan.columns), list(self.y)
        with self._ending():
            self._put_parameters(coupling)
            self.evaluate(self.t)
            self._instant(left=left, left_values=values, before=[list(p) for p in self.past])


def _update(inverse: Array, dz: Array, df: Array) -> None:
    """Broyden's update: the inverse then maps the change of the residual to minus the change of the guess."""
    predicted = inverse @ df
    scale = float(dz @ predicted)
    if abs(scale) > 1e-30 and np.isfinite(predicted).all():
        inverse += np.outer((-dz - predicted) / scale, dz @ inverse)
