"""Numbers for tuning from a linear model: the order and b0 of a plant, the PID controller that a controller is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from .response import poles, single, zeros
from .systems import Source, is_of

_EPS = float(np.finfo(float).eps)
_AT_REST = 1e-12  # of the largest pole: what is nearer to 0 is an integrator
_SAME = 1e-7  # of a zero: what is nearer to it is the same pole
_LEAST = 1e-7  # of the largest term of a response at its fastest pole: what is smaller is rounding


class HighFrequencyGain(NamedTuple):
    """y^(order) = ... + b0 u: how often y must be derived until u appears, and its factor, in SI units."""

    order: int
    b0: float


def high_frequency_gain(system: object) -> HighFrequencyGain:
    """Return the order n and the b0 of y^(n) = f + b0 u that a linear model has: its high-frequency gain b0/s^n.

    system: of one input and one output, in continuous time, as `plant.linearize("u", "y")`. n is the relative degree:
    what is fast, such as the lag of an actuator, counts, so an ADRC of a lower order with another b0 may be the better
    choice. Raises AnalysisError (E705) where u does not reach y, and UsageError (E501).
    """
    name = "high_frequency_gain"
    known = _continuous(system, name)
    if known.realization is None:
        if not is_of(system, "TransferFunction"):
            raise AnalysisError(Fault("E705", name, "the order of a measured or delayed response is unknown.", _MODEL))
        num, den = (np.trim_zeros(np.asarray(part[0][0], dtype=float), "f") for part in (system.num, system.den))  # type: ignore[attr-defined]
        if len(num) > len(den):
            raise AnalysisError(Fault("E705", name, "the system is improper: y depends on derivatives of u.", _MODEL))
        if len(num):
            return HighFrequencyGain(len(den) - len(num), float(num[0] / den[0]))
    else:
        model = known.realization
        if model.d[0, 0]:
            return HighFrequencyGain(0, float(model.d[0, 0]))
        speed = float(np.max(np.abs(model.eigenvalues()), initial=0.0)) or 1.0
        row, bound, terms, reached = model.c / speed, np.abs(model.c) / speed, [], 0.0
        for n in range(1, len(model.a) + 1):
            gain, size = float((row @ model.b)[0, 0]), float((bound @ np.abs(model.b))[0, 0])
            reached = max(reached, size)
            terms.append(gain if abs(gain) > 8 * n * len(model.a) * _EPS * size else 0.0)
            row, bound = row @ model.a / speed, bound @ np.abs(model.a) / speed
        # The terms b0/s^n of the response at the speed of the fastest pole: what is far smaller is what rounding left.
        largest = max(map(abs, terms), default=0.0)
        for n, term in enumerate(terms, 1):
            if term and abs(term) >= _LEAST * largest:
                return HighFrequencyGain(n, term * speed**n)
        if reached:
            what = "rounding hides whether u reaches y."
            raise AnalysisError(
                Fault("E705", name, what, "Give a model whose zeros are exact, such as a transfer function.")
            )
    raise AnalysisError(Fault("E705", name, "u does not reach y.", "Choose another input or output."))


_MODEL = "Give a linear model without delays, or with pade=3."


def _continuous(system: object, name: str) -> Source:
    known = single(system, name)
    if known.dt > 0:
        raise UsageError(Fault("E501", name, "the system is sampled.", "Give the model in continuous time."))
    return known


@dataclass(frozen=True, slots=True)
class EquivalentPID:
    """C(s) = (kp + ki/s + kd s)/F(s), F(0) = 1: what a controller is from -y to u, in SI units.

    filter: the coefficients of F, the highest power first; zeros, poles: those of C without its integrator [1/s].
    """

    kp: float
    ki: float
    kd: float
    filter: tuple[float, ...]
    zeros: tuple[complex, ...]
    poles: tuple[complex, ...]

    @property
    def Ti(self) -> float:
        """Reset time kp/ki [s]."""
        return self.kp / self.ki

    @property
    def Td(self) -> float:
        """Derivative time kd/kp [s]; nan without a proportional part."""
        return self.kd / self.kp if self.kp else math.nan

    def __str__(self) -> str:
        parts = [f"kp {self.kp:.6g}, ki {self.ki:.6g}, kd {self.kd:.6g}; Ti {self.Ti:.6g} s, Td {self.Td:.6g} s"]
        for what, roots in (("zeros", self.zeros), ("filter", self.poles)):
            parts += [f"{what}: {', '.join(_corners(roots))}"] if roots else []
        return "\n".join(parts)


def _corners(roots: tuple[complex, ...]) -> list[str]:
    """Corner frequencies, with the damping of pairs."""
    shown = [f"{abs(p):.6g} rad/s{' (right half-plane)' if p.real > 0 else ''}" for p in roots if p.imag == 0]
    return shown + [f"{abs(p):.6g} rad/s with damping {-p.real / abs(p):.4g}" for p in roots if p.imag > 0]


def equivalent_pid(system: object) -> EquivalentPID:
    """Return the PID controller with a filter that a linear controller of another form is, from y to u.

    system: of one input and one output, in continuous time, with one integrator and at most two zeros, as
    `control.linearize("y", "u")` of an ADRC of order 1 or 2 with a LESO or ReducedESO. Raises AnalysisError (E705)
    where it is no such controller, and UsageError (E501).

    References: G. Herbst, Transfer Function Analysis and Implementation of Active Disturbance Rejection Control,
    Control Theory and Technology 19, 2021.
    """
    name = "equivalent_pid"
    _continuous(system, name)
    rest, top = _visible(poles(system), zeros(system))
    is_slow = np.abs(rest) <= _AT_REST * np.max(np.abs(rest), initial=0.0)
    count, rest, what = int(is_slow.sum()), rest[~is_slow], ""
    if count != 1:
        what = f"has {'several integrators' if count else 'no integrator'}, but a PID has one."
    elif len(top) > 2:
        what = f"has {len(top)} zeros, but a PID has at most 2."
    if what:
        raise AnalysisError(Fault("E705", name, f"the controller {what}", "Draw it with gang_of_six or bode instead."))
    N, F = (np.atleast_1d(np.real(np.poly(roots))) for roots in (top, rest))
    kd, kp, ki = np.pad(N, (2 - len(top), 0)) * -high_frequency_gain(system).b0 / F[-1]
    return EquivalentPID(
        float(kp), float(ki), float(kd), tuple((F / F[-1]).tolist()), tuple(top.tolist()), tuple(rest.tolist())
    )


def _visible(p: Array, z: Array) -> tuple[Array, Array]:
    """Poles and zeros without those that cancel: hidden modes, such as a filter of r."""
    left, slow = [*p.tolist()], _AT_REST * float(np.max(np.abs(p), initial=0.0))
    shown = []
    for zero in z.tolist():
        near = min(left, key=lambda pole: abs(pole - zero), default=None)
        if near is not None and abs(near - zero) <= max(_SAME * abs(zero), slow):
            left.remove(near)
        else:
            shown.append(zero)
    return np.array(left, dtype=complex), np.array(shown, dtype=complex)
