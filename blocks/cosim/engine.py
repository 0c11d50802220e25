"""Which engine runs a diagram: one solver for a Plan, a master for a Coupling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..fmi.instance import Loaded, open_fmu
from ..native.cache import of_user
from ..native.compile import find_compiler
from ..native.engine import AnySimulation, chosen
from ..native.engine import simulation as alone
from ..native.hosts import compiled
from ..plan import Plan
from ..run.inputs import InputTable
from ..settings import RunSettings
from .coupling import Coupling, Unit
from .master import MasterSimulation
from .native import NativeMaster

__all__ = ["loaded", "simulation"]


def simulation(
    engine: str | None,
    what: Plan | Coupling,
    settings: RunSettings,
    inputs: InputTable,
    log: tuple[str, ...],
    *,
    progress: Callable[[float], None] | None = None,
    resume: Any = None,
) -> AnySimulation | MasterSimulation:
    """A run by an engine; arguments and errors as of `blocks.native.engine.simulation`."""
    if isinstance(what, Plan):
        return alone(engine, what, settings, inputs, log, progress=progress, resume=resume)
    asked = chosen(engine)
    kind = NativeMaster if asked == "native" or (asked == "auto" and find_compiler() is not None) else MasterSimulation
    return kind(what, settings, inputs, log, open_unit=loaded, progress=progress, resume=resume)


def loaded(unit: Unit) -> Loaded:
    """The FMU of a unit, loaded; what loaded once is remembered in the folder of the cache."""
    foreign = unit.foreign
    assert foreign is not None
    if not foreign.isolate:
        return open_fmu(foreign.path, foreign.kind, notes=of_user())
    return open_fmu(foreign.path, foreign.kind, isolate=True, timeout=foreign.timeout, compiled=compiled)
