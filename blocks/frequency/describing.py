"""Describing functions of the usual laws in closed form; the functions of `quadrature`, for all others, stand here too.

    power(0.8433, 0.01).gain                # of |e|^a sgn e at e = 0.01 sin(theta)
    relay(0.1, -0.1, 1.0, -1.0, A).gain     # complex: it lags
    gaussian_power(0.8433, 0.01).gain       # at a Gaussian e of deviation 0.01

A sinusoid u = bias + A sin(theta) makes the output mean + Im(gain A exp(j theta)) and harmonics, which the loop is
assumed to suppress. A Gaussian signal makes mean + gain (u - bias) and what is not correlated with u; there the gain is
E[df/du] where the slope exists. Amplitudes, deviations and biases may be arrays, which are broadcast; results then have
their shape. Nothing here depends on time: the law is static, or, with hysteresis, depends on the turning points only.

Limits, intervals and edges are in the unit of the input. Raises: UsageError E501 for numbers that cannot be meant.

References: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions, McGraw-Hill, 1968, appendices B, E;
D. P. Atherton, Nonlinear Control Engineering, Van Nostrand Reinhold, 1975; fal: J. Han, From PID to Active Disturbance
Rejection Control, IEEE TIE 56(3), 2009.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import betainc, gamma, gammainc, gammaincc, ndtr

from ..text.arrays import Array
from .law_corners import breaks_of, finite, positive, refused, undescribed
from .quadrature import Described, Spectrum, fundamental, gaussian, harmonics, sinusoidal

__all__ = [
    "Described",
    "Spectrum",
    "backlash",
    "breaks_of",
    "dead_zone",
    "fal",
    "fundamental",
    "gaussian",
    "gaussian_dead_zone",
    "gaussian_fal",
    "gaussian_power",
    "gaussian_quantizer",
    "gaussian_relay",
    "gaussian_saturation",
    "gaussian_sign",
    "gaussian_tanh",
    "harmonics",
    "power",
    "quantizer",
    "relay",
    "saturation",
    "sign",
    "sinusoidal",
    "tanh",
]

_SUMMED = 1000  # steps of a quantizer at each end that are summed one by one; the rest is off by 1e-14 of one
_SO_MANY = 1e9  # intervals of amplitude from which a quantizer does nothing: 1e-13 in gain, 1e-14 A in mean
_SMOOTH = 0.75  # deviation in intervals from which a quantizer's Fourier series is the shorter sum


def power(a: float, A: object) -> Described:
    """|e|^a sgn e at e = A sin(theta): gain = 2 Gamma(a/2 + 1)/(sqrt(pi) Gamma(a/2 + 3/2)) A^(a - 1), a > -1."""
    a, A = _exponent(a), positive(A, "amplitude")
    factor = 2.0 / math.sqrt(math.pi) * gamma(0.5 * a + 1.0) / gamma(0.5 * a + 1.5)
    return _odd(factor * A ** (a - 1.0))


def gaussian_power(a: float, sigma: object) -> Described:
    """|e|^a sgn e of a Gaussian e: gain = 2^((a + 1)/2) Gamma(a/2 + 1)/sqrt(pi) sigma^(a - 1), a > -1."""
    a, sigma = _exponent(a), positive(sigma, "deviation")
    return _odd(2.0 ** (0.5 * a + 0.5) * gamma(0.5 * a + 1.0) / math.sqrt(math.pi) * sigma ** (a - 1.0))


def fal(a: float, delta: float, A: object) -> Described:
    """Han's fal at e = A sin(theta): e delta^(a - 1) where |e| <= delta, |e|^a sgn e beyond."""
    a, A, delta = _exponent(a), positive(A, "amplitude"), float(positive(delta, "delta"))
    x = np.minimum(delta / A, 1.0)
    inner = 2.0 / math.pi * (np.arcsin(x) - x * np.sqrt(1.0 - x * x))
    # The integral of sin^(a + 1) from asin(x) on is an incomplete beta function of cos^2.
    outer = betainc(0.5, 0.5 * a + 1.0, 1.0 - x * x)
    return _odd(delta ** (a - 1.0) * inner + power(a, A).gain * outer)


def gaussian_fal(a: float, delta: float, sigma: object) -> Described:
    """Han's fal of a Gaussian e."""
    a, sigma, delta = _exponent(a), positive(sigma, "deviation"), float(positive(delta, "delta"))
    z = 0.5 * (delta / sigma) ** 2
    inner = delta ** (a - 1.0) * gammainc(1.5, z)
    return _odd(inner + gaussian_power(a, sigma).gain * gammaincc(0.5 * a + 1.0, z))


def sign(A: object, bias: object = 0.0) -> Described:
    """sgn u at bias + A sin(theta): gain = 4/(pi A) sqrt(1 - (bias/A)^2); 0 where u does not change sign."""
    return relay(0.0, 0.0, 1.0, -1.0, A, bias)


def gaussian_sign(sigma: object, bias: object = 0.0) -> Described:
    """sgn u of a Gaussian u: gain = sqrt(2/pi)/sigma exp(-(bias/sigma)^2/2)."""
    return gaussian_relay(0.0, 1.0, -1.0, sigma, bias)


def saturation(lower: float, upper: float, A: object, bias: object = 0.0) -> Described:
    """u within lower ... upper, else the limit, at bias + A sin(theta). A limit may be infinite."""
    lower, upper = _limits(lower, upper)
    A, bias = _signal(A, "amplitude", bias)
    a, b = _reach(lower, A, bias), _reach(upper, A, bias)
    root_a, root_b = np.sqrt(1.0 - a * a), np.sqrt(1.0 - b * b)
    angle = np.arcsin(b) - np.arcsin(a)
    gain = (angle + b * root_b - a * root_a) / math.pi
    # A (root_a - root_b), without the cancellation of nearly equal roots.
    swing = A * (b - a) * (b + a) / np.maximum(root_a + root_b, np.finfo(float).tiny)
    mean = (_held(upper, np.arccos(b)) + _held(lower, np.arccos(-a)) + bias * angle + swing) / math.pi
    return _described(gain, mean)


def gaussian_saturation(lower: float, upper: float, sigma: object, bias: object = 0.0) -> Described:
    """u within lower ... upper, else the limit, of a Gaussian u. A limit may be infinite."""
    lower, upper = _limits(lower, upper)
    sigma, bias = _signal(sigma, "deviation", bias)
    a, b = (lower - bias) / sigma, (upper - bias) / sigma
    inside = _between(a, b)
    mean = _held(upper, ndtr(-b)) + _held(lower, ndtr(a)) + bias * inside + sigma * (_density(a) - _density(b))
    return _described(inside, mean)


def dead_zone(lower: float, upper: float, A: object, bias: object = 0.0) -> Described:
    """0 within lower ... upper, else u less the limit that it is beyond, at bias + A sin(theta)."""
    lower, upper = _limits(lower, upper)
    A, bias = _signal(A, "amplitude", bias)
    above, below = _reach(upper, A, bias), -_reach(lower, A, bias)
    angle_a, root_a = np.arccos(above), np.sqrt(1.0 - above * above)
    angle_b, root_b = np.arccos(below), np.sqrt(1.0 - below * below)
    gain = (angle_a - above * root_a + angle_b - below * root_b) / math.pi
    mean = _held(bias - upper, angle_a) + _held(bias - lower, angle_b) + A * (root_a - root_b)
    return _described(gain, mean / math.pi)


def gaussian_dead_zone(lower: float, upper: float, sigma: object, bias: object = 0.0) -> Described:
    """0 within lower ... upper, else u less the limit that it is beyond, of a Gaussian u."""
    lower, upper = _limits(lower, upper)
    sigma, bias = _signal(sigma, "deviation", bias)
    a, b = (bias - lower) / sigma, (upper - bias) / sigma
    return _described(ndtr(-a) + ndtr(-b), sigma * (_beyond(b) - _beyond(a)))


def relay(on_at: float, off_at: float, on: float, off: float, A: object, bias: object = 0.0) -> Described:
    """y = on from where u reaches on_at, off from where it falls below off_at <= on_at, at bias + A sin(theta).

    The gain is complex where off_at < on_at: its imaginary part is -(on - off) (on_at - off_at)/(pi A^2).

    Raises: AnalysisError E704 where off_at < on_at and u does not pass both, as y then is what it was at the start.
    """
    on_at, off_at = finite(on_at, "edge on_at"), finite(off_at, "edge off_at")
    on, off = finite(on, "output on"), finite(off, "output off")
    A, bias = _signal(A, "amplitude", bias)
    if off_at > on_at:
        raise refused(f"off_at = {off_at:g} lies above on_at = {on_at:g}.", "Give an off_at that is not above on_at.")
    if off_at < on_at:
        stuck = (bias + A < on_at) | (bias - A >= off_at)
        if np.any(stuck):
            some, middle = (np.broadcast_to(each, np.shape(stuck))[stuck].flat[0] for each in (A, bias))
            need = np.max(np.maximum(on_at - bias, bias - off_at))
            raise undescribed(
                f"a relay that goes on at {on_at:g} and off below {off_at:g} does not switch at {middle:g} + {some:g} "
                "sin(theta): its output is constant, and its value depends on the past.",
                f"Give an amplitude above {need:g}, or replace the relay by a constant.",
            )
    rise, fall = _reach(on_at, A, bias), _reach(off_at, A, bias)
    step = on - off
    gain = step * (np.sqrt(1.0 - rise * rise) + np.sqrt(1.0 - fall * fall)) / (math.pi * A)
    mean = off + step * (np.arccos(rise) + np.arccos(fall)) / (2.0 * math.pi)
    return _described(gain + 1j * step * (fall - rise) / (math.pi * A) if off_at < on_at else gain, mean)


def gaussian_relay(at: float, on: float, off: float, sigma: object, bias: object = 0.0) -> Described:
    """y = on where u >= at, else off, of a Gaussian u.

    One with hysteresis has no gain of this kind: what it gives depends on the spectrum of u, not on sigma alone.
    """
    at, on, off = finite(at, "edge"), finite(on, "output on"), finite(off, "output off")
    sigma, bias = _signal(sigma, "deviation", bias)
    z = (at - bias) / sigma
    return _described((on - off) * _density(z) / sigma, off * ndtr(z) + on * ndtr(-z))


def backlash(width: float, A: object, bias: object = 0.0) -> Described:
    """y = min(max(y_last, u - width/2), u + width/2) at bias + A sin(theta), once u has pushed y both ways.

    Raises: AnalysisError E704 where A <= width/2, as y then rests where it was at the start.
    """
    half = 0.5 * finite(width, "width")
    if half < 0.0:
        raise refused(f"the width is {width:g}.", "Give a width of 0 or more.")
    A, bias = _signal(A, "amplitude", bias)
    if np.any(half >= A):
        message = f"an amplitude of {np.min(A):g} does not cross a backlash of width {width:g}: the output is constant."
        raise undescribed(message, f"Give an amplitude above {half:g}, or replace the backlash by a constant.")
    x = 1.0 - 2.0 * half / A
    gain = 0.5 + (np.arcsin(x) + x * np.sqrt(1.0 - x * x)) / math.pi
    return _described(gain - 4.0j * half / (math.pi * A) * (1.0 - half / A), bias + 0.0 * A)


def quantizer(interval: float, A: object, bias: object = 0.0) -> Described:
    """interval * floor(u/interval + 1/2) at bias + A sin(theta): the sum of its steps, each a relay's."""
    q = float(positive(interval, "interval"))
    A, bias = _signal(A, "amplitude", bias)
    pairs = [_steps(a, b) for a, b in zip((A / q).flat, (bias / q).flat, strict=True)]
    gain, mean = (np.reshape([pair[i] for pair in pairs], A.shape) for i in range(2))
    return _described(gain, q * mean)


def gaussian_quantizer(interval: float, sigma: object, bias: object = 0.0) -> Described:
    """interval * floor(u/interval + 1/2) of a Gaussian u."""
    q = float(positive(interval, "interval"))
    sigma, bias = _signal(sigma, "deviation", bias)
    s, b = sigma / q, bias / q
    # The error of rounding is a sawtooth of u; each of its harmonics has the mean of a sine of a Gaussian angle.
    m = np.arange(1, 12).reshape(-1, *[1] * s.ndim)
    alternating, wide = np.where(m % 2 == 0, 1.0, -1.0), np.maximum(s, _SMOOTH)
    fade = alternating * np.exp(-2.0 * (math.pi * m * wide) ** 2)
    smooth_gain = 1.0 + 2.0 * np.sum(fade * np.cos(2.0 * math.pi * m * b), axis=0)
    smooth_mean = b + np.sum(fade * np.sin(2.0 * math.pi * m * b) / (math.pi * m), axis=0)
    # Few steps are within reach of a narrow one: 40 deviations are at most 30 intervals.
    level = np.floor(b + 0.5)
    k = np.arange(-31, 31).reshape(-1, *[1] * s.ndim)
    narrow = np.minimum(s, _SMOOTH)
    z = (level + k + 0.5 - b) / narrow
    gain = np.sum(_density(z), axis=0) / narrow
    mean = level + np.sum(np.where(k >= 0, ndtr(-z), -ndtr(z)), axis=0)
    few = s < _SMOOTH
    return _described(np.where(few, gain, smooth_gain), q * np.where(few, mean, smooth_mean))


def tanh(A: object, bias: object = 0.0) -> Described:
    """tanh u at bias + A sin(theta), by quadrature. That of c tanh(k u) is c k times the gain at k A and k bias."""
    return _each(sinusoidal, *_signal(A, "amplitude", bias))


def gaussian_tanh(sigma: object, bias: object = 0.0) -> Described:
    """tanh u of a Gaussian u, by quadrature."""
    return _each(gaussian, *_signal(sigma, "deviation", bias))


def _each(described: Any, size: Array, bias: Array) -> Described:
    """tanh described at each amplitude or deviation; its bend at 0 is treated as a corner, which a steep one is."""
    each = [described(np.tanh, a, b, breaks=(0.0,)) for a, b in zip(size.flat, bias.flat, strict=True)]
    gain = np.reshape([point.gain.real for point in each], size.shape)
    mean = np.reshape([point.mean for point in each], size.shape)
    return Described(gain[()], mean[()], max((point.error for point in each), default=0.0))


def _steps(a: float, b: float) -> tuple[float, float]:
    """Gain and mean of floor(u + 1/2) at u = b + a sin(theta); its steps lie at k + 1/2, k = first ... last."""
    if a > _SO_MANY:
        return 1.0, b
    first, last = math.ceil(b - a - 0.5), math.floor(b + a - 0.5)
    number, level = last - first + 1, math.floor(b + 0.5)
    few = number <= 2 * _SUMMED
    k = np.arange(number) if few else np.concatenate((np.arange(_SUMMED), np.arange(number - _SUMMED, number)))
    x = np.clip((first + k + 0.5 - b) / a, -1.0, 1.0)
    roots, angles = float(np.sum(np.sqrt(1.0 - x * x))), float(np.sum(np.arcsin(x)))
    if not few:
        # Away from the ends a sum is the integral, corrected by -(f' at the end - f' at the start)/24.
        lo, hi = (first + _SUMMED - b) / a, (last - _SUMMED + 1 - b) / a
        root_lo, root_hi = math.sqrt(1.0 - lo * lo), math.sqrt(1.0 - hi * hi)
        angle_lo, angle_hi = math.asin(lo), math.asin(hi)
        roots += 0.5 * a * (angle_hi - angle_lo + hi * root_hi - lo * root_lo)
        roots += (hi / root_hi - lo / root_lo) / (24.0 * a)
        angles += a * (hi * angle_hi - lo * angle_lo + root_hi - root_lo)
        angles -= (1.0 / root_hi - 1.0 / root_lo) / (24.0 * a)
    # Of each step u is above for arccos(x)/pi of the time, and steps below the level of the bias count from it.
    return 2.0 / (math.pi * a) * roots, level + 0.5 * number - (level - first) - angles / math.pi


def _reach(at: float, A: Array, bias: Array) -> Array:
    """sin(theta) where u reaches `at`; -1 or 1 where it is always above or below."""
    return np.asarray(np.clip((at - bias) / A, -1.0, 1.0))


def _density(z: Any) -> Any:
    return np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


def _between(a: Array, b: Array) -> Array:
    """Share of a Gaussian signal within a ... b deviations, from the nearer tail."""
    return np.asarray(np.where(a > 0.0, ndtr(-a) - ndtr(-b), ndtr(b) - ndtr(a)))


def _beyond(z: Array) -> Array:
    """Mean of max(s - z, 0) for a Gaussian s of deviation 1."""
    return np.asarray(_density(z) - _held(z, ndtr(-z)))


def _held(value: Any, share: Array) -> Array:
    """value * share; 0 where the share is 0, whatever the value."""
    return np.asarray(np.multiply(value, share, out=np.zeros(np.shape(share)), where=share > 0.0))


def _described(gain: object, mean: object) -> Described:
    return Described(np.asarray(gain)[()], np.asarray(mean)[()])


def _odd(gain: Any) -> Described:
    return _described(gain, np.zeros(np.shape(gain)))


def _signal(size: object, name: str, bias: object) -> tuple[Array, Array]:
    size, bias = positive(size, name), np.asarray(bias, dtype=float)
    if not np.all(np.isfinite(bias)):
        raise refused("a bias is not finite.", "Give a finite bias.")
    a, b = np.broadcast_arrays(size, bias)
    return a, b


def _exponent(a: float) -> float:
    a = float(a)
    if not -1.0 < a < math.inf:
        raise refused(f"the exponent is {a:g}.", "Give a finite exponent above -1.")
    return a


def _limits(lower: float, upper: float) -> tuple[float, float]:
    lower, upper = float(lower), float(upper)
    if not lower < upper:
        raise refused(f"the limits are {lower:g} and {upper:g}.", "Give a lower limit below the upper one.")
    return lower, upper
