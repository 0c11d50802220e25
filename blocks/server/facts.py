"""What can be turned: the parameters and inputs of a diagram, as a page shows them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..api.diagram import Diagram
from ..compile.bindings import bindings_of
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..compile.setting_programs import Setting
from ..contract.enumerations import enumeration_of
from ..model.copies import without_numbers
from ..model.diagram_value import DiagramValue
from ..model.values import expressions_in
from ..text.json_number import Number
from ..text.quantity_text import quantity_of
from ..text.units import converted, same_quantity


@dataclass(frozen=True, slots=True)
class Fact:
    """A parameter by its path, or an input of the diagram by its name.

    unit: the declared one, of all numbers here. raw: what the file says; None where it says nothing, so that a default
    counts. nominal: the value that it gives. low, high: the declared range; is_open: 0 itself is excluded below. why:
    why it cannot change in a run, "" where it can; is_bound: nor before one, as an expression of the file gives it.
    """

    name: str
    raw: Any
    nominal: Any
    unit: str
    type: str
    low: float | None = None
    high: float | None = None
    is_open: bool = False
    choices: tuple[str, ...] = ()
    why: str = ""
    is_bound: bool = False
    is_input: bool = False

    @property
    def said(self) -> Any:
        """The value of the file or the default, as a run is given it; None where there is none."""
        return self.nominal if self.raw is None else self.raw

    @property
    def was(self) -> str:
        """The value of the file or the default, as a person types it."""
        return self.text(self.said)

    def told(self, raw: object) -> dict[str, Any]:
        """It as a page gets it. raw: what the session has set; None: nothing."""
        value = self.nominal if raw is None else self.number(raw)
        low, high, is_log = self.span(value)
        return {
            "name": self.name, "text": self.was if raw is None else self.text(raw), "was": self.was,
            "changed": raw is not None, "value": value, "unit": self.unit, "type": self.type, "low": low, "high": high,
            "log": is_log, "choices": list(self.choices), "why": self.why, "bound": self.is_bound,
            "range": self.range,
        }  # fmt: skip

    @property
    def range(self) -> str:
        """The declared range in `unit`, as a person reads it."""
        if self.low is not None and self.high is not None and not self.is_open:
            return f"{self.low:g} to {self.high:g}"
        low = "" if self.low is None else f"{'>' if self.is_open else '>='} {self.low:g}"
        return ", ".join(filter(None, (low, "" if self.high is None else f"<= {self.high:g}")))

    def text(self, raw: object) -> str:
        """A raw value as a person types it, in `unit`."""
        value = self.number(raw) if quantity_of(raw, self.unit).unit != self.unit else None
        return "" if raw is None else text_of(raw if value is None else value, self.unit)

    def number(self, raw: object) -> Any:
        """The number, or the list of them, of a raw value; None where it is an expression, a table, or does not fit."""
        value, unit = quantity_of(raw, self.unit)
        is_known = value is not None and not any(expressions_in(value)) and same_quantity(unit, self.unit)
        return _in_unit(value, unit, self.unit) if is_known else None

    def span(self, value: object) -> tuple[float | None, float | None, bool]:
        """The range of a slider, and whether it is logarithmic: the declared one, or one around the value."""
        if self.type not in ("real", "int") or isinstance(value, (bool, str)) or not isinstance(value, (int, float)):
            return None, None, False
        least, most = -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high
        if not self.is_open and math.isfinite(most - least):
            return least, most, False
        if self.is_open and value > 0.0:
            return value / 10, min(value * 10, most), True
        low, high = sorted((0.0, 2 * value)) if value else (-1.0, 1.0)
        if self.type == "int":
            low, high = math.floor(low), math.ceil(high)
        return max(low, least), min(high, most), False


def facts_of(
    diagram: Diagram, planned: Plan | Coupling | None, values: Mapping[str, object] | None = None
) -> dict[str, Fact]:
    """All that can be turned of a diagram, its variants chosen, by path. planned: None where it has faults: nothing.

    values: of parameters by path, from which others are computed; of these only what they give counts.
    """
    if planned is None:
        return {}
    value, flat = diagram.value, diagram.flatten(parameters=values)
    facts = {fact.name: fact for fact in _inputs(value, planned)}
    declarations = {block.path: block.interface.declaration.parameters for block in flat.blocks}
    copied: dict[str, list[Fact]] = {}
    replaced = set(map(_plain, values or ()))
    bound = bindings_of(flat, planned if isinstance(planned, Plan) and not values else None)
    for setting, origin in zip(bound.settings, bound.origins, strict=True):
        owner, _, own_name = setting.path.rpartition(".")
        parameter = declarations.get(owner, {}).get(own_name)
        choices = tuple(setting.members) or (() if parameter is None else tuple(parameter.choices))
        name = _plain(setting.path)
        is_default = origin is None or origin.set_at or (name != setting.path and name in replaced)
        facts[setting.path] = fact = _fact(setting, None if origin is None or is_default else origin.raw, choices)
        if name != setting.path:
            one = copied.setdefault(name, [])
            if not one:
                facts[name] = replace(fact, name=name, raw=None if origin is None else origin.written)
            one.append(fact)
    return facts | {name: _of_all(facts[name], each) for name, each in copied.items()}


def _of_all(first: Fact, each: list[Fact]) -> Fact:
    """The parameter of all copies: their one value, or the values in their order where these differ.

    first: that of the first copy, with what the file says of all.
    """
    values = [fact.nominal for fact in each]
    is_bound = any(expressions_in(first.raw))
    why = f"it is computed: {text_of(first.raw)}" if is_bound else first.why
    is_one = all(value == values[0] for value in values)
    return replace(first, nominal=values[0] if is_one else values, why=why, is_bound=is_bound)


def _fact(setting: Setting, raw: object, choices: tuple[str, ...]) -> Fact:
    if setting.type == "text":
        return Fact(setting.path, raw, setting.values[0], "", "text", choices=choices, why=setting.why)
    unit = setting.display or setting.unit
    nominal = np.array(setting.values, bool if setting.type == "bool" else float).reshape(setting.shape).tolist()
    nominal = _in_unit(nominal, setting.unit, unit)
    known, own = quantity_of(raw, unit)
    if own == unit and isinstance(known, Number) and not setting.shape:
        nominal = float(known)  # without the rounding of SI
    is_bound = any(expressions_in(raw))
    why = f"it is computed: {text_of(raw)}" if is_bound else setting.why
    low, high = (None if x is None else _in_unit(x, setting.unit, unit) for x in (setting.low, setting.high))
    return Fact(setting.path, raw, nominal, unit, setting.type, low, high, setting.low_open, choices, why, is_bound)


def _inputs(value: DiagramValue, planned: Plan | Coupling) -> Iterator[Fact]:
    for name, _, unit, type_, _ in planned.inputs:
        raw = value.run.get("inputs", {}).get(name, value.inputs[name].get("default"))
        enumeration = enumeration_of(type_)
        members = () if enumeration is None else tuple(enumeration.members)
        fact = Fact(name, raw, None, unit, "enum" if members else str(type_), choices=members, is_input=True)
        yield replace(fact, nominal=fact.number(raw))


def _plain(path: str) -> str:
    """A path without the numbers of copies: it means all of them."""
    return without_numbers(path)[0].replace("[]", "")


def _in_unit(value: object, unit: str, to: str) -> Any:
    """A number, or a list of them, in another unit, rounded as far as that makes digits."""
    if unit == to:
        return value
    return np.vectorize(lambda x: float(f"{converted(x, unit, to):.14g}"), [float])(value).tolist()


def text_of(raw: object, unit: str = "") -> str:
    """A raw value as a person types it. unit: of a bare number."""
    if isinstance(raw, Mapping):
        return text_of(raw["value"], str(raw.get("unit", unit))) if "value" in raw else json.dumps(raw)
    if isinstance(raw, (list, tuple)):
        return f"[{', '.join(map(text_of, raw))}]" + (f" {unit}" if unit else "")
    if isinstance(raw, bool):
        return "true" if raw else "false"
    if isinstance(raw, str):
        return raw
    number = raw.text if isinstance(raw, Number) else repr(raw).removesuffix(".0")
    return f"{number} {unit}".rstrip()
