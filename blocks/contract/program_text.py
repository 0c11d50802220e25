"""The text of a program in plain Python: what stands for it where no equations tell what it computes.

A program counts by how it is written, without comments and empty lines: the function that makes it, and the functions,
classes and plain constants of the user's that these name, wherever they lie, and the defaults of arguments. Constants
are what cannot change: numbers, texts, and tuples of them. Lists, dicts, arrays and other objects may be what a program
works with; they do not count. Where Python has no source of one, its name alone stands there.
"""

from __future__ import annotations

import inspect
import io
import textwrap
import tokenize
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from .captured_values import is_settled

_PLAIN = (bool, int, float, complex, str, bytes, np.generic)


def program_text(function: Callable[..., object]) -> str:
    """The text of the function that makes a program and of all that it names, in the order of their names."""
    pending: list[tuple[str, object]] = [(getattr(function, "__qualname__", "program"), function)]
    seen: set[int] = set()
    texts: set[str] = set()
    while pending:
        name, value = pending.pop()
        if _is_constant(value):
            texts.add(f"{name} = {_constant(value)}")
        elif isinstance(value, (FunctionType, type)) and id(value) not in seen and not is_settled(value.__module__):
            seen.add(id(value))
            texts.add(f"{value.__qualname__}\n{_source(value)}".rstrip())
            pending += _named(value)
    return "\n".join(sorted(texts))


def _is_constant(value: object) -> bool:
    return isinstance(value, _PLAIN) or (isinstance(value, (tuple, frozenset)) and all(map(_is_constant, value)))


def _constant(value: object) -> str:
    """A constant as Python writes it, in the same way wherever it runs."""
    if isinstance(value, (tuple, frozenset)):
        parts = [_constant(part) for part in value]
        return f"({', '.join(parts)})" if isinstance(value, tuple) else f"{{{', '.join(sorted(parts))}}}"
    return repr(value.item() if isinstance(value, np.generic) else value)


def _named(value: Any) -> Iterator[tuple[str, object]]:
    """What a function, or a class with its methods and bases, names."""
    if isinstance(value, FunctionType):
        yield from _named_by(value)
        return
    for base in value.__bases__:
        yield base.__qualname__, base
    for item in vars(value).values():
        for part in (item, *(getattr(item, word, None) for word in ("__func__", "fget", "fset", "__wrapped__"))):
            if isinstance(part, FunctionType):
                yield from _named_by(part)


def _named_by(function: FunctionType) -> Iterator[tuple[str, object]]:
    known = dict(function.__globals__)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            known[name] = cell.cell_contents
        except ValueError:  # it is empty
            continue
    for index, value in enumerate((*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values())):
        if value is not None:
            yield f"{function.__qualname__} default {index}", value
    names = dict.fromkeys(code_names(function.__code__))
    for name in names:
        if name.startswith("__"):  # what a module knows of itself, such as its file
            continue
        value = known.get(name)
        if isinstance(value, ModuleType) and not is_settled(value.__name__):
            yield from ((other, vars(value)[other]) for other in names if other in vars(value))
        elif value is not None:
            yield name, value


def code_names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function, and the functions inside it, read from outside."""
    yield from (*code.co_names, *code.co_freevars)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from code_names(constant)


def _source(value: Any) -> str:
    """The source of a function or a class without comments, empty lines and the indentation of the whole."""
    try:
        lines = textwrap.dedent(inspect.getsource(value)).splitlines()
    except Exception:  # there is none, or its file was edited since into what is no Python
        return ""
    try:
        for token in tokenize.generate_tokens(io.StringIO("\n".join(lines) + "\n").readline):
            if token.type == tokenize.COMMENT:
                row, column = token.start
                lines[row - 1] = lines[row - 1][:column]
    except (tokenize.TokenError, SyntaxError):  # a part of a statement, as a lambda may be
        pass
    return "\n".join(line.rstrip() for line in lines if line.strip())
