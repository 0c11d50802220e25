"""Margins of several channels of a loop together: disk margins, and the singular values of S and T.

A factor f on each channel is within a disk: f = (1 + (1 - skew)/2 d)/(1 - (1 + skew)/2 d), |d| <= alpha, each channel
with a d of its own, at each frequency another. The loop bears all of them if alpha < 1/mu(S + (skew - 1)/2 I) at all
frequencies, S = (I + L)^-1. mu is bounded from above (`structured`), so that the margin is guaranteed. It is the
largest for up to three channels; for more, the loop may bear a larger disk. skew = 0: balanced, f and 1/f alike; 1: S
alone; -1: T alone.

Reference: P. Seiler, A. Packard, P. Gahinet, An introduction to disk margins, IEEE Control Systems 40 (2020).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from ..text.rich_output import Shown, Table
from .closed_loop import closed_loop, frequencies_of, is_stable_by_encirclements, verdict_of
from .delayed import Rational
from .lifted import Lifted
from .margins import Margins, at_text, gain_text, margins, pole_text
from .realization import period
from .response import dc_gain
from .search import Peak, highest, layout, refined
from .structured import scaled, scalings, upper_bounds, worst
from .systems import Source, StateSpace, source

_FRAGILE = 0.5  # of the least margin of a single channel


@dataclass(frozen=True, slots=True, repr=False)
class DiskMargins(Shown):
    """Margins of the channels of a loop, together and one at a time. nan where the closed loop is not stable.

    channels: the signals at which the loop is open. stable, unstable, border, hidden: as of `Margins`.

    disk: the alpha up to which the closed loop bears all factors of the disk, in all channels at once; it is
    guaranteed, and `disk_most` is no margin any more: there the factors `worst`, one for each channel at
    `disk_frequency`, lead to the border of stability. Ms, Mt: the largest singular values of S and T.

    alone: the margins of each channel, where the others are closed; empty where the loop is not stable.
    """

    channels: tuple[str, ...]
    stable: bool | None
    unstable: tuple[complex, ...]
    border: tuple[complex, ...]
    hidden: tuple[complex, ...]
    disk: float
    disk_frequency: float
    disk_most: float
    worst: tuple[complex, ...]
    Ms: float
    Ms_frequency: float
    Mt: float
    Mt_frequency: float
    alone: tuple[Margins, ...]
    skew: float
    dt: float

    @property
    def verdict(self) -> str:
        """ "stable", "border" (at the border of stability within rounding), "unstable", or "unknown"."""
        return verdict_of(self.stable, self.border, self.unstable)

    @property
    def disk_gains(self) -> tuple[float, float]:
        """The least and the largest gain within the disk, which all channels may have at once."""
        low, high = self._ends
        return low, high if high > 0 else math.inf

    @property
    def disk_phase_deg(self) -> float:
        """The phase that may be added to all channels or taken away, in each another; inf: any."""
        low, high = self._ends
        cosine = low if math.isinf(high) else (1 + low * high) / (low + high)
        return math.degrees(math.acos(cosine)) if abs(cosine) <= 1 else math.nan if math.isnan(cosine) else math.inf

    @property
    def _ends(self) -> tuple[float, float]:
        a, b = 0.5 * self.disk * (1 - self.skew), 0.5 * self.disk * (1 + self.skew)
        return (1 - a) / (1 + b), math.inf if b == 1 else (1 + a) / (1 - b)

    def as_json(self) -> dict[str, Any]:
        """Return the values that --json prints; null for infinite and missing ones."""
        keys = ("disk", "disk_frequency", "disk_phase_deg", "disk_most", "Ms", "Ms_frequency", "Mt", "Mt_frequency")
        factors = zip(self.channels, self.worst, strict=False)
        return {
            **{key: _finite(getattr(self, key)) for key in keys},
            "disk_gains": [_finite(gain) for gain in self.disk_gains],
            "worst": {name: [_finite(f.real), _finite(f.imag)] for name, f in factors},
            "alone": {name: m.as_json() for name, m in zip(self.channels, self.alone, strict=False)},
            "stable": self.stable,
            "border": self.verdict == "border",
        }

    def parts(self) -> tuple[Table]:
        return (Table(list(_rows(self)), has_head=False),)

    def __str__(self) -> str:
        return "\n".join(f"{name:<16}{text}" for name, text in _rows(self))

    __repr__ = __str__


def _rows(m: DiskMargins) -> Iterator[tuple[str, str]]:
    poles = ", ".join(pole_text(p) for p in m.unstable or m.border)
    where = f" ({poles})" if poles else ""
    words = {
        "stable": "stable", "unknown": "stability unknown: give the number of unstable poles of the open loop",
        "border": f"AT THE BORDER of stability within rounding{where}",
        "unstable": f"UNSTABLE{where}: it has no margins",
    }  # fmt: skip
    yield "closed loop", words[m.verdict]
    if m.hidden:
        yield "", f"beside the loop, on the border: {', '.join(pole_text(p) for p in m.hidden)}"
    if m.verdict == "unstable":
        return
    yield "largest S", f"{gain_text(m.Ms)}{at_text(m.Ms_frequency)}"
    yield "largest T", f"{gain_text(m.Mt)}{at_text(m.Mt_frequency)}"
    low, high = m.disk_gains
    bears = f"gain x {low:.5g} to {high:.5g} and phase +-{m.disk_phase_deg:.5g} deg"
    yield "disk margin", f"{m.disk:.5g}{at_text(m.disk_frequency)}: {bears} in all channels together"
    if m.disk_most > m.disk * (1 + 1e-3):
        yield "  at most", f"{m.disk_most:.5g}; what lies between is not known"
    factors = zip(m.channels, m.worst, strict=False)
    texts = [f"{name} x {abs(f):.5g} at {round(math.degrees(np.angle(f)), 9):.5g} deg" for name, f in factors]
    if texts:
        yield "  at the border", ", ".join(texts)
    for k, (name, one) in enumerate(zip(m.channels, m.alone, strict=False)):
        gain = "any gain" if one.gain is None else f"gain margin {one.gain:.5g}"
        phase = "any phase" if one.phase_deg is None else f"phase margin {one.phase_deg:.5g} deg"
        disk = f"disk margin {one.disk:.5g}{at_text(one.disk_frequency)}"
        yield "" if k else "one at a time", f"{name}: {disk}, {gain}, {phase}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def disk_margins(
    loop: object, *, skew: float = 0.0, unstable_poles: int | None = None, integrators: int = 0
) -> DiskMargins:
    """Margins of the channels of a loop transfer matrix L, S = (I + L)^-1, together and one at a time.

    loop: `linearizer.loop(["k.y[0]", "k.y[1]"])`, or any square system, continuous or sampled. Where the loop is open
    decides what they are of: at the inputs of a plant, they are those of its actuators. skew: 0 for the balanced disk,
    1 for S alone, -1 for T alone. unstable_poles, integrators: of the open loop, where only its response is known.

    Raises AnalysisError (E705) where a channel is in no loop, where the closed loop has no solution, or of several
    rates; UsageError (E501).
    """
    if isinstance(loop, Lifted):
        cure = "Use margins(loop), which has gain and phase margins of one signal."
        raise AnalysisError(Fault("E705", "disk_margins", "a loop of several rates has no disk margin.", cure))
    if isinstance(skew, bool) or not isinstance(skew, (int, float)) or not math.isfinite(skew):
        raise UsageError(Fault("E501", "skew", f"must be a number, not {skew!r}.", "Use 0, the balanced disk."))
    known = source(loop)
    n = known.inputs
    if known.outputs != n or n == 0:
        what = f"{known.outputs} outputs and {n} inputs, but a loop has as many of each, and at least one."
        raise UsageError(Fault("E501", "disk_margins", what, "Give the loop transfer, with negative feedback."))
    if known.points is not None:
        what = "measured data are known at their own frequencies only."
        raise UsageError(Fault("E501", "disk_margins", what, "Give a model."))
    channels = _names(loop, n)
    closed = closed_loop(loop, known) if isinstance(loop, StateSpace) or n == 1 else None
    unstable, border, hidden = (closed.unstable, closed.border, closed.hidden) if closed is not None else ((),) * 3
    x = math.nan
    nothing = DiskMargins(channels, False, unstable, border, hidden, x, x, x, (), x, x, x, x, (), float(skew), known.dt)
    if unstable:
        return nothing
    alone = () if border else tuple(_alone(loop, known, i, name) for i, name in enumerate(channels))
    if closed is None:  # where the loop of one channel alone is at the border, S is infinite
        border = tuple(dict.fromkeys(pole for one in alone for pole in one.border))
    if border:
        w = frequencies_of(border, known.dt)[0]
        return replace(
            nothing, border=border, disk=0.0, disk_frequency=w, disk_most=0.0, worst=(1.0 + 0j,) * n, Ms=math.inf,
            Ms_frequency=w, Mt=math.inf, Mt_frequency=w,
        )  # fmt: skip
    peaks, factors, at = _over_frequency(sensitivities(loop)["S"], known, skew)
    stable: bool | None = True
    if closed is None:
        stable = is_stable_by_encirclements(1.0 / np.linalg.det(at) - 1.0, unstable_poles, integrators)
        alone = tuple(replace(one, stable=stable) for one in alone)
    if stable is False:
        return nothing
    with np.errstate(all="ignore"):
        leading = (1 + 0.5 * (1 - skew) * factors) / (1 - 0.5 * (1 + skew) * factors)
    top = peaks["disk"]
    return replace(
        nothing, stable=stable, disk=1.0 / top.value if top.value else math.inf, disk_frequency=top.frequency,
        disk_most=float(np.max(np.abs(factors))), worst=tuple(complex(f) for f in leading), Ms=peaks["S"].value,
        Ms_frequency=peaks["S"].frequency, Mt=peaks["T"].value, Mt_frequency=peaks["T"].frequency, alone=alone,
    )  # fmt: skip


def _over_frequency(sensitivity: object, known: Source, skew: float) -> tuple[dict[str, Peak], Array, Array]:
    """The peaks of S, T and mu, the perturbations that lead to the border at that of mu, and S on a grid.

    known: the loop, whose poles and zeros the grid shows too.
    """
    S, one = source(sensitivity), np.eye(known.inputs)
    laws: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
        "S": (lambda S: S, _largest),
        "T": (lambda S: one - S, _largest),
        "disk": (lambda S: S + 0.5 * (skew - 1) * one, upper_bounds),
    }

    def stacked(omega: Array) -> Array:
        return np.moveaxis(S.at(omega), 2, 0)

    def sizes(omega: Array) -> Array:
        at = stacked(omega)
        laws_of = (_largest, lambda S: _largest(one - S), lambda S: scaled(disk := laws["disk"][0](S), scalings(disk)))
        return np.stack([_where_finite(size, at) for size in laws_of])

    omega, values = refined(sizes, layout(S, known.features))
    usable = np.all(np.isfinite(values), axis=0)
    omega, values = omega[usable], values[:, usable]
    at = stacked(omega)
    values[2] = _bounded(laws["disk"][0](at), values[2])
    ends = _ends(sensitivity, S, known)
    peaks = {}
    for row, (name, (law, size)) in zip(values, laws.items(), strict=True):

        def gain(w: Array, law: Callable[[Array], Array] = law, size: Callable[[Array], Array] = size) -> Array:
            return np.nan_to_num(_where_finite(lambda S: size(law(S)), stacked(w)))

        limits = [Peak(float(size(law(value[None]))[0]), w) for w, value in ends]
        peaks[name] = highest(gain, omega, row, limits)
    top = peaks["disk"]
    there = dict(ends).get(top.frequency)
    there = stacked(np.array([top.frequency]))[0] if there is None else there
    return peaks, worst(laws["disk"][0](there), top.value), at


def fragile_together(loop: object, name: str) -> Fault | None:
    """Return a warning (W701) of a loop at one channel of a name, if all channels of `loop` bear far less together."""
    try:
        together = disk_margins(loop)
    except AnalysisError:  # there is no margin to compare with
        return None
    least = min((one.disk for one in together.alone), default=0.0)
    if not together.disk < _FRAGILE * least:
        return None
    names = ", ".join(f'"{name}"' for name in together.channels)
    message = (
        f"this margin is of one channel alone. Each of {', '.join(together.channels)} has a disk margin of {least:.4g} "
        f"or more if the others are exact, but all together bear no more than {together.disk_most:.4g}."
    )
    cure = f"Ask for their margins together: disk_margins(linearizer.loop([{names}])), or --loop for each."
    return Fault("W701", name, message, cure)


def _largest(matrices: Array) -> Array:
    """The largest singular value of each matrix, (count,)."""
    return np.asarray(np.linalg.svd(matrices, compute_uv=False)[:, 0])


def _where_finite(size: Callable[[Array], Array], matrices: Array) -> Array:
    """Return the size of each matrix, (count,); nan if the matrix is not finite, as at a pole of a response."""
    sizes, usable = np.full(len(matrices), math.nan), np.isfinite(matrices).all(axis=(1, 2))
    if usable.any():
        sizes[usable] = size(matrices[usable])
    return sizes


def _names(loop: Any, count: int) -> tuple[str, ...]:
    named = getattr(loop, "signals", None) or [getattr(loop, "input_labels", None) or range(count)]
    return tuple(str(name) for name in named[0])


def _bounded(matrices: Array, bounds: Array) -> Array:
    """Bounds of mu, which are the least where they might be the largest of all."""
    shown = np.max(np.abs(np.linalg.eigvals(matrices)))  # mu is no smaller
    wanted = bounds >= shown * (1 - 1e-9)
    bounds = bounds.copy()
    bounds[wanted] = upper_bounds(matrices[wanted])
    return bounds


def sensitivities(loop: Any) -> dict[str, object]:
    """S = (I + L)^-1 and T = I - S by name; of a state space as such: where L has poles on the axis, S is finite."""
    if isinstance(loop, StateSpace):
        A, B, C, D = (np.asarray(m, dtype=float) for m in (loop.A, loop.B, loop.C, loop.D))
        one, dt = np.eye(len(D)), period(loop.dt)
        K = np.linalg.inv(one + D)
        A, B, C = A - B @ K @ C, B @ K, K @ C
        return {"S": Rational(A, B, -C, K, dt), "T": Rational(A, B, C, one - K, dt)}
    known = source(loop)
    one = np.eye(known.inputs)

    def S(omega: Array) -> Array:
        return np.moveaxis(_inverses(one + np.moveaxis(known.at(omega), 2, 0)), 0, 2)

    return {"S": _Response(S, known.dt), "T": _Response(lambda omega: one[:, :, None] - S(omega), known.dt)}


def _inverses(matrices: Array) -> Array:
    """Return the inverse of each matrix, (count, n, n); infinite if it is singular."""
    try:
        return np.asarray(np.linalg.inv(matrices))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full(matrices.shape, math.inf)
        return np.concatenate([_inverses(matrix[None]) for matrix in matrices])


def _ends(system: object, S: Source, loop: Source) -> list[tuple[float, Array]]:
    """(frequency, S) at zero and at infinity or the Nyquist frequency, as far as they are known."""
    zero, infinity = np.array([0.0]), S.infinity
    with np.errstate(all="ignore"):
        is_known = bool(np.isfinite(loop.at(zero)).all())
    if S.realization is not None:
        ends = [(0.0, dc_gain(system).astype(complex))]
    else:  # at a pole of L the inverse of I + L would be made of 0 inf
        ends = [(0.0, S.at(zero)[:, :, 0])] if is_known else []
        infinity = None if loop.infinity is None else _inverses(np.eye(loop.inputs)[None] + loop.infinity)[0]
    if S.dt > 0:
        ends.append((S.high, S.at(np.array([S.high]))[:, :, 0]))
    if infinity is not None:
        ends.append((math.inf, infinity.astype(complex)))
    return [(w, value) for w, value in ends if np.all(np.isfinite(value))]


@dataclass(frozen=True, slots=True)
class _Response:
    """A system by its response."""

    at: Callable[[Array], Array]
    dt: float

    def response(self, omega: Array) -> Array:
        with np.errstate(all="ignore"):
            return self.at(omega)


def _alone(loop: Any, known: Source, i: int, name: str) -> Margins:
    """The margins of one channel, where the others are closed."""
    if isinstance(loop, StateSpace):
        A, B, C, D = (np.asarray(m, dtype=float) for m in (loop.A, loop.B, loop.C, loop.D))
        rest = [k for k in range(known.inputs) if k != i]
        own = np.eye(len(rest)) + D[np.ix_(rest, rest)]
        if rest and np.linalg.cond(own) > 1e14:
            message = "has no margins alone: 1 + L of the other channels vanishes at infinite frequency."
            raise AnalysisError(Fault("E705", name, message, "Put a state or a delay into their loops."))
        K = np.linalg.inv(own)
        x, e = K @ C[rest], K @ D[rest][:, [i]]
        B_i, C_i, D_i = B[:, [i]] - B[:, rest] @ e, C[[i]] - D[[i]][:, rest] @ x, D[[i]][:, [i]] - D[[i]][:, rest] @ e
        channel: object = Rational(A - B[:, rest] @ x, B_i, C_i, D_i, period(loop.dt))
    else:
        S = source(sensitivities(loop)["S"])
        channel = _Response(lambda omega: 1.0 / S.at(omega)[i, i] - 1.0, known.dt)
    try:
        return margins(channel)
    except AnalysisError as error:
        message = f"has no margin alone, where the other channels are closed: {error.faults[0].message}"
        cure = getattr(loop, "hint", "") or error.faults[0].cure
        raise AnalysisError(Fault("E705", name, message, cure)) from None
