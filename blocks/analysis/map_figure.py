"""The figure of a map of a loop: contours over two parameters, curves over one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..frequency.figure_look import FAINT, SMALL, finished, new_figure
from ..results.plots import INK, STYLES, Look, defaults, plain
from ..text.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..results.figure import Figure

_LEVELS, _PRESENT = 8, "present values"
_LARGE = 20.0
"""The ratio from which on values are drawn by equal factors."""


class Mapped(Protocol):
    """The parts of a `LoopMap` that its figure shows."""

    @property
    def parameters(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def values(self) -> tuple[Array, ...]: ...
    @property
    def measures(self) -> Mapping[str, Array]: ...
    @property
    def present(self) -> tuple[float, ...]: ...


@defaults()
def drawn(
    found: Mapped, names: Sequence[str], slack: Array | None, titles: Mapping[str, str],
    stars: Mapping[str, Sequence[float]], look: Look,
) -> Figure:  # fmt: skip
    """Return the figure of some measures. slack: at least 0 in the region that stays clear. stars: points by name."""
    from matplotlib.patches import Patch

    is_plane = len(found.parameters) == 2
    columns = min(2, len(names)) if is_plane else 1
    rows = math.ceil(len(names) / columns)
    height = (2.9 if columns == 2 else 4.0) * rows if is_plane else 1.9 * rows + 0.4
    figure, axes = new_figure(rows, columns, height=height, share=not is_plane, look=look)
    flat = list(np.ravel(axes))
    for axis in flat[len(names) :]:
        axis.remove()
    labels = [
        plain(f"{name} [{unit}]" if unit else name) for name, unit in zip(found.parameters, found.units, strict=True)
    ]
    for k, (axis, name) in enumerate(zip(flat, names, strict=False)):
        axis.set_title(titles[name], fontsize=SMALL + 1, loc="left", color=INK)
        if is_plane:
            _plane(axis, found, found.measures[name], slack)
            if k % columns == 0:
                axis.set_ylabel(labels[1])
        else:
            _curve(axis, found, found.measures[name], slack)
        for label, at in stars.items():
            if is_plane:
                axis.plot(at[:1], at[1:], "*", color=STYLES[2][0], markersize=10, clip_on=False, label=label)
            else:
                axis.axvline(at[0], color=STYLES[2][0], linewidth=1.4, linestyle=":", label=label)
        if k + columns >= len(names):
            axis.set_xlabel(labels[0])
    shown, _ = flat[0].get_legend_handles_labels()
    if slack is not None and slack.min() < 0:
        shown.append(Patch(facecolor="#94a3b8", alpha=0.45, label="outside the limits"))
    if is_plane and 0 < np.isnan(found.measures["Ms"]).sum() < found.measures["Ms"].size:
        shown.append(Patch(facecolor="none", edgecolor=FAINT, hatch="////", label="not stable"))
    if shown:
        figure.legend(handles=shown, loc="outside lower center", ncols=4, fontsize=SMALL, frameon=False, labelcolor=INK)
    return finished(figure, look=look)


def _scale(axis: Axes, which: str, values: Array) -> None:
    if values[0] > 0 and values[-1] / values[0] > 4:
        (axis.set_xscale if which == "x" else axis.set_yscale)("log")


def _plane(axis: Axes, found: Mapped, values: Array, slack: Array | None) -> None:
    x, y = found.values
    _scale(axis, "x", x)
    _scale(axis, "y", y)
    axis.grid(False)
    known = values[np.isfinite(values)]
    axis.set_facecolor("#e2e8f0")
    if slack is not None and slack.min() < 0:
        region = np.clip(slack, -1.0, 1.0)
        axis.contourf(x, y, region, levels=[-1.1, 0.0], colors=["#94a3b8"], alpha=0.45)
        if region.max() > 0:
            axis.contour(x, y, region, levels=[0.0], colors=[STYLES[2][0]], linewidths=1.2)
    if len(known) and known.min() < known.max():
        lines = axis.contour(x, y, values, levels=_levels(known), colors=[STYLES[1][0]], linewidths=0.9)
        axis.clabel(lines, fmt=_short, fontsize=SMALL - 1, colors=[INK])
    _hatched(axis, x, y, found.measures["Ms"])
    at = found.present
    if x[0] <= at[0] <= x[-1] and y[0] <= at[1] <= y[-1]:
        axis.plot(at[:1], at[1:], "x", color=STYLES[0][0], markersize=7, markeredgewidth=1.8, label=_PRESENT)
    axis.set_xlim(x[0], x[-1])
    axis.set_ylim(y[0], y[-1])


def _hatched(axis: Axes, x: Array, y: Array, Ms: Array) -> None:
    """Where the closed loop is not stable."""
    unstable = np.isnan(Ms)
    if unstable.any() and not unstable.all():
        hatched = axis.contourf(x, y, unstable.astype(float), levels=[0.5, 1.5], colors=["none"], hatches=["////"])
        hatched.set_edgecolor(FAINT)
        hatched.set_linewidth(0.0)
        axis.contour(x, y, unstable.astype(float), levels=[0.5], colors=[FAINT], linewidths=1.0)


def _levels(known: Array) -> Array:
    """Round levels, by equal factors where the values span much."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    low, high = np.percentile(known, [4, 90])  # lines crowd at the border of stability
    if low > 0 and high / low > _LARGE:
        steps = (1.0, 2.0, 5.0) if high / low < 10**3 else (1.0,)
        levels: Any = LogLocator(subs=steps, numticks=60).tick_values(low, high)
    else:
        levels = MaxNLocator(_LEVELS).tick_values(low, high)
    found: Array = np.asarray(levels)
    inside: Array = found[(found > known.min()) & (found < known.max())]
    return inside


def _short(value: float) -> str:
    return f"{value:g}"


def _curve(axis: Axes, found: Mapped, values: Array, slack: Array | None) -> None:
    (x,) = found.values
    _scale(axis, "x", x)
    known = values[np.isfinite(values)]
    if len(known) and known.min() > 0 and known.max() / known.min() > _LARGE:
        axis.set_yscale("log")
    axis.plot(x, values, color=STYLES[1][0], linewidth=1.4)
    if len(known) > 20:  # what goes to infinity at the border of stability would hide the rest
        high = float(np.percentile(known, 97))
        axis.set_ylim(top=high * 1.3 if high < known.max() / 2 else None)
    if slack is not None:
        outside, span = (slack < 0).tolist(), axis.get_xaxis_transform()
        axis.fill_between(x, 0, 1, where=outside, transform=span, color=FAINT, alpha=0.3, linewidth=0)
    if x[0] <= found.present[0] <= x[-1]:
        axis.axvline(found.present[0], color=STYLES[0][0], linewidth=1.0, linestyle="--", label=_PRESENT)
    axis.set_xlim(x[0], x[-1])
