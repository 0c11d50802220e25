"""Scalar operations as they are recorded: what the elements of symbols are while equations run.

A `Scalar` is one operation of a tape, of other scalars. Nothing is simplified here but -(-x), as an identity may change
the meaning (sqrt(x)**2 is not x where x is negative, x == x is false for NaN); an operation of constants alone is a
constant. What occurs twice is recorded twice; `recorded_nodes` makes equal ones one node.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

__all__ = ["Scalar", "choose", "constant", "record", "unknown"]


_Operator = Callable[[Any, Any], "Scalar"]


def _both_sides(op: str) -> tuple[_Operator, _Operator]:
    """The methods of an operator, with the scalar on its left and on its right. An array takes its elements itself."""

    def left(scalar: Scalar, other: Any) -> Any:
        return record(op, scalar, other) if isinstance(other, _OPERANDS) else NotImplemented

    def right(scalar: Scalar, other: Any) -> Any:
        return record(op, other, scalar) if isinstance(other, _OPERANDS) else NotImplemented

    return left, right


class Scalar:
    """One operation: `op` is one of a tape's, `value` the number of a constant.

    The operators are those that numpy's own functions use on arrays of objects. Two scalars are equal where they are
    the same one; `record("eq", a, b)` compares what they will be.
    """

    __slots__ = ("op", "operands", "value")

    def __init__(self, op: str, operands: tuple[Scalar, ...] = (), value: float = 0.0) -> None:
        self.op, self.operands, self.value = op, operands, value

    __add__, __radd__ = _both_sides("add")
    __sub__, __rsub__ = _both_sides("sub")
    __mul__, __rmul__ = _both_sides("mul")
    __truediv__, __rtruediv__ = _both_sides("div")

    def __neg__(self) -> Scalar:
        return self.operands[0] if self.op == "neg" else record("neg", self)


_OPERANDS = (Scalar, int, float, np.number)


def unknown() -> Scalar:
    """A new argument."""
    return Scalar("argument")


def constant(value: float) -> Scalar:
    """A number. The sign of a zero is not kept, and there is one NaN."""
    return Scalar("constant", (), math.nan if math.isnan(value) else float(value) + 0.0)


def record(op: str, *operands: Any) -> Scalar:
    """An operation of scalars and numbers."""
    scalars = tuple([x if isinstance(x, Scalar) else constant(float(x)) for x in operands])
    for scalar in scalars:
        if scalar.op != "constant":
            return Scalar(op, scalars)
    return constant(_folded(op, [scalar.value for scalar in scalars]))


def choose(condition: Any, yes: Any, no: Any) -> Scalar:
    """`yes` where the condition is 1, else `no`."""
    return record("choose", condition, yes, no)


def _folded(op: str, values: list[float]) -> float:
    """The value of an operation as IEEE 754 has it, where Python's `math` raises as well."""
    try:
        return float(_FLOAT[op](*values))
    except (ValueError, OverflowError, ZeroDivisionError):
        with np.errstate(all="ignore"):
            return float(_NUMPY[op](*map(np.float64, values)))


def _least(a: float, b: float) -> float:
    return a if a < b else b if b <= a else a + b


def _largest(a: float, b: float) -> float:
    return a if a > b else b if b >= a else a + b


_FLOAT: Mapping[str, Callable[..., float]] = {
    **{
        name: getattr(math, name)
        for name in (
            *("pow", "sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
            *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "fabs", "floor", "ceil", "fmod", "copysign"),
        )
    },
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "hypot": lambda a, b: abs(complex(a, b)),  # as C has it; math.hypot rounds otherwise
    "sign": lambda a: 1.0 if a > 0 else -1.0 if a < 0 else a,
    "fmin": _least,
    "fmax": _largest,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": lambda a, b: bool(a) and bool(b),
    "or": lambda a, b: bool(a) or bool(b),
    "not": operator.not_,
    "choose": lambda condition, yes, no: yes if condition else no,
}
"""What the operations of a tape are of numbers, by the mathematical library of the system."""
_NUMPY: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "sinh")},
    **{name: getattr(np, name) for name in ("cosh", "hypot", "floor", "ceil", "fmod")},
    **{"pow": np.power, "div": np.divide, "asin": np.arcsin, "acos": np.arccos, "acosh": np.arccosh},
    "atanh": np.arctanh,
}
"""The operations that raise for some numbers, of which these give inf or NaN."""
