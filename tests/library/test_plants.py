"""Mechanical plants: closed forms, matrix exponentials, python-control, Lagrange's equations from the energies."""

import math
from typing import Any

import casadi
import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from blocks import (
    Constant,
    Diagram,
    DiscreteESO,
    Integrator,
    InvertedPendulum,
    Lorenz,
    MassSpringDamper,
    Pulse,
    Quadrotor,
    QuarterCar,
    Results,
    Sine,
    Step,
    Tank,
    TwoLinkArm,
    VanDerPol,
)
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.library import LIBRARY
from tests.support.on_numbers import numeric
from tests.support.places import ROOT

Array = np.ndarray[Any, Any]

FOLDER = ROOT / "diagrams"

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
CLOSE = 1e-8
"""What an adaptive run at TIGHT leaves of the global error, with two digits to spare."""

PENDULUM = ("x", "v", "theta", "omega")
CAR = ("xb", "vb", "xw", "vw")


def evaluate(name: str, given: dict[str, Any], **read: float) -> dict[str, float]:
    """All results of a block of scalars, by the keys of the contract."""
    made = resolve(LIBRARY[name], {key: Value(value) for key, value in given.items()})
    parameters = {key: made.values[key].value[()] for key in made.interface.symbolic_parameters}
    outputs = dict.fromkeys(made.interface.declaration.outputs, 0.0)
    values = {"t": 0.0, "tick": 0, **parameters, **outputs, **read}
    for _ in range(2):  # equations that read outputs see them the second time
        results = numeric(made.interface, values)
        values |= {key: results[f"output:{key}"] for key in outputs}
    return {key: float(value[0]) for key, value in numeric(made.interface, values).items()}


def slopes(name: str, states: tuple[str, ...], given: dict[str, Any], at: Array, **inputs: float) -> Array:
    made = evaluate(name, given, **dict(zip(states, at, strict=True)), **inputs)
    return np.array([made[f"derivative:{state}"] for state in states])


def final(results: Results, *names: str) -> list[float]:
    return [float(results[name][-1]) for name in names]


# --- a mass on a spring ----------------------------------------------------------------------------------------


def test_a_mass_on_a_spring_swings_as_its_closed_form_says() -> None:
    m, c, k, force, x0, v0 = 2.0, 1.2, 50.0, 10.0, 0.3, -1.0
    d = Diagram("spring")
    push = d.add("push", Constant(value=force, unit="N"))
    plant = d.add("plant", MassSpringDamper(m=m, c=c, k=k, x_start=x0, v_start=v0))
    d.wire(plant.F, push.y)
    results = d.run(stop=6.0, every=0.25, **TIGHT)
    t, rest, decay = np.asarray(results.t), force / k, c / (2.0 * m)
    omega = math.sqrt(k / m - decay**2)
    a, b = x0 - rest, (v0 + decay * (x0 - rest)) / omega
    fading, cos, sin = np.exp(-decay * t), np.cos(omega * t), np.sin(omega * t)
    x = rest + fading * (a * cos + b * sin)
    assert results["plant.x"] == pytest.approx(x, rel=CLOSE, abs=CLOSE)
    v = fading * ((b * omega - decay * a) * cos - (a * omega + decay * b) * sin)
    assert results["plant.v"] == pytest.approx(v, rel=CLOSE, abs=CLOSE)


def test_a_mass_with_neither_spring_nor_damper_is_free() -> None:
    d = Diagram("free")
    push, plant = d.add("push", Step(unit="N", after=3.0)), d.add("plant", MassSpringDamper(m=2.0, c=0.0, k=0.0))
    d.wire(plant.F, push.y)
    assert final(d.run(stop=4.0), "plant.x", "plant.v") == pytest.approx([12.0, 6.0], rel=1e-12)


# --- the pendulum ----------------------------------------------------------------------------------------------


def lagrange(M: float, m: float, l: float, I: float, g: float) -> Any:
    """From (x, theta), (v, omega) and the generalized forces the accelerations: from the energies, by derivatives."""
    q, dq, force = (casadi.SX.sym(name, 2) for name in ("q", "dq", "force"))
    tip = casadi.vertcat(q[0] + l * casadi.sin(q[1]), l * casadi.cos(q[1]))
    speed = casadi.jacobian(tip, q) @ dq
    kinetic = 0.5 * M * dq[0] ** 2 + 0.5 * m * casadi.sumsqr(speed) + 0.5 * I * dq[1] ** 2
    difference = kinetic - m * g * tip[1]
    momentum = casadi.gradient(difference, dq)
    mass = casadi.jacobian(momentum, dq)
    rest = force + casadi.gradient(difference, q) - casadi.jacobian(momentum, q) @ dq
    return casadi.Function("accelerations", [q, dq, force], [casadi.solve(mass, rest)])


@pytest.mark.parametrize(("I", "b", "d"), [(0.006, 0.1, 0.0), (0.0, 0.0, 0.02), (0.1, 2.0, 0.5)])
def test_the_pendulum_obeys_lagranges_equations(I: float, b: float, d: float) -> None:
    M, m, l, g = 0.7, 0.3, 0.4, 9.81
    accelerations = lagrange(M, m, l, I, g)
    rng = np.random.default_rng(3)
    for _ in range(100):
        x, v, theta, omega, F = rng.uniform(-1.0, 1.0, 5) * [5.0, 3.0, 7.0, 10.0, 20.0]
        pairs = ((x, theta), (v, omega), (F - b * v, -d * omega))
        expected = [
            float(value) for value in accelerations(*(casadi.DM(list(map(float, pair))) for pair in pairs)).elements()
        ]
        given = {"M": M, "m": m, "l": l, "I": I, "b": b, "d": d, "g": g}
        made = slopes("InvertedPendulum", PENDULUM, given, np.array([x, v, theta, omega]), F=F)
        assert made == pytest.approx([v, expected[0], omega, expected[1]], rel=1e-11, abs=1e-11)


def test_without_friction_a_pendulum_that_turns_over_keeps_energy_and_momentum() -> None:
    M, m, l, I, g = 0.5, 0.2, 0.3, 0.006, 9.81
    d = Diagram("turning")
    none = d.add("none", Constant(value=0.0, unit="N"))
    plant = d.add("plant", InvertedPendulum(b=0.0, theta_start=0.3, omega_start=4.0, v_start=0.5))
    d.wire(plant.F, none.y)
    results = d.run(stop=20.0, every=0.05, **TIGHT)
    v, theta, omega = (np.asarray(results[f"plant.{name}"]) for name in ("v", "theta", "omega"))
    assert np.ptp(theta) > 20.0 * math.pi
    sideways, up = v + l * omega * np.cos(theta), -l * omega * np.sin(theta)
    energy = 0.5 * (M * v**2 + m * (sideways**2 + up**2) + I * omega**2) + m * g * l * np.cos(theta)
    # 20 s of turning: the error at TIGHT grows with the number of turns.
    assert energy == pytest.approx(np.full(len(energy), energy[0]), rel=100 * CLOSE)
    momentum = M * v + m * sideways
    assert momentum == pytest.approx(np.full(len(momentum), momentum[0]), rel=100 * CLOSE)


def test_a_pendulum_is_that_of_equations_written_by_hand() -> None:
    M, m, l, I, b, d, g = 0.5, 0.2, 0.3, 0.006, 0.4, 0.01, 9.81

    def by_hand(t: float, s: Array) -> list[float]:
        _, v, theta, omega = s
        mass = [[M + m, m * l * math.cos(theta)], [m * l * math.cos(theta), I + m * l * l]]
        push = 2.0 * math.sin(3.0 * t)
        right = [push - b * v + m * l * omega**2 * math.sin(theta), m * g * l * math.sin(theta) - d * omega]
        dv, domega = np.linalg.solve(mass, right)
        return [v, dv, omega, domega]

    diagram = Diagram("pushed")
    push = diagram.add("push", Sine(amplitude=2.0, omega=3.0, unit="N"))
    plant = diagram.add("plant", InvertedPendulum(b=b, d=d, theta_start=2.5, v_start=-0.2))
    diagram.wire(plant.F, push.y)
    results = diagram.run(stop=5.0, every=0.5, **TIGHT)
    start = [0.0, -0.2, 2.5, 0.0]
    expected = solve_ivp(by_hand, (0.0, 5.0), start, "DOP853", np.asarray(results.t), rtol=1e-12, atol=1e-13)
    for k, name in enumerate(PENDULUM):
        assert results[f"plant.{name}"] == pytest.approx(expected.y[k], abs=10 * CLOSE), name


def test_a_pendulum_near_upright_is_the_published_linear_system() -> None:
    """The matrices and poles that the tutorial prints, which measures the angle the other way round and has g = 9.8."""
    h, origin = 1e-6, np.zeros(4)
    columns = [slopes("InvertedPendulum", PENDULUM, {"g": 9.8}, h * e, F=0.0) / h for e in np.eye(4)]
    A, B = np.array(columns).T, slopes("InvertedPendulum", PENDULUM, {"g": 9.8}, origin, F=1.0)
    turned = np.diag([1.0, 1.0, -1.0, -1.0])
    printed = [[0, 1, 0, 0], [0, -0.1818, 2.6727, 0], [0, 0, 0, 1], [0, -0.4545, 31.1818, 0]]
    assert turned @ A @ turned == pytest.approx(np.array(printed), abs=5.1e-5)
    assert turned @ B == pytest.approx([0.0, 1.8182, 0.0, 4.5455], abs=5.1e-5)
    poles = control.ss(A, B[:, None], np.eye(4), np.zeros((4, 1))).poles()
    assert sorted(poles.real) == pytest.approx([-5.6041, -0.1428, 0.0, 5.5651], abs=5.1e-5)


# --- the quarter car -------------------------------------------------------------------------------------------


def quarter_car() -> Any:
    """The published state-space model, from (road, F) to (ab, stroke, tire) and the states."""
    mb, mw, bs, ks, kt = 300.0, 60.0, 1000.0, 16000.0, 190000.0
    A = np.array([
        [0, 1, 0, 0],
        [-ks / mb, -bs / mb, ks / mb, bs / mb],
        [0, 0, 0, 1],
        [ks / mw, bs / mw, (-ks - kt) / mw, -bs / mw],
    ])  # fmt: skip
    B = np.array([[0, 0], [0, 1 / mb], [0, 0], [kt / mw, -1 / mw]])
    C = np.vstack([A[1], [1, 0, -1, 0], [0, 0, -kt, 0], np.eye(4)])
    D = np.vstack([B[1], [0, 0], [kt, 0], np.zeros((4, 2))])
    return control.ss(A, B, C, D)


SEEN = ("ab", "stroke", "tire", *CAR)


def test_a_quarter_car_is_the_exponential_of_its_matrix() -> None:
    model = quarter_car()
    d = Diagram("car")
    road, force = d.add("road", Constant(value=0.05, unit="m")), d.add("force", Constant(value=-200.0, unit="N"))
    start = [0.01, -0.2, 0.02, 0.3]
    car = d.add("car", QuarterCar(**{f"{name}_start": value for name, value in zip(CAR, start, strict=True)}))
    d.wire(car.road, road.y)
    d.wire(car.F, force.y)
    results = d.run(stop=2.0, every=0.1, **TIGHT)
    u = np.array([0.05, -200.0])
    both = np.block([[model.A, model.B], [np.zeros((2, 6))]])
    for k, t in enumerate(results.t):
        x = (expm(both * t) @ np.concatenate([start, u]))[:4]
        expected = model.C @ x + model.D @ u
        assert [results[f"car.{name}"][k] for name in SEEN] == pytest.approx(expected, rel=CLOSE, abs=100 * CLOSE)


def test_a_quarter_car_has_its_published_invariant_frequencies() -> None:
    """Whatever the suspension does, its force cannot act at these frequencies: zeros on the imaginary axis."""
    names = ("ab", "stroke")
    columns = [evaluate("QuarterCar", {}, **dict(zip(CAR, e, strict=True)), road=0.0, F=0.0) for e in np.eye(4)]
    ahead = evaluate("QuarterCar", {}, **dict.fromkeys(CAR, 0.0), road=0.0, F=1.0)
    A = np.array([[made[f"derivative:{state}"] for made in columns] for state in CAR])
    B = np.array([[ahead[f"derivative:{state}"]] for state in CAR])
    for name, frequency in zip(names, (56.27, 22.97), strict=True):
        C = np.array([[made[f"output:{name}"] for made in columns]])
        zeros = control.ss(A, B, C, [[ahead[f"output:{name}"]]]).zeros()
        axis = zeros[np.abs(zeros) > 1.0]
        assert sorted(axis.imag) == pytest.approx([-frequency, frequency], abs=0.0051)
        assert axis.real == pytest.approx([0.0, 0.0], abs=1e-6)


def test_an_unwired_force_leaves_a_passive_suspension() -> None:
    d = Diagram("passive")
    road, car = d.add("road", Step(after=0.1, unit="m")), d.add("car", QuarterCar())
    d.wire(car.road, road.y)
    results = d.run(stop=30.0)
    assert final(results, "car.xb", "car.xw", "car.stroke", "car.ab") == pytest.approx([0.1, 0.1, 0.0, 0.0], abs=1e-6)


# --- the arm ---------------------------------------------------------------------------------------------------

ARM = ("theta1", "theta2", "omega1", "omega2")
ARMS = {"m1": 1.3, "m2": 0.7, "l1": 0.6, "l2": 0.4, "r1": 0.25, "r2": 0.22, "I1": 0.05, "I2": 0.01, "g": 9.81}


def arm_energies(q: Any, dq: Any, m1: float, m2: float, l1: float, r1: float, r2: float, I1: float, I2: float) -> Any:
    """Kinetic energy and the heights of both masses, as symbols or as numbers."""
    ahead, total = q[0] + q[1], dq[0] + dq[1]
    across = -l1 * casadi.sin(q[0]) * dq[0] - r2 * casadi.sin(ahead) * total
    up = l1 * casadi.cos(q[0]) * dq[0] + r2 * casadi.cos(ahead) * total
    kinetic = 0.5 * (m1 * r1**2 + I1) * dq[0] ** 2 + 0.5 * m2 * (across**2 + up**2) + 0.5 * I2 * total**2
    return kinetic, m1 * r1 * casadi.sin(q[0]) + m2 * (l1 * casadi.sin(q[0]) + r2 * casadi.sin(ahead))


def test_the_arm_obeys_lagranges_equations() -> None:
    given = {key: value for key, value in ARMS.items() if key not in ("l2", "g")}
    q, dq, tau = (casadi.SX.sym(name, 2) for name in ("q", "dq", "tau"))
    kinetic, moment = arm_energies(q, dq, **given)
    momentum = casadi.gradient(kinetic, dq)
    rest = tau + casadi.gradient(kinetic - 9.81 * moment, q) - casadi.jacobian(momentum, q) @ dq
    accelerations = casadi.Function("a", [q, dq, tau], [casadi.solve(casadi.jacobian(momentum, dq), rest)])
    rng = np.random.default_rng(4)
    for _ in range(50):
        at, d1, d2 = rng.uniform(-1.0, 1.0, 6) * [7.0, 7.0, 10.0, 10.0, 20.0, 20.0], *rng.uniform(0.0, 1.0, 2)
        torques = [at[4] - d1 * at[2], at[5] - d2 * at[3]]
        expected = accelerations(*(casadi.DM(list(map(float, pair))) for pair in (at[:2], at[2:4], torques))).elements()
        made = slopes("TwoLinkArm", ARM, {**ARMS, "d1": d1, "d2": d2}, at[:4], tau1=at[4], tau2=at[5])
        assert made == pytest.approx([at[2], at[3], *expected], rel=1e-11, abs=1e-11)


def test_an_arm_without_friction_keeps_its_energy() -> None:
    d = Diagram("falling")
    d.add("arm", TwoLinkArm(**ARMS, theta1_start=0.4, theta2_start=1.0, omega2_start=2.0))
    results = d.run(stop=10.0, every=0.05, **TIGHT)
    q1, q2, w1, w2 = (np.asarray(results[f"arm.{name}"]) for name in ARM)
    given = {key: value for key, value in ARMS.items() if key not in ("l2", "g")}
    energy = [
        float(kinetic + 9.81 * moment)
        for kinetic, moment in (
            arm_energies(casadi.DM([a, b]), casadi.DM([c, e]), **given)
            for a, b, c, e in zip(q1, q2, w1, w2, strict=True)
        )
    ]
    # Chaotic: the error grows, that of the energy less.
    assert energy == pytest.approx([energy[0]] * len(energy), abs=1000 * CLOSE)
    tip = 0.6 * np.exp(1j * q1) + 0.4 * np.exp(1j * (q1 + q2))
    assert np.asarray(results["arm.x"]) + 1j * np.asarray(results["arm.y"]) == pytest.approx(tip, abs=1e-13)


# --- the quadrotor ---------------------------------------------------------------------------------------------


def test_a_quadrotor_is_that_of_a_rotation_matrix() -> None:
    """Nine elements of R with dR/dt = R hat(omega), by SciPy: no quaternion, another kinematics."""
    m, J, k, g = 0.7, np.array([3e-3, 2e-3, 5e-3]), 0.2, 9.81
    F, torque = 8.0, np.array([2e-3, -1e-3, 1.5e-3])
    angles = (0.3, -0.4, 1.1)

    def by_hand(t: float, s: Array) -> Array:
        v, R, omega = s[3:6], s[6:15].reshape(3, 3), s[15:]
        a, b, c = omega
        hat = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        dv = (F * R @ [0.0, 0.0, 1.0] - k * v) / m - [0.0, 0.0, g]
        return np.concatenate([v, dv, (R @ hat).ravel(), (torque - np.cross(omega, J * omega)) / J])

    d = Diagram("flight")
    start = dict(zip(("roll_start", "pitch_start", "yaw_start"), angles, strict=True))
    drone = d.add("drone", Quadrotor(m=m, J=J, k=k, g=g, omega_start=[0.5, -1.0, 2.0], **start))
    d.wire(drone.F, d.add("thrust", Constant(value=F, unit="N")).y)
    for axis, value in enumerate(torque):
        d.wire(f"drone.tau[{axis}]", d.add(f"tau{axis}", Constant(value=value, unit="N.m")).y)
    results = d.run(stop=3.0, every=0.1, **TIGHT)
    roll, pitch, yaw = (Rotation.from_euler(axis, angle) for axis, angle in zip("xyz", angles, strict=True))
    begin = np.concatenate([np.zeros(6), (yaw * pitch * roll).as_matrix().ravel(), [0.5, -1.0, 2.0]])
    t = np.asarray(results.t)
    expected = solve_ivp(by_hand, (0.0, 3.0), begin, "DOP853", t, rtol=1e-12, atol=1e-13).y
    assert pytest.approx(expected[:3], abs=10 * CLOSE) == np.asarray(results["drone.p"]).T
    assert pytest.approx(expected[3:6], abs=10 * CLOSE) == np.asarray(results["drone.v"]).T
    assert pytest.approx(expected[15:], abs=10 * CLOSE) == np.asarray(results["drone.omega"]).T
    turned = Rotation.from_matrix(expected[6:15].T.reshape(-1, 3, 3)).as_euler("ZYX")
    for name, angle in zip(("yaw", "pitch", "roll"), turned.T, strict=True):
        assert results[f"drone.{name}"] == pytest.approx(angle, abs=100 * CLOSE), name


def test_a_quadrotor_hovers_and_turns_about_a_free_axis_for_ever() -> None:
    d = Diagram("hover")
    drone = d.add("drone", Quadrotor(omega_start=[0.0, 0.0, 3.0], yaw_start=0.2))
    d.wire(drone.F, d.add("thrust", Constant(value=0.5 * 9.81, unit="N")).y)
    results = d.run(stop=100.0, every=1.0, **TIGHT)
    assert np.max(np.abs(results["drone.p"])) < CLOSE
    yaw = np.exp(1j * np.asarray(results["drone.yaw"]))
    assert yaw == pytest.approx(np.exp(1j * (0.2 + 3.0 * np.asarray(results.t))), abs=100 * CLOSE)


# --- the tank --------------------------------------------------------------------------------------------------


def test_a_tank_drains_after_torricelli_and_stays_empty_until_it_is_filled() -> None:
    """The root of the level falls evenly."""
    A, a, g = 0.5, 0.01, 9.81
    d = Diagram("drained")
    flow = d.add("flow", Step(at=60.0, after=0.02, unit="m3/s"))
    tank = d.add("tank", Tank(A=A, a_out=a, H=3.0, h_start=2.0))
    d.wire(tank.q, flow.y)
    results = d.run(stop=400.0, every=0.5, **TIGHT)
    t, h = np.asarray(results.t), np.asarray(results["tank.h"])
    empty = A / a * math.sqrt(2.0 * 2.0 / g)
    assert 30.0 < empty < 60.0
    before = t < 60.0
    root = np.maximum(math.sqrt(2.0) - a / A * math.sqrt(g / 2.0) * t[before], 0.0)
    assert h[before] == pytest.approx(root**2, abs=10 * CLOSE)
    assert np.all(h[before & (t > empty + 0.01)] == 0.0)
    assert h[-1] == pytest.approx((0.02 / a) ** 2 / (2.0 * g), rel=1e-6)


def test_a_tank_runs_over_and_keeps_all_water() -> None:
    d = Diagram("full")
    flow = d.add("flow", Pulse(height=0.08, on=5.0, off=60.0, unit="m3/s"))
    tank = d.add("tank", Tank(c=0.6, H=1.5, h_start=1.0))
    d.wire(tank.q, flow.y)
    for name in ("q", "q_out", "q_over"):
        d.add(name, Integrator(unit="m3"))
        d.wire(f"{name}.u", flow.y if name == "q" else f"tank.{name}")
    results = d.run(stop=100.0, every=0.1, **TIGHT)
    h, into, out, over = (np.asarray(results[name]) for name in ("tank.h", "q.y", "q_out.y", "q_over.y"))
    assert h - 1.0 == pytest.approx(into - out - over, abs=CLOSE)
    assert np.max(h) == 1.5
    full = np.asarray(results["tank.full"]).astype(bool)
    assert results["tank.q_over"][full] == pytest.approx(0.08 - 0.006 * math.sqrt(2.0 * 9.81 * 1.5), rel=1e-12)
    [sunk] = [event.t for event in results.events if event.what == "sinks"]
    assert sunk == 60.0


def test_a_tank_is_pumped_empty_and_no_further() -> None:
    d = Diagram("pumped")
    tank = d.add("tank", Tank(h_start=0.5))
    d.wire(tank.q, d.add("pump", Sine(amplitude=0.1, phase=math.pi, unit="m3/s")).y)
    d.wire(tank.valve, d.add("shut", Constant(value=0.0, unit="1")).y)
    results = d.run(stop=30.0, every=0.01, **TIGHT)
    h = np.asarray(results["tank.h"])
    pumped = 0.5 - 0.1 * (1.0 - np.cos(np.asarray(results.t)))
    assert h == pytest.approx(pumped, abs=CLOSE)  # 0.3 m at least
    deep = Diagram("deep")
    tank = deep.add("tank", Tank(h_start=0.05))
    deep.wire(tank.q, deep.add("pump", Sine(amplitude=0.1, phase=math.pi, unit="m3/s")).y)
    deep.wire(tank.valve, deep.add("shut", Constant(value=0.0, unit="1")).y)
    results = deep.run(stop=2.0 * math.pi, every=0.01, **TIGHT)
    t = np.asarray(results.t)
    level = np.where(t < math.pi, np.maximum(0.05 - 0.1 * (1.0 - np.cos(t)), 0.0), 0.1 * (1.0 + np.cos(t)))
    assert results["tank.h"] == pytest.approx(level, abs=CLOSE)
    assert [(e.what, e.t) for e in results.events] == [
        ("drained", pytest.approx(math.acos(0.5))), ("refills", pytest.approx(math.pi)),
    ]  # fmt: skip


# --- oscillators -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("mu", "period"), [(0.0, 2.0 * math.pi), (1.0, 6.6632868593231), (10.0, 19.0783695)])
def test_the_limit_cycle_of_van_der_pol_has_its_published_period(mu: float, period: float) -> None:
    """The numbers are those of the literature, to the digits that are printed."""
    d = Diagram("cycle")
    d.add("b", VanDerPol(mu=mu))
    results = d.run(stop=60.0, **TIGHT, method="dopri5")
    t, x, v = (np.asarray(each) for each in (results.t, results["b.x"], results["b.v"]))
    up = np.nonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))[0]
    # The cubic of Hermite between the last two rows.
    lines = [CubicHermiteSpline(*(each[k : k + 2] for each in (t, x, v))) for k in up]
    zeros = [float(line.roots(extrapolate=False)[0]) for line in lines]
    assert zeros[-1] - zeros[-2] == pytest.approx(period, abs=1e-6)


def test_lorenz_is_that_of_scipy_for_a_while_and_rests_where_its_equations_say() -> None:
    d = Diagram("chaos")
    d.add("b", Lorenz(x_start=1.0, y_start=2.0, z_start=20.0))
    results = d.run(stop=5.0, every=0.05, **TIGHT)

    def by_hand(t: float, s: Array) -> list[float]:
        return [10.0 * (s[1] - s[0]), s[0] * (28.0 - s[2]) - s[1], s[0] * s[1] - 8.0 / 3.0 * s[2]]

    expected = solve_ivp(by_hand, (0.0, 5.0), [1.0, 2.0, 20.0], "DOP853", np.asarray(results.t), rtol=1e-12, atol=1e-13)
    for k, name in enumerate("xyz"):
        assert results[f"b.{name}"] == pytest.approx(expected.y[k], abs=1000 * CLOSE)
    rest = math.sqrt(8.0 / 3.0 * 27.0)
    assert slopes("Lorenz", ("x", "y", "z"), {}, np.array([-rest, -rest, 27.0])) == pytest.approx([0.0] * 3, abs=1e-13)


# --- files and diagrams ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "block",
    [
        InvertedPendulum(theta_start={"value": 30, "unit": "deg"}, I=0.0),
        MassSpringDamper(m={"value": 250, "unit": "g"}),
        QuarterCar(mb=400.0, xb_start=0.1),
        DiscreteESO(form="zoh", order=3, period=0.1, bandwidth=2.0),
        LIBRARY["LSEF"](order=3, gains=[1.0, 2.0, 3.0], b0=-2.0),
        LIBRARY["NESO"](order=1, bandwidth=2.0, alpha=[1.0, 0.3]),
    ],
    ids=lambda block: type(block).__name__,
)
def test_a_block_in_a_file_is_the_block_in_python(block: Any) -> None:
    d = Diagram("one")
    d.add("it", block)
    again = Diagram.from_json(d.to_json())
    assert again.value == d.value
    assert again.dumps() == d.dumps()


def test_the_pendulum_of_the_diagram_is_balanced_by_the_optimal_gains() -> None:
    diagram = Diagram.load(FOLDER / "inverted_pendulum.json")
    h = 1e-6
    A = np.array([slopes("InvertedPendulum", PENDULUM, {}, h * e, F=0.0) / h for e in np.eye(4)]).T
    B = slopes("InvertedPendulum", PENDULUM, {}, np.zeros(4), F=1.0)[:, None]
    K, _, _ = control.lqr(A, B, np.diag([5.0, 1.0, 50.0, 1.0]), 0.1)
    gains = [diagram.to_json()["blocks"][f"of_{name}"]["parameters"]["k"] for name in PENDULUM]
    assert gains == pytest.approx(-K[0], rel=2e-3)  # as rounded in the file
    results = diagram.run()
    assert final(results, "plant.x", "plant.theta") == pytest.approx([0.5, 0.0], abs=1e-3)
    assert np.max(np.abs(diagram.run(parameters={"angle": 45})["plant.theta"])) < 0.8
    for change in ({"angle": 60}, {"force": 3}):  # what its documentation says
        assert np.max(np.abs(diagram.run(parameters=change)["plant.theta"])) > math.pi / 2


def test_the_car_of_the_diagram_climbs_its_ramp_as_python_control_says() -> None:
    results = Diagram.load(FOLDER / "quarter_car.json").run(**TIGHT)
    t = np.arange(0.0, 5.0025, 0.005)
    # Between the samples python-control takes the road for straight: its corners lie on the grid.
    road = np.interp(t, [0.0, 0.2, 0.25, 5.0], [0.0, 0.0, 0.05, 0.05])
    _, expected = control.forced_response(quarter_car(), t, np.vstack([road, np.zeros(len(t))]))
    rows = np.searchsorted(results.t, t + 1e-9, side="right") - 1
    for k, name in enumerate(("ab", "stroke", "tire", "xb")):
        scale = float(np.max(np.abs(expected[k])))
        assert np.asarray(results[f"car.{name}"][rows]) / scale == pytest.approx(expected[k] / scale, abs=10 * CLOSE)
    soft, hard = (Diagram.load(FOLDER / "quarter_car.json").run(parameters={"damping": c}) for c in (300, 3000))
    assert soft.measures["acceleration"] < results.measures["acceleration"] < hard.measures["acceleration"]
