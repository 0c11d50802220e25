"""Expressions: the arithmetic in a diagram's `"=kt/(La*Jeq*n)"`, without its leading "=".

    sum     = product { ("+" | "-") product }
    product = signed { ("*" | "/") signed }
    signed  = ("+" | "-") signed | power
    power   = atom [ "**" signed ]               as in Python: -2**2 == -4, 2**3**2 == 512, 2**-1 == 0.5
    atom    = number | name | "pi" | function "(" sum { "," sum } ")" | "(" sum ")"

Where truth values are allowed (`has_truths`), a text may also be one of these, and brackets may hold one:

    truth      = conjunct { "or" conjunct }
    conjunct   = negation { "and" negation }
    negation   = "not" negation | comparison
    comparison = sum relation sum { relation sum }    0 < x < 3 is 0 < x and x < 3; relation: < <= > >= == !=

Nothing else can be written, so a file cannot make a program run. A text is compiled to postfix steps, which are
computed in the order written with one stack: no text, however nested, can exhaust Python's recursion. Values are
floats; beside each goes the exact fraction of the decimals as written, as long as there is one, because periods and
other times must not be rounded (0.1 + 0.2 is 3/10, its float is not).
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TypeVar

from ..text.errors import Fault, ModelError, did_you_mean
from .scalars import OPERATIONS

_T = TypeVar("_T")

# The length also bounds the number of steps: each takes at least one character.
LENGTH, _DEPTH = 1000, 50
_LARGEST_POWER, _LARGEST_BITS = 64, 4096


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number: its float, and the fraction that it stands for exactly, or None where that is not known."""

    value: float
    exact: Fraction | None = None


@dataclass(frozen=True, slots=True)
class PostfixStep:
    """One postfix step: a constant (`scalar`), a name (no operands), or an operation on the last `operands` values.

    `column` counts from 1. The signs are written "neg" and "pos". min and max of several are steps of two.
    """

    word: str
    column: int
    operands: int = 0
    scalar: Scalar | None = None

    @property
    def op(self) -> str:
        """The operation, by its name in `scalars.OPERATIONS`."""
        return _SIGNS.get(self.word, self.word)


@dataclass(frozen=True, slots=True)
class Expression:
    """A parsed expression: its text, its steps, and the names it reads, in order of first appearance.

    is_truth: it is a truth value, and no number.
    """

    text: str
    steps: tuple[PostfixStep, ...]
    names: tuple[str, ...]
    is_truth: bool = False

    @property
    def name(self) -> str | None:
        """The name, where the expression is nothing but one name."""
        return self.names[0] if self.names and len(self.steps) == 1 else None

    def folded(self, operand: Callable[[PostfixStep], _T], operation: Callable[[PostfixStep, list[_T]], _T]) -> _T:
        """What the steps come to: `operand` gives it for numbers and names, `operation` for operations of these."""
        stack: list[_T] = []
        for step in self.steps:
            if not step.operands:
                stack.append(operand(step))
            elif step.word != "pos":
                operands = stack[-step.operands :]
                del stack[-step.operands :]
                stack.append(operation(step, operands))
        return stack.pop()


_SIGNS = {"+": "add", "-": "sub", "*": "mul", "/": "div", "**": "pow", "abs": "fabs"}
RELATIONS = ("<", "<=", ">", ">=", "==", "!=")
"""The relations of two numbers."""
FUNCTIONS = ("abs", "acos", "asin", "atan", "atan2", "cos", "exp", "log", "max", "min", "mod", "sin", "sqrt", "tan",
             "tanh")  # fmt: skip
"""The functions that an expression may call: log is the natural logarithm, mod(x, w) = x - w floor(x/w), angles are in
rad.
"""


def exact_decimal(x: float) -> Fraction:
    """The shortest decimal that reads as this float, as a fraction: 0.1 -> 1/10.

    Raises:
        ValueError: where x is not finite.
    """
    if not math.isfinite(x):
        raise ValueError(f"is {x}, which is not a finite number.")
    return Fraction(repr(float(x)))


LARGEST_DENOMINATOR = 10**6


def exact_time(written: float | Fraction) -> Fraction:
    """Return the fraction that a time means, from a float or from the decimal that stands for one.

    A number that is the double of a fraction with a denominator up to 1e6 is this fraction: 0.00014285714285714287 is
    1/7000. All others are themselves, among them decimals with fewer digits than the fraction. The double stays.
    """
    exact = exact_decimal(written) if isinstance(written, float) else written
    denominator = exact.denominator
    if denominator <= LARGEST_DENOMINATOR or pow(10, denominator.bit_length(), denominator):  # or it is no decimal
        return exact
    digits = exact.numerator
    while digits % denominator:
        digits *= 10
    digits //= denominator  # the decimal without its point
    time = float(exact)
    simple = Fraction(time).limit_denominator(LARGEST_DENOMINATOR)
    is_shorter = abs(simple.numerator) * simple.denominator < abs(digits)
    return simple if is_shorter and float(simple) == time else exact


def _exact_power(a: Fraction, b: Fraction) -> Fraction | None:
    """a to an integer power of moderate size; None for any other power."""
    if b.denominator != 1 or abs(b) > _LARGEST_POWER or (b < 0 and not a):
        return None
    return a ** int(b)


_EXACT: dict[str, Callable[..., Fraction | None]] = {
    # The float of b may differ from 0 by a rounding where b is exactly 0.
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "/": lambda a, b: a / b if b else None},
    **{"**": _exact_power, "neg": operator.neg, "abs": abs, "min": min, "max": max},
    **{"mod": lambda a, b: a % b if b else None},
}

_DOMAINS = {
    "sqrt": "a number that is not negative",
    "log": "a positive number",
    "asin": "a number from -1 to 1",
    "acos": "a number from -1 to 1",
    "**": "a positive base, or an integer power of one that is not 0",
}


def evaluate(expression: Expression, values: Mapping[str, Scalar]) -> Scalar:
    """The value of an expression: IEEE doubles in the order written, and the exact fraction where there is one.

    The fraction passes through + - * / abs min max and integer powers up to 64; it is None once an operand has none,
    or where it would need more than 4096 bits.

    Raises:
        ModelError: E108, where a name is unknown (all of them), a value is not finite, or the arithmetic fails.
    """
    _check_names(expression, values)
    return expression.folded(
        lambda step: values[step.word] if step.scalar is None else step.scalar,
        lambda step, operands: _computed(expression.text, step, operands),
    )


def evaluate_columns(expression: Expression, columns: Mapping[str, Sequence[float]]) -> list[float]:
    """Return the floats of an expression for each row of finite values of its names.

    Raises:
        ArithmeticError, TypeError, ValueError: where `evaluate` refuses one of them.
    """

    size = max(map(len, columns.values()), default=1)

    def computed(step: PostfixStep, operands: list[Sequence[float]]) -> list[float]:
        function = operator.mod if step.word == "mod" else OPERATIONS[step.op].value
        column = [float(x) for x in map(function, *operands)]
        if not all(map(math.isfinite, column)):
            raise ArithmeticError(step.word)
        return column

    return [*expression.folded(lambda s: columns[s.word] if s.scalar is None else [s.scalar.value] * size, computed)]


def check_numbers(expression: Expression) -> None:
    """Raise ModelError (E108) if an operation on numbers alone fails, as in u1 + 1/0."""

    def computed(step: PostfixStep, operands: list[Scalar | None]) -> Scalar | None:
        numbers = [operand for operand in operands if operand is not None]
        if len(numbers) < len(operands) or step.word in RELATIONS or step.word in _WORDS:
            return None
        return _computed(expression.text, step, numbers)

    expression.folded(lambda step: step.scalar, computed)


def _check_names(expression: Expression, values: Mapping[str, Scalar]) -> None:
    faults = []
    for name in expression.names:
        if name not in values:
            message = f"{_quoted(expression.text)} reads '{name}', which is not a known name here."
            faults.append(Fault("E108", "", message, _cure_of_name(name, values)))
        elif not math.isfinite(values[name].value):
            message = f"{_quoted(expression.text)} reads '{name}', which is {values[name].value}."
            faults.append(Fault("E108", "", message, "Give it a finite value."))
    if "pi" in values and any(step.word == "pi" for step in expression.steps):
        message = f"in {_quoted(expression.text)}, 'pi' is the constant, but a value here also has this name."
        faults.append(Fault("E108", "", message, "Rename the value."))
    if faults:
        raise ModelError(*faults)


def _cure_of_name(name: str, values: Mapping[str, Scalar]) -> str:
    if name in FUNCTIONS:
        return f"Write the argument of a function in brackets: {name}(...)."
    near = did_you_mean(name, values)
    if near or not values:
        return near or f"No names are known here: declare the parameter '{name}' first."
    return f"Known: {', '.join(list(values)[:20])}."


def _computed(text: str, step: PostfixStep, operands: list[Scalar]) -> Scalar:
    """The result of one operation. The float comes first: where it overflows, no large fraction is computed."""
    numbers = [operand.value for operand in operands]
    what = ""
    try:
        value = float(operator.mod(*numbers) if step.word == "mod" else OPERATIONS[step.op].value(*numbers))
        if not math.isfinite(value):
            what = "overflow"
    except ZeroDivisionError:
        what = "division by zero"
    except OverflowError:
        what = "overflow"
    except ValueError:
        what = f"{_NAMES.get(step.word, step.word)} takes {_DOMAINS.get(step.word, 'other numbers')}"
    if what:
        message = f"{_quoted(text)}, column {step.column}: {what} in {_shown(step.word, numbers)}."
        raise ModelError(Fault("E108", "", message, "Check the values that it is computed from."))
    return Scalar(value, _fraction(step.word, [operand.exact for operand in operands]))


_NAMES = {"**": "a power"}


def _shown(word: str, numbers: list[float]) -> str:
    """An operation with its numbers."""
    if word[0].isalpha():
        return f"{word}({', '.join(map(repr, numbers))})"
    return f" {word} ".join(f"({x!r})" if x < 0 else repr(x) for x in numbers)


def _fraction(word: str, operands: list[Fraction | None]) -> Fraction | None:
    """The exact result of an operation, or None."""
    known = [operand for operand in operands if operand is not None]
    if word not in _EXACT or len(known) < len(operands):
        return None
    # A power of b bits has about b times the exponent: not worth computing where that is too long.
    if word == "**" and (_bits(known[0]) - 1) * abs(known[1]) > _LARGEST_BITS:
        return None
    return _bounded(_EXACT[word](*known))


def _bounded(exact: Fraction | None) -> Fraction | None:
    return None if exact is None or _bits(exact) > _LARGEST_BITS else exact


def _bits(exact: Fraction) -> int:
    return max(exact.numerator.bit_length(), exact.denominator.bit_length())


def names_at(text: str) -> Iterator[tuple[int, int, str]]:
    """Return the names that an expression reads, with the offsets of begin and end; also those of a faulty one."""
    return _names_in(text, _TOKEN, ("pi",))


def signals_at(text: str) -> Iterator[tuple[int, int, str]]:
    """Return the signals that a condition reads, with the offsets of begin and end; see `names_at`."""
    return _names_in(text, _TOKEN_OF_SIGNALS, (*_WORDS, "pi", "t"))


def _names_in(text: str, tokens: re.Pattern[str], apart: tuple[str, ...]) -> Iterator[tuple[int, int, str]]:
    """Yield the names in a text with their offsets, except functions that are called and the words `apart`."""
    for match in tokens.finditer(text[:LENGTH]):
        is_call = text[match.end() :].lstrip(" \t\r\n").startswith("(") and match[0] in FUNCTIONS
        if match["name"] and match[0] not in apart and not is_call:
            yield match.start(), match.end(), match[0]


@lru_cache(maxsize=4096)
def parse(
    text: str, *, has_parts: bool = False, has_truths: bool = False, truths: frozenset[str] | None = None
) -> Expression:
    """The expression of a text, without the leading "=". has_parts: names may be of two parts, as in noisy.ITAE.

    has_truths: it may be a truth value. truths: of a condition over signals, those that are truth values themselves.

    Raises:
        ModelError: E108, with the column of the first thing that does not fit, and what was expected there.
    """
    if len(text) > LENGTH:
        message = f"the expression has {len(text)} characters; the limit is {LENGTH}."
        raise ModelError(Fault("E108", "", message, "Split it into several parameters."))
    tokens = _TOKEN_OF_PARTS if has_parts else _TOKEN_OF_TRUTHS if has_truths else _TOKEN
    reader = _ExpressionParser(text, tokens if truths is None else _TOKEN_OF_SIGNALS, truths or frozenset())
    is_truth = reader.read_operand(0, 0)
    reader.expect_end()
    names = dict.fromkeys(step.word for step in reader.steps if not step.operands and step.scalar is None)
    return Expression(text, tuple(reader.steps), tuple(names), is_truth)


_TOKEN = re.compile(
    r"(?P<space>[ \t\r\n]+)"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE](?P<exponent>[+-]?[0-9]+))?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>\*\*|[-+*/(),])"
)
_TOKEN_OF_PARTS = re.compile(_TOKEN.pattern.replace("[A-Za-z0-9_]*)", r"[A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)?)"))
_TOKEN_OF_TRUTHS = re.compile(_TOKEN.pattern.replace(r"\*\*|[-", r"\*\*|[<>=!]=|[-<>"))
_ELEMENT = r"[A-Za-z_][A-Za-z0-9_]*(?:\[[A-Za-z0-9_, ]*\])*"
_TOKEN_OF_SIGNALS = re.compile(
    _TOKEN_OF_TRUTHS.pattern.replace(r"[A-Za-z_][A-Za-z0-9_]*)", rf"{_ELEMENT}(?:\.{_ELEMENT})*)")
)
# How tightly an operator binds its left side, and its right side.
_ARITHMETIC = {"+": (10, 10), "-": (10, 10), "*": (20, 20), "/": (20, 20), "**": (40, 29)}
_BINDING = {**_ARITHMETIC, "or": (2, 2), "and": (4, 4), **dict.fromkeys(RELATIONS, (8, 8))}
_WORDS = ("and", "or", "not")
# A sign binds looser than a power and tighter than a product; "not" binds looser than a relation.
_SIGN, _NOT = 30, 6
_FOREIGN = {
    "^": "Write a power with **.",
    "=": "Write one = at the start only, and == for equality. Only conditions have comparisons.",
    ".": "A name cannot contain a point: only parameters of this diagram can be read.",
    "[": "Elements of a vector cannot be read here.",
    **dict.fromkeys("&|!", "Conditions are joined by and, or, not."),
    "×": "Write a product with *.",
    "·": "Write a product with *.",
    "−": "Write the minus sign as '-'.",
}
_ALLOWED = "Use numbers, names, + - * / ** ( ) and " + ", ".join(FUNCTIONS) + "."


class _ExpressionParser:
    """Reads a text from left to right into postfix steps (precedence climbing)."""

    def __init__(self, text: str, tokens: re.Pattern[str], truths: frozenset[str] = frozenset()) -> None:
        self.text, self.tokens, self.truths = text, tokens, truths
        self.has_truths = tokens in (_TOKEN_OF_TRUTHS, _TOKEN_OF_SIGNALS)
        self.binding = _BINDING if self.has_truths else _ARITHMETIC
        self.steps: list[PostfixStep] = []
        self.at = 0
        self._advance()

    def _advance(self) -> None:
        """Go to the next token: its kind ("end" after the last), its text and its place."""
        while True:
            match = self.tokens.match(self.text, self.at)
            self.column = self.at + 1
            if match is None:
                break
            self.at = match.end()
            if not match["space"]:
                break
        if match is None and self.at < len(self.text):
            character = self.text[self.at]
            raise self._wrong(f"{character!r} is not allowed in an expression", _FOREIGN.get(character, _ALLOWED))
        self.match = match
        self.token = match[0] if match else ""

    def _wrong(self, what: str, cure: str = "") -> ModelError:
        return ModelError(Fault("E108", "", f"{_quoted(self.text)}, column {self.column}: {what}.", cure))

    def _expected(self, what: str) -> ModelError:
        actual = f"'{_shortened(self.token)}'" if self.match else "the end"
        return self._wrong(f"expected {what}, found {actual}", self._cure_of_token())

    def _cure_of_token(self) -> str:
        """What is probably meant where a token stands that does not fit."""
        match, before = self.match, self.text[: self.column - 1]
        if match and match["name"] and before.rstrip()[-1:].isdigit():
            is_group = self.token.startswith("_") and before[-1:].isdigit()
            return "Write digits without _." if is_group else "Write a product with *."
        if self.token == "," and before[-1:].isdigit():
            return "Write decimals after a point."
        if self.token.startswith("."):
            return "Write only one decimal point." if before[-1:].isdigit() or before[-1:] == "." else _FOREIGN["."]
        return "Write a product with *." if self.token == "(" else ""

    def expect_end(self) -> None:
        if self.match:
            raise self._expected("an operator or the end")

    def read_operand(self, binding: int, depth: int) -> bool:
        """Read an operand, and operators after it that bind tighter than `binding`. Return if it is a truth value."""
        if depth > _DEPTH:
            raise self._wrong(f"nested more than {_DEPTH} deep", "Split it into several parameters.")
        if self.token in ("+", "-"):
            step = PostfixStep("neg" if self.token == "-" else "pos", self.column, 1)
            self._advance()
            is_truth = self._read_side(step, _SIGN, depth + 1)
        elif self.has_truths and self.token == "not":
            step = PostfixStep("not", self.column, 1)
            self._advance()
            is_truth = self._read_side(step, _NOT, depth + 1)
        else:
            is_truth = self._read_atom(depth)
        last: range | None = None  # the steps of the right side of a relation, which a chain repeats
        while (sides := self.binding.get(self.token)) and sides[0] > binding:
            step = PostfixStep(self.token, self.column, 2)
            is_chained = step.word in RELATIONS and last is not None
            if last is not None and is_chained:
                self.steps += [self.steps[k] for k in last]
            else:
                self._check_side(step, is_truth=is_truth)
            begin = len(self.steps)
            self._advance()
            # Only ** nests to the right; the operands of the others stand beside each other.
            is_truth = self._read_side(step, sides[1], depth + (step.word == "**"))
            last = range(begin, len(self.steps) - 1) if step.word in RELATIONS else None
            if is_chained:
                self.steps.append(PostfixStep("and", step.column, 2))
        return is_truth

    def _read_side(self, step: PostfixStep, binding: int, depth: int) -> bool:
        """Read the last operand of an operator, and add its step. Return if the operator gives a truth value."""
        self._check_side(step, is_truth=self.read_operand(binding, depth))
        self.steps.append(step)
        return step.word in (*_WORDS, *RELATIONS)

    def _check_side(self, step: PostfixStep, *, is_truth: bool) -> None:
        """Refuse a number where an operator takes truth values, and the other way round."""
        if is_truth == (step.word in _WORDS):
            return
        self.column, word = step.column, {"neg": "-", "pos": "+"}.get(step.word, step.word)
        if is_truth:
            raise self._wrong(f"'{word}' takes numbers, not truth values", "Join comparisons by and, or, not.")
        raise self._wrong(f"'{word}' takes truth values, not numbers", "Compare the number, as in x > 0.")

    def _read_atom(self, depth: int) -> bool:
        """Read a number, a name, a call or a bracket. Return if it is a truth value."""
        match, word, column = self.match, self.token, self.column
        if match and match["number"]:
            self.steps.append(PostfixStep(word, column, scalar=self._number(match)))
            self._advance()
        elif match and match["name"] and not (self.has_truths and word in _WORDS):
            self._advance()
            if self.token == "(":
                self._read_call(word, column, depth)
            else:
                self.steps.append(PostfixStep(word, column, scalar=Scalar(math.pi) if word == "pi" else None))
                return word in self.truths
        elif word == "(":
            self._advance()
            is_truth = self.read_operand(0, depth + 1)
            self._close(column)
            return is_truth
        else:
            raise self._expected("a number, a name or '('")
        return False

    def _number(self, match: re.Match[str]) -> Scalar:
        value = float(match[0])
        if math.isinf(value):
            raise self._wrong(f"{_shortened(match[0])} is too large", "The largest number is about 1.8e308.")
        # 1e-999999999 is the float 0, but would be a fraction of a billion digits.
        long = abs(int(match["exponent"] or 0)) > LENGTH
        return Scalar(value, None if long else _bounded(Fraction(match[0])))

    def _read_call(self, word: str, column: int, depth: int) -> None:
        """Read the arguments of a function, from its bracket on."""
        if word not in FUNCTIONS:
            self.column = column
            cure = did_you_mean(word, FUNCTIONS) or f"Functions: {', '.join(FUNCTIONS)}. Write a product with *."
            raise self._wrong(f"there is no function '{_shortened(word)}'", cure)
        bracket, count = self.column, 0
        while not count or self.token == ",":
            self._advance()
            self._check_side(PostfixStep(word, column), is_truth=self.read_operand(0, depth + 1))
            count += 1
            if word in ("min", "max") and count > 1:
                self.steps.append(PostfixStep(word, column, 2))
        self._close(bracket)
        takes, holds = "one argument", count == 1
        if word in ("min", "max"):
            takes, holds = "two or more arguments", count >= 2
        elif word in ("atan2", "mod"):
            takes, holds = "two arguments", count == 2
        if not holds:
            self.column = column
            raise self._wrong(f"{word} takes {takes}, not {count}", "Separate arguments with commas.")
        if word not in ("min", "max"):
            self.steps.append(PostfixStep(word, column, count))

    def _close(self, bracket: int) -> None:
        if self.token != ")":
            raise self._expected(f"an operator or the ')' for the '(' in column {bracket}")
        self._advance()


def _quoted(text: str) -> str:
    """An expression as messages show it, on one line."""
    return repr("=" + _shortened(text, 60))


def _shortened(text: str, length: int = 30) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."
