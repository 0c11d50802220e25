"""One step of a Runge-Kutta method: tableaus as data, a step as a pure function, dense output as a polynomial.

References: Dormand and Prince 1980 (the 5(4) pair); Hairer, Norsett and Wanner, Solving Ordinary Differential
Equations I, II.4 to II.6 (error control, first step, continuous extension).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["METHODS", "Tableau", "Trial", "error_norm", "first_step", "trial"]

Array = np.ndarray[Any, Any]
Rates = Callable[[float, Array], Array]
"""dx/dt at (t, x): arrays of shape (n,)."""


@dataclass(frozen=True)
class Tableau:
    """Nodes c, stages a, weights b; error weights e (b minus the embedded ones) and dense weights p, where there are.

    The last stage stands at the end of the step (first same as last): its rates are those of the next step's start.
    """

    name: str
    order: int
    c: tuple[float, ...]
    a: tuple[Array, ...]  # for each stage after the first, the weights of the ones before
    e: Array | None
    p: Array  # (stages, degree): x(theta) = x0 + h * sum_i k_i * sum_j p[i, j] theta^(j+1)


def _tableau(name: str, order: int, c: Any, a: Any, p: Any, e: Any = None) -> Tableau:
    return Tableau(
        name,
        order,
        tuple(float(node) for node in c),
        tuple(np.array(row, dtype=float) for row in a),
        None if e is None else np.array(e, dtype=float),
        np.array(p, dtype=float),
    )


# The stages of the lower-order methods are followed by one at the end of the step, so that all have dense output: a
# straight line for Euler, the cubic of Hermite through both ends and their slopes for rk4.
METHODS = {
    "euler": _tableau("euler", 1, [0, 1], [[1]], [[1], [0]]),
    "rk4": _tableau(
        "rk4",
        4,
        [0, 1 / 2, 1 / 2, 1, 1],
        [[1 / 2], [0, 1 / 2], [0, 0, 1], [1 / 6, 1 / 3, 1 / 3, 1 / 6]],
        # x0 (1 - 3 th^2 + 2 th^3) + x1 (3 th^2 - 2 th^3) + h k0 (th - 2 th^2 + th^3) + h k4 (th^3 - th^2), where
        # x1 - x0 = h b.k
        [[1, -2 + 3 / 6, 1 - 2 / 6], [0, 3 / 3, -2 / 3], [0, 3 / 3, -2 / 3], [0, 3 / 6, -2 / 6], [0, -1, 1]],
    ),
    "dopri5": _tableau(
        "dopri5",
        5,
        [0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1],
        [
            [1 / 5],
            [3 / 40, 9 / 40],
            [44 / 45, -56 / 15, 32 / 9],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
            [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
        ],
        # The continuous extension of order 4 by Shampine 1986.
        [
            [1, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432],
            [0, 0, 0, 0],
            [0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799],
            [0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072],
            [0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632],
            [0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844],
            [0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423],
        ],
        [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
    ),
}


@dataclass(frozen=True)
class Polynomial:
    """Dense output of a Runge-Kutta step."""

    t0: float
    h: float
    x0: Array
    weights: Array  # (degree, n): h * p.T @ k

    def __call__(self, theta: Array) -> Array:
        powers = theta[:, None] ** np.arange(1, len(self.weights) + 1)
        return np.asarray(self.x0 + powers @ self.weights)


@dataclass(frozen=True)
class Trial:
    """A step that was tried: the states at its end, the rates of all stages, and the error estimate (0 without one)."""

    t0: float
    h: float
    x0: Array
    x1: Array
    k: Array
    tableau: Tableau

    @property
    def last(self) -> Array:
        """The rates at the end of the step."""
        return np.asarray(self.k[-1])

    @property
    def error(self) -> Array:
        assert self.tableau.e is not None
        return np.asarray(self.h * (self.tableau.e @ self.k))

    def interpolant(self) -> Polynomial:
        return Polynomial(self.t0, self.h, self.x0, self.h * (self.tableau.p.T @ self.k))


def trial(tableau: Tableau, rates: Rates, t: float, x: Array, first: Array, h: float) -> Trial:
    """One step of size h from (t, x), where the rates are `first`."""
    k = np.empty((len(tableau.c), len(x)))
    k[0] = first
    x1 = x
    for i, row in enumerate(tableau.a, start=1):
        x1 = x + h * (row @ k[:i])
        k[i] = rates(t + tableau.c[i] * h, x1)
    return Trial(t, h, x, x1, k, tableau)


def error_norm(error: Array, x0: Array, x1: Array, atol: Array, rtol: float) -> float:
    """The largest error over the states, each by its own tolerance: neither their order nor their number dilutes it.

    A step to states that are not finite has an error above every bound: inf or NaN.
    """
    if len(error) == 0:
        return 0.0
    size = np.maximum(np.abs(x0), np.abs(x1))
    if not np.isfinite(size).all():
        return np.inf
    # max hands NaN on, so that a step with NaN is never accepted.
    return float(np.max(np.abs(error) / (atol + rtol * size)))


def first_step(
    rates: Rates, t: float, x: Array, first: Array, order: int, atol: Array, rtol: float, most: float
) -> float:
    """A first step by Hairer's rule, with the norm above."""
    if len(x) == 0:
        return most
    scale = atol + rtol * np.abs(x)
    d0, d1 = float(np.max(np.abs(x) / scale)), float(np.max(np.abs(first) / scale))
    h0 = 1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1
    h0 = min(h0, most)
    second = rates(t + h0, x + h0 * first)
    d2 = float(np.max(np.abs(second - first) / scale)) / h0
    if not np.isfinite(d2):
        return h0 * 1e-3
    h1 = max(1e-6, h0 * 1e-3) if max(d1, d2) <= 1e-15 else (0.01 / max(d1, d2)) ** (1 / (order + 1))
    return min(100 * h0, h1, most)
