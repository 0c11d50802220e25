"""The diagrams of a study, and all that is wrong with what it asks of them, found before anything runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..api.diagram import Diagram
from ..model.block_signals import FlatSignal, element_of
from ..model.block_types import Library
from ..text import units
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.grammar import Steps
from ..text.json_document import place_of
from ..text.printable import legible, quoted
from .study_reader import Claim, Run, Study
from .study_sweeps import ManyRuns, flattened, names_missing, section_of
from .sweep_run import units_of_measures


class StudyChecks:
    """One walk over a study, which collects faults with their places in its file.

    diagrams: by run, sweep or tuning, with its variants. library: block types beyond the
    library that ships. parameters: as of `study.run`. Raises ModelError with the faults of all diagrams, of the values
    and settings that the runs give to them, and of claims about measures that they do not take, or in units of other
    quantities.
    """

    def __init__(self, study: Study, library: Library = (), parameters: Mapping[str, Any] | None = None) -> None:
        self.study, self._library = study, library
        self.diagrams: dict[str, Diagram] = {}
        self._extra = _by_run(study, parameters or {})
        self._faults: dict[Fault, None] = {}
        self._units: dict[str, dict[str, str]] = {}  # of measures: "1" where they have none, "" where it is not known
        self._recorded: dict[str, dict[str, FlatSignal]] = {}
        for entry in study.runs:
            self._check_run(entry)
        for section, many in (("sweeps", study.sweeps), ("tunings", study.tunings)):
            for each in many:
                self._check_many(section, each)
        for k, claim in enumerate(study.claims):
            self._check_claim(("claims", k), claim)
        for k, figure in enumerate(study.figures):
            self._check_sweep_of(("figures", k), figure)
        for k, figure in enumerate(study.figures):
            self._check_lines(("figures", k), figure)
        if self._faults:
            raise ModelError(*self._faults)

    def given(self, entry: Run | ManyRuns) -> dict[str, Any]:
        """Return the parameters of a run, or of all runs of a sweep or a tuning."""
        return {**entry.parameters, **self._extra.get(entry.name, {})}

    def factor(self, claim: Claim) -> float:
        """Return what makes a measure, or a change in %, a number in the unit of the claim; 1 if a unit is not known.

        Raises ModelError (E104, E114).
        """
        known = self._units.get(claim.many or next(iter(claim.runs), ""), {})
        measure = claim.measure.rpartition(".")[2] if claim.tuning else claim.measure  # of a scenario
        if units.has_offset(claim.unit):
            message = f"{claim.unit} has an offset, but measures are differences, which have none."
            raise ModelError(Fault("E104", "", message, f"Write {units.difference(claim.unit)}."))
        return units.scale("%" if claim.change else known.get(measure, ""), claim.unit)

    def _add(self, path: Steps, fault: Fault, place: str = "") -> None:
        """Collect a fault. path: its place in the file, unless it has one in another file. place: its text."""
        if not fault.file:
            fault = self.study.fault(fault.code, place or place_of(path), fault.message, fault.cure, path)
        self._faults[fault] = None

    def _add_unknown(self, path: Steps, place: Steps, message: str, cure: str) -> None:
        """Collect a fault of an unknown name (E105). path: of the name. place: of what contains it."""
        self._add(path, Fault("E105", "", message, cure), place_of(place))

    def _load(self, entry: Run | ManyRuns) -> Diagram:
        diagram = Diagram.load(Path(self.study.folder) / entry.diagram, library=self._library)
        return diagram.with_variants(entry.variants) if entry.variants else diagram

    def _check_run(self, entry: Run) -> None:
        path: Steps = ("runs", entry.name)
        try:
            diagram = self._load(entry)
            flat = flattened(diagram, entry.case(self.given(entry)))
            self.diagrams[entry.name] = diagram
            self._units[entry.name] = units_of_measures(flat, plain="1")
            elements = {signal: element_of(signal, flat.signals) for signal in flat.log}
            self._recorded[entry.name] = {signal: found for signal, found in elements.items() if found is not None}
        except (ModelError, UsageError) as error:
            for fault in error.faults:
                word = fault.place.removeprefix("run.")
                steps = section_of(word, entry, "parameters", "settings", "variants") if word else ("diagram",)
                self._add((*path, *steps), fault, f"runs.{entry.name}.{fault.place if word else 'diagram'}")

    def _check_many(self, section: str, entry: ManyRuns) -> None:
        try:
            diagram, given = self._load(entry), self.given(entry)
            self.diagrams[entry.name] = diagram
            found = [*entry.faults(diagram, given)]
            if not found:
                flat = flattened(diagram, entry.case(given))
                self._units[entry.name] = {**units_of_measures(flat, plain="1"), **entry.units_of_margins()}
        except (ModelError, UsageError) as error:
            found = [(("diagram",), fault) for fault in error.faults]
        for inside, fault in found:
            self._add((section, entry.name, *inside), fault)

    def _check_claim(self, path: Steps, claim: Claim) -> None:
        sweep = self.study.sweep(claim.sweep)
        if claim.scenario and sweep is not None and claim.scenario not in sweep.scenarios:
            message = f"the sweep {claim.sweep} has no scenario {quoted(claim.scenario)}."
            cure = f"Scenarios: {', '.join(sweep.scenarios) or 'none'}."
            self._add_unknown((*path, "scenario"), path, message, cure)
        entries = {entry.name: entry for entry in self.study.all_runs}
        for name in (*claim.runs, claim.many):
            known = entries[name].measured(self.diagrams[name]) if name in self.diagrams else [claim.measure]
            if claim.measure not in known:
                cure = did_you_mean(claim.measure, known) or f"Measures: {', '.join(known) or 'none'}."
                message = f"the diagram of {name} has no measure {quoted(claim.measure)}."
                self._add_unknown((*path, "measure"), path, message, cure)
        try:
            self.factor(claim)
        except ModelError as error:
            for fault in error.faults:
                message = f"the unit of {claim.measure}: {fault.message}"
                self._add((*path, "unit"), Fault(fault.code, "", message, fault.cure))

    def _check_sweep_of(self, path: Steps, figure: Mapping[str, Any]) -> None:
        sweep = self.study.sweep(figure.get("sweep", ""))
        if sweep is not None and sweep.name in self.diagrams:
            for fault in names_missing(sweep, self.diagrams[sweep.name], figure):
                self._add_unknown(path, path, fault.message, fault.cure)

    def _check_lines(self, path: Steps, figure: Mapping[str, Any]) -> None:
        for place, item in _drawn(path, figure):
            known = self._recorded.get(item.get("run", ""), {})
            if known and "signal" in item and element_of(item["signal"], known) is None:
                cure = did_you_mean(item["signal"], known) or 'Add it to the "log" of the diagram or of the run.'
                message = f"the run {item['run']} does not record {quoted(item['signal'])}."
                self._add_unknown((*place, "signal"), place, message, cure)


def _by_run(study: Study, parameters: Mapping[str, Any]) -> dict[str, dict[str, object]]:
    """Values by "RUN.path" as values by path, for each run. Raises ModelError (E106)."""
    values: dict[str, dict[str, object]] = {}
    names = [entry.name for entry in study.all_runs]
    for key, value in parameters.items():
        name, _, path = key.partition(".")
        if name not in names or not path:
            cure = did_you_mean(name, names) or "Write RUN.PARAMETER. Example: IADRC.torque."
            raise ModelError(Fault("E106", legible(key), "does not begin with the name of a run.", cure))
        values.setdefault(name, {})[path] = value
    return values


def _drawn(path: Steps, figure: Mapping[str, Any]) -> Iterator[tuple[Steps, Mapping[str, Any]]]:
    """The lines and markers of a figure, with their places in the file."""
    for k, panel in enumerate(figure.get("panels", ())):
        for key in ("lines", "markers"):
            for j, item in enumerate(panel.get(key, ())):
                yield (*path, "panels", k, key, j), item
