"""The settings of a run and the measures of a diagram, read and checked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from ..text import units
from ..text.errors import ModelError, did_you_mean
from ..text.expressions import exact_decimal
from ..text.json_text import Number, quoted

__all__ = [
    "LARGEST_SEED",
    "MASTER",
    "MEASURES",
    "METHODS",
    "TIMES",
    "MasterSettings",
    "MeasureSpec",
    "RunSettings",
    "read_settings",
    "seconds",
    "seed_of",
    "times_of",
]

METHODS = ("dopri5", "rk4", "euler", "radau")
# What other tools call them, or others of their kind.
OTHER_NAMES = {
    **dict.fromkeys(("rk45", "ode45", "ode23", "rk23", "dop853", "adaptive"), "dopri5"),
    **dict.fromkeys(("ode4", "rungekutta", "runge-kutta"), "rk4"),
    **dict.fromkeys(("ode1", "forward-euler"), "euler"),
    **dict.fromkeys(("ode15s", "ode23s", "ode23t", "bdf", "lsoda", "cvode", "dassl", "radau5", "stiff"), "radau"),
}
FIXED_STEP = ("rk4", "euler")
QUANTITY = ("value", "unit", "doc")
LEAST_RTOL = 1e-13
LONGEST, FINEST = 10**15, 10**60  # a double has up to 17 digits: 1/3 and 1e-30 are times like others
# Steps are counted in 64 bits; rows of a recording are kept in memory.
MOST_STEPS, MOST_ROWS = 2**53, 10**9
MOST_STOPS = 10_000
LARGEST_SEED = 2**53
TIMES = ("start", "stop", "step", "every")
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
LOOPS = ("error", "solve")
MASTER = ("step", "steps", "algorithm", "order", "tolerance", "couple", "iterations")
ALGORITHMS = ("jacobi", "gauss-seidel", "iterated")
COUPLINGS = ("together", "each")
HIGHEST_ORDER, MOST_ITERATIONS = 2, 10_000


@dataclass(frozen=True, slots=True)
class MasterSettings:
    """How the master couples what it steps: the CS FMUs of a diagram, and the rest of it.

    step: the communication step in s; None: the master chooses. steps: of single units, by block path. algorithm:
    "jacobi", "gauss-seidel" or "iterated". order: of the polynomials through past values that inputs follow over a
    step, 0 (held) to 2. tolerance: of the error by which steps are controlled, as a part of a signal's size; None:
    fixed steps. couple: "each" makes every block a unit of its own, "together" all that has equations one. iterations:
    the most of one step, where it iterates.
    """

    step: Fraction | None = None
    steps: Mapping[str, Fraction] = field(default_factory=dict)
    algorithm: str = "jacobi"
    order: int = 1
    tolerance: float | None = None
    couple: str = "together"
    iterations: int = 20


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How a diagram is simulated. Times are exact; `step` is for fixed-step methods, `every` is the recording grid.

    jumps: whether rows before and after jumps stand between those of the grid; without a grid they always stand.
    seed: of all streams of random numbers. loops: "error", or "solve" to solve algebraic loops by Newton's method.
    """

    start: Fraction = Fraction(0)
    stop: Fraction | None = None
    method: str = "dopri5"
    step: Fraction | None = None
    rtol: float = 1e-6
    atol: float = 1e-9
    every: Fraction | None = None
    jumps: bool = False
    stops: tuple[Fraction, ...] = ()
    seed: int = 0
    loops: str = "error"
    inputs: Mapping[str, Any] = field(default_factory=dict)
    log: tuple[str, ...] | None = None
    master: MasterSettings = field(default_factory=MasterSettings)
    gives_rtol: bool = False  # and not what is usual

    @property
    def is_fixed_step(self) -> bool:
        return self.method in FIXED_STEP

    @property
    def records_jumps(self) -> bool:
        """Whether a jump of what is recorded stands as two rows, wherever it is."""
        return self.every is None or self.jumps


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
    unit: Any = ""
    if isinstance(raw, Mapping):
        odd = next((str(key) for key in raw if key not in QUANTITY and not str(key).startswith("x-")), None)
        if odd is not None:
            raise ValueError(f'must be a time, as in {{"value": 5, "unit": "min"}}, which has no {quoted(odd)}.')
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
        made = raw.exact
    else:
        made = exact_decimal(raw) if isinstance(raw, float) else Fraction(raw)
    if unit:
        if not units.same_quantity(unit, "s"):
            raise ValueError(f"must be a time, not a number of {unit}.")
        scale = units.scale_exact(unit, "s")
        if scale is None:
            raise ValueError(f"must be a time in a unit without pi, not in {unit}.")
        made *= scale
    if abs(made) > LONGEST or made.denominator > FINEST:
        raise ValueError("is out of the range of times that can be computed (1e15 s, and 60 decimals).")
    return made


def _shown(raw: Any) -> str:
    """A value for a message, as JSON has it."""
    if raw is None or isinstance(raw, bool):
        return "null" if raw is None else str(raw).lower()
    if isinstance(raw, str):
        return quoted(raw)
    if isinstance(raw, (int, float)):
        return quoted(str(raw))[1:-1]
    return "an object" if isinstance(raw, Mapping) else "a list" if isinstance(raw, (list, tuple)) else "that"


def seed_of(raw: Mapping[str, Any], seed: Any = None) -> int:
    """The seed of a run by the file's `run`, and by what is given in its place; 0 where it is not one."""
    reader = _Settings({"seed": raw.get("seed", 0) if seed is None else seed})
    reader.seed()
    return int(reader.made.get("seed", 0))


def times_of(run: Mapping[str, Any]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """The times in run settings as they are written, each with its path: ("stop",), ("master", "steps", "motor")."""
    for key in TIMES:
        if key in run:
            yield (key,), run[key]
    stops, master = run.get("stops"), run.get("master")
    for index, raw in enumerate(stops) if isinstance(stops, (list, tuple)) else ():
        yield ("stops", index), raw
    if isinstance(master, Mapping):
        if "step" in master:
            yield ("master", "step"), master["step"]
        steps = master.get("steps")
        for name, raw in steps.items() if isinstance(steps, Mapping) else ():
            yield ("master", "steps", name), raw


class _Settings:
    """Reads run settings one by one; faults are collected as (key, code, message, cure)."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.given = given
        self.made: dict[str, Any] = {}
        self.faults: list[tuple[str, str, str, str]] = []

    def fault(self, key: str, message: str, cure: str = "", code: str = "E115") -> None:
        self.faults.append((key, code, message, cure))

    def times(self) -> None:
        for key in TIMES:
            if key not in self.given:
                continue
            try:
                time = seconds(self.given[key])
            except ValueError as error:
                cure = 'A time is a number of seconds, or {"value": 5, "unit": "ms"}.'
                cure = cure if isinstance(self.given[key], str) else ""
                self.fault(key, error.faults[0].message if isinstance(error, ModelError) else str(error), cure)
                continue
            if key in ("step", "every") and time <= 0:
                self.fault(key, f"must be above 0 s, not {float(time)}.")
            else:
                self.made[key] = time
        start, stop = self.made.get("start", Fraction(0)), self.made.get("stop")
        if stop is None:
            return
        if stop < start:
            self.fault("stop", f"must not lie before the start at {float(start)} s, but is {float(stop)} s.")
        for key, most in (("step", MOST_STEPS), ("every", MOST_ROWS)):
            if key in self.made and (stop - start) / self.made[key] > most:
                message = f"makes {float((stop - start) / self.made[key]):.3g} of them; {float(most):.3g} are the most."
                self.fault(key, message, f"Make it {float((stop - start) / most):.3g} s or more.")

    def jumps(self) -> None:
        if "jumps" not in self.given:
            return
        jumps = self.given["jumps"]
        if isinstance(jumps, np.generic):
            jumps = jumps.item()
        if not isinstance(jumps, bool):
            self.fault("jumps", f"must be true or false, not {_shown(jumps)}.")
        elif not jumps and "every" not in self.given:
            message = "cannot be false without a recording grid, as then all steps and jumps are recorded."
            self.fault("jumps", message, 'Set "every" (--every), or leave it out.')
        else:
            self.made["jumps"] = jumps

    def stops(self) -> None:
        stops = self.given.get("stops", ())
        if not isinstance(stops, (list, tuple)):
            self.fault("stops", f"must be a list of times, not {_shown(stops)}.")
            return
        if len(stops) > MOST_STOPS:
            self.fault("stops", f"holds {len(stops):,} times; {MOST_STOPS:,} are the most.", 'Use "every" for a grid.')
            return
        made = set()
        for stop in stops:
            try:
                made.add(seconds(stop))
            except ValueError as error:
                self.fault("stops", error.faults[0].message if isinstance(error, ModelError) else str(error))
        self.made["stops"] = tuple(sorted(made))

    def tolerances(self) -> None:
        for key in ("rtol", "atol"):
            if key not in self.given:
                continue
            value = self.given[key]
            if isinstance(value, np.generic):
                value = value.item()
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1:
                self.fault(key, f"must be a number between 0 and 1, not {_shown(value)}.")
            elif key == "rtol" and value < LEAST_RTOL:
                self.fault(key, f"{float(value)} is below what doubles can hold.", f"Use {LEAST_RTOL} or more.")
            else:
                self.made[key] = float(value)
        self.made["gives_rtol"] = "rtol" in self.made

    def method(self, *, step_of_file: bool) -> None:
        method = self.given.get("method", "dopri5")
        if not isinstance(method, str) or method not in METHODS:
            word = method[:60] if isinstance(method, str) else ""
            other = OTHER_NAMES.get(word.lower())
            known = f"Methods: {', '.join(METHODS)}."
            guess = f"What comes nearest is {quoted(other)}. {known}" if other else did_you_mean(word, METHODS)
            self.fault("method", f"{_shown(method)} is not known.", guess or known)
            return
        self.made["method"] = method
        if method in FIXED_STEP:
            if "step" not in self.given:
                self.fault("method", f"{method} has a fixed step, and none is given.", 'Set "step" (--step).')
        elif step_of_file:
            self.made.pop("step", None)  # it belongs to the method of the file
        elif "step" in self.given:
            self.fault("step", f"{method} chooses its steps itself.", "Leave the step out, or use rk4 or euler.")

    def seed(self) -> None:
        seed = self.given.get("seed", 0)
        seed = seed.item() if isinstance(seed, np.generic) else seed
        is_number = isinstance(seed, (int, float)) and not isinstance(seed, bool)
        if is_number and 0 <= seed <= LARGEST_SEED and seed == int(seed):
            self.made["seed"] = int(seed)
        else:
            self.fault("seed", f"must be an integer from 0 to 2^53, not {_shown(seed)}.")

    def loops(self) -> None:
        loops = self.given.get("loops", "error")
        if isinstance(loops, str) and loops in LOOPS:
            self.made["loops"] = loops
        else:
            self.fault("loops", f"{_shown(loops)} is not known.", 'Use "error" or "solve".')

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
            what = "one that holds other things" if isinstance(log, (list, tuple)) else _shown(log)
            cure = f"Write [{_shown(log)}]." if isinstance(log, str) else ""
            self.fault("log", f"must be a list of signal names, not {what}.", cure)

    def master(self, over: Any) -> None:
        """Of the master; what is given on top replaces single keys of the file's."""
        given: dict[str, Any] = {}
        for source in (self.given.get("master", {}), {} if over is None else over):
            if not isinstance(source, Mapping):
                self.fault("master", f"must be an object of settings, not {_shown(source)}.")
                return
            steps = [one.get("steps") for one in (given, source)]
            given |= {key: value for key, value in source.items() if not str(key).startswith("x-")}
            if all(isinstance(one, Mapping) for one in steps):
                given["steps"] = {**steps[0], **steps[1]}  # type: ignore[dict-item]
        for key in [key for key, value in (over or {}).items() if value is None]:
            del given[key]
        for key in given:
            if key not in MASTER:
                guess = (
                    did_you_mean(str(key)[:60], MASTER, quote='"') or f"Settings of the master: {', '.join(MASTER)}."
                )
                self.fault("master", f"{_shown(str(key))} is not known.", guess)
        reader = _Master(given, self.made)
        self.made["master"] = reader.settings()
        self.faults += [(f"master.{key}", "E115", message, cure) for key, message, cure in reader.faults]


class _Master:
    """Reads the settings of the master; faults are (key, message, cure). run: the settings of the run up to now."""

    def __init__(self, given: Mapping[str, Any], run: Mapping[str, Any]) -> None:
        self.given, self.run = given, run
        self.faults: list[tuple[str, str, str]] = []

    def settings(self) -> MasterSettings:
        made: dict[str, Any] = {
            "algorithm": self.choice("algorithm", ALGORITHMS),
            "couple": self.choice("couple", COUPLINGS),
            "order": self.integer("order", 0, HIGHEST_ORDER),
            "iterations": self.integer("iterations", 1, MOST_ITERATIONS),
            "step": self.time("step", self.given["step"]) if "step" in self.given else None,
            "tolerance": self.tolerance(),
            "steps": self.steps(),
        }
        return MasterSettings(**{key: value for key, value in made.items() if value is not None})

    def choice(self, key: str, known: tuple[str, ...]) -> str | None:
        value = self.given.get(key)
        if key not in self.given or (isinstance(value, str) and value in known):
            return value
        guess = did_you_mean(value[:60], known, quote='"') if isinstance(value, str) else ""
        cure = guess or f"Use {', '.join(quoted(word) for word in known)}."
        self.faults.append((key, f"{_shown(value)} is not known.", cure))
        return None

    def integer(self, key: str, least: int, most: int) -> int | None:
        if key not in self.given:
            return None
        value: Any = self.given[key]
        if isinstance(value, np.generic):
            value = value.item()
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if is_number and least <= value <= most and value == int(value):
            return int(value)
        self.faults.append((key, f"must be an integer from {least} to {most:,}, not {_shown(value)}.", ""))
        return None

    def time(self, key: str, raw: Any, whose: str = "") -> Fraction | None:
        try:
            made = seconds(raw)
        except ValueError as error:
            message = error.faults[0].message if isinstance(error, ModelError) else str(error)
            self.faults.append((key, whose + message, ""))
            return None
        start, stop = self.run.get("start", Fraction(0)), self.run.get("stop")
        if made <= 0:
            self.faults.append((key, f"{whose}must be above 0 s, not {float(made)}.", ""))
        elif stop is not None and (stop - start) / made > MOST_STEPS:
            message = f"{whose}makes {float((stop - start) / made):.3g} of them; {float(MOST_STEPS):.3g} are the most."
            self.faults.append((key, message, f"Make it {float((stop - start) / MOST_STEPS):.3g} s or more."))
        else:
            return made
        return None

    def tolerance(self) -> float | None:
        if "tolerance" not in self.given:
            return None
        value = self.given["tolerance"]
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1:
            self.faults.append(("tolerance", f"must be a number between 0 and 1, not {_shown(value)}.", ""))
            return None
        return float(value)

    def steps(self) -> dict[str, Fraction] | None:
        steps = self.given.get("steps", {})
        if not isinstance(steps, Mapping):
            self.faults.append(("steps", f"must be an object of steps by block, not {_shown(steps)}.", ""))
            return None
        made = {str(name): self.time("steps", raw, f"{quoted(str(name))} ") for name, raw in steps.items()}
        return {name: step for name, step in made.items() if step is not None}


def read_settings(raw: Mapping[str, Any], /, **overrides: Any) -> tuple[RunSettings, list[tuple[str, str, str, str]]]:
    """The settings of a file's `run` with overrides on top, and its faults as (key, code, message, cure).

    An override that is None is none. One of the method takes the file's step away where the method chooses its own;
    one of the master replaces the keys that it has.
    """
    over = {key: value for key, value in overrides.items() if value is not None}
    master = over.pop("master", None)
    reader = _Settings({**raw, **over})
    reader.times()
    reader.jumps()
    reader.stops()
    reader.tolerances()
    reader.method(step_of_file="method" in over and "step" not in over)
    reader.seed()
    reader.loops()
    reader.inputs()
    reader.log()
    reader.master(master)
    return RunSettings(**reader.made), reader.faults
