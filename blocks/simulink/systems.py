"""A system of a model as a diagram: each block by its rule, until sizes and rates stay; then the wires.

A rule says what a block becomes, given what is known of its inputs. It runs again when more is known of them.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..text.errors import FMUError, ModelError
from .matlab import names_in
from .matlab_functions import NoValue
from .numbers import MOST_ELEMENTS, Raw, Scope, Unknown, as_json, named
from .signals import (
    CONSTANT,
    CONTINUOUS,
    Attr,
    Note,
    Out,
    Own,
    Part,
    Rate,
    Reading,
    Wire,
    joined,
    outputs_of,
    passed_on,
    rate_of,
)
from .tags import tag_of
from .tree import Block, End, Model, System

Rule = Callable[["At"], None]
MOST_ROUNDS = 60
MOST_PORTS = 1000
MOST_BLOCKS = 50_000  # of all systems, with those of libraries as often as they are used
DEEPEST = 20  # models and links in each other
ENDLESS = 1e100  # what stands for infinity in a diagram
_SCALE = (1.7, 1.4)  # of positions: blocks of a diagram have their types inside, and are larger


class Refused(Exception):
    """A block, or an option of it, that has no equal here. cure: what the user can do."""

    def __init__(self, why: str, cure: str = "") -> None:
        super().__init__(why)
        self.cure = cure


@dataclass(slots=True)
class Mapped:
    """A system as the body of a diagram. outs: of its Outports, by number. used: parameters that it takes.

    taken: the blocks of the model that are in it, with their paths there, "" for what is no block there. log: signals
    that it shows. named: its outputs that a variable or a file takes.
    """

    body: dict[str, Any]
    outs: dict[str, Attr]
    scope: Scope
    used: list[str]
    names: Mapping[str, str]
    notes: list[tuple[Block, Note]]
    taken: list[tuple[Block, str]]
    log: list[str]
    named: list[str]
    stops: list[str]
    is_late: bool
    size: int  # its blocks, with those inside


@dataclass(slots=True)
class Context:
    """What all systems of one import share.

    folder: of the files that the model refers to. shortest: the step of the solver, or a part of the run that is short
    enough for what is a step there. fallback: the sample time where none is inherited.
    """

    model: Model
    rule_of: Callable[[Block], Rule | None]
    open_model: Callable[[str], Model | None]
    folder: Path
    shortest: float
    fallback: Raw | None = None
    kept: dict[Any, Mapped] = field(default_factory=dict)
    opened: tuple[str, ...] = ()  # the models and links that lie around a system
    left: list[int] = field(default_factory=lambda: [MOST_BLOCKS])  # how many blocks may still be mapped

    def inside(self, model: Model, name: str) -> Context:
        """Return the context of what a model or a link refers to. Raises Refused where it refers to itself."""
        if name in self.opened or len(self.opened) >= DEEPEST:
            raise Refused("models or links refer to each other")
        return replace(self, model=model, opened=(*self.opened, name))


@dataclass(slots=True)
class Drawing:
    """A system while it is mapped."""

    context: Context
    system: System
    scope: Scope
    inputs: Mapping[str, Attr]
    names: dict[str, str]
    drivers: dict[Reading, End]
    labels: dict[tuple[str, str], str]  # names of lines, by the port at which they begin
    parts: dict[str, Part] = field(default_factory=dict)
    readings: dict[str, list[Reading]] = field(init=False)  # the wired inputs of a block

    def __post_init__(self) -> None:
        self.readings = {}
        for reading in self.drivers:
            self.readings.setdefault(reading[0], []).append(reading)

    def attr(self, reading: Reading) -> Attr:
        """Return what is known of the signal at an input; nothing that is wired is a constant 0."""
        end = self.drivers.get(reading)
        if end is None:
            return Attr(rate=CONSTANT)
        part = self.parts.get(end.block)
        out = None if part is None else part.outs.get(end.port)
        return Attr() if out is None else out.attr

    def sources(self, source: str | Own, attr: Attr | None = None) -> list[tuple[str, bool]] | None:
        """Return the source of each element and whether it is a bool; None where nothing is wired."""
        found: list[tuple[str, bool]] = []
        left = [(source, attr, 0)]
        while left:
            one, attr, depth = left.pop()
            if not isinstance(one, Own):
                found.append((one, bool(attr and attr.is_bool)))
                continue
            out = self._driving(one.reading)
            if out is None or depth > len(self.parts):
                return None
            chosen = out.elements if one.element is None else out.elements[one.element : one.element + 1]
            left += [(each, out.attr, depth + 1) for each in reversed(chosen)]
        return found or None

    def whole(self, source: str | Own, attr: Attr | None = None) -> tuple[str, bool] | None:
        """Return the one source of all elements, or None if there is none."""
        for _ in range(len(self.parts) + 2):
            if not isinstance(source, Own):
                return source, bool(attr and attr.is_bool)
            out = self._driving(source.reading)
            if out is None or source.element is not None or out.whole is None:
                return None
            source, attr = out.whole, out.attr
        return None

    def _driving(self, reading: Reading) -> Out | None:
        end = self.drivers.get(reading)
        part = None if end is None else self.parts.get(end.block)
        return None if part is None or end is None else part.outs.get(end.port)


def whole(given: Raw, key: str, least: int = -10_000, most: int = 10_000) -> int:
    """Return a number as an integer. Raises Refused where it is none, or out of bounds."""
    if not math.isfinite(given.value) or given.value != int(given.value) or not least <= given.value <= most:
        raise Refused(f"{key} is no whole number from {least:,} to {most:,}")
    return int(given.value)


def _is_infinite(value: Any) -> bool:
    if isinstance(value, list):
        return any(_is_infinite(one) for one in value)
    return isinstance(value, float) and math.isinf(value)


class At:
    """A block while its rule runs: its parameters, what is known of its inputs, and the part that it becomes."""

    def __init__(self, drawing: Drawing, block: Block) -> None:
        self.drawing, self.block, self.part = drawing, block, Part()
        self.name, self.scope, self.context = drawing.names[block.name], drawing.scope, drawing.context
        self.frozen: dict[str, None] = {}
        self.is_timed = False  # whether its rule has read its sample time

    # --- what the model says ---------------------------------------------------------------------------------------

    def text(self, key: str, default: str = "") -> str:
        value = self.context.model.value(self.block, key)
        return default if value is None else value

    def raws(self, key: str, default: str) -> list[Raw]:
        text = self.text(key, default) or default
        found = self.scope.raws(text)
        self._freeze(text, repr([one.json for one in found]))
        return found

    def _freeze(self, text: str, written: str = "") -> None:
        """Note the variables of an expression that are numbers in the diagram, and do not follow --set."""
        names = [name for name in named(text) if name in self.scope.known]
        self.frozen |= dict.fromkeys(name for name in names if not re.search(rf"\b{name}\b", written))

    def raw(self, key: str, default: str) -> Raw:
        found = self.raws(key, default)
        if len(found) != 1:
            raise Refused(f"{key} has {len(found)} elements, and one is needed")
        return found[0]

    def matrix(self, key: str, default: str) -> Any:
        text = self.text(key, default) or default
        self._freeze(text)
        return self.scope.matrix(text)

    def whole_number(self, key: str, default: str, most: int = 10_000) -> int:
        return whole(self.raw(key, default), key, 0, most)

    def number_of(self, key: str, default: str) -> int | None:
        """Return a number of ports; None where the parameter says it in another way. Raises Refused."""
        text = self.text(key, default).strip()
        if not re.fullmatch(r"\d+", text, re.ASCII):
            return None
        return whole(Raw(text, float(text)), key, 0, MOST_PORTS)

    def is_on(self, key: str, default: str = "off") -> bool:
        return self.text(key, default) == "on"

    def attr(self, port: str | int) -> Attr:
        return self.drawing.attr((self.block.name, str(port)))

    def count(self, default: int = 1) -> int:
        """Return the number of inputs: as the file counts them, or as many as are wired."""
        wired = [port for _, port in self.drawing.readings.get(self.block.name, ()) if port.isdecimal()]
        most = max([int(port) if len(port) < 9 else MOST_PORTS for port in wired], default=default)
        return min(self.block.ports.get("in", most), MOST_PORTS)

    def is_wired(self, port: str) -> bool:
        return (self.block.name, port) in self.drawing.drivers

    def own_rate(self, key: str = "SampleTime", default: str = "-1") -> Rate | None:
        """Return the sample time of the block; None where it is inherited."""
        self.is_timed = True
        given = self.raws(key, default)
        if len(given) > 2 or not given:
            raise Refused(f"{key} is no sample time")
        period, offset = given[0], given[1].value if len(given) == 2 else 0.0
        if period.value == -1 or (period.value <= 0 and offset < 0):
            return None
        if period.value == 0:
            return CONTINUOUS
        if period.value < 0 or not offset == offset or offset < 0:
            raise Refused(f"{key} is {self.text(key, default)!r}: a sample time that changes", "Give it one period.")
        return CONSTANT if period.value == float("inf") else rate_of(period, offset)

    def inherited(self, ports: Iterable[str | int] | None = None) -> Rate | None:
        return self._here(joined([self.attr(port).rate for port in ports or range(1, self.count() + 1)]))

    def _here(self, rate: Rate | None) -> Rate | None:
        """Return a rate of another system, whose period may be a variable there, as this system can say it."""
        if rate is None or not isinstance(rate.json, str):
            return rate
        text, period = rate.json.removeprefix("=").replace("**", "^"), rate.period
        if all(name in self.scope.known for name in names_in(text)):
            found = self.scope.raw(text)
            if found.value == period:
                return replace(rate, json=found.json)
        return rate if period != period else replace(rate, json=period)

    def ticks(self, key: str = "SampleTime", default: str = "-1", ports: Iterable[str | int] | None = None) -> Rate:
        """Return the rate of a sampled block, its own or inherited."""
        rate = self.own_rate(key, default) or self.inherited(ports)
        if rate is not None and (rate.is_sampled or rate.period != rate.period):
            return rate
        self.part.is_late = True
        given = self.context.fallback or Raw(1, 1.0)
        kind = "that of a continuous signal" if rate == CONTINUOUS else "inherited, and nothing gives one"
        self.note("decided", f"its sample time is {kind}: {given.json} s is taken", "Set its period.")
        return self._here(Rate(given.value, 0.0, given.json)) or CONTINUOUS

    def is_read(self, port: str) -> bool:
        """Return whether a line begins at an output."""
        return any(end.block == self.block.name and end.port == port for end in self.drawing.drivers.values())

    # --- what it becomes -------------------------------------------------------------------------------------------

    def add(self, kind: str, suffix: str = "", n: int = 1, /, **parameters: Any) -> str:
        """Add a block and return its name; parameters that are None are left out."""
        name = self.name + suffix
        entry: dict[str, Any] = {"type": kind}
        given = {key: value for key, value in parameters.items() if value is not None}
        if any(_is_infinite(value) for value in given.values()):
            raise Refused("a parameter is infinite", "Give it a finite value.")
        if n > 1:
            entry["copies"] = n
        if given:
            entry["parameters"] = given
        self.part.blocks[name] = entry
        return name

    def own(self, port: str | int, element: int | None = None) -> Own:
        return Own((self.block.name, str(port)), element)

    def wire(
        self, sink: str, source: str | Own | int, n: int = 1, *, is_bool: bool = False, is_vector: bool = False
    ) -> None:
        """Wire an input of the diagram; a number is an input of the model's block. Raises Refused for other sizes."""
        source = self.own(source) if isinstance(source, int) else source
        if isinstance(source, Own) and source.element is None:
            arriving = self.drawing.attr(source.reading).n
            if arriving not in (1, n):
                raise Refused(f"{arriving} elements arrive at its input {source.reading[1]}, and it takes {n}")
        self.part.wires.append(Wire(sink, source, n, is_bool, is_vector))

    def out(self, port: str, rate: Rate | None, n: int = 1, number: str | int = 1, **more: Any) -> None:
        """Say which port of the diagram the output of a number is. Raises Refused where it has too many elements."""
        if n > MOST_ELEMENTS:
            raise Refused(f"its output has {n:,} elements, and {MOST_ELEMENTS:,} are the most")
        is_vector = more.pop("is_vector", False)
        self.part.outs[str(number)] = outputs_of(port, Attr(n, rate=rate, **more), is_vector=is_vector)

    def pass_on(self, port: str | int = 1, number: str | int = 1, **more: Any) -> None:
        """Say that an output is an input of the block."""
        attr = replace(self.attr(port), **more)
        self.part.outs[str(number)] = passed_on((self.block.name, str(port)), attr)

    def note(self, kind: str, what: str, cure: str = "") -> None:
        self.part.notes.append(Note(kind, what, cure))

    def width(self, *lists: Sequence[Raw], ports: Iterable[str | int] | None = None, least: int = 1) -> int:
        """Return the number of elements of a block that works on each: the largest of its inputs and parameters."""
        sizes = [self.attr(port).n for port in (range(1, self.count() + 1) if ports is None else ports)]
        sizes += [len(each) for each in lists]
        n = max([*sizes, least])
        if any(size not in (1, n) for size in sizes):
            raise Refused(f"its inputs and parameters have {', '.join(map(str, sizes))} elements")
        return n

    def per_copy(self, given: Sequence[Raw], n: int, *, limit: bool = False) -> Any:
        """Return a parameter of a block that has n copies: one value, or a value for each. limit: inf is none."""
        if limit and all(abs(one.value) == float("inf") for one in given):
            return None
        values = [
            one.json if abs(one.value) != float("inf") else ENDLESS * (1 if one.value > 0 else -1) for one in given
        ]
        if not limit and any(abs(one.value) == float("inf") for one in given):
            raise Refused("a parameter is infinite", "Give it a finite value.")
        return values[0] if len(values) == 1 or n == 1 else values

    def each(
        self,
        kind: str,
        /,
        ports: Mapping[str, int | str] | None = None,
        lists: Mapping[str, Sequence[Raw]] | None = None,
        *,
        rate: Rate | None = None,
        port: str = "y",
        suffix: str = "",
        bools: Iterable[str] = (),
        is_bool: bool = False,
        limits: Iterable[str] = (),
        number: int = 1,
        n: int = 1,
        **parameters: Any,
    ) -> str:
        """Add a block that works on each element, with copies where there are several; returns its name.

        ports: the sources of its inputs: numbers of inputs of the model's block, or ports of the diagram. n: the
        least number of elements. lists: its parameters with
        a value for each element. limits: those of them that may be infinite. bools: its ports that take truth values.
        """
        ports, lists = {"u": 1} if ports is None else ports, lists or {}
        n = self.width(*lists.values(), ports=[one for one in ports.values() if isinstance(one, int)], least=n)
        given = {key: self.per_copy(one, n, limit=key in limits) for key, one in lists.items()}
        name = self.add(kind, suffix, n, **given, **parameters)
        for sink, source in ports.items():
            self.wire(f"{name}.{sink}", source, n, is_bool=sink in bools)
        if rate is None:
            rate = joined([self.attr(one).rate for one in ports.values() if isinstance(one, int)])
        self.out(f"{name}.{port}", rate, n, number, is_bool=is_bool)
        return name

    def nest(self, rate: Rate, source: str = "e", output: str = "u") -> None:
        """Put the blocks that were added, which take one value and give one, into a subdiagram of the block's name."""

        def local(text: str) -> str:
            name, _, port = text.partition(".")
            return f"{name.removeprefix(self.name).lstrip('_') or 'last'}.{port}"

        blocks = {local(name)[:-1]: entry for name, entry in self.part.blocks.items()}
        wires = {
            local(wire.sink): source if isinstance(wire.source, Own) else local(wire.source) for wire in self.part.wires
        }
        given = repr(blocks)
        used = {name: value for name, value in self.scope.used.items() if re.search(rf"\b{name}\b", given)}
        body: dict[str, Any] = {"parameters": {name: as_json(value) for name, value in used.items()}} if used else {}
        body |= {"inputs": {source: {}}, "outputs": {output: "last.y"}, "blocks": blocks, "wires": wires}
        entry: dict[str, Any] = {"diagram": body} | (
            {"parameters": {name: f"={name}" for name in used}} if used else {}
        )
        self.part.blocks, self.part.wires = {self.name: entry}, []
        self.wire(f"{self.name}.{source}", 1)
        self.out(f"{self.name}.{output}", rate)

    def hold(self, key: str = "SampleTime", number: str | int = 1, default: str = "-1") -> None:
        """Hold the output from tick to tick if the block has a sample time of its own."""
        rate = self.own_rate(key, default)
        out = self.part.outs.get(str(number))
        if rate is None or out is None or not rate.is_sampled or out.attr.rate in (rate, CONSTANT):
            return
        source, n = out.whole, out.attr.n
        assert isinstance(source, str)
        if out.attr.is_bool:
            raise Refused("a truth value that is sampled", "Sample its inputs.")
        suffix = "_hold" if str(number) == "1" else f"_hold{number}"
        name = self.add("ZeroOrderHold", suffix, n, period=rate.json, offset=rate.offset or None)
        self.wire(f"{name}.u", source, n)
        self.out(f"{name}.y", rate, n, number)


# --- the whole system ----------------------------------------------------------------------------------------------


def map_system(context: Context, system: System, scope: Scope, inputs: Mapping[str, Attr]) -> Mapped:
    """Return a system as the body of a diagram. inputs: what is known of its Inports, by number."""
    reserved: set[str] = set()
    for _ in range(3):
        drawing = _drawn(context, system, scope, inputs, reserved)
        mapped = _linked(drawing)
        taken = {*mapped.used, *scope.missing}
        made = {key for name, part in drawing.parts.items() for key in part.blocks if key != drawing.names[name]}
        if not taken & {*mapped.body.get("blocks", ()), *mapped.body.get("inputs", ())} | made & {
            *drawing.names.values()
        }:
            break
        reserved = reserved | taken | made
    return mapped


def _drawn(context: Context, system: System, scope: Scope, inputs: Mapping[str, Attr], reserved: set[str]) -> Drawing:
    blocks = {name: block for name, block in system.blocks.items() if block.values.get("Commented", "off") == "off"}
    drivers: dict[Reading, End] = {}
    labels: dict[tuple[str, str], str] = {}
    around = {name: block for name, block in system.blocks.items() if block.values.get("Commented") == "through"}
    for line in system.lines:
        if line.source is None:
            continue
        if line.name:
            labels[line.source.block, line.source.port] = line.name
        for target in line.targets:
            drivers[target.block, target.port] = line.source
    for name in around:
        for reading, end in list(drivers.items()):
            if end.block == name:
                before = drivers.get((name, end.port))
                if before is None:
                    del drivers[reading]
                else:
                    drivers[reading] = before
    drivers = {reading: end for reading, end in drivers.items() if end.block in blocks}
    drawing = Drawing(context, system, scope, inputs, _names(blocks, reserved), drivers, labels)
    seen: dict[str, object] = {}
    changed: list[Part] = []
    order = _along(drawing, blocks)
    for _ in range(MOST_ROUNDS):
        changed = []
        for name in order:
            block = blocks[name]
            readings = drawing.readings.get(name, ())
            state = tuple(drawing.attr(reading) for reading in readings) if block.type != "From" else object()
            if name in seen and seen[name] == state:
                continue
            seen[name] = state
            part = _part(drawing, block)
            old = drawing.parts.get(name)
            drawing.parts[name] = part
            if old is None or old.outs != part.outs:
                changed.append(part)
        if not changed:
            break
    for part in changed:
        part.notes.append(Note("left out", "the size or the rate of its output depends on itself", ""))
    drawing.parts = {name: drawing.parts[name] for name in blocks}
    return drawing


def _along(drawing: Drawing, blocks: Mapping[str, Block]) -> list[str]:
    """Return the blocks in the order of the signals, so that a few rounds reach them all."""
    model = drawing.context.model
    tags: dict[str, str] = {}
    for name, block in blocks.items():
        if block.type == "Goto":
            tags.setdefault(tag_of(model, block), name)
    order: dict[str, None] = {}
    begun: set[str] = set()
    for first in blocks:
        left = [first]
        while left:
            name = left[-1]
            if name in begun:
                order[left.pop()] = None
                continue
            begun.add(name)
            before = [drawing.drivers[reading].block for reading in drawing.readings.get(name, ())]
            if blocks[name].type == "From":
                before += [tags[tag] for tag in [tag_of(model, blocks[name])] if tag in tags]
            left += [one for one in before if one not in begun]
    return list(order)


_FROM_DIALOG = {"NumeratorSource": "Dialog", "DenominatorSource": "Dialog", "InitialStatesSource": "Dialog"}
_ONLY: dict[str, dict[str, str]] = {
    "DiscreteFilter": _FROM_DIALOG | {"ExternalReset": "None"},
    "DiscreteTransferFcn": _FROM_DIALOG | {"ExternalReset": "None"},
    "DiscreteFir": {"CoefSource": "Dialog parameters", "FilterStructure": "Direct form", "InitialStates": "0"},
    "DiscretePulseGenerator": {"TimeSource": "Use simulation time"},
    "Lookup_n-D": {"DataSpecification": "Table and breakpoints", "TableSource": "Dialog",
                   "BreakpointsForDimension1Source": "Dialog", "BreakpointsForDimension2Source": "Dialog",
                   "UseOneInputPortForAllInputData": "off", "UseLastTableValue": "off"},
    "Saturate": {"UpperLimitSource": "Dialog", "LowerLimitSource": "Dialog"},
    "Selector": {"InputType": "Vector", "ElementSrc": "Internal"},
    "SignalGenerator": {"TimeSource": "Use simulation time"},
    "Product": {"CollapseMode": "All dimensions"}, "Sum": {"CollapseMode": "All dimensions"},
}  # fmt: skip
"""Options by BlockType with the one value that has an equal here."""


_UNTIMED = {"Inport", "ManualSwitch", "ModelReference", "Reference", "SubSystem"}  # there it may be a mask's parameter


def _part(drawing: Drawing, block: Block) -> Part:
    rule = drawing.context.rule_of(block)
    at = At(drawing, block)
    before, drawing.scope.missing = drawing.scope.missing, {}
    try:
        if rule is None:
            raise Refused(f"no equal of {_kind(block)} here", "Write it as a block of your own.")
        own = block.mask.parameters if block.mask and block.type not in ("SubSystem", "Reference") else {}
        if any(re.search(rf"\b{name}\b", text) for name in own for key, text in block.values.items() if key not in own):
            raise Refused("its mask has parameters", "Write their values into the block.")
        for key, only in _ONLY.get(block.type, {}).items():
            if at.text(key, only) != only:
                raise Refused(f"its {key} is {at.text(key)[:40]!r}", f"Here it is always {only!r}.")
        rule(at)
        if drawing.scope.missing:
            named = ", ".join(drawing.scope.missing)
            at.note("unknown", f"no value for {named}", f"Give {named} by --workspace.")
        if at.block.type not in ("SubSystem", "ModelReference") and at.frozen:
            at.note("decided", f"{', '.join(at.frozen)} went into its numbers: --set does not change them", "")
        if not at.is_timed and "SampleTime" in block.values and block.type not in _UNTIMED:
            for number, out in list(at.part.outs.items()):
                if isinstance(out.whole, str):
                    at.hold(number=number)
        kind = at.text("OutDataTypeStr") or at.text("OutDataTypeMode")
        kind = at.text("OutDataType") if kind == "Specify via dialog" else kind
        if re.match(r"u?int\d|fixdt|[su]fix|float\(", kind):
            at.note("decided", f"its type is {kind}; here numbers stay as they are, without rounding or overflow", "")
    except (Refused, Unknown, NoValue, OSError, ValueError, FMUError, ModelError) as refused:
        unknown = ", ".join(getattr(refused, "names", ()))
        cure = f"Give {unknown} by --workspace." if unknown else str(getattr(refused, "cure", ""))
        at = At(drawing, block)
        _empty(at, f"{refused}.", cure)
        at.note("unknown" if unknown else "left out", f"{refused}", cure)
    drawing.scope.missing |= before
    return at.part


def _kind(block: Block) -> str:
    return (block.values.get("SourceType") or block.values.get("SourceBlock") or block.type).replace("\n", " ")


def _empty(at: At, why: str, cure: str) -> None:
    """Add a block of a type that does not exist, with the ports of the model's block: check names it."""
    if at.block.type == "Inport":  # an input has no block; it stays, as one number
        at.out(at.name, CONTINUOUS)
        return
    name = at.add(f"{legal(at.block.name, set(), 'Block')}ToWrite")
    given = {
        key: at.block.values.get(key, "") for key in ("FunctionName", "MATLABFcn", "OutputDimensions", "Parameters")
    }
    said = [f"{key}: {text}." for key, text in given.items() if text]
    at.part.blocks[name]["doc"] = " ".join(part for part in (why, cure, *said, at.block.script) if part)[:4000]
    for port in range(1, at.count(0) + 1):
        at.wire(f"{name}.u{port}", port, at.attr(port).n)
    for port in range(1, at.block.ports.get("out", 1) + 1):
        at.out(f"{name}.y{port}", None, number=port)


def legal(name: str, taken: set[str], kind: str = "model") -> str:
    """Return a name as diagrams have it, which is not taken yet, and take it. kind: goes before a digit."""
    plain = name
    for letter, plainly in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("Ä", "Ae"), ("Ö", "Oe"), ("Ü", "Ue")):
        plain = plain.replace(letter, plainly)
    plain = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
    plain = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:150]
    if not plain or plain[0].isdigit():
        plain = f"{kind}_{plain}".rstrip("_")
    wanted, k = plain, 2
    while plain in taken:
        plain, k = f"{wanted}_{k}", k + 1
    taken.add(plain)
    return plain


def _names(blocks: Mapping[str, Block], reserved: set[str]) -> dict[str, str]:
    """Return names for blocks; ports of the system come first, because users type their names."""
    taken = {*reserved, "index", "copies"}
    order = sorted(blocks, key=lambda name: blocks[name].type not in ("Inport", "Outport"))
    return {name: legal(name, taken, re.sub(r"^\d+|\W", "", blocks[name].type) or "block") for name in order}


# --- wires -----------------------------------------------------------------------------------------------------------


class _Wiring:
    """The wires of a drawing, and the blocks that they need: a 0, a truth value as a number, a vector of elements."""

    def __init__(self, drawing: Drawing) -> None:
        self.drawing, self.wires = drawing, {}  # type: Drawing, dict[str, str]
        self.blocks: dict[str, dict[str, Any]] = {}
        self.taken = set(drawing.names.values())
        for part in drawing.parts.values():
            self.taken |= set(part.blocks)
        self._made: dict[tuple[str, str], str] = {}

    def add(self, wire: Wire) -> None:
        drawing = self.drawing
        if wire.source in ("0", "1"):
            self.wires[wire.sink] = self.constant(int(wire.source))
            return
        whole = drawing.whole(wire.source)
        found = drawing.sources(wire.source) if whole is None or isinstance(wire.source, Own) else [whole]
        if found is None:
            found, whole = [(self.constant(0), False)], None
        is_one = wire.n == 1 and not wire.is_vector
        if whole is not None and not isinstance(wire.source, Own):
            self.wires[wire.sink] = self.fitted(*whole, wire.is_bool, wire.n)
        elif is_one:
            self.wires[wire.sink] = self.fitted(*found[0], wire.is_bool)
        elif whole is not None and len(found) == wire.n > 1 and "[" not in whole[0]:
            self.wires[wire.sink] = self.fitted(*whole, wire.is_bool, wire.n)
        elif len(found) == 1 and not wire.is_vector:
            self.wires[wire.sink] = self.fitted(*found[0], wire.is_bool)  # one value for all copies
        else:
            for i in range(wire.n):
                self.wires[f"{wire.sink}[{i}]"] = self.fitted(*found[min(i, len(found) - 1)], wire.is_bool)

    def fitted(self, source: str, is_bool: bool, wants_bool: bool, n: int = 1) -> str:
        """Return a source as a truth value or as a number, by a block in between if need be."""
        if is_bool == wants_bool:
            return source
        key = (source, "bool" if wants_bool else "number")
        if key not in self._made:
            base = re.sub(
                r"\W+",
                "_",
                source.partition(".")[0] + source[source.index("[") :] if "[" in source else source.partition(".")[0],
            ).strip("_")
            if wants_bool:
                name = self._block(f"{base}_is_true", "CompareToConstant", n, operator="unequal")
                self.wires[f"{name}.u"] = source
            else:
                name = self._block(f"{base}_number", "Switch", n)
                self.wires |= {
                    f"{name}.u1": self.constant(1),
                    f"{name}.u2": self.constant(0),
                    f"{name}.control": source,
                }
            self._made[key] = f"{name}.y"
        return self._made[key]

    def constant(self, value: int) -> str:
        key = ("", str(value))
        if key not in self._made:
            self._made[key] = self._block(("zero", "one")[value], "Constant", value=value) + ".y"
        return self._made[key]

    def one_source(self, source: Own, name: str) -> tuple[str, int]:
        """Return the one source of a signal, made by a Mux if there is none, and its number of elements."""
        found = self.drawing.sources(source)
        if found is None:
            return self.constant(0), 1
        if len(found) == 1:
            return found[0][0], 1
        whole = self.drawing.whole(source)
        if whole is not None:
            return whole[0], len(found)
        mux = self._block(f"{name}_vector", "Mux", size=len(found))
        for i, (each, is_bool) in enumerate(found):
            self.wires[f"{mux}.u{i + 1}"] = self.fitted(each, is_bool, False)
        return f"{mux}.y", len(found)

    def _block(self, wanted: str, kind: str, n: int = 1, **parameters: Any) -> str:
        name = legal(wanted, self.taken)
        self.blocks[name] = (
            {"type": kind} | ({"copies": n} if n > 1 else {}) | ({"parameters": parameters} if parameters else {})
        )
        return name


def _linked(drawing: Drawing) -> Mapped:
    body = _Body(drawing)
    for name, part in drawing.parts.items():
        body.add(drawing.system.blocks[name], part)
    return body.mapped()


class _Body:
    """The body of a diagram, block by block of the model, with notes, signals to log and ends of the run."""

    def __init__(self, drawing: Drawing) -> None:
        self.drawing, self.wiring = drawing, _Wiring(drawing)
        self.inputs: dict[str, Any] = {}
        self.outputs: dict[str, str] = {}
        self.blocks: dict[str, Any] = {}
        self.layout: dict[str, list[int]] = {}
        self.notes: list[tuple[Block, Note]] = []
        self.taken: list[tuple[Block, str]] = []
        self.log: list[str] = []
        self.stops: list[str] = []

    def add(self, block: Block, part: Part) -> None:
        ours = self.drawing.names[block.name]
        self.notes += [(block, note) for note in part.notes]
        if block.type == "Inport":
            attr = part.outs["1"].attr
            kind = {"type": "bool", "default": False} if attr.is_bool else {"default": 0}
            self.inputs[ours] = ({"size": attr.n} if attr.n > 1 else {}) | kind
        if ours in part.blocks and ours != block.name:
            part.blocks[ours].setdefault("doc", block.name)
        self.blocks |= part.blocks
        is_drawn = ours in part.blocks or block.type in ("Inport", "Outport")
        self.taken.append((block, ours if is_drawn else ""))
        center = _center(block)
        if center and is_drawn:
            self.layout[ours] = center
        self._tell_open_ends(block, part)
        for wire in part.wires:
            self.wiring.add(wire)
        self.log += [one for reading in part.log for one in _logged(self.drawing, Own(reading))]
        for reading in part.stops:
            self._stop(reading)
        if part.inner is not None:
            self._take_over(block.name, ours, part)

    def _tell_open_ends(self, block: Block, part: Part) -> None:
        readings = dict.fromkeys(wire.source.reading for wire in part.wires if isinstance(wire.source, Own))
        for reading in readings:
            if self.drawing.sources(Own(reading)) is None:
                port = reading[1]
                there = f"its input {port}, which is 0 there" if port.isdecimal() else port
                self.notes.append((block, Note("decided", f"nothing is wired to {there}: a Constant 0", "")))

    def _stop(self, reading: Reading) -> None:
        found = self.drawing.sources(Own(reading)) or []
        self.stops += [each if is_bool else f"{each} != 0" for each, is_bool in found]

    def _take_over(self, name: str, ours: str, part: Part) -> None:
        """Take over what a subdiagram logs, tells and ends; its inputs are no signals of its own."""
        inner = part.inner
        arriving = inner.body.get("inputs", {})
        shown = [one for one in inner.log if "." in one or one.partition("[")[0] not in arriving]
        self.log += [f"{ours}.{one}" for one in [*shown, *inner.named]]
        for one in inner.stops:
            port = part.ports.get(re.split(r"\W", one, maxsplit=1)[0], "") if "." not in one else ""
            if port:
                self._stop((name, port))
            else:
                self.stops.append(f"{ours}.{one}")
        self.notes += inner.notes
        self.taken += [(block, inside and f"{ours}.{inside}") for block, inside in inner.taken]

    def mapped(self) -> Mapped:
        drawing, wiring = self.drawing, self.wiring
        outs: dict[str, Attr] = {}
        taken = {*self.inputs, *drawing.scope.used}
        for name in drawing.parts:
            block = drawing.system.blocks[name]
            if block.type == "Outport":
                number, ours, source = block.values.get("Port", "1"), drawing.names[name], Own((name, "1"))
                self.outputs[ours], n = wiring.one_source(source, ours)
                outs[number] = drawing.attr(source.reading)
                if n > 1 and drawing.whole(source) is None:  # gathered by a Mux, as numbers
                    outs[number] = replace(outs[number], is_bool=False)
                taken.add(ours)
        named: list[str] = []
        for name, part in drawing.parts.items():
            for wanted, reading in part.outputs.items():
                if drawing.sources(Own(reading)) is not None:
                    ours = legal(wanted, taken)
                    self.outputs[ours], _ = wiring.one_source(Own(reading), ours)
                    named.append(ours)
                    center = _center(drawing.system.blocks[name])
                    if center and ours not in self.blocks and ours not in self.inputs:
                        self.layout[ours] = center
        blocks = self.blocks | wiring.blocks
        written = repr([*blocks.values()])
        used = [name for name in drawing.scope.used if re.search(rf"\b{name}\b", written)]
        sections = {
            "parameters": {name: as_json(drawing.scope.used[name]) for name in used},
            "inputs": self.inputs, "outputs": self.outputs, "blocks": blocks, "wires": wiring.wires,
            "layout": self.layout,
        }  # fmt: skip
        inner = [part.inner for part in drawing.parts.values() if part.inner is not None]
        return Mapped(
            body={key: value for key, value in sections.items() if value},
            outs=outs, scope=drawing.scope, used=used, names=drawing.names, notes=self.notes, taken=self.taken,
            log=self.log, named=named, stops=self.stops,
            is_late=any(part.is_late for part in drawing.parts.values()),
            size=len(blocks) + sum(one.size for one in inner),
        )  # fmt: skip


def _logged(drawing: Drawing, source: Own) -> list[str]:
    whole = drawing.whole(source)
    found = [whole] if whole is not None else drawing.sources(source) or []
    return [each for each, _ in found if each]


def _center(block: Block) -> list[int]:
    numbers = [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", block.values.get("Position", ""))]
    if len(numbers) != 4:
        return []
    left, top, right, bottom = numbers
    return [round(_SCALE[0] * (left + right) / 2), round(_SCALE[1] * (top + bottom) / 2)]
