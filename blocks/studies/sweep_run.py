"""How a sweep is run: its rows are drawn, run by a Batch for each scenario, and kept in a file as they are done.

What becomes of row i follows from its values and its run seed `seed_of(seed, i)` alone: neither the order nor the
chunks of rows, nor the threads, nor where a sweep was killed, changes a bit.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..api.batch import Batch, BatchRows, prepared_of
from ..api.case import EMPTY, Case, ModelWords, Work, key_of, sources
from ..api.diagram import run_of
from ..api.run import RunOptions
from ..host.progress_line import in_rows, live_line
from ..model.block_signals import element_of
from ..model.diagram_grammar import MEASURE_UNITS
from ..model.diagram_value import check_name
from ..model.flatten import Flat
from ..model.raw_values import raw_of
from ..model.values import in_unit
from ..model.varied import each_of
from ..results.table import optional
from ..text import units as unit_texts
from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from ..text.json_number import is_number
from ..text.printable import legible
from ..text.quantity_text import read_quantity
from .sampling import Rows, rows_of, seed_of
from .sweep import Sweep
from .sweep_file import SweepPart, check_target, told_of
from .sweep_margins import RowMargins, margins_of

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..results.results import Results

CHUNK = 2.0
"""Seconds of work after which rows are written to the file of a sweep."""
STEPS, TIMES = 1_000_000, 1000
"""Without a budget, rows that take more than STEPS run after all others, up to TIMES the median of these."""
SHOWN = 3


def sweep(
    diagram: Diagram,
    vary: object,
    case: Case,
    work: Work,
    *,
    n: int | None,
    sampler: str,
    margins: Mapping[str, Mapping[str, object]] | None,
    scenarios: Mapping[str, Mapping[str, object] | Case] | None,
    max_steps: int | None,
    on: object,
    notice: Callable[[str], None] | None,
) -> Sweep:
    """Return what `Diagram.sweep` gives."""
    folder = "" if on is None else _folder_of_workers(case, work)
    out = None if folder else work.out
    if out is not None:
        check_target(out)
    flat = diagram.flatten(case.only(*ModelWords.__annotations__))
    seed = flat.settings.seed
    case = case.without("seed")  # each row has its own
    rows = rows_of(vary, n=n, sampler=sampler, seed=seed, expand=lambda pattern: each_of(pattern, flat))
    given = _scenarios(scenarios, is_here=on is None)
    cases = [case.on_top(own.words) for own in given.values()]
    seeds = np.array([seed_of(seed, i) for i in range(rows.n)], dtype=np.int64)
    names = list(rows.columns)
    batches = [diagram.batch(names, each, lanes=work.lanes) for each in cases]
    wanted = margins_of(margins or {})
    beside = [RowMargins(diagram, wanted, each) for each in (cases if wanted else ())]
    first = batches[0]
    _check_units(list(given), batches)
    own = zip(rows.columns.items(), first.units, strict=True)
    rows = replace(rows, columns={name: _in_unit(name, column, unit) for (name, column), unit in own})
    of_start = cases[0].without("measures").updated(log=case.settings.get("log", ()))
    begun = run_of(diagram, of_start, RunOptions(), likes=prepared_of(first, diagram.value))
    start = begun.results
    begun.leave()
    units = units_of_measures(flat)
    units |= {margin.name: margin.unit for margin in wanted}
    units |= dict(zip(names, first.units, strict=True)) | {name: start.columns[name][2] for name in first.signals}
    table = _table(rows)

    def again(scenario: str, number: int) -> Results:
        return batches[list(given).index(scenario)].single(list(table[number]), int(seeds[number]))

    taken_measures = (*first.measures, *(margin.name for margin in wanted))
    made = _Made(diagram.name, rows, units, tuple(scenarios or ()), seeds, taken_measures, first.signals, again)
    warnings = dict.fromkeys(warning for batch in batches for warning in batch.warnings)
    made.begun = replace(made.begun, lanes=first.lanes, warnings=(*made.begun.warnings, *warnings))
    key: dict[str, object] = {"scenarios": raw_of({name: _told(own) for name, own in given.items()})}
    key |= {"measures": first.measures, "signals": first.signals}
    key |= {"margins": wanted} if wanted else {}
    key |= {"lanes": first.lanes} if first.lanes else {}
    key |= {"n": n, "max_steps": max_steps, "engine": start.statistics.engine, "varied rows": _digest(rows, seeds)}
    told = told_of(start.origin, key)
    if out is not None:
        made.part = SweepPart(out, told, restart=work.restart)
    try:
        made.take_found()
        if on is None:
            with live_line(work.progress, in_rows("rows")) as told_to:
                run = _Rounds(batches, beside, table, seeds, made, work.threads, told_to, notice)
                # With fixed steps the number of steps is known, and equal in all rows.
                run.all(max_steps, is_bounded=not begun.plan.settings.is_fixed_step)
        else:
            from .distributed import Job, Put, run_on

            static = {name: getattr(made.begun, name) for name in ("name", "units", "scenarios", "base", "warnings")}
            # By name: a worker without a compiler refuses, and does not take the other engine.
            of_rows = case.updated(measures=first.measures, log=first.signals, engine=start.statistics.engine)
            put = Put(folder, static, told) if folder else None
            job = Job.of(diagram, names, [each.parameters for each in cases], of_rows, wanted, put=put)
            if start.origin is not None and (start.origin.equations, start.origin.values) != job.computed[1:]:
                raise AssertionError("the text of the diagram says something else")
            made.interrupted = not run_on(on, job, table, seeds, made, max_steps, work)
        done = made.sweep()
        if made.part is not None:
            made.part.end(vars(done))
    finally:
        if made.part is not None:
            made.part.close()
    return done


def _folder_of_workers(case: Case, work: Work) -> str:
    """Return the folder or URL that workers write to, or "" if rows come back. Raises UsageError (E501, E504)."""
    optional("distributed", "on", "dask")
    if work.threads is not None:
        message = "cannot be combined with on=: each worker sets its own threads."
        cure = "Set the threads when you start the workers: dask worker ADDRESS --nworkers 4 --nthreads 1."
        raise UsageError(Fault("E501", "threads", message, cure))
    if work.lanes != "exact":
        message = f"{legible(repr(work.lanes))} works on this machine only: the lanes of workers may differ, and with "
        message += "them the results."
        raise UsageError(Fault("E501", "lanes", message, "Leave lanes out if workers run the rows."))
    if any(isinstance(source, (str, Path)) for source in sources(case.inputs)):
        cure = "Read the file here, and give its columns: inputs={name: (t, u)}."
        raise UsageError(Fault("E501", "inputs", "is a file, which the workers may not have.", cure))
    out = "" if work.out is None else str(work.out)
    return "" if out.lower().endswith(".parquet") else out


_OWN = ("parameters", "inputs", "interpolation", "variants")
"""The words of a case that may differ between scenarios."""


def _scenarios(scenarios: Mapping[str, Mapping[str, object] | Case] | None, *, is_here: bool) -> dict[str, Case]:
    """Return the case of each scenario; one of the name "" if there are none. Raises UsageError, ModelError.

    is_here: the rows run on this machine.
    """
    given: dict[str, Case] = {}
    for name, on_top in (scenarios or {}).items():
        check_name(name)
        if not isinstance(on_top, (Mapping, Case)):
            message, cure = "must be a mapping from parameters to values, or a Case.", '{"heavy": {"load": 2}}'
            raise UsageError(Fault("E501", f"scenarios.{name}", message, f"Example: scenarios={cure}."))
        own = given[name] = on_top if isinstance(on_top, Case) else Case(parameters=on_top)
        message = cure = ""
        if others := own.without(*_OWN).words:
            message, cure = f"cannot have its own {next(iter(others))}.", f"Scenarios differ in {', '.join(_OWN)} only."
        elif any(isinstance(source, (str, Path)) for source in sources(own.inputs)):
            message, cure = "has inputs from a file.", "Give the columns of the file: inputs={name: (t, u)}."
        elif not is_here and own.without("parameters").words:
            message, cure = "has more than parameters, which workers are not given.", "Leave on= out."
        if message:
            raise UsageError(Fault("E501", f"scenarios.{name}", message, cure))
    return given or {"": EMPTY}


def _check_units(names: Sequence[str], batches: Sequence[Batch]) -> None:
    """Refuse scenarios in which the varied parameters have different units (E501)."""
    for name, batch in zip(names, batches, strict=True):
        if batch.units != batches[0].units:
            message = f"the varied parameters have other units than in {names[0]}."
            raise UsageError(Fault("E501", f"scenarios.{name}", message, "Vary parameters that all variants have."))


def _told(own: Case) -> dict[str, object]:
    """Return what a scenario is, as the file of a sweep keeps it."""
    rest = own.without("parameters").words
    digest = hashlib.sha256(repr(key_of(rest)).encode()).hexdigest()
    return {**own.parameters, **({"": digest} if rest else {})}


def units_of_measures(flat: Flat, *, plain: str = "") -> dict[str, str]:
    """The units of measures, in SI; "" where that of the signal is not known. plain: of measures that have none."""
    told = {}
    for measure in flat.measures:
        signal, (of_signal, of_time) = element_of(measure.of, flat.signals), MEASURE_UNITS.get(measure.type, (0, 0))
        powers = ((unit_texts.si_text(signal.unit) if signal and signal.unit else "", of_signal), ("s", of_time))
        parts = [unit_texts.power(unit, power) for unit, power in powers if power]
        told[measure.name] = reduce(unit_texts.product, parts) if parts else plain
    return told


def _in_unit(name: str, column: Array, unit: str) -> Array:
    """Return a column whose values have units as numbers in the unit of the parameter, or in SI if it has none.

    Columns in which some values are no numbers stay as they are. Raises ModelError (E104, E114).
    """
    if column.dtype.kind == "f":
        return column
    if unit and column.dtype.kind == "O":
        column = np.fromiter(map(read_quantity, column), dtype=object, count=len(column))
    quantities = [isinstance(item, Mapping) and {*item} <= {"value", "unit", "doc"} for item in column]
    if not any(quantities):
        return column
    unit = unit or unit_texts.si_text(str(column[quantities.index(True)].get("unit", "")))
    numbers = [in_unit(item, unit, name) for item in column.tolist()]
    if not all(map(is_number, numbers)):
        return column  # vectors and texts stay as they are given
    return np.array(numbers, dtype=float)


def _table(rows: Rows) -> Array:
    """The rows as (n, columns): floats, or objects where some values are no numbers."""
    is_plain = all(column.dtype.kind == "f" for column in rows.columns.values())
    table = np.empty((rows.n, len(rows.columns)), dtype=float if is_plain else object)
    for k, column in enumerate(rows.columns.values()):
        table[:, k] = column
    return table


def _digest(rows: Rows, seeds: Array) -> str:
    """The SHA-256 of all values and seeds, by which it is known that the rows are the same."""
    digest = hashlib.sha256(seeds.tobytes())
    for name, column in rows.columns.items():
        is_plain = column.dtype.kind == "f"
        digest.update(name.encode() + (column.tobytes() if is_plain else repr(column.tolist()).encode()))
    return digest.hexdigest()


class _Made:
    """The rows of a sweep, as far as they are there: row `number` of a scenario stands at scenario * n + number."""

    def __init__(
        self,
        name: str,
        rows: Rows,
        units: Mapping[str, str],
        scenarios: tuple[str, ...],
        seeds: Array,
        measures: Sequence[str],
        signals: Sequence[str],
        again: Callable[[str, int], Results],
    ) -> None:
        copies = max(1, len(scenarios))
        total = rows.n * copies
        self.n, self.logged = rows.n, signals
        self.messages = [""] * total
        self.t = np.empty(0)
        self.signals: dict[str, Array] = {}
        self.begun = Sweep(
            name,
            {key: np.tile(column, copies) for key, column in rows.columns.items()},
            units,
            scenarios,
            np.repeat(np.arange(copies), rows.n),
            np.tile(np.arange(rows.n), copies),
            np.tile(seeds, copies),
            np.full(total, "left", dtype="<U8"),
            (),
            np.zeros(total, dtype=np.int64),
            {key: np.full(total, np.nan) for key in measures},
            self.t,
            {},
            base=rows.base,
            warnings=rows.warnings,
            again=again,
        )
        self.status, self.steps, self.measures = self.begun.status, self.begun.steps, self.begun.measures
        self.interrupted = False
        self.part: SweepPart | None = None
        self.unwritten = np.empty(0, dtype=np.int64)

    def take_found(self) -> None:
        """Take the rows that the part of the file holds."""
        for fields in self.part.found if self.part is not None else ():
            piece = Sweep(**fields)
            self.take(piece.scenario * self.n + piece.number, piece)

    def keep(self, at: Array, rows: BatchRows) -> None:
        """Take rows, and write them to the part of the file, those that are "left" apart."""
        self.take(at, rows)
        if self.part is None:
            return
        self.unwritten = np.concatenate([self.unwritten, at[rows.status != "left"]])
        # The sizes of signals are known when the first row has run.
        if len(self.unwritten) and bool(self.signals) == bool(self.logged):
            self.part.add(vars(self.sweep().taken(self.unwritten)))
            self.unwritten = self.unwritten[:0]

    def take(self, at: Array, rows: Any) -> None:
        """Rows that are done. at: (m,) where they stand. rows: BatchRows, or a Sweep."""
        self.status[at], self.steps[at] = rows.status, rows.steps
        for k, message in zip(at.tolist(), rows.messages, strict=True):
            self.messages[k] = message
        for name, column in self.measures.items():
            column[at] = rows.measures[name]
        if not rows.signals:
            return
        if not len(self.t):
            self.t = rows.t
            shapes = {name: values.shape[1:] for name, values in rows.signals.items()}
            self.signals = {name: np.full((len(self.status), *shape), np.nan) for name, shape in shapes.items()}
        elif not np.array_equal(self.t, rows.t):
            message, cure = "its rows differ in their recorded times.", "Give every=... and stop=... for all rows."
            raise UsageError(Fault("E501", self.begun.name, message, cure))
        for name, values in rows.signals.items():
            self.signals[name][at] = values

    def sweep(self) -> Sweep:
        return replace(
            self.begun, messages=tuple(self.messages), t=self.t, signals=self.signals, interrupted=self.interrupted
        )


@dataclass
class _Rounds:
    """The rows of a sweep that are not there yet, run in rounds: a row that takes many steps waits for all others."""

    batches: Sequence[Batch]
    beside: Sequence[RowMargins]
    table: Array
    seeds: Array
    made: _Made
    threads: int | None
    progress: Callable[[int, int], None] | None
    notice: Callable[[str], None] | None

    def all(self, budget: int | None, *, is_bounded: bool) -> None:
        """Run all rows, each with at most `budget` steps.

        None: where `is_bounded`, with a budget that follows from the steps of the other rows, of which most must be
        done first. So it is the same however the rows are cut into chunks, and wherever a sweep was killed.
        """
        made = self.made
        try:
            if budget is not None or len(made.status) == 1 or not is_bounded:
                self._round(budget)
                return
            budget, is_last = STEPS, False
            self._round(budget, is_last=is_last)
            while (left := np.flatnonzero(made.status == "left")).size:
                budget, is_last, before = *_next_budget(made, budget), budget
                if self.notice is not None:
                    self.notice(self._held_up(left, before, budget, is_last=is_last))
                self._round(budget, is_last=is_last)
                if is_last:
                    return
        except KeyboardInterrupt:
            made.interrupted = True

    def _held_up(self, left: Array, before: int, budget: int, *, is_last: bool) -> str:
        """Name the rows that hold the sweep up."""
        made, names = self.made, []
        for at in left[:SHOWN].tolist():
            values = [f"{name} = {column[at]}" for name, column in made.begun.varied.items()]
            scenario = made.begun.scenarios[at // made.n] if made.begun.scenarios else ""
            names.append(f"{at % made.n} ({', '.join(filter(None, (scenario, *values)))})")
        more = f" and {len(left) - SHOWN} more" if len(left) > SHOWN else ""
        rows = f"row{'s' if len(left) > 1 else ''} {', '.join(names)}{more}"
        end = f", up to {budget:,} steps" if is_last else ""
        return f"more than {before:,} steps: {rows}. All other rows are done; the sweep continues with these rows{end}."

    def _round(self, budget: int | None, *, is_last: bool = True) -> None:
        """Run the rows that are "left"; where there is a file, in chunks that take about CHUNK seconds.

        is_last: rows that are over the budget get that status; else they stay "left". Ctrl-C is raised.
        """
        made, threads = self.made, self.threads
        left = np.flatnonzero(made.status == "left")
        total, size = len(made.status), len(left) if made.part is None else threads or os.cpu_count() or 1

        def tell(count: int, _: int) -> None:
            if self.progress is not None:
                self.progress(done + count, total)

        done = int(np.count_nonzero(made.status != "left"))
        tell(0, 0)
        for scenario, batch in enumerate(self.batches):
            waiting = left[left // made.n == scenario]
            while len(waiting):
                chunk, waiting = waiting[:size], waiting[size:]
                begun = time.perf_counter()
                numbers = chunk - scenario * made.n
                table, seeds = self.table[numbers], self.seeds[numbers]
                rows = batch(table, seeds=seeds, threads=threads, max_steps=budget, progress=tell)
                rows = rows if is_last else _postponed(rows)
                if self.beside:
                    rows = self.beside[scenario].beside(rows, batch, table, seeds)
                made.keep(chunk, rows)
                if rows.interrupted:
                    raise KeyboardInterrupt
                done = int(np.count_nonzero(made.status != "left"))
                if made.part is not None:
                    seconds = max(time.perf_counter() - begun, 1e-3)
                    size = max(1, int(min(4 * size, size * CHUNK / seconds)))


def _next_budget(made: _Made, budget: int) -> tuple[int, bool]:
    """The budget of the rows that took more than the last one, and whether it cuts them short.

    It does where most rows are done. It follows from the rows within the last budget alone: what was done after it in a
    sweep that was killed does not count.
    """
    is_within = (made.status == "ok") & (made.steps <= budget)
    is_beyond = np.isin(made.status, ("left", "budget")) | (made.steps > budget)
    if np.count_nonzero(is_within) <= np.count_nonzero(is_beyond):
        return 10 * budget, False
    return max(budget, TIMES * int(np.median(made.steps[is_within]))), True


def _postponed(rows: BatchRows) -> BatchRows:
    """The same, with rows that are over the budget "left"."""
    is_over = rows.status == "budget"
    messages = ("" if over else message for over, message in zip(is_over, rows.messages, strict=True))
    status, steps = np.where(is_over, "left", rows.status), np.where(is_over, 0, rows.steps)
    return replace(rows, status=status, messages=tuple(messages), steps=steps)
