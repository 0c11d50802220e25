"""The units of an FMU in the spelling of `blocks.text.units`.

A file gives a unit a name, and mostly base units with a factor and an offset. The name is taken where it means the
same; else the SI unit of the base units with the factor and the origin: 6894.757*Pa, 100000*Pa@1.01325. Tools differ:
OpenModelica leaves rad out of the base units (rad/s is s-1), others write factors with a few digits, others no base
units at all; a name that `blocks.text.units` can read then says more than they do.

Reference: FMI 3.0.2, 2.4.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

from ..text import units
from ..text.errors import ModelError

# Files round factors, 1/min to 0.0167; no two units of one quantity are that near to each other.
ROUNDED = 5e-3
# Without J, which is N.m as well, and Hz, which others take for a turn a second.
_PLAIN = ("N", "W", "Pa", "C", "V", "Ohm", "S", "H", "F", "Wb", "T")


def spelled(name: str, exponents: Sequence[int] | None, factor: float, offset: float) -> tuple[str, str, bool]:
    """The text of a unit and of its SI unit, each "" where there is none, and whether name and base units agree."""
    known = _known(name)
    if exponents is None:
        return (name, units.si_text(name), True) if known else ("", "", True)
    *others, rad = exponents
    agree = True
    if known:
        agree = list(known.dimension[:-1]) == others
        is_scaled_so = math.isclose(known.factor, factor, rel_tol=ROUNDED)
        if agree and is_scaled_so and _same_offset(known, offset) and rad in (0, known.dimension[-1]):
            return name, units.si_text(name), True
    si = _coherent(tuple(exponents))
    return _affine(si, factor, offset), si, agree


def _same_offset(known: units.Unit, offset: float) -> bool:
    return math.isclose(known.offset, offset, rel_tol=1e-9) if known.offset or offset else True


def _affine(si: str, factor: float, offset: float) -> str:
    """Return the text of a unit by its factor and its offset in SI; "" where there is none."""
    scaled = "" if factor == 1 else f"{_decimal(factor)}*"
    origin = "" if not offset else f"@{_decimal(offset / factor)}"
    text = f"{scaled}{si}{origin}" if si and factor > 0 else ""
    return text if text == si or _known(text) else ""


def _decimal(number: float) -> str:
    return repr(float(number)).removesuffix(".0")


@lru_cache(maxsize=4096)
def _known(name: str) -> units.Unit | None:
    try:
        return units.parse(name)
    except ModelError:
        return None


@lru_cache(maxsize=4096)
def _coherent(exponents: tuple[int, ...]) -> str:
    """The SI unit with these exponents; "" where `blocks.text.units` has none (powers beyond its limit)."""
    for name in _PLAIN:
        if units.parse(name).dimension == exponents:
            return name
    text = "1"
    for base, n in zip(units.BASE, exponents, strict=True):
        if n:
            try:
                text = units.product(text, f"{base}{n}")
            except ModelError:
                return ""
    return text
