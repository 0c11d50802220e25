"""The interconnection of a Plan's equations, and their exact partial derivatives at a point.

    graph = Graph(plan)                    # the structure: once
    slopes = graph.at(point)               # numbers: of each equation by each of its arguments, block by block

Every result of a block (an output, a derivative, an update at a tick) and every local of it is a node of its own. What
a node reads are its slots; a slot reads a column: a state, a discrete, an input, a delayed value, or another node. So
the diagram is two sparse matrices,

    change of the nodes = partials (nodes x slots) * selection (slots x columns) * change of the columns,

of which the second one holds the wires only. A law is studied or replaced as its entry of `partials`, and an analysis
point is another entry of `selection`.

Derivatives are exact, by the tape of each type, for all blocks of a type at once; those of FMUs are their directional
derivatives, or central differences of two steps, which must agree. A node that has no one slope at the point (an
infinite one, a jump, a corner) is found by looking at both sides of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ..compile.fmu_tape import Request
from ..compile.jacobian import on_arrays, terms_on_arrays
from ..compile.plan import Node, Plan, Reference
from ..contract.tape import Tape, fine, jacobian
from ..text.errors import AnalysisError, Fault
from .point import Point

__all__ = ["BENDS", "Column", "Graph", "Law", "Slopes", "slopes_at"]

Array = np.ndarray[Any, Any]
Column = tuple[str, int]
"""("x" | "d" | "u" | "h", index), or ("v", number of a node)."""

_SIGNALS = frozenset({"input", "state", "discrete", "history", "output", "held", "algebraic", "local"})
_ROLES = frozenset({"output", "local", "derivative", "next", "residual", "crossing"})
BENDS = frozenset({
    *("fabs", "sign", "floor", "ceil", "fmod", "copysign", "fmin", "fmax", "lt", "le", "eq", "ne", "search", "pick"),
    *("sqrt", "pow", "log", "div", "atan2", "hypot", "asin", "acos", "acosh", "atanh"),
})  # fmt: skip
"""Operations that may have no slope somewhere."""
_MANY = 4096  # partials that are derived at once
_GRAPHS: WeakKeyDictionary[Any, Graph] = WeakKeyDictionary()
NEAR = 1e-9
"""How near to a corner is at it, of the size of what the value is the sum of."""
_DIFFERS = 1e-3
"""How much two slopes differ, of the larger one, where the difference is no rounding and no curvature."""
_ROUNDING = 8 * float(np.finfo(float).eps)
"""What rounding leaves of a sum whose terms cancel, of the size of these terms."""
_FAR, _DRIFTS = 1e3, 5e-3
"""A slope that is more by _DRIFTS than the one _FAR times as far away grows towards the point: |e|^0.999 has none."""


@dataclass(frozen=True, slots=True)
class Law:
    """A node that has no one slope at the point, or that a describing function stands for: its block and equation.

    kind: "infinite slope", "jump", "corner". by: the argument, as it is called.
    """

    node: int
    slot: int
    block: str
    equation: str
    by: str
    kind: str


def slopes_at(point: Point) -> Slopes:
    """The slopes at a point, which are computed once; points of one run share their graph."""
    if not point.slopes:
        graph = _GRAPHS.get(point.engine)
        if graph is None or graph.plan is not point.plan:
            graph = _GRAPHS[point.engine] = Graph(point.plan)
        point.slopes.append(graph.at(point))
    made: Slopes = point.slopes[0]
    return made


class _Type:
    """What all blocks of one type have in common: nodes, slots, and the tapes of their partials."""

    def __init__(self, tape: Tape) -> None:
        self.original = tape
        self.tape = tape if tape.opaque is not None else fine(tape)
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
        self.delayed: list[tuple[int, int]] = []  # arguments that are delayed, and the slot of what they were
        for k, a in enumerate(tape.arguments):
            if a.kind == "history":
                of = self.tape.interface.declaration.histories[a.name].of.name
                self.delayed.append((k, self.slot_of[places["input", of, a.element]]))
        self.fine_at = [places[a.kind, a.name, a.element] for a in tape.arguments]
        self.resets = self._resets()
        self.still = {k for k in self.slots if self._is_still(k)}
        self.static = self._static()
        self.pairs: list[tuple[int, int]] = []  # (row, slot) of the partials
        self.tapes: list[tuple[Tape, list[int], bool]] = []  # what gives them, in order; whether there are sums
        if self.tape.opaque is None:
            self._derive()
        else:
            for row in self.rows:
                for k in self.tape.read_by[row[0]][row[1]]:
                    if k in self.slot_of and not row[0].startswith("crossing"):
                        self.pairs.append((self.row_of[row], self.slot_of[k]))
        self.bends = [row for row in self.rows if self._bends(row)]
        self._coupled: dict[Any, tuple[frozenset[int] | None]] = {}

    def _derive(self) -> None:
        reads = {row: [k for k in self.tape.read_by[row[0]][row[1]] if k in self.slot_of] for row in self.rows}
        rows = [row for row in self.rows if reads[row]]
        by = sorted({k for row in rows for k in reads[row]})
        parts = [rows] if len(rows) * len(by) <= _MANY else [[row] for row in rows]
        for part in parts:
            own = sorted({k for row in part for k in reads[row]})
            if not own:
                continue
            made = jacobian(self.tape, part, own)
            nodes, kept = made.results["partial"].nodes, []
            for i, row in enumerate(part):
                for j, k in enumerate(own):
                    n = nodes[i * len(own) + j]
                    if made.nodes[n].op == "constant" and made.nodes[n].value == 0.0 and k not in reads[row]:
                        continue
                    kept.append(n)
                    self.pairs.append((self.row_of[row], self.slot_of[k]))
            sums = any(made.nodes[n].op in ("add", "sub") for n in made.needed(kept))
            self.tapes.append((made, kept, sums))

    def _resets(self) -> dict[str, dict[int, int]]:
        """By crossing, the discretes that it resets, as arguments, and the nodes of what becomes of them."""
        made: dict[str, dict[int, int]] = {}
        for key, result in self.tape.results.items():
            role, _, rest = key.partition(":")
            name, _, cause = rest.partition(":")
            if role == "reset" and f"crossing:{cause}" in self.tape.results:
                for e, node in enumerate(result.nodes):
                    if ("discrete", name, e) in self.by_fine:
                        made.setdefault(cause, {})[self.by_fine["discrete", name, e]] = node
        return made

    def _static(self) -> dict[int, int]:
        """Discretes that are a function of signals (the index of a table), as nodes: all resets say the same."""
        nodes: dict[int, set[int]] = {}
        for resets in self.resets.values():
            for k, node in resets.items():
                nodes.setdefault(k, set()).add(node)
        arguments, made = self.tape.arguments, {}
        for k, found in nodes.items():
            begin = self.tape.results.get(f"initial:{arguments[k].name}")
            found |= {begin.nodes[arguments[k].element]} if begin is not None else set()
            reads = {arguments[j].kind for n in found for j in self.tape.arguments_of(n)}
            if len(found) == 1 and k in self.still and reads <= {"input", "state", "local", "parameter", "table"}:
                made[k] = found.pop()
        return made

    def _seen(self, arguments: Iterable[int]) -> set[int]:
        """The signals among arguments; in the place of static discretes, those that they are functions of."""
        found = set[int]()
        for k in arguments:
            found |= self._seen(self.tape.arguments_of(self.static[k])) if k in self.static else {k}
        return found & self.slot_of.keys()

    def _is_still(self, k: int) -> bool:
        """Whether an argument has no small changes: it is of whole numbers, or replaced at instants alone."""
        argument = self.tape.arguments[k]
        if argument.kind == "discrete" and f"next:{argument.name}" not in self.tape.results:
            return True
        return argument.kind in ("input", "discrete", "output", "held") and self.type_of(k) != "real"

    def type_of(self, k: int) -> str:
        return str(self.tape.interface.declaration.readable[self.tape.arguments[k].name].type)

    def _bends(self, row: tuple[str, int]) -> bool:
        """Whether the equation of a row may have no slope somewhere: it has such an operation, or it reads a side, or
        what crossings reset."""
        if self.tape.opaque is not None or row[0].startswith("crossing"):
            return False
        node = self.tape.results[row[0]].nodes[row[1]]
        for n in self.tape.needed([node]):
            made = self.tape.nodes[n]
            if made.op == "argument":
                k = int(made.value)
                if self.tape.arguments[k].kind == "side" or any(k in resets for resets in self.resets.values()):
                    return True
            elif made.op in BENDS and self._moves(made.operands, made.op):
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
        found = sorted(self._seen(self.tape.read_by[row[0]][row[1]]))
        for side in self.sides_of[row]:
            found += [k for k in self.crossing_reads(side) if k not in found]
        return tuple(found)

    def steps(self, row: tuple[str, int]) -> tuple[int, ...]:
        """What a row depends on that changes by steps alone: whole numbers, also through its sides."""
        found = self.signals(row)
        return tuple(k for k in found if k in self.still and self.tape.arguments[k].kind != "discrete")

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
        tape, found = self.tape, set[int]()
        if tape.opaque is not None:
            return None
        reads = tape.read_by[row[0]][row[1]]
        found |= self._seen(self._slope_reads(row, k))
        for other in self.static.keys() & set(reads):  # it jumps with what the discrete is a function of
            seen = self._seen([other])
            found |= seen if k in seen else set()
        for n in tape.needed([tape.results[row[0]].nodes[row[1]]]):
            node = tape.nodes[n]
            if node.op in BENDS:
                operands = node.operands[1:] if node.op == "div" else node.operands
                read = self._seen(a for o in operands for a in tape.arguments_of(o))
                found |= read if k in read else set()
        for side in self.sides_of[row]:
            crossed = set(self.crossing_reads(side))
            if side in self._slope_reads(row, k):
                found |= crossed
            if k in crossed:  # what it switches between
                found |= crossed | {j for j in reads if j in self.slot_of and side in self._slope_reads(row, j)}
        return frozenset(found) or None

    def _slope_reads(self, row: tuple[str, int], k: int) -> tuple[int, ...]:
        """The arguments on which the partial derivative of a row by one depends."""
        if k not in self.tape.read_by[row[0]][row[1]]:
            return ()
        partial = jacobian(self.tape, [row], [k])
        return tuple(partial.arguments_of(partial.results["partial"].nodes[0]))

    def _moves(self, operands: Sequence[int], op: str) -> bool:
        """Whether a signal can reach the operands (of a quotient: the divisor)."""
        if op == "div":
            operands = operands[1:]
        return any(k in self.slot_of for n in operands for k in self.tape.arguments_of(n))


@dataclass(slots=True)
class _Group:
    """Blocks of one type and with the same tables.

    gather, locals: where the arguments and the locals stand when everything is one row, (arguments or locals, members).
    """

    type: _Type
    tables: list[Array]
    members: list[int] = field(default_factory=list)
    gather: Array = field(default_factory=lambda: np.empty((0, 0), dtype=np.intp))
    locals: Array = field(default_factory=lambda: np.empty((0, 0), dtype=np.intp))


class Graph:
    """The structure of a Plan: nodes, slots and what each slot reads.

    nodes: (instance, result key, element), those that others read (plan.outputs, then locals) first: `values` of them.
    states, nexts, held: numbers of the nodes that are dx/dt, the updates at ticks with their place in d, and sampled
    outputs with theirs. selects: the column of each slot by its number (-1: a constant). is_wired: of each slot,
    whether it is an input of a block, which a wire ends in; other slots read the block itself. delayed: of each delayed
    value, the slot of the input that it was.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        types: dict[int, _Type] = {}
        groups: dict[Any, _Group] = {}
        self.type_of: list[_Type] = []
        for index, instance in enumerate(plan.instances):
            kind = types.get(id(instance.tape))
            if kind is None:
                kind = types[id(instance.tape)] = _Type(instance.tape)
            self.type_of.append(kind)
            tables = tuple(reference for reference in instance.arguments if reference.row == "c")
            key = (id(instance.tape), tables)
            if key not in groups:
                groups[key] = _Group(kind, [np.array(plan.tables[int(place)]) for _, place in tables])
            groups[key].members.append(index)
        self.groups = list(groups.values())
        self.group_of = {i: (group, m) for group in self.groups for m, i in enumerate(group.members)}
        self._number()
        self._select()
        self._gather()

    def _number(self) -> None:
        plan = self.plan
        self.nodes: list[Node] = list(plan.outputs)
        self.nodes += [Node(i, *row) for i, kind in enumerate(self.type_of) for row in kind.locals]
        self.values = len(self.nodes)
        known = set(self.nodes)
        self.nodes += [
            node for i, kind in enumerate(self.type_of) for row in kind.rows if (node := Node(i, *row)) not in known
        ]
        self.number = {node: n for n, node in enumerate(self.nodes)}
        self.states = np.array([self.number[node] for node in plan.derivatives], dtype=np.intp)
        self.held: dict[int, int] = {}  # by the place in d, the node of the sampled output
        self.nexts: dict[int, int] = {}  # the same of discrete updates
        for rate in plan.rates:
            self.held.update((slot, self.number[node]) for node, slot in rate.outputs)
            self.nexts.update((slot, self.number[node]) for node, slot in rate.nexts)
        # Whether there was a tick: what the first tick makes of it stays, and a model is of ticks after the first.
        self.begun: list[tuple[int, float]] = []
        for slot, number in self.nexts.items():
            i, key, e = self.nodes[number]
            tape = plan.instances[i].tape
            operation = tape.nodes[tape.results[key].nodes[e]] if tape.opaque is None else None
            if operation is not None and operation.op == "constant":
                self.begun.append((slot, float(operation.value)))
        sizes = [math.prod(shape) for _, shape, *_ in plan.inputs]
        self.sizes = {
            "x": len(plan.states), "d": len(plan.discretes), "u": sum(sizes), "h": len(plan.histories),
            "v": self.values,
        }  # fmt: skip
        self.first: dict[str, int] = {}
        self.columns = 0
        for row, size in self.sizes.items():
            self.first[row] = self.columns
            self.columns += size
        self.slot_first = np.cumsum([0, *(len(kind.slots) for kind in self.type_of)])
        self.slots = int(self.slot_first[-1])

        roles = [self.plan.instances[i].tape.results[key].role for i, key, _ in self.nodes[: self.values]]
        self.residuals = np.array([n for n, role in enumerate(roles) if role == "residual"], dtype=np.intp)

        moving = [*self.states.tolist(), *self.held.values(), *self.nexts.values()]
        sides = [self.plan.instances[self.nodes[node][0]].condition for node in moving]
        self.enabled = [(node, side) for node, side in zip(moving, sides, strict=True) if side is not None]

    @cached_property
    def at_path(self) -> dict[str, list[int]]:
        """The instances of each path, in order."""
        made: dict[str, list[int]] = {}
        for i, instance in enumerate(self.plan.instances):
            made.setdefault(instance.path, []).append(i)
        return made

    def owner(self, slot: int) -> int:
        """The instance that a slot is of."""
        return int(np.searchsorted(self.slot_first, slot, side="right")) - 1

    def column(self, reference: Reference) -> int:
        """The column of a place of memory; -1 of what never changes."""
        row, index = reference
        if row == "w":
            return self.first["v"] + int(index)
        return self.first[row] + int(index) if row in self.first else -1

    def _select(self) -> None:
        made = np.full(self.slots, -1, dtype=np.intp)
        self.is_wired = np.zeros(self.slots, dtype=bool)
        self.delayed: dict[int, int] = {}
        for i, kind in enumerate(self.type_of):
            arguments, first = self.plan.instances[i].arguments, self.slot_first[i]
            for n, k in enumerate(kind.slots):
                argument = kind.tape.arguments[k]
                if argument.kind == "local":
                    node = Node(i, f"local:{argument.name}", argument.element)
                    made[first + n] = self.first["v"] + self.number[node]
                else:
                    k = kind.by_name[argument.kind, argument.name, argument.element]
                    made[first + n] = self.column(arguments[k])
            self.is_wired[first : first + len(kind.slots)] = kind.is_wired
            for k, n in kind.delayed:
                self.delayed[int(arguments[k].index)] = int(first) + n
        self.selects = made

    def _gather(self) -> None:
        """Where the arguments of all tapes stand, when everything is one row."""
        plan = self.plan
        sizes = {
            "x": self.sizes["x"], "d": self.sizes["d"], "s": len(plan.s_start), "p": len(plan.parameters),
            "u": self.sizes["u"], "tick": len(plan.rates), "h": self.sizes["h"], "w": len(plan.outputs),
            "l": self.values - len(plan.outputs), "t": 1, "c": 1,
        }  # fmt: skip
        begin, self.width = {}, 0
        for row, size in sizes.items():
            begin[row], self.width = self.width, self.width + size
        numbers: dict[float, int] = {}
        for group in self.groups:
            tape = group.type.tape
            made = np.empty((len(tape.arguments), len(group.members)), dtype=np.intp)
            for m, i in enumerate(group.members):
                arguments = plan.instances[i].arguments
                for k, argument in enumerate(tape.arguments):
                    if argument.kind == "local":
                        node = Node(i, f"local:{argument.name}", argument.element)
                        made[k, m] = begin["l"] + self.number[node] - len(plan.outputs)
                        continue
                    row, index = arguments[group.type.by_name[argument.kind, argument.name, argument.element]]
                    if row == "k":
                        made[k, m] = self.width + numbers.setdefault(float(index), len(numbers))
                    else:
                        made[k, m] = begin[row] + (int(index) if row not in ("c", "tick") else 0)
            group.gather = made
            local = [[self.number[Node(i, *row)] for i in group.members] for row in group.type.locals]
            group.locals = np.array(local, dtype=np.intp) - len(plan.outputs) + begin["l"]
        self.begin, self.numbers = begin, np.array(list(numbers), dtype=float)
        rows, slots = [], []
        for group in self.groups:
            kind = group.type
            number = np.array([[self.number[Node(i, *row)] for row in kind.rows] for i in group.members], dtype=np.intp)
            pairs = np.array(kind.pairs, dtype=np.intp).reshape(-1, 2)
            number = number.reshape(len(group.members), len(kind.rows))
            rows.append(number[:, pairs[:, 0]].T.ravel())
            slots.append((self.slot_first[group.members][:, None] + pairs[:, 1]).T.ravel())
        empty = np.empty(0, dtype=np.intp)
        self.partial_rows = np.concatenate([empty, *rows])
        self.partial_slots = np.concatenate([empty, *slots])

        variable = np.full(len(self.nodes), -1, dtype=np.intp)
        variable[: self.values] = self.first["v"] + np.arange(self.values)
        variable[self.states] = self.first["x"] + np.arange(len(self.states))
        for place, which in (*self.held.items(), *self.nexts.items()):
            variable[which] = self.first["d"] + place
        self.variable = variable  # of each node, what it gives, or the rate of which, as a column; -1: of a crossing

    def is_local(self, column: int) -> bool:
        """Whether a column is a local of a block."""
        return len(self.plan.outputs) <= column - self.first["v"] < self.values

    def is_of_ticks(self, column: int) -> bool:
        """Whether a column is a local that sampled equations alone read."""
        if not self.is_local(column):
            return False
        instance, key, _ = self.nodes[column - self.first["v"]]
        return self.type_of[instance].tape.interface.declaration.is_of_ticks(key.removeprefix("local:"))

    @cached_property
    def entry_of(self) -> dict[tuple[int, int], int]:
        """The number of each partial by its node and slot."""
        pairs = zip(self.partial_rows.tolist(), self.partial_slots.tolist(), strict=True)
        return {pair: n for n, pair in enumerate(pairs)}

    # --- numbers ---------------------------------------------------------------------------------------------------

    def everything(self, point: Point) -> Array:
        """All that equations read, in one row."""
        t, x, d, s, p, u, k, h, *_ = point.memory
        values = np.empty(self.width + len(self.numbers))
        parts = {"x": x, "d": d, "s": s, "p": p, "u": u, "h": h, "w": point.outputs}
        values[self.begin["tick"] : self.begin["h"]] = k
        for row, numbers in parts.items():
            values[self.begin[row] : self.begin[row] + len(numbers)] = numbers
        for slot, value in self.begun:
            values[self.begin["d"] + slot] = value
        values[self.begin["t"]], values[self.begin["c"]] = t, 0.0
        values[self.width :] = self.numbers
        for group in self.groups:  # locals, by the tapes that see through them
            kind = group.type
            if not kind.locals:
                continue
            nodes = [kind.original.results[key].nodes[e] for key, e in kind.locals]
            arguments = [values[group.gather[k]] for k in kind.fine_at]
            made = on_arrays(kind.original, nodes, arguments, group.tables)
            for places, value in zip(group.locals, made, strict=True):
                values[places] = value
        return values

    def at(self, point: Point) -> Slopes:
        """The partial derivatives at a point, with the laws that have none there."""
        everything = self.everything(point)
        numbers, first = np.empty(len(self.partial_rows)), 0
        told: dict[int, str] = {}
        for group in self.groups:
            kind, size = group.type, len(group.members)
            if kind.tape.opaque is not None:
                made = numbers[first : first + len(kind.pairs) * size].reshape(len(kind.pairs), size)
                for m, i in enumerate(group.members):
                    made[:, m], told[i] = _of_fmu(kind, point, i, everything[group.gather[:, m]])
                first += made.size
                continue
            arguments = list(everything[group.gather])
            for tape, nodes, sums in kind.tapes:
                begin = first
                for value in on_arrays(tape, nodes, arguments, group.tables):
                    numbers[first : first + size] = value
                    first += size
                if sums:  # kp - ki kp/ki is 0, and not what rounding makes of it
                    for n, terms in enumerate(terms_on_arrays(tape, nodes, arguments, group.tables)):
                        part = numbers[begin + n * size : begin + (n + 1) * size]
                        part[np.abs(part) <= _ROUNDING * terms] = 0.0
        slopes = Slopes(self, point, everything, numbers, told)
        slopes.find_laws()
        return slopes

    def node_name(self, number: int) -> str:
        return self.plan.node_name(self.nodes[number])

    def slot_name(self, slot: int) -> str:
        """How what a slot reads is called: block.port, or block.variable where it is no port."""
        i = self.owner(slot)
        kind, path = self.type_of[i], self.plan.instances[i].path
        argument = kind.tape.arguments[kind.slots[slot - int(self.slot_first[i])]]
        interface = kind.tape.interface
        for port in (interface.inputs if argument.kind == "input" else interface.outputs).values():
            if port.variable == argument.name and 0 <= argument.element - port.first < port.size:
                return f"{path}.{port.name}" + (f"[{argument.element - port.first}]" if port.size > 1 else "")
        same = sum(1 for a in kind.tape.arguments if (a.kind, a.name) == (argument.kind, argument.name))
        return f"{path}.{argument.name}" + (f"[{argument.element}]" if same > 1 else "")

    @cached_property
    def stepped(self) -> tuple[tuple[int, int], ...]:
        """Nodes and slots of whole numbers that they depend on: a jump passes there, whatever the slope."""
        made = []
        for i, kind in enumerate(self.type_of):
            first = int(self.slot_first[i])
            if kind.tape.opaque is None and kind.still:
                for row in kind.rows:
                    made += [(self.number[Node(i, *row)], first + kind.slot_of[k]) for k in kind.steps(row)]
        return tuple(made)


class Slopes:
    """Partial derivatives at a point: `data` over (partial_rows, partial_slots) of the graph.

    laws: the nodes that have no one slope here. methods: by instance, how the derivatives of FMUs were had.
    """

    def __init__(self, graph: Graph, point: Point, everything: Array, data: Array, methods: Mapping[int, str]) -> None:
        self.graph, self.point, self.everything, self.data, self.methods = graph, point, everything, data, methods
        self.laws: list[Law] = []
        self.sizes = self._sizes()
        sides = point.memory[3]
        self.off = np.zeros(len(graph.nodes), dtype=bool)  # nodes that do not move, in subdiagrams that are off
        for node, side in graph.enabled:
            self.off[node] = not sides[side]

    def everything_of(self, slot: int) -> float:
        """The value that a slot reads at the point."""
        graph = self.graph
        i = graph.owner(slot)
        group, member = graph.group_of[i]
        k = group.type.slots[slot - int(graph.slot_first[i])]
        return float(self.everything[group.gather[k, member]])

    def _sizes(self) -> Array:
        """Of each column, how large the terms are that it is the sum of: what rounding and tolerances are part of."""
        graph = self.graph
        made = np.zeros(graph.columns + 1)  # the last one: of constants
        for row in ("x", "d", "u", "h"):
            values = self.everything[graph.begin[row] : graph.begin[row] + graph.sizes[row]]
            made[graph.first[row] : graph.first[row] + graph.sizes[row]] = np.abs(values)
        begin = graph.begin["w"]
        own = np.abs(self.everything[begin : begin + graph.values])
        made[graph.first["v"] : graph.first["v"] + graph.values] = own
        keep = (graph.partial_rows < graph.values) & np.isfinite(self.data)
        terms = np.zeros(graph.values)
        read = made[graph.selects[graph.partial_slots[keep]]]
        np.add.at(terms, graph.partial_rows[keep], np.abs(self.data[keep]) * np.where(np.isfinite(read), read, 0.0))
        made[graph.first["v"] : graph.first["v"] + graph.values] = np.fmax(own, terms)
        return made

    def find_laws(self) -> None:
        """Look at both sides of every equation that may have no slope."""
        graph = self.graph
        first = 0
        for group in graph.groups:
            kind, size = group.type, len(group.members)
            places = {pair: first + n * size for n, pair in enumerate(kind.pairs)}
            first += len(kind.pairs) * size
            if kind.bends:
                self._probe(group, places)
        bad = ~np.isfinite(self.data)
        known = {(law.node, law.slot) for law in self.laws}
        for n in np.nonzero(bad)[0].tolist():
            node, slot = int(graph.partial_rows[n]), int(graph.partial_slots[n])
            if (node, slot) not in known:
                self._add(node, slot, "infinite slope")

    def _add(self, node: int, slot: int, kind: str) -> None:
        graph = self.graph
        path = graph.plan.instances[graph.nodes[node][0]].path
        by = graph.slot_name(slot).removeprefix(f"{path}.")
        self.laws.append(Law(node, slot, path, graph.node_name(node).removeprefix(f"{path}."), by, kind))

    def _probe(self, group: _Group, places: Mapping[tuple[int, int], int]) -> None:
        graph, kind, members = self.graph, group.type, group.members
        arguments = list(self.everything[group.gather])
        tables = group.tables
        slot_first = graph.slot_first[members]
        steps: dict[int, Array] = {}
        for n, k in enumerate(kind.slots):
            sizes = NEAR * self.sizes[graph.selects[slot_first + n]]
            steps[k] = np.where(sizes > 0, sizes, NEAR)
        turns = self._turns(group, arguments, steps, tables)
        for row in kind.bends:
            r = kind.row_of[row]
            needs = kind.tape.read_by[row[0]][row[1]]
            reads = [k for k in needs if k in kind.slot_of and k not in kind.still]
            flips = [turn for turn in turns if not turn.changes.keys().isdisjoint(needs)]
            if not reads and not flips:
                continue
            made = jacobian(kind.tape, [row], reads) if reads else kind.tape
            nodes = [kind.tape.results[row[0]].nodes[row[1]]]
            wanted = [made.results["value"].nodes[0], *made.results["partial"].nodes] if reads else nodes
            moves: list[Mapping[int, Array]] = [{}]
            for k in reads:
                moves += [{k: arguments[k] + steps[k]}, {k: arguments[k] - steps[k]}]
            moves += [turn.changes for turn in flips]

            def at(
                moves: Sequence[Mapping[int, Array]], of: Any = on_arrays, made: Tape = made, wanted: list[int] = wanted
            ) -> Array:
                """The value and the partials where some arguments are others: (1 + reads, moves, members)."""
                moved = list(arguments)
                for k in {k for move in moves for k in move}:
                    moved[k] = np.stack([move.get(k, arguments[k]) for move in moves])
                found = np.empty((len(wanted), len(moves), len(members)))
                for n, value in enumerate(of(made, wanted, moved, tables)):
                    found[n] = value
                return found

            everywhere = at(moves)
            here = everywhere[:, 0]
            noise: Array | None = None  # what rounding may make of these; known where something differs
            for c, k in enumerate(reads, 1):
                step, slot = steps[k], kind.slot_of[k]
                above, below = everywhere[:, 2 * c - 1], everywhere[:, 2 * c]
                *_, rough = _compared(here, above, below, c, step, np.zeros_like(here))
                if not rough.any():
                    continue
                noise = at(moves, terms_on_arrays) if noise is None else noise
                rounding = 2.0 * _ROUNDING * noise[:, [0, 2 * c - 1, 2 * c]].max(axis=1)
                largest, jumps, differs, rough = _compared(here, above, below, c, step, rounding)
                if not rough.any():
                    continue
                both = [{k: arguments[k] + f * step} for f in (_FAR, -_FAR, 1e-2, 1e-6)]
                far, behind, nearer, nearest = at(both)[c]
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
                at_place = places.get((r, slot))
                if at_place is not None:
                    self.data[at_place : at_place + len(members)][known] = nearest[known]
                for m in np.nonzero(jumps | bends | infinite)[0].tolist():
                    sided = bends[m] and not grows[m] and np.isfinite(above[c][m]) and np.isfinite(below[c][m])
                    what = "jump" if jumps[m] else "corner" if sided else "infinite slope"
                    self._add(graph.number[Node(members[m], *row)], int(slot_first[m]) + slot, what)
            for n, turn in enumerate(flips, 1 + 2 * len(reads)):
                other = everywhere[:, n]
                noise = at(moves, terms_on_arrays) if noise is None else noise
                rounding = 2.0 * _ROUNDING * noise[:, [0, n]].max(axis=1)
                with np.errstate(all="ignore"):
                    largest = np.fmax(np.abs(other[1:]), np.abs(here[1:]))
                    reach = sum(
                        (row_ * steps[k] for row_, k in zip(largest, reads, strict=True)), np.zeros(len(members))
                    )
                    least = 1e3 * reach + 1e-12 * np.abs(here[0]) + rounding[0] + 1e-300
                    jumps = np.abs(other[0] - here[0]) > least
                    apart = np.abs(other[1:] - here[1:]) > _DIFFERS * largest + rounding[1:] + 1e-300
                for m in np.nonzero(turn.near & (jumps | apart.any(axis=0)))[0].tolist():
                    node, what = graph.number[Node(members[m], *row)], "jump" if jumps[m] else "corner"
                    for k in turn.by:
                        self._add(node, int(slot_first[m]) + kind.slot_of[k], what)

    def _turns(
        self, group: _Group, arguments: list[Array], steps: Mapping[int, Array], tables: list[Array]
    ) -> list[_Turn]:
        """What a change of nothing would turn: sides, and discretes that crossings reset."""
        kind, made = group.type, list[_Turn]()
        size = len(group.members)
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
            made.append(_Turn({k: 1.0 - arguments[k]}, near, by))
            resets = kind.resets.get(argument.name)
            if not resets:
                continue
            # Beyond the crossing, and there with what else the resets read a little off.
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
                    made.append(_Turn(new, near & differs, [*by, *(j for j in others if j in move)]))
        return made


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


def _of_fmu(kind: _Type, point: Point, instance: int, values: Array) -> tuple[Array, str]:
    """The partials of an FMU, and how they were had. Raises AnalysisError (E701) where differences do not agree.

    Its local variables have no directional derivatives: theirs are differences, and NaN where these do not agree.
    """
    unit = point.foreign[point.plan.foreign_of[instance]]
    asked = [(kind.rows[r], kind.slots[s]) for r, s in kind.pairs]
    values = values.copy()
    made = np.full(len(asked), math.nan)
    if unit.interface.directional:
        if unit.is_reliable is None:
            unit.partials(asked, values.tolist())  # which compares them with differences
        if unit.is_reliable:
            made[:] = unit.exact(asked, values.tolist())
    rest = [n for n in range(len(asked)) if not math.isfinite(made[n])]
    inner = {row for row, _ in asked if not unit.has_directional(unit.item(*row))}
    is_exact = all(asked[n][0] in inner for n in rest)
    method = "directional derivatives" if unit.is_reliable and is_exact else "central differences of two steps"
    if not rest:
        return made, method
    rows = list(dict.fromkeys(asked[n][0] for n in rest))
    place = {row: n for n, row in enumerate(rows)}
    request = Request.of(kind.tape, rows)

    def results(at: Array) -> Array:
        given = [at[k] for k in request.arguments]
        return np.array(unit.values(request, given[0], *given[1:]), dtype=float)

    for k in dict.fromkeys(asked[n][1] for n in rest):
        size = max(abs(values[k]), _nominal(kind, k))
        quotients = []
        for step in (1e-4 * size, 1e-5 * size):
            up, down = values.copy(), values.copy()
            up[k] += step
            down[k] -= step
            quotients.append((results(up) - results(down)) / (up[k] - down[k]))
        for n in rest:
            row, slot = asked[n]
            if slot == k:
                one, two = quotients[0][place[row]], quotients[1][place[row]]
                largest = max(float(np.nanmax(np.abs(quotients[1]))), abs(one), abs(two))
                if not abs(one - two) <= 1e-3 * max(abs(one), abs(two)) + 1e-9 * largest:
                    path = point.plan.instances[instance].path
                    by = kind.tape.arguments[k].name
                    message = f"differences of two steps by {by} give {one:.6g} and {two:.6g}: it has no slope here."
                    cure = "Choose another operating point, or estimate the response by simulation."
                    if row not in inner:
                        raise AnalysisError(Fault("E701", f"{path}.{row[0].partition(':')[2]}", message, cure))
                    two = math.nan
                made[n] = two
    results(values)
    return made, method


def _nominal(kind: _Type, k: int) -> float:
    argument = kind.tape.arguments[k]
    state = kind.tape.interface.declaration.states.get(argument.name)
    nominal = state.nominal if state is not None else 1.0
    assert not callable(nominal)  # that of an FMU's state is a number
    return float(nominal)
