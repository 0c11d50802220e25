"""Two masses, lags and switches as blocks that a master couples, and what comes out exactly."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from blocks import (
    Block,
    Discrete,
    Input,
    Parameter,
    State,
    crossing,
    output,
)
from blocks.results.results import Results

Array = np.ndarray[Any, Any]
ALGORITHMS = ("jacobi", "gauss-seidel", "iterated")
TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


class Displaced(Block):
    """m x'' = -c x - d x' + F"""

    m = Parameter(1.0)
    c = Parameter(1.0)
    d = Parameter(0.1)
    F = Input()
    x = State(1.0, output=True)
    v = State(output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v, F, m, c, d):
        return (-c * x - d * v + F) / m


class Forced(Block):
    """m x'' = -c x - d x' - F, F = cc (x - x1) + dc (x' - v1)"""

    m = Parameter(1.0)
    c = Parameter(1.0)
    d = Parameter(0.1)
    cc = Parameter(1.0)
    dc = Parameter(0.1)
    x1 = Input()
    v1 = Input()
    x = State(output=True)
    v = State(output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v, F, m, c, d):
        return (-c * x - d * v - F) / m

    @output
    def F(x, v, x1, v1, cc, dc):
        return cc * (x - x1) + dc * (v - v1)


MASSES = ("a.x", "a.v", "b.x", "b.v")
EXACT = np.array([-0.27690212153, 0.355902137226, -0.252306697377, -0.031922584126])
"""At t = 10, of x1, v1, x2, v2."""
HS = (0.1, 0.05, 0.025)
TABLE = {
    ("jacobi", 0): (1.039e-1, 4.814e-2, 2.323e-2),
    ("jacobi", 1): (7.390e-3, 1.868e-3, 4.686e-4),
    ("gauss-seidel", 0): (8.161e-2, 3.895e-2, 1.902e-2),
    ("gauss-seidel", 1): (5.814e-3, 1.445e-3, 3.597e-4),
    ("iterated", 1): (1.487e-3, 3.714e-4, 9.282e-5),
}
"""The largest error at t = 10, for the three H."""


def error_of(results: Results) -> float:
    return max(abs(float(results[name][-1]) - exact) for name, exact in zip(MASSES, EXACT, strict=True))


class First(Block):
    """x' = -0.9 x + 0.5 u, y = 3 x + u"""

    u = Input()
    x = State(1.0, output=True)

    @x.derivative
    def dx(x, u):
        return -0.9 * x + 0.5 * u

    @output
    def y(x, u):
        return 3 * x + u


class Second(Block):
    """x' = -x + 10 u, y = -31 x - 0.9 u"""

    u = Input()
    x = State(1.0, output=True)

    @x.derivative
    def dx(x, u):
        return -x + 10 * u

    @output
    def y(x, u):
        return -31 * x - 0.9 * u


AT_1 = np.array([0.0859764038708439, 0.008392664839635064])
"""x(1) of the linear loop."""


def rows_at(results: Results, times: Array) -> Array:
    """The rows of the right values."""
    return np.searchsorted(results.t, times + 1e-9, side="right") - 1


class Lag(Block):
    """x' = u - x"""

    u = Input()
    x = State(output=True)

    @x.derivative
    def dx(x, u):
        return u - x


class Switching(Block):
    """on becomes 0 where u rises through 0.6, and 1 where it falls through 0.4."""

    u = Input()
    on = Discrete(1.0, output=True)

    @crossing(direction="up")
    def high(u):
        return u - 0.6

    @high.reset(on)
    def off():
        return 0.0

    @crossing(direction="down")
    def low(u):
        return u - 0.4

    @low.reset(on)
    def back():
        return 1.0


def switched_at(n: int) -> list[float]:
    """Off after ln 2.5, then on and off again after ln 1.5 each."""
    return [math.log(2.5) + k * math.log(1.5) for k in range(n)]
