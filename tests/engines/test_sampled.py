"""Sampled blocks: what they see at a tick, in which order, and discrete controllers against SciPy."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import dlsim, lfilter

from blocks import (
    Block,
    Constant,
    Diagram,
    Discrete,
    Gain,
    Input,
    Parameter,
    Ramp,
    Results,
    Sine,
    State,
    Sum,
    TransferFunction,
    UnitDelay,
    ZeroOrderHold,
    output,
)

Array = np.ndarray[Any, Any]

RECURSION = 1e-12
"""Two ways to sum the same few hundred products."""


def after_ticks(results: Results, name: str, period: float, count: int) -> Array:
    """The right values of a signal at the first ticks."""
    times = np.arange(count) * period
    rows = np.searchsorted(results.t, times + 1e-9, side="right") - 1
    return np.asarray(results[name][rows])


def test_a_hold_keeps_the_value_at_its_tick_and_lets_it_through_at_once() -> None:
    diagram = Diagram("hold")
    source, hold, gain = (
        diagram.add("source", Sine(omega=3.0)),
        diagram.add("hold", ZeroOrderHold(period=0.25)),
        diagram.add("gain", Gain(k=2.0)),
    )
    diagram.wire(hold.u, source.y)
    diagram.wire(gain.u, hold.y)
    results = diagram.run(stop=2.0, every=0.01)
    ticks = np.floor(results.t / 0.25 + 1e-9) * 0.25
    right = np.append(np.diff(results.t) > 0, True)
    assert results["hold.y"][right] == pytest.approx(np.sin(3.0 * ticks)[right], abs=1e-15)
    assert np.array_equal(results["gain.y"], 2 * results["hold.y"])


def test_a_unit_delay_gives_the_value_of_the_tick_before() -> None:
    diagram = Diagram("delay")
    source, delay = diagram.add("source", Ramp()), diagram.add("delay", UnitDelay(period=0.25, y_start=-7.0))
    diagram.wire(delay.u, source.y)
    results = diagram.run(stop=2.0)
    assert after_ticks(results, "delay.y", 0.25, 9).tolist() == [-7.0, *(0.25 * k for k in range(8))]


def test_what_is_held_before_the_first_tick_is_the_start() -> None:
    diagram = Diagram("start")
    source, hold = (
        diagram.add("source", Constant(value=5.0)),
        diagram.add("hold", ZeroOrderHold(period=1.0, offset=0.5, y_start=-1.0)),
    )
    diagram.wire(hold.u, source.y)
    results = diagram.run(stop=1.0, every=0.25, jumps=True)
    assert results["hold.y"].tolist() == [-1.0, -1.0, -1.0, 5.0, 5.0, 5.0]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)])
def test_sampled_blocks_in_a_row_are_computed_in_one_instant_in_dependency_order(order: tuple[int, ...]) -> None:
    """hold -> gain -> hold -> gain -> hold, in whatever order they were added."""
    diagram = Diagram("row")
    blocks = {
        "a": ZeroOrderHold(period=0.1),
        "g": Gain(k=3.0),
        "b": ZeroOrderHold(period=0.1),
        "c": ZeroOrderHold(period=0.2),
    }
    for k in order:
        key = list(blocks)[k]
        diagram.add(key, blocks[key])
    source = diagram.add("source", Ramp())
    diagram.wire("a.u", source.y)
    diagram.wire("g.u", "a.y")
    diagram.wire("b.u", "g.y")
    diagram.wire("c.u", "b.y")
    results = diagram.run(stop=1.0)
    assert after_ticks(results, "b.y", 0.1, 11) == pytest.approx(0.3 * np.arange(11), abs=1e-15)
    assert after_ticks(results, "c.y", 0.2, 6) == pytest.approx(0.6 * np.arange(6), abs=1e-15)
    assert results["c.y"][-1] == results["b.y"][-1]  # both tick at the stop


class Shift(Block):
    """Two discretes that shift u along, and what sampled equations see of them."""

    period = Parameter(0.1)
    u = Input()
    a = Discrete(1.0, visible="after", output=True)
    b = Discrete(2.0, visible="after", output=True)

    @a.next(every=period)
    def next_a(u):
        return u

    @b.next(every=period)
    def next_b(a):
        return a

    @output(every=period)
    def seen(a, b):
        return 100 * a + b

    @output
    def now(a, b):
        return 100 * a + b


def test_discrete_updates_and_sampled_outputs_see_the_values_before_the_tick() -> None:
    diagram = Diagram("shift")
    source, shift = diagram.add("source", Ramp(before=5.0, slope=10.0)), diagram.add("shift", Shift())
    diagram.wire(shift.u, source.y)
    results = diagram.run(stop=0.5)
    u = [5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
    a = [1.0, *u]
    b = [2.0, *a]
    assert after_ticks(results, "shift.a", 0.1, 6) == pytest.approx(a[1:], abs=1e-14)
    assert after_ticks(results, "shift.b", 0.1, 6) == pytest.approx(b[1:-1], abs=1e-14)
    before = [100 * x + y for x, y in zip(a, b, strict=False)]
    assert after_ticks(results, "shift.seen", 0.1, 6) == pytest.approx(before[:6], abs=1e-12)
    assert after_ticks(results, "shift.now", 0.1, 6) == pytest.approx(before[1:7], abs=1e-12)


def test_the_number_of_the_tick_is_known_to_sampled_equations() -> None:
    class Count(Block):
        period = Parameter(0.1)
        total = Discrete()

        @total.next(every=period)
        def add(total, tick):
            return total + tick

        @output(every=period)
        def y(total, tick):
            return 1000 * total + tick

    diagram = Diagram("count")
    diagram.add("c", Count())
    y = after_ticks(diagram.run(stop=1.0), "c.y", 0.1, 11)
    assert y.tolist() == [1000 * k * (k - 1) / 2 + k for k in range(11)]


# --- controllers -----------------------------------------------------------------------------------------------


class DiscretePI(Block):
    """y = kp u + x, x+ = x + ki T u."""

    kp, ki, T = Parameter(2.0), Parameter(1.5), Parameter(0.1)
    u = Input()
    x = Discrete()

    @x.next(every=T)
    def next_x(x, u, ki, T):
        return x + ki * T * u

    @output(every=T)
    def y(x, u, kp):
        return kp * u + x


def test_a_discrete_pi_controller_equals_its_difference_equation() -> None:
    """(kp z - kp + ki T)/(z - 1) by lfilter, on a sine."""
    diagram = Diagram("pi")
    source, pi = diagram.add("source", Sine(omega=2.0, phase=0.3)), diagram.add("pi", DiscretePI())
    diagram.wire(pi.u, source.y)
    results = diagram.run(stop=50.0)
    u = np.sin(2.0 * np.arange(501) / 10 + 0.3)
    expected = lfilter([2.0, -2.0 + 0.15], [1.0, -1.0], u)
    assert np.max(np.abs(after_ticks(results, "pi.y", 0.1, 501) - expected)) < RECURSION


class DiscreteStateSpace(Block):
    """x+ = A x + B u, y = C x + D u, with two states."""

    T = Parameter(0.05)
    A = Parameter([[0.9, 0.1], [-0.2, 0.7]], shape=(2, 2))
    B = Parameter([0.3, -0.5], shape=2)
    C = Parameter([1.0, 2.0], shape=2)
    D = Parameter(0.4)
    u = Input()
    x = Discrete(shape=2)

    @x.next(every=T)
    def next_x(x, u, A, B):
        return A @ x + B * u

    @output(every=T)
    def y(x, u, C, D):
        return C @ x + D * u


def test_a_discrete_state_space_equals_dlsim() -> None:
    diagram = Diagram("ss")
    source, system = diagram.add("source", Sine(omega=5.0)), diagram.add("system", DiscreteStateSpace())
    diagram.wire(system.u, source.y)
    results = diagram.run(stop=10.0)
    u = np.sin(5.0 * np.arange(201) / 20)
    matrices = ([[0.9, 0.1], [-0.2, 0.7]], [[0.3], [-0.5]], [[1.0, 2.0]], [[0.4]], 0.05)
    _, expected, _ = dlsim(matrices, u)
    assert np.max(np.abs(after_ticks(results, "system.y", 0.05, 201) - expected[:, 0])) < RECURSION


def closed_loop() -> Diagram:
    """A PI controller at 0.1 s before a plant 2/(s^2 + s + 2) in continuous time."""
    diagram = Diagram("closed")
    r, error = diagram.add("r", Constant()), diagram.add("error", Sum(signs="+-"))
    pi, plant = (
        diagram.add("pi", DiscretePI(kp=0.8, ki=1.2)),
        diagram.add("plant", TransferFunction(num=[2], den=[1, 1, 2])),
    )
    diagram.wire(error.u1, r.y)
    diagram.wire(error.u2, plant.y)
    diagram.wire(pi.u, error.y)
    diagram.wire(plant.u, pi.y)
    return diagram


def discretized() -> tuple[Array, Array]:
    """The plant under a hold, by the exponential of one matrix."""
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2] = [[0, 1], [-2, -1]], [0, 1]
    whole = expm(block * 0.1)
    return whole[:2, :2], whole[:2, 2]


@pytest.mark.parametrize(
    ("settings", "tolerance"),
    [
        ({"rtol": 1e-10, "atol": 1e-12}, 1e-9),
        ({"method": "rk4", "step": 0.01}, 1e-8),
        ({"method": "radau", "rtol": 1e-9, "atol": 1e-11}, 1e-7),
    ],
    ids=["dopri5", "rk4", "radau"],
)
def test_a_sampled_loop_around_a_continuous_plant_is_the_exact_discretization(
    settings: dict[str, Any], tolerance: float
) -> None:
    results = closed_loop().run(stop=20.0, **settings)
    A, B = discretized()
    x, integral, expected = np.zeros(2), 0.0, []
    for _ in range(201):
        expected.append(2 * x[0])
        u = 1.0 - 2 * x[0]
        x, integral = A @ x + B * (0.8 * u + integral), integral + 0.12 * u
    assert np.max(np.abs(after_ticks(results, "plant.y", 0.1, 201) - expected)) < tolerance


def test_the_same_loop_equals_python_control() -> None:
    control = pytest.importorskip("control")
    z = control.tf([1, 0], [1], 0.1)
    plant = control.c2d(control.tf([2], [1, 1, 2]), 0.1, "zoh")
    pi = (0.8 * z - 0.8 + 0.12) / (z - 1)
    _, y = control.forced_response(control.feedback(pi * plant, 1), np.arange(201) / 10, np.ones(201))
    results = closed_loop().run(stop=20.0, rtol=1e-10, atol=1e-12)
    assert np.max(np.abs(after_ticks(results, "plant.y", 0.1, 201) - y)) < 1e-8


def test_between_ticks_the_plant_sees_a_constant_and_no_step_straddles_a_tick() -> None:
    """A stage beyond the tick would read the old value there, and rk4 at its coarsest would show it."""

    class Exact(Block):
        u = Input()
        x = State(output=True)

        @x.derivative
        def dx(u):
            return u

    diagram = Diagram("hold")
    source, hold, x = (
        diagram.add("source", Ramp()),
        diagram.add("hold", ZeroOrderHold(period=0.1)),
        diagram.add("x", Exact()),
    )
    diagram.wire(hold.u, source.y)
    diagram.wire(x.u, hold.y)
    for settings in ({"method": "euler", "step": 0.3}, {"method": "rk4", "step": 0.25}, {}, {"method": "radau"}):
        results = diagram.run(stop=2.0, **settings)
        assert results["x.x"][-1] == pytest.approx(0.01 * sum(range(20)), abs=1e-13)


def test_two_rates_meet_in_dependency_order() -> None:
    """A slow loop gives the set point of a fast one; at common ticks the fast one sees the new set point."""
    diagram = Diagram("cascade")
    source, slow, fast = (
        diagram.add("source", Ramp()),
        diagram.add("slow", ZeroOrderHold(period=0.3)),
        diagram.add("fast", DiscretePI(kp=1.0, ki=0.0)),
    )
    diagram.wire(fast.u, slow.y)
    diagram.wire(slow.u, source.y)
    results = diagram.run(stop=3.0)
    expected = [math.floor(k / 3) * 0.3 for k in range(31)]
    assert after_ticks(results, "fast.y", 0.1, 31) == pytest.approx(expected, abs=1e-14)
