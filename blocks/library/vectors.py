"""Blocks over vectors of any length: what a group has in common, and couplings that change."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Input, Parameter
from .logic import Multiport, chosen_of

__all__ = ["Reduction", "SwitchedMatrixGain"]


class Reduction(Block, apart="reduction"):
    """y = the mean, the sum, the least, the largest or the deviation of the elements of a vector.

    "deviation": sqrt(mean((u - mean(u))^2)), the disagreement of a group, which is 0 if all agree.

    Sums go from u[0] on. When another element becomes the largest or the least, the slope jumps, and the slope of the
    deviation jumps at 0. These corners are not located (MinMax locates them for up to 16 scalars).
    """

    kind = Parameter("mean", structural=True, choices=("mean", "sum", "min", "max", "deviation"), doc="reduction")
    size = Parameter(2, structural=True, type="int", min=1, doc="number of elements")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    u = Input(shape=lambda size: size, unit=unit, doc="vector")

    @output(unit=unit, doc="reduction of the input")
    def y(u, kind, size):
        if kind in ("min", "max"):
            return np.min(u) if kind == "min" else np.max(u)
        if kind == "deviation":
            return np.sqrt(np.sum((u - np.sum(u) / size) ** 2) / size)
        return np.sum(u) / size if kind == "mean" else np.sum(u)


class SwitchedMatrixGain(Multiport, apart="gains"):
    """y = K1 u if index is 1, K2 u if it is 2, ...: the matrix whose number is nearest to index.

    K holds the matrices, all of one shape, one below the other: K1 is its first rows. As for MatrixGain, zeros of K fix
    the type, all u have one unit and so have all y, and you can give a large K by its edges; for a topology that
    changes, use scipy.sparse.vstack([K1, K2]) in Python. The cost is then proportional to the number of edges that any
    of the matrices has. The instants at which y changes are located, as for MultiportSwitch.
    """

    size = Parameter(2, structural=True, type="int", min=1, doc="number of matrices to choose from")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    K = Parameter(
        [[1.0], [0.0]],
        shape=("rows", "m"),
        zeros=True,
        sparse=True,
        unit=unit / unit_u,
        doc="matrices, stacked",
    )
    u = Input(shape=lambda m: m, unit=unit_u, doc="inputs")
    index = Input(doc="number of the chosen matrix, from 1 on")
    chosen = Multiport.chosen

    @requires("the rows of K must be those of `size` matrices of one shape")
    def is_even(rows, size):
        return rows % size == 0

    @output(shape=lambda rows, size: rows // size, unit=unit, doc="the chosen matrix times the inputs")
    def y(u, K, chosen, rows, size):
        p = rows // size
        return chosen_of([K[k * p : (k + 1) * p] @ u for k in range(size)], chosen)
