"""A linear model from signals to signals: its matrices, and how they came about.

Text and analyses take it as it is; who asks for a model in Python gets a `LinearModel`, for which python-control is
loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..text.arrays import Array
from ..text.errors import Fault
from .model_report import BlockReport


@dataclass(frozen=True, eq=False)
class Transfer:
    """dx/dt = A x + B u, y = C x + D u (or x(k+1) = ... where dt is a period in s), in SI units.

    states: their names; signals: the names of the inputs and of the outputs in the diagram; units: theirs. name: of the
    diagram. report, hint, fragile: as of `LinearModel`.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float
    states: Sequence[str]
    signals: tuple[Sequence[str], Sequence[str]]
    units: tuple[Sequence[str], Sequence[str]] = ((), ())
    name: str = ""
    report: tuple[BlockReport, ...] = ()
    hint: str = ""
    fragile: Callable[[], Fault | None] | None = None

    @property
    def nstates(self) -> int:
        return len(self.A)

    @property
    def noutputs(self) -> int:
        return len(self.D)

    @property
    def ninputs(self) -> int:
        return int(self.D.shape[1])

    def closed(self) -> Transfer:
        """Of a loop transfer L: T = L/(1 + L), or of a matrix (I + L)^-1 L."""
        B, C, D = self.B, self.C, self.D
        K = np.linalg.inv(np.eye(len(D)) + D)
        A, B, C, D = self.A - B @ K @ C, B @ K, K @ C, K @ D
        return Transfer(A, B, C, D, self.dt, self.states, self.signals, self.units, report=self.report)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoopOfRates(Transfer):
    """The loop transfer at one signal of a diagram of several rates. point, times: as of `LiftedLoop`."""

    point: str
    times: tuple[float, ...]
