"""modelDescription.xml of FMI 2.0 and 3.0 -> Description; lenient, since many files break what nothing hangs on.

    read_description("x.fmu"), parse(text, "x.fmu/modelDescription.xml")

What does not matter is a warning (W201) and is mended: an attribute that does not exist, another order, a missing
initial unknown, an output that is not listed (it depends on all). What makes the FMU unusable is an error, and all of
them are told at once: no token, one reference for two variables, an index or a reference that leads nowhere,
derivatives in a circle, a value of the wrong kind. Both versions stand in one module, because they share most rules.

References: FMI 2.0.4, section 2.2; FMI 3.0.2, sections 2.4, 3.3, 4.3.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from ..text.errors import Fault, FMUError
from ..text.gc_pause import paused
from . import xmltree
from .archive import DESCRIPTION, Archive
from .definitions import TYPES, Definitions
from .findings import Findings, quoted, real_number, shown, whole_number
from .schema import (
    CALLS,
    FLOATS,
    INTEGERS,
    Alias,
    Category,
    Clock,
    Description,
    Experiment,
    Interface,
    Structure,
    Unknown,
    Value,
    Variable,
    variable_of,
)
from .xmltree import Element

__all__ = ["parse", "read_description", "remembered"]

LARGEST_ARRAY = 10_000_000
"""Elements; 80 MB of doubles."""

_CAUSALITIES = {
    "parameter", "calculatedParameter", "structuralParameter", "input", "output", "local", "independent",
}  # fmt: skip
# How a variable gets its first value where the file does not say, of the combinations that the standards allow.
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
_KINDS = {"dependent", "constant", "fixed", "tunable", "discrete"}
_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
_INTERFACES = {"ModelExchange": "ME", "CoSimulation": "CS", "ScheduledExecution": "SE"}
_ORDER = (
    *_INTERFACES, "UnitDefinitions", "TypeDefinitions", "LogCategories", "DefaultExperiment", "VendorAnnotations",
    "ModelVariables", "ModelStructure", "Annotations",
)  # fmt: skip

# --- attributes that each element may have ----

_ROOT = {
    "fmiVersion", "modelName", "guid", "instantiationToken", "description", "author", "version", "copyright", "license",
    "generationTool", "generationDateAndTime", "variableNamingConvention", "numberOfEventIndicators",
}  # fmt: skip
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
_INTERFACE = {
    "modelIdentifier", "needsExecutionTool", "completedIntegratorStepNotNeeded", "canBeInstantiatedOnlyOncePerProcess",
    "canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate", "canSerializeFMUstate", "canGetAndSetFMUState",
    "canSerializeFMUState", "providesDirectionalDerivative", "providesDirectionalDerivatives",
    "providesAdjointDerivatives", "providesPerElementDependencies", "needsCompletedIntegratorStep",
    "providesEvaluateDiscreteStates", "canHandleVariableCommunicationStepSize", "fixedInternalStepSize",
    "canInterpolateInputs", "maxOutputDerivativeOrder", "recommendedIntermediateInputSmoothness",
    "providesIntermediateUpdate", "mightReturnEarlyFromDoStep", "canReturnEarlyAfterIntermediateUpdate",
    "hasEventMode", "canRunAsynchronuously",
}  # fmt: skip
_UNKNOWN = {"index", "valueReference", "dependencies", "dependenciesKind"}


def read_description(path: str | os.PathLike[str]) -> Description:
    """The description in an FMU; nothing is unpacked, and no code of the FMU runs.

    Raises:
        ModelError: E007 where the file cannot be read.
        FMUError: E202, E203 as Archive; E204, E205, E206 as `parse`.
    """
    with Archive(path) as archive:
        return remembered(archive.read(DESCRIPTION), f"{Path(path).name}/{DESCRIPTION}")


def remembered(text: bytes, file: str) -> Description:
    """As `parse`, once for each text: a large one takes seconds, and a diagram and its run ask for the same one."""
    key = hashlib.sha256(text).digest(), file
    known = _remembered.get(key)
    if known is None:
        known = parse(text, file)
        with _lock:
            if len(_remembered) >= REMEMBERED:
                del _remembered[next(iter(_remembered))]
            _remembered[key] = known
    return known


REMEMBERED = 64
"""Descriptions that are remembered."""
_remembered: dict[tuple[bytes, str], Description] = {}
_lock = threading.Lock()


@paused()
def parse(text: bytes, file: str = DESCRIPTION) -> Description:
    """The description of a text; `file` is its name in messages.

    Raises:
        FMUError: E204 where the text is not XML or no description, E205 for another version of FMI, E206 where it
            contradicts itself or leaves out what a run needs, with a fault for each place.
    """
    root = xmltree.parse(text, file)
    tag, attributes, _, line = root
    if tag != "fmiModelDescription":
        message = f"the root element is {quoted(tag)}, not fmiModelDescription."
        raise FMUError(Fault("E204", "", message, "Export the model again.").at(file, line, 1))
    return _Reader(file, _fmi(attributes, file, line)).description(root)


def _fmi(attributes: Mapping[str, str], file: str, line: int) -> int:
    """2 or 3. Raises FMUError (E205)."""
    version = attributes.get("fmiVersion", "").strip()
    if version.startswith("2."):
        return 2
    if version.startswith("3."):
        return 3
    if version.startswith("1."):
        message, cure = "FMI 1.0 is not supported.", "Export the model as FMI 2.0 or 3.0."
    elif version:
        message, cure = f"FMI {quoted(version)} is not supported.", "This release reads FMI 2.0 and 3.0."
    else:
        message, cure = "the file does not say which version of FMI it is written in.", "Export the model again."
    raise FMUError(Fault("E205", "", message, cure).at(file, line, 1))


class _Reader:
    """One pass over the tree of a file; gathers faults and warnings on the way."""

    def __init__(self, file: str, fmi: int) -> None:
        self.fmi = fmi
        self.told = Findings(file, fmi)
        self.defined = Definitions(self.told)
        # Variability and initial by what a variable says, of combinations with which nothing is wrong.
        self.plain: dict[tuple[str, str | None, str | None, str], tuple[str, str]] = {}
        self.variables: list[Variable] = []
        self.by_name: dict[str, Variable] = {}
        self.by_reference: dict[int, int] = {}  # FMI 3: where in variables
        self.aliases: dict[str, str] = {}

    # --- the whole ----

    def description(self, root: Element) -> Description:
        _, attributes, children, line = root
        sections = self.sections(children)
        self.told.strange(attributes, _ROOT, "", line)
        version = attributes["fmiVersion"].strip()
        if not re.fullmatch(r"2\.0|3\.\d+(\.\d+)?", version):
            self.told.warn("", f"FMI {quoted(version)} is no published version; it is read as FMI {self.fmi}.0.", line)
        token_name = "guid" if self.fmi == 2 else "instantiationToken"
        token = attributes.get(token_name)
        if token is None:
            self.told.error("", f"{token_name} is missing, without which an FMU refuses to start.", line)
        elif not token:
            self.told.warn("", f"{token_name} is empty.", line)

        interfaces = tuple(self.interface(one) for tag in _INTERFACES for one in sections.get(tag, ()))
        if not interfaces:
            cure = "It may be a file of FMI 1.0, or none for exchange; export the model again."
            self.told.error("", "there is neither ModelExchange nor CoSimulation: nothing to run.", line, cure)
        self.defined.read_units(_children(sections, "UnitDefinitions"))
        self.defined.read_types(_children(sections, "TypeDefinitions"))
        if "ModelVariables" not in sections:
            self.told.warn("", "there are no variables.", line)
        elements = _children(sections, "ModelVariables")
        if self.fmi == 2:
            self.read_variables_2(elements)
        else:
            self.read_variables_3(elements)
        self.check_references()
        self.resolve()
        has_me = any(one.kind == "ME" for one in interfaces)
        structure = self.structure(_children(sections, "ModelStructure"), has_me, line)
        indicators = sum(math.prod(one.variable.shape) for one in structure.indicators)
        if self.fmi == 2:
            indicators = max(self.told.whole(attributes, "numberOfEventIndicators", "", line) or 0, 0)
        if self.told.faults:
            raise FMUError(*self.told.faults)
        return Description(
            fmi=self.fmi,
            version=version,
            name=attributes.get("modelName") or interfaces[0].identifier,
            token=token or "",
            interfaces=interfaces,
            variables=tuple(self.variables),
            structure=structure,
            names=MappingProxyType(self.by_name),
            aliases=MappingProxyType(self.aliases),
            units=MappingProxyType(self.defined.units),
            types=MappingProxyType(self.defined.types),
            experiment=self.experiment(sections.get("DefaultExperiment", ())),
            indicators=indicators,
            categories=tuple(
                Category(values.get("name", ""), values.get("description", ""))
                for tag, values, _, _ in _children(sections, "LogCategories")
                if tag == "Category"
            ),
            doc=attributes.get("description", ""),
            author=attributes.get("author", ""),
            model_version=attributes.get("version", ""),
            copyright=attributes.get("copyright", ""),
            license=attributes.get("license", ""),
            tool=attributes.get("generationTool", ""),
            date=attributes.get("generationDateAndTime", ""),
            convention=attributes.get("variableNamingConvention", "flat"),
            warnings=tuple(self.told.warnings()),
        )

    def sections(self, children: Iterable[Element]) -> dict[str, list[Element]]:
        """The elements below the root by tag."""
        found: dict[str, list[Element]] = {}
        last = 0
        for child in children:
            tag, line = child[0], child[3]
            if tag not in _ORDER:
                self.told.warn("", f"the element {quoted(tag)} is not one of FMI {self.fmi}, and is ignored.", line)
                continue
            at = _ORDER.index(tag)
            if at < last:
                self.told.warn("", f"{tag} stands behind {_ORDER[last]}; the standard has another order.", line)
            if tag in found:
                self.told.warn("", f"{tag} stands twice.", line)
            last = max(at, last)
            found.setdefault(tag, []).append(child)
        return found

    def experiment(self, elements: Iterable[Element]) -> Experiment:
        for _, attributes, _, line in elements:
            self.told.strange(attributes, {"startTime", "stopTime", "tolerance", "stepSize"}, "DefaultExperiment", line)
            values = (
                self.told.real(attributes, name, "DefaultExperiment", line)
                for name in ("startTime", "stopTime", "tolerance", "stepSize")
            )
            return Experiment(*values)
        return Experiment()

    def interface(self, element: Element) -> Interface:
        tag, attributes, children, line = element
        self.told.strange(attributes, _INTERFACE, tag, line)
        identifier = attributes.get("modelIdentifier", "")
        if not identifier:
            self.told.error(tag, "modelIdentifier is missing, which names the binary.", line)
        elif identifier in (".", "..") or len(identifier) > 200 or re.search(r"[/\\\x00-\x1f]", identifier):
            self.told.error(tag, "modelIdentifier is no name of a file.", line)
        elif not re.fullmatch(r"[A-Za-z_]\w*", identifier, re.ASCII):
            self.told.warn(tag, "modelIdentifier is no identifier of C.", line)

        def flag(*names: str) -> bool:
            return any(self.told.boolean(attributes, name, tag, line) for name in names)

        def count(name: str) -> int:
            return max(self.told.whole(attributes, name, tag, line) or 0, 0)

        step = self.told.real(attributes, "fixedInternalStepSize", tag, line)
        return Interface(
            kind=_INTERFACES[tag],
            identifier=identifier,
            needs_tool=flag("needsExecutionTool"),
            once_per_process=flag("canBeInstantiatedOnlyOncePerProcess"),
            own_memory=flag("canNotUseMemoryManagementFunctions"),
            saves=flag("canGetAndSetFMUstate", "canGetAndSetFMUState"),
            serializes=flag("canSerializeFMUstate", "canSerializeFMUState"),
            directional=flag("providesDirectionalDerivative", "providesDirectionalDerivatives"),
            adjoint=flag("providesAdjointDerivatives"),
            per_element=flag("providesPerElementDependencies"),
            completed_step=(
                flag("needsCompletedIntegratorStep")
                if self.fmi == 3
                else tag == "ModelExchange" and not flag("completedIntegratorStepNotNeeded")
            ),
            evaluates_discrete_states=flag("providesEvaluateDiscreteStates"),
            any_step=flag("canHandleVariableCommunicationStepSize"),
            fixed_step=step if step is not None and step > 0 else None,
            input_derivatives=flag("canInterpolateInputs"),
            output_order=count("maxOutputDerivativeOrder"),
            smoothness=self.told.whole(attributes, "recommendedIntermediateInputSmoothness", tag, line) or 0,
            intermediate_update=flag("providesIntermediateUpdate"),
            early_return=flag("mightReturnEarlyFromDoStep"),
            early_return_after_update=flag("canReturnEarlyAfterIntermediateUpdate"),
            event_mode=flag("hasEventMode"),
            asynchronous=flag("canRunAsynchronuously"),
            sources=tuple(
                file[1]["name"]
                for child in children
                if child[0] == "SourceFiles"
                for file in child[2]
                if file[0] == "File" and file[1].get("name")
            ),
        )

    # --- variables ----

    def read_variables_2(self, elements: Iterable[Element]) -> None:
        indices: list[tuple[int, int, int]] = []
        for tag, attributes, children, line in elements:
            value = children[0] if children and children[0][0] in TYPES[2] else None
            if value is None:
                value = next((child for child in children if child[0] in TYPES[2]), None)
            if tag != "ScalarVariable" or value is None:
                self.told.error(attributes.get("name", tag), "a variable without a type of FMI 2.", line)
                continue
            if not attributes.keys() <= _VARIABLE:
                self.told.strange(attributes, _VARIABLE, attributes.get("name", ""), line)
            if not value[1].keys() <= _VALUE:
                self.told.strange(value[1], _VALUE, attributes.get("name", ""), value[3])
            variable = self.variable(attributes, value[1], TYPES[2][value[0]], line)
            if "derivative" in value[1]:
                indices.append((len(self.variables), whole_number(value[1]["derivative"]) or 0, line))
            self.variables.append(variable)
        if self.told.faults:
            return
        for at, index, line in indices:
            name = self.variables[at].name
            if not 1 <= index <= len(self.variables):
                self.told.error(
                    name, f"derivative is no index of a variable; there are 1 ... {len(self.variables)}.", line
                )
            else:
                self.variables[at] = replace(self.variables[at], derivative_of=self.variables[index - 1].name)

    def read_variables_3(self, elements: Iterable[Element]) -> None:
        links: list[tuple[int, Element]] = []
        for element in elements:
            tag, attributes, children, line = element
            type_ = TYPES[3].get(tag)
            if type_ is None:
                self.told.error(attributes.get("name", tag), f"{quoted(tag)} is no type of FMI 3.", line)
                continue
            if not attributes.keys() <= _VALUE_3:
                self.told.strange(attributes, _VALUE_3, attributes.get("name", ""), line)
            variable = self.variable(attributes, attributes, type_, line, children)
            if children or "derivative" in attributes or "previous" in attributes or "clocks" in attributes:
                links.append((len(self.variables), element))
            self.variables.append(variable)
        for at, variable in enumerate(self.variables):
            self.by_reference.setdefault(variable.reference, at)
        for at, (_, attributes, children, line) in links:
            variable = self.variables[at]
            dimensions = tuple(self.dimension(one, variable) for one in children if one[0] == "Dimension")
            aliases = tuple(
                Alias(one[1].get("name", ""), one[1].get("description", ""), one[1].get("displayUnit", ""))
                for one in children
                if one[0] == "Alias"
            )
            clocks = attributes.get("clocks", "").split()
            self.variables[at] = replace(
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
        found = self.at(text)
        if found is None:
            self.told.error(place, f"{name} holds {quoted(text)}, which is no reference of a variable.", line)
            return ""
        return found.name

    def dimension(self, element: Element, variable: Variable) -> tuple[int | str, int]:
        """A size of an array as the file has it, and with start values put in."""
        _, attributes, _, line = element
        if "start" in attributes:
            size = whole_number(attributes["start"])
            if size is None or not 0 <= size <= LARGEST_ARRAY:
                self.told.error(variable.name, f"{quoted(attributes['start'])} is no size of an array.", line)
                return 0, 0
            return size, size
        name = self.linked(attributes, "valueReference", variable.name, line)
        if not name:
            if "valueReference" not in attributes:
                self.told.error(variable.name, "a dimension without a size.", line)
            return 0, 0
        held = self.at(attributes["valueReference"]) or variable
        held_size = held.start[0] if held.type in INTEGERS and len(held.start) == 1 else None
        if not isinstance(held_size, int) or not 0 <= held_size <= LARGEST_ARRAY:
            message = f"its size is {shown(held.name)}, which is no whole number with a start value."
            self.told.error(variable.name, message, line)
            return name, 0
        if held.causality != "structuralParameter" and held.variability != "constant":
            self.told.warn(variable.name, "its size is a variable that is neither structural nor constant.", line)
        return name, held_size

    def variable(
        self,
        attributes: Mapping[str, str],
        values: Mapping[str, str],
        type_: str,
        line: int,
        children: Iterable[Element] = (),
    ) -> Variable:
        """A variable without its links to others."""
        get = values.get
        name = attributes.get("name", "")
        if not name:
            self.told.error("", "a variable without a name.", line)
        reference = whole_number(attributes.get("valueReference", ""))
        if reference is None or not 0 <= reference < 2**32:
            self.told.error(name, "valueReference is missing, or no whole number of 32 bits.", line)
            reference = 0
        causality = attributes.get("causality", "local")
        if causality not in _CAUSALITIES or (self.fmi == 2 and causality == "structuralParameter"):
            self.told.error(name, f"the causality {quoted(causality)} does not exist in FMI {self.fmi}.", line)
            causality = "local"
        said = causality, attributes.get("variability"), attributes.get("initial"), type_
        if said in self.plain:
            variability, initial = self.plain[said]
        else:
            count = self.told.count
            variability = self.variability(said[1], name, type_, causality, line)
            initial = self.initial(said[2], name, type_, causality, variability, line)
            if count == self.told.count:
                self.plain[said] = variability, initial
        declared = get("declaredType", "")
        inherited = self.defined.types.get(declared)
        if declared and inherited is None:
            self.told.warn(name, f"the type {quoted(declared)} is not defined.", line)
        elif inherited is not None and inherited.type != type_:
            self.told.warn(name, f"the type {quoted(declared)} is one of {inherited.type}, and is ignored.", line)
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
            self.told.warn(name, "nominal is not above 0; its absolute value counts, and 0 counts as 1.", line)
            nominal = abs(nominal) or None
        start = self.start(get("start"), name, type_, line, children)
        if not start and initial == "exact" and type_ != "Clock":
            self.told.warn(name, "a start value is missing; what the FMU itself begins with counts.", line)
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

    def variability(self, text: str | None, name: str, type_: str, causality: str, line: int) -> str:
        is_parameter = causality in ("parameter", "calculatedParameter", "structuralParameter")
        if text is None:
            if self.fmi == 3 and is_parameter:
                return "fixed"
            text = "continuous" if self.fmi == 2 or type_ in FLOATS else "discrete"
        elif text not in ("constant", "fixed", "tunable", "discrete", "continuous"):
            self.told.error(name, f"the variability {quoted(text)} does not exist.", line)
        if text == "continuous" and is_parameter:
            self.told.warn(name, "a parameter is not continuous; it counts as fixed.", line)
            return "fixed"
        if text == "continuous" and type_ not in FLOATS:
            self.told.warn(name, f"a variable of type {type_} is not continuous; it counts as discrete.", line)
            return "discrete"
        return text

    def initial(self, text: str | None, name: str, type_: str, causality: str, variability: str, line: int) -> str:
        """How the variable gets its first value."""
        default = _INITIAL.get((causality, variability))
        if default is None:
            self.told.warn(name, f"a variable with causality {causality} is not {variability}.", line)
            default = "exact" if causality in ("parameter", "structuralParameter", "input") else "calculated"
        if type_ == "Clock":
            return ""
        if text is None:
            return default
        if text not in ("exact", "approx", "calculated"):
            self.told.error(name, f"initial is {quoted(text)}: neither exact, approx nor calculated.", line)
            return default
        if causality in ("input", "independent") and text != default:
            self.told.warn(name, f"an {causality} variable has no attribute initial; it is ignored.", line)
            return default
        return text

    def start(
        self, text: str | None, name: str, type_: str, line: int, children: Iterable[Element]
    ) -> tuple[Value, ...]:
        """The start values; () where there are none."""
        if type_ in ("String", "Binary"):
            texts = [text] if text is not None else []
            if self.fmi == 3:
                texts += [one[1].get("value", "") for one in children if one[0] == "Start"]
            if type_ == "String":
                return tuple(texts)
            try:
                return tuple(bytes.fromhex(one) for one in texts)
            except ValueError:
                self.told.error(name, "a start value is not hexadecimal.", line)
                return ()
        if text is None or type_ == "Clock":
            return ()
        if type_ in FLOATS:
            single = real_number(text)
            values: list[Value | None] = [single] if single is not None else [real_number(one) for one in text.split()]
        elif type_ == "Boolean":
            values = [_BOOLEANS.get(one) for one in text.lower().split()]
        else:
            low, high = INTEGERS.get(type_, INTEGERS["Int32" if self.fmi == 2 else "Int64"])
            found = [whole_number(one) for one in text.split()]
            values = [one if one is not None and low <= one <= high else None for one in found]
        if not values or (self.fmi == 2 and len(values) != 1) or None in values:
            what = "start has no value" if not text.strip() else f"the start value {quoted(text)} is none"
            self.told.error(name, f"{what} of type {type_}.", line)
            return ()
        return tuple(value for value in values if value is not None)

    def clock(self, values: Mapping[str, str], name: str, line: int) -> Clock:
        interval = values.get("intervalVariability", "")
        if interval not in ("constant", "fixed", "tunable", "changing", "countdown", "triggered"):
            self.told.warn(name, "intervalVariability is missing, or does not exist.", line)
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
        """One variable for each reference in FMI 3; in FMI 2, all of one call that have the same one are aliases."""
        seen: dict[tuple[str, int], Variable] = {}
        leading: dict[tuple[str, int], Variable] = {}
        shared: list[tuple[tuple[str, int], Variable]] = []
        calls = CALLS if self.fmi == 2 else {}
        for variable in self.variables:
            key = (calls.get(variable.type, ""), variable.reference)
            first = seen.setdefault(key, variable)
            if first is variable:
                continue
            place, line = variable.name, variable.line
            other = f"{shown(first.name)} (line {first.line})"
            if first.type != variable.type or first.shape != variable.shape:
                message = f"the reference {variable.reference} is that of {other} too, which has another type or size."
                self.told.error(place, message, line)
            elif self.fmi == 3:
                self.told.warn(
                    place, f"one reference for two variables, the other is {other}; they count as one.", line
                )
            lead = leading.get(key, first)
            if _is_settable(variable) and not _is_settable(lead):
                leading[key] = variable
            elif _is_settable(variable) and variable.name != lead.name:
                self.told.warn(place, f"it can be set, and so can {shown(lead.name)}, which is the same value.", line)
            shared.append((key, variable))
        for key, variable in shared:
            lead = leading.get(key, seen[key])
            for one in (variable, seen[key]):
                if one.name != lead.name:
                    self.aliases[one.name] = lead.name

    def resolve(self) -> None:
        """Names to variables; arrays; circles of derivatives."""
        for variable in self.variables:
            first = self.by_name.setdefault(variable.name, variable)
            if first is not variable:
                same = first.reference == variable.reference and first.type == variable.type
                tell = self.told.warn if same else self.told.error
                tell(variable.name, f"the name stands twice, first in line {first.line}.", variable.line)
            if variable.shape or len(variable.start) > 1:
                self.check_array(variable)
        for variable in self.variables:
            for alias in variable.aliases:
                if not alias.name:
                    self.told.warn(variable.name, "an alias without a name.", variable.line)
                elif alias.name in self.by_name:
                    what = "the variable itself" if alias.name == variable.name else "another variable, too"
                    message = f"its alias {shown(alias.name)} is the name of {what}."
                    self.told.error(variable.name, message, variable.line)
                else:
                    self.by_name[alias.name] = variable
                    self.aliases[alias.name] = self.aliases.get(variable.name, variable.name)
        settled: set[str] = set()
        for variable in self.variables:
            chain: dict[str, None] = {}
            at = variable
            while at.derivative_of and at.name not in settled and at.name not in chain:
                chain[at.name] = None
                at = self.by_name.get(at.derivative_of, at)
                if at.derivative_of and at.name in chain:
                    names = list(chain)
                    circle = [*names[names.index(at.name) :][:8], at.name]
                    self.told.error(at.name, f"derivatives in a circle: {' -> '.join(map(shown, circle))}.", at.line)
            settled.update(chain)
            if variable.derivative_of:
                state = self.by_name.get(variable.derivative_of, variable)
                if variable.type not in FLOATS or state.type not in FLOATS or state.shape != variable.shape:
                    message = f"the derivative of {shown(state.name)}, which has another type or size."
                    self.told.error(variable.name, message, variable.line)

    def check_array(self, variable: Variable) -> None:
        size = math.prod(variable.shape)
        if size > LARGEST_ARRAY:
            message = f"an array of {size:,} elements; the limit is {LARGEST_ARRAY:,}."
            self.told.error(variable.name, message, variable.line)
        elif len(variable.start) > 1 and len(variable.start) != size:
            message = f"{len(variable.start):,} start values for {size:,} elements."
            self.told.error(variable.name, message, variable.line)

    # --- structure ----

    def structure(self, elements: Iterable[Element], has_me: bool, line: int) -> Structure:
        if self.told.faults:
            return Structure()
        lists: dict[str, list[Unknown]] = {name: [] for name in ("out", "der", "clocked", "initial", "indicator")}
        names = {
            "Outputs": "out", "Derivatives": "der", "InitialUnknowns": "initial", "Output": "out",
            "ContinuousStateDerivative": "der", "ClockedState": "clocked", "InitialUnknown": "initial",
            "EventIndicator": "indicator", "DiscreteStates": "",
        }  # fmt: skip
        for element in elements:
            tag, _, children, at = element
            key = names.get(tag)
            if key is None or (self.fmi == 2) != tag.endswith("s"):
                self.told.warn("ModelStructure", f"{quoted(tag)} is not one of FMI {self.fmi}, and is ignored.", at)
            elif key:
                seen = lists[key]
                known = {one.variable.name for one in seen} if self.fmi == 2 else None
                for one in children if self.fmi == 2 else (element,):
                    unknown = self.unknown(one, key)
                    if unknown is not None and known is not None:
                        if unknown.variable.name in known:
                            self.told.warn(unknown.variable.name, f"it stands twice in {tag}.", one[3])
                            continue
                        known.add(unknown.variable.name)
                    if unknown is not None:
                        seen.append(unknown)
        derivatives = tuple(self.derivatives(lists["der"], has_me))
        outputs = self.outputs(lists["out"], line)
        self.check_initial(lists["initial"], outputs, derivatives, line)
        return Structure(
            outputs=outputs,
            derivatives=derivatives,
            states=tuple(self.by_name[one.variable.derivative_of] for one in derivatives),
            clocked_states=tuple(lists["clocked"]),
            initial=tuple(lists["initial"]),
            indicators=tuple(lists["indicator"]),
        )

    def at(self, text: str) -> Variable | None:
        """The variable of an index (FMI 2, from 1) or of a reference (FMI 3)."""
        number = whole_number(text)
        if number is None:
            return None
        if self.fmi == 3:
            found = self.by_reference.get(number)
            return None if found is None else self.variables[found]
        return self.variables[number - 1] if 1 <= number <= len(self.variables) else None

    def unknown(self, element: Element, key: str) -> Unknown | None:
        """None where it cannot be read; of initial unknowns that is no error: nothing but an order hangs on them."""
        tag, attributes, _, line = element
        if not attributes.keys() <= _UNKNOWN:
            self.told.strange(attributes, _UNKNOWN, "ModelStructure", line)
        tell: Callable[[str, str, int], None] = self.told.warn if key == "initial" else self.told.error
        what = "index" if self.fmi == 2 else "valueReference"
        text = attributes.get(what, "")
        variable = self.at(text)
        if variable is None:
            tell("ModelStructure", f"{tag} has the {what} {quoted(text)}, which no variable has.", line)
            return None
        listed = attributes.get("dependencies")
        if listed is None:
            return Unknown(variable)
        found = []
        for one in listed.split():
            dependency = self.at(one)
            if dependency is None:
                message = f"its dependencies hold {quoted(one)}, which is the {what} of no variable."
                tell(variable.name, message, line)
                return Unknown(variable)
            found.append(dependency)
        kinds = tuple(attributes.get("dependenciesKind", "").split())
        if kinds and (len(kinds) != len(found) or not _KINDS.issuperset(kinds)):
            self.told.warn(variable.name, "dependenciesKind does not fit the dependencies, and is ignored.", line)
            kinds = ()
        return Unknown(variable, tuple(found), kinds or ("dependent",) * len(found))

    def derivatives(self, listed: list[Unknown], has_me: bool) -> Iterator[Unknown]:
        """Those that are derivatives of a state."""
        for one in listed:
            variable = one.variable
            if variable.derivative_of:
                yield one
            elif has_me:
                message = "it is listed as a derivative and does not say of which state."
                self.told.error(variable.name, message, variable.line)
            else:
                self.told.warn(variable.name, "it is listed as a derivative and does not say of what.", variable.line)
        known = {one.variable.name for one in listed}
        if has_me:
            for variable in self.variables:
                if variable.derivative_of and variable.name not in known and variable.name not in self.aliases:
                    self.told.warn(variable.name, "a derivative that is not listed; its state is none.", variable.line)

    def outputs(self, listed: list[Unknown], line: int) -> tuple[Unknown, ...]:
        """The outputs in the order of the list; those that it leaves out depend on all."""
        for one in listed:
            if one.variable.causality != "output":
                self.told.warn(one.variable.name, "it is listed as an output and is none.", one.variable.line)
        known = {one.variable.name for one in listed}
        kept = [one for one in listed if one.variable.causality == "output"]
        for variable in self.variables:
            if variable.causality == "output" and variable.name not in known:
                self.told.warn(
                    variable.name, "an output that is not listed; it counts as one that depends on all.", line
                )
                kept.append(Unknown(variable))
        return tuple(kept)

    def check_initial(
        self, initial: list[Unknown], outputs: Iterable[Unknown], derivatives: Iterable[Unknown], line: int
    ) -> None:
        """Warns of unknowns of the start that are not listed."""
        known = {one.variable.name for one in initial}
        calculated = ("calculated", "approx")
        wanted = [one.variable for one in outputs if one.variable.initial in calculated and not one.variable.clocks]
        wanted += [one.variable for one in derivatives if one.variable.initial in calculated]
        for variable in wanted:
            if variable.name not in known and variable.type != "Clock":
                self.told.warn(variable.name, "it is computed at the start and not listed as an initial unknown.", line)


def _is_settable(variable: Variable) -> bool:
    return variable.causality in ("input", "parameter", "structuralParameter") or (
        variable.initial in ("exact", "approx") and variable.variability != "constant"
    )


def _children(sections: Mapping[str, list[Element]], tag: str) -> Iterator[Element]:
    for section in sections.get(tag, ()):
        yield from section[2]
