"""Sweeps of study files: read, checked before the first run, run; and what claims ask of their rows.

What they share with tunings (`study_tunings`) stands here too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from ..api.case import Case
from ..api.checks import flat_of
from ..api.diagram import Diagram
from ..model.block_signals import element_of
from ..model.flatten import Flat
from ..model.resolver import resolver_of
from ..model.trust import Paths
from ..model.varied import columns_of
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.json_number import Number
from ..text.printable import quoted
from .sampling import check_draws, each, is_law, named_values
from .statistics import quantiles
from .sweep import Sweep
from .sweep_margins import RowMargins, margins_of

Placed = tuple[Steps, Fault]
"""A fault with its place in an entry."""
_OPTIONS = ("n", "sampler", "seed", "max_steps", "measures", "log", "margins", "scenarios", "lanes")
_COUNTS = ("n", "seed", "search_seed", "max_steps", "budget")


@dataclass(frozen=True, slots=True)
class ManyRuns:
    """A sweep or a tuning of a study, as its file says it: runs of one diagram with other values of parameters.

    vary: what is said of the values, by path. options: the other arguments of `Diagram.sweep` or `Diagram.tune` that
    are no settings of runs.
    """

    name: str
    diagram: str
    vary: Mapping[str, Any]
    options: Mapping[str, Any]
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    doc: str
    variants: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, name: str, entry: Mapping[str, Any], doc: str, vary: str, keys: Collection[str]) -> Self:
        """That of an object which the grammar has checked. vary, keys: where its values, and its options, stand."""
        options = {key: plain(entry[key]) for key in keys if key in entry}
        options |= {key: int(options[key]) for key in _COUNTS if key in options}
        if "scenarios" in entry:
            options["scenarios"] = entry["scenarios"]
        parameters, settings, variants = (dict(entry.get(key, {})) for key in ("parameters", "settings", "variants"))
        return cls(name, entry["diagram"], entry[vary], options, parameters, settings, doc, variants)

    def case(self, parameters: Mapping[str, object], trust: Paths = ()) -> Case:
        """Return the case of all runs. parameters: of all rows."""
        return Case(parameters=parameters, trust=trust, **self.settings)

    @property
    def scenarios(self) -> dict[str, Mapping[str, Any]]:
        return dict(self.options.get("scenarios", {}))

    def faults(self, diagram: Diagram, parameters: Mapping[str, object]) -> Iterator[Placed]:
        """Find what is wrong, each fault with its place in the entry. parameters: of all runs."""
        flats = list[Flat]()
        for name, on_top in (self.scenarios or {"": {}}).items():
            try:
                flats.append(flattened(diagram, self.case({**parameters, **on_top})))
            except BlocksError as error:
                for fault in error.faults:
                    word = fault.place.removeprefix("run.")
                    steps: Steps = ("scenarios", name, word) if word in on_top else ()
                    yield steps or section_of(word, self, "parameters", "settings"), fault
        yield from self.asked(diagram, parameters, flats)

    def asked(self, diagram: Diagram, parameters: Mapping[str, object], flats: Sequence[Flat]) -> Iterator[Placed]:
        """Find what is wrong with what is varied and measured. flats: of the scenarios without a fault."""
        raise NotImplementedError

    def measured(self, diagram: Diagram) -> list[str]:
        """Return the measures that claims may name."""
        raise NotImplementedError

    def units_of_margins(self) -> dict[str, str]:
        """Return the units of columns that are no measures of the diagram; "1": none."""
        return {}


def flattened(diagram: Diagram, case: Case) -> Flat:
    """Return the flat model of a case of a study file, whose inputs are checked too. Raises ModelError, UsageError."""
    inputs = case.named_inputs() or None
    return flat_of(diagram.value, resolver_of(copy(diagram.types)), case, inputs=inputs)


def section_of(word: str, entry: object, *sections: str) -> Steps:
    """Return the steps from an entry to a word in one of its sections; none if it is in none of them."""
    return next(((section, word) for section in sections if word in getattr(entry, section)), ())


def placed(steps: Steps, check: Callable[..., object], *given: object) -> Iterator[Placed]:
    """Find what is wrong with one part of an entry, by a call that raises its faults."""
    try:
        check(*given)
    except BlocksError as error:
        yield from ((steps, fault) for fault in error.faults)


class StudySweep(ManyRuns):
    """A sweep of a study."""

    __slots__ = ()

    @classmethod
    def of(cls, name: str, entry: Mapping[str, object], doc: str) -> StudySweep:
        """The sweep of an object that the grammar has checked."""
        return cls.read(name, entry, doc, "vary", _OPTIONS)

    def measured(self, diagram: Diagram) -> list[str]:
        return [*self.options.get("measures", diagram.value.measures), *self.options.get("margins", {})]

    def units_of_margins(self) -> dict[str, str]:
        return {margin.name: margin.unit or "1" for margin in margins_of(self.options.get("margins", {}))}

    def made(self, diagram: Diagram, parameters: Mapping[str, object], trust: Paths) -> Sweep:
        """Return the sweep; Ctrl-C returns the rows that are done. Raises as `Diagram.sweep`."""
        made: Sweep = diagram.sweep(self.varied(), self.case(parameters, trust), **self.options)
        return made

    def asked(self, diagram: Diagram, parameters: Mapping[str, object], flats: Sequence[Flat]) -> Iterator[Placed]:
        if not flats:
            return
        for name in self.vary:
            yield from placed(("vary", name), columns_of, [_pattern(name) or name], flats[0])
        try:
            varied = self.varied()
        except UsageError as error:
            yield ("vary", error.faults[0].place), error.faults[0]
            varied = {}
        for name, law in zip(self.vary, varied.values(), strict=False):
            if is_law(law):
                yield from placed(("vary", name), law.ppf, np.array([0.5]))
        options, measures, signals = self.options, diagram.value.measures, flats[0].signals
        yield from placed(("n",), check_draws, varied, options.get("n"), options.get("sampler", "random"))
        for k, name in enumerate(options.get("measures", ())):
            if name not in measures:
                yield ("measures", k), _unknown(name, measures, "measure of the diagram")
        for k, name in enumerate(options.get("log", ())):
            if element_of(name, signals) is None:
                yield ("log", k), _unknown(name, signals, "signal of the diagram")
        rows = self.case(parameters)
        for name, margin in options.get("margins", {}).items():
            yield from placed(("margins", name), lambda of: RowMargins(diagram, margins_of(of), rows), {name: margin})

    def varied(self) -> dict[Any, Any]:
        """What `Diagram.sweep` takes as `vary`. Raises UsageError (E501)."""
        vary: dict[Any, object] = {}
        for name, raw in self.vary.items():
            if isinstance(raw, Mapping):
                (kind, given), *_ = raw.items()
                values = named_values(name, kind, plain(given))
            else:
                values = plain(raw)
            vary[each(_pattern(name)) if _pattern(name) else name] = values
        return vary


def plain(value: object) -> Any:
    """A value of a file with the numbers of Python."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return float(value) if isinstance(value, Number) else value


def _pattern(name: str) -> str:
    """Return the pattern in "each(PATTERN)", or ""."""
    found = re.fullmatch(r"each\((.*)\)", name)
    return found[1] if found else ""


def names_missing(entry: StudySweep, diagram: Diagram, figure: Mapping[str, Any]) -> Iterator[Fault]:
    """What a figure names that the sweep does not have."""
    known = [*entry.measured(diagram), *entry.options.get("log", ()), *entry.vary]
    for key in ("of", "against"):
        for name in [figure[key]] if isinstance(figure.get(key), str) else figure.get(key, ()):
            if name not in known and name.partition("[")[0] not in known and not any("each(" in v for v in entry.vary):
                yield _unknown(name, known, f"signal, measure or parameter of the sweep {entry.name}")
    if "scenario" in figure and figure["scenario"] not in entry.scenarios:
        yield _unknown(figure["scenario"], entry.scenarios, f"scenario of the sweep {entry.name}")


def _unknown(name: str, known: Collection[str], what: str) -> Fault:
    cure = did_you_mean(name[:200], known) or f"Known: {', '.join([*known][:20]) or 'none'}."
    return Fault("E105", name, f"{quoted(name)} is not a {what}.", cure)


def statistic_of(values: Array, statistic: tuple[str, float], limit: tuple[str, float] | None) -> float:
    """What a claim asks of a measure (n,): ("quantile", q), ("mean", nan), ("deviation", nan); or ("share", part): the
    share of all rows within the limit, ("at_most", x) or ("at_least", x).

    A row without a number keeps no limit: it is not in the share; in a quantile it lies beyond all others; and with it
    neither mean nor deviation have a number. Without a limit the other rows count.
    """
    kind, level = statistic
    if limit is not None and kind == "share":
        within = values <= limit[1] if limit[0] == "at_most" else values >= limit[1]
        return float(np.count_nonzero(within) / max(1, len(values)))
    if limit is not None and kind == "quantile":
        values = np.where(np.isnan(values), np.inf if limit[0] == "at_most" else -np.inf, values)
    known = values if limit is not None else values[~np.isnan(values)]
    if not len(known):
        return float("nan")
    if kind == "quantile":
        return float(quantiles(known, np.array([level]))[0])
    with np.errstate(invalid="ignore"):  # beside an infinite value there is no deviation
        return float(known.mean() if kind == "mean" else known.std(ddof=min(1, len(known) - 1)))


def figure_of(entry: Mapping[str, Any], sweeps: Mapping[str, Sweep]) -> object:
    """A figure of a sweep. Raises UsageError (E501)."""
    sweep = sweeps[entry["sweep"]]
    sweep = sweep[entry["scenario"]] if "scenario" in entry else sweep
    bins = entry.get("bins")
    return sweep.plot(
        entry.get("of"), entry.get("against"), kind=entry.get("kind"), bins=None if bins is None else int(bins)
    )
