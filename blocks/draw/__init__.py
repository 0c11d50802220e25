"""Drawing: a diagram as SVG, laid out by itself.

    svg(diagram, ports_of(diagram, resolver))

The way of a diagram: `parts` (names) -> `piece` (shapes) -> `graph` (nodes and nets) -> `layered`, or `pinned` where
the file gives positions -> `picture` (places) -> `svg`. `compose` leads it, level by level.
"""

from .compose import picture
from .picture import Picture
from .ports import Ports, ports_of
from .svg import rendered, svg

__all__ = ["Picture", "Ports", "picture", "ports_of", "rendered", "svg"]
