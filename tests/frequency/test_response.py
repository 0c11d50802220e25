"""Responses, poles, zeros, bandwidths and norms against closed forms, SciPy and python-control."""

from __future__ import annotations

import itertools
import math
import warnings
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, linear_sum_assignment
from scipy.signal import butter

from blocks.frequency import realization
from blocks.frequency.response import HALF_POWER, bandwidth, dc_gain, h2, hinf, peak, poles, response, zeros
from blocks.text.errors import AnalysisError, UsageError

EPS = float(np.finfo(float).eps)
# Solving (s I - A) x = B loses digits by the condition of a few states: some hundred roundings.
SOLVED = 1e-12
PRINTED = 5e-10  # half a unit of the tenth digit

LESO = (30.4, 523.4, 2970.8)
SMESO = (30.4, 513.4, 1570.8)


def observer(gains: tuple[float, float, float], *, to: int) -> Any:
    """n -> z_to of a linear observer of order 3."""
    b1, b2, b3 = gains
    a = [[-b1, 1.0, 0.0], [-b2, 0.0, 1.0], [-b3, 0.0, 0.0]]
    return control.ss(a, [[b1], [b2], [b3]], [[float(to == k) for k in (1, 2, 3)]], 0)


def disturbance(gains: tuple[float, float, float]) -> Any:
    """f -> z3: y - z1 is f passed through 1/Delta."""
    b1, b2, b3 = gains
    return control.ss([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-b3, -b2, -b1]], [[0.0], [0.0], [b3]], [[1.0, 0.0, 0.0]], 0)


def random_stable(n: int, inputs: int, outputs: int, *, seed: int) -> Any:
    random = np.random.default_rng(seed)
    a = random.normal(size=(n, n))
    a -= (np.max(np.linalg.eigvals(a).real) + 0.3) * np.eye(n)
    return control.ss(
        a, random.normal(size=(n, inputs)), random.normal(size=(outputs, n)), random.normal(size=(outputs, inputs))
    )


# Responses


def test_a_response_is_that_of_the_polynomials() -> None:
    omega = np.geomspace(0.01, 1e4, 50)
    s = 1j * omega
    expected = LESO[2] / (s**3 + LESO[0] * s**2 + LESO[1] * s + LESO[2])
    for system in (disturbance(LESO), control.tf([LESO[2]], [1, *LESO])):
        assert response(system, omega)[0, 0] == pytest.approx(expected, rel=SOLVED)


def test_a_response_has_outputs_inputs_and_frequencies() -> None:
    system = random_stable(5, 2, 3, seed=1)
    omega = np.array([0.1, 1.0, 10.0, 100.0])
    values = response(system, omega)
    assert values.shape == (3, 2, 4)
    assert values == pytest.approx(np.asarray(system(1j * omega)), rel=SOLVED)


def test_a_lightly_damped_pole_is_met_on_its_flank() -> None:
    damping = 1e-7
    system = control.ss([[0.0, 1.0], [-1.0, -2 * damping]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    omega = 1.0 + damping * np.array([-3.0, -1.0, 0.0, 0.5, 2.0])
    # 1 - omega^2 as a product, which cancels nothing.
    expected = 1 / ((1 - omega) * (1 + omega) + 2j * damping * omega)
    assert response(system, omega)[0, 0] == pytest.approx(expected, rel=10 * EPS / damping)


def test_many_states_are_solved_by_the_hessenberg_form_as_by_the_full_one(monkeypatch: pytest.MonkeyPatch) -> None:
    system = random_stable(60, 2, 2, seed=2)
    omega = np.geomspace(0.01, 1e3, 40)
    full = response(system, omega)
    monkeypatch.setattr(realization, "_DENSE", 0)
    monkeypatch.setattr(realization, "_FEW", 0)
    assert response(system, omega) == pytest.approx(full, rel=1e-9, abs=1e-12 * float(np.max(np.abs(full))))


def test_a_search_for_a_margin_needs_no_hessenberg_form_for_each_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    system = random_stable(120, 1, 1, seed=3)
    whole = response(system, np.geomspace(0.01, 1e3, 40))
    monkeypatch.setattr(realization, "_Hessenberg", None)
    one = [response(system, omega)[0, 0, 0] for omega in np.geomspace(0.01, 1e3, 40)]
    assert one == pytest.approx(whole[0, 0], rel=1e-9, abs=1e-12 * float(np.max(np.abs(whole))))


def test_a_pole_on_the_axis_is_infinite_in_its_own_channel_only(monkeypatch: pytest.MonkeyPatch) -> None:
    system = control.ss([[0.0, 0.0], [0.0, -2.0]], np.eye(2), np.eye(2), np.zeros((2, 2)))
    for dense in (96, 0):
        monkeypatch.setattr(realization, "_DENSE", dense)
        monkeypatch.setattr(realization, "_FEW", dense)
        values = response(system, [0.0, 1.0])[:, :, 0]
        assert np.isinf(values[0, 0])
        assert values[1, 1] == pytest.approx(0.5)
        assert values[0, 1] == values[1, 0] == 0


def test_a_loop_that_is_sampled_fast_keeps_its_digits() -> None:
    """At Ts = 1e-4 the coefficients of a transfer function hold ten digits less than delta = z - 1 does."""
    period = 1e-4
    plant = disturbance(LESO)
    sampled = control.c2d(plant, period)
    omega = np.array([0.01, 0.1, 1.0, 10.0])
    s = 1j * omega
    continuous = LESO[2] / (s**3 + LESO[0] * s**2 + LESO[1] * s + LESO[2])
    hold = (1 - np.exp(-s * period)) / (s * period)
    # Of the sampled spectrum the next alias is smaller by (omega Ts/2 pi)^4; the hold's A - I has 1e-12 by expm.
    assert response(sampled, omega)[0, 0] == pytest.approx(continuous * hold, rel=1e-9)


def test_at_the_nyquist_frequency_a_sampled_response_is_real() -> None:
    system = control.ss([[0.5]], [[1.0]], [[1.0]], 0, 0.1)
    assert response(system, [math.pi / 0.1])[0, 0, 0] == 1 / (-1 - 0.5)


def test_measured_data_answer_at_their_own_frequencies_only() -> None:
    data = control.frd(np.array([1 + 1j, 2 + 0j]), np.array([1.0, 2.0]))
    assert response(data, [2.0])[0, 0, 0] == 2
    with pytest.raises(
        AnalysisError,
        match=r"E705 response: the data were measured at 2 frequencies, but not "
        r"at 1\.5 rad/s",
    ):
        response(data, [1.5])


def test_what_is_no_system_is_refused() -> None:
    with pytest.raises(UsageError, match="E501 system: float is not a linear system"):
        response(1.0, [1.0])
    with pytest.raises(UsageError, match="finite numbers"):
        response(disturbance(LESO), [math.inf])


# Poles and zeros


@pytest.mark.parametrize(
    ("gains", "real", "pair"),
    [
        (LESO, -8.970816244, complex(-10.71459188, 14.70918934)),
        (SMESO, -3.812241604, complex(-13.2938792, 15.33994189)),
    ],
)
def test_poles_of_the_observers_are_those_of_the_facts(gains: Any, real: float, pair: complex) -> None:
    for system in (observer(gains, to=1), disturbance(gains), control.tf([1.0], [1.0, *gains])):
        found = poles(system)
        assert found[0] == pytest.approx(real, rel=PRINTED)
        assert found[1:] == pytest.approx(np.array([pair.conjugate(), pair]), rel=PRINTED)


def test_a_cascade_of_equal_blocks_keeps_its_multiple_pole() -> None:
    """Eigenvalues of the whole matrix would scatter by eps^(1/4) about -1."""
    stage = control.ss([[-1.0]], [[1.0]], [[1.0]], 0)
    assert np.all(poles(stage * stage * stage * stage) == -1.0)


def test_poles_of_sampled_systems_are_z() -> None:
    found = np.sort_complex(poles(control.c2d(disturbance(LESO), 1e-3)))
    assert found == pytest.approx(np.sort_complex(np.exp(1e-3 * poles(disturbance(LESO)))), rel=1e-10)


def test_zeros_of_the_observer_are_those_of_its_closed_form() -> None:
    b1, b2, b3 = LESO
    assert zeros(observer(LESO, to=3)) == pytest.approx(np.zeros(2))
    assert zeros(observer(LESO, to=2)) == pytest.approx(np.array([0.0, -b3 / b2]), rel=1e-12)
    expected = np.roots([b1, b2, b3])
    assert np.sort_complex(zeros(observer(LESO, to=1))) == pytest.approx(np.sort_complex(expected), rel=1e-12)
    assert len(zeros(disturbance(LESO))) == 0


def test_infinite_zeros_are_none_however_many() -> None:
    """Of 12 integrators in a row the pencil has 13 infinite zeros, which rounding would bring to about 20 rad/s."""
    chain = control.ss(np.diag(np.ones(11), 1) - np.diag(np.arange(1.0, 13.0)), np.eye(12)[:, 11:], np.eye(12)[:1], 0)
    assert len(zeros(chain)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_zeros_of_square_systems_make_the_system_matrix_singular(seed: int) -> None:
    system = random_stable(6, 2, 2, seed=seed)
    system.D[:, 1] = 0.0
    found = zeros(system)
    assert len(found) >= 4
    for z in found:
        block = np.block([[system.A - z * np.eye(6), system.B], [system.C, system.D]])
        values = np.linalg.svd(block, compute_uv=False)
        assert values[-1] < 1e-11 * values[0]


def test_a_system_with_more_inputs_than_outputs_has_no_zeros_by_chance() -> None:
    assert len(zeros(random_stable(6, 3, 2, seed=5))) == 0


def canonical(num: Any, den: Any, dt: float = 0.0) -> Any:
    """num/den in controllable canonical form, as a TransferFunction of a diagram has it."""
    num, den = np.asarray(num, dtype=float) / den[0], np.asarray(den, dtype=float) / den[0]
    n = len(den) - 1
    num = np.concatenate([np.zeros(n + 1 - len(num)), num])
    a = np.vstack([np.eye(n)[1:], -den[:0:-1]])
    return control.ss(a, np.eye(n)[:, -1:], [(num[1:] - den[1:] * num[0])[::-1]], num[0], dt)


def agree(found: Any, expected: Any, share: float) -> bool:
    """Whether both are the same points but for a share of their sizes, each with its partner."""
    found, expected = np.asarray(found, dtype=complex), np.asarray(expected, dtype=complex)
    if len(found) != len(expected):
        return False
    apart = np.abs(found[:, None] - expected) / np.maximum(np.abs(expected), 1.0)
    return bool(len(found) == 0 or np.max(apart[linear_sum_assignment(apart)]) < share)


@pytest.mark.parametrize("order", range(1, 9))
def test_multiple_zeros_at_plus_and_minus_one_are_distinguished(order: int) -> None:
    for poles_at in (0.0, 0.5):
        system = canonical(np.poly([1.0, -1.0] * order), np.poly([poles_at] * 2 * order), 1.0)
        found = zeros(system)
        assert np.count_nonzero(found == 1.0) == order
        # Rounding moves a zero of multiplicity k by eps^(1/k).
        assert agree(found, [1.0, -1.0] * order, 4 * EPS ** (1 / order))
        assert dc_gain(system)[0, 0] == 0.0


@pytest.mark.parametrize(("order", "band"), [*itertools.product(range(1, 9), ((0.01, 0.02), (0.1, 0.2), (0.3, 0.5)))])
def test_a_band_pass_has_half_its_zeros_at_one_and_no_gain_there(order: int, band: tuple[float, float]) -> None:
    """Also where sixteen digits cannot hold the roots of its denominator, which nearly vanishes at 1."""
    num, den = butter(order, band, "bandpass")
    system = canonical(num, den, 1.0)
    assert np.count_nonzero(zeros(system) == 1.0) == order
    assert dc_gain(system)[0, 0] == 0.0
    num, den = butter(order, band[0], "high")
    assert np.count_nonzero(zeros(canonical(num, den, 1.0)) == 1.0) == order


def test_the_gain_of_an_ill_conditioned_filter_at_zero_frequency_is_finite() -> None:
    for kind in ("bandpass", "bandstop"):
        for order in (4, 5):
            num, den = butter(order, (0.01, 0.02), kind)
            for system in (canonical(num, den, 1.0), control.tf(num, den, 1.0)):
                assert math.isfinite(dc_gain(system)[0, 0])


@pytest.mark.parametrize("slow", [1.0, 1e-3])
def test_zeros_beside_a_multiple_one_at_rest_are_kept(slow: float) -> None:
    for poles_at in ([-1000.0] * 4, [-1000.0] * 5, [-1.0, -10.0, -100.0, -1000.0]):
        found = zeros(canonical(np.poly([0.0, 0.0, 0.0, -slow]), np.poly(poles_at)))
        assert np.count_nonzero(found == 0.0) == 3
        assert found[-1] == pytest.approx(-slow, rel=1e-9)


@pytest.mark.parametrize("seed", range(30))
def test_zeros_are_those_of_which_the_numerator_was_made(seed: int) -> None:
    random = np.random.default_rng(seed)
    dt = float(seed % 2)
    order = int(random.integers(1, 13))
    places = [0.0, 1.0, -1.0, 0.5] if dt else [0.0, -1.0, 1.0, -30.0]
    made = [float(random.choice([*places, random.uniform(-1, 1)])) for _ in range(int(random.integers(0, order + 1)))]
    den = np.poly(random.choice([0.0, 0.3, -0.4, 0.9] if dt else [-1.0, -2.0, -100.0], size=order))
    num = np.atleast_1d(np.poly(made)) * 10 ** random.uniform(-3, 3)
    found, most = zeros(canonical(num, den, dt)), max((made.count(place) for place in made), default=1)
    by_roots = np.asarray(np.roots(num), dtype=complex)
    # np.roots shows how far rounding moves multiple zeros; zeros at rest are exact.
    assert agree(found, made, 0.1 if most > 4 else 0.01) or agree(found, by_roots, 1e-6)
    at_rest = 1.0 if dt else 0.0
    assert np.count_nonzero(found == at_rest) == made.count(at_rest)


def test_zeros_of_measured_data_are_not_known() -> None:
    data = control.frd(np.array([1 + 1j]), np.array([1.0]))
    for question in (zeros, poles):
        with pytest.raises(AnalysisError, match="E705"):
            question(data)


# The gain at zero frequency


def test_the_gain_at_zero_frequency_is_finite_infinite_or_zero() -> None:
    assert dc_gain(disturbance(LESO))[0, 0] == pytest.approx(1.0, rel=1e-13)
    assert dc_gain(-disturbance(LESO))[0, 0] == pytest.approx(-1.0, rel=1e-13)
    assert dc_gain(observer(LESO, to=3))[0, 0] == 0.0
    assert dc_gain(control.tf([1], [1, 0]))[0, 0] == math.inf
    assert dc_gain(control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[-1.0, -1.0]], 0))[0, 0] == -math.inf
    assert dc_gain(control.ss([[1.0]], [[1.0]], [[2.0]], 0, 0.1))[0, 0] == math.inf
    assert dc_gain(control.ss([[0.5]], [[1.0]], [[-2.0]], 0, 0.1))[0, 0] == pytest.approx(-4.0)


def test_an_integrator_that_cancels_leaves_the_finite_gain() -> None:
    assert dc_gain(control.tf([1, 0], [1, 2, 0]))[0, 0] == pytest.approx(0.5)
    hidden = control.ss([[0.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[0.0, 3.0]], 0)
    assert dc_gain(hidden)[0, 0] == 3.0
    # No zero in A, B, C tells it: two wheels' angles of which only the difference is used.
    wheels = control.ss([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, -1.0, -1.0]], np.ones((3, 1)), [[0.0, 0.0, 1.0]], 0)
    assert dc_gain(wheels)[0, 0] == pytest.approx(1.0)


def test_an_integrator_that_rounding_moved_is_one() -> None:
    turned = np.array([[0.3, 0.3], [-0.3, -0.3]])  # a double integrator in other coordinates
    assert math.isinf(dc_gain(control.ss(turned, [[1.0], [1.0]], [[1.0, 0.0]], 0))[0, 0])


def test_slow_and_fast_poles_together_are_no_integrator() -> None:
    system = control.ss([[-1e-9, 1.0], [0.0, -1e9]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    assert dc_gain(system)[0, 0] == pytest.approx(1.0, rel=1e-12)


# Bandwidths


@pytest.mark.parametrize(("gains", "expected"), [(LESO, 9.856422606), (SMESO, 3.846405550)])
def test_bandwidths_of_the_observers_are_those_of_the_facts(gains: Any, expected: float) -> None:
    b1, b2, b3 = gains
    # |Delta(j w)|^2 = 2 b3^2 is a cubic in w^2.
    cubic = np.roots([1.0, b1**2 - 2 * b2, b2**2 - 2 * b1 * b3, -(b3**2)])
    exact = math.sqrt(min(r.real for r in cubic if abs(r.imag) < 1e-6 and r.real > 0))
    for system in (disturbance(gains), control.tf([b3], [1, *gains])):
        assert bandwidth(system) == pytest.approx(expected, rel=PRINTED)
        assert bandwidth(system) == pytest.approx(exact, rel=1e-12)


def test_the_bandwidth_of_gaos_observer_is_its_closed_form() -> None:
    wo = 37.0
    system = disturbance((3 * wo, 3 * wo**2, wo**3))
    assert bandwidth(system) == pytest.approx(wo * math.sqrt(2 ** (1 / 3) - 1), rel=1e-12)


def test_a_negative_gain_has_its_bandwidth_and_python_control_gives_infinity() -> None:
    lag = control.ss([[-2.0]], [[1.0]], [[-3.0]], 0)
    assert control.bandwidth(lag) == math.inf
    assert bandwidth(lag) == pytest.approx(2.0, rel=1e-14)


def test_a_sampled_system_has_its_bandwidth_and_python_control_raises() -> None:
    period, pole = 0.1, 0.8
    lag = control.ss([[pole]], [[1.0]], [[1.0]], 0, period)
    with pytest.raises(ValueError, match="different signs"):
        control.bandwidth(lag)
    # |z - p|^2 = 1 + p^2 - 2 p cos = 2 (1 - p)^2
    exact = math.acos((1 + pole**2 - 2 * (1 - pole) ** 2) / (2 * pole)) / period
    assert bandwidth(lag) == pytest.approx(exact, rel=1e-13)


def test_python_control_drops_by_3_db_and_not_to_half_the_power() -> None:
    lag = control.ss([[-1.0]], [[1.0]], [[1.0]], 0)
    assert control.bandwidth(lag) == pytest.approx(math.sqrt(10**0.3 - 1), rel=1e-6)
    assert bandwidth(lag, drop=3.0) == pytest.approx(math.sqrt(10**0.3 - 1), rel=1e-13)
    assert bandwidth(lag) == pytest.approx(1.0, rel=1e-14)
    half = 10 ** (-HALF_POWER / 20)
    assert half == pytest.approx(math.sqrt(0.5), rel=2 * EPS)
    assert bandwidth(lag, drop=1e-9) == pytest.approx(math.sqrt(10**1e-10 - 1), rel=1e-5)


def test_a_narrow_dip_ends_the_bandwidth() -> None:
    notch = control.tf([1, 2e-6, 1], [1, 0.2, 1]) * control.tf([1], [0.001, 1])
    found = bandwidth(notch)
    assert found is not None
    exact = brentq(lambda w: abs(1 - w * w) / math.hypot(1 - w * w, 0.2 * w) - math.sqrt(0.5), 0.8, 0.9999)
    assert found == pytest.approx(exact, rel=1e-5)


def test_what_never_falls_has_no_bandwidth() -> None:
    assert bandwidth(control.tf([1, 1], [1, 2])) is None
    assert bandwidth(control.ss([], [], [], [[2.0]])) is None


def test_a_zero_or_infinite_gain_at_zero_frequency_is_no_reference() -> None:
    with pytest.raises(AnalysisError, match=r"E705 bandwidth: .* is zero\. Use relative='peak' or"):
        bandwidth(observer(LESO, to=3))
    with pytest.raises(AnalysisError, match=r"infinite .*\. Use relative='unity'\."):
        bandwidth(control.tf([5], [1, 0]))
    assert bandwidth(control.tf([5], [1, 0]), relative="unity", drop=20 * math.log10(2)) == pytest.approx(10.0)
    band_pass = control.tf([0.2, 0], [1, 0.2, 1])
    # |1 - w^2| = 0.2 w above the peak
    assert bandwidth(band_pass, relative="peak") == pytest.approx(0.1 + math.sqrt(1.01), rel=1e-9)


def test_a_bandwidth_asked_wrongly_is_refused() -> None:
    for wrong in ({"relative": "max"}, {"drop": -3.0}):
        with pytest.raises(UsageError, match="E501 bandwidth"):
            bandwidth(disturbance(LESO), **wrong)
    with pytest.raises(UsageError, match="2 outputs and 2 inputs"):
        bandwidth(random_stable(3, 2, 2, seed=1))


# Norms and peaks


@pytest.mark.parametrize(("gains", "expected"), [(LESO, 422.4727884), (SMESO, 212.4239518)])
def test_the_noise_gain_is_that_of_the_facts(gains: Any, expected: float) -> None:
    b1, b2, b3 = gains
    found = h2(observer(gains, to=3))
    assert found == pytest.approx(expected, rel=PRINTED)
    assert found == pytest.approx(b3 * math.sqrt(b2 / (2 * (b1 * b2 - b3))), rel=1e-12)
    assert h2(control.tf([b3, 0, 0], [1, b1, b2, b3])) == pytest.approx(found, rel=1e-10)


def test_the_h2_norm_is_the_integral_over_frequency() -> None:
    system = random_stable(5, 2, 2, seed=3)
    system.D[:] = 0.0

    def power(omega: float) -> float:
        return float(np.sum(np.abs(response(system, [omega])) ** 2))

    total = quad(power, 0, 1, limit=300)[0] + quad(lambda x: power(1 / x) / x**2, 0, 1, limit=300)[0]
    assert h2(system) == pytest.approx(math.sqrt(total / math.pi), rel=1e-7)


@pytest.mark.parametrize("period", [0.1, 1e-4])
def test_the_h2_norm_of_a_sampled_system_is_the_sum_of_its_impulse_response(period: float) -> None:
    pole = math.exp(-3 * period)
    system = control.ss([[pole, 1.0], [0.0, pole]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.5]], period)
    # sum of (k p^(k-1))^2 = (1 + q)/(1 - q)^3 with q = p^2
    rest = -math.expm1(-6 * period)
    assert h2(system) == pytest.approx(math.sqrt((1 + pole**2) / rest**3 + 0.25), rel=1e-11 / period)


def test_norms_ask_for_what_they_need() -> None:
    assert h2(control.tf([1, 1], [1, 2])) == math.inf
    for norm in (h2, hinf):
        with pytest.raises(AnalysisError, match=r"is not stable: a pole at \(?1"):
            norm(control.ss([[1.0]], [[1.0]], [[1.0]], 0))
    # What no output shows does not count.
    beside = control.ss([[0.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[0.0, 1.0]], 0)
    assert h2(beside) == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize("damping", [0.3, 1e-3, 1e-8])
def test_a_resonance_is_found_at_its_peak(damping: float) -> None:
    system = control.ss([[0.0, 1.0], [-1.0, -2 * damping]], [[0.0], [1.0]], [[1.0, 0.0]], 0)
    top = 1 / (2 * damping * math.sqrt(1 - damping**2))
    found = hinf(system)
    assert found.value == pytest.approx(top, rel=max(1e-12, 10 * EPS / damping))
    assert found.frequency == pytest.approx(math.sqrt(1 - 2 * damping**2), rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_peak_of_many_signals_is_above_every_frequency(seed: int) -> None:
    system = random_stable(6, 2, 3, seed=seed)
    found = hinf(system)
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4000)])
    gains = np.linalg.svd(np.moveaxis(np.asarray(system(1j * omega)), 2, 0), compute_uv=False)[:, 0]
    largest = max(float(np.max(gains)), float(np.linalg.norm(system.D, 2)))
    assert largest * (1 - 1e-12) <= found.value <= largest * (1 + 1e-4)
    sampled = control.c2d(system, 0.05, "bilinear")  # which keeps the norm
    assert hinf(sampled).value == pytest.approx(found.value, rel=1e-9)


def test_a_peak_may_lie_at_the_ends() -> None:
    assert peak(control.tf([1], [1, 1])).frequency == 0.0
    assert peak(control.tf([3, 1], [1, 1])) == peak(control.ss([[-1.0]], [[1.0]], [[-2.0]], [[3.0]]))
    assert peak(control.tf([3, 1], [1, 1])).frequency == math.inf
    assert peak(control.tf([1], [1, 0])).value == math.inf
    alternating = control.ss([[-0.5]], [[1.0]], [[1.0]], 0, 0.1)
    assert peak(alternating).value == pytest.approx(2.0)
    assert peak(alternating).frequency == pytest.approx(math.pi / 0.1)


def test_norms_agree_with_python_control() -> None:
    system = observer(LESO, to=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = control.system_norm(system, 2), control.system_norm(system, "inf", tol=1e-10)
    assert h2(system) == pytest.approx(theirs[0], rel=1e-9)
    assert hinf(system).value == pytest.approx(theirs[1], rel=1e-6)
