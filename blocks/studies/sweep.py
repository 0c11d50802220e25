"""A sweep: runs of one diagram with varied parameters, as one table; and its statistics.

sweep = diagram.sweep({"Jeq": Normal(0.2752, 0.02)}, n=1000, seed=1, scenarios={"quiet": {}, "heavy": {"load": 2}})
str(sweep)                         # what was varied, quantiles of the measures, what became of the rows
sweep["heavy"].correlations()      # statistics are of one scenario
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..api.batch import STATUSES
from ..host.ipython_errors import UnknownName
from ..results.table import optional, unique
from ..text.arrays import Array
from ..text.atomic_write import known_ending, write_atomically
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.other_words import Guided
from ..text.printable import counted, legible
from ..text.rich_output import Part, Shown, Table, as_text
from . import statistics
from .sweep_file import read, write
from .sweep_tables import cell_text

if TYPE_CHECKING:
    from ..results.plots import Look
    from ..results.results import Results

QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Guided, Shown):
    """The rows of a sweep, tidy: all of the first scenario, then all of the second.

    varied: by column (n,), floats, or objects for values that are no numbers. units: by column and signal. scenarios:
    () where there are none; scenario: (n,) an index into them. number: (n,) of the row in its scenario. seeds: (n,) of
    the runs. status, messages: (n,) what became of each row and why, as `BatchRows` tells. steps: (n,). measures: (n,)
    each, nan where a row has none. t: (g,) in s. signals: (n, g) and the shape of the signal, nan after the end of a
    row. interrupted: Ctrl-C came before all rows were done. base: rows of each sample of the sampler "saltelli", else
    0. warnings: what is to be known about how the rows were drawn and run. lanes: in which they ran side by side, so
    that they are those of single runs within the tolerance; "": bit for bit. again: runs a row by its scenario and
    number.
    """

    name: str
    varied: Mapping[str, Array]
    units: Mapping[str, str]
    scenarios: tuple[str, ...]
    scenario: Array
    number: Array
    seeds: Array
    status: Array
    messages: tuple[str, ...]
    steps: Array
    measures: Mapping[str, Array]
    t: Array
    signals: Mapping[str, Array]
    interrupted: bool = False
    base: int = 0
    warnings: tuple[Fault, ...] = ()
    lanes: str = ""
    again: Callable[[str, int], Results] | None = None

    def __len__(self) -> int:
        return len(self.number)

    # --- rows ---------------------------------------------------------------------------------------------------

    def __getitem__(self, scenario: str) -> Sweep:
        """The rows of one scenario. Raises KeyError."""
        if scenario not in self.scenarios:
            known = f"Scenarios: {', '.join(self.scenarios) or 'none'}."
            cure = did_you_mean(str(scenario), self.scenarios)
            if isinstance(scenario, int | np.integer):
                cure = f"To run row {scenario} again, call single({scenario})."
            for table in ("signals", "measures", "varied"):
                if isinstance(scenario, str) and scenario in getattr(self, table):
                    cure = f'It is one of the {table}: sweep.{table}["{scenario}"].'
            raise UnknownName(f"there is no scenario {scenario!r}. {cure}{' ' if cure else ''}{known}")
        rows = np.flatnonzero(self.scenario == self.scenarios.index(scenario))
        first = np.zeros(len(rows), dtype=np.int64)
        return replace(self.taken(rows), scenarios=(scenario,), scenario=first, base=self.base)

    def __contains__(self, scenario: object) -> bool:
        return scenario in self.scenarios

    def __iter__(self) -> Iterator[object]:
        cure = "Rows are in sweep.to_pandas() and sweep.single(i), scenarios in sweep.scenarios and each_scenario()."
        raise TypeError(f"a sweep cannot be iterated: it has rows and scenarios. {cure}")

    def taken(self, rows: Array) -> Sweep:
        """Some of the rows, by their places (m,) or by a mask (n,)."""
        rows = np.arange(len(self))[rows]
        changed: dict[str, Any] = {"base": 0, "messages": tuple(self.messages[k] for k in rows.tolist())}
        for name in ("scenario", "number", "seeds", "status", "steps"):
            changed[name] = getattr(self, name)[rows]
        for name in ("varied", "measures", "signals"):
            changed[name] = {key: column[rows] for key, column in getattr(self, name).items()}
        return replace(self, **changed)

    def single(self, i: int) -> Results:
        """Run row i again by itself, with all that the diagram records: its measures are those of the row, bit for bit
        unless it ran in lanes.

        Raises as `Diagram.run`; UsageError (E501) for a sweep that was read from a file.
        """
        if not -len(self) <= i < len(self):
            raise UsageError(
                Fault("E501", str(i), "there is no such row.", f"Rows have the numbers 0 to {len(self) - 1}.")
            )
        if self.again is None:
            cure = "Run the diagram with the values and the seed of the row: diagram.run(parameters=..., seed=...)."
            raise UsageError(
                Fault("E501", self.name, "the sweep was read from a file, which does not contain the diagram.", cure)
            )
        scenario = self.scenarios[int(self.scenario[i])] if self.scenarios else ""
        return self.again(scenario, int(self.number[i]))

    def to_pandas(self) -> object:
        """Return the table as a pandas DataFrame, a row for each run; `attrs["units"]` by column.

        Raises UsageError (E504).
        """
        pandas = optional("pandas", "to_pandas")
        frame = pandas.DataFrame(self._columns())
        frame.attrs.update(diagram=self.name, units=dict(self.units))
        return frame

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV, a row for each run, without signals and units: these are in `save`'s Parquet.

        Raises UsageError (E501).
        """
        known_ending(path, (".csv",), "tables")
        table = self._columns()
        with write_atomically(path) as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(table)
            writer.writerows(zip(*(column.tolist() for column in table.values()), strict=True))

    def _columns(self) -> dict[str, Array]:
        """Return the columns of the table by name, (n,) each: number, parameters, measures, and how each run went."""
        first: dict[str, Array] = {"number": self.number, "status": self.status.astype(object)}
        if self.scenarios:
            first = {"scenario": np.array(self.scenarios, dtype=object)[self.scenario], **first}
        last: dict[str, Array] = {
            "message": np.array(self.messages, dtype=object), "steps": self.steps, "seed": self.seeds,
        }  # fmt: skip
        # A parameter may be called as a measure is, or as one of these.
        names = unique([*first, *last, *self.varied, *self.measures], longest=1000)
        columns = [*first.values(), *last.values(), *self.varied.values(), *self.measures.values()]
        head, rest = len(first), len(first) + len(last)
        table = dict(zip(names, columns, strict=True))
        return {name: table[name] for name in (*names[:head], *names[rest:], *names[head:rest])}

    def to_xarray(self) -> object:
        """Return an xarray Dataset: measures (scenario, row), signals (scenario, row, time, ...).

        What was varied are coordinates. Units are in `attrs`. Without scenarios there is no such dimension. Raises
        UsageError (E504).
        """
        xarray = optional("xarray", "to_xarray")
        shape = (len(self.scenarios), -1) if self.scenarios else (-1,)
        dims = ("scenario", "row") if self.scenarios else ("row",)

        def variable(name: str, column: Array, *more: str) -> Any:
            axes = [*more, *(f"{name}_{axis}" for axis in range(1, column.ndim - len(more)))]
            attrs = {"units": self.units[name]} if self.units.get(name) else {}
            return (*dims, *axes), column.reshape(*shape, *column.shape[1:]), attrs

        known = {"number": self.number, "status": self.status, "steps": self.steps, "seed": self.seeds}
        known["message"] = np.array(self.messages, dtype=object)
        tables = (known, self.varied, self.measures, self.signals)
        taken = ["time", "scenario", "row"]
        named = iter(unique([*taken, *(name for table in tables for name in table)], longest=1000)[len(taken) :])
        plain, coords, measured, recorded = (
            {next(named): variable(name, column, *(["time"] if table is self.signals else []))
             for name, column in table.items()}
            for table in tables
        )  # fmt: skip
        data = {**plain, **measured, **recorded}
        coords |= {"time": ("time", self.t, {"units": "s"})} if len(self.t) else {}
        coords |= {"scenario": ("scenario", list(self.scenarios), {})} if self.scenarios else {}
        return xarray.Dataset(data, coords, attrs={"diagram": self.name})

    # --- statistics ---------------------------------------------------------------------------------------------

    def quantiles(self, *names: str, q: Sequence[float] = QUANTILES) -> dict[str, Array]:
        """Quantiles over the rows that have a number: of a measure (len(q),), of a signal (len(q), g, ...).

        names: of measures and signals; none: all measures. Raises UsageError (E501), KeyError.
        """
        self._one_scenario("quantiles")
        levels = np.asarray(q, dtype=float)
        return {str(name): statistics.quantiles(self.values(name), levels) for name in names or self.measures}

    def correlations(self, *, kind: str = "pearson") -> dict[str, dict[str, float]]:
        """By measure and column of numbers, the coefficient of correlation; nan where one of them is constant.

        kind: "pearson" (how linear), or "spearman" (of ranks: how monotonous). Raises UsageError (E501).
        """
        self._one_scenario("correlations")
        if kind not in ("pearson", "spearman"):
            raise UsageError(
                Fault("E501", legible(str(kind)), "is not a kind of correlation.", "Choose pearson or spearman.")
            )
        by_rank = kind == "spearman"
        columns = {name: column for name, column in self.varied.items() if column.dtype.kind == "f"}
        return {
            measure: {name: statistics.correlation(x, y, by_rank=by_rank) for name, x in columns.items()}
            for measure, y in self.measures.items()
        }

    def sobol(self) -> dict[str, dict[str, statistics.SobolIndex]]:
        """By measure and column, which share of the measure's variance comes from it: first and total order.

        The rows are those of sampler="saltelli". Raises UsageError (E501).
        """
        self._one_scenario("sobol")
        if not self.base or len(self) != self.base * (len(self.varied) + 2):
            cure = 'Draw the rows with sampler="saltelli": sweep(..., n=1024, sampler="saltelli").'
            raise UsageError(Fault("E501", self.name, "its rows were not drawn for Sobol indices.", cure))
        return {
            name: dict(zip(self.varied, statistics.sobol_indices(y, self.base, len(self.varied)), strict=True))
            for name, y in self.measures.items()
        }

    def values(self, name: str) -> Array:
        """A measure (n,), a signal (n, g, ...), or a column of numbers (n,). Raises KeyError."""
        for known in (self.measures, self.signals, self.varied):
            if name in known:
                return known[name]
        names = [*self.measures, *self.signals, *self.varied]
        cure = did_you_mean(str(name), names) or f"Known: {', '.join(names)}."
        raise UnknownName(f"the sweep has no '{name}'. {cure} To keep a signal, log it: sweep(..., log=[...]).")

    def _one_scenario(self, what: str) -> None:
        if len(self.scenarios) > 1:
            cure = f'Choose one scenario: sweep["{self.scenarios[0]}"].{what}().'
            raise UsageError(
                Fault("E501", what, f"works for one scenario, but the sweep has {len(self.scenarios)}.", cure)
            )

    # --- figures and tables --------------------------------------------------------------------------------------

    def plot(
        self,
        what: str | Sequence[str] | None = None,
        against: str | Sequence[str] | None = None,
        *,
        kind: str | None = None,
        singles: int = 3,
        bins: int | None = None,
        **look: Unpack[Look],
    ) -> Any:
        """A `matplotlib.figure.Figure`: what of the sweep is drawn, and against what.

            sweep.plot("motor.omega")                      a logged signal: median, 25 to 75 % and 5 to 95 % over time
            sweep.plot(["ITAE", "overshoot"])              measures: histograms; kind="ecdf": their distributions
            sweep.plot("ITAE", against="motor.Jeq")        against a parameter or another measure: scatter
            sweep.plot("gm", against=("b0", "omega_o"))    over two: a heat map

        what: None: all signals, or all measures where there are none. Rows that failed are counted, and shown where
        they can be. singles: how many runs are drawn by themselves in bands. bins: of a histogram, or of each axis of a
        heat map over ranges. Scenarios stand beside each other; `sweep[name].plot()` shows one. look: size,
        title, xlabel, ylabel, xlim and ylim as of `results.plot`. Raises UsageError (E501).
        """
        from .sweep_figures import plot

        return plot(self, what, against, kind=kind, singles=singles, bins=bins, look=look)

    def markdown(self, *, by: str | Sequence[str] = (), q: Sequence[float] = QUANTILES) -> str:
        """Measures by scenario as a Markdown table: mean, quantiles, and how many rows have no number.

        by: varied parameters; then there is a row for each combination of their values, with the median of each
        measure, and how many runs there are, how many of them failed, and how many lack a number in some measure.
        Raises UsageError (E501).
        """
        from .sweep_tables import markdown

        return markdown(self, by, q)

    def latex(self, *, by: str | Sequence[str] = (), q: Sequence[float] = QUANTILES) -> str:
        """The same as a tabular of LaTeX, with the rules of the package booktabs."""
        from .sweep_tables import latex

        return latex(self, by, q)

    # --- text and files -----------------------------------------------------------------------------------------

    def counts(self) -> dict[str, int]:
        """How many rows have each status; those that some have, in the order of STATUSES."""
        counts = {name: int(np.count_nonzero(self.status == name)) for name in STATUSES}
        return {name: count for name, count in counts.items() if count}

    def each_scenario(self) -> Iterator[tuple[str, Sweep]]:
        """The sweep by scenario; itself, with the name "", where there is none."""
        if not self.scenarios:
            yield "", self
        for name in self.scenarios:
            yield name, self[name]

    def save(self, path: str | Path) -> None:
        """Write all rows and signals as Parquet; the file is replaced as a whole. Raises UsageError (E501, E504)."""
        write(path, vars(self))

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """The sweep in a file that `save` or `out=` wrote, in the part that one that was killed has left, or in a
        folder that workers wrote, without the rows that are missing.

        Raises UsageError (E503, E504).
        """
        return cls(**read(path))

    def table(self) -> str:
        """What was varied, quantiles of the measures, and what became of the rows, as text."""
        return as_text(self._told())

    def parts(self) -> list[Part]:
        return [*self._told(), *map(str, self.warnings)]

    def _told(self) -> list[Part]:
        runs = f"{counted(len(self) // max(1, len(self.scenarios)), 'row')}"
        runs += f" x {counted(len(self.scenarios), 'scenario')}" if self.scenarios else ""
        told = ", ".join(f"{count} {name}" for name, count in self.counts().items())
        rows: list[tuple[str, ...]] = [("varied", "unit", "values")]
        rows += [(name, self.units.get(name) or "-", _span(column)) for name, column in self.varied.items()]
        how = f"; {self.lanes}" if self.lanes else ""
        parts: list[Part] = [f"{self.name}: {runs}; {told or 'none'}{how}", *([Table(rows)] if self.varied else [])]
        rows = [("measure", *(f"{100 * q:g} %" for q in QUANTILES), "rows")]
        for scenario, part in self.each_scenario():
            for name, values in part.quantiles().items():
                numbers = map(cell_text, values.tolist())
                known = str(np.count_nonzero(~np.isnan(part.measures[name])))
                rows.append((f"{scenario}.{name}" if scenario else name, *numbers, known))
        parts += [Table(rows)] if len(rows) > 1 else []
        rows = [("variance of", "from", "first", "total")]
        for scenario, part in self.each_scenario() if self.base else ():
            for measure, indices in part.sobol().items():
                for name, index in indices.items():
                    shown = f"{scenario}.{measure}" if scenario else measure
                    shares = _share(index.first, index.first_error), _share(index.total, index.total_error)
                    rows.append((shown, name, *shares))
        parts += [Table(rows)] if len(rows) > 1 else []
        return [*parts, *(f"  {line}" for line in self.failures())]

    def failures(self) -> list[str]:
        """By status how many rows have it, and why the first of them; also of rows that lack a number."""
        told = []
        for name, count in self.counts().items():
            speaking = [k for k in np.flatnonzero(self.status == name).tolist() if self.messages[k]]
            if speaking:
                rows = f"{len(speaking)} ok, but" if name == "ok" else f"{count} {name}; for example"
                told.append(f"{rows} row {speaking[0]}: {self.messages[speaking[0]]}")
        return told

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.scenarios)


def _share(value: float, error: float) -> str:
    """A Sobol index; of so few rows that it has no error it says nothing."""
    return f"{value:.2f} ± {error:.2f}" if np.isfinite(value) and np.isfinite(error) else "-"


def _span(column: Array) -> str:
    """The values of a column in short."""
    if column.dtype.kind != "f":
        known = list(dict.fromkeys(map(str, column)))
        return ", ".join(known[:6]) + (" ..." if len(known) > 6 else "")
    few = np.unique(column)
    if len(few) <= 6:
        return ", ".join(f"{value:g}" for value in few.tolist())
    return f"{column.min():.5g} ... {column.max():.5g}"
