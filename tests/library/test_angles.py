"""Angles: wrapped, unwrapped, measured by an encoder; and the timer."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.signal import lfilter

from blocks import (
    CompareToConstant,
    Constant,
    Counter,
    Diagram,
    Encoder,
    Expression,
    Integrator,
    ModelError,
    Pulse,
    Ramp,
    Sine,
    SquareWave,
    Step,
    Timer,
    Unwrap,
    Wrap,
)
from blocks.contract.expressions import evaluate, parse

ENGINES = ["reference", "native"]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("slope", "lower"), [(1.0, -np.pi), (-2.0, -np.pi), (0.7, 0.0)])
def test_the_integral_of_a_wrapped_ramp_is_exact(engine: str, slope: float, lower: float) -> None:
    """Each jump is located: between two of them, y is a straight line from edge to edge."""
    d = Diagram("d")
    wrap, total = d.add("wrap", Wrap(lower=lower)), d.add("total", Integrator(unit="rad.s"))
    d.wire(wrap.u, d.add("ramp", Ramp(slope=slope, unit="rad")).y)
    d.wire(total.u, wrap.y)
    results = d.run(stop=20, engine=engine)
    u, turn = slope * 20.0, 2 * np.pi
    turns = np.floor((u - lower) / turn)
    assert results["wrap.y"][-1] == pytest.approx(u - turns * turn, abs=1e-12)
    edges = lower + turn * (np.arange(1, turns + 1) if slope > 0 else -np.arange(0, -turns))
    exact = u * 20 / 2 - np.sign(slope) * turn * np.sum(20.0 - edges / slope)
    assert results["total.y"][-1] == pytest.approx(exact, abs=1e-12)
    assert [event.t for event in results.events] == pytest.approx(list(edges / slope), rel=1e-15)


def test_every_value_is_wrapped_as_numpy_does_it() -> None:
    d = Diagram("d")
    d.wire(d.add("wrap", Wrap(unit="deg")).u, d.add("u", Sine(amplitude=1000, omega=3, unit="deg")).y)
    results = d.run(stop=5, every=0.001)
    whole = np.mod(results["u.y"] + np.pi, 2 * np.pi) - np.pi
    near = np.abs(np.abs(whole) - np.pi) < 1e-9  # at an edge, both sides are right
    assert np.allclose(results["wrap.y"][~near], whole[~near], atol=1e-12)
    assert np.all(np.abs(results["wrap.y"]) <= np.pi + 1e-12)
    assert len(results.events) > 25


@pytest.mark.parametrize("u", [-7.0, -np.pi, 0.0, np.pi, 100.0])
def test_a_constant_is_wrapped_at_the_start_and_the_lower_edge_belongs_to_it(u: float) -> None:
    d = Diagram("d")
    d.wire(d.add("wrap", Wrap()).u, d.add("u", Constant(value=u, unit="rad")).y)
    y = d.run(stop=1)["wrap.y"]
    assert np.ptp(y) == 0
    assert y[0] == pytest.approx(np.mod(u + np.pi, 2 * np.pi) - np.pi, abs=1e-13)


@pytest.mark.parametrize("engine", ENGINES)
def test_unwrap_undoes_wrap(engine: str) -> None:
    d = Diagram("d")
    wrap, unwrap = d.add("wrap", Wrap()), d.add("unwrap", Unwrap(period=0.01))
    d.wire(wrap.u, d.add("u", Sine(amplitude=20, omega=2, unit="rad")).y)
    d.wire(unwrap.u, wrap.y)
    results = d.run(stop=6, every=0.01, engine=engine)
    assert np.allclose(results["unwrap.y"], results["u.y"], atol=1e-12)
    assert np.allclose(results["unwrap.y"], np.unwrap(results["wrap.y"]), atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_encoder_counts_and_filters_as_the_formulas_say(engine: str) -> None:
    d = Diagram("d")
    encoder = d.add("encoder", Encoder(counts_per_turn=512, period=0.01, Tf=0.05))
    d.wire(encoder.theta, d.add("theta", Sine(amplitude=3, omega=4, unit="rad")).y)
    results = d.run(stop=3, every=0.01, engine=engine)
    count = np.floor(512 * results["theta.y"] / (2 * np.pi))
    assert np.array_equal(results["encoder.count"], count)
    angle = 2 * np.pi * count / 512
    assert np.allclose(results["encoder.angle"], angle, rtol=1e-15)
    a = np.exp(-0.01 / 0.05)
    speed = lfilter([1 - a], [1, -a], np.diff(angle, prepend=angle[0]) / 0.01)
    assert np.allclose(results["encoder.omega"], speed, atol=1e-11)
    plain = Diagram("plain")
    plain.wire(plain.add("encoder", Encoder(counts_per_turn=512, period=0.01)).theta, "theta.y")
    plain.add("theta", Sine(amplitude=3, omega=4, unit="rad"))
    steps = np.diff(angle, prepend=angle[0]) / 0.01
    assert np.allclose(plain.run(stop=3, every=0.01, engine=engine)["encoder.omega"], steps, atol=1e-11)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_timer_is_an_on_delay_with_located_instants(engine: str) -> None:
    d = Diagram("d")
    timer, integral = d.add("timer", Timer(duration=0.4)), d.add("integral", Integrator())
    on = d.add("on", CompareToConstant(operator=">"))
    d.wire(on.u, d.add("wave", SquareWave(period=2)).y)
    d.wire(timer.u, on.y)
    d.wire(integral.u, timer.elapsed)
    results = d.run(stop=5, jumps=True, engine=engine)
    assert [event.t for event in results.events if event.block == "timer" and event.what == "due"] == [0.4, 2.4, 4.4]
    assert results["integral.y"][-1] == pytest.approx(3 * 0.5, abs=1e-12)
    done, phase = results["timer.done"], np.mod(results.t, 2)
    assert np.all(done[(phase > 0.4 + 1e-9) & (phase < 1)] == 1)
    assert np.all(done[(phase < 0.4 - 1e-9) | (phase > 1)] == 0)


@pytest.mark.parametrize(("width", "done"), [(0.25, False), (0.2500001, True)])
def test_a_pulse_has_to_be_longer_than_the_duration(width: float, done: bool) -> None:
    d = Diagram("d")
    timer, on = d.add("timer", Timer(duration=0.25)), d.add("on", CompareToConstant(operator=">", constant=0.5))
    d.wire(on.u, d.add("pulse", Pulse(on=1, off=1 + width)).y)
    d.wire(timer.u, on.y)
    results = d.run(stop=3, jumps=True)
    after = results["timer.done"][results.t > 1.0]
    assert bool(after.any()) is done
    assert results["timer.done"][-1] == 0


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("duration", [1e-20, 1e-14, 1e-9])
def test_a_duration_that_is_lost_in_the_digits_of_t_is_over_at_once(duration: float, engine: str) -> None:
    d = Diagram("d")
    timer, on = d.add("timer", Timer(duration=duration)), d.add("on", CompareToConstant())
    d.wire(on.u, d.add("step", Step(at=1000, before=-1.0)).y)
    d.wire(timer.u, on.y)
    results = d.run(start=999, stop=1001, every=0.5, engine=engine)
    assert list(results["timer.done"]) == [0, 0, 1000 + duration == 1000, 1, 1]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("width", [0.25, 0.375])
def test_nothing_behind_a_timer_sees_a_pulse_of_its_duration(width: float, engine: str) -> None:
    d = Diagram("d")
    timer, on = d.add("timer", Timer(duration=0.25)), d.add("on", CompareToConstant(operator=">", constant=0.5))
    d.wire(on.u, d.add("pulse", Pulse(on=1, off=1 + width)).y)
    d.wire(timer.u, on.y)
    d.wire(d.add("count", Counter()).u, timer.done)
    assert d.run(stop=3, engine=engine)["count.y"][-1] == (width > 0.25)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("before", [0.25, 0.75])
def test_a_run_goes_on_with_another_duration(before: float, engine: str) -> None:
    d = Diagram("d")
    timer = d.add("timer", Timer(duration=before))
    d.wire(timer.u, d.add("on", CompareToConstant()).y)
    d.wire("on.u", d.add("one", Constant()).y)
    run = d.start(stop=2, engine=engine)
    run.advance_to(0.5)
    for duration in (0.125, 0.25, 0.5, 0.625, 0.75, 1.0):
        rest = d.run(stop=2, every=0.125, resume=run.snapshot(), parameters={"timer.duration": duration}, engine=engine)
        assert list(rest["timer.done"]) == list(rest.t >= duration), duration


@pytest.mark.parametrize("engine", ENGINES)
def test_mod_in_a_formula_jumps_at_located_instants(engine: str) -> None:
    d = Diagram("d")
    wrap, total = d.add("wrap", Expression(expression="mod(u1 + pi, 2*pi) - pi")), d.add("total", Integrator())
    d.wire(wrap.u1, d.add("ramp", Ramp()).y)
    d.wire(total.u, wrap.y)
    results = d.run(stop=20, engine=engine)
    edges = np.pi * np.array([1, 3, 5])
    assert [event.t for event in results.events if event.block == "wrap"] == pytest.approx(list(edges), rel=1e-15)
    assert results["total.y"][-1] == pytest.approx(200 - 2 * np.pi * np.sum(20 - edges), abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_mod_inside_mod_and_in_conditions_is_what_numpy_says(engine: str) -> None:
    d = Diagram("d")
    sine = d.add("sine", Sine(amplitude=10, omega=3))
    formula = d.add("formula", Expression(expression="mod(mod(u1, k1), k2) + mod(u1, -3)", k=[5, 2]))
    condition = d.add("condition", Expression(expression="mod(u1, 4) < 1 or mod(u1, 4) > 3"))
    d.wire(formula.u1, sine.y)
    d.wire(condition.u1, sine.y)
    results = d.run(stop=5, every=0.0123, engine=engine, rtol=1e-10)
    u = results["sine.y"]
    assert np.allclose(results["formula.y"], np.mod(np.mod(u, 5), 2) + np.mod(u, -3), atol=1e-9)
    assert np.array_equal(results["condition.y"], (np.mod(u, 4) < 1) | (np.mod(u, 4) > 3))


def test_mod_of_parameters_is_exact() -> None:
    d = Diagram("d")
    d.parameter("a", 0.7)
    d.add("c", Constant(value="=mod(a, 0.2) + mod(-7, 3)"))
    assert d.run(stop=1)["c.y"][-1] == pytest.approx(2.1, rel=1e-15)
    assert evaluate(parse("mod(0.7, 0.2)"), {}).exact == Fraction(1, 10)
    for expression, said in (("mod(3)", "mod takes two arguments, not 1"), ("mod(3, 0)", "division by zero in mod")):
        with pytest.raises(ModelError, match=said):
            Diagram("e").add("c", Constant(value=f"={expression}"))
