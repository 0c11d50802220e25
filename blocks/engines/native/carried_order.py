"""What the stiff method keeps from step to step, in the order of the model and in that of the Plan."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...compile.c.jacobian_code import in_order
from ...compile.jacobian import PlanJacobian
from ...compile.plan import Plan
from ...text.arrays import Array, frozen
from ..run.snapshot import CARRIED_NUMBERS


class CarriedOrder:
    """The row `carried` of C: five numbers, the polynomial (3, n), the values of the Jacobian, pivots; and that of a
    Snapshot. place: of each state of the Plan in the model."""

    def __init__(self, plan: Plan, place: Array) -> None:
        self.plan, self.place = plan, place

    @cached_property
    def values(self) -> Array:
        """Where the values of the model's pattern stand in that of the Plan."""
        return in_order(PlanJacobian(self.plan), self.place.tolist())[2]

    def _parts(self, row: Array) -> list[Array]:
        n = len(self.place)
        return np.split(row, CARRIED_NUMBERS + np.array([0, 3 * n, 3 * n + len(self.values)]))

    def taken(self, row: Array) -> Array:
        """That of a Snapshot, from C."""
        numbers, polynomial, values, pivots = self._parts(row)
        slopes = np.empty(len(values))
        slopes[self.values] = values
        ordered = polynomial.reshape(3, -1)[:, self.place]
        return frozen(np.concatenate([numbers, ordered.ravel(), slopes, pivots]))

    def put(self, row: Array, out: Array) -> None:
        """That of a Snapshot into C. What another engine kept has no pivots: columns then prefer their diagonals."""
        numbers, polynomial, values, pivots = self._parts(row)
        order = np.argsort(self.place)
        made = [numbers, polynomial.reshape(3, -1)[:, order].ravel(), values[self.values], pivots]
        whole = np.concatenate(made)
        if len(whole) < len(out):
            whole = np.concatenate([whole, np.arange(len(out) - len(whole))])
        out[:] = whole[: len(out)]
