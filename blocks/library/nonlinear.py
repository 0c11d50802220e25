"""Nonlinear characteristics whose corners are located as crossings."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, output, requires
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["DeadZone", "Quantizer", "Relay", "Saturation"]


class Saturation(Block):
    """y = u within lower ... upper, else the nearer limit.

    The instants at which u reaches a limit are located, so no solver step straddles a corner. With corners="clipped"
    they are not: steps cost less, and a step that straddles a corner has an error of the order of its square.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    corners = Parameter("located", structural=True, choices=("located", "clipped"), doc="whether corners are located")
    lower = Parameter(-1.0, unit=unit, is_limit=True, doc="smallest y")
    upper = Parameter(1.0, unit=unit, is_limit=True, doc="largest y")
    u = Input(unit=unit, doc="input")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @crossing
    def above(u, upper, corners):
        return u - upper if corners == "located" else -1.0

    @crossing
    def below(u, lower, corners):
        return lower - u if corners == "located" else -1.0

    @output(unit=unit, doc="limited input")
    def y(u, above, below, lower, upper, corners):
        if corners == "clipped":
            return np.minimum(np.maximum(u, lower), upper)
        return np.where(above, upper, np.where(below, lower, u))


class DeadZone(Block):
    """y = 0 within lower ... upper, else u minus the nearer limit.

    The instants at which u reaches a limit are located, so no solver step straddles a corner.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    lower = Parameter(-1.0, unit=unit, is_limit=True, doc="lower end of the dead zone")
    upper = Parameter(1.0, unit=unit, is_limit=True, doc="upper end of the dead zone")
    u = Input(unit=unit, doc="input")

    @requires("lower must be below upper")
    def is_ordered(lower, upper):
        return lower < upper

    @crossing
    def above(u, upper):
        return u - upper

    @crossing
    def below(u, lower):
        return lower - u

    @output(unit=unit, doc="part of the input beyond the dead zone")
    def y(u, above, below, lower, upper):
        return np.where(above, u - upper, np.where(below, u - lower, 0.0))


class Relay(Block, describing="relay"):
    """y switches to on when u reaches on_at, to off when u falls below off_at, and keeps its value in between.

    Both instants are located. If u lies between off_at and on_at at the start, starts_on decides. With off_at = on_at
    the relay is a comparator, without hysteresis; in a loop that pushes u back to this edge it switches ever faster,
    which stops the run with an error (E304). A thermostat heats below off_at: on=0, and off is the power.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    on_at = Parameter(1.0, unit=unit_u, doc="u at which the relay goes on")
    off_at = Parameter(-1.0, unit=unit_u, doc="u below which it goes off")
    on = Parameter(1.0, unit=unit, doc="y while it is on")
    off = Parameter(-1.0, unit=unit, doc="y while it is off")
    starts_on = Parameter(False, type="bool", doc="whether it is on at the start if u lies between off_at and on_at")
    u = Input(unit=unit_u, doc="input")
    is_on = Discrete(type="bool", doc="whether the relay is on")

    @requires("off_at must not be above on_at")
    def is_ordered(off_at, on_at):
        return off_at <= on_at

    @is_on.initial
    def start(u, on_at, off_at, starts_on):
        return (u >= on_at) | (starts_on & (u >= off_at))

    @crossing
    def switch(u, is_on, on_at, off_at):
        return u - np.where(is_on, off_at, on_at)

    @switch.reset(is_on)
    def switched(u, is_on, on_at, off_at):
        return u >= np.where(is_on, off_at, on_at)

    @output(unit=unit, doc="on or off, by the side of the relay")
    def y(is_on, on, off):
        return np.where(is_on, on, off)


class Quantizer(Block, describing="quantizer"):
    """y = interval level, with the integer level nearest to u/interval; halfway, the upper level.

    The instants at which the level changes are located, and y is constant in between; a jump of u may change the level
    by many. In a loop that pushes u back to the edge of a level, the level changes ever faster, which stops the run
    with an error (E304).
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    interval = Parameter(1.0, unit=unit, positive=True, doc="distance of two levels")
    u = Input(unit=unit, doc="input")
    level = Discrete(doc="number of the level")

    @crossing(direction="up")
    def above(u, level, interval):
        return u - (level + 0.5) * interval

    @crossing(direction="down")
    def below(u, level, interval):
        return u - (level - 0.5) * interval

    @level.initial
    @above.reset(level)
    @below.reset(level)
    def nearest(u, interval):
        # The quotient may round across an edge. The level has to be on that side of it on which the crossings see u,
        # or none of them would fire again.
        n = np.floor(u / interval + 0.5)
        n = np.where(u - (n + 0.5) * interval >= 0.0, n + 1.0, n)
        return np.where(u - (n - 0.5) * interval < 0.0, n - 1.0, n)

    @output(unit=unit, doc="nearest level")
    def y(level, interval):
        return interval * level
