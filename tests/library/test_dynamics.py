"""What the blocks of the library do over time: closed forms, SciPy on matrices, SciPy on equations written by hand."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from blocks import (
    INTD,
    LESO,
    NLSEF,
    PID,
    SMESO,
    BouncingBall,
    Constant,
    Demux,
    Diagram,
    Disturbance,
    Gain,
    Integrator,
    Kinematics,
    MatchedDisturbance,
    Mux,
    PMDCMotor,
    Product,
    Pulse,
    Ramp,
    Results,
    Saturation,
    Sine,
    StateSpace,
    Step,
    Sum,
    TrackingDifferentiator,
    TransferFunction,
    UnitDelay,
    WheelMixing,
    ZeroOrderHold,
)
from blocks.library import LIBRARY

Array = np.ndarray[Any, Any]

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""


def at(results: Results, name: str, t: float) -> float:
    """The right value of a signal at a recorded time."""
    k = int(np.searchsorted(results.t, t, side="right")) - 1
    assert results.t[k] == t
    return float(results[name][k])


def held_by_matrices(A: Array, B: Array, x: Array, u: Array, t: float) -> Array:
    """The state after t under a constant input, by the exponential of one matrix."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    return np.asarray((expm(block * t) @ np.concatenate([x, u]))[:n])


# --- sources ---------------------------------------------------------------------------------------------------


def test_the_integrals_of_sources_are_exact() -> None:
    d = Diagram("sources")
    for name, block in {
        "step": Step(at=0.3, before=1.0, after=-2.0),
        "ramp": Ramp(at=0.7, before=1.0, slope=3.0),
        "pulse": Pulse(height=5.0, on=0.2, off=0.9),
        "torque": Disturbance(torque=5.0, on=0.2, off=0.9),
        "sine": Sine(amplitude=2.0, omega=3.0, phase=0.5, bias=0.25),
        "constant": Constant(value=4.0),
    }.items():
        source = d.add(name, block)
        integral = d.add(f"of_{name}", Integrator())
        d.wire(integral.u, source.y)
    results = d.run(stop=2.0, every=0.1, **TIGHT)
    expected = {
        "step": 0.3 - 2.0 * 1.7,
        "ramp": 2.0 + 3.0 * 1.3**2 / 2,
        "pulse": 5.0 * 0.7,
        "torque": 5.0 * 0.7,
        "sine": 0.5 + 2.0 / 3.0 * (math.cos(0.5) - math.cos(6.5)),
        "constant": 8.0,
    }
    for name, value in expected.items():
        assert results[f"of_{name}.y"][-1] == pytest.approx(value, rel=1e-9), name
    assert [(event.t, event.block) for event in results.events] == [
        (0.2, "pulse"), (0.2, "torque"), (0.3, "step"), (0.7, "ramp"), (0.9, "pulse"), (0.9, "torque"),
    ]  # fmt: skip


def test_a_run_that_begins_within_a_pulse_sees_it() -> None:
    d = Diagram("late")
    d.add("pulse", Pulse(height=5.0, on=1.0, off=4.0))
    d.add("step", Step(at=2.0))
    results = d.run(start=2.0, stop=5.0, every=0.5)
    assert (at(results, "pulse.y", 2.0), at(results, "pulse.y", 3.5), at(results, "pulse.y", 4.0)) == (5.0, 5.0, 0.0)
    assert results["step.y"][0] == 1.0


# --- linear systems --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num", "den"),
    [
        ([2.0], [0.5, 1.0]),
        ([1.0, 3.0], [1.0, 2.0]),
        ([3.0, 1.0], [2.0, 0.4, 8.0]),
        ([1.0, 0.0, 4.0, 1.0], [1.0, 3.0, 7.0, 5.0]),
        ([5.0], [2.0]),
    ],
)
def test_a_transfer_function_answers_a_step_as_its_residues_say(num: list[float], den: list[float]) -> None:
    d = Diagram("tf")
    step, system = d.add("step", Step(after=2.0)), d.add("system", TransferFunction(num=num, den=den))
    d.wire(system.u, step.y)
    results = d.run(stop=4.0, every=0.5, **TIGHT)
    # 2 num/(s den) in partial fractions; its poles are simple.
    poles = np.concatenate([[0.0], np.roots(den)]).astype(complex)
    slope = np.polyder(np.append(den, 0.0))
    residues = 2.0 * np.polyval(num, poles) / np.polyval(slope, poles)
    t = np.asarray(results.t)
    direct = 2.0 * num[0] / den[0] if len(num) == len(den) else 0.0
    expected = (residues[None, :] * np.exp(np.outer(t, poles))).sum(axis=1).real
    assert results["system.y"] == pytest.approx(expected, rel=CLOSE, abs=CLOSE)
    assert results["system.y"][0] == pytest.approx(direct, abs=1e-12)


def test_a_state_space_system_is_the_exponential_of_its_matrix() -> None:
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -0.5, 1.0], [0.0, 0.0, -2.0]])
    B = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 3.0]])
    C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -1.0]])
    D = np.array([[0.0, 0.5], [0.0, 0.0]])
    x0 = np.array([1.0, -1.0, 0.5])
    d = Diagram("ss")
    u1, u2 = d.add("u1", Constant(value=2.0)), d.add("u2", Constant(value=-1.0))
    mux, demux = d.add("mux", Mux()), d.add("demux", Demux())
    system = d.add("system", StateSpace(A=A, B=B, C=C, D=D, x_start=x0))
    d.wire(mux.u1, u1.y)
    d.wire(mux.u2, u2.y)
    d.wire(system.u, mux.y)
    d.wire(demux.u, system.y)
    results = d.run(stop=3.0, every=0.5, **TIGHT)
    u = np.array([2.0, -1.0])
    for k, t in enumerate(results.t):
        x = held_by_matrices(A, B, x0, u, t)
        assert results["system.x"][k] == pytest.approx(x, rel=CLOSE, abs=CLOSE)
        assert [results["demux.y1"][k], results["demux.y2"][k]] == pytest.approx(C @ x + D @ u, rel=CLOSE, abs=CLOSE)


def test_a_motor_is_the_exponential_of_its_matrix() -> None:
    Ra, La, kb, kt, n, Jeq, Beq = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
    A = np.array([[-Beq / Jeq, kt / (Jeq * n)], [-kb * n / La, -Ra / La]])
    B = np.array([[0.0, -1.0 / (Jeq * n * n)], [1.0 / La, 0.0]])
    d = Diagram("motor")
    voltage, torque = d.add("voltage", Constant(value=12.0, unit="V")), d.add("torque", Constant(value=3.0, unit="N.m"))
    motor = d.add("motor", PMDCMotor(omega_start=1.0, i_start=-2.0))
    matched = d.add("matched", MatchedDisturbance())
    d.wire(motor.v, voltage.y)
    d.wire(motor.tau, torque.y)
    d.wire(matched.tau, torque.y)
    d.wire(matched.omega, motor.omega)
    d.wire(matched.i, motor.i)
    results = d.run(stop=2.0, every=0.25, **TIGHT)
    u = np.array([12.0, 3.0])
    for k, t in enumerate(results.t):
        x = held_by_matrices(A, B, np.array([1.0, -2.0]), u, t)
        assert [results["motor.omega"][k], results["motor.i"][k]] == pytest.approx(x, rel=CLOSE)
        second = (A @ (A @ x + B @ u))[0]  # theorem 1: omega'' = bh (v + total)
        assert kt / (La * Jeq * n) * (12.0 + results["matched.total"][k]) == pytest.approx(second, rel=CLOSE, abs=CLOSE)


# --- saturation and PID ----------------------------------------------------------------------------------------


def test_a_saturation_cuts_a_sine_at_the_instants_of_its_inverse() -> None:
    d = Diagram("clipped")
    sine, clip = d.add("sine", Sine(amplitude=2.0)), d.add("clip", Saturation(lower=-1.0, upper=1.5))
    integral = d.add("integral", Integrator())
    d.wire(clip.u, sine.y)
    d.wire(integral.u, clip.y)
    results = d.run(stop=6.0, every=0.1, **TIGHT)
    high, low = math.asin(0.75), math.asin(0.5)
    expected = [high, math.pi - high, math.pi + low, 2.0 * math.pi - low]
    assert [event.t for event in results.events] == pytest.approx(expected, abs=1e-9)
    assert results["clip.y"] == pytest.approx(np.clip(2.0 * np.sin(results.t), -1.0, 1.5), abs=1e-9)
    above = 1.5 * (math.pi - 2.0 * high) + 4.0 * (1.0 - math.cos(high))
    below = math.pi - 2.0 * low + 2.0 * (1.0 - math.cos(low)) + 2.0 * (math.cos(6.0) - math.cos(low))
    assert results["integral.y"][-1] == pytest.approx(above - below, abs=CLOSE)


def pid_loop(pid: PID) -> Results:
    """An oscillator under a PID controller: 2 is wanted from 0.5 s to 4 s."""
    d = Diagram("loop")
    wanted = d.add("wanted", Pulse(height=2.0, on=0.5, off=4.0))
    control, plant = d.add("control", pid), d.add("plant", TransferFunction(num=[3.0], den=[1.0, 1.2, 1.0]))
    d.wire(control.r, wanted.y)
    d.wire(control.y, plant.y)
    d.wire(plant.u, control.u)
    return d.run(stop=6.0, every=0.25, **TIGHT)


def test_a_pid_without_limits_is_linear() -> None:
    kp, ki, kd, Tf = 4.0, 3.0, 1.5, 0.05
    results = pid_loop(PID(kp=kp, ki=ki, kd=kd, c=1.0, Tf=Tf))
    # States: plant x1, x2 (y = 3 x1), integral, smoothed; v = (kp + kd/Tf) e + integral - kd/Tf smoothed.
    gain = kp + kd / Tf
    A = np.array([
        [0.0, 1.0, 0.0, 0.0],
        [-1.0 - 3.0 * gain, -1.2, 1.0, -kd / Tf],
        [-3.0 * ki, 0.0, 0.0, 0.0],
        [-3.0 / Tf, 0.0, 0.0, -1.0 / Tf],
    ])  # fmt: skip
    B = np.array([[0.0], [gain], [ki], [1.0 / Tf]])
    for t in (1.0, 2.5, 3.5):
        x = held_by_matrices(A, B, np.zeros(4), np.array([2.0]), t - 0.5)
        assert at(results, "plant.y", t) == pytest.approx(3.0 * x[0], rel=CLOSE)


def test_a_limited_pid_is_that_of_equations_written_by_hand() -> None:
    kp, ki, kd, Tf, Tt, upper, lower = 4.0, 3.0, 1.5, 0.05, 0.4, 1.0, -0.2
    results = pid_loop(PID(kp=kp, ki=ki, kd=kd, c=1.0, Tf=Tf, Tt=Tt, lower=lower, upper=upper))

    def control(t: float, x: Array) -> tuple[float, float, float]:
        e = (2.0 if t < 4.0 else 0.0) - 3.0 * x[0]
        v = kp * e + x[2] + kd * (e - x[3]) / Tf
        return e, v, min(max(v, lower), upper)

    def slopes(t: float, x: Array) -> list[float]:
        e, v, y = control(t, x)
        return [x[1], y - x[0] - 1.2 * x[1], ki * e + (y - v) / Tt, (e - x[3]) / Tf]

    x: Array = np.zeros(4)
    for times in ([0.5, 1.0, 2.5, 3.75, 4.0 - 1e-12], [4.0, 4.5, 6.0]):
        span = (times[0], times[-1])
        expected = solve_ivp(slopes, span, x, "DOP853", times, rtol=1e-10, atol=1e-12, max_step=0.01)
        for k, t in list(enumerate(times))[1:]:
            x = expected.y[:, k]
            if t == round(t, 2):
                assert at(results, "plant.y", t) == pytest.approx(3.0 * x[0], abs=1e-6)
                assert at(results, "control.u", t) == pytest.approx(control(t, x)[2], abs=1e-6)
    assert np.max(results["control.u"]) == pytest.approx(upper, abs=1e-9)
    assert np.min(results["control.u"]) == pytest.approx(lower, abs=1e-9)
    assert at(results, "plant.y", 3.75) == pytest.approx(2.0, abs=0.1)  # no windup: it is there soon after the limit


def test_a_pid_goes_from_hand_to_automatic_without_a_bump() -> None:
    """By hand the integral nears what makes v = u with the time constant Tt; then it integrates the error."""
    d = Diagram("transfer")
    control = d.add("control", PID(kp=2.0, ki=0.5, Tt=0.25, u_start=1.0, upper=4.0))
    d.wire(control.r, d.add("r", Constant(value=3.0)).y)
    d.wire(control.y, d.add("y", Constant(value=2.5)).y)
    d.wire(control.manual, d.add("manual", Pulse(on=1.0, off=2.0)).y)
    d.wire(control.u_manual, d.add("by_hand", Step(at=1.5, before=-1.0, after=9.0)).y)
    results = d.run(stop=3.0, every=0.25, **TIGHT)
    integral = 1.0 + 0.25 * 1.0  # ki e t
    for u, seconds in ((-1.0, 0.5), (4.0, 0.5)):  # by hand, within the limits; kp e is 1
        integral = (u - 1.0) + (integral - (u - 1.0)) * math.exp(-seconds / 0.25)
    expected = {0.75: 2.0 + 0.25 * 0.75, 1.25: -1.0, 1.75: 4.0}
    expected |= {t: 1.0 + integral + 0.25 * (t - 2.0) for t in (2.25, 3.0)}
    for t, u in expected.items():
        assert at(results, "control.u", t) == pytest.approx(u, rel=CLOSE)


# --- sampled blocks --------------------------------------------------------------------------------------------


def test_a_hold_shows_the_last_tick_and_a_delay_the_one_before() -> None:
    d = Diagram("sampled")
    ramp = d.add("ramp", Ramp())
    hold = d.add("hold", ZeroOrderHold(period=0.1, offset=0.05, y_start=-1.0))
    delay = d.add("delay", UnitDelay(period=0.1, offset=0.05, y_start=-2.0))
    second = d.add("second", UnitDelay(period=0.1, offset=0.05))
    d.wire(hold.u, ramp.y)
    d.wire(delay.u, ramp.y)
    d.wire(second.u, delay.y)
    results = d.run(stop=0.5, every=0.01)

    def tick(t: float, back: int) -> float:
        """The value of the ramp at the last tick up to t, or so many ticks before; NaN before the first."""
        k = round((t - 0.05) * 1e6) // 100_000 - back
        return 0.05 + 0.1 * k if k >= 0 else math.nan

    right = np.append(np.diff(results.t) > 0, True)  # of two rows at one time, the second
    for k in np.flatnonzero(right):
        t = float(results.t[k])
        for name, back, start in (("hold", 0, -1.0), ("delay", 1, -2.0)):
            value = tick(t, back)
            assert results[f"{name}.y"][k] == pytest.approx(start if math.isnan(value) else value, abs=1e-12), (name, t)
    # A delay of a delay first shows its own start, then that of the other.
    assert [at(results, "second.y", t) for t in (0.0, 0.05, 0.15, 0.25, 0.35)] == [0.0, 0.0, -2.0, 0.05, 0.15]


def test_a_sampled_loop_is_its_recursion() -> None:
    period, k = 0.1, 0.8
    A, B = np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([[0.0], [1.0]])
    d = Diagram("loop")
    step, error = d.add("step", Step()), d.add("error", Sum(signs="+-"))
    sampler, delay = d.add("sampler", ZeroOrderHold(period=period)), d.add("delay", UnitDelay(period=period))
    gain, plant = d.add("gain", Gain(k=k)), d.add("plant", TransferFunction(num=[1.0], den=[1.0, 1.0, 0.0]))
    d.wire(error.u1, step.y)
    d.wire(error.u2, plant.y)
    d.wire(sampler.u, error.y)
    d.wire(gain.u, sampler.y)
    d.wire(delay.u, gain.y)
    d.wire(plant.u, delay.y)
    results = d.run(stop=5.0, every=period, **TIGHT)
    x, held = np.zeros(2), 0.0
    for n in range(51):
        t = n / 10
        held, u = k * (1.0 - x[0]), held
        assert at(results, "delay.y", t) == pytest.approx(u, abs=CLOSE)
        assert at(results, "plant.y", t) == pytest.approx(x[0], abs=CLOSE)
        x = held_by_matrices(A, B, x, np.array([u]), period)


# --- mechanics and the robot -----------------------------------------------------------------------------------


def ball_run(ball: BouncingBall, **settings: Any) -> Results:
    d = Diagram("ball")
    d.add("ball", ball)
    return d.run(stop=4.0, every=0.1, **settings)


@pytest.mark.parametrize("settings", [TIGHT, {"method": "rk4", "step": 0.1}, {"rtol": 1e-3, "atol": 1e-3}], ids=str)
@pytest.mark.parametrize("e", [0.0, 0.5, 0.7, 0.85])
def test_a_ball_bounces_at_the_times_of_its_series_and_rests(e: float, settings: dict[str, Any]) -> None:
    g, v_rest = 9.81, 1e-4
    results = ball_run(BouncingBall(e=e, v_rest=v_rest), **settings)
    T = math.sqrt(2.0 / g)
    times, v = [T], e * g * T
    while v >= v_rest:
        times.append(times[-1] + 2.0 * v / g)  # the last flights are far shorter than a step of 0.1 s
        v *= e
    assert [event.t for event in results.events] == pytest.approx([t for t in times if t <= 4.0], abs=1e-9)
    if times[-1] < 4.0:
        assert (results["ball.h"][-1], results["ball.v"][-1], results["ball.resting"][-1]) == (0.0, 0.0, 1.0)
    assert np.min(results["ball.h"]) > -1e-9


def test_a_ball_that_lies_on_the_floor_stays() -> None:
    results = ball_run(BouncingBall(h_start=0.0))
    assert np.max(np.abs(results["ball.h"])) < 1e-9
    assert results["ball.resting"][-1] == 1.0


def test_a_robot_with_steady_wheels_runs_on_a_circle() -> None:
    right, left, heading = 3.0, 1.0, 0.5
    d = Diagram("circle")
    fast, slow = (d.add(f"wheel{speed:.0f}", Constant(value=speed, unit="rad/s")) for speed in (right, left))
    mixing, pose = d.add("mixing", WheelMixing()), d.add("pose", Kinematics(theta_start=heading))
    d.wire(mixing.omega_right, fast.y)
    d.wire(mixing.omega_left, slow.y)
    d.wire(pose.v, mixing.v)
    d.wire(pose.omega, mixing.omega)
    results = d.run(stop=10.0, every=1.0, **TIGHT)
    v, omega = 0.075 * (right + left) / 2, 0.075 * (right - left) / 0.4
    theta = heading + omega * np.asarray(results.t)
    assert results["pose.theta"] == pytest.approx(theta, rel=CLOSE)
    assert results["pose.x"] == pytest.approx(v / omega * (np.sin(theta) - math.sin(heading)), abs=CLOSE)
    assert results["pose.y"] == pytest.approx(v / omega * (math.cos(heading) - np.cos(theta)), abs=CLOSE)


# --- active disturbance rejection ------------------------------------------------------------------------------


def follow(block: Any, stop: float, **settings: Any) -> Results:
    d = Diagram("follow")
    step, td = d.add("step", Step(unit="rad/s")), d.add("td", block)
    d.wire(td.r, step.y)
    return d.run(stop=stop, every=stop / 100, **settings)


def test_the_tracking_differentiator_follows_a_step_in_the_least_time() -> None:
    results = follow(TrackingDifferentiator(unit="rad/s"), 0.4, **TIGHT)
    t, r1 = np.asarray(results.t), np.asarray(results["td.r1"])
    # Full acceleration to half the way at sqrt(1/R), then full braking. The step h of fhan rounds that off.
    half = 0.1
    parabola = np.where(t < half, 50.0 * t**2, 1.0 - 50.0 * np.maximum(2 * half - t, 0.0) ** 2)
    assert r1 == pytest.approx(parabola, abs=0.012)
    assert np.max(r1) < 1.0 + 1e-6
    assert r1[-1] == pytest.approx(1.0, abs=1e-6)


def test_the_sign_form_is_the_limit_of_fhan_and_chatters() -> None:
    smooth = follow(TrackingDifferentiator(h=1e-4), 0.4, method="rk4", step=1e-4)
    sign = follow(TrackingDifferentiator(form="sign"), 0.4, method="rk4", step=1e-4)
    assert sign["td.r1"] == pytest.approx(smooth["td.r1"], abs=3e-3)
    tail = slice(-20, None)
    assert np.ptp(sign["td.r2"][tail]) > 100 * np.ptp(smooth["td.r2"][tail])


@pytest.mark.parametrize(("form", "gain"), [("unit", 1.0), ("literal", (1.0 - 0.4968) / 2.1555)])
def test_the_intd_settles_at_its_gain(form: str, gain: float) -> None:
    results = follow(INTD(form=form, unit="rad/s"), 5.0, **TIGHT)
    assert results["td.r1"][-1] == pytest.approx(gain, abs=1e-6)
    assert results["td.r2"][-1] == pytest.approx(0.0, abs=1e-6)


def disturbed_chain(order: int, feedback: Any, observer: Any, f: float, b0: float) -> Results:
    """y^(order) = f + b0 u under an observer and a feedback that wants y = 1; f sets in at 1 s."""
    d = Diagram("chain")
    wanted, disturbance = d.add("wanted", Constant()), d.add("disturbance", Step(at=1.0, after=f))
    zero = d.add("zero", Constant(value=0.0))
    gain, total = d.add("gain", Gain(k=b0)), d.add("total", Sum())
    law, eso = d.add("law", feedback), d.add("eso", observer)
    d.wire(gain.u, law.u)
    d.wire(total.u1, gain.y)
    d.wire(total.u2, disturbance.y)
    before = total.y
    for k in range(order):
        integrator = d.add(f"integrator{k + 1}", Integrator())
        d.wire(integrator.u, before)
        before = integrator.y
    d.wire(eso.y, before)
    d.wire(eso.u, law.u)
    for k in range(order):
        d.wire(getattr(law, f"r{k + 1}"), zero.y if k else wanted.y)
    for k in range(order + 1):
        d.wire(getattr(law, f"z{k + 1}"), getattr(eso, f"z{k + 1}"))
    return d.run(stop=20.0, every=1.0, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("observer", ["LESO", "SMESO"])
@pytest.mark.parametrize("feedback", ["NLSEF", "INLSEF"])
def test_feedback_and_observer_of_any_order_reject_a_disturbance(order: int, observer: str, feedback: str) -> None:
    b0, f, speed = 2.0, -3.0, 2.0
    # With exponents of 1 the laws are linear, and these gains put the poles of the chain at -speed.
    gains = [math.comb(order, k) * speed ** (order - k) / b0 for k in range(order)]
    if feedback == "NLSEF":
        law: Any = NLSEF(order=order, gains=gains, alpha=1.0, delta=0.1, b0=b0)
    else:
        law = LIBRARY["INLSEF"](order=order, k1=gains, k2=0.0, mu=1.0, alpha=1.0, k3=0.0, delta=100.0, b0=b0)
    eso = (LESO if observer == "LESO" else SMESO)(order=order, bandwidth=20.0, b0=b0)
    results = disturbed_chain(order, law, eso, f, b0)
    assert results[f"integrator{order}.y"][-1] == pytest.approx(1.0, abs=1e-5)
    assert results[f"eso.z{order + 1}"][-1] == pytest.approx(f, abs=1e-4)
    assert results["eso.z1"][-1] == pytest.approx(1.0, abs=1e-5)
    assert results["law.u"][-1] == pytest.approx(-f / b0, abs=1e-4)


def test_the_integral_of_the_improved_feedback_is_that_of_its_first_error() -> None:
    d = Diagram("integral")
    sine, zero, law = d.add("sine", Sine()), d.add("zero", Constant(value=0.0)), d.add("law", LIBRARY["INLSEF"]())
    d.wire(law.r1, sine.y)
    for port in (law.r2, law.z1, law.z2, law.z3):
        d.wire(port, zero.y)
    results = d.run(stop=3.0, every=0.5, **TIGHT)
    assert results["law.I"] == pytest.approx(1.0 - np.cos(results.t), abs=CLOSE)


def test_products_and_gains_at_work() -> None:
    d = Diagram("square")
    ramp, square, half = d.add("ramp", Ramp()), d.add("square", Product()), d.add("half", Gain(k=0.5))
    d.wire(square.u1, ramp.y)
    d.wire(square.u2, ramp.y)
    d.wire(half.u, square.y)
    results = d.run(stop=2.0, every=0.25)
    assert results["half.y"] == pytest.approx(0.5 * np.asarray(results.t) ** 2, rel=1e-15)
