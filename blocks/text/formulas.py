"""Formulas in plain text, as docstrings have them -> MathML.

    relation = sum { ("=" | "<" | "<=" | ">" | ">=" | "!=" | "->" | "...") sum }
    sum      = [sign] product { sign product }                   sign: "+", "-", "+-"
    product  = factor { ["*" | "/"] factor }                     from left to right: a/b c is (a/b) c
    factor   = atom [ "^" exponent ] | function factor           sgn e, cos theta
    atom     = number | name | derivative | name "(" list ")" | name "[" list "]"
             | "(" list ")" | "[" list "]" | "|" relation "|" | "..." | ("sum" | "integral") "of" product
    derivative = dx/dt, d name/dt

A formula is found in a text as the longest part that this grammar reads and that has an operator in it; all else is
text, as it stands. Names are the variables of the block, Greek letters, single letters, letters with digits, and what
has an underscore. English words join a formula nowhere, and those that are also names ("at", "before") only beside a
sign or a relation.

A formula that is read keeps every word of its text, in order: `plain` gives it back. Its fractions and exponents reach
as far as the grammar says, and `value` computes it by the same tree, so that tests can hold it against the block.

Longer than other modules: each rule of the grammar is a method here, and each is short.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

from .formula_tree import (
    FUNCTIONS,
    RELATIONS,
    SIGNS,
    Applied,
    Call,
    Derivative,
    Dots,
    Group,
    Name,
    Names,
    Node,
    Number,
    Power,
    Product,
    Relation,
    Style,
    Sum,
    Whole,
)

WITHOUT_BRACKETS = ("sin", "cos", "tan", "tanh", "exp", "log", "ln", "sgn")
"""Functions that take the next factor where no bracket follows."""

_BINDING = ("=", "<", ">", "<=", ">=", "!=", "^", "/", "*", "+", "-")

_WORD = re.compile(
    r"""(?P<code>`[^`]+`|\{"[^{}]*\}|"[^"]*")
    |(?P<number>\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![A-Za-z0-9_]))
    |(?P<name>[A-Za-z][A-Za-z0-9]*(?:_(?:\{[^{}\s]*\}|[A-Za-z0-9]+))*(?:'+(?![A-Za-z]))?)
    |(?P<sign>\.\.\.|<=|>=|!=|->|\+-|[-+*/^=<>()\[\]|,;])
    |(?P<other>\S)""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class Word:
    """A word of a text with its place, and whether white space stands before and behind it."""

    kind: str
    text: str
    start: int
    end: int
    spaced: bool
    followed: bool


def words_of(text: str) -> list[Word]:
    made = []
    for match in _WORD.finditer(text):
        start, end = match.span()
        before = start == 0 or text[start - 1].isspace()
        behind = end == len(text) or text[end].isspace()
        made.append(Word(match.lastgroup or "", match[0], start, end, before, behind))
    return made


# --- reading ---------------------------------------------------------------------------------------------------


@dataclass
class _Reader:
    """Reads formulas out of words; each method gives a node and leaves `at` behind it, or gives None."""

    words: list[Word]
    names: Names
    at: int = 0
    bars: int = 0  # how many | are open

    def whole(self) -> Node | None:
        """All the words as one formula."""
        node = self.relation()
        return node if self.at == len(self.words) else None

    def peek(self, ahead: int = 0) -> Word | None:
        index = self.at + ahead
        return self.words[index] if index < len(self.words) else None

    def is_sign(self, *texts: str) -> bool:
        word = self.peek()
        return word is not None and word.kind == "sign" and word.text in texts

    def tried(self, read: Callable[[], Node | None]) -> Node | None:
        """What is read, or None with `at` where it was."""
        at, bars = self.at, self.bars
        node = read()
        if node is None:
            self.at, self.bars = at, bars
        return node

    def relation(self, *, beside: bool = True) -> Node | None:
        """A relation, or one side alone. beside: whether it begins beside a sign, a relation or a bracket."""
        first = self.tried(lambda: self.sum(beside=beside))
        if first is None:
            return None
        sides: list[tuple[str, Node]] = [("", first)]
        while self.is_sign(*RELATIONS):
            at, sign = self.at, self.words[self.at].text
            self.at += 1
            side = self.tried(self.sum)
            if side is None:
                self.at = at
                break
            sides.append((sign, side))
        return Relation(tuple(sides)) if len(sides) > 1 else first

    def sum(self, *, beside: bool = True) -> Node | None:
        sign = ""
        if self.is_sign(*SIGNS):
            word = self.words[self.at]
            if (word.followed and word.text != "+-") or not (word.spaced or self.is_open()):
                return None  # a dash, or a hyphen
            sign, self.at = word.text, self.at + 1
        first = self.tried(lambda: self.product(beside=beside or bool(sign)))
        if first is None:
            return None
        terms: list[tuple[str, Node]] = [(sign, first)]
        while self.is_sign(*SIGNS):
            at, word = self.at, self.words[self.at]
            self.at += 1
            term = self.tried(self.product) if self.is_binary(word) else None
            if term is None:
                self.at = at
                break
            terms.append((word.text, term))
        return Sum(tuple(terms)) if sign or len(terms) > 1 else first

    def is_open(self) -> bool:
        """Whether the word before here is a sign after which a term begins."""
        before = self.words[self.at - 1] if self.at else None
        return before is None or (before.kind == "sign" and before.text not in (")", "]", "|"))

    def is_binary(self, word: Word) -> bool:
        """Whether a sign stands between two terms: a - b, +- u2, n-1, but no hyphen."""
        if word.spaced:
            return word.followed or word.text == "+-"
        behind = self.peek()
        return not word.followed and behind is not None and (behind.kind == "number" or word.text == "+")

    def product(self, *, beside: bool = True) -> Node | None:
        first = self.tried(lambda: self.factor(beside=beside))
        if first is None:
            return None
        factors: list[tuple[str, Node]] = [("", first)]
        while True:
            at, sign = self.at, ""
            if self.is_sign("*", "/"):
                sign, self.at = self.words[self.at].text, self.at + 1
            elif self.is_sign("|") and self.bars:
                break
            # A number stands before other factors, and dots stand alone.
            if not sign and self.is_sign("["):
                break  # a list is no factor: "num [1]"
            factor = self.tried(lambda beside=sign == "*": self.factor(beside=beside))  # type: ignore[misc]
            following = self.peek()
            opens = following is not None and following.text == "("  # (s - z1) ... (s - zn)
            if factor is None or (not sign and isinstance(factor, (Number, Dots)) and not opens):
                self.at = at
                break
            factors.append((sign, factor))
        if self.is_sign("...") and all(not sign for sign, _ in factors) and not isinstance(factors[-1][1], Dots):
            following = self.peek(1)
            if following is None or following.kind == "sign" or following.kind == "other":
                self.at += 1
                factors.append(("", Dots()))
        return Product(tuple(factors)) if len(factors) > 1 else first

    def factor(self, *, beside: bool) -> Node | None:
        """A factor. beside: whether it stands beside a sign or a relation, so that weak names may stand there."""
        word = self.peek()
        if word is None:
            return None
        if word.kind == "name" and word.text in WITHOUT_BRACKETS and word.text not in self.names.declared:
            following = self.peek(1)
            if following is not None and (following.text != "(" or following.spaced):
                self.at += 1
                to = self.tried(lambda: self.factor(beside=True))
                return None if to is None else Applied(Name(word.text), to)
        base = self.atom(beside)
        if base is None:
            return None
        if self.is_sign("^"):
            self.at += 1
            exponent = self.exponent()
            return None if exponent is None else Power(base, exponent)
        return base

    def exponent(self) -> Node | None:
        word = self.peek()
        if word is not None and word.text == "-":
            self.at += 1
            inner = self.tried(lambda: self.atom(False))
            return None if inner is None else Sum((("-", inner),))
        return self.atom(True)

    def atom(self, beside: bool) -> Node | None:
        word = self.peek()
        assert word is not None or self.at >= len(self.words)
        if word is None:
            return None
        if word.kind == "number":
            self.at += 1
            return Number(word.text)
        if word.text == "...":
            following = self.peek(1)
            stands = following is None or following.kind in ("sign", "other")
            if stands and (beside or (following is not None and following.text == "(")):
                self.at += 1
                return Dots()
            return None
        if word.kind == "sign":
            return self.bracketed(word.text)
        if word.kind != "name":
            return None
        if word.text in ("sum", "integral") and (following := self.peek(1)) and following.text == "of":
            self.at += 2
            of = self.tried(self.product)
            return None if of is None else Whole(word.text, of)
        derivative = self.tried(self.derivative)
        if derivative is not None:
            return derivative
        return self.named(word, beside)

    def bracketed(self, sign: str) -> Node | None:
        if sign == "|":
            self.at, self.bars = self.at + 1, self.bars + 1
            inner = self.relation()
            if inner is None or not self.is_sign("|"):
                return None
            self.at, self.bars = self.at + 1, self.bars - 1
            return Group((inner,), "||")
        if sign not in ("(", "["):
            return None
        return self.list(sign)

    def list(self, sign: str) -> Group | None:
        """A list from its opening to its closing bracket."""
        bars, self.bars = self.bars, 0
        items: list[Node] = []
        while True:
            self.at += 1
            item = self.tried(self.relation)
            if item is None:
                return None
            items.append(item)
            if not self.is_sign(","):
                break
        if not self.is_sign({"(": ")", "[": "]"}[sign]):
            return None
        self.at, self.bars = self.at + 1, bars
        return Group(tuple(items), {"(": "()", "[": "[]"}[sign])

    def derivative(self) -> Node | None:
        """dx/dt, or d x/dt."""
        word, second = self.words[self.at], self.peek(1)
        apart = word.text == "d" and second is not None and second.kind == "name" and second.spaced
        first = second if apart else word
        assert first is not None
        of = first.text if apart else word.text[1:]
        slash, below = self.peek(2 if apart else 1), self.peek(3 if apart else 2)
        if slash is None or slash.text != "/" or slash.spaced or below is None or below.spaced:
            return None
        if not word.text.startswith("d") or word.text in self.names.declared or below.text in self.names.declared:
            return None
        order = ""
        if not apart and (higher := re.match(r"([2-9])(?=[A-Za-z])", of)):
            order, of = higher[1], of[1:]
        if not of[:1].isalpha() or not below.text.startswith("d") or not below.text.endswith(order):
            return None
        by = below.text[1 : len(below.text) - len(order)]
        if not (self.names.has(of) and self.names.has(by)):
            return None
        self.at += 4 if apart else 3
        return Derivative(Name(of), Name(by), apart, order)

    def named(self, word: Word, beside: bool) -> Node | None:
        text = word.text
        following = self.peek(1)
        opens = following is not None and following.text in ("(", "[") and not following.spaced
        is_name = self.names.has(text)
        if not is_name and not (opens and text.islower()):
            return None
        if self.names.is_weak(text) and not beside and not (following is not None and following.text in _BINDING):
            return None
        if text == "a" and text not in self.names.declared and following is not None and following.kind == "name":
            behind = following.text  # "y = a formula", and not "a x", "a where x > 0"
            if not (self.names.has(behind) or self.names.is_weak(behind) or behind in FUNCTIONS):
                return None
        self.at += 1
        if opens:
            assert following is not None
            group = self.tried(lambda: self.list(following.text))
            if isinstance(group, Group):
                return Call(Name(text), group, text in FUNCTIONS or is_name)
            if not is_name or text in FUNCTIONS:
                return None
        return Name(text) if text not in FUNCTIONS or text in self.names.declared else None


# --- texts -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Words:
    """A part of a text that is no formula."""

    text: str


@dataclass(frozen=True, slots=True)
class Code:
    """A part of a text that stands in backquotes or quotation marks."""

    text: str


@dataclass(frozen=True, slots=True)
class Formula:
    """A part of a text that was read as a formula, and that part."""

    node: Node
    text: str


Part = Words | Code | Formula


def formulas_in(text: str, names: Names) -> list[Part]:
    """A text as words, code and formulas, in order; nothing is left out."""
    reader = _Reader(words_of(text), names)
    made: list[Part] = []
    done = at = 0

    def add(part: Part, start: int, end: int) -> None:
        nonlocal done
        if start > done:
            made.append(Words(text[done:start]))
        made.append(part)
        done = end

    while at < len(reader.words):
        word = reader.words[at]
        if word.kind == "code":
            bare = word.text[1:-1] if word.text.startswith("`") else word.text
            add(Code(bare), word.start, word.end)
            at += 1
            continue
        node = None
        if word.kind != "other" and not (word.kind == "sign" and word.text in RELATIONS):
            reader.at, reader.bars = at, 0
            node = reader.tried(lambda: reader.relation(beside=False))
        if node is not None and _is_formula(node, names) and _ends(reader):
            last = reader.words[reader.at - 1]
            add(Formula(node, text[word.start : last.end]), word.start, last.end)
            at = reader.at
        else:
            at += 1
    if done < len(text):
        made.append(Words(text[done:]))
    return made


def _is_formula(node: Node, names: Names) -> bool:
    if isinstance(node, Name):
        # k_i is an element of something; y_start is the name of a parameter.
        return ("_" in node.text and node.text not in names.declared) or node.text == "pi"
    if isinstance(node, Sum) and len(node.terms) == 1 and isinstance(node.terms[0][1], Number):
        return False  # a number with a sign
    return node.operates


def _ends(reader: _Reader) -> bool:
    """Whether a formula ends where a reader would end it, and not in the middle of something it does not read."""
    word = reader.peek()
    return word is None or word.spaced or word.text in {",", ";", ")", "]", ":", ".", "?"}


def html(formula: Formula, names: Names, *, display: bool = False) -> str:
    """A formula as HTML. A long one may be broken at its relations and outer signs.

    display: its fractions are stacked; in a line of text they have a slash.
    """
    style = Style(display, names)
    attribute = ' displaystyle="true"' if display else ""
    parts = [formula.node.show(style)] if len(formula.text) <= SHORT else _parts(formula.node, style)
    inside = "<wbr>".join(f"<math{attribute}>{part}</math>" for part in parts)
    return f'<span class="formula" role="math" aria-label="{escape(formula.text)}">{inside}</span>'


SHORT = 24
"""Formulas of so many characters stay on one line."""


def _parts(node: Node, style: Style) -> list[str]:
    """What may stand on lines of their own."""
    made: list[str] = []
    for sign, side in node.sides if isinstance(node, Relation) else (("", node),):
        relation = f'<mo form="infix">{RELATIONS[sign]}</mo>' if sign else ""
        for index, (mark, term) in enumerate(side.terms if isinstance(side, Sum) else (("", side),)):
            form = "prefix" if index == 0 else "infix"
            shown = (f'<mo form="{form}">{SIGNS[mark]}</mo>' if mark else "") + term.show(style)
            made.append(relation + shown if index == 0 else shown)
    return made
