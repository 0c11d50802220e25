"""Blocks that remember their input: as it was a while ago, or as far as they could follow it."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output
from ..contract.variables import Discrete, History, Input, Parameter

__all__ = ["Backlash", "RateLimiter", "TransportDelay"]


class TransportDelay(Block):
    """y(t) = u(t - delay); y = y_before until the delay has passed since the start.

    The delay is exact: a jump of u comes out as a jump, at exactly its time plus the delay, and between jumps u is kept
    as polynomials of the order of the method. y does not depend on u at the same instant, so a delay breaks an
    algebraic loop. No step of the solver is longer than the delay.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    delay = Parameter(1.0, unit="s", positive=True, doc="dead time from the input to the output")
    y_before = Parameter(0.0, unit=unit, doc="y before the delay has passed")
    u = Input(unit=unit, doc="input")
    past = History(u, delay=delay, before=y_before, doc="input one delay earlier")

    @output(unit=unit, doc="delayed input")
    def y(past):
        return past


class RateLimiter(Block):
    """y follows u, rising and falling no faster than allowed: -falling <= dy/dt <= rising.

    y begins at u. The instant at which y catches up with u is located. The instant at which u becomes too fast is not,
    because it cannot be known in advance. Adaptive methods keep their steps so short there that y is within their
    tolerance; with a fixed step y is off by the deviation of u from a line in one step.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    rising = Parameter(1.0, unit=unit / "s", positive=True, doc="fastest rise per second")
    falling = Parameter(lambda rising: rising, unit=unit / "s", positive=True, doc="fastest fall per second")
    u = Input(unit=unit, doc="input")
    y_last = Discrete(unit=unit, doc="y at the end of the last step")
    t_last = Discrete(unit="s", doc="end of the last step")
    mode = Discrete(0, type="int", doc="1 while rising as fast as allowed, -1 while falling as fast, 0 while y = u")

    @local(unit=unit, doc="largest y that can have been reached")
    def highest(t, y_last, t_last, rising):
        return y_last + rising * (t - t_last)

    @local(unit=unit, doc="smallest y that can have been reached")
    def lowest(t, y_last, t_last, falling):
        return y_last - falling * (t - t_last)

    @crossing
    def behind(u, mode, highest, lowest):
        return np.where(mode > 0.0, u - highest, np.where(mode < 0.0, lowest - u, 1.0))

    @output(unit=unit, doc="followed input")
    def y(u, highest, lowest):
        return np.minimum(np.maximum(u, lowest), highest)

    @y_last.initial
    def begins(u):
        return u

    @t_last.initial
    @t_last.next(every="step")
    def now(t):
        return t

    @y_last.next(every="step")
    def reached(y):
        return y

    @mode.initial
    def follows_at_start():
        return 0.0

    @mode.next(every="step")
    def follows(u, highest, lowest):
        return np.where(u > highest, 1.0, np.where(u < lowest, -1.0, 0.0))


class Backlash(Block, describing="backlash"):
    """Play between two gears: y rests until u has moved through the gap, then u pushes it.

        y = min(max(y_last, u - width/2), u + width/2)

    y begins at y_start, or where u pushes it. The instant at which u meets y is located. The instant at which u turns
    back is not, because it cannot be known in advance. Adaptive methods keep their steps so short there that y is
    within their tolerance; with a fixed step y is off by the deviation of u from a line in one step.

    For u = A sin(theta) with A > width/2 its describing function is, with x = 1 - width/A,
    1/2 + (asin(x) + x sqrt(1 - x^2))/pi - j 2 width/(pi A) (1 - width/(2 A)); a smaller A moves nothing.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    width = Parameter(1.0, unit=unit, min=0.0, doc="width of the gap")
    y_start = Parameter(0.0, unit=unit, doc="y before u pushes it")
    u = Input(unit=unit, doc="input")
    y_last = Discrete(unit=unit, doc="y at the end of the last step")
    mode = Discrete(0, type="int", doc="1 while u pushes upwards, -1 while it pushes downwards, 0 within the gap")

    @crossing
    def meets_above(u, y_last, mode, width):
        return np.where(mode == 0.0, u - width / 2.0 - y_last, 1.0)

    @crossing
    def meets_below(u, y_last, mode, width):
        return np.where(mode == 0.0, y_last - (u + width / 2.0), 1.0)

    @output(unit=unit, doc="pushed output")
    def y(u, y_last, width):
        return np.minimum(np.maximum(y_last, u - width / 2.0), u + width / 2.0)

    @y_last.initial
    def begins(y_start):
        return y_start

    @y_last.next(every="step")
    def reached(y):
        return y

    @mode.initial
    def rests_at_start():
        return 0.0

    @mode.next(every="step")
    def pushes(u, y_last, width):
        return np.where(u - width / 2.0 >= y_last, 1.0, np.where(u + width / 2.0 <= y_last, -1.0, 0.0))
