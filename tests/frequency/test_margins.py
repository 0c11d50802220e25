"""Margins against the facts, closed forms and closed-loop eigenvalues; and where python-control 0.10.2 is wrong."""

from __future__ import annotations

import itertools
import json
import math
import warnings
from typing import Any

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from blocks.frequency.margins import Margins, margins
from blocks.frequency.response import bandwidth, hinf
from blocks.text.errors import AnalysisError, UsageError
from tests.support.marks import long_but

# Digits printed in the facts: nine or ten, so half a unit of the last.
PRINTED = 1e-9
# Roots are found to the last digits of a response of a few states.
ROOT = 1e-11

KP, KD = 144.6642, 25.5574
LESO = (30.4, 523.4, 2970.8)
SMESO = (30.4, 513.4, 1570.8)
# The motor of the paper.
RA, LA, KB, KT, N, JEQ, BEQ = 0.1557, 0.82, 1.185, 1.1882, 3.0, 0.2752, 0.3922
B0 = KT / (LA * JEQ * N)
FACTS = {
    LESO: {
        "gain": 3.041673242, "phase_deg": 33.75572796, "crossover": 14.80974098, "delay": 0.03978115,
        "Ms": 2.043559704, "Mt": 1.739486522, "r_to_y": 5.809135471, "d_to_y": 0.14439167, "n_to_u": 350.2185917,
    },
    SMESO: {
        "gain": 3.480644231, "phase_deg": 40.19235560, "crossover": 13.83537364, "delay": 0.05070257,
        "Ms": 1.824165977, "Mt": 1.479125861, "r_to_y": 5.246648132, "d_to_y": 0.13124097, "n_to_u": 297.7099056,
    },
}  # fmt: skip


def motor() -> Any:
    """v, and the torque at the armature (tau/n) -> omega."""
    a = [[-BEQ / JEQ, KT / (JEQ * N)], [-KB * N / LA, -RA / LA]]
    return control.ss(a, [[0.0, -1 / (JEQ * N)], [1 / LA, 0.0]], [[1.0, 0.0]], [[0.0, 0.0]])


def observer_and_law(gains: tuple[float, float, float]) -> tuple[Any, Any, Any]:
    """z' = A z + B u + L y and u = (kp r - K z)/b0: A, B, L as arrays, and K/b0."""
    b1, b2, b3 = gains
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    l = np.array([[b1], [b2], [b3]])
    return a - l @ np.array([[1.0, 0.0, 0.0]]), np.array([[0.0], [B0], [0.0]]), l


LAW = np.array([[KP, KD, 1.0]]) / B0


def feedback_part(gains: tuple[float, float, float]) -> Any:
    """C_fb: -y -> u."""
    a, b, l = observer_and_law(gains)
    return control.ss(a - b @ LAW, l, LAW, 0)


def loop(gains: tuple[float, float, float] = LESO) -> Any:
    return motor()[0, 0] * feedback_part(gains)


def closed(gains: tuple[float, float, float]) -> Any:
    """r, d, n -> y, u."""
    plant = motor()
    a, b, l = observer_and_law(gains)
    whole = np.block([[plant.A, -plant.B[:, :1] @ LAW], [l @ plant.C, a - b @ LAW]])
    reference = KP / B0
    inputs = np.block(
        [
            [plant.B[:, :1] * reference, plant.B[:, 1:], np.zeros((2, 1))],
            [b * reference, np.zeros((3, 1)), l],
        ]
    )
    outputs = np.block([[plant.C, np.zeros((1, 3))], [np.zeros((1, 2)), -LAW]])
    return control.ss(whole, inputs, outputs, [[0.0, 0.0, 0.0], [reference, 0.0, 0.0]])


def border_gain(system: Any, low: float, high: float) -> float:
    """The gain between low and high at which the closed loop loses stability, by eigenvalues alone."""

    def growth(k: float) -> float:
        p = np.linalg.eigvals(system.A - k * system.B @ system.C / (1 + k * system.D[0, 0]))
        return float(np.max(np.abs(p)) - 1 if system.dt else np.max(p.real))

    return float(brentq(growth, low, high, xtol=1e-14, rtol=1e-14))


def theirs(system: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return control.stability_margins(system)


# The facts


@pytest.mark.parametrize("gains", [LESO, SMESO])
def test_margins_of_the_motors_loops_are_those_of_the_facts(gains: Any) -> None:
    found, facts = margins(loop(gains)), FACTS[gains]
    assert found.stable is True
    for name in ("gain", "phase_deg", "crossover", "Ms", "Mt"):
        assert getattr(found, name) == pytest.approx(facts[name], rel=PRINTED), name
    assert found.delay == pytest.approx(facts["delay"], abs=5e-9)
    assert found.delay == pytest.approx(math.radians(facts["phase_deg"]) / facts["crossover"], rel=PRINTED)
    assert found.gain_low is None
    assert found.modulus == pytest.approx(1 / facts["Ms"], rel=PRINTED)


@pytest.mark.parametrize("gains", [LESO, SMESO])
def test_closed_loop_figures_are_those_of_the_facts(gains: Any) -> None:
    system, facts = closed(gains), FACTS[gains]
    assert bandwidth(system[0, 0]) == pytest.approx(facts["r_to_y"], rel=PRINTED)
    assert hinf(system[0, 1]).value == pytest.approx(facts["d_to_y"], abs=5e-9)
    assert hinf(system[1, 2]).value == pytest.approx(facts["n_to_u"], rel=PRINTED)


@pytest.mark.parametrize("gains", [LESO, SMESO])
def test_margins_agree_with_eigenvalues_and_with_python_control(gains: Any) -> None:
    system = loop(gains)
    found = margins(system)
    assert found.gain == pytest.approx(border_gain(system, 2.0, 5.0), rel=ROOT)
    gain, phase, modulus, at_gain, at_phase, at_modulus = theirs(system)
    assert (found.gain, found.phase_deg, found.modulus) == pytest.approx((gain, phase, modulus), rel=1e-9)
    assert (found.gain_frequency, found.crossover) == pytest.approx((at_gain, at_phase), rel=1e-9)
    assert found.Ms_frequency == pytest.approx(at_modulus, rel=1e-7)
    by_polynomials = margins(control.ss2tf(system)).as_json()
    for name, value in found.as_json().items():
        assert value == (by_polynomials[name] if value is None else pytest.approx(by_polynomials[name], rel=1e-8))


@pytest.mark.parametrize("seed", range(60))
def test_margins_have_the_names_of_python_control(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states, gain, sign = int(rng.integers(1, 5)), 10.0 ** rng.uniform(-1, 1.5), rng.choice([1.0, -1.0])
    A, B, C = rng.normal(size=(states, states)), rng.normal(size=(states, 1)), rng.normal(size=(1, states))
    system = sign * gain * control.ss(A - (0.1 + np.max(np.linalg.eigvals(A).real)) * np.eye(states), B, C, 0)
    found = margins(system)
    gm, pm, sm, at_gain, at_phase, at_modulus = control.stability_margins(system)
    if gm > 1e8:  # rounding of its polynomials makes a crossing far above the loop
        gm, at_gain = math.inf, math.nan
    ours = (found.gm, found.pm, found.wcg, found.wcp)
    assert ours == pytest.approx((gm, pm, at_gain, at_phase), rel=1e-4, nan_ok=True)
    # It looks for the least distance between 0 and infinity, but not there.
    if 0 < found.wms < math.inf:
        assert (found.sm, found.wms) == pytest.approx((sm, at_modulus), rel=1e-4)
    else:
        assert found.sm <= sm


def test_a_loop_without_margins_has_those_of_python_control() -> None:
    found = margins(control.ss(control.tf([0.5], [1.0, 1.0])))
    theirs = control.margin(control.tf([0.5], [1.0, 1.0]))
    assert (found.gm, found.pm, found.wcg, found.wcp) == pytest.approx(theirs, nan_ok=True)
    assert found.gain is None


def test_every_distance_is_where_it_says() -> None:
    system = loop()
    found = margins(system)

    def at(omega: float | None) -> complex:
        assert omega is not None
        return complex(system(1j * omega))

    assert found.gain is not None
    assert found.phase_deg is not None
    assert found.delay is not None
    assert found.delay_frequency is not None
    assert found.gain * at(found.gain_frequency) == pytest.approx(-1, abs=ROOT)
    assert at(found.crossover) * np.exp(-1j * math.radians(found.phase_deg)) == pytest.approx(-1, abs=ROOT)
    assert at(found.delay_frequency) * np.exp(-1j * found.delay * found.delay_frequency) == pytest.approx(-1, abs=ROOT)
    assert abs(1 + at(found.Ms_frequency)) == pytest.approx(found.modulus, rel=1e-13)
    omega = np.geomspace(0.1, 1e3, 20_001)
    values = np.asarray(system(1j * omega))
    # Between the points of so fine a grid a peak exceeds by less than 1e-6.
    assert found.Ms == pytest.approx(np.max(np.abs(1 / (1 + values))), rel=1e-6)
    assert found.Mt == pytest.approx(np.max(np.abs(values / (1 + values))), rel=1e-6)
    assert found.disk == pytest.approx(2 / np.max(np.abs((1 - values) / (1 + values))), rel=1e-6)
    assert found.bandwidth is not None
    total = at(found.bandwidth) / (1 + at(found.bandwidth))
    assert abs(total) == pytest.approx(math.sqrt(0.5), rel=ROOT)


def test_the_loop_bears_every_factor_within_its_disk() -> None:
    """On the disk's border there is one factor that the closed loop does not bear; and alpha gives it exactly."""
    system = loop()
    found = margins(system)
    value = complex(system(1j * found.disk_frequency))
    worst = -1 / value
    delta = (worst - 1) / (worst + 1)  # worst = (1 + delta)/(1 - delta)
    assert 2 * abs(delta) == pytest.approx(found.disk, rel=1e-12)
    assert found.disk_gain == pytest.approx((1 + found.disk / 2) / (1 - found.disk / 2))
    assert math.tan(math.radians(found.disk_phase_deg) / 2) == pytest.approx(found.disk / 2)
    assert found.gain is not None
    assert found.phase_deg is not None
    assert found.disk_gain < found.gain
    assert found.disk_phase_deg < found.phase_deg


# Where python-control 0.10.2 is wrong


@pytest.mark.parametrize(("gains", "expected"), [(LESO, 3.0299095281), (SMESO, 3.4660426093)])
def test_margins_of_loops_that_are_sampled_fast_and_python_control_has_noise(gains: Any, expected: float) -> None:
    """Ts = 1e-4: held motor, explicit Euler observer. Their figures, of z-polynomials, are rounding noise."""
    period = 1e-4
    part = feedback_part(gains)
    sampled = control.ss(np.eye(3) + period * part.A, period * part.B, part.C, 0, period)
    system = control.c2d(motor()[0, 0], period) * sampled
    found = margins(system)
    assert found.stable is True
    assert found.gain == pytest.approx(expected, rel=1e-9)
    # Eigenvalues of the closed loop change by 1e-5 for a relative change of the gain of 1: eps/1e-5 remains.
    assert found.gain == pytest.approx(border_gain(system, 2.0, 5.0), rel=1e-9)
    wrong = theirs(system)
    # Noise may hit one of them by chance.
    assert found.phase_deg is not None
    assert (
        max(abs(wrong[0] / expected - 1), abs(wrong[2] / found.modulus - 1), abs(wrong[1] / found.phase_deg - 1)) > 0.01
    )


def test_both_gain_margins_are_given_and_python_control_hides_the_lower_one() -> None:
    system = control.ss(control.tf([12, 12], [1, -1, 0]) * control.tf([1], [0.05, 1]) * control.tf([1], [0.05, 1]))
    found = margins(system)
    assert found.stable is True
    assert control.margin(system)[0] == pytest.approx(found.gain, rel=1e-9)
    assert found.gain_low == pytest.approx(border_gain(system, 0.01, 0.9), rel=1e-9)
    assert found.gain == pytest.approx(border_gain(system, 1.1, 20.0), rel=1e-9)
    assert [factor for factor, _ in found.gains] == [found.gain_low, found.gain]


def test_an_integrator_that_rounds_to_the_right_is_stable_and_python_control_counts_minus_one() -> None:
    system = control.ss([[1.5e-16, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert control.nyquist_response(system).count == -1
    found = margins(system)
    assert found.stable is True
    assert np.all(np.roots([1, 1, 1]).real < 0)  # s^2 + s + 1
    # |L| = 1 where w^2 (1 + w^2) = 1
    assert found.crossover == pytest.approx(math.sqrt((math.sqrt(5) - 1) / 2), rel=1e-12)


def test_a_disk_margin_does_not_depend_on_a_grid_and_python_controls_does() -> None:
    system = loop()
    coarse = control.disk_margins(system, np.array([1.0, 10.0, 30.0, 100.0]))[0]
    fine = control.disk_margins(system, np.linspace(17.8, 17.9, 1001))[0]
    found = margins(system)
    assert coarse > 1.2 * fine
    assert found.disk == pytest.approx(fine, rel=1e-8)


# Closed forms


def test_the_margins_of_three_lags() -> None:
    """k/(s + 1)^3: the phase is -180 degrees at sqrt(3), where the gain is k/8."""
    found = margins(control.tf([4], [1, 3, 3, 1]))
    assert found.gain == pytest.approx(2.0, rel=1e-12)
    assert found.gain_frequency == pytest.approx(math.sqrt(3), rel=1e-12)
    crossover = math.sqrt(4 ** (2 / 3) - 1)
    assert found.crossover == pytest.approx(crossover, rel=1e-12)
    assert found.phase_deg == pytest.approx(180 - 3 * math.degrees(math.atan(crossover)), rel=1e-11)


def test_an_integrator_of_any_gain_has_its_crossover() -> None:
    for k in (1e-9, 1.0, 3e7):
        found = margins(control.tf([k], [1, 0]))
        assert found.crossover == pytest.approx(k, rel=1e-12)
        assert found.phase_deg == pytest.approx(90.0, rel=1e-12)
        assert found.delay == pytest.approx(math.pi / 2 / k, rel=1e-12)
        assert (found.gain, found.gain_low, found.Ms) == (None, None, pytest.approx(1.0))
        assert found.disk == pytest.approx(2.0)
        assert found.disk_gain > 1e9


def test_a_double_integrator_with_lead() -> None:
    """(s + a)/s^2: |L| = 1 where w^4 = w^2 + a^2; the phase margin is atan(w/a). No gain leads to the border."""
    a = 0.25
    for system in (control.tf([1, a], [1, 0, 0]), control.ss([[0, 1], [0, 0]], [[0], [1.0]], [[a, 1.0]], 0)):
        found = margins(system)
        omega = math.sqrt((1 + math.sqrt(1 + 4 * a * a)) / 2)
        assert found.crossover == pytest.approx(omega, rel=1e-12)
        assert found.phase_deg == pytest.approx(math.degrees(math.atan(omega / a)), rel=1e-12)
        assert (found.stable, found.gain, found.gain_low) == (True, None, None)


def test_gain_margins_at_zero_and_at_infinite_frequency() -> None:
    at_zero = margins(control.ss([[-1.0]], [[1.0]], [[-0.5]], 0))
    assert at_zero.gains == ((pytest.approx(2.0), 0.0),)
    assert at_zero.stable is True
    at_infinity = margins(control.tf([-0.5, 0], [1, 1]))
    assert at_infinity.gains == ((2.0, math.inf),)


def test_a_sampled_loop_loses_stability_at_the_nyquist_frequency() -> None:
    """L = k/(z - p): the pole p - k leaves the circle at -1 for k = 1 + p."""
    for k in (0.5, 2.5):
        found = margins(control.ss([[0.5]], [[1.0]], [[k]], 0, 0.1))
        assert found.gains == ((pytest.approx(1.5 / k, rel=1e-14), pytest.approx(math.pi / 0.1)),)
        assert found.stable is (k < 1.5)
        assert (found.gain is None) is (k > 1.5)
        assert found.Ms == pytest.approx(abs(1.5 / (1.5 - k)) if k < 1 else max(1.5 / (k - 1.5), 1.0), rel=1e-12)


def test_the_delay_margin_of_a_sampled_loop_is_in_seconds() -> None:
    period = 0.01
    found = margins(control.ss([[1.0]], [[1.0]], [[1.0 * period]], 0, period))
    # |e^(j w T) - 1| = T: 2 sin(w T/2) = T
    crossover = 2 * math.asin(period / 2) / period
    assert found.crossover == pytest.approx(crossover, rel=1e-12)
    assert found.delay == pytest.approx((math.pi / 2 - crossover * period / 2) / crossover, rel=1e-11)


def test_a_loop_that_stays_above_0_db_bears_no_delay() -> None:
    found = margins(control.ss([[-1.0]], [[1.0]], [[1.0]], [[2.0]]))
    assert (found.delay, found.phase_deg, found.stable) == (0.0, None, True)


def test_crossings_that_touch_are_found() -> None:
    """A resonance whose top is 0 dB exactly, and a phase that touches -180 degrees."""
    damping = 0.1
    top = 2 * damping * math.sqrt(1 - damping**2)
    found = margins(control.ss([[0, 1.0], [-1.0, -2 * damping]], [[0.0], [top]], [[1.0, 0.0]], 0))
    assert len(found.phases) == 1
    # A touch is as wide as sqrt(eps).
    assert found.crossover == pytest.approx(math.sqrt(1 - 2 * damping**2), rel=1e-7)
    # (1 - w^2)^2: the imaginary part of L = (s^2 + 1)^2/(s (s + 1)^4 ...) has a double root at 1 where L is negative.
    w = np.array([1.0])
    num = np.polymul([1.0, 0.0, 1.0], [1.0, 0.0, 1.0])
    real = np.polyadd(np.poly([-2.0, -2.0, -2.0, -2.0]) * -0.1, num)  # -0.1 + (s^2 + 1)^2/(s + 2)^4
    system = control.tf(real, np.poly([-2.0, -2.0, -2.0, -2.0]))
    assert complex(system(1j * w[0])) == pytest.approx(-0.1)
    touching = [frequency for factor, frequency in margins(system).gains if factor == pytest.approx(10.0, rel=1e-6)]
    assert len(touching) >= 1


def test_two_crossings_between_neighbors_of_the_grid_are_both_found() -> None:
    damping = 1e-3
    top = 2 * damping * math.sqrt(1 - damping**2) * (1 + 1e-9)
    found = margins(control.ss([[0, 1.0], [-1.0, -2 * damping]], [[0.0], [top]], [[1.0, 0.0]], 0))
    assert len(found.phases) == 2
    first, second = (frequency for _, frequency in found.phases)
    assert 0 < second - first < 1e-6


def test_all_crossings_of_a_conditionally_stable_loop_are_there() -> None:
    """A type-3 loop with two zeros: below one gain and above another it is unstable."""
    system = control.tf(10 * np.poly([-1.0, -1.0]), np.polymul([1, 0, 0, 0], np.poly([-20.0, -30.0]) / 600))
    found = margins(system)
    state = control.ss(system)
    assert len(found.gains) == 2
    assert found.stable is True
    assert found.gain_low == pytest.approx(border_gain(state, 1e-3, 0.5), rel=1e-8)
    assert found.gain == pytest.approx(border_gain(state, 1.5, 1e3), rel=1e-8)


def test_poles_on_the_axis_are_no_crossing() -> None:
    """k (s + 1)/(s (s^2 + 1)): the phase jumps from -45 to -225 degrees at 1, through -180 without a margin."""
    found = margins(control.tf([0.1, 0.01], [1, 0, 1]))
    assert found.stable is True
    assert found.gains == ()
    assert len(found.phases) == 2
    undamped = margins(control.ss([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0))
    assert undamped.stable is False
    assert undamped.modulus == pytest.approx(0.0, abs=1e-12)


def test_a_lightly_damped_resonance_is_not_missed() -> None:
    damping, k = 1e-7, 1e-6
    system = control.tf([k], [1, 2 * damping, 1]) * control.tf([1], [1, 1])
    found = margins(system)
    assert found.stable is False
    # Routh: s^3 + (1 + 2 d) s^2 + (1 + 2 d) s + 1 + k is at the border for (1 + 2 d)^2 = 1 + k.
    assert found.gain_low == pytest.approx(((1 + 2 * damping) ** 2 - 1) / k, rel=1e-7)


# Stability first


def test_an_unstable_loop_says_so_first() -> None:
    found = margins(control.tf([10], [1, 3, 3, 1]))
    assert found.stable is False
    assert found.gain is None
    assert found.gain_low == pytest.approx(0.8)
    assert len(found.unstable) == 2
    expected = max(np.roots([1, 3, 3, 11]), key=lambda p: p.real)
    assert found.unstable[0].real == pytest.approx(expected.real)
    first, *_ = str(found).splitlines()
    assert first.startswith("closed loop     UNSTABLE (0.077217")
    assert first.endswith("the values below are distances to the border of stability, not margins")


def test_what_lies_beside_the_loop_does_not_count_unless_it_grows() -> None:
    """An integrator behind the output (a heading) is named; an unstable mode there makes the diagram unstable."""
    for pole, stable, hidden in ((0.0, True, 1), (-0.1, True, 0), (0.1, False, 0)):
        system = control.ss([[-1.0, 0.0], [1.0, pole]], [[1.0], [0.0]], [[2.0, 0.0]], 0)
        found = margins(system)
        assert (found.stable, len(found.hidden)) == (stable, hidden)
        assert found.phase_deg == pytest.approx(120.0)
    # Two wheels' angles of which only the difference is fed back: no zero in A, B, C tells it.
    a = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, -1.0, -1.0]])
    wheels = margins(control.ss(a, [[1.0], [-1.0], [0.0]], [[0.0, 0.0, 1.0]], 0))
    assert wheels.stable is True
    assert wheels.hidden == (pytest.approx(0.0, abs=1e-12),)
    assert "beside the loop, on the border" in str(wheels)


def test_a_slow_unstable_pole_among_fast_ones_is_seen() -> None:
    for slow, stable in ((1e-4, False), (-1e-4, True)):
        system = control.ss([[-1e8, 0.0], [1.0, slow]], [[1e8], [0.0]], [[0.0, 1e-9]], 0)
        assert margins(system).stable is stable


def test_a_loop_without_a_solution_at_infinite_frequency_is_refused() -> None:
    for system in (control.ss([[-1.0]], [[1.0]], [[1.0]], [[-1.0]]), control.tf([-1, 3], [1, 1])):
        with pytest.raises(AnalysisError, match=r"E705 margins: 1 \+ L vanishes at infinite frequency"):
            margins(system)


def test_a_loop_has_one_input_and_one_output() -> None:
    with pytest.raises(UsageError, match="E501 margins: 1 outputs and 2 inputs"):
        margins(motor())
    with pytest.raises(UsageError, match="positive numbers"):
        margins(loop(), grid=[0.0, 1.0])
    with pytest.raises(AnalysisError, match="zero or infinite at all frequencies"):
        margins(control.ss([], [], [], [[0.0]]))


# Measured data and delays


def test_measured_data_have_margins_by_interpolation() -> None:
    system = loop()
    exact = margins(system)
    data = control.frd(system, np.geomspace(0.01, 1e4, 1500))
    found = margins(data, unstable_poles=0, integrators=1)
    assert found.stable is True
    for name in ("gain", "phase_deg", "crossover", "delay", "Ms", "Mt", "disk"):
        # Cubics between points that are 1 % apart.
        assert getattr(found, name) == pytest.approx(getattr(exact, name), rel=1e-5), name
    assert margins(data).stable is None
    assert "stability unknown" in str(margins(data))


def test_encirclements_tell_stability_of_measured_data() -> None:
    omega = np.geomspace(1e-3, 1e3, 800)
    for system, unstable, integrators in (
        (control.tf([4], [1, 3, 3, 1]), 0, 0),
        (control.tf([10], [1, 3, 3, 1]), 0, 0),
        (control.tf([3, 3], [1, -1, 0]), 1, 1),
        (control.tf([0.5, 0.5], [1, -1, 0]), 1, 1),
    ):
        found = margins(control.frd(system, omega), unstable_poles=unstable, integrators=integrators)
        assert found.stable is margins(system).stable
    sampled = control.ss([[1.2]], [[1.0]], [[0.5]], 0, 0.1)
    data = control.frd(
        control.frd(sampled, np.linspace(1e-3, math.pi / 0.1, 400)).frdata[0, 0],
        np.linspace(1e-3, math.pi / 0.1, 400),
        0.1,
    )
    assert margins(data, unstable_poles=1).stable is margins(sampled).stable is True
    assert margins(data, unstable_poles=0).stable is False


class Delayed:
    """k e^(-s T)/s, of which no state space exists."""

    dt = 0

    def __init__(self, k: float, delay: float) -> None:
        self.k, self.delay = k, delay

    def response(self, omega: Any) -> Any:
        with np.errstate(all="ignore"):
            return self.k * np.exp(-1j * omega * self.delay) / (1j * omega)


def test_an_exact_delay_has_its_margins() -> None:
    k, delay = 2.0, 0.3
    found = margins(Delayed(k, delay), unstable_poles=0, integrators=1)
    assert found.gain == pytest.approx(math.pi / (2 * delay * k), rel=1e-12)
    assert found.crossover == pytest.approx(k, rel=1e-12)
    assert found.phase_deg == pytest.approx(90 - math.degrees(k * delay), rel=1e-12)
    assert found.delay == pytest.approx(math.pi / (2 * k) - delay, rel=1e-12)
    assert found.stable is True
    assert margins(Delayed(2 * math.pi, delay), unstable_poles=0, integrators=1).stable is False


# What is printed


def test_the_json_has_these_keys_and_no_infinity() -> None:
    keys = ["gain", "gain_low", "phase_deg", "crossover", "delay", "modulus", "Ms", "Mt", "disk", "bandwidth"]
    keys += ["stable", "border"]
    for system in (loop(), control.tf([1], [1, 0]), control.ss([[-1.0]], [[1.0]], [[0.5]], 0)):
        shown = margins(system).as_json()
        assert list(shown) == keys
        assert json.loads(json.dumps(shown, allow_nan=False)) == shown
    assert margins(control.ss([[-1.0]], [[1.0]], [[0.5]], 0)).as_json()["phase_deg"] is None


def test_the_table_is_readable() -> None:
    assert str(margins(loop())).splitlines() == [
        "closed loop     stable",
        "gain margin     3.0417 (9.662 dB) at 33.506 rad/s",
        "phase margin    33.756 deg at 14.81 rad/s",
        "delay margin    0.039781 s at 14.81 rad/s",
        "modulus margin  0.48934 at 20.364 rad/s",
        "Ms              2.0436 (6.208 dB) at 20.364 rad/s",
        "Mt              1.7395 (4.808 dB) at 13.294 rad/s",
        "disk margin     0.58043 at 17.862 rad/s: gain x or / 1.8178 and phase +-32.367 deg together",
        "bandwidth of T  29.039 rad/s",
    ]


def test_margins_are_values() -> None:
    found = margins(loop())
    assert isinstance(found, Margins)
    assert found == margins(loop())
    assert hash(found) == hash(margins(loop()))


# Nothing is missed


def unstable_count(system: Any, k: float) -> int:
    p = np.linalg.eigvals(system.A - k * system.B @ system.C / (1 + k * system.D[0, 0]))
    return int(np.sum(np.abs(p) > 1)) if system.dt else int(np.sum(p.real > 0))


@pytest.mark.parametrize("seed", range(40))
def test_between_two_gain_crossings_no_pole_crosses_the_border(seed: int) -> None:
    """The eigenvalues of the closed loop, over all gains, are the witness that the list is complete."""
    random = np.random.default_rng(seed)
    order, period = int(random.integers(1, 7)), 0.1 * (seed % 2)
    a = random.normal(size=(order, order))
    if period:
        a *= random.uniform(0.3, 1.3) / np.max(np.abs(np.linalg.eigvals(a)))
    else:
        a = 10 ** random.uniform(-1, 2) * (
            a - random.choice([0.5, 1.5]) * np.max(np.linalg.eigvals(a).real) * np.eye(order)
        )
    direct = random.normal(size=(1, 1)) * (random.random() < 0.3)
    system = control.ss(a, random.normal(size=(order, 1)), random.normal(size=(1, order)), direct, period)
    found = margins(system)
    assert found.stable is (unstable_count(system, 1.0) == 0)
    edges = [1e-5, *sorted(g for g, _ in found.gains if 1e-5 < g < 1e5), 1e5]
    for low, high in itertools.pairwise(edges):
        if high > low * 1.001:
            counts = {unstable_count(system, float(k)) for k in np.geomspace(low, high, 12)[1:-1]}
            assert len(counts) == 1, (low, high)
    for factor, omega in found.gains:
        if math.isfinite(omega):
            p = np.linalg.eigvals(system.A - factor * system.B @ system.C / (1 + factor * system.D[0, 0]))
            border = np.exp(1j * omega * period) if period else 1j * omega
            assert np.min(np.abs(p - border)) < 1e-8 * max(1.0, float(np.max(np.abs(p))))


# Loops of several rates


class OfTicks(control.StateSpace):  # type: ignore[misc]
    """A sampled loop over a pattern of several of its periods, as a diagram of several rates gives it."""

    def __init__(self, system: Any, count: int) -> None:
        a, b, c, d = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
        power = [np.linalg.matrix_power(a, k) for k in range(count + 1)]
        inputs = np.hstack([power[count - 1 - k] @ b for k in range(count)])
        outputs = np.vstack([c @ power[k] for k in range(count)])
        direct = np.zeros((count, count))
        for row in range(count):
            direct[row, row] = d[0, 0]
            for column in range(row):
                direct[row, column] = (c @ power[row - 1 - column] @ b)[0, 0]
        dt = float(system.dt) * count
        super().__init__(power[count], inputs, outputs, direct, dt, remove_useless_states=False)
        self.times = tuple(float(system.dt) * k for k in range(count))


@pytest.mark.parametrize("seed", long_but(range(20), lambda seed: seed < 6))
def test_a_loop_of_one_rate_has_the_same_margins_over_several_of_its_periods(seed: int) -> None:
    random = np.random.default_rng(seed)
    order = int(random.integers(1, 5))
    a = random.normal(size=(order, order))
    a *= random.uniform(0.3, 1.2) / np.max(np.abs(np.linalg.eigvals(a)))
    direct = 0.3 * random.normal(size=(1, 1)) * (seed % 3 == 0)
    system = control.ss(a, random.normal(size=(order, 1)), random.normal(size=(1, order)), direct, 0.1)
    one, several = margins(system), margins(OfTicks(system, 2 + seed % 3))
    assert several.stable is one.stable
    assert (several.several_rates, one.several_rates) == (True, False)
    assert sorted(g for g, _ in several.gains) == pytest.approx(
        sorted(g for g, _ in one.gains if 1e-8 < g < 1e8), rel=1e-7
    )
    phases = sorted({round(abs(degrees), 9) for degrees, _ in one.phases})
    assert sorted(degrees for degrees, _ in several.phases) == pytest.approx(phases, rel=1e-6, abs=1e-6)


def test_an_integrator_beside_a_loop_of_several_rates_is_named_and_an_unstable_mode_counts() -> None:
    for pole, stable, hidden in ((1.0, True, 1), (0.9, True, 0), (1.1, False, 0)):
        system = control.ss([[0.5, 0.0], [1.0, pole]], [[1.0], [0.0]], [[0.5, 0.0]], 0, 0.1)
        found = margins(OfTicks(system, 3))
        assert (found.stable, len(found.hidden)) == (stable, hidden)
        # k/(z - 0.5) is at the border for k = 1.5.
        assert found.gain == pytest.approx(3.0, rel=1e-10)
        assert len(found.gains) == 1


def test_the_table_of_a_loop_of_several_rates_tells_what_there_is_not() -> None:
    shown = str(margins(OfTicks(control.ss([[0.5]], [[1.0]], [[0.375]], 0, 0.1), 3))).splitlines()
    assert shown == [
        "closed loop     stable",
        "gain margin     4 (12.04 dB) at 10.472 rad/s",
        "phase margin    none: the loop stays stable for any phase",
        "                several rates: no delay, modulus or disk margin; frequencies are the lowest of several",
    ]


def test_the_json_of_a_loop_of_several_rates_has_null_for_what_there_is_not() -> None:
    shown = margins(OfTicks(control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1), 2)).as_json()
    assert json.loads(json.dumps(shown, allow_nan=False)) == shown
    missing = ["gain_low", "delay", "modulus", "Ms", "Mt", "disk", "bandwidth"]
    assert [name for name, value in shown.items() if value is None] == missing


@pytest.mark.parametrize("seed", long_but(range(20), lambda seed: seed < 6))
def test_between_two_borders_of_a_loop_of_several_rates_no_pole_crosses(seed: int) -> None:
    """The eigenvalues of the closed loop, over all gains and phases, are the witness that the lists are complete."""
    random = np.random.default_rng(seed)
    order, count = int(random.integers(1, 7)), int(random.integers(2, 7))
    a = random.normal(size=(order, order))
    a *= random.uniform(0.2, 1.3) / np.max(np.abs(np.linalg.eigvals(a)))
    b = random.normal(size=(order, count)) * 10 ** random.uniform(-2, 1)
    c = random.normal(size=(count, order))
    d = np.tril(random.normal(size=(count, count)), -1) * random.uniform(0, 1)  # what comes back comes later
    system = control.ss(a, b, c, d, 0.5)
    system.times = tuple(0.1 * k for k in range(count))
    found = margins(system)

    def poles(factor: complex) -> Any:
        return np.linalg.eigvals(a - factor * b @ np.linalg.solve(np.eye(count) + factor * d, c))

    assert found.stable is bool(np.all(np.abs(poles(1.0)) < 1))
    gains = [math.log(factor) for factor, _ in found.gains]
    phases = [math.radians(degrees) for degrees, _ in found.phases]
    for borders, factor, low, high in (
        (gains, np.exp, math.log(1e-3), math.log(1e3)),
        (phases, lambda x: np.exp(-1j * x), 0.0, math.pi),
    ):
        inside = sorted(x for x in borders if low < x < high)
        for x in inside:
            assert np.min(np.abs(np.abs(poles(factor(x))) - 1)) < 1e-7
        for before, after in itertools.pairwise([low, *inside, high]):
            if after - before > 1e-3 and np.max(np.abs(poles(factor(after)))) < 1e8:
                between = np.linspace(before, after, 60)[1:-1]
                assert len({int(np.sum(np.abs(poles(factor(x))) > 1)) for x in between}) == 1, (before, after)


# The border of stability


def at_the_border() -> dict[str, tuple[Any, float]]:
    """Loops whose closed one has poles exactly on the border, by closed forms, and the frequency of these poles."""
    lags, turn = control.tf([8], [1, 3, 3, 1]), math.sqrt(3.0)
    lag = control.ss([[0.5]], [[1.0]], [[1.5]], 0, 0.1)  # closed: z + 1
    delayed = control.ss([[1.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0, 0.1)  # closed: z^2 - z + 1
    still = control.ss([[0.5]], [[1.0]], [[-0.5]], 0, 0.1)  # closed: z - 1
    return {
        "lags": (control.tf2ss(lags), turn),
        "polynomials": (lags, turn),
        "undamped": (control.tf2ss(control.tf([1], [1, 0, 0])), 1.0),
        "positive feedback": (control.tf2ss(control.tf([-1], [1, 1])), 0.0),
        "double": (control.tf2ss(control.tf([2, 0, 1], [1, 0, 0, 0, 0])), 1.0),
        "triple": (control.tf2ss(control.tf([3, 0, 3, 0, 1], [1, 0, 0, 0, 0, 0, 0])), 1.0),
        "Nyquist": (lag, 10.0 * math.pi),
        "Nyquist, polynomials": (control.ss2tf(lag), 10.0 * math.pi),
        "sampled": (delayed, 10.0 * math.pi / 3),
        "sampled, at rest": (still, 0.0),
        "several rates": (OfTicks(delayed, 2), 10.0 * math.pi / 3),
        "several rates, Nyquist": (OfTicks(lag, 3), 10.0 * math.pi / 3),
        "several rates, at rest": (OfTicks(still, 3), 0.0),
    }


@pytest.mark.parametrize("name", [*at_the_border()])
def test_a_loop_at_the_border_of_stability_has_no_margin(name: str) -> None:
    system, frequency = at_the_border()[name]
    found = margins(system)
    assert (found.verdict, found.stable, found.unstable) == ("border", False, ())
    # A triple pole is known to eps^(1/3).
    assert found.gain_frequency == pytest.approx(frequency, rel=1e-5)
    assert (found.gain, found.phase_deg, found.gain_low) == (1.0, 0.0, found.gain_low)
    assert str(found).startswith("closed loop     AT THE BORDER of stability within rounding (")
    assert (found.as_json()["stable"], found.as_json()["border"]) == (False, True)
    if not found.several_rates:
        assert (found.delay, found.modulus, found.disk, found.Ms) == (0.0, 0.0, 0.0, math.inf)


@pytest.mark.parametrize(("beside", "verdict"), [(-1e-9, "stable"), (1e-9, "unstable")])
def test_a_loop_close_to_the_border_is_stable_or_not(beside: float, verdict: str) -> None:
    loops = [control.tf([8 * (1 + beside)], [1, 3, 3, 1])]
    loops = [*loops, control.tf2ss(loops[0]), control.ss([[0.5]], [[1.0]], [[1.5 * (1 + beside)]], 0, 0.1)]
    for system in (*loops, OfTicks(loops[2], 3)):
        found = margins(system)
        assert (found.verdict, found.border) == (verdict, ())
        distance = found.gain if verdict == "stable" else found.gain_low
        assert distance == pytest.approx(1 - beside, rel=1e-12)


@pytest.mark.parametrize("count", range(2, 9))
def test_a_multiple_pole_far_from_the_border_is_stable(count: int) -> None:
    """Rounding moves it by eps^(1/count), but not as far as to the border."""
    found = margins(control.tf2ss(control.tf(np.poly([-1.0] * count)[1:], [1.0] + [0.0] * count)))
    assert (found.verdict, found.hidden) == ("stable", ())


def test_a_response_that_passes_through_minus_one_is_at_the_border() -> None:
    class Delayed:
        """1/s behind a delay of pi/2 s: the closed loop s + exp(-s pi/2) has the poles +-j."""

        dt = 0.0

        def response(self, omega: Any) -> Any:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.exp(-0.5j * math.pi * omega) / (1j * omega)

    found = margins(Delayed(), unstable_poles=0, integrators=1)
    assert (found.verdict, found.gain, found.phase_deg, found.delay) == ("border", 1.0, 0.0, 0.0)


def test_a_zero_on_the_border_is_no_crossing() -> None:
    notch = control.ss(control.tf2ss(control.tf([0.3, -0.6, 0.3], [1.0, -1.1, 0.4], 0.1)))
    exact = control.tf2ss(control.tf([1.0, 0.0, 1.0], [1.0, 2.0, 1.0]))
    for system in (notch, exact):
        found = margins(system)
        assert found.stable is True
        assert all(math.isfinite(factor) for factor, _ in found.gains)


def test_a_sampled_loop_with_a_gain_above_1_at_the_nyquist_frequency_bears_no_period_of_delay() -> None:
    system = control.tf([1.49, -1.46], [1.0, -1.0], 0.1)
    found = margins(system)
    assert found.stable is True
    assert found.delay == pytest.approx(0.1)
    assert np.max(np.abs(np.roots([1.0, -1.0 + 1.49, -1.46]))) > 1
