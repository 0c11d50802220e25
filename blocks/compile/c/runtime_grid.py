"""Time grids as the C runtime counts them: by 64-bit integers. `grid_of` is the only door: what it takes fits."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from ..coupling import Coupling
from ..plan import Plan
from ..time_grid import Grid
from . import runtime_layout

LARGEST = 2**62
MOST = 2**53  # beyond it, doubles do not hold every integer
HORIZON = 10**9  # s: a run without an end is taken to be so long


def why_not(what: Plan | Coupling) -> str:
    """Say why compiled code cannot count the times of a run, in words; "" where it can."""
    settings = what.settings
    if isinstance(what, Plan):
        plans, steps = [what], [settings.step, settings.every]
    else:
        plans = [unit.plan for unit in what.units if unit.plan is not None]
        steps = [settings.every, *(unit.step for unit in what.units), *(plan.settings.step for plan in plans)]
    fits = all(_fits(Grid.of(settings.start, step)) for step in steps if step is not None)
    fits = fits and all(max(plan.base.as_integer_ratio()) <= LARGEST for plan in plans if plan.rates)
    return "" if fits else "times are fractions of more than 62 bits"


def grid_of(start: Fraction, step: Fraction | None, stop: Fraction | None) -> Any:
    """The times start + k step as the runtime counts them, up to `stop`; times in s.

    Raises OverflowError where they do not fit its integers: see `why_not`.
    """
    if step is None:
        return runtime_layout.BlocksGrid()
    grid = Grid.of(start, step)
    if not _fits(grid):
        raise OverflowError(f"times {start} + k {step} are fractions of more than 62 bits")
    stop = start + HORIZON if stop is None else stop
    most = abs(int(max(abs(start), abs(stop)) * grid.unit)) + 4 * grid.step
    return runtime_layout.BlocksGrid(grid.start, grid.step, grid.unit, int(max(most, grid.unit) < MOST), 1)


def _fits(grid: Grid) -> bool:
    return max(abs(grid.start), grid.step, grid.unit) <= LARGEST
