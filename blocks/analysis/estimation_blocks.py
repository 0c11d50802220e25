"""Blocks that an estimation of a frequency response puts into a diagram: what excites it, and what listens."""

# Equations are plain functions of their variables' names: they have no annotations.
# mypy: disallow-untyped-defs=False, disallow-untyped-decorators=False, disallow-untyped-calls=False
# mypy: disallow-incomplete-defs=False, check-untyped-defs=False

from __future__ import annotations

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, output
from ..contract.variables import Discrete, Input, Parameter, State

TONE = 5
"""The elements of a tone, which is one vector so that one call sets all of them at one instant:"""
AMPLITUDE, OMEGA, AT, BEGIN, LENGTH = range(TONE)


class Tone(Block):
    """y = A sin(omega (t - at)), with A, omega and at from a vector that comes from outside."""

    tone = Input(shape=TONE, doc="amplitude, angular frequency, time of phase 0, and the window of the Correlator")

    @output(doc="the sine")
    def y(t, tone):
        return tone[AMPLITUDE] * np.sin(tone[OMEGA] * (t - tone[AT]))


class Multitone(Block):
    """y = sum over i of amplitude_i sin(multiples_i omega (t - at) + phase_i)."""

    multiples = Parameter(shape="n", doc="frequency of each line over omega")
    amplitude = Parameter(shape=lambda n: n, doc="amplitude of each line")
    phase = Parameter(shape=lambda n: n, unit="rad", doc="phase of each line at t = at")
    omega = Parameter(unit="rad/s", doc="angular frequency of which all others are multiples")
    at = Parameter(0.0, unit="s", doc="time of phase 0")

    @output(doc="the sum of the lines")
    def y(t, multiples, amplitude, phase, omega, at, n):
        total = 0.0
        for i in range(n):
            total = total + amplitude[i] * np.sin(multiples[i] * omega * (t - at) + phase[i])
        return total


class Sweep(Block):
    """y = amplitude w(s) sin(angle(s)), s = t - at within 0 ... duration, else 0: an exponential chirp.

        d angle/ds = low (high/low)^(s/duration)

    w rises from 0 to 1 over the first part `taper` of the duration and falls over the last, as half a cosine.
    """

    low = Parameter(unit="rad/s", positive=True, doc="angular frequency at the beginning")
    high = Parameter(unit="rad/s", positive=True, doc="angular frequency at the end")
    duration = Parameter(unit="s", positive=True, doc="duration of the sweep")
    amplitude = Parameter(1.0, doc="amplitude between the tapers")
    taper = Parameter(0.1, positive=True, max=0.5, doc="part of the duration in which the amplitude rises, and falls")
    at = Parameter(0.0, unit="s", doc="time at which it begins")

    @output(doc="the chirp")
    def y(t, low, high, duration, amplitude, taper, at):
        s = np.clip((t - at) / duration, 0.0, 1.0)
        rate = np.log(high / low)
        edge = np.minimum(np.minimum(s, 1.0 - s) / taper, 1.0)
        angle = low * duration * np.expm1(rate * s) / rate
        return amplitude * 0.5 * (1.0 - np.cos(np.pi * edge)) * np.sin(angle)


class Injection(Block):
    """y = u + d; of a vector u, d is added to one element."""

    size = Parameter(0, structural=True, type="int", min=0, doc="elements of u; 0: it is no vector")
    index = Parameter(0, structural=True, type="int", min=0, doc="element that d is added to")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    u = Input(shape=lambda size: size or (), unit=unit, doc="the signal")
    d = Input(doc="what is added to it")

    @output(shape=lambda size: size or (), unit=unit, doc="the sum")
    def y(u, d, size, index):
        if not size:
            return u + d
        return u + np.array([float(i == index) for i in range(size)]) * d


class Correlator(Block):
    """x_i = means of w y_i times 1, s, 2 cos k theta and 2 sin k theta over a window, for k = 1 ... orders.

        theta = omega (t - at),   s = (t - begin)/length - 1/2,   w = 1 + cos(2 pi s) within the window, else 0

    The means are states, so that the solver's own error control makes them and no jump of a signal is missed between
    two samples. Hann's window w is blind to whatever lies some lines away from k omega, such as the images of a sampler
    and transients. A begin that moves up empties the means.
    """

    count = Parameter(1, structural=True, type="int", min=1, doc="number of signals")
    orders = Parameter(1, structural=True, type="int", min=1, doc="highest harmonic k")
    tone = Input(shape=TONE, doc="amplitude, omega, at, begin, length")
    y = Input(shape=lambda count: count, doc="signals")
    x = State(shape=lambda count, orders: (count, 2 * orders + 2), output=True, doc="means: 1, s, cos, sin, ...")
    begun = Discrete(unit="s", doc="begin of the window")

    @begun.initial
    def first(tone):
        return tone[BEGIN]

    @crossing(direction="up")
    def anew(tone, begun):
        return np.where(tone[BEGIN] > begun, 1.0, -1.0)

    @anew.reset(x)
    def empty(x):
        return 0.0 * x

    @anew.reset(begun)
    def begin(tone):
        return tone[BEGIN]

    @x.derivative
    def dx(t, y, tone, count, orders):
        s = (t - tone[BEGIN]) / tone[LENGTH] - 0.5
        w = np.where((s >= -0.5) & (s <= 0.5), (1.0 + np.cos(2.0 * np.pi * s)) / tone[LENGTH], 0.0)
        theta = tone[OMEGA] * (t - tone[AT])
        c, d = np.cos(theta), np.sin(theta)
        ck, dk, row = c, d, [w, w * s]
        for _ in range(orders):
            row += [2.0 * w * ck, 2.0 * w * dk]
            ck, dk = c * ck - d * dk, d * ck + c * dk  # the next multiple of theta costs no call of cos
        return np.array([[y[i] * weight for weight in row] for i in range(count)])
