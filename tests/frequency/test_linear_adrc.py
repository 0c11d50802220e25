"""Formulas of linear ADRC against the facts, the diagrams, SciPy, python-control and iterated Euler steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import brentq

from blocks import LESO, LSEF, Diagram, subdiagram
from blocks.contract.interface import Value
from blocks.contract.resolution import resolve
from blocks.frequency.linear_adrc import (
    Controller,
    adrc_gains,
    bandwidth_gains,
    controller,
    disturbance_bandwidth,
    disturbance_estimate,
    equivalent_bandwidth,
    euler_cycles,
    half_gain,
    half_gain_poles,
    noise_gain,
    observer,
    sampling_limits,
    settling_bandwidth,
    settling_time,
)
from blocks.frequency.margins import margins
from blocks.frequency.response import bandwidth, h2, peak, response
from blocks.text.errors import AnalysisError, UsageError
from tests.support.places import ROOT

# Digits printed in the facts: nine or ten, so half a unit of the last.
PRINTED = 1e-9
# A few operations on numbers of one size.
EXACT = 1e-12

FOLDER = ROOT / "diagrams" / "analysis"
KP, KD = 144.6642, 25.5574
LESO_GAINS, SMESO_GAINS = (30.4, 523.4, 2970.8), (30.4, 513.4, 1570.8)
RA, LA, KB, KT, N, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
B0 = KT / (LA * JEQ * N)
ORDERS = [1, 2, 3, 4]
each_order = pytest.mark.parametrize("n", ORDERS)
each_observer = pytest.mark.parametrize(
    ("gains", "poles", "width", "noise"),
    [
        (LESO_GAINS, (-8.970816244, -10.71459188 + 14.70918934j), 9.856422606, 422.4727884),
        (SMESO_GAINS, (-3.812241604, -13.2938792 + 15.33994189j), 3.846405550, 212.4239518),
    ],
    ids=["LESO", "SMESO gains"],
)


def motor() -> Any:
    """v -> omega."""
    return control.ss(
        [[-BEQ / JEQ, KT / (JEQ * N)], [-KB * N / LA, -RA / LA]], [[0.0], [1 / LA]], [[1.0, 0.0]], [[0.0]]
    )


def at(system: Any, s: Any) -> Any:
    """A transfer function at s, by its polynomials."""
    return np.polyval(system.num[0][0], s) / np.polyval(system.den[0][0], s)


def sliding(e: float) -> float:
    """g of the paper's SMESO."""
    return math.copysign(0.6265 * abs(e) ** 0.8433 + 0.5878 * abs(e) ** 1.04078, e)


# --- gains -----------------------------------------------------------------------------------------------------------


def test_the_gains_of_gao_are_those_of_the_literature() -> None:
    assert bandwidth_gains(2, 10.0) == (30.0, 300.0, 1000.0)
    assert adrc_gains(2, 12.0) == (144.0, 24.0)
    assert bandwidth_gains(1, 10.0) == (20.0, 100.0)
    assert adrc_gains(1, 4.0) == (4.0,)


@each_order
def test_gains_put_all_poles_where_they_are_wanted(n: int) -> None:
    assert np.poly([-7.0] * (n + 1)) == pytest.approx([1.0, *bandwidth_gains(n, 7.0)], rel=EXACT)
    assert np.poly([-3.0] * n) == pytest.approx([1.0, *adrc_gains(n, 3.0)[::-1]], rel=EXACT)


@each_order
def test_the_blocks_have_these_gains(n: int) -> None:
    diagram = Diagram("d")
    diagram.add("law", LSEF(order=n, bandwidth=3.0))
    diagram.add("eso", LESO(order=n, bandwidth=7.0, b0=1.0))
    for i in range(1, n + 2):
        diagram.wire(f"law.z{i}", f"eso.z{i}")
    diagram.wire("eso.u", "law.u")
    diagram.input("y")
    diagram.wire("eso.y", "y")
    found = diagram.linearize("y", "law.u")
    wanted = controller(n, adrc_gains(n, 3.0), bandwidth_gains(n, 7.0), 1.0)
    omega = np.geomspace(0.1, 100, 9)
    assert response(found, omega)[0, 0] == pytest.approx(response(wanted.system[0, 1], omega)[0, 0], rel=1e-9)


@each_order
def test_bandwidths_give_the_blocks_exactly_these_gains(n: int) -> None:
    law = resolve(LSEF, {"order": Value(n), "bandwidth": Value(3.7)})
    eso = resolve(LESO, {"order": Value(n), "bandwidth": Value(11.3)})
    assert tuple(law.values["gains"].value) == adrc_gains(n, 3.7)
    assert tuple(eso.values["gains"].value) == bandwidth_gains(n, 11.3)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_diagrams_of_linear_adrc_are_these_controllers(n: int) -> None:
    wc, wo, b0 = 3.7, 21.0, 1.7
    diagram = Diagram("d")
    diagram.add("adrc", subdiagram(FOLDER.parent / "adrc" / f"adrc_{n}.json", b0=b0, omega_c=wc, omega_o=wo))
    for name in ("r", "y"):
        diagram.input(name)
        diagram.wire(f"adrc.{name}", name)
    found = diagram.linearizer().model(["r", "y"], ["adrc.u"])
    made = controller(n, adrc_gains(n, wc), bandwidth_gains(n, wo), b0)
    omega = np.geomspace(1e-3, 1e5, 200)
    drawn = response(found, omega)[0]
    assert drawn == pytest.approx(response(made.system, omega)[0], rel=1e-9)
    assert -drawn[1] == pytest.approx(at(made.feedback, 1j * omega), rel=1e-9)
    assert drawn[0] == pytest.approx(at(made.feedback, 1j * omega) * at(made.prefilter, 1j * omega), rel=1e-9)


@pytest.mark.parametrize("which", [(False, False), (False, True), (True, False), (True, True)], ids=str)
@each_order
def test_the_poles_of_a_tuning_are_those_of_its_nominal_loop(n: int, which: tuple[bool, bool]) -> None:
    gains = half_gain(n, 3.0, 11.0, feedback=which[0], observer=which[1])
    assert len(gains.poles) == 2 * n + 1
    assert np.poly(gains.poles[:n]) == pytest.approx([1.0, *gains.feedback[::-1]], rel=EXACT)
    assert np.poly(gains.poles[n:]) == pytest.approx([1.0, *gains.observer], rel=EXACT)
    of = controller(n, gains.feedback, gains.observer, 1.7).system
    plant, last = np.eye(n, k=1), 1.7 * np.eye(n)[:, -1:]
    whole = np.block([[plant, last @ of.C], [of.B[:, 1:] @ np.eye(n)[:1], of.A]])
    # Coefficients, since eigenvalues of n + 1 equal poles have the (n + 1)-th root of the rounding.
    assert np.poly(whole) == pytest.approx(np.poly(gains.poles), rel=1e-9)


def test_what_pyadrc_halves_makes_y_settle_elsewhere() -> None:
    """pyadrc 0.6.1 with half_gain=(True, ...) has u = (k_1 r - (k_1 z1 + k_2 z2 + z3)/2)/b0, k_1 and k_2 whole.

    At rest z1 = y, z2 = 0, z3 = -b0 u, and y'' + a1 y' + a0 y = b0 u gives a0 y = b0 u: y = 2 k_1 r/(k_1 + a0).
    """
    k1, a0, b0, r = adrc_gains(2, 1.2)[0], 1.0, 1.7, 1.0
    made = half_gain(2, 1.2, 12.0, observer=False)

    def rest(reference: float, law: list[float]) -> float:
        """y of b0 u - reference r + law z = 0 and a0 y - b0 u = 0; unknown: y, u."""
        return float(np.linalg.solve([[law[0], b0 - law[1] * b0], [a0, -b0]], [reference * r, 0.0])[0])

    assert rest(k1, [k1 / 2, 0.5]) == pytest.approx(2 * k1 * r / (k1 + a0), rel=EXACT)
    assert rest(k1, [k1 / 2, 0.5]) == pytest.approx(1.180327869, rel=PRINTED)  # as it simulates
    assert rest(k1, [k1 / 2, 1.0]) == pytest.approx(2 * r, rel=EXACT)  # k_1 whole at r alone
    assert rest(made.feedback[0], [made.feedback[0], 1.0]) == pytest.approx(r, rel=EXACT)


@each_order
def test_halved_gains_have_poles_of_one_real_part(n: int) -> None:
    made = half_gain(n, 3.0, 7.0)
    for gains, w in ((made.feedback[::-1], 3.0), (made.observer, 7.0)):
        found = np.sort_complex(np.roots([1.0, *gains]))
        wanted = np.sort_complex(half_gain_poles(len(gains), w))
        assert np.sort(found.imag) == pytest.approx(np.sort(wanted.imag), abs=1e-9 * w)
        assert found.real == pytest.approx(np.full(len(gains), -w / 2), rel=1e-9)


@pytest.mark.parametrize("m", [1, 2, 3, 4, 5])
def test_halved_gains_are_those_of_the_alpha_controller(m: int) -> None:
    w = 3.0
    A, b = np.eye(m, k=1), np.eye(m)[:, -1:]
    inverse = solve_continuous_lyapunov(A + w / 2 * np.eye(m), 2 * b @ b.T)
    X = np.linalg.inv(inverse)
    assert np.linalg.eigvalsh(inverse).min() > 0
    assert (b.T @ X)[0] == pytest.approx(np.array(adrc_gains(m, w)) / 2, rel=1e-8)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("which", [(False, False), (False, True), (True, False), (True, True)], ids=str)
def test_with_halved_gains_y_still_settles_at_r_under_a_disturbance(n: int, which: tuple[bool, bool]) -> None:
    gains = half_gain(n, 3.0, 12.0, feedback=which[0], observer=which[1])
    b0 = 1.7
    made = controller(n, gains.feedback, gains.observer, b0)
    of = made.system
    # y^(n) = d + b0 u - y - 2 y' - ...: a plant that is not the nominal one.
    a = np.array([math.comb(n, k) for k in range(n)], dtype=float)
    A = np.eye(n, k=1)
    A[-1] -= a
    last, first = np.eye(n)[:, -1:], np.eye(n)[:1]
    whole = np.block([[A, b0 * last @ of.C], [of.B[:, 1:] @ first, of.A]])
    assert np.linalg.eigvals(whole).real.max() < 0
    r, d = 1.0, 5.0
    inputs = np.concatenate([last[:, 0] * (d + b0 * float(of.D[0, 0]) * r), of.B[:, 0] * r])
    rest = np.linalg.solve(whole, -inputs)
    assert rest[0] == pytest.approx(r, rel=1e-10)


def test_halving_the_whole_feedback_but_not_the_reference_misses_r() -> None:
    """As pyadrc 0.6.1 does with half_gain=(True, ...): u = (kp r - (kp z1 + kd z2 + z3)/2)/b0 settles at 1.18 r."""
    kp, kd = adrc_gains(2, 1.2)
    b, b0, A = bandwidth_gains(2, 12.0), 1.7, [[0.0, 1.0], [-1.0, -2.0]]
    of = observer(2, b, b0)
    row = np.array([[kp, kd, 1.0]]) / (2 * b0)
    push = np.array([[0.0], [b0]])
    whole = np.block([[np.array(A), -push @ row], [of.B[:, :1] @ [[1.0, 0.0]], of.A - of.B[:, 1:] @ row]])
    rest = np.linalg.solve(whole, -np.concatenate([push, of.B[:, 1:]])[:, 0] * kp / b0)
    assert rest[0] == pytest.approx(2 * kp / (kp + 1.0), rel=1e-10)
    assert rest[0] == pytest.approx(1.18, abs=5e-3)


@each_order
def test_halving_the_observer_halves_the_gain_of_fast_noise(n: int) -> None:
    omega = 1e6  # so fast that only the leading terms count, to one part in 1e4
    sizes = [
        abs(response(controller(n, g.feedback, g.observer, 1.0).system[0, 1], omega)[0, 0, 0])
        for g in (half_gain(n, 3.0, 12.0, feedback=False, observer=half) for half in (False, True))
    ]
    assert sizes[1] / sizes[0] == pytest.approx(0.5, rel=1e-3)


# --- the observer ----------------------------------------------------------------------------------------------------


@each_observer
def test_the_papers_observers_have_the_figures_of_the_facts(
    gains: tuple[float, ...], poles: tuple[complex, ...], width: float, noise: float
) -> None:
    found = np.roots([1.0, *gains])
    for p in poles:
        assert min(abs(found - p)) < PRINTED * abs(p)
    assert disturbance_bandwidth(gains) == pytest.approx(width, rel=PRINTED)
    assert noise_gain(gains) == pytest.approx(noise, rel=PRINTED)


@each_observer
def test_figures_of_an_observer_have_three_witnesses(
    gains: tuple[float, ...], poles: tuple[complex, ...], width: float, noise: float
) -> None:
    b1, b2, b3 = gains
    assert noise_gain(gains) == pytest.approx(b3 * math.sqrt(b2 / (2 * (b1 * b2 - b3))), rel=EXACT)
    z3 = observer(2, gains, B0)[2, 0]
    assert noise_gain(gains) == pytest.approx(h2(z3), rel=1e-11)
    assert noise_gain(gains) == pytest.approx(float(control.norm(z3, 2)), rel=1e-9)
    estimate = disturbance_estimate(gains)
    assert disturbance_bandwidth(gains) == pytest.approx(bandwidth(estimate), rel=1e-11)

    def above(w: float) -> float:
        return abs(at(estimate, 1j * w)) - math.sqrt(0.5)

    assert disturbance_bandwidth(gains) == pytest.approx(float(brentq(above, 0.1, 50, xtol=1e-13)), rel=1e-11)


@pytest.mark.parametrize("wo", [1e-3, 1.0, 1e4])
@each_order
def test_noise_gains_are_the_integral_of_the_response(n: int, wo: float) -> None:
    # y -> z_{n+1} = wo^(n+1) s^n/(s + wo)^(n+1), and omega = wo x.
    size = quad(lambda x: x ** (2 * n) / (1 + x * x) ** (n + 1), 0, np.inf)[0] / math.pi * wo ** (2 * n + 1)
    assert noise_gain(bandwidth_gains(n, wo)) == pytest.approx(math.sqrt(size), rel=1e-7)
    closed = wo ** (n + 0.5) * math.sqrt(math.comb(2 * n, n) / 2 ** (2 * n + 1))
    assert noise_gain(bandwidth_gains(n, wo)) == pytest.approx(closed, rel=EXACT)


@each_order
def test_the_bandwidth_of_gaos_observer_gives_its_wo_back(n: int) -> None:
    wide = disturbance_bandwidth(bandwidth_gains(n, 25.0))
    assert wide / 25.0 == pytest.approx(math.sqrt(2 ** (1 / (n + 1)) - 1), rel=1e-11)
    assert equivalent_bandwidth(n, wide) == pytest.approx(25.0, rel=1e-11)


def test_the_factor_of_order_two_is_that_of_the_facts() -> None:
    assert 1 / equivalent_bandwidth(2, 1.0) == pytest.approx(0.5098245285, rel=PRINTED)


@each_order
def test_the_observer_has_the_polynomials_of_its_docstring(n: int) -> None:
    b, b0 = [1.0 + 2.0 * k for k in range(1, n + 2)], 1.7
    made = observer(n, b, b0)
    s = 0.3 + 1.1j
    delta = np.polyval([1.0, *b], s)
    whole = made(s)
    for i in range(1, n + 2):
        from_y = np.polyval(b[i - 1 :], s) * s ** (i - 1) / delta
        assert whole[i - 1, 0] == pytest.approx(from_y, rel=EXACT)
        from_u = b0 * (s * np.polyval([1.0, *b[: i - 1]], s) if i <= n else -b[n]) / delta
        assert whole[i - 1, 1] == pytest.approx(from_u, rel=EXACT)


@each_order
def test_an_observer_follows_f_in_any_plant(n: int) -> None:
    """z_{n+1} of y and u with y^(n) = f + b0 u: u cancels, whatever it is."""
    b, b0, s = bandwidth_gains(n, 4.0), 1.7, 0.2 + 2.1j
    whole = observer(n, b, b0)(s)
    f, u = 0.7 - 0.2j, 0.4 + 0.9j
    y = (f + b0 * u) / s**n
    assert whole[n, 0] * y + whole[n, 1] * u == pytest.approx(at(disturbance_estimate(b), s) * f, rel=1e-11)


def test_an_observer_that_is_not_stable_has_no_figures() -> None:
    for call in (disturbance_bandwidth, noise_gain):
        with pytest.raises(AnalysisError, match=r"E705 gains: the observer is not stable: it has the pole"):
            call([1.0, 1.0, 5.0])
        with pytest.raises(AnalysisError, match=r"E705"):
            call([1.0, 1.0, -5.0])


# --- the controller --------------------------------------------------------------------------------------------------


def test_the_controller_of_order_two_is_that_of_the_facts() -> None:
    b1, b2, b3 = LESO_GAINS
    made = controller(2, [KP, KD], LESO_GAINS, B0)
    N = [KP * b1 + KD * b2 + b3, KP * b2 + KD * b3, KP * b3]
    assert made.feedback.num[0][0] == pytest.approx(N, rel=EXACT)
    assert made.feedback.den[0][0] == pytest.approx([B0, B0 * (b1 + KD), B0 * (b2 + KD * b1 + KP), 0.0], rel=EXACT)
    assert made.prefilter.num[0][0] == pytest.approx([KP, KP * b1, KP * b2, KP * b3], rel=EXACT)
    assert made.prefilter.den[0][0] == pytest.approx(N, rel=EXACT)


@pytest.mark.parametrize("halved", [False, True])
@each_order
def test_transfer_functions_and_system_are_the_same(n: int, halved: bool) -> None:
    gains = half_gain(n, 3.0, 11.0, feedback=halved, observer=halved)
    made = controller(n, gains.feedback, gains.observer, -1.7)
    for s in (0.1j, 1.3 + 0.4j, 80j):
        from_r, from_y = made.system(s)[0]
        assert from_y == pytest.approx(-at(made.feedback, s), rel=1e-11)
        assert from_r == pytest.approx(at(made.feedback, s) * at(made.prefilter, s), rel=1e-11)
    assert at(made.prefilter, 0.0) == pytest.approx(1.0, rel=EXACT)


@each_order
def test_poles_of_the_nominal_loop_are_those_of_observer_and_feedback(n: int) -> None:
    k, b = adrc_gains(n, 3.0), bandwidth_gains(n, 11.0)
    made = controller(n, k, b, 1.7)
    den, num = made.feedback.den[0][0], made.feedback.num[0][0]
    whole = np.polyadd(np.polymul(den, [1.0] + [0.0] * n), 1.7 * np.asarray(num))
    wanted = np.polymul([1.0, *b], [1.0, *k[::-1]])
    assert whole / whole[0] == pytest.approx(wanted, rel=EXACT)


def pd(gains: tuple[float, ...]) -> Controller:
    return controller(2, [KP, KD], gains, B0)


@pytest.mark.parametrize(
    ("name", "gains", "wanted"),
    [
        ("leso_pd", LESO_GAINS, (3.041673242, 33.75572796, 14.80974098, 0.03978115, 2.043559704, 1.739486522)),
        ("smeso_gains_pd", SMESO_GAINS, (3.480644231, 40.19235560, 13.83537364, 0.05070257, 1.824165977, 1.479125861)),
    ],
)
def test_the_loop_with_the_motor_has_the_margins_of_the_facts(name: str, gains: tuple[float, ...], wanted: Any) -> None:
    loop = pd(gains).loop(motor())
    made = margins(loop)
    found = (made.gain, made.phase_deg, made.crossover, made.delay, made.Ms, made.Mt)
    assert found[:3] == pytest.approx(wanted[:3], rel=PRINTED)
    assert found[3] == pytest.approx(wanted[3], rel=2e-7)  # it has seven digits
    assert found[4:] == pytest.approx(wanted[4:], rel=PRINTED)
    gain, phase, _, crossover = control.margin(loop)
    assert (gain, phase, crossover) == pytest.approx(wanted[:3], rel=1e-8)
    omega = np.geomspace(0.01, 1e3, 30)
    drawn = Diagram.load(FOLDER / f"{name}.json").linearizer().loop("control.u")
    assert response(drawn, omega)[0, 0] == pytest.approx(response(loop, omega)[0, 0], rel=1e-10)


@pytest.mark.parametrize("name", ["leso_pd", "smeso_gains_pd", "smeso_pd"])
def test_the_diagrams_have_the_papers_motor(name: str) -> None:
    held = {"amplitude": {"eso.e": 0.1}} if name == "smeso_pd" else {}
    plant = Diagram.load(FOLDER / f"{name}.json").linearize("d", "y", openings=["control.u"], **held)
    omega = np.geomspace(0.01, 100, 12)
    assert response(plant, omega)[0, 0] == pytest.approx(response(motor(), omega)[0, 0], rel=1e-10)
    found = np.linalg.eigvals(motor().A)
    assert min(abs(found - (-0.807511699 + 2.420324095j))) < 1e-9
    assert pytest.approx(1.755116752, rel=PRINTED) == B0


@pytest.mark.parametrize("name", ["leso_pd", "smeso_gains_pd"])
def test_the_diagrams_have_the_other_figures_of_the_facts(name: str) -> None:
    wanted = {
        "leso_pd": (5.809135471, 0.14439167, 350.2185917), "smeso_gains_pd": (5.246648132, 0.13124097, 297.7099056)
    }  # fmt: skip
    linearizer = Diagram.load(FOLDER / f"{name}.json").linearizer()
    assert bandwidth(linearizer.model("r", "y")) == pytest.approx(wanted[name][0], rel=PRINTED)
    # d of the facts is a torque on the motor's side of the gear.
    assert N * peak(linearizer.model("tau", "y")).value == pytest.approx(wanted[name][1], rel=5e-8)
    at_input = pd(LESO_GAINS if name == "leso_pd" else SMESO_GAINS).loop(motor())
    omega = np.geomspace(0.1, 100, 9)
    added = response(motor(), omega)[0, 0] / (1 + response(at_input, omega)[0, 0])
    for enters in ("d", "control.u"):
        assert response(linearizer.model(enters, "y"), omega)[0, 0] == pytest.approx(added, rel=1e-9)
    assert peak(linearizer.model("n", "u")).value == pytest.approx(wanted[name][2], rel=PRINTED)


def test_a_plant_with_several_channels_has_no_loop() -> None:
    with pytest.raises(UsageError, match=r"E501 plant: has 2 inputs and 1 outputs"):
        pd(LESO_GAINS).loop(control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))


# --- sampling --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gains", [LESO_GAINS, SMESO_GAINS])
def test_euler_steps_are_stable_just_below_the_limit_and_not_above(gains: tuple[float, ...]) -> None:
    A = np.asarray(observer(2, gains, B0).A)
    limit = sampling_limits(np.linalg.eigvals(A)).euler
    sizes = [np.abs(np.linalg.eigvals(np.eye(3) + q * limit * A)).max() for q in (0.9999, 1.0, 1.0001)]
    assert sizes[0] < 1 < sizes[2]
    assert sizes[1] == pytest.approx(1.0, abs=1e-12)


def test_the_usual_periods_are_a_twentieth_to_a_fortieth_of_that_of_the_bandwidth() -> None:
    made = sampling_limits([-1.0, -3.0], bandwidth=2 * math.pi)
    assert made.usual == pytest.approx((0.025, 0.05), rel=EXACT)
    late = sampling_limits([-1.0, -3.0], bandwidth=2 * math.pi, delay=0.09)
    assert late.usual == pytest.approx((0.025, 0.03), rel=EXACT)
    assert late.euler == made.euler
    assert made.euler == pytest.approx(2 / 3, rel=EXACT)
    with pytest.raises(AnalysisError, match="E705 poles: the pole 1"):
        sampling_limits([-1.0, 1.0])


def test_euler_steps_of_the_smeso_end_in_the_cycle_of_the_facts() -> None:
    (cycle,) = euler_cycles(SMESO_GAINS, sliding, 0.01)
    assert cycle.amplitude == pytest.approx(2.327059878e-07, rel=5e-10)
    assert cycle.stable


def iterated(gains: tuple[float, ...], law: Callable[[float], float], period: float, steps: int, e: float) -> float:
    """|e| after so many Euler steps, at y = u = 0."""
    z = [-e] + [0.0] * (len(gains) - 1)
    for _ in range(steps):
        g = law(-z[0])
        z = [a + period * (b + gain * g) for a, b, gain in zip(z, [*z[1:], 0.0], gains, strict=True)]
    return abs(z[0])


@pytest.mark.parametrize("period", [0.002, 0.01, 0.03])
def test_iterated_euler_steps_end_in_the_cycle(period: float) -> None:
    (cycle,) = euler_cycles(SMESO_GAINS, sliding, period)
    assert cycle.stable
    steps = math.ceil(math.log(1e-13) / math.log(max(map(abs, cycle.multipliers))))
    assert iterated(SMESO_GAINS, sliding, period, 3 * steps, 1e-3) == pytest.approx(cycle.amplitude, rel=1e-10)


@each_order
def test_the_cycle_satisfies_the_steps_of_any_order(n: int) -> None:
    gains, Ts = bandwidth_gains(n, 20.0), 0.01
    (cycle,) = euler_cycles(gains, sliding, Ts)
    A0, L = np.eye(n + 1, k=1), np.array(gains)
    z = np.linalg.solve(2 * np.eye(n + 1) + Ts * A0, -Ts * L * sliding(cycle.amplitude))
    assert -z[0] == pytest.approx(cycle.amplitude, rel=1e-11)
    after = z + Ts * (A0 @ z + L * sliding(-z[0]))
    assert after == pytest.approx(-z, rel=1e-9)


def test_a_linear_law_has_no_cycle_below_its_limit() -> None:
    assert euler_cycles(SMESO_GAINS, lambda e: e, 0.01) == ()


def test_where_linear_steps_flip_the_cycles_gain_is_one() -> None:
    b = (20.0, 10.0)  # real poles, far from each other: the fast one is the first at z = -1
    limit = sampling_limits(np.roots([1.0, *b])).euler

    def gain_of_steps(period: float) -> float:
        return sum(-((-period / 2) ** k) * gain for k, gain in enumerate(b, 1))

    assert gain_of_steps(limit) == pytest.approx(1.0, rel=EXACT)
    (cycle,) = euler_cycles(b, math.tanh, 1.5 * limit)
    assert math.tanh(cycle.amplitude) / cycle.amplitude == pytest.approx(1 / gain_of_steps(1.5 * limit), rel=1e-11)


def test_the_cycle_of_the_formula_is_that_of_the_sampled_diagram() -> None:
    from blocks import DiscreteSMESO
    from blocks.analysis import limit_cycles

    diagram = Diagram.alone(DiscreteSMESO(gains=list(SMESO_GAINS), period=0.01, form="euler"))
    found = [cycle for cycle in limit_cycles(diagram) if cycle.kind == "two periods"]
    assert len(found) == 1
    assert next(iter(found[0].amplitudes.values())) == pytest.approx(2.327059878e-07, rel=5e-10)


# --- what cannot be meant --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: bandwidth_gains(0, 1.0), "E501 n: must be an order, 1, 2, 3, ..., not 0"),
        (lambda: adrc_gains(1.5, 1.0), "E501 n: must be an order, 1, 2, 3, ..., not 1.5"),  # type: ignore[arg-type]
        (lambda: adrc_gains(math.nan, 1.0), "E501 n: must be an order, 1, 2, 3, ..., not nan"),  # type: ignore[arg-type]
        (lambda: adrc_gains("2", 1.0), "E501 n: must be an order, 1, 2, 3, ..., not '2'"),  # type: ignore[arg-type]
        (
            lambda: bandwidth_gains(2, 1e200),
            "E501 wo: 1e+200 overflows a double, or vanishes, when raised to the power 3",
        ),
        (lambda: adrc_gains(2, 1e-200), "E501 wc: 1e-200 overflows a double, or vanishes, when raised to the power 2"),
        (lambda: equivalent_bandwidth(2, None), "E501 w3db: must be above 0, not None"),  # type: ignore[arg-type]
        (lambda: noise_gain("abc"), "E501 gains: must be finite numbers in one row"),  # type: ignore[arg-type]
        (lambda: controller(1, [0.0], [0.0, 0.0], 1.0), "E501 controller: all gains are 0"),
        (lambda: observer(1, [1.0, 1.0], "b0"), "E501 b0: must be a finite gain other than 0, not 'b0'"),  # type: ignore[arg-type]
        (lambda: sampling_limits(["a"]), "E501 poles: must be finite numbers"),  # type: ignore[list-item]
        (lambda: bandwidth_gains(2, -1.0), "E501 wo: must be above 0, not -1.0"),
        (lambda: adrc_gains(2, math.nan), "E501 wc: must be above 0, not nan"),
        (lambda: controller(2, [1.0], [1.0, 1.0, 1.0], 1.0), "E501 feedback: has 1 values, but 2 are needed"),
        (lambda: controller(2, [1.0, 1.0], [1.0, 1.0], 1.0), "E501 observer: has 2 values, but 3 are needed"),
        (lambda: observer(1, [1.0, 1.0], 0.0), "E501 b0: must be a finite gain other than 0, not 0.0"),
        (lambda: observer(1, [1.0, math.inf], 1.0), "E501 gains: must be finite numbers in one row"),
        (lambda: sampling_limits([]), "E501 poles: must be finite numbers"),
        (lambda: euler_cycles([1.0], math.tanh, 0.0), "E501 period: must be above 0, not 0.0"),
        (lambda: euler_cycles([1.0], lambda e: math.nan, 1.0), "E501 law: is not finite"),
        (
            lambda: euler_cycles([1.0], math.tanh, 1.0, amplitude=(1.0, 1.0)),
            "E501 amplitude: the lower limit 1 must lie below the upper limit 1",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(call: Callable[[], Any], text: str) -> None:
    with pytest.raises(UsageError) as caught:
        call()
    assert text in str(caught.value)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
@pytest.mark.parametrize("band", [0.02, 0.05])
def test_a_bandwidth_for_a_settling_time_is_that_of_the_step_response(n: int, band: float) -> None:
    wc = settling_bandwidth(n, 2.0, band)
    assert settling_time(n, wc, band) == pytest.approx(2.0, rel=1e-14)
    poles = control.tf([wc**n], np.poly([-wc] * n))
    t, y = control.step_response(poles, np.linspace(0.0, 4.0, 4001))
    assert np.abs(y[t > 2.001] - 1).max() < band < np.abs(y[t < 1.999] - 1)[-1]
    assert settling_bandwidth(1, 2.0, band) == pytest.approx(-np.log(band) / 2.0, rel=1e-14)


@pytest.mark.parametrize("given", [(0, 1.0, 0.02), (1, 0.0, 0.02), (1, 1.0, 0.0), (1, 1.0, 1.0), (1, 1.0, "x")])
def test_a_settling_time_that_cannot_be_is_refused(given: tuple[Any, Any, Any]) -> None:
    with pytest.raises(UsageError) as refused:
        settling_bandwidth(*given)
    assert refused.value.code == "E501"
