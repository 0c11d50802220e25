"""Wiring: blocks that only re-arrange signals. They cost nothing, and dependencies go through them one by one."""

from ..declare import Block, Input, Parameter, wiring

__all__ = ["Demux", "Mux"]


class Mux(Block):
    """y = [u1, u2, ...]: scalars become a vector, and each keeps its unit."""

    size = Parameter(2, structural=True, type="int", min=1, doc="number of inputs")
    u = Input(shape=lambda size: size, ports="u{}", doc="elements")

    @wiring(shape=lambda size: size, doc="vector of the inputs")
    def y(u):
        return u


class Demux(Block):
    """[y1, y2, ...] = u: a vector becomes scalars, and each keeps its unit."""

    size = Parameter(2, structural=True, type="int", min=1, doc="number of outputs")
    u = Input(shape=lambda size: size, doc="vector")

    @wiring(shape=lambda size: size, ports="y{}", doc="elements of the vector")
    def y(u):
        return u
