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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.coupling import Coupling, Get, Link, Loop, Unit
from ...compile.plan import Reference
from ...fmi.instance import Ended, Loaded
from ...fmi.patience import patient, undisturbed
from ...results.results import Event, Statistics
from ...text.errors import BlocksError, Fault, SimulationError, UsageError
from ..run.engine import Recorded
from ..run.inputs import InputTable
from ..run.measures import Measures
from ..run.recording import Recording
from ..run.saved_state import State
from ..run.time_grid import within_ulps
from .growth import Growth, circles, warning
from .islands import (
    NEAR,
    Course,
    FmuUnit,
    PlanUnit,
    Running,
    course_at,
    not_finite,
    tolerance_of,
    too_short,
    unconverged,
)
from .measured import measured

__all__ = ["MOST_LEARNT", "ReferenceMaster", "Row", "course_of"]

Array = np.ndarray[Any, Any]
Row = tuple[float, ...]
Point = tuple[float, float]
MOST_PASSES = 100
CONVERGED = 1e-10
"""Where an iterated step ends: the change of all that is exchanged, as a part of its size; or where the solvers of
units, by the largest of their tolerances, say no more."""
ROUNDING = 1e-13
DEEPEST = 3
"""So often a step is iterated that instants inside of it cut short."""
MOST_LEARNT = 300
"""Up to so many exchanged elements an iterated step learns how they depend on each other."""
_SAFETY, _LEAST, _MOST = 0.9, 0.2, 5.0
LEAST, LEAST_OF_STEP, MOST_SMALL = 1e-12, 1e-6, 100
"""So many steps in a row that are shorter than these parts of the run and of its first step: it would not end."""


def course_of(points: Sequence[Point], order: int, t: float) -> Course:
    """The polynomial through the last order + 1 points: its value and derivatives at t."""
    if len(points) == 1 or order == 0:
        return points[-1][1], 0.0, 0.0
    (t0, y0), (t1, y1) = points[-1], points[-2]
    slope = (y0 - y1) / (t0 - t1)
    if len(points) == 2 or order == 1:
        return y0 + (t - t0) * slope, slope, 0.0
    t2, y2 = points[-3]
    curve = (slope - (y1 - y2) / (t1 - t2)) / (t0 - t2)
    return y0 + (t - t0) * (slope + (t - t1) * curve), slope + (2 * t - t0 - t1) * curve, 2 * curve


class ReferenceMaster:
    """One run of a Coupling under way, as `engines.run.engine.Engine` has it.

    open_unit: gives the loaded FMU of a unit.
    """

    name = "reference"

    def __init__(self, coupling: Coupling, inputs: InputTable, open_unit: Callable[[Any], Loaded]) -> None:
        self.plan, self.settings, self.inputs = coupling, coupling.settings, inputs
        self.master = coupling.settings.master
        self.open_unit = open_unit
        self.units: list[Running] = []
        self._clear()

    def _clear(self) -> None:
        """Nothing has run yet."""
        settings, coupling = self.settings, self.plan
        self.recording = Recording(len(coupling.columns))
        self.measured = [*Measures(coupling).references]  # type: ignore[arg-type]
        self.points: list[Row] = []  # t, 1 where something jumped there, and what is measured
        self.has_failed = False
        self.told_over: Fault | None = None
        self.steps = self.rejected = self.instants = self.iterations = 0
        self.exact: Fraction | None = settings.start
        self.t = float(settings.start)
        n = len(coupling.units)
        self.at = [self.t] * n
        self.unsure = [k for k, unit in enumerate(coupling.units) if unit.is_assumed]
        self.next = [1] * n  # the number of the next point of each unit's grid
        self.y = [0.0] * len(coupling.elements)
        self.past: list[list[Point]] = [[] for _ in coupling.elements]
        self.segment = self.inputs.segment(self.t)
        self.broken = self.t
        self.h = 0.0  # the next step, where steps are controlled; 0: none yet
        self.small, self.worst = 0, 0  # so many short steps in a row, and the element that asks for them
        self.fresh = 0  # so many steps since something jumped
        self.inverse: tuple[Any, Array] | None = None
        own = (tolerance_of(unit, settings) for unit in coupling.units if unit.foreign is not None)
        self.solved_to = max(settings.rtol, *(value or 0.0 for value in own), 0.0)  # the largest tolerance of a unit
        self.ends: list[float] = []  # all elements at the end of the last step, before what happened there
        self.crowd = 0  # how many instants followed each other within some ulp
        self.depth = 0  # how many instants have cut the step under way short
        self.reached: dict[int, float] = {}  # up to where each unit went in the last sweep
        self.end = math.nan if settings.stop is None else float(settings.stop)
        self.growths: dict[int, Growth] = {}  # of the elements that are watched
        self.grown: dict[int, Fault] = {}  # what is told of them, by circles

    def start(self) -> None:
        self.close()
        self._clear()
        for unit in self.plan.units:
            self.units.append(self._unit(unit))
        with self._ending():
            self._initialize()

    def go_on_from(self, state: State) -> None:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be resumed."
        raise UsageError(Fault("E506", self.plan.name, message, "Begin it anew."))

    def _unit(self, unit: Unit) -> Running:
        if unit.plan is not None:
            return PlanUnit(unit)
        with self.open_unit(unit) as loaded:
            return FmuUnit(unit, loaded, self.settings)

    def close(self) -> None:
        """Free all FMUs."""
        with undisturbed():
            for unit in self.units:
                unit.close()
            self.units = []

    # --- values ------------------------------------------------------------------------------------------------

    def value_of(self, link: Link, t: float) -> float:
        """What a link gives at t, as the units see it."""
        place: int = link.index
        if link.row == "y":
            known = self.past[place]
            if not known or self.at[self.plan.elements[place].unit] == t or self.plan.elements[place].held:
                return self.y[place]
            return course_of(known, self.master.order, t)[0]
        return float(place) if link.row == "k" else self.segment.at(t)[place]

    def evaluate(self, t: float) -> None:
        """All outputs of the units that stand at t, with the inputs as they are at t."""
        for stage in self.plan.stages:
            if isinstance(stage, Loop):
                here = [get for get in stage.gets if self.at[get.unit] == t]
                if len(here) == len(stage.gets):
                    self._solve(stage, t)
                else:  # the others lag behind: what they give is known
                    for get in here:
                        self._get(get, t)
            elif self.at[stage.unit] == t:
                self._get(stage, t)

        for k in self.unsure:  # their outputs follow inputs that were not known yet
            if self.at[k] == t:
                values = self._inputs(k, t)
                self.units[k].put(range(len(values)), values)
                for g, value in zip(self.plan.units[k].outputs, self.units[k].outputs(), strict=True):
                    self.y[g] = value

    def _get(self, get: Get, t: float) -> None:
        unit, links = self.units[get.unit], self.plan.units[get.unit].links
        if get.inputs:
            unit.put(get.inputs, [self.value_of(links[i], t) for i in get.inputs])
        values = unit.outputs()
        for g in get.elements:
            self.y[g] = values[self.plan.elements[g].index]

    def _solve(self, loop: Loop, t: float) -> None:
        """An algebraic loop across units by Newton's method, with differences. Raises SimulationError (E307)."""
        ours = list(loop.elements)

        def residual(guess: Array) -> Array:
            for g, value in zip(ours, guess.tolist(), strict=True):
                self.y[g] = value
            for get in loop.gets:
                links = self.plan.units[get.unit].links
                self.units[get.unit].put(get.inputs, [self.value_of(links[i], t) for i in get.inputs])
            made = []
            for get in loop.gets:
                values = self.units[get.unit].outputs()
                made += [(g, values[self.plan.elements[g].index]) for g in get.elements]
            found = dict(made)
            return np.array([found[g] for g in ours]) - guess

        guess = np.array([self.y[g] for g in ours])
        best = math.inf
        for _ in range(50):
            r = residual(guess)
            if not np.isfinite(r).all():
                break
            # Values near 0 may be differences of large ones: what counts is the largest of the loop.
            size = float(np.max(np.abs(guess) + np.abs(r))) + 1e-300
            off = float(np.max(np.abs(r))) / size
            if off <= 1e-15 or (off <= 1e-10 and off > best / 2):  # rounding decides from here on
                self.y = [*self.y]
                for g, value in zip(ours, guess.tolist(), strict=True):
                    self.y[g] = value
                return
            best = min(best, off)
            matrix = np.empty((len(ours), len(ours)))
            for j in range(len(ours)):
                delta = 1e-7 * max(abs(guess[j]), 1e-3)
                moved = guess.copy()
                moved[j] += delta
                matrix[:, j] = (residual(moved) - r) / delta
            try:
                guess = guess + np.linalg.solve(matrix, -r)
            except np.linalg.LinAlgError:
                break
        name = self.plan.elements[ours[0]].name
        message = f"no values were found at t = {t} s that close the loop through it."
        raise SimulationError(Fault("E307", name, message, "Start nearer to a solution, or put a UnitDelay into it."))

    def _inputs(self, k: int, t: float) -> list[float]:
        """All inputs of a unit at t."""
        return [self.value_of(link, t) for link in self.plan.units[k].links]

    # --- start -------------------------------------------------------------------------------------------------

    def _initialize(self) -> None:
        """Initialization of all units, and the instant at the start."""
        stop = None if math.isnan(self.end) else self.end
        for unit in self.units:
            unit.start(self.t, stop)
        self.evaluate(self.t)
        for k, unit in enumerate(self.units):
            values = self._inputs(k, self.t)
            unit.put(range(len(values)), values)
        for unit in self.units:
            unit.finish_start()
        self.evaluate(self.t)  # some FMUs compute their outputs only when they leave initialization
        self._instant(is_start=True)
        found = circles(self.plan, self._saving)
        self.growths = {g: Growth(number, abs(self.y[g])) for number, elements in found for g in elements}

    # --- going on ----------------------------------------------------------------------------------------------

    def proceed(self, stop: Fraction) -> bool:
        end = float(stop)
        with self._ending():
            if self.t < end and self.over is None:
                self._macro(stop, end)
        return self.t >= end or self.over is not None

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        return patient()

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """An FMU inside a unit may end the run."""
        if self.has_failed:
            raise UsageError(Fault("E501", self.plan.name, "the run has failed and cannot go on.", "Begin anew."))
        try:
            yield
        except Ended as error:
            self.told_over = error.faults[0]

    @property
    def recorded_bytes(self) -> float:
        """Bytes of what is recorded, and of what is kept for the measures."""
        return self.recording.bytes + 8.0 * len(self.points) * (2 + len(self.measured))

    @property
    def over(self) -> Fault | None:
        return self.told_over or next((unit.over for unit in self.units if unit.over is not None), None)

    def _grid(self, k: int) -> Fraction:
        """The next point of a unit's grid."""
        step = self.plan.units[k].step
        begin = self.settings.start
        while float(begin + self.next[k] * step) <= self.at[k]:
            self.next[k] += 1
        return begin + self.next[k] * step

    def _macro(self, stop: Fraction, end: float) -> None:
        """One step of the master, to the next communication point of any unit, or one try at it."""
        limit: Fraction = stop
        edge = self.inputs.next_break(self.broken)
        if edge < limit and not within_ulps(edge, float(limit)):
            limit = Fraction(edge)
        if self.master.tolerance is not None:
            self._controlled(limit)
            return
        target = min(self._grid(k) for k in range(len(self.units)))
        if float(target) >= float(limit):
            target = target if float(target) == float(limit) else limit  # a point of the grid keeps its exact name
            due = list(range(len(self.units)))
        else:
            # What may stop on the way goes along, so that nobody who hears of it is ahead.
            has = [unit.has_instants for unit in self.plan.units]
            due = [k for k in range(len(self.units)) if has[k] or self._grid(k) == target]
        self._to(target, due)

    def _to(self, target: Fraction, due: Sequence[int]) -> bool:
        """Step units to the target, or all to the first instant inside one of them; whether nothing jumped."""
        t1 = float(target)
        due = [k for k in due if self.at[k] < t1]
        can = [k for k in due if self.units[k].can_save]
        iterates = self.master.algorithm == "iterated" or (self.fresh < self.master.order and self.master.order == 2)
        iterates = iterates and self.depth < DEEPEST  # what is crossed moves with each iteration
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
            for k, one in saved.items():
                self.units[k].forget(one)
        self.past = old
        for k in due:
            self.at[k] = t1
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
        """A unit came to an instant before the target: it, what hears of it, and what may stop sooner go there only.

        An FMU that stands there stays, where another try would be the same: some lose the instant when they go back.
        """
        first, te = early
        self.past = old
        was_over = self.units[first].over is not None
        if was_over and te <= self.t:  # nothing more is known of it than at the last point
            return True
        self.crowd = self.crowd + 1 if te - self.t <= NEAR * math.ulp(te) else 0
        if self.crowd > MOST_PASSES:
            message = f"it stops again and again at t = {te} s, for what it takes moves with each step."
            cure = "Use order 1 or 2, so that it is known what its inputs come to."
            raise SimulationError(Fault("E305", self.plan.units[first].place, message, cure))
        outputs = self.plan.units[first].outputs
        wanted = {k for g in outputs if self.plan.elements[g].jumps for k in self.plan.readers[g]} | {first}
        wanted |= {k for k, unit in enumerate(self.plan.units) if unit.has_instants}
        wanted |= set(due) if was_over else set()  # all go there
        others = [k for k, unit in enumerate(self.plan.units) if unit.has_instants and k != first]
        is_led = any(row == "y" for row, _ in self.plan.units[first].links)
        is_same = not iterates and not others and (self.master.algorithm == "jacobi" or not is_led)
        stays = is_same and not was_over and isinstance(self.units[first], FmuUnit)
        for k in due:
            if k == first and stays:
                self.at[k] = te
            elif k in saved:
                self.units[k].restore(saved[k])
            else:  # it cannot go back, and waits where it is
                self.at[k] = self.reached.get(k, self.at[k])
        rest = [k for k in sorted(wanted) if self.at[k] < te]
        if rest:
            self.depth += 1
            try:
                return self._to(Fraction(te), rest)
            finally:
                self.depth -= 1
        self.t, self.exact = te, Fraction(te)
        return self._arrived()

    def _courses(self, k: int, t: float, past: Sequence[Sequence[Point]]) -> list[Course]:
        """How the inputs of a unit go from t on."""
        unit = self.plan.units[k]
        made: list[Course] = []
        for (row, place), moves in zip(unit.links, unit.continuous, strict=True):
            if row == "k":
                made.append((float(place), 0.0, 0.0))
            elif row == "u":
                made.append(self._course_of_input(place, t) if moves else (self.segment.at(t)[place], 0.0, 0.0))
            elif not moves or self.plan.elements[place].held:
                made.append((self.y[place], 0.0, 0.0))
            else:
                made.append(course_of(past[place], self.master.order, t))
        return made

    def _course_of_input(self, place: int, t: float) -> Course:
        segment = self.segment
        if segment.constant or segment.base[place] == segment.aim[place]:
            return segment.at(t)[place], 0.0, 0.0
        slope = (segment.aim[place] - segment.base[place]) / (segment.end[place] - segment.begin[place])
        return segment.at(t)[place], slope, 0.0

    def _sweep(
        self, t1: float, target: Fraction, due: Sequence[int], past: Sequence[list[Point]],
        guess: dict[int, float] | None = None,
    ) -> tuple[int, float] | None:  # fmt: skip
        """Step each unit once. guess: what is exchanged at t1, as it is known. The first that stopped early."""
        order = [k for k in self.plan.order if k in due]
        sequential = self.master.algorithm != "jacobi" or guess is not None
        view = [list(points) for points in past]
        self.reached = {}
        if guess is not None:
            for g, value in guess.items():
                view[g].append((t1, value))
        courses = {k: self._courses(k, self.at[k], view) for k in order} if not sequential else {}
        y = list(self.y)
        for k in order:
            given = courses[k] if not sequential else self._courses(k, self.at[k], view)
            reached = self.units[k].step(self.at[k], t1, target, given)
            self.reached[k] = reached.t
            self.steps += 1
            if reached.t < t1:
                self.y = y
                return k, reached.t
            if sequential:
                # What it gives now, with what its inputs come to on their courses.
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
        exchanged = [g for g, readers in enumerate(self.plan.readers) if readers]
        at = list(self.at)

        def ends() -> dict[int, float]:
            y = list(self.y)
            for k in due:
                self.at[k] = t1
            self.evaluate(t1)
            made = {g: self.y[g] for g in exchanged if self.plan.elements[g].unit in due}
            self.y, self.at = y, list(at)
            return made

        guess = ends()
        names = list(guess)
        z = np.array([guess[g] for g in names])
        inverse, before = self._inverse(names, t1 - self.t), None
        for passes in range(self.master.iterations):
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
            if change <= CONVERGED or (passes >= 6 and change <= 10 * self.solved_to):
                return None
            if before is not None and inverse is not None:
                _update(inverse, z - before[0], f - before[1])
            before = z, f
            z = z + (f if inverse is None else inverse @ f)
        self.inverse = None
        raise unconverged(self.plan.name, self.t, t1, self.master)

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
            guess = course_of(points, self.master.order, self.t)[0]
            if growth.grows(self.y[g], guess):
                self._tell_growth(g, growth.circle, self.t)

    def _tell_growth(self, element: int, circle: int, t: float) -> None:
        if circle not in self.grown:
            self.grown[circle] = warning(self.plan, self._saving, element, t)

    @property
    def _saving(self) -> list[bool]:
        return [unit.can_save for unit in self.units]

    def _measure(self, kind: float) -> None:
        if self.measured:
            self.points.append((self.t, kind, *self._row(self.measured)))

    def _row(self, links: Sequence[Any]) -> tuple[float, ...]:
        values = tuple(self.value_of(link, self.t) for link in links)
        for link, value in zip(links, values, strict=True):
            if not math.isfinite(value):
                raise not_finite(self.plan, link, value, self.t)
        return values

    def _instant(
        self,
        *,
        is_start: bool = False,
        left: tuple[float, ...] | None = None,
        left_values: list[float] | None = None,
        before: list[list[Point]] | None = None,
    ) -> bool:
        """What happens at t: in all units that stand here, until nothing changes."""
        t, coupling = self.t, self.plan
        at_break = False
        while (edge := self.inputs.next_break(self.broken)) <= t or within_ulps(edge, t):
            self.broken, at_break = edge, True
            self.segment = self.inputs.segment(max(t, edge))
            self.evaluate(t)
        has = [unit.has_instants for unit in coupling.units]
        acting = [k for k, unit in enumerate(coupling.units) if self.at[k] == t and (has[k] or unit.plan is not None)]
        bent: set[int] = set()
        passes = 0
        while acting:
            if passes == MOST_PASSES:
                names = ", ".join(coupling.units[k].place for k in acting[:3])
                message = f"at t = {t} s instants in {names} cause each other without end."
                raise SimulationError(Fault("E305", coupling.name, message, "Put a delay between them."))
            known = list(self.y)
            several = sum(has[k] for k in acting) > 1
            # One after the other: what ticks at t sees what others that tick at t have come to, in the order of wires.
            is_any = False
            for k in sorted(acting, key=coupling.at_instants.index):
                self.units[k].take(self._inputs(k, t))
                if self.units[k].instant(is_due=not passes):
                    is_any = True
                    bent.add(k)
                if several and k in bent:
                    self.evaluate(t)
            self.instants += is_any
            passes += 1
            self.evaluate(t)
            changed = [g for g, (a, b) in enumerate(zip(known, self.y, strict=True)) if a != b]
            # What hears of a jump and lags behind comes here with its old inputs.
            late = {k for g in changed for k in coupling.readers[g] if self.at[k] < t}
            if late and left_values is not None and before is not None:
                y, self.y = self.y, list(left_values)
                for k in sorted(late):
                    self.units[k].step(self.at[k], t, Fraction(t), self._courses(k, self.at[k], before))
                self.y = y
                for k in late:
                    self.at[k] = t
                self.evaluate(t)
            hearing = {k for g in changed for k in coupling.readers[g] if self.at[k] == t}
            acting = sorted(k for k in hearing if has[k])
        here = [g for g, element in enumerate(coupling.elements) if self.at[element.unit] == t]
        jumps = set(here) if left_values is None else {g for g in here if self.y[g] != left_values[g]}
        jumped = bool(jumps)
        # What jumps, and what comes out of units where something happened or that hear of a jump, goes on otherwise.
        bent |= {k for g in jumps for k in coupling.readers[g]}
        if at_break:
            bent |= {k for k, unit in enumerate(coupling.units) if any(row == "u" for row, _ in unit.links)}
        is_new = False
        for g in here:
            points = self.past[g]
            if g in jumps or coupling.elements[g].unit in bent:
                self.past[g] = [(t, self.y[g])]
                is_new = is_new or bool(coupling.readers[g])
            elif not points or points[-1][0] < t:
                points.append((t, self.y[g]))
                del points[:-3]
        self.fresh = 0 if is_new else self.fresh + 1
        self._record(left, is_start=is_start)
        if jumped or is_start or at_break:
            self._measure(1.0)
        return not is_new

    def _record(self, left: tuple[float, ...] | None, *, is_start: bool) -> None:
        t, right = self.t, self._row(self.plan.columns)
        every = self.settings.every
        on_grid = every is None
        if self.over is not None:
            self.end = t
        if every is not None and self.exact is not None:
            on_grid = ((self.exact - self.settings.start) / every).denominator == 1
        last = self.recording.last[0]
        if not self.settings.records_jumps:
            if t == last:
                self.recording.replace_last(right)
            elif on_grid or t == self.end:
                self.recording.add(t, right)
        elif left is not None and left != right:
            if t != last:
                self.recording.add(t, left)
            self.recording.add(t, right)
        elif (on_grid or t == self.end) and t != last:
            self.recording.add(t, right)

    # --- control of the error ----------------------------------------------------------------------------------

    def _controlled(self, limit: Fraction) -> None:
        """One try at a step whose error is estimated: against two half steps, or by what was predicted of the outputs.

        The errors of all steps of the run shall come to the tolerance, so that a step has its share of it by its
        length; what is predicted wrongly is an error of the inputs at all times, and is held to the tolerance itself.
        """
        every, tolerance, k = self.settings.every, self.master.tolerance, self.master.order
        assert tolerance is not None
        if every is not None:
            row = self.settings.start + (math.floor((Fraction(self.t) - self.settings.start) / every) + 1) * every
            if float(row) <= self.t:
                row += every
            limit = min(limit, row)
        left = float(limit) - self.t
        everyone = list(range(len(self.units)))
        doubled = all(unit.can_save for unit in self.units)
        if self.h <= 0:
            self.h = min(self._begin_step(doubled=doubled), left)
        ratio = self.settings.atol / self.settings.rtol
        span = 1.0 if math.isnan(self.end) else self.end - float(self.settings.start)
        least = min(LEAST * span, LEAST_OF_STEP * float(min(unit.step for unit in self.plan.units)))
        ours = [g for g, element in enumerate(self.plan.elements) if not element.held]
        order = min(k, self.fresh)  # after a jump inputs are held at first
        whole = self.h >= left / 1.01
        target = limit if whole else Fraction(self.t + self.h)
        h = float(target) - self.t
        if h >= least:
            self.small = 0
        elif not whole:
            self.small += 1
        if h <= 16 * math.ulp(self.t) or self.small > MOST_SMALL:
            raise too_short(self.plan, self.worst, self.t, h, tolerance)
        begin, error = self.t, 0.0
        if doubled:
            kept = self._keep()
            try:
                self._to(target, everyone)
                if self.over is not None and self.t <= begin:
                    return
                if self.t < float(target):  # something happens before: up to there, all units
                    whole, target = False, Fraction(self.t)
                    self._back(kept)
                    self._to(target, everyone)
                big, t1 = self.ends, self.t
                h = t1 - begin
                middle = begin + h / 2
                if begin < middle < t1:
                    self._back(kept)
                    self._to(Fraction(middle), everyone)
                    if self.t == middle and self.over is None:
                        self._to(target, everyone)
                        off = {g: abs(big[g] - self.ends[g]) - ROUNDING * abs(big[g]) for g in ours}
                        sizes = {g: tolerance * (ratio + abs(self.ends[g])) for g in ours}
                        error = self._largest({g: max(off[g], 0.0) / sizes[g] for g in ours})
                        error *= span / h / (2 ** (order + 1) - 1)
                    if not error <= 1.0:
                        self._back(kept)
                        self.rejected += 1
                        shrunk = _SAFETY * error ** (-1 / (order + 1)) if math.isfinite(error) else _LEAST
                        self.h = h * max(_LEAST, shrunk)
                        return  # to be tried again, when the caller has looked up
            finally:
                self._drop(kept)
        else:
            t1 = float(target)
            predicted = {g: course_of(self.past[g], k, t1)[0] for g in ours if self.past[g]}
            self._to(target, everyone)
            sizes = {g: tolerance * (ratio + abs(self.ends[g])) for g in predicted}
            error = self._largest({g: abs(predicted[g] - self.ends[g]) / sizes[g] for g in predicted})
            error = error if order == k and self.t == t1 else max(error, 1.0)
        factor = min(_MOST, max(_LEAST, _SAFETY * max(error, 1e-10) ** (-1 / (order + 1))))
        proposed = h * factor
        self.h = max(proposed, self.h) if whole and factor >= 1 else proposed
        if not self.fresh:  # begun anew
            self.h = min(self.h, self._begin_step(doubled=doubled))

    def _largest(self, errors: Mapping[int, float]) -> float:
        """The largest of errors by element, and which it is of."""
        if not errors:
            return 0.0
        self.worst = max(errors, key=lambda g: math.inf if math.isnan(errors[g]) else errors[g])
        return errors[self.worst]

    def _begin_step(self, *, doubled: bool) -> float:
        """The step to begin with, and after a jump; a short one where its error cannot be estimated."""
        shortest = float(min(unit.step for unit in self.plan.units))
        return shortest if doubled else shortest * math.sqrt(self.master.tolerance or 1.0) / 10

    def _keep(self) -> dict[str, Any]:
        names = ("t", "exact", "at", "next", "y", "segment", "broken", "fresh", "instants")
        return {
            **{name: copy.copy(getattr(self, name)) for name in names},
            "past": [list(points) for points in self.past],
            "rows": self.recording.rows,
            "points": len(self.points),
            "saved": [unit.save() for unit in self.units],
        }

    def _back(self, kept: dict[str, Any]) -> None:
        for name, value in kept.items():
            if name not in ("past", "rows", "points", "saved"):
                setattr(self, name, copy.copy(value))
        self.past = [list(points) for points in kept["past"]]
        self.recording.rows = kept["rows"]
        del self.points[kept["points"] :]
        for unit, saved in zip(self.units, kept["saved"], strict=True):
            unit.restore(saved)

    def _drop(self, kept: dict[str, Any]) -> None:
        for unit, saved in zip(self.units, kept["saved"], strict=True):
            unit.forget(saved)

    # --- from outside ------------------------------------------------------------------------------------------

    def set_input(self, index: int, value: Array) -> None:
        left, values = self._row(self.plan.columns), list(self.y)
        self.inputs = self.inputs.replaced(index, value)
        self.segment = self.inputs.segment(self.t)
        with self._ending():
            self.evaluate(self.t)
            self._instant(left=left, left_values=values, before=[list(p) for p in self.past])

    def set_parameters(self, coupling: Coupling) -> None:
        left, values = self._row(self.plan.columns), list(self.y)
        with self._ending():
            self._put_parameters(coupling)
            self.evaluate(self.t)
            self._instant(left=left, left_values=values, before=[list(p) for p in self.past])

    def _put_parameters(self, coupling: Coupling) -> None:
        for running, new in zip(self.units, coupling.units, strict=True):
            running.take_parameters(new)
        self.plan = coupling

    def snapshot(self, overrides: Mapping[str, Any]) -> State:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be saved."
        raise UsageError(Fault("E506", self.plan.name, message, "Run it in one go."))

    def values(self, references: tuple[Reference, ...]) -> tuple[float, ...]:
        for row, place in references:
            if row == "source":
                name = f"{self.plan.flat.blocks[place[1]].path}.{place[2]}"
                raise UsageError(Fault("E502", name, "is neither recorded nor exchanged.", "Name it in log."))
        return tuple(self.value_of(reference, self.t) for reference in references)

    def _told(self) -> str:
        """The algorithm in words."""
        master, units = self.master, self.plan.units
        steps = f"every {float(min(unit.step for unit in units)):g} s"
        control = steps if master.tolerance is None else f"tolerance {master.tolerance:g}"
        return f"{master.algorithm}, order {master.order}, {control}"

    def _rows(self) -> tuple[Array, Array]:
        return self.recording.arrays()

    def _points(self) -> Array:
        return np.array(self.points)

    def recorded(self) -> Recorded:
        t, values = self._rows()
        statistics = Statistics(self._told(), self.name, self.steps, self.rejected, 0, self.instants)
        events: list[Event] = sorted((e for unit in self.units for e in unit.events()), key=lambda event: event.t)
        measures, uncovered = measured(self.plan, self._points())
        warnings = (*(told for unit in self.units for told in unit.warnings()), *self.grown.values(), *uncovered)
        return Recorded(t, values, tuple(events), measures, statistics, warnings)

    def abandon(self) -> None:
        self.has_failed = True
        self.close()

    def __del__(self) -> None:
        with suppress(BlocksError):
            self.close()


def _update(inverse: Array, dz: Array, df: Array) -> None:
    """Broyden's update: what the inverse makes of the change of the residual is the change of the guess."""
    made = inverse @ df
    scale = float(dz @ made)
    if abs(scale) > 1e-30 and np.isfinite(made).all():
        inverse += np.outer((-dz - made) / scale, dz @ inverse)
