"""The inputs of a diagram during a run: constants, held and linear tables, CSV files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..contract.enumerations import Enumeration, enumeration_of
from ..host.plain_files import opened
from ..model.diagram_grammar import INTERPOLATIONS, TABLE
from ..model.values import in_si
from ..text import units
from ..text.arrays import Array
from ..text.csv_text import read_columns
from ..text.element_names import element_names
from ..text.errors import Fault, ModelError, UsageError, did_you_mean, sentence_of
from ..text.quantity_text import quantity_in, quantity_of
from .plan import Plan

if TYPE_CHECKING:
    from .coupling import Coupling

_BOOLS = {"true": 1, "false": 0}
MAX_CSV_BYTES = 512 * 2**20


@dataclass(frozen=True, slots=True)
class Track:
    """One input over time: u[k] holds from t[k] on, or is reached linearly.

    Before the first time and after the last it is constant. Of two values at one time, the second holds from there on.
    """

    t: Array  # (n,)
    u: Array  # (n, size)
    linear: bool


@dataclass(frozen=True, slots=True)
class Segment:
    """All inputs between two breakpoints, element by element: from `base` at `begin` to `aim` at `end`, linearly."""

    base: tuple[float, ...]
    aim: tuple[float, ...]
    begin: tuple[float, ...]
    end: tuple[float, ...]
    constant: bool

    def at(self, t: float) -> tuple[float, ...]:
        if self.constant:
            return self.base
        values = []
        for a, b, t0, t1 in zip(self.base, self.aim, self.begin, self.end, strict=True):
            if a == b or t0 == t1:  # held; and no NaN where coupled units have overflowed
                values.append(a)
            else:
                share = (t - t0) / (t1 - t0)
                values.append((1.0 - share) * a + share * b)  # exact at both ends: a bend is no jump of one ulp
        return tuple(values)


@dataclass(frozen=True, slots=True)
class InputTable:
    """The tracks of all inputs, in the order of the Plan."""

    tracks: tuple[Track, ...]

    def segment(self, t: float) -> Segment:
        """What holds from t on."""
        base: list[float] = []
        aim: list[float] = []
        begin: list[float] = []
        end: list[float] = []
        for track in self.tracks:
            k = int(np.searchsorted(track.t, t, side="right")) - 1
            row = following = max(k, 0)
            if track.linear and 0 <= k < len(track.t) - 1:
                following = k + 1
            size = track.u.shape[1]
            base += track.u[row].tolist()
            aim += track.u[following].tolist()
            begin += [float(track.t[row])] * size
            end += [float(track.t[following])] * size
        return Segment(tuple(base), tuple(aim), tuple(begin), tuple(end), base == aim)

    def next_break(self, t: float) -> float:
        """The first time after t at which an input jumps or bends; inf where there is none."""
        best = np.inf
        for track in self.tracks:
            k = int(np.searchsorted(track.t, t, side="right"))
            if len(track.t) > 1 and k < len(track.t):
                best = min(best, float(track.t[k]))
        return best

    def replaced(self, index: int, value: Array) -> InputTable:
        """The same with one input constant from now on."""
        track = Track(np.zeros(1), value.reshape(1, -1), False)
        return replace(self, tracks=(*self.tracks[:index], track, *self.tracks[index + 1 :]))


def read_inputs(plan: Plan | Coupling, raw: Mapping[str, object], *, interpolation: str = "linear") -> InputTable:
    """The inputs of a run.

    raw: by input name a number, a list (vectors), a quantity, a (t, u) pair or (t, u, "hold" | "linear") triple, or
    {"t": ..., "u": ..., "interpolation": ...}. Raises UsageError (E502) with all faults.
    """
    faults: list[Fault] = []
    known = [name for name, *_ in plan.inputs]
    for name in raw:
        if name not in known:
            cure = did_you_mean(name, known) or f"Inputs: {', '.join(known) or 'none'}."
            faults.append(Fault("E502", name, "the diagram has no such input.", cure))
    tracks: list[Track] = []
    for name, shape, unit, type_, default in plan.inputs:
        if name not in raw and default is None:
            cure = f'Give one: --input {name}=1 (in Python inputs={{"{name}": 1.0}}), or a default in the diagram.'
            faults.append(Fault("E502", name, "the input has no value.", cure))
            continue
        try:
            given = raw[name] if name in raw else _in_si(default or (), shape, unit)
            tracks.append(_track(given, shape, unit, type_, interpolation))
        except (ValueError, TypeError) as error:
            cure = f'Over time, give the times too: inputs={{"{name}": (t, u)}}.'
            faults.append(Fault("E502", name, sentence_of(error), cure if _is_series(raw.get(name), shape) else ""))
    if faults:
        raise UsageError(*faults)
    return InputTable(tuple(tracks))


def _is_series(raw: object, shape: tuple[int, ...]) -> bool:
    """Return whether a refused value may have been meant over time: a list, an array, a table or a function."""
    return (isinstance(raw, list) and not shape) or callable(raw) or bool(getattr(raw, "ndim", 0))


def constant(raw: object, shape: tuple[int, ...], unit: str, type_: str) -> Array:
    """One value of an input, flat. Raises ValueError with a sentence."""
    return np.asarray(_values(raw, shape, unit, type_, rows=False)[0])


def _in_si(default: Sequence[float], shape: tuple[int, ...], unit: str) -> Any:
    """A default, which the Plan holds in SI, as a quantity."""
    value = np.reshape(default, shape).tolist() if shape and default else default[0]
    return {"value": value, "unit": units.si_text(unit)} if unit else value


def _track(raw: object, shape: tuple[int, ...], unit: str, type_: str, interpolation: str) -> Track:
    if isinstance(raw, Mapping) and "value" not in raw:
        unknown = {key for key in raw if key not in TABLE and not str(key).startswith("x-")}
        if unknown or not set(TABLE[:2]) <= set(raw):
            raise ValueError('a table needs the form {"t": [...], "u": [...], "interpolation": "hold" or "linear"}.')
        values = {"value": raw["u"], "unit": raw["unit"]} if "unit" in raw else raw["u"]
        raw = (raw["t"], values, *((raw["interpolation"],) if "interpolation" in raw else ()))
    if not isinstance(raw, tuple):
        return Track(np.zeros(1), _values(raw, shape, unit, type_, rows=False), False)
    if len(raw) not in (2, 3) or (len(raw) == 3 and raw[2] not in INTERPOLATIONS):
        raise ValueError('a table must have the form (t, u) or (t, u, "hold" or "linear").')
    t = np.array(raw[0], dtype=float)
    u = _values(raw[1], shape, unit, type_, rows=True)
    if t.ndim != 1 or len(t) == 0 or len(t) != len(u):
        raise ValueError(f"a table needs one value for each time, but has {len(u)} values and {t.size} times.")
    if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0):
        raise ValueError("the times of a table must be finite and must not decrease.")
    explicit = len(raw) == 3 and raw[2] == "linear"
    if explicit and type_ != "real":
        what = f"{type_}s" if type_ in ("int", "bool") else "members of an enumeration"
        raise ValueError(f'has {what}, which cannot be interpolated by lines. Use "hold".')
    linear = type_ == "real" and (raw[2] if len(raw) == 3 else interpolation) == "linear"
    return Track(t, u, linear)


def _values(raw: object, shape: tuple[int, ...], unit: str, type_: str, *, rows: bool) -> Array:
    """Values as rows of elements, in SI."""
    raw, factor, offset = _plain(raw, unit, type_)
    if isinstance(raw, str):
        raise ValueError(f"must be a number, not the text {raw!r}.")
    array = np.asarray(raw)
    _check_type(array, type_)
    size = math.prod(shape)
    wanted = (len(array) if array.ndim else 0, *shape) if rows else shape
    if array.shape != wanted and not (array.shape == () and not rows):
        shown = f"{' x '.join(map(str, shape))} elements" if shape else "a single number"
        each = "" if not rows else " in each row" if shape else " for each time"
        raise ValueError(f"must be {shown}{each}.")
    values = np.broadcast_to(array, (len(array) if rows else 1, size)) if array.ndim == 0 else array.reshape(-1, size)
    values = values.astype(float) * factor
    if offset:
        values = values + offset
    if not np.all(np.isfinite(values)):
        raise ValueError("must be finite.")
    return values


def _plain(raw: object, unit: str, type_: str) -> tuple[object, float, float]:
    """Return given values without their unit, and the factor and the offset that convert them to SI."""
    raw, given = quantity_of(raw)
    if given and not units.same_quantity(given, unit):
        raise ValueError(f"[{given}] is given, but [{unit}] is needed: they are different quantities.")
    unit = given or unit
    # A bare number is in the unit that the input declares.
    factor, offset = (units.parse(unit).factor, units.parse(unit).offset) if unit else (1.0, 0.0)
    members = enumeration_of(type_)
    if members is None and type_ != "bool" and isinstance(raw, (str, list, tuple)) and _holds_quantities(raw):
        return in_si(raw, unit, ""), 1.0, 0.0
    if members is not None:
        if given:
            raise ValueError(f"has no unit. Give the number of a member, or its name: {', '.join(members.members)}.")
        raw = _numbers(raw, members)
    return raw, factor, offset


def _check_type(array: Array, type_: str) -> None:
    if array.dtype == object or array.dtype.kind not in "biuf":
        raise ValueError("must be numbers.")
    if type_ != "bool" and array.dtype == bool:
        raise ValueError("must be a number, not true or false.")
    if type_ == "int" and not np.all((array == np.floor(array)) & (np.abs(array) <= 2**53)):
        raise ValueError("must be integers up to 2^53.")
    if type_ == "bool" and not np.all((array == 0) | (array == 1)):
        raise ValueError("must be true or false.")


def _holds_quantities(raw: object) -> bool:
    """Whether a value is given as a text or a quantity, or holds some, such as ["2 rpm", 3]."""
    if isinstance(raw, (list, tuple)):
        return any(map(_holds_quantities, raw))
    return isinstance(raw, Mapping) or quantity_in(raw) is not None if isinstance(raw, (str, Mapping)) else False


def _numbers(raw: object, members: Enumeration) -> Any:
    """The numbers of members, which are given by name or by number."""
    if isinstance(raw, np.ndarray):
        raw = raw.tolist()
    if isinstance(raw, (list, tuple)):
        return [_numbers(item, members) for item in raw]
    return members.number(raw)


def read_csv(path: str | Path, plan: Plan) -> dict[str, object]:
    """The inputs in a CSV file: a column `time`, and one for each input (or `u[0]`, `u[1]` for the elements of one).

    Raises UsageError (E502).
    """
    path = Path(path)

    def refuse(message: str, cure: str = "") -> UsageError:
        return UsageError(Fault("E502", str(path), message, cure))

    given: dict[str, str] = {}
    try:
        with opened(path) as raw, io.TextIOWrapper(raw, encoding="utf-8-sig", newline="") as stream:
            if os.fstat(raw.fileno()).st_size > MAX_CSV_BYTES:
                raise refuse(f"is larger than {MAX_CSV_BYTES // 2**20} MiB.")
            header, data = read_columns(stream, words=_words(plan), units=given)
    except UsageError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    except ValueError as error:
        raise refuse(str(error)) from None
    if not header or header[0] not in ("time", "t"):
        raise refuse("does not begin with a column 'time'.", "Begin the first line with: time,NAME,...")
    if not len(data):
        raise refuse("has no rows.")
    try:
        data[:, 0] *= units.scale(given.get(header[0]) or "s", "s")
    except ModelError as error:
        raise refuse(f"the column '{header[0]}': {error.faults[0].message}") from None
    stop = plan.settings.stop
    if stop is not None and data[0, 0] > stop:
        message = f"begins at {data[0, 0]:.10g} s, after the end of the run at {float(stop):.10g} s."
        raise refuse(message, "Its times must be times of the run, in s: shift them, or extend the run (--stop).")
    return _columns(header, data, plan, given, refuse)


def _words(plan: Plan) -> dict[str, Mapping[str, float]]:
    """What may stand in columns besides numbers: members by their names, and true and false."""
    words: dict[str, Mapping[str, float]] = {}
    for name, shape, _, type_, _ in plan.inputs:
        members = enumeration_of(type_)
        known: Mapping[str, float] = members.members if members is not None else _BOOLS if type_ == "bool" else {}
        words.update(dict.fromkeys(element_names(name, shape), known))
    return words


def _columns(
    header: Sequence[str], data: Array, plan: Plan, given: Mapping[str, str], refuse: Any
) -> dict[str, object]:
    """Return the inputs by name, in the units that the file gives, or the inputs declare."""
    inputs: dict[str, Any] = {}
    used = {0}
    for name, shape, unit, type_, _ in plan.inputs:
        names = element_names(name, shape)
        if not any(column in header for column in names):
            continue
        missing = [column for column in names if column not in header]
        if missing:
            raise refuse(f"has no column '{missing[0]}'.")
        picked = [header.index(column) for column in names]
        used.update(picked)
        own = [given.get(column) or given.get(name) or unit for column in names] if type_ in ("real", "int") else [unit]
        values: Any = data[:, picked]
        if len(set(own)) > 1:
            try:
                factors, offsets = np.transpose([units.affine(each, unit) for each in own])
                values, own = values * factors + offsets, [unit]
            except ModelError as error:
                raise refuse(f"the columns of '{name}': {error.faults[0].message}") from None
        values = values.reshape(-1, *shape) if shape else values[:, 0]
        inputs[name] = (data[:, 0], values if own[0] == unit else {"value": values, "unit": own[0]})
    unused = [name for index, name in enumerate(header) if index not in used]
    if unused:
        known = [name for name, *_ in plan.inputs]
        cure = did_you_mean(unused[0], known) or f"Inputs: {', '.join(known) or 'none'}."
        raise refuse(f"the column {unused[0]!r} is not an input of the diagram.", cure)
    return inputs
