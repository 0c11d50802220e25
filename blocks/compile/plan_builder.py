"""A flat diagram -> its Plan: memory laid out, types traced, programs ordered, loops found."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from ..contract.interface import Interface
from ..contract.resolution import Resolved, memory_start
from ..contract.variables import Parameter
from ..host.gc_pause import paused
from ..model.block_signals import FlatSignal
from ..model.conditional import Ending
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.wires import BlockSource, InputSource, Source
from ..text.arrays import Array
from ..text.errors import Fault, ModelError
from .conditioning import unsure
from .firing_order import firing_order
from .fmu_tape import FmuTape
from .folding import At, folded
from .memory_layout import ROWS, Footprint, Start, names_of
from .plan import (
    NOTHING,
    TICK,
    TIME,
    AlgebraicLoop,
    Cause,
    EnabledPart,
    ForeignPart,
    History,
    Instance,
    Node,
    Plan,
    PlanInput,
    PlanSignal,
    Program,
    ProgramStep,
    Rate,
    Reference,
    StepperPart,
)
from .scheduler import schedule
from .tick_stages import coinciding, stages_of, tick_program
from .upstream import Upstream, at_once


@paused()
def plan(flat: Flat) -> Plan:
    """The Plan of a flat diagram: memory laid out, types traced, loops found.

    Raises ModelError (E102 algebraic loop, E119 rates, E120 start) and DeclarationError (E407).
    """
    as_one = folded(flat, _PlanBuilder) if flat.expansion is not None else None
    if as_one is not None:
        return as_one
    with flat.placing():
        return _PlanBuilder(flat).plan()


class _MemoryPlaces:
    """Where everything is: the footprint of each block, and where its places begin in each row."""

    def __init__(self) -> None:
        self.footprints: list[Footprint] = []
        self.first: list[tuple[int, ...]] = []
        self.sizes = (0,) * len(ROWS)

    def add(self, footprint: Footprint) -> None:
        self.footprints.append(footprint)
        self.first.append(self.sizes)
        self.sizes = tuple(map(operator.add, self.sizes, footprint.sizes))

    def place(self, block: int, variable: str) -> tuple[str, int]:
        """The row of a variable of a block, and the place of its first element."""
        row, place = self.footprints[block].place[variable]
        return row, self.first[block][ROWS[row]] + place

    def reference(self, source: Source) -> Reference:
        """Where a source of a wire is."""
        if isinstance(source, BlockSource):
            row, place = self.footprints[source.block].place[source.variable]
            index = self.first[source.block][ROWS[row]] + place + source.element
            return Reference(row, At(index, source.block.lane) if type(source.block) is At else index)
        return (
            Reference("u", source.element) if isinstance(source, InputSource) else Reference("k", float(source.value))
        )


class _PlanSignals(Mapping[str, PlanSignal]):
    """The signals of a diagram by name. Few of many are asked for, so each is made when it is."""

    def __init__(self, signals: Mapping[str, FlatSignal], memory: _MemoryPlaces) -> None:
        self._signals, self._memory = signals, memory
        self._made: dict[str, PlanSignal] = {}

    def __getitem__(self, name: str) -> PlanSignal:
        if name not in self._made:
            signal = self._signals[name]
            references = tuple(map(self._memory.reference, signal.sources))
            self._made[name] = PlanSignal(name, references, signal.shape, signal.units, signal.declared)
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._signals

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)


_Numbers = tuple[list[float], list[tuple[float, ...]]]
"""The values of a block in the rows p and c."""


class _PlanBuilder:
    def __init__(self, flat: Flat) -> None:
        self.flat = flat
        self.memory = _MemoryPlaces()
        self.footprints: dict[Interface, Footprint] = {}
        self.numbers: dict[int, _Numbers] = {}  # by the id of Resolved
        self.names: dict[str, list[str]] = {"x": [], "d": []}
        self.starts: dict[str, list[Node | Reference]] = {"x": [], "d": [], "s": []}
        self.nominal: list[float] = []
        self.parameters: list[float] = []
        self.tables: list[tuple[float, ...]] = []
        self.histories: list[History] = []
        self.guesses: dict[Reference, float] = {}
        self.integers: dict[int, frozenset[float]] = {}
        self.projections: list[tuple[Node, Reference]] = []
        self.outputs: list[Node] = []
        self.derivatives: list[Node] = []
        self.events: list[Cause] = []
        self.crossings: list[Cause] = []
        self.sampled: dict[tuple[Fraction, Fraction], tuple[list[tuple[Node, int]], list[tuple[Node, int]]]] = {}

    def plan(self) -> Plan:
        flat, memory = self.flat, self.memory
        for index, block in enumerate(flat.blocks):
            self.lay_out(index, block)
        for index, block in enumerate(flat.blocks):
            if not memory.footprints[index].is_still:
                self.causes(index)
                self.clocks(index, block)
                self.delays(index, block)
        base, rates = self.rates()
        instances = tuple(
            Instance(
                block.path,
                memory.footprints[index].tape,
                self.arguments(index, block),
                None if block.condition is None else memory.place(block.condition, "on")[1],
                block.hidden,
                block.told_as,
            )
            for index, block in enumerate(flat.blocks)
        )
        draft = Plan(
            flat.name,
            instances,
            tuple(self.names["x"]),
            tuple(self.names["d"]),
            tuple(self.nominal),
            tuple(self.parameters),
            tuple(self.tables),
            tuple(PlanInput(i.name, i.shape, i.declared, i.type, i.default) for i in flat.inputs),
            tuple(self.starts["x"]),
            tuple(self.starts["d"]),
            tuple(self.starts["s"]),
            tuple(self.derivatives),
            tuple(self.outputs),
            tuple(self.crossings),
            tuple(self.events),
            base,
            rates,
            tuple(self.projections),
            tuple(self.histories),
            self.enabled_parts(),
            self.steppers(),
            self.foreign_parts(),
            self.integers,
            self.guesses,
            _PlanSignals(flat.signals, memory),
            flat.log,
            flat.measures,
            flat.settings,
            tuple(self.warnings()),
            self.ends(),
        )
        return _settled(replace(draft, histories=tuple(_with_echoes(draft))))

    def lay_out(self, index: int, block: FlatBlock) -> None:
        """Places in memory for everything of one block, and its start values."""
        resolved = block.resolved
        footprint = self.footprints.get(block.interface)
        if footprint is None:
            footprint = self.footprints[block.interface] = Footprint(block.interface)
        self.memory.add(footprint)
        first = self.memory.first[index]
        parameters, tables = self.numbers.get(id(resolved)) or self.numbers_of(resolved)
        self.parameters += parameters
        self.tables += tables
        self.nominal += resolved.nominal
        for row, names in footprint.names.items():
            if names:
                self.names[row] += [block.path + name for name in names]
        for row, starts in footprint.starts.items():
            if starts:
                self.starts[row] += [self.start(index, resolved, start) for start in starts]
        self.outputs += [Node(index, key, element) for key, element in footprint.outputs]
        self.derivatives += [Node(index, key, element) for key, element in footprint.derivatives]
        self.integers.update((first[ROWS["d"]] + place, members) for place, members in footprint.integers)
        for name, algebraic in block.interface.declaration.algebraics.items():
            start = memory_start(resolved.values, algebraic)
            assert start is not None
            row, place = self.memory.place(index, name)
            self.guesses.update((Reference(row, place + e), float(x)) for e, x in enumerate(start))

    def numbers_of(self, resolved: Resolved) -> _Numbers:
        """The values of parameters and tables. Equal blocks share them."""
        interface, values = resolved.interface, resolved.values
        parameters = [x for name in interface.symbolic_parameters for x in _floats(values[name].value)]
        tables = [tuple(_floats(values[name].value)) for name in interface.tables]
        return self.numbers.setdefault(id(resolved), (parameters, tables))

    def start(self, index: int, resolved: Resolved, start: Start) -> Node | Reference:
        """The start value of a place of memory."""
        match start.kind:
            case "result":
                return Node(index, start.name, start.element)
            case "parameter":
                row, first = self.memory.place(index, start.name)
                return Reference(row, first + start.element)
            case "held":
                return Reference("k", float(resolved.starts[start.name][start.element]))
        return Reference("k", start.element)

    def arguments(self, index: int, block: FlatBlock) -> tuple[Reference, ...]:
        """Where the arguments of a block's tape are."""
        first = self.memory.first[index]

        def outside(kind: str, place: Any) -> Reference:
            """Where an argument is that has no place in the rows of the block."""
            if kind == "input":
                variable, element = place
                return self.memory.reference(block.sources[variable][element])
            if kind == "tick":
                return TICK
            return TIME if block.time is None else Reference(*self.memory.place(block.time, "y"))

        # Most objects of a large plan are made here, by tuple's own constructor: calling Reference takes twice as long.
        new, laid = tuple.__new__, self.memory.footprints[index].arguments
        return tuple([new(Reference, (r, first[n] + place)) if n >= 0 else outside(r, place) for r, n, place in laid])

    def steppers(self) -> tuple[StepperPart, ...]:
        parts = []
        clocks = list(self.sampled)
        for index, block in enumerate(self.flat.blocks):
            declared, interface = block.interface.declaration, block.interface
            if declared.stepper is None:
                continue
            known = {**{n: v.value for n, v in block.resolved.values.items()}, **interface.structural}
            given = {name: known[name] for name in declared.stepper.reads}
            inputs = [
                (name, tuple(map(self.memory.reference, block.sources[name])), interface.shape(variable))
                for name, variable in declared.inputs.items()
            ]
            outputs = []
            for name, stepped in declared.stepped.items():
                shape, (_, first) = interface.shape(stepped), self.memory.place(index, name)
                outputs.append((name, tuple(range(first, first + math.prod(shape))), shape))
            rate = clocks.index(block.resolved.clocks[declared.stepper.name])
            make = partial(_begun, declared.stepper.function, given)
            types = tuple(stepped.type for stepped in declared.stepped.values())
            parts.append(StepperPart(block.path, index, rate, make, tuple(inputs), tuple(outputs), types))
        return tuple(parts)

    def foreign_parts(self) -> tuple[ForeignPart, ...]:
        parts = []
        for index, block in enumerate(self.flat.blocks):
            footprint, interface = self.memory.footprints[index], block.interface
            if not isinstance(footprint.tape, FmuTape):
                continue
            opaque = footprint.tape.opaque
            if block.condition is not None or block.time is not None:
                message = "is an FMU for Model Exchange, which cannot be in an enabled subdiagram."
                raise ModelError(Fault("E121", block.path, message, "Move it out of the subdiagram."))
            arguments = self.arguments(index, block)
            parameters = []
            for name, parameter in interface.symbolic_parameters.items():
                parameters.append((name, self.memory.place(index, name)[1], math.prod(interface.shape(parameter))))
            texts = [(name, value) for name, value in interface.structural.items() if isinstance(value, str)]
            values = ((name, block.resolved.values[name].value) for name in interface.optional_parameters)
            optional = [(name, tuple(_floats(value))) for name, value in values if value is not None]
            crossings = tuple(j for j, cause in enumerate(self.crossings) if cause.instance == index)
            event = next(i for i, cause in enumerate(self.events) if cause.instance == index)
            states = tuple(int(arguments[k].index) for k, _ in opaque.states)
            inputs = tuple(arguments[k] for k, *_ in opaque.inputs)
            d, known = interface.declaration, footprint.tape.arguments
            parts.append(
                ForeignPart(
                    path=block.path,
                    instance=index,
                    states=states,
                    inputs=inputs,
                    crossings=crossings,
                    event=event,
                    parameters=tuple(parameters),
                    texts=tuple(texts),
                    optional=tuple(optional),
                    tunable=frozenset(name for name, *_ in parameters if not d.parameters[name].fixed),
                    nominal=tuple(_number(d.states[known[k].name].nominal) for k, _ in opaque.states),
                    foreign=d.foreign,
                )
            )
        return tuple(parts)

    def enabled_parts(self) -> tuple[EnabledPart, ...]:
        parts, first = [], [*self.memory.first, self.memory.sizes]
        for part in self.flat.enabled:
            resets: list[Reference] = []
            for row in ("x", "d"):
                for index in sorted(part.resets):
                    resets += [Reference(row, k) for k in range(first[index][ROWS[row]], first[index + 1][ROWS[row]])]
            _, side = self.memory.place(part.enabled, "on")
            _, time = self.memory.place(part.time, "kept")
            parts.append(
                EnabledPart(part.path, side, time, frozenset(part.members), tuple(resets), frozenset(part.resets))
            )
        return tuple(parts)

    def ends(self) -> int | None:
        """Find the crossing that ends the run."""
        blocks = self.flat.blocks if self.flat.settings.stop_when else ()
        found = (k for k, block in enumerate(blocks) if block.interface.declaration is Ending.declaration)
        return next((self.memory.place(k, "on")[1] for k in found), None)

    def causes(self, index: int) -> None:
        first, footprint = self.memory.first[index], self.memory.footprints[index]
        for laid, causes in ((footprint.crossings, self.crossings), (footprint.events, self.events)):
            for cause in laid:
                resets = tuple(
                    (Node(index, *result), Reference(row, first[ROWS[row]] + place))
                    for result, (row, place) in cause.resets
                )
                causes.append(Cause(index, cause.name, cause.direction, Node(index, *cause.result), resets))

    def clocks(self, index: int, block: FlatBlock) -> None:
        first, footprint = self.memory.first[index], self.memory.footprints[index]
        stepper = block.interface.declaration.stepper
        if stepper is not None:
            self.sampled.setdefault(block.resolved.clocks[stepper.name], ([], []))
        for result, (row, place) in footprint.projections:
            self.projections.append((Node(index, *result), Reference(row, first[ROWS[row]] + place)))
        for clocked in footprint.clocked:
            outputs, nexts = self.sampled.setdefault(block.resolved.clocks[clocked.clock], ([], []))
            (outputs if clocked.is_output else nexts).extend(
                (Node(index, *result), first[ROWS["d"]] + place) for result, place in clocked.elements
            )

    def delays(self, index: int, block: FlatBlock) -> None:
        """Histories in the order of their layout."""
        d = block.interface.declaration
        places = self.memory.footprints[index].place

        def where(source: object, values: Array) -> Iterator[Reference]:
            """Yield the places in p of a parameter, or the numbers that were computed."""
            if isinstance(source, Parameter) and places.get(source.name, ("", 0))[0] == "p":
                row, first = self.memory.place(index, source.name)
                shape = block.interface.shape(source)
                own = np.arange(first, first + math.prod(shape)).reshape(shape)
                return (Reference(row, int(k)) for k in np.broadcast_to(own, values.shape))
            return (Reference("k", float(value)) for value in values)

        for name, (delay, before) in block.resolved.delays.items():
            history = d.histories[name]
            names = names_of(f"{block.path}.{name}", len(before), block.interface.shape(history))
            sources, since = block.sources[history.of.name], where(history.delay, np.full(len(before), delay))
            for label, source, ago, held in zip(names, sources, since, where(history.before, before), strict=True):
                self.histories.append(History(label, self.memory.reference(source), ago, held))

    def rates(self) -> tuple[Fraction, tuple[Rate, ...]]:
        times = [time for clock in self.sampled for time in clock if time]
        base = _gcd(times) if times else Fraction(1)
        rates = tuple(
            Rate(int(period / base), int(offset / base), tuple(outputs), tuple(nexts))
            for (period, offset), (outputs, nexts) in self.sampled.items()
        )
        if any(max(rate.period, rate.offset) > 2**53 for rate in rates) or max(base.as_integer_ratio()) > 2**53:
            periods = ", ".join(f"{float(period)} s" for period, _ in self.sampled)
            message = f"ticks of {periods} have no common base that is coarse enough to count them exactly."
            cure = 'Round them to a common base, such as 1 us, or write them as fractions: "=1/3".'
            finest = max(self.sampled, key=lambda clock: max(time.denominator for time in clock))
            blocks = (block.path for block in self.flat.blocks if finest in block.resolved.clocks.values())
            raise ModelError(Fault("E119", next(blocks, self.flat.name), message, cure))
        return base, rates

    def warnings(self) -> Iterable[Fault]:
        """Find variables that two causes reset by different equations (W102), and poles that are lost (W105)."""
        for block, footprint in zip(self.flat.blocks, self.memory.footprints, strict=True):
            for target, names in footprint.clashes.items():
                causes = " and ".join(f"'{name}'" for name in names)
                message = f"is reset by {causes}; if they fire at the same instant, the reset of '{names[-1]}' wins."
                cure = "To change this, declare the resets in another order: the last one wins."
                yield self.flat.placed(Fault("W102", f"{block.path}.{target}", message, cure))
            if (fault := unsure(block.path, block.resolved)) is not None:
                yield self.flat.placed(fault)


def _settled(plan: Plan) -> Plan:
    """The plan with its derived fields. Raises ModelError (E102, E120).

    Every loop that could occur in a run is found here, before it: at all times, at the start, at ticks that coincide.
    """
    continuous = schedule(plan, _continuous(plan))
    for part in plan.enabled:
        schedule(plan, part.resets, start=frozenset(part.resets))
    starting, start, guessed = _start(plan)
    _check_ticks(plan)
    unknowns: tuple[Reference, ...] = ()
    loops: list[AlgebraicLoop] = []
    if any(isinstance(step, AlgebraicLoop) for step in continuous.steps):
        steps = schedule(plan, [Reference("w", i) for i in range(len(plan.outputs))]).steps
        loops = [step for step in steps if isinstance(step, AlgebraicLoop)]
        unknowns = tuple(reference for loop in loops for reference in loop.unknowns)
    order = firing_order(plan, loops)
    # The solution of a loop rounds in another way at each search.
    searched = enumerate(cause.node for cause in plan.crossings) if unknowns else ()
    corners = [j for j, node in searched if not at_once(plan, plan.bind(node)).isdisjoint(unknowns)]
    inner = [j for j in order.inner if j in corners]
    return replace(
        plan,
        starting=starting,
        start=start,
        continuous=continuous,
        unknowns=unknowns,
        corners=(*inner, *(j for j in corners if j not in inner)),
        inner_corners=tuple(inner),
        firing=order,
        guessed=guessed,
    )


def _continuous(plan: Plan) -> list[Node | Reference]:
    """All results but those that are computed at ticks: what a run may ask for between them."""
    causes = (*plan.crossings, *plan.events)
    return [
        *plan.derivatives,
        *(cause.node for cause in causes),
        *(node for cause in causes for node, _ in cause.resets),
        *(node for node, _ in plan.projections),
        *(node for rate in plan.rates for node, _ in rate.nexts),
        *(Reference("w", i) for i in range(len(plan.outputs))),
    ]


def _start(plan: Plan) -> tuple[bool | frozenset[Reference], Program, tuple[int, ...]]:
    """What is computed at the start, how, and the places in d that are guessed like sides. Raises ModelError (E120)
    where a start value needs itself."""
    rows = (("x", len(plan.states)), ("d", len(plan.discretes)))
    memory = [Reference(row, i) for row, size in rows for i in range(size)]
    known, start = frozenset(memory), NOTHING
    try:
        start = schedule(plan, [*memory, *plan.s_start], start=True)
    except ModelError:
        start = schedule(plan, [*memory, *plan.s_start], start=known)
        starting: bool | frozenset[Reference] = known
    else:
        starting = True
    guessed = tuple(sorted(place for step in start.steps for place in _stepped(plan, start, step)))
    if guessed:
        starting = known.difference(Reference("d", place) for place in guessed)
        begins = [plan.d_start[i] if i in guessed else Reference("d", i) for i in range(len(plan.discretes))]
        start = schedule(plan, [*memory[: len(plan.states)], *begins, *plan.s_start], start=starting)
    return starting, start, guessed


def _stepped(plan: Plan, program: Program, step: ProgramStep | AlgebraicLoop) -> Iterable[int]:
    """The places in d that a loop at the start would solve for, though they are steps of its unknowns: numbers of
    cells, of levels. Newton's method finds no way along steps."""
    for part in step.parts if isinstance(step, AlgebraicLoop) else ():
        if isinstance(part.tape, FmuTape):
            continue
        partials = [part.tape.nodes[n] for n in part.tape.results["partial"].nodes]
        for k, result in enumerate(part.results):
            own = partials[k * len(part.columns) : (k + 1) * len(part.columns)]
            reference = program.made.get(Node(part.instance, *result))
            is_flat = all(node.op == "constant" and node.value == 0.0 for node in own)
            if reference is not None and reference.row == "d" and is_flat:
                yield reference.index


def _check_ticks(plan: Plan) -> None:
    """Order all that may be computed at one tick. Raises ModelError (E102)."""
    if not plan.rates:
        return
    everything = frozenset(range(len(plan.rates)))
    try:
        _check_tick(plan, everything)
    except ModelError:
        # Rates that never coincide cannot close a loop; those that all meet in pairs meet together (remainders).
        for rates in coinciding(plan.rates):
            _check_tick(plan, rates)


def _check_tick(plan: Plan, rates: frozenset[int]) -> None:
    tick_program(plan, [slot for k in sorted(rates) for _, slot in plan.rates[k].outputs])
    stages_of(plan, rates)


def _with_echoes(plan: Plan) -> Iterable[History]:
    """The histories, each with whether a source of any depends on it, through equations or through memory."""
    if not plan.histories:
        return
    known = Upstream(plan).of(history.source for history in plan.histories)
    for i, history in enumerate(plan.histories):
        yield replace(history, echoes=Reference("h", i) in known)


def _gcd(times: Iterable[Fraction]) -> Fraction:
    divisor = Fraction(0)
    for time in times:
        divisor = Fraction(
            math.gcd(divisor.numerator * time.denominator, time.numerator * divisor.denominator),
            divisor.denominator * time.denominator,
        )
    return divisor


def _number(value: object) -> float:
    """A value that an FMU declares: a number, where a block of Python may give a function."""
    assert isinstance(value, (int, float))
    return float(value)


def _begun(function: Callable[..., object], given: Mapping[str, object]) -> Any:
    """What a stepper's function makes; each run has values of its own."""
    return function(**{name: _plain_value(value) for name, value in given.items()})


def _plain_value(value: object) -> object:
    """A parameter's value for a stepper: a plain number or text, or an array of its own."""
    if isinstance(value, np.ndarray):
        return value.copy() if value.shape else float(value)
    return value


def _floats(value: Any) -> list[float]:
    return np.ravel(value).astype(float).tolist()  # type: ignore[no-any-return]
