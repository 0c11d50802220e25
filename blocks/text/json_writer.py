"""Plain values -> JSON text, in its canonical form."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, NoReturn, Protocol, runtime_checkable

from . import json_document as limits
from .errors import Fault, ModelError
from .json_document import Path, place_of
from .json_number import Number


@runtime_checkable
class _Array(Protocol):
    """A scalar or an array of NumPy, which this module does not import."""

    def tolist(self) -> Any: ...


def write(value: object, *, one_per_line: Callable[[Path, Any], bool]) -> str:
    r"""The canonical text of a value, with a line break at its end.

    A container for which `one_per_line(path, value)` is true has one entry per line, indented by one space per
    level; every other one stands on one line with all that it holds. An empty one is `{}` or `[]`.

    A Number is written as it was spelled, another float by its shortest repr. Tuples are lists; scalars and arrays of
    NumPy are the numbers they hold. Strings keep all characters but `"`, `\`, control characters, U+2028 and U+2029,
    and halves of surrogate pairs, which are escaped (`read` refuses those halves). The limits are those of files.

    Raises ModelError with all faults: E004 for inf, nan and what JSON does not know, E008 for what is too large.
    """
    text = piece(value, (), "\n", one_per_line=one_per_line) + "\n"
    largest = limits.IN_FILES * limits.LARGEST_TEXT
    if len(text) > largest or (not text.isascii() and len(text.encode("utf-8")) > largest):
        raise ModelError(Fault("E008", "", f"the text has more than {largest:,} bytes.", "Split it."))
    return text


def piece(
    value: object, path: Path, margin: str, unit: str = " ", *, one_per_line: Callable[[Path, Any], bool]
) -> str:
    """The text of a value that stands at a path. margin: the line break before its closing bracket, with the
    indentation there; "" for a value that stands on one line. unit: the indentation of one more level.
    """
    writer = _Writer(one_per_line, unit)
    writer.put(value, path, margin)
    if writer.faults:
        raise ModelError(*writer.faults)
    return "".join(writer.pieces)


def string(text: str) -> str:
    """The text of a string."""
    return '"' + _escapable.sub(_escaped, text) + '"'


# From here on an integer is rounded to an infinite float: half a spacing above the largest finite one.
_INTEGERS_END = (1 << 1024) - (1 << 970)
_PLAIN_TYPES = (str, int, float, dict, list, tuple, type(None), type)
_escapable = re.compile(r'["\\\x00-\x1f\u2028\u2029\ud800-\udfff]')
_SHORT_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t"}


def _escaped(match: re.Match[str]) -> str:
    return _SHORT_ESCAPES.get(match[0]) or f"\\u{ord(match[0]):04x}"


@dataclass
class _Writer:
    one_per_line: Callable[[Path, Any], bool]
    unit: str
    pieces: list[str] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    count: int = 0

    def put(self, value: object, path: Path, margin: str) -> None:
        """`margin` is the line break and the indentation of this level; it is empty inside a line."""
        self.count += 1
        if self.count > limits.IN_FILES * limits.LARGEST_COUNT:
            self.end(path, f"there are more than {limits.IN_FILES * limits.LARGEST_COUNT:,} values.")
        if not isinstance(value, _PLAIN_TYPES) and isinstance(value, _Array):
            value = value.tolist()
        # The methods are those of the builtin: NumPy and enumerations have a repr of their own.
        match value:
            case Mapping() | list() | tuple():
                self.container(value, path, margin)
            case str():
                self.string(value, path)
            case None | True | False:
                self.pieces.append({None: "null", True: "true", False: "false"}[value])
            case Number():
                self.pieces.append(value.text)
            case float() if isfinite(value):
                self.pieces.append(float.__repr__(value))
            case float():
                self.fault("E004", path, f"JSON has no {float.__repr__(value)}.", "Write a finite number.")
            case int() if abs(value) < _INTEGERS_END:
                self.pieces.append(int.__repr__(value))
            case int():
                self.fault("E004", path, "an integer is too large: the largest float is 1.8e308.")
            case _:
                self.fault("E004", path, f"a value of the type {type(value).__name__} cannot be written as JSON.")

    def string(self, value: str, path: Path) -> None:
        if len(value) > limits.LONGEST_STRING:
            message = f"a string has {len(value):,} characters; the limit is {limits.LONGEST_STRING:,}."
            self.fault("E008", path, message)
        self.pieces.append(string(value))

    def container(self, value: Mapping[str, object] | list[Any] | tuple[object, ...], path: Path, margin: str) -> None:
        if len(path) >= limits.LARGEST_DEPTH:
            self.end(path, f"containers are nested deeper than {limits.LARGEST_DEPTH}, or one holds itself.")
        is_object = isinstance(value, Mapping)
        lines = bool(margin and value) and self.one_per_line(path, value)
        inner = margin + self.unit if lines else ""
        separator = "{" if is_object else "["
        for key, entry in value.items() if isinstance(value, Mapping) else enumerate(value):
            self.pieces.append(separator + inner)
            separator = "," if inner else ", "
            if isinstance(key, str):
                self.string(key, path)
                self.pieces.append(": ")
            elif is_object:
                self.fault("E004", path, f"a key is of the type {type(key).__name__}.", "Use strings as keys.")
                continue
            self.put(entry, (*path, key), inner)
        self.pieces.append(("" if value else separator) + (margin if lines else "") + ("}" if is_object else "]"))

    def fault(self, code: str, path: Path, message: str, cure: str = "") -> None:
        if len(self.faults) < limits.MOST_FAULTS:
            self.faults.append(Fault(code, place_of(path), message, cure, path))

    def end(self, path: Path, message: str) -> NoReturn:
        raise ModelError(*self.faults, Fault("E008", place_of(path), message, "Split it.", path))
