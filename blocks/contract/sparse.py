"""Matrices of which only the elements that are not 0 are kept, in the order of rows and columns."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import Fault, ModelError


class SparseMatrix:
    """A constant matrix by its edges (row, column, value); zeros among the values are left out.

    ends[i] ... ends[i + 1] are the places of row i in columns and values.
    """

    ndim = 2

    def __init__(self, edges: Array, shape: tuple[int, int]) -> None:
        """Raises ModelError (E107) for an edge that lies outside, appears twice, or is no finite number."""
        places = edges[:, :2]
        _refuse_first(edges, ~np.isfinite(edges).all(axis=1), "must have finite numbers.")
        _refuse_first(edges, (places % 1 != 0).any(axis=1), "must begin with two integers, a row and a column.")
        size = f"the matrix is {shape[0]} x {shape[1]}, and indices count from 0."
        _refuse_first(edges, ((places < 0) | (places >= shape)).any(axis=1), f"is outside the matrix: {size}")
        order = np.lexsort((places[:, 1], places[:, 0]))
        sorted_places = places[order].astype(np.int64)
        again = np.zeros(len(edges), dtype=bool)
        again[order[1:]] = (sorted_places[1:] == sorted_places[:-1]).all(axis=1)
        _refuse_first(edges, again, "appears twice.", "Give one edge with the sum of both values.")
        kept = edges[order, 2] != 0
        rows, self.columns = sorted_places[kept].T
        self.values: Array = edges[order, 2][kept]
        self.ends = np.searchsorted(rows, np.arange(shape[0] + 1))
        self.shape = shape

    def __len__(self) -> int:
        return self.shape[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SparseMatrix) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        """Its size, and a digest that tells it from others."""
        digest = hashlib.sha256(b"".join(self._key[1:])).hexdigest()
        return f"{self.shape[0]} x {self.shape[1]} with {len(self.values)} elements, {digest[:12]}"

    @property
    def _key(self) -> tuple[Any, ...]:
        return self.shape, self.ends.tobytes(), self.columns.tobytes(), self.values.tobytes()

    def scaled(self, values: Array) -> SparseMatrix:
        """The same places with other values."""
        other = object.__new__(SparseMatrix)
        other.shape, other.ends, other.columns, other.values = self.shape, self.ends, self.columns, values
        return other

    def dense(self) -> Array:
        """All elements, zeros too."""
        whole = np.zeros(self.shape)
        whole[np.repeat(np.arange(self.shape[0]), np.diff(self.ends)), self.columns] = self.values
        return whole

    def rows(self) -> Iterator[tuple[list[int], list[float]]]:
        """The columns and the values of each row."""
        columns, values, ends = self.columns.tolist(), self.values.tolist(), self.ends.tolist()
        for first, end in pairwise(ends):
            yield columns[first:end], values[first:end]


def edges_of(matrix: Any) -> dict[str, object]:
    """A matrix of scipy.sparse as a diagram file holds it; duplicates are added up, as they mean there."""
    whole = matrix.tocsr().copy()
    whole.sum_duplicates()
    coo = whole.tocoo()
    edges = zip(coo.row.tolist(), coo.col.tolist(), coo.data.astype(float).tolist(), strict=True)
    return {"edges": [list(edge) for edge in edges], "shape": [int(size) for size in matrix.shape]}


def _refuse_first(edges: Array, wrong: Any, message: str, cure: str = "") -> None:
    if wrong.any():
        row, column, value = edges[int(np.argmax(wrong))].tolist()
        shown = f"[{row:.15g}, {column:.15g}, {value:.15g}]"
        raise ModelError(Fault("E107", "", f"the edge {shown} (number {int(np.argmax(wrong))}) {message}", cure))
