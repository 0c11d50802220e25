"""How the master steps a diagram, in words."""

from __future__ import annotations

from collections.abc import Iterator

from ...compile.coupling import CoupledUnit, Coupling
from .stepped_units import tolerance_of, way_of

__all__ = ["lines", "own_tolerance"]

_WAYS = {
    "exact": "inputs follow their courses exactly",
    "derivatives": "inputs by their derivatives",
    "intermediate": "inputs by intermediate update",
    "mean": "inputs by their mean over a step (order 2 at best)",
    "hold": "inputs are held",
}


def lines(coupling: Coupling) -> Iterator[str]:
    """Algorithm and units: how far each step goes, how inputs reach each unit, and what cannot go back."""
    master = coupling.settings.master
    control = f", error held to {master.tolerance:g}" if master.tolerance is not None else ""
    yield f"master: {master.algorithm}, inputs of order {master.order}{control}"
    for k in coupling.order:
        yield f"  {_told(coupling.units[k], coupling)}"
    if coupling.measures:
        yield "  measures: of the values at communication points, joined by straight lines; what is between is not seen"


def own_tolerance(unit: CoupledUnit, coupling: Coupling) -> float | None:
    """The tolerance that is given to the solver of an FMU, where it is not that of the run."""
    told = None if unit.foreign is None else tolerance_of(unit, coupling)
    return None if told == coupling.settings.rtol else told


def _told(unit: CoupledUnit, coupling: Coupling) -> str:
    master = coupling.settings.master
    if unit.foreign is None:
        assert unit.plan is not None
        what = ", ".join(instance.path for instance in unit.plan.instances[:5] if not instance.hidden)
        name = unit.path or f"blocks with equations ({what}{', ...' if len(unit.plan.instances) > 5 else ''})"
    else:
        name = f"{unit.path} (FMI {unit.foreign.description.fmi})"
    step = "" if master.tolerance is not None else f"every {float(unit.step):g} s; "
    way = _WAYS[way_of(unit)] if master.order or unit.foreign is None else "inputs are held"
    rest = ""
    if (own := own_tolerance(unit, coupling)) is not None:
        rest = f"; its own tolerance, {own:g}"
    if not unit.can_go_back:
        rest += "; cannot go back"
        if master.algorithm == "iterated":
            rest += ": its inputs are extrapolated, and only the others are iterated"
        elif master.tolerance is not None:
            rest += ": the error is estimated by what was predicted"
    return f"{name}: {step}{way}{rest}"
