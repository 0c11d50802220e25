"""The parts of blocks that are taken apart (see `parts`), and what is left of these.

They are put in by `flatten`; they are not in the library.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc,operator,index"

from __future__ import annotations

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, wiring
from ..contract.variables import Input, Parameter
from ..library.logic import chosen_of

__all__ = ["Link", "Weights", "Whole"]


class Whole(Block):
    """What is left of a block that is taken apart: its ports, and the parameters that their units follow from."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    p = Parameter(0, structural=True, type="int", doc="number of outputs; 0: y is a scalar")
    m = Parameter(1, structural=True, type="int", doc="number of inputs")
    u = Input(shape=lambda m: m, unit=unit_u, doc="inputs")

    @wiring(shape=lambda p: p or (), doc="what the parts give")
    def y(u, p):
        return u[[0] * p] if p else u[0]  # never asked: what reads y reads the parts


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
