"""The parameters that a name sets, in runs and in rows of a batch: by a path, a pattern, or an element of a vector.

"motor.Ra"              a parameter
"control_*.eso.Ka"      one value for all parameters that the pattern names; * stands for a part of one name
"control.nlsef.k1[0]"   an element of a vector; M[0,1] of a matrix
"plant.den[1]"          a parameter of an FMU, if it has one of this name
"cells[3].motor.Ra"     in one copy; "cells[*].motor.Ra" and "cells.motor.Ra" in all
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ..contract.interface import Value
from ..contract.sparse import SparseMatrix
from ..text.element_names import element_names
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.json_number import is_number
from ..text.other_words import parameter_meant
from ..text.printable import legible
from ..text.quantity_text import read_quantity
from ..text.units import from_si, si_text, to_si
from . import raw_values as whole_values
from .copies import named, without_copies
from .diagram_value import DiagramValue
from .flatten import Flat, flatten
from .hierarchy import DiagramScope, Leaf, Resolver, bound_faults
from .origins import Origin
from .raw_values import raw_of
from .values import Absent, names_in, value_of
from .variants import taken


@dataclass(frozen=True, slots=True)
class Target:
    """A parameter, or an element of it. unit: of a bare number. whole: the whole value in SI, where an element is set.
    value: the number that the diagram gives it, in the unit; nan where that is none. units: of the elements, if they
    differ."""

    path: str
    element: int | None
    unit: str
    value: float = math.nan
    whole: tuple[Any, tuple[int, ...]] = ((), ())
    units: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table of rows: what its values are given to."""

    name: str
    targets: tuple[Target, ...]

    @property
    def unit(self) -> str:
        """The unit of its numbers; "" where there is none, or where the targets differ."""
        units = {target.unit for target in self.targets}
        return units.pop() if len(units) == 1 else ""

    @property
    def value(self) -> float:
        """The number that the diagram gives to all targets; nan where it gives none, or several."""
        values = {target.value for target in self.targets}
        return values.pop() if len(values) == 1 else math.nan


@dataclass(frozen=True, slots=True)
class _Known:
    """A parameter of a diagram: the unit of each element of a bare value, and its value in SI, where it is known.

    others: the values in copies of which they are known to differ, by lane of the `copies` around. written: what the
    file says of it.
    """

    units: tuple[str, ...]
    value: Any
    others: Mapping[int, Any]
    written: Any

    def unit(self, element: int = 0) -> str:
        return self.units[min(element, len(self.units) - 1)]

    def value_at(self, copies: Sequence[tuple[int, int | None]]) -> Any:
        """Return the value in a copy, or in several copies if it is the same in all of them; else None."""
        lane = 0
        for count, number in copies:
            if number is None:
                return None if self.others else self.value
            lane = lane * count + number
        return self.others.get(lane, self.value)


class _Parameters:
    """All parameters that can be given by their paths, without the numbers of copies."""

    def __init__(self, flat: Flat) -> None:
        assert flat.root is not None
        self.copies = flat.copies
        found = sorted(_of_diagram(flat.root), key=lambda each: each[0])  # those of diagrams first
        self.known = {path: known for _, path, known in found}

    def numbers(self, path: str) -> list[tuple[int, int | None]]:
        """For each of the fleets that a path goes through, how many copies there are, and the number of one, if any."""
        made, plain = [], ""
        for part in path.split(".")[:-1]:
            name, _, number = part.partition("[")
            plain += name
            if plain in self.copies:
                made.append((self.copies[plain], int(number[:-1]) if number else None))
            plain += "."
        return made

    def named(self, path: str) -> list[str]:
        """Return the parameters that a name or a pattern matches. A parameter of all copies has no number."""
        found = named(path, self.known, self.copies)
        return [one for one in found if all(number is None or number < n for n, number in self.numbers(one))]

    def of(self, path: str) -> _Known:
        return self.known[without_copies(path, self.copies)]

    def split(self, name: str) -> tuple[str, str]:
        """Split a name into the name without its element, and the element: "" or "[0]"."""
        if not is_element(name) or self.named(name):
            return name, ""
        path, bracket, rest = name.rpartition("[")
        return path, bracket + rest

    def each(self, path: str) -> Iterator[str]:
        """Yield the parameter in each copy that a path means."""
        labels, plain = [], ""
        for part in path.split("."):
            plain += part.partition("[")[0]
            is_open = plain in self.copies and not part.endswith("]")
            labels.append([f"{part}[{k}]" for k in range(self.copies[plain])] if is_open else [part])
            plain += "."
        return map(".".join, product(*labels))


def given_values(
    value: DiagramValue, resolver: Resolver, given: Mapping[str, object], around: Mapping[str, object] | None = None
) -> Mapping[str, object]:
    """Return values by the paths of parameters, as a run is given them, with patterns and elements written out.

    An element ("t.values[2]") changes the value that the diagram has, with the other values that are given and with
    those of `around`, which were given before. Raises ModelError, UsageError.
    """
    if not any(map(is_element, given)):
        return whole_values.given_values(value, resolver, given)
    value = taken(value)
    elements = [n for n in given if is_element(n) and not whole_values.is_of_block(value, resolver, n)]
    if not elements:
        return whole_values.given_values(value, resolver, given)
    wholes = whole_values.given_values(value, resolver, {n: raw for n, raw in given.items() if n not in elements})
    overrides = {path: raw_of(raw) for path, raw in {**(around or {}), **wholes}.items()}
    columns = columns_of(elements, flatten(value, resolver, overrides=overrides))
    written = raw_values(columns, [given[name] for name in elements])
    return {**wholes, **whole_values.given_values(value, resolver, written)}


def is_element(name: object) -> bool:
    """Return whether a name of parameters may be that of an element; a parameter of an FMU may have such a name too."""
    return isinstance(name, str) and name.endswith("]")


def columns_of(names: Sequence[str], flat: Flat) -> tuple[Column, ...]:
    """Return the columns of these names.

    Raises UsageError (E501, E106) if a name matches nothing, or repeats, and ModelError (E117) if a parameter is bound.
    """
    if isinstance(names, str):
        message, cure = "is a single name, but a list of names is needed.", f'Write ["{legible(names)}"].'
        raise UsageError(Fault("E501", legible(names), message, cure))
    parameters = _Parameters(flat)
    columns: list[Column] = []
    taken: dict[str, dict[int | None, str]] = {}  # by the path in one copy and the element: who varies it
    for name in names:
        if not isinstance(name, str):
            message, cure = "is not the name of a parameter.", 'Write a path such as "motor.Ra".'
            raise UsageError(Fault("E501", legible(str(name)), message, cure))
        found, element = _found(name, parameters)
        # Of a copy an element is set together with the others, which each copy may have of its own.
        found = [one for of_all in found for one in parameters.each(of_all)] if element else found
        targets = tuple(_target(path, name, element, parameters) for path in found)
        for target in targets:
            for path in parameters.each(target.path):
                by, own = taken.setdefault(path, {}), target.element
                other = next(iter(by.values()), None) if own is None else by.get(None, by.get(own))
                if other is not None:
                    message = f"is already varied by {legible(other)}."
                    raise UsageError(Fault("E501", legible(name), message, "Vary each parameter once."))
                by[target.element] = name
        columns.append(Column(name, targets))
    paths = dict.fromkeys(target.path for column in columns for target in column.targets)
    bound = [fault for path in paths for fault in bound_faults(path, parameters.of(path).written)]
    if bound:
        raise ModelError(*bound)
    return tuple(columns)


def each_of(name: str, flat: Flat) -> list[str]:
    """All that a name or a pattern names, each copy by itself. Raises UsageError (E106) where there is nothing."""
    parameters = _Parameters(flat)
    found, element = _found(name, parameters)
    return [one + element for path in found for one in parameters.each(path)]


def _found(name: str, parameters: _Parameters) -> tuple[list[str], str]:
    """Find the parameters that a name or a pattern matches, and the element of them: "" or "[0]".

    Raises UsageError (E106) if none does.
    """
    path, element = parameters.split(name)
    found = parameters.named(path)
    if not found:
        known, last = parameters.known, path.rpartition(".")[2]
        what = "matches no parameter" if "*" in path else "there is no such parameter"
        alike = [each for each in known if each.rpartition(".")[2] == last]
        cure = parameter_meant(path[:200], known) or did_you_mean(path[:200], known)
        cure = cure or (f"Did you mean {', '.join(alike[:3])}?" if alike else "")
        if (parts := name.partition("["))[0] in known and "][" in parts[2]:
            cure = f"Did you mean '{name.replace('][', ',')}'?"
        plain = without_copies(path, parameters.copies)
        if plain in known:
            around = (one for one in parameters.copies.items() if plain.startswith(f"{one[0]}."))
            cure = " ".join(f"{fleet} has the copies 0 to {count - 1}." for fleet, count in around) or cure
        raise UsageError(Fault("E106", legible(name), f"{what}.", cure))
    return found, element


def raw_values(columns: Sequence[Column], row: Sequence[object]) -> dict[str, Any]:
    """Return the raw values of parameters in a row, by path."""
    given: dict[str, object] = {}
    elements: dict[str, list[object]] = {}
    shapes: dict[str, tuple[Target, tuple[int, ...]]] = {}
    for column, raw in zip(columns, row, strict=True):
        raw = raw if type(raw) is float else raw_of(raw)
        is_plain = type(raw) is float and math.isfinite(raw)
        for target in column.targets:
            if target.element is None:
                given[target.path] = raw
                continue
            flat, shape = target.whole
            number = to_si(raw, target.unit) if is_plain else _number(raw, target.unit, column.name)
            elements.setdefault(target.path, list(flat))[target.element] = number
            shapes[target.path] = target, shape
    for path, values in elements.items():
        target, shape = shapes[path]
        if target.units:  # each with its own unit
            given[path] = [_quantity(value, si_text(own)) for value, own in zip(values, target.units, strict=True)]
            continue
        unit = si_text(target.unit)
        nested = np.array(values, dtype=float).reshape(shape).tolist()
        given[path] = _quantity(nested, unit)
    return given


def _quantity(value: object, unit: str) -> Any:
    return {"value": value, "unit": unit} if unit else value


def _number(raw: object, unit: str, name: str) -> float:
    """Return a value of an element in SI. Raises ModelError (E104, E107, E108, E114)."""
    try:
        number = value_of(read_quantity(raw), unit, {}).value
    except ModelError as error:
        raise ModelError(*(replace(fault, place=fault.place or name) for fault in error.faults)) from None
    except Absent:
        number = None
    if not is_number(number):
        message = f"must be a number, not {legible(repr(raw))}."
        raise ModelError(Fault("E107", legible(name), message, "To use an expression, give the whole value."))
    return float(number)


def _target(path: str, name: str, element: str, parameters: _Parameters) -> Target:
    parameter = parameters.of(path)
    value = parameter.value_at(parameters.numbers(path))
    if not element:
        unit = parameter.unit() if len(set(parameter.units)) == 1 else ""  # of unlike ones a number is in SI
        return Target(path, None, unit, _in_unit(value, unit))
    shape = np.shape(value) if value is not None and not isinstance(value, (str, SparseMatrix)) else ()
    elements = [each[len(path) :] for each in element_names(path, shape)] if shape else []
    if value is None:
        message = f"the elements of {path} are not known: its value is computed, or differs between copies."
        raise UsageError(Fault("E501", legible(name), message, "Give the whole value."))
    if element not in elements:
        message = f"{path} has no element {legible(element)}."
        cure = f"It has {elements[0]} to {elements[-1]}." if elements else "It is a single value: name it alone."
        raise UsageError(Fault("E501", legible(name), message, cure))
    k = elements.index(element)
    whole = tuple(np.ravel(value).tolist())
    units = parameter.units if len(set(parameter.units)) > 1 else ()
    return Target(path, k, parameter.unit(k), _in_unit(whole[k], parameter.unit(k)), (whole, shape), units)


def _in_unit(value: object, unit: str) -> float:
    """Convert a number from SI to another unit; return nan if it is no number."""
    array = np.asarray(value)
    return from_si(float(array), unit) if array.dtype.kind in "iuf" and array.ndim == 0 else math.nan


def _of_diagram(like: DiagramScope) -> Iterator[tuple[bool, str, _Known]]:
    """Yield the parameters of a diagram and of all in it: whether it is of a block, its path, and it; copies once.

    The value of a diagram's parameter is not known if it is computed from others or set in single copies.
    """
    for name in like.value.parameters:
        first = like.origins[name]
        in_lanes = {lane: (scope.origins[name], scope.parameters[name]) for lane, scope in like.each.items()}
        is_known = not any("[" in origin.set_at for origin, _ in in_lanes.values())
        lanes = {lane: _value(*found) for lane, found in in_lanes.items()} if is_known else {}
        value = _value(first, like.parameters[name]) if is_known else None
        yield False, like.prefix + name, _Known((str(first.unit),), value, _unlike(value, lanes), first.written)
    for child in like.children.values():
        if isinstance(child, DiagramScope):
            yield from _of_diagram(child)
        elif child is not None:
            yield from _of_block(child)


def _of_block(leaf: Leaf) -> Iterator[tuple[bool, str, _Known]]:
    declaration, values = leaf.interface.declaration, leaf.resolved.values
    for name, parameter in declaration.parameters.items():
        if name not in declaration.streams:
            value = values[name].value
            others = _unlike(value, {lane: resolved.values[name].value for lane, resolved in leaf.each.items()})
            units = leaf.interface.declared_units(parameter) or ("",)
            written = leaf.origins[name].written if name in leaf.origins else None
            yield True, f"{leaf.path}.{name}", _Known(units, value, others, written)


def _unlike(value: Any, lanes: Mapping[int, Any]) -> dict[int, object]:
    return {lane: other for lane, other in lanes.items() if not np.array_equal(other, value)}


def _value(origin: Origin, value: Value | None) -> Any:
    """Return the value in SI, or None if it is computed from other values."""
    return None if value is None or names_in(origin.raw) else value.value
