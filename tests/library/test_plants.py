"""Mechanical plants: closed forms, matrix exponentials, python-control, Lagrange's equations from the energies."""

import math
from typing import Any

import casadi
import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from blocks import (
    Constant,
    Diagram,
    DiscreteESO,
    InvertedPendulum,
    MassSpringDamper,
    QuarterCar,
    Results,
    Sine,
    Step,
)
from blocks.contract.equation_values import numeric
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.library import LIBRARY
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
