"""How far rounding may have moved poles, and whether they are on the border of stability within that.

Poles are s, or z - 1 of sampled systems, as in `realization`. A doubt is of first order and for one pole; close to
others it is large, and `is_singular` decides: whether a matrix that differs by rounding has a pole right there.

Reference: L. N. Trefethen, M. Embree, Spectra and Pseudospectra, Princeton 2005, chapters 2 and 52.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..text.arrays import Array
from .lapack import eigenvectors
from .realization import Realization, components, growth

_EPS = float(np.finfo(float).eps)


def rounding(a: Array, opened: Array, dt: float) -> float:
    """How far rounding may have moved the matrix of a closed loop: it is that of the opened one and of a feedback.

    Both may cancel. A sampled one (dt > 0) comes as z - 1, but was rounded as z.
    """
    scale = float(np.linalg.norm(a)) + float(np.linalg.norm(opened)) + (1.0 if dt > 0 else 0.0)
    return 8 * len(a) * _EPS * scale


def eigenvalues_with_doubt(a: Array, unsure: float) -> tuple[Array, Array]:
    """Eigenvalues, and how far a change of the matrix of the norm `unsure` may have moved each.

    By the angle between its left and right vectors.
    """
    if not len(a):
        return np.zeros(0, complex), np.zeros(0)
    values, left, right = eigenvectors(a)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    return np.asarray(values, dtype=complex), unsure / np.maximum(overlap, 1e-12)


def is_singular(a: Array, unsure: float) -> Callable[[complex], bool]:
    """Whether a place is an eigenvalue of a matrix that differs from `a` by no more than `unsure`."""

    def is_there(p: complex) -> bool:
        return bool(np.linalg.svd(p * np.eye(len(a)) - a, compute_uv=False)[-1] <= unsure)

    return is_there


def root_doubts(coefficients: Array, roots: Array, terms: Array) -> Array:
    """How far rounding of the coefficients of a polynomial, and of its evaluation, may have moved each root.

    terms: the sizes of what the coefficients are sums of.
    """
    with np.errstate(all="ignore"):
        slope = np.abs(np.polyval(np.polyder(coefficients), roots))
        doubt = _floor(terms, np.abs(roots)) / slope
    return np.where(np.isfinite(doubt), doubt, 1e-4 * np.abs(roots))


def is_root(coefficients: Array, x: complex, terms: Array) -> bool:
    """Whether a polynomial vanishes there but for rounding of its coefficients and of its evaluation."""
    return bool(abs(np.polyval(coefficients, x)) <= _floor(terms, abs(x)))


def _floor(terms: Array, size: Array | float) -> Array:
    return np.asarray(8 * len(terms) * _EPS * np.polyval(terms, size))


def growth_of(p: Array, dt: float) -> Array:
    """How fast poles grow, per unit of p: that of z = 1 + p goes by the period."""
    return growth(p, dt) * (dt if dt > 0 else 1.0)


def onto_border(p: complex, dt: float) -> complex:
    """The nearest point on the border of stability."""
    if dt == 0:
        return complex(0.0, p.imag)
    if p.imag == 0:
        return 0j if p.real > -1 else complex(-2.0, 0.0)
    return complex(np.expm1(1j * np.angle(1.0 + p)))


def parts_with_doubt(model: Realization) -> Iterator[tuple[Array, float, Array, Array]]:
    """Yield the blocks of states that act on each other: matrix, rounding of it, eigenvalues, and the doubt of each."""
    for k in components(model.a):
        a = model.a[np.ix_(k, k)]
        unsure = rounding(a, a, model.dt) if len(a) > 1 else 4 * _EPS * (model.dt > 0)
        yield a, unsure, *eigenvalues_with_doubt(a, unsure)


def stability(model: Realization) -> str:
    """Return "stable", "border" (at the border of stability within rounding) or "unstable", by the poles of a model."""
    word = "stable"
    for a, unsure, p, doubt in parts_with_doubt(model):
        is_there = is_singular(a, unsure)
        for pole, fast, most in zip(p, growth_of(p, model.dt), doubt, strict=True):
            if abs(fast) <= most and is_there(onto_border(pole, model.dt)):
                word = "border"
            elif fast >= 0:
                return "unstable"
    return word
