"""What follows from the nodes of a tape: quicker ones, the phases of periodic operations, which are integers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from .scalars import JUMPS, KEEPS_WHOLE, WHOLE
from .tape import Argument, TapeNode, nodes_needed

_MOVING = frozenset({"time", "input", "state", "algebraic", "history", "output"})
"""The kinds of arguments that may change between instants."""
_TURNS = {"sin": 1 / (2 * math.pi), "cos": 1 / (2 * math.pi), "tan": 1 / math.pi, "floor": 1.0, "ceil": 1.0}
"""Turns per unit of the operand, by periodic operation; for one that jumps, a turn is from jump to jump."""
_CELL = 0.25  # of a table: one may be passed where another operation may make a quarter turn


def with_reciprocals(
    nodes: Sequence[TapeNode], arguments: Sequence[Argument]
) -> tuple[tuple[TapeNode, ...], dict[int, int]]:
    """The nodes, then some that multiply where these divide by parameters; and by node, the one that replaces it."""
    kinds = [argument.kind for argument in arguments]
    fixed: list[bool] = []  # nothing but parameters and constants
    plain: list[bool] = []  # nothing but constants
    for node in nodes:
        if node.op == "argument":
            fixed.append(kinds[int(node.value)] == "parameter")
            plain.append(False)
        else:
            fixed.append(all(fixed[k] for k in node.operands))
            plain.append(all(plain[k] for k in node.operands))
    extended = [*nodes]
    known: dict[TapeNode, int] = {}
    quick: dict[int, int] = {}

    def add(node: TapeNode) -> int:
        if node not in known:
            known[node] = len(extended)
            extended.append(node)
        return known[node]

    for n, node in enumerate(nodes):
        if fixed[n] or node.op in JUMPS:
            continue
        if node.op == "choose":
            operands = (node.operands[0], *(quick.get(k, k) for k in node.operands[1:]))
        else:
            operands = tuple(quick.get(k, k) for k in node.operands)
        if node.op == "div" and fixed[node.operands[1]] and not plain[node.operands[1]]:
            unity = add(TapeNode("constant", (), 1.0))
            quick[n] = add(TapeNode("mul", (operands[0], add(TapeNode("div", (unity, node.operands[1]))))))
        elif operands != node.operands:
            quick[n] = add(TapeNode(node.op, operands, node.value))
    return tuple(extended), quick


def with_phases(
    nodes: Sequence[TapeNode], arguments: Sequence[Argument], outputs: Sequence[int]
) -> tuple[tuple[TapeNode, ...], tuple[int, ...], dict[int, int]]:
    """The nodes, then the phases of periodic operations; which nodes those are; by periodic node, which of them."""
    extended = [*nodes]
    known: dict[TapeNode, int] = {}
    moves = [False] * len(nodes)
    phases: dict[int, int] = {}
    periodic: dict[int, int] = {}

    def add(node: TapeNode) -> int:
        if node not in known:
            known[node] = len(extended)
            extended.append(node)
        return known[node]

    for n in nodes_needed(nodes, outputs):
        node = nodes[n]
        if node.op == "argument":
            moves[n] = arguments[int(node.value)].kind in _MOVING
            continue
        moves[n] = any(moves[k] for k in node.operands)
        if not moves[n]:
            continue
        if node.op in _TURNS:
            scale = _TURNS[node.op]
            turns = (
                add(TapeNode("mul", (node.operands[0], add(TapeNode("constant", (), scale))))) if scale != 1.0 else None
            )
            place = node.operands[0] if turns is None else turns
        elif node.op == "fmod":
            place = add(TapeNode("div", node.operands))
        elif node.op == "search":
            place = add(TapeNode("mul", (n, add(TapeNode("constant", (), _CELL)))))
        else:
            continue
        periodic[n] = phases.setdefault(place, len(phases))
    return tuple(extended), tuple(phases), periodic


def are_whole(nodes: Sequence[TapeNode], arguments: Sequence[Argument], types: Mapping[str, str]) -> list[bool]:
    """For each node whether it is an integer, whatever the arguments are."""
    whole: list[bool] = []
    for node in nodes:
        if node.op == "argument":
            argument = arguments[int(node.value)]
            whole.append(argument.kind in ("tick", "side") or types.get(argument.name, "real") != "real")
        elif node.op == "constant":
            whole.append(float(node.value).is_integer())
        else:
            below = node.operands[1:] if node.op == "choose" else node.operands
            whole.append(node.op in WHOLE or (node.op in KEEPS_WHOLE and all(whole[k] for k in below)))
    return whole
