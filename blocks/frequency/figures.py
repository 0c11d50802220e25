"""Figures over frequency: Bode, Nyquist, Nichols, singular values, the gangs of four and six, poles and zeros, steps.

Each function takes a system, several, or a mapping of names to systems, and returns a `matplotlib.figure.Figure` that
`results.plots.save` and `svg_text` write. It takes the words of `results.plots.Look`: size, title, xlabel, ylabel, xlim
and ylim. Models are lines; measured data (control.FrequencyResponseData) are points
upon them. Axes in rad/s, dB and degrees; phases are unwrapped from the slope at the low end, so that a double
integrator begins at -180 and not at +180 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..results.plots import INK, STYLES, Look, defaults
from ..text.arrays import Array
from ..text.errors import AnalysisError, BlocksError, Fault, UsageError
from .closed_loop import closed_loop
from .disk import DiskMargins
from .figure_curves import (
    curve_of,
    decibel_of,
    draw_step_figures,
    full_curve_of,
    phase_of,
    settling_time,
    shown_of,
    single_channels,
    span_of,
    step_response,
)  # fmt: skip
from .figure_look import FAINT, SMALL, Shown, finished, limit_decibel, new_figure, note, plot_curve, tick_degrees
from .figure_margins import margins_on_bode, margins_on_nichols, margins_on_nyquist
from .figure_planes import draw_arrow, draw_contours, draw_half_plane, draw_unit_circle, view_of
from .margins import Margins
from .margins import margins as margins_of
from .response import poles, zeros
from .search import highest, layout, refined
from .systems import Source, source

if TYPE_CHECKING:
    from ..results.figure import Figure

# Poles and zeros of each style.
_MARKS = (("x", "o"), ("+", "s"), ("1", "D"), ("2", "^"), ("3", "v"), ("4", "p"))


@defaults()
def bode(
    systems: object, omega: Iterable[float] | None = None, *, margins: bool | Margins = True, **look: Unpack[Look]
) -> Figure:
    """Gain and phase over frequency; the gain and phase margins of a single loop are drawn.

    omega: frequencies [rad/s]; without them they are laid out from poles and zeros. margins: off where the system is no
    loop, or the margins of a single loop, if they are known. Several systems are laid over each other without margins.
    Raises UsageError (E501).
    """
    shown = single_channels(systems, "bode")
    span = span_of(shown, omega)
    figure, (above, below) = new_figure(2, 1, height=4.6, share=True, look=look)
    curves = []
    for trace in shown:
        w, values = curve_of(trace, span)
        gain, phase = decibel_of(values), phase_of(w, values)
        curves.append((w, gain, phase))
        for axis, y in ((above, gain), (below, phase)):
            plot_curve(axis, trace, w, y, len(shown))
            if trace.known.dt > 0 and not trace.measured:
                axis.axvline(trace.known.high, color=trace.color, linewidth=0.8, alpha=0.6)
    for axis in (above, below):
        axis.set_xscale("log")
        axis.set_xlim(*span)
        axis.grid(True, which="minor", axis="x", color=FAINT, alpha=0.15, linewidth=0.5)
    above.set_ylabel("gain [dB]")
    below.set_ylabel("phase [deg]")
    below.set_xlabel("frequency [rad/s]")
    loop_margins = _margins(shown, margins)
    drawn = loop_margins is not None and bool(loop_margins.gains or loop_margins.phases)
    limit_decibel(above, floor=-60.0 if drawn else -math.inf)
    tick_degrees(below)
    if loop_margins is not None and drawn:
        margins_on_bode(above, below, loop_margins, curves[0])
    return finished(figure, above, shown, look=look)


@defaults()
def nyquist(loop: object, *, margins: bool | Margins = True, **look: Unpack[Look]) -> Figure:
    """The loop transfer in the complex plane, with -1, the unit circle, the circle that Ms keeps free, and margins.

    Negative frequencies are drawn faintly. The view is that of the critical point: what an integrator sends to
    infinity leaves it. margins: as of `bode`. Raises UsageError (E501).
    """
    shown = single_channels(loop, "nyquist")
    figure, axis = new_figure(1, 1, height=5.2, width=5.6, look=look)
    circle = np.exp(1j * np.linspace(0, 2 * math.pi, 361))
    axis.axhline(0, color=FAINT, linewidth=0.6)
    axis.axvline(0, color=FAINT, linewidth=0.6)
    axis.plot(circle.real, circle.imag, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    loop_margins = _margins(shown, margins)
    curves = [full_curve_of(trace)[1] for trace in shown]
    low, high = view_of(curves, loop_margins)
    size = high - low
    for trace, values in zip(shown, curves, strict=True):
        if trace.measured:
            axis.plot(
                values.real, values.imag, "o", color=trace.color, markersize=3.5, fillstyle="none", label=trace.label
            )
            continue
        pattern = trace.pattern if len(shown) > 1 else "solid"
        axis.plot(values.real, values.imag, color=trace.color, linestyle=pattern, linewidth=1.4, label=trace.label)
        axis.plot(values.real, -values.imag, color=trace.color, linestyle=pattern, linewidth=0.8, alpha=0.4)
        draw_arrow(axis, trace, values, size)
    axis.set_xlim(low, high)
    axis.set_ylim(-0.5 * size, 0.5 * size)
    if loop_margins is not None:
        margins_on_nyquist(axis, loop_margins, curves[0], size)
    axis.plot([-1], [0], "+", color=INK, markersize=9, markeredgewidth=1.6)
    axis.set_aspect("equal")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    return finished(figure, axis, shown, look=look)


@defaults()
def nichols(systems: object, *, margins: bool | Margins = True, **look: Unpack[Look]) -> object:
    """Gain over phase of loops, upon the curves of constant |T|. margins: as of `bode`. Raises UsageError (E501)."""
    shown = single_channels(systems, "nichols")
    figure, axis = new_figure(1, 1, height=5.2, width=6.6, look=look)
    curves = []
    for trace in shown:
        w, values = full_curve_of(trace)
        curves.append((trace, phase_of(w, values), decibel_of(values)))
    everything = np.concatenate([phase[(gain > -40) & (gain < 40)] for _, phase, gain in curves])
    left = 90 * math.floor((min(float(np.min(everything, initial=-200.0)), -200.0)) / 90)
    right = 90 * math.ceil((max(float(np.max(everything, initial=-110.0)), -110.0) + 20) / 90)
    left = max(left, right - 720)
    axis.set_xlim(left, right)
    axis.set_ylim(-40, 40)
    draw_contours(axis, left, right)
    for trace, phase, gain in curves:
        plot_curve(axis, trace, phase, gain, len(shown))
    loop_margins = _margins(shown, margins)
    if loop_margins is not None:
        margins_on_nichols(axis, loop_margins, curves[0][1], curves[0][2])
    for turn in np.arange(-180 - 360 * 3, 721, 360):
        if left <= turn <= right:
            axis.plot([turn], [0], "+", color=INK, markersize=9, markeredgewidth=1.6)
    axis.set_xlabel("phase [deg]")
    axis.set_ylabel("gain [dB]")
    tick_degrees(axis, which="x")
    return finished(figure, axis, shown, look=look)


@defaults()
def sigma(
    systems: object, omega: Iterable[float] | None = None, *, margins: DiskMargins | None = None, **look: Unpack[Look]
) -> Figure:
    """Singular values over frequency: the largest and the smallest as lines, with what lies between them shaded.

    margins: of a loop, whose S and T are the systems: their peaks are marked.
    """
    shown = shown_of(systems, "sigma")
    span = span_of(shown, omega)
    figure, axis = new_figure(1, 1, height=3.4, look=look)
    for trace in shown:

        def sizes(w: Array, known: Source = trace.known) -> Array:
            stack = np.moveaxis(known.at(w), 2, 0)
            values = np.full((min(stack.shape[1:]), len(w)), math.inf)
            finite = np.all(np.isfinite(stack), axis=(1, 2))
            values[:, finite] = np.linalg.svd(stack[finite], compute_uv=False).T
            return values

        if trace.measured:
            assert trace.known.points is not None
            w = trace.known.points[trace.known.points > 0]
            values = sizes(w)
        else:
            limits = max(span[0], trace.known.low), min(span[1], trace.known.high)
            w = layout(trace.known)
            w = np.unique(np.concatenate([np.geomspace(*limits, 60), w[(w > limits[0]) & (w < limits[1])]]))
            w, values = refined(sizes, w, passes=6)
        finite = np.isfinite(values[0])
        w, values = w[finite], decibel_of(values[:, finite].T)
        plot_curve(axis, trace, w, values[:, 0], len(shown))
        if values.shape[1] > 1:
            plot_curve(axis, trace, w, values[:, -1], len(shown), label=False)
            axis.fill_between(w, values[:, -1], values[:, 0], color=trace.color, alpha=0.1, linewidth=0)
    axis.set_xscale("log")
    axis.set_xlim(*span)
    axis.set_xlabel("frequency [rad/s]")
    axis.set_ylabel("singular values [dB]")
    limit_decibel(axis, floor=-60.0 if margins is not None else -math.inf)
    tops = () if margins is None else ((margins.Ms, margins.Ms_frequency), (margins.Mt, margins.Mt_frequency))
    for trace, (value, at), above in zip(shown, tops, (True, False), strict=False):
        if span[0] <= at <= span[1] and 0 < value < math.inf:
            level = 20 * math.log10(value)
            axis.plot([at], [level], "o", color=trace.color, markersize=4)
            side = "right" if math.log(at / span[0]) > 0.5 * math.log(span[1] / span[0]) else "left"
            place = (6 if side == "left" else -6, 6 if above else -6)
            text = f"{value:.4g} at {at:.4g} rad/s"
            note(axis, text, (at, level), place, color=trace.color, ha=side, va="bottom" if above else "top")
    return finished(figure, axis, shown, look=look)


@defaults()
def gang_of_four(
    plant: object, controller: object, omega: Iterable[float] | None = None, **look: Unpack[Look]
) -> object:
    """|S|, |T|, |PS| and |CS| of a plant P and a controller C in a loop with negative feedback; with their peaks."""
    parts = _models(single_channels({"P": plant, "C": controller}, "gang_of_four"), "gang_of_four")
    p, c = (trace.known.siso for trace in parts)
    unstable = _is_unstable(plant, controller)
    return _drawn_gang(_FOUR, lambda w: (p(w), c(w), None), span_of(parts, omega), unstable, look)


@defaults()
def gang_of_six(
    plant: object, controller: object, omega: Iterable[float] | None = None, **look: Unpack[Look]
) -> object:
    """The gang of four with what r does, for a controller of two degrees of freedom: u = Cr r - C y.

    controller: from r and y, in this order, to u, as `control.linearize(["r", "y"], "u")` of any form gives it, or the
    `system` of a linear ADRC's `controller`. r reaches y by P Cr S, and u by Cr S. Raises UsageError (E501).
    """
    parts = [*single_channels({"P": plant}, "gang_of_six"), *shown_of({"C": controller}, "gang_of_six")]
    known = parts[1].known
    if (known.outputs, known.inputs) != (1, 2):
        what = f"the controller has {known.inputs} inputs and {known.outputs} outputs, but must be from r and y to u."
        raise UsageError(Fault("E501", "gang_of_six", what, 'Give control.linearize(["r", "y"], "u").'))
    if [*getattr(controller, "input_labels", ())] == ["y", "r"]:
        raise UsageError(Fault("E501", "gang_of_six", "the controller is from y and r: r comes first."))
    p = _models(parts, "gang_of_six")[0].known.siso

    def at(w: Array) -> tuple[Array, Array, Array | None]:
        of_r, of_y = known.at(w)[0]
        return p(w), -of_y, of_r

    unstable = _is_unstable(plant, controller, channel=1)
    return _drawn_gang((*_FOUR, *_OF_REFERENCE), at, span_of(parts, omega), unstable, look)


def _models(parts: list[Shown], name: str) -> list[Shown]:
    if len({trace.known.dt for trace in parts}) != 1:
        raise UsageError(Fault("E501", name, "the plant and the controller have different periods."))
    if any(trace.measured for trace in parts):
        raise UsageError(Fault("E501", name, "measured data are known at their own frequencies only; give models."))
    return parts


def _is_unstable(plant: object, controller: Any, channel: int | None = None) -> bool:
    """Whether the closed loop is known to be unstable. channel: of the controller, which then gives -u."""
    import control

    try:
        law = control.ss(controller) if channel is None else -control.ss(controller)[0, channel]
        opened = control.ss(plant) * law
        closed = closed_loop(opened, source(opened))
    except (TypeError, ValueError, NotImplementedError, BlocksError):  # of which only responses are known
        return False
    return closed is not None and bool(closed.unstable)


_Law = tuple[str, str, Callable[[Array, Array, Any], Array]]
_FOUR: tuple[_Law, ...] = (
    ("S = 1/(1 + PC)", "set point to error", lambda P, C, R: 1 / (1 + P * C)),
    ("T = PC/(1 + PC)", "noise to output", lambda P, C, R: P * C / (1 + P * C)),
    ("PS = P/(1 + PC)", "load to output", lambda P, C, R: P / (1 + P * C)),
    ("CS = C/(1 + PC)", "noise to control", lambda P, C, R: C / (1 + P * C)),
)
_OF_REFERENCE: tuple[_Law, ...] = (
    ("P Cr S", "set point to output", lambda P, C, R: P * R / (1 + P * C)),
    ("Cr S", "set point to control", lambda P, C, R: R / (1 + P * C)),
)


def _drawn_gang(
    laws: tuple[_Law, ...],
    at: Callable[[Array], tuple[Array, Array, Array | None]],
    span: tuple[float, float],
    unstable: bool,
    look: Look,
) -> object:
    rows = len(laws) // 2
    figure, axes = new_figure(rows, 2, height=2.5 * rows, width=7.6, share=True, look=look)
    start = np.geomspace(*span, 200)
    for axis, (title, meaning, law) in zip(np.ravel(axes), laws, strict=True):

        def value(w: Array, law: Callable[[Array, Array, Any], Array] = law) -> Array:
            with np.errstate(all="ignore"):
                return law(*at(w))

        w, values = refined(value, start, passes=6)
        gain = decibel_of(values)
        w, gain = w[np.isfinite(gain)], gain[np.isfinite(gain)]
        axis.plot(w, gain, color=STYLES[0][0], linewidth=1.4)
        top = highest(_size_of(value), w, 10 ** (gain / 20), ())
        axis.set_title(title, fontsize=10, loc="left", color=INK)
        axis.set_title(meaning, fontsize=SMALL, loc="right", color="#64748b")
        axis.set_xscale("log")
        axis.set_xlim(*span)
        limit_decibel(axis)
        low, high = axis.get_ylim()
        if low < 0 < high:
            axis.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
        # A summit within the picture; not a level that is kept to its edge.
        if w[0] < top.frequency < w[-1] and top.value > 1.001 * 10 ** (max(gain[0], gain[-1]) / 20):
            level = 20 * math.log10(top.value)
            axis.plot([top.frequency], [level], "o", color=STYLES[0][0], markersize=4)
            axis.set_ylim(low, max(high, level + 0.16 * (high - low)))
            part = math.log(top.frequency / span[0]) / math.log(span[1] / span[0])
            side = "right" if part > 0.7 else "left" if part < 0.3 else "center"
            text = f"{top.value:.4g} at {top.frequency:.4g} rad/s"
            note(axis, text, (top.frequency, level), (0, 6), color=INK, ha=side)
        if unstable:
            place = {"transform": axis.transAxes, "ha": "center", "fontsize": SMALL}
            axis.text(0.5, 0.04, "the closed loop is UNSTABLE", color="#b91c1c", **place)
    for axis in axes[-1]:
        axis.set_xlabel("frequency [rad/s]")
    for axis in axes[:, 0]:
        axis.set_ylabel("gain [dB]")
    return finished(figure, look=look)


@defaults()
def pole_map(systems: object, **look: Unpack[Look]) -> object:
    """Poles (crosses) and zeros (circles); with lines of equal damping and, for sampled systems, the unit circle."""
    shown = shown_of(systems, "pole_map")
    is_sampled = shown[0].known.dt > 0
    if any((trace.known.dt > 0) != is_sampled for trace in shown):
        raise UsageError(Fault("E501", "pole_map", "continuous and sampled systems cannot share a plane (s or z)."))
    figure, axis = new_figure(1, 1, height=5.0, width=5.8, look=look)
    roots = [(trace, poles(trace.system), _known_zeros(trace)) for trace in shown]
    everything = np.concatenate([part for _, p, z in roots for part in (p, z)])
    (draw_unit_circle if is_sampled else draw_half_plane)(axis, everything)
    for trace, p, z in roots:
        label = f"{trace.label}: " if trace.name else ""
        cross, ring = _MARKS[trace.style]
        same = {"color": trace.color, "linestyle": "none"}
        axis.plot(p.real, p.imag, cross, markersize=8, markeredgewidth=1.8, label=f"{label}poles", **same)
        if len(z):
            same |= {"fillstyle": "none", "label": f"{label}zeros"}
            axis.plot(z.real, z.imag, ring, markersize=7, markeredgewidth=1.4, **same)
    unit = " of z" if is_sampled else " [1/s]"
    axis.set_xlabel(f"real part{unit}")
    axis.set_ylabel(f"imaginary part{unit}")
    figure.legend(loc="outside upper center", ncols=4, fontsize=SMALL, frameon=False, labelcolor=INK)
    return finished(figure, look=look)


@defaults()
def step_figure(systems: object, *, until: float | None = None, **look: Unpack[Look]) -> object:
    """Responses to a unit step, exactly; with overshoot and the time to stay within 2 % of a single one.

    until: the last time [s]; without it, what the slowest pole needs to settle. Raises UsageError (E501).
    """
    shown = single_channels(systems, "step_figure")
    figure, axis = new_figure(1, 1, height=3.4, look=look)
    last = until if until is not None else max(settling_time(trace) for trace in shown)
    if not (math.isfinite(last) and last > 0):
        raise UsageError(Fault("E501", "step_figure", "until= must be a positive time in s."))
    for trace in shown:
        t, y = step_response(trace, last)
        pattern = trace.pattern if len(shown) > 1 else "solid"
        style = "steps-post" if trace.known.dt > 0 else "default"
        axis.plot(t, y, color=trace.color, linestyle=pattern, linewidth=1.4, drawstyle=style, label=trace.label)
        if len(shown) == 1:
            draw_step_figures(axis, trace, t, y)
    axis.set_xlim(0, last)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("response to a unit step")
    return finished(figure, axis, shown, look=look)


def _margins(shown: list[Shown], wanted: bool | Margins) -> Margins | None:
    """Return the margins of a single loop, unless they are off."""
    if isinstance(wanted, Margins):
        return wanted
    return margins_of(shown[0].system) if wanted and len(shown) == 1 else None


def _size_of(value: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda w: np.asarray(np.abs(value(w)))


def _known_zeros(trace: Shown) -> Array:
    try:
        return zeros(trace.system)
    except AnalysisError:
        return np.zeros(0, complex)  # a matrix of polynomials: its poles alone are shown
