"""Newton's method for algebraic loops: small dense systems with exact matrices.

A loop comes here torn: its unknowns are the few from which the others follow. Its first search takes steps that lower
the residuals. Where it fails, others follow: from what the blocks give at the guess; between two values at which the
residual of a single unknown has opposite signs; and, of several unknowns, along the way on which the residuals that the
guess leaves fall to 0.

References: J. E. Dennis, R. B. Schnabel, Numerical Methods for Unconstrained Optimization and Nonlinear Equations, SIAM
1996, chapters 5 and 6 (a step is halved until the residual falls). P. Deuflhard, Newton Methods for Nonlinear Problems,
Springer 2004, chapters 3 (residuals are measured by the step that they ask for, however their rows are scaled) and 5
(continuation).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

MOST_STEPS, MOST_HALVINGS = 60, 30
FEW_STEPS, FEW_HALVINGS = 10, 4
_CLOSE = 1e-13  # relative size of a last step: the next one would be rounding
_NEAR = 1e-9  # the same where no part of a step lowers the residual, in spite of exact slopes
_SINGULAR = 1e13  # condition beyond which a matrix says nothing
_ROUNDING = 4 * 2.0**-52
_WIDE = 2.0**20  # how many times their rounding torn unknowns are moved, so that the others do not round much
_FIRST_PART, _LEAST_PART = 0.125, 1e-6  # of the way from the guess
_FIRST_DISTANCE, _LAST_DISTANCE = 1e-6, 1e20  # between which a change of sign is searched for

System = Callable[..., tuple[Any, Any, tuple[float, ...]]]
"""From the torn unknowns to the residuals, their partial derivatives row by row, and the other unknowns."""
Rounding = Callable[..., tuple[float, ...]]
"""From the torn unknowns to bounds on the rounding of the residuals, in units of 2^-52."""
Array = Any


class Point(NamedTuple):
    """A system at some unknowns."""

    x: Array
    residuals: Array
    matrix: Array
    others: tuple[float, ...]

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.residuals).all() and np.isfinite(self.matrix).all())


class Loop(NamedTuple):
    """The equations of a loop."""

    system: System
    rounding: Rounding

    def at(self, x: Array) -> Point:
        residuals, matrix, others = self.system(*x.tolist())
        return Point(x, np.array(residuals, dtype=float), np.array(matrix, dtype=float), others)

    def is_rounding(self, point: Point) -> bool:
        """Return whether the residuals are no more than what rounding leaves of 0."""
        return bool(np.all(np.abs(point.residuals) <= _ROUNDING * np.array(self.rounding(*point.x.tolist()))))


def newton(system: System, guess: tuple[float, ...], rounding: Rounding) -> tuple[float, ...]:
    """Return all unknowns where the residuals are 0, the torn ones first, or NaN if none is found.

    guess: of the torn ones.
    """
    loop = Loop(system, rounding)
    first = loop.at(np.array(guess, dtype=float))
    found = _descended(loop, first)
    if found is None:
        found = next((point for point in _others(loop, first) if point is not None), None)
    if found is None:
        return (math.nan,) * (len(guess) + len(first.others))
    return (*found.x.tolist(), *found.others)


class Nearest:
    """How near the first search comes to a solution: the torn unknown of the largest residual where that is least.

    number, x: of this unknown, its number and value. residual: there; inf where none is finite.
    """

    def __init__(self, system: System, guess: tuple[float, ...], rounding: Rounding) -> None:
        self.system, self.guess = system, guess
        self.number, self.x, self.residual = 0, guess[0], math.inf
        loop = Loop(self._watched, rounding)
        _descended(loop, loop.at(np.array(guess, dtype=float)))

    def _watched(self, *x: float) -> tuple[Any, Any, tuple[float, ...]]:
        parts = self.system(*x)
        sizes = [abs(residual) for residual in parts[0]]
        if max(sizes) < self.residual and all(map(math.isfinite, sizes)):
            self.number = sizes.index(max(sizes))
            self.x, self.residual = x[self.number], max(sizes)
        return parts


def spread(
    system: System, solution: tuple[float, ...], bounds: Callable[..., tuple[tuple[float, ...], ...]]
) -> tuple[float, ...]:
    """Return how far rounding may move all unknowns, the torn ones first, from a solution of these; 0 if it is unknown.

    bounds: those on the rounding of the residuals, and of the other unknowns where the torn ones are exact.
    """
    point = Loop(system, lambda: ()).at(np.array(solution, dtype=float))
    of_residuals, of_others = (2.0**-52 * np.array(part) for part in bounds(*solution))
    try:
        torn = np.abs(np.linalg.inv(point.matrix)) @ of_residuals
    except np.linalg.LinAlgError:
        torn = np.zeros(len(solution))
    others = of_others
    for k, off in enumerate(torn):
        x = point.x.copy()
        x[k] += _WIDE * off
        moved = np.array(system(*x.tolist())[2], dtype=float)
        others = others + np.abs(moved - point.others) / _WIDE
    unknowns = np.concatenate([torn, others])
    return tuple(np.where(np.isfinite(unknowns), unknowns, 0.0).tolist())


def _descended(loop: Loop, point: Point) -> Point | None:
    """The solution from a point, by steps that lower the largest residual."""
    size = _size(point.residuals)
    for steps in range(MOST_STEPS):
        if steps >= FEW_STEPS and loop.is_rounding(point):
            return point  # an unknown that is 0 but for rounding goes on to fall
        if not math.isfinite(size) or not np.isfinite(point.matrix).all():
            return None
        step = _solved(point.matrix, -point.residuals)
        if step is None:
            return None
        if steps == 0 and np.all(np.abs(step) <= _CLOSE * np.abs(point.x)) and loop.is_rounding(point):
            return point  # a solution stays as it is: at one instant all see the same bits
        share = 1.0
        for halvings in range(MOST_HALVINGS):
            tried = loop.at(point.x + share * step)
            size_tried = _size(tried.residuals)
            if size_tried < size or size_tried == 0.0:
                break
            if halvings == 0:
                is_least = np.all(np.abs(step) <= _CLOSE * (np.abs(point.x) + 1e-3))
                if is_least or loop.is_rounding(point):
                    return point  # rounding decides from here on
            elif halvings == FEW_HALVINGS and np.all(np.abs(step) <= _NEAR * np.abs(point.x)):
                return point
            share /= 2
        else:
            return None
        is_last = share == 1.0 and np.all(np.abs(step) <= _CLOSE * np.abs(point.x))
        point, size = tried, size_tried
        if size == 0.0 or is_last:
            return point
    return point if loop.is_rounding(point) else None


def _others(loop: Loop, first: Point) -> Iterator[Point | None]:
    """Further searches, from the guess, from what the blocks give there, and from 1."""
    begins = [first]
    for x in (first.x + first.residuals, np.ones(len(first.x))):
        point = loop.at(x)
        if point.is_finite:
            yield _settled(loop, _moved(loop, point, 0.0, MOST_STEPS))
            begins.append(point)
    for point in begins:
        if len(point.x) == 1:
            yield _enclosed(loop, point)
        elif point.is_finite:
            yield _followed(loop, point)


def _settled(loop: Loop, point: Point | None) -> Point | None:
    return None if point is None else _descended(loop, point)


def _moved(loop: Loop, point: Point, left: Array | float, most: int) -> Point | None:
    """A point near that where the residuals are `left`: each step lowers them, or the step that they ask for."""
    for _ in range(most):
        wanted = point.residuals - left
        step = _solved(point.matrix, -wanted)
        if step is None:
            return None
        scale = np.abs(point.x) + np.abs(step) + 5e-324
        share = 1.0
        for _ in range(MOST_HALVINGS):
            tried = loop.at(point.x + share * step)
            if tried.is_finite:
                if _size(tried.residuals - left) < _size(wanted):
                    break
                again = _solved(point.matrix, left - tried.residuals)
                if again is not None and _size(again / scale) < (1.0 - share / 4) * _size(step / scale):
                    break
            if np.all(np.abs(step) <= _NEAR * np.abs(point.x)):
                return point
            share /= 2
        else:
            return None
        point = tried
        if share == 1.0 and np.all(np.abs(step) <= 1e-6 * np.abs(point.x)):
            return point
    return None


def _followed(loop: Loop, point: Point) -> Point | None:
    """The solution at the end of the way on which the residuals are a part of those at a point that falls to 0."""
    begin = point.residuals
    left, part = 1.0, _FIRST_PART
    while left > 0.0 and part > _LEAST_PART:
        then = max(left - part, 0.0)
        found = _moved(loop, point, then * begin, FEW_STEPS)
        if found is None:
            part /= 4
        else:
            point, left, part = found, then, 2 * part
    return _descended(loop, point) if left == 0.0 else None


def _enclosed(loop: Loop, point: Point) -> Point | None:
    """The solution between two values of a single unknown, the nearest where residuals have opposite signs."""
    begin = float(point.x[0])
    sides = {1.0: point, -1.0: point}
    away = _FIRST_DISTANCE * max(abs(begin), 1e-3)
    while away < _LAST_DISTANCE:
        for sign, last in sides.items():
            sides[sign] = here = loop.at(np.array([begin + sign * away]))
            before, now = float(last.residuals[0]), float(here.residuals[0])
            if before * now < 0.0 or (now == 0.0 and before != 0.0):
                found = _halved(loop, last, here)
                if found is not None:
                    return found
        away *= 4
    return None


def _halved(loop: Loop, a: Point, b: Point) -> Point | None:
    """The solution between two points whose residuals have opposite signs."""
    while True:
        middle = float(a.x[0]) + float(b.x[0] - a.x[0]) / 2
        if middle in (a.x[0], b.x[0]):
            break
        point = loop.at(np.array([middle]))
        if math.isnan(point.residuals[0]):
            return None
        if (point.residuals[0] > 0.0) == (a.residuals[0] > 0.0):
            a = point
        else:
            b = point
    return _descended(loop, a) or _descended(loop, b)


def _size(residuals: Array) -> float:
    return float(np.max(np.abs(residuals)))  # NaN stays NaN


def _solved(matrix: Array, right: Array) -> Array | None:
    """The step, or None where the matrix is singular to working precision."""
    if len(right) == 1:
        return right / matrix[0] if matrix[0, 0] != 0.0 else None
    try:
        # Rows of very different units are brought to one size first.
        scale = np.max(np.abs(matrix), axis=1)
        if np.any(scale == 0.0) or np.linalg.cond(matrix / scale[:, None]) > _SINGULAR:
            return None
        return np.linalg.solve(matrix / scale[:, None], right / scale)
    except np.linalg.LinAlgError:
        return None
