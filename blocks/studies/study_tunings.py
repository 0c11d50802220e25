"""Tunings of study files: read, checked before the first run, run; and what claims ask of their best values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from ..api.diagram import Diagram
from ..model.trust import Paths
from ..model.varied import columns_of
from ..text.errors import BlocksError, Fault
from ..text.grammar import Steps
from .objectives import constraints_of, objective_of
from .optimizers import check_installed
from .search_space import Space, units_of_parameters
from .study_sweeps import ManyRuns, plain
from .tuned import Tuning
from .tuning import measured

OBJECTIVE = "objective"
"""In a claim: what is minimized."""
_OPTIONS = ("minimize", "subject_to", "method", "budget", "seed", "scenarios", "lanes")


class StudyTuning(ManyRuns):
    """A tuning of a study; `vary` are its bounds."""

    __slots__ = ()

    @classmethod
    def of(cls, name: str, entry: Mapping[str, Any], doc: str) -> StudyTuning:
        """The tuning of an object that the grammar has checked."""
        return cls.read(name, entry, doc, "over", _OPTIONS)

    @property
    def told(self) -> tuple[str, ...]:
        """The names of its scenarios in measures."""
        return tuple(self.scenarios) or ("nominal",)

    def measured(self, diagram: Diagram) -> list[str]:
        """What claims may name."""
        measures = diagram.value.measures
        return [OBJECTIVE, *measures, *(f"{scenario}.{measure}" for scenario in self.told for measure in measures)]


def faults_of(entry: StudyTuning, diagram: Diagram, parameters: Mapping[str, Any]) -> Iterator[tuple[Steps, Fault]]:
    """What is wrong with a tuning of a diagram, each with its place in the entry. parameters: of all runs."""
    flats, faults = entry.flattened(diagram, parameters)
    yield from faults
    measures, options = tuple(diagram.value.measures), entry.options
    checks: list[tuple[Steps, Callable[[], Any]]] = [
        (("minimize",), partial(objective_of, options["minimize"], measures, entry.told, unknown="E105"))
    ]
    for k, text in enumerate(options.get("subject_to", ())):
        checks.append((("subject_to", k), partial(constraints_of, [text], measures, entry.told, unknown="E105")))
    unit_of = units_of_parameters(diagram, parameters)
    for name, bounds in entry.vary.items():
        checks.append((("over", name), partial(Space.of, {name: plain(bounds)}, unit_of)))
        checks += [(("over", name), partial(columns_of, [name], flat)) for flat in flats[:1]]
    found = [(steps, fault) for steps, check in checks for fault in _faults(check)]
    if flats and not found:  # whether two names are of one parameter
        found = [(("over",), fault) for fault in _faults(partial(columns_of, [*entry.vary], flats[0]))]
    yield from found


def _faults(check: Callable[[], Any]) -> tuple[Fault, ...]:
    try:
        check()
    except BlocksError as error:
        return error.faults
    return ()


def needs(entry: StudyTuning) -> None:
    """Raises UsageError (E504) where the package of its method is not installed."""
    method = entry.options.get("method", "cma")
    check_installed(method, f'tunings.{entry.name}: method "{method}"')


def run_tuning(entry: StudyTuning, diagram: Diagram, parameters: Mapping[str, Any], trust: Paths) -> Tuning:
    """Run it; where Ctrl-C ended it, it is `interrupted`. Raises as `Diagram.tune`."""
    made: Tuning = diagram.tune(
        over=plain(entry.vary), parameters=parameters, trust=trust, **entry.options, **entry.settings
    )
    return made


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
