"""Other values of parameters in a Plan, without flattening the diagram again: from raw values to the row p.

A `Rebinding` is for certain parameters, those that `flat` was given. It knows what is computed from them, and which
checks their values must pass. What it cannot decide it leaves to flattening, which also words all errors: `row` is None
then. So nothing that it gives differs from a Plan that is made again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, MutableSequence, Sequence
from itertools import repeat
from typing import Any

import numpy as np

from ..contract.uses import uses
from ..model.diagram_grammar import RUN
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.streams import number_of
from ..model.values import expressions_in, names_in, value_of
from ..text.arrays import Array
from ..text.errors import ModelError
from ..text.units import to_si, to_si_each
from .bindings import Given, bindings_of
from .plan import Plan
from .setting_programs import Setting, evaluated, evaluated_each, numbers, put


class Rebinding:
    """Values of some parameters in a Plan.

    flat, plan: made with values of certain parameters. runs: raw settings of runs. free: the paths of those parameters
    that get other values.

    Where `is_possible` is False, other values need a Plan of their own: what they fix is not in the row p alone (sizes
    and other structural parameters, patterns of zeros, periods, delays given by functions, tables, texts, measures,
    times of the run, nominal sizes), or the diagram has FMUs or programs in Python.
    """

    def __init__(self, flat: Flat, plan: Plan, free: Iterable[str], runs: Iterable[Mapping[str, object]] = ()) -> None:
        self.parameters, self.seed = plan.parameters, plan.settings.seed
        self.streams: tuple[tuple[str, tuple[int, ...]], ...] = ()  # each with the places of its number
        self.free, self.runs = tuple(free), tuple(runs)
        self.given: list[Given] = []
        self.bound: list[Setting] = []  # what is computed from them, in order
        self.checks: list[_Requirement] = []
        self.defaults: set[str] = set()  # of what is bound, the computed defaults of blocks
        self.is_possible = not (plan.foreign or plan.steppers) and self._follow(flat, plan)

    def _follow(self, flat: Flat, plan: Plan) -> bool:
        """Find all that depends on the parameters; return whether that is all that does."""
        settings, _, given, self.streams = bindings_of(flat, plan)
        by_path = {setting.path: setting for setting in settings}
        self.numbers = numbers(settings)
        self.given = [one for one in given if one.origin.set_at in self.free]
        if len(by_path) != len(settings) or not {*self.free} <= {one.origin.set_at for one in self.given}:
            return False
        if any(one.setting.is_bound for one in self.given):
            return False
        touched = {place for one in self.given for place in one.setting.span}
        for setting in settings:
            reads = {int(node.value) for p in setting.elements or () for node in p if node.op == "argument"}
            if reads & touched:
                self.bound.append(setting)
                touched.update(setting.span)
        changed = [*(one.setting for one in self.given), *self.bound]
        if any(setting.type != "real" or setting.variability == "constant" for setting in changed):
            return False
        paths = {setting.path for setting in changed}
        return not paths & self._read_by_runs(flat) and self._check(flat, paths, by_path)

    def _read_by_runs(self, flat: Flat) -> set[str]:
        """Find the parameters that settings of runs and measures read."""
        assert flat.diagram is not None
        raws = [raw for run in self.runs for _, raw in RUN.quantities(run)]
        raws += [raw for measure in flat.diagram.measures.values() for raw in measure.values()]
        return {name for raw in raws for name in names_in(raw)}

    def is_tunable(self, name: str) -> bool:
        """Return whether a parameter may change during a run."""
        found = [one.setting.variability for one in self.given if one.origin.set_at == name]
        return bool(found) and {*found} == {"tunable"}

    def _check(self, flat: Flat, paths: set[str], by_path: Mapping[str, Setting]) -> bool:
        """Take in the requirements of all blocks of which a parameter changes; return whether all values are in p."""
        owners = {path.rpartition(".")[0] for path in paths}
        return all(self._check_block(block, paths, by_path) for block in flat.blocks if block.path in owners)

    def _check_block(self, block: FlatBlock, paths: set[str], by_path: Mapping[str, Setting]) -> bool:
        declaration, known = block.interface.declaration, block.resolved.values
        own = {name for name in declaration.parameters if f"{block.path}.{name}" in paths}
        self.defaults |= {f"{block.path}.{name}" for name in own if callable(declaration.parameters[name].default)}
        if any(use.what == "nominal" and use.name in own for use in uses(declaration)):
            return False
        for requirement in declaration.requirements:
            reads = requirement.equation.reads
            if not own & {*reads}:
                continue
            constants = {**{name: value.value for name, value in known.items()}, **block.interface.structural}
            operands = [by_path[f"{block.path}.{name}"] if name in own else constants[name] for name in reads]
            self.checks.append(_Requirement(requirement.equation.function, operands))
        return True

    def row(self, given: Mapping[str, object], seed: int) -> tuple[float, ...] | None:
        """Return the row p with other values of the parameters; None where only flattening can tell what they mean.

        given: raw values of the same parameters. seed: of the run.
        """
        row = list(self.parameters)
        return tuple(row) if self.fill(row, given, seed) else None

    def fill(self, row: MutableSequence[float], given: Mapping[str, object], seed: int) -> bool:
        """Put the same into a row that holds `parameters`; False, and nothing is changed, where `row` gives None."""
        if not self.is_possible:
            return False
        s = self.numbers.copy()
        for one in self.given:
            setting, values = one.setting, _numbers(one, given[one.origin.set_at])
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
        put([*(one.setting for one in self.given), *self.bound], s, row)
        for stream, places in self.streams if seed != self.seed else ():
            for index in places:
                row[index] = number_of(seed, stream)
        return True

    def fill_all(self, table: Array, given: Mapping[str, Array], seeds: Sequence[int] | None) -> Array:
        """Put values into many rows that hold `parameters`; return for which rows that was possible.

        given: by path a finite number for each row. seeds: None: that of the Plan. What is False is left to `fill`.
        """
        n = len(table)
        is_filled = np.ones(n, dtype=bool)
        if not self.is_possible or any(one.setting.shape or isinstance(one.origin.unit, tuple) for one in self.given):
            return ~is_filled
        s: list[Any] = self.numbers.copy()  # arrays (n,) in the place of numbers that differ between rows
        try:
            for one in self.given:
                values = given[one.origin.set_at].tolist()
                s[one.setting.first] = np.array(to_si_each(values, str(one.origin.unit)))
                is_filled &= _are_allowed(one.setting, s)
            for setting in self.bound:
                for place, program in zip(setting.span, setting.elements or (), strict=True):
                    s[place] = np.array(evaluated_each(program, s, n))
                    if setting.path in self.defaults:
                        is_filled &= s[place] != 0.0
                is_filled &= _are_allowed(setting, s)
            for check in self.checks:
                is_filled &= check.hold(s, n)
        except Exception:  # as above; `fill` finds the rows
            return np.zeros(n, dtype=bool)
        put([*(one.setting for one in self.given), *self.bound], s, table.T)
        for stream, places in self.streams if seeds is not None else ():
            table[:, list(places)] = [[number_of(seed, stream)] for seed in seeds or ()]
        return is_filled


class _Requirement:
    """A condition of a block type on values of which some are given again: each of those is a Setting here."""

    def __init__(self, function: Callable[..., bool | Array], operands: list[Any]) -> None:
        self.function, self.operands = function, operands

    def holds(self, s: list[float]) -> bool:
        held = self.function(*[_value(x, s) if isinstance(x, Setting) else x for x in self.operands])
        return bool(held if isinstance(held, (bool, np.bool_)) else np.all(held))

    def hold(self, s: list[Any], n: int) -> Array:
        """Return whether it holds in each of n rows."""
        operands = [_each_value(x, s, n) if isinstance(x, Setting) else repeat(x) for x in self.operands]
        return np.array([bool(np.asarray(self.function(*row)).all()) for row in zip(*operands, strict=False)])


def _value(setting: Setting, s: list[float]) -> Any:
    """Return the value of a parameter as a block type sees it."""
    values = s[setting.first : setting.first + len(setting.values)]
    return np.array(values).reshape(setting.shape) if setting.shape else np.array(values[0])


def _each_value(setting: Setting, s: list[Any], n: int) -> Iterable[Any]:
    """Return `_value` of each of n rows."""
    values = np.stack([np.broadcast_to(s[place], n) for place in setting.span], axis=-1)
    return map(np.array, values.reshape(n, *setting.shape).tolist())


def _numbers(given: Given, raw: object) -> list[float] | None:
    """Evaluate a raw value in the place of the given one; None where it is no plain numbers of the same shape."""
    unit, shape = given.origin.unit, given.setting.shape
    try:
        raw = given.origin.again(raw, given.copies)
        if type(raw) is float and not shape and isinstance(unit, str) and math.isfinite(raw):
            return [to_si(raw, unit)]
        if any(expressions_in(raw.tolist() if isinstance(raw, np.ndarray) else raw)):
            return None
        value = value_of(raw, unit, {}).value
    except (ModelError, ValueError, TypeError, ArithmeticError):
        return None
    if isinstance(value, (bool, str)) or value is None or np.shape(value) != shape:
        return None
    array = np.asarray(value)
    return [float(x) for x in array.ravel().tolist()] if array.dtype.kind in "if" else None


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


def _are_allowed(setting: Setting, s: list[Any]) -> Array | bool:
    """Return whether the values of a setting are allowed, in each row."""
    values = np.array([s[place] for place in setting.span])
    if not (setting.whole or setting.members) and _allowed(setting, [float(values.min()), float(values.max())]):
        return True
    return np.array([_allowed(setting, row) for row in values.T.tolist()])
