"""What a static law makes of sinusoids and of Gaussian signals: its mean, its gain and its harmonics, by quadrature.

    sinusoidal(np.tanh, A=2.0)                               # of one signal: bias + A sin(theta)
    sinusoidal(f, 0.1, bias=0.3, breaks=breaks_of(f, -1, 1))
    gaussian(np.tanh, sigma=2.0)                             # of a Gaussian signal
    fundamental(f, [1j, 0.2], [0.0, 0.0])                    # of several signals of one frequency
    harmonics(np.tanh, 2.0, 0.0, 5)                          # what the gain leaves out

A law is a function that maps an array of inputs to the array of outputs, element by element. Where it has corners,
jumps or infinite slopes, `breaks` says at which inputs; the quadrature then runs from break to break, and each panel
costs about a hundred values of the law for an error near rounding. What is not told is found by halving the panels
that do not converge, at some ten times the cost.

Each panel is integrated by the tanh-sinh rule, whose nodes crowd towards the ends so fast that an algebraic
singularity there (|e|^0.84 at e = 0) costs no accuracy. The error is estimated from the rules of two and four times
the step on the same values. A feature so narrow that no node meets it remains unseen, as by every quadrature.

References: H. Takahasi, M. Mori, Double exponential formulas for numerical integration, Publ. RIMS 9, 1974;
T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm, Adv. Eng. Software 28, 1997 (roots);
A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions, McGraw-Hill, 1968.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import AnalysisError, Fault, UsageError

__all__ = ["Described", "Spectrum", "breaks_of", "fundamental", "gaussian", "harmonics", "refused", "sinusoidal"]

Array = np.ndarray[Any, Any]
Law = Callable[[Array], Any]

_EPS = float(np.finfo(float).eps)
_TOLERANCE = 1e-13  # of the integral of |f|; what is left of it in a gain is below 1e-12
_PANELS = 8192  # more than that, and the law is noise or has corners without number
_ROUNDS = 64  # of halving: a panel of pi is then below the spacing of floats
_STALL = 6  # rounds without progress after which the estimate is given as it is
_TINY = float(np.finfo(float).tiny)
_CHUNK = 1024  # panels of one call of the law, so that its arrays stay within the cache or near
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
        return higher / first if first else (math.inf if higher else 0.0)


def refused(message: str, cure: str) -> UsageError:
    """E501 of a call of a describing function."""
    return UsageError(Fault("E501", "describing function", message, cure))


def sinusoidal(f: Law, A: float, bias: float = 0.0, *, breaks: Sequence[float] | Array = ()) -> Described:
    """Describing function of y = f(u) at u = bias + A sin(theta): gain = 2 <f sin>/A and mean = <f>, to 1e-12 of |f|.

    f maps an array of shape (n,) to one of its shape. breaks: inputs at which it has corners, jumps or infinite slopes.

    Raises: UsageError E501 (A not above 0), AnalysisError E704 (f is not finite somewhere on the sinusoid).
    """
    A, bias = _checked(A, "amplitude"), _finite(bias, "bias")

    def sample(theta: Array) -> tuple[Array, Array]:
        s = np.sin(theta)
        return _values(f, bias + A * s), np.stack((np.ones_like(s), s))

    # f(bias + A sin(theta)) is even about pi/2: half the circle holds everything.
    total, error, middle = _integrate(sample, _sine_cuts(A, bias, breaks), (abs(bias) + A) / A)
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
    sigma, bias = _checked(sigma, "deviation"), _finite(bias, "bias")

    def sample(s: Array) -> tuple[Array, Array]:
        density = np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi)
        return _values(f, bias + sigma * s), np.stack((density, density * s))

    inner = (np.asarray(breaks, dtype=float) - bias) / sigma
    cuts = np.union1d((-_TAIL, -4.0, 0.0, 4.0, _TAIL), inner[np.abs(inner) < _TAIL])
    total, error, middle = _integrate(sample, cuts, (abs(bias) + sigma) / sigma)
    return Described(complex(total[1] / sigma), middle + float(total[0]), float(max(error[1], error[0]) / sigma))


def harmonics(f: Law, A: float, bias: float = 0.0, count: int = 5, *, breaks: Sequence[float] | Array = ()) -> Spectrum:
    """Mean and the first `count` harmonics of y = f(bias + A sin(theta)): odd ones are real, even ones imaginary.

    For f, breaks and what is raised see `sinusoidal`.
    """
    A, bias, order = _checked(A, "amplitude"), _finite(bias, "bias"), _orders(count)[:, None, None]

    def sample(theta: Array) -> tuple[Array, Array]:
        angle = order * theta
        kernels = np.where(order % 2 == 1, np.sin(angle), np.cos(angle))
        return _values(f, bias + A * np.sin(theta)), np.concatenate((np.ones_like(theta)[None], kernels))

    total, error, middle = _integrate(sample, _sine_cuts(A, bias, breaks), (abs(bias) + A) / A)
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

    def sample(theta: Array) -> tuple[Array, Array]:
        angle, u = order * theta, inputs(theta.ravel())
        y = np.reshape(_values(f, u, theta.size), theta.shape)
        return y, np.concatenate((np.ones_like(theta)[None], np.sin(angle), np.cos(angle)))

    cuts = np.linspace(-math.pi, math.pi, 5)
    if switches is not None:
        # The grid begins off the axes: where a signal passes 0 at a round angle, both sides of it are then seen.
        grid = np.linspace(-math.pi, math.pi, 385) + 0.00437
        found = _sign_changes(lambda theta: _switched(switches, inputs(theta), theta.size), grid)
        cuts = np.union1d(cuts, np.where(found > math.pi, found - 2.0 * math.pi, found))
    scale = np.abs(U)
    resolution = float(np.max((np.abs(b) + scale) / np.where(scale > 0, scale, np.inf), initial=1.0))
    total, error, middle = _integrate(sample, cuts, resolution)
    half = (len(total) - 1) // 2
    made = (total[1 : half + 1] + 1j * total[half + 1 :]) / math.pi
    return Spectrum(middle + float(total[0]) / (2.0 * math.pi), made, float(np.max(error) * math.sqrt(2.0) / math.pi))


def breaks_of(f: Law, low: float, high: float, switches: Law | None = None) -> tuple[float, ...]:
    """Inputs in low ... high at which f has corners, jumps or infinite slopes, for `breaks` of the functions here.

    switches: maps an array of shape (n,) to one of shape (n, k), whose columns change sign there (what stands in |.|,
    sgn and comparisons); without it f is looked at itself: intervals are halved where a polynomial does not follow it.
    A column that touches 0 between two points of the scan, which is dense around 0, may be missed where it is not
    smooth; f itself is then off by little.

    Raises: UsageError E501 (no interval).
    """
    low, high = _finite(low, "lower end"), _finite(high, "upper end")
    if not low < high:
        raise refused(f"{low:g} ... {high:g} is no interval.", "Give the lower end first.")
    if switches is None:
        return _rough(f, low, high)
    given = switches
    reach = max(abs(low), abs(high))
    fine = reach * np.geomspace(1e-12, 1.0, 241)
    grid = np.union1d(np.linspace(low, high, 1025), np.concatenate((-fine, fine)))
    grid = grid[(grid >= low) & (grid <= high)]
    return tuple(_sign_changes(lambda u: _switched(given, u, u.size), grid).tolist())


def _sine_cuts(A: float, bias: float, breaks: Sequence[float] | Array) -> Array:
    """theta of the ends of the panels in -pi/2 ... pi/2: the breaks, and 0, as two panels resolve smooth laws."""
    inner = {math.asin((at - bias) / A) for at in breaks if abs(at - bias) < A}
    return np.array(sorted(inner | {-0.5 * math.pi, 0.0, 0.5 * math.pi}))


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

Sample = Callable[[Array], tuple[Array, Array]]


def _integrate(sample: Sample, cuts: Array, resolution: float) -> tuple[Array, Array, float]:
    """Integrals of (y - c) K_i over cuts[0] ... cuts[-1], estimates of their errors, and c; K_0 is positive.

    sample: values y of shape (p, n) and kernels K of shape (m, p, n) at places of shape (p, n). c lies amid the values:
    what is integrated is how y varies, so that a large constant neither costs digits nor loosens the tolerance.
    resolution: how many roundings of 1 the inputs of the law are off by, relative to how far they go.
    """
    lo, hi = cuts[:-1], cuts[1:]
    center = slice(max(0, len(lo) // 2 - _CHUNK // 2), len(lo) // 2 + _CHUNK // 2)
    y, kernels = _sampled(sample, lo[center], hi[center])
    weights = kernels[0] * _WEIGHTS[:, 0] * (0.5 * (hi - lo))[center, None]
    weight = float(weights.sum())
    middle = float((y * weights).sum()) / weight
    if len(lo) <= _CHUNK:
        total, error, size = _summed(y, kernels, middle, hi - lo)
    else:
        total, error, size = _panels(sample, lo, hi, middle)
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
        new = _panels(sample, new_lo, new_hi, middle)
        keep = ~bad
        total, error, size = (
            np.concatenate((a[:, keep], b), axis=1) for a, b in zip((total, error, size), new, strict=True)
        )
        lo, hi = np.concatenate((lo[keep], new_lo)), np.concatenate((hi[keep], new_hi))
    return total.sum(axis=1), error.sum(axis=1) + noise, middle


def _panels(sample: Sample, lo: Array, hi: Array, middle: float) -> tuple[Array, ...]:
    """What `_summed` gives, for any number of panels."""
    parts = []
    for i in range(0, len(lo), _CHUNK):
        a, b = lo[i : i + _CHUNK], hi[i : i + _CHUNK]
        parts.append(_summed(*_sampled(sample, a, b), middle, b - a))
    return parts[0] if len(parts) == 1 else tuple(np.concatenate(each, axis=1) for each in zip(*parts, strict=True))


def _sampled(sample: Sample, lo: Array, hi: Array) -> tuple[Array, Array]:
    """Values and kernels at the nodes of panels."""
    apart = (0.5 * (hi - lo))[:, None] * _NEAR
    # From the nearer end, so that a panel that begins at 0 has its nodes at full relative accuracy.
    places = np.concatenate((lo[:, None] + apart[:, :_MIDDLE], hi[:, None] - apart[:, _MIDDLE:]), axis=1)
    y, kernels = sample(places)
    return (y if np.isfinite(y).all() else _mended(y)), kernels


def _summed(y: Array, kernels: Array, middle: float, width: Array) -> tuple[Array, Array, Array]:
    """Integrals over panels, their errors, and those of the absolute values: shape (m, p) each."""
    terms, half = (y - middle) * kernels, 0.5 * width
    sums = terms @ _WEIGHTS
    fine, coarse = sums[..., 0], sums[..., 1]
    size = np.abs(terms) @ _WEIGHTS[:, 0]
    scale = 1.0 / np.maximum(size, _TINY)
    once, twice = np.abs(fine - coarse) * scale, np.abs(coarse - sums[..., 2]) * scale
    # Where f is smooth each difference is about the square of the one before, so that the fine sum is far better than
    # the last of them. Where it is not, the last counts, or the square of the first where the last is small by chance.
    smooth = (twice < 1e-3) & (once <= twice * np.sqrt(twice))
    error = np.where(smooth, np.maximum(once * np.sqrt(once), twice**3), np.maximum(once, np.minimum(twice, twice**2)))
    return fine * half, (error + 4.0 * _EPS) * size * half, size * half


def _mended(y: Array) -> Array:
    """Values of a law that is not defined just at a break (0/0): there, its value nearby within the panel."""
    y = y.copy()
    for row in y:
        finite = np.flatnonzero(np.isfinite(row))
        if not finite.size:
            break
        # Nodes so near to an end round to it.
        begin, end = finite[0], finite[-1]
        if begin <= _MIDDLE and end >= _MIDDLE and max(_NEAR[:begin], default=0.0) < 1e-7:
            row[:begin] = row[begin]
        if begin <= _MIDDLE and end >= _MIDDLE and max(_NEAR[end + 1 :], default=0.0) < 1e-7:
            row[end + 1 :] = row[end]
    if not np.all(np.isfinite(y)):
        value = y[~np.isfinite(y)][0]
        raise AnalysisError(
            Fault(
                "E704",
                "describing function",
                f"the law gives {value:g} within the range of its inputs.",
                "Take a bias and an amplitude at which it is defined, or estimate the response by simulation.",
            )
        )
    return y


def _values(f: Law, u: Array, size: int | None = None) -> Array:
    """f at all inputs at once: u of any shape, or rows of inputs where `size` says how many."""
    flat = u if size is not None else u.ravel()
    with np.errstate(all="ignore"):
        y = np.asarray(f(flat), dtype=float)
    count = flat.size if size is None else size
    if y.shape == (count,):
        return y if size is not None else y.reshape(u.shape)
    if y.ndim == 0:
        return np.full(u.shape if size is None else (count,), float(y))
    raise refused(
        f"the law gives an array of shape {y.shape} for {count} inputs.", "It must give one output for each input."
    )


def _switched(switches: Law, u: Array, count: int) -> Array:
    """Quantities that mark corners and jumps, of shape (n, k); NaN where they are not defined."""
    with np.errstate(all="ignore"):
        g = np.asarray(switches(u), dtype=float)
    if g.ndim == 1 and g.shape == (count,):
        g = g[:, None]
    if g.ndim != 2 or len(g) != count:
        raise refused(f"the switches give an array of shape {g.shape} for {count} inputs.", "They must give (n, k).")
    return g


def _sign_changes(g: Callable[[Array], Array], grid: Array) -> Array:
    """Places at which columns of g (shape (n, k) at n places) change sign, increasing, each once."""
    values = g(grid)
    if not values.shape[1]:
        return np.empty(0)
    sign = np.sign(values)
    opposite = sign[:-1] * sign[1:] == -1.0
    row, column = np.nonzero(opposite)
    lo, hi = [grid[row]], [grid[row + 1]]
    columns = [column]
    g_lo, g_hi = [values[row, column]], [values[row + 1, column]]

    # A column that comes near 0 between two points and turns: its least absolute value may lie beyond 0.
    size = np.abs(values)
    turns = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]) & (sign[:-2] * sign[2:] == 1.0) & (sign[1:-1] != 0.0)
    turns &= (sign[1:-1] == sign[:-2]) & ((size[1:-1] < size[:-2]) | (size[1:-1] < size[2:]))
    row, column = np.nonzero(turns)
    if row.size:
        at, value = _least(g, grid[row], grid[row + 2], column, sign[row + 1, column])
        hit = value * sign[row + 1, column] < 0.0
        row, column, at, value = row[hit], column[hit], at[hit], value[hit]
        lo += [grid[row], at]
        hi += [at, grid[row + 2]]
        g_lo += [values[row, column], value]
        g_hi += [value, values[row + 2, column]]
        columns += [column, column]
    roots = _roots(g, *(np.concatenate(each) for each in (lo, hi, g_lo, g_hi, columns)))

    # Exactly 0 at a point of the grid, or 0 along a stretch whose ends count.
    zero = np.pad(sign == 0.0, ((1, 1), (0, 0)))
    alone = zero[1:-1] & ~zero[:-2] & ~zero[2:]
    long = zero[1:-1] & ~alone
    row, column = np.nonzero((long[:-1] != long[1:]) & ~np.isnan(sign[:-1]) & ~np.isnan(sign[1:]))
    ends = _ends(g, grid[row], grid[row + 1], column, sign[row, column] == 0.0)
    return _distinct(np.concatenate((roots, grid[np.any(alone, axis=1)], ends)), float(grid[-1] - grid[0]))


def _distinct(places: Array, width: float) -> Array:
    """Places in order, of those that rounding alone tells apart the one nearest to 0."""
    places = np.sort(places)
    kept: list[float] = []
    for place in places.tolist():
        if kept and place - kept[-1] <= 8.0 * _EPS * max(abs(place), 1e-13 * width):
            kept[-1] = min(kept[-1], place, key=abs)
        else:
            kept.append(place)
    return np.array(kept)


def _picked(g: Callable[[Array], Array], x: Array, column: Array) -> Array:
    return np.asarray(g(x)[np.arange(len(x)), column])


def _roots(g: Callable[[Array], Array], a: Array, b: Array, g_a: Array, g_b: Array, column: Array) -> Array:
    """Roots of columns of g in brackets, all at once, by Chandrupatla's method."""
    c, g_c = a, g_a
    t = np.full(len(a), 0.5)
    done = np.full(len(a), np.nan)
    left = np.arange(len(a))
    for _ in range(100):
        if not left.size:
            break
        x = a + t * (b - a)
        g_x = _picked(g, x, column)
        same = np.sign(g_x) == np.sign(g_a)
        c, g_c = np.where(same, a, b), np.where(same, g_a, g_b)
        b, g_b = np.where(same, b, a), np.where(same, g_b, g_a)
        a, g_a = x, g_x
        best = np.where(np.abs(g_a) < np.abs(g_b), a, b)
        # NaN inside a bracket ends it where it is: something is there.
        end = (np.abs(b - a) <= 4.0 * _EPS * np.abs(best)) | (g_a == 0.0) | ~np.isfinite(g_a)
        done[left[end]] = np.where(g_a == 0.0, a, best)[end]
        go = ~end
        left, a, b, c, g_a, g_b, g_c, column = (each[go] for each in (left, a, b, c, g_a, g_b, g_c, column))
        with np.errstate(all="ignore"):
            xi, phi = (a - b) / (c - b), (g_a - g_b) / (g_c - g_b)
            inverse = g_a / (g_b - g_a) * g_c / (g_b - g_c) + (c - a) / (b - a) * g_a / (g_c - g_a) * g_b / (g_c - g_b)
            trusted = (phi**2 < xi) & ((1.0 - phi) ** 2 < 1.0 - xi) & np.isfinite(inverse)
            least = np.minimum(2.0 * _EPS * np.abs(a) / np.abs(b - a), 0.5)
        t = np.clip(np.where(trusted, inverse, 0.5), least, 1.0 - least)
    done[left] = 0.5 * (a + b)
    return done


def _least(g: Callable[[Array], Array], a: Array, b: Array, column: Array, sign: Array) -> tuple[Array, Array]:
    """Where columns of sign * g are least in a ... b, by golden section, and g there; ends early beyond 0."""
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    x, y = b - ratio * (b - a), a + ratio * (b - a)
    g_x, g_y = _picked(g, x, column), _picked(g, y, column)
    for _ in range(40):
        # Once beyond 0 a place is kept: it is all that is asked for.
        left = g_x * sign < g_y * sign
        if np.all(np.minimum(g_x * sign, g_y * sign) < 0.0):
            break
        a, b = np.where(left, a, x), np.where(left, y, b)
        new = np.where(left, b - ratio * (b - a), a + ratio * (b - a))
        g_new = _picked(g, new, column)
        x, y = np.where(left, new, y), np.where(left, x, new)
        g_x, g_y = np.where(left, g_new, g_y), np.where(left, g_x, g_new)
    left = g_x * sign < g_y * sign
    return np.where(left, x, y), np.where(left, g_x, g_y)


def _ends(g: Callable[[Array], Array], a: Array, b: Array, column: Array, from_zero: Array) -> Array:
    """Where columns of g begin or cease to be 0 in a ... b, by halving; from_zero: it is 0 at a."""
    least = _EPS * (b - a)
    for _ in range(60):
        mid = 0.5 * (a + b)
        open_ = (mid > a) & (mid < b) & (b - a > least)
        if not np.any(open_):
            break
        zero = _picked(g, mid, column) == 0.0
        a = np.where(open_ & (zero == from_zero), mid, a)
        b = np.where(open_ & (zero != from_zero), mid, b)
    return np.where(from_zero, a, b)


def _rough(f: Law, low: float, high: float) -> tuple[float, ...]:
    """Places in low ... high that no halving makes smooth: where a polynomial of degree 16 still misses f."""
    k = np.arange(17)
    angle = (k + 0.5) * math.pi / 17.0
    # The three last Chebyshev coefficients.
    last = 2.0 / 17.0 * np.cos(np.outer(angle, (14, 15, 16)))
    # Unequal parts, here and below: a break at a round place would lie on an edge, where no polynomial sees it.
    edges = np.linspace(low, high, 34)
    edges[1:-1] += 0.1234567 * (edges[1] - edges[0])
    lo, hi = edges[:-1], edges[1:]
    scale = 0.0
    leaves: list[tuple[float, float, int]] = []
    for depth in range(46):
        y = _values(f, 0.5 * (lo + hi)[:, None] + 0.5 * (hi - lo)[:, None] * np.cos(angle))
        finite = np.all(np.isfinite(y), axis=1)
        if depth == 0:
            known = y[np.isfinite(y)]
            scale = float(np.max(known) - np.min(known)) if known.size else 0.0
            noise = 64.0 * _EPS * float(np.max(np.abs(known), initial=0.0))
        with np.errstate(all="ignore"):
            rough = ~finite | (np.max(np.abs(y @ last), axis=1) > 1e-12 * scale + noise)
        narrow = hi - lo <= 8.0 * _EPS * np.maximum(np.abs(lo), np.abs(hi))
        ended = ~rough | narrow if depth < 45 else np.ones_like(rough)
        if depth > 20:
            leaves += [(a, b, depth) for a, b in zip(lo[ended].tolist(), hi[ended].tolist(), strict=True)]
        lo, hi = lo[~ended], hi[~ended]
        if not lo.size or 2 * lo.size > _PANELS:
            break
        mid = lo + 0.4871 * (hi - lo)
        lo, hi = np.concatenate((lo, mid)), np.concatenate((mid, hi))
    return tuple(_place(group) for group in _joined(sorted(leaves)))


def _joined(leaves: list[tuple[float, float, int]]) -> list[list[tuple[float, float, int]]]:
    """Leaves that touch, as groups: each surrounds one break."""
    groups: list[list[tuple[float, float, int]]] = []
    for leaf in leaves:
        if groups and leaf[0] <= groups[-1][-1][1]:
            groups[-1].append(leaf)
        else:
            groups.append([leaf])
    return groups


def _place(group: list[tuple[float, float, int]]) -> float:
    """The break within a group of leaves: amid the narrowest; a round number there is preferred, 0 above all."""
    depth = max(leaf[2] for leaf in group)
    deepest = [leaf for leaf in group if leaf[2] == depth]
    a, b = deepest[0][0], deepest[-1][1]
    at, spread = 0.5 * (a + b), b - a
    for round_one in (0.0, float(f"{at:.6g}"), float(f"{at:.12g}")):
        if abs(round_one - at) <= spread:
            return round_one
    return at


def _checked(x: float, name: str) -> float:
    x = float(x)
    if not (x > 0.0 and math.isfinite(x)):
        raise refused(f"the {name} is {x:g}.", f"Give {'an' if name[0] in 'aeiou' else 'a'} {name} above 0.")
    return x


def _finite(x: float, name: str) -> float:
    x = float(x)
    if not math.isfinite(x):
        raise refused(f"the {name} is {x:g}.", "Give a finite number.")
    return x


def _orders(count: int) -> Array:
    if count < 1:
        raise refused(f"{count} harmonics were asked for.", "Ask for 1 or more.")
    return np.arange(1, int(count) + 1)
