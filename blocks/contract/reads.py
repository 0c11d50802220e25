"""What the functions of a block class read, and how what a class must not say is refused."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import FunctionType
from typing import Any, NoReturn

from ..text.errors import DeclarationError, Fault
from .unit_expression import UnitExpression

_VARIADIC = inspect.CO_VARARGS | inspect.CO_VARKEYWORDS

Function = Callable[..., Any]


def refuse(code: str, place: str, message: str, cure: str = "") -> NoReturn:
    raise DeclarationError(Fault(code, place, message, cure))


def arguments(function: Function, place: str) -> tuple[str, ...]:
    """The names that a function of the contract reads: plain arguments, nothing else."""
    if not callable(function):
        refuse("E405", place, f"{function!r} is not a function.")
    if type(function) is FunctionType and not (function.__defaults__ or function.__kwdefaults__ or function.__dict__):
        # Most are plain functions, whose code gives the names a hundred times faster than inspect.
        code = function.__code__
        if not (code.co_flags & _VARIADIC or code.co_kwonlyargcount or code.co_posonlyargcount):
            return code.co_varnames[: code.co_argcount]
    if isinstance(function, UnitExpression):
        return function.reads
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        refuse("E405", place, "the names of its arguments cannot be read.", "Wrap it in a def or a lambda.")
    for parameter in parameters:
        if parameter.kind is not parameter.POSITIONAL_OR_KEYWORD or parameter.default is not parameter.empty:
            refuse(
                "E405",
                place,
                f"argument '{parameter}' is not a plain name: the arguments of an equation name its variables.",
                "Write each name once, without * or a default.",
            )
    return tuple(parameter.name for parameter in parameters)
