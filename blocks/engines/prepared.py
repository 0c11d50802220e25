"""A prepared model: what a diagram becomes once, before any run of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compile.coupling import Coupling, couple
from ..compile.equation_record import Equations
from ..compile.plan import Plan
from ..compile.plan_builder import plan
from ..contract.outside import Outside, outside_of
from ..model.diagram import DiagramValue
from ..model.flatten import Flat, flatten
from ..model.hierarchy import Resolver
from ..model.raw_values import raw_of
from ..model.settings import TIMES
from ..model.trust import Paths, check_trust
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.gc_pause import paused
from ..text.printable import legible

__all__ = ["Prepared"]


@dataclass(frozen=True)
class Prepared:
    """A model that runs are made of.

    value: the diagram, its variants chosen. resolver: its block types. parameters, settings: what was given in place of
    what the diagram says, as it was given. plan: of one solver a Plan, of a master a Coupling. outside: what the
    classes of its blocks read from outside, which may change.
    """

    value: DiagramValue
    resolver: Resolver
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    flat: Flat
    plan: Plan | Coupling
    equations: Equations
    outside: tuple[Outside, ...]

    @classmethod
    @paused()
    def of(
        cls,
        value: DiagramValue,
        resolver: Resolver,
        parameters: Mapping[str, Any],
        settings: Mapping[str, Any],
        *,
        trust: Paths,
        flat: Flat | None = None,
    ) -> Prepared:
        """trust: FMUs, or folders of them, that may be loaded though they lie outside of the project. flat: the flat
        model, where it is known. Raises ModelError with all faults of the diagram, and for an FMU that is not trusted.
        """
        flat = flat or _flattened(value, resolver, parameters, settings)
        check_trust(value, trust)
        outside = outside_of(block.interface.declaration for block in flat.blocks)
        compiled_plan = couple(flat)
        return cls(value, resolver, parameters, settings, flat, compiled_plan, Equations(flat, compiled_plan), outside)

    @property
    def is_current(self) -> bool:
        """Whether all that the classes of its blocks read from outside is unchanged."""
        return all(read.holds() for read in self.outside)

    def flat_with(self, parameters: Mapping[str, Any]) -> Flat:
        """The flat model with other parameters. Raises ModelError with all faults."""
        return _flattened(self.value, self.resolver, parameters, self.settings)

    def changed(self, name: str, value: Any) -> Prepared:
        """With another value of a tunable parameter, by its path.

        Raises ModelError, and UsageError (E502) where there is none of that name, (E117) where it cannot change in a
        run.
        """
        parameters = {**self.parameters, name: value}
        try:
            flat = self.flat_with(parameters)
        except ModelError as error:
            if error.code == "E106":
                raise self._unknown(name) from None
            raise
        why = _frozen_by(self.flat, flat)
        if why:
            raise UsageError(Fault("E117", name, f"cannot change during a run: {why}.", "Start another run with it."))
        if isinstance(self.plan, Plan):
            new = plan(flat)
            compiled_plan: Plan | Coupling = replace(self.plan, parameters=new.parameters, nominal=new.nominal)
        else:
            compiled_plan = couple(flat)
        return replace(
            self, parameters=parameters, flat=flat, plan=compiled_plan, equations=Equations(flat, compiled_plan)
        )

    def _unknown(self, name: str) -> UsageError:
        inputs = [i[0] for i in self.plan.inputs]
        known = list(inputs)
        for b in self.flat.blocks:
            hidden = b.interface.declaration.streams
            known += [f"{b.path}.{p}" for p in b.interface.symbolic_parameters if p not in hidden]
        cure = did_you_mean(name, known) or f"Inputs: {', '.join(inputs) or 'none'}; parameters go by path."
        return UsageError(Fault("E502", legible(name), "there is no such input or parameter.", cure))


def _flattened(
    value: DiagramValue, resolver: Resolver, parameters: Mapping[str, Any], settings: Mapping[str, Any]
) -> Flat:
    overrides = {name: raw_of(given) for name, given in parameters.items()}
    return flatten(value, resolver, overrides=overrides, settings=settings)


def _frozen_by(old: Flat, new: Flat) -> str:
    """The change between two flat models that a run under way cannot take over; "" where there is none."""
    for before, after in zip(old.blocks, new.blocks, strict=True):
        declaration = before.interface.declaration
        memories = {f"{name}_start" for name in (*declaration.states, *declaration.discretes, *declaration.algebraics)}
        for key, value in after.resolved.values.items():
            if np.array_equal(before.resolved.values[key].value, value.value):
                continue
            parameter = declaration.parameters[key]
            if parameter.structural or parameter.fixed:
                return f"{before.path}.{key} is {'structural' if parameter.structural else 'fixed'}"
            if key in memories:
                return f"{before.path}.{key} is a start value"
        if before.interface != after.interface:
            return f"the zeros in the parameters of {before.path} are its structure"
        for key, (delay, past) in after.resolved.delays.items():
            known = before.resolved.delays[key]
            if known[0] != delay or not np.array_equal(known[1], past):
                return f"the past of {before.path} is what it was"
        for key, held in after.resolved.starts.items():
            if not np.array_equal(before.resolved.starts[key], held):
                return f"{before.path}.{key} starts at it"
    if old.measures != new.measures:
        return "a measure depends on it"
    for key in (*TIMES, "stops", "master"):
        if getattr(old.settings, key) != getattr(new.settings, key):
            return f"{key} in the settings of the run depends on it"
    return ""
