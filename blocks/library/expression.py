"""A formula as a block."""

import functools
import inspect
import operator
import re
import types

from ..contract import expressions
from ..contract.block import Block
from ..contract.equations import crossing, output, requires
from ..contract.scalars import OPERATIONS
from ..contract.variables import Input, Parameter
from ..text.errors import ModelError

__all__ = ["Expression"]

_NAME = re.compile(r"([uk])([1-9][0-9]{0,2})\Z")

_BY_SIGNS = {**{op: OPERATIONS[op].value for op in ("add", "sub", "mul", "div", "neg")}, "pow": operator.pow}
_JOINED = {"and": operator.and_, "or": operator.or_, "not": operator.invert}
_AT_LEAST, _AT_MOST = (">=", "<", "==", "!="), ("<=", ">", "==", "!=")
"""The relations that need to know if the left number is at least the right one, and if it is at most that."""


def _parsed(expression):
    return expressions.parse(expression, has_truths=True)


def _names(expression):
    """The names in an expression; none where it cannot be read, which a separate check reports."""
    try:
        return _parsed(expression).names
    except ModelError:
        return ()


def _count(expression, letter):
    """The largest number that stands behind a letter in the names of an expression."""
    matches = (_NAME.match(name) for name in _names(expression))
    return max((int(match[2]) for match in matches if match and match[1] == letter), default=0)


def _value(values, relation, join):
    """Compute a formula. relation: of a word and two numbers; join: by a word, what relations gave."""
    u, k, t, expression = values

    def operand(step):
        if step.scalar is not None:
            return step.scalar.value
        return t if step.word == "t" else (u if step.word[0] == "u" else k)[int(step.word[1:]) - 1]

    def operation(step, operands):
        if step.word in expressions.RELATIONS:
            return relation(step.word, *operands)
        if step.word in _JOINED:
            return join(step.word, operands)
        return (_BY_SIGNS.get(step.op) or OPERATIONS[step.op].ieee)(*operands)

    return _parsed(expression).folded(operand, operation)


def _differences(*values):
    """Compute the numbers whose signs decide the relations of a formula, in their order."""
    differences = []

    def relation(word, left, right):
        differences.extend([left - right] if word in _AT_LEAST else [])
        differences.extend([right - left] if word in _AT_MOST else [])

    _value(values, relation, lambda word, operands: None)
    return differences


def _truth(u, k, t, expression, *sides):
    """Compute a formula that is a truth value from the sides of its differences."""
    rest = iter(sides)

    def relation(word, left, right):
        at_least = next(rest) if word in _AT_LEAST else None
        at_most = next(rest) if word in _AT_MOST else None
        relations = {
            ">=": lambda: at_least, "<": lambda: ~at_least, "<=": lambda: at_most, ">": lambda: ~at_most,
            "==": lambda: at_least & at_most, "!=": lambda: ~(at_least & at_most),
        }  # fmt: skip
        return relations[word]()

    return _value((u, k, t, expression), relation, lambda word, operands: _JOINED[word](*operands))


def _reading(function, *names):
    """Return the function with names for its arguments."""
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    named = types.FunctionType(function.__code__, globals(), function.__name__, None, function.__closure__)
    named.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in names])
    return named


def _form(given):
    """The class of a formula that is a truth value; None for a number, and where it cannot be read."""
    try:
        parsed = _parsed(given["expression"].value)
    except (KeyError, TypeError, ModelError):
        return None
    counts = [(step.word in _AT_LEAST) + (step.word in _AT_MOST) for step in parsed.steps if step.operands]
    return _condition(sum(counts)) if parsed.is_truth else None


class _Formula(Block, abstract=True):
    """What formulas read."""

    expression = Parameter("u1", structural=True, type="string", doc="the formula")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    k = Parameter([], shape="n", doc="constants k1, k2, ..., which may change during a run")
    u = Input(shape=lambda expression: _count(expression, "u"), ports="u{}", doc="inputs")

    @requires("expression must be arithmetic")
    def is_arithmetic(expression):
        return bool(_parsed(expression).steps)

    @requires("expression reads names that are not u1, u2, ..., k1, k2, ... or t")
    def is_known(expression):
        return all(name == "t" or _NAME.match(name) for name in _names(expression))

    @requires("k must hold as many constants as the expression reads")
    def has_constants(expression, k):
        return _count(expression, "k") <= len(k)


class Expression(_Formula, form=_form):
    """y = a formula over the inputs u1, u2, ..., the constants k1, k2, ... and the time t.

    "k1*sin(u1) + u2**2" has the inputs u1 and u2. The formula is arithmetic: + - * / ** ( ), pi, and abs, acos, asin,
    atan, atan2, cos, exp, log, max, min, sin, sqrt, tan, tanh; angles are in rad and values in SI. The corners of abs,
    max and min are not located: use Abs, MinMax and Saturation if that matters.

    Or it is a condition: comparisons (< <= > >= == !=, also 0 < u1 < k1), joined by and, or, not. Then y is a bool, and
    the instants at which a comparison changes are located. Numbers are equal if all their digits are.
    """

    @output(unit=_Formula.unit, doc="value of the formula")
    def y(u, k, t, expression):
        return _value((u, k, t, expression), None, None)


@functools.cache
def _condition(count):
    """The class of formulas that are truth values, with so many crossings."""
    sides = [f"side{j + 1}" for j in range(count)]

    def fill(body):
        def difference(j):
            def side(*values):
                return _differences(*values)[j]

            return crossing(_reading(side, "u", "k", "t", "expression"))

        body["__doc__"] = Expression.__doc__
        for j, name in enumerate(sides):
            body[name] = difference(j)
        body["y"] = output(type="bool", doc="value of the formula")(
            _reading(_truth, "u", "k", "t", "expression", *sides)
        )
        body["has_no_unit"] = requires("a condition has no unit")(lambda unit: not unit)

    return types.new_class("Expression", (_Formula,), {}, fill)
