"""Equally spaced times, never accumulated, each the double nearest to the exact fraction; and which are equal."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction


def within_ulps(a: float, b: float, scale: float = 0.0, count: int = 4) -> bool:
    """Whether two times are at most `count` spacings of floats apart.

    scale: the size of the times that they were computed from: -9.7 + 9.8 is 0.1 with the rounding errors of 9.8.
    """
    if math.isinf(a) or math.isinf(b):
        return a == b
    return abs(a - b) <= count * math.ulp(max(abs(a), abs(b), scale))


@dataclass(frozen=True, slots=True)
class Grid:
    """The times (start + k step) / unit for whole k."""

    start: int
    step: int
    unit: int

    @classmethod
    def of(cls, start: Fraction, step: Fraction) -> Grid:
        (begin, of_begin), (length, of_length) = start.as_integer_ratio(), step.as_integer_ratio()
        unit = math.lcm(of_begin, of_length)
        return cls(begin * (unit // of_begin), length * (unit // of_length), unit)

    def after(self, t: float) -> int:
        """The number of the first time after t."""
        k = math.floor((Fraction(t) * self.unit - self.start) / self.step)
        while self.time(k) <= t:
            k += 1
        return k

    def time(self, k: int) -> float:
        return (self.start + k * self.step) / self.unit  # Python divides integers with correct rounding
