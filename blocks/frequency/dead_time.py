"""Loops of a rational transfer R and a dead time T: L = R(s) exp(-s T), whose phase turns without end.

|L| is |R|, so that all that depends on the gain follows from R alone. Where L turns many times while R changes little,
the peaks of 1/(1 + L), L/(1 + L) and (1 - L)/(1 + L) in each turn go with 1/|1 - |R||: the largest of all are in the
first turns, beside a crossover or an extremum of |R|, or at infinite frequency. `stretches` are these places.

Encirclements are counted without following the turns: while |L| <= 1 the phase of 1 + L is within +-90 degrees, and
while |L| >= 1 it is that of L, which is known, and that of 1 + 1/L, which is within +-90 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..text.arrays import Array
from .realization import Realization
from .search import summit

_EPS = float(np.finfo(float).eps)
_FIRST = 64  # turns from zero frequency on that are looked at
_BESIDE = 4  # turns on either side of each place of interest
_PER_TURN = 64


def extrema(size: Callable[[Array], Array], omega: Array, sizes: Array) -> list[float]:
    """Find the frequencies at which a gain has a largest or least value between its neighbors on a grid."""
    places = []
    for sign in (1.0, -1.0):
        up = sign * sizes
        inner = (up[1:-1] >= up[:-2]) & (up[1:-1] >= up[2:])
        # On a level rounding makes extrema of its own.
        inner &= up[1:-1] - np.minimum(up[:-2], up[2:]) > 1e-12 * sizes[1:-1]
        for k in np.flatnonzero(inner) + 1:
            places.append(summit(lambda w: sign * size(w), float(omega[k - 1]), float(omega[k + 1]))[0])  # noqa: B023
    return places


def stretches(delay: float, omega: Array, places: Iterable[float]) -> list[Array]:
    """Make grids, in order and apart from each other: of the first turns, and of some turns beside each place.

    omega: the grid of R, whose points are kept.
    """
    turn = 2 * math.pi / delay
    spans = [(0.0, _FIRST * turn), *((w - _BESIDE * turn, w + _BESIDE * turn) for w in sorted(places))]
    joined = spans[:1]
    for low, high in spans[1:]:
        if low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], high))
        else:
            joined.append((low, high))
    grids = []
    for low, high in joined:
        even = np.arange(math.floor(low / turn * _PER_TURN) + 1, math.ceil(high / turn * _PER_TURN)) * turn / _PER_TURN
        grids.append(np.unique(np.concatenate([omega[(omega > low) & (omega < high)], even])))
    return grids


def is_stable(
    rational: Realization,
    delay: float,
    poles: Array,
    doubts: Array,
    omega: Array,
    crossovers: Sequence[float],
) -> bool:
    """Return whether 1 + R(s) exp(-s T) has no zeros with Re s >= 0, by encirclements.

    R has no hidden states. poles: of R, with how far rounding may have moved each; omega: a grid that shows R;
    crossovers: all frequencies at which |R| is 1. The path passes poles on the axis on their right.
    """
    if abs(float(rational.d[0, 0])) >= 1 - 8 * _EPS:
        return False  # infinitely many poles right of the axis, or ever closer to it

    def at(s: Array) -> Array:
        return np.asarray(rational.at(s)[0, 0])

    unstable, on_axis = int(np.sum(poles.real > doubts)), _on_axis(poles, doubts)
    unity = np.asarray(crossovers, dtype=float)
    points = np.unique(np.concatenate([omega, unity, 0.5 * (unity[1:] + unity[:-1])]))
    path = [np.zeros(0 if on_axis and on_axis[0][0] == 0 else 1, complex)]
    begin = 0.0
    for center, doubt in on_axis:
        radius = _radius(at, center, doubt, 1e-3 * min([1.0 / delay, *_distances(poles, center, doubt)]))
        path.append(1j * points[(points > begin) & (points < center - radius)])
        arc = np.exp(1j * math.pi * np.linspace(-0.5 if center else 0.0, 0.5, 65))
        path.append(1j * center + radius * arc)
        begin = center + radius
    path.append(1j * points[points > begin])
    turned = _turned(at, np.concatenate(path), delay, unity)
    return round(unstable - turned / math.pi) == 0


def _on_axis(poles: Array, doubts: Array) -> list[tuple[float, float]]:
    """Return the poles on the axis, from 0 up, each once: (frequency, doubt)."""
    near = np.abs(poles.real) <= doubts
    apart: list[tuple[float, float]] = []
    for center, doubt in sorted(zip(np.abs(poles.imag[near]).tolist(), doubts[near].tolist(), strict=True)):
        if apart and center - apart[-1][0] <= 20 * max(doubt, apart[-1][1]):
            apart[-1] = (apart[-1][0], max(doubt, apart[-1][1]))
        else:
            apart.append((0.0 if center <= doubt else center, doubt))
    return apart


def _distances(poles: Array, center: float, doubt: float) -> list[float]:
    """Return how far other poles are from one on the axis."""
    away = np.abs(poles - 1j * center)
    return [float(x) for x in away if x > 20 * doubt]


def _radius(at: Callable[[Array], Array], center: float, doubt: float, radius: float) -> float:
    """Return a distance from a pole within which 1 + L has no zero: |L| is large there, unless a zero cancels it."""
    least = max(20 * doubt, 1e-12 * radius)
    while radius > least and not abs(at(np.array([1j * center + radius]))[0]) > 10:
        radius *= 0.1
    return max(radius, least)


def _turned(at: Callable[[Array], Array], s: Array, delay: float, crossovers: Array) -> float:
    """Return by how much 1 + L turns along a path that goes up the axis and back to the right at infinity, in rad."""
    R = at(s)
    L = R * np.exp(-s * delay)
    unity = np.isin(s.imag, crossovers) & (s.real == 0)
    below, above = (np.abs(L) <= 1) | unity, (np.abs(L) >= 1) | unity
    step = np.angle((1.0 + L[1:]) / (1.0 + L[:-1]))
    inner = np.angle(1.0 + L)
    outer = np.angle(1.0 + 1.0 / np.where(L == 0, 1.0, L))
    of_loop = np.angle(R[1:] / np.where(R[:-1] == 0, 1.0, R[:-1])) - np.diff(s.imag) * delay
    is_below, is_above = below[1:] & below[:-1], above[1:] & above[:-1]
    turned = np.where(is_below, np.diff(inner), np.where(is_above, of_loop + np.diff(outer), step))
    return float(np.sum(turned)) - float(inner[-1])
