"""Rows of runs and of measured signals, on their way to the plots of a page as binary frames.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..text.element_names import element_names

__all__ = ["Curve", "Source", "Window", "elements", "extremes", "firsts", "packed", "values_at"]

Array = np.ndarray[Any, Any]
Reduced = tuple[Array, Array, Array, Array]
"""Times (m,), columns (n, m), and where each bin begins: in the rows, and in these."""
LATE = 2
"""Rows at the end that may still change."""
ROWS = 4
"""Rows of a pixel that are sent as they are."""


class Source(Protocol):
    """Recorded rows: a run, or a file that was measured."""

    @property
    def columns(self) -> Mapping[str, tuple[int, tuple[int, ...], str]]:
        """By signal the first column, shape and unit."""

    def rows(self) -> tuple[Array, Array]:
        """Times (n,) and values (n, columns) up to now; they grow at the end, where the last ones may still change."""


def elements(source: Source) -> dict[str, tuple[int, str]]:
    """The column and the unit of each element that a source has."""
    found: dict[str, tuple[int, str]] = {}
    for name, (first, shape, unit) in source.columns.items():
        found |= {element: (first + k, unit) for k, element in enumerate(element_names(name, shape))}
    return found


def values_at(source: Source, t: float) -> dict[str, Any]:
    """The value of each signal at a time, linear between rows as the plots are, the right one at a jump.

    Of vectors and matrices a flat list. None is a value that is not finite; outside of the rows there is nothing.
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
    told = [value if math.isfinite(value) else None for value in row.tolist()]
    return {
        name: told[first : first + math.prod(shape)] if shape else told[first]
        for name, (first, shape, _) in source.columns.items()
    }


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
    given = kept.sum(axis=1)
    return times, reduced, first, np.cumsum(given) - given


def firsts(t: Array, columns: Sequence[Array], origin: float, step: float) -> Reduced:
    """The first row of each bin, and how many it holds as one column more: events, of which a pixel shows one."""
    first, last = _bins(t, origin, step)
    reduced = np.stack([*(values[first] for values in columns), last - first + 1]).astype(np.float32)
    return t[first], reduced, first, np.arange(len(first))


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
        self.origin, self.done, self.sent = 0.0, 0, 0
        self.mark: tuple[int, bytes, bytes] | None = None

    def frame(self, until: float = math.inf) -> tuple[int, Array, Array] | None:
        """What is new up to a time: `from`, times, columns; None where nothing is."""
        t, values = self.source.rows()
        begin, end = self._rows(t, until)
        mark = (end, t[end - 1 : end].tobytes(), values[end - 1 : end].tobytes())
        if mark == self.mark:
            return None
        self.mark = mark
        many = ROWS * self.window.width
        reduced = end - begin > (many // 2 if self.is_reduced else many) or self.reduce is not extremes
        if self.is_open and end > begin and (not self.extent or t[end - 1] - t[begin] > self.extent):
            self.extent, self.is_begun = 2.0 * float(t[end - 1] - t[begin]), self.is_begun and not reduced
        if not self.is_begun or reduced != self.is_reduced:
            self.is_begun, self.is_reduced, self.done, self.sent = True, reduced, begin, 0
            self.origin = float(t[begin]) if end > begin else 0.0
        since = self.sent
        times, new = t[self.done : end], values[self.done : end]
        columns = [new[:, k] if factor == 1.0 else new[:, k] * factor for k, factor in self.columns]
        final = max(0, len(times) - LATE)
        if not reduced or not len(times):
            with np.errstate(over="ignore"):
                block = np.array(columns, np.float32).reshape(len(columns), len(times))
            self.done, self.sent = self.done + final, self.sent + final
            return since, times, block
        times, block, first, places = self.reduce(times, columns, self.origin, self._step())
        still = int(np.searchsorted(first, final, side="right")) - 1  # this bin may get other rows
        self.done, self.sent = self.done + int(first[still]), self.sent + int(places[still])
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
