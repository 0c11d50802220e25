"""Measures: quadratures over accepted steps by dense output. They watch the run and never steer it.

In each step e = of - against is taken at the five nodes of Lobatto's rule (order 8). What happens between the nodes
(a change of sign of e, a peak, a turn, the entry into a band) is looked for on the quartic through them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import copy
from typing import Any

import numpy as np

from ..plan import Plan, Reference
from .methods import Interpolant
from .recording import Recording

__all__ = ["Measures"]

Array = np.ndarray[Any, Any]
NODES = np.array([0.0, (1 - math.sqrt(3 / 7)) / 2, 0.5, (1 + math.sqrt(3 / 7)) / 2, 1.0])
WEIGHTS = np.array([1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20])
_FINE = np.linspace(0.0, 1.0, 129)
_SQUARES = ("ISE", "ISU", "mean_square")
_ABSOLUTES = ("IAE", "ITAE")
_ROWS = 512  # steps that are looked through at once


def _lagrange(at: Array) -> Array:
    """The matrix that takes values at the nodes to those of their polynomial at other points."""
    made = np.ones((len(at), len(NODES)))
    for i, node in enumerate(NODES):
        for other in np.delete(NODES, i):
            made[:, i] *= (at - other) / (node - other)
    return made


_TO_FINE = _lagrange(_FINE)

Values = Callable[[float, Array], tuple[float, ...]]
"""All `of` and `against` at (t, x), one after the other."""


_DEEPEST = 8  # so many times a step is halved for the measures at most
_FOURTH = 1.0 / np.array([np.prod(NODES[i] - np.delete(NODES, i)) for i in range(5)])  # the coefficient of theta^4


def _is_resolved(table: Array) -> bool:
    """Whether five values (5, m) tell how each signal goes between them: the quartic's last term is small.

    Ripples on a signal that stands nearly still do not count: a stiff loop has them from step to step.
    """
    low, high = table.min(axis=0), table.max(axis=0)
    span = high - low
    moving = span > 1e-3 * np.maximum(np.abs(low), np.abs(high)) + 1e-300
    return not np.any(moving & (np.abs(_FOURTH @ table) > 0.3 * span))


class Measures:
    """The measures of one run up to some time. They are replaced step by step, never changed.

    A window holds its beginning, and its end if the run ends there.
    """

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
        self.first: list[float | None] = [None] * self.count  # t at which the window begins
        self.begin = [math.nan] * self.count  # `of` there
        self.target = [math.nan] * self.count  # `against` where it ends
        self.last = [math.nan] * self.count  # e at the end of the step before, for jumps
        self.extremes = [(math.inf, -math.inf)] * self.count  # least and largest `of`
        types = [spec.type for spec in self.specs]
        # Of each step: t0, h and `of` at the nodes.
        self.paths = {i: Recording(6) for i, t in enumerate(types) if t == "settling_time"}
        self.squares = np.array([i for i, t in enumerate(types) if t in _SQUARES], dtype=int)
        self.absolutes = np.array([i for i, t in enumerate(types) if t in _ABSOLUTES], dtype=int)
        self.timed = np.array([types[i] == "ITAE" for i in self.absolutes], dtype=bool)  # which of them weigh with t
        self.others = [i for i, t in enumerate(types) if t not in (*_SQUARES, *_ABSOLUTES)]
        self.known: tuple[float, Array] | None = None

    def after_instant(self, t: float, row: tuple[float, ...]) -> Measures:
        """The measures with the values after an instant that changed something."""
        made = self._copy()
        values = np.array(row)
        made.known = (t, values)
        for i in self.others:
            if self.low[i] <= t < self.high[i]:
                made._other(i, t, values[2 * i : 2 * i + 1], values[2 * i + 1 : 2 * i + 2])
        return made

    def after_step(self, interpolant: Interpolant, t1: float, values: Values) -> Measures:
        """The measures with one accepted step, from interpolant.t0 to t1."""
        t0 = interpolant.t0
        if not self.count or t1 <= t0:
            return self
        made = self._copy()
        if not self.windowed:
            made._take(interpolant, t0, t1, values, None)
            return made
        for low, high in {(max(lo, t0), min(hi, t1)) for lo, hi in zip(self.low, self.high, strict=True)}:
            if low < high:
                picked = (np.maximum(self.low, t0) == low) & (np.minimum(self.high, t1) == high)
                made._take(interpolant, low, high, values, picked)
        return made

    def _copy(self) -> Measures:
        """A copy to be filled. The paths are shared: a step that is retaken stands in them twice, without harm."""
        made = copy(self)
        made.total, made.span = self.total.copy(), self.span.copy()
        made.first, made.begin, made.target = [*self.first], [*self.begin], [*self.target]
        made.last, made.extremes = [*self.last], [*self.extremes]
        return made

    def saved(self) -> dict[str, Array | dict[str, Array]]:
        """All that the rest of a run needs, as arrays."""
        nan = math.nan
        return {
            "total": self.total,
            "span": self.span,
            "first": np.array([nan if t is None else t for t in self.first]),
            "begin": np.array(self.begin),
            "target": np.array(self.target),
            "last": np.array(self.last),
            "extremes": np.array(self.extremes).reshape(self.count, 2),
            "known": np.empty(0) if self.known is None else np.array([self.known[0], *self.known[1]]),
            "paths": {str(i): np.column_stack(path.arrays()) for i, path in self.paths.items()},
        }

    def restored(self, saved: Mapping[str, Any]) -> Measures:
        """The measures of the same plan as they were saved."""
        made = self._copy()
        made.total, made.span = saved["total"].copy(), saved["span"].copy()
        made.first = [None if math.isnan(t) else t for t in saved["first"].tolist()]
        made.begin, made.target, made.last = (saved[key].tolist() for key in ("begin", "target", "last"))
        made.extremes = [(low, high) for low, high in saved["extremes"].tolist()]
        known = saved["known"]
        made.known = (float(known[0]), known[1:].copy()) if len(known) else None
        made.paths = {i: Recording(6) for i in self.paths}
        for i, path in made.paths.items():
            for row in saved["paths"][str(i)]:
                path.add(float(row[0]), row[1:])
        return made

    def _take(
        self, interpolant: Interpolant, t0: float, t1: float, values: Values, picked: Array | None, depth: int = 0
    ) -> None:
        h = t1 - t0
        t = t0 + NODES * h
        whole = t0 == interpolant.t0 and abs(h - interpolant.h) <= 1e-12 * interpolant.h
        theta = NODES if whole else (t - interpolant.t0) / interpolant.h
        x = interpolant(theta)
        table = np.empty((5, 2 * self.count))
        first = 0
        if self.known is not None and self.known[0] == t0:
            table[0], first = self.known[1], 1
        for k in range(first, 5):
            table[k] = values(float(t[k]), x[k])
        if depth < _DEEPEST and not _is_resolved(table):
            # The solver's steps follow the states; a signal of time alone may turn more often than they.
            middle = t0 + h / 2
            self._take(interpolant, t0, middle, values, picked, depth + 1)
            self._take(interpolant, middle, t1, values, picked, depth + 1)
            return
        self.known = (t1, table[4])
        of, against = table[:, 0::2].T, table[:, 1::2].T
        self._integrals(of - against, t, h, picked)
        self.span += h if picked is None else np.where(picked, h, 0.0)
        for i in self.others:
            if picked is None or picked[i]:
                self._other(i, t0, of[i], against[i])
                if i in self.paths:
                    self.paths[i].add(t0, (h, *of[i]))

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
                made[row] = _absolute_integral(rows[row], t[0], h, weighted=bool(self.timed[row]))
            gain[self.absolutes] = made
        self.total += gain if picked is None else np.where(picked, gain, 0.0)

    def _other(self, i: int, t0: float, of: Array, against: Array) -> None:
        """Take in the values of one measure: five from a step, or one after an instant."""
        kind, e = self.specs[i].type, of - against
        if self.first[i] is None:
            self.first[i], self.begin[i], self.last[i] = t0, float(of[0]), float(e[0])
        self.target[i] = float(against[-1])
        if kind == "peak":
            most = float(np.max(np.abs(e)))
            if most > 0.9 * self.total[i]:
                most = max(most, float(np.max(np.abs(_with_turns(e)))))
            self.total[i] = max(self.total[i], most)
        elif kind == "total_variation":
            self.total[i] += abs(float(e[0]) - self.last[i]) + float(np.sum(np.abs(np.diff(_with_turns(e)))))
        elif kind == "overshoot":
            (low, high), path = self.extremes[i], _with_turns(of)
            self.extremes[i] = min(low, float(path.min())), max(high, float(path.max()))
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
            elif spec.type == "overshoot":
                value = self._overshoot(i)
            elif spec.type == "settling_time":
                value = self._settling_time(i)
            made[spec.name] = value
        return made

    def _overshoot(self, i: int) -> float:
        """How far `of` goes beyond the last `against`, as a part of the step from the first `of` to there."""
        low, high = self.extremes[i]
        size = self.target[i] - self.begin[i]
        if size == 0.0:
            return math.nan
        return max(0.0, ((high if size > 0 else low) - self.begin[i]) / size - 1.0)

    def _settling_time(self, i: int) -> float:
        """From the window's beginning to the last entry of `of` into the band around the last `against`."""
        first, target = self.first[i], self.target[i]
        band = self.specs[i].band * abs(target - self.begin[i])
        if band == 0.0 or first is None:
            return math.nan
        t, rows = self.paths[i].arrays()
        for end in range(len(t), 0, -_ROWS):
            begin = max(0, end - _ROWS)
            outside = np.abs(rows[begin:end, 1:] @ _TO_FINE.T - target) > band
            if np.any(outside):
                step = begin + int(np.nonzero(outside.any(axis=1))[0][-1])
                k = int(np.nonzero(outside[step - begin])[0][-1])
                if step == len(t) - 1 and k == len(_FINE) - 1:
                    return math.nan  # the run ends outside
                return float(t[step] + _entry(rows[step, 1:], k, target, band) * rows[step, 0] - first)
        return 0.0


def _entry(y: Array, k: int, target: float, band: float) -> float:
    """Where in a step (0 to 1) a signal enters the band, which it is outside of at the fine point k and never after."""
    if k == len(_FINE) - 1:
        return 1.0  # it jumps into the band
    low, high = float(_FINE[k]), float(_FINE[k + 1])
    while high - low > 1e-12:
        middle = (low + high) / 2
        if abs(float(_lagrange(np.array([middle]))[0] @ y) - target) > band:
            low = middle
        else:
            high = middle
    return high


def _with_turns(y: Array) -> Array:
    """Values at the nodes of a step, with those at the turns of the quartic between them, in order."""
    if len(y) < 5 or (y[1:] >= y[:-1]).all() or (y[1:] <= y[:-1]).all():
        return y
    fine = _TO_FINE @ y
    slope = np.diff(fine)
    k = np.nonzero((slope[:-1] * slope[1:] <= 0) & (slope[:-1] != slope[1:]))[0]
    # The vertex of the parabola through the three points around each turn.
    vertices = fine[k + 1] - (slope[k] + slope[k + 1]) ** 2 / (8 * (slope[k + 1] - slope[k]))
    return np.concatenate([y[:1], vertices, y[-1:]])


def _absolute_integral(e: Array, t0: float, h: float, *, weighted: bool) -> float:
    """The integral of |e|, or of t |e|, over a step in which e changes its sign: from zero to zero."""
    fine = _TO_FINE @ e
    k = np.nonzero(fine[:-1] * fine[1:] < 0)[0]
    zeros = _FINE[k] + (_FINE[k + 1] - _FINE[k]) * fine[k] / (fine[k] - fine[k + 1])
    ends = np.concatenate([[0.0], zeros, [1.0]])
    width = np.diff(ends)
    theta = ends[:-1, None] + width[:, None] * NODES
    values = np.abs((_lagrange(theta.ravel()) @ e).reshape(theta.shape))
    if weighted:
        values = values * (t0 + theta * h)
    return float(h * (width @ (values @ WEIGHTS)))
