"""Angles that wrap around, and their measurement."""

import math

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["Encoder", "Unwrap", "Wrap"]


def _turn(unit):
    """Return one turn in SI: a computed default is in SI, whatever the unit of the parameter."""
    return 2.0 * math.pi


class Wrap(Block):
    """The input less whole turns: lower <= y < lower + width; by default an angle from -pi to pi.

    The instants at which u passes an edge are located, so an integral of y is exact across the jump. In a loop that
    pushes u back to an edge y jumps ever faster, which stops the run with an error (E304). For a fixed function without
    jumps use Trigonometry and Atan2.
    """

    unit = Parameter("rad", structural=True, type="string", doc='unit of u and y; "": unknown')
    lower = Parameter(lambda width: -width / 2.0, unit=unit, doc="least y")
    width = Parameter(_turn, unit=unit, positive=True, doc="width of one turn")
    u = Input(unit=unit, doc="input")
    turns = Discrete(doc="whole turns that are taken off")

    @crossing(direction="up")
    def above(u, turns, lower, width):
        return u - (lower + (turns + 1.0) * width)

    @crossing(direction="down")
    def below(u, turns, lower, width):
        return u - (lower + turns * width)

    @turns.initial
    @above.reset(turns)
    @below.reset(turns)
    def whole(u, lower, width):
        # As for the Quantizer, the turn has to be on that side of an edge on which the crossings see u.
        n = np.floor((u - lower) / width)
        n = np.where(u - (lower + (n + 1.0) * width) >= 0.0, n + 1.0, n)
        return np.where(u - (lower + n * width) < 0.0, n - 1.0, n)

    @output(unit=unit, doc="input less whole turns")
    def y(u, turns, width):
        return u - turns * width


class Unwrap(Block):
    """The input plus whole turns, so that y changes by at most half a turn from tick to tick.

    At the first tick there are none. The block undoes Wrap if the angle turns by less than half a turn in a period.
    """

    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("rad", structural=True, type="string", doc='unit of u and y; "": unknown')
    width = Parameter(_turn, unit=unit, positive=True, doc="width of one turn")
    u = Input(unit=unit, doc="input")
    last = Discrete(unit=unit, doc="input at the last tick")
    turns = Discrete(doc="whole turns that are added")
    sampled = Discrete(type="bool", doc="whether there was a tick")

    @local(doc="whole turns from this tick on")
    def count(u, last, turns, sampled, width):
        return np.where(sampled, turns - np.floor((u - last) / width + 0.5), 0.0)

    @last.next(every=period, offset=offset)
    def remember(u):
        return u

    @turns.next(every=period, offset=offset)
    def add(count):
        return count

    @sampled.next(every=period, offset=offset)
    def has_sampled():
        return True

    @output(unit=unit, every=period, offset=offset, doc="input plus whole turns")
    def y(u, count, width):
        return u + count * width


class Encoder(Block):
    """An incremental encoder: the angle in whole counts at each tick, and the speed from their differences.

        count = floor(counts_per_turn theta/(2 pi)),    angle = 2 pi count/counts_per_turn
        omega[k] = a omega[k-1] + (1 - a) (angle[k] - angle[k-1])/period,    a = exp(-period/Tf)

    Without the filter (Tf = 0) one count of difference is a speed of 2 pi/(counts_per_turn period), which is the
    resolution of omega; the filter improves it, and delays omega. At the first tick omega = 0.
    """

    counts_per_turn = Parameter(2000.0, positive=True, doc="counts in one turn: four for each line")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    Tf = Parameter(0.0, unit="s", min=0.0, doc="time constant of the filter of omega; 0: none")
    theta = Input(unit="rad", doc="angle of the shaft")
    last_angle = Discrete(unit="rad", doc="angle at the last tick")
    last_omega = Discrete(unit="rad/s", doc="speed at the last tick")
    sampled = Discrete(type="bool", doc="whether there was a tick")

    @local(doc="whole counts of the angle")
    def counted(theta, counts_per_turn):
        return np.floor(counts_per_turn * theta / (2.0 * np.pi))

    @local(unit="rad", doc="angle of these counts")
    def measured(counted, counts_per_turn):
        return 2.0 * np.pi * counted / counts_per_turn

    @local(unit="rad/s", doc="filtered difference")
    def speed(measured, last_angle, last_omega, sampled, period, Tf):
        a = np.where(Tf > 0.0, np.exp(-period / np.where(Tf > 0.0, Tf, 1.0)), 0.0)
        return np.where(sampled, a * last_omega + (1.0 - a) * (measured - last_angle) / period, 0.0)

    @last_angle.next(every=period, offset=offset)
    def remember_angle(measured):
        return measured

    @last_omega.next(every=period, offset=offset)
    def remember_speed(speed):
        return speed

    @sampled.next(every=period, offset=offset)
    def has_sampled():
        return True

    @output(every=period, offset=offset, doc="whole counts")
    def count(counted):
        return counted

    @output(unit="rad", every=period, offset=offset, doc="measured angle")
    def angle(measured):
        return measured

    @output(unit="rad/s", every=period, offset=offset, doc="measured speed")
    def omega(speed):
        return speed
