"""The variables of a description: each by itself, and what belongs together: references, names, arrays, derivatives.

References: FMI 2.0.4, section 2.2.7; FMI 3.0.2, section 2.4.7.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from .definitions import Definitions
from .findings import Findings, quoted, real_number, shown, whole_number
from .model_description import Alias, Clock, ModelVariable, Value, variable_of
from .types import CALLS, FLOATS, INTEGERS, TYPES, limits_of
from .xmltree import Element

LARGEST_ARRAY = 10_000_000
"""Elements; 80 MB of doubles."""

_CAUSALITIES = {
    "parameter", "calculatedParameter", "structuralParameter", "input", "output", "local", "independent",
}  # fmt: skip
# How a variable gets its first value where the file does not say, for the combinations that the standards allow.
_INITIAL = {
    ("parameter", "fixed"): "exact", ("parameter", "tunable"): "exact",
    ("structuralParameter", "fixed"): "exact", ("structuralParameter", "tunable"): "exact",
    ("calculatedParameter", "fixed"): "calculated", ("calculatedParameter", "tunable"): "calculated",
    ("input", "discrete"): "exact", ("input", "continuous"): "exact",
    ("output", "constant"): "exact", ("output", "discrete"): "calculated", ("output", "continuous"): "calculated",
    ("local", "constant"): "exact", ("local", "fixed"): "calculated", ("local", "tunable"): "calculated",
    ("local", "discrete"): "calculated", ("local", "continuous"): "calculated",
    ("independent", "continuous"): "",
}  # fmt: skip
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}

# --- attributes that each element may have ----

_VARIABLE = {
    "name", "valueReference", "description", "causality", "variability", "initial",
    "canHandleMultipleSetPerTimeInstant",
}  # fmt: skip
_VALUE = {
    "declaredType", "quantity", "unit", "displayUnit", "relativeQuantity", "min", "max", "nominal", "unbounded",
    "start", "derivative", "reinit",
}  # fmt: skip
_VALUE_3 = _VARIABLE | _VALUE | {
    "clocks", "intermediateUpdate", "previous", "mimeType", "maxSize", "canBeDeactivated", "priority",
    "intervalVariability", "intervalDecimal", "shiftDecimal", "supportsFraction", "resolution", "intervalCounter",
    "shiftCounter",
}  # fmt: skip


class Variables:
    """The variables in the order of the file, and by name, as far as they are read."""

    def __init__(self, told: Findings, defined: Definitions) -> None:
        self.told, self.defined = told, defined
        self.fmi = told.fmi
        # Variability and initial by the attributes of a variable, for combinations without faults.
        self.plain: dict[tuple[str, str | None, str | None, str], tuple[str, str]] = {}
        self.listed: list[ModelVariable] = []
        self.by_name: dict[str, ModelVariable] = {}
        self.by_reference: dict[int, int] = {}  # FMI 3: where in `listed`
        self.aliases: dict[str, str] = {}

    def read(self, elements: Iterable[Element]) -> None:
        if self.fmi == 2:
            self.read_2(elements)
        else:
            self.read_3(elements)
        self.check_references()
        self.resolve()

    def at(self, text: str) -> ModelVariable | None:
        """The variable of an index (FMI 2, from 1) or of a reference (FMI 3)."""
        number = whole_number(text)
        if number is None:
            return None
        if self.fmi == 3:
            position = self.by_reference.get(number)
            return None if position is None else self.listed[position]
        return self.listed[number - 1] if 1 <= number <= len(self.listed) else None

    # --- variables ----

    def read_2(self, elements: Iterable[Element]) -> None:
        indices: list[tuple[int, int, int]] = []
        for tag, attributes, children, line in elements:
            value = children[0] if children and children[0][0] in TYPES[2] else None
            if value is None:
                value = next((child for child in children if child[0] in TYPES[2]), None)
            if tag != "ScalarVariable" or value is None:
                self.told.error(attributes.get("name", tag), "this variable has no type of FMI 2.", line)
                continue
            if not attributes.keys() <= _VARIABLE:
                self.told.strange(attributes, _VARIABLE, attributes.get("name", ""), line)
            if not value[1].keys() <= _VALUE:
                self.told.strange(value[1], _VALUE, attributes.get("name", ""), value[3])
            variable = self.variable(attributes, value[1], TYPES[2][value[0]], line)
            if "derivative" in value[1]:
                indices.append((len(self.listed), whole_number(value[1]["derivative"]) or 0, line))
            self.listed.append(variable)
        if self.told.faults:
            return
        for at, index, line in indices:
            name = self.listed[at].name
            if not 1 <= index <= len(self.listed):
                self.told.error(
                    name, f"derivative is not the index of a variable; the indices are 1 to {len(self.listed)}.", line
                )
            else:
                self.listed[at] = replace(self.listed[at], derivative_of=self.listed[index - 1].name)

    def read_3(self, elements: Iterable[Element]) -> None:
        links: list[tuple[int, Element]] = []
        for element in elements:
            tag, attributes, children, line = element
            type_ = TYPES[3].get(tag)
            if type_ is None:
                self.told.error(attributes.get("name", tag), f"{quoted(tag)} is not a type of FMI 3.", line)
                continue
            if not attributes.keys() <= _VALUE_3:
                self.told.strange(attributes, _VALUE_3, attributes.get("name", ""), line)
            variable = self.variable(attributes, attributes, type_, line, children)
            if children or "derivative" in attributes or "previous" in attributes or "clocks" in attributes:
                links.append((len(self.listed), element))
            self.listed.append(variable)
        for at, variable in enumerate(self.listed):
            self.by_reference.setdefault(variable.reference, at)
        for at, (_, attributes, children, line) in links:
            variable = self.listed[at]
            dimensions = tuple(self.dimension(child, variable) for child in children if child[0] == "Dimension")
            aliases = tuple(
                Alias(child[1].get("name", ""), child[1].get("description", ""), child[1].get("displayUnit", ""))
                for child in children
                if child[0] == "Alias"
            )
            clocks = attributes.get("clocks", "").split()
            self.listed[at] = replace(
                variable,
                derivative_of=self.linked(attributes, "derivative", variable.name, line),
                previous=self.linked(attributes, "previous", variable.name, line),
                clocks=tuple(self.linked({"clocks": text}, "clocks", variable.name, line) for text in clocks),
                dimensions=tuple(size for size, _ in dimensions),
                shape=tuple(size for _, size in dimensions),
                aliases=aliases,
            )

    def linked(self, attributes: Mapping[str, str], name: str, place: str, line: int) -> str:
        """The name of the variable that a reference in an attribute means; "" where there is no such attribute."""
        text = attributes.get(name)
        if text is None:
            return ""
        target = self.at(text)
        if target is None:
            self.told.error(place, f"{name} is {quoted(text)}, which is not the value reference of a variable.", line)
            return ""
        return target.name

    def dimension(self, element: Element, variable: ModelVariable) -> tuple[int | str, int]:
        """A size of an array as the file has it, and as a number, by start values."""
        _, attributes, _, line = element
        if "start" in attributes:
            size = whole_number(attributes["start"])
            if size is None or not 0 <= size <= LARGEST_ARRAY:
                self.told.error(variable.name, f"{quoted(attributes['start'])} is not a valid size of an array.", line)
                return 0, 0
            return size, size
        name = self.linked(attributes, "valueReference", variable.name, line)
        if not name:
            if "valueReference" not in attributes:
                self.told.error(variable.name, "one of its dimensions has no size.", line)
            return 0, 0
        held = self.at(attributes["valueReference"]) or variable
        held_size = held.start[0] if held.type in INTEGERS and len(held.start) == 1 else None
        if not isinstance(held_size, int) or not 0 <= held_size <= LARGEST_ARRAY:
            message = f"its size is {shown(held.name)}, which is not a whole number with a start value."
            self.told.error(variable.name, message, line)
            return name, 0
        if held.causality != "structuralParameter" and held.variability != "constant":
            message = "its size is a variable that is neither a structural parameter nor a constant."
            self.told.warn(variable.name, message, line)
        return name, held_size

    def variable(
        self,
        attributes: Mapping[str, str],
        values: Mapping[str, str],
        type_: str,
        line: int,
        children: Iterable[Element] = (),
    ) -> ModelVariable:
        """A variable without its links to others."""
        name, reference, causality = self.identity(attributes, line)
        variability, initial = self.variability_and_initial(attributes, name, type_, causality, line)
        low, high, nominal, unit, display, declared, quantity, relative, unbounded = self.traits(
            values, name, type_, line
        )
        get = values.get
        start = self.start(get("start"), name, type_, line, children)
        if not start and initial == "exact" and type_ != "Clock":
            self.told.warn(name, "its start value is missing; the FMU's own start value applies.", line)
        return variable_of(
            name,
            reference,
            type_,
            causality,
            variability,
            initial,
            start,
            low,
            high,
            nominal,
            unit,
            display,
            declared,
            attributes.get("description", ""),
            quantity,
            relative,
            unbounded,
            reinit="reinit" in values and self.told.boolean(values, "reinit", name, line),
            set_once="canHandleMultipleSetPerTimeInstant" in attributes
            and not self.told.boolean(attributes, "canHandleMultipleSetPerTimeInstant", name, line),
            intermediate="intermediateUpdate" in values and self.told.boolean(values, "intermediateUpdate", name, line),
            clock=self.clock(values, name, line) if type_ == "Clock" else None,
            mime=get("mimeType", ""),
            max_bytes=self.told.whole(values, "maxSize", name, line) if "maxSize" in values else None,
            line=line,
        )

    def identity(self, attributes: Mapping[str, str], line: int) -> tuple[str, int, str]:
        """Name, reference and causality of a variable."""
        name = attributes.get("name", "")
        if not name:
            self.told.error("", "this variable has no name.", line)
        reference = whole_number(attributes.get("valueReference", ""))
        if reference is None or not 0 <= reference < 2**32:
            self.told.error(name, "valueReference is missing, or not a whole number of 32 bits.", line)
            reference = 0
        causality = attributes.get("causality", "local")
        if causality not in _CAUSALITIES or (self.fmi == 2 and causality == "structuralParameter"):
            self.told.error(name, f"the causality {quoted(causality)} does not exist in FMI {self.fmi}.", line)
            causality = "local"
        return name, reference, causality

    def variability_and_initial(
        self, attributes: Mapping[str, str], name: str, type_: str, causality: str, line: int
    ) -> tuple[str, str]:
        """Variability and initial of a variable."""
        said = causality, attributes.get("variability"), attributes.get("initial"), type_
        if said in self.plain:
            variability, initial = self.plain[said]
        else:
            count = self.told.count
            variability = self.variability(said[1], name, type_, causality, line)
            initial = self.initial(said[2], name, type_, causality, variability, line)
            if count == self.told.count:
                self.plain[said] = variability, initial
        return variability, initial

    def traits(
        self, values: Mapping[str, str], name: str, type_: str, line: int
    ) -> tuple[float | None, float | None, float | None, str, str, str, str, bool, bool]:
        """Bounds, nominal value, unit, displayed unit, declared type, quantity, whether it is relative, and unbounded.

        What the variable leaves out is taken from its declared type.
        """
        get = values.get
        declared = get("declaredType", "")
        inherited = self.defined.types.get(declared)
        if declared and inherited is None:
            self.told.warn(name, f"the type {quoted(declared)} is not defined.", line)
        elif inherited is not None and inherited.type != type_:
            message = f"the type {quoted(declared)} is for variables of type {inherited.type}, and is ignored."
            self.told.warn(name, message, line)
            inherited = None
        unit, display, quantity = get("unit", ""), get("displayUnit", ""), get("quantity", "")
        low = self.told.real(values, "min", name, line) if "min" in values else None
        high = self.told.real(values, "max", name, line) if "max" in values else None
        nominal = self.told.real(values, "nominal", name, line) if "nominal" in values else None
        relative = "relativeQuantity" in values and self.told.boolean(values, "relativeQuantity", name, line)
        unbounded = "unbounded" in values and self.told.boolean(values, "unbounded", name, line)
        if inherited is not None:
            unit, display = unit or inherited.unit, display or inherited.display
            quantity = quantity or inherited.quantity
            low = inherited.low if low is None else low
            high = inherited.high if high is None else high
            nominal = inherited.nominal if nominal is None else nominal
            relative = relative or ("relativeQuantity" not in values and inherited.relative)
            unbounded = unbounded or ("unbounded" not in values and inherited.unbounded)
        if unit and unit not in self.defined.units:
            self.defined.unit(unit, name, line)
        if nominal is not None and nominal <= 0:
            self.told.warn(name, "nominal is not above 0; blocks uses its absolute value, or 1 if it is 0.", line)
            nominal = abs(nominal) or None
        return low, high, nominal, unit, display, declared, quantity, relative, unbounded

    def variability(self, text: str | None, name: str, type_: str, causality: str, line: int) -> str:
        is_parameter = causality in ("parameter", "calculatedParameter", "structuralParameter")
        if text is None:
            if self.fmi == 3 and is_parameter:
                return "fixed"
            text = "continuous" if self.fmi == 2 or type_ in FLOATS else "discrete"
        elif text not in ("constant", "fixed", "tunable", "discrete", "continuous"):
            self.told.error(name, f"the variability {quoted(text)} does not exist.", line)
        if text == "continuous" and is_parameter:
            self.told.warn(name, "a parameter cannot be continuous; blocks treats it as fixed.", line)
            return "fixed"
        if text == "continuous" and type_ not in FLOATS:
            self.told.warn(name, f"the type {type_} cannot be continuous; blocks treats it as discrete.", line)
            return "discrete"
        return text

    def initial(self, text: str | None, name: str, type_: str, causality: str, variability: str, line: int) -> str:
        """How the variable gets its first value."""
        default = _INITIAL.get((causality, variability))
        if default is None:
            self.told.warn(name, f"a variable with causality {causality} cannot have variability {variability}.", line)
            default = "exact" if causality in ("parameter", "structuralParameter", "input") else "calculated"
        if type_ == "Clock":
            return ""
        if text is None:
            return default
        if text not in ("exact", "approx", "calculated"):
            self.told.error(name, f"initial must be exact, approx or calculated, not {quoted(text)}.", line)
            return default
        if causality in ("input", "independent") and text != default:
            message = f"a variable with causality {causality} cannot have the attribute initial; it is ignored."
            self.told.warn(name, message, line)
            return default
        return text

    def start(
        self, text: str | None, name: str, type_: str, line: int, children: Iterable[Element]
    ) -> tuple[Value, ...]:
        """The start values; () where there are none."""
        if type_ in ("String", "Binary"):
            texts = [text] if text is not None else []
            if self.fmi == 3:
                texts += [child[1].get("value", "") for child in children if child[0] == "Start"]
            if type_ == "String":
                return tuple(texts)
            try:
                return tuple(bytes.fromhex(digits) for digits in texts)
            except ValueError:
                self.told.error(name, "its start value is not hexadecimal.", line)
                return ()
        if text is None or type_ == "Clock":
            return ()
        if type_ in FLOATS:
            single = real_number(text)
            values: list[Value | None] = (
                [single] if single is not None else [real_number(word) for word in text.split()]
            )
        elif type_ == "Boolean":
            values = [_BOOLEANS.get(word) for word in text.lower().split()]
        else:
            low, high = limits_of(type_, self.fmi)
            numbers = [whole_number(word) for word in text.split()]
            values = [number if number is not None and low <= number <= high else None for number in numbers]
        if not values or (self.fmi == 2 and len(values) != 1) or None in values:
            what = "start has no value" if not text.strip() else f"the start value {quoted(text)} is not"
            self.told.error(name, f"{what} of type {type_}.", line)
            return ()
        return tuple(value for value in values if value is not None)

    def clock(self, values: Mapping[str, str], name: str, line: int) -> Clock:
        interval = values.get("intervalVariability", "")
        if interval not in ("constant", "fixed", "tunable", "changing", "countdown", "triggered"):
            self.told.warn(name, "intervalVariability is missing, or is not a value that FMI defines.", line)
        return Clock(
            interval,
            self.told.boolean(values, "canBeDeactivated", name, line),
            self.told.whole(values, "priority", name, line),
            self.told.real(values, "intervalDecimal", name, line),
            self.told.real(values, "shiftDecimal", name, line) or 0.0,
            self.told.boolean(values, "supportsFraction", name, line),
            self.told.whole(values, "resolution", name, line),
            self.told.whole(values, "intervalCounter", name, line),
            self.told.whole(values, "shiftCounter", name, line) or 0,
        )

    # --- what belongs together ----

    def check_references(self) -> None:
        """One variable for each reference in FMI 3; in FMI 2, those of one call and one reference are aliases."""
        seen: dict[tuple[str, int], ModelVariable] = {}
        leading: dict[tuple[str, int], ModelVariable] = {}
        shared: list[tuple[tuple[str, int], ModelVariable]] = []
        calls = CALLS if self.fmi == 2 else {}
        for variable in self.listed:
            key = (calls.get(variable.type, ""), variable.reference)
            first = seen.setdefault(key, variable)
            if first is variable:
                continue
            place, line = variable.name, variable.line
            other = f"{shown(first.name)} (line {first.line})"
            if first.type != variable.type or first.shape != variable.shape:
                message = f"{other} has the same reference {variable.reference}, but another type or size."
                self.told.error(place, message, line)
            elif self.fmi == 3:
                self.told.warn(place, f"{other} has the same reference; blocks treats the two as one variable.", line)
            lead = leading.get(key, first)
            if _is_settable(variable) and not _is_settable(lead):
                leading[key] = variable
            elif _is_settable(variable) and variable.name != lead.name:
                self.told.warn(place, f"{shown(lead.name)} is the same value, and both can be set.", line)
            shared.append((key, variable))
        for key, variable in shared:
            lead = leading.get(key, seen[key])
            for alias in (variable, seen[key]):
                if alias.name != lead.name:
                    self.aliases[alias.name] = lead.name

    def resolve(self) -> None:
        """Maps names to variables; checks arrays, and derivatives for circles."""
        for variable in self.listed:
            first = self.by_name.setdefault(variable.name, variable)
            if first is not variable:
                same = first.reference == variable.reference and first.type == variable.type
                tell = self.told.warn if same else self.told.error
                tell(variable.name, f"the name appears twice, first in line {first.line}.", variable.line)
            if variable.shape or len(variable.start) > 1:
                self.check_array(variable)
        for variable in self.listed:
            for alias in variable.aliases:
                if not alias.name:
                    self.told.warn(variable.name, "it has an alias without a name.", variable.line)
                elif alias.name in self.by_name:
                    what = "the variable itself" if alias.name == variable.name else "another variable"
                    message = f"its alias {shown(alias.name)} is also the name of {what}."
                    self.told.error(variable.name, message, variable.line)
                else:
                    self.by_name[alias.name] = variable
                    self.aliases[alias.name] = self.aliases.get(variable.name, variable.name)
        settled: set[str] = set()
        for variable in self.listed:
            chain: dict[str, None] = {}
            at = variable
            while at.derivative_of and at.name not in settled and at.name not in chain:
                chain[at.name] = None
                at = self.by_name.get(at.derivative_of, at)
                if at.derivative_of and at.name in chain:
                    names = list(chain)
                    circle = [*names[names.index(at.name) :][:8], at.name]
                    message = f"derivatives form a circle: {' -> '.join(map(shown, circle))}."
                    self.told.error(at.name, message, at.line)
            settled.update(chain)
            if variable.derivative_of:
                state = self.by_name.get(variable.derivative_of, variable)
                if variable.type not in FLOATS or state.type not in FLOATS or state.shape != variable.shape:
                    message = f"it is the derivative of {shown(state.name)}, but their types or sizes do not match."
                    self.told.error(variable.name, message, variable.line)

    def check_array(self, variable: ModelVariable) -> None:
        size = math.prod(variable.shape)
        if size > LARGEST_ARRAY:
            message = f"the array has {size:,} elements; the limit is {LARGEST_ARRAY:,}."
            self.told.error(variable.name, message, variable.line)
        elif len(variable.start) > 1 and len(variable.start) != size:
            message = f"it has {len(variable.start):,} start values for {size:,} elements."
            self.told.error(variable.name, message, variable.line)


def _is_settable(variable: ModelVariable) -> bool:
    return variable.causality in ("input", "parameter", "structuralParameter") or (
        variable.initial in ("exact", "approx") and variable.variability != "constant"
    )
