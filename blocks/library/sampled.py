"""Blocks that act at ticks: at offset + k period, for k = 0, 1, 2 ..., counted from t = 0."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["Delay", "FirstOrderHold", "RateTransition", "UnitDelay", "ZeroOrderHold"]


class ZeroOrderHold(Block):
    """y = u at the last tick, held in between; y_start before the first tick.

    At a tick, u passes to y at the same instant: with a controller after it, this is a sampler without computation
    time.
    """

    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    u = Input(unit=unit, doc="input")

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="sampled and held input")
    def y(u):
        return u


class FirstOrderHold(Block):
    """y = begin + slope (t - at): a straight line from each tick on, with the slope between the last two samples of u.

    form: "predictive" begins at the sample u[k] and continues the line of the last two samples, so y jumps at ticks;
    "delayed" begins at the sample before, u[k-1], and reaches u[k] one tick later, so y is continuous. The predictive
    form reproduces a ramp without error from its second sample on, the delayed form a period late.

    Before the first tick y is y_start. From the first tick on, the predictive form has one sample and holds it; the
    delayed form goes from y_start to it. In a loop of sampled blocks both need a UnitDelay, because the slope depends
    on u at the same instant.
    """

    form = Parameter("predictive", structural=True, choices=("predictive", "delayed"), doc="where a line begins")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    u = Input(unit=unit, doc="input")
    last = Discrete(unit=unit, doc="input at the last tick")
    sampled = Discrete(type="bool", doc="whether there was a tick")

    @last.initial
    def start(y_start):
        return y_start

    @last.next(every=period, offset=offset)
    def sample(u):
        return u

    @sampled.next(every=period, offset=offset)
    def has_sampled():
        return np.True_

    @output(unit="s", every=period, offset=offset, doc="time of the last tick")
    def at(t):
        return t

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="y at the last tick")
    def begin(u, last, form):
        return u if form == "predictive" else last

    @output(unit=unit / "s", every=period, offset=offset, doc="rise per second since the last tick")
    def slope(u, last, sampled, period, form):
        rise = (u - last) / period
        return np.where(sampled, rise, 0.0) if form == "predictive" else rise

    @output(unit=unit, doc="line through the samples")
    def y(t, at, begin, slope):
        return begin + slope * (t - at)


class RateTransition(Block):
    """y = u of a task that ticks with period_u, as a task that ticks with `period` receives it.

    Ticks are exact and their order is known, so no value is ever torn or lost between rates, and a wire is enough for
    an ideal transfer: at common ticks u passes without delay. On a computer, u of a slow task is not ready by then.

    mode: "hold" gives u at each tick of the receiver: for a fast sender, which is done before a slow receiver begins.
    "delay" gives u at the last tick but one of the sender: for a slow sender, which has all of period_u to compute; y
    does not depend on u at the same instant. The default is "delay" from slow to fast, else "hold".

    Code generators do the same for tasks with priorities by rate. The periods may have any ratio. y is y_start until
    the first value arrives.
    """

    mode = Parameter(
        lambda period_u, period: "delay" if period_u > period else "hold",
        structural=True, choices=("hold", "delay"), doc="transfer of u; default: delay from slow to fast, else hold",
    )  # fmt: skip
    period_u = Parameter(unit="s", positive=True, doc="time between two ticks of the sender")
    period = Parameter(unit="s", positive=True, doc="time between two ticks of the receiver")
    offset_u = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick of the sender")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick of the receiver")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y until the first value of u arrives")
    u = Input(unit=unit, doc="input")
    x = Discrete(unit=unit, doc="input at the last tick of the sender")

    @x.initial
    def start(y_start):
        return y_start

    @x.next(every=period_u, offset=offset_u)
    def sample(u):
        return u

    @output(unit=unit, every=period_u, offset=offset_u, start=y_start, doc="value that the sender has finished")
    def finished(x):
        return x

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="value that the receiver has")
    def y(u, finished, mode):
        return u if mode == "hold" else finished


class UnitDelay(Block):
    """y = u at the last tick but one, held in between; y_start up to the second tick.

    y does not depend on u at the same instant, so a UnitDelay breaks an algebraic loop of sampled blocks.
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
