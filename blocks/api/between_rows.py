"""How recorded signals go between their rows, for figures: from the model, and from the same run once more on a grid.

A grid changes no state, event or measure (docs/semantics.md, "Rows"), so the second run takes the same steps, and its
rows are those of the solver's own interpolation. Where that is not sure, there are none, and a figure joins the rows of
the run by lines.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction

import numpy as np

from ..compile.plan import Plan
from ..compile.upstream import at_once
from ..contract.enumerations import enumeration_of
from ..engines.prepared import Prepared
from ..results.results import Results
from ..text.errors import BlocksError
from .case import Case

MOST_WORK = {"native": 3_000_000, "reference": 200_000}
"""Steps times what moves in each, of a run that a figure repeats: some seconds of an engine."""
MOST_ROWS = 50_000
Start = Callable[[Case, Iterable[Prepared]], Results]


class BetweenRows:
    """The answers to `Results.between`. They keep neither the run nor its model alive.

    start: runs a case of the same diagram, like what was prepared; None: nothing repeats the run.
    """

    def __init__(self, prepared: Prepared, case: Case, start: Start | None) -> None:
        plan = prepared.plan
        # FMUs and steppers may act on something outside.
        is_alone = isinstance(plan, Plan) and not plan.foreign and not plan.steppers
        self._start = start if is_alone and plan.settings.every is None else None
        self._moving = len(plan.states) if isinstance(plan, Plan) else 0
        self._alike, self._case = weakref.ref(prepared.alike), case

    def _prepared(self) -> list[Prepared]:
        alike = self._alike()
        return [] if alike is None else [*alike.made.values()]

    def finer(self, results: Results, every: float) -> Results | None:
        """Return the results of the same run with rows at this distance in s, or more; None where it is not sure."""
        if self._start is None or results.interrupted or results.rows < 2:
            return None
        steps, (first, ended) = results.statistics.steps, results.span
        if steps * (10 + self._moving) > MOST_WORK[results.statistics.engine]:
            return None
        # Three digits: the native engine counts in fractions of 62 bits.
        distance = Fraction(f"{max(every, (ended - first) / MOST_ROWS):.3g}")
        on_grid = {"every": distance, "jumps": True, "engine": results.statistics.engine}
        try:
            made = self._start(self._case.on_top(on_grid), self._prepared())
        except BlocksError:
            return None
        # What it depends on may have changed, such as a file of inputs.
        is_same = made.span[1] == ended and made.statistics.steps == steps
        return made if is_same and np.array_equal(made.values[-1], results.values[-1], equal_nan=True) else None

    def held(self, names: Iterable[str]) -> dict[str, Mapping[int, str]]:
        """Return which of the signals change at instants only, with the names of their values if they have names."""
        prepared = next(iter(self._prepared()), None)
        if prepared is None:
            return {}
        plan, held = prepared.plan, dict[str, Mapping[int, str]]()
        for name in names:
            type_ = prepared.flat.signals[name].type if name in prepared.flat.signals else "real"
            known = enumeration_of(type_)
            if known is not None or type_ != "real":
                held[name] = {} if known is None else known.names
            elif isinstance(plan, Plan):
                rows = {row for row, _ in at_once(plan, plan.signal(name).references)}
                if not rows & {"x", "t", "u", "h", "z"}:
                    held[name] = {}
        return held
