"""Rates that jump to and fro without a crossing, which no step can follow; and what is only slow, and goes on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import blocks.engines.reference.chattering as module
from blocks import Block, Diagram, Integrator, Parameter, Relay, State
from blocks.text.errors import SimulationError

ENGINES = pytest.mark.parametrize("engine", ["reference", "native"])


def of(block: Block) -> Diagram:
    diagram = Diagram("slides")
    diagram.add("b", block)
    return diagram


class Sliding(Block):
    """dx = -10 sign(x): it reaches 0 at x_start / 10, and stays there."""

    calm = State(0.0)
    x = State(1.0, output=True)

    @x.derivative
    def dx(x):
        return -10.0 * np.sign(x)

    @calm.derivative
    def dcalm(t):
        return np.cos(t)


class Stick(Block):
    """A mass on a spring, and dry friction that holds it once it has come to rest."""

    x = State(0.0, output=True)
    v = State(1.0, output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v):
        return -3.0 * x - 2.0 * np.sign(v)


@ENGINES
def test_chattering_ends_early_and_names_the_state(engine: str) -> None:
    with pytest.raises(SimulationError) as told:
        of(Sliding()).run(stop=1.0, engine=engine)
    fault, results = told.value.faults[0], told.value.results
    assert (fault.code, fault.place) == ("E301", "b.x")
    assert "chatters at t = 0.100" in fault.message
    assert "crossing" in fault.cure
    assert results.statistics.steps < 50_000
    assert results.t[-1] == pytest.approx(0.1, abs=1e-3)
    assert results["b.x"] == pytest.approx(np.maximum(1.0 - 10.0 * results.t, 0.0), abs=1e-6)


@ENGINES
def test_a_mass_that_sticks_chatters_where_it_comes_to_rest(engine: str) -> None:
    with pytest.raises(SimulationError) as told:
        of(Stick()).run(stop=3.0, engine=engine)
    fault, results = told.value.faults[0], told.value.results
    assert (fault.code, fault.place) == ("E301", "b.v")
    # x = (2/3) (cos(w t) - 1) + sin(w t) / w, w = sqrt(3), turns where tan(w t) = 3 / (2 w).
    w = math.sqrt(3.0)
    assert results.t[-1] == pytest.approx(math.atan(1.5 / w) / w, rel=1e-3)


def test_both_engines_say_the_same() -> None:
    said = []
    for engine in ("reference", "native"):
        with pytest.raises(SimulationError) as told:
            of(Sliding()).run(stop=1.0, engine=engine)
        said.append((told.value.faults[0].message.split(" at t")[0], told.value.faults[0].cure.split(" Results")[0]))
    assert said[0] == said[1]


def test_what_the_error_says_is_the_cure() -> None:
    diagram = Diagram("relay")
    x = diagram.add("x", Integrator(y_start=1.0))
    relay = diagram.add("relay", Relay(on_at=0.01, off_at=-0.01, on=-10, off=10))
    diagram.wire(x.u, relay.y)
    diagram.wire(relay.u, x.y)
    results = diagram.run(stop=1.0)
    assert abs(results["x.y"][-1]) <= 0.01 + 1e-9


def smooth(law: Callable[..., Any], start: float = 1.0) -> Block:
    class Law(Block):
        """dx = law(x, t)."""

        x = State(start, output=True)

        @x.derivative
        def dx(x, t):
            return law(x, t)

    return Law()


class Vdp(Block):
    """The equation of van der Pol, far stiffer than dopri5 is made for."""

    mu = Parameter(1e8)
    x = State(2.0, output=True)
    v = State(0.0, output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v, mu):
        return mu * ((1 - x * x) * v - x)


SLOW: dict[str, tuple[Block, float, Callable[[float], float], float]] = {
    # The block, how far it goes, the truth there, and how near it comes.
    "stiff": (smooth(lambda x, t: -1e8 * (x - np.cos(t))), 1e-3, math.cos, 1e-5),
    # A jump of time is passed, however many there are.
    "jumps of time": (
        smooth(lambda x, t: -1e8 * (x - np.sign(np.sin(3e4 * t)))),
        5e-4,
        lambda t: math.copysign(1.0, math.sin(3e4 * t)),
        1e-5,
    ),
    # Between x and the jump lies what is smooth: tanh has its equilibrium within 1e-8 of 0.
    "smoothed sign": (smooth(lambda x, t: -10.0 * np.tanh(x / 1e-8) + 5.0, 1e-3), 1e-3, lambda t: 5.493e-9, 1e-8),
    # Steep at 0, where it rests.
    "steep": (smooth(lambda x, t: -10.0 * np.abs(x) ** 0.25 * np.sign(x), 1e-6), 1e-3, lambda t: 0.0, 1e-8),
    # From stair to stair downwards, on each at 2e-3 or 3e-3: 2.4e-3 on the whole.
    "stairs": (smooth(lambda x, t: -1e-3 * (2.0 + np.floor(x * 1e6) % 2), 0.0), 0.05, lambda t: -2.4e-3 * t, 2e-6),
}


@pytest.mark.parametrize("name", SLOW)
def test_what_is_slow_but_no_chattering_goes_on(name: str) -> None:
    block, until, truth, near = SLOW[name]
    run = of(block).start(stop=1e3, rtol=1e-9, atol=1e-12, engine="native")
    run.advance_to(until)
    assert run.results["b.x"][-1] == pytest.approx(truth(until), abs=near)


@ENGINES
def test_a_stiff_model_is_looked_at_and_goes_on(engine: str) -> None:
    run = of(Vdp()).start(stop=1e3, engine=engine)
    run.advance_to(2e-5 if engine == "reference" else 1e-3)
    assert run.results.statistics.steps > 512
    assert run.results["b.v"][-1] == pytest.approx(-2.0 / 3.0, rel=1e-3)  # x / (1 - x^2), where x is 2


def test_looks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    for window in (16, 10**9):
        monkeypatch.setattr(module, "_WINDOW", window)
        run = of(Vdp()).start(stop=1e3, engine="reference")
        run.advance_to(1e-5)
        made.append((run.results.t.tolist(), run.results["b.v"].tolist()))
    assert made[0] == made[1]
