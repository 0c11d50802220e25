"""Runs that would never end: crossings that come ever faster (Zeno), and steps that a jump of a rate keeps short."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from ...compile.plan import Plan
from ...text.arrays import Array
from ...text.errors import Fault, SimulationError
from . import event_location
from .event_update import Instants

# So many located crossings within so small a part of the run are Zeno or chattering; no model needs 1e9 of them.
_CROWD, _CROWD_PART = 1000, 1e-6
# A crossing that fires again within so many ulp of t is one too: soon after, time could not tell its firings apart.
_QUICK = 4096
# Chattering over a jump of a rate: steps of which a run would take so many are looked at, one of each window. Those
# of windows in a row must go to and fro over a jump; one does not, however stiff the model, where its rates are smooth.
_MANY, _WINDOW = 1e7, 512
TO_AND_FRO = 16
_HALVINGS = 20  # what is smooth over a step changes by a millionth of it within this part, and a jump stays


def _span(plan: Plan, t: float, stop: float) -> float:
    """The length in s that a run up to `stop` has, at t."""
    return max(stop - float(plan.settings.start), 1e-3 * abs(t), 1e-12)


class CrossingWatch:
    """When crossings fired last. Raises SimulationError (E304) where they come ever faster."""

    def __init__(self, plan: Plan, instants: Instants) -> None:
        self.plan, self.instants = plan, instants
        self.times: deque[float] = deque(maxlen=_CROWD)
        self.fired: dict[int, float] = {}  # when each crossing fired last
        theirs = plan.foreign_crossings
        self.resetting = np.array([bool(c.resets) or j in theirs for j, c in enumerate(plan.crossings)], dtype=bool)
        # Passing one back at once is no Zeno where it resets nothing, as where a corner just touches it, but passing it
        # downwards again is. An FMU's has no direction.
        self.directions = [
            "down" if j in theirs or (cause.direction == "both" and not cause.resets) else cause.direction
            for j, cause in enumerate(plan.crossings)
        ]

    def rows(self) -> dict[str, Array]:
        """Return the same as rows of a saved state; crossings that have not fired have -inf."""
        fired = [self.fired.get(j, -math.inf) for j in range(len(self.plan.crossings))]
        return {"fired": np.array(fired), "crossed": np.array(self.times)}

    def go_on(self, rows: Mapping[str, Array]) -> None:
        """Take what `rows` gave."""
        self.fired = {j: t for j, t in enumerate(rows["fired"].tolist()) if t > -math.inf}
        self.times.extend(rows["crossed"].tolist())

    def kept(self) -> tuple[dict[int, float], deque[float]]:
        """All that changes, to go back to."""
        return dict(self.fired), self.times.copy()

    def go_back(self, kept: tuple[dict[int, float], deque[float]]) -> None:
        self.fired, self.times = dict(kept[0]), kept[1].copy()

    def add(self, t: float, crossing: int, *, up: bool) -> None:
        """A crossing fires. Refused: one crossing again within some ulp of t, or too many of all of them."""
        cure = "Add a state of rest to the block, or a hysteresis to the crossing."
        name = self.instants.name(crossing)
        if self.directions[crossing] in ("both", "up" if up else "down"):
            last = self.fired.get(crossing, -math.inf)
            self.fired[crossing] = t
            if 0 < t - last <= _QUICK * math.ulp(t):  # 0: the same firing, found anew after an interrupt
                message = f"fires ever faster, and at t = {t} s faster than time can be resolved: Zeno or chattering."
                raise SimulationError(Fault("E304", name, message, cure))
        if len(self.times) == _CROWD:
            stop = self.plan.settings.stop
            span = _span(self.plan, t, t if stop is None else float(stop))
            if t - self.times[0] < _CROWD_PART * span:
                message = f"fires {_CROWD} times between t = {self.times[0]} s and {t} s: Zeno or chattering."
                raise SimulationError(Fault("E304", name, message, cure))
        self.times.append(t)

    def withdraw(self, t: float, moved: Array) -> None:
        """Forget the firing times of crossings that were found at t, if inputs have jumped there and moved them.

        If a master extrapolates an input, the run finds the crossing again after each jump back to the true input,
        closer and closer to the last time. That is the error of the extrapolation, not Zeno behavior of the model.

        moved: whether the value of each crossing has changed since the run found it.
        """
        for crossing in np.nonzero(moved)[0]:
            if self.fired.get(int(crossing)) == t:
                del self.fired[int(crossing)]

    def check_missed(
        self, t: float, values: Array, sides: Array, beyond: Array, slopes_by_rates: Callable[[], Array]
    ) -> None:
        """Refuse a flight too short to be seen.

        A located instant lies beyond its crossing by a rounding error. Where its resets turn the motion back, the
        crossing must be passed again at once; if it is not, it was passed twice within that rounding error. Polynomials
        of a method may begin with a slope that is not that of the rates: both must lead back.
        """
        slopes, unsure = event_location.slope(values)
        size = 1e-12 * np.abs(values).max(axis=0) + unsure
        # A crossing through infinity leaves the other side far away: nothing was missed there.
        error = np.minimum(2 * beyond, 1e3 * size)
        missed = (np.where(sides, -slopes, slopes) > size) & (np.abs(values[0]) <= error) & self.resetting
        if missed.any():
            slopes = slopes_by_rates()
            missed &= np.where(sides, -slopes, slopes) > size
        if missed.any():
            message = f"at t = {t} s it is crossed again after less time than a double can resolve: Zeno behavior."
            cure = "Add a state of rest to the block."
            raise SimulationError(Fault("E304", self.instants.name(int(np.nonzero(missed)[0][0])), message, cure))


class ProgressWatch:
    """Whether a run gets on. Raises SimulationError (E301) where it chatters over a jump of a rate (dx = -sign(x))."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        # How many steps a run may need, how many lie between looks, the time of the last look, and how many in a row
        # found that a rate jumps to and fro.
        self.many, self.window, self.last, self.count = _MANY, _WINDOW, -math.inf, 0

    def look_closely(self, t: float) -> None:
        """Look at each step from t on: another engine, which looks at one of many, met a jump there."""
        self.many, self.window, self.last, self.count = 0.0, 1, t, TO_AND_FRO - 1

    def kept(self) -> tuple[float, int]:
        """Return what a step changes, to go back to it."""
        return self.last, self.count

    def go_back(self, kept: tuple[float, int]) -> None:
        self.last, self.count = kept

    def step(
        self,
        number: int,
        t: float,
        t1: float,
        x: Array,
        first: Array,
        rates: Callable[[float, Array], Array],
        weights: Array,
        end: float,
    ) -> None:
        """An accepted step, the number-th, from (t, x) to t1 in a run up to `end`.

        first: the rates at its start; rates: those at other times and states. weights: what a state may be off by.
        """
        if number % self.window:
            return
        span = _span(self.plan, t1, t1 if math.isnan(end) else end)
        is_slow = (t1 - self.last) * self.many < self.window * span
        self.last = t1
        culprit = None
        if is_slow and not self.plan.foreign:
            culprit = _to_and_fro(lambda s, x: rates(t + s, x), x, first, t1 - t, weights)
        self.count = 0 if not is_slow else self.count + (culprit is not None)
        if culprit is None or self.count < TO_AND_FRO:
            return
        message = f"chatters at t = {t} s: its rate jumps back and forth, and the steps become too short to go on."
        cure = "Make the jump a crossing with a hysteresis, as in Relay, or smooth it, as in tanh(x/eps)."
        raise SimulationError(Fault("E301", self.plan.states[culprit], message, cure))


def _to_and_fro(rates: Callable[[float, Array], Array], x: Array, first: Array, h: float, weights: Array) -> int | None:
    """The state whose rate jumps on the way along the rates from x, and jumps back on the way that follows.

    rates: after s seconds. None where no rate jumps within h, or where what follows leads on.
    """
    low, high, end = 0.0, h, rates(h, x + h * first)
    if not (len(first) and np.isfinite(end).all()):
        return None
    worst = int(np.argmax(np.abs(end - first) / weights))
    before, after = first, end
    jump = abs(after[worst] - before[worst])
    for _ in range(_HALVINGS):
        middle = low + (high - low) / 2
        middle_rates = rates(middle, x + middle * first)
        if abs(middle_rates[worst] - before[worst]) > abs(after[worst] - middle_rates[worst]):
            high, after = middle, middle_rates
        else:
            low, before = middle, middle_rates
    if not (abs(after[worst] - before[worst]) > 0.5 * jump > 0.0 and np.isfinite(after).all()):
        return None
    on = h / 256  # much more than the way by which the jump was passed
    back = rates(high + on, x + high * first + on * after)
    return worst if abs(back[worst] - before[worst]) < abs(back[worst] - after[worst]) else None
