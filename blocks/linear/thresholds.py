"""Where a law of one argument bends or jumps, as its operations alone show: |u| <= 0.5 does at -0.5 and 0.5.

    evident(tape, switches, argument, constant)      # inputs, or None where a search must find them

This is exact, and takes a hundredth of the time of a search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from ..contract.tape import Tape

Constant = Callable[[int], float]
_COMPARED = frozenset({"lt", "le", "eq", "ne", "fmin", "fmax"})
_AT_ZERO = frozenset({"crossing", "fabs", "sign", "copysign", "sqrt", "log", "atan2", "hypot"})


def evident(
    tape: Tape, switches: Sequence[tuple[str, tuple[int, ...]]], argument: int, constant: Constant
) -> tuple[float, ...] | None:
    """The inputs, in order, at which some operations bend or jump; None where they are not evident.

    switches: operations with their operands, and ("crossing", (node,)) for what jumps as a node passes 0. constant: the
    value of a node that the argument does not change.
    """
    inputs: set[float] = set()
    for op, operands in switches:
        for node, level in _levels(tape, op, operands, argument, constant) or [(-1, math.nan)]:
            passed = places(tape, node, argument, constant, level) if node >= 0 else None
            if passed is None:
                return None
            inputs.update(passed)
    return tuple(sorted(inputs))


def _levels(
    tape: Tape, op: str, operands: tuple[int, ...], argument: int, constant: Constant
) -> list[tuple[int, float]]:
    """The nodes that an operation depends on, with the levels at which it bends or jumps; none: not known."""
    if op in _AT_ZERO:
        return [(operand, 0.0) for operand in operands]
    if op == "div":
        return [(operands[1], 0.0)]
    if op == "pow":
        return [(operands[0], 0.0)]
    if op in ("asin", "acos", "atanh"):
        return [(operands[0], 1.0), (operands[0], -1.0)]
    if op in _COMPARED:
        a, b = operands
        if argument not in tape.arguments_of(b):
            return [(a, constant(b))]
        if argument not in tape.arguments_of(a):
            return [(b, constant(a))]
    return []


def places(tape: Tape, node: int, argument: int, constant: Constant, level: float) -> tuple[float, ...] | None:
    """The inputs at which a node passes a level; None where its operations do not show them."""
    if argument not in tape.arguments_of(node) or math.isinf(level):
        return ()
    if math.isnan(level):
        return None
    op, operands = tape.nodes[node].op, tape.nodes[node].operands
    if op == "argument":
        return (level + 0.0,)  # no negative zero

    def behind(place: int, value: float) -> tuple[float, ...] | None:
        return places(tape, operands[place], argument, constant, value)

    if op == "neg":
        return behind(0, -level)
    if op == "fabs":
        both = [behind(0, value) for value in {level, -level}] if level >= 0.0 else []
        known = [inputs for inputs in both if inputs is not None]
        return tuple(u for inputs in known for u in inputs) if len(known) == len(both) else None
    if op not in ("add", "sub", "mul", "div", "pow", "fmin", "fmax"):
        return None
    moving = [k for k, operand in enumerate(operands) if argument in tape.arguments_of(operand)]
    if len(moving) != 1:
        return None
    k = moving[0]
    other = constant(operands[1 - k])
    if op == "add":
        return behind(k, level - other)
    if op == "sub":
        return behind(k, level + other if k == 0 else other - level)
    if op in ("fmin", "fmax"):
        is_cut = level > other if op == "fmin" else level < other
        return None if level == other or math.isnan(other) else () if is_cut else behind(k, level)
    if op == "pow":
        return behind(0, 0.0) if k == 0 and level == 0.0 and other > 0.0 else None
    if k != 0 and op == "div":
        return None
    if not math.isfinite(other) or other == 0.0:
        return () if op == "mul" and other == 0.0 else None
    return behind(k, level / other if op == "mul" else level * other)
