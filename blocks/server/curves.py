"""Rows of runs and of measured signals, on their way to the plots of a page as binary frames.

A frame holds, little-endian: the length of its header (u32), the header in JSON, padded with spaces so that what
follows lies at a multiple of 8, the times in s (float64; float32 would fail near 1e4 s), and a column of float32 for
each signal of the header. It is the whole curve: a page that is too slow misses frames and no rows.

Rows are told by bins of at most a pixel: each gives two rows, the least and the largest value of each signal, so that a
peak of a single row is seen; the rows of a bin that has no more are these two. The length of a bin is a power of two,
and bins begin at its multiples. So a frame needs to look at the rows since the last one alone, whatever was recorded
before, until a curve is twice as long: then the bins are others, and all of it is told anew.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..text.arrays import Array
from ..text.element_names import element_names

LATE = 2
"""Rows at the end that may still change."""
SHORTEST = 1e-300
"""The length of a bin in s is not 0."""


class Source(Protocol):
    """Recorded rows: a run, its events, or a file that was measured."""

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


def row_at(source: Source, t: float) -> list[float | None] | None:
    """The columns at a time, linear between rows as the plots are, the right ones at a jump; None outside of the rows.

    None in it is a value that is not finite.
    """
    times, values = source.rows()
    after = int(np.searchsorted(times, t, side="right"))
    if after == 0 or (after == len(times) and times[-1] < t):
        return None
    row = values[after - 1]
    if times[after - 1] < t:
        share = (t - times[after - 1]) / (times[after] - times[after - 1])
        with np.errstate(invalid="ignore", over="ignore"):
            row = (1.0 - share) * row + share * values[after]
    return [value if math.isfinite(value) else None for value in row.tolist()]


def values_at(source: Source, t: float) -> dict[str, object]:
    """The value of each signal at a time, as `row_at` has it; of vectors and matrices a flat list."""
    told = row_at(source, t)
    return {} if told is None else {
        name: told[first : first + math.prod(shape)] if shape else told[first]
        for name, (first, shape, _) in source.columns.items()
    }


def extremes(t: Array, columns: Sequence[Array], step: float, origin: float = 0.0) -> tuple[Array, Array, Array]:
    """The least and the largest value of each bin, at its first and its last time; and the first row of each bin.

    A bin: the rows with one floor((t - origin) / step). The order of the two is that of the first and the last value. A
    bin of one row gives that row. NaN counts only where a bin holds nothing else. The last row is the last of all.
    """
    with np.errstate(invalid="ignore", over="ignore"):  # NaN; what is infinite in float32
        first = np.flatnonzero(np.diff(np.floor((t - origin) / step), prepend=np.nan) != 0)
        last = np.append(first[1:], len(t))[: len(first)] - 1
        kept = np.column_stack([np.ones(len(first), bool), last > first])
        reduced = np.empty((len(columns), np.count_nonzero(kept)), np.float32)
        for k, values in enumerate(columns):
            ends = np.column_stack([reduce.reduceat(values, first) for reduce in (np.fmin, np.fmax)])
            falls = values[first] > values[last]
            ends[falls] = ends[falls, ::-1]
            reduced[k] = ends[kept]
        times = t[np.column_stack([first, last])[kept]]
        if len(t) and last[-1] > first[-1] + 1:
            times = np.append(times, t[-1])
            reduced = np.column_stack([reduced, np.array([values[-1] for values in columns], np.float32)])
    return times, reduced, first


@dataclass(frozen=True, kw_only=True)
class Window:
    """What a scope shows, in s: t0 ... t1, or the last `span`, or all. width: pixels."""

    width: int
    t0: float | None = None
    t1: float | None = None
    span: float | None = None

    @property
    def length(self) -> float | None:
        """In s; None: all."""
        return self.span if self.t0 is None or self.t1 is None else self.t1 - self.t0

    def rows(self, t: Array, until: float) -> tuple[int, int]:
        """Which rows it shows, with one more on each side, to which lines lead."""
        begin, end = -math.inf if self.t0 is None else self.t0, until if self.t1 is None else min(until, self.t1)
        if self.t0 is None and self.span is not None and len(t):
            begin = min(float(t[-1]), end) - self.span
        first, after = np.searchsorted(t, begin, side="left") - 1, np.searchsorted(t, end, side="right") + 1
        return max(int(first), 0), min(int(after), len(t))


class Curve:
    """Rows of one source on their way to one scope.

    columns: those of the source, each with a factor. header: what its frames say besides the rows. step, done, t and
    block: the length of a bin, the rows that are in bins for good, and what was made of them.
    """

    def __init__(
        self, source: Source, columns: Sequence[tuple[int, float]], window: Window, header: Mapping[str, object]
    ) -> None:
        self.source, self.columns, self.window, self.header = source, columns, window, header
        self.step, self.done = 0.0, 0
        self.t, self.block = np.empty(0), np.empty((len(columns), 0), np.float32)
        self.mark: tuple[int, bytes, bytes] | None = None

    def frame(self, until: float = math.inf) -> bytes | None:
        """The curve up to a time; None where it is as it was."""
        t, values = self.source.rows()
        begin, end = self.window.rows(t, until)
        mark = (end, t[end - 1 : end].tobytes(), values[end - 1 : end].tobytes())
        if mark == self.mark:
            return None
        self.mark = mark
        if end > begin:
            length = self.window.length or float(t[end - 1] - t[begin])
            step = 2.0 ** math.floor(math.log2(max(length / self.window.width, SHORTEST)))
            self.step, self.done = step, max(begin, self.done if step == self.step else 0)
            new = values[self.done : end]
            columns = [new[:, k] if factor == 1.0 else new[:, k] * factor for k, factor in self.columns]
            times, block, firsts = extremes(t[self.done : end], columns, step)
            kept = slice(*np.searchsorted(self.t, [t[begin], t[self.done]]))
            self.t, self.block = np.append(self.t[kept], times), np.append(self.block[:, kept], block, axis=1)
            # A bin that may get other rows is looked at again.
            self.done += int(firsts[np.searchsorted(firsts, max(0, len(new) - LATE), side="right") - 1])
        return packed(self.header, self.t, self.block)


def packed(header: Mapping[str, object], t: Array, columns: Array) -> bytes:
    """A frame."""
    text = json.dumps({**header, "count": len(t)}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 8)
    body = np.ascontiguousarray(t, "<f8").tobytes() + np.ascontiguousarray(columns, "<f4").tobytes()
    return len(text).to_bytes(4, "little") + text + body


def thinned(t: Array, values: Array, most: int) -> tuple[Array, Array]:
    """At most some `most` rows: of more, the least and the largest value of each column in each stretch of time."""
    if len(t) <= most:
        return t, values
    times, columns, _ = extremes(t, list(values.T), 2.0 * float(t[-1] - t[0]) / most, float(t[0]))
    return times, columns.T
