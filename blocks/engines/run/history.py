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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...compile.plan import Delay, Plan
from ...compile.time_grid import within_ulps
from ...text.arrays import Array

NODES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
POWERS = np.linalg.inv(NODES[:, None] ** np.arange(5))  # values at the nodes -> coefficients of 1, th, ..., th^4

ORDER = 4  # derivatives above this one may jump inside a step: the methods do not see it
COURSE = 2  # of a break that a master makes between two pieces of an extrapolation: no jump of what is meant
_JUMP = 1e-9  # relative size below which a jump or a bend is one of rounding and interpolation
_TRIM = 1024  # what is forgotten is taken out by so many parts at once, or copying would take most of the time


@dataclass(slots=True)
class Store:
    """Lists that only grow at their end. Each Past says how much of them it holds; one run alone adds to them."""

    starts: list[float] = field(default_factory=list)
    ends: list[float] = field(default_factory=list)
    parts: list[Array] = field(default_factory=list)
    breaks: list[tuple[float, int]] = field(default_factory=list)


def has_jumped(before: Array, after: Array) -> bool:
    """Return whether values differ by more than rounding, by which projections move them where a past breaks."""
    return bool(np.any(np.abs(after - before) > _JUMP * np.maximum(np.abs(before), np.abs(after))))


@dataclass(frozen=True, slots=True)
class Past:
    """The past of all histories of a Plan up to now. It is replaced, never changed.

    store: the parts (their begins and ends in s; their polynomials, coefficients of 1, th, ..., th^4 for th from 0 to
    1, and the values at th = 1, (6, m)) and the breaks (times and orders; 0: a jump, 1: a bend). known, broken: how
    many of them there are. open: whether the order of the last break is not known yet, as the part after it is not.
    passed: for each history the number of breaks that lie a delay ago or more. seen: the order of the break that the
    instant now makes, if it is not a lower one by the signals themselves. scale: of times, see Plan.
    """

    histories: tuple[Delay, ...]
    scale: float
    store: Store = field(compare=False, repr=False)
    known: int
    broken: int
    open: bool
    passed: tuple[int, ...]
    seen: int

    @classmethod
    def at_start(cls, plan: Plan, t: float) -> Past | None:
        """Nothing but the start, which is a break; None where nothing is remembered."""
        if not plan.histories:
            return None
        return cls(plan.delays, plan.time_scale, Store(breaks=[(t, 0)]), 0, 1, True, (0,) * len(plan.histories), 0)

    def rows(self) -> dict[str, Array]:
        """Return the same as rows of a saved state."""
        store, known, n = self.store, self.known, len(self.histories)
        times, orders = zip(*store.breaks[: self.broken], strict=True)
        return {
            "past.starts": np.array(store.starts[:known]),
            "past.ends": np.array(store.ends[:known]),
            "past.parts": np.array(store.parts[:known]).reshape(known, len(POWERS) + 1, n),
            "past.breaks": np.array(times),
            "past.orders": np.array(orders, dtype=np.int32),
            "past.open": np.array(self.open, dtype=np.int32),
            "past.passed": np.array(self.passed, dtype=np.int64),
            "past.seen": np.array(self.seen, dtype=np.int32),
        }

    @classmethod
    def of_rows(cls, rows: Mapping[str, Array], plan: Plan) -> Past:
        """Return the past of rows that `rows` gave."""
        breaks = list(zip(rows["past.breaks"].tolist(), rows["past.orders"].tolist(), strict=True))
        parts = list(rows["past.parts"].copy())
        store = Store(rows["past.starts"].tolist(), rows["past.ends"].tolist(), parts, breaks)
        passed = tuple(rows["past.passed"].tolist())
        is_open, seen = bool(rows["past.open"]), int(rows["past.seen"])
        return cls(plan.delays, plan.time_scale, store, len(parts), len(breaks), is_open, passed, seen)

    @property
    def longest_step(self) -> float:
        """A step that is shorter than every delay, also when it is stretched a little, needs no future."""
        return min(history.delay for history in self.histories) / 1.02

    def values(self, t: float) -> tuple[float, ...]:
        """What the histories give at t, which lies between now and the next break."""
        return tuple(self._value(i, history, t) for i, history in enumerate(self.histories))

    def _value(self, i: int, history: Delay, t: float) -> float:
        passed, store, delay = self.passed[i], self.store, history.delay
        if passed == 0:
            return history.before
        begin = store.breaks[passed - 1][0]
        at_begin = self._is_due(t, begin + delay)
        then = begin if at_begin else max(t - delay, begin)
        k = bisect_right(store.starts, then, 0, self.known) - 1
        if passed < self.broken and self._is_due(store.breaks[passed][0] + delay, t):
            then = store.breaks[passed][0]
            k = bisect_left(store.starts, then, 0, self.known) - 1  # the part that ends there
        elif at_begin and k > 0 and store.starts[k] == begin:
            # What does not jump has one value there, and two polynomials that differ in its last bits.
            before, after = float(store.parts[k - 1][5, i]), float(store.parts[k][0, i])
            if abs(after - before) <= _JUMP * max(abs(before), abs(after)):
                return before
        k = max(k, 0)
        a0, a1, a2, a3, a4, end = store.parts[k][:, i]
        if then >= store.ends[k]:
            return float(end)
        theta = (then - store.starts[k]) / (store.ends[k] - store.starts[k])
        return float(a0 + theta * (a1 + theta * (a2 + theta * (a3 + theta * a4))))

    def next_break(self) -> float:
        """The next time at which a history breaks; inf: none known."""
        times = [
            self.store.breaks[passed][0] + history.delay
            for passed, history in zip(self.passed, self.histories, strict=True)
            if passed < self.broken
        ]
        return min(times, default=math.inf)

    def _is_due(self, due: float, t: float) -> bool:
        """Return whether t has reached `due`, but for rounding: sums of many delays round off by more than 4 ulp."""
        return due <= t or within_ulps(due, t, self.scale, 64)

    def breaks_at(self, t: float) -> list[int]:
        """Return the histories in which a jump or a bend arrives at t that was more than the end of a `COURSE`."""
        return [
            i
            for i, (passed, history) in enumerate(zip(self.passed, self.histories, strict=True))
            if passed < self.broken
            and self._is_due(self.store.breaks[passed][0] + history.delay, t)
            and self.store.breaks[passed][1] < COURSE
        ]

    def after_breaks(self, t: float) -> Past:
        """The past as it is seen from the instant at t on; itself where no history breaks there."""
        passed, seen = list(self.passed), self.seen
        for i, history in enumerate(self.histories):
            while passed[i] < self.broken:
                time, order = self.store.breaks[passed[i]]
                if not self._is_due(time + history.delay, t):
                    break
                if history.echoes:
                    # What is integrated is smoother by one order.
                    seen = min(seen, order + 1)
                passed[i] += 1
        return self if tuple(passed) == self.passed else replace(self, passed=tuple(passed), seen=seen)

    def after_instant(self, t: float, *, changed: bool) -> Past:
        """The past with a break at t, whose order is known once the signals after it are.

        changed: whether anything but histories changed at t.
        """
        seen = min(self.seen, 2) if changed else self.seen
        if seen > ORDER or self.store.breaks[self.broken - 1][0] == t:
            return replace(self, seen=seen)
        breaks = self.store.breaks
        del breaks[self.broken :]  # of an instant that was interrupted
        breaks.append((t, 0))
        return replace(self, broken=self.broken + 1, open=True, seen=seen)

    def after_course(self, t: float) -> Past:
        """The past with a break at t of order 2, where inputs only take the next piece of an extrapolation."""
        if self.store.breaks[self.broken - 1][0] == t:
            return self
        breaks = self.store.breaks
        del breaks[self.broken :]
        breaks.append((t, COURSE))
        return replace(self, broken=self.broken + 1, seen=min(self.seen, COURSE))

    def part_at(self, i: int, t: float) -> float:
        """Where history i is read at t: the number of the part of the past, and how much of it has gone by."""
        store, then = self.store, t - self.histories[i].delay
        k = bisect_right(store.starts, then, 0, self.known) - 1
        if k < 0:
            return 0.0
        return k + min((then - store.starts[k]) / (store.ends[k] - store.starts[k]), 1.0)

    def after_step(self, t1: float, tables: Iterable[tuple[float, float, Array]]) -> Past:
        """The past with a step to t1.

        tables: the begin and the end of each part of it, and the values (5, m) of all sources at NODES.
        """
        store = self.store
        # By differences from the first value, so that what is constant stays so to the last bit.
        added = [
            (begin, end, np.vstack([values[:1], POWERS[1:, 1:] @ (values[1:] - values[0]), values[-1:]]))
            for begin, end, values in tables
        ]
        if self.open:
            store.breaks[self.broken - 1] = (store.breaks[self.broken - 1][0], self._order(added[0]))
        n = self.known  # what lies beyond is of a step that was interrupted
        store.starts[n:] = [start for start, _, _ in added]
        store.ends[n:] = [end for _, end, _ in added]
        store.parts[n:] = [part for _, _, part in added]
        past = replace(self, known=self.known + len(added), open=False, seen=ORDER + 1)
        return past._trimmed(t1)

    def _trimmed(self, t: float) -> Past:
        """The past without what no history sees any more; breaks are kept as long as one has not passed them."""
        horizon, store = t - max(history.delay for history in self.histories), self.store
        first = max(bisect_right(store.ends, horizon, 0, self.known) - 1, 0)
        done = max(min(self.passed) - 1, 0)
        if first < max(_TRIM, self.known // 2) and done < max(_TRIM, self.broken // 2):
            return self
        n = self.known
        kept = Store(store.starts[first:n], store.ends[first:n], store.parts[first:n], store.breaks[done : self.broken])
        passed = tuple(k - done for k in self.passed)
        return replace(self, store=kept, known=n - first, broken=self.broken - done, passed=passed)

    def _order(self, part: tuple[float, float, Array]) -> int:
        """The order of the break between the past and the part that follows it."""
        if self.known == 0:
            return 0
        start, end, after = part
        store, last = self.store, self.known - 1
        before, h = store.parts[last], store.ends[last] - store.starts[last]
        size = np.maximum(np.abs(before).max(axis=0), np.abs(after).max(axis=0))
        if np.any(np.abs(before[5] - after[0]) > _JUMP * size):
            return 0
        slope_before, slope_after = np.arange(5) @ before[:5] / h, after[1] / (end - start)
        steepness = np.maximum(np.abs(slope_before), np.abs(slope_after))
        # Slopes of interpolants are known to a few digits only.
        bends = np.abs(slope_before - slope_after) > 1e-3 * steepness + _JUMP * size / min(h, end - start)
        return 1 if np.any(bends) else self.seen
