"""The planes that curves, poles and zeros are drawn in: that of Nyquist, the chart of Nichols, and those of s and z."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..results.plots import INK
from ..text.arrays import Array
from .figure_curves import decibel_of
from .figure_look import FAINT, Shown, note
from .margins import Margins

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CONTOURS = (12.0, 6.0, 3.0, 1.0, -1.0, -3.0, -6.0, -12.0, -20.0, -40.0)  # dB of T in a Nichols chart


def view_of(curves: Sequence[Array], m: Margins | None) -> tuple[float, float]:
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


def draw_arrow(axis: Axes, one: Shown, values: Array, size: float) -> None:
    """The direction of growing frequency, at the last point beyond 0.3 of the view from 0."""
    far = np.flatnonzero(np.abs(values) > 0.3 * size)
    k = int(far[-1]) if len(far) else len(values) // 2
    k = min(max(k, 0), len(values) - 2)
    a, b = values[k], values[k + 1]
    if a != b:
        axis.annotate(
            "", (b.real, b.imag), (a.real, a.imag),
            arrowprops={"arrowstyle": "-|>", "color": one.color, "mutation_scale": 14, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip


def draw_contours(axis: Axes, left: float, right: float) -> None:
    """Curves of constant |T| = |L/(1 + L)|, repeated for every turn of the phase."""
    turn = np.linspace(1e-3, 2 * math.pi - 1e-3, 721)
    for level in _CONTOURS:
        t = 10 ** (level / 20) * np.exp(1j * turn)
        loop = t / (1 - t)
        phase, gain = np.degrees(np.unwrap(np.angle(loop))), decibel_of(loop)
        phase -= 360 * round((float(np.mean(phase)) + 180) / 360)
        for shift in np.arange(-1080, 1081, 360):
            if np.max(phase + shift) < left or np.min(phase + shift) > right:
                continue
            axis.plot(phase + shift, gain, color=FAINT, linewidth=0.6, alpha=0.7, zorder=0)
            k = int(np.argmax(gain)) if level > 0 else len(turn) - 1
            x, y = phase[k] + shift, gain[k]
            if level < 0:
                k = int(np.argmin(np.abs(phase + shift - (right - 4))))
                x, y = right - 4, gain[k]
                if abs(phase[k] + shift - x) > 5:
                    continue
            if left < x <= right and abs(y) < 38:
                side = "center" if level > 0 else "right"
                note(axis, f"{level:g} dB", (x, y), (0, 2), fontsize=6.5, color="#64748b", ha=side)


def draw_half_plane(axis: Axes, everything: Array) -> None:
    size = max(float(np.max(np.abs(everything), initial=0.0)), 1e-9)
    left = min(float(np.min(everything.real, initial=0.0)), -0.25 * size)
    right = max(float(np.max(everything.real, initial=0.0)), 0.2 * size)
    top = max(float(np.max(np.abs(everything.imag), initial=0.0)), 0.5 * size)
    left, right, top = 1.15 * left, 1.2 * right, 1.15 * top
    # The panel is wider than high by a tenth; equal units on both axes.
    wide = max(right - left, 2.2 * top)
    left, top = right - wide, wide / 2.2
    axis.axvspan(0, right, color="#be123c", alpha=0.06, linewidth=0)
    axis.axvline(0, color=INK, linewidth=0.8)
    axis.axhline(0, color=FAINT, linewidth=0.6)
    for damping in (0.1, 0.3, 0.5, 0.7, 0.9):
        # Rays of equal damping; their names stand where they leave the picture.
        direction = np.array([-damping, math.sqrt(1 - damping**2)])
        length = min(left / direction[0], top / direction[1])
        for sign in (1, -1):
            x, y = direction[0] * length, sign * direction[1] * length
            axis.plot([0, x], [0, y], color=FAINT, linewidth=0.6, linestyle=(0, (1, 2)))
        x, y = direction[0] * length * 0.97, direction[1] * length * 0.97
        axis.annotate(f"{damping:g}", (x, y), fontsize=6.5, color="#64748b", ha="left", va="top")
    axis.set_xlim(left, right)
    axis.set_ylim(-top, top)
    axis.set_aspect("equal")


def draw_unit_circle(axis: Axes, everything: Array) -> None:
    circle = np.exp(1j * np.linspace(0, 2 * math.pi, 361))
    axis.axhline(0, color=FAINT, linewidth=0.6)
    axis.axvline(0, color=FAINT, linewidth=0.6)
    axis.plot(circle.real, circle.imag, color=INK, linewidth=0.9)
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
            axis.plot(ray.real, sign * ray.imag, color=FAINT, linewidth=0.6, linestyle=(0, (1, 2)))
    axis.set_xlim(-size, size)
    axis.set_ylim(-size, size)
    axis.set_aspect("equal")
