"""Which engine runs a diagram: the native one where it can, else the reference one, which says so.

An engine is imported when it is first taken: a run needs one of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..compile.c.runtime_grid import why_not
from ..compile.coupling import CoupledUnit, Coupling
from ..compile.inputs import InputTable
from ..compile.plan import Plan
from ..compile.toolchain.cache import of_user
from ..compile.toolchain.compiler import find_compiler
from ..compile.toolchain.isolation_build import compiled
from ..host.user_warning import warn_user
from ..text.errors import CompilerError, Fault, FMUError, UsageError, did_you_mean
from .driver import Simulation
from .run.engine import ENGINES, VARIABLE, Engine
from .run.memory_estimate import COPIES_OF_MASTER, check, check_plan, no_room
from .run.saved_state import State

if TYPE_CHECKING:
    from ..fmi.loading import Loaded
    from ..fmi.trace import Tracer
    from .run.model_exchange import Foreigns

_told: set[str] = set()


def simulation(
    what: Plan | Coupling,
    inputs: InputTable,
    *,
    engine: str | None = None,
    progress: Callable[[float], None] | None = None,
    state: State | None = None,
    model: Any = None,
    programs: Any = None,
    is_streamed: bool = False,
    tracer: Tracer | None = None,
) -> Simulation:
    """A run, by an engine, that stands at its start, or where a saved one stood.

    engine: "native", "reference", "auto" (the native one where there is a compiler and it can run this), or None:
    what the environment says, else "auto". model: that of a Plan that differs in values alone, compiled; programs:
    those that the reference engine has printed for such a one. is_streamed: its rows go to a file. tracer: of the
    calls of its FMUs. Raises UsageError (E501) where the native one is asked for and cannot run this, or (E311)
    where the run cannot fit into memory, CompilerError (E60x) where it cannot be compiled, and what the run raises.
    """
    try:
        name, why = _chosen(engine), why_not(what)
        begin = what.settings.start if state is None else max(what.settings.start, Fraction(state.t))
        check_room(what, begin, is_native=name != "reference" and not why, is_streamed=is_streamed)
        if name == "native" and why:
            message = f"the native engine cannot run this: {why}."
            raise UsageError(Fault("E501", "engine", message, 'Use engine="auto".'))
        if name == "auto" and why:
            _tell(f"{why}: the reference engine runs, which is slower.")
        has_no_compiler = name == "auto" and not why and find_compiler() is None
        if has_no_compiler:
            why = "no C compiler was found"
            _tell(f"{why}: the reference engine runs, which is slower; see `blocks doctor`.")
        native: Engine | None = None
        if name != "reference" and not why:
            try:
                native = _native(what, inputs, model, tracer)
            except CompilerError as error:
                fault = error.faults[0]
                if name == "native" or fault.place == "$CC":  # it was asked for
                    raise
                _tell(f"{fault.message} The reference engine runs, which is slower ({fault.code}).")
            else:
                if model is None:
                    _tell_cache()
        return Simulation(native or _reference(what, inputs, programs, tracer), progress=progress, state=state)
    except MemoryError:
        raise no_room(what.name, float(what.settings.start), 0.0) from None


def compiled_model(what: Plan | Coupling, *, engine: str | None = None, lanes: Any = None) -> Any:
    """The compiled model of a Plan, for `simulation`; None where another engine runs it. Raises CompilerError (E60x)
    where the native one is asked for and it cannot be compiled. lanes: the `Machine` whose lanes run several at once.
    """
    name = _chosen(engine)
    if not isinstance(what, Plan):
        return None
    if name == "reference" or why_not(what) or find_compiler() is None:
        return None  # a run says why, if it must
    from .native.model import model_of

    try:
        return model_of(what, what.log, what.settings.method, lanes=lanes)
    except CompilerError as error:
        if name == "native" or error.faults[0].place == "$CC":
            raise
        return None


def _native(what: Plan | Coupling, inputs: InputTable, model: Any, tracer: Tracer | None) -> Engine:
    if isinstance(what, Coupling):
        from .master.native_master import NativeMaster, master_code

        return NativeMaster(what, inputs, _loaded, master_code(), tracer)
    from .native.native_engine import NativeEngine

    return NativeEngine(what, inputs, foreign=_foreigns(what, tracer), model=model)


def _reference(what: Plan | Coupling, inputs: InputTable, programs: Any, tracer: Tracer | None) -> Engine:
    if isinstance(what, Coupling):
        from .master.master import ReferenceMaster

        return ReferenceMaster(what, inputs, _loaded, tracer)
    from .reference.reference_engine import ReferenceEngine

    return ReferenceEngine(what, inputs, compiled=programs, foreign=_foreigns(what, tracer))


def _foreigns(plan: Plan, tracer: Tracer | None) -> Foreigns | None:
    """Its FMUs for Model Exchange. Which of them loaded before is remembered in the folder of the cache."""
    if not plan.foreign:
        return None
    from .run.model_exchange import Foreigns

    return Foreigns.of(plan, of_user(), compiled, tracer)


def _chosen(engine: str | None) -> str:
    """The name of an engine. Raises UsageError (E501) where there is none of that name."""
    name = engine if engine is not None else os.environ.get(VARIABLE, "") or "auto"
    if name in ENGINES:
        return name
    place = "engine" if engine is not None else VARIABLE
    cure = did_you_mean(str(name)[:60], ENGINES) or f"Engines: {', '.join(ENGINES)}."
    raise UsageError(Fault("E501", place, f"{str(name)[:60]!r} is not known.", cure))


def _tell_cache() -> None:
    """Why compiled code is kept in a temporary folder, where it is."""
    place = of_user()
    if place.is_temporary:
        _tell(f"{place.reason}; compiled code is kept in a temporary folder until this process ends.")


def _tell(message: str) -> None:
    """Warn, once in a process."""
    if message not in _told:
        _told.add(message)
        warn_user(message)


# --- memory ----------------------------------------------------------------------------------------------------------


def check_room(
    what: Plan | Coupling,
    begin: Fraction | None = None,
    *,
    is_native: bool | None = None,
    is_streamed: bool = False,
) -> None:
    """Raise UsageError (E311) where a run, as far as that is known before it begins, cannot fit into memory."""
    settings = what.settings
    if isinstance(what, Plan):
        is_native = not why_not(what) if is_native is None else is_native
        check_plan(what, settings.start if begin is None else begin, is_native=is_native, is_streamed=is_streamed)
        return
    points = 0  # at least so many communication points; not known where steps are controlled, or there is no end
    if settings.stop is not None and settings.master.tolerance is None:
        points = int((settings.stop - settings.start) / what.shortest) + 1
    rows = points  # at least so many
    if settings.stop is not None and settings.every is not None:
        rows = int((settings.stop - settings.start) / settings.every) + 1
    width = 2 + 2 * len(what.measures)
    of_measures = 8.0 * COPIES_OF_MASTER * width * points if what.measures else 0.0
    check(what.name, 0 if is_streamed else rows, len(what.columns), of_measures, copies=COPIES_OF_MASTER)


def _loaded(unit: CoupledUnit) -> Loaded:
    """The FMU of a unit, loaded; what loaded once is remembered in the folder of the cache."""
    from ..fmi.loading import open_fmu

    foreign = unit.foreign
    assert foreign is not None
    if foreign.isolate:
        loaded = open_fmu(foreign.path, foreign.kind, isolate=True, timeout=foreign.timeout, compiled=compiled)
    else:
        loaded = open_fmu(foreign.path, foreign.kind, notes=of_user())
    if loaded.description.token != foreign.description.token:
        loaded.close()
        message = f"the file {foreign.path.name} has changed since the diagram was loaded."
        raise FMUError(Fault("E205", unit.place, message, "Load the diagram again."))
    return loaded
