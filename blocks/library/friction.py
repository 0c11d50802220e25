"""Dry friction: Coulomb's, with exact instants of sticking and slipping, and the bristles of the LuGre model."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["CoulombFriction", "LuGreFriction"]


class CoulombFriction(Block):
    """A mass on a dry surface: m dv/dt = F - friction, with dx/dt = v.

        friction = Fc slip + b v     while it slips

    slip is the direction of the slip, 1 or -1. While the mass sticks, slip is 0, and friction is F: v stays 0. It
    begins to slip when |F| reaches Fs, in the direction of F. It comes to rest when v reaches 0 under a smaller |F|; a
    larger |F| turns it back at once. Both instants are located, and at rest v is 0 exactly: the mass neither creeps nor
    chatters. F is the sum of all other forces, such as springs and drives. For a body that turns, set motion "rotary":
    m is its inertia, F a torque, v a speed in rad/s.

    References: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and
        compensation methods for the control of machines with friction, Automatica 30 (1994) 1083-1138.
    """

    motion = Parameter("linear", structural=True, choices=("linear", "rotary"), doc="whether it slides or turns")
    m = Parameter(1.0, unit=lambda motion: _of(motion, "kg", "kg.m2"), positive=True, doc="mass, or inertia")
    Fc = Parameter(1.0, unit=lambda motion: _of(motion, "N", "N.m"), min=0.0, doc="Coulomb friction, while it slips")
    Fs = Parameter(
        lambda Fc: Fc, unit=lambda motion: _of(motion, "N", "N.m"), min=0.0, doc="force that breaks it away from rest"
    )
    b = Parameter(0.0, unit=lambda motion: _of(motion, "N.s/m", "N.m.s/rad"), min=0.0, doc="viscous friction")
    F = Input(unit=lambda motion: _of(motion, "N", "N.m"), doc="sum of all other forces on the mass")
    x = State(unit=lambda motion: _of(motion, "m", "rad"), output=True, doc="position")
    v = State(unit=lambda motion: _of(motion, "m/s", "rad/s"), output=True, doc="velocity")
    slip = Discrete(type="int", output=True, doc="1 or -1 while it slips to this side, 0 while it sticks")

    @requires("Fs must not be below Fc")
    def is_ordered(Fc, Fs):
        return Fc <= Fs

    @slip.initial
    def begins(v, F, Fs):
        return np.where(v == 0.0, _side(F, Fs), np.sign(v))

    @crossing(direction="down")
    def stops(v, slip):
        return np.where(slip == 0, 1.0, slip * v)

    @crossing(direction="up")
    def breaks_away(F, Fs, slip):
        return np.where(slip == 0, np.abs(F) - Fs, -1.0)

    @stops.reset(v)
    def rest():
        return 0.0

    @stops.reset(slip)
    @breaks_away.reset(slip)
    def side(F, Fs):
        return _side(F, Fs)

    @output(unit=lambda motion: _of(motion, "N", "N.m"), doc="friction, against the motion or against F")
    def friction(v, F, slip, Fc, b):
        return np.where(slip == 0, F, Fc * slip + b * v)

    @x.derivative
    def dx(v):
        return v

    @v.derivative
    def dv(F, friction, m):
        return (F - friction) / m


def _of(motion, linear, rotary):
    return linear if motion == "linear" else rotary


def _side(F, Fs):
    """To which side a force moves what rests; without friction, Fs = 0, it rests at no force."""
    return np.where(np.abs(F) < Fs, 0.0, np.where(F >= 0.0, 1.0, -1.0))


class LuGreFriction(Block):
    """F = sigma0 z + sigma1 dz/dt + sigma2 v: friction of two surfaces that touch with elastic bristles, bent by z.

        dz/dt = v - sigma0 |v| z/g

    g falls from Fs to Fc with the speed, after Stribeck: `g = Fc + (Fs - Fc) exp(-(v/vs)^2)`. F acts against v. The
    model shows the spring before slip, the peak at break-away, the drop of force with speed that causes stick-slip, and
    the lag behind v. In steady slip the bristles bear g against v. z is of the size Fc/sigma0, micrometers, and follows
    v within Fc/(sigma0 |v|): at high speeds that is stiff, and radau suits better. Default values are those of [1].

    References:
        [1] C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of systems with friction,
            IEEE Trans. Automatic Control 40 (1995) 419-425.
    """

    sigma0 = Parameter(1e5, unit="N/m", positive=True, doc="stiffness of the bristles")
    sigma1 = Parameter(np.sqrt(1e5), unit="N.s/m", min=0.0, doc="damping of the bristles")
    sigma2 = Parameter(0.4, unit="N.s/m", min=0.0, doc="viscous friction")
    Fc = Parameter(1.0, unit="N", positive=True, doc="Coulomb friction")
    Fs = Parameter(1.5, unit="N", positive=True, doc="static friction")
    vs = Parameter(0.001, unit="m/s", positive=True, doc="Stribeck velocity, over which Fs falls to Fc")
    v = Input(unit="m/s", doc="velocity of the surfaces against each other")
    z = State(unit="m", output=True, nominal=lambda Fc, sigma0: Fc / sigma0, doc="mean deflection of the bristles")

    @requires("Fs must not be below Fc")
    def is_ordered(Fc, Fs):
        return Fc <= Fs

    @local(unit="N", doc="friction of steady slip, without the viscous part")
    def g(v, Fc, Fs, vs):
        return Fc + (Fs - Fc) * np.exp(-((v / vs) ** 2))

    @local(unit="m/s", doc="rate of the deflection")
    def rate(v, z, g, sigma0):
        return v - sigma0 * np.abs(v) * z / g

    @z.derivative
    def dz(rate):
        return rate

    @output(unit="N", doc="friction, against v")
    def F(z, rate, v, sigma0, sigma1, sigma2):
        return sigma0 * z + sigma1 * rate + sigma2 * v
