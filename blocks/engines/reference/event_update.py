"""An instant: what happens at one time, always in this order.

    1. every island has reached t, and what is replaced after each step is replaced; left values are recorded
    2. crossings and events that fire: all resets at once from the values before, sides latched again; until quiet
    3. the ticks that are due, once: sampled outputs and time events of FMUs in dependency order (with step 2 before an
       output that sees others through a side or through what events reset), step 2, then all discrete updates together
    4. step 2 again; ticks never repeat
    5. what is replaced after each step (every="step") is replaced, all at once; where that changed anything, step 2
       again
    6. right values are recorded

This module is the meaning of steps 2 to 5 and of the start, for every engine. It is pure: a Snapshot comes in, another
goes out, with what fired.
"""

from __future__ import annotations

import copy
import json
import math
import os
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from ...compile.firing_order import order_of
from ...compile.plan import Cause, EnabledPart, Node, Plan, Reference, StepperPart
from ...compile.tick_stages import UnitPlace, rate_sets, sequence_at
from ...results.results import Event
from ...text.arrays import Array, frozen
from ...text.errors import NOT_FINITE, Fault, SimulationError, UsageError
from ..run.history import Past
from ..run.model_exchange import Foreigns
from ..run.saved_state import restoring
from ..run.snapshot import MethodMemory, Snapshot
from .corners import MOST_CORNERS, Corners, at, first_change
from .python_code import CompiledPrograms, Evaluator

_Update = tuple[Evaluator, list[int]]  # a program, and the places in d of what it gives
_Item = UnitPlace | tuple[_Update, list[int]]  # the time event of an FMU, or sampled outputs and programs
MOST_PASSES = 100
OPEN_THE_LOOP = "Put a UnitDelay or a state into the loop, or use a law without a jump."
_TINY = 5e-324


def _line(error: BaseException) -> str:
    """Where in the user's program an error was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename != __file__]
    return f" ({os.path.basename(own[-1].filename)}:{own[-1].lineno})" if own else ""


def _cycle(history: list[str]) -> str:
    """The names from where the last one stood before, as a circle."""
    before = [k for k, name in enumerate(history[:-1]) if name == history[-1]]
    return " -> ".join(history[before[-1] if before else 0 :])


@dataclass(frozen=True)
class _Restart:
    """Where the search for quiet may begin again: at its start, or after the last events of FMUs."""

    snapshot: Snapshot
    due: dict[int, float]
    fired: int  # how many events there were
    slack: tuple[float, ...]
    fmu_events: int  # how many events FMUs had had


@dataclass
class Instants:
    """The programs that instants of one Plan need, printed when first needed."""

    plan: Plan
    compiled: CompiledPrograms
    _inputs: dict[int, Evaluator] = field(default_factory=dict)
    _anew: dict[EnabledPart, Evaluator] = field(default_factory=dict)
    _due: dict[frozenset[int], tuple[list[_Item], _Update]] = field(default_factory=dict)
    programs: dict[int, Any] = field(default_factory=dict)  # of steppers: what owns their state
    foreign: Foreigns = field(default_factory=Foreigns)  # FMUs, which own theirs
    later: float = 0.0  # s; by how much states and crossings stand after an instant that crossings have joined
    inputs_later: Sequence[float] = ()  # the inputs there
    slack: tuple[float, ...] = ()  # of crossings that are corners of loops: how far they may be off by rounding
    looseness: float = 1.0  # in steps it is 2: where a corner is located there, it is beyond its slack at the instant
    touched: tuple[float, Array] = (math.nan, np.empty(0))  # a time, and the values of crossings that touch 0 there

    def __post_init__(self) -> None:
        plan, program = self.plan, self.compiled.program
        self.causes: list[Cause] = [*plan.crossings, *plan.events]
        self._sides = program("crossings", [cause.node for cause in plan.crossings])
        # What stands still while the subdiagram around it is off, and the side that says so.
        conditions = [instance.condition for instance in plan.instances]
        gated = [(j, conditions[cause.node.instance]) for j, cause in enumerate(plan.crossings)]
        self.gated = [(j, side) for j, side in gated if side is not None]
        self.event_sides = [conditions[cause.node.instance] for cause in plan.events]
        held = [(slot, conditions[node.instance]) for rate in plan.rates for node, slot in (*rate.outputs, *rate.nexts)]
        self.slot_sides = {slot: side for slot, side in held if side is not None}
        self.projected_sides = [conditions[node.instance] for node, _ in plan.projections]
        of_states = [conditions[node.instance] for node in plan.derivatives]
        self.state_sides = np.array([-1 if side is None else side for side in of_states], dtype=int)
        self.projections = program("projections", [node for node, _ in plan.projections])
        self.solutions = program("solutions", plan.unknowns)
        self.corners = Corners(plan, self.compiled) if plan.corners else None
        self.order_of_firing = order_of(plan)
        self.event_times = program("event_times", [cause.node for cause in plan.events])
        self.taken = [reference for part in plan.foreign for reference in part.inputs]  # by FMUs
        self.foreign_inputs = program("foreign_inputs", self.taken)
        self.resets = [
            program(f"reset_{index}", [node for node, _ in cause.resets]) if cause.resets else None
            for index, cause in enumerate(self.causes)
        ]
        self.of_fmus = plan.foreign_crossings | {len(plan.crossings) + part.event for part in plan.foreign}
        # By block, then as declared: so events are listed, and so the reset that is declared later wins.
        self.order = sorted(range(len(self.causes)), key=lambda i: self._rank(self.causes[i].node))
        self.ranks = [[self._rank(node) for node, _ in cause.resets] for cause in self.causes]

    @cached_property
    def rate_sets(self) -> list[frozenset[int]]:
        return rate_sets(self.plan)

    def _rank(self, node: Node) -> tuple[int, int]:
        return node.instance, list(self.plan.instances[node.instance].tape.results).index(node.key)

    def start(self, t: float, u: Sequence[float], ticks: tuple[int, ...], fixed: int) -> Snapshot:
        """Values at the start: start values, initial equations and sides in one dependency order. Nothing fires."""
        plan = self.plan
        nx, nd = len(plan.states), len(plan.discretes)
        past = Past.at_start(plan, t)
        values, s, z = self._settled_at_start(t, u, ticks, () if past is None else past.values(t))
        x = frozen(np.array(values[:nx], dtype=float))
        d = tuple(float(v) for v in values[nx : nx + nd])
        bad = next((i for i, v in enumerate((*x, *d)) if not math.isfinite(v)), None)
        if bad is not None:
            name = (*plan.states, *plan.discretes)[bad]
            raise SimulationError(Fault("E303", name, f"starts at {(*x, *d)[bad]}, which is not finite.", NOT_FINITE))
        if plan.foreign:
            x = frozen(self.foreign.started(x))
        snapshot = Snapshot(t, None, x, d, s, ticks, (), (math.nan,) * len(plan.events), MethodMemory(), fixed, past, z)
        if plan.foreign:
            snapshot = self._with_foreign_sides(snapshot, u, range(len(plan.foreign)))
        return self.with_event_times(self.with_solutions(snapshot, u), u)

    def _settled_at_start(
        self, t: float, u: Sequence[float], ticks: tuple[int, ...], h: tuple[float, ...]
    ) -> tuple[Sequence[float], tuple[float, ...], tuple[float, ...]]:
        """Return the values at the start, with the sides and the unknowns of loops that they agree with.

        Raises SimulationError (E305) if there are none.
        """
        plan = self.plan
        asked: list[Node | Reference] = [Reference("x", i) for i in range(len(plan.states))]
        asked += [plan.d_start[i] if i in plan.guessed else Reference("d", i) for i in range(len(plan.discretes))]
        asked += plan.s_start  # the crossings themselves: what is asked for as ("s", i) is a side already
        asked += self.taken
        z = tuple(plan.guesses.get(reference, 0.0) for reference in plan.unknowns)
        first = len(plan.states) + len(plan.discretes) + len(plan.s_start)  # of what FMUs take
        program = self.compiled.program("start", asked, start=plan.starting)
        # Where a side and what it is of need each other at the start, sides are guessed until they hold.
        s = tuple(0.0 if isinstance(begin, Node) else float(begin.index) for begin in plan.s_start)
        d = (0.0,) * len(plan.discretes) if plan.guessed else ()
        self.foreign.begin(plan, t)
        moved, is_settled = False, False
        last: tuple[float, ...] | None = None
        for _ in range(MOST_PASSES):
            values = program(t, (), d, s, plan.parameters, u, ticks, h, z, self.foreign)
            guess = s, d
            s, d = self._shown(values)
            # What FMUs begin with may depend on inputs that were not known when it was read.
            if plan.foreign:
                self.foreign.initialized(values[first:])
                moved, last = last is None or not np.allclose(values, last, rtol=1e-13, atol=0.0), values
            is_settled = not moved and ((s, d) == guess or plan.starting is True)
            if is_settled:
                break
        is_free = plan.starting is not True and self.corners is not None and not plan.foreign
        if is_free and (not is_settled or any(map(math.isnan, values))):
            begun = self._start_along(asked, t, u, ticks, h)
            if begun is not None:
                return begun
        if is_settled:
            return values, s, z
        raise self.foreign.unsettled(t) if moved else self._sideless(s, guess[0])

    def _sideless(self, s: tuple[float, ...], guess: tuple[float, ...]) -> SimulationError:
        """Return the error of sides that do not hold at the start. guess: those from which s came."""
        j = next((j for j, (side, other) in enumerate(zip(s, guess, strict=True)) if side != other), 0)
        message = "has no side on which it can start: each side leads to the other."
        cure = "Put a UnitDelay or a state into the loop, or set the side at the start: @crossing(start=False)."
        if j in self.plan.corners:
            message, cure = "the algebraic loop has no solution at the start.", OPEN_THE_LOOP
        return SimulationError(Fault("E305", self.name(j), message, cure))

    def _shown(self, values: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The sides, and what else is guessed, that the values at the start show."""
        plan = self.plan
        nx, nd, ns = len(plan.states), len(plan.discretes), len(plan.s_start)
        s = tuple(
            float(v if isinstance(begin, Reference) else v >= 0)
            for v, begin in zip(values[nx + nd : nx + nd + ns], plan.s_start, strict=True)
        )
        return s, tuple(values[nx + i] if i in plan.guessed else 0.0 for i in range(nd)) if plan.guessed else ()

    def _start_along(
        self,
        asked: Sequence[Node | Reference],
        t: float,
        u: Sequence[float],
        ticks: tuple[int, ...],
        h: Sequence[float],
    ) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] | None:
        """The values and sides at the start, found from corner to corner, and the unknowns at the last one; None where
        there is no way to them.

        It begins where searches begin, with the sides that are shown there.
        """
        plan, corners = self.plan, self.corners
        assert corners is not None
        nx, nd, nz = len(plan.states), len(plan.discretes), len(plan.unknowns)
        solved = self.compiled.program("start_along", [*asked, *plan.unknowns], start=plan.starting)
        given = self.compiled.program("start_given", asked, start=plan.starting, given=True)
        guess = tuple(0.0 if isinstance(begin, Node) else float(begin.index) for begin in plan.s_start), (0.0,) * nd
        z = tuple(plan.guesses.get(reference, 0.0) for reference in plan.unknowns)

        def shown(z: Sequence[float], guess: tuple[tuple[float, ...], tuple[float, ...]]) -> Any:
            s, d = guess
            return self._shown(given(t, (), d, s, plan.parameters, u, ticks, h, z, self.foreign))

        def solution(s: tuple[float, ...]) -> tuple[float, ...] | None:
            values = solved(t, (), guess[1], s, plan.parameters, u, ticks, h, z, self.foreign)
            return None if any(map(math.isnan, values)) else values

        for _ in range(MOST_PASSES):
            begin, guess = guess, shown(z, guess)
            if guess == begin:
                break
        for _ in range(MOST_CORNERS):
            values = solution(guess[0])
            if values is None:
                others = (self._turned(guess[0], j) for j in corners.numbers)
                other = next((s for s in others if solution(s) is not None), None)
                if other is None:
                    return None
                guess = other, guess[1]
                continue
            end = values[-nz:]
            if self._shown(values) == guess:
                return values, guess[0], z
            d = tuple(guess[1][i] if i in plan.guessed else values[nx + i] for i in range(nd))
            memory = (t, values[:nx], d, guess[0], plan.parameters, u, ticks, h, end, self.foreign)
            if corners.is_near(z, end, memory):
                return (*values[:nx], *d, *values[nx + nd :]), guess[0], z
            z = first_change(lambda z: shown(z, guess) != guess, z, end)  # noqa: B023
            guess = shown(z, guess)
        return None

    @staticmethod
    def _turned(s: tuple[float, ...], j: int) -> tuple[float, ...]:
        """The sides with that of one crossing turned."""
        return (*s[:j], 1.0 - s[j], *s[j + 1 :])

    def with_event_times(self, snapshot: Snapshot, u: Sequence[float]) -> Snapshot:
        """The same with the next time of every event. Raises SimulationError (E306) where it is not in the future."""
        if not self.plan.events:
            return snapshot
        t = snapshot.t
        times = list(self.event_times(*self.memory(snapshot, u)))
        for i, side in enumerate(self.event_sides):
            if side is not None and not snapshot.s[side]:
                times[i] = math.inf
        for i, own in enumerate(snapshot.own):
            if self._is_off(self.event_sides[i], snapshot):
                continue
            if own > t:  # it fired at its own time, some ulp after this instant's
                times[i] = self.event_times(*self.memory(snapshot, u, own))[i]
            if not times[i] > (own if own > t else t):
                raise self._not_ahead(len(self.plan.crossings) + i, times[i], t)
        return replace(snapshot, events=tuple(times))

    def _not_ahead(self, index: int, time: float, t: float) -> SimulationError:
        """The error of an event time that does not lie in the future."""
        message = f"returned {time} as the next instant after t = {t} s."
        cure = "An event time must be after t, or inf: compare with t < ..., not t <= ..."
        return SimulationError(Fault("E306", self.name(index), message, cure))

    def with_solutions(self, snapshot: Snapshot, u: Sequence[float]) -> Snapshot:
        """The same with the solutions of the algebraic loops now. Raises SimulationError (E307) where one has none."""
        if not self.plan.unknowns:
            return snapshot
        memory = self.memory(snapshot, u)
        z = self.solutions(*memory)
        for reference, value in zip(self.plan.unknowns, z, strict=True):
            if not math.isfinite(value):
                raise self.unsolved(reference, memory)
        return snapshot if z == snapshot.z else replace(snapshot, z=z)

    def unsolved(self, reference: Reference, memory: tuple[object, ...]) -> SimulationError:
        """The error of a loop for which no solution was found: how near the search came, and what may help."""
        node = self.plan.outputs[reference.index]
        name = self.plan.node_name(node)
        if node.key.startswith("residual"):
            message = f"at t = {memory[0]} s no value was found at which its residual is 0."
            cure = f"There may be none, or the search starts too far from it: set {name.partition('[')[0]}_start."
        else:
            message = f"at t = {memory[0]} s no solution was found for its algebraic loop."
            cure = (
                "It may have no solution, or many (y = y). If it has one, let the search start near it: a block with "
                "an Algebraic variable in the loop has a start value. A state or a UnitDelay in the loop breaks it."
            )
        found = self.compiled.nearest(reference, memory)
        if found is not None:
            torn, search = found
            its = self.plan.node_name(self.plan.outputs[torn.index])
            if search.residual == 0.0:
                message += f" The residual is 0 at {its} = {search.x!r}, but its derivative is singular there."
            elif math.isfinite(search.residual):
                message += f" The search came nearest at {its} = {search.x!r}, with the residual {search.residual:g}."
            else:
                message += (
                    f" The residual is not finite where the search begins, at {its} = {search.guess[search.number]!r}."
                )
        return SimulationError(Fault("E307", name, message, cure))

    def memory(self, snapshot: Snapshot, u: Sequence[float], t: float | None = None) -> tuple[Any, ...]:
        """The arguments of a program."""
        now = snapshot.t if t is None else t
        h = snapshot.delayed(now)
        x, d, s, p, f = snapshot.x.tolist(), snapshot.d, snapshot.s, self.plan.parameters, self.foreign
        return now, x, d, s, p, u, snapshot.ticks, h, snapshot.z, f

    def crossing_values(self, snapshot: Snapshot, u: Sequence[float]) -> tuple[float, ...]:
        return self.sides(*self.memory(snapshot, u)) if self.plan.crossings else ()

    def sides_now(self, snapshot: Snapshot, u: Sequence[float]) -> tuple[float, ...]:
        """The crossings at an instant; where the step before was taken a little further, as they are there."""
        if not self.plan.crossings:
            return ()
        return self.sides(*self._memory_now(snapshot, u))

    def latched(self, snapshot: Snapshot, values: Iterable[float]) -> tuple[float, ...]:
        """The sides that go with crossing values. Where a signal touched 0 and has not jumped since, its side stays."""
        sides = tuple(float(value >= 0) for value in values)
        if self.touched[0] != snapshot.t:
            return sides
        kept = zip(sides, snapshot.s, values, self.touched[1], strict=True)
        return tuple(latched if value == touched else side for side, latched, value, touched in kept)

    def sides(self, *memory: Any) -> tuple[float, ...]:
        """The values of all crossings; of those that are off, one on the latched side."""
        values = self._beyond(self._sides(*memory), memory[3])
        if not self.gated:
            return values
        s, crossings = memory[3], list(values)
        for j, side in self.gated:
            if not s[side]:
                crossings[j] = 1.0 if s[j] else -1.0
        return tuple(crossings)

    def _beyond(self, values: tuple[float, ...], s: Sequence[float]) -> tuple[float, ...]:
        """Crossings, those that are corners less the slack by which they leave their side."""
        if not any(self.slack):
            return values
        pairs = zip(values, s, self.slack, strict=True)
        return tuple(value + self.looseness * (slack if side else -slack) for value, side, slack in pairs)

    def _told(self, t: float, index: int) -> Iterable[Event]:
        """The event of a cause that fired. Hidden causes are no events, but turning a subdiagram on or off is one."""
        cause = self.causes[index]
        instance = self.plan.instances[cause.instance]
        if not instance.hidden or instance.told_as:
            yield Event(t, instance.told_as or instance.path, cause.name)

    @staticmethod
    def _is_off(side: int | None, snapshot: Snapshot) -> bool:
        return side is not None and not snapshot.s[side]

    def instant(
        self,
        before: Snapshot,
        u: Sequence[float],
        due_events: Iterable[int],
        due_rates: frozenset[int],
        *,
        changed: bool = False,
        seen: Snapshot | None = None,
    ) -> tuple[Snapshot, list[Event]]:
        """Steps 2 to 5 at before.t: `before` itself where nothing changes.

        due_events: indices of events whose time has come. due_rates: rates that tick. changed: inputs or parameters
        are other ones now. seen: the end of the step before its projections, where a side has changed in that step.
        """
        fired: list[Event] = []
        first = {len(self.plan.crossings) + i: before.events[i] for i in due_events}
        waiting = self._postponed(first)
        after = self.quiet(before, u, first, fired, seen)
        if due_rates or waiting:
            after = self.tick(after, u, due_rates, fired)
            after = self.quiet(after, u, {}, fired)
        projected = self.projected(after, u)
        if projected is not after:
            after = self.quiet(projected, u, {}, fired)
        if changed or after is not before:
            after = self.with_event_times(self.with_solutions(after, u), u)
        return after, fired

    def _postponed(self, due: dict[int, float]) -> bool:
        """Let the FMUs that have a time event at this instant wait for their turn; whether there are any.

        due: the event times of the instant; those of FMUs are taken out.
        """
        for unit, part in zip(self.foreign, self.plan.foreign, strict=True):
            index = len(self.plan.crossings) + part.event
            unit.waits = index in due or unit.mode == "event"
            due.pop(index, None)
        return any(unit.waits for unit in self.foreign)

    def quiet(
        self,
        snapshot: Snapshot,
        u: Sequence[float],
        due: dict[int, float],
        fired: list[Event],
        seen: Snapshot | None = None,
    ) -> Snapshot:
        """Fire events and crossings until no side changes any more. seen: what crossings fire by at first."""
        if self.corners is None:
            return self._quiet(snapshot, u, due, fired, seen)
        self.restart = self._restart(snapshot, due, fired)
        try:
            return self._quiet(snapshot, u, due, fired, seen)
        except SimulationError as error:
            restart = self.restart
            if self.foreign.events != restart.fmu_events:
                raise  # FMUs do not go back
            # The sides that are shown are those of no solution: the way to it goes from corner to corner.
            del fired[restart.fired :]
            self.slack = restart.slack
            try:
                after = self._quiet_along(restart.snapshot, u, restart.due, fired)
            except SimulationError:
                after = None
            if after is None:
                raise error
            return after

    def _restart(self, snapshot: Snapshot, due: dict[int, float], fired: Sequence[Event]) -> _Restart:
        return _Restart(snapshot, due, len(fired), self.slack, self.foreign.events)

    def _quiet(
        self,
        snapshot: Snapshot,
        u: Sequence[float],
        due: dict[int, float],
        fired: list[Event],
        seen: Snapshot | None,
    ) -> Snapshot:
        """The same, where all that changes fires at once."""
        plan = self.plan
        snapshot = self._with_own(snapshot, due)
        history: list[str] = []  # what changed, pass by pass
        known = set()
        for _ in range(MOST_PASSES + len(self.order_of_firing.waits)):  # what waits fires a pass later
            values = self.sides_now(snapshot if seen is None else seen, u)
            sides, firing, changed = self._changes(values, snapshot, due)
            late = self._late(changed, firing) if seen is None else frozenset[int]()
            self._check_numbers(values, late, snapshot.t)
            sides, firing, changed, due = self._without(late, snapshot, sides, firing, changed, due)
            asked = self.asked(snapshot, u, firing, changed, late)
            if not firing and not changed and not asked and seen is None:
                return snapshot
            seen = None
            history += [self.name(index) for index in self.order if index in firing or index in changed]
            history += [plan.foreign[k].path for k in asked] if not firing and not changed else []
            z, is_reset = snapshot.z, self.corners is not None and any(j in firing for j in self.corners.resets)
            if self.corners is not None and (asked or is_reset):
                z = self.solutions(*self._memory_now(snapshot, u))  # before FMUs have their events
            snapshot = self._fire(snapshot, u, sides, firing, asked, fired)
            if self.corners is not None:
                if is_reset:
                    snapshot = self._latched_at(z, snapshot, u, firing)
                if asked:  # FMUs do not go back: a way from corner to corner begins after their events
                    self.restart = self._restart(replace(snapshot, z=z), due, fired)
                self._widen(self.with_solutions(snapshot, u), u)
                now = snapshot.x.tobytes(), snapshot.d, snapshot.s, self.slack, self.foreign.events
                if now in known:
                    break
                known.add(now)
        what = "events trigger each other without end"
        cure = "Their effects act back on them at once. Put a UnitDelay or a state between them, or a hysteresis."
        if not {*plan.corners}.isdisjoint((*firing, *changed)):
            what, cure = "the algebraic loop has no solution: its sides change without end", OPEN_THE_LOOP
        raise SimulationError(Fault("E305", history[-1], f"at t = {snapshot.t} s {what}: {_cycle(history)}.", cure))

    def _with_own(self, snapshot: Snapshot, due: dict[int, float]) -> Snapshot:
        """The same with the times of the events that are due."""
        if not due:
            return snapshot
        own = list(snapshot.own)
        for index, time in due.items():
            own[index - len(self.plan.crossings)] = time
        return replace(snapshot, own=tuple(own))

    def _changes(
        self, values: Sequence[float], snapshot: Snapshot, due: dict[int, float]
    ) -> tuple[tuple[float, ...], dict[int, float], list[int]]:
        """Return the sides that crossings show, what fires with what is due, and which sides have changed."""
        sides = self.latched(snapshot, values)
        firing = dict(due)
        changed = []
        for j, value in enumerate(values):
            if not math.isnan(value) and sides[j] != snapshot.s[j]:
                changed.append(j)
                if self.plan.crossings[j].direction in ("both", "up" if sides[j] else "down"):
                    firing[j] = snapshot.t + self.later
        return sides, firing, changed

    def _check_numbers(self, values: Sequence[float], late: frozenset[int], t: float) -> None:
        """Raise SimulationError (E303) where a crossing that need not wait is not a number."""
        for j, value in enumerate(values):
            if math.isnan(value) and j not in late:
                raise self.not_a_number(j, t)

    def _late(self, changed: Sequence[int], firing: Mapping[int, float]) -> frozenset[int]:
        """Return the causes that wait, as crossings change whose sides they see.

        With one that would fire waits what resets memory that it reads, unless nothing went on then. FMUs wait for all
        corners of loops too: they do not go back.
        """
        plan, pairs = self.plan, self.order_of_firing.beside
        units = zip(self.foreign, plan.foreign, strict=True)
        turns = {j for unit, part in units if unit.waits for j in part.crossings}  # these keep their sides until then
        late = more = held = self._behind(changed, frozenset(turns.intersection(changed)))
        while held:
            both = (first for first, other in pairs if other in more and {first, other} <= firing.keys())
            held = frozenset(both) - more
            more = self._behind(changed, more | held)
        if any(index not in more for index in (*firing, *changed)):
            late = more
        is_between = any(j in plan.inner_corners and j not in late for j in changed)
        return late | self.of_fmus if is_between else late

    def _behind(self, changed: Iterable[int], late: frozenset[int]) -> frozenset[int]:
        """Return the late causes, and those that wait for them or for what changes."""
        moving, waiting = {*changed, *late}, {*late}
        for cause, needed in self.order_of_firing.waits if moving else ():
            if not moving.isdisjoint(needed):
                moving.add(cause)
                waiting.add(cause)
        return frozenset(waiting)

    def _without(
        self,
        late: frozenset[int],
        snapshot: Snapshot,
        sides: tuple[float, ...],
        firing: Mapping[int, float],
        changed: list[int],
        due: Mapping[int, float],
    ) -> tuple[tuple[float, ...], dict[int, float], list[int], dict[int, float]]:
        """Return changes without those that wait, and what stays due."""
        if late:
            sides = tuple(old if j in late else new for j, (old, new) in enumerate(zip(snapshot.s, sides, strict=True)))
        rest = {index: time for index, time in firing.items() if index not in late}
        still_due = {index: time for index, time in due.items() if index in late}
        return sides, rest, [j for j in changed if j not in late], still_due

    def _fire(
        self,
        snapshot: Snapshot,
        u: Sequence[float],
        sides: tuple[float, ...],
        firing: dict[int, float],
        asked: Mapping[int, tuple[float, tuple[float, ...]]],
        fired: list[Event],
        *,
        given: bool = False,
    ) -> Snapshot:
        """The same after what fires. given: resets read the solutions of loops that the snapshot has."""
        turned_on = [part for part in self.plan.enabled if sides[part.side] > snapshot.s[part.side]]
        since = [snapshot.d[part.time] for part in turned_on]
        snapshot = self.reset(snapshot, u, sides, firing, asked, given=given)
        for part, begin in zip(turned_on, since, strict=True):
            snapshot = self.turned_on(part, snapshot, u, begin, fired)
        for index in self.order:
            fired += self._told(snapshot.t, index) if index in firing else ()
        return snapshot

    def _latched_at(self, z: Sequence[float], after: Snapshot, u: Sequence[float], fired: Iterable[int]) -> Snapshot:
        """The same with the sides of corners that fired as they are after their resets, before loops are solved again.

        A table that has passed a point looks at the next one from before it, also where the solution moves beyond it.
        """
        assert self.corners is not None
        values = self.corners.crossings(*at(self._memory_now(after, u), z))
        sides = list(after.s)
        for j in self.corners.resets.keys() & fired:
            other = "down" if values[j] >= 0 else "up"  # the direction that does not fire again
            is_other = (values[j] >= 0) != (sides[j] > 0)
            if is_other and self.plan.crossings[j].direction == other:
                sides[j] = 1.0 - sides[j]
        return after if tuple(sides) == after.s else replace(after, s=tuple(sides))

    def _widen(self, solved: Snapshot, u: Sequence[float]) -> None:
        """The slack within an instant grows with the solutions that are tried."""
        assert self.corners is not None
        self.slack = tuple(map(max, self.slack, self.corners.slack(self.memory(solved, u))))

    def loosen(self, snapshot: Snapshot, u: Sequence[float]) -> None:
        """The slack of corners from here on, in a step."""
        if self.corners is not None:
            self.slack = self.corners.slack(self.memory(snapshot, u))

    def _quiet_along(
        self, snapshot: Snapshot, u: Sequence[float], due: dict[int, float], fired: list[Event]
    ) -> Snapshot | None:
        """The same, where corners fire one after the other, on the way from the last solution of the loops to the next.

        None where there is no way.
        """
        corners = self.corners
        assert corners is not None
        snapshot = self._with_own(snapshot, due)
        for _ in range(MOST_CORNERS):
            memory = self._memory_now(snapshot, u)
            end = self.solutions(*memory)
            if not all(map(math.isfinite, end)):
                other = self._other_side(snapshot, memory)
                if other is None:
                    return None
                j, sides = other
                snapshot = self._fire(snapshot, u, sides, self._firing(snapshot, sides, [j]), {}, fired, given=True)
                continue
            self.slack = tuple(map(max, self.slack, corners.slack(at(memory, end))))
            shown = self.sides(*at(memory, end))
            sides, firing, changed = self._changes(shown, snapshot, due)
            late = self._late(changed, firing)
            self._check_numbers(shown, late, snapshot.t)
            sides, firing, changed, still_due = self._without(late, snapshot, sides, firing, changed, due)
            own = [j for j in changed if j in corners.inner]
            if len(still_due) < len(due) or not own:
                # Corners wait until the loop is solved with what else has changed.
                sides = tuple(
                    old if j in own else new for j, (old, new) in enumerate(zip(snapshot.s, sides, strict=True))
                )
                firing = {index: time for index, time in firing.items() if index not in own}
                changed = [j for j in changed if j not in own]
                asked = {} if own else self.asked(snapshot, u, firing, changed, late)
                if not firing and not changed and not asked and not own:
                    return snapshot
                snapshot = snapshot if own else replace(snapshot, z=end)
                snapshot = self._fire(snapshot, u, sides, firing, asked, fired)
                due = still_due
                continue

            def turned_at(z: Sequence[float], memory: Any = memory, late: frozenset[int] = late) -> list[int]:
                values = self._beyond(corners.crossings(*at(memory, z)), memory[3])
                return [
                    j
                    for j in corners.inner
                    if j not in late and not self._is_gated(j, memory[3]) and (values[j] >= 0) != (memory[3][j] > 0)
                ]

            z = first_change(lambda z: bool(turned_at(z)), snapshot.z, end)
            turned = turned_at(z) or own
            sides = snapshot.s
            for j in turned:
                sides = self._turned(sides, j)
            firing = self._firing(snapshot, sides, turned)
            snapshot = self._fire(replace(snapshot, z=z), u, sides, firing, {}, fired, given=True)
            snapshot = self._latched_at(z, snapshot, u, firing)
        return None

    def _is_gated(self, j: int, s: Sequence[float]) -> bool:
        return any(j == other and not s[side] for other, side in self.gated)

    def _firing(self, snapshot: Snapshot, sides: Sequence[float], changed: Sequence[int]) -> dict[int, float]:
        """Those of changed crossings that fire in this direction, with their time."""
        directions = {j: ("both", "up" if sides[j] else "down") for j in changed}
        return {j: snapshot.t + self.later for j in changed if self.plan.crossings[j].direction in directions[j]}

    def _other_side(self, snapshot: Snapshot, memory: Any) -> tuple[int, tuple[float, ...]] | None:
        """The first corner with whose other side the loops have a solution, and the sides then."""
        assert self.corners is not None
        for j in self.corners.inner:
            sides = self._turned(snapshot.s, j)
            if not self._is_gated(j, snapshot.s) and all(
                map(math.isfinite, self.solutions(*memory[:3], sides, *memory[4:]))
            ):
                return j, sides
        return None

    def _memory_now(self, snapshot: Snapshot, u: Sequence[float]) -> tuple[object, ...]:
        """The arguments of a program that looks at crossings at an instant."""
        if not self.later:
            return self.memory(snapshot, u)
        return self.memory(snapshot, self.inputs_later, snapshot.t + self.later)

    def asked(
        self,
        snapshot: Snapshot,
        u: Sequence[float],
        firing: Mapping[int, float],
        changed: Sequence[int],
        late: frozenset[int],
    ) -> dict[int, tuple[float, tuple[float, ...]]]:
        """Return, for the FMUs that have an event now, its time and their inputs."""
        if not self.plan.foreign:
            return {}
        values, fmu_events, first = self.foreign_inputs(*self.memory(snapshot, u)), {}, 0
        for k, part in enumerate(self.plan.foreign):
            inputs = tuple(values[first : first + len(part.inputs)])
            first += len(part.inputs)
            event = len(self.plan.crossings) + part.event
            if self.foreign[k].waits or event in late:
                continue
            crossed = any(j in changed for j in part.crossings)
            if crossed or event in firing or self.foreign[k].has_event(inputs, self.plan):
                fmu_events[k] = max(firing.get(event, snapshot.t), snapshot.t), inputs
        return fmu_events

    def completed(self, snapshot: Snapshot, u: Sequence[float]) -> bool:
        """Report an accepted step to FMUs; whether one of them asks for an event."""
        values, first, asks = self.foreign_inputs(*self.memory(snapshot, u)), 0, False
        for unit, part in zip(self.foreign, self.plan.foreign, strict=True):
            inputs = values[first : first + len(part.inputs)]
            first += len(part.inputs)
            asks |= unit.completed(snapshot.t, snapshot.x[list(part.states)].tolist(), inputs)
        return asks

    def turned_on(
        self, part: EnabledPart, before: Snapshot, u: Sequence[float], since: float, fired: list[Event]
    ) -> Snapshot:
        """A subdiagram begins to go on: anew, or through the event times that have passed since it was turned off."""
        for number, stepper in enumerate(self.plan.steppers):
            if stepper.instance in part.anew:
                self.programs.pop(number, None)
        if part.anew:
            if part not in self._anew:
                name = f"anew_{part.side}"
                self._anew[part] = self.compiled.program(name, part.resets, start=frozenset(part.resets))
            x, d = before.x.copy(), list(before.d)
            for (row, place), value in zip(part.resets, self._anew[part](*self.memory(before, u)), strict=True):
                if not math.isfinite(value):
                    message = f"starts again at {value} when it is turned on at t = {before.t} s."
                    raise SimulationError(Fault("E303", part.path, message, NOT_FINITE))
                if row == "x":
                    x[place] = value
                else:
                    d[place] = value
            return replace(before, x=frozen(x), d=tuple(d))
        snapshot, first = before, len(self.plan.crossings)
        inside = [i for i, cause in enumerate(self.plan.events) if cause.node.instance in part.instances]
        while inside:
            times = self.event_times(*self.memory(snapshot, u, since))
            late = [i for i in inside if not times[i] > since]
            if late:
                raise self._not_ahead(first + late[0], times[late[0]], since)
            since = min(times[i] for i in inside)
            if since > before.t:
                break
            now = {first + i: since for i in inside if times[i] == since}
            snapshot = self.reset(snapshot, u, snapshot.s, now)
            fired += [
                Event(before.t, self.plan.instances[self.causes[i].instance].path, self.causes[i].name) for i in now
            ]
        return snapshot

    def name(self, index: int) -> str:
        """How a cause is called in messages."""
        cause = self.causes[index]
        return f"{self.plan.instances[cause.instance].path}.{cause.name}"

    def reset(
        self,
        before: Snapshot,
        u: Sequence[float],
        sides: tuple[float, ...],
        firing: dict[int, float],
        asked: Mapping[int, tuple[float, tuple[float, ...]]] = MappingProxyType({}),
        *,
        given: bool = False,
    ) -> Snapshot:
        """All resets at once from the values before; then the sides are latched.

        asked: the FMUs that have an event, with its time and their inputs. given: the solutions of loops are those that
        the snapshot has.
        """
        resets: list[tuple[tuple[int, int], Reference, float]] = []
        for index in firing:
            evaluate = self.resets[index]
            if given and self.corners is not None:
                evaluate = self.corners.resets.get(index)
            if evaluate is None:
                continue
            # What joined an instant some ulp away sees its own time: an event, and a crossing where it was seen.
            is_later = self.later > 0.0 and index < len(self.plan.crossings)
            values = evaluate(*self.memory(before, self.inputs_later if is_later else u, firing[index]))
            for rank, (node, place), value in zip(self.ranks[index], self.causes[index].resets, values, strict=True):
                if not math.isfinite(value):
                    message = f"is reset to {value} at t = {before.t} s."
                    raise SimulationError(Fault("E303", self.plan.node_name(node), message, NOT_FINITE))
                resets.append((rank, place, float(value)))
        x, d, begins = before.x.copy(), list(before.d), False
        for k, (time, inputs) in asked.items():
            places = list(self.plan.foreign[k].states)
            begins = begins or self.foreign[k].mode == "event"
            x[places] = self.foreign[k].event(time, before.x[places].tolist(), inputs, self.plan)
        for _, (row, place), value in sorted(resets):
            if row == "x":
                x[place] = value
            else:
                d[place] = self.whole(place, value, before.t)
        after = replace(before, x=frozen(x), d=tuple(d), s=sides)
        return self._with_foreign_sides(after, u, asked) if begins else after

    def _with_foreign_sides(self, snapshot: Snapshot, u: Sequence[float], units: Iterable[int]) -> Snapshot:
        """The same with the sides from which FMUs start: nothing has fired."""
        values, sides = self.crossing_values(snapshot, u), [*snapshot.s]
        for j in (j for k in units for j in self.plan.foreign[k].crossings):
            if math.isnan(values[j]):
                raise self.not_a_number(j, snapshot.t)
            sides[j] = float(values[j] >= 0)
        return replace(snapshot, s=tuple(sides))

    def projected(self, before: Snapshot, u: Sequence[float]) -> Snapshot:
        """What is replaced after each step, all at once, from the values before; `before` itself where nothing is.

        Raises SimulationError (E303) where it is not finite.
        """
        if not self.plan.projections:
            return before
        x, d = before.x.copy(), list(before.d)
        values = self.projections(*self.memory(before, u))
        for (node, (row, place)), value, side in zip(self.plan.projections, values, self.projected_sides, strict=True):
            if self._is_off(side, before):
                continue
            if not math.isfinite(value):
                message = f"became {value} after the step to t = {before.t} s."
                raise SimulationError(Fault("E303", self.plan.node_name(node), message, NOT_FINITE))
            if row == "x":
                x[place] = value
            else:
                d[place] = self.whole(place, float(value), before.t)
        if tuple(d) == before.d and np.array_equal(x, before.x):
            return before
        return replace(before, x=frozen(x), d=tuple(d))

    def tick(self, before: Snapshot, u: Sequence[float], due: frozenset[int], fired: list[Event]) -> Snapshot:
        """The ticks of all due rates: held outputs in dependency order, then the discrete updates at once.

        Where an output sees another one through a side or through what events reset, the events come in between.
        """
        if due not in self._due:
            label = "_".join(map(str, sorted(due)))
            sequence = sequence_at(self.plan, due, self.rate_sets)
            nexts = [pair for k in sorted(due) for pair in self.plan.rates[k].nexts]
            self._due[due] = (
                [
                    item
                    if isinstance(item, UnitPlace)
                    else (
                        self._outputs(f"outputs_{label}_{n}", frozenset(key for key in item if key >= 0)),
                        sorted(-1 - key for key in item if key < 0),
                    )
                    for n, item in enumerate(sequence)
                ],
                (self.compiled.program(f"nexts_{label}", [node for node, _ in nexts]), [slot for _, slot in nexts]),
            )
        sequence_now, update = self._due[due]
        after, is_settled = before, True
        for item in sequence_now:
            if isinstance(item, UnitPlace) and not self.foreign[item.unit].waits:
                continue
            if not is_settled:
                after = self.quiet(after, u, {}, fired)
            if isinstance(item, UnitPlace):
                after = self.quiet(after, u, self._turn(item, after, due), fired)
                is_settled = True
                continue
            (stage, steppers), before_stage, is_settled = item, after, False
            after = self.updated(after, u, stage)
            for number in steppers:
                after = self.stepped(number, before_stage, after, u)
        if update[1] and not is_settled:
            after = self.quiet(after, u, {}, fired)
        after = self.updated(after, u, update)
        return replace(after, ticks=tuple(n + 1 if k in due else n for k, n in enumerate(before.ticks)))

    def _turn(self, place: UnitPlace, now: Snapshot, due: frozenset[int]) -> dict[int, float]:
        """End the wait of an FMU: the time event that it has now; none at the start, where it asks for its first."""
        unit, part = self.foreign[place.unit], self.plan.foreign[place.unit]
        unit.waits = False
        if unit.mode == "event":
            unit.asks = True
            return {}
        unit.is_late |= bool(place.rates & due) or any(self.foreign[k].waits for k in place.units)
        return {len(self.plan.crossings) + part.event: now.events[part.event]}

    def stepped(self, number: int, before: Snapshot, after: Snapshot, u: Sequence[float]) -> Snapshot:
        """What the program of a stepper gives now. Raises SimulationError (E310) where it fails."""
        part = self.plan.steppers[number]
        if self._is_off(self.plan.instances[part.instance].condition, before):
            return after
        if number not in self._inputs:
            references = [reference for _, references, _ in part.inputs for reference in references]
            self._inputs[number] = self.compiled.program(f"stepper_{number}", references)
        flat = self._inputs[number](*self.memory(before, u))
        return replace(after, d=self.stepped_with(number, before.t, flat, after.d))

    def stepped_with(self, number: int, t: float, flat: Sequence[float], d: tuple[float, ...]) -> tuple[float, ...]:
        """The places of d after the program of a stepper took these inputs, element by element."""
        part, first = self.plan.steppers[number], 0
        if number not in self.programs:
            self.programs[number] = self.made(part)
        given: dict[str, object] = {}
        for name, elements, shape in part.inputs:
            own = flat[first : first + len(elements)]
            given[name] = np.array(own, dtype=float).reshape(shape) if shape else float(own[0])
            first += len(elements)
        try:
            return self._taken(part, self.programs[number].step(t, **given), d, t)
        except SimulationError:
            raise
        except Exception as error:  # a program of the user may raise anything
            message = f"raised {type(error).__name__} at t = {t} s{_line(error)}: {error}"
            raise self._failed(part, message) from error

    def _failed(self, part: StepperPart, message: str) -> SimulationError:
        return SimulationError(Fault("E310", part.path, f"its stepper {message}.", "Correct this program."))

    def made(self, part: StepperPart) -> Any:
        """The program of a stepper, new."""
        try:
            program = part.make()
        except Exception as error:  # a program of the user may raise anything
            raise self._failed(part, f"could not be created: {type(error).__name__}{_line(error)}: {error}") from error
        if not callable(getattr(program, "step", None)):
            raise self._failed(part, f"is {program!r}, which has no step(t, **inputs)")
        return program

    def saved(self, number: int) -> Any:
        """What a stepper gives to be saved; None: it has not begun. Raises UsageError (E506) where it gives none."""
        program, part = self.programs.get(number), self.plan.steppers[number]
        if program is None:
            return None
        if not callable(getattr(program, "save", None)) or not callable(getattr(program, "restore", None)):
            cure = "Give its program save() and restore(value)."
            raise UsageError(Fault("E506", part.path, "its stepper cannot be saved.", cure))
        try:
            return json.loads(json.dumps({"saved": program.save()}, allow_nan=False))
        except Exception as error:  # a program of the user may raise anything
            message = f"its stepper cannot be saved: {type(error).__name__}: {error}."
            cure = "save() must return a value that JSON can hold."
            raise UsageError(Fault("E506", part.path, message, cure)) from error

    def restore(self, number: int, blob: Any) -> None:
        """Restore a stepper as it was saved. Raises UsageError (E506)."""
        if blob is not None:
            part = self.plan.steppers[number]
            program = self.made(part)
            with restoring(part.path, "its stepper"):
                program.restore(copy.deepcopy(blob["saved"]))
            self.programs[number] = program

    def _taken(self, part: StepperPart, returned: object, before: tuple[float, ...], t: float) -> tuple[float, ...]:
        """The outputs of a stepper in their places."""
        if not isinstance(returned, Mapping):
            returned = {part.outputs[0][0]: returned} if len(part.outputs) == 1 else returned
        names = [name for name, _, _ in part.outputs]
        if not isinstance(returned, Mapping) or sorted(returned) != sorted(names):
            what = ", ".join(map(str, returned)) if isinstance(returned, Mapping) else repr(returned)
            raise self._failed(part, f"returned {what or 'nothing'}, but its outputs are {', '.join(names) or 'none'}")
        d = list(before)
        for (name, slots, shape), type_ in zip(part.outputs, part.types, strict=True):
            values = np.asarray(returned[name], dtype=float)
            if values.shape not in (shape, ()) or not np.isfinite(values).all():
                raise self._failed(part, f"returned {returned[name]!r} for '{name}' at t = {t} s")
            if type_ != "real" and not np.all(values == np.floor(values)):
                raise self._failed(part, f"returned {returned[name]!r} for '{name}', which is {type_} (t = {t} s)")
            if type_ == "bool" and not np.all((values == 0) | (values == 1)):
                raise self._failed(part, f"returned {returned[name]!r} for '{name}', which is a bool (t = {t} s)")
            for slot, value in zip(slots, np.broadcast_to(values, shape).ravel(), strict=True):
                d[slot] = self.whole(slot, float(value), t)
        return tuple(d)

    def _outputs(self, name: str, stage: frozenset[int]) -> _Update:
        slots = sorted(stage)
        return self.compiled.program(name, [Reference("d", slot) for slot in slots], due=stage), slots

    def updated(self, before: Snapshot, u: Sequence[float], update: _Update) -> Snapshot:
        """Places in d replaced, all at once. Raises SimulationError (E303) where one is not finite."""
        program, slots = update
        d = list(before.d)
        for slot, value in zip(slots, program(*self.memory(before, u)), strict=True):
            if self._is_off(self.slot_sides.get(slot), before):
                continue
            if not math.isfinite(value):
                message = f"became {value} at its tick at t = {before.t} s."
                nexts = [node for rate in self.plan.rates for node, place in rate.nexts if place == slot]
                asked, due = (nexts, frozenset[int]()) if nexts else ([Reference("d", slot)], frozenset([slot]))
                cure = self.compiled.cure(asked, self.memory(before, u), due=due)
                raise SimulationError(Fault("E303", self.plan.discretes[slot], message, cure))
            d[slot] = self.whole(slot, float(value), before.t)
        return replace(before, d=tuple(d))

    def whole(self, slot: int, value: float, t: float) -> float:
        """A value for a place in d. Raises SimulationError (E309) where an integer is too large, or no member."""
        members = self.plan.integers.get(slot)
        if members is None or (value in members if members else abs(value) <= 2**53):
            return value
        if members:
            what, cure = f"which is none of {sorted(map(int, members))}", "Its equation must give one of them."
        else:
            what, cure = "beyond 2^53, where doubles cannot hold all integers", "Reset it earlier, or make it real."
        message = f"became {value:.17g} at t = {t} s, {what}."
        raise SimulationError(Fault("E309", self.plan.discretes[slot], message, cure))

    def not_a_number(self, j: int, t: float) -> SimulationError:
        return SimulationError(Fault("E303", self.name(j), f"is not a number at t = {t} s.", NOT_FINITE))

    def distance(self, values: Array, sides: Array) -> Array:
        """How far crossings are beyond their latched sides: negative on the side, zero or positive once it changed."""
        return np.where(sides, np.where(values == 0.0, -_TINY, -values), values)
