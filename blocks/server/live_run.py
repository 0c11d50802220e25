"""A run that a person watches and turns: in a thread of its own, paused, stepped and paced, with its rows to look at.

It is the run of `blocks run`: the same engine, led by the same `Simulation`, which asks between its moments whether to
go on; no step is cut for a pause. What was set is known by the step it came after, so that a script has the same bits.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from ..api.run import Run
from ..engines.driver import Simulation
from ..engines.run.memory_estimate import COPIES_OF_MASTER
from ..host.available_memory import Watch
from ..model.wires import BlockSource, ValueSource
from ..results.results import Event, Results
from ..text.arrays import Array
from ..text.element_names import element_names
from ..text.errors import BlocksError, Fault, FMUError, SimulationError, UsageError

SLICE = 0.01
"""s of computing after which the engine comes back at the latest."""
PERIOD = 0.03
"""s between two looks at the rows, and between two looks at the clock of a paced run."""
LAST = 20
"""Rows before a failure that are shown."""
SHARE = 20
"""The looks at the rows take one part in so many of the time."""
PATIENCE = 5.0
"""s that who asks the run waits for its next moment."""
LONGEST = 60.0
"""s that it waits at most before it looks again; a very slow pace waits for longer than a clock can count."""

_Made = TypeVar("_Made")


@dataclass(frozen=True, slots=True)
class Turned:
    """What was set: after how many steps, at which time in s, the name of an input or the path of a parameter."""

    steps: int
    t: float
    name: str
    value: Any


class LiveRun:
    """A Run in its own thread, which stands at the start until it is told to `go`. Any thread may call all of it.

    changed: called by the thread of the run when there is something new, at most every 30 ms and when its state
    changes; it must not wait for the run. state: "running", "paused", "done", "stopped" or "failed" (`error` says why;
    the rows up to there stay). t, steps, rejected, seconds (of computing), lag (how far it is behind the clock, in s)
    and `rows` are those of the last look. columns: of each signal the first of its columns, its shape and unit.
    """

    def __init__(self, run: Run, changed: Callable[[], None]) -> None:
        results = run.results
        self.columns: Mapping[str, tuple[int, tuple[int, ...], str]] = results.columns
        self.changed, self.prepared, self.options, self.case = changed, run.prepared, run.options, run.case
        self.state, self.error = "paused", None  # type: str, BlocksError | None
        self.t, self.steps, self.rejected = run.t, 0, 0
        self.pace: float | None = None
        self.lag = self.seconds = 0.0
        self.turned: list[Turned] = []
        self._events = results.events
        self._rows = _Rows(1 + results.values.shape[1])
        self._rows.show(results)
        self._final: Results | None = None
        self._blamed: dict[str, int] = {}
        self._run: Run | None = run
        self._condition = threading.Condition()
        self._wish, self._version = "paused", 0  # running, step, paused or stopped; how often something was asked
        self._asked: deque[tuple[Callable[[Simulation], Any], Future[Any]]] = deque()
        self._is_standing = False  # all of this moment has happened, and is shown
        self._is_shown = False  # what was known at a look at this moment
        self._at = math.nan  # the time of the last moment
        self._soft = math.inf  # the time at which the engine comes back
        self._stepped_from: float | None = None
        self._origin: tuple[float, float] | None = None  # the clock, and the time of the run, from which it is paced
        self._next = self._left = 0.0  # when to look at the rows; when the engine went on
        self._watch = Watch()
        self._thread = threading.Thread(target=self._live, name=f"live run of {run.plan.name}", daemon=True)
        self._thread.start()

    # --- from other threads ------------------------------------------------------------------------------------------

    def go(self, pace: float | None = None) -> None:
        """Go on; pace: simulated s per s of the clock, None: as fast as it goes. Raises UsageError (E501)."""
        check_pace(pace)
        with self._condition:
            self.pace, self._origin, self.lag = pace, None, 0.0
            self._wish_for("running")

    def pause(self) -> None:
        """Stand at the next moment of the engine."""
        with self._condition:
            self._wish_for("paused")

    def step(self) -> None:
        """Take one step, with all that happens at its end."""
        with self._condition:
            self._stepped_from = None
            self._wish_for("step")

    def stop(self) -> None:
        """End the run; what it has recorded stays, FMUs are freed. `wait` waits for it."""
        with self._condition:
            self._wish_for("stopped")

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the run is over; whether it is."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def set(self, name: str, value: object) -> Turned:
        """Set an input, or a tunable parameter by its path, at the next moment. Raises UsageError, ModelError."""
        return self._ask(lambda simulation: self._set(simulation, name, value))

    def results(self) -> Results:
        """All that was recorded up to now."""
        if self._final is None:
            try:
                return self._ask(lambda simulation: self._joined(self._present.results, is_final=False))
            except UsageError:
                if self._final is None:
                    raise
        return self._final

    def rows(self) -> tuple[Array, Array]:
        """Times (n,) and values (n, columns) up to the last look: views. The last row may change where it is set."""
        return self._rows.view

    def events(self, since: int = 0) -> list[Event]:
        """The events from the since-th on."""
        return list(self._events[since:])

    def rejected_by_block(self) -> dict[str, int]:
        """As of `Run`."""
        try:
            return self._ask(lambda simulation: self._present.rejected_by_block)
        except UsageError:
            if not self.is_over:
                raise
        self._thread.join()
        return self._blamed

    def _wish_for(self, wish: str) -> None:
        if not self.is_over and self._wish != "stopped":
            self._wish, self._version = wish, self._version + 1
            self.state = "running" if wish in ("running", "step") else self.state
        self._condition.notify_all()

    @property
    def is_over(self) -> bool:
        return self.state in ("done", "stopped", "failed")

    def _ask(self, what: Callable[[Simulation], _Made]) -> _Made:
        """What the thread of the run answers at its next moment. Raises UsageError (E501): that does not come."""
        future: Future[_Made] = Future()
        with self._condition:
            if not self.is_over:
                self._asked.append((what, future))
                self._version += 1
                self._condition.notify_all()
            else:
                future.set_exception(self._no_more())
        try:
            return future.result(PATIENCE)
        except TimeoutError:
            if not future.cancel():  # it is being answered
                return future.result()
            raise UsageError(self.busy) from None

    @property
    def busy(self) -> Fault:
        """The fault that it comes to no moment."""
        message = f"has been computing one step for more than {PATIENCE:g} s."
        cure = 'Wait, or stop the server. If an FMU hangs, run it with "isolate" and "timeout".'
        return Fault("E501", self.prepared.plan.name, message, cure)

    def _no_more(self) -> UsageError:
        return UsageError(Fault("E501", self.prepared.plan.name, "the run is over.", "Start another run."))

    # --- in the thread of the run ------------------------------------------------------------------------------------

    @property
    def _present(self) -> Run:
        assert self._run is not None
        return self._run

    def _live(self) -> None:
        run, state = self._present, "failed"
        self._left = perf_counter()
        try:
            state = "stopped" if run.advance_until(self._is_enough) else "done"
            self._final = self._joined(run.results.changed(interrupted=state == "stopped"))
        except (SimulationError, FMUError) as error:
            self.error = error
            error.results = self._final = self._joined(error.results if error.results is not None else run.results)
        except Exception as error:
            state, self.error = "failed", error if isinstance(error, BlocksError) else SimulationError(own_fault(error))
            self._final = self._joined(run.results)
        finally:
            self._end(run, state)

    def _end(self, run: Run, state: str) -> None:
        """Nothing goes on: rows are shown, who waits is told, and what the run holds is freed."""
        final = self._final
        if final is not None:
            self._events, self.steps, self.rejected = final.events, final.statistics.steps, final.statistics.rejected
        self.t, self._blamed = run.t, run.rejected_by_block
        with self._condition:
            self.state, self._run = state, None
            asked, self._asked = self._asked, deque()
        for _, future in asked:
            future.set_exception(self._no_more())
        run.end()
        self.changed()

    def _is_enough(self, simulation: Simulation) -> bool:
        """Between two moments: answer, wait, look at the rows; whether the run is to stop."""
        entered = perf_counter()
        self.seconds += entered - self._left
        is_quiet = not self._asked and self._wish == "running" and simulation.t < self._soft and entered < self._next
        try:
            return not is_quiet and self._turn(simulation)
        finally:
            self._left = perf_counter()
            simulation.seconds -= self._left - entered

    def _turn(self, simulation: Simulation) -> bool:
        if simulation.t != self._at:  # a set is known by its time: it comes at the first moment of that, not later
            self._at, self._is_standing, self._is_shown = simulation.t, False, False
            while self._wish != "stopped":
                version = self._version
                self._answer(simulation)
                seconds = self._seconds_here(simulation)
                if seconds <= 0.0:
                    break
                with self._condition:
                    if self._version == version:
                        self._condition.wait(None if seconds == math.inf else min(seconds, LONGEST))
        if self._wish == "stopped":
            simulation.values(())  # what is outstanding happens
            self._look(simulation)
            return True
        if perf_counter() >= self._next:
            self._look(simulation)
            self.changed()
        return False

    def _answer(self, simulation: Simulation) -> None:
        """Do what was asked for."""
        while self._asked:
            what, future = self._asked.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(what(simulation))
            except BaseException as error:
                future.set_exception(error)
                if isinstance(error, (SimulationError, FMUError)) or not isinstance(error, BlocksError):
                    raise  # of the run itself

    def _seconds_here(self, simulation: Simulation) -> float:
        """How long it stands here (s), unless something is asked for; 0: it goes on, as the engine is told."""
        t = simulation.t
        with self._condition:
            if self._wish == "step":
                if self._stepped_from is None:
                    self._stepped_from = t
                if t == self._stepped_from:
                    return self._go_on(simulation, math.nextafter(t, math.inf))
                self._wish = "paused"
            wish, pace = self._wish, self.pace
            if wish == "running" and pace is not None and self._origin is None:
                self._origin = (perf_counter(), t)
        if wish == "paused":
            self._stand(simulation)
            return math.inf
        if pace is None:
            return self._go_on(simulation, math.inf)
        clock = self._clock(pace)
        if t > clock:
            seconds, early = (t - clock) / pace, self._next - perf_counter()
            if not self._is_shown and early > 0.0:
                return min(seconds, early)
            if not self._is_shown:
                self._look(simulation)
                self.changed()
            return seconds
        return self._go_on(simulation, max(clock + PERIOD * pace, math.nextafter(t, math.inf)))

    def _clock(self, pace: float) -> float:
        """The time that a paced run should be at now."""
        begun, t = self._origin or (perf_counter(), self._at)
        return t + (perf_counter() - begun) * pace

    def _go_on(self, simulation: Simulation, soft: float) -> float:
        self._soft = soft
        simulation.engine.pause(SLICE, soft)
        return 0.0

    def _stand(self, simulation: Simulation) -> None:
        """It is paused: all that belongs to this moment has happened, and is shown."""
        if not self._is_standing or self.state != "paused":  # told to go on and to pause at once
            simulation.values(())
            self._look(simulation)
            with self._condition:
                self.state = "paused" if self._wish == "paused" else self.state
            self._is_standing = True
            self.changed()

    def _set(self, simulation: Simulation, name: str, value: object) -> Turned:
        simulation.values(())  # as `advance_past` does
        self._present.set(name, value)
        self._is_standing = self._is_shown = False
        self.turned.append(turned := Turned(simulation.steps, simulation.t, name, value))
        return turned

    def _look(self, simulation: Simulation) -> None:
        """Take over the rows since the last look, and how the run stands."""
        begun = perf_counter()
        self._rows.add(simulation.engine.taken())
        results = simulation.results()  # with the last row alone
        self._rows.show(results)
        self._events, self._is_shown = results.events, True
        self.t, self.steps, self.rejected = simulation.t, simulation.steps, simulation.tried - simulation.steps
        if self.pace is not None and self._wish == "running":
            self.lag = max(0.0, (self._clock(self.pace) - self.t) / self.pace)
        simulation.taken_bytes = self._rows.bytes
        self._watch.look(self._rows.bytes, COPIES_OF_MASTER)
        now = perf_counter()
        self._next = now + max(PERIOD, SHARE * (now - begun))

    def _joined(self, results: Results, *, is_final: bool = True) -> Results:
        """Results with all rows; of a run that goes on, a copy of these."""
        with contextlib.suppress(MemoryError):  # the last rows have no place
            self._rows.show(results)
        t, values = self._rows.view
        return results.changed(t=t if is_final else t.copy(), values=values if is_final else values.copy())

    # --- what went wrong ---------------------------------------------------------------------------------------------

    def failing(self) -> dict[str, object] | None:
        """The block that a failed run failed in, and the last rows of what it reads and gives, where that is recorded.

        {"block": path, "signals": names of elements, "t": times, "rows": values by time}; None where no block is known.
        """
        flat = self.prepared.flat
        places = {block.path: k for k, block in enumerate(flat.blocks) if not block.hidden}
        path = "" if self.error is None else self.error.faults[0].place
        while path and path not in places:
            path = path.rpartition(".")[0]
        if not path:
            return None
        sources = flat.blocks[places[path]].sources.values()
        read = {source for each in sources for source in each if not isinstance(source, ValueSource)}
        columns: tuple[dict[str, int], dict[str, int]] = {}, {}  # of what it reads, and of what it gives
        for name, (first, shape, _) in self.columns.items():
            its = flat.signals[name if name in flat.signals else name.rpartition("[")[0]].sources
            is_given = any(isinstance(source, BlockSource) and source.block == places[path] for source in its)
            if is_given or read.intersection(its):
                elements = enumerate(element_names(name, shape), first)
                columns[is_given].update({element: k for k, element in elements})
        told = columns[0] | columns[1]
        t, values = self.rows()
        rows = values[-LAST:][:, list(told.values())]
        return {"block": path, "signals": list(told), "t": t[-LAST:].tolist(), "rows": rows.tolist()}

    # --- to do it again ----------------------------------------------------------------------------------------------

    def script(
        self, path: str | Path, *, library: Sequence[str] = (), variants: Mapping[str, str] | None = None
    ) -> str:
        """A Python script that runs the diagram of a file as this run went: it gives the same bits.

        library: names of modules with block types. variants: those that the run was begun with.
        """
        case = self.case
        given = {**dict(self.prepared.settings), "interpolation": case.interpolation, "variants": variants}
        given.update(parameters=dict(self.prepared.parameters), inputs=case.inputs, engine=case.engine)
        given["trust"] = [os.fspath(item) for item in case.trust]
        usual = {"interpolation": "linear", "parameters": {}, "inputs": {}, "variants": {}, "trust": []}
        told = {key: value for key, value in given.items() if value is not None and value != usual.get(key)}
        arguments = ", ".join(f"{key}={_literal(value)}" for key, value in told.items())
        loaded = ", ".join([repr(str(path)), *([f"library={list(library)!r}"] if library else [])])
        lines = ["from blocks import Diagram", "", f"run = Diagram.load({loaded}).start({arguments})"]
        for turned in self.turned:
            lines.append(f"run.advance_past({turned.t!r})  # {turned.steps} steps")
            lines.append(f"run.set({turned.name!r}, {_literal(turned.value)})")
        if self.state == "done" and self.prepared.plan.settings.stop is not None:
            lines.append("results = run.finish()")
        else:
            lines += [f"run.advance_past({self.t!r})  # {self.steps} steps", "results = run.results"]
        return "\n".join([*lines, ""])


def check_pace(pace: float | None) -> None:
    """Raise UsageError (E501) for what is no pace."""
    if pace is not None and not (isinstance(pace, (int, float)) and 0.0 < pace < math.inf):
        raise UsageError(Fault("E501", "pace", f"must be a number above 0, not {pace!r}.", "Use 1 for real time."))


def own_fault(error: Exception) -> Fault:
    """The fault that an exception is: of blocks itself (E901), or that there is no memory (E311)."""
    if isinstance(error, MemoryError):
        cure = "Forget earlier runs, record fewer signals (log), or record on a coarser grid (every)."
        return Fault("E311", "", "the memory does not suffice for this.", cure)
    return Fault("E901", "", f"blocks itself failed ({type(error).__name__}: {error}).", "Please report it.")


class _Rows:
    """Rows in one array that grows; those that were added stay as they are. view: times and values, which may be read
    while others are added.
    """

    def __init__(self, width: int) -> None:
        self.kept, self.n = np.empty((1024, width)), 0
        self.view: tuple[Array, Array] = self.kept[:0, 0], self.kept[:0, 1:]

    @property
    def bytes(self) -> float:
        return float(8 * self.n * self.kept.shape[1])

    def add(self, rows: Array) -> None:
        """Rows that do not change any more."""
        end = self.n + len(rows)
        self._put(self.n, rows)
        self.n = end

    def show(self, results: Results) -> None:
        """The rows after those, which may still change: both are seen from now on."""
        end = self.n + len(results.t)
        self._put(self.n, np.column_stack([results.t, results.values]))
        self.view = self.kept[:end, 0], self.kept[:end, 1:]

    def _put(self, first: int, rows: Array) -> None:
        if first + len(rows) > len(self.kept):
            more = np.empty((2 * (first + len(rows)), self.kept.shape[1]))
            more[:first] = self.kept[:first]
            self.kept = more
        self.kept[first : first + len(rows)] = rows


def _literal(value: object) -> str:
    """A value as Python reads it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_literal(each)}" for key, each in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + "".join(f"{_literal(each)}, " for each in value) + ")"
    if isinstance(value, list):
        return "[" + ", ".join(map(_literal, value)) + "]"
    if isinstance(value, Path):
        return repr(str(value))
    return repr(value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value)
