"""The interconnection of a Plan's equations.

    graph = Interconnection(plan)          # the structure: once
    slopes = slopes_at(point)              # numbers (`slopes`): of each equation by each of its arguments

Every result of a block (an output, a derivative, an update at a tick) and every local of it is a node of its own. What
a node reads are its slots; a slot reads a column: a state, a discrete, an input, a delayed value, or another node. So
the diagram is two sparse matrices,

    change of the nodes = partials (nodes x slots) * selection (slots x columns) * change of the columns,

and `selection` holds the wires only. A law is studied or replaced as its entry of `partials`, and an analysis point is
another entry of `selection`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..compile.fmu_tape import FmuTape
from ..compile.plan import Node, Plan, Reference
from ..text.arrays import Array
from .type_partials import TypePartials


@dataclass(slots=True)
class BlockGroup:
    """Blocks of one type and with the same tables.

    gather, locals: where the arguments and the locals stand when everything is one row, (arguments or locals, members).
    """

    type: TypePartials
    tables: list[Array]
    members: list[int] = field(default_factory=list)
    gather: Array = field(default_factory=lambda: np.empty((0, 0), dtype=np.intp))
    locals: Array = field(default_factory=lambda: np.empty((0, 0), dtype=np.intp))


class Interconnection:
    """The structure of a Plan: nodes, slots and what each slot reads.

    nodes: (instance, result key, element), those that others read (plan.outputs, then locals) first: `values` of them.
    states, nexts, held: numbers of the nodes that are dx/dt, the updates at ticks with their place in d, and sampled
    outputs with theirs. selects: the column of each slot by its number (-1: a constant). is_wired: by slot, whether it
    is an input of a block, where a wire ends; other slots read the block itself. delayed: by delayed value, the slot of
    the input that is delayed.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        types: dict[int, TypePartials] = {}
        groups: dict[object, BlockGroup] = {}
        self.type_of: list[TypePartials] = []
        for index, instance in enumerate(plan.instances):
            kind = types.get(id(instance.tape))
            if kind is None:
                kind = types[id(instance.tape)] = TypePartials(instance.tape)
            self.type_of.append(kind)
            tables = tuple(reference for reference in instance.arguments if reference.row == "c")
            key = (id(instance.tape), tables)
            if key not in groups:
                groups[key] = BlockGroup(kind, [np.array(plan.tables[int(place)]) for _, place in tables])
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
        # Discretes that the first tick sets for good: a model describes the ticks after the first.
        self.begun: list[tuple[int, float]] = []
        for slot, number in self.nexts.items():
            i, key, e = self.nodes[number]
            tape = plan.instances[i].tape
            operation = None if isinstance(tape, FmuTape) else tape.nodes[tape.results[key].nodes[e]]
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
        indices: dict[str, list[int]] = {}
        for i, instance in enumerate(self.plan.instances):
            indices.setdefault(instance.path, []).append(i)
        return indices

    def owner(self, slot: int) -> int:
        """The instance that a slot belongs to."""
        return int(np.searchsorted(self.slot_first, slot, side="right")) - 1

    def column(self, reference: Reference) -> int:
        """The column of a place of memory; -1 for what never changes."""
        row, index = reference
        if row == "w":
            return self.first["v"] + int(index)
        return self.first[row] + int(index) if row in self.first else -1

    def _select(self) -> None:
        columns = np.full(self.slots, -1, dtype=np.intp)
        self.is_wired = np.zeros(self.slots, dtype=bool)
        self.delayed: dict[int, int] = {}
        for i, kind in enumerate(self.type_of):
            arguments, first = self.plan.instances[i].arguments, self.slot_first[i]
            for n, k in enumerate(kind.slots):
                argument = kind.tape.arguments[k]
                if argument.kind == "local":
                    node = Node(i, f"local:{argument.name}", argument.element)
                    columns[first + n] = self.first["v"] + self.number[node]
                else:
                    k = kind.by_name[argument.kind, argument.name, argument.element]
                    columns[first + n] = self.column(arguments[k])
            self.is_wired[first : first + len(kind.slots)] = kind.is_wired
            for k, n in kind.delayed:
                self.delayed[int(arguments[k].index)] = int(first) + n
        self.selects = columns

    def _gather(self) -> None:
        """The positions of the arguments of all tapes, when everything is one row."""
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
            positions = np.empty((len(tape.arguments), len(group.members)), dtype=np.intp)
            for m, i in enumerate(group.members):
                arguments = plan.instances[i].arguments
                for k, argument in enumerate(tape.arguments):
                    if argument.kind == "local":
                        node = Node(i, f"local:{argument.name}", argument.element)
                        positions[k, m] = begin["l"] + self.number[node] - len(plan.outputs)
                        continue
                    row, index = arguments[group.type.by_name[argument.kind, argument.name, argument.element]]
                    if row == "k":
                        positions[k, m] = self.width + numbers.setdefault(float(index), len(numbers))
                    else:
                        positions[k, m] = begin[row] + (int(index) if row not in ("c", "tick") else 0)
            group.gather = positions
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
        self.variable = variable  # by node, the column that it gives, or whose rate it gives; -1: a crossing

    @cached_property
    def moves(self) -> Array:
        """Whether the signal of each slot can change at a fixed time: constants and functions of time alone cannot."""
        moving = np.ones(self.columns + 1, dtype=bool)  # the last one: of what never changes
        moving[-1] = False
        reads: dict[int, list[int]] = {}  # by column, the columns that its equation reads
        for n, (i, key, element) in enumerate(self.nodes[: self.values]):
            kind, first = self.type_of[i], int(self.slot_first[i])
            if not isinstance(kind.tape, FmuTape):
                slots = [first + kind.slot_of[k] for k in kind.signals((key, element))]
                reads[int(self.variable[n])] = [int(self.selects[slot]) for slot in slots]
        readers: dict[int, list[int]] = {}
        for column, read in reads.items():
            for other in {*read}:
                readers.setdefault(other, []).append(column)
        still = [-1, *(column for column, read in reads.items() if not read)]
        while still:
            at = still.pop()
            moving[at] = False
            ahead = readers.get(at, ())
            still += [c for c in ahead if moving[c] and not any(moving[read] for read in reads[c])]
        return moving[self.selects]

    def is_local(self, column: int) -> bool:
        """Whether a column is a local of a block."""
        return len(self.plan.outputs) <= column - self.first["v"] < self.values

    def is_of_ticks(self, column: int) -> bool:
        """Whether a column is a local that sampled equations alone read."""
        if not self.is_local(column):
            return False
        instance, key, _ = self.nodes[column - self.first["v"]]
        return key.removeprefix("local:") in self.type_of[instance].tape.sampled_locals

    @cached_property
    def entry_of(self) -> dict[tuple[int, int], int]:
        """The number of each partial by its node and slot."""
        pairs = zip(self.partial_rows.tolist(), self.partial_slots.tolist(), strict=True)
        return {pair: n for n, pair in enumerate(pairs)}

    def node_name(self, number: int) -> str:
        return self.plan.node_name(self.nodes[number])

    def slot_name(self, slot: int) -> str:
        """The name of what a slot reads: block.port, or block.variable where it is no port."""
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
        pairs = []
        for i, kind in enumerate(self.type_of):
            first = int(self.slot_first[i])
            if not isinstance(kind.tape, FmuTape) and kind.still:
                for row in kind.rows:
                    pairs += [(self.number[Node(i, *row)], first + kind.slot_of[k]) for k in kind.steps(row)]
        return tuple(pairs)
