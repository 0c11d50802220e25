"""A diagram drawn with what was found to be wrong with it."""

from __future__ import annotations

from collections.abc import Callable

from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..draw import ports_of, svg
from ..model.diagram_value import DiagramValue
from ..model.hierarchy import Resolver
from ..text.errors import BlocksError, Fault


class Drawing(str):
    """The text of an SVG, which a notebook shows as a picture."""

    def _repr_svg_(self) -> str:
        return str(self)


def drawn(value: DiagramValue, resolver: Resolver, depth: int, check: Callable[[], Plan | Coupling]) -> str:
    """Return the text of an SVG. check: returns the compiled diagram with its warnings, or raises its faults."""
    faults: tuple[Fault, ...] = ()
    rates: dict[str, str] = {}
    try:
        planned = check()
        faults, rates = planned.warnings, planned.rate_labels
    except BlocksError as error:
        faults = error.faults
    return Drawing(svg(value, ports_of(value, resolver), depth=depth, faults=faults, rates=rates))
