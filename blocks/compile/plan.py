"""The Plan: what is computed, in which order, from which memory. Below it nobody knows a block.

Memory is rows of numbers:

| row | what it holds | its index |
|---|---|---|
| x | states | place |
| d | discretes and held outputs | place |
| s | sides of crossings: 1 where the crossing's value is not negative | crossing |
| p | parameters | place |
| u | inputs of the diagram | element |
| h | histories: inputs of blocks as they were a delay ago | history |
| z | the last solutions of algebraic loops, where the next search begins | place; no `Reference` names it |
| w | unsampled outputs: shown by `Plan.outputs`, computed when they are read | place |
| c | tables, which never change | table |

A `Reference` is a row and an index; besides memory it may name the time, ("t", 0), the number of a rate's last tick,
("tick", rate), or a number itself, ("k", number). A `Node` is one element of one result of one instance (an equation's
element). A `Program` is the ordered list of what must be run to get some nodes; engines print programs as code.
"""

from __future__ import annotations

import heapq
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ..contract.interface import Interface, Resolved, memory_start
from ..contract.tape import Result, Tape, jacobian
from ..model.flatten import BlockSource, Flat, FlatBlock, FlatSignal, InputSource, Source
from ..model.settings import MeasureSpec, RunSettings
from ..text.errors import Fault, ModelError
from ..text.gc_pause import paused
from .fmu_tape import asked
from .memory_layout import ROWS, Footprint, Start, names_of

__all__ = [
    "Cause",
    "ForeignPart",
    "History",
    "Instance",
    "Loop",
    "Node",
    "Plan",
    "PlanInput",
    "Program",
    "Rate",
    "Reference",
    "Signal",
    "Step",
    "components",
    "plan",
]


class Reference(NamedTuple):
    """Where a value is read: a row, and the place in it; of "k" the number itself."""

    row: str
    index: Any


class Node(NamedTuple):
    """One element of one result of one instance: what an engine computes."""

    instance: int
    key: str
    element: int

    @property
    def result(self) -> tuple[str, int]:
        """The key and the element: what the node is of every instance of its type."""
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
    """One block: its path, the tape of its type, and where each argument of the tape stands in memory."""

    path: str
    tape: Tape
    arguments: tuple[Reference, ...]
    condition: int | None = None  # the side that says whether it is on, in an enabled subdiagram
    hidden: bool = False  # put in at the edge of a subdiagram
    told_as: str = ""  # of a hidden instance: the name under which its events are told; "" for none


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


@dataclass(frozen=True, slots=True)
class History:
    """One element of h: what `source` was `delay` seconds ago, and `before` where that is before the start.

    echoes: whether any history comes to depend on it, so that what breaks in it may break again a delay later.
    """

    name: str
    source: Reference
    delay: float
    before: float
    echoes: bool = True


@dataclass(frozen=True, slots=True)
class StepperPart:
    """A program in plain Python: what makes it, the rate of its ticks, what it takes and what it gives.

    inputs: by name, the references of the elements and the shape. outputs: by name, the places in d and the shape.
    """

    path: str
    instance: int
    rate: int
    make: Callable[[], Any]
    inputs: tuple[tuple[str, tuple[Reference, ...], tuple[int, ...]], ...]
    outputs: tuple[tuple[str, tuple[int, ...], tuple[int, ...]], ...]


@dataclass(frozen=True, slots=True)
class ForeignPart:
    """An FMU for Model Exchange: where its states and inputs are, the crossings and the event time that it has.

    states: places in x, and inputs: references, both in the order of `Opaque`. parameters: by name, where those that
    can be set begin in p, and how many numbers each has. texts: values of those that are texts. optional: those, in SI,
    of which the FMU does not say what they are, and that are given.
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


@dataclass(frozen=True, slots=True)
class EnabledPart:
    """An enabled subdiagram: its side, the place in d of the time when it was turned off, and the instances in it.

    resets: what begins anew when it is turned on: places of memory; and of which instances.
    """

    path: str
    side: int
    time: int
    instances: frozenset[int]
    resets: tuple[Reference, ...]
    anew: frozenset[int]


@dataclass(frozen=True, slots=True)
class Signal:
    """A named value that can be recorded or measured."""

    name: str
    references: tuple[Reference, ...]
    shape: tuple[int, ...]
    units: tuple[str, ...]

    @property
    def unit(self) -> str:
        return self.units[0] if len(set(self.units)) == 1 else ""


class Step(NamedTuple):
    """Results of one instance that are computed together."""

    instance: int
    results: tuple[tuple[str, int], ...]

    @property
    def nodes(self) -> list[Node]:
        """The results as nodes."""
        return [Node(self.instance, key, element) for key, element in self.results]


@dataclass(frozen=True, slots=True)
class Loop:
    """Nodes that need each other: their values, the unknowns, are solved for together by Newton's method.

    parts: the tapes of values and exact partial derivatives, of one instance each. An unknown is what its node gives,
    or, where the node is a residual, what makes it 0.
    """

    unknowns: tuple[Reference, ...]
    parts: tuple[LoopPart, ...]

    @property
    def steps(self) -> tuple[Step, ...]:
        return tuple(Step(part.instance, part.results) for part in self.parts)

    @property
    def nodes(self) -> list[Node]:
        """The results of all parts as nodes."""
        return [node for step in self.steps for node in step.nodes]


@dataclass(frozen=True, slots=True)
class LoopPart:
    """The nodes of one instance in a loop.

    rows: the unknown that each node is for. tape: its results are "value" and "partial". columns: for each argument
    that is derived by, the unknown that it is.
    """

    instance: int
    results: tuple[tuple[str, int], ...]
    rows: tuple[int, ...]
    tape: Tape
    columns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Program:
    """Steps in order, what they make known on the way, and what is asked for at the end."""

    steps: tuple[Step | Loop, ...]
    made: Mapping[Node, Reference]  # nodes whose values later steps read, by the memory they stand for
    moved: Mapping[Reference, Reference]  # at the start: memory that is not filled yet, and where its value stands
    results: tuple[Node | Reference, ...]

    @property
    def order(self) -> Iterable[Step]:
        """All steps, those in loops one by one."""
        for step in self.steps:
            yield from step.steps if isinstance(step, Loop) else (step,)


@dataclass(frozen=True)
class Plan:
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
    signals: Mapping[str, Signal]
    log: tuple[str, ...]
    measures: tuple[MeasureSpec, ...]
    settings: RunSettings
    warnings: tuple[Fault, ...]

    def tick_time(self, count: int) -> float:
        """The time of a base step, correctly rounded: Python divides integers exactly."""
        return (count * self.base.numerator) / self.base.denominator

    def program(
        self,
        results: Sequence[Node | Reference],
        *,
        start: bool | frozenset[Reference] = False,
        due: frozenset[int] = frozenset(),
    ) -> Program:
        """What must be run to know `results`.

        start: states, discretes and sides are not memory yet but computed too, all or these. due: the places in d of
        the sampled outputs that are computed now. Raises ModelError (E102, E120) where something needs itself.
        """
        asked = (tuple(results), start, due)
        return self.checked.get(asked) or _Scheduler(self, start, due).program(asked[0])

    @cached_property
    def checked(self) -> dict[Any, Program]:
        """The programs that the check of the plan has made and that engines ask for again, by what was asked."""
        return {}

    def _check(self, results: Sequence[Node | Reference], *, start: bool | frozenset[Reference] = False) -> Program:
        made = self.checked[tuple(results), start, frozenset[int]()] = self.program(results, start=start)
        return made

    def stages(self, due: frozenset[int]) -> tuple[frozenset[int], ...]:
        """The sampled outputs of the rates that tick together, as places in d, in the order in which they are computed.

        An output that needs another one at once stands in its stage or a later one; one that sees another one through
        a side, or through what events reset, in a later one, so that the events in between come first. A stepper
        stands as -1 - its number, after all that it takes and before all that takes what it gives. Raises ModelError
        (E102) where a stepper needs itself.
        """
        return _staged(self, due)

    @cached_property
    def starting(self) -> bool | frozenset[Reference]:
        """What is computed at the start: all memory, or all but the sides where these need what they are of.

        Raises ModelError (E120) where a start value needs itself.
        """
        rows = (("x", len(self.states)), ("d", len(self.discretes)))
        memory: list[Node | Reference] = [Reference(row, i) for row, size in rows for i in range(size)]
        try:
            self._check([*memory, *self.s_start], start=True)
            return True
        except ModelError:
            known = frozenset(place for place in memory if isinstance(place, Reference))
            self._check([*memory, *self.s_start], start=known)
            return known

    @cached_property
    def unsampled(self) -> tuple[Node | Reference, ...]:
        """All results but those that are computed at ticks: what a run may ask for between them."""
        causes = (*self.crossings, *self.events)
        return (
            *self.derivatives,
            *(cause.node for cause in causes),
            *(node for cause in causes for node, _ in cause.resets),
            *(node for node, _ in self.projections),
            *(node for rate in self.rates for node, _ in rate.nexts),
            *(Reference("w", i) for i in range(len(self.outputs))),
        )

    @cached_property
    def unknowns(self) -> tuple[Reference, ...]:
        """What is solved for at all times, the places of z in order; their last values are where each search begins."""
        if not any(isinstance(step, Loop) for step in self.program(self.unsampled).steps):
            return ()
        steps = self.program([Reference("w", i) for i in range(len(self.outputs))]).steps
        return tuple(reference for step in steps if isinstance(step, Loop) for reference in step.unknowns)

    @cached_property
    def unknowns_at(self) -> Mapping[Reference, int]:
        """The place in z of each unknown."""
        return {reference: k for k, reference in enumerate(self.unknowns)}

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
        made: dict[str, str] = {}
        for rate in self.rates:
            offset = f" + {self.tick_time(rate.offset):g} s" if rate.offset else ""
            label = f"{self.tick_time(rate.period):g} s{offset}"
            for node, _ in (*rate.outputs, *rate.nexts):
                made[self.instances[node.instance].path] = label
        return made

    def signal(self, name: str) -> Signal:
        """A signal by name or element ("z[0]"); the name must exist."""
        if name in self.signals:
            return self.signals[name]
        base, _, index = name.rpartition("[")
        whole = self.signals[base]
        k = int(index[:-1])
        return Signal(name, (whole.references[k],), (), (whole.units[k],))

    def node_name(self, node: Node) -> str:
        """How a node is called in messages: block.variable, with the element of an array."""
        instance, key, element = node
        target = self.instances[instance].tape.results[key]
        many = len(target.nodes) > 1
        return f"{self.instances[instance].path}.{target.target}" + (f"[{element}]" if many else "")

    def bind(self, node: Node) -> list[Reference]:
        """The memory that a node reads."""
        instance, key, element = node
        made = self.instances[instance]
        found = [made.arguments[k] for k in made.tape.read_by[key][element]]
        if _TICK in found:
            tick = Reference("tick", self.rate_of[node])
            found = [tick if reference is _TICK else reference for reference in found]
        return found


_TICK = Reference("tick", 0)
"""The tick's number as an argument; which one it is, the rate of the result says."""
_TIME = Reference("t", 0)


class _Scheduler:
    """Orders nodes so that each comes after what it needs, with results of one instance together where possible."""

    def __init__(self, plan: Plan, start: bool | frozenset[Reference], due: frozenset[int]) -> None:
        self.plan, self.start, self.due = plan, start, due
        self.begun = {"x": plan.x_start, "d": plan.d_start, "s": plan.s_start} if start else {}

    def begins(self, reference: Reference) -> Node | Reference | None:
        """What memory that is not filled yet begins with, or the node of an output that is due now."""
        row, place = reference.row, reference.index
        if row in self.begun and (self.start is True or reference in self.start):  # type: ignore[operator]
            begins: Node | Reference = self.begun[row][place]
            return begins
        return self.plan.held_nodes[place][0] if row == "d" and place in self.due else None

    def program(self, results: tuple[Node | Reference, ...]) -> Program:
        outputs, instances = self.plan.outputs, self.plan.instances
        needs: dict[Node, list[Node]] = {}
        made: dict[Node, Reference] = {}
        moved: dict[Reference, Reference] = {}
        stack: list[Node] = []
        computed = {"w", *self.begun, *("d" if self.due else "")}  # the rows that may have to be computed

        def ask(reference: Reference) -> None:
            """Put the node that computes a place of memory on the stack, where memory does not have it already."""
            found = outputs[reference.index] if reference.row == "w" else self.begins(reference)
            if isinstance(found, Node):
                made[found] = reference
                stack.append(found)
            elif found is not None:  # at the start, memory that begins at a parameter or a number is read there
                moved[reference] = found

        for item in results:
            if isinstance(item, Node):
                stack.append(item)
            elif item.row in computed:
                ask(item)
        while stack:
            node = stack.pop()
            if node in needs:
                continue
            instance, depth = instances[node.instance], len(stack)
            arguments = instance.arguments
            for argument in instance.tape.fed_by[node.key][node.element]:
                reference = arguments[argument]
                if reference.row in computed:
                    ask(reference)
            needs[node] = stack[depth:]
        return Program(tuple(self.steps(needs, made)), made, moved, results)

    def steps(self, needs: Mapping[Node, list[Node]], made: Mapping[Node, Reference]) -> list[Step | Loop]:
        # Few diagrams have loops, and those without one are ordered in half the time.
        found = None if self.plan.guesses else self.ordered(needs, made, [])
        if found is None:
            loops = [group for group in components(needs) if len(group) > 1 or self.is_loop(group[0], needs)]
            found = self.ordered(needs, made, loops)
        assert found is not None
        return found

    def ordered(
        self, needs: Mapping[Node, list[Node]], made: Mapping[Node, Reference], loops: list[list[Node]]
    ) -> list[Step | Loop] | None:
        """The steps in order, each loop as one; None where there are other loops than these."""
        loop_of = {node: k for k, group in enumerate(loops) for node in group}
        users: dict[Node, list[Node]] = {node: [] for node in needs}
        for node, before in needs.items():
            for other in before:
                users[other].append(node)
        # A loop waits for what its nodes need from outside, and all of it is known at once.
        waiting: dict[Node | int, int] = {node: len(before) for node, before in needs.items() if node not in loop_of}
        for node, k in loop_of.items():
            waiting[k] = waiting.get(k, 0) + sum(1 for other in needs[node] if loop_of.get(other) != k)
        # What nobody waits for (derivatives, crossings) comes last, so that it is computed in one go per instance.
        # Sampled results of different rates stay apart, because each has its own tick number.
        last: dict[int, list[Node]] = {}
        for node in needs:
            if not users[node] and node not in loop_of:
                last.setdefault(node.instance, []).append(node)
                del waiting[node]
        ready: dict[tuple[int, int], list[Node]] = {}
        heap: list[tuple[int, int]] = []

        def offer(key: Node | int) -> None:
            if isinstance(key, int):
                place, nodes = (loops[key][0].instance, key), loops[key]
            else:
                place, nodes = (key.instance, -1), [key]
            if place not in ready:
                ready[place] = []
                heapq.heappush(heap, place)
            ready[place] += nodes

        for key in [key for key, count in waiting.items() if not count]:
            offer(key)
        steps: list[Step | Loop] = []
        while heap:
            place = heapq.heappop(heap)
            group = ready.pop(place)
            for node in group:
                for user in users[node]:
                    key = loop_of.get(user, user)
                    if key == place[1] or key not in waiting:
                        continue
                    waiting[key] -= 1
                    if not waiting[key]:
                        offer(key)  # of this instance too: what reads the group's results comes in a step of its own
            if place[1] >= 0:
                steps.append(self.solved(group, needs, made))
            else:
                steps += self.grouped(group)
        if any(waiting.values()):
            return None
        for instance in sorted(last):
            steps += self.grouped(last[instance])
        return steps

    def grouped(self, group: list[Node]) -> Sequence[Step]:
        """One step for each rate in the group, its results in the order of the tape."""
        if len(group) == 1:
            (node,) = group
            return (Step(node.instance, ((node.key, node.element),)),)
        rate_of, by_rate = self.plan.rate_of, dict[int, list[Node]]()
        for node in group:
            by_rate.setdefault(rate_of.get(node, -1), []).append(node)
        instance = group[0].instance
        order = self.plan.instances[instance].tape.order
        made = []
        for rate in sorted(by_rate):
            results = sorted((node[1:] for node in by_rate[rate]), key=lambda result: (order[result[0]], result[1]))
            made.append(Step(instance, tuple(results)))
        return made

    def is_loop(self, node: Node, needs: Mapping[Node, list[Node]]) -> bool:
        """Whether a node alone must be solved for: it needs itself, or is a residual."""
        return node in needs[node] or self.result(node).role == "residual"

    def result(self, node: Node) -> Result:
        return self.plan.instances[node.instance].tape.results[node.key]

    def solved(self, group: Sequence[Node], needs: Mapping[Node, list[Node]], made: Mapping[Node, Reference]) -> Loop:
        """A loop as a system of equations. Raises ModelError (E102, E120) where it cannot or must not be solved."""
        plan, nodes = self.plan, sorted(group)
        number = {node: k for k, node in enumerate(nodes)}
        inside = {node: [other for other in needs[node] if other in number] for node in nodes}
        for node in nodes:
            variable = plan.instances[node.instance].tape.interface.declaration.readable.get(self.result(node).target)
            if variable is None or variable.type != "real" or self.result(node).role == "crossing":
                raise self.loop(inside, f"it goes through '{plan.node_name(node)}', which is no real number")
        of_one_block = len({node.instance for node in nodes}) == 1
        has_residual = any(self.result(node).role == "residual" for node in nodes)
        if plan.settings.loops != "solve" and not (of_one_block and has_residual):
            raise self.loop(inside)
        unknowns = {made[node]: k for k, node in enumerate(nodes)}
        parts = []
        by_instance = [list(same) for _, same in groupby(nodes, key=lambda node: node.instance)]
        for step in (step for same in by_instance for step in self.grouped(same)):
            instance = plan.instances[step.instance]
            results = instance.tape.results
            read = {k for key, e in step.results for k in instance.tape.arguments_of(results[key].nodes[e])}
            arguments = [k for k in sorted(read) if instance.arguments[k] in unknowns]
            parts.append(
                LoopPart(
                    step.instance,
                    step.results,
                    tuple(number[node] for node in step.nodes),
                    _partials(instance.tape, step.results, tuple(arguments)),
                    tuple(unknowns[instance.arguments[k]] for k in arguments),
                )
            )
        return Loop(tuple(unknowns), tuple(parts))

    def loop(self, needs: Mapping[Node, list[Node]], why: str = "") -> ModelError:
        """The error that shows a loop edge by edge."""
        cycle = _find_cycle(needs)
        names = [self.plan.node_name(node) for node in reversed(cycle)]
        chain = " -> ".join([*names, names[0]])
        if self.start:
            message = f"the value at start depends on itself: {chain}."
            return ModelError(Fault("E120", names[0], message, "Give one of them a start value."))
        place = self.plan.instances[cycle[0].instance].path
        if why:
            message = f"algebraic loop: {chain}; {why}."
            return ModelError(Fault("E102", place, message, "Put a UnitDelay or a state into it."))
        cure = 'Put a UnitDelay or a state into it, or set "loops": "solve" in "run".'
        return ModelError(Fault("E102", place, f"algebraic loop: {chain}.", cure))


def _partials(tape: Tape, results: Sequence[tuple[str, int]], arguments: tuple[int, ...]) -> Tape:
    return jacobian(tape, results, arguments) if tape.opaque is None else asked(tape, results, arguments)


def components(needs: Mapping[Any, list[Any]]) -> list[list[Any]]:
    """The sets of nodes that need each other, each after those that it needs (Tarjan 1972, without recursion)."""
    index: dict[Any, int] = {}
    low: dict[Any, int] = {}
    waiting: list[Any] = []
    open_: set[Any] = set()
    found: list[list[Any]] = []
    for root in needs:
        if root in index:
            continue
        index[root] = low[root] = len(index)
        waiting.append(root)
        open_.add(root)
        stack = [(root, iter(needs[root]))]
        while stack:
            node, rest = stack[-1]
            for other in rest:
                if other not in index:
                    index[other] = low[other] = len(index)
                    waiting.append(other)
                    open_.add(other)
                    stack.append((other, iter(needs[other])))
                    break
                if other in open_:
                    low[node] = min(low[node], index[other])
            else:
                stack.pop()
                if stack:
                    low[stack[-1][0]] = min(low[stack[-1][0]], low[node])
                if low[node] == index[node]:
                    group: list[Any] = []
                    while not group or group[-1] != node:
                        group.append(waiting.pop())
                        open_.discard(group[-1])
                    found.append(group)
    return found


def _find_cycle(needs: Mapping[Node, list[Node]]) -> list[Node]:
    """Nodes that need each other in a circle, each needing the next."""
    state: dict[Node, int] = {}
    for root in needs:
        if root in state:
            continue
        path: list[Node] = []
        stack = [(root, iter(needs[root]))]
        state[root] = 1
        path.append(root)
        while stack:
            node, rest = stack[-1]
            for following in rest:
                if state.get(following) == 1:
                    return path[path.index(following) :]
                if following not in state:
                    state[following] = 1
                    path.append(following)
                    stack.append((following, iter(needs[following])))
                    break
            else:
                state[node] = 2
                path.pop()
                stack.pop()
    raise AssertionError("the nodes that could not be ordered have no cycle")


# --- building --------------------------------------------------------------------------------------------------


@paused()
def plan(flat: Flat) -> Plan:
    """The Plan of a flat diagram: memory laid out, types traced, loops found.

    Raises ModelError (E102 algebraic loop, E119 rates, E120 start) and DeclarationError (E407).
    """
    with flat.placing():
        return _Builder(flat).plan()


class _Memory:
    """Where everything stands: the footprint of each block, and where its places begin in each row."""

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
        """Where a source of a wire stands."""
        if isinstance(source, BlockSource):
            row, place = self.footprints[source.block].place[source.variable]
            return Reference(row, self.first[source.block][ROWS[row]] + place + source.element)
        return (
            Reference("u", source.element) if isinstance(source, InputSource) else Reference("k", float(source.value))
        )


class _Signals(Mapping[str, Signal]):
    """The signals of a diagram by name. They are many, and few are asked for: each is made when it is."""

    def __init__(self, signals: Mapping[str, FlatSignal], memory: _Memory) -> None:
        self._signals, self._memory = signals, memory

    def __getitem__(self, name: str) -> Signal:
        signal = self._signals[name]
        return Signal(name, tuple(map(self._memory.reference, signal.sources)), signal.shape, signal.units)

    def __contains__(self, name: object) -> bool:
        return name in self._signals

    def __iter__(self) -> Iterator[str]:
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)


_Numbers = tuple[list[float], list[tuple[float, ...]]]
"""What a block has in the rows p and c."""


class _Builder:
    def __init__(self, flat: Flat) -> None:
        self.flat = flat
        self.memory = _Memory()
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
                self.delays(block)
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
        made = Plan(
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
            _Signals(flat.signals, memory),
            flat.log,
            flat.measures,
            flat.settings,
            (*flat.warnings, *self.warnings()),
        )
        # Before the check, which leaves in the plan what runs ask for again (loops, what is computed at the start).
        made = replace(made, histories=tuple(_with_echoes(made)))
        _check_loops(made)
        return made

    def lay_out(self, index: int, block: FlatBlock) -> None:
        """Places in memory for everything of one block, and where its memory starts."""
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
        """The values of parameters and tables. Blocks that are alike share them."""
        interface, values = resolved.interface, resolved.values
        parameters = [x for name in interface.symbolic_parameters for x in _floats(values[name].value)]
        tables = [tuple(_floats(values[name].value)) for name in interface.tables]
        return self.numbers.setdefault(id(resolved), (parameters, tables))

    def start(self, index: int, resolved: Resolved, start: Start) -> Node | Reference:
        """What a place of memory begins with."""
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
        """Where the arguments of a block's tape stand."""
        first = self.memory.first[index]

        def outside(kind: str, place: Any) -> Reference:
            """Where an argument stands that is in no row of the block."""
            if kind == "input":
                variable, element = place
                return self.memory.reference(block.sources[variable][element])
            if kind == "tick":
                return _TICK
            return _TIME if block.time is None else Reference(*self.memory.place(block.time, "y"))

        # Most parts of a large plan are made here, by tuple's own constructor: a call of Reference takes twice as long.
        new, laid = tuple.__new__, self.memory.footprints[index].arguments
        return tuple(
            [new(Reference, (r, first[n] + place)) if n >= 0 else outside(r, place) for r, n, place in laid]
        )

    def steppers(self) -> tuple[StepperPart, ...]:
        made = []
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
            make = partial(declared.stepper.function, **{n: _plain_value(v) for n, v in given.items()})
            made.append(StepperPart(block.path, index, rate, make, tuple(inputs), tuple(outputs)))
        return tuple(made)

    def foreign_parts(self) -> tuple[ForeignPart, ...]:
        made = []
        for index, block in enumerate(self.flat.blocks):
            footprint, interface = self.memory.footprints[index], block.interface
            opaque = footprint.tape.opaque
            if opaque is None:
                continue
            if block.condition is not None or block.time is not None:
                message = "is an FMU for Model Exchange, which cannot stand still as an enabled subdiagram does."
                raise ModelError(Fault("E121", block.path, message, "Take it out of the subdiagram."))
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
            made.append(
                ForeignPart(
                    block.path,
                    index,
                    states,
                    inputs,
                    crossings,
                    event,
                    tuple(parameters),
                    tuple(texts),
                    tuple(optional),
                )
            )
        return tuple(made)

    def enabled_parts(self) -> tuple[EnabledPart, ...]:
        made, first = [], [*self.memory.first, self.memory.sizes]
        for part in self.flat.enabled:
            resets: list[Reference] = []
            for row in ("x", "d"):
                for index in sorted(part.resets):
                    resets += [Reference(row, k) for k in range(first[index][ROWS[row]], first[index + 1][ROWS[row]])]
            _, side = self.memory.place(part.enabled, "on")
            _, time = self.memory.place(part.time, "kept")
            made.append(
                EnabledPart(part.path, side, time, frozenset(part.members), tuple(resets), frozenset(part.resets))
            )
        return tuple(made)

    def causes(self, index: int) -> None:
        first, footprint = self.memory.first[index], self.memory.footprints[index]
        for laid, found in ((footprint.crossings, self.crossings), (footprint.events, self.events)):
            for cause in laid:
                resets = tuple(
                    (Node(index, *result), Reference(row, first[ROWS[row]] + place))
                    for result, (row, place) in cause.resets
                )
                found.append(Cause(index, cause.name, cause.direction, Node(index, *cause.result), resets))

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

    def delays(self, block: FlatBlock) -> None:
        """Histories in the order in which they were laid out."""
        d = block.interface.declaration
        for name, (delay, before) in block.resolved.delays.items():
            history = d.histories[name]
            names = names_of(f"{block.path}.{name}", len(before), block.interface.shape(history))
            for label, source, value in zip(names, block.sources[history.of.name], before, strict=True):
                self.histories.append(History(label, self.memory.reference(source), delay, float(value)))

    def rates(self) -> tuple[Fraction, tuple[Rate, ...]]:
        times = [time for clock in self.sampled for time in clock if time]
        base = _gcd(times) if times else Fraction(1)
        rates = tuple(
            Rate(int(period / base), int(offset / base), tuple(outputs), tuple(nexts))
            for (period, offset), (outputs, nexts) in self.sampled.items()
        )
        if any(max(rate.period, rate.offset) > 2**53 for rate in rates) or max(base.as_integer_ratio()) > 2**53:
            periods = ", ".join(f"{float(period)} s" for period, _ in self.sampled)
            message = f"ticks of {periods} have no common base that can be counted."
            cure = 'Round them to a common base, such as 1 us, or write them as fractions: "=1/3".'
            finest = max(self.sampled, key=lambda clock: max(time.denominator for time in clock))
            blocks = (block.path for block in self.flat.blocks if finest in block.resolved.clocks.values())
            raise ModelError(Fault("E119", next(blocks, self.flat.name), message, cure))
        return base, rates

    def warnings(self) -> Iterable[Fault]:
        """W102: variables that two causes reset, by different equations."""
        for block, footprint in zip(self.flat.blocks, self.memory.footprints, strict=True):
            for target, names in footprint.clashes.items():
                causes = " and ".join(f"'{name}'" for name in names)
                message = f"is reset by {causes}; where they fire at once, that of '{names[-1]}' wins."
                cure = "The reset that is declared later wins."
                yield self.flat.placed(Fault("W102", f"{block.path}.{target}", message, cure))


def _check_loops(plan: Plan) -> None:
    """Every loop that could occur in a run, found before it: at all times, at the start, at ticks that coincide."""
    plan._check(plan.unsampled)
    for part in plan.enabled:
        plan.program(part.resets, start=frozenset(part.resets))
    assert plan.starting is not False  # raises where a start value needs itself
    if not plan.rates:
        return
    everything = frozenset(range(len(plan.rates)))
    try:
        _tick_program(plan, everything)
        plan.stages(everything)
    except ModelError:
        # Rates that never coincide cannot close a loop; those that all meet in pairs meet together (remainders).
        for due in _coinciding(plan.rates):
            _tick_program(plan, due)
            plan.stages(due)


def _with_echoes(plan: Plan) -> Iterable[History]:
    """The histories, each with whether any of their sources depends on it, through equations or through memory."""
    if not plan.histories:
        return
    makes: dict[Reference, list[Node]] = {Reference("w", i): [node] for i, node in enumerate(plan.outputs)}
    for i, node in enumerate(plan.derivatives):
        makes.setdefault(Reference("x", i), []).append(node)
    for j, cause in enumerate(plan.crossings):
        makes.setdefault(Reference("s", j), []).append(cause.node)
    for cause in (*plan.crossings, *plan.events):
        for node, reference in cause.resets:
            makes.setdefault(reference, []).extend((cause.node, node))
    for rate in plan.rates:
        for node, slot in (*rate.outputs, *rate.nexts):
            makes.setdefault(Reference("d", slot), []).append(node)
    for node, reference in plan.projections:
        makes.setdefault(reference, []).append(node)
    inputs = {
        slot: [reference for _, references, _ in part.inputs for reference in references]
        for part in plan.steppers
        for _, slots, _ in part.outputs
        for slot in slots
    }
    known = {history.source for history in plan.histories}
    waiting = list(known)
    while waiting:
        reference = waiting.pop()
        read = [other for node in makes.get(reference, ()) for other in plan.bind(node)]
        read += inputs.get(reference.index, []) if reference.row == "d" else []
        for other in read:
            if other not in known:
                known.add(other)
                waiting.append(other)
    for i, history in enumerate(plan.histories):
        yield replace(history, echoes=Reference("h", i) in known)


def _tick_program(plan: Plan, due: frozenset[int]) -> Program:
    slots = [slot for k in sorted(due) for _, slot in plan.rates[k].outputs]
    return plan.program([Reference("d", slot) for slot in slots], due=frozenset(slots))


def _staged(plan: Plan, rates: frozenset[int]) -> tuple[frozenset[int], ...]:
    """The stages of sampled outputs and steppers; see Plan.stages."""
    due = frozenset(slot for k in rates for _, slot in plan.rates[k].outputs)
    steppers = {-1 - n: part for n, part in enumerate(plan.steppers) if part.rate in rates}
    given_by = {slot: key for key, part in steppers.items() for _, slots, _ in part.outputs for slot in slots}
    changed_by: dict[Reference, list[Node]] = {}
    for cause in (*plan.crossings, *plan.events):
        for node, reference in cause.resets:
            changed_by.setdefault(reference, []).extend((cause.node, node))
    changed_by.update((Reference("s", j), [cause.node]) for j, cause in enumerate(plan.crossings))
    if not steppers and (len(due) < 2 or not (changed_by or plan.foreign)):
        return (due,)
    units = {part.instance: part for part in plan.foreign}

    def seen(begin: Iterable[Reference]) -> tuple[set[int], set[int]]:
        """The due outputs and steppers that are needed at once, and those that are seen through memory."""
        found: tuple[set[int], set[int]] = (set(), set())
        waiting = [(reference, False) for reference in begin]
        known = set(waiting)
        while waiting:
            reference, late = waiting.pop()
            row, index = reference
            nodes: list[tuple[Node, bool]] = []
            if row == "w":
                nodes = [(plan.outputs[index], late)]
            elif row == "d" and (index in due or index in given_by):
                found[late].add(given_by[index] if index in given_by else int(index))
            else:
                nodes = [(node, True) for node in changed_by.get(reference, ())]
            for node, flag in nodes:
                reached = [(other, flag) for other in plan.bind(node)]
                if node.instance in units:  # what it is given at an instant may change all that it gives by an event
                    reached += [(other, True) for other in units[node.instance].inputs]
                for pair in reached:
                    if pair not in known:
                        known.add(pair)
                        waiting.append(pair)
        return found

    needs = {slot: seen(plan.bind(plan.held_nodes[slot][0])) for slot in sorted(due)}
    for key, part in steppers.items():
        needs[key] = seen(reference for _, references, _ in part.inputs for reference in references)
    for group in components({key: list(direct) for key, (direct, _) in needs.items()}):
        bad = [key for key in group if key < 0 and (len(group) > 1 or key in needs[key][0])]
        if bad:
            message = "its outputs come back to its inputs at one tick, and a stepper cannot be solved for."
            raise ModelError(Fault("E102", steppers[bad[0]].path, message, "Put a UnitDelay or a state in between."))
    # Memory breaks loops: outputs that see each other in a circle share a stage.
    stage: dict[int, int] = {}
    for group in components({key: [*direct, *late] for key, (direct, late) in needs.items()}):
        earliest = 0
        for key in group:
            for late in (0, 1):
                for other in needs[key][late] - set(group):
                    alone = key < 0 or other < 0 or late
                    earliest = max(earliest, stage[other] + (1 if alone else 0))
        stage.update(dict.fromkeys(group, earliest))
    return tuple(frozenset(key for key in stage if stage[key] == n) for n in range(max(stage.values()) + 1))


def _coinciding(rates: Sequence[Rate]) -> Iterable[frozenset[int]]:
    """The largest sets of rates that tick together at some time.

    References: C. Bron, J. Kerbosch, Algorithm 457: finding all cliques of an undirected graph, 1973.
    """
    meets = [
        {j for j, b in enumerate(rates) if j != i and (a.offset - b.offset) % math.gcd(a.period, b.period) == 0}
        for i, a in enumerate(rates)
    ]

    def extended(clique: set[int], open_: set[int], done: set[int]) -> Iterable[frozenset[int]]:
        if not open_ and not done:
            yield frozenset(clique)
        # Those that meet a pivot are found with it, or with one that does not meet it.
        pivot = max(open_ | done, key=lambda k: len(open_ & meets[k]), default=-1)
        for k in sorted(open_ - meets[pivot]) if pivot >= 0 else ():
            yield from extended({*clique, k}, open_ & meets[k], done & meets[k])
            open_, done = open_ - {k}, {*done, k}

    return extended(set(), set(range(len(rates))), set())


def _gcd(times: Iterable[Fraction]) -> Fraction:
    made = Fraction(0)
    for time in times:
        made = Fraction(
            math.gcd(made.numerator * time.denominator, time.numerator * made.denominator),
            made.denominator * time.denominator,
        )
    return made


def _plain_value(value: Any) -> Any:
    """A parameter's value for a stepper: a plain number or text, or an array of its own."""
    if isinstance(value, np.ndarray):
        return value.copy() if value.shape else float(value)
    return value


def _floats(value: Any) -> list[float]:
    return np.ravel(value).astype(float).tolist()  # type: ignore[no-any-return]
