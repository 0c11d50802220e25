"""The structured singular value mu of complex diagonal perturbations: 1/mu is the size of the least that is singular.

mu(M) = 1/min(size of Delta: det(I - M Delta) = 0), Delta = diag(d1, ..., dn) complex, its size the largest |di|. From
above, mu is at most the largest singular value of D M D^-1 for each diagonal D > 0: the least of these is mu up to
n = 3, and never below it. From below, each Delta that is singular shows a value of mu.

References: A. Packard, J. Doyle, The complex structured singular value, Automatica 29 (1993); E. E. Osborne, On
pre-conditioning of matrices, J. ACM 7 (1960).
"""

from __future__ import annotations

import math

import numpy as np

from ..text.arrays import Array

_TINY = 1e-300
_SWEEPS = 12
_SHARP = 4.0 ** np.arange(9)
"""Exponents p of Schatten norms, whose minima approach that of the largest singular value: to n^(1/2p) for each."""
_NEWTON = 4
_STARTS = 24


def scalings(m: Array) -> Array:
    """Logarithms of D that balances each matrix, (count, n): its rows and columns are equally large off the diagonal.

    m: (count, n, n). For n = 2 this D is the best; else it is near it.
    """
    count, n = m.shape[:2]
    sizes = np.abs(m) ** 2 * (1.0 - np.eye(n))
    logs = np.zeros((count, n))
    for _ in range(_SWEEPS):
        for k in range(n):
            with np.errstate(all="ignore"):
                step = 0.25 * np.log(sizes[:, :, k].sum(axis=1) / sizes[:, k, :].sum(axis=1))
            step = np.clip(np.where(np.isnan(step), 0.0, step), -5.0, 5.0)
            logs[:, k] += step
            sizes[:, k, :] *= np.exp(2 * step)[:, None]
            sizes[:, :, k] *= np.exp(-2 * step)[:, None]
    return logs


def scaled(m: Array, logs: Array) -> Array:
    """The largest singular value of each D M D^-1, (count,): an upper bound of mu."""
    return np.asarray(np.linalg.svd(_balanced(m, logs), compute_uv=False)[:, 0])


def upper_bounds(m: Array) -> Array:
    """The least upper bound of mu over all D, of each matrix: a convex problem, by Newton's method.

    The bound itself is always one; it is the least to some 1e-4 of its size at worst.
    """
    count, n = m.shape[:2]
    logs = scalings(m)
    least = scaled(m, logs)
    if n <= 2:
        return least
    for p in _SHARP:
        for _ in range(_NEWTON):
            value, slope = _smooth(m, logs, p)
            bend, h = np.ones((count, n, n)) + 1e-9 * np.eye(n), 1e-3 / p  # D and 2 D are the same
            for k in range(n):
                bend[:, :, k] += (_smooth(m, logs + h * np.eye(n)[k], p)[1] - slope) / h
            step = -np.linalg.solve(bend + np.swapaxes(bend, 1, 2), 2 * slope[:, :, None])[:, :, 0]
            step /= np.maximum(1.0, np.max(np.abs(step), axis=1, keepdims=True))
            for _ in range(4):
                worse = _smooth(m, logs + step, p)[0] > value
                step[worse] *= 0.25
            step[worse] = 0.0
            logs = logs + step
        least = np.minimum(least, scaled(m, logs))
    return least


def _balanced(m: Array, logs: Array) -> Array:
    size = np.exp(logs)
    return np.asarray(m * (size[:, :, None] / size[:, None, :]))


def _smooth(m: Array, logs: Array, p: float) -> tuple[Array, Array]:
    """The logarithm of the Schatten norm of order 2p of D M D^-1, and its slope by the logarithms of D."""
    left, sizes, right = np.linalg.svd(_balanced(m, logs))
    top = np.maximum(sizes[:, :1], _TINY)
    weights = (sizes / top) ** (2 * p)
    total = weights.sum(axis=1, keepdims=True)
    shares = np.abs(left) ** 2 - np.abs(np.swapaxes(right, 1, 2)) ** 2
    return np.log((top * total ** (1 / (2 * p)))[:, 0]), np.einsum("fki,fi->fk", shares, weights / total)


def worst(m: Array, bound: float) -> Array:
    """The least singular Delta that is found, as its diagonal (n,): 1/mu is no larger than its size. m: one matrix.

    Its elements have one size: the largest spectral radius of M U, over the phases of a diagonal U, by local searches
    from several places until one reaches the upper bound of mu.
    """
    from scipy.optimize import minimize

    def lost(angles: Array) -> tuple[float, Array]:
        values, right = np.linalg.eig(m * np.exp(1j * angles))
        k = int(np.argmax(np.abs(values)))
        try:
            left = np.linalg.inv(right)[k]
        except np.linalg.LinAlgError:  # a multiple eigenvalue, which has no slope
            left = right[:, k].conj()
        # By the angles |values| moves by -Im(left_i right_i).
        return -float(np.log(max(abs(values[k]), _TINY))), np.imag(left * right[:, k])

    u, _, vh = np.linalg.svd(_balanced(m[None], scalings(m[None]))[0])
    draws = np.random.default_rng(0).uniform(-np.pi, np.pi, (_STARTS, len(m)))
    best, angles = math.inf, np.zeros(len(m))
    for start in (np.angle(vh[0].conj()) - np.angle(u[:, 0]), angles, *draws):
        search = minimize(lost, start, jac=True, method="BFGS", options={"gtol": 1e-12})
        if search.fun < best:
            best, angles = float(search.fun), search.x
        if best <= 1e-9 - math.log(max(bound, _TINY)):
            break
    values = np.linalg.eigvals(m * np.exp(1j * angles))
    return np.asarray(np.exp(1j * angles) / values[int(np.argmax(np.abs(values)))])
