"""Units as the reference master steps them: FMUs through FMPy, and blocks with equations by the reference engine.

Numbers are in SI. A unit stands at a time t, left of what happens there until `instant` is called.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from fractions import Fraction
from functools import partial
from typing import Any, Protocol

import numpy as np

from ...compile.coupling import CoupledUnit, Coupling, CouplingLoop, Link, Slot, calls_of, slots_at
from ...compile.inputs import InputTable
from ...compile.master_limits import MOST_PASSES, NEAR, SMALLEST
from ...compile.plan import Plan, Reference
from ...compile.time_grid import within_ulps
from ...compile.toolchain.cache import of_user
from ...compile.toolchain.isolation_build import compiled
from ...compile.upstream import changed_by
from ...fmi.instance import Instance, Saved, ended
from ...fmi.loading import Loaded
from ...fmi.model_description import ModelVariable
from ...fmi.trace import Tracer
from ...results.results import Event
from ...text.errors import NOT_FINITE, Fault, FMUError, SimulationError
from ..run.model_exchange import Foreigns

Course = tuple[float, float, float]
"""How an input goes over a step from t: its value, and its first and second derivative by time."""


class Running(Protocol):
    """What the master steps. What compiled code does by itself, only units of the reference master can."""

    unit: CoupledUnit
    u: list[float]
    can_save: bool

    @property
    def over(self) -> Fault | None:
        """The warning that an FMU ended the run (W206)."""
        ...

    def start(self, t: float, stop: float | None) -> None: ...
    def finish_start(self) -> None:
        raise AssertionError("compiled code ends the initialization")

    def put(self, places: Sequence[int], values: Sequence[float]) -> None:
        raise AssertionError("compiled code sets inputs")

    def take(self, values: Sequence[float]) -> None:
        """All inputs as they are now, for `instant`: an FMU receives them there."""
        self.u[:] = values

    def outputs(self) -> list[float]:
        raise AssertionError("compiled code reads outputs")

    def step(self, t: float, t1: float, exact: Fraction | None, courses: Sequence[Course]) -> float:
        """One step from t to t1, or to an instant before; where it came to."""
        raise AssertionError("compiled code makes the steps")

    def instant(self, *, is_due: bool) -> bool:
        """What happens at t, with the inputs as they are now; whether anything did. is_due: only what is due."""
        raise AssertionError("compiled code does what happens")

    def arrive(self, *, at_break: bool) -> None:
        """Stand at a communication point, before anything happens there. at_break: the diagram's inputs may bend."""
        return

    def bent(self, has_acted: bool) -> Collection[int]:
        """Return the places of the outputs that take a new course since `arrive`. has_acted: whether `instant` did."""
        return range(len(self.unit.outputs)) if has_acted else ()

    def save(self) -> object:
        raise AssertionError("compiled code saves")

    def restore(self, saved: Any) -> None:
        raise AssertionError("compiled code restores")

    def forget(self, saved: Any) -> None:
        raise AssertionError("compiled code forgets")

    def take_parameters(self, unit: CoupledUnit) -> None: ...
    def events(self) -> list[Event]:
        return []

    def warnings(self) -> Sequence[Fault]: ...
    def close(self) -> None: ...


def course_at(course: Course, s: float) -> float:
    """The value s seconds later."""
    return course[0] + s * (course[1] + s * course[2] / 2)


def mean_of(course: Course, h: float) -> float:
    """The mean over the next h seconds."""
    return course[0] + h * (course[1] / 2 + h * course[2] / 6)


# --- blocks with equations -------------------------------------------------------------------------------------


class _Inputs:
    """Inputs of a Plan that go as polynomials, in the place of an InputTable and of its segment."""

    tracks = ()
    begin = end = ()

    def __init__(self, t0: float, courses: Sequence[Course]) -> None:
        self.t0, self.courses = t0, courses
        self.base = tuple(course[0] for course in courses)
        self.constant = not any(course[1] or course[2] for course in courses)

    def segment(self, t: float) -> _Inputs:
        return self

    def at(self, t: float) -> tuple[float, ...]:
        if self.constant or t == self.t0:
            return self.base
        return tuple(course_at(course, t - self.t0) for course in self.courses)

    def next_break(self, t: float) -> float:
        return math.inf


def foreigns(plan: Plan, tracer: Tracer | None) -> Foreigns:
    """The FMUs for Model Exchange among blocks with equations."""
    return Foreigns.of(plan, of_user(), compiled, tracer) if plan.foreign else Foreigns()


class PlanUnit(Running):
    """Blocks with equations: a run of their Plan, whose inputs the master gives."""

    def __init__(self, unit: CoupledUnit, seen: frozenset[Reference], tracer: Tracer | None = None) -> None:
        from ..reference.reference_engine import ReferenceEngine  # FMUs alone need none

        assert unit.plan is not None
        self.unit, self.plan = unit, unit.plan
        self.u = [0.0] * len(unit.links)
        self.engine = ReferenceEngine(self.plan, InputTable(()), foreign=foreigns(self.plan, tracer), is_silent=True)
        self.given = self.engine.compiled.program("given", unit.references)
        self.can_save = not self.plan.steppers and self.engine.instants.foreign.can_go_back
        self.has_begun = False
        self.uncounted = -math.inf  # when a crossing was found last that the inputs did not confirm
        self.counted = self.engine.crossed.kept()
        self.seen = [not seen.isdisjoint(changed) for changed in changed_by(self.plan)]
        self.arrived: tuple[Any, ...] = ()
        self.arrived_u: list[float] = []
        self.is_driven = False  # whether the diagram's inputs, which it reads, jump or bend now

    def start(self, t: float, stop: float | None) -> None:
        self._hold(t)
        self.engine.stand_at_start(self.u)

    @property
    def over(self) -> Fault | None:
        return self.engine.over

    def finish_start(self) -> None:
        self.engine.stand_at_start(self.u)
        self.has_begun = True
        own = self.engine.instants.foreign
        for own_unit in own:
            own_unit.is_inside = True
        self.engine.outstanding = True
        if self.can_save and own.units:  # some FMUs say that they can, and cannot
            try:
                kept = own.keep()
                own.go_back(kept)
                own.drop(kept)
            except FMUError:
                self.can_save = False

    def _hold(self, t: float) -> None:
        """Inputs as they are now, from now on."""
        self.engine.hold(_Inputs(t, [(value, 0.0, 0.0) for value in self.u]))

    def put(self, places: Sequence[int], values: Sequence[float]) -> None:
        for place, value in zip(places, values, strict=True):
            self.u[place] = value
        if not self.has_begun:
            self.engine.stand_at_start(self.u)

    def outputs(self) -> list[float]:
        with np.errstate(all="ignore"):
            values = self.given(*self.engine.instants.memory(self.engine.now, tuple(self.u)))
        return list(values)

    def step(self, t: float, t1: float, exact: Fraction | None, courses: Sequence[Course]) -> float:
        engine = self.engine
        engine.hold(_Inputs(t, courses))
        self.counted = engine.crossed.kept()
        end = exact if exact is not None else Fraction(t1)
        with np.errstate(all="ignore"):
            while engine.t < t1:
                if not engine.outstanding:
                    engine.step(*engine.next_instant(end))
                elif self._is_seen():
                    # Where it goes back and comes here again, a short step may not see what lies behind a crossing.
                    engine.sure = engine.located
                    break
                else:
                    engine.instant()
        return t1 if within_ulps(engine.t, t1, engine.scale) else engine.t

    def instant(self, *, is_due: bool) -> bool:
        """What happens at t, with the inputs as they are now; whether anything did."""
        engine = self.engine
        was_due = engine.is_due
        before = engine.now.s, len(engine.events)
        has_crossed = engine.crossing
        self._hold(engine.t)
        engine.changed, engine.recourses = True, not self.is_driven and self.u == self.arrived_u
        with np.errstate(all="ignore"):
            engine.instant(is_start=not engine.steps and engine.left is None)
        engine.recourses = False
        is_ahead = engine.t - self.uncounted > NEAR * math.ulp(engine.t)  # else it comes back again and again
        if has_crossed and is_ahead and (engine.now.s, len(engine.events)) == before:
            self.uncounted = engine.t
            # With the present inputs it is not crossed yet: it will be soon, and that is no chattering.
            engine.crossed.go_back(self.counted)
            engine.located = (math.nan, np.empty(0))
        return was_due

    def _is_seen(self) -> bool:
        """Return whether what happens now changes anything that can be seen outside."""
        engine, plan, now = self.engine, self.plan, self.engine.now
        if plan.foreign:
            return True
        happening = [*engine.due_rates]
        first = len(plan.rates)
        if engine.crossing:
            t, values = engine.sides
            crossed = np.flatnonzero((values >= 0) != (np.array(now.s) > 0)).tolist() if t == now.t else []
            happening += [first + j for j in crossed or range(len(plan.crossings))]  # not known: any
        first += len(plan.crossings)
        happening += [first + i for i in engine.due_events]
        first += len(plan.events)
        if now.past is not None:
            happening += [first + i for i in now.past.breaks_at(now.t)]
        return any(self.seen[k] for k in happening)

    def arrive(self, *, at_break: bool) -> None:
        self.arrived, self.arrived_u = self._memory(), list(self.u)
        self.is_driven = at_break and self.unit.reads_inputs

    def _memory(self) -> tuple[Any, ...]:
        engine, now = self.engine, self.engine.now
        broken = [] if now.past is None else now.past.breaks_at(now.t)
        return now.x.tolist(), now.d, now.s, broken, engine.instants.foreign.events

    def bent(self, has_acted: bool) -> Collection[int]:
        (x, d, s, broken, events), (x1, d1, s1, _, events1) = self.arrived, self._memory()
        if events != events1:  # of an FMU inside: it may change all
            return range(len(self.unit.outputs))
        rows = (("x", x, x1), ("d", d, d1), ("s", s, s1))
        changed = {Reference(row, i) for row, a, b in rows for i, (v, w) in enumerate(zip(a, b, strict=True)) if v != w}
        changed |= {Reference("h", i) for i in broken}
        return [n for n, follows in enumerate(self.unit.follows) if not changed.isdisjoint(follows)]

    def save(self) -> object:
        return self.engine.keep(), list(self.u)

    def restore(self, saved: Any) -> None:
        self.engine.go_back(saved[0])
        self.u = list(saved[1])

    def forget(self, saved: Any) -> None:
        self.engine.drop(saved[0])

    def take_parameters(self, unit: CoupledUnit) -> None:
        assert unit.plan is not None
        self.unit, self.plan = unit, unit.plan
        self.engine.set_parameters(unit.plan)

    def events(self) -> list[Event]:
        return self.engine.events

    def warnings(self) -> Sequence[Fault]:
        return self.engine.instants.foreign.warnings

    def close(self) -> None:
        self.engine.instants.foreign.close()


# --- FMUs ------------------------------------------------------------------------------------------------------


def _elements(value: Any) -> list[Any]:
    return [value] if isinstance(value, (str, bool)) else np.ravel(value).tolist()


def set_up(one: Instance, unit: CoupledUnit) -> None:
    """Set the parameters and start values of a block that differ from what the description says."""
    assert unit.foreign is not None
    foreign = unit.foreign
    sizes: list[tuple[ModelVariable, list[Any]]] = []
    given: list[tuple[ModelVariable, list[Any]]] = []
    for name, value in unit.values.items():
        variable, default = foreign.variables.get(name), unit.defaults[name]
        if variable is None or value is None:
            continue
        flat = _elements(value)
        own = [item if isinstance(item, (str, bool)) else foreign.own(name, item) for item in flat]
        told = [default] if isinstance(default, (str, bool)) else np.ravel(default).tolist()
        told = told * len(own) if len(told) == 1 else told
        is_own = default is not None and variable.name not in foreign.changed
        if name in foreign.offsets:
            is_told = all(_same(a, foreign.si(name, b)) for a, b in zip(flat, told, strict=True)) if is_own else False
        else:
            is_told = is_own and all(_same(a, b) for a, b in zip(own, told, strict=True))
        if is_told:
            continue
        target = sizes if variable.causality == "structuralParameter" else given
        target.append((variable, [_typed(item, variable.type) for item in own]))
    if sizes:
        one.configure([variable for variable, _ in sizes], [item for _, items in sizes for item in items])
    if given:
        one.set([variable for variable, _ in given], [item for _, items in given for item in items])


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, str) or isinstance(b, str):
        return bool(a == b)
    return math.isclose(float(a), float(b), rel_tol=4e-16, abs_tol=0.0)


def _typed(value: Any, type_: str) -> Any:
    if type_ == "Boolean":
        return bool(value)
    return value if isinstance(value, str) or type_ in ("Float64", "Float32") else int(value)


class FmuUnit(Running):
    """A Co-Simulation FMU. way: how courses of its inputs reach it. update: the address of the callback within steps,
    where compiled code makes them.
    """

    over: Fault | None = None  # nothing is set in it once it has ended the run
    begins = False  # it has left initialization, and is in event mode until its turn in the instant at the start

    def __init__(
        self,
        unit: CoupledUnit,
        loaded: Loaded,
        coupling: Coupling,
        *,
        update: int = 0,
        tracer: Tracer | None = None,
    ) -> None:
        assert unit.foreign is not None
        self.unit, self.coupling = unit, coupling
        self.interface = unit.foreign.interface
        self.u = [0.0] * len(unit.links)
        self.way = unit.way
        self.courses: Sequence[Course] = ()
        self.t = math.nan
        self.is_asked = False  # whether the FMU has asked for event mode
        self.held: list[float] | None = None  # what it knows of inputs that are held; None: it has not begun
        self.takes = 2  # the highest order of derivatives that it has not refused
        is_asked = self.way == "intermediate" and coupling.settings.master.order > 0
        intermediate = self._intermediate if is_asked and not update else None
        self.moving = unit.moving
        self.one = Instance(
            loaded, unit.path, event_mode=self.interface.event_mode,
            early_return=self.interface.event_mode and self.interface.any_step,  # else no step of it is cut
            intermediate=intermediate, intermediate_variables=[slot.variable for slot in self.moving],
            update=update if is_asked else 0, tracer=tracer,
        )  # fmt: skip
        # What is set as a step begins: what is discrete can be set in event mode only, where there is one.
        self.stepped = self.moving if self.interface.event_mode else list(unit.slots_in)
        self.calls: dict[tuple[int, ...], list[tuple[list[Slot], tuple[ModelVariable, ...]]]] = {}
        self.can_save = self.interface.saves
        self.asked = tuple(slot.variable for slot in unit.slots_out)
        self.scales, self.offsets = (
            [getattr(slot, part) for slot in unit.slots_out for _ in range(slot.size)] for part in ("scale", "offset")
        )

    def start(self, t: float, stop: float | None) -> None:
        experiment = t, stop, self.coupling.tolerance_of(self.unit)
        self.one.set_up_experiment(*experiment)
        set_up(self.one, self.unit)
        self.one.enter_initialization(*experiment)
        self.t = t

    def finish_start(self) -> None:
        self.one.exit_initialization()
        self.held = [value for value, moves in zip(self.u, self.unit.continuous, strict=True) if not moves]
        self.begins = self.interface.event_mode
        if self.can_save and self.over is None:  # some say that they can, and cannot
            try:
                saved = self.one.save()
                self.one.restore(saved)
                self.one.forget(saved)
            except FMUError:
                self.can_save = False

    def _iterate(self) -> bool:
        """Event mode until it is quiet; False where it ended the run."""
        for _ in range(MOST_PASSES):
            told = self.one.update_discrete_states()
            if told.terminate:
                self.end(self.t)
                return False
            if not told.needs_update:
                return True
        raise endless_updates(self.unit, self.t)

    def put(self, places: Sequence[int], values: Sequence[float]) -> None:
        for place, value in zip(places, values, strict=True):
            self.u[place] = value
        if self.over is not None:
            return
        wanted = set(places)
        if self.interface.event_mode and self.held is not None:  # what is discrete can be set in event mode only
            wanted &= {place for place, moves in enumerate(self.unit.continuous) if moves}
        self._set(slots_at(self.unit, wanted))

    def _set(self, slots: Sequence[Slot]) -> None:
        key = tuple(slot.first for slot in slots)
        if key not in self.calls:
            groups = calls_of(slots, self.one.fmi, self.unit.continuous).values()
            self.calls[key] = [(group, tuple(slot.variable for slot in group)) for group in groups]
        for group, variables in self.calls[key]:
            given = ((slot, value) for slot in group for value in self.u[slot.first : slot.first + slot.size])
            self.one.set(variables, [self._own(slot, value) for slot, value in given])

    @staticmethod
    def _own(slot: Slot, value: float) -> Any:
        type_ = slot.variable.type
        is_real = type_ in ("Float64", "Float32")
        return (value - slot.offset) / slot.scale if is_real else _typed(value, type_)

    def outputs(self) -> list[float]:
        if not self.asked:
            return []
        values = self.one.get(self.asked)
        picked = [float(values[place]) * self.scales[place] for place in self.unit.picks]
        if not any(self.offsets):
            return picked
        moves = (self.offsets[place] for place in self.unit.picks)
        return [value + move if move else value for value, move in zip(picked, moves, strict=True)]

    def _put_courses(self, slots: Sequence[Slot], s: float, *, mean: float = 0.0) -> None:
        """Inputs as they are s seconds later, or on the mean over some seconds."""
        for slot in slots:
            for place in range(slot.first, slot.first + slot.size):
                course = self.courses[place]
                self.u[place] = mean_of(course, mean) if mean else course_at(course, s)
        self._set(slots)

    def _intermediate(self, t: float, one: Instance) -> float | None:
        self._put_courses(self.moving, t - self.t)
        return None

    def step(self, t: float, t1: float, exact: Fraction | None, courses: Sequence[Course]) -> float:
        self.courses = courses
        end, least = t1, (t1 - t) / SMALLEST
        if self.over is not None:
            return min(self.t, t1)
        while True:
            h, self.t = end - t, t
            self._lead(h)
            outcome = self.one.step(t, h)
            if outcome.terminate:
                self.end(t if outcome.last_time is None else max(t, min(outcome.last_time, end)))
                return self.t
            last = end
            if outcome.discarded:
                if outcome.last_time is None or not t < outcome.last_time:  # it went nowhere: a shorter one may do
                    if h <= least:
                        raise stuck(self.one, t)
                    end = t + h / 2
                    continue
                last = outcome.last_time
            if last < t1 and not outcome.early:  # a part of it is done
                s = last - t
                courses = self.courses = [(course_at(c, s), c[1] + s * c[2], c[2]) for c in courses]
                t, end = last, t1
                continue
            assert outcome.last_time is not None
            self.t = outcome.last_time if outcome.early else t1
            self.is_asked = outcome.event_needed
            return self.t

    def _lead(self, h: float) -> None:
        """Inputs for a step of h seconds."""
        leads = self.coupling.settings.master.order > 0 and any(course[1] or course[2] for course in self.courses)
        self._put_courses(self.stepped, 0.0, mean=h if leads and self.way == "mean" else 0.0)
        if leads and self.way == "derivatives":
            variables = [slot.variable for slot in self.moving]
            for order in range(1, self.takes + 1):
                values = [
                    self.courses[place][order] / slot.scale
                    for slot in self.moving
                    for place in range(slot.first, slot.first + slot.size)
                ]
                if (order == 1 or any(values)) and not self._accepts(variables, order, values):
                    break
            if self.way == "mean":
                self._put_courses(self.stepped, 0.0, mean=h)

    def _accepts(self, variables: Sequence[ModelVariable], order: int, values: Sequence[float]) -> bool:
        """Derivatives for the next step; False where the FMU refuses this order, now and from now on."""
        try:
            self.one.set_input_derivatives(variables, order, values)
        except FMUError as error:
            if self.one.is_lost:
                raise
            self.lower(order, error.faults[0].message)
            return False
        return True

    def lower(self, order: int, why: str) -> None:
        """Use the next lower order of input derivatives, as the FMU refuses this one: reported once."""
        self.takes = order - 1
        if not self.takes:
            self.way = "mean"
        instead = "as straight lines" if self.takes else "by their mean over each step"
        message = f"it refuses input derivatives of order {order}; from here on its inputs go in {instead}: {why}"
        cure = f"Set --master order={self.takes} to request none."
        self.one.excused(Fault("W207", self.unit.path, message, cure))

    def instant(self, *, is_due: bool) -> bool:
        if not self.interface.event_mode or self.over is not None:
            return False
        held = [value for value, moves in zip(self.u, self.unit.continuous, strict=True) if not moves]
        if is_due and not self.is_asked and held == self.held and not self.begins:
            return False  # it neither asks for event mode nor has received a jump
        self.is_asked, self.held = False, held
        if not self.begins:
            self.one.enter_event_mode()
        self.begins = False
        self._set(self.unit.slots_in)
        if self._iterate():
            self.one.enter_step_mode()
        return True

    def end(self, t: float) -> None:
        """The FMU ended the run at t."""
        self.t = t
        self.over = ended(self.one.name, self.one.place, t, self.one.words if self.one.messages else "")

    def save(self) -> Saved:
        return self.one.save()

    def restore(self, saved: Saved) -> None:
        self.one.restore(saved)
        self.t, self.over = saved.t, None

    def forget(self, saved: Saved) -> None:
        self.one.forget(saved)

    def take_parameters(self, unit: CoupledUnit) -> None:
        assert unit.foreign is not None
        for name, value in unit.values.items():
            if not np.array_equal(self.unit.values[name], value):
                variable, own = unit.foreign.variables[name], partial(unit.foreign.own, name)
                self.one.set((variable,), [_typed(own(item), variable.type) for item in _elements(value)])
        self.unit = unit

    def warnings(self) -> Sequence[Fault]:
        return self.one.warnings

    def close(self) -> None:
        self.one.close()


def stuck(one: Instance, t: float) -> FMUError:
    message = f"{one.place} discarded the step from t = {t:.10g} s, and each shorter one that was tried.{one.words}"
    return FMUError(Fault("E213", one.name, message, "Try other inputs or parameters."))


def not_finite(coupling: Coupling, link: Link, value: float, t: float) -> SimulationError:
    """The error of a recorded or measured value that is not finite."""
    row, index = link
    if row != "y":
        return SimulationError(Fault("E303", coupling.name, f"is {value} at t = {t} s.", NOT_FINITE))
    element = coupling.elements[index]
    is_foreign = coupling.units[element.unit].foreign is not None
    own = "The FMU returns it: try other inputs or parameters, or a shorter communication step."
    return SimulationError(Fault("E303", element.name, f"is {value} at t = {t} s.", own if is_foreign else NOT_FINITE))


def acts_later(unit: CoupledUnit, t: float) -> Fault:
    """Return the warning that a jump at t reaches a unit, whose steps must not differ, at its next point."""
    step = f"{float(unit.step):g}"
    message = f"takes steps of {step} s only: the jump of its input at t = {t:.10g} s acts from its next step on."
    return Fault("W209", unit.path, message, "Later jumps do so too. Choose a step whose multiples include the jumps.")


def unconverged(coupling: Coupling, t: float, t1: float) -> SimulationError:
    master = coupling.settings.master
    message = f"the step from t = {t} s to {t1} s did not converge in {master.iterations} iterations."
    cure = "Use a shorter communication step (--master step=H), another order (--master order=N), or more iterations."
    if master.algorithm != "iterated":  # its first steps are iterated, for their order
        cure = "Use order 1, which repeats no step (--master order=1), a shorter step (step=H), or more iterations."
    return SimulationError(Fault("E312", coupling.name, message, cure))


def unsolved(coupling: Coupling, loop: CouplingLoop, t: float) -> SimulationError:
    message = f"at t = {t} s no values were found that solve the algebraic loop through it."
    cure = "Use start values nearer to a solution, or put a UnitDelay into the loop."
    return SimulationError(Fault("E307", coupling.elements[loop.elements[0]].name, message, cure))


def endless(coupling: Coupling, acting: Sequence[int], t: float) -> SimulationError:
    """The error of instants in units that do not end. acting: the units."""
    names = ", ".join(coupling.units[k].place for k in acting[:3])
    message = f"at t = {t} s events in {names} cause each other without end."
    return SimulationError(Fault("E305", coupling.name, message, "Put a delay between them."))


def endless_stops(unit: CoupledUnit, t: float) -> SimulationError:
    """The error of a unit that gets no further, as each try at a step ends at another instant near t."""
    message = f"it stops again and again at t = {t} s, because its inputs change with each step."
    cure = "Use order 1 or 2 (--master order=1), so that its inputs are interpolated."
    return SimulationError(Fault("E305", unit.place, message, cure))


def endless_updates(unit: CoupledUnit, t: float) -> FMUError:
    message = f"its event iteration at t = {t} s does not end: after {MOST_PASSES} updates it requests more."
    return FMUError(Fault("E214", unit.place, message, "Report it to the FMU's vendor."))


def too_short(coupling: Coupling, element: int, t: float, h: float) -> SimulationError:
    tolerance = coupling.settings.master.tolerance
    message = (
        f"at t = {t} s the communication step fell to {h:.3g} s, and its error still exceeds the tolerance {tolerance}."
    )
    cure = "Use a larger tolerance of the master, or fixed steps (--master step=H)."
    return SimulationError(Fault("E301", coupling.elements[element].name, message, cure))
