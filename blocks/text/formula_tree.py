"""The parts of a formula: each gives back its words, shows itself as MathML, and has a value.

`formulas` makes the tree. Only elements of MathML Core are used, which browsers show without help. Longer than other
modules: a kind of part is a class here, and each is short.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "iota": "ι", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ",
    "tau": "τ", "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω", "Gamma": "Γ", "Delta": "Δ", "Theta": "Θ",
    "Lambda": "Λ", "Sigma": "Σ", "Phi": "Φ", "Psi": "Ψ", "Omega": "Ω", "inf": "∞",
}  # fmt: skip

FUNCTIONS: dict[str, Callable[..., object]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log,
    "ln": np.log, "log10": np.log10, "sqrt": np.sqrt, "sgn": np.sign, "sign": np.sign, "abs": np.abs, "floor": np.floor,
    "ceil": np.ceil, "round": np.round, "min": min, "max": max,
}  # fmt: skip

# Words that are no names, however short, and that as names of a block join a formula only beside a sign or a relation.
_WORDS = """
    a an the and or not no nor if then else where when while until unless with without within of for from to into onto
    in out on off at by as is are be it its so than that this over under up down per each all any both but before after
    above below between beyond held last next once again here there has have may must can do we us eq eqs ref al vs
"""
ENGLISH = frozenset(_WORDS.split())

RELATIONS = {"=": "=", "<": "&lt;", ">": "&gt;", "<=": "≤", ">=": "≥", "!=": "≠", "->": "→", "...": "…"}
SLASH = '<mo lspace="0" rspace="0">/</mo>'
THIN = '<mspace width="0.17em"/>'
SIGNS = {"+": "+", "-": "−", "+-": "±"}


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
        if not bare[:1].isalpha():
            return False
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
            lowered = _subscript(",".join(below))
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


def _subscript(text: str) -> str:
    """What is lowered: a number, a letter, a word, or a sum of two of these."""
    signed = re.fullmatch(r"(\w+)([-+])(\w+)", text)
    if signed:
        return f"<mrow>{_subscript(signed[1])}<mo>{SIGNS[signed[2]]}</mo>{_subscript(signed[3])}</mrow>"
    if text.isdecimal():
        return f"<mn>{text}</mn>"
    return _letters(text) if text in GREEK or len(text) == 1 else f"<mtext>{escape(text)}</mtext>"


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
    order: str = ""  # "2" in d2y/dt2

    def plain(self) -> str:
        return f"d{self.order}{self.of.plain()}/d{self.by.plain()}{self.order}"

    def show(self, style: Style) -> str:
        base = _split(self.of.text, style.names)[0]
        space = THIN if self.apart and len(base) > 1 and base not in GREEK else ""
        above = f"<mrow>{self._raised('<mi>d</mi>')}{space}{self.of.show(style)}</mrow>"
        below = f"<mrow><mi>d</mi>{self._raised(self.by.show(style))}</mrow>"
        # In a line of text a slash, which all readers take for a derivative.
        return f"<mfrac>{above}{below}</mfrac>" if style.display else f"<mrow>{above}{SLASH}{below}</mrow>"

    def _raised(self, shown: str) -> str:
        return f"<msup>{shown}<mn>{self.order}</mn></msup>" if self.order else shown

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
        return f"<mrow><mo>{self.brackets[0]}</mo>{self.inside(style)}<mo>{self.brackets[1]}</mo></mrow>"

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
        # A list of numbers in a text is words: "den [1, -0.5]".
        return self.brackets == "||" or (self.brackets != "[]" and any(item.operates for item in self.items))


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
        name = f"<mi>{self.name.text}</mi>" if self.name.text in FUNCTIONS else self.name.show(style)
        return f"<mrow>{name}<mo>&#x2061;</mo>{self.group.show(style)}</mrow>"

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
        return f"<mrow>{self.name.show(style)}{THIN}{self.to.show(style)}</mrow>"

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
                shown[-1] = (f"{shown[-1][0]}{SLASH}{factor.show(style)}", True)
            elif sign == "*":
                shown[-1:] = [(f"{shown[-1][0]}<mo>·</mo>{factor.show(style)}", shown[-1][1])]
            else:
                is_derivative = isinstance(factor, Derivative)
                # Beside other factors its slash would mislead as well.
                shown.append((factor.show(Style(True, style.names) if is_derivative else style), not is_derivative))
        return _joined([text for text, _ in shown])

    def value(self, known: Values) -> Any:
        made = self.factors[0][1].value(known)
        for sign, factor in self.factors[1:]:
            value = factor.value(known)
            if np.ndim(made) == 2 and np.ndim(value) > 0 and not sign:
                made = made @ value
            else:
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
        total: object = 0.0
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
