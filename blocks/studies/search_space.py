"""The values among which a tuning or a fit searches, as points of the unit cube."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..model.values import in_unit
from ..model.varied import columns_of
from ..text.arrays import Array
from ..text.errors import Fault, ModelError, UsageError
from ..text.printable import legible

FAR_APART = 10.0
"""Bounds of which the upper is so many times the lower are searched on a logarithmic scale."""
DIGITS = 6
"""Significant digits of the values of candidates: what is run, told and written is the same."""


def _number(bound: object, name: str, unit_of: Callable[[str], str]) -> float:
    """Return a bound in the unit of its parameter. Raises ModelError, TypeError, ValueError."""
    return float(bound if isinstance(bound, (int, float)) else in_unit(bound, unit_of(name), legible(name)))


def units_of_parameters(diagram: Any, case: Any) -> Callable[[str], str]:
    """Return the function that gives the unit of plain numbers for a parameter of a diagram, by its name."""
    return lambda name: columns_of([name], diagram.flatten(case))[0].unit


@dataclass(frozen=True)
class Space:
    """The values that may be taken, as a cube: 0 stands for the lower bound, 1 for the upper one."""

    low: Array
    high: Array
    is_log: Array

    @classmethod
    def of(cls, over: Mapping[str, Any], unit_of: Callable[[str], str] = lambda name: "") -> Space:
        """Read the bounds: numbers in the units of the parameters, or quantities. unit_of: the unit of a parameter.

        Raises UsageError (E501) with all bounds that are none.
        """
        if not isinstance(over, Mapping):
            raise UsageError(
                Fault(
                    "E501", "over", "must be a mapping from names to bounds.", 'Example: over={"motor.Ra": (0.1, 0.2)}.'
                )
            )
        faults, bounds = [], []
        for name, given in over.items():
            try:
                low, high = (_number(bound, name, unit_of) for bound in given)
            except ModelError as error:
                faults += [replace(fault, code="E501") for fault in error.faults]
                low, high = 0.0, 1.0
            except (TypeError, ValueError):
                low = high = math.nan
            if not -math.inf < low < high < math.inf:
                cure = "Give the smallest and the largest value: (50, 600)."
                faults.append(
                    Fault(
                        "E501", legible(str(name)), f"must have two bounds, the lower one first, not {given!r}.", cure
                    )
                )
            bounds.append((low, high))
        if not over:
            faults.append(Fault("E501", "over", "contains no parameter.", 'Example: over={"motor.Ra": (0.1, 0.2)}.'))
        if faults:
            raise UsageError(*faults)
        low, high = np.array(bounds, dtype=float).T
        return cls(low, high, (low > 0) & (high >= FAR_APART * low))

    def values(self, cube: Array, digits: int | Sequence[int] = DIGITS) -> Array:
        """The values (..., k) of points (..., k) of the cube, with so many significant digits, or (k,) of them."""
        with np.errstate(all="ignore"):
            logs = self.low * (self.high / self.low) ** cube
        values = np.where(self.is_log, logs, self.low + (self.high - self.low) * cube)
        counts = np.broadcast_to(digits, values.shape).flat
        rounded = [float(f"{value:.{count}g}") for value, count in zip(values.flat, counts, strict=True)]
        values = np.array(rounded).reshape(values.shape)
        clipped: Array = np.clip(values, self.low, self.high)
        return clipped

    def slopes(self, cube: Array) -> Array:
        """The derivatives (k,) of the values at a point (k,) of the cube."""
        with np.errstate(all="ignore"):
            rates = np.log(self.high / self.low)
        return np.where(self.is_log, self.values(cube) * rates, self.high - self.low)

    def cube(self, values: Array) -> Array:
        """The points of values; the nearest ones of those outside, the middle of those that are no numbers."""
        inside = np.clip(values, self.low, self.high)
        with np.errstate(all="ignore"):
            logs = np.log(inside / self.low) / np.log(self.high / self.low)
        cube = np.where(self.is_log, logs, (inside - self.low) / (self.high - self.low))
        return np.where(np.isnan(values), 0.5, cube)
