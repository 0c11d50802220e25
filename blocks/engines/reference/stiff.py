"""The stiff method: Radau IIA of order 5, a step at a time, with the exact Jacobian of the Plan.

A step from (t, x) of length h has stages x + z_i at t + c_i h, the last of them at its end:

    z_i = h sum_j a_ij f(t + c_j h, x + z_j)

They are solved together by a simplified Newton iteration: J, the Jacobian, is one of this step or of an earlier one. In
the variables w = T^-1 z the matrix of all stages falls into a real one and a complex one of the size of J,
(gamma/h I - J) and ((alpha + i beta)/h I - J), whose factors serve while h and J do. The iteration begins on the
polynomial of the step before. Its own polynomial, of degree 3 through x and the stages, is the dense output.

The error is that of an embedded formula of order 3, filtered by (gamma/h I - J)^-1: what is stiff does not shorten the
step. The next step follows from this error and from how the last one changed it (Gustafsson). What is kept from step to
step is `Carried`, a part of snapshots. Its twin in C: compile/c/runtime/radau.c.

Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8, and their program RADAU5.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ...compile.jacobian import PlanJacobian
from ...compile.plan import Plan
from ...text.arrays import Array, frozen
from .methods import Flow, Polynomial, Rates, Retaken, first_step, worst
from .python_code import CompiledPrograms

# SuperLU overtakes LAPACK from 60 to 80 states on where a matrix is tridiagonal. With 10 % of all entries, scattered,
# it fills them all in and never does.
_SPARSE_FROM, _SPARSE_DENSITY = 80, 0.05

_S6 = math.sqrt(6)
_C = np.array([(4 - _S6) / 10, (4 + _S6) / 10, 1.0])
_E = np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1]) / 3
_REAL = 3 + 3 ** (2 / 3) - 3 ** (1 / 3)
_COMPLEX = 3 + 0.5 * (3 ** (1 / 3) - 3 ** (2 / 3)) - 0.5j * (3 ** (5 / 6) + 3 ** (7 / 6))
_T = np.array([
    [0.09443876248897524, -0.14125529502095421, 0.03002919410514742],
    [0.25021312296533332, 0.20412935229379994, -0.38294211275726192],
    [1, 1, 0],
])  # fmt: skip
_TI = np.array([
    [4.17871859155190428, 0.32768282076106237, 0.52337644549944951],
    [-4.17871859155190428, -0.32768282076106237, 0.47662355450055044],
    [0.50287263494578682, -2.57192694985560522, 0.59603920482822492],
])  # fmt: skip
# Stages -> coefficients of the polynomial, by powers of theta.
_P = np.array([
    [13 / 3 + 7 * _S6 / 3, -23 / 3 - 22 * _S6 / 3, 10 / 3 + 5 * _S6],
    [13 / 3 - 7 * _S6 / 3, -23 / 3 + 22 * _S6 / 3, 10 / 3 - 5 * _S6],
    [1 / 3, -8 / 3, 10 / 3],
])  # fmt: skip

_ITERATIONS, _TRIALS = 7, 64
_SLOW = 1e-3  # an iteration that converges no slower needs no other Jacobian
_EPS = float(np.finfo(float).eps)
_LEAST, _MOST, _SAFETY, _HELD = 0.2, 8.0, 0.9, 1.2


class Slopes:
    """The Jacobian of a Plan for a stiff method: sparse where that pays, else dense. It serves several runs."""

    def __init__(self, compiled: CompiledPrograms) -> None:
        plan: Plan = compiled.plan
        self.jacobian = PlanJacobian(plan)
        self.outputs = compiled.program("slopes", self.jacobian.outputs) if self.jacobian.outputs else None
        self.nominal = np.array(plan.nominal, dtype=float)
        self.is_sparse = len(plan.states) >= _SPARSE_FROM and self.jacobian.density <= _SPARSE_DENSITY

    @classmethod
    def of(cls, compiled: CompiledPrograms) -> Slopes:
        """The slopes of a compiled Plan, made once."""
        if compiled not in _MADE:
            _MADE[compiled] = cls(compiled)
        return _MADE[compiled]

    def at(self, memory: Sequence[object], rates: Callable[[Array], Array]) -> Array:
        """The values of the pattern where memory is (t, x, d, s, p, u, k, h, z).

        rates: dx/dt from x alone, for difference quotients where the exact derivatives are not finite. Raises
        ArithmeticError where these are not finite either.
        """
        exact = self.jacobian.at(memory, () if self.outputs is None else self.outputs(*memory))
        jacobian = exact
        if not exact.is_finite:
            x = np.array(memory[1], dtype=float)
            jacobian = exact.completed(rates, x, np.maximum(np.abs(x), self.nominal))
            if not jacobian.is_finite:
                where = ", ".join(f"{doubt.block}.{doubt.equation} by {doubt.by}" for doubt in exact.doubtful())
                raise ArithmeticError(f"the Jacobian is not finite ({where})")
        return frozen(jacobian.data)

    def matrix(self, values: Array) -> Any:
        """J, an array or a scipy.sparse matrix, by the values of its pattern."""
        pattern = self.jacobian
        if self.is_sparse:
            from scipy.sparse import csc_matrix

            return csc_matrix((values, pattern.indices, pattern.indptr), shape=pattern.shape)
        matrix = np.zeros(pattern.shape)
        matrix[pattern.indices, np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))] = values
        return matrix


_MADE: WeakKeyDictionary[CompiledPrograms, Slopes] = WeakKeyDictionary()


@dataclass(frozen=True)
class Carried:
    """What the method keeps from step to step: of the last one its length (0: there is none), its error, and its
    polynomial (3, n) without x; how Newton's iteration converged; the values of the Jacobian (None: they are to be
    taken anew), and the length of the step for which there are factors (0: none)."""

    length: float
    error: float
    rate: float
    factored: float
    polynomial: Array
    slopes: Array | None

    @classmethod
    def nothing(cls, n: int) -> Carried:
        return cls(0.0, 1.0, 1.0, 0.0, np.zeros((3, n)), None)

    def row(self, values: int) -> Array:
        """As one row, with so many values of the Jacobian."""
        slopes = np.zeros(values) if self.slopes is None else self.slopes
        numbers = (self.length, self.error, self.rate, self.factored, float(self.slopes is not None))
        return frozen(np.concatenate([numbers, self.polynomial.ravel(), slopes]))

    @classmethod
    def of_row(cls, row: Array, n: int, values: int) -> Carried:
        numbers, rest = row[:5].tolist(), row[5:]
        slopes = frozen(rest[3 * n : 3 * n + values].copy()) if numbers[4] else None
        length, error, rate, factored, _ = numbers
        return cls(length, error, rate, factored, rest[: 3 * n].reshape(3, n), slopes)


class _Factors:
    """The factors of both matrices. Raises ArithmeticError where one is singular."""

    def __init__(self, matrix: Any, h: float) -> None:
        n = matrix.shape[0]
        self.solvers: list[Callable[[Array], Array]] = []
        if not isinstance(matrix, np.ndarray):
            from scipy.sparse import identity
            from scipy.sparse.linalg import splu

            for shift in (_REAL / h, _COMPLEX / h):
                try:
                    self.solvers.append(splu((shift * identity(n, format="csc") - matrix).tocsc()).solve)
                except RuntimeError as error:
                    raise ArithmeticError(str(error)) from None
            return
        from scipy.linalg import lu_factor, lu_solve

        for shift in (_REAL / h, _COMPLEX / h):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a pivot of 0, which is asked for below
                factors = lu_factor(shift * np.eye(n) - matrix, check_finite=False) if n else (np.empty((0, 0)), [])
            if not np.all(np.diag(factors[0]) != 0.0):
                raise ArithmeticError("the matrix of a step is singular")
            self.solvers.append(partial(lu_solve, factors, check_finite=False) if n else lambda b: b)


@dataclass(frozen=True)
class Step:
    """An accepted step: its dense output, its end, the rates there, the proposal for the next one, and its error."""

    dense: Polynomial
    t1: float
    x1: Array
    last: Array
    proposed: float
    error: float
    carried: Carried


class Radau:
    """The steps of one run.

    rates: dx/dt at (t, x). slopes: the values of the Jacobian there, or ArithmeticError. matrix: J by them. blamed: the
    number of steps in which a state had the largest error of one that was rejected.
    """

    def __init__(
        self, rates: Rates, slopes: Callable[[float, Array], Array], matrix: Callable[[Array], object], n: int
    ) -> None:
        self.rates, self.slopes, self.matrix = rates, slopes, matrix
        self.rejected, self.blamed = 0, np.zeros(n, dtype=int)
        self._known: tuple[float, Array | None, _Factors | None] = (0.0, None, None)

    def step(
        self, t: float, x: Array, first: Array, carried: Carried, h: float, target: float, longest: float,
        atol: Array, rtol: float, *, refused: Retaken | None = None,
    ) -> Step:  # fmt: skip
        """A step from (t, x), where the rates are `first`, towards the target. h: the proposed one (0: there is none).
        refused: a retaken step from here whose error was too large.

        Raises ArithmeticError where no step is short enough.
        """
        left, least, weights = target - t, 16 * math.ulp(t), 1.0 / (atol + rtol * np.abs(x))
        if h <= 0:
            h = first_step(self.rates, t, x, first, 3, atol, rtol, left)
        h, is_fresh, rejected = max(min(h, longest), least), False, False
        if refused is not None:
            self.rejected, rejected = self.rejected + 1, True
            self.blamed[refused.culprit] += 1
            if refused.h <= least:
                raise ArithmeticError(f"the step became too small to reach rtol {rtol}")
            factor = max(_LEAST, _SAFETY * refused.error**-0.25) if math.isfinite(refused.error) else 0.5
            h = max(refused.h * factor, least)
        while True:
            # The last step before the target is stretched a little rather than followed by a tiny one.
            t1 = target if h >= left / 1.01 else t + h
            step = t1 - t
            if carried.slopes is None:
                carried, is_fresh = replace(carried, slopes=self.slopes(t, x), factored=0.0), True
            solved = self._solved(t, x, step, carried, weights, rtol)
            error = math.inf
            if solved is not None:
                z, rate, theta, count = solved
                carried = replace(carried, rate=max(rate, _EPS), factored=step)
                x1 = x + z[2]
                assert carried.slopes is not None
                factors, again = self._factors(step, carried.slopes), rejected or carried.length == 0.0
                error, culprit = self._error(t, x, first, step, z, factors, atol, rtol, again=again)
                if error <= 1.0:
                    last = self.rates(t1, x1)
                    if np.isfinite(last).all():
                        break
                    error = math.inf
                self.blamed[culprit] += 1
            elif not is_fresh:  # with the Jacobian here, it may converge
                carried, is_fresh = replace(carried, slopes=self.slopes(t, x), factored=0.0), True
                continue
            if h <= least or step <= least:
                raise ArithmeticError(f"the step became too small to reach rtol {rtol}")
            factor = _factor(step, error, count, carried) if math.isfinite(error) else 0.5
            h = max(step * factor, least)
            if carried.length == 0.0 and not rejected and math.isfinite(error):
                h = max(min(h, 0.1 * step), least)
            self.rejected, rejected = self.rejected + 1, True
        factor, keeps = _factor(step, error, count, carried), theta <= _SLOW
        if rejected:
            factor = min(factor, 1.0)
        if keeps and 1.0 <= factor <= _HELD:
            factor = 1.0  # the factors serve once more
        proposed = step * factor
        if step < h:  # cut short by the target: the proposal before it still counts
            proposed = max(proposed, h)
        polynomial = frozen(_P.T @ z)
        carried = replace(carried, length=step, error=max(error, 1e-2), polynomial=polynomial)
        if not keeps:
            carried = replace(carried, slopes=None)
        return Step(Polynomial(t, step, x, polynomial), t1, x1, last, proposed, max(error, 1e-4), carried)

    def flow(self, t: float, x: Array, first: Array, atol: Array, rtol: float) -> Flow:
        """Return the flow from (t, x), where the rates are `first`, to rounding: a crossing is looked for on its steps.
        A step is divided into parts if it does not converge as a whole."""
        weights = 1.0 / (atol + rtol * np.abs(x))

        def after(h: float) -> Array:
            made = self._in_parts(t, x, h, weights, rtol)
            return made[-1][1] if made else np.full(len(x), np.nan)

        def retaken(h: float) -> Retaken:
            made = self._in_parts(t, x, h, weights, rtol)
            if not made:
                return Retaken(h, np.full(len(x), np.nan), math.inf, 0)
            begin, rates, errors = x, first, []
            for k, (z, end) in enumerate(made):
                part = h / len(made)
                then = t + k * part
                rates = first if k == 0 else self.rates(then, begin)
                factors = self._factors(part, self.slopes(then, begin))
                errors.append(self._error(then, begin, rates, part, z, factors, atol, rtol, again=True))
                begin = end
            return Retaken(h, begin, *max(errors))

        return Flow(after, retaken)

    def _in_parts(self, t: float, x: Array, h: float, weights: Array, rtol: float) -> list[tuple[Array, Array]]:
        """Return the stages and the ends of as few equal parts of a step as converge; nothing if no parts do."""
        needed, parts = 10.0 * _EPS / rtol, 1
        while parts <= _TRIALS:
            made: list[tuple[Array, Array]] = []
            for part in range(parts):
                begin = made[-1][1] if made else x
                z = self._settled(t + part * (h / parts), begin, h / parts, weights, needed)
                if z is None:
                    break
                made.append((z, begin + z[2]))
            if len(made) == parts:
                return made
            parts *= 2
        return []

    def _settled(self, t: float, x: Array, h: float, weights: Array, needed: float) -> Array | None:
        factors = self._factors(h, self.slopes(t, x))
        z, change = np.zeros((3, len(x))), math.inf
        w = z.copy()
        for k in range(4 * _ITERATIONS if factors is not None else 0):
            before = change
            assert factors is not None
            z, w, change = self._iterate(t, x, h, z, w, factors, weights)
            if not change > needed or (k > 2 and change >= before):
                break
        return z if change <= 1e-3 else None

    def _factors(self, h: float, slopes: Array) -> _Factors | None:
        """The factors for a step of length h; None where there are none."""
        if self._known[0] != h or self._known[1] is not slopes:
            try:
                made = _Factors(self.matrix(slopes), h)
            except ArithmeticError:
                return None
            self._known = (h, slopes, made)
        return self._known[2]

    def _solved(
        self, t: float, x: Array, h: float, carried: Carried, weights: Array, rtol: float
    ) -> tuple[Array, float, float, int] | None:
        """The stages, how the iteration converged (twice), and in how many steps; None where it does not, or will not.

        It ends where what is left changes a step by no more than its error may be.
        """
        assert carried.slopes is not None
        factors = self._factors(h, carried.slopes)
        if factors is None:
            return None
        needed = max(10.0 * _EPS / rtol, min(0.03, math.sqrt(rtol)))
        z = np.zeros((3, len(x)))
        if carried.length > 0.0:
            there = 1.0 + _C * h / carried.length
            z = (there[:, None] ** np.arange(1, 4) - 1.0) @ carried.polynomial
        w = _TI @ z
        rate, before, ratio, theta = max(carried.rate, _EPS) ** 0.8, 0.0, 0.0, _SLOW
        for k in range(_ITERATIONS):
            z, w, change = self._iterate(t, x, h, z, w, factors, weights)
            if math.isnan(change):
                return None
            if k > 0:
                now = change / before
                theta = now if k == 1 else math.sqrt(now * ratio)
                ratio = now
                if not theta < 0.99:
                    return None
                rate = theta / (1.0 - theta)
                if rate * change * theta ** (_ITERATIONS - 1 - k) >= needed and rate * change > needed:
                    return None
            before = max(change, _EPS)
            if rate * change <= needed:
                return z, rate, theta, k + 1
        return None

    def _iterate(
        self, t: float, x: Array, h: float, z: Array, w: Array, factors: _Factors, weights: Array
    ) -> tuple[Array, Array, float]:
        """One iteration: stages, their variables, and the largest change of these over its weights."""
        f = _TI @ np.array([self.rates(t + c * h, x + own) for c, own in zip(_C.tolist(), z, strict=True)])
        solve, solve_complex = factors.solvers
        real = solve(f[0] - _REAL / h * w[0])
        other = solve_complex(f[1] + 1j * f[2] - _COMPLEX / h * (w[1] + 1j * w[2]))
        moved = np.array([real, other.real, other.imag])
        w = w + moved
        is_finite = np.isfinite(moved).all()
        return _T @ w, w, float(np.max(np.abs(moved) * weights, initial=0.0)) if is_finite else math.nan

    def _error(
        self, t: float, x: Array, first: Array, h: float, z: Array, factors: _Factors | None, atol: Array, rtol: float,
        *, again: bool,
    ) -> tuple[float, int]:  # fmt: skip
        """The largest error over the states, each by its own tolerance, and that state.

        again: whether it is filtered once more, as in a first step and in one that is tried again: in a transient it is
        far too large.
        """
        assert factors is not None
        x1, embedded, scale = x + z[2], _E @ z / h, atol + rtol * np.maximum(np.abs(x), np.abs(x + z[2]))
        error = factors.solvers[0](first + embedded)
        for is_last in (not again, True):
            if not (np.isfinite(error).all() and np.isfinite(x1).all()):
                return math.inf, worst(error, x, x1, atol, rtol)
            size = float(np.max(np.abs(error) / scale, initial=0.0))
            if size < 1.0 or is_last:
                break
            error = factors.solvers[0](self.rates(t, x + error) + embedded)
        return size, worst(error, x, x1, atol, rtol) if len(x) else 0


def _factor(h: float, error: float, iterations: int, carried: Carried) -> float:
    """How many times as long the next step may be as one of length h with this error."""
    safety = _SAFETY * (1 + 2 * _ITERATIONS) / (iterations + 2 * _ITERATIONS)
    factor: float = safety * max(error, 1e-10) ** -0.25
    if error <= 1.0 and carried.length > 0.0:
        foreseen = h / carried.length * (carried.error / max(error**2, 1e-20)) ** 0.25 * _SAFETY
        factor = min(factor, foreseen)
    return max(_LEAST, min(_MOST, factor))
