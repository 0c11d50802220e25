"""Both sides of the equations of a diagram at a point: where they jump, have a corner or an infinite slope."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..compile.jacobian import on_arrays, terms_on_arrays
from ..compile.plan import Node
from ..contract.tracing import jacobian
from ..text.arrays import Array
from .interconnection import BlockGroup, Interconnection

_NEAR = 1e-9
"""What counts as at a corner, relative to the terms of which the value is the sum."""
_DIFFERS = 1e-3
"""How much two slopes differ, relative to the larger one, beyond rounding and curvature."""
ROUNDING = 8 * float(np.finfo(float).eps)
"""The rounding error of a sum whose terms cancel, relative to these terms."""
_FAR, _DRIFTS = 1e3, 5e-3
"""A slope that is more by _DRIFTS than the one _FAR times as far away grows towards the point: |e|^0.999 has none."""


class Probe:
    """The blocks of one group, looked at around a point.

    everything: what equations read there, in one row. sizes: by column, how large the terms of its sum are. steps: by
    signal, how far away its two sides are, one number for each block.
    """

    def __init__(self, graph: Interconnection, group: BlockGroup, everything: Array, sizes: Array) -> None:
        self.graph, self.group, self.kind, self.members = graph, group, group.type, group.members
        self.arguments = list(everything[group.gather])
        self.slot_first = graph.slot_first[group.members]
        self.steps: dict[int, Array] = {}
        for n, k in enumerate(self.kind.slots):
            near = _NEAR * sizes[graph.selects[self.slot_first + n]]
            self.steps[k] = np.where(near > 0, near, _NEAR)

    def laws(self, places: Mapping[tuple[int, int], int], data: Array) -> Iterator[tuple[int, int, str]]:
        """The nodes that have no unique slope, with the slot and what they have instead.

        places: by row and slot, where the partials of the group begin in `data`; a slope that an operation has on both
        sides of the point, and not there, is filled in.
        """
        kind, turns = self.kind, self._turns()
        for row in kind.bends:
            needs = kind.tape.read_by[row[0]][row[1]]
            reads = [k for k in needs if k in kind.slot_of and k not in kind.still]
            flips = [turn for turn in turns if not turn.changes.keys().isdisjoint(needs)]
            if not reads and not flips:
                continue
            moved = _Moved(self, row, reads, flips)
            for c, k in enumerate(reads, 1):
                yield from self._at_both_sides(moved, c, k, places.get((kind.row_of[row], kind.slot_of[k])), data)
            for n, turn in enumerate(flips, 1 + 2 * len(reads)):
                yield from self._where_turned(moved, n, turn)

    def _at_both_sides(
        self, moved: _Moved, c: int, k: int, place: int | None, data: Array
    ) -> Iterator[tuple[int, int, str]]:
        """The laws of a row by signal k, number c of those that it reads, from both sides of the point."""
        here, step = moved.here, self.steps[k]
        above, below = moved.everywhere[:, 2 * c - 1], moved.everywhere[:, 2 * c]
        *_, rough = _compared(here, above, below, c, step, np.zeros_like(here))
        if not rough.any():
            return
        rounding = moved.rounding(0, 2 * c - 1, 2 * c)
        largest, jumps, differs, rough = _compared(here, above, below, c, step, rounding)
        if not rough.any():
            return
        both = [{k: self.arguments[k] + f * step} for f in (_FAR, -_FAR, 1e-2, 1e-6)]
        far, behind, nearer, nearest = moved.at(both)[c]
        with np.errstate(all="ignore"):
            # Where slopes differ by less the nearer they are, as those of u^2 at 0, there is no corner.
            bends = differs & ~(np.abs(above[c] - below[c]) <= 0.5 * np.abs(far - behind))
            farther = np.fmax(np.abs(far), np.abs(behind))
            grows, fades = largest > (1 + _DRIFTS) * farther, largest < (1 - _DRIFTS) * farther
            none = ~np.isfinite(here[c])
            tame = ~bends & ~jumps & np.isfinite(above[c]) & np.isfinite(below[c])
            # The slope is that of both sides where an operation has none, or another one, at the point alone:
            # |u| sgn u, or max(u, 0) + min(u, 0). Towards 0 it fades as that of |e|^1.5.
            known = rough & tame & (np.abs(nearer) <= (1 + _DIFFERS) * largest) & (none | (~grows & ~fades))
            steep = np.abs(here[c]) > (1 + _DIFFERS) * largest + rounding[c] + 1e-300
            infinite = rough & ~known & (none | grows | steep)
        if place is not None:
            data[place : place + len(self.members)][known] = nearest[known]
        for m in np.nonzero(jumps | bends | infinite)[0].tolist():
            sided = bends[m] and not grows[m] and np.isfinite(above[c][m]) and np.isfinite(below[c][m])
            what = "jump" if jumps[m] else "corner" if sided else "infinite slope"
            yield self._node(m, moved.row), self._slot(m, k), what

    def _where_turned(self, moved: _Moved, n: int, turn: _Turn) -> Iterator[tuple[int, int, str]]:
        """The laws of a row by a side or a discrete that takes another value, in move n."""
        here, other, rounding = moved.here, moved.everywhere[:, n], moved.rounding(0, n)
        with np.errstate(all="ignore"):
            largest = np.fmax(np.abs(other[1:]), np.abs(here[1:]))
            terms = (slopes * self.steps[k] for slopes, k in zip(largest, moved.reads, strict=True))
            reach = sum(terms, np.zeros(len(self.members)))
            least = 1e3 * reach + 1e-12 * np.abs(here[0]) + rounding[0] + 1e-300
            jumps = np.abs(other[0] - here[0]) > least
            apart = np.abs(other[1:] - here[1:]) > _DIFFERS * largest + rounding[1:] + 1e-300
        for m in np.nonzero(turn.near & (jumps | apart.any(axis=0)))[0].tolist():
            for k in turn.by:
                yield self._node(m, moved.row), self._slot(m, k), "jump" if jumps[m] else "corner"

    def _node(self, member: int, row: tuple[str, int]) -> int:
        return self.graph.number[Node(self.members[member], *row)]

    def _slot(self, member: int, k: int) -> int:
        return int(self.slot_first[member]) + self.kind.slot_of[k]

    def _turns(self) -> list[_Turn]:
        """What an arbitrarily small change would switch: sides, and discretes that crossings reset."""
        kind, arguments, steps, tables = self.kind, self.arguments, self.steps, self.group.tables
        turns, size = list[_Turn](), len(self.members)
        for k, argument in enumerate(kind.tape.arguments):
            row = f"crossing:{argument.name}"
            if argument.kind != "side" or row not in kind.tape.results:
                continue
            reads = [j for j in kind.tape.read_by[row][0] if j in kind.slot_of]
            if not reads:
                continue
            tape = jacobian(kind.tape, [(row, 0)], reads)
            wanted = [tape.results["value"].nodes[0], *tape.results["partial"].nodes]
            value, *partials = on_arrays(tape, wanted, arguments, tables)
            reach = sum(np.abs(p) * steps[j] for p, j in zip(partials, reads, strict=True))
            near = np.broadcast_to(np.abs(value) <= reach, (size,))
            if not near.any():
                continue
            by = [j for j in reads if j not in kind.still] or reads
            turns.append(_Turn({k: 1.0 - arguments[k]}, near, by))
            resets = kind.resets.get(argument.name)
            if not resets:
                continue
            # Beyond the crossing, and there with each other signal of the resets a little off.
            away = np.where(value >= 0, -2.0, 2.0)
            beyond = {j: arguments[j] + away * np.sign(p) * steps[j] for j, p in zip(reads, partials, strict=True)}
            others = {j for node in resets.values() for j in kind.tape.arguments_of(node)} & kind.slot_of.keys()
            others -= kind.still | set(reads)
            moves = [beyond, *({**beyond, j: arguments[j] + f * steps[j]} for j in others for f in (1.0, -1.0))]
            for move in moves:
                moved = [move.get(j, argument) for j, argument in enumerate(arguments)]
                values = on_arrays(kind.tape, list(resets.values()), moved, tables)
                new = {j: np.broadcast_to(v, (size,)).astype(float) for j, v in zip(resets, values, strict=True)}
                differs = np.any([new[j] != arguments[j] for j in new], axis=0)
                if (near & differs).any():
                    turns.append(_Turn(new, near & differs, [*by, *(j for j in others if j in move)]))
        return turns


class _Moved:
    """A row with its partials at the point and around it.

    reads: the signals that it is derived by. everywhere: its value and its partials, (1 + reads, moves, members), at
    the point, above and below it by each signal, and where sides and discretes are others; here: those at the point.
    """

    def __init__(self, probe: Probe, row: tuple[str, int], reads: Sequence[int], flips: Sequence[_Turn]) -> None:
        self.probe, self.row, self.reads = probe, row, reads
        tape, arguments, steps = probe.kind.tape, probe.arguments, probe.steps
        self.tape = jacobian(tape, [row], reads) if reads else tape
        self.wanted = [tape.results[row[0]].nodes[row[1]]]
        if reads:
            self.wanted = [self.tape.results["value"].nodes[0], *self.tape.results["partial"].nodes]
        self.moves: list[Mapping[int, Array]] = [{}]
        for k in reads:
            self.moves += [{k: arguments[k] + steps[k]}, {k: arguments[k] - steps[k]}]
        self.moves += [turn.changes for turn in flips]
        self.everywhere = self.at(self.moves)
        self.here = self.everywhere[:, 0]

    def at(self, moves: Sequence[Mapping[int, Array]], of: Callable[..., Any] = on_arrays) -> Array:
        """The value and the partials where some arguments are others: (1 + reads, moves, members)."""
        arguments = self.probe.arguments
        moved = list(arguments)
        for k in {k for move in moves for k in move}:
            moved[k] = np.stack([move.get(k, arguments[k]) for move in moves])
        values = np.empty((len(self.wanted), len(moves), len(self.probe.members)))
        for n, value in enumerate(of(self.tape, self.wanted, moved, self.probe.group.tables)):
            values[n] = value
        return values

    @cached_property
    def _noise(self) -> Array:
        """Sizes of the terms of these, for rounding; computed only where something differs."""
        return self.at(self.moves, terms_on_arrays)

    def rounding(self, *moves: int) -> Array:
        """The largest rounding errors of differences between some moves."""
        return np.asarray(2.0 * ROUNDING * self._noise[:, list(moves)].max(axis=1))


@dataclass(frozen=True, slots=True)
class _Turn:
    """Arguments that become others within rounding of the point, for the members that are near, by some signals."""

    changes: Mapping[int, Array]
    near: Array
    by: Sequence[int]


def _compared(
    here: Array, above: Array, below: Array, c: int, step: Array, rounding: Array
) -> tuple[Array, Array, Array, Array]:
    """An equation at a point and on both sides of it: the larger slope, whether it jumps, whether the slopes of the two
    sides differ, and whether anything is in doubt.

    here, above, below, rounding: of the value and of the partials, of which number c is meant, (1 + partials, members).
    """
    with np.errstate(all="ignore"):
        largest = np.fmax(np.abs(above[c]), np.abs(below[c]))
        least = _DIFFERS * largest + rounding[c] + 1e-300
        jump = 1e3 * step * largest + 1e-12 * np.abs(here[0]) + rounding[0] + 1e-300
        jumps = np.abs(above[0] - below[0]) > jump
        differs = np.abs(above[c] - below[c]) > least
        off = np.fmax(np.abs(here[c] - above[c]), np.abs(here[c] - below[c])) > least
        return largest, jumps, differs, jumps | ~np.isfinite(here[c]) | differs | off
