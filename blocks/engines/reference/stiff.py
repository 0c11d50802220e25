"""The stiff method: Radau IIA of order 5 by SciPy, one accepted step at a time, with the exact Jacobian of the Plan.

Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ...compile.jacobian import PlanJacobian
from ...compile.plan import Plan
from ...text.errors import BlocksError
from .methods import Rates
from .python_code import CompiledPrograms

__all__ = ["Radau", "Slopes", "flow"]

Array = np.ndarray[Any, Any]
Jacobian = Callable[[float, Array], Any]
"""d(rates)/dx at (t, x): an array or a scipy.sparse matrix, (n, n)."""

# SuperLU overtakes LAPACK from 60 to 80 states on where a matrix is tridiagonal. With 10 % of all entries, scattered,
# it fills them all in and never does.
_SPARSE_FROM, _SPARSE_DENSITY = 80, 0.05


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

    def at(self, memory: Sequence[Any], rates: Callable[[Array], Array]) -> Any:
        """The matrix where memory is (t, x, d, s, p, u, k, h, z).

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
        return jacobian.matrix() if self.is_sparse else jacobian.dense()


_MADE: WeakKeyDictionary[CompiledPrograms, Slopes] = WeakKeyDictionary()


@dataclass(frozen=True)
class _Dense:
    """SciPy's dense output, asked by theta."""

    t0: float
    h: float
    output: Any

    def __call__(self, theta: Array) -> Array:
        return np.asarray(self.output(self.t0 + theta * self.h).T)


class Radau:
    """An integration from (t, x) that nothing disturbs until t_end.

    h: the first step (0: none known). longest: no step is longer. Raises ArithmeticError where it fails.
    """

    def __init__(
        self,
        rates: Rates,
        jacobian: Jacobian,
        t: float,
        x: Array,
        t_end: float,
        *,
        rtol: float,
        atol: Array,
        h: float,
        longest: float,
    ) -> None:
        from scipy.integrate import Radau as Method

        first = min(h, t_end - t) if h > 0 else None
        self.end, self.proposed = t_end, h
        options = {"rtol": rtol, "atol": atol, "first_step": first, "max_step": longest, "jac": jacobian}
        try:
            self.solver = Method(rates, t, x, t_end, **options)
        except ValueError as error:  # NaN among the rates
            raise ArithmeticError(str(error)) from None

    def step(self) -> tuple[_Dense, float, Array]:
        """One accepted step: dense output, its end, the states there. Raises ArithmeticError where it fails."""
        try:
            message = self.solver.step()
        except BlocksError:
            raise
        except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:  # NaN or a zero pivot in its linear algebra
            raise ArithmeticError(str(error)) from None
        if self.solver.status == "failed":
            raise ArithmeticError(message)
        t0, t1 = float(self.solver.t_old), float(self.solver.t)
        h = float(self.solver.h_abs)
        # Of a step that the end cut short, the proposal before it still counts.
        self.proposed = h if t1 < self.end else max(h, self.proposed)
        return _Dense(t0, t1 - t0, self.solver.dense_output()), t1, np.array(self.solver.y)


def flow(
    rates: Rates,
    jacobian: Jacobian,
    t: float,
    x: Array,
    t_end: float,
    *,
    rtol: float,
    atol: Array,
    h: float,
    longest: float,
) -> Array:
    """The states at t_end, in as many steps as it takes."""
    if t_end <= t:
        return x
    run = Radau(rates, jacobian, t, x, t_end, rtol=rtol, atol=atol, h=h, longest=longest)
    while run.solver.status == "running":
        _, _, x = run.step()
    return x
