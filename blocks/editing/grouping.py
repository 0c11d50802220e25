"""Blocks of a diagram as a subdiagram of it, and back: nothing that is computed changes.

What leads across the edge of the subdiagram gets a port there, and parameters of the diagram that its blocks read are
handed in. Names of what lies in it get one name more, in all files that use them; random numbers keep their streams.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..contract.enumerations import enumeration_of
from ..model import streams
from ..model.diagram_value import check_name
from ..model.flatten import Flat
from ..model.values import is_expression
from ..text.errors import Fault, ModelError, UsageError
from ..text.grammar import Steps
from ..text.json_document import Document, place_of
from ..text.json_edits import same
from ..text.json_number import is_number
from ..text.printable import quoted
from ..text.quantity_text import quantity_of
from . import tree
from .edits import files_with
from .references import Reference, Target, references
from .renaming import READ, drawing, same_flat
from .spots import Spot, blocks_of, entries_around

_ELEMENTS = re.compile(r"(.*?)((?:\[[^\[\]]*\])*)\Z", re.DOTALL)


def group(spot: Spot, entry: Mapping[str, Any]) -> None:
    """{"group": ["a", "b"], "as": "control"}. Raises ModelError (E105, E109, E111)."""
    names, name, body = list(dict.fromkeys(entry["group"])), entry["as"], spot.body
    spot.whole()
    check_name(name)
    for block in names:
        if block not in body.names("block"):
            raise spot.missing("block", block, body.names("block"))
    taken = [kind for kind in READ if name in body.names(kind)]
    if taken and name not in names:
        raise ModelError(spot.fault("E109", name, f"is already the name of another {taken[0]}.", "Choose "
            "another name."))
    before = spot.workspace.flat(spot.file)
    inside = _Inside(spot, names, name, before)
    targets = {Target(spot.file, spot.scope, "block", block): f"{name}.{block}" for block in names}
    own = [(*spot.scope, "blocks", block) for block in names]
    own += [(*spot.scope, section) for section in ("wires", "outputs", "layout")]

    def longer(document: Document, found: list[Reference]) -> object:
        is_here = os.path.realpath(document.file) == spot.file
        found = [reference for reference in found if not (is_here and tree.is_within(reference.path, own))]
        return tree.with_names(document.value, found, targets)

    _everywhere(spot, names, longer)
    value = _put_section(spot.value, spot.scope, "blocks", inside.blocks())
    for section in ("wires", "outputs", "layout"):
        value = _put_section(value, spot.scope, section, getattr(inside, section)())
    spot.put(value)
    prefix = "".join(f"{block}." for block in blocks_of(spot.scope))

    def path(text: str) -> str:
        rest = text.removeprefix(prefix)
        is_one = text.startswith(prefix) and rest.partition(".")[0].partition("[")[0] in names
        return f"{prefix}{name}.{rest}" if is_one else text

    _check(spot, before, path, name, "these blocks cannot be grouped")


def _check(spot: Spot, before: Flat | tuple[Fault, ...], path: Callable[[str], str], place: str, what: str) -> None:
    """Refuse where the diagram that a file holds would compute something else."""
    after = spot.workspace.flat(spot.file)
    if isinstance(before, Flat) and not (isinstance(after, Flat) and same_flat(before, after, path)):
        told = "" if isinstance(after, Flat) else f" ({after[0].code} {after[0].place}: {after[0].message})"
        cure = "Choose other blocks, or make the change in steps: add, wire, remove."
        raise UsageError(spot.fault("E501", place, f"{what}: the diagram would compute something else{told}.", cure))


def _put_section(value: object, scope: Steps, section: str, entries: Mapping[str, object]) -> object:
    path = (*scope, section)
    if entries:
        return tree.replaced(value, path, dict(entries))
    return tree.without(value, [path]) if tree.table_at(value, path) else value


@dataclass
class _Inside:
    """What goes into the subdiagram, and what stands around it then."""

    spot: Spot
    names: list[str]
    name: str
    flat: Flat | tuple[Fault, ...]
    inputs: dict[str, str] = field(default_factory=dict)  # by source
    ports: dict[str, str] = field(default_factory=dict)  # outputs, by source without elements
    inner_wires: dict[str, str] = field(default_factory=dict)
    outer_wires: dict[str, str] = field(default_factory=dict)
    outer_outputs: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.body = self.spot.body.value
        self.parameters = self.read()
        for sink, source in tree.table_at(self.body, ("wires",)).items():
            into, out = self.has(sink), self.has(source)
            if into and out:
                self.inner_wires[sink] = source
            elif into:
                self.inner_wires[sink] = self.input(source, sink)
            else:
                self.outer_wires[sink] = self.output(source) if out else source
        for output, source in tree.table_at(self.body, ("outputs",)).items():
            self.outer_outputs[output] = self.output(source) if self.has(source) else source

    def has(self, text: object) -> bool:
        return isinstance(text, str) and re.split(r"[.\[]", text, maxsplit=1)[0] in self.names

    def read(self) -> list[str]:
        """The parameters of the diagram that the blocks read, and those that these are computed from."""
        spot = self.spot
        known = tree.table_at(self.body, ("parameters",))
        places = [(*spot.scope, "blocks", name) for name in self.names]
        found = references(spot.workspace.document(spot.file), spot.file, spot.workspace.documents)
        needed = {
            target.name
            for reference in found
            if tree.is_within(reference.path, places)
            for target in reference.targets
            if (target.file, target.scope, target.kind) == (spot.file, spot.scope, "parameter")
        }
        while True:
            places = [(*spot.scope, "parameters", name) for name in needed]
            more = {
                target.name
                for reference in found
                if tree.is_within(reference.path, places) and not reference.is_key
                for target in reference.targets
                if (target.file, target.scope, target.kind) == (spot.file, spot.scope, "parameter")
            }
            if more <= needed:
                return [name for name in known if name in needed]
            needed |= more

    def free(self, *candidates: str) -> str:
        taken = {*self.names, *self.parameters, *self.inputs.values(), *self.ports.values()}
        names = [re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")[:190] for text in candidates]
        names += [f"{names[-1]}_{count}" for count in range(2, len(taken) + 3)]
        return next(name for name in names if name not in taken)

    def input(self, source: str, sink: str) -> str:
        """The input of the subdiagram that a source leads to."""
        if source not in self.inputs:
            block, _, port = sink.partition(".")
            self.inputs[source] = self.free(port if "." in source else source, f"{block}_{port}")
        return self.inputs[source]

    def output(self, source: str) -> str:
        """A source in the subdiagram, as it is called outside."""
        whole, elements = _ELEMENTS.match(source).groups()  # type: ignore[union-attr]  # it matches always
        if whole not in self.ports:
            block, _, port = whole.partition(".")
            self.ports[whole] = self.free(port or f"{block}_out", f"{block}_{port or 'out'}")
        return f"{self.name}.{self.ports[whole]}{elements}"

    def input_entry(self, source: str) -> dict[str, object]:
        """What the input says that stands for a source: its unit, size and type."""
        given = tree.table_at(self.body, ("inputs",)).get(source)
        if isinstance(given, Mapping):
            return {key: given[key] for key in ("unit", "size", "type") if key in given}
        prefix = "".join(f"{block}." for block in blocks_of(self.spot.scope))
        signal = self.flat.signals.get(prefix + source) if isinstance(self.flat, Flat) else None
        if signal is None:
            return {}
        kind = enumeration_of(signal.type)
        entry: dict[str, object] = {"unit": signal.unit} if signal.unit else {}
        entry |= {"size": signal.shape[0] if len(signal.shape) == 1 else list(signal.shape)} if signal.shape else {}
        entry |= {"type": kind.entry if kind else signal.type} if signal.type != "real" else {}
        return entry

    def streams(self) -> dict[Steps, str]:
        """The streams of random numbers that the blocks draw from, counted from the whole diagram, by their entries."""
        spot = self.spot
        targets = frozenset(Target(spot.file, spot.scope, "block", name) for name in self.names)
        drawn = drawing(spot.file, targets, spot.workspace)
        if not drawn:
            return {}
        around = ""
        for path in entries_around(spot.scope):
            entry = tree.entry_at(spot.value, path, spot.name)
            around = f"{streams.joined(around, entry.get('stream', path[-1]))}."
        relative = {path[len(spot.scope) + 1 :]: stream for path, stream in drawn.items() if not stream.startswith("/")}
        if relative and self.is_used():
            name = min(relative)[0]
            what = "draws random numbers, which would change in the diagrams that use this file."
            cure = f'Set its stream first: {{"set": "blocks.{name}.stream", "to": "/{name}"}}.'
            raise UsageError(spot.fault("E501", str(name), what, cure))
        return {path: f"/{streams.joined(around, stream or str(path[0]))}" for path, stream in relative.items()}

    def is_used(self) -> bool:
        """Whether another diagram of the project has the file as a subdiagram."""
        spot = self.spot
        for document in files_with({os.path.basename(spot.file)}, spot.file, spot.workspace.documents):
            if not isinstance(document, str):
                folder = os.path.dirname(os.path.realpath(document.file))
                used = (os.path.realpath(os.path.join(folder, path)) for path in _subdiagrams(document.value))
                if spot.file in used:
                    return True
        return False

    def subdiagram(self) -> dict[str, Any]:
        blocks = {name: self.body["blocks"][name] for name in self.names}
        for path, stream in self.streams().items():
            blocks = tree.replaced({"blocks": blocks}, ("blocks", *path, "stream"), stream)["blocks"]
        known = tree.table_at(self.body, ("parameters",))
        layout = tree.table_at(self.body, ("layout",))
        sections = {
            "parameters": {name: known[name] for name in self.parameters},
            "inputs": {name: self.input_entry(source) for source, name in self.inputs.items()},
            "outputs": {name: source for source, name in self.ports.items()},
            "blocks": blocks,
            "wires": self.inner_wires,
            "layout": {name: layout[name] for name in self.names if name in layout},
        }
        return {section: entries for section, entries in sections.items() if entries}

    def blocks(self) -> dict[str, Any]:
        """The blocks of the diagram, the subdiagram in place of the first one that goes into it."""
        new: dict[str, object] = {"diagram": self.subdiagram()}
        if self.parameters:
            new["parameters"] = {name: f"={name}" for name in self.parameters}
        blocks: dict[str, object] = {}
        for name, entry in self.body["blocks"].items():
            if name not in self.names:
                blocks[name] = entry
            elif self.name not in blocks:
                blocks[self.name] = new
        return blocks

    def wires(self) -> dict[str, str]:
        """The wires of the diagram: those to the subdiagram first."""
        return {f"{self.name}.{name}": source for source, name in self.inputs.items()} | self.outer_wires

    def outputs(self) -> dict[str, str]:
        return self.outer_outputs

    def layout(self) -> dict[str, Any]:
        """The positions in the diagram: the subdiagram stands in the middle of what goes into it."""
        layout = tree.table_at(self.body, ("layout",))
        placed = [layout[name] for name in self.names if name in layout]
        left = {name: at for name, at in layout.items() if name not in self.names}
        if placed:
            left[self.name] = [round(sum(at[axis] for at in placed) / len(placed)) for axis in (0, 1)]
        return left


def _subdiagrams(value: object) -> Iterator[str]:
    """The paths of the subdiagram files that a document names, anywhere in it."""
    if isinstance(value, Mapping):
        if isinstance(value.get("diagram"), str) and "\0" not in value["diagram"]:
            yield value["diagram"]
        for entry in value.values():
            yield from _subdiagrams(entry)


# --- and back --------------------------------------------------------------------------------------------------


def ungroup(spot: Spot, entry: Mapping[str, Any]) -> None:
    """{"ungroup": "control"}. Raises ModelError (E105) and UsageError (E501)."""
    name, body = entry["ungroup"], spot.body
    spot.whole()
    if name not in body.names("block"):
        raise spot.missing("block", name, body.names("block"))
    block = body.names("block")[name]
    diagram = block.get("diagram")
    if not isinstance(diagram, Mapping):
        what = f"lies in another file, {quoted(diagram)}" if isinstance(diagram, str) else "is not a subdiagram"
        raise UsageError(spot.fault("E501", name, f"{what}.", "Only a subdiagram inside this file can be ungrouped."))
    place = (*spot.scope, "blocks", name)
    kept = {"name", "parameters", "inputs", "outputs", "blocks", "wires", "layout"}
    lost = [(*place, key) for key in block if key not in ("diagram", "parameters", "stream")]
    lost += [(*place, "diagram", key) for key in diagram if key not in kept]
    if lost:
        what = f'has "{lost[0][-1]}", which would be lost.'
        cure = f'Remove it first: {{"remove": {quoted(place_of(lost[0]))}}}.'
        raise UsageError(spot.fault("E501", name, what, cure, lost[0]))
    before = spot.workspace.flat(spot.file)
    lifted = _Lifted(spot, name)
    _everywhere(spot, {target.name for target in lifted.targets} | {name}, lifted.with_free_names)
    lifted.take()
    _everywhere(spot, {name}, lifted.shorter)
    spot.put(lifted.value())
    prefix = "".join(f"{outer}." for outer in blocks_of(spot.scope))

    def path(text: str) -> str:
        rest = text.removeprefix(f"{prefix}{name}.")
        first = rest.partition(".")[0].partition("[")[0]
        is_one = text.startswith(f"{prefix}{name}.") and first in lifted.blocks
        return f"{prefix}{lifted.blocks[first]}{rest[len(first) :]}" if is_one else text

    _check(spot, before, path, name, "cannot be ungrouped")


class _Lifted:
    """The names of a subdiagram's blocks and parameters in the diagram around it, and the sources of its outputs."""

    def __init__(self, spot: Spot, name: str) -> None:
        self.spot, self.name, body = spot, name, spot.body
        self.path = (*spot.scope, "blocks", name)
        block = body.names("block")[name]
        diagram, given = block["diagram"], tree.table_at(block, ("parameters",))
        taken = {other for kind in READ for other in body.names(kind)} - {name}
        self.parameters: dict[str, str] = {}
        for parameter in tree.table_at(diagram, ("parameters",)):
            value = given.get(parameter)
            read = value[1:].strip() if isinstance(value, str) and is_expression(value) else ""
            if read not in body.names("parameter"):
                read = _free(parameter, name, taken)
                taken.add(read)
            self.parameters[parameter] = read
        self.blocks: dict[str, str] = {}
        for inner in tree.table_at(diagram, ("blocks",)):
            self.blocks[inner] = _free(inner, name, taken)
            taken.add(self.blocks[inner])
        scope = (*self.path, "diagram")
        self.targets = {Target(spot.file, scope, "block", old): new for old, new in self.blocks.items()}
        self.targets |= {Target(spot.file, scope, "parameter", old): new for old, new in self.parameters.items()}

    def with_free_names(self, document: Document, found: list[Reference]) -> object:
        return tree.with_names(document.value, found, self.targets)

    def take(self) -> None:
        """What the subdiagram holds, now that no name in it is taken outside."""
        self.block = tree.entry_at(self.spot.value, self.path, self.spot.name)
        self.diagram = self.block["diagram"]
        self.body = self.spot.body.value
        wires = tree.table_at(self.body, ("wires",))
        self.into: dict[str, str] = {}
        for inner in tree.table_at(self.diagram, ("inputs",)):
            if any(sink.startswith(f"{self.name}.{inner}[") for sink in wires):
                what = f"the elements of its input {quoted(inner)} have separate wires, which ungroup cannot keep."
                raise UsageError(self.spot.fault("E501", self.name, what))
            if f"{self.name}.{inner}" in wires:
                self.into[inner] = wires[f"{self.name}.{inner}"]
        self.out = {
            output: self.source(source) for output, source in tree.table_at(self.diagram, ("outputs",)).items()
        }

    def source(self, text: str) -> str:
        """A source in the subdiagram as the diagram around it says it."""
        first = re.split(r"[.\[]", text, maxsplit=1)[0]
        if first in tree.table_at(self.diagram, ("inputs",)):
            if first not in self.into:
                what = f"its input {quoted(first)} has no wire."
                raise UsageError(self.spot.fault("E501", self.name, what, "Wire it first."))
            return self.into[first] + text[len(first) :]
        return text

    def outer(self, text: str) -> str:
        """A source in the diagram around: an output of the subdiagram is its source."""
        whole, elements = _ELEMENTS.match(text).groups()  # type: ignore[union-attr]  # it matches always
        first, dot, port = whole.partition(".")
        return self.out[port] + elements if dot and first == self.name and port in self.out else text

    def shorter(self, document: Document, found: list[Reference]) -> object:
        """The document of a file without the name of the subdiagram in its paths."""
        target = Target(self.spot.file, self.spot.scope, "block", self.name)
        own = [self.path, *((*self.spot.scope, section) for section in ("wires", "outputs", "layout"))]
        is_here = os.path.realpath(document.file) == self.spot.file
        cuts: list[Reference] = []
        for reference in found:
            if target not in reference.targets or (is_here and tree.is_within(reference.path, own)):
                continue
            value: Any = document.value
            for step in reference.path:
                value = value[step]
            text = str(reference.path[-1]) if reference.is_key else str(value)
            rest = text[reference.end + 1 :]
            whole, _ = _ELEMENTS.match(rest).groups()  # type: ignore[union-attr]  # it matches always
            if rest.partition(".")[0] in self.blocks.values() and whole not in self.out:
                cuts.append(replace(reference, end=reference.end + 1, targets=frozenset([_CUT])))
            elif whole in self.out or whole in self.into or whole in self.parameters.values():
                new = self.out.get(whole) or self.into.get(whole) or whole
                end = reference.end + 1 + len(whole)
                cuts.append(replace(reference, end=end, targets=frozenset([target._replace(name=new)])))
            else:
                what = f"{quoted(text)} refers to the subdiagram itself, which would no longer exist."
                place = (document.key_positions if reference.is_key else document.positions)[reference.path]
                fault = Fault("E501", place_of(reference.path), what, "Remove it first.", reference.path)
                raise UsageError(fault.at(document.file, *place))
        names = {target: "" if target is _CUT else target.name for cut in cuts for target in cut.targets}
        return tree.with_names(document.value, cuts, names)

    def value(self) -> Any:
        """The file without the subdiagram, and with what lay in it."""
        spot, name = self.spot, self.name
        body, value = spot.body.value, spot.value
        given = tree.table_at(self.block, ("parameters",))
        parameters = dict(tree.table_at(body, ("parameters",)))
        for parameter, default in tree.table_at(self.diagram, ("parameters",)).items():
            if parameter not in parameters:
                raw = given.get(parameter, default)
                unit = quantity_of(default).unit
                parameters[parameter] = {"value": raw, "unit": unit} if unit and is_number(raw) else raw
        stream = self.block.get("stream", name)
        lifted = dict(tree.table_at(self.diagram, ("blocks",)))
        for path, own in drawing(spot.file, self.targets_now(), spot.workspace).items():
            inner = path[len(self.path) + 2 :]
            own = own or self.old_name(str(inner[0]))
            if not own.startswith("/"):
                lifted = tree.replaced({"blocks": lifted}, ("blocks", *inner, "stream"), f"{stream}.{own}")["blocks"]
        blocks: dict[str, object] = {}
        for other, entry in body["blocks"].items():
            blocks |= lifted if other == name else {other: entry}
        wires = {
            sink: self.outer(source)
            for sink, source in tree.table_at(body, ("wires",)).items()
            if sink.partition(".")[0] != name
        }
        wires |= {sink: self.source(text) for sink, text in tree.table_at(self.diagram, ("wires",)).items()}
        outputs = {key: self.outer(source) for key, source in tree.table_at(body, ("outputs",)).items()}
        sections = (
            ("parameters", parameters), ("outputs", outputs), ("blocks", blocks), ("wires", wires),
            ("layout", self.layout(body)),
        )  # fmt: skip
        for section, entries in sections:
            value = _put_section(value, spot.scope, section, entries)
        return value

    def old_name(self, block: str) -> str:
        return next(old for old, new in self.blocks.items() if new == block)

    def targets_now(self) -> frozenset[Target]:
        scope = (*self.path, "diagram")
        return frozenset(Target(self.spot.file, scope, "block", name) for name in self.blocks.values())

    def layout(self, body: Mapping[str, object]) -> dict[str, Any]:
        """The positions: what lay in the subdiagram stands around the place where that stood."""
        layout = dict(tree.table_at(body, ("layout",)))
        inner = {
            name: at for name, at in tree.table_at(self.diagram, ("layout",)).items() if name in self.blocks.values()
        }
        at = layout.pop(self.name, None)
        if at and inner:
            centre = [round(sum(place[axis] for place in inner.values()) / len(inner)) for axis in (0, 1)]
            shift = [at[axis] - centre[axis] for axis in (0, 1)]
            inner = {
                name: place if shift == [0, 0] else [place[axis] + shift[axis] for axis in (0, 1)]
                for name, place in inner.items()
            }
        return layout | inner


_CUT = Target("", (), "block", "")


def _free(name: str, group: str, taken: set[str]) -> str:
    """A name that is not taken, the same one if possible."""
    names = [name, f"{group}_{name}", *(f"{group}_{name}_{count}" for count in range(2, len(taken) + 3))]
    return next(each for each in names if each not in taken)


# --- all files -------------------------------------------------------------------------------------------------


def _everywhere(spot: Spot, names: Collection[str], edit: Callable[[Document, list[Reference]], object]) -> None:
    """Edit the file, and where the whole project is meant all others that use the targets; else tell of these."""
    workspace = spot.workspace
    document = workspace.document(spot.file)
    others = {spot.file: replace(document, file=spot.file)}
    for other in files_with(names, spot.file, workspace.documents):
        if isinstance(other, str):
            workspace.note = other
        else:
            others.setdefault(os.path.realpath(other.file), other)
    for real, other in others.items():
        value = edit(other, references(other, real, workspace.documents))
        if same(value, other.value):
            continue
        if workspace.is_whole or workspace.is_named(real):
            workspace.put(workspace.open(Path(other.file)), value)
        else:
            workspace.tell(real, value)
