"""Sources: signals that depend on time alone. Their edges are event times, so that no solver step straddles one."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import event_time, local, output, requires
from ..contract.variables import Discrete, Parameter

__all__ = ["Chirp", "Constant", "Pulse", "Ramp", "Sawtooth", "Sine", "SquareWave", "Step", "Trapezoid"]


class Constant(Block):
    """y = value."""

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    value = Parameter(1.0, unit=unit, doc="value")

    @output(unit=unit, doc="the value")
    def y(value):
        return value


class Step(Block):
    """y = before for t < at, after for t >= at.

    The edge is hit exactly. A run that begins at `at` or later begins with `after`.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    at = Parameter(0.0, unit="s", doc="time of the step")
    before = Parameter(0.0, unit=unit, doc="value before the step")
    after = Parameter(1.0, unit=unit, doc="value from the step on")
    stepped = Discrete(type="bool", doc="whether the step has come")

    @event_time
    def edge(t, at):
        return np.where(t < at, at, np.inf)

    @stepped.initial
    @edge.reset(stepped)
    def is_after(t, at):
        return t >= at

    @output(unit=unit, doc="the step")
    def y(stepped, before, after):
        return np.where(stepped, after, before)


class Ramp(Block):
    """y = before for t < at, before + slope (t - at) for t >= at.

    The corner at `at` is hit exactly.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    at = Parameter(0.0, unit="s", doc="time at which the ramp begins")
    before = Parameter(0.0, unit=unit, doc="value before the ramp")
    slope = Parameter(1.0, unit=unit / "s", doc="rise per second")
    rising = Discrete(type="bool", doc="whether the ramp has begun")

    @event_time
    def corner(t, at):
        return np.where(t < at, at, np.inf)

    @rising.initial
    @corner.reset(rising)
    def is_after(t, at):
        return t >= at

    @output(unit=unit, doc="the ramp")
    def y(t, rising, at, before, slope):
        return before + np.where(rising, slope * (t - at), 0.0)


class Pulse(Block):
    """y = height for on <= t < off, else 0.

    Both edges are hit exactly. With on = off there is no pulse.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    height = Parameter(1.0, unit=unit, doc="value during the pulse")
    on = Parameter(1.0, unit="s", doc="time at which the pulse begins")
    off = Parameter(2.0, unit="s", doc="time at which the pulse ends")
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

    @output(unit=unit, doc="the pulse")
    def y(active, height):
        return np.where(active, height, 0.0)


class Sine(Block):
    """y = bias + amplitude sin(omega t + phase).

    A frequency in Hz is an omega in rev/s: {"value": 50, "unit": "rev/s"}.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    amplitude = Parameter(1.0, unit=unit, doc="amplitude")
    omega = Parameter(1.0, unit="rad/s", doc="angular frequency")
    phase = Parameter(0.0, unit="rad", doc="phase at t = 0")
    bias = Parameter(0.0, unit=unit, doc="mean value")

    @output(unit=unit, doc="the sine")
    def y(t, amplitude, omega, phase, bias):
        return bias + amplitude * np.sin(omega * t + phase)


class Chirp(Block):
    """y = bias + amplitude sin(angle + phase), with an angular frequency that goes from omega_start to omega_end.

        omega = omega_start + (omega_end - omega_start) s/duration       linear
        omega = omega_start (omega_end/omega_start)^(s/duration)         exponential
        d angle/dt = omega, from 0 at t = at on, with s = t - at

    The angle stays 0 before `at`. After the sweep, omega stays omega_end and the angle goes on without a jump. The
    beginning and the end of the sweep are hit exactly. A frequency in Hz is an omega in rev/s.
    """

    form = Parameter("linear", structural=True, choices=("linear", "exponential"), doc="how omega changes with time")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    amplitude = Parameter(1.0, unit=unit, doc="amplitude")
    omega_start = Parameter(1.0, unit="rad/s", doc="angular frequency at the beginning of the sweep")
    omega_end = Parameter(10.0, unit="rad/s", doc="angular frequency at the end of the sweep")
    duration = Parameter(10.0, unit="s", positive=True, doc="duration of the sweep")
    at = Parameter(0.0, unit="s", doc="time at which the sweep begins")
    phase = Parameter(0.0, unit="rad", doc="phase at the beginning of the sweep")
    bias = Parameter(0.0, unit=unit, doc="mean value")

    @requires("an exponential sweep needs two frequencies of one sign, neither of them 0")
    def has_ratio(form, omega_start, omega_end):
        return form == "linear" or np.sign(omega_start) * np.sign(omega_end) > 0

    @event_time
    def corner(t, at, duration):
        return np.where(t < at, at, np.where(t < at + duration, at + duration, np.inf))

    @local(unit="rad", doc="angle since the beginning of the sweep")
    def angle(t, at, duration, omega_start, omega_end, form):
        s = np.clip(t - at, 0.0, duration)
        if form == "linear":
            swept = (omega_start + (omega_end - omega_start) * s / (2.0 * duration)) * s
        else:
            rate = np.log(omega_end / omega_start) / duration
            known = np.where(rate == 0.0, 1.0, rate)
            swept = omega_start * np.where(rate == 0.0, s, np.expm1(known * s) / known)
        return swept + omega_end * np.maximum(t - at - duration, 0.0)

    @output(unit=unit, doc="the chirp")
    def y(angle, amplitude, phase, bias):
        return bias + amplitude * np.sin(angle + phase)


def _whole_periods(t, at, period):
    """k with at + k period <= t < at + (k + 1) period, for t >= at.

    This holds for the doubles that these expressions give, which are the times of edges: the rounding of the quotient
    may put its floor one off, and an edge would then come twice or not at all.
    """
    k = np.floor((t - at) / period)
    k = np.where(t < at + k * period, k - 1.0, k)
    return np.where(t < at + (k + 1.0) * period, k, k + 1.0)


class SquareWave(Block):
    """y = high during the first part `duty` of each period, then low.

    Periods begin at at + k period, for k = 0, 1, 2 ...; before `at`, y = low. All edges are hit exactly, and they do
    not drift: no edge is computed from the edge before.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    period = Parameter(1.0, unit="s", positive=True, doc="time from one rise to the next")
    duty = Parameter(0.5, unit="1", min=0.0, max=1.0, doc="part of the period for which y is high")
    at = Parameter(0.0, unit="s", doc="time of the first rise")
    low = Parameter(0.0, unit=unit, doc="lower value")
    high = Parameter(1.0, unit=unit, doc="upper value")
    risen = Discrete(type="bool", doc="whether y is high")

    @event_time
    def edge(t, at, period, duty):
        k = _whole_periods(t, at, period)
        fall = at + (k + duty) * period
        return np.where(t < at, at, np.where(t < fall, fall, at + (k + 1.0) * period))

    @risen.initial
    @edge.reset(risen)
    def is_high(t, at, period, duty):
        return (at <= t) & (t < at + (_whole_periods(t, at, period) + duty) * period)

    @output(unit=unit, doc="the square wave")
    def y(risen, low, high):
        return np.where(risen, high, low)


class Sawtooth(Block):
    """y = low + (high - low) (t - begun)/period: a line from low to high in each period, and a jump back.

    Periods begin at at + k period, for k = 0, 1, 2 ...; before `at`, y = low. The jumps are hit exactly and do not
    drift. With high below low the line falls.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    period = Parameter(1.0, unit="s", positive=True, doc="time from one jump to the next")
    at = Parameter(0.0, unit="s", doc="time at which the first line begins")
    low = Parameter(0.0, unit=unit, doc="value at the beginning of a period")
    high = Parameter(1.0, unit=unit, doc="value at the end of a period")
    running = Discrete(type="bool", doc="whether the first period has begun")
    begun = Discrete(unit="s", doc="time at which the period began")

    @event_time
    def jump(t, at, period):
        return np.where(t < at, at, at + (_whole_periods(t, at, period) + 1.0) * period)

    @running.initial
    @jump.reset(running)
    def is_after(t, at):
        return t >= at

    @begun.initial
    @jump.reset(begun)
    def begin(t, at, period):
        return np.where(t < at, at, at + _whole_periods(t, at, period) * period)

    @output(unit=unit, doc="the sawtooth")
    def y(t, running, begun, period, low, high):
        return low + np.where(running, (high - low) * (t - begun) / period, 0.0)


# The sum of three decimals may be two roundings off that of the period which they fill.
_ROUNDED = 1e-15


def _corners(t, at, period, rise, width, fall):
    """The beginning of the period of t, the ends of its rise, its top and its fall, and its own end."""
    k = _whole_periods(t, at, period)
    begin, end = at + k * period, at + (k + 1.0) * period
    parts = (rise, rise + width, rise + width + fall)
    return begin, *(np.where(s < period * (1.0 - _ROUNDED), np.minimum(begin + s, end), end) for s in parts), end


class Trapezoid(Block):
    """y goes from low to high in `rise`, stays there for `width`, goes back in `fall`, and rests up to the next period.

    Periods begin at at + k period, for k = 0, 1, 2 ...; before `at`, y = low. All corners are hit exactly and do not
    drift. A rise or a fall of 0 is a jump; with width = 0 and rise + fall = period, y is a triangle.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    period = Parameter(1.0, unit="s", positive=True, doc="time from one rise to the next")
    rise = Parameter(0.1, unit="s", min=0.0, doc="duration of the rise")
    width = Parameter(0.4, unit="s", min=0.0, doc="time at high")
    fall = Parameter(0.1, unit="s", min=0.0, doc="duration of the fall")
    at = Parameter(0.0, unit="s", doc="time at which the first rise begins")
    low = Parameter(0.0, unit=unit, doc="value at rest")
    high = Parameter(1.0, unit=unit, doc="value at the top")
    begun = Discrete(unit="s", doc="time at which the period began")
    part = Discrete(doc="1 in the rise, 2 at the top, 3 in the fall, 0 at rest")

    @requires("rise + width + fall must not be longer than the period")
    def fits(rise, width, fall, period):
        return rise + width + fall <= period * (1.0 + _ROUNDED)

    @event_time
    def corner(t, at, period, rise, width, fall):
        _, *corners, following = _corners(t, at, period, rise, width, fall)
        for s in reversed(corners):
            following = np.where(t < s, s, following)
        return np.where(t < at, at, following)

    @begun.initial
    @corner.reset(begun)
    def begin(t, at, period):
        return np.where(t < at, at, at + _whole_periods(t, at, period) * period)

    @part.initial
    @corner.reset(part)
    def which(t, at, period, rise, width, fall):
        _, risen, falling, fallen, _ = _corners(t, at, period, rise, width, fall)
        after = np.where(t < falling, 2.0, np.where(t < fallen, 3.0, 0.0))
        return np.where(t < at, 0.0, np.where(t < risen, 1.0, after))

    @output(unit=unit, doc="the trapezoid")
    def y(t, begun, part, rise, width, fall, low, high):
        s = t - begun
        # Where an instant joins one some ulp away, s may lie outside its part by as much.
        up = np.clip(s / np.where(rise > 0.0, rise, 1.0), 0.0, 1.0)
        down = np.clip((rise + width + fall - s) / np.where(fall > 0.0, fall, 1.0), 0.0, 1.0)
        level = np.where(part == 1.0, up, np.where(part == 2.0, 1.0, np.where(part == 3.0, down, 0.0)))
        return low + (high - low) * level
