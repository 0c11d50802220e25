"""Where in a step a side changes first.

A crossing is looked for on the polynomial through five values inside the step, so that two crossings in one step
are found: where its Bernstein coefficients all lie on the latched side, it cannot leave it. Otherwise the extrema of the
polynomial are tested too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["NODES", "first_change", "narrowed"]

Array = np.ndarray[Any, Any]
NODES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_POWERS = np.linalg.inv(NODES[:, None] ** np.arange(5))  # values at the nodes -> coefficients of 1, th, ..., th^4
# Coefficients of powers -> Bernstein coefficients: b_i = sum_k C(i, k) / C(4, k) a_k.
_BERNSTEIN = (
    np.array([[math.comb(i, k) / math.comb(4, k) if k <= i else 0.0 for k in range(5)] for i in range(5)]) @ _POWERS
)


def first_change(values: Array, sides: Array, evaluate: Callable[[float], Array]) -> tuple[float, float] | None:
    """An interval (low, high] of theta in which the first change of a side lies, or None.

    values: (5, m) crossing values at NODES. sides: (m,) latched sides. evaluate: values (m,) at another theta.
    """
    bounds = _BERNSTEIN @ values
    suspicious = np.where(sides, np.min(bounds, axis=0) < 0, np.max(bounds, axis=0) >= 0)
    if not np.any(suspicious):
        return None
    points = {float(theta): values[k] for k, theta in enumerate(NODES)}
    for j in np.nonzero(suspicious)[0]:
        coefficients = _POWERS @ values[:, j]
        slope = coefficients[1:] * np.arange(1, 5)
        while len(slope) > 1 and abs(slope[-1]) <= 1e-14 * np.max(np.abs(slope)):
            slope = slope[:-1]
        for root in np.roots(slope[::-1]):
            theta = float(root.real)
            if abs(root.imag) <= 1e-8 and 0.0 < theta < 1.0 and theta not in points:
                points[theta] = evaluate(theta)
    low = 0.0
    for theta in sorted(points):
        if np.any((points[theta] >= 0) != sides) and theta > 0.0:
            return low, theta
        low = theta
    return None


def narrowed(changed: Callable[[float], float], low: float, high: float, resolution: float) -> float:
    """The right end of the smallest interval that holds the first change.

    changed(h): negative before the change, zero or positive after it (a continuous measure of how far).
    low is before, high after it. Illinois's rule with bisection where it is slow.
    """
    f_low, f_high = changed(low), changed(high)
    if f_low >= 0:
        return low
    side = 0
    for count in range(200):
        if high - low <= resolution:
            break
        middle = (low + high) / 2
        if count % 3 != 2 and math.isfinite(f_low) and math.isfinite(f_high) and f_high > f_low:
            middle = low - f_low * (high - low) / (f_high - f_low)
            # Stay inside, and off the ends by the resolution, or the other end never moves.
            middle = min(max(middle, low + resolution / 2), high - resolution / 2)
        if not low < middle < high:
            break
        value = changed(middle)
        if value >= 0:
            high, f_high = middle, value
            if side == 1:
                f_low /= 2
            side = 1
        else:
            low, f_low = middle, value
            if side == -1:
                f_high /= 2
            side = -1
    return high
