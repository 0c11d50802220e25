"""The order of computation at ticks that coincide: which rates may tick together, and the stages of their outputs.

Both engines take their stages from here: `rate_sets` and `sequence_of`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..text.errors import Fault, ModelError
from .fmu_tape import FmuTape
from .plan import AlgebraicLoop, ForeignPart, Node, Plan, Program, Rate, Reference
from .scheduler import components, schedule


def tick_program(plan: Plan, slots: Sequence[int]) -> Program:
    """The program that computes the sampled outputs at these places in d, which are due. Raises ModelError (E102)."""
    return schedule(plan, [Reference("d", slot) for slot in slots], due=frozenset(slots))


def stages_of(plan: Plan, rates: frozenset[int]) -> tuple[frozenset[int], ...]:
    """Return the sampled outputs of the rates that tick together, as places in d, in the order of their computation.

    An output that needs another one at once is in the same stage or a later one; one that depends on it through a
    side, through what events reset, or because it is switched on or off by it, is in a later one, so that the events in
    between come first. So is one that reads an output of a part that may be off while the reader is on: it reads the
    held value. A stepper is listed as -1 - its number, after its inputs and before all that reads its outputs.
    Memory breaks circles: inside of one, only what is needed at once counts. Raises ModelError (E102) where a stepper
    needs itself, or where a loop that must be solved passes the edge of an enabled part.
    """
    needs = _Needs(plan, rates)
    if needs.is_flat:
        return (needs.due,)
    stage: dict[int, int] = {}
    for group in needs.groups:
        earliest, circle = 0, set(group)
        for key in group:
            for late in (0, 1):
                for other in needs.of[key][late] - circle:
                    earliest = max(earliest, stage[other] + (1 if late or needs.is_apart(key, other) else 0))
        inside = {key: sorted(needs.of[key][0] & circle) for key in group}
        for loop in components(inside):
            needs.check_loop(loop, inside)
            first = earliest
            for key in loop:
                for other in set(inside[key]) - set(loop):
                    first = max(first, stage[other] + (1 if needs.is_apart(key, other) else 0))
            stage.update(dict.fromkeys(loop, first))
    return tuple(frozenset(key for key in stage if stage[key] == n) for n in range(max(stage.values()) + 1))


class _Needs:
    """The dependencies among the sampled outputs and steppers of rates that tick together.

    of: by key, the keys that are needed at once, and the keys that are seen through memory: through sides, through
    resets, and through the sides that enable a part. groups: keys in a circle, each group after the ones it needs.
    """

    def __init__(self, plan: Plan, rates: frozenset[int], *, has_units: bool = False) -> None:
        self.plan = plan
        self.due = frozenset(slot for k in rates for _, slot in plan.rates[k].outputs)
        self.steppers = {-1 - n: part for n, part in enumerate(plan.steppers) if part.rate in rates}
        self.given_by = {s: key for key, part in self.steppers.items() for _, slots, _ in part.outputs for s in slots}
        self.units = {part.instance: part for part in plan.foreign}
        self.unit_keys = {part.instance: unit_key(plan, k) for k, part in enumerate(plan.foreign) if has_units}
        self.changed_by: dict[Reference, list[Node | Reference]] = {}
        for cause in (*plan.crossings, *plan.events):
            for node, reference in cause.resets:
                self.changed_by.setdefault(reference, []).extend((cause.node, node, *self.gate(cause.instance)))
        for j, cause in enumerate(plan.crossings):
            self.changed_by[Reference("s", j)] = [cause.node, *self.gate(cause.instance)]
        for part in plan.enabled:
            for reference in part.resets:
                self.changed_by.setdefault(reference, []).append(Reference("s", part.side))
        is_alone = len(self.due) < 2 or not (self.changed_by or plan.foreign)
        self.is_flat = is_alone and not (self.steppers or self.unit_keys)
        self.of: dict[int, tuple[set[int], set[int]]] = {}
        if self.is_flat:
            return
        for slot in sorted(self.due):
            node = plan.held_nodes[slot][0]
            self.of[slot] = self.seen([*plan.bind(node), *self.gate(node.instance)])
        for key, stepper in self.steppers.items():
            read = [reference for _, references, _ in stepper.inputs for reference in references]
            self.of[key] = self.seen([*read, *self.gate(stepper.instance)])

    @cached_property
    def groups(self) -> list[list[int]]:
        return components({key: [*direct, *late] for key, (direct, late) in self.of.items()})

    def gate(self, instance: int) -> list[Reference]:
        """The side that says whether an instance is on, if it may be off."""
        condition = self.plan.instances[instance].condition
        return [] if condition is None else [Reference("s", condition)]

    def seen(self, begin: Iterable[Reference]) -> tuple[set[int], set[int]]:
        """The due outputs and steppers that are needed at once, and those that are seen through memory."""
        dependencies: tuple[set[int], set[int]] = (set(), set())
        waiting = [(reference, False) for reference in begin]
        known = set(waiting)
        while waiting:
            reference, late = waiting.pop()
            row, index = reference
            read: list[tuple[Node | Reference, bool]] = []
            if row == "w":
                read = [(self.plan.outputs[index], late)]
            elif row == "d" and (index in self.due or index in self.given_by):
                dependencies[late].add(self.given_by.get(index, int(index)))
            else:
                read = [(item, True) for item in self.changed_by.get(reference, ())]
            for item, flag in read:
                reached = [(other, flag) for other in (self.plan.bind(item) if isinstance(item, Node) else (item,))]
                if isinstance(item, Node) and item.instance in self.unit_keys:
                    dependencies[True].add(self.unit_keys[item.instance])
                elif isinstance(item, Node) and item.instance in self.units:
                    # Its inputs at an instant may change all its outputs by an event.
                    reached += [(other, True) for other in self.units[item.instance].inputs]
                for pair in reached:
                    if pair not in known:
                        known.add(pair)
                        waiting.append(pair)
        return dependencies

    def is_apart(self, key: int, other: int) -> bool:
        """Whether the other is read in memory: one is a program, or the other may be off while the reader is on."""
        return key < 0 or other < 0 or self.condition(other) not in (None, self.condition(key))

    def condition(self, key: int) -> int | None:
        return self.plan.instances[self.instance(key)].condition

    def instance(self, key: int) -> int:
        return self.steppers[key].instance if key < 0 else self.plan.held_nodes[key][0].instance

    def rate(self, key: int) -> int:
        return self.steppers[key].rate if key < 0 else self.plan.held_nodes[key][1]

    def check_loop(self, loop: Sequence[int], needs: Mapping[int, Sequence[int]]) -> None:
        """Refuse what need each other at once and cannot be solved for together. Raises ModelError (E102)."""
        if len(loop) == 1 and loop[0] not in needs[loop[0]]:
            return
        steppers = [key for key in loop if key < 0]
        if steppers:
            message = "its outputs reach its inputs at the same tick, and blocks cannot solve a loop through a stepper."
        elif len({self.condition(key) for key in loop}) > 1:
            message = "is in an algebraic loop at one tick that crosses the border of an enabled subdiagram."
        else:
            return
        path = self.plan.instances[self.instance(steppers[0] if steppers else loop[0])].path
        raise ModelError(Fault("E102", path, message, "Put a UnitDelay or a state into the loop."))


def unit_key(plan: Plan, number: int) -> int:
    """Return the key of an FMU for Model Exchange among those of sampled outputs and steppers."""
    return -1 - len(plan.steppers) - number


@dataclass(frozen=True, slots=True)
class UnitPlace:
    """The place of the time event of an FMU for Model Exchange in a sequence of stages.

    rates, units: what of a circle it comes before, though its inputs depend on it: rates, and other FMUs.
    """

    unit: int
    rates: frozenset[int] = frozenset()
    units: frozenset[int] = frozenset()


def sequence_of(plan: Plan, rates: frozenset[int]) -> tuple[frozenset[int] | UnitPlace, ...]:
    """Return `stages_of` these rates with the time events of all FMUs for Model Exchange in between.

    An event comes after what the inputs of the FMU depend on, and before what reads its outputs. In a circle it comes
    first. Inputs of which an FMU takes nothing but rates, by its declared dependencies, do not count in a circle.
    """
    stages = stages_of(plan, rates)
    if not plan.foreign:
        return stages
    needs = _Needs(plan, rates, has_units=True)
    stage = {key: n for n, members in enumerate(stages) for key in members}
    units = {unit_key(plan, k): part for k, part in enumerate(plan.foreign)}
    of, before = _needs_of_units(plan, needs, units)
    after: dict[int, int] = {}
    order = [key for group in components({key: sorted(needed) for key, needed in of.items()}) for key in group]
    for key in (key for key in order if key in units):
        after[key] = max((after[other] if other in units else stage[other] + 1 for other in of[key]), default=0)
    numbers = {unit_key(plan, k): k for k in range(len(plan.foreign))}
    sequence: list[frozenset[int] | UnitPlace] = []
    for n in range(len(stages) + 1):
        for key in (key for key in after if after[key] == n):
            late = before[key] - of[key]
            others = frozenset(numbers[other] for other in late if other in units)
            rates_after = frozenset(needs.rate(other) for other in late if other not in units)
            sequence.append(UnitPlace(numbers[key], rates_after, others))
        sequence += stages[n : n + 1]
    return tuple(sequence)


def _needs_of_units(
    plan: Plan, needs: _Needs, units: Mapping[int, ForeignPart]
) -> tuple[dict[int, set[int]], dict[int, set[int]]]:
    """Return what all rates and FMUs need before them, without circles of FMUs; and of FMUs alone what their inputs
    need, also in circles."""
    of: dict[int, set[int]] = {key: direct | late for key, (direct, late) in needs.of.items()}
    sampled: dict[int, set[int]] = {}
    for key, part in units.items():
        by_input = [set().union(*needs.seen([reference])) for reference in part.inputs]
        sampled[key] = set().union(*(by_input[k] for k in _sampled_inputs(plan, part)))
        of[key] = set().union(*by_input)

    def circles() -> dict[int, set[int]]:
        groups = components({key: sorted(needed) for key, needed in of.items()})
        return {key: set(group) for group in groups for key in group}

    circle = circles()
    for key in units:
        of[key] -= circle[key] - sampled[key]
    before, circle = {key: set(of[key]) for key in units}, circles()
    for key in units:  # first in its circle; then what is left of it are FMUs alone
        of[key] -= {other for other in circle[key] if other not in units}
    circle = circles()
    for key in units:
        of[key] -= circle[key]
    return of, before


def _sampled_inputs(plan: Plan, part: ForeignPart) -> set[int]:
    """The inputs of an FMU on which an output depends, or nothing: they are taken at its events."""
    tape = plan.instances[part.instance].tape
    variables = part.foreign.variables
    read: dict[bool, set[int]] = {True: set(), False: set()}
    for key, result in tape.results.items():
        is_output = result.role == "output" and variables[result.target].causality == "output"
        if is_output or result.role == "derivative":
            read[is_output].update(argument for arguments in tape.read_by[key] for argument in arguments)
    arguments = [argument for argument, *_ in tape.opaque.inputs] if isinstance(tape, FmuTape) else []
    return {k for k, argument in enumerate(arguments) if argument in read[True] or argument not in read[False]}


def sequence_at(
    plan: Plan, due: frozenset[int], sets: Sequence[frozenset[int]]
) -> tuple[frozenset[int] | UnitPlace, ...]:
    """Return what is computed where these rates are due, in order. sets: `rate_sets` of the plan."""
    keys = {slot for k in due for _, slot in plan.rates[k].outputs}
    keys.update(-1 - n for n, part in enumerate(plan.steppers) if part.rate in due)
    sequence = sequence_of(plan, next(rates for rates in sets if due <= rates))
    return tuple(item for item in (_restricted(item, keys) for item in sequence) if item)


def _restricted(item: frozenset[int] | UnitPlace, keys: set[int]) -> frozenset[int] | UnitPlace:
    return item if isinstance(item, UnitPlace) else item & keys


def rate_sets(plan: Plan) -> list[frozenset[int]]:
    """Return the sets of rates that have stages of their own, each before its supersets.

    Rates that are due are computed in the stages of the first set that has them all. One set serves its subsets, too,
    unless an algebraic loop or a circle through memory is another one if not all of its rates are due.
    """
    everything = frozenset(range(len(plan.rates)))
    if _can_tick(plan, everything) and not _is_split(plan, everything):
        return [everything]
    found: set[frozenset[int]] = set()
    for largest in coinciding(plan.rates):
        if not _is_split(plan, largest):
            found.add(largest)
            continue
        own = [largest]
        for rates in _subsets(plan, largest):
            if _has_loop(plan, largest) or sequence_at(plan, rates, own[::-1]) != sequence_of(plan, rates):
                own.append(rates)
        found.update(own)
    return sorted(found, key=lambda rates: (len(rates), sorted(rates)))


def _subsets(plan: Plan, largest: frozenset[int]) -> Iterable[frozenset[int]]:
    """The smaller sets of these rates that may be due, large ones first. A tick of 0.2 s is one of 0.1 s, too."""
    brings = {
        a: frozenset(
            b
            for b, other in ((b, plan.rates[b]) for b in largest)
            if other.offset <= rate.offset
            and rate.period % other.period == 0
            and (rate.offset - other.offset) % other.period == 0
        )
        for a, rate in ((a, plan.rates[a]) for a in largest)
    }
    closed: set[frozenset[int]] = {frozenset()}
    for rate in sorted(largest):
        closed |= {rates | brings[rate] for rates in closed}
    return sorted(closed - {frozenset(), largest}, key=lambda rates: (-len(rates), sorted(rates)))


def _can_tick(plan: Plan, rates: frozenset[int]) -> bool:
    try:
        stages_of(plan, rates)
        tick_program(plan, _slots(plan, rates))
    except ModelError:
        return False
    return True


def _slots(plan: Plan, rates: frozenset[int]) -> list[int]:
    """The places in d of the sampled outputs of these rates."""
    return sorted(slot for k in rates for _, slot in plan.rates[k].outputs)


def _is_split(plan: Plan, rates: frozenset[int]) -> bool:
    """Whether what is computed together is another set if not all of the rates are due."""
    if len(rates) < 2:
        return False
    needs = _Needs(plan, rates)
    circles = [] if needs.is_flat else [group for group in needs.groups if len({*map(needs.rate, group)}) > 1]
    return bool(circles) or _has_loop(plan, rates)


def _has_loop(plan: Plan, rates: frozenset[int]) -> bool:
    """Whether an algebraic loop passes a sampled output."""
    steps = tick_program(plan, _slots(plan, rates)).steps
    return any(r.row == "d" for step in steps if isinstance(step, AlgebraicLoop) for r in step.unknowns)


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
