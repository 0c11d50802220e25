"""The closed loop of a loop transfer: its poles, and whether it is stable, at the border or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .doubt import eigenvalues_with_doubt, growth_of, is_root, is_singular, onto_border, root_doubts, rounding
from .realization import balanced, equivalent, period
from .systems import Source, StateSpace, is_of, polynomials

_EPS = float(np.finfo(float).eps)
_WIDER = 8.0
"""The ratio of two circles around a pole, between which the gain is compared."""


def verdict_of(stable: bool | None, border: Collection[complex], unstable: Collection[complex]) -> str:
    """Return "stable", "border" (at the border of stability within rounding), "unstable", or "unknown"."""
    if stable is None:
        return "unknown"
    return "stable" if stable else "border" if border and not unstable else "unstable"


@dataclass(frozen=True, slots=True)
class Closed:
    """Poles of a closed loop, as s; and those that grow, are at the border, or are there beside the loop, as s or z."""

    poles: Array
    unstable: tuple[complex, ...]
    border: tuple[complex, ...]
    hidden: tuple[complex, ...]


def closed_loop(loop: Any, known: Source) -> Closed | None:
    """Return the closed loop of a state space, or of one transfer function; None: only a response is known."""
    if isinstance(loop, StateSpace):
        model = balanced(loop)
        seen = model.visible()
        gain = np.eye(len(model.d)) + model.d
        sizes = np.linalg.svd(gain, compute_uv=False)
        check_well_posed(float(sizes[-1]), max(1.0, float(sizes[0])))
        matrix = seen.a - seen.b @ np.linalg.solve(gain, seen.c)
        unsure = rounding(matrix, seen.a, known.dt)
        p, doubt = eigenvalues_with_doubt(matrix, unsure)
        beside, scale = model.hidden_eigenvalues(), float(np.linalg.norm(model.a))
        return judged(p, doubt, seen.at, beside, scale, known.dt, is_singular(matrix, unsure))
    if is_of(loop, "TransferFunction"):
        num, den = polynomials(loop)[0][0]
        total = np.polyadd(num, den)
        check_well_posed(float(total[0]) if len(total) >= max(len(num), len(den)) else 0.0, float(np.max(np.abs(den))))
        shift = 1.0 if period(loop.dt) > 0 else 0.0
        roots = np.asarray(np.roots(total), dtype=complex)
        terms = np.polyadd(np.abs(num), np.abs(den))  # which may cancel in their sum
        doubts = root_doubts(total, roots, terms)
        # A root at exactly 0 may be in no doubt, but a circle around it needs a radius.
        sizes = np.abs(np.concatenate([roots, np.roots(num), np.roots(den)]))
        doubts[doubts == 0] = _EPS * np.min(sizes[sizes > 0], initial=1.0)
        return judged(
            roots - shift, doubts,
            lambda x: (np.polyval(num, x + shift) / np.polyval(den, x + shift))[None, None],
            np.zeros(0, complex), 0.0, known.dt, lambda x: is_root(total, x + shift, terms),
        )  # fmt: skip
    return None


def check_well_posed(leading: float, scale: float) -> None:
    if abs(leading) <= 8 * _EPS * scale:
        raise_ill_posed("infinite frequency")


def raise_ill_posed(where: str) -> NoReturn:
    cure = "Put a state or a delay into the loop: it is an algebraic loop without a solution."
    raise AnalysisError(Fault("E705", "margins", f"1 + L vanishes at {where}.", cure))


def judged(
    p: Array, doubt: Array, at: Callable[[Array], Array], beside: Array, scale: float, dt: float,
    is_there: Callable[[complex], bool] = lambda x: True,
) -> Closed:  # fmt: skip
    """Sort the poles of the closed loop. at: L. is_there: whether a place is a pole within rounding."""
    shift = 1.0 if dt > 0 else 0.0
    unstable, border, hidden = [], [], []
    for pole, fast, unsure in zip(p, growth_of(p, dt), doubt, strict=True):
        if fast < -unsure:
            continue
        if abs(fast) > unsure or not is_there(onto_border(pole, dt)):
            if fast >= 0:
                unstable.append(complex(pole + shift))
        elif _has_zero(at, pole, 10 * unsure):
            border.append(onto_border(pole, dt) + shift)
        else:
            hidden.append(complex(pole + shift))
    rate, least = growth_of(beside, dt), 1e3 * _EPS * scale
    unstable += [complex(pole + shift) for pole, fast in zip(beside, rate, strict=True) if fast > least]
    hidden += [complex(pole + shift) for pole, fast in zip(beside, rate, strict=True) if abs(fast) <= least]
    return Closed(equivalent(p, dt), tuple(unstable), tuple(border), tuple(hidden))


def _has_zero(at: Callable[[Array], Array], center: complex, radius: float) -> bool:
    """Return whether I + L has a zero within the circle; else the pole there was one of L, and stayed."""
    circle = radius * np.exp(2j * math.pi * np.arange(65) / 64)
    with np.errstate(all="ignore"):
        near, far = (np.moveaxis(at(center + by), 2, 0) for by in (circle, _WIDER * circle))
        one = np.eye(near.shape[-1])
        angles = np.unwrap(np.angle(np.linalg.det(one + near)))
    if angles[-1] - angles[0] > math.pi:
        return True
    if len(one) == 1 or not (np.isfinite(near).all() and np.isfinite(far).all()):
        return False
    # The determinant does not turn if another channel has a pole there. Towards a zero, the least gain still falls.
    least, before = (np.median(np.linalg.svd(one + L, compute_uv=False)[:, -1]) for L in (near, far))
    return bool(least < 3 / _WIDER * before)


def is_stable_by_encirclements(values: Array, unstable_poles: int | None, integrators: int) -> bool | None:
    """Whether 1 + L turns by what a stable closed loop needs: pi for each unstable pole, pi/2 for each integrator."""
    if unstable_poles is None:
        return None
    angles = np.unwrap(np.angle(1.0 + values))
    zeros = unstable_poles + 0.5 * integrators - (angles[-1] - angles[0]) / math.pi
    # The ends of measured data are not at zero and infinity: their turn is not quite whole.
    if abs(zeros - round(zeros)) > 0.3:
        return None
    return bool(round(zeros) == 0)


def frequencies_of(border: Iterable[complex], dt: float) -> list[float]:
    """Those of poles at the border, in rad/s; of a pair once."""
    return sorted({float(abs(np.angle(p)) / dt if dt > 0 else abs(p.imag)) for p in border})
