"""The public Diagram: builds the frozen value, and has the verbs.

    loop = Diagram("speed_loop")
    r = loop.input("r", unit="rad/s")
    error = loop.add("error", Sum(signs="+-", unit="rad/s"))
    motor = loop.add("motor", PMDCMotor())
    loop.wire(error.u1, r)                      # sink first, as in the file
    loop.wire(error.u2, motor.omega)
    results = loop.run(stop=1.0, inputs={"r": 1.0})

A run keeps the value that it began with: what is added to a Diagram afterwards does not reach it.

This file is longer than others: it is all that a person calls, and every misuse is told here.
"""

from __future__ import annotations

import builtins
import contextlib
import enum
import inspect
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.coupling import Coupling, couple
from ..compile.plan import Plan
from ..compile.plan_builder import plan
from ..contract.block import Block
from ..contract.enumerations import Enumeration, enumeration_of, resting
from ..contract.outside import Outside
from ..model import document as documents
from ..model.block_types import Library, library_types
from ..model.diagram import BASE, BlockEntry, DiagramValue, FaultList, beside, is_name, name_cure
from ..model.flatten import Flat, flatten, interface_of
from ..model.raw_values import raw_of
from ..model.resolver import resolver_of
from ..model.variants import Match, Swap, match, taken, used_ports
from ..results.results import Results
from ..text import units
from ..text.atomic_write import write_atomically
from ..text.errors import (
    AnalysisError,
    BlocksError,
    Fault,
    ModelError,
    UsageError,
    did_you_mean,
)
from ..text.json_text import quoted
from ..text.printable import legible
from .last_made import LastMade
from .values import check_settings, time_of

if TYPE_CHECKING:
    from ..editing.diff import Differences
    from ..engines.run.saved_state import State
    from ..export.exporter import Exported
    from ..linear.linear_model import LinearModel
    from ..linear.linearizer import Linearizer
    from ..linear.operating_point import OperatingPoint
    from ..linear.point import Point
    from ..model.trust import Paths
    from .run import Run, RunOptions

__all__ = [
    "Diagram",
    "Handle",
    "PortName",
    "Subdiagram",
    "at_rest",
    "run_of",
    "subdiagram",
]

# --- building --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PortName:
    """A port of a block in a diagram, or an input of the diagram; `port[0]` is one element."""

    diagram: Diagram
    text: str
    is_input: bool
    unit: str = ""

    def __getitem__(self, index: int) -> PortName:
        if "[" in self.text or index < 0:
            raise IndexError(f"{self.text}[{index}]: an element of a port is counted from 0.")
        return replace(self, text=f"{self.text}[{index}]")

    def __iter__(self) -> Any:
        raise TypeError(f"{self.text} is the name of a port; its elements are {self.text}[0], {self.text}[1], ...")

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<{'input' if self.is_input else 'output'} {self.text}{f' [{self.unit}]' if self.unit else ''}>"


class Handle:
    """A block in a diagram; its ports are attributes."""

    __slots__ = ("_diagram", "_inputs", "_name", "_outputs")
    _diagram: Diagram
    _name: str
    _inputs: Mapping[str, str]
    _outputs: Mapping[str, str]

    def __init__(self, diagram: Diagram, name: str, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> None:
        for slot, value in (("_diagram", diagram), ("_name", name), ("_inputs", inputs), ("_outputs", outputs)):
            object.__setattr__(self, slot, value)

    def __getattr__(self, port: str) -> PortName:
        if port in Handle.__slots__ or port.startswith("__"):
            raise AttributeError(port)
        for table, is_input in ((self._inputs, True), (self._outputs, False)):
            if port in table:
                return PortName(self._diagram, f"{self._name}.{port}", is_input, table[port])
        known = (*self._inputs, *self._outputs)
        fault = Fault("E105", self._name, f"there is no port {quoted(port)}.", did_you_mean(port, known))
        raise AttributeError(f"{fault} Inputs: {_listed(self._inputs)}. Outputs: {_listed(self._outputs)}.")

    def __setattr__(self, port: str, value: Any) -> None:
        raise AttributeError(f"a port is wired by diagram.wire({self._name}.{port}, source), not assigned.")

    def __reduce__(self) -> Any:
        return Handle, (self._diagram, self._name, self._inputs, self._outputs)

    def __dir__(self) -> list[str]:
        return [*self._inputs, *self._outputs]

    def __repr__(self) -> str:
        return f"<block {self._name}: inputs {_listed(self._inputs)}; outputs {_listed(self._outputs)}>"


def _listed(ports: Mapping[str, str]) -> str:
    """Names with their units; of very many, as an FMU may have, the first ones."""
    shown = [f"{name}{f' [{unit}]' if unit else ''}" for name, unit in islice(ports.items(), MOST_LISTED)]
    more = f" and {len(ports) - MOST_LISTED:,} more" if len(ports) > MOST_LISTED else ""
    return (", ".join(shown) or "none") + more


@dataclass(frozen=True, slots=True)
class Subdiagram:
    """A diagram used as a block, with values for its parameters."""

    source: Diagram | str
    parameters: Mapping[str, Any]


def subdiagram(source: Diagram | str | Path, **parameters: Any) -> Subdiagram:
    """A diagram, or the path of a diagram file, as a block of another."""
    return Subdiagram(source if isinstance(source, Diagram) else str(source), parameters)


MOST_LISTED = 40
"""Ports that an error lists."""

MOST_DRAWN = 100
"""Blocks of a diagram whose FMU shows its drawing."""

MOST_KEPT = 2**24
"""Bytes of rows of a run that is kept for the next one."""


def _key(value: DiagramValue, engine: str | None, settings: Mapping[str, Any]) -> Any:
    """What a run without inputs follows from; None where that is not known before the run."""
    plain = (str, int, float, type(None))
    if not all(isinstance(item, plain) for item in settings.values()) or _names_files(value):
        return None
    given = tuple((name, type(item), item) for name, item in settings.items())  # 1 is no True
    return id(value), value, engine, os.environ.get("BLOCKS_ENGINE"), os.environ.get("CC"), given


def _names_files(value: DiagramValue) -> bool:
    """Whether other files, which may change, say what a diagram is."""
    for entry in value.blocks.values():
        is_file = (entry.diagram and entry.inner is None) or entry.fmu or entry.variants
        if is_file or (entry.inner and _names_files(entry.inner)):
            return True
    return bool(value.run.get("inputs"))


class Diagram:
    """A block diagram that can be built, loaded, saved, checked and run.

    folder: where the paths of subdiagram files begin (the current folder unless given). library: block types, modules
    or names of modules beyond the library that ships.
    """

    def __init__(self, name: str = "diagram", *, folder: str | Path = "", library: Library = ()) -> None:
        _check_name(name)
        self._types = library_types(library)
        self._frozen = DiagramValue(name, folder=os.path.abspath(folder))
        self._open: dict[str, dict[str, Any]] = {}
        self._last = LastMade()

    # --- from and to files -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, path: str | Path, *, library: Library = ()) -> Diagram:
        """The diagram of a file. Raises ModelError with all faults, where its structure has some."""
        return cls._read(library, lambda: documents.load(path))

    @classmethod
    def from_json(
        cls, document: str | bytes | Mapping[str, Any], *, folder: str | Path = "", library: Library = ()
    ) -> Diagram:
        """The diagram of a JSON text or of the dict that it stands for. Raises ModelError as `load`."""
        if isinstance(document, (str, bytes)):
            return cls._read(library, lambda: documents.loads(document, folder=folder))
        return cls._read(library, lambda: documents.from_document(document, folder=folder))

    @classmethod
    def _read(cls, library: Library, read: Callable[[], DiagramValue]) -> Diagram:
        try:
            return cls._of(read(), library)
        except ModelError as error:
            value = error.readable
            if value is None:
                raise
            faults = FaultList()
            faults.update((*error.faults, *_beside(error, lambda: cls._of(value, library).flatten())))
        raise ModelError(*faults.in_order())

    @classmethod
    def _of(cls, value: DiagramValue, library: Library) -> Diagram:
        made = cls(value.name, folder=value.folder, library=library)
        made._frozen = value
        return made

    def to_json(self) -> dict[str, Any]:
        """The dict of the canonical file, with ordinary numbers."""
        return json.loads(self.dumps())  # type: ignore[no-any-return]

    def dumps(self) -> str:
        """The text of the canonical file."""
        return documents.dumps(self.value)

    def save(self, path: str | Path) -> None:
        """Write the canonical file; an existing one is replaced as a whole. Raises UsageError (E501)."""
        text = documents.dumps(documents.relocated(self.value, Path(path).parent))
        with write_atomically(path) as stream:
            stream.write(text)

    def copy(self) -> Diagram:
        """A diagram of its own with the same value."""
        return self._like(self.value)

    def _like(self, value: DiagramValue) -> Diagram:
        """A diagram with another value and the same block types."""
        made = Diagram.__new__(Diagram)
        made._types, made._frozen, made._open = self._types, value, {}
        made._last = LastMade()
        return made

    def __getstate__(self) -> dict[str, Any]:
        """What a copy or a pickle of it holds: the value and the block types, nothing of what was run."""
        return {"_types": self._types, "_frozen": self.value, "_open": {}, "_last": LastMade()}

    # --- building ----------------------------------------------------------------------------------------------

    @property
    def value(self) -> DiagramValue:
        """The frozen value."""
        if self._open:
            self._frozen, self._open = replace(self._frozen, **self._open), {}  # type: ignore[arg-type]
        return self._frozen

    @property
    def name(self) -> str:
        return self._frozen.name

    def _put(self, section: str, entries: Mapping[str, Any]) -> None:
        """Add entries. A section is copied once between two readings of the value: building is not quadratic."""
        if entries and section not in self._open:
            self._open[section] = dict(getattr(self._frozen, section))
        if entries:
            self._open[section].update(entries)

    def _section(self, section: str) -> Mapping[str, Any]:
        made: Mapping[str, Any] = self._open[section] if section in self._open else getattr(self._frozen, section)
        return made

    def _free(self, name: str, kind: str) -> None:
        """Refuse what is no name, and a name that is taken. An output may be called like a block or a parameter."""
        _check_name(name)
        seen = {"input": ("output", "input", "block", "parameter"), "output": ("output", "input")}
        for what in seen.get(kind, ("input", "block", "parameter")):
            if name in self._section(what + "s"):
                article = "an" if what[0] in "io" else "a"
                raise ModelError(Fault("E109", name, f"the name is taken by {article} {what}."))

    def parameter(self, name: str, value: Any, *, unit: str = "", doc: str = "") -> str:
        """A parameter of the diagram; returns "=name", which blocks take as a value."""
        self._free(name, "parameter")
        entry = raw_of(value)
        if unit or doc:
            entry = dict(entry) if isinstance(entry, dict) else {"value": entry}
            entry |= {**({"unit": unit} if unit else {}), **({"doc": doc} if doc else {})}
        made = documents.entries(folder=self._frozen.folder, parameters={name: entry})
        self._put("parameters", made.parameters)
        return f"={name}"

    def input(
        self,
        name: str,
        *,
        unit: str = "",
        default: Any = None,
        size: int | Sequence[int] | None = None,
        type: str | builtins.type[enum.IntEnum] | Enumeration = "real",
        doc: str = "",
    ) -> PortName:
        """An input of the diagram, as a source for wires. With `size` it is a vector, or a matrix: (2, 3).

        default: one value, or a list with one for each element. type: "real", "int", "bool", or an `enum.IntEnum`, of
        which default is a member, or its name.
        """
        self._free(name, "input")
        kind = Enumeration.of(type) if isinstance(type, builtins.type) and issubclass(type, enum.IntEnum) else type
        entry: dict[str, Any] = {} if unit == "" else {"unit": unit}
        entry |= {} if default is None else {"default": _named(raw_of(default), kind)}
        entry |= {} if size is None else {"size": raw_of(size)}
        entry |= {} if kind == "real" else {"type": kind.entry if isinstance(kind, Enumeration) else kind}
        entry |= {} if doc == "" else {"doc": doc}
        made = documents.entries(inputs={name: entry})
        self._put("inputs", made.inputs)
        return PortName(self, name, False, unit)

    def output(self, name: str, source: PortName | str) -> None:
        """An output of the diagram."""
        self._free(name, "output")
        self._put("outputs", {name: self._source(source)})

    def add(
        self,
        name: str,
        block: Block | Diagram | Subdiagram,
        *,
        doc: str = "",
        at: tuple[float, float] | None = None,
        enable: Mapping[str, Any] | None = None,
        trigger: Mapping[str, Any] | None = None,
        stream: str = "",
    ) -> Handle:
        """Add a block (or a diagram as a block) and return its ports as attributes.

        at: its position in drawings. enable: of a diagram, what its states and outputs do while it is off,
        {"states": "held" | "reset", "outputs": "held" | "reset"}; it gets the bool input `enable`. trigger:
        {"direction": "up" | "down" | "both"}, for the input `trigger`, or {"every": period, "offset": ...}. stream: the
        name of its stream of random numbers, if that is not its own. Raises ModelError for a name that is taken or
        parameters that do not fit.
        """
        self._free(name, "block")
        control = {"enable": enable, "trigger": trigger}
        control = {key: value for key, value in control.items() if value is not None}
        entry = self._entry(name, block, doc, control, stream)
        layout: Mapping[str, Any] = {}
        if at is not None:
            layout = documents.entries(layout={name: raw_of(at)}, blocks={name: {"type": "Block"}}).layout
        inputs, outputs = self._ports(name, entry)
        self._put("blocks", {name: entry})
        self._put("layout", layout)
        return Handle(self, name, inputs, outputs)

    def _entry(
        self,
        name: str,
        block: Block | Diagram | Subdiagram,
        doc: str = "",
        control: Mapping[str, Any] | None = None,
        stream: str = "",
    ) -> BlockEntry:
        """The entry of a block, checked as a file's is."""
        if inspect.isclass(block):
            cure = f"Add a block of it: {block.__name__}()."
            raise UsageError(Fault("E501", name, f"{block.__name__} is a class.", cure))
        if isinstance(block, Diagram):
            block = subdiagram(block)
        if isinstance(block, Block):
            known = type(block).declaration.parameters
            # None stands for what is not given; a file leaves it out.
            given = {k: raw_of(v) for k, v in block.parameters.items() if v is not None or known[k].default is not None}
            entry = self._entry_of(type(block))
        elif isinstance(block, Subdiagram):
            given = {k: raw_of(v) for k, v in block.parameters.items() if v is not None}
            entry = self._subdiagram(block)
        else:
            cure = "Add a Block, a Diagram or a subdiagram(...)."
            raise UsageError(Fault("E501", name, f"{quoted(repr(block))} is not a block.", cure))
        # What stands for the block is checked as a file's is; a subdiagram was checked before.
        described: dict[str, Any] = {"type": entry.type or "Subdiagram"}
        if entry.fmu:
            described = {"fmu": entry.fmu, **entry.options}
        elif control and not entry.type:
            described = {"diagram": {}}
        described |= {"parameters": given, **({"doc": doc} if doc else {})}
        described |= {key: raw_of(value) for key, value in (control or {}).items()}
        described |= {"stream": stream} if stream else {}
        read = documents.entries(folder=self._frozen.folder, blocks={name: described}).blocks[name]
        parts = {key: getattr(read, key) for key in ("parameters", "doc", "control", "options", "stream")}
        return replace(entry, **parts)

    def _entry_of(self, cls: type[Block]) -> BlockEntry:
        """The entry of a block of a class: its type, or the path of its FMU from the diagram's folder on."""
        foreign = cls.declaration.foreign
        if foreign is None:
            return BlockEntry(type=cls.__name__, cls=cls)
        from ..model.fmu_block import fmu_type

        path = foreign.path
        with contextlib.suppress(ValueError):  # another drive
            path = Path(os.path.relpath(path, self._frozen.folder))
        usual = inspect.signature(fmu_type).parameters["timeout"].default
        options: dict[str, Any] = {"kind": foreign.kind}
        options |= {"isolate": True} if foreign.isolate else {}
        options |= {"timeout": foreign.timeout} if foreign.timeout != usual else {}
        return BlockEntry(fmu=path.as_posix(), options=options, cls=cls)

    def _subdiagram(self, block: Subdiagram) -> BlockEntry:
        if isinstance(block.source, Diagram):
            self._types = {**block.source._types, **self._types}
            return BlockEntry(diagram=documents.relocated(block.source.value, self._frozen.folder))
        return BlockEntry(diagram=block.source, loaded=documents.load(Path(self._frozen.folder) / block.source))

    def _ports(self, name: str, entry: BlockEntry) -> tuple[dict[str, str], dict[str, str]]:
        """Input and output ports with their units. Parameters over the diagram are taken as they are now."""
        if entry.variants and entry.variant not in ("", BASE):
            # Wires name the block's own ports; those that only the variant has can be wired as well.
            variant = entry.variants[entry.variant]
            tables = self._ports(name, replace(entry, variants={}, variant="")), self._ports(name, variant)
            taken = set(variant.ports.values())
            own = [{key: unit for key, unit in table.items() if key not in taken} for table in tables[1]]
            return own[0] | tables[0][0], own[1] | tables[0][1]
        inner = entry.inner
        if inner is not None:
            inputs = {key: str(given.get("unit", "")) for key, given in inner.inputs.items()}
            inputs |= dict.fromkeys(entry.control_inputs, "")
            return inputs, dict.fromkeys(inner.outputs, "")
        parameters, folder = self._section("parameters"), self._frozen.folder
        probe = DiagramValue(self.name, parameters=parameters, blocks={name: entry}, folder=folder)
        interface = interface_of(probe, name, resolver_of(self._types))
        return (
            {port.name: port.unit for port in interface.inputs.values()},
            {port.name: port.unit for port in interface.outputs.values()},
        )

    def __getitem__(self, name: str) -> Handle:
        """The ports of a block that is there already."""
        blocks = self._section("blocks")
        if name not in blocks:
            cure = did_you_mean(name, blocks) or f"Blocks: {', '.join(blocks) or 'none'}."
            raise KeyError(f"there is no block {name!r}. {cure}")
        return Handle(self, name, *self._ports(name, blocks[name]))

    def wire(self, sink: PortName | str, source: PortName | str) -> None:
        """Connect a source to a sink: the sink comes first, as in the file. Raises ModelError (E109, E112)."""
        text = self._text(sink)
        if isinstance(sink, PortName) and not sink.is_input:
            swapped = isinstance(source, PortName) and source.is_input
            cure = f"The sink comes first: wire({source}, {sink})." if swapped else "A wire ends at an input."
            raise ModelError(Fault("E112", text, "is a source, and a wire ends at an input.", cure))
        wires = self._section("wires")
        if text in wires:
            message = f"is wired already, to {legible(wires[text])}."
            raise ModelError(Fault("E109", legible(text), message, "Use Sum to add signals."))
        self._put("wires", {text: self._source(source)})

    def _source(self, source: PortName | str) -> str:
        if isinstance(source, PortName) and source.is_input:
            raise ModelError(Fault("E112", source.text, "is an input, and a wire begins at an output."))
        return self._text(source)

    def _text(self, port: PortName | str) -> str:
        if isinstance(port, PortName):
            if port.diagram is not self:
                message = f"belongs to the diagram {port.diagram.name}, not to {self.name}."
                if port.diagram.name == self.name:
                    message = f"belongs to another diagram called {self.name}."
                raise ModelError(Fault("E105", port.text, message))
            return port.text
        if not isinstance(port, str):
            what = f"{quoted(repr(port))} is not a port."
            raise UsageError(Fault("E501", "wire", what, "Use block.port, or its name as a text."))
        return port

    def swap(
        self,
        name: str,
        block: Block | Diagram | Subdiagram,
        *,
        variant: str = "",
        ports: Mapping[str, str] | None = None,
        doc: str = "",
    ) -> Swap:
        """Put another block in the place of one, and say what was matched; wires, outputs, log and measures stay.

        Ports are matched by name, then by spelling (without case and underscores), then by unit where that leaves no
        choice; ports: by hand, {"omega": "w"}. Values of parameters of equal names go along where they can, and so does
        the name of the stream of random numbers. The block that was there stays as well: the new one is a variant of
        it, chosen from now on, and the file keeps both. variant: its name ("fmu", or the name of the type or the
        diagram). `run(variants={name: "base"})` takes the block that was there before.

        Raises ModelError where a port that is used has no partner; then nothing is changed.
        """
        blocks = self._section("blocks")
        if name not in blocks:
            cure = did_you_mean(str(name)[:200], blocks) or f"Blocks: {', '.join(blocks) or 'none'}."
            raise ModelError(Fault("E105", legible(str(name)), "there is no such block to swap.", cure))
        base = replace(blocks[name], variants={}, variant="")
        is_subdiagram = isinstance(block, (Diagram, Subdiagram))
        entry = self._entry(name, block, doc, base.control if is_subdiagram else None)
        kind = "fmu" if entry.fmu else entry.type or (entry.inner.name if entry.inner is not None else "diagram")
        variant = variant or kind
        _check_name(variant)
        if variant == BASE or variant in blocks[name].variants:
            message = f"there is a variant {quoted(variant)} already."
            raise ModelError(Fault("E109", name, message, "Name it otherwise: variant=..."))
        before, after = self._ports(name, base), self._ports(name, entry)
        matched = _matched(self.value, name, before, after, dict(ports or {}))
        entry, kept, dropped = self._parameters_kept(name, base, entry)
        if base.stream and (is_subdiagram or (entry.cls is not None and entry.cls.declaration.streams)):
            entry = replace(entry, stream=base.stream)
        inputs, outputs = matched
        found = {one.name for one in (*inputs, *outputs)}, {one.own for one in (*inputs, *outputs)}
        made = Swap(
            name, variant, base.what or "subdiagram", entry.what or "subdiagram", inputs, outputs,
            tuple(key for table in before for key in table if key not in found[0]),
            tuple(key for table in after for key in table if key not in found[1]),
            kept, dropped,
        )  # fmt: skip
        entry = replace(entry, ports=made.ports)
        changed = replace(blocks[name], variant=variant, variants={**blocks[name].variants, variant: entry})
        self._put("blocks", {name: changed})
        return made

    def _parameters_kept(
        self, name: str, old: BlockEntry, new: BlockEntry
    ) -> tuple[BlockEntry, tuple[str, ...], tuple[tuple[str, str], ...]]:
        """The new entry with the old one's values for parameters of equal names; those kept, and those not and why."""
        kept: list[str] = []
        dropped: list[tuple[str, str]] = []
        units_ = self._units(old), self._units(new)
        for key, raw in old.parameters.items():
            if key in new.parameters:
                continue  # it was given anew
            if key not in units_[1]:
                dropped.append((key, "there is none of this name"))
                continue
            unit = units_[0].get(key, "")
            is_number = isinstance(raw, (int, float)) and not isinstance(raw, bool)
            if is_number and unit and unit != units_[1][key]:
                raw = {"value": raw, "unit": unit}  # it was meant in the unit that the other one declares
            tried = replace(new, parameters={**new.parameters, key: raw})
            try:
                self._ports(name, tried)
            except ModelError as error:
                dropped.append((key, error.faults[0].message))
            else:
                new = tried
                kept.append(key)
        return new, tuple(kept), tuple(dropped)

    def _units(self, entry: BlockEntry) -> dict[str, str]:
        """The parameters that a block has, with the units in which bare numbers are meant where that is one."""
        if entry.inner is not None:
            raws = entry.inner.parameters.items()
            return {key: str(raw.get("unit", "")) if isinstance(raw, Mapping) else "" for key, raw in raws}
        resolver = resolver_of(self._types)
        try:
            cls = entry.cls or (resolver.fmu(entry, self._frozen.folder) if entry.fmu else resolver(entry.type))
        except KeyError:
            return {}
        parameters = cls.declaration.parameters
        return {key: known.unit if isinstance(known.unit, str) else "" for key, known in parameters.items()}

    def with_variants(self, choices: Mapping[str, str]) -> Diagram:
        """A copy in which these variants stand in place of their blocks, by path: {"robot.motor": "fmu"}.

        "base" stands for the block itself. The copy has no variants any more: it is there to be run, checked, drawn.
        Raises ModelError (E122) for what is not there.
        """
        made = self.copy()
        made._frozen = taken(self.value, choices)
        return made

    def measure(
        self,
        name: str,
        type: str,
        of: PortName | str,
        against: PortName | str | float | None = None,
        *,
        start: Any = None,
        stop: Any = None,
        band: float | None = None,
    ) -> None:
        """A measure to be taken in every run; see `blocks list measures`."""
        if name in self._section("measures"):
            raise ModelError(Fault("E109", legible(str(name)), "the name is taken by a measure."))
        _check_name(name)
        entry: dict[str, Any] = {"type": type, "of": self._text(of)}
        for key, given in (("against", against), ("from", start), ("to", stop), ("band", band)):
            if given is not None:
                entry[key] = self._text(given) if isinstance(given, PortName) else raw_of(given)
        self._put("measures", documents.entries(measures={name: entry}).measures)

    def settings(self, **run: Any) -> None:
        """Set what the file's `run` says: start, stop, method, step, rtol, atol, every, jumps, stops, seed, inputs,
        loops, log, master.
        """
        check_settings(run)
        made = documents.entries(run={key: raw_of(value) for key, value in _plain_log(run).items()})
        self._put("run", made.run)

    # --- verbs -------------------------------------------------------------------------------------------------

    def flatten(
        self,
        *,
        parameters: Mapping[str, Any] | None = None,
        settings: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
    ) -> Flat:
        """The diagram without hierarchy. Raises ModelError with all faults."""
        overrides = {name: raw_of(value) for name, value in (parameters or {}).items()}
        check_settings(settings or {})
        value = taken(self.value, variants)
        return flatten(value, resolver_of(self._types), overrides=overrides, settings=_plain_log(settings or {}))

    def plan(
        self,
        *,
        parameters: Mapping[str, Any] | None = None,
        settings: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
    ) -> Plan:
        """What is computed and in which order. Raises ModelError (E1xx) and DeclarationError (E407)."""
        return _plan(self.flatten(parameters=parameters, settings=settings, variants=variants))

    def check(self, *, variants: Mapping[str, str] | None = None) -> Plan | Coupling:
        """Raise every static fault at once (ModelError); the Plan where there is none (its `warnings` are left).

        A Coupling where a master is needed: for FMUs of Co-Simulation, or where all blocks are units of their own.
        """
        try:
            return couple(self.flatten(variants=variants))
        except ModelError as error:
            if any(fault.path[:1] != ("run",) for fault in error.faults):
                raise
            # What is wrong with the settings hides nothing of what is wrong with the order of the blocks.
            loops = {key: value for key, value in self.value.run.items() if key == "loops" and value == "solve"}
            try:
                couple(self._like(replace(self.value, run=loops)).flatten(variants=variants))
            except ModelError as further:
                raise ModelError(*error.faults, *further.faults) from None
            raise

    def start(
        self,
        *,
        inputs: Mapping[str, Any] | str | Path | Sequence[Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        interpolation: str = "linear",
        progress: Callable[[float], None] | None = None,
        resume: State | str | Path | None = None,
        engine: str | None = None,
        variants: Mapping[str, str] | None = None,
        trust: Paths = (),
        **settings: Any,
    ) -> Run:
        """A run that is stepped by hand. Arguments as for `run`; `stop` only bounds what adaptive steps may span."""
        from .run import RunOptions

        options = RunOptions(
            inputs=inputs, interpolation=interpolation, progress=progress, resume=resume, engine=engine, trust=trust
        )
        return run_of(self.with_variants(variants or {}), parameters or {}, settings, options)

    def run(
        self,
        *,
        stop: float | None = None,
        inputs: Mapping[str, Any] | str | Path | Sequence[Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        interpolation: str = "linear",
        progress: Callable[[float], None] | None = None,
        resume: State | str | Path | None = None,
        engine: str | None = None,
        variants: Mapping[str, str] | None = None,
        trust: Paths = (),
        **settings: Any,
    ) -> Results:
        """Simulate to `stop`.

        inputs: by name a number, (t, u), (t, u, "hold" | "linear"), or the path of a CSV file, or a list of these.
        parameters: values by path ("motor.Ra"), in place of those of the file. settings: start, method ("dopri5",
        "rk4", "euler", "radau"), step (fixed-step methods), rtol, atol, every (recording grid; every step without
        it), jumps (True: rows before and after jumps between those of the grid), stops, seed (an integer, of all
        noise), loops ("error", "solve"), log (signal names or ports), master (a mapping with any of step, steps,
        algorithm, order, tolerance, couple and iterations, which replace those of the file). resume: a snapshot, or the
        file of one, from which the run goes on as if it had never stopped there; inputs that are given take the place
        of those of the snapshot. engine: "native" (compiled C), "reference" (plain Python), or "auto", the default:
        native where there is a C compiler; the environment variable BLOCKS_ENGINE names another default. variants: what
        stands in the place of blocks, by path ({"motor": "fmu"}; "base": the block itself). trust: FMUs, or folders of
        FMUs, that a diagram file may name though they lie outside of its project.

        Ctrl-C returns what is there (`results.interrupted`). Raises ModelError, UsageError, and SimulationError, whose
        `.results` hold what was computed.
        """
        if stop is not None:
            settings["stop"] = stop
        if inputs or parameters or variants or progress is not None or resume is not None:
            run = self.start(
                inputs=inputs,
                parameters=parameters,
                interpolation=interpolation,
                progress=progress,
                resume=resume,
                engine=engine,
                variants=variants,
                trust=trust,
                **settings,
            )
            return run.finish()
        # The same run again is not prepared again.
        key = _key(self.value, engine, {**settings, "interpolation": interpolation})
        known: Run | None = self._last.taken("run", key)
        known = known if known is not None and known.is_current else None
        if known is not None:
            known.again()
        run = known or self.start(interpolation=interpolation, engine=engine, trust=trust, **settings)
        results = run.finish()
        # One that records much is not kept, nor one that would never be taken, as FMUs may be in it.
        if key is not None and run.is_repeatable and not results.interrupted and run.recorded_bytes <= MOST_KEPT:
            self._last.keep("run", key, run)
        return results

    # --- linear models -----------------------------------------------------------------------------------------

    def linearize(
        self,
        inputs: PortName | str | Sequence[PortName | str],
        outputs: PortName | str | Sequence[PortName | str],
        *,
        at: OperatingPoint | float | None = None,
        openings: PortName | str | Sequence[PortName | str] = (),
        amplitude: Mapping[str, Any] | None = None,
        sigma: Mapping[str, Any] | None = None,
        overrides: Mapping[str, Any] | None = None,
        pade: int = 0,
        held: Mapping[str, Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
        trust: Paths = (),
        **settings: Any,
    ) -> LinearModel:
        """The linear model from small changes at `inputs` to `outputs`: a control.StateSpace in SI units.

        Signals go by name: "motor.omega" (all that read it see a change there), an input of a block ("motor.v",
        which alone sees it), an input of the diagram, a local ("eso.e"). openings: signals that are cut; they keep the
        values that they have. at: None: at the start; a time in s: as a run stands there; an `OperatingPoint`. held:
        values of the diagram's inputs; those that have none are 0. amplitude, sigma: by signal, the amplitude of a
        sine, or the deviation of a random signal, at laws that have no slope: their describing functions take their
        place. overrides: by the path of a block, a linear model instead. pade: the order of models of exact delays.
        parameters, variants, trust, settings: as of `run`.

        Sampled blocks make a discrete-time model with its period as `dt`. The model has what contributes to the
        transfer; its `report` tells how each block came in. Many transfers of one point: `linearizer`. Raises
        UsageError, ModelError and AnalysisError (E701: a law without a slope, E703, E704, E707).
        """
        linearizer = self.linearizer(
            at=at, amplitude=amplitude, sigma=sigma, overrides=overrides, held=held, parameters=parameters,
            variants=variants, trust=trust, **settings,
        )  # fmt: skip
        return linearizer.model(_texts(inputs), _texts(outputs), openings=_texts(openings), pade=pade)

    def linearizer(
        self,
        *,
        at: OperatingPoint | float | None = None,
        amplitude: Mapping[str, Any] | None = None,
        sigma: Mapping[str, Any] | None = None,
        overrides: Mapping[str, Any] | None = None,
        held: Mapping[str, Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
        trust: Paths = (),
        **settings: Any,
    ) -> Linearizer:
        """The slopes at one point, for many transfers: `model`, `loop`, `sensitivity`, `complementary`, `response`.

        Arguments as of `linearize`.
        """
        from ..linear.interconnection import slopes_at
        from ..linear.linearizer import Linearizer

        point = self.point(at=at, held=held, parameters=parameters, variants=variants, trust=trust, **settings)
        return Linearizer(slopes_at(point), amplitude=amplitude, sigma=sigma, overrides=overrides)

    def point(
        self,
        *,
        at: OperatingPoint | float | None = None,
        held: Mapping[str, Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
        trust: Paths = (),
        **settings: Any,
    ) -> Point:
        """Where the diagram stands: all of its memory at a time. Arguments as of `linearize`."""
        from ..linear.operating_point import OperatingPoint
        from ..linear.point import Point

        if isinstance(at, OperatingPoint):
            if held or parameters or variants or settings:
                message = "an operating point has its inputs, parameters and settings already."
                raise UsageError(Fault("E501", "at", message, "Give them where it is searched for."))
            if at.point is None:
                message = "was found by a run with FMUs of Co-Simulation, which hide what they are made of."
                cure = "Import them as Model Exchange, or estimate the response by simulation."
                raise AnalysisError(Fault("E703", at.name, message, cure))
            return at.point
        for word, table in (("held", held), ("parameters", parameters), ("variants", variants)):
            if table is not None and not isinstance(table, Mapping):
                raise UsageError(Fault("E501", word, f"{table!r} is no mapping.", f"As in {word}={{name: value}}."))
        plain = [{name: _plainly(value) for name, value in (table or {}).items()} for table in (held, parameters)]
        given = repr((*(sorted(table.items()) for table in plain), variants, settings))
        key = (id(self.value), self.value, at, given)
        known: tuple[Point, tuple[Outside, ...]] | None = self._last.known("point", key)
        if known is not None and all(read.holds() for read in known[1]):
            return known[0]
        made = Point.of(self._standing(at, held, parameters, variants, trust, settings, is_silent=True))
        if not np.isfinite(made.outputs).all():
            self._standing(at, held, parameters, variants, trust, settings, is_silent=False)  # tells where, if recorded
        if not made.plan.foreign and not _names_files(self.value):
            tapes = {id(one.tape): one.tape for one in made.plan.instances}.values()
            outside = tuple(tape.traced.outside for tape in tapes if tape.traced is not None)
            self._last.keep("point", key, (made, outside))
        return made

    def _standing(
        self,
        at: float | None,
        held: Mapping[str, Any] | None,
        parameters: Mapping[str, Any] | None,
        variants: Mapping[str, str] | None,
        trust: Paths,
        settings: Mapping[str, Any],
        *,
        is_silent: bool,
    ) -> Any:
        """A run of the reference engine that stands at a time; a silent one is not made to record signals."""
        from .run import RunOptions, engine_of

        diagram = self.with_variants(variants or {})
        silent: dict[str, Any] = {"log": []} if is_silent else {}
        flat = diagram.flatten(parameters=parameters, settings={**settings, **silent})
        coupled = _coupled(flat)
        if coupled:
            message = "is an FMU for Co-Simulation: it hides its states, so that it has no linear model."
            cure = 'Import it as "kind": "ME", or estimate the response by simulation (estimate_response).'
            raise AnalysisError(Fault("E703", coupled, message, cure))
        given, values = dict(parameters or {}), {**at_rest(diagram.value, flat), **(held or {})}
        options = RunOptions(inputs=values, engine="reference", trust=trust)
        if at is None:
            return engine_of(run_of(diagram, given, {**settings, **silent}, options, flat))
        time = time_of("at", at)
        has_fmus = any(block.interface.declaration.foreign is not None for block in flat.blocks)
        options = options if has_fmus else replace(options, engine=None)
        run = run_of(diagram, given, settings, options)
        begun, stop = run.settings.start, run.settings.stop
        if time < begun:
            raise UsageError(Fault("E501", "at", f"{float(time)} s lies before the start at {float(begun)} s."))
        if stop is not None and time > stop:
            settings = {**settings, "stop": time}
            run = run_of(diagram, given, settings, options)
        run.advance_to(time)
        if has_fmus:
            return engine_of(run)
        going = RunOptions(resume=run.snapshot(), engine="reference", trust=trust)
        again = {key: item for key, item in settings.items() if key != "start"}
        return engine_of(run_of(diagram, {}, {**again, **silent}, going))

    def draw(self, *, depth: int = 1, variants: Mapping[str, str] | None = None) -> str:
        """The diagram as the text of an SVG, the same each time; its faults, if it has any, are marked on the blocks.

        depth: how many levels of subdiagrams are shown; 1 draws them as boxes.
        """
        from ..draw import ports_of, svg

        value = taken(self.value, variants)
        faults: tuple[Fault, ...] = ()
        rates: dict[str, str] = {}
        try:
            planned = self.check(variants=variants)
            faults, rates = planned.warnings, planned.rate_labels
        except BlocksError as error:
            faults = error.faults
        resolver = resolver_of(self._types)
        return svg(value, ports_of(value, resolver), depth=depth, faults=faults, rates=rates)

    def diff(self, other: Diagram | str | Path, *, doc: bool = False) -> Differences:
        """What differs from this diagram to another one, or to that of a file; it is false where nothing does.

        Layout, the order of entries and the spelling of numbers are no differences, nor is 1200 mOhm in place of
        1.2 Ohm. doc: compare doc texts and keys "x-..." too. Printed, it is a line for each change; `.svg()` draws
        both diagrams in one. Raises ModelError for a file that cannot be read.
        """
        from ..editing.diff import differences

        if not isinstance(other, Diagram):
            other = Diagram._of(documents.load(other), ())
        resolver = resolver_of({**other._types, **self._types})
        return differences(self.value, other.value, doc=doc, resolver=resolver)

    @classmethod
    def alone(cls, block: Block, name: str = "") -> Diagram:
        """A diagram of one block, whose ports are its inputs and outputs: to run or to export it by itself.

        What is no name of a diagram ("body.phi[1]", as FMUs have) becomes one ("body_phi_1").
        """
        foreign = type(block).declaration.foreign
        kind = type(block).__name__ if foreign is None else _as_name(type(block).__name__)
        made = cls(name or kind, library=type(block) if foreign is None else ())
        handle = made.add(kind, block)
        ports = interface_of(made.value, kind, resolver_of(made._types))
        for port in ports.inputs.values():
            unit = port.declared[0] if port.declared else ""
            type_: str | Enumeration = enumeration_of(port.type) or port.type
            default: Any = None
            if foreign is not None and port.default is not None:  # what an FMU starts with is what it is given
                values = [item != 0.0 if type_ == "bool" else item / units.to_si(1.0, unit) for item in port.default]
                default = np.reshape(values, port.shape) if len(set(values)) > 1 else values[0]
            size = (port.shape[0] if len(port.shape) == 1 else port.shape) if port.shape else None
            whole = made.input(_as_name(port.name), unit=unit, size=size, type=type_, default=default)
            made.wire(f"{kind}.{port.name}", whole)
        for port in ports.outputs.values():
            if port.name not in handle._inputs:
                made.output(_as_name(port.name), f"{kind}.{port.name}")
        return made

    def export(
        self,
        path: str | Path,
        *,
        fmi: int = 3,
        kinds: Sequence[str] | None = None,
        platforms: Sequence[str] | None = None,
        name: str = "",
        parameters: Mapping[str, Any] | None = None,
        variants: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> Exported:
        """Write the diagram as an FMU, which needs no Python: the C code of a native run, packed with its sources.

        fmi: 2 or 3. kinds: of "CS" (Co-Simulation: the diagram's own method integrates) and "ME" (Model Exchange: the
        importer does); None: all that the diagram allows. platforms: "x86_64-linux", "x86_64-windows", ...; None: that
        of this machine; (): sources only. name: of the model, if not the diagram's. parameters, settings: as of `run`.
        Raises ModelError (E606 and the faults of the diagram), UsageError (E501), CompilerError (E60x).
        """
        from ..export.exporter import export
        from ..text.version import __version__

        check_settings(settings)
        if name:
            _check_name(name)
        value = taken(self.value, variants)
        flat = self.flatten(parameters=parameters, settings=settings, variants=variants)
        inside = [block.path for block in flat.blocks if block.interface.declaration.foreign is not None]
        if inside:
            cure = "Take a variant with equations, or export the diagram without it."
            faults = (Fault("E606", path_, "is an FMU, which an FMU cannot hold.", cure) for path_ in inside)
            raise ModelError(*faults)
        return export(
            value, flat, plan(flat), path,
            fmi=fmi, kinds=kinds, platforms=platforms, name=name, overrides=parameters, version=__version__,
            method=str(settings.get("method") or ""),
            drawing=self.draw(variants=variants) if len(value.blocks) <= MOST_DRAWN else "",
        )  # fmt: skip

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """What a notebook shows: the drawing, and the text where it cannot draw."""
        return {"image/svg+xml": self.draw(), "text/plain": repr(self)}

    def __repr__(self) -> str:
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


def run_of(
    diagram: Diagram,
    parameters: Mapping[str, Any],
    settings: Mapping[str, Any],
    options: RunOptions,
    flat: Flat | None = None,
) -> Run:
    """A run of a diagram with these parameters, settings and options. flat: its flat model with them, where known."""
    from .run import started

    resolver = resolver_of(dict(diagram._types))  # what is added to the diagram afterwards does not reach the run
    return started(taken(diagram.value), resolver, parameters, _plain_log(settings), options, flat)


def at_rest(value: DiagramValue, flat: Flat) -> dict[str, Any]:
    """Zeros for the inputs that a diagram gives no value: where it is looked at around a point, they rest."""
    known = {*value.run.get("inputs", {}), *(name for name, entry in value.inputs.items() if "default" in entry)}
    return {
        entry.name: np.full(entry.shape, resting(entry.type)) if entry.shape
        else False if entry.type == "bool" else resting(entry.type)
        for entry in flat.inputs
        if entry.name not in known
    }


def _plainly(value: Any) -> Any:
    """An array as lists, which print all of their digits."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def _texts(names: PortName | str | Sequence[PortName | str]) -> list[str]:
    """Names of signals, which may be given as ports."""
    made = [names] if isinstance(names, (str, PortName)) else names
    if not isinstance(made, (list, tuple)) or not all(isinstance(name, (str, PortName)) for name in made):
        raise UsageError(Fault("E501", "linearize", f"{made!r} is no name of a signal, and no list of names."))
    return [str(name) for name in made]


def _coupled(flat: Flat) -> str:
    """The path of a block that a master steps; "" where there is none."""
    for block in flat.blocks:
        foreign = block.interface.declaration.foreign
        if foreign is not None and foreign.kind == "CS":
            return block.path
    return ""


def _plan(flat: Flat) -> Plan:
    """The plan of a diagram. Raises ModelError (E118) where a master steps it."""
    coupled = _coupled(flat)
    if coupled:
        message = "is an FMU for Co-Simulation, which a master steps: the diagram has no single plan."
        raise ModelError(Fault("E118", coupled, message, 'Import it as "kind": "ME", or take another variant.'))
    return plan(flat)


def _matched(
    value: DiagramValue,
    name: str,
    before: tuple[Mapping[str, str], Mapping[str, str]],
    after: tuple[Mapping[str, str], Mapping[str, str]],
    known: dict[str, str],
) -> tuple[tuple[Match, ...], tuple[Match, ...]]:
    """The pairs of inputs, and those of outputs. Raises ModelError where a port that the diagram names has none."""
    faults = []
    for key, own in known.items():
        side = 0 if key in before[0] else 1
        if key not in before[side]:
            faults.append(Fault("E105", name, f"has no port {quoted(str(key))}.", did_you_mean(str(key), before[side])))
        elif own not in after[side]:
            what = f"what takes its place has no {('input', 'output')[side]} {quoted(str(own))}."
            faults.append(Fault("E105", name, what, did_you_mean(str(own), after[side]) or _ports_listed(after[side])))
    made: list[tuple[Match, ...]] = []
    for side, used in enumerate(used_ports(value, name)) if not faults else ():
        word = ("input", "output")[side]
        # What wires name and the block has not is of another variant, or a fault that `check` tells.
        ports = dict(before[side])
        pairs = match(ports, after[side], {key: own for key, own in known.items() if key in ports})
        made.append(pairs)
        partners = {one.name for one in pairs}
        for text, place in used.items():
            port = text if text in ports or "[" not in text else text.rpartition("[")[0]
            if port in partners or (port not in ports and (port in after[side] or place == "run: log")):
                continue
            shown = f"{port} [{ports[port]}]" if ports.get(port) else port
            message = f"the {word} {shown} ({place}) has no partner in what takes its place."
            faults.append(Fault("E105", name, message, _ports_listed(after[side])))
    if faults:
        raise ModelError(*faults)
    return made[0], made[1]


def _ports_listed(ports: Mapping[str, str]) -> str:
    return f"It has {_listed(ports)}; pairs can be given: ports={{...}}."


def _as_name(text: str) -> str:
    """A text as a name: a port of an FMU, as an input or an output of a diagram."""
    made = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return made if is_name(made) else f"_{made}"[:200]


def _check_name(name: Any) -> None:
    if not is_name(name):
        raise ModelError(Fault("E111", quoted(str(name)), "is not a name.", name_cure(str(name))))


def _beside(error: ModelError, flattened: Callable[[], Flat]) -> list[Fault]:
    """What is wrong with the meaning of a diagram whose structure has faults, apart from what follows from those.

    Without it, a user would mend one half of the faults only to be shown the other one.
    """
    try:
        flattened()
    except ModelError as further:
        return beside(further.faults, error.faults)
    except Exception:  # what is half read may make anything fail: then the faults of the structure are all
        return []
    return []


def _plain_log(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Signals to record may be given as ports."""
    log = settings.get("log")
    if not isinstance(log, (list, tuple)):
        return dict(settings)
    return {**settings, "log": [name.text if isinstance(name, PortName) else name for name in log]}


def _named(raw: Any, kind: Any) -> Any:
    """Members of an enumeration, as files have them: by name."""
    if isinstance(raw, list):
        return [_named(item, kind) for item in raw]
    known = kind.names if isinstance(kind, Enumeration) and not isinstance(raw, (str, bool)) else {}
    return known.get(raw, raw)


