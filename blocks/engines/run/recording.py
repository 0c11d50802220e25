"""Rows of recorded signals, in memory that grows by chunks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...fmi.patience import patient
from ...text.arrays import Array

CHUNK = 4096  # rows
MOST_BYTES = 2**24  # of a chunk


class Recording:
    """Times and values of the recorded elements. What was added stays, whatever happens later."""

    def __init__(self, columns: int) -> None:
        self.columns = columns
        self.chunks: list[Array] = []
        self.rows = 0
        self.whole: Array | None = None  # rows that results have; the last one is the first one here
        self.chunk = max(1, min(CHUNK, MOST_BYTES // (8 * (1 + columns))))

    @property
    def bytes(self) -> float:
        """What the rows take."""
        return 8.0 * (self.rows + (0 if self.whole is None else len(self.whole) - 1)) * (1 + self.columns)

    @property
    def last(self) -> tuple[float, Sequence[float]]:
        """Time and values of the last row."""
        if not self.rows:
            return math.nan, ()
        t, *values = self.chunks[(self.rows - 1) // self.chunk][(self.rows - 1) % self.chunk].tolist()
        return t, tuple(values)

    def add(self, t: float, values: Sequence[float]) -> None:
        place = self.rows % self.chunk
        if place == 0 and len(self.chunks) * self.chunk == self.rows:
            self.chunks.append(np.empty((self.chunk, 1 + self.columns)))
        row = self.chunks[-1][place]
        row[0] = t
        row[1:] = values
        self.rows += 1  # an interrupt before this leaves no half row

    def replace_last(self, values: Sequence[float]) -> None:
        """Other values at the time of the last row."""
        self.chunks[(self.rows - 1) // self.chunk][(self.rows - 1) % self.chunk, 1:] = values

    def cut(self, t: float) -> None:
        """Take out the rows after t."""
        while self.rows and self.last[0] > t:
            self.rows -= 1
        if not self.rows and self.whole is not None:
            self.whole = self.whole[: np.searchsorted(self.whole[:, 0], t, side="right")]
            self._keep_last(self.whole)

    def taken(self) -> Array:
        """All rows, (rows, 1 + columns), which are here no longer, but for the last one, which may still change."""
        with patient() as look_up:
            moved = self._moved()
            rows = moved if self.whole is None else np.concatenate([self.whole[:-1], moved])
            self.whole = None
        look_up()
        return rows

    def _moved(self) -> Array:
        """The rows of all chunks; the last one is the first one of a new chunk then."""
        whole, first = np.empty((self.rows, 1 + self.columns)), 0
        chunks, self.chunks = self.chunks[::-1], []
        while chunks:  # each is freed when it is copied: hardly any row appears twice
            chunk = chunks.pop()[: self.rows - first]
            whole[first : first + len(chunk)] = chunk
            first += len(chunk)
        self.rows = 0
        self._keep_last(whole)
        return whole

    def _keep_last(self, whole: Array) -> None:
        for t, *values in whole[-1:].tolist():
            self.add(t, values)

    def arrays(self) -> tuple[Array, Array]:
        """Times (rows,) and values (rows, columns)."""
        if self.rows > self.chunk:
            with patient() as look_up:
                taken = self._moved()
                self.whole = taken if self.whole is None else np.concatenate([self.whole[:-1], taken])
            look_up()
            return self.whole[:, 0], self.whole[:, 1:]
        rows = self.chunks[0][: self.rows].copy() if self.rows else np.empty((0, 1 + self.columns))
        if self.whole is not None:
            is_same = len(rows) == 1 and rows[0].tobytes() == self.whole[-1].tobytes()
            rows = self.whole if is_same else np.concatenate([self.whole[:-1], rows])
        return rows[:, 0], rows[:, 1:]
