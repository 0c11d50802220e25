"""The witness of recorded scalars: CasADi, which orders, computes and derives the same operations by other means.

`as_casadi` makes scalars of CasADi of those that were recorded, `nodes_of` the nodes of a tape of its instructions.
"""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi

from blocks.contract.scalars import Scalar
from blocks.contract.tape import TapeNode, nodes_needed

_CALLS = {
    **{"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg},
    **{"lt": operator.lt, "le": operator.le, "eq": operator.eq, "ne": operator.ne},
    **{"and": casadi.logic_and, "or": casadi.logic_or, "not": casadi.logic_not, "choose": casadi.if_else},
    "pow": casadi.power,
}


@dataclass(frozen=True, slots=True, eq=False)
class Lookup:
    """A value that was looked up: the symbol that stands for it, the operation, what was looked for, and in what."""

    result: Any
    op: str
    operand: Any
    table: Any


@contextlib.contextmanager
def as_written() -> Iterator[None]:
    """Without CasADi's own simplifications, some of which change the meaning."""
    options = casadi.GlobalOptions
    before = options.getSimplificationOnTheFly()
    options.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        options.setSimplificationOnTheFly(before)


def operation(op: str) -> Callable[..., Any]:
    """An operation of a tape, but for lookups, on numbers and symbols of CasADi."""
    return _CALLS[op] if op in _CALLS else getattr(casadi, op)  # type: ignore[no-any-return]


def as_casadi(arguments: Sequence[Scalar], results: Sequence[Scalar]) -> tuple[list[Any], list[Any], list[Lookup]]:
    """Recorded scalars as those of CasADi, each operation once: arguments, results, lookups."""
    made = {scalar: casadi.SX.sym(f"x{k}") for k, scalar in enumerate(arguments)}
    lookups: list[Lookup] = []
    stack = list(reversed(results))
    while stack:
        scalar = stack[-1]
        missing = [operand for operand in scalar.operands if operand not in made]
        if scalar in made:
            stack.pop()
        elif missing:
            stack += missing
        elif scalar.op == "constant":
            made[scalar] = casadi.SX(scalar.value)
        elif scalar.op in ("search", "pick"):
            lookups.append(Lookup(casadi.SX.sym(scalar.op), scalar.op, *(made[x] for x in scalar.operands)))
            made[scalar] = lookups[-1].result
        else:
            made[scalar] = operation(scalar.op)(*(made[x] for x in scalar.operands))
    return [made[x] for x in arguments], [made[x] for x in results], lookups


def nodes_of(arguments: list[Any], results: list[Any], lookups: list[Any]) -> tuple[tuple[TapeNode, ...], list[int]]:
    """CasADi's instructions as nodes, the arguments first; equal nodes are one, and what nothing needs is left out.

    Values that were looked up in tables are arguments at first, which are replaced by the lookups at the end. Products
    with zero make no dependency, operations without effect are left out, and both halves of a choice become one node.
    """
    count = len(arguments)
    arguments = [*arguments, *(lookup.result for lookup in lookups)]
    asked = [*results, *(item for lookup in lookups for item in (lookup.operand, lookup.table))]
    function = casadi.Function("f", [casadi.vertcat(*arguments)], [casadi.vertcat(*asked)] if asked else [])
    names = _operations()
    nodes = [TapeNode("argument", (), float(index)) for index in range(len(arguments))]
    register: dict[int, int] = {}
    outputs = [0] * len(asked)
    zero = len(nodes)
    nodes.append(TapeNode("constant", (), 0.0))
    known: dict[TapeNode, int] = {nodes[zero]: zero}

    def add(node: TapeNode) -> int:
        if node not in known:
            known[node] = len(nodes)
            nodes.append(node)
        return known[node]

    for k in range(function.n_instructions()):
        op = names[function.instruction_id(k)]
        source, target = function.instruction_input(k), function.instruction_output(k)
        if op == "input":
            register[target[0]] = source[1]
        elif op == "output":
            outputs[target[1]] = register[source[0]]
        elif op == "const":
            register[target[0]] = add(TapeNode("constant", (), function.instruction_constant(k)))
        else:
            op, below = _plain(op, tuple(register[i] for i in source), add)
            simplified = _simplified(op, below, nodes)
            register[target[0]] = add(simplified) if isinstance(simplified, TapeNode) else simplified
    # A choice that was not one half of another one, as in derivatives.
    nodes = [TapeNode("choose", (*node.operands, zero)) if node.op == "if_else_zero" else node for node in nodes]
    if lookups:
        operands = outputs[len(results) :]
        ops = [lookup.op for lookup in lookups]
        nodes, outputs = _stitched(nodes, outputs[: len(results)], count, ops, operands)
    needed = [*range(count), *(n for n in nodes_needed(nodes, outputs) if n >= count)]
    place = {n: k for k, n in enumerate(needed)}
    kept = (nodes[n] for n in needed)
    return (
        tuple(TapeNode(node.op, tuple(place[n] for n in node.operands), node.value) for node in kept),
        [place[n] for n in outputs],
    )


@cache
def _operations() -> dict[int, str]:
    """The names of CasADi's operations."""
    return {getattr(casadi, name): name[3:].lower() for name in dir(casadi) if name.startswith("OP_")}


def _plain(op: str, operands: tuple[int, ...], add: Callable[[TapeNode], int]) -> tuple[str, tuple[int, ...]]:
    """Operations of CasADi's derivatives that a tape does not have, in terms of those that it has."""
    match op:
        case "twice":
            return "add", operands * 2
        case "sq":
            return "mul", operands * 2
        case "inv":
            return "div", (add(TapeNode("constant", (), 1.0)), *operands)
        case "constpow":
            return "pow", operands
    return op, operands


def _stitched(
    nodes: list[TapeNode], outputs: list[int], count: int, ops: list[str], operands: list[int]
) -> tuple[list[TapeNode], list[int]]:
    """The nodes with each argument from `count` on replaced by its lookup, again in order of dependency."""
    stitched = nodes[:count]
    place = {index: index for index in range(count)}
    known = {node: index for index, node in enumerate(stitched)}

    def needs(index: int) -> tuple[int, ...]:
        node = nodes[index]
        if node.op == "argument" and index >= count:
            lookup = index - count
            return operands[2 * lookup], operands[2 * lookup + 1]
        return node.operands

    stack = list(reversed(outputs))
    while stack:
        index = stack[-1]
        missing = [] if index in place else [other for other in needs(index) if other not in place]
        if missing:
            stack += missing
            continue
        stack.pop()
        if index not in place:
            node, below = nodes[index], tuple(place[other] for other in needs(index))
            if node.op == "argument":
                node = TapeNode(ops[index - count])
            node = TapeNode(node.op, below, node.value)
            if node not in known:
                known[node] = len(stitched)
                stitched.append(node)
            place[index] = known[node]
    return stitched, [place[index] for index in outputs]


def _simplified(op: str, operands: tuple[int, ...], nodes: list[TapeNode]) -> TapeNode | int:
    """The node of an operation, or the index of a node that gives the same."""
    left, right = operands[0], operands[-1]
    a, b = nodes[left], nodes[right]
    x, y = (node.value if node.op == "constant" else None for node in (a, b))
    if op in _FOLDED and x is not None and y is not None and not (op == "div" and y == 0):
        return TapeNode("constant", (), float(_FOLDED[op](x, y)))
    match op:
        case "add":
            if a.op == b.op == "if_else_zero":
                # CasADi writes a choice as (c ? a : 0) + (!c ? b : 0).
                condition, opposite = nodes[a.operands[0]], nodes[b.operands[0]]
                if opposite == TapeNode("not", a.operands[:1]):
                    if condition.op == "not":
                        return _choice(condition.operands[0], b.operands[1], a.operands[1])
                    return _choice(a.operands[0], a.operands[1], b.operands[1])
            if x == 0 or y == 0:
                return right if x == 0 else left
        case "sub" if y == 0:
            return left
        case "mul":
            if x == 0 or y == 0:
                return TapeNode("constant", (), 0.0)
            if x == 1 or y == 1:
                return right if x == 1 else left
        case "div":
            if x == 0 and y is None:
                return TapeNode("constant", (), 0.0)
            if y == 1:
                return left
        case "and" | "or":
            absorbing = op == "or"
            if x is not None or y is not None:
                other, value = (right, x) if x is not None else (left, y)
                return TapeNode("constant", (), float(absorbing)) if bool(value) == absorbing else other
        case "if_else_zero" if x is not None:
            return right if x else TapeNode("constant", (), 0.0)
        case "assign":
            return left
    return TapeNode(op, operands)


def _choice(condition: int, yes: int, no: int) -> TapeNode | int:
    return yes if yes == no else TapeNode("choose", (condition, yes, no))


_FOLDED: Mapping[str, Callable[[float, float], float]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": lambda x, _: -x,
    "not": lambda x, _: float(not x),
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
}
