"""What many runs share: how many run at once, how many steps each may take, and when their signals are recorded."""

from __future__ import annotations

import os
from fractions import Fraction
from typing import Any

import numpy as np

from ...compile.time_grid import Grid
from ...text.errors import Fault

__all__ = ["cores", "over_budget", "times_of"]

Array = np.ndarray[Any, Any]


def cores() -> int:
    """How many threads or processes can run at once."""
    known = getattr(os, "sched_getaffinity", None)
    return len(known(0)) if known is not None else os.cpu_count() or 1


def over_budget(place: str, budget: int | None) -> Fault:
    """Why a run was cut short. When it was does not count: that depends on when the clock was looked at."""
    cure = "Give it more steps, or look at its values: such a run may be stiff, or chatter."
    return Fault("E313", place, f"takes more than {budget} steps.", cure)


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
