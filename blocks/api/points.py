"""Where a diagram stands: the point around which it is linear, from its start or from a run that led there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..compile.plan import Plan
from ..contract.captured_values import Outside
from ..engines.prepared import Prepared
from ..engines.reference.reference_engine import ReferenceEngine
from ..linear.operating_point import OperatingPoint
from ..linear.point import Point
from ..model.diagram_value import DiagramValue
from ..model.flatten import Flat
from ..model.hierarchy import Resolver
from ..model.trust import Paths
from ..model.variants import taken
from ..text.errors import AnalysisError, Fault, UsageError, check_mappings
from .checks import coupled_block, flat_of
from .given_values import at_rest, time_of
from .last_made import LastMade, names_files
from .ports import plain_settings
from .run import Run, RunOptions, engine_of, started

MOST_KEPT = 3
"""Forms of a model that are kept ready for other points."""


@dataclass(frozen=True, kw_only=True)
class PointOptions:
    """What a point is given besides its model; see `Diagram.point`."""

    at: OperatingPoint | Run | float | None
    held: Mapping[str, Any] | None
    parameters: Mapping[str, Any] | None
    variants: Mapping[str, str] | None
    trust: Paths
    settings: Mapping[str, Any]


def point_of(value: DiagramValue, resolver: Resolver, options: PointOptions, last: LastMade) -> Point:
    """Where a diagram stands. last: where its last point is kept."""
    at, held, parameters, variants = options.at, options.held, options.parameters, options.variants
    if isinstance(at, (OperatingPoint, Run)) and (held or parameters or variants or options.settings):
        whose, cure = "the operating point has", "Give them to find_operating_point."
        if isinstance(at, Run):
            whose, cure = "the run has", "Give them when you start the run, or set them in the run."
        raise UsageError(Fault("E501", "at", f"{whose} its inputs, parameters and settings already.", cure))
    if isinstance(at, Run):
        return _of_run(at, options.trust)
    if isinstance(at, OperatingPoint):
        if at.point is None:
            message = "was found by a run with Co-Simulation FMUs, which hide their states: it has no linear model."
            cure = "Import them as Model Exchange, or estimate the response by simulation."
            raise AnalysisError(Fault("E703", at.name, message, cure))
        return at.point
    check_mappings(held=held, parameters=parameters, variants=variants)
    plain = [{name: _plainly(given) for name, given in (table or {}).items()} for table in (held, parameters)]
    key = (id(value), value, at, repr((*(sorted(table.items()) for table in plain), variants, options.settings)))
    known: tuple[Point, tuple[Outside, ...]] | None = last.known("point", key)
    if known is not None and all(read.holds() for read in known[1]):
        return known[0]
    point = Point.of(_standing(value, resolver, options, at, last, is_silent=True))
    if not np.isfinite(point.outputs).all():
        _standing(value, resolver, options, at, last, is_silent=False)  # reports where, if recorded
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
        going = RunOptions(resume=run.snapshot(), engine="reference", trust=trust)
        run = started(prepared.value, prepared.resolver, {}, {**settings, "log": []}, going, likes=[prepared])
    engine = engine_of(run)
    if not isinstance(engine, ReferenceEngine):
        cure = 'Start the run with engine="reference".'
        raise UsageError(
            Fault("E501", "at", "is a run with FMUs on the native engine, whose states cannot be read.", cure)
        )
    return Point.of(engine)


def _refuse_coupled(flat: Flat) -> None:
    coupled = coupled_block(flat)
    if coupled:
        message = "is a Co-Simulation FMU, which hides its states, so that it has no linear model."
        cure = 'Import it as "kind": "ME", or estimate the response by simulation (estimate_response).'
        raise AnalysisError(Fault("E703", coupled, message, cure))


def _standing(
    given_value: DiagramValue, resolver: Resolver, options: PointOptions, at: float | None, last: LastMade,
    *, is_silent: bool,
) -> Any:  # fmt: skip
    """Return a run of the reference engine at a time. A silent run is not made to record signals.

    last: keeps the source of the run, for runs with other values of parameters.
    """
    held, parameters, settings = options.held, dict(options.parameters or {}), options.settings
    value = taken(given_value, options.variants)
    silent: dict[str, Any] = {"log": []} if is_silent else {}
    key = (id(given_value), given_value, repr(options.variants))
    kept: tuple[Prepared, ...] = last.known("standing", key) or ()
    likes = [form for form in kept if form.is_current]

    def begun(parameters: Mapping[str, Any], settings: Mapping[str, Any], given: RunOptions, flat: Any = None) -> Run:
        run = started(value, resolver, parameters, plain_settings(settings), given, flat, likes)
        form = run.prepared
        is_kept = isinstance(form.plan, Plan) and not form.plan.foreign and not names_files(given_value)
        if is_kept and not any(like.alike is form.alike for like in likes):
            likes.insert(0, form)
            last.keep("standing", key, tuple(likes[:MOST_KEPT]))
        return run

    asked = plain_settings({**settings, **silent})
    like = next((form for form in likes if form.with_values(parameters, asked) is not None), None)
    flat = flat_of(value, resolver, parameters, asked) if like is None else like.structure
    _refuse_coupled(flat)
    given = RunOptions(inputs={**at_rest(value, flat), **(held or {})}, engine="reference", trust=options.trust)
    if at is None:
        return engine_of(begun(parameters, asked, given, flat if like is None else None))
    time = time_of("at", at)
    has_fmus = any(block.interface.declaration.foreign is not None for block in flat.one_of_each)
    given = given if has_fmus else replace(given, engine=None)
    run = begun(parameters, settings, given)
    start, stop = run.settings.start, run.settings.stop
    if time < start:
        raise UsageError(Fault("E501", "at", f"{float(time)} s lies before the start at {float(start)} s."))
    if stop is not None and time > stop:
        settings = {**settings, "stop": time}
        run = begun(parameters, settings, given)
    run.advance_to(time)
    if has_fmus:
        return engine_of(run)
    going = RunOptions(resume=run.snapshot(), engine="reference", trust=options.trust)
    again = {key: item for key, item in settings.items() if key != "start"}
    return engine_of(begun({}, {**again, **silent}, going))


def _plainly(value: Any) -> Any:
    """Return an array as lists, which print all digits."""
    return value.tolist() if isinstance(value, np.ndarray) else value
