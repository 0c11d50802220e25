"""Three functions of LAPACK, as scipy.linalg gives them, bit for bit, without all that scipy.linalg loads.

Importing scipy.linalg takes longer than the margins of a loop. The functions of `scipy.linalg.lapack` stand in a
library of their own, which is loaded by itself; where a release of SciPy has them elsewhere, scipy.linalg is loaded.
"""

from __future__ import annotations

from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["balancing", "eigenvectors", "generalized_eigenvalues"]

Array = np.ndarray[Any, Any]


@cache
def _lapack() -> Any:
    import scipy

    assert scipy.__file__ is not None
    spec = PathFinder.find_spec("scipy.linalg._flapack", [str(Path(scipy.__file__).parent / "linalg")])
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
    lwork = int(lapack.dgeev_lwork(len(a))[0].real)
    real, imaginary, left, right, info = lapack.dgeev(a, lwork=lwork)
    _check(info)
    values = real + 1j * imaginary
    return (values, _paired(values, left), _paired(values, right)) if imaginary.any() else (values, left, right)


def _paired(values: Array, given: Array) -> Array:
    """LAPACK has the real and the imaginary part of a pair's first vector in its two columns."""
    vectors = given.astype(complex)
    for k in np.flatnonzero(values.imag > 0):
        vectors[:, k] = given[:, k] + 1j * given[:, k + 1]
        vectors[:, k + 1] = vectors[:, k].conj()
    return vectors


def generalized_eigenvalues(a: Array, b: Array) -> tuple[Array, Array]:
    """alpha (complex) and beta, by which beta A x = alpha B x. Raises ValueError, LinAlgError."""
    lapack, a, b = _lapack(), np.asarray_chkfinite(a), np.asarray_chkfinite(b)
    lwork = int(lapack.dggev(a, b, lwork=-1)[-2][0].real)
    real, imaginary, beta, *_, info = lapack.dggev(a, b, 0, 0, lwork)
    _check(info)
    return real + 1j * imaginary, np.asarray(beta)


def _check(info: int) -> None:
    if info:
        raise np.linalg.LinAlgError(f"the eigenvalues did not converge ({info})")
