"""Figures of a sweep: bands over time, histograms, distribution functions, scatter and heat maps of measures.

    plot(sweep, "motor.omega")                              # a logged signal: its bands over time
    plot(sweep, ["ITAE", "overshoot"])                      # measures: histograms
    plot(sweep, "ITAE", against="motor.Jeq")                # a measure against a parameter, or another measure
    plot(sweep, "gm", against=("b0", "omega_o"))            # a heat map

Rows that failed have no numbers; each figure counts them, and shows where they lie if it can. They look like the
figures of `blocks.results.plots`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..frequency.figure_look import SMALL, finished, new_figure
from ..model.study_grammar import SWEEP_FIGURES
from ..results.plots import INK, STYLES, WIDTH, Look, defaults, plain
from ..text.arrays import Array
from ..text.element_names import element_names
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import counted, legible
from .statistics import correlation, quantiles

Sweep = Any  # a `Sweep`, whose module calls this one
BAD = "#be123c"
"""The color of rows that failed."""
_WORDS = {"budget": "over the budget", "left": "not run"}
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_LOGGED = " Add a signal to `log` to draw it."
_HEIGHT = 2.4  # inches of a row of panels
_MOST_BINS = 60
_MOST_VALUES = 60
"""Of a column in a heat map whose values make its cells; of more, cells are ranges."""
_MOST_TICKS = 12
"""Of a grid by distances whose every value has a tick."""
_MOST_LINES = 8
"""Rows that failed, drawn up to where they ended."""
_FLAT = 20.0
"""Bands are cut where they are so many times as high as those of the middle half of the rows."""
_MANY = 3000
"""Points that an SVG holds as a picture."""


@dataclass(frozen=True, slots=True)
class _Rows:
    """The rows of one scenario: those that are there, and which of them ran to their end."""

    name: str
    style: int
    index: Array
    is_ok: Array

    @property
    def color(self) -> str:
        return STYLES[self.style % len(STYLES)][0]

    @property
    def pattern(self) -> Any:
        return STYLES[self.style % len(STYLES)][1]


@defaults()
def plot(
    sweep: Sweep,
    what: str | Sequence[str] | None = None,
    against: str | Sequence[str] | None = None,
    *,
    kind: str | None = None,
    singles: int = 3,
    bins: int | None = None,
    look: Look | None = None,
) -> Any:
    """What `Sweep.plot` does. kind: of SWEEP_FIGURES, where it does not follow from the names."""
    if bins is not None and (isinstance(bins, bool) or not isinstance(bins, int | np.integer) or not 0 < bins <= 1000):
        raise UsageError(Fault("E501", "bins", f"must be an integer from 1 to 1000, not {legible(repr(bins))}."))
    wanted = _names(sweep.signals or sweep.measures if what is None else what)
    if what is None and against is None and kind is None and not sweep.signals:
        against = _stepped(sweep)
    others = _names(() if against is None else against)
    chosen = _kind(sweep, wanted, others, kind)
    if not wanted:
        raise UsageError(
            Fault(
                "E501",
                sweep.name,
                "the sweep has no measures and no signals to draw.",
                "Run the sweep with measures= or log=.",
            )
        )
    rows = _scenarios(sweep)
    if chosen == "bands":
        return _bands(sweep, wanted, rows, singles, look)
    if chosen in ("histogram", "ecdf"):
        return _distributions(sweep, wanted, rows, chosen, bins, look)
    if chosen == "scatter":
        return _scatter(sweep, wanted, others, rows, look)
    return _heat_maps(sweep, wanted, (others[0], others[1]), rows, bins, look)


def column(sweep: Sweep, name: str) -> Array:
    """A measure or a varied parameter, (n,). Raises UsageError (E501)."""
    for table in (sweep.measures, sweep.varied):
        if name in table:
            return np.asarray(table[name])
    raise _unknown(name, [*sweep.measures, *sweep.varied], "neither a measure nor a parameter")


def _drawn(sweep: Sweep, name: str) -> None:
    if name not in sweep.measures and name not in sweep.varied:
        raise _unknown(name, [*sweep.measures, *sweep.varied], "neither a measure nor a parameter", _LOGGED)


def told_rows(sweep: Sweep) -> str:
    """How many rows there are, and what became of those that did not run to their end."""
    counts = {_WORDS.get(name, name): count for name, count in sweep.counts().items() if name != "ok"}
    bad = ", ".join(f"{count:,} {name}" for name, count in counts.items())
    return f"{counted(len(sweep), 'run')}" + (f", of which {bad}" if bad else "")


def _stepped(sweep: Sweep) -> list[str]:
    """Return the only varied parameter if its values go up or down row by row, as those of a range and no draws do."""
    if len(sweep.varied) != 1:
        return []
    (name, values), *_ = sweep.varied.items()
    steps = np.diff(values[sweep.scenario == 0]) if values.dtype.kind == "f" and values.ndim == 1 else np.zeros(1)
    is_even = len(steps) > 1 and bool(np.allclose(steps, steps[0], rtol=1e-9, atol=0.0))
    return [name] if (len(steps) > 6 or is_even) and (np.all(steps > 0) or np.all(steps < 0)) else []


def _names(given: str | Sequence[str] | Any) -> list[str]:
    return [str(name) for name in ([given] if isinstance(given, str) else given)]


def _unknown(name: str, known: Sequence[str], what: str, more: str = "") -> UsageError:
    cure = did_you_mean(name[:200], known) or f"Known: {', '.join(known) or 'none'}."
    return UsageError(Fault("E501", legible(name), f"is {what} of the sweep.", cure + more))


def _kind(sweep: Sweep, what: Sequence[str], against: Sequence[str], kind: str | None) -> str:
    """What kind of figure it is. Raises UsageError (E501)."""
    is_signal = [name.partition("[")[0] in sweep.signals for name in what]
    if kind is None:
        kind = "bands" if what and all(is_signal) else ("histogram", "scatter", "heat map")[min(len(against), 2)]
    if kind not in SWEEP_FIGURES:
        cure = f"Choose one of: {', '.join(SWEEP_FIGURES)}."
        raise UsageError(Fault("E501", "kind", f"{kind!r} is not a kind of figure.", cure))
    least, most = {"scatter": (1, 99), "heat map": (2, 2)}.get(kind, (0, 0))
    if not least <= len(against) <= most:
        needs = {(0, 0): "takes no against=", (2, 2): "needs two names in against="}.get(
            (least, most), "needs at least one name in against="
        )
        cure = 'Example: plot("ITAE", against="motor.Ra"), or against=("b0", "omega_o").'
        raise UsageError(Fault("E501", "against", f"the figure ({kind}) {needs}.", cure))
    for name, fits in zip(what, is_signal, strict=True):
        if kind == "bands" and not fits:
            raise _unknown(name, list(sweep.signals), "not a logged signal", _LOGGED)
        if kind != "bands":
            _drawn(sweep, name)
    for name in against:
        column(sweep, name)
    return kind


def _scenarios(sweep: Sweep) -> list[_Rows]:
    rows = []
    for k, name in enumerate(sweep.scenarios or ("",)):
        index = np.flatnonzero(sweep.scenario == k)
        rows.append(_Rows(name if len(sweep.scenarios) > 1 else "", k, index, sweep.status[index] == "ok"))
    return rows


def _label(sweep: Sweep, name: str) -> str:
    unit = sweep.units.get(name, "") or sweep.units.get(name.partition("[")[0], "")
    return plain(f"{name} [{unit}]" if unit else name)


def _titled(figure: Any, sweep: Sweep) -> None:
    """What the figure shows, and how many rows failed."""
    name = f"{sweep.name}, {sweep.scenarios[0]}" if len(sweep.scenarios) == 1 else sweep.name
    figure.suptitle(plain(f"{name}: {told_rows(sweep)}"), fontsize=10, x=0.01, ha="left", color=INK)


def _legend(figure: Any, axis: Any, columns: int = 6, groups: Sequence[str] = ()) -> None:
    """The legend of one pair of axes, below all of them, where it hides nothing. groups: beginnings of its labels."""
    handles, labels = axis.get_legend_handles_labels()
    columns = max(1, int(columns * min(1.0, figure.get_size_inches()[0] / WIDTH)))
    if handles:

        def place(pair: tuple[object, str]) -> float:
            return next((k for k, group in enumerate(groups) if pair[1].startswith(group)), 0.5)  # below the first

        handles, labels = zip(*sorted(zip(handles, labels, strict=True), key=place), strict=True)
        figure.legend(
            handles, labels, loc="outside lower center", ncols=columns, fontsize=SMALL, frameon=False, labelcolor=INK
        )


# --- over time -------------------------------------------------------------------------------------------------------


def _bands(sweep: Sweep, names: Sequence[str], rows: Sequence[_Rows], singles: int, look: Look | None) -> object:
    signals = [pair for name in names for pair in _elements(sweep, name)]
    several = len(rows) > 1
    figure, axes = new_figure(len(signals), 1, height=0.95 + _HEIGHT * len(signals), width=WIDTH, share=True, look=look)
    for axis, (name, values) in zip(np.ravel(axes), signals, strict=True):
        for part in rows:
            of = f"{part.name}: " if several else ""
            for shade, label in (({"alpha": 0.18}, "5 to 95 %"), ({"alpha": 0.32}, "25 to 75 %")):
                axis.fill_between([], [], [], color=part.color, linewidth=0, label=plain(of + label), **shade)
        for part in rows:
            _band(axis, sweep.t, values[part.index], part, 0 if several else singles)
        _keep_scale(axis, [values[part.index[part.is_ok]] for part in rows])
        _lines_of_failed(axis, sweep.t, values, rows)
        axis.set_ylabel(_label(sweep, name))
        axis.margins(x=0.0)
    axes = np.ravel(axes)
    axes[-1].set_xlabel("time [s]")
    _titled(figure, sweep)
    _legend(figure, axes[0], len(rows) if several else 6, [plain(f"{part.name}: ") for part in rows if several])
    return finished(figure, look=look)


def _elements(sweep: Sweep, name: str) -> list[tuple[str, Array]]:
    """The elements of a logged signal, each (n, g). Raises UsageError (E501)."""
    whole, bracket, _ = name.partition("[")
    values = np.asarray(sweep.signals[whole], dtype=float)
    if values.ndim == 2 and not bracket:
        return [(name, values)]
    flat = values.reshape(*values.shape[:2], -1)
    elements = {each: flat[:, :, k] for k, each in enumerate(element_names(whole, values.shape[2:]))}
    if bracket and name not in elements:
        raise _unknown(name, list(elements), "not a logged signal")
    return [(each, elements[each]) for each in ([name] if bracket else elements)]


def _band(axis: Any, t: Array, values: Array, part: _Rows, singles: int) -> None:
    """The bands of the rows that ran to their end, and a few of them."""
    good = values[part.is_ok]
    if not len(good):
        return
    level = quantiles(good, np.array(_QUANTILES))
    axis.fill_between(t, level[0], level[4], alpha=0.18, color=part.color, linewidth=0)
    axis.fill_between(t, level[1], level[3], alpha=0.32, color=part.color, linewidth=0)
    for k, row in enumerate(good[np.unique(np.linspace(0, len(good) - 1, singles).astype(int))] if singles else ()):
        axis.plot(t, row, color=INK, linewidth=0.5, alpha=0.6, label=None if k else "single runs")
    label = plain(f"{part.name}: median" if part.name and not singles else "median")
    width = 2.0 if part.name and part.pattern == "-" else 1.4  # what lies on it leaves its edges free
    axis.plot(t, level[2], color=part.color, linestyle=part.pattern, linewidth=width, label=label)


def _keep_scale(axis: Any, values: Sequence[Array]) -> None:
    """Let what runs away leave the axes, where it would make a line of the middle half of the rows. values: (n, g)."""
    levels = [quantiles(each, np.array([0.25, 0.75])) for each in values if len(each)]
    inner = np.concatenate([level[np.isfinite(level)] for level in levels]) if levels else np.empty(0)
    if not len(inner):
        return
    low, high = float(inner.min()), float(inner.max())
    bottom, top = axis.get_ylim()
    if not 0 < _FLAT * (high - low) < top - bottom:
        return
    reach = high - low
    seen = np.concatenate([each[np.isfinite(each)] for each in values])
    least, most = float(seen.min()), float(seen.max())
    axis.set_ylim(max(least - 0.05 * reach, low - reach), min(most + 0.05 * reach, high + reach))
    ends = [f"{end:.3g}" for end in (least, most) if not low - reach <= end <= high + reach]
    axis.set_title(f"values outside of the axes: up to {' and '.join(ends)}", fontsize=SMALL, loc="right", color=BAD)


def _lines_of_failed(axis: Any, t: Array, values: Array, rows: Sequence[_Rows]) -> None:
    """Rows that failed, as far as they came; where they run away, the others keep their scale."""
    index = np.concatenate([part.index[~part.is_ok] for part in rows])
    begun = index[np.isfinite(values[index]).any(axis=1)][:_MOST_LINES]
    low, high = axis.get_ylim()
    for k, row in enumerate(values[begun]):
        axis.plot(t, row, color=BAD, linewidth=0.7, label=None if k else "failed, up to its end")
    if len(begun):
        reach = 0.25 * (high - low)
        bottom, top = axis.get_ylim()
        axis.set_ylim(max(bottom, low - reach), min(top, high + reach))


# --- distributions ---------------------------------------------------------------------------------------------------


def _distributions(
    sweep: Sweep, names: Sequence[str], rows: Sequence[_Rows], kind: str, bins: int | None, look: Look | None
) -> object:
    across = min(len(names), 2)
    down = -(-len(names) // across)
    height = 0.7 + _HEIGHT * down * (1.25 if across == 1 else 1.0)
    figure, axes = new_figure(down, across, height=height, look=look)
    axes = np.ravel(axes)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    for axis, name in zip(axes, names, strict=False):
        whole = column(sweep, name)
        values, labels = _numbers(whole)
        finite = values[np.isfinite(values)]
        edges = _edges(finite, bins)
        for part in rows:
            own = values[part.index]
            if kind == "ecdf":
                _steps(axis, own, part)
            else:
                _bars(axis, own, edges, part, is_alone=len(rows) == 1)
        axis.set_xlabel(_label(sweep, name))
        axis.set_ylabel("share of all runs" if kind == "ecdf" else "runs")
        missing, endless = np.count_nonzero(np.isnan(values)), np.count_nonzero(np.isinf(values))
        told = [f"{missing:,} without a number"] if missing else []
        told += [f"{endless:,} without a limit ($\\infty$)"] if endless else []
        if told:
            axis.set_title(", ".join(told), fontsize=SMALL, loc="right", color=BAD if missing else INK)
        _tell_none(axis, values)
        if labels is not None:
            axis.set_xticks(range(len(labels)), labels)
        else:  # 0.000500, 0.000505, ... would run into each other
            axis.locator_params(axis="x", nbins=5 if across > 1 else 8)
            axis.ticklabel_format(axis="x", scilimits=(-3, 5))
        if kind == "ecdf":
            axis.set_ylim(0.0, 1.0)
    _titled(figure, sweep)
    _legend(figure, axes[0], 3)
    return finished(figure, look=look)


def _tell_none(axis: Any, values: Array) -> None:
    """In place of an empty axis, that no row has a number to draw."""
    if not np.isfinite(values).any():
        told = "no row has a limit" if np.isinf(values).any() else "no row has a number"
        axis.text(0.5, 0.5, told, transform=axis.transAxes, ha="center", va="center", color=INK)


def _edges(values: Array, bins: int | None) -> Array:
    if not len(values) or values.min() == values.max():
        middle = float(values[0]) if len(values) else 0.0
        reach = 0.5 * abs(middle) or 0.5
        return np.array([middle - reach, middle + reach])
    edges = np.histogram_bin_edges(values, bins if bins is not None else "auto")
    return edges if bins is not None or len(edges) <= _MOST_BINS else np.histogram_bin_edges(values, _MOST_BINS)


def _bars(axis: Any, values: Array, edges: Array, part: _Rows, *, is_alone: bool) -> None:
    values = values[np.isfinite(values)]
    counts, _ = np.histogram(values, edges)
    label = plain(part.name) if part.name else None
    axis.stairs(counts, edges, color=part.color, alpha=0.3, fill=True)
    axis.stairs(counts, edges, color=part.color, linewidth=1.1, linestyle=part.pattern, label=label)
    axis.set_ylim(bottom=0)
    if is_alone and len(values) > 1:
        for quantile, pattern in ((0.05, (0, (4, 2))), (0.5, "-"), (0.95, (0, (4, 2)))):
            x = float(np.quantile(values, quantile))
            axis.axvline(x, color=INK, linewidth=0.8, linestyle=pattern)
        axis.plot([], [], color=INK, linewidth=0.8, label="median")
        axis.plot([], [], color=INK, linewidth=0.8, linestyle=(0, (4, 2)), label="5 and 95 %")


def _steps(axis: Any, values: Array, part: _Rows) -> None:
    """The share of all rows whose value is at most x; where rows have none, it does not come to 1."""
    known = np.sort(values[~np.isnan(values)])
    known = known[np.isfinite(known)]
    below = int(np.count_nonzero(values == -np.inf))
    shares = (below + np.arange(1, len(known) + 1)) / max(len(values), 1)
    label = plain(part.name) if part.name else None
    axis.step(known, shares, where="post", color=part.color, linestyle=part.pattern, linewidth=1.4, label=label)


# --- against each other ----------------------------------------------------------------------------------------------


def _numbers(values: Array) -> tuple[Array, list[str] | None]:
    """A column as numbers; of texts and truths their places among all, which are named."""
    if values.dtype.kind in "fiu":
        return values.astype(float), None
    try:
        if values.dtype.kind == "O" and not any(isinstance(value, (str, bool, np.bool_)) for value in values):
            return values.astype(float), None
    except (TypeError, ValueError):
        pass
    texts = np.array([str(value) for value in values])
    names, places = np.unique(texts, return_inverse=True)
    return places.astype(float), [plain(str(name)) for name in names]


def _scatter(
    sweep: Sweep, names: Sequence[str], against: Sequence[str], rows: Sequence[_Rows], look: Look | None
) -> object:
    down, across = len(names), len(against)
    width = max(WIDTH, 2.05 * across)
    figure, axes = new_figure(down, across, height=0.75 + (_HEIGHT + 0.3) * down, width=width, look=look)
    axes = np.reshape(axes, (down, across))
    for i, name in enumerate(names):
        y, y_labels = _numbers(column(sweep, name))
        for j, other in enumerate(against):
            axis = axes[i, j]
            x, x_labels = _numbers(column(sweep, other))
            every = np.concatenate([part.index for part in rows])
            for part in rows:
                _points(axis, _spread(x, x_labels)[part.index], y[part.index], part)
            _crosses(axis, x[every][np.isnan(y[every])])
            _crosses(axis, x[every][np.isinf(y[every])], endless=True)
            _tell_none(axis, y)
            related = correlation(x[every], y[every], by_rank=True)
            if len(rows) == 1 and x_labels is None and y_labels is None and np.isfinite(related):
                axis.set_title(f"rank correlation {related:.2f}", fontsize=SMALL, loc="right", color=INK)
            if _is_geometric(x[every]):
                _by_ratios(axis.xaxis)
            for labels, ticks in ((x_labels, axis.set_xticks), (y_labels, axis.set_yticks)):
                if labels is not None:
                    ticks(range(len(labels)), labels)
            if x_labels is not None:
                axis.set_xlim(-0.5, len(x_labels) - 0.5)
            if i == down - 1:
                axis.set_xlabel(_label(sweep, other))
            if j == 0:
                axis.set_ylabel(_label(sweep, name))
    _titled(figure, sweep)
    _legend(figure, axes[0, 0], 4)
    return finished(figure, look=look)


def _points(axis: Any, x: Array, y: Array, part: _Rows) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    size = float(np.clip(2000.0 / max(len(x), 1), 3.0, 16.0))
    axis.plot(
        x[known], y[known], "os^Dvp"[part.style % 6], color=part.color, alpha=0.55, markersize=size**0.5 * 1.2,
        markeredgewidth=0, label=plain(part.name) if part.name else None, rasterized=len(x) > _MANY,
    )  # fmt: skip


def _crosses(axis: Any, x: Array, *, endless: bool = False) -> None:
    """Rows without a number, or without a limit, on the upper edge, where they lie along x."""
    if len(x):
        axis.plot(
            x, np.full(len(x), 0.985), marker="$\\infty$" if endless else "x", linestyle="none",
            color=INK if endless else BAD, markersize=6 if endless else 4, markeredgewidth=0.9 * (not endless),
            clip_on=False, transform=axis.get_xaxis_transform(), rasterized=len(x) > _MANY,
            label="no limit" if endless else "rows without a number",
        )  # fmt: skip


def _spread(x: Array, labels: list[str] | None) -> Array:
    """Places of names, spread so that their points lie beside each other (by the golden ratio, the same each time)."""
    return x if labels is None else x + 0.5 * (np.arange(len(x)) * 0.6180339887498949 % 1.0 - 0.5)


def _is_geometric(x: Array) -> bool:
    """Return whether a column is spaced by ratios: exactly, or over a decade and more evenly than by distances."""
    values = np.unique(x[np.isfinite(x)])
    if len(values) > _MOST_VALUES:  # draws: their quantiles show how even they are
        values = np.unique(np.quantile(x[np.isfinite(x)], np.linspace(0.0, 1.0, 9)))
    if len(values) < 3 or values[0] <= 0:
        return False
    by_ratio, by_distance = (float(np.ptp(s) / s.mean()) for s in (np.diff(np.log(values)), np.diff(values)))
    reach = values[-1] / values[0]
    return by_ratio < by_distance and (reach > 9.99 or (by_ratio < 0.05 and reach > 3.99))


def _by_ratios(axis: Any) -> None:
    """Make an axis logarithmic, with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _ticks_on_grid(axis: Any, values: Array, edges: Array, *, is_log: bool, least: float) -> None:
    """Put the ticks of an axis on the values of a grid; `least`: the shortest distance of two, in parts of the axis."""
    places, (low, high) = (np.log(x) if is_log else x for x in (values, edges[[0, -1]]))
    with np.errstate(all="ignore"):
        is_decade = is_log & (np.abs(np.log10(values) % 1.0 - 0.5) > 0.5 - 1e-9)
    shown: list[int] = []
    for k in np.argsort(~is_decade, kind="stable").tolist():  # powers of ten come first
        if all(abs(places[k] - places[other]) >= least * (high - low) for other in shown):
            shown.append(k)
    shown.sort()
    digits = next((n for n in range(3, 17) if len({f"{x:.{n}g}" for x in values}) == len(values)), 17)
    texts = [f"{float(f'{x:.{digits}g}'):.{max(digits, 5)}g}" for x in values[shown]]
    axis.set_ticks(values[shown], texts)
    axis.set_ticks([], minor=True)


# --- over two parameters ---------------------------------------------------------------------------------------------


def _heat_maps(
    sweep: Sweep, names: Sequence[str], against: tuple[str, str], rows: Sequence[_Rows], bins: int | None,
    look: Look | None,
) -> object:  # fmt: skip
    from matplotlib.colors import LogNorm, Normalize

    down, across = len(names), len(rows)
    height = 0.6 + (3.6 if down * across == 1 else 2.9) * down
    figure, axes = new_figure(down, across, height=height, width=max(WIDTH, 3.1 * across), look=look)
    axes = np.reshape(axes, (down, across))
    for i, name in enumerate(names):
        values, _ = _numbers(column(sweep, name))
        shown = values[np.concatenate([part.index for part in rows])]
        shown = shown[np.isfinite(shown)]
        limits, extend = _color_limits(shown)
        norm = (LogNorm if _is_by_ratios(shown, limits) else Normalize)(*limits)
        for j, part in enumerate(rows):
            axis = axes[i, j]
            image = _heat_map(axis, sweep, values, against, part, bins, norm, 0.09 * min(across, 2))
            if across > 1:
                axis.set_title(plain(part.name), fontsize=9, loc="left")
            axis.set_xlabel(_label(sweep, against[0]))
            if j == 0:
                axis.set_ylabel(_label(sweep, against[1]))
        bar = figure.colorbar(image, ax=list(axes[i]), pad=0.02, extend=extend)
        bar.set_label(_label(sweep, name), color=INK)
        if not len(shown):  # a scale of nothing would be one of no color
            bar.ax.set_visible(False)
            why = "no row has a limit" if np.isinf(values).any() else "no row has a number"
            axes[i, -1].set_title(plain(f"{name}: {why}"), fontsize=SMALL, loc="right", color=INK)
        bar.outline.set_edgecolor(INK)
    _titled(figure, sweep)
    _legend(figure, axes[0, 0], 4)
    return finished(figure, look=look)


def _color_limits(values: Array) -> tuple[tuple[float, float], str]:
    """Where the colors of finite values begin and end, and at which ends the bar has an arrow.

    Values far beyond 2 to 98 % of all have the color of the end.
    """
    if not len(values):
        return (0.0, 1.0), "neither"
    least, low, high, most = np.quantile(values, (0.0, 0.02, 0.98, 1.0)).tolist()
    is_low, is_high = low - least > high - low > 0, most - high > high - low > 0
    limits = low if is_low else least, high if is_high else most
    return limits, ("neither", "min", "max", "both")[is_low + 2 * is_high]


def _is_by_ratios(values: Array, limits: tuple[float, float]) -> bool:
    """Return whether colors go by ratios: where by distances, as beside a row that runs away, most have one color."""
    low, high = limits
    if not 0 < 100 * low < high:
        return False
    middle = float(np.clip(np.median(values), low, high))
    return bool(abs(np.log(middle / low) / np.log(high / low) - 0.5) <= abs((middle - low) / (high - low) - 0.5))


def _heat_map(
    axis: Any, sweep: Sweep, values: Array, against: tuple[str, str], part: _Rows, bins: int | None,
    norm: Any, least: float,
) -> object:  # fmt: skip
    """The median of each cell; a cross where a row of it has no number. least: the distance of ticks along x."""
    axis.grid(False)
    edges, places, middles = [], [], []
    for name, along, ticks in zip(against, (axis.xaxis, axis.yaxis), (axis.set_xticks, axis.set_yticks), strict=True):
        numbers, labels = _numbers(column(sweep, name)[part.index])
        is_log = labels is None and _is_geometric(numbers)
        cell = _cells(numbers, bins, len(part.index), is_named=labels is not None, is_log=is_log)
        edges.append(cell[0])
        middles.append(cell[1])
        places.append(np.clip(np.searchsorted(cell[0], numbers, side="right") - 1, 0, len(cell[1]) - 1))
        if is_log:
            _by_ratios(along)
        if labels is not None:
            ticks(range(len(labels)), labels)
        elif cell[2] and (is_log or len(cell[1]) <= _MOST_TICKS):
            _ticks_on_grid(along, cell[1], cell[0], is_log=is_log, least=0.06 if along is axis.yaxis else least)
    shape = len(middles[1]), len(middles[0])
    flat = places[1] * shape[1] + places[0]
    own = values[part.index]
    table = np.full(shape, np.nan)
    missing = np.zeros(shape, dtype=bool)
    order = np.argsort(flat, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(flat[order])) + 1):
        if len(group):
            known = own[group][~np.isnan(own[group])]
            place = np.unravel_index(flat[group[0]], shape)
            with np.errstate(invalid="ignore"):  # inf beside -inf
                table[place] = np.median(known) if len(known) else np.nan
            missing[place] = len(known) < len(group)
    masked = np.ma.masked_invalid(table)
    image = axis.pcolormesh(edges[0], edges[1], masked, cmap="cividis", norm=norm, rasterized=masked.size > _MANY)
    for marks, text, color, label in (
        (missing, "x", BAD, "rows without a number"), (np.isposinf(table), "$\\infty$", INK, "no limit"),
    ):  # fmt: skip
        if marks.any():
            j, i = np.nonzero(marks)
            axis.plot(
                middles[0][i], middles[1][j], linestyle="none", marker=text, color=color, label=label,
                markersize=5 if text == "x" else 6,
            )  # fmt: skip
    return image


def _cells(values: Array, bins: int | None, rows: int, *, is_named: bool, is_log: bool) -> tuple[Array, Array, bool]:
    """The edges of the cells along an axis, their middles, and whether these are the values, or else ranges of many."""
    known = np.unique(values[np.isfinite(values)])
    if not len(known):
        return np.array([0.0, 1.0]), np.array([0.5]), False
    if len(known) == 1:
        reach = 0.5 if is_named else 0.5 * abs(float(known[0])) or 0.5
        return np.array([known[0] - reach, known[0] + reach]), known, True
    to: Callable[[Array], Array]
    of: Callable[[Array], Array]
    to, of = (np.log, np.exp) if is_log else (np.asarray, np.asarray)
    at = to(known)
    if len(known) > _MOST_VALUES or (bins is not None and not is_named):
        count = bins if bins is not None else int(np.clip((rows / 10) ** 0.5, 4, 40))
        edges = np.linspace(at[0], at[-1], count + 1)
        return of(edges), of((edges[:-1] + edges[1:]) / 2), False
    inner = (at[:-1] + at[1:]) / 2
    return of(np.concatenate([[at[0] - (inner[0] - at[0])], inner, [at[-1] + (at[-1] - inner[-1])]])), known, True
