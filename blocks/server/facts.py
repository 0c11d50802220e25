"""What can be turned: the parameters and inputs of a diagram, as a page shows them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..api.diagram import Diagram
from ..compile.bindings import bindings
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..compile.setting_programs import Setting
from ..contract.enumerations import enumeration_of
from ..model.diagram import DiagramValue
from ..model.values import expressions_in
from ..text.json_number import Number
from ..text.units import to_si

__all__ = ["Fact", "facts_of", "text_of"]


@dataclass(frozen=True, slots=True)
class Fact:
    """A parameter by its path, or an input of the diagram by its name.

    raw: what the file says; None where it says nothing, so that a default counts. nominal: the value that it gives, in
    `unit`: that of the file's entry, else the declared one. declared: the unit of a bare number. low, high: the
    declared range in `unit`; is_open: 0 itself is excluded below. why: why it cannot change in a run, "" where it can;
    is_bound: nor before one, as an expression of the file gives it.
    """

    name: str
    raw: Any
    nominal: Any
    unit: str
    declared: str
    type: str
    low: float | None = None
    high: float | None = None
    is_open: bool = False
    choices: tuple[str, ...] = ()
    why: str = ""
    is_bound: bool = False
    is_input: bool = False

    @property
    def text(self) -> str:
        """The value as the file says it, or as its default is."""
        return "" if self.said is None else text_of(self.said, self.declared)

    def told(self, raw: Any) -> dict[str, Any]:
        """It as a page gets it. raw: what the session has set; None: nothing."""
        value = self.nominal if raw is None else self.number(raw)
        low, high, is_log = self.span(value)
        return {
            "name": self.name, "text": self.text if raw is None else text_of(raw, self.declared), "was": self.text,
            "changed": raw is not None, "value": value, "unit": self.unit, "type": self.type, "low": low, "high": high,
            "log": is_log, "choices": list(self.choices), "tunable": not self.why, "why": self.why,
            "bound": self.is_bound, "input": self.is_input,
        }  # fmt: skip

    def number(self, raw: Any) -> Any:
        """A raw value in `unit`; None where it is an expression or a table."""
        unit, value = self.declared, raw
        if isinstance(raw, Mapping):
            unit, value = str(raw.get("unit", unit)), raw.get("value")
        if value is None or (isinstance(value, str) and value.startswith("=")):
            return None
        return value if unit == self.unit else _in_unit(_mapped(value, lambda x: to_si(x, unit)), self.unit)

    def bare(self, raw: Mapping[str, Any]) -> Any:
        """A quantity as a bare number in the declared unit."""
        unit, value = str(raw.get("unit", self.declared)), raw["value"]
        return value if unit == self.declared else _in_unit(_mapped(value, lambda x: to_si(x, unit)), self.declared)

    @property
    def said(self) -> Any:
        """The value of the file or the default, as a run is given it; None where there is none."""
        return self.quantity(self.nominal) if self.raw is None else self.raw

    def quantity(self, value: Any) -> Any:
        """A raw value of numbers in `unit`."""
        is_numeric = self.type in ("real", "int") and not isinstance(value, (str, bool, Mapping))
        return {"value": value, "unit": self.unit} if is_numeric and self.unit != self.declared else value

    def span(self, value: Any) -> tuple[float | None, float | None, bool]:
        """The range of a slider, and whether it is logarithmic: the declared one, or one around the value."""
        if self.type not in ("real", "int") or isinstance(value, (bool, str)) or not isinstance(value, (int, float)):
            return None, None, False
        if self.low is not None and self.high is not None and not self.is_open:
            return self.low, self.high, False
        if self.is_open and value > 0.0:
            return value / 10, min(value * 10, math.inf if self.high is None else self.high), True
        low, high = sorted((0.0, 2 * value)) if value else (-1.0, 1.0)
        if self.type == "int":
            low, high = math.floor(low), math.ceil(high)
        low = low if self.low is None else max(low, self.low)
        return low, high if self.high is None else min(high, self.high), False


def facts_of(diagram: Diagram, planned: Plan | Coupling | None) -> dict[str, Fact]:
    """All that can be turned of a diagram, its variants chosen, by path. planned: None where it has faults: nothing."""
    if planned is None:
        return {}
    value, flat = diagram.value, diagram.flatten()
    facts = {fact.name: fact for fact in _inputs(value, planned)}
    declarations = {block.path: block.interface for block in flat.blocks}
    for setting in bindings(value, flat, planned if isinstance(planned, Plan) else None):
        owner, _, name = setting.path.rpartition(".")
        choices: Sequence[str] = [*setting.members]
        interface = declarations.get(owner)
        if interface is not None and name in interface.declaration.parameters:
            choices = choices or interface.declaration.parameters[name].choices
        facts[setting.path] = _fact(setting, _entry(value, setting.path), tuple(choices))
    return facts


def _fact(setting: Setting, raw: Any, choices: tuple[str, ...]) -> Fact:
    declared = setting.display or setting.unit
    unit = str(raw.get("unit", declared)) if isinstance(raw, Mapping) else declared
    if setting.type == "text":
        return Fact(setting.path, raw, setting.values[0], "", "", "text", choices=choices, why=setting.why)
    values: Any = setting.values
    nested = _nested([_in_unit(x, unit) for x in values], setting.shape)
    if setting.type == "bool":
        nested = _mapped(nested, bool)
    known = raw.get("value") if isinstance(raw, Mapping) else raw
    if not setting.shape and unit == declared and isinstance(known, Number):
        nested = float(known)  # without the rounding of SI
    why = setting.why
    is_bound = any(expressions_in(raw))
    if is_bound:
        why = f"it is computed: {text_of(raw)}"
    low, high = (None if x is None else _in_unit(x, unit) for x in (setting.low, setting.high))
    return Fact(
        setting.path, raw, nested, unit, declared, setting.type, low, high, setting.low_open, choices, why, is_bound
    )


def _inputs(value: DiagramValue, planned: Plan | Coupling) -> Iterator[Fact]:
    for name, _, unit, type_, _ in planned.inputs:
        raw = value.run.get("inputs", {}).get(name, value.inputs[name].get("default"))
        enumeration = enumeration_of(type_)
        members = () if enumeration is None else tuple(enumeration.members)
        kind = "enum" if members else str(type_)
        shown = str(raw.get("unit", unit)) if isinstance(raw, Mapping) else unit
        fact = Fact(name, raw, None, shown, unit, kind, choices=members, is_input=True)
        yield replace(fact, nominal=fact.number(raw))


def _entry(value: DiagramValue, path: str) -> Any:
    """What a file says of a parameter; None where it says nothing."""
    *blocks, name = path.split(".")
    given: Mapping[str, Any] = {}
    inside: DiagramValue | None = value
    for block in blocks:
        entry = inside.blocks[block] if inside is not None else None
        given, inside = ({}, None) if entry is None else (entry.parameters, entry.inner)
    return given[name] if name in given else inside.parameters.get(name) if inside is not None else None


def _in_unit(value: Any, unit: str) -> Any:
    """Numbers in SI in another unit, rounded as far as the change of units makes digits."""
    scale = to_si(1.0, unit) if unit else 1.0
    return value if scale == 1.0 else _mapped(value, lambda x: float(f"{x / scale:.14g}"))


def _mapped(value: Any, function: Any) -> Any:
    return [_mapped(item, function) for item in value] if isinstance(value, (list, tuple)) else function(value)


def _nested(values: list[Any], shape: tuple[int, ...]) -> Any:
    if not shape:
        return values[0]
    size = len(values) // shape[0] if shape[0] else 0
    return [_nested(values[k * size : (k + 1) * size], shape[1:]) for k in range(shape[0])]


def text_of(raw: Any, unit: str = "") -> str:
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
