"""A linear model from signals to signals: its matrices, and how they came about.

Text and analyses take it as it is; who asks for a model in Python gets a `LinearModel`, for which python-control is
loaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .model_report import BlockReport

__all__ = ["LoopOfRates", "Transfer"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class Transfer:
    """dx/dt = A x + B u, y = C x + D u (or x(k+1) = ... where dt is a period in s), in SI units.

    matrices: A, B, C, D. states: their names; signals: the names of the inputs and of the outputs in the diagram;
    units: theirs. name: of the diagram. report, hint: as of `LinearModel`.
    """

    matrices: tuple[Array, Array, Array, Array]
    dt: float
    states: Sequence[str]
    signals: tuple[Sequence[str], Sequence[str]]
    name: str = ""
    report: tuple[BlockReport, ...] = ()
    units: tuple[Sequence[str], Sequence[str]] = ((), ())
    hint: str = ""

    @property
    def A(self) -> Array:
        return self.matrices[0]

    @property
    def B(self) -> Array:
        return self.matrices[1]

    @property
    def C(self) -> Array:
        return self.matrices[2]

    @property
    def D(self) -> Array:
        return self.matrices[3]

    @property
    def nstates(self) -> int:
        return len(self.matrices[0])

    @property
    def noutputs(self) -> int:
        return len(self.matrices[3])

    @property
    def ninputs(self) -> int:
        return int(self.matrices[3].shape[1])

    def closed(self) -> Transfer:
        """Of a loop transfer L: T = L/(1 + L)."""
        A, B, C, D = self.matrices
        K = np.linalg.inv(np.eye(len(D)) + D)
        matrices = (A - B @ K @ C, B @ K, K @ C, K @ D)
        told: dict[str, Any] = {"report": self.report, "units": self.units}
        return Transfer(matrices=matrices, dt=self.dt, states=self.states, signals=self.signals, **told)


@dataclass(frozen=True, eq=False, kw_only=True)
class LoopOfRates(Transfer):
    """The loop transfer at one signal of a diagram of several rates. point, times: as of `LiftedLoop`."""

    point: str
    times: tuple[float, ...]
