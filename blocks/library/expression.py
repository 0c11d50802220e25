"""A formula as a block."""

import operator
import re

from ..contract import expressions
from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.scalars import OPERATIONS
from ..contract.variables import Input, Parameter
from ..text.errors import ModelError

__all__ = ["Expression"]

_NAME = re.compile(r"([uk])([1-9][0-9]{0,2})\Z")

_BY_SIGNS = {**{op: OPERATIONS[op].value for op in ("add", "sub", "mul", "div", "neg")}, "pow": operator.pow}


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
    abs, max and min are not located: use Abs, MinMax and Saturation if that matters.
    """

    expression = Parameter("u1", structural=True, type="string", doc="the formula")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    k = Parameter([], shape="n", doc="constants k1, k2, ..., which may change during a run")
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
        def operand(step):
            if step.scalar is not None:
                return step.scalar.value
            return t if step.word == "t" else (u if step.word[0] == "u" else k)[int(step.word[1:]) - 1]

        def operation(step, operands):
            return (_BY_SIGNS.get(step.op) or OPERATIONS[step.op].ieee)(*operands)

        return expressions.parse(expression).folded(operand, operation)
