"""Scopes: rows of runs and of measured signals, on their way to the plots of a page as binary frames.

A frame holds, little-endian: the length of its header (u32), the header in JSON, padded with spaces so that what
follows lies at a multiple of 8, the times in s (float64; float32 would fail near 1e4 s), and a column of float32 for
each signal of the header. Rows `from` on of what the page has of this curve are replaced; `from` = 0 begins it anew.

Where a window holds more than 4 rows a pixel, each half of a pixel gives two rows: the least and the largest value of
each signal, in the order in which they come, so that a peak of a single row is seen. Only rows since the last frame are
looked at, whatever the run has recorded before.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ..text import units
from ..text.element_names import element_names
from ..text.errors import BlocksError, Fault, UsageError

__all__ = ["Curve", "EventRows", "Page", "Scope", "Source", "Window", "extremes", "firsts", "packed", "values_at"]

Array = np.ndarray[Any, Any]
Reduced = tuple[Array, Array, int, int]
"""Times (m,), columns (n, m), and where the last bin begins: in the rows, and in what it gives."""
ROWS = 4
"""Rows of a pixel that are sent as they are."""
MOST_SIGNALS, MOST_SCOPES = 64, 32


class Source(Protocol):
    """Recorded rows: a run, or a file that was measured."""

    @property
    def columns(self) -> Mapping[str, tuple[int, tuple[int, ...], str]]:
        """By signal the first column, shape and unit."""

    def rows(self) -> tuple[Array, Array]:
        """Times (n,) and values (n, columns) up to now; they grow at the end only."""


def elements(source: Source) -> dict[str, tuple[int, str]]:
    """The column and the unit of each element that a source has."""
    found: dict[str, tuple[int, str]] = {}
    for name, (first, shape, unit) in source.columns.items():
        found |= {element: (first + k, unit) for k, element in enumerate(element_names(name, shape))}
    return found


def values_at(source: Source, t: float) -> dict[str, float | None]:
    """The value of each element at a time, linear between rows as the plots are, the right one at a jump.

    None is a value that is not finite; outside of the rows there is nothing.
    """
    times, values = source.rows()
    after = int(np.searchsorted(times, t, side="right"))
    if after == 0 or (after == len(times) and times[-1] < t):
        return {}
    row = values[after - 1]
    if times[after - 1] < t:
        share = (t - times[after - 1]) / (times[after] - times[after - 1])
        with np.errstate(invalid="ignore", over="ignore"):
            row = (1.0 - share) * row + share * values[after]
    return {name: float(row[k]) if np.isfinite(row[k]) else None for name, (k, _) in elements(source).items()}


# --- fewer rows ------------------------------------------------------------------------------------------------------


def _bins(t: Array, origin: float, step: float) -> tuple[Array, Array]:
    """The first and the last row of each bin: of the rows with one floor((t - origin) / step)."""
    first = np.flatnonzero(np.diff(np.floor((t - origin) / step), prepend=np.nan) != 0)
    return first, np.append(first[1:], len(t)) - 1


def extremes(t: Array, columns: Sequence[Array], origin: float, step: float) -> Reduced:
    """The least and the largest value of each bin, in the order in which they come, at its first and last time.

    NaN counts only where a bin holds nothing else. A bin of one row gives that row.
    """
    first, last = _bins(t, origin, step)
    kept = np.column_stack([np.ones(len(first), bool), last > first])
    times = t[np.column_stack([first, last])[kept]]
    reduced = np.empty((len(columns), len(times)), np.float32)
    place = np.arange(len(t))
    for k, values in enumerate(columns):
        found = []
        with np.errstate(invalid="ignore", over="ignore"):  # NaN; what is infinite in float32
            for extreme in (np.fmin, np.fmax):
                ends = extreme.reduceat(values, first)
                where = np.where(values == np.repeat(ends, last - first + 1), place, len(t))
                found.append((ends, np.minimum.reduceat(where, first)))
            (low, at_low), (high, at_high) = found
            pair = np.where((at_low <= at_high)[:, None], np.column_stack([low, high]), np.column_stack([high, low]))
            reduced[k] = pair[kept]
    return times, reduced, int(first[-1]), len(times) - int(kept[-1].sum())


def firsts(t: Array, columns: Sequence[Array], origin: float, step: float) -> Reduced:
    """The first row of each bin, and how many it holds as one column more: events, of which a pixel shows one."""
    first, last = _bins(t, origin, step)
    reduced = np.stack([*(values[first] for values in columns), last - first + 1]).astype(np.float32)
    return t[first], reduced, int(first[-1]), len(first) - 1


# --- frames ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Window:
    """What a scope shows, in s: t0 ... t1, or the last `span`, or all. width: pixels."""

    width: int
    t0: float | None = None
    t1: float | None = None
    span: float | None = None


class Curve:
    """Rows of one source on their way to one scope, which go on where they ended.

    columns: those of the source, each with a factor. extent: how long the whole may become, in s, where that is known.
    """

    def __init__(
        self,
        source: Source,
        columns: Sequence[tuple[int, float]],
        window: Window,
        extent: float | None = None,
        reduce: Callable[[Array, Sequence[Array], float, float], Reduced] = extremes,
    ) -> None:
        self.source, self.columns, self.window, self.reduce = source, columns, window, reduce
        given = window.span if window.t0 is None or window.t1 is None else window.t1 - window.t0
        self.extent = extent if given is None else given
        self.is_open = given is None and extent is None
        self.is_begun = self.is_reduced = False
        self.origin, self.done, self.end, self.sent = 0.0, 0, 0, 0

    def frame(self, until: float = math.inf) -> tuple[int, Array, Array] | None:
        """What is new up to a time: `from`, times, columns; None where nothing is."""
        t, values = self.source.rows()
        begin, end = self._rows(t, until)
        if end <= self.end and self.is_begun:
            return None
        many = ROWS * self.window.width
        reduced = end - begin > (many // 2 if self.is_reduced else many) or self.reduce is not extremes
        if self.is_open and end > begin and (not self.extent or t[end - 1] - t[begin] > self.extent):
            self.extent, self.is_begun = 2.0 * float(t[end - 1] - t[begin]), self.is_begun and not reduced
        if not self.is_begun or reduced != self.is_reduced:
            self.is_begun, self.is_reduced, self.done, self.sent = True, reduced, begin, 0
            self.origin = float(t[begin]) if end > begin else 0.0
        since, self.end = self.sent, end
        times, new = t[self.done : end], values[self.done : end]
        columns = [new[:, k] if factor == 1.0 else new[:, k] * factor for k, factor in self.columns]
        if not reduced or end == self.done:
            with np.errstate(over="ignore"):
                block = np.array(columns, np.float32).reshape(len(columns), end - self.done)
            self.done, self.sent = end, self.sent + end - self.done
            return since, times, block
        times, block, open_row, final = self.reduce(times, columns, self.origin, self._step())
        self.done, self.sent = self.done + open_row, self.sent + final
        return since, times, block

    def _step(self) -> float:
        """The length of a bin in s: half a pixel."""
        return (self.extent or 1.0) / (2 * self.window.width)

    def _rows(self, t: Array, until: float) -> tuple[int, int]:
        """The rows of the window, with one more on each side, to which lines lead."""
        window = self.window
        begin, last = -math.inf, until if window.t1 is None else min(until, window.t1)
        if window.t0 is not None:
            begin = window.t0
        elif window.span is not None and len(t):
            begin = min(float(t[-1]), last) - window.span
        first, after = np.searchsorted(t, begin, side="left") - 1, np.searchsorted(t, last, side="right") + 1
        return max(int(first), 0), min(int(after), len(t))


def packed(header: Mapping[str, Any], t: Array, columns: Array) -> bytes:
    """A frame."""
    text = json.dumps({**header, "count": len(t)}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 8)
    body = np.ascontiguousarray(t, "<f8").tobytes() + np.ascontiguousarray(columns, "<f4").tobytes()
    return len(text).to_bytes(4, "little") + text + body


# --- the scopes of a page --------------------------------------------------------------------------------------------


class EventRows:
    """Events of a run as a source: the time of each, and the number of what it is among `told`."""

    columns: Mapping[str, tuple[int, tuple[int, ...], str]] = {"events": (0, (), "")}

    def __init__(self) -> None:
        self.told: dict[tuple[str, str], int] = {}
        self._t, self._causes, self.count = np.empty(64), np.empty((64, 1)), 0

    def add(self, events: Sequence[Any]) -> None:
        """events: with t, block and what."""
        need = self.count + len(events)
        if need > len(self._t):
            more = max(need, 2 * len(self._t)) - len(self._t)
            self._t = np.append(self._t, np.empty(more))
            self._causes = np.append(self._causes, np.empty((more, 1)), axis=0)
        for k, event in enumerate(events, self.count):
            self._t[k] = event.t
            self._causes[k] = self.told.setdefault((event.block, event.what), len(self.told))
        self.count = need

    def rows(self) -> tuple[Array, Array]:
        return self._t[: self.count], self._causes[: self.count]


@dataclass
class Scope:
    """A plot of a page. signals: names of signals, of their elements, and `FILE|COLUMN` of measured ones."""

    name: str
    signals: Sequence[str]
    window: Window
    curves: dict[tuple[str, Any], tuple[Curve, dict[str, Any]]] = field(default_factory=dict)


class Live(Source, Protocol):
    """A run under way, or one that was."""

    @property
    def t(self) -> float: ...

    def events(self, since: int) -> Sequence[Any]: ...


class Page:
    """The scopes of one page, over the run and what else is shown: earlier runs by number, measured files by name."""

    def __init__(self) -> None:
        self.scopes: dict[str, Scope] = {}
        self.ghosts: dict[int, Source] = {}
        self.files: dict[str, Source] = {}
        self.number, self.events = 0, EventRows()
        self.live: Live | None = None
        self.start: float = 0.0
        self.stop: float | None = None
        self.is_ready = True
        """Whether the page has drawn what it got: nothing is sent to one that cannot keep up, or is hidden."""

    def begin(self, number: int, live: Live | None, start: float, stop: float | None) -> None:
        """Show another run."""
        self.number, self.live, self.start, self.stop, self.events = number, live, start, stop, EventRows()
        self.refresh()

    def open(self, scope: Scope) -> None:
        """Open a scope, or change it. Raises UsageError (E501), and E505 where units do not fit."""
        if len(self.scopes) >= MOST_SCOPES and scope.name not in self.scopes:
            raise UsageError(Fault("E501", "scope", f"more than {MOST_SCOPES} scopes cannot be open.", "Close some."))
        window = scope.window
        if window.t0 is not None and window.t1 is not None and not window.t0 < window.t1:
            raise UsageError(Fault("E501", "scope", f"{window.t0:g} ... {window.t1:g} s is no span of time."))
        if window.span is not None and not window.span > 0.0:
            raise UsageError(Fault("E501", "scope.span", f"must be positive, not {window.span:g} s."))
        self._fill(scope)
        self.scopes[scope.name] = scope

    def refresh(self) -> None:
        """Begin all curves anew: the run, the ghosts or the files are others."""
        for scope in self.scopes.values():
            self._fill(scope)

    def frames(self) -> Iterator[bytes]:
        """What is new in all scopes."""
        if self.live is not None:
            self.events.add(self.live.events(self.events.count))
        reached = math.inf if self.live is None else self.live.t
        for scope in self.scopes.values():
            follows = scope.window.span is not None and scope.window.t0 is None
            for (kind, _), (curve, header) in scope.curves.items():
                new = curve.frame(reached if follows and kind else math.inf)
                if new is not None:
                    since, t, block = new
                    told: dict[str, Any] = {"events": [*self.events.told]} if kind == "events" else {}
                    told |= {"scope": scope.name, "run": self.number, "kind": "append" if since else "replace"}
                    yield packed({**told, "from": since, **header}, t, block)

    def _fill(self, scope: Scope) -> None:
        """The curves of a scope. Raises UsageError (E501, E505)."""
        curves: dict[tuple[str, Any], tuple[Curve, dict[str, Any]]] = {}
        extent = None if self.stop is None else self.stop - self.start
        own: dict[str, str] = {}  # the units that the scope has, by signal
        if self.live is not None:
            own = self._units(scope, self.live)
            curves["", 0] = self._curve(scope, self.live, own, {}, extent)
        for number, ghost in self.ghosts.items():
            shown = own or self._units(scope, ghost)
            curves["ghost", number] = self._curve(scope, ghost, shown, {"ghost": number}, extent)
        for name, measured in self.files.items():
            wanted = self._measured(scope, name, measured, own)
            if wanted:
                curves["overlay", name] = self._curve(scope, measured, wanted, {"overlay": name}, extent)
        if self.live is not None:
            curve = Curve(self.events, [(0, 1.0)], scope.window, extent, firsts)
            curves["events", 0] = (curve, {"signals": ["cause", "count"], "units": ["", ""]})
        scope.curves = curves

    def _units(self, scope: Scope, source: Source) -> dict[str, str]:
        """The elements of a scope that a run has, with their units; vectors by all of their elements."""
        known, found = elements(source), dict[str, str]()
        for name in scope.signals:
            shape = source.columns[name][1] if name in source.columns else ()
            found |= {each: known[each][1] for each in element_names(name, shape) if each in known}
        if len(found) > MOST_SIGNALS:
            message = f"{len(found)} signals are more than {MOST_SIGNALS} in one scope."
            raise UsageError(Fault("E501", "scope", message, "Open another one for some of them."))
        return found

    def _measured(self, scope: Scope, name: str, file: Source, own: Mapping[str, str]) -> dict[str, str]:
        """The columns of a measured file that a scope shows, each with the unit in which it does.

        Those of the names of its signals, and those that it names; in a unit of the scope, where one fits.
        """
        wanted: dict[str, str] = {}
        for column, (_, unit) in elements(file).items():
            if column in own:
                if unit and own[column] and not _fits(unit, own[column]):
                    message = f"is in {own[column]}, and in {unit} in {name}, which are different quantities."
                    raise UsageError(Fault("E505", column, message, "Mend the unit in the head of its column."))
                wanted[column] = own[column] or unit
            elif f"{name}|{column}" in scope.signals:
                wanted[column] = next((have for have in own.values() if unit and have and _fits(unit, have)), unit)
        return wanted

    def _curve(
        self, scope: Scope, source: Source, wanted: Mapping[str, str], header: Mapping[str, Any], extent: float | None
    ) -> tuple[Curve, dict[str, Any]]:
        """The curve of those elements of a source that are wanted in units that fit, and what its header says."""
        known = elements(source)
        picked = {name: unit for name, unit in wanted.items() if name in known and _fits(known[name][1], unit)}
        columns = [(known[name][0], units.scale(known[name][1], unit)) for name, unit in picked.items()]
        told = {**header, "signals": [*picked], "units": [*picked.values()]}
        return Curve(source, columns, scope.window, extent), told


def _fits(a: str, b: str) -> bool:
    try:
        return units.same_quantity(a, b)
    except BlocksError:  # a unit that cannot be read is equal to itself only
        return a == b
