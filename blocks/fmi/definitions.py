"""The units and types that a description defines; variables refer to them by name."""

from __future__ import annotations

from collections.abc import Iterable

from ..text import units
from . import quantities
from .findings import Findings, quoted
from .model_description import Display, Type, UnitDefinition
from .types import TYPES
from .xmltree import Element

ATTRIBUTES = {
    "name", "description", "quantity", "unit", "displayUnit", "relativeQuantity", "min", "max", "nominal", "unbounded",
    "mimeType", "maxSize", "canBeDeactivated", "priority", "intervalVariability", "intervalDecimal", "shiftDecimal",
    "supportsFraction", "resolution", "intervalCounter", "shiftCounter",
}  # fmt: skip
"""Of a type."""


class Definitions:
    """Units and types by name, as far as they are read."""

    def __init__(self, told: Findings) -> None:
        self.told = told
        self.units: dict[str, UnitDefinition] = {}
        self.types: dict[str, Type] = {}

    def read_units(self, elements: Iterable[Element]) -> None:
        for tag, attributes, children, line in elements:
            name = attributes.get("name", "")
            if tag != "Unit" or not name:
                message = f"the element {quoted(tag)} is not a unit with a name, and is ignored."
                self.told.warn("UnitDefinitions", message, line)
                continue
            exponents, factor, offset = None, 1.0, 0.0
            displays = []
            for kind, values, _, below in children:
                if kind == "BaseUnit":
                    exponents = tuple(self.told.whole(values, base, name, below) or 0 for base in units.BASE)
                    self.told.strange(values, {*units.BASE, "factor", "offset"}, name, below)
                    factor = self.told.real(values, "factor", name, below) or 1.0
                    offset = self.told.real(values, "offset", name, below) or 0.0
                elif kind == "DisplayUnit" and values.get("name"):
                    displays.append(
                        Display(
                            values["name"],
                            self.told.real(values, "factor", name, below) or 1.0,
                            self.told.real(values, "offset", name, below) or 0.0,
                            self.told.boolean(values, "inverse", name, below),
                        )
                    )
            text, si, agree = quantities.spelled(name, exponents, factor, offset)
            if not agree:
                message = "its base units are not those of the unit with this name; blocks uses the base units."
                self.told.warn(name, message, line)
            unit = UnitDefinition(name, text, si, factor, offset, exponents, tuple(displays))
            if name in self.units:
                what = "equally" if self.units[name] == unit else "differently; blocks uses the first definition"
                self.told.warn(name, f"this unit is defined twice, {what}.", line)
            self.units.setdefault(name, unit)

    def unit(self, name: str, place: str, line: int) -> str:
        """The name of a unit; one that is not defined is added, with nothing known but its name."""
        if name and name not in self.units:
            text, si, _ = quantities.spelled(name, None, 1.0, 0.0)
            factor = units.parse(text).factor if text else 1.0
            self.units[name] = UnitDefinition(name, text, si, factor)
            self.told.warn(place, f"the unit {quoted(name)} is not defined.", line)
        return name

    def read_types(self, elements: Iterable[Element]) -> None:
        for tag, attributes, children, line in elements:
            name = attributes.get("name", "")
            inner = attributes
            if self.told.fmi == 2:
                if tag != "SimpleType" or not children:
                    self.told.warn(name or "TypeDefinitions", "this type has no definition, and is ignored.", line)
                    continue
                kind, inner, children, _ = children[0]
                type_ = TYPES[2].get(kind)
            else:
                type_ = TYPES[3].get(tag.removesuffix("Type")) if tag.endswith("Type") else None
            if type_ is None or not name:
                self.told.warn(name or "TypeDefinitions", "this is not a type of FMI, and is ignored.", line)
                continue
            self.told.strange(inner, ATTRIBUTES, name, line)
            members = []
            for item, values, _, below in children:
                if item == "Item":
                    value = self.told.whole(values, "value", name, below)
                    if value is None or not values.get("name"):
                        self.told.warn(name, "a member of the enumeration has no name or no value.", below)
                    else:
                        members.append((values["name"], value))
            if len({value for _, value in members}) < len(members):
                self.told.warn(name, "two members of the enumeration have the same value.", line)
            if name in self.types:
                self.told.warn(name, "this type is defined twice; blocks uses the first definition.", line)
                continue
            self.types[name] = Type(
                name,
                type_,
                doc=attributes.get("description", ""),
                quantity=inner.get("quantity", ""),
                unit=self.unit(inner.get("unit", ""), name, line),
                display=inner.get("displayUnit", ""),
                relative=self.told.boolean(inner, "relativeQuantity", name, line),
                unbounded=self.told.boolean(inner, "unbounded", name, line),
                low=self.told.real(inner, "min", name, line),
                high=self.told.real(inner, "max", name, line),
                nominal=self.told.real(inner, "nominal", name, line),
                members=tuple(members),
            )
