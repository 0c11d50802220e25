"""Sampled blocks of the library: SciPy's recursions, loops in plain Python, and their continuous limits."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import expm

from blocks import (
    PID,
    Constant,
    Delay,
    Demux,
    Diagram,
    DiscreteIntegrator,
    DiscretePID,
    DiscreteStateSpace,
    DiscreteTransferFunction,
    FirstOrder,
    Gain,
    Mux,
    Pulse,
    Ramp,
    Results,
    Sine,
    Step,
    Sum,
    TransferFunction,
    UnitDelay,
)
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.contract.tracing import trace
from blocks.library import LIBRARY
from blocks.text.errors import ModelError

Array = np.ndarray[Any, Any]

RECURSION = 1e-12
"""Two ways to sum the same few hundred products."""
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""


def sampled(results: Results, name: str, period: float, count: int, offset: float = 0.0) -> Array:
    """The right values of a signal at its first ticks."""
    rows = np.searchsorted(results.t, offset + period * np.arange(count) + 1e-9, side="right") - 1
    return np.asarray(results[name][rows])


def filtered(block: Any, u: Array, period: float, offset: float = 0.0) -> Array:
    """The outputs of a block at its ticks for these inputs; before the first tick u is 99, which it must not see."""
    d = Diagram("filtered")
    d.wire(d.add("b", block).u, d.input("u"))
    t = offset + period * np.arange(len(u))
    if offset:
        t, u = np.append(0.0, t), np.append(99.0, u)
    results = d.run(stop=float(t[-1] + period / 2), inputs={"u": (t, u, "hold")})
    return sampled(results, "b.y", period, len(u) - (offset > 0), offset)


def noise(count: int, *shape: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).normal(size=(count, *shape))


def feedthrough(name: str, **given: Any) -> bool:
    """Whether y depends on u at once."""
    tape = trace(resolve(LIBRARY[name], {"period": Value(1.0), **{k: Value(v) for k, v in given.items()}}).interface)
    found = {tape.arguments[k].kind for node in tape.results["output:y"].nodes for k in tape.arguments_of(node)}
    return "input" in found


# --- linear systems --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num", "den"),
    [
        ([1.0], [1.0, 0.0]),
        ([2.0], [4.0]),
        ([3.0, 1.0], [2.0, -1.0]),
        ([0.5], [1.0, -1.2, 0.7]),
        ([1.0, 0.0, -0.5], [1.0, -1.2, 0.7]),
        ([0.0, 1.0, 0.3], [2.0, 0.4, -0.6]),
        ([1.0, 2.0], [1.0, 0.3, -0.2, 0.5, 0.1]),
    ],
)
@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_a_discrete_transfer_function_is_that_of_scipy(num: list[float], den: list[float], offset: float) -> None:
    u = noise(100)
    y = filtered(DiscreteTransferFunction(num=num, den=den, period=0.1, offset=offset), u, 0.1, offset)
    padded = [0.0] * (len(den) - len(num)) + num
    assert y == pytest.approx(signal.lfilter(padded, den, u), abs=RECURSION)
    if len(den) > 1 and num[0] != 0.0:
        _, theirs = signal.dlsim((num, den, 0.1), u)
        assert y == pytest.approx(theirs[:, 0], abs=RECURSION)
    assert feedthrough("DiscreteTransferFunction", num=num, den=den) is (padded[0] != 0.0)


def test_a_discrete_transfer_function_starts_from_its_state_and_shows_its_start_before() -> None:
    d = Diagram("start")
    block = DiscreteTransferFunction(num=[1.0], den=[1.0, -0.5], period=0.1, offset=0.05, x_start=[8.0], y_start=-3.0)
    d.wire(d.add("b", block).u, d.add("u", Constant(value=0.0)).y)
    results = d.run(stop=0.36, every=0.01)
    assert results["b.y"][0] == -3.0
    assert results["b.y"][np.searchsorted(results.t, 0.04)] == -3.0
    assert sampled(results, "b.y", 0.1, 4, 0.05).tolist() == [8.0, 4.0, 2.0, 1.0]


stable = st.lists(st.floats(-0.9, 0.9), min_size=0, max_size=4)


@settings(max_examples=30, deadline=None)
@given(stable, st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=5))
def test_any_stable_discrete_transfer_function_is_that_of_lfilter(poles: list[float], num: list[float]) -> None:
    den = 2.0 * np.atleast_1d(np.poly(poles))
    num = num[: len(den)]
    u = noise(40)
    y = filtered(DiscreteTransferFunction(num=num, den=den, period=0.1), u, 0.1)
    # Four poles at 0.9 have a gain of 1e4.
    assert y == pytest.approx(signal.lfilter([0.0] * (len(den) - len(num)) + num, den, u), abs=1e4 * RECURSION)


A = np.array([[0.5, 0.3, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.4, -0.6]])
B = np.array([[1.0, 0.0], [0.0, 2.0], [-1.0, 0.5]])
C = np.array([[1.0, 0.0, 1.0], [0.0, -1.0, 2.0]])
D = np.array([[0.0, 0.5], [0.0, 0.0]])


def test_a_discrete_state_space_system_is_that_of_scipy() -> None:
    u, x0 = noise(80, 2), np.array([1.0, -1.0, 0.5])
    d = Diagram("ss")
    system, mux, demux = (
        d.add("b", DiscreteStateSpace(A=A, B=B, C=C, D=D, period=0.25, x_start=x0)),
        d.add("m", Mux()),
        d.add("e", Demux()),
    )
    d.wire(mux.u1, d.input("u1"))
    d.wire(mux.u2, d.input("u2"))
    d.wire(system.u, mux.y)
    d.wire(demux.u, system.y)
    t = 0.25 * np.arange(80)
    results = d.run(stop=19.8, inputs={"u1": (t, u[:, 0], "hold"), "u2": (t, u[:, 1], "hold")})
    _, theirs, _ = signal.dlsim((A, B, C, D, 0.25), u, x0=x0)
    assert sampled(results, "b.y", 0.25, 80) == pytest.approx(theirs, abs=RECURSION)
    assert sampled(results, "e.y2", 0.25, 80) == pytest.approx(theirs[:, 1], abs=RECURSION)


def test_the_zeros_of_d_say_which_loops_are_none() -> None:
    def loop(output: str, input_: str) -> None:
        d = Diagram("loop")
        system, mux, demux = (
            d.add("b", DiscreteStateSpace(A=A, B=B, C=C, D=D, period=1.0)),
            d.add("m", Mux()),
            d.add("e", Demux()),
        )
        d.wire(system.u, mux.y)
        d.wire(demux.u, system.y)
        for port in ("u1", "u2"):
            source = getattr(demux, output) if port == input_ else d.add("zero", Constant(value=0.0)).y
            d.wire(getattr(mux, port), source)
        d.run(stop=3.0)

    loop("y1", "u1")
    loop("y2", "u2")
    with pytest.raises(ModelError, match="E102"):
        loop("y1", "u2")


# --- integrators -----------------------------------------------------------------------------------------------

FORMS = ["forward", "backward", "trapezoidal"]


def summed(form: str, u: Array, period: float) -> Array:
    """The integral from the first tick on, by NumPy and SciPy."""
    if form == "trapezoidal":
        return np.asarray(cumulative_trapezoid(u, dx=period, initial=0.0))
    return period * (np.cumsum(u) - (u if form == "forward" else u[0]))


@pytest.mark.parametrize("form", FORMS)
def test_a_discrete_integrator_is_the_sum_of_its_form(form: str) -> None:
    u, period = noise(100), 0.2
    y = filtered(DiscreteIntegrator(form=form, period=period, offset=0.1), u, period, 0.1)
    assert y == pytest.approx(summed(form, u, period), abs=RECURSION)
    started = filtered(DiscreteIntegrator(form=form, period=period, y_start=5.0), u, period)
    assert started == pytest.approx(5.0 + summed(form, u, period), abs=RECURSION)
    assert feedthrough("DiscreteIntegrator", form=form) is (form != "forward")


@pytest.mark.parametrize("form", FORMS)
def test_a_discrete_integrator_has_the_transfer_function_of_its_form(form: str) -> None:
    num, factor = {"forward": ([0.0, 1.0], 1.0), "backward": ([1.0, 0.0], 1.0), "trapezoidal": ([1.0, 1.0], 0.5)}[form]
    u = np.append(0.0, noise(50))  # where u[0] is 0, y[0] is that of a system at rest
    y = filtered(DiscreteIntegrator(form=form, period=0.2), u, 0.2)
    assert y == pytest.approx(signal.lfilter(factor * 0.2 * np.array(num), [1.0, -1.0], u), abs=RECURSION)


@pytest.mark.parametrize("form", FORMS)
def test_y_start_of_the_state_is_the_sum_before_the_first_tick(form: str) -> None:
    """The same as a filter from rest, whatever u[0] is; a constant 1 gives 0, 1, 2 or 1, 2, 3 or 0.5, 1.5, 2.5."""
    num, factor = {"forward": ([0.0, 1.0], 1.0), "backward": ([1.0, 0.0], 1.0), "trapezoidal": ([1.0, 1.0], 0.5)}[form]
    u = 1.0 + noise(50)
    y = filtered(DiscreteIntegrator(form=form, period=0.2, y_start=3.0, y_start_of="state"), u, 0.2)
    assert y == pytest.approx(3.0 + signal.lfilter(factor * 0.2 * np.array(num), [1.0, -1.0], u), abs=RECURSION)
    ones = filtered(DiscreteIntegrator(form=form, period=1.0, y_start_of="state"), np.ones(3), 1.0)
    first = {"forward": 0.0, "backward": 1.0, "trapezoidal": 0.5}[form]
    assert ones.tolist() == [first, first + 1.0, first + 2.0]


@pytest.mark.parametrize(("form", "order"), [("forward", 1), ("backward", 1), ("trapezoidal", 2)])
def test_a_discrete_integrator_nears_the_integral_with_its_order(form: str, order: int) -> None:
    def error(n: int) -> float:
        d = Diagram("order")
        d.wire(d.add("b", DiscreteIntegrator(form=form, period=1.0 / n)).u, d.add("u", Sine(omega=3.0, phase=1.0)).y)
        return float(d.run(stop=1.0)["b.y"][-1]) - (math.cos(1.0) - math.cos(4.0)) / 3.0

    errors = [error(n) for n in (16, 32, 64)]
    assert np.log2(np.array(errors[:-1]) / np.array(errors[1:])) == pytest.approx([order, order], abs=0.1)


@pytest.mark.parametrize("form", FORMS)
def test_a_limited_discrete_integrator_does_not_wind_up(form: str) -> None:
    u = np.array([1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 0.0, -3.0, -3.0, -3.0, 1.0, 1.0])
    y = filtered(DiscreteIntegrator(form=form, period=0.5, lower=-0.75, upper=1.25), u, 0.5)
    a = {"forward": 0.0, "backward": 1.0, "trapezoidal": 0.5}[form]
    expected = [0.0]
    for before, now in itertools.pairwise(u):
        expected.append(min(max(expected[-1] + 0.5 * ((1.0 - a) * before + a * now), -0.75), 1.25))
    assert y == pytest.approx(expected, abs=RECURSION)
    assert (np.min(y), np.max(y)) == (-0.75, 1.25)


# --- delays ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [1, 2, 5])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_a_delay_gives_what_was_there_so_many_ticks_ago(samples: int, offset: float) -> None:
    u = noise(20)
    y = filtered(Delay(samples=samples, period=0.1, offset=offset, y_start=-7.0), u, 0.1, offset)
    assert y.tolist() == [*[-7.0] * samples, *u[:-samples]]


def test_a_delay_is_a_chain_of_unit_delays_and_breaks_a_loop() -> None:
    def loop(samples: int, chain: bool) -> Array:
        d = Diagram("loop")
        total, gain = d.add("total", Sum()), d.add("gain", Gain(k=-0.9))
        delays: list[Any] = [UnitDelay(period=0.1)] * samples if chain else [Delay(samples=samples, period=0.1)]
        d.wire(total.u1, d.add("u", Sine(omega=2.0)).y)
        d.wire(total.u2, gain.y)
        port = total.y
        for k, block in enumerate(delays):
            delay = d.add(f"delay{k}", block)
            d.wire(delay.u, port)
            port = delay.y
        d.wire(gain.u, port)
        return sampled(d.run(stop=5.0), str(port), 0.1, 51)

    for samples in (1, 4):
        assert np.array_equal(loop(samples, chain=False), loop(samples, chain=True))


# --- the controller --------------------------------------------------------------------------------------------


class Controller:
    """A sampled PID in plain Python, as textbooks write it."""

    def __init__(self, h: float, kp: float, ki: float, kd: float, **given: float) -> None:
        self.h, self.kp, self.ki, self.kd = h, kp, ki, kd
        self.b, self.c, self.Tf = given["b"], given["c"], given["Tf"]
        self.Tt, self.lower, self.upper = given["Tt"], given["lower"], given["upper"]
        self.I, self.D, self.before = given.get("u_start", 0.0), 0.0, None

    def control(self, r: float, y: float, by_hand: float | None = None) -> float:
        P = self.kp * (self.b * r - y)
        w = self.c * r - y
        rise = 0.0 if self.before is None else w - self.before
        self.D = self.Tf / (self.Tf + self.h) * self.D + self.kd / (self.Tf + self.h) * rise
        v = P + self.I + self.D
        u = min(max(v if by_hand is None else by_hand, self.lower), self.upper)
        if by_hand is None:
            self.I += self.ki * self.h * (r - y) + self.h / self.Tt * (u - v)
        else:
            self.I = u - P - self.D
        self.before = w
        return u


PLANT = np.array([[0.0, 1.0], [-1.0, -1.2]])
"""3/(s^2 + 1.2 s + 1) with y = 3 x1."""


def held(A: Array, b: Array, h: float) -> tuple[Array, Array]:
    """The step of a system under a constant input."""
    n = len(b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, b
    made = expm(block * h)
    return made[:n, :n], made[:n, n]


def pid_loop(control: Any, wanted: Any, **run: Any) -> Results:
    """A DiscretePID or a PID before an oscillator."""
    d = Diagram("loop")
    made, plant = d.add("control", control), d.add("plant", TransferFunction(num=[3.0], den=[1.0, 1.2, 1.0]))
    source = d.add("wanted", wanted)
    d.wire(made.r, source.y)
    d.wire(made.y, plant.y)
    d.wire(plant.u, made.u)
    return d.run(**{**TIGHT, **run})


GAINS = {"kp": 2.0, "ki": 1.5, "kd": 0.8, "Tf": 0.05, "Tt": 0.4}


@pytest.mark.parametrize(
    "weights", [{"b": 1.0, "c": 0.0}, {"b": 0.4, "c": 1.0}, {"b": 1.0, "c": 1.0, "lower": -0.3, "upper": 1.0}], ids=str
)
def test_a_discrete_pid_is_that_of_a_loop_in_python(weights: dict[str, float]) -> None:
    h = 0.1
    results = pid_loop(DiscretePID(period=h, **GAINS, **weights), Pulse(height=2.0, on=0.5, off=4.0), stop=8.0)
    control = Controller(h, **{"lower": -math.inf, "upper": math.inf, **GAINS, **weights})
    F, g = held(PLANT, np.array([0.0, 1.0]), h)
    x, y, u = np.zeros(2), [], []
    for k in range(80):
        y.append(3.0 * x[0])
        u.append(control.control(2.0 if 5 <= k < 40 else 0.0, y[-1]))
        x = F @ x + g * u[-1]
    assert sampled(results, "plant.y", h, 80) == pytest.approx(y, abs=CLOSE)
    assert sampled(results, "control.u", h, 80) == pytest.approx(u, abs=10 * CLOSE)  # kd/Tf enlarges what y is off by
    if "upper" in weights:
        assert (np.max(u), np.min(u)) == (1.0, -0.3)  # both limits are at work


def test_the_defaults_of_a_discrete_pid_are_those_of_the_continuous_one() -> None:
    def values(**given: float) -> list[float]:
        made = resolve(LIBRARY["DiscretePID"], {key: Value(value) for key, value in given.items()}).values
        return [float(made[key].value) for key in ("Tf", "Tt")]

    assert values(period=0.01, kp=2.0, ki=4.0, kd=1.0) == [0.05, 0.5]
    assert values(period=0.01) == [1.0, 1.0]
    assert values(period=2.0, kp=2.0, ki=4.0) == [1.0, 2.0]  # not below the period


@pytest.mark.parametrize("limits", [{}, {"lower": -0.3, "upper": 1.0}], ids=["free", "limited"])
def test_a_discrete_pid_nears_the_continuous_one_with_its_period(limits: dict[str, float]) -> None:
    gains = {**GAINS, "Tf": 0.2}
    wanted = Pulse(height=1.0, on=0.5, off=4.0)
    times = 0.5 * np.arange(13)

    def seen(results: Results) -> Array:
        return np.asarray(results["plant.y"][np.searchsorted(results.t, times)])

    expected = seen(pid_loop(PID(b=1.0, c=1.0, **gains, **limits), wanted, stop=6.0, every=0.5))
    errors = []
    for h in (0.02, 0.01, 0.005):
        block = DiscretePID(period=h, b=1.0, c=1.0, **gains, **limits)
        found = pid_loop(block, wanted, stop=6.0, every=0.5, rtol=1e-8, atol=1e-10)
        errors.append(np.max(np.abs(seen(found) - expected)))
    assert np.log2(np.array(errors[:-1]) / np.array(errors[1:])) == pytest.approx([1.0, 1.0], abs=0.1)
    assert errors[-1] < 0.02


def test_a_pid_and_a_discrete_pid_swap() -> None:
    """The wires stay, and so do the values: all parameters but the period have one name, one meaning and one unit."""
    d = Diagram("loop")
    control = d.add("control", PID(kp=2.0, ki=1.5, kd=0.4, Tf=0.2, b=0.7, u_start=0.1, unit="rad", unit_u="V", upper=3))
    plant = d.add("plant", TransferFunction(num=[3.0], den=[1.0, 1.2, 1.0], unit="rad", unit_u="V"))
    d.wire(control.r, d.add("wanted", Step(at=0.5, unit="rad")).y)
    d.wire(control.y, plant.y)
    d.wire(plant.u, control.u)
    d.settings(stop=5.0, every=0.5, rtol=1e-8, atol=1e-10, log=["plant.y", "control.u"])
    before, times = d.run(), 0.5 * np.arange(2, 10)
    swap = d.swap("control", DiscretePID(period=0.001), variant="sampled")
    assert (swap.ports, swap.left, swap.dropped) == ({}, (), ())
    after = d.run()
    for name in ("plant.y", "control.u"):
        ours, theirs = (np.asarray(one[name])[np.searchsorted(one.t, times)] for one in (before, after))
        assert theirs == pytest.approx(ours, abs=0.01), name
    pid, sampled = (set(LIBRARY[kind].declaration.parameters) for kind in ("PID", "DiscretePID"))
    assert pid - sampled == {"smoothed_start"}


def test_a_discrete_pid_goes_from_hand_to_automatic_without_a_bump() -> None:
    h, gains = 0.1, {**GAINS, "kd": 0.1, "b": 1.0, "c": 0.0, "upper": 1.5}
    d = Diagram("transfer")
    control, plant = d.add("control", DiscretePID(period=h, **gains)), d.add("plant", FirstOrder(k=2.0, T=0.8))
    d.wire(control.r, d.add("r", Constant(value=2.0)).y)
    d.wire(control.y, plant.y)
    d.wire(control.manual, d.add("manual", Pulse(on=1.0, off=9.0)).y)
    d.wire(control.u_manual, d.add("by_hand", Step(at=2.0, before=0.4, after=7.0)).y)
    d.wire(plant.u, control.u)
    results = d.run(stop=15.0, **TIGHT)
    twin = Controller(h, **{**gains, "lower": -math.inf})
    x, u = 0.0, []
    for k in range(150):
        by_hand = (0.4 if k < 20 else 7.0) if 10 <= k < 90 else None
        u.append(twin.control(2.0, x, by_hand))
        x = math.exp(-h / 0.8) * x + (1.0 - math.exp(-h / 0.8)) * 2.0 * u[-1]
    found = sampled(results, "control.u", h, 150)
    assert found == pytest.approx(u, abs=10 * CLOSE)
    assert found[89] == 1.5  # by hand, within the limits
    # y has come to rest at 3 up to exp(-7/0.8): u moves no further than kp and kd make of that.
    assert found[90] == pytest.approx(1.5, abs=1e-3)
    assert found[91] < 1.4
    assert found[-1] == pytest.approx(1.0, abs=0.01)


def test_a_step_of_the_wanted_value_kicks_only_where_the_derivative_weighs_it() -> None:
    def first(c: float) -> float:
        d = Diagram("kick")
        control = d.add("b", DiscretePID(period=0.1, kd=1.0, Tf=0.1, b=0.0, c=c))
        d.wire(control.r, d.add("r", Step(at=0.5)).y)
        d.wire(control.y, d.add("y", Constant(value=4.0)).y)
        results = d.run(stop=1.0)
        assert sampled(results, "b.u", 0.1, 5) == pytest.approx([-4.0] * 5, abs=1e-15)  # no kick of y at the first tick
        return float(sampled(results, "b.u", 0.1, 6)[5]) + 4.0

    assert first(0.0) == 0.0
    assert first(1.0) == pytest.approx(1.0 / 0.2, rel=1e-14)


def test_a_discrete_pid_without_an_integral_gain_follows_nothing() -> None:
    d = Diagram("proportional")
    control = d.add("b", DiscretePID(period=0.1, kp=2.0, upper=1.0, u_start=0.25))
    d.wire(control.r, d.add("r", Step(at=1.0, before=0.25, after=3.0)).y)  # at its limit from 1 s on
    d.wire(control.y, d.add("y", Step(at=2.0, after=2.875)).y)
    d.wire(control.manual, d.add("manual", Pulse(on=0.3, off=0.7)).y)
    d.wire(control.u_manual, d.add("by_hand", Constant(value=-5.0)).y)
    u = sampled(d.run(stop=3.0), "b.u", 0.1, 31)
    assert u.tolist() == [0.75] * 3 + [-5.0] * 4 + [0.75] * 3 + [1.0] * 10 + [0.5] * 11


def test_a_change_of_the_integral_gain_makes_no_jump() -> None:
    d = Diagram("tuned")
    control = d.add("b", DiscretePID(period=0.1, kp=2.0, ki=1.0))
    d.wire(control.r, d.add("r", Ramp()).y)
    d.wire(control.y, d.add("y", Constant(value=0.0)).y)
    run = d.start()
    run.advance_to(5.0)
    before = run["b.u"]
    run.set("b.ki", 10.0)
    run.advance_to(5.1)
    # The integral part at 5.1 s was added up before the change, but for the last period.
    assert run["b.u"] == pytest.approx(before + 2.0 * 0.1 + 1.0 * 0.1 * 5.0, rel=1e-12)


# --- files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "block",
    [
        DiscreteIntegrator(form="trapezoidal", period=0.1, upper=0.3),
        DiscreteTransferFunction(num=[1.0, 0.5], den=[1.0, 0.0, -0.25], period=0.1, offset=0.05),
        DiscreteStateSpace(A=[[0.5]], period=0.1, y_start=2.0),
        DiscretePID(kp=2.0, ki=1.0, period=0.1, upper=3.0),
        Delay(samples=3, period=0.1, y_start=-1.0),
    ],
    ids=lambda block: type(block).__name__,
)
def test_a_block_in_a_file_runs_as_the_one_in_python(block: Any) -> None:
    d = Diagram("file")
    made, sine = d.add("b", block), d.add("sine", Sine(amplitude=3.0, omega=5.0))
    if isinstance(block, DiscreteStateSpace):
        mux = d.add("mux", Mux(size=1))
        d.wire(mux.u1, sine.y)
        d.wire(made.u, mux.y)
    elif isinstance(block, DiscretePID):
        d.wire(made.r, sine.y)
        d.wire(made.y, d.add("y", Constant()).y)
    else:
        d.wire(made.u, sine.y)
    again = Diagram.from_json(d.to_json())
    assert again.to_json() == d.to_json()
    ours, theirs = (one.run(stop=1.0, every=0.1) for one in (d, again))
    assert np.array_equal(ours.values, theirs.values)
