"""The block types that there are, and what each of them says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..contract.block import Block
from ..model.block_types import Library, library_types
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.printable import legible

__all__ = ["Catalog", "ParameterRow", "PortRow", "Sheet", "measures"]


class PortRow(NamedTuple):
    """A port. unit: "*" where it follows from the units that structural parameters say. default: in words, or ""."""

    name: str
    unit: str
    default: str
    doc: str


class ParameterRow(NamedTuple):
    """A parameter. default: in words. kind: "structural", "fixed" or "", with the values that it may have."""

    name: str
    unit: str
    default: str
    doc: str
    kind: str


@dataclass(frozen=True)
class Sheet:
    """One block type: its ports, as they are without parameters where it can have none, and its parameters."""

    name: str
    doc: str
    inputs: tuple[PortRow, ...]
    outputs: tuple[PortRow, ...]
    parameters: tuple[ParameterRow, ...]


@dataclass(frozen=True)
class Catalog:
    """Block types by name."""

    types: Mapping[str, type[Block]]

    @classmethod
    def of(cls, library: Library = ()) -> Catalog:
        """Those that ship, those of installed packages, and `library`. Raises UsageError (E501)."""
        return cls(library_types(library))

    def sheet(self, name: str) -> Sheet:
        """What a block type, or an FMU by its path, says of itself. Raises UsageError (E103), ModelError."""
        if name.endswith(".fmu"):
            from ..model.fmu_block import fmu_type

            return _sheet(fmu_type(name))
        if name not in self.types:
            cure = did_you_mean(name[:200], self.types) or "`blocks list` names them all."
            raise UsageError(Fault("E103", legible(name), "there is no such block type.", cure))
        return _sheet(self.types[name])


def measures() -> Mapping[str, str]:
    """What can be measured of a run: by name, what it is."""
    from ..model.diagram_grammar import MEASURES

    return MEASURES


def _sheet(cls: type[Block]) -> Sheet:
    declaration = cls.declaration
    inputs, outputs = _ports(cls)
    parameters = (
        ParameterRow(p.name, _unit(p), _default(p), p.doc, _kind(declaration, p)) for p in declaration.settable.values()
    )
    return Sheet(cls.__name__, declaration.doc, tuple(inputs), tuple(outputs), tuple(parameters))


def _ports(cls: type[Block]) -> tuple[list[PortRow], list[PortRow]]:
    from ..contract.resolution import resolve

    declaration = cls.declaration
    variables: dict[str, Any] = {
        **declaration.inputs,
        **declaration.outputs,
        **declaration.stepped,
        **declaration.given,
        **declaration.states,
        **declaration.discretes,
        **declaration.algebraics,
    }
    try:
        interface = resolve(cls, {}).interface
    except BlocksError:  # a type with parameters that must be given has no ports yet
        inputs = [PortRow(name, _unit(v), "", v.doc) for name, v in declaration.inputs.items()]
        outputs = [
            PortRow(name, _unit(v), "", v.doc)
            for name, v in variables.items()
            if name not in declaration.inputs and getattr(v, "output", True)
        ]
        return inputs, outputs

    def row(port: Any) -> PortRow:
        values = port.default if port.default is None or len(set(port.default)) > 1 else port.default[:1]
        default = f"default {', '.join(f'{value:g}' for value in values)}" if values is not None else ""
        return PortRow(port.name, port.unit, default, variables[port.variable].doc)

    return [row(port) for port in interface.inputs.values()], [row(port) for port in interface.outputs.values()]


def _unit(variable: Any) -> str:
    return variable.unit if isinstance(variable.unit, str) else "*"


def _default(parameter: Any) -> str:
    from ..contract.variables import REQUIRED

    if parameter.default is REQUIRED:
        return "required"
    if parameter.default is None:
        return "optional"
    return "computed" if callable(parameter.default) else f"{parameter.default}"


def _kind(declaration: Any, parameter: Any) -> str:
    kind = "structural" if parameter.structural else "fixed" if parameter.fixed else ""
    return f"{kind} ({' | '.join(parameter.choices)})" if parameter.choices else kind
