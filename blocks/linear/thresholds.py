"""Where a law of one argument bends or jumps, as its operations alone show: |u| <= 0.5 does at -0.5 and 0.5.

    evident(tape, switches, argument, constant)      # inputs, or None where a search must find them

This is exact, and takes a hundredth of the time of a search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from ..contract.tape import Tape

Constant = Callable[[int], float]
_COMPARED = frozenset({"lt", "le", "eq", "ne", "fmin", "fmax"})
_BINARY = frozenset({"add", "sub", "mul", "div", "pow", "fmin", "fmax"})
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
    moving = [k for k, operand in enumerate(operands) if argument in tape.arguments_of(operand)]
    if len(moving) != 1:
        return None
    levels: tuple[float, ...] | None
    if op == "neg":
        levels = (-level,)
    elif op == "fabs":
        levels = tuple({level, -level}) if level >= 0.0 else ()
    else:
        levels = _behind(op, moving[0], level, constant(operands[1 - moving[0]])) if op in _BINARY else None
    behind = [places(tape, operands[moving[0]], argument, constant, value) for value in levels or ()]
    known = [inputs for inputs in behind if inputs is not None]
    return None if levels is None or len(known) < len(behind) else tuple(u for inputs in known for u in inputs)


_INVERSES: Mapping[tuple[str, int], Callable[[float, float], float]] = {
    ("add", 0): lambda level, other: level - other, ("add", 1): lambda level, other: level - other,
    ("sub", 0): lambda level, other: level + other, ("sub", 1): lambda level, other: other - level,
    ("mul", 0): lambda level, other: level / other, ("mul", 1): lambda level, other: level / other,
    ("div", 0): lambda level, other: level * other,
}  # fmt: skip
"""The operand at a place, at which an operation with another operand passes a level."""


def _behind(op: str, k: int, level: float, other: float) -> tuple[float, ...] | None:
    """Return the values of operand k at which an operation passes a level; None if they are not known."""
    if op in ("fmin", "fmax"):
        is_cut = level > other if op == "fmin" else level < other
        return None if level == other or math.isnan(other) else () if is_cut else (level,)
    if op == "pow":
        return (0.0,) if k == 0 and level == 0.0 and other > 0.0 else None
    if op in ("mul", "div") and (not math.isfinite(other) or other == 0.0):
        return () if op == "mul" and other == 0.0 else None
    inverse = _INVERSES.get((op, k))
    return None if inverse is None else (inverse(level, other),)
