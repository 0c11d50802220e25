"""The block types that there are, what each of them says of itself, and Simulink's words for them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..contract.block import Block
from ..contract.interface import Interface
from ..model import simulink
from ..model.block_types import Library, library_types
from ..text.errors import BlocksError, Fault, UsageError, did_you_mean
from ..text.other_words import TYPES
from ..text.printable import legible

Word = simulink.Word
words, word_of = simulink.words, simulink.word_of


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


class Found(NamedTuple):
    """A block type with its group, the first line of its doc, and the words of Simulink by which it was found."""

    name: str
    group: str
    doc: str
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Catalog:
    """Block types by name."""

    types: Mapping[str, type[Block]]

    @classmethod
    def of(cls, library: Library = ()) -> Catalog:
        """Those that ship, those of installed packages, and `library`. Raises UsageError (E501)."""
        return cls(library_types(library))

    def sheet(self, name: str) -> Sheet:
        """Return the sheet of a block type, or of an FMU by its path. Raises UsageError (E103), ModelError."""
        if name.endswith(".fmu"):
            from ..model.fmu_block import fmu_type

            return sheet_of(fmu_type(name))
        if name not in self.types:
            if name in TYPES:
                message = "is a function that makes a diagram, and not a block type."
                cure = f"{TYPES[name]} In Python, see help(blocks.{name})."
                raise UsageError(Fault("E103", name, message, cure))
            near = did_you_mean(name[:200], (*self.types, *self.groups(), *words()))
            cure = f"{near} `blocks list --search WORD` searches the descriptions, `blocks list` shows all types."
            raise UsageError(Fault("E103", legible(name), "there is no such block type.", cure))
        return sheet_of(self.types[name])

    def groups(self) -> dict[str, list[Found]]:
        """Return the block types by group: the module that holds them."""
        groups: dict[str, list[Found]] = {}
        for name, cls in self.types.items():
            group = cls.__module__.rpartition(".")[2]
            groups.setdefault(group, []).append(Found(name, group, cls.declaration.doc.partition("\n")[0]))
        return dict(sorted(groups.items()))

    def search(self, text: str) -> tuple[list[Found], list[Word]]:
        """Find the block types, and the words of Simulink, that match all words of `text`.

        A type matches by its name, group, first line, ports and parameters, or by a word of Simulink that means it.
        Types come in this order: by their own name, by a word of Simulink, by the rest. Words of Simulink are returned
        if they match and mean no type. If nothing matches, the types are returned whose whole description does; else
        the words whose section in the documentation has a heading with all words of `text`.
        """
        asked = text.lower().split()
        told = [word for word in words().values() if _says(asked, word.name)]
        every = [found for members in self.groups().values() for found in members]
        ranked = []
        for found in every:
            names = tuple(word.name for word in told if found.name in word.meant)
            own = " ".join(_texts(self.types[found.name], found))
            if names or _says(asked, own):
                ranked.append((not _says(asked, found.name), not names, found._replace(words=names)))
        ranked.sort(key=lambda item: item[:2])
        if not ranked and not told:
            if described := [found for found in every if _says(asked, self.types[found.name].declaration.doc)]:
                return described, []
            titled = [word for word in words().values() if _says(asked, word.see.partition("#")[2])]
            return [], [*{word.here: word for word in reversed(titled)}.values()][::-1]
        return [found for *_, found in ranked], [word for word in told if not word.blocks]


def _texts(cls: type[Block], found: Found) -> Iterator[str]:
    """Yield the texts by which a search finds a type."""
    declaration = cls.declaration
    yield from (re.sub(r"(?<=[a-z])(?=[A-Z])", " ", found.name), *found[:3])
    for table in (declaration.inputs, declaration.outputs, declaration.states, declaration.settable):
        for name, variable in table.items():
            yield f"{name} {variable.doc}"


def _says(asked: list[str], text: str) -> bool:
    """Whether each word that is asked for begins one of the text."""
    return all(re.search(rf"\b{re.escape(word)}", text.lower()) for word in asked)


def measures() -> Mapping[str, str]:
    """Return the measures of a run with their descriptions, by name."""
    from ..model.diagram_grammar import MEASURES

    return MEASURES


def sheet_of(cls: type[Block], interface: Interface | None = None) -> Sheet:
    """Return the sheet of a block class. interface: of a block; its ports replace the ports without parameters."""
    declaration = cls.declaration
    inputs, outputs = _ports(cls, interface)
    parameters = (
        ParameterRow(p.name, _unit(p), _default(p), p.doc, _kind(declaration, p)) for p in declaration.settable.values()
    )
    return Sheet(cls.__name__, declaration.doc, tuple(inputs), tuple(outputs), tuple(parameters))


def _ports(cls: type[Block], interface: Interface | None) -> tuple[list[PortRow], list[PortRow]]:
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
        interface = interface or resolve(cls, {}).interface
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


def _kind(declaration: object, parameter: Any) -> str:
    kind = "structural" if parameter.structural else "fixed" if parameter.fixed else ""
    return f"{kind} ({' | '.join(parameter.choices)})" if parameter.choices else kind
