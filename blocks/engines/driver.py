"""A run under way: an engine, and all that surrounds it.

    run = Simulation(engine)              # at its start; state=...: where a saved one stood
    run.advance_to(stop)
    run.results()

Here, for all engines, are the loop over moments of a run, Ctrl-C, the reported progress, the watch over memory, and
failures, which carry the results so far.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction

from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..fmi.exits import Ended
from ..host.available_memory import Watch
from ..results.provenance import Origin
from ..results.results import Between, Event, Events, Results
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, FMUError, ModelError, SimulationError
from .run.engine import Engine
from .run.memory_estimate import COPIES, COPIES_OF_MASTER, no_room
from .run.saved_state import State
from .run.stiffness import StiffWatch


class Simulation:
    """One run by an engine. progress: called with t after each moment that has brought the run on.

    state: where a saved run stood, from which it goes on. Raises SimulationError and FMUError where it cannot begin.
    """

    def __init__(
        self, engine: Engine, *, progress: Callable[[float], None] | None = None, state: State | None = None
    ) -> None:
        self.engine, self.progress = engine, progress
        self.notice: Callable[[Fault], None] | None = None  # called with a warning when it is found
        self.found: tuple[Fault, ...] = ()  # the warnings so far
        self.flush: Callable[[], None] | None = None  # called after each moment, as `progress` is
        self.watch = Watch()
        self.taken_bytes = 0.0  # of rows that `until` took from the engine and keeps
        self.interrupted, self.seconds = False, 0.0
        self.is_telling = False  # `progress` runs, whose errors are not those of this run
        self._check_range(engine.plan.settings.start)
        with self._guarded():
            if state is None:
                engine.start()
            else:
                engine.go_on_from(state)
        self.stiffness = StiffWatch(engine)

    @property
    def t(self) -> float:
        """The time in s that the run has reached."""
        return self.engine.t

    @property
    def exact(self) -> Fraction:
        """The same as a fraction."""
        exact = self.engine.exact
        return exact if exact is not None else Fraction(self.engine.t)

    @property
    def over(self) -> Fault | None:
        """The warning that something ended the run (W206, W307)."""
        return self.engine.over

    @property
    def tried(self) -> int:
        """How many steps it has tried: those that were rejected count too."""
        return self.engine.tried

    @property
    def steps(self) -> int:
        """How many steps it has taken."""
        return self.engine.steps

    @property
    def recorded_bytes(self) -> float:
        return self.engine.recorded_bytes + self.taken_bytes

    def advance_to(self, stop: Fraction, until: Callable[[], bool] | None = None) -> bool:
        """Run up to and including the instant at `stop`, or to where something ends the run.

        until: asked at first and after each moment, whether it is enough; no step is cut for it. It may set what can be
        set, and take rows. Returns whether it was.

        Raises SimulationError and FMUError, with the results so far, where it fails. After KeyboardInterrupt the run
        stands at the last moment that counts, and `interrupted` is set; it can go on from there.
        """
        self._check_range(stop)
        engine, self.interrupted = self.engine, False
        copies = COPIES_OF_MASTER if isinstance(engine.plan, Coupling) else COPIES
        with self._guarded():
            try:
                with engine.hearing() as look_up:
                    is_there = False
                    while not is_there:
                        if until is not None and until():
                            return True
                        t = engine.t
                        is_there = engine.proceed(stop)
                        look_up()
                        if engine.t == t:  # an instant, or a step that was refused
                            continue
                        self.watch.look(self.recorded_bytes, copies)
                        if self.flush is not None:
                            self.flush()
                        if (found := self.stiffness.look(engine)) is not None:
                            self.found = (*self.found, found)
                            if self.notice is not None:
                                self.notice(found)
                        if self.progress is not None:
                            self.is_telling = True
                            self.progress(engine.t)
                            self.is_telling = False
                            look_up()  # one that came meanwhile, which may be the last moment
            except KeyboardInterrupt:
                self.interrupted = True
        return False

    def set_input(self, index: int, value: Array) -> None:
        """An input jumps now."""
        with self._guarded():
            self.engine.set_input(index, value)

    def set_parameters(self, plan: Plan | Coupling) -> None:
        """Tunable parameters change now; the plan is the same but for their values."""
        with self._guarded():
            self.engine.set_parameters(plan)

    def values(self, references: tuple[object, ...]) -> tuple[float, ...]:
        """Values now."""
        with self._guarded(is_reading=True):
            return self.engine.values(references)

    def snapshot(self, overrides: Mapping[str, object]) -> State:
        """What the rest of the run follows from. overrides: the raw values of parameters that were given or set."""
        with self._guarded(is_reading=True):
            return self.engine.snapshot(overrides)

    def results(
        self, *, origin: Origin | None = None, before: tuple[Fault, ...] = (), between: Between | None = None
    ) -> Results:
        """Return the results up to now. before: warnings to list before those of the run."""
        plan, recorded, over = self.engine.plan, self.engine.recorded(), self.over
        return Results(
            plan.name, recorded.t, recorded.values, dict(plan.recorded), _told_once(recorded.events, plan),
            recorded.measures, replace(recorded.statistics, seconds=self.seconds), self.interrupted, origin,
            (*before, *self.found, *recorded.warnings, *(() if over is None else (over,))), between,
        )  # fmt: skip

    @contextmanager
    def _guarded(self, *, is_reading: bool = False) -> Iterator[None]:
        """The time that it takes, and failures that carry the results so far. is_reading: an interrupt ends nothing."""
        begun = time.perf_counter()
        try:
            yield
            return
        except Ended:
            raise
        except (SimulationError, FMUError) as error:
            if self.is_telling or error.results is not None:  # of another run, or told already: of what `until` has set
                self.engine.abandon()
                raise
            failed: SimulationError | FMUError = error
        except MemoryError:
            failed = no_room(self.engine.plan.name, self.engine.t, self.recorded_bytes)
        except BlocksError:
            raise
        except BaseException:
            if not is_reading:
                self.engine.abandon()
            raise
        finally:
            self.seconds += time.perf_counter() - begun
            self.is_telling = False
        results = self.results()
        self.engine.abandon()
        rest = f"Results up to {results.t[-1]:.10g} s are kept." if len(results.t) else ""
        told = (replace(f, cure=f"{f.cure} {rest}".strip()) for f in failed.faults)
        raise (FMUError if isinstance(failed, FMUError) else SimulationError)(*told, results=results) from (
            failed.__cause__
        )

    def _check_range(self, t: Fraction) -> None:
        """Raise ModelError (E119) where ticks could not be counted up to t."""
        plan = self.engine.plan
        if isinstance(plan, Plan) and plan.rates and abs(t / plan.base) > 2**53:
            message = f"{float(t)} s is more than 2^53 times {float(plan.base)} s, the common base of all ticks."
            raise ModelError(Fault("E119", plan.name, message, "Choose periods with a larger common base."))


def _told_once(events: tuple[Event, ...] | Events, plan: Plan | Coupling) -> tuple[Event, ...] | Events:
    """Return events with each indicator of an FMU once at each time: the event itself may turn the indicator back."""
    parts = [plan] if isinstance(plan, Plan) else [unit.plan for unit in plan.units if unit.plan is not None]
    foreign = {part.instances[fmu.instance].path for part in parts for fmu in part.foreign}
    if not foreign:
        return events
    seen: set[Event] = set()

    def is_new(event: Event) -> bool:
        known = event in seen
        if event.block in foreign:
            seen.add(event)
        return not known

    return tuple(filter(is_new, events))
