"""Scalar operations: the table of all, and how they are recorded while equations run.

A `Scalar` is one operation, of other scalars: the elements of symbols are scalars. Nothing is simplified here but
-(-x), as an identity may change the meaning (sqrt(x)**2 is not x where x is negative, x == x is false for NaN); an
operation of constants alone is a constant. What occurs twice is recorded twice; `recorded_nodes` makes equal ones one
node.
"""

from __future__ import annotations

import math
import operator
from bisect import bisect_right
from collections.abc import Callable
from enum import Flag, auto
from typing import Any, NamedTuple

import numpy as np

from .table_lookup import pick, search

_Operator = Callable[[Any, Any], "Scalar"]


def _both_sides(op: str) -> tuple[_Operator, _Operator]:
    """The methods of an operator, with the scalar on its left and on its right. An array takes its elements itself."""

    def left(scalar: Scalar, other: object) -> Any:
        return record(op, scalar, other) if isinstance(other, _OPERANDS) else NotImplemented

    def right(scalar: Scalar, other: object) -> Any:
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


def choose(condition: object, yes: object, no: object) -> Scalar:
    """`yes` where the condition is 1, else `no`."""
    return record("choose", condition, yes, no)


def _folded(op: str, values: list[float]) -> float:
    """The value of an operation as IEEE 754 has it, where Python's `math` raises as well."""
    try:
        return float(OPERATIONS[op].value(*values))
    except (ValueError, OverflowError, ZeroDivisionError):
        with np.errstate(all="ignore"):
            return float(OPERATIONS[op].ieee(*map(np.float64, values)))


# --- the table -------------------------------------------------------------------------------------------------


class _Trait(Flag):
    """What an operation is to those who print, derive or study it."""

    NONE = 0
    COSTLY = auto()
    """It takes longer than a branch: a call of C's library that compilers do not vectorise."""
    LOGICAL = auto()
    """It gives 1 or 0."""
    JOINS = auto()
    """It takes 1 or 0."""
    JUMPS = auto()
    """It is constant between jumps, or jumps."""
    BENDS = auto()
    """It may have no slope somewhere."""
    WHOLE = auto()
    """It gives integers, of whatever operands."""
    KEEPS_WHOLE = auto()
    """It gives integers where its operands, of a choice the last two, are integers."""


class Operation(NamedTuple):
    """What is known of one operation.

    value: of floats, by the mathematical library of the system; it raises where `math` does. ieee: the same of floats
    and of arrays, by numpy, which gives inf or NaN there. c: its operator in C, or its function. partials: by operand
    the partial derivative, as scalars of the value f and the operands x, y; None: 0. What has none has steps only.
    """

    value: Callable[..., Any]
    ieee: Callable[..., Any]
    c: str
    partials: tuple[Callable[..., Scalar] | None, ...] = ()
    traits: _Trait = _Trait.NONE


ONE, MINUS_ONE = constant(1.0), constant(-1.0)


def _one(*_: Scalar) -> Scalar:
    return ONE


def _minus_one(*_: Scalar) -> Scalar:
    return MINUS_ONE


def _share(small: Scalar, large: Scalar) -> Scalar:
    """1 where the one is below the other, 1/2 where they are equal, else 0; NaN where they cannot be compared."""
    below = record("le", small, large)
    return below / (below + record("le", large, small))


_LEAST = (lambda f, x, y: _share(x, y), lambda f, x, y: _share(y, x))
_LARGEST = _LEAST[::-1]
_COSTLY, _BENDS, _KEEPS = _Trait.COSTLY, _Trait.BENDS, _Trait.KEEPS_WHOLE
_COSTLY_BENDS, _KEEPS_BENDS = _COSTLY | _BENDS, _KEEPS | _BENDS
_STEPS = _Trait.JUMPS | _Trait.BENDS | _Trait.WHOLE
_COMPARES = _STEPS | _Trait.LOGICAL
_JOINS = _Trait.JUMPS | _Trait.WHOLE | _Trait.LOGICAL | _Trait.JOINS

OPERATIONS: dict[str, Operation] = {
    "add": Operation(operator.add, np.add, "+", (_one, _one), _KEEPS),
    "sub": Operation(operator.sub, np.subtract, "-", (_one, _minus_one), _KEEPS),
    "mul": Operation(operator.mul, np.multiply, "*", (lambda f, x, y: y, lambda f, x, y: x), _KEEPS),
    "div": Operation(operator.truediv, np.divide, "/", (lambda f, x, y: 1 / y, lambda f, x, y: -(f * (1 / y))), _BENDS),
    "neg": Operation(operator.neg, np.negative, "-", (_minus_one,), _KEEPS),
    # Not **: that is complex for a negative x, and an integer of any size for integers.
    "pow": Operation(math.pow, np.power, "pow", (
        lambda f, x, y: y * record("pow", x, y - 1), lambda f, x, y: record("log", x) * f), _COSTLY_BENDS),
    "sqrt": Operation(math.sqrt, np.sqrt, "sqrt", (lambda f, x: 0.5 / f,), _BENDS),
    "exp": Operation(math.exp, np.exp, "exp", (lambda f, x: f,), _COSTLY),
    "expm1": Operation(math.expm1, np.expm1, "expm1", (lambda f, x: record("exp", x),), _COSTLY),
    "log": Operation(math.log, np.log, "log", (lambda f, x: 1 / x,), _COSTLY_BENDS),
    "log1p": Operation(math.log1p, np.log1p, "log1p", (lambda f, x: 1 / (1 + x),), _COSTLY),
    "sin": Operation(math.sin, np.sin, "sin", (lambda f, x: record("cos", x),), _COSTLY),
    "cos": Operation(math.cos, np.cos, "cos", (lambda f, x: -record("sin", x),), _COSTLY),
    "tan": Operation(math.tan, np.tan, "tan", (lambda f, x: 1 + f * f,), _COSTLY),
    "asin": Operation(math.asin, np.arcsin, "asin", (
        lambda f, x: 1 / record("sqrt", (1 - x) * (1 + x)),), _COSTLY_BENDS),
    "acos": Operation(math.acos, np.arccos, "acos", (
        lambda f, x: -1 / record("sqrt", (1 - x) * (1 + x)),), _COSTLY_BENDS),
    "atan": Operation(math.atan, np.arctan, "atan", (lambda f, x: 1 / (1 + x * x),), _COSTLY),
    "atan2": Operation(math.atan2, np.arctan2, "atan2", (
        lambda f, y, x: x / (y * y + x * x), lambda f, y, x: -(y / (y * y + x * x))), _COSTLY_BENDS),
    "sinh": Operation(math.sinh, np.sinh, "sinh", (lambda f, x: record("cosh", x),), _COSTLY),
    "cosh": Operation(math.cosh, np.cosh, "cosh", (lambda f, x: record("sinh", x),), _COSTLY),
    "tanh": Operation(math.tanh, np.tanh, "tanh", (lambda f, x: 1 - f * f,), _COSTLY),
    "asinh": Operation(math.asinh, np.arcsinh, "asinh", (lambda f, x: 1 / record("sqrt", 1 + x * x),), _COSTLY),
    "acosh": Operation(math.acosh, np.arccosh, "acosh", (
        lambda f, x: 1 / (record("sqrt", x - 1) * record("sqrt", x + 1)),), _COSTLY_BENDS),
    "atanh": Operation(math.atanh, np.arctanh, "atanh", (lambda f, x: 1 / ((1 - x) * (1 + x)),), _COSTLY_BENDS),
    # As C has it; math.hypot rounds otherwise.
    "hypot": Operation(lambda x, y: abs(complex(x, y)), np.hypot, "hypot", (
        lambda f, x, y: x / f, lambda f, x, y: y / f), _COSTLY_BENDS),
    "fabs": Operation(math.fabs, np.abs, "fabs", (lambda f, x: record("sign", x),), _KEEPS_BENDS),
    "sign": Operation(lambda x: 1.0 if x > 0 else -1.0 if x < 0 else x, np.sign, "blocks_sign", (), _STEPS),
    "floor": Operation(lambda x: float(math.floor(x)), np.floor, "floor", (), _STEPS),
    "ceil": Operation(lambda x: float(math.ceil(x)), np.ceil, "ceil", (), _STEPS),
    "fmod": Operation(math.fmod, np.fmod, "fmod", (
        _one, lambda f, x, y: (f - x) / y), _COSTLY | _KEEPS_BENDS | _Trait.JUMPS),
    "copysign": Operation(math.copysign, np.copysign, "copysign", (
        lambda f, x, y: record("sign", x) * record("copysign", 1, y), None), _KEEPS_BENDS),
    # NaN goes through, as in numpy; x < y ? x : y would turn it into a bound.
    "fmin": Operation(lambda x, y: x if x < y else y if y <= x else x + y, np.minimum, "blocks_min", _LEAST,
        _KEEPS_BENDS),
    "fmax": Operation(lambda x, y: x if x > y else y if y >= x else x + y, np.maximum, "blocks_max", _LARGEST,
        _KEEPS_BENDS),
    # Python's: of equals the first. Expressions of files have them, tapes do not.
    "min": Operation(min, lambda x, y: np.minimum(x, y), "<", _LEAST, _KEEPS_BENDS),
    "max": Operation(max, lambda x, y: np.maximum(x, y), ">", _LARGEST, _KEEPS_BENDS),
    "lt": Operation(operator.lt, np.less, "<", (), _COMPARES),
    "le": Operation(operator.le, np.less_equal, "<=", (), _COMPARES),
    "eq": Operation(operator.eq, np.equal, "==", (), _COMPARES),
    "ne": Operation(operator.ne, np.not_equal, "!=", (), _COMPARES),
    "and": Operation(lambda x, y: bool(x) and bool(y), np.logical_and, "&", (), _JOINS),
    "or": Operation(lambda x, y: bool(x) or bool(y), np.logical_or, "|", (), _JOINS),
    "not": Operation(operator.not_, np.logical_not, "!", (), _JOINS),
    # Its partials count where they are chosen.
    "choose": Operation(lambda condition, x, y: x if condition else y, lambda condition, x, y: np.where(
        np.not_equal(condition, 0.0), x, y), "?", (None, _one, _one), _KEEPS),
    "search": Operation(lambda x, table: float(bisect_right(table, x)), lambda x, table: search(table, x),
        "blocks_search", (), _COSTLY | _STEPS),
    "pick": Operation(lambda index, table: table[min(max(int(index), 0), len(table) - 1)],
        lambda index, table: pick(table, index), "blocks_pick", (), _Trait.JUMPS | _Trait.BENDS),
}  # fmt: skip
"""The operations of a tape, beside its arguments and constants. They mean what C's functions mean, but fmin and fmax
are NaN where an operand is, and sign(x) is x where x is neither above nor below 0. Comparisons give 1 or 0; `choose`
(c, x, y) is x where c is 1, else y, and takes nothing from the other; and, or, not are for 1 and 0. `search` (x, table)
and `pick` (index, table) are those of `table_lookup`; their second operand is an argument that is a table. The tape of
an FMU has `foreign` in their place: what the FMU gives, where time, states and inputs are its operands; see
`blocks.compile.fmu_tape`.
"""


COSTLY, LOGICAL, JOINS, JUMPS, BENDS, WHOLE, KEEPS_WHOLE = (
    frozenset(op for op, operation in OPERATIONS.items() if trait in operation.traits) for trait in _Trait
)
"""The operations by trait."""
