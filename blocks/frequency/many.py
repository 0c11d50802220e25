"""Margins and peaks of many closed loops at once, from stacks of matrices.

The closed loop of each row is dx/dt = A x + B e, with e added at the signal where the loop is opened: from there to the
signal behind it is S, and L = 1/S - 1. All is found on a grid for each row, laid out from its own poles, and then
refined: crossings by secants, peaks by parabolas. `margins` of one loop is exact and knows every crossing; here narrow
peaks between the points of the grid can be missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..text.arrays import Array

_POINTS = 160
_GOLDEN, _STEPS = (5**0.5 - 1) / 2, 22
_NUMBERS = 2**21
"""Numbers of one response that are computed at once."""
Response = Callable[[Array, Array], Array]


class Loops:
    """Systems with the same A for all their channels: (rows, n, n). dt: 0 for continuous ones."""

    def __init__(self, A: Array, dt: float = 0.0) -> None:
        from scipy.linalg import hessenberg, matrix_balance

        self.dt, self.H, self.q, self.scale = dt, np.empty_like(A), np.empty_like(A), np.ones(A.shape[:2])
        if not A.shape[1]:
            return
        for k, matrix in enumerate(A):
            # Gains of observers rise by powers of the bandwidth: beside them the plant would be lost in rounding.
            even, (self.scale[k], _) = matrix_balance(matrix, permute=False, separate=True)
            self.H[k], self.q[k] = hessenberg(even, calc_q=True)

    def response(self, B: Array, C: Array, D: Array) -> Response:
        """Return the function of rows and frequencies [rad/s] (rows, count) that gives C (p - A)^-1 B + D.

        B: (rows, n), C: (rows, n), D: (rows): of one input and one output. p is jw, or exp(jw dt).
        """
        b = np.einsum("kji,kj->ki", self.q, B / self.scale)
        c = np.einsum("kj,kji->ki", C * self.scale, self.q)

        def response(rows: Array, omega: Array) -> Array:
            found = np.empty(omega.shape, dtype=complex)
            chunk = max(1, _NUMBERS // max(1, b.shape[1] * omega.shape[1]))
            for first in range(0, len(rows), chunk):
                part = slice(first, first + chunk)
                k, p = rows[part], 1j * omega[part]
                p = np.exp(1j * np.minimum(omega[part] * self.dt, np.pi)) if self.dt else p
                found[part] = _solved(self.H[k], b[k], c[k], p) + D[k][:, None]
            return found

        return response


def _solved(H: Array, b: Array, c: Array, p: Array) -> Array:
    """c (p - H)^-1 b for upper Hessenberg matrices: columns are rotated from the last one up, as in `realization`."""
    n = H.shape[1]
    if not n:
        return np.zeros(p.shape, dtype=complex)
    y = np.moveaxis(np.broadcast_to(b[:, None, :].astype(complex), (*p.shape, n)), 2, 0).copy()
    cosines, sines = np.empty((n, *p.shape), dtype=complex), np.empty((n, *p.shape))
    last = np.moveaxis(np.broadcast_to(-H[:, None, :, -1].astype(complex), (*p.shape, n)), 2, 0).copy()
    last[-1] += p
    with np.errstate(all="ignore"):
        for k in range(n - 1, 0, -1):
            column = np.moveaxis(
                np.broadcast_to(-H[:, None, : k + 1, k - 1].astype(complex), (*p.shape, k + 1)), 2, 0
            ).copy()
            column[k - 1] += p
            corner = -H[:, k, k - 1][:, None]
            length = np.hypot(np.abs(last[k]), np.abs(corner))
            cosines[k], sines[k] = last[k] / length, corner / length
            y[k] /= length
            y[:k] -= (cosines[k].conj() * last[:k] + sines[k] * column[:k]) * y[k]
            last = cosines[k] * column[:k] - sines[k] * last[:k]
        y[0] /= last[0]
        for k in range(1, n):
            y[k - 1], y[k] = sines[k] * y[k] + cosines[k] * y[k - 1], cosines[k].conj() * y[k] - sines[k] * y[k - 1]
        found: Array = np.einsum("ki,ikm->km", c, y)
        return found


def between(A: Array, B: Array, C: Array) -> Array:
    """Which states lie between one input and one output of each row: (rows, n). The others have no part in it."""
    links = A != 0

    def reached(seen: Array, links: Array) -> Array:
        for _ in range(A.shape[1]):
            seen = seen | (links & seen[:, None, :]).any(axis=2)
        return seen

    return reached(B != 0, links) & reached(C != 0, links.transpose(0, 2, 1))


def grid_of(poles: Array, dt: float = 0.0) -> Array:
    """Frequencies for each row of poles [1/s]: two decades around all of them, and close to each; up to pi/dt."""
    if dt:
        poles = np.where(np.abs(poles) < np.pi / dt, poles, 0.0)
    sizes = np.abs(poles)
    scale = sizes.max(axis=1, initial=1e-300)[:, None]
    sizes = np.where(sizes > 1e-9 * scale, sizes, np.nan)
    least = np.fmin.reduce(sizes, axis=1, initial=np.inf)
    least = np.where(np.isfinite(least), least, 1.0)
    most = np.where(scale[:, 0] > 0, scale[:, 0], 1.0)
    along = np.linspace(0.0, 1.0, _POINTS)
    wide = np.exp(np.log(least / 100)[:, None] * (1 - along) + np.log(most * 100)[:, None] * along)
    near = np.where(np.isfinite(sizes), sizes, least[:, None])
    near = (near[:, :, None] * np.array([0.94, 0.98, 1.0, 1.02, 1.06])).reshape(len(poles), -1)
    omega = np.concatenate([wide, near], axis=1)
    if dt:
        omega = np.concatenate([omega, np.geomspace(1e-3, 1.0, 40) * np.full((len(poles), 1), np.pi / dt)], axis=1)
        omega = np.minimum(omega, np.pi / dt)
    return np.sort(omega, axis=1)


class Channel:
    """A response of all rows on their grids. at: the response of some rows at frequencies (rows, count)."""

    def __init__(self, at: Response, omega: Array) -> None:
        self.at, self.omega = at, omega
        rows = np.arange(len(omega))
        self.values = at(rows, omega)
        # As good as 0 and as good as infinity, where suprema lie that no frequency reaches.
        self.ends = at(rows, np.stack([1e-8 * omega[:, 0], 1e8 * omega[:, -1]], axis=1))

    def peaks(self, of: Callable[[Array], Array] = lambda response: response) -> tuple[Array, Array]:
        """The largest |of(response)| of each row, and its frequency."""
        count, edge = len(self.omega), np.abs(of(self.values[:, 0]))
        sizes = np.nan_to_num(np.abs(of(self.values)), nan=-1.0)
        # Of two summits of nearly one height, the grid may see the lower one higher.
        first = np.argmax(sizes, axis=1)
        inner = np.pad(sizes, ((0, 0), (1, 1)), constant_values=-1.0)
        is_other = np.abs(self.omega / self.omega[np.arange(count), first][:, None] - 1) > 1e-6
        is_other &= (sizes >= inner[:, :-2]) & (sizes >= inner[:, 2:])
        at = np.concatenate([first, np.argmax(np.where(is_other, sizes, -1.0), axis=1)])
        rows = np.tile(np.arange(count), 2)
        omega, sizes = self.omega[rows], sizes[rows]
        best, place = sizes[np.arange(2 * count), at], omega[np.arange(2 * count), at]
        # Poles that lie together make points that do.
        low = np.log(np.where(omega < place[:, None] * (1 - 1e-9), omega, omega[:, :1]).max(axis=1))
        high = np.log(np.where(omega > place[:, None] * (1 + 1e-9), omega, omega[:, -1:]).min(axis=1))
        x = np.log(place)

        def size(x: Array) -> Array:
            return np.asarray(np.nan_to_num(np.abs(of(self.at(rows, np.exp(x)[:, None])))[:, 0]))

        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        of_left, of_right = size(left), size(right)
        for _ in range(_STEPS):  # golden section between the neighbors
            goes_left = of_left > of_right
            low, high = np.where(goes_left, low, left), np.where(goes_left, right, high)
            kept, known = np.where(goes_left, left, right), np.where(goes_left, of_left, of_right)
            new = np.where(goes_left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
            of_new = size(new)
            left, right = np.where(goes_left, new, kept), np.where(goes_left, kept, new)
            of_left, of_right = np.where(goes_left, of_new, known), np.where(goes_left, known, of_new)
            x, best = np.where(of_new > best, new, x), np.fmax(best, of_new)
        higher = np.where(best[:count] >= best[count:], np.arange(count), np.arange(count, 2 * count))
        x, best = x[higher], best[higher]
        ends = np.abs(of(self.ends))
        # A pole at rest: all others are farther than the grid reaches.
        ends[:, 0] = np.where(ends[:, 0] > 10.0 * edge, np.inf, ends[:, 0])
        for end, frequency in zip(ends.T, (-np.inf, np.inf), strict=True):
            x, best = np.where(end > best, frequency, x), np.fmax(best, end)
        return best, np.exp(x)

    def crossings(self, of: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """Where a real function of the response changes its sign: the rows, the frequencies, the responses there."""
        values, x = of(self.values), np.log(self.omega)
        k, m = np.nonzero(values[:, :-1] * values[:, 1:] < 0)
        a, b, fa, fb = x[k, m], x[k, m + 1], values[k, m], values[k, m + 1]
        pairs = self._pairs(of, values, x)
        k, a, b, fa, fb = (np.concatenate([own, more]) for own, more in zip((k, a, b, fa, fb), pairs, strict=True))
        for _ in range(12):  # Illinois: a bracket by secants, where the end that stays loses half of its value
            x = b - fb * (b - a) / np.where(fb == fa, 1.0, fb - fa)
            fx = of(self.at(k, np.exp(x)[:, None]))[:, 0]
            flips = fx * fb < 0
            a, fa = np.where(flips, b, a), np.where(flips, fb, fa / 2)
            b, fb = x, fx
        w = np.exp(b)
        return k, w, self.at(k, w[:, None])[:, 0]

    def _pairs(self, of: Callable[[Array], Array], values: Array, x: Array) -> tuple[Array, ...]:
        """Brackets of two crossings between points of the grid: where a parabola turns on the other side of 0."""
        left, here, right = values[:, :-2], values[:, 1:-1], values[:, 2:]
        near = (left * here > 0) & (right * here > 0) & (np.abs(here) <= np.fmin(np.abs(left), np.abs(right)))
        k, m = np.nonzero(near)
        x0, x1, x2 = x[k, m], x[k, m + 1], x[k, m + 2]
        f0, f1, f2 = values[k, m], values[k, m + 1], values[k, m + 2]
        with np.errstate(all="ignore"):
            up, down = (x1 - x0) * (f1 - f2), (x1 - x2) * (f1 - f0)
            turn = x1 - 0.5 * ((x1 - x0) * up - (x1 - x2) * down) / (up - down)
        inside = (turn > x0) & (turn < x2) & (turn != x1)
        k, turn, x0, x1, x2, f0, f1, f2 = (each[inside] for each in (k, turn, x0, x1, x2, f0, f1, f2))
        f = of(self.at(k, np.exp(turn)[:, None]))[:, 0]
        two = f * f1 < 0
        k, turn, x0, x1, x2, f0, f1, f2, f = (each[two] for each in (k, turn, x0, x1, x2, f0, f1, f2, f))
        low, f_low = np.where(turn < x1, x0, x1), np.where(turn < x1, f0, f1)
        high, f_high = np.where(turn < x1, x1, x2), np.where(turn < x1, f1, f2)
        ends = ((k, k), (low, turn), (turn, high), (f_low, f), (f, f_high))
        return tuple(np.concatenate(pair) for pair in ends)


def margins_of(sensitivity: Channel, stable: Array) -> dict[str, Array]:
    """Margins of each row, by the names and meanings of `margins`; nan where the closed loop is not stable.

    gain: the smallest above 1, inf where there is none; gain_low: the largest below 1, 0 where there is none;
    phase_deg, crossover, delay, Ms, Mt, disk.
    """
    count = len(stable)
    Ms, _ = sensitivity.peaks()
    Mt, _ = sensitivity.peaks(lambda S: 1 - S)
    skew, _ = sensitivity.peaks(lambda S: 2 * S - 1)
    gain, low = np.full(count, np.inf), np.zeros(count)
    # L is real where S is. Far out L vanishes, and what is left of its imaginary part is rounding.
    k, _, S = sensitivity.crossings(lambda S: np.where(np.abs(1 - S) < 1e-9, 0.0, S.imag))
    with np.errstate(all="ignore"):
        L, ends = (1 / S - 1).real, 1 / sensitivity.ends - 1
    # It is real at 0 and at infinity too, where nothing changes its sign.
    row, end = np.nonzero(np.abs(ends.imag) < 1e-6 * np.abs(ends.real))
    k, L = np.concatenate([k, row]), np.concatenate([L, ends.real[row, end]])
    real = (L < -1e-9) & (L > -1e9)  # where the open loop has a pole on the axis, S is rounding
    k, factor = k[real], -1 / L[real]
    up = factor >= 1
    np.minimum.at(gain, k[up], factor[up])
    np.maximum.at(low, k[~up], factor[~up])
    phase, delay, crossover = np.full(count, np.inf), np.full(count, np.inf), np.full(count, np.nan)
    # |L| = 1 where |1 - S| = |S|: where the real part of S is 1/2.
    k, w, S = sensitivity.crossings(lambda S: S.real - 0.5)
    angle = np.angle(1 - 1 / S)
    np.minimum.at(delay, k, np.mod(angle, 2 * np.pi) / w)
    # Of equal ones, but for rounding, that of the lowest frequency.
    order = np.lexsort((w, np.round(np.abs(angle), 9)))[::-1]
    phase[k[order]], crossover[k[order]] = np.degrees(angle[order]), w[order]
    found = {
        "gain": gain, "gain_low": low, "phase_deg": phase, "delay": delay, "crossover": crossover, "Ms": Ms, "Mt": Mt,
        "disk": 2 / skew,
    }  # fmt: skip
    return {name: np.where(stable, values, np.nan) for name, values in found.items()}
