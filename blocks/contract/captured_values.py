"""What the functions of a block class read from outside: globals, cells of closures, helpers, attributes of modules.

Equations are run once, so what they read then is a constant of the tape. `outside` follows the code of a class and
notes each of these values; `Outside.holds` says whether all are still the same. Numbers, texts, lists, tuples, dicts,
sets, arrays and the attributes of plain objects are compared by content, all else by identity. What the library that
ships, numpy and Python's own modules hold is taken as constant, so that it costs nothing.

Functions that are known to give something else each time are noted too: random numbers, clocks, files.
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
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from .declaration import Declaration
from .variables import Variable

_MISSING: object = type("Missing", (), {"__repr__": lambda self: "MISSING"})()
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_SETTLED = frozenset({"blocks", "numpy", "scipy", "control"})
_MOST = 100_000
"""The most values of containers and objects that are compared by content, in what one name stands for."""


@dataclass(frozen=True, slots=True)
class _Watch:
    """A value: how it is obtained, what it was, its content then, and whether the same object has the same content."""

    now: Callable[[], Any]
    value: Any
    content: object
    is_fixed: bool

    def holds(self) -> bool:
        now = self.now()
        if now is self.value and self.is_fixed:
            return True
        return bool(_content(now) == self.content)


@dataclass(frozen=True, eq=False, slots=True)
class Outside:
    """What a class read from outside at one time.

    impure: what its equations name that gives something else each time: the equation, the name and what it is.
    is_opaque: they read something that cannot be looked into. is_unsteady: they, or what is called before a run, as
    defaults are, name something that is else each time.
    """

    watches: tuple[_Watch, ...]
    impure: tuple[tuple[str, str, str], ...] = ()
    is_opaque: bool = False
    is_unsteady: bool = False

    def holds(self) -> bool:
        """Whether all of it is still what it was."""
        return all(watch.holds() for watch in self.watches)


_KNOWN: dict[Declaration, Outside] = {}
_LOCK = threading.RLock()  # of what is known; what is compared by content may ask for more


def outside(declaration: Declaration) -> Outside:
    """What the functions of a class read from outside now; the same object as long as it stays the same."""
    known = _KNOWN.get(declaration)
    if known is not None and known.holds():
        return known
    with _LOCK:  # two threads that looked at once would have an object each
        known = _KNOWN.get(declaration)
        if known is None or not known.holds():
            known = _KNOWN[declaration] = _found(declaration)
        return known


def _found(declaration: Declaration) -> Outside:
    reader = _ReadsFinder()
    for equation in declaration.equations:
        reader.equation = equation.name
        reader.value(equation.function)
    impure, is_opaque = tuple(reader.impure), reader.is_opaque
    for function in _functions(declaration):
        reader.value(function)
    return Outside(tuple(reader.watches.values()), impure, is_opaque, bool(reader.impure))


def outside_of(declarations: Iterable[Declaration]) -> tuple[Outside, ...]:
    """What several classes read, of those that read anything."""
    return tuple(read for read in map(outside, dict.fromkeys(declarations)) if read.watches)


def _functions(declaration: Declaration) -> Iterator[Callable[..., object]]:
    """All functions of a class that are called before a run begins, besides its equations."""
    variables: list[Variable] = [*declaration.readable.values(), *declaration.event_times.values()]
    candidates: list[object] = [requirement.equation.function for requirement in declaration.requirements]
    for variable in variables:
        shapes = variable.shape if isinstance(variable.shape, tuple) else (variable.shape,)
        candidates += [variable.unit, *shapes]
        candidates += [getattr(variable, word, None) for word in ("default", "start", "delay", "before")]
    for equation in declaration.equations:
        for role in equation.roles:
            candidates += [role.clock.every, role.clock.offset] if role.clock is not None else []
    for function in candidates:
        if callable(function) and not isinstance(function, Variable):
            yield function


# --- content ---------------------------------------------------------------------------------------------------


class _Same:
    """An object that is equal to itself only, and stays as long as this does."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


class _TooMuch(Exception):
    """There is more than is looked at."""


def _content(value: object, by_identity: list[Any] | None = None) -> object:
    """What a value holds, as something that can be compared. by_identity: takes what is compared by identity."""
    if isinstance(value, _PLAIN):  # most are
        return type(value), repr(value)
    seen: dict[int, int] = {}

    def of(value: object) -> Any:
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
            if by_identity is not None:
                by_identity.append(value)
            return _Same(value)
        seen[id(value)] = len(seen)
        if len(seen) > _MOST:
            raise _TooMuch
        if isinstance(value, (set, frozenset)):
            return kind, frozenset(map(of, value))
        if is_own:
            if by_identity is not None:
                by_identity.append(value)
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
    return bool(kind.__flags__ & 1 << 9) and not is_settled(kind.__module__)  # made by a class statement


_TYPE_OF_NAMESPACES: object = type(sys.implementation)  # types.SimpleNamespace
_STDLIB = os.path.dirname(os.__file__) + os.sep


def is_settled(name: object) -> bool:
    """Whether what a module holds is taken as constant."""
    root = str(name).partition(".")[0]
    if root in _SETTLED:
        return True
    if root not in sys.stdlib_module_names:
        return False
    # A user's module may have a name of Python's own.
    file = getattr(sys.modules.get(root), "__file__", None)
    return file is None or file.startswith(_STDLIB)


# --- what is not pure ------------------------------------------------------------------------------------------

_RANDOM, _CLOCK, _FILES = "random numbers", "the clock", "files or the system"
_IMPURE = {
    **dict.fromkeys(("random", "secrets", "uuid", "numpy.random"), _RANDOM),
    **dict.fromkeys(("time",), _CLOCK),
    **dict.fromkeys(("os", "posix", "nt", "io", "_io", "pathlib", "genericpath", "tempfile", "shutil", "glob"), _FILES),
    **dict.fromkeys(("fileinput", "mmap", "shelve", "dbm", "sqlite3", "subprocess", "socket", "urllib"), _FILES),
    **dict.fromkeys(("http", "zipfile", "tarfile", "gzip", "linecache"), _FILES),
}
"""What a module gives that is something else each time."""
_READERS = frozenset({"load", "loadtxt", "genfromtxt", "fromfile", "memmap", "save", "savez", "savetxt"})  # of numpy
_CLOCKS = frozenset({"now", "today", "utcnow"})  # of datetime
_PURE = frozenset({"numpy", "math", "cmath", "builtins", "blocks", "operator", "functools", "enum"})
_ANYTHING = frozenset({"eval", "exec", "globals", "vars", "id", "hash", "next", "iter", "__import__", "getattr"})


def _home(value: object) -> str:
    """The module that a value comes from."""
    if isinstance(value, ModuleType):
        return value.__name__
    owner = getattr(value, "__self__", None) if isinstance(value, (BuiltinFunctionType, MethodType)) else None
    if owner is not None and not isinstance(owner, ModuleType):
        return str((owner if isinstance(owner, type) else type(owner)).__module__)
    is_named = isinstance(value, (type, FunctionType)) or callable(value)
    home = getattr(value, "__module__", None) if is_named else None
    return home if isinstance(home, str) else type(value).__module__


def _impurity(value: object) -> str:
    """What it gives that is something else each time; "" where nothing is known of it."""
    home, name = _home(value), getattr(value, "__name__", "")
    if not is_settled(home):
        return ""
    if home.startswith("datetime"):
        return _CLOCK if name in _CLOCKS else ""
    if home.startswith("numpy") and name in _READERS:
        return _FILES
    if home == "builtins":
        return "the console" if value is input else ""
    return _impure_name(home)


def _impure_name(name: str) -> str:
    parts = name.split(".")
    return next((_IMPURE[package] for k in (2, 1) if (package := ".".join(parts[:k])) in _IMPURE), "")


def _is_opaque(value: object) -> bool:
    """Whether it may give something else each time, for all that can be seen."""
    if isinstance(value, (FunctionType, ModuleType, enum.Enum, np.ufunc, property)) or value is _MISSING:
        return False
    if isinstance(value, type) or callable(value):
        home = _home(value)
        if _is_own(value if isinstance(value, type) else type(value)):
            return False
        return home.partition(".")[0] not in _PURE or getattr(value, "__name__", "") in _ANYTHING
    return not _is_own(type(value))


# --- reading code ----------------------------------------------------------------------------------------------


class _ReadsFinder:
    """Follows functions into all that they read."""

    def __init__(self) -> None:
        self.watches: dict[object, _Watch] = {}
        self.done: set[Any] = set()
        self.kept: list[Any] = []  # what keys name by its id
        self.equation = ""
        self.impure: dict[tuple[str, str, str], None] = {}
        self.is_opaque = False

    def judge(self, value: object, name: str = "") -> None:
        """Note what gives something else each time."""
        what = _impurity(value)
        if what:
            shown = name or ".".join(filter(None, (_home(value), getattr(value, "__name__", type(value).__name__))))
            self.impure[self.equation, shown, what] = None
        elif _is_opaque(value):
            self.is_opaque = True

    def watch(self, key: object, now: Callable[[], object], name: str = "") -> object:
        """Note a value, follow what it holds, and give it. name: what the code calls it."""
        value = now()
        if key not in self.watches:
            held: list[object] = []
            content = _content(value, held)
            is_fixed = isinstance(value, _PLAIN) or isinstance(content, _Same)
            self.watches[key] = _Watch(now, value, content, is_fixed)
            for item in held:
                self.value(item, name if item is value else "")
        return value

    def value(self, value: Any, name: str = "") -> None:
        """Follow a function, or what can be called of a class or an object of the user's."""
        if not isinstance(value, ModuleType):
            self.judge(value, name)
        if isinstance(value, np.vectorize):
            self.watch(("vectorized", id(value)), lambda: value.pyfunc)
            self.kept.append(value)
        elif isinstance(value, MethodType):
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
        member = _static(owner, name)
        for part in (member.fget,) if isinstance(member, property) else (member,):
            if isinstance(part, FunctionType):
                self.watch(("attribute", owner, name), lambda: _static(owner, name))
                self.function(part, owner)

    def function(self, function: FunctionType, owner: type | None = None) -> None:
        if (id(function), owner) in self.done or is_settled(function.__globals__.get("__name__", "")):
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
        chain, text = _MISSING, ""  # what stands on the stack, where that is known, and how it is written
        modules: list[ModuleType] = []  # whose attributes may be read by names that no instruction shows
        for instruction in dis.get_instructions(code):
            name, op = instruction.argval, instruction.opname
            if op in ("LOAD_ATTR", "LOAD_METHOD"):
                if chain is _MISSING and owner is not None:
                    self.function_of(owner, name)  # of self
                chain, text = self.attribute(chain, name), f"{text}.{name}"
                if chain is not _MISSING and not isinstance(chain, (ModuleType, *_PLAIN)):
                    self.judge(chain, text)
                continue
            self.end(chain, modules, text)
            chain, text = _MISSING, str(name)
            if op in ("LOAD_GLOBAL", "LOAD_NAME"):
                chain = self.watch(("global", id(function.__globals__), name), _global_of(function, name), name)
            elif "DEREF" in op and op.startswith("LOAD") and name in cells:
                chain = self.watch(("cell", id(cells[name])), _cell_of(cells[name]), name)
            elif op == "IMPORT_NAME":
                what = _impure_name(name) or (_CLOCK if name == "datetime" and _CLOCKS & {*code.co_names} else "")
                if what and is_settled(name):
                    self.impure[self.equation, name, what] = None
                self.end(sys.modules.get(name, _MISSING), modules, name)
        for module in modules:
            for name in code.co_names:
                if name in vars(module):
                    self.attribute(module, name)
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self.code(constant, function, cells, owner)

    def end(self, value: object, modules: list[ModuleType], text: str) -> None:
        """Note a module that is read as a whole: its attributes may then be read by any name."""
        if isinstance(value, ModuleType):
            self.judge(value, text)
            if not is_settled(value.__name__):
                modules.append(value)

    def attribute(self, value: object, name: str) -> object:
        """An attribute of a module, a class or an object, where it can be obtained without running code of it."""
        if isinstance(value, ModuleType):
            if is_settled(value.__name__):
                return getattr(value, name, _MISSING)
            return self.watch(("attribute", id(value), name), lambda: getattr(value, name, _MISSING))
        if isinstance(value, type) and not _is_own(value):
            return getattr(value, name, _MISSING)
        if isinstance(value, type):
            return self.watch(("attribute", value, name), lambda: _static(value, name))
        if _is_own(type(value)):
            self.function_of(type(value), name)
            own = getattr(value, "__dict__", {})
            return own[name] if name in own else self.attribute(type(value), name)
        return _MISSING


def _global_of(function: FunctionType, name: str) -> Callable[[], object]:
    own, beneath = function.__globals__, vars(builtins)
    return lambda: own[name] if name in own else beneath.get(name, _MISSING)


def _cell_of(cell: Any) -> Callable[[], object]:
    def now() -> Any:
        try:
            return cell.cell_contents
        except ValueError:  # it is empty
            return _MISSING

    return now


def _static(owner: type, name: str) -> object:
    """An attribute of a class, obtained without running code of it."""
    member = next((cls.__dict__[name] for cls in owner.__mro__ if name in cls.__dict__), _MISSING)
    return member.__func__ if isinstance(member, (staticmethod, classmethod)) else member
