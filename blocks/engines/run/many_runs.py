"""What many runs share: what becomes of each, how many run at once, and when their signals are recorded."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from ...compile.time_grid import Grid
from ...text.arrays import Array
from ...text.errors import BlocksError, Fault


@dataclass(frozen=True, slots=True)
class Row:
    """What became of one run of many.

    measures: by name; none where it failed. faults: why it failed, or how it ended and why a measure has no value.
    status: of `api.batch.STATUSES`; None where the code of the fault says it. signals: (rows, elements of all that is
    logged), as far as it came.
    """

    steps: int
    measures: Mapping[str, float]
    faults: tuple[Fault, ...]
    status: str | None
    signals: Array = field(default_factory=lambda: np.empty((0, 0)))

    @classmethod
    def failed(cls, error: BlocksError, *, is_refused: bool) -> Row:
        return cls(0, {}, error.faults[:1], "refused" if is_refused else None)

    @classmethod
    def over(cls, place: str, budget: int | None) -> Row:
        """One that was cut short. When it was does not count: that depends on when the clock was looked at."""
        cure = "Increase the budget, or check the values of this row: the run may be stiff or chatter."
        message = f"needs more than {budget} steps, the most that it may take."
        return cls(budget or 0, {}, (Fault("E313", place, message, cure),), "budget")

    @classmethod
    def ok(cls, steps: int, measures: Mapping[str, float], faults: Iterable[Fault], signals: Array) -> Row:
        """One that ran to its end. Of its warnings, the first of each code counts; how it ended comes first."""
        first = {fault.code: fault for fault in reversed([*faults]) if fault.code in ("W301", "W307")}
        return cls(steps, measures, tuple(first[code] for code in sorted(first, reverse=True)), "ok", signals)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcomes of n runs.

    is_plain: (n,) of runs that came to their end and have all measures. measures, steps: (n,), those of plain runs.
    signals: (n, rows, elements), as far as each came. others: of runs that are not plain, by number; none of a run that
    was not reached.
    """

    is_plain: Array
    measures: Mapping[str, Array]
    steps: Array
    signals: Array
    others: Mapping[int, Row]


def cores() -> int:
    """How many threads or processes can run at once."""
    known = getattr(os, "sched_getaffinity", None)
    return len(known(0)) if known is not None else os.cpu_count() or 1


def times_of(start: Fraction, every: Fraction, stop: Fraction) -> Array:
    """The times of rows of signals: the grid, and the stop."""
    grid = Grid.of(start, every)
    count = (stop - start) // every + 1
    times = [grid.time(k) for k in range(count)]
    if start + (count - 1) * every == stop:
        times[-1] = float(stop)
    else:
        times.append(float(stop))
    return np.array(times)
