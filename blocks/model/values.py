"""Raw values of a diagram -> values in SI: numbers, quantities, lists, texts, and expressions over parameters.

A bare number is in the declared unit, `{"value": 1200, "unit": "mOhm"}` in its own, an expression in SI. A bare
`"=Kp"` is the parameter itself, whatever it is (a vector, a text, a bool), and its unit is checked.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from typing import Any, NoReturn

import numpy as np

from ..contract import expressions
from ..contract.expressions import Expression, Scalar, exact_decimal
from ..contract.interface import Value
from ..contract.sparse import SparseMatrix
from ..text import units
from ..text.errors import Fault, ModelError, UsageError
from ..text.json_number import Number, is_number
from ..text.printable import quoted
from ..text.quantity_text import quantity_of, read_quantity
from ..text.units import Declared, single
from .diagram_grammar import EDGES, NUMBER, QUANTITY, SHAPE

Known = Mapping[str, Value | None]
"""The parameters of a diagram by name; None where a fault was reported already."""

Unit = Declared
"""The unit of a parameter, or of each of its elements."""


class Column(dict[str, Any]):
    """A column of a CSV file as a file names it, {"csv": ..., "column": ..., "unit": ...}, with its numbers.

    Comparing and writing use the text of the file. key: the key of the numbers in a file that holds them itself. unit:
    the unit of the numbers: beside the column, else of the CSV file; "" for the unit of the parameter.
    """

    key = "value"

    def __init__(self, raw: Mapping[str, object], numbers: Sequence[Any], unit: str = "") -> None:
        super().__init__(raw)
        self.numbers, self.unit = tuple(numbers), str(raw.get("unit") or unit)

    @property
    def as_value(self) -> dict[str, object]:
        """Return the entry that replaces the column in a file that holds the numbers itself."""
        others = {key: self[key] for key in self if key not in ("csv", "column")}
        return {self.key: list(self.numbers), **others, **({"unit": self.unit} if self.unit else {})}


class EdgeTable(Column):
    """A CSV file of the edges of a matrix, {"csv": ..., "shape": ..., "unit": ...}, with them: [row, column, value]."""

    key = "edges"


class Absent(Exception):
    """Something is missing because of a fault that was reported already."""


def _refuse(message: str, cure: str = "", *, code: str = "E107") -> NoReturn:
    raise ModelError(Fault(code, "", message, cure))


def is_expression(raw: object) -> bool:
    """Whether a raw value is an expression ("==" begins an ordinary text)."""
    return isinstance(raw, str) and raw.startswith("=") and not raw.startswith("==")


def expressions_in(raw: Any) -> Iterator[str]:
    """The expressions in a raw value: it may be one, a quantity of one, or a list that holds some."""
    if isinstance(raw, Mapping):
        yield from expressions_in(raw.get("value"))
    elif isinstance(raw, (list, tuple)):
        for item in raw:
            yield from expressions_in(item)
    elif is_expression(raw):
        yield raw


def names_in(raw: object) -> list[str]:
    """The parameters that a raw value reads. An expression that cannot be read reads none."""
    names: dict[str, None] = {}
    for text in expressions_in(raw):
        with contextlib.suppress(ModelError):
            names |= dict.fromkeys(expressions.parse(text[1:]).names)
    return list(names)


def order_of(needs: Mapping[str, Sequence[str]]) -> list[str]:
    """Names in an order in which each comes after those that it needs; names that are no keys need nothing.

    Raises ModelError (E108) for a cycle, whose first name is the fault's place.
    """
    try:
        return [name for name in TopologicalSorter(needs).static_order() if name in needs]
    except CycleError as error:
        cycle = error.args[1][::-1]
        message = f"needs itself: {' -> '.join(cycle)}."
        raise ModelError(Fault("E108", cycle[0], message, "Give one of them a number.")) from None


def value_of(raw: object, declared: Unit, known: Known) -> Value:
    """What a raw value means, in SI.

    declared: the unit of bare numbers; for a vector it may be one for each element. known: the parameters that
    expressions may read. Raises ModelError (E104, E107, E108, E110, E114), and Absent where a parameter is missing
    because of a fault.
    """
    if isinstance(raw, EdgeTable):
        return _sparse({**raw, "unit": raw.unit}, raw.numbers, declared)
    if isinstance(raw, Mapping) and "edges" in raw:
        return _sparse(raw, raw["edges"], declared)
    if isinstance(raw, Column):
        if raw.unit:
            _check_unit("", raw.unit, declared)
        return _array(raw.numbers, raw.unit or declared, known)
    if isinstance(raw, Mapping):
        return _quantity(raw, declared, known)
    if isinstance(raw, (np.ndarray, np.generic)):
        raw = raw.tolist()
    if isinstance(raw, str):
        return _text(raw, declared, known)
    if isinstance(raw, (list, tuple)):
        return _array(raw, declared, known)
    if raw is None or isinstance(raw, bool):
        return Value(raw)
    return _number(raw, single(declared))


def in_si(raw: object, declared: Unit, place: str, *, is_difference: bool = False) -> Any:
    """Return a number, or a list of numbers, that a user gave for something with a declared unit, in SI.

    A plain number is in the declared unit. A quantity, {"value": 2, "unit": "rpm"} or "2 rpm", is in its own unit,
    which must be of the same quantity. What is no finite number comes back as it is. place: what an error names.
    is_difference: of an amplitude, say, for which an offset of the unit does not count. Raises UsageError (E501).
    """
    if isinstance(raw, (list, tuple, np.ndarray)) and np.ndim(raw):
        own = declared if isinstance(declared, tuple) and len(declared) == len(raw) else (declared,) * len(raw)
        each = zip(raw, own, strict=True)
        return [in_si(item, unit, place, is_difference=is_difference) for item, unit in each]
    raw = raw.item() if isinstance(raw, (np.ndarray, np.generic)) else float(raw) if isinstance(raw, Fraction) else raw
    if isinstance(raw, float) and not math.isfinite(raw):
        return raw
    try:
        raw = read_quantity(raw)
        if is_difference:
            declared = units.difference(single(declared))
            if isinstance(raw, Mapping) and isinstance(raw.get("unit"), str):
                raw = {**raw, "unit": units.difference(raw["unit"])}
        value = value_of(raw, declared, {}).value
    except ModelError as error:
        raise UsageError(*(Fault("E501", place, fault.message, fault.cure) for fault in error.faults)) from None
    return value if isinstance(value, (float, list)) else raw


def in_unit(raw: object, declared: str, place: str) -> Any:
    """Return a number that a user gave for something with a declared unit, in that unit.

    A plain number, and what is no number, comes back as it is. place: what an error names. Raises ModelError (E104,
    E114).
    """
    quantity = read_quantity(raw)
    value, unit = quantity_of(quantity)
    if not isinstance(quantity, Mapping) or not {*quantity} <= {"value", "unit", "doc"} or not is_number(value):
        return raw
    try:
        if not declared:
            return units.to_si(float(value), unit)
        if units.has_offset(unit) or units.has_offset(declared):
            return units.converted(float(value), unit, declared)
        exact, scale = units.scale_exact(unit, declared), units.scale(unit, declared)
    except ModelError as error:
        raise ModelError(*(replace(fault, place=place) for fault in error.faults)) from None
    return float(value) * scale if exact is None else float(exact_decimal(float(value)) * exact)


def _check_unit(what: str, unit: str, declared: Unit) -> None:
    for needed in dict.fromkeys((declared,) if isinstance(declared, str) else declared):
        if not units.same_quantity(unit, needed):
            message = f"{what}[{unit}] is given, but [{needed}] is needed: they are different quantities."
            cure = f"A number without a unit is in {needed}."
            if what:
                cure = f"Correct the unit of {what.strip()}, or use another parameter."
            if unit.lower() == needed.lower():
                cure = f"Did you mean [{needed}]? Upper and lower case are different units."
            _refuse(message, cure, code="E104")


def _quantity(raw: Mapping[str, object], declared: Unit, known: Known) -> Value:
    unit = raw.get("unit", "")
    odd = [key for key in raw if key not in QUANTITY.keys and not str(key).startswith("x-")]
    if "csv" in raw:
        cure = "Give the numbers, or name the file in the diagram."
        _refuse("a parameter cannot be set to a CSV file from outside the diagram.", cure)
    if odd or "value" not in raw or not isinstance(unit, str) or isinstance(raw["value"], Mapping):
        _refuse('a quantity must have the form {"value": ..., "unit": "..."}.')
    if unit:
        _check_unit("", unit, declared)
    value = value_of(raw["value"], unit or declared, known)
    if unit and not is_expression(raw["value"]) and (value.value is None or isinstance(value.value, (str, bool))):
        _refuse(f"{_kind(value.value)} cannot have the unit [{unit}].", "Only numbers have units.")
    return value


def _sparse(raw: Mapping[str, Any], edges: Sequence[Any], declared: Unit) -> Value:
    """A matrix by its edges. Its numbers are constants, so that they hold no expressions."""
    shape = raw.get("shape")
    if any(key not in EDGES.keys and not str(key).startswith("x-") for key in raw) or not SHAPE.fits(shape):
        _refuse('a sparse matrix must have the form {"edges": [[row, column, value], ...], "shape": [rows, columns]}.')
    if raw.get("unit"):
        _check_unit("", raw["unit"], declared)
    if any(not isinstance(edge, (list, tuple)) or len(edge) != 3 or not all(map(NUMBER.holds, edge)) for edge in edges):
        _refuse("an edge must be three numbers: a row and a column, which count from 0, and a value.")
    rows, columns = shape  # type: ignore[misc]
    matrix = SparseMatrix(np.array(edges, dtype=float).reshape(-1, 3), (int(rows), int(columns)))
    unit = single(raw.get("unit") or declared)
    if unit:
        matrix = matrix.scaled(np.array([units.to_si(value, unit) for value in matrix.values.tolist()]))
    return Value(matrix, None, units.si_text(unit))


def _text(raw: str, declared: Unit, known: Known) -> Value:
    if not is_expression(raw):
        return Value(raw[1:] if raw.startswith("==") else raw)
    expression, unit = expressions.parse(raw[1:]), single(declared)
    if expression.name is None or expression.name not in known:
        return _computed(expression, unit, known)
    value = known[expression.name]
    if value is None:
        raise Absent
    if value.unit:
        _check_unit(f"{expression.name} ", value.unit, declared)
    has_unit = unit and not (value.value is None or isinstance(value.value, (str, bool)))
    return replace(value, unit=units.si_text(unit)) if has_unit else value


def _computed(expression: Expression, unit: str, known: Known) -> Value:
    """An expression over parameters: a number in SI."""
    numbers: dict[str, Scalar] = {}
    if any(name not in known for name in expression.names):
        numbers = dict.fromkeys(known, Scalar(0.0))  # evaluate offers one of them
    for name in expression.names:
        if name not in known:
            continue  # evaluate says so
        value = known[name]
        if value is None:
            raise Absent
        if not _is_number(value.value):
            message = f"'{name}' is {_kind(value.value)}, not a number."
            _refuse(message, f'It can only be passed as a whole: "={name}".', code="E108")
        numbers[name] = Scalar(value.value, value.exact)
    scalar = expressions.evaluate(expression, numbers)
    return Value(scalar.value, scalar.exact, units.si_text(unit))


def _array(raw: Sequence[object], declared: Unit, known: Known) -> Value:
    """A list of numbers and expressions, or of bools, with one unit or one for each element."""
    if raw and all(isinstance(item, bool) for item in raw):
        return Value(list(raw))

    def element(item: object, unit: str) -> Any:
        if not unit and type(item) is Number:
            return float(item)
        if isinstance(item, (np.ndarray, np.generic)):
            item = item.tolist()
        if isinstance(item, (list, tuple)):
            return [element(part, unit) for part in item]
        value = value_of(item, unit, known).value
        if isinstance(value, str) and value in ("inf", "-inf"):
            _refuse(f"must hold finite numbers, not {value}.")
        if not _is_number(value):
            words = [word for word in raw if isinstance(word, str)]
            cure = f"For several names, write one text: {quoted(', '.join(words))}." if len(words) == len(raw) else ""
            _refuse(f"a list must hold numbers, not {_kind(value)}.", cure)
        return value

    if isinstance(declared, tuple) and len(set(declared)) > 1:
        if len(declared) != len(raw):
            _refuse(f"has {len(raw)} elements, but {len(declared)} are needed.", code="E110")
        return Value([element(item, unit) for item, unit in zip(raw, declared, strict=True)])
    unit = single(declared)
    return Value([element(item, unit) for item in raw], None, units.si_text(unit))


def _number(raw: object, unit: str) -> Value:
    if not isinstance(raw, (int, float)):
        _refuse(f"must be a number, a text, a list, true or false, not a {type(raw).__name__}.")
    try:
        number = float(raw)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        _refuse(f"must be a finite number, not {number}.")
    exact = raw.exact if isinstance(raw, Number) else exact_decimal(number)
    if not unit:
        return Value(number, exact)
    scale = units.parse(unit).exact
    si = units.to_si(number, unit, exact=exact)
    if not math.isfinite(si):
        _refuse(f"{number} {unit} overflows a double in SI units.")
    is_exact = scale is not None and not units.has_offset(unit)
    return Value(si, exact * scale if is_exact else None, units.si_text(unit))  # type: ignore[operator]


def _is_number(value: object) -> bool:
    return isinstance(value, float)


def _kind(value: object) -> str:
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    return "a list"
