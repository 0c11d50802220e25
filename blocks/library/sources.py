"""Sources: signals that depend on time alone. Their edges are event times, so that no solver step straddles one."""

import numpy as np

from .. import units
from ..declare import Block, Discrete, Parameter, event_time, output, requires

__all__ = ["Constant", "Pulse", "Ramp", "Sine", "Step"]


class Constant(Block):
    """y = value."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    value = Parameter(1.0, unit=lambda unit: unit, doc="value")

    @output(unit=lambda unit: unit, doc="the value")
    def y(value):
        return value


class Step(Block):
    """y = before for t < at, after for t >= at.

    The edge is hit exactly. A run that begins at `at` or later begins with `after`.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    at = Parameter(0.0, unit="s", doc="time of the step")
    before = Parameter(0.0, unit=lambda unit: unit, doc="value before the step")
    after = Parameter(1.0, unit=lambda unit: unit, doc="value from the step on")
    stepped = Discrete(type="bool", doc="whether the step has come")

    @event_time
    def edge(t, at):
        return np.where(t < at, at, np.inf)

    @stepped.initial
    @edge.reset(stepped)
    def is_after(t, at):
        return t >= at

    @output(unit=lambda unit: unit, doc="the step")
    def y(stepped, before, after):
        return np.where(stepped, after, before)


class Ramp(Block):
    """y = before for t < at, before + slope (t - at) for t >= at.

    The corner at `at` is hit exactly.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    at = Parameter(0.0, unit="s", doc="time at which the ramp begins")
    before = Parameter(0.0, unit=lambda unit: unit, doc="value before the ramp")
    slope = Parameter(1.0, unit=lambda unit: units.quotient(unit, "s"), doc="rise per second")
    rising = Discrete(type="bool", doc="whether the ramp has begun")

    @event_time
    def corner(t, at):
        return np.where(t < at, at, np.inf)

    @rising.initial
    @corner.reset(rising)
    def is_after(t, at):
        return t >= at

    @output(unit=lambda unit: unit, doc="the ramp")
    def y(t, rising, at, before, slope):
        return before + np.where(rising, slope * (t - at), 0.0)


class Pulse(Block):
    """y = height for on <= t < off, else 0.

    Both edges are hit exactly. With on = off there is no pulse.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    height = Parameter(1.0, unit=lambda unit: unit, doc="value during the pulse")
    on = Parameter(1.0, unit="s", doc="time at which the pulse begins")
    off = Parameter(2.0, unit="s", doc="time at which it ends")
    active = Discrete(type="bool", doc="whether the pulse is on")

    @requires("on must not be after off")
    def is_ordered(on, off):
        return on <= off

    @event_time
    def edge(t, on, off):
        return np.where(t < on, on, np.where(t < off, off, np.inf))

    @active.initial
    @edge.reset(active)
    def is_active(t, on, off):
        return (on <= t) & (t < off)

    @output(unit=lambda unit: unit, doc="the pulse")
    def y(active, height):
        return np.where(active, height, 0.0)


class Sine(Block):
    """y = bias + amplitude sin(omega t + phase).

    A frequency in Hz is an omega in rev/s: {"value": 50, "unit": "rev/s"}.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    amplitude = Parameter(1.0, unit=lambda unit: unit, doc="amplitude")
    omega = Parameter(1.0, unit="rad/s", doc="angular frequency")
    phase = Parameter(0.0, unit="rad", doc="phase at t = 0")
    bias = Parameter(0.0, unit=lambda unit: unit, doc="mean value")

    @output(unit=lambda unit: unit, doc="the sine")
    def y(t, amplitude, omega, phase, bias):
        return bias + amplitude * np.sin(omega * t + phase)
