"""What a tuning minimizes, and what it is bound to: expressions over the measures of several scenarios.

ITAE_right + ITAE_left + 1e-3*ISU_right      bare names: the mean of the measure over the scenarios
noisy.variation <= 75                        the measure in one scenario
peak_e_theta <= 0.005                        a constraint of bare names holds in each scenario
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..contract.expressions import Expression, PostfixStep, parse
from ..contract.scalars import OPERATIONS
from ..text import units
from ..text.arrays import Array
from ..text.errors import Fault, ModelError, UsageError, did_you_mean
from ..text.printable import quoted
from ..text.quantity_text import quantity_in

Measured = Mapping[str, Mapping[str, Array]]
"""Measures (n,) by scenario and name."""

_COMPARED = re.compile(r"<=|>=|==|!=|<|>|=")


def _value(expression: Expression, read: Callable[[str], Array]) -> Array:
    """The value of an expression for all rows; nan or infinite where it has none."""

    def operand(step: PostfixStep) -> object:
        return read(step.word) if step.scalar is None else np.float64(step.scalar.value)

    with np.errstate(all="ignore"):
        value = expression.folded(operand, lambda step, operands: OPERATIONS[step.op].ieee(*operands))
    return np.asarray(value, dtype=float)


@dataclass(frozen=True, slots=True)
class Objective:
    """What is minimized."""

    expression: Expression

    @property
    def text(self) -> str:
        return self.expression.text

    def values(self, measured: Measured) -> Array:
        """(n,) for measures (n,)."""

        def read(name: str) -> Array:
            scenario, _, measure = name.rpartition(".")
            if scenario:
                return measured[scenario][measure]
            mean: Array = np.mean([of[measure] for of in measured.values()], axis=0)
            return mean

        return _value(self.expression, read)

    def reads(self, scenarios: Sequence[str]) -> list[tuple[str, str]]:
        """The measures that it reads, with their scenarios."""
        return _reads(self.expression, scenarios)


@dataclass(frozen=True, slots=True)
class Constraint:
    """left <= right, with the measures of `scenario` for bare names."""

    text: str
    left: Expression
    right: Expression
    scenario: str

    def sides(self, measured: Measured) -> tuple[Array, Array]:
        """Both sides, (n,) each or single numbers."""

        def read(name: str) -> Array:
            scenario, _, measure = name.rpartition(".")
            return measured[scenario or self.scenario][measure]

        return _value(self.left, read), _value(self.right, read)

    def excess(self, measured: Measured, scale: float) -> Array:
        """By how much it is violated, in parts of `scale`; 0 where it holds, infinite where a side has no number."""
        left, right = self.sides(measured)
        with np.errstate(all="ignore"):
            excess = np.maximum(left - right, 0.0) / scale
        return np.where(np.isnan(left) | np.isnan(right), np.inf, excess)

    def scale(self, measured: Measured) -> float:
        """What an excess is compared with: the larger side of these runs, or the limit where that is a number."""
        left, right = (np.abs(side) for side in self.sides(measured))
        sizes = [right] if not self.right.names else [left] if not self.left.names else [left, right]
        known = [float(size) for side in (sizes, [left, right]) for size in map(np.max, side)]
        return next((size for size in known if np.isfinite(size) and size > 0), 1.0)

    def reads(self) -> list[tuple[str, str]]:
        return [*_reads(self.left, (self.scenario,)), *_reads(self.right, (self.scenario,))]


def objective_of(text: str, measures: Sequence[str], scenarios: Sequence[str], *, unknown: str = "E501") -> Objective:
    """The objective of a text. unknown: the code of names that mean nothing.

    Raises UsageError and ModelError with all that is wrong with its names.
    """
    expression = _parsed("minimize", text)
    _check(_faults("minimize", text, expression.names, measures, scenarios, unknown))
    return Objective(expression)


def constraints_of(
    texts: Sequence[str], measures: Sequence[str], scenarios: Sequence[str], *, unknown: str = "E501",
    unit_of: Callable[[str], str] = lambda name: "",
) -> tuple[Constraint, ...]:
    """The constraints of texts; one of bare names is one for each scenario. Raises as `objective_of`.

    unit_of: the unit of a measure, with which that of a limit such as "75 V" must agree.
    """
    if isinstance(texts, str):
        texts = (texts,)
    made: list[Constraint] = []
    faults: list[Fault] = []
    for k, text in enumerate(texts):
        place = f"subject_to[{k}]"
        signs = _COMPARED.findall(text) if isinstance(text, str) else []
        if len(signs) != 1 or signs[0] not in ("<=", ">=", "<", ">"):
            message = f"{quoted(str(text))} is not a comparison of two sides with <= or >=."
            faults.append(Fault("E501", place, message, 'Example: "noisy.variation <= 75".'))
            continue
        left, right = (_parsed(place, side) for side in text.split(signs[0]))
        wrong = _faults(place, text, (*left.names, *right.names), measures, scenarios, unknown)
        faults += wrong or _misfits(place, text.split(signs[0]), (left, right), unit_of)
        if signs[0].startswith(">"):
            left, right = right, left
        is_bare = any("." not in name for name in (*left.names, *right.names))
        for scenario in scenarios if is_bare else ("",):
            made.append(Constraint(text, left, right, scenario))
    _check(faults)
    return tuple(made)


def _parsed(place: str, text: str) -> Expression:
    if not isinstance(text, str):
        raise UsageError(Fault("E501", place, f"must be a text, not {type(text).__name__}.", 'Example: "ITAE + '
            '1e-3*ISU".'))
    try:
        return parse(text.strip(), has_parts=True)
    except ModelError as error:
        if (quantity := _quantity(text)) is not None:
            if units.has_offset(quantity[1]):
                message = f"{quantity[1]} has an offset, but measures are differences, which have none."
                fault = Fault("E501", place, message, f"Write {units.difference(quantity[1])}.")
                raise UsageError(fault) from None
            return parse(repr(units.to_si(*quantity)))  # measures are in SI
        raise UsageError(*(Fault("E501", place, fault.message, fault.cure) for fault in error.faults)) from None


def _quantity(text: str) -> tuple[float, str] | None:
    """Return the number and the unit of a text such as "75 V"; None for any other text."""
    with suppress(ModelError):
        if (found := quantity_in(text)) and found[1]:
            return float(found[0]), units.parse(found[1]).text
    return None


def _misfits(
    place: str, texts: Sequence[str], sides: Sequence[Expression], unit_of: Callable[[str], str]
) -> list[Fault]:
    """Find a limit with a unit beside a measure that is another quantity."""
    faults = []
    for text, other in ((texts[0], sides[1]), (texts[1], sides[0])):
        quantity = _quantity(text)
        if quantity is not None and other.name is not None:
            unit = unit_of(other.name.rpartition(".")[2])
            if not units.same_quantity(quantity[1], unit):
                message = f"{quoted(text.strip())} limits a measure in {unit}, which is a different quantity."
                faults.append(Fault("E501", place, message))
    return faults


def _faults(
    place: str, text: str, names: Sequence[str], measures: Sequence[str], scenarios: Sequence[str], unknown: str
) -> list[Fault]:
    """Names that mean no measure, or no scenario."""
    faults = []
    for name in names:
        scenario, _, measure = name.rpartition(".")
        if scenario and scenario not in scenarios:
            cure = did_you_mean(scenario, scenarios) or f"Scenarios: {', '.join(scenarios)}."
            faults.append(Fault(unknown, place, f"there is no scenario {quoted(scenario)}.", cure))
        elif measure not in measures:
            cure = did_you_mean(measure, measures) or f"Measures: {', '.join(measures) or 'none'}."
            faults.append(Fault(unknown, place, f"the diagram has no measure {quoted(measure)}.", cure))
    if not names:
        faults.append(Fault("E501", place, f"{quoted(text)} contains no measure.", f"Measures: {', '.join(measures)}."))
    return faults


def _check(faults: Sequence[Fault]) -> None:
    if faults:
        raise UsageError(*dict.fromkeys(faults))


def _reads(expression: Expression, scenarios: Sequence[str]) -> list[tuple[str, str]]:
    found = []
    for name in expression.names:
        scenario, _, measure = name.rpartition(".")
        found += [(each, measure) for each in ((scenario,) if scenario else scenarios)]
    return found
