"""Units that follow from unit parameters, written as what they are: `unit / "s"`, `unit * "m"`, `unit / unit_u`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

from ..text import units
from ..text.errors import DeclarationError, Fault, ModelError


class UnitParameter(Protocol):
    """A parameter whose text is a unit; `Parameter` is one."""

    name: str


class UnitExpression:
    """The unit that a text parameter of the class names, or a product, a quotient or a power of units.

    It is a function of these parameters: called with their texts, in the order of `reads`, it gives a text. Where one
    of the units is unknown (""), so is what it gives. A parameter that stands alone gives its text as it is.

    parameters: the unit parameters, each once. compute: the unit, from the texts of the parameters by name.
    """

    __slots__ = ("compute", "parameters")

    def __init__(self, parameters: tuple[UnitParameter, ...], compute: Callable[[Mapping[str, str]], str]) -> None:
        self.parameters, self.compute = tuple(dict.fromkeys(parameters)), compute

    @property
    def reads(self) -> tuple[str, ...]:
        """The names of the unit parameters, which they have once the class body has named them."""
        return tuple(parameter.name for parameter in self.parameters)

    def __call__(self, *texts: str) -> str:
        return self.compute(dict(zip(self.reads, texts, strict=True)))

    def moved(self, to: Callable[[UnitParameter], UnitParameter]) -> UnitExpression:
        """The same expression of other parameters: `to` gives each parameter's counterpart, which has its name."""
        return UnitExpression(tuple(map(to, self.parameters)), self.compute)

    def __mul__(self, other: object) -> UnitExpression:
        return _combined(units.product, self, _unit(other))

    def __rmul__(self, other: object) -> UnitExpression:
        return _combined(units.product, _unit(other), self)

    def __truediv__(self, other: object) -> UnitExpression:
        return _combined(units.quotient, self, _unit(other))

    def __rtruediv__(self, other: object) -> UnitExpression:
        return _combined(units.quotient, _unit(other), self)

    def __pow__(self, exponent: object) -> UnitExpression:
        if isinstance(exponent, bool) or not isinstance(exponent, int):
            raise _refused(f"the exponent of a unit must be a whole number, not {exponent!r}.", "")
        return UnitExpression(self.parameters, lambda known: units.power(self.compute(known), exponent))

    def __repr__(self) -> str:
        return f"<a unit that follows from {', '.join(self.reads)}>"


@runtime_checkable
class _UnitParameter(Protocol):
    """A unit parameter."""

    def as_unit(self) -> UnitExpression: ...


def _combined(operation: Callable[[str, str], str], left: UnitExpression, right: UnitExpression) -> UnitExpression:
    parameters = (*left.parameters, *right.parameters)
    return UnitExpression(parameters, lambda known: operation(left.compute(known), right.compute(known)))


def _unit(value: object) -> UnitExpression:
    """What may stand beside a unit: a text, a unit parameter or an expression. Raises DeclarationError (E405)."""
    if isinstance(value, str):
        try:
            units.parse(value)
        except ModelError as error:
            raise _refused(error.faults[0].message, error.faults[0].cure) from None
        return UnitExpression((), lambda known: value)
    if isinstance(value, UnitExpression):
        return value
    if not isinstance(value, _UnitParameter):
        cure = 'Use a text such as "s", or a text parameter of the class.'
        raise _refused(f"{value!r} is not a unit.", cure)
    return value.as_unit()


def _refused(message: str, cure: str) -> DeclarationError:
    return DeclarationError(Fault("E405", "", message, cure))
