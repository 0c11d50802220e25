"""What the functions of a block class read from outside: globals, cells of closures, helpers, attributes of modules.

Equations are run once, so what they read then is a constant of the tape. `outside` follows the code of a class and
notes each of these values; `Outside.holds` says whether all are still the same. Numbers, texts, lists, tuples, dicts,
sets, arrays and the attributes of plain objects are compared by content, all else by identity. What the library that
ships, numpy, CasADi and Python's own modules hold is taken to stand still, so that it costs nothing.
"""

from __future__ import annotations

import builtins
import dis
import enum
import functools
import hashlib
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from .declare import Declaration, Variable

__all__ = ["Outside", "outside", "outside_of"]

_MISSING: Any = type("Missing", (), {"__repr__": lambda self: "MISSING"})()
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_SETTLED = frozenset({"blocks", "numpy", "scipy", "casadi", "control"})
_MOST = 100_000
"""The most values of containers and objects that are compared by content, in what one name stands for."""


@dataclass(frozen=True, slots=True)
class _Watch:
    """One value: how it is had, what it was, its content then, and whether the same object has the same content."""

    now: Callable[[], Any]
    value: Any
    content: Any
    is_fixed: bool

    def holds(self) -> bool:
        now = self.now()
        if now is self.value and self.is_fixed:
            return True
        return bool(_content(now) == self.content)


@dataclass(frozen=True, eq=False, slots=True)
class Outside:
    """What a class read from outside at one time."""

    watches: tuple[_Watch, ...]

    def holds(self) -> bool:
        """Whether all of it is still what it was."""
        return all(watch.holds() for watch in self.watches)


_KNOWN: dict[Declaration, Outside] = {}


def outside(declaration: Declaration) -> Outside:
    """What the functions of a class read from outside now; the same object as long as it stays the same."""
    known = _KNOWN.get(declaration)
    if known is None or not known.holds():
        reader = _Reader()
        for function in _functions(declaration):
            reader.value(function)
        known = _KNOWN[declaration] = Outside(tuple(reader.watches.values()))
    return known


def outside_of(declarations: Iterable[Declaration]) -> tuple[Outside, ...]:
    """What several classes read, of those that read anything."""
    return tuple(made for made in map(outside, dict.fromkeys(declarations)) if made.watches)


def _functions(declaration: Declaration) -> Iterator[Callable[..., Any]]:
    """All functions of a class that are called before a run begins."""
    variables: list[Variable] = [*declaration.readable.values(), *declaration.event_times.values()]
    found: list[Any] = [equation.function for equation in declaration.equations]
    found += [requirement.equation.function for requirement in declaration.requirements]
    for variable in variables:
        shapes = variable.shape if isinstance(variable.shape, tuple) else (variable.shape,)
        found += [variable.unit, *shapes]
        found += [getattr(variable, word, None) for word in ("default", "start", "delay", "before")]
    for equation in declaration.equations:
        for role in equation.roles:
            found += [role.clock.every, role.clock.offset] if role.clock is not None else []
    for function in found:
        if callable(function) and not isinstance(function, Variable):
            yield function


# --- content ---------------------------------------------------------------------------------------------------


class _Same:
    """An object that is equal to itself only, and stays as long as this does."""

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


class _TooMuch(Exception):
    """There is more than is looked at."""


def _content(value: Any, found: list[Any] | None = None) -> Any:
    """What a value holds, as something that can be compared. found: takes what is compared by identity."""
    if isinstance(value, _PLAIN):  # most are
        return type(value), repr(value)
    seen: dict[int, int] = {}

    def of(value: Any) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            return kind, repr(value)  # tells 1 from True, 0.0 from -0.0, and NaN is NaN
        if id(value) in seen:
            return "again", seen[id(value)]
        if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.dtype.hasobject):
            return kind, value.dtype.str, value.shape, hashlib.blake2b(value.tobytes()).digest()
        is_own = _is_own(kind) and not isinstance(value, (enum.Enum, type, ModuleType, np.ndarray))
        items: Any = ()
        if isinstance(value, dict):
            items = [part for pair in value.items() for part in pair]
        elif isinstance(value, (list, tuple)):
            items = value
        elif isinstance(value, np.ndarray):
            items = [value.shape, *value.ravel()]
        elif isinstance(value, functools.partial):
            items = (value.func, value.args, value.keywords)
        elif isinstance(value, MethodType):
            items = (value.__func__, value.__self__)
        elif not isinstance(value, (set, frozenset)) and not is_own:
            if found is not None:
                found.append(value)
            return _Same(value)
        seen[id(value)] = len(seen)
        if len(seen) > _MOST:
            raise _TooMuch
        if isinstance(value, (set, frozenset)):
            return kind, frozenset(map(of, value))
        if is_own:
            if found is not None:
                found.append(value)
            slots = (name for cls in kind.__mro__ for name in _names(cls.__dict__.get("__slots__", ())))
            fields = {name: getattr(value, name, _MISSING) for name in slots} | getattr(value, "__dict__", {})
            items = [*items, *(part for pair in fields.items() for part in pair)]
        return (kind, *map(of, items))

    try:
        return of(value)
    except (_TooMuch, RecursionError):
        return _Same(value)


def _names(slots: Any) -> Iterator[str]:
    for name in (slots,) if isinstance(slots, str) else slots:
        if not name.startswith("__"):
            yield name


def _is_own(kind: type) -> bool:
    """Whether a type is one of the user's, whose objects are looked into."""
    if kind is _TYPE_OF_NAMESPACES:
        return True
    return bool(kind.__flags__ & 1 << 9) and not _is_settled(kind.__module__)  # made by a class statement


_TYPE_OF_NAMESPACES: Any = type(sys.implementation)  # types.SimpleNamespace
_STDLIB = os.path.dirname(os.__file__) + os.sep


def _is_settled(name: Any) -> bool:
    """Whether what a module holds is taken to stand still."""
    root = str(name).partition(".")[0]
    if root in _SETTLED:
        return True
    if root not in sys.stdlib_module_names:
        return False
    # A user's module may have a name of Python's own.
    file = getattr(sys.modules.get(root), "__file__", None)
    return file is None or file.startswith(_STDLIB)


# --- reading code ----------------------------------------------------------------------------------------------


class _Reader:
    """Follows functions into all that they read."""

    def __init__(self) -> None:
        self.watches: dict[Any, _Watch] = {}
        self.done: set[Any] = set()
        self.kept: list[Any] = []  # what keys name by its id

    def watch(self, key: Any, now: Callable[[], Any]) -> Any:
        """Note a value, follow what it holds, and give it."""
        value = now()
        if key not in self.watches:
            found: list[Any] = []
            content = _content(value, found)
            is_fixed = isinstance(value, _PLAIN) or isinstance(content, _Same)
            self.watches[key] = _Watch(now, value, content, is_fixed)
            for item in found:
                self.value(item)
        return value

    def value(self, value: Any) -> None:
        """Follow a function, or what can be called of a class or an object of the user's."""
        if isinstance(value, MethodType):
            self.value(value.__func__)
            self.watch(("self", id(value)), lambda: value.__self__)
            self.kept.append(value)
        elif isinstance(value, functools.partial):
            self.watch(("partial", id(value)), lambda: value)
            self.kept.append(value)
        elif isinstance(value, FunctionType):
            self.function(value)
        elif isinstance(inspect.getattr_static(value, "__wrapped__", None), FunctionType):  # as functools.cache makes
            self.function(value.__wrapped__)
        elif isinstance(value, type) and _is_own(value):
            for name in ("__init__", "__new__", "__post_init__"):
                self.value(_static(value, name))
        elif _is_own(type(value)):
            self.function_of(type(value), "__call__")

    def function_of(self, owner: type, name: str) -> None:
        """Follow the method or the property of a class."""
        made = _static(owner, name)
        for part in (made.fget,) if isinstance(made, property) else (made,):
            if isinstance(part, FunctionType):
                self.watch(("attribute", owner, name), lambda: _static(owner, name))
                self.function(part, owner)

    def function(self, function: FunctionType, owner: type | None = None) -> None:
        if (id(function), owner) in self.done or _is_settled(function.__globals__.get("__name__", "")):
            return
        self.done.add((id(function), owner))
        self.kept.append(function)
        self.watch(("code", id(function)), lambda: function.__code__)
        if function.__defaults__ or function.__kwdefaults__:
            self.watch(("defaults", id(function)), lambda: (function.__defaults__, function.__kwdefaults__))
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        self.code(function.__code__, function, cells, owner)

    def code(self, code: CodeType, function: FunctionType, cells: dict[str, Any], owner: type | None) -> None:
        """Follow the names of a code and their attributes."""
        chain: Any = _MISSING  # what stands on the stack, where that is known
        modules: list[ModuleType] = []  # of which names may be read that no instruction tells
        for instruction in dis.get_instructions(code):
            name, op = instruction.argval, instruction.opname
            if op in ("LOAD_ATTR", "LOAD_METHOD"):
                if chain is _MISSING and owner is not None:
                    self.function_of(owner, name)  # of self
                chain = self.attribute(chain, name)
                continue
            self.end(chain, modules)
            chain = _MISSING
            if op in ("LOAD_GLOBAL", "LOAD_NAME"):
                chain = self.watch(("global", id(function.__globals__), name), _global_of(function, name))
            elif "DEREF" in op and op.startswith("LOAD") and name in cells:
                chain = self.watch(("cell", id(cells[name])), _cell_of(cells[name]))
            elif op == "IMPORT_NAME":
                self.end(sys.modules.get(name, _MISSING), modules)
        for module in modules:
            for name in code.co_names:
                if name in vars(module):
                    self.attribute(module, name)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self.code(constant, function, cells, owner)

    def end(self, value: Any, modules: list[ModuleType]) -> None:
        if isinstance(value, ModuleType) and not _is_settled(value.__name__):
            modules.append(value)

    def attribute(self, value: Any, name: str) -> Any:
        """An attribute of a module, a class or an object, where it can be had without running code of it."""
        if isinstance(value, ModuleType):
            if _is_settled(value.__name__):
                return getattr(value, name, _MISSING)
            return self.watch(("attribute", id(value), name), lambda: getattr(value, name, _MISSING))
        if isinstance(value, type) and _is_own(value):
            return self.watch(("attribute", value, name), lambda: _static(value, name))
        if _is_own(type(value)):
            self.function_of(type(value), name)
            own = getattr(value, "__dict__", {})
            return own[name] if name in own else self.attribute(type(value), name)
        return _MISSING


def _global_of(function: FunctionType, name: str) -> Callable[[], Any]:
    own, beneath = function.__globals__, vars(builtins)
    return lambda: own[name] if name in own else beneath.get(name, _MISSING)


def _cell_of(cell: Any) -> Callable[[], Any]:
    def now() -> Any:
        try:
            return cell.cell_contents
        except ValueError:  # it is empty
            return _MISSING

    return now


def _static(owner: type, name: str) -> Any:
    """What a class has under a name, without any code of it."""
    made = next((cls.__dict__[name] for cls in owner.__mro__ if name in cls.__dict__), _MISSING)
    return made.__func__ if isinstance(made, (staticmethod, classmethod)) else made
