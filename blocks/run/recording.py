"""Rows of recorded signals, in memory that grows by chunks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

__all__ = ["Recording"]

Array = np.ndarray[Any, Any]
CHUNK = 4096


class Recording:
    """Times and values of the recorded elements. What was added stays, whatever happens later."""

    def __init__(self, columns: int) -> None:
        self.columns = columns
        self.chunks: list[Array] = []
        self.rows = 0

    @property
    def last(self) -> tuple[float, Sequence[float]]:
        """Time and values of the last row."""
        if not self.rows:
            return math.nan, ()
        t, *values = self.chunks[(self.rows - 1) // CHUNK][(self.rows - 1) % CHUNK].tolist()
        return t, tuple(values)

    def add(self, t: float, values: Sequence[float]) -> None:
        place = self.rows % CHUNK
        if place == 0 and len(self.chunks) * CHUNK == self.rows:
            self.chunks.append(np.empty((CHUNK, 1 + self.columns)))
        row = self.chunks[-1][place]
        row[0] = t
        row[1:] = values
        self.rows += 1  # an interrupt before this leaves no half row

    def arrays(self) -> tuple[Array, Array]:
        """Times (rows,) and values (rows, columns)."""
        if not self.chunks:
            return np.empty(0), np.empty((0, self.columns))
        whole = np.concatenate(self.chunks)[: self.rows]
        return whole[:, 0].copy(), whole[:, 1:].copy()
