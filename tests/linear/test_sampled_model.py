"""Discrete-time models of sampled diagrams: against python-control, simulation, and closed forms."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq

import blocks
from blocks import AnalysisError, Diagram, UsageError
from blocks.analysis.estimation import SineStream, estimate_response
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler
from blocks.frequency import describing
from blocks.frequency.margins import margins
from blocks.frequency.response import response
from blocks.linear.linear_model import LiftedLoop
from tests.support.marks import long_but
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]
DIAGRAMS = ROOT / "diagrams"
ENGINE = "reference" if find_compiler() is None else "native"

# Two routes in double precision through matrices of norm 1.
SAME = 1e-12
# A run at rtol = atol = 1e-12 is right to some 1e-10 of what it shows after a hundred steps.
RUN = 1e-9
TIGHT = {"rtol": 1e-12, "atol": 1e-12, "engine": ENGINE}
# A sweep at rtol = 1e-8 gives phasors right to 1e-7.
SWEPT = 1e-6


def loop_with(controller: Any, *, num: list[float], den: list[float], port: str = "u") -> Diagram:
    """r - y through a sampled block into a plant in continuous time."""
    made = Diagram("loop")
    r = made.input("r")
    d = made.input("d", default=0.0)
    made.add("error", blocks.Sum(signs="+-"))
    made.add("controller", controller)
    made.add("load", blocks.Sum())
    made.add("plant", blocks.TransferFunction(num=num, den=den))
    made.wire("error.u1", r)
    made.wire("error.u2", "plant.y")
    made.wire(f"controller.{port}", "error.y")
    made.wire("load.u1", "controller.y")
    made.wire("load.u2", d)
    made.wire("plant.u", "load.y")
    return made


def at(results: Any, names: list[str], times: Array) -> Array:
    """Values just after what happens at times, (names, times)."""
    rows = np.searchsorted(results.t, times + 1e-9, side="right") - 1
    assert np.max(np.abs(results.t[rows] - times)) < 1e-9
    return np.array([results[name][rows] for name in names])


def simulated(
    diagram: Diagram, inputs: dict[str, Array], outputs: list[str], step: float, *, begin: int = 0, **run: Any
) -> Array:
    """What inputs that are held over each step do to outputs after each of them, (outputs, steps).

    They are changed from their step `begin` on, up to which the diagram runs as it is; the run without them is taken
    away.
    """
    count = len(next(iter(inputs.values())))
    times = step * (begin + np.arange(count))
    stop = float(times[-1] + 0.5 * step)
    common = {"stop": stop, "every": step, "log": outputs, **TIGHT, **run}
    moved = diagram.run(inputs={name: (times, u, "hold") for name, u in inputs.items()}, **common)
    still = diagram.run(inputs=dict.fromkeys(inputs, 0.0), **common)
    return at(moved, outputs, times) - at(still, outputs, times)


def from_model(model: Any, u: Array) -> Array:
    """The response of a model to u, (inputs, steps), from rest: (outputs, steps)."""
    A, B, C, D = (np.asarray(m) for m in (model.A, model.B, model.C, model.D))
    x, made = np.zeros(len(A)), []
    for k in range(u.shape[1]):
        made.append(C @ x + D @ u[:, k])
        x = A @ x + B @ u[:, k]
    return np.array(made).T


def random(count: int, seed: int = 1) -> Array:
    """Inputs whose first value is not 0: what comes with the first tick is seen."""
    return np.random.default_rng(seed).uniform(0.5, 1.0, count) * np.resize([1.0, -0.7, 0.2], count)


# --- one rate, against python-control -------------------------------------------------------------------------------


def test_a_plant_behind_a_sampled_controller_is_the_zero_order_hold_model_of_python_control() -> None:
    T = 0.1
    diagram = loop_with(
        blocks.DiscreteTransferFunction(num=[1.5, -1.2], den=[1.0, -0.6], period=T), num=[2.0], den=[1.0, 0.8, 2.0]
    )
    linearizer = diagram.linearizer()
    plant = control.c2d(control.ss(control.tf([2.0], [1.0, 0.8, 2.0])), T, "zoh")
    controller = control.ss(control.tf([1.5, -1.2], [1.0, -0.6], T))
    omega = np.geomspace(0.1, 0.99 * math.pi / T, 20)
    z = np.exp(1j * omega * T)
    P, C = plant(z), controller(z)
    assert np.allclose(response(linearizer.loop("controller.y"), omega)[0, 0], P * C, rtol=SAME)
    closed = linearizer.model(["r", "d"], ["plant.y", "controller.y"])
    assert closed.dt == T
    wanted = np.array([[P * C, P], [C, -P * C]]) / (1.0 + P * C)
    assert np.allclose(response(closed, omega), wanted, rtol=1e2 * SAME)
    fed = control.feedback(plant * controller, 1)
    assert np.allclose(np.sort_complex(closed.poles()), np.sort_complex(fed.poles()), rtol=1e2 * SAME)
    assert np.allclose(response(linearizer.sensitivity("controller.y"), omega)[0, 0], 1 / (1 + P * C), rtol=1e2 * SAME)
    assert np.allclose(
        response(linearizer.complementary("controller.y"), omega)[0, 0], P * C / (1 + P * C), rtol=1e2 * SAME
    )


def test_a_sampled_pid_is_its_difference_equations() -> None:
    T, kp, ki, kd, Tf, b = 0.05, 2.0, 1.5, 0.4, 0.03, 0.7
    diagram = Diagram("pid")
    r = diagram.input("r")
    diagram.add("pid", blocks.DiscretePID(kp=kp, ki=ki, kd=kd, Tf=Tf, b=b, period=T))
    diagram.add("plant", blocks.TransferFunction(num=[1.0], den=[1.0, 1.2, 0.5]))
    diagram.wire("pid.r", r)
    diagram.wire("pid.y", "plant.y")
    diagram.wire("plant.u", "pid.u")
    linearizer = diagram.linearizer()
    omega = np.geomspace(0.05, 0.99 * math.pi / T, 20)
    z = np.exp(1j * omega * T)
    from_r = kp * b + ki * T / (z - 1)
    from_y = kp + ki * T / (z - 1) + kd * (z - 1) / ((Tf + T) * z - Tf)
    P = control.c2d(control.ss(control.tf([1.0], [1.0, 1.2, 0.5])), T, "zoh")(z)
    assert np.allclose(response(linearizer.loop("pid.u"), omega)[0, 0], P * from_y, rtol=1e2 * SAME)
    made = response(linearizer.model("r", ["plant.y", "pid.u"]), omega)[:, 0]
    assert np.allclose(made, np.array([P, np.ones(len(z))]) * from_r / (1 + P * from_y), rtol=1e2 * SAME)


@pytest.mark.parametrize(("T", "at"), [(0.01, None), (0.05, None), (0.1, None), (0.1, 1.3)])
def test_sampled_pi_loops_of_ordinary_gains_are_those_of_python_control(T: float, at: float | None) -> None:
    """With Tt = kp/ki the integral does not see r by itself: kp period/Tt and ki period cancel but for rounding."""
    P = control.c2d(control.ss(control.tf([1.0], [0.5, 1.0])), T, "zoh")
    omega = np.geomspace(0.05, 0.99 * math.pi / T, 12)
    z = np.exp(1j * omega * T)
    for kp in (0.5, 1.0, 2.0, 5.0, 10.0):
        for ki in (0.1, 0.5, 1.0, 2.0, 5.0):
            diagram = Diagram("pi")
            r = diagram.input("r")
            diagram.add("c", blocks.DiscretePID(kp=kp, ki=ki, period=T))
            diagram.add("p", blocks.FirstOrder(T=0.5))
            diagram.wire("c.r", r)
            diagram.wire("c.y", "p.y")
            diagram.wire("p.u", "c.u")
            linearizer = diagram.linearizer(at=at, inputs={"r": 0.0 if at is None else 0.7})
            L = control.tf([kp, ki * T - kp], [1.0, -1.0], T) * P
            closed = linearizer.model("r", "p.y")
            assert np.allclose(response(closed, omega)[0, 0], L(z) / (1.0 + L(z)), rtol=1e2 * SAME), (kp, ki)
            known = np.sort_complex(control.feedback(L, 1).poles())
            assert np.allclose(np.sort_complex(closed.poles()), known, rtol=1e4 * SAME), (kp, ki)
            assert np.allclose(response(linearizer.loop("c.u"), omega)[0, 0], L(z), rtol=1e2 * SAME), (kp, ki)
            slopes, graph = linearizer.slopes, linearizer.graph
            names = [graph.node_name(node) for node in graph.partial_rows]
            by_r = [graph.slot_name(slot) == "c.r" for slot in graph.partial_slots]
            rows = [k for k, name in enumerate(names) if name == "c.integral" and by_r[k]]
            assert [slopes.data[k] for k in rows] == [0.0], (kp, ki)


def test_a_sampled_state_space_of_many_inputs_and_outputs_is_that_of_python_control_and_of_a_run() -> None:
    T = 0.2
    rng = np.random.default_rng(4)
    A, B, C, D = rng.normal(size=(3, 3)) / 3, rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    D /= 5.0
    F, G, H = rng.normal(size=(4, 4)) - 2 * np.eye(4), rng.normal(size=(4, 2)), rng.normal(size=(2, 4))
    diagram = Diagram("mimo")
    r = diagram.input("r", size=2)
    diagram.add("controller", blocks.DiscreteStateSpace(A=A, B=B, C=C, D=D, period=T))
    diagram.add("plant", blocks.StateSpace(A=F, B=G, C=H))
    for k in range(2):
        diagram.add(f"error{k}", blocks.Sum(signs="+-"))
        diagram.wire(f"error{k}.u1", r[k])
        diagram.wire(f"error{k}.u2", f"plant.y[{k}]")
        diagram.wire(f"controller.u[{k}]", f"error{k}.y")
        diagram.wire(f"plant.u[{k}]", f"controller.y[{k}]")
    names = ["plant.y[0]", "plant.y[1]", "controller.y[0]", "controller.y[1]"]
    model = diagram.linearize("r", ["plant.y", "controller.y"])
    assert model.signals == (("r[0]", "r[1]"), tuple(names))
    plant, controller = control.c2d(control.ss(F, G, H, 0), T, "zoh"), control.ss(A, B, C, D, T)
    omega = np.geomspace(0.1, 0.99 * math.pi / T, 10)
    made = response(model, omega)
    for k, w in enumerate(omega.tolist()):
        P, K = plant(np.exp(1j * w * T)), controller(np.exp(1j * w * T))
        S = np.linalg.inv(np.eye(2) + P @ K)
        assert np.allclose(made[:, :, k], np.vstack([S @ P @ K, K @ S]), rtol=1e3 * SAME, atol=1e2 * SAME)
    u = np.array([random(20, 1), random(20, 2)])
    times = T * np.arange(20)
    run = diagram.run(inputs={"r": (times, u.T, "hold")}, stop=19.5 * T, every=T, log=names, **TIGHT)
    assert np.allclose(at(run, names, times), from_model(model, u), rtol=RUN, atol=RUN)


# --- one rate, against runs -----------------------------------------------------------------------------------------


def test_a_sampled_loop_of_the_repository_answers_an_impulse_as_its_model() -> None:
    diagram = Diagram.load(DIAGRAMS / "sampled_loop.json")
    model = diagram.linearize("reference.y", ["plant.y", "delay.y", "sampler.y", "gain.y"])
    # It asks for 1 from the start on: its answer to that is the step response.
    times = 0.1 * np.arange(60)
    names = ["plant.y", "delay.y", "sampler.y", "gain.y"]
    run = diagram.run(stop=5.95, every=0.1, log=names, **TIGHT)
    assert np.allclose(at(run, names, times), from_model(model, np.ones((1, 60))), rtol=RUN, atol=RUN)
    # 0.8 z^-1 into the zero-order hold model of 1/(s (s + 1)), in closed form.
    T, e = 0.1, math.exp(-0.1)
    z = np.exp(0.1j * np.geomspace(0.1, 31.0, 9))
    plant = ((T - 1 + e) * z + (1 - e - T * e)) / ((z - 1) * (z - e))
    loop = response(diagram.linearizer().loop("delay.y"), np.geomspace(0.1, 31.0, 9))[0, 0]
    assert np.allclose(loop, 0.8 / z * plant, rtol=1e2 * SAME)


@pytest.mark.parametrize("offset", [0.0, 0.03])
@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (blocks.UnitDelay, {}),
        (blocks.Delay, {"samples": 3}),
        (blocks.ZeroOrderHold, {}),
        (blocks.DiscreteIntegrator, {"form": "forward"}),
        (blocks.DiscreteIntegrator, {"form": "backward"}),
        (blocks.DiscreteIntegrator, {"form": "trapezoidal"}),
        (blocks.DiscreteTransferFunction, {"num": [0.5, 0.1], "den": [1.0, -0.3, 0.4]}),
    ],
)
def test_a_loop_around_each_sampled_block_answers_as_its_model(kind: Any, given: dict[str, Any], offset: float) -> None:
    made = kind(period=0.1, offset=offset, **given)
    diagram = loop_with(made, num=[1.0, 3.0], den=[1.0, 1.2, 2.0])
    names = ["plant.y", "controller.y", "error.y"]
    model = diagram.linearize(["r", "d"], names)
    u = np.array([random(25, 1), random(25, 2)])
    times = offset + 0.1 * (3 + np.arange(25))
    inputs = {"r": (times, u[0], "hold"), "d": (times, u[1], "hold")}
    inputs = {name: (np.r_[0.0, t], np.r_[0.0, value], "hold") for name, (t, value, _) in inputs.items()}
    run = diagram.run(inputs=inputs, stop=times[-1] + 0.05, every=0.01, log=names, **TIGHT)
    assert np.allclose(at(run, names, times), from_model(model, u), rtol=RUN, atol=RUN)


@pytest.mark.parametrize("form", ["euler", "zoh", "current"])
def test_a_sampled_observer_answers_as_its_model_and_as_its_closed_form(form: str) -> None:
    T, b0 = 0.02, 1.7
    observer = Diagram.alone(blocks.DiscreteESO(form=form, period=T, bandwidth=12.0, b0=b0))
    names = ["z1", "z2", "z3"]
    model = observer.linearize(["y", "u"], names)
    u = np.array([random(40, 1), random(40, 2)])
    times = T * np.arange(40)
    inputs = {"y": (times, u[0], "hold"), "u": (times, u[1], "hold")}
    run = observer.run(inputs=inputs, stop=39.5 * T, every=T, log=[f"DiscreteESO.{name}" for name in names], **TIGHT)
    assert np.allclose(at(run, [f"DiscreteESO.{name}" for name in names], times), from_model(model, u), rtol=RUN)
    pole = 1.0 - 12.0 * T if form == "euler" else math.exp(-12.0 * T)
    # Three poles at one place: rounding moves them by eps^(1/3) of their size.
    assert np.allclose(model.poles(), pole, atol=1e-4)
    beta = 1.0 - pole
    A = np.array([[1.0, T, T * T / 2.0], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    B = b0 * np.array([[T * T / 2.0], [T], [0.0]])
    if form == "euler":
        A[0, 2], B[0, 0] = 0.0, 0.0
    # The characteristic polynomial (lambda - pole)^3 of A - L [1 0 0], by Ackermann's formula.
    seen = np.vstack([[1.0, 0.0, 0.0], A[0], (A @ A)[0]])
    shift = np.linalg.matrix_power(A - pole * np.eye(3), 3)
    L = shift @ np.linalg.solve(seen, [0.0, 0.0, 1.0])[:, None]
    if form == "current":
        L = np.linalg.solve(A, L)
    z = np.exp(1j * np.geomspace(0.5, 150.0, 8) * T)
    C = np.array([[1.0, 0.0, 0.0]])
    for k, one in enumerate(z):
        if form == "current":  # x(k+1) = A (x + L (y - x1)) + B u, z = x + L (y - x1)
            X = np.linalg.solve(one * np.eye(3) - A + A @ L @ C, np.hstack([A @ L, B]))
            wanted = (np.eye(3) - L @ C) @ X + np.hstack([L, 0.0 * B])
        else:
            wanted = np.linalg.solve(one * np.eye(3) - A + L @ C, np.hstack([L, B]))
        got = response(model, np.geomspace(0.5, 150.0, 8)[k : k + 1])[:, :, 0]
        assert np.allclose(got, wanted, rtol=1e-9)
    assert beta > 0.0


def test_the_papers_sampled_controllers_at_an_amplitude_are_linear_ones_of_the_gains_of_that_amplitude() -> None:
    diagram = Diagram.load(DIAGRAMS / "paper" / "iadrc_sampled.json")
    names = ["motor_right.omega", "control_right.u", "control_right.z3"]
    with pytest.raises(AnalysisError, match=r"E701 control_right\.eso\.g: has an infinite slope at e = 0") as told:
        diagram.linearize("disturbance.y", names)
    assert 'amplitude={"control_right.eso.e": A}' in str(told.value)
    sizes: dict[str, Any] = {}
    for side in ("right", "left"):
        sizes |= {f"control_{side}.eso.e": 0.02, f"control_{side}.nlsef.e": [0.03, 0.2]}
    linearizer = diagram.linearizer(amplitude=sizes)
    graph = linearizer.graph
    gains = {graph.node_name(node): gain for (node, _), gain in linearizer.gains.items()}
    power = [describing.power(a, 0.02).gain for a in (0.8433, 1.04078)]
    assert gains["control_right.eso.g"] == pytest.approx(0.6265 * power[0] + 0.5878 * power[1], rel=1e-9)
    # The same laws with these gains as slopes: what follows is a diagram without corners, which a run can judge.
    laws: dict[str, Any] = {}
    for side in ("control_right", "control_left"):
        laws |= {f"{side}.eso.Ka": gains[f"{side}.eso.g"], f"{side}.eso.Kb": 0.0, f"{side}.eso.alpha": 1.0}
        laws |= {f"{side}.nlsef.k1": [gains[f"{side}.nlsef.law[{k}]"] for k in (0, 1)], f"{side}.nlsef.k3": 0.0}
        laws |= {f"{side}.nlsef.alpha": [1.0, 1.0], f"{side}.nlsef.k2": [0.0, 0.0]}
    on, torque, count = 8.0, 3e-4, 200
    model = diagram.linearize("disturbance.y", names, at=on, parameters=laws)
    quasi = linearizer.model("disturbance.y", names)
    assert quasi.dt == model.dt == 0.001
    u = np.ones((1, count))
    # The loop is not quite at rest after 8 s, and tanh bends a little there.
    assert np.allclose(from_model(quasi, u), from_model(model, u), rtol=1e-6, atol=1e-6)
    both = [
        diagram.run(
            stop=on + 0.001 * count, every=0.001, log=names, **TIGHT,
            parameters={**laws, "torque": sign * torque, "torque_on": on},
        )
        for sign in (1.0, -1.0)
    ]  # fmt: skip
    times = on + 0.001 * np.arange(count)
    moved = (at(both[0], names, times) - at(both[1], names, times)) / (2.0 * torque)
    # Runs at 1e-12 that are 6e-4 apart; the part of third order in the torque is below that.
    assert np.allclose(moved, from_model(model, u), rtol=1e-7, atol=1e-6)


# --- several rates --------------------------------------------------------------------------------------------------


def of_two_rates(fast: float = 0.02, slow: float = 0.03, offset: float = 0.0, sampler: float = 0.0) -> Diagram:
    """A fast inner loop around a motor, and a slower one outside that needs a period to compute.

    sampler: the period at which the input is sampled before it goes in; 0: it is not.
    """
    made = Diagram("two_rates")
    r = made.input("r")
    if sampler:
        made.wire(made.add("sampler", blocks.ZeroOrderHold(period=sampler)).u, r)
        r = made["sampler"].y
    made.add("error", blocks.Sum(signs="+-"))
    made.add("outer", blocks.DiscreteTransferFunction(num=[2.0, -1.6], den=[1.0, -0.5], period=slow, offset=offset))
    made.add("computing", blocks.UnitDelay(period=slow, offset=offset))
    made.add("inner_error", blocks.Sum(signs="+-"))
    made.add("inner", blocks.DiscreteIntegrator(form="backward", period=fast))
    made.add("drive", blocks.Sum())
    made.add("motor", blocks.TransferFunction(num=[8.0], den=[1.0, 5.0]))
    made.add("angle", blocks.Integrator())
    for target, source in {
        "error.u2": "angle.y", "outer.u": "error.y", "computing.u": "outer.y", "inner_error.u1": "computing.y",
        "inner_error.u2": "motor.y", "inner.u": "inner_error.y", "drive.u1": "inner.y", "drive.u2": "inner_error.y",
        "motor.u": "drive.y", "angle.u": "motor.y",
    }.items():  # fmt: skip
        made.wire(target, source)
    made.wire("error.u1", r)
    return made


SEEN = ["angle.y", "motor.y", "inner.y", "computing.y", "outer.y"]


@pytest.mark.parametrize(
    ("fast", "slow", "offset", "period"),
    [
        (0.02, 0.03, 0.0, 0.06),
        (0.01, 0.04, 0.0, 0.04),
        (0.02, 0.02, 0.01, 0.02),
        (0.02, 0.03, 0.013, 0.06),
    ],
)
def test_a_diagram_of_two_rates_answers_at_their_least_common_multiple_as_its_model(
    fast: float, slow: float, offset: float, period: float
) -> None:
    diagram = of_two_rates(fast, slow, offset)
    model = diagram.linearize("r", SEEN)
    assert model.dt == pytest.approx(period, rel=1e-12)
    u = random(15)
    begin = 0.0 if offset == 0.0 else 10 * period  # from then on all rates tick
    times = begin + period * np.arange(15)
    run = diagram.run(
        inputs={"r": (np.r_[0.0, times], np.r_[0.0 if begin else u[0], u], "hold")},
        stop=times[-1] + 0.5 * period, every=0.001, log=SEEN, **TIGHT,
    )  # fmt: skip
    assert np.allclose(at(run, SEEN, times), from_model(model, u[None]), rtol=RUN, atol=RUN)


@pytest.mark.parametrize(("fast", "slow", "offset", "steps"), [(0.02, 0.03, 0.0, 6), (0.02, 0.03, 0.013, 60)])
def test_a_lifted_model_has_what_happens_at_every_base_step(
    fast: float, slow: float, offset: float, steps: int
) -> None:
    diagram = of_two_rates(fast, slow, offset)
    model = diagram.linearizer().lifted("r", SEEN)
    assert model.steps == steps
    h, turns = float(model.dt) / steps, max(2, 60 // steps)
    assert model.signals[0] == tuple(f"r@{k}" for k in range(steps))
    assert model.signals[1] == tuple(f"{name}@{k}" for k in range(steps) for name in SEEN)
    u = random(steps * turns)
    begin = 0.0 if offset == 0.0 else 10 * float(model.dt)
    times = begin + h * np.arange(steps * turns)
    run = diagram.run(
        inputs={"r": (np.r_[0.0, times], np.r_[0.0 if begin else u[0], u], "hold")},
        stop=times[-1] + 0.5 * h, every=0.001, log=SEEN, **TIGHT,
    )  # fmt: skip
    made = from_model(model, u.reshape(turns, steps).T)  # (steps x outputs, turns)
    made = made.reshape(steps, len(SEEN), turns).transpose(1, 2, 0).reshape(len(SEEN), -1)
    assert np.allclose(at(run, SEEN, times), made, rtol=RUN, atol=RUN)
    # Held over all base steps it is the model at the least common multiple.
    whole = diagram.linearize("r", SEEN)
    n = len(SEEN)
    assert np.allclose(response(model, [3.0])[:n].sum(axis=1), response(whole, [3.0])[:, 0], rtol=1e3 * SAME)


def test_a_lifted_model_of_one_rate_is_the_model_and_what_never_ticks_has_none() -> None:
    diagram = Diagram.load(DIAGRAMS / "sampled_loop.json")
    linearizer = diagram.linearizer()
    lifted, model = linearizer.lifted("reference.y", "plant.y"), linearizer.model("reference.y", "plant.y")
    assert lifted.steps == 1
    for name in "ABCD":
        assert np.array_equal(getattr(lifted, name), getattr(model, name))
    omega = np.geomspace(0.1, 30.0, 5)
    assert np.allclose(lifted.fundamental(omega), response(model, omega), rtol=SAME)
    alone = Diagram.alone(blocks.FirstOrder())
    with pytest.raises(
        UsageError,
        match=r"E501 FirstOrder: this transfer has no sampled part\. "
        r"Use model",
    ):
        alone.linearizer().lifted("u", "y")


def held(omega: Array, h: float) -> Array:
    """The fundamental in time of what is held over steps h."""
    return np.asarray((1.0 - np.exp(-1j * omega * h)) / (1j * omega * h))


def test_the_fundamental_of_two_rates_is_that_of_a_long_run() -> None:
    h, period = 0.01, 0.06
    diagram = of_two_rates(sampler=h)
    lifted = diagram.linearizer().lifted("sampler.u", SEEN)
    # At these all sines that two rates make of one are harmonics of it, which a window of its periods keeps apart.
    omega = 2.0 * math.pi / (period * np.array([40.0, 9.0, 3.0]))
    swept = estimate_response(diagram, "r", ["inner.y", "outer.y"], SineStream(omega), engine=ENGINE)
    assert swept.settled.all()
    made = lifted.fundamental(omega)[[SEEN.index("inner.y"), SEEN.index("outer.y")], 0]
    assert np.allclose(swept.value, held(omega, h) * made, rtol=SWEPT, atol=SWEPT)
    # The response of the slow model is another one: its input is held over the whole pattern.
    assert not np.allclose(
        made[:, 2], response(diagram.linearize("r", ["inner.y", "outer.y"]), omega)[:, 0, 2], rtol=0.1
    )


# --- loops ----------------------------------------------------------------------------------------------------------


def of_two_holds(k: float = 1.5) -> Diagram:
    """1/(s (s + 1)) behind holds of 0.1 s and 0.25 s and a gain."""
    made = Diagram("holds")
    made.add("fast", blocks.ZeroOrderHold(period=0.1))
    made.add("slow", blocks.ZeroOrderHold(period=0.25))
    made.add("gain", blocks.Gain(k=-k))
    made.add("lag", blocks.FirstOrder(T=1.0))
    made.add("plant", blocks.Integrator(y_start=1.0))
    for target, source in {
        "fast.u": "plant.y", "slow.u": "fast.y", "gain.u": "slow.y", "lag.u": "gain.y", "plant.u": "lag.y",
    }.items():  # fmt: skip
        made.wire(target, source)
    return made


def size_of_two_holds(k: complex) -> float:
    """The largest eigenvalue of 0.5 s of it in closed form: 1/(s (s + 1)) with inputs held, from tick to tick."""
    whole, now = np.eye(4, dtype=complex), 0.0  # y, its rate, what is held fast, and slowly
    for until in (0.1, 0.2, 0.25, 0.3, 0.4, 0.5):
        sampled = np.eye(4, dtype=complex)
        if now != 0.25:
            sampled[2] = [1.0, 0.0, 0.0, 0.0]
        if now in (0.0, 0.25):
            sampled[3] = sampled[2]
        T, e = until - now, math.exp(now - until)
        flow = np.array(
            [[1.0, 1.0 - e, 0.0, -k * (T - 1.0 + e)], [0.0, e, 0.0, -k * (1.0 - e)], [0, 0, 1, 0], [0, 0, 0, 1]]
        )
        whole, now = flow @ sampled @ whole, until
    return float(np.max(np.abs(np.linalg.eigvals(whole))))


POINTS = ["fast.u", "fast.y", "slow.u", "slow.y", "gain.u", "gain.y", "lag.u", "plant.y"]


@pytest.mark.parametrize("point", long_but(POINTS, lambda point: point in ("fast.y", "slow.u", "plant.y")))
def test_margins_of_a_loop_of_two_rates_are_those_of_its_eigenvalues_wherever_it_is_opened(point: str) -> None:
    found = margins(of_two_holds().linearizer().loop(point))
    gain = brentq(lambda k: size_of_two_holds(1.5 * k) - 1.0, 2.0, 8.0, xtol=1e-14)
    assert gain == pytest.approx(4.6446, abs=5e-5)
    phase = brentq(lambda x: size_of_two_holds(1.5 * np.exp(1j * x)) - 1.0, 0.1, 1.5, xtol=1e-14)
    assert found.stable is True
    assert [factor for factor, _ in found.gains] == pytest.approx([gain], rel=1e-9)
    assert [degrees for degrees, _ in found.phases] == pytest.approx([math.degrees(phase)], rel=1e-9)
    shown = found.as_json()
    assert (shown["delay"], shown["Ms"], shown["Mt"], shown["disk"]) == (None, None, None, None)
    # An input held over the whole pattern gives a model that closes to another system.
    assert margins(of_two_holds(0.99 * 1.5 * gain).linearizer().loop(point)).stable is True
    beyond = margins(of_two_holds(1.01 * 1.5 * gain).linearizer().loop(point))
    assert (beyond.stable, len(beyond.unstable), beyond.gain_low) == (False, 2, pytest.approx(1.0 / 1.01, rel=1e-9))


def test_a_loop_of_two_rates_grows_in_a_run_beyond_its_gain_margin_alone() -> None:
    def last(factor: float) -> float:
        run = of_two_holds(1.5 * factor).run(stop=100.0, every=0.25, log=["plant.y"], engine=ENGINE)
        size = np.abs(run["plant.y"])
        return float(np.max(size[-40:]) / np.max(size[:40]))

    assert last(4.6) < 0.8
    assert last(4.7) > 1.25


def test_the_command_shows_a_loop_of_two_rates_and_draws_no_curve_of_it(tmp_path: Path, capsys: Any) -> None:
    path = str(tmp_path / "holds.json")
    of_two_holds(6.9).save(path)
    assert main(["linearize", path, "--loop", "gain.y"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines[1].startswith("loop at gain.y: 2 states, ")
    assert lines[1].endswith(" values of the signal in a pattern of 0.5 s")
    assert "gain margin     1.0097 (0.08377 dB) at 2.5205 rad/s" in lines
    assert main(["linearize", path, "--loop", "gain.y", "--json"]) == 0
    known = json.loads(capsys.readouterr().out)["margins"]
    assert (known["stable"], known["gain"]) == (True, pytest.approx(1.5 * 4.644579452 / 6.9, rel=1e-9))
    figure = tmp_path / "loop.svg"
    assert main(["linearize", path, "--loop", "gain.y", "--plot", str(figure)]) == 2
    assert "E705 gain.y: is a loop of several rates" in capsys.readouterr().err
    assert not figure.exists()
    assert main(["linearize", path, "--loop", "gain.y", "--plot", str(figure), "--figure", "poles"]) == 0
    assert figure.exists()


def with_factor(point: str, factor: float, **rates: float) -> Diagram:
    """of_two_rates with a gain behind an output."""
    text = of_two_rates(**rates).to_json()
    text["wires"] = {sink: "factor.y" if source == point else source for sink, source in text["wires"].items()}
    text["wires"]["factor.u"] = point
    text["blocks"]["factor"] = {"type": "Gain", "parameters": {"k": factor}}
    return Diagram.from_json(text)


@pytest.mark.parametrize(
    ("point", "rates"),
    long_but(
        itertools.product(
            ("error.y", "outer.y", "computing.y", "inner.y", "angle.y"),
            ({}, {"offset": 0.013}, {"fast": 0.01, "slow": 0.04}),
        ),
        lambda point, rates: not rates or point == "inner.y",
    ),
)
def test_the_gain_margin_of_a_loop_of_two_rates_is_where_the_diagram_with_this_gain_is_at_the_border(
    point: str, rates: dict[str, float]
) -> None:
    found = margins(of_two_rates(**rates).linearizer().loop(point))
    assert (found.stable, len(found.gains), found.gain_low) == (True, 1, None)
    assert found.gain is not None

    def size(factor: float) -> float:
        model = with_factor(point, factor, **rates).linearize("r", SEEN)
        return float(np.max(np.abs(model.poles())))

    assert all(size(found.gain * factor) < 1.0 for factor in (0.01, 0.1, 0.5, 0.9, 1.0 - 1e-6))
    assert size(found.gain * (1.0 + 1e-6)) > 1.0


def test_the_closed_loop_over_all_ticks_has_the_poles_of_the_diagram() -> None:
    linearizer = of_two_rates().linearizer()
    wanted = np.sort(np.abs(linearizer.model("r", SEEN).poles()))[::-1]
    for point in ("error.y", "computing.y", "inner.y"):
        loop = linearizer.loop(point)
        assert isinstance(loop, LiftedLoop)
        assert (loop.point, loop.dt) == (point, pytest.approx(0.06))
        assert np.all(np.diff(loop.times) > 0)
        made = np.sort(np.abs(loop.closed().poles()))[::-1]
        assert np.allclose(made[:4], wanted[:4], rtol=1e-9, atol=1e-12)
    assert loop.times == pytest.approx((0.0, 0.02, 0.03, 0.04))
    positive = linearizer.loop("inner.y", sign=1.0)
    assert isinstance(positive, LiftedLoop)
    assert np.array_equal(positive.C, -linearizer.loop("inner.y").C)


def test_a_sampled_loop_is_not_opened_where_its_signal_changes_between_ticks_and_acts_there() -> None:
    """With its input held from tick to tick it would be another loop, of one rate as of several."""
    told = (
        r"E705 motor\.y: changes and acts between the ticks of sampled blocks.*held: outer\.y, "
        r"computing\.y"
    )
    with pytest.raises(AnalysisError, match=told):
        of_two_rates().linearizer().loop("motor.y")
    one = Diagram("one")
    one.add("hold", blocks.ZeroOrderHold(period=0.5))
    one.add("gain", blocks.Gain(k=-3.0))
    one.add("first", blocks.FirstOrder(T=1.0))
    one.add("second", blocks.FirstOrder(T=0.1))
    for target, source in {
        "gain.u": "hold.y", "first.u": "gain.y", "second.u": "first.y", "hold.u": "second.y",
    }.items():  # fmt: skip
        one.wire(target, source)
    with pytest.raises(AnalysisError, match=r"E705 first\.y: changes and acts between the ticks.*held: hold\.y"):
        one.linearizer().loop("first.y")
    before, behind = (margins(one.linearizer().loop(name)) for name in ("second.y", "gain.y"))
    assert before.gain == pytest.approx(behind.gain, rel=1e-10)
    assert before.Ms == pytest.approx(behind.Ms, rel=1e-10)


class Latch(blocks.Block):
    """y is u at the last tick, after it; equations of the tick see the one before."""

    period = blocks.Parameter(0.5, unit="s")
    u = blocks.Input()
    x = blocks.Discrete(visible="after")

    @x.next(every=period)
    def sample(u):  # type: ignore[no-untyped-def]
        return u

    @blocks.output
    def y(x):  # type: ignore[no-untyped-def]
        return x


def test_a_signal_that_an_update_changes_has_two_values_at_the_tick() -> None:
    """x(k+1) = -a x(k) - b p(k) with p' = x - p: what goes into the update is x(k), what goes into p is x(k+1)."""
    a, b, e = 0.4, 0.3, math.exp(-0.5)
    made = Diagram("latched")
    made.add("latch", Latch())
    made.add("plant", blocks.FirstOrder(T=1.0))
    made.add("back", blocks.Sum(signs="--"))
    made.add("a", blocks.Gain(k=a))
    made.add("b", blocks.Gain(k=b))
    for target, source in {
        "latch.u": "back.y", "a.u": "latch.y", "plant.u": "latch.y", "b.u": "plant.y", "back.u1": "a.y",
        "back.u2": "b.y",
    }.items():  # fmt: skip
        made.wire(target, source)

    def size(k: complex) -> float:
        """x and p after the tick; k on the signal that both read."""
        update = np.array([[-a * k, -b], [0.0, 1.0]])
        return float(np.max(np.abs(np.linalg.eigvals(np.array([[1.0, 0.0], [(1.0 - e) * k, e]]) @ update))))

    loop = made.linearizer().loop("latch.y")
    assert isinstance(loop, LiftedLoop)
    assert loop.times == (0.0, 0.0)
    found = margins(loop)
    assert found.stable is (size(1.0) < 1.0) is True
    assert found.gain == pytest.approx(brentq(lambda k: size(k) - 1.0, 1.0, 10.0, xtol=1e-14), rel=1e-9)
    # Only the update reads it here: x(k+1) = -k x(k), at the border for k = 1.
    alone = Diagram("alone")
    alone.add("latch", Latch())
    alone.add("gain", blocks.Gain(k=-0.4))
    alone.wire("gain.u", "latch.y")
    alone.wire("latch.u", "gain.y")
    for point in ("latch.y", "gain.y"):
        assert margins(alone.linearizer().loop(point)).gain == pytest.approx(2.5, rel=1e-12)


# --- responses ------------------------------------------------------------------------------------------------------


def test_a_sweep_sees_the_sampled_model_behind_its_hold_and_in_front_of_the_plant() -> None:
    T = 0.1
    diagram = Diagram("held")
    r = diagram.input("r")
    diagram.add("sampler", blocks.ZeroOrderHold(period=T))
    diagram.add("error", blocks.Sum(signs="+-"))
    diagram.add("sensor", blocks.ZeroOrderHold(period=T))
    diagram.add("controller", blocks.DiscreteTransferFunction(num=[1.5, -1.2], den=[1.0, -0.6], period=T))
    diagram.add("plant", blocks.TransferFunction(num=[2.0], den=[1.0, 0.8, 2.0]))
    for target, source in {
        "error.u1": "sampler.y", "sensor.u": "plant.y", "error.u2": "sensor.y", "controller.u": "error.y",
        "plant.u": "controller.y",
    }.items():  # fmt: skip
        diagram.wire(target, source)
    diagram.wire("sampler.u", r)
    omega = np.array([0.3, 1.4, 5.0, 20.0])
    model = diagram.linearize("r", ["controller.y", "sensor.y"])
    swept = estimate_response(diagram, "r", ["controller.y", "sensor.y", "plant.y"], SineStream(omega), engine=ENGINE)
    made = response(model, omega)[:, 0] * held(omega, T)
    assert np.allclose(swept.value[:2], made, rtol=SWEPT, atol=SWEPT)
    # In continuous time the plant answers the fundamental of what is held in front of it.
    s = 1j * omega
    assert np.allclose(swept.value[2], made[0] * 2.0 / (s**2 + 0.8 * s + 2.0), rtol=SWEPT, atol=SWEPT)


# --- delays ---------------------------------------------------------------------------------------------------------


def delayed_loop(delay: float, controller: Any = None) -> Diagram:
    """r - y through a gain (or a sampled block) and a delay into 1/(s + 1)."""
    made = Diagram("late")
    r = made.input("r")
    made.add("error", blocks.Sum(signs="+-"))
    made.add("controller", controller or blocks.Gain(k=1.5))
    made.add("late", blocks.TransportDelay(delay=delay))
    made.add("plant", blocks.FirstOrder(T=1.0))
    made.wire("error.u1", r)
    made.wire("error.u2", "plant.y")
    made.wire("controller.u", "error.y")
    made.wire("late.u", "controller.y")
    made.wire("plant.u", "late.y")
    return made


def test_delays_in_responses_are_exact_in_a_loop_too() -> None:
    linearizer = delayed_loop(0.4).linearizer()
    omega = np.geomspace(0.01, 300.0, 40)
    s = 1j * omega
    L = 1.5 * np.exp(-0.4 * s) / (s + 1.0)
    made = linearizer.response("r", ["plant.y", "late.y", "late.u", "controller.y"], omega)[:, 0]
    wanted = np.array([L, 1.5 * np.exp(-0.4 * s), 1.5 + 0.0 * s, 1.5 + 0.0 * s]) / (1.0 + L)
    assert np.allclose(made, wanted, rtol=1e2 * SAME)
    # Put in right in front of the delay, and behind it.
    assert np.allclose(
        linearizer.response(["late.u", "late.y"], "plant.y", omega)[0],
        np.array([np.exp(-0.4 * s), 1.0 + 0.0 * s]) / (s + 1.0) / (1.0 + L), rtol=1e2 * SAME,
    )  # fmt: skip
    assert np.allclose(linearizer.response("late.u", "late.u", omega)[0, 0], 1.0 / (1.0 + L), rtol=1e2 * SAME)
    opened = linearizer.response("late.u", "plant.y", omega, openings="late.u")[0, 0]
    assert np.allclose(opened, np.exp(-0.4 * s) / (s + 1.0), rtol=1e2 * SAME)


@pytest.mark.parametrize("delay", [0.03, 0.13])
def test_a_delay_behind_a_hold_is_a_hold_with_an_offset(delay: float) -> None:
    """A hold of 0.1 s, a delay and 1/(s + 1): by the transition over the parts of a period before and after it."""
    period, whole, rest = 0.1, int(delay / 0.1), delay % 0.1
    controller = blocks.ZeroOrderHold(period=period)
    made = Diagram("offset")
    chain: dict[str, Any] = {"plant": blocks.FirstOrder(T=1.0), "controller": controller}
    chain |= {f"unit{k}": blocks.UnitDelay(period=period) for k in range(whole)}
    chain |= {"late": blocks.ZeroOrderHold(period=period, offset=rest), "back": blocks.Gain(k=-1.0)}
    for name, block in chain.items():
        made.add(name, block)
    for before, name in itertools.pairwise([*chain, "plant"]):
        made.wire(f"{name}.u", f"{before}.y")
    omega = np.geomspace(0.1, 30.0, 20)
    z = np.exp(1j * omega * period)
    # y[k+1] = e^-T y[k] + (e^-(T - rest) - e^-T) u[k-1-whole] + (1 - e^-(T - rest)) u[k-whole]
    early, late = np.exp(-(period - rest)) - np.exp(-period), 1 - np.exp(-(period - rest))
    wanted = z ** -float(whole) * (early / z + late) / (z - np.exp(-period))
    held, exact = made.linearizer().loop("controller.y"), delayed_loop(delay, controller).linearizer().loop("error.y")
    assert np.allclose(response(held, omega)[0, 0], wanted, rtol=1e-12)
    assert np.allclose(response(exact, omega)[0, 0], wanted, rtol=1e-12)
    assert margins(exact).gain == pytest.approx(margins(held).gain, rel=1e-12)
    assert margins(exact).modulus == pytest.approx(margins(held).modulus, rel=1e-12)


def test_delays_have_no_state_space_but_pade_models() -> None:
    linearizer = delayed_loop(0.4).linearizer()
    with pytest.raises(AnalysisError, match=r"E707 late: the transfer has exact delays.*late\.past \(0\.4 s\)") as told:
        linearizer.model("r", "plant.y")
    assert "pade=3" in str(told.value)
    omega = np.geomspace(0.01, 3.0, 10)
    model = linearizer.model("r", "plant.y", pade=5)
    assert model.nstates == 6
    assert np.allclose(response(model, omega), linearizer.response("r", "plant.y", omega), rtol=1e-6)
    num, den = control.pade(0.4, 3)
    wanted = control.feedback(control.tf(num, den) * control.tf([1.5], [1.0, 1.0]), 1)
    assert np.allclose(response(linearizer.model("r", "plant.y", pade=3), omega)[0, 0], wanted(1j * omega), rtol=1e-9)
