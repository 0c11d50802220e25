"""A run of a Coupling up to its first step, its instants, its records, and the answers to what is asked of it.

How it goes on from there is left to two masters: `master` in plain Python, and `native_master` in compiled code.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.coupling import CoupledUnit, Coupling
from ...compile.inputs import InputTable
from ...compile.plan import Reference
from ...compile.time_grid import within_ulps
from ...fmi.exits import Ended
from ...fmi.loading import Loaded
from ...fmi.patience import patient, undisturbed
from ...results.results import Event, Statistics
from ...text.arrays import Array
from ...text.errors import BlocksError, Fault, UsageError
from ..run.engine import Recorded, ended_by
from ..run.measures import Measures
from ..run.recording import Recording
from ..run.saved_state import State
from .exchange import Exchange, Point
from .growth import Growth, circles, warning
from .limits import CLOSE, JUMPED, MOST_PASSES, ROUGH
from .master_measures import measured
from .policy import Policy
from .step_control import StepControl
from .stepped_units import Course, Running, acts_later, endless, not_finite

Row = tuple[float, ...]
MOST_LEARNT = 300
"""An iterated step learns how up to so many exchanged elements depend on each other."""


class CoupledRun(Exchange, ABC):
    """One run of a Coupling under way, as `engines.run.engine.Engine` defines it.

    open_unit: gives the loaded FMU of a unit.
    """

    name: str

    def __init__(self, coupling: Coupling, inputs: InputTable, open_unit: Callable[[Any], Loaded]) -> None:
        self.open_unit = open_unit
        super().__init__(coupling, inputs)

    def _clear(self) -> None:
        """Nothing has run yet."""
        super()._clear()
        settings, coupling = self.settings, self.plan
        self.recording = Recording(len(coupling.columns))
        self.measured = [*Measures(coupling).references]  # type: ignore[arg-type]
        self.points: list[Row] = []  # t, 1 where something jumped there, and what is measured
        self.has_failed = False
        self.told_over: Fault | None = None
        self.steps = self.rejected = self.instants = self.iterations = 0
        self.exact: Fraction | None = settings.start
        self.broken = self.t
        self.control = StepControl()
        self.fresh = 0  # so many steps since something jumped
        self.set_aside: dict[int, Point] = {}  # past points that closer ones have replaced, by element
        self.end = math.nan if settings.stop is None else float(settings.stop)
        self.waiting: dict[int, list[Course]] = {}  # courses of units that cannot stop where their inputs jumped
        self.late: dict[int, Fault] = {}  # the warnings about the first such jump, by unit
        self.growths: dict[int, Growth] = {}  # of the elements that are watched
        self.grown: dict[int, Fault] = {}  # the warnings about them, by circle

    def start(self) -> None:
        self.close()
        self._clear()
        for unit in self.plan.units:
            self.units.append(self._unit(unit))
        with self._ending():
            self._initialize()

    def go_on_from(self, state: State) -> None:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be resumed."
        raise UsageError(Fault("E506", self.plan.name, message, "Start the run again from the beginning."))

    @abstractmethod
    def _unit(self, unit: CoupledUnit) -> Running:
        """Make a unit that has not started."""

    @abstractmethod
    def proceed(self, stop: Fraction) -> bool: ...

    @abstractmethod
    def pause(self, every: float, at: float) -> None: ...

    @abstractmethod
    def set_input(self, index: int, value: Array) -> None: ...

    @abstractmethod
    def set_parameters(self, coupling: Coupling) -> None: ...

    def close(self) -> None:
        """Free all FMUs."""
        with undisturbed():
            for unit in self.units:
                unit.close()
            self.units = []

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
        self.policy = Policy.of(self.plan, self._saving)
        self.evaluate(self.t)  # some FMUs compute their outputs only when they leave initialization
        self._instant(is_start=True)
        guessed = circles(self.plan, self._saving)
        self.growths = {g: Growth(number, abs(self.y[g])) for number, elements in guessed for g in elements}

    # --- going on ----------------------------------------------------------------------------------------------

    def hearing(self) -> AbstractContextManager[Callable[[], None]]:
        return patient()

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """An FMU inside a unit may end the run."""
        if self.has_failed:
            message = "the run has failed and cannot continue."
            raise UsageError(Fault("E501", self.plan.name, message, "Start a new run."))
        try:
            yield
        except Ended as error:
            self.told_over = error.faults[0]

    @property
    def tried(self) -> int:
        return self.steps + self.rejected

    @property
    def recorded_bytes(self) -> float:
        """Bytes of what is recorded, and of what is kept for the measures."""
        return self.recording.bytes + 8.0 * len(self.points) * (2 + len(self.measured))

    @property
    def over(self) -> Fault | None:
        told = self.told_over or next((unit.over for unit in self.units if unit.over is not None), None)
        ends = self.plan.ends
        if told is not None or ends is None or not self.y[ends] or any(at != self.t for at in self.at):
            return told  # behind a unit that lags, the condition is one of its extrapolated outputs
        return ended_by(self.settings.stop_when, self.t)

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

    # --- from outside ------------------------------------------------------------------------------------------

    def _put_parameters(self, coupling: Coupling) -> None:
        for running, new in zip(self.units, coupling.units, strict=True):
            running.take_parameters(new)
        self.plan = coupling

    def snapshot(self, overrides: Mapping[str, Any]) -> State:
        message = "a run with Co-Simulation FMUs, or with blocks that are coupled one by one, cannot be saved."
        raise UsageError(Fault("E506", self.plan.name, message, "Run it without saving its state."))

    def values(self, references: tuple[Reference, ...]) -> tuple[float, ...]:
        for row, place in references:
            if row == "source":
                name = f"{self.plan.flat.blocks[place[1]].path}.{place[2]}"
                raise UsageError(Fault("E502", name, "is neither recorded nor exchanged.", "Add it to log."))
        return tuple(self.value_of(reference, self.t) for reference in references)

    def _told(self) -> str:
        """The algorithm in words."""
        master = self.master
        steps = f"every {float(self.plan.shortest):g} s"
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
        warnings = (
            *(fault for fault in self.plan.warnings if fault.code in ("W209", "W211")),  # the run's end and steps
            *(told for unit in self.units for told in unit.warnings()), *self.late.values(), *self.grown.values(),
            *uncovered,
        )  # fmt: skip
        return Recorded(t, values, tuple(events), measures, statistics, warnings)

    def taken(self) -> Array:
        return self.recording.taken()[:-1]

    def abandon(self) -> None:
        self.has_failed = True
        self.close()

    def __del__(self) -> None:
        with suppress(BlocksError):
            self.close()
