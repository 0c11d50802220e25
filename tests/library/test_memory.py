"""Delays, rate limiters and backlash: the method of steps, closed forms, SciPy."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from blocks import (
    Backlash,
    Block,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    Noise,
    Parameter,
    Pulse,
    Ramp,
    RateLimiter,
    Results,
    Sine,
    SquareWave,
    State,
    Step,
    Sum,
    Table,
    TransportDelay,
    ZeroOrderHold,
)
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.marks import long

Array = np.ndarray[Any, Any]
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
ENGINES = ["reference", *(["native"] if find_compiler() is not None else [])]


def decay(start: float = 1.0, delay: float = 1.0) -> Diagram:
    """dx/dt = -x(t - delay), x = start before 0."""
    d = Diagram("decay")
    x, past, gain = (
        d.add("x", Integrator(y_start=start)),
        d.add("past", TransportDelay(delay=delay, y_before=start)),
        d.add("gain", Gain(k=-1.0)),
    )
    d.wire(past.u, x.y)
    d.wire(gain.u, past.y)
    d.wire(x.u, gain.y)
    return d


def by_steps(t: float) -> float:
    """The solution of decay() by the method of steps: one more term in each interval of one delay."""
    terms = itertools.takewhile(lambda k: t >= k - 1, itertools.count(0))
    return sum((-1) ** k * (t - (k - 1)) ** k / math.factorial(k) for k in terms)


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({}, 1e-7),
        (TIGHT, 1e-10),
        ({"method": "rk4", "step": 0.01}, 1e-10),
        ({"method": "rk4", "step": 0.3}, 1e-4),
        ({"method": "radau", **TIGHT}, 1e-9),
    ],
)
def test_a_delayed_decay_is_that_of_the_method_of_steps(settings: dict[str, Any], error: float) -> None:
    results = decay().run(stop=10.0, **settings)
    assert results["x.y"] == pytest.approx([by_steps(t) for t in results.t], abs=error)


def test_a_delay_keeps_the_order_of_the_method() -> None:
    def end(**settings: Any) -> float:
        # No step is a part of the delay, so that the breaks lie anywhere in the grid.
        return float(decay(delay=math.pi / 3).run(stop=6.0, every=6.0, **settings)["x.y"][-1])

    exact = end(rtol=1e-12, atol=1e-14)
    coarse, fine = (abs(end(method="rk4", step=step) - exact) for step in (0.2, 0.0125))
    assert math.log2(coarse / fine) / 4 == pytest.approx(4.0, abs=0.5)


def test_a_jump_comes_out_one_delay_later_as_a_jump() -> None:
    d = Diagram("jump")
    pulse, late = d.add("pulse", Pulse(height=3.0, on=0.2, off=0.5)), d.add("late", TransportDelay(delay=0.7))
    integral = d.add("integral", Integrator())
    d.wire(late.u, pulse.y)
    d.wire(integral.u, late.y)
    results = d.run(stop=2.0)
    rows = [(t, y) for t, y in zip(results.t, results["late.y"], strict=True)]
    for t, before, after in ((0.2 + 0.7, 0.0, 3.0), (0.5 + 0.7, 3.0, 0.0)):
        at = [y for time, y in rows if time == t]
        assert at == [before, after]
    assert results["integral.y"][-1] == pytest.approx(0.9, rel=1e-15)


def test_before_the_delay_has_passed_the_output_is_the_value_before() -> None:
    d = Diagram("before")
    one, late = d.add("one", Constant(value=5.0)), d.add("late", TransportDelay(delay=1.0, y_before=2.0))
    d.wire(late.u, one.y)
    results = d.run(start=3.0, stop=5.0, every=0.25, jumps=True)
    assert [results["late.y"][results.t < 4.0].max(), results["late.y"][results.t > 4.0].min()] == [2.0, 5.0]
    assert [y for t, y in zip(results.t, results["late.y"], strict=True) if t == 4.0] == [2.0, 5.0]


def test_a_jump_that_goes_round_in_a_loop_without_memory_never_gets_lost() -> None:
    """y(t) = step(t) - 0.9 y(t - 0.3): every jump comes back, smaller."""
    d = Diagram("echo")
    total, late, gain = d.add("sum", Sum()), d.add("late", TransportDelay(delay=0.3)), d.add("gain", Gain(k=-0.9))
    step, integral = d.add("step", Step(at=0.1)), d.add("integral", Integrator())
    d.wire(total.u1, step.y)
    d.wire(total.u2, gain.y)
    d.wire(late.u, total.y)
    d.wire(gain.u, late.y)
    d.wire(integral.u, total.y)
    results = d.run(stop=5.0)
    expected = sum((-0.9) ** k * (5.0 - 0.1 - 0.3 * k) for k in range(17))
    assert results["integral.y"][-1] == pytest.approx(expected, abs=1e-13)
    jumps = [t for t, following in itertools.pairwise(results.t) if t == following]
    assert jumps == pytest.approx([0.1 + 0.3 * k for k in range(17)], rel=1e-15)


def test_a_signal_that_no_state_follows_is_delayed_as_it_is() -> None:
    """The step of the solver knows nothing of the sine; what is kept of it must be fine enough by itself."""
    d = Diagram("sine")
    sine, late = d.add("sine", Sine(omega=50.0)), d.add("late", TransportDelay(delay=0.5))
    slow, one = d.add("slow", Integrator()), d.add("one", Constant())
    d.wire(late.u, sine.y)
    d.wire(slow.u, one.y)
    results = d.run(stop=5.0, every=0.013)
    after = results.t > 0.5
    assert results["late.y"][after] == pytest.approx(np.sin(50.0 * (results.t[after] - 0.5)), abs=1e-6)


def test_two_delays_in_a_row_are_one() -> None:
    d = Diagram("row")
    sine = d.add("sine", Sine(omega=3.0))
    first, second = d.add("first", TransportDelay(delay=0.4)), d.add("second", TransportDelay(delay=0.25))
    d.wire(first.u, sine.y)
    d.wire(second.u, first.y)
    results = d.run(stop=3.0, every=0.07)
    after = results.t > 0.66
    assert results["second.y"][after] == pytest.approx(np.sin(3.0 * (results.t[after] - 0.65)), abs=1e-6)


def test_a_sampled_controller_with_dead_time_is_that_of_exact_matrices() -> None:
    """dx/dt = -x + u(t - 0.25), u = 2 (1 - x) at ticks of 0.1 s: between edges x is known in closed form."""
    d = Diagram("dead_time")
    x, late = d.add("x", Lag()), d.add("late", TransportDelay(delay=0.25))
    control, one = d.add("control", ZeroOrderHold(period=0.1)), d.add("one", Constant())
    error, gain = d.add("error", Sum(signs="+-")), d.add("gain", Gain(k=2.0))
    d.wire(x.u, late.y)
    d.wire(error.u1, one.y)
    d.wire(error.u2, x.y)
    d.wire(gain.u, error.y)
    d.wire(control.u, gain.y)
    d.wire(late.u, control.y)
    results = d.run(stop=3.0, every=0.1, **TIGHT)
    state, held, ours = 0.0, [0.0, 0.0, 0.0], [0.0]
    for k in range(30):
        held.append(2.0 * (1.0 - state))
        for u in (held[k], held[k + 1]):  # u(t - 0.25) changes in the middle of each period
            state = u + (state - u) * math.exp(-0.05)
        ours.append(state)
    rows = [float(results["x.y"][np.nonzero(results.t == k / 10)[0][-1]]) for k in range(31)]
    assert rows == pytest.approx(ours, abs=1e-9)


class Lag(Block):
    """dy/dt = (u - y)/T."""

    T = Parameter(1.0, unit="s", positive=True)
    u = Input()
    y = State(output=True)

    @y.derivative
    def dy(u, y, T):  # type: ignore[no-untyped-def]
        return (u - y) / T


def dead_time(*extra: Block) -> Diagram:
    """Noise through a delay into an integrator, and blocks that are wired to nothing."""
    d = Diagram("idle")
    noise, late = d.add("noise", Noise(period=0.05)), d.add("late", TransportDelay(delay=0.0371))
    total = d.add("i", Integrator())
    d.wire(late.u, noise.y)
    d.wire(total.u, late.y)
    for k, block in enumerate(extra):
        d.add(f"extra{k}", block)
    return d


def test_what_has_nothing_to_do_with_a_delay_makes_no_instants_of_it() -> None:
    alone = dead_time().run(stop=3.0)
    for block in (Table(times=[0.0, 100.0], values=[0.0, 1.0]), SquareWave(period=100.0), Ramp(at=50.0)):
        assert len(dead_time(block).run(stop=3.0).t) == len(alone.t)
    # A tick, and its jump a delay later: no echo of it, as nothing comes back to the delay.
    assert alone.statistics.instants == 1 + 60 + 60


def test_a_smooth_loop_has_few_instants() -> None:
    """A jump comes back as a bend, then as one of higher derivatives, and then it is forgotten."""
    assert decay().run(stop=50.0).statistics.instants == 1 + 5 + 1  # start, five delays, stop


def test_what_no_delay_sees_any_more_is_forgotten() -> None:
    run = decay(delay=0.05).start(stop=100.0, method="rk4", step=0.01, every=10.0)
    run.advance_to(60.0)
    rows = run.snapshot().rows
    assert len(rows["past.starts"]) < 3000
    assert len(rows["past.breaks"]) < 20


@pytest.mark.long
def test_a_long_delay_costs_no_more_per_step_than_a_short_one() -> None:
    """Copying the past at each step would take minutes here."""
    d = Diagram("long")
    sine, late = d.add("sine", Sine()), d.add("late", TransportDelay(delay=1000.0))
    x = d.add("x", Integrator())
    d.wire(late.u, sine.y)
    d.wire(x.u, sine.y)
    results = d.run(stop=30.0, method="rk4", step=0.001, every=1.0)
    assert results.statistics.steps == 30000


def test_a_delayed_jump_joins_the_tick_that_it_falls_on() -> None:
    """-9.7 + 10 is 0.3 with the rounding error of 10: a hold at 0.3 sees the jump."""
    for start, at, delay in ((-20.0, -9.7, 10.0), (0.0, 0.1, 0.2), (-1.0, -0.9, 1.2)):
        d = Diagram("join")
        step, late = d.add("step", Step(at=at)), d.add("late", TransportDelay(delay=delay))
        hold = d.add("hold", ZeroOrderHold(period=0.1))
        d.wire(late.u, step.y)
        d.wire(hold.u, late.y)
        results = d.run(start=start, stop=1.0)
        assert results.t[np.nonzero(results["hold.y"])[0][0]] == 0.3


# --- rate limiter ----------------------------------------------------------------------------------------------


def driven(block: Any, source: Any, **settings: Any) -> Results:
    d = Diagram("driven")
    made, driver = d.add("made", block), d.add("driver", source)
    d.wire(made.u, driver.y)
    return d.run(**settings)


def test_a_jump_becomes_a_ramp_that_ends_exactly() -> None:
    d = Diagram("ramp")
    limiter, step = d.add("limiter", RateLimiter(rising=2.0)), d.add("step", Step(at=0.3))
    integral = d.add("integral", Integrator())
    d.wire(limiter.u, step.y)
    d.wire(integral.u, limiter.y)
    results = d.run(stop=2.0)
    expected = np.clip(2.0 * (results.t - 0.3), 0.0, 1.0)
    assert results["limiter.y"] == pytest.approx(expected, abs=1e-13)
    assert [event.t for event in results.events if event.block == "limiter"][-1] == pytest.approx(0.8, abs=1e-14)
    assert results["integral.y"][-1] == pytest.approx(0.25 + 1.2, abs=1e-13)


def test_it_falls_at_its_own_rate() -> None:
    results = driven(RateLimiter(rising=10.0, falling=0.5), Pulse(on=0.0, off=1.0), stop=4.0, every=0.5)
    expected = {0.5: 1.0, 1.5: 0.75, 2.5: 0.25, 3.0: 0.0, 4.0: 0.0}
    for t, y in expected.items():
        assert results["made.y"][np.nonzero(results.t == t)[0][-1]] == pytest.approx(y, abs=1e-12)


def test_a_slow_input_passes() -> None:
    results = driven(RateLimiter(rising=2.0), Ramp(slope=1.5), stop=2.0, every=0.1)
    assert results["made.y"] == pytest.approx(1.5 * results.t, abs=1e-12)


@pytest.mark.long
def test_a_fast_sine_becomes_a_triangle() -> None:
    """A sine of 10 rad/s against 1/s: y goes up and down in straight lines, and turns where it meets the sine."""
    results = driven(RateLimiter(rising=1.0), Sine(omega=10.0), method="rk4", step=1e-4, stop=4.0)
    y = np.asarray(results["made.y"])
    reference, inputs = [0.0], np.sin(10.0 * np.arange(40001) * 1e-4)
    for u in inputs[1:]:
        reference.append(min(max(u, reference[-1] - 1e-4), reference[-1] + 1e-4))
    ours = np.interp(np.arange(40001) * 1e-4, results.t, y)
    # The loop keeps to its grid; what it cuts off where y meets the sine is one step at most.
    assert ours == pytest.approx(np.array(reference), abs=2e-4)
    slopes = np.diff(y)[np.diff(results.t) > 1e-6] / np.diff(results.t)[np.diff(results.t) > 1e-6]
    assert np.max(np.abs(slopes)) <= 1.0 + 1e-6


def test_the_error_at_a_departure_shrinks_with_the_square_of_the_step() -> None:
    def error(step: float) -> float:
        # From cos t = -1/2 on the sine falls faster than 1/2, and y is a line.
        results = driven(RateLimiter(rising=1.0, falling=0.5), Sine(), method="rk4", step=step, stop=4.0)
        leaves = math.acos(-0.5)
        t = np.linspace(leaves + step, 4.0, 7)
        exact = math.sin(leaves) - 0.5 * (t - leaves)
        return float(np.max(np.abs(np.interp(t, results.t, results["made.y"]) - exact)))

    for step in (0.1, 0.0125, 0.001):
        assert error(step) <= step**2 / 8 * math.sin(math.acos(-0.5)) * 1.1  # 1.1: its third derivative


@pytest.mark.parametrize("settings", [{}, TIGHT, {"method": "radau"}], ids=str)
def test_adaptive_steps_follow_a_limiter_within_their_tolerance(settings: dict[str, Any]) -> None:
    d = Diagram("fast")
    sine, limiter = d.add("sine", Sine(omega=20.0)), d.add("limiter", RateLimiter(rising=5.0, falling=0.3))
    total = d.add("total", Integrator())
    d.wire(limiter.u, sine.y)
    d.wire(total.u, limiter.y)
    results = d.run(stop=3.0, **settings)
    # A loop on a fine grid; its own error is of the size of its step.
    step = 2e-5
    y, exact = 0.0, 0.0
    for u in np.sin(20.0 * np.arange(1, 150001) * step):
        following = min(max(u, y - 0.3 * step), y + 5.0 * step)
        exact += step * (y + following) / 2
        y = following
    assert results["total.y"][-1] == pytest.approx(exact, abs=1e-3)


# --- backlash --------------------------------------------------------------------------------------------------


def test_play_is_the_operator_of_the_literature() -> None:
    """y = min(max(y, u - w/2), u + w/2) along a path of straight lines: exact at every corner."""
    corners = {0.0: 0.0, 1.0: 2.0, 2.0: -1.0, 3.0: 0.2, 4.0: -0.3, 5.0: 3.0}
    source = Table(times=list(corners), values=list(corners.values()))
    results = driven(Backlash(width=0.8), source, stop=5.0, **TIGHT)
    y, expected = 0.0, {}
    for t, u in corners.items():
        y = min(max(y, u - 0.4), u + 0.4)
        expected[t] = y
    for t, value in expected.items():
        assert results["made.y"][np.nonzero(results.t == t)[0][-1]] == pytest.approx(value, abs=1e-13)
    met = [event.t for event in results.events if event.block == "made" and event.what.startswith("meets")]
    assert 0.2 in [round(t, 12) for t in met]  # u = 2 t meets y = 0 at u = 0.4


def test_play_turns_a_sine_into_a_loop_with_flat_ends() -> None:
    results = driven(Backlash(width=0.6), Sine(), stop=4 * math.pi, **TIGHT)
    late = results.t > math.pi
    assert np.max(results["made.y"][late]) == pytest.approx(0.7, abs=2e-3)
    assert np.min(results["made.y"][late]) == pytest.approx(-0.7, abs=2e-3)


def lagged(omega: float, T: float = 0.2) -> tuple[Any, Any]:
    """The answer of a lag to sin(omega t), and its derivative."""
    size, part = 1 + (omega * T) ** 2, omega * T

    def u(t: Any) -> Any:
        return (np.sin(omega * t) - part * np.cos(omega * t) + part * np.exp(-t / T)) / size

    return u, lambda t: (np.sin(omega * t) - u(t)) / T


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("method", "settings", "error"),
    [
        ("dopri5", {}, 3e-6),
        ("dopri5", {"rtol": 1e-9, "atol": 1e-12}, 1e-7),
        ("radau", {}, 3e-6),
        long("radau", {"rtol": 1e-9, "atol": 1e-12}, 1e-7),
    ],
)
@pytest.mark.parametrize(("omega", "width"), [(0.3, 0.1), (3.0, 0.1), (3.0, 1.0)])
def test_play_is_within_the_tolerance_where_its_input_turns_late_in_a_step(
    omega: float, width: float, settings: dict[str, float], error: float, method: str, engine: str
) -> None:
    u, slope = lagged(omega)
    grid = np.linspace(1e-9, 20.0, 4001)
    turns = [brentq(slope, a, b, xtol=1e-14) for a, b in itertools.pairwise(grid) if slope(a) * slope(b) < 0]
    d = Diagram("play")
    sine, lag, play, sum_ = (
        d.add("sine", Sine(omega=omega)),
        d.add("lag", FirstOrder(T=0.2)),
        d.add("play", Backlash(width=width)),
        d.add("sum", Integrator()),
    )
    d.wire(lag.u, sine.y)
    d.wire(play.u, lag.y)
    d.wire(sum_.u, play.y)
    results = d.run(stop=20.0, every=0.1, method=method, engine=engine, **settings)
    y, before = 0.0, list(turns)
    for t, made in zip(results.t, results["play.y"], strict=True):
        while before and before[0] <= t:
            x = float(u(before.pop(0)))
            y = min(max(y, x - width / 2), x + width / 2)
        assert made == pytest.approx(min(max(y, u(t) - width / 2), u(t) + width / 2), abs=error)


def test_a_gap_of_nothing_is_a_wire() -> None:
    results = driven(Backlash(width=0.0), Sine(), stop=3.0, every=0.1)
    assert results["made.y"] == pytest.approx(np.sin(results.t), abs=1e-12)


def test_a_rate_limited_loop_is_that_of_scipy() -> None:
    """dx/dt = limited(-4 x + sin t): the limiter within a loop, where adaptive steps see it."""
    d = Diagram("loop")
    x, law, sine = d.add("x", Integrator(y_start=1.0)), d.add("law", Sum()), d.add("sine", Sine())
    gain, limiter = d.add("gain", Gain(k=-4.0)), d.add("limiter", RateLimiter(rising=1.0))
    d.wire(gain.u, x.y)
    d.wire(law.u1, gain.y)
    d.wire(law.u2, sine.y)
    d.wire(limiter.u, law.y)
    d.wire(x.u, limiter.y)
    results = d.run(stop=8.0, method="rk4", step=1e-3, every=0.5)

    # The limiter as a stiff lag of limited speed.
    def rates(t: float, z: Array) -> list[float]:
        return [z[1], float(np.clip(1e4 * (-4.0 * z[0] + math.sin(t) - z[1]), -1.0, 1.0))]

    made = solve_ivp(rates, (0.0, 8.0), [1.0, -4.0], method="Radau", rtol=1e-9, atol=1e-10, max_step=1e-2,
                     t_eval=np.arange(0.0, 8.01, 0.5))  # fmt: skip
    ours = np.array([results["x.y"][np.nonzero(results.t == t)[0][-1]] for t in np.arange(0.0, 8.01, 0.5)])
    assert ours == pytest.approx(made.y[0], abs=2e-3)
