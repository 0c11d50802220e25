"""Continuous and nonlinear blocks over time: closed forms, SciPy, python-control, and instants that are exact."""

import itertools
import math
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from blocks import (
    Constant,
    DeadZone,
    Derivative,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    LeadLag,
    LimitedIntegrator,
    Pulse,
    Quantizer,
    Ramp,
    Relay,
    ResettableIntegrator,
    Results,
    SecondOrder,
    SimulationError,
    Sine,
    Step,
    Sum,
    TransferFunction,
    ZeroPoleGain,
)
from blocks.compile.plan_builder import plan
from blocks.contract.interface import Value
from blocks.contract.resolution import Resolved, resolve
from blocks.contract.tracing import trace
from blocks.library import LIBRARY
from tests.support.marks import long_but
from tests.support.on_numbers import numeric

Array = np.ndarray[Any, Any]

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""
INSTANT = 1e-9
"""How far that error moves a crossing which its signal passes with a slope of about 1."""


def driven(block: Any, *sources: Any, ports: tuple[str, ...] = ("u",), **run: Any) -> Results:
    """A run of one block "b" with a source at each of its ports."""
    d = Diagram("driven")
    made = d.add("b", block)
    for port, source in zip(ports, sources, strict=True):
        d.wire(getattr(made, port), d.add(f"of_{port}", source).y)
    return d.run(**{**TIGHT, **run})


def fired(results: Results, block: str = "b") -> list[tuple[float, str]]:
    return [(event.t, event.what) for event in results.events if event.block == block]


def rights(results: Results) -> Array:
    """Of two rows at one time, only the second."""
    return np.append(np.diff(results.t) > 0, True)


def resolved(name: str, **given: Any) -> Resolved:
    return resolve(LIBRARY[name], {key: Value(value) for key, value in given.items()})


def matrices(name: str, **given: Any) -> tuple[Array, Array, Array, Array]:
    """A, B, C and D of a block with the input u, the output y and the states x, column by column."""
    made = resolved(name, **given)
    (state,) = made.interface.declaration.states
    n = int(np.prod(made.interface.shape(made.interface.declaration.states[state])))
    parameters = {key: made.values[key].value[()] for key in made.interface.symbolic_parameters}

    def at(x: Array, u: float) -> tuple[Array, Array]:
        found = numeric(made.interface, {**parameters, "t": 0.0, "tick": 0, state: x, "u": u, "y": 0.0})
        return found[f"derivative:{state}"], found["output:y"]

    columns = [at(x, 0.0) for x in np.eye(n)]
    B, D = at(np.zeros(n), 1.0)
    A = np.array([column[0] for column in columns]).reshape(n, n).T
    C = np.array([column[1] for column in columns]).reshape(n, 1).T
    return A, B.reshape(n, 1), C, D.reshape(1, 1)


def feedthrough(name: str, **given: Any) -> bool:
    """Whether y depends on u at once."""
    tape = trace(resolved(name, **given).interface)
    (node,) = tape.results["output:y"].nodes
    return any(tape.arguments[k].kind == "input" for k in tape.arguments_of(node))


# --- integrators that jump -------------------------------------------------------------------------------------


def test_an_integrator_that_resets_itself_is_a_sawtooth() -> None:
    slope, threshold, y0 = 2.0, 1.0, -0.5
    d = Diagram("sawtooth")
    saw = d.add("b", ResettableIntegrator(threshold=threshold))
    d.wire(saw.u, d.add("slope", Constant(value=slope)).y)
    d.wire(saw.trigger, saw.y)
    d.wire(saw.y0, d.add("y0", Constant(value=y0)).y)
    results = d.run(stop=10.0, every=0.125, **TIGHT)
    times = threshold / slope + (threshold - y0) / slope * np.arange(13)
    assert [t for t, _ in fired(results)] == pytest.approx(times.tolist(), abs=INSTANT)
    t = np.asarray(results.t)[rights(results)]
    since = np.searchsorted(times, t - 1e-12)
    last = np.concatenate([[0.0], times])[since]
    expected = np.where(since == 0, 0.0, y0) + slope * (t - last)
    inside = np.min(np.abs(t[:, None] - times), axis=1) > 1e-6
    assert np.asarray(results["b.y"])[rights(results)][inside] == pytest.approx(expected[inside], abs=CLOSE)


@pytest.mark.parametrize(
    ("direction", "expected"),
    [
        ("up", [(1.0, "rise")]),
        ("down", [(2.5, "fall")]),
        ("both", [(1.0, "rise"), (2.5, "fall")]),
    ],
)
def test_the_direction_chooses_the_edges_of_a_pulse(direction: str, expected: list[tuple[float, str]]) -> None:
    results = driven(
        ResettableIntegrator(direction=direction, y_start=7.0),
        Sine(phase=math.pi / 2),
        Pulse(on=1.0, off=2.5),
        Sine(omega=2.0),
        ports=("u", "trigger", "y0"),
        stop=4.0,
        every=0.25,
    )
    assert fired(results) == expected  # to the last bit: the edges are event times
    t, y = np.asarray(results.t)[rights(results)], np.asarray(results["b.y"])[rights(results)]
    starts = [(0.0, 7.0), *((at, math.sin(2.0 * at)) for at, _ in expected)]
    for at, until in itertools.pairwise([*starts, (math.inf, 0.0)]):
        here = (t >= at[0]) & (t < until[0])
        assert y[here] == pytest.approx(at[1] + np.sin(t[here]) - math.sin(at[0]), abs=CLOSE)


def test_a_smooth_trigger_is_located_and_one_that_is_on_at_the_start_does_not_fire() -> None:
    def run(direction: str) -> list[tuple[float, str]]:
        block = ResettableIntegrator(direction=direction, threshold=0.5)
        trigger = Sine(omega=3.0, phase=math.pi / 2)  # on at the start
        return fired(driven(block, Constant(), trigger, ports=("u", "trigger"), stop=4.0))

    down = [(math.pi / 3 + 2 * math.pi * k) / 3 for k in range(2)]
    up = [(2 * math.pi - math.pi / 3 + 2 * math.pi * k) / 3 for k in range(2)]
    for direction, times in (("down", down), ("up", up), ("both", sorted(down + up))):
        assert [t for t, _ in run(direction)] == pytest.approx(times, abs=INSTANT)


# --- integrators that stop -------------------------------------------------------------------------------------


def test_a_limited_integrator_stops_at_its_limits_and_leaves_when_the_input_turns() -> None:
    upper, lower = 1.0, -0.5
    block = LimitedIntegrator(lower=lower, upper=upper)
    results = driven(block, Sine(amplitude=2.0), stop=14.0, every=0.05)
    # Free, y falls or rises by 2 (1 - cos) from the limit it left.
    hit = math.acos(1.0 - (upper - lower) / 2.0)
    events = [(math.acos(1.0 - upper / 2.0), "above"), (math.pi, "turn")]
    for turn in (math.pi, 2.0 * math.pi, 3.0 * math.pi, 4.0 * math.pi):
        events += [(turn + hit, "below" if len(events) % 4 == 2 else "above"), (turn + math.pi, "turn")]
    events = [event for event in events if event[0] <= 14.0]
    assert [what for _, what in fired(results)] == [what for _, what in events]
    assert [t for t, _ in fired(results)] == pytest.approx([t for t, _ in events], abs=INSTANT)
    t, y = np.asarray(results.t), np.asarray(results["b.y"])
    resting = np.zeros(len(t), dtype=bool)
    for (at, what), (until, _) in itertools.pairwise([*events, (math.inf, "")]):
        if what != "turn":
            here = (t > at + 1e-6) & (t < until - 1e-6)
            assert set(y[here]) == {upper if what == "above" else lower}  # exactly
            resting |= here
    free = (t < events[0][0]) | ((t > math.pi) & (t < math.pi + hit))
    expected = np.where(t < math.pi, 2.0 - 2.0 * np.cos(t), upper - 2.0 - 2.0 * np.cos(t))
    assert y[free] == pytest.approx(expected[free], abs=CLOSE)
    assert np.count_nonzero(resting) > 50
    right = y[rights(results)]
    assert (np.min(right), np.max(right)) == (lower, upper)
    # What is recorded just before a limit stops it lies beyond by 4 ulp of t times u at most.
    assert max(np.max(y) - upper, lower - np.min(y)) <= 2.0 * 4.0 * math.ulp(14.0)


@pytest.mark.parametrize("method", [{"method": "rk4", "step": 0.05}, {"method": "radau"}], ids=lambda m: m["method"])
def test_other_methods_stop_at_the_same_instants(method: dict[str, Any]) -> None:
    def loop(**run: Any) -> list[tuple[float, str]]:
        d = Diagram("follow")
        y, error, gain = (
            d.add("b", LimitedIntegrator(lower=-1.0, upper=0.8)),
            d.add("e", Sum(signs="+-")),
            d.add("g", Gain(k=5.0)),
        )
        d.wire(error.u1, d.add("r", Sine(amplitude=1.2, omega=2.0)).y)
        d.wire(error.u2, y.y)
        d.wire(gain.u, error.y)
        d.wire(y.u, gain.y)
        results = d.run(stop=7.0, **run)
        assert np.max(results["b.y"]) == pytest.approx(0.8, abs=1e-12)
        return fired(results)

    found, expected = loop(**method), loop(**TIGHT)
    assert [what for _, what in found] == [what for _, what in expected]
    # rk4 is off by about (5 h)^4/120 of the amplitude, and the slopes at the limits are about 1.
    assert [t for t, _ in found] == pytest.approx([t for t, _ in expected], abs=5e-5)
    # It leaves where the reference comes back to its limit.
    assert next(t for t, what in expected if what == "turn") == pytest.approx(
        (math.pi - math.asin(0.8 / 1.2)) / 2.0, abs=INSTANT
    )


def test_a_limited_integrator_leaves_at_the_very_edge_of_its_input() -> None:
    d = Diagram("edge")
    y = d.add("b", LimitedIntegrator(upper=1.0))
    d.wire(y.u, d.add("u", Step(at=3.3, before=2.0, after=-0.75)).y)
    results = d.run(stop=5.0, every=0.1, **TIGHT)
    assert fired(results) == [(pytest.approx(0.5, abs=INSTANT), "above"), (3.3, "turn")]
    t = np.asarray(results.t)
    expected = np.where(t < 0.5, 2.0 * t, np.where(t < 3.3, 1.0, 1.0 - 0.75 * (t - 3.3)))
    assert results["b.y"] == pytest.approx(expected, abs=CLOSE)


def test_a_limited_integrator_that_starts_at_its_limit_rests_or_leaves() -> None:
    for u, end in ((1.0, 2.0), (-1.0, 1.0), (0.0, 2.0)):
        results = driven(LimitedIntegrator(lower=0.0, upper=2.0, y_start=2.0), Constant(value=u), stop=1.0)
        assert fired(results) == []
        assert results["b.y"][-1] == pytest.approx(end, abs=1e-12)


def test_a_limited_integrator_under_fast_signals_is_the_reflection_of_its_free_integral() -> None:
    """Under an upper limit, y = U - max(0, sup of U - upper so far), with U the free integral of u."""
    w, drift, upper, stop = 40.0, 0.3, 0.1, 2.0
    d = Diagram("fast")
    total, y = d.add("total", Sum()), d.add("b", LimitedIntegrator(upper=upper))
    d.wire(total.u1, d.add("sine", Sine(omega=w)).y)
    d.wire(total.u2, d.add("drift", Constant(value=drift)).y)
    d.wire(y.u, total.y)
    results = d.run(stop=stop, every=0.01, **TIGHT)
    fine = np.linspace(0.0, stop, 2_000_001)  # the sup over this grid is right to w dt^2/8 = 5e-12
    free = drift * fine + (1.0 - np.cos(w * fine)) / w
    reflected = free - np.maximum.accumulate(np.maximum(free - upper, 0.0))
    expected = reflected[np.rint(np.asarray(results.t) * 1e6).astype(int)]
    on_grid = np.abs(np.asarray(results.t) * 1e6 % 1.0 - 0.5) > 0.499
    assert np.count_nonzero(on_grid) > 150
    assert np.asarray(results["b.y"])[on_grid] == pytest.approx(expected[on_grid], abs=CLOSE)
    # Once at its limit, it leaves and comes back once in each period.
    whats = [what for _, what in fired(results)]
    assert whats[:4] == ["above", "turn", "above", "turn"]
    assert len(whats) >= 2 * (stop * w / (2 * math.pi) - 4)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(-3, 3), min_size=1, max_size=25))
@example([1, 0, 0, 1, -1, -1, 0, 3, -3, 3, 3, 0, -3, -3, -3])
def test_a_limited_integrator_of_steps_is_a_clipped_sum(steps: list[int]) -> None:
    d = Diagram("steps")
    u = d.input("u")
    y = d.add("b", LimitedIntegrator(lower=-1.0, upper=2.0))
    d.wire(y.u, u)
    t = 0.5 * np.arange(len(steps))
    results = d.run(stop=0.5 * len(steps), every=0.5, inputs={"u": (t, np.array(steps, dtype=float), "hold")})
    expected, value = [0.0], 0.0
    for step in steps:
        value = min(max(value + 0.5 * step, -1.0), 2.0)
        expected.append(value)
    found = [float(results["b.y"][np.searchsorted(results.t, 0.5 * n)]) for n in range(len(steps) + 1)]
    assert found == pytest.approx(expected, abs=1e-12)


def test_limits_that_are_set_during_a_run_take_y_along_or_let_it_go() -> None:
    d = Diagram("moved")
    y = d.add("b", LimitedIntegrator(upper=1.0))
    d.wire(y.u, d.add("u", Constant(value=1.0)).y)
    run = d.start()
    run.advance_to(2.0)
    assert run["b.y"] == 1.0
    run.set("b.upper", 1.5)
    run.advance_to(2.25)
    assert run["b.y"] == pytest.approx(1.25, abs=1e-12)
    run.advance_to(3.0)
    assert run["b.y"] == 1.5
    run.set("b.upper", 0.5)
    assert run["b.y"] == 0.5
    run.advance_to(4.0)
    assert run["b.y"] == 0.5


# --- linear systems --------------------------------------------------------------------------------------------


def test_a_derivative_starts_without_a_jump_and_is_smoothed() -> None:
    Tf = 0.2
    results = driven(Derivative(Tf=Tf), Sine(omega=3.0, phase=1.0), stop=2.0, every=0.1)
    # Im of a exp(jt w): y = Im(H U) and the transient that makes y(0) = 0.
    H = 3.0j / (1.0 + 3.0j * Tf) * np.exp(1.0j)
    t = np.asarray(results.t)
    expected = (H * np.exp(3.0j * t)).imag - H.imag * np.exp(-t / Tf)
    assert results["b.y"] == pytest.approx(expected, abs=CLOSE)
    assert np.all(driven(Derivative(Tf=Tf), Constant(value=5.0), stop=1.0, every=0.1)["b.y"] == 0.0)


def test_a_jump_passes_through_a_derivative_over_its_filter_time() -> None:
    Tf = 0.05
    results = driven(Derivative(Tf=Tf), Step(at=0.5, before=1.0, after=3.0), stop=1.0, every=0.05)
    t = np.asarray(results.t)[rights(results)]
    expected = np.where(t < 0.5, 0.0, 2.0 / Tf * np.exp(-np.maximum(t - 0.5, 0.0) / Tf))
    assert np.asarray(results["b.y"])[rights(results)] == pytest.approx(expected, abs=CLOSE * 2.0 / Tf)


def test_a_first_order_lag_is_its_exponential() -> None:
    results = driven(FirstOrder(k=3.0, T=0.4, y_start=-1.0), Constant(value=2.0), stop=2.0, every=0.1)
    assert results["b.y"] == pytest.approx(6.0 - 7.0 * np.exp(-np.asarray(results.t) / 0.4), abs=CLOSE)


@pytest.mark.parametrize("damping", [0.0, 0.3, 1.0, 2.5, -0.1])
def test_a_second_order_lag_is_its_closed_form(damping: float) -> None:
    k, w, y0, v0 = 2.0, 3.0, 0.5, -1.0
    results = driven(SecondOrder(k=k, d=damping, w=w, y_start=y0, v_start=v0), Constant(value=1.5), stop=4.0, every=0.1)
    t, rest = np.asarray(results.t), k * 1.5
    # y - rest = exp(-d w t) (a C(t) + b S(t)) with S(t) = t where both poles are one.
    root = w * np.emath.sqrt(damping**2 - 1.0)
    if damping == 1.0:
        C, S = np.ones_like(t), t
    else:
        C, S = np.cosh(root * t).real, (np.sinh(root * t) / root).real
    a = y0 - rest
    b = v0 + damping * w * a
    expected = rest + np.exp(-damping * w * t) * (a * C + b * S)
    assert results["b.y"] == pytest.approx(expected, abs=CLOSE)


def test_a_second_order_lag_overshoots_as_its_damping_says() -> None:
    damping, w = 0.2, 5.0
    results = driven(SecondOrder(d=damping, w=w), Constant(), stop=1.0, every=0.001)
    peak = math.pi / (w * math.sqrt(1.0 - damping**2))
    overshoot = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    assert np.max(results["b.y"]) == pytest.approx(1.0 + overshoot, abs=1e-6)  # w^2 dt^2/8 below the peak at worst
    assert results.t[int(np.argmax(results["b.y"]))] == pytest.approx(peak, abs=1e-3)


@pytest.mark.parametrize(("T1", "T2"), [(0.5, 0.1), (0.05, 0.4), (0.0, 0.3)])
def test_a_lead_lag_answers_a_step_as_its_limits_say(T1: float, T2: float) -> None:
    results = driven(LeadLag(k=3.0, T1=T1, T2=T2), Step(at=0.25, after=2.0), stop=2.0, every=0.05)
    t = np.asarray(results.t)[rights(results)]
    since = np.maximum(t - 0.25, 0.0)
    expected = np.where(t < 0.25, 0.0, 6.0 * (1.0 + (T1 / T2 - 1.0) * np.exp(-since / T2)))
    assert np.asarray(results["b.y"])[rights(results)] == pytest.approx(expected, abs=CLOSE * max(1.0, T1 / T2))
    assert feedthrough("LeadLag", T1=T1, T2=T2) is (T1 > 0.0)


POLES = [
    ([], [], [-2.0], [0.0], 3.0),
    ([-3.0], [0.0], [-2.0], [0.0], 1.5),
    ([], [], [0.0, -1.0], [0.0, 0.0], 2.0),
    ([2.0], [0.0], [-1.0, -1.0], [4.0, -4.0], 5.0),
    ([-1.0, -1.0], [3.0, -3.0], [-2.0, -0.5, -0.5], [0.0, 2.0, -2.0], 4.0),
    ([-1.0, -1.0, 0.5], [3.0, -3.0, 0.0], [-0.5, -0.5, -2.0], [2.0, -2.0, 0.0], 4.0),
    ([0.5, -1.0, -1.0, -4.0], [0.0, 3.0, -3.0, 0.0], [-2.0, -0.5, -0.5, -3.0], [0.0, 2.0, -2.0, 0.0], -1.0),
    ([0.0, 0.0], [2.0, -2.0], [0.0, 0.0, -1.0, -1.0], [5.0, -5.0, 1.0, -1.0], 1.0),
    ([], [], [], [], 2.5),
]


@pytest.mark.parametrize(("zeros", "zeros_imag", "poles", "poles_imag", "k"), POLES)
def test_zeros_poles_and_gain_are_those_of_scipy_and_control(
    zeros: list[float], zeros_imag: list[float], poles: list[float], poles_imag: list[float], k: float
) -> None:
    given_ = {"zeros": zeros, "zeros_imag": zeros_imag, "poles": poles, "poles_imag": poles_imag, "k": k}
    A, B, C, D = matrices("ZeroPoleGain", **given_)
    z, p = np.array(zeros) + 1j * np.array(zeros_imag), np.array(poles) + 1j * np.array(poles_imag)
    s = np.array([0.3j, 1.7j, 20.0 + 3.0j, -0.2 + 0.1j])
    found = np.array([(C @ np.linalg.solve(x * np.eye(len(p)) - A, B.astype(complex)) + D).item() for x in s])
    plain = k * np.prod(s[:, None] - z, axis=1) / np.prod(s[:, None] - p, axis=1)
    assert found == pytest.approx(plain, rel=1e-12)
    num, den = signal.zpk2tf(z, p, k)
    assert found == pytest.approx(np.polyval(num, s) / np.polyval(den, s), rel=1e-10)
    if len(p):
        theirs = control.zpk(z, p, k)
        assert found == pytest.approx(np.array([theirs(x) for x in s]), rel=1e-10)
    assert feedthrough("ZeroPoleGain", **given_) is (len(z) == len(p))


roots = st.lists(
    st.tuples(st.floats(-5.0, 1.0), st.sampled_from([0.0, 0.0, 1.0]), st.floats(0.1, 5.0)), min_size=0, max_size=4
)


def spread(given_: list[tuple[float, float, float]]) -> tuple[list[float], list[float]]:
    """Real and imaginary parts, with both of each pair."""
    real, imag = [], []
    for a, is_pair, b in given_:
        real += [a, a] if is_pair else [a]
        imag += [b, -b] if is_pair else [0.0]
    return real, imag


@settings(deadline=None)
@given(roots, roots, st.floats(0.1, 10.0))
def test_any_zeros_and_poles_make_their_transfer_function(
    some: list[tuple[float, float, float]], others: list[tuple[float, float, float]], k: float
) -> None:
    zeros, poles = sorted([spread(some), spread(others)], key=lambda parts: len(parts[0]))
    A, B, C, D = matrices("ZeroPoleGain", zeros=zeros[0], zeros_imag=zeros[1], poles=poles[0], poles_imag=poles[1], k=k)
    z, p = (np.array(parts[0]) + 1j * np.array(parts[1]) for parts in (zeros, poles))
    for s in (3.0 + 1.3j, 20.0 - 3.0j):
        expected = k * np.prod(s - z) / np.prod(s - p)
        found = (C @ np.linalg.solve(s * np.eye(len(p)) - A, B.astype(complex)) + D).item()
        # Sums of up to 2^n terms, the largest of which is a bound of the rounding errors.
        size = k * np.prod(abs(s) + abs(z)) / np.prod(abs(s - p))
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-12 * size)


@pytest.mark.parametrize(("zeros", "zeros_imag", "poles", "poles_imag", "k"), POLES[1:-1])
def test_zeros_and_poles_answer_a_step_as_the_matrices_of_scipy(
    zeros: list[float], zeros_imag: list[float], poles: list[float], poles_imag: list[float], k: float
) -> None:
    block = ZeroPoleGain(zeros=zeros, zeros_imag=zeros_imag, poles=poles, poles_imag=poles_imag, k=k)
    results = driven(block, Constant(value=2.0), stop=3.0, every=0.25)
    z, p = np.array(zeros) + 1j * np.array(zeros_imag), np.array(poles) + 1j * np.array(poles_imag)
    A, B, C, D = signal.zpk2ss(z, p, k)
    n = len(p)
    held = np.zeros((n + 1, n + 1))
    held[:n, :n], held[:n, n:] = A, B
    expected = [(C @ (expm(held * t) @ np.append(np.zeros(n), 2.0))[:n] + D[0] * 2.0).item() for t in results.t]
    assert results["b.y"] == pytest.approx(expected, rel=CLOSE, abs=CLOSE)


def test_a_fast_filter_of_high_order_keeps_its_digits() -> None:
    """A Butterworth low-pass of order 8 at 1 kHz at the default tolerances, against its residues."""
    z, p, k = signal.butter(8, 2.0 * math.pi * 1000.0, analog=True, output="zpk")
    pairs = sorted((pole for pole in p if pole.imag > 0), key=lambda pole: pole.real)
    block = ZeroPoleGain(
        poles=[pole.real for pole in pairs for _ in range(2)],
        poles_imag=[sign * pole.imag for pole in pairs for sign in (1.0, -1.0)],
        k=float(np.real(k)),
    )
    assert len(z) == 0
    results = driven(block, Constant(), stop=0.004, every=0.0001, rtol=1e-6, atol=1e-9)
    t = np.asarray(results.t)
    residues = [k / pole / np.prod([pole - other for other in p if other != pole]) for pole in p]
    expected = 1.0 + sum(r * np.exp(pole * t) for r, pole in zip(residues, p, strict=True)).real
    assert results["b.y"] == pytest.approx(expected, abs=1e-6)  # rtol: the global error of the largest state


def test_a_pole_that_is_slow_for_its_run_keeps_its_digits_too() -> None:
    results = driven(ZeroPoleGain(poles=[-1e-6, -1e-6]), Constant(), stop=10.0, every=1.0, rtol=1e-6, atol=1e-9)
    # For so short a time it is a double integrator: t^2/2, less t^3/3 of 1e-6.
    t = np.asarray(results.t)
    assert results["b.y"] == pytest.approx(t**2 / 2.0 - 1e-6 * t**3 / 3.0, rel=1e-6, abs=1e-9)


def companion(den: Array, t: Array) -> Array:
    """The answer of den[-1]/den to a step, by the exponential of its matrix, with time in units of its speed."""
    speed = (den[-1] / den[0]) ** (1.0 / (len(den) - 1))
    a = den / den[0] / speed ** np.arange(len(den))
    n = len(a) - 1
    held = np.zeros((n + 1, n + 1))
    held[: n - 1, 1:n], held[n - 1, :n], held[n - 1, n] = np.eye(n - 1), -a[:0:-1], 1.0
    return np.array([a[-1] * expm(held * speed * time)[0, n] for time in t])


@pytest.mark.parametrize(
    ("frequency", "method", "engine"),
    long_but(
        itertools.product((1.0, 1e4, 1e5, 1e7), ("dopri5", "radau"), ("reference", "native")),
        lambda frequency, method, engine: engine == "native" or frequency == 1e7,
    ),
)
def test_a_fast_transfer_function_is_as_accurate_as_a_slow_one(frequency: float, method: str, engine: str) -> None:
    """At the default tolerances, beside the same plant as a SecondOrder."""
    w = 2.0 * math.pi * frequency
    run: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-9, "method": method, "engine": engine}
    run |= {"stop": round(50.0 / frequency, 12), "every": round(0.5 / frequency, 12)}
    results = driven(TransferFunction(num=[w**2], den=[1.0, 0.4 * w, w**2]), Constant(), **run)
    expected = companion(np.array([1.0, 0.4 * w, w**2]), np.asarray(results.t))
    assert results["b.y"] == pytest.approx(expected, abs=1e-6)
    if method == "dopri5":
        other = driven(SecondOrder(w=w, d=0.2), Constant(), **run)
        assert other["b.y"] == pytest.approx(expected, abs=1e-6)


def sizes(name: str, **given: Any) -> list[float]:
    """The nominal sizes of the states of a block."""
    return list(resolve(LIBRARY[name], {key: Value(value) for key, value in given.items()}).nominal)


@settings(max_examples=50)
@given(
    st.lists(st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-6), min_size=1, max_size=5),
    st.lists(st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-6), min_size=1, max_size=5),
)
def test_the_size_of_a_canonical_state_is_its_largest_gain_over_all_frequencies(
    num: list[float], den: list[float]
) -> None:
    """The gain w^i over the largest term of the denominator or of the output, by a search over w."""
    den = [1.0, *den]
    num = num[: len(den)]
    n = len(den) - 1
    direct = num[0] if len(num) == n + 1 else 0.0
    row = np.polysub(num, direct * np.array(den))[::-1]  # what is left of num, lowest power first
    terms = np.abs(den[::-1])
    terms[: len(row)] = np.maximum(terms[: len(row)], np.abs(row))
    heights = np.log(np.maximum(terms, 1.0))
    w = np.linspace(-20.0, 20.0, 8001)  # logarithms
    largest = np.max(heights[:, None] + np.arange(n + 1)[:, None] * w, axis=0)
    expected = [float(np.exp(np.max(i * w - largest))) for i in range(n)]
    assert sizes("TransferFunction", num=num, den=den) == pytest.approx(expected, rel=0.03)


def test_sizes_stay_numbers_that_tolerances_can_be_made_of() -> None:
    assert sizes("TransferFunction", num=[1.0], den=[1e-300, 1e300]) == [pytest.approx(1e-150)]
    assert sizes("TransferFunction", num=[1e-300], den=[1.0, 0.0]) == [1.0]
    assert sizes("TransferFunction", num=[2.0], den=[4.0]) == []
    assert sizes("ZeroPoleGain", poles=[-1.0], k=1e300) == [pytest.approx(1e-150)]
    assert sizes("ZeroPoleGain", poles=[], k=1e300) == []
    assert sizes("LeadLag", k=0.0, T1=1e300, T2=1e-300) == [1.0]


def test_num_and_den_that_are_given_or_set_take_the_nominal_along_and_leave_the_states_as_they_are() -> None:
    d = Diagram("tuned")
    b = d.add("b", TransferFunction(num=[1.0], den=[1.0, 1.0, 1.0]))
    d.wire(b.u, d.add("u", Constant()).y)
    assert plan(d.flatten()).nominal == (1.0, 1.0)
    w = 2e5 * math.pi
    fast: dict[str, Any] = {"b.num": [w**2], "b.den": [1.0, 0.4 * w, w**2]}
    assert plan(d.flatten(parameters=fast)).nominal == pytest.approx((w**-2, 1 / w), rel=1e-12)
    (tuned,) = (one for one in d.flatten(parameters=fast).blocks if one.path == "b")
    assert tuned.resolved.values["x_start"].value.tolist() == [0.0, 0.0]
    for engine in ("reference", "native"):
        run = d.start(stop=0.0005, engine=engine)
        for name, value in fast.items():
            run.set(name, value)
        run.advance(0.0005)
        t = np.asarray(run.results.t)
        assert run.results["b.y"] == pytest.approx(companion(np.array(fast["b.den"]), t), abs=1e-6)
    still = d.start(parameters=fast, stop=0.0005)
    still.advance(0.0005)
    last = companion(np.array(fast["b.den"]), np.array([0.0005]))[0]
    assert run["b.y"] == pytest.approx(last, abs=1e-6)
    assert w**2 * still.snapshot().rows["x"][0] == pytest.approx(last, abs=1e-6)  # the first state is y/num


@pytest.mark.parametrize(
    "block",
    [ZeroPoleGain(poles=[-3.0], k=1e7), LeadLag(k=1e7, T1=0.0, T2=1.0), TransferFunction(num=[1e7], den=[1.0, 1.0])],
    ids=lambda block: type(block).__name__,
)
def test_a_state_behind_which_a_high_gain_stands_is_small(block: Any) -> None:
    """In a loop that holds the output at about 1, the state is near 1e-7."""
    d = Diagram("loop")
    b, error = d.add("b", block), d.add("error", Sum(signs="+-"))
    d.wire(error.u1, d.add("wanted", Constant()).y)
    d.wire(error.u2, b.y)
    d.wire(b.u, error.y)
    results = d.run(stop=1e-5, every=1e-7, rtol=1e-6, atol=1e-9)
    pole = 3.0 if isinstance(block, ZeroPoleGain) else 1.0
    a = pole + 1e7
    expected = -1e7 / a * np.expm1(-a * np.asarray(results.t))
    assert results["b.y"] == pytest.approx(expected, abs=1e-6)


# --- nonlinear characteristics ---------------------------------------------------------------------------------


def test_a_dead_zone_cuts_the_middle_out_of_a_sine() -> None:
    d = Diagram("dead")
    zone, integral = d.add("b", DeadZone(lower=-1.0, upper=0.5)), d.add("integral", Integrator())
    d.wire(zone.u, d.add("sine", Sine(amplitude=2.0)).y)
    d.wire(integral.u, zone.y)
    results = d.run(stop=6.0, every=0.1, **TIGHT)
    high, low = math.asin(0.25), math.asin(0.5)
    times = [high, math.pi - high, math.pi + low, 2.0 * math.pi - low]
    assert fired(results) == [
        (pytest.approx(t, abs=INSTANT), what)
        for t, what in zip(times, ("above", "above", "below", "below"), strict=True)
    ]
    u = 2.0 * np.sin(results.t)
    expected = np.maximum(u - 0.5, 0.0) + np.minimum(u + 1.0, 0.0)
    assert results["b.y"] == pytest.approx(expected, abs=1e-9)
    above = 4.0 * math.cos(high) - 0.5 * (math.pi - 2.0 * high)
    below = (math.pi - 2.0 * low) - 4.0 * math.cos(low)
    assert results["integral.y"][-1] == pytest.approx(above + below, abs=CLOSE)


def relay_loop(relay: Relay, plant: Any, **run: Any) -> Results:
    """A relay on the negative output of a plant."""
    d = Diagram("loop")
    switch, system, minus = d.add("b", relay), d.add("plant", plant), d.add("minus", Gain(k=-1.0))
    d.wire(minus.u, system.y)
    d.wire(switch.u, minus.y)
    d.wire(system.u, switch.y)
    return d.run(**{**TIGHT, **run})


def test_a_relay_and_an_integrator_make_a_triangle() -> None:
    width, on, off = 0.3, 2.0, -0.5
    results = relay_loop(Relay(on_at=width, off_at=-width, on=on, off=off), Integrator(), stop=10.0, every=0.01)
    # From 0, off: down to -width, up to width, and so on. u = -y.
    times = [width / -off]
    while times[-1] <= 10.0:
        times.append(times[-1] + 2.0 * width / (on if len(times) % 2 else -off))
    assert [t for t, _ in fired(results)] == pytest.approx(times[:-1], abs=INSTANT)
    y = np.asarray(results["plant.y"])
    assert (np.min(y), np.max(y)) == pytest.approx((-width, width), abs=1e-9)
    assert set(np.asarray(results["b.y"])) == {on, off}


def test_a_relay_and_a_lag_oscillate_with_the_period_of_the_closed_form() -> None:
    width, level, k, T = 0.25, 1.5, 2.0, 0.7
    relay = Relay(on_at=width, off_at=-width, on=level, off=-level, starts_on=True)
    results = relay_loop(relay, FirstOrder(k=k, T=T), stop=10.0, every=0.01, jumps=True)
    half = T * math.log((k * level + width) / (k * level - width))
    first = T * math.log(k * level / (k * level - width))
    found = [t for t, _ in fired(results)]
    assert found == pytest.approx([first + half * n for n in range(len(found))], abs=1e-8)
    assert len(found) == 1 + int((10.0 - first) / half)
    assert np.max(np.abs(results["plant.y"])) == pytest.approx(width, abs=1e-9)


def test_a_relay_with_unequal_levels_heats_for_its_share_of_the_time() -> None:
    """A thermostat: T dy/dt = k u - y between off_at and on_at of -y, with 5 or 0 at its input."""
    low, high, power, T = 1.0, 1.5, 5.0, 2.0
    relay = Relay(on_at=-low, off_at=-high, on=power, off=0.0)
    results = relay_loop(relay, FirstOrder(T=T, y_start=1.2), stop=10.0, every=0.01)
    heats, cools = T * math.log((power - low) / (power - high)), T * math.log(high / low)
    found = [t for t, _ in fired(results)]
    assert found[0] == pytest.approx(T * math.log(1.2 / low), abs=1e-8)
    assert np.diff(found) == pytest.approx([(heats, cools)[n % 2] for n in range(len(found) - 1)], abs=1e-8)


@pytest.mark.parametrize(
    ("u", "starts_on", "y"), [(0.0, False, -2.0), (0.0, True, 2.0), (1.0, False, 2.0), (-1.1, True, -2.0)]
)
def test_a_relay_starts_as_its_input_says_or_else_as_it_was_told(u: float, starts_on: bool, y: float) -> None:
    results = driven(Relay(on=2.0, off=-2.0, starts_on=starts_on), Constant(value=u), stop=1.0)
    assert results["b.y"][0] == y
    assert fired(results) == []


def test_a_relay_follows_jumps_and_remembers_in_between() -> None:
    d = Diagram("jumps")
    d.wire(d.add("b", Relay()).u, d.input("u"))
    t, u = np.arange(8.0), np.array([0.0, 1.0, 0.0, -1.0, -1.1, 0.9, 5.0, -5.0])
    results = d.run(stop=8.0, every=1.0, inputs={"u": (t, u, "hold")})
    assert fired(results) == [(1.0, "switch"), (4.0, "switch"), (6.0, "switch"), (7.0, "switch")]
    right = np.asarray(results["b.y"])[rights(results)]
    assert right[:8].tolist() == [-1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]


def test_a_relay_without_hysteresis_compares_and_does_not_slide() -> None:
    results = driven(Relay(on_at=0.5, off_at=0.5), Sine(), stop=6.0)
    assert [t for t, _ in fired(results)] == pytest.approx([math.pi / 6, math.pi * 5 / 6], abs=INSTANT)
    with pytest.raises(SimulationError, match=r"E30[45] b\.switch"):
        relay_loop(Relay(on_at=0.0, off_at=0.0), Integrator(y_start=1.0), stop=3.0)


def quantized(u: Array, interval: float) -> Array:
    return interval * np.floor(u / interval + 0.5)


def test_a_quantizer_changes_at_the_edges_of_its_levels() -> None:
    results = driven(Quantizer(interval=0.3), Ramp(before=-1.0, slope=0.7), stop=4.0, every=0.01)
    edges = [(n + 0.5) * 0.3 for n in range(-4, 7) if -1.0 < (n + 0.5) * 0.3 <= 1.8]
    assert fired(results) == [(pytest.approx((edge + 1.0) / 0.7, abs=1e-12), "above") for edge in edges]
    t = np.asarray(results.t)
    far = np.min(np.abs((-1.0 + 0.7 * t)[:, None] - np.array(edges)), axis=1) > 1e-9
    assert np.asarray(results["b.y"])[far] == pytest.approx(quantized(-1.0 + 0.7 * t, 0.3)[far], abs=1e-12)


def test_a_quantizer_of_a_fast_sine_misses_no_level() -> None:
    amplitude, w, interval, stop = 5.0, 20.0, 0.5, 1.0
    d = Diagram("fast")
    block, integral = d.add("b", Quantizer(interval=interval)), d.add("integral", Integrator())
    d.wire(block.u, d.add("sine", Sine(amplitude=amplitude, omega=w)).y)
    d.wire(integral.u, block.y)
    results = d.run(stop=stop, every=0.001, **TIGHT)
    # Each edge in (0, amplitude) is passed at both sides of each crest, and its negative at those of each trough.
    expected = []
    for edge in (np.arange(10) + 0.5) * interval:
        a = math.asin(edge / amplitude)
        for n in range(5):
            for t, what in (
                (a + 2 * n * math.pi, "above"),
                (math.pi - a + 2 * n * math.pi, "below"),
                (math.pi + a + 2 * n * math.pi, "below"),
                (2 * math.pi - a + 2 * n * math.pi, "above"),
            ):
                if t / w <= stop:
                    expected.append((t / w, what))
    expected.sort()
    found = fired(results)
    assert [what for _, what in found] == [what for _, what in expected]
    assert [t for t, _ in found] == pytest.approx([t for t, _ in expected], abs=INSTANT)
    t = np.asarray(results.t)
    far = np.min(np.abs(t[:, None] - np.array([t for t, _ in expected])), axis=1) > 1e-8
    assert np.asarray(results["b.y"])[far] == pytest.approx(
        quantized(amplitude * np.sin(w * t), interval)[far], abs=1e-12
    )
    # y is constant between its edges, so that its integral is a sum.
    times = np.array([0.0, *(t for t, _ in expected), stop])
    middle = 0.5 * (times[1:] + times[:-1])
    total = np.sum(quantized(amplitude * np.sin(w * middle), interval) * np.diff(times))
    assert results["integral.y"][-1] == pytest.approx(total, abs=CLOSE)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(-60, 60), min_size=1, max_size=12), st.sampled_from([1.0, 0.1, 0.3, 1e-3, 7.0]))
@example([0, 1, 3, -3, -1, 1], 0.1)
def test_a_quantizer_jumps_over_many_levels_and_onto_edges(halves: list[int], interval: float) -> None:
    """u jumps among multiples of interval/2, half of which are edges, and then rises by a little more than a level."""
    d = Diagram("jumps")
    block, total = d.add("b", Quantizer(interval=interval)), d.add("total", Sum())
    d.wire(total.u1, d.input("u"))
    d.wire(total.u2, d.add("ramp", Ramp(at=float(len(halves)), slope=1.1 * interval)).y)
    d.wire(block.u, total.y)
    t, u = np.arange(float(len(halves))), np.array(halves) * 0.5 * interval
    results = d.run(stop=len(halves) + 1.0, every=0.5, method="rk4", step=0.1, inputs={"u": (t, u, "hold")})
    found = np.asarray(results["b.y"]) / interval
    for n, half in enumerate(halves):
        level = found[np.searchsorted(results.t, n + 0.5)]
        if half % 2:  # on an edge, rounding chooses the side
            assert min(abs(level - (half + 1) // 2), abs(level - (half - 1) // 2)) < 1e-9
        else:
            assert level == pytest.approx(half // 2, abs=1e-9)
    assert found[-1] == pytest.approx(math.floor(halves[-1] / 2 + 1.1 + 0.5), abs=1e-9)


@given(st.floats(-1e6, 1e6), st.floats(1e-4, 1e4))
@example(0.15, 0.1)
@example(-19.450000000000003, 0.1)  # of which the quotient rounds across the edge
@example(-0.15, 0.3)
@example(0.5, 1.0)
@example(-0.5, 1.0)
def test_the_level_of_a_quantizer_is_one_that_its_crossings_agree_with(u: float, interval: float) -> None:
    made = resolved("Quantizer", interval=interval)
    values = {"t": 0.0, "u": u, "interval": interval, "above": False, "below": True, "y": 0.0}
    level = float(numeric(made.interface, {**values, "level": 0.0})["initial:level"][0])
    sides = numeric(made.interface, {**values, "level": level})
    assert sides["crossing:above"][0] < 0.0 <= sides["crossing:below"][0]
    assert abs(level * interval - u) <= 0.5 * interval * (1.0 + 1e-9) + 1e-15 * abs(u)


def test_halfway_a_quantizer_takes_the_upper_level() -> None:
    for u, y in ((0.5, 1.0), (-0.5, 0.0), (1.5, 2.0), (-1.5, -1.0)):
        assert driven(Quantizer(), Constant(value=u), stop=1.0)["b.y"][0] == y


def test_a_quantized_loop_is_that_of_equations_written_by_hand() -> None:
    """2 dy/dt = 4 sin t - quantized(y) - y, piece by piece between the edges."""
    interval, stop = 0.25, 3.0
    d = Diagram("loop")
    plant, block = d.add("plant", FirstOrder(T=2.0)), d.add("b", Quantizer(interval=interval))
    total = d.add("total", Sum(signs="+-"))
    d.wire(block.u, plant.y)
    d.wire(total.u1, d.add("sine", Sine(amplitude=4.0)).y)
    d.wire(total.u2, block.y)
    d.wire(plant.u, total.y)
    results = d.run(stop=stop, every=0.25, **TIGHT)
    t, y, level, times = 0.0, 0.0, 0, []
    while t < stop:

        def slope(t: float, y: Array, level: int = level) -> list[float]:
            return [(4.0 * math.sin(t) - interval * level - y[0]) / 2.0]

        def above(t: float, y: Array, level: int = level) -> float:
            return float(y[0] - (level + 0.5) * interval)

        def below(t: float, y: Array, level: int = level) -> float:
            return float(y[0] - (level - 0.5) * interval)

        edges: list[Any] = [above, below]
        for edge, direction in zip(edges, (1.0, -1.0), strict=True):
            edge.terminal, edge.direction = True, direction
        piece = solve_ivp(slope, (t, stop), [y], "DOP853", events=edges, max_step=0.01, rtol=1e-12, atol=1e-13)
        t, y = float(piece.t[-1]), float(piece.y[0, -1])
        if piece.status == 1:
            level += 1 if len(piece.t_events[0]) else -1
            times.append(t)
    assert results["plant.y"][-1] == pytest.approx(y, abs=CLOSE)
    assert [at for at, _ in fired(results)] == pytest.approx(times, abs=CLOSE)
    assert len(times) > 5


# --- files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "block",
    [
        ResettableIntegrator(direction="both", threshold=0.5, unit="m", y_start=1.0),
        LimitedIntegrator(lower=-1.0, upper=2.0),
        Derivative(Tf=0.1, unit="m/s"),
        FirstOrder(k=2.0, T=0.5),
        SecondOrder(k=2.0, d=0.1, w=30.0),
        LeadLag(k=3.0, T1=0.0, T2=2.0),
        ZeroPoleGain(zeros=[], poles=[-1.0, -1.0], poles_imag=[2.0, -2.0], k=5.0),
        DeadZone(lower=-2.0, upper=0.5),
        Relay(on_at=0.5, off_at=0.25, starts_on=True),
        Quantizer(interval=0.1),
    ],
    ids=lambda block: type(block).__name__,
)
def test_a_block_in_a_file_runs_as_the_one_in_python(block: Any) -> None:
    d = Diagram("file")
    made = d.add("b", block)
    sine = d.add("sine", Sine(amplitude=3.0, omega=5.0))
    d.wire(made.u, sine.y)
    if isinstance(block, ResettableIntegrator):
        d.wire(made.trigger, sine.y)
    again = Diagram.from_json(d.to_json())
    assert again.to_json() == d.to_json()
    ours, theirs = (one.run(stop=1.0, every=0.1) for one in (d, again))
    assert np.array_equal(ours.values, theirs.values)
    assert ours.events == theirs.events
