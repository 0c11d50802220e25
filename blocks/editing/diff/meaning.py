"""Raw values: whether two mean the same, and how one is shown."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ...contract import expressions
from ...contract.expressions import exact_decimal
from ...model.values import Column, EdgeTable, Unit, is_expression
from ...text import units
from ...text.errors import ModelError
from ...text.json_number import Number
from ...text.printable import quoted

QUANTITY = ("value", "unit", "doc")
LONGEST = 60  # characters of a value that are shown
MOST_SHOWN = 6  # elements of a list that are shown


# --- what a value means ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Quantity:
    """A number in SI. exact: its exact value, where known. dimension: of its unit; None where no unit is known."""

    value: float
    exact: Fraction | None
    dimension: object

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Quantity) or self.dimension != other.dimension:
            return False
        if self.exact is not None and other.exact is not None:
            return self.exact == other.exact
        return self.value == other.value

    __hash__ = None  # type: ignore[assignment]  # equal numbers may have different exact values


def same(a: object, b: object, declared: Unit = "", declared_b: Unit | None = None) -> bool:
    """Whether two raw values mean the same, if bare numbers are in a declared unit ("" where it is not known)."""
    return bool(_meaning(a, declared) == _meaning(b, declared if declared_b is None else declared_b))


def same_unit(a: object, b: object) -> bool:
    """Whether two units are the same, however they are spelled: N.m and m.N."""
    if a == b or not (isinstance(a, str) and isinstance(b, str) and a and b):
        return bool(a == b)
    try:
        unit_a, unit_b = units.parse(a), units.parse(b)
    except ModelError:
        return False
    return (unit_a.dimension, unit_a.factor, unit_a.offset) == (unit_b.dimension, unit_b.factor, unit_b.offset)


def is_quantity(raw: object) -> bool:
    """Whether a raw value is {"value": ..., "unit": ...}."""
    return isinstance(raw, Mapping) and "value" in raw and all(key in QUANTITY or key[:2] == "x-" for key in raw)


def _meaning(raw: Any, declared: Unit = "") -> object:
    """Quantities for numbers, tuples for lists, dicts for objects, and texts, bools and null as they are."""
    match raw:
        case EdgeTable():
            return _meaning(raw.as_value)
        case Column():
            unit = raw.unit or declared
            return tuple(_number(number, unit) for number in raw.numbers)
        case Mapping() if is_quantity(raw):
            return _meaning(raw["value"], _text(raw.get("unit")) or declared)
        case Mapping():
            return {key: _meaning(value) for key, value in raw.items() if key != "doc" and not key.startswith("x-")}
        case str() if is_expression(raw):
            return _expression(raw, declared)
        case list() | tuple():
            each = declared if isinstance(declared, tuple) and len(declared) == len(raw) else (declared,) * len(raw)
            return tuple(_meaning(item, unit) for item, unit in zip(raw, each, strict=True))
        case None | bool() | str():
            return raw
        case int() | float():
            return _number(raw, declared)
        case _:
            return repr(raw)


def _text(raw: object) -> str:
    return raw if isinstance(raw, str) else ""


def _single(unit: Unit) -> str:
    if isinstance(unit, str):
        return unit
    return unit[0] if unit and len(set(unit)) == 1 else ""


def _number(raw: float, declared: Unit) -> _Quantity:
    value, unit = float(raw), _single(declared)
    try:
        exact = raw.exact if isinstance(raw, Number) else exact_decimal(value)
    except (ValueError, OverflowError):  # inf and nan of a diagram made in Python
        return _Quantity(value, None, repr(value))
    if not unit:
        return _Quantity(value, exact, None)
    try:
        read = units.parse(unit)
    except ModelError:
        return _Quantity(value, exact, unit)
    scaled = None if read.exact is None or read.offset else exact * read.exact
    return _Quantity(units.to_si(value, unit, exact=exact), scaled, read.dimension)


def _expression(raw: str, declared: Unit) -> object:
    """The steps of an expression; its number in SI where it reads no parameter."""
    try:
        expression = expressions.parse(raw[1:])
        if not expression.names:
            number, unit = expressions.evaluate(expression, {}), _single(declared)
            dimension = units.parse(unit).dimension if unit else None
            return _Quantity(number.value, number.exact, dimension)
    except ModelError:
        return raw
    steps = []
    for step in expression.steps:
        scalar = step.scalar and _Quantity(step.scalar.value, step.scalar.exact, None)
        steps.append(("=", step.word if scalar is None else "", step.operands, scalar))
    return tuple(steps)


def digest_of(raw: object) -> str:
    """A text that is the same for values that mean the same, as far as that is known without declared units."""
    return hashlib.sha256(repr(_canonical(_meaning(raw))).encode("utf-8", "backslashreplace")).hexdigest()


def _canonical(meaning: object) -> object:
    match meaning:
        case _Quantity():
            return ("number", meaning.value + 0.0, meaning.dimension)
        case tuple():
            return tuple(_canonical(item) for item in meaning)
        case dict():
            return {key: _canonical(meaning[key]) for key in sorted(meaning)}
        case _:
            return (type(meaning).__name__, meaning)


# --- how a value is shown --------------------------------------------------------------------------------------


def clean(text: str, most: int = LONGEST) -> str:
    """A text on one line, without control characters, of at most `most` characters."""
    line = "".join(c if c.isprintable() else _escape(c) for c in text[: most + 1])
    return line if len(line) <= most else line[: most - 1] + "…"


def _escape(character: str) -> str:
    code = ord(character)
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def legible_value(raw: Any, declared: Unit = "") -> str:
    """A raw value as a file has it, shortened: 0.10 V, "+-", =kp, [1, 0.2, 1]; a bare number with its declared unit."""
    match raw:
        case {"shape": [rows, columns]} if isinstance(raw.get("edges", []), (list, tuple)):
            given = f"of {quoted(str(raw['csv']))}" if "csv" in raw else f"of {len(raw.get('edges', ())):,} edges"
            return clean(f"{rows} x {columns} matrix {given}")
        case Column() | {"csv": _}:
            unit = _text(raw.get("unit")) or _single(declared)
            return _with_unit(f"column {quoted(str(raw.get('column')))} of {quoted(str(raw.get('csv')))}", unit)
        case Mapping() if is_quantity(raw):
            return legible_value(raw["value"], _text(raw.get("unit")) or declared)
        case Mapping():
            inside = ", ".join(f"{clean(str(key))}: {legible_value(item)}" for key, item in list(raw.items())[:20])
            return clean(f"{{{inside}}}")
        case str() if is_expression(raw):
            return clean(raw)
        case str():
            return quoted(raw)
        case None | bool():
            return {None: "null", True: "true", False: "false"}[raw]
        case list() | tuple():
            items = [legible_value(item) for item in raw[:MOST_SHOWN]]
            more = f", … {len(raw)} elements" if len(raw) > MOST_SHOWN else ""
            return _with_unit(clean(f"[{', '.join(items)}{more}]"), _single(declared))
        case float() | int():
            return _with_unit(clean(f"{raw!r}"), _single(declared))
        case _:
            return clean(str(raw))


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {clean(unit)}".rstrip()


def parts_that_differ(
    a: object, b: object, declared: Unit = "", declared_b: Unit = ""
) -> tuple[str, object, object, str]:
    """Return where two long lists of one length differ: the first element, "[17]", its values, a note on the others."""
    elements_a, elements_b = _elements(a, declared), _elements(b, declared_b)
    count = len(elements_a)
    if count <= MOST_SHOWN or count != len(elements_b):
        return "", a, b, ""
    pairs = enumerate(zip(elements_a, elements_b, strict=True))
    apart = [i for i, ((x, unit_x), (y, unit_y)) in pairs if not same(x, y, unit_x, unit_y)]
    if not apart:
        return "", a, b, ""

    def wrapped(item: object, unit: str) -> object:
        return {"value": item, "unit": unit} if unit and not isinstance(item, Mapping) else item

    first = apart[0]
    note = f" (and {len(apart) - 1} more of {count} elements)" if len(apart) > 1 else ""
    return f"[{first}]", wrapped(*elements_a[first]), wrapped(*elements_b[first]), note


def _elements(raw: Any, declared: Unit) -> list[tuple[Any, str]]:
    """Return the elements of a list with their units."""
    if is_quantity(raw):
        raw, declared = raw["value"], _text(raw.get("unit")) or declared
    if not isinstance(raw, (list, tuple)):
        return []
    each = declared if isinstance(declared, tuple) and len(declared) == len(raw) else (_single(declared),) * len(raw)
    return [*zip(raw, each, strict=True)]
