"""The Plan: what is computed, in which order, from which memory. Modules below it know no blocks.

Memory is rows of numbers:

| row | what it holds | its index |
|---|---|---|
| x | states | place |
| d | discretes and held outputs | place |
| s | sides of crossings: 1 where the crossing's value is not negative | crossing |
| p | parameters | place |
| u | inputs of the diagram | element |
| h | histories: inputs of blocks as they were a delay ago | history |
| z | the last solutions of algebraic loops, where the next search begins | place; read where unknowns are given |
| w | unsampled outputs: shown by `Plan.outputs`, computed when they are read | place |
| c | tables, which never change | table |

A `Reference` is a row and an index; besides memory it may name the time, ("t", 0), the number of a rate's last tick,
("tick", rate), or a number itself, ("k", number). A `Node` is one element of one result of one instance (an equation's
element). A `Program` is the ordered list of what must be run to get some nodes; engines print programs as code.

This module has data and look-ups in it only. `scheduler` orders programs, `tick_stages` what is computed at a tick, and
`plan_builder` makes the Plan of a flat diagram.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ..contract.tape import Tape
from ..model.settings import MeasureSpec, RunSettings
from ..text.errors import Fault
from ..text.rich_output import Part, Shown
from ..text.units import OfUnits

if TYPE_CHECKING:
    from ..model.fmu_block import Foreign


class Reference(NamedTuple):
    """Where a value is read: a row, and the place in it; for "k" the number itself."""

    row: str
    index: Any


TICK = Reference("tick", 0)
"""The tick's number as an argument; the rate is that of the result."""
TIME = Reference("t", 0)


class Node(NamedTuple):
    """One element of one result of one instance: what an engine computes."""

    instance: int
    key: str
    element: int

    @property
    def result(self) -> tuple[str, int]:
        """The key and the element, the same for every instance of the type."""
        return self[1:]


class PlanInput(NamedTuple):
    """An input of the diagram: its name, shape, declared unit and type, and for each element the default in SI."""

    name: str
    shape: tuple[int, ...]
    unit: str
    type: str
    default: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Instance:
    """One block: its path, the tape of its type, and where each argument of the tape is in memory."""

    path: str
    tape: Tape
    arguments: tuple[Reference, ...]
    condition: int | None = None  # the side that says whether it is on, in an enabled subdiagram
    hidden: bool = False  # inserted at the edge of a subdiagram
    told_as: str = ""  # of a hidden instance: the name under which its events are reported; "" for none


@dataclass(frozen=True, slots=True)
class Rate:
    """Ticks at (offset + n * period) base steps, and what is computed at them."""

    period: int
    offset: int
    outputs: tuple[tuple[Node, int], ...]  # sampled outputs and the place in d that holds them
    nexts: tuple[tuple[Node, int], ...]  # discrete updates and their place in d


@dataclass(frozen=True, slots=True)
class Cause:
    """A crossing (with a direction) or an event time, and the resets that it fires: nodes and where they go."""

    instance: int
    name: str
    direction: str  # "up", "down", "both"; "" for an event time
    node: Node
    resets: tuple[tuple[Node, Reference], ...]


class Wait(NamedTuple):
    """A cause and the causes that it waits for, by number: crossings, then event times, then what is no cause."""

    cause: int
    needed: tuple[int, ...]


class FiringOrder(NamedTuple):
    """Which causes wait for which at an instant, by number: crossings, then event times.

    waits: each after those of what it waits for. beside: pairs of causes, the second of which reads memory that the
    first resets: if that one must wait and fires, so does the first. inner: the crossings that an algebraic loop finds
    with its solution.
    """

    waits: tuple[Wait, ...] = ()
    beside: tuple[tuple[int, int], ...] = ()
    inner: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class History:
    """One element of h: what `source` was `delay` seconds ago, and `before` where that is before the start.

    delay, before: places in p, or numbers ("k"); `Plan.delays` has their values. echoes: whether any history depends
    on it, so that a break in it may occur again a delay later.
    """

    name: str
    source: Reference
    delay: Reference
    before: Reference
    echoes: bool = True


class Delay(NamedTuple):
    """The numbers of a history: its delay in s, and its value before the start."""

    delay: float
    before: float
    echoes: bool


@dataclass(frozen=True, slots=True)
class StepperPart:
    """A program in plain Python: what makes it, the rate of its ticks, its inputs and outputs.

    inputs: by name, the references of the elements and the shape. outputs: by name, the places in d and the shape.
    types: of the outputs, in order.
    """

    path: str
    instance: int
    rate: int
    make: Callable[[], Any]
    inputs: tuple[tuple[str, tuple[Reference, ...], tuple[int, ...]], ...]
    outputs: tuple[tuple[str, tuple[int, ...], tuple[int, ...]], ...]
    types: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignPart:
    """An FMU for Model Exchange: where its states and inputs are, the crossings and the event time that it has.

    states: places in x, and inputs: references, both in the order of `Opaque`. parameters: by name, where those that
    can be set begin in p, and how many numbers each has. texts: values of those that are texts. optional: given values,
    in SI, of parameters without a value in the FMU. tunable: the parameters that a run may change. nominal: of the
    states, in SI. foreign: the archive, its description and how it is asked.
    """

    path: str
    instance: int
    states: tuple[int, ...]
    inputs: tuple[Reference, ...]
    crossings: tuple[int, ...]
    event: int
    parameters: tuple[tuple[str, int, int], ...]
    texts: tuple[tuple[str, str], ...]
    optional: tuple[tuple[str, tuple[float, ...]], ...]
    tunable: frozenset[str]
    nominal: tuple[float, ...]
    foreign: Foreign


@dataclass(frozen=True, slots=True)
class EnabledPart:
    """An enabled subdiagram: its side, the place in d of the time when it was turned off, and the instances in it.

    resets: the memory that begins anew when it is turned on; anew: the instances that have it.
    """

    path: str
    side: int
    time: int
    instances: frozenset[int]
    resets: tuple[Reference, ...]
    anew: frozenset[int]


@dataclass(frozen=True, slots=True)
class PlanSignal(OfUnits):
    """A named value that can be recorded or measured.

    units: in SI. declared: the units of its ports, in which plain numbers about it are meant.
    """

    name: str
    references: tuple[Reference, ...]
    shape: tuple[int, ...]
    units: tuple[str, ...]
    declared: tuple[str, ...]


class ProgramStep(NamedTuple):
    """Results of one instance that are computed together."""

    instance: int
    results: tuple[tuple[str, int], ...]

    @property
    def nodes(self) -> list[Node]:
        """The results as nodes."""
        return [Node(self.instance, key, element) for key, element in self.results]


@dataclass(frozen=True, slots=True)
class AlgebraicLoop:
    """Nodes that need each other: their values, the unknowns, are solved for together by Newton's method.

    parts: the tapes of values and exact partial derivatives, of one instance each. An unknown is the value of its node,
    or, where the node is a residual, what makes it 0.

    torn: the unknowns that are searched for, by their numbers. Where they are known, the others follow from the
    equations of their nodes in the order of `parts`; the torn ones come last, and give the residuals.
    """

    unknowns: tuple[Reference, ...]
    parts: tuple[LoopPart, ...]
    torn: tuple[int, ...]

    @property
    def steps(self) -> tuple[ProgramStep, ...]:
        return tuple(ProgramStep(part.instance, part.results) for part in self.parts)

    @property
    def nodes(self) -> list[Node]:
        """The results of all parts as nodes."""
        return [node for step in self.steps for node in step.nodes]

    @property
    def solved(self) -> tuple[int, ...]:
        """The numbers of all unknowns in the order in which the solution gives them: the torn ones, then the others."""
        others = (row for part in self.parts for row in part.rows if row not in self.torn)
        return (*self.torn, *others)

    def is_residual(self, plan: Plan, part: int, k: int) -> bool:
        """Whether result k of a part is a residual; the others are values of unknowns."""
        of = self.parts[part]
        return plan.instances[of.instance].tape.results[of.results[k][0]].role == "residual"


@dataclass(frozen=True, slots=True)
class LoopPart:
    """The nodes of one instance in a loop.

    rows: the unknown of each node. tape: its results are "value" and "partial". columns: for each argument of the
    partials, the unknown that it is.
    """

    instance: int
    results: tuple[tuple[str, int], ...]
    rows: tuple[int, ...]
    tape: Tape
    columns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Program:
    """Steps in order, what they compute on the way, and what is asked for at the end."""

    steps: tuple[ProgramStep | AlgebraicLoop, ...]
    made: Mapping[Node, Reference]  # nodes whose values later steps read, by the memory they stand for
    moved: Mapping[Reference, Reference]  # at the start: memory that is not filled yet, and where its value is
    results: tuple[Node | Reference, ...]

    @property
    def order(self) -> Iterable[ProgramStep]:
        """All steps, those in loops one by one."""
        for step in self.steps:
            yield from step.steps if isinstance(step, AlgebraicLoop) else (step,)


NOTHING = Program((), {}, {}, ())
"""The program that computes nothing."""


_OF_VALUES = frozenset({"time_scale", "delays"})
"""Cached properties that depend on the parameters or settings of a Plan."""


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """A diagram ready to run. Frozen: everything that changes during a run is in a Snapshot."""

    name: str
    instances: tuple[Instance, ...]
    states: tuple[str, ...]  # names of x
    discretes: tuple[str, ...]  # names of d
    nominal: tuple[float, ...]
    parameters: tuple[float, ...]  # values of p
    tables: tuple[tuple[float, ...], ...]  # values of c, each table in C order
    inputs: tuple[PlanInput, ...]
    x_start: tuple[Node | Reference, ...]
    d_start: tuple[Node | Reference, ...]
    s_start: tuple[Node | Reference, ...]
    derivatives: tuple[Node, ...]
    outputs: tuple[Node, ...]  # the nodes of w
    crossings: tuple[Cause, ...]
    events: tuple[Cause, ...]
    base: Fraction
    rates: tuple[Rate, ...]
    projections: tuple[tuple[Node, Reference], ...]  # what is replaced after each step, and where it goes
    histories: tuple[History, ...]  # what h holds
    enabled: tuple[EnabledPart, ...]
    steppers: tuple[StepperPart, ...]
    foreign: tuple[ForeignPart, ...]  # FMUs whose states are among x
    integers: Mapping[int, frozenset[float]]  # places in d of ints, and of enumerations with their members
    guesses: Mapping[Reference, float]  # where the search for an algebraic variable begins
    signals: Mapping[str, PlanSignal]
    log: tuple[str, ...]
    measures: tuple[MeasureSpec, ...]
    settings: RunSettings
    warnings: tuple[Fault, ...]
    ends: int | None = None  # the crossing that ends the run after an instant at which it is on its side
    # Derived from the parts above, once, for all who run the plan.
    starting: bool | frozenset[Reference] = field(default=True, compare=False, repr=False)
    """What is computed at the start: all memory, or all but the sides where these depend on themselves."""
    start: Program = field(default=NOTHING, compare=False, repr=False)  # all states, discretes and sides at the start
    continuous: Program = field(default=NOTHING, compare=False, repr=False)  # all but what is computed at ticks
    unknowns: tuple[Reference, ...] = field(default=(), compare=False, repr=False)
    """What is solved for at all times, in the order of z; each search begins at their last values."""
    corners: tuple[int, ...] = field(default=(), compare=False, repr=False)
    """Crossings that depend on what a loop solves for; first those of `inner_corners`."""
    inner_corners: tuple[int, ...] = field(default=(), compare=False, repr=False)
    """Those that a loop finds with its solution, as it reads their sides; FMUs wait for them."""
    firing: FiringOrder = field(default=FiringOrder(), compare=False, repr=False)
    """Which causes wait for which; of a diagram that is planned for one copy, `firing_order.order_of` says it."""
    guessed: tuple[int, ...] = field(default=(), compare=False, repr=False)
    """Places in d that are guessed at the start, as sides are: steps of what a loop solves for, which reads them."""
    folded: Any = field(default=None, compare=False, repr=False)
    """Of a diagram with copies: the plan of one copy, by which it is printed (`compile.folding`); else None."""
    written_out: Callable[[], Plan] | None = field(default=None, compare=False, repr=False)
    """Of such a one: the plan of the diagram written out, whose long tables are its own, once they are asked for."""
    outline: Callable[[Any], Iterator[Part]] | None = field(default=None, compare=False, repr=False)
    """Gives the summary for a reader, if the plan was made for one; `compile.plan_summary` makes it."""

    def with_values(self, parameters: tuple[float, ...], settings: RunSettings) -> Plan:
        """Return this plan with other values of p, and other times and tolerances; what was derived stays derived."""
        plan = object.__new__(Plan)
        own, read_by_all = vars(plan), {"recorded": self.recorded, "columns": self.columns}
        own.update(vars(self), **read_by_all, parameters=parameters, settings=settings)
        for name in _OF_VALUES & own.keys():
            del own[name]
        return plan

    def tick_time(self, count: int) -> float:
        """The time of a base step, correctly rounded: Python divides integers exactly."""
        return (count * self.base.numerator) / self.base.denominator

    @cached_property
    def time_scale(self) -> float:
        """The size of the times that others are computed from, whose rounding errors these carry along near 0."""
        return max([abs(float(self.settings.start)), *(one.delay for one in self.delays)])

    @cached_property
    def delays(self) -> tuple[Delay, ...]:
        """The numbers of each history, with the parameters of this Plan."""
        p = self.parameters

        def number(reference: Reference) -> float:
            return float(p[reference.index] if reference.row == "p" else reference.index)

        return tuple(Delay(number(one.delay), number(one.before), one.echoes) for one in self.histories)

    @cached_property
    def columns(self) -> tuple[Reference, ...]:
        """The elements of the recorded signals, in their order."""
        return tuple(reference for name in self.log for reference in self.signal(name).references)

    @cached_property
    def recorded(self) -> Mapping[str, tuple[int, tuple[int, ...], str]]:
        """Where each recorded signal is among the columns: the first of them, its shape and its unit."""
        return recorded_in(self)

    @cached_property
    def unknowns_at(self) -> Mapping[Reference, int]:
        """The place in z of each unknown."""
        return {reference: k for k, reference in enumerate(self.unknowns)}

    @cached_property
    def table_places(self) -> list[range]:
        """The places of each table in the row c of printed code, where all copies share the tables of one copy."""
        if self.folded is not None:
            one, of_one = self.folded.plan.table_places, self.folded.of_one
            return [one[of_one(Reference("c", k)).index] for k in range(len(self.tables))]
        ends = accumulate(map(len, self.tables))
        return [range(end - len(table), end) for table, end in zip(self.tables, ends, strict=True)]

    @cached_property
    def foreign_crossings(self) -> frozenset[int]:
        """The crossings that are event indicators of FMUs."""
        return frozenset(j for part in self.foreign for j in part.crossings)

    @cached_property
    def foreign_of(self) -> dict[int, int]:
        """The number of each instance that is an FMU."""
        return {part.instance: k for k, part in enumerate(self.foreign)}

    @cached_property
    def held_nodes(self) -> dict[int, tuple[Node, int]]:
        """For each place in d that holds a sampled output: its node and its rate."""
        return {slot: (node, k) for k, rate in enumerate(self.rates) for node, slot in rate.outputs}

    @cached_property
    def rate_of(self) -> dict[Node, int]:
        """The rate of each sampled node."""
        return {node: k for k, rate in enumerate(self.rates) for node, _ in (*rate.outputs, *rate.nexts)}

    @cached_property
    def rate_labels(self) -> dict[str, str]:
        """How often each sampled block and signal is computed, by its name: "0.1 s"."""
        labels: dict[str, str] = {}
        for rate in self.rates:
            offset = f" + {self.tick_time(rate.offset):g} s" if rate.offset else ""
            label = f"{self.tick_time(rate.period):g} s{offset}"
            for node, _ in (*rate.outputs, *rate.nexts):
                labels[self.instances[node.instance].path] = label
        return labels

    def parts(self) -> Iterator[Part]:
        """What `check` shows."""
        return iter([f"<Plan of {self.name}>"]) if self.outline is None else self.outline(self)

    def signal(self, name: str) -> PlanSignal:
        """A signal by name or element ("z[0]"); the name must exist."""
        if name in self.signals:
            return self.signals[name]
        base, _, index = name.rpartition("[")
        whole = self.signals[base]
        row = math.prod(whole.shape[1:])
        k = slice(int(index[:-1]) * row, (int(index[:-1]) + 1) * row)
        return PlanSignal(name, whole.references[k], whole.shape[1:], whole.units[k], whole.declared[k])

    def node_name(self, node: Node) -> str:
        """The name of a node in messages: block.variable, with the element of an array."""
        instance, key, element = node
        target = self.instances[instance].tape.results[key]
        many = len(target.nodes) > 1
        return f"{self.instances[instance].path}.{target.target}" + (f"[{element}]" if many else "")

    def bind(self, node: Node) -> list[Reference]:
        """The memory that a node reads."""
        instance, key, element = node
        block = self.instances[instance]
        references = [block.arguments[k] for k in block.tape.read_by[key][element]]
        if TICK in references:
            tick = Reference("tick", self.rate_of[node])
            references = [tick if reference is TICK else reference for reference in references]
        return references


class _Recording(Protocol):
    """A Plan or a Coupling, as far as it tells what is recorded."""

    @property
    def log(self) -> tuple[str, ...]: ...

    def signal(self, name: str) -> PlanSignal: ...


def recorded_in(what: _Recording) -> dict[str, tuple[int, tuple[int, ...], str]]:
    """Return what `Plan.recorded` says of a Plan or of a Coupling."""
    columns, first = {}, 0
    for name in what.log:
        signal = what.signal(name)
        columns[name] = (first, signal.shape, signal.unit)
        first += len(signal.references)
    return columns
