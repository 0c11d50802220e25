"""Famous nonlinear oscillators."""

from ..contract.block import Block
from ..contract.variables import Input, Parameter, State

__all__ = ["Lorenz", "VanDerPol"]


class VanDerPol(Block):
    """dx/dt = v, dv/dt = mu (1 - x^2) v - x + u: an oscillation that gains energy while |x| < 1, and loses it beyond.

    From every start but rest it reaches one limit cycle, of an amplitude near 2 for every mu > 0. For small mu it is a
    sine of the period 2 pi; for large mu it is a relaxation oscillation with a period near 1.614 mu, and stiff: use
    radau. No number has a unit.

    References: B. van der Pol, On relaxation-oscillations, Philosophical Magazine 2 (1926) 978-992.
    """

    mu = Parameter(1.0, min=0.0, doc="strength of the nonlinear damping")
    u = Input(0.0, doc="force from outside")
    x = State(2.0, output=True, doc="position")
    v = State(output=True, doc="velocity")

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(x, v, u, mu):
        return mu * (1.0 - x**2) * v - x + u


class Lorenz(Block):
    """dx/dt = sigma (y - x), dy/dt = x (rho - z) - y, dz/dt = x y - beta z: convection, and deterministic chaos.

    For rho > 1 there are two points of rest: |x| and |y| are sqrt(beta (rho - 1)), and z is rho - 1. With the default
    values they are unstable, and the distance of neighboring solutions grows by a factor e in some 1.1 s: runs whose
    methods or tolerances differ agree for a while only. Only time has a unit.

    References: E. N. Lorenz, Deterministic nonperiodic flow, J. Atmospheric Sciences 20 (1963) 130-141.
    """

    sigma = Parameter(10.0, doc="Prandtl number")
    rho = Parameter(28.0, doc="Rayleigh number over its critical value")
    beta = Parameter(8.0 / 3.0, doc="shape of the convection rolls")
    x = State(1.0, output=True, doc="intensity of the convection")
    y = State(1.0, output=True, doc="difference of temperature between rising and sinking fluid")
    z = State(1.0, output=True, doc="distortion of the vertical profile of temperature")

    @x.derivative
    def dx(x, y, sigma):
        return sigma * (y - x)

    @y.derivative
    def dy(x, y, z, rho):
        return x * (rho - z) - y

    @z.derivative
    def dz(x, y, z, beta):
        return x * y - beta * z
