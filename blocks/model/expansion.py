"""A flat diagram with copies: each of its blocks once, with the fleet that it is in, and how they are written out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..contract.resolution import Resolved
from .copies import CopySource, EachSource, Fleet, Layout
from .flat_block import FlatBlock, FlatEnabled
from .wires import BlockSource, Source


@dataclass(frozen=True, eq=False)
class Expansion:
    """blocks: one of each; fleets: the innermost fleet of each; each: by lane, the numbers that are others in it.

    ordered: how many of the blocks stand in the order of the text; what is at the edges of subdiagrams, first `gates`
    where wires cross them, and parts of blocks, follow. moved: from sources to those in parts of blocks.
    """

    blocks: tuple[FlatBlock, ...]
    fleets: tuple[Fleet | None, ...]
    each: tuple[Mapping[int, Resolved], ...]
    ordered: int
    gates: int = 0
    moved: Callable[[tuple[Source, ...]], tuple[Source, ...]] = tuple

    @cached_property
    def layout(self) -> Layout:
        return Layout(self.fleets, self.ordered, self.gates)

    def source(self, source: Any, fleet: Fleet | None, lane: int) -> Source:
        """A source as it is in a lane of the fleet that it is seen from."""
        while True:
            if isinstance(source, BlockSource):
                own = self.layout.lane(source.block, fleet, lane)
                return source._replace(block=self.layout.place(source.block, own))
            if isinstance(source, EachSource):
                inside = 0 if fleet is None else fleet.around(source.fleet, lane)
                fleet, lane = source.fleet.outer, inside // source.fleet.count
                source = source.sources[inside % source.fleet.count]
            elif isinstance(source, CopySource):
                outside = 0 if fleet is None else fleet.around(source.fleet.outer, lane)
                fleet, lane = source.fleet, outside * source.fleet.count + source.number
                source = source.source
            else:
                return source  # type: ignore[no-any-return]

    def settled(self, other: Expansion) -> Iterator[tuple[str, Resolved, Resolved]]:
        """The numbers of blocks here and in another expansion of the same diagram, by path; equal copies stand once."""
        for k, (block, fleet) in enumerate(zip(self.blocks, self.fleets, strict=True)):
            one, two = block.resolved, other.blocks[k].resolved
            yield block.path, one, two
            for lane in sorted({*self.each[k], *other.each[k]}):
                assert fleet is not None
                path = fleet.numbered(block.path, lane)
                yield path, self.each[k].get(lane, one), other.each[k].get(lane, two)

    def sources(self, sources: Sequence[Source], fleet: Fleet | None, lane: int) -> tuple[Source, ...]:
        sources = self.moved(tuple(sources))
        return tuple([self.source(source, fleet, lane) for source in sources])

    def written_out(self) -> Iterator[FlatBlock]:
        """All blocks, each for itself."""
        layout = self.layout
        for index, lane in layout.each():
            block, fleet = self.blocks[index], self.fleets[index]

            def place(other: int | None, fleet: Fleet | None = fleet, lane: int = lane) -> int | None:
                return None if other is None else layout.place(other, layout.lane(other, fleet, lane))

            yield dataclasses.replace(
                block,
                path=block.path if fleet is None else fleet.numbered(block.path, lane),
                resolved=self.each[index].get(lane, block.resolved),
                sources={name: self.sources(part, fleet, lane) for name, part in block.sources.items()},
                condition=place(block.condition),
                time=place(block.time),
                told_as=fleet.numbered(block.told_as, lane) if fleet and block.told_as else block.told_as,
            )

    def enabled(self, parts: Sequence[tuple[FlatEnabled, Fleet | None]]) -> Iterator[FlatEnabled]:
        """All enabled subdiagrams; parts: one of each, with the fleet that it is in."""
        layout = self.layout
        for part, fleet in parts:
            for lane in range(1 if fleet is None else fleet.total):

                def all_of(blocks: Sequence[int], fleet: Fleet | None = fleet, lane: int = lane) -> tuple[int, ...]:
                    """Blocks in a copy, those in copies within it each."""
                    found = []
                    for block in blocks:
                        inner = self.fleets[block]
                        size = 1 if inner is None else inner.total // (1 if fleet is None else fleet.total)
                        found += [layout.place(block, lane * size + k) for k in range(size)]
                    return tuple(found)

                yield dataclasses.replace(
                    part,
                    path=part.path if fleet is None else fleet.numbered(part.path, lane),
                    enabled=layout.place(part.enabled, layout.lane(part.enabled, fleet, lane)),
                    time=layout.place(part.time, layout.lane(part.time, fleet, lane)),
                    members=all_of(part.members),
                    resets=all_of(part.resets),
                )
