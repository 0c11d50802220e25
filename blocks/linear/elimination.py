"""From a diagram's wires to matrices: what lies between the states and the signals is eliminated, sparsely.

    z = N z + R r        outputs and locals by each other, and by states, discretes, delayed values and inputs

Few signals are in algebraic loops: each loop is solved as a small dense system. What is left has no cycles, so that
1 + N + N^2 + ... ends after as many terms as the longest chain of blocks without memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault

MOST_DENSE = 2**18
"""Numbers in a matrix that is kept as an array."""


@dataclass(frozen=True, slots=True)
class Entries:
    """A matrix as (row, column, value), some places more than once. Small pieces of it are made dense."""

    rows: Array
    columns: Array
    values: Array
    size: int

    def reached(
        self, begin: Sequence[int], end: Sequence[int], links: Sequence[tuple[int, int]] = ()
    ) -> tuple[Array, Array]:
        """Which variables change with those at `begin`, and which change those at `end`. links: further entries."""
        more = np.array(links, dtype=np.intp).reshape(-1, 2)
        rows, columns = np.concatenate([self.rows, more[:, 0]]), np.concatenate([self.columns, more[:, 1]])
        live = np.concatenate([self.values != 0, np.ones(len(more), dtype=bool)])
        rows, columns = rows[live], columns[live]
        masks = []
        for first, sources, targets in ((begin, columns, rows), (end, rows, columns)):
            seen = np.zeros(self.size, dtype=bool)
            seen[list(first)] = True
            count = -1
            while count != (count := int(seen.sum())):
                seen[targets[seen[sources]]] = True
            masks.append(seen)
        return masks[0], masks[1]

    def within(self, rows: Sequence[int], columns: Sequence[int]) -> tuple[Array, Array, Array]:
        """Return the numbers of the entries in some rows and columns, and where these have them."""
        row_at, column_at = np.full(self.size, -1, dtype=np.intp), np.full(self.size, -1, dtype=np.intp)
        row_at[rows], column_at[columns] = np.arange(len(rows)), np.arange(len(columns))
        r, c = row_at[self.rows], column_at[self.columns]
        keep = np.flatnonzero((r >= 0) & (c >= 0))
        return keep, r[keep], c[keep]

    def block(self, rows: Sequence[int], columns: Sequence[int]) -> Any:
        """Some rows and columns in an order: an array, or a sparse matrix where they are many."""
        keep, r, c = self.within(rows, columns)
        entries = Entries(r, c, self.values[keep], self.size)
        return entries.matrix((len(rows), len(columns)), is_sparse=len(rows) * len(columns) > MOST_DENSE)

    def matrix(self, shape: tuple[int, int], *, is_sparse: bool) -> Any:
        if is_sparse:
            from scipy import sparse

            return sparse.csr_matrix((self.values, (self.rows, self.columns)), shape=shape)
        dense = np.zeros(shape)
        np.add.at(dense, (self.rows, self.columns), self.values)
        return dense


def eliminated(N: Any, R: Any, name: Callable[[int], str]) -> Any:
    """(1 - N)^-1 R, sparse. Raises AnalysisError (E701) where an algebraic loop has no unique solution here."""
    size = N.shape[0]
    if not size:
        return R
    if isinstance(N, np.ndarray):
        matrix = np.eye(size) - N
        if np.linalg.cond(matrix, 1) > 1e14:
            from scipy import sparse

            eliminated(sparse.csr_matrix(N), sparse.csr_matrix(R), name)  # which names the loop
        return np.linalg.solve(matrix, R)
    from scipy import sparse
    from scipy.sparse import csgraph

    N = sparse.csr_matrix(N)
    N.eliminate_zeros()
    count, label = csgraph.connected_components(N, directed=True, connection="strong")
    sizes = np.bincount(label, minlength=count)
    diagonal = N.diagonal() != 0
    looped = (sizes[label] > 1) | diagonal
    if looped.any():
        N, R = _solved(N, R, label, looped, name)
    X = R = sparse.csr_matrix(R)
    for _ in range(size + 1):
        R = N @ R
        R.eliminate_zeros()
        if R.nnz == 0:
            return X
        X = X + R
    raise AssertionError("what is left of the loops has a cycle")


def reach(N: Any, R: Any, T: Any) -> Any:
    """The absolute terms of the sum T = (1 - N)^-1 R, added up; |T| itself where N has loops."""
    sizes, given = abs(N), abs(R)
    if not N.shape[0]:
        return given
    if not isinstance(N, np.ndarray):
        from scipy.sparse import csgraph

        count = csgraph.connected_components(sizes, connection="strong", return_labels=False)
        if count < N.shape[0] or (sizes.diagonal() != 0).any():
            return abs(T)
        return eliminated(sizes, given, str)
    bound = np.linalg.solve(np.eye(len(sizes)) - sizes, given) if _ends(sizes) else abs(T)
    return np.fmax(bound, abs(T))


def _ends(sizes: Array) -> bool:
    """Whether there is no loop: the rows can be solved one after the other."""
    left = sizes != 0
    alive = np.ones(len(left), dtype=bool)
    while alive.any():
        last = alive & ~left[:, alive].any(axis=1)
        if not last.any():
            return False
        alive &= ~last
    return True


def without_noise(value: Any, bound: Any) -> Any:
    """A sum with 0 where its terms cancel but for rounding: b0 (1/b0) - 1 is no slow pole."""
    least = 8 * float(np.finfo(float).eps) * bound
    if not isinstance(value, np.ndarray):
        from scipy import sparse

        value = sparse.csr_matrix(value)
        value = value.multiply(abs(value) > least).tocsr()
        value.eliminate_zeros()
        return value
    return np.where(np.abs(value) > least, value, 0.0)


def _solved(N: Any, R: Any, label: Array, looped: Array, name: Callable[[int], str]) -> tuple[object, object]:
    """The rows of loops solved for what is outside of them."""
    from scipy import sparse

    members: dict[int, list[int]] = {}
    for i in np.nonzero(looped)[0].tolist():
        members.setdefault(int(label[i]), []).append(i)
    rows, columns, values = [np.nonzero(~looped)[0]], [np.nonzero(~looped)[0]], [np.ones(int((~looped).sum()))]
    coo = N.tocoo()
    inside = (label[coo.row] == label[coo.col]) & looped[coo.row]
    for group in members.values():
        own = N[group][:, group].toarray()
        matrix = np.eye(len(group)) - own
        with np.errstate(all="ignore"):
            bad = not np.isfinite(matrix).all() or np.linalg.cond(matrix) > 1e14
        if bad:
            message = "an algebraic loop through it has no unique solution for small changes at this operating point."
            raise AnalysisError(Fault("E701", name(group[0]), message, "Choose another operating point."))
        inverse = np.linalg.inv(matrix)
        grid = np.meshgrid(group, group, indexing="ij")
        rows.append(grid[0].ravel())
        columns.append(grid[1].ravel())
        values.append(inverse.ravel())
    shape = N.shape
    inverse_ = sparse.csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
    outside = sparse.csr_matrix((coo.data[~inside], (coo.row[~inside], coo.col[~inside])), shape=shape)
    return inverse_ @ outside, inverse_ @ R
