"""What grows beyond the doubles is told as an overflow, and what is undefined as that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from blocks import Block, Constant, Diagram, Discrete, Input, Integrator, Parameter, Power, Ramp, State, output
from blocks.text.errors import NOT_FINITE, OVERFLOW, SimulationError

ENGINES = pytest.mark.parametrize("engine", ["reference", "native"])


class Cubed(Block):
    """d = d^3 at each tick."""

    period = Parameter(0.1, unit="s")
    d = Discrete(3.0, output=True, visible="after")

    @d.next(every=period)
    def following(d):
        return d * d * d


class Exponential(Block):
    """y = exp(u)."""

    u = Input()

    @output
    def y(u):
        return np.exp(u)


class Growing(Block):
    """dx = 1000 x."""

    x = State(1.0, output=True)

    @x.derivative
    def dx(x):
        return 1000.0 * x


class Law(Block):
    """y = 1 / u, or its logarithm."""

    is_log = Parameter(False, structural=True, type="bool")
    u = Input()

    @output
    def y(u, is_log):
        return np.log(u) if is_log else 1.0 / u


def alone(block: Block) -> Diagram:
    diagram = Diagram("grows")
    diagram.add("b", block)
    return diagram


def behind(block: Block, source: Block) -> Diagram:
    diagram = Diagram("grows")
    made, given = diagram.add("b", block), diagram.add("source", source)
    diagram.wire(made.u, given.y)
    return diagram


def squares() -> Diagram:
    diagram = Diagram("grows")
    x, power = diagram.add("x", Integrator(y_start=1.0)), diagram.add("b", Power(exponent=2))
    diagram.wire(x.u, power.y)
    diagram.wire(power.u, x.y)
    return diagram


LARGEST = np.log(np.finfo(float).max)
OVERFLOWS: dict[str, tuple[Callable[[], Diagram], str, float, dict[str, Any]]] = {
    # 3^(3^n) is beyond 1.8e308 from n = 6 on: the tick of 0.5 s is the sixth. Then the place, the time, the settings.
    "sampled": (lambda: alone(Cubed()), "b.d", 0.5, {}),
    "exp": (lambda: behind(Exponential(), Ramp(slope=1000.0)), "b.y", LARGEST / 1000.0, {}),
    "dopri5": (lambda: alone(Growing()), "b.x", LARGEST / 1000.0, {}),
    "rk4": (lambda: alone(Growing()), "b.x", 1.1, {"method": "rk4", "step": 0.01}),
    # x grows by its square: x(k + 1) = x + 0.1 x^2.
    "euler": (squares, "b.y", 2.1, {"method": "euler", "step": 0.1}),
}


@ENGINES
@pytest.mark.parametrize("name", OVERFLOWS)
def test_an_overflow_is_told_as_one_where_it_began(name: str, engine: str) -> None:
    make, place, t, settings = OVERFLOWS[name]
    with pytest.raises(SimulationError) as told:
        make().run(stop=10.0, engine=engine, **settings)
    fault = told.value.faults[0]
    assert (fault.code, fault.place) == ("E303", place)
    assert OVERFLOW in fault.cure
    assert "division" not in fault.cure
    assert told.value.results.t[-1] == pytest.approx(t, abs=0.2)


@ENGINES
@pytest.mark.parametrize("is_log", [False, True])
def test_what_is_undefined_is_told_as_that(is_log: bool, engine: str) -> None:
    with pytest.raises(SimulationError) as told:
        behind(Law(is_log=is_log), Constant(value=0.0)).run(stop=1.0, engine=engine)
    fault = told.value.faults[0]
    assert (fault.code, fault.place) == ("E303", "b.y")
    assert NOT_FINITE in fault.cure
