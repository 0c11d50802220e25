"""What stands in the place of SciPy's functions, against SciPy, bit for bit."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from blocks.frequency.lapack import balancing, eigenvectors, generalized_eigenvalues
from blocks.frequency.realization import components
from blocks.frequency.search import root

CHANCE = np.random.default_rng(22)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8, 20, 70])
@pytest.mark.parametrize("is_symmetric", [False, True], ids=["general", "symmetric"])
def test_eigenvalues_and_balancing_are_those_of_scipy(size: int, is_symmetric: bool) -> None:
    """Entries far apart and zeros among them; symmetric ones have real eigenvalues alone."""
    a = CHANCE.normal(size=(size, size)) * 10.0 ** CHANCE.integers(-8, 8, size=(size, size))
    a *= CHANCE.random((size, size)) < 0.5
    a = a + a.T if is_symmetric else a
    b = CHANCE.normal(size=(size, size))
    assert np.array_equal(balancing(a), linalg.matrix_balance(a, permute=False, separate=True)[1][0])
    for ours, theirs in zip(eigenvectors(a), linalg.eig(a, left=True, right=True), strict=True):
        assert np.array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype
    for ours, theirs in zip(generalized_eigenvalues(a, b), linalg.eigvals(a, b, homogeneous_eigvals=True), strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("function", [balancing, eigenvectors, lambda a: generalized_eigenvalues(a, a)])
def test_numbers_that_are_not_finite_are_refused_as_by_scipy(function: Callable[[Any], Any]) -> None:
    with pytest.raises(ValueError, match="infs or NaNs"):
        function(np.full((2, 2), math.nan))


def points(search: Callable[..., float], f: Callable[[float], float], *given: Any, **options: Any) -> list[float]:
    """Where a search looks, and what it finds."""
    seen = []

    def watched(x: float) -> float:
        seen.append(x)
        return f(x)

    found = search(watched, *given, **options)
    return [found, *seen]


@pytest.mark.parametrize("kind", ["polynomial", "smooth", "steep", "jump", "flat"])
def test_zeros_are_found_by_the_steps_of_brentq(kind: str) -> None:
    """The same points, one after the other."""
    found = 0
    for _ in range(300):
        c, scale = CHANCE.normal(size=CHANCE.integers(2, 9)), 10.0 ** CHANCE.integers(-9, 9)
        f = {
            "polynomial": partial(lambda c, h, x: float(np.polyval(c, x / h)), c, scale),
            "smooth": partial(lambda c, h, x: math.tanh(c[0] * x / h + c[1]), c, scale),
            "steep": partial(lambda c, h, x: math.atan(x / h * 1e6 - c[0]) + 1e-3 * c[1], c, scale),
            "jump": partial(lambda c, h, x: float(np.sign(x / h - c[0])), c, scale),
            "flat": partial(lambda c, h, x: (x / h - c[0]) ** 9, c, scale),
        }[kind]
        a, b = np.sort(CHANCE.normal(size=2) * scale * 3).tolist()
        if f(a) * f(b) < 0:
            found += 1
            theirs = points(brentq, f, a, b, xtol=1e-300, rtol=4 * np.finfo(float).eps, maxiter=300)
            assert points(root, f, a, b) == theirs
        else:
            assert root(f, a, b) in (a, b)
    assert found > 50


def test_components_come_in_the_order_of_scipy() -> None:
    for _ in range(500):
        n = int(CHANCE.integers(1, 30))
        a = CHANCE.normal(size=(n, n)) * (CHANCE.random((n, n)) < CHANCE.choice([0.02, 0.05, 0.1, 0.2]))
        count, label = connected_components(csr_array(a != 0), directed=True, connection="strong")
        assert [part.tolist() for part in components(a)] == [np.flatnonzero(label == k).tolist() for k in range(count)]
