"""The look of figures over frequency, that of `blocks.results.plots`: systems with their styles, axes and texts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..results import plots
from ..results.plots import GRID, INK, STYLES, WIDTH, Look, ink, plain
from ..text.arrays import Array
from .systems import Source

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..results.figure import Figure

FAINT = "#94a3b8"
SMALL = 8  # points


@dataclass(frozen=True, slots=True)
class Shown:
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


def new_figure(
    rows: int, columns: int, *, height: float, width: float = WIDTH, share: bool = False, look: Look | None = None
) -> tuple[Any, Any]:
    """Return a figure and its axes. look: may have another size. Raises UsageError (E501) for one that cannot be."""
    size = (look or {}).get("size", (width, height))
    plots.check_look({"size": size}, rows * columns)
    figure = plots.new_figure(*size)
    axes = figure.subplots(rows, columns, sharex="col" if share else False)
    for axis in np.ravel(axes):
        axis.grid(True, **GRID)
    return figure, axes


def plot_curve(axis: Axes, one: Shown, x: Array, y: Array, count: int, *, label: bool = True) -> None:
    name = one.label if label else None
    if one.measured:
        axis.plot(x, y, "o", color=one.color, markersize=4, fillstyle="none", markeredgewidth=1.1, label=name)
        return
    pattern = one.pattern if count > 1 else "solid"  # no other to distinguish it from
    # Of equal curves each shows: a solid one is wider than the dashes on it.
    width = 1.9 if count > 1 and pattern == "-" else 1.4
    axis.plot(x, y, color=one.color, linestyle=pattern, linewidth=width, label=name)


def note(axis: Axes, text: str, place: tuple[Any, Any], offset: tuple[float, float], **how: Any) -> None:
    """A small text beside a place. offset: in points."""
    axis.annotate(text, place, xytext=offset, textcoords="offset points", **{"fontsize": SMALL, **how})


def limit_decibel(axis: Axes, *, floor: float = -math.inf) -> None:
    """Ticks at usual values, and a lower limit where a zero makes a deep dip."""
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_ylim()
    low = max(low, high - 240, min(floor, high - 60))
    reach = high - low
    axis.set_ylim(low, high)
    axis.yaxis.set_major_locator(MultipleLocator(next((s for s in (1, 2, 5, 10, 20, 40) if reach / s <= 7), 60)))


def tick_degrees(axis: Axes, *, which: str = "y") -> None:
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_ylim() if which == "y" else axis.get_xlim()
    if which == "y" and high - low > 900:
        # What a delay does after two turns says nothing more.
        high = float(axis.dataLim.ymax)
        low, high = high - 800, high + 40
        axis.set_ylim(low, high)
    step = next((s for s in (5, 10, 15, 30, 45, 90, 180) if abs(high - low) / s <= 8), 360)
    (axis.yaxis if which == "y" else axis.xaxis).set_major_locator(MultipleLocator(step))


def finished(
    figure: Figure, named: Any = None, shown: Sequence[Shown] = (), *, look: Look | None = None
) -> Figure:
    """The figure in its colors and with its look. named: the axes that name the systems in it."""
    if len(shown) > 1:
        named.legend(fontsize=SMALL, frameon=False, loc="best", labelcolor=INK)
    elif shown and shown[0].name:
        named.set_title(shown[0].label, fontsize=10, loc="left", color=INK)
    for axis in figure.axes:
        ink(axis, which="both", labelsize=9)
        for spine in axis.spines.values():
            spine.set_linewidth(0.8)
    return plots.dressed(figure, look or {})
