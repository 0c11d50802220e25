"""Limit cycles of diagrams."""

from __future__ import annotations

from typing import Any

from ..api.diagram import Diagram
from ..linear.limit_cycles import LimitCycle, LimitCycles
from ..linear.limit_cycles import limit_cycles as of_linearizer

__all__ = ["LimitCycle", "LimitCycles", "limit_cycles"]


def limit_cycles(
    diagram: Diagram,
    *,
    omega: tuple[float, float] | None = None,
    amplitude: tuple[float, float] = (1e-9, 1e3),
    **point: Any,
) -> LimitCycles:
    """The limit cycles of a diagram around an operating point, by harmonic balance, with their stability.

    omega: where to look, in rad/s (from the poles, unless given). amplitude: of the signal of the first law, in SI.
    point: what `Diagram.linearizer` takes (at, held, parameters, ...). Of a sampled diagram also the cycle of two
    periods, which is exact. Raises AnalysisError: E704 (a law that moves the mean), E705 (no law in a loop, or a point
    at which what stands between the laws is not at rest).
    """
    return of_linearizer(diagram.linearizer(**point), omega=omega, amplitude=amplitude)
