"""Where a diagram stands: the point around which it is linear, from its start or from a run that led there."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compile.plan import Plan
from ..contract.captured_values import Outside
from ..engines.prepared import Prepared
from ..engines.reference.reference_engine import ReferenceEngine
from ..engines.run.saved_state import State
from ..linear.operating_point import OperatingPoint
from ..linear.point import Point
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..model.hierarchy import Resolver
from ..model.trust import Paths
from ..text.errors import AnalysisError, Fault, UsageError
from .case import Case, key_of
from .checks import coupled_block, flat_of, instead_of_steps
from .given_values import at_rest, time_of
from .last_made import LastMade, names_files
from .run import Run, RunOptions, engine_of, started

MOST_KEPT = 3
"""Forms of a model that are kept ready for other points."""


def point_of(
    value: DiagramValue, resolver: Resolver, at: OperatingPoint | Run | float | None, case: Case, last: LastMade
) -> Point:
    """Return where a diagram is at a time. last: where its last point is kept."""
    if isinstance(at, (OperatingPoint, Run)) and case.words.keys() - {"trust"}:
        whose, cure = "the operating point has", "Give them to find_operating_point."
        if isinstance(at, Run):
            whose, cure = "the run has", "Give them when you start the run, or set them in the run."
        raise UsageError(Fault("E501", "at", f"{whose} its inputs, parameters and settings already.", cure))
    if isinstance(at, Run):
        return _of_run(at, case.trust)
    if isinstance(at, OperatingPoint):
        if at.point is None:
            message = "was found by a run with Co-Simulation FMUs, which hide their states: it has no linear model."
            cure = "Import them as Model Exchange, or estimate the response by simulation."
            raise AnalysisError(Fault("E703", at.name, message, cure))
        return at.point
    key = (id(value), value, at, repr(key_of(case.without("trust").words)))
    known: tuple[Point, tuple[Outside, ...]] | None = last.known("point", key)
    if known is not None and all(read.holds() for read in known[1]):
        return known[0]
    point = Point.of(_standing(value, resolver, case, at, last, is_silent=True))
    if not np.isfinite(point.outputs).all():
        _standing(value, resolver, case, at, last, is_silent=False)  # reports where, if recorded
    if not point.plan.foreign and not names_files(value):
        tapes = {id(instance.tape): instance.tape for instance in point.plan.instances}.values()
        outside = tuple(tape.outside for tape in tapes if tape.outside is not None)
        last.keep("point", key, (point, outside))
    return point


def _of_run(run: Run, trust: Paths) -> Point:
    """Where a run stands, with all that was set in it. It can go on; its FMUs, which exist once, are looked at."""
    prepared = run.prepared
    _refuse_coupled(prepared.structure)
    if not any(block.interface.declaration.foreign is not None for block in prepared.structure.blocks):
        settings = {key: value for key, value in prepared.settings.items() if key not in ("start", "seed")}
        case = Case(engine="reference", trust=trust, **{**settings, "log": []})
        going = RunOptions(resume=run.snapshot())
        run = started(prepared.value, prepared.resolver, case, going, likes=[prepared])
    engine = engine_of(run)
    if not isinstance(engine, ReferenceEngine):
        cure = 'Start the run with engine="reference".'
        raise UsageError(
            Fault("E501", "at", "is a run with FMUs on the native engine, whose states cannot be read.", cure)
        )
    return Point.of(engine)


def _refuse_coupled(flat: Flat) -> None:
    coupled = coupled_block(flat)
    if coupled is not None:
        message = "is a Co-Simulation FMU, which hides its states, so that it has no linear model."
        cure = (
            f"{instead_of_steps(coupled)}, or estimate the response by simulation (estimate_response). "
            "overrides= takes the place of blocks and of Model Exchange FMUs only."
        )
        raise AnalysisError(Fault("E703", coupled.path, message, cure))


def _standing(
    given_value: DiagramValue, resolver: Resolver, case: Case, at: float | None, last: LastMade, *, is_silent: bool
) -> Any:
    """Return a run of the reference engine at a time. A silent run is not made to record signals.

    last: keeps the source of the run, for runs with other values of parameters.
    """
    value, case = case.of(given_value), case.updated(stop_when="")  # a run goes on to the time, whatever ends it
    key = (id(given_value), given_value, repr(case.variants))
    kept: tuple[Prepared, ...] = last.known("standing", key) or ()
    likes = [form for form in kept if form.is_current]

    def begun(case: Case, flat: Flat | None = None, resume: State | None = None) -> Run:
        run = started(value, resolver, case, RunOptions(resume=resume), flat, likes)
        form = run.prepared
        is_kept = isinstance(form.plan, Plan) and not form.plan.foreign and not names_files(given_value)
        if is_kept and not any(like.alike is form.alike for like in likes):
            likes.insert(0, form)
            last.keep("standing", key, tuple(likes[:MOST_KEPT]))
        return run

    silent = case.updated(log=[]) if is_silent else case
    if at is None and case.settings.get("log"):  # nothing is recorded, but its names are checked
        flat_of(given_value, resolver, case)
    like = next((form for form in likes if form.with_values(case.parameters, silent.settings) is not None), None)
    flat = flat_of(given_value, resolver, silent) if like is None else like.structure
    _refuse_coupled(flat)
    inputs = {**at_rest(value, flat), **case.named_inputs()}
    if at is None:
        return engine_of(begun(silent.updated(inputs=inputs, engine="reference"), flat if like is None else None))
    time = time_of("at", at)
    has_fmus = any(block.interface.declaration.foreign is not None for block in flat.one_of_each)
    going = case.updated(inputs=inputs, engine="reference" if has_fmus else None)
    run = begun(going)
    start, stop = run.settings.start, run.settings.stop
    if time < start:
        raise UsageError(Fault("E501", "at", f"{float(time)} s lies before the start at {float(start)} s."))
    if stop is not None and time > stop:
        going = going.updated(stop=time)
        run = begun(going)
    run.advance_to(time)
    if has_fmus:
        return engine_of(run)
    again = (going.updated(log=[]) if is_silent else going).without("start", "inputs", "parameters")
    return engine_of(begun(again.updated(engine="reference"), resume=run.snapshot()))
