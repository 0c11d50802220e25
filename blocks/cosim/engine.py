"""Which engine runs a diagram: one solver for a Plan, a master for a Coupling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import CompilerError, Fault, FMUError, UsageError
from ..fmi.instance import Loaded, open_fmu
from ..native.cache import of_user
from ..native.compile import find_compiler
from ..native.engine import AnySimulation, chosen, tell
from ..native.engine import simulation as alone
from ..native.hosts import compiled
from ..native.simulation import why_not
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
    arguments: dict[str, Any] = {"open_unit": loaded, "progress": progress, "resume": resume}
    why = _why_not(what, settings)
    if asked == "native" and why:
        message = f"the native engine cannot run this: {why}."
        raise UsageError(Fault("E501", "engine", message, 'Use engine="auto".'))
    if asked == "native" or (asked == "auto" and not why and find_compiler() is not None):
        try:
            return NativeMaster(what, settings, inputs, log, **arguments)
        except CompilerError as error:
            if asked == "native" or error.faults[0].place == "$CC":  # it was asked for
                raise
            tell(f"{error.faults[0].message} The reference engine runs, which is slower ({error.code}).")
    elif asked == "auto" and not why:
        tell("no C compiler was found: the reference engine runs, which is slower; see `blocks doctor`.")
    return MasterSimulation(what, settings, inputs, log, **arguments)


def _why_not(coupling: Coupling, settings: RunSettings) -> str:
    """Why compiled code cannot step a diagram, in words; "" where it can."""
    for unit in coupling.units:
        if unit.plan is not None and unit.plan.states and settings.method == "radau":
            return f"radau integrates {unit.place} in Python"
        if unit.plan is not None and (why := why_not(unit.plan, settings)):
            return why
    return ""


def loaded(unit: Unit) -> Loaded:
    """The FMU of a unit, loaded; what loaded once is remembered in the folder of the cache."""
    foreign = unit.foreign
    assert foreign is not None
    if foreign.isolate:
        made = open_fmu(foreign.path, foreign.kind, isolate=True, timeout=foreign.timeout, compiled=compiled)
    else:
        made = open_fmu(foreign.path, foreign.kind, notes=of_user())
    if made.description.token != foreign.description.token:
        made.close()
        message = f"{foreign.path.name} is another FMU than when the diagram was made."
        raise FMUError(Fault("E205", unit.place, message, "Load the diagram again."))
    return made
