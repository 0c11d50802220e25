"""Drawing: a diagram as SVG, laid out automatically.

    svg(diagram, ports_of(diagram, resolver))

The stages: `diagram_parts` (names) -> `piece` (shapes) -> `layout_graph` (nodes and nets) -> `layered`, or `pinned`
where the file gives positions, with wires by `maze` -> `picture` (places) -> `svg`. `compose` runs them level by level.
"""

from .compose import picture
from .diagram_parts import Ports, ports_of
from .picture import Picture
from .svg import rendered, svg

__all__ = ["Picture", "Ports", "picture", "ports_of", "rendered", "svg"]
