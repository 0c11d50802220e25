"""Margins in figures: in a Bode, a Nyquist and a Nichols diagram, with texts where no curve runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..results.plots import INK, STYLES, WIDTH
from ..text.arrays import Array
from .figure_look import FAINT, SMALL, note
from .margins import Margins

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DRAWN = 4  # crossings of each kind


def margins_on_bode(above: Axes, below: Axes, m: Margins, curve: tuple[Array, Array, Array]) -> None:
    mark = STYLES[1][0]
    w, gain, phase = curve
    span = above.get_xlim()
    turns: set[float] = set()
    taken: list[tuple[float, float, float]] = []
    # Of the crossings that a delay makes without end, those near the border.
    gains = sorted(m.gains, key=lambda crossing: abs(math.log(crossing[0])))[:_DRAWN]
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
            _beside(above, at, level / 2, text, (w, gain), border=0.0, left=level > 0, taken=taken)
            below.plot([at], [there], "o", color=mark, markersize=4)
    for degrees, at in sorted(m.phases, key=lambda crossing: abs(crossing[0]))[:_DRAWN]:
        if not span[0] <= at <= w[-1]:
            continue
        there = float(np.interp(math.log(at), np.log(w), phase))
        border = there - degrees
        turns.add(border)
        _upright((above, below), at)
        if degrees == m.phase_deg:
            _measure(below, at, border, there)
            _beside(
                below, at, (border + there) / 2, f"phase margin {degrees:.3g}°", (w, phase), border=border, left=True,
                taken=[],
            )  # fmt: skip
            above.plot([at], [0], "o", color=mark, markersize=4)
    above.axhline(0, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    for turn in {round(turn, 3) for turn in turns}:
        below.axhline(turn, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    _warn(above, m)


def _upright(axes: Sequence[Axes], x: float) -> None:
    for axis in axes:
        axis.axvline(x, color=FAINT, linewidth=0.8, linestyle=(0, (3, 2)), zorder=0)


def _measure(axis: Axes, x: float, start: float, end: float) -> None:
    axis.plot([x, x], [start, end], color=STYLES[1][0], linewidth=2.2, solid_capstyle="butt")
    axis.plot([x], [end], "o", color=STYLES[1][0], markersize=4)


def _warn(axis: Axes, m: Margins) -> None:
    if m.stable is False:
        words = "closed loop at the border of stability" if m.verdict == "border" else "closed loop unstable"
        axis.set_title(words, fontsize=9, loc="right", color=STYLES[5][0])


def _beside(
    axis: Axes, x: float, y: float, text: str, curve: tuple[Array, Array], *, border: float, left: bool,
    taken: list[tuple[float, float, float]],
) -> None:  # fmt: skip
    """A text beside x, on the side and at the height where neither the curve nor another text is.

    taken: where texts of the axes are: from, to, and the height of the middle; this text is added.
    """
    low, high = axis.get_ylim()
    span = np.log(np.asarray(axis.get_xlim()))
    across, down = (float(size) for size in axis.get_figure().get_size_inches())  # type: ignore[union-attr]
    if across < 4.5:  # a column of a paper; the place says which margin it is
        text = text.partition("margin ")[2]
    # Of a panel of the usual size: a letter is a ninetieth wide, a line a twelfth high (at 8 points).
    width = (0.0112 * len(text) + 0.02) * WIDTH / across * (span[1] - span[0])
    height = 0.08 * 4.6 / down * (high - low)
    best: tuple[float, bool, float] | None = None
    for shift in np.arange(-3.0, 3.1, 0.5):
        for side in (left, not left):
            a = math.log(x) - width if side else math.log(x)
            inside = (np.log(curve[0]) >= a) & (np.log(curve[0]) <= a + width)
            center = y + shift * height
            free = float(np.min(np.abs(curve[1][inside] - center), initial=abs(center - border))) / height
            fits = a > span[0] and a + width < span[1] and low + height / 2 < center < high - height / 2
            fits &= not any(a < end and begin < a + width and abs(center - at) < height for begin, end, at in taken)
            score = min(free, 0.8) - 0.1 * abs(shift) - 0.05 * (side != left) - 10 * (not fits)
            if best is None or score > best[0]:
                best = (score, side, center)
    assert best is not None
    begin = math.log(x) - width * best[1]
    taken.append((begin, begin + width, best[2]))
    offset, at = ((-7, 0), "right") if best[1] else ((7, 0), "left")
    note(axis, text, (x, best[2]), offset, va="center", ha=at, color=STYLES[1][0])


def margins_on_nyquist(axis: Axes, m: Margins, curve: Array, size: float) -> None:
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


def _label(axis: Axes, center: complex, radius: float, text: str, taken: list[Array], size: float) -> None:
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
    axis.text(middle.real, middle.imag, text, fontsize=SMALL, ha="center", va="center", color=STYLES[1][0])
    box = np.linspace(-0.5, 0.5, 9)
    taken.append(middle + np.add.outer(width * box, 1j * height * box).ravel())


def margins_on_nichols(axis: Axes, m: Margins, phase: Array, gain: Array) -> None:
    mark = STYLES[1][0]
    near = -180 + 360 * np.round((phase + 180) / 360)
    if m.gain is not None:
        level = -20 * math.log10(m.gain)
        k = int(np.argmin(np.abs(phase - near) + 3 * np.abs(gain - level)))
        _measure(axis, near[k], 0.0, level)
        text = f"gain margin {m.gain:.4g} ({-level:.3g} dB)"
        note(axis, text, (near[k], level / 2), (-6, 0), va="center", ha="right", color=mark)
    if m.phase_deg is not None:
        k = int(np.argmin(np.abs(phase - near - m.phase_deg) + 3 * np.abs(gain)))
        axis.plot([near[k], near[k] + m.phase_deg], [0, 0], color=mark, linewidth=2.2, solid_capstyle="butt")
        axis.plot([near[k] + m.phase_deg], [0], "o", color=mark, markersize=4)
        left, right = axis.get_xlim()
        x = near[k] + m.phase_deg
        offset, side = ((7, 0), "left") if x < right - 0.25 * (right - left) else ((-4, 9), "right")
        note(axis, f"phase margin {m.phase_deg:.4g}°", (x, 0), offset, va="center", ha=side, color=mark)
    _warn(axis, m)
