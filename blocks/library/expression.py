"""A formula as a block."""

import functools
import inspect
import operator
import re
import types

import numpy as np

from ..contract import expressions
from ..contract.block import Block
from ..contract.equations import crossing, output, requires
from ..contract.scalars import OPERATIONS
from ..contract.variables import Discrete, Input, Parameter
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


def _walk(values, turns=(), sides=()):
    """Compute a formula. Return its value, and what it is decided by: the differences of relations, and quotients.

    values: u, k, t and the expression. turns: the whole parts of the quotients of mod, of the first ones or of all.
    sides: those of the differences; without them a truth value is None.
    """
    u, k, t, expression = values
    differences, quotients, rest = [], [], iter(sides)

    def operand(step):
        if step.scalar is not None:
            return step.scalar.value
        return t if step.word == "t" else (u if step.word[0] == "u" else k)[int(step.word[1:]) - 1]

    def modulo(x, width):
        quotients.append(x / width)
        return x - turns[len(quotients) - 1] * width if len(quotients) <= len(turns) else x

    def relation(word, left, right):
        at_least = at_most = None
        if word in _AT_LEAST:
            differences.append(left - right)
            at_least = next(rest, None)
        if word in _AT_MOST:
            differences.append(right - left)
            at_most = next(rest, None)
        if at_least is None and at_most is None:
            return None
        relations = {
            ">=": lambda: at_least, "<": lambda: ~at_least, "<=": lambda: at_most, ">": lambda: ~at_most,
            "==": lambda: at_least & at_most, "!=": lambda: ~(at_least & at_most),
        }  # fmt: skip
        return relations[word]()

    def operation(step, operands):
        if step.word == "mod":
            return modulo(*operands)
        if step.word in expressions.RELATIONS:
            return relation(step.word, *operands)
        if step.word in _JOINED:
            return None if operands[0] is None else _JOINED[step.word](*operands)
        return (_BY_SIGNS.get(step.op) or OPERATIONS[step.op].ieee)(*operands)

    return _parsed(expression).folded(operand, operation), differences, quotients


def _reading(function, *names):
    """Return the function with names for its arguments."""
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    named = types.FunctionType(function.__code__, globals(), function.__name__, None, function.__closure__)
    named.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in names])
    return named


def _form(given):
    """Return the class of a formula that jumps; None for one that does not, or that cannot be read."""
    try:
        parsed = _parsed(given["expression"].value)
    except (KeyError, TypeError, ModelError):
        return None
    words = [step.word for step in parsed.steps if step.operands]
    sides = sum((word in _AT_LEAST) + (word in _AT_MOST) for word in words)
    is_smooth = not parsed.is_truth and "mod" not in words
    return None if is_smooth else _jumping(words.count("mod"), sides, parsed.is_truth)


class _Formula(Block, abstract=True):
    """The parameters and inputs of formulas."""

    expression = Parameter("u1", structural=True, type="string", doc="the formula")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    k = Parameter([], shape="n", doc="constants k1, k2, ..., which may change during a run")
    u = Input(shape=lambda expression: _count(expression, "u"), ports="u{}", doc="inputs")

    @requires("expression must be arithmetic")
    def is_arithmetic(expression):
        parsed = _parsed(expression)
        expressions.check_numbers(parsed)
        return bool(parsed.steps)

    @requires("expression reads names that are not u1, u2, ..., k1, k2, ... or t")
    def is_known(expression):
        return all(name == "t" or _NAME.match(name) for name in _names(expression))

    @requires("k must hold as many constants as the expression reads")
    def has_constants(expression, k):
        return _count(expression, "k") <= len(k)


class Expression(_Formula, form=_form):
    """y = a formula over the inputs u1, u2, ..., the constants k1, k2, ... and the time t.

    "k1*sin(u1) + u2**2" has the inputs u1 and u2. The formula is arithmetic: + - * / ** ( ), pi, and abs, acos, asin,
    atan, atan2, cos, exp, log, max, min, mod, sin, sqrt, tan, tanh; angles are in rad and values in SI. mod(x, w) =
    x - w floor(x/w); the instants at which it jumps are located. The corners of abs, max and min are not located: use
    Abs, MinMax and Saturation if that matters.

    Or it is a condition: comparisons (< <= > >= == !=, also 0 < u1 < k1), joined by and, or, not. Then y is a bool, and
    the instants at which a comparison changes are located. Numbers are equal if all their digits are.
    """

    @output(unit=_Formula.unit, doc="value of the formula")
    def y(u, k, t, expression):
        return _walk((u, k, t, expression))[0]


@functools.cache
def _jumping(mods, count, is_truth):
    """Return the class of formulas with this number of mod and of differences of relations."""
    read = ("u", "k", "t", "expression")
    turns, sides = [f"turns{j + 1}" for j in range(mods)], [f"side{j + 1}" for j in range(count)]

    def passing(j, offset):
        def edge(*values):
            return _walk(values[:4], values[4:-1])[2][j] - (values[-1] + offset)

        return _reading(edge, *read, *turns[: j + 1])

    def whole(j):
        def part(*values):
            return np.floor(_walk(values[:4], values[4:])[2][j])

        return _reading(part, *read, *turns[:j])

    def difference(j):
        def side(*values):
            return _walk(values[:4], values[4:])[1][j]

        return _reading(side, *read, *turns)

    def value(*values):
        return _walk(values[:4], values[4 : 4 + mods], values[4 + mods :])[0]

    def fill(body):
        body["__doc__"] = Expression.__doc__
        for j, name in enumerate(turns):
            body[name] = turn = Discrete(doc="whole part of the quotient of a mod")
            body[f"above{j + 1}"] = above = crossing(direction="up")(passing(j, 1.0))
            body[f"below{j + 1}"] = below = crossing(direction="down")(passing(j, 0.0))
            body[f"whole{j + 1}"] = turn.initial(above.reset(turn)(below.reset(turn)(whole(j))))
        for j, name in enumerate(sides):
            body[name] = crossing(difference(j))
        kind = {"type": "bool"} if is_truth else {"unit": _Formula.unit}
        body["y"] = output(**kind, doc="value of the formula")(_reading(value, *read, *turns, *sides))
        if is_truth:
            body["has_no_unit"] = requires("a condition has no unit")(lambda unit: not unit)

    return types.new_class("Expression", (_Formula,), {}, fill)
