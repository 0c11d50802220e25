"""Wiring: blocks that only re-arrange signals. They cost nothing, and dependencies go through them one by one."""

import re

from ..contract.block import Block
from ..contract.equations import requires, wiring
from ..contract.variables import Input, Parameter

__all__ = ["Demux", "Mux", "Selector"]


_is_name = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII).fullmatch


def _count(names):
    """As many as there are names; 2 where there are none."""
    return names.count(",") + 1 if names else 2


class Mux(Block):
    """y = [u1, u2, ...]: scalars become a vector, and each keeps its unit.

    With names it is a bus: with "x, y, theta" wires, outputs, measures and the log may say y[theta] for the third
    element, wherever the vector arrives, through subdiagrams and Selector too.
    """

    names = Parameter("", structural=True, type="string", doc='names of the elements, "x, y, theta"; "": none')
    size = Parameter(_count, structural=True, type="int", min=1, doc="number of inputs")
    u = Input(shape=lambda size: size, ports="u{}", doc="elements")

    @requires("names must be one for each input, different, of letters, digits and _, with commas between")
    def is_bus(names, size):
        given = [name.strip() for name in names.split(",")]
        return not names or (len({*given}) == size == len(given) and all(map(_is_name, given)))

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


class Selector(Block):
    """y = [u[i] for i in elements]: elements of a vector, counted from 0, in any order and any number of times.

    Each element keeps its unit. For one element as a scalar no block is needed: a wire can begin at u[i].
    """

    elements = Parameter([0], structural=True, type="int", shape="m", doc="numbers of the elements, from 0 on")
    size = Parameter(
        lambda elements: max(elements, default=0) + 1, structural=True, type="int", min=1, doc="number of inputs"
    )
    u = Input(shape=lambda size: size, doc="vector to choose from")

    @requires("elements must be numbers of elements of u, from 0 to size - 1, and not be empty")
    def exist(elements, size):
        return len(elements) > 0 and all(0 <= i < size for i in elements)

    @wiring(shape=lambda m: m, doc="the chosen elements")
    def y(u, elements):
        return u[list(elements)]
