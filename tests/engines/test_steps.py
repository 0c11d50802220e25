"""What is done after each step of the solver: `every="step"`."""

import math
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Diagram,
    Discrete,
    Input,
    Parameter,
    Pulse,
    RateLimiter,
    Relay,
    Sine,
    State,
    TransportDelay,
    ZeroOrderHold,
    crossing,
    output,
)
from blocks.compile.toolchain.compiler import find_compiler
from blocks.text.errors import SimulationError

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=needs_compiler)]


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


class Caught(Block):
    """x meets a bound that moves on after the step, and the reset that counts it reads the bound."""

    x = State(output=True)
    bound = Discrete(0.5)
    sum = Discrete(output=True)

    @x.derivative
    def dx():  # type: ignore[no-untyped-def]
        return 1.0

    @crossing(direction="up")
    def meets(x, bound):  # type: ignore[no-untyped-def]
        return x - bound

    @meets.reset(sum)
    def adds(sum, bound):  # type: ignore[no-untyped-def]
        return sum + 1.0 / (2.0 - bound)

    @bound.next(every="step")
    def moves_on(x, bound):  # type: ignore[no-untyped-def]
        return np.where(x >= bound, bound + 0.5, bound)


@pytest.mark.parametrize("engine", ENGINES)
def test_resets_see_what_the_end_of_the_step_was_replaced_by(engine: str) -> None:
    """As at a tick or an event time: 1/(2 - 1) at 0.5 s, 1/(2 - 1.5) at 1 s, and a division by 0 at 1.5 s."""
    d = Diagram("caught")
    d.add("caught", Caught())
    assert d.run(stop=1.25, engine=engine)["caught.sum"][-1] == 3.0
    with pytest.raises(SimulationError, match=r"E303 caught\.sum: is reset to inf at t = 1\.5"):
        d.run(stop=1.75, engine=engine)


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
    with pytest.raises(SimulationError, match=r"E301 average\.m: at t = 0\.0 s it changes at every step"):
        d.run(stop=1.0)
    assert d.run(stop=1.0, method="rk4", step=0.1).t[-1] == 1.0


class Way(Block):
    """The length of the way that u has gone, jumps included."""

    u = Input()
    way = Discrete(output=True)
    last = Discrete()

    @last.initial
    def begins(u):  # type: ignore[no-untyped-def]
        return u

    @last.next(every="step")
    def here(u):  # type: ignore[no-untyped-def]
        return u

    @way.next(every="step")
    def longer(way, last, u):  # type: ignore[no-untyped-def]
        return way + abs(u - last)


class Saw(Block):
    """y rises by 1 in a second, and falls to 0 where it meets 1."""

    y = State(output=True)

    @y.derivative
    def dy():  # type: ignore[no-untyped-def]
        return 1.0

    @crossing(direction="up")
    def falls(y):  # type: ignore[no-untyped-def]
        return y - 1.0

    @falls.reset(y)
    def to_zero():  # type: ignore[no-untyped-def]
        return 0.0


METHODS = [{}, {"method": "radau"}, {"method": "rk4", "step": 0.3}]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("settings", METHODS)
def test_a_step_that_ends_at_a_crossing_of_another_block_is_projected_before_that_fires(
    engine: str, settings: dict[str, Any]
) -> None:
    """A saw goes 3.5 up in 3.5 s, and jumps down by 1 three times."""
    d = Diagram("saw")
    saw, way = d.add("saw", Saw()), d.add("way", Way())
    d.wire(way.u, saw.y)
    results = d.run(stop=3.5, engine=engine, **settings)
    assert len(results.events) == 3
    assert results["way.way"][-1] == pytest.approx(6.5, abs=1e-12)


def switched(kind: str) -> tuple[Diagram, dict[str, Any]]:
    """A RateLimiter follows what jumps from 0 to 2 at 1 s and back at 4 s, where steps end for this reason."""
    d = Diagram("switched")
    q = d.add("q", RateLimiter(rising=0.2))
    if kind == "crossing":
        wave, bound = d.add("wave", Sine(omega=math.pi / 3)), math.sin(math.pi / 3)
        relay = d.add("relay", Relay(on_at=bound, off_at=-bound, on=2.0, off=0.0))
        d.wire(relay.u, wave.y)
        d.wire(q.u, relay.y)
    elif kind == "event time":
        d.wire(q.u, d.add("source", Pulse(on=1.0, off=4.0, height=2.0)).y)
    elif kind == "tick":
        source, hold = d.add("source", Pulse(on=0.5, off=3.5, height=2.0)), d.add("hold", ZeroOrderHold(period=1.0))
        d.wire(hold.u, source.y)
        d.wire(q.u, hold.y)
    elif kind == "delay":
        delay = d.add("delay", TransportDelay(delay=0.75))
        d.wire(delay.u, d.add("source", Pulse(on=0.25, off=3.25, height=2.0)).y)
        d.wire(q.u, delay.y)
    else:
        d.wire(q.u, d.input("u"))
        return d, {"inputs": {"u": ([0.0, 1.0, 4.0], [0.0, 2.0, 0.0], "hold")}}
    return d, {}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["crossing", "event time", "tick", "delay", "input"])
def test_whatever_ends_a_step_a_limiter_has_reached_what_it_could_by_then(engine: str, kind: str) -> None:
    """0.2 3 = 0.6 at 4 s, and 0.5 half a second later, by steps of 0.7 s."""
    d, given = switched(kind)
    results = d.run(stop=4.5, engine=engine, method="rk4", step=0.7, every=0.5, **given)
    assert results["q.y"][8:] == pytest.approx([0.6, 0.5], abs=1e-12)
