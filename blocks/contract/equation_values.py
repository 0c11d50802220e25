"""The results of equations for values of their arguments: for symbols, from which a tape is made."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from ..text.errors import DeclarationError, Fault
from .interface import Interface
from .variables import Equation


class EquationValues:
    """The values that equations read, by name; locals are computed when first read.

    seen: what the other equations see of a local, by its name and what it gives.
    """

    def __init__(
        self,
        interface: Interface,
        known: Mapping[str, object],
        made: Callable[[Any], object],
        seen: Callable[[str, Any], object] = lambda name, value: value,
    ) -> None:
        self.interface, self.known, self.made, self.seen = interface, dict(known), made, seen
        self.given: dict[str, Any] = {}  # by locals

    def __getitem__(self, name: str) -> Any:
        if name not in self.known:
            self.known[name] = self.seen(name, self.local(name))
        return self.known[name]

    def local(self, name: str) -> Any:
        """What the equation of a local gives."""
        if name not in self.given:
            self.given[name] = self.of(self.interface.declaration.locals[name].equation)
        return self.given[name]

    def of(self, equation: Equation) -> Any:
        """What an equation gives, as an array. Raises DeclarationError (E407), with the cause."""
        values = [self[name] for name in equation.reads]
        try:
            return self.made(equation.function(*values))
        except Exception as error:  # a user's function may raise anything; each is reported with its place
            cause = error.__cause__ if isinstance(error.__cause__, TypeError) else error  # numpy hides the refusal
            text = str(cause) if isinstance(cause, TypeError) else f"{type(error).__name__}: {error}"
            raise refusal(self.interface, equation, text, error) from error


def refusal(
    interface: Interface, equation: Equation, message: str, error: BaseException | None = None
) -> DeclarationError:
    """E407, with the line of the equation where the `error` came up, or where it begins, if that stands in a file."""
    fault = Fault("E407", f"{interface.name}.{equation.name}", f"cannot be traced: {message}")
    code = getattr(equation.function, "__code__", None)
    if code is None or not os.path.isfile(code.co_filename):
        return DeclarationError(fault)
    line, column = code.co_firstlineno, 0
    frame = error.__traceback__ if error is not None else None
    while frame is not None:
        if frame.tb_frame.f_code is code:
            line, column = frame.tb_lineno, [*code.co_positions()][frame.tb_lasti // 2][2] or 0
        frame = frame.tb_next
    return DeclarationError(fault.at(code.co_filename, line, column + 1))
