"""The structure of a model: which variables are outputs and derivatives, and what each of them depends on.

References: FMI 2.0.4, section 2.2.8; FMI 3.0.2, section 2.4.8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from .description_variables import Variables
from .findings import Findings, quoted
from .model_description import Structure, Unknown
from .xmltree import Element

_KINDS = {"dependent", "constant", "fixed", "tunable", "discrete"}
_UNKNOWN = {"index", "valueReference", "dependencies", "dependenciesKind"}


class Dependencies:
    """Reads the structure of a model whose variables are known."""

    def __init__(self, told: Findings, variables: Variables) -> None:
        self.told, self.variables = told, variables
        self.fmi = told.fmi

    def read(self, elements: Iterable[Element], has_me: bool, line: int) -> Structure:
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
                message = f"FMI {self.fmi} has no element {quoted(tag)} here; it is ignored."
                self.told.warn("ModelStructure", message, at)
            elif key:
                seen = lists[key]
                known = {entry.variable.name for entry in seen} if self.fmi == 2 else None
                for child in children if self.fmi == 2 else (element,):
                    unknown = self.unknown(child, key)
                    if unknown is not None and known is not None:
                        if unknown.variable.name in known:
                            self.told.warn(unknown.variable.name, f"it appears twice in {tag}.", child[3])
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
            states=tuple(self.variables.by_name[derivative.variable.derivative_of] for derivative in derivatives),
            clocked_states=tuple(lists["clocked"]),
            initial=tuple(lists["initial"]),
            indicators=tuple(lists["indicator"]),
        )

    def unknown(self, element: Element, key: str) -> Unknown | None:
        """None where it cannot be read; for initial unknowns that is no error: they decide only an order."""
        tag, attributes, _, line = element
        if not attributes.keys() <= _UNKNOWN:
            self.told.strange(attributes, _UNKNOWN, "ModelStructure", line)
        tell: Callable[[str, str, int], None] = self.told.warn if key == "initial" else self.told.error
        what = "index" if self.fmi == 2 else "valueReference"
        text = attributes.get(what, "")
        variable = self.variables.at(text)
        if variable is None:
            tell("ModelStructure", f"{tag} has the {what} {quoted(text)}, which no variable has.", line)
            return None
        listed = attributes.get("dependencies")
        if listed is None:
            return Unknown(variable)
        dependencies = []
        for reference in listed.split():
            dependency = self.variables.at(reference)
            if dependency is None:
                message = f"its dependencies list the {what} {quoted(reference)}, which no variable has."
                tell(variable.name, message, line)
                return Unknown(variable)
            dependencies.append(dependency)
        kinds = tuple(attributes.get("dependenciesKind", "").split())
        if kinds and (len(kinds) != len(dependencies) or not _KINDS.issuperset(kinds)):
            self.told.warn(variable.name, "dependenciesKind does not match dependencies, and is ignored.", line)
            kinds = ()
        return Unknown(variable, tuple(dependencies), kinds or ("dependent",) * len(dependencies))

    def derivatives(self, listed: list[Unknown], has_me: bool) -> Iterator[Unknown]:
        """Those that are derivatives of a state."""
        for unknown in listed:
            variable = unknown.variable
            if variable.derivative_of:
                yield unknown
            else:
                message = "it is listed as a derivative, but has no attribute derivative that names its state."
                tell = self.told.error if has_me else self.told.warn
                tell(variable.name, message, variable.line)
        known = {unknown.variable.name for unknown in listed}
        if has_me:
            for variable in self.variables.listed:
                if (
                    variable.derivative_of
                    and variable.name not in known
                    and variable.name not in self.variables.aliases
                ):
                    message = "this derivative is not listed in ModelStructure, so blocks does not integrate its state."
                    self.told.warn(variable.name, message, variable.line)

    def outputs(self, listed: list[Unknown], line: int) -> tuple[Unknown, ...]:
        """The outputs in the order of the list; those that it leaves out depend on all."""
        for unknown in listed:
            if unknown.variable.causality != "output":
                message = "it is listed as an output, but its causality is not output; the entry is ignored."
                self.told.warn(unknown.variable.name, message, unknown.variable.line)
        known = {unknown.variable.name for unknown in listed}
        kept = [unknown for unknown in listed if unknown.variable.causality == "output"]
        for variable in self.variables.listed:
            if variable.causality == "output" and variable.name not in known:
                message = "this output is not listed in ModelStructure; blocks assumes that it depends on everything."
                self.told.warn(variable.name, message, line)
                kept.append(Unknown(variable))
        return tuple(kept)

    def check_initial(
        self, initial: list[Unknown], outputs: Iterable[Unknown], derivatives: Iterable[Unknown], line: int
    ) -> None:
        """Warns of unknowns of the start that are not listed."""
        known = {unknown.variable.name for unknown in initial}
        calculated = ("calculated", "approx")
        wanted = [
            output.variable
            for output in outputs
            if output.variable.initial in calculated and not output.variable.clocks
        ]
        wanted += [derivative.variable for derivative in derivatives if derivative.variable.initial in calculated]
        for variable in wanted:
            if variable.name not in known and variable.type != "Clock":
                message = "it is computed at the start, but not listed as an initial unknown."
                self.told.warn(variable.name, message, line)
