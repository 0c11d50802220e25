"""Settings of a diagram as data, and the programs that compute those that depend on others.

All numbers are in SI: units were settled when the values were read. The operations are those of equations, with min and
max, and in the order in which they are written, so that C computes the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np

from ..contract.scalars import OPERATIONS, Scalar
from ..contract.tape import TapeNode

# --- programs --------------------------------------------------------------------------------------------------

Program = tuple[TapeNode, ...]
"""Operations, each after its operands, which no other one has; the last is the result. The value of an "argument" is
its place among the numbers of all settings, or among those that a computed default reads. Nothing is simplified."""


def recorded(op: str, *operands: Scalar) -> Scalar:
    """Return an operation; one on constants alone is folded, as compilers may round differently."""
    scalar = Scalar(op, operands)
    if all(operand.op == "constant" for operand in operands):
        return Scalar("constant", (), evaluated(program_of(scalar), ()))
    return scalar


def program_of(result: Scalar) -> Program:
    """Return a recorded expression as a program; an operand that occurs twice is computed twice."""
    order: list[Scalar] = []  # from the end: results before their operands, the last of these first
    stack = [result]
    while stack:
        order.append(stack.pop())
        stack += order[-1].operands
    nodes: list[TapeNode] = []
    places: list[int] = []  # of what no operation has taken yet
    for place, scalar in enumerate(reversed(order)):
        first = len(places) - len(scalar.operands)
        nodes.append(TapeNode(scalar.op, tuple(places[first:]), scalar.value))
        places[first:] = [place]
    return tuple(nodes)


def evaluated(program: Program, numbers: Sequence[float], *, is_strict: bool = False) -> float:
    """Return the value of a program, given the numbers that it reads; NaN if Python refuses an operation.

    is_strict: raise the error of Python instead.
    """
    values: list[float] = []
    for node in program:
        if node.op == "constant":
            values.append(node.value)
        elif node.op == "argument":
            values.append(numbers[int(node.value)])
        else:
            try:
                values.append(float(OPERATIONS[node.op].value(*[values[k] for k in node.operands])))
            except (ArithmeticError, ValueError):
                if is_strict:
                    raise
                values.append(math.nan)
    return values[-1]


def evaluated_each(program: Program, numbers: Sequence[Any], n: int) -> list[float]:
    """Return what `evaluated` gives in each of n rows; numbers that differ are arrays (n,). Raises what Python does."""
    values: list[Iterable[float]] = []
    for node in program:
        if node.op in ("constant", "argument"):
            number = node.value if node.op == "constant" else numbers[int(node.value)]
            values.append(number.tolist() if isinstance(number, np.ndarray) else repeat(number, n))
        else:
            values.append([*map(float, map(OPERATIONS[node.op].value, *[values[k] for k in node.operands]))])
    return [*values[-1]]


NO_MEMBERS: Mapping[str, int] = {}


# --- settings --------------------------------------------------------------------------------------------------


class Setting(NamedTuple):
    """A parameter by its path ("Kp", "left.Kp", "motor.Ra") and what it does.

    causality: "parameter" (a leaf, which is set) or "calculatedParameter" (bound: it is computed). variability: of a
    leaf, whether it may be set at any time ("tunable"), before the start only ("fixed") or never ("constant"); of a
    bound one, when it can change; why: the reason, unless it is tunable. type: "real", "int", "bool", "enum", "text".
    unit: in SI, "" where none is known or the elements differ; display: the declared unit where it is another one. low,
    high: the range of each element, in SI; low_open, high_open: whether the end is excluded. whole: whether elements
    are integers of at most 2^53. members: of an enumeration, its own or that of a copy: the allowed names and numbers.
    A leaf takes on the ranges of its copies; a bound setting has its own, which the computed value may violate.

    values: its elements in C order, in SI, or one text. places: for each element, its indices in p. elements: of a
    bound one, a program for each element; None for a leaf and for texts. first: the index of the first element among
    the numbers of all settings, -1 for a text.
    """

    path: str
    causality: str = "parameter"
    variability: str = "tunable"
    type: str = "real"
    shape: tuple[int, ...] = ()
    unit: str = ""
    display: str = ""
    doc: str = ""
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False
    whole: bool = False
    members: Mapping[str, int] = NO_MEMBERS
    values: tuple[Any, ...] = ()
    places: tuple[tuple[int, ...], ...] = ()
    elements: tuple[Program, ...] | None = None
    first: int = -1
    why: str = ""

    @property
    def is_bound(self) -> bool:
        return self.causality == "calculatedParameter"

    @property
    def span(self) -> range:
        """The indices of its elements among the numbers of all settings."""
        return range(self.first, self.first + len(self.values))


def numbers(settings: Sequence[Setting]) -> list[float]:
    """Return the elements of all settings that are no texts, one after the other, unchanged."""
    return [float(x) for setting in settings if setting.first >= 0 for x in setting.values]


def put(settings: Iterable[Setting], s: Sequence[Any], row: Any) -> None:
    """Put the numbers of settings into their places in the row p; or arrays, into columns."""
    for setting in settings:
        for k, places in enumerate(setting.places):
            for index in places if setting.first >= 0 else ():
                row[index] = s[setting.first + k]
