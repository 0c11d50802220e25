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
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

__all__ = ["Code", "Formula", "Names", "Node", "Words", "formulas_in", "html"]

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "iota": "ι", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ",
    "tau": "τ", "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω", "Gamma": "Γ", "Delta": "Δ", "Theta": "Θ",
    "Lambda": "Λ", "Sigma": "Σ", "Phi": "Φ", "Psi": "Ψ", "Omega": "Ω", "inf": "∞",
}  # fmt: skip

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log,
    "ln": np.log, "log10": np.log10, "sqrt": np.sqrt, "sgn": np.sign, "sign": np.sign, "abs": np.abs, "floor": np.floor,
    "ceil": np.ceil, "round": np.round, "min": min, "max": max,
}  # fmt: skip

WITHOUT_BRACKETS = ("sin", "cos", "tan", "tanh", "exp", "log", "ln", "sgn")
"""Functions that take the next factor where no bracket follows."""

# Words that are no names, however short, and that as names of a block join a formula only beside a sign or a relation.
ENGLISH = frozenset(
    "a an the and or not no nor if then else where when while until unless with without within of for from to into "
    "onto in out on off at by as is are be it its so than that this over under up down per each all any both but "
    "before after above below between beyond held last next once again here there has have may must can do we us "
    "eq eqs ref al vs ie eg".split()
)

RELATIONS = {"=": "=", "<": "&lt;", ">": "&gt;", "<=": "≤", ">=": "≥", "!=": "≠", "->": "→", "...": "…", "~": "∼"}
THIN = '<mspace width="0.17em"/>'
SIGNS = {"+": "+", "-": "−", "+-": "±"}

_BINDING = ("=", "<", ">", "<=", ">=", "!=", "^", "/", "*")

_WORD = re.compile(
    r"""(?P<code>`[^`]+`|\{"[^{}]*\}|"[^"]*")
    |(?P<number>\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![A-Za-z0-9_]))
    |(?P<name>[A-Za-z][A-Za-z0-9]*(?:_(?:\{[^{}\s]*\}|[A-Za-z0-9]+))*(?:'+(?![A-Za-z]))?)
    |(?P<sign>\.\.\.|<=|>=|!=|->|\+-|[-+*/^=<>()\[\]|,;~])
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


@dataclass(frozen=True)
class Names:
    """The names that a text may use in formulas. vectors: those with elements x1 ... xn."""

    declared: frozenset[str] = frozenset()
    vectors: frozenset[str] = frozenset()

    def has(self, text: str) -> bool:
        """Whether a word is a name of a formula."""
        bare = text.rstrip("'")
        if bare in self.declared or bare in GREEK or "_" in bare or bare == "tick":
            return True
        if self.is_weak(bare):
            return bare == "a"
        if bare.startswith("d") and bare[1:] in (self.declared | GREEK.keys()):
            return True
        stem = bare.rstrip("0123456789")
        return len(stem) <= 2 or (stem != bare and (stem in self.declared or stem in GREEK))

    def is_weak(self, text: str) -> bool:
        """Whether a name is also an English word that may stand beside a formula."""
        return text in ENGLISH or (len(text) > 1 and text.lower() in ENGLISH)

    def is_index_of_vector(self, text: str) -> bool:
        """xn, where x has elements."""
        return len(text) == 2 and text[1] in "nkmijp" and text[0] in self.vectors and text not in self.declared


# --- the tree --------------------------------------------------------------------------------------------------

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Node:
    """A part of a formula. value: computed by names; KeyError where a name has none, TypeError where nothing has."""

    def plain(self) -> str:
        """The words of the text, without spaces."""
        raise NotImplementedError

    def show(self, style: Style) -> str:
        """MathML."""
        raise NotImplementedError

    def value(self, known: Values) -> Any:
        raise TypeError(f"{self.plain()} has no value")

    @property
    def operates(self) -> bool:
        """Whether it is more than names beside each other."""
        return any(child.operates for child in self.children)

    @property
    def children(self) -> tuple[Node, ...]:
        return ()


@dataclass(frozen=True)
class Style:
    """display: fractions are stacked; in a line of text they have a slash. names: see `Names`."""

    display: bool
    names: Names


@dataclass(frozen=True)
class Number(Node):
    text: str

    def plain(self) -> str:
        return self.text

    def show(self, style: Style) -> str:
        mantissa, _, exponent = self.text.lower().partition("e")
        if not exponent:
            return f"<mn>{mantissa}</mn>"
        raised = f"<mn>{exponent.lstrip('+-').lstrip('0') or '0'}</mn>"
        raised = f"<mrow><mo>−</mo>{raised}</mrow>" if exponent.startswith("-") else raised
        return f"<mrow><mn>{mantissa}</mn><mo>×</mo><msup><mn>10</mn>{raised}</msup></mrow>"

    def value(self, known: Values) -> Any:
        return float(self.text)


@dataclass(frozen=True)
class Name(Node):
    text: str

    def plain(self) -> str:
        return self.text

    def show(self, style: Style) -> str:
        bare = self.text.rstrip("'")
        primes = "<mo>′</mo>" * (len(self.text) - len(bare))
        base, below = _split(bare, style.names)
        shown = _letters(base)
        if below:
            parts = ",".join(below)
            lowered = _subscript(parts, style)
            made = f"<msub>{shown}{lowered}</msub>"
            return f"<msup>{made}<mrow>{primes}</mrow></msup>" if primes else made
        return f"<msup>{shown}<mrow>{primes}</mrow></msup>" if primes else shown

    def value(self, known: Values) -> Any:
        if self.text in known:
            return known[self.text]
        if self.text in ("pi", "inf"):
            return getattr(math, self.text)
        raise KeyError(self.text)

    @property
    def operates(self) -> bool:
        return self.text.endswith("'")


def _split(bare: str, names: Names) -> tuple[str, list[str]]:
    """A name as its letters and what is lowered: omega_right -> omega, [right]; k1_i -> k, [1, i]."""
    if names.is_index_of_vector(bare):
        return bare[0], [bare[1]]
    first, *rest = re.split(r"_(?![^{]*\})", bare)
    stem = first.rstrip("0123456789")
    below = [first[len(stem) :]] if stem != first else []
    return stem, [*below, *(part.strip("{}") for part in rest)]


def _letters(base: str) -> str:
    if base in GREEK:
        return f"<mi>{GREEK[base]}</mi>"
    if base.startswith("d") and base[1:] in GREEK:
        return f"<mrow><mi>d</mi><mi>{GREEK[base[1:]]}</mi></mrow>"
    return f"<mi>{escape(base)}</mi>"


def _subscript(text: str, style: Style) -> str:
    node = _Reader(words_of(text), style.names).whole()
    if isinstance(node, Sum):
        return node.show(Style(False, style.names))
    if text in GREEK or len(text) == 1 or text.isdecimal():
        return f"<mn>{text}</mn>" if text.isdecimal() else _letters(text)
    return f"<mtext>{escape(text)}</mtext>"


@dataclass(frozen=True)
class Dots(Node):
    def plain(self) -> str:
        return "..."

    def show(self, style: Style) -> str:
        return "<mo>…</mo>"


@dataclass(frozen=True)
class Derivative(Node):
    """dx/dt, and d x/dt where the name is a word."""

    of: Name
    by: Name
    apart: bool  # whether white space stands behind the first d

    def plain(self) -> str:
        return f"d{self.of.plain()}/d{self.by.plain()}"

    def show(self, style: Style) -> str:
        space = '<mspace width="0.15em"/>' if len(_split(self.of.text, style.names)[0]) > 1 and self.apart else ""
        above = f"<mrow><mi>d</mi>{space}{self.of.show(style)}</mrow>"
        below = f"<mrow><mi>d</mi>{self.by.show(style)}</mrow>"
        # In a line of text a slash, which all readers take for a derivative.
        return f"<mfrac>{above}{below}</mfrac>" if style.display else f"<mrow>{above}<mo>/</mo>{below}</mrow>"

    def value(self, known: Values) -> Any:
        return known[self.plain()]

    @property
    def operates(self) -> bool:
        return True


@dataclass(frozen=True)
class Group(Node):
    """A list in brackets."""

    items: tuple[Node, ...]
    brackets: str = "()"

    def plain(self) -> str:
        return self.brackets[0] + ",".join(item.plain() for item in self.items) + self.brackets[1]

    def inside(self, style: Style) -> str:
        """The list without its brackets. No fraction is stacked in it: not every font has brackets of any height."""
        style = Style(False, style.names)
        return '<mo separator="true">,</mo>'.join(item.show(style) for item in self.items)

    def show(self, style: Style) -> str:
        left, right = self.brackets
        return f"<mrow><mo>{left}</mo>{self.inside(style)}<mo>{right}</mo></mrow>"

    def value(self, known: Values) -> Any:
        if len(self.items) != 1 or self.brackets == "[]":
            raise TypeError("a list has no single value")
        value = self.items[0].value(known)
        return abs(value) if self.brackets == "||" else value

    @property
    def children(self) -> tuple[Node, ...]:
        return self.items

    @property
    def operates(self) -> bool:
        return self.brackets == "||" or any(item.operates for item in self.items)


@dataclass(frozen=True)
class Call(Node):
    """A function of a list, or an element of something: g(e), z[0]."""

    name: Name
    group: Group
    is_known: bool  # a function of the table, or a name of the block

    def plain(self) -> str:
        return self.name.plain() + self.group.plain()

    def show(self, style: Style) -> str:
        inside = self.group.inside(style)
        match self.name.text:
            case "sqrt" if len(self.group.items) == 1:
                return f"<msqrt>{inside}</msqrt>"
            case "abs" if len(self.group.items) == 1:
                return f"<mrow><mo>|</mo>{inside}<mo>|</mo></mrow>"
            case "floor" if len(self.group.items) == 1:
                return f"<mrow><mo>⌊</mo>{inside}<mo>⌋</mo></mrow>"
            case "ceil" if len(self.group.items) == 1:
                return f"<mrow><mo>⌈</mo>{inside}<mo>⌉</mo></mrow>"
        return f"<mrow>{self.name.show(style)}<mo>&#x2061;</mo>{self.group.show(style)}</mrow>"

    def value(self, known: Values) -> Any:
        if self.group.brackets == "[]":
            (index,) = (item.value(known) for item in self.group.items)
            return self.name.value(known)[int(index)]
        if self.name.text not in FUNCTIONS:
            raise KeyError(self.name.text)
        return FUNCTIONS[self.name.text](*(item.value(known) for item in self.group.items))

    @property
    def children(self) -> tuple[Node, ...]:
        return self.group.items

    @property
    def operates(self) -> bool:
        return self.is_known and self.group.brackets == "()"


@dataclass(frozen=True)
class Applied(Node):
    """A function without brackets: sgn e."""

    name: Name
    to: Node

    def plain(self) -> str:
        return self.name.plain() + self.to.plain()

    def show(self, style: Style) -> str:
        return f'<mrow>{self.name.show(style)}{THIN}{self.to.show(style)}</mrow>'

    def value(self, known: Values) -> Any:
        return FUNCTIONS[self.name.text](self.to.value(known))

    @property
    def operates(self) -> bool:
        return True


@dataclass(frozen=True)
class Power(Node):
    base: Node
    exponent: Node

    def plain(self) -> str:
        return f"{self.base.plain()}^{self.exponent.plain()}"

    def show(self, style: Style) -> str:
        exponent, small = self.exponent, Style(False, style.names)
        # y^(n) is a derivative, whose brackets belong to it; other brackets only say how far the exponent goes.
        is_order = isinstance(self.base, Name) and re.match(r"\([nki]([-+]\d)?\)\Z", exponent.plain())
        if isinstance(exponent, Group) and exponent.brackets == "()" and not is_order:
            raised = f"<mrow>{exponent.inside(small)}</mrow>"
        else:
            raised = exponent.show(small)
        return f"<msup>{self.base.show(style)}{raised}</msup>"

    def value(self, known: Values) -> Any:
        return self.base.value(known) ** self.exponent.value(known)

    @property
    def operates(self) -> bool:
        return True


@dataclass(frozen=True)
class Product(Node):
    """Factors from left to right, each with "", "*" or "/" before it."""

    factors: tuple[tuple[str, Node], ...]

    def plain(self) -> str:
        return "".join(sign + factor.plain() for sign, factor in self.factors)

    def show(self, style: Style) -> str:
        shown: list[tuple[str, bool]] = []  # what is shown so far, and whether it can go above a fraction bar
        for index, (sign, factor) in enumerate(self.factors):
            following = self.factors[index + 1][0] if index + 1 < len(self.factors) else "end"
            # A slash with another factor behind it would not tell how far it reaches: a/b c.
            if sign == "/" and (style.display or following != "end"):
                first = len(shown)
                while first and shown[first - 1][1]:
                    first -= 1
                first = 0 if first == len(shown) else first  # a fraction over something
                above = [text for text, _ in shown[first:]]
                is_lone = index == 1
                numerator = _bare(self.factors[0][1], style) if is_lone else _joined(above)
                shown[first:] = [(f"<mfrac>{numerator}{_bare(factor, style)}</mfrac>", False)]
            elif sign == "/":
                shown[-1] = (f"{shown[-1][0]}<mo>/</mo>{factor.show(style)}", True)
            elif sign == "*":
                shown[-1:] = [(f"{shown[-1][0]}<mo>·</mo>{factor.show(style)}", shown[-1][1])]
            else:
                shown.append((factor.show(style), not isinstance(factor, Derivative)))
        return _joined([text for text, _ in shown])

    def value(self, known: Values) -> Any:
        made = self.factors[0][1].value(known)
        for sign, factor in self.factors[1:]:
            value = factor.value(known)
            made = made / value if sign == "/" else made * value
        return made

    @property
    def children(self) -> tuple[Node, ...]:
        return tuple(factor for _, factor in self.factors)

    @property
    def operates(self) -> bool:
        return any(sign for sign, _ in self.factors[1:]) or any(child.operates for child in self.children)


def _joined(parts: list[str]) -> str:
    """Factors beside each other, a thin space between them."""
    return parts[0] if len(parts) == 1 else f"<mrow>{THIN.join(parts)}</mrow>"


def _bare(node: Node, style: Style) -> str:
    """What stands above or below a fraction bar needs no brackets."""
    if isinstance(node, Group) and node.brackets == "()" and len(node.items) == 1:
        return f"<mrow>{node.items[0].show(Style(False, style.names))}</mrow>"
    return f"<mrow>{node.show(Style(False, style.names))}</mrow>"


@dataclass(frozen=True)
class Whole(Node):
    """A large sum or an integral: sum of x, integral of u."""

    word: str
    of: Node

    def plain(self) -> str:
        return f"{self.word}of{self.of.plain()}"

    def show(self, style: Style) -> str:
        if self.word == "sum":
            return f"<mrow><mo>∑</mo>{self.of.show(style)}</mrow>"
        end = f"{THIN}<mi>d</mi><mi>t</mi>"
        return f'<mrow><mo stretchy="false">∫</mo>{self.of.show(style)}{end}</mrow>'

    @property
    def children(self) -> tuple[Node, ...]:
        return (self.of,)  # alone, "the integral of u" is words


@dataclass(frozen=True)
class Sum(Node):
    """Terms with their signs; the first may have none."""

    terms: tuple[tuple[str, Node], ...]

    def plain(self) -> str:
        return "".join(sign + term.plain() for sign, term in self.terms)

    def show(self, style: Style) -> str:
        made = []
        for index, (sign, term) in enumerate(self.terms):
            form = ' form="prefix"' if index == 0 else ""
            made.append((f"<mo{form}>{SIGNS[sign]}</mo>" if sign else "") + term.show(style))
        return f"<mrow>{''.join(made)}</mrow>"

    def value(self, known: Values) -> Any:
        total: Any = 0.0
        for sign, term in self.terms:
            if sign == "+-":
                raise TypeError("+- has no single value")
            value = term.value(known)
            total = total - value if sign == "-" else total + value
        return total

    @property
    def operates(self) -> bool:
        return True


@dataclass(frozen=True)
class Relation(Node):
    """Sides with the relation before each; the first has none."""

    sides: tuple[tuple[str, Node], ...]

    def plain(self) -> str:
        return "".join(sign + side.plain() for sign, side in self.sides)

    def show(self, style: Style) -> str:
        made = [(f"<mo>{RELATIONS[sign]}</mo>" if sign else "") + side.show(style) for sign, side in self.sides]
        return f"<mrow>{''.join(made)}</mrow>"

    @property
    def operates(self) -> bool:
        return True


# --- reading ---------------------------------------------------------------------------------------------------


@dataclass
class _Reader:
    """Reads formulas out of words; each method gives a node and leaves `at` behind it, or gives None."""

    words: list[Word]
    names: Names
    at: int = 0
    bars: int = field(default=0)  # how many | are open

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

    def relation(self) -> Node | None:
        first = self.tried(self.sum)
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

    def sum(self) -> Node | None:
        sign = ""
        if self.is_sign(*SIGNS):
            word = self.words[self.at]
            if (word.followed and word.text != "+-") or not (word.spaced or self.is_open()):
                return None  # a dash, or a hyphen
            sign, self.at = word.text, self.at + 1
        first = self.tried(self.product)
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

    def product(self) -> Node | None:
        first = self.tried(lambda: self.factor(beside=True))
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
            if factor is None or (not sign and isinstance(factor, (Number, Dots))):
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
            if beside and (following is None or following.kind in ("sign", "other")):
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
        if not of or not below.text.startswith("d") or not below.text[1:]:
            return None
        if not (self.names.has(of) and self.names.has(below.text[1:])):
            return None
        self.at += 4 if apart else 3
        return Derivative(Name(of), Name(below.text[1:]), apart)

    def named(self, word: Word, beside: bool) -> Node | None:
        text = word.text
        following = self.peek(1)
        opens = following is not None and following.text in ("(", "[") and not following.spaced
        is_name = self.names.has(text)
        if not is_name and not (opens and text.islower()):
            return None
        if self.names.is_weak(text) and not beside and not (following is not None and following.text in _BINDING):
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
            node = reader.tried(reader.relation)
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
        return "_" in node.text and node.text not in names.declared
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
