"""Which engine runs a diagram: one solver for a Plan, a master for a Coupling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..compile.coupling import Coupling, Unit
from ..compile.plan import Plan
from ..compile.toolchain.cache import of_user
from ..compile.toolchain.compiler import find_compiler
from ..compile.toolchain.isolation_build import compiled
from ..fmi.instance import Loaded, open_fmu
from ..model.settings import RunSettings
from ..text.errors import CompilerError, Fault, FMUError, UsageError
from .master.native_master import NativeMaster
from .master.simulation import MasterSimulation
from .native.selection import AnySimulation, chosen, tell, tell_cache
from .native.selection import simulation as alone
from .native.simulation import why_not
from .run.inputs import InputTable
from .run.memory_estimate import COPIES, check, check_plan, no_room

__all__ = ["check_room", "loaded", "simulation"]


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
    """A run by an engine; arguments and errors as of `blocks.engines.native.selection.simulation`."""
    try:
        if isinstance(what, Plan):
            return alone(engine, what, settings, inputs, log, progress=progress, resume=resume)
        return _master(engine, what, settings, inputs, log, progress=progress, resume=resume)
    except MemoryError:
        raise no_room(what.name, float(settings.start), 0.0) from None


def check_room(what: Plan | Coupling, settings: RunSettings) -> None:
    """Raise UsageError (E311) where a run, as far as that is known before it begins, cannot fit into memory."""
    if isinstance(what, Plan):
        check_plan(what, settings, settings.start, is_native=not why_not(what, settings))
    else:
        check(what.name, _rows_of(what, settings), len(what.columns), _of_measures(what, settings))


def _points_of(coupling: Coupling, settings: RunSettings) -> int:
    """At least so many communication points there are; 0 where steps are controlled, or there is no end."""
    if settings.stop is None or settings.master.tolerance is not None:
        return 0
    return int((settings.stop - settings.start) / min(unit.step for unit in coupling.units)) + 1


def _rows_of(coupling: Coupling, settings: RunSettings) -> int:
    """At least so many rows are recorded."""
    if settings.stop is None or settings.every is None:
        return _points_of(coupling, settings)
    return int((settings.stop - settings.start) / settings.every) + 1


def _of_measures(coupling: Coupling, settings: RunSettings) -> float:
    """Bytes of what is measured at all communication points."""
    width = 2 + 2 * len(coupling.measures)
    return 8.0 * COPIES * width * _points_of(coupling, settings) if coupling.measures else 0.0


def _master(
    engine: str | None,
    what: Coupling,
    settings: RunSettings,
    inputs: InputTable,
    log: tuple[str, ...],
    *,
    progress: Callable[[float], None] | None,
    resume: Any,
) -> MasterSimulation:
    check_room(what, settings)
    asked = chosen(engine)
    arguments: dict[str, Any] = {"open_unit": loaded, "progress": progress, "resume": resume}
    why = _why_not(what, settings)
    if asked == "native" and why:
        message = f"the native engine cannot run this: {why}."
        raise UsageError(Fault("E501", "engine", message, 'Use engine="auto".'))
    if asked == "native" or (asked == "auto" and not why and find_compiler() is not None):
        try:
            made = NativeMaster(what, settings, inputs, log, **arguments)
        except CompilerError as error:
            if asked == "native" or error.faults[0].place == "$CC":  # it was asked for
                raise
            tell(f"{error.faults[0].message} The reference engine runs, which is slower ({error.code}).")
        else:
            tell_cache()
            return made
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
