"""Corners: crossings of what an algebraic loop solves for.

If the loop reads their sides, these and the solution belong together. With the present sides the loop has one
solution, at which a crossing may show its other side; with that side it has another solution. Two things follow.

If both solutions lie at the corner itself, rounding decides which side each of them shows, and both may show the other
one. So a side is left only if the crossing is beyond the rounding of the solution, its slack.

If several corners lie between the last solution and the next one, the sides that a solution shows may be those of no
solution. Then the way is gone from corner to corner: on the straight line from the last solution to that with the
present sides, up to the first crossing; from there with its other side. If a loop is piecewise linear and monotone,
this ends at its solution.

References: J. Katzenelson, An algorithm for solving nonlinear resistor networks, Bell System Technical Journal 44
(1965); T. Fujisawa, E. S. Kuh, Piecewise-linear theory of nonlinear networks, SIAM Journal on Applied Mathematics 22
(1972).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from ...compile.plan import Plan
from .python_code import CompiledPrograms

MOST_CORNERS = 1000  # on the way to one solution
_SAFETY = 8.0  # times the rounding of the unknowns that a crossing reads: solutions are found to 4 times theirs
_WIDE = 2.0**20  # unknowns are moved by so many times their rounding, so that the crossings do not round much

Memory = tuple[Any, ...]
"""(t, x, d, s, p, u, k, h, z, FMUs), as programs read it."""
Z = 8


class Corners:
    """The corners of one Plan."""

    def __init__(self, plan: Plan, compiled: CompiledPrograms) -> None:
        nodes = [cause.node for cause in plan.crossings]
        self.numbers = plan.corners
        self.inner = plan.inner_corners
        self.crossings = compiled.program("crossings_given", nodes, given=True)
        self.resets = {
            j: compiled.program(f"reset_given_{j}", [node for node, _ in plan.crossings[j].resets], given=True)
            for j in plan.corners
            if plan.crossings[j].resets
        }
        self._rounding = compiled.program("rounding", plan.unknowns)

    def slack(self, memory: Memory) -> tuple[float, ...]:
        """By how much each crossing may be off by the rounding of the loops' solutions, which memory holds; 0 for those
        that are no corners."""
        z = memory[Z]
        slack = [0.0] * len(memory[3])
        if not all(map(math.isfinite, z)):
            return tuple(slack)
        values = self.crossings(*memory)
        for k, moved in enumerate(self._rounding(*memory)):
            if moved == 0.0:
                continue
            others = self.crossings(*at(memory, (*z[:k], z[k] + _WIDE * moved, *z[k + 1 :])))
            for j in self.numbers:
                off = abs(others[j] - values[j])
                if math.isfinite(off):
                    slack[j] += _SAFETY * off / _WIDE
        return tuple(slack)

    def is_near(self, z: Sequence[float], end: Sequence[float], memory: Memory) -> bool:
        """Whether z is the solution `end`, which memory holds, but for rounding."""
        moved = self._rounding(*memory)
        return all(abs(a - b) <= _SAFETY * off for a, b, off in zip(z, end, moved, strict=True))


def at(memory: Memory, z: Sequence[float]) -> Memory:
    """Memory with other solutions of loops."""
    return (*memory[:Z], tuple(z), *memory[Z + 1 :])


def first_change(
    changed: Callable[[tuple[float, ...]], bool], z0: Sequence[float], z1: Sequence[float]
) -> tuple[float, ...]:
    """The first point on the line from z0 to z1 that has changed, to the last bit; z1 has."""
    low, high, end = 0.0, 1.0, tuple(z1)

    def point(share: float) -> tuple[float, ...]:
        return tuple((1.0 - share) * a + share * b for a, b in zip(z0, z1, strict=True))

    if changed(point(0.0)):
        return point(0.0)
    while True:
        middle = (low + high) / 2
        if not low < middle < high or high - low < 2.0**-60:
            return end
        between = point(middle)
        if changed(between):
            high, end = middle, between
        else:
            low = middle
