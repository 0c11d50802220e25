"""Tunings of study files: read, checked before the first run, run; and what claims ask of their best values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

from ..api.diagram import Diagram
from ..model.flatten import Flat
from ..model.trust import Paths
from ..model.varied import columns_of
from .objectives import constraints_of, objective_of
from .optimizers import check_installed
from .search_space import Space, units_of_parameters
from .study_sweeps import ManyRuns, Placed, placed, plain
from .tuned import Tuning
from .tuning import measured

OBJECTIVE = "objective"
"""In a claim: what is minimized."""
_OPTIONS = ("minimize", "subject_to", "optimizer", "budget", "search_seed", "scenarios", "lanes")


class StudyTuning(ManyRuns):
    """A tuning of a study; `vary` are its bounds."""

    __slots__ = ()

    @classmethod
    def of(cls, name: str, entry: Mapping[str, object], doc: str) -> StudyTuning:
        """The tuning of an object that the grammar has checked."""
        return cls.read(name, entry, doc, "over", _OPTIONS)

    @property
    def told(self) -> tuple[str, ...]:
        """The names of its scenarios in measures."""
        return tuple(self.scenarios) or ("nominal",)

    def measured(self, diagram: Diagram) -> list[str]:
        measures = diagram.value.measures
        return [OBJECTIVE, *measures, *(f"{scenario}.{measure}" for scenario in self.told for measure in measures)]

    def made(self, diagram: Diagram, parameters: Mapping[str, object], trust: Paths) -> Tuning:
        """Return the tuning; if Ctrl-C ended it, it is `interrupted`. Raises as `Diagram.tune`."""
        made: Tuning = diagram.tune(self.case(parameters, trust), over=plain(self.vary), **self.options)
        is_cut = any(run.interrupted for run in (*made.before.values(), *made.after.values()))
        return replace(made, interrupted=True) if is_cut else made

    def asked(self, diagram: Diagram, parameters: Mapping[str, object], flats: Sequence[Flat]) -> Iterator[Placed]:
        known, is_right = (tuple(diagram.value.measures), self.told), True
        objective, constraints = partial(objective_of, unknown="E105"), partial(constraints_of, unknown="E105")
        checks = [placed(("minimize",), objective, self.options["minimize"], *known)]
        for k, text in enumerate(self.options.get("subject_to", ())):
            checks.append(placed(("subject_to", k), constraints, [text], *known))
        unit_of = units_of_parameters(diagram, self.case(parameters))
        for name, bounds in self.vary.items():
            checks.append(placed(("over", name), Space.of, {name: plain(bounds)}, unit_of))
            checks += [placed(("over", name), columns_of, [name], flat) for flat in flats[:1]]
        for found in chain.from_iterable(checks):
            is_right = False
            yield found
        if flats and is_right:  # whether two names are of one parameter
            yield from placed(("over",), columns_of, [*self.vary], flats[0])


def needs(entry: StudyTuning) -> None:
    """Raises UsageError (E504) where the package of its optimizer is not installed."""
    optimizer = entry.options.get("optimizer", "cma")
    check_installed(optimizer, f'tunings.{entry.name}: optimizer "{optimizer}"')


def values_of(tuning: Tuning, measure: str) -> list[float]:
    """What a claim names, before and after."""
    if measure == OBJECTIVE:
        return [tuning.objective_before, tuning.objective]
    objective = objective_of(measure, tuple(tuning.diagram.value.measures), tuple(tuning.scenarios))
    return [float(objective.values(measured(runs))[0]) for runs in (tuning.before, tuning.after)]


def limits_of(tuning: Tuning) -> Iterator[tuple[str, str, tuple[str, float], float]]:
    """Of each constraint: its scenario, its text, the limit as claims have it, and the value that it limits."""
    for each in tuning.conditions:
        limit = ("at_least", each.left) if each.is_lower else ("at_most", each.right)
        yield each.scenario, each.text, limit, each.value
