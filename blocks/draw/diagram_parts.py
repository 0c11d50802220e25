"""What a diagram consists of, for drawing: its blocks, terminals and nets, by names, before they have places.

Diagrams with faults are read as far as they can be: a block whose type is unknown has the ports that wires name, and
a wire whose source is unknown is left out, so that its sink shows as unwired.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

from ..contract.interface import Interface
from ..contract.variables import REQUIRED
from ..model.diagram_value import BlockEntry, DiagramValue
from ..model.flatten import interface_of
from ..model.hierarchy import Resolver
from ..text.errors import ModelError

BEFORE = "\0"
"""Prefix of a port's name for the end of a wire that another wire has replaced."""

ELEMENT = re.compile(r"(.*)\[([0-9]{1,9})\]\Z", re.DOTALL)
MOST_ELEMENTS = 64  # of a partly wired vector; of a longer one, only the wired elements are drawn


@dataclass(frozen=True, slots=True)
class Ports:
    """The port names of a block from top to bottom.

    optional: inputs that may stay unwired. sizes: ports that are vectors. defaults: raw values of parameters that
    the diagram does not give. An empty `Ports` (`known` False) leaves the ports to be found from the wires.
    """

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()
    sizes: Mapping[str, int] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    known: bool = True

    @classmethod
    def of(cls, interface: Interface) -> Ports:
        """Return the ports of a block type whose sizes are known, but for those without elements."""
        inputs, outputs = (
            {name: port for name, port in ports.items() if port.size} for ports in (interface.inputs, interface.outputs)
        )
        parameters = interface.declaration.parameters
        return cls(
            tuple(inputs),
            tuple(outputs),
            frozenset(name for name, port in inputs.items() if port.default is not None),
            {name: port.size for name, port in (*inputs.items(), *outputs.items()) if port.shape},
            {n: p.default for n, p in parameters.items() if p.default is not REQUIRED and not callable(p.default)},
        )


UNKNOWN = Ports(known=False)


def ports_of(diagram: DiagramValue, resolver: Resolver) -> Callable[[str], Ports]:
    """The ports of any block of a diagram by its path ("control_right.td"); `UNKNOWN` where it has faults.

    resolver: from the name of a type to its class, as for `flatten`.
    """
    alike: dict[tuple[str, str, Any], Ports] = {}  # blocks of one level with the same type and parameters

    def ports(path: str) -> Ports:
        *outer, name = path.split(".")
        inner = diagram
        for step in outer:
            below = inner.blocks[step].inner
            if below is None:
                return UNKNOWN
            inner = below
        entry = inner.blocks[name]
        key = ".".join(outer), repr(entry), entry.cls
        if key not in alike:
            alike[key] = _ports(inner, name, resolver)
        return alike[key]

    return cache(ports)


def _ports(diagram: DiagramValue, name: str, resolver: Resolver) -> Ports:
    # Alone, so that the faults of its neighbors do not hide its ports.
    probe = replace(diagram, blocks={name: diagram.blocks[name]}, measures={}, run={}, layout={})
    try:
        return Ports.of(interface_of(probe, name, resolver))
    except (ModelError, AssertionError, KeyError):
        return UNKNOWN


@dataclass
class Part:
    """A block or a terminal. kind: block, diagram, fmu, input or output. name: as the file has it."""

    name: str
    path: str
    kind: str
    entry: BlockEntry | None = None
    ports: Ports = UNKNOWN
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    unwired: set[str] = field(default_factory=set)
    replaced: list[str] = field(default_factory=list)  # inputs whose wire replaced another, which is drawn too


@dataclass
class Net:
    """A net: from a port of a part to ports of parts."""

    name: str
    source: tuple[int, str]
    wide: bool
    sinks: list[tuple[int, str]] = field(default_factory=list)


@dataclass
class Parts:
    """One level of a diagram: inputs, blocks, outputs, in this order, and the nets between them."""

    diagram: DiagramValue
    parts: list[Part]
    signals: list[Net]


def parts_of(
    diagram: DiagramValue,
    ports: Callable[[str], Ports],
    prefix: str,
    replaced: Sequence[tuple[str, str, bool]],
) -> Parts:
    """The parts of one level. prefix: the path of the diagram, "" or with a dot at its end.

    replaced: wires that others have replaced, as (sink, source, whether the sink is an output of the diagram).
    """
    parts = [Part(name, prefix + name, "input", outputs=[""]) for name in diagram.inputs]
    parts += [_block(name, entry, prefix, ports) for name, entry in diagram.blocks.items()]
    first_output = len(parts)
    parts += [Part(name, prefix + name, "output", inputs=[""]) for name in diagram.outputs]
    place = {part.name: index for index, part in reversed(list(enumerate(parts[:first_output])))}
    wires = [(_end(sink, place), source) for sink, source in diagram.wires.items()]
    wires += [((first_output + index, ""), source) for index, source in enumerate(diagram.outputs.values())]
    first_replaced = len(wires)
    outputs = {name: (first_output + index, "") for index, name in enumerate(diagram.outputs)}
    wires += [(outputs.get(sink) if out else _end(sink, place), source) for sink, source, out in replaced]
    pairs: list[tuple[End, End]] = []
    for goal, text in wires:
        origin = _end(text, place) if isinstance(text, str) else None
        known_goal = goal is not None and parts[goal[0]].kind != "input"
        pairs.append((origin, goal if known_goal else None))
    _complete(parts, pairs)
    for index, (origin, goal) in enumerate(pairs[first_replaced:], first_replaced):
        if origin is not None and goal is not None:
            pairs[index] = (origin, (goal[0], BEFORE + goal[1]))
            parts[goal[0]].replaced.append(goal[1])
    signals: dict[tuple[int, str], Net] = {}
    for origin, goal in pairs:
        if origin is None or goal is None:
            continue
        part = parts[origin[0]]
        if origin not in signals:
            name = f"{part.path}.{origin[1]}" if origin[1] else part.path
            wide = part.ports.sizes.get(origin[1], 1) > 1
            signals[origin] = Net(name, origin, wide)
        if goal not in signals[origin].sinks:
            signals[origin].sinks.append(goal)
    for signal in signals.values():
        for index, port in signal.sinks:
            parts[index].unwired.discard(port)
    return Parts(diagram, parts, list(signals.values()))


def _block(name: str, entry: BlockEntry, prefix: str, ports: Callable[[str], Ports]) -> Part:
    path = prefix + name
    inner = entry.inner
    if inner is not None:
        optional = frozenset(key for key, raw in inner.inputs.items() if isinstance(raw, Mapping) and "default" in raw)
        inputs = (*inner.inputs, *entry.control_inputs)
        return Part(name, path, "diagram", entry, _of_copies(entry, Ports(inputs, tuple(inner.outputs), optional)))
    kind = "fmu" if entry.fmu else "block" if entry.diagram is None else "diagram"
    return Part(name, path, kind, entry, _of_copies(entry, ports(path)))


def _of_copies(entry: BlockEntry, ports: Ports) -> Ports:
    """The ports of a block that has copies: vectors of some size."""
    if entry.copies is None:
        return ports
    return replace(ports, sizes=dict.fromkeys((*ports.inputs, *ports.outputs), MOST_ELEMENTS + 1))


def _end(text: str, place: Mapping[str, int]) -> tuple[int, str] | None:
    """The part and the port that a wire's end names; None where there is no such part."""
    name, dot, port = text.partition(".")
    if name in place and dot and port:
        return place[name], port
    element = ELEMENT.match(text)
    if not dot and text in place:
        return place[text], ""
    if not dot and element and element[1] in place:
        return place[element[1]], ""
    return None


End = tuple[int, str] | None


def _complete(parts: list[Part], pairs: list[tuple[End, End]]) -> None:
    """Give each block its ports: those of its type, as elements where wires name some, and those only wires name."""
    used: dict[tuple[int, int], dict[str, None]] = {}
    for ends in pairs:
        for side, end in enumerate(ends):
            if end is not None:
                used.setdefault((end[0], side), {})[end[1]] = None
    for index, part in enumerate(parts):
        if part.entry is None:
            part.unwired = set(part.inputs)
            continue
        part.outputs = _with_elements(part.ports.outputs, used.get((index, 0), {}), {})
        part.inputs = _with_elements(part.ports.inputs, used.get((index, 1), {}), part.ports.sizes)
        optional = part.ports.optional
        wanted = part.inputs if part.ports.known else []
        part.unwired = {name for name in wanted if name not in optional and _base(name) not in optional}


def _base(name: str) -> str:
    element = ELEMENT.match(name)
    return element[1] if element else name


def _with_elements(known: tuple[str, ...], used: Mapping[str, None], sizes: Mapping[str, int]) -> list[str]:
    """The known ports and those that are used. sizes: of vectors that must be wired as a whole."""
    elements: dict[str, list[str]] = {}
    for name in used:
        if name not in known and _base(name) in known:
            elements.setdefault(_base(name), []).append(name)
    ports: list[str] = []
    for name in known:
        if name not in elements or name in used:
            ports.append(name)
        if name in elements:
            own = elements[name]
            if sizes.get(name, 0) <= MOST_ELEMENTS and name not in used:
                own = list(dict.fromkeys([f"{name}[{i}]" for i in range(sizes.get(name, 0))] + own))
            ports += own
    return ports + [name for name in used if name not in known and _base(name) not in known]
