"""Rows between those of a run without a grid, for figures: from the same run once more, on a grid.

A grid changes no state, event or measure (docs/semantics.md, "Rows"), so the second run takes the same steps, and its
rows are those of the solver's own interpolation. Where that is not sure, there are none, and a figure joins the rows of
the run by lines.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from fractions import Fraction

import numpy as np

from ..compile.plan import Plan
from ..engines.prepared import Prepared
from ..results.results import Results
from ..text.errors import BlocksError
from .case import Case

MOST_WORK = 3_000_000
"""Steps times what moves in each, of a run that a figure repeats: a few seconds of the slower engine."""
MOST_ROWS = 50_000


def finer(
    prepared: Prepared, case: Case, results: Results, start: Callable[[Case, Iterable[Prepared]], Results]
) -> Callable[[float], Results | None] | None:
    """Return a function from the distance of rows in s to results with such rows; None if a figure repeats no run.

    start: runs a case of the same diagram, like what was prepared. Not repeated: runs with FMUs or steppers, which may
    act on something outside, and long runs.
    """
    plan = prepared.plan
    if not isinstance(plan, Plan) or plan.foreign or plan.steppers or plan.settings.every is not None:
        return None
    if results.interrupted or results.stored is not None or results.rows < 2:
        return None
    if results.statistics.steps * (10 + len(plan.states)) > MOST_WORK:
        return None
    known, (first, ended) = weakref.ref(prepared), results.span
    steps, engine = results.statistics.steps, results.statistics.engine
    last = np.array(results.values[-1])

    def again(every: float) -> Results | None:
        # Three digits: the native engine counts in fractions of 62 bits.
        distance = Fraction(f"{max(every, (ended - first) / MOST_ROWS):.3g}")
        on_grid = {"every": distance, "jumps": True, "engine": engine}
        try:
            made = start(case.on_top(on_grid), filter(None, [known()]))
        except BlocksError:
            return None
        # What it depends on may have changed, such as a file of inputs.
        is_same = made.span[1] == ended and made.statistics.steps == steps
        return made if is_same and np.array_equal(made.values[-1], last, equal_nan=True) else None

    return again
