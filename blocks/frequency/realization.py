"""(A, B, C, D) as the analyses need it: balanced, in s or in z - 1, with its responses, eigenvalues and zeros.

Responses come from (A, B, C, D) itself, never from a transfer function made of it: the coefficients of a polynomial of
a loop that is sampled fast hold fewer digits than the loop needs. Sampled systems are written in delta = z - 1, where
neither A - I nor z - 1 loses digits near z = 1.

References: G. Henry, The shifted Hessenberg system solve computation, 1994; A. Emami-Naeini, P. Van Dooren, Computation
of zeros of linear multivariable systems, Automatica 18 (1982).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from .lapack import balancing, generalized_eigenvalues

_EPS = float(np.finfo(float).eps)
_SURE = 1e6 * _EPS  # of the norm of a matrix: rounding that moves the coefficients of a cluster of eigenvalues
_STRONG = 1e4  # of the norm of A: a larger feedback from y = 0 leaves too few digits to zeros
_DENSE = 96  # states; above, a Hessenberg form with refinement is cheaper than an LU for each of many frequencies
_FEW = 2048  # states times frequencies; up to there an LU for each frequency is cheaper, whatever the number of states
_CHUNK = 1 << 22  # entries of the matrices that are solved at once


@dataclass(frozen=True, slots=True)
class Realization:
    """p x = A x + B u, y = C x + D u, balanced; p is s, or z - 1 where dt > 0 (then a has A - I)."""

    a: Array
    b: Array
    c: Array
    d: Array
    dt: float

    def at(self, p: Array) -> Array:
        """C (p I - A)^-1 B + D for each p, (outputs, inputs, len(p)); inf where p is a pole."""
        return _transfer(self, np.asarray(p, dtype=complex))

    def _visible(self) -> Array:
        moved = _reached(self.a, np.any(self.b != 0, axis=1))
        return np.asarray(moved & _reached(self.a.T, np.any(self.c != 0, axis=0)))

    def visible(self) -> Realization:
        """Without states that no input moves, or that no output shows, as far as the zeros in A, B, C tell."""
        keep = np.flatnonzero(self._visible())
        return Realization(self.a[np.ix_(keep, keep)], self.b[keep], self.c[:, keep], self.d, self.dt)

    def channel(self, output: int, input: int) -> Realization:
        """One output of one input."""
        rows, columns = slice(output, output + 1), slice(input, input + 1)
        return Realization(self.a, self.b[:, columns], self.c[rows], self.d[rows, columns], self.dt)

    def hidden_eigenvalues(self) -> Array:
        """Of the states that `visible` leaves out: whole strong components, so that these are eigenvalues of A."""
        rest = np.flatnonzero(~self._visible())
        return Realization(self.a[np.ix_(rest, rest)], self.b[rest], self.c[:, rest], self.d, self.dt).eigenvalues()

    def eigenvalues(self) -> Array:
        """Of A (of A - I where dt > 0), strong component by strong component: a cascade keeps its multiple poles."""
        return np.concatenate([np.zeros(0, complex), *(_eigenvalues(self.a[np.ix_(k, k)]) for k in components(self.a))])


def period(dt: Any) -> float:
    if dt is None:
        return 0.0
    return 1.0 if dt is True else float(dt)


def balanced(system: Any) -> Realization:
    dt = period(system.dt)
    d = np.atleast_2d(np.asarray(system.D, dtype=float))
    n = int(system.nstates)
    a = np.array(system.A, dtype=float).reshape(n, n)
    b = np.array(system.B, dtype=float).reshape(n, d.shape[1])
    c = np.array(system.C, dtype=float).reshape(d.shape[0], n)
    check_finite(A=a, B=b, C=c, D=d)
    if dt > 0:
        a -= np.eye(n)
    if n:
        # Powers of two: nothing is rounded. B and C take part, or a small A could leave them far apart.
        m = n + max(d.shape)
        whole = np.zeros((m, m))
        whole[:n, :n], whole[:n, n : n + d.shape[1]], whole[n : n + d.shape[0], :n] = a, b, c
        scale = balancing(whole)[:n]
        a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
    return Realization(a, b, c, d, dt)


def check_finite(**numbers: Array) -> None:
    """Raise UsageError (E501) for a system with numbers that are nan or infinite. numbers: by what they are."""
    for name, values in numbers.items():
        for value in values[~np.isfinite(values)][:1]:
            message, cure = f"{name} holds {value:g}, but must be finite.", "Check the numbers that it is made from."
            raise UsageError(Fault("E501", "system", message, cure))


def variable(omega: Array, dt: float) -> Array:
    """s, or z - 1 where dt > 0, without loss of digits near z = 1; real at the Nyquist frequency."""
    if dt == 0:
        return 1j * omega
    value = np.expm1(1j * omega * dt)
    value[np.abs(omega * dt - math.pi) < 4 * _EPS] = -2.0
    return np.asarray(value)


def equivalent(p: Array, dt: float) -> Array:
    """Poles as s where they are z - 1; without those at z = 0, which have no s."""
    if dt == 0:
        return p
    p = p[np.abs(1.0 + p) > _EPS]
    growth = 0.5 * np.log1p(np.maximum(2 * p.real + np.abs(p) ** 2, _EPS - 1.0))
    angle = np.arctan2(p.imag, 1.0 + p.real)
    return np.asarray((growth + 1j * angle) / dt)


def growth(p: Array, dt: float) -> Array:
    """How fast modes grow, in 1/s: negative for those that decay. p is s, or z - 1."""
    if dt == 0:
        return np.asarray(p.real)
    with np.errstate(divide="ignore"):
        return np.asarray(0.5 * np.log1p(np.maximum(2 * p.real + np.abs(p) ** 2, -1.0)) / dt)


def _reached(a: Array, start: Array) -> Array:
    """The states that those of `start` act on, directly or not: a[i, j] != 0 means that j acts on i."""
    links, reached, new = a != 0, start.copy(), start
    while new.any():
        new = links[:, new].any(axis=1) & ~reached
        reached |= new
    return reached


def components(a: Array) -> list[Array]:
    """States that act on each other: the diagonal blocks of a block-triangular form (by R. Tarjan's search)."""
    links, size = a != 0, len(a)
    found: list[Array] = []
    order, lowest, unseen = np.zeros(size, int), np.full(size, size), np.ones(size, dtype=bool)
    waiting: list[int] = []  # seen, and in no component yet
    for begin in range(size):
        path = [begin] if unseen[begin] else []
        while path:
            k = path[-1]
            if unseen[k]:
                order[k] = lowest[k] = size - np.count_nonzero(unseen)
                unseen[k] = False
                waiting.append(k)
            ahead = np.flatnonzero(links[k] & unseen)
            if len(ahead):
                path.append(int(ahead[-1]))
                continue
            path.pop()
            lowest[k] = min(lowest[k], np.min(lowest[links[k]], initial=size))
            if lowest[k] == order[k]:
                first = waiting.index(k)
                found.append(np.sort(waiting[first:]))
                lowest[waiting[first:]] = size
                del waiting[first:]
    return found


def _eigenvalues(block: Array) -> Array:
    if len(block) == 1:
        return np.asarray(block[0], dtype=complex)
    return np.asarray(np.linalg.eigvals(block), dtype=complex)


def _transfer(model: Realization, p: Array) -> Array:
    n, m = model.b.shape
    out = np.empty((*model.d.shape, len(p)), dtype=complex)
    if not n:
        out[:] = model.d[:, :, None]
        return out
    is_dense = n <= _DENSE or n * len(p) <= _FEW
    step = max(1, _CHUNK // (n * (n if is_dense else 4 * m)))
    solve = _solve_dense if is_dense else _Hessenberg(model.a)
    for k in range(0, len(p), step):
        part = p[k : k + step]
        states, singular = solve(model.a, model.b, part)
        out[:, :, k : k + step] = np.moveaxis(model.c @ states, 0, 2) + model.d[:, :, None]
        for index in np.flatnonzero(singular):
            out[:, :, k + index] = _at_pole(model, part[index])
    return out


def _at_pole(model: Realization, p: complex) -> Array:
    """Channels that do not have the pole are finite there; the others are inf."""
    if model.d.shape == (1, 1):
        seen = model.visible()
        if len(seen.a) < len(model.a):
            return seen.at(np.array([p]))[:, :, 0]
        return np.full((1, 1), complex(math.inf, 0.0))
    rows, columns = model.d.shape
    parts = [[_at_pole(model.channel(i, j), p)[0, 0] for j in range(columns)] for i in range(rows)]
    return np.array(parts)


def _solve_dense(a: Array, b: Array, p: Array) -> tuple[Array, Array]:
    """(p I - A)^-1 B, (len(p), n, inputs), and where that is singular."""
    n = len(a)
    matrices = np.tile(-a.astype(complex), (len(p), 1, 1))
    matrices[:, np.arange(n), np.arange(n)] += p[:, None]
    singular = np.zeros(len(p), dtype=bool)
    right = np.broadcast_to(b.astype(complex), (len(p), *b.shape))
    try:
        return np.linalg.solve(matrices, right), singular
    except np.linalg.LinAlgError:
        out = np.zeros((len(p), *b.shape), dtype=complex)
        for k, matrix in enumerate(matrices):
            try:
                out[k] = np.linalg.solve(matrix, b)
            except np.linalg.LinAlgError:
                singular[k] = True
        return out, singular


class _Hessenberg:
    """(p I - A)^-1 B in n^2 operations for each p, all p at once, after one Hessenberg form of A.

    Columns are rotated from the last one up, and the triangle is solved as it arises, so that nothing of size n^2 is
    kept for each p. The form rounds A by eps times its norm; one step of refinement with A itself takes that back.
    """

    def __init__(self, a: Array) -> None:
        from scipy.linalg import hessenberg

        self.h, self.q = hessenberg(a, calc_q=True)

    def __call__(self, a: Array, b: Array, p: Array) -> tuple[Array, Array]:
        from scipy.sparse import csr_array

        sparse = csr_array(a)
        n, m = b.shape
        right = np.broadcast_to(b.astype(complex), (len(p), n, m))
        with np.errstate(all="ignore"):
            x = self._solve(right, p)
            flat = np.moveaxis(x, 1, 0).reshape(n, -1)
            residual = right - p[:, None, None] * x + np.moveaxis((sparse @ flat).reshape(n, len(p), m), 0, 1)
            better = x + self._solve(residual, p)
        singular = ~np.all(np.isfinite(better), axis=(1, 2))
        better[singular] = 0.0
        return better, singular

    def _solve(self, b: Array, p: Array) -> Array:
        h, n = self.h, len(self.h)
        y = np.moveaxis(self.q.T @ b, 0, 1)  # (n, len(p), m)
        cosines = np.empty((n, len(p)), dtype=complex)
        sines = np.empty((n, len(p)))
        last = np.repeat(-h[:, -1:].astype(complex), len(p), axis=1)
        last[-1] += p
        for k in range(n - 1, 0, -1):
            column = np.repeat(-h[: k + 1, k - 1 : k].astype(complex), len(p), axis=1)
            column[k - 1] += p
            corner = -h[k, k - 1]
            length = np.hypot(np.abs(last[k]), abs(corner))
            c, s = last[k] / length, corner / length
            cosines[k], sines[k] = c, s
            y[k] /= length[:, None]
            y[:k] -= (c.conj() * last[:k] + s * column[:k])[:, :, None] * y[k]
            last = c * column[:k] - s * last[:k]
        y[0] /= last[0][:, None]
        for k in range(1, n):
            c, s = cosines[k][:, None], sines[k][:, None]
            y[k - 1], y[k] = s * y[k] + c * y[k - 1], c.conj() * y[k] - s * y[k - 1]
        return np.asarray(self.q @ np.moveaxis(y, 0, 1))


def invariant_zeros(model: Realization) -> Array:
    a, b, c, d = model.a, model.b, model.c, model.d
    if not len(a) or not d.size:
        return np.zeros(0, complex)
    if d.shape == (1, 1) and (dynamics := _zero_dynamics(model)) is not None:
        zeros = np.concatenate(
            [np.zeros(0, complex), *(_eigenvalues(dynamics[np.ix_(k, k)]) for k in components(dynamics))]
        )
        scale = _balanced_norm(dynamics)
    else:
        zeros, scale = _pencil_zeros(a, b, c, d), float(np.linalg.norm(a))
    if not regular(np.block([[a, b], [c, d]])):
        # k zeros at p = 0, which rounding moves by eps^(1/k), are put back.
        zeros[np.argsort(np.abs(zeros))[: count_at_zero(zeros, scale)]] = 0.0
    return zeros


def _zero_dynamics(model: Realization) -> Array | None:
    """The matrix whose eigenvalues are the zeros of one output of one input; None where it loses digits.

    While u does not act on y at once, y = 0 eliminates a state, and the derivative of y takes the place of y. Pivots in
    place of rotations keep the zeros of A, B and C, by which multiple zeros stay exact.
    """
    a, b, c, d = model.a, model.b[:, 0], model.c[0], float(model.d[0, 0])
    while abs(d) <= 10 * len(model.a) * _EPS * float(np.linalg.norm(b) * np.linalg.norm(c)):
        pivot = int(np.argmax(np.abs(c))) if len(c) else 0
        if not len(c) or c[pivot] == 0:
            return None
        rest = np.arange(len(c)) != pivot
        ratio = c[rest] / c[pivot]
        slope, d = c @ a, float(c @ b)
        c = slope[rest] - slope[pivot] * ratio
        a, b = a[np.ix_(rest, rest)] - np.outer(a[rest, pivot], ratio), b[rest]
        if not len(a):
            return a if d else None
    feedback = np.outer(b, c / d)
    return a - feedback if np.linalg.norm(feedback) <= _STRONG * np.linalg.norm(model.a) else None


def _balanced_norm(a: Array) -> float:
    scale = balancing(a) if len(a) else np.ones(0)
    return float(np.linalg.norm(a * scale / scale[:, None]))


def _pencil_zeros(a: Array, b: Array, c: Array, d: Array) -> Array:
    norm = math.hypot(*(float(np.linalg.norm(part)) for part in (a, b, c, d)))
    tolerance = 10 * max(a.shape[0], *d.shape) * _EPS * norm
    a, b, c, d = _output_reduced(a, b, c, d, tolerance)
    # The dual system, reversed: what is left has a square regular D.
    a, c, b, d = _output_reduced(a.T, c.T, b.T, d.T, tolerance)
    a, b, c, d = a.T, b.T, c.T, d.T
    n, m = b.shape
    if not n:
        return np.zeros(0, complex)
    if not m:
        return _eigenvalues(a)
    # Columns such that [C D] W = [0 R]: then zeros are those of the pencil [A B] W1 - s W1, without infinite ones.
    full = np.linalg.svd(np.hstack([c, d]), full_matrices=True)[2].T
    w = full[:, m:]
    alpha, beta = generalized_eigenvalues(np.hstack([a, b]) @ w, w[:n])
    finite = np.abs(beta) > 100 * _EPS * np.hypot(np.abs(alpha) / max(norm, 1e-300), np.abs(beta))
    return np.asarray(alpha[finite] / beta[finite], dtype=complex)


def count_at_zero(values: Array, scale: float, tolerance: float = _SURE) -> int:
    """How many of the eigenvalues of a matrix of norm `scale` are 0 within a perturbation, relative to that norm.

    Rounding moves a k-fold eigenvalue by eps^(1/k), but the coefficients of the polynomial of all k by little more than
    eps: by these a multiple eigenvalue at 0 differs from distinct ones nearby.
    """
    nearest = values[np.argsort(np.abs(values))] / max(scale, 1e-300)
    return next((k for k in range(len(values), 0, -1) if np.all(np.abs(np.poly(nearest[:k])[1:]) <= tolerance)), 0)


def _output_reduced(a: Array, b: Array, c: Array, d: Array, tolerance: float) -> tuple[Array, Array, Array, Array]:
    """The same zeros with a D of full row rank; rows and states that only make zeros at infinity are gone."""
    while len(c):
        u, values, _ = np.linalg.svd(d) if d.size else (np.eye(len(c)), np.zeros(0), None)
        rank = int(np.sum(values > tolerance))
        if rank == len(c):
            break
        if rank:
            c, d = u.T @ c, u.T @ d
        lower = c[rank:]
        c, d = c[:rank], d[:rank]
        _, values, vh = np.linalg.svd(lower) if lower.size else (None, np.zeros(0), np.eye(len(a)))
        seen = int(np.sum(values > tolerance))
        if not seen:
            break
        v = np.vstack([vh[seen:], vh[:seen]]).T
        a, b, c = v.T @ a @ v, v.T @ b, c @ v
        k = len(a) - seen
        c, d = np.vstack([c[:, :k], a[k:, :k]]), np.vstack([d, b[k:]])
        a, b = a[:k, :k], b[:k]
    return a, b, c, d


def regular(block: Array) -> bool:
    """Not singular, whatever the scales of rows and columns."""
    scaled = block.copy()
    for _ in range(2):
        for axis in (1, 0):
            largest = np.max(np.abs(scaled), axis=axis, keepdims=True)
            if np.any(largest == 0):
                return False
            scaled /= largest
    values = np.linalg.svd(scaled, compute_uv=False)
    return bool(values[-1] > 8 * len(block) * _EPS * values[0])


def around_zero(at: Callable[[Array], Array], found: Array, norm: float = 0.0) -> float:
    """Return the constant term at p = 0 by Cauchy's formula, or inf if a pole is there (Laurent coefficients by FFT).

    found: the poles. norm: of the matrix that has them; what is smaller by rounding alone is at 0.
    """
    sizes = np.abs(found)
    # A double pole at zero that was rounded lies sqrt(eps) away; it must stay within the circle.
    far = sizes[sizes > max(1e-6 * float(np.max(sizes, initial=0.0)), 8 * len(sizes) * _EPS * norm, 1e-306)]
    radius = 0.1 * float(np.min(far)) if len(far) else 1.0
    count = 32
    circle = radius * np.exp(2j * math.pi * (np.arange(count) + 0.5) / count)
    values = at(circle)[0, 0]
    k = np.arange(-count // 2, count // 2)
    terms = (np.exp(-2j * math.pi * np.outer(k, np.arange(count) + 0.5) / count) @ values).real / count
    size = float(np.max(np.abs(values)))
    poles_there = [j for j in range(count // 2) if k[j] >= -len(found) and abs(terms[j]) > 1e-9 * size]
    if poles_there:
        # p tends to 0 from above: the term of the highest order wins.
        return math.copysign(math.inf, terms[poles_there[0]])
    return float(terms[count // 2])
