"""The figures and the report of a tuning."""

from __future__ import annotations

import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..results import plots
from ..text.atomic_write import write_atomically
from .report import folder_for, page

if TYPE_CHECKING:
    from .tuned import Tuning

__all__ = ["figure", "runs_figure", "write"]

MOST_SIGNALS = 4


@plots.defaults()
def figure(tuning: Tuning) -> Any:
    """The objective of all candidates, where the values lie in their bounds, and the sensitivities."""
    from matplotlib.figure import Figure

    names = list(tuning.values)
    made = Figure(figsize=(7.2, 3.4 + 0.26 * len(names)), layout="constrained")
    made.patch.set_alpha(0.0)
    grid = made.add_gridspec(2, 2, height_ratios=(2.6, 0.6 + 0.26 * len(names)))
    _history(tuning, made.add_subplot(grid[0, :]))
    rows, colors = np.arange(len(names)), [color for color, _ in plots.STYLES]
    bounds, slopes = made.add_subplot(grid[1, 0]), made.add_subplot(grid[1, 1])
    for style, values, label in ((0, tuning.nominal, "before"), (1, tuning.values, "after")):
        places = [_place(tuning, name, values[name]) for name in names]
        size, mark = (6, "o") if style else (11, "|")
        bounds.plot(places, rows, mark, color=colors[style], markersize=size, label=label)
    bounds.set_xlim(-0.04, 1.04)
    bounds.set_xticks([0, 1], ["lower\nbound", "upper\nbound"])
    bounds.set_yticks(rows, [plots.plain(name) for name in names], fontsize=8)
    bounds.legend(fontsize=8, frameon=False, labelcolor=plots.INK, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    for k, label in enumerate(("-5 %", "+5 %")):
        widths = [100 * tuning.sensitivities.get(name, (np.nan, np.nan))[k] for name in names]
        slopes.barh(rows + 0.18 * (2 * k - 1), widths, 0.34, color=colors[3 * k + 2], label=label)
    slopes.axvline(0, color="#94a3b8", linewidth=0.8)
    slopes.set_xlabel("change of the objective [%]")
    slopes.set_yticks(rows, [])
    slopes.legend(fontsize=8, frameon=False, labelcolor=plots.INK, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    for axis in (bounds, slopes):
        axis.set_ylim(len(names) - 0.5, -0.5)
        axis.grid(True, axis="x", color="#94a3b8", alpha=0.35, linewidth=0.5)
        plots.ink(axis)
    return made


def _history(tuning: Tuning, axis: Any) -> None:
    """Candidates by number: those that fulfil the constraints, those that do not, and the best one so far."""
    made = tuning.history
    number, fine = np.arange(1, len(made.objective) + 1), made.excess == 0
    best = np.minimum.accumulate(np.where(fine & np.isfinite(made.objective), made.objective, np.inf))
    lost = ~np.isfinite(made.objective)
    shown = made.objective[~lost]
    axis.plot(number[fine], made.objective[fine], ".", color=plots.STYLES[1][0], markersize=4, label="constraints hold")
    others = ~fine & ~lost
    if others.any():
        label, color = "constraints violated", plots.STYLES[0][0]
        axis.plot(number[others], made.objective[others], ".", color=color, markersize=3, alpha=0.55, label=label)
    best = np.where(np.isfinite(best), best, np.nan)
    axis.step(number, best, where="post", color=plots.INK, linewidth=1.1, label="best")
    axis.axhline(tuning.objective_before, color=plots.INK, linestyle=(0, (1, 2)), linewidth=0.9, label="before")
    if len(shown):
        low, high = float(np.min(shown)), float(np.percentile(shown, 90))
        if low > 0 and high > 3 * low:
            axis.set_yscale("log")
        else:
            axis.set_ylim(top=max(high, tuning.objective_before) + 0.1 * (high - low or 1.0))
    if lost.any():
        base = axis.get_ylim()[1]
        label = f"no number ({np.count_nonzero(lost)})"
        axis.plot(number[lost], np.full(np.count_nonzero(lost), base), "x", color=plots.STYLES[5][0], markersize=4,
                  label=label, clip_on=False)  # fmt: skip
    axis.set_xlabel("candidate")
    axis.set_ylabel("objective")
    axis.set_title(plots.plain(tuning.minimize[:90]), fontsize=9, loc="left")
    axis.legend(fontsize=8, frameon=False, labelcolor=plots.INK, loc="upper right")
    axis.grid(True, color="#94a3b8", alpha=0.35, linewidth=0.5)
    plots.ink(axis)


def _place(tuning: Tuning, name: str, value: float) -> float:
    """Where a value lies between its bounds, from 0 to 1, on the scale on which it was searched."""
    from .tuning import Space

    return float(Space.of({name: tuning.bounds[name]}).cube(np.array([value]))[0])


def runs_figure(tuning: Tuning, scenario: str) -> Any:
    """Recorded signals of a scenario before and after; None where none was recorded."""
    before, after = tuning.before[scenario], tuning.after[scenario]
    read = {name for name in before.names if before[name].ndim == 1}
    controlled = [spec["of"] for spec in tuning.diagram.to_json().get("measures", {}).values()]
    names = [name for name in dict.fromkeys([*controlled, *before.names]) if name in read][:MOST_SIGNALS]
    parts = []
    for name in names:
        unit = f" [{before[name].unit}]" if before[name].unit else ""
        lines = (
            plots.Line(before.t, np.asarray(before[name]), "before", 0),
            plots.Line(after.t, np.asarray(after[name]), "after", 1),
        )
        parts.append(plots.Panel(lines, f"{name}{unit}"))
    return plots.panels(parts, xlabel="time [s]") if parts else None


def write(tuning: Tuning, folder: Path) -> Path:
    """Write `report.html` and its figures (SVG in it, PNG beside it). Raises UsageError (E501)."""
    folder_for(folder)
    figures = {"search": figure(tuning)}
    figures |= {f"scenario_{name}": runs_figure(tuning, name) for name in tuning.scenarios}
    shown = {}
    for k, (name, made) in enumerate(figures.items()):
        if made is not None:
            shown[name] = plots.svg_text(made).replace('id="', f'id="f{k}-').replace("url(#", f"url(#f{k}-")
            shown[name] = shown[name].replace('href="#', f'href="#f{k}-')
            plots.save(made, folder / f"{name}.png")
    kind = "fine" if tuning.is_feasible else "odd"
    told = f"{tuning.minimize}: {tuning.objective_before:.5g} before, {tuning.objective:.5g} after"
    parts = [
        f"<h1>Tuning of {html.escape(tuning.diagram.name)}</h1>",
        f'<p class="verdict {kind}">{html.escape(told)}; '
        + ("all constraints hold.</p>" if tuning.is_feasible else "constraints are violated.</p>"),
        *(f'<p class="against">{html.escape(str(warning))}</p>' for warning in tuning.warnings),
        f"<p>{len(tuning.history.objective)} candidates in {len(tuning.scenarios)} scenarios, method "
        f"{tuning.method}, seed {tuning.seed}.</p>",
        *(_scenario(name, values) for name, values in tuning.scenarios.items()),
    ]
    titles = ("Values", "Measures", "Constraints")
    for title, (head, rows) in zip(titles, tuning.tables(), strict=True):
        if rows:
            parts.append(f"<h2>{title}</h2>")
            lines = [_row(head, "th"), *(_row(row, "td") for row in rows)]
            parts.append(f'<div class="wide"><table>{"".join(lines)}</table></div>')
    parts.append("<h2>Figures</h2>")
    for name, svg in shown.items():
        caption = f"<figcaption><b>{html.escape(name.replace('_', ' '))}</b></figcaption>"
        parts.append(f'<figure>{caption}<div class="plot">{svg}</div></figure>')
    path = folder / "report.html"
    with write_atomically(path) as stream:
        stream.write(page(f"Tuning of {tuning.diagram.name}", parts))
    return path


def _scenario(name: str, values: Any) -> str:
    given = ", ".join(f"{key} = {value}" for key, value in values.items()) or "as the diagram is"
    return f"<p>Scenario <b>{html.escape(name)}</b>: {html.escape(given)}.</p>"


def _row(cells: Any, kind: str) -> str:
    return f"<tr>{''.join(f'<{kind}>{html.escape(cell)}</{kind}>' for cell in cells)}</tr>"
