"""An FMU for Model Exchange as a tape: its results are opaque nodes.

Between events its derivatives, outputs and event indicators are functions of time, states, inputs and of what is hidden
in it. The tape says on which of these each of them depends; `Opaque` says by which calls it is obtained. Where the
description names no dependencies, a result depends on all states and inputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ..contract.interface import Interface
from ..contract.tape import Argument, Result, Tape, TapeNode

if TYPE_CHECKING:
    from ..fmi.model_description import ModelVariable, Unknown

EVENT = "time_event"
"""The name under which the time events of an FMU are reported."""

_TAPES: dict[Interface, FmuTape] = {}


@dataclass(frozen=True, slots=True)
class OpaqueItem:
    """One number that an FMU gives.

    kind: "state", "derivative" and "indicator" by their index, "value" (an element of a variable), "event_time";
    "given": an argument itself; "number"; "partial": the derivative of another item by an argument. scale, offset: in
    SI it is scale * number of the FMU + offset.
    """

    kind: str
    index: int
    variable: ModelVariable | None = None
    scale: float = 1.0
    of: OpaqueItem | None = None
    offset: float = 0.0

    def si(self, number: float) -> float:
        """Return a number of the FMU in SI."""
        return number * self.scale + self.offset if self.offset else number * self.scale


@dataclass(frozen=True, slots=True)
class Opaque:
    """How the nodes of an FMU for Model Exchange are obtained.

    items: what each `foreign` node is, by its value. states: in the order of the FMU, the argument of each and its
    scale. inputs: for each, the argument, the variable and its element, and the scale. indicators: their number.
    origins, offsets: of the states and of the inputs, what 0 of the FMU is in SI.
    """

    fmi: int
    items: tuple[OpaqueItem, ...]
    states: tuple[tuple[int, float], ...]
    inputs: tuple[tuple[int, ModelVariable, int, float], ...]
    indicators: int
    origins: tuple[float, ...] = ()
    offsets: tuple[float, ...] = ()


@dataclass(frozen=True)
class FmuTape(Tape):
    """The tape of an FMU. opaque: what its `foreign` nodes are."""

    opaque: Opaque = field(kw_only=True)

    def computed(self) -> tuple[Any, ...]:
        return (*super().computed(), self.opaque)


def opaque(interface: Interface) -> FmuTape:
    """The tape of a type that is an FMU for Model Exchange, made once."""
    if interface not in _TAPES:
        _TAPES[interface] = _FmuTapeBuilder(interface).tape()
    return _TAPES[interface]


@dataclass(slots=True)
class _FmuTapeBuilder:
    """Arguments first (time, inputs, states), then one node for each element of what the FMU gives."""

    interface: Interface

    def tape(self) -> FmuTape:
        d = self.interface.declaration
        foreign = d.foreign
        by_variable = {id(variable): name for name, variable in foreign.variables.items() if name in d.states}
        structure = foreign.description.structure
        states_of = [(variable, by_variable[id(variable)]) for variable in structure.states]
        arguments = [Argument("time", "t")]
        place: dict[str, int] = {}
        for kind, variables in (("input", d.inputs), ("state", d.states)):
            for name, variable in variables.items():
                place[name] = len(arguments)
                arguments += [Argument(kind, name, e) for e in range(self.size(variable))]
        nodes = [TapeNode("argument", (), float(k)) for k in range(len(arguments))]
        everything = tuple(range(1, len(arguments)))
        # Where each variable of the FMU is an argument, by reference and type, as two names may be one value.
        at: dict[tuple[int, str], tuple[str, range]] = {}
        for name in (*d.inputs, *d.states):
            inner, size = foreign.variables[name], self.size(d.readable[name])
            at[inner.reference, inner.type] = (name, range(place[name], place[name] + size))
        known = {unknown.variable.name: unknown for unknown in structure.outputs}
        items: list[OpaqueItem] = []
        results: dict[str, Result] = {}

        def needs(unknown: Unknown | None) -> tuple[int, ...]:
            if unknown is None or unknown.dependencies is None:
                return everything
            needed: set[int] = set()
            for variable in unknown.dependencies:
                needed.update(at.get((variable.reference, variable.type), ("", range(0)))[1])
            return tuple(sorted(needed))

        def add(key: str, target: str, elements: Iterable[OpaqueItem | int], operands: Sequence[int]) -> None:
            places = []
            for item in elements:
                if isinstance(item, int):
                    places.append(item)
                    continue
                nodes.append(TapeNode("foreign", (0, *operands), float(len(items))))
                items.append(item)
                places.append(len(nodes) - 1)
            role = key.partition(":")[0]
            results[key] = Result(key, role, target, "", "", tuple(places))

        first = 0
        scales, offsets = foreign.scales, foreign.offsets
        for number, (_, name) in enumerate(states_of):
            size, scale = self.size(d.states[name]), scales.get(name, 1.0)
            unknown = structure.derivatives[number] if number < len(structure.derivatives) else None
            origin = offsets.get(name, 0.0)
            new_items = (OpaqueItem("state", first + e, scale=scale, offset=origin) for e in range(size))
            add(f"initial:{name}", name, new_items, ())
            new_items = (OpaqueItem("derivative", first + e, scale=scale) for e in range(size))
            add(f"derivative:{name}", name, new_items, needs(unknown))
            first += size
        for name, given in d.given.items():
            variable, size, scale = foreign.variables[name], self.size(given), scales.get(name, 1.0)
            same, at_same = at.get((variable.reference, variable.type), ("", range(0)))
            offset = offsets.get(name, 0.0)
            is_alike = scales.get(same, 1.0) == scale and offsets.get(same, 0.0) == offset
            if same in d.states and is_alike:  # another name of a state
                add(f"output:{name}", name, at_same, ())
                continue
            new_items = (OpaqueItem("value", e, variable, scale, offset=offset) for e in range(size))
            unknown = known.get(variable.name) or known.get(foreign.description.aliases.get(variable.name, ""))
            add(f"output:{name}", name, new_items, needs(unknown))
        indicators = self.indicators()
        for k, (name, unknown) in enumerate(indicators):
            add(f"crossing:{name}", name, (OpaqueItem("indicator", k),), needs(unknown))
        add(f"event_time:{EVENT}", EVENT, (OpaqueItem("event_time", 0),), ())
        inputs = tuple(
            (place[name] + e, foreign.variables[name], e, scales.get(name, 1.0))
            for name, variable in d.inputs.items()
            for e in range(self.size(variable))
        )
        states = tuple(
            (place[name] + e, scales.get(name, 1.0)) for _, name in states_of for e in range(self.size(d.states[name]))
        )
        moved = [
            tuple(offsets.get(name, 0.0) for name in names for _ in range(self.size({**d.states, **d.inputs}[name])))
            for names in ([name for _, name in states_of], d.inputs)
        ]
        known_as = Opaque(foreign.description.fmi, tuple(items), states, inputs, len(indicators), *moved)
        return FmuTape(self.interface, tuple(arguments), tuple(nodes), results, opaque=known_as)

    def size(self, variable: object) -> int:
        return math.prod(self.interface.shape(variable))  # type: ignore[arg-type]

    def indicators(self) -> list[tuple[str, Unknown | None]]:
        """The names of event indicators, one for each, and what they depend on."""
        description = self.interface.declaration.foreign.description
        if description.fmi == 2:
            return [(f"event[{k}]", None) for k in range(description.indicators)]
        indicators: list[tuple[str, Unknown | None]] = []
        for unknown in description.structure.indicators:
            size = math.prod(unknown.variable.shape)
            names = (
                [unknown.variable.name]
                if unknown.variable.shape == ()
                else [f"{unknown.variable.name}[{e}]" for e in range(size)]
            )
            indicators += [(name, unknown) for name in names]
        return indicators


def asked(tape: FmuTape, results: Sequence[tuple[str, int]], arguments: Sequence[int]) -> FmuTape:
    """Results of an FMU with their partial derivatives, as `contract.tracing.jacobian` gives those of equations."""
    opaque = tape.opaque
    nodes, items = list(tape.nodes), list(opaque.items)
    values = tuple(tape.results[key].nodes[element] for key, element in results)
    partials = []
    for n in values:
        node = tape.nodes[n]
        for argument in arguments:
            if node.op == "argument" or argument not in node.operands:
                nodes.append(TapeNode("constant", (), float(node.op == "argument" and int(node.value) == argument)))
            else:
                nodes.append(TapeNode("foreign", node.operands, float(len(items))))
                items.append(OpaqueItem("partial", argument, of=opaque.items[int(node.value)]))
            partials.append(len(nodes) - 1)
    asked_results = {
        key: Result(key, key, key, "", "", tuple(places)) for key, places in (("value", values), ("partial", partials))
    }
    given = replace(opaque, items=tuple(items))
    return FmuTape(tape.interface, tape.arguments, tuple(nodes), asked_results, opaque=given)


@dataclass(frozen=True, slots=True)
class Request:
    """Some results of an FMU: the arguments that they need (time first), where these go, and what is read.

    states, inputs: pairs of a place among the given values and one in the order of the FMU.
    """

    arguments: tuple[int, ...]
    states: tuple[tuple[int, int], ...]
    inputs: tuple[tuple[int, int], ...]
    items: tuple[OpaqueItem, ...]

    @classmethod
    def of(cls, tape: FmuTape, results: Sequence[tuple[str, int]]) -> Request:
        opaque = tape.opaque
        nodes = [tape.results[key].nodes[element] for key, element in results]
        read = {int(tape.nodes[n].value) for n in tape.needed(nodes) if tape.nodes[n].op == "argument"}
        arguments = tuple(sorted({0, *read}))
        place = {argument: k for k, argument in enumerate(arguments)}
        states = tuple((place[a], k) for k, (a, _) in enumerate(opaque.states) if a in place)
        inputs = tuple((place[a], k) for k, (a, *_) in enumerate(opaque.inputs) if a in place)
        items = []
        for n in nodes:
            node = tape.nodes[n]
            if node.op == "foreign":
                items.append(opaque.items[int(node.value)])
            elif node.op == "constant":
                items.append(OpaqueItem("number", 0, scale=node.value))
            else:  # another name of a state
                items.append(OpaqueItem("given", place[int(node.value)]))
        return cls(arguments, states, inputs, tuple(items))
