"""modelDescription.xml of FMI 2.0 and 3.0 -> Description; lenient, since many files break minor rules.

    read_description("x.fmu"), parse(text, "x.fmu/modelDescription.xml")

What does not matter is a warning (W201) and is mended: an attribute that does not exist, another order, a missing
initial unknown, an output that is not listed (it depends on all). What makes the FMU unusable is an error, and all of
them are reported at once: no token, one reference for two variables, an index or a reference that leads nowhere,
derivatives in a circle, a value of the wrong kind. Both versions are read by the same code, because they share most
rules. Beside it: units and types (`definitions`), variables (`description_variables`), the structure (`dependencies`).

References: FMI 2.0.4, section 2.2; FMI 3.0.2, sections 2.4, 3.3, 4.3.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from ..host.gc_pause import paused
from ..text.errors import Fault, FMUError
from . import xmltree
from .archive import DESCRIPTION, Archive
from .definitions import Definitions
from .dependencies import Dependencies
from .description_variables import Variables
from .findings import Findings, quoted
from .model_description import (
    Category,
    Description,
    Experiment,
    Interface,
)
from .xmltree import Element

EXPERIMENT = "DefaultExperiment"
_INTERFACES = {"ModelExchange": "ME", "CoSimulation": "CS", "ScheduledExecution": "SE"}
_ORDER = (
    *_INTERFACES, "UnitDefinitions", "TypeDefinitions", "LogCategories", EXPERIMENT, "VendorAnnotations",
    "ModelVariables", "ModelStructure", "Annotations",
)  # fmt: skip

# --- attributes that each element may have ----

_ROOT = {
    "fmiVersion", "modelName", "guid", "instantiationToken", "description", "author", "version", "copyright", "license",
    "generationTool", "generationDateAndTime", "variableNamingConvention", "numberOfEventIndicators",
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
    return _DescriptionReader(file, _fmi(attributes, file, line)).description(root)


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
        message, cure = "the file has no fmiVersion.", "Export the model again."
    raise FMUError(Fault("E205", "", message, cure).at(file, line, 1))


class _DescriptionReader:
    """One pass over the tree of a file; gathers faults and warnings on the way."""

    def __init__(self, file: str, fmi: int) -> None:
        self.fmi = fmi
        self.told = Findings(file, fmi)
        self.defined = Definitions(self.told)
        self.variables = Variables(self.told, self.defined)

    # --- the whole ----

    def description(self, root: Element) -> Description:
        _, attributes, children, line = root
        sections = self.sections(children)
        self.told.strange(attributes, _ROOT, "", line)
        version, token = self.version_and_token(attributes, line)
        interfaces = tuple(self.interface(element) for tag in _INTERFACES for element in sections.get(tag, ()))
        if not interfaces:
            cure = "It may be an FMU of FMI 1.0. Export the model again."
            self.told.error("", "there is neither ModelExchange nor CoSimulation, so nothing can run.", line, cure)
        self.defined.read_units(_children(sections, "UnitDefinitions"))
        self.defined.read_types(_children(sections, "TypeDefinitions"))
        if "ModelVariables" not in sections:
            self.told.warn("", "there are no variables.", line)
        self.variables.read(_children(sections, "ModelVariables"))
        has_me = any(interface.kind == "ME" for interface in interfaces)
        structure = Dependencies(self.told, self.variables).read(_children(sections, "ModelStructure"), has_me, line)
        indicators = sum(math.prod(indicator.variable.shape) for indicator in structure.indicators)
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
            variables=tuple(self.variables.listed),
            structure=structure,
            names=MappingProxyType(self.variables.by_name),
            aliases=MappingProxyType(self.variables.aliases),
            units=MappingProxyType(self.defined.units),
            types=MappingProxyType(self.defined.types),
            experiment=self.experiment(sections.get(EXPERIMENT, ())),
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

    def version_and_token(self, attributes: Mapping[str, str], line: int) -> tuple[str, str | None]:
        """The version as it is written, and the token, None where there is none."""
        version = attributes["fmiVersion"].strip()
        if not re.fullmatch(r"2\.0|3\.\d+(\.\d+)?", version):
            message = f"FMI {quoted(version)} is not a published version; blocks reads the file as FMI {self.fmi}.0."
            self.told.warn("", message, line)
        token_name = "guid" if self.fmi == 2 else "instantiationToken"
        token = attributes.get(token_name)
        if token is None:
            self.told.error("", f"{token_name} is missing; an FMU does not start without it.", line)
        elif not token:
            self.told.warn("", f"{token_name} is empty.", line)
        return version, token

    def sections(self, children: Iterable[Element]) -> dict[str, list[Element]]:
        """The elements below the root by tag."""
        sections: dict[str, list[Element]] = {}
        last = 0
        for child in children:
            tag, line = child[0], child[3]
            if tag not in _ORDER:
                self.told.warn("", f"FMI {self.fmi} has no element {quoted(tag)} here; it is ignored.", line)
                continue
            at = _ORDER.index(tag)
            if at < last:
                self.told.warn("", f"{tag} comes after {_ORDER[last]}; the standard requires it before.", line)
            if tag in sections:
                self.told.warn("", f"{tag} appears twice.", line)
            last = max(at, last)
            sections.setdefault(tag, []).append(child)
        return sections

    def experiment(self, elements: Iterable[Element]) -> Experiment:
        for _, attributes, _, line in elements:
            self.told.strange(attributes, {"startTime", "stopTime", "tolerance", "stepSize"}, EXPERIMENT, line)
            start, stop, tolerance, step = (
                self.told.real(attributes, name, EXPERIMENT, line)
                for name in ("startTime", "stopTime", "tolerance", "stepSize")
            )
            if stop is not None and stop <= (start or 0.0):
                begin = attributes.get("startTime", "0")
                message = f"stopTime {attributes['stopTime']} is not after startTime {begin}, and is ignored."
                self.told.warn(EXPERIMENT, message, line)
                stop = None
            if tolerance is not None and tolerance <= 0.0:
                self.told.warn(EXPERIMENT, f"tolerance {attributes['tolerance']} is not above 0, and is ignored.", line)
                tolerance = None
            if step is not None and step <= 0.0:
                self.told.warn(EXPERIMENT, f"stepSize {attributes['stepSize']} is not above 0, and is ignored.", line)
                step = None
            return Experiment(start, stop, tolerance, step)
        return Experiment()

    def interface(self, element: Element) -> Interface:
        tag, attributes, children, line = element
        self.told.strange(attributes, _INTERFACE, tag, line)
        identifier = attributes.get("modelIdentifier", "")
        if not identifier:
            self.told.error(tag, "modelIdentifier, the name of the binary, is missing.", line)
        elif identifier in (".", "..") or len(identifier) > 200 or re.search(r"[/\\\x00-\x1f]", identifier):
            self.told.error(tag, "modelIdentifier is not a valid file name.", line)
        elif not re.fullmatch(r"[A-Za-z_]\w*", identifier, re.ASCII):
            self.told.warn(tag, "modelIdentifier is not a valid identifier of C.", line)

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


def _children(sections: Mapping[str, list[Element]], tag: str) -> Iterator[Element]:
    for section in sections.get(tag, ()):
        yield from section[2]
