"""The border of stability of a loop of several rates: by the eigenvalues of the closed loop, over gain and phase.

Such a loop transfer L goes from the values that a signal takes within one pattern of ticks to those that come back,
L(z) = D + C (z I - A)^-1 B with z over the whole pattern. With a factor f on the signal the closed loop is
A - f B (I + f D)^-1 C: the monodromy matrix of the diagram. It is at the border where an eigenvalue has the size 1.
A signal of one frequency comes back at several, so that no curve over frequency shows the margins.

Reference: S. Bittanti, P. Colaneri, Periodic Systems, Springer 2009, chapters 3 and 6.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .realization import Realization, growth

_EPS = float(np.finfo(float).eps)
MOST_GAIN = 1e8
"""The largest gain up to which borders are looked for; 1 over it is the least."""
_PER_DECADE = 12
_PHASES = 180
_STEP = 0.05  # of the logarithm of an eigenvalue's size near the border, between neighbors on a grid
_PASSES = 24
_TOUCH = 1e-10
_DOUBT = 1e-6  # of the logarithm of a size: what rounding may do to an eigenvalue that is reported at the border
_BESIDE = 1e-3  # of the logarithm of the gain, or of the phase in rad
_LARGE = 1e10  # a larger monodromy matrix leaves no digits to eigenvalues near the border
_FAR = 4.0  # logarithms of sizes are cut here


@runtime_checkable
class Lifted(Protocol):
    """A state space over a pattern of ticks; times: of its inputs and outputs within the pattern, in s."""

    times: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Factored:
    """The closed loop with a factor on the signal; fixed: eigenvalues (as z - 1) at the border that no factor moves.

    is_at_border: whether it is at the border within rounding with the factor 1. check: called before eigenvalues are
    computed.
    """

    seen: Realization
    fixed: tuple[complex, ...] = ()
    is_at_border: bool = False
    check: Callable[[], None] | None = None

    def matrix(self, factor: complex) -> Array:
        """The monodromy matrix less I. inf where the loop has no solution."""
        from scipy.linalg import solve_triangular

        loop = self.seen
        with np.errstate(all="ignore"):
            try:
                # What comes back does not depend on later values: D is lower triangular.
                back = solve_triangular(np.eye(len(loop.d)) + factor * loop.d, loop.c, lower=True, check_finite=False)
            except np.linalg.LinAlgError:
                return np.full(loop.a.shape, np.inf)
            return np.asarray(loop.a - factor * loop.b @ back)

    def poles(self, factor: complex) -> Array | None:
        """Its eigenvalues, less 1; None where rounding hides them."""
        if self.check is not None:
            self.check()
        matrix = self.matrix(factor)
        if not np.all(np.isfinite(matrix)) or np.max(np.abs(matrix), initial=0.0) > _LARGE:
            return None
        eigenvalues = np.linalg.eigvals(matrix).astype(complex)
        for pole in self.fixed:
            if len(eigenvalues):
                eigenvalues = np.delete(eigenvalues, int(np.argmin(np.abs(eigenvalues - pole))))
        return eigenvalues

    def sizes(self, factor: complex) -> Array | None:
        """Logarithms of the sizes of its eigenvalues, the largest first: each is continuous over the factor."""
        eigenvalues = self.poles(factor)
        return None if eigenvalues is None else np.clip(np.sort(growth(eigenvalues, 1.0))[::-1], -_FAR, _FAR)

    def nearest(self, factor: complex) -> complex:
        """The eigenvalue that is nearest to the border, less 1."""
        eigenvalues = self.poles(factor)
        assert eigenvalues is not None
        return complex(eigenvalues[int(np.argmin(np.abs(growth(eigenvalues, 1.0))))])

    def angle(self, factor: complex) -> float:
        """The angle of the eigenvalue nearest to the border, in rad, from 0 to pi."""
        return float(abs(np.angle(1.0 + self.nearest(factor))))

    def is_sure(self, factor: complex, beside: tuple[complex, complex]) -> bool:
        """Whether an eigenvalue is at the border by more than rounding: it is known there to some digits, or it passes
        from one side to the other, between two factors beside, by more than what rounding may have moved it."""
        from scipy.linalg import eig

        matrix = self.matrix(factor)
        values, left, right = eig(matrix, left=True, right=True)
        near = int(np.argmin(np.abs(values - self.nearest(factor))))
        overlap = abs(np.sum(left[:, near].conj() * right[:, near]))
        doubt = 8 * len(matrix) * _EPS * np.linalg.norm(matrix) / max(overlap, 1e-12)
        if doubt < _DOUBT:
            return True
        sides = [self.sizes(neighbor) for neighbor in beside]
        if sides[0] is None or sides[1] is None:
            return False
        passes = sides[0] * sides[1] < 0
        return bool(np.any(passes & (np.minimum(np.abs(sides[0]), np.abs(sides[1])) > doubt)))


def gain_borders(loop: Factored) -> tuple[tuple[float, float], ...]:
    """(factor, angle) of every gain from 1/MOST_GAIN to MOST_GAIN at which the closed loop is at the border.

    Raises AnalysisError (E705) where rounding hides whether a stable loop has one above 1.
    """
    end = math.log(MOST_GAIN)
    grid = np.linspace(-end, end, 2 * _PER_DECADE * round(math.log10(MOST_GAIN)) + 1)
    borders = _sure(loop, lambda x: complex(math.exp(x)), grid, "a gain", math.exp)
    return tuple((math.exp(x), loop.angle(math.exp(x))) for x in borders)


def phase_borders(loop: Factored) -> tuple[tuple[float, float], ...]:
    """(degrees, angle) of every phase from 0 to 180 degrees at which it is at the border; each as lag and as lead.

    Raises AnalysisError (E705) as `gain_borders`.
    """
    grid = np.linspace(0.0, math.pi, _PHASES + 1)
    borders = _sure(loop, lambda x: complex(math.cos(x), -math.sin(x)), grid, "a phase in degrees", math.degrees)
    return tuple((math.degrees(x), loop.angle(complex(math.cos(x), -math.sin(x)))) for x in borders)


def _sure(
    loop: Factored, factor: Callable[[float], complex], grid: Array, what: str, shown: Callable[[float], float]
) -> list[float]:
    """The borders on a grid that are none by rounding alone. factor: of a place on the grid."""
    borders, last = _borders(lambda x: loop.sizes(factor(x)), grid)
    sure, hidden = [], [last] if last < grid[-1] else []
    for x in _apart(borders):
        if loop.is_sure(factor(x), (factor(x - _BESIDE), factor(x + _BESIDE))):
            sure.append(x)
        elif x >= 0:
            hidden.append(x)
    sizes = loop.sizes(1.0)
    first = min((x for x in sure if x >= 0), default=math.inf)
    is_stable = sizes is not None and np.all(sizes < 0) and not loop.is_at_border
    if hidden and min(hidden) < first and is_stable:
        message = f"from {what} of {shown(min(hidden)):.4g} on, rounding hides whether the closed loop is stable."
        cure = "Choose periods with a shorter common multiple."
        raise AnalysisError(Fault("E705", "margins", message, cure))
    return sure


def _apart(borders: list[float]) -> list[float]:
    """In order, without what is there twice: a pair of eigenvalues crosses together."""
    distinct: list[float] = []
    for border in sorted(borders):
        if not distinct or border - distinct[-1] > 1e-9 * max(1.0, abs(border)):
            distinct.append(border)
    return distinct


def _borders(f: Callable[[float], Array | None], grid: Array) -> tuple[list[float], float]:
    """Where one of the functions is 0, crossed or touched, and up to where they are known: f gives None where not."""
    points = [(x, f(x)) for x in grid.tolist()]
    for (a, before), (b, after) in list(itertools.pairwise(points)):
        # A power of many steps may leave the border and what rounding shows within one step of the grid.
        while (before is None) is not (after is None) and b - a > 1e-9:
            middle = 0.5 * (a + b)
            values = f(middle)
            points.append((middle, values))
            if (values is None) is (before is None):
                a = middle
            else:
                b = middle
    points.sort(key=lambda point: point[0])
    borders: list[float] = []
    for is_known, run in itertools.groupby(points, key=lambda point: point[1] is not None):
        if is_known:
            borders += _of_run(f, [(x, values) for x, values in run if values is not None])
    return borders, max((x for x, values in points if values is not None), default=float(grid[0]))


def _of_run(f: Callable[[float], Array | None], known: list[tuple[float, Array]]) -> list[float]:
    for _ in range(_PASSES):
        finer = known[:1]
        for (a, before), (b, after) in itertools.pairwise(known):
            change = np.abs(after - before)
            near = np.minimum(np.abs(before), np.abs(after)) < 2.0 * change
            if np.any(near & (change > _STEP)) and b - a > 1e-9:
                middle = 0.5 * (a + b)
                values = f(middle)
                if values is not None:
                    finer.append((middle, values))
            finer.append((b, after))
        if len(finer) == len(known):
            break
        known = finer
    x = np.array([at for at, _ in known])
    borders: list[float] = []
    for k in range(len(known[0][1])):
        borders += _zeros(f, x, np.array([values[k] for _, values in known]), k)
    return borders


def _zeros(f: Callable[[float], Array | None], x: Array, values: Array, k: int) -> list[float]:
    from scipy.optimize import brentq, minimize_scalar

    def branch(at: float) -> float:
        branches = f(float(at))
        return math.nan if branches is None else float(branches[k])

    def between(a: float, b: float) -> float:
        return float(brentq(branch, a, b, xtol=1e-15, rtol=4 * _EPS))

    sign = np.sign(values)
    zeros = [between(float(x[i]), float(x[i + 1])) for i in np.flatnonzero(sign[:-1] * sign[1:] < 0)]
    zeros += [float(x[i]) for i in np.flatnonzero(sign == 0)]
    # Turning back in front of 0, or a little behind it: between two neighbors on the grid.
    size = np.abs(values)
    inner = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]) & (size[1:-1] < 2 * _STEP)
    inner &= (sign[:-2] == sign[1:-1]) & (sign[1:-1] == sign[2:])
    for i in np.flatnonzero(inner) + 1:
        a, b = float(x[i - 1]), float(x[i + 1])
        least = minimize_scalar(
            lambda at, s=float(sign[i]): s * branch(at), bounds=(a, b), method="bounded", options={"xatol": 1e-10}
        )
        if least.fun < -1e-12:
            zeros += [between(a, float(least.x)), between(float(least.x), b)]
        elif least.fun < _TOUCH:
            zeros.append(float(least.x))
    return zeros
