"""Blocks over vectors of any length: what a group has in common, and couplings that change."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Input, Parameter
from .logic import Multiport, chosen_of

__all__ = ["Reduction", "SwitchedMatrixGain"]


class Reduction(Block):
    """y = what the elements of a vector have in common: their mean, sum, least or largest, or their deviation.

    "deviation": sqrt(mean((u - mean(u))^2)), the disagreement of a group, which is 0 where all agree.

    Sums go from u[0] on. Where another element takes the lead the slope jumps, and so does that of the deviation at 0:
    these corners are not located (MinMax does it for up to 16 scalars).
    """

    kind = Parameter("mean", structural=True, choices=("mean", "sum", "min", "max", "deviation"), doc="what y is")
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


class SwitchedMatrixGain(Multiport):
    """y = K1 u where index is 1, K2 u where it is 2, ...: the matrix whose number is nearest to index.

    K holds the matrices, all of one shape, one below the other: K1 is its first rows. As MatrixGain has it, zeros of K
    fix the type, all u have one unit and so have all y, and a large K is given by its edges; for a topology that
    changes they are in Python scipy.sparse.vstack([K1, K2]). The cost is then in proportion to the edges that stand in
    any of the matrices. Where y changes is located, as by MultiportSwitch.
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
    index = Input(doc="number of the matrix that counts, from 1 on")
    chosen = Multiport.chosen

    @requires("the rows of K must be those of `size` matrices of one shape")
    def is_even(rows, size):
        return rows % size == 0

    @output(shape=lambda rows, size: rows // size, unit=unit, doc="the chosen matrix times the inputs")
    def y(u, K, chosen, rows, size):
        p = rows // size
        return chosen_of([K[k * p : (k + 1) * p] @ u for k in range(size)], chosen)
