"""Measures: quadratures over accepted steps by dense output. They watch the run and never steer it.

In each step e = of - against is taken at the five nodes of Lobatto's rule (order 8). Where |e| has a kink inside a step,
the quartic through the nodes is integrated piece by piece.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..plan import Plan, Reference
from .methods import Interpolant

__all__ = ["Measures"]

Array = np.ndarray[Any, Any]
NODES = np.array([0.0, (1 - math.sqrt(3 / 7)) / 2, 0.5, (1 + math.sqrt(3 / 7)) / 2, 1.0])
WEIGHTS = np.array([1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20])
_FINE = np.linspace(0.0, 1.0, 129)
_SQUARES = ("ISE", "ISU", "mean_square")
_ABSOLUTES = ("IAE", "ITAE")


def _lagrange(nodes: Array, at: Array) -> Array:
    """The matrix that takes values at nodes to those of their polynomial at other points."""
    made = np.ones((len(at), len(nodes)))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            made[:, i] *= (at - other) / (node - other)
    return made


_TO_FINE = _lagrange(NODES, _FINE)

Values = Callable[[float, Array], tuple[float, ...]]
"""All `of` and `against` at (t, x), one after the other."""


class Measures:
    """The measures of one run, fed step by step."""

    def __init__(self, plan: Plan) -> None:
        self.specs = plan.measures
        self.count = len(self.specs)
        self.references: list[Reference] = []
        for spec in self.specs:
            self.references.append(plan.signal(spec.of).references[0])
            against = spec.against
            self.references.append(
                plan.signal(against).references[0] if isinstance(against, str) else ("k", float(against))
            )
        self.low = np.array([spec.start for spec in self.specs])
        self.high = np.array([spec.stop for spec in self.specs])
        self.windowed = bool(np.any(np.isfinite(self.low)) or np.any(np.isfinite(self.high)))
        self.total = np.zeros(self.count)  # the integral, the peak or the variation so far
        self.span = np.zeros(self.count)  # how much of the window was seen
        self.begin: list[float | None] = [None] * self.count  # `of` where the window begins
        self.target = [math.nan] * self.count  # `against` where it ends
        self.last: list[float | None] = [None] * self.count  # e at the end of the step before, for jumps
        self.paths: list[list[tuple[Array, Array]]] = [[] for _ in self.specs]  # t and `of`, where needed at the end
        types = [spec.type for spec in self.specs]
        self.squares = np.array([i for i, t in enumerate(types) if t in _SQUARES], dtype=int)
        self.absolutes = np.array([i for i, t in enumerate(types) if t in _ABSOLUTES], dtype=int)
        self.timed = np.array([types[i] == "ITAE" for i in self.absolutes], dtype=bool)  # which of them weigh with t
        self.others = [i for i, t in enumerate(types) if t not in (*_SQUARES, *_ABSOLUTES)]
        self.known: tuple[float, Array] | None = None

    def jumped(self) -> None:
        """The values at the current time may have changed."""
        self.known = None

    def step(self, interpolant: Interpolant, t1: float, values: Values) -> None:
        """Take in one accepted step from interpolant.t0 to t1."""
        t0 = interpolant.t0
        if not self.count or t1 <= t0:
            return
        if not self.windowed:
            self._take(interpolant, t0, t1, values, None)
            return
        for low, high in {(max(lo, t0), min(hi, t1)) for lo, hi in zip(self.low, self.high, strict=True)}:
            if low < high:
                picked = (np.maximum(self.low, t0) == low) & (np.minimum(self.high, t1) == high)
                self._take(interpolant, low, high, values, picked)

    def _take(self, interpolant: Interpolant, t0: float, t1: float, values: Values, picked: Array | None) -> None:
        h = t1 - t0
        t = t0 + NODES * h
        whole = t0 == interpolant.t0 and abs(h - interpolant.h) <= 1e-12 * interpolant.h
        theta = NODES if whole else (t - interpolant.t0) / interpolant.h
        x = interpolant(theta)
        table = np.empty((5, 2 * self.count))
        first = 0
        if whole and self.known is not None and self.known[0] == t0:
            table[0], first = self.known[1], 1
        for k in range(first, 5):
            table[k] = values(float(t[k]), x[k])
        if whole:
            self.known = (t1, table[4])
        of, against = table[:, 0::2].T, table[:, 1::2].T
        e = of - against
        self._integrals(e, t, h, picked)
        self.span += h if picked is None else np.where(picked, h, 0.0)
        for i in self.others:
            if picked is None or picked[i]:
                self._other(i, t, of[i], against[i], e[i])

    def _integrals(self, e: Array, t: Array, h: float, picked: Array | None) -> None:
        gain = np.zeros(self.count)
        if len(self.squares):
            gain[self.squares] = h * (e[self.squares] ** 2 @ WEIGHTS)
        if len(self.absolutes):
            rows = e[self.absolutes]
            size = np.abs(rows)
            size[self.timed] *= t
            made = h * (size @ WEIGHTS)
            for row in np.nonzero((rows.min(axis=1) < 0) & (rows.max(axis=1) > 0))[0]:
                made[row] = _absolute_integral(rows[row], t, h, weighted=bool(self.timed[row]))
            gain[self.absolutes] = made
        self.total += gain if picked is None else np.where(picked, gain, 0.0)

    def _other(self, i: int, t: Array, of: Array, against: Array, e: Array) -> None:
        spec, last = self.specs[i], self.last[i]
        if self.begin[i] is None:
            self.begin[i] = float(of[0])
        self.target[i] = float(against[-1])
        if spec.type == "peak":
            most = float(np.max(np.abs(e)))
            if most > 0.9 * self.total[i]:
                most = max(most, float(np.max(np.abs(_TO_FINE @ e))))
            self.total[i] = max(self.total[i], most)
        elif spec.type == "total_variation":
            jump = 0.0 if last is None else abs(float(e[0]) - last)
            self.total[i] += jump + float(np.sum(np.abs(np.diff(e))))
        else:
            self.paths[i].append((t, of))
        self.last[i] = float(e[-1])

    def results(self) -> dict[str, float]:
        """The values by name; NaN where the run did not reach the window."""
        made = {}
        for i, spec in enumerate(self.specs):
            value = float(self.total[i])
            if self.span[i] == 0.0:
                value = math.nan
            elif spec.type == "mean_square":
                value /= float(self.span[i])
            elif spec.type in ("overshoot", "settling_time"):
                value = self._response(i)
            made[spec.name] = value
        return made

    def _response(self, i: int) -> float:
        """Overshoot or settling time of a step from the first value of `of` to the last of `against`."""
        spec, begin, target = self.specs[i], self.begin[i], self.target[i]
        assert begin is not None
        size = target - begin
        if size == 0.0:
            return math.nan
        t = np.concatenate([part for part, _ in self.paths[i]])
        progress = (np.concatenate([part for _, part in self.paths[i]]) - begin) / size
        if spec.type == "overshoot":
            return max(0.0, _refined_maximum(t, progress) - 1.0)
        outside = np.abs(progress - 1.0) > spec.band
        if not np.any(outside):
            return 0.0
        k = int(np.nonzero(outside)[0][-1])
        if k == len(t) - 1:
            return math.nan
        a, b = abs(progress[k] - 1.0) - spec.band, abs(progress[k + 1] - 1.0) - spec.band
        # In a jump (two rows of one time) there is nothing to interpolate.
        share = a / (a - b) if a != b else 1.0
        start = max(spec.start, t[0])
        return float(t[k] + share * (t[k + 1] - t[k]) - start)


def _absolute_integral(e: Array, t: Array, h: float, *, weighted: bool) -> float:
    """The integral of |e|, or of t |e|, where e changes its sign: by trapezoids that end at the zeros."""
    fine, times = _TO_FINE @ e, t[0] + _FINE * h
    flips = np.nonzero(fine[:-1] * fine[1:] < 0)[0]
    zeros = times[flips] + (times[flips + 1] - times[flips]) * fine[flips] / (fine[flips] - fine[flips + 1])
    times = np.insert(times, flips + 1, zeros)
    values = np.abs(np.insert(fine, flips + 1, 0.0)) * (times if weighted else 1.0)
    return float(np.sum(np.diff(times) * (values[:-1] + values[1:]) / 2))


def _refined_maximum(t: Array, y: Array) -> float:
    """The largest value, with a parabola through the largest sample and its neighbors."""
    k = int(np.argmax(y))
    if not 0 < k < len(y) - 1 or not t[k - 1] < t[k] < t[k + 1]:
        return float(y[k])
    coefficients = np.polyfit((t[k - 1 : k + 2] - t[k]) / (t[k + 1] - t[k - 1]), y[k - 1 : k + 2], 2)
    if coefficients[0] >= 0:
        return float(y[k])
    return float(max(y[k], coefficients[2] - coefficients[1] ** 2 / (4 * coefficients[0])))
