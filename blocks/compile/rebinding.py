"""Other values of parameters in a Plan, without flattening the diagram again: from raw values to the row p.

A `Rebinding` is for certain parameters, those that `flat` was given. It knows what is computed from them, and which
checks their values must pass. What it cannot decide it leaves to flattening, which also words all errors: `row` is None
then. So nothing that it gives differs from a Plan made anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, MutableSequence, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..contract.reads import arguments
from ..model.copies import Copy, Fleet, depth_of, dimensions, own_value, spellings, unnumbered
from ..model.diagram import DiagramValue
from ..model.diagram_grammar import RUN
from ..model.flatten import Flat, FlatBlock
from ..model.hierarchy import streams_in
from ..model.streams import number_of
from ..model.values import Unit, expressions_in, names_in, value_of
from ..text.errors import ModelError
from ..text.units import to_si
from .bindings import bindings
from .plan import Plan
from .setting_programs import Setting, evaluated, numbers, put

__all__ = ["Rebinding"]


class Rebinding:
    """Values of some parameters in a Plan.

    flat, plan: made with values of exactly these parameters, `given`, by path. runs: raw settings of runs. free: those
    of the parameters that get other values; None: all.

    Where `is_possible` is False, other values need a Plan of their own: what they fix is not in the row p alone (sizes
    and other structural parameters, patterns of zeros, periods, delays, tables, texts, measures, times of the run,
    nominal sizes), or the diagram has FMUs or programs in Python.
    """

    def __init__(
        self,
        value: DiagramValue,
        flat: Flat,
        plan: Plan,
        given: Mapping[str, Any],
        runs: Iterable[Mapping[str, Any]] = (),
        free: Iterable[str] | None = None,
    ) -> None:
        self.parameters, self.seed = plan.parameters, plan.settings.seed
        self.streams: list[tuple[str, tuple[int, ...]]] = []  # the name of each stream, and where its number stands
        self.free = tuple(given if free is None else free)
        self.leaves: list[_Leaf] = []
        self.bound: list[Setting] = []  # what is computed from them, in order
        self.checks: list[_Requirement] = []
        self.defaults: set[str] = set()  # of what is bound, the computed defaults of blocks
        self.runs = tuple(runs)
        self.is_possible = not (plan.foreign or plan.steppers) and self._follow(value, flat, plan, given)

    def _follow(self, value: DiagramValue, flat: Flat, plan: Plan, given: Mapping[str, Any]) -> bool:
        """Find all that depends on the parameters; whether that is all that does."""
        settings = bindings(value, flat, plan, given)
        by_path = {setting.path: setting for setting in settings}
        last = {name.rpartition(".")[2] for name in given}
        found = {path: spellings(path) for path in by_path if path.rpartition(".")[2] in last}
        given_as = {path: next((name for name in names if name in given), "") for path, names in found.items()}
        if len(by_path) != len(settings) or not {*self.free} <= {*given_as.values()}:
            return False
        self.numbers = numbers(settings)
        blocks = {block.path: block for block in flat.blocks}
        for path, stream in streams_in(value, flat.copies):
            keys = blocks[path].interface.declaration.streams if path in blocks else ()
            self.streams += [(stream, by_path[f"{path}.{key}"].places[0]) for key in keys]
        for setting in settings:
            name = given_as.get(setting.path)
            if name is None or name not in self.free:
                continue
            if setting.is_bound or setting.variability == "constant" or setting.type != "real":
                return False
            unit, depth = _declared(setting.path, value, blocks)
            self.leaves.append(_Leaf(name, setting, unit, depth, unnumbered(name, _copies(setting.path, flat.copies))))
        touched = {place for leaf in self.leaves for place in _elements(leaf.setting)}
        for setting in settings:
            reads = {int(node.value) for p in setting.elements or () for node in p if node.op == "argument"}
            if reads & touched:
                if setting.type != "real" or setting.variability == "constant":
                    return False
                self.bound.append(setting)
                touched.update(_elements(setting))
        paths = {setting.path for setting in (*(leaf.setting for leaf in self.leaves), *self.bound)}
        read_by_run = {name for run in self.runs for _, raw in RUN.quantities(run) for name in names_in(raw)}
        read_by_measures = {name for m in value.measures.values() for raw in m.values() for name in names_in(raw)}
        if paths & (read_by_run | read_by_measures):
            return False
        for path in {path.rpartition(".")[0] for path in paths} & blocks.keys():
            if not self._check(blocks[path], paths, by_path):
                return False
        return True

    def is_tunable(self, name: str) -> bool:
        """Whether a parameter may change during a run."""
        found = [leaf.setting.variability for leaf in self.leaves if leaf.name == name]
        return bool(found) and {*found} == {"tunable"}

    def _check(self, block: FlatBlock, paths: set[str], by_path: Mapping[str, Setting]) -> bool:
        """Take in the requirements of a block; whether its values are all in p."""
        declaration, known = block.interface.declaration, block.resolved.values
        own = {name for name in declaration.parameters if f"{block.path}.{name}" in paths}
        self.defaults |= {f"{block.path}.{name}" for name in own if callable(declaration.parameters[name].default)}
        for state in declaration.states.values():
            if callable(state.nominal) and own & {*arguments(state.nominal, state.name)}:
                return False
        for requirement in declaration.requirements:
            reads = requirement.equation.reads
            if not own & {*reads}:
                continue
            constants = {**{name: value.value for name, value in known.items()}, **block.interface.structural}
            operands = [by_path[f"{block.path}.{name}"] if name in own else constants[name] for name in reads]
            self.checks.append(_Requirement(requirement.equation.function, operands))
        return True

    def row(self, given: Mapping[str, Any], seed: int) -> tuple[float, ...] | None:
        """The row p with other values of the parameters; None where only flattening can tell what they mean.

        given: raw values of the same parameters. seed: of the run.
        """
        row = list(self.parameters)
        return tuple(row) if self.fill(row, given, seed) else None

    def fill(self, row: MutableSequence[float], given: Mapping[str, Any], seed: int) -> bool:
        """Put the same into a row that holds `parameters`; False, and nothing is changed, where `row` gives None."""
        if not self.is_possible:
            return False
        s = self.numbers.copy()
        for leaf in self.leaves:
            setting, values = leaf.setting, leaf.numbers(given[leaf.name])
            if values is None or not _allowed(setting, values):
                return False
            s[setting.first : setting.first + len(values)] = values
        try:
            for setting in self.bound:
                for k, program in enumerate(setting.elements or ()):
                    s[setting.first + k] = evaluated(program, s, is_strict=True)
                    if s[setting.first + k] == 0.0 and setting.path in self.defaults:
                        return False  # a function of numpy may give it another sign
                if not _allowed(setting, s[setting.first : setting.first + len(setting.values)]):
                    return False
            if not all(check.holds(s) for check in self.checks):
                return False
        except Exception:  # what Python refuses, flattening tells; a requirement may raise anything
            return False
        put([*(leaf.setting for leaf in self.leaves), *self.bound], s, row)
        for stream, places in self.streams if seed != self.seed else ():
            for index in places:
                row[index] = number_of(seed, stream)
        return True


class _Leaf(NamedTuple):
    """A setting that is given, maybe by a name that means other copies too.

    unit: of a bare number. depth: the declared dimensions. copies: those that the name gives no number of.
    """

    name: str
    setting: Setting
    unit: Unit
    depth: int
    copies: Sequence[Copy]

    def numbers(self, raw: Any) -> list[float] | None:
        """Its elements in SI, as a raw value of its name gives them; None where these are no plain numbers."""
        try:
            return _numbers(own_value(raw, self.depth, self.copies), self.unit, self.setting.shape)
        except ModelError:
            return None


class _Requirement:
    """A condition of a block type on values of which some are given anew: a Setting stands for each of those."""

    def __init__(self, function: Any, operands: list[Any]) -> None:
        self.function, self.operands = function, operands

    def holds(self, s: list[float]) -> bool:
        return bool(np.all(self.function(*(_value(x, s) if isinstance(x, Setting) else x for x in self.operands))))


def _value(setting: Setting, s: list[float]) -> Any:
    """The value of a parameter as a block type sees it."""
    values = s[setting.first : setting.first + len(setting.values)]
    return np.array(values).reshape(setting.shape) if setting.shape else np.array(values[0])


def _copies(path: str, counts: Mapping[str, int]) -> list[Copy | None]:
    """The copies that a path names, by its parts. counts: how many there are, by path without numbers."""
    made: list[Copy | None] = []
    plain = ""
    for part in path.split(".")[:-1]:
        name, bracket, number = part.partition("[")
        plain = f"{plain}.{name}" if plain else name
        made.append(Copy(Fleet(plain, counts[plain]), int(number[:-1])) if bracket else None)
    return made


def _declared(path: str, value: DiagramValue, blocks: Mapping[str, FlatBlock]) -> tuple[Unit, int]:
    """The unit of bare numbers of a parameter, or those of its elements; and its dimensions."""
    owner, _, name = path.rpartition(".")
    if owner in blocks and name in blocks[owner].interface.declaration.parameters:
        interface = blocks[owner].interface
        parameter = interface.declaration.parameters[name]
        declared = interface.declared_units(parameter)
        return declared[0] if len({*declared}) == 1 else declared, dimensions(parameter.shape)
    inside: DiagramValue | None = value
    for part in owner.split(".") if owner else ():
        inside = inside.blocks[part.partition("[")[0]].inner if inside is not None else None
    entry = inside.parameters.get(name) if inside is not None else None
    return str(entry.get("unit", "")) if isinstance(entry, Mapping) else "", depth_of(entry)


def _elements(setting: Setting) -> range:
    return range(setting.first, setting.first + len(setting.values))


def _numbers(raw: Any, unit: Unit, shape: tuple[int, ...]) -> list[float] | None:
    """The elements of a raw value in SI; None where it is no plain numbers of this shape."""
    if type(raw) is float and not shape and isinstance(unit, str) and math.isfinite(raw):
        return [to_si(raw, unit)]
    if any(_expressions(raw)):
        return None
    try:
        value = value_of(raw, unit, {}).value
    except (ModelError, ValueError, TypeError, ArithmeticError):
        return None
    if isinstance(value, (bool, str)) or value is None or np.shape(value) != shape:
        return None
    array = np.asarray(value)
    return [float(x) for x in array.ravel().tolist()] if array.dtype.kind in "if" else None


def _expressions(raw: Any) -> Iterator[str]:
    return expressions_in(raw.tolist() if isinstance(raw, np.ndarray) else raw)


def _allowed(setting: Setting, values: list[float]) -> bool:
    low, high = setting.low, setting.high
    for x in values:
        if not math.isfinite(x) or (setting.whole and not (x.is_integer() and abs(x) <= 2**53)):
            return False
        if low is not None and (x <= low if setting.low_open else x < low):
            return False
        if high is not None and (x >= high if setting.high_open else x > high):
            return False
    return not setting.members or all(x in setting.members.values() for x in values)
