"""A diagram while it is built: its value, what was added since that was read last, and its block types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..contract.block import Block
from ..contract.interface import Interface
from ..model import document as documents
from ..model.block_ports import Ports, Probe, interface_alone, port_units
from ..model.diagram_value import BASE, BlockEntry, DiagramValue, check_name
from ..model.hierarchy import Resolver
from ..model.raw_values import given_values, raw_of
from ..model.resolver import resolver_of
from ..model.spreading import fitted, spread
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.json_document import IN_FILES
from ..text.printable import legible
from .entries import block_entry, checked_entry


class Draft:
    """What a Diagram holds. types: the block types that it may use, by name."""

    def __init__(self, value: DiagramValue, types: Mapping[str, type[Block]]) -> None:
        self.types = types
        self._frozen = value
        self._open: dict[str, dict[str, object]] = {}
        self._probe: Probe | None = None
        self._brought: object = None  # the types that the last subdiagram has brought

    @property
    def value(self) -> DiagramValue:
        """The frozen value; another one can take its place."""
        if self._open:
            self._frozen, self._open = replace(self._frozen, **self._open), {}  # type: ignore[arg-type]
        return self._frozen

    @value.setter
    def value(self, value: DiagramValue) -> None:
        self._frozen, self._open, self._probe = value, {}, None

    @property
    def name(self) -> str:
        return self._frozen.name

    @property
    def folder(self) -> str:
        """Where the relative paths of files begin."""
        return self._frozen.folder

    @property
    def resolver(self) -> Resolver:
        return resolver_of(self.types)

    def put(self, section: str, entries: Mapping[str, object]) -> None:
        """Add entries. A section is copied once between two readings of the value: building is not quadratic."""
        if entries and section not in self._open:
            self._open[section] = dict(getattr(self._frozen, section))
        if entries:
            self._open[section].update(entries)
        if section == "parameters":
            self._probe = None

    def wire(self, sink: str, source: str) -> None:
        """Add a wire, and give copies to the scalar blocks that a vector reaches by it. Raises ModelError (E109)."""
        within = DiagramValue(
            self.name, parameters=self.section("parameters"), inputs=self.section("inputs"),
            blocks=self.section("blocks"), wires=self.section("wires"), folder=self.folder,
        )  # fmt: skip
        sink, source = fitted(within, sink, source, self.resolver, self.interface)
        if sink in within.wires:
            message = f"is already wired to {legible(within.wires[sink])}."
            cure = f'Use Sum to add signals, or remove the wire first: unwire("{legible(sink)}").'
            raise ModelError(Fault("E109", legible(sink), message, cure))
        self.put("blocks", spread(within, sink, source, self.resolver, self.interface))
        self.put("wires", {sink: source})

    def unwire(self, sink: str) -> None:
        """Remove a wire. Raises UsageError (E501) if there is none."""
        wires = self.section("wires")
        if sink not in wires:
            cure = did_you_mean(sink, wires)
            raise UsageError(Fault("E501", legible(sink), "is not wired.", cure))
        self._open.setdefault("wires", dict(wires))
        del self._open["wires"][sink]
        self._probe = None

    def set(self, name: str, raw: object) -> None:
        """Give a parameter another value. Raises UsageError (E106, E501) and ModelError."""
        from ..editing.setting import with_parameter  # few diagrams change a block

        self.value = with_parameter(self.value, name, raw, self.resolver)

    def remove(self, name: str) -> None:
        """Remove what has a name, and everything that refers to it. Raises UsageError (E501)."""
        from ..editing.applying import text_without  # few diagrams lose a block

        before = self.value
        text = text_without(documents.dumps(before), name, before.folder, tuple(self.types.values()))
        after = documents.loads(text, file="", folder=before.folder, times=IN_FILES)  # nobody sees this text
        # Blocks that stay as they were keep their classes: those of FMUs hold what was given beside the path.
        kept = {key: before.blocks[key] for key, entry in after.blocks.items() if before.blocks[key] == entry}
        self.value = replace(after, blocks={**after.blocks, **kept})

    def section(self, section: str) -> Mapping[str, Any]:
        entries: Mapping[str, object] = self._open[section] if section in self._open else getattr(self._frozen, section)
        return entries

    def check_free(self, name: str, kind: str) -> None:
        """Refuse what is no name, and a name that is taken. An output may be called like a block or a parameter."""
        check_name(name)
        seen = {"input": ("output", "input", "block", "parameter"), "output": ("output", "input")}
        for what in seen.get(kind, ("input", "block", "parameter")):
            if name in self.section(what + "s"):
                article = "an" if what[0] in "io" else "a"
                raise ModelError(Fault("E109", name, f"the name is already used by {article} {what}.", "Choose "
                "another name."))

    def outline(self) -> str:
        """Describe the blocks, one line for each."""
        value = self.value
        lines = [f"<Diagram {value.name}: {len(value.blocks)} blocks, {len(value.wires)} wires>"]
        for name, entry in value.blocks.items():
            shown = entry.what or "subdiagram"
            if entry.variants:
                chosen = entry.variant or BASE
                names = (f"[{key}]" if key == chosen else key for key in (BASE, *entry.variants))
                shown += f" (variants: {', '.join(names)})"
            lines.append(f"  {name}: {shown}")
        return "\n".join(lines)

    # --- blocks ------------------------------------------------------------------------------------------------

    def block(
        self, name: str, block: object, *, doc: str, control: Mapping[str, Any] | None = None, stream: str = "",
        copies: Any = None,
    ) -> BlockEntry:
        """Return the entry of a Block, checked like the entry of a file. Raises UsageError (E501) if it is no block."""
        given, entry = block_entry(name, block, self.folder)
        said = {"doc": doc, "control": control or {}, "stream": stream, "copies": copies}
        return checked_entry(name, entry, given, self.folder, **said)

    def subdiagram(
        self,
        name: str,
        source: Draft | str,
        parameters: Mapping[str, Any],
        *,
        doc: str,
        control: Mapping[str, Any] | None = None,
        stream: str = "",
        copies: Any = None,
    ) -> BlockEntry:
        """Return the entry of a diagram, or of a diagram file, as a block. It brings the block types of a diagram."""
        given = {k: raw_of(v) for k, v in parameters.items() if v is not None}
        if isinstance(source, Draft):
            if source.types is not self._brought and source.types.keys() - self.types.keys():
                self.types = {**source.types, **self.types}  # which loads all modules of the library
            self._brought = source.types
            entry = BlockEntry(diagram=documents.relocated(source.value, self.folder))
        else:
            entry = BlockEntry(diagram=source, loaded=documents.load(Path(self.folder) / source))
        if entry.inner is not None:
            given = {**given_values(entry.inner, self.resolver, given)}
        said = {"doc": doc, "control": control or {}, "stream": stream, "copies": copies}
        return checked_entry(name, entry, given, self.folder, **said)

    def ports(self, name: str, entry: BlockEntry) -> Ports:
        """Return the ports of a block in this diagram, with their units, without reading the diagram value."""
        if entry.variants or entry.inner is not None:
            return port_units(self._within(), name, entry, self.resolver)
        interface = self.interface(name, entry)
        return interface.input_units, interface.output_units

    def interface(self, name: str, entry: BlockEntry) -> Interface:
        """Return the interface of a block of a type in this diagram. Raises ModelError."""
        is_known = bool(entry.type) and entry.cls is not None and entry.copies is None and not entry.variants
        probe, self._probe = (self._probe, None) if is_known else (None, self._probe)
        if probe is not None and (interface := probe.interface(name, entry)) is not None:
            self._probe = probe
            return interface
        interface = interface_alone(self._within(), name, entry, self.resolver)
        if is_known:
            self._probe = Probe(self._within(), self.resolver)
        return interface

    def _within(self) -> DiagramValue:
        return DiagramValue(self.name, parameters=self.section("parameters"), folder=self.folder)
