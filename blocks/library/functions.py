"""Functions of one signal or several: y at a time depends on the inputs at that time alone.

Corners and jumps are located as crossings, so that no solver step straddles one. The equation of a jump reads the
latched side. That of a corner computes the function itself and needs no side: it is right at a tick that makes u jump,
and |u| >= 0 in a trial step beyond the corner too, so that a root behind it is never that of a negative number.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, output, requires
from ..contract.scalars import OPERATIONS
from ..contract.variables import Input, Parameter

__all__ = ["Abs", "Atan2", "Divide", "Exp", "Log", "MinMax", "Polynomial", "Power", "Sign", "Sqrt", "Trigonometry"]

NEVER = 1.0
"""The value of a crossing that a form of a block has no use for: its side does not change."""


class Abs(Block):
    """y = |u|.

    The instants at which u changes its sign are located.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    u = Input(unit=unit, doc="input")

    @crossing
    def corner(u):
        return u

    @output(unit=unit, doc="absolute value of the input")
    def y(u):
        return np.abs(u)


class Sign(Block):
    """y = 1 for u > 0, 0 for u = 0, -1 for u < 0.

    The instants at which u reaches or leaves 0 are located. If y drives u back to 0 from both sides, they come ever
    faster, and the run stops with an error that names this block: use a Saturation with a steep Gain, or a relay.
    """

    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=unit_u, doc="input")

    @crossing
    def above(u):
        return u

    @crossing
    def below(u):
        return -u

    @output(unit="1", doc="sign of the input")
    def y(above, below):
        return np.where(above, 1.0, 0.0) - np.where(below, 1.0, 0.0)


class Sqrt(Block):
    """y = sqrt(u), or in the signed form y = sqrt(|u|) sgn u.

    In the plain form a negative u stops the run with an error that names this block. The slope at u = 0 is infinite:
    steps near it are small, and a loop that comes to rest there needs ever more steps. u has the unit of y squared.
    """

    form = Parameter("plain", structural=True, choices=("plain", "signed"), doc="treatment of negative inputs")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(unit=unit**2, doc="input")

    # No crossing at 0: the slope is infinite before it too, and a loop at rest there would chatter.
    @output(unit=unit, doc="square root of the input")
    def y(u, form):
        return np.sqrt(u) if form == "plain" else np.sign(u) * np.sqrt(np.abs(u))


class Power(Block):
    """y = u^exponent, or in the signed form y = |u|^exponent sgn u.

    In the plain form a negative u with an exponent that is not an integer, or u = 0 with a negative exponent, stops the
    run with an error that names this block. In the signed form with an exponent above 1 the instants at which u changes
    its sign are located; with an exponent below 1 the slope at u = 0 is infinite, as for Sqrt. The power is computed
    from the number in SI units; `unit` is not checked against the unit of u.
    """

    form = Parameter("plain", structural=True, choices=("plain", "signed"), doc="treatment of negative inputs")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    exponent = Parameter(2.0, doc="exponent")
    u = Input(unit=unit_u, doc="input")

    @requires("the signed form needs an exponent above 0")
    def is_continuous(form, exponent):
        return form == "plain" or exponent > 0

    @crossing
    def corner(u, exponent, form):
        return np.where(exponent > 1.0, u, NEVER) if form == "signed" else NEVER

    @output(unit=unit, doc="power of the input")
    def y(u, exponent, form):
        return np.power(u, exponent) if form == "plain" else np.sign(u) * np.power(np.abs(u), exponent)


class Polynomial(Block):
    """y = c[0] u^n + c[1] u^(n-1) + ... + c[n], coefficients from the highest power down, as in numpy.polyval.

    The powers are computed from the number in SI units, by Horner's rule.
    """

    c = Parameter([1.0, 0.0], shape="m", doc="coefficients, highest power first")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    u = Input(unit=unit_u, doc="input")

    @requires("c must not be empty")
    def is_given(m):
        return m > 0

    @output(unit=unit, doc="value of the polynomial")
    def y(u, c, m):
        value = c[0]
        for k in range(1, m):
            value = value * u + c[k]
        return value


class Divide(Block):
    """y = u1/u2.

    The units of the inputs are free. A division by 0 stops the run with an error that names this block.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(shape=2, ports="u{}", doc="dividend and divisor")

    @output(unit=unit, doc="the quotient")
    def y(u):
        return u[0] / u[1]


def _lead(u, function, bit):
    """By how much the inputs whose number has a bit set are ahead of those whose number has not."""
    ones = [i for i in range(len(u)) if i & bit]
    zeros = [i for i in range(len(u)) if not i & bit]
    if not ones or not zeros:
        return NEVER
    return np.max(u[ones]) - np.max(u[zeros]) if function == "max" else np.min(u[zeros]) - np.min(u[ones])


class MinMax(Block):
    """y = max(u1, u2, ...), or the least of the inputs.

    The instants at which another input becomes the largest, or the least, are located. For each binary digit of the
    numbers of the inputs, a crossing compares the inputs with a 1 there with the inputs with a 0.
    """

    function = Parameter("max", structural=True, choices=("max", "min"), doc="whether y is the largest or the least")
    size = Parameter(2, structural=True, type="int", min=1, max=16, doc="number of inputs")
    unit = Parameter("", structural=True, type="string", doc='unit of the inputs and of y; "": unknown')
    u = Input(shape=lambda size: size, ports="u{}", unit=unit, doc="inputs")

    @crossing
    def lead_1(u, function):
        return _lead(u, function, 1)

    @crossing
    def lead_2(u, function):
        return _lead(u, function, 2)

    @crossing
    def lead_4(u, function):
        return _lead(u, function, 4)

    @crossing
    def lead_8(u, function):
        return _lead(u, function, 8)

    @output(unit=unit, doc="the largest or the least input")
    def y(u, function):
        return np.max(u) if function == "max" else np.min(u)


_TRIGONOMETRY = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")


class Trigonometry(Block):
    """y = sin u, or another trigonometric or hyperbolic function of u.

    Angles are in rad: u of sin, cos and tan, y of asin, acos and atan. A u beyond the domain of a function (|u| > 1 for
    asin, acos, atanh; u < 1 for acosh) stops the run with an error that names this block. A step may miss a pole of
    tan.
    """

    function = Parameter("sin", structural=True, choices=_TRIGONOMETRY, doc="function")
    u = Input(unit=lambda function: "rad" if function in ("sin", "cos", "tan") else "1", doc="input")

    @output(
        unit=lambda function: "rad" if function in ("asin", "acos", "atan") else "1", doc="the function of the input"
    )
    def y(u, function):
        return OPERATIONS[function].ieee(u)


class Atan2(Block):
    """y = the angle of the point (u2, u1) = atan2(u1, u2), from -pi to pi.

    With u2 < 0, y jumps between -pi and pi when u1 changes its sign; for u1 = 0 it is pi. These instants are located
    (also with u2 > 0, when nothing jumps). At u1 = u2 = 0, y = 0.
    """

    unit_u = Parameter("", structural=True, type="string", doc='unit of u1 and u2; "": unknown')
    u = Input(shape=2, ports="u{}", unit=unit_u, doc="opposite and adjacent side")

    @crossing
    def upper(u):
        return u[0]

    @output(unit="rad", doc="angle")
    def y(u, upper):
        # pi - atan2(u1, -u2) goes on smoothly beyond the jump until the side changes.
        return np.where(u[1] < 0.0, np.where(upper, np.pi, -np.pi) - np.arctan2(u[0], -u[1]), np.arctan2(u[0], u[1]))


class Exp(Block):
    """y = e^u.

    A u above 709 is too large for a number and stops the run with an error that names this block.
    """

    u = Input(unit="1", doc="exponent")

    @output(unit="1", doc="exponential of the input")
    def y(u):
        return np.exp(u)


_LOGARITHMS = {"e": np.log, "10": np.log10, "2": np.log2}


class Log(Block):
    """y = the logarithm of u to the base e, 10 or 2.

    A u that is not above 0 stops the run with an error that names this block.
    """

    base = Parameter("e", structural=True, choices=tuple(_LOGARITHMS), doc="base: e, 10 or 2")
    u = Input(unit="1", doc="input")

    @output(unit="1", doc="logarithm of the input")
    def y(u, base):
        return _LOGARITHMS[base](u)
