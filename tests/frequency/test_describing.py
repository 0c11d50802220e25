"""Describing functions: closed forms against SciPy's quadrature, the own quadrature against both, and limits."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, fsolve
from scipy.special import iv

from blocks.frequency import describing
from blocks.frequency.describing import Described
from blocks.frequency.law_corners import breaks_of
from blocks.frequency.quadrature import fundamental, gaussian, harmonics, sinusoidal
from blocks.text.errors import AnalysisError, UsageError

Array = np.ndarray[Any, Any]

CLOSED = 1e-11  # SciPy's quadrature is asked for 1e-12 on each piece
ROUNDED = 1e-13  # closed forms and the own quadrature: some hundred roundings
PRINTED = 5e-10  # half of the last of the digits that the facts print


def power(a: float) -> Callable[[Any], Any]:
    return lambda e: np.abs(e) ** a * np.sign(e)


def fal(a: float, delta: float) -> Callable[[Any], Any]:
    return lambda e: np.where(np.abs(e) <= delta, e * delta ** (a - 1.0), power(a)(e))


def smeso(e: Any) -> Any:
    return 0.6265 * power(0.8433)(e) + 0.5878 * power(1.04078)(e)


def clipped(u: Any) -> Any:
    return np.clip(u, -0.4, 0.9)


def rounded(u: Any) -> Any:
    return 0.3 * np.floor(u / 0.3 + 0.5)


EDGES = tuple(0.3 * (np.arange(-200, 200) + 0.5))

# law, its breaks, and its closed forms for a sinusoid and for a Gaussian signal
ODD: dict[str, tuple[Any, ...]] = {
    "power": (
        power(0.3),
        (0.0,),
        lambda A: describing.power(0.3, A),
        lambda s: describing.gaussian_power(0.3, s),
    ),
    "fal": (
        fal(0.3, 0.7),
        (-0.7, 0.7),
        lambda A: describing.fal(0.3, 0.7, A),
        lambda s: describing.gaussian_fal(0.3, 0.7, s),
    ),
}
BIASED: dict[str, tuple[Any, ...]] = {
    "sign": (np.sign, (0.0,), describing.sign, describing.gaussian_sign),
    "saturation": (
        clipped,
        (-0.4, 0.9),
        lambda A, b: describing.saturation(-0.4, 0.9, A, b),
        lambda s, b: describing.gaussian_saturation(-0.4, 0.9, s, b),
    ),
    "saturation above": (
        lambda u: np.minimum(u, 0.9),
        (0.9,),
        lambda A, b: describing.saturation(-math.inf, 0.9, A, b),
        lambda s, b: describing.gaussian_saturation(-math.inf, 0.9, s, b),
    ),
    "dead zone": (
        lambda u: u - clipped(u),
        (-0.4, 0.9),
        lambda A, b: describing.dead_zone(-0.4, 0.9, A, b),
        lambda s, b: describing.gaussian_dead_zone(-0.4, 0.9, s, b),
    ),
    "dead below": (
        lambda u: np.maximum(u - 0.9, 0.0),
        (0.9,),
        lambda A, b: describing.dead_zone(-math.inf, 0.9, A, b),
        lambda s, b: describing.gaussian_dead_zone(-math.inf, 0.9, s, b),
    ),
    "comparator": (
        lambda u: np.where(u >= 0.3, 2.0, -1.0),
        (0.3,),
        lambda A, b: describing.relay(0.3, 0.3, 2.0, -1.0, A, b),
        lambda s, b: describing.gaussian_relay(0.3, 2.0, -1.0, s, b),
    ),
    "quantizer": (
        rounded,
        EDGES,
        lambda A, b: describing.quantizer(0.3, A, b),
        lambda s, b: describing.gaussian_quantizer(0.3, s, b),
    ),
    "tanh": (np.tanh, (0.0,), describing.tanh, describing.gaussian_tanh),
}
# Beyond all limits, between them, at one, and far beyond both.
SIGNALS = [(0.5, 0.0), (1.5, 0.2), (3.0, -0.7), (0.2, 2.0), (0.2, -2.0), (0.1, 0.1), (0.4, 0.5)]


def pieces(f: Callable[[float], Any], ends: Sequence[float]) -> float:
    """SciPy's integral of f from end to end."""
    return sum(
        quad(lambda x: float(f(x)), a, b, epsabs=1e-13, epsrel=1e-12, limit=200)[0] for a, b in pairwise(ends) if b > a
    )


def sine_by_quad(f: Callable[[Any], Any], A: float, bias: float, breaks: Sequence[float]) -> tuple[float, float]:
    inner = [math.asin((c - bias) / A) for c in breaks if abs(c - bias) < A]
    ends = sorted({-math.pi / 2, *inner, math.pi / 2})
    gain = pieces(lambda x: f(bias + A * math.sin(x)) * math.sin(x), ends) * 2.0 / (math.pi * A)
    return gain, pieces(lambda x: f(bias + A * math.sin(x)), ends) / math.pi


def gauss_by_quad(f: Callable[[Any], Any], sigma: float, bias: float, breaks: Sequence[float]) -> tuple[float, float]:
    inner = [(c - bias) / sigma for c in breaks if abs(c - bias) < 10.0 * sigma]
    ends = sorted({-10.0, -5.0, -2.0, *inner, 2.0, 5.0, 10.0})

    def weighted(s: float) -> float:
        return float(f(bias + sigma * s)) * math.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi)

    return pieces(lambda s: weighted(s) * s, ends) / sigma, pieces(weighted, ends)


def close(one: Described, gain: complex, mean: float, size: float, tolerance: float) -> None:
    """Gains within the tolerance of 1 + the gain; means of that in units of the signal."""
    assert abs(one.gain - gain) <= tolerance * (1.0 + abs(gain))
    assert abs(one.mean - mean) <= tolerance * (1.0 + abs(mean) + size)


@pytest.mark.parametrize(
    ("A", "gain", "random"),
    [
        (1e-3, 2.347994160, 2.201970321),
        (1e-2, 1.813412572, 1.715706885),
        (0.1, 1.458138387, 1.394518192),
        (1.0, 1.229572531, 1.190155758),
    ],
)
def test_the_law_of_the_smeso_has_the_gains_of_the_facts(A: float, gain: float, random: float) -> None:
    closed = 0.6265 * describing.power(0.8433, A).gain + 0.5878 * describing.power(1.04078, A).gain
    assert abs(closed - gain) <= PRINTED
    assert abs(sinusoidal(smeso, A, breaks=(0.0,)).gain - closed) <= ROUNDED
    assert abs(sinusoidal(smeso, A).gain - closed) <= ROUNDED
    closed = 0.6265 * describing.gaussian_power(0.8433, A).gain + 0.5878 * describing.gaussian_power(1.04078, A).gain
    assert abs(closed - random) <= PRINTED
    assert abs(gaussian(smeso, A, breaks=(0.0,)).gain - closed) <= ROUNDED


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("A", [0.05, 0.7, 0.71, 3.0, 200.0])
def test_closed_forms_of_odd_laws_are_the_integrals(name: str, A: float) -> None:
    f, breaks, sine, random = ODD[name]
    close(sine(A), *sine_by_quad(f, A, 0.0, breaks), A, CLOSED)
    close(random(A), *gauss_by_quad(f, A, 0.0, breaks), A, CLOSED)
    own, own_random = sinusoidal(f, A, breaks=breaks), gaussian(f, A, breaks=breaks)
    close(own, sine(A).gain, 0.0, A, ROUNDED)
    close(own_random, random(A).gain, 0.0, A, ROUNDED)
    assert own.error <= 1e-12 * abs(own.gain)
    assert own_random.error <= 1e-12 * abs(own_random.gain)


@pytest.mark.parametrize("name", BIASED)
@pytest.mark.parametrize(("A", "bias"), SIGNALS)
def test_closed_forms_with_a_bias_are_the_integrals(name: str, A: float, bias: float) -> None:
    f, breaks, sine, random = BIASED[name]
    close(sine(A, bias), *sine_by_quad(f, A, bias, breaks), A, CLOSED)
    close(random(A, bias), *gauss_by_quad(f, A, bias, breaks), A, CLOSED)
    own = sinusoidal(f, A, bias, breaks=breaks)
    close(own, sine(A, bias).gain, sine(A, bias).mean, A, ROUNDED)
    own = gaussian(f, A, bias, breaks=breaks)
    close(own, random(A, bias).gain, random(A, bias).mean, A, ROUNDED)


def test_gains_of_textbooks() -> None:
    A = np.array([1.25, 2.0, 17.0])
    x = 1.0 / A
    ideal = 2.0 / math.pi * (np.arcsin(x) + x * np.sqrt(1.0 - x * x))
    assert np.allclose(describing.saturation(-1.0, 1.0, A).gain, ideal, rtol=ROUNDED)
    assert np.allclose(describing.dead_zone(-1.0, 1.0, A).gain, 1.0 - ideal, rtol=ROUNDED)
    assert np.allclose(describing.sign(A).gain, 4.0 / (math.pi * A), rtol=ROUNDED)
    assert np.allclose(describing.power(3.0, A).gain, 0.75 * A**2, rtol=ROUNDED)
    assert np.allclose(describing.power(2.0, A).gain, 8.0 * A / (3.0 * math.pi), rtol=ROUNDED)
    hysteresis = describing.relay(1.0, -1.0, 3.0, -3.0, A).gain
    assert np.allclose(hysteresis, 12.0 / (math.pi * A) * np.exp(-1j * np.arcsin(x)), rtol=ROUNDED)
    assert np.allclose(describing.gaussian_power(3.0, A).gain, 3.0 * A**2, rtol=ROUNDED)
    assert np.allclose(describing.gaussian_sign(A).gain, math.sqrt(2.0 / math.pi) / A, rtol=ROUNDED)


def test_limits_of_small_and_large_amplitudes() -> None:
    assert describing.saturation(-1.0, 2.0, 1e-6).gain == pytest.approx(1.0, abs=ROUNDED)
    assert describing.saturation(-1.0, 1.0, 1e6).gain == pytest.approx(4e-6 / math.pi, rel=1e-11)
    assert describing.dead_zone(-1.0, 2.0, 0.5) == Described(0.0, 0.0)
    assert describing.fal(0.5, 0.01, 1e-3).gain == pytest.approx(10.0, rel=ROUNDED)
    # Of the linear zone remains what it lacks to the power: of the order of (delta/A)^(a + 2).
    assert describing.fal(0.5, 0.01, 1e4).gain == pytest.approx(describing.power(0.5, 1e4).gain, rel=1e-12)
    assert describing.quantizer(1.0, 0.4).gain == 0.0
    assert describing.quantizer(1.0, 0.4, 3.0).mean == 3.0
    assert describing.tanh(1e-6).gain == pytest.approx(1.0, abs=1e-12)
    assert describing.tanh(1e6).gain == pytest.approx(4e-6 / math.pi, rel=1e-11)
    assert describing.gaussian_tanh(1e6).gain == pytest.approx(math.sqrt(2.0 / math.pi) * 1e-6, rel=1e-11)


@pytest.mark.parametrize("a", [990.3, 1010.7, 5000.25, 100_000.4])
def test_a_quantizer_of_many_levels_is_the_sum_of_its_steps(a: float) -> None:
    edges = np.arange(math.ceil(0.2 - a - 0.5), math.floor(0.2 + a - 0.5) + 1) + 0.5
    x = (edges - 0.2) / a
    one = describing.quantizer(1.0, a, 0.2)
    assert one.gain == pytest.approx(2.0 / (math.pi * a) * math.fsum(np.sqrt(1.0 - x * x)), rel=1e-13)
    level = math.floor(0.5 + 0.2)
    share = math.fsum(np.where(edges > level, np.arccos(x), np.arccos(x) - math.pi)) / math.pi
    assert one.mean == pytest.approx(level + share, abs=1e-15 * a)


def test_a_quantizer_of_very_many_levels_does_nothing() -> None:
    assert describing.quantizer(1e-3, 1e7, 5.0) == Described(1.0, 5.0)
    # What rounding leaves of a gain falls as A^(-3/2); it is continuous where the sum ends.
    assert abs(describing.quantizer(1.0, 0.99e9, 0.3).gain - 1.0) <= 1e-13


@pytest.mark.parametrize("sigma", [1e-3, 0.05, 0.2249, 0.2251, 0.5, 4.0])
def test_both_sums_of_a_quantizer_of_noise_agree_with_the_integral(sigma: float) -> None:
    one, own = describing.gaussian_quantizer(0.3, sigma, 0.13), gaussian(rounded, sigma, 0.13, breaks=EDGES)
    close(one, own.gain, own.mean, sigma, ROUNDED)


def test_amplitudes_and_biases_may_be_arrays() -> None:
    A, bias = np.array([[0.5], [2.0]]), np.array([0.0, 0.3, 1.0])
    for _, _, sine, random in BIASED.values():
        for law in (sine, random):
            many = law(A, bias)
            assert many.gain.shape == many.mean.shape == (2, 3)
            assert many.gain[1, 2] == pytest.approx(law(2.0, 1.0).gain, abs=ROUNDED)
            assert many.mean[1, 2] == pytest.approx(law(2.0, 1.0).mean, abs=ROUNDED)
            assert np.ndim(law(2.0, 1.0).gain) == 0
    assert describing.fal(0.5, 0.1, A).gain.shape == describing.fal(0.5, 0.1, A).mean.shape == (2, 1)


def remembered(A: float, bias: float, step: Callable[[float, float], float], start: float) -> tuple[complex, float]:
    """Gain and mean of a law with memory, from the second period of 40,000 samples."""
    n, y, past = 40_000, [], start
    theta = 2.0 * np.pi * (np.arange(2 * n) + 0.5) / n
    for u in (bias + A * np.sin(theta)).tolist():
        past = step(u, past)
        y.append(past)
    period = np.array(y[n:])
    return 2.0 / A * np.mean(period * 1j * np.exp(-1j * theta[n:])), float(np.mean(period))


@pytest.mark.parametrize(("A", "bias"), [(1.0, 0.0), (0.5, -0.1), (7.0, 0.4)])
def test_hysteresis_lags_as_it_does_in_time(A: float, bias: float) -> None:
    one = describing.relay(0.2, -0.3, 2.0, 0.5, A, bias)
    gain, mean = remembered(A, bias, lambda u, y: 2.0 if u >= 0.2 else 0.5 if u < -0.3 else y, 0.5)
    # Each of the two edges is found within a sample, 2 pi/40,000.
    close(one, gain, mean, A, 3e-4)
    assert one.gain.imag == pytest.approx(-1.5 * 0.5 / (math.pi * A**2), rel=ROUNDED)
    one = describing.backlash(0.3, A, bias)
    gain, mean = remembered(A, bias, lambda u, y: min(max(y, u - 0.15), u + 0.15), 0.0)
    close(one, gain, mean, A, 1e-6)


def test_hysteresis_that_is_not_crossed_has_no_gain() -> None:
    with pytest.raises(AnalysisError) as raised:
        describing.relay(0.1, -0.1, 1.0, -1.0, np.array([1.0, 0.05]))
    assert str(raised.value) == (
        "E704 describing function: a relay that goes on at 0.1 and off below -0.1 does not switch at"
        " 0 + 0.05 sin(theta): its output is constant, and its value depends on the past."
        " Give an amplitude above 0.1, or replace the relay by a constant."
    )
    with pytest.raises(AnalysisError, match=r"E704 .* an amplitude of 1 does not cross a backlash of width 2"):
        describing.backlash(2.0, 1.0)
    # Without hysteresis the output does not depend on the past.
    assert describing.relay(0.1, 0.1, 1.0, -1.0, 0.05) == Described(0.0, -1.0)
    assert describing.relay(0.1, 0.1, 1.0, -1.0, 0.05, 1.0) == Described(0.0, 1.0)


def test_smooth_laws_against_bessel_functions_and_moments() -> None:
    one = sinusoidal(np.exp, 3.0, 0.5)
    close(one, math.exp(0.5) * 2.0 * iv(1, 3.0) / 3.0, math.exp(0.5) * iv(0, 3.0), 3.0, ROUNDED)
    one = gaussian(np.exp, 1.5, 0.5)
    close(one, math.exp(0.5 + 1.125), math.exp(0.5 + 1.125), 1.5, ROUNDED)
    one = gaussian(lambda u: u**3, 0.7, -0.4)
    close(one, 3.0 * (0.49 + 0.16), -0.064 - 3.0 * 0.4 * 0.49, 0.7, ROUNDED)
    # The gain of a Gaussian signal is the mean slope.
    slope = gaussian(lambda u: 1.0 / np.cosh(u) ** 2, 2.0, 0.3)
    assert gaussian(np.tanh, 2.0, 0.3).gain == pytest.approx(slope.mean, rel=1e-12)


@pytest.mark.parametrize(("A", "bias"), [(0.3, 0.0), (2.0, 0.4), (6.0, -1.0)])
def test_harmonics_of_a_smooth_law_are_its_fourier_coefficients(A: float, bias: float) -> None:
    theta = 2.0 * np.pi * np.arange(1024) / 1024  # tanh is resolved to rounding up to A = 6
    y = np.tanh(bias + A * np.sin(theta))
    transform = np.fft.rfft(y) / 1024
    one = harmonics(np.tanh, A, bias, 12)
    # y = mean + sum of Im(Y_k exp(j k theta)), so that Y_k = 2 j times the transform.
    assert np.allclose(one.harmonics, 2j * transform[1:13], rtol=0.0, atol=ROUNDED)
    assert one.mean == pytest.approx(transform[0].real, abs=ROUNDED)
    assert one.error <= 1e-12
    close(sinusoidal(np.tanh, A, bias), one.fundamental / A, one.mean, A, ROUNDED)
    several = fundamental(lambda u: np.tanh(u[0]), [A], [bias], count=12)
    assert np.allclose(several.harmonics, one.harmonics, rtol=0.0, atol=ROUNDED)
    # Parseval; what lies beyond 12 harmonics is the transform's.
    rest = 2.0 * float(np.sum(np.abs(transform[13:]) ** 2))
    power_of = one.mean**2 + 0.5 * float(np.sum(np.abs(one.harmonics) ** 2)) + rest
    assert power_of == pytest.approx(float(np.mean(y**2)), abs=ROUNDED)


def test_the_distortion_of_a_relay_is_that_of_a_square_wave() -> None:
    one = harmonics(np.sign, 2.0, 0.0, 9, breaks=(0.0,))
    expected = [4.0 / (math.pi * k) if k % 2 else 0.0 for k in range(1, 10)]
    assert np.allclose(one.harmonics, expected, rtol=0.0, atol=ROUNDED)
    assert one.distortion == pytest.approx(math.sqrt(1 / 9 + 1 / 25 + 1 / 49 + 1 / 81), rel=1e-12)
    assert harmonics(lambda u: 0.0 * u, 1.0).distortion == 0.0
    assert harmonics(lambda u: u**2, 1.0).distortion == math.inf


def broken(rng: np.random.Generator) -> tuple[Callable[[Array], Array], Array]:
    """A law with corners, jumps and infinite slopes of many sizes, and where they are."""
    count = int(rng.integers(1, 6))
    at, size = rng.uniform(-1.5, 1.5, count), rng.normal(size=count) * 10.0 ** rng.uniform(-8, 0, count)
    exponent = rng.choice([0.0, 0.1, 0.5, 0.84, 1.0, 1.5, 2.3], count)

    def f(u: Array) -> Array:
        y = np.tanh(u) + 0.3 * u
        for c, h, a in zip(at, size, exponent, strict=True):
            y = y + h * np.where(u > c, np.abs(u - c) ** a, 0.0)
        return y

    return f, at


@pytest.mark.parametrize("seed", range(40))
def test_breaks_that_are_not_told_are_found_and_the_error_is_honest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    f, at = broken(rng)
    A, bias = rng.uniform(0.3, 1.5), rng.uniform(-0.5, 0.5)
    for described in (sinusoidal, gaussian):
        told = described(f, A, bias, breaks=at)
        for one in (described(f, A, bias), described(f, A, bias, breaks=breaks_of(f, -3.0, 3.0))):
            off = max(abs(told.gain - one.gain), abs(told.mean - one.mean) / A)
            assert off <= 1e-11  # the tolerance, 1e-13 of |f|, in units of A
            assert off <= 10.0 * (one.error + told.error)  # an estimate
            assert one.error <= 1e-11


def test_noise_does_not_converge_and_the_error_says_so() -> None:
    one = sinusoidal(lambda u: u + 1e-6 * np.sin(1e9 * u), 1.0)
    assert one.error > 1e-9
    assert abs(one.gain - 1.0) <= one.error


def test_a_large_constant_costs_no_more_digits_than_its_rounding() -> None:
    assert sinusoidal(lambda u: np.full_like(u, 7e6), 1e-3) == Described(
        0.0,
        7e6,
        pytest.approx(0.0, abs=1e-5),  # 16 digits of 7e6, in units of A
    )
    assert sinusoidal(lambda u: 7e6, 1e-3).mean == 7e6
    one = sinusoidal(lambda u: u**2, 1e-6, 1.0)
    assert abs(one.gain - 2.0) <= one.error <= 1e-8


def test_a_law_that_is_not_defined_at_its_break_is_one_sided_there() -> None:
    for bias in (0.0, 0.3, 0.999):
        one = sinusoidal(lambda u: u / np.abs(u), 1.0, bias, breaks=(0.0,))
        exact = describing.sign(1.0, bias)
        close(one, exact.gain, exact.mean, 1.0, 1e-12)
    one = sinusoidal(lambda u: np.sign(u) / np.sqrt(np.abs(u)), 2.0, breaks=(0.0,))
    # The last node of a panel is at 1e-17 of it: what lies beyond counts by the root of that.
    assert one.gain == pytest.approx(describing.power(-0.5, 2.0).gain, rel=1e-8)


def test_breaks_are_found_in_a_law_alone() -> None:
    assert breaks_of(np.tanh, -5.0, 7.0) == ()
    assert breaks_of(lambda u: np.sin(40.0 * u), -3.0, 3.0) == ()
    assert breaks_of(smeso, -3.0, 3.0) == (0.0,)
    assert breaks_of(np.sign, -3.0, 3.0) == (0.0,)
    assert breaks_of(clipped, -100.0, 100.0) == (-0.4, 0.9)
    assert breaks_of(fal(0.5, 0.01), -100.0, 100.0) == pytest.approx((-0.01, 0.01), abs=1e-12)
    steps = breaks_of(lambda u: np.floor(u / 0.1 + 0.5), -1.0, 1.0)
    assert steps == pytest.approx([k / 20.0 for k in range(-19, 20, 2)], abs=1e-15)


def test_breaks_are_found_by_what_a_law_switches_by() -> None:
    def switches(u: Array) -> Array:
        # A narrow pair between two points of the scan, one that is 0 along a stretch, one that is not defined below 0.
        pair = (u - 1.234) ** 2 - 1e-8
        with np.errstate(invalid="ignore"):
            return np.stack((u, np.abs(u) - 1e-9, np.maximum(u, 2.0) - 2.0, np.sqrt(u) - 0.5, pair), axis=1)

    found = list(breaks_of(smeso, -3.0, 3.0, switches))
    assert found == pytest.approx([-1e-9, 0.0, 1e-9, 0.25, 1.2339, 1.2341, 2.0], abs=1e-12)
    assert breaks_of(smeso, -3.0, 3.0, lambda u: u**2 + 0.1) == ()
    assert breaks_of(smeso, -3.0, 3.0, lambda u: np.empty((len(u), 0))) == ()
    assert breaks_of(np.sin, 0.1, 30.0, lambda u: np.sin(u)[:, None]) == pytest.approx(
        np.pi * np.arange(1, 10), rel=1e-15
    )


def test_a_linear_law_of_several_signals_gives_the_sum_of_their_phasors() -> None:
    one = fundamental(lambda u: 2.0 * u[0] - u[1] + 1.0, [1.0 + 2.0j, 0.3j], [0.5, 0.2])
    assert one.fundamental == pytest.approx(2.0 + 3.7j, rel=ROUNDED)
    assert one.mean == pytest.approx(1.8, rel=ROUNDED)


def test_a_product_of_two_signals_has_its_mean_and_second_harmonic() -> None:
    U, V = 1.0 + 2.0j, -0.3 + 0.7j
    one = fundamental(lambda u: u[0] * u[1], [U, V], [0.5, -0.2], count=3)
    assert one.mean == pytest.approx(-0.1 + 0.5 * (U * V.conjugate()).real, rel=1e-12)
    # Im(U e) Im(V e) = Re(U V*)/2 - Re(U V e^2)/2, and -Re(z) = Im(-j z).
    assert np.allclose(one.harmonics, [0.5 * V - 0.2 * U, -0.5j * U * V, 0.0], rtol=0.0, atol=ROUNDED)


@pytest.mark.parametrize("seed", range(8))
def test_jumps_of_laws_of_several_signals_are_located(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights, offset = rng.normal(size=3), 0.5 * rng.normal()
    U, bias = rng.normal(size=3) + 1j * rng.normal(size=3), 0.3 * rng.normal(size=3)

    def side(u: Array) -> Array:
        return np.asarray(weights @ u + offset + 0.3 * u[0] * np.abs(u[1]))

    def f(u: Array) -> Array:
        return np.asarray(np.sign(side(u)) * (1.0 + 0.2 * u[2] ** 2) + np.abs(u[2]))

    told = fundamental(f, U, bias, count=3, switches=lambda u: np.stack((side(u), u[1], u[2]), axis=1))
    found = fundamental(f, U, bias, count=3)
    assert np.allclose(told.harmonics, found.harmonics, rtol=0.0, atol=1e-11)
    assert told.error <= 1e-11
    # SciPy from root to root, located by itself.
    grid = np.linspace(-math.pi, math.pi, 2001)

    def inputs(theta: float) -> Array:
        return np.asarray(bias + (U * np.exp(1j * theta)).imag)

    ends = [-math.pi, math.pi]
    for g in (lambda x: float(side(inputs(x))), lambda x: float(inputs(x)[1]), lambda x: float(inputs(x)[2])):
        marks = [g(x) for x in grid]
        for a, b, left, right in zip(grid[:-1], grid[1:], marks[:-1], marks[1:], strict=True):
            if left * right < 0.0:
                ends.append(brentq(g, a, b, xtol=1e-15))
    y1 = pieces(lambda x: f(inputs(x)) * math.sin(x), sorted(ends)) / math.pi
    y2 = pieces(lambda x: f(inputs(x)) * math.cos(x), sorted(ends)) / math.pi
    assert abs(told.fundamental - (y1 + 1j * y2)) <= CLOSED * (1.0 + abs(told.fundamental))


def test_the_tracking_differentiator_of_han_has_its_bandwidth() -> None:
    R, A = 100.0, 1.0

    def side(u: Array) -> Array:
        return np.asarray(u[0] - u[1] + u[2] * np.abs(u[2]) / (2.0 * R))

    def balance(unknown: Array) -> list[float]:
        """dx2/dt = -R sgn(...) where x1 has fallen to A/sqrt(2): unknown are the frequency and the phase of x1."""
        omega, phase = unknown
        x1 = A / math.sqrt(2.0) * np.exp(1j * phase)
        law = fundamental(
            lambda u: -R * np.sign(side(u)),
            [x1, A, 1j * omega * x1],
            [0.0, 0.0, 0.0],
            switches=lambda u: np.stack((side(u), u[2]), axis=1),
        )
        assert abs(law.fundamental) == pytest.approx(4.0 * R / math.pi, rel=1e-12)
        assert abs(law.mean) <= ROUNDED * R
        rest = (-(omega**2) * x1 - law.fundamental) / R
        return [rest.real, rest.imag]

    omega, _ = fsolve(balance, [10.0, -1.0], xtol=1e-13)
    assert omega == pytest.approx(math.sqrt(4.0 * math.sqrt(2.0) / math.pi * R / A), rel=1e-11)
    assert abs(omega - 13.41876534) <= 5e-9


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: sinusoidal(np.tanh, 0.0), "the amplitude is 0. Give an amplitude above 0."),
        (lambda: sinusoidal(np.tanh, math.nan), "the amplitude is nan. Give an amplitude above 0."),
        (lambda: sinusoidal(np.tanh, 1.0, math.inf), "the bias is inf. Give a finite number."),
        (lambda: gaussian(np.tanh, -1.0), "the deviation is -1. Give a deviation above 0."),
        (lambda: harmonics(np.tanh, 1.0, 0.0, 0), "0 harmonics were asked for. Ask for 1 or more."),
        (
            lambda: sinusoidal(lambda u: u[:3], 1.0),
            "the law gives an array of shape (3,) for 206 inputs. Return one output for each input.",
        ),
        (
            lambda: fundamental(lambda u: u[0], [1.0], [0.0, 1.0]),
            "there are phasors of shape (1,) and biases of shape (2,). Give one phasor and one bias for each signal.",
        ),
        (
            lambda: fundamental(lambda u: u[0], [math.nan], [0.0]),
            "a phasor or a bias is not finite. Give finite numbers.",
        ),
        (lambda: describing.power(0.5, [1.0, -2.0]), "the amplitude is -2. Give an amplitude above 0."),
        (lambda: describing.power(-1.0, 1.0), "the exponent is -1. Give a finite exponent above -1."),
        (lambda: describing.fal(0.5, 0.0, 1.0), "the delta is 0. Give a delta above 0."),
        (
            lambda: describing.saturation(1.0, 1.0, 1.0),
            "the limits are 1 and 1. Give a lower limit below the upper one.",
        ),
        (lambda: describing.sign(1.0, math.nan), "a bias is not finite. Give a finite bias."),
        (
            lambda: describing.relay(-1.0, 1.0, 1.0, 0.0, 2.0),
            "off_at = 1 lies above on_at = -1. Give an off_at that is not above on_at.",
        ),
        (lambda: describing.quantizer(0.0, 1.0), "the interval is 0. Give an interval above 0."),
        (lambda: describing.backlash(-1.0, 1.0), "the width is -1. Give a width of 0 or more."),
        (lambda: breaks_of(np.sign, 1.0, 1.0), "1 ... 1 is not an interval. Give the lower end first."),
        (
            lambda: breaks_of(np.sign, 0.0, 1.0, lambda u: u[:2]),
            "the switches give an array of shape (2,) for 1265 inputs. Return an array of shape (n, k).",
        ),
    ],
)
def test_calls_that_cannot_be_meant_are_refused(call: Callable[[], Any], text: str) -> None:
    with pytest.raises(UsageError) as raised:
        call()
    assert str(raised.value) == f"E501 describing function: {text}"


def test_a_law_that_is_not_finite_is_refused_with_the_input() -> None:
    with pytest.raises(AnalysisError) as raised:
        sinusoidal(np.sqrt, 1.0)
    assert str(raised.value) == (
        "E704 describing function: the law gives nan at u = -1."
        " Give inputs at which the law is defined, or estimate the response by simulation."
    )
    with pytest.raises(AnalysisError, match=r"the law gives inf at u = 0\.\d+\."):
        harmonics(lambda u: np.where(u > 0.3, np.inf, u), 1.0)
    with pytest.raises(AnalysisError, match=r"the law gives nan at u = \(.*, .*\)\."):
        fundamental(lambda u: np.log(u[0] + u[1]), [1.0, 1.0], [0.0, 0.0])
    with pytest.raises(AnalysisError, match="grows so fast that inputs beyond 13 deviations of 1 matter"):
        gaussian(lambda u: np.exp(u**2), 1.0)
