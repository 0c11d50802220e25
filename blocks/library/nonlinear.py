"""Nonlinear characteristics whose corners are located as crossings."""

import numpy as np

from ..declare import Block, Input, Parameter, crossing, output, requires

__all__ = ["Saturation"]


class Saturation(Block):
    """y = u within lower ... upper, else the limit that u is beyond.

    The instants at which u reaches a limit are located, so that no solver step straddles a corner.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    lower = Parameter(-1.0, unit=lambda unit: unit, doc="smallest y")
    upper = Parameter(1.0, unit=lambda unit: unit, doc="largest y")
    u = Input(unit=lambda unit: unit, doc="input")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @crossing
    def above(u, upper):
        return u - upper

    @crossing
    def below(u, lower):
        return lower - u

    @output(unit=lambda unit: unit, doc="limited input")
    def y(u, above, below, lower, upper):
        return np.where(above, upper, np.where(below, lower, u))
