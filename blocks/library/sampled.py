"""Blocks that act at ticks: at offset + k period, for k = 0, 1, 2 ..., counted from t = 0."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["Delay", "UnitDelay", "ZeroOrderHold"]


class ZeroOrderHold(Block):
    """y = u at the last tick, held in between; y_start before the first tick.

    At a tick, u passes to y at once: with a controller behind it, this is a sampler without computation time.
    """

    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    u = Input(unit=unit, doc="input")

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="sampled and held input")
    def y(u):
        return u


class UnitDelay(Block):
    """y = u at the last tick but one, held in between; y_start up to the second tick.

    y does not depend on u at once, so that a UnitDelay breaks an algebraic loop of sampled blocks.
    """

    period = Parameter(unit="s", positive=True, doc="time between two ticks, by which the input is delayed")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y up to the second tick")
    u = Input(unit=unit, doc="input")
    x = Discrete(unit=unit, doc="input at the last tick")

    @x.initial
    def start(y_start):
        return y_start

    @x.next(every=period, offset=offset)
    def sample(u):
        return u

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="delayed input")
    def y(x):
        return x


class Delay(Block):
    """y = u as it was `samples` ticks before the last tick, held in between; y_start up to the tick at which u arrives.

    With samples = 1 this is a UnitDelay. Every tick moves all samples along.
    """

    samples = Parameter(1, structural=True, type="int", min=1, doc="number of ticks by which the input is delayed")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y up to the tick number `samples`, counted from 0")
    u = Input(unit=unit, doc="input")
    x = Discrete(shape=lambda samples: samples, unit=unit, doc="inputs at the last ticks, newest first")

    @x.initial
    def start(y_start):
        return y_start

    @x.next(every=period, offset=offset)
    def shift(u, x):
        return np.concatenate([[u], x[:-1]])

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="delayed input")
    def y(x, samples):
        return x[samples - 1]
