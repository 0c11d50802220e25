"""Quartics: what a signal does between its values at the five nodes of Lobatto's rule.

Values y have the nodes first: shape (5, n) for the n parts of steps, each of length 1 here. What is made of one part
does not depend, bit for bit, on how many come at once.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from ...text.arrays import Array

NODES = np.array([0.0, (1 - math.sqrt(3 / 7)) / 2, 0.5, (1 + math.sqrt(3 / 7)) / 2, 1.0])
WEIGHTS = np.array([1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20])
FINE = np.linspace(0.0, 1.0, 129)


def _lagrange(at: Array) -> Array:
    """At points of any shape, the polynomials (5, *shape) that are 1 at one node and 0 at the others."""
    basis = np.ones((len(NODES), *at.shape))
    for i, node in enumerate(NODES):
        for other in np.delete(NODES, i):
            basis[i] *= (at - other) / (node - other)
    return basis


def weighted(weights: Array, y: Array) -> Array:
    """The sum of weights * y over the nodes, which come first.

    A product of matrices is rounded in one way for one column and in another for many: the measures would depend on
    how many records come at once.
    """
    total: Array = weights[0] * y[0]
    for k in range(1, len(NODES)):
        total = total + weights[k] * y[k]
    return total


TO_FINE = _lagrange(FINE)
_NEAR_ENDS = TO_FINE[:, [1, -2]]
# How far from the middle of its values at the nodes, in halves of their span, a quartic is looked for. The sizes of the
# polynomials bound it at the fine points. Two of these differ by a quarter of that bound at most (Markov's inequality),
# and the vertex of a parabola lies beyond its three points by an eighth of their difference at most.
_REACH = 1.05 * float(np.abs(TO_FINE).sum(axis=0).max())


def entry(y: Array, k: int, target: float, band: float) -> float:
    """Where in a step (0 to 1) a signal enters the band, which it is outside of at the fine point k and never after."""
    if k == len(FINE) - 1:
        return 1.0  # it jumps into the band
    low, high = float(FINE[k]), float(FINE[k + 1])
    while high - low > 1e-12:
        middle = (low + high) / 2
        if abs(float(weighted(_lagrange(np.array(middle)), y)) - target) > band:
            low = middle
        else:
            high = middle
    return high


def first_reach(y: Array, level: float) -> float:
    """Where (0 to 1) the quartic through y (5,) first reaches a level from below, among or between the fine points."""
    reaches = weighted(TO_FINE, y[:, None]) >= level
    k = int(np.argmax(reaches))
    if k == 0:
        return 0.0 if reaches[0] else 1.0
    low, high = float(FINE[k - 1]), float(FINE[k])
    while high - low > 1e-12:
        middle = (low + high) / 2
        if float(weighted(_lagrange(np.array(middle)), y)) < level:
            low = middle
        else:
            high = middle
    return high


def fourier(e: Array, since: float, h: float, omega: float) -> Array:
    """Integrals over a part of length h of the quartic e (5,): of itself, of its square, and of its products with the
    cosine and the sine of omega t, where t is `since` at its beginning; by pieces of an eighth of a turn."""
    count = math.ceil(h * omega / (math.pi / 4))
    theta = (np.arange(count) + NODES[:, None]) / count
    y, at = weighted(_lagrange(theta), e[:, None, None]), omega * (since + theta * h)
    with np.errstate(over="ignore"):  # infinite squares make a value that there is none
        sums = [weighted(WEIGHTS, values).sum() for values in (y, y * y, y * np.cos(at), y * np.sin(at))]
    return h / count * np.array(sums)


def _turns(y: Array) -> tuple[Array, Array]:
    """The turns of the quartics through the columns of y (5, n): the column of each and the value there, in order."""
    slope = np.diff(y, axis=0)
    # A turn between the first two nodes or the last two hides from them; the fine points next to the ends show it.
    near = weighted(_NEAR_ENDS[:, :, None], y[:, None])
    hidden = ((near[0] - y[0]) * slope[0] < 0) | ((y[4] - near[1]) * slope[3] < 0)
    columns = np.nonzero((slope < 0).any(axis=0) & (slope > 0).any(axis=0) | hidden)[0]
    if not len(columns):
        return columns, np.empty(0)
    fine = weighted(TO_FINE[:, None, :], y[:, columns, None])
    slope = np.diff(fine, axis=1)
    column, k = np.nonzero((slope[:, :-1] * slope[:, 1:] <= 0) & (slope[:, :-1] != slope[:, 1:]))
    before, after = slope[column, k], slope[column, k + 1]
    # The vertex of the parabola through the three points around each turn.
    return columns[column], fine[column, k + 1] - (before + after) ** 2 / (8 * (after - before))


def reached(y: Array, low: float, high: float) -> tuple[float, float]:
    """The least and the largest of low, high and what the columns of y (5, n) reach, at the nodes or between them."""
    bottom, top = y.min(axis=0), y.max(axis=0)
    low, high = min(low, float(bottom.min())), max(high, float(top.max()))
    beyond = (_REACH - 1) / 2 * (top - bottom)
    _, turns = _turns(y[:, (bottom - beyond < low) | (top + beyond > high)])
    return float(turns.min(initial=low)), float(turns.max(initial=high))


def variations(y: Array) -> Array:
    """How far the quartics through the columns of y (5, n) go up and down, shape (n,)."""
    column, turns = _turns(y)
    column, begin, end = _pieces(column, y[0], turns, y[-1])
    return np.bincount(column, np.abs(end - begin), minlength=y.shape[1])


def absolute_integrals(e: Array, t: Array, h: Array, timed: Array) -> Array:
    """The integrals of |e|, or of t |e| where timed, over parts in which e (5, n) changes its sign."""
    fine = weighted(TO_FINE[:, None, :], e[:, :, None])
    column, k = np.nonzero(fine[:, :-1] * fine[:, 1:] < 0)
    before, after = fine[column, k], fine[column, k + 1]
    zeros = FINE[k] + (FINE[k + 1] - FINE[k]) * before / (before - after)
    column, begin, end = _pieces(column, np.zeros_like(t), zeros, np.ones_like(t))
    theta = begin + (end - begin) * NODES[:, None]
    values = np.abs(weighted(_lagrange(theta), e[:, None, column]))
    values *= np.where(timed[column], t[column] + theta * h[column], 1.0)
    return h * np.bincount(column, (end - begin) * weighted(WEIGHTS, values), minlength=len(t))


def _pieces(column: Array, first: Array, inner: Array, last: Array) -> tuple[Array, Array, Array]:
    """The pieces from first over the inner points to last, column by column: their column, begin and end.

    column says of which column an inner point is; those of one column are in order.
    """
    all_columns = np.arange(len(first))
    columns = np.concatenate([all_columns, column, all_columns])
    order = np.argsort(columns, kind="stable")
    columns, points = columns[order], np.concatenate([first, inner, last])[order]
    inside = columns[1:] == columns[:-1]
    return columns[1:][inside], points[:-1][inside], points[1:][inside]


class Interpolant(Protocol):
    """The states inside a step."""

    @property
    def t0(self) -> float: ...

    @property
    def h(self) -> float: ...

    def __call__(self, theta: Array) -> Array:
        """States at t0 + theta h: from shape (m,) to (m, n)."""
