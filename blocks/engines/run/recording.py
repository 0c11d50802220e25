"""Rows of recorded signals, in memory that grows by chunks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["Recording"]

Array = np.ndarray[Any, Any]
CHUNK = 4096  # rows
MOST_BYTES = 2**24  # of a chunk


class Recording:
    """Times and values of the recorded elements. What was added stays, whatever happens later."""

    def __init__(self, columns: int) -> None:
        self.columns = columns
        self.chunks: list[Array] = []
        self.rows = 0
        self.chunk = max(1, min(CHUNK, MOST_BYTES // (8 * (1 + columns))))

    @property
    def bytes(self) -> float:
        """What the rows take."""
        return 8.0 * self.rows * (1 + self.columns)

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

    def arrays(self) -> tuple[Array, Array]:
        """Times (rows,) and values (rows, columns)."""
        t, values = np.empty(self.rows), np.empty((self.rows, self.columns))
        for first, chunk in zip(range(0, self.rows, self.chunk), self.chunks, strict=False):
            rows = slice(first, min(first + self.chunk, self.rows))
            t[rows], values[rows] = chunk[: rows.stop - first, 0], chunk[: rows.stop - first, 1:]
        return t, values
