"""Values that a tuning or a fit has found: shown as tables, drawn beside the diagram's own, written into its file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..editing.edits import Edit
from ..results import plots
from ..results.results import Results, Signal
from ..text.errors import Fault
from ..text.printable import as_markdown
from ..text.rich_output import Part, Shown, Table, as_text
from .gains_file import Value, edit_of

if TYPE_CHECKING:
    from ..api.diagram import Diagram


@dataclass(frozen=True, repr=False, kw_only=True)
class Outcome(Shown):
    """The outcome of a tuning or a fit.

    values: by parameter, pattern or element of `over`, in its unit (units); nominal: those of the diagram. parameters:
    the same as `Diagram.run(parameters=...)` takes them. targets: the parameters that each of them sets. variants:
    chosen for the runs, in place of those that the file chooses.
    """

    diagram: Diagram
    values: Mapping[str, float]
    nominal: Mapping[str, float]
    units: Mapping[str, str]
    parameters: Mapping[str, Any]
    targets: Mapping[str, tuple[str, ...]]
    variants: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[Fault, ...] = ()

    def write(self, path: str | Path) -> Edit:
        """Put the values into the diagram file `path`, from which the diagram was loaded, or a copy of it.

        The values of a block go into the variant that the runs had (`variants`); the file keeps its own choice. Only
        the characters of the values change, in this file and in those of the subdiagrams that hold some of them; they
        are written all or none. The result lists what changed (`changes`) and takes it back (`undone.write()`). Raises
        UsageError (E501) where the file would not give the diagram with these values then, as for wheels that share one
        file and have got different values.
        """
        values = [
            Value(
                target,
                _element(column, target),
                self.values[column],
                self.units[column],
                self.parameters[target],
            )
            for column, targets in self.targets.items()
            for target in (targets if self.parameters else ())
        ]
        chosen = {**self.diagram.chosen, **self.variants}
        edit = edit_of(self.diagram, path, values, parameters=self.parameters, chosen=chosen)
        edit.write()
        return edit

    # --- shown -------------------------------------------------------------------------------------------------

    def tables(self) -> dict[str, Table]:
        """Return the tables by their titles; the first one is of the values."""
        raise NotImplementedError

    def table(self) -> str:
        """Return the tables as text."""
        return "\n\n".join(as_text([table]) for table in self.tables().values())

    def markdown(self) -> str:
        """Return the tables as Markdown."""
        return "\n\n".join(as_markdown(table.rows) for table in self.tables().values())

    def parts(self) -> list[Part]:
        return [*self.tables().values(), *map(str, self.warnings)]

    def __str__(self) -> str:
        return "\n\n".join(as_text([part]) for part in self.parts())

    __repr__ = __str__

    def row(self, name: str, value: str, ends: Sequence[str], last: str) -> tuple[str, ...]:
        """Return the row of a parameter: its value before and after, its unit, a range and one cell more."""
        return name, short(self.nominal[name]), value, self.units[name] or "-", " ... ".join(ends), last

    def plot(self) -> Any:
        """Return a matplotlib figure."""
        raise NotImplementedError


def _element(column: str, target: str) -> tuple[int, ...]:
    """Return the indices of the element of a parameter that a column sets; () if it sets the whole."""
    if target.endswith("]") or not column.endswith("]"):
        return ()
    return tuple(int(k) for k in re.findall(r"\d+", column.rpartition("[")[2]))


def short(value: float) -> str:
    """A number of tables."""
    return "-" if math.isnan(value) else f"{value:.5g}"


def panel_of(name: str, before: Results, after: Results, label: str = "after", *data: plots.Line) -> plots.Panel:
    """Return a panel of a signal before and after. label: of the run after. data: is drawn between the two."""
    first, last = before.smooth().line(name, "before", 0, "wide"), after.smooth().line(name, label, 1)
    height, names = 1.5 if data else 1.0, plots.shared_names((first, last))
    return plots.Panel((first, *data, last), name + unit_of(after[name]), height=height, names=names)


def unit_of(signal: Signal) -> str:
    """Return the unit of a signal for a label."""
    return f" [{signal.unit}]" if signal.unit else ""
