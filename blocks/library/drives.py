"""Transformations of three-phase quantities, as the control of electrical machines and inverters uses them.

References: P. C. Krause, O. Wasynczuk, S. D. Sudhoff, S. Pekarek, Analysis of Electric Machinery and Drive Systems,
    3rd ed., Wiley 2013, chapter 3.
"""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output
from ..contract.variables import Input, Parameter

__all__ = ["Clarke", "InverseClarke", "InversePark", "Park"]

_SCALES = {"amplitude": (2.0 / 3.0, 1.0 / 3.0), "power": (np.sqrt(2.0 / 3.0), np.sqrt(1.0 / 3.0))}
"""The factors of alpha and beta, and of zero, by the scaling."""
_INVERSES = {"amplitude": (1.0, 1.0), "power": _SCALES["power"]}

_HEIGHT = np.sqrt(3.0) / 2.0


class Clarke(Block):
    """alpha = 2/3 (a - b/2 - c/2), beta = (b - c)/sqrt(3), zero = (a + b + c)/3: three phases as a vector in a plane.

    alpha lies on phase a, beta leads it by 90 degrees. scaling "amplitude": balanced phases of the amplitude A make a
    vector of the length A, and power is 3/2 (v_alpha i_alpha + v_beta i_beta) + 3 v_zero i_zero. "power": the factors
    are sqrt(2/3), sqrt(1/2) and sqrt(1/3), the transformation is orthogonal, and power is the sum of the products.
    """

    scaling = Parameter("amplitude", structural=True, choices=("amplitude", "power"), doc="part that keeps its size")
    unit = Parameter("", structural=True, type="string", doc='unit of all inputs and outputs; "": unknown')
    a = Input(unit=unit, doc="phase a")
    b = Input(unit=unit, doc="phase b")
    c = Input(unit=unit, doc="phase c")

    @output(unit=unit, doc="component along phase a")
    def alpha(a, b, c, scaling):
        return _SCALES[scaling][0] * (a - 0.5 * b - 0.5 * c)

    @output(unit=unit, doc="component 90 degrees ahead of phase a")
    def beta(b, c, scaling):
        return _SCALES[scaling][0] * _HEIGHT * (b - c)

    @output(unit=unit, doc="common part of the phases")
    def zero(a, b, c, scaling):
        return _SCALES[scaling][1] * (a + b + c)


class InverseClarke(Block):
    """a = alpha + zero, b = -alpha/2 + sqrt(3)/2 beta + zero, c = -alpha/2 - sqrt(3)/2 beta + zero: undoes Clarke.

    With scaling "power", alpha and beta count by sqrt(2/3) and zero by sqrt(1/3).
    """

    scaling = Parameter("amplitude", structural=True, choices=("amplitude", "power"), doc="part that keeps its size")
    unit = Parameter("", structural=True, type="string", doc='unit of all inputs and outputs; "": unknown')
    alpha = Input(unit=unit, doc="component along phase a")
    beta = Input(unit=unit, doc="component 90 degrees ahead of phase a")
    zero = Input(0.0, unit=unit, doc="common part of the phases")

    @output(unit=unit, doc="phase a")
    def a(alpha, zero, scaling):
        return _INVERSES[scaling][0] * alpha + _INVERSES[scaling][1] * zero

    @output(unit=unit, doc="phase b")
    def b(alpha, beta, zero, scaling):
        return _INVERSES[scaling][0] * (_HEIGHT * beta - 0.5 * alpha) + _INVERSES[scaling][1] * zero

    @output(unit=unit, doc="phase c")
    def c(alpha, beta, zero, scaling):
        return _INVERSES[scaling][0] * (-_HEIGHT * beta - 0.5 * alpha) + _INVERSES[scaling][1] * zero


class Park(Block):
    """d = alpha cos theta + beta sin theta, q = beta cos theta - alpha sin theta: a vector seen from turning axes.

    theta is the angle from alpha (phase a) to d, in electrical radians: the angle of the machine times its pole pairs.
    q leads d by 90 degrees. So cos(theta + phi) on phase a, balanced, is d = cos phi and q = sin phi. Other conventions
    put phase a on q at theta = 0: theta here is their angle minus pi/2.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of alpha, beta, d and q; "": unknown')
    alpha = Input(unit=unit, doc="component along phase a")
    beta = Input(unit=unit, doc="component 90 degrees ahead of phase a")
    theta = Input(unit="rad", doc="electrical angle of the d axis, from phase a")

    @output(unit=unit, doc="direct component")
    def d(alpha, beta, theta):
        return alpha * np.cos(theta) + beta * np.sin(theta)

    @output(unit=unit, doc="quadrature component, 90 degrees ahead of d")
    def q(alpha, beta, theta):
        return beta * np.cos(theta) - alpha * np.sin(theta)


class InversePark(Block):
    """alpha = d cos theta - q sin theta, beta = d sin theta + q cos theta: undoes Park."""

    unit = Parameter("", structural=True, type="string", doc='unit of d, q, alpha and beta; "": unknown')
    d = Input(unit=unit, doc="direct component")
    q = Input(unit=unit, doc="quadrature component, 90 degrees ahead of d")
    theta = Input(unit="rad", doc="electrical angle of the d axis, from phase a")

    @output(unit=unit, doc="component along phase a")
    def alpha(d, q, theta):
        return d * np.cos(theta) - q * np.sin(theta)

    @output(unit=unit, doc="component 90 degrees ahead of phase a")
    def beta(d, q, theta):
        return d * np.sin(theta) + q * np.cos(theta)
