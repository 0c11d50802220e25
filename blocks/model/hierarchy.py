"""Subdiagrams opened: every diagram in its place with its parameters' values, every block with its numbers.

`Hierarchy` goes down the diagram once. Which output feeds which input is left to `wires`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from copy import copy as shallow_copy
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

from ..contract.block import Block
from ..contract.declaration import Declaration
from ..contract.interface import LARGEST, Interface, Value, check_differences, unit_from
from ..contract.reads import arguments
from ..contract.resolution import Resolved, late_units_of, loose, resolve, with_numbers
from ..contract.uses import late_units
from ..contract.variables import Parameter
from ..text import units
from ..text.errors import BlocksError, Fault, ModelError
from ..text.json_document import AT_KEY
from ..text.json_number import Number
from ..text.other_words import TYPES, parameter_meant
from ..text.printable import legible, quoted
from ..text.quantity_text import quantity_of
from . import streams
from .copies import (
    Copy,
    Fleet,
    InLanes,
    LateCopies,
    depth_of,
    dimensions,
    labelled,
    own_value,
    stream_of,
    unnumbered,
    without_numbers,
)
from .diagram_grammar import LARGEST_SIZE
from .diagram_value import DEEPEST, BlockEntry, DiagramValue, FaultList
from .origins import Origin, Origins
from .simulink import hint
from .values import Absent, Unit, expressions_in, is_expression, names_in, order_of, value_of

MAX_BLOCKS = 1_000_000
_COPIES_ARE = "an integer from 1 to 100,000"


class Resolver(Protocol):
    """Where block classes come from."""

    def __call__(self, name: str, /) -> type[Block]:
        """Return the class of a type; raises KeyError with the known names as its arguments."""

    def fmu(self, entry: BlockEntry, folder: str) -> type[Block]:
        """Return the class of an FMU; its path begins at a folder. Raises BlocksError."""


Spot = tuple[str | int, ...] | None
"""The place of something in the document of its diagram; None where it has none."""
_Raws = dict[str, tuple[Any, str, Spot]]
"""Raw values by parameter: the value, the path that it was set at ("": the file says it), and its place."""


@dataclass(eq=False, slots=True)
class Leaf:
    """A block of a type, with its numbers and with where they come from."""

    name: str
    scope: DiagramScope
    resolved: Resolved
    origins: Origins
    index: int
    copied: Fleet | None = None  # where the block itself has copies
    each: dict[int, Resolved] | InLanes[Resolved] = field(default_factory=dict)  # of lanes in which its numbers differ
    origins_of: dict[int, Origins] | InLanes[Origins] = field(default_factory=dict)  # of lanes in which these differ

    @property
    def fleet(self) -> Fleet | None:
        """The innermost fleet that it is in."""
        return self.copied or self.scope.fleet

    @property
    def path(self) -> str:
        return self.scope.prefix + self.name

    @property
    def all_paths(self) -> list[str]:
        """Those of all of its copies."""
        fleet = self.fleet
        return [self.path] if fleet is None else [fleet.numbered(self.path, k) for k in range(fleet.total)]

    @property
    def interface(self) -> Interface:
        return self.resolved.interface


@dataclass
class _Drawing:
    """The blocks that draw from one stream: the first one, the scopes around them, and those that give the stream."""

    first: str
    around: set[int] = field(default_factory=set)
    holders: set[int] = field(default_factory=set)


class InLane(NamedTuple):
    """The parameters of a diagram in a copy."""

    parameters: Mapping[str, Value | None]
    origins: Origins


@dataclass(eq=False)
class DiagramScope:
    """A diagram in its place: its parameters (None: faulty, already reported) and its blocks (the same)."""

    name: str
    parent: DiagramScope | None
    value: DiagramValue
    index: int
    depth: int
    control: Mapping[str, Any] = field(default_factory=dict)  # what enables or triggers it
    stream: str = ""  # the name of its streams, where its block says one
    clock: tuple[Value, Value] | None = None  # period and offset, where it is triggered by ticks
    copy: Copy | None = None  # where the diagram itself has copies
    parameters: dict[str, Value | None] = field(default_factory=dict)
    origins: dict[str, Origin] = field(default_factory=dict)  # each after those that it reads
    children: dict[str, Leaf | DiagramScope | None] = field(default_factory=dict)
    each: dict[int, InLane] | InLanes[InLane] = field(default_factory=dict)  # of lanes in which its parameters differ

    def __post_init__(self) -> None:
        self.path: str = "" if self.parent is None else self.parent.prefix + labelled(self.name, self.copy)
        self.prefix: str = self.path and self.path + "."
        self.streams: str = ""  # with which the names of the streams in it begin
        self.prefixes: tuple[str, ...] = ("",)  # under which its parameters are set: in one copy, or in all of them
        self.fleet: Fleet | None = None if self.copy is None else self.copy.fleet
        self.copies: tuple[Copy | None, ...] = ()  # by the parts of its path
        if self.parent is not None:
            self.copies = (*self.parent.copies, self.copy)
            own = stream_of(self.stream or self.name, self.copy)
            self.streams = streams.joined(self.parent.streams, own) + "."
            self.prefixes = tuple(f"{path}." for path in self.parent.paths(self.name, self.copy))
            self.fleet = self.fleet or self.parent.fleet

    def in_lane(self, lane: int) -> InLane:
        """Return its parameters in a copy."""
        return self.each.get(lane) or InLane(self.parameters, self.origins)

    @property
    def copied(self) -> Fleet | None:
        """Its copies, where the diagram itself has some."""
        return None if self.copy is None else self.copy.fleet

    def paths(self, name: str, copy: Copy | None = None) -> tuple[str, ...]:
        """Return the paths under which something in it is set, that of a single copy first."""
        names = dict.fromkeys((labelled(name, copy), name))
        return tuple(prefix + text for prefix in self.prefixes for text in names)


class Hierarchy:
    """All scopes and all leaves of a diagram, in the order of the text; `faults` are collected, not raised."""

    def __init__(
        self, diagram: DiagramValue, resolver: Resolver, overrides: Mapping[str, object], seed: int = 0
    ) -> None:
        """Open the diagram. seed: of the run."""
        self.resolver, self.overrides, self.seed = resolver, overrides, seed
        self.faults = FaultList()
        self.scopes: list[DiagramScope] = []
        self.leaves: list[Leaf] = []
        self.settable: dict[str, None] = {}  # paths of all parameters, where overrides are given
        self.resolved: dict[object, Resolved] = {}
        self.spelled: dict[object, tuple[Resolved, Origins]] = {}  # by type and parameters as they are written
        self.units: dict[object, Unit] = {}  # of parameters whose unit follows from structural ones
        self.drawing: dict[str, _Drawing] = {}  # by the names of streams
        self.fleets: list[Fleet] = []  # in the order of the text
        self.late: list[LateCopies] = []  # the copies that are looked into when somebody asks for them
        _check_size(diagram)
        self.root = self.open(DiagramScope("", None, diagram, 0, 0))

    def check_overrides(self) -> None:
        """Refuse what is set and is not there, once all copies were looked into."""
        are_seen = not self.faults  # copies behind a fault were not looked into
        for copies in self.late if not self.settable.keys() >= self.overrides.keys() else ():
            copies.look_at_all()  # a name that is meant may be in any of them
        for path in self.overrides:
            of_all = without_numbers(path)[0].replace("[]", "")
            if path not in self.settable and (are_seen or of_all == path or of_all not in self.settable):
                inside = [parameter for parameter in self.settable if parameter.startswith(f"{path}.")]
                cure = parameter_meant(path, self.settable) or self.faults.guess(path, self.settable)
                cure = f"Parameters of {legible(path)}: {_listed(inside)}." if inside else cure
                if of_all in self.settable and of_all != path:
                    around = [fleet for fleet in self.fleets if of_all.startswith(f"{fleet.path}.")]
                    cure = " ".join(f"{fleet.path} has the copies 0 to {fleet.count - 1}." for fleet in around) or cure
                cure = cure or "Give the path of a parameter, as in motor.Ra."
                self.faults.add(Fault("E106", legible(path), "there is no such parameter to set.", cure))

    # --- faults ------------------------------------------------------------------------------------------------

    def tell(self, scope: DiagramScope, code: str, place: str, message: str, cure: str = "", spot: Spot = ()) -> None:
        """Report a fault at a place within a scope. A fault in a diagram that is used twice is reported once."""
        if len(message) > FaultList.LONGEST_MESSAGE:
            message = message[: FaultList.LONGEST_MESSAGE] + " ..."
        if spot is None:
            self.faults.add(Fault(code, scope.prefix + place, message, cure))
        else:
            fault = scope.value.fault(code, scope.prefix + place, message, cure, spot)
            self.faults.add(fault, (id(scope.value), code, place, message, spot))

    def evaluated(self, scope: DiagramScope, raw: object, declared: Unit, place: str, spot: Spot) -> Value | None:
        """Return a raw value in SI; None after a fault was reported."""
        try:
            return value_of(raw, declared, scope.parameters)
        except Absent:
            return None
        except ModelError as error:
            for fault in error.faults:
                self.tell(scope, fault.code, place, fault.message, fault.cure, spot)
            return None

    # --- diagrams ----------------------------------------------------------------------------------------------

    def open(self, scope: DiagramScope) -> DiagramScope:
        """Compute a diagram's parameters and make its blocks. It has what the block entry around it gives."""
        self.scopes.append(scope)
        if scope.depth > DEEPEST:
            raise ModelError(scope.value.fault("E008", scope.path, f"subdiagrams lie more than {DEEPEST} deep."))
        self.parameters(scope)
        for name, entry in scope.value.blocks.items():
            scope.children[name] = self.child(scope, name, entry)
        return scope

    def count(self, scope: DiagramScope, name: str, entry: BlockEntry) -> int | None:
        """Return how many copies of a block there are; None after a fault was reported."""
        spot = ("blocks", name, "copies")
        for word in ("index", "copies"):
            if word in scope.value.parameters:
                message = f"is the name of a parameter, but in the parameters of {name} it has a meaning for copies."
                self.tell(scope, "E109", word, message, "Rename the parameter.", ("parameters", word, AT_KEY))
        value = self.evaluated(scope, entry.copies, "", f"{name}.copies", spot)
        if value is None:
            return None
        count = value.value
        if not isinstance(count, float) or not count.is_integer() or not 1 <= count <= LARGEST_SIZE:
            message = f"must be {_COPIES_ARE}, not {quoted(str(count))}."
            self.tell(scope, "E107", f"{name}.copies", message, "", spot)
            return None
        return int(count)

    def child(self, scope: DiagramScope, name: str, entry: BlockEntry) -> Leaf | DiagramScope | None:
        spot, copy = ("blocks", name), None
        if entry.copies is not None:
            count = self.count(scope, name, entry)
            if count is None:
                return None
            copy = Copy(Fleet(scope.prefix + name, count, scope.fleet), 0, is_first=True)
            self.fleets.append(copy.fleet)
        if entry.inner is not None:
            depth = scope.depth + 1
            inner = DiagramScope(
                name, scope, entry.inner, len(self.scopes), depth, entry.control, entry.stream, copy=copy
            )
            trigger = entry.control.get("trigger", {})
            if "every" in trigger:
                words = {"every": trigger["every"], "offset": trigger.get("offset", 0.0)}
                times = [
                    self.evaluated(scope, raw, "s", f"{name}.trigger.{word}", (*spot, "trigger", word))
                    for word, raw in words.items()
                ]
                if times[0] is not None and times[1] is not None:
                    inner.clock = (times[0], times[1])
            self.give(inner, entry.parameters)
            return self.open(inner)
        if entry.type or entry.fmu:
            return self.leaf(scope, name, entry, copy)
        self.tell(scope, "E007", name, "its subdiagram is not loaded.", "Load the diagram from its file.", spot)
        return None

    def give(self, inner: DiagramScope, given: Mapping[str, object]) -> None:
        """Take the values that a block entry gives to parameters of its subdiagram."""
        outer, known = inner.parent, inner.value.parameters
        assert outer is not None
        within = numbered(outer, inner.copy)
        for key, raw in given.items():
            place, spot = f"{inner.name}.{legible(key)}", ("blocks", inner.name, "parameters", key)
            if key in known:
                unit, depth, value = quantity_of(known[key]).unit, depth_of(known[key]), None
                own = raw
                with contextlib.suppress(Absent):
                    own = self.own(outer, raw, depth, [inner.copy] if inner.copy else [], place, spot)
                    value = self.evaluated(within, own, unit, place, spot) if _fault_of(unit) is None else None
                inner.parameters[key] = value
                inner.origins[key] = Origin(raw, own, own is not raw, unit, depth, is_outer=True)
            else:
                cure = parameter_meant(key, known) or self.faults.guess(key, known) or f"Parameters: {_listed(known)}."
                self.tell(outer, "E106", place, "there is no such parameter.", cure, (*spot, AT_KEY))

    def parameters(self, scope: DiagramScope) -> None:
        """Compute a diagram's parameters: those given from outside, overrides, plain values, then expressions."""
        given, scope.parameters = scope.parameters, {}
        origins: dict[str, Origin] = {}
        for name, entry in scope.value.parameters.items():
            scope.parameters[name] = given.get(name)
            with contextlib.suppress(Absent):
                origins[name] = self.origin(scope, name, entry)
        needs = {name: [] if origin.is_outer else names_in(origin.raw) for name, origin in origins.items()}
        spots: dict[str, Spot] = {name: None if o.set_at else ("parameters", name) for name, o in origins.items()}
        try:
            order = order_of(needs)
        except ModelError as error:
            fault = error.faults[0]
            self.tell(scope, fault.code, fault.place, fault.message, fault.cure, spots[fault.place])
            # Those that are in no cycle may have faults of their own.
            order = [name for name, names in needs.items() if not names]
        scope.origins = {name: origins[name] for name in order}
        for name, origin in scope.origins.items():
            if not origin.is_outer:
                raw = _with_unit(origin.raw, origin.unit)
                scope.parameters[name] = self.evaluated(scope, raw, origin.unit, name, spots[name])

    def origin(self, scope: DiagramScope, name: str, entry: object) -> Origin:
        """Find where the value of a diagram's parameter comes from. Raises Absent after a fault was reported."""
        unit, depth, outer = quantity_of(entry).unit, depth_of(entry), scope.origins.get(name)
        written = entry if outer is None else outer.written
        said, set_at = self.overridden(scope.paths(name), written)
        raw = said
        if set_at:
            try:
                raw = self.own(scope, said, depth, unnumbered(set_at, scope.copies), name, None)
            except Absent:
                scope.parameters[name] = None
                raise
        wrong = _fault_of(unit)
        if wrong is not None:
            self.tell(scope, wrong.code, name, wrong.message, wrong.cure, ("parameters", name, "unit"))
            raise Absent
        return outer if outer is not None and not set_at else Origin(written, raw, raw is not said, unit, depth, set_at)

    def own(self, scope: DiagramScope, raw: object, depth: int, copies: Sequence[Copy], place: str, spot: Spot) -> Any:
        """Return the raw value in one copy of each fleet. Raises Absent after a fault was reported."""
        try:
            return own_value(raw, depth, copies)
        except ModelError as error:
            fault = error.faults[0]
            self.tell(scope, fault.code, place, fault.message, fault.cure, spot)
            raise Absent from None

    def overridden(self, paths: tuple[str, ...], raw: object) -> tuple[object, str]:
        """Return the raw value that counts, and the path by which it is set ("": it is none that is).

        paths: under which it may be set. A bound parameter cannot be set itself (E117).
        """
        if not self.overrides:
            return raw, ""
        self.settable |= dict.fromkeys(paths)
        full = next((path for path in paths if path in self.overrides), "")
        if not full:
            return raw, ""
        for fault in bound_faults(full, raw):
            self.faults.add(fault)
        return self.overrides[full], full

    # --- blocks ------------------------------------------------------------------------------------------------

    def leaf(self, scope: DiagramScope, name: str, entry: BlockEntry, copy: Copy | None = None) -> Leaf | None:
        """Make a block of a type; None after its faults were reported. Those that are written alike share numbers."""
        key = None if self.overrides or copy else spelling(entry, scope)
        made = self.spelled.get(key) if key is not None else None
        if made is None:
            made = self.numbers(scope, name, entry, copy)
            if made is None:
                return None
            # Each block reports its own faults, and has its own stream.
            if key is not None and not self.faults and not made[0].interface.declaration.streams:
                self.spelled[key] = made
        leaf = Leaf(name, scope, *made, len(self.leaves), copy and copy.fleet)
        self.leaves.append(leaf)
        if leaf.interface.declaration.streams:
            self.check_stream(leaf, streams.joined(scope.streams, stream_of(entry.stream or name, copy)))
        return leaf

    def check_stream(self, leaf: Leaf, stream: str) -> None:
        """Refuse a stream that two blocks draw from by accident.

        A block that names its stream itself does so on purpose. For any other, the nearest subdiagram around it that
        names one (else the whole diagram) must not hold another block that draws from the stream.
        """
        known = self.drawing.setdefault(stream, _Drawing(leaf.path))
        around, holder = set(), set()
        scope: DiagramScope | None = leaf.scope
        is_open = not leaf.scope.value.blocks[leaf.name].stream
        while scope is not None:
            around.add(scope.index)
            if is_open and (scope.stream or scope.parent is None):
                holder, is_open = {scope.index}, False
            scope = scope.parent
        if holder & known.around or around & known.holders:
            message = f"draws from the stream {quoted(stream)}, as {known.first} does: both would be equal."
            cure = f'Give one of them another "stream", or both "stream": "/{stream}" if they should share it.'
            self.tell(leaf.scope, "E109", leaf.name, message, cure, ("blocks", leaf.name))
            return
        known.around |= around
        known.holders |= holder

    def numbers(
        self, scope: DiagramScope, name: str, entry: BlockEntry, copy: Copy | None = None
    ) -> tuple[Resolved, Origins] | None:
        """Settle a block's type and its values, with where they come from; None after its faults were reported.

        copy: which one of its copies.
        """
        cls = self.block_class(scope, name, entry)
        if cls is None:
            return None
        declaration: Declaration = cls.declaration
        raws = self.written(scope, name, entry, declaration)
        self.override(scope, name, declaration, raws, copy)
        within, shown = numbered(scope, copy), labelled(name, copy)
        given: dict[str, Value] = {}
        origins: dict[str, Origin] = {}
        # Structural ones first: units may follow from them.
        for key in sorted(raws, key=lambda key: not declaration.parameters[key].structural):
            said, set_at, spot = raws[key]
            parameter, place = declaration.parameters[key], f"{shown}.{key}"
            depth, raw = dimensions(parameter.shape), said
            if set_at or copy:
                copies = unnumbered(set_at, (*scope.copies, copy)) if set_at else [copy] if copy else []
                try:
                    raw = self.own(scope, said, depth, copies, place, spot)
                except Absent:
                    continue
            declared = self.declared_unit(scope, name, cls, parameter, raws, given)
            value = None if declared is None else self.evaluated(within, raw, declared, place, spot)
            if declared is not None and value is not None:
                given[key], written = value, entry.parameters.get(key)
                origins[key] = Origin(written, raw, raw is not said, declared, depth, set_at, True)
        for key, late in late_units_of(cls, given).items() if len(given) == len(raws) else ():
            value = self.evaluated(within, origins[key].raw, late, f"{shown}.{key}", raws[key][2])
            given.pop(key)
            if value is not None:
                given[key], origins[key] = value, origins[key]._replace(unit=late)
        is_complete = len(given) == len(raws)
        for key in declaration.streams:
            stream = streams.joined(scope.streams, stream_of(entry.stream or name, copy))
            given[key] = Value(streams.number_of(self.seed, stream))
            origins[key] = Origin(None, None, stream=stream)
        if is_complete and declaration.foreign is not None:  # structural parameters of an FMU are sizes of its arrays
            cls = declaration.foreign.resized(given) or cls
        resolved = self.resolve(scope, name, cls, given, raws) if is_complete else None
        return None if resolved is None else (resolved, origins)

    def block_class(self, scope: DiagramScope, name: str, entry: BlockEntry) -> type[Block] | None:
        """Find the class of a block; None after a fault was reported."""
        spot = ("blocks", name)
        if entry.cls is not None:
            return entry.cls
        if entry.fmu:
            try:
                return self.resolver.fmu(entry, scope.value.folder)
            except BlocksError as error:
                for fault in error.faults:
                    self.tell(scope, fault.code, name, f"{entry.fmu}: {fault.message}", fault.cure, (*spot, "fmu"))
                return None
        try:
            return self.resolver(entry.type)
        except KeyError as error:
            known_types = [word for word in error.args if word != entry.type]
            meant = TYPES.get(entry.type) or hint(entry.type, known_types)
            meant = meant or self.faults.guess(entry.type, known_types)
            cure = f"{meant} `blocks list` shows the types; --library adds your own.".strip()
            self.tell(scope, "E103", name, f"there is no block type {quoted(entry.type)}.", cure, (*spot, "type"))
            return None

    def written(self, scope: DiagramScope, name: str, entry: BlockEntry, declaration: Declaration) -> _Raws:
        """Collect the raw values of a block's entry. What the block does not have is a fault."""
        spot = ("blocks", name)
        raws: _Raws = {}
        for key, raw in entry.parameters.items():
            if key in declaration.settable:
                raws[key] = (raw, "", (*spot, "parameters", key))
            else:
                cure = parameter_meant(key, declaration.settable, declaration.inputs, entry.type)
                cure = cure or self.faults.guess(key, declaration.settable)
                cure = cure or f"Parameters of {entry.type or entry.fmu}: {_listed(declaration.settable)}."
                if key in declaration.streams:
                    cure = f'Write "stream": {quoted(str(raw))} beside "type" and "parameters".'
                message = f"{entry.type or entry.fmu} has no parameter of this name."
                at_key = (*spot, "parameters", key, AT_KEY)
                self.tell(scope, "E106", f"{name}.{legible(key)}", message, cure, at_key)
        if entry.stream and not declaration.streams:
            message, cure = "draws no random numbers, so it has no stream.", "Leave the stream out."
            self.tell(scope, "E003", f"{name}.stream", message, cure, (*spot, "stream", AT_KEY))
        return raws

    def override(
        self, scope: DiagramScope, name: str, declaration: Declaration, raws: _Raws, copy: Copy | None
    ) -> None:
        """Put what is set by its path in the place of what the entry says."""
        for key in declaration.settable if self.overrides else ():
            paths = tuple(f"{path}.{key}" for path in scope.paths(name, copy))
            raw, set_at = self.overridden(paths, raws[key][0] if key in raws else None)
            if set_at:
                raws[key] = (raw, set_at, None)

    def declared_unit(
        self,
        scope: DiagramScope,
        name: str,
        cls: type[Block],
        parameter: Parameter,
        raws: Mapping[str, Any],
        given: Mapping[str, Value],
    ) -> Unit | None:
        """Return the unit in which a bare number of this parameter is meant; it may follow from structural parameters.

        None where that cannot be known because of a fault.
        """
        if isinstance(parameter.unit, str):
            return parameter.unit
        if parameter.name in late_units(cls.declaration):
            return ""  # `late_units_of` knows it once all values are known
        known: dict[str, Value] = {}
        for read in arguments(parameter.unit, parameter.name):
            structural = cls.declaration.parameters[read]
            if read in raws and read not in given:
                return None
            value = given[read].value if read in given else structural.default
            value = int(value) if structural.type == "int" and isinstance(value, float) else value
            if isinstance(value, int) and abs(value) > LARGEST:
                return ""  # `resolve` refuses it
            known[read] = Value(value)
        try:
            key = (parameter, *(_hashable(value.value) for value in known.values()))
            if key in self.units:
                return self.units[key]
            declared = unit_from(parameter, known)
            for text in dict.fromkeys((declared,) if isinstance(declared, str) else declared):
                if text:
                    units.parse(text)
            check_differences((declared,) if isinstance(declared, str) else declared, name)
        except ModelError as error:
            fault = error.faults[0]
            self.tell(scope, fault.code, name, fault.message, fault.cure, ("blocks", name))
            return None
        except Exception:  # a function of the class may raise anything; wrong sizes are reported by `resolve`
            return ""
        self.units[key] = declared
        return declared

    def resolve(
        self, scope: DiagramScope, name: str, cls: type[Block], given: Mapping[str, Value], raws: _Raws
    ) -> Resolved | None:
        """Settle sizes, defaults, ranges and ports of a block. Blocks with equal values share them."""
        # The hash of a ratio takes less time than that of a fraction.
        values = [(_hashable(v.value), v.exact and v.exact.as_integer_ratio(), v.unit) for v in given.values()]
        key = (cls, *zip(given, values, strict=True))
        if key in self.resolved:
            return self.resolved[key]
        free = loose(cls.declaration)
        changed = {word: value for word, value in given.items() if word in free and type(value.value) is float}
        shared = (cls, *((word, Value) if word in changed else own for word, own in zip(given, key[1:], strict=True)))
        like = self.resolved.get(shared)
        if like is not None and (made := with_numbers(like, changed)) is not None:
            self.resolved[key] = made
            return made
        try:
            resolved_block = resolve(cls, given, name)
            clashes = set(resolved_block.interface.inputs) & set(resolved_block.interface.outputs)
            if clashes:
                message = f"'{min(clashes)}' is the name of both an input and an output."
                raise ModelError(Fault("E109", name, message, "Rename one of them."))
        except ModelError as error:
            own = cls.declaration.name
            written = scope.value.blocks.get(name, BlockEntry()).parameters  # the condition of a run has no entry
            misspelt = any(word not in cls.declaration.parameters for word in written)
            for fault in error.faults:
                if misspelt and fault.place.rpartition(".")[2] not in given:
                    continue  # what is missing is probably what is misspelt, and that was reported
                # Ports do not know their block: their faults begin with the name of the type.
                place = name + fault.place[len(own) :] if f"{fault.place}.".startswith(f"{own}.") else fault.place
                word = place.rpartition(".")[2]
                where = raws[word][2] if word in raws else ("blocks", name)
                self.tell(scope, fault.code, place, fault.message, fault.cure, where)
            return None
        self.resolved[key] = self.resolved[shared] = resolved_block
        return resolved_block


def numbered(scope: DiagramScope, copy: Copy | None) -> DiagramScope:
    """Return a diagram as the parameters of a copy of a block in it see it: with its number, and how many there are."""
    if copy is None:
        return scope
    own = {"index": copy.number, "copies": copy.fleet.count}
    values = {word: Value(float(number), Fraction(number)) for word, number in own.items()}
    made = shallow_copy(scope)
    made.parameters = {**scope.parameters, **values}
    return made


def is_equal(one: Value | None, other: Value | None) -> bool:
    """Return whether two values of parameters are one, in the signs of zeros too."""
    if one is None or other is None:
        return one is other
    return _hashable(one.value) == _hashable(other.value) and (one.exact, one.unit) == (other.exact, other.unit)


def bound_faults(path: str, raw: object) -> list[Fault]:
    """Return the fault (E117) of setting a parameter that its raw value binds by an expression, if it does."""
    bound = next(expressions_in(raw), "")
    message = f"is computed from other parameters ({quoted(bound)}), so it cannot be set itself."
    return [Fault("E117", path, message, "Set the parameters that it is computed from.")] if bound else []


def _fault_of(unit: str) -> Fault | None:
    """Return what is wrong with a unit."""
    try:
        if unit:
            units.parse(unit)
    except ModelError as error:
        return error.faults[0]
    return None


def _with_unit(raw: object, unit: Unit) -> object:
    """Return a text or a bool for a parameter with a unit, as a quantity: a fault, as with a unit of its own."""
    return {"value": raw, "unit": unit} if unit and isinstance(raw, (bool, str)) else raw


def spelling(entry: BlockEntry, scope: DiagramScope, loose: Mapping[str, object] | None = None) -> object:
    """Return a key that is equal for blocks of one type with parameters, but for loose ones, written alike, or None."""
    if entry.stream:  # which not every block has
        return None
    written = []
    for name, raw in entry.parameters.items():
        key = Number if loose and name in loose else _written(raw, scope)
        if key is None:
            return None
        written.append((name, key))
    return (entry.cls or entry.type or entry.fmu, *map(repr, getattr(entry, "options", {}).items()), *written)


def _written(raw: Any, scope: DiagramScope) -> object:
    """Return a raw value as it is written, with its scope where it is an expression; None for what no text holds."""
    kind = type(raw)
    if kind is Number:
        return (Number, raw.text)
    if kind is str:
        return (scope.index, raw) if is_expression(raw) else raw
    if kind is bool:
        return (bool, raw)
    if kind is list or kind is dict:
        if "edges" in raw:
            return (kind, id(raw))
        keys = tuple(raw) if kind is dict else ()
        items = tuple(_written(item, scope) for item in (raw.values() if kind is dict else raw))
        return None if None in items else (kind, keys, items)
    return None


def _hashable(value: object) -> object:
    """Return a key of a value: 0.0 and -0.0, which are equal, are two."""
    return tuple(_hashable(item) for item in value) if isinstance(value, list) else (type(value), value or repr(value))


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _check_size(diagram: DiagramValue) -> None:
    """Refuse a diagram that would be too large once opened: files that use each other twice grow without end."""
    sizes: dict[int, int] = {}

    def size(value: DiagramValue, depth: int) -> int:
        if depth > DEEPEST:
            raise ModelError(value.fault("E008", value.name, f"subdiagrams lie more than {DEEPEST} deep."))
        if id(value) not in sizes:
            inner = (1 if entry.inner is None else 1 + size(entry.inner, depth + 1) for entry in value.blocks.values())
            sizes[id(value)] = sum(inner)
        return sizes[id(value)]

    total = size(diagram, 0)
    if total > MAX_BLOCKS:
        message = f"the diagram has {total:,} blocks, but the limit is {MAX_BLOCKS:,}."
        raise ModelError(diagram.fault("E008", diagram.name, message))
