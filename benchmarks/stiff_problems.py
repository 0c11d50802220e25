"""Stiff test problems as blocks; c/stiff.c has the same for CVODE.

References: Hairer and Wanner, Solving Ordinary Differential Equations II, IV.1 and IV.10 (Robertson, HIRES, van der
Pol, E5); F. Mazzia, C. Magherini, Test Set for Initial Value Problem Solvers, Bari 2008 (pollution, ring modulator).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from blocks import Block, Diagram, Input, Parameter, State
from blocks.library import Constant

__all__ = ["PROBLEMS", "Cell", "Problem", "chain"]

CONDUCTION, RADIATION = 1e5, 1.0
Rates = Callable[[Any, Any], Any]


def _system(rates: Rates, start: Sequence[float]) -> Diagram:
    """A diagram of one block with the states x, whose rates are a function of t and x."""
    size = len(start)

    class System(Block):
        x = State(shape=size, output=True)

        @x.initial  # type: ignore[untyped-decorator]
        def begins() -> Any:
            return np.array(start)

        @x.derivative  # type: ignore[untyped-decorator]
        def dx(t: Any, x: Any) -> Any:
            return rates(t, [x[i] for i in range(size)])

    diagram = Diagram(rates.__name__, library=System)
    diagram.add("b", System())
    return diagram


def robertson(t: Any, x: Any) -> list[Any]:
    slow, fast = -0.04 * x[0] + 1e4 * x[1] * x[2], 3e7 * x[1] * x[1]
    return [slow, -slow - fast, fast]


def hires(t: Any, x: Any) -> list[Any]:
    r = 280.0 * x[5] * x[7]
    return [
        -1.71 * x[0] + 0.43 * x[1] + 8.32 * x[2] + 0.0007,
        1.71 * x[0] - 8.75 * x[1],
        -10.03 * x[2] + 0.43 * x[3] + 0.035 * x[4],
        8.32 * x[1] + 1.71 * x[2] - 1.12 * x[3],
        -1.745 * x[4] + 0.43 * x[5] + 0.43 * x[6],
        -r + 0.69 * x[3] + 1.71 * x[4] - 0.43 * x[5] + 0.69 * x[6],
        r - 1.81 * x[6],
        -r + 1.81 * x[6],
    ]


# The reactions of the pollution model: constant, reactants, and by how many each species grows.
_K = (
    0.35, 26.6, 12300, 0.00086, 0.00082, 15000, 0.00013, 24000, 16500, 9000, 0.022, 12000, 1.88, 16300, 4.8e6, 0.00035,
    0.0175, 1e8, 4.44e11, 1240, 2.1, 5.78, 0.0474, 1780, 3.12,
)  # fmt: skip
_REACTANTS = (
    (0,), (1, 3), (4, 1), (6,), (6,), (6, 5), (8,), (8, 5), (10, 1), (10, 0), (12,), (9, 1), (13,), (0, 5), (2,), (3,),
    (3,), (15,), (15,), (16, 5), (18,), (18,), (0, 3), (18, 0), (19,),
)  # fmt: skip
_MADE = (
    {0: -1, 9: -1, 13: -1, 22: -1, 23: -1, 1: 1, 2: 1, 8: 1, 10: 1, 11: 1, 21: 1, 24: 1},
    {1: -1, 2: -1, 8: -1, 11: -1, 0: 1, 20: 1}, {14: -1, 0: 1, 16: 1, 18: 1, 21: 1},
    {1: -1, 15: -1, 16: -1, 22: -1, 14: 1}, {2: -1, 3: 2, 5: 1, 6: 1, 12: 1, 19: 1},
    {5: -1, 7: -1, 13: -1, 19: -1, 2: 1, 17: 2}, {3: -1, 4: -1, 5: -1, 12: 1}, {3: 1, 4: 1, 5: 1, 6: 1},
    {6: -1, 7: -1}, {11: -1, 6: 1, 8: 1}, {8: -1, 9: -1, 7: 1, 10: 1}, {8: 1}, {10: -1, 9: 1}, {12: -1, 11: 1},
    {13: 1}, {17: -1, 18: -1, 15: 1}, {19: -1}, {19: 1}, {20: -1, 21: -1, 23: -1, 22: 1, 24: 1}, {24: -1, 23: 1},
)  # fmt: skip


def pollution(t: Any, x: Any) -> list[Any]:
    r = [k * math.prod(x[i] for i in own) for k, own in zip(_K, _REACTANTS, strict=True)]
    return [sum(count * r[i] for i, count in made.items()) for made in _MADE]


def e5(t: Any, x: Any) -> list[Any]:
    a, b, c, d = 7.89e-10 * x[0], 1.1e7 * x[0] * x[2], 1.13e9 * x[1] * x[2], 1.13e3 * x[3]
    return [-a - b, a - c, (a - c) - (b - d), b - d]


def ring_modulator(t: Any, x: Any) -> list[Any]:
    two = 2.0 * np.sin(20000.0 * math.pi * t)
    voltages = (
        x[2] - x[4] - x[6] - two, -x[3] + x[5] - x[6] - two, x[3] + x[4] + x[6] + two, -x[2] - x[5] + x[6] + two,
    )  # fmt: skip
    q = [40.67286402e-9 * (np.exp(17.7493332 * u) - 1.0) for u in voltages]
    return [
        (x[7] - 0.5 * x[9] + 0.5 * x[10] + x[13] - x[0] / 25000.0) / 1.6e-8,
        (x[8] - 0.5 * x[11] + 0.5 * x[12] + x[14] - x[1] / 25000.0) / 1.6e-8,
        (x[9] - q[0] + q[3]) / 2e-12,
        (-x[10] + q[1] - q[2]) / 2e-12,
        (x[11] + q[0] - q[2]) / 2e-12,
        (-x[12] - q[1] + q[3]) / 2e-12,
        (-x[6] / 50.0 + q[0] + q[1] - q[2] - q[3]) / 1e-8,
        -x[0] / 4.45,
        -x[1] / 4.45,
        (0.5 * x[0] - x[2] - 17.3 * x[9]) / 5e-4,
        (-0.5 * x[0] + x[3] - 17.3 * x[10]) / 5e-4,
        (0.5 * x[1] - x[4] - 17.3 * x[11]) / 5e-4,
        (-0.5 * x[1] + x[5] - 17.3 * x[12]) / 5e-4,
        (-x[0] + 0.5 * np.sin(2000.0 * math.pi * t) - 86.3 * x[13]) / 0.002,
        (-x[1] - 636.3 * x[14]) / 0.002,
    ]


def drive(t: Any, x: Any) -> list[Any]:
    """An amplifier of 1e-6 s, current, speed, position, and a position controller with an integral."""
    e = np.sin(5.0 * t) - x[3]
    return [
        (40.0 * e + 30.0 * x[4] - 1.5 * x[2] - x[0]) / 1e-6,
        (x[0] - 0.8 * x[1] - 0.05 * x[2]) / 2e-3,
        (0.05 * x[1] - 1e-4 * x[2] - 2e-3 * np.tanh(x[2] / 0.1)) / 1e-4,
        x[2],
        e,
    ]


class Cell(Block):
    """A slice of a rod: dx/dt = c (left - 2 x + right) - r x^4."""

    c = Parameter(CONDUCTION, unit="1/s", doc="conduction to each side")
    r = Parameter(RADIATION, unit="1/s", doc="radiation")
    left = Input(doc="temperature of the slice before it")
    right = Input(doc="temperature of the slice behind it")
    x = State(output=True, doc="temperature")

    @x.derivative  # type: ignore[untyped-decorator]
    def dx(x: Any, left: Any, right: Any, c: Any, r: Any) -> Any:
        return c * (left - 2.0 * x + right) - r * x**4


def chain(count: int, conduction: float = CONDUCTION) -> Diagram:
    """A rod of so many slices, its ends held at 1 and 0."""
    diagram = Diagram("rod", library=Cell)
    hot, cold = diagram.add("hot", Constant(value=1.0)), diagram.add("cold", Constant(value=0.0))
    cells = [diagram.add(f"cell{k}", Cell(c=conduction)) for k in range(count)]
    for k, cell in enumerate(cells):
        diagram.wire(cell.left, cells[k - 1].x if k else hot.y)
        diagram.wire(cell.right, cells[k + 1].x if k + 1 < count else cold.y)
    return diagram


def _rod(count: int) -> Rates:
    """Its rates by hand, on arrays."""

    def rates(t: Any, x: Any) -> Any:
        made = -2.0 * x
        made[1:] += x[:-1]
        made[:-1] += x[1:]
        made[0] += 1.0
        return _conduction(count) * made - RADIATION * x**4

    return rates


def _conduction(count: int) -> float:
    return CONDUCTION * (count / 1000) ** 2


def _van_der_pol(mu: float) -> Rates:
    def van_der_pol(t: Any, x: Any) -> list[Any]:
        return [x[1], mu * (1.0 - x[0] * x[0]) * x[1] - x[0]]

    return van_der_pol


@dataclass(frozen=True)
class Problem:
    """name: as c/stiff.c has it. atol: for each unit of rtol. floor: of the size of a state, as a part of the largest.
    tight: the rtol of the states that count as exact. runs: of which the fastest counts. rod: how many slices, if it is
    one. in_scipy: whether SciPy's Radau solves it within seconds."""

    name: str
    rates: Rates
    start: Sequence[float]
    stop: float
    atol: float
    floor: float = 1e-3
    tight: float = 1e-11
    runs: int = 20
    rod: int = 0
    in_scipy: bool = True

    @property
    def log(self) -> list[str]:
        return [f"cell{k}.x" for k in range(self.rod)] if self.rod else ["b.x"]

    def made(self) -> Diagram:
        return chain(self.rod, _conduction(self.rod)) if self.rod else _system(self.rates, self.start)


PROBLEMS = (
    Problem("robertson", robertson, [1.0, 0, 0], 1e11, 1e-8, floor=0.0),
    Problem("hires", hires, [1.0, 0, 0, 0, 0, 0, 0, 0.0057], 321.8122, 1e-4),
    Problem("pollution", pollution, [0, 0.2, 0, 0.04, 0, 0, 0.1, 0.3, 0.01, *[0] * 7, 0.007, 0, 0, 0], 60.0, 1e-4),
    Problem("van der Pol 1e3", _van_der_pol(1e3), [2.0, 0.0], 2000.0, 1.0),
    Problem("van der Pol 1e6", _van_der_pol(1e6), [2.0, 0.0], 2e6, 1.0, tight=3e-10),
    Problem("e5", e5, [1.76e-3, 0, 0, 0], 1e13, 1e-19, floor=1e-15),
    Problem("ring modulator", ring_modulator, [0.0] * 15, 1e-3, 1e-2, runs=1, tight=1e-10, in_scipy=False),
    Problem("drive", drive, [0.0] * 5, 2.0, 1e-2),
    Problem("rod 200", _rod(200), [0.0] * 200, 1.0, 1e-3, runs=3, rod=200),
    Problem("rod 1000", _rod(1000), [0.0] * 1000, 1.0, 1e-3, runs=3, rod=1000, in_scipy=False),
)
