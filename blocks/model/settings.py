"""The settings of a run and the measures of a diagram, read and checked: from files, and from Python."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from ..contract.expressions import exact_time
from ..text import units
from ..text.errors import did_you_mean, sentence_of
from ..text.grammar import Choice, Object, Scalar
from ..text.json_number import Number, is_number
from ..text.printable import quoted
from .diagram_grammar import FIXED_STEP, LEAST_RTOL, MASTER, METHODS, QUANTITY, RUN

# What other tools call them, or others of their kind.
OTHER_NAMES = {
    **dict.fromkeys(("rk45", "ode45", "ode23", "rk23", "dop853", "adaptive"), "dopri5"),
    **dict.fromkeys(("ode4", "rungekutta", "runge-kutta"), "rk4"),
    **dict.fromkeys(("ode1", "forward-euler"), "euler"),
    **dict.fromkeys(("ode15s", "ode23s", "ode23t", "bdf", "lsoda", "cvode", "dassl", "radau5", "stiff"), "radau"),
}
LONGEST, FINEST = 10**15, 10**60  # a double has up to 17 digits: 1/3 and 1e-30 are times like others
# Steps are counted in 64 bits; rows of a recording are kept in memory.
MOST_STEPS, MOST_ROWS = 2**53, 10**9
MOST_STOPS = 10_000
TIMES = tuple(key for key in RUN.keys if RUN.entry(key).unit)


@dataclass(frozen=True, slots=True)
class MasterSettings:
    """How the master couples what it steps: the CS FMUs of a diagram, and the rest of it.

    step: the communication step in s; None: the master chooses. steps: of single units, by block path. algorithm:
    "jacobi", "gauss-seidel" or "iterated". order: of the polynomials through past values that inputs follow over a
    step, 0 (held) to 2. tolerance: of the error by which steps are controlled, as a part of a signal's size; None:
    fixed steps. couple: "each" makes every block a unit of its own, "together" one of all that have equations.
    iterations: the most of one step, where it iterates.
    """

    step: Fraction | None = None
    steps: Mapping[str, Fraction] = field(default_factory=dict)
    algorithm: str = MASTER.by_key["algorithm"].default
    order: int = MASTER.by_key["order"].default
    tolerance: float | None = None
    couple: str = MASTER.by_key["couple"].default
    iterations: int = MASTER.by_key["iterations"].default


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How a diagram is simulated. Times are exact; `step` is for fixed-step methods, `every` is the recording grid.

    stop_when: a condition over signals that ends the run; "": none.
    jumps: whether rows before and after jumps stand between those of the grid; without a grid they always stand.
    seed: of all streams of random numbers. loops: "error", or "solve" to solve algebraic loops by Newton's method.
    """

    start: Fraction = Fraction(0)
    stop: Fraction | None = None
    stop_when: str = ""
    method: str = RUN.by_key["method"].default
    step: Fraction | None = None
    rtol: float = RUN.by_key["rtol"].default
    atol: float = RUN.by_key["atol"].default
    every: Fraction | None = None
    jumps: bool = RUN.by_key["jumps"].default
    stops: tuple[Fraction, ...] = ()
    seed: int = RUN.by_key["seed"].default
    loops: str = RUN.by_key["loops"].default
    inputs: Mapping[str, Any] = field(default_factory=dict)
    log: tuple[str, ...] | None = None
    master: MasterSettings = field(default_factory=MasterSettings)
    gives_rtol: bool = False  # rtol was set, and is not the default

    @property
    def is_fixed_step(self) -> bool:
        return self.method in FIXED_STEP

    @property
    def records_jumps(self) -> bool:
        """Whether a jump of what is recorded stands as two rows, wherever it is."""
        return self.every is None or self.jumps


@dataclass(frozen=True, slots=True)
class MeasureSpec:
    """One measure by the names of its signals: e = of - against over [start, stop]; `against` may be a number.

    band: of the step's size. omega: of the fundamental, in rad/s; 0: it has none.
    """

    name: str
    type: str
    of: str
    against: str | float
    start: float
    stop: float
    band: float
    omega: float


def seconds(raw: object) -> Fraction:
    """A time as an exact fraction: a decimal as written, a float by its shortest decimal or as the fraction that it is
    the double of (see `exact_time`), or a quantity.

    Raises ValueError with a sentence.
    """
    unit: object = ""
    if isinstance(raw, Mapping):
        odd = next((str(key) for key in raw if key not in QUANTITY.keys and not str(key).startswith("x-")), None)
        if odd is not None:
            raise ValueError(f'must be a time such as {{"value": 5, "unit": "min"}}, without the key {quoted(odd)}.')
        unit, raw = raw.get("unit", ""), raw.get("value")
    if isinstance(raw, np.generic):
        raw = raw.item()
    if not isinstance(unit, str):
        raise ValueError(f"must have a text as its unit, not {_shown(unit)}.")
    if isinstance(raw, bool) or not isinstance(raw, (int, float, Fraction)):
        raise ValueError(f"must be a time in s, not {_shown(raw)}.")
    if isinstance(raw, float) and not math.isfinite(raw):
        raise ValueError(f"must be a finite time, not {raw}.")
    if isinstance(raw, Number):
        time = exact_time(raw.exact)
    else:
        time = exact_time(raw) if isinstance(raw, float) else Fraction(raw)
    if unit:
        if not units.same_quantity(unit, "s"):
            raise ValueError(f"must be a time, not a number of {unit}.")
        scale = units.scale_exact(unit, "s")
        if scale is None:
            raise ValueError(f"must be a time in a unit without pi, not in {unit}.")
        time *= scale
    if abs(time) > LONGEST or time.denominator > FINEST:
        raise ValueError("is outside the range of times: at most 1e15 s, and at most 60 decimals.")
    return time


def _shown(raw: object) -> str:
    """A value for a message, as JSON has it."""
    if raw is None or isinstance(raw, bool):
        return "null" if raw is None else str(raw).lower()
    if isinstance(raw, str):
        return quoted(raw)
    if isinstance(raw, (int, float)):
        return quoted(str(raw))[1:-1]
    return "an object" if isinstance(raw, Mapping) else "a list" if isinstance(raw, (list, tuple)) else "that"


def seed_of(raw: Mapping[str, object], seed: object = None) -> int:
    """The seed of a run: the given one, else that of the file's `run`; 0 where it is not valid."""
    reader = _Settings({"seed": raw.get("seed", 0) if seed is None else seed}, RUN)
    reader.plain("seed")
    return int(reader.made.get("seed", 0))


class _Settings:
    """Reads settings one by one; faults are collected as (key, code, message, cure). within: what the keys stand in."""

    def __init__(self, given: Mapping[str, Any], kind: Object, within: str = "") -> None:
        self.given, self.kind, self.within = given, kind, within
        self.made: dict[str, Any] = {}
        self.faults: list[tuple[str, str, str, str]] = []

    def fault(self, key: str, message: str, cure: str = "", code: str = "E115") -> None:
        self.faults.append((self.within + key, code, message, cure))

    def plain(self, *keys: str) -> None:
        """Settings whose kinds say all about them."""
        for key in keys:
            if key not in self.given:
                continue
            kind, value = self.kind.by_key[key].kind, self.given[key]
            value = value.item() if isinstance(value, np.generic) else value
            if kind.fits(value):
                number = int if isinstance(kind, Scalar) and kind.is_whole else float
                self.made[key] = number(value) if isinstance(kind, Scalar) else value
            elif isinstance(kind, Choice):
                guess = did_you_mean(value[:60], kind.words, quote='"') if isinstance(value, str) else ""
                self.fault(key, f"{_shown(value)} is not known.", guess or f"Use {kind.what}.")
            elif key == "rtol" and isinstance(value, (int, float)) and 0 < value < LEAST_RTOL:
                self.fault(key, f"{float(value)} is below the precision of a double.", f"Use {LEAST_RTOL} or more.")
            else:
                self.fault(key, f"must be {kind.what}, not {_shown(value)}.")


class _RunSettings(_Settings):
    def text(self, key: str) -> None:
        text = self.given.get(key, "")
        if isinstance(text, str):
            self.made[key] = text.strip()
        else:
            self.fault(key, f"must be a text, not {_shown(text)}.", 'Example: "lift.height >= 3".')

    def times(self) -> None:
        for key in TIMES:
            if key not in self.given:
                continue
            try:
                time = seconds(self.given[key])
            except ValueError as error:
                cure = 'A time is a number of seconds, or {"value": 5, "unit": "ms"}.'
                cure = cure if isinstance(self.given[key], str) else ""
                self.fault(key, sentence_of(error), cure)
                continue
            if key in ("step", "every") and time <= 0:
                self.fault(key, f"must be above 0 s, not {float(time)}.")
            else:
                self.made[key] = time
        start, stop = self.made.get("start", Fraction(0)), self.made.get("stop")
        if stop is None:
            return
        if stop < start:
            self.fault("stop", f"is {float(stop)} s, before the start at {float(start)} s.")
        for key, most, what in (("step", MOST_STEPS, "steps"), ("every", MOST_ROWS, "rows")):
            if key in self.made and (stop - start) / self.made[key] > most:
                message = f"gives {float((stop - start) / self.made[key]):.3g} {what}; the limit is {float(most):.3g}."
                self.fault(key, message, f"Make it {float((stop - start) / most):.3g} s or more.")

    def jumps(self) -> None:
        self.plain("jumps")
        if self.made.get("jumps") is False and "every" not in self.given:
            message = "cannot be false without a recording grid, because then all steps and jumps are recorded."
            self.fault("jumps", message, 'Set "every" (--every), or leave it out.')

    def stops(self) -> None:
        stops = self.given.get("stops", ())
        if not isinstance(stops, (list, tuple)):
            self.fault("stops", f"must be a list of times, not {_shown(stops)}.")
            return
        if len(stops) > MOST_STOPS:
            self.fault("stops", f"has {len(stops):,} times; the limit is {MOST_STOPS:,}.", 'Use "every" for a grid.')
            return
        times = set()
        for stop in stops:
            try:
                times.add(seconds(stop))
            except ValueError as error:
                self.fault("stops", sentence_of(error))
        self.made["stops"] = tuple(sorted(times))

    def method(self, *, step_of_file: bool) -> None:
        method = self.given.get("method", "dopri5")
        if not isinstance(method, str) or method not in METHODS:
            word = method[:60] if isinstance(method, str) else ""
            other = OTHER_NAMES.get(word.lower())
            known = f"Methods: {', '.join(METHODS)}."
            guess = f"The nearest method is {quoted(other)}. {known}" if other else did_you_mean(word, METHODS)
            self.fault("method", f"{_shown(method)} is not known.", guess or known)
            return
        self.made["method"] = method
        if method in FIXED_STEP:
            if "step" not in self.given:
                self.fault("method", f"{method} needs a fixed step, and none is given.", 'Set "step" (--step).')
        elif step_of_file:
            self.made.pop("step", None)  # it belongs to the method of the file
        elif "step" in self.given:
            self.fault("step", f"{method} chooses its own steps.", "Leave the step out, or use rk4 or euler.")

    def inputs(self) -> None:
        inputs = self.given.get("inputs", {})
        if isinstance(inputs, Mapping):
            self.made["inputs"] = dict(inputs)
        else:
            self.fault("inputs", f"must be an object of values by input name, not {_shown(inputs)}.")

    def log(self) -> None:
        log = self.given.get("log")
        if log is None and "log" not in self.given:
            return
        if isinstance(log, (list, tuple)) and all(isinstance(name, str) for name in log):
            self.made["log"] = tuple(log)
        else:
            what = "a list with other items" if isinstance(log, (list, tuple)) else _shown(log)
            cure = f"Write [{_shown(log)}]." if isinstance(log, str) else ""
            self.fault("log", f"must be a list of signal names, not {what}.", cure)

    def master(self, over: Any) -> None:
        """The settings of the master; what is given on top replaces single keys of the file's."""
        given: dict[str, object] = {}
        for source in (self.given.get("master", {}), {} if over is None else over):
            if not isinstance(source, Mapping):
                shown = _shown(source)
                step = shown if is_number(source) else "0.001"
                self.fault("master", f"must be an object of settings, not {shown}.", f'As in {{"step": {step}}}.')
                return
            steps = [layer.get("steps") for layer in (given, source)]
            given |= {key: value for key, value in source.items() if not str(key).startswith("x-")}
            if all(isinstance(table, Mapping) for table in steps):
                given["steps"] = {**steps[0], **steps[1]}  # type: ignore[dict-item]
        for key in [key for key, value in (over or {}).items() if value is None]:
            del given[key]
        for key in given:
            if key not in MASTER.keys:
                guess = did_you_mean(str(key)[:60], MASTER.keys, quote='"')
                guess = guess or f"Settings of the master: {', '.join(MASTER.keys)}."
                self.fault("master", f"{_shown(str(key))} is not known.", guess)
        reader = _MasterSettings(given, MASTER, "master.")
        self.made["master"] = reader.settings(self.made)
        self.faults += reader.faults


class _MasterSettings(_Settings):
    def settings(self, run: Mapping[str, Any]) -> MasterSettings:
        """The settings of the master. run: those of the run that were read so far."""
        self.run = run
        self.plain("algorithm", "couple", "order", "iterations")
        if "step" in self.given:
            self.made["step"] = self.time("step", self.given["step"])
        self.plain("tolerance")
        self.made["steps"] = self.steps()
        return MasterSettings(**{key: value for key, value in self.made.items() if value is not None})

    def time(self, key: str, raw: Any, whose: str = "") -> Fraction | None:
        try:
            step_size = seconds(raw)
        except ValueError as error:
            self.fault(key, whose + sentence_of(error))
            return None
        start, stop = self.run.get("start", Fraction(0)), self.run.get("stop")
        if step_size <= 0:
            self.fault(key, f"{whose}must be above 0 s, not {float(step_size)}.")
        elif stop is not None and (stop - start) / step_size > MOST_STEPS:
            message = (
                f"{whose}gives {float((stop - start) / step_size):.3g} steps; the limit is {float(MOST_STEPS):.3g}."
            )
            self.fault(key, message, f"Make it {float((stop - start) / MOST_STEPS):.3g} s or more.")
        else:
            return step_size
        return None

    def steps(self) -> dict[str, Fraction] | None:
        steps = self.given.get("steps", {})
        if not isinstance(steps, Mapping):
            self.fault("steps", f"must be an object of steps by block, not {_shown(steps)}.")
            return None
        times = {str(name): self.time("steps", raw, f"{quoted(str(name))} ") for name, raw in steps.items()}
        return {name: step for name, step in times.items() if step is not None}


def read_settings(
    raw: Mapping[str, object], /, **overrides: object
) -> tuple[RunSettings, list[tuple[str, str, str, str]]]:
    """The settings of a file's `run` with overrides on top, and its faults as (key, code, message, cure).

    An override that is None is ignored. One of the method drops the file's step where the method chooses its own; one
    of the master replaces the keys that it has.
    """
    over = {key: value for key, value in overrides.items() if value is not None}
    master = over.pop("master", None)
    reader = _RunSettings({**raw, **over}, RUN)
    reader.times()
    reader.jumps()
    reader.stops()
    reader.text("stop_when")
    reader.plain("rtol", "atol")
    reader.made["gives_rtol"] = "rtol" in reader.made
    reader.method(step_of_file="method" in over and "step" not in over)
    reader.plain("seed", "loops")
    reader.inputs()
    reader.log()
    reader.master(master)
    return RunSettings(**reader.made), reader.faults
