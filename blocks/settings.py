"""The settings of a run and the measures of a diagram, read and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from . import units
from .errors import ModelError, did_you_mean
from .expressions import exact_decimal
from .jsontext import Number

__all__ = ["MEASURES", "METHODS", "MeasureSpec", "RunSettings", "read_settings", "seconds"]

METHODS = ("dopri5", "rk4", "euler", "radau")
MEASURES = {
    "ITAE": "integral of t |e|, t from 0",
    "IAE": "integral of |e|",
    "ISE": "integral of e^2",
    "ISU": "integral of e^2 of a control signal",
    "mean_square": "mean of e^2 over the window (OPI)",
    "peak": "largest |e|",
    "overshoot": "how far the signal goes beyond the final value of `against`, as a part of the step's size",
    "settling_time": "time after which the signal stays within `band` (0.02) of the step's size around the final value",
    "total_variation": "sum of all changes of e",
}
"""What a measure can be; e is `of` minus `against`."""


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How a diagram is simulated. Times are exact; `step` is for fixed-step methods, `every` is the recording grid."""

    start: Fraction = Fraction(0)
    stop: Fraction | None = None
    method: str = "dopri5"
    step: Fraction | None = None
    rtol: float = 1e-6
    atol: float = 1e-9
    every: Fraction | None = None
    stops: tuple[Fraction, ...] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)
    log: tuple[str, ...] | None = None

    @property
    def is_fixed_step(self) -> bool:
        return self.method in ("rk4", "euler")


@dataclass(frozen=True, slots=True)
class MeasureSpec:
    """One measure by the names of its signals: e = of - against over [start, stop]; `against` may be a number."""

    name: str
    type: str
    of: str
    against: str | float
    start: float
    stop: float
    band: float


def seconds(raw: Any) -> Fraction:
    """A time as an exact fraction: a decimal as written, a float by its shortest decimal, or a quantity.

    Raises ValueError with a sentence.
    """
    unit = ""
    if isinstance(raw, Mapping):
        unit, raw = raw.get("unit", ""), raw.get("value")
    if isinstance(raw, bool):
        raise ValueError(f"must be a time in s, not {str(raw).lower()}.")
    if isinstance(raw, Fraction):
        made = raw
    elif isinstance(raw, Number):
        made = raw.exact
    elif isinstance(raw, (int, np.integer)):
        made = Fraction(int(raw))
    elif isinstance(raw, (float, np.floating)):
        if not math.isfinite(raw):
            raise ValueError(f"must be a finite time, not {raw}.")
        made = exact_decimal(float(raw))
    else:
        raise ValueError(f"must be a time in s, not {raw!r}.")
    if unit:
        if not units.same_quantity(unit, "s"):
            raise ValueError(f"must be a time, not a number of {unit}.")
        factor = units.scale_exact(unit, "s")
        made *= Fraction(1) if factor is None else factor
    return made


def read_settings(raw: Mapping[str, Any], **overrides: Any) -> tuple[RunSettings, list[tuple[str, str, str, str]]]:
    """The settings of a file's `run` with overrides on top, and its faults as (key, code, message, cure)."""
    given = {**raw, **{key: value for key, value in overrides.items() if value is not None}}
    made: dict[str, Any] = {}
    faults: list[tuple[str, str, str, str]] = []

    def fault(key: str, message: str, cure: str = "", code: str = "E115") -> None:
        faults.append((key, code, message, cure))

    for key in ("start", "stop", "step", "every"):
        if key in given:
            try:
                made[key] = seconds(given[key])
            except (ValueError, ModelError) as error:
                fault(key, str(error))
                continue
            if key in ("step", "every") and made[key] <= 0:
                fault(key, f"must be above 0 s, not {float(made[key])}.")
                del made[key]
            elif abs(made[key]) > 10**15 or made[key].denominator > 10**15:
                fault(key, f"{float(made[key])} s is out of the range that can be computed.")
                del made[key]
    if "stop" in made and made["stop"] < made.get("start", 0):
        fault("stop", f"must not lie before the start at {float(made.get('start', 0))} s, but is {float(made['stop'])} s.")
    for key in ("rtol", "atol"):
        if key in given:
            value = given[key]
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1:
                fault(key, f"must be a number between 0 and 1, not {value!r}.")
            elif key == "rtol" and value < 1e-13:
                fault(key, f"{float(value)} is below what doubles can hold.", "Use 1e-13 or more.")
            else:
                made[key] = float(value)
    method = given.get("method", "dopri5")
    if method not in METHODS:
        fault("method", f"{method!r} is not known.", did_you_mean(str(method), METHODS) or f"Methods: {', '.join(METHODS)}.")
    else:
        made["method"] = method
        if method in ("rk4", "euler") and "step" not in made:
            fault("method", f"{method} has a fixed step, and none is given.", 'Set "step" (--step).')
        if method in ("dopri5", "radau") and "step" in made:
            fault("step", f"{method} chooses its steps itself.", "Leave the step out, or use rk4 or euler.")
    stops = given.get("stops", [])
    try:
        made["stops"] = tuple(sorted({seconds(stop) for stop in stops}))
    except (TypeError, ValueError, ModelError) as error:
        fault("stops", f"{error}")
    loops = given.get("loops", "error")
    if loops == "solve":
        fault("loops", '"loops": "solve" is not supported yet.', "Put a UnitDelay or a state into the loop.", "E118")
    elif loops != "error":
        fault("loops", f"{loops!r} is not known.", 'Use "error", or leave it out.')
    inputs = given.get("inputs", {})
    if not isinstance(inputs, Mapping):
        fault("inputs", "must be an object of values by input name.")
    else:
        made["inputs"] = dict(inputs)
    log = given.get("log")
    if log is not None:
        if isinstance(log, str) or not all(isinstance(name, str) for name in log):
            fault("log", "must be a list of signal names.")
        else:
            made["log"] = tuple(log)
    return RunSettings(**made), faults
