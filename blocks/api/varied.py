"""What a column of a batch sets: parameters by their paths, by patterns, or elements of them.

    "motor.Ra"              a parameter
    "control_*.eso.Ka"      one value for all parameters that the pattern names; * stands for a part of one name
    "control.nlsef.k1[0]"   an element of a vector; M[0,1] of a matrix
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..model.diagram import DiagramValue
from ..model.flatten import Flat
from ..model.raw_values import raw_of
from ..model.values import Absent, value_of
from ..text.element_names import element_names, matching
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import legible
from ..text.quantity_text import read_quantity
from ..text.units import si_text, to_si

__all__ = ["Column", "Target", "columns_of", "names_of", "raw_values"]


@dataclass(frozen=True, slots=True)
class Target:
    """A parameter, or an element of it. unit: of a bare number. whole: the whole value in SI, where an element is set.
    value: the number that the diagram gives it, in the unit; nan where that is none."""

    path: str
    element: int | None
    unit: str
    value: float = math.nan
    whole: tuple[Any, tuple[int, ...]] = ((), ())


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
    """A parameter of a diagram: the unit of each element of a bare value, and its value in SI, where it is known."""

    units: tuple[str, ...]
    value: Any = None

    def unit(self, element: int = 0) -> str:
        return self.units[min(element, len(self.units) - 1)]


def columns_of(names: Sequence[str], value: DiagramValue, flat: Flat) -> tuple[Column, ...]:
    """The columns of these names. Raises UsageError (E501, E106) for what names nothing, or names twice."""
    if isinstance(names, str):
        message, cure = "is one name, not a list of names.", f'As in ["{legible(names)}"].'
        raise UsageError(Fault("E501", legible(names), message, cure))
    known = dict(_parameters(value, flat))
    columns: list[Column] = []
    taken: dict[tuple[str, int | None], str] = {}
    for name in names:
        if not isinstance(name, str):
            raise UsageError(Fault("E501", legible(str(name)), "is no name of a parameter.", 'As in "motor.Ra".'))
        targets = tuple(_target(path, name, known) for path in names_of(name, known))
        for target in targets:
            key = target.path, target.element
            other = taken.get(key) or (taken.get((target.path, None)) if target.element is not None else None)
            if other is None and target.element is None:
                other = next((by for (path, _), by in taken.items() if path == target.path), None)
            if other is not None:
                message = f"is varied by {legible(other)} already."
                raise UsageError(Fault("E501", legible(name), message, "Vary each parameter once."))
            taken[key] = name
        columns.append(Column(name, targets))
    return tuple(columns)


def names_of(name: str, known: Mapping[str, Any]) -> list[str]:
    """The parameters that a name or a pattern names, without elements. Raises UsageError (E106) where there is none."""
    path, _ = _split(name)
    found = matching(path, known) if "*" in path else [path] if path in known else []
    if not found:
        what = "names no parameter" if "*" in path else "there is no such parameter"
        alike = [each for each in known if each.rpartition(".")[2] == path.rpartition(".")[2]]
        cure = did_you_mean(path[:200], known) or (f"Did you mean {', '.join(alike[:3])}?" if alike else "")
        raise UsageError(Fault("E106", legible(name), f"{what}.", cure))
    return found


def raw_values(columns: Sequence[Column], row: Sequence[Any]) -> dict[str, Any]:
    """The raw values of parameters by path, as a row gives them."""
    given: dict[str, Any] = {}
    elements: dict[str, list[Any]] = {}
    shapes: dict[str, tuple[str, tuple[int, ...]]] = {}
    for column, raw in zip(columns, row, strict=True):
        raw = raw if type(raw) is float else raw_of(raw)
        is_plain = type(raw) is float and math.isfinite(raw)
        for target in column.targets:
            if target.element is None:
                given[target.path] = raw
                continue
            flat, shape = target.whole
            try:
                number = to_si(raw, target.unit) if is_plain else value_of(read_quantity(raw), target.unit, {}).value
            except ModelError as error:
                placed = [replace(fault, place=fault.place or column.name) for fault in error.faults]
                raise ModelError(*placed) from None
            elements.setdefault(target.path, list(flat))[target.element] = number
            shapes[target.path] = si_text(target.unit), shape
    for path, values in elements.items():
        unit, shape = shapes[path]
        nested = np.array(values, dtype=float).reshape(shape).tolist()
        given[path] = {"value": nested, "unit": unit} if unit else nested
    return given


def _split(name: str) -> tuple[str, str]:
    """A name without its element, and the element: "" or "[0]"."""
    path, bracket, rest = name.rpartition("[") if name.endswith("]") else (name, "", "")
    return path, bracket + rest


def _target(path: str, name: str, known: Mapping[str, _Known]) -> Target:
    _, element = _split(name)
    parameter = known[path]
    if not element:
        return Target(path, None, parameter.unit(), _in_unit(parameter.value, parameter.unit()))
    value = parameter.value
    shape = np.shape(value) if value is not None and not isinstance(value, str) else ()
    elements = [each[len(path) :] for each in element_names(path, shape)] if shape else []
    if element not in elements:
        message = f"{path} has no element {legible(element)}."
        cure = f"It has {elements[0]} to {elements[-1]}." if elements else "It is a single value: name it alone."
        raise UsageError(Fault("E501", legible(name), message, cure))
    if len(set(parameter.units)) > 1:
        message = "the elements have different units, so that one of them cannot be varied by itself."
        raise UsageError(Fault("E501", legible(name), message, "Vary the whole value, or a parameter of the diagram."))
    k = elements.index(element)
    whole = tuple(np.ravel(value).tolist())
    return Target(path, k, parameter.unit(k), _in_unit(whole[k], parameter.unit(k)), (whole, shape))


def _in_unit(value: Any, unit: str) -> float:
    """A number in SI in another unit; nan where it is none."""
    array = np.asarray(value)
    return float(array) / to_si(1.0, unit) if array.dtype.kind in "iuf" and array.ndim == 0 else math.nan


def _parameters(value: DiagramValue, flat: Flat) -> Iterator[tuple[str, _Known]]:
    """All parameters that can be given by their paths, those of the diagram first."""
    copies = flat.copies
    yield from _of_diagrams(value, "", "", copies)
    for block in [*flat.blocks, *(flat.one_of_each if copies else ())]:
        declaration = block.interface.declaration
        for name, parameter in declaration.parameters.items():
            if name in declaration.streams:
                continue
            known = block.resolved.values.get(name)
            units = block.interface.declared_units(parameter) or ("",)
            yield f"{block.path}.{name}", _Known(tuple(units), None if known is None else known.value)


def _of_diagrams(
    value: DiagramValue, prefix: str, path: str, copies: Mapping[str, int]
) -> Iterator[tuple[str, _Known]]:
    for name, raw in value.parameters.items():
        unit = str(raw.get("unit", "")) if isinstance(raw, Mapping) else ""
        try:
            known = value_of(raw, unit, {}).value
        except (ModelError, Absent, ValueError, TypeError, ArithmeticError):  # it is computed from others
            known = None
        yield prefix + name, _Known((unit,), known)
    for name, block in value.blocks.items():
        if block.inner is not None:
            own = f"{path}{name}"
            for label in (name, *(f"{name}[{k}]" for k in range(copies.get(own, 0)))):
                yield from _of_diagrams(block.inner, f"{prefix}{label}.", f"{own}.", copies)
