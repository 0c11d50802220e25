"""The order in which a Plan's nodes are computed: programs, algebraic loops, nodes that need each other.

`schedule` gives the `Program` of some results: each node after those that it needs, and nodes that need each other as
one `AlgebraicLoop`, which is solved.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TypeVar

from ..contract.tape import Result, Tape
from ..contract.tracing import jacobian
from ..text.errors import Fault, ModelError
from .fmu_tape import FmuTape, asked
from .plan import AlgebraicLoop, LoopPart, Node, Plan, Program, ProgramStep, Reference
from .tearing import stages

Key = TypeVar("Key")


def schedule(
    plan: Plan,
    results: Sequence[Node | Reference],
    *,
    start: bool | frozenset[Reference] = False,
    due: frozenset[int] = frozenset(),
    given: bool = False,
) -> Program:
    """The program that computes `results`.

    start: states, discretes and sides are not memory yet but computed too, all or these. due: the places in d of the
    sampled outputs that are computed now. given: unknowns of loops are read from z, not solved for. Programs that the
    plan has already are not ordered again. Raises ModelError (E102, E120) where something needs itself.
    """
    wanted = tuple(results)
    plan = plan.written_out() if plan.written_out is not None else plan
    if not due and not given and start in (False, plan.starting):
        ordered = plan.start if start else plan.continuous
        if ordered.results == wanted:
            return ordered
    return _Scheduler(plan, start, due, plan.unknowns_at if given else {}).program(wanted)


class _Scheduler:
    """Orders nodes so that each comes after what it needs, with results of one instance together where possible."""

    def __init__(
        self, plan: Plan, start: bool | frozenset[Reference], due: frozenset[int], given: Mapping[Reference, int]
    ) -> None:
        self.plan, self.start, self.due, self.given = plan, start, due, given
        self.begun = {"x": plan.x_start, "d": plan.d_start, "s": plan.s_start} if start else {}

    def begins(self, reference: Reference) -> Node | Reference | None:
        """The start value of memory that is not filled yet, or the node of an output that is due now."""
        row, place = reference.row, reference.index
        if row in self.begun and (self.start is True or reference in self.start):  # type: ignore[operator]
            begins: Node | Reference = self.begun[row][place]
            return begins
        return self.plan.held_nodes[place][0] if row == "d" and place in self.due else None

    def program(self, results: tuple[Node | Reference, ...]) -> Program:
        outputs, instances = self.plan.outputs, self.plan.instances
        needs: dict[Node, list[Node]] = {}
        memory_of: dict[Node, Reference] = {}
        moved: dict[Reference, Reference] = {}
        stack: list[Node] = []
        computed = {"w", *self.begun, *("d" if self.due else "")}  # the rows that may have to be computed

        def ask(reference: Reference) -> None:
            """Put the node that computes a place of memory on the stack, unless memory has its value."""
            if reference in self.given:
                moved[reference] = Reference("z", self.given[reference])
                return
            source = outputs[reference.index] if reference.row == "w" else self.begins(reference)
            if isinstance(source, Node):
                memory_of[source] = reference
                stack.append(source)
            elif source is not None:  # at the start, memory that begins at a parameter or a number is read there
                moved[reference] = source

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
        return Program(tuple(self.steps(needs, memory_of)), memory_of, moved, results)

    def steps(
        self, needs: Mapping[Node, list[Node]], memory_of: Mapping[Node, Reference]
    ) -> list[ProgramStep | AlgebraicLoop]:
        # Few diagrams have loops, and those without one are ordered in half the time.
        steps = None if self.plan.guesses else self.ordered(needs, memory_of, [])
        if steps is None:
            loops = [group for group in components(needs) if len(group) > 1 or self.is_loop(group[0], needs)]
            steps = self.ordered(needs, memory_of, loops)
        assert steps is not None
        return steps

    def ordered(
        self, needs: Mapping[Node, list[Node]], memory_of: Mapping[Node, Reference], loops: list[list[Node]]
    ) -> list[ProgramStep | AlgebraicLoop] | None:
        """The steps in order, each loop as one; None where there are other loops than these."""
        loop_of = {node: k for k, group in enumerate(loops) for node in group}
        users: dict[Node, list[Node]] = {node: [] for node in needs}
        for node, before in needs.items():
            for other in before:
                users[other].append(node)
        # A loop waits for what its nodes need from outside; then all of its nodes are known together.
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
        steps: list[ProgramStep | AlgebraicLoop] = []
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
                steps.append(self.solved(group, needs, memory_of))
            else:
                steps += self.grouped(group)
        if any(waiting.values()):
            return None
        for instance in sorted(last):
            steps += self.grouped(last[instance])
        return steps

    def grouped(self, group: list[Node]) -> Sequence[ProgramStep]:
        """One step for each rate in the group, its results in the order of the tape."""
        if len(group) == 1:
            (node,) = group
            return (ProgramStep(node.instance, ((node.key, node.element),)),)
        rate_of, by_rate = self.plan.rate_of, dict[int, list[Node]]()
        for node in group:
            by_rate.setdefault(rate_of.get(node, -1), []).append(node)
        instance = group[0].instance
        order = self.plan.instances[instance].tape.order
        steps = []
        for rate in sorted(by_rate):
            results = sorted((node[1:] for node in by_rate[rate]), key=lambda result: (order[result[0]], result[1]))
            steps.append(ProgramStep(instance, tuple(results)))
        return steps

    def is_loop(self, node: Node, needs: Mapping[Node, list[Node]]) -> bool:
        """Whether a node alone must be solved for: it needs itself, or is a residual."""
        return node in needs[node] or self.result(node).role == "residual"

    def result(self, node: Node) -> Result:
        return self.plan.instances[node.instance].tape.results[node.key]

    def solved(
        self, group: Sequence[Node], needs: Mapping[Node, list[Node]], memory_of: Mapping[Node, Reference]
    ) -> AlgebraicLoop:
        """A loop as a system of equations. Raises ModelError (E102, E120) where it cannot or may not be solved."""
        plan, nodes = self.plan, sorted(group)
        number = {node: k for k, node in enumerate(nodes)}
        inside = {node: [other for other in needs[node] if other in number] for node in nodes}
        for node in nodes:
            result = self.result(node)
            if plan.instances[node.instance].tape.type_of(result.target) != "real" or result.role == "crossing":
                raise self.loop(inside, f"it goes through '{plan.node_name(node)}', which is not a real number")
        of_one_block = len({node.instance for node in nodes}) == 1
        has_residual = any(self.result(node).role == "residual" for node in nodes)
        if plan.settings.loops != "solve" and not (of_one_block and has_residual):
            raise self.loop(inside)
        unknowns = {memory_of[node]: k for k, node in enumerate(nodes)}
        parts = []
        stage = stages(inside, frozenset(node for node in nodes if self.result(node).role == "residual"))
        last = max(stage.values())
        ordered = sorted(nodes, key=lambda node: (stage[node], node))
        by_instance = [list(same) for _, same in groupby(ordered, key=lambda node: (stage[node], node.instance))]
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
        torn = tuple(k for k, node in enumerate(nodes) if stage[node] == last)
        return AlgebraicLoop(tuple(unknowns), tuple(parts), torn)

    def loop(self, needs: Mapping[Node, list[Node]], why: str = "") -> ModelError:
        """The error that shows a loop edge by edge."""
        cycle = _find_cycle(needs)
        names = [self.plan.node_name(node) for node in reversed(cycle)]
        chain = " -> ".join([*names, names[0]])
        if self.start:
            message = f"the value at start depends on itself: {chain}."
            cure = "Put a UnitDelay or a state between them, or give one of them a start value."
            return ModelError(Fault("E120", names[0], message, cure))
        place = self.plan.instances[cycle[0].instance].path
        if why:
            message = f"algebraic loop: {chain}; {why}."
            return ModelError(Fault("E102", place, message, "Put a UnitDelay or a state into it."))
        cure = 'Put a UnitDelay or a state into it, or set "loops": "solve" in "run".'
        return ModelError(Fault("E102", place, f"algebraic loop: {chain}.", cure))


def _partials(tape: Tape, results: Sequence[tuple[str, int]], arguments: tuple[int, ...]) -> Tape:
    return asked(tape, results, arguments) if isinstance(tape, FmuTape) else jacobian(tape, results, arguments)


def components(needs: Mapping[Key, Sequence[Key]]) -> list[list[Key]]:
    """The sets of nodes that need each other, each after those that it needs (Tarjan 1972, without recursion)."""
    index: dict[Key, int] = {}
    low: dict[Key, int] = {}
    waiting: list[Key] = []
    open_: set[Key] = set()
    groups: list[list[Key]] = []
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
                    group: list[Key] = []
                    while not group or group[-1] != node:
                        group.append(waiting.pop())
                        open_.discard(group[-1])
                    groups.append(group)
    return groups


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
