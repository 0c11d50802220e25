"""Exact delays between the ticks of sampled blocks, as copies of a linear model that lag behind it.

A delayed signal is h(t) = s(t - delay), where s depends on the states x, the sampled values d and the inputs e. A copy
with the lag L holds the elements of z = (x, d, e) at t - L that some h(t) needs. Between instants it follows the
equations of the model itself; what they read of a delay comes from the copy whose lag is longer by that delay. L after
each instant, such as a tick, the copy is set to the z that `Kept` holds of that instant. So it forgets its past from
instant to instant: it adds eigenvalues at 0 to the model over a period, and none of the plant.

The number of copies is finite unless a path in continuous time leads from the output of a delay back to its input.
At an instant copies are set before the tick, because a run also passes on what arrives from a delay before it.

Reference: K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 3rd ed., Prentice Hall 1997, section 2.3 (delays
behind a hold).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ..compile.plan import Plan
from ..compile.time_grid import within_ulps
from ..contract.closure import closure
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault

Time = int | Fraction
"""In base steps of the ticks: whole numbers are exact, and equal times compare equal."""

MOST = 1 << 24
"""The most numbers in a matrix of a model."""


def too_long(plan: Plan, count: int) -> AnalysisError:
    """Return the error for delays that keep too many values."""
    message = f"exact delays keep {count} values from tick to tick: the model of them is too large."
    cure = "Choose longer periods or shorter delays, or take Padé models: pade=3 (--pade 3)."
    return AnalysisError(Fault("E703", plan.name, message, cure))


class LateCopies:
    """The vector (x, d, e, copies) and what depends on it.

    m: dense matrices by row and column: "x" (rates), "d", "y", "h" (what is delayed) by "x", "d", "e", "h". histories:
    numbers of the plan's histories in "h". size: of the vector. held: by lag in base steps, the numbers of z that the
    copy holds, in order. first: by lag, the first row of the copy. dynamics: the rates of the whole vector, as far as
    it has states. node, seen: rows "d" and "y", by the whole vector.
    """

    def __init__(self, plan: Plan, m: Mapping[str, Array], histories: Sequence[int]) -> None:
        self.nx, self.width = len(m["xx"]), m["xx"].shape[1] + m["xd"].shape[1] + m["xe"].shape[1]
        self._own = {row: np.hstack([m[row + "x"], m[row + "d"], m[row + "e"]]) for row in "xdy"}
        self._late = {row: np.empty((len(own), 0)) for row, own in self._own.items()}
        self._plan, self._delays = plan, [_in_steps(plan.delays[k].delay, plan) for k in histories]
        self._names = [f"{plan.histories[k].name} ({plan.delays[k].delay:g} s)" for k in histories]
        if histories:
            self._own["h"] = np.hstack([m["hx"], m["hd"], m["he"]])
            self._late = {row: m[row + "h"] for row in "xdyh"}
        self._reads = [self._read(k) for k in range(len(histories))]
        self.held = self._copies()
        self.first: dict[Time, int] = {}
        self.size = self.width
        for lag, held in self.held.items():
            self.first[lag] = self.size
            self.size += len(held)
        delayed = self._delayed()
        self.node, self.seen = self._rows("d", 0, delayed), self._rows("y", 0, delayed)
        self.dynamics = np.zeros((self.size, self.size))
        self.dynamics[: self.nx] = self._rows("x", 0, delayed)
        for lag, first in self.first.items():
            states = [k for k in self.held[lag] if k < self.nx]
            self.dynamics[first : first + len(states)] = self._rows("x", lag, delayed)[states]

    @property
    def states(self) -> Array:
        """Whether each element of the vector is a state of a plant in continuous time, or a copy of one."""
        numbers = [*range(self.width), *(k for held in self.held.values() for k in held)]
        return np.array(numbers, dtype=np.intp) < self.nx

    @property
    def inputs(self) -> Array:
        """Whether each element of the vector is a copy of an input."""
        numbers = [*([0] * self.width), *(k for held in self.held.values() for k in held)]
        return np.array(numbers, dtype=np.intp) >= self.nx + len(self._own["d"])

    def place(self, lag: Time, number: int) -> int | None:
        """Return where the copy of an element of z is; None if this copy does not hold it."""
        return self.first[lag] + self.held[lag].index(number) if number in self.held[lag] else None

    def _copies(self) -> dict[Time, list[int]]:
        """Return the lags, in order, and what the copies hold. Raises AnalysisError (E707, and E703 for too many)."""
        self._check_circles()
        held: dict[Time, set[int]] = {}
        read = [k for k in range(len(self._delays)) if any(np.any(self._late[row][:, k] != 0) for row in "xdy")]
        waiting: list[tuple[Time, int]] = [(0, k) for k in read]
        done = set(waiting)
        while waiting:
            lag, k = waiting.pop()
            then = _counted(lag + self._delays[k], self._plan)
            held.setdefault(then, set()).update(self._reads[k][0])
            count = self.width + sum(map(len, held.values()))
            if count**2 > MOST:
                raise too_long(self._plan, count)
            for ahead in self._reads[k][1]:
                if (then, ahead) not in done:
                    done.add((then, ahead))
                    waiting.append((then, ahead))
        return {lag: sorted(held[lag]) for lag in sorted(held)}

    def _read(self, k: int) -> tuple[set[int], set[int]]:
        """Find what a delayed signal needs: elements of z, and the delays that they or the signal itself read."""
        first: list[int] = np.nonzero(self._own["h"][k])[0].tolist()
        elements = closure(first, lambda row: np.nonzero(self._own["x"][row])[0].tolist() if row < self.nx else ())
        late = [self._late["h"][k], *(self._late["x"][row] for row in elements if row < self.nx)]
        return elements, {delay for row in late for delay in np.nonzero(row)[0].tolist()}

    def _check_circles(self) -> None:
        """Raise AnalysisError (E707) if a delayed signal depends on itself in continuous time."""
        inside = [
            self._names[k]
            for k, (_, delays) in enumerate(self._reads)
            if k in closure(delays, lambda other: self._reads[other][1])
        ]
        if inside:
            delays = ", ".join(inside)
            message = f"exact delays act back on themselves in continuous time, through no sampled block: {delays}."
            cure = "Take Padé models: pade=3 in model(...) or loop(...), --pade 3 in commands."
            raise AnalysisError(Fault("E707", self._plan.name, message, cure))

    def _delayed(self) -> dict[Time, Array]:
        """Return by lag what delays give there, by the whole vector; the row of a delay that nothing reads is 0."""
        rows: dict[Time, Array] = {}
        for lag in (*reversed(self.first), 0):
            rows[lag] = np.zeros((len(self._delays), self.size))
            for k, delay in enumerate(self._delays):
                then = _counted(lag + delay, self._plan)
                if then in self.first and self._reads[k][0] <= {*self.held[then]}:
                    rows[lag][k] = self._rows("h", then, rows, [k])[0]
        return rows

    def _rows(self, row: str, lag: Time, delayed: Mapping[Time, Array], which: Any = slice(None)) -> Array:
        """Return rows as they are at a lag, by the whole vector."""
        own = self._own[row][which]
        rows = np.zeros((len(own), self.size))
        if lag == 0:
            rows[:, : self.width] = own
        else:
            held, first = self.held[lag], self.first[lag]
            rows[:, first : first + len(held)] = own[:, held]
        return rows + self._late[row][which] @ delayed[lag] if self._delays else rows


class Kept:
    """The values of z just after each instant of the pattern, kept until the copies are set to them.

    copies: of the model. instants: times in the pattern. period: of the pattern. first: the time with which a pass over
    it begins. spans: in the order of the pass, the times at which something happens, instants or those at which copies
    are set, and how long nothing happens after each. begin: of the rows behind the vector that are kept; size: of them.
    """

    def __init__(self, copies: LateCopies, instants: Iterable[Time], period: int, first: Time = 0) -> None:
        self.copies, self.begin = copies, copies.size
        self.elements = sorted({k for held in copies.held.values() for k in held})
        # A copy with the lag L is set L after an instant, which has recurred ceil(L/period) - 1 times since.
        self.ages = {lag: math.ceil(Fraction(lag) / period) - 1 for lag in copies.held}
        self.depth = max(self.ages.values(), default=-1) + 1
        self.instants = {time: n for n, time in enumerate(sorted({*instants}))}
        self.size = len(self.instants) * self.depth * len(self.elements)
        self._sets: dict[Time, list[tuple[Time, Time]]] = {}  # by time: lags, and the instants to which copies are set
        for instant in self.instants:
            for lag in copies.held:
                self._sets.setdefault((instant + lag) % period, []).append((lag, instant))
        times = sorted({*self.instants, *self._sets}, key=lambda time: (time - first) % period)
        following = [*times[1:], times[0]]
        self.spans = [(time, (then - time) % period or period) for time, then in zip(times, following, strict=True)]

    def _rows(self, instant: Time, age: int) -> slice:
        """Return where z is kept as it was at an instant some periods ago."""
        begin = self.begin + (self.instants[instant] * self.depth + age) * len(self.elements)
        return slice(begin, begin + len(self.elements))

    def set(self, time: Time, now: Array) -> None:
        """Set the copies that are due."""
        for lag, instant in self._sets.get(time, ()):
            held, first = self.copies.held[lag], self.copies.first[lag]
            kept = now[self._rows(instant, self.ages[lag])]
            now[first : first + len(held)] = kept[np.searchsorted(self.elements, held)]

    def keep(self, time: Time, now: Array, z: Array) -> None:
        """Keep z, if the time is an instant, and forget the oldest."""
        if self.size and time in self.instants:
            for age in range(self.depth - 1, 0, -1):
                now[self._rows(time, age)] = now[self._rows(time, age - 1)]
            now[self._rows(time, 0)] = z[self.elements]


def _in_steps(delay: float, plan: Plan) -> Time:
    """Return a delay in base steps: of the decimal that a user wrote, not of the double next to it."""
    return _counted(Fraction(repr(float(delay))) / plan.base, plan)


def _counted(lag: Time, plan: Plan) -> Time:
    """Return the lag, as a whole number if only rounding separates it from one: a run compares times alike."""
    whole = round(lag)
    return whole if within_ulps(float(lag * plan.base), float(whole * plan.base), count=64) else lag
