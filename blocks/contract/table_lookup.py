"""Looking up in tables: the primitives that equations and every engine share.

A table is a parameter declared with `table=True`. Equations look up in it with these functions, on numbers and on
symbols alike; what is made of them (lines between points, the next edge) is ordinary arithmetic. Both are constant
between the points of a table, so their derivatives are 0 there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np


class TracedTable(ABC):
    """A table while equations are traced: its numbers are not known, its size is."""

    @abstractmethod
    def search(self, x: object) -> Any:
        """How many of the points are at most x."""

    @abstractmethod
    def pick(self, index: object) -> Any:
        """The element at an index, in C order."""


def _is_number(x: object) -> bool:
    return isinstance(x, (int, float, np.ndarray, np.generic, list, tuple))


def search(points: Any, x: Any) -> Any:
    """How many of the increasing `points` are at most x: 0 below the first, len(points) from the last on.

    NaN counts as above all. The result has the shape of x and is a float.
    """
    if isinstance(points, TracedTable):
        return points.search(x)
    if not _is_number(x):  # symbols: of a few points that stand in the equation
        count: object = 0.0 * x
        for point in np.ravel(points):
            count = count + np.where(x >= float(point), 1.0, 0.0)
        return count
    return np.searchsorted(points, x, side="right").astype(float)[()]


def pick(values: Any, index: Any) -> Any:
    """The element of `values`, in C order, at a whole number; beyond the ends the first or the last. NaN gives NaN."""
    if isinstance(values, TracedTable):
        return values.pick(index)
    if not _is_number(index):
        picked: Any = 0.0 * index + float(np.ravel(values)[0])
        for number, value in enumerate(np.ravel(values)[1:], start=1):
            picked = np.where(index >= number, float(value), picked)
        return picked
    flat, place = np.ravel(values), np.asarray(index, dtype=float)
    known = np.where(np.isnan(place), 0.0, np.clip(place, 0, flat.size - 1))
    return np.where(np.isnan(place), np.nan, flat[known.astype(int)])[()]
