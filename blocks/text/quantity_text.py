"""Values as people write them: `2 mH`, `-0.5 1/s`, `[1, 2]`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from .errors import ModelError
from .json_number import Number, spelled

DECIMAL = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_number = re.compile(DECIMAL).match


class Quantity(NamedTuple):
    """A raw value of a file, and the unit that it is in."""

    value: Any
    unit: str


def quantity_of(raw: object, unit: str = "") -> Quantity:
    """Return the value and the unit of {"value": 2, "unit": "mH"}, or of a bare value, which is in `unit`."""
    return Quantity(raw.get("value"), str(raw.get("unit", unit))) if isinstance(raw, Mapping) else Quantity(raw, unit)


def quantity_in(text: str) -> tuple[Number, str] | None:
    """The number and the unit ("" where there is none) of a text; None where it does not begin with a number.

    The unit is not looked at. Raises ModelError (E004) for a number out of the range of a double.
    """
    text = text.strip()
    match = _number(text)
    unit = text[match.end() :].strip() if match else "\n"
    return (Number(spelled(match[0])), unit) if match and "\n" not in unit else None


def read_quantity(raw: object) -> Any:
    """A text such as "2 mH" as the quantity of a file, {"value": 2, "unit": "mH"}; any other value as it is."""
    found = quantity_in(raw) if isinstance(raw, str) else None
    is_quantity = found is not None and found[1] and found[1][0] != ","
    return {"value": found[0], "unit": found[1]} if found and is_quantity else raw


def in_a_file(raw: Any) -> str:
    """Return the advice to write a text such as "2 mH" as a file takes it; "" if it is no number with a unit."""
    try:
        found = read_quantity(raw)
    except ModelError:
        return ""
    if found is raw or len(raw) > 100:
        return ""
    return f'Write {{"value": {found["value"]!r}, "unit": {json.dumps(found["unit"], ensure_ascii=False)}}}.'


def value_in(text: str, *, file: str = "--set") -> Any:
    """A typed value: a number, a number with a unit, true, false, a JSON list, or a text.

    file: what errors of a list name. Raises ModelError (E0xx).
    """
    if found := quantity_in(text):
        number, unit = found
        return {"value": number, "unit": unit} if unit else number
    if text in ("true", "false"):
        return text == "true"
    if text.startswith("["):
        from .json_text import read

        return read(text, file=file).value
    return text
