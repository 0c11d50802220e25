"""The Plan of a diagram with copies, planned for one copy: what is computed is known by types, where it is by ranges.

    Expansion --> the blocks of one copy of each fleet, and what enters fleets --plan--> Plan of one copy
    its places + ranges of places --> Plan of the whole diagram, whose long tables are made when somebody asks for them

A block in a fleet is computed in lanes, one for each copy. Its places in memory are those of the diagram that is
written out: `first + stride lane` in each row. What is read in the own lane has a plain reference in the plan of one
copy; what a certain copy gives has an `At`, which is equal to the plain one and knows its lane. What enters a fleet
with another source for each copy is gathered by an instance of its own, so that the order of computation follows.

Copies inside of copies are written out in the plan of one copy. Where copies cannot be planned as one (`foldable`), or
need each other at one time, the diagram is written out and planned whole.
"""

from __future__ import annotations

import dataclasses
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..contract.block import Block
from ..contract.equations import output
from ..contract.interface import Value
from ..contract.resolution import Resolved, resolve
from ..contract.variables import Input, Parameter
from ..model.conditional import Enabled, Gate, OutputGate, TickGate, Time, TriggerGate
from ..model.copies import CopySource, EachSource, Fleet, InLanes, Later
from ..model.expansion import Expansion
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat
from ..model.wires import BlockSource, Source
from ..text.errors import BlocksError
from .memory_layout import ROWS, parameter_places
from .plan import Plan, PlanSignal, Rate, Reference

# mypy: disable-error-code="no-untyped-def,misc,operator,index"


class At(int):
    """A number of something in the plan of one copy, that of a certain copy."""

    lane: int

    def __new__(cls, number: int, lane: int) -> At:
        made = super().__new__(cls, number)
        made.lane = lane
        return made

    def __reduce__(self) -> Any:
        return At, (int(self), self.lane)


class Gather(Block):
    """What enters a fleet: for each copy one of its inputs. Its equation says what it depends on, and no more."""

    size = Parameter(1, structural=True, type="int", doc="number of different sources")
    u = Input(shape=lambda size: size, doc="sources")

    @output
    def y(u, size):
        made = u[0]
        for k in range(1, size):
            made = made + u[k]
        return made


@dataclass(frozen=True, slots=True)
class Segment:
    """Places of a row side by side: from `first` on in the whole diagram, from `own` on in the plan of one copy.

    size: how many there are for each of `count` copies.
    """

    first: int
    own: int
    size: int
    count: int


@dataclass(frozen=True, eq=False)
class Folded:
    """plan: of one copy. fleets: of its instances. segments: by row. gathers: by instance, what each lane reads.

    sizes: of the rows in the whole diagram.
    """

    plan: Plan
    fleets: tuple[Fleet | None, ...]
    segments: Mapping[str, tuple[Segment, ...]]
    gathers: Mapping[int, tuple[Reference, ...]]

    def places(self, row: str, index: int) -> range:
        """The places of all copies of a place."""
        if row not in self.segments:
            return range(index, index + 1)
        segments = self.segments[row]
        found = segments[bisect_right(segments, index, key=lambda segment: segment.own) - 1]
        first = found.first + index - found.own
        return range(first, first + found.size * found.count, max(found.size, 1))

    def spread(self, instances: Sequence[int]) -> list[range]:
        """The numbers in the whole diagram of what instances, in their order, have one after the other."""
        numbers: list[range] = []
        first = k = 0
        while k < len(instances):
            fleet, end = self.fleets[instances[k]], k + 1
            while fleet is not None and end < len(instances) and self.fleets[instances[end]] is fleet:
                end += 1
            size = (end - k) * (1 if fleet is None else fleet.count)
            numbers += [range(first + n, first + size, end - k) for n in range(end - k)]
            first, k = first + size, end
        return numbers

    def order(self, instance: int, lane: int) -> tuple[int, int, int]:
        """What sorts blocks as they stand in the whole diagram."""
        return self.begins[instance], lane, instance

    @cached_property
    def begins(self) -> list[int]:
        """Of each instance the first one of its fleet."""
        begins: list[int] = []
        for k, fleet in enumerate(self.fleets):
            is_same = k > 0 and fleet is not None and self.fleets[k - 1] is fleet
            begins.append(begins[-1] if is_same else k)
        return begins

    def in_order(self, row: str, places: Sequence[int]) -> Iterator[int]:
        """Places of the plan of one copy, in the whole diagram: copy by copy."""
        whole = [own for place in places for own in self.places(row, place)]
        return iter(sorted(whole) if places == sorted(places) else whole)

    def lanes(self, row: str, index: int) -> int:
        """How many copies a place stands for."""
        return len(self.places(row, index))

    def copies(self, instance: int) -> int:
        """How many copies an instance stands for."""
        fleet = self.fleets[instance]
        return 1 if fleet is None else fleet.count

    def shown(self, index: int) -> Sequence[Reference]:
        """What a place of w shows in each copy, in the whole diagram."""
        gathered = self.gathers.get(self.plan.outputs[index].instance)
        if gathered is not None:
            return [self.of_whole(reference) for reference in gathered]
        return [Reference("w", place) for place in self.places("w", index)]

    def path(self, instance: int, lane: int) -> str:
        """The path of a copy of an instance."""
        path, fleet = self.plan.instances[instance].path, self.fleets[instance]
        return path if fleet is None else f"{fleet.path}[{lane}]{path[len(fleet.path) :]}"

    def of_one(self, reference: Reference) -> Reference:
        """Where something of the whole diagram is in the plan of one copy."""
        row, index = reference
        if row not in self.segments:
            return reference
        segments = self.segments[row]
        found = segments[bisect_right(segments, index, key=lambda segment: segment.first) - 1]
        lane, place = divmod(index - found.first, found.size)
        return Reference(row, found.own + place if found.count == 1 else At(found.own + place, lane))

    def of_whole(self, reference: Reference) -> Reference:
        """Where a place of the plan of one copy, of a certain copy or outside of all, is in the whole diagram."""
        row, index = reference
        if row not in self.segments:
            return reference
        return Reference(row, self.places(row, index)[getattr(index, "lane", 0)])


_OF_EDGES = (Enabled, Gate, OutputGate, TickGate, Time, TriggerGate)


def foldable(expansion: Expansion) -> bool:
    """Whether copies are planned as one, as far as their blocks tell."""
    for block, each in zip(expansion.blocks, expansion.each, strict=True):
        declared, resolved = block.interface.declaration, block.resolved
        if declared.stepper or declared.foreign or declared.histories or declared.algebraics:
            return False
        if block.condition is not None or block.time is not None or block.interface.cls in _OF_EDGES:
            return False
        others = (each.known if isinstance(each, InLanes) else each).values()  # columns are in the row p alone
        if any(other.clocks != resolved.clocks or not _alike(other, resolved) for other in others):
            return False
    return True


def _alike(one: Resolved, other: Resolved) -> bool:
    """Whether two blocks have equal numbers in what no parameter holds."""
    tables = one.interface.tables
    starts = all((one.starts[name] == other.starts[name]).all() for name in one.starts)
    return starts and all(np.array_equal(one.values[name].value, other.values[name].value) for name in tables)


class _Folding:
    """Makes the flat diagram of one copy: `blocks`, in the order of the text, and gathers behind them."""

    def __init__(self, expansion: Expansion) -> None:
        self.expansion = expansion
        self.number: dict[tuple[int, int], int] = {}  # of a block in a lane among the inner copies
        self.entries: list[tuple[int, int]] = []
        self.roots: list[Fleet | None] = []  # the outermost fleet of each
        pairs = [
            (block, lane)
            for block, fleet in enumerate(expansion.fleets)
            for lane in range(1 if fleet is None else _inner(fleet))
        ]
        for block, lane in sorted(pairs, key=lambda pair: expansion.layout.place(*pair)):
            fleet = expansion.fleets[block]
            self.number[block, lane] = len(self.entries)
            self.entries.append((block, lane))
            self.roots.append(None if fleet is None else _root(fleet))
        self.gathered: dict[object, int] = {}
        self.gathers: list[tuple[Fleet, list[Source]]] = []
        self.blocks = [self.block(*entry) for entry in self.entries]
        self.blocks += [self.gather(*pair) for pair in self.gathers]

    def block(self, index: int, inner: int) -> FlatBlock:
        block, fleet = self.expansion.blocks[index], self.expansion.fleets[index]
        if fleet is None:
            path = block.path
        else:
            root = _root(fleet)
            path = root.path + fleet.numbered(block.path, inner)[len(root.path) + len("[0]") :]
        own = None if fleet is None else -1
        sources = {
            name: tuple([self.source(source, fleet, inner, own) for source in part])
            for name, part in block.sources.items()
        }
        resolved = self.expansion.each[index].get(inner, block.resolved)
        return dataclasses.replace(block, path=path, resolved=resolved, sources=sources)

    def source(self, source: Any, fleet: Fleet | None, inner: int, outer: int | None) -> Source:
        """A source in the plan of one copy.

        fleet, inner: from which it is seen, and the lane among its inner copies. outer: the number of the outermost
        copy: -1 for that of the reader, None outside.
        """

        def reduce(to: Fleet | None) -> None:
            nonlocal fleet, inner, outer
            while fleet is not to:
                assert fleet is not None
                inner //= fleet.count
                fleet = fleet.outer
                inner, outer = (inner, outer) if fleet is not None else (0, None)

        while True:
            if isinstance(source, BlockSource):
                reduce(self.expansion.fleets[source.block])
                number = self.number[source.block, inner]
                if outer is None or outer == -1 or fleet is None or _root(fleet).count == 1:
                    return source._replace(block=number)
                return source._replace(block=At(number, outer))
            if isinstance(source, EachSource):
                reduce(source.fleet)
                if source.fleet.outer is None and outer == -1:
                    return self.entering(source)
                number = inner % source.fleet.count if source.fleet.outer is not None else outer or 0
                reduce(source.fleet.outer)
                source = source.sources[number]
            elif isinstance(source, CopySource):
                reduce(source.fleet.outer)
                if source.fleet.outer is None:
                    inner, outer = 0, source.number
                else:
                    inner = inner * source.fleet.count + source.number
                fleet, source = source.fleet, source.source
            else:
                return source  # type: ignore[no-any-return]

    def entering(self, source: EachSource) -> BlockSource:
        """What gathers the sources of all lanes."""
        key = tuple(source)
        if key not in self.gathered:
            self.gathered[key] = len(self.gathers)
            self.gathers.append((source.fleet, []))
            self.gathers[self.gathered[key]][1][:] = [self.source(one, None, 0, None) for one in source.sources]
        return BlockSource(len(self.entries) + self.gathered[key], "y", 0)

    def gather(self, fleet: Fleet, sources: Sequence[Source]) -> FlatBlock:
        distinct = tuple(dict.fromkeys(sources))
        resolved = resolve(Gather, {"size": Value(len(distinct))})
        return FlatBlock(f"{fleet.path} entered", resolved, {"u": distinct}, hidden=True)


def _root(fleet: Fleet) -> Fleet:
    return fleet if fleet.outer is None else _root(fleet.outer)


def _inner(fleet: Fleet) -> int:
    """How many copies there are in one of the outermost fleet."""
    return fleet.total // _root(fleet).count


def folded(flat: Flat, plan_of: object) -> Plan | None:
    """The Plan of a flat diagram with copies; None where it must be written out. plan_of: the builder of a Plan."""
    expansion = flat.expansion
    if expansion is None or flat.settings.loops == "solve" or not foldable(expansion):
        return None
    folding = _Folding(expansion)
    one = dataclasses.replace(flat, blocks=tuple(folding.blocks), expansion=None, log=(), measures=())
    builder = plan_of(one)
    try:
        plan = builder.plan()
    except BlocksError:  # which may be one of copies, or of their being looked at as one
        return None
    if plan.starting is not True:
        return None
    memory, count = builder.memory, len(folding.entries)
    roots = (*folding.roots, *(fleet for fleet, _ in folding.gathers))
    segments = dict(_segments(memory, folding.roots))
    gathers = {
        count + k: tuple(map(memory.reference, sources)) for k, (_, sources) in enumerate(folding.gathers)
    }
    return _whole(flat, Folded(plan, roots, segments, gathers), builder, folding)


def _segments(memory: Any, roots: Sequence[Fleet | None]) -> Iterator[tuple[str, tuple[Segment, ...]]]:
    """By row, where its places are. The events of blocks have rows of their own, "e"."""
    ends = (*memory.first[1 : len(roots)], memory.first[len(roots)] if len(memory.first) > len(roots) else memory.sizes)
    for row, number in ROWS.items():
        sizes = [end[number] - first[number] for first, end in zip(memory.first, ends, strict=False)]
        yield row, tuple(_laid(sizes, roots))
    events = [len(footprint.events) for footprint in memory.footprints[: len(roots)]]
    yield "e", tuple(_laid(events, roots))


def _laid(sizes: Sequence[int], roots: Sequence[Fleet | None]) -> Iterator[Segment]:
    first = own = 0
    size, last = 0, roots[0] if roots else None
    for fleet, more in zip((*roots, None), (*sizes, 0), strict=True):
        if fleet is not last:
            count = 1 if last is None else last.count
            if size:
                yield Segment(first, own, size, count)
            first, own, size, last = first + size * count, own + size, 0, fleet
        size += more
    if size:
        yield Segment(first, own, size, 1 if last is None else last.count)


def _whole(flat: Flat, made: Folded, builder: Any, folding: _Folding) -> Plan:
    """The Plan of the whole diagram."""
    one, expansion = made.plan, flat.expansion
    assert expansion is not None
    sizes = {row: sum(s.size * s.count for s in segments) for row, segments in made.segments.items()}

    @dataclass
    class Whole:
        @cached_property
        def plan(self) -> Plan:
            with flat.placing():
                return type(builder)(dataclasses.replace(flat, expansion=None)).plan()  # type: ignore[no-any-return]

    whole = Whole()

    def later(name: str, row: str | int) -> Any:
        return Later(sizes[row] if isinstance(row, str) else row, lambda: getattr(whole.plan, name))

    def rate(k: int, name: str, pairs: Any) -> Any:
        size = sum(made.lanes("d", place) for _, place in pairs)
        return Later(size, lambda: getattr(whole.plan.rates[k], name))

    def names(row: str) -> Iterator[str]:
        own = getattr(one, "states" if row == "x" else "discretes")
        for fleet, blocks in _runs(folding.roots):
            first, last = (_first(builder.memory, row, k) for k in (blocks.start, blocks.stop))
            if fleet is None:
                yield from own[first:last]
                continue
            rests = [name[len(fleet.path) :] for name in own[first:last]]
            for number in range(fleet.count):
                yield from [f"{fleet.path}[{number}]{rest}" for rest in rests]

    def numbers(of: Callable[[Resolved], Sequence[float]], *, is_row_p: bool) -> tuple[float, ...]:
        """The numbers of all blocks, copy by copy. of: those of one block."""
        row: list[float] = []
        for fleet, blocks in _runs(folding.roots):
            entries, first = folding.entries[blocks.start : blocks.stop], 0
            starts = [of(expansion.blocks[index].resolved) for index, _ in entries]
            if fleet is None:
                row += [x for start in starts for x in start]
                continue
            table = np.tile(np.concatenate(starts), (fleet.count, 1))
            for (index, inner), start in zip(entries, starts, strict=True):
                block, own, each = expansion.blocks[index], expansion.fleets[index], expansion.each[index]
                size, part = _inner(own), table[:, first : first + len(start)]  # type: ignore[arg-type]
                others: Collection[int] = range(fleet.count) if not isinstance(each, InLanes) and each else ()
                if isinstance(each, InLanes):
                    others = [*each.copies.seen]
                    for name, places in parameter_places(block.interface).items() if is_row_p else ():
                        if name in each.columns:
                            column = each.columns[name][inner::size].reshape(fleet.count, -1)
                            part[:, places.start : places.stop] = column
                for number in others:
                    part[number] = of(each.get(number * size + inner, block.resolved))
                first += len(start)
            row += table.ravel().tolist()
        return tuple(row)

    rates = tuple(
        Rate(one_rate.period, one_rate.offset, rate(k, "outputs", one_rate.outputs), rate(k, "nexts", one_rate.nexts))
        for k, one_rate in enumerate(one.rates)
    )
    names_of_rows: dict[str, Any] = {
        "states": Later(sizes["x"], lambda: [*names("x")]),
        "discretes": Later(sizes["d"], lambda: [*names("d")]),
    }
    integers = {slot: known for place, known in one.integers.items() for slot in made.places("d", place)}
    projections = sum(made.lanes(*reference) for _, reference in one.projections)
    return dataclasses.replace(
        one,
        instances=later("instances", expansion.layout.size),
        **names_of_rows,
        nominal=numbers(lambda resolved: resolved.nominal, is_row_p=False),
        parameters=numbers(lambda resolved: builder.numbers_of(resolved)[0], is_row_p=True),
        tables=later("tables", "c"),
        x_start=later("x_start", "x"),
        d_start=later("d_start", "d"),
        s_start=later("s_start", "s"),
        derivatives=later("derivatives", "x"),
        outputs=later("outputs", "w"),
        crossings=later("crossings", "s"),
        events=later("events", "e"),
        rates=rates,
        projections=later("projections", projections),
        integers=integers,
        signals=_WholeSignals(flat, made, folding, builder.memory),
        log=flat.log,
        measures=flat.measures,
        ends=None if one.ends is None else made.places("s", one.ends)[0],
        folded=made,
        written_out=lambda: whole.plan,
    )


def _first(memory: Any, row: str, block: int) -> int:
    firsts = memory.first
    return (firsts[block] if block < len(firsts) else memory.sizes)[ROWS[row]]  # type: ignore[no-any-return]


def _runs(roots: Sequence[Fleet | None]) -> Iterator[tuple[Fleet | None, range]]:
    """Blocks of one outermost fleet, or of none, side by side."""
    first = 0
    for k in range(1, len(roots) + 1):
        if k == len(roots) or roots[k] is not roots[first]:
            yield roots[first], range(first, k)
            first = k


class _WholeSignals(Mapping[str, PlanSignal]):
    """The signals of the whole diagram by name, each made when it is asked for."""

    def __init__(self, flat: Flat, made: Folded, folding: _Folding, memory: Any) -> None:
        self._flat, self._folded, self._folding, self._memory = flat, made, folding, memory
        self._made: dict[str, PlanSignal] = {}

    def __getitem__(self, name: str) -> PlanSignal:
        if name not in self._made:
            signal, fleet, lane = self._flat.signals.of_copies(name)  # type: ignore[attr-defined]
            inner = 1 if fleet is None else _inner(fleet)
            outer = None if fleet is None else lane // inner
            moved = self._folding.expansion.moved(signal.sources)
            sources = [self._folding.source(source, fleet, lane % inner, outer) for source in moved]
            references = tuple(self._folded.of_whole(self._memory.reference(source)) for source in sources)
            self._made[name] = PlanSignal(name, references, signal.shape, signal.units, signal.declared)
        return self._made[name]

    def __contains__(self, name: object) -> bool:
        return name in self._flat.signals

    def __iter__(self) -> Iterator[str]:
        return iter(self._flat.signals)

    def __len__(self) -> int:
        return len(self._flat.signals)
