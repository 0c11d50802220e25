"""Many native runs of one model: threads take row after row of its parameters, and nothing of it passes through Python.

A row gives what a run of its own gives, bit for bit: it begins, stops and ends as that does.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...compile.c import runtime_layout
from ...compile.inputs import InputTable
from ...compile.plan import Plan
from ...text.arrays import Array
from ...text.errors import Fault
from ..run.engine import ended_by
from ..run.many_runs import Outcome, Row, cores
from ..run.measures import Measures
from .model import Model
from .native_engine import NativeEngine, in_brief

_KEPT = 8  # numbers of a measure
_LEFT, _DONE, _FAILED, _BUDGET, _NO_MEMORY, _STOPPED = range(6)
_LOOK = 0.05  # s, after which progress is told and Ctrl-C seen


def run_rows(
    plan: Plan,
    inputs: InputTable,
    model: Model,
    table: Array,
    *,
    grid: int,
    threads: int | None = None,
    budget: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Outcome, bool]:
    """Run all rows of parameters (n, np). plan: that of the first. grid: how many rows of signals each has. progress:
    called with how many rows are done. Gives what became of them, and whether Ctrl-C cut it short.

    Ctrl-C, and what `progress` raises, let no further row begin; after the latter it is raised again.
    """
    table = np.ascontiguousarray(table, dtype=float)
    n, width = len(table), len(model.logged)
    measures = model.measures_of(plan)
    beside = 1 if model.lanes is None else model.lanes.width
    count = max(1, min(-(-n // beside), threads or cores()))
    beside = min(beside, -(-n // count))  # lanes that never have a row need none behind them
    workers = [
        _Worker([NativeEngine(plan, inputs, is_silent=not width, model=model) for _ in range(beside)], grid, width)
        for _ in range(count)
    ]
    batch, kept = _begun(plan, workers[0].engines[0], table, grid, budget)
    batch.is_by_one = int(bool(measures.paths))
    paths: dict[int, dict[int, Array]] = {}

    working, ended = [*workers], threading.Event()
    memory = batch, kept, inputs, plan

    def work(worker: _Worker) -> None:
        held = memory  # where Ctrl-C leaves the caller between two lines, C still writes here  # noqa: F841
        try:
            for row, engine in worker.rows(batch):
                paths[row] = engine.paths()
        finally:
            working.remove(worker)
            if not working:
                ended.set()

    try:
        for worker in workers:
            threading.Thread(target=work, args=(worker,)).start()
        is_cancelled, failure = _watched(ended, batch, progress)
    finally:
        batch.is_cancelled = 1
    if failure is not None:
        raise failure
    return _outcome(plan, measures, kept, paths, budget), is_cancelled


class _Worker:
    """What a thread works with: a run for each lane, or a single one; room: of rows of signals, for each."""

    def __init__(self, engines: list[NativeEngine], grid: int, width: int) -> None:
        self.engines, self.library = engines, engines[0].model.library
        self.room = np.empty((len(engines), grid + 1, 1 + width))
        self.lanes = engines[0].model.lanes

    def rows(self, batch: Any) -> Iterator[tuple[int, NativeEngine]]:
        """Work on rows; where that goes by one, the number of each, and the run that made it."""
        address, room = ctypes.addressof(batch), self.room.ctypes.data
        if self.lanes is None:
            while (row := self.library.blocks_batch(address, self.engines[0].address, room)) >= 0:
                yield row, self.engines[0]
            return
        sims = (ctypes.c_void_p * self.lanes.width)(*(engine.address for engine in self.engines))
        lanes = self.library.blocks_lanes_new(ctypes.addressof(sims), room, self.room[0].size)
        if not lanes:
            raise MemoryError
        which = ctypes.c_int32()
        try:
            while (row := self.library.blocks_lanes(address, lanes, ctypes.addressof(which))) >= 0:
                yield row, self.engines[which.value]
        finally:
            self.library.blocks_lanes_free(lanes)


def _begun(
    plan: Plan, engine: NativeEngine, table: Array, grid: int, budget: int | None
) -> tuple[Any, dict[str, Array]]:
    """The batch as C reads it, and its arrays."""
    settings, n = plan.settings, len(table)
    assert settings.stop is not None
    stops = [float(t) for t in settings.stops if settings.start < t < settings.stop]
    kept = {
        "p": table, "ticks": engine.at_start(), **dict(engine.model.begin),
        "stops": np.array([*stops, float(settings.stop)]),
        "signals": np.full((n, grid, len(engine.model.logged)), np.nan),
        "measured": np.empty((n, len(plan.measures), _KEPT)),
        "ended": np.empty(n), "steps": np.zeros(n, dtype=np.int64),
        "status": np.zeros(n, dtype=np.int32), "failure": np.zeros(n, dtype=np.int32),
        "culprit": np.zeros(n, dtype=np.int32),
    }  # fmt: skip
    most = min(budget or 0, 2**63 - 1)
    batch = runtime_layout.BlocksBatch(nrows=n, nstops=len(kept["stops"]), ngrid=grid, budget=most)
    sim = engine.sim
    batch.start, batch.count, batch.exact, batch.crossing = sim.t, sim.count, sim.exact, sim.crossing
    for name, values in kept.items():
        setattr(batch, name, values.ctypes.data)
    return batch, kept


def _watched(
    ended: threading.Event, batch: Any, progress: Callable[[int], None] | None
) -> tuple[bool, BaseException | None]:
    """Wait until all threads have ended. Whether Ctrl-C cut it short, and what `progress` raised."""
    is_cancelled, failure, told = False, None, -1
    # Not `Thread.join`: after Ctrl-C in it, Python 3.11 and 3.12 take a thread that works for one that has ended, and
    # its memory would be freed.
    while not ended.is_set():
        try:
            ended.wait(_LOOK)
            if progress is not None and not batch.is_cancelled and batch.done != told:
                told = batch.done
                progress(told)
        except KeyboardInterrupt:
            is_cancelled, batch.is_cancelled = True, 1
        except BaseException as error:
            failure, batch.is_cancelled = error, 1
    return is_cancelled, failure


def _outcome(
    plan: Plan, measures: Measures, kept: dict[str, Array], paths: dict[int, dict[int, Array]], budget: int | None
) -> Outcome:
    """Return the outcomes of all rows. Python looks only at rows that have something to report."""
    status, ended = kept["status"], kept["ended"]
    values, is_known = measures.results_each(kept["measured"], ended)
    is_plain = is_known & (status == _DONE)

    def row(i: int) -> Row:
        steps, signals, t = int(kept["steps"][i]), kept["signals"][i], float(ended[i])
        if status[i] == _BUDGET:
            return Row.over(plan.name, budget)
        if status[i] not in (_DONE, _STOPPED):
            return Row(steps, {}, (_why(plan, kept, i),), None, signals)
        faults: tuple[Fault, ...] = ()
        if is_known[i]:
            own = {name: float(column[i]) for name, column in values.items()}
        else:
            own, faults = measures.kept(kept["measured"][i], paths.get(i, {})).results(t)
        if status[i] == _STOPPED:
            faults = (*faults, ended_by(plan.settings.stop_when, t))
        return Row.ok(steps, own, faults, signals)

    others = {i: row(i) for i in np.nonzero((status != _LEFT) & ~is_plain)[0].tolist()}
    return Outcome(is_plain, values, kept["steps"], kept["signals"], others)


def _why(plan: Plan, kept: dict[str, Array], i: int) -> Fault:
    """Why a row came to no end, in brief: a run of its own tells more."""
    t, status = float(kept["ended"][i]), int(kept["status"][i])
    if status == _NO_MEMORY:
        cure = "Run fewer rows at once (threads=1), or log less."
        return Fault("E311", plan.name, f"at t = {t:.10g} s no memory is left.", cure)
    cure = "Run this row alone for a more detailed message."
    return in_brief(plan, int(kept["failure"][i]), int(kept["culprit"][i]), t, cure)
