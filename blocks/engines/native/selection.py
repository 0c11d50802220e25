"""Which engine runs a Plan: the native one where it can, else the reference one, which says so."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from fractions import Fraction
from typing import Any

from ...compile.plan import Plan
from ...compile.toolchain.cache import of_user
from ...compile.toolchain.compiler import find_compiler
from ...compile.toolchain.isolation_build import compiled
from ...model.settings import RunSettings
from ...text.errors import CompilerError, Fault, UsageError, did_you_mean
from ..reference.simulation import Simulation
from ..run.inputs import InputTable
from ..run.memory_estimate import check_plan
from ..run.model_exchange import Foreigns
from ..run.saved_state import State
from .simulation import NativeSimulation, why_not
from .stiff import StiffSimulation

__all__ = ["ENGINES", "VARIABLE", "AnySimulation", "chosen", "simulation", "tell", "tell_cache"]

ENGINES = ("auto", "native", "reference")
VARIABLE = "BLOCKS_ENGINE"
"""The environment variable that names the engine where a run does not."""

AnySimulation = Simulation | NativeSimulation
_told: set[str] = set()


def simulation(
    engine: str | None,
    plan: Plan,
    settings: RunSettings,
    inputs: InputTable,
    log: tuple[str, ...],
    *,
    progress: Callable[[float], None] | None = None,
    resume: State | None = None,
) -> AnySimulation:
    """A run by an engine.

    engine: "native", "reference", "auto" (the native one where there is a compiler and it knows the method), or None:
    what the environment says, else "auto". Raises UsageError (E501) where the native one is asked for and cannot run
    the plan, or (E311) where the run cannot fit into memory, CompilerError (E60x) where it cannot be compiled, and what
    the engines raise.
    """
    asked = chosen(engine)
    begin = settings.start if resume is None else max(settings.start, Fraction(resume.snapshot.t))
    check_plan(plan, settings, begin, is_native=asked != "reference" and not why_not(plan, settings))
    arguments: dict[str, Any] = {"progress": progress, "resume": resume}
    if plan.foreign:  # which of them loaded before is remembered in the folder of the cache
        arguments["foreign"] = Foreigns.of(plan, settings, of_user(), compiled)
    if asked == "reference":
        return Simulation(plan, settings, inputs, log, **arguments)
    why = why_not(plan, settings)
    native = StiffSimulation if settings.method == "radau" else NativeSimulation
    if asked == "auto":
        if not why and find_compiler() is None:
            why = "no C compiler was found"
            tell(f"{why}: the reference engine runs, which is slower; see `blocks doctor`.")
        if why:
            return Simulation(plan, settings, inputs, log, **arguments)
        try:
            made = native(plan, settings, inputs, log, **arguments)
        except CompilerError as error:
            fault = error.faults[0]
            if fault.place == "$CC":  # it was asked for
                raise
            tell(f"{fault.message} The reference engine runs, which is slower ({fault.code}).")
            return Simulation(plan, settings, inputs, log, **arguments)
        tell_cache()
        return made
    if why:
        raise UsageError(Fault("E501", "engine", f"the native engine cannot run this: {why}.", 'Use engine="auto".'))
    made = native(plan, settings, inputs, log, **arguments)
    tell_cache()
    return made


def chosen(engine: str | None) -> str:
    """The name of an engine. Raises UsageError (E501) where there is none of that name."""
    name = engine if engine is not None else os.environ.get(VARIABLE, "") or "auto"
    if name in ENGINES:
        return name
    place = "engine" if engine is not None else VARIABLE
    cure = did_you_mean(str(name)[:60], ENGINES) or f"Engines: {', '.join(ENGINES)}."
    raise UsageError(Fault("E501", place, f"{str(name)[:60]!r} is not known.", cure))


def tell_cache() -> None:
    """Why compiled code is kept in a temporary folder, where it is."""
    place = of_user()
    if place.is_temporary:
        tell(f"{place.reason}; compiled code is kept in a temporary folder until this process ends.")


def tell(message: str) -> None:
    """Once in a process."""
    if message not in _told:
        _told.add(message)
        warnings.warn(message, RuntimeWarning, stacklevel=6)
