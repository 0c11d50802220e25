"""Many runs of one diagram: rows of values in, rows of measures and signals out.

    batch = diagram.batch(["motor.Ra", "control_*.eso.Ka"], measures=["ITAE"])
    rows = batch([[0.15, 0.5], [0.16, 0.6]])
    rows.measures["ITAE"], rows.status
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ..compile.coupling import Coupling
from ..compile.inputs import InputTable
from ..compile.plan import Plan
from ..compile.rebinding import Rebinding
from ..engines.prepared import Prepared
from ..engines.run.many_runs import Outcome, Row, cores, times_of
from ..engines.run.memory_estimate import check
from ..engines.selection import compiled_model
from ..host.progress_line import in_rows, live_line
from ..model.diagram_value import DiagramValue
from ..model.resolver import resolver_of
from ..model.unread import unread_faults
from ..model.variants import taken
from ..model.varied import Column, columns_of, given_values, is_element, raw_values
from ..results.results import Results
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, FMUError, ModelError, SimulationError, UsageError
from ..text.printable import counted, legible
from ..text.rich_output import Part, Shown, Table
from .batch_processes import Worker, in_processes, packed
from .batch_rows import checked_seeds, rows_of
from .case import CallWords, Case, check_words, takes
from .given_values import picked, time_of
from .lanes import Lanes, no_lanes
from .prepared_model import PreparedModel
from .run import Run, RunOptions, check_inputs, input_table

if TYPE_CHECKING:
    from ..contract.block import Block

STATUSES = ("ok", "diverged", "budget", "refused", "failed", "left")
"""What may become of a row: it ran to its end; its numbers or its steps failed (E301 to E309); it took more steps than
it may; its values are refused, and it did not run; something else failed, as an FMU; it was not reached."""
GRID = 200
"""Intervals of the grid on which signals are recorded where the diagram says none."""
PIECE = 2**26
"""Bytes of rows of parameters that are bound at once, and then run."""
MOST_FORMS = 8
"""Forms of the model, for other structural values, that are kept ready."""
_NUMERIC = ("E301", "E303", "E304", "E305", "E306", "E307", "E308", "E309")


@dataclass(frozen=True, repr=False)
class BatchRows(Shown):
    """What became of n rows.

    status: (n,) of STATUSES. messages: why, "" where there is nothing to say; also that its condition ended a row
    (W307), or that it has no lanes (W504), where those of other structural values have. measures: (n,) each, nan where
    a row has none. t: (g,) in s; signals: (n, g) and the shape of the signal, in SI, nan after the end of a row. steps:
    (n,) accepted and rejected; those of the budget where it was cut short. how: they ran, in words ("2 threads", "2
    processes: it has FMUs").
    """

    status: Array
    messages: tuple[str, ...]
    measures: Mapping[str, Array]
    t: Array
    signals: Mapping[str, Array]
    steps: Array
    interrupted: bool = False
    how: str = ""

    def __len__(self) -> int:
        return len(self.status)

    def parts(self) -> Iterator[Part]:
        """How many rows have each status, the ends of their measures, and why the first of them failed."""
        counts = {name: int(np.count_nonzero(self.status == name)) for name in STATUSES}
        told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        yield f"<BatchRows {told or 'none'}>"
        rows = [("measure", "min", "max", "rows")]
        for name, values in self.measures.items():
            known = values[~np.isnan(values)]
            ends = (f"{known.min():.5g}", f"{known.max():.5g}") if len(known) else ("-", "-")
            rows.append((name, *ends, str(len(known))))
        yield from [Table(rows)] if self.measures else []
        yield from [f"  row {k}: {text}" for k, text in enumerate(self.messages) if text][:1]


class Batch(Shown):
    """A diagram of which rows of values are run; see `Diagram.batch`. It stays what it was when it was made.

    columns: their names. targets: of each column the parameters that it sets. units: of each column, that of its bare
    numbers. measures, signals: what comes out. lanes: in which rows run side by side; "": each by itself. warnings:
    columns that nothing reads, and why lanes that were asked for are not there.
    """

    def __init__(
        self,
        value: DiagramValue,
        types: Mapping[str, type[Block]],
        names: Sequence[str],
        case: Case,
        *,
        lanes: str = "exact",
    ) -> None:
        log, engine = case.settings.get("log", []), case.engine
        settings = {"log": log, **case.settings}
        if settings.get("jumps"):
            message = "cannot be recorded in a batch: all rows record their signals on one common grid."
            raise UsageError(Fault("E501", "jumps", message, "Leave jumps out, or run the row alone."))
        if value.run.get("jumps"):
            settings["jumps"] = False
        value, whole = taken(value, case.variants), value
        kept = picked(value, case.measures)
        resolver = resolver_of(copy(types))
        of_all = case.parameters
        parameters = {**given_values(kept, resolver, of_all)}
        first = Prepared.of(kept, resolver, parameters, settings, trust=case.trust)
        check_inputs(first.plan, case.inputs, case.interpolation)
        run = first.plan.settings
        if run.stop is None:
            cure = 'Give stop=..., or "stop" in the file\'s "run".'
            raise UsageError(Fault("E501", value.name, "the runs have no stop time.", cure))
        every = run.every
        if every is None and log:
            settings["every"] = float((run.stop - run.start) / GRID)
            every = time_of("every", settings["every"])
        self._columns: tuple[Column, ...] = columns_of(names, first.flat)
        elements = columns_of([name for name in of_all if is_element(name)], first.flat)
        places = {(target.path, target.element) for column in elements for target in column.targets}
        wholes = parameters.keys() - {path for path, _ in places} | of_all.keys()
        for column in self._columns:
            for target in column.targets:
                is_free = target.element is not None and (target.path, target.element) not in places
                if target.path in parameters and not (is_free and target.path not in wholes):
                    message = "varies from row to row, and has a value for all rows (parameters, case or scenario)."
                    cure = "Leave out one of the two."
                    raise UsageError(Fault("E501", legible(target.path), message, cure))
        self.name, self.seed = value.name, run.seed
        self.columns = tuple(column.name for column in self._columns)
        self.targets = tuple(tuple(target.path for target in column.targets) for column in self._columns)
        self.has_elements = any(target.element is not None for column in self._columns for target in column.targets)
        self.units = tuple(column.unit for column in self._columns)
        self.measures, self.signals = tuple(kept.measures), tuple(first.plan.log)
        self.shapes = {name: first.plan.signal(name).shape for name in self.signals}
        self.times = times_of(run.start, every, run.stop) if every and self.signals else np.empty(0)
        self._clock = run.start, every, run.stop
        self._kept, self._resolver, self._parameters, self._settings = kept, resolver, parameters, settings
        self._case = case
        is_native = compiled_model(first.plan, engine=engine) is not None
        self._why = _why_processes(first.plan, is_native=is_native)
        self._lanes = Lanes.asked(lanes, first.plan, engine, self._why)
        varied = dict(zip(self.columns, self.targets, strict=True))
        whole = replace(whole, measures={**whole.measures, **kept.measures})
        unread = unread_faults(whole, varied, parameters, settings)
        steps = (fault for fault in first.plan.warnings if fault.code == "W211")  # of all rows alike
        self.lanes, self.warnings = self._lanes.told, (*steps, *unread, *self._lanes.warnings)
        numbers = len(first.plan.parameters) if isinstance(first.plan, Plan) else 0
        self._most = PIECE // (8 * max(1, numbers)) + 1  # rows that are bound at once
        self._forms: dict[str, _Form] = {}  # by the values that fix more than numbers; the last used one goes last
        self._fixed: list[str] | None = None  # the parameters that do
        self._first: Prepared | None = first  # until rows run, which keep forms of their own
        self._workers: list[Worker] = []  # processes that wait for rows
        rest = case.without("log", "jumps", "variants", "measures", "parameters").updated(parameters=parameters)
        self._whole = PreparedModel(value, types, rest.updated(every=settings.get("every")))
        self._model = PreparedModel(kept, types, rest.updated(**settings))

    def parts(self) -> Iterator[Part]:
        """What its columns set, and what comes out."""
        yield f"<Batch of {self.name}: {counted(len(self.columns), 'column')}>"
        rows = [("column", "unit", "of the diagram", "sets")]
        for name, unit, value, targets in zip(self.columns, self.units, self.nominal, self.targets, strict=True):
            known = "-" if math.isnan(value) else f"{value:.5g}"
            rows.append((name, unit or "-", known, counted(len(targets), "parameter")))
        yield Table(rows)
        yield f"  measures: {', '.join(self.measures) or 'none'}; signals: {', '.join(self.signals) or 'none'}"

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_forms": {}, "_workers": [], "_fixed": None, "_first": None}

    @property
    def nominal(self) -> tuple[float, ...]:
        """The number that the diagram gives to each column, in its unit; nan where it gives none, or several."""
        return tuple(column.value for column in self._columns)

    def parameters(self, row: Sequence[object]) -> dict[str, Any]:
        """The values of a row as `Diagram.run(parameters=...)` takes them."""
        return raw_values(self._columns, row)

    def single(self, row: Sequence[object] | Mapping[str, object], seed: int | None = None) -> Results:
        """Run one row by itself, with all measures and with what the diagram records. Raises as `Diagram.run`."""
        values = rows_of(self.columns, {k: [x] for k, x in row.items()})[0][0] if isinstance(row, Mapping) else row
        if len(values) != len(self.columns):
            message = f"has {len(values)} values for {len(self.columns)} columns."
            raise UsageError(Fault("E501", "row", message, f"The columns: {', '.join(self.columns)}."))
        return self._whole.run(parameters=raw_values(self._columns, values), seed=seed)

    @takes(CallWords)
    def __call__(self, table: object, **words: Unpack[CallWords]) -> BatchRows:
        """Run all rows.

        table: (n, columns), or a mapping or a DataFrame of the columns: numbers in the units of the parameters. seeds:
        (n,) of the runs; None: that of the diagram for all. threads: how many run at once; None: all cores. max_steps:
        of a run, rejected ones included. progress: called with the number of rows that are done, and of all. Ctrl-C
        ends it: what was not run is "left". Raises UsageError (E501).
        """
        check_words(words, CallWords)
        seeds, threads, max_steps = words.get("seeds"), words.get("threads"), words.get("max_steps")
        self._first = None
        rows, numbers = rows_of(self.columns, table)
        _check_count("threads", threads)
        _check_count("max_steps", max_steps)
        seeds = None if seeds is None else checked_seeds(seeds, len(rows))
        made = _Made(self, len(rows), seeds, max_steps)
        try:
            given = _Given(self, rows, numbers, made)
            with live_line(words.get("progress"), in_rows("rows")) as told:
                work = _Work(made, told)
                if self._why:
                    self._one_by_one(given, work, threads)
                else:
                    for key, places in self._alike(given, made).items():
                        if not made.interrupted:
                            self._at_once(key, given, places, work, threads)
        except KeyboardInterrupt:
            made.interrupted = True
        return replace(made.rows(), how=self.how(len(rows), threads))

    def how(self, n: int, threads: int | None = None) -> str:
        """How n rows run: in threads, with lanes or why not, or in processes and why."""
        beside = self._lanes.width
        count = max(1, min(threads or cores(), -(-n // beside)))
        if not self._why:
            more = f" of {self.lanes}" if self.lanes else ""
            more += f", without lanes: {self._lanes.why}" if self._lanes.why else ""
            return counted(count, "thread") + more
        why_here = packed(self)[1]
        if why_here:
            return f"this process only: {self._why}, and {why_here}"
        return f"{count} process{'' if count == 1 else 'es'}: {self._why}"

    def given(self, row: Sequence[object]) -> dict[str, object]:
        """Return the raw values of a row, by path. Raises what refuses them."""
        raw = raw_values(self._columns, row)
        return {**self._parameters, **given_values(self._kept, self._resolver, raw)}

    # --- by threads ------------------------------------------------------------------------------------------------

    def _alike(self, given: _Given, made: _Made) -> dict[str, Array]:
        """Return the rows of each form of the model: those whose values of what is fixed in it are alike."""
        left = made.left(np.arange(len(made.status)))
        for i in left.tolist():
            if self._fixed is not None:
                break
            self._find_fixed(given[i], i, made)
        found: dict[str, list[int]] = {}
        for i in left.tolist() if self._fixed else ():
            raw = given[i]
            found.setdefault(repr([raw.get(name) for name in self._fixed or ()]), []).append(i)
        return {key: np.array(rows) for key, rows in found.items()} if self._fixed else {"": left}

    def _find_fixed(self, given: Mapping[str, object], i: int, made: _Made) -> None:
        """Find the parameters that fix more than numbers, by a row that is not refused."""
        try:
            first = self._flattened(given, made.seed(i))
        except BlocksError:
            return
        names = sorted({path for paths in self.targets for path in paths})
        whole = first.rebinding(names)
        self._fixed = [] if whole.is_possible else [n for n in names if not first.rebinding([n]).is_possible]
        made.known = {i: (first, None if self._fixed else whole)}

    def _flattened(self, given: Mapping[str, object], seed: int | None) -> Prepared:
        settings = self._settings if seed is None else {**self._settings, "seed": seed}
        return Prepared.of(self._kept, self._resolver, given, settings, trust=self._case.trust)

    def _check_times(self, plan: Plan | Coupling) -> None:
        """Raise UsageError (E501) where a row would record its signals on a grid of its own."""
        run = plan.settings
        if self.signals and (run.start, run.every, run.stop) != self._clock:
            message = "the row changes start, stop or every, but all rows record their signals on one grid."
            raise UsageError(Fault("E501", "row", message, "Log no signals, or give start, stop and every."))

    def _at_once(self, key: str, given: _Given, places: Array, work: _Work, threads: int | None) -> None:
        """Run the rows of one form of the model by threads."""
        made = work.made
        key += "" if made.seeds is None else " by seeds"  # their base has the seed of a row, not that of the diagram
        form = self._forms.pop(key, None)
        while len(places) and not made.interrupted:
            form = self._piece(form, given, places[: self._most], work, threads)
            places = places[self._most :]
        if form is not None:
            self._forms[key] = form
        while len(self._forms) > MOST_FORMS:
            del self._forms[next(iter(self._forms))]

    def _piece(
        self, form: _Form | None, given: _Given, places: Array, work: _Work, threads: int | None
    ) -> _Form | None:
        """Bind and run some rows; return the form that they are of, once there is one."""
        made, first = work.made, -1
        for i in places.tolist() if form is None else ():
            first, form = i, self._flat(given, i, made)
            if form is not None:
                break
        if form is None:
            return None
        places = made.left(places)
        table = np.tile(form.base, (len(places), 1))
        is_bound = given.fill(table, form.rebinding, places, made.seeds)
        others: dict[int, _Form] = {}  # rows that need a form of their own
        for k in np.nonzero(~is_bound)[0].tolist():
            i = int(places[k])
            seed = made.seed(i)
            if form.rebinding.fill(table[k], given[i], form.rebinding.seed if seed is None else seed):
                is_bound[k] = True
            elif (own := form if i == first else self._flat(given, i, made)) is not None:
                if own.model is form.model and form.rebinding.is_possible:
                    table[k], is_bound[k] = own.base, True
                else:
                    others[i] = own
        self._run(form, places[is_bound], table if is_bound.all() else table[is_bound], work, threads)
        for i, own in others.items():
            if not made.interrupted:
                self._run(own, np.array([i]), own.base[None], work, 1)
        return form

    def _flat(self, given: _Given, i: int, made: _Made) -> _Form | None:
        """Flatten row i; return None if it is refused."""
        try:
            known, rebinding = made.known.pop(i, (None, None))
            return self._form(known or self._flattened(given[i], made.seed(i)), rebinding)
        except BlocksError as error:
            made.fail(i, "refused", error)
            return None

    def _form(self, prepared: Prepared, rebinding: Rebinding | None) -> _Form:
        plan = prepared.plan
        assert isinstance(plan, Plan)
        self._check_times(plan)
        names = {path for paths in self.targets for path in paths} - {*(self._fixed or ())}
        inputs = input_table(plan, self._case.inputs, self._case.interpolation)
        model, why = self._lanes.model(plan, self._case.engine)
        faults = (no_lanes("this row", why),) if why else ()
        return _Form(prepared, rebinding or prepared.rebinding(names), model, inputs, np.array(plan.parameters), faults)

    def _run(self, form: _Form, places: Array, table: Array, work: _Work, threads: int | None) -> None:
        from ..engines.native.batch_threads import run_rows

        made, plan = work.made, form.prepared.plan
        assert isinstance(plan, Plan)
        if not len(places):
            return
        before = work.done
        outcome, is_cancelled = run_rows(
            plan, form.inputs, form.model, table,
            grid=len(self.times), threads=threads, budget=made.budget, progress=lambda done: work.tell(before + done),
        )  # fmt: skip
        made.take_all(places, outcome, form.faults)
        made.interrupted |= is_cancelled
        work.tell(before + int(np.count_nonzero(outcome.is_plain)) + len(outcome.others))

    # --- one by one ----------------------------------------------------------------------------------------------

    def _one_by_one(self, given: _Given, work: _Work, threads: int | None) -> None:
        """Run the rows in processes of their own."""
        made = work.made
        rows = [(i, given[i], made.seed(i)) for i in made.left(np.arange(len(made.status))).tolist()]
        for i, ended in in_processes(self, rows, made.budget, threads or cores(), self._workers):
            if ended is None:
                made.interrupted = True
                return
            made.take(i, ended)
            work.tell(work.done + 1)

    def alone(self, given: Mapping[str, object], seed: int | None, budget: int | None) -> Row:
        """Run one row here, by raw values of all parameters that are given. Ctrl-C goes through."""
        held: list[Run] = []

        def watch(_: float, __: float) -> None:
            if held and budget is not None and held[0].tried > budget:
                raise _OverBudget

        try:
            case = Case(parameters=given, seed=seed)
            held.append(self._model.run_of(case, RunOptions(progress=watch, notice=lambda _: None)))
            self._check_times(held[0].plan)
        except BlocksError as error:
            return Row.failed(error, is_refused=not isinstance(error, (SimulationError, FMUError)))
        try:
            results = held[0].finish()
        except _OverBudget:
            return Row.over(self.name, budget)
        except BlocksError as error:
            if budget is not None and held[0].tried > budget:
                return Row.over(self.name, budget)
            found, partial = Row.failed(error, is_refused=False), getattr(error, "results", None)
            return replace(found, steps=held[0].tried, signals=self._recorded(partial))
        if results.interrupted:
            raise KeyboardInterrupt
        steps = results.statistics.steps + results.statistics.rejected
        if budget is not None and steps > budget:
            return Row.over(self.name, budget)
        return Row.ok(steps, dict(results.measures), results.warnings, self._recorded(results))

    def _recorded(self, results: Results | None) -> Array:
        """The signals (rows, elements) on the grid, as far as the run came."""
        t = self.times
        if results is None or not self.signals:
            return np.empty((0, 0))
        count = min(len(t), len(results.t))
        differs = np.nonzero(results.t[:count] != t[:count])[0]  # where something ended the run
        count = int(differs[0]) if len(differs) else count
        return np.column_stack([np.asarray(results[name])[:count].reshape(count, -1) for name in self.signals])


def prepared_of(batch: Batch, value: DiagramValue) -> list[Prepared]:
    """Return what a batch has prepared of this diagram, if no rows have run yet."""
    first = batch._first
    return [] if first is None or first.value is not value else [first]


class _OverBudget(Exception):
    """A run has taken more steps than it may."""


@dataclass(frozen=True, slots=True)
class _Form:
    """A form of the model, of which rows differ in numbers alone."""

    prepared: Prepared
    rebinding: Rebinding
    model: Any
    inputs: InputTable
    base: Array  # the row p
    faults: tuple[Fault, ...]  # W504: other forms have lanes


class _Given:
    """The raw values of the rows of a batch by path.

    Here it is decided which rows Python looks at. Finite numbers come into their places as columns of the whole table
    if they set whole parameters and fix nothing else. All else is read row by row.
    """

    def __init__(self, batch: Batch, rows: Sequence[Sequence[object]], numbers: Array | None, made: _Made) -> None:
        """Rows that are refused fail at once."""
        self.batch, self.rows = batch, rows
        self.numbers = np.full((len(rows), 1), np.nan) if numbers is None or batch.has_elements else numbers
        self.is_plain: Array = np.logical_and.reduce(np.isfinite(self.numbers), axis=1)
        self.read: dict[int, dict[str, object]] = {}
        for i in np.nonzero(~self.is_plain)[0].tolist():
            try:
                self.read[i] = batch.given(rows[i])
            except (ModelError, UsageError, ValueError, TypeError) as error:
                made.fail(i, "refused", error)

    def __getitem__(self, i: int) -> dict[str, object]:
        return self.read[i] if i in self.read else self.batch.given(self.rows[i])

    def fill(self, table: Array, rebinding: Rebinding, places: Array, seeds: Sequence[int] | None) -> Array:
        """Put the values of rows into a table; return for which rows that was possible."""
        if not self.is_plain[places].any():
            return np.zeros(len(places), dtype=bool)
        numbers = self.numbers[places]
        columns = {path: numbers[:, k] for k, paths in enumerate(self.batch.targets) for path in paths}
        is_filled = rebinding.fill_all(table, columns, seeds and [seeds[i] for i in places.tolist()])
        return is_filled & self.is_plain[places]


class _Made:
    """The rows of a batch, as far as they are there."""

    def __init__(self, batch: Batch, n: int, seeds: Sequence[int] | None, budget: int | None) -> None:
        self.batch, self.seeds, self.budget = batch, seeds, budget
        self.status = np.full(n, "left", dtype="<U8")
        self.messages = [""] * n
        self.measures = {name: np.full(n, np.nan) for name in batch.measures}
        self.steps = np.zeros(n, dtype=np.int64)
        self.t, width = batch.times, sum(math.prod(shape) for shape in batch.shapes.values())
        check(batch.name, n * len(self.t), width)
        self.recorded = np.full((n, len(self.t), width), np.nan)
        self.interrupted = False
        self.known: dict[int, tuple[Prepared, Rebinding | None]] = {}  # of the row that was looked at first

    def seed(self, i: int) -> int | None:
        return None if self.seeds is None else self.seeds[i]

    def fail(self, i: int, status: str, error: Exception) -> None:
        fault = error.faults[0] if isinstance(error, BlocksError) else Fault("E501", "row", str(error))
        self.take(i, Row(0, {}, (fault,), status))

    def left(self, places: Array) -> Array:
        """Return which of these rows are left."""
        is_left: Array = self.status[places] == "left"
        return places[is_left]

    def take_all(self, places: Array, outcome: Outcome, faults: Sequence[Fault]) -> None:
        """Take what became of these rows. faults: of rows that ran to their end and have none of their own."""
        self.recorded[places] = outcome.signals
        for k, row in outcome.others.items():
            self.take(int(places[k]), row if row.status != "ok" else replace(row, faults=row.faults or tuple(faults)))
        plain = places[outcome.is_plain]
        for name, values in outcome.measures.items():
            self.measures[name][plain] = values[outcome.is_plain]
        self.steps[plain] = outcome.steps[outcome.is_plain]
        for i in plain.tolist() if faults else ():
            self.messages[i] = _told(faults)
        self.status[plain] = "ok"  # last, as below

    def take(self, i: int, row: Row) -> None:
        """What became of row i."""
        faults, status = row.faults, row.status
        if status is None:
            status = "diverged" if any(fault.code in _NUMERIC for fault in faults) else "failed"
        if len(row.signals):
            self.recorded[i, : len(row.signals)] = row.signals
        self.steps[i] = row.steps
        self.messages[i] = _told(faults)
        for name, value in row.measures.items():
            self.measures[name][i] = value
        self.status[i] = status  # last: where Ctrl-C comes between two lines, the row is left

    def rows(self) -> BatchRows:
        for values in (*self.measures.values(), self.recorded) if self.interrupted else ():
            values[self.status == "left"] = np.nan
        self.steps[self.status == "left"] = 0
        signals, first = {}, 0
        for name, shape in self.batch.shapes.items():
            size = math.prod(shape)
            signals[name] = self.recorded[:, :, first : first + size].reshape(len(self.status), len(self.t), *shape)
            first += size
        return BatchRows(
            self.status, tuple(self.messages), self.measures, self.t, signals, self.steps, self.interrupted
        )


class _Work:
    """How far the rows are, for those who look on."""

    def __init__(self, made: _Made, progress: Callable[[int, int], None] | None) -> None:
        self.made, self.progress, self.done = made, progress, 0

    def tell(self, done: int) -> None:
        if done > self.done:
            self.done = done
            if self.progress is not None:
                self.progress(done, len(self.made.status))


def _told(faults: Iterable[Fault]) -> str:
    return " ".join(f"{fault.code} {fault.place}: {fault.message}" for fault in faults)


def _why_processes(plan: Plan | Coupling, *, is_native: bool) -> str:
    """Why rows do not run side by side in threads, in words; "" where they do."""
    if isinstance(plan, Coupling):
        return "its units are stepped by a master"
    if plan.foreign:
        return "it has FMUs"
    if plan.steppers:
        return "it has blocks with programs in Python"
    return "" if is_native else "the reference engine runs it"


def _check_count(name: str, given: object) -> None:
    """Raise UsageError (E501) for what is neither None nor an integer from 1 on."""
    if given is not None and (isinstance(given, bool) or not isinstance(given, (int, np.integer)) or given < 1):
        raise UsageError(Fault("E501", name, f"must be an integer, 1 or more, not {legible(repr(given))}."))
