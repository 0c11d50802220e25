"""Hybrid models against closed forms, exact matrices, and SciPy started anew at each event."""

# mypy: allow-untyped-defs, allow-untyped-decorators, no-check-untyped-defs
# Equations have no self and no annotations; tests have theirs.

import itertools
import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from blocks import (
    PID,
    Backlash,
    Block,
    Constant,
    Diagram,
    Discrete,
    DiscretePID,
    FirstOrder,
    Gain,
    Input,
    Integrator,
    LimitedIntegrator,
    Parameter,
    Pulse,
    Relay,
    ResettableIntegrator,
    Results,
    Saturation,
    SimulationError,
    Sine,
    State,
    Step,
    Sum,
    SwitchAbove,
    TransportDelay,
    ZeroOrderHold,
    crossing,
    event_time,
    output,
)

Array = np.ndarray[Any, Any]

TIGHT: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-14}
SOLVED = 1e-9
"""An error of rtol = 1e-12 in each of at most 1000 steps; sizes are near 1, and no model here makes errors grow."""
ROUNDED = 1e-12
"""Constant or linear rates are integrated without error but rounding: 1e-16 in each of some thousand operations."""


def times(results: Results, block: str, what: str = "") -> list[float]:
    return [event.t for event in results.events if event.block == block and what in ("", event.what)]


def right(results: Results, name: str, t: Any) -> Array:
    """The right values of a signal at rows that are there; the times may be some ulp off."""
    rows = np.searchsorted(results.t, np.asarray(t) + 1e-9, side="right") - 1
    assert results.t[rows] == pytest.approx(np.asarray(t), abs=1e-12)
    return np.asarray(results[name][rows])


def held(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """The exact step of dx/dt = A x + B u over h with a constant u."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    whole = expm(block * h)
    return whole[:n, :n], whole[:n, n:]


# --- an event that makes another one ---------------------------------------------------------------------------


class TwoBalls(Block):
    """Two points above a floor, one on top of the other; all impacts are elastic.

    An impact is where two bodies touch and come nearer, so that the one that the floor makes comes at its instant.
    """

    m1 = Parameter(1.7)
    m2 = Parameter(1.0)
    g = Parameter(9.81)
    x1 = State(1.0, output=True)
    x2 = State(1.0, output=True)
    v1 = State(output=True)
    v2 = State(output=True)

    @x1.derivative
    def dx1(v1):
        return v1

    @x2.derivative
    def dx2(v2):
        return v2

    @v1.derivative
    @v2.derivative
    def dv(g):
        return -g

    @crossing(direction="up")
    def floor(x1, v1):
        return np.where(x1 > 0.0, -x1, -v1 - 1e-6)

    @floor.reset(v1)
    def bounce(v1):
        return -v1

    @crossing(direction="up")
    def knock(x1, x2, v1, v2):
        return np.where(x2 > x1, x1 - x2, v1 - v2 - 1e-6)

    @knock.reset(v1)
    def v1_after(v1, v2, m1, m2):
        return ((m1 - m2) * v1 + 2.0 * m2 * v2) / (m1 + m2)

    @knock.reset(v2)
    def v2_after(v1, v2, m1, m2):
        return ((m2 - m1) * v2 + 2.0 * m1 * v1) / (m1 + m2)


def impacts_of_two(m1: float, m2: float, g: float, stop: float) -> list[tuple[float, str]]:
    """From parabola to parabola: all impacts in closed form."""
    t, x1, x2, v1, v2 = 0.0, 1.0, 1.0, 0.0, 0.0
    made: list[tuple[float, str]] = []
    while True:
        to_floor = (v1 + math.sqrt(v1 * v1 + 2 * g * x1)) / g if x1 > 0 or v1 > 0 else 0.0
        to_knock = (x2 - x1) / (v1 - v2) if v1 > v2 else math.inf
        dt = min(to_floor, to_knock)
        t, x1, x2 = t + dt, x1 + v1 * dt - g * dt * dt / 2, x2 + v2 * dt - g * dt * dt / 2
        v1, v2 = v1 - g * dt, v2 - g * dt
        if t > stop:
            return made
        if to_floor <= to_knock:
            made.append((t, "floor"))
            x1, v1 = 0.0, -v1
        else:
            made.append((t, "knock"))
            x1 = x2
            v1, v2 = ((m1 - m2) * v1 + 2 * m2 * v2) / (m1 + m2), ((m2 - m1) * v2 + 2 * m1 * v1) / (m1 + m2)
        if x1 == 0.0 and x2 < 1e-12:
            x2 = 0.0


@pytest.mark.parametrize("m1", [1.7, 4.0])
def test_an_impact_on_the_floor_makes_one_between_the_balls_at_the_same_instant(m1: float) -> None:
    """A light lower ball is knocked back onto the floor: three impacts at one instant, each made by the one before."""
    d = Diagram("balls")
    d.add("balls", TwoBalls(m1=m1))
    results = d.run(stop=3.0, **TIGHT)
    expected = impacts_of_two(m1, 1.0, 9.81, 3.0)
    first = ["floor", "knock", "floor"] if m1 < 3.0 else ["floor", "knock"]
    assert [what for _, what in expected[: len(first)]] == first
    assert len(expected) > len(first) + 2
    assert [event.what for event in results.events] == [what for _, what in expected]
    # An error of velocity is carried on from impact to impact, and grows by the ratio of the masses in some of them.
    assert [event.t for event in results.events] == pytest.approx([t for t, _ in expected], abs=1e-10)
    assert len({event.t for event in results.events[: len(first)]}) == 1
    x1, x2, v1, v2 = (results[f"balls.{name}"] for name in ("x1", "x2", "v1", "v2"))
    energy = m1 * (v1**2 / 2 + 9.81 * x1) + v2**2 / 2 + 9.81 * x2
    assert energy == pytest.approx((m1 + 1.0) * 9.81, abs=1e-10)
    assert np.min(x1) > -ROUNDED
    assert np.min(x2 - x1) > -ROUNDED


def test_momentum_is_kept_where_the_balls_meet_in_flight() -> None:
    d = Diagram("balls")
    d.add("balls", TwoBalls(m1=4.0))
    results = d.run(stop=3.0, **TIGHT)
    knocks = [t for t in times(results, "balls", "knock") if t not in times(results, "balls", "floor")]
    assert knocks
    for t in knocks:
        (before, after) = np.nonzero(results.t == t)[0]
        momentum = 4.0 * results["balls.v1"] + results["balls.v2"]
        assert momentum[after] == pytest.approx(momentum[before], abs=ROUNDED)
        approach = results["balls.v1"] - results["balls.v2"]
        assert approach[after] == pytest.approx(-approach[before], abs=ROUNDED)
        assert approach[before] > 0.1


# --- limit cycles ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("on", "off"), [(-1.0, 1.0), (-0.5, 2.0)])
def test_the_limit_cycle_of_a_relay_on_a_first_order_plant_has_its_period_and_amplitude(on: float, off: float) -> None:
    """T dy/dt = k u - y between -w and w: T ln((k u + w)/(k u - w)) upwards, and likewise downwards."""
    k, T, w = 2.0, 0.7, 0.3
    d = Diagram("cycle")
    relay, plant = d.add("relay", Relay(on_at=w, off_at=-w, on=on, off=off)), d.add("plant", FirstOrder(k=k, T=T))
    d.wire(relay.u, plant.y)
    d.wire(plant.u, relay.y)
    results = d.run(stop=6.0, **TIGHT)
    first = T * math.log(k * off / (k * off - w))
    down = T * math.log((k * on - w) / (k * on + w))
    up = T * math.log((k * off + w) / (k * off - w))
    expected = list(
        itertools.takewhile(lambda t: t < 6.0, itertools.accumulate(itertools.cycle([down, up]), initial=first))
    )
    found = times(results, "relay", "switch")
    assert len(found) == len(expected) > 10
    assert found == pytest.approx(expected, abs=SOLVED)
    settled = results["plant.y"][results.t >= first]
    # A located row is its instant's right end: beyond the level by 4 ulp of t at the fastest rate.
    assert [settled.min(), settled.max()] == pytest.approx([-w, w], abs=ROUNDED)


def test_a_thermostat_is_scipy_started_anew_at_each_switching() -> None:
    """A room under a sine of outside temperatures, heated between 19 and 21."""
    d = Diagram("thermostat")
    outside, room = d.add("outside", Sine(amplitude=6.0, omega=0.8, bias=5.0)), d.add("room", Integrator(y_start=17.0))
    heater = d.add("heater", Relay(on_at=21.0, off_at=19.0, on=0.0, off=12.0))
    flow, loss, total = d.add("flow", Sum(signs="+-")), d.add("loss", Gain(k=0.4)), d.add("total", Sum())
    d.wire(flow.u1, outside.y)
    d.wire(flow.u2, room.y)
    d.wire(loss.u, flow.y)
    d.wire(heater.u, room.y)
    d.wire(total.u1, loss.y)
    d.wire(total.u2, heater.y)
    d.wire(room.u, total.y)
    results = d.run(stop=12.0, **TIGHT)

    t, y, heats = 0.0, 17.0, True
    switched: list[float] = []
    while True:
        power, level = (12.0, 21.0) if heats else (0.0, 19.0)

        def meets(_: float, x: Array, level: float = level) -> float:
            return float(x[0] - level)

        meets.terminal = True  # type: ignore[attr-defined]
        meets.direction = 1.0 if heats else -1.0  # type: ignore[attr-defined]
        made = solve_ivp(
            lambda t, x, power=power: [0.4 * (5.0 + 6.0 * math.sin(0.8 * t) - x[0]) + power],
            (t, 12.0), [y], method="DOP853", rtol=1e-12, atol=1e-12, events=meets,
        )  # fmt: skip
        t, y = float(made.t[-1]), float(made.y[0, -1])
        if made.status == 0:
            break
        y, heats = level, not heats
        switched.append(t)
    assert len(switched) > 8
    # SciPy finds its events on dense output, of order 7 in steps that are error-controlled to 1e-12: some 1e-9 off.
    assert times(results, "heater") == pytest.approx(switched, abs=1e-8)
    assert results["room.y"][-1] == pytest.approx(y, abs=1e-7)


# --- sampled controllers ---------------------------------------------------------------------------------------


def test_a_sampled_pi_before_a_plant_with_dead_time_is_the_exact_discretization() -> None:
    """A dead time of 2.5 samples: the plant sees u[k-3] for half of an interval, and u[k-2] for the rest."""
    kp, ki, T, h = 0.6, 0.9, 0.8, 0.1
    d = Diagram("dead_time")
    r, pi = d.add("r", Constant()), d.add("pi", DiscretePID(kp=kp, ki=ki, period=h))
    late, plant = d.add("late", TransportDelay(delay=0.25)), d.add("plant", FirstOrder(k=2.0, T=T))
    d.wire(pi.r, r.y)
    d.wire(pi.y, plant.y)
    d.wire(late.u, pi.u)
    d.wire(plant.u, late.y)
    results = d.run(stop=10.0, **TIGHT)
    half, full = math.exp(-h / 2 / T), math.exp(-h / T)
    y, integral = 0.0, 0.0
    u = [0.0, 0.0, 0.0]
    expected_y, expected_u = [], []
    for _ in range(101):
        e = 1.0 - y
        u.append(kp * e + integral)
        integral += ki * h * e
        expected_y.append(y)
        expected_u.append(u[-1])
        y = full * y + 2.0 * (half * (1.0 - half) * u[-4] + (1.0 - half) * u[-3])
    at = np.arange(101) / 10
    assert np.max(np.abs(right(results, "plant.y", at) - expected_y)) < SOLVED
    assert np.max(np.abs(right(results, "pi.u", at) - expected_u)) < SOLVED


def last_tick(t: Fraction, period: str, offset: str) -> Fraction | None:
    k = math.floor((t - Fraction(offset)) / Fraction(period))
    return Fraction(offset) + k * Fraction(period) if k >= 0 else None


@pytest.mark.parametrize(
    ("offsets", "meet"), [(("0.02", "0.05"), 0), (("0.05", "0.05"), 5), (("0", "0.1"), 5), (("0", "0"), 5)]
)
def test_rates_of_a_tenth_and_of_fifteen_hundredths_follow_each_other_exactly(
    offsets: tuple[str, str], meet: int
) -> None:
    """slow samples what fast holds: at common ticks the new value. The integral of both is a sum of rectangles."""
    d = Diagram("rates")
    source = d.add("source", Sine(omega=3.0, phase=0.4))
    fast = d.add("fast", ZeroOrderHold(period=0.1, offset=float(offsets[0]), y_start=0.25))
    slow = d.add("slow", ZeroOrderHold(period=0.15, offset=float(offsets[1]), y_start=-0.5))
    total, x = d.add("total", Sum()), d.add("x", Integrator())
    d.wire(slow.u, fast.y)
    d.wire(fast.u, source.y)
    d.wire(total.u1, fast.y)
    d.wire(total.u2, slow.y)
    d.wire(x.u, total.y)
    results = d.run(stop=1.5, every=0.01)

    def fast_at(t: Fraction) -> float:
        tick = last_tick(t, "0.1", offsets[0])
        return 0.25 if tick is None else math.sin(3.0 * float(tick) + 0.4)

    def slow_at(t: Fraction) -> float:
        tick = last_tick(t, "0.15", offsets[1])
        return -0.5 if tick is None else fast_at(tick)

    grid = [Fraction(k, 100) for k in range(151)]
    at = np.array([float(t) for t in grid])
    assert right(results, "fast.y", at) == pytest.approx([fast_at(t) for t in grid], abs=1e-15)
    assert right(results, "slow.y", at) == pytest.approx([slow_at(t) for t in grid], abs=1e-15)
    area = sum((fast_at(t) + slow_at(t)) / 100 for t in grid[:-1])
    assert results["x.y"][-1] == pytest.approx(area, abs=ROUNDED)
    common = {last_tick(t, "0.1", offsets[0]) for t in grid} & {last_tick(t, "0.15", offsets[1]) for t in grid} - {None}
    assert len([t for t in common if t is not None and 0 < t <= Fraction(3, 2)]) == meet


# --- resets, ticks and events at one time ----------------------------------------------------------------------


def test_a_tick_that_resets_an_integrator_shows_its_samplers_what_comes_after() -> None:
    """The trigger is held: it rises at the tick 0.3, y begins anew there, and the hold at 0.3 sees 0."""
    d = Diagram("reset")
    step, hold = d.add("step", Step(at=0.25)), d.add("hold", ZeroOrderHold(period=0.1))
    x, seen, one = (
        d.add("x", ResettableIntegrator(threshold=0.5)),
        d.add("seen", ZeroOrderHold(period=0.1)),
        d.add("one", Constant()),
    )
    d.wire(hold.u, step.y)
    d.wire(x.trigger, hold.y)
    d.wire(x.u, one.y)
    d.wire(seen.u, x.y)
    results = d.run(stop=1.0)
    assert times(results, "x") == [0.3]
    after = np.append(np.diff(results.t) > 0, True)
    exact = np.where((results.t > 0.3) | ((results.t == 0.3) & after), results.t - 0.3, results.t)
    assert results["x.y"] == pytest.approx(exact, abs=ROUNDED)
    ticks = np.arange(11) / 10
    assert right(results, "seen.y", ticks) == pytest.approx(np.where(ticks < 0.3, ticks, ticks - 0.3), abs=ROUNDED)


class Fires(Block):
    """dx/dt = u; where x reaches 1, it begins anew at 0, and is counted."""

    u = Input()
    x = State(output=True)
    n = Discrete(output=True)

    @x.derivative
    def dx(u):
        return u

    @crossing(direction="up")
    def full(x):
        return x - 1.0

    @full.reset(x)
    def empty():
        return 0.0

    @full.reset(n)
    def counted(n):
        return n + 1.0


def test_a_tick_on_an_event_sees_what_the_event_left() -> None:
    """x is full at 0.5, 1, 1.5 ..., which are ticks: in binary, without any rounding."""
    d = Diagram("fires")
    rate, neuron = d.add("rate", Constant(value=2.0)), d.add("neuron", Fires())
    x, n = d.add("x", ZeroOrderHold(period=0.25)), d.add("n", ZeroOrderHold(period=0.25))
    d.wire(neuron.u, rate.y)
    d.wire(x.u, neuron.x)
    d.wire(n.u, neuron.n)
    results = d.run(stop=4.0, method="euler", step=0.0625)
    assert times(results, "neuron") == [k / 2 for k in range(1, 9)]
    at = np.arange(17) / 4
    assert right(results, "x.y", at).tolist() == [2 * (t % 0.5) for t in at]
    assert right(results, "n.y", at).tolist() == [t // 0.5 for t in at]


class PWM(Block):
    """y = 1 for the first part `u` of each period, as u was at its beginning, then 0."""

    period = Parameter(0.1)
    u = Input()
    on = Discrete(type="bool", visible="after")
    falls = Discrete(-1.0, visible="after")

    @on.next(every=period)
    def rises(u):
        return u > 0.0

    @falls.next(every=period)
    def edge_at(t, u, period):
        return t + u * period

    @event_time
    def edge(t, falls):
        return np.where(t < falls, falls, np.inf)

    @edge.reset(on)
    def off():
        return np.False_

    @output
    def y(on):
        return np.where(on, 1.0, 0.0)


def test_a_loop_by_pulse_widths_that_are_set_at_ticks_is_its_recursion() -> None:
    """T dy/dt = 2 pwm - y, and the width is 0.3 + 2 (0.9 - y) within 0.05 ... 0.95 at each tick."""
    d = Diagram("pwm")
    wanted, error = d.add("wanted", Constant(value=0.9)), d.add("error", Sum(signs="+-"))
    gain, bias, total = d.add("gain", Gain(k=2.0)), d.add("bias", Constant(value=0.3)), d.add("total", Sum())
    limit, pwm = d.add("limit", Saturation(lower=0.05, upper=0.95)), d.add("pwm", PWM())
    plant = d.add("plant", FirstOrder(k=2.0, T=0.5))
    d.wire(error.u1, wanted.y)
    d.wire(error.u2, plant.y)
    d.wire(gain.u, error.y)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, bias.y)
    d.wire(limit.u, total.y)
    d.wire(pwm.u, limit.y)
    d.wire(plant.u, pwm.y)
    results = d.run(stop=3.0, **TIGHT)
    y, expected, edges = 0.0, [], []
    for k in range(31):
        expected.append(y)
        width = min(max(0.3 + 2.0 * (0.9 - y), 0.05), 0.95) * 0.1
        edges.append(k / 10 + width)
        y = 2.0 + (y - 2.0) * math.exp(-width / 0.5)
        y *= math.exp(-(0.1 - width) / 0.5)
    assert np.max(np.abs(right(results, "plant.y", np.arange(31) / 10) - expected)) < SOLVED
    assert times(results, "pwm", "edge") == pytest.approx(edges[:-1], abs=SOLVED)
    assert len({round(edge % 0.1, 9) for edge in edges}) > 5, "the widths are many"


# --- friction --------------------------------------------------------------------------------------------------


class Belt(Block):
    """A mass on a belt that moves with V, held by a spring: it sticks until k x = Fs, then slips against Fc."""

    m = Parameter(1.0)
    k = Parameter(4.0)
    Fs = Parameter(2.0)
    Fc = Parameter(1.0)
    V = Parameter(0.3)
    x = State(output=True)
    v = State(0.3, output=True)
    sticks = Discrete(True, type="bool", output=True)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, sticks, m, k, Fc):
        return np.where(sticks, 0.0, (Fc - k * x) / m)

    @crossing(direction="up")
    def breaks(x, sticks, k, Fs):
        return np.where(sticks, k * x - Fs, -1.0)

    @crossing(direction="up")
    def catches(v, sticks, V):
        return np.where(sticks, 1.0, v - V)

    @breaks.reset(sticks)
    def slips():
        return np.False_

    @catches.reset(sticks)
    def sticks_again():
        return np.True_

    @catches.reset(v)
    def carried(V):
        return V


def test_stick_and_slip_has_the_period_of_its_two_phases() -> None:
    """Slipping is a part of a circle in (x, v/w) around Fc/k, from one side at height V/w to the other one."""
    m, k, Fs, Fc, V = 1.0, 4.0, 2.0, 1.0, 0.3
    d = Diagram("belt")
    d.add("belt", Belt(m=m, k=k, Fs=Fs, Fc=Fc, V=V))
    results = d.run(stop=20.0, **TIGHT)
    w, a = math.sqrt(k / m), (Fs - Fc) / k
    slip = (math.pi + 2 * math.atan2(V / w, a)) / w
    stick = 2 * a / V
    first = Fs / k / V
    breaks = [t for n in range(20) if (t := first + n * (slip + stick)) < 20.0]
    catches = [t for n in range(20) if (t := first + slip + n * (slip + stick)) < 20.0]
    assert len(breaks) > 4
    # Where it sticks again, v - V has the slope 1/s of its circle; errors of one slip are forgotten in the next stick.
    assert times(results, "belt", "breaks") == pytest.approx(breaks, abs=SOLVED)
    assert times(results, "belt", "catches") == pytest.approx(catches, abs=SOLVED)
    after = results.t > catches[0]
    # Rows stand beside the extreme points: by at most a step, of which w^2 h^2/2 is 1e-3 of the radius below h = 0.02.
    for found, sign in ((results["belt.x"][after].max(), 1.0), (-results["belt.x"][after].min(), -1.0)):
        extreme = sign * Fc / k + math.hypot(a, V / w)
        assert extreme - 1e-3 < found < extreme + SOLVED
    assert np.max(results["belt.v"]) < V + SOLVED


# --- tanks -----------------------------------------------------------------------------------------------------


def test_coupled_tanks_overflow_from_where_to_when_the_exponentials_say() -> None:
    """dh1 = q - a (h1 - h2), within 1; dh2 = a (h1 - h2) - b h2: full while more comes than leaves."""
    a, b, q, off = 1.5, 0.8, 2.0, 4.0
    d = Diagram("tanks")
    inflow, between, out = (
        d.add("inflow", Pulse(height=q, on=0.0, off=off)),
        d.add("between", Gain(k=a)),
        d.add("out", Gain(k=b)),
    )
    h1, h2 = d.add("h1", LimitedIntegrator(upper=1.0)), d.add("h2", Integrator())
    head, net1, net2 = d.add("head", Sum(signs="+-")), d.add("net1", Sum(signs="+-")), d.add("net2", Sum(signs="+-"))
    d.wire(head.u1, h1.y)
    d.wire(head.u2, h2.y)
    d.wire(between.u, head.y)
    d.wire(net1.u1, inflow.y)
    d.wire(net1.u2, between.y)
    d.wire(out.u, h2.y)
    d.wire(net2.u1, between.y)
    d.wire(net2.u2, out.y)
    d.wire(h1.u, net1.y)
    d.wire(h2.u, net2.y)
    results = d.run(stop=7.0, every=0.05, **TIGHT)

    free, drive = np.array([[-a, a], [a, -a - b]]), np.array([[1.0], [0.0]])

    def filling(t: float) -> Array:
        return held(free, drive, t)[1][:, 0] * q

    full = float(brentq(lambda t: filling(t)[0] - 1.0, 0.1, 3.0, xtol=1e-14))
    low = filling(full)[1]
    rest = a / (a + b)

    def overflowing(t: float) -> Array:
        return np.array([1.0, rest + (low - rest) * math.exp(-(a + b) * (t - full))])

    assert full < off
    assert q > a * (1.0 - low), "it overflows from where it is full on"
    level = overflowing(off)
    expected = np.array([
        filling(t) if t <= full else overflowing(t) if t <= off else held(free, drive, t - off)[0] @ level
        for t in results.t
    ])  # fmt: skip
    assert np.max(np.abs(np.column_stack([results["h1.y"], results["h2.y"]]) - expected)) < SOLVED
    (reached,) = times(results, "h1", "above")
    assert reached == pytest.approx(full, abs=SOLVED)
    assert times(results, "h1", "turn") == [off]
    # The left row of the instant is its located right end.
    assert results["h1.y"].max() == pytest.approx(1.0, abs=ROUNDED)
    # What is not in the tanks has run out or over.
    lost = q * off - results["h1.y"][-1] - results["h2.y"][-1]
    ran = b * (expected_area(filling, full)
               + rest * (off - full) + (low - rest) * (1 - math.exp(-(a + b) * (off - full))) / (a + b)
               + float((np.linalg.inv(free) @ (held(free, drive, 7.0 - off)[0] - np.eye(2)) @ level)[1]))  # fmt: skip
    over = (q - a * (1 - rest)) * (off - full) + a * (low - rest) * (1 - math.exp(-(a + b) * (off - full))) / (a + b)
    assert lost == pytest.approx(ran + over, abs=SOLVED)


def expected_area(filling: Callable[[float], Array], full: float) -> float:
    """The integral of the second level while the first tank fills, by Gauss's rule, exact to rounding for 20 nodes."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    return float(sum(w * filling(full * (1 + x) / 2)[1] for x, w in zip(nodes, weights, strict=True)) * full / 2)


# --- delays ----------------------------------------------------------------------------------------------------


def by_steps(rates: dict[int, Fraction], step: Fraction, pieces: int) -> list[list[Fraction]]:
    """dx/dt = sum of rate x(t - n step), x = 1 up to 0, in polynomials of t - k step on each piece, in fractions."""
    made: list[list[Fraction]] = []
    value = Fraction(1)
    for k in range(pieces):
        slope: list[Fraction] = []
        for n, rate in rates.items():
            past = made[k - n] if k >= n else [Fraction(1)]
            slope += [Fraction(0)] * (len(past) - len(slope))
            for power, coefficient in enumerate(past):
                slope[power] += rate * coefficient
        made.append([value, *(coefficient / (power + 1) for power, coefficient in enumerate(slope))])
        value = sum((c * step**power for power, c in enumerate(made[-1])), Fraction(0))
    return made


@pytest.mark.parametrize(
    ("settings", "tolerance"),
    [
        (TIGHT, SOLVED),
        # The past is kept to a tenth of the tolerance, and errors of rk4 at 0.05 are h^4/120 of a derivative below 4.
        ({"method": "rk4", "step": 0.05}, 1e-6),
        ({"method": "radau", "rtol": 1e-10, "atol": 1e-12}, 1e-7),
    ],
    ids=["dopri5", "rk4", "radau"],
)
def test_a_loop_with_an_integrator_and_two_delays_is_that_of_the_method_of_steps(
    settings: dict[str, Any], tolerance: float
) -> None:
    """dx/dt = -x(t - 1) - x(t - 3/2)/2."""
    d = Diagram("two_delays")
    x = d.add("x", Integrator(y_start=1.0))
    near, far = (
        d.add("near", TransportDelay(delay=1.0, y_before=1.0)),
        d.add("far", TransportDelay(delay=1.5, y_before=1.0)),
    )
    half, total = d.add("half", Gain(k=0.5)), d.add("total", Sum(signs="--"))
    d.wire(near.u, x.y)
    d.wire(far.u, x.y)
    d.wire(half.u, far.y)
    d.wire(total.u1, near.y)
    d.wire(total.u2, half.y)
    d.wire(x.u, total.y)
    results = d.run(stop=6.0, **settings)
    pieces = by_steps({2: Fraction(-1), 3: Fraction(-1, 2)}, Fraction(1, 2), 12)

    def exact(t: float) -> float:
        k = min(int(t / 0.5), 11)
        return sum(float(c) * (t - 0.5 * k) ** power for power, c in enumerate(pieces[k]))

    assert np.max(np.abs(results["x.y"] - [exact(t) for t in results.t])) < tolerance
    assert np.max(np.abs(results["far.y"] - [exact(t - 1.5) if t > 1.5 else 1.0 for t in results.t])) < tolerance


def test_a_delay_of_a_delay_is_one_of_the_sum_of_both() -> None:
    d = Diagram("chain")
    source = d.add("source", Sine(omega=2.0))
    first, second = d.add("first", TransportDelay(delay=0.3)), d.add("second", TransportDelay(delay=0.45))
    d.wire(first.u, source.y)
    d.wire(second.u, first.y)
    results = d.run(stop=4.0, **TIGHT)
    late = results.t > 0.75
    # Twice kept as polynomials, to a tenth of rtol each.
    assert np.max(np.abs(results["second.y"][late] - np.sin(2.0 * (results.t[late] - 0.75)))) < SOLVED
    assert np.all(results["second.y"][results.t < 0.3] == 0.0)


def test_a_projection_that_moves_by_rounding_where_a_delay_breaks_is_no_jump() -> None:
    """The play follows the delayed sine, amplified, in contact: its own break must not return after the delay."""
    d = Diagram("followed")
    source, late = d.add("source", Sine(omega=5.968376, phase=4.655123)), d.add("late", TransportDelay(delay=0.356711))
    control, play = d.add("control", PID(kp=1.9, ki=1.0, kd=0.2)), d.add("play", Backlash(width=0.2))
    d.wire(late.u, source.y)
    d.wire(control.r, source.y)
    d.wire(control.y, late.y)
    d.wire(play.u, control.u)
    steps = {}
    for engine in ("reference", "native"):
        results = d.run(stop=2.0, method="euler", step=0.01, engine=engine)
        begun = {event.t for event in results.events}
        twice = [t for t in results.t if any(0 < abs(t - when - 2 * 0.356711) < 1e-12 for when in begun if when > 0)]
        assert begun, engine
        assert not twice, engine
        steps[engine] = results.statistics.steps
    assert steps["native"] == steps["reference"]


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_what_bends_comes_out_of_a_delay_with_one_value_at_the_bend(engine: str) -> None:
    """A limited sine bends where the limit acts: one delay later it bends, too, and does not jump by rounding."""
    d = Diagram("bent")
    source, limit = d.add("source", Sine(omega=5.3)), d.add("limit", Saturation(lower=-0.71, upper=0.37))
    sums, late = d.add("sums", Integrator()), d.add("late", TransportDelay(delay=0.3137))
    d.wire(limit.u, source.y)
    d.wire(sums.u, limit.y)
    d.wire(late.u, limit.y)
    d.wire(d.add("again", TransportDelay(delay=0.2211)).u, sums.y)
    results = d.run(stop=9.0, method="rk4", step=0.01, engine=engine, log=["late.y", "again.y"])
    bends = [event.t + delay for event in results.events for delay in (0.3137, 0.2211)]
    assert len(bends) > 40
    assert {t for t in bends if t < 9.0} <= {*results.t}
    assert np.all(np.diff(results.t) > 0)  # where a signal jumps there are two rows


# --- switching controllers -------------------------------------------------------------------------------------


def transfer(*, tracks: bool) -> Results:
    """Two controllers, of which the second takes over at t = 2; until then it follows the first one, if it tracks."""
    d = Diagram("transfer")
    r, plant, clock = d.add("r", Constant()), d.add("plant", FirstOrder(T=0.5)), d.add("clock", Step(at=2.0))
    a, b = d.add("a", DiscretePID(kp=0.5, ki=0.8, period=0.1)), d.add("b", DiscretePID(kp=3.0, ki=2.0, period=0.1))
    chosen, by_hand = d.add("chosen", SwitchAbove(threshold=0.5)), d.add("by_hand", Sum(signs="+-"))
    one = d.add("one", Constant(value=1.0 if tracks else 0.0))
    for controller in (a, b):
        d.wire(controller.r, r.y)
        d.wire(controller.y, plant.y)
    d.wire(by_hand.u1, one.y)
    d.wire(by_hand.u2, clock.y)
    d.wire(b.manual, by_hand.y)
    d.wire(b.u_manual, a.u)
    d.wire(chosen.control, clock.y)
    d.wire(chosen.u1, b.u)
    d.wire(chosen.u2, a.u)
    d.wire(plant.u, chosen.y)
    return d.run(stop=6.0, **TIGHT)


def test_a_controller_that_followed_takes_over_without_a_bump() -> None:
    results = transfer(tracks=True)
    decay = math.exp(-0.1 / 0.5)
    y, of_a, of_b, expected = 0.0, 0.0, 0.0, []
    for k in range(61):
        e = 1.0 - y
        u_a = 0.5 * e + of_a
        v_b = 3.0 * e + of_b
        u = u_a if k < 20 else v_b
        expected.append((y, u))
        of_a += 0.8 * 0.1 * e
        of_b += u_a - v_b if k < 20 else 2.0 * 0.1 * e
        y = decay * y + (1.0 - decay) * u
    at = np.arange(61) / 10
    assert np.max(np.abs(right(results, "plant.y", at) - [y for y, _ in expected])) < SOLVED
    assert np.max(np.abs(right(results, "chosen.y", at) - [u for _, u in expected])) < SOLVED
    # It goes on from what it followed by its own proportional part alone: 3 times what y moved in a sample.
    before, after = right(results, "chosen.y", [1.9, 2.0])
    moved = float(np.diff(right(results, "plant.y", [1.9, 2.0]))[0])
    assert after - before == pytest.approx(-3.0 * moved, abs=SOLVED)
    assert abs(after - before) < 0.1
    jolted = transfer(tracks=False)
    assert abs(float(np.diff(right(jolted, "chosen.y", [1.9, 2.0]))[0])) > 1.0


# --- algebraic loops -------------------------------------------------------------------------------------------


def looped(k: float, offset: Block) -> Diagram:
    """y = k y + offset."""
    d = Diagram("loop")
    total, gain, source = d.add("total", Sum()), d.add("gain", Gain(k=k)), d.add("source", offset)
    x = d.add("x", Integrator())
    d.wire(total.u1, gain.y)
    d.wire(total.u2, source.y)
    d.wire(gain.u, total.y)
    d.wire(x.u, total.y)
    return d


def test_the_loop_y_is_2_y_plus_1_is_solved_and_jumps_with_what_drives_it() -> None:
    results = looped(2.0, Constant()).run(stop=1.0, loops="solve")
    assert results["total.y"] == pytest.approx(-1.0, abs=1e-15)
    assert results["x.y"][-1] == pytest.approx(-1.0, abs=ROUNDED)
    jumps = looped(2.0, Step(at=0.3)).run(stop=1.0, loops="solve")
    assert jumps["total.y"][jumps.t == 0.3].tolist() == [0.0, -1.0]
    assert jumps["x.y"][-1] == pytest.approx(-0.7, abs=ROUNDED)


def test_the_loop_y_is_y_is_refused_by_name() -> None:
    with pytest.raises(SimulationError, match=r"E307 total\.y: .* no solution, or many \(y = y\)"):
        looped(1.0, Constant(value=0.0)).run(stop=1.0, loops="solve")


# --- state machines --------------------------------------------------------------------------------------------

IDLE, RUNS, RESTS, FAILED = 0.0, 1.0, 2.0, 3.0


class Machine(Block):
    """Four states: it starts at u >= 1, rests below 0.5, and fails at 3; then only a u below -1 makes it idle."""

    u = Input()
    state = Discrete(IDLE, output=True)

    @crossing(direction="up")
    def start(u, state):
        return np.where((state == IDLE) | (state == RESTS), u - 1.0, -1.0)

    @crossing(direction="up")
    def rest(u, state):
        return np.where(state == RUNS, 0.5 - u, -1.0)

    @crossing(direction="up")
    def fail(u, state):
        return np.where(state == FAILED, -1.0, u - 3.0)

    @crossing(direction="up")
    def clear(u, state):
        return np.where(state == FAILED, -1.0 - u, -1.0)

    @start.reset(state)
    def starts():
        return RUNS

    @rest.reset(state)
    def rests():
        return RESTS

    @fail.reset(state)
    def fails():
        return FAILED

    @clear.reset(state)
    def clears():
        return IDLE


class Careless(Block):
    """The same start and failure, declared the other way round; a failure that lost stands while u stays."""

    u = Input()
    state = Discrete(IDLE, output=True)

    @crossing(direction="up")
    def fail(u):
        return u - 3.0

    @crossing(direction="up")
    def start(u, state):
        return np.where((state == IDLE) | (state == RESTS), u - 1.0, -1.0)

    @fail.reset(state)
    def fails():
        return FAILED

    @start.reset(state)
    def starts():
        return RUNS


def stepped(block: Block, table: list[tuple[float, float]]) -> Results:
    d = Diagram("machine")
    u, machine = d.input("u"), d.add("machine", block)
    d.wire(machine.u, u)
    return d.run(stop=10.0, inputs={"u": ([t for t, _ in table], [v for _, v in table], "hold")})


def test_a_state_machine_goes_through_its_states_at_the_times_of_its_guards() -> None:
    table = [
        (0.0, 0.0),
        (1.0, 2.0),
        (2.0, 0.0),
        (3.0, 1.5),
        (4.0, 3.5),
        (5.0, 0.0),
        (6.0, 2.0),
        (7.0, -2.0),
        (8.0, 1.0),
    ]
    results = stepped(Machine(), table)
    passed = [(event.t, event.what) for event in results.events]
    assert passed == [(1.0, "start"), (2.0, "rest"), (3.0, "start"), (4.0, "fail"), (7.0, "clear"), (8.0, "start")]
    state = right(results, "machine.state", [0.0, 1.0, 2.0, 3.0, 4.0, 7.0, 8.0])
    assert state.tolist() == [IDLE, RUNS, RESTS, RUNS, FAILED, IDLE, RUNS]


def test_of_two_guards_at_one_instant_the_reset_that_is_declared_later_wins() -> None:
    """u jumps from 0 to 5: it would start, and it would fail."""
    table = [(0.0, 0.0), (1.0, 5.0)]
    both = stepped(Machine(), table)
    assert [(event.t, event.what) for event in both.events] == [(1.0, "start"), (1.0, "fail")]
    assert both["machine.state"][both.t == 1.0].tolist() == [IDLE, FAILED]
    other = stepped(Careless(), table)
    assert [(event.t, event.what) for event in other.events] == [(1.0, "fail"), (1.0, "start")]
    assert other["machine.state"][other.t == 1.0].tolist() == [IDLE, RUNS]
    assert other["machine.state"][-1] == RUNS


def test_a_chain_of_guards_passes_through_states_within_one_instant() -> None:
    """From -2 to 5 in the failed state: cleared first, and then it would start and fails again."""
    table = [(0.0, 0.0), (1.0, 4.0), (2.0, -2.0), (3.0, 4.0)]
    results = stepped(Machine(), table)
    assert [(event.t, event.what) for event in results.events] == [
        (1.0, "start"), (1.0, "fail"), (2.0, "clear"), (3.0, "start"), (3.0, "fail"),
    ]  # fmt: skip
    assert results["machine.state"][-1] == FAILED
