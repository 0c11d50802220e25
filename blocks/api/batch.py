"""Many runs of one diagram: rows of values in, rows of measures and signals out.

    batch = diagram.batch(["motor.Ra", "control_*.eso.Ka"], measures=["ITAE"])
    rows = batch([[0.15, 0.5], [0.16, 0.6]])
    rows.measures["ITAE"], rows.status
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engines.prepared import Prepared
from ..model.diagram import DiagramValue
from ..model.resolver import resolver_of
from ..model.trust import Paths
from ..results.results import Results
from ..text.errors import BlocksError, Fault, SimulationError, UsageError, did_you_mean
from ..text.printable import legible
from .prepared_model import PreparedModel
from .run import RunOptions
from .values import check_settings
from .varied import Column, columns_of, raw_values

if TYPE_CHECKING:
    from ..contract.block import Block

__all__ = ["STATUSES", "Batch", "BatchRows"]

Array = np.ndarray[Any, Any]
STATUSES = ("ok", "diverged", "budget", "refused", "failed", "left")
"""What may become of a row: it ran to its end; its numbers or its steps failed (E301 to E309); it took more steps than
it may; its values are refused, and it did not run; something else failed, as an FMU; it was not reached."""
GRID = 200
"""Intervals of the grid on which signals are recorded where the diagram says none."""
_NUMERIC = ("E301", "E303", "E304", "E305", "E306", "E307", "E308", "E309")


@dataclass(frozen=True)
class BatchRows:
    """What became of n rows.

    status: (n,) of STATUSES. messages: why, "" where there is nothing to say. measures: (n,) each, nan where a row has
    none. t: (g,) in s; signals: (n, g) and the shape of the signal, in SI, nan after the end of a row. steps: (n,)
    accepted and rejected.
    """

    status: Array
    messages: tuple[str, ...]
    measures: Mapping[str, Array]
    t: Array
    signals: Mapping[str, Array]
    steps: Array
    interrupted: bool = False

    def __len__(self) -> int:
        return len(self.status)

    def __repr__(self) -> str:
        counts = {name: int(np.count_nonzero(self.status == name)) for name in STATUSES}
        told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        return f"<BatchRows {told or 'none'}>"


class Batch:
    """A diagram of which rows of values are run; see `Diagram.batch`. It stays what it was when it was made.

    columns: their names. targets: of each column the parameters that it sets. units: of each column, that of its bare
    numbers. measures, signals: what comes out.
    """

    def __init__(
        self,
        value: DiagramValue,
        types: Mapping[str, type[Block]],
        names: Sequence[str],
        *,
        measures: Sequence[str] | None = None,
        log: Sequence[str] = (),
        parameters: Mapping[str, Any] | None = None,
        engine: str | None = None,
        trust: Paths = (),
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        settings = {"log": list(log), **(settings or {})}
        check_settings(settings)
        kept = _picked(value, measures)
        resolver, parameters = resolver_of(dict(types)), dict(parameters or {})
        first = Prepared.of(kept, resolver, parameters, settings, trust=trust)
        run = first.plan.settings
        if run.stop is None:
            cure = 'Give stop=..., or "stop" in the file\'s "run".'
            raise UsageError(Fault("E501", value.name, "the runs have no end.", cure))
        if run.every is None and log:
            settings["every"] = (run.stop - run.start) / GRID
        self._columns: tuple[Column, ...] = columns_of(names, kept, first.flat)
        for column in self._columns:
            for target in column.targets:
                if target.path in parameters:
                    message = "is given as a parameter of all rows too."
                    raise UsageError(Fault("E501", legible(target.path), message, "Give it once."))
        self.columns = tuple(column.name for column in self._columns)
        self.targets = tuple(tuple(target.path for target in column.targets) for column in self._columns)
        self.units = tuple(column.unit for column in self._columns)
        self.measures, self.signals = tuple(kept.measures), tuple(first.plan.log)
        self._value, self._settings = value, settings
        self._model = PreparedModel(
            kept, types, parameters=parameters, engine=engine, trust=trust, settings=settings
        ).ready()
        self._whole = PreparedModel(
            value, types, parameters=parameters, engine=engine, trust=trust,
            settings={key: given for key, given in settings.items() if key != "log"},
        )  # fmt: skip

    def single(self, row: Sequence[Any] | Mapping[str, Any], seed: int | None = None) -> Results:
        """Run one row by itself, with all measures and with what the diagram records. Raises as `Diagram.run`."""
        values = [row[name] for name in self.columns] if isinstance(row, Mapping) else row
        given = {} if seed is None else {"seed": seed}
        return self._whole.run(parameters=raw_values(self._columns, values), **given)  # type: ignore[arg-type]

    def __call__(
        self,
        table: Any,
        *,
        seeds: Sequence[int] | Array | None = None,
        threads: int | None = None,
        budget: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> BatchRows:
        """Run all rows.

        table: (n, columns), or a mapping or a DataFrame of the columns: numbers in the units of the parameters. seeds:
        (n,) of the runs; None: that of the diagram for all. threads: how many run at once; None: all cores. budget: the
        most steps of a run, rejected ones included. progress: called with the number of rows that are done, and of all.
        Ctrl-C ends it: what was not run is "left".
        """
        rows = self._rows(table)
        n = len(rows)
        made = _Made(self, n)
        interrupted = False
        try:
            for i, row in enumerate(rows):
                self._run_row(made, i, row, None if seeds is None else int(seeds[i]), budget)
                if progress is not None:
                    progress(i + 1, n)
        except KeyboardInterrupt:
            interrupted = True
        return replace(made.rows(), interrupted=interrupted)

    def _rows(self, table: Any) -> list[list[Any]]:
        """The rows of a table. Raises UsageError (E501)."""
        if isinstance(table, Mapping) or hasattr(table, "columns"):
            given = list(table)
            for name in self.columns:
                if name not in given:
                    cure = did_you_mean(name, given) or f"Its columns: {', '.join(map(str, given)) or 'none'}."
                    raise UsageError(Fault("E501", name, "the table has no such column.", cure))
            extra = [str(name) for name in given if name not in self.columns]
            if extra:
                message = f"the batch has no column {', '.join(map(legible, extra))}."
                raise UsageError(Fault("E501", "table", message, f"Its columns: {', '.join(self.columns)}."))
            columns = [list(table[name]) for name in self.columns]
            if len({len(column) for column in columns}) > 1:
                message = "the columns have different lengths."
                raise UsageError(Fault("E501", "table", message, "Give each column a value for each row."))
            return [list(row) for row in zip(*columns, strict=True)]
        rows = [list(row) for row in table]
        for i, row in enumerate(rows):
            if len(row) != len(self.columns):
                message = f"row {i} has {len(row)} values, and the batch {len(self.columns)} columns."
                raise UsageError(Fault("E501", "table", message, f"The columns: {', '.join(self.columns)}."))
        return rows

    def _run_row(self, made: _Made, i: int, row: Sequence[Any], seed: int | None, budget: int | None) -> None:
        settings = {} if seed is None else {"seed": seed}
        try:
            run = self._model.run_of(raw_values(self._columns, row), settings, RunOptions())
        except BlocksError as error:
            status = "diverged" if isinstance(error, SimulationError) else "refused"
            made.fail(i, status, error.faults[0])
            return
        try:
            results = run.finish()
        except BlocksError as error:
            fault = error.faults[0]
            so_far: Results | None = getattr(error, "results", None)
            if so_far is not None:
                made.steps[i] = so_far.statistics.steps + so_far.statistics.rejected
            is_over = budget is not None and made.steps[i] > budget
            made.fail(i, "budget" if is_over else "diverged" if fault.code in _NUMERIC else "failed", fault)
            return
        if results.interrupted:
            raise KeyboardInterrupt
        made.take(i, results, budget)


class _Made:
    """The rows of a batch, as far as they are there."""

    def __init__(self, batch: Batch, n: int) -> None:
        self.batch = batch
        self.status = np.full(n, "left", dtype="<U8")
        self.messages = [""] * n
        self.measures = {name: np.full(n, np.nan) for name in batch.measures}
        self.steps = np.zeros(n, dtype=np.int64)
        self.t = np.empty(0)
        self.signals: dict[str, Array] = {}

    def fail(self, i: int, status: str, fault: Fault) -> None:
        self.status[i], self.messages[i] = status, f"{fault.code} {fault.place}: {fault.message}"

    def take(self, i: int, results: Results, budget: int | None) -> None:
        self.steps[i] = results.statistics.steps + results.statistics.rejected
        if budget is not None and self.steps[i] > budget:
            self.status[i], self.messages[i] = "budget", f"it takes more than {budget} steps."
            return
        self.status[i] = "ok"
        for name, column in self.measures.items():
            column[i] = results.measures[name]
        told = [fault for fault in results.warnings if fault.code == "W301"]
        self.messages[i] = f"W301 {told[0].place}: {told[0].message}" if told else ""
        if self.batch.signals and not len(self.t):
            self.t = np.array(results.t)
        for name in self.batch.signals:
            values = np.asarray(results[name])
            if name not in self.signals:
                self.signals[name] = np.full((len(self.status), *values.shape), np.nan)
            self.signals[name][i] = values

    def rows(self) -> BatchRows:
        return BatchRows(self.status, tuple(self.messages), self.measures, self.t, self.signals, self.steps)


def _picked(value: DiagramValue, measures: Sequence[str] | None) -> DiagramValue:
    """The diagram with the measures that are asked for. Raises UsageError (E501)."""
    if measures is None:
        return value
    for name in measures:
        if name not in value.measures:
            cure = did_you_mean(str(name), value.measures) or f"Measures: {', '.join(value.measures) or 'none'}."
            raise UsageError(Fault("E501", legible(str(name)), "the diagram has no such measure.", cure))
    return replace(value, measures={name: value.measures[name] for name in measures})
