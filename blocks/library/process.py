"""Plants of process control."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import crossing, local, output, requires
from ..contract.variables import Discrete, Input, Parameter, State

__all__ = ["Tank"]


class Tank(Block):
    """A dh/dt = q - q_out - q_over: an upright tank that drains by its own weight, after Torricelli.

        q_out = valve c a_out sqrt(2 g h)

    It runs over at the height H: while it is full and more flows in than out, the level is constant and the rest is
    q_over. A q below 0 pumps out, until the tank is empty. These instants are located. A full tank without inflow is
    empty after A/(c a_out) sqrt(2 H/g). For tanks in a row, wire q_out to q of the next tank.

    References: K. H. Johansson, The quadruple-tank process, IEEE Trans. Control Systems Technology 8 (2000) 456-465.
    """

    A = Parameter(1.0, unit="m2", positive=True, doc="cross-section of the tank")
    a_out = Parameter(0.01, unit="m2", min=0.0, doc="cross-section of the outlet")
    c = Parameter(1.0, unit="1", min=0.0, max=1.0, doc="coefficient of discharge, 0.6 for a sharp edge")
    H = Parameter(2.0, unit="m", positive=True, doc="height of the tank")
    g = Parameter(9.81, unit="m/s2", positive=True, doc="gravity")
    q = Input(unit="m3/s", doc="flow into the tank")
    valve = Input(1.0, unit="1", doc="opening of the outlet, from 0 to 1")
    h = State(0.0, unit="m", output=True, doc="level")
    full = Discrete(type="bool", output=True, doc="whether the tank runs over")
    empty = Discrete(type="bool", output=True, doc="whether the tank is empty, and stays so")

    @requires("h_start must lie within 0 ... H")
    def is_within(h_start, H):
        return (h_start >= 0.0) & (h_start <= H)

    # A trial step may look below the bottom.
    @output(unit="m3/s", doc="flow out of the outlet")
    def q_out(h, valve, empty, c, a_out, g):
        return np.where(empty, 0.0, valve * c * a_out * np.sqrt(2.0 * g * np.maximum(h, 0.0)))

    @local(unit="m3/s", doc="flow that raises the level")
    def gain(q, q_out):
        return q - q_out

    @output(unit="m3/s", doc="flow over the edge")
    def q_over(gain, full):
        return np.where(full, gain, 0.0)

    @h.derivative
    def dh(gain, full, empty, A):
        return np.where(full | empty, 0.0, gain / A)

    @crossing(direction="down")
    def drained(h):
        return h

    @crossing(direction="down")
    def filled(h, H):
        return H - h

    @crossing(direction="down")
    def sinks(gain, full):
        return np.where(full, gain, 1.0)

    @crossing(direction="down")
    def refills(q, empty):
        return np.where(empty, -q, 1.0)

    @drained.reset(h)
    @filled.reset(h)
    def stop(h, H):
        return np.clip(h, 0.0, H)

    @empty.initial
    @drained.reset(empty)
    @refills.reset(empty)
    def is_empty(h, q):
        return (h <= 0.0) & (q <= 0.0)

    @full.initial
    @filled.reset(full)
    @sinks.reset(full)
    def is_full(h, H, gain):
        return (h >= H) & (gain >= 0.0)
