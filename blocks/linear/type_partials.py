"""What all blocks of one type have in common in a linear model: nodes, slots, and the tapes of their partials."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from ..compile.fmu_tape import FmuTape
from ..contract.scalars import BENDS
from ..contract.tape import Tape
from ..contract.tracing import fine, jacobian

_SIGNALS = frozenset({"input", "state", "discrete", "history", "output", "held", "algebraic", "local"})
_ROLES = frozenset({"output", "local", "derivative", "next", "residual", "crossing"})
_MANY = 4096  # partials that are derived at once


class TypePartials:
    """Nodes and slots of one type, and what gives its partials.

    tape: the fine one, with the locals as arguments; original: the one with the locals expanded. rows: the results that
    are nodes; slots: the arguments that are signals. bends: the rows that may have no slope somewhere.
    """

    def __init__(self, tape: Tape) -> None:
        self.original = tape
        self.tape = tape if isinstance(tape, FmuTape) else fine(tape)
        arguments = self.tape.arguments
        self.slots = [k for k, a in enumerate(arguments) if a.kind in _SIGNALS]
        self.slot_of = {k: n for n, k in enumerate(self.slots)}
        self.rows = [
            (key, e)
            for key, result in self.tape.results.items()
            if result.role in _ROLES
            for e in range(len(result.nodes))
        ]
        self.row_of = {row: n for n, row in enumerate(self.rows)}
        self.locals = [row for row in self.rows if row[0].startswith("local:")]
        self.by_name = {(a.kind, a.name, a.element): k for k, a in enumerate(tape.arguments)}
        places = {(a.kind, a.name, a.element): k for k, a in enumerate(arguments)}
        self.by_fine = places
        self.is_wired = np.array([arguments[k].kind == "input" for k in self.slots], dtype=bool)
        self.delayed: list[tuple[int, int]] = []  # delayed arguments, and the slot of the input that is delayed
        for k, a in enumerate(tape.arguments):
            if a.kind == "history":
                of = self.tape.delayed[a.name]
                self.delayed.append((k, self.slot_of[places["input", of, a.element]]))
        self.fine_at = [places[a.kind, a.name, a.element] for a in tape.arguments]
        self.resets = self._resets()
        self.still = {k for k in self.slots if self._is_still(k)}
        self.static = self._static()
        self.pairs: list[tuple[int, int]] = []  # (row, slot) of the partials
        self.tapes: list[tuple[Tape, list[int], bool]] = []  # what gives them, in order; whether there are sums
        if not isinstance(self.tape, FmuTape):
            self._derive()
        else:
            for row in self.rows:
                for k in self.tape.read_by[row[0]][row[1]]:
                    if k in self.slot_of and not row[0].startswith("crossing"):
                        self.pairs.append((self.row_of[row], self.slot_of[k]))
        self.bends = [row for row in self.rows if self._bends(row)]
        self._coupled: dict[object, tuple[frozenset[int] | None]] = {}

    def _derive(self) -> None:
        reads = {row: [k for k in self.tape.read_by[row[0]][row[1]] if k in self.slot_of] for row in self.rows}
        rows = [row for row in self.rows if reads[row]]
        by = sorted({k for row in rows for k in reads[row]})
        parts = [rows] if len(rows) * len(by) <= _MANY else [[row] for row in rows]
        for part in parts:
            own = sorted({k for row in part for k in reads[row]})
            if not own:
                continue
            partial_tape = jacobian(self.tape, part, own)
            nodes, kept = partial_tape.results["partial"].nodes, []
            for i, row in enumerate(part):
                for j, k in enumerate(own):
                    n = nodes[i * len(own) + j]
                    if (
                        partial_tape.nodes[n].op == "constant"
                        and partial_tape.nodes[n].value == 0.0
                        and k not in reads[row]
                    ):
                        continue
                    kept.append(n)
                    self.pairs.append((self.row_of[row], self.slot_of[k]))
            sums = any(partial_tape.nodes[n].op in ("add", "sub") for n in partial_tape.needed(kept))
            self.tapes.append((partial_tape, kept, sums))

    def _resets(self) -> dict[str, dict[int, int]]:
        """By crossing, the discretes that it resets, as arguments, and the nodes of their new values."""
        resets: dict[str, dict[int, int]] = {}
        for key, result in self.tape.results.items():
            role, _, rest = key.partition(":")
            name, _, cause = rest.partition(":")
            if role == "reset" and f"crossing:{cause}" in self.tape.results:
                for e, node in enumerate(result.nodes):
                    if ("discrete", name, e) in self.by_fine:
                        resets.setdefault(cause, {})[self.by_fine["discrete", name, e]] = node
        return resets

    def _static(self) -> dict[int, int]:
        """Discretes that are a function of signals (the index of a table), as nodes: all resets agree."""
        nodes: dict[int, set[int]] = {}
        for resets in self.resets.values():
            for k, node in resets.items():
                nodes.setdefault(k, set()).add(node)
        arguments, static = self.tape.arguments, {}
        for k, own_nodes in nodes.items():
            begin = self.tape.results.get(f"initial:{arguments[k].name}")
            own_nodes |= {begin.nodes[arguments[k].element]} if begin is not None else set()
            reads = {arguments[j].kind for n in own_nodes for j in self.tape.arguments_of(n)}
            if len(own_nodes) == 1 and k in self.still and reads <= {"input", "state", "local", "parameter", "table"}:
                static[k] = own_nodes.pop()
        return static

    def _seen(self, arguments: Iterable[int]) -> set[int]:
        """The signals among arguments; static discretes are replaced by the signals that determine them."""
        signals = set[int]()
        for k in arguments:
            signals |= self._seen(self.tape.arguments_of(self.static[k])) if k in self.static else {k}
        return signals & self.slot_of.keys()

    def _is_still(self, k: int) -> bool:
        """Whether an argument has no small changes: it is of whole numbers, or replaced at instants alone."""
        argument = self.tape.arguments[k]
        if argument.kind == "discrete" and f"next:{argument.name}" not in self.tape.results:
            return True
        return argument.kind in ("input", "discrete", "output", "held") and self.type_of(k) != "real"

    def type_of(self, k: int) -> str:
        return str(self.tape.type_of(self.tape.arguments[k].name))

    def _bends(self, row: tuple[str, int]) -> bool:
        """Whether the equation of a row may have no slope somewhere: it has such an operation, or it reads a side, or
        what crossings reset."""
        if isinstance(self.tape, FmuTape) or row[0].startswith("crossing"):
            return False
        node = self.tape.results[row[0]].nodes[row[1]]
        for n in self.tape.needed([node]):
            operation = self.tape.nodes[n]
            if operation.op == "argument":
                k = int(operation.value)
                if self.tape.arguments[k].kind == "side" or any(k in resets for resets in self.resets.values()):
                    return True
            elif operation.op in BENDS and self._moves(operation.operands, operation.op):
                return True
        return False

    @cached_property
    def sides_of(self) -> dict[tuple[str, int], tuple[int, ...]]:
        """The sides that each row reads, as arguments."""
        arguments = self.tape.arguments
        return {
            row: tuple(k for k in self.tape.read_by[row[0]][row[1]] if arguments[k].kind == "side") for row in self.rows
        }

    def signals(self, row: tuple[str, int]) -> tuple[int, ...]:
        """The signals that a row depends on, also through the sides that it reads, as arguments of the tape."""
        signals = sorted(self._seen(self.tape.read_by[row[0]][row[1]]))
        for side in self.sides_of[row]:
            signals += [k for k in self.crossing_reads(side) if k not in signals]
        return tuple(signals)

    def steps(self, row: tuple[str, int]) -> tuple[int, ...]:
        """What a row depends on that changes by steps alone: whole numbers, also through its sides."""
        signals = self.signals(row)
        return tuple(k for k in signals if k in self.still and self.tape.arguments[k].kind != "discrete")

    def crossing_reads(self, side: int) -> list[int]:
        key = f"crossing:{self.tape.arguments[side].name}"
        if key not in self.tape.results:
            return []
        return [k for k in self.tape.read_by[key][0] if k in self.slot_of]

    def coupled(self, row: tuple[str, int], k: int) -> frozenset[int] | None:
        """The signals on which the slope of a row by a signal depends; None where the row is linear in it."""
        known = self._coupled.get((row, k))
        if known is None:
            known = self._coupled[row, k] = (self._find_coupled(row, k),)
        return known[0]

    def _find_coupled(self, row: tuple[str, int], k: int) -> frozenset[int] | None:
        tape, coupled = self.tape, set[int]()
        if isinstance(tape, FmuTape):
            return None
        reads = tape.read_by[row[0]][row[1]]
        coupled |= self._seen(self._slope_reads(row, k))
        for other in self.static.keys() & set(reads):  # it jumps with the signals that determine the discrete
            seen = self._seen([other])
            coupled |= seen if k in seen else set()
        for n in tape.needed([tape.results[row[0]].nodes[row[1]]]):
            node = tape.nodes[n]
            if node.op in BENDS:
                operands = node.operands[1:] if node.op == "div" else node.operands
                read = self._seen(a for o in operands for a in tape.arguments_of(o))
                coupled |= read if k in read else set()
        for side in self.sides_of[row]:
            crossed = set(self.crossing_reads(side))
            if side in self._slope_reads(row, k):
                coupled |= crossed
            if k in crossed:  # what it switches between
                coupled |= crossed | {j for j in reads if j in self.slot_of and side in self._slope_reads(row, j)}
        return frozenset(coupled) or None

    def _slope_reads(self, row: tuple[str, int], k: int) -> tuple[int, ...]:
        """The arguments on which the partial derivative of a row by argument k depends."""
        if k not in self.tape.read_by[row[0]][row[1]]:
            return ()
        partial = jacobian(self.tape, [row], [k])
        return tuple(partial.arguments_of(partial.results["partial"].nodes[0]))

    def _moves(self, operands: Sequence[int], op: str) -> bool:
        """Whether a signal can reach the operands (of a quotient: the divisor)."""
        if op == "div":
            operands = operands[1:]
        return any(k in self.slot_of for n in operands for k in self.tape.arguments_of(n))
