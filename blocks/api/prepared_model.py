"""A prepared model: a diagram made ready once, of which runs are made at the price of the run alone.

    model = diagram.prepare(stop=10)
    for kp in (1, 2, 5):
        results = model.run(parameters={"pid.kp": kp})
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from copy import copy
from typing import TYPE_CHECKING, Any, Unpack

from ..engines.prepared import Prepared
from ..engines.selection import compiled_model
from ..model.diagram_value import DiagramValue
from ..model.resolver import resolver_of
from ..model.varied import given_values, is_element
from ..results.results import Results
from ..text.errors import Fault, UsageError
from .case import FIXED, Case, PointWords, case_of, takes
from .run import Run, RunOptions, check_inputs, started

if TYPE_CHECKING:
    from ..contract.block import Block

MOST_KEPT = 8
"""Forms of a model (other logs, methods, structural values) that are kept ready."""
MOST_BLOCKS = 50_000
"""So many blocks all forms may have, if there is more than one."""


class PreparedModel:
    """A diagram as it was when it was prepared, with the settings that were given; what changes afterwards does not
    reach it. Threads may use it at the same time: each run has its own state.

    Values of tunable parameters, start values and delays, inputs, and of the settings start, stop, step, rtol, atol,
    every, jumps, stops and seed cost nothing beyond the run. What fixes more than numbers makes a new form of the
    model, of which the last 8 are kept: structural parameters, sizes, periods, tables, texts, which elements of a
    matrix are 0; parameters that measures, the times of the run or nominal sizes are computed from; other names of
    parameters than in the runs before; log, method, loops, master. A form for FMUs is prepared once too, but these
    begin as new ones in each run. A model pickles as what it is made of, and is prepared again where it is loaded.
    """

    def __init__(self, value: DiagramValue, types: Mapping[str, type[Block]], case: Case) -> None:
        self._value, self._types = case.of(value), copy(types)
        self._resolver = resolver_of(self._types)
        self._base = case.without("variants", "measures")
        if any(map(is_element, case.parameters)):  # what a run gives goes on top of them
            written = given_values(self._value, self._resolver, case.parameters)
            self._base = self._base.without("parameters").updated(parameters=written)
        self._forms: list[Prepared] = []  # the last used one goes last
        self._lock = threading.Lock()

    def __reduce__(self) -> Any:
        return _again, (self._value, self._types, self._base)

    def __repr__(self) -> str:
        return f"<PreparedModel {self._value.name}>"

    def ready(self) -> PreparedModel:
        """Prepare and compile it now, for runs with what was given. Raises what `run` raises before it begins."""
        case = self._base
        form = Prepared.of(self._value, self._resolver, case.parameters, case.settings, trust=case.trust)
        check_inputs(form.plan, case.inputs, case.interpolation)
        form.alike.model = compiled_model(form.plan, engine=case.engine)
        self._keep(form)
        return self

    @property
    def is_current(self) -> bool:
        """Whether all that its block classes read from outside is what it was."""
        return all(form.is_current for form in self._kept())

    @takes(PointWords)
    def run(
        self,
        case: Case | None = None,
        *,
        progress: Callable[[float, float], None] | None = None,
        **words: Unpack[PointWords],
    ) -> Results:
        """Simulate to `stop`: bit for bit what `Diagram.run` gives. Arguments as there, on top of what was prepared."""
        given = case_of(case, {}).words
        for name in FIXED:
            if words.get(name) is not None or name in given:
                cure = f"Give it to prepare({name}=...)."
                raise UsageError(Fault("E501", name, "is fixed when the model is prepared.", cure))
        for name in ("out", "resume"):
            if name in words:
                cure = f"Use Diagram.run({name}=...), or save the results of this run."
                raise UsageError(Fault("E501", name, "is not available for runs of a prepared model.", cure))
        return self.run_of(case_of(case, words), RunOptions(progress=progress)).finish()

    def run_of(self, case: Case, options: RunOptions) -> Run:
        """Return a run at its start, with a case on top of what was prepared."""
        words = dict(case.words)
        if any(map(is_element, case.parameters)):
            words["parameters"] = given_values(self._value, self._resolver, case.parameters, self._base.parameters)
        case = self._base.on_top(words) if words else self._base
        known = self._kept()
        run = started(self._value, self._resolver, case, options, likes=known)
        is_new = not any(form.alike is run.prepared.alike for form in known)
        if is_new and not self.is_current:  # a form of now beside forms of then
            message = (
                "its equations read Python values from outside the blocks, which have changed since the model was "
                "prepared."
            )
            cure = "Prepare the model again: the new parameters need other equations."
            raise UsageError(Fault("E501", self._value.name, message, cure))
        self._keep(run.prepared)
        return run

    def _kept(self) -> list[Prepared]:
        """Return the forms of the model, the most recently used form first."""
        with self._lock:
            return self._forms[::-1]

    def _keep(self, used: Prepared) -> None:
        with self._lock:
            if self._forms and self._forms[-1].alike is used.alike:
                return
            form = next((form for form in self._forms if form.alike is used.alike), used)
            kept = [*(known for known in self._forms if known is not form), form][-MOST_KEPT:]
            while len(kept) > 1 and sum(len(known.flat.blocks) for known in kept) > MOST_BLOCKS:
                del kept[0]
            self._forms = kept


def _again(value: DiagramValue, types: Mapping[str, type[Block]], case: Case) -> PreparedModel:
    """Rebuild a model from a pickle."""
    return PreparedModel(value, types, case).ready()
