"""What a figure shows: the systems that were given, and curves of their responses, over frequency and to a step."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..results.plots import INK, STYLES
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from .figure_look import FAINT, Shown, note
from .realization import balanced, equivalent, period
from .response import dc_gain
from .search import layout, refined
from .systems import StateSpace, is_of, source

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = len(STYLES)


def shown_of(systems: object, place: str) -> list[Shown]:
    if isinstance(systems, Mapping):
        named = [(str(name), system) for name, system in systems.items()]
    elif isinstance(systems, (list, tuple)):
        named = [(_own_name(system) or f"{index}", system) for index, system in enumerate(systems, 1)]
    else:
        named = [(_own_name(systems), systems)]
    if not 0 < len(named) <= _MOST:
        cure = f"Draw 1 to {_MOST} systems."
        raise UsageError(Fault("E501", place, f"{len(named)} systems cannot be distinguished in one figure.", cure))
    return [Shown(name, system, source(system), index) for index, (name, system) in enumerate(named)]


def _own_name(system: Any) -> str:
    """A name that somebody gave; python-control numbers the others."""
    if not is_of(system, "StateSpace", "TransferFunction", "FrequencyResponseData"):
        return ""
    name = str(system.name or "")
    return "" if re.search(r"sys\[\d+\]", name) else name


def single_channels(systems: object, place: str) -> list[Shown]:
    shown = shown_of(systems, place)
    for trace in shown:
        if (trace.known.outputs, trace.known.inputs) != (1, 1):
            what = f"{trace.name or 'the system'} has {trace.known.outputs} outputs and {trace.known.inputs} inputs."
            raise UsageError(Fault("E501", place, what, "Choose a channel, system[i, j], or draw sigma()."))
    return shown


def span_of(shown: Sequence[Shown], omega: Iterable[float] | None) -> tuple[float, float]:
    """The limits of the frequency axis: a decade about poles, zeros and measured points, in whole decades."""
    if omega is not None:
        given = np.asarray(list(omega), dtype=float)
        if len(given) < 2 or not np.all(np.isfinite(given)) or np.min(given) <= 0 or np.min(given) == np.max(given):
            raise UsageError(Fault("E501", "omega", "must be at least two positive numbers, in rad/s."))
        return float(np.min(given)), float(np.max(given))
    low, high = [], []
    for trace in shown:
        if trace.known.points is not None:
            low.append(float(np.min(trace.known.points[trace.known.points > 0])))
            high.append(trace.known.high)
            continue
        features = trace.known.features if trace.known.features is not None else np.zeros(0)
        sizes = np.abs(features)
        sizes = sizes[np.isfinite(sizes) & (sizes > 1e-9 * np.max(sizes, initial=0.0))]
        if len(sizes):
            low.append(0.1 * float(np.min(sizes)))
            high.append(min(10 * float(np.max(sizes)), trace.known.high))
        elif trace.known.dt > 0:
            low.append(1e-3 * trace.known.high)
            high.append(trace.known.high)
        if (trace.known.outputs, trace.known.inputs) == (1, 1) and len(sizes) == 0 and trace.known.dt == 0:
            w = layout(trace.known)
            gains = np.abs(trace.known.siso(w))
            k = int(np.argmin(np.abs(np.log(np.maximum(gains, 1e-300)))))
            low.append(0.01 * float(w[k]))
            high.append(100 * float(w[k]))
    if not low:
        low, high = [1e-2], [1e2]
    a, b = 10 ** math.floor(math.log10(min(low)) + 1e-9), 10 ** math.ceil(math.log10(max(high)) - 1e-9)
    limit = max(trace.known.high for trace in shown)
    return a, min(b, limit * 1.15)


def curve_of(one: Shown, span: tuple[float, float]) -> tuple[Array, Array]:
    """Frequencies within the span, and the response; measured data: their own."""
    if one.measured:
        assert one.known.points is not None
        w = one.known.points[one.known.points > 0]
        return w, one.known.siso(w)
    w = layout(one.known)
    w = w[(w >= span[0]) & (w <= span[1])]
    w = np.unique(np.concatenate([np.geomspace(span[0], min(span[1], one.known.high), 200), w]))
    w, values = refined(one.known.siso, w)
    keep = np.isfinite(values)
    return w[keep], values[keep]


def full_curve_of(one: Shown) -> tuple[Array, Array]:
    if one.measured:
        return curve_of(one, (0.0, math.inf))
    w, values = refined(one.known.siso, layout(one.known), change=0.05)
    if one.known.dt > 0:
        w, values = np.append(w, one.known.high), np.append(values, one.known.siso(np.array([one.known.high])))
    keep = np.isfinite(values)
    return w[keep], values[keep]


def decibel_of(values: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20 * np.log10(np.maximum(np.abs(values), 1e-300)))


def phase_of(w: Array, values: Array) -> Array:
    """Degrees, unwrapped; a slope of n at the low end begins near 90 n degrees, a negative gain at -180."""
    angles = np.angle(values)
    steps = np.diff(angles)
    steps = (steps + math.pi) % (2 * math.pi) - math.pi
    # Across a pole on the axis the phase falls by 180 degrees, across a zero it rises.
    jumps = np.flatnonzero(np.abs(steps) > 0.95 * math.pi)
    gains = np.abs(values)
    for k in (int(index) for index in jumps):
        around = max(float(gains[max(0, k - 3)]), float(gains[min(len(gains) - 1, k + 4)]))
        pole = max(float(gains[k]), float(gains[k + 1])) > around
        steps[k] = -abs(steps[k]) if pole else abs(steps[k])
    phase = np.degrees(np.concatenate([[angles[0]], angles[0] + np.cumsum(steps)]))
    if len(w) > 1 and gains[0] > 0 and gains[1] > 0:
        slope = round(math.log(gains[1] / gains[0]) / math.log(w[1] / w[0]))
        phase -= 360 * math.ceil((phase[0] - 90 * slope) / 360 - 0.5 - 1e-9) if slope else 0.0
        phase -= 360.0 if slope == 0 and phase[0] > 170 else 0.0
    return np.asarray(phase)


def _state_space(trace: Shown) -> Any:
    if is_of(trace.system, "TransferFunction"):
        import control

        return control.tf2ss(trace.system)
    if isinstance(trace.system, StateSpace):
        return trace.system
    cure = "Fit a model, or simulate."
    raise AnalysisError(
        Fault(
            "E705", "step_figure", "a response that is known at some frequencies only has no exact step response.", cure
        )
    )


def settling_time(one: Shown) -> float:
    features = one.known.features if one.known.realization is None else None
    if features is None:
        model = balanced(_state_space(one)).visible()
        p = model.eigenvalues()
        features = equivalent(p, model.dt)
    rates = np.abs(features.real)
    slow = rates[(rates > 1e-9 * np.max(np.abs(features), initial=0.0)) & (features.real < 0)]
    if len(slow):
        last = 7.0 / float(np.min(slow))
    else:
        sizes = np.abs(features)[np.abs(features) > 0]
        last = 10.0 / float(np.min(sizes)) if len(sizes) else 1.0
    return max(last, 10 * one.known.dt)


def step_response(one: Shown, last: float) -> tuple[Array, Array]:
    from scipy.linalg import expm

    system = _state_space(one)
    a, b, c, d = (np.asarray(part, dtype=float) for part in (system.A, system.B, system.C, system.D))
    n, dt = len(a), period(system.dt)
    if dt > 0:
        count, h = min(20_000, math.floor(last / dt) + 1), dt
    else:
        count, h = 1500, last / 1499
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n:] = a * h, b * h
        exponential = expm(whole)
        a, b = exponential[:n, :n], exponential[:n, n:]
    x, y = np.zeros((n, 1)), np.empty(count)
    for k in range(count):
        y[k] = float((c @ x + d)[0, 0])
        x = a @ x + b
    return np.arange(count) * h, y


def draw_step_figures(axis: Axes, one: Shown, t: Array, y: Array) -> None:
    """The final value with its band of 2 %, the overshoot and the time to settle, where there are such."""
    final = float(dc_gain(one.system)[0, 0])
    if not math.isfinite(final) or final == 0 or abs(y[-1] - final) > 0.05 * abs(final):
        return
    axis.axhspan(0.98 * final, 1.02 * final, color=FAINT, alpha=0.22, linewidth=0)
    axis.axhline(final, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    mark = STYLES[1][0]
    k = int(np.argmax(y * np.sign(final)))
    over = y[k] / final - 1
    if over > 0.005 and 0 < k < len(t) - 1:
        axis.plot([t[k]], [y[k]], "o", color=mark, markersize=4)
        note(axis, f"{100 * over:.3g} % over at {t[k]:.3g} s", (t[k], y[k]), (6, 2), color=mark)
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.05 * (high - low))
    outside = np.flatnonzero(np.abs(y - final) > 0.02 * abs(final))
    if len(outside) and outside[-1] + 1 < len(t):
        settled = t[outside[-1] + 1]
        place, side = (settled, y[outside[-1] + 1]), "right" if settled > 0.7 * t[-1] else "left"
        axis.plot([place[0]], [place[1]], "s", color=mark, markersize=4)
        note(axis, f"within 2 % from {settled:.3g} s", place, (0, -14), color=mark, ha=side)
