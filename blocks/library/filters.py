"""Digital filters by their coefficients, which scipy.signal designs: firwin, butter.

All act at ticks: at offset + k period, for k = 0, 1, 2 ..., counted from t = 0.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Discrete, Input, Parameter

__all__ = ["Biquad", "FIRFilter", "MovingAverage"]


class MovingAverage(Block):
    """y[k] = (u[k] + u[k-1] + ... + u[k-samples+1])/samples: the mean of the last inputs.

    Before the first tick y is y_start, and the first means use y_start as the inputs before that tick. A disturbance of
    the period `samples period`, and its harmonics, average to 0; the delay is (samples - 1) period/2.
    """

    samples = Parameter(10, structural=True, type="int", min=1, doc="number of inputs in the mean")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick, and u before it")
    u = Input(unit=unit, doc="input")
    x = Discrete(shape=lambda samples: samples - 1, unit=unit, doc="inputs at the last ticks, newest first")

    @x.initial
    def start(y_start):
        return y_start

    @x.next(every=period, offset=offset)
    def shift(u, x, samples):
        return np.concatenate([[u], x])[: samples - 1]

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="mean of the last inputs")
    def y(u, x, samples):
        return (u + np.sum(x)) / samples


class FIRFilter(Block):
    """y[k] = b[0] u[k] + b[1] u[k-1] + ... + b[m-1] u[k-m+1]: a finite impulse response, which is b itself.

    The coefficients are those of scipy.signal.firwin and of scipy.signal.lfilter(b, 1, u). Zeros of b fix the type:
    with b[0] = 0, y does not depend on u at the same instant. Inputs before the first tick are x_start, which is 0.

    References: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, Pearson 2010, section 6.5.
    """

    b = Parameter([1.0], shape="m", zeros=True, doc="coefficients, for the newest input first")
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    u = Input(unit=unit_u, doc="input")
    x = Discrete(shape=lambda m: max(m - 1, 0), unit=unit_u, doc="inputs at the last ticks, newest first")

    @requires("b must not be empty")
    def is_given(m):
        return m > 0

    @x.next(every=period, offset=offset)
    def shift(u, x, m):
        return np.concatenate([[u], x])[: m - 1]

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="filtered input")
    def y(u, x, b):
        return b[0] * u + b[1:] @ x


def _sections(u, x, sos, n):
    """The output of a cascade and its next state, section by section: direct form II, transposed."""
    following = []
    for k in range(n):
        b, a = sos[k, :3] / sos[k, 3], sos[k, 3:] / sos[k, 3]
        y = b[0] * u + x[k, 0]
        following.append([x[k, 1] + b[1] * u - a[1] * y, b[2] * u - a[2] * y])
        u = y
    return u, following


class Biquad(Block):
    """y = u through n sections of second order in series, each (b0 z^2 + b1 z + b2)/(a0 z^2 + a1 z + a2).

    A row of sos is [b0, b1, b2, a0, a1, a2], as in scipy.signal: butter, tf2sos, sosfilt. One row is a biquad. A filter
    of high order keeps its digits as a cascade, but loses them as one polynomial. Each section is in the transposed
    direct form II:

        y = b0 u + x1,   x1[k+1] = x2 + b1 u - a1 y,   x2[k+1] = b2 u - a2 y   (coefficients over a0)

    Zeros of sos fix the type. The state begins at x_start, which is 0; scipy.signal.sosfilt_zi gives a state at rest.

    References: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, Pearson 2010, section 6.3.
    """

    sos = Parameter(
        [[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]], shape=("n", 6), zeros=True, doc="sections, each a row b0, b1, b2, a0, a1, a2"
    )
    period = Parameter(unit="s", positive=True, doc="time between two ticks")
    offset = Parameter(0.0, unit="s", min=0.0, doc="time of the first tick")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    y_start = Parameter(0.0, unit=unit, doc="y before the first tick")
    u = Input(unit=unit_u, doc="input")
    x = Discrete(shape=lambda n: (n, 2), doc="state of each section")

    @requires("sos must not be empty, no a0 may be 0")
    def has_sections(sos, n):
        return n > 0 and np.all(sos[:, 3] != 0.0)

    @x.next(every=period, offset=offset)
    def step(u, x, sos, n):
        return np.array(_sections(u, x, sos, n)[1])

    @output(unit=unit, every=period, offset=offset, start=y_start, doc="filtered input")
    def y(u, x, sos, n):
        return _sections(u, x, sos, n)[0]
