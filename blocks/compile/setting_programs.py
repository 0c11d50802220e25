"""Settings of a diagram as data, and the postfix programs that compute those that depend on others.

All numbers are in SI: units were settled when the values were read. The operations are those of `expressions`, in their
order, so that C computes the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..text.expressions import FLOAT_OPERATIONS

__all__ = ["Program", "Setting", "SettingStep", "computed", "evaluated", "joined", "numbers", "placed"]

# --- programs --------------------------------------------------------------------------------------------------


class SettingStep(NamedTuple):
    """One postfix step: a "constant", a "reference" to an element of a setting, or an operation on `operands` values.

    Operations are those of `expressions`, and of computed defaults also expm1, "<", "<=", "==", "!=" (1 or 0), and
    "choose": for c, a, b it is a where c is not 0, else b.
    """

    word: str
    operands: int = 0
    value: float = 0.0
    setting: int = -1
    element: int = 0


Program = tuple[SettingStep, ...]


_OPERATIONS: dict[str, Callable[..., float]] = {
    **FLOAT_OPERATIONS,
    "expm1": math.expm1,
    "<": lambda a, b: float(a < b),
    "<=": lambda a, b: float(a <= b),
    "==": lambda a, b: float(a == b),
    "!=": lambda a, b: float(a != b),
    "choose": lambda c, a, b: a if c else b,
}


def joined(word: str, operands: Sequence[Program]) -> Program:
    """An operation on programs; constants are folded here, as compilers may round differently."""
    if word == "pos":
        return operands[0]
    steps = tuple(step for operand in operands for step in operand)
    program = (*steps, SettingStep(word, len(operands)))
    if all(step.word == "constant" for step in steps):
        return (SettingStep("constant", value=evaluated(program, lambda _: math.nan)),)
    return program


def evaluated(program: Program, value: Callable[[SettingStep], float]) -> float:
    """The value of a program; NaN where Python refuses an operation."""
    stack: list[float] = []
    for step in program:
        if step.word == "constant":
            stack.append(step.value)
        elif step.word == "reference":
            stack.append(value(step))
        else:
            operands = stack[-step.operands :]
            del stack[-step.operands :]
            try:
                stack.append(float(_OPERATIONS[step.word](*operands)))
            except (ArithmeticError, ValueError):
                stack.append(math.nan)
    return stack.pop()


# --- settings --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Setting:
    """A parameter by its path ("Kp", "left.Kp", "motor.Ra") and what it does.

    causality: "parameter" (a leaf, which is set) or "calculatedParameter" (bound: it is computed). variability: of a
    leaf, whether it may be set at any time ("tunable"), before the start only ("fixed") or never ("constant"); of a
    bound one, when it can change; why: the reason, unless it is tunable. type: "real", "int", "bool", "enum", "text".
    unit: in SI, "" where none is known or the elements differ; display: the declared unit where it is another one. low,
    high: the range of each element, in SI; low_open, high_open: whether the end is excluded. whole: whether elements
    are integers of at most 2^53. members: of an enumeration, its own or that of a copy: the allowed names and numbers.
    A leaf takes on the ranges of its copies; a bound setting has its own, which the computed value may violate.

    values: its elements in C order, in SI, or one text. places: for each element, its indices in p. elements: of a
    bound one, a program for each element; None for a leaf and for texts. first: the index of the first element among
    the numbers of all settings, -1 for a text.
    """

    path: str
    causality: str
    variability: str
    type: str
    shape: tuple[int, ...]
    unit: str
    display: str
    doc: str
    low: float | None
    high: float | None
    low_open: bool
    high_open: bool
    whole: bool
    members: Mapping[str, int]
    values: tuple[float, ...] | tuple[str, ...]
    places: tuple[tuple[int, ...], ...]
    elements: tuple[Program, ...] | None
    first: int
    why: str

    @property
    def is_bound(self) -> bool:
        return self.causality == "calculatedParameter"


def numbers(settings: Sequence[Setting]) -> list[float]:
    """The elements of all settings that are no texts, one after the other, unchanged."""
    return [float(x) for setting in settings if setting.first >= 0 for x in setting.values]


def computed(settings: Sequence[Setting], s: Sequence[float]) -> list[float]:
    """The numbers of all settings with the bound ones computed anew from the leaves.

    What cannot be computed is NaN here, and not finite in C: callers that set leaves refuse that.
    """
    values = list(s)

    def value(step: SettingStep) -> float:
        return values[settings[step.setting].first + step.element]

    for setting in settings:
        for k, program in enumerate(setting.elements or ()):
            values[setting.first + k] = evaluated(program, value)
    return values


def placed(settings: Sequence[Setting], s: Sequence[float], p: Sequence[float]) -> list[float]:
    """The row p with the numbers of settings in their places."""
    row = list(p)
    for setting in settings:
        for k, places in enumerate(setting.places):
            for place in places if setting.first >= 0 else ():
                row[place] = s[setting.first + k]
    return row
