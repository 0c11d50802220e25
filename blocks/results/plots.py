"""Figures of signals over time and over frequency, made with matplotlib.

Figures are made without pyplot and without its global state: `new_figure` is where all come from. It is a
`matplotlib.figure.Figure` (`results.figure`), which notebooks show and `savefig` writes. `svg_text` gives an SVG in the
text color of the page around it, light or dark. They look the same everywhere: a matplotlibrc, of the user or of the
current folder, changes nothing (`defaults`). Names and labels are text, and never formulas (`plain`).
"""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from ..text.arrays import Array
from ..text.atomic_write import known_ending, write_atomically
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .figure import Figure

# Two lines that stay apart in greyscale and for the color-blind, by color and by pattern; then more of the kind.
STYLES = (
    ("#b45309", "-"),
    ("#1d4ed8", (0, (5, 2))),
    ("#0f766e", (0, (1, 1.2))),
    ("#7e22ce", (0, (6, 1.5, 1, 1.5))),
    ("#64748b", "-"),
    ("#be123c", (0, (3, 1, 1, 1, 1, 1))),
)
GRID: dict[str, Any] = {"color": "#94a3b8", "alpha": 0.35, "linewidth": 0.5}
_DOTS = ((0, (1, 1.2)), (0, (1, 2)))
# Format of a picture: what keeps the date out of it, so that one figure gives the same bytes each time.
FORMATS: dict[str, dict[str, object]] = {".svg": {"Date": None}, ".png": {}, ".pdf": {"CreationDate": None}}
# In a notebook: text and background, light and dark, and the colors of STYLES upon dark.
_PAGES = (("#1f2937", "#ffffff"), ("#e5e7eb", "#111827"))
_BRIGHT = ("#fbbf24", "#7aa2ff", "#34d399", "#c4b5fd", "#cbd5e1", "#fb7185")
INK = "#010203"  # stands for the page's text color until `svg_text` puts it in
PAPER = "#fefdfc"  # stands for the page's background
WIDTH = 6.2  # inches: where a phone shows them whole, texts can be read
_HEIGHT = 2.1  # of one panel
_COLUMNS = 1500
_FULL = 5.0  # inches: narrower figures have smaller texts
_LEAST_SIZE = 6.0  # points
_LETTERS = 84
"""Of the labels in a line of a legend."""


@dataclass(frozen=True, slots=True)
class Line:
    """One curve: x and y of shape (n,), what it is, and the number of its style (None: dotted ink).

    look: "line"; "wide", pale below the others, which it may equal; or "points". names: of its values.
    """

    x: Array
    y: Array
    label: str
    style: int | None = 0
    look: str = "line"
    names: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Marker:
    """A point with a text, such as a published value."""

    x: float
    y: float
    label: str
    style: int | None = 0


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes. band: a grey span of x; inset: (x0, x1, y0, y1) that is also shown enlarged.

    names: of the values along y.
    """

    lines: tuple[Line, ...]
    ylabel: str
    markers: tuple[Marker, ...] = ()
    band: tuple[float, float] | None = None
    inset: tuple[float, float, float, float] | None = None
    log: bool = False
    height: float = 1.0
    names: Mapping[int, str] = field(default_factory=dict)


class Look(TypedDict, total=False):
    """How a figure with panels looks: whatever is given replaces what follows from the signals.

    size: (width, height) in inches. xlim: (from, to). ylim, ylabel: of the panel, or a list with one for each; None
    leaves a panel as it is.
    """

    size: tuple[float, float]
    title: str
    xlabel: str
    ylabel: str | Sequence[str | None]
    xlim: tuple[float, float]
    ylim: tuple[float, float] | Sequence[tuple[float, float] | None]


@contextlib.contextmanager
def defaults(own: Mapping[str, object] | None = None) -> Iterator[None]:
    """matplotlib with its default settings and `own` ones; the earlier settings are restored afterwards.

    For whatever makes, draws or writes a figure; also as a decorator. Raises UsageError (E501) where matplotlib cannot
    be loaded.
    """
    try:
        import matplotlib
    except Exception as error:  # it reads its settings then, which may be anything
        what = " ".join(str(error).split())[:200]
        cure = "Look for a file matplotlibrc in the current folder, or install matplotlib again."
        raise UsageError(Fault("E501", "matplotlib", f"cannot be loaded: {what}.", cure)) from None
    known: Any = matplotlib.rcParamsDefault
    with matplotlib.rc_context():
        # As `rcParams.update`, which checks each of these 300 values anew.
        settings: dict[Any, Any] = matplotlib.rcParams
        dict.update(settings, {key: known[key] for key in known if not key.startswith("backend")})
        settings.update(own or {})
        yield


def stepped(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a curve that keeps each value until the next row, (n,) and (n,), with two points at each change."""
    changes = np.flatnonzero((y[1:] != y[:-1]) & (x[1:] > x[:-1])) + 1
    return np.insert(x, changes, x[changes]), np.insert(y, changes, y[changes - 1])


def shared_names(lines: Sequence[Line]) -> Mapping[int, str]:
    """Return the names of the values of all these lines; none if they have different names."""
    return lines[0].names if all(line.names == lines[0].names for line in lines) else {}


def plain(text: str) -> str:
    """A name or a label for matplotlib, which shows it as it stands: no formula, nothing left out."""
    text = "".join(c if c.isprintable() or c == "\n" else "\ufffd" for c in text)
    # matplotlib leaves labels that begin with _ out of a legend: an invisible character is put before them.
    return ("\u200b" if text.startswith("_") else "") + text.replace("$", "\\$")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size in inches, without a background."""
    from .figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.patch.set_alpha(0.0)
    figure.forms = {"image/svg+xml": _shown_svg, "image/png": _shown_png, "text/plain": repr}
    return figure


@defaults()
def panels(
    parts: Sequence[Panel],
    *,
    xlabel: str,
    title: str = "",
    windows: Sequence[tuple[float, float]] = (),
    look: Look | None = None,
) -> Figure:
    """Return a figure with panels below each other on one x axis.

    windows: stretches of the x axis, shown beside each other. Raises UsageError (E501) for a look that does not fit.
    """
    look = look or {}
    check_look(look, len(parts))
    xlabel, title = look.get("xlabel", xlabel), look.get("title", title)
    if "ylabel" in look:
        labels = zip(parts, _for_each(look["ylabel"], str, len(parts)), strict=True)
        parts = [part if label is None else replace(part, ylabel=label) for part, label in labels]
    if "xlim" in look:
        windows = [look["xlim"]]
    heights = [part.height for part in parts]
    legends = [_legend_of(part, look.get("size", (WIDTH, 0.0))[0]) for part in parts]
    lines = sum(-(-len(part.lines) // columns) for part, columns in zip(parts, legends, strict=True) if columns)
    figure = new_figure(*look.get("size", (WIDTH, _HEIGHT * sum(heights) + 0.6 + 0.16 * lines)))
    figure.parts, figure.along = tuple(parts), xlabel
    grid = {"height_ratios": heights, "width_ratios": [end - begin for begin, end in windows] or [1]}
    across = max(1, len(windows))
    axes = figure.subplots(len(parts), across, sharex="col", sharey="row", squeeze=False, gridspec_kw=grid)
    for part, columns, row in zip(parts, legends, axes, strict=True):
        for k, axis in enumerate(row):
            _draw(_within(part, windows[k]) if windows else part, axis)
            axis.set_xlim(windows[k] if windows else None)
        row[0].set_ylabel(plain(part.ylabel))
        if columns:
            _legend(part, row[0], columns)
    if "ylim" in look:
        for limits, row in zip(_for_each(look["ylim"], tuple, len(parts)), axes, strict=True):
            row[0].set_ylim(limits)
    figure.supxlabel(plain(xlabel), fontsize=10, color=INK)
    if title:
        figure.suptitle(plain(title), fontsize=10, x=0.01, ha="left", color=INK)
    for axis in np.ravel(axes):
        ink(axis)
    if "size" in look:
        _fit(figure)
    return figure


def dressed(figure: Figure, look: Look) -> Figure:
    """Return a figure of other axes than panels with the look, but for its size, with which it was made.

    Raises UsageError (E501) for a look that does not fit.
    """
    axes = [axis for axis in figure.axes if axis.get_visible() and axis.get_label() != "<colorbar>"]
    check_look(look, len(axes))
    if "title" in look:
        figure.suptitle(plain(look["title"]), fontsize=10, x=0.01, ha="left", color=INK)
    labels = _for_each(look.get("ylabel"), str, len(axes))
    limits = _for_each(look.get("ylim"), tuple, len(axes))
    for axis, label, ends in zip(axes, labels, limits, strict=True):
        if label is not None:
            axis.set_ylabel(plain(label))
        if ends is not None:
            axis.set_ylim(ends)
        if "xlim" in look:
            axis.set_xlim(look["xlim"])
        if "xlabel" in look and axis.get_xlabel():
            axis.set_xlabel(plain(look["xlabel"]))
    if "size" in look:
        _fit(figure)
    return figure


def _fit(figure: Figure) -> None:
    """Let the texts fit the size of a figure: smaller in a column of a paper, labels of y in two lines if need be."""
    from matplotlib.text import Text

    factor = min(1.0, max(0.75, float(figure.get_size_inches()[0]) / _FULL))
    for text in figure.findobj(Text):
        text.set_fontsize(max(_LEAST_SIZE, factor * float(text.get_fontsize())))
    for axis in figure.axes:
        axis.tick_params(which="both", labelsize=max(_LEAST_SIZE, 9.5 * factor))
    figure.draw_without_rendering()
    for axis in figure.axes:
        label, room = axis.yaxis.label, axis.get_window_extent().height
        if label.get_window_extent().height > room:
            label.set_text(label.get_text().replace(" [", "\n["))
            label.set_fontsize(float(label.get_fontsize()) * min(1.0, room / label.get_window_extent().height))


def _for_each(given: Any, kind: type, count: int) -> list[Any]:
    """Return one value for each panel."""
    is_list = isinstance(given, list) or (isinstance(given, tuple) and not (kind is tuple and _is_pair(given)))
    return list(given) if is_list else [given] * count


def _is_pair(given: object) -> bool:
    """Return whether it is two finite numbers."""
    if not isinstance(given, (tuple, list, np.ndarray)) or len(given) != 2:
        return False
    return all(isinstance(x, (int, float, np.number)) and math.isfinite(x) for x in given)


_NAMED = 'Name what is drawn: bode({"ADRC": L, "PID": other}), results.plot(label="ADRC", beside={"PID": other}).'


def check_look(look: Look, count: int) -> None:
    """Refuse a look that does not fit a figure with this number of panels (E501)."""

    def refuse(key: str, needed: str) -> None:
        what = " ".join(repr(look.get(key)).split())[:100]
        raise UsageError(Fault("E501", f"plot({key}=)", f"{what} is not {needed}."))

    for key in look.keys() - Look.__annotations__.keys():
        cure = did_you_mean(key, Look.__annotations__) or f"Options: {', '.join(Look.__annotations__)}."
        cure = _NAMED if key in ("label", "labels", "legend", "names") else cure
        raise UsageError(Fault("E501", f"plot({key}=)", "there is no such option.", cure))
    if "size" in look and not (_is_pair(look["size"]) and min(look["size"]) > 0.1 and max(look["size"]) <= 100):
        refuse("size", "a width and a height in inches, such as (6, 4)")
    if "xlim" in look and not (_is_pair(look["xlim"]) and look["xlim"][0] < look["xlim"][1]):
        refuse("xlim", "the start and the end of the axis, such as (0, 5)")
    for key in ("title", "xlabel"):
        if not isinstance(look.get(key, ""), str):
            refuse(key, "a text")
    for key, kind in (("ylabel", str), ("ylim", tuple)):
        items = _for_each(look.get(key), kind, count)
        fits = [item is None or (_is_pair(item) and item[0] < item[1] if kind is tuple else isinstance(item, str))
                for item in items]  # fmt: skip
        if len(items) != count or not all(fits):
            one = "the least and the largest value, such as (-1, 1)" if kind is tuple else "a text"
            refuse(key, f"{one}, or a list with one for each of {counted(count, 'panel')}")


def _within(part: Panel, window: tuple[float, float]) -> Panel:
    """What a panel shows in a window: the scale of the others does not follow what lies outside all of them."""
    lines = []
    for line in part.lines:
        first, last = np.searchsorted(line.x, window[0], "right") - 1, np.searchsorted(line.x, window[1])
        inside = slice(max(int(first), 0), int(last) + 1)
        lines.append(replace(line, x=line.x[inside], y=line.y[inside]))
    markers = tuple(marker for marker in part.markers if window[0] <= marker.x <= window[1])
    return replace(part, lines=tuple(lines), markers=markers)


def _legend_of(part: Panel, width: float) -> int:
    """How many labels stand beside each other in the legend of a panel; 0 where it has none."""
    if len(part.lines) == 1 and part.lines[0].label in part.ylabel:
        return 0
    letters = int(_LETTERS * width / WIDTH)
    return min(len(part.lines), max(1, letters // (6 + max(len(line.label) for line in part.lines))))


def _legend(part: Panel, axis: Axes, columns: int) -> None:
    """The legend above its panel, where it hides no line. It is wider than one of several columns may be: the layout
    is told of its height alone."""
    legend = axis.legend(
        fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0.2,
        labelspacing=0.3, columnspacing=1.5, ncols=columns, labelcolor=INK,
    )  # fmt: skip
    legend.set_in_layout(False)
    axis.set_title("\n".join(" " * -(-len(part.lines) // columns)), fontsize=9, pad=3)


def _draw(part: Panel, axis: Axes) -> None:
    if part.band is not None:
        axis.axvspan(*part.band, color="#94a3b8", alpha=0.22, linewidth=0)
    _curves(part, axis)
    axis.grid(True, **GRID)
    if part.log:
        axis.set_yscale("log")
    if part.names:
        axis.set_yticks([*part.names], [plain(name) for name in part.names.values()], fontsize=8)
        axis.set_ylim(min(part.names) - 0.3, max(part.names) + 0.3)
    for marker in part.markers:
        color = INK if marker.style is None else STYLES[marker.style][0]
        axis.plot([marker.x], [marker.y], "o", color=color, markersize=5, markerfacecolor="none")
        axis.annotate(
            plain(marker.label), (marker.x, marker.y), xytext=(7, 0), textcoords="offset points", fontsize=8,
            va="center", color=INK, bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0, "alpha": 0.75},
        )  # fmt: skip
    axis.margins(x=0.0)
    if part.inset is not None:
        _inset(part, axis)


def _curves(part: Panel, axis: Axes) -> None:
    for line in part.lines:
        color, pattern = (INK, (0, (1, 2))) if line.style is None else STYLES[line.style]
        if len(part.lines) == 1:
            pattern = "solid"  # nothing to tell it from
        # Of equal lines each shows: a solid one is wider than what lies on it, and dots lie on dashes.
        is_solid, is_dotted = isinstance(pattern, str), pattern in _DOTS
        width = 1.8 if is_solid and len(part.lines) > 1 else 0.9 if line.style is None else 1.2
        x, y = _thinned(line.x, line.y)
        order = 2 + 0.1 * (not is_solid) + 0.1 * is_dotted
        look: dict[str, Any] = {"linestyle": pattern, "linewidth": width, "zorder": order}
        if line.look == "wide":
            look = {"linestyle": "solid", "linewidth": 4.0, "alpha": 0.4, "zorder": 1.9}
        elif line.look == "points":
            look = {"linestyle": "none", "marker": "o", "markersize": 2.2, "markeredgewidth": 0, "alpha": 0.7}
        axis.plot(x, y, color=color, label=plain(line.label), **look)


def _inset(part: Panel, axis: Axes) -> None:
    assert part.inset is not None
    x0, x1, y0, y1 = part.inset
    small = axis.inset_axes((0.56, 0.14, 0.41, 0.52))
    if part.band is not None:
        small.axvspan(*part.band, color="#94a3b8", alpha=0.22, linewidth=0)
    _curves(part, small)
    small.set_xlim(x0, x1)
    small.set_ylim(y0, y1)
    small.tick_params(labelsize=7)
    axis.indicate_inset_zoom(small, edgecolor="#64748b")
    ink(small)
    small.set_facecolor(PAPER)


def ink(axis: Axes, **ticks: Any) -> None:
    """Text and axes in the color that stands for the page's. ticks: more of what `tick_params` takes."""
    axis.set_facecolor("none")
    axis.tick_params(colors=INK, **ticks)
    for spine in axis.spines.values():
        spine.set_color(INK)
    for text in (axis.xaxis.label, axis.yaxis.label, axis.title):
        text.set_color(INK)


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """The least and largest value of each column of the picture: what a screen shows, jumps and peaks included."""
    if len(x) <= 4 * _COLUMNS:
        return x, y
    edges = np.linspace(0, len(x), _COLUMNS + 1).astype(int)
    first, last = edges[:-1], edges[1:] - 1
    keep = [first, last]
    for extreme in (np.minimum, np.maximum):
        # The first place of it in each column; of nan, which is the extreme where it is.
        found = np.flatnonzero((y == np.repeat(extreme.reduceat(y, first), last - first + 1)) | np.isnan(y))
        keep.append(found[np.searchsorted(found, first)])
    index = np.unique(np.concatenate(keep))
    return x[index], y[index]


def svg_text(figure: Figure) -> str:
    """The figure as an <svg> element in the text color of the page; the same bytes each time."""
    stream = io.StringIO()
    with defaults({"svg.hashsalt": "blocks", "svg.fonttype": "none"}):
        _write(figure, stream, "svg", {"Date": None, "Creator": None}, dpi=figure.dpi)
    text = stream.getvalue()
    text = text[text.index("<svg") :].replace(INK, "currentColor")
    text = text.replace(PAPER, "var(--paper, var(--color-background-primary, Canvas))")
    head, rest = text.split(">", 1)
    # Fixed sizes in points would not shrink on a phone; the view box keeps the proportions.
    return re.sub(r' (?:width|height)="[^"]*"', "", head) + ">" + rest


def _shown_svg(figure: Figure) -> str:
    """As `svg_text` on a background of its own, light or dark, whichever the reader prefers.

    A notebook does not tell a picture whether it is dark; drawings of diagrams do the same.
    """
    body, rules = svg_text(figure), []
    for page, colors in zip(_PAGES, ([color for color, _ in STYLES], _BRIGHT), strict=True):
        named = "".join(f";--c{n}:{color}" for n, color in enumerate(colors))
        rules.append(f".blocks-figure{{color:{page[0]};background:{page[1]};--paper:{page[1]}{named}}}")
    for n, (color, _) in enumerate(STYLES):
        body = body.replace(color, f"var(--c{n},{color})")
    # Places to a hundredth of a point: a notebook keeps all of this.
    body = re.sub(r' (?:d|x|y)="[^"]*', lambda found: re.sub(r"(\.\d\d)\d+|\n", r"\1", found[0]), body)
    width, height = (round(100 * size) for size in figure.get_size_inches())
    style = f"<style>{rules[0]}@media (prefers-color-scheme:dark){{{rules[1]}}}</style>"
    size = f'<svg class="blocks-figure" width="{width}" height="{height}" style="max-width:100%;height:auto"'
    head, rest = body.removeprefix("<svg").split(">", 1)
    return f"{size}{head}>{style}{rest}"


@defaults()
def _shown_png(figure: Figure) -> bytes:
    """On white, for what shows no SVG."""
    alpha, stream = figure.patch.get_alpha(), io.BytesIO()
    try:
        figure.patch.set_alpha(1.0)
        _write(figure, stream, "png", {}, dpi=100)
    finally:
        figure.patch.set_alpha(alpha)
    return stream.getvalue()


def check_format(path: str | Path) -> str:
    """Return the format of a picture by its ending. Raises UsageError (E501), also where no picture can be drawn."""
    check_loads()
    return known_ending(path, FORMATS, "pictures")


@defaults()
def check_loads() -> None:
    """Load matplotlib, so that a run does not come before this fails. Raises UsageError (E501)."""


@defaults({"svg.hashsalt": "blocks", "pdf.fonttype": 42})  # journals refuse fonts of type 3
def save(figure: Figure, path: str | Path) -> None:
    """Write a figure to PNG, SVG or PDF, on white; the file is replaced as a whole. Raises UsageError (E501)."""
    ending = check_format(path)
    figure.patch.set_alpha(1.0)
    for artist in figure.findobj():
        for get, put in (("get_color", "set_color"), ("get_edgecolor", "set_edgecolor")):
            color = getattr(artist, get, lambda: None)()
            if isinstance(color, str) and color == INK:
                getattr(artist, put)("#000000")
    with write_atomically(path) as stream:
        _write(figure, stream.buffer, ending[1:], FORMATS[ending], dpi=150)


def _write(figure: Figure, stream: Any, format: str, metadata: Mapping[str, Any], *, dpi: float) -> None:
    """As `figure.savefig`, which draws each figure twice, first to lay it out. Lines to an inset need that."""
    from matplotlib.backends import backend_agg, backend_svg

    if format == "pdf" or any(axis.child_axes for axis in figure.axes):
        figure.savefig(stream, format=format, dpi=dpi, metadata=metadata, facecolor="auto")
        return
    canvas, own = figure.canvas, figure.dpi
    kinds: dict[str, Any] = {"svg": backend_svg.FigureCanvasSVG, "png": backend_agg.FigureCanvasAgg}
    try:
        figure.dpi = dpi
        getattr(kinds[format](figure), f"print_{format}")(stream, metadata=metadata)
    finally:
        figure.set_canvas(canvas)
        figure.dpi = own
