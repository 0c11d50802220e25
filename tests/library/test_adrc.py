"""Feedbacks and extended state observers in continuous and in sampled time, and the controllers of diagrams/adrc.

Witnesses: python-control (pole placement, loops of state-space systems), SciPy (matrix exponentials, equations written
by hand, located crossings), recursions in numpy, and gains in closed form from the literature.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from blocks import (
    LESO,
    LSEF,
    NESO,
    Constant,
    Diagram,
    DiscreteESO,
    Gain,
    Integrator,
    MassSpringDamper,
    ModelError,
    Results,
    Sine,
    Step,
    Sum,
    TransferFunction,
    ZeroOrderHold,
    subdiagram,
)
from tests.support.adrc import after, chain, evaluate, gains_of, resolved, right_rows
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]

FOLDER = ROOT / "diagrams"

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""

each_order = pytest.mark.parametrize("order", [1, 2, 3])
each_form = pytest.mark.parametrize("form", ["euler", "zoh", "current"])


# --- the linear feedback ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_the_bandwidth_of_a_feedback_puts_all_poles_of_the_chain_in_one_place(order: int) -> None:
    b0, speed = -2.5, 3.0
    A, B = np.eye(order, k=1), np.eye(order)[:, -1:] * b0
    gains = gains_of("LSEF", order=order, bandwidth=speed)
    assert gains == pytest.approx(b0 * np.ravel(control.acker(A, B, [-speed] * order)), rel=1e-9)
    u = [
        evaluate("LSEF", {"order": order, "bandwidth": speed, "b0": b0}, r=np.zeros(order), z=z)["output:u"][0]
        for z in np.eye(order + 1)
    ]
    assert np.poly(A + B @ [u[:order]]) == pytest.approx(np.poly([-speed] * order), rel=1e-9)
    assert u[order] == pytest.approx(-1.0 / b0, rel=1e-15)


def test_a_linear_feedback_takes_what_is_not_wired_of_its_reference_for_0() -> None:
    d = Diagram("bare")
    one, law = d.add("one", Constant(value=1.0)), d.add("law", LSEF(order=3, gains=[5.0, 7.0, 11.0], b0=2.0))
    for port in (law.r1, law.z1, law.z2, law.z3, law.z4):
        d.wire(port, one.y)
    assert d.run(stop=1.0)["law.u"][-1] == (5.0 * (1.0 - 1.0) - 7.0 - 11.0 - 1.0) / 2.0
    d.wire(law.r3, one.y)
    assert d.run(stop=1.0)["law.u"][-1] == (-7.0 - 1.0) / 2.0


def test_gains_have_the_units_that_their_errors_need() -> None:
    def units(name: str, **given: Any) -> tuple[str, ...]:
        interface = resolved(name, **given).interface
        return interface.declared_units(interface.declaration.parameters["gains"])

    assert units("LSEF", order=3, bandwidth=1.0) == ("1/s3", "1/s2", "1/s")
    assert units("LESO", order=2, bandwidth=1.0) == ("1/s", "1/s2", "1/s3")
    assert units("DiscreteESO", order=2, bandwidth=1.0, period=0.1) == ("1", "1/s", "1/s2")


# --- the nonlinear observer ------------------------------------------------------------------------------------


@each_order
def test_a_nonlinear_observer_is_the_linear_one_where_the_error_is_small(order: int) -> None:
    given = {"order": order, "bandwidth": 20.0, "b0": 3.0}
    z = np.array([0.4, -2.0, 5.0, 7.0])[: order + 1]
    sides = {"above": np.False_, "below": np.False_}
    ours = evaluate("NESO", {**given, "delta": 0.02}, y=0.41, u=1.5, z=z, **sides)["derivative:z"]
    linear = evaluate("LESO", given, y=0.41, u=1.5, z=z)["derivative:z"]
    assert ours == pytest.approx(linear, rel=1e-13)


@each_order
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_nonlinear_observer_has_hans_laws_where_the_error_is_large(order: int, sign: float) -> None:
    gains, delta, b0, u = [11.0, 22.0, 33.0, 44.0][: order + 1], 0.01, 3.0, 1.5
    z, e = np.array([0.4, -2.0, 5.0, 7.0])[: order + 1], 0.3 * sign
    sides = {"above": np.bool_(sign > 0), "below": np.bool_(sign < 0)}
    given = {"order": order, "gains": gains, "delta": delta, "b0": b0}
    made = evaluate("NESO", given, y=0.4 + e, u=u, z=z, **sides)
    for k in range(order + 1):
        law = sign * math.pow(0.3, 0.5**k)
        assert made["local:law"][k] == pytest.approx(law, rel=1e-14)
        ahead = (z[k + 1] if k < order else 0.0) + (b0 * u if k == order - 1 else 0.0)
        assert made["derivative:z"][k] == pytest.approx(ahead + gains[k] * law, rel=1e-13)


def nonlinear_slopes(gains: Array, delta: float, b0: float) -> Callable[[float, Array], Array]:
    """Han's observer of order 2 on y = sin 3t, u = cos t, by hand."""
    alpha = np.array([1.0, 0.5, 0.25])

    def slopes(t: float, z: Array) -> Array:
        e = math.sin(3.0 * t) - z[0]
        law = np.abs(e) ** alpha * math.copysign(1.0, e) if abs(e) > delta else e / delta ** (1.0 - alpha)
        return np.array([z[1], z[2] + b0 * math.cos(t), 0.0]) + gains * law

    return slopes


def test_a_nonlinear_observer_is_that_of_equations_written_by_hand() -> None:
    bandwidth, delta, b0 = 8.0, 0.02, 2.0
    d = Diagram("neso")
    y, u = d.add("y", Sine(omega=3.0)), d.add("u", Sine(phase=math.pi / 2))
    eso = d.add("eso", NESO(bandwidth=bandwidth, delta=delta, b0=b0, z_start=[0.5, 0.0, 0.0]))
    d.wire(eso.y, y.y)
    d.wire(eso.u, u.y)
    results = d.run(stop=4.0, every=0.5, **TIGHT)
    gains = np.array([24.0, 192.0 * delta**0.5, 512.0 * delta**0.75])
    slopes = nonlinear_slopes(gains, delta, b0)

    def passes(t: float, z: Array) -> float:
        return abs(math.sin(3.0 * t) - z[0]) - delta

    # SciPy straddles the corners: short steps keep what that costs below CLOSE.
    span, times = (0.0, 4.0), np.arange(0.0, 4.1, 0.5)
    z0 = np.array([0.5, 0.0, 0.0])
    expected = solve_ivp(slopes, span, z0, "DOP853", times, events=passes, rtol=1e-11, atol=1e-12, max_step=1e-3)
    rows = right_rows(results, times)
    for k in range(3):
        assert results[f"eso.z{k + 1}"][rows] == pytest.approx(expected.y[k], abs=100 * CLOSE)
    assert len(expected.t_events[0]) > 4
    assert [event.t for event in results.events] == pytest.approx(expected.t_events[0], abs=1e-6)


@each_order
def test_a_nonlinear_observer_finds_a_constant_disturbance_from_far_off(order: int) -> None:
    d = Diagram("far")
    zero, f = d.add("zero", Constant(value=0.0)), d.add("f", Constant(value=2.0))
    before = f.y
    for k in range(order):
        integrator = d.add(f"x{order - k}", Integrator(y_start=5.0 if k == order - 1 else 0.0))
        d.wire(integrator.u, before)
        before = integrator.y
    eso = d.add("eso", NESO(order=order, bandwidth=20.0))
    d.wire(eso.y, before)
    d.wire(eso.u, zero.y)
    results = d.run(stop=6.0, every=0.1)
    assert results[f"eso.z{order + 1}"][-1] == pytest.approx(2.0, rel=1e-4)
    assert np.max(np.abs(results[f"eso.z{order + 1}"])) < 0.5 * peak_of_the_linear(order)


def peak_of_the_linear(order: int) -> float:
    """How far the last estimate of a LESO swings where it starts 5 off: by the exponential of its error's matrix."""
    A, _, C = chain(order, 1.0)
    loop = A - gains_of("LESO", order=order, bandwidth=20.0)[:, None] @ C
    start = 5.0 * np.eye(order + 1)[0]
    return float(max(abs((expm(loop * t) @ start)[order]) for t in np.linspace(0.0, 1.0, 1001)))


# --- the sampled observer --------------------------------------------------------------------------------------


def error_matrix(**given: Any) -> Array:
    """What makes the next error of a sampled observer from the last: of y = 0, u = 0."""
    order = given["order"]
    return np.array([
        evaluate("DiscreteESO", given, y=0.0, u=0.0, x=x)["next:x"] for x in np.eye(order + 1)
    ]).T  # fmt: skip


@each_form
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("reach", [0.01, 0.3, 1.5])
def test_all_poles_of_a_sampled_observer_lie_where_they_are_wanted(form: str, order: int, reach: float) -> None:
    period = 0.05
    bandwidth = reach / period
    pole = 1.0 - reach if form == "euler" else math.exp(-reach)
    matrix = error_matrix(form=form, order=order, period=period, bandwidth=bandwidth, b0=2.0)
    # With the time in units of period/(1 - pole), the matrix less 1 over 1 - pole has all poles at -1.
    scale = (period / (1.0 - pole)) ** np.arange(order + 1)
    scaled = (matrix * scale[:, None] / scale[None, :] - np.eye(order + 1)) / (1.0 - pole)
    assert np.poly(scaled) == pytest.approx(np.poly([-1.0] * (order + 1)), rel=1e-11)


@pytest.mark.parametrize("bandwidth", [0.01, 3.0, 40.0])
def test_the_gains_of_the_current_form_are_those_of_the_fading_memory_filter(bandwidth: float) -> None:
    # N. Morrison, Introduction to Sequential Smoothing and Prediction, McGraw-Hill 1969, section 13.6.
    T = 0.02
    b, c = math.exp(-bandwidth * T), -math.expm1(-bandwidth * T)
    closed = {
        1: [c * (1 + b), c**2 / T],
        2: [c * (1 + b + b**2), 1.5 * c**2 * (1 + b) / T, c**3 / T**2],
        3: [
            c * (1 + b + b**2 + b**3),
            c**2 * (11 + 14 * b + 11 * b**2) / (6 * T),
            2 * c**3 * (1 + b) / T**2,
            c**4 / T**3,
        ],
    }
    for order, expected in closed.items():
        gains = gains_of("DiscreteESO", order=order, period=T, bandwidth=bandwidth)
        assert gains == pytest.approx(expected, rel=1e-12)


@each_order
def test_the_gains_of_a_sampled_observer_are_those_of_pole_placement(order: int) -> None:
    T, bandwidth = 0.1, 8.0
    A, B, C = chain(order, 1.0)
    model, _ = after(A, B, T)
    wanted = [math.exp(-bandwidth * T)] * (order + 1)
    placed = np.ravel(control.acker(model.T, C.T, wanted))
    given = {"order": order, "period": T, "bandwidth": bandwidth}
    assert gains_of("DiscreteESO", form="zoh", **given) == pytest.approx(placed, rel=1e-9)
    assert gains_of("DiscreteESO", form="current", **given) == pytest.approx(np.linalg.solve(model, placed), rel=1e-9)
    linear = np.array([math.comb(order + 1, k) * bandwidth**k for k in range(1, order + 2)])
    assert gains_of("DiscreteESO", form="euler", **given) == pytest.approx(T * linear, rel=1e-14)


def sampled_loop(form: str, order: int, T: float, b0: float, f: float) -> Results:
    """y^(order) = f + b0 u under a sampled observer and a feedback that wants y = 1."""
    d = Diagram("sampled")
    wanted, disturbance = d.add("wanted", Constant()), d.add("disturbance", Constant(value=f))
    gain, total = d.add("gain", Gain(k=b0)), d.add("total", Sum())
    law = d.add("law", LSEF(order=order, bandwidth=2.0, b0=b0))
    eso = d.add("eso", DiscreteESO(form=form, order=order, period=T, bandwidth=10.0, b0=b0))
    before = total.y
    for k in range(order):
        integrator = d.add(f"x{order - k}", Integrator())
        d.wire(integrator.u, before)
        before = integrator.y
    d.wire(gain.u, law.u)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, disturbance.y)
    d.wire(eso.y, before)
    d.wire(eso.u, law.u)
    d.wire(law.r1, wanted.y)
    for k in range(order + 1):
        d.wire(getattr(law, f"z{k + 1}"), getattr(eso, f"z{k + 1}"))
    return d.run(stop=10.0, every=T, **TIGHT)


@each_form
@each_order
def test_a_sampled_loop_is_its_recursion(form: str, order: int) -> None:
    T, b0, f, count = 0.05, 2.0, -3.0, 201
    results = sampled_loop(form, order, T, b0, f)
    A, B, _ = chain(order, b0)
    plant, held = after(A, B, T)
    model, drive = (np.eye(order + 1) + T * A, T * B) if form == "euler" else (plant, held)
    gains = gains_of("DiscreteESO", form=form, order=order, period=T, bandwidth=10.0)
    k = gains_of("LSEF", order=order, bandwidth=2.0)
    x, guess = np.append(np.zeros(order), f), np.zeros(order + 1)
    rows = right_rows(results, np.arange(count) * T)
    for row in rows:
        e = x[0] - guess[0]
        z = guess + gains * e if form == "current" else guess
        u = (k @ (np.eye(order)[0] - z[:order]) - z[order]) / b0
        assert [results[f"x{i + 1}.y"][row] for i in range(order)] == pytest.approx(x[:order], rel=CLOSE, abs=CLOSE)
        assert [results[f"eso.z{i + 1}"][row] for i in range(order + 1)] == pytest.approx(z, rel=CLOSE, abs=CLOSE)
        assert results["law.u"][row] == pytest.approx(u, rel=CLOSE, abs=CLOSE)
        guess = model @ z + drive[:, 0] * u + (0.0 if form == "current" else gains * e)
        x = plant @ x + held[:, 0] * u
    # The disturbance is found and rejected; of Euler's model, too, for at rest it is right.
    assert results["x1.y"][-1] == pytest.approx(1.0, abs=1e-4)
    assert results[f"eso.z{order + 1}"][-1] == pytest.approx(f, abs=1e-3)


def estimates(block: Any) -> Array:
    """What an observer of order 2 makes of y = sin 2t and u = cos t, at 3 s."""
    d = Diagram("open")
    y, u = d.add("y", Sine(omega=2.0)), d.add("u", Sine(phase=math.pi / 2))
    eso = d.add("eso", block)
    d.wire(eso.y, y.y)
    d.wire(eso.u, u.y)
    results = d.run(stop=3.0, every=1.0, **TIGHT)
    return np.array([results[f"eso.z{k}"][-1] for k in (1, 2, 3)])


@each_form
def test_a_sampled_observer_becomes_the_continuous_one_with_the_first_order_of_its_period(form: str) -> None:
    limit = estimates(LESO(bandwidth=6.0, b0=1.5))
    periods = (0.01, 0.005, 0.0025)
    off = [estimates(DiscreteESO(form=form, bandwidth=6.0, b0=1.5, period=T)) - limit for T in periods]
    sizes = [float(np.max(np.abs(error))) for error in off]
    # The inputs are seen up to a period late, so that errors fall with the period; 0.05 is for the terms of its square.
    assert [a / b for a, b in pairwise(sizes)] == pytest.approx([2.0, 2.0], rel=0.05)


def test_before_its_first_tick_a_sampled_observer_holds_its_start() -> None:
    d = Diagram("late")
    one = d.add("one", Constant())
    eso = d.add("eso", DiscreteESO(period=1.0, offset=0.5, bandwidth=1.0, z_start=[3.0, 2.0, 1.0]))
    d.wire(eso.y, one.y)
    d.wire(eso.u, one.y)
    results = d.run(stop=1.0, every=0.25, jumps=True)
    k = gains_of("DiscreteESO", period=1.0, bandwidth=1.0)
    for j, start in enumerate((3.0, 2.0, 1.0)):
        first = start + k[j] * (1.0 - 3.0)
        assert results[f"eso.z{j + 1}"].tolist() == pytest.approx([start] * 3 + [first] * 3, rel=1e-15)


def test_only_the_current_form_lets_the_measurement_of_a_tick_through_at_that_tick() -> None:
    for form, share in (("euler", 0.0), ("zoh", 0.0), ("current", 1.0)):
        given = {"form": form, "gains": [0.5, 0.25, 0.125], "period": 0.1}
        made = evaluate("DiscreteESO", given, y=2.0, u=9.0, x=np.array([1.0, 10.0, 100.0]))["output:z"]
        assert made.tolist() == [1.0 + 0.5 * share, 10.0 + 0.25 * share, 100.0 + 0.125 * share]


# --- the controllers of diagrams/adrc --------------------------------------------------------------------------


def controlled(order: int, plant: Any, *, f: float = 0.0, **tuning: Any) -> Diagram:
    """A plant with input u and output y under the controller of a file: 1 is wanted, f is added to u from 4 s on."""
    d = Diagram("controlled", folder=FOLDER)
    wanted, disturbance = d.add("wanted", Step()), d.add("disturbance", Step(at=4.0, after=f))
    loop, total = d.add("loop", subdiagram(f"adrc/adrc_{order}.json", **tuning)), d.add("total", Sum())
    system = d.add("system", plant)
    d.wire(loop.r, wanted.y)
    d.wire(loop.y, system.y)
    d.wire(total.u1, loop.u)
    d.wire(total.u2, disturbance.y)
    d.wire(system.u, total.y)
    return d


PLANTS = {1: [1.0, 0.7], 2: [1.0, 1.2, 3.0], 3: [1.0, 2.0, 1.5, 0.8]}
"""Denominators of plants of order 1 to 3, above which stands b."""


def matrices(order: int, b: float, b0: float, omega_c: float, omega_o: float) -> tuple[Any, Any, Any]:
    """The plant, and the controller from (r, y) to u, written from Gao's equations."""
    plant = control.ss(control.tf([b], PLANTS[order]))
    A, B, C = chain(order, b0)
    L = np.array([[math.comb(order + 1, k) * omega_o**k] for k in range(1, order + 2)])
    K = np.array([[*(math.comb(order, k) * omega_c ** (order - k) for k in range(order)), 1.0]]) / b0
    R = np.array([[K[0, 0]]])
    made = control.ss(A - L @ C - B @ K, np.hstack([B @ R, L]), -K, np.hstack([R, [[0.0]]]))
    return plant, made, L


@each_order
@pytest.mark.parametrize("share", [1.0, 0.7], ids=["exact b0", "another b0"])
def test_a_loop_without_limits_is_that_of_python_control(order: int, share: float) -> None:
    b, omega_c, omega_o, f = 2.0, 3.0, 15.0, 1.5
    b0 = share * b
    diagram = controlled(
        order, TransferFunction(num=[b], den=PLANTS[order]), f=f, b0=b0, omega_c=omega_c, omega_o=omega_o
    )
    results = diagram.run(stop=8.0, every=0.5, **TIGHT)
    plant, made, _ = matrices(order, b, b0, omega_c, omega_o)
    plant.set_inputs(["v"]), plant.set_outputs(["y"])
    made.set_inputs(["r", "y"]), made.set_outputs(["u"])
    total = control.summing_junction(["u", "d"], "v")
    closed = control.interconnect([plant, made, total], inputs=["r", "d"], outputs=["y", "u"])
    both = np.block([[closed.A, closed.B], [np.zeros((2, closed.nstates + 2))]])
    x = np.zeros(closed.nstates)
    for t in np.arange(0.0, 8.1, 0.5):
        u = np.array([1.0, f if t >= 4.0 else 0.0])
        row = right_rows(results, np.array([t]))[0]
        y = closed.C @ x + closed.D @ u
        assert [results["system.y"][row], results["loop.u"][row]] == pytest.approx(y, rel=CLOSE, abs=10 * CLOSE)
        x = (expm(0.5 * both) @ np.concatenate([x, u]))[: closed.nstates]
    # The step's transient has died out, and the disturbance's nearly: nothing is left of either.
    assert results["system.y"][right_rows(results, np.array([4.0]))[0]] == pytest.approx(1.0, abs=0.02)
    assert results["system.y"][-1] == pytest.approx(1.0, abs=0.02)
    assert np.all(np.real(closed.poles()) < 0)
    # What is left for good, by the DC gain, is nothing.
    assert closed.dcgain()[0] == pytest.approx([1.0, 0.0], abs=1e-9)


@each_order
def test_with_the_exact_b0_and_a_constant_disturbance_all_poles_lie_at_the_bandwidths(order: int) -> None:
    b0, omega_c, omega_o, f = 2.0, 3.0, 12.0, -4.0
    # The plant is the chain itself, so that f is constant.
    den = [1.0] + [0.0] * order
    diagram = controlled(order, TransferFunction(num=[b0], den=den), f=f / b0, b0=b0, omega_c=omega_c, omega_o=omega_o)
    results = diagram.run(stop=14.0, every=0.25, **TIGHT)
    # Gao's poles: r passes through omega_c^n/(s + omega_c)^n alone, for the estimates begin right.
    t = np.arange(0.0, 4.0, 0.25)
    _, y = control.forced_response(control.tf([omega_c**order], np.poly([-omega_c] * order)), t, np.ones(len(t)))
    assert results["system.y"][right_rows(results, t)] == pytest.approx(y, abs=CLOSE)
    assert results["system.y"][-1] == pytest.approx(1.0, abs=CLOSE)
    assert results[f"loop.z{order + 1}"][-1] == pytest.approx(f, rel=CLOSE)
    assert results["loop.u"][-1] == pytest.approx(-f / b0, rel=CLOSE)
    # And the disturbance is estimated through omega_o^(n+1)/(s + omega_o)^(n+1).
    t = np.arange(0.0, 8.0, 0.25)
    _, z = control.forced_response(control.tf([omega_o ** (order + 1)], np.poly([-omega_o] * (order + 1))), t, f)
    assert results[f"loop.z{order + 1}"][right_rows(results, t + 4.0)] == pytest.approx(z, abs=10 * CLOSE)


@each_order
def test_a_limited_loop_is_that_of_equations_written_by_hand(order: int) -> None:
    b, b0, omega_c, omega_o, f = 2.0, 1.6, 3.0, 12.0, 0.3
    lower, upper = -0.5, {1: 1.2, 2: 2.5, 3: 1.0}[order]
    tuning = {"b0": b0, "omega_c": omega_c, "omega_o": omega_o, "lower": lower, "upper": upper}
    plant = TransferFunction(num=[b], den=PLANTS[order])
    results = controlled(order, plant, f=f, **tuning).run(stop=8.0, every=0.5, **TIGHT)
    n, a = order, PLANTS[order][:0:-1]
    gains = [math.comb(n + 1, k) * omega_o**k for k in range(1, n + 2)]

    def control_of(z: Array) -> float:
        wanted = sum(math.comb(n, k) * omega_c ** (n - k) * ((1.0 if k == 0 else 0.0) - z[k]) for k in range(n))
        return float(min(max((wanted - z[n]) / b0, lower), upper))

    def slopes(t: float, state: Array) -> list[float]:
        y, z = state[:n], state[n:]  # the plant's output and its derivatives
        u = control_of(z)
        push = b * (u + (f if t >= 4.0 else 0.0))
        e = y[0] - z[0]
        ahead = [*z[1:], 0.0]
        ahead[n - 1] += b0 * u
        return [
            *y[1:],
            push - sum(c * part for c, part in zip(a, y, strict=True)),
            *(part + gain * e for part, gain in zip(ahead, gains, strict=True)),
        ]

    x: Array = np.zeros(2 * n + 1)
    for begin in (0.0, 4.0):
        times = np.arange(begin, begin + 4.01, 0.5)
        end = times[-1] - 1e-12 if begin == 0.0 else times[-1]
        expected = solve_ivp(slopes, (begin, end), x, "DOP853", times[:-1], rtol=1e-11, atol=1e-12, max_step=0.005)
        for k, t in enumerate(times[:-1]):
            row = right_rows(results, np.array([t]))[0]
            assert results["system.y"][row] == pytest.approx(expected.y[0, k], abs=1e-6)
            assert results["loop.u"][row] == pytest.approx(control_of(expected.y[n:, k]), abs=1e-5)
        x = solve_ivp(slopes, (begin, end), x, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.005).y[:, -1]
    assert np.max(results["loop.u"]) == upper
    assert {event.block for event in results.events} >= {"loop.limit"}


def test_a_controller_says_what_does_not_fit_its_units() -> None:
    def diagram(**units: str) -> Diagram:
        d = Diagram("units", folder=FOLDER)
        wanted, plant = d.add("wanted", Step(unit="m")), d.add("plant", MassSpringDamper())
        loop = d.add("loop", subdiagram("adrc/adrc_2.json", **units))
        d.wire(loop.r, wanted.y)
        d.wire(loop.y, plant.x)
        d.wire(plant.F, loop.u)
        return d

    assert diagram(unit="m", unit_u="N").run(stop=0.1)["loop.z2"].unit == "m/s"
    assert diagram().run(stop=0.1)["loop.z2"].unit == ""
    with pytest.raises(ModelError, match="rad and m are different quantities"):
        diagram(unit="rad").check()
    with pytest.raises(ModelError, match="N and V are different quantities"):
        diagram(unit_u="V").check()


def test_a_controller_in_a_file_and_in_python_are_one() -> None:
    tuning = {"b0": 2.0, "omega_c": 3.0, "omega_o": 12.0, "upper": 3.0}
    python = controlled(2, TransferFunction(num=[2.0], den=PLANTS[2]), **tuning)
    document = python.to_json()
    assert document["blocks"]["loop"] == {"diagram": "adrc/adrc_2.json", "parameters": tuning}
    file = Diagram.from_json(document, folder=FOLDER)
    settings = {"stop": 3.0, "every": 0.1}
    assert np.array_equal(file.run(**settings)["loop.u"], python.run(**settings)["loop.u"])


def test_a_sampled_controller_does_nearly_what_the_continuous_one_does() -> None:
    d = Diagram("digital")
    wanted, plant = d.add("wanted", Step()), d.add("plant", TransferFunction(num=[2.0], den=PLANTS[2]))
    sampler = d.add("sampler", ZeroOrderHold(period=0.01))
    law, eso = (
        d.add("law", LSEF(bandwidth=3.0, b0=2.0)),
        d.add("eso", DiscreteESO(period=0.01, bandwidth=12.0, b0=2.0)),
    )
    d.wire(sampler.u, plant.y)
    d.wire(eso.y, sampler.y)
    d.wire(eso.u, law.u)
    d.wire(law.r1, wanted.y)
    for k in (1, 2, 3):
        d.wire(getattr(law, f"z{k}"), getattr(eso, f"z{k}"))
    d.wire(plant.u, law.u)
    digital = d.run(stop=4.0, every=0.1)
    diagram = controlled(2, TransferFunction(num=[2.0], den=PLANTS[2]), b0=2.0, omega_c=3.0, omega_o=12.0)
    continuous, times = diagram.run(stop=4.0, every=0.1), np.arange(0.0, 4.0, 0.1)
    expected = continuous["system.y"][right_rows(continuous, times)]
    assert digital["plant.y"][right_rows(digital, times)] == pytest.approx(expected, abs=0.01)


# --- the diagrams that show them -------------------------------------------------------------------------------


def test_a_car_keeps_its_speed_on_a_slope() -> None:
    diagram = Diagram.load(FOLDER / "adrc" / "cruise_control.json")
    results = diagram.run()
    hill = 1000.0 * 9.81 * math.sin(math.radians(5.0))
    assert results["car.y"][-1] == pytest.approx(20.0, abs=1e-4)
    assert results["control.u"][-1] == pytest.approx(50.0 * 20.0 + hill, rel=1e-4)
    assert np.max(results["control.u"]) == 4000.0
    assert results.measures["overshoot"] < 1e-3
    heavy = diagram.run(parameters={"load": 500.0})
    assert heavy["car.y"][-1] == pytest.approx(20.0, abs=1e-3)


def test_a_motor_turns_to_its_angle_against_a_torque() -> None:
    """The whole loop by hand: motor, angle, observer of order 3, feedback, limit."""
    Ra, La, kb, kt, n, Jeq, Beq = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
    b0, omega_c, omega_o, limit = kt / (La * Jeq * n), 4.0, 30.0, 24.0

    def voltage(t: float, z: Array) -> float:
        wanted = 1.0 if t >= 1.0 else 0.0
        u0 = omega_c**3 * (wanted - z[0]) - 3.0 * omega_c**2 * z[1] - 3.0 * omega_c * z[2]
        return float(np.clip((u0 - z[3]) / b0, -limit, limit))

    def slopes(t: float, x: Array) -> list[float]:
        theta, omega, i, *z = x
        v, tau, e = voltage(t, np.array(z)), 3.0 if t >= 5.0 else 0.0, theta - z[0]
        return [
            omega,
            (-Beq * n * omega + kt * i - tau / n) / (Jeq * n),
            (-kb * n * omega - Ra * i + v) / La,
            z[1] + 4.0 * omega_o * e,
            z[2] + 6.0 * omega_o**2 * e,
            z[3] + b0 * v + 4.0 * omega_o**3 * e,
            omega_o**4 * e,
        ]

    results = Diagram.load(FOLDER / "adrc" / "motor_angle.json").run(**TIGHT)
    x: Array = np.zeros(7)
    for begin, end in ((1.0, 5.0), (5.0, 10.0)):
        times = np.arange(begin, end, 0.5)
        expected = solve_ivp(
            slopes, (begin, end), x, "DOP853", times, dense_output=True, rtol=1e-11, atol=1e-12, max_step=0.005
        )
        rows = right_rows(results, times)
        assert results["shaft.y"][rows] == pytest.approx(expected.y[0], abs=1e-6)
        # Before an edge the voltage is that of the time just before it.
        x = expected.sol(end - 1e-13)
    assert results["shaft.y"][-1] == pytest.approx(1.0, abs=1e-5)
    assert np.max(results["control.u"]) == 24.0


def test_a_mass_is_held_against_spring_and_push() -> None:
    diagram = Diagram.load(FOLDER / "adrc" / "mass_position.json")
    results = diagram.run()
    assert results["plant.x"][-1] == pytest.approx(0.5, abs=1e-5)
    assert results["control.u"][-1] == pytest.approx(20.0 * 0.5 + 5.0, abs=1e-4)
    assert results["control.z3"][-1] == pytest.approx(-15.0, abs=1e-3)
    slow = diagram.run(parameters={"omega_o": 10.0})
    assert slow.measures["dip"] > 2.0 * results.measures["dip"]
