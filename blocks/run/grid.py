"""Equally spaced times: never accumulated, each the double nearest to the exact fraction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

__all__ = ["Grid"]


@dataclass(frozen=True, slots=True)
class Grid:
    """The times (start + k step) / unit for whole k."""

    start: int
    step: int
    unit: int

    @classmethod
    def of(cls, start: Fraction, step: Fraction) -> Grid:
        unit = math.lcm(start.denominator, step.denominator)
        return cls(int(start * unit), int(step * unit), unit)

    def time(self, k: int) -> float:
        return (self.start + k * self.step) / self.unit  # Python divides integers with correct rounding
