"""What was recorded, as the nodes of a tape: the operations of the equations, as they are written.

Simplified here are products with zero, so that they make no dependency (0 x -> 0, 0/x -> 0, also where x is inf or
NaN), and operations without effect (1 x, x/1, x + 0, a choice between equals). The sign of a zero is not kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .scalars import OPERATIONS, Scalar
from .tape import TapeNode, nodes_needed

_ZERO = TapeNode("constant", (), 0.0)
_LOOKUPS = ("search", "pick")
_FOLDED = frozenset({"add", "sub", "mul", "div", "neg", "not", "lt", "le", "eq", "ne"})


class NodeList:
    """The nodes of a tape while it grows: the arguments first; equal nodes are one."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.nodes = [TapeNode("argument", (), float(index)) for index in range(count)]
        self._known: dict[TapeNode, int] = {}

    def constant(self, value: float) -> int:
        return self._index(TapeNode("constant", (), value))

    def add(self, op: str, *operands: int) -> int:
        """The index of an operation: of a node that gives the same, where there is one."""
        node = _simplified(op, operands, self.nodes)
        return self._index(node) if isinstance(node, TapeNode) else node

    def _index(self, node: TapeNode) -> int:
        index = self._known.setdefault(node, len(self.nodes))
        if index == len(self.nodes):
            self.nodes.append(node)
        return index

    def needed(self, outputs: Sequence[int]) -> tuple[tuple[TapeNode, ...], list[int]]:
        """The arguments and what these outputs need, in this order; and where the outputs are among them."""
        return _kept(self.nodes, [n for n in nodes_needed(self.nodes, outputs) if n >= self.count], self.count, outputs)


def nodes_of(arguments: Sequence[Scalar], results: Sequence[Scalar]) -> tuple[tuple[TapeNode, ...], list[int]]:
    """Recorded scalars as nodes, the arguments first; what nothing needs is left out.

    The order is that of need: the first result first, and of an operation the first operand first.
    """
    listed = NodeList(len(arguments))
    listed.constant(0.0)
    place = {scalar: index for index, scalar in enumerate(arguments)}
    stack = list(reversed(results))
    while stack:
        scalar = stack[-1]
        if scalar in place:
            stack.pop()
            continue
        missing = next((operand for operand in scalar.operands if operand not in place), None)
        if scalar.op == "choose" and missing is not scalar.operands[0] and missing is not scalar.operands[1]:
            listed.add("not", place[scalar.operands[0]])  # so the nodes of equations keep the order that they have had
        if missing is not None:
            stack.append(missing)
            continue
        stack.pop()
        if scalar.op == "constant":
            place[scalar] = listed.constant(scalar.value)
        else:
            place[scalar] = listed.add(scalar.op, *(place[operand] for operand in scalar.operands))
    outputs = [place[scalar] for scalar in results]
    if any(node.op in _LOOKUPS for node in listed.nodes):
        order = _last_operand_first(listed.nodes, outputs)
        return _kept(listed.nodes, [n for n in order if n >= listed.count], listed.count, outputs)
    return listed.needed(outputs)


def _last_operand_first(nodes: Sequence[TapeNode], outputs: Sequence[int]) -> Iterable[int]:
    """What outputs need in the order of tapes that look up in tables: of an operation the last operand first."""
    order: dict[int, None] = {}
    stack = list(reversed(outputs))
    while stack:
        missing = [] if stack[-1] in order else [k for k in nodes[stack[-1]].operands if k not in order]
        if missing:
            stack += missing
        else:
            order.setdefault(stack.pop())
    return order


def _kept(
    nodes: Sequence[TapeNode], kept: Sequence[int], count: int, outputs: Sequence[int]
) -> tuple[tuple[TapeNode, ...], list[int]]:
    """The first `count` nodes and those kept, in this order, and where the outputs are among them."""
    order = [*range(count), *kept]
    place = {n: k for k, n in enumerate(order)}
    chosen = (nodes[n] for n in order)
    return (
        tuple(TapeNode(node.op, tuple(place[n] for n in node.operands), node.value) for node in chosen),
        [place[n] for n in outputs],
    )


def _simplified(op: str, operands: tuple[int, ...], nodes: Sequence[TapeNode]) -> TapeNode | int:
    """The node of an operation, or the index of a node that gives the same."""
    left, right = operands[0], operands[-1]
    a, b = nodes[left], nodes[right]
    x, y = (node.value if node.op == "constant" else None for node in (a, b))
    if op in _FOLDED and x is not None and y is not None and not (op == "div" and y == 0):
        return TapeNode("constant", (), float(OPERATIONS[op].value(*(x, y)[: len(operands)])))
    if op == "choose":
        return _choice(operands, a, x)
    if op in ("and", "or") and (x is not None or y is not None):
        other, value = (right, x) if x is not None else (left, y)
        return TapeNode("constant", (), float(op == "or")) if bool(value) == (op == "or") else other
    if (op == "mul" and (x == 0 or y == 0)) or (op == "div" and x == 0 and y is None):
        return _ZERO
    neutral = _NEUTRAL.get(op)
    if neutral is not None and y == neutral:
        return left
    return right if neutral is not None and x == neutral and op in ("add", "mul") else TapeNode(op, operands)


_NEUTRAL = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0}
"""The second operand without an effect; of sums and products also the first."""


def _choice(operands: tuple[int, ...], condition: TapeNode, known: float | None) -> TapeNode | int:
    """The node of a choice. known: the value of its condition, if it is a constant."""
    yes, no = operands[1:]
    if known is not None:
        return yes if known else no
    if yes == no:
        return yes
    if condition.op == "not":
        return TapeNode("choose", (condition.operands[0], no, yes))
    return TapeNode("choose", operands)
