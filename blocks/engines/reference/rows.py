"""Which rows a run records: of a grid, of all steps, of both sides of a jump, and between steps where signals turn."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ...compile.plan import Plan
from ...compile.time_grid import Grid, within_ulps
from ...host.available_memory import Watch
from ...text.arrays import Array
from ..run.memory_estimate import COPIES
from ..run.recording import Recording
from ..run.snapshot import Snapshot
from ..run.step_parts import BETWEEN_ROWS, LEFT_OUT
from ..run.step_polynomial import Interpolant
from .inside_step import InsideStep, in_time

Row = tuple[float, ...]
_AT_ONCE = 4096  # rows of the grid
MOST_BETWEEN = 100_000  # rows inside steps, in a run without a grid


class RunRows:
    """The rows of a run, and where it stands in them.

    values: the recorded values at a time and states of the step under way. scale: the size of the times that those of
    the run are computed from. is_silent: nothing is recorded, as the caller does.
    """

    def __init__(
        self, plan: Plan, columns: int, inside: InsideStep, values: Callable[[float, Array], Row], scale: float,
        *, is_silent: bool = False,
    ) -> None:  # fmt: skip
        settings = plan.settings
        self.settings, self.inside, self.values, self.scale = settings, inside, values, scale
        self.is_silent = is_silent
        self.recording = Recording(columns)
        self.watch = Watch()
        self.every = Grid.of(settings.start, settings.every) if settings.every is not None else None
        self.next = 0  # the number of the next row of the grid
        self.end = math.nan if settings.stop is None else float(settings.stop)
        self.between = 0  # rows that were recorded inside steps, where there is no grid

    def go_on(self, t: float) -> None:
        """Rows from t on, where a saved run goes on."""
        if self.every is not None:
            self.next = self.every.after(t)

    def cut(self, t: float) -> None:
        """Take out rows of a step that was interrupted before it counted."""
        self.recording.cut(t)
        if self.every is not None:
            self.next = min(self.next, self.every.after(t))

    def wants(self, t: float) -> bool:
        """Whether an instant at t has a row: what is recorded is computed for these alone."""
        if self.every is None or self.settings.records_jumps:
            return True
        last = self.recording.last[0]
        is_near = within_ulps(t, self.every.time(self.next), self.scale) or within_ulps(t, last, self.scale)
        return is_near or t == self.end or math.isnan(last)

    def at_instant(self, t: float, left: Row | None, right: Row) -> None:
        """A row where the grid or a jump asks for it, but none twice; in a jump, after that of the left values."""
        recording = self.recording
        last, values = recording.last
        if not self.settings.records_jumps:
            self._on_grid(t, right, last)
            return
        on_grid = t != last if self.every is None else t == self.every.time(self.next)
        if left is not None and left != right:
            if t != last:
                recording.add(t, left)
            if t != last or right != values:
                recording.add(t, right)
        elif on_grid or math.isnan(last) or (t == self.end and t != last):
            recording.add(t, right)
        if self.every is not None and on_grid:
            self.next += 1

    def _on_grid(self, t: float, right: Row, last: float) -> None:
        """A row where the grid asks for it, and at the stop; another instant at the time of the last row changes it."""
        assert self.every is not None
        if within_ulps(t, point := self.every.time(self.next), self.scale):
            self.recording.add(t if t == self.end else point, right)
            self.next += 1
        elif within_ulps(t, last, self.scale):
            self.recording.replace_last(right)
        elif t == self.end or math.isnan(last):
            self.recording.add(t, right)

    def in_step(self, number: int, now: Snapshot, dense: Interpolant, t1: float, *, outstanding: bool) -> None:
        """Rows strictly inside the number-th step, from now to t1. outstanding: whether an instant follows there."""
        if self.is_silent:
            return
        if self.every is None:
            self._between_steps(now, dense, t1)
            return
        if number % 64 == 0:
            self._look_between(now, dense, t1)
        if outstanding and not self.settings.records_jumps:  # the instant has the rows that belong to it
            point = self.every.time(self.every.after(math.nextafter(t1, -math.inf)) - 1)
            t1 = point if within_ulps(point, t1, self.scale) else t1
        # All of the step's rows each time, also after an interrupt: how many are evaluated together decides last bits.
        first = self.every.after(math.nextafter(now.t, -math.inf))
        while self.every.time(first) < t1:
            times: list[float] = []
            while len(times) < _AT_ONCE and (t := self.every.time(first + len(times))) < t1:
                times.append(t)
            theta = (np.array(times) - dense.t0) / dense.h
            for k, (t, x) in enumerate(zip(times, dense(theta), strict=True), first):
                if k >= self.next:
                    if t != self.recording.last[0]:
                        self.recording.add(t, self.values(t, x))
                    self.next = k + 1
            first += len(times)
            self.watch.look(self.recording.bytes, COPIES)

    def _between_steps(self, now: Snapshot, dense: Interpolant, t1: float) -> None:
        """Without a grid, rows inside a step where what is recorded turns faster than the steps follow each other."""
        look, _ = self.inside.look("logged")
        if not look.motion.phases or t1 <= now.t:
            return
        parts = self.inside.parts("logged", now, dense, now.t, t1, lambda t, x: ())
        for _, t, _ in in_time(parts, now.t, t1):
            if t == t1 or t <= self.recording.last[0]:
                continue
            if self.between == MOST_BETWEEN:
                look.not_seen(t, 0, LEFT_OUT)
                return
            x = dense(np.array([(t - dense.t0) / dense.h]))[0]
            self.recording.add(t, self.values(t, x))
            self.between += 1
        self.watch.look(self.recording.bytes, COPIES)

    def _look_between(self, now: Snapshot, dense: Interpolant, t1: float) -> None:
        """Note where what is recorded turns more than half a turn from row to row of the grid."""
        look, program = self.inside.look("logged")
        every = self.settings.every
        if every is not None and float(every) >= self.end - float(self.settings.start):
            return  # the ends of the run alone are asked for
        if look.motion.phases and t1 > now.t and math.isnan(look.unseen.t):
            x1 = dense(np.array([(t1 - dense.t0) / dense.h]))[0]
            phases = [np.array(program(*self.inside.at(t, x))) for t, x in ((now.t, now.x), (t1, x1))]
            turns = np.abs(phases[1] - phases[0]) * float(every or 0) / (t1 - now.t)
            if np.any(turns > 0.5):
                look.not_seen(now.t, int(np.nanargmax(turns)), BETWEEN_ROWS)
