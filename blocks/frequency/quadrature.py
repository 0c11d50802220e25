"""What a static law makes of sinusoids and of Gaussian signals: its mean, its gain and its harmonics, by quadrature.

    sinusoidal(np.tanh, A=2.0)                               # of one signal: bias + A sin(theta)
    sinusoidal(f, 0.1, bias=0.3, breaks=breaks_of(f, -1, 1))
    gaussian(np.tanh, sigma=2.0)                             # of a Gaussian signal
    fundamental(f, [1j, 0.2], [0.0, 0.0])                    # of several signals of one frequency
    harmonics(np.tanh, 2.0, 0.0, 5)                          # what the gain leaves out

A law is a function that maps an array of inputs to the array of outputs, element by element. Where it has corners,
jumps or infinite slopes, `breaks` says at which inputs; the quadrature then runs from break to break, and each panel
costs about a hundred values of the law for an error near rounding. Breaks that are not given are found by halving the
panels that do not converge, at some ten times the cost.

Each panel is integrated by the tanh-sinh rule, whose nodes crowd towards the ends so fast that an algebraic
singularity there (|e|^0.84 at e = 0) costs no accuracy. The error is estimated from the rules of two and four times
the step on the same values. A feature so narrow that no node meets it remains unseen, as by every quadrature.

References: H. Takahasi, M. Mori, Double exponential formulas for numerical integration, Publ. RIMS 9, 1974;
A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions, McGraw-Hill, 1968.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array
from .law_corners import Law, finite, positive, refused, sign_changes, switched, undescribed, values

_EPS = float(np.finfo(float).eps)
_TOLERANCE = 1e-13  # of the integral of |f|; what is left of it in a gain is below 1e-12
_PANELS = 8192  # more than that, and the law is noise or has corners without number
_ROUNDS = 64  # of halving: a panel of pi is then below the spacing of floats
_STALL = 6  # rounds without progress after which the estimate is given as it is
_CAUTION = 10.0  # differences that hide a corner are at times smaller than the error
_TINY = float(np.finfo(float).tiny)
_CHUNK = 1024  # panels of one call of the law, so that its arrays stay within the cache or near
_HUGE = 1e290  # beyond it sums overflow
_TAIL = 13.0  # deviations: beyond them lies 1e-38 of a Gaussian signal


@dataclass(frozen=True, slots=True)
class Described:
    """What a law makes of a sinusoid or a Gaussian signal: output = mean + gain (input - bias) + what is left.

    gain: of the fundamental, complex where there is hysteresis; of a Gaussian s, E[f s]/sigma^2. mean: of the output.
    error: estimate of the absolute error of the gain; that of the mean is at most A (or sigma) times it; 0 of a closed
    form. gain and mean have the shape of A where an array of amplitudes was given.
    """

    gain: Any
    mean: Any
    error: float = 0.0


@dataclass(frozen=True, slots=True)
class Spectrum:
    """y = mean + sum over k = 1, 2, ... of Im(harmonics[k - 1] exp(j k theta)).

    error: estimate of the absolute error of the mean and of each harmonic.
    """

    mean: float
    harmonics: Array
    error: float

    @property
    def fundamental(self) -> complex:
        return complex(self.harmonics[0])

    @property
    def distortion(self) -> float:
        """Root of the sum of the squares of the higher harmonics over the fundamental; inf without a fundamental."""
        higher, first = float(np.linalg.norm(self.harmonics[1:])), abs(self.fundamental)
        if first > self.error:
            return higher / first
        return math.inf if higher > self.error else 0.0


def sinusoidal(f: Law, A: float, bias: float = 0.0, *, breaks: Sequence[float] | Array = ()) -> Described:
    """Describing function of y = f(u) at u = bias + A sin(theta): gain = 2 <f sin>/A and mean = <f>, to 1e-12 of |f|.

    f maps an array of shape (n,) to one of its shape. breaks: inputs at which it has corners, jumps or infinite slopes.

    Raises: UsageError E501 (A not above 0), AnalysisError E704 (f is not finite somewhere on the sinusoid).
    """
    A, bias = float(positive(A, "amplitude")), finite(bias, "bias")

    def sample(theta: Array, lo: Array, hi: Array) -> tuple[Array, Array]:
        s = np.sin(theta)
        return values(f, _within(A, bias, s, lo, hi)), np.stack((np.ones_like(s), s))

    # f(bias + A sin(theta)) is even about pi/2: half the circle holds everything.
    total, error, middle = _integrate(sample, _sine_cuts(A, bias, breaks), (abs(bias) + A) / A, _input(A, bias))
    mean_error, gain_error = (error / math.pi).tolist()
    return Described(
        complex(2.0 / (math.pi * A) * float(total[1])),
        middle + float(total[0]) / math.pi,
        max(2.0 * gain_error, mean_error) / A,
    )


def gaussian(f: Law, sigma: float, bias: float = 0.0, *, breaks: Sequence[float] | Array = ()) -> Described:
    """Random-input describing function of y = f(u) at u = bias + s, s Gaussian of deviation sigma.

    gain = E[f s]/sigma^2, which makes E[(f - mean - gain s)^2] smallest, and mean = E[f]. f is read up to 13 sigma from
    the bias. For f, breaks and what is raised see `sinusoidal`.
    """
    sigma, bias = float(positive(sigma, "deviation")), finite(bias, "bias")

    def sample(s: Array, _lo: Array, _hi: Array) -> tuple[Array, Array]:
        density = np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi)
        return values(f, bias + sigma * s), np.stack((density, density * s))

    inner = (np.asarray(breaks, dtype=float) - bias) / sigma
    cuts = np.union1d((-_TAIL, -6.0, -2.5, 0.0, 2.5, 6.0, _TAIL), inner[np.abs(inner) < _TAIL])
    total, error, middle = _integrate(sample, cuts, (abs(bias) + sigma) / sigma, lambda s: f"u = {bias + sigma * s:g}")
    ends = values(f, bias + sigma * np.array([-_TAIL, _TAIL])) - middle
    if np.max(np.abs(ends)) * _TAIL * math.exp(-0.5 * _TAIL**2) > _TOLERANCE * float(np.max(np.abs(total) + error)):
        raise undescribed(
            f"the law grows so fast that inputs beyond {_TAIL:g} deviations of {sigma:g} matter.",
            "Give a smaller deviation, or describe the law for a sinusoid.",
        )
    return Described(complex(total[1] / sigma), middle + float(total[0]), float(max(error[1], error[0]) / sigma))


def harmonics(f: Law, A: float, bias: float = 0.0, count: int = 5, *, breaks: Sequence[float] | Array = ()) -> Spectrum:
    """Mean and the first `count` harmonics of y = f(bias + A sin(theta)): odd ones are real, even ones imaginary.

    For f, breaks and what is raised see `sinusoidal`.
    """
    A, bias, order = float(positive(A, "amplitude")), finite(bias, "bias"), _orders(count)[:, None, None]

    def sample(theta: Array, lo: Array, hi: Array) -> tuple[Array, Array]:
        angle = order * theta
        kernels = np.where(order % 2 == 1, np.sin(angle), np.cos(angle))
        u = _within(A, bias, np.sin(theta), lo, hi)
        return values(f, u), np.concatenate((np.ones_like(theta)[None], kernels))

    total, error, middle = _integrate(sample, _sine_cuts(A, bias, breaks), (abs(bias) + A) / A, _input(A, bias))
    phasors = 2.0 / math.pi * total[1:] * np.where(order[:, 0, 0] % 2 == 1, 1.0, 1.0j)
    return Spectrum(middle + float(total[0]) / math.pi, phasors, float(2.0 / math.pi * np.max(error)))


def fundamental(
    f: Law,
    phasors: Sequence[complex] | Array,
    biases: Sequence[float] | Array,
    *,
    count: int = 1,
    switches: Law | None = None,
) -> Spectrum:
    """Mean and harmonics of y = f(u_1, ..., u_m) at u_i = biases[i] + Im(phasors[i] exp(j theta)).

    f maps an array of shape (m, n), a row for each signal, to one of shape (n,). switches: maps the same array to one
    of shape (n, k), whose columns change sign where f has a corner or a jump (what stands in |.|, sgn and comparisons);
    these places are then located in theta. Without it they are closed in on by halving, which costs more.

    Raises: UsageError E501 (numbers that do not fit or are not finite), AnalysisError E704 (f is not finite somewhere).
    """
    U, b = np.asarray(phasors, dtype=complex), np.asarray(biases, dtype=float)
    if U.ndim != 1 or U.shape != b.shape or not U.size:
        raise refused(
            f"there are phasors of shape {U.shape} and biases of shape {b.shape}.",
            "Give one phasor and one bias for each signal.",
        )
    if not (np.all(np.isfinite(U)) and np.all(np.isfinite(b))):
        raise refused("a phasor or a bias is not finite.", "Give finite numbers.")
    order = _orders(count)[:, None, None]
    real, imag, offset = U.real[:, None], U.imag[:, None], b[:, None]

    def inputs(theta: Array) -> Array:
        return np.asarray(offset + real * np.sin(theta) + imag * np.cos(theta))

    def sample(theta: Array, _lo: Array, _hi: Array) -> tuple[Array, Array]:
        angle, u = order * theta, inputs(theta.ravel())
        y = np.reshape(values(f, u, theta.size), theta.shape)
        return y, np.concatenate((np.ones_like(theta)[None], np.sin(angle), np.cos(angle)))

    cuts = np.linspace(-math.pi, math.pi, 5)
    if switches is not None:
        # The grid begins off the axes: where a signal passes 0 at a round angle, both sides of it are then seen.
        grid = np.linspace(-math.pi, math.pi, 385) + 0.00437
        switch_angles = sign_changes(lambda theta: switched(switches, inputs(theta), theta.size), grid)
        cuts = np.union1d(cuts, np.where(switch_angles > math.pi, switch_angles - 2.0 * math.pi, switch_angles))
    # Of the signal that goes furthest, so that one that hardly moves does not loosen the tolerance.
    resolution = 1.0 + float(np.min(np.abs(b) / np.where(U == 0.0, np.inf, np.abs(U))))
    total, error, middle = _integrate(
        sample, cuts, resolution, lambda theta: f"u = ({', '.join(f'{u:g}' for u in inputs(np.array([theta])).flat)})"
    )
    half = (len(total) - 1) // 2
    coefficients = (total[1 : half + 1] + 1j * total[half + 1 :]) / math.pi
    return Spectrum(
        middle + float(total[0]) / (2.0 * math.pi), coefficients, float(np.max(error) * math.sqrt(2.0) / math.pi)
    )


def _sine_cuts(A: float, bias: float, breaks: Sequence[float] | Array) -> Array:
    """theta of the ends of the panels in -pi/2 ... pi/2: the breaks, and 0, as two panels resolve smooth laws."""
    inner = {math.asin((at - bias) / A) for at in breaks if abs(at - bias) < A}
    return np.array(sorted(inner | {-0.5 * math.pi, 0.0, 0.5 * math.pi}))


def _within(A: float, bias: float, s: Array, lo: Array, hi: Array) -> Array:
    """bias + A s, off the ends of the panels lo ... hi by some roundings.

    A node that rounds to a break would see the law there, and not beside it. Where the sinusoid turns at the break such
    nodes make up 1e-8 of it.
    """
    a, b = bias + A * np.sin(lo), bias + A * np.sin(hi)
    size = 4.0 * _EPS
    a, b = a + size * np.maximum(np.abs(a), abs(bias)), b - size * np.maximum(np.abs(b), abs(bias))
    return np.asarray(np.clip(bias + A * s, a[:, None], np.maximum(a, b)[:, None]))


def _input(A: float, bias: float) -> Tell:
    return lambda theta: f"u = {bias + A * math.sin(theta):g}"


def _rule() -> tuple[Array, Array]:
    """Nodes of the tanh-sinh rule as distances to the nearer end, and its weights for the steps 1/16, 1/8 and 1/4.

    On -1 ... 1; shapes (n,) and (n, 3). At the last node, t = 51/16, the weight is 1e-16.
    """
    k = np.arange(-51, 52)
    t = k / 16.0
    s = 0.5 * math.pi * np.sinh(t)
    weights = math.pi / 32.0 * np.cosh(t) / np.cosh(s) ** 2
    steps = [weights, np.where(k % 2 == 0, 2.0 * weights, 0.0), np.where(k % 4 == 0, 4.0 * weights, 0.0)]
    return np.exp(-np.abs(s)) / np.cosh(s), np.stack(steps, axis=1)


_NEAR, _WEIGHTS = _rule()
_MIDDLE = len(_NEAR) // 2

Sample = Callable[[Array, Array, Array], tuple[Array, Array]]
Tell = Callable[[float], str]


def _integrate(sample: Sample, cuts: Array, resolution: float, tell: Tell) -> tuple[Array, Array, float]:
    """Integrals of (y - c) K_i over cuts[0] ... cuts[-1], estimates of their errors, and c; K_0 is positive.

    sample: values y of shape (p, n) and kernels K of shape (m, p, n) at places of shape (p, n) in p panels, of which
    the lower and the upper ends follow. c lies amid the values: what is integrated is how y varies, so that a large
    constant neither costs digits nor loosens the tolerance. resolution: how many roundings of 1 the inputs of the law
    are off by, relative to how far they go. tell: words for the inputs at a place.
    """
    lo, hi = cuts[:-1], cuts[1:]
    center = slice(max(0, len(lo) // 2 - _CHUNK // 2), len(lo) // 2 + _CHUNK // 2)
    y, kernels = _sampled(sample, lo[center], hi[center], tell)
    weights = kernels[0] * _WEIGHTS[:, 0] * (0.5 * (hi - lo))[center, None]
    weight = float(weights.sum())
    middle = float((y * weights).sum()) / weight
    if len(lo) <= _CHUNK:
        total, error, size = _summed(y, kernels, middle, hi - lo)
    else:
        total, error, size = _panels(sample, lo, hi, middle, tell)
    # No quadrature is better than the values: those are rounded, and so are the inputs that they stand for.
    whole = float(size[0].sum())
    noise = 2.0 * _EPS * (abs(middle) * weight + resolution * whole)
    best, stalled = math.inf, 0
    for _ in range(_ROUNDS):
        target = _TOLERANCE * size.sum(axis=1, keepdims=True) + noise
        excess = float((error.sum(axis=1, keepdims=True) / np.maximum(target, _TINY)).max())
        if excess <= 1.0:
            break
        stalled = 0 if excess < 0.9 * best else stalled + 1
        best = min(best, excess)
        bad = np.any(error > 0.5 * target / len(lo), axis=0)
        bad &= hi - lo > 8.0 * _EPS * np.maximum(np.abs(lo), np.abs(hi))
        if stalled >= _STALL or not np.any(bad) or len(lo) + np.count_nonzero(bad) > max(_PANELS, 4 * len(cuts)):
            break
        mid = 0.5 * (lo[bad] + hi[bad])
        new_lo, new_hi = np.concatenate((lo[bad], mid)), np.concatenate((mid, hi[bad]))
        new = _panels(sample, new_lo, new_hi, middle, tell)
        keep = ~bad
        total, error, size = (
            np.concatenate((a[:, keep], b), axis=1) for a, b in zip((total, error, size), new, strict=True)
        )
        lo, hi = np.concatenate((lo[keep], new_lo)), np.concatenate((hi[keep], new_hi))
    return total.sum(axis=1), error.sum(axis=1) + noise, middle


def _panels(sample: Sample, lo: Array, hi: Array, middle: float, tell: Tell) -> tuple[Array, ...]:
    """What `_summed` gives, for any number of panels."""
    parts = []
    for i in range(0, len(lo), _CHUNK):
        a, b = lo[i : i + _CHUNK], hi[i : i + _CHUNK]
        parts.append(_summed(*_sampled(sample, a, b, tell), middle, b - a))
    return parts[0] if len(parts) == 1 else tuple(np.concatenate(each, axis=1) for each in zip(*parts, strict=True))


def _sampled(sample: Sample, lo: Array, hi: Array, tell: Tell) -> tuple[Array, Array]:
    """Values and kernels at the nodes of panels."""
    apart = (0.5 * (hi - lo))[:, None] * _NEAR
    # From the nearer end, so that a panel that begins at 0 has its nodes at full relative accuracy.
    places = np.concatenate((lo[:, None] + apart[:, :_MIDDLE], hi[:, None] - apart[:, _MIDDLE:]), axis=1)
    y, kernels = sample(places, lo, hi)
    if not (np.abs(y) < _HUGE).all():
        y = _mended(y)
        if np.any(lost := ~(np.abs(y) < _HUGE)):
            raise undescribed(
                f"the law gives {y[lost][0]:g} at {tell(float(places[lost][0]))}.",
                "Give inputs at which the law is defined, or estimate the response by simulation.",
            )
    return y, kernels


def _summed(y: Array, kernels: Array, middle: float, width: Array) -> tuple[Array, Array, Array]:
    """Integrals over panels, their errors, and those of the absolute values: shape (m, p) each."""
    terms, half = (y - middle) * kernels, 0.5 * width
    sums = terms @ _WEIGHTS
    fine, coarse = sums[..., 0], sums[..., 1]
    size = np.abs(terms) @ _WEIGHTS[:, 0]
    scale = 1.0 / np.maximum(size, _TINY)
    once, twice = np.abs(fine - coarse) * scale, np.abs(coarse - sums[..., 2]) * scale
    # Where f is smooth each difference is about the square of the one before, and the fine sum far better than the
    # last. Not so at a weak corner, which hides in a first difference that the rest of f dominates: the last counts,
    # and the cube of the first where the last is small by chance.
    error = np.maximum(_CAUTION * once, np.minimum(twice, twice**3))
    return fine * half, (error + 4.0 * _EPS) * size * half, size * half


def _mended(y: Array) -> Array:
    """Values of a law that is not defined just at a break (0/0): there, its value nearby within the panel."""
    y = y.copy()
    for row in y:
        known = np.flatnonzero(np.abs(row) < _HUGE)
        if not known.size:
            break
        # Nodes so near to an end round to it.
        begin, end = known[0], known[-1]
        if begin <= _MIDDLE and end >= _MIDDLE and max(_NEAR[:begin], default=0.0) < 1e-7:
            row[:begin] = row[begin]
        if begin <= _MIDDLE and end >= _MIDDLE and max(_NEAR[end + 1 :], default=0.0) < 1e-7:
            row[end + 1 :] = row[end]
    return y


def _orders(count: int) -> Array:
    if count < 1:
        raise refused(f"{count} harmonics were asked for.", "Ask for 1 or more.")
    return np.arange(1, int(count) + 1)
