"""Figures over frequency: Bode, Nyquist, Nichols, singular values, the gang of four, poles and zeros, steps.

Each function takes a system, several, or a mapping of names to systems, and returns a `matplotlib.figure.Figure` that
`results.plots.save` and `svg_text` write. Models are lines; measured data (control.FrequencyResponseData) are points
upon them. Axes in rad/s, dB and degrees; phases are unwrapped from the slope at the low end, so that a double
integrator begins at -180 and not at +180 degrees. The module is long because each figure is one function.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..results.plots import _INK, STYLES, defaults, plain
from ..text.errors import AnalysisError, Fault, UsageError
from .margins import Margins
from .margins import margins as margins_of
from .realization import balanced, equivalent, period
from .response import dc_gain, poles, zeros
from .search import highest, layout, refined
from .systems import Source, source

__all__ = ["bode", "gang_of_four", "nichols", "nyquist", "pole_map", "sigma", "step_figure"]

Array = np.ndarray[Any, Any]

_GRID = {"color": "#94a3b8", "alpha": 0.35, "linewidth": 0.5}
_FAINT = "#94a3b8"
_SMALL = 8  # points
_MOST = len(STYLES)
_DRAWN = 4  # crossings of each kind
# Poles and zeros of each style.
_MARKS = (("x", "o"), ("+", "s"), ("1", "D"), ("2", "^"), ("3", "v"), ("4", "p"))
_CONTOURS = (12.0, 6.0, 3.0, 1.0, -1.0, -3.0, -6.0, -12.0, -20.0, -40.0)  # dB of T in a Nichols chart


@dataclass(frozen=True, slots=True)
class _Shown:
    """A system in a figure: its name, what is known of it, and its style."""

    name: str
    system: Any
    known: Source
    style: int

    @property
    def label(self) -> str:
        return plain(self.name)

    @property
    def color(self) -> str:
        return STYLES[self.style][0]

    @property
    def pattern(self) -> Any:
        return STYLES[self.style][1]

    @property
    def measured(self) -> bool:
        return self.known.points is not None


@defaults()
def bode(systems: Any, omega: Iterable[float] | None = None, *, margins: bool = True) -> Any:
    """Gain and phase over frequency; the gain and phase margins of a single loop are drawn.

    omega: frequencies [rad/s]; without them they are laid out from poles and zeros. margins: off where the system is no
    loop. Several systems are laid over each other without margins. Raises UsageError (E501).
    """
    shown = _single_channels(systems, "bode")
    span = _span(shown, omega)
    figure, (above, below) = _figure(2, 1, height=4.6, share=True)
    curves = []
    for one in shown:
        w, values = _curve(one, span)
        gain, phase = _decibel(values), _phase(w, values)
        curves.append((w, gain, phase))
        for axis, y in ((above, gain), (below, phase)):
            _plot(axis, one, w, y, len(shown))
            if one.known.dt > 0 and not one.measured:
                axis.axvline(one.known.high, color=one.color, linewidth=0.8, alpha=0.6)
    for axis in (above, below):
        axis.set_xscale("log")
        axis.set_xlim(*span)
        axis.grid(True, which="minor", axis="x", color=_FAINT, alpha=0.15, linewidth=0.5)
    above.set_ylabel("gain [dB]")
    below.set_ylabel("phase [deg]")
    below.set_xlabel("frequency [rad/s]")
    found = margins_of(shown[0].system) if margins and len(shown) == 1 else None
    drawn = found is not None and bool(found.gains or found.phases)
    _limit_decibel(above, floor=-60.0 if drawn else -math.inf)
    _degrees(below)
    if found is not None and drawn:
        _margins_on_bode(above, below, found, curves[0])
    _name(above, shown)
    _finish(figure)
    return figure


@defaults()
def nyquist(loop: Any, *, margins: bool = True) -> Any:
    """The loop transfer in the complex plane, with -1, the unit circle, the circle that Ms keeps free, and margins.

    Negative frequencies are drawn faintly. The view is that of the critical point: what an integrator sends to
    infinity leaves it. Raises UsageError (E501).
    """
    shown = _single_channels(loop, "nyquist")
    figure, axis = _figure(1, 1, height=5.2, width=5.6)
    circle = np.exp(1j * np.linspace(0, 2 * math.pi, 361))
    axis.axhline(0, color=_FAINT, linewidth=0.6)
    axis.axvline(0, color=_FAINT, linewidth=0.6)
    axis.plot(circle.real, circle.imag, color=_INK, linewidth=0.8, linestyle=(0, (1, 2)))
    found = margins_of(shown[0].system) if margins and len(shown) == 1 else None
    curves = [_full_curve(one)[1] for one in shown]
    low, high = _view(curves, found)
    size = high - low
    for one, values in zip(shown, curves, strict=True):
        if one.measured:
            axis.plot(values.real, values.imag, "o", color=one.color, markersize=3.5, fillstyle="none", label=one.label)
            continue
        pattern = one.pattern if len(shown) > 1 else "solid"
        axis.plot(values.real, values.imag, color=one.color, linestyle=pattern, linewidth=1.4, label=one.label)
        axis.plot(values.real, -values.imag, color=one.color, linestyle=pattern, linewidth=0.8, alpha=0.4)
        _arrow(axis, one, values, size)
    axis.set_xlim(low, high)
    axis.set_ylim(-0.5 * size, 0.5 * size)
    if found is not None:
        _margins_on_nyquist(axis, found, curves[0], size)
    axis.plot([-1], [0], "+", color=_INK, markersize=9, markeredgewidth=1.6)
    axis.set_aspect("equal")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    _name(axis, shown)
    _finish(figure)
    return figure


@defaults()
def nichols(systems: Any, *, margins: bool = True) -> Any:
    """Gain over phase of loops, upon the curves of constant |T|. Raises UsageError (E501)."""
    shown = _single_channels(systems, "nichols")
    figure, axis = _figure(1, 1, height=5.2, width=6.6)
    curves = []
    for one in shown:
        w, values = _full_curve(one)
        curves.append((one, _phase(w, values), _decibel(values)))
    everything = np.concatenate([phase[(gain > -40) & (gain < 40)] for _, phase, gain in curves] or [np.zeros(0)])
    left = 90 * math.floor((min(float(np.min(everything, initial=-200.0)), -200.0)) / 90)
    right = 90 * math.ceil((max(float(np.max(everything, initial=-110.0)), -110.0) + 20) / 90)
    left = max(left, right - 720)
    axis.set_xlim(left, right)
    axis.set_ylim(-40, 40)
    _contours(axis, left, right)
    for one, phase, gain in curves:
        _plot(axis, one, phase, gain, len(shown))
    found = margins_of(shown[0].system) if margins and len(shown) == 1 else None
    if found is not None:
        _margins_on_nichols(axis, found, curves[0][1], curves[0][2])
    for turn in np.arange(-180 - 360 * 3, 721, 360):
        if left <= turn <= right:
            axis.plot([turn], [0], "+", color=_INK, markersize=9, markeredgewidth=1.6)
    axis.set_xlabel("phase [deg]")
    axis.set_ylabel("gain [dB]")
    _degrees(axis, which="x")
    _name(axis, shown)
    _finish(figure)
    return figure


@defaults()
def sigma(systems: Any, omega: Iterable[float] | None = None) -> Any:
    """Singular values over frequency: the largest and the smallest as lines, with what lies between them shaded."""
    shown = _shown(systems, "sigma")
    span = _span(shown, omega)
    figure, axis = _figure(1, 1, height=3.4)
    for one in shown:
        if one.measured:
            assert one.known.points is not None
            w = one.known.points[one.known.points > 0]
        else:
            w = np.geomspace(max(span[0], one.known.low), min(span[1], one.known.high), 60)
            w = refined(one.known.at, w, passes=6)[0]
        stack = np.moveaxis(one.known.at(w), 2, 0)
        finite = np.all(np.isfinite(stack), axis=(1, 2))
        w = w[finite]
        values = _decibel(np.linalg.svd(stack[finite], compute_uv=False))
        _plot(axis, one, w, values[:, 0], len(shown))
        if values.shape[1] > 1:
            _plot(axis, one, w, values[:, -1], len(shown), label=False)
            axis.fill_between(w, values[:, -1], values[:, 0], color=one.color, alpha=0.1, linewidth=0)
    axis.set_xscale("log")
    axis.set_xlim(*span)
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("singular values [dB]")
    _limit_decibel(axis)
    _name(axis, shown)
    _finish(figure)
    return figure


@defaults()
def gang_of_four(plant: Any, controller: Any, omega: Iterable[float] | None = None) -> Any:
    """|S|, |T|, |PS| and |CS| of a plant P and a controller C in a loop with negative feedback; with their peaks."""
    parts = _single_channels({"P": plant, "C": controller}, "gang_of_four")
    if len({one.known.dt for one in parts}) != 1:
        raise UsageError(Fault("E501", "gang_of_four", "the plant and the controller have different periods."))
    if any(one.measured for one in parts):
        raise UsageError(Fault("E501", "gang_of_four", "measured data stand at their own points; give models."))
    p, c = (one.known.siso for one in parts)
    span = _span(parts, omega)
    laws: tuple[tuple[str, str, Callable[[Array, Array], Array]], ...] = (
        ("S = 1/(1 + PC)", "set point to error", lambda P, C: 1 / (1 + P * C)),
        ("T = PC/(1 + PC)", "noise to output", lambda P, C: P * C / (1 + P * C)),
        ("PS = P/(1 + PC)", "load to output", lambda P, C: P / (1 + P * C)),
        ("CS = C/(1 + PC)", "noise to control", lambda P, C: C / (1 + P * C)),
    )
    figure, axes = _figure(2, 2, height=5.0, width=7.6, share=True)
    start = np.geomspace(*span, 200)
    for axis, (title, meaning, law) in zip(np.ravel(axes), laws, strict=True):

        def value(w: Array, law: Callable[[Array, Array], Array] = law) -> Array:
            with np.errstate(all="ignore"):
                return law(p(w), c(w))

        w, values = refined(value, start, passes=6)
        gain = _decibel(values)
        w, gain = w[np.isfinite(gain)], gain[np.isfinite(gain)]
        axis.plot(w, gain, color=STYLES[0][0], linewidth=1.4)
        top = highest(_size_of(value), w, 10 ** (gain / 20), ())
        axis.set_title(title, fontsize=10, loc="left", color=_INK)
        axis.set_title(meaning, fontsize=_SMALL, loc="right", color="#64748b")
        axis.set_xscale("log")
        axis.set_xlim(*span)
        _limit_decibel(axis)
        low, high = axis.get_ylim()
        if low < 0 < high:
            axis.axhline(0, color=_FAINT, linewidth=0.8, zorder=0)
        # A summit within the picture; not a level that is kept to its edge.
        if w[0] < top.frequency < w[-1] and top.value > 1.001 * 10 ** (max(gain[0], gain[-1]) / 20):
            level = 20 * math.log10(top.value)
            axis.plot([top.frequency], [level], "o", color=STYLES[0][0], markersize=4)
            axis.set_ylim(low, max(high, level + 0.16 * (high - low)))
            part = math.log(top.frequency / span[0]) / math.log(span[1] / span[0])
            axis.annotate(
                f"{top.value:.4g} at {top.frequency:.4g} rad/s", (top.frequency, level), xytext=(0, 6), color=_INK,
                textcoords="offset points", ha="right" if part > 0.7 else "left" if part < 0.3 else "center",
                fontsize=_SMALL,
            )  # fmt: skip
    for axis in axes[1]:
        axis.set_xlabel("frequency [rad/s]")
    for axis in axes[:, 0]:
        axis.set_ylabel("gain [dB]")
    _finish(figure)
    return figure


@defaults()
def pole_map(systems: Any) -> Any:
    """Poles (crosses) and zeros (circles); with lines of equal damping and, for sampled systems, the unit circle."""
    shown = _shown(systems, "pole_map")
    sampled = {one.known.dt > 0 for one in shown}
    if len(sampled) != 1:
        raise UsageError(Fault("E501", "pole_map", "continuous and sampled systems have no plane in common."))
    figure, axis = _figure(1, 1, height=5.0, width=5.8)
    found = []
    for one in shown:
        found.append((one, poles(one.system), _known_zeros(one)))
    everything = np.concatenate([part for _, p, z in found for part in (p, z)] or [np.zeros(0)])
    if sampled == {True}:
        _unit_circle(axis, everything)
    else:
        _half_plane(axis, everything)
    for one, p, z in found:
        label = f"{one.label}: " if one.name else ""
        cross, ring = _MARKS[one.style]
        axis.plot(
            p.real, p.imag, cross, color=one.color, markersize=8, markeredgewidth=1.8, label=f"{label}poles",
            linestyle="none",
        )  # fmt: skip
        if len(z):
            axis.plot(
                z.real, z.imag, ring, color=one.color, markersize=7, fillstyle="none", markeredgewidth=1.4,
                label=f"{label}zeros", linestyle="none",
            )  # fmt: skip
    axis.set_xlabel("real part [1/s]" if sampled == {False} else "real part of z")
    axis.set_ylabel("imaginary part [1/s]" if sampled == {False} else "imaginary part of z")
    figure.legend(loc="outside upper center", ncols=4, fontsize=_SMALL, frameon=False, labelcolor=_INK)
    _finish(figure)
    return figure


@defaults()
def step_figure(systems: Any, *, until: float | None = None) -> Any:
    """Responses to a unit step, exactly; with overshoot and the time to stay within 2 % of a single one.

    until: the last time [s]; without it, what the slowest pole needs to settle. Raises UsageError (E501).
    """
    shown = _single_channels(systems, "step_figure")
    figure, axis = _figure(1, 1, height=3.4)
    last = until if until is not None else max(_settling(one) for one in shown)
    if not (math.isfinite(last) and last > 0):
        raise UsageError(Fault("E501", "step_figure", "until= is a positive time in s."))
    for one in shown:
        t, y = _step(one, last)
        pattern = one.pattern if len(shown) > 1 else "solid"
        style = "steps-post" if one.known.dt > 0 else "default"
        axis.plot(t, y, color=one.color, linestyle=pattern, linewidth=1.4, drawstyle=style, label=one.label)
        if len(shown) == 1:
            _step_figures(axis, one, t, y)
    axis.set_xlim(0, last)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("response to a unit step")
    _name(axis, shown)
    _finish(figure)
    return figure


def _size_of(value: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda w: np.asarray(np.abs(value(w)))


# What is shown


def _shown(systems: Any, place: str) -> list[_Shown]:
    if isinstance(systems, Mapping):
        named = [(str(name), system) for name, system in systems.items()]
    elif isinstance(systems, (list, tuple)):
        named = [(_own_name(system) or f"{index}", system) for index, system in enumerate(systems, 1)]
    else:
        named = [(_own_name(systems), systems)]
    if not 0 < len(named) <= _MOST:
        cure = f"Give one to {_MOST}."
        raise UsageError(Fault("E501", place, f"{len(named)} systems cannot be told apart in one figure.", cure))
    return [_Shown(name, system, source(system), index) for index, (name, system) in enumerate(named)]


def _own_name(system: Any) -> str:
    """A name that somebody gave; python-control numbers the others."""
    import control

    if not isinstance(system, (control.StateSpace, control.TransferFunction, control.FrequencyResponseData)):
        return ""
    name = str(system.name or "")
    return "" if re.search(r"sys\[\d+\]", name) else name


def _single_channels(systems: Any, place: str) -> list[_Shown]:
    shown = _shown(systems, place)
    for one in shown:
        if (one.known.outputs, one.known.inputs) != (1, 1):
            what = f"{one.name or 'the system'} has {one.known.outputs} outputs and {one.known.inputs} inputs."
            raise UsageError(Fault("E501", place, what, "Pick a channel, system[i, j], or draw sigma()."))
    return shown


def _span(shown: Sequence[_Shown], omega: Iterable[float] | None) -> tuple[float, float]:
    """The limits of the frequency axis: a decade about poles, zeros and measured points, in whole decades."""
    if omega is not None:
        given = np.asarray(list(omega), dtype=float)
        if len(given) < 2 or not np.all(np.isfinite(given)) or np.min(given) <= 0 or np.min(given) == np.max(given):
            raise UsageError(Fault("E501", "omega", "frequencies are positive numbers in rad/s, and two at least."))
        return float(np.min(given)), float(np.max(given))
    low, high = [], []
    for one in shown:
        if one.known.points is not None:
            low.append(float(np.min(one.known.points[one.known.points > 0])))
            high.append(one.known.high)
            continue
        found = one.known.features if one.known.features is not None else np.zeros(0)
        sizes = np.abs(found)
        sizes = sizes[np.isfinite(sizes) & (sizes > 1e-9 * np.max(sizes, initial=0.0))]
        if len(sizes):
            low.append(0.1 * float(np.min(sizes)))
            high.append(min(10 * float(np.max(sizes)), one.known.high))
        elif one.known.dt > 0:
            low.append(1e-3 * one.known.high)
            high.append(one.known.high)
        if (one.known.outputs, one.known.inputs) == (1, 1) and len(sizes) == 0 and one.known.dt == 0:
            w = layout(one.known)
            gains = np.abs(one.known.siso(w))
            k = int(np.argmin(np.abs(np.log(np.maximum(gains, 1e-300)))))
            low.append(0.01 * float(w[k]))
            high.append(100 * float(w[k]))
    if not low:
        low, high = [1e-2], [1e2]
    a, b = 10 ** math.floor(math.log10(min(low)) + 1e-9), 10 ** math.ceil(math.log10(max(high)) - 1e-9)
    limit = max(one.known.high for one in shown)
    return a, min(b, limit * 1.15)


def _curve(one: _Shown, span: tuple[float, float]) -> tuple[Array, Array]:
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


def _full_curve(one: _Shown) -> tuple[Array, Array]:
    if one.measured:
        return _curve(one, (0.0, math.inf))
    w, values = refined(one.known.siso, layout(one.known), change=0.05)
    if one.known.dt > 0:
        w, values = np.append(w, one.known.high), np.append(values, one.known.siso(np.array([one.known.high])))
    keep = np.isfinite(values)
    return w[keep], values[keep]


def _decibel(values: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(20 * np.log10(np.maximum(np.abs(values), 1e-300)))


def _phase(w: Array, values: Array) -> Array:
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


# Margins upon figures


def _margins_on_bode(above: Any, below: Any, m: Margins, curve: tuple[Array, Array, Array]) -> None:
    mark = STYLES[1][0]
    w, gain, phase = curve
    span = above.get_xlim()
    turns: set[float] = set()
    # Of the crossings that a delay makes without end, those near the border.
    gains = sorted(m.gains, key=lambda one: abs(math.log(one[0])))[:_DRAWN]
    for factor, at in gains:
        if not span[0] <= at <= w[-1]:
            continue
        level = -20 * math.log10(factor)
        there = float(np.interp(math.log(at), np.log(w), phase))
        turns.add(-180.0 + 360.0 * round((there + 180) / 360))
        _upright((above, below), at)
        if factor in (m.gain, m.gain_low):
            _measure(above, at, 0.0, level)
            text = f"gain margin {factor:.4g} ({-level:.3g} dB)"
            _beside(above, at, level / 2, text, (w, gain), border=0.0, left=level > 0)
            below.plot([at], [there], "o", color=mark, markersize=4)
    for degrees, at in sorted(m.phases, key=lambda one: abs(one[0]))[:_DRAWN]:
        if not span[0] <= at <= w[-1]:
            continue
        there = float(np.interp(math.log(at), np.log(w), phase))
        border = there - degrees
        turns.add(border)
        _upright((above, below), at)
        if degrees == m.phase_deg:
            _measure(below, at, border, there)
            _beside(
                below, at, (border + there) / 2, f"phase margin {degrees:.3g}°", (w, phase), border=border, left=True
            )
            above.plot([at], [0], "o", color=mark, markersize=4)
    above.axhline(0, color=_INK, linewidth=0.8, linestyle=(0, (1, 2)))
    for turn in {round(turn, 3) for turn in turns}:
        below.axhline(turn, color=_INK, linewidth=0.8, linestyle=(0, (1, 2)))
    _warn(above, m)


def _upright(axes: Sequence[Any], x: float) -> None:
    for axis in axes:
        axis.axvline(x, color=_FAINT, linewidth=0.8, linestyle=(0, (3, 2)), zorder=0)


def _measure(axis: Any, x: float, start: float, end: float) -> None:
    axis.plot([x, x], [start, end], color=STYLES[1][0], linewidth=2.2, solid_capstyle="butt")
    axis.plot([x], [end], "o", color=STYLES[1][0], markersize=4)


def _warn(axis: Any, m: Margins) -> None:
    if m.stable is False:
        axis.set_title("closed loop unstable", fontsize=9, loc="right", color=STYLES[5][0])


def _beside(axis: Any, x: float, y: float, text: str, curve: tuple[Array, Array], *, border: float, left: bool) -> None:
    """A text beside x, on the side and at the height where the curve does not run through it."""
    low, high = axis.get_ylim()
    span = np.log(np.asarray(axis.get_xlim()))
    # Of the panel: a letter is a hundredth wide, a line a twentieth high, at 8 points in these figures.
    width, height = 0.0105 * len(text) * (span[1] - span[0]), 0.08 * (high - low)
    best: tuple[float, bool, float] | None = None
    for shift in np.arange(-3.0, 3.1, 0.5):
        for side in (left, not left):
            a = math.log(x) - width if side else math.log(x)
            inside = (np.log(curve[0]) >= a) & (np.log(curve[0]) <= a + width)
            center = y + shift * height
            free = float(np.min(np.abs(curve[1][inside] - center), initial=abs(center - border))) / height
            fits = a > span[0] and a + width < span[1] and low + height / 2 < center < high - height / 2
            score = min(free, 0.8) - 0.1 * abs(shift) - 0.05 * (side != left) - 10 * (not fits)
            if best is None or score > best[0]:
                best = (score, side, center)
    assert best is not None
    axis.annotate(
        text, (x, best[2]), xytext=(-7 if best[1] else 7, 0), textcoords="offset points", fontsize=_SMALL,
        va="center", ha="right" if best[1] else "left", color=STYLES[1][0],
    )  # fmt: skip


def _margins_on_nyquist(axis: Any, m: Margins, curve: Array, size: float) -> None:
    mark = STYLES[1][0]
    circle = np.exp(1j * np.linspace(0, 2 * math.pi, 361))
    # Texts stand where no curve and no other mark is near.
    taken = [curve, curve.conj(), circle[::6], np.linspace(-10, 10, 401) + 0j]
    if m.phase_deg is not None:
        angles = np.radians(np.linspace(180, 180 + m.phase_deg, 60))
        arc = np.exp(1j * angles)
        axis.plot(arc.real, arc.imag, color=mark, linewidth=2.2, solid_capstyle="butt")
        axis.plot([0, arc[-1].real], [0, arc[-1].imag], color=mark, linewidth=0.7, linestyle=(0, (1, 2)))
        axis.plot([arc[-1].real], [arc[-1].imag], "o", color=mark, markersize=5)
        taken.append(arc[-1] * np.linspace(0, 1, 20))
    if 0 < m.modulus < 3:
        free = -1 + m.modulus * circle
        axis.fill(free.real, free.imag, color=mark, alpha=0.08, linewidth=0)
        axis.plot(free.real, free.imag, color=mark, linewidth=0.9, linestyle=(0, (4, 2)))
        taken.append(free)
    for factor in (m.gain, m.gain_low):
        if factor is not None and 1 / factor < 1.5 * size:
            axis.plot([-1 / factor], [0], "o", color=mark, markersize=5)
            _label(axis, -1 / factor, 0.0, f"gain margin {factor:.4g}", taken, size)
    if m.phase_deg is not None:
        _label(axis, complex(arc[-1]), 0.0, f"phase margin {m.phase_deg:.4g}°", taken, size)
    if 0 < m.modulus < 3:
        _label(axis, -1, m.modulus, f"$M_s$ = {m.Ms:.4g}", taken, size)
    _warn(axis, m)


def _label(axis: Any, center: complex, radius: float, text: str, taken: list[Array], size: float) -> None:
    """A text beside a point or a circle, in the direction that is freest; its own place is taken from then on."""
    width, height = 0.0108 * len(text.replace("$", "")) * size, 0.026 * size
    crowd = np.concatenate(taken)
    best: tuple[float, complex] | None = None
    for distance in (0.025, 0.05, 0.08, 0.12):
        for angle in np.radians(np.arange(0, 360, 15)):
            direction = complex(np.exp(1j * angle))
            # The middle of the text, so far out that its box touches the circle.
            middle = center + direction * (radius + distance * size)
            middle += direction.real * width / 2 + 1j * direction.imag * height / 2
            offset = crowd - middle
            gap = np.maximum(np.abs(offset.real) - width / 2, np.abs(offset.imag) - height / 2)
            score = min(float(np.min(gap)) / size, 0.02) - 0.1 * distance
            a, b = axis.get_xlim()
            if middle.real - width / 2 < a or middle.real + width / 2 > b:
                score -= 1.0
            if best is None or score > best[0] + 1e-9:
                best = (score, middle)
    assert best is not None
    middle = best[1]
    axis.text(middle.real, middle.imag, text, fontsize=_SMALL, ha="center", va="center", color=STYLES[1][0])
    box = np.linspace(-0.5, 0.5, 9)
    taken.append(middle + np.add.outer(width * box, 1j * height * box).ravel())


def _margins_on_nichols(axis: Any, m: Margins, phase: Array, gain: Array) -> None:
    mark = STYLES[1][0]
    near = -180 + 360 * np.round((phase + 180) / 360)
    if m.gain is not None:
        level = -20 * math.log10(m.gain)
        k = int(np.argmin(np.abs(phase - near) + 3 * np.abs(gain - level)))
        _measure(axis, near[k], 0.0, level)
        axis.annotate(
            f"gain margin {m.gain:.4g} ({-level:.3g} dB)", (near[k], level / 2), xytext=(-6, 0), va="center",
            textcoords="offset points", fontsize=_SMALL, ha="right", color=mark,
        )  # fmt: skip
    if m.phase_deg is not None:
        k = int(np.argmin(np.abs(phase - near - m.phase_deg) + 3 * np.abs(gain)))
        axis.plot([near[k], near[k] + m.phase_deg], [0, 0], color=mark, linewidth=2.2, solid_capstyle="butt")
        axis.plot([near[k] + m.phase_deg], [0], "o", color=mark, markersize=4)
        left, right = axis.get_xlim()
        x = near[k] + m.phase_deg
        if x < right - 0.25 * (right - left):
            offset, side = (7, 0), "left"
        else:
            offset, side = (-4, 9), "right"
        axis.annotate(
            f"phase margin {m.phase_deg:.4g}°", (x, 0), xytext=offset, va="center", textcoords="offset points",
            fontsize=_SMALL, ha=side, color=mark,
        )  # fmt: skip
    _warn(axis, m)


def _contours(axis: Any, left: float, right: float) -> None:
    """Curves of constant |T| = |L/(1 + L)|, repeated for every turn of the phase."""
    turn = np.linspace(1e-3, 2 * math.pi - 1e-3, 721)
    for level in _CONTOURS:
        t = 10 ** (level / 20) * np.exp(1j * turn)
        loop = t / (1 - t)
        phase, gain = np.degrees(np.unwrap(np.angle(loop))), _decibel(loop)
        phase -= 360 * round((float(np.mean(phase)) + 180) / 360)
        for shift in np.arange(-1080, 1081, 360):
            if np.max(phase + shift) < left or np.min(phase + shift) > right:
                continue
            axis.plot(phase + shift, gain, color=_FAINT, linewidth=0.6, alpha=0.7, zorder=0)
            k = int(np.argmax(gain)) if level > 0 else len(turn) - 1
            x, y = phase[k] + shift, gain[k]
            if level < 0:
                k = int(np.argmin(np.abs(phase + shift - (right - 4))))
                x, y = right - 4, gain[k]
                if abs(phase[k] + shift - x) > 5:
                    continue
            if left < x <= right and abs(y) < 38:
                axis.annotate(
                    f"{level:g} dB", (x, y), xytext=(0, 2), textcoords="offset points", fontsize=6.5, color="#64748b",
                    ha="center" if level > 0 else "right",
                )  # fmt: skip


# Planes


def _known_zeros(one: _Shown) -> Array:
    try:
        return zeros(one.system)
    except AnalysisError:
        return np.zeros(0, complex)  # a matrix of polynomials: its poles alone are shown


def _half_plane(axis: Any, everything: Array) -> None:
    size = max(float(np.max(np.abs(everything), initial=0.0)), 1e-9)
    left = min(float(np.min(everything.real, initial=0.0)), -0.25 * size)
    right = max(float(np.max(everything.real, initial=0.0)), 0.2 * size)
    top = max(float(np.max(np.abs(everything.imag), initial=0.0)), 0.5 * size)
    left, right, top = 1.15 * left, 1.2 * right, 1.15 * top
    # The panel is wider than high by a tenth; equal units on both axes.
    wide = max(right - left, 2.2 * top)
    left, top = right - wide, wide / 2.2
    axis.axvspan(0, right, color="#be123c", alpha=0.06, linewidth=0)
    axis.axvline(0, color=_INK, linewidth=0.8)
    axis.axhline(0, color=_FAINT, linewidth=0.6)
    for damping in (0.1, 0.3, 0.5, 0.7, 0.9):
        # Rays of equal damping; their names stand where they leave the picture.
        direction = np.array([-damping, math.sqrt(1 - damping**2)])
        length = min(left / direction[0], top / direction[1])
        for sign in (1, -1):
            x, y = direction[0] * length, sign * direction[1] * length
            axis.plot([0, x], [0, y], color=_FAINT, linewidth=0.6, linestyle=(0, (1, 2)))
        x, y = direction[0] * length * 0.97, direction[1] * length * 0.97
        axis.annotate(f"{damping:g}", (x, y), fontsize=6.5, color="#64748b", ha="left", va="top")
    axis.set_xlim(left, right)
    axis.set_ylim(-top, top)
    axis.set_aspect("equal")


def _unit_circle(axis: Any, everything: Array) -> None:
    circle = np.exp(1j * np.linspace(0, 2 * math.pi, 361))
    axis.axhline(0, color=_FAINT, linewidth=0.6)
    axis.axvline(0, color=_FAINT, linewidth=0.6)
    axis.plot(circle.real, circle.imag, color=_INK, linewidth=0.9)
    size = 1.15 * max(1.0, float(np.max(np.abs(everything), initial=0.0)))
    axis.fill(
        np.concatenate([circle.real, size * np.array([1, 1, -1, -1, 1, 1])]),
        np.concatenate([circle.imag, size * np.array([0, -1, -1, 1, 1, 0])]),
        color="#be123c", alpha=0.06, linewidth=0,
    )  # fmt: skip
    for damping in (0.1, 0.3, 0.5, 0.7, 0.9):
        angle = np.linspace(0, math.pi, 200)
        ray = np.exp(-damping / math.sqrt(1 - damping**2) * angle + 1j * angle)
        for sign in (1, -1):
            axis.plot(ray.real, sign * ray.imag, color=_FAINT, linewidth=0.6, linestyle=(0, (1, 2)))
    axis.set_xlim(-size, size)
    axis.set_ylim(-size, size)
    axis.set_aspect("equal")


def _view(curves: Sequence[Array], m: Margins | None) -> tuple[float, float]:
    """Limits of the real axis that hold -1, the unit circle, the margins and what of the curves is near them."""
    points = np.concatenate(list(curves))
    near = points[np.abs(points) < 2.4]
    low = min(-1.6, float(np.min(near.real, initial=0.0)))
    if m is not None:
        low = min(low, -1.05 - m.modulus)
        if m.gain_low is not None and m.gain_low > 0.15:
            low = min(low, -1.25 / m.gain_low)
    high = max(1.25, float(np.max(near.real, initial=0.0)))
    reach = max(1.25, float(np.max(np.abs(near.imag), initial=0.0)))
    reach = min(reach, 0.75 * (high - low))
    size = max(high - low, 2 * reach) * 1.04
    middle = (low + high) / 2
    return middle - size / 2, middle + size / 2


def _arrow(axis: Any, one: _Shown, values: Array, size: float) -> None:
    """The direction of growing frequency, where the curve passes the view's middle distance."""
    far = np.flatnonzero(np.abs(values) > 0.3 * size)
    k = int(far[-1]) if len(far) else len(values) // 2
    k = min(max(k, 0), len(values) - 2)
    a, b = values[k], values[k + 1]
    if a != b:
        axis.annotate(
            "", (b.real, b.imag), (a.real, a.imag),
            arrowprops={"arrowstyle": "-|>", "color": one.color, "mutation_scale": 14, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


# Steps


def _state_space(one: _Shown) -> Any:
    import control

    if isinstance(one.system, control.TransferFunction):
        return control.tf2ss(one.system)
    if isinstance(one.system, control.StateSpace):
        return one.system
    cure = "Fit a model, or simulate."
    raise AnalysisError(Fault("E705", "step_figure", "a response over frequency alone has no exact step.", cure))


def _settling(one: _Shown) -> float:
    found = one.known.features if one.known.realization is None else None
    if found is None:
        model = balanced(_state_space(one)).visible()
        p = model.eigenvalues()
        found = equivalent(p, model.dt)
    rates = np.abs(found.real)
    slow = rates[(rates > 1e-9 * np.max(np.abs(found), initial=0.0)) & (found.real < 0)]
    if len(slow):
        last = 7.0 / float(np.min(slow))
    else:
        sizes = np.abs(found)[np.abs(found) > 0]
        last = 10.0 / float(np.min(sizes)) if len(sizes) else 1.0
    return max(last, 10 * one.known.dt)


def _step(one: _Shown, last: float) -> tuple[Array, Array]:
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


def _step_figures(axis: Any, one: _Shown, t: Array, y: Array) -> None:
    """The final value with its band of 2 %, the overshoot and the time to settle, where there are such."""
    final = float(dc_gain(one.system)[0, 0])
    if not math.isfinite(final) or final == 0 or abs(y[-1] - final) > 0.05 * abs(final):
        return
    axis.axhspan(0.98 * final, 1.02 * final, color=_FAINT, alpha=0.22, linewidth=0)
    axis.axhline(final, color=_INK, linewidth=0.8, linestyle=(0, (1, 2)))
    mark = STYLES[1][0]
    k = int(np.argmax(y * np.sign(final)))
    over = y[k] / final - 1
    if over > 0.005 and 0 < k < len(t) - 1:
        axis.plot([t[k]], [y[k]], "o", color=mark, markersize=4)
        axis.annotate(
            f"{100 * over:.3g} % over at {t[k]:.3g} s", (t[k], y[k]), xytext=(6, 2), textcoords="offset points",
            fontsize=_SMALL, color=mark,
        )  # fmt: skip
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.05 * (high - low))
    outside = np.flatnonzero(np.abs(y - final) > 0.02 * abs(final))
    if len(outside) and outside[-1] + 1 < len(t):
        settled = t[outside[-1] + 1]
        axis.plot([settled], [y[outside[-1] + 1]], "s", color=mark, markersize=4)
        axis.annotate(
            f"within 2 % from {settled:.3g} s", (settled, y[outside[-1] + 1]), xytext=(0, -14), color=mark,
            textcoords="offset points", fontsize=_SMALL, ha="right" if settled > 0.7 * t[-1] else "left",
        )  # fmt: skip


# The look, that of `blocks.results.plots`


def _figure(rows: int, columns: int, *, height: float, width: float = 7.2, share: bool = False) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.patch.set_alpha(0.0)
    axes = figure.subplots(rows, columns, sharex="col" if share else False)
    for axis in np.ravel(axes):
        axis.grid(True, **_GRID)
    return figure, axes


def _plot(axis: Any, one: _Shown, x: Array, y: Array, count: int, *, label: bool = True) -> None:
    name = one.label if label else None
    if one.measured:
        axis.plot(x, y, "o", color=one.color, markersize=4, fillstyle="none", markeredgewidth=1.1, label=name)
        return
    pattern = one.pattern if count > 1 else "solid"  # nothing to tell it from
    axis.plot(x, y, color=one.color, linestyle=pattern, linewidth=1.4, label=name)


def _name(axis: Any, shown: Sequence[_Shown]) -> None:
    if len(shown) > 1:
        axis.legend(fontsize=_SMALL, frameon=False, loc="best", labelcolor=_INK)
    elif shown[0].name:
        axis.set_title(shown[0].label, fontsize=10, loc="left")


def _limit_decibel(axis: Any, *, floor: float = -math.inf) -> None:
    """Ticks that engineers read, and no view down into the bottomless dip of a zero."""
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_ylim()
    low = max(low, high - 240, min(floor, high - 60))
    reach = high - low
    axis.set_ylim(low, high)
    axis.yaxis.set_major_locator(MultipleLocator(next((s for s in (1, 2, 5, 10, 20, 40) if reach / s <= 7), 60)))


def _degrees(axis: Any, *, which: str = "y") -> None:
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_ylim() if which == "y" else axis.get_xlim()
    if which == "y" and high - low > 900:
        # What a delay does after two turns says nothing more.
        high = float(axis.dataLim.ymax)
        low, high = high - 800, high + 40
        axis.set_ylim(low, high)
    step = next((s for s in (5, 10, 15, 30, 45, 90, 180) if abs(high - low) / s <= 8), 360)
    (axis.yaxis if which == "y" else axis.xaxis).set_major_locator(MultipleLocator(step))


def _finish(figure: Any) -> None:
    for axis in figure.axes:
        axis.set_facecolor("none")
        axis.tick_params(colors=_INK, which="both", labelsize=9)
        for spine in axis.spines.values():
            spine.set_color(_INK)
            spine.set_linewidth(0.8)
        for text in (axis.xaxis.label, axis.yaxis.label, axis.title):
            text.set_color(_INK)
