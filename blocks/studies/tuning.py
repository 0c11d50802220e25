"""Tuning: values of parameters that make an expression over measures small, under constraints, in several scenarios.

    tuning = diagram.tune(
        minimize="ITAE_right + ITAE_left + 1e-3*ISU_right",
        over={"control_*.nlsef.k1[0]": (50, 600)},
        scenarios={"quiet": {}, "noisy": {"sigma": 0.001}},
        subject_to=["noisy.variation <= 75", "peak_e_theta <= 0.005"],
    )
    tuning.write("loop.json")

A candidate runs once in every scenario; a generation of candidates is one call of a `Batch` for each scenario.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..api.batch import Batch
from ..api.case import Case, ModelWords, Work
from ..host.progress_line import in_rows, live_line
from ..model.block_signals import element_of
from ..model.flatten import Flat
from ..model.wires import BlockSource
from ..results.results import Results
from ..text.arrays import Array
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import legible, quoted
from .gains_file import changes
from .objectives import Constraint, Objective, constraints_of, objective_of
from .optimizers import METHODS, Spent, check_installed
from .search_space import Space, units_of_parameters
from .sweep_file import check_target
from .sweep_run import units_of_measures
from .tuned import Candidates, Condition, Tuning
from .tuning_part import TuningPart

if TYPE_CHECKING:
    from ..api.diagram import Diagram

_T = TypeVar("_T")
STEPS, LEAST_STEPS = 20, 10_000
"""A run of a candidate may take STEPS times the steps of the run of the diagram itself, and LEAST_STEPS more."""
PENALTY = 10.0
"""What an excess of a constraint by all of its limit adds to the fitness, in parts of the objective of the diagram."""
CHANGE = 0.05
"""The relative change of each value for the sensitivities."""
_SCENARIOS = 'Example: scenarios={"quiet": {}, "noisy": {"sigma": 0.001}}.'
EFFORT = ("ISU", "total_variation")
"""Measures that limit a control, of whatever signal."""


def tune(diagram: Diagram, case: Case, work: Work, **asked: Any) -> Tuning:
    """Return what `Diagram.tune` gives. asked: the other arguments, as of `problem_of`."""
    if work.out is not None:
        check_target(work.out)
    return problem_of(diagram, case, lanes=work.lanes, **asked).solve(work)


@dataclass(frozen=True)
class Problem:
    """A tuning that has been checked, before its first candidate. warnings: what a user should know before it runs."""

    diagram: Diagram
    objective: Objective
    constraints: tuple[Constraint, ...]
    scenarios: Mapping[str, Mapping[str, Any]]
    batches: Mapping[str, Batch]
    space: Space
    before: Mapping[str, Results]
    optimizer: str
    budget: int
    search_seed: int
    case: Case
    warnings: tuple[Fault, ...]

    def solve(self, work: Work) -> Tuning:
        """Run the optimizer. Raises UsageError (E501) where no candidate has a number; as `SweepPart` for `out`."""
        part = None if work.out is None else TuningPart(self, work.out, restart=work.restart)
        try:
            with live_line(work.progress, in_rows("candidates")) as told:
                tuning = self._solved(_Search(self, work.threads, told, part))
            if part is not None:
                part.end(tuning.history, interrupted=tuning.interrupted)
        finally:
            if part is not None:
                part.close()
        return tuning

    def _solved(self, search: _Search) -> Tuning:
        start = self.space.cube(np.array(self.batch.nominal))
        # Optimisers compare fitnesses that may be infinite, or as large as numbers can be.
        with contextlib.suppress(Spent), np.errstate(all="ignore"):
            try:
                METHODS[self.optimizer](search, start, self.search_seed, self.budget)
            except KeyboardInterrupt:
                search.is_interrupted = True
        return search.tuning()

    @property
    def batch(self) -> Batch:
        return next(iter(self.batches.values()))

    def case_of(self, scenario: str, values: Mapping[str, object]) -> Case:
        """Return the case of a scenario, with values on top."""
        return self.case.updated(parameters={**self.scenarios[scenario], **values})

    def run(self, scenario: str, values: Mapping[str, object], seed: int | None = None) -> Results:
        """A run by itself in a scenario, with all measures."""
        return self.diagram.run(self.case_of(scenario, values), seed=seed)


def _check_search(
    case: Case, scenarios: Mapping[str, Mapping[str, Any]] | None, optimizer: str, budget: int, search_seed: int
) -> None:
    """Raise UsageError (E501, E504) for arguments of the search that cannot be."""
    if case.settings.get("method") in METHODS:
        name = case.settings["method"]
        cure = f'Write optimizer="{name}".'
        raise UsageError(Fault("E501", "method", f'"{name}" is an optimizer, and method integrates the runs.', cure))
    if optimizer not in METHODS:
        cure = did_you_mean(str(optimizer), METHODS) or f"Optimizers: {', '.join(METHODS)}."
        cure = "Use Diagram.fit, which compares with measured data." if optimizer == "least_squares" else cure
        raise UsageError(Fault("E501", "optimizer", f"{quoted(str(optimizer))} is not an optimizer.", cure))
    check_installed(optimizer, f'optimizer="{optimizer}"')
    if not isinstance(budget, int) or isinstance(budget, bool) or budget < 1:
        raise UsageError(Fault("E501", "budget", f"must be a number of candidates, such as 500, not {budget!r}."))
    if not isinstance(search_seed, int) or isinstance(search_seed, bool) or search_seed < 0:
        what = f"must be an integer, 0 or more, not {legible(repr(search_seed))}."
        raise UsageError(Fault("E501", "search_seed", what))
    if scenarios is not None and not isinstance(scenarios, Mapping):
        raise UsageError(Fault("E501", "scenarios", "must be a mapping from names to parameters.", _SCENARIOS))
    for name, on_top in (scenarios or {}).items():
        if not isinstance(on_top, Mapping):
            raise UsageError(
                Fault("E501", f"scenarios.{name}", "must be a mapping from parameters to values.", _SCENARIOS)
            )


def problem_of(
    diagram: Diagram,
    case: Case,
    *,
    minimize: str,
    over: Mapping[str, object],
    scenarios: Mapping[str, Mapping[str, object]] | None,
    subject_to: Sequence[str],
    optimizer: str,
    budget: int,
    search_seed: int,
    lanes: str,
) -> Problem:
    """Return the tuning of these arguments (of `tune`), checked: the diagram itself has run in every scenario."""
    _check_search(case, scenarios, optimizer, budget, search_seed)
    scenarios = dict(scenarios) if scenarios else {"nominal": {}}
    measures = tuple(diagram.value.measures)
    model = case.only(*ModelWords.__annotations__)
    objective = objective_of(minimize, measures, tuple(scenarios))
    constraints = constraints_of(
        subject_to, measures, tuple(scenarios),
        unit_of=lambda name: units_of_measures(diagram.flatten(model), plain="1")[name],
    )  # fmt: skip
    space = Space.of(over, units_of_parameters(diagram, model))
    read = objective.reads(tuple(scenarios)) + [pair for each in constraints for pair in each.reads()]
    needed = {name: sorted({measure for scenario, measure in read if scenario == name}) for name in scenarios}
    problem = Problem(
        diagram, objective, constraints, scenarios, {}, space, {}, optimizer, budget, search_seed, case, ()
    )  # fmt: skip
    batches = {
        name: diagram.batch(list(over), problem.case_of(name, {}), measures=needed[name], lanes=lanes)
        for name in scenarios
    }
    problem = replace(problem, batches=batches)
    before = {name: problem.run(name, {}) for name in scenarios}
    faults = [
        Fault("E501", f"{name}.{measure}", warning.message, warning.cure)
        for name, results in before.items()
        for warning in results.warnings
        for measure in needed[name]
        if warning.code == "W301" and warning.place == f"measures.{measure}"
    ]
    if faults:
        raise UsageError(*faults)
    problem = replace(problem, before=before)
    of_lanes = dict.fromkeys(warning for batch in batches.values() for warning in batch.warnings)
    return replace(problem, warnings=(*_warnings(problem, needed), *of_lanes))


def measured(results: Mapping[str, Results]) -> dict[str, dict[str, Array]]:
    """The measures of one run for each scenario, as columns of one row."""
    return {
        name: {measure: np.array([value]) for measure, value in each.measures.items()} for name, each in results.items()
    }


# --- does it cheat? ---------------------------------------------------------------------------------------------


def _warnings(problem: Problem, needed: Mapping[str, Sequence[str]]) -> tuple[Fault, ...]:
    """W501 where nothing that is asked for depends on noise, or nothing limits the effort of the control."""
    scenario, limit = "a scenario with noise at the sensor", "a limit such as noisy.variation <= 75 (total_variation)"
    has_noise, is_limited = _has_noise(problem, needed), _limits_effort(problem, needed)
    if has_noise and is_limited:
        return ()
    if is_limited:
        message = (
            "no scenario has noise that reaches the objective or a constraint: the best gains may be useless if "
            "there is noise."
        )
        cure = f"Add {scenario}."
    elif has_noise:
        message = (
            "nothing in the objective or the constraints limits or weighs the outputs of the tuned blocks: with "
            "the best values the noise may make the control chatter."
        )
        cure = f"Add {limit}."
    else:
        message = (
            "no scenario has noise that reaches the objective or a constraint, and nothing in them limits or "
            "weighs the outputs of the tuned blocks: the search then tends towards gains that noise makes useless."
        )
        cure = f"Add {scenario}, and {limit}."
    return (Fault("W501", problem.diagram.name, message, cure),)


def _has_noise(problem: Problem, needed: Mapping[str, Sequence[str]]) -> bool:
    """Whether a measure that counts is another one with another run seed: all streams of random numbers follow it."""
    seed = problem.diagram.flatten(problem.case.only(*ModelWords.__annotations__)).settings.seed + 1
    for name, results in problem.before.items():
        other = problem.run(name, {}, seed)
        for measure in needed[name]:
            value, again = results.measures[measure], other.measures[measure]
            if value != again and not (math.isnan(value) and math.isnan(again)):
                return True
    return False


def _limits_effort(problem: Problem, needed: Mapping[str, Sequence[str]]) -> bool:
    """Whether a measure that counts is one of effort, or one of a tuned block's output against nothing."""
    space, model = problem.space, problem.case.only("parameters", "variants")

    def flat(values: Mapping[str, object]) -> Flat:
        return problem.diagram.flatten(model, parameters=values)

    first, tuned = flat({}), set[str]()
    for share in (0.25, 0.75):
        with contextlib.suppress(ModelError):  # values that a block refuses, as candidates may be
            row = space.values(np.full(len(space.low), share)).tolist()
            tuned |= {name.rpartition(".")[0] for name in changes(first, flat(problem.batch.parameters(row)))}
    names = {measure for each in needed.values() for measure in each}
    for spec in first.measures:
        signal = element_of(spec.of, first.signals)
        if spec.name not in names or signal is None:
            continue
        sources = (source for source in signal.sources if isinstance(source, BlockSource))
        of = {first.blocks[source.block].path for source in sources}
        if spec.type in EFFORT or (spec.against == 0.0 and of & tuned):
            return True
    return False


# --- the search ----------------------------------------------------------------------------------------------------


class _Search:
    """The candidates of a tuning, as far as they are there; called with a generation it gives the fitness."""

    def __init__(
        self,
        problem: Problem,
        threads: int | None,
        progress: Callable[[int, int], None] | None,
        part: TuningPart | None = None,
    ) -> None:
        self.problem, self.threads, self.progress, self.part = problem, threads, progress, part
        before = measured(problem.before)
        self.base = float(problem.objective.values(before)[0])
        self.scales = [constraint.scale(before) for constraint in problem.constraints]
        self.size = abs(self.base) if math.isfinite(self.base) and self.base else 1.0
        self.budgets = {
            name: STEPS * (results.statistics.steps + results.statistics.rejected) + LEAST_STEPS
            for name, results in problem.before.items()
        }
        self.made: list[Candidates] = []
        self.count = 0
        self.is_interrupted = False
        self.why = ""  # the first reason why a candidate has no numbers

    def __call__(self, cube: Array) -> Array:
        """The fitness (n,) of points (n, k). Raises Spent."""
        left = self.problem.budget - self.count
        values = self.problem.space.values(np.asarray(cube, dtype=float)[:left])
        kept = None if self.part is None else self.part.next(values)
        candidates = self.run(values) if kept is None else kept
        if self.part is not None and kept is None and not self.is_interrupted:
            self.part.add(candidates)
        self.why = self.why or next(filter(None, candidates.messages), "")
        self.made.append(candidates)
        self.count += len(values)
        if self.is_interrupted or self.count >= self.problem.budget:
            raise Spent
        return np.where(
            np.isfinite(candidates.objective) & np.isfinite(candidates.excess),
            candidates.objective / self.size + PENALTY * candidates.excess,
            np.inf,
        )

    def run(self, values: Array, *, counts: bool = True) -> Candidates:
        """Candidates (n, k), run in every scenario. counts: towards the budget, as progress tells it."""
        n = len(values)
        status = np.full(n, "ok", dtype="<U8")
        messages = np.full(n, "", dtype=object)
        steps = np.zeros(n, dtype=np.int64)
        measured = {
            name: {measure: np.full(n, np.nan) for measure in batch.measures}
            for name, batch in self.problem.batches.items()
        }
        for k, (name, batch) in enumerate(self.problem.batches.items()):

            def told(done: int, total: int, k: int = k) -> None:
                if self.progress is not None and counts:
                    part = (k + done / max(total, 1)) / len(self.problem.batches)
                    self.progress(self.count + int(n * part), self.problem.budget)

            rows = batch(values, threads=self.threads, max_steps=self.budgets[name], progress=told)
            measured[name] = {
                measure: np.where(rows.status == "ok", column, np.nan) for measure, column in rows.measures.items()
            }
            status = np.where(status == "ok", rows.status, status)
            steps = steps + rows.steps
            texts = ["" if text.startswith("W504") else text for text in rows.messages]
            messages = np.where(messages == "", np.array(texts, dtype=object), messages)
            if rows.interrupted:
                self.is_interrupted = True
                status = np.where(status == "ok", "left", status)
                break
        objective = self.problem.objective.values(measured)
        excess = np.zeros(n)
        for constraint, scale in zip(self.problem.constraints, self.scales, strict=True):
            excess = excess + constraint.excess(measured, scale)
        is_fine = (status == "ok") & np.isfinite(objective) & np.isfinite(excess)
        objective = np.where(is_fine, objective, np.nan)
        return Candidates(values, objective, np.where(is_fine, excess, np.nan), status, steps, messages)

    def tuning(self) -> Tuning:
        """What was found. Raises UsageError (E501) where no candidate has a number."""
        problem = self.problem
        history = Candidates.joined(self.made, len(problem.space.low))
        before = measured(problem.before)
        nominal = np.array(problem.batch.nominal)
        scaled = zip(problem.constraints, self.scales, strict=True)
        excess = sum(float(each.excess(before, scale)[0]) for each, scale in scaled)
        index, has_own = history.best, not np.isnan(nominal).any()
        if index is None and not has_own:
            message = (
                f"none of {len(history.objective)} candidates has a value of the "
                f"objective{f': {self.why}' if self.why else '.'}"
            )
            cure = "Move the bounds towards values at which the diagram runs."
            raise UsageError(Fault("E501", problem.diagram.name, message, cure))
        found = (math.inf, math.inf) if index is None else (history.excess[index], history.objective[index])
        # A pattern whose values differ has none of its own to show, but they may be the best.
        is_kept = index is None or bool((excess, self.base) <= found)
        values = nominal if index is None or is_kept else history.values[index]
        given = {} if is_kept else problem.batch.parameters(values.tolist())
        after = {name: problem.run(name, given) for name in problem.scenarios}
        conditions = []
        for each in problem.constraints:
            sides = [tuple(float(side.flat[0]) for side in each.sides(of)) for of in (before, measured(after))]
            conditions.append(Condition(each.text, each.scenario, *sides[0], *sides[1]))
        batch, space = problem.batch, problem.space

        def named(items: Iterable[_T]) -> dict[str, _T]:
            return dict(zip(batch.columns, items, strict=True))

        return Tuning(
            diagram=problem.diagram, minimize=problem.objective.text, optimizer=problem.optimizer,
            search_seed=problem.search_seed, budget=problem.budget,
            bounds=named(zip(space.low.tolist(), space.high.tolist(), strict=True)), units=named(batch.units),
            nominal=named(nominal.tolist()), values=named(values.tolist()), parameters=given,
            scenarios=problem.scenarios, objective_before=self.base,
            objective=float(problem.objective.values(measured(after))[0]), before=problem.before, after=after,
            conditions=tuple(conditions),
            sensitivities={} if self.is_interrupted or (is_kept and not has_own) else self.sensitivities(values),
            history=history, warnings=problem.warnings, interrupted=self.is_interrupted, is_kept=is_kept,
            targets=named(batch.targets), variants=dict(problem.case.variants),
            why="" if index is not None else self.why,
        )  # fmt: skip

    def sensitivities(self, values: Array) -> dict[str, tuple[float, float]]:
        """The relative change of the objective where one value is smaller, or larger, by CHANGE of it."""
        k = len(values)
        size = np.where(values != 0, np.abs(values), self.problem.space.high - self.problem.space.low) * CHANGE
        rows = np.repeat(values[None], 2 * k + 1, axis=0)
        rows[np.arange(k), np.arange(k)] -= size
        rows[k + np.arange(k), np.arange(k)] += size
        objective = self.run(rows, counts=False).objective
        with np.errstate(all="ignore"):
            change = (objective[:-1] - objective[-1]) / abs(objective[-1])
        pairs = zip(change[:k].tolist(), change[k:].tolist(), strict=True)
        return dict(zip(self.problem.batch.columns, pairs, strict=True))
