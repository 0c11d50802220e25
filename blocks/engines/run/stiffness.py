"""Whether a run by dopri5 is stiff: stability keeps its steps short, and not the error.

The run itself is not asked: between its moments, and rarely, the largest eigenvalue of the Jacobian is estimated from a
few rates and compared with the mean step. That costs nothing inside a step and changes no bit of a result.

Reference: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2 (the edge of stability of dopri5 is at
h lambda = -3.3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ...text.arrays import Array
from ...text.errors import Fault

_FIRST, _PART = 2_000, 0.25  # steps before the first look, and between looks as a part of all before
_LOOKS = 3  # in a row that must find the run stiff
_LONG = 50_000  # steps since the last look after which one suffices: a short run in C has few looks
_MANY = 200_000  # steps left; fewer are no reason to take another method
_GAIN = 10  # a step as much longer must fit between instants and within the longest step
_VECTORS = 16  # of the Krylov space in which the eigenvalue is estimated
_PERTURBED = 0.1  # of what a state may be off by: small for the equations, large for rounding errors


@dataclass(frozen=True, slots=True)
class StateRates:
    """Where a run stands, for those who ask how stiff it is.

    names, x, weights: (n,), the states, and what each may be off by in a step. rates: those of other states, now.
    instants: how many there were. longest: the longest step in s.
    """

    names: tuple[str, ...]
    x: Array
    weights: Array
    rates: Callable[[Array], Array]
    instants: int
    longest: float


class _Asked(Protocol):
    @property
    def plan(self) -> Any: ...

    @property
    def t(self) -> float: ...

    @property
    def steps(self) -> int: ...

    def state_rates(self) -> StateRates | None: ...


class StiffWatch:
    """Looks at a run from time to time; `look` gives the warning W306, once."""

    def __init__(self, engine: _Asked) -> None:
        settings = engine.plan.settings
        self.is_over = settings.method != "dopri5" or settings.stop is None
        self.due = engine.steps + _FIRST
        self.steps, self.t, self.instants, self.count = engine.steps, engine.t, 0, 0

    def look(self, engine: _Asked) -> Fault | None:
        """The warning that this run is stiff, where that is found now."""
        if self.is_over or engine.steps < self.due:
            return None
        now = engine.state_rates()
        if now is None or not len(now.x):
            self.is_over = True
            return None
        t, stop, steps, instants = engine.t, float(engine.plan.settings.stop), engine.steps, now.instants
        taken, passed, h = steps - self.steps, instants - self.instants, (t - self.t) / (steps - self.steps)
        self.steps, self.t, self.instants, self.due = steps, t, instants, steps + max(1, int(_PART * steps))
        left = (stop - t) / h if h > 0 else math.inf
        # What cuts steps anyway would cut those of another method too.
        is_free = taken > _GAIN * passed and now.longest > _GAIN * h
        found = None
        if is_free and left > _MANY:
            with np.errstate(all="ignore"):
                found = _largest(now)
        if found is None or not (-5.0 < h * found[0].real < -2.0 and abs(h * found[0].imag) < 5.0):
            self.count = 0
            return None
        self.count += 1
        if self.count < _LOOKS and taken < _LONG:
            return None
        self.is_over = True
        message = (
            f"is stiff: at t = {t:.4g} s its time constant of {-1.0 / found[0].real:.2g} s keeps the steps of dopri5 "
            f"at {h:.2g} s, and the run needs {left:.1g} more of them up to {stop:g} s."
        )
        cure = 'Use a method for stiff models: --method radau, or auto ("method" in the file\'s "run").'
        return Fault("W306", now.names[found[1]], message, cure)


def _largest(now: StateRates) -> tuple[complex, int] | None:
    """The eigenvalue of the Jacobian with the largest magnitude, and the state that has the most of it.

    It is estimated by the method of Arnoldi with differences of rates. None if these are not finite.
    """
    n = len(now.x)
    first, count = now.rates(now.x), min(n, _VECTORS)
    vectors, projected = np.zeros((n, count + 1)), np.zeros((count + 1, count))
    start = np.cos(1.0 + np.arange(n))  # no symmetry of a model has it
    vectors[:, 0] = start / np.linalg.norm(start)
    for k in range(count):
        scale = _PERTURBED * now.weights
        slope = (now.rates(now.x + scale * vectors[:, k]) - first) / scale
        if not np.isfinite(slope).all():
            return None
        for i in range(k + 1):
            projected[i, k] = vectors[:, i] @ slope
            slope = slope - projected[i, k] * vectors[:, i]
        projected[k + 1, k] = np.linalg.norm(slope)
        if not np.isfinite(projected).all():
            return None
        if projected[k + 1, k] <= 1e-10 * np.abs(projected).max():
            count = k + 1
            break
        vectors[:, k + 1] = slope / projected[k + 1, k]
    values, own = np.linalg.eig(projected[:count, :count])
    largest = int(np.argmax(np.abs(values)))
    return complex(values[largest]), int(np.argmax(np.abs(vectors[:, :count] @ own[:, largest])))
