"""Time grids as the C runtime counts them: by 64-bit integers."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from ..plan import Plan
from ..time_grid import Grid
from . import runtime_layout

__all__ = ["grid_of", "why_not"]

MOST = 2**53  # beyond it, doubles do not hold every integer


def why_not(plan: Plan, rows: Fraction | None) -> str:
    """Why a Plan cannot run natively, in words; "" where it can. rows: the step of rows in s, or its master's."""
    settings = plan.settings
    grids = [Grid.of(settings.start, step) for step in (settings.step, rows) if step is not None]
    numbers = [abs(n) for grid in grids for n in (grid.start, grid.step, grid.unit)]
    numbers += [plan.base.numerator, plan.base.denominator] if plan.rates else []
    if max(numbers, default=0) > 2**62:
        return "times are fractions of more than 62 bits"
    return ""


def grid_of(start: Fraction, step: Fraction | None, stop: Fraction) -> Any:
    """The times start + k step as the runtime counts them, up to `stop`; times in s."""
    if step is None:
        return runtime_layout.BlocksGrid()
    grid = Grid.of(start, step)
    most = abs(int(max(abs(start), abs(stop)) * grid.unit)) + 4 * grid.step
    return runtime_layout.BlocksGrid(grid.start, grid.step, grid.unit, int(max(most, grid.unit) < MOST), 1)
