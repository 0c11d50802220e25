"""Signals that are faster than the solver's steps: crossings, measures, delays, recordings and ties, against formulas.

Most diagrams here have slow states or none, so that an adaptive method takes steps of many turns, and a fixed step is
chosen as long as that. Truths are closed forms, or the formula of the signal itself on a grid of several hundred points
a turn, with the roots between these points by bisection: neither knows a solver's steps. SciPy, too, is given no more
than formulas.
"""

from __future__ import annotations

import copy
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from blocks import (
    Abs,
    Block,
    BouncingBall,
    Chirp,
    Compare,
    CompareToConstant,
    Constant,
    Counter,
    Diagram,
    DiscreteIntegrator,
    DiscreteTransferFunction,
    Expression,
    FirstOrder,
    Gain,
    Integrator,
    Logic,
    LookupTable,
    MinMax,
    Parameter,
    PMDCMotor,
    Product,
    Quantizer,
    Ramp,
    Relay,
    ResettableIntegrator,
    Results,
    Saturation,
    SecondOrder,
    Sine,
    State,
    Step,
    Sum,
    SwitchAbove,
    TransportDelay,
    Trigonometry,
    UnitDelay,
    ZeroOrderHold,
    fmu,
    output,
    search,
)
from tests.support.marks import long, long_but

Array = np.ndarray[Any, Any]
Formula = Callable[[Array], Array]

TURN = 2 * math.pi
ENGINES = ("reference", "native")
each_engine = pytest.mark.parametrize("engine", ENGINES)
METHODS = ("dopri5", "rk4", "euler", "radau")
each_method = pytest.mark.parametrize(
    ("engine", "method"),
    long_but(
        itertools.product(ENGINES, METHODS),
        # Steps of radau are looked through as others are: by the plant behind a fast relay, both engines.
        lambda engine, method: method == "dopri5" or (engine == "native" and method != "radau"),
    ),
)
LAG = 100.0
"""s; of the lag behind a gate, so slow that it gives a method no reason for short steps."""
FINE = 600
"""Points a turn of the fastest part of a signal, where its truth is taken from its formula."""
CORNERS = 12_000
"""The same for signals with corners, which a grid misses by half the distance of its points."""


# --- truths ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Course:
    """A signal by its formula alone: its values on a fine grid, and from them all that is asked here."""

    formula: Formula
    stop: float
    rate: float  # rad/s: no part of the signal turns faster
    points: int = FINE  # a turn

    @functools.cached_property
    def t(self) -> Array:
        # A number of points that has no factor in common with the turns.
        return np.linspace(0.0, self.stop, 2 * round(self.stop * self.rate / TURN * self.points / 2) + 10_007)

    @functools.cached_property
    def y(self) -> Array:
        return np.asarray(self.formula(self.t))

    def passes(self, level: float) -> tuple[Array, Array]:
        """The times at which the side (at least the level) changes, by bisection, and the sides from there on."""
        side = self.y >= level
        (k,) = np.nonzero(side[1:] != side[:-1])
        low, high, after = self.t[k], self.t[k + 1], side[k + 1]
        for _ in range(60):
            middle = (low + high) / 2
            changed = (np.asarray(self.formula(middle)) >= level) == after
            low, high = np.where(changed, low, middle), np.where(changed, middle, high)
        return high, after

    def rises(self, level: float) -> int:
        return int(np.sum(self.passes(level)[1]))

    def gated(self, level: float, lag: float = LAG) -> float:
        """What y' = (gate - y)/lag has come to, with a gate of 1 while the signal is at least the level, and 0 else."""
        times, sides = self.passes(level)
        return lagged([(0.0, float(self.y[0] >= level)), *zip(times, sides.astype(float), strict=True)], self.stop, lag)

    @property
    def peak(self) -> float:
        return float(np.max(np.abs(self.y)))

    @property
    def variation(self) -> float:
        return float(np.sum(np.abs(np.diff(self.y))))

    @property
    def mean_square(self) -> float:
        """By the trapezoidal rule: exact to (turn / points)^2 / 12 of what moves, or a point's width for each jump."""
        return float(np.trapezoid(self.y**2, self.t)) / self.stop


def lagged(pieces: Sequence[tuple[float, float]], stop: float, lag: float) -> float:
    """y(stop) of y' = (u - y)/lag from 0 on, where u goes to a value at each of some times: exact, piece by piece."""
    y = 0.0
    for (begin, u), (end, _) in pairwise([*pieces, (stop, 0.0)]):
        y = u + (y - u) * math.exp(-(end - begin) / lag)
    return y


def sine_passes(omega: float, level: float, stop: float, phase: float = 0.0) -> list[tuple[float, float]]:
    """When sin(omega t + phase) comes to the level (1) and leaves it (0), after 0 and up to stop: the closed form."""
    up, down = math.asin(level), math.pi - math.asin(level)
    made = []
    for angle, value in ((up, 1.0), (down, 0.0)):
        first = math.ceil((phase - angle) / TURN)
        last = math.floor((omega * stop + phase - angle) / TURN)
        made += [((angle + TURN * k - phase) / omega, value) for k in range(first, last + 1)]
    return sorted((t, value) for t, value in made if 0 < t <= stop)


def mean_square_of_sine(omega: float, stop: float) -> float:
    return 0.5 - math.sin(2 * omega * stop) / (4 * omega * stop)


def variation_of_sine(omega: float, stop: float) -> float:
    """Each quarter of a turn is 1, and of the last one a part."""
    quarters, rest = divmod(omega * stop, math.pi / 2)
    return quarters + (math.sin(rest) if quarters % 2 == 0 else 1 - math.cos(rest))


def test_the_truths_agree_with_one_another() -> None:
    """The closed forms of a sine, its fine grid, and SciPy with the pieces between the crossings."""
    omega, level, stop, phase = 61.7, 0.3, 7.3, 0.4
    course = Course(lambda t: np.sin(omega * t + phase), stop, omega)
    times, sides = course.passes(level)
    passes = sine_passes(omega, level, stop, phase)
    assert times == pytest.approx([t for t, _ in passes], abs=1e-13)
    assert sides.tolist() == [bool(value) for _, value in passes]
    assert course.rises(level) == sum(value == 1.0 for _, value in passes)
    y, pieces = 0.0, [(0.0, float(math.sin(phase) >= level)), *passes, (stop, 0.0)]
    for (begin, u), (end, _) in pairwise(pieces):
        y = solve_ivp(lambda t, y, u=u: (u - y) / 30, (begin, end), [y], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    assert course.gated(level, 30.0) == pytest.approx(y, abs=1e-12)
    plain = Course(lambda t: np.sin(omega * t), stop, omega)
    assert plain.mean_square == pytest.approx(mean_square_of_sine(omega, stop), rel=1e-6)
    assert plain.variation == pytest.approx(variation_of_sine(omega, stop), rel=1e-5)
    assert plain.peak == pytest.approx(1.0, rel=1e-5)


# --- thirty-odd waves, each counted, gated and measured -----------------------------------------------------------


class Mod(Block):
    """y = rate t modulo 1: a sawtooth that no event time tells of."""

    rate = Parameter(37.3)

    @output
    def y(t, rate):  # type: ignore[no-untyped-def]
        return np.mod(rate * t, 1.0)


class Floor(Block):
    """y = 1 where the whole number of rate t is even: a square wave that no event time tells of."""

    rate = Parameter(40.7)

    @output
    def y(t, rate):  # type: ignore[no-untyped-def]
        n = np.floor(rate * t)
        return 1.0 - (n - 2.0 * np.floor(n / 2.0))


class Cube(Block):
    """y = sin(omega t)^3, by a block's own equation."""

    omega = Parameter(150.0)

    @output
    def y(t, omega):  # type: ignore[no-untyped-def]
        return np.sin(omega * t) ** 3


class Zigzag(Block):
    """y = straight lines between the numbers of a table over time; a search that no crossing follows."""

    points = Parameter([0.0, 1.0], shape="n", table=True)
    values = Parameter([0.0, 1.0], shape="n", table=True)

    @output
    def y(t, points, values):  # type: ignore[no-untyped-def]
        return np.interp(t, points, values)


class Cells(Block):
    """y = whether the number of the table's points up to t is odd."""

    points = Parameter([0.0, 1.0], shape="n", table=True)

    @output
    def y(t, points):  # type: ignore[no-untyped-def]
        return np.mod(search(points, t), 2.0)


class Swing(Block):
    """x'' = -w^2 x from x = 0 on: a sine whose states are the solver's own."""

    w = Parameter(25.0)
    x = State(output=True)
    v = State(1.0)

    @x.derivative
    def dx(v, w):  # type: ignore[no-untyped-def]
        return w * v

    @v.derivative
    def dv(x, w):  # type: ignore[no-untyped-def]
        return -w * x


def source(block: Block, port: str = "y") -> Callable[[Diagram], Any]:
    return lambda d: getattr(d.add("wave", block), port)


def formula(expression: str, *sources: Callable[[Diagram], Any]) -> Callable[[Diagram], Any]:
    """An Expression of the time and of what the sources give."""

    def build(d: Diagram) -> Any:
        made = d.add("wave", Expression(expression=expression))
        for k, one in enumerate(sources, 1):
            d.wire(getattr(made, f"u{k}"), one(d))
        return made.y

    return build


def angle(rate: float) -> Callable[[Diagram], Any]:
    """rate t as a state."""

    def build(d: Diagram) -> Any:
        made = d.add("angle", Integrator())
        d.wire(made.u, d.add("rate", Constant(value=rate)).y)
        return made.y

    return build


def accelerated(rate: float) -> Callable[[Diagram], Any]:
    """rate t^2 / 2 as a state."""

    def build(d: Diagram) -> Any:
        made = d.add("angle", Integrator())
        d.wire(made.u, d.add("rate", Ramp(slope=rate)).y)
        return made.y

    return build


def settled(lag: float) -> Callable[[Diagram], Any]:
    """1 - exp(-t/lag) as a state."""

    def build(d: Diagram) -> Any:
        made = d.add("x", FirstOrder(T=lag))
        d.wire(made.u, d.add("one", Constant()).y)
        return made.y

    return build


def decaying(lag: float) -> Callable[[Diagram], Any]:
    """exp(-t/lag) as a state."""

    def build(d: Diagram) -> Any:
        made = d.add("x", FirstOrder(T=lag, y_start=1.0))
        d.wire(made.u, d.add("nothing", Constant(value=0.0)).y)
        return made.y

    return build


def through_gain(d: Diagram) -> Any:
    ramp, gain, wave = d.add("ramp", Ramp()), d.add("gain", Gain(k=110.0)), d.add("wave", Trigonometry(function="cos"))
    d.wire(gain.u, ramp.y)
    d.wire(wave.u, gain.y)
    return wave.y


def modulated_across_blocks(d: Diagram) -> Any:
    """sin(40 t + 30 sin 11 t) by four blocks."""
    carrier, tone = d.add("carrier", Ramp(slope=40.0)), d.add("tone", Sine(omega=11.0, amplitude=30.0))
    total, wave = d.add("total", Sum()), d.add("wave", Trigonometry(function="sin"))
    d.wire(total.u1, carrier.y)
    d.wire(total.u2, tone.y)
    d.wire(wave.u, total.y)
    return wave.y


def of_two(block: Block, *omegas: float) -> Callable[[Diagram], Any]:
    def build(d: Diagram) -> Any:
        wave = d.add("wave", block)
        for k, omega in enumerate(omegas, 1):
            d.wire(getattr(wave, f"u{k}"), d.add(f"sine{k}", Sine(omega=omega)).y)
        return wave.y

    return build


def behind(block: Block, omega: float) -> Callable[[Diagram], Any]:
    def build(d: Diagram) -> Any:
        wave = d.add("wave", block)
        d.wire(wave.u, d.add("sine", Sine(omega=omega)).y)
        return wave.y

    return build


def in_a_subdiagram(d: Diagram) -> Any:
    inner = Diagram("inner")
    theta, made = inner.input("theta"), inner.add("wave", Expression(expression="sin(u1)"))
    inner.wire(made.u1, theta)
    inner.output("y", made.y)
    part = d.add("part", inner)
    d.wire(part.theta, angle(170.0)(d))
    return part.y


_ZIGZAG = np.concatenate([[0.0], np.cumsum(np.random.default_rng(3).uniform(0.01, 0.03, 200))])  # up to about 4 s
_HEIGHTS = np.where(np.arange(201) % 2, 1.0, 0.0)


def looked_up(d: Diagram) -> Any:
    table = d.add("wave", LookupTable(points=_ZIGZAG.tolist(), values=_HEIGHTS.tolist()))
    d.wire(table.u, d.add("ramp", Ramp()).y)
    return table.y


@dataclass(frozen=True)
class Wave:
    """A signal as blocks and as a formula. smooth: without jumps and corners, which both sides know less exactly."""

    build: Callable[[Diagram], Any]
    formula: Formula
    rate: float
    level: float = 0.5
    stop: float = 6.0
    brief: float = 1.0  # the stop of the reference engine, which is slow
    smooth: bool = True
    measured: bool = True
    tight: bool = False  # the states themselves make the wave, and drift by their tolerance

    def course(self, stop: float) -> Course:
        return Course(self.formula, stop, self.rate, FINE if self.smooth else CORNERS)


WAVES: dict[str, Wave] = {
    "a_sine_of_50_hz": Wave(source(Sine(omega=314.159265)), lambda t: np.sin(314.159265 * t), 314.0),
    "a_sine_of_exact_turns_of_a_round_step": Wave(
        source(Sine(omega={"value": 50, "unit": "rev/s"}, phase=0.1)), lambda t: np.sin(100 * math.pi * t + 0.1), 315.0
    ),
    "a_sine_with_a_bias_far_from_0": Wave(
        source(Sine(omega=271.0, bias=1000.0)), lambda t: 1000 + np.sin(271.0 * t), 271.0, level=1000.4
    ),
    "a_sine_that_is_above_for_a_short_time_only": Wave(
        source(Sine(omega=190.0)), lambda t: np.sin(190.0 * t), 190.0, level=0.99
    ),
    "a_sine_of_a_small_amplitude": Wave(
        source(Sine(omega=220.0, amplitude=1e-6)), lambda t: 1e-6 * np.sin(220.0 * t), 220.0, level=3e-7
    ),
    "a_sine_that_is_faster_by_far": Wave(
        source(Sine(omega=5e4)), lambda t: np.sin(5e4 * t), 5e4, stop=0.05, brief=0.006
    ),
    "a_linear_chirp": Wave(
        source(Chirp(omega_start=1.0, omega_end=300.0, duration=4.0)),
        lambda t: np.sin(t + 299.0 * t**2 / 8.0), 300.0, stop=4.0, brief=2.5,
    ),
    "an_exponential_chirp": Wave(
        source(Chirp(form="exponential", omega_start=2.0, omega_end=400.0, duration=4.0)),
        lambda t: np.sin(2.0 * 4.0 / math.log(200.0) * (200.0 ** (t / 4.0) - 1.0)), 400.0, stop=4.0, brief=3.0,
    ),
    "a_formula_of_time": Wave(formula("sin(300*t)"), lambda t: np.sin(300 * t), 300.0),
    "frequency_modulation_in_a_formula": Wave(
        formula("sin(40*t + 30*sin(11*t))"), lambda t: np.sin(40 * t + 30 * np.sin(11 * t)), 370.0
    ),
    "frequency_modulation_across_blocks": Wave(
        modulated_across_blocks, lambda t: np.sin(40 * t + 30 * np.sin(11 * t)), 370.0
    ),
    "amplitude_modulation_by_a_state": Wave(
        formula("sin(300*t)*u1", settled(5.0)), lambda t: np.sin(300 * t) * (1 - np.exp(-t / 5)), 300.0, level=0.2
    ),
    "a_sine_that_dies_away": Wave(
        formula("sin(250*t)*u1", decaying(1.5)), lambda t: np.sin(250 * t) * np.exp(-t / 1.5), 250.0
    ),
    "a_phase_in_a_state": Wave(formula("sin(u1)", angle(300.0)), lambda t: np.sin(300 * t), 300.0),
    "a_phase_in_a_state_and_a_bias": Wave(
        formula("sin(u1) + 0.5", angle(314.16)), lambda t: np.sin(314.16 * t) + 0.5, 315.0, level=0.0
    ),
    "a_phase_that_accelerates_in_a_state": Wave(
        formula("sin(u1)", accelerated(100.0)), lambda t: np.sin(50 * t**2), 600.0, brief=2.0
    ),
    "a_phase_in_a_state_and_a_tone": Wave(
        formula("cos(u1 + 4*sin(31*t))", angle(120.0)), lambda t: np.cos(120 * t + 4 * np.sin(31 * t)), 245.0
    ),
    "a_phase_in_a_subdiagram": Wave(in_a_subdiagram, lambda t: np.sin(170 * t), 170.0),
    "a_gain_before_a_cosine": Wave(through_gain, lambda t: np.cos(110 * t), 110.0),
    "a_beat": Wave(of_two(Product(), 200.0, 203.0), lambda t: np.sin(200 * t) * np.sin(203 * t), 403.0),
    "a_sum_of_two_sines": Wave(of_two(Sum(), 200.0, 37.0), lambda t: np.sin(200 * t) + np.sin(37 * t), 237.0),
    "the_larger_of_two_sines": Wave(
        of_two(MinMax(), 160.0, 91.0), lambda t: np.maximum(np.sin(160 * t), np.sin(91 * t)), 160.0, level=0.4,
        smooth=False,
    ),
    "a_clipped_sine": Wave(
        behind(Saturation(lower=-0.7, upper=0.7, corners="clipped"), 180.0),
        lambda t: np.clip(np.sin(180 * t), -0.7, 0.7), 180.0, smooth=False,
    ),
    "a_sine_with_located_corners": Wave(
        behind(Saturation(lower=-0.6, upper=0.6), 90.0), lambda t: np.clip(np.sin(90 * t), -0.6, 0.6), 90.0,
        smooth=False,
    ),
    "the_size_of_a_sine": Wave(behind(Abs(), 95.0), lambda t: np.abs(np.sin(95 * t)), 95.0, smooth=False),
    "the_square_of_a_sine": Wave(formula("sin(140*t)**2"), lambda t: np.sin(140 * t) ** 2, 280.0),
    "a_power_in_an_own_block": Wave(source(Cube()), lambda t: np.sin(150 * t) ** 3, 450.0),
    "a_triangle_of_arcs": Wave(
        formula("asin(sin(100*t))"), lambda t: np.arcsin(np.sin(100 * t)), 100.0, smooth=False
    ),
    "a_product_of_three": Wave(
        formula("sin(100*t)*cos(41*t)*cos(7*t)"), lambda t: np.sin(100 * t) * np.cos(41 * t) * np.cos(7 * t), 148.0
    ),
    "a_steep_function_of_a_sine": Wave(formula("tanh(4*sin(120*t))"), lambda t: np.tanh(4 * np.sin(120 * t)), 480.0),
    "a_tangent_through_its_poles": Wave(
        formula("tan(60*t + 0.3)"), lambda t: np.tan(60 * t + 0.3), 120.0, smooth=False, measured=False
    ),
    "a_remainder": Wave(source(Mod()), lambda t: np.mod(37.3 * t, 1.0), 37.3 * TURN, smooth=False, measured=False),
    "a_whole_number_that_is_even": Wave(
        source(Floor()), lambda t: np.mod(np.floor(40.7 * t) + 1.0, 2.0), 40.7 * math.pi, smooth=False
    ),
    "a_zigzag_in_a_table": Wave(
        source(Zigzag(points=_ZIGZAG.tolist(), values=_HEIGHTS.tolist())),
        lambda t: np.interp(t, _ZIGZAG, _HEIGHTS), 400.0, stop=3.9, smooth=False,
    ),
    "a_zigzag_in_the_table_of_the_library": Wave(
        looked_up,
        lambda t: np.interp(t, _ZIGZAG, _HEIGHTS), 400.0, stop=3.9, smooth=False,
    ),
    "the_cells_of_a_table": Wave(
        source(Cells(points=(_ZIGZAG + 0.007).tolist())),
        lambda t: np.mod(np.searchsorted(_ZIGZAG + 0.007, t, side="right"), 2.0), 400.0, stop=3.9, smooth=False,
    ),
    "states_that_swing": Wave(source(Swing(), "x"), lambda t: np.sin(25 * t), 25.0, stop=20.0, brief=4.0, tight=True),
}  # fmt: skip

MEASURED = ("mean_square", "peak", "total_variation")


def switched(d: Diagram, control: Any, threshold: float = 0.0) -> Any:
    """1 where the control is at least the threshold, else 0."""
    gate = d.add("gate", SwitchAbove(threshold=threshold))
    d.wire(gate.control, control)
    d.wire(gate.u1, d.add("on", Constant(value=1.0)).y)
    d.wire(gate.u2, d.add("off", Constant(value=0.0)).y)
    return gate.y


def watched(wave: Wave) -> Diagram:
    """A wave with a counter, a gate into a slow lag, and measures."""
    d = Diagram("fast")
    y = wave.build(d)
    counter, lag = d.add("counter", Counter(threshold=wave.level)), d.add("lag", FirstOrder(T=LAG))
    d.wire(counter.u, y)
    d.wire(lag.u, switched(d, y, wave.level))
    if wave.measured:
        for kind in MEASURED:
            d.measure(kind, kind, y)
    return d


def check(wave: Wave, results: Results, stop: float, slack: float = 0.0) -> None:
    course = wave.course(stop)
    assert results["counter.y"][-1] == course.rises(wave.level)
    # The lag is exact between its crossings, but for the slack of a method of low order.
    assert results["lag.y"][-1] == pytest.approx(course.gated(wave.level), abs=slack + 1e-7 * stop / LAG)
    up = [event.t for event in results.events if event.block == "counter"]
    times, sides = course.passes(wave.level)
    # A state gives the times to the tolerance of the run; a formula to rounding errors.
    assert up == pytest.approx(times[sides].tolist(), abs=2e-6 + slack)
    if wave.measured:
        rel = 3e-5 if wave.smooth else 2e-3
        assert results.measures["mean_square"] == pytest.approx(course.mean_square, rel=rel)
        assert results.measures["peak"] == pytest.approx(course.peak, rel=rel)
        assert results.measures["total_variation"] == pytest.approx(course.variation, rel=max(rel, 1e-4))


EXPORTED = (
    "a_sine_of_50_hz",
    "a_phase_in_a_state_and_a_bias",
    "frequency_modulation_across_blocks",
    "amplitude_modulation_by_a_state",
)


@pytest.mark.parametrize(
    ("engine", "name"),
    long_but(itertools.product(ENGINES, WAVES), lambda engine, name: engine == "native" or name in EXPORTED),
)
def test_each_turn_of_a_fast_wave_is_counted_gated_and_measured(name: str, engine: str) -> None:
    wave = WAVES[name]
    stop = wave.stop if engine == "native" else wave.brief
    tolerances = {"rtol": 1e-11, "atol": 1e-13} if wave.tight else {}
    results = watched(wave).run(stop=stop, engine=engine, log=["counter.y", "lag.y"], every=stop, **tolerances)
    check(wave, results, stop)


GRID = {"rk4": 0.02, "euler": 0.02}
"""s; the step of methods with a fixed one: one whole turn of 50 Hz."""


def method_of(name: str) -> dict[str, Any]:
    return {"method": name, **({"step": GRID[name]} if name in GRID else {})}


BY_EACH = (
    "a_sine_of_exact_turns_of_a_round_step",
    "a_phase_in_a_state_and_a_bias",
    "frequency_modulation_across_blocks",
)


@pytest.mark.parametrize(
    ("name", "engine", "method"),
    long_but(
        itertools.product(BY_EACH, ENGINES, METHODS),
        lambda name, engine, method: (
            name == BY_EACH[2] if method == "radau" and engine == "native" else engine == "native" or method == "dopri5"
        ),
    ),
)
def test_each_method_sees_each_turn_of_a_fast_wave(name: str, method: str, engine: str) -> None:
    wave = WAVES[name]
    stop = wave.stop if engine == "native" else wave.brief
    results = watched(wave).run(stop=stop, engine=engine, log=["counter.y", "lag.y"], every=stop, **method_of(method))
    # Between two crossings euler's error of the lag is y'' h^2/2 at most, with y'' <= 1/LAG^2 and h <= step.
    check(wave, results, stop, slack=GRID["euler"] * stop / LAG**2 if method == "euler" else 0.0)


# --- what was reported -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("engine", "stop", "rounded"),
    [("native", 60.0, 0.30079), ("native", 6.0, 0.0388226737), ("reference", 6.0, 0.0388226737)],
)
def test_a_gate_at_50_hz_gives_its_share_to_a_slow_lag(engine: str, stop: float, rounded: float) -> None:
    """Open for two thirds of each turn: 2/3 (1 - exp(-stop/100)) and, within a turn, the exact sum over the turns."""
    d, omega = Diagram("gate"), 314.159265
    lag = d.add("lag", FirstOrder(T=100.0))
    d.wire(lag.u, switched(d, d.add("sine", Sine(omega=omega, bias=0.5)).y))
    results = d.run(stop=stop, engine=engine, log=["lag.y"], every=stop)
    exact = lagged([(0.0, 1.0), *sine_passes(omega, -0.5, stop)], stop, 100.0)
    assert exact == pytest.approx(rounded, rel=2e-5)
    assert exact == pytest.approx(2 / 3 * (1 - math.exp(-stop / 100.0)), abs=1 / 100 * 0.02)
    assert results["lag.y"][-1] == pytest.approx(exact, abs=1e-10)
    assert len(results.events) == len(sine_passes(omega, -0.5, stop))


@each_engine
def test_a_relay_of_5_hz_gives_its_share_to_a_slow_lag(engine: str) -> None:
    d, omega, stop = Diagram("relay"), 10 * math.pi, 12.0
    relay, lag = d.add("relay", Relay(on_at=0.8, off_at=-0.3, on=1.0, off=0.0)), d.add("lag", FirstOrder(T=30.0))
    d.wire(relay.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(lag.u, relay.y)
    on = [(t, value) for t, value in sine_passes(omega, 0.8, stop) if value == 1.0]
    off = [(t, value) for t, value in sine_passes(omega, -0.3, stop) if value == 0.0]
    exact = lagged([(0.0, 0.0), *sorted(on + off)], stop, 30.0)
    share = (math.pi + math.asin(0.3) - math.asin(0.8)) / TURN
    assert exact == pytest.approx(share * (1 - math.exp(-stop / 30)), abs=0.2 / 30)
    results = d.run(stop=stop, engine=engine, log=["lag.y"], every=stop)
    assert results["lag.y"][-1] == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("engine", "stop"), [("native", 60.0), ("reference", 6.0)])
@pytest.mark.parametrize(("omega", "rises"), [(20.0, 191), (62.8, 600), (100.0, 955)])
def test_counters_and_comparisons_of_a_sine_beside_a_slow_lag(
    omega: float, rises: int, engine: str, stop: float
) -> None:
    """None is missed, and none of them is taken for Zeno's."""
    d = Diagram("counted")
    sine = d.add("sine", Sine(omega=omega))
    counter, compare, beside = (
        d.add("counter", Counter()),
        d.add("above", CompareToConstant()),
        d.add("lag", FirstOrder(T=50)),
    )
    for block in (counter, compare):
        d.wire(block.u, sine.y)
    d.wire(beside.u, compare.y)
    results = d.run(stop=stop, engine=engine, log=["counter.y", "lag.y"], every=stop)
    passes = sine_passes(omega, 0.5, stop)
    expected = sum(value for _, value in passes)
    assert stop < 60.0 or expected == rises
    assert results["counter.y"][-1] == expected
    exact = lagged([(0.0, 1.0), *sine_passes(omega, 0.0, stop)], stop, 50.0)
    assert results["lag.y"][-1] == pytest.approx(exact, abs=1e-9)
    ups = [event.t for event in results.events if event.block == "counter"]
    assert ups == pytest.approx([t for t, value in passes if value == 1.0], abs=1e-13 * stop)


@pytest.mark.parametrize(("engine", "stop"), [("native", 60.0), ("reference", 3.0)])
def test_a_phase_in_a_state_opens_a_gate_and_is_measured(engine: str, stop: float) -> None:
    d, omega = Diagram("phase"), 314.16
    theta, wave, lag = (
        d.add("theta", Integrator()),
        d.add("wave", Expression(expression="sin(u1)+0.5")),
        d.add("lag", FirstOrder(T=100)),
    )
    d.wire(theta.u, d.add("rate", Constant(value=omega)).y)
    d.wire(wave.u1, theta.y)
    d.wire(lag.u, switched(d, wave.y))
    d.measure("mean_square", "mean_square", wave.y)
    results = d.run(stop=stop, engine=engine, log=["lag.y"], every=stop)
    assert results["lag.y"][-1] == pytest.approx(
        lagged([(0.0, 1.0), *sine_passes(omega, -0.5, stop)], stop, 100.0), abs=1e-8
    )
    exact = mean_square_of_sine(omega, stop) + 0.25 + (1 - math.cos(omega * stop)) / (omega * stop)
    assert results.measures["mean_square"] == pytest.approx(exact, rel=2e-5)
    if stop == 60.0:
        assert results["lag.y"][-1] == pytest.approx(0.3008, abs=5e-5)
        assert results.measures["mean_square"] == pytest.approx(0.75, abs=1e-4)


@each_engine
def test_a_controlled_oscillator_is_counted_over_many_turns(engine: str) -> None:
    d = Diagram("vco")
    wave, counter = d.add("wave", Expression(expression="sin(u1)")), d.add("counter", Counter())
    d.wire(wave.u1, angle(300.0)(d))
    d.wire(counter.u, wave.y)
    d.measure("peak", "peak", wave.y)
    stop = 10.0 if engine == "native" else 3.0
    results = d.run(stop=stop, engine=engine, log=["counter.y"], every=stop)
    assert results["counter.y"][-1] == math.floor((300 * stop - math.pi / 6) / TURN) + 1
    assert stop < 10.0 or results["counter.y"][-1] == 478
    assert results.measures["peak"] == pytest.approx(1.0, rel=2e-5)


def test_thirty_seconds_of_frequency_modulation_have_1008_rises() -> None:
    wave = WAVES["frequency_modulation_in_a_formula"]
    course = Course(wave.formula, 30.0, wave.rate)
    results = watched(wave).run(stop=30.0, engine="native", log=["counter.y"], every=30.0)
    assert results["counter.y"][-1] == course.rises(0.5) == 1008


# --- random sines ----------------------------------------------------------------------------------------------


@functools.cache
def counted_sine() -> Diagram:
    d = Diagram("random")
    sine, counter, lag = d.add("sine", Sine()), d.add("counter", Counter()), d.add("lag", FirstOrder(T=LAG))
    d.wire(counter.u, sine.y)
    d.wire(lag.u, switched(d, sine.y))
    return d


@pytest.mark.parametrize(("engine", "most", "count"), [long("native", 1000.0, 150), ("reference", 60.0, 10)])
def test_random_sines_are_counted(engine: str, most: float, count: int) -> None:
    rng = np.random.default_rng(20)
    for k in range(count):
        turns, stop = np.exp(rng.uniform(np.log([3.0, 0.01]), np.log([most, 1000.0]))).tolist()
        stop = round(stop, 4)
        method = ("dopri5", "rk4", "radau")[k % 3] if engine == "reference" or k < 30 else ("dopri5", "rk4")[k % 2]
        check_sine(engine, turns, stop, float(rng.uniform(0.0, TURN)), float(rng.uniform(-0.95, 0.95)), method)


@settings(
    deadline=None, max_examples=40, suppress_health_check=list(HealthCheck), derandomize=True, phases=[Phase.generate]
)
@given(
    turns=st.floats(3.0, 1000.0),
    stop=st.floats(0.01, 1000.0),
    phase=st.floats(0.0, TURN),
    level=st.floats(-0.95, 0.95),
)
def test_sines_of_round_numbers_are_counted(turns: float, stop: float, phase: float, level: float) -> None:
    """Whole turns in a step and levels that are 0 come up here more often than by chance."""
    check_sine("native", turns, round(stop, 4), phase, level, "rk4")


def check_sine(engine: str, turns: float, stop: float, phase: float, level: float, method: str) -> None:
    omega = turns * TURN / stop
    last = min(
        abs(math.remainder(omega * t + phase - a, TURN))
        for a in (math.asin(level), math.pi - math.asin(level))
        for t in (0.0, stop)
    )
    if last < 1e-6:
        return  # at the start or at the stop the side is a matter of rounding
    passes = sine_passes(omega, level, stop, phase)
    settings = {"method": method, **({"step": f"={stop}/50"} if method == "rk4" else {})}
    results = counted_sine().run(
        stop=stop, engine=engine, log=["counter.y", "lag.y"], every=stop, **settings,
        parameters={
            "sine.omega": omega, "sine.phase": phase, "counter.threshold": level, "gate.threshold": level,
            "lag.T": 10.0 * stop,
        },
    )  # fmt: skip
    assert results["counter.y"][-1] == sum(value for _, value in passes)
    exact = lagged([(0.0, float(math.sin(phase) >= level)), *passes], stop, 10.0 * stop)
    assert results["lag.y"][-1] == pytest.approx(exact, abs=1e-8)


# --- two signals, and events that act ------------------------------------------------------------------------------


@each_engine
def test_a_comparison_of_two_sines_opens_a_gate(engine: str) -> None:
    """sin(150 t) > sin(97 t): their difference is 2 cos(123.5 t) sin(26.5 t), whose zeros are known."""
    d, stop = Diagram("two"), 2.0
    compare, lag, counter = (
        d.add("compare", Compare(operator=">")),
        d.add("lag", FirstOrder(T=20.0)),
        d.add("counter", Counter()),
    )
    for k, omega in ((1, 150.0), (2, 97.0)):
        d.wire(getattr(compare, f"u{k}"), d.add(f"sine{k}", Sine(omega=omega)).y)
    d.wire(lag.u, compare.y)
    d.wire(counter.u, compare.y)
    zeros = [(k + 0.5) * math.pi / 123.5 for k in range(100)] + [k * math.pi / 26.5 for k in range(1, 40)]
    times = sorted(t for t in zeros if t < stop)
    # It begins above, and each zero is of one factor.
    pieces = [(0.0, 1.0), *((t, float(n % 2)) for n, t in enumerate(times))]
    assert np.min(np.diff(times)) > 1e-4
    results = d.run(stop=stop, engine=engine, log=["lag.y", "counter.y"], every=stop)
    assert results["lag.y"][-1] == pytest.approx(lagged(pieces, stop, 20.0), abs=1e-9)
    assert results["counter.y"][-1] == len(times) // 2 + 1  # the equality at 0 is no rise yet


@each_engine
def test_the_coincidences_of_two_sines_are_counted(engine: str) -> None:
    d, stop = Diagram("and"), 2.0
    both, counter, lag = d.add("both", Logic()), d.add("counter", Counter()), d.add("lag", FirstOrder(T=20.0))
    for k, omega in ((1, 157.0), (2, 131.0)):
        above = d.add(f"above{k}", CompareToConstant(constant=0.25))
        d.wire(above.u, d.add(f"sine{k}", Sine(omega=omega)).y)
        d.wire(getattr(both, f"u{k}"), above.y)
    d.wire(counter.u, both.y)
    d.wire(lag.u, both.y)
    course = Course(lambda t: np.minimum(np.sin(157 * t), np.sin(131 * t)), stop, 157.0, CORNERS)
    results = d.run(stop=stop, engine=engine, log=["lag.y", "counter.y"], every=stop)
    assert results["counter.y"][-1] == course.rises(0.25)
    assert results["lag.y"][-1] == pytest.approx(course.gated(0.25, 20.0), abs=1e-9)


@each_method
def test_an_integrator_that_a_fast_sine_resets_has_counted_since_its_last_rise(engine: str, method: str) -> None:
    d, omega, stop = Diagram("reset"), 217.0, 2.0
    clock = d.add("clock", ResettableIntegrator(threshold=0.4))
    d.wire(clock.u, d.add("one", Constant()).y)
    d.wire(clock.trigger, d.add("sine", Sine(omega=omega)).y)
    d.measure("IAE", "IAE", clock.y)
    rises = [t for t, value in sine_passes(omega, 0.4, stop) if value == 1.0]
    results = d.run(stop=stop, engine=engine, log=["clock.y"], **method_of(method))
    assert results["clock.y"][-1] == pytest.approx(stop - rises[-1], abs=1e-12)
    exact = sum((b - a) ** 2 / 2 for a, b in pairwise([0.0, *rises, stop]))
    assert results.measures["IAE"] == pytest.approx(exact, rel=1e-9)
    assert [event.t for event in results.events] == pytest.approx(rises, abs=1e-13)


@each_engine
def test_a_fast_sine_through_a_quantizer_takes_each_level(engine: str) -> None:
    """Levels -3 ... 3 of 0.3: six of them up and down in each turn, and three in the first quarter."""
    d, omega, stop = Diagram("levels"), 160.0, 1.0
    levels = d.add("levels", Quantizer(interval=0.3))
    d.wire(levels.u, d.add("sine", Sine(omega=omega)).y)
    d.measure("total_variation", "total_variation", levels.y)
    d.measure("mean_square", "mean_square", levels.y)
    edges = sorted(t for k in range(-3, 3) for t, _ in sine_passes(omega, (k + 0.5) * 0.3, stop))
    results = d.run(stop=stop, engine=engine, log=["levels.y"])
    assert [event.t for event in results.events] == pytest.approx(edges, abs=1e-13)
    assert results.measures["total_variation"] == pytest.approx(0.3 * len(edges), abs=1e-12)
    steps = [(a, b, round(math.sin(omega * (a + b) / 2) / 0.3) * 0.3) for a, b in pairwise([0.0, *edges, stop])]
    assert results.measures["mean_square"] == pytest.approx(sum((b - a) * y * y for a, b, y in steps), rel=1e-9)


@each_engine
def test_a_fast_sine_triggers_a_subdiagram(engine: str) -> None:
    """It samples a ramp at each rise."""
    inner, d = Diagram("inner"), Diagram("triggered")
    u = inner.input("u")
    inner.wire(inner.add("double", Gain(k=2.0)).u, u)
    inner.output("y", inner["double"].y)
    part = d.add("part", inner, trigger={"direction": "up"})
    d.wire(part.u, d.add("ramp", Ramp()).y)
    d.wire(part.trigger, d.add("sine", Sine(omega=173.0)).y)
    d.wire(d.add("total", Integrator()).u, part.y)
    results = d.run(stop=2.0, engine=engine, log=["part.y", "total.y"], every=2.0)
    rises = [TURN * k / 173.0 for k in range(1, 100) if TURN * k / 173.0 < 2.0]
    assert results["part.y"][-1] == pytest.approx(2 * rises[-1], abs=1e-12)
    exact = sum(2 * a * (b - a) for a, b in pairwise([0.0, *rises, 2.0]))
    assert results["total.y"][-1] == pytest.approx(exact, abs=1e-9)


@each_engine
def test_the_integral_of_the_size_of_a_fast_sine(engine: str) -> None:
    d, omega, stop = Diagram("size"), 100 * math.pi, 1.0
    size, total = d.add("size", Abs()), d.add("total", Integrator())
    d.wire(size.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(total.u, size.y)
    results = d.run(stop=stop, engine=engine, log=["total.y"], every=stop)
    assert results["total.y"][-1] == pytest.approx(2 / math.pi * stop, rel=1e-4)


@each_engine
@pytest.mark.parametrize("method", ["dopri5", "radau"])
def test_a_plant_behind_a_fast_relay_is_that_of_scipy(method: str, engine: str) -> None:
    """x'' + 0.4 x' + x = relay, by DOP853 from switch to switch, and a Counter of rises beside it."""
    d, omega, stop = Diagram("plant"), 131.0, 3.0
    relay, plant = d.add("relay", Relay(on_at=0.5, off_at=-0.5)), d.add("plant", SecondOrder(d=0.2, w=1.0))
    counter = d.add("counter", Counter(threshold=0.0))
    d.wire(relay.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(plant.u, relay.y)
    d.wire(counter.u, relay.y)
    on = [(t, 1.0) for t, value in sine_passes(omega, 0.5, stop) if value == 1.0]
    off = [(t, -1.0) for t, value in sine_passes(omega, -0.5, stop) if value == 0.0]
    x = np.zeros(2)
    for (begin, u), (end, _) in pairwise([(0.0, -1.0), *sorted(on + off), (stop, 0.0)]):
        law = lambda t, x, u=u: [x[1], u - x[0] - 0.4 * x[1]]  # noqa: E731
        x = solve_ivp(law, (begin, end), x, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    settings = {"method": method, "rtol": 1e-9, "atol": 1e-11}
    results = d.run(stop=stop, engine=engine, log=["plant.y", "counter.y"], every=stop, **settings)
    assert results["plant.y"][-1] == pytest.approx(x[0], abs=1e-8)
    assert results["counter.y"][-1] == len(on)


@each_engine
def test_a_ball_bounces_as_ever_beside_a_fast_counter(engine: str) -> None:
    """The times of its bounces are a geometric series, and the counter has its turns."""
    d, omega, stop = Diagram("ball"), 230.0, 1.5
    d.add("ball", BouncingBall(h_start=1.0, e=0.7))
    counter = d.add("counter", Counter(threshold=-0.2))
    d.wire(counter.u, d.add("sine", Sine(omega=omega)).y)
    results = d.run(stop=stop, engine=engine, log=["ball.h", "counter.y"])
    fall = math.sqrt(2 / 9.81)
    bounces = [fall * (1 + 2 * sum(0.7**k for k in range(1, n + 1))) for n in range(8)]
    found = [event.t for event in results.events if event.block == "ball"]
    assert found == pytest.approx([t for t in bounces if t < stop], abs=1e-9)
    rises = [t for t, value in sine_passes(omega, -0.2, stop) if value == 1.0]
    assert [event.t for event in results.events if event.block == "counter"] == pytest.approx(rises, abs=1e-13)


# --- measures and recordings -----------------------------------------------------------------------------------


@each_engine
@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside_a_motor"])
def test_a_sine_of_10_hz_is_measured_over_100_s(beside: bool, engine: str) -> None:
    d, omega = Diagram("sine"), 62.83
    stop = 100.0 if engine == "native" else 10.0
    sine = d.add("sine", Sine(omega=omega))
    if beside:
        motor = d.add("motor", PMDCMotor())
        d.wire(motor.v, d.add("v", Step(at=1.0, after=6.0, unit="V")).y)
    for kind in (*MEASURED, "IAE", "ISE", "ITAE"):
        d.measure(kind, kind, sine.y)
    d.measure("window", "mean_square", sine.y, start=1.0003, stop=2.0447)
    results = d.run(stop=stop, engine=engine, log=["sine.y"], every=stop)
    found = results.measures
    assert found["mean_square"] == pytest.approx(mean_square_of_sine(omega, stop), rel=2e-5)
    assert found["ISE"] == pytest.approx(mean_square_of_sine(omega, stop) * stop, rel=2e-5)
    assert found["peak"] == pytest.approx(1.0, rel=2e-5)
    assert found["total_variation"] == pytest.approx(variation_of_sine(omega, stop), rel=2e-5)
    halves, rest = divmod(omega * stop, math.pi)
    assert found["IAE"] == pytest.approx((2 * halves + 1 - math.cos(rest)) / omega, rel=2e-5)
    # Of u |sin u|: (2 k + 1) pi in the half turn number k.
    u = halves * math.pi
    last = math.sin(u + rest) - (u + rest) * math.cos(u + rest) - (math.sin(u) - u * math.cos(u))
    assert found["ITAE"] == pytest.approx((math.pi * halves**2 + abs(last)) / omega**2, rel=2e-5)
    moment = [t / 2 - math.sin(2 * omega * t) / (4 * omega) for t in (1.0003, 2.0447)]
    assert found["window"] == pytest.approx((moment[1] - moment[0]) / 1.0444, rel=2e-5)


@each_engine
def test_a_tight_tolerance_measures_tightly(engine: str) -> None:
    d, omega, stop = Diagram("tight"), 62.83, 5.0
    sine = d.add("sine", Sine(omega=omega, bias=0.25))
    d.measure("mean_square", "mean_square", sine.y)
    exact = mean_square_of_sine(omega, stop) + 0.0625 + 0.5 * (1 - math.cos(omega * stop)) / (omega * stop)
    assert d.run(stop=stop, engine=engine, rtol=1e-9).measures["mean_square"] == pytest.approx(exact, rel=1e-7)


@each_engine
def test_a_fast_signal_times_a_state_is_measured(engine: str) -> None:
    """(sin(300 t) (1 - exp(-t/5)))^2 by SciPy, in steps that follow it."""
    wave, stop = WAVES["amplitude_modulation_by_a_state"], 1.0
    d = watched(wave)
    d.measure("ISE", "ISE", "wave.y")
    exact = solve_ivp(
        lambda t, y: wave.formula(np.array([t])) ** 2, (0, stop), [0.0], "DOP853", rtol=1e-11, atol=1e-14, max_step=1e-3
    ).y[0, -1]
    results = d.run(stop=stop, engine=engine, log=["lag.y"], every=stop)
    assert results.measures["ISE"] == pytest.approx(exact, rel=3e-5)


@each_engine
@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside_a_lag"])
def test_what_is_recorded_without_every_shows_each_turn(beside: bool, engine: str) -> None:
    d, omega = Diagram("rows"), 62.83
    stop = 100.0 if engine == "native" else 20.0
    d.add("sine", Sine(omega=omega))
    if beside:
        d.wire(d.add("lag", FirstOrder(T=50.0)).u, d.add("one", Constant()).y)
    results = d.run(stop=stop, engine=engine)
    y = results["sine.y"]
    assert np.asarray(y) == pytest.approx(np.sin(omega * results.t), abs=1e-9)
    # Rows are at most 1/8 of a turn apart: a top lies within 1/16 of one.
    assert y.max() >= math.cos(TURN / 16) - 1e-9
    assert y.min() <= -math.cos(TURN / 16) + 1e-9
    assert np.max(np.diff(results.t)) <= TURN / omega / 8 * (1 + 1e-9)
    assert np.sum(np.diff(np.sign(y)) != 0) == math.floor(omega * stop / math.pi) + 1  # and once from 0 itself
    assert len(results.t) < 20 * stop * omega / TURN


@each_engine
def test_rows_on_a_grid_are_exact_there_and_no_more(engine: str) -> None:
    d, omega = Diagram("grid"), 62.83
    d.add("sine", Sine(omega=omega))
    results = d.run(stop=10.0, every=0.37, engine=engine)
    assert results.t.tolist() == pytest.approx([*(0.37 * k for k in range(28)), 10.0])
    assert np.asarray(results["sine.y"]) == pytest.approx(np.sin(omega * results.t), abs=1e-11)


# --- delays ----------------------------------------------------------------------------------------------------


@each_engine
def test_the_square_of_a_fast_sine_that_was_delayed_is_integrated(engine: str) -> None:
    """sin^2 from t = 3 on: 50 after 100 s, and exactly 40 turns a second."""
    d, omega = Diagram("delayed"), 80 * math.pi
    stop = 103.0 if engine == "native" else 4.0
    delay, square, total = (
        d.add("delay", TransportDelay(delay=3.0)),
        d.add("square", Product()),
        d.add("total", Integrator()),
    )
    d.wire(delay.u, d.add("sine", Sine(omega=omega)).y)
    for k in (1, 2):
        d.wire(getattr(square, f"u{k}"), delay.y)
    d.wire(total.u, square.y)
    results = d.run(stop=stop, engine=engine, log=["total.y"], every=stop)
    assert results["total.y"][-1] == pytest.approx((stop - 3.0) / 2, rel=1e-4)


@each_engine
@pytest.mark.parametrize("method", ["dopri5", "rk4"])
def test_a_fast_sine_is_counted_and_measured_behind_its_delay(method: str, engine: str) -> None:
    d, omega, stop = Diagram("delayed"), 251.3, 2.5
    delay, counter = d.add("delay", TransportDelay(delay=1.0)), d.add("counter", Counter())
    d.wire(delay.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(counter.u, delay.y)
    d.measure("ISE", "ISE", delay.y)
    d.measure("peak", "peak", delay.y)
    results = d.run(stop=stop, engine=engine, log=["counter.y"], **method_of(method))
    rises = [t + 1.0 for t, value in sine_passes(omega, 0.5, stop - 1.0) if value == 1.0]
    assert results["counter.y"][-1] == len(rises)
    assert [event.t for event in results.events] == pytest.approx(rises, abs=1e-7)
    assert results.measures["ISE"] == pytest.approx(mean_square_of_sine(omega, stop - 1.0) * (stop - 1.0), rel=5e-5)
    assert results.measures["peak"] == pytest.approx(1.0, rel=5e-5)


# --- ties ------------------------------------------------------------------------------------------------------


TIES = range(1, 60)
TIED = {
    "dopri5": {},
    "rk4": {"method": "rk4", "step": 0.1},
    "euler": {"method": "euler", "step": 0.1},
    "radau": {"method": "radau"},
}
OFF_GRID = {"rk4 of 0.03": {"method": "rk4", "step": 0.03}, "euler of 0.07": {"method": "euler", "step": 0.07}}
HOW = {**TIED, **OFF_GRID}
each_tied = pytest.mark.parametrize(
    ("engine", "name"),
    long_but(
        itertools.product(ENGINES, HOW),
        lambda engine, name: name != "radau" and (engine == "native" or name in ("dopri5", "rk4 of 0.03")),
    ),
)


@functools.cache
def tied(of_time: bool) -> Diagram:
    """Something that is t, as a state or as a formula, counted and switched at a level, and both held every 0.1 s."""
    d = Diagram("tied")
    if of_time:
        t = d.add("t", Ramp()).y
    else:
        x = d.add("x", Integrator())
        d.wire(x.u, d.add("one", Constant()).y)
        t = x.y
    counter, switch = d.add("counter", Counter()), switched(d, t)
    d.wire(counter.u, t)
    for name, u in {"counted": counter.y, "switched": switch}.items():
        d.wire(d.add(name, ZeroOrderHold(period=0.1)).u, u)
    return d


def held(of_time: bool, level: float, at: float, engine: str, **how: Any) -> tuple[float, float, list[float]]:
    """What both holds have from the tick at a time on, and when the crossings fired."""
    levels = {"counter.threshold": level, "gate.threshold": level}
    results = tied(of_time).run(stop=at + 0.05, engine=engine, parameters=levels, **how)
    return results["counted.y"][-1], results["switched.y"][-1], [event.t for event in results.events]


@each_tied
@pytest.mark.parametrize("of_time", [False, True], ids=["a_state", "time_itself"])
def test_a_crossing_at_a_tick_acts_before_the_tick_samples(of_time: bool, name: str, engine: str) -> None:
    late, how = {}, HOW[name]
    for k in TIES if engine == "native" and how.get("method") != "radau" else TIES[::6]:
        found = held(of_time, k / 10, k / 10, engine, **how)
        if found != (1.0, 1.0, [k / 10, k / 10]):
            late[k] = found
    assert not late


@each_tied
@pytest.mark.parametrize("ulps", [-3, 3])
def test_a_crossing_of_time_within_3_ulp_of_a_tick_belongs_to_it(ulps: int, name: str, engine: str) -> None:
    late, how = {}, HOW[name]
    for k in TIES if engine == "native" and how.get("method") != "radau" else TIES[::6]:
        found = held(True, k / 10 + ulps * math.ulp(k / 10), k / 10, engine, **how)
        if found != (1.0, 1.0, [k / 10, k / 10]):
            late[k] = found
    assert not late


@pytest.mark.parametrize(
    ("of", "ulps", "method", "engine"),
    long_but(
        itertools.product(("an_input", "a_delay"), (1, 3), ("dopri5", "rk4"), ENGINES),
        lambda of, ulps, method, engine: engine == "native" or ulps == 3,
    ),
)
def test_a_crossing_of_what_comes_from_outside_or_from_the_past_belongs_to_a_tick_too(
    of: str, ulps: int, method: str, engine: str
) -> None:
    """An input that is t, and a delay of 0.05 s whose output is t - 0.05, come to a level within 3 ulp after a tick."""
    late = {}
    for k in TIES[::12]:
        d, at = Diagram("tied"), k / 10
        level, inputs = at + ulps * math.ulp(at), {"u": ([0.0, 10.0], [0.0, 10.0], "linear")}
        if of == "an_input":
            u = d.input("u")
        else:
            delay, level, inputs = d.add("delay", TransportDelay(delay=0.05)), level - 0.05, {}
            d.wire(delay.u, d.add("t", Ramp()).y)
            u = delay.y
        counter, hold = d.add("counter", Counter(threshold=level)), d.add("hold", ZeroOrderHold(period=0.1))
        d.wire(counter.u, u)
        d.wire(hold.u, counter.y)
        results = d.run(stop=at + 0.05, engine=engine, inputs=inputs, **TIED[method])
        if (results["hold.y"][-1], [event.t for event in results.events]) != (1.0, [at]):
            late[k] = results.events
    assert not late


@pytest.mark.parametrize("engine", ["native", long("reference")])
@pytest.mark.parametrize("slope", [1e-3, 0.1])
def test_a_crossing_that_a_bend_at_a_tick_puts_off_is_not_taken_for_zeno(slope: float, engine: str) -> None:
    """u rises by 1, and from the tick on by less: 3 u comes to the level some ulp later, once."""
    for k in range(1, 40):
        d, at = Diagram("bent"), k / 10
        gain, counter = d.add("gain", Gain(k=3.0)), d.add("counter", Counter(threshold=(3 * k) / 10))
        d.wire(gain.u, d.input("u"))
        d.wire(counter.u, gain.y)
        d.wire(d.add("hold", ZeroOrderHold(period=0.1)).u, counter.y)
        table = ([0.0, at, 10.0], [0.0, at, at + slope * (10 - at)], "linear")
        results = d.run(stop=at + 0.05, engine=engine, inputs={"u": table})
        assert [event.t for event in results.events] == pytest.approx([at], abs=1e-12)


@each_tied
@pytest.mark.parametrize("of_time", [False, True], ids=["a_state", "time_itself"])
@pytest.mark.parametrize("distance", [-1e-9, 1e-9])
def test_a_crossing_that_is_a_little_off_a_tick_has_an_instant_of_its_own(
    of_time: bool, distance: float, name: str, engine: str
) -> None:
    for k in (1, 7, 30, 59):
        at = k / 10
        counted, switch, times = held(of_time, at + distance, at, engine, **HOW[name])
        assert (counted, switch) == ((1.0, 1.0) if distance < 0 else (0.0, 0.0))
        assert times == pytest.approx([at + distance] * 2, abs=1e-13)
        assert at not in times


@each_method
def test_a_fast_sine_whose_rises_are_at_ticks_is_sampled_after_them(method: str, engine: str) -> None:
    """sin(2 pi 20 t) rises through 0 at 0.05 k, to within some ulp, and is held every 0.05 s."""
    d = Diagram("at_ticks")
    hold = d.add("hold", ZeroOrderHold(period=0.05))
    d.wire(hold.u, switched(d, d.add("sine", Sine(omega=40 * math.pi)).y))
    results = d.run(stop=5.0, engine=engine, log=["hold.y"], **method_of(method))
    assert set(results["hold.y"].tolist()) == {1.0}
    rises = [event.t for event in results.events][1::2]
    assert rises == [k / 20 for k in range(1, 101)]


# --- several sample times --------------------------------------------------------------------------------------


def at_ticks(results: Results, name: str, times: Sequence[float]) -> list[float]:
    """The values from each time on: those of the last row of it."""
    rows = np.searchsorted(results.t, np.asarray(times), side="right") - 1
    return [float(value) for value in results[name][rows]]


@each_method
def test_holds_of_holds_with_other_periods(method: str, engine: str) -> None:
    """t every 0.1 s, of that every 0.3 s, of that every 0.2 s: at common ticks each sees the one before it."""
    d = Diagram("holds")
    signal = d.add("ramp", Ramp()).y
    for name, period in (("a", 0.1), ("b", 0.3), ("c", 0.2)):
        hold = d.add(name, ZeroOrderHold(period=period))
        d.wire(hold.u, signal)
        signal = hold.y
    results = d.run(stop=6.0, engine=engine, **method_of(method))
    ticks = [k / 10 for k in range(60)]
    assert at_ticks(results, "a.y", ticks) == ticks
    assert at_ticks(results, "b.y", ticks) == [3 * (k // 3) / 10 for k in range(60)]
    assert at_ticks(results, "c.y", ticks) == [3 * (2 * (k // 2) // 3) / 10 for k in range(60)]


@each_engine
def test_delays_and_sums_at_several_rates_are_their_recursions(engine: str) -> None:
    """A sine of 31 rad/s, sampled every 0.07 s, delayed by 0.1 s and summed every 0.25 s."""
    d, omega = Diagram("rates"), 31.0
    hold, delay, total = (
        d.add("hold", ZeroOrderHold(period=0.07)),
        d.add("delay", UnitDelay(period=0.1)),
        d.add("total", DiscreteIntegrator(period=0.25)),
    )
    d.wire(hold.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(delay.u, hold.y)
    d.wire(total.u, delay.y)
    results = d.run(stop=10.0, engine=engine)
    # In hundredths of a second, so that common ticks are common.
    sampled = [math.sin(omega * (7 * (n // 7) / 100)) for n in range(1001)]
    before = [0.0 if n < 10 else sampled[10 * (n // 10) - 10] for n in range(1001)]
    sums = np.cumsum([0.0, *(0.25 * before[25 * k] for k in range(40))])
    times = [n / 100 for n in range(0, 1001, 5)]
    assert at_ticks(results, "delay.y", times) == pytest.approx([before[n] for n in range(0, 1001, 5)], abs=1e-12)
    assert at_ticks(results, "total.y", times) == pytest.approx([sums[n // 25] for n in range(0, 1001, 5)], abs=1e-12)


@each_engine
@pytest.mark.parametrize(("period", "offset"), [("0.02", 0.0), ("0.02", 0.005), ("0.0201", 0.0), ("0.0199", 0.003)])
def test_a_sine_of_50_hz_that_is_sampled_too_slowly_is_its_alias(period: str, offset: float, engine: str) -> None:
    """What a hold gives is the sine at its ticks, and a filter behind it is a recursion on these samples."""
    d, stop = Diagram("alias"), 8.0
    hold = d.add("hold", ZeroOrderHold(period=float(period), offset=offset))
    slow = d.add("filter", DiscreteTransferFunction(num=[0.1], den=[1.0, -0.9], period=float(period), offset=offset))
    counter = d.add("counter", Counter(threshold=0.6))
    d.wire(hold.u, d.add("sine", Sine(omega=100 * math.pi, phase=0.3)).y)
    d.wire(slow.u, hold.y)
    d.wire(counter.u, hold.y)
    results = d.run(stop=stop, engine=engine)
    ticks = [offset + float(period) * k for k in range(round((stop - offset) / float(period)))]
    samples = [math.sin(100 * math.pi * t + 0.3) for t in ticks]
    inside = [t + float(period) / 2 for t in ticks[:-1]]
    assert at_ticks(results, "hold.y", inside) == pytest.approx(samples[:-1], abs=1e-10)
    y, filtered = 0.0, []
    for sample in samples:
        filtered.append(y)
        y = 0.9 * y + 0.1 * sample
    assert at_ticks(results, "filter.y", inside) == pytest.approx(filtered[:-1], abs=1e-10)
    sides = [False, *(sample >= 0.6 for sample in samples)]
    assert results["counter.y"][-1] == sum(not a and b for a, b in pairwise(sides))


@each_engine
def test_a_slow_hold_of_a_fast_counter_has_its_count_at_each_tick(engine: str) -> None:
    d, omega, stop = Diagram("counts"), 143.0, 4.0
    counter, hold = d.add("counter", Counter()), d.add("hold", ZeroOrderHold(period=0.37))
    d.wire(counter.u, d.add("sine", Sine(omega=omega)).y)
    d.wire(hold.u, counter.y)
    results = d.run(stop=stop, engine=engine)
    rises = np.array([t for t, value in sine_passes(omega, 0.5, stop) if value == 1.0])
    ticks = [0.37 * k for k in range(11)]
    assert at_ticks(results, "hold.y", [t + 0.01 for t in ticks]) == [float(np.sum(rises <= t)) for t in ticks]


# --- watching steers nothing -----------------------------------------------------------------------------------


@each_method
def test_neither_log_nor_grid_nor_measures_change_a_bit_of_the_states(method: str, engine: str) -> None:
    def run(measures: bool, **settings: Any) -> tuple[Any, ...]:
        d = Diagram("same")
        sine, motor, hold = (
            d.add("sine", Sine(omega=150.0)),
            d.add("motor", PMDCMotor()),
            d.add("hold", ZeroOrderHold(period=0.3)),
        )
        delay, theta = d.add("delay", TransportDelay(delay=0.5)), d.add("theta", Integrator())
        wave, lag = d.add("wave", Expression(expression="sin(u1)")), d.add("lag", FirstOrder(T=3.0))
        d.wire(motor.v, d.add("v", Step(at=0.1, after=6.0, unit="V")).y)
        d.wire(theta.u, d.add("rate", Constant(value=90.0)).y)
        d.wire(wave.u1, theta.y)
        d.wire(hold.u, sine.y)
        d.wire(delay.u, wave.y)
        d.wire(lag.u, switched(d, sine.y, 0.2))
        if measures:
            for kind in MEASURED:
                for name, of in {"sine": sine.y, "wave": wave.y, "delay": delay.y, "omega": motor.omega}.items():
                    d.measure(f"{kind}_{name}", kind, of)
        one = d.start(stop=1.0, engine=engine, **method_of(method), **settings)
        results = one.finish()
        statistics = results.statistics
        names = ("motor.omega", "motor.i", "theta.y", "lag.y", "hold.y")
        return statistics.steps, statistics.rejected, [one[name] for name in names], [*results.events]

    plain = run(False)
    assert run(False, log=[], every=0.01) == plain
    assert run(True) == plain
    assert run(True, every=0.01, log=["wave.y"]) == plain


# --- exported --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """The FMU of a wave with its counter and its gate, exported once."""
    folder = tmp_path_factory.mktemp("waves")

    @functools.cache
    def export(name: str, fmi: int) -> Path:
        d = watched(WAVES[name])
        d.output("count", "counter.y")
        d.output("share", "lag.y")
        d.output("wave", "wave.y")
        path: Path = folder / f"{name}{fmi}.fmu"
        d.export(path, fmi=fmi)
        return path

    return export


each_exported = pytest.mark.parametrize(("name", "fmi"), [(name, 2 + k % 2) for k, name in enumerate(EXPORTED)])


@each_exported
def test_an_exported_wave_is_counted_by_its_fmu(name: str, fmi: int, exported: Callable[[str, int], Path]) -> None:
    wave = WAVES[name]
    stop, course = wave.stop, wave.course(wave.stop)
    found = fmpy.simulate_fmu(
        str(exported(name, fmi)),
        fmi_type="CoSimulation",
        stop_time=stop,
        output_interval=stop / 4,
        output=["count", "share"],
    )
    assert found["count"][-1] == course.rises(wave.level)
    assert found["share"][-1] == pytest.approx(course.gated(wave.level), abs=1e-8)


@each_engine
@pytest.mark.parametrize("kind", ["CS", "ME"])
@each_exported
def test_an_exported_wave_is_counted_back_in_a_diagram(
    name: str, fmi: int, kind: str, engine: str, exported: Callable[[str, int], Path]
) -> None:
    """By the counter within it; in Model Exchange by one outside, too, that sees its output."""
    wave = WAVES[name]
    stop = wave.stop if engine == "native" else wave.brief
    course, d = wave.course(stop), Diagram("back")
    part = d.add("part", fmu(exported(name, fmi), kind))
    logged, how = ["part.count", "part.share"], {}
    if kind == "ME":
        counter = d.add("outside", Counter(threshold=wave.level))
        d.wire(counter.u, part.wave)
        logged.append("outside.y")
    else:
        how["master"] = {"step": stop / 4}
    results = d.run(stop=stop, engine=engine, log=logged, every=stop, **how)
    assert results["part.count"][-1] == course.rises(wave.level)
    assert results["part.share"][-1] == pytest.approx(course.gated(wave.level), abs=1e-8)
    assert kind == "CS" or results["outside.y"][-1] == course.rises(wave.level)


@each_engine
def test_a_wave_in_a_model_exchange_fmu_is_counted_in_and_outside(engine: str, tmp_path: Path) -> None:
    """37 Hz: 740 rises in 20 s, in steps that follow a slow lag."""
    d = Diagram("inner")
    sine, counter = d.add("wave", Sine(omega={"value": 37, "unit": "rev/s"})), d.add("counter", Counter())
    d.wire(counter.u, sine.y)
    d.output("count", counter.y)
    d.output("wave", sine.y)
    d.export(tmp_path / "wave.fmu")
    outer = Diagram("outer")
    part, outside = outer.add("part", fmu(tmp_path / "wave.fmu", "ME")), outer.add("outside", Counter())
    outer.wire(outside.u, part.wave)
    outer.wire(outer.add("lag", FirstOrder(T=50.0)).u, outer.add("one", Constant()).y)
    stop = 20.0 if engine == "native" else 2.0
    results = outer.run(stop=stop, engine=engine, log=["part.count", "outside.y"], every=stop)
    assert results["part.count"][-1] == results["outside.y"][-1] == 37 * stop


@pytest.mark.parametrize("fmi", [2, 3])
def test_ties_hold_in_an_exported_fmu(fmi: int, tmp_path: Path) -> None:
    d = copy.deepcopy(tied(of_time=False))
    for name in ("counted", "switched"):
        d.output(name, f"{name}.y")
    d.export(tmp_path / "tied.fmu", fmi=fmi)
    for k in (3, 6, 12, 47):
        found = fmpy.simulate_fmu(
            str(tmp_path / "tied.fmu"), fmi_type="CoSimulation", stop_time=k / 10 + 0.05, output_interval=k / 10 + 0.05,
            start_values={"counter.threshold": k / 10, "gate.threshold": k / 10}, output=["counted", "switched"],
        )  # fmt: skip
        assert (found["counted"][-1], found["switched"][-1]) == (1.0, 1.0), k
