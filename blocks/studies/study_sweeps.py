"""Sweeps of study files: read, checked before the first run, run; and what claims ask of their rows.

What they share with tunings (`study_tunings`) stands here too.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from ..api.diagram import Diagram
from ..model.flatten import Flat, element_of
from ..model.trust import Paths
from ..model.varied import columns_of
from ..text.arrays import Array
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.json_number import Number
from ..text.printable import quoted
from .sampling import check_draws, each, named_values
from .statistics import quantiles
from .sweep import Sweep
from .sweep_margins import RowMargins, margins_of

_OPTIONS = ("n", "sampler", "seed", "budget", "measures", "log", "margins", "scenarios", "lanes")


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
        options |= {key: int(options[key]) for key in ("n", "seed", "budget") if key in options}
        if "scenarios" in entry:
            options["scenarios"] = entry["scenarios"]
        parameters, settings, variants = (dict(entry.get(key, {})) for key in ("parameters", "settings", "variants"))
        return cls(name, entry["diagram"], entry[vary], options, parameters, settings, doc, variants)

    @property
    def scenarios(self) -> dict[str, Mapping[str, Any]]:
        return dict(self.options.get("scenarios", {}))

    def flattened(
        self, diagram: Diagram, parameters: Mapping[str, Any]
    ) -> tuple[list[Flat], list[tuple[Steps, Fault]]]:
        """The diagram in each scenario, and what is wrong there, each with its place in the entry.

        parameters: of all rows.
        """
        flats, faults = list[Flat](), list[tuple[Steps, Fault]]()
        for name, on_top in (self.scenarios or {"": {}}).items():
            try:
                flats.append(diagram.flatten(parameters={**parameters, **on_top}, settings=self.settings))
            except BlocksError as error:
                for fault in error.faults:
                    word = fault.place.removeprefix("run.")
                    sections = {"scenarios": on_top, "parameters": self.parameters, "settings": self.settings}
                    section = next((key for key, table in sections.items() if word in table), "")
                    steps = (section, name, word) if section == "scenarios" else (section, word) if section else ()
                    faults.append((steps, fault))
        return flats, faults


class StudySweep(ManyRuns):
    """A sweep of a study."""

    __slots__ = ()

    @classmethod
    def of(cls, name: str, entry: Mapping[str, Any], doc: str) -> StudySweep:
        """The sweep of an object that the grammar has checked."""
        return cls.read(name, entry, doc, "vary", _OPTIONS)

    def measured(self, diagram: Diagram) -> list[str]:
        """The names of its measures and margins."""
        return [*self.options.get("measures", diagram.value.measures), *self.options.get("margins", {})]

    def varied(self) -> dict[Any, Any]:
        """What `Diagram.sweep` takes as `vary`. Raises UsageError (E501)."""
        vary: dict[Any, Any] = {}
        for name, raw in self.vary.items():
            pattern = re.fullmatch(r"each\((.*)\)", name)
            if isinstance(raw, Mapping):
                (kind, given), *_ = raw.items()
                values = named_values(name, kind, plain(given))
            else:
                values = plain(raw)
            vary[each(pattern[1]) if pattern else name] = values
        return vary


def plain(value: Any) -> Any:
    """A value of a file with the numbers of Python."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return float(value) if isinstance(value, Number) else value


def faults_of(entry: StudySweep, diagram: Diagram, parameters: Mapping[str, Any]) -> Iterator[tuple[Steps, Fault]]:
    """What is wrong with a sweep of a diagram, each with its place in the entry. parameters: of all rows."""
    flats, faults = entry.flattened(diagram, parameters)
    yield from faults
    if not flats:
        return
    for name in entry.vary:
        try:
            pattern = re.fullmatch(r"each\((.*)\)", name)
            columns_of([pattern[1] if pattern else name], flats[0])
        except BlocksError as error:
            yield ("vary", name), error.faults[0]
    try:
        varied = entry.varied()
    except UsageError as error:
        yield ("vary", error.faults[0].place), error.faults[0]
        varied = {}
    for name, law in zip(entry.vary, varied.values(), strict=False):
        if callable(getattr(law, "ppf", None)):
            try:
                law.ppf(np.array([0.5]))
            except UsageError as error:
                yield ("vary", name), error.faults[0]
    try:
        check_draws(varied, entry.options.get("n"), entry.options.get("sampler", "random"))
    except UsageError as error:
        yield ("n",), error.faults[0]
    for k, name in enumerate(entry.options.get("measures", ())):
        if name not in diagram.value.measures:
            yield ("measures", k), _unknown(name, diagram.value.measures, "measure of the diagram")
    for k, name in enumerate(entry.options.get("log", ())):
        if element_of(name, flats[0].signals) is None:
            yield ("log", k), _unknown(name, flats[0].signals, "signal of the diagram")
    for name, margin in entry.options.get("margins", {}).items():
        try:
            RowMargins(diagram, margins_of({name: margin}), {"parameters": parameters, **entry.settings})
        except BlocksError as error:
            yield ("margins", name), error.faults[0]


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


def run_sweep(entry: StudySweep, diagram: Diagram, parameters: Mapping[str, Any], trust: Paths) -> Sweep:
    """Run it; Ctrl-C returns what is done. Raises as `Diagram.sweep`."""
    made: Sweep = diagram.sweep(entry.varied(), parameters=parameters, trust=trust, **entry.options, **entry.settings)
    return made


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


def figure_of(entry: Mapping[str, Any], sweeps: Mapping[str, Sweep]) -> Any:
    """A figure of a sweep. Raises UsageError (E501)."""
    sweep = sweeps[entry["sweep"]]
    sweep = sweep[entry["scenario"]] if "scenario" in entry else sweep
    bins = entry.get("bins")
    return sweep.plot(
        entry.get("of"), entry.get("against"), kind=entry.get("kind"), bins=None if bins is None else int(bins)
    )
