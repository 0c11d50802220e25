"""A run in a thread of its own, which can be paused, paced and turned while it goes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ..api.run import Run
from ..results.results import Results
from ..text.errors import BlocksError

__all__ = ["LiveRun", "Turned"]

Array = np.ndarray[Any, Any]
SLICE = Fraction(1, 50)


class Turned(NamedTuple):
    """A value that was set: after so many accepted steps, at t in s."""

    steps: int
    t: float
    name: str
    value: Any


class LiveRun:
    """A run that stands at its start until `go`. changed: called from its thread when there is something new."""

    def __init__(self, run: Run, changed: Callable[[], None]) -> None:
        self.run, self._changed = run, changed
        self.state, self.error = "paused", None  # type: str, BlocksError | None
        self.pace: float | None = None
        self.lag = self.seconds = 0.0
        self.turned: list[Turned] = []
        self._todo: list[Callable[[], None]] = []
        self._wake = threading.Condition()
        self._is_over = False
        self._results: Results = run.results
        self.columns = {
            name: (first, signal.shape, signal.unit)
            for name, first in _firsts(run)
            for signal in [run.plan.signal(name)]
        }
        self._thread = threading.Thread(target=self._work, daemon=True, name="live run")
        self._thread.start()

    @property
    def t(self) -> float:
        return self.run.t

    @property
    def steps(self) -> int:
        return self._results.statistics.steps

    @property
    def rejected(self) -> int:
        return self._results.statistics.rejected

    def go(self, pace: float | None = None) -> None:
        self.pace = pace
        self._become("running")

    def pause(self) -> None:
        self._become("paused")

    def step(self) -> None:
        self._later(self._advance)

    def stop(self) -> None:
        self._is_over = True
        self._become("stopped")

    def set(self, name: str, value: Any) -> Turned:
        done = threading.Event()
        failure: list[BlocksError] = []

        def act() -> None:
            try:
                self.run.set(name, value)
                self.turned.append(Turned(self.steps, self.t, name, value))
            except BlocksError as error:
                failure.append(error)
            done.set()

        self._later(act)
        done.wait(5.0)
        if failure:
            raise failure[0]
        return self.turned[-1]

    def rows(self) -> tuple[Array, Array]:
        return self._results.t, self._results.values

    def events(self, since: int = 0) -> list[Any]:
        return list(self._results.events)[since:]

    def results(self) -> Results:
        return self._results

    def _become(self, state: str) -> None:
        with self._wake:
            if self.state in ("running", "paused"):
                self.state = state
            self._wake.notify_all()

    def _later(self, act: Callable[[], None]) -> None:
        with self._wake:
            self._todo.append(act)
            self._wake.notify_all()

    def _work(self) -> None:
        while not self._is_over:
            with self._wake:
                while not self._todo and self.state != "running" and not self._is_over:
                    self._wake.wait()
                todo, self._todo = self._todo, []
            for act in todo:
                act()
            if self.state == "running":
                self._advance()
            self._changed()

    def _advance(self) -> None:
        begun = time.perf_counter()
        stop = self.run.settings.stop
        try:
            end = Fraction(self.run.t) + SLICE
            self.run.advance_to(end if stop is None else min(end, stop))
            if stop is not None and self.run.t >= float(stop):
                self.state = "done"
        except BlocksError as error:
            self.error, self.state = error, "failed"
        self._results = self.run.results
        self.seconds += time.perf_counter() - begun
        if self.pace:
            time.sleep(max(0.0, float(SLICE) / self.pace))


def _firsts(run: Run) -> list[tuple[str, int]]:
    named, first = [], 0
    for name in run.plan.log:
        named.append((name, first))
        first += len(run.plan.signal(name).references)
    return named
