"""Hierarchy and wires -> flat names, numbers and element-wise sources, with every fault of the model at once.

    DiagramValue --hierarchy--> blocks with their numbers --wires--> sources --flatten--> Flat

What is left for this module: the names that can be recorded, the run settings, the log and the measures.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import islice
from typing import Any

from ..contract.block import Block
from ..contract.expressions import LENGTH, RELATIONS, PostfixStep, check_numbers, exact_time, parse, signals_at
from ..contract.interface import Interface, Value
from ..contract.resolution import resolve
from ..host.gc_pause import paused
from ..library.expression import Expression
from ..text import units
from ..text.element_names import indexed, matching
from ..text.errors import Fault, ModelError
from ..text.json_document import AT_KEY
from ..text.other_words import CONDITION_NAMES, measure_meant
from ..text.printable import legible, quoted
from ..text.quantity_text import in_a_file, read_quantity
from .block_signals import FlatSignal, Signals, element_of
from .conditional import Enabled, Ending, Gate, OutputGate, TickGate, Time, TriggerGate
from .copies import Fleet, Later, without_numbers
from .copy_numbers import look_into_copies
from .diagram_grammar import MEASURE_NUMBERS, MEASURES, RUN
from .diagram_value import BlockEntry, DiagramValue
from .expansion import Expansion
from .flat_block import FlatBlock, FlatEnabled
from .hierarchy import MAX_BLOCKS, DiagramScope, Hierarchy, Leaf, Resolver, Spot
from .parts import Parts, is_taken_apart
from .settings import MeasureSpec, RunSettings, read_settings, seed_of
from .values import expressions_in, is_expression, names_in
from .variants import taken
from .wires import BlockSource, FlatInput, Source, Strand, ValueSource, Wires, WireSource, entered

MOST_OMEGA = 1e9
"""rad/s: each turn of a fundamental takes time to look through."""


def is_stepped(block: FlatBlock) -> bool:
    """Return whether a master steps the block: an FMU for Co-Simulation."""
    foreign = block.interface.declaration.foreign
    return foreign is not None and foreign.kind == "CS"


@dataclass(frozen=True, slots=True)
class Flat:
    """A diagram without hierarchy. `diagram`: its source, which knows where the blocks stand in the text.

    parts: by the index of a block that was taken apart, its parts, which come after all others.
    """

    name: str
    blocks: Sequence[FlatBlock]
    inputs: tuple[FlatInput, ...]
    signals: Mapping[str, FlatSignal]
    outputs: tuple[str, ...]
    settings: RunSettings
    log: tuple[str, ...]
    measures: tuple[MeasureSpec, ...]
    enabled: tuple[FlatEnabled, ...] = ()
    diagram: DiagramValue | None = field(default=None, compare=False, repr=False)
    expansion: Expansion | None = field(default=None, compare=False, repr=False)  # where there are copies
    stepped_by: tuple[str, ...] = ()  # the parameters from which the step of a fixed-step method is computed
    parts: Mapping[int, range] = field(default_factory=dict)
    fleets: tuple[Fleet, ...] = field(default=(), compare=False, repr=False)
    root: DiagramScope | None = field(default=None, compare=False, repr=False)  # with where all values come from
    ending: Leaf | None = field(default=None, compare=False, repr=False)  # the condition that ends a run

    @property
    def one_of_each(self) -> Sequence[FlatBlock]:
        """The blocks, of copies one that stands for all: what their types tell."""
        return self.blocks if self.expansion is None else self.expansion.blocks

    @property
    def copies(self) -> dict[str, int]:
        """How many copies there are of a block with copies, by its path without numbers."""
        return {fleet.path: fleet.count for fleet in self.fleets}

    def placed(self, fault: Fault) -> Fault:
        """The fault with the place in the text of the block that it names, where there is one."""
        if fault.file:
            return fault
        value, known = self.diagram, fault
        for name in without_numbers(f"{fault.place}.")[0].replace("[]", "").split("."):
            if value is None or name not in value.blocks:
                break
            known = value.fault(fault.code, fault.place, fault.message, fault.cure, ("blocks", name, AT_KEY))
            value = value.blocks[name].inner
        return known if known.line else fault

    @contextlib.contextmanager
    def placing(self) -> Iterator[None]:
        """Faults that are raised inside get their place in the text."""
        try:
            yield
        except ModelError as error:
            raise ModelError(*map(self.placed, error.faults)) from error.__cause__


@paused()
def flatten(
    diagram: DiagramValue,
    resolver: Resolver,
    *,
    overrides: Mapping[str, object] | None = None,
    settings: Mapping[str, object] | None = None,
) -> Flat:
    """The flat form of a diagram.

    Of blocks with variants, those that the file chooses are taken. overrides: raw values by the path of a parameter
    ("torque", "motor_right.Ra"). settings: run settings that replace those of the file. Raises ModelError with all
    faults.
    """
    return _Flattener(taken(diagram), resolver, dict(overrides or {}), dict(settings or {})).flat()


def interface_of(diagram: DiagramValue, name: str, resolver: Resolver) -> Interface:
    """The ports and sizes of one block of a diagram that need not be complete. Raises ModelError."""
    hierarchy = Hierarchy(replace(taken(diagram), inputs={}, wires={}, outputs={}), resolver, {})
    hierarchy.faults.check()
    leaf = hierarchy.root.children[name]
    assert isinstance(leaf, Leaf)
    return leaf.interface


def _blocks_around(signal: str) -> list[str]:
    """The paths of the blocks and subdiagrams that a signal lies in: "a", "a.b" of "a.b.y"."""
    return [signal[:k] for k, letter in enumerate(signal) if letter == "."]


def _replaced(run: Mapping[str, Any], path: tuple[str | int, ...], time: Fraction | None) -> dict[str, object]:
    """Run settings with another time at a path; None: without a time there, or with a neutral one."""
    key, *rest = path
    if key == "stops":
        stops = list(run["stops"])
        stops[int(rest[0])] = Fraction(0) if time is None else time
        return {**run, "stops": stops}
    if rest:
        return {**run, str(key): _replaced(run[str(key)], tuple(rest), time)}
    if time is None and key != "step":  # without a step, there would be another fault
        return {name: raw for name, raw in run.items() if name != key}
    return {**run, str(key): Fraction(1) if time is None else time}


def _shown(raw: object) -> str:
    return next(expressions_in(raw), "")


class _Flattener:
    def __init__(
        self, diagram: DiagramValue, resolver: Resolver, overrides: Mapping[str, object], settings: Mapping[str, object]
    ) -> None:
        self.diagram = diagram
        self.given = {key for key, value in settings.items() if value is not None}
        if isinstance(master := settings.get("master"), Mapping):
            self.given |= {f"master.{key}" for key in master}
        self.hierarchy = Hierarchy(diagram, resolver, overrides, seed_of(diagram.run, settings.get("seed")))
        look_into_copies(self.hierarchy)
        self.hierarchy.check_overrides()
        self.root, self.faults, self.tell = self.hierarchy.root, self.hierarchy.faults, self.hierarchy.tell
        self.wires = Wires(self.hierarchy)
        self.stepped_by: tuple[str, ...] = ()
        times = self.times(diagram.run, settings), self.times(settings)
        self.settings, self.wrong_settings = read_settings(times[0], **times[1])

    def times(self, run: Mapping[str, object], above: Mapping[str, object] | None = None) -> dict[str, Any]:
        """Run settings with times in place of expressions. above: for the file's settings, those that replace them.

        A time whose expression has faults, which are reported here, is left out or becomes a neutral one.
        """
        run_settings = dict(run)
        replaced = {path for path, raw in RUN.quantities(above or {}) if raw is not None}
        for path, raw in RUN.quantities(run):
            if next(expressions_in(raw), None) is None:
                continue
            if path in replaced or (path[0] == "stops" and (above or {}).get("stops") is not None):
                run_settings = _replaced(run_settings, path, None)
                continue
            run_settings = _replaced(
                run_settings, path, self.time(path, raw, ("run", *path) if above is not None else None)
            )
            if path == ("step",):
                self.stepped_by = tuple(names_in(raw))
        return run_settings

    def time(self, path: tuple[str | int, ...], raw: object, spot: Spot) -> Fraction | None:
        """The time in s that an expression gives; None after its faults were reported."""
        place = ".".join(["run", *(legible(part) for part in path if isinstance(part, str))])
        value = self.hierarchy.evaluated(self.root, raw, "s", place, spot)
        if value is None:
            return None
        if not isinstance(value.value, float):
            self.tell(self.root, "E115", place, f"must be a time in s, not {quoted(_shown(raw))}.", "", spot)
            return None
        return exact_time(value.value if value.exact is None else value.exact)

    def flat(self) -> Flat:
        blocks = []
        for leaf in self.hierarchy.leaves:
            sources = self.wires.sources(leaf)
            if sources is not None:
                blocks.append(FlatBlock(leaf.path, leaf.resolved, sources))
        signals = self.signals()
        for key, code, message, cure in self.wrong_settings:
            if key == "step" and any(is_stepped(block) for block in blocks):
                cure += ' Steps between FMUs: "step" in "master" (master={"step": 0.01}, --master step=0.01).'
            spot_ = None if key in self.given else ("run", *key.split("."))
            self.tell(self.root, code, f"run.{key}", message, cure, spot_)
        self.check_steps()
        for name in self.settings.inputs:
            if name not in self.diagram.inputs:
                known = self.diagram.inputs
                cure = self.faults.guess(name, known) or f"Inputs: {', '.join(known) or 'none'}."
                spot = None if "inputs" in self.given else ("run", "inputs", name)
                place = f"run.inputs.{legible(name)}"
                self.tell(self.root, "E502", place, "the diagram has no such input.", cure, spot)
        log = self.log(signals)
        measures = [self.measure(name, raw, signals) for name, raw in self.diagram.measures.items()]
        ending = self.ending(signals)
        self.faults.check()
        # Without faults, nothing is left out.
        assert len(blocks) == len(self.hierarchy.leaves)
        assert all(child is not None for scope in self.hierarchy.scopes for child in scope.children.values())
        enabled = self.controlled(blocks)
        blocks += () if ending is None else ending.blocks(len(blocks))
        self.faults.check()
        written, enabled, expansion, parts = self.taken_apart(blocks, enabled, signals)
        return Flat(
            self.diagram.name,
            written,
            tuple(self.wires.inputs.values()),
            signals,
            tuple(self.diagram.outputs),
            self.settings,
            log,
            tuple(measure for measure in measures if measure is not None),
            enabled,
            self.diagram,
            expansion,
            self.stepped_by,
            parts,
            tuple(self.hierarchy.fleets),
            self.root,
            None if ending is None else ending.leaf,
        )

    def taken_apart(
        self, blocks: list[FlatBlock], enabled: tuple[FlatEnabled, ...], signals: Signals
    ) -> tuple[Sequence[FlatBlock], tuple[FlatEnabled, ...], Expansion | None, Mapping[int, range]]:
        """Blocks with those over long vectors taken apart, and how copies are written out.

        Where a block inside of copies is taken apart, the copies are written out at once.
        """
        has_copies = bool(self.hierarchy.fleets)
        scopes = {scope.path: scope.fleet for scope in self.hierarchy.scopes}
        written = blocks
        is_inside = any(leaf.fleet and is_taken_apart(blocks[leaf.index]) for leaf in self.hierarchy.leaves)
        expansion = self.expansion(blocks) if is_inside else None
        if expansion is not None:
            signals.expansion, written = expansion, [*expansion.written_out()]
            enabled = tuple(expansion.enabled([(part, scopes[part.path]) for part in enabled]))
        parts = Parts(written)
        if parts.given:
            signals.moved = parts.moved
            enabled = tuple(
                replace(e, members=parts.members(e.members), resets=parts.members(e.resets)) for e in enabled
            )
        if is_inside or not has_copies:
            return tuple(written), enabled, None, parts.of
        expansion = self.expansion(blocks)
        if parts.given:
            expansion, signals.moved = replace(expansion, moved=parts.moved), tuple
        signals.expansion = expansion
        enabled = tuple(expansion.enabled([(part, scopes[part.path]) for part in enabled]))
        later = Later(expansion.layout.size, lambda: [*expansion.written_out()])
        place = expansion.layout.place
        of = {place(k, 0): range(place(own[0], 0), place(own[-1], 0) + 1) for k, own in parts.of.items() if own}
        return later, enabled, expansion, of

    def expansion(self, blocks: Sequence[FlatBlock]) -> Expansion:
        """The blocks with the fleets that they are in. Raises ModelError (E008) for too many."""
        leaves = self.hierarchy.leaves
        scopes = [edge.scope for edge in self.wires.gates]
        scopes += [scope for scope in self.hierarchy.scopes if scope.control for _ in range(3)]
        rest = len(blocks) - len(leaves) - len(scopes)  # parts of blocks, which are in no fleet
        fleets = (*(leaf.fleet for leaf in leaves), *(scope.fleet for scope in scopes), *[None] * rest)
        each = (*(leaf.each for leaf in leaves), *({} for _ in range(len(scopes) + rest)))
        expansion = Expansion(tuple(blocks), fleets, each, len(leaves), len(self.wires.gates))
        if expansion.layout.size > MAX_BLOCKS:
            message = f"the diagram has {expansion.layout.size:,} blocks, but the limit is {MAX_BLOCKS:,}."
            raise ModelError(self.diagram.fault("E008", self.diagram.name, message))
        return expansion

    def check_steps(self) -> None:
        """Refuse a communication step for a name that is no block."""
        leaves = self.hierarchy.leaves if self.settings.master.steps else ()
        paths = {path for leaf in leaves for path in leaf.all_paths}
        for name in self.settings.master.steps:
            if name not in paths and not self.is_lost(name):
                spot = None if "master.steps" in self.given else ("run", "master", "steps", name)
                cure = self.faults.guess(name, paths) or "Give the path of a block, as in robot.motor."
                self.tell(self.root, "E115", "run.master.steps", f"there is no block {quoted(name)}.", cure, spot)

    # --- the condition that ends a run ------------------------------------------------------------------------

    def ending(self, signals: Signals) -> _Condition | None:
        """Read the condition that ends the run; None if there is none, or after its faults were reported."""
        text, before = self.settings.stop_when, len(self.faults)
        names = dict.fromkeys(name for _, _, name in signals_at(text))
        read = {name: signal for name in names if (signal := element_of(name, signals)) is not None}
        constants = [name for name in names if name not in read and name in self.root.parameters]
        missing = [name for name in names if name not in {*read, *constants}]
        if len(text) > LENGTH:
            self.refuse_ending("E108", f"the condition has {len(text)} characters; the limit is {LENGTH}.")
        else:
            self.check_names(text, read, missing, signals)
        is_absent = missing or None in [self.root.parameters[name] for name in constants]
        if len(self.faults) > before or not text or is_absent:
            return None
        truths = frozenset(name for name, signal in read.items() if signal.type == "bool")
        self.check_condition(text, read, truths)
        if len(self.faults) > before:
            return None
        # The formula of an Expression has numbered inputs and constants; a truth value becomes a comparison of 0 or 1.
        numbered = {name: f"u{k + 1}" for k, name in enumerate(read)}
        numbered |= {name: f"k{k + 1}" for k, name in enumerate(constants)}
        for begin, end, name in [*signals_at(text)][::-1]:
            text = text[:begin] + (f"({numbered[name]} > 0)" if name in truths else numbered[name]) + text[end:]
        if len(text) > LENGTH:
            self.refuse_ending("E108", "the condition reads too many signals.", "Join some of them in a block Logic.")
            return None
        path = "stop_when"
        while any(path in names for names in (self.root.children, self.root.parameters, self.diagram.inputs)):
            path += "_"
        given = {"expression": text, "k": [f"=1*{name}" for name in constants]}
        made = self.hierarchy.numbers(self.root, path, BlockEntry(cls=Expression, parameters=given))
        sources = tuple(signals.seen_outside(name) for name in read)
        return None if made is None else _Condition(Leaf(path, self.root, *made, -1), sources)

    def refuse_ending(self, code: str, message: str, cure: str = "") -> None:
        """Report a fault of the condition that ends the run."""
        spot = None if "stop_when" in self.given else ("run", "stop_when")
        self.tell(self.root, code, "run.stop_when", message, cure, spot)

    def check_names(self, text: str, read: Mapping[str, FlatSignal], missing: Sequence[str], signals: Signals) -> None:
        """Refuse names of a condition that are no signals and no parameters, and signals of several elements."""
        for name, signal in read.items():
            if signal.shape != ():
                message = f"{name} has {math.prod(signal.shape)} elements."
                self.refuse_ending("E110", message, f'Name one, as in "{name}[0]".')
        for name in missing:
            if not self.is_lost(name):
                is_unit = text[: text.index(name)].rstrip()[-1:].isdigit()
                cure = "Numbers are in SI: write them without a unit." if is_unit else ""
                cure = cure or CONDITION_NAMES.get(name.lower(), "")
                cure = cure or self.faults.guess(name, signals) or self.faults.guess(name, self.root.parameters)
                cure = cure or "Name an output, as in lift.height, a parameter of the diagram, or t."
                self.refuse_ending("E105", f"there is no signal {quoted(name)}.", cure)

    def check_condition(self, text: str, read: Mapping[str, FlatSignal], truths: frozenset[str]) -> None:
        """Refuse what is no condition, and comparisons of two signals that are different quantities."""
        try:
            condition = parse(text, truths=truths)
            check_numbers(condition)
        except ModelError as error:
            self.refuse_ending("E108", error.faults[0].message, error.faults[0].cure)
            return
        if not condition.is_truth:
            self.refuse_ending("E108", f"{quoted(text)} is a number, not a condition.", "Compare it, as in x >= 3.")
        known = {name: signal.declared_unit or signal.unit for name, signal in read.items()}
        known |= {name: value.unit for name, value in self.root.parameters.items() if value is not None}
        for left, right, relation in zip(condition.steps, condition.steps[1:], condition.steps[2:], strict=False):
            if relation.word in RELATIONS:
                self.check_relation([step for step in (left, right) if not step.operands], known)

    def check_relation(self, sides: Sequence[PostfixStep], known: Mapping[str, str]) -> None:
        """Refuse a comparison of different quantities, and of a number with a signal that is not in SI.

        sides: the names and numbers that stand directly beside the relation. known: units by name.
        """
        named = [step.word for step in sides if known.get(step.word)]
        if len(named) == 2 and not units.same_quantity(known[named[0]], known[named[1]]):
            shown = " and ".join(f"{name} [{known[name]}]" for name in named)
            self.refuse_ending("E104", f"{shown} are different quantities.", "Compare equal quantities.")
        numbers = [step.scalar.value for step in sides if step.scalar is not None]
        name = named[0] if len(named) == 1 and any(numbers) else ""
        unit = known.get(name, "")
        if unit and units.affine(unit, units.si_text(unit)) != (1.0, 0.0):
            message = f"{name} is in {unit}, but numbers of a condition are in SI, {units.si_text(unit)}."
            cure = f'Compare it with a parameter of the diagram, {{"value": {numbers[0]:g}, "unit": {quoted(unit)}}}.'
            self.refuse_ending("E104", message, cure)

    # --- enabled and triggered subdiagrams ---------------------------------------------------------------------

    def controlled(self, blocks: list[FlatBlock]) -> tuple[FlatEnabled, ...]:
        """Add the blocks at the edges of enabled and triggered subdiagrams, and set each block's condition and time."""
        scopes = [scope for scope in self.hierarchy.scopes if scope.control]
        if not scopes:
            return ()
        # The gates of the edges come first: their places are assigned already. Then the blocks of each scope.
        first = len(blocks) + len(self.wires.gates)
        at = {scope.index: first + 3 * k for k, scope in enumerate(scopes)}
        edges = _Edges(at, {scope.index: self.wires.control_sources(scope) for scope in scopes})
        self.faults.check()
        for index, leaf in enumerate(self.hierarchy.leaves):
            blocks[index] = replace(blocks[index], **edges.place(leaf.scope))
            self.check_controlled(leaf)
        for scope, name, sources, is_output in self.wires.gates:
            blocks.append((edges.output_gate if is_output else edges.gate)(scope, name, sources))
        directly: dict[int | None, list[int]] = {}  # the blocks that lie in an enabled subdiagram, by its switch
        for index, block in enumerate(blocks):
            directly.setdefault(block.condition, []).append(index)
        below: dict[int, list[int]] = {}  # the blocks anywhere in a scope
        for index, leaf in enumerate(self.hierarchy.leaves):
            inner: DiagramScope | None = leaf.scope
            while inner is not None:
                below.setdefault(inner.index, []).append(index)
                inner = inner.parent
        enabled = []
        for scope in scopes:
            blocks += edges.blocks_of(scope)
            if "enable" in scope.control:
                places = at[scope.index] + 2, at[scope.index] + 1
                members = tuple(directly.get(places[0], ()))
                anew = below.get(scope.index, ()) if scope.control["enable"].get("states") == "reset" else ()
                enabled.append(FlatEnabled(scope.path, *places, members, tuple(anew)))
        return tuple(enabled)

    def check_controlled(self, leaf: Leaf) -> None:
        """Refuse what has a time of its own in a triggered subdiagram, and delays in an enabled one."""
        d, scope = leaf.interface.declaration, leaf.scope
        spot = ("blocks", leaf.name)
        within: DiagramScope | None = scope
        while within is not None:
            if "trigger" in within.control:
                what = "states" if d.states else "sampled equations" if leaf.resolved.clocks else ""
                what = what or ("event times" if d.event_times else "a delay" if d.histories else "")
                if what:
                    message = f"has {what}, but {within.path} runs at its triggers only."
                    self.tell(scope, "E121", leaf.name, message, "Enable the subdiagram instead.", spot)
                    return
            if "enable" in within.control and d.histories:
                message = f"is a delay, which would go on recording its input while {within.path} is off."
                self.tell(scope, "E121", leaf.name, message, "Move it out of the subdiagram.", spot)
                return
            within = within.parent

    # --- names that can be recorded ----------------------------------------------------------------------------

    def signals(self) -> Signals:
        """Every input and output of the diagram, every output of every block and subdiagram, by its path."""
        all_signals = Signals()

        def add(name: str, strand: Strand | None, fleet: Fleet | None = None) -> None:
            if strand is not None:
                whole = FlatSignal(name, strand.sources, strand.shape, strand.units, strand.declared, strand.type)
                all_signals.add(name, whole, fleet)
                for k, element in enumerate(strand.names):
                    of_bus = f"{name}[{element}]"
                    part = strand.part(slice(k, k + 1), ())
                    own = FlatSignal(of_bus, part.sources, (), part.units, part.declared, part.type)
                    if element:
                        all_signals.add(of_bus, own, fleet, is_told=False)

        def made(name: str, node: WireSource, fleet: Fleet | None, copied: Fleet | None) -> None:
            strand = self.wires.strand(node)
            add(name, strand, fleet)
            if copied is not None and strand is not None:
                add(name, entered(copied, strand), copied)

        for name in self.diagram.inputs:
            add(name, self.wires.strand(WireSource("input", 0, name)))
        for leaf in self.hierarchy.leaves:
            rearranged, fleet = leaf.interface.rearranged, leaf.fleet
            for name, port in leaf.interface.outputs.items():
                for text in self.names_of(leaf, name, all_signals):
                    if name not in rearranged:
                        all_signals.add(text, (leaf.index, port), fleet)
                    if name in rearranged or leaf.copied:
                        made(text, WireSource("port", leaf.index, name), leaf.scope.fleet, leaf.copied)
            for name, port in leaf.interface.locals.items():
                all_signals.add(f"{leaf.path}.{name}", (leaf.index, port), fleet, is_told=False)
        for scope in self.hierarchy.scopes:
            for name in scope.value.outputs:
                if name in scope.value.inputs:
                    cure = "Rename one of them: results need different names."
                    self.tell(scope, "E109", name, "is also the name of an input.", cure, ("outputs", name))
                outer = scope.fleet if scope.parent is None else scope.parent.fleet
                for text in self.names_of(scope, name, all_signals):
                    made(text, WireSource("output", scope.index, name), outer, scope.copied)
            for name in scope.value.inputs:
                self.wires.strand(
                    WireSource("input", scope.index, name)
                )  # its faults, also where nothing inside reads it
        for section, table in (("inputs", self.diagram.inputs), ("outputs", self.diagram.outputs)):
            if "time" in table:
                message, cure = "is the name that results give to their times.", "Rename the signal."
                self.tell(self.root, "E109", "time", message, cure, (section, "time"))
        return all_signals

    def names_of(self, child: Leaf | DiagramScope, port: str, signals: Signals) -> list[str]:
        """The names of a port as a signal: for a port of a variant, the block's name and its own."""
        path = child.path
        scope = child.scope if isinstance(child, Leaf) else child.parent
        own = f"{path}.{port}" if path else port
        ports = scope.value.blocks[child.name].ports if scope is not None else {}
        if not ports:
            return [own]
        names = [f"{path}.{name}" for name, other in ports.items() if other == port]
        if names and port not in ports:
            signals.hide(own, child.fleet)
        return names if port in ports else [*names, own]

    def log(self, signals: Signals) -> tuple[str, ...]:
        """The names to record: signals, elements of them, all outputs of a block, or what a pattern names of these."""
        if self.settings.log is None:
            return tuple(signals.told)
        names: dict[str, None] = {}
        for index, name in enumerate(self.settings.log):
            if element_of(name, signals) is not None:
                names[name] = None
                continue
            below = self.signals_like(name, signals) if "*" in name else self.signals_of(name, signals)
            names.update(dict.fromkeys(below))
            if not below and not self.is_lost(name):
                spot = None if "log" in self.given else ("run", "log", index)
                beside = self.signals_of(indexed(name)[0].rpartition(".")[0], signals)
                near = self.faults.guess(name.rpartition(".")[2], [signal.rpartition(".")[2] for signal in beside])
                inside = (f"{child}.{name}" for child in islice(self.root.children, 100))
                same = next((signal for signal in inside if signal in signals), None)
                guess = "" if "*" in name else self.faults.guess(name, signals)
                cure = f"Did you mean '{same}'?" if same else guess
                known = [*islice(signals, 20)]
                cure = cure or f"Signals: {', '.join(known)}{', ...' if len(signals) > len(known) else ''}."
                cure = f"Signals there: {', '.join(beside[:20])}." if beside else cure
                cure = self.faults.guess(name, beside) + " " + cure if near else cure
                what = "no signal or block matches" if "*" in name else "there is no signal"
                self.tell(self.root, "E105", "run.log", f"{what} {quoted(name)}.", cure, spot)
        return tuple(names)

    def signals_like(self, pattern: str, signals: Signals) -> list[str]:
        """The names of all signals that a pattern names; where it names none, those of the blocks that it names."""
        base, bracket, index = (pattern[:-1] if pattern.endswith("]") else f"{pattern}[").rpartition("[")
        end = f"{bracket}{index}]" if pattern.endswith("]") else ""
        found = [name + end for name in signals.like(base)]
        if end or found:
            return [name for name in found if element_of(name, signals) is not None]
        open_ = [name for name in signals if signals.is_told(name)]
        blocks = {*matching(base, dict.fromkeys(part for name in open_ for part in _blocks_around(name)))}
        return [name for name in open_ if not blocks.isdisjoint(_blocks_around(name))]

    def signals_of(self, path: str, signals: Signals) -> list[str]:
        """The names of all signals of a block; none where there is no such block."""
        child: Leaf | DiagramScope | None = self.root
        names, numbers = without_numbers(f"{path}.")
        for part in names[:-1].split("."):
            child = child.children.get(part.removesuffix("[]")) if isinstance(child, DiagramScope) else None
        if child is None or not signals.is_copy(child.fleet, names, numbers):
            return []
        if isinstance(child, Leaf) or (child.copied is not None and not names.endswith("[].")):
            ports = child.interface.outputs if isinstance(child, Leaf) else child.value.outputs
            own = [f"{path}{name[len(child.path) :]}" for port in ports for name in self.names_of(child, port, signals)]
            return [name for name in own if name in signals and signals.is_told(name)]
        return signals.below(names, numbers)

    def is_lost(self, name: str) -> bool:
        """Whether a signal is missing only because of a fault that was reported already."""
        scope, rest = self.root, indexed(name)[0]
        while True:
            if rest in scope.value.outputs:
                return self.wires.strand(WireSource("output", scope.index, rest)) is None
            first, _, rest = rest.partition(".")
            first, number = indexed(first)
            if first not in scope.children:
                return False
            child = scope.children[first]
            if number is not None and child is not None and (child.copied is None or number >= child.copied.count):
                return False
            if not isinstance(child, DiagramScope):
                lost = isinstance(child, Leaf) and rest in child.interface.outputs
                return child is None or (lost and self.wires.strand(WireSource("port", child.index, rest)) is None)
            scope = child

    # --- measures ----------------------------------------------------------------------------------------------

    def measure(self, name: str, raw: Mapping[str, Any], signals: Mapping[str, FlatSignal]) -> MeasureSpec | None:
        """A measure with its signals and its window; None after its faults were reported."""
        before = len(self.faults)

        def refuse(key: str, message: str, cure: str = "", code: str = "E116") -> None:
            self.tell(self.root, code, f"measures.{name}", message, cure, ("measures", name, key))

        type_ = raw["type"]
        if type_ not in MEASURES:
            cure = measure_meant(type_) or self.faults.guess(type_, MEASURES) or f"Measures: {', '.join(MEASURES)}."
            refuse("type", f"there is no measure {quoted(type_)}.", cure)
        raw = {**raw, **{key: read_quantity(raw[key]) for key in MEASURE_NUMBERS if key in raw}}
        operands, complete = self._operands(raw, signals, refuse)
        against: str | float = operands["against"].name if "against" in operands else 0.0
        if "against" in raw and "against" not in operands and complete:
            signal = operands.get("of")
            unit = "" if signal is None else signal.declared_unit
            number = self.number(name, "against", raw["against"], unit)
            against = 0.0 if number is None else number
        window = self._window(name, raw, type_, refuse)
        if type_ in ("overshoot", "settling_time", "rise_time") and "against" not in raw:
            refuse("type", f"{type_} needs the target value.", 'Add "against": a number or a signal.')
        if len(operands) == 2 and not units.same_quantity(operands["of"].unit, operands["against"].unit):
            shown = " and ".join(f"{signal.name} [{signal.unit}]" for signal in operands.values())
            cure = "A measure of a difference needs two signals of the same quantity."
            refuse("against", f"{shown} are different quantities.", cure, "E104")
        if len(self.faults) > before or not complete:
            return None
        return MeasureSpec(name, type_, operands["of"].name, against, *window.values())

    def _operands(
        self, raw: Mapping[str, Any], signals: Mapping[str, FlatSignal], refuse: Callable[..., None]
    ) -> tuple[dict[str, FlatSignal], bool]:
        """Return the signals of a measure by key, and whether there are all that it names."""
        operands: dict[str, FlatSignal] = {}
        complete = True
        for key in ("of", "against"):
            text = raw.get(key)
            if not isinstance(text, str) or (key == "against" and is_expression(text)):
                continue
            signal = element_of(text, signals)
            if signal is None:
                complete = False
                if not self.is_lost(text):
                    cure = in_a_file(text) or self.faults.guess(text, signals)
                    refuse(key, f"there is no signal {quoted(text)}.", cure, "E105")
            elif signal.shape != ():
                cure = f'Measure one element, as in "{text}[0]".'
                refuse(key, f"{text} has {math.prod(signal.shape)} elements, but a measure needs one.", cure, "E110")
            else:
                operands[key] = signal
        return operands, complete

    def _window(
        self, name: str, raw: Mapping[str, Any], type_: str, refuse: Callable[..., None]
    ) -> dict[str, float]:
        """Return the window, the band and omega of a measure."""
        window = {"from": -math.inf, "to": math.inf, "band": 0.02, "omega": 0.0}
        for key in window:
            if key in raw:
                number = self.number(name, key, raw[key], MEASURE_NUMBERS[key])
                window[key] = window[key] if number is None else number
        if window["from"] >= window["to"]:
            refuse("to", "the window ends before it begins.")
        if not 0 < window["band"] < 1:
            message = f"the band must be between 0 and 1, not {window['band']}."
            refuse("band", message, "It is a fraction of the step's size, as in 0.02.")
        elif "band" in raw and type_ in MEASURES and type_ != "settling_time":
            refuse("band", f"{type_} has no band.", "The band belongs to settling_time.")
        if "omega" in raw and not 0 < window["omega"] <= MOST_OMEGA:
            refuse("omega", f"omega must be above 0 and at most {MOST_OMEGA:g} rad/s, not {window['omega']}.")
        elif ("omega" in raw) != (type_ == "THD") and type_ in MEASURES:
            message = "needs omega, the frequency of its fundamental." if type_ == "THD" else "does not use omega."
            cure = 'Add "omega" in rad/s.' if type_ == "THD" else "Leave it out: omega belongs to THD."
            refuse("omega" if "omega" in raw else "type", f"{type_} {message}", cure)
        return window

    def number(self, name: str, key: str, raw: object, unit: str) -> float | None:
        """A number of a measure in SI; None after a fault was reported."""
        place, spot = f"measures.{name}", ("measures", name, key)
        value = self.hierarchy.evaluated(self.root, raw, unit, place, spot)
        if value is not None and not isinstance(value.value, float):
            self.tell(self.root, "E116", place, f'"{key}" must be a number.', in_a_file(raw), spot)
            return None
        return None if value is None else value.value


@dataclass(frozen=True, slots=True)
class _Condition:
    """The condition that ends a run: a formula, which is in no diagram, and what it reads."""

    leaf: Leaf
    sources: tuple[Source, ...]

    def blocks(self, index: int) -> list[FlatBlock]:
        """The formula, with this index, and whether it holds."""
        formula = FlatBlock(self.leaf.path, self.leaf.resolved, {"u": self.sources}, hidden=True)
        holds = resolve(Ending, {}, self.leaf.path)
        return [formula, FlatBlock(self.leaf.path, holds, {"holds": (BlockSource(index, "y", 0),)}, hidden=True)]


class _Edges:
    """The blocks at the edges of subdiagrams that are enabled or triggered.

    at: by scope, the place of its three blocks: Time, its gate, Enabled. controls: by scope, the sources of what
    enables or triggers it.
    """

    def __init__(self, at: Mapping[int, int], controls: Mapping[int, tuple[Source, ...] | None]) -> None:
        self.at, self.controls = at, controls

    def place(self, scope: DiagramScope | None) -> dict[str, Any]:
        """The condition and the time of a block that lies directly in a scope."""
        enabled, any_ = _around(scope, "enable"), _around(scope)
        condition = None if enabled is None else self.at[enabled.index] + 2
        return {"condition": condition, "time": None if any_ is None else self.at[any_.index] + 1}

    def outer(self, scope: DiagramScope) -> tuple[Source, ...]:
        enabled = _around(scope.parent, "enable")
        return (ValueSource(1.0) if enabled is None else BlockSource(self.at[enabled.index] + 2, "y", 0),)

    def gate(self, scope: DiagramScope, name: str, sources: tuple[Source, ...]) -> FlatBlock:
        """The block that lets values into a scope while it is on, or when it is triggered."""
        given: dict[str, Value] = {"size": Value(len(sources))}
        control = self.controls[scope.index] or ()
        cls: type[Block]
        wired: dict[str, tuple[Source, ...]]
        if scope.clock is not None:
            cls, wired = TickGate, {}
            given |= {"period": scope.clock[0], "offset": scope.clock[1]}
        elif "trigger" in scope.control:
            cls, wired = TriggerGate, {"trigger": control}
            given["direction"] = Value(scope.control["trigger"].get("direction", "up"))
        else:
            cls, wired = Gate, {"enable": control, "outer": self.outer(scope)}
        resolved = resolve(cls, given, scope.path)
        where = self.place(scope.parent)
        if cls is Gate:  # it sees for itself that the subdiagram around is off, and must not stand still then
            where["condition"] = None
        return FlatBlock(f"{scope.path}.{name}", resolved, {"u": sources, **wired}, **where, hidden=True)

    def output_gate(self, scope: DiagramScope, name: str, sources: tuple[Source, ...]) -> FlatBlock:
        """The block that gives an output of a scope: 0 while the scope is off."""
        resolved = resolve(OutputGate, {"size": Value(len(sources))})
        wired = {"u": sources, "on": (BlockSource(self.at[scope.index] + 2, "y", 0),)}
        return FlatBlock(f"{scope.path}.{name}", resolved, wired, **self.place(scope.parent), hidden=True)

    def blocks_of(self, scope: DiagramScope) -> tuple[FlatBlock, FlatBlock, FlatBlock]:
        """The time in a scope, its gate, and whether the scope is on."""
        time = FlatBlock(f"{scope.path}.t", resolve(Time, {}), {}, **self.place(scope.parent), hidden=True)
        clock = self.gate(scope, "t", (BlockSource(self.at[scope.index], "y", 0),))
        clock = replace(clock, told_as=scope.path if "direction" in scope.control.get("trigger", {}) else "")
        wired = {"enable": self.controls[scope.index] or (ValueSource(1.0),), "outer": self.outer(scope)}
        if "enable" not in scope.control:
            wired = {"enable": (ValueSource(1.0),), "outer": (ValueSource(1.0),)}
        switch = FlatBlock(scope.path, resolve(Enabled, {}), wired, hidden=True)
        return time, clock, replace(switch, told_as=scope.path if "enable" in scope.control else "")


def _around(scope: DiagramScope | None, kind: str = "") -> DiagramScope | None:
    """The nearest scope, from this one outwards, that is enabled or triggered."""
    while scope is not None and (not scope.control or (kind and kind not in scope.control)):
        scope = scope.parent
    return scope
