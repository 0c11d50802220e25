"""The map of a loop over two parameters in a page: tables of measures, what lies within limits, the best point.

What the page leaves open is chosen here: a controller with an output u and an input y, the one that is selected first,
its two bandwidths or gains, and ranges around their present values.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from ..analysis.loop_maps import LARGER, MEASURES, LoopMap
from ..analysis.loop_maps import loop_map as mapped
from ..compile.plan import Plan
from ..text.errors import AnalysisError, Fault, UsageError, did_you_mean
from ..text.printable import legible
from .analysis_messages import PADE, Amplitude, analyzed, laws_of, linearized
from .messages import Answer, handles_aside
from .panel import knobs_of
from .session import Session

PAIRS = (("omega_c", "omega_o"), ("kp", "ki"), ("kp", "kd"))
"""Pairs of parameters for the axes, unless the page names others: the first pair that a controller has counts."""
POINTS, ONE_BY_ONE = 40, 12
"""Values of each parameter; where the model of each point is computed by itself."""
AROUND = 5.0
"""The factor from a present value to both ends of a range."""
MOST_NAMES = 500


@handles_aside
def loop_map(
    session: Session, *, control: str = "", output: str = "", over: dict[str, list[float]] | None = None,
    limits: dict[str, float] | None = None, best: str = "disturbance", near: str = "",
    amplitude: Amplitude = None, have: int = 0,
) -> Answer:  # fmt: skip
    """Measure a loop over two parameters, at the start of the diagram.

    over: by parameter, its range in its declared unit, or [] for one around its present value. limits: by measure.
    best: the measure of the best point. near: a block or signal that is selected. have: the number of the
    map that the page has, whose tables are left out. It ends without a result where the page asks something else.
    """
    names = [*(over or {})]
    if not (control and output and names):
        path, measured, pair = _obvious(session, near or control)
        control, output, names = control or f"{path}.u", output or measured, names or pair
    axes = _axes(session)
    if len(names) != 2:
        raise UsageError(Fault("E501", "over", f"names {len(names)} parameters.", "Choose two different parameters."))
    for name in names:
        if name not in axes:
            message = "is not a single number that can be set."
            raise UsageError(Fault("E502", legible(name[:200]), message, did_you_mean(name[:200], axes)))
    present = knobs_of(session, names)
    given = {name: [float(end) for end in ends] for name, ends in (over or {}).items()}
    ranges = {name: given.get(name) or _around(session, present[name]) for name in names}
    linearizer, where, refused = linearized(session, "start", amplitude)

    def made() -> dict[str, Any]:
        number, found = _known(session, control, output, ranges, amplitude)
        ends = {name: (end, None) if name in LARGER else (None, end) for name, end in (limits or {}).items()}
        told: dict[str, Any] = {"number": number, "slack": np.clip(found.slack(ends), -1, 1).tolist(), "best": None}
        notes = [f"Delays are Padé models of order {PADE}."] if linearizer.plan.delays else []
        if len(found.values[0]) == ONE_BY_ONE:
            notes.append(f"{ONE_BY_ONE} x {ONE_BY_ONE} points: the models of sampled loops are computed one by one.")
        try:
            point = found.best(best, **ends)
            told["best"] = {"point": [*point.values()], "at": _digits([*found.at(point).values()])}
        except AnalysisError as error:
            text = f"{error.faults[0].message} {error.faults[0].cure}"
            notes.append(text[0].upper() + text[1:])
        if number != have:
            data = found.as_json()
            told |= {"axes": [*data["parameters"].values()], "tables": _digits([*data["measures"].values()])}
        return told | {"notes": notes}

    title = f"Loop opened at {control}, of {output}. {where}"
    told = analyzed(linearizer, title, made, laws_of(linearizer, [control], [control], [control]), refused)
    measures = [[name, text, name in LARGER] for name, text in MEASURES.items() if name != "at_frequency"]
    chosen = {"control": control, "output": output, "over": ranges, "names": axes, "present": [*present.values()]}
    return told | {"map": chosen | {"measures": measures}}


def _known(
    session: Session, control: str, output: str, ranges: dict[str, list[float]], amplitude: Amplitude
) -> tuple[int, LoopMap]:
    """The last map and its number, where nothing but its two parameters has changed; or a new one."""

    def check() -> None:
        session.check_wanted()
        if session.is_outdated:  # another page waits until this map is done
            raise UsageError(Fault("E501", "map", "another request stopped this one.", "Request it again."))

    document, planned, maps = session.document, session.document.planned, session.maps
    values = {name: value for name, value in session.values.items() if name not in ranges}
    key = repr((document.revision, document.variants, values, session.inputs, control, output, ranges, amplitude))
    if key not in maps:
        is_quick = (
            isinstance(planned, Plan) and not planned.foreign and {*planned.rate_labels.values()} <= {"continuous"}
        )
        made = mapped(
            document.shown, control, output, over=ranges, points=POINTS if is_quick else ONE_BY_ONE, pade=PADE,
            amplitude=amplitude, parameters=values, inputs=session.inputs, trust=session.trust, check=check,
        )  # fmt: skip
        number = 1 + max((number for number, _ in maps.values()), default=0)
        maps.clear()
        maps[key] = number, made
    return maps[key]


def _digits(values: Any) -> Any:
    """Lists of numbers with as many digits as a picture shows; None where there is no number."""
    if isinstance(values, list):
        return [_digits(value) for value in values]
    return float(f"{values:.5g}") if values is not None and math.isfinite(values) else None


# --- what the page leaves open ---------------------------------------------------------------------------------------


def _obvious(session: Session, near: str) -> tuple[str, str, list[str]]:
    """A controller, what it measures, and two of its parameters. Raises UsageError (E501) where there is none."""
    document, found = session.document, []
    signals = () if document.planned is None else document.planned.signals
    for order, block in enumerate(document.told()["blocks"]):
        level, _, name = (path := block["path"]).rpartition(".")
        source = document.value_at(level).wires.get(f"{name}.y")
        if source and f"{path}.u" in signals and (pair := _pair(session, path)):
            whole = f"{level}.{source}".lstrip(".")
            is_far = near not in (path, whole) and not near.startswith(f"{path}.")
            measured = whole if whole in signals else f"{path}.y"
            found.append((is_far, path.count("."), order, path, measured, pair))
    if not found:
        message = "has no block with an output u and an input y to begin with."
        cure = "Name the control signal, what is controlled, and two parameters."
        raise UsageError(Fault("E501", document.name, message, cure))
    *_, path, measured, pair = min(found)
    return path, measured, pair


def _pair(session: Session, path: str) -> list[str]:
    """The two parameters of a controller that matter, or those around it that give them their values."""
    facts, axes, level = session.document.facts, _axes(session), path.rpartition(".")[0]
    for pair in PAIRS:
        names = [f"{path}.{own}" for own in pair]
        given = [re.fullmatch(r"=\s*(\w+)", str(facts[name].raw)) if name in facts else None for name in names]
        names = [f"{level}.{by[1]}".lstrip(".") if by else name for name, by in zip(names, given, strict=True)]
        if set(names) <= set(axes):
            return names
    own = [name for name in axes if name.startswith(f"{path}.")][:2]
    return own if len(own) == 2 else []


def _axes(session: Session) -> list[str]:
    """The parameters that a map can be over."""
    facts = [fact for fact in session.document.facts.values() if fact.type == "real" and not fact.is_bound]
    return [fact.name for fact in facts if isinstance(fact.nominal, float) and not fact.is_input][:MOST_NAMES]


def _around(session: Session, now: dict[str, Any]) -> list[float]:
    """A range around a present value within what may be set: by factors, or that of its slider where it is 0."""
    value, fact = now["value"], session.document.facts[now["name"]]
    ends = sorted((value / AROUND, value * AROUND)) if value else [now["low"] or 0.0, now["high"] or 0.0]
    low, high = (float(f"{end:.4g}") for end in ends)
    return [low if fact.low is None else max(low, fact.low), high if fact.high is None else min(high, fact.high)]
