"""Three functions of LAPACK, as scipy.linalg gives them, bit for bit, without all that scipy.linalg loads.

Importing scipy.linalg takes longer than the margins of a loop. The functions of `scipy.linalg.lapack` stand in a
library of their own, which is loaded by itself; where a release of SciPy has them elsewhere, scipy.linalg is loaded.
"""

from __future__ import annotations

from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from typing import Any

import numpy as np

from ..text.arrays import Array


@cache
def _lapack() -> Any:
    import scipy

    spec = PathFinder.find_spec("scipy.linalg._flapack", [f"{place}/linalg" for place in scipy.__path__])
    if spec is None or spec.loader is None:
        from scipy.linalg import lapack

        return lapack
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def balancing(a: Array) -> Array:
    """Powers of two d, for which the rows and columns of A d / d[:, None] are of like size. Raises ValueError (nan)."""
    *_, scale, _ = _lapack().dgebal(np.asarray_chkfinite(a), scale=1, permute=0)
    return np.asarray(scale)


def eigenvectors(a: Array) -> tuple[Array, Array, Array]:
    """Eigenvalues (complex) of a real matrix, left and right eigenvectors. Raises ValueError, LinAlgError."""
    lapack, a = _lapack(), np.asarray_chkfinite(a)
    real, imaginary, left, right, info = lapack.dgeev(a, lwork=int(lapack.dgeev_lwork(len(a))[0].real))
    _check(info)
    pairs = np.flatnonzero(imaginary > 0)
    if len(pairs):  # LAPACK has the real and the imaginary part of a pair's first vector in its two columns
        left, right = left.astype(complex), right.astype(complex)
        for vectors in (left, right):
            vectors[:, pairs] += 1j * vectors[:, pairs + 1]
            vectors[:, pairs + 1] = vectors[:, pairs].conj()
    return real + 1j * imaginary, left, right


def generalized_eigenvalues(a: Array, b: Array) -> tuple[Array, Array]:
    """alpha (complex) and beta, by which beta A x = alpha B x. Raises ValueError, LinAlgError."""
    lapack, a, b = _lapack(), np.asarray_chkfinite(a), np.asarray_chkfinite(b)
    real, imaginary, beta, *_, info = lapack.dggev(a, b, 0, 0, int(lapack.dggev(a, b, lwork=-1)[-2][0].real))
    _check(info)
    return real + 1j * imaginary, np.asarray(beta)


def _check(info: int) -> None:
    if info:
        raise np.linalg.LinAlgError(f"the eigenvalues did not converge ({info})")
