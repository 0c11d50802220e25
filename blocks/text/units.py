"""Units: a text such as `kg.m2/s3`, its dimension, its factor to SI, and the offset of units such as degC.

    unit    = product | [number "*"] product ["@" origin] | "degC" | "degF"
    product = factor { ("." | "/") factor }      from left to right: "/" takes the next factor only
    factor  = symbol [power] | "(" product ")" [power] | "1"
    power   = ["+" | "-"] digits                 kg.m2/s3, s-1, 1/s, V.s/rad, N.m/(rad/s)

A value in a unit with an origin counts from there: `bar@1.01325` is the pressure above 1.01325 bar, degC is K@273.15.
Such a unit is one of values, not of differences, and stands alone: a product with it is refused (E114).

`1` is dimensionless; the empty text (UNKNOWN) says that nothing is known about the unit, and fits every other.
The radian is a dimension of its own, so rad/s and 1/s (Hz) are different quantities. Factors are kept as a rational
number times a power of pi: decimal values are then scaled with one rounding, and rpm to deg/s is exactly 6.

References: BIPM, The International System of Units, 9th edition (2019); Modelica specification 3.6, chapter 19.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

from .errors import Fault, ModelError

Declared = str | tuple[str, ...]
"""The unit of a variable, or of each of its elements."""

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""The base units, in the order of the exponents of a dimension."""

UNKNOWN = ""
"""The unit of which nothing is known."""

_LENGTH, _DEPTH, _POWER = 100, 10, 20
# With factors in 1e-100 ... 1e100 the ratio of any two units is a finite float that is not 0.
_LARGEST = Fraction(10) ** 100
# 50 decimals: far more than the 17 that decide how a product is rounded to a float.
_PI = Fraction("3.14159265358979323846264338327950288419716939937510")

Factors = tuple[tuple[str, int], ...]
"""A unit as symbols with their exponents: (("V", 1), ("s", 1), ("rad", -1))."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: `factor` times the SI unit of `dimension` (exponents in the order of BASE).

    `exact` is the factor as a fraction, or None where pi is in it. offset: what 0 of the unit is in SI.
    """

    text: str
    dimension: tuple[int, ...]
    factor: float
    exact: Fraction | None
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class _Symbol:
    """A symbol: `rational` * pi**`pi` times `coherent`, a product of units with factor 1."""

    dimension: tuple[int, ...]
    rational: Fraction
    pi: int
    coherent: Factors


_PREFIXES = {
    "f": -15, "p": -12, "n": -9, "u": -6, "m": -3, "c": -2, "d": -1,
    "da": 1, "h": 2, "k": 3, "M": 6, "G": 9, "T": 12,
}  # fmt: skip

# Units with factor 1 that have a name: the exponents of kg, m, s, A; none holds K, mol, cd or rad.
_NAMED = {
    "N": (1, 1, -2, 0), "J": (1, 2, -2, 0), "W": (1, 2, -3, 0), "Pa": (1, -1, -2, 0), "Hz": (0, 0, -1, 0),
    "C": (0, 0, 1, 1), "V": (1, 2, -3, -1), "Ohm": (1, 2, -3, -2), "S": (-1, -2, 3, 2), "H": (1, 2, -2, -2),
    "F": (-1, -2, 4, 2), "Wb": (1, 2, -2, -1), "T": (1, 0, -2, -1),
}  # fmt: skip

# Symbol: numerator, denominator, power of pi, the unit with factor 1, and whether it takes prefixes.
_SCALED: dict[str, tuple[int, int, int, Factors, bool]] = {
    "g": (1, 1000, 0, (("kg", 1),), True),
    "t": (1000, 1, 0, (("kg", 1),), False),
    "l": (1, 1000, 0, (("m", 3),), True),
    "L": (1, 1000, 0, (("m", 3),), True),
    "bar": (100_000, 1, 0, (("Pa", 1),), True),
    "min": (60, 1, 0, (("s", 1),), False),
    "h": (3600, 1, 0, (("s", 1),), False),
    "d": (86_400, 1, 0, (("s", 1),), False),
    "deg": (1, 180, 1, (("rad", 1),), False),
    "rev": (2, 1, 1, (("rad", 1),), False),
    "rpm": (1, 30, 1, (("rad", 1), ("s", -1)), False),
    "%": (1, 100, 0, (), False),
}


def _table() -> dict[str, _Symbol]:
    """Every symbol that can be written, with and without prefix."""
    table: dict[str, _Symbol] = {}
    for index, name in enumerate(BASE):
        table[name] = _Symbol(tuple(int(index == k) for k in range(len(BASE))), Fraction(1), 0, ((name, 1),))
    for name, exponents in _NAMED.items():
        table[name] = _Symbol((*exponents, 0, 0, 0, 0), Fraction(1), 0, ((name, 1),))
    prefixed = [name for name in table if name != "kg"]
    for name, (numerator, denominator, pi, coherent, takes_prefix) in _SCALED.items():
        dimension = _sum((table[symbol].dimension, exponent) for symbol, exponent in coherent)
        table[name] = _Symbol(dimension, Fraction(numerator, denominator), pi, coherent)
        if takes_prefix:
            prefixed.append(name)
    for name in prefixed:
        for prefix, exponent in _PREFIXES.items():
            rational = table[name].rational * Fraction(10) ** exponent
            # What stands already wins: kg is the base unit, cd the candela.
            table.setdefault(prefix + name, replace(table[name], rational=rational))
    return table


def _sum(parts: Iterable[tuple[tuple[int, ...], int]]) -> tuple[int, ...]:
    """The dimension of a product of powers."""
    total = [0] * len(BASE)
    for dimension, exponent in parts:
        total = [have + exponent * more for have, more in zip(total, dimension, strict=True)]
    return tuple(total)


_SYMBOLS = _table()


@lru_cache(maxsize=4096)
def parse(text: str) -> Unit:
    """The unit of a text.

    Raises:
        ModelError: E114, where the text is empty, malformed, too long, nested too deeply, or names an unknown unit.
    """
    factors = _factors(text)
    rational, pi = _magnitude(text)
    dimension = _sum((_SYMBOLS[symbol].dimension, exponent) for symbol, exponent in factors)
    return Unit(text, dimension, float(rational * _PI**pi), None if pi else rational, float(_offset(text)))


def same_quantity(a: str, b: str) -> bool:
    """Whether values in a and in b can be converted; an unknown unit fits every other."""
    return not a or not b or parse(a).dimension == parse(b).dimension


def scale(a: str, b: str) -> float:
    """The number x in 1 a = x b, for differences where a unit has an offset; 1.0 where either unit is unknown.

    Raises:
        ModelError: E104 where a and b are different quantities, E114 where one cannot be read.
    """
    rational, pi = _ratio(a, b)
    return float(rational * _PI**pi)


def scale_exact(a: str, b: str) -> Fraction | None:
    """The number x in 1 a = x b as a fraction, or None where pi is in it. Raises as `scale`."""
    rational, pi = _ratio(a, b)
    return None if pi else rational


def to_si(value: float, unit: str, *, exact: Fraction | None = None) -> float:
    """The value in SI: the product of the decimal value and the factor of its unit, rounded once.

    `exact` is the value as it was written; without it the shortest decimal of the float is taken, so that
    to_si(1200.0, "mOhm") == 1.2. An infinity, a nan and a value of unknown unit or of factor 1 come back as they are.
    """
    if not unit or not math.isfinite(value):
        return value
    p, q, r, s = _affine(unit)
    if p == q and not r:
        return value
    n, d = _written(float(value)) if exact is None else exact.as_integer_ratio()
    if not n and not r:
        return value
    try:
        return (n * p * s + r * d * q) / (d * q * s)  # of integers: rounded once
    except OverflowError:
        return math.copysign(math.inf, value)


def to_si_each(values: Sequence[float], unit: str) -> Sequence[float]:
    """Return what `to_si` gives for each of many values."""
    p, q, r, _ = _affine(unit) if unit else (1, 1, 0, 1)
    return values if p == q and not r else [to_si(value, unit) for value in values]


def _written(value: float) -> tuple[int, int]:
    """Return the shortest decimal of a finite float as a ratio. `Fraction` takes ten times as long to read it."""
    mantissa, _, exponent = repr(value).partition("e")
    whole, _, part = mantissa.partition(".")
    n, power = int(whole + part), int(exponent or 0) - len(part)
    return (n * 10**power, 1) if power >= 0 else (n, 10**-power)


def converted(value: float, a: str, b: str) -> float:
    """Return a value in a as a value in b, by factor and offset; as it is if either unit is unknown.

    Raises:
        ModelError: E104 where a and b are different quantities, E114 where one cannot be read.
    """
    if a == b or not a or not b or not math.isfinite(value):
        return value
    rational, pi = _ratio(a, b)
    (own, own_pi), offset = _magnitude(b), _offset(a) - _offset(b)
    try:
        return float(Fraction(repr(float(value))) * rational * _PI**pi + offset / (own * _PI**own_pi))
    except OverflowError:
        return math.copysign(math.inf, value)


def from_si(value: float, unit: str) -> float:
    """Return a value in SI as a value in a unit."""
    return converted(value, si_text(unit), unit) if unit else value


def affine(a: str, b: str) -> tuple[float, float]:
    """Return the numbers with which a value x in a is factor * x + offset in b; (1, 0) if either unit is unknown.

    Raises as `converted`.
    """
    return scale(a, b), converted(0.0, a, b)


def has_offset(unit: str) -> bool:
    """Return whether 0 of the unit is not 0 in SI, as with degC."""
    return bool(unit) and bool(_offset(unit))


def difference(unit: str) -> str:
    """Return the unit of differences of values in a unit: K of degC. A unit without an offset is its own."""
    if not has_offset(unit):
        return unit
    (rational, pi), si = _magnitude(unit), si_text(unit)
    if rational == 1 and not pi:
        return si
    plain = _AFFINE.fullmatch(_ALONE.get(unit, unit))
    assert plain is not None
    factor = "" if plain["factor"] is None else f"{plain['factor']}*"
    return factor + plain["product"]


def single(unit: Declared) -> str:
    """Return the one unit of all elements; "" if they differ."""
    return unit if isinstance(unit, str) else unit[0] if len(set(unit)) == 1 else ""


class OfUnits:
    """Something whose elements have units: `units` in SI, and `declared` as the class of the block has them."""

    __slots__ = ()
    units: tuple[str, ...]
    declared: tuple[str, ...]

    @property
    def unit(self) -> str:
        """The one unit of all elements, or "" if they differ."""
        return single(self.units)

    @property
    def declared_unit(self) -> str:
        """The one declared unit of all elements, or "" if they differ."""
        return single(self.declared)


@lru_cache(maxsize=4096)
def si_text(unit: str) -> str:
    """The unit in which SI values of this unit are shown: mOhm -> Ohm, rpm -> rad/s, km/h -> m/s, unknown -> ''.

    A unit with factor 1 is its own.
    """
    if not unit or (_magnitude(unit) == (Fraction(1), 0) and not _offset(unit)):
        return unit
    coherent = [(base, n * m) for symbol, n in _factors(unit) for base, m in _SYMBOLS[symbol].coherent]
    try:
        return _text(coherent)
    except ModelError:
        # Exponents may grow beyond the limit (l20 is m60) and only cancel in base units.
        return _text(zip(BASE, parse(unit).dimension, strict=True))


def product(a: str, b: str) -> str:
    """The unit of a value in a times a value in b; '' where either is unknown. Raises ModelError as `parse`."""
    return _text(_plain(a) + _plain(b)) if a and b else UNKNOWN


def quotient(a: str, b: str) -> str:
    """The unit of a value in a over a value in b; '' where either is unknown. Raises ModelError as `parse`."""
    return _text(_plain(a) + tuple((symbol, -n) for symbol, n in _plain(b))) if a and b else UNKNOWN


def power(a: str, n: int) -> str:
    """The unit of a value in a to the power n; '' where it is unknown. Raises ModelError as `parse`."""
    return _text((symbol, n * exponent) for symbol, exponent in _plain(a)) if a else UNKNOWN


def _ratio(a: str, b: str) -> tuple[Fraction, int]:
    """1 a in b as a rational number and a power of pi."""
    if not a or not b:
        return Fraction(1), 0
    if not same_quantity(a, b):
        raise ModelError(Fault("E104", "", f"{a} and {b} are different quantities."))
    (p, i), (q, k) = _magnitude(a), _magnitude(b)
    return p / q, i - k


@lru_cache(maxsize=4096)
def _magnitude(text: str) -> tuple[Fraction, int]:
    """The factor to SI as a rational number and a power of pi."""
    rational, pi = Fraction(1), 0
    for name, exponent in _factors(text):
        symbol = _SYMBOLS[name]
        rational *= symbol.rational**exponent
        pi += symbol.pi * exponent
    if (factor := _split(text)[0]) is not None:
        rational *= factor
    if not 1 / _LARGEST <= rational * _PI**pi <= _LARGEST:
        message = f"the unit {text!r} is larger than 1e100 or smaller than 1e-100 in SI."
        raise ModelError(Fault("E114", "", message, "Use smaller prefixes or powers."))
    return rational, pi


@lru_cache(maxsize=4096)
def _affine(text: str) -> tuple[int, int, int, int]:
    """Return the factor to SI and what 0 of the unit is there, each as a ratio."""
    rational, pi = _magnitude(text)
    return *(rational * _PI**pi).as_integer_ratio(), *_offset(text).as_integer_ratio()


def _merged(factors: Iterable[tuple[str, int]]) -> Factors:
    """Each symbol once, in the order of appearance, without those that cancel."""
    exponents: dict[str, int] = {}
    for symbol, n in factors:
        exponents[symbol] = exponents.get(symbol, 0) + n
    return tuple((symbol, n) for symbol, n in exponents.items() if n)


def _text(factors: Iterable[tuple[str, int]]) -> str:
    """The text of a product of powers, one that `parse` reads."""
    merged = _merged(factors)
    above = [symbol if n == 1 else f"{symbol}{n}" for symbol, n in merged if n > 0]
    below = [symbol if n == -1 else f"{symbol}{-n}" for symbol, n in merged if n < 0]
    text = ".".join(above) or "1"
    if below:
        text += f"/{below[0]}" if len(below) == 1 else f"/({'.'.join(below)})"
    return parse(text).text


_NUMBER = r"[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?"
_AFFINE = re.compile(rf"(?:(?P<factor>{_NUMBER}|5/9)\*)?(?P<product>[^@*]+)(?:@(?P<origin>-?{_NUMBER}))?")
_ALONE = {"degC": "K@273.15", "degF": "5/9*K@459.67"}
"""Units that stand alone, and what they are."""


def _split(text: str) -> tuple[Fraction | None, str, Fraction]:
    """Return the number before a product, the product, and the origin; None and 0 where they are not given."""
    if ("@" not in text and "*" not in text and text not in _ALONE) or len(text) > _LENGTH:
        return None, text, Fraction(0)
    match = _AFFINE.fullmatch(_ALONE.get(text, text))
    if match is None:
        return None, text, Fraction(0)
    factor = None if match["factor"] is None else Fraction(match["factor"])
    if factor == 0:
        raise ModelError(Fault("E114", "", f"the unit {text!r} is 0."))
    return factor, match["product"], Fraction(match["origin"] or 0)


@lru_cache(maxsize=4096)
def _offset(text: str) -> Fraction:
    """Return what 0 of the unit is in SI."""
    origin = _split(text)[2]
    if not origin:
        return Fraction(0)
    rational, pi = _magnitude(text)
    offset = origin * rational * _PI**pi
    if abs(offset) > _LARGEST:
        raise ModelError(Fault("E114", "", f"the origin of the unit {text!r} lies beyond 1e100 in SI."))
    return offset


def _plain(text: str) -> Factors:
    """Return the symbols of a unit that can be a part of others. Raises ModelError (E114)."""
    factor, _, origin = _split(text)
    if factor is not None or origin:
        message = f"{text!r} has a factor or an offset, so that it cannot be a part of another unit."
        raise ModelError(Fault("E114", "", message, f"Use {si_text(text)}, the unit of differences."))
    return _factors(text)


@lru_cache(maxsize=4096)
def _factors(text: str) -> Factors:
    """The symbols of a text with their exponents; a fault says where the text is wrong, and offers a better one."""
    try:
        return _read(_split(text)[1])
    except ModelError as error:
        (fault,) = error.faults
        raise ModelError(replace(fault, cure=_cure(text))) from None


_LETTERS = re.compile(r"[^\W\d_]+|%|°\w*")
_EXPONENT = re.compile(r"[+-]?[0-9]+")


def _read(text: str) -> Factors:
    """The symbols of a text with their exponents, each symbol once."""
    if text in _ALONE:
        raise ModelError(Fault("E114", "", f"the unit {text!r} cannot be a part of another unit."))
    if not text:
        raise ModelError(Fault("E114", "", "the unit is empty."))
    if len(text) > _LENGTH:
        raise ModelError(Fault("E114", "", f"the unit has {len(text)} characters; the limit is {_LENGTH}."))
    factors, end = _read_product(text, 0, 0)
    if end < len(text):
        raise _wrong(text, end, "expected '.', '/' or the end")
    merged = _merged(factors)
    dimension = _sum((_SYMBOLS[symbol].dimension, n) for symbol, n in merged)
    largest = max((abs(n) for n in (*dimension, *(n for _, n in merged))), default=0)
    if largest > _POWER:
        raise ModelError(Fault("E114", "", f"the unit {text!r} holds the power {largest}; the limit is {_POWER}."))
    return merged


def _read_product(text: str, at: int, depth: int) -> tuple[list[tuple[str, int]], int]:
    """The factors from `at` on, up to the end or to a closing bracket, and where they end."""
    if depth > _DEPTH:
        raise _wrong(text, at, f"more than {_DEPTH} brackets in each other")
    factors, at = _read_factor(text, at, depth)
    while at < len(text) and text[at] in "./":
        sign = -1 if text[at] == "/" else 1
        more, at = _read_factor(text, at + 1, depth)
        factors += [(symbol, sign * n) for symbol, n in more]
    return factors, at


def _read_factor(text: str, at: int, depth: int) -> tuple[list[tuple[str, int]], int]:
    """One symbol, bracket or `1` with its power, and where it ends."""
    if text.startswith("(", at):
        factors, end = _read_product(text, at + 1, depth + 1)
        if not text.startswith(")", end):
            raise _wrong(text, end, "expected ')'")
        end += 1
    elif text.startswith("1", at):
        return [], at + 1
    elif letters := _LETTERS.match(text, at):
        if letters[0] not in _SYMBOLS:
            raise _wrong(text, at, f"{letters[0]!r} is not known")
        factors, end = [(letters[0], 1)], letters.end()
    else:
        raise _wrong(text, at, "expected a unit")
    if exponent := _EXPONENT.match(text, end):
        n = int(exponent[0])
        if abs(n) > _POWER:
            raise _wrong(text, end, f"the power {n} is beyond {_POWER}")
        factors, end = [(symbol, n * m) for symbol, m in factors], exponent.end()
    return factors, end


def _wrong(text: str, at: int, what: str) -> ModelError:
    place = f"character {at + 1}" if at < len(text) else "the end"
    return ModelError(Fault("E114", "", f"the unit {text!r} cannot be read at {place}: {what}."))


_SPELLINGS = str.maketrans({
    "Ω": "Ohm", "\N{OHM SIGN}": "Ohm", "µ": "u", "μ": "u", "°": "deg",
    "·": ".", "×": ".", "*": ".", "^": None, "²": "2", "³": "3", "⁻": "-", "¹": "1",
})  # fmt: skip
_OTHER_WORDS = {
    "meter": "m", "metre": "m", "gram": "g", "kilogram": "kg", "sec": "s", "second": "s", "minute": "min", "hour": "h",
    "hr": "h", "day": "d", "amp": "A", "ampere": "A", "kelvin": "K", "newton": "N", "joule": "J", "watt": "W",
    "volt": "V", "ohm": "Ohm", "farad": "F", "henry": "H", "hertz": "Hz", "pascal": "Pa", "tesla": "T", "liter": "l",
    "radian": "rad", "degree": "deg", "cycle": "rev", "turn": "rev", "rps": "rev/s", "percent": "%",
}  # fmt: skip
_OFFSETS = {
    **dict.fromkeys(("degC", "°C", "℃", "celsius", "Celsius"), "degC"),
    **dict.fromkeys(("degF", "°F", "℉", "fahrenheit", "Fahrenheit"), "degF"),
}


def _cure(text: str) -> str:
    """What to write instead."""
    if not text or len(text) > _LENGTH:
        return "A unit is a product such as 'kg.m2/s3'; '1' is dimensionless."
    if text.strip() in _OFFSETS:
        return f"Did you mean '{_OFFSETS[text.strip()]}'?"
    if any(word in _OFFSETS for word in _LETTERS.findall(text)):
        return "For a temperature use degC or degF alone. In products use K, the unit of differences."
    plain = text.strip().replace("**", "^").translate(_SPELLINGS)
    plain = re.sub(r"\s+", ".", re.sub(r"\s*([./()])\s*", r"\1", plain))
    better = _LETTERS.sub(_respelled, plain)
    try:
        _read(better)
    except ModelError:
        if all(word in _SYMBOLS for word in _LETTERS.findall(better)):
            return f"A unit is a product such as 'kg.m2/s3', with powers up to {_POWER}."
        known = " ".join((*BASE, *_NAMED, *_SCALED))
        return f"A unit is a product such as 'kg.m2/s3' of {known}, with SI prefixes."
    return f"Did you mean '{better}'?"


def _respelled(word: re.Match[str]) -> str:
    """The nearest known text for one word of a unit; the word itself where there is none."""
    name = word[0]
    if name in _SYMBOLS:
        return name
    below = word.string[: word.start()].endswith("/")
    if other := _OTHER_WORDS.get(name.lower()) or _OTHER_WORDS.get(name.lower().removesuffix("s")):
        return f"({other})" if below and "/" in other else other
    if name.startswith("K") and "k" + name[1:] in _SYMBOLS:
        return "k" + name[1:]
    # Units run together (Nm, Vs, kWh) are far more frequent than misspelt ones.
    for cut in range(len(name) - 1, 0, -1):
        if name[:cut] in _SYMBOLS and name[cut:] in _SYMBOLS:
            together = f"{name[:cut]}.{name[cut:]}"
            return f"({together})" if below else together
    same_letters = [symbol for symbol in _SYMBOLS if symbol.lower() == name.lower()]
    # Among symbols of one or two letters the nearest is a guess: psi is not ps.
    long = [symbol for symbol in _SYMBOLS if len(symbol) > 2]
    near = difflib.get_close_matches(name, long, n=1, cutoff=0.6) if len(name) > 2 else []
    return (same_letters or near or [name])[0]
