"""Where in a step a side changes first.

A crossing is looked for on the polynomial through five values inside the step, so that two crossings in one step
are found: where its Bernstein coefficients all lie on the latched side, it cannot leave it. Otherwise the extrema of
the polynomial are tested too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...text.arrays import Array
from ..run.history import NODES, POWERS

# Coefficients of powers -> Bernstein coefficients: b_i = sum_k C(i, k) / C(4, k) a_k.
_BERNSTEIN = (
    np.array([[math.comb(i, k) / math.comb(4, k) if k <= i else 0.0 for k in range(5)] for i in range(5)]) @ POWERS
)


class Found(NamedTuple):
    """An interval (low, high] of a step in which a side changes, and the crossing values at its end."""

    low: float
    high: float
    values: Array


def first_change(
    values: Array,
    sides: Array,
    evaluate: Callable[[float], Array],
    changed: Callable[[float, Array], Array],
    begin: float = 0.0,
    end: float = 1.0,
) -> Found | None:
    """The interval of a step in which the first change of a side in a part lies, or None.

    values: (5, m) crossing values at NODES of the part. sides: (m,) latched sides. evaluate: values (m,) at another
    place of the step. changed: which sides have changed at a place with values. begin, end: of the part, where the step
    goes from 0 to 1.
    """
    bounds = _BERNSTEIN @ values
    safe = np.where(sides, bounds.min(axis=0) >= 0, bounds.max(axis=0) < 0)  # false where a value is not finite
    if safe.all():
        return None
    points = {float(theta): values[k] for k, theta in enumerate(NODES)}
    for j in np.nonzero(~safe)[0]:
        coefficients = POWERS @ values[:, j]
        if not np.isfinite(coefficients).all():
            continue
        slope = coefficients[1:] * np.arange(1, 5)
        while len(slope) > 1 and abs(slope[-1]) <= 1e-14 * np.max(np.abs(slope)):
            slope = slope[:-1]
        for root in np.roots(slope[::-1]):
            theta = float(root.real)
            if abs(root.imag) <= 1e-8 and 0.0 < theta < 1.0 and theta not in points:
                points[theta] = evaluate(begin + theta * (end - begin))
    low = begin
    for theta in sorted(points):
        place = begin + theta * (end - begin)
        if theta > 0.0 and np.any(changed(place, points[theta])):
            return Found(low, place, points[theta])
        low = place
    return None


def slope(values: Array) -> tuple[Array, Array]:
    """The derivatives (m,) by theta, at the start of the step, of the polynomials through values (5, m).

    With them the size of their last terms, which shows how far the signals may differ from the polynomials.
    """
    coefficients = POWERS @ values
    return np.asarray(coefficients[1]), np.abs(coefficients[4])


def narrowed(changed: Callable[[float], float], low: float, high: float, resolution: float) -> float:
    """The right end of the smallest interval that holds the first change.

    changed(h): negative before the change, zero or positive after it (a continuous measure of how far).
    low is before, high after it; `low` is returned where it is not. Needs one call more than bisection at worst,
    and far fewer where `changed` is smooth.

    References: I. F. D. Oliveira, R. H. C. Takahashi, An enhancement of the bisection method average performance
    preserving minmax optimality, ACM Transactions on Mathematical Software 47 (2020).
    """
    f_low, f_high = changed(low), changed(high)
    if f_low >= 0:
        return low
    width = high - low
    radius = resolution * 2.0 ** math.ceil(math.log2(max(width / resolution, 1.0)))  # of bisection, one call behind
    while high - low > resolution:
        middle = (low + high) / 2
        size = high - low
        x = middle
        if math.isfinite(f_low) and math.isfinite(f_high) and f_high > f_low:
            x = low - f_low * size / (f_high - f_low)
            towards = math.copysign(1.0, middle - x)
            # Off the root by something, towards the far end, or that end would never move.
            shift = max(0.02 / width * size**2, resolution / 4)
            x = x + towards * shift if shift <= abs(middle - x) else middle
            slack = max(radius - size / 2, 0.0)
            if abs(x - middle) > slack:
                x = middle - towards * slack
        radius /= 2
        if not low < x < high:
            x = middle
            if not low < middle < high:
                break
        value = changed(x)
        if value >= 0:
            high, f_high = x, value
        else:
            low, f_low = x, value
    return high
