"""Which crossings and events of an instant wait for which: those that see a side wait until it is right.

A saturation shows u with the side "below the limit" until its crossing has fired, also where u has jumped beyond the
limit. What reads such a value too early sees a value that the signal never has. So a cause (a crossing or an event
time) waits while a crossing changes whose side it sees, by itself or in its resets:

    cause --> outputs that it depends on at one time --> sides, and memory that serves as one, that these read

The index of a table and the state of a relay are such memory: discretes that an output reads and that the crossings of
the block judge by as well as reset, or that the output reads beside the input that these judge. A state or a count that
events reset is none: it has its value from before until they fire.

Causes that see each other's sides fire at once, as the corners of an algebraic loop do. An algebraic loop is a part of
this order: it waits for the sides that its equations see, and what sees its solution waits with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

from .fmu_tape import FmuTape
from .folding import Folded
from .plan import AlgebraicLoop, Cause, EnabledPart, Instance, Node, Plan, Reference, Wait
from .scheduler import components

_GIVEN = frozenset("spck")  # rows that no crossing judges: sides, parameters, tables, numbers


class Mark(NamedTuple):
    """Something that a cause sees. kind: "cause", "loop" or "gather"; lane: of which copy, -1: the reader's."""

    kind: str
    number: int
    lane: int = -1


class FiringOrder(NamedTuple):
    """waits: each after those of what it waits for. inner: crossings that an algebraic loop finds with its solution."""

    waits: tuple[Wait, ...]
    inner: tuple[int, ...]


class Marks:
    """What the outputs and causes of a Plan see. gathers: instances that show each copy another source."""

    def __init__(self, plan: Plan, loops: Sequence[AlgebraicLoop] = (), gathers: Iterable[int] = ()) -> None:
        self.plan, self.loops, self.gathers = plan, loops, frozenset(gathers)
        self.loop_of = {reference: k for k, loop in enumerate(loops) for reference in loop.unknowns}
        self.known: dict[int, frozenset[Mark]] = {}
        self.of_instance: dict[int, list[int]] = {}
        for j, cause in enumerate(plan.crossings):
            self.of_instance.setdefault(cause.instance, []).append(j)

    def of_cause(self, cause: Cause) -> frozenset[Mark]:
        """Return what the time or crossing of a cause sees, and its resets."""
        nodes = [cause.node, *(node for node, _ in cause.resets)]
        marks = self.of(reference for node in nodes for reference in self.plan.bind(node))
        if self.plan.instances[cause.instance].condition is not None:
            # Inside an enabled part: what fires when it is turned off fires with that.
            marks = frozenset(mark for mark in marks if not self._is_hidden(mark))
        return marks

    def of_turning_on(self, part: EnabledPart) -> Iterable[Mark]:
        """Return what a part sees when it is turned on: for its start values, and in events that it catches up with."""
        plan = self.plan
        starts = ((plan.x_start if row == "x" else plan.d_start)[place] for row, place in part.resets)
        late = (cause for cause in plan.events if cause.instance in part.instances)
        nodes = [*(start for start in starts if isinstance(start, Node)), *(n for c in late for n, _ in c.resets)]
        seen = self.of(reference for node in nodes for reference in plan.bind(node))
        return [mark for mark in seen if not (self._is_hidden(mark) or self._is_inside(mark))]

    def of_loop(self, loop: AlgebraicLoop) -> frozenset[Mark]:
        """Return what the equations of a loop see but its own unknowns."""
        marks: set[Mark] = set()
        rest: list[Reference] = []
        for node in loop.nodes:
            modes, read = self._read(node)
            marks |= modes
            rest += [reference for reference in read if reference not in loop.unknowns]
        return self.of(rest) | marks

    def of(self, references: Iterable[Reference]) -> frozenset[Mark]:
        """Return what values see."""
        marks: set[Mark] = set()
        for reference in references:
            row, index = reference
            lane = getattr(index, "lane", -1)
            if row == "s":
                marks.add(Mark("cause", int(index), lane))
            elif row == "w":
                own = self.of_output(int(index))
                marks |= own if lane < 0 else {mark._replace(lane=lane) if mark.lane < 0 else mark for mark in own}
        return frozenset(marks)

    def of_output(self, index: int) -> frozenset[Mark]:
        """Return what an output sees."""
        stack = [index]
        while stack:
            place = stack[-1]
            if place in self.known:
                stack.pop()
                continue
            node, reference = self.plan.outputs[place], Reference("w", place)
            if reference in self.loop_of:
                self.known[place] = frozenset({Mark("loop", self.loop_of[reference])})
            elif node.instance in self.gathers:
                self.known[place] = frozenset({Mark("gather", node.instance)})
            else:
                modes, rest = self._read(node)
                above = [int(other.index) for other in rest if other.row == "w" and int(other.index) not in self.known]
                if above:
                    stack += above
                    continue
                self.known[place] = self.of(rest) | modes
        return self.known[index]

    def _read(self, node: Node) -> tuple[set[Mark], list[Reference]]:
        """Return the sides that a node reads itself, and what else it reads that their crossings do not judge."""
        read = self.plan.bind(node)
        modes = {Mark("cause", int(index), getattr(index, "lane", -1)) for row, index in read if row == "s"}
        judged: set[Reference] = set()
        is_foreign = isinstance(self.plan.instances[node.instance].tape, FmuTape)
        for j in self.of_instance.get(node.instance, ()):
            cause, mark = self.plan.crossings[j], Mark("cause", j)
            judged_by = self.plan.bind(cause.node)
            targets = {target for _, target in cause.resets if target in read}
            given = {reference for reference in read if reference.row not in _GIVEN and reference not in targets}
            seen = given.intersection(judged_by)
            is_mode = mark in modes or any(seen or (to.row == "d" and to in judged_by) for to in targets)
            if is_mode or (is_foreign and any(reference.row in "wu" for reference in given)):
                modes.add(mark)
                judged |= seen
        return modes, [reference for reference in read if reference.row == "w" and reference not in judged]

    def _is_hidden(self, mark: Mark) -> bool:
        return mark.kind == "cause" and self._instance(mark).hidden

    def _is_inside(self, mark: Mark) -> bool:
        return mark.kind == "cause" and self._instance(mark).condition is not None

    def _instance(self, mark: Mark) -> Instance:
        return self.plan.instances[self.plan.crossings[mark.number].instance]


def firing_order(plan: Plan, loops: Sequence[AlgebraicLoop]) -> FiringOrder:
    """Find the order of a plan with these algebraic loops."""
    if not plan.crossings:
        return FiringOrder((), ())
    causes, marks = [*plan.crossings, *plan.events], Marks(plan, loops)
    first_event, first_loop = len(plan.crossings), len(causes)
    united = _united(plan)
    needs: dict[int, set[int]] = {}

    def add(number: int, seen: Iterable[Mark]) -> None:
        numbers = (first_loop + mark.number if mark.kind == "loop" else mark.number for mark in seen)
        needs.setdefault(united.get(number, number), set()).update(united.get(other, other) for other in numbers)

    for number, cause in enumerate(causes):
        add(number, marks.of_cause(cause))
    for k, loop in enumerate(loops):
        add(first_loop + k, marks.of_loop(loop))
    for part in plan.enabled:
        add(part.side, marks.of_turning_on(part))
    for unit in plan.foreign:
        add(first_event + unit.event, marks.of(unit.inputs))
    members: dict[int, list[int]] = {}
    for number in range(first_loop + len(loops)):
        members.setdefault(united.get(number, number), []).append(number)
    groups = components({number: sorted(needed) for number, needed in needs.items()})
    of_loops = (group for group in groups if any(unit >= first_loop for unit in group))
    inner = {number for group in of_loops for unit in group for number in members[unit] if number < first_event}
    waits = _waits(needs, groups, members, first_event)
    return FiringOrder(tuple(waits), tuple(sorted(inner - plan.foreign_crossings)))


def waits_of_copies(plan: Plan) -> tuple[Wait, ...]:
    """Find what waits for what in a plan that is known of one copy; it has no loops, FMUs or enabled parts."""
    folded: Folded = plan.folded
    one, gathers = folded.plan, folded.gathers
    marks, first_event = Marks(one, gathers=gathers), len(plan.crossings)
    sizes = accumulate(map(len, gathers.values()), initial=first_event + len(plan.events))
    begin = dict(zip(gathers, sizes, strict=False))

    def number(mark: Mark, reader: int) -> int:
        lane = reader if mark.lane < 0 else mark.lane
        if mark.kind == "gather":
            return begin[mark.number] + lane
        places = folded.places("s", mark.number)
        return places[lane if len(places) > 1 else 0]

    kinds = (("s", one.crossings, 0), ("e", one.events, first_event))
    seen = [(row, k, first, marks.of_cause(cause)) for row, causes, first in kinds for k, cause in enumerate(causes)]
    if not any(own for *_, own in seen):
        return ()
    needs: dict[int, set[int]] = {}
    for row, k, first, own in seen:
        for lane, place in enumerate(folded.places(row, k)):
            needs[first + place] = {number(mark, lane) for mark in own}
    for instance, sources in gathers.items():
        for lane, source in enumerate(sources):
            needs[begin[instance] + lane] = {number(mark, lane) for mark in marks.of([source])}
    groups = components({number: sorted(needed) for number, needed in needs.items()})
    return tuple(_waits(needs, groups, {number: (number,) for number in needs}, first_event))


def _waits(
    needs: Mapping[int, set[int]], groups: Iterable[Sequence[int]], members: Mapping[int, Sequence[int]], sides: int
) -> Iterator[Wait]:
    """Give each member of a unit what its unit waits for, and what those wait for that see each other with it.

    sides: the number of crossings. Only these change; others that wait for nothing are never waited for.
    """
    group_of: dict[int, Sequence[int]] = {}
    waiting: set[int] = set()
    for group in groups:
        group_of.update(dict.fromkeys(group, group))
        needed = set[int]().union(*(needs[unit] for unit in group)).difference(group)
        theirs = {unit for other in needed for unit in group_of[other]}
        numbers = (number for unit in theirs for number in members[unit])
        every = tuple(sorted(number for number in numbers if number < sides or number in waiting))
        if every:
            waiting.update(number for unit in group for number in members[unit])
            yield from (Wait(number, every) for unit in group for number in members[unit])


def _united(plan: Plan) -> dict[int, int]:
    """Return, for causes that fire as one, the first of them: those at the edge of a part, and those of an FMU."""
    united: dict[int, int] = {}
    edges: dict[frozenset[Reference], int] = {}
    for j, cause in enumerate(plan.crossings):
        if plan.instances[cause.instance].hidden and (read := frozenset(plan.bind(cause.node))):
            united[j] = edges.setdefault(read, j)
    for part in plan.foreign:
        own = (*part.crossings, len(plan.crossings) + part.event)
        united.update(dict.fromkeys(own, own[0]))
    return united
