"""Noise on a grid: a counter-based function of stream, seed and tick, the same in every engine and in any order."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Parameter

__all__ = ["Noise"]

# Two primes just below 2^26: products of two residues stay below 2^53, where doubles are exact.
_P, _Q = 67108859.0, 67108837.0


def _modulo(x, m):
    """x mod m, exact for integers 0 <= x < 2^52: the quotient's rounding error is below 1/m."""
    return x - m * np.floor(x / m)


def _mixed(counter, seed, stream, salt, m):
    """A residue of m that depends on every bit of counter, seed and stream.

    Rounds of x -> (a x + c)^3 mod m: linear ones would leave a lattice.
    """
    low, high = _modulo(counter, m), np.floor(counter / m)
    first, second = _modulo(stream, 2.0**26), np.floor(stream / 2.0**26)
    x = _modulo(low + 40503.0 * salt, m)
    for factor, shift in (
        (48271.0, seed),
        (69621.0, high + 7919.0 * salt),
        (16807.0, 2654435.0 + salt + first),
        (742938.0, second),
        (39373.0, seed),
    ):
        x = _modulo(factor * x + _modulo(shift, m), m)
        x = _modulo(x * _modulo(x * x, m), m)
    return x


def uniform(counter, seed, stream, salt):
    """A number in (0, 1) for each integer counter, seed, stream (0 <= counter, stream < 2^52) and salt; 52 bits."""
    low = (_mixed(counter, seed, stream, salt + 1.0, _Q) + 0.5) / _Q
    return (_mixed(counter, seed, stream, salt, _P) + low) / _P


class Noise(Block):
    """y = mean + deviation w(tick), held in between: w has mean 0 and standard deviation 1.

    w is Gaussian (Box and Muller) or uniform on -sqrt(3) ... sqrt(3). It depends on tick, seed and stream only: a run
    that begins later, or that has further ticks, has the same values at the same ticks. Each block has a stream of its
    own, which follows from the seed of the run and the path of the block: two blocks are independent, whatever their
    seeds, unless both name the same stream. For white noise of the two-sided spectral density S use
    deviation = sqrt(S/period).
    """

    distribution = Parameter("gaussian", structural=True, choices=("gaussian", "uniform"), doc="kind of noise")
    unit = Parameter("", type="string", structural=True, doc='unit of y; "": unknown')
    deviation = Parameter(1.0, unit=unit, min=0.0, doc="standard deviation")
    mean = Parameter(0.0, unit=unit, doc="mean")
    seed = Parameter(0.0, min=0.0, max=2.0**26, doc="an integer; another seed gives other noise")
    stream = Parameter(stream=True, doc="number of the stream of random numbers")
    period = Parameter(0.01, unit="s", positive=True, doc="time between two values")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first value")

    @requires("the seed must be an integer")
    def has_whole_seed(seed):
        return seed == np.floor(seed)

    @output(unit=unit, every=period, offset=offset, start=mean, doc="noise")
    def y(tick, seed, stream, mean, deviation, distribution):
        if distribution == "uniform":
            return mean + deviation * np.sqrt(3.0) * (2.0 * uniform(tick, seed, stream, 0.0) - 1.0)
        radius = np.sqrt(-2.0 * np.log(uniform(tick, seed, stream, 0.0)))
        return mean + deviation * radius * np.cos(2.0 * np.pi * uniform(tick, seed, stream, 2.0))
