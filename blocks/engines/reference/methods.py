"""One step of a Runge-Kutta method as a pure function, with its dense output as a polynomial.

References: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.4 to II.6 (error control, first
step, continuous extension).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...compile.tableaus import Tableau
from ...text.arrays import Array

Rates = Callable[[float, Array], Array]
"""dx/dt at (t, x): arrays of shape (n,)."""


@dataclass(frozen=True)
class Polynomial:
    """Dense output of a Runge-Kutta step."""

    t0: float
    h: float
    x0: Array
    weights: Array  # (degree, n): h * p.T @ k

    def __call__(self, theta: Array) -> Array:
        powers = theta[:, None] ** np.arange(1, len(self.weights) + 1)
        return np.asarray(self.x0 + combined(powers.T[:, :, None], self.weights))


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
        return np.asarray(self.h * combined(self.tableau.e, self.k))

    def interpolant(self) -> Polynomial:
        return Polynomial(self.t0, self.h, self.x0, self.h * combined(self.tableau.p[:, :, None], self.k))


def combined(weights: Array, rows: Array) -> Array:
    """Return the sum of rows (m, n), each times its weight, from first to last.

    A product of matrices would add in an order that depends on their sizes and on the processor, and so would the bits
    of each state on how many others there are.
    """
    total = weights[0] * rows[0]
    for weight, row in zip(weights[1:], rows[1:], strict=True):
        total = total + weight * row
    return np.asarray(total)


@dataclass(frozen=True)
class Retaken:
    """A shortened step that was taken once more: its size, its end, its error (up to 1 is accepted) and the state with
    that error."""

    h: float
    x1: Array
    error: float
    culprit: int


class StepRefused(Exception):
    """A retaken step with too large an error. The run is still at the begin of the step; a shorter step is due."""

    def __init__(self, step: Retaken) -> None:
        super().__init__(step)
        self.step = step


@dataclass(frozen=True)
class Flow:
    """Steps of any size from the present state: `after` gives their ends, `retaken` their errors too."""

    after: Callable[[float], Array]
    retaken: Callable[[float], Retaken]

    def retake(self, h: float) -> Array:
        """Return the end of a step of size h that is to be accepted. Raises StepRefused if its error is too large."""
        step = self.retaken(h)
        if not step.error <= 1.0:
            raise StepRefused(step)
        return step.x1


def retaking(tableau: Tableau, rates: Rates, t: float, x: Array, first: Array, atol: Array, rtol: float) -> Flow:
    """Return the flow from (t, x), where the rates are `first`. Without an error estimate, no step is refused."""

    def after(h: float) -> Array:
        return trial(tableau, rates, t, x, first, h).x1

    def retaken(h: float) -> Retaken:
        made = trial(tableau, rates, t, x, first, h)
        if tableau.e is None or not len(x):
            return Retaken(h, made.x1, 0.0, 0)
        error = error_norm(made.error, x, made.x1, atol, rtol)
        return Retaken(h, made.x1, error, worst(made.error, x, made.x1, atol, rtol))

    return Flow(after, retaken)


def trial(tableau: Tableau, rates: Rates, t: float, x: Array, first: Array, h: float) -> Trial:
    """One step of size h from (t, x), where the rates are `first`."""
    k = np.empty((len(tableau.c), len(x)))
    k[0] = first
    x1 = x
    for i, row in enumerate(tableau.a, start=1):
        x1 = x + h * combined(row, k[:i])
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


def worst(error: Array, x0: Array, x1: Array, atol: Array, rtol: float) -> int:
    """The state with the largest error, or one that is not finite."""
    parts = np.abs(error) / (atol + rtol * np.maximum(np.abs(x0), np.abs(x1)))
    return int(np.argmax(np.where(np.isfinite(x1 + error), parts, np.inf)))


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
