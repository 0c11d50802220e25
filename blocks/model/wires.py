"""Wires followed to their sources: where each element of each input comes from.

Wiring blocks (Mux, Demux) and the borders of subdiagrams dissolve on the way. What a wire can begin at is a node: an
output of a block, an input of a diagram, or an output of a subdiagram. Nodes are settled in order of dependency, with
a stack of our own, because a chain of them may be longer than Python's stack.

This file is longer than others: each fault of a wire is reported where it is found, with its cure.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, Literal, NamedTuple

import numpy as np

from ..contract.enumerations import enumeration_of, same_members, type_text
from ..contract.interface import Port
from ..contract.reads import arguments
from ..text import units
from ..text.element_names import indexed, named_element
from ..text.errors import ModelError
from ..text.json_document import AT_KEY
from ..text.printable import legible, quoted
from .copies import CopySource, EachSource, Fleet
from .diagram_grammar import shape_of
from .hierarchy import DiagramScope, Hierarchy, Leaf, Spot
from .values import Absent

COMMON = ".y"
"""How most outputs are called, so that it does not tell which one is meant."""


class BlockSource(NamedTuple):
    """An element that comes from an output of a block: the block's index, the variable, and which of its elements."""

    block: int
    variable: str
    element: int


class InputSource(NamedTuple):
    """An element that comes from an input of the diagram, by its place among all of their elements."""

    element: int


@dataclass(frozen=True, slots=True)
class ValueSource:
    """An element that is a number. It is no tuple, which would be equal to an input of that place."""

    value: float


Source = BlockSource | InputSource | ValueSource
"""Where one element comes from. Where there are copies, it may be an `EachSource` or a `CopySource` until they are
written out."""


@dataclass(frozen=True, slots=True)
class FlatInput:
    """An input of the whole diagram: its first element, shape, unit in SI and as declared, and defaults in SI."""

    name: str
    first: int
    shape: tuple[int, ...]
    unit: str
    declared: str
    type: str
    default: tuple[float, ...] | None


class Strand(NamedTuple):
    """Describe a wire: the source, units and type of each element; of a bus also the names of its elements.

    units: in SI. declared: the units that the ports declare, in which plain numbers about the signal are meant.
    """

    sources: tuple[Source, ...]
    units: tuple[str, ...]
    declared: tuple[str, ...]
    types: tuple[str, ...]
    shape: tuple[int, ...]
    names: tuple[str, ...] = ()

    @property
    def type(self) -> str:
        """The type of all elements; bools among numbers are 0 and 1."""
        types = set(self.types)
        return types.pop() if len(types) == 1 else "real"

    def part(self, k: slice, shape: tuple[int, ...]) -> Strand:
        """Return some elements, without their names."""
        return Strand(self.sources[k], self.units[k], self.declared[k], self.types[k], shape)

    def repeated(self, n: int, shape: tuple[int, ...]) -> Strand:
        """Return the elements n times, without their names."""
        return Strand(self.sources * n, self.units * n, self.declared * n, self.types * n, shape)


@dataclass(frozen=True, slots=True)
class WireElement:
    """One number on its way through a wiring block."""

    source: Source
    unit: str
    declared: str
    type: str
    name: str = ""


class WireSource(NamedTuple):
    """What a wire can begin at: an output of leaf `owner`, an input or an output of scope `owner`."""

    kind: Literal["port", "input", "output"]
    owner: int
    name: str


class Feed(NamedTuple):
    """A wire at its sink: the node that it comes from (None: faulty, already reported), which element, and its text."""

    node: WireSource | None
    element: int | str | None
    text: str


@dataclass(slots=True)
class Sink:
    """A block as wires see it: a leaf or a subdiagram."""

    block: Leaf | DiagramScope
    scope: DiagramScope  # the diagram around it
    inputs: Mapping[str, Port]
    outputs: Mapping[str, str]  # by name, with units
    copied: Fleet | None = None
    feeds: dict[str, Feed | dict[int, Feed]] = field(default_factory=dict)  # port -> its wire, or wires by element

    def wires(self, port: str) -> Iterable[Feed]:
        """The wires that end at an input."""
        port_feeds = self.feeds.get(port, {})
        return (port_feeds,) if isinstance(port_feeds, Feed) else port_feeds.values()


class Edge(NamedTuple):
    """An input or an output of a subdiagram at which a gate stands, and the sources of its elements."""

    scope: DiagramScope
    name: str
    sources: tuple[Source, ...]
    is_output: bool


def control_port(scope: DiagramScope) -> Port | None:
    """The input that enables or triggers a subdiagram."""
    if "enable" in scope.control:
        return Port("enable", "enable", (), 0, 1, ("",), ("",), "bool")
    if "direction" in scope.control.get("trigger", {}):
        return Port("trigger", "trigger", (), 0, 1, ("",), ("",), "real")
    return None


class Wires:
    """The sources of all inputs of a hierarchy's leaves; faults go to the hierarchy's list."""

    def __init__(self, hierarchy: Hierarchy) -> None:
        self.scopes, self.leaves = hierarchy.scopes, hierarchy.leaves
        self.faults, self.tell, self.evaluated = hierarchy.faults, hierarchy.tell, hierarchy.evaluated
        self.ports = [self.input_ports(scope) for scope in self.scopes]
        self.inputs = self.root_inputs()
        self.sinks: list[dict[str, Sink | None]] = [{} for _ in self.scopes]  # for each scope, by block
        self.ends: list[dict[str, Feed]] = [{} for _ in self.scopes]  # for each scope, by output
        self.settled: dict[WireSource, Strand | None] = {}
        self.spoiled: set[tuple[int, str, str]] = set()  # by scope, block and port: a misfit was reported
        self.taken: dict[tuple[int, str, str], Strand | None] = {}  # by scope, block and port
        self.rearranged: dict[tuple[int, str], list[WireElement] | None] = {}  # by wiring leaf and variable
        self.gates: list[Edge] = []  # of enabled and triggered subdiagrams; their blocks come after the leaves
        self.candidates: dict[int, dict[str, list[tuple[str, str]]]] = {}
        for scope in self.scopes:
            self.sinks[scope.index] = {name: self.sink(scope, child) for name, child in scope.children.items()}
        for scope in self.scopes:
            self.attach(scope)

    # --- what there is -----------------------------------------------------------------------------------------

    def input_ports(self, scope: DiagramScope) -> dict[str, Port]:
        ports = {}
        for name, entry in scope.value.inputs.items():
            shape, type_ = shape_of(entry.get("size", ())), type_text(entry.get("type", "real"))
            size = math.prod(shape)
            unit, default = str(entry.get("unit", "")), entry.get("default")
            try:
                si = units.si_text(unit)
            except ModelError as error:
                fault = error.faults[0]
                self.tell(scope, "E114", name, fault.message, fault.cure, ("inputs", name, "unit"))
                unit = si = ""
            if default is not None:
                default = self.default(scope, name, default, unit, type_, size)
            ports[name] = Port(name, name, shape, 0, size, (si,) * size, (unit,) * size, type_, default)
        return ports

    def default(self, scope: DiagramScope, name: str, raw: Any, unit: str, type_: Any, size: int) -> tuple[float, ...]:
        """Return the default of an input in SI, element by element."""
        if isinstance(raw, Mapping):
            value = self.evaluated(scope, raw, unit, name, ("inputs", name, "default"))
            raw, unit = (0.0 if value is None else value.value), ""
        kind = enumeration_of(type_)
        return tuple(
            units.to_si(float(item), unit, exact=getattr(item, "exact", None)) if kind is None else kind.number(item)
            for item in (_flat(raw) if isinstance(raw, (list, tuple)) else [raw] * size)
        )

    def root_inputs(self) -> dict[str, FlatInput]:
        flat_inputs: dict[str, FlatInput] = {}
        first = 0
        for name, port in self.ports[0].items():
            flat_inputs[name] = FlatInput(name, first, port.shape, port.unit, port.declared[0], port.type, port.default)
            first += port.size
        return flat_inputs

    def sink(self, scope: DiagramScope, child: Leaf | DiagramScope | None) -> Sink | None:
        if isinstance(child, Leaf):
            inputs = {name: of_copies(port, child.copied) for name, port in child.interface.inputs.items()}
            return Sink(child, scope, inputs, child.interface.output_units, child.copied)
        if isinstance(child, DiagramScope):
            ports, control = self.ports[child.index], control_port(child)
            if control is not None:
                if control.name in ports:
                    message = "is an input of the subdiagram and also its control signal."
                    place = f"{child.name}.{control.name}"
                    self.tell(scope, "E109", place, message, "Rename the input.", ("blocks", child.name))
                ports = {**ports, control.name: control}
            ports = {name: of_copies(port, child.copied) for name, port in ports.items()}
            return Sink(child, scope, ports, dict.fromkeys(child.value.outputs, ""), child.copied)
        return None

    # --- wires to their sinks ----------------------------------------------------------------------------------

    def attach(self, scope: DiagramScope) -> None:
        """Attach each wire of a diagram to the input of a block or the output of the diagram that it feeds."""
        sinks = self.sinks[scope.index]
        for text, source in scope.value.wires.items():
            spot = ("wires", text)
            base, element = indexed(text)
            name, _, port = base.partition(".")
            sink = sinks.get(name)
            if sink is not None and text.removeprefix(f"{name}.") in sink.inputs:  # an FMU's own name with brackets
                base, element, port = text, None, text.removeprefix(f"{name}.")
            if sink is not None and port in sink.outputs and self.is_input(scope, source):
                self.tell_turned(scope, text, source, spot)
                continue
            feed = self.feed(scope, source, text, spot)
            if sink is None:
                if name not in scope.children:
                    self.tell_no_block(scope, text, name, spot)
            elif port not in sink.inputs:
                self.tell_no_input(sink, text, source, name, port)
            elif element is not None and not self.has_element(sink.inputs[port], element):
                shape = sink.inputs[port].shape
                message = f"'{port}' {_extent(shape)}, so there is no [{element}]."
                cure = f'Write "{base}".' if shape == () else "Elements are counted from 0."
                self.tell(scope, "E105", legible(text), message, cure, (*spot, AT_KEY))
                self.spoiled.add((scope.index, name, port))
            elif isinstance(sink.feeds.get(port), Feed) or (element is None and port in sink.feeds):
                message = f"the input '{port}' of {name} is wired both as a whole and by element."
                self.tell(scope, "E109", legible(text), message, "Keep one of the two.", (*spot, AT_KEY))
                self.spoiled.add((scope.index, name, port))
            elif element is None:
                sink.feeds[port] = feed
            else:
                feeds = sink.feeds.setdefault(port, {})
                assert not isinstance(feeds, Feed)
                feeds[element] = feed
        for name, source in scope.value.outputs.items():
            self.ends[scope.index][name] = self.feed(scope, source, name, ("outputs", name))

    @staticmethod
    def has_element(port: Port, element: int) -> bool:
        return bool(port.shape) and element < port.shape[0]

    def tell_no_block(self, scope: DiagramScope, text: str, name: str, spot: tuple[str | int, ...]) -> None:
        if name in scope.value.outputs and "." not in text:
            message, cure = "is an output of the diagram, not an input of a block.", 'Move it to "outputs".'
        elif name in scope.value.inputs or name in scope.value.parameters:
            what = "an input of the diagram" if name in scope.value.inputs else "a parameter"
            message, cure = f"is {what}, but a wire must end at an input of a block.", ""
        else:
            message = f"there is no block {quoted(name)}."
            cure = self.faults.guess(name, scope.children) or 'Write a wire as "block.input": "block.output".'
        self.tell(scope, "E105", legible(text), message, cure, (*spot, AT_KEY))

    def tell_no_input(self, sink: Sink, text: str, source: str, name: str, port: str) -> None:
        code, spot = "E105", ("wires", text, AT_KEY)
        if not port:
            message, cure = "is a block, not one of its inputs.", f"Inputs: {_listed(sink.inputs)}."
        elif port in sink.outputs:
            code, message = "E112", f"'{port}' is an output of {name}, but a wire must end at an input."
            cure = f"Inputs: {_listed(sink.inputs)}."
        else:
            message = f"{name} has no input {quoted(port)}."
            cure = self.faults.guess(port, sink.inputs) or f"Inputs: {_listed(sink.inputs)}."
            cure = _each(name, port, sink.inputs) or cure
            if isinstance(sink.block, DiagramScope) and port.partition(".")[0] in sink.block.children:
                cure = f"A wire into a subdiagram must end at one of its inputs: {_listed(sink.inputs)}."
            if why := _why_no_port(sink, port):
                message, cure = f"{quoted(port)} of {name} {why}", "Leave the wire out: the FMU keeps its own value."
                if isinstance(sink.block, Leaf) and f"{port}_start" in sink.block.interface.declaration.parameters:
                    cure = f'Set its parameter "{port}_start".'
        self.tell(sink.scope, code, legible(text), message, cure, spot)

    def tell_turned(self, scope: DiagramScope, text: str, source: str, spot: Spot) -> None:
        """A wire that is written the wrong way round: one fault, and the input that it means counts as wired."""
        name, _, port = indexed(source)[0].partition(".")
        self.spoiled.add((scope.index, name, port))
        message = f"{legible(text)} is an output, and {legible(source)} is an input."
        cure = f"Write the input first: {quoted(source)}: {quoted(text)}."
        self.tell(scope, "E112", legible(text), message, cure, spot)

    def is_input(self, scope: DiagramScope, text: str) -> bool:
        name, _, port = indexed(text)[0].partition(".")
        sink = self.sinks[scope.index].get(name)
        return sink is not None and port in sink.inputs

    def feed(self, scope: DiagramScope, text: str, sink_text: str, spot: Spot) -> Feed:
        """The node that a source text names; a fault is reported where there is none."""
        element: int | str | None
        base, element = indexed(text)
        name, _, port = base.partition(".")
        sink = self.sinks[scope.index].get(name)
        if sink is not None and text.removeprefix(f"{name}.") in sink.outputs:  # an FMU's own name with brackets
            element, port = None, text.removeprefix(f"{name}.")
        elif named_element(text)[1]:
            base, element = named_element(text)
            name, _, port = base.partition(".")
            sink = self.sinks[scope.index].get(name)
        if not port and name in scope.value.inputs:
            return Feed(WireSource("input", scope.index, name), element, text)
        if sink is not None and port in sink.outputs:
            kind: Literal["port", "output"] = "port" if isinstance(sink.block, Leaf) else "output"
            return Feed(WireSource(kind, sink.block.index, port), element, text)
        place = legible(sink_text)
        if sink is not None:
            code, message = "E105", f"{name} has no output {quoted(port)}."
            if not port:
                message = f"{name} is a block, not a signal."
            outputs = ", ".join(f"{port}{_bracket(unit)}" for port, unit in sink.outputs.items()) or "none"
            cure = f"{self.faults.guess(port, sink.outputs)} Outputs: {outputs}.".strip()
            cure = _each(name, port, sink.outputs) or cure
            if isinstance(sink.block, DiagramScope) and port.partition(".")[0] in sink.block.children:
                cure = f"A wire from a subdiagram must begin at one of its outputs: {outputs}."
            if why := _why_no_port(sink, port):
                message, cure = f"{quoted(port)} of {name} {why}", "Leave the wire out."
            if port in sink.inputs:
                code, message = "E112", f"'{port}' is an input of {name}, but a wire must begin at an output."
            self.tell(scope, code, place, message, cure, spot)
        elif name not in scope.children:
            what, cure = "not there", self.faults.guess(text, self.all_sources(scope))
            if name in scope.value.parameters:
                what, cure = "a parameter, not a signal", f'Use a Constant with "value": "={name}".'
            base, number = indexed(name)
            if number is not None and getattr(scope.children.get(base), "copied", None) is not None:
                cure = f'For copy {number}, write the element of the port: "{base}.{port}[{number}]".'
            cure = cure or 'Use "block.output", or an input of the diagram.'
            self.tell(scope, "E105", place, f"the source {quoted(text)} is {what}.", cure, spot)
        return Feed(None, element, text)

    def all_sources(self, scope: DiagramScope) -> list[str]:
        """The texts that wires of a diagram may begin with."""
        return [text for texts in self.sources_by_name(scope).values() for text, _ in texts]

    def sources_by_name(self, scope: DiagramScope) -> dict[str, list[tuple[str, str]]]:
        """The texts that wires of a diagram may begin with, and their units, by the last part of the text."""
        if scope.index not in self.candidates:
            by_name: dict[str, list[tuple[str, str]]] = {}
            for name, port in self.ports[scope.index].items():
                by_name.setdefault(name, []).append((name, port.unit))
            for name, sink in self.sinks[scope.index].items():
                for output, unit in sink.outputs.items() if sink is not None else ():
                    by_name.setdefault(output, []).append((f"{name}.{output}", unit))
            self.candidates[scope.index] = by_name
        return self.candidates[scope.index]

    # --- from a node back to the sources -----------------------------------------------------------------------

    def strand(self, node: WireSource) -> Strand | None:
        """What begins at a node; None where a fault was reported."""
        if node not in self.settled:
            if node.kind == "port" and node.name not in self.leaves[node.owner].interface.rearranged:
                self.settled[node] = self.made(node)  # it needs nothing
            else:
                self.settle(node)
        return self.settled[node]

    def settle(self, node: WireSource) -> None:
        under_way: dict[WireSource, None] = {node: None}
        stack: list[tuple[WireSource, Iterator[Feed]]] = [(node, iter(self.needs(node)))]
        while stack:
            node, rest = stack[-1]
            for feed in rest:
                needed = feed.node
                if needed is None or needed in self.settled:
                    continue
                if needed in under_way:
                    self.tell_circle([*under_way], needed)
                    self.settled[needed] = None
                    continue
                under_way[needed] = None
                stack.append((needed, iter(self.needs(needed))))
                break
            else:
                if node not in self.settled:
                    self.settled[node] = self.made(node)
                stack.pop()
                del under_way[node]

    def needs(self, node: WireSource) -> Iterable[Feed]:
        """The wires that a node passes on."""
        if node.kind == "port":
            leaf = self.leaves[node.owner]
            return self.feeds_of(leaf.scope, leaf.name) if node.name in leaf.interface.rearranged else ()
        if node.kind == "output":
            return (self.ends[node.owner][node.name],)
        scope = self.scopes[node.owner]
        if scope.parent is None:
            return ()
        sink = self.sinks[scope.parent.index][scope.name]
        assert sink is not None
        return sink.wires(node.name)

    def feeds_of(self, scope: DiagramScope, name: str) -> Iterator[Feed]:
        sink = self.sinks[scope.index][name]
        assert sink is not None
        for port in sink.feeds:
            yield from sink.wires(port)

    def tell_circle(self, under_way: list[WireSource], node: WireSource) -> None:
        circle = [self.name_of(passed) for passed in under_way[under_way.index(node) :]][::-1]
        circle = [circle[-1], *circle]
        if len(circle) > 20:
            circle = [*circle[:10], f"... ({len(circle) - 13:,} more)", *circle[-3:]]
        chain = " -> ".join(circle)
        scope = self.leaves[node.owner].scope if node.kind == "port" else self.scopes[node.owner]
        place = self.name_of(node)[len(scope.prefix) :]
        spot = ("blocks", place.partition(".")[0]) if node.kind == "port" else (f"{node.kind}s", node.name)
        cure = "Put a block that gives a value into the circle."
        self.tell(scope, "E102", place, f"wires form a circle that contains no value: {chain}.", cure, spot)

    def name_of(self, node: WireSource) -> str:
        path = self.leaves[node.owner].path + "." if node.kind == "port" else self.scopes[node.owner].prefix
        return path + node.name

    def made(self, node: WireSource) -> Strand | None:
        """A node's strand, once all that it needs is settled."""
        if node.kind == "port":
            leaf = self.leaves[node.owner]
            port = leaf.interface.outputs[node.name]
            if node.name in leaf.interface.rearranged:
                all_ = self.rearrangement(leaf, port.variable)
                if all_ is None:
                    return None
                strand = _strand(all_[port.first : port.first + port.size], port.shape)
                names = leaf.interface.structural.get("names")
                names = bus_names(names) if isinstance(names, str) else ()
                strand = strand._replace(names=names) if len(names) == port.size and port.shape else strand
                return leaving(leaf.copied, strand)
            places = range(port.first, port.first + port.size)
            owned = tuple([BlockSource(leaf.index, port.variable, place) for place in places])
            return leaving(leaf.copied, Strand(owned, port.units, port.declared, port.types, port.shape))
        scope = self.scopes[node.owner]
        if node.kind == "output":
            try:
                strand = self.carried(scope, self.ends[node.owner][node.name], node.name, ("outputs", node.name))
            except Absent:
                return None
            if scope.control.get("enable", {}).get("outputs") == "reset":
                strand = self.gated(scope, node.name, strand, is_output=True)
            return leaving(scope.copied, strand)
        port = self.ports[node.owner][node.name]
        if scope.parent is None:
            first = self.inputs[node.name].first
            sources = tuple([InputSource(first + i) for i in range(port.size)])
            return Strand(sources, port.units, port.declared, port.types, port.shape)
        fed = self.entering(scope.parent, scope.name, port.name)
        if fed is None:
            return None
        units_ = tuple(own or given for own, given in zip(port.units, fed.units, strict=True))
        declared = tuple(own or given for own, given in zip(port.declared, fed.declared, strict=True))
        entering = Strand(fed.sources, units_, declared, port.types, port.shape, fed.names)
        return self.gated(scope, node.name, entering) if scope.control else entering

    def gated(self, scope: DiagramScope, name: str, strand: Strand, *, is_output: bool = False) -> Strand:
        """A strand as it comes out of the gate of an input or an output of a subdiagram."""
        index = len(self.leaves) + len(self.gates)
        self.gates.append(Edge(scope, name, strand.sources, is_output))
        return strand._replace(sources=tuple(BlockSource(index, "y", k) for k in range(len(strand.sources))))

    def control_sources(self, scope: DiagramScope) -> tuple[Source, ...] | None:
        """What enables or triggers a subdiagram; None where a fault was reported."""
        port = control_port(scope)
        if port is None or scope.parent is None:
            return ()
        fed = self.entering(scope.parent, scope.name, port.name)
        return None if fed is None else fed.sources

    def rearrangement(self, leaf: Leaf, variable: str) -> list[WireElement] | None:
        """An output of a wiring block: its equation, run on the elements of its inputs."""
        key = (leaf.index, variable)
        if key not in self.rearranged:
            self.rearranged[key] = self.rearrange(leaf, variable)
        return self.rearranged[key]

    def rearrange(self, leaf: Leaf, variable: str) -> list[WireElement] | None:
        interface = leaf.interface
        output = interface.declaration.outputs[variable]
        values: dict[str, object] = dict(interface.structural)
        parts: dict[str, list[WireElement]] = {name: [] for name in interface.declaration.inputs}
        complete = True
        for port in interface.inputs.values():
            fed = self.entering(leaf.scope, leaf.name, port.name)
            if fed is None:
                complete = False
            else:
                names = fed.names or ("",) * len(fed.sources)
                parts[port.variable] += [WireElement(*element) for element in zip(*fed[:4], names, strict=True)]
        if not complete:
            return None
        for name, part in parts.items():
            array = np.empty(len(part), dtype=object)
            array[:] = part
            values[name] = array.reshape(interface.shape(interface.declaration.inputs[name]))
        shape = interface.shape(output)
        try:
            elements = np.asarray(
                output.equation.function(*(values[name] for name in output.equation.reads)), dtype=object
            )
            message = f"its function returns an array that {_extent(elements.shape)}, but the output {_extent(shape)}."
            message = "" if elements.shape == shape else message
        except Exception as error:  # a function of the class may raise anything
            elements, message = np.empty(0), f"cannot be computed: {type(error).__name__}: {error}."
        if not message and not all(isinstance(element, WireElement) for element in elements.flat):
            message = "its function returns something that is not an element of an input."
        if message:
            cure = "A wiring function may only select and reorder elements of inputs."
            self.tell(leaf.scope, "E110", f"{leaf.name}.{variable}", message, cure, ("blocks", leaf.name))
            return None
        return list(elements.flat)

    # --- what reaches an input ---------------------------------------------------------------------------------

    def sources(self, leaf: Leaf) -> dict[str, tuple[Source, ...]] | None:
        """The source of each element of each input variable; None where a fault was reported."""
        interface = leaf.interface
        for feed in self.feeds_of(leaf.scope, leaf.name):
            if feed.node is not None and feed.node not in self.settled:
                self.strand(feed.node)
        # An input that is many ports has them one after the other.
        parts: dict[str, list[tuple[Source, ...]]] = {name: [] for name in interface.declaration.inputs}
        take = self.entering if interface.rearranged or leaf.copied else self.taken_once
        complete = True
        for port in interface.inputs.values():
            fed = take(leaf.scope, leaf.name, port.name)
            if fed is None:
                complete = False
            else:
                parts[port.variable].append(fed.sources)
        if not complete:
            return None
        return {name: part[0] if len(part) == 1 else tuple(chain(*part)) for name, part in parts.items()}

    def entering(self, scope: DiagramScope, name: str, port: str) -> Strand | None:
        """What reaches an input of a subdiagram, of copies or of a wiring block, as it is seen inside; kept, as it is
        asked for more than once."""
        key = (scope.index, name, port)
        if key not in self.taken:
            fed, sink = self.taken_once(scope, name, port), self.sinks[scope.index][name]
            assert sink is not None
            self.taken[key] = fed if fed is None or sink.copied is None else entered(sink.copied, fed)
        return self.taken[key]

    def taken_once(self, scope: DiagramScope, name: str, port: str) -> Strand | None:
        """What reaches an input of a block; None where a fault was reported."""
        sink = self.sinks[scope.index][name]
        assert sink is not None
        try:
            return self.reaching(scope, name, sink, sink.inputs[port])
        except Absent:
            return None

    def reaching(self, scope: DiagramScope, name: str, sink: Sink, port: Port) -> Strand:
        if self.spoiled and (scope.index, name, port.name) in self.spoiled:
            raise Absent
        feeds = sink.feeds.get(port.name, {})
        if isinstance(feeds, Feed):
            return self.fitting(scope, f"{name}.{port.name}", feeds, port, None, sink.copied)
        elements: list[WireElement | None] = [None] * port.size
        if port.default is not None:
            given = zip(map(ValueSource, port.default), port.units, port.declared, port.types, strict=True)
            elements = [WireElement(*element) for element in given]
        absent = False
        for index, feed in feeds.items():
            try:
                strand = self.fitting(scope, f"{name}.{port.name}[{index}]", feed, port, index)
                part = [WireElement(*element) for element in zip(*strand[:4], strict=True)]
                elements[index * len(part) : (index + 1) * len(part)] = part
            except Absent:
                absent = True
        if absent:
            raise Absent
        complete = [element for element in elements if element is not None]
        if len(complete) < len(elements):
            row = elements.index(None) // math.prod(port.shape[1:])
            at = f"{name}.{port.name}" + (f"[{row}]" if feeds else "")
            message = "this element of the input is not wired." if feeds else "input is not wired."
            self.tell(scope, "E101", at, message, self.wire_meant(scope, name, at, port), ("blocks", name, AT_KEY))
            raise Absent
        return _strand(complete, port.shape)

    def wire_meant(self, scope: DiagramScope, name: str, at: str, port: Port) -> str:
        """The cure for an input that is not wired: the source of its name and quantity, if there is one alone."""
        named = self.sources_by_name(scope).get(port.name, ())
        found = [
            text for text, unit in named
            if not text.startswith(f"{name}.") and not text.endswith(COMMON) and units.same_quantity(unit, port.unit)
        ]  # fmt: skip
        taken = {source for sink, source in scope.value.wires.items() if sink.partition(".")[0] == name}
        if len(found) == 1 and found[0] not in taken:
            return f'Did you mean "{at}": "{found[0]}"?'
        return f'Add "{at}": "block.output" to the wires.'

    def carried(self, scope: DiagramScope, feed: Feed, place: str, spot: Spot) -> Strand:
        """What a wire carries, whole or one element of it."""
        strand = None if feed.node is None else self.strand(feed.node)
        if strand is None:
            raise Absent
        if feed.element is None:
            return strand
        if isinstance(feed.element, str):
            return self.of_bus(scope, strand, feed.text, place, spot)
        if not strand.shape or feed.element >= strand.shape[0]:
            message = f"{indexed(feed.text)[0]} {_extent(strand.shape)}, so there is no [{feed.element}]."
            cure = f'Write "{indexed(feed.text)[0]}".' if strand.shape == () else "Elements are counted from 0."
            self.tell(scope, "E105", place, message, cure, spot)
            raise Absent
        row = math.prod(strand.shape[1:])  # of a matrix, as of the vectors of copies, an element is a row
        k = slice(feed.element * row, (feed.element + 1) * row)
        return strand.part(k, strand.shape[1:])

    def of_bus(self, scope: DiagramScope, strand: Strand, text: str, place: str, spot: Spot) -> Strand:
        """The element that a wire takes from a bus by its name."""
        base, name = named_element(text)
        if name not in strand.names:
            known = [known for known in strand.names if known]
            cure = f"{self.faults.guess(name, known)} Elements: {', '.join(known)}.".strip()
            if not known:
                numbers = f'Its elements have no names. Use a number, as in "{base}[0]", or give names'
                cure = f'{numbers} with the parameter "names" of a Mux; blocks with equations pass none on.'
            self.tell(scope, "E105", place, f"{base} has no element {quoted(name)}.", cure, spot)
            raise Absent
        k = strand.names.index(name)
        return strand.part(slice(k, k + 1), ())

    def fitting(
        self, scope: DiagramScope, at: str, feed: Feed, port: Port, index: int | None, copied: Fleet | None = None
    ) -> Strand:
        """What a wire brings to an input, or to one element of it, if it fits in shape, quantity and type.

        copied: the copies of the block; what has the size of one reaches all of them.
        """
        spot = ("wires", at)
        strand = self.carried(scope, feed, at, spot)
        shape, wanted = port.shape, port.units
        if index is not None:
            shape, row = port.shape[1:], math.prod(port.shape[1:])
            wanted = port.units[index * row : (index + 1) * row]
        elif copied is not None and strand.shape == shape[1:]:
            n = copied.count
            strand = strand.repeated(n, shape)._replace(names=strand.names)
        if strand.shape != shape:
            source = scope.children.get(feed.text.partition(".")[0])
            of = None if source is None or feed.element is not None else source.copied
            message = f"{_extent(shape)}{_for_each(copied)}, but {feed.text} {_extent(strand.shape)}{_for_each(of)}."
            cure = ""
            if strand.shape == (1,) and shape == ():
                cure = f'Wire its element: "{feed.text}[0]".'
            elif shape == ():
                cure = f'Wire one {"element" if of is None else "copy"}, as in "{feed.text}[0]"'
                cure += f', or give the block "copies": {strand.shape[0]}.' if len(strand.shape) == 1 else "."
            elif copied is not None:
                cure = "Wire one value for each copy, or one value for all copies."
            elif strand.shape == () and shape == (1,):
                cure = f'Wire its element: "{at}[0]".'
            elif strand.shape == ():
                cure = f'Wire each element, as in "{at}[0]", or use a Mux.'
            self.tell(scope, "E110", at, message, cure, spot)
            raise Absent
        if wanted == strand.units and (port.type,) * len(wanted) == strand.types:
            return strand
        for needed, unit, type_ in zip(wanted, strand.units, strand.types, strict=True):
            if not units.same_quantity(needed, unit):
                place = f"{at} [{needed}] <- {feed.text} [{unit}]"
                gain = f'a Gain with "unit_u": {quoted(unit)} and "unit": {quoted(needed)}'
                parameter = self.unit_parameter(scope, at, port)
                cure = f"Check the wire{parameter}, or insert {gain}."
                self.tell(scope, "E104", place, f"{needed} and {unit} are different quantities.", cure, spot)
                raise Absent
            if not _fits(port.type, type_):
                what = f"is {_typed(port.type)}, but {feed.text} is {_typed(type_)}."
                cure = "Insert a CompareToConstant, which turns a number into a bool." if port.type == "bool" else ""
                if cure and port.name == "control":
                    cure += " For a Switch, use SwitchAbove instead: its control is a number."
                if (wanted_ := enumeration_of(port.type)) is not None:
                    entry = json.dumps(wanted_.entry, ensure_ascii=False)
                    first = json.dumps(next(iter(wanted_.members)), ensure_ascii=False)
                    cure = "Wire an input of the diagram or an output of this type."
                    if len(entry) < 200:
                        cure = f'Wire an input of the diagram: {{"type": {entry}, "default": {first}}}.'
                self.tell(scope, "E104", at, what, cure, spot)
                raise Absent
        return strand

    @staticmethod
    def unit_parameter(scope: DiagramScope, at: str, port: Port) -> str:
        """Words for the parameter that gives an input its unit, if there is one."""
        name = at.partition(".")[0]
        leaf = scope.children.get(name)
        if not isinstance(leaf, Leaf):
            return ""
        variable = leaf.interface.declaration.inputs.get(port.variable)
        unit = getattr(variable, "unit", None)
        names = [arg for arg in arguments(unit, port.variable) if arg.startswith("unit")] if callable(unit) else []
        return f' and the "{names[0]}" of {name}' if names else ""


def of_copies(port: Port, copied: Fleet | None) -> Port:
    """A port of a block as the port of its copies: it has one more dimension, which comes first."""
    if copied is None:
        return port
    n = copied.count
    return replace(
        port, shape=(n, *port.shape), first=0, size=n * port.size, units=port.units * n, declared=port.declared * n,
        default=port.default and port.default * n,
    )  # fmt: skip


def entered(copied: Fleet, strand: Strand) -> Strand:
    """What reaches copies, as it is seen in each of them."""
    n = copied.count
    size = len(strand.sources) // n
    columns = (strand.sources[element::size] for element in range(size))
    sources: tuple[Any, ...] = tuple(
        column[0] if column[:-1] == column[1:] else EachSource(copied, column) for column in columns
    )
    one = strand.part(slice(size), strand.shape[1:])
    return one._replace(sources=sources, names=strand.names[:size])


def leaving(copied: Fleet | None, strand: Strand) -> Strand:
    """What comes out of a block, of copies: of all of them, one after the other."""
    if copied is None:
        return strand
    n = range(copied.count)
    sources = tuple([_left(copied, number, source) for number in n for source in strand.sources])
    shape = (copied.count, *strand.shape)
    return strand.repeated(copied.count, shape)._replace(sources=sources)


def _left(copied: Fleet, number: int, source: object) -> Any:
    if isinstance(source, EachSource) and source.fleet is copied:
        return source.sources[number]
    return source if isinstance(source, (InputSource, ValueSource)) else CopySource(copied, number, source)


def _flat(rows: object) -> Iterator[Any]:
    """The values of nested lists, in C order."""
    for item in rows if isinstance(rows, list) else ():
        yield from _flat(item) if isinstance(item, list) else (item,)


def _each(name: str, port: str, ports: Collection[str]) -> str:
    """Return the cure for a vector whose elements are ports of their own, as in FMUs of FMI 2; "" for no vector."""
    found = [other for other in ports if indexed(other)[0] == port != other]
    if not found:
        return ""
    shown = ", ".join(f"{name}.{other}" for other in found[:3]) + (" and so on" if len(found) > 3 else "")
    return f"Each element is a port of its own: wire {shown}."


def _why_no_port(sink: Sink, name: str) -> str:
    """Why a variable of an FMU is no port of its block."""
    foreign = sink.block.interface.declaration.foreign if isinstance(sink.block, Leaf) else None
    return foreign.why_no_port(name) if foreign is not None else ""


def _strand(elements: list[WireElement], shape: tuple[int, ...]) -> Strand:
    return Strand(
        tuple(element.source for element in elements),
        tuple(element.unit for element in elements),
        tuple(element.declared for element in elements),
        tuple(element.type for element in elements),
        shape,
        tuple(element.name for element in elements) if shape and any(element.name for element in elements) else (),
    )


def bus_names(text: str) -> tuple[str, ...]:
    """The names of a bus, as its Mux has them: "x, y, theta"."""
    return tuple(name.strip() for name in text.split(","))


def _fits(wanted: str, given: str) -> bool:
    """Whether a value of one type can stand for another: bools are 0 and 1, and an int is a number."""
    if wanted == given:
        return True
    if given.startswith("enum"):
        return same_members(wanted, given)
    return wanted == "real" or (wanted == "int" and given == "bool")


def _typed(type_: str) -> str:
    words = {"real": "a number", "int": "an integer", "bool": "a bool"}
    return words.get(type_) or f"of the {type_}"


def _bracket(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _listed(ports: Mapping[str, Port]) -> str:
    return ", ".join(f"{name}{_bracket(port.unit)}" for name, port in ports.items()) or "none"


def _for_each(copied: Fleet | None) -> str:
    """What the elements of a port are, if its block has copies."""
    if copied is None:
        return ""
    if copied.count == 1:
        return f", for the 1 copy of {copied.path}"
    return f", one for each of the {copied.count:,} copies of {copied.path}"


def _extent(shape: tuple[int, ...]) -> str:
    if shape in ((), (1,)):
        return "has 1 element" if shape else "is a single value"
    return f"has {' x '.join(map(str, shape))} elements"
