"""The closed loop of a loop transfer: its poles, and whether it is stable, at the border or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .doubt import eigenvalues_with_doubt, growth_of, is_root, is_singular, onto_border, root_doubts, rounding
from .realization import Realization, balanced, equivalent, period
from .systems import Source, StateSpace, is_of, polynomials

_EPS = float(np.finfo(float).eps)


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
        at, is_there = (lambda x: return_of_values(seen, x)), is_singular(matrix, unsure)
        return judged(p, doubt, at, beside, scale, known.dt, is_there)
    if is_of(loop, "TransferFunction"):
        num, den = polynomials(loop)[0][0]
        total = np.polyadd(num, den)
        check_well_posed(float(total[0]) if len(total) >= max(len(num), len(den)) else 0.0, float(np.max(np.abs(den))))
        shift = 1.0 if period(loop.dt) > 0 else 0.0
        roots = np.asarray(np.roots(total), dtype=complex)
        return judged(
            roots - shift, root_doubts(total, roots), lambda x: np.polyval(num, x + shift) / np.polyval(den, x + shift),
            np.zeros(0, complex), 0.0, known.dt, lambda x: is_root(total, x + shift),
        )  # fmt: skip
    return None


def check_well_posed(leading: float, scale: float) -> None:
    if abs(leading) <= 8 * _EPS * scale:
        cure = "Put a state or a delay into the loop: it is an algebraic loop without a solution."
        raise AnalysisError(Fault("E705", "margins", "1 + L vanishes at infinite frequency.", cure))


def judged(
    p: Array, doubt: Array, at: Callable[[Array], Array], beside: Array, scale: float, dt: float,
    is_there: Callable[[complex], bool] = lambda x: True,
) -> Closed:  # fmt: skip
    """Sort the poles of the closed loop. is_there: whether a place is a pole within rounding."""
    shift = 1.0 if dt > 0 else 0.0
    unstable, border, hidden = [], [], []
    for pole, fast, unsure in zip(p, growth_of(p, dt), doubt, strict=True):
        if fast < -unsure:
            continue
        if abs(fast) > unsure or not is_there(onto_border(pole, dt)):
            if fast >= 0:
                unstable.append(complex(pole + shift))
        # 1 + L turns once around a zero that is no pole of L: elsewhere the pole was there before and stayed.
        elif _turns(at, pole, 10 * unsure):
            border.append(onto_border(pole, dt) + shift)
        else:
            hidden.append(complex(pole + shift))
    rate, least = growth_of(beside, dt), 1e3 * _EPS * scale
    unstable += [complex(pole + shift) for pole, fast in zip(beside, rate, strict=True) if fast > least]
    hidden += [complex(pole + shift) for pole, fast in zip(beside, rate, strict=True) if abs(fast) <= least]
    return Closed(equivalent(p, dt), tuple(unstable), tuple(border), tuple(hidden))


def _turns(at: Callable[[Array], Array], center: complex, radius: float) -> bool:
    """Whether 1 + L has more zeros than poles within the circle."""
    around = center + radius * np.exp(2j * math.pi * np.arange(65) / 64)
    with np.errstate(all="ignore"):
        angles = np.unwrap(np.angle(1.0 + at(around)))
    return bool(angles[-1] - angles[0] > math.pi)


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


def return_of_values(seen: Realization, p: Array) -> Array:
    """det(I + L) - 1, which goes round the zeros and poles of the return difference as L does of one value."""
    whole = np.moveaxis(seen.at(p), 2, 0) + np.eye(len(seen.d))
    return np.asarray(np.linalg.det(whole) - 1.0)


def frequencies_of(border: Iterable[complex], dt: float) -> list[float]:
    """Those of poles at the border, in rad/s; of a pair once."""
    return sorted({float(abs(np.angle(p)) / dt if dt > 0 else abs(p.imag)) for p in border})
