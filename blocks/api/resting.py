"""A run that begins at an operating point: the state of a run at its start, with the memory of the point."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..compile.plan import Plan
from ..engines.run.measures import Measures
from ..engines.run.saved_state import ENDING, State, fit
from ..text.errors import Fault, UsageError

if TYPE_CHECKING:
    from ..linear.point import Point

_ROWS = (("x", "states", 1), ("d", "discretes", 2), ("s", "crossings", 3), ("z", "algebraic unknowns", 8))
"""Rows of a state, what `fit` calls their names, and their places in the memory of a point."""


def standing_at(point: Point, state: State, plan: Plan) -> State:
    """Return the state of a run at its start with the memory and the inputs of an operating point.

    Raises UsageError (E506) where the point is of another diagram, or does not hold all that changes in a run.
    """
    was, own, rows, inputs = fit(point.plan), fit(plan), dict(state.rows), state.inputs
    hidden = [what for what in ("steppers", "delays", "FMUs") if own.get(what)]
    if hidden:
        message = f"cannot begin at an operating point, which does not hold the state of its {' and '.join(hidden)}."
        raise UsageError(Fault("E506", plan.name, message, "Resume the run from a snapshot."))
    for name, what, k in _ROWS:
        known = dict(zip(was[what], point.memory[k], strict=True))
        if {*own[what]} - {n for n in own[what] if n.startswith(ENDING)} != {*known} or was["inputs"] != own["inputs"]:
            message = f"the operating point is of another diagram: it has other {what} or inputs."
            raise UsageError(Fault("E506", plan.name, message, "Find the operating point of this diagram."))
        pairs = zip(own[what], rows[name].tolist(), strict=True)
        rows[name] = np.array([known.get(n, value) for n, value in pairs], dtype=float)
    first = 0
    for k, (_, shape, *_) in enumerate(plan.inputs):
        size = math.prod(shape)
        inputs = inputs.replaced(k, np.array(point.memory[5][first : first + size], dtype=float))
        first += size
    return replace(state, rows={**rows, **Measures(plan).rows()}, inputs=inputs, is_adapted=True)
