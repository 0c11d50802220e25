"""Newton's method for algebraic loops: small dense systems with exact matrices.

Reference: J. E. Dennis, R. B. Schnabel, Numerical Methods for Unconstrained Optimization and Nonlinear Equations, SIAM
1996, chapters 5 and 6 (a step is halved until the residual falls).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["newton"]

MOST_STEPS, MOST_HALVINGS = 60, 30
_CLOSE = 1e-13  # relative size of a last step: the next one would be rounding
_SINGULAR = 1e13  # condition beyond which a matrix says nothing

System = Callable[..., tuple[tuple[float, ...], tuple[tuple[float, ...], ...]]]
"""From the unknowns to the residuals, and to their partial derivatives row by row."""


def newton(system: System, guess: tuple[float, ...]) -> tuple[float, ...]:
    """The unknowns where all residuals are 0, from a guess; NaN where none is found."""
    nothing = (math.nan,) * len(guess)
    x = np.array(guess, dtype=float)
    residuals, matrix = _evaluated(system, x)
    size = _size(residuals)
    for _ in range(MOST_STEPS):
        if not math.isfinite(size) or not np.isfinite(matrix).all():
            return nothing
        step = _solved(matrix, -residuals)
        if step is None:
            return nothing
        share = 1.0
        for _ in range(MOST_HALVINGS):
            tried = x + share * step
            residuals_tried, matrix_tried = _evaluated(system, tried)
            size_tried = _size(residuals_tried)
            if size_tried < size or size_tried == 0.0:
                break
            if np.all(np.abs(step) <= _CLOSE * (np.abs(x) + 1e-3)):
                return tuple(x.tolist())  # rounding decides from here on
            share /= 2
        else:
            return nothing
        x, residuals, matrix, size = tried, residuals_tried, matrix_tried, size_tried
        if size == 0.0 or (share == 1.0 and np.all(np.abs(step) <= _CLOSE * np.abs(x))):
            return tuple(x.tolist())
    return nothing


def _evaluated(system: System, x: Any) -> tuple[Any, Any]:
    residuals, matrix = system(*x.tolist())
    return np.array(residuals, dtype=float), np.array(matrix, dtype=float)


def _size(residuals: Any) -> float:
    return float(np.max(np.abs(residuals)))  # NaN stays NaN


def _solved(matrix: Any, right: Any) -> Any:
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
