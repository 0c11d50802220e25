"""Transfer functions whose coefficients do not hold their poles, as rounding moves those over the border.

A double changes by half a unit in its last place when it is rounded. That moves a simple pole by its doubt, which is of
first order; whether a place is a pole of a polynomial that differs by rounding is seen by the value there.

Reference: N. J. Higham, Accuracy and Stability of Numerical Algorithms (2nd ed.), SIAM 2002, sections 5.2 and 26.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np

from ..contract.resolution import Resolved
from ..library.continuous import TransferFunction
from ..library.discrete import DiscreteTransferFunction
from ..text.errors import Fault

_HALF = float(np.finfo(float).eps) / 2
_MOST = 60  # degrees; eigenvalues of more take long
_FEW = 1e-3  # of the distance to the point of rest: a doubt below it leaves a pole three digits
_APART = 1e-2  # of the nearest other pole: poles at rest are a cluster of their own within it


def unsure(path: str, block: Resolved) -> Fault | None:
    """Return the warning (W105) about a transfer function whose coefficients do not hold its poles."""
    if block.interface.cls not in (TransferFunction, DiscreteTransferFunction):
        return None
    is_sampled = block.interface.cls is DiscreteTransferFunction
    poles = lost_poles(tuple(np.asarray(block.values["den"].value, dtype=float).tolist()), is_sampled)
    if not poles:
        return None
    worst = ", ".join(f"{p:.4g}" if p.imag else f"{p.real:.4g}" for p in poles[:3])
    message = (
        f"the coefficients of den do not determine its poles: rounding in their last digits moves poles ({worst}"
        f"{', ...' if len(poles) > 3 else ''}) across the stability limit."
    )
    cure = "Use sections in series (Biquad), or a DiscreteStateSpace." if is_sampled else ""
    return Fault("W105", path, message, cure or "Use a ZeroPoleGain, or a StateSpace.")


@lru_cache(maxsize=256)
def lost_poles(den: tuple[float, ...], is_sampled: bool) -> tuple[complex, ...]:
    """Return the poles (s, or z) that rounding of the coefficients may have moved over the border of stability.

    Poles at rest, as those of integrators, are on the border by themselves; they are known if they are apart from
    others.
    """
    a = np.trim_zeros(np.array(den), "b")  # poles at z = 0 and integrators 1/s have no doubt
    if not 3 <= len(a) - 1 <= _MOST or not np.all(np.isfinite(a)):
        return ()
    poles = np.asarray(np.roots(a), dtype=complex)
    rest = 1.0 if is_sampled else 0.0
    with np.errstate(all="ignore"):
        slope = np.abs(np.polyval(np.polyder(a), poles))
        doubt = _HALF * np.polyval(np.abs(a), np.abs(poles)) / slope
        away = np.abs(poles - rest)
        vague = ~(doubt <= _FEW * away)
    if not vague.any():
        return ()
    count = _at_rest(a) if is_sampled else 0
    if count is None:
        return tuple(poles[vague].tolist())
    vague[np.argsort(away)[:count]] = False
    lost = []
    for k in np.flatnonzero(vague & (poles.imag >= 0)):
        pole = complex(poles[k])
        border = pole / abs(pole) if is_sampled else complex(0.0, pole.imag)
        if _is_pole(a, border):
            lost.append(pole)
    return tuple(lost)


def _at_rest(a: np.ndarray) -> int | None:
    """Return how many poles are at z = 1 but for rounding, or None if they are no cluster apart from the others."""
    exact, n = [Fraction(x) for x in a.tolist()[::-1]], len(a) - 1
    # The polynomial in z - 1, exact, and how far rounding may have moved its coefficients.
    shifted = [float(sum(math.comb(i, j) * exact[i] for i in range(j, n + 1))) for j in range(n + 1)]
    moved = [_HALF * float(sum(math.comb(i, j) * abs(exact[i]) for i in range(j, n + 1))) for j in range(n + 1)]
    count = next(j for j in range(n + 1) if abs(shifted[j]) > moved[j] or j == n)
    if count == 0:
        return 0
    size = (moved[0] / abs(shifted[count])) ** (1.0 / count)
    others = np.abs(np.roots(shifted[count:][::-1]))
    return count if size < _APART * np.min(others, initial=1.0) else None


def _is_pole(a: np.ndarray, place: complex) -> bool:
    """Return whether a polynomial vanishes there but for rounding of its coefficients."""
    real, imag = Fraction(place.real), Fraction(place.imag)
    x, y = Fraction(0), Fraction(0)
    for coefficient in a.tolist():
        x, y = x * real - y * imag + Fraction(coefficient), x * imag + y * real
    return math.hypot(float(x), float(y)) <= _HALF * float(np.polyval(np.abs(a), abs(place)))
