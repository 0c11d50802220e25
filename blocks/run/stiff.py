"""The stiff method: Radau IIA of order 5 by SciPy, one accepted step at a time.

Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .methods import Rates

__all__ = ["Radau", "flow"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class _Dense:
    """SciPy's dense output, asked by theta."""

    t0: float
    h: float
    output: Any

    def __call__(self, theta: Array) -> Array:
        return np.asarray(self.output(self.t0 + theta * self.h).T)


class Radau:
    """An integration from (t, x) that nothing disturbs until t_end.

    h: the first step (0: none known). longest: no step is longer. Raises ArithmeticError where it fails.
    """

    def __init__(
        self, rates: Rates, t: float, x: Array, t_end: float, *, rtol: float, atol: Array, h: float, longest: float
    ) -> None:
        from scipy.integrate import Radau as Method

        first = min(h, t_end - t) if h > 0 else None
        self.end, self.proposed = t_end, h
        try:
            self.solver = Method(rates, t, x, t_end, rtol=rtol, atol=atol, first_step=first, max_step=longest)
        except ValueError as error:  # NaN in the Jacobian
            raise ArithmeticError(str(error)) from None

    def step(self) -> tuple[_Dense, float, Array]:
        """One accepted step: dense output, its end, the states there. Raises ArithmeticError where it fails."""
        try:
            message = self.solver.step()
        except (ValueError, np.linalg.LinAlgError) as error:  # NaN in its linear algebra
            raise ArithmeticError(str(error)) from None
        if self.solver.status == "failed":
            raise ArithmeticError(message)
        t0, t1 = float(self.solver.t_old), float(self.solver.t)
        h = float(self.solver.h_abs)
        # Of a step that the end cut short, the proposal before it still counts.
        self.proposed = h if t1 < self.end else max(h, self.proposed)
        return _Dense(t0, t1 - t0, self.solver.dense_output()), t1, np.array(self.solver.y)


def flow(
    rates: Rates, t: float, x: Array, t_end: float, *, rtol: float, atol: Array, h: float, longest: float
) -> Array:
    """The states at t_end, in as many steps as it takes."""
    if t_end <= t:
        return x
    run = Radau(rates, t, x, t_end, rtol=rtol, atol=atol, h=h, longest=longest)
    while run.solver.status == "running":
        _, _, x = run.step()
    return x
