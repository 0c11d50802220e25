"""A prepared model: what a diagram becomes once, before any run of it."""

from __future__ import annotations

import copy
import math
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from ..compile.coupling import Coupling, couple
from ..compile.equation_record import Equations
from ..compile.plan import Plan
from ..compile.plan_builder import plan
from ..compile.rebinding import Rebinding
from ..contract.captured_values import Outside, outside_of
from ..contract.resolution import Resolved
from ..host.gc_pause import paused
from ..model.copies import spellings
from ..model.diagram_grammar import RUN
from ..model.diagram_value import DiagramValue
from ..model.fingerprint import fingerprint
from ..model.flatten import Flat, flatten
from ..model.hierarchy import Resolver
from ..model.raw_values import raw_of
from ..model.settings import TIMES, RunSettings, read_settings
from ..model.trust import Paths, check_trust
from ..model.values import expressions_in
from ..model.varied import given_values
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import legible

_OF_THE_CLOCK = ("start", "stop", "step", "rtol", "atol", "gives_rtol", "every", "jumps", "stops")
"""The settings of a run that no Plan depends on."""
_OF_THE_ROW = (*_OF_THE_CLOCK, "seed")
"""Those that a Plan depends on in its row p alone, too."""
MOST_MADE = 4
"""Sets of parameters that are kept ready: each has a flat model."""
MOST_BOUND = 10_000
"""Blocks in all copies. Of more it takes longer to find what depends on a parameter than to flatten copies again."""
_PLAIN = (str, bool, int, float, Fraction, type(None))


class _Alike:
    """What prepared models share that differ in values alone.

    given: the settings of the first. made: those that were flattened, and rebindings: how others follow from them, by
    the names of the parameters that are given. model: the compiled model, once there is one; programs: those of the
    reference engine. fingerprint: of the diagram, once it was asked for. Threads may share it: what is written twice is
    written alike.
    """

    def __init__(self, given: Mapping[str, object]) -> None:
        self.given = given
        self.made: dict[frozenset[str], Prepared] = {}
        self.rebindings: dict[frozenset[str], Rebinding] = {}
        self.lock = threading.Lock()
        self.model: Any = None
        self.programs: Any = None
        self.settings: tuple[Mapping[str, Any], RunSettings] | None = None  # the last ones that were read
        self.fingerprint = ""

    def keep(self, made: Prepared) -> None:
        """Take in one that was flattened, in the place of another one with the same parameters."""
        names = frozenset(made.parameters)
        with self.lock:
            for old in [names, *self.made][: 1 if len(self.made) < MOST_MADE else 2]:
                self.made.pop(old, None)
                self.rebindings.pop(old, None)
            self.made[names] = made


@dataclass(frozen=True)
class Prepared:
    """A model that runs are made of.

    value: the diagram, its variants chosen. resolver: its block types. parameters, settings: what was given in place of
    what the diagram says, as it was given. plan: of one solver a Plan, of a master a Coupling. outside: what the
    classes of its blocks read from outside, which may change. alike: what it shares with those that differ in values
    of parameters and in settings alone.
    """

    value: DiagramValue
    resolver: Resolver
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    plan: Plan | Coupling
    outside: tuple[Outside, ...]
    alike: _Alike = field(compare=False, repr=False)

    @classmethod
    @paused()
    def of(
        cls,
        value: DiagramValue,
        resolver: Resolver,
        parameters: Mapping[str, object],
        settings: Mapping[str, object],
        *,
        trust: Paths,
        flat: Flat | None = None,
    ) -> Prepared:
        """trust: FMUs, or folders of them, that may be loaded though they lie outside of the project. flat: the flat
        model, where it is known. Raises ModelError with all faults of the diagram, and for an FMU that is not trusted.
        """
        parameters = given_values(value, resolver, parameters)
        flat = flat or _flattened(value, resolver, parameters, settings)
        check_trust(value, trust)
        outside = outside_of(block.interface.declaration for block in flat.one_of_each)
        compiled_plan = couple(flat)
        alike = _Alike(settings)
        return cls(value, resolver, parameters, settings, compiled_plan, outside, alike)._with_flat(flat)

    def _with_flat(self, flat: Flat) -> Prepared:
        """The same, which others can follow from, with its flat model."""
        vars(self).update(flat=flat, equations=Equations(flat, self.plan, self.alike))
        self.alike.keep(self)
        return self

    @cached_property
    def flat(self) -> Flat:
        """The flat model."""
        return _flattened(self.value, self.resolver, self.parameters, self.settings)

    @cached_property
    def equations(self) -> Equations:
        return Equations.later(lambda: Equations(self.flat, self.plan), self.alike)

    @property
    def known_equations(self) -> Equations | None:
        """The same, unless what they are made of is not known any more: classes read something else now."""
        return self.equations if self.is_current or not self.equations.is_to_be_made else None

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the diagram: made once, but where FMUs, which may change, are a part of it."""
        is_fixed = isinstance(self.plan, Plan) and not self.plan.foreign
        known = self.alike.fingerprint if is_fixed else ""
        self.alike.fingerprint = known or fingerprint(self.value)
        return self.alike.fingerprint

    @property
    def is_current(self) -> bool:
        """Whether all that the classes of its blocks read from outside is unchanged."""
        return all(read.holds() and not read.is_unsteady for read in self.outside)

    def flat_with(self, parameters: Mapping[str, object]) -> Flat:
        """The flat model with other parameters. Raises ModelError with all faults."""
        return _flattened(self.value, self.resolver, parameters, self.settings)

    def changed(self, name: str, value: object) -> Prepared:
        """With another value of a tunable parameter, by its path.

        Raises ModelError, and UsageError (E502) where there is none of that name, (E117) where it cannot change in a
        run.
        """
        try:
            given = given_values(self.value, self.resolver, {name: copy.deepcopy(value)}, self.parameters)
        except (ModelError, UsageError) as error:
            if error.code == "E106":
                raise self._unknown(name) from None
            raise
        # What was set in single copies before is not kept beside what is set in all of them now.
        kept = {key: raw for key, raw in self.parameters.items() if given.keys().isdisjoint(spellings(key))}
        parameters = {**kept, **given}
        quick = self._bound(parameters, self.plan.settings, tunable=given)
        if quick is not None:
            return replace(self, parameters=parameters, plan=quick)
        try:
            flat = self.flat_with(parameters)
        except ModelError as error:
            if error.code == "E106":
                raise self._unknown(name) from None
            raise
        why = _frozen_by(self.flat, flat)
        if why:
            raise UsageError(Fault("E117", name, f"cannot change during a run: {why}.", "Start a new run with it."))
        if isinstance(self.plan, Plan):
            new = plan(flat)
            compiled_plan: Plan | Coupling = replace(self.plan, parameters=new.parameters, nominal=new.nominal)
        else:
            compiled_plan = couple(flat)
        return replace(self, parameters=parameters, plan=compiled_plan)._with_flat(flat)

    def with_values(self, parameters: Mapping[str, object], settings: Mapping[str, object]) -> Prepared | None:
        """The same model with other values of parameters, and other times and tolerances of the run.

        None where the diagram must be flattened again to know what they mean: where other parameters than here are
        given, where one fixes more than numbers (see `Rebinding`), where other settings differ, or where anything is
        wrong with them.
        """
        run_settings = self._settings_with(settings)
        bound = None if run_settings is None else self._bound(parameters, run_settings)
        if run_settings is None or bound is None:
            return None
        if bound is self.plan and _same(parameters, self.parameters) and _same(settings, self.settings):
            return self
        made = Prepared(self.value, self.resolver, parameters, settings, bound, self.outside, self.alike)
        base = self.alike.made.get(frozenset(parameters), self)
        if _same(parameters, base.parameters) and run_settings.seed == base.plan.settings.seed:
            vars(made).update(equations=base.equations)  # as they were when it was flattened
        return made

    @property
    def structure(self) -> Flat:
        """The flat model with some values of parameters: its blocks, types and signals are those of this one."""
        return vars(self).get("flat") or next(iter(self.alike.made.values())).flat

    def _bound(
        self, parameters: Mapping[str, object], settings: RunSettings, tunable: Iterable[str] = ()
    ) -> Plan | Coupling | None:
        """The plan with other values of parameters. tunable: those that must be changeable in a run."""
        names, alike = frozenset(parameters), self.alike
        base = alike.made.get(names)
        if base is None:
            return None
        seed = settings.seed
        if not tunable and _same(parameters, base.parameters) and seed == base.plan.settings.seed:
            return base.plan if settings is base.plan.settings else _with_settings(base.plan, settings)
        if not isinstance(base.plan, Plan):
            return None
        known = alike.rebindings.get(names)
        if known is None:
            if not self.is_current:  # defaults would be computed from what is outside now
                return None
            if not tunable and base.plan.folded is not None and len(base.flat.blocks) > MOST_BOUND:
                return None
            known = alike.rebindings[names] = base.rebinding()
        if not known.is_possible or not all(map(known.is_tunable, tunable)):
            return None
        row = known.row(parameters, seed)
        return None if row is None else base.plan.with_values(row, settings)

    def rebinding(self, free: Iterable[str] | None = None) -> Rebinding:
        """How other values of its parameters, or of those that are free, get into its Plan, which is of one solver."""
        assert isinstance(self.plan, Plan)
        free = self.parameters if free is None else free
        return Rebinding(self.flat, self.plan, free, runs=(self.value.run, self.alike.given))

    def _settings_with(self, settings: Mapping[str, object]) -> RunSettings | None:
        """The settings of a run with others given; None where they change more than a Plan's times and tolerances."""
        known = self.plan.settings
        if _same(settings, self.settings):
            return known
        last = self.alike.settings
        if last is not None and _same(settings, last[0]):
            return last[1]
        raws = (raw for run in (self.value.run, settings) for _, raw in RUN.quantities(run))
        if not isinstance(self.plan, Plan) or any(next(expressions_in(raw), None) for raw in raws):
            return None
        made, faults = read_settings(self.value.run, **settings)
        others = replace(made, **{key: getattr(known, key) for key in _OF_THE_ROW})
        if faults or others != known:
            return None
        self.alike.settings = settings, made
        return made

    def _unknown(self, name: str) -> UsageError:
        inputs = [i[0] for i in self.plan.inputs]
        known = list(inputs)
        for b in self.flat.blocks:
            hidden = b.interface.declaration.streams
            known += [f"{b.path}.{p}" for p in b.interface.symbolic_parameters if p not in hidden]
        inputs_are = f"Inputs: {', '.join(inputs) or 'none'}"
        cure = did_you_mean(name, known) or f"{inputs_are}; a parameter needs its path, as in motor.Ra."
        return UsageError(Fault("E502", legible(name), "there is no such input or parameter.", cure))


def _with_settings(plan: Plan | Coupling, settings: RunSettings) -> Plan | Coupling:
    return plan.with_values(plan.parameters, settings) if isinstance(plan, Plan) else replace(plan, settings=settings)


def _equal(one: Any, other: Any) -> bool:
    """Whether two values are equal, in the signs of zeros too."""
    if not np.array_equal(one, other):
        return False
    kinds = np.asarray(one).dtype.kind, np.asarray(other).dtype.kind
    return kinds != ("f", "f") or np.array_equal(np.signbit(one), np.signbit(other))


def _same(given: Mapping[str, object], known: Mapping[str, object]) -> bool:
    return given.keys() == known.keys() and all(_is_same(item, known[name]) for name, item in given.items())


def _is_same(one: Any, other: Any) -> bool:
    """Whether two raw values are written alike: 1 is neither True nor 1.0, and lists may have changed meanwhile."""
    if type(one) is not type(other) or type(one) not in _PLAIN or one != other:
        return False
    return type(one) is not float or math.copysign(1.0, one) == math.copysign(1.0, other)


def _flattened(
    value: DiagramValue, resolver: Resolver, parameters: Mapping[str, object], settings: Mapping[str, object]
) -> Flat:
    overrides = {name: raw_of(given) for name, given in parameters.items()}
    return flatten(value, resolver, overrides=overrides, settings=settings)


def _settled(old: Flat, new: Flat) -> Iterable[tuple[str, Resolved, Resolved]]:
    """The numbers of all blocks in two flat models, by path."""
    if old.expansion is not None and new.expansion is not None:
        return old.expansion.settled(new.expansion)
    pairs = zip(old.blocks, new.blocks, strict=True)
    return ((before.path, before.resolved, after.resolved) for before, after in pairs)


def _frozen_by(old: Flat, new: Flat) -> str:
    """The change between two flat models that a run under way cannot take over; "" where there is none."""
    for path, before, after in _settled(old, new):
        declaration = before.interface.declaration
        memories = {f"{name}_start" for name in (*declaration.states, *declaration.discretes, *declaration.algebraics)}
        for key, value in after.values.items():
            if _equal(before.values[key].value, value.value):
                continue
            parameter = declaration.parameters[key]
            if parameter.structural or parameter.fixed:
                return f"{path}.{key} is {'structural' if parameter.structural else 'fixed'}"
            if key in memories:
                return f"{path}.{key} is a start value"
        if before.interface != after.interface:
            return f"the zeros in the parameters of {path} define its structure"
        for key, (delay, past) in after.delays.items():
            known = before.delays[key]
            if known[0] != delay or not _equal(known[1], past):
                return f"the past of {path} cannot change"
        for key, held in after.starts.items():
            if not _equal(before.starts[key], held):
                return f"{path}.{key} starts at it"
    if old.measures != new.measures:
        return "a measure depends on it"
    for key in (*TIMES, "stops", "master"):
        if getattr(old.settings, key) != getattr(new.settings, key):
            return f"{key} in the settings of the run depends on it"
    return ""
