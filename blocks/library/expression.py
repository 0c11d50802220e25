"""A formula as a block."""

import re
from functools import reduce

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Input, Parameter
from ..text import expressions
from ..text.errors import ModelError

__all__ = ["Expression"]

_NAME = re.compile(r"([uk])([1-9][0-9]{0,2})\Z")

_OPERATIONS = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": lambda a, b: a**b,
    "neg": lambda a: -a,
    "pos": lambda a: a,
    "abs": np.abs,
    "min": lambda *a: reduce(np.minimum, a),
    "max": lambda *a: reduce(np.maximum, a),
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "tanh": np.tanh,
}


def _names(expression):
    """The names in an expression; none where it cannot be read, which a separate check reports."""
    try:
        return expressions.parse(expression).names
    except ModelError:
        return ()


def _count(expression, letter):
    """The largest number that stands behind a letter in the names of an expression."""
    matches = (_NAME.match(name) for name in _names(expression))
    return max((int(match[2]) for match in matches if match and match[1] == letter), default=0)


class Expression(Block):
    """y = a formula over the inputs u1, u2, ..., the constants k1, k2, ... and the time t.

    "k1*sin(u1) + u2**2" has the inputs u1 and u2. The formula is arithmetic only: + - * / ** ( ), pi, and abs, acos,
    asin, atan, atan2, cos, exp, log, max, min, sin, sqrt, tan, tanh; angles are in rad and values in SI. The corners of
    abs, max and min are not located: use Abs, MinMax and Saturation where that matters.
    """

    expression = Parameter("u1", structural=True, type="string", doc="the formula")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    k = Parameter([], shape="n", doc="constants k1, k2, ..., which may be changed during a run")
    u = Input(shape=lambda expression: _count(expression, "u"), ports="u{}", doc="inputs")

    @requires("expression must be arithmetic")
    def is_arithmetic(expression):
        return bool(expressions.parse(expression).steps)

    @requires("expression reads names that are not u1, u2, ..., k1, k2, ... or t")
    def is_known(expression):
        return all(name == "t" or _NAME.match(name) for name in _names(expression))

    @requires("k must hold as many constants as the expression reads")
    def has_constants(expression, k):
        return _count(expression, "k") <= len(k)

    @output(unit=unit, doc="value of the formula")
    def y(u, k, t, expression):
        stack = []
        for step in expressions.parse(expression).steps:
            if step.scalar is not None:
                stack.append(step.scalar.value)
            elif not step.operands:
                stack.append(t if step.word == "t" else (u if step.word[0] == "u" else k)[int(step.word[1:]) - 1])
            else:
                operands = stack[-step.operands :]
                del stack[-step.operands :]
                stack.append(_OPERATIONS[step.word](*operands))
        return stack.pop()
