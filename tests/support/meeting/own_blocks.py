"""Blocks that only tests have: projections after each step whose results have closed forms."""

from __future__ import annotations

import numpy as np

from blocks import Block, Discrete, Input, Parameter, output


class Peak(Block):
    """y = the largest u so far, as the steps have seen it."""

    least = Parameter(-10.0, doc="y is at least this")
    u = Input()
    largest = Discrete()

    @largest.initial
    def first(u, least):
        return np.maximum(u, least)

    @largest.next(every="step")
    def grown(u, largest):
        return np.maximum(u, largest)

    @output
    def y(u, largest):
        return np.maximum(u, largest)


OWN = [Peak]
