"""What a tuning gives: the best values, what they do in every scenario, and how they were found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..results import plots
from ..results.results import Results
from ..text.arrays import Array
from ..text.printable import counted
from ..text.rich_output import Part, Table
from .outcome import Outcome, panel_of, short
from .report_page import escaped, folder_for, framed, plotted, svg_of, table, warned, written
from .search_space import Space

MOST_SIGNALS = 4
"""Of a scenario, in the report."""


@dataclass(frozen=True)
class Candidates:
    """Candidates in the order in which they were run.

    values: (n, k). objective: (n,), nan where there is none. excess: (n,), the sum of the violations of all
    constraints, each in parts of its limit; 0 where all hold. status: (n,) of `blocks.api.batch.STATUSES`: the first
    one over the scenarios that is not "ok". steps: (n,) of all scenarios. messages: (n,), why some measure has
    no number, "" otherwise.
    """

    values: Array
    objective: Array
    excess: Array
    status: Array
    steps: Array
    messages: Array

    @classmethod
    def joined(cls, parts: Sequence[Candidates], k: int) -> Candidates:
        if not parts:
            nothing = np.empty(0)
            texts, steps = np.empty(0, dtype=object), np.empty(0, dtype=np.int64)
            return cls(np.empty((0, k)), nothing, nothing, np.empty(0, dtype="<U8"), steps, texts)
        fields = (np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__)
        return cls(*fields)

    @property
    def best(self) -> int | None:
        """The least violation first, then the least objective, then the earlier one; None where none has a number."""
        known = np.flatnonzero(np.isfinite(self.objective))
        if not len(known):
            return None
        return int(known[np.lexsort((self.objective[known], self.excess[known]))[0]])


@dataclass(frozen=True, slots=True)
class Condition:
    """A constraint, left <= right, of a scenario ("" where it names them), before and after."""

    text: str
    scenario: str
    left_before: float
    right_before: float
    left: float
    right: float

    @property
    def is_lower(self) -> bool:
        """Whether the text has the limit on the left of this form, as in "f >= 2"."""
        return ">" in self.text

    @property
    def value_before(self) -> float:
        """The left side of the text before, as a rule a measure."""
        return self.right_before if self.is_lower else self.left_before

    @property
    def value(self) -> float:
        """The left side of the text after."""
        return self.right if self.is_lower else self.left

    @property
    def holds(self) -> bool:
        return self.left <= self.right


@dataclass(frozen=True, repr=False, kw_only=True)
class Tuning(Outcome):
    """The outcome of `Diagram.tune`; its values are the best ones.

    before, after: by scenario the run of the diagram and that of the best values, with all measures. sensitivities:
    the relative change of the objective where one value is 5 % smaller, and 5 % larger, whether the constraints hold
    then or not. is_kept: nothing better than the diagram itself was found. is_feasible: all constraints hold.
    why: where no candidate has numbers, what the first one was refused for.
    """

    minimize: str
    optimizer: str
    search_seed: int
    budget: int
    bounds: Mapping[str, tuple[float, float]]
    scenarios: Mapping[str, Mapping[str, Any]]
    objective_before: float
    objective: float
    before: Mapping[str, Results]
    after: Mapping[str, Results]
    conditions: tuple[Condition, ...]
    sensitivities: Mapping[str, tuple[float, float]]
    history: Candidates
    interrupted: bool = False
    is_kept: bool = False
    why: str = ""

    @property
    def is_feasible(self) -> bool:
        return all(condition.holds for condition in self.conditions)

    @property
    def head(self) -> str:
        """What was run, in a line."""
        return (
            f"{self.diagram.name}: {self.ran} of {counted(self.budget, 'candidate')} in "
            f"{counted(len(self.scenarios), 'scenario')}, optimizer {self.optimizer}, search seed {self.search_seed}"
            f"{'; interrupted' if self.interrupted else ''}"
        )

    @property
    def ran(self) -> int:
        """How many candidates have run in every scenario."""
        return int(np.count_nonzero(self.history.status != "left"))

    def rows(self) -> list[tuple[str, str, float, float]]:
        """Scenario, measure, before and after: of all measures in all scenarios."""
        return [
            (scenario, measure, value, self.after[scenario].measures[measure])
            for scenario, results in self.before.items()
            for measure, value in results.measures.items()
        ]

    def tables(self) -> dict[str, Table]:
        change = "objective at -5 % / +5 %, constraints aside"
        values, measures, constraints = (
            [tuple(head.split("; "))] for head in (
                f"parameter; before; after; unit; bounds; {change}",
                "scenario; measure; before; after; change", "scenario; constraint; before; after; verdict",
            )
        )  # fmt: skip
        for name, value in self.values.items():
            change = " ".join(map(_percent, self.sensitivities.get(name, ()))) or "-"
            values.append(self.row(name, short(value), [*map(short, self.bounds[name])], change))
        for scenario, measure, a, b in [("", self.minimize, self.objective_before, self.objective), *self.rows()]:
            measures.append((scenario, measure, short(a), short(b), _change(a, b)))
        for c in self.conditions:
            verdict = "holds" if c.holds else "violated"
            constraints.append((c.scenario, c.text, short(c.value_before), short(c.value), verdict))
        tables = {"Values": values, "Measures": measures, "Constraints": constraints}
        return {title: Table(rows) for title, rows in tables.items() if len(rows) > 1}

    def plot(self) -> Any:
        """A matplotlib figure: the objective of all candidates, and the values and sensitivities."""
        return _figure(self)

    def report(self, folder: str | Path) -> Path:
        """Write `report.html` with tables and figures (SVG, PNG) into a folder; returns its path."""
        return _report(self, Path(folder))

    def parts(self) -> list[Part]:
        kept = [f"{self.kept} The values of the diagram are kept."] if self.is_kept else []
        return [self.head, *super().parts(), *kept]

    @property
    def kept(self) -> str:
        """That nothing better was found, and why."""
        if self.why:
            return f"No candidate has an objective to compare with that of the diagram: {self.why}"
        return "No candidate was better than the values of the diagram."


def _percent(change: float) -> str:
    return "-" if math.isnan(change) else f"{100 * change:+.2g} %"


def _change(before: float, after: float) -> str:
    return _percent((after - before) / abs(before)) if before else "-"


# --- figures and the report ------------------------------------------------------------------------------------


@plots.defaults()
def _figure(tuning: Tuning) -> object:
    """The objective of all candidates, where the values lie in their bounds, and the sensitivities."""
    names = list(tuning.values)
    made = plots.new_figure(plots.WIDTH, 3.4 + 0.26 * len(names))
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
    slopes.set_xlabel("change of the objective,\nconstraints aside [%]")
    slopes.set_yticks(rows, [])
    slopes.legend(fontsize=8, frameon=False, labelcolor=plots.INK, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    for axis in (bounds, slopes):
        axis.set_ylim(len(names) - 0.5, -0.5)
        axis.grid(True, axis="x", **plots.GRID)
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
    axis.figure.suptitle(plots.plain(tuning.minimize[:90]), fontsize=9, x=0.01, ha="left", color=plots.INK)
    axis.legend(fontsize=8, frameon=False, labelcolor=plots.INK, loc="lower left", bbox_to_anchor=(0, 1), ncols=5)
    axis.grid(True, **plots.GRID)
    plots.ink(axis)


def _place(tuning: Tuning, name: str, value: float) -> float:
    """Where a value lies between its bounds, from 0 to 1, on the scale on which it was searched."""
    return float(Space.of({name: tuning.bounds[name]}).cube(np.array([value]))[0])


def _runs_figure(tuning: Tuning, scenario: str) -> object:
    """Recorded signals of a scenario before and after; None where none was recorded."""
    before, after = tuning.before[scenario], tuning.after[scenario]
    read = {name for name in before.names if before[name].ndim == 1}
    asked = " ".join([tuning.minimize, *(condition.text for condition in tuning.conditions)])
    specs = sorted(tuning.diagram.to_json().get("measures", {}).items(), key=lambda item: item[0] not in asked)
    names = [name for name in dict.fromkeys([*(spec["of"] for _, spec in specs), *before.names]) if name in read]
    parts = [panel_of(name, before, after) for name in names[:MOST_SIGNALS]]
    return plots.panels(parts, xlabel="time [s]") if parts else None


def _report(tuning: Tuning, folder: Path) -> Path:
    """Write `report.html` and its figures (SVG in it, PNG beside it). Raises UsageError (E501)."""
    folder_for(folder)
    figures = {"search": _figure(tuning)}
    figures |= {f"scenario_{name}": _runs_figure(tuning, name) for name in tuning.scenarios}
    shown = [
        framed(plotted(svg_of(figure, folder, name), f"f{k}-"), f"<b>{escaped(name.replace('_', ' '))}</b>")
        for k, (name, figure) in enumerate(figures.items())
        if figure is not None
    ]
    verdict = f"{tuning.minimize}: {tuning.objective_before:.5g} before, {tuning.objective:.5g} after; "
    verdict += "all constraints hold." if tuning.is_feasible else "constraints are violated."
    parts = [
        *warned(tuning.warnings),
        f"<p>{escaped(tuning.head)}.</p>",
        *(_scenario(name, values) for name, values in tuning.scenarios.items()),
        *(part for title, of in tuning.tables().items() for part in (f"<h2>{title}</h2>", table(of.rows))),
        "<h2>Figures</h2>",
        *shown,
    ]
    return written(folder, f"Tuning of {tuning.diagram.name}", verdict, parts, is_fine=tuning.is_feasible)


def _scenario(name: str, values: Any) -> str:
    given = ", ".join(f"{key} = {value}" for key, value in values.items()) or "as the diagram is"
    return f"<p>Scenario <b>{escaped(name)}</b>: {escaped(given)}.</p>"
