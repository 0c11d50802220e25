"""What histories remember: the signals of the past steps as polynomials, and the times at which they broke.

A signal is kept step by step, as the polynomial through five of its values; a step in which that does not resolve it
is cut into parts. A break is a time at which it may jump or bend: the start, and every instant. A delayed signal
breaks one delay later: an instant stands there, and up to it the values before the break are seen, from it on those
after it, as with every other edge.

A break is smoothed each time it passes an integrator. One that came back through the histories is followed until it
is one of a derivative of the fourth order; but what jumps or bends still is a new one.

Reference: L. F. Shampine, S. Thompson, Solving DDEs in MATLAB, Applied Numerical Mathematics 37 (2001), on breaks.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..plan import History, Plan
from .grid import within_ulps
from .locate import NODES, POWERS

__all__ = ["Past"]

Array = np.ndarray[Any, Any]
Row = Sequence[float]

ORDER = 4  # derivatives above this one may jump inside a step: the methods do not see it
_CHECKS = (0.125, 0.875)  # where a polynomial is compared with its signal
_PARTS = 10  # a step is halved so often at most
_JUMP = 1e-9  # relative size below which a jump or a bend is one of rounding and interpolation


@dataclass(frozen=True, slots=True)
class Past:
    """The past of all histories of a Plan up to now. It is replaced, never changed.

    starts, ends: of the parts, in s. parts: their polynomials, coefficients of 1, th, ..., th^4 for th from 0 to 1,
    and the values at th = 1, (6, m). breaks: times and their orders (0: a jump, 1: a bend); the last one may still
    be open (order -1), as the part after it is not known yet. passed: for each history the number of breaks that
    lie a delay ago or more. seen: the order of the break that the instant now makes, if it is not a lower one by
    the signals themselves.
    """

    histories: tuple[History, ...]
    starts: tuple[float, ...]
    ends: tuple[float, ...]
    parts: tuple[Array, ...]
    breaks: tuple[tuple[float, int], ...]
    passed: tuple[int, ...]
    seen: int

    @classmethod
    def at_start(cls, plan: Plan, t: float) -> Past | None:
        """Nothing but the start, which is a break; None where nothing is remembered."""
        if not plan.histories:
            return None
        return cls(plan.histories, (), (), (), ((t, -1),), (0,) * len(plan.histories), 0)

    @property
    def longest_step(self) -> float:
        """A step that is shorter than every delay, also when it is stretched a little, needs no future."""
        return min(history.delay for history in self.histories) / 1.02

    def values(self, t: float) -> tuple[float, ...]:
        """What the histories give at t, which lies between now and the next break."""
        return tuple(self._value(i, history, t) for i, history in enumerate(self.histories))

    def _value(self, i: int, history: History, t: float) -> float:
        passed = self.passed[i]
        if passed == 0:
            return history.before
        then = max(t - history.delay, self.breaks[passed - 1][0])
        k = bisect_right(self.starts, then) - 1
        if passed < len(self.breaks) and self.breaks[passed][0] <= then:
            then = self.breaks[passed][0]
            k = bisect_left(self.starts, then) - 1  # the part that ends there
        k = max(k, 0)
        a0, a1, a2, a3, a4, end = self.parts[k][:, i]
        if then >= self.ends[k]:
            return float(end)
        theta = (then - self.starts[k]) / (self.ends[k] - self.starts[k])
        return float(a0 + theta * (a1 + theta * (a2 + theta * (a3 + theta * a4))))

    def next_break(self) -> float:
        """The next time at which a history breaks; inf: none known."""
        times = [
            self.breaks[passed][0] + history.delay
            for passed, history in zip(self.passed, self.histories, strict=True)
            if passed < len(self.breaks)
        ]
        return min(times, default=math.inf)

    def after_breaks(self, t: float) -> Past:
        """The past as it is seen from the instant at t on; itself where no history breaks there."""
        passed, seen = list(self.passed), self.seen
        for i, history in enumerate(self.histories):
            while passed[i] < len(self.breaks):
                due = self.breaks[passed[i]][0] + history.delay
                if due > t and not within_ulps(due, t):
                    break
                # What is integrated is smoother by one order.
                seen = min(seen, self.breaks[passed[i]][1] + 1)
                passed[i] += 1
        return self if tuple(passed) == self.passed else replace(self, passed=tuple(passed), seen=seen)

    def after_instant(self, t: float, *, changed: bool) -> Past:
        """The past with a break at t, whose order is known once the signals after it are.

        changed: whether anything but histories changed at t.
        """
        seen = min(self.seen, 2) if changed else self.seen
        if seen > ORDER or self.breaks[-1][0] == t:
            return replace(self, seen=seen)
        return replace(self, breaks=(*self.breaks, (t, -1)), seen=seen)

    def after_step(
        self, t0: float, t1: float, signals: Callable[[float], Row], tolerance: Callable[[Array], Array]
    ) -> Past:
        """The past with the step from t0 to t1, in which `signals` gives the values of all sources.

        tolerance: the error that a part may have, from the largest size of each signal.
        """
        added = _resolved(t0, t1, signals, tolerance)
        breaks = list(self.breaks)
        time, order = breaks[-1]
        if order < 0:
            breaks[-1] = (time, self._order(added[0]))
        # What no history sees any more is forgotten; breaks are kept as long as one has not passed them.
        horizon = t1 - max(history.delay for history in self.histories)
        first = max(bisect_right(self.ends, horizon) - 1, 0)
        done = max(min(self.passed) - 1, 0)
        return replace(
            self,
            starts=(*self.starts[first:], *(part[0] for part in added)),
            ends=(*self.ends[first:], *(part[1] for part in added)),
            parts=(*self.parts[first:], *(part[2] for part in added)),
            breaks=tuple(breaks[done:]),
            passed=tuple(n - done for n in self.passed),
            seen=ORDER + 1,
        )

    def _order(self, part: tuple[float, float, Array]) -> int:
        """The order of the break between the past and the part that follows it."""
        if not self.parts:
            return 0
        start, end, after = part
        before, h = self.parts[-1], self.ends[-1] - self.starts[-1]
        size = np.maximum(np.abs(before).max(axis=0), np.abs(after).max(axis=0))
        if np.any(np.abs(before[5] - after[0]) > _JUMP * size):
            return 0
        slope_before, slope_after = np.arange(5) @ before[:5] / h, after[1] / (end - start)
        steepness = np.maximum(np.abs(slope_before), np.abs(slope_after))
        # Slopes of interpolants are known to a few digits only.
        bends = np.abs(slope_before - slope_after) > 1e-3 * steepness + _JUMP * size / (end - start)
        return 1 if np.any(bends) else self.seen


def _resolved(
    t0: float, t1: float, signals: Callable[[float], Row], tolerance: Callable[[Array], Array]
) -> list[tuple[float, float, Array]]:
    """Parts of a step, each with its polynomial, so short that they give the signals."""
    made: list[tuple[float, float, Array]] = []
    waiting = [(t0, t1, 0)]
    while waiting:
        begin, end, halved = waiting.pop()
        h = end - begin
        values = np.array([signals(end if theta == 1.0 else begin + theta * h) for theta in NODES])
        # By differences from the first value, so that what is constant stays so to the last bit.
        part = np.vstack([values[:1], POWERS[1:, 1:] @ (values[1:] - values[0]), values[-1:]])
        if halved < _PARTS and h > 1e3 * math.ulp(end):
            allowed = tolerance(np.abs(values).max(axis=0))
            for theta in _CHECKS:
                given = theta ** np.arange(5) @ part[:5]
                if np.any(np.abs(given - np.array(signals(begin + theta * h))) > allowed):
                    middle = begin + h / 2
                    waiting += [(middle, end, halved + 1), (begin, middle, halved + 1)]
                    break
            else:
                made.append((begin, end, part))
        else:
            made.append((begin, end, part))
    return made
