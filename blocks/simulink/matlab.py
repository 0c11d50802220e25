"""Values of MATLAB's expressions: numbers, booleans, texts, matrices, ranges, indices, functions that models use.

Nothing is run: an expression has no effect, and of code plain assignments are read, one by one.

    evaluate("2*pi*[f; 2*f]", {"f": scalar(50.0)})     # a matrix of 2 x 1
    values, rest = assignments("m = 2;  c = m/4  % friction", {})

A value is a matrix of two dimensions (float64 or bool), a text, or a structure (a dict of values by name).

Source: MathWorks, MATLAB: Operator Precedence; Array Indexing (documentation of R2024b).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .matlab_functions import (
    FUNCTIONS,
    MOST,
    OF_TEXTS,
    Array,
    NoValue,
    check_size,
    divided,
    matrix,
    power,
    powers,
    product,
    scalar,
)

Value = Array | str | dict[str, Any]

LONGEST = 1_000_000  # characters of one expression or script
MOST_COMPUTED = 30 * MOST  # elements of all steps of one expression or script
DEEPEST = 60
_TOKEN = re.compile(
    r"(?P<space>[ \t\r\f\v\u00a0]+|\.\.\.[^\n]*\n)"
    r"|(?P<comment>%[^\n]*)"
    r"|(?P<number>0[xX][0-9a-fA-F]+|(?:\d+(?:\.(?![*/\\^'])\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z]\w*)"
    r"|(?P<op>\.\*|\./|\.\\|\.\^|\.'|==|~=|!=|<=|>=|&&|\|\||[-+*/\\^:,;<>&|~!()\[\]{}=.@\n])"
)
_TEXT = {"'": re.compile(r"'((?:[^'\n]|'')*)'"), '"': re.compile(r'"((?:[^"\n]|"")*)"')}
_OPENERS = frozenset({"if", "for", "while", "switch", "try", "parfor", "function", "classdef"})
_WITHOUT_VALUES = frozenset({"clc", "close", "format", "hold", "figure"})
_CONSTANTS = {
    "pi": np.pi, "eps": np.finfo(float).eps, "inf": np.inf, "Inf": np.inf, "nan": np.nan, "NaN": np.nan,
    "realmax": np.finfo(float).max, "realmin": np.finfo(float).tiny,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str  # "number", "name", "text", "op", "end"
    text: str
    after_space: bool
    at: int


@dataclass(frozen=True, slots=True)
class Unread:
    """Code that is no plain assignment of a value. line: from 1. why: what prevents it."""

    line: int
    text: str
    why: str


def evaluate(text: str, known: Mapping[str, Value]) -> Value:
    """Return the value of an expression. known: variables. Raises NoValue, with the name of an unknown variable."""
    reader = _Reader(_tokens(text), known, [MOST_COMPUTED])
    return reader.whole()


def names_in(text: str) -> list[str]:
    """Return the names in an expression that are neither functions nor constants, each once. Raises NoValue."""
    tokens = _tokens(text)
    found = [
        token.text
        for before, token in zip([None, *tokens], tokens, strict=False)
        if token.kind == "name" and not (before is not None and before.text == ".")
    ]
    return [name for name in dict.fromkeys(found) if name not in FUNCTIONS and name not in _CONSTANTS and name != "end"]


def assignments(text: str, known: Mapping[str, Value]) -> tuple[dict[str, Value], list[Unread]]:
    """Return the variables after code whose plain assignments are read, and what else it does.

    A variable that other code may have changed has no value afterwards.
    """
    values, rest = dict(known), []
    if len(text) > LONGEST:
        return {}, [Unread(1, "", f"it has more than {LONGEST:,} characters")]
    text = _without_blocks(text)
    left, line, at = [MOST_COMPUTED], 1, 0
    for tokens in _statements(text):
        first, last = tokens[0], tokens[-1]
        line, at = line + text.count("\n", at, first.at), first.at
        if first.text in ("clear", "clearvars"):
            names = {token.text.strip("'\"") for token in tokens[1:] if token.text not in "(),;"}
            is_whole = not names or not all(name.isidentifier() for name in names) or "all" in names
            values = {} if is_whole else {key: value for key, value in values.items() if key not in names}
        elif first.text not in _WITHOUT_VALUES:
            why = _assign(tokens, values, left)
            if why:
                rest.append(Unread(line, " ".join(text[at : last.at + len(last.text)].split())[:200], why))
    return values, rest


def _without_blocks(text: str) -> str:
    """Return code without comments in %{ and %}, each alone on its line; lines keep their numbers."""
    lines, depth = [], 0
    for line in text.split("\n"):
        mark = line.strip()
        depth += (mark == "%{") - (mark == "%}" and depth > 0)
        lines.append("" if depth or mark == "%}" else line)
    return "\n".join(lines)


def _assign(tokens: Sequence[_Token], values: dict[str, Value], left: list[int]) -> str:
    """Carry out one statement; returns why it cannot be, and then forgets what it may have changed."""
    path, at = [tokens[0].text], 1
    while at + 1 < len(tokens) and tokens[at].text == "." and tokens[at + 1].kind == "name":
        path.append(tokens[at + 1].text)
        at += 2
    is_plain = tokens[0].kind == "name" and tokens[0].text not in _OPENERS
    if not is_plain or at >= len(tokens) or tokens[at].text != "=":
        _forget(tokens, values)
        return "it is no plain assignment"
    try:
        reader = _Reader([*tokens[at + 1 :], _Token("end", "", False, 0)], values, left)
        value = reader.whole()
    except NoValue as none:
        values.pop(path[0], None)
        return str(none)
    if len(path) == 1:
        values[path[0]] = value
        return ""
    root = values.get(path[0])
    copied: dict[str, Any] = dict(root) if isinstance(root, dict) else {}
    values[path[0]] = inner = copied
    for name in path[1:-1]:
        below = inner.get(name)
        inner[name] = dict(below) if isinstance(below, dict) else {}
        inner = inner[name]
    inner[path[-1]] = value
    return ""


def _forget(tokens: Sequence[_Token], values: dict[str, Value]) -> None:
    """Take the values from variables to the left of an equals sign: those before it on its line, in brackets too."""
    names: list[str] = []
    for token in tokens:
        if token.text in ("\n", ";") or (token.kind == "name" and token.text in _OPENERS):
            names = []
        elif token.text == "=":
            for name in names:
                values.pop(name, None)
        elif token.kind == "name":
            names.append(token.text)


def _statements(text: str) -> list[list[_Token]]:
    """Return the statements of code; one that opens a block goes on to its end."""
    found: list[list[_Token]] = []
    now: list[_Token] = []
    depth = within = 0
    for token in _tokens(text, is_code=True):
        if not within and token.kind == "name":
            is_first = not now or now[-1].text in ("\n", ";", ",")
            if token.text in _OPENERS and is_first:
                depth += 1
            elif token.text == "end" and depth and is_first:
                depth -= 1
        within += (token.text in "([{") - (token.text in ")]}") if token.kind == "op" else 0
        if token.kind == "bad":
            within = 0
        if token.kind == "end" or (token.text in ("\n", ";", ",") and token.kind == "op" and within <= 0 and not depth):
            if now:
                found.append(now)
            now, within = [], 0
        elif now or token.text not in ("\n", ";", ","):
            now.append(token)
    return found


def _tokens(text: str, *, is_code: bool = False) -> list[_Token]:
    """Return the words of an expression, or of code, and a last one of the kind "end".

    Raises NoValue; in code what cannot be read is a word of the kind "bad", up to the end of its line.
    """
    if len(text) > LONGEST:
        raise NoValue(f"it has more than {LONGEST:,} characters")
    found: list[_Token] = []
    brackets: list[str] = []
    at, space = 0, False

    def bad(why: str) -> int:
        if not is_code:
            raise NoValue(why)
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        found.append(_Token("bad", text[at:end], space, at))
        brackets.clear()
        return end

    while at < len(text):
        char = text[at]
        if char in "'\"" and not (char == "'" and _is_transpose(found, brackets, space)):
            if not (word := _TEXT[char].match(text, at)):
                at, space = bad("a text has no closing quote"), False
                continue
            found.append(_Token("text", word[0], space, at))
        elif char == "'":
            found.append(_Token("op", "'", space, at))
            at, space = at + 1, False
            continue
        elif not (word := _TOKEN.match(text, at)):
            at, space = bad(f"{char!r} is not expected here"), False
            continue
        elif word.lastgroup in ("space", "comment") or (word[0] == "\n" and not is_code and "[" not in brackets):
            space, at = True, word.end()
            continue
        else:
            found.append(_Token(str(word.lastgroup), word[0], space, at))
            if word[0] in "([{":
                brackets.append(word[0])
            elif word[0] in ")]}" and brackets:
                brackets.pop()
        at, space = word.end(), False
    return [*found, _Token("end", "", space, len(text))]


def _is_transpose(found: Sequence[_Token], brackets: Sequence[str], space: bool) -> bool:
    if not found or (space and brackets and brackets[-1] in "[{"):
        return False
    last = found[-1]
    return last.kind in ("name", "number", "text") or last.text in (")", "]", "}", "'", ".'")


class _Reader:
    """Reads and evaluates one expression, by the precedence of MATLAB's operators."""

    def __init__(self, tokens: Sequence[_Token], known: Mapping[str, Value], left: list[int]) -> None:
        self._tokens, self._known = tokens, known
        self._left = left  # how many elements may yet be computed
        self._at = self._depth = 0
        self._in_matrix = False
        self._ends: list[tuple[Array, int, int]] = []  # what is indexed, at which index, of how many

    @property
    def next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        token = self.next
        self._at += token.kind != "end"
        return token

    def _is(self, *texts: str) -> bool:
        return self.next.kind == "op" and self.next.text in texts

    def _is_binary(self, *texts: str) -> bool:
        """Tell whether an operator comes that joins two operands: in a matrix [1 -2] has two elements."""
        if not self._is(*texts):
            return False
        follows = self._tokens[self._at + 1]
        return not (self._in_matrix and self.next.after_space and not follows.after_space and self.next.text in "+-")

    def _expect(self, text: str) -> None:
        if self._take().text != text:
            raise NoValue(f"{text!r} is missing")

    def whole(self) -> Value:
        """Read one expression up to the end, or to semicolons there."""
        value = self.expression()
        while self._is(";"):
            self._take()
        if self.next.kind != "end":
            raise NoValue(f"{self.next.text!r} is not expected here")
        return value

    def expression(self) -> Value:
        """Read one expression."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise NoValue(f"brackets lie more than {DEEPEST} deep")
        value = self._level(0)
        self._depth -= 1
        return value

    _LEVELS: tuple[Mapping[str, Callable[[Array, Array], npt.NDArray[Any]]], ...] = (
        {"||": np.logical_or},
        {"&&": np.logical_and},
        {"|": np.logical_or},
        {"&": np.logical_and},
        {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal,
         "~=": np.not_equal, "!=": np.not_equal},
        {},
        {"+": lambda a, b: a + b, "-": lambda a, b: a - b},
        {"*": product, "/": lambda a, b: divided(a, b), "\\": lambda a, b: divided(b.T, a.T).T,
         ".*": lambda a, b: a * b, "./": lambda a, b: a / b, ".\\": lambda a, b: b / a},
    )  # fmt: skip

    def _level(self, k: int) -> Value:
        if k == len(self._LEVELS):
            return self._unary()
        if not self._LEVELS[k]:
            return self._range(k + 1)
        value = self._level(k + 1)
        while self._is_binary(*self._LEVELS[k]):
            operator = self._LEVELS[k][self._take().text]
            left = _number(value)
            right = _number(self._level(k + 1))
            value = self._computed(operator, *((left, right) if k < 5 else (left + 0.0, right + 0.0)))
        return value

    def _range(self, k: int) -> Value:
        value = self._level(k)
        if not self._is(":") or self._tokens[self._at + 1].text in (")", ","):
            return value
        parts = [_number(value)]
        while self._is(":") and len(parts) < 3:
            self._take()
            parts.append(_number(self._level(k)))
        if any(part.size != 1 for part in parts):
            raise NoValue("a range needs scalars")
        first, *step, last = (float(part[0, 0]) for part in parts)
        return _colon(first, step[0] if step else 1.0, last)

    def _unary(self) -> Value:
        if self._is("+", "-", "~", "!"):
            self._depth += 1
            if self._depth > DEEPEST:
                raise NoValue(f"signs lie more than {DEEPEST} deep")
            sign = self._take().text
            value = _number(self._unary())
            self._depth -= 1
            return value + 0.0 if sign == "+" else 0.0 - value if sign == "-" else ~(value != 0)
        return self._power()

    def _power(self) -> Value:
        value = self._postfix()
        while self._is("^", ".^"):
            is_elementwise = self._take().text == ".^"
            signs = 1.0
            while self._is("+", "-"):
                signs *= -1.0 if self._take().text == "-" else 1.0
            exponent = signs * _number(self._postfix())
            value = self._computed(powers if is_elementwise else power, _number(value) + 0.0, exponent)
        return value

    def _postfix(self) -> Value:
        value = self._operand()
        while self._is("'", ".'") and not (self._in_matrix and self.next.after_space):
            self._take()
            value = _number(value).T
        return value

    def _operand(self) -> Value:
        token = self._take()
        if token.kind == "number":
            text = token.text.lower()
            if self.next.kind == "name" and not self.next.after_space:
                raise NoValue(
                    "complex numbers are not supported" if self.next.text in "ij" else "a number is malformed"
                )
            return scalar(int(text, 16) if text.startswith("0x") else float(text.replace("d", "e")))
        if token.kind == "text":
            return token.text[1:-1].replace(token.text[0] * 2, token.text[0])
        if token.text == "(" and token.kind == "op":
            was, self._in_matrix = self._in_matrix, False
            value = self.expression()
            self._in_matrix = was
            self._expect(")")
            return value
        if token.text == "[":
            return self._matrix()
        if token.kind == "name":
            named: Value = self._named(token.text)
            return named
        what = {"{": "a cell array", "@": "a handle of a function"}.get(token.text)
        raise NoValue(
            f"{what} is not supported"
            if what
            else f"{token.text!r} is not expected here"
            if token.text
            else "it ends too early"
        )

    def _matrix(self) -> Value:
        rows: list[list[Value]] = [[]]
        was, self._in_matrix = self._in_matrix, True
        while not self._is("]"):
            if self.next.kind == "end":
                raise NoValue("']' is missing")
            if self._is(";", "\n"):
                self._take()
                rows.append([])
            elif self._is(","):
                self._take()
            else:
                rows[-1].append(self.expression())
        self._take()
        self._in_matrix = was
        value = matrix([row for row in rows if row])
        return value if isinstance(value, str) else self._computed(lambda: value)

    def _named(self, name: str) -> Any:
        if name == "end" and self._ends:
            indexed, k, n = self._ends[-1]
            return scalar(indexed.size if n == 1 else indexed.shape[k] if k < 2 else 1)
        value: Value | None = self._known.get(name)
        while value is not None and isinstance(value, dict) and self._is("."):
            self._take()
            field = self._take().text
            if field not in value:
                raise NoValue(f"{name} has no field {field}", f"{name}.{field}")
            value, name = value[field], f"{name}.{field}"
        is_call = self._is("(") and not (self._in_matrix and self.next.after_space)
        if value is not None:
            return self._indexed(_number(value)) if is_call else value
        if name in ("true", "false"):
            ones = self._computed(FUNCTIONS["ones"], *(self._arguments(None) if is_call else []))
            return ones == (1 if name == "true" else 0)
        if name in _CONSTANTS and not is_call:
            return scalar(float(_CONSTANTS[name]))
        if name in FUNCTIONS:
            given = self._arguments(None) if is_call else []
            return self._computed(FUNCTIONS[name], *(given if name in OF_TEXTS else map(_number, given)))
        if name in ("i", "j"):
            raise NoValue("complex numbers are not supported", name)
        raise NoValue(f"{name} has no value", name)

    def _computed(self, function: Callable[..., Any], *given: Any) -> Array:
        """Call a function with matrices; what NumPy refuses is no value."""
        shapes = [one.shape for one in given if isinstance(one, np.ndarray)]
        if len(shapes) > 1 and function not in (product, divided):
            check_size(max(rows for rows, _ in shapes), max(columns for _, columns in shapes))
        try:
            with np.errstate(all="ignore"):
                value = np.atleast_2d(np.asarray(function(*given)))
        except (ValueError, TypeError, IndexError, np.linalg.LinAlgError, OverflowError) as error:
            raise NoValue(f"it cannot be computed: {str(error)[:100]}") from None
        if value.ndim != 2:
            raise NoValue("arrays of three dimensions are not supported")
        check_size(*value.shape)
        self._left[0] -= value.size + sum(rows * columns for rows, columns in shapes)
        if self._left[0] < 0:
            raise NoValue(f"more than {MOST_COMPUTED:,} elements are computed")
        if np.iscomplexobj(value):
            raise NoValue("complex numbers are not supported")
        return value if value.dtype == bool else value.astype(float)

    def _arguments(self, indexed: Array | None) -> list[Any]:
        """Read what lies between parentheses; None is a colon alone."""
        self._take()
        was, self._in_matrix = self._in_matrix, False
        count = self._count()
        given: list[Any] = []
        while not self._is(")"):
            if self.next.kind == "end":
                raise NoValue("')' is missing")
            if self._is(":") and self._tokens[self._at + 1].text in (")", ","):
                self._take()
                given.append(None)
            else:
                if indexed is not None:
                    self._ends.append((indexed, len(given), count))
                given.append(self.expression())
                if indexed is not None:
                    self._ends.pop()
            if not self._is(")"):
                self._expect(",")
        self._take()
        self._in_matrix = was
        if indexed is None and any(value is None or isinstance(value, dict) for value in given):
            raise NoValue("a function of this is not supported")
        return given

    def _count(self) -> int:
        """Return how many arguments come."""
        depth, n = 0, 1
        for token in self._tokens[self._at :]:
            if token.kind == "op":
                depth += (token.text in "([{") - (token.text in ")]}")
                n += token.text == "," and not depth
            if depth < 0:
                break
        return n

    def _indexed(self, value: Array) -> Array:
        given = self._arguments(value)
        if len(given) == 1:
            return _elements(value, given[0])
        if len(given) == 2:
            rows, columns = (
                np.arange(n) if one is None else _places(_number(one), n)
                for one, n in zip(given, value.shape, strict=True)
            )
            check_size(rows.size, columns.size)
            return np.asarray(value[np.ix_(rows, columns)])
        raise NoValue("arrays of three dimensions are not supported" if given else "an index is missing")


def _colon(first: float, step: float, last: float) -> Array:
    """Return first:step:last, from both ends to the middle, as MATLAB computes it. Raises NoValue."""
    if not np.isfinite([first, step, last]).all():
        raise NoValue("a range needs finite numbers")
    if not step or (last - first) * step < 0:
        return np.zeros((1, 0))
    check_size(1, (last - first) / step)
    near, n = 2 * np.finfo(float).eps * max(abs(first), abs(last)), round((last - first) / step)
    if np.sign(step) * (first + n * step - last) > near:
        n -= 1
    end = first + n * step
    if np.sign(step) * (end - last) > -near:
        end = last
    k = np.arange(n + 1, dtype=float)
    value = np.where(k <= n // 2, first + k * step, end - (n - k) * step)
    if n % 2 == 0 and n:
        value[n // 2] = (first + end) / 2
    return np.asarray(value[None, :])


def _elements(value: Array, given: Value | None) -> Array:
    """Return elements by one index, column after column; those of a vector lie as the vector does."""
    flat = value.T.reshape(-1)
    if given is None:
        return np.asarray(flat[:, None])
    index = _number(given)
    taken = flat[_places(index, flat.size)]
    is_vector = 1 in value.shape and value.size != 1
    if is_vector and 1 in index.shape:
        return np.asarray(taken[None, :] if value.shape[0] == 1 else taken[:, None])
    if index.dtype == bool:
        return np.asarray(taken[None, :] if index.shape[0] == 1 else taken[:, None])
    return np.asarray(taken.reshape(index.shape[::-1]).T)


def _places(index: Array, n: int) -> npt.NDArray[np.intp]:
    if index.dtype == bool:
        places = np.flatnonzero(index.T.reshape(-1))
    else:
        flat = index.T.reshape(-1)
        if (flat != np.floor(flat)).any():
            raise NoValue("an index is no whole number")
        places = flat.astype(np.intp) - 1
    if places.size and (places.min() < 0 or places.max() >= n):
        raise NoValue(f"an index is not within 1 to {n}")
    return places


def _number(value: Value) -> Array:
    if isinstance(value, np.ndarray):
        return value
    raise NoValue("a text is used as a number" if isinstance(value, str) else "a structure is used as a number")
