"""What is computed at ticks that coincide: which rates may tick together, and the stages of their outputs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from ..text.errors import Fault, ModelError
from .plan import Node, Plan, Program, Rate, Reference
from .scheduler import components, schedule

__all__ = ["coinciding", "stages_of", "tick_program"]


def tick_program(plan: Plan, slots: Sequence[int]) -> Program:
    """The program that computes the sampled outputs at these places in d, which are due. Raises ModelError (E102)."""
    return schedule(plan, [Reference("d", slot) for slot in slots], due=frozenset(slots))


def stages_of(plan: Plan, rates: frozenset[int]) -> tuple[frozenset[int], ...]:
    """The sampled outputs of the rates that tick together, as places in d, in the order in which they are computed.

    An output that needs another one at once is in the same stage or a later one; one that depends on it through a
    side, or through what events reset, is in a later one, so that the events in between come first. A stepper is
    listed as -1 - its number, after its inputs and before all that reads its outputs. Raises ModelError (E102) where
    a stepper needs itself.
    """
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
        dependencies: tuple[set[int], set[int]] = (set(), set())
        waiting = [(reference, False) for reference in begin]
        known = set(waiting)
        while waiting:
            reference, late = waiting.pop()
            row, index = reference
            nodes: list[tuple[Node, bool]] = []
            if row == "w":
                nodes = [(plan.outputs[index], late)]
            elif row == "d" and (index in due or index in given_by):
                dependencies[late].add(given_by[index] if index in given_by else int(index))
            else:
                nodes = [(node, True) for node in changed_by.get(reference, ())]
            for node, flag in nodes:
                reached = [(other, flag) for other in plan.bind(node)]
                if node.instance in units:  # its inputs at an instant may change all its outputs by an event
                    reached += [(other, True) for other in units[node.instance].inputs]
                for pair in reached:
                    if pair not in known:
                        known.add(pair)
                        waiting.append(pair)
        return dependencies

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


def coinciding(rates: Sequence[Rate]) -> Iterable[frozenset[int]]:
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
