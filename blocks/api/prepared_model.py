"""A prepared model: a diagram made ready once, of which runs are made at the price of the run alone.

    model = diagram.prepare(stop=10)
    for kp in (1, 2, 5):
        results = model.run(parameters={"pid.kp": kp})
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engines.prepared import Prepared
from ..engines.selection import compiled_model
from ..model.diagram_value import DiagramValue
from ..model.resolver import resolver_of
from ..model.trust import Paths
from ..model.varied import given_values, is_element
from ..results.results import Results
from ..text.errors import Fault, UsageError
from .given_values import check_settings
from .ports import plain_settings
from .run import Run, RunOptions, started

if TYPE_CHECKING:
    from ..contract.block import Block

MOST_KEPT = 8
"""Forms of a model (other logs, methods, structural values) that are kept ready."""
MOST_BLOCKS = 50_000
"""So many blocks all forms may have, if there is more than one."""


class PreparedModel:
    """A diagram as it was when it was prepared, with the settings that were given; what changes afterwards does not
    reach it. Threads may use it at the same time: each run has its own state.

    Values of tunable parameters and start values, inputs, and of the settings start, stop, step, rtol, atol, every,
    jumps, stops and seed cost nothing beyond the run. What fixes more than numbers makes a new form of the model, of
    which the last 8 are kept: structural parameters, sizes, periods, delays, tables, texts, which elements of a matrix
    are 0; parameters that measures, the times of the run or nominal sizes are computed from; other names of parameters
    than in the runs before; log, method, loops, master. A form for FMUs is prepared once too, but these begin as new
    ones in each run. A model pickles as what it is made of, and is prepared again where it is loaded.
    """

    def __init__(
        self,
        value: DiagramValue,
        types: Mapping[str, type[Block]],
        *,
        parameters: Mapping[str, Any] | None = None,
        engine: str | None = None,
        trust: Paths = (),
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        if "inputs" in (settings or {}):
            cure = "Give them to the run: prepare().run(inputs=...)."
            raise UsageError(Fault("E501", "inputs", "cannot be prepared: they belong to a run.", cure))
        self._value, self._types = value, dict(types)
        self._parameters, self._settings = _own(dict(parameters or {})), _own(dict(settings or {}))
        self._engine, self._trust = engine, trust
        self._resolver = resolver_of(self._types)
        if any(map(is_element, self._parameters)):  # what a run gives goes on top of them
            self._parameters = {**given_values(value, self._resolver, self._parameters)}
        self._forms: list[Prepared] = []  # the last used one goes last
        self._lock = threading.Lock()

    def __reduce__(self) -> Any:
        given = {"parameters": self._parameters, "engine": self._engine, "trust": self._trust}
        return _again, (self._value, self._types, {**given, "settings": self._settings})

    def __repr__(self) -> str:
        return f"<PreparedModel {self._value.name}>"

    def ready(self) -> PreparedModel:
        """Prepare and compile it now, for runs with what was given. Raises what `run` raises before it begins."""
        check_settings(self._settings)
        form = Prepared.of(self._value, self._resolver, self._parameters, self._settings, trust=self._trust)
        form.alike.model = compiled_model(form.plan, engine=self._engine)
        self._keep(form)
        return self

    @property
    def is_current(self) -> bool:
        """Whether all that its block classes read from outside is what it was."""
        return all(form.is_current for form in self._kept())

    def run(
        self,
        *,
        stop: float | None = None,
        inputs: Mapping[str, Any] | str | Path | Sequence[Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        interpolation: str = "linear",
        progress: Callable[[float], None] | None = None,
        **settings: Any,
    ) -> Results:
        """Simulate to `stop`: bit for bit what `Diagram.run` gives. Arguments as there, on top of what was prepared."""
        if stop is not None:
            settings["stop"] = stop
        for name in ("engine", "variants", "trust"):
            if name in settings:
                raise UsageError(Fault("E501", name, "is fixed when the model is prepared.", f"Give it to "
                f"prepare({name}=...)."))
        for name in ("out", "resume"):
            if name in settings:
                cure = f"Use Diagram.run({name}=...), or save the results of this run."
                raise UsageError(Fault("E501", name, "is not available for runs of a prepared model.", cure))
        options = RunOptions(inputs=inputs, interpolation=interpolation, progress=progress)
        return self.run_of(parameters or {}, settings, options).finish()

    def run_of(self, parameters: Mapping[str, Any], settings: Mapping[str, Any], options: RunOptions) -> Run:
        """Return a run at its start, with these parameters and settings on top of the prepared values."""
        if isinstance(parameters, Mapping):
            own: Mapping[str, Any] = _own(parameters)
            if any(map(is_element, own)):
                own = given_values(self._value, self._resolver, own, self._parameters)
            parameters = {**self._parameters, **own}
        settings = {**self._settings, **_own(plain_settings(settings))}
        options = replace(options, engine=self._engine, trust=self._trust)
        known = self._kept()
        run = started(self._value, self._resolver, parameters, settings, options, likes=known)
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
            form = next((form for form in self._forms if form.alike is used.alike), used)
            kept = [*(known for known in self._forms if known is not form), form][-MOST_KEPT:]
            while len(kept) > 1 and sum(len(known.flat.blocks) for known in kept) > MOST_BLOCKS:
                del kept[0]
            self._forms = kept


def _own(value: Any) -> Any:
    """Return a value that nobody else can change."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, Mapping):
        return {key: _own(item) for key, item in value.items()}
    return type(value)(map(_own, value)) if type(value) in (list, tuple) else value


def _again(value: DiagramValue, types: Mapping[str, type[Block]], given: Mapping[str, Any]) -> PreparedModel:
    """Rebuild a model from a pickle."""
    return PreparedModel(value, types, **given).ready()
