"""Hierarchy and wires -> flat names, numbers and element-wise sources, with every wiring fault.

`flatten` goes once down the diagram (parameters are computed, types resolved, subdiagrams opened) and then asks for
the source of every element of every block input. Wiring blocks (Mux, Demux) and subdiagram borders dissolve on the way.

This file is longer than others: the faults of a diagram are told in one place, with their cures.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from . import expressions, units
from .declare import Parameter, arguments
from .diagram import BlockEntry, DiagramValue
from .errors import Fault, ModelError, did_you_mean
from .expressions import Scalar, exact_decimal
from .interface import Interface, Port, Resolved, Value, resolve
from .jsontext import Number, quoted
from .settings import MEASURES, MeasureSpec, RunSettings, read_settings

__all__ = ["Flat", "FlatBlock", "FlatInput", "FlatSignal", "Source", "element_of", "flatten", "interface_of"]

MAX_BLOCKS = 1_000_000
MAX_DEPTH = 30

Source = tuple[Any, ...]
"""Where one element comes from: ("block", index, variable, element), ("input", element) or ("value", number)."""

Resolver = Callable[[str], Any]
"""From the name of a type to the block class; raises KeyError with the known names as its arguments."""


@dataclass(frozen=True, slots=True)
class FlatBlock:
    """A block by its path, with its numbers, and the source of each element of each input."""

    path: str
    resolved: Resolved
    sources: Mapping[str, tuple[Source, ...]]  # by variable

    @property
    def interface(self) -> Interface:
        return self.resolved.interface


@dataclass(frozen=True, slots=True)
class FlatInput:
    """An input of the whole diagram: its first element, shape, unit in SI, and default."""

    name: str
    first: int
    shape: tuple[int, ...]
    unit: str
    type: str
    default: float | None


@dataclass(frozen=True, slots=True)
class FlatSignal:
    """A value that can be recorded, by name: where its elements come from."""

    name: str
    sources: tuple[Source, ...]
    shape: tuple[int, ...]
    units: tuple[str, ...]
    type: str

    @property
    def unit(self) -> str:
        return self.units[0] if len(set(self.units)) == 1 else ""


@dataclass(frozen=True, slots=True)
class Flat:
    """A diagram without hierarchy."""

    name: str
    blocks: tuple[FlatBlock, ...]
    inputs: tuple[FlatInput, ...]
    signals: Mapping[str, FlatSignal]
    outputs: tuple[str, ...]
    settings: RunSettings
    log: tuple[str, ...]
    measures: tuple[MeasureSpec, ...]
    warnings: tuple[Fault, ...]


def flatten(
    diagram: DiagramValue,
    resolver: Resolver,
    *,
    overrides: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Flat:
    """The flat form of a diagram.

    overrides: raw values by the path of a parameter ("torque", "motor_right.Ra"). settings: run settings that replace
    those of the file. Raises ModelError with all faults.
    """
    return _Flattener(diagram, resolver, dict(overrides or {}), dict(settings or {})).flat()


def interface_of(diagram: DiagramValue, name: str, resolver: Resolver) -> Interface:
    """The ports and sizes of one block of a diagram that need not be complete. Raises ModelError."""
    flattener = _Flattener(replace(diagram, inputs={}, wires={}, outputs={}), resolver, {}, {})
    scope = _Scope("", flattener.diagram, None)
    flattener.open(scope, {}, 0)
    leaf = scope.children.get(name)
    if flattener.faults or not isinstance(leaf, _Leaf):
        raise ModelError(*flattener.faults)
    return leaf.resolved.interface


@dataclass
class _Leaf:
    """A block of a type, before its sources are known."""

    path: str
    entry: BlockEntry
    resolved: Resolved
    index: int
    wires: dict[str, dict[int | None, str]] = field(default_factory=dict)  # port -> element or None -> source text


@dataclass
class _Scope:
    """A diagram in its place: its parameter values, its blocks, and the wires that reach its inputs."""

    path: str  # "" or "control_right."
    value: DiagramValue
    parent: _Scope | None
    parameters: dict[str, Value] = field(default_factory=dict)
    children: dict[str, _Leaf | _Scope | None] = field(default_factory=dict)  # None: faulty, already told
    wires: dict[str, dict[int | None, str]] = field(default_factory=dict)

    def sources(self) -> Iterable[str]:
        """The texts that wires of this diagram may begin with."""
        yield from self.value.inputs
        for name, child in self.children.items():
            if isinstance(child, _Leaf):
                yield from (f"{name}.{port}" for port in child.resolved.interface.outputs)
            elif child is not None:
                yield from (f"{name}.{port}" for port in child.value.outputs)


@dataclass(frozen=True)
class _Signal:
    """The elements that a source text stands for."""

    sources: tuple[Source, ...]
    shape: tuple[int, ...]
    units: tuple[str, ...]
    type: str

    def element(self, index: int | None) -> _Signal:
        if index is None:
            return self
        return _Signal((self.sources[index],), (), (self.units[index],), self.type)


class _Absent(Exception):
    """A source that cannot be had because of a fault that was told already."""


class _Flattener:
    def __init__(
        self, diagram: DiagramValue, resolver: Resolver, overrides: dict[str, Any], settings: dict[str, Any]
    ) -> None:
        self.diagram, self.resolver, self.overrides, self.settings_given = diagram, resolver, overrides, settings
        self.faults: list[Fault] = []
        self.warnings: list[Fault] = []
        self.leaves: list[_Leaf] = []
        self.scopes: list[_Scope] = []
        self.settable: dict[str, None] = {}
        self.used: set[str] = set()
        self.inputs: list[FlatInput] = []
        self.memo: dict[tuple[str, str], _Signal] = {}
        self.under_way: list[tuple[str, str]] = []

    # --- the whole ---------------------------------------------------------------------------------------------

    def flat(self) -> Flat:
        root = _Scope("", self.diagram, None)
        self.open(root, {}, 0)
        for name in self.overrides:
            if name not in self.used:
                cure = did_you_mean(name, self.settable) or "blocks check DIAGRAM lists the blocks; blocks list TYPE, its parameters."
                self.faults.append(Fault("E106", name, "there is no such parameter to set.", cure))
        self.root_inputs(root)
        for scope in self.scopes:
            self.attach(scope)
        blocks = [self.block(leaf) for leaf in self.leaves]
        signals = self.signals(root)
        settings, faults = read_settings(self.diagram.run, **self.settings_given)
        for key, code, message, cure in faults:
            self.tell(self.diagram, code, f"run.{key}", message, cure, ("run", key))
        log = self.log(settings, signals)
        measures = tuple(self.measure(name, raw, signals) for name, raw in self.diagram.measures.items())
        for index, name in enumerate(settings.inputs):
            if name not in self.diagram.inputs:
                self.tell(self.diagram, "E502", f"run.inputs.{name}", "the diagram has no such input.",
                          did_you_mean(name, self.diagram.inputs) or f"Inputs: {', '.join(self.diagram.inputs) or 'none'}.", ("run", "inputs", name))  # fmt: skip
            del index
        if self.faults:
            raise ModelError(*_unique(self.faults))
        return Flat(
            self.diagram.name,
            tuple(block for block in blocks if block is not None),
            tuple(self.inputs),
            signals,
            tuple(self.diagram.outputs),
            settings,
            log,
            tuple(measure for measure in measures if measure is not None),
            tuple(self.warnings),
        )

    def tell(self, value: DiagramValue, code: str, place: str, message: str, cure: str = "", path: tuple[str | int, ...] = ()) -> None:
        self.faults.append(value.fault(code, place, message, cure, path))

    # --- downwards: parameters and types -----------------------------------------------------------------------

    def open(self, scope: _Scope, given: dict[str, Value], depth: int) -> None:
        """Compute a diagram's parameters and make its blocks."""
        self.scopes.append(scope)
        self.diagram_parameters(scope, given)
        for name, entry in scope.value.blocks.items():
            path, where = scope.path + name, ("blocks", name)
            if len(self.leaves) >= MAX_BLOCKS or depth >= MAX_DEPTH:
                what = f"more than {MAX_BLOCKS} blocks" if depth < MAX_DEPTH else f"subdiagrams more than {MAX_DEPTH} deep"
                raise ModelError(scope.value.fault("E008", path, f"the diagram has {what}.", path=where))
            scope.children[name] = None
            inner = entry.inner
            if inner is not None:
                child = _Scope(path + ".", inner, scope)
                known = inner.parameters
                values = {}
                for key, raw in entry.parameters.items():
                    if key not in known:
                        cure = did_you_mean(key, known) or f"Parameters: {', '.join(known) or 'none'}."
                        self.tell(scope.value, "E106", f"{path}.{key}", "there is no such parameter.", cure, (*where, "parameters", key))
                        continue
                    unit = _entry(known[key])[1]
                    value = self.value(scope, raw, unit, f"{path}.{key}", (*where, "parameters", key))
                    if value is not None:
                        values[key] = value
                scope.children[name] = child
                self.open(child, values, depth + 1)
            elif entry.fmu:
                self.tell(scope.value, "E118", path, "FMUs in diagrams are not supported yet.", "Use a block type.", where)
            elif entry.type:
                self.leaf(scope, name, entry)
            else:
                self.tell(scope.value, "E007", path, "its subdiagram was not loaded.", "Load the diagram from its file.", where)

    def diagram_parameters(self, scope: _Scope, given: dict[str, Value]) -> None:
        """Values given from outside, overrides, plain values, then expressions in their order of need."""
        table = scope.value.parameters
        bound: dict[str, expressions.Expression] = {}
        for name, entry in table.items():
            raw, unit = _entry(entry)
            path, where = scope.path + name, ("parameters", name)
            self.settable[path] = None
            if unit:
                try:
                    units.parse(unit)
                except ModelError as error:
                    self.tell(scope.value, "E114", path, error.faults[0].message, error.faults[0].cure, (*where, "unit"))
                    continue
            is_bound = _is_expression(raw) or name in given and self.is_bound(scope, name)
            if path in self.overrides:
                self.used.add(path)
                if is_bound:
                    self.refuse_bound(scope, path, raw)
                value = self.value(scope, self.overrides[path], unit, path, where)
            elif name in given:
                value = given[name]
            elif _is_expression(raw):
                made = self.expression(scope, raw, path, where)
                if made is not None:
                    bound[name] = made
                continue
            else:
                value = self.value(scope, raw, unit, path, where)
            if value is not None:
                scope.parameters[name] = value
        while bound:
            ready = [n for n, e in bound.items() if not any(read in bound for read in e.names)]
            if not ready:
                cycle = _cycle({n: [r for r in e.names if r in bound] for n, e in bound.items()})
                self.tell(scope.value, "E108", scope.path + cycle[0], f"needs itself: {' -> '.join(cycle)}.", "", ("parameters", cycle[0]))
                return
            for name in ready:
                raw, unit = _entry(table[name])
                value = self.value(scope, raw, unit, scope.path + name, ("parameters", name))
                if value is not None:
                    scope.parameters[name] = value
                del bound[name]

    def is_bound(self, scope: _Scope, name: str) -> bool:
        """Whether the block entry of this subdiagram gives the parameter as an expression."""
        assert scope.parent is not None
        entry = scope.parent.value.blocks[scope.path.rstrip(".").rpartition(".")[2]]
        return _is_expression(entry.parameters.get(name))

    def refuse_bound(self, scope: _Scope, path: str, raw: Any) -> None:
        bound = raw if _is_expression(raw) else "an expression of the diagram around it"
        self.faults.append(
            Fault("E117", path, f"is bound ({quoted(str(bound))}) and cannot be set itself.", "Set what it is computed from.")
        )

    def expression(self, scope: _Scope, raw: str, place: str, path: tuple[str | int, ...]) -> expressions.Expression | None:
        try:
            return expressions.parse(raw[1:])
        except ModelError as error:
            fault = error.faults[0]
            self.tell(scope.value, fault.code, place, f"{quoted(raw)}: {fault.message}", fault.cure, path)
            return None

    def value(self, scope: _Scope, raw: Any, declared: str | tuple[str, ...], place: str, path: tuple[str | int, ...]) -> Value | None:
        """A raw value in SI; bare numbers are in the declared unit. None after a fault was told."""
        try:
            return self._value(scope, raw, declared)
        except ModelError as error:
            for fault in error.faults:
                message = f"{quoted(raw)}: {fault.message}" if fault.code == "E108" and isinstance(raw, str) else fault.message
                self.tell(scope.value, fault.code, place, message, fault.cure, path)
        except (ValueError, TypeError, OverflowError) as error:
            self.tell(scope.value, "E107", place, str(error), "", path)
        return None

    def _value(self, scope: _Scope, raw: Any, declared: str | tuple[str, ...]) -> Value:
        single = declared if isinstance(declared, str) else (declared[0] if len(set(declared)) == 1 else "")
        if isinstance(raw, Mapping):
            unit = raw.get("unit", "") or single
            if unit and single and not units.same_quantity(unit, single):
                raise ModelError(Fault("E104", "", f"[{unit}] is given where [{single}] is needed: they are different quantities."))
            return self._value(scope, raw.get("value"), unit)
        if isinstance(raw, (bool, np.bool_)):
            return Value(bool(raw))
        if isinstance(raw, str):
            if not _is_expression(raw):
                return Value(raw[1:] if raw.startswith("==") else raw)
            expression = expressions.parse(raw[1:])
            if expression.name is not None and expression.name in scope.value.parameters:
                if expression.name not in scope.parameters:
                    raise _Told()
                value = scope.parameters[expression.name]
                if value.unit and single and not units.same_quantity(value.unit, single):
                    raise ModelError(Fault("E104", "", f"{expression.name} [{value.unit}] is given where [{single}] is needed: "
                                           "they are different quantities."))  # fmt: skip
                return replace(value, unit=units.si_text(single) if single else value.unit)
            return self.computed(scope, expression, single)
        if isinstance(raw, (list, tuple, np.ndarray)) and np.ndim(raw) == 0 and not isinstance(raw, (list, tuple)):
            raw = raw.item()
        if isinstance(raw, (list, tuple, np.ndarray)):
            return self.array(scope, raw, declared)
        if raw is None:
            return Value(None)
        if not isinstance(raw, (int, float, np.integer, np.floating)):
            raise ValueError(f"{raw!r} is not a number, a text, a list, true or false.")
        exact = raw.exact if isinstance(raw, Number) else None
        number = float(raw)
        if not np.isfinite(number):
            raise ValueError(f"must be a finite number, not {number}.")
        if exact is None:
            exact = exact_decimal(number)
        if single:
            factor = units.parse(single)
            if factor.factor != 1.0:
                return Value(units.to_si(number, single), None if factor.exact is None else exact * factor.exact, units.si_text(single))
            return Value(number, exact, units.si_text(single))
        return Value(number, exact)

    def computed(self, scope: _Scope, expression: expressions.Expression, unit: str) -> Value:
        """An expression over the diagram's parameters: a number in SI."""
        known: dict[str, Scalar] = {}
        for name in expression.names:
            if name not in scope.value.parameters:
                continue  # evaluate says that it is unknown, and what is meant
            if name not in scope.parameters:
                raise _Told()
            value = scope.parameters[name]
            if isinstance(value.value, (str, bool)) or np.ndim(value.value) != 0:
                raise ModelError(Fault("E108", "", f"'{name}' is not a single number.", f'Pass it whole, as "={name}".'))
            known[name] = Scalar(float(value.value), value.exact)
        known_names = {**{name: Scalar(0.0, None) for name in scope.value.parameters}, **known}
        made = expressions.evaluate(expression, known_names)
        return Value(made.value, made.exact, units.si_text(unit) if unit else "")

    def array(self, scope: _Scope, raw: Any, declared: str | tuple[str, ...]) -> Value:
        """A list of numbers and expressions, with one unit or one for each element."""

        def numbers(item: Any, unit: str) -> Any:
            if isinstance(item, (list, tuple, np.ndarray)) and np.ndim(item) > 0 if isinstance(item, np.ndarray) else isinstance(item, (list, tuple)):
                return [numbers(part, unit) for part in item]
            made = self._value(scope, item, unit)
            if isinstance(made.value, (str, bool)) or made.value is None or np.ndim(made.value):
                raise ValueError(f"a list holds numbers, not {item!r}.")
            return float(made.value)

        if isinstance(declared, tuple) and len(set(declared)) > 1:
            if len(declared) != len(raw):
                raise ModelError(Fault("E110", "", f"has {len(raw)} elements, but {len(declared)} are needed."))
            return Value([numbers(item, unit) for item, unit in zip(raw, declared, strict=True)])
        unit = declared if isinstance(declared, str) else (declared[0] if declared else "")
        return Value([numbers(item, unit) for item in raw], None, units.si_text(unit) if unit else "")

    def leaf(self, scope: _Scope, name: str, entry: BlockEntry) -> None:
        path, where = scope.path + name, ("blocks", name)
        cls = entry.cls
        if cls is None:
            try:
                cls = self.resolver(entry.type)
            except KeyError as error:
                cure = did_you_mean(entry.type, error.args) or "`blocks list` names the types; own ones come with --library MODULE."
                self.tell(scope.value, "E103", path, f"there is no block type {quoted(entry.type)}.", cure, (*where, "type"))
                return
        known: Mapping[str, Parameter] = cls.declaration.parameters
        raws = dict(entry.parameters)
        for key in known:
            full = f"{path}.{key}"
            self.settable[full] = None
            if full in self.overrides:
                self.used.add(full)
                if _is_expression(raws.get(key)):
                    self.refuse_bound(scope, full, raws[key])
                raws[key] = self.overrides[full]
        given: dict[str, Value] = {}
        ok = True
        for key, raw in raws.items():
            spot = (*where, "parameters", key)
            if key not in known:
                cure = did_you_mean(key, known) or f"Parameters of {entry.type}: {', '.join(known) or 'none'}."
                self.tell(scope.value, "E106", f"{path}.{key}", f"{entry.type} has no such parameter.", cure, spot)
                ok = False
                continue
            try:
                declared = self.declared_unit(scope, cls, known[key], raws)
            except (ModelError, TypeError, ValueError):
                declared = ""  # sizes that do not fit are told by `resolve`
            value = self.value(scope, raw, declared, f"{path}.{key}", spot)
            if value is None:
                ok = False
            else:
                given[key] = value
        if not ok:
            return
        try:
            resolved = resolve(cls, given, path)
            interface = resolved.interface
            clashes = set(interface.inputs) & set(interface.outputs)
            if clashes:
                raise ModelError(Fault("E109", path, f"'{min(clashes)}' is the name of an input and of an output."))
        except ModelError as error:
            for fault in error.faults:
                key = fault.place.rpartition(".")[2]
                spot = (*where, "parameters", key) if key in raws else where
                self.tell(scope.value, fault.code, fault.place, fault.message, fault.cure, spot)
            return
        leaf = _Leaf(path, entry, resolved, len(self.leaves))
        self.leaves.append(leaf)
        scope.children[name] = leaf

    def declared_unit(self, scope: _Scope, cls: Any, parameter: Parameter, raws: Mapping[str, Any]) -> str | tuple[str, ...]:
        """The unit in which a bare number of this parameter is meant; it may follow from structural parameters."""
        if isinstance(parameter.unit, str):
            return parameter.unit
        known = {}
        for name in arguments(parameter.unit, parameter.name):
            structural = cls.declaration.parameters[name]
            raw = raws.get(name, structural.default)
            value = self._value(scope, raw, "").value if not callable(raw) else raw
            known[name] = int(value) if structural.type == "int" else value
        unit = parameter.unit(**known)
        return unit if isinstance(unit, str) else tuple(unit)

    # --- wires -------------------------------------------------------------------------------------------------

    def root_inputs(self, root: _Scope) -> None:
        first = 0
        for name, entry in root.value.inputs.items():
            size = int(entry.get("size", 1))
            shape = (size,) if "size" in entry else ()
            default = entry.get("default")
            unit = self.input_unit(root, name, entry)
            scale = units.scale(unit, units.si_text(unit)) if unit else 1.0
            self.inputs.append(
                FlatInput(name, first, shape, units.si_text(unit) if unit else "", entry.get("type", "real"),
                          None if default is None else float(default) * scale)  # fmt: skip
            )
            first += size

    def input_unit(self, scope: _Scope, name: str, entry: Mapping[str, Any]) -> str:
        unit = str(entry.get("unit", ""))
        try:
            if unit:
                units.parse(unit)
        except ModelError as error:
            fault = error.faults[0]
            self.tell(scope.value, "E114", scope.path + name, fault.message, fault.cure, ("inputs", name, "unit"))
            return ""
        return unit

    def attach(self, scope: _Scope) -> None:
        """Hand each wire of a diagram to the block whose input it feeds."""
        for sink, source in scope.value.wires.items():
            where = ("wires", sink)
            text, index = _indexed(sink)
            name, _, port = text.partition(".")
            place = scope.path + sink[:200]
            if name not in scope.children or not port:
                if name in scope.value.outputs and not port:
                    cure = f'Outputs stand under "outputs": {{"{name}": ...}}.'
                else:
                    cure = did_you_mean(name, scope.children) or "A wire is \"block.input\": \"block.output\"."
                self.tell(scope.value, "E105", place, f"there is no block {quoted(name)}." if port or name not in scope.children
                          else "names a block, not an input of it.", cure, where)  # fmt: skip
                continue
            child = scope.children[name]
            if child is None:
                continue
            ports: Mapping[str, Any]
            if isinstance(child, _Leaf):
                ports, outputs = child.resolved.interface.inputs, set(child.resolved.interface.outputs)
                shown = ", ".join(f"{p.name}{_bracket(p.unit)}" for p in ports.values())
            else:
                ports, outputs = child.value.inputs, set(child.value.outputs)
                shown = ", ".join(ports)
            if port not in ports:
                if port in outputs:
                    message, code = f"'{port}' is an output of {name}, and a wire ends at an input.", "E112"
                    cure = f'Wires are written sink first: "{source}": "{sink}"?' if "." in source else ""
                else:
                    message, code = f"{name} has no input {quoted(port)}.", "E105"
                    cure = did_you_mean(port, ports) or f"Inputs: {shown or 'none'}."
                self.tell(scope.value, code, place, message, cure, where)
                continue
            entries = child.wires.setdefault(port, {})
            if index is None and entries or None in entries:
                self.tell(scope.value, "E109", place, f"the input '{port}' of {name} is wired as a whole and by element.", "Keep one of the two.", where)
                continue
            entries[index] = source

    def block(self, leaf: _Leaf) -> FlatBlock | None:
        """A block with the source of each element of its inputs."""
        scope = self.scope_of(leaf.path)
        interface = leaf.resolved.interface
        sources: dict[str, list[Source | None]] = {
            name: [None] * int(np.prod(interface.shape(variable)))
            for name, variable in interface.declaration.inputs.items()
        }
        ok = True
        for port in interface.inputs.values():
            try:
                made = self.fed(scope, leaf, port)
                sources[port.variable][port.first : port.first + port.size] = made
            except _Absent:
                ok = False
        if not ok:
            return None
        return FlatBlock(leaf.path, leaf.resolved, {name: tuple(items) for name, items in sources.items()})  # type: ignore[arg-type]

    def scope_of(self, path: str) -> _Scope:
        prefix = path.rpartition(".")[0]
        return self._by_path[prefix + "." if prefix else ""]

    @cached_property
    def _by_path(self) -> dict[str, _Scope]:
        return {scope.path: scope for scope in self.scopes}

    def fed(self, scope: _Scope, leaf: _Leaf, port: Port) -> list[Source]:
        name = leaf.path.rpartition(".")[2]
        wires = leaf.wires.get(port.name, {})
        if None in wires:
            signal = self.checked(scope, f"{name}.{port.name}", wires[None], port.shape, port.units, port.type)
            return list(signal.sources)
        made: list[Source | None] = [None] * port.size if port.default is None else [("value", port.default)] * port.size
        absent = False
        for index, text in wires.items():
            assert index is not None
            sink = f"{name}.{port.name}[{index}]"
            if index >= port.size:
                self.tell(scope.value, "E105", scope.path + sink, f"'{port.name}' has {port.size} elements, counted from 0.", "", ("wires", sink))
                absent = True
                continue
            try:
                made[index] = self.checked(scope, sink, text, (), (port.units[index],), port.type).sources[0]
            except _Absent:
                absent = True
        if absent:
            raise _Absent
        if None in made:
            missing = [f"[{i}]" for i, item in enumerate(made) if item is None] if wires else [""]
            self.tell(scope.value, "E101", f"{leaf.path}.{port.name}{missing[0]}", "input is not wired.",
                      self.cure_for(scope, name, port), ("blocks", name))  # fmt: skip
            raise _Absent
        return made  # type: ignore[return-value]

    def cure_for(self, scope: _Scope, name: str, port: Port) -> str:
        """The wire that is probably meant: a source of the same name and quantity."""
        for text in scope.sources():
            if text.rpartition(".")[2] == port.name and not text.startswith(name + "."):
                return f'Did you mean "{name}.{port.name}": "{text}"?'
        return f'Add "{name}.{port.name}": "block.output" to the wires.'

    def checked(self, scope: _Scope, sink: str, text: str, shape: tuple[int, ...], wanted: tuple[str, ...], type_: str) -> _Signal:
        """The signal that feeds a sink, fitting in shape, quantity and type."""
        where = ("wires", sink)
        signal = self.signal(scope, text, scope.path + sink, where)
        if signal.shape != shape:
            cure = "Wire single elements, as in \"x[0]\", or use Mux and Demux." if shape == () or signal.shape == () else ""
            self.tell(scope.value, "E110", scope.path + sink, f"has {_size(shape)}, but {text} has {_size(signal.shape)}.", cure, where)
            raise _Absent
        for unit, other in zip(wanted, signal.units, strict=True):
            if not units.same_quantity(unit, other):
                self.tell(scope.value, "E104", f"{scope.path}{sink} [{unit}] <- {text} [{other}]",
                          f"{unit} and {other} are different quantities.", "", where)  # fmt: skip
                raise _Absent
        if type_ == "bool" and signal.type != "bool":
            self.tell(scope.value, "E104", scope.path + sink, f"is a bool, but {text} is a number.", "", where)
            raise _Absent
        return signal

    def signal(self, scope: _Scope, text: str, place: str, where: tuple[str | int, ...]) -> _Signal:
        """What a source text of a diagram stands for."""
        base, index = _indexed(text)
        key = (scope.path, base)
        if key in self.under_way:
            loop = [a + b for a, b in self.under_way[self.under_way.index(key) :]] + [key[0] + key[1]]
            self.tell(scope.value, "E102", place, f"wires go round in a circle: {' -> '.join(loop)}.", "Put a block into it.", where)
            raise _Absent
        if key not in self.memo:
            self.under_way.append(key)
            try:
                self.memo[key] = self.found(scope, base, place, where)
            finally:
                self.under_way.pop()
        signal = self.memo[key]
        if index is not None and (len(signal.shape) != 1 or index >= signal.shape[0]):
            self.tell(scope.value, "E105", place, f"{quoted(base)} has {_size(signal.shape)}; there is no element [{index}].", "", where)
            raise _Absent
        return signal.element(index)

    def found(self, scope: _Scope, text: str, place: str, where: tuple[str | int, ...]) -> _Signal:
        name, _, port = text.partition(".")
        if not port and name in scope.value.inputs:
            return self.diagram_input(scope, name)
        if name not in scope.children:
            cure = did_you_mean(text, scope.sources()) or "A source is \"block.output\" or an input of the diagram."
            what = "a parameter, not a signal" if name in scope.value.parameters else "not there"
            if what != "not there":
                cure = f"Use a Constant with value \"={name}\"."
            self.tell(scope.value, "E105", place, f"the source {quoted(text)} is {what}.", cure, where)
            raise _Absent
        child = scope.children[name]
        if child is None:
            raise _Absent
        if isinstance(child, _Scope):
            if port not in child.value.outputs:
                cure = did_you_mean(port, child.value.outputs) or f"Outputs: {', '.join(child.value.outputs) or 'none'}."
                self.tell(scope.value, "E105", place, f"{name} has no output {quoted(port)}.", cure, where)
                raise _Absent
            return self.signal(child, child.value.outputs[port], child.path + port, ("outputs", port))
        outputs = child.resolved.interface.outputs
        if port not in outputs:
            shown = ", ".join(f"{p.name}{_bracket(p.unit)}" for p in outputs.values())
            if port in child.resolved.interface.inputs:
                code, message = "E112", f"'{port}' is an input of {name}, and a wire begins at an output."
            else:
                code, message = "E105", f"{name} has no port {quoted(port)}." if port else "names a block, not an output of it."
            self.tell(scope.value, code, place, message, f"{did_you_mean(port, outputs)} Outputs: {shown or 'none'}.".strip(), where)
            raise _Absent
        return self.port(child, outputs[port])

    def port(self, leaf: _Leaf, port: Port) -> _Signal:
        made = leaf.resolved.interface.declaration.outputs.get(port.variable)
        if made is not None and made.wiring:
            return self.through_wiring(leaf, port)
        sources = tuple(("block", leaf.index, port.variable, port.first + i) for i in range(port.size))
        return _Signal(sources, port.shape, port.units, port.type)

    def through_wiring(self, leaf: _Leaf, port: Port) -> _Signal:
        """A wiring block run on the sources of its inputs, elements together with their units."""
        scope = self.scope_of(leaf.path)
        interface = leaf.resolved.interface
        made = interface.declaration.outputs[port.variable]
        values: dict[str, Any] = dict(interface.structural)
        for name, variable in interface.declaration.inputs.items():
            items: list[Any] = []
            for entry in interface.inputs.values():
                if entry.variable == name:
                    items += self.with_units(scope, leaf, entry)
            array = np.empty(len(items), dtype=object)
            array[:] = items
            values[name] = array.reshape(interface.shape(variable))
        result = np.asarray(made.equation.function(*(values[n] for n in made.equation.reads)), dtype=object)
        shape = interface.shape(made)
        if result.shape != shape:
            raise ModelError(Fault("E110", f"{leaf.path}.{port.variable}", f"gives {_size(result.shape)}, not {_size(shape)}."))
        part = [result.ravel()[port.first + i] for i in range(port.size)]
        return _Signal(tuple(p.source for p in part), port.shape, tuple(p.unit for p in part), port.type)

    def with_units(self, scope: _Scope, leaf: _Leaf, port: Port) -> list[_Element]:
        name = leaf.path.rpartition(".")[2]
        sources = self.fed(scope, leaf, port)
        wires = leaf.wires.get(port.name, {})
        known: dict[int, str] = {}
        for index, text in wires.items():
            signal = self.signal(scope, text, "", ("wires", f"{name}.{port.name}"))
            if index is None:
                known.update(enumerate(signal.units))
            else:
                known[index] = signal.units[0]
        return [_Element(source, known.get(i, "")) for i, source in enumerate(sources)]

    def diagram_input(self, scope: _Scope, name: str) -> _Signal:
        entry = scope.value.inputs[name]
        size = int(entry.get("size", 1))
        shape: tuple[int, ...] = (size,) if "size" in entry else ()
        type_ = entry.get("type", "real")
        if scope.parent is None:
            made = next(i for i in self.inputs if i.name == name)
            return _Signal(tuple(("input", made.first + i) for i in range(size)), shape, (made.unit,) * size, type_)
        unit = self.input_unit(scope, name, entry)
        unit = units.si_text(unit) if unit else ""
        outer = scope.path.rstrip(".").rpartition(".")[2]
        port = Port(name, name, shape, 0, size, (unit,) * size, (unit,) * size, type_,
                    None if entry.get("default") is None else float(entry["default"]))  # fmt: skip
        stand_in = _Leaf(scope.path.rstrip("."), scope.parent.value.blocks[outer], None, -1, scope.wires)  # type: ignore[arg-type]
        sources = self.with_units(scope.parent, stand_in, port)
        return _Signal(tuple(e.source for e in sources), shape, tuple(unit or e.unit for e in sources), type_)

    # --- names that can be recorded ----------------------------------------------------------------------------

    def signals(self, root: _Scope) -> dict[str, FlatSignal]:
        """Every output of every block and subdiagram by its path, then the diagram's inputs and outputs."""
        made: dict[str, FlatSignal] = {}

        def add(name: str, signal: _Signal) -> None:
            made.setdefault(name, FlatSignal(name, signal.sources, signal.shape, signal.units, signal.type))

        for name in root.value.inputs:
            add(name, self.diagram_input(root, name))
        for leaf in self.leaves:
            for port in leaf.resolved.interface.outputs.values():
                try:
                    add(f"{leaf.path}.{port.name}", self.port(leaf, port))
                except _Absent:
                    continue
        for scope in self.scopes:
            for name, text in scope.value.outputs.items():
                try:
                    add(scope.path + name, self.signal(scope, text, scope.path + name, ("outputs", name)))
                except _Absent:
                    continue
            for name in scope.value.inputs if scope.parent is not None else ():
                if scope.wires.get(name) is None and scope.value.inputs[name].get("default") is None:
                    try:  # told even where nothing inside reads it
                        self.diagram_input(scope, name)
                    except _Absent:
                        continue
        return made

    def log(self, settings: RunSettings, signals: Mapping[str, FlatSignal]) -> tuple[str, ...]:
        """The names to record: signals, elements of them, or all outputs of a block."""
        if settings.log is None:
            return tuple(signals)
        made: dict[str, None] = {}
        for index, name in enumerate(settings.log):
            if self.lookup(name, signals) is not None:
                made[name] = None
                continue
            below = [signal for signal in signals if signal.startswith(name + ".")] if name else []
            made.update(dict.fromkeys(below))
            if not below and not self.faults:
                place = "run.log" if "log" not in self.settings_given else "log"
                self.tell(self.diagram, "E105", place, f"there is no signal {quoted(name)}.", did_you_mean(name, signals), ("run", "log", index))
        return tuple(made)

    def lookup(self, name: str, signals: Mapping[str, FlatSignal]) -> FlatSignal | None:
        return element_of(name, signals)

    def measure(self, name: str, raw: Mapping[str, Any], signals: Mapping[str, FlatSignal]) -> MeasureSpec | None:
        place, where = f"measures.{name}", ("measures", name)
        before = len(self.faults)

        def refuse(key: str, message: str, cure: str = "", code: str = "E116") -> None:
            self.tell(self.diagram, code, place, message, cure, (*where, key))

        type_ = raw.get("type", "")
        if type_ not in MEASURES:
            refuse("type", f"there is no measure {quoted(str(type_))}.", did_you_mean(str(type_), MEASURES) or f"Measures: {', '.join(MEASURES)}.")
        picked: dict[str, Any] = {"against": 0.0}
        for key in ("of", "against"):
            entry = raw.get(key)
            if isinstance(entry, str):
                signal = self.lookup(entry, signals)
                if signal is None:
                    if not self.faults or entry.partition(".")[0] not in self.diagram.blocks:
                        refuse(key, f"there is no signal {quoted(entry)}.", did_you_mean(entry, signals), "E105")
                elif signal.shape != ():
                    refuse(key, f"{entry} has {_size(signal.shape)}.", f'Take an element, as in "{entry}[0]".', "E110")
                picked[key] = entry
            elif key == "against" and entry is not None:
                value = self.value(self.scopes[0], entry, "", place, (*where, key))
                if value is not None and isinstance(value.value, float):
                    picked[key] = value.value
                elif value is not None:
                    refuse(key, "must be a signal or a number.")
        window = {"from": -np.inf, "to": np.inf, "band": 0.02}
        for key in ("from", "to", "band"):
            if key in raw:
                value = self.value(self.scopes[0], raw[key], "s" if key != "band" else "", place, (*where, key))
                if value is not None and isinstance(value.value, float):
                    window[key] = value.value
                elif value is not None:
                    refuse(key, "must be a number.")
        if window["from"] >= window["to"]:
            refuse("to", "the window ends before it begins.")
        if "band" in raw and type_ != "settling_time":
            refuse("band", f"{type_} has no band.", "The band belongs to settling_time.")
        if type_ in ("overshoot", "settling_time") and "against" not in raw:
            refuse("type", f"{type_} needs the value that is aimed at.", 'Add "against".')
        if isinstance(picked["against"], str) and isinstance(picked.get("of"), str) and len(self.faults) == before:
            a, b = self.lookup(picked["of"], signals), self.lookup(picked["against"], signals)
            if a is not None and b is not None and not units.same_quantity(a.unit, b.unit):
                refuse("against", f"{picked['of']} [{a.unit}] and {picked['against']} [{b.unit}] are different quantities.", "", "E104")
        if len(self.faults) > before or "of" not in picked:
            return None
        return MeasureSpec(name, type_, picked["of"], picked["against"], window["from"], window["to"], window["band"])


class _Told(ValueError):
    """A value that cannot be had because of a fault that was told already."""

    def __str__(self) -> str:
        return "depends on a parameter that has a fault."


@dataclass(frozen=True, slots=True)
class _Element:
    source: Source
    unit: str


def element_of(name: str, signals: Mapping[str, FlatSignal]) -> FlatSignal | None:
    """A signal by name, or one element of it ("z[0]")."""
    if name in signals:
        return signals[name]
    base, index = _indexed(name)
    signal = signals.get(base)
    if signal is None or index is None or len(signal.shape) != 1 or index >= signal.shape[0]:
        return None
    return FlatSignal(name, (signal.sources[index],), (), (signal.units[index],), signal.type)


_INDEX = re.compile(r"(.*)\[([0-9]{1,7})\]\Z", re.DOTALL)


def _indexed(text: str) -> tuple[str, int | None]:
    match = _INDEX.match(text)
    return (match[1], int(match[2])) if match else (text, None)


def _entry(entry: Any) -> tuple[Any, str]:
    """The raw value and the unit of a diagram's parameter."""
    return (entry.get("value"), entry.get("unit", "")) if isinstance(entry, Mapping) else (entry, "")


def _is_expression(raw: Any) -> bool:
    if isinstance(raw, Mapping):
        raw = raw.get("value")
    return isinstance(raw, str) and raw.startswith("=") and not raw.startswith("==")


def _cycle(graph: Mapping[str, list[str]]) -> list[str]:
    """A cycle of a graph in which every node has a successor."""
    name = next(iter(graph))
    path: list[str] = []
    while name not in path:
        path.append(name)
        name = graph[name][0]
    return [*path[path.index(name) :], name]


def _unique(faults: list[Fault]) -> list[Fault]:
    return list(dict.fromkeys(faults))


def _bracket(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _size(shape: tuple[int, ...]) -> str:
    return "one element" if shape == () else f"{' x '.join(map(str, shape))} elements"
