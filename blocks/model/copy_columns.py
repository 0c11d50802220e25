"""The numbers of all copies of a fleet at once, as columns: an element, or a vector, for each lane.

It follows what differs from the entry of the fleet into all blocks, once for each type. Sums, differences, products and
quotients of doubles are those of numpy, to the last bit; other functions are computed number by number. What it cannot
compute or check so is left to a visit of each copy, which also words all faults.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..contract.expressions import evaluate_columns, parse
from ..contract.resolution import fits
from ..text.arrays import Array
from ..text.errors import ModelError
from . import streams
from .copies import Copy, own_value, stream_of
from .diagram_value import BlockEntry
from .hierarchy import DiagramScope, Hierarchy, Leaf, numbered
from .origins import Origin
from .values import Absent, Known, is_expression, names_in, value_of

Columns = Mapping[str, Array]
Found = list[tuple[Leaf | DiagramScope, Columns]]


class _Different(Exception):
    """The copies must be visited to know their numbers."""


def columns_of(fleet: Leaf | DiagramScope, entry: BlockEntry, hierarchy: Hierarchy) -> Found | None:
    """Return what differs between the copies of a fleet that is in no other; None if they must be visited to know."""
    outer, columns = _around(fleet), _Columns(hierarchy)
    try:
        columns.take(fleet, entry, {}, 1, lambda lane: outer.streams)
    except (_Different, ModelError, Absent, ArithmeticError, ValueError, TypeError):
        return None
    return columns.found


def _around(child: Leaf | DiagramScope) -> DiagramScope:
    scope = child.scope if isinstance(child, Leaf) else child.parent
    assert scope is not None
    return scope


class _Columns:
    def __init__(self, hierarchy: Hierarchy) -> None:
        self.hierarchy, self.found = hierarchy, Found()

    def take(
        self, child: Leaf | DiagramScope, entry: BlockEntry, varied: Columns, lanes: int, prefix: Callable[[int], str]
    ) -> None:
        """Take in a block. varied: of the parameters around it. prefix: by lane, of the names of streams around it."""
        within, fleet = _around(child), child.copied
        count = 1 if fleet is None else fleet.count
        if fleet is not None:
            within, lanes = numbered(within, Copy(fleet, 0)), lanes * count
            varied = {name: np.repeat(column, count, axis=0) for name, column in varied.items()}
            varied["index"] = np.tile(np.arange(count, dtype=float), lanes // count)

        def stream(lane: int) -> str:
            name = child.scope.value.blocks[child.name].stream if isinstance(child, Leaf) else child.stream
            own = stream_of(name or child.name, None if fleet is None else Copy(fleet, lane % count))
            return streams.joined(prefix(lane // count), own)

        own: dict[str, Array] = {}
        for key, origin in child.origins.items():  # each after those that it reads
            if origin.stream:
                seed = self.hierarchy.seed
                column: Array | None = np.array([streams.number_of(seed, stream(lane)) for lane in range(lanes)])
            elif origin.is_outer or isinstance(child, Leaf):
                column = self.column(origin, child, within.parameters, varied, lanes)
            else:
                column = self.column(origin, child, child.parameters, own, lanes)
            if column is not None:
                own[key] = column
        if own:
            self.found.append((child, own))
        if isinstance(child, Leaf):
            if not fits(child.resolved, own):
                raise _Different
            return
        for name, inner in child.children.items():
            of_block = child.value.blocks[name]
            fixed = (of_block.copies, *of_block.control.get("trigger", {}).values())
            if inner is None or any(word in own for raw in fixed for word in names_in(raw)):
                raise _Different
            self.take(inner, of_block, own, lanes, lambda lane: f"{stream(lane)}.")

    def column(
        self, origin: Origin, child: Leaf | DiagramScope, known: Known, varied: Columns, lanes: int
    ) -> Array | None:
        """Return a value in all lanes; None if it is the same in all. known: of lane 0. varied: columns of some."""
        if origin.is_listed:
            return self.listed(origin, child, lanes)
        raw: Any = origin.raw
        if not any(name in varied for name in names_in(raw)):
            return None
        text = raw.get("value") if isinstance(raw, Mapping) else raw
        if not isinstance(text, str) or not is_expression(text):
            raise _Different
        expression = parse(text[1:])
        if expression.name is not None:
            return varied[expression.name]
        columns: dict[str, list[float]] = {}
        for name in expression.names:
            value = known.get(name)
            if value is None or type(value.value) is not float:
                raise _Different
            columns[name] = varied[name].tolist() if name in varied else [value.value] * lanes
        return np.array(evaluate_columns(expression, columns))

    def listed(self, origin: Origin, child: Leaf | DiagramScope, lanes: int) -> Array:
        """Return the values of a list for copies in all lanes."""
        fleet = child.fleet
        assert fleet is not None
        if origin.set_at:  # by its path: the list may be one for the copies around, too
            said = self.hierarchy.overrides[origin.set_at]
            copies = [[copy for copy in fleet.copies(lane) if copy is not None] for lane in range(lanes)]
        else:
            said, copies = origin.written, [[Copy(fleet, number)] for number in range(fleet.count)]
        values = [value_of(own_value(said, origin.depth, own), origin.unit, {}) for own in copies]
        if len({(type(value.value), value.unit) for value in values}) > 1:
            raise _Different
        column = np.array([value.value for value in values])
        if column.dtype.kind != "f":
            raise _Different
        return column if origin.set_at else np.tile(column, (lanes // fleet.count, *[1] * (column.ndim - 1)))
