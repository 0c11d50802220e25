"""From a diagram's wires to matrices: what lies between the states and the signals is eliminated, sparsely.

    z = N z + R r        outputs and locals by each other, and by states, discretes, delayed values and inputs

Few signals are in algebraic loops: each loop is solved as a small dense system. What is left has no cycles, so that
1 + N + N^2 + ... ends after as many terms as the longest chain of blocks without memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from ..errors import AnalysisError, Fault

__all__ = ["eliminated", "reached"]

Array = np.ndarray[Any, Any]


def reached(pattern: Any, begin: Sequence[int]) -> Array:
    """Which nodes there are paths to. pattern: sparse, (from, to)."""
    n = pattern.shape[0]
    made = np.zeros(n, dtype=bool)
    if not len(begin):
        return made
    first = sparse.csr_matrix((np.ones(len(begin)), (np.zeros(len(begin), dtype=int), list(begin))), shape=(1, n))
    whole = sparse.bmat([[pattern, None], [first, sparse.csr_matrix((1, 1))]], format="csr")
    order = csgraph.breadth_first_order(whole, n, directed=True, return_predecessors=False)
    made[order[order < n]] = True
    return made


def eliminated(N: Any, R: Any, name: Callable[[int], str]) -> Any:
    """(1 - N)^-1 R, sparse. Raises AnalysisError (E701) where an algebraic loop has no one solution here."""
    size = N.shape[0]
    if not size:
        return R
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


def _solved(N: Any, R: Any, label: Array, looped: Array, name: Callable[[int], str]) -> tuple[Any, Any]:
    """The rows of loops solved for what is outside of them."""
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
            message = "an algebraic loop through it has no one solution for small changes here."
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
