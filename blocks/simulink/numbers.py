"""The numbers of a model: its variables, and its expressions as values of a diagram file that stay tunable."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..host.plain_files import opened
from ..results.mat_check import check
from ..text.errors import Fault, UsageError
from .matlab import Unread, Value, assignments, evaluate, names_in
from .matlab_functions import NoValue
from .tree import Model

_NAME = re.compile(r"[A-Za-z]\w*")
_FORMULA = re.compile(r"[\w.\s+\-*/()^]+")
_LIST = re.compile(r"\[([^\[\]'{}]*)\]")
_RESERVED = frozenset({"true", "false", "index", "copies", "and", "or", "not", "t"})
MOST_BYTES = 64 * 2**20
MOST_ELEMENTS = 10_000  # of one signal, or of a parameter with a value for each


@dataclass(frozen=True, slots=True)
class Raw:
    """A number as a diagram file has it. json: a number, or an expression "=kp". value: NaN where it is unknown."""

    json: Any
    value: float


class Unknown(Exception):
    """An expression has no value, or none that a diagram can hold. names: the variables that are not known."""

    def __init__(self, why: str, names: Sequence[str] = ()) -> None:
        super().__init__(why)
        self.names = tuple(names)


Given = str | os.PathLike[str] | Mapping[str, Any]
"""A file of variables, or the variables themselves."""


def read_workspace(files: Sequence[Given]) -> tuple[dict[str, Value], list[tuple[str, Unread]]]:
    """Return the variables of .mat files and of the plain assignments in .m files, and what was not read of these.

    Raises UsageError (E501) for a file that cannot be read.
    """
    known: dict[str, Value] = {}
    rest: list[tuple[str, Unread]] = []
    for each in files:
        if isinstance(each, Mapping):
            known |= {name: value if isinstance(value, str) else np.atleast_2d(value) for name, value in each.items()}
            continue
        path = Path(each)
        if path.suffix not in (".m", ".mat"):
            raise UsageError(Fault("E501", str(path), "is no file of variables.", "Give a .mat or .m file."))
        try:
            if path.suffix == ".mat":
                known |= values_of_mat(path)
            else:
                with opened(path) as stream:
                    text = stream.read(MOST_BYTES).decode("utf-8", "replace")
                known, unread = assignments(text, known)
                rest += [(path.name, one) for one in unread]
        except (OSError, ValueError, NotImplementedError) as error:
            what = getattr(error, "strerror", None) or " ".join(str(error).split())[:200] or type(error).__name__
            is_there = path.suffix == ".mat" and path.is_file()
            cure = "Save the variables by save(name, '-v7')." if is_there else "Check the path."
            raise UsageError(Fault("E501", str(path), f"the variables cannot be read: {what}.", cure)) from None
    return known, rest


def values_of_mat(path: Path) -> dict[str, Value]:
    """Return the variables of a MAT file that expressions can hold. Raises OSError, ValueError."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    def refused(what: str, cure: str = "") -> ValueError:
        return ValueError(what.rstrip(".").removeprefix("cannot be read: "))

    with opened(path) as stream:
        data = stream.read()
    if not data.startswith(b"MATLAB 7.3"):
        check(data, refused)  # a damaged file may end SciPy, and the process
    try:
        held = loadmat(io.BytesIO(data), struct_as_record=False)
    except (MatReadError, TypeError, KeyError, IndexError, EOFError) as error:
        raise ValueError(f"it is no MAT file that can be read ({type(error).__name__})") from None
    values = {name: _of_object(value) for name, value in held.items() if not name.startswith("__")}
    return {name: value for name, value in values.items() if value is not None}


def _of_object(held: Any) -> Value | None:
    """Return what a MAT file holds as a value of an expression; None for what has none."""
    if not isinstance(held, np.ndarray):
        return None
    if held.dtype.kind in "US" and held.size == 1:
        return str(held.reshape(-1)[0])
    if held.ndim == 2 and held.dtype.kind in "biuf":
        return held if held.dtype.kind == "b" else held.astype(float)
    if held.dtype == object and held.size == 1 and hasattr(inner := held.reshape(-1)[0], "_fieldnames"):
        fields = {name: _of_object(getattr(inner, name)) for name in inner._fieldnames}
        return {name: value for name, value in fields.items() if value is not None}
    return None


def variables(model: Model, base: Mapping[str, Value]) -> tuple[dict[str, Value], list[tuple[str, Unread]]]:
    """Return the variables that a model sees: of the base workspace, of its callbacks, and its own, which are first."""
    known, rest = dict(base), []
    for name in ("PreLoadFcn", "InitFcn"):
        known, unread = assignments(model.callbacks.get(name, ""), known)
        rest += [(name, one) for one in unread]
    if model.workspace:
        known, unread = assignments(model.workspace, known)
        rest += [("the model workspace", one) for one in unread]
    return known, rest


@dataclass(slots=True)
class Scope:
    """The variables that a system sees. own: the expressions of its mask, which its parent evaluates.

    used: the scalars that its diagram takes as parameters. missing: names without a value, by use.
    """

    known: Mapping[str, Value]
    own: Mapping[str, str] = field(default_factory=dict)
    used: dict[str, float] = field(default_factory=dict)
    missing: dict[str, None] = field(default_factory=dict)
    base: Mapping[str, Value] | None = None  # where masks are around it: the variables of the model

    @property
    def workspace(self) -> Mapping[str, Value]:
        """Return the variables that the model has without masks."""
        return self.known if self.base is None else self.base

    def masked(self) -> tuple[object, ...]:
        """Return what masks around it change of the workspace, as a key."""
        changed = {name: value for name, value in self.known.items() if self.workspace.get(name) is not value}
        gone = [name for name in self.workspace if name not in self.known]
        values = [
            (name, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else (name, repr(value))
            for name, value in changed.items()
        ]
        return (*gone, *values)

    def inner(self, own: Mapping[str, str], code: str = "") -> Scope:
        """Return the scope of a masked subsystem: its mask's parameters, and what the code of the mask assigns."""
        known = dict(self.known)
        for name, text in own.items():
            known.pop(name, None)
            try:
                known[name] = evaluate(text, self.known)
            except NoValue:
                if text and "=" not in text:
                    known.setdefault(name, text)  # a choice of a list, as text
        if code:
            known, _ = assignments(code, known)
        plain = {name: text for name, text in own.items() if not isinstance(known.get(name), str)}
        return Scope(known, {name: text for name, text in plain.items() if _same(known, name, text, self.known)},
                     base=self.workspace)  # fmt: skip

    def value(self, text: str) -> Value:
        """Return the value of an expression. Raises Unknown."""
        try:
            return evaluate(text, self.known)
        except NoValue as none:
            if none.name:
                self.missing[none.name] = None
            raise Unknown(f"{text.strip()[:80]!r} has no value: {none}", [none.name] if none.name else []) from None

    def raw(self, text: str) -> Raw:
        """Return a number as the diagram has it: variables that it names become parameters. Raises Unknown."""
        text = text.strip()
        names = [name for name in named(text) if name != "pi"] if _FORMULA.fullmatch(text) else []
        calls = re.search(r"\w\s*\(", text) is not None
        if not {*re.findall(r"(?<![\w.])[A-Za-z]\w*", text)} <= {*names, "pi"}:  # eps, or what is no name in a diagram
            value = _number(self.value(text), text)
            return Raw(as_json(value), value)
        if (
            names
            and not calls
            and text.count("^") < 2
            and not _RESERVED.intersection(names)
            and not ("pi" in self.known and re.search(r"\bpi\b", text))
        ):
            held = {name: self.known.get(name) for name in names}
            unknown = [name for name, value in held.items() if value is None]
            if all(value is None or _is_scalar(value) for value in held.values()):
                formula = text if _NAME.fullmatch(text) else re.sub(r"\s+", " ", text.replace("^", "**"))
                value = math.nan
                if unknown:
                    self.missing |= dict.fromkeys(unknown)
                else:
                    value = _number(self.value(text), text)
                self.used |= {name: _number(held[name], name) for name in names if name not in unknown}
                return Raw(f"={formula}", value)
        value = _number(self.value(text), text)
        if "/" in text and not names and not calls and _FORMULA.fullmatch(text) and "^" not in text:
            return Raw(f"={text}", value)  # 1/3 stays exact
        return Raw(as_json(value), value)

    def raws(self, text: str) -> list[Raw]:
        """Return the elements of a row, of a column or of one number. Raises Unknown."""
        text = text.strip()
        if (found := self._elements(text)) is not None:
            return found
        if _NAME.fullmatch(text) and (text not in self.known or _is_scalar(self.known[text])):
            return [self.raw(text)]
        if _FORMULA.fullmatch(text) and any(name not in self.known for name in named(text)):
            return [self.raw(text)]  # an unknown variable counts as a number
        value = self.matrix(text)
        if 1 not in value.shape and value.size:
            raise Unknown(f"{text[:80]!r} is a matrix, and one row is needed")
        if value.size > MOST_ELEMENTS:
            raise Unknown(f"{text[:80]!r} has {value.size:,} elements, and {MOST_ELEMENTS:,} are the most")
        return [self.raw(text)] if value.size == 1 else [Raw(as_json(float(one)), float(one)) for one in value.ravel()]

    def _elements(self, text: str) -> list[Raw] | None:
        """Return the elements of a list, each as it is written, if that is their value; else None."""
        listed, before = _LIST.fullmatch(text), dict(self.missing)
        if listed is None or not re.search(r"[A-Za-z/]", listed[1]):
            return None
        inner = re.sub(r"\s*([*/^])\s*|\s+([-+])\s+", lambda found: found[1] or found[2], listed[1].strip())
        parts = [part.strip() for part in inner.split(";")] if ";" in inner else re.split(r"\s*,\s*|\s+", inner)
        try:
            raws = [self.raw(part) for part in parts]
            values = [raw.value for raw in raws]
            if any(math.isnan(value) for value in values) or np.array_equal(self.matrix(text).ravel(), values):
                return raws
        except Unknown:
            pass
        self.missing = before
        return None

    def matrix(self, text: str) -> Any:
        """Return an expression as a matrix of floats. Raises Unknown."""
        value = self.value(text)
        _check_text(value, text.strip())
        if not isinstance(value, np.ndarray):
            raise Unknown(f"{text.strip()[:80]!r} is no number")
        if not np.all(np.isfinite(value) | np.isinf(value)):
            raise Unknown(f"{text.strip()[:80]!r} is not a number (NaN)")
        return value.astype(float)

    def handed(self, name: str, outer: Scope) -> Any:
        """Return what an entry in the outer diagram gives to a parameter of this one; None: nothing, it is inside."""
        text = self.own.get(name)
        if text is None:
            if not np.array_equal(outer.known.get(name, ""), self.known.get(name, "")):  # type: ignore[arg-type]
                return None
            text = name
        try:
            return outer.raw(text).json
        except Unknown:
            return None


def _same(known: Mapping[str, Value], name: str, text: str, outer: Mapping[str, Value]) -> bool:
    """Return whether a parameter of a mask still has the value of its expression after the mask's code."""
    try:
        return name not in known or bool(np.array_equal(known[name], evaluate(text, outer)))  # type: ignore[arg-type]
    except NoValue:
        return name not in known


def named(text: str) -> list[str]:
    """Return the names in an expression; none where it cannot be read, which its evaluation tells."""
    try:
        return names_in(text)
    except NoValue:
        return []


def _is_scalar(value: object) -> bool:
    return isinstance(value, np.ndarray) and value.size == 1 and bool(np.all(np.isfinite(value)))


def _check_text(value: Value | None, text: str) -> None:
    """Raise Unknown where the value is that of a mask's parameter which names a variable without a value."""
    if isinstance(value, str) and _NAME.fullmatch(value):
        raise Unknown(f"{text[:80]!r} has no value: {value[:80]} has no value", [value[:80]])


def _number(value: Value | None, text: str) -> float:
    _check_text(value, text)
    if not isinstance(value, np.ndarray) or value.size != 1:
        raise Unknown(f"{text[:80]!r} is no single number")
    number = float(np.reshape(value, -1)[0])
    if math.isnan(number):
        raise Unknown(f"{text[:80]!r} is not a number (NaN)")
    return number


def as_json(value: float) -> float | int:
    """Return a number as it is written: without a point if it is whole."""
    return int(value) if abs(value) < 2**53 and value == int(value) else value
