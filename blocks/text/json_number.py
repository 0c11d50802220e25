"""Numbers of JSON, with their spelling kept."""

from __future__ import annotations

import re
from fractions import Fraction
from math import isfinite
from typing import Self, TypeGuard

from .errors import Fault, ModelError
from .printable import quoted

# Every double has a spelling of 25 characters, every integer below 1.8e308 one of 310.
LONGEST_NUMBER = 400
# Possessive quantifiers (*+, ++) never give back: a match that fails costs one pass over the text.
NUMBER = r"-?(?:0|[1-9][0-9]*+)(?:\.[0-9]++)?(?:[eE][+-]?[0-9]++)?"
_is_number = re.compile(NUMBER).fullmatch


class Number(float):
    """A number that remembers how it was spelled: 0.10 stays 0.10, and `exact` is 1/10.

    It is a finite float in all else: equality, hash and arithmetic (whose results are plain floats). Only a zero
    is read as zero. Raises ModelError (E004) for what is no JSON number, is out of the range of a double, or has
    more than 400 characters.
    """

    __slots__ = ("_text",)
    _text: str

    def __new__(cls, text: str) -> Self:
        if len(text) > LONGEST_NUMBER:
            message = f"the number has {len(text)} characters; the limit is {LONGEST_NUMBER}."
            raise ModelError(Fault("E004", "", message, "Round it: a float has 17 digits."))
        if _is_number(text) is None:
            raise ModelError(Fault("E004", "", f"{quoted(text)} is not a JSON number.", number_cure(text)))
        number = super().__new__(cls, text)
        if not isfinite(number):
            message = f"{quoted(text)[1:-1]} is too large: the largest float is 1.8e308."
            raise ModelError(Fault("E004", "", message, "Write a smaller number."))
        if not number and text.lower().partition("e")[0].strip("-0."):
            message = f"{quoted(text)[1:-1]} is too small: a float would round it to 0."
            raise ModelError(Fault("E004", "", message, "Write 0, or at least 5e-324."))
        number._text = text
        return number

    @property
    def text(self) -> str:
        """The spelling in JSON."""
        return self._text

    @property
    def exact(self) -> Fraction:
        """The number that the text means, before it is rounded to a float."""
        # Fraction("0e999999999") would compute the power of ten; every other exponent is bounded by the float's range.
        return Fraction(self._text) if self else Fraction(0)

    def __repr__(self) -> str:
        return self._text

    def __reduce__(self) -> tuple[type[Self], tuple[str]]:
        return type(self), (self._text,)


def is_number(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a number, which true and false are not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def spelled(text: str) -> str:
    """A number as people write it (+1, .5, 1., 007, 1_000) in JSON's spelling."""
    sign = "-" if text.startswith("-") else ""
    mantissa, _, exponent = text.lstrip("+-").replace("_", "").lower().partition("e")
    whole, _, fraction = mantissa.partition(".")
    return f"{sign}{whole.lstrip('0') or '0'}{'.' + fraction if fraction else ''}{'e' + exponent if exponent else ''}"


def number_cure(text: str) -> str:
    """How a number of another language is written in JSON."""
    if re.fullmatch(r"0[xX][0-9a-fA-F]{1,13}", text):
        return f"Write {int(text, 16)}."
    is_meant = len(text) <= 60 and re.fullmatch(r"[+-]?(?=.?[0-9])[0-9_]*\.?[0-9_]*(?:[eE][+-]?[0-9]+)?", text)
    return f"Write {spelled(text)}." if is_meant else "Write a number like 12, -0.5 or 1e-6."
