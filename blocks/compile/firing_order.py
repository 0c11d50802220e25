"""Which crossings and events of an instant wait for which: those that see a side wait until it is right.

A saturation shows u with the side "below the limit" until its crossing has fired, also where u has jumped beyond the
limit. What reads such a value too early sees a value that the signal never has. So a cause (a crossing or an event
time) waits while a crossing changes whose side it sees, by itself or in its resets:

    cause --> outputs that it depends on at one time --> sides, and memory that serves as one, that these read

Such memory are discretes that crossings of their block reset to what follows from the signals that they judge, and from
memory: the state of a relay, the index of a table, a count. A discrete that takes another input, as a sample does, has
its value from before until it is reset, and so has every state.

In a circle, memory counts only if the crossings of its block judge by it, or an output reads it beside what they judge;
a count, for one, does not. Causes that see each other's sides even so fire at once, as the corners of an algebraic loop
do. An algebraic loop is a part of this order: it waits for the sides that its equations see, and what sees its solution
waits with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import cached_property
from typing import NamedTuple

from ..contract.closure import closure
from .fmu_tape import FmuTape
from .folding import Folded
from .plan import AlgebraicLoop, Cause, EnabledPart, FiringOrder, Instance, Node, Plan, Reference, Wait
from .scheduler import components

_OWN = frozenset({"parameter", "table", "state", "discrete", "held", "side"})  # arguments that are no signals


class Mark(NamedTuple):
    """Something that a cause sees. kind: "cause", "loop", "gather" or "output"; lane: of which copy, -1: the reader's.

    is_loose: whether it does not count in a circle.
    """

    kind: str
    number: int
    lane: int = -1
    is_loose: bool = False


MANY = 8
"""An output that sees more is a part of the order itself, so that it takes no n^2 places if n causes see n sides."""

_Needs = dict[int, set[tuple[int, bool]]]  # by cause or loop: what it sees, and whether that is loose


class _Walk:
    """The marks that values have by one rule, through outputs; each output is looked at once.

    rows: those in which a reference has marks by itself, which `direct` gives. look: the marks that an output has by
    itself, and the references that it reads. keep: what is remembered of an output with these marks.
    """

    def __init__(
        self,
        rows: str,
        direct: Callable[[Reference], set[Mark]],
        look: Callable[[int], tuple[set[Mark], Sequence[Reference]]],
        keep: Callable[[int, frozenset[Mark]], frozenset[Mark]] = lambda _, marks: marks,
    ) -> None:
        self.rows, self.direct, self.look, self.keep = rows, direct, look, keep
        self.known: dict[int, frozenset[Mark]] = {}

    def of(self, references: Iterable[Reference]) -> frozenset[Mark]:
        """Return the marks of values."""
        marks: set[Mark] = set()
        for reference in references:
            row, index = reference
            if row == "w":
                own: Set[Mark] = self.at(int(index))
            elif row in self.rows:
                own = self.direct(reference)
            else:
                continue
            lane = getattr(index, "lane", -1)
            marks |= own if lane < 0 else {mark._replace(lane=lane) if mark.lane < 0 else mark for mark in own}
        return frozenset(marks)

    def at(self, index: int) -> frozenset[Mark]:
        """Return the marks of an output."""
        stack = [index]
        while stack:
            place = stack[-1]
            if place in self.known:
                stack.pop()
                continue
            marks, read = self.look(place)
            above = [int(other.index) for other in read if other.row == "w" and int(other.index) not in self.known]
            if above:
                stack += above
                continue
            self.known[place] = self.keep(place, self.of(read) | marks)
        return self.known[index]


class Marks:
    """Find the marks of the outputs and causes of a Plan. gathers: instances that show each copy another source."""

    def __init__(self, plan: Plan, loops: Sequence[AlgebraicLoop] = (), gathers: Iterable[int] = ()) -> None:
        self.plan, self.loops, self.gathers = plan, loops, frozenset(gathers)
        self.loop_of = {reference: k for k, loop in enumerate(loops) for reference in loop.unknowns}
        self.seen = _Walk("s", lambda side: {Mark("cause", int(side.index))}, self._look, self._kept)
        self.written = _Walk("xd", self._writers_at, self._look_for_memory)
        self.shared: dict[int, frozenset[Mark]] = {}  # what outputs see that see much: others see these outputs
        self.order: dict[int, int] = {}  # the number of each of these
        self.memory: dict[int, set[Reference]] = {}  # what `_sides_of` gave
        self.of_instance: dict[int, list[int]] = {}
        for j, cause in enumerate(plan.crossings):
            self.of_instance.setdefault(cause.instance, []).append(j)

    def of_cause(self, cause: Cause) -> frozenset[Mark]:
        """Return what the time or crossing of a cause sees, and its resets."""
        nodes = [cause.node, *(node for node, _ in cause.resets)]
        marks = self.seen.of(reference for node in nodes for reference in self.plan.bind(node))
        if self.plan.instances[cause.instance].condition is not None:
            # Inside an enabled part: what fires when it is turned off fires with that.
            marks = frozenset(mark for mark in self._each(marks) if not self._is_hidden(mark))
        return marks

    def writers_of(self, cause: Cause) -> frozenset[Mark]:
        """Return the causes that reset memory that a cause or its resets read at one time, sides apart."""
        nodes = [cause.node, *(node for node, _ in cause.resets)]
        return self.written.of(reference for node in nodes for reference in self.plan.bind(node))

    def _writers_at(self, reference: Reference) -> set[Mark]:
        return {Mark("cause", number) for number in self.writers.get(reference, ())}

    def _look_for_memory(self, index: int) -> tuple[set[Mark], list[Reference]]:
        node, loop = self.plan.outputs[index], self.loop_of.get(Reference("w", index))
        if node.instance in self.gathers:
            return {Mark("gather", node.instance)}, []
        if loop is None:
            return set(), self.plan.bind(node)
        own = self.loops[loop].unknowns
        read = (reference for one in self.loops[loop].nodes for reference in self.plan.bind(one))
        return set(), [reference for reference in read if reference not in own]

    @cached_property
    def writers(self) -> dict[Reference, list[int]]:
        """Return the causes that reset each place in memory that does not count as a side."""
        writers: dict[Reference, list[int]] = {}
        for number, cause in enumerate((*self.plan.crossings, *self.plan.events)):
            sides = self._sides_of(number) if number < len(self.plan.crossings) else ()
            for _, target in cause.resets:
                if target not in sides:
                    writers.setdefault(target, []).append(number)
        return writers

    def of_turning_on(self, part: EnabledPart) -> Iterable[Mark]:
        """Return what a part sees when it is turned on: for its start values, and in events that it catches up with."""
        plan = self.plan
        starts = ((plan.x_start if row == "x" else plan.d_start)[place] for row, place in part.resets)
        late = (cause for cause in plan.events if cause.instance in part.instances)
        nodes = [*(start for start in starts if isinstance(start, Node)), *(n for c in late for n, _ in c.resets)]
        seen = self.seen.of(reference for node in nodes for reference in plan.bind(node))
        return [mark for mark in self._each(seen) if not (self._is_hidden(mark) or self._is_inside(mark))]

    def of_loop(self, loop: AlgebraicLoop) -> frozenset[Mark]:
        """Return what the equations of a loop see but its own unknowns."""
        marks: set[Mark] = set()
        rest: list[Reference] = []
        for node in loop.nodes:
            modes, read = self._read(node)
            marks |= modes
            rest += [reference for reference in read if reference not in loop.unknowns]
        return self.seen.of(rest) | marks

    def _look(self, index: int) -> tuple[set[Mark], list[Reference]]:
        node, loop = self.plan.outputs[index], self.loop_of.get(Reference("w", index))
        if loop is not None:
            return {Mark("loop", loop)}, []
        return ({Mark("gather", node.instance)}, []) if node.instance in self.gathers else self._read(node)

    def _kept(self, index: int, marks: frozenset[Mark]) -> frozenset[Mark]:
        if len(marks) <= MANY:
            return marks
        self.order[index], self.shared[index] = len(self.order), marks
        return frozenset({Mark("output", index)})

    def _each(self, marks: Iterable[Mark]) -> set[Mark]:
        """Return marks with what shared outputs see in place of these."""
        each, rest = set[Mark](), [*marks]
        while rest:
            mark = rest.pop()
            if mark.kind == "output":
                rest += self.shared[mark.number]
            else:
                each.add(mark)
        return each

    def _read(self, node: Node) -> tuple[set[Mark], list[Reference]]:
        """Return the sides that a node reads itself, and what else it reads that their crossings do not judge."""
        arguments = [*self._arguments(node)]
        read = {reference for _, reference in arguments}
        inputs = {reference for kind, reference in arguments if kind not in _OWN}
        modes = {Mark("cause", int(index), getattr(index, "lane", -1)) for row, index in read if row == "s"}
        judged: set[Reference] = set()
        tape, kinds = self.plan.instances[node.instance].tape, {kind for kind, _ in arguments}
        is_foreign = isinstance(tape, FmuTape) and "input" in kinds
        for j in self.of_instance.get(node.instance, ()):
            memory, judges = self._sides_of(j).intersection(read), self.plan.bind(self.plan.crossings[j].node)
            is_tight = any(one in judges for one in (*inputs, *memory)) if memory else is_foreign
            if is_tight or Mark("cause", j) in modes:
                modes.add(Mark("cause", j))
                judged.update(judges)
            elif memory:
                modes.add(Mark("cause", j, is_loose=True))
        return modes, [reference for reference in inputs if reference.row == "w" and reference not in judged]

    def _sides_of(self, crossing: int) -> set[Reference]:
        """Return the discretes that a crossing resets to what follows from memory and the signals that it judges."""
        if crossing in self.memory:
            return self.memory[crossing]
        cause = self.plan.crossings[crossing]
        judged = set(self._arguments(cause.node))
        self.memory[crossing] = {
            target
            for node, target in cause.resets
            if target.row == "d" and all(pair[0] in _OWN or pair in judged for pair in self._arguments(node))
        }
        return self.memory[crossing]

    def _arguments(self, node: Node) -> Iterator[tuple[str, Reference]]:
        """Give the kind of each argument that a node reads, and where it is."""
        instance = self.plan.instances[node.instance]
        for k in instance.tape.read_by[node.key][node.element]:
            yield instance.tape.arguments[k].kind, instance.arguments[k]

    def _is_hidden(self, mark: Mark) -> bool:
        return mark.kind == "cause" and self._instance(mark).hidden

    def _is_inside(self, mark: Mark) -> bool:
        return mark.kind == "cause" and self._instance(mark).condition is not None

    def _instance(self, mark: Mark) -> Instance:
        return self.plan.instances[self.plan.crossings[mark.number].instance]


def firing_order(plan: Plan, loops: Sequence[AlgebraicLoop]) -> FiringOrder:
    """Find the order of a plan with these algebraic loops."""
    if not plan.crossings:
        return FiringOrder()
    causes, marks = [*plan.crossings, *plan.events], Marks(plan, loops)
    first_event, first_loop = len(plan.crossings), len(causes)
    first_output = first_loop + len(loops)
    united = _united(plan)
    needs: _Needs = {}

    def number_of(mark: Mark) -> int:
        if mark.kind == "cause":
            return united.get(mark.number, mark.number)
        return first_loop + mark.number if mark.kind == "loop" else first_output + marks.order[mark.number]

    def add(number: int, seen: Iterable[Mark]) -> None:
        own = needs.setdefault(united.get(number, number), set())
        own.update((number_of(mark), mark.is_loose) for mark in seen)

    for number, cause in enumerate(causes):
        add(number, marks.of_cause(cause))
    for k, loop in enumerate(loops):
        add(first_loop + k, marks.of_loop(loop))
    for part in plan.enabled:
        add(part.side, marks.of_turning_on(part))
    for unit in plan.foreign:
        add(first_event + unit.event, marks.seen.of(unit.inputs))
    if not any(needs.values()):
        return FiringOrder()
    for place, number in marks.order.items():
        add(first_output + number, marks.shared[place])
    members: dict[int, list[int]] = {}
    for number in range(first_output + len(marks.order)):
        members.setdefault(united.get(number, number), []).append(number)
    tight, groups = _grouped(needs)
    of_loops = (group for group in groups if any(first_loop <= unit < first_output for unit in group))
    inner = {number for group in of_loops for unit in group for number in members[unit] if number < first_event}
    waits = tuple(_waits(tight, groups, members, first_event))
    own = (wait.cause for wait in waits if wait.cause < len(causes))
    readers = {number: [mark.number for mark in marks.writers_of(causes[number])] for number in own}
    beside = tuple(_beside(tight, readers, united))
    return FiringOrder(waits, beside, tuple(sorted(inner - plan.foreign_crossings)))


def order_of(plan: Plan) -> FiringOrder:
    """Return which causes wait for which in any plan, also in one that is known of one copy.

    Such a plan has no loops, FMUs or enabled parts.
    """
    if plan.folded is None:
        return plan.firing
    folded: Folded = plan.folded
    one, gathers = folded.plan, folded.gathers
    marks, first_event = Marks(one, gathers=gathers), len(plan.crossings)
    kinds = (("s", one.crossings, 0), ("e", one.events, first_event))
    seen = [(row, k, first, marks.of_cause(cause)) for row, causes, first in kinds for k, cause in enumerate(causes)]
    if not any(own for *_, own in seen):
        return FiringOrder()
    entered = {k: [marks.seen.of([source]) for source in sources] for k, sources in gathers.items()}
    begin: dict[tuple[str, int], int] = {}
    end = first_event + len(plan.events)
    sizes = [("gather", k, len(sources)) for k, sources in gathers.items()]
    for kind, k, size in (*sizes, *(("output", k, folded.lanes("w", k)) for k in marks.order)):
        begin[kind, k], end = end, end + size

    def number(mark: Mark, reader: int) -> int:
        lane = reader if mark.lane < 0 else mark.lane
        places = folded.places("s", mark.number) if mark.kind == "cause" else ()
        if mark.kind == "output" and folded.lanes("w", mark.number) == 1:
            lane = 0
        return places[lane if len(places) > 1 else 0] if places else begin[mark.kind, mark.number] + lane

    needs: _Needs = {}
    for row, k, first, own in seen:
        for lane, place in enumerate(folded.places(row, k)):
            needs[first + place] = {(number(mark, lane), mark.is_loose) for mark in own}
    for k, lanes in entered.items():
        for lane, own in enumerate(lanes):
            needs[begin["gather", k] + lane] = {(number(mark, lane), mark.is_loose) for mark in own}
    for k in marks.order:
        for lane in range(folded.lanes("w", k)):
            needs[begin["output", k] + lane] = {(number(mark, lane), mark.is_loose) for mark in marks.shared[k]}
    tight, groups = _grouped(needs)
    waits = tuple(_waits(tight, groups, {number: (number,) for number in needs}, first_event))

    def writers(of: Iterable[Mark], reader: int) -> Iterator[int]:
        for mark in of:
            lane = reader if mark.lane < 0 else mark.lane
            if mark.kind == "gather":
                yield from writers(marks.written.of([gathers[mark.number][lane]]), lane)
                continue
            is_event = mark.number >= len(one.crossings)
            own = folded.places("e", mark.number - len(one.crossings)) if is_event else folded.places("s", mark.number)
            yield is_event * first_event + own[lane if len(own) > 1 else 0]

    waiting, readers = {wait.cause for wait in waits}, dict[int, list[int]]()
    for row, causes, first in kinds:
        for k, cause in enumerate(causes):
            read = marks.writers_of(cause)
            for lane, place in enumerate(folded.places(row, k) if read else ()):
                if first + place in waiting:
                    readers[first + place] = [*writers(read, lane)]
    return FiringOrder(waits, tuple(_beside(tight, readers, {})))


def _beside(
    tight: Mapping[int, set[int]], readers: Mapping[int, Iterable[int]], united: Mapping[int, int]
) -> Iterator[tuple[int, int]]:
    """Pair causes that reset memory with those that read it and may wait, unless these wait for them."""
    needed = set[int]().union(*tight.values())
    for reader, writers in readers.items():
        unit, above = united.get(reader, reader), set[int]()
        for writer in writers:
            other = united.get(writer, writer)
            if other in needed and not above:
                above.update(closure([unit], lambda number: tight.get(number, ())))
            if other != unit and other not in above:
                yield writer, reader


def _grouped(needs: _Needs) -> tuple[dict[int, set[int]], list[list[int]]]:
    """Return what each needs without what is loose in circles, and the groups that need each other even so."""
    every = components({number: sorted({other for other, _ in needed}) for number, needed in needs.items()})
    group_of = {number: k for k, group in enumerate(every) for number in group}
    tight = {
        number: {other for other, is_loose in needed if not is_loose or group_of[other] != group_of[number]}
        for number, needed in needs.items()
    }
    return tight, components({number: sorted(needed) for number, needed in tight.items()})


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
