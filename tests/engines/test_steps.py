"""What is done after each step of the solver: `every="step"`."""

import math
from typing import Any

import numpy as np
import pytest

from blocks import Block, Diagram, Discrete, Input, Parameter, Pulse, Sine, State, crossing, output
from blocks.text.errors import SimulationError


class Rotor(Block):
    """A rotation as a complex number of length 1, which is brought back to it after each step."""

    omega = Parameter(3.0)
    z = State(shape=2, output=True)

    @z.initial
    def begins():  # type: ignore[no-untyped-def]
        return np.array([1.0, 0.0])

    @z.derivative
    def dz(z, omega):  # type: ignore[no-untyped-def]
        return omega * np.stack([-z[1], z[0]])

    @z.next(every="step")
    def normalized(z):  # type: ignore[no-untyped-def]
        return z / np.sqrt(z @ z)


@pytest.mark.parametrize("settings", [{"method": "euler", "step": 0.01}, {}, {"method": "radau"}])
def test_a_state_can_be_projected(settings: dict[str, object]) -> None:
    d = Diagram("rotor")
    d.add("rotor", Rotor())
    results = d.run(stop=5.0, **settings)
    z = np.asarray(results["rotor.z"])
    assert np.hypot(z[:, 0], z[:, 1]) == pytest.approx(1.0, abs=1e-15)
    angle = np.unwrap(np.arctan2(z[:, 1], z[:, 0]))
    # Euler's angle per step is atan(omega h): the projection keeps the length and not the phase.
    expected = results.t / 0.01 * math.atan(0.03) if settings.get("method") == "euler" else 3.0 * results.t
    assert angle == pytest.approx(expected, abs=1e-4)


class Counted(Block):
    """How many steps there were, and the largest u at their ends."""

    u = Input()
    n = Discrete(output=True)
    top = Discrete(-10.0, output=True)

    @n.next(every="step")
    def one_more(n):  # type: ignore[no-untyped-def]
        return n + 1.0

    @top.next(every="step")
    def largest(top, u):  # type: ignore[no-untyped-def]
        return np.maximum(top, u)


def test_it_is_done_after_each_step_and_at_the_end_of_each_instant() -> None:
    d = Diagram("counted")
    counted, sine = d.add("counted", Counted()), d.add("sine", Sine())
    d.wire(counted.u, sine.y)
    results = d.run(stop=1.0, method="euler", step=0.25)
    # One at the instant of the start, four steps, one at the instant of the stop.
    assert results["counted.n"].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert results["counted.top"][-1] == math.sin(1.0)
    pulse = Diagram("pulse")
    counted, source = pulse.add("counted", Counted()), pulse.add("source", Pulse(on=0.5, off=0.75, height=7.0))
    pulse.wire(counted.u, source.y)
    assert pulse.run(stop=1.0, method="euler", step=0.25)["counted.top"][-1] == 7.0


class Catch(Block):
    """x rises; where it meets the bound a reset counts it, and the projection after the step moves the bound on."""

    x = State(output=True)
    bound = Discrete(0.5, output=True)
    hits = Discrete(output=True)

    @x.derivative
    def dx():  # type: ignore[no-untyped-def]
        return 1.0

    @crossing(direction="up")
    def meets(x, bound):  # type: ignore[no-untyped-def]
        return x - bound

    @meets.reset(hits)
    def counts(hits):  # type: ignore[no-untyped-def]
        return hits + 1.0

    @bound.next(every="step")
    def moves_on(x, bound):  # type: ignore[no-untyped-def]
        return np.where(x >= bound, bound + 0.5, bound)


def test_what_a_step_has_crossed_fires_before_it_is_projected_away() -> None:
    d = Diagram("catch")
    d.add("catch", Catch())
    results = d.run(stop=1.75)
    assert results["catch.hits"][-1] == 3.0
    assert [event.t for event in results.events] == pytest.approx([0.5, 1.0, 1.5], abs=1e-14)


class Broken(Block):
    """A projection that divides by zero after 0.5 s."""

    d = Discrete(1.0, output=True)

    @d.next(every="step")
    def fails(t):  # type: ignore[no-untyped-def]
        return 1.0 / np.where(t > 0.5, 0.0, 1.0)


def test_a_projection_that_is_not_finite_names_the_block() -> None:
    d = Diagram("broken")
    d.add("broken", Broken())
    with pytest.raises(SimulationError, match=r"E303 broken\.d: became inf after the step to t = "):
        d.run(stop=1.0)


class Reader(Block):
    """An unsampled output may read what changes after steps only."""

    d = Discrete()

    @d.next(every="step")
    def now(t):  # type: ignore[no-untyped-def]
        return t

    @output
    def y(t, d):  # type: ignore[no-untyped-def]
        return t - d


def test_inside_a_step_the_value_from_its_start_is_seen() -> None:
    d = Diagram("reader")
    d.add("reader", Reader())
    results = d.run(stop=1.0, method="euler", step=0.25, every=0.125)
    assert results["reader.y"].tolist() == [0.0, 0.125, 0.0, 0.125, 0.0, 0.125, 0.0, 0.125, 0.0]


@pytest.mark.parametrize("change", [lambda m: m + 1.0, lambda m: m + 0.1 * (5.0 - m)])
def test_what_changes_with_every_step_however_short_is_an_error(change: Any) -> None:
    class Average(Block):
        """A filter by steps, which has no meaning of its own."""

        m = Discrete(output=True)
        x = State()

        @x.derivative
        def dx(x):  # type: ignore[no-untyped-def]
            return -x

        @m.next(every="step")
        def following(m):  # type: ignore[no-untyped-def]
            return change(m)

    d = Diagram("average")
    d.add("average", Average())
    with pytest.raises(SimulationError, match=r"E301 average\.m: at t = 0\.0 s it changes with every step"):
        d.run(stop=1.0)
    assert d.run(stop=1.0, method="rk4", step=0.1).t[-1] == 1.0
