"""Exact sparse derivatives of a Plan: how its results change with its memory.

    jacobian = PlanJacobian(plan)                     # d(dx/dt)/dx
    exact = jacobian.at(memory, outputs)              # outputs: values of jacobian.outputs, by an engine
    exact.dense()                                     # an array; NaN where a derivative is not finite
    exact.doubtful()                                  # which equations those are

    PlanJacobian(plan, [*plan.derivatives, *y], [*x, *u])        # A, B, C and D in one matrix

Between a result and a state there is a chain of blocks. The partial derivatives of each block's results by its
arguments are exact, by its type's tape; equal instances are computed at once, as arrays. They are then combined in Plan
order:

    dw = sum over the arguments of w: dw/da da          (an algebraic loop F(w, a) = 0: F_w dw = -F_a da)

Which entries can differ from 0 follows from the structure and never changes, so the work is laid out once, as indices
of partials and entries, stage by stage.

Derivatives are those between instants: discretes, sides, histories and tick numbers are constants, and the states of
subdiagrams that are off stand still. A derivative that is inf or NaN (|e|^alpha at 0, sqrt at 0) says nothing, and all
that depends on it becomes NaN: `completed` puts difference quotients there.

Of a diagram with copies, d(dx/dt)/dx is found by its plan of one copy, where a row stands for all lanes of an instance
and each entry knows its lane: what is done for each row grows with types, and only arrays grow with copies.

References: A. Griewank, A. Walther, Evaluating Derivatives, SIAM 2008, chapters 7 (sparse accumulation) and 15
(implicit functions); A. Curtis, M. Powell, J. Reid, On the estimation of sparse Jacobian matrices, 1974 (columns that
share a difference quotient).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import accumulate, chain
from typing import Any

import numpy as np

from ..contract.closure import closure
from ..contract.scalars import LOGICAL, OPERATIONS
from ..contract.tape import Tape
from ..contract.tracing import jacobian
from ..text.arrays import Array
from .fmu_tape import FmuTape
from .folding import Folded
from .plan import AlgebraicLoop, Node, Plan, Program, Reference
from .scheduler import schedule

_LARGE = 4096  # partials of one group; a larger one is derived result by result, each by what it alone reads


@dataclass(frozen=True, slots=True)
class Doubt:
    """A derivative that is not finite: the block, its equation, and the variable that it is taken by."""

    block: str
    equation: str
    by: str


class PlanJacobian:
    """The derivatives of `of` by `by`: by default those of all rates of change by all states.

    of: nodes, or references. by: references, each once. A place of w in `by` is cut: what reads it sees a variable of
    its own (the node in `of` is then what the block would give). shape: (results, variables). indptr, indices: the
    pattern in CSC, rows in order. outputs: the places of w whose values the partials need; probed: the same in the plan
    of one copy, where each is that of all copies.

    How it is computed, for those who print it: all that is read is one row (x d s p u tick h, outputs, t, numbers).
    `gather` takes the arguments of `groups` from it, and their results are the partials (npartials; `unused` ones are
    0, and those in off_partials where a side is 0). `stages` then computes the entries (nentries; the first is 1), and
    data_at says which of them are the values of the pattern (those in `off` are 0 where a side is 0).
    """

    def __init__(
        self, plan: Plan, of: Sequence[Node | Reference] | None = None, by: Sequence[Reference] | None = None
    ) -> None:
        folded: Folded | None = plan.folded if of is None and by is None else None
        folded = Folded(plan, (None,) * len(plan.instances), {}, {}) if folded is None else folded
        own = folded.plan
        self.of: tuple[Node | Reference, ...] = tuple(own.derivatives if of is None else of)
        self.by = tuple([Reference("x", i) for i in range(len(own.states))] if by is None else by)
        if len(set(self.by)) != len(self.by):
            raise ValueError("each variable can be derived by once only")
        builder = _JacobianBuilder(folded, self.of, self.by)
        self.shape = (sum(folded.lanes("x", i) for i in range(len(self.of))), builder.width)
        builder.accumulate()
        self._lay_out(plan, builder)

    @property
    def density(self) -> float:
        """The part of all entries that can differ from 0."""
        return len(self.indices) / max(1, self.shape[0] * self.shape[1])

    def _lay_out(self, plan: Plan, builder: _JacobianBuilder) -> None:
        """Everything in the order in which it is computed."""
        # Entries are numbered by stage, those of a loop side by side; entry 0 is the 1 of a variable by itself.
        rank = np.array(builder.rank, dtype=np.intp)
        order = np.argsort(rank, kind="stable")
        number = np.empty(len(rank) + 1, dtype=np.intp)
        number[order] = np.arange(1, len(rank) + 1)
        number[-1] = 0  # the index -1 stands for entry 0
        target, partial, source = (_joined(parts) for parts in (builder.targets, builder.partials, builder.sources))
        target, source = number[target], number[source]
        by_target = np.argsort(target, kind="stable")
        target, partial, source = target[by_target], partial[by_target], source[by_target]
        ranks, first = np.unique(rank[order], return_index=True)
        bounds = [*(first + 1).tolist(), len(rank) + 1]
        self.stages: list[Sum | Solve] = []
        for r, lo, hi in zip(ranks.tolist(), bounds, bounds[1:], strict=False):
            if r % 2:
                self.stages += [solve.placed(number) for solve in builder.loops if solve.rank == r]
                continue
            a, b = np.searchsorted(target, (lo, hi))
            starts = np.searchsorted(target[a:b], np.arange(lo, hi))
            many = None if b - a == hi - lo else starts
            self.stages.append(Sum(lo, hi, partial[a:b], source[a:b] if source[a:b].any() else None, many))
        self.nentries = len(rank) + 1

        rows, columns, entries = [], [], []
        off: dict[int, list[int]] = {}  # rows of states that stand still, by the side that says so
        variables = {reference: j for j, reference in enumerate(self.by)}
        for i, item in enumerate(self.of):
            if isinstance(item, Node) and item.key.startswith("derivative:"):
                condition = builder.plan.instances[item.instance].condition
                if condition is not None:
                    off.setdefault(condition, []).append(i)
            if item in variables:
                row, own, own_entries = np.array([i]), np.array([variables[item]]), np.array([-1])
            else:
                node = builder.node(item)
                lane, own, own_entries = _NOTHING if node is None else builder.rows.get(node, _NOTHING)
                row = np.array(builder.folded.places("x", i))[lane]
            rows.append(row)
            columns.append(own)
            entries.append(number[own_entries])
        row, column, entry = _joined(rows), _joined(columns), _joined(entries)
        order = np.lexsort((row, column))
        self.indices = row[order].astype(np.int32)
        self.indptr = np.searchsorted(column[order], np.arange(self.shape[1] + 1)).astype(np.int32)
        self.data_at = entry[order]
        self.off = [(side, np.isin(self.indices, rows)) for side, rows in off.items()]

        self.groups = builder.groups
        self.npartials = builder.count
        used = np.zeros(builder.count, dtype=bool)
        used[partial] = True
        for solve in builder.loops:
            used[solve.inner[1]] = used[solve.outer[1]] = True
        self.unused = ~used
        self.off_partials = [(side, np.array(numbers)) for side, numbers in builder.off.items()]
        self._path = builder.folded.path
        self._foreign_of = builder.plan.foreign_of
        self.probed = builder.outputs
        of_probed = [builder.folded.shown(reference.index) for reference in self.probed]
        self.outputs = tuple(chain.from_iterable(of_probed))
        self.numbers = np.array(list(builder.numbers), dtype=float)
        # Where rows of memory begin in one array of all.
        sizes = {
            "x": len(plan.states), "d": len(plan.discretes), "s": len(plan.s_start), "p": len(plan.parameters),
            "u": sum(int(np.prod(shape)) for _, shape, *_ in plan.inputs), "tick": len(plan.rates),
            "h": len(plan.histories), "w": len(self.outputs), "t": 1, "k": len(self.numbers),
        }  # fmt: skip
        self._sizes = tuple(sizes.values())
        self.width = sum(self._sizes)
        ends = np.cumsum(list(sizes.values())).tolist()
        begin = {row: end - sizes[row] for row, end in zip(sizes, ends, strict=True)}
        ends_w = accumulate(map(len, of_probed))
        place_w = {
            one: range(end - len(own), end) for one, own, end in zip(self.probed, of_probed, ends_w, strict=True)
        }

        def places(reference: Reference, lanes: int) -> Sequence[int]:
            row, index = reference
            if row == "k":
                return [int(begin["k"]) + builder.numbers[index]] * lanes
            own = place_w[reference] if row == "w" else builder.folded.places(row, index)
            if len(own) < lanes or hasattr(index, "lane"):  # of one copy, for all
                return [int(begin[row]) + own[getattr(index, "lane", 0)]] * lanes
            return range(begin[row] + own[0], begin[row] + own[-1] + 1, own.step)

        self.gather = np.fromiter(chain.from_iterable(places(*read) for read in builder.arguments()), dtype=np.intp)
        self._single = sum(len(group.reads) for group in self.groups if len(group.members) == 1)

    def at(self, memory: Sequence[Any], outputs: Sequence[float]) -> Evaluated:
        """The derivatives where memory is (t, x, d, s, p, u, k, h, z) and self.outputs have these values.

        Raises ValueError where a row of memory has another length than the Plan says.
        """
        t, x, d, s, p, u, k, h, *_ = memory
        parts = [x, d, s, p, u, k, h, outputs, (t,), self.numbers]
        if tuple(map(len, parts)) != self._sizes:
            raise ValueError(f"memory has rows of {tuple(map(len, parts))}, and not of {self._sizes}")
        with np.errstate(all="ignore"):
            arguments = np.concatenate([np.asarray(part, dtype=float) for part in parts])[self.gather]
            partials = self._derived(arguments, memory[9] if len(memory) > 9 else ())
            partials[self.unused] = 0.0
            for side, numbers in self.off_partials:
                if not s[side]:
                    partials[numbers] = 0.0
            bad = np.nonzero(~np.isfinite(partials))[0]
            partials[bad] = np.nan
            values = np.empty(self.nentries)
            values[0] = 1.0
            for stage in self.stages:
                stage.run(partials, values)
            data = values[self.data_at]
        for side, entries in self.off:
            if not s[side]:
                data[entries] = 0.0
        return Evaluated(self, data, tuple(bad.tolist()))

    def _derived(self, arguments: Array, foreign: Any) -> Array:
        partials = np.empty(self.npartials)
        single, place = arguments[: self._single].tolist(), 0
        scalars: list[float] = []
        for group in self.groups:
            size = len(group.members)
            values = list(group.template)
            if isinstance(group.tape, FmuTape):
                points = np.array(single[place : place + len(group.reads)]).reshape(1, -1)
                if size > 1:
                    points = arguments[place : place + len(group.reads) * size].reshape(-1, size).T
                place += points.size
                for member, ((index, _), point) in enumerate(zip(group.members, points.tolist(), strict=True)):
                    derivatives = foreign[self._foreign_of[index]].partials(group.asked, point)
                    if size == 1:
                        scalars += derivatives
                    else:
                        partials[group.first + member : group.first + len(derivatives) * size : size] = derivatives
                continue
            if size == 1:  # these come first
                for n in group.reads:
                    values[n] = single[place]
                    place += 1
                for n, function, operands in group.operations:
                    values[n] = function(*[values[k] for k in operands])
                scalars += [values[n] for n in group.results_at]
                continue
            for n in group.reads:
                values[n] = arguments[place : place + size]
                place += size
            for n, function, operands in group.operations:
                values[n] = function(*[values[k] for k in operands])
            for number, n in enumerate(group.results_at):
                begin = group.first + number * size
                partials[begin : begin + size] = values[n]
        partials[: len(scalars)] = scalars
        return partials

    def doubts(self, numbers: Iterable[int]) -> tuple[Doubt, ...]:
        """The equations and variables of partials, by their numbers."""
        doubts: dict[Doubt, None] = {}
        for number in numbers:
            group = next(g for g in reversed(self.groups) if g.first <= number)
            pair, member = divmod(number - group.first, len(group.members))
            key, argument = group.pairs[pair]
            block = self._path(*group.members[member])
            if isinstance(group.tape, FmuTape):
                doubts[Doubt(block, key.partition(":")[2], group.tape.arguments[argument].name)] = None
                continue
            equation = group.tape.equation_of[":".join(key.split(":")[:2])]
            doubts[Doubt(block, equation, group.tape.arguments[argument].name)] = None
        return tuple(doubts)


@dataclass(frozen=True)
class Evaluated:
    """The derivatives of a PlanJacobian at one point. data: the values of its pattern; NaN: not finite."""

    jacobian: PlanJacobian
    data: Array
    bad: tuple[int, ...] = field(repr=False, default=())

    def dense(self) -> Array:
        matrix = np.zeros(self.jacobian.shape)
        matrix[self.jacobian.indices, self._columns] = self.data
        return matrix

    def doubtful(self) -> tuple[Doubt, ...]:
        """The equations with partial derivatives that are not finite."""
        return self.jacobian.doubts(self.bad)

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.data).all())

    @property
    def _columns(self) -> Array:
        return np.repeat(np.arange(self.jacobian.shape[1]), np.diff(self.jacobian.indptr))

    def completed(self, function: Callable[[Array], Array], at: Array, sizes: Array) -> Evaluated:
        """The same with difference quotients for NaN, and only for those.

        function: from values of `by` to values of `of`. at: the values of `by` here. sizes: the scale of each
        variable; a quotient is taken over sqrt(eps) of it, upward, or downward where that is not finite. Where neither
        is finite, NaN stays.
        """
        if self.is_finite:
            return self
        data, indices, columns = self.data.copy(), self.jacobian.indices, self._columns
        base = function(at)
        for sign in (1.0, -1.0):
            missing = np.isnan(data)
            for together in self._apart(np.unique(columns[missing])):
                moved = at.copy()
                moved[together] += sign * np.sqrt(np.finfo(float).eps) * sizes[together]
                steps = moved - at
                change = function(moved) - base
                mine = missing & np.isin(columns, together)
                data[mine] = change[indices[mine]] / steps[columns[mine]]
            data[~np.isfinite(data)] = np.nan
        return replace(self, data=data)

    def _apart(self, columns: Array) -> list[list[int]]:
        """Columns in groups that have no row in common."""
        indices, ends = self.jacobian.indices, self.jacobian.indptr
        return apart({j: set(indices[ends[j] : ends[j + 1]].tolist()) for j in columns.tolist()})


def apart(rows_of: Mapping[int, set[int]]) -> list[list[int]]:
    """Put columns into groups that have no row in common. rows_of: the rows of each."""
    groups: list[tuple[set[int], list[int]]] = []
    for column, rows in rows_of.items():
        free = next((group for group in groups if not group[0] & rows), None)
        if free is None:
            groups.append(({*rows}, [column]))
        else:
            free[0].update(rows)
            free[1].append(column)
    return [group for _, group in groups]


# --- stages ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Sum:
    """Entries lo ... hi - 1: sums of partials times earlier entries.

    sources None: these are all 1. starts: where the terms of each entry begin; None: one term each.
    """

    lo: int
    hi: int
    partials: Array
    sources: Array | None
    starts: Array | None

    def run(self, partials: Array, values: Array) -> None:
        terms = partials[self.partials]
        if self.sources is not None:
            terms *= values[self.sources]
        values[self.lo : self.hi] = terms if self.starts is None else np.add.reduceat(terms, self.starts)


@dataclass(frozen=True, slots=True)
class Solve:
    """The entries of an algebraic loop, a full matrix (unknowns, columns): F_w dw = -F_a da.

    inner, outer: the flat places of the terms of F_w and F_a, their partials, and, for outer ones, the entries they
    are multiplied by. own: the diagonal's -1 for equations w = f(w, a).
    """

    rank: int
    lo: int
    hi: int
    own: Array
    inner: tuple[Array, Array]
    outer: tuple[Array, Array, Array]

    def placed(self, number: Array) -> Solve:
        """The same by the final numbers of entries, which keep those of a loop side by side."""
        place, partials, sources = self.outer
        lo = int(number[self.lo]) if self.hi > self.lo else self.lo
        return replace(self, lo=lo, hi=lo + self.hi - self.lo, outer=(place, partials, number[sources]))

    def run(self, partials: Array, values: Array) -> None:
        n = len(self.own)
        place, numbers = self.inner
        matrix = np.bincount(place, partials[numbers], n * n).reshape(n, n) - np.diag(self.own)
        place, numbers, sources = self.outer
        right = np.bincount(place, partials[numbers] * values[sources], self.hi - self.lo).reshape(n, -1)
        scale = np.max(np.abs(matrix), axis=1, keepdims=True)
        solution = np.full(right.shape, np.nan)
        if np.isfinite(scale).all() and (scale > 0).all():
            with suppress(np.linalg.LinAlgError):
                solution = np.linalg.solve(matrix / scale, -right / scale)
        values[self.lo : self.hi] = solution.ravel()


# --- building --------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _PartialsGroup:
    """The partials of some results of a type, for all instances that have the same ones.

    members: instances, each with its lane. pairs: for each partial the result's key and the argument. first: the number
    of the first partial; those of one pair are adjacent, in the order of the members. template: the values of constants
    and tables by node.
    """

    tape: Tape
    results: tuple[tuple[str, int], ...]
    tables: tuple[Reference, ...]
    members: list[tuple[int, int]] = field(default_factory=list)
    by: set[int] = field(default_factory=set)
    first: int = 0
    pairs: list[tuple[str, int]] = field(default_factory=list)
    at: dict[tuple[str, int], list[tuple[int, int]]] = field(default_factory=dict)  # result -> (argument, pair)
    template: list[Any] = field(default_factory=list)
    reads: dict[int, int] = field(default_factory=dict)  # node -> argument
    operations: list[tuple[int, Callable[..., Any], tuple[int, ...]]] = field(default_factory=list)
    results_at: list[int] = field(default_factory=list)
    asked: list[tuple[tuple[str, int], int]] = field(default_factory=list)  # of an FMU, by partial

    def ask(self, by: Sequence[int]) -> None:
        """For an FMU: ask for each partial that can differ from 0; all of its arguments are read."""
        for key, element in self.results:
            argument_pairs = self.at.setdefault((key, element), [])
            for argument in self.tape.read_by[key][element]:
                if argument in by:
                    argument_pairs.append((argument, len(self.pairs)))
                    self.pairs.append((key, argument))
                    self.asked.append(((key, element), argument))
        self.reads = {k: k for k in range(len(self.tape.arguments))}

    def derive(self, tables: Sequence[Sequence[float]]) -> None:
        by = sorted(self.by)
        if isinstance(self.tape, FmuTape):
            self.ask(by)
            return
        derivative_tape = jacobian(self.tape, self.results, by)
        nodes = derivative_tape.results["partial"].nodes
        for row, result in enumerate(self.results):
            argument_pairs = self.at.setdefault(result, [])
            for column, argument in enumerate(by):
                n = nodes[row * len(by) + column]
                if derivative_tape.nodes[n].op == "constant" and derivative_tape.nodes[n].value == 0.0:
                    continue
                argument_pairs.append((argument, len(self.pairs)))
                self.pairs.append((result[0], argument))
                self.results_at.append(n)
        needed = derivative_tape.needed(self.results_at)
        self.template = [None] * (max(needed, default=-1) + 1)
        functions = _ONE if len(self.members) == 1 else _MANY
        table_at = dict(
            zip((k for k, a in enumerate(self.tape.arguments) if a.kind == "table"), self.tables, strict=True)
        )
        for n in needed:
            node = derivative_tape.nodes[n]
            if node.op == "constant":
                self.template[n] = node.value
            elif node.op != "argument":
                self.operations.append((n, functions[node.op], node.operands))
            elif int(node.value) in table_at:
                self.template[n] = np.array(tables[table_at[int(node.value)][1]])
            else:
                self.reads[n] = int(node.value)


_Row = tuple[Array, Array, Array]
"""The places in which a row can differ from 0: of each its lane, its column and the number of its entry."""
_NOTHING: _Row = (np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp))
_Term = tuple[int, Reference, _Row]
"""An argument: the number of its partial (that of the first lane), what it is, and its row."""


def _joined(parts: Sequence[Array]) -> Array:
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.intp)


class _JacobianBuilder:
    """Finds which entries there are, and which partials and entries each is the sum of."""

    def __init__(self, folded: Folded, of: Sequence[Node | Reference], by: Sequence[Reference]) -> None:
        self.folded, self.plan = folded, folded.plan
        self.columns: dict[Reference, _Row] = {}
        for j, reference in enumerate(by):
            columns = np.array(folded.places("x", j))
            self.columns[reference] = np.arange(len(columns)), columns, np.full(len(columns), -1)
        self.width = sum(len(columns) for _, columns, _ in self.columns.values())
        self.program: Program = schedule(self.plan, of)
        self.needed = self._needed(of)
        self.depends = self._depends()
        self.groups: list[_PartialsGroup] = []
        self.group_of: dict[tuple[int, tuple[str, int]], tuple[_PartialsGroup, int]] = {}
        self._make_groups()
        self.rows: dict[Node, _Row] = {}
        self.level: dict[Node, int] = {}
        self.rank: list[int] = []  # of each entry: twice its level, and 1 more in a loop
        self.targets: list[Array] = []
        self.partials: list[Array] = []
        self.sources: list[Array] = []
        self.loops: list[Solve] = []

    def node(self, item: Node | Reference) -> Node | None:
        """The node of a row; None: a constant."""
        if isinstance(item, Node):
            return item
        return self.plan.outputs[item.index] if item.row == "w" else None

    def before(self, reference: Reference) -> Node | None:
        """The node that computes an argument; None where it is memory, or cut."""
        return None if reference in self.columns else self.node(reference)

    def _needed(self, of: Sequence[Node | Reference]) -> set[Node]:
        """The nodes between the results and the variables (or cuts)."""
        begin = (node for item in of if item not in self.columns and (node := self.node(item)) is not None)
        return closure(begin, lambda node: filter(None, map(self.before, self.plan.bind(node))))

    def _depends(self) -> set[Node]:
        """The needed nodes that depend on a variable."""
        dependent: set[Node] = set()
        for step in self.program.steps:
            nodes = [node for node in step.nodes if node in self.needed]
            changed = [
                node
                for node in nodes
                if any(ref in self.columns or self.before(ref) in dependent for ref in self.plan.bind(node))
            ]
            dependent.update(nodes if changed and isinstance(step, AlgebraicLoop) else changed)
        return dependent

    def _reads(self, node: Node) -> list[tuple[int, Reference]]:
        """The arguments of a node that depend on a variable, and their references."""
        instance = self.plan.instances[node.instance]
        tape = instance.tape
        pairs = [(k, instance.arguments[k]) for k in tape.arguments_of(tape.results[node.key].nodes[node.element])]
        return [(k, ref) for k, ref in pairs if ref in self.columns or self.before(ref) in self.depends]

    def _make_groups(self) -> None:
        plan = self.plan
        known: dict[object, _PartialsGroup] = {}
        for step in self.program.order:
            results = tuple(node.result for node in step.nodes if node in self.depends)
            if not results or step.instance in self.folded.gathers:
                continue
            reads = {result: self._reads(Node(step.instance, *result)) for result in results}
            by = {k for pairs in reads.values() for k, _ in pairs}
            instance = plan.instances[step.instance]
            tables = tuple(ref for ref in instance.arguments if ref.row == "c")
            parts = [results] if len(results) * len(by) <= _LARGE else [(result,) for result in results]
            for part in parts:
                group = known.setdefault((id(instance.tape), part, tables), _PartialsGroup(instance.tape, part, tables))
                for result in part:
                    self.group_of[step.instance, result] = group, len(group.members)
                    group.by.update(k for k, _ in reads[result])
                group.members += [(step.instance, lane) for lane in range(self.folded.copies(step.instance))]
        # Single instances are computed as plain numbers; they come first.
        self.groups = sorted(known.values(), key=lambda group: len(group.members) > 1)
        self.count = 0
        self.numbers: dict[float, int] = {}
        self.off: dict[int, list[int]] = {}
        outputs: dict[Reference, None] = {}
        for group in self.groups:
            group.derive(plan.tables)
            group.first = self.count
            size = len(group.members)
            self.count += len(group.pairs) * size
            for member, (index, _) in enumerate(group.members):
                condition = plan.instances[index].condition
                for pair, (key, _) in enumerate(group.pairs) if condition is not None else ():
                    if key.startswith("derivative:"):
                        assert condition is not None
                        self.off.setdefault(condition, []).append(group.first + pair * size + member)
        for reference, _ in self.arguments():
            if reference.row == "w":
                outputs[Reference("w", int(reference.index))] = None  # that of all copies
            elif reference.row == "k":
                self.numbers.setdefault(reference.index, len(self.numbers))
        self.outputs = tuple(sorted(outputs))

    def arguments(self) -> Iterable[tuple[Reference, int]]:
        """What the groups read, in the order in which they take it; and how many lanes do."""
        for group in self.groups:
            instances = [(index, self.folded.copies(index)) for index, lane in group.members if lane == 0]
            for argument in group.reads.values():
                for index, lanes in instances:
                    reference = self.plan.instances[index].arguments[argument]
                    if reference.row == "tick":
                        reference = Reference("tick", self.plan.rate_of[Node(index, *group.results[0])])
                    yield reference, lanes

    def accumulate(self) -> None:
        for step in self.program.steps:
            if isinstance(step, AlgebraicLoop):
                self._loop(step)
            else:
                for node in step.nodes:
                    self._row(node)

    def _read(self, reference: Reference, lanes: int) -> _Row:
        """The row of what so many lanes read."""
        if reference in self.columns:
            row = self.columns[reference]
            count = len(row[0])
        else:
            source = self.before(reference)
            if source is None or source not in self.rows:
                return _NOTHING
            row, count = self.rows[source], self.folded.copies(source.instance)
        lane, columns, entries = row
        own = getattr(reference.index, "lane", None)
        if own is not None:
            is_own, count = lane == own, 1
            lane, columns, entries = np.zeros(int(is_own.sum()), dtype=np.intp), columns[is_own], entries[is_own]
        if lanes == count:
            return lane, columns, entries
        return np.repeat(np.arange(lanes), len(columns)), np.tile(columns, lanes), np.tile(entries, lanes)

    def _terms(self, node: Node) -> list[_Term]:
        """The terms of a node."""
        if node not in self.depends:
            return []
        group, member = self.group_of[node.instance, node.result]
        arguments, lanes = self.plan.instances[node.instance].arguments, self.folded.copies(node.instance)
        return [
            (group.first + pair * len(group.members) + member, arguments[k], self._read(arguments[k], lanes))
            for k, pair in group.at[node.result]
        ]

    def _above(self, terms: Iterable[_Term]) -> int:
        """The level of a sum of these terms."""
        return 1 + self._highest(reference for _, reference, row in terms if len(row[1]))

    def _highest(self, references: Iterable[Reference]) -> int:
        nodes = map(self.before, references)
        return max((self.level.get(node, 0) for node in nodes if node is not None), default=0)

    def _row(self, node: Node) -> None:
        gathered = self.folded.gathers.get(node.instance)
        if gathered is not None:
            parts = [self._read(reference, 1) for reference in gathered]
            lane = np.repeat(np.arange(len(parts)), [len(columns) for _, columns, _ in parts])
            self.rows[node] = lane, _joined([part[1] for part in parts]), _joined([part[2] for part in parts])
            self.level[node] = self._highest(gathered)
            return
        terms = [term for term in self._terms(node) if len(term[2][1])]
        if not terms:
            return
        places = np.concatenate([lane * self.width + columns for _, _, (lane, columns, _) in terms])
        places, place = np.unique(places, return_inverse=True)
        level, first = self._above(terms), len(self.rank)
        self.targets.append(first + place)
        self.partials.append(np.concatenate([number + lane for number, _, (lane, _, _) in terms]))
        self.sources.append(np.concatenate([entries for _, _, (_, _, entries) in terms]))
        self.rank += [2 * level] * len(places)
        self.rows[node] = *np.divmod(places, self.width), np.arange(first, len(self.rank))
        self.level[node] = level

    def _loop(self, loop: AlgebraicLoop) -> None:
        """The rows of a loop; a cut variable is no unknown, but its row may be asked for."""
        everything = loop.nodes
        rows = [row for part in loop.parts for row in part.rows]
        reference = {node: loop.unknowns[row] for node, row in zip(everything, rows, strict=True)}
        nodes = [node for node in everything if node in self.depends and reference[node] not in self.columns]
        if nodes:
            self._solve(nodes, {reference[node]: k for k, node in enumerate(nodes)})
        for node in everything:
            if node in self.depends and reference[node] in self.columns:
                self._row(node)

    def _solve(self, nodes: Sequence[Node], unknown: Mapping[Reference, int]) -> None:
        """Add the system of the nodes of a loop, whose unknowns have these numbers, and their rows."""
        terms = {node: self._terms(node) for node in nodes}
        outer = {node: [t for t in terms[node] if t[1] not in unknown and len(t[2][1])] for node in nodes}
        columns = np.unique(_joined([term[2][1] for node in nodes for term in outer[node]]))
        level, n, first = self._above([t for node in nodes for t in outer[node]]), len(nodes), len(self.rank)
        inner = [(k * n + unknown[t[1]], t[0]) for k, node in enumerate(nodes) for t in terms[node] if t[1] in unknown]
        places, partials, sources = [], [], []
        for k, node in enumerate(nodes):
            for number, _, (_, own, entries) in outer[node]:
                places.append(k * len(columns) + np.searchsorted(columns, own))
                partials.append(np.full(len(own), number))
                sources.append(entries)
        roles = (self.plan.instances[node.instance].tape.results[node.key].role for node in nodes)
        explicit = np.array([float(role != "residual") for role in roles])
        at, numbers = (np.array([pair[k] for pair in inner], dtype=np.intp) for k in (0, 1))
        outside = (_joined(places), _joined(partials), _joined(sources))
        self.rank += [2 * level + 1] * (n * len(columns))
        self.loops.append(Solve(2 * level + 1, first, len(self.rank), explicit, (at, numbers), outside))
        for k, node in enumerate(nodes):
            begin = first + k * len(columns)
            self.rows[node] = np.zeros_like(columns), columns, np.arange(begin, begin + len(columns))
            self.level[node] = level


# --- the operations of a tape, on numbers and on arrays --------------------------------------------------------


def on_arrays(
    tape: Tape, wanted: Sequence[int], arguments: Sequence[object], tables: Sequence[object] = ()
) -> list[Any]:
    """The values of nodes of a tape of equations, where each argument is a number or an array.

    arguments: one for each of the tape, None for tables. tables: these, in order. As in IEEE 754, a quotient by 0 is
    inf.
    """
    key = tuple(wanted)
    order = tape.orders.get(key)
    if order is None:
        order = tape.orders[key] = _order(tape, key)
    constants, read, operations, places = order
    values = dict(constants)
    at = {k: np.asarray(table) for k, table in zip(places, tables, strict=True)}
    for n, k in read:
        values[n] = at[k] if k in at else np.asarray(arguments[k], dtype=float)
    with np.errstate(all="ignore"):
        for n, operation, operands in operations:
            values[n] = operation(*[values[k] for k in operands])
    return [values[n] for n in wanted]


def terms_on_arrays(
    tape: Tape, wanted: Sequence[int], arguments: Sequence[object], tables: Sequence[object]
) -> list[Any]:
    """The size of the terms that nodes of a tape sum up: rounding errors are some units in the last place of it.

    Arguments as of `on_arrays`. A sum has the terms of both operands, a product their products; all else has its own
    size. 0 where it is not finite.
    """
    needed = tape.needed(wanted)
    values = dict(zip(needed, on_arrays(tape, needed, arguments, tables), strict=True))
    sizes: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for n in needed:
            op, operands = tape.nodes[n].op, tape.nodes[n].operands
            if op in ("add", "sub"):
                sizes[n] = sizes[operands[0]] + sizes[operands[1]]
            elif op == "mul":
                sizes[n] = sizes[operands[0]] * sizes[operands[1]]
            elif op == "div":
                sizes[n] = sizes[operands[0]] / np.abs(values[operands[1]])
            elif op in ("neg", "fabs"):
                sizes[n] = sizes[operands[0]]
            elif op in ("fmin", "fmax"):
                sizes[n] = np.where(values[n] == values[operands[0]], sizes[operands[0]], sizes[operands[1]])
            elif op == "choose":
                sizes[n] = np.where(values[operands[0]] != 0.0, sizes[operands[1]], sizes[operands[2]])
            else:
                sizes[n] = np.abs(values[n])
    return [np.where(np.isfinite(sizes[n]), sizes[n], 0.0) for n in wanted]


def _order(tape: Tape, wanted: Sequence[int]) -> tuple[dict[int, Any], list[tuple[int, int]], list[Any], list[int]]:
    """What is needed: the constants, the arguments, the operations in order; and which arguments are tables."""
    constants: dict[int, object] = {}
    read: list[tuple[int, int]] = []
    operations: list[tuple[int, Callable[..., object], tuple[int, ...]]] = []
    for n in tape.needed(wanted):
        node = tape.nodes[n]
        if node.op == "constant":
            constants[n] = np.float64(node.value)
        elif node.op == "argument":
            read.append((n, int(node.value)))
        else:
            operations.append((n, _MANY[node.op], node.operands))
    return constants, read, operations, [k for k, argument in enumerate(tape.arguments) if argument.kind == "table"]


def _divided(a: Any, b: Any) -> object:
    try:
        return a / b
    except ZeroDivisionError:
        return np.divide(a, b)


def _numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """A comparison that gives numbers, as bools of numpy do not subtract."""
    return lambda *operands: function(*operands) * 1.0


_MANY: dict[str, Callable[..., Any]] = {
    **{op: operation.ieee for op, operation in OPERATIONS.items()},
    **{op: _numbers(OPERATIONS[op].ieee) for op in LOGICAL},
    **{op: OPERATIONS[op].value for op in ("add", "sub", "mul", "neg")},
    "div": _divided,
}
_ONE: dict[str, Callable[..., object]] = {
    **_MANY,
    **{op: _numbers(OPERATIONS[op].value) for op in LOGICAL},
    "choose": OPERATIONS["choose"].value,
}
