"""Mechanics with impacts."""

import numpy as np

from ..declare import Block, Discrete, Parameter, State, crossing, requires

__all__ = ["BouncingBall"]


class BouncingBall(Block):
    """A ball above a floor: dh/dt = v, dv/dt = -g; an impact turns v into -e v.

    An impact that would send it up with less than v_rest lays it to rest on the floor for good: without that rule
    the impacts of a ball with e < 1 pile up at a finite time, and no run gets beyond it. From the height h_start, at
    rest, the impacts are at T, T (1 + 2 e), T (1 + 2 e + 2 e^2), ... with T = sqrt(2 h_start/g).
    """

    g = Parameter(9.81, unit="m/s2", positive=True, doc="gravity")
    e = Parameter(0.7, min=0.0, max=1.0, doc="coefficient of restitution")
    v_rest = Parameter(1e-3, unit="m/s", min=0.0, doc="speed below which the ball stays on the floor")
    h = State(1.0, unit="m", output=True, doc="height above the floor")
    v = State(unit="m/s", output=True, doc="velocity, upwards")
    resting = Discrete(type="bool", output=True, doc="whether the ball lies on the floor for good")

    @requires("the ball must start on the floor or above it")
    def is_above(h_start):
        return h_start >= 0

    @h.derivative
    def dh(v, resting):
        return np.where(resting, 0.0, v)

    @v.derivative
    def dv(g, resting):
        return np.where(resting, 0.0, -g)

    @crossing(direction="down")
    def impact(h):
        return h

    @impact.reset(h)
    def lift():
        # The located instant lies a rounding error below the floor. From there a short flight might not reach the
        # floor's other side, and its end would go unseen.
        return 0.0

    @impact.reset(v)
    def rebound(v, e, v_rest):
        return np.where(-e * v < v_rest, 0.0, -e * v)

    @impact.reset(resting)
    def settle(v, e, v_rest):
        return -e * v < v_rest
