"""Sources with many edges, functions, logic and wiring: exact instants, closed forms, NumPy and SciPy."""

import itertools
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.signal import chirp

from blocks import (
    Abs,
    Atan2,
    Block,
    Chirp,
    Compare,
    CompareToConstant,
    Constant,
    Counter,
    Demux,
    Diagram,
    Divide,
    EdgeDetect,
    Exp,
    Gain,
    Integrator,
    Log,
    Logic,
    MatrixGain,
    MinMax,
    ModelError,
    MultiportSwitch,
    Mux,
    Power,
    Product,
    Pulse,
    Ramp,
    Results,
    Sawtooth,
    Selector,
    Sign,
    SimulationError,
    Sine,
    Sqrt,
    SquareWave,
    Step,
    Sum,
    Switch,
    SwitchAbove,
    Trapezoid,
    Trigonometry,
    ZeroOrderHold,
)
from blocks.library import LIBRARY
from blocks.text import units
from tests.support.cases import in_one_test
from tests.support.library_variants import VARIANTS, evaluate, reads, resolved

Array = np.ndarray[Any, Any]

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""
LOCATED = 1e-12
"""A located time is within 4 ulp of its crossing, and near t = 20 that is 2e-14; slopes below 1 stretch it."""
ROOTS = 1e-7
"""Beside the infinite slope of a root a step of the fifth order gains only as much as one of the order 3/2."""
EXACT = 1e-13
"""Products and sums of a few numbers near 1, each rounded once."""


def times(results: Results, block: str, what: str = "") -> list[float]:
    return [event.t for event in results.events if event.block == block and what in ("", event.what)]


def distinct(found: list[float]) -> list[float]:
    """Times in order, without those that follow another within the error of location: sides of one corner."""
    ordered = sorted(found)
    return [t for t, before in zip(ordered, [-math.inf, *ordered], strict=False) if t - before > LOCATED]


def after(results: Results, name: str) -> tuple[Array, Array]:
    """The recorded times and the right values at them: of two rows at one time, the second."""
    right = np.append(np.diff(results.t) > 0, True)
    return np.asarray(results.t)[right], np.asarray(results[name])[right]


def integrated(block: Block, **settings: Any) -> Results:
    """A source `s` and its integral."""
    d = Diagram("source")
    source, integral = d.add("s", block), d.add("integral", Integrator())
    d.wire(integral.u, source.y)
    return d.run(**settings)


def answered(block: Block, *sources: Block, **settings: Any) -> Results:
    """A block `f` behind sources `s1`, `s2`, ..., and the integral of its output."""
    d = Diagram("function")
    f, integral = d.add("f", block), d.add("integral", Integrator())
    ports = ["u"] if len(sources) == 1 and "u" in resolved_inputs(block) else [f"u{k + 1}" for k in range(len(sources))]
    for k, (port, source) in enumerate(zip(ports, sources, strict=True)):
        d.wire(f"f.{port}", d.add(f"s{k + 1}", source).y)
    d.wire(integral.u, f.y)
    return d.run(**settings)


def resolved_inputs(block: Block) -> set[str]:
    return set(resolved(type(block).__name__, dict(block.parameters)).interface.inputs)


# --- chirp -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("form", "method"), [("linear", "linear"), ("exponential", "logarithmic")])
@pytest.mark.parametrize(("f0", "f1"), [(0.5, 4.0), (3.0, 0.2), (2.0, 2.0)])
def test_a_chirp_is_that_of_scipy(form: str, method: str, f0: float, f1: float) -> None:
    source = Chirp(
        form=form,
        omega_start={"value": f0, "unit": "rev/s"},
        omega_end={"value": f1, "unit": "rev/s"},
        duration=3.0,
        at=1.0,
        phase=math.pi / 2,
        amplitude=2.0,
        bias=0.5,
    )
    results = integrated(source, start=-1.0, stop=6.0, every=0.01, **TIGHT)
    t, y = np.asarray(results.t), np.asarray(results["s.y"])
    within = (t >= 1.0) & (t <= 4.0)
    assert y[within] == pytest.approx(0.5 + 2.0 * chirp(t[within] - 1.0, f0, 3.0, f1, method=method), abs=1e-11)
    assert y[t < 1.0] == pytest.approx(2.5, abs=1e-14), "it waits at its first value"
    assert times(results, "s") == [1.0, 4.0]
    # After the sweep: a sine of the last frequency, whose phase is that of the sweep at its end.
    swept = 2.0 * math.pi * 3.0 * ((f0 + f1) / 2 if form == "linear" or f0 == f1 else (f1 - f0) / math.log(f1 / f0))
    late = t[t > 4.0]
    assert y[t > 4.0] == pytest.approx(0.5 + 2.0 * np.cos(swept + 2.0 * math.pi * f1 * (late - 4.0)), abs=1e-11)
    # chirp() of SciPy has a method of its own for equal frequencies, as ours has.
    expected = quad(lambda s: float(chirp(s, f0, 3.0, f1, method=method)), 0.0, 3.0, epsabs=1e-12, limit=200)[0]
    end, begin = (float(results["integral.y"][t == at][-1]) for at in (4.0, 1.0))
    assert end - begin == pytest.approx(1.5 + 2.0 * expected, abs=CLOSE)


def test_the_angle_of_an_exponential_sweep_loses_no_digits_where_the_frequencies_are_close() -> None:
    given_ = {"form": "exponential", "omega_end": 1.0 + 1e-9, "duration": 5.0}
    for t in (0.5, 2.0, 5.0):
        # To first order in the ratio the sweep is linear; the next order is 1e-18.
        assert evaluate("Chirp", given_, t=t)["angle"][0] == pytest.approx(t + 1e-9 * t**2 / 10.0, abs=1e-14)


# --- edges -----------------------------------------------------------------------------------------------------


def level(at: Fraction, period: Fraction, duty: Fraction, t: Fraction) -> bool:
    return t >= at and (t - at) % period < duty * period


@pytest.mark.parametrize(
    ("period", "duty", "at"), [("0.1", "0.3", "0"), ("0.7", "0.5", "0.05"), ("0.03", "0.9", "-7.3")]
)
def test_the_edges_of_a_square_wave_do_not_drift(period: str, duty: str, at: str) -> None:
    T, d, t0 = Fraction(period), Fraction(duty), Fraction(at)
    results = integrated(SquareWave(period=float(T), duty=float(d), at=float(t0)), stop=20.0, every=20.0)
    exact = sorted(
        t for k in range(1000) for t in (t0 + k * T, t0 + (k + d) * T) if 0 < t <= 20
    )  # the instant at the start is no event
    found = times(results, "s")
    assert len(found) == len(exact) > 50
    # Four decimals and three operations are rounded, each by at most half an ulp of a number up to 20 + 7.3.
    assert np.max(np.abs([float(Fraction(a) - b) for a, b in zip(found, exact, strict=True)])) <= 3.5 * math.ulp(27.3)
    falls = sum((max(min(20, t0 + (k + d) * T), 0) - max(min(20, t0 + k * T), 0) for k in range(1000)), Fraction(0))
    assert results["integral.y"][-1] == pytest.approx(float(falls), rel=EXACT * len(found))


times_ = st.floats(-1e6, 1e6)
durations = st.floats(1e-3, 1e3)


@given(times_, durations, st.floats(0.0, 1.0), times_)
@example(0.0, 0.1, 0.5, 0.30000000000000004)
@example(0.0, 0.1, 0.5, 0.3)
@example(0.0, 0.1, 1.0, 0.6000000000000001)
@example(0.0, 0.1, 0.0, 0.7000000000000001)
@example(-0.1, 0.1, 0.5, -0.0)
@example(1e6, 1e-3, 1.0 - 1e-16, -1e6)
def test_an_edge_lies_after_t_and_none_lies_between(at: float, period: float, duty: float, t: float) -> None:
    def edge(t: np.float64) -> np.float64:
        return np.float64(SquareWave.edge.equation.function(t, *values))

    def is_high(t: np.float64) -> bool:
        return bool(SquareWave.is_high.function(t, *values))

    values = [np.float64(value) for value in (at, period, duty)]
    now = np.float64(t)
    for _ in range(5):
        following = edge(now)
        assert following > now
        assert edge(np.nextafter(following, -np.inf)) == following, "no edge is passed over"
        assert is_high(now) == is_high(np.nextafter(following, -np.inf)), "y changes at edges only"
        assert now < at or following - now <= 1.001 * period + 4 * math.ulp(1e6)
        now = following


@given(times_, durations, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), times_)
@example(0.0, 0.3, 1 / 3, 0.0, 2 / 3, 0.8999999999999999)
@example(0.0, 1.0, 0.0, 0.5, 0.0, 7.0)
def test_a_corner_of_a_trapezoid_lies_after_t_and_parts_change_at_corners_only(
    at: float, period: float, a: float, b: float, c: float, t: float
) -> None:
    total = max(a + b + c, 1.0)
    lengths = [part / total * period for part in (a, b, c)]
    assume(sum(lengths) <= period * (1.0 + 1e-15))
    values = [np.float64(value) for value in (at, period, *lengths)]
    now = np.float64(t)
    for _ in range(9):
        following = np.float64(Trapezoid.corner.equation.function(now, *values))
        assert following > now
        before = np.nextafter(following, -np.inf)
        assert Trapezoid.which.function(now, *values) == Trapezoid.which.function(before, *values)
        assert (
            Trapezoid.begin.function(now, *values[:2]) == Trapezoid.begin.function(before, *values[:2]) <= max(now, at)
        )
        now = following


@pytest.mark.parametrize(
    ("period", "duty", "at", "tick"),
    [
        ("0.2", "0.5", "0", "0.1"),
        ("0.3", "1/3", "0.1", "0.1"),
        ("0.1", "0.5", "0.05", "0.05"),
        ("0.07", "2/7", "0.01", "0.01"),
        ("0.9", "1/9", "-2.1", "0.3"),
    ],
)
@pytest.mark.parametrize("start", ["0", "0.3", "13.3", "-1.2", "99999.9"])
def test_a_tick_at_an_edge_sees_the_value_after_it(period: str, duty: str, at: str, tick: str, start: str) -> None:
    """The doubles of 3 times 0.1 and of 0.3 differ; the tick and the edge are one instant all the same."""
    T, d, t0, h = (Fraction(text) for text in (period, duty, at, tick))
    begin = Fraction(start)
    sources = {
        "wave": SquareWave(period=float(T), duty=float(d), at=float(t0)),
        "saw": Sawtooth(period=float(T), at=float(t0)),
        "hill": Trapezoid(period=float(T), rise=0.0, width=float(d * T), fall=0.0, at=float(t0)),
    }
    sampled = Diagram("sampled")
    for name, source in sources.items():
        hold = sampled.add(f"held_{name}", ZeroOrderHold(period=float(h)))
        sampled.wire(hold.u, sampled.add(name, source).y)
    results = sampled.run(start=float(begin), stop=float(begin) + 12.0, every=float(h), jumps=True)
    checked = 0
    for k in range(math.ceil(begin / h), math.floor((begin + 12) / h)):
        rows = np.flatnonzero(np.abs(np.asarray(results.t) - float(k * h)) < 1e-9)
        if k * h < 0 or not len(rows):
            continue
        row, exact = rows[-1], k * h
        for name in ("wave", "hill"):
            value = results[f"held_{name}.y"][row]
            assert value == results[f"{name}.y"][row] == float(level(t0, T, d, exact)), (name, float(exact))
        ramp = float((exact - t0) % T / T) if exact >= t0 else 0.0
        # The line is 1/T steep, and a few times are rounded.
        assert results["held_saw.y"][row] == pytest.approx(ramp, abs=8 * math.ulp(25.0 + abs(float(begin))) / float(T))
        checked += 1
    assert checked > 10


SOURCES = {
    "square": SquareWave(period=0.7, duty=0.3, at=0.2, low=-1.0, high=2.0),
    "always": SquareWave(period=0.7, duty=1.0, at=0.2),
    "never": SquareWave(period=0.7, duty=0.0, at=0.2),
    "saw": Sawtooth(period=0.7, at=0.2, low=-1.0, high=2.0),
    "trapezoid": Trapezoid(period=0.7, rise=0.1, width=0.2, fall=0.3, at=0.2, low=-1.0, high=2.0),
    "triangle": Trapezoid(period=0.7, rise=0.35, width=0.0, fall=0.35, at=0.2),
    "box": Trapezoid(period=0.7, rise=0.0, width=0.2, fall=0.0, at=0.2),
    "full": Trapezoid(period=0.3, rise=0.1, width=0.2, fall=0.0, at=0.2),
}


def expected_value(source: Block, t: Array) -> Array:
    """Piecewise linear over one period, by NumPy's table."""
    p = {key: float(getattr(source, key)) for key in resolved(type(source).__name__).values if key != "unit"}
    s = np.where(t >= p["at"], (t - p["at"]) % p["period"], -1.0)
    if isinstance(source, SquareWave):
        part = (s >= 0) & (s < p["duty"] * p["period"])
    elif isinstance(source, Sawtooth):
        part = np.maximum(s, 0.0) / p["period"]
    else:
        corners = np.cumsum([0.0, p["rise"], p["width"], p["fall"]])
        part = np.where(s < 0, 0.0, np.interp(s, corners, [0.0, 1.0, 1.0, 0.0], right=0.0))
    return p["low"] + (p["high"] - p["low"]) * np.asarray(part, dtype=float)


@pytest.mark.parametrize("name", SOURCES)
@pytest.mark.parametrize("start", [-3.03, 0.0, 0.2, 0.2345, 1.6, 100.123])
@pytest.mark.parametrize("settings", [TIGHT, {"method": "rk4", "step": 0.05}], ids=["dopri5", "rk4"])
def test_a_source_is_right_wherever_a_run_begins(name: str, start: float, settings: dict[str, Any]) -> None:
    source = SOURCES[name]
    results = integrated(source, start=start, stop=start + 5.0, every=0.0137, **settings)
    t, y = after(results, "s.y")
    edges = np.array(times(results, "s") or [math.inf])
    away = np.abs(t[:, None] - edges[None, :]).min(axis=1) > 1e-9
    away &= (
        np.abs(expected_value(source, t - 1e-9) - expected_value(source, t + 1e-9)) < 1e-6
    )  # the start may be an edge
    assert away.sum() > 300
    assert y[away] == pytest.approx(expected_value(source, t[away]), abs=1e-12)
    # Between edges the source is a line, which both methods integrate exactly.
    fine = np.unique(np.concatenate([edges[np.isfinite(edges)], [start, start + 5.0]]))
    middles = (fine[1:] + fine[:-1]) / 2
    area = float(np.sum(np.diff(fine) * expected_value(source, middles)))
    assert results["integral.y"][-1] == pytest.approx(area, abs=1e-11)


@pytest.mark.parametrize(
    ("rise", "width", "fall"), [(0.1, 0.4, 0.2), (0.0, 0.3, 0.7), (0.5, 0.0, 0.5), (0.0, 1.0, 0.0)]
)
def test_the_integral_of_a_trapezoid_is_its_height_times_half_its_sides(rise: float, width: float, fall: float) -> None:
    source = Trapezoid(rise=rise, width=width, fall=fall, low=-1.0, high=3.0, at=0.5)
    results = integrated(source, stop=7.5, **TIGHT)
    assert results["integral.y"][-1] == pytest.approx(-7.5 + 7 * 4.0 * (rise / 2 + width + fall / 2), abs=1e-11)
    lengths = np.unique(np.cumsum([0.0, rise, width, fall])[[0, 1, 2, 3]])
    corners = sorted({0.5 + k + float(s) for k in range(8) for s in lengths if 0.5 + k + s <= 7.5})
    assert times(results, "s") == pytest.approx(corners, abs=4 * math.ulp(7.5))


def test_three_parts_that_fill_a_period_up_to_rounding_are_taken() -> None:
    assert 0.1 + 0.2 > 0.3
    results = integrated(Trapezoid(period=0.3, rise=0.1, width=0.0, fall=0.2), stop=3.0, **TIGHT)
    assert results["integral.y"][-1] == pytest.approx(1.5, abs=1e-12)
    assert len(results.events) == 20


def test_a_fall_or_a_rise_of_nothing_is_a_jump_and_y_stays_within_its_values() -> None:
    results = integrated(Trapezoid(period=0.1, rise=1e-12, width=0.05, fall=0.0), stop=30.0, every=0.05)
    assert results["s.y"].min() == 0.0
    assert results["s.y"].max() == 1.0


# --- functions -------------------------------------------------------------------------------------------------

WAVE = {"amplitude": 1.7, "omega": 2.0, "phase": 0.3, "bias": 0.4}


def wave(t: Any) -> Any:
    return 0.4 + 1.7 * np.sin(2.0 * t + 0.3)


def zeros_of(f: Any, stop: float) -> list[float]:
    """All roots between 0 and stop that lie apart by more than 0.01, by bisection."""
    grid = np.linspace(0.0, stop, 5000)
    values = f(grid)
    return [
        brentq(f, grid[k], grid[k + 1], xtol=1e-15) for k in np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    ]


def integral_of(f: Any, stop: float, corners: list[float]) -> float:
    ends = [0.0, *corners, stop]
    return sum(quad(f, a, b, epsabs=1e-12, limit=200)[0] for a, b in itertools.pairwise(ends))


@pytest.mark.parametrize(
    ("block", "law", "corner"),
    [
        (Abs(), np.abs, True),
        (Sign(), np.sign, True),
        (Sqrt(form="signed"), lambda u: np.sign(u) * np.sqrt(np.abs(u)), False),
        (Power(), np.square, False),
        (Power(exponent=3.0), lambda u: u**3, False),
        (Power(form="signed", exponent=2.0), lambda u: u * np.abs(u), True),
        (Power(form="signed", exponent=0.5), lambda u: np.sign(u) * np.sqrt(np.abs(u)), False),
        (Exp(), np.exp, False),
        (Trigonometry(), np.sin, False),
        (Trigonometry(function="cos"), np.cos, False),
        (Trigonometry(function="atan"), np.arctan, False),
        (Trigonometry(function="sinh"), np.sinh, False),
        (Trigonometry(function="cosh"), np.cosh, False),
        (Trigonometry(function="tanh"), np.tanh, False),
        (Trigonometry(function="asinh"), np.arcsinh, False),
    ],
    ids=lambda x: repr(x) if isinstance(x, Block) else "",
)
def test_functions_of_a_sine(block: Block, law: Any, corner: bool) -> None:
    results = answered(block, Sine(**WAVE), stop=10.0, every=0.01, **TIGHT)
    corners = zeros_of(wave, 10.0)
    found = distinct(times(results, "f"))
    assert found == (pytest.approx(corners, abs=LOCATED) if corner else [])
    t, y = after(results, "f.y")
    away = np.abs(t[:, None] - np.array(corners)).min(axis=1) > 1e-9
    assert y[away] == pytest.approx(law(wave(t[away])), abs=1e-12)
    expected = integral_of(lambda t: float(law(wave(t))), 10.0, corners)
    steep = "Sqrt" in repr(block) or "exponent=0.5" in repr(block)
    assert results["integral.y"][-1] == pytest.approx(expected, abs=ROOTS if steep else CLOSE)


@pytest.mark.parametrize(
    ("block", "law"),
    [
        (Sqrt(), np.sqrt),
        (Power(exponent=-1.5), lambda u: u**-1.5),
        (Log(), np.log),
        (Log(base="10"), np.log10),
        (Log(base="2"), np.log2),
        (Trigonometry(function="tan"), np.tan),
        (Trigonometry(function="asin"), np.arcsin),
        (Trigonometry(function="acos"), np.arccos),
        (Trigonometry(function="atanh"), np.arctanh),
        (Trigonometry(function="acosh"), np.arccosh),
    ],
    ids=lambda item: repr(item) if isinstance(item, Block) else None,
)
def test_functions_within_their_domains(block: Block, law: Any) -> None:
    bias = 1.5 if block == Trigonometry(function="acosh") else 0.5
    results = answered(block, Sine(amplitude=0.4, bias=bias), stop=5.0, every=0.1, **TIGHT)
    u = bias + 0.4 * np.sin(results.t)
    assert results["f.y"] == pytest.approx(law(u), rel=1e-13, abs=1e-13)
    expected = quad(lambda t: float(law(bias + 0.4 * math.sin(t))), 0.0, 5.0, epsabs=1e-12)[0]
    assert results["integral.y"][-1] == pytest.approx(expected, abs=CLOSE)


@pytest.mark.parametrize("block", [Sqrt(), Log(), Power(exponent=0.5), Trigonometry(function="acosh")], ids=repr)
def test_a_function_beyond_its_domain_stops_the_run_and_names_its_block(block: Block) -> None:
    with pytest.raises(SimulationError, match=r"E303 f\.y: ") as caught:
        answered(block, Ramp(before=2.0, slope=-1.0), stop=4.0, every=0.1)
    end = 1.0 if block == Trigonometry(function="acosh") else 2.0
    assert end - 0.101 < caught.value.results.t[-1] <= end


def test_a_division_by_zero_stops_the_run_and_names_its_block() -> None:
    results = answered(Divide(), Sine(**WAVE), Ramp(before=1.0), stop=2.0, every=0.1, **TIGHT)
    assert results["f.y"] == pytest.approx(wave(np.asarray(results.t)) / (1.0 + np.asarray(results.t)), abs=EXACT)
    with pytest.raises(SimulationError, match=r"E303 f\.y: "):
        answered(Divide(), Constant(), Step(at=1.0, before=1.0, after=0.0), stop=2.0)


def test_a_root_behind_an_absolute_value_is_never_that_of_a_negative_number() -> None:
    """The trial steps over the corner see |u| too, or the run would end there."""
    d = Diagram("root")
    for name, block in {"s": Sine(), "f": Abs(), "root": Sqrt(), "integral": Integrator()}.items():
        d.add(name, block)
    for sink, source in itertools.pairwise(["s", "f", "root", "integral"][::-1]):
        d.wire(f"{sink}.u", f"{source}.y")
    results = d.run(stop=9.0, **TIGHT)
    expected = integral_of(lambda t: math.sqrt(abs(math.sin(t))), 9.0, [math.pi, 2 * math.pi])
    assert results["integral.y"][-1] == pytest.approx(expected, abs=ROOTS)


def test_a_tank_empties_by_torricellis_law() -> None:
    """dh/dt = -sqrt(h): h = (1 - t/2)^2, up to where it is empty."""
    d = Diagram("tank")
    h, root, gain = d.add("h", Integrator(y_start=1.0)), d.add("root", Sqrt(form="signed")), d.add("out", Gain(k=-1.0))
    d.wire(root.u, h.y)
    d.wire(gain.u, root.y)
    d.wire(h.u, gain.y)
    results = d.run(stop=1.9, every=0.1, **TIGHT)
    assert results["h.y"] == pytest.approx((1.0 - np.asarray(results.t) / 2.0) ** 2, abs=CLOSE)


def test_sign_is_zero_at_zero() -> None:
    levels = [0.0, 2.0, 0.0, -3.0, 0.0]
    d = Diagram("sign")
    total = d.add("total", Sum(signs="++++"))
    for k, (low, high) in enumerate(itertools.pairwise(levels)):
        d.wire(f"total.u{k + 1}", d.add(f"step{k}", Step(at=k + 1.0, after=high - low)).y)
    sign = d.add("sign", Sign())
    d.wire(sign.u, total.y)
    t, y = after(d.run(stop=4.5, every=0.5), "sign.y")
    assert y.tolist() == [float(np.sign(levels[int(s)])) for s in t]


@pytest.mark.parametrize(("start", "begin"), [(0.3, 0.3), (-1.0, -1.0)])
def test_the_angle_of_a_turning_point_is_its_time_and_jumps_at_pi(start: float, begin: float) -> None:
    results = answered(
        Atan2(),
        Sine(amplitude=3.0),
        Sine(amplitude=3.0, phase=math.pi / 2),
        start=start,
        stop=20.0,
        every=0.01,
        **TIGHT,
    )
    t, y = after(results, "f.y")
    turned = (t + math.pi) % (2 * math.pi) - math.pi
    away = np.abs(np.abs(turned) - math.pi) > 1e-9
    assert y[away] == pytest.approx(turned[away], abs=1e-12)
    passed = [k * math.pi for k in range(-1, 7) if begin < k * math.pi <= 20.0]
    assert times(results, "f", "upper") == pytest.approx(passed, abs=LOCATED)
    # The integral of the angle over a turn is 0; a jump missed by dt would leave 2 pi dt.
    end = 20.0 - 6.0 * math.pi
    assert results["integral.y"][-1] == pytest.approx((end**2 - begin**2) / 2, abs=CLOSE)


@pytest.mark.parametrize(("u1", "u2", "angle"), [(0.0, -2.0, math.pi), (0.0, 0.0, 0.0), (-1.0, 0.0, -math.pi / 2)])
def test_angles_at_the_axes(u1: float, u2: float, angle: float) -> None:
    results = answered(Atan2(), Constant(value=u1), Constant(value=u2), stop=1.0)
    assert results["f.y"][-1] == angle


@pytest.mark.parametrize("function", ["max", "min"])
@pytest.mark.parametrize("n", [1, 2, 3, 5, 9, 16])
def test_each_change_of_the_lead_is_an_instant_and_nothing_else_is(n: int, function: str) -> None:
    rng = np.random.default_rng(n)
    sines = [Sine(amplitude=1.0 + a, omega=0.5 + w, phase=6.0 * p, bias=0.3 * b) for a, w, p, b in rng.random((n, 4))]
    results = answered(MinMax(function=function, size=n), *sines, stop=10.0, every=0.01, **TIGHT)

    def inputs(t: Any) -> Array:
        return np.array([s.bias + s.amplitude * np.sin(s.omega * t + s.phase) for s in sines])

    best = np.argmax if function == "max" else np.argmin
    grid = np.linspace(0.0, 10.0, 20001)
    leader = best(inputs(grid), axis=0)
    corners = [
        brentq(
            lambda t, i=leader[k], j=leader[k + 1]: float(inputs(t)[i] - inputs(t)[j]), grid[k], grid[k + 1], xtol=1e-15
        )
        for k in np.flatnonzero(np.diff(leader))
    ]
    assert distinct(times(results, "f")) == pytest.approx(corners, abs=LOCATED)
    t, y = after(results, "f.y")
    extreme = np.max if function == "max" else np.min
    assert y == pytest.approx(extreme(inputs(t), axis=0), abs=1e-12)
    expected = integral_of(lambda t: float(extreme(inputs(t))), 10.0, corners)
    assert results["integral.y"][-1] == pytest.approx(expected, abs=CLOSE)


def test_the_largest_of_three_phases_has_the_mean_of_a_rectifier() -> None:
    """The mean of the largest of three sines in thirds of a turn is 3 sqrt(3)/(2 pi)."""
    phases = [Sine(omega={"value": 1.0, "unit": "rev/s"}, phase=2.0 * math.pi * k / 3.0) for k in range(3)]
    results = answered(MinMax(size=3), *phases, stop=4.0, **TIGHT)
    assert results["integral.y"][-1] / 4.0 == pytest.approx(3.0 * math.sqrt(3.0) / (2.0 * math.pi), abs=CLOSE)
    assert len(distinct(times(results, "f"))) == 12


def test_corners_behind_ticks_are_seen_at_the_tick_itself() -> None:
    """What is sampled behind a corner sees the input of this tick, not that of the last one."""
    d = Diagram("ticks")
    step, hold = d.add("step", Step(at=0.25, before=1.0, after=-2.0)), d.add("hold", ZeroOrderHold(period=0.1))
    d.wire(hold.u, step.y)
    for name, block in (("abs", Abs()), ("max", MinMax()), ("root", Sqrt(form="signed"))):
        f, held = d.add(name, block), d.add(f"held_{name}", ZeroOrderHold(period=0.1))
        d.wire(f"{name}.u1" if name == "max" else f"{name}.u", hold.y)
        d.wire(held.u, f.y)
    zero = d.add("zero", Constant(value=0.0))
    d.wire("max.u2", zero.y)
    results = d.run(stop=0.3, every=0.1)
    assert [results[f"held_{name}.y"][-1] for name in ("abs", "max", "root")] == [2.0, 0.0, -math.sqrt(2.0)]


def test_units_of_functions() -> None:
    def ports(name: str, **given: Any) -> dict[str, str]:
        interface = resolved(name, given).interface
        return {port.name: port.unit for port in (*interface.inputs.values(), *interface.outputs.values())}

    assert ports("Trigonometry") == {"u": "rad", "y": "1"}
    assert ports("Trigonometry", function="acos") == {"u": "1", "y": "rad"}
    assert ports("Trigonometry", function="tanh") == {"u": "1", "y": "1"}
    assert ports("Atan2", unit_u="m") == {"u1": "m", "u2": "m", "y": "rad"}
    assert units.same_quantity(ports("Sqrt", unit="V")["u"], "V2")
    matrix = resolved("MatrixGain", {"K": np.ones((2, 3)), "unit": "N", "unit_u": "m"}).interface
    assert set(matrix.declared_units(matrix.declaration.parameters["K"])) == {"N/m"}
    d = Diagram("wrong")
    d.add("angle", Constant(unit="V"))
    d.add("sine", Trigonometry())
    d.wire("sine.u", "angle.y")
    with pytest.raises(ModelError, match="E104"):
        d.check()


def test_a_multiport_switch_changes_where_its_index_passes_a_half() -> None:
    d = Diagram("ports")
    switch = d.add("switch", MultiportSwitch(size=4))
    for k in range(4):
        d.wire(f"switch.u{k + 1}", d.add(f"c{k + 1}", Constant(value=10.0 * (k + 1))).y)
    d.wire(switch.index, d.add("index", Sine(amplitude=3.0, bias=2.0)).y)
    results = d.run(stop=2.0 * math.pi, every=0.01)
    index = 2.0 + 3.0 * np.sin(np.asarray(results.t))
    assert results["switch.y"] == pytest.approx(10.0 * np.clip(np.floor(index + 0.5), 1.0, 4.0))
    rising = [math.asin(x) for x in (0.5 / 3.0, 1.5 / 3.0)]
    falling = [math.pi - math.asin(x) for x in (1.5 / 3.0, 0.5 / 3.0, -0.5 / 3.0)]
    located = [*rising, *falling, 2.0 * math.pi - math.asin(0.5 / 3.0)]
    assert times(results, "switch") == pytest.approx(located, abs=LOCATED)


@pytest.mark.parametrize(
    ("index", "chosen"), [(-7.0, 1), (1.5, 2), (math.nextafter(1.5, 0.0), 1), (3.0, 3), (2.5, 3), (1e9, 3)]
)
def test_a_multiport_switch_begins_with_the_input_nearest_to_its_index(index: float, chosen: int) -> None:
    d = Diagram("jump")
    switch = d.add("switch", MultiportSwitch())
    for k in range(3):
        d.wire(f"switch.u{k + 1}", d.add(f"c{k + 1}", Constant(value=k + 1.0)).y)
    d.wire(switch.index, d.add("index", Step(at=1.0, before=2.0, after=index)).y)
    assert d.run(stop=2.0)["switch.y"][-1] == d.run(start=1.0, stop=2.0)["switch.y"][0] == chosen


def test_polynomials_dot_products_and_norms_are_those_of_numpy() -> None:
    random = np.random.default_rng(5)
    for size in (1, 2, 5):
        u, v, c = random.normal(size=(3, size))
        assert evaluate("Polynomial", {"c": c}, u=1.7)["y"] == pytest.approx([np.polyval(c, 1.7)], rel=EXACT)
        assert evaluate("DotProduct", {"size": size}, u1=u, u2=v)["y"] == pytest.approx([np.dot(u, v)], abs=EXACT)
        for kind, order in (("2", 2), ("1", 1), ("inf", np.inf)):
            made = evaluate("Norm", {"kind": kind, "size": size}, u=u)["y"]
            assert made == pytest.approx([np.linalg.norm(u, order)], rel=EXACT)


# --- matrices and selectors ------------------------------------------------------------------------------------


def test_a_matrix_gain_is_the_product_and_its_zeros_make_no_dependency() -> None:
    K = np.array([[1.0, 0.0, -2.0], [0.0, 0.0, 3.0]])
    assert reads("MatrixGain", {"K": K}, "output:y") == [{"u[0]", "u[2]"}, {"u[2]"}]
    d = Diagram("matrix")
    sources = [d.add(f"s{k}", Sine(omega=k + 1.0)) for k in range(3)]
    mux, gain, demux = d.add("mux", Mux(size=3)), d.add("gain", MatrixGain(K=K)), d.add("demux", Demux())
    for k, source in enumerate(sources):
        d.wire(f"mux.u{k + 1}", source.y)
    d.wire(gain.u, mux.y)
    d.wire(demux.u, gain.y)
    results = d.run(stop=2.0, every=0.1)
    u = np.array([np.sin((k + 1.0) * np.asarray(results.t)) for k in range(3)])
    assert np.array([results["demux.y1"], results["demux.y2"]]) == pytest.approx(K @ u, abs=EXACT)


def test_a_triangular_matrix_closes_no_loop() -> None:
    d = Diagram("chain")
    d.add("gain", MatrixGain(K=[[2.0, 0.0], [3.0, 4.0]]))
    d.wire("gain.u[0]", d.add("one", Constant()).y)
    d.wire("gain.u[1]", "gain.y[0]")
    assert d.run(stop=0.1)["gain.y"][-1].tolist() == [2.0, 11.0]
    full = Diagram("loop")
    full.add("gain", MatrixGain(K=[[2.0, 1.0], [3.0, 4.0]]))
    full.wire("gain.u[0]", full.add("one", Constant()).y)
    full.wire("gain.u[1]", "gain.y[0]")
    with pytest.raises(ModelError, match=r"E102 .* algebraic loop"):
        full.check()


def test_a_selector_picks_elements_with_their_units_and_costs_nothing() -> None:
    d = Diagram("select")
    mux = d.add("mux", Mux(size=3))
    for k, unit in enumerate(("V", "A", "m")):
        d.wire(f"mux.u{k + 1}", d.add(f"s{k}", Constant(value=k + 1.0, unit=unit)).y)
    chosen = d.add("chosen", Selector(elements=[2, 0, 2], size=3))
    d.wire(chosen.u, mux.y)
    meters = d.add("meters", Gain(unit="m", unit_u="m"))
    d.wire(meters.u, "chosen.y[2]")
    gain = d.add("gain", MatrixGain(K=np.eye(3)))
    d.wire(gain.u, chosen.y)
    results = d.run(stop=0.1)
    assert results["gain.y"][-1].tolist() == [3.0, 1.0, 3.0]
    assert results["meters.y"][-1] == 3.0
    assert [made.tape.results for made in d.check().instances if made.path == "chosen"] == [{}], "nothing is computed"
    d.add("wrong", Gain(unit="m", unit_u="m"))
    d.wire("wrong.u", "chosen.y[1]")
    with pytest.raises(ModelError, match=r"E104 .*V.*m"):
        d.check()


# --- logic -----------------------------------------------------------------------------------------------------

RELATIONS = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "equal": np.equal,
    "unequal": np.not_equal,
}


@pytest.mark.parametrize("operator", RELATIONS)
@pytest.mark.parametrize("constant", [False, True])
def test_relations_of_signals_that_meet_and_stay_equal(operator: str, constant: bool) -> None:
    """u1 is 0, 1, 2, 1, 0, each for 1 s; u2 is 1. The relation is that of numbers at all times."""
    levels = [0.0, 1.0, 2.0, 1.0, 0.0]
    d = Diagram("relations")
    total = d.add("total", Sum(signs="++++"))
    for k, (low, high) in enumerate(itertools.pairwise(levels)):
        d.wire(f"total.u{k + 1}", d.add(f"step{k}", Step(at=k + 1.0, after=high - low)).y)
    if constant:
        made = d.add("compare", CompareToConstant(operator=operator, constant=1.0))
        d.wire(made.u, total.y)
    else:
        made = d.add("compare", Compare(operator=operator))
        d.wire(made.u1, total.y)
        d.wire(made.u2, d.add("one", Constant()).y)
    for start in (0.0, 1.0, 2.25, 3.0):
        t, y = after(d.run(start=start, stop=4.5, every=0.25), "compare.y")
        assert y.tolist() == [float(RELATIONS[operator](levels[int(s)], 1.0)) for s in t]


@pytest.mark.parametrize("operator", RELATIONS)
@pytest.mark.parametrize("settings", [TIGHT, {"method": "rk4", "step": 0.1}], ids=["dopri5", "rk4"])
def test_relations_of_sines_change_where_they_cross(operator: str, settings: dict[str, Any]) -> None:
    d = Diagram("crossing")
    made, integral = d.add("compare", Compare(operator=operator)), d.add("integral", Integrator())
    d.wire(made.u1, d.add("s1", Sine(**WAVE)).y)
    d.wire(made.u2, d.add("s2", Sine(omega=3.0)).y)
    d.wire(integral.u, made.y)
    results = d.run(stop=10.0, every=0.01, **settings)

    def difference(t: Any) -> Any:
        return wave(t) - np.sin(3.0 * t)

    crossings = zeros_of(difference, 10.0)
    assert distinct(times(results, "compare")) == pytest.approx(crossings, abs=LOCATED)
    t, y = after(results, "compare.y")
    away = np.abs(t[:, None] - np.array(crossings)).min(axis=1) > 1e-9
    assert y[away].tolist() == RELATIONS[operator](difference(t[away]), 0.0).tolist()
    ends = np.array([0.0, *crossings, 10.0])
    holds = RELATIONS[operator](difference((ends[1:] + ends[:-1]) / 2), 0.0)
    assert results["integral.y"][-1] == pytest.approx(float(np.sum(np.diff(ends) * holds)), abs=1e-9)


OPERATORS: dict[str, Any] = {
    "and": all,
    "or": any,
    "nand": lambda bits: not all(bits),
    "nor": lambda bits: not any(bits),
    "xor": lambda bits: sum(bits) % 2 == 1,
    "not": lambda bits: not bits[0],
}


@pytest.mark.parametrize(("operator", "n"), [(o, n) for o in OPERATORS for n in (1, 2, 3, 4) if o != "not" or n == 1])
def test_operators_over_all_combinations_of_bits(operator: str, n: int) -> None:
    """Square waves of halved frequency count through all combinations."""
    d = Diagram("bits")
    d.add("logic", Logic(operator=operator, size=n))
    for k in range(n):
        wave = d.add(f"wave{k}", SquareWave(period=2.0 ** (k + 1), at=-64.0))
        bit = d.add(f"bit{k}", CompareToConstant(constant=0.5))
        d.wire(bit.u, wave.y)
        d.wire(f"logic.u{k + 1}", bit.y)
    results = d.run(start=0.5, stop=2.0**n + 0.5, every=1.0)
    for row, t in enumerate(results.t):
        if t % 1.0 == 0.5:
            bits = [t % 2.0 ** (k + 1) < 2.0**k for k in range(n)]
            assert results["logic.y"][row] == float(OPERATORS[operator](bits)), bits


def test_a_logic_block_takes_bools_only() -> None:
    d = Diagram("bools")
    d.add("not", Logic(operator="not"))
    d.wire("not.u1", d.add("one", Constant()).y)
    with pytest.raises(ModelError, match=r"E104 not\.u1: is a bool"):
        d.check()


def test_switches_choose_at_exact_instants() -> None:
    d = Diagram("switch")
    pulse, on = d.add("pulse", Pulse(on=0.3, off=1.1)), d.add("on", CompareToConstant(constant=0.5))
    switch, above = d.add("switch", Switch()), d.add("above", SwitchAbove(threshold=0.5))
    ramp, sine = d.add("ramp", Ramp()), d.add("sine", Sine())
    d.wire(on.u, pulse.y)
    d.wire(switch.control, on.y)
    d.wire(above.control, sine.y)
    for chooser in ("switch", "above"):
        d.wire(f"{chooser}.u1", ramp.y)
        d.wire(f"{chooser}.u2", sine.y)
        d.add(f"of_{chooser}", Integrator())
        d.wire(f"of_{chooser}.u", f"{chooser}.y")
    results = d.run(stop=3.0, every=0.1, **TIGHT)
    assert times(results, "on") == [0.3, 1.1]
    sines = [math.cos(0.0) - math.cos(0.3), math.cos(1.1) - math.cos(3.0)]
    assert results["of_switch.y"][-1] == pytest.approx(sum(sines) + (1.1**2 - 0.3**2) / 2, abs=CLOSE)
    low, high = math.pi / 6, 5 * math.pi / 6
    assert times(results, "above") == pytest.approx([low, high], abs=LOCATED)
    expected = 1.0 - math.cos(low) + math.cos(high) - math.cos(3.0) + (high**2 - low**2) / 2
    assert results["of_above.y"][-1] == pytest.approx(expected, abs=CLOSE)


@pytest.mark.parametrize("edge", ["rise", "fall", "either"])
@pytest.mark.parametrize("last", [False, True])
def test_edges_are_seen_at_the_tick_after_them(edge: str, last: bool) -> None:
    d = Diagram("edges")
    wave, bit = d.add("wave", SquareWave(period=0.5, duty=0.4, at=0.27)), d.add("bit", CompareToConstant(constant=0.5))
    detect = d.add("detect", EdgeDetect(edge=edge, period=0.1, offset=0.05, last_start=last))
    d.wire(bit.u, wave.y)
    d.wire(detect.u, bit.y)
    results = d.run(stop=3.0, every=0.01)
    t, y = after(results, "detect.y")

    def u(n: int) -> bool:
        """The input at tick n, in hundredths of a second: no edge lies at a tick."""
        return last if n < 0 else 5 + 10 * n >= 27 and (5 + 10 * n - 27) % 50 < 20

    for time, value in zip(t, y, strict=True):
        n = (round(time * 100) - 5) // 10
        rose, fell = (u(n) and not u(n - 1), u(n - 1) and not u(n)) if n >= 0 else (False, False)
        assert value == float({"rise": rose, "fall": fell, "either": rose or fell}[edge]), time
    assert 0 < np.sum(y) < len(y)


def test_an_edge_at_a_tick_is_seen_at_that_tick() -> None:
    d = Diagram("edge")
    step, bit = d.add("step", Step(at=0.3)), d.add("bit", CompareToConstant(constant=0.5))
    detect = d.add("detect", EdgeDetect(period=0.1))
    d.wire(bit.u, step.y)
    d.wire(detect.u, bit.y)
    t, y = after(d.run(stop=0.6, every=0.1), "detect.y")
    assert t[y == 1.0].tolist() == [0.3]


def test_a_counter_counts_every_rise_from_its_start_on() -> None:
    d = Diagram("count")
    counter = d.add("counter", Counter(threshold=0.5, first=10.0))
    d.wire(counter.u, d.add("s", Sine(omega=7.0)).y)
    results = d.run(stop=20.0, every=0.05)
    rises = (math.pi / 6 + 2.0 * math.pi * np.arange(30)) / 7.0
    rises = rises[rises <= 20.0]
    assert times(results, "counter", "rise") == pytest.approx(rises, abs=LOCATED)
    t, y = after(results, "counter.y")
    away = np.abs(t[:, None] - rises).min(axis=1) > 1e-9
    assert y[away].tolist() == (10.0 + (t[away, None] >= rises).sum(axis=1)).tolist()


@pytest.mark.parametrize("form", ["stop", "wrap"])
@pytest.mark.parametrize("start", [0.0, 8.0])
def test_a_counter_of_bools_ends_at_its_limit_and_is_reset(form: str, start: float) -> None:
    """Rises at 0.5, 1.5, 2.5, ...; reset from 7.25 to 9.75."""
    d = Diagram("count")
    wave, bit = d.add("wave", SquareWave(duty=0.25, at=0.5)), d.add("bit", CompareToConstant(constant=0.5))
    pulse, reset = d.add("pulse", Pulse(on=7.25, off=9.75)), d.add("reset", CompareToConstant(constant=0.5))
    counter = d.add("counter", Counter(form=form, first=-1.0, final=3.0))
    d.wire(bit.u, wave.y)
    d.wire(reset.u, pulse.y)
    d.wire(counter.u, bit.y)
    d.wire(counter.reset, reset.y)
    results = d.run(start=start, stop=20.0, every=0.125)
    rises = np.array([k + 0.5 for k in range(20) if k + 0.5 > start])
    assert times(results, "counter", "rise") == rises.tolist()
    for time, value in zip(*after(results, "counter.y"), strict=True):
        begun = start if time < 7.25 else 9.75
        n = np.sum((begun < rises) & (rises <= time))
        assert value == (-1.0 + min(n, 4) if form == "stop" else -1.0 + n % 5), time


def test_a_counter_drives_a_divider_of_frequency() -> None:
    """A count is compared for equality, and a bool among numbers is 0 or 1."""
    d = Diagram("divider")
    counter, third = (
        d.add("counter", Counter(form="wrap", final=2.0)),
        d.add("third", CompareToConstant(operator="equal", constant=1.0)),
    )
    d.wire(counter.u, d.add("wave", SquareWave(period=0.1, at=0.05)).y)
    d.wire(third.u, counter.y)
    gain, integral = d.add("gain", Product()), d.add("integral", Integrator())
    d.wire(gain.u1, third.y)
    d.wire(gain.u2, d.add("height", Constant(value=6.0)).y)
    d.wire(integral.u, gain.y)
    results = d.run(stop=3.05, every=0.05, **TIGHT)
    assert results["integral.y"][-1] == pytest.approx(10 * 0.1 * 6.0, abs=1e-11)


# --- files -----------------------------------------------------------------------------------------------------


@in_one_test("name, given_", VARIANTS)
def test_every_block_of_the_library_goes_into_a_file_and_comes_back(name: str, given_: dict[str, Any]) -> None:
    d = Diagram("file")
    d.add("block", LIBRARY[name](**given_))
    text = d.dumps()
    again = Diagram.from_json(text)
    assert again.dumps() == text
    assert again.value == d.value
    assert LIBRARY[name](**again.value.blocks["block"].parameters) == LIBRARY[name](**given_)
