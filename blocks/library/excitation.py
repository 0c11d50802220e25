"""Signals that excite all frequencies of a band, for measuring frequency responses and fitting models."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Discrete, Parameter

__all__ = ["PRBS", "Multisine"]

_TAPS = {
    2: (1,), 3: (2,), 4: (3,), 5: (3,), 6: (5,), 7: (6,), 8: (7, 6, 1), 9: (5,), 10: (7,), 11: (9,), 12: (11, 10, 4),
    13: (12, 11, 8), 14: (13, 12, 2), 15: (14,), 16: (15, 13, 4), 17: (14,), 18: (11,), 19: (18, 17, 14), 20: (17,),
    21: (19,), 22: (21,), 23: (18,), 24: (23, 22, 17), 25: (22,), 26: (25, 24, 20), 27: (26, 25, 22), 28: (25,),
    29: (27,), 30: (29, 28, 7), 31: (28,), 32: (31, 30, 10),
}  # fmt: skip
"""Places of the register whose sum, with that of place 0, is the next bit; those of scipy.signal.max_len_seq."""


class PRBS(Block):
    """A pseudo-random binary sequence of maximal length: at each tick y becomes high or low, as by the toss of a coin.

    A shift register of `order` bits puts out its oldest bit, and takes in the sum modulo 2 of this bit and the bits at
    its taps. After 2^order - 1 ticks the register has had all values but 0, and the sequence repeats: in one period y
    is high 2^(order-1) times, and its autocorrelation is that of white noise but for -1/(2^order - 1). The spectrum is
    flat to a few percent up to 1/(4 period), and 0 at 1/period. At the first tick of the run the register is `seed`;
    scipy.signal.max_len_seq(order, bits of seed, lowest first) is the same sequence.

    References: S. W. Golomb, Shift Register Sequences, Holden-Day 1967; L. Ljung, System Identification, 2nd ed.,
        Prentice Hall 1999, section 13.3.
    """

    order = Parameter(9, structural=True, type="int", min=2, max=32, doc="number of bits of the register")
    seed = Parameter(
        lambda order: 2**order - 1, type="int", fixed=True, min=1, doc="register at the start, lowest bit first"
    )
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    low = Parameter(-1.0, unit=unit, doc="lower value, also before the first tick")
    high = Parameter(1.0, unit=unit, doc="upper value")
    register = Discrete(shape=lambda order: order, type="bool", doc="coming bits, the next bit first")

    @requires("seed must be below 2^order")
    def fits(seed, order):
        return seed < 2**order

    @register.initial
    def bits(seed, order):
        return np.remainder(np.floor(seed / 2.0 ** np.arange(order)), 2.0) == 1.0

    @register.next(every=period, offset=offset)
    def shift(register, order):
        entering = register[0]
        for tap in _TAPS[order]:
            entering = entering ^ register[tap]
        return np.concatenate([register[1:], [entering]])

    @output(unit=unit, every=period, offset=offset, start=low, doc="the sequence")
    def y(register, low, high):
        return np.where(register[0], high, low)


def _schroeder(amplitude, n):
    """Phases of little crest: each is -2 pi times the sum of the shares of power before it, each by its distance."""
    power = np.square(amplitude) * np.ones(n)
    total = np.sum(power)
    distance = np.maximum(np.subtract.outer(np.arange(n), np.arange(n)), 0)
    return -2.0 * np.pi * (distance @ power) / np.where(total > 0.0, total, 1.0)


class Multisine(Block):
    """y = bias + the sum over k of amplitude[k] cos(2 pi harmonics[k] t/period + phase[k]).

    It repeats after `period`, so the response of a linear system over whole periods has lines at its harmonics only,
    without leakage. The default phases are Schroeder's, which keep the crest factor low, near that of one sine: for
    equal amplitudes phase[k] = -pi k (k + 1)/n, with k from 0 on.

    References: M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences with low autocorrelation,
        IEEE Trans. Information Theory 16 (1970) 85-89; R. Pintelon, J. Schoukens, System Identification: A Frequency
        Domain Approach, 2nd ed., Wiley 2012, chapter 5.
    """

    harmonics = Parameter(np.arange(1.0, 11.0), shape="n", doc="numbers of the harmonics, integers above 0")
    period = Parameter(1.0, unit="s", positive=True, doc="period of the first harmonic")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    amplitude = Parameter(1.0, unit=unit, shape="n", doc="amplitude of each harmonic; one number for all")
    phase = Parameter(_schroeder, unit="rad", shape="n", doc="phase of each harmonic at t = 0")
    bias = Parameter(0.0, unit=unit, doc="mean value")

    @requires("harmonics must be integers above 0, at least one")
    def are_whole(harmonics, n):
        return n > 0 and np.all((harmonics > 0.0) & (harmonics == np.floor(harmonics)))

    @output(unit=unit, doc="the multisine")
    def y(t, harmonics, period, amplitude, phase, bias):
        return bias + np.sum(amplitude * np.cos(2.0 * np.pi * harmonics * (t / period) + phase))
