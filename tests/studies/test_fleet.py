"""Fleets: what the study says, once more by matrix exponentials, closed forms, and SciPy on equations by hand."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from blocks import Diagram, graph
from blocks.studies import study
from tests.support import witness_paper as paper
from tests.support.places import ROOT

FLEET = ROOT / "diagrams" / "fleet"
Array = np.ndarray[Any, Any]


@pytest.mark.usefixtures("native")
def test_every_verdict_of_the_study_is_the_expected_one() -> None:
    outcome = study.run(study.load(FLEET / "study.json"))
    assert outcome.is_fine, [(v.claim.measure, v.value) for v in outcome.verdicts if not v.is_expected]
    assert sum(bool(verdict.verdict) for verdict in outcome.verdicts) == 11


# --- agreement ---------------------------------------------------------------------------------------------------


def test_agents_on_a_ring_agree_as_the_exponential_of_its_laplacian_says() -> None:
    diagram = Diagram.load(FLEET / "consensus.json")
    results = diagram.run()
    laplacian = graph.laplacian(graph.ring(20)).toarray()
    start = 1.0 + np.cos(2 * np.pi * np.arange(20) / 20)
    for t in (0.0, 10.0, 40.0):
        row = np.searchsorted(results.t, t)
        assert np.asarray(results["agents.y"])[row] == pytest.approx(expm(-t * laplacian) @ start, abs=1e-8)
    second = np.linalg.eigvalsh(laplacian)[1]
    assert results.measures["left"] == pytest.approx(np.exp(-10.0 * second) / np.sqrt(2.0), rel=1e-7)


# --- a platoon ---------------------------------------------------------------------------------------------------


def link(h: float, kp: float = 0.2, kd: float = 0.7, T: float = 0.1) -> Any:
    """From the speed of a vehicle to that of the one behind it."""
    return control.tf([kd, kp], [T, 1.0, kd + kp * h, kp])


@pytest.mark.parametrize(("h", "is_stable"), [(1.5, True), (1.0, False)])
def test_swings_in_a_platoon_follow_the_gain_of_one_link(h: float, is_stable: bool) -> None:
    gains = np.abs(link(h)(1j * np.logspace(-4, 2, 4001)))
    assert (gains.max() <= 1.0) == is_stable
    measures = Diagram.load(FLEET / "platoon.json").run(parameters={"h": h}).measures
    gain = abs(link(h)(0.2j))
    assert (measures["first"], measures["last"]) == pytest.approx((gain, gain**50), rel=1e-5)


@pytest.mark.parametrize("h", [1.5, 1.0])
def test_the_linear_model_of_the_platoon_is_the_link_to_the_power_of_fifty(h: float) -> None:
    linear = Diagram.load(FLEET / "platoon.json").linearizer(parameters={"h": h})
    for k in (0, 1, 9):
        model = linear.model("leader.y", f"vehicles.speed[{k}]")
        for omega in (0.05, 0.2, 1.0):
            assert model(1j * omega) == pytest.approx(link(h)(1j * omega) ** (k + 1), rel=1e-8)


# --- a formation -------------------------------------------------------------------------------------------------

OFFSETS = np.array([[0, -0.6, -0.6, -1.2, -1.2, -1.2], [0, 0.5, -0.5, 1.0, -1.0, 0]])
START = np.array([[-0.3, -0.5, -0.9, -1.6, -1.0, -1.9], [0.3, 0.2, -0.9, 0.6, -0.5, 0.3]])
HEADINGS = np.radians([20, -40, 60, -10, 90, 0])
HEARS = {1: [(0, 1.0)], 2: [(0, 1.0)], 3: [(1, 1.0)], 4: [(2, 1.0)], 5: [(1, 0.5), (2, 0.5)]}
ARM, GAIN, SPEED = 0.2, 0.3, 0.15


def bell(m: float, e: Array) -> Array:
    return 0.5 * (1.0 - np.tanh(0.5 * m * e * e))


def power(e: Array, a: float) -> Array:
    return np.sign(e) * np.abs(e) ** a


def fal(e: Array, a: float, d: float) -> Array:
    return np.where(np.abs(e) > d, power(e, a), e / d ** (1.0 - a))


def improved(r1: Array, r2: Array, integral: Array, z1: Array, z2: Array, omega: Array, wanted: Array) -> Any:
    """What the controllers under IADRC give: d r2/dt, feedback, g of the observer by derivative, and its gains."""
    e1, e2, R, alpha = r1 - z1, r2 - z2, paper.INTD_R, (paper.ALPHA1, paper.ALPHA2, paper.ALPHA3)
    v = (paper.K11 + paper.K12 * bell(paper.MU1, e1)) * power(e1, alpha[0])
    v = v + (paper.K21 + paper.K22 * bell(paper.MU2, e2)) * power(e2, alpha[1])
    v = v + paper.K3 * bell(paper.MU3, integral) * power(integral, alpha[2])
    slope = -R * R * np.tanh(paper.INTD_BETA * (r1 - wanted) / paper.INTD_GAMMA) - R * r2
    e = omega - z1
    g = paper.K_ALPHA * power(e, paper.SM_ALPHA) + paper.K_BETA * np.abs(e) ** paper.SM_BETA * e
    return slope, paper.DELTA * np.tanh(v / paper.DELTA), g, (paper.SM_L1, paper.SM_L2, paper.SM_L3)


def classical(r1: Array, r2: Array, integral: Array, z1: Array, z2: Array, omega: Array, wanted: Array) -> Any:
    """The same under ADRC; fhan by its formula."""
    r, h = paper.TD_R, paper.TD_H
    d, y = r * h, r1 - wanted + h * r2
    a = np.where(np.abs(y) > d * h, r2 + np.sign(y) * 0.5 * (np.sqrt(d * d + 8 * r * np.abs(y)) - d), r2 + y / h)
    slope = np.where(np.abs(a) > d, -r * np.sign(a), -r * a / d)
    feedback = fal(r1 - z1, paper.FAL_A1, paper.FAL_D1) + fal(r2 - z2, paper.FAL_A2, paper.FAL_D2)
    return slope, feedback, omega - z1, (paper.LE_L1, paper.LE_L2, paper.LE_L3)


def hands(x: Array, y: Array, theta: Array) -> Array:
    return np.stack([x + ARM * np.cos(theta), y + ARM * np.sin(theta)]) - OFFSETS


def errors(p: Array) -> Array:
    """What the robots hear: the places of their neighbors less their own."""
    made = np.zeros((2, 6))
    for robot, heard in HEARS.items():
        made[:, robot] = sum(weight * (p[:, other] - p[:, robot]) for other, weight in heard)
    return made


def rhs(t: float, state: Array, law: Any, torque: float) -> Array:
    r1, r2, integral, z1, z2, z3, omega, i = state[:96].reshape(8, 12)  # right wheels, then left ones
    x, y, theta = state[96:114].reshape(3, 6)
    angle = 0.9 * np.tanh((t - 14) / 5)
    velocity = SPEED * np.array([np.cos(angle), np.sin(angle)])
    p = hands(x, y, theta)
    e = errors(p)
    e[:, 0] += state[114:] - p[:, 0]
    ux, uy = velocity[:, None] + GAIN * e
    ahead, aside = ux * np.cos(theta) + uy * np.sin(theta), uy * np.cos(theta) - ux * np.sin(theta)
    turn = paper.D_TRACK / (2 * ARM) * aside
    wanted = np.concatenate([ahead + turn, ahead - turn]) / paper.R_WHEEL
    slope, feedback, g, (l1, l2, l3) = law(r1, r2, integral, z1, z2, omega, wanted)
    u = feedback - z3 / paper.B_HAT
    load = np.zeros(12)
    load[1] = torque
    n, inertia = paper.N_GEAR, paper.JEQ * paper.N_GEAR
    right, left = omega[:6], omega[6:]
    v = 0.5 * paper.R_WHEEL * (right + left)
    return np.concatenate([
        r2, slope, r1 - z1, z2 + l1 * g, z3 + paper.B_HAT * u + l2 * g, l3 * g,
        (-paper.BEQ * n * omega + paper.KT * i - load / n) / inertia,
        (-paper.KB * n * omega - paper.RA * i + u) / paper.LA,
        v * np.cos(theta), v * np.sin(theta), paper.R_WHEEL * (right - left) / paper.D_TRACK, velocity,
    ])  # fmt: skip


def by_hand(law: Any, tolerance: float) -> tuple[Array, Array]:
    """Positions at 55 s, and the miss of each robot from then on, each 10 ms: shape (times, robots)."""
    state = np.concatenate([np.zeros(96), START.ravel(), HEADINGS, np.zeros(2)])
    missed = []
    for begin, end, torque in ((0, 55, 0.0), (55, 70, 3.0), (70, 85, 0.0)):
        times = np.linspace(begin, end, 100 * (end - begin) + 1)
        solved = solve_ivp(
            rhs, (begin, end), state, "DOP853", times, args=(law, torque), rtol=tolerance, atol=1e-2 * tolerance
        )
        state = solved.y[:, -1]
        if begin:
            poses = solved.y[96:114].T.reshape(-1, 3, 6)
            missed += [np.hypot(*errors(hands(*pose))) for pose in poses]
        else:
            gathered = state[96:108].reshape(2, 6)
    return gathered, np.array(missed)


@pytest.mark.long
@pytest.mark.usefixtures("native")
@pytest.mark.parametrize(
    ("variant", "law", "tolerance"),
    [("base", improved, 1e-8), ("adrc", classical, 1e-6)],
    ids=["IADRC", "ADRC"],
)
def test_the_formation_is_that_of_scipy_by_hand(variant: str, law: Any, tolerance: float) -> None:
    gathered, missed = by_hand(law, tolerance)
    formation = Diagram.load(FLEET / "formation.json")
    results = formation.run(
        variants={"robots.control_right": variant, "robots.control_left": variant}, rtol=1e-8, atol=1e-10, jumps=False
    )
    row = np.searchsorted(results.t, 55.0)
    for k, name in enumerate(("x", "y")):
        assert np.asarray(results[f"robots.{name}"])[row] == pytest.approx(gathered[k], abs=1e-6)
    for name, robot in (("braked", 1), ("neighbor", 3), ("other", 4)):
        assert results.measures[name] == pytest.approx(missed[:, robot].max(), rel=2e-4)
    wedge = OFFSETS - OFFSETS[:, :1]
    assert gathered - gathered[:, :1] == pytest.approx(wedge, abs=1e-3)
