"""Steps of a master whose error is estimated: how long the next one is, and which is tried again.

A step is compared with two half steps, where all units can go back; else predicted outputs are compared with those that
were reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, Protocol

from ...compile.coupling import Coupling
from ...compile.master_limits import LEAST, MOST, MOST_SMALL, ROUNDING, SAFETY
from ...compile.master_policy import Policy
from ...text.errors import Fault
from .exchange import Point, course_of
from .stepped_units import Running, too_short


class Stepped(Protocol):
    """The part of a master that the control of its steps needs."""

    plan: Coupling
    policy: Policy
    units: list[Running]
    past: list[list[Point]]
    ends: list[float]  # all elements at the end of the last step, before what happened there
    t: float
    fresh: int  # so many steps since something jumped
    rejected: int

    @property
    def over(self) -> Fault | None: ...
    def go_to(self, target: Fraction, due: Sequence[int]) -> bool: ...
    def kept(self) -> dict[str, Any]: ...
    def go_back(self, kept: dict[str, Any]) -> None: ...
    def drop(self, kept: dict[str, Any]) -> None: ...


class StepControl:
    """The steps of one run."""

    def __init__(self) -> None:
        self.h = 0.0  # the next step; 0: none yet
        self.small, self.worst = 0, 0  # so many short steps in a row, and the element that causes them

    def advance(self, master: Stepped, limit: Fraction) -> None:
        """One try at a step whose error is estimated: against two half steps, or by predicted outputs.

        The errors of all steps of the run together may reach the tolerance, so that a step has a share of it by its
        length; a wrong prediction is an error of the inputs at all times, and must meet the tolerance itself.
        """
        every = master.plan.settings.every
        if every is not None:
            start = master.plan.settings.start
            row = start + (math.floor((Fraction(master.t) - start) / every) + 1) * every
            if float(row) <= master.t:
                row += every
            limit = min(limit, row)
        left = float(limit) - master.t
        policy = master.policy
        if self.h <= 0:
            self.h = min(policy.first_step, left)
        order = min(policy.order, master.fresh)  # after a jump inputs are held at first
        whole = self.h >= left / 1.01
        target = limit if whole else Fraction(master.t + self.h)
        h = float(target) - master.t
        self._check_length(master, h, whole=whole)
        if policy.is_doubled:
            tried = self._halved(master, target, order)
            if tried is None:
                return
            h, error, is_early = tried
            whole = whole and not is_early
        else:
            error = self._predicted(master, target, order)
        factor = min(MOST, max(LEAST, SAFETY * max(error, 1e-10) ** (-1 / (order + 1))))
        proposed = h * factor
        self.h = max(proposed, self.h) if whole and factor >= 1 else proposed
        if not master.fresh:  # begun anew
            self.h = min(self.h, policy.first_step)

    def _check_length(self, master: Stepped, h: float, *, whole: bool) -> None:
        """Raises SimulationError (E301) where steps are, or were too often, too short. whole: h is all that is left."""
        if h >= master.policy.least_step:
            self.small = 0
        elif not whole:
            self.small += 1
        if h <= 16 * math.ulp(master.t) or self.small > MOST_SMALL:
            raise too_short(master.plan, self.worst, master.t, h)

    def _halved(self, master: Stepped, target: Fraction, order: int) -> tuple[float, float, bool] | None:
        """A step and its two halves: how long it was, its error, and whether something happened before the target.

        None where it is to be tried again, once the caller has checked for Ctrl-C, or where an FMU ended the run.
        """
        everyone, ours = list(range(len(master.units))), _continuous(master)
        begin, error, is_early = master.t, 0.0, False
        kept = master.kept()
        try:
            master.go_to(target, everyone)
            if master.over is not None and master.t <= begin:
                return None
            if master.t < float(target):  # something happens before: all units step only up to there
                is_early, target = True, Fraction(master.t)
                master.go_back(kept)
                master.go_to(target, everyone)
            big, t1 = master.ends, master.t
            h = t1 - begin
            middle = begin + h / 2
            if begin < middle < t1:
                master.go_back(kept)
                master.go_to(Fraction(middle), everyone)
                if master.t == middle and master.over is None:
                    master.go_to(target, everyone)
                    off = {g: abs(big[g] - master.ends[g]) - ROUNDING * abs(big[g]) for g in ours}
                    sizes = _sizes(master, ours)
                    error = self._largest({g: max(off[g], 0.0) / sizes[g] for g in ours})
                    error *= master.policy.span / h / (2 ** (order + 1) - 1)
                if not error <= 1.0:
                    master.go_back(kept)
                    master.rejected += 1
                    shrunk = SAFETY * error ** (-1 / (order + 1)) if math.isfinite(error) else LEAST
                    self.h = h * max(LEAST, shrunk)
                    return None
            return h, error, is_early
        finally:
            master.drop(kept)

    def _predicted(self, master: Stepped, target: Fraction, order: int) -> float:
        """The error of a step by the predicted outputs at its end."""
        t1, k = float(target), master.policy.order
        predicted = {g: course_of(master.past[g], k, t1)[0] for g in _continuous(master) if master.past[g]}
        master.go_to(target, list(range(len(master.units))))
        sizes = _sizes(master, predicted)
        error = self._largest({g: abs(predicted[g] - master.ends[g]) / sizes[g] for g in predicted})
        return error if order == k and master.t == t1 else max(error, 1.0)

    def _largest(self, errors: Mapping[int, float]) -> float:
        """The largest of errors by element; `worst` is then its element."""
        if not errors:
            return 0.0
        self.worst = max(errors, key=lambda g: math.inf if math.isnan(errors[g]) else errors[g])
        return errors[self.worst]


def _continuous(master: Stepped) -> list[int]:
    """The elements whose errors count."""
    return [g for g, element in enumerate(master.plan.elements) if not element.held]


def _sizes(master: Stepped, elements: Iterable[int]) -> dict[int, float]:
    """The allowed errors of elements, by the values that they reached."""
    policy = master.policy
    return {g: policy.tolerance * (policy.ratio + abs(master.ends[g])) for g in elements}
