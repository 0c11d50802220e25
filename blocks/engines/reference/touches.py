"""Signals that touch a threshold: sides that stay, because a change of sign there is one of rounding.

While a signal moves smoothly, its side changes where it crosses 0 and goes on, beyond the band of its rounding errors.
Where it comes back before, it has touched 0, and its side stays. The values at neighboring times show how wide the band
is: they differ from those of a smooth function by rounding errors alone, whatever they are computed from.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ...text.arrays import Array
from .event_location import Found, narrowed

# A change of side that reaches no further than this share of the values in the part is looked at closely. So are all
# where rounding may be all that moves: in a part that is shorter than _SHORT of a usual step, and of values that are
# not smooth (third or fourth differences of no less than _UNSMOOTH of them) or are a few multiples of one difference.
_SMALL, _SHORT, _UNSMOOTH, _LEVELS = 1e-6, 1e-3, 0.25, 1024.0
# Rounding errors of nine values in a row, at three distances or more: third differences leave nothing else. The rows
# stand before a change and behind it, as signals may jump there.
_SPREAD, _WINDOWS, _BAND = 37.0, 3, 4.0
_WIDEST = 64.0  # the band in sizes of the values of the part, at most: beside a pole differences are no rounding errors


def _is_rough(values: Array, size: float) -> bool:
    """Whether values of a part may be rounding alone."""
    third, differences = np.diff(values, 3), np.abs(np.diff(values))
    if max(np.abs(third).max(), np.abs(np.diff(third)).max()) >= _UNSMOOTH * size or not differences.any():
        return True
    least = differences[differences > 0.0].min()
    return bool(size <= _LEVELS * least and not np.fmod(values, least).any())


class Touches:
    """Where in one step the sides change, and where signals only touch 0.

    sides: the latched ones. evaluate: crossing values at a place of the step, which goes from 0 to 1. resolution: the
    distance of times that can be told apart. usual: the length of a usual step, by that of this one. sure: the sides
    whose change at the end is no touch, as a longer step has found it. is_closed: whether nothing can be evaluated
    behind the end.
    """

    def __init__(
        self,
        sides: Array,
        evaluate: Callable[[float], Array],
        resolution: float,
        usual: float,
        sure: Array,
        *,
        is_closed: bool,
    ) -> None:
        self.sides, self.evaluate, self.resolution, self.usual = sides, evaluate, resolution, usual
        self.end = 1.0 if is_closed else 1.0 + _SHORT * max(1.0, usual)
        self.until = np.full(len(sides), -math.inf)  # up to where a change of each side is a touch
        self.sure, self.judged = sure, sure.copy()  # judged: at the end of a step that a crossing has cut

    def begin(self, values: Array, reach: float) -> None:
        """Let sides that have changed just before their values do, as they joined an instant, stay up to a place."""
        self.until[((values >= 0) != self.sides) & ~self.sure] = reach

    def enter(self, table: Array, length: float) -> None:
        """Go on to a part of the step, which has the values (5, m) and is `length` long."""
        self.table, self.length, self.size = table, length, np.abs(table).max(axis=0)

    def changed(self, place: float, values: Array) -> Array:
        """Which sides have changed at a place: those that are touched have not."""
        return np.asarray(((values >= 0) != self.sides) & (place > self.until))

    def kept(self, place: float, values: Array) -> Array:
        """The values of crossings that are touched there, NaN for all others."""
        return np.where(((values >= 0) != self.sides) & (place <= self.until), values, math.nan)

    def found(self, change: Found) -> bool:
        """Whether a change that was found in the part is a touch of some crossing, which from here on is known."""
        table, size = self.table, self.size
        doubtful = (np.abs(change.values) <= _SMALL * size) | (self.length < _SHORT * self.usual)
        for j in np.nonzero(~doubtful)[0]:
            doubtful[j] = _is_rough(table[:, j], float(size[j]))
        doubtful &= np.isfinite(size) & ~self.sure  # else it is a pole
        suspects = np.nonzero(doubtful & self.changed(change.high, change.values))[0]
        touches = [self._is_touch(int(j), change.low, change.high) for j in suspects]
        if change.low == 0.0:
            # Some begin beyond their side, where a step before has left them as touches.
            begin = ((table[0] >= 0) != self.sides) & (self.until < self.resolution) & ~self.sure
            begin &= ~self.changed(change.high, change.values)
            touches += [self._is_touch(int(j), 0.0, 0.0) for j in np.nonzero(begin)[0]]
        return any(touches)

    def judge(self, place: float, values: Array, change: Found) -> bool:
        """Judge the sides that have changed at a place, but not at the end of the interval in which it was found.

        Return whether any of them is a touch. Judge each side once: if the polynomials of a bad step contradict the
        step to the place, judging would never end.
        """
        others = np.nonzero(self.changed(place, values) & ~self.changed(change.high, change.values) & ~self.judged)[0]
        self.judged[others] = True
        touches = [self._is_touch(int(j), place, place) for j in others]
        return any(touches)

    def joined(self, values: Array) -> Array:
        """Which sides have changed shortly behind the end of the step, with these values."""
        changed = self.changed(1.0, values)
        for j in np.nonzero(changed)[0]:
            changed[j] = not self._is_touch(int(j), 1.0, 1.0)
        return changed

    def _beyond(self, j: int, place: float) -> float:
        """How far a crossing is beyond its latched side."""
        value = float(self.evaluate(place)[j])
        return value if not self.sides[j] else -value if value else -5e-324

    def _is_touch(self, j: int, low: float, high: float) -> bool:
        """Whether a crossing comes back, or stays in the band, but for one that rests on 0 exactly.

        Its side changes within (low, high].
        """
        low = max(low, float(self.until[j]))
        at = narrowed(lambda place: self._beyond(j, place), low, high, self.resolution) if low < high else high
        widest = _WIDEST * self.size[j] if self.size[j] > 0.0 else math.inf
        band, end = min(_BAND * self._rounding(j, at), widest), min(self.end, 2.0)
        rests, reach = True, self.resolution
        while (place := at + reach) <= end:
            beyond = self._beyond(j, place)
            if not beyond <= band:  # what is not a number too
                return False
            if beyond < -band:
                self.until[j] = max(place, high)
                return True
            rests &= beyond == 0.0
            reach *= 2
        if not rests:
            self.until[j] = max(end, high)
        return not rests

    def _rounding(self, j: int, at: float) -> float:
        """The largest third difference of values in a row before a place and behind it."""
        widest = _SHORT * (self.usual if _SHORT * self.usual > 1.0 else self.length)
        most, spacing, windows = 0.0, self.resolution, 0
        while windows == 0 or 8 * spacing <= widest:
            for first in (at - 9 * spacing, at + spacing):
                if first >= 0.0 and first + 8 * spacing <= self.end:
                    values = [float(self.evaluate(first + k * spacing)[j]) for k in range(9)]
                    most = max(most, float(np.fmax.reduce(np.abs(np.diff(values, 3)))))
            spacing, windows = _SPREAD * spacing, windows + 1
            if windows >= _WINDOWS and most > 0.0:
                break
        return most
