"""What a tuning gives: the best values, what they do in every scenario, and how they were found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..results.results import Results
from ..text.errors import Fault

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..editing.edits import Edit

__all__ = ["Candidates", "Condition", "Tuning", "aligned", "short"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Candidates:
    """Candidates in the order in which they were run.

    values: (n, k). objective: (n,), nan where there is none. excess: (n,), the sum of the violations of all
    constraints, each in parts of its limit; 0 where all hold. status: (n,) of `blocks.api.batch.STATUSES`: the first
    one over the scenarios that is not "ok".
    """

    values: Array
    objective: Array
    excess: Array
    status: Array

    @classmethod
    def joined(cls, parts: Sequence[Candidates], k: int) -> Candidates:
        if not parts:
            return cls(np.empty((0, k)), np.empty(0), np.empty(0), np.empty(0, dtype="<U8"))
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
    def held_before(self) -> bool:
        return self.left_before <= self.right_before

    @property
    def holds(self) -> bool:
        return self.left <= self.right


@dataclass(frozen=True)
class Tuning:
    """The outcome of `Diagram.tune`.

    values: the best value of each parameter, pattern or element of `bounds`, in its unit; nominal: that of the diagram.
    parameters: the same as `Diagram.run(parameters=...)` takes them. before, after: by scenario the run of the diagram
    and that of the best values, with all measures. sensitivities: the relative change of the objective where one value
    is 5 % smaller, and 5 % larger. is_kept: nothing better than the diagram itself was found. is_feasible: all
    constraints hold.
    """

    diagram: Diagram = field(repr=False)
    minimize: str
    method: str
    seed: int
    budget: int
    bounds: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    nominal: Mapping[str, float]
    values: Mapping[str, float]
    parameters: Mapping[str, Any]
    scenarios: Mapping[str, Mapping[str, Any]]
    objective_before: float
    objective: float
    before: Mapping[str, Results]
    after: Mapping[str, Results]
    conditions: tuple[Condition, ...]
    sensitivities: Mapping[str, tuple[float, float]]
    history: Candidates
    targets: Mapping[str, tuple[str, ...]]
    warnings: tuple[Fault, ...] = ()
    interrupted: bool = False
    is_kept: bool = False

    @property
    def is_feasible(self) -> bool:
        return all(condition.holds for condition in self.conditions)

    def rows(self) -> list[tuple[str, str, float, float]]:
        """Scenario, measure, before and after: of all measures in all scenarios."""
        return [
            (scenario, measure, value, self.after[scenario].measures[measure])
            for scenario, results in self.before.items()
            for measure, value in results.measures.items()
        ]

    def table(self) -> str:
        """What was found, as text: values, measures before and after, constraints."""
        parts = [aligned(head, rows) for head, rows in self.tables()]
        return "\n\n".join(part for part in parts if part)

    def markdown(self) -> str:
        """The same as Markdown tables."""
        parts = []
        for head, rows in self.tables():
            if rows:
                lines = [head, ("---",) * len(head), *rows]
                parts.append("\n".join(f"| {' | '.join(cells)} |" for cells in lines))
        return "\n\n".join(parts)

    def tables(self) -> list[tuple[tuple[str, ...], list[tuple[str, ...]]]]:
        """Heads and rows of the tables: values, measures, constraints."""
        values, measures, conditions = (list[tuple[str, ...]]() for _ in range(3))
        for name, value in self.values.items():
            pair = self.sensitivities.get(name)
            change = "-" if pair is None else " ".join(map(_percent, pair))
            low, high = self.bounds[name]
            values.append((name, short(self.nominal[name]), short(value), self.units[name] or "-",
                           f"{short(low)} ... {short(high)}", change))  # fmt: skip
        measures += [
            ("", self.minimize, short(self.objective_before), short(self.objective),
             _change(self.objective_before, self.objective))
        ]  # fmt: skip
        measures += [(s, m, short(a), short(b), _change(a, b)) for s, m, a, b in self.rows()]
        conditions += [
            (c.scenario, c.text, short(c.left_before), short(c.left), "holds" if c.holds else "violated")
            for c in self.conditions
        ]
        return [
            (("parameter", "before", "after", "unit", "bounds", "objective at -5 % / +5 %"), values),
            (("scenario", "measure", "before", "after", "change"), measures),
            (("scenario", "constraint", "before", "after", "verdict"), conditions),
        ]

    def write(self, path: str | Path) -> Edit:
        """Put the values into the diagram file `path`, from which the diagram was loaded, or a copy of it.

        Only the characters of the values change, in this file and in those of the subdiagrams that hold some of them;
        they are written all or none. The result tells what changed (`changes`) and takes it back (`undone.write()`).
        Raises UsageError (E501) where the file would not give the tuned diagram then, as for wheels that share one file
        and have got different values.
        """
        from .gains_file import written

        edit = written(self, path)
        edit.write()
        return edit

    def plot(self) -> Any:
        """A matplotlib figure: the objective of all candidates, and the values and sensitivities."""
        from .tuning_report import figure

        return figure(self)

    def report(self, folder: str | Path) -> Path:
        """Write `report.html` with tables and figures (SVG, PNG) into a folder; returns its path."""
        from .tuning_report import write

        return write(self, Path(folder))

    def __repr__(self) -> str:
        found = "nothing better than the diagram" if self.is_kept else f"{self.minimize} = {self.objective:.6g}"
        state = "" if self.is_feasible else ", constraints violated"
        return (
            f"<Tuning of {self.diagram.name}: {found} ({self.objective_before:.6g} before{state}), "
            f"{len(self.history.objective)} candidates>"
        )

    def __str__(self) -> str:
        told = [self.table(), *map(str, self.warnings)]
        if self.is_kept:
            told.append("No candidate was better than the diagram itself: its values are kept.")
        return "\n\n".join(told)


def short(value: float) -> str:
    """A number of tables."""
    return "-" if math.isnan(value) else f"{value:.5g}"


def _percent(change: float) -> str:
    return "-" if math.isnan(change) else f"{100 * change:+.2g} %"


def _change(before: float, after: float) -> str:
    return _percent((after - before) / abs(before)) if before else "-"


def aligned(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table as text; "" where it has no rows."""
    if not rows:
        return ""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [head, *rows])
    return "\n".join(line.rstrip() for line in lines)
