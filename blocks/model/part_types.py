"""The parts of blocks that are taken apart (see `parts`), and what is left of these, by their `apart`.

They are put in by `flatten`; they are not in the library.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,operator,index"

from __future__ import annotations

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, wiring
from ..contract.variables import Input, Parameter
from ..library.logic import chosen_of


def _rows(K):
    return int(K.split()[0])


def _columns(K):
    return int(K.split()[2])


class WholeGain(Block):
    """What is left of a "gain". K: what `SparseMatrix` says of itself, "3 x 4 with 5 elements, ..."."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    K = Parameter("1 x 1", structural=True, type="string", doc="matrix of gains")
    u = Input(shape=_columns, unit=unit_u, doc="inputs")

    # Never asked, as those below: what reads y reads the parts.
    @wiring(shape=_rows, doc="K times the inputs")
    def y(u, K):
        return u[[0] * _rows(K)]


class WholeSwitch(Block):
    """What is left of a block of several "gains"."""

    size = Parameter(2, structural=True, type="int", doc="number of matrices to choose from")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    K = Parameter("2 x 1", structural=True, type="string", doc="matrices, stacked")
    u = Input(shape=_columns, unit=unit_u, doc="inputs")
    index = Input(doc="number of the matrix that counts, from 1 on")

    @wiring(shape=lambda K, size: _rows(K) // size, doc="the chosen matrix times the inputs")
    def y(u, K, size):
        return u[[0] * (_rows(K) // size)]


class WholeReduction(Block):
    """What is left of a "reduction" or a "norm"."""

    kind = Parameter("", structural=True, type="string", doc="what y is")
    size = Parameter(1, structural=True, type="int", doc="number of elements")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    u = Input(shape=lambda size: size, unit=unit, doc="vector")

    @wiring(doc="reduction of the input")
    def y(u):
        return u[0]


class WholeProduct(Block):
    """What is left of a "dot"."""

    size = Parameter(1, structural=True, type="int", doc="number of elements of each vector")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u1 = Input(shape=lambda size: size, doc="vector")
    u2 = Input(shape=lambda size: size, doc="vector")

    @wiring(doc="scalar product of the inputs")
    def y(u1, u2):
        return u1[0]


class Link(Block):
    """A link of a chain: what it gets of the links before, and the elements that it takes, from left to right."""

    kind = Parameter("products", structural=True, choices=("products", "squares", "sizes", "min", "max", "largest"))
    size = Parameter(1, structural=True, type="int", doc="number of elements")
    before = Input(doc="the links before")
    u1 = Input(shape=lambda size: size, doc="elements")
    u2 = Input(shape=lambda size: size, doc="factors, or what is taken off")

    @output
    def y(before, u1, u2, kind):
        total = before
        for a, b in zip(u1, u2, strict=True):
            if kind in ("products", "squares", "sizes"):
                total = total + (a * b if kind == "products" else np.abs(a) if kind == "sizes" else (a - b) ** 2)
            else:
                total = (
                    np.minimum(total, a) if kind == "min" else np.maximum(total, np.abs(a) if kind == "largest" else a)
                )
        return total


class Weights(Block):
    """The weights of a row of several matrices, of the one that is chosen."""

    size = Parameter(2, structural=True, type="int", doc="number of matrices")
    m = Parameter(1, structural=True, type="int", doc="number of elements of the row")
    w = Input(shape=lambda size, m: (size, m), doc="weights, a row for each matrix")
    chosen = Input(type="int", doc="number of the chosen matrix")

    @output(shape=lambda m: m)
    def y(w, chosen):
        return chosen_of(w, chosen)
