"""All equations of a diagram with its analysis points, as entries of one matrix.

An analysis point is a row: what reads a signal there reads q = (the signal) + (a perturbation), and where the point is
opened, the perturbation alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..text.arrays import Array
from ..text.errors import Fault, UsageError
from .elimination import Entries
from .interconnection import Interconnection
from .replaced_slopes import ReplacedSlopes
from .signals import SignalElement, passes_on, told

Key = tuple[int, tuple[int, ...] | None]
"""What makes a place an analysis point: its column and its slots."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """The variables: the columns of a graph, then analysis points, inputs and states of overrides.

    entries: the terms of which each variable is the sum. points, inputs, states: where these begin; size: how many
    variables there are. measured: the variables that are outputs (-1: a constant). selects: what each slot reads.
    """

    entries: Entries
    points: int
    inputs: int
    states: int
    size: int
    measured: list[int]
    selects: Array

    def reached(self, links: Sequence[tuple[int, int]]) -> tuple[Array, Array]:
        """Which variables change with the inputs, and which change what is measured. links: further entries."""
        measured = [variable for variable in self.measured if variable >= 0]
        return self.entries.reached(range(self.inputs, self.states), measured, links)


def wiring(
    replaced: ReplacedSlopes,
    inputs: Sequence[SignalElement],
    outputs: Sequence[SignalElement],
    openings: Sequence[SignalElement],
    injected: Sequence[int],
    watched: Sequence[int],
) -> Wiring:
    """The equations with points at inputs and openings.

    injected: nodes to which further inputs are added. watched: slots; what they read is measured too. Raises UsageError
    (E501) where nothing can be put in or cut.
    """
    graph = replaced.graph
    points = _Points(graph, inputs, openings)
    selects, first = points.selects, graph.first
    begin = points.first + len(points.keys)
    states = begin + len(inputs) + len(injected)
    rows, read, values = replaced.entries
    columns = selects[read]
    live = columns >= 0
    sources = [(k, int(selects[slot])) for k, slot in graph.delayed.items()]
    more = [
        *((first["v"] + n, first["v"] + n, 1.0) for n in graph.residuals.tolist()),
        *((first["h"] + k, column, 1.0) for k, column in sources if column >= 0),
        *points.entries(),
        *((points.of(spot), begin + k, 1.0) for k, spot in enumerate(inputs)),
        *((int(graph.variable[node]), begin + len(inputs) + k, 1.0) for k, node in enumerate(injected)),
        *_overriding(replaced, selects, states),
    ]
    also = np.array(more, dtype=float).reshape(-1, 3)
    size = states + sum(len(A) for A, *_ in replaced.overridden.values())
    entries = Entries(
        np.concatenate([rows[live], also[:, 0].astype(np.intp)]),
        np.concatenate([columns[live], also[:, 1].astype(np.intp)]),
        np.concatenate([values[live], also[:, 2]]),
        size,
    )
    measured = [*(points.measured(spot) for spot in outputs), *(int(selects[slot]) for slot in watched)]
    return Wiring(entries, points.first, begin, states, size, measured, selects)


class _Points:
    """The analysis points of a wiring: each place once, however often it is named.

    first: the variable of the first point. selects: what each slot reads, with the points. sources: by column, the
    point on its whole signal.
    """

    def __init__(
        self, graph: Interconnection, inputs: Sequence[SignalElement], openings: Sequence[SignalElement]
    ) -> None:
        self.graph, self.first = graph, graph.columns
        self.spots: dict[Key, SignalElement] = {}
        for spot in (*inputs, *openings):
            _check(graph, spot)
            self.spots.setdefault(_key(spot), spot)
        self.keys = list(self.spots)
        self.disturbed, self.opened = set(map(_key, inputs)), set(map(_key, openings))
        self.sources = {column: self.first + n for n, (column, slots) in enumerate(self.keys) if slots is None}
        self.selects = graph.selects.copy()
        for column, point in self.sources.items():
            # What a block reads of itself (a motor its own speed) is no part of the signal that goes to others.
            self.selects[(graph.selects == column) & (graph.is_wired | graph.is_local(column))] = point
        for n, (_, slots) in enumerate(self.keys):  # an input of a block comes after the signal that it reads
            if slots is not None:
                self.selects[list(slots)] = self.first + n

    def of(self, spot: SignalElement) -> int:
        """The point at a place that has one."""
        return self.first + self.keys.index(_key(spot))

    def entries(self) -> Iterator[tuple[int, int, float]]:
        """What a point that is not opened reads: its signal; at an input of a block, the point on its signal."""
        for n, (column, slots) in enumerate(self.keys):
            behind = column if slots is None else self.sources.get(column, column)
            if (column, slots) not in self.opened and behind >= 0:
                yield self.first + n, behind, 1.0

    def measured(self, spot: SignalElement) -> int:
        """The variable that is measured at a place."""
        known = self.spots.get(_key(spot))
        if known is not None and known.name != spot.name:
            return self.of(spot)  # another name for it, farther down the wire
        if known is not None and _key(spot) in self.disturbed - self.opened:
            return self.of(spot)  # what is seen behind the perturbation
        return spot.column if spot.slots is None else self.sources.get(spot.column, spot.column)


def _key(spot: SignalElement) -> Key:
    return spot.column, spot.slots


def _check(graph: Interconnection, spot: SignalElement) -> None:
    """Raise UsageError (E501) where nothing can be put in or cut."""
    if spot.column < 0 and spot.slots is None:
        raise UsageError(Fault("E501", spot.name, "is a constant, where a signal can neither enter nor be cut."))
    if spot.is_copy:
        message = "is a copy of a signal, which other blocks read before this place too."
        raise UsageError(Fault("E501", spot.name, message, f"Name {told(graph, spot.column)}, or an input."))
    if spot.slots is not None and passes_on(graph, spot):
        message = "is the input of a block that only passes the signal on to its readers."
        raise UsageError(
            Fault("E501", spot.name, message, "Name the output of this block, or the signal that is wired to it.")
        )


def _overriding(replaced: ReplacedSlopes, selects: Array, begin: int) -> Iterator[tuple[int, int, float]]:
    """The entries of the models in the place of blocks; their states start at `begin`."""
    graph, first = replaced.graph, begin
    for i, (A, B, C, D) in replaced.overridden.items():
        kind, base = graph.type_of[i], int(graph.slot_first[i])
        slots = [
            base + kind.slot_of[kind.by_fine["input", port.variable, port.first + e]]
            for port in kind.tape.interface.inputs.values()
            for e in range(port.size)
        ]
        states = list(range(first, first + len(A)))
        first += len(A)
        columns = [*states, *(int(selects[slot]) for slot in slots)]
        for row, numbers in zip([*states, *replaced.given[i]], np.block([[A, B], [C, D]]).tolist(), strict=True):
            for column, value in zip(columns, numbers, strict=True):
                if column >= 0 and value != 0.0:
                    yield row, column, value
