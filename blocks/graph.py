"""Graphs as sparse matrices: what MatrixGain takes to couple many blocks.

    coupling = MatrixGain(K=-graph.laplacian(graph.ring(100)))

An adjacency has the weight with which vertex i listens to vertex j in row i and column j. All are arrays of
scipy.sparse, so that they can be scaled, added, transposed and put one below another.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .text.errors import Fault, ModelError

__all__ = ["grid", "laplacian", "line", "random_geometric", "ring"]


def line(n: int, *, directed: bool = False) -> Any:
    """Vertices in a row, each with its neighbors; directed: each listens to the one before it only."""
    _check(n >= 1, f"a line has 1 vertex at least, not {n}.")
    i = np.arange(n - 1)
    return _adjacency(n, np.column_stack([i, i + 1]), directed=directed)


def ring(n: int, *, directed: bool = False) -> Any:
    """Vertices in a circle, each with both neighbors; directed: each listens to the one before it only."""
    _check(n >= 3, f"a ring has 3 vertices at least, not {n}.")
    i = np.arange(n)
    return _adjacency(n, np.column_stack([i, (i + 1) % n]), directed=directed)


def grid(rows: int, columns: int) -> Any:
    """Vertices in rows, row by row, each with its neighbors to the left and right, above and below."""
    _check(rows >= 1 and columns >= 1, f"a grid has 1 row and 1 column at least, not {rows} and {columns}.")
    number = np.arange(rows * columns).reshape(rows, columns)
    across = np.column_stack([number[:, :-1].ravel(), number[:, 1:].ravel()])
    down = np.column_stack([number[:-1].ravel(), number[1:].ravel()])
    return _adjacency(rows * columns, np.concatenate([across, down]))


def random_geometric(n: int, radius: float, *, seed: int) -> Any:
    """Vertices at random places in the unit square; those not farther apart than radius are neighbors."""
    from scipy.spatial import cKDTree

    _check(n >= 1 and radius > 0, f"needs 1 vertex at least and a radius above 0, not {n} and {radius}.")
    places = np.random.default_rng(seed).uniform(size=(n, 2))
    return _adjacency(n, cKDTree(places).query_pairs(radius, output_type="ndarray"))


def laplacian(adjacency: Any) -> Any:
    """L = D - A, where D holds the sums of the rows of A: (L x)_i = sum over j of A_ij (x_i - x_j)."""
    from scipy.sparse import csr_array, diags_array

    matrix = csr_array(adjacency, dtype=float)
    square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1]
    _check(square, f"an adjacency is square, not of the shape {matrix.shape}.")
    _check(np.isfinite(matrix.data).all(), "an adjacency has finite weights.")
    return csr_array(diags_array(matrix.sum(axis=1)) - matrix)


def _adjacency(n: int, pairs: Any, *, directed: bool = False) -> Any:
    """1 where the second of a pair listens to the first, and the other way round unless it is directed."""
    from scipy.sparse import csr_array

    both = pairs if directed else np.concatenate([pairs, pairs[:, ::-1]])
    return csr_array((np.ones(len(both)), (both[:, 1], both[:, 0])), shape=(n, n))


def _check(holds: Any, message: str) -> None:
    if not holds:
        raise ModelError(Fault("E110", "graph", message, ""))
