"""The stiff method: Radau IIA of order 5 by SciPy, one accepted step at a time.

Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from .methods import Rates

__all__ = ["Radau", "flow"]

Array = np.ndarray[Any, Any]


@dataclass
class _Dense:
    """SciPy's dense output, asked by theta."""

    t0: float
    h: float
    output: Any

    def __call__(self, theta: Array) -> Array:
        return np.asarray(self.output(self.t0 + theta * self.h).T)


class Radau:
    """An integration from (t, x) that nothing disturbs until t_end."""

    def __init__(self, rates: Rates, t: float, x: Array, t_end: float, rtol: float, atol: Array, h: float) -> None:
        from scipy.integrate import Radau as Method

        first = min(h, t_end - t) if h > 0 else None
        self.solver = Method(rates, t, x, t_end, rtol=rtol, atol=atol, first_step=first)

    def step(self) -> tuple[_Dense, float, Array]:
        """One accepted step: dense output, its end, the states there. Raises ArithmeticError where it fails."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                message = self.solver.step()
            except (ValueError, np.linalg.LinAlgError) as error:  # NaN in its linear algebra
                raise ArithmeticError(str(error)) from None
        if self.solver.status == "failed":
            raise ArithmeticError(message)
        t0, t1 = float(self.solver.t_old), float(self.solver.t)
        return _Dense(t0, t1 - t0, self.solver.dense_output()), t1, np.array(self.solver.y)

    @property
    def proposed(self) -> float:
        return float(self.solver.h_abs)

    @property
    def evaluations(self) -> int:
        return int(self.solver.nfev)


def flow(rates: Rates, t: float, x: Array, t_end: float, rtol: float, atol: Array, h: float) -> Array:
    """The states at t_end, in as many steps as it takes."""
    run = Radau(rates, t, x, t_end, rtol, atol, h)
    while run.solver.status == "running":
        _, _, x = run.step()
    return x
