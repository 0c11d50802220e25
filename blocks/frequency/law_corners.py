"""Where a static law has corners, jumps or infinite slopes: what a quadrature must know to be exact.

    breaks_of(np.sign, -1.0, 1.0)                            # (0.0,), from the law alone
    breaks_of(f, -1.0, 1.0, lambda u: np.stack((u, np.abs(u) - 0.1), axis=1))   # from what it switches by

A law is a function that maps an array of inputs to the array of outputs, element by element.

References: T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm, Adv. Eng. Software 28, 1997.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError

Law = Callable[[Array], Any]

PLACE = "describing function"
"""The place of faults where no law is known, but its numbers only."""

_EPS = float(np.finfo(float).eps)
_HALVINGS = 45  # of an interval until a break in it is known to rounding
_SMOOTHED = 12  # halvings after which a law that bends within an interval is taken to break there
_INTERVALS = 8192  # more than that are rough, and the law is noise


def breaks_of(f: Law, low: float, high: float, switches: Law | None = None) -> tuple[float, ...]:
    """Inputs in low ... high at which f has corners, jumps or infinite slopes, for `breaks` of the functions here.

    switches: maps an array of shape (n,) to one of shape (n, k), whose columns change sign there (what stands in |.|,
    sgn and comparisons); without it f is looked at itself: intervals are halved where a polynomial does not follow it.
    A column that touches 0 between two points of the scan, which is dense around 0, may be missed where it is not
    smooth; f itself is then off by little.

    Raises: UsageError E501 (no interval).
    """
    low, high = finite(low, "lower end"), finite(high, "upper end")
    if not low < high:
        raise refused(f"{low:g} ... {high:g} is not an interval.", "Give the lower end first.")
    if switches is None:
        return _rough(f, low, high)
    given = switches
    reach = max(abs(low), abs(high))
    fine = reach * np.geomspace(1e-12, 1.0, 241)
    # With 0 itself, where most laws break: |u| is known to be 0 there, and need not be searched for its least value.
    grid = np.union1d(np.linspace(low, high, 1025), np.concatenate((-fine, [0.0], fine)))
    grid = grid[(grid >= low) & (grid <= high)]
    return tuple(sign_changes(lambda u: switched(given, u, u.size), grid).tolist())


def sign_changes(g: Callable[[Array], Array], grid: Array) -> Array:
    """Places at which columns of g (shape (n, k) at n places) change sign, increasing, each once."""
    samples = g(grid)
    if not samples.shape[1]:
        return np.empty(0)
    sign = np.sign(samples)
    opposite = sign[:-1] * sign[1:] == -1.0
    row, column = np.nonzero(opposite)
    lo, hi = [grid[row]], [grid[row + 1]]
    columns = [column]
    g_lo, g_hi = [samples[row, column]], [samples[row + 1, column]]

    # A column that comes near 0 between two points and turns: its least absolute value may lie beyond 0.
    size = np.abs(samples)
    turns = (size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]) & (sign[:-2] * sign[2:] == 1.0) & (sign[1:-1] != 0.0)
    turns &= (sign[1:-1] == sign[:-2]) & ((size[1:-1] < size[:-2]) | (size[1:-1] < size[2:]))
    row, column = np.nonzero(turns)
    if row.size:
        at, value = _least(g, grid[row], grid[row + 2], column, sign[row + 1, column])
        hit = value * sign[row + 1, column] < 0.0
        row, column, at, value = row[hit], column[hit], at[hit], value[hit]
        lo += [grid[row], at]
        hi += [at, grid[row + 2]]
        g_lo += [samples[row, column], value]
        g_hi += [value, samples[row + 2, column]]
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
    # With the ends, so that no break hides between an interval's last node and its end.
    angle = np.arange(17) * math.pi / 16.0
    # The three last Chebyshev coefficients.
    last = np.cos(np.outer(angle, (14, 15, 16))) / 8.0
    last[[0, -1]] *= 0.5
    # Unequal parts, here and below: a break at a round place would lie on an edge, where no polynomial sees it.
    edges = np.linspace(low, high, 34)
    edges[1:-1] += 0.1234567 * (edges[1] - edges[0])
    lo, hi = edges[:-1], edges[1:]
    scale = 0.0
    leaves: list[tuple[float, float, int]] = []
    for depth in range(_HALVINGS + 1):
        y = values(f, 0.5 * (lo + hi)[:, None] + 0.5 * (hi - lo)[:, None] * np.cos(angle))
        known = np.all(np.isfinite(y), axis=1)
        if depth == 0:
            heights = y[np.isfinite(y)]
            scale = float(np.max(heights) - np.min(heights)) if heights.size else 0.0
            noise = 64.0 * _EPS * float(np.max(np.abs(heights), initial=0.0))
        with np.errstate(all="ignore"):
            rough = ~known | (np.max(np.abs(y @ last), axis=1) > 1e-12 * scale + noise)
        narrow = hi - lo <= 8.0 * _EPS * np.maximum(np.abs(lo), np.abs(hi))
        ended = ~rough | narrow if depth < _HALVINGS else np.ones_like(rough)
        if depth > _SMOOTHED:
            leaves += [(a, b, depth) for a, b in zip(lo[ended].tolist(), hi[ended].tolist(), strict=True)]
        lo, hi = lo[~ended], hi[~ended]
        if not lo.size or 2 * lo.size > _INTERVALS:
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


def values(f: Law, u: Array, size: int | None = None) -> Array:
    """f at all inputs at once: u of any shape, or rows of inputs where `size` says how many."""
    flat = u if size is not None else u.ravel()
    with np.errstate(all="ignore"):
        y = np.asarray(f(flat), dtype=float)
    count = flat.size if size is None else size
    if y.shape == (count,):
        return y if size is not None else y.reshape(u.shape)
    if y.ndim == 0:
        return np.full(u.shape if size is None else (count,), float(y))
    raise refused(f"the law gives an array of shape {y.shape} for {count} inputs.", "Return one output for each input.")


def switched(switches: Law, u: Array, count: int) -> Array:
    """Quantities that mark corners and jumps, of shape (n, k); NaN where they are not defined."""
    with np.errstate(all="ignore"):
        g = np.asarray(switches(u), dtype=float)
    if g.ndim == 1 and g.shape == (count,):
        g = g[:, None]
    if g.ndim != 2 or len(g) != count:
        raise refused(
            f"the switches give an array of shape {g.shape} for {count} inputs.", "Return an array of shape (n, k)."
        )
    return g


def undescribed(message: str, cure: str) -> AnalysisError:
    """E704 of a law that has no describing function there."""
    return AnalysisError(Fault("E704", PLACE, message, cure))


def refused(message: str, cure: str) -> UsageError:
    """E501 of a call of a describing function."""
    return UsageError(Fault("E501", PLACE, message, cure))


def positive(x: object, name: str) -> Array:
    numbers = np.asarray(x, dtype=float)
    good = (numbers > 0.0) & np.isfinite(numbers)
    if not np.all(good):
        article = "an" if name[0] in "aeiou" else "a"
        raise refused(f"the {name} is {numbers[~good].flat[0]:g}.", f"Give {article} {name} above 0.")
    return numbers


def finite(x: float, name: str) -> float:
    x = float(x)
    if not math.isfinite(x):
        raise refused(f"the {name} is {x:g}.", "Give a finite number.")
    return x
