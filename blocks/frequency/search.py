"""Searching over frequency: grids that show every pole and zero, crossings to the last digit, peaks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..text.arrays import Array
from .systems import Source, interpolated

_EPS = float(np.finfo(float).eps)
_PER_DECADE = 40
_SUMMITS = 100  # of a gain, which are searched


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest gain (largest singular value) over all frequencies, and where it is; 0 and inf are frequencies."""

    value: float
    frequency: float


def layout(known: Source, extra: Array | None = None) -> Array:
    """Frequencies that show every pole, zero and `extra` (as s): a few decades around them, dense at light damping."""
    if known.points is not None:
        return np.asarray(known.points[known.points > 0])
    features = known.features if known.features is not None else np.zeros(0, complex)
    if extra is not None:
        features = np.concatenate([features, extra])
    sizes = np.abs(features)
    sizes = sizes[np.isfinite(sizes) & (sizes > 1e-13 * np.max(sizes, initial=0.0))]
    if known.features is None:
        low, high = _reach(known)
    elif len(sizes):
        low, high = float(np.min(sizes)) * 1e-3, float(np.max(sizes)) * 1e3
    else:
        low, high = (1e-3, 1e3) if known.dt == 0 else (1e-4 * known.high, known.high)
    if known.dt > 0:
        low, high = min(low, 1e-4 * known.high), known.high
    if known.outputs == known.inputs == 1:
        low, high = _extended(known, low, high)
    count = max(8, math.ceil(_PER_DECADE * math.log10(high / low)))
    parts = [np.geomspace(low, high, count)]
    for feature in features[np.isfinite(features) & (np.abs(features) > 0)]:
        parts.append(_near(abs(feature.imag), abs(feature.real)))
    if known.dt > 0:
        parts.append(high * (1.0 - np.geomspace(1e-6, 0.5, _PER_DECADE)))
    omega = np.sort(np.concatenate(parts))  # what appears twice goes below; np.unique would load numpy.ma
    omega = omega[(omega >= low) & (omega <= high * (1 - 1e-12 if known.dt > 0 else 1))]
    return np.asarray(omega[np.concatenate([[True], np.diff(omega) > 1e-14 * omega[1:]])])


def _reach(known: Source) -> tuple[float, float]:
    """Limits for a system of which only the response is known: up to where it has fallen far below 1 and below its top.

    The phase of a delay turns without end; its crossings far above the loop's frequencies mean nothing.
    """
    low, high = (1e-4, 1e5) if known.dt == 0 else (1e-6 * known.high, known.high)
    omega = np.geomspace(low, high, 200)
    gains = np.max(np.abs(known.at(omega)), axis=(0, 1))
    felt = np.flatnonzero(gains > 1e-3 * min(1.0, float(np.max(gains))))
    if known.dt == 0 and len(felt) and felt[-1] + 1 < len(omega):
        high = float(omega[felt[-1] + 1])
    return low, high


def _near(center: float, width: float) -> Array:
    """Frequencies about a lightly damped pole; on the axis: close to it, but never at it."""
    if center == 0 or width > 0.4 * center:
        return np.zeros(0)
    middle = [center] if width > 1e-12 * center else []
    width = max(width, 1e-9 * center)
    away = np.geomspace(0.05 * width, 0.3 * center, max(8, math.ceil(10 * math.log10(6 * center / width))))
    return np.concatenate([center - away, middle, center + away])


def _extended(known: Source, low: float, high: float) -> tuple[float, float]:
    """Limits moved to where the gain has passed 1 for good: an integrator of any gain crosses somewhere."""
    with np.errstate(all="ignore"):
        ends = np.array([low, low * 1.1, high / 1.1, high])
        gains = np.log(np.abs(known.siso(ends)))
    step = math.log(1.1)
    if not np.all(np.isfinite(gains)):
        return low, high
    rise, fall = (gains[1] - gains[0]) / step, (gains[3] - gains[2]) / step
    # The straight line of slope n meets 0 dB at omega exp(-gain/n).
    if abs(rise) > 0.5 and gains[0] / rise > 0:
        low *= math.exp(max(-gains[0] / rise, -230.0)) / 10
    if known.dt == 0 and abs(fall) > 0.5 and gains[3] / fall < 0:
        high *= math.exp(min(-gains[3] / fall, 230.0)) * 10
    return low, high


def refined(f: Callable[[Array], Array], omega: Array, *, change: float = 0.12, passes: int = 9) -> tuple[Array, Array]:
    """A grid on which log f moves by no more than `change` between neighbors, and f on it, (..., len(omega)).

    change: of the natural logarithm, gain and phase together. Intervals at a jump (a pole on the axis) stay, after so
    many passes.
    """
    values = f(omega)
    for _ in range(passes):
        with np.errstate(all="ignore"):
            ratio = values[..., 1:] / values[..., :-1]
            moved = np.max(np.abs(np.log(ratio)).reshape(-1, len(omega) - 1), axis=0)
        wide = omega[1:] / omega[:-1] - 1.0 > 1e-9
        split = np.flatnonzero((moved > change) & wide & np.isfinite(moved))
        if not len(split) or len(omega) > 60_000:
            break
        between = np.sqrt(omega[split] * omega[split + 1])
        new = f(between)
        omega = np.insert(omega, split + 1, between)
        values = np.insert(values, split + 1, new, axis=-1)
    return omega, values


def root(f: Callable[[float], float], a: float, b: float) -> float:
    """The zero of f in [a, b], to the last digits; the better end, where both have one sign by rounding.

    By R. P. Brent, Algorithms for Minimization without Derivatives, 1973, chapter 4, with the steps of SciPy's brentq
    (xtol=1e-300, rtol=4 eps), which takes longer to import than the margins of a loop.
    """
    last, x = float(a), float(b)
    at_last, at_x = f(last), f(x)
    if at_last * at_x >= 0:
        return last if abs(at_last) <= abs(at_x) else x
    other, at_other, step, before = last, at_last, 0.0, 0.0
    for _ in range(300):
        if at_last and at_x and (at_last < 0) != (at_x < 0):
            other, at_other, step, before = last, at_last, x - last, x - last
        if abs(at_other) < abs(at_x):
            last, x, other, at_last, at_x, at_other = x, other, x, at_x, at_other, at_x
        least, half = (1e-300 + 4 * _EPS * abs(x)) / 2, (other - x) / 2
        if at_x == 0 or abs(half) < least:
            return x
        inner = math.inf
        if abs(before) > least and abs(at_x) < abs(at_last):
            if last == other:
                inner = -at_x * (x - last) / (at_x - at_last)
            else:
                p, q = (at_last - at_x) / (last - x), (at_other - at_x) / (other - x)
                below = q * p * (at_other - at_last)
                inner = -at_x * (at_other * q - at_last * p) / below if below else math.inf
        if 2 * abs(inner) < min(abs(before), 3 * abs(half) - least):
            before, step = step, inner
        else:
            before = step = half
        last, at_last = x, at_x
        x += step if abs(step) > least else math.copysign(least, half)
        if math.isnan(at_x := f(x)):
            break
    raise ArithmeticError(f"no zero was found between {a:g} and {b:g}")


def summit(f: Callable[[Array], Array], a: float, b: float) -> tuple[float, float]:
    """(omega, f) at the largest f within [a, b]: ever finer grids, then Newton's steps on a fourth-order stencil.

    Grids, since f is fast for many frequencies at once and slow for one.
    """
    low, high = a, b
    for _ in range(10):
        omega = np.linspace(low, high, 17)
        values = f(omega)
        k = int(np.argmax(values))
        low, high = float(omega[max(k - 1, 0)]), float(omega[min(k + 1, 16)])
        # Below this the values differ by rounding, and the stencil knows better.
        if float(np.ptp(values)) < 1e-9 * abs(float(values[k])):
            break
    best, top = float(omega[k]), float(values[k])
    h = max(high - low, 2e-3 * (b - a))
    at = best
    for _ in range(3):
        if not a + 2 * h < at < b - 2 * h:
            break
        y = f(at + h * np.arange(-2.0, 3.0))
        slope = (y[0] - 8 * y[1] + 8 * y[3] - y[4]) / 12
        bend = -(y[0] - 16 * y[1] + 30 * y[2] - 16 * y[3] + y[4]) / 12
        if not (bend < 0 and abs(slope) < -bend):
            break
        at -= h * float(slope / bend)
    value = float(f(np.array([at]))[0])
    return (at, value) if value >= top - 1e-12 * abs(top) else (best, top)


def first_fall(
    gain: Callable[[Array], Array], omega: Array, gains: Array, level: float, *, above: bool
) -> float | None:
    """The lowest frequency at which a gain falls through `level`; None: nowhere.

    gain: real and positive, of frequencies; gains: its values at omega. above: below omega[0] the gain is known to be
    above the level.
    """

    def log_gain(w: Array) -> Array:
        with np.errstate(divide="ignore"):
            return np.asarray(np.maximum(np.log(gain(w) / level), -700.0))

    with np.errstate(divide="ignore"):
        logs = np.maximum(np.log(gains / level), -700.0)
    if above and logs[0] <= 0:
        # A drop so small that it lies below the grid.
        omega, logs = np.append(1e-6 * omega[0], omega), np.append(_EPS, logs)
    falls = np.flatnonzero((logs[:-1] > 0) & (logs[1:] <= 0))
    first = int(falls[0]) if len(falls) else len(logs)
    inner = logs[1:-1]
    low = (inner > 0) & (inner < 0.3) & (inner <= logs[:-2]) & (inner <= logs[2:])
    for k in np.flatnonzero(low) + 1:
        if k > first:
            break
        bottom, depth = summit(lambda w: -log_gain(w), omega[k - 1], omega[k + 1])
        if depth > 0:
            return root(lambda w: float(log_gain(np.array([w]))[0]), omega[k - 1], bottom)
    if not len(falls):
        return None
    return root(lambda w: float(log_gain(np.array([w]))[0]), omega[first], omega[first + 1])


def highest(gain: Callable[[Array], Array], omega: Array, gains: Array, ends: Sequence[Peak]) -> Peak:
    """The largest value of a gain: of its summits, and of `ends`, its values where no grid reaches."""
    peaks = [*ends, Peak(float(gains[0]), float(omega[0])), Peak(float(gains[-1]), float(omega[-1]))]
    least = np.minimum(gains[:-2], gains[2:])
    # On a level rounding makes summits of its own.
    top = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
    top = top[gains[top] - least[top - 1] > 1e-12 * gains[top]]
    if len(top) > _SUMMITS:  # a phase that turns without end makes thousands: of equal ones the first
        size = np.log(_crowns(omega, gains, top))
        top = top[np.lexsort((omega[top], -np.round(size, 4)))][:_SUMMITS]
    for k in sorted((int(k) for k in top), key=lambda k: -float(gains[k])):
        # The grid's points differ by less than that from what lies between them.
        if gains[k] < 0.8 * max(peak.value for peak in peaks):
            break
        at, value = summit(gain, float(omega[k - 1]), float(omega[k + 1]))
        peaks.append(Peak(value, at))
    best = max(peak.value for peak in peaks)
    # Of equal values the end is meant, not the grid's point beside it, and of summits that of the lowest frequency.
    peaks[len(ends) + 2 :] = sorted(peaks[len(ends) + 2 :], key=lambda peak: peak.frequency)
    return next(peak for peak in peaks if peak.value >= best * (1 - 8 * _EPS))


def _crowns(omega: Array, gains: Array, top: Array) -> Array:
    """The values at the vertices of the parabolas through each point of the grid and its neighbors."""
    left, right = omega[top] - omega[top - 1], omega[top + 1] - omega[top]
    with np.errstate(all="ignore"):
        fall, rise = (gains[top] - gains[top - 1]) / left, (gains[top + 1] - gains[top]) / right
        bend = (rise - fall) / (left + right)
        crowns = gains[top] - (fall + bend * left) ** 2 / (4 * bend)
    return np.where(np.isfinite(crowns), crowns, gains[top])


def curve(known: Source) -> Callable[[Array], Array]:
    """The response of one input and one output; of measured data, interpolated."""
    return interpolated(known) if known.points is not None else known.siso


def largest(values: Array) -> Array:
    """Largest singular value at each frequency, (len(omega),)."""
    if values.shape[:2] == (1, 1):
        return np.asarray(np.abs(values[0, 0]))
    stack = np.moveaxis(values, 2, 0)
    out = np.full(len(stack), math.inf)
    finite = np.all(np.isfinite(stack), axis=(1, 2))
    if np.any(finite):
        out[finite] = np.linalg.svd(stack[finite], compute_uv=False)[:, 0]
    return out
