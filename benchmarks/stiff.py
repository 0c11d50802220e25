"""Stiff models against CVODE in C and SciPy, at equal error.

    python -m benchmarks stiff                  # the table
    python -m benchmarks.stiff --plot DIR       # work and precision of each problem, as figures

Each problem is run at tolerances from 1e-3 to 1e-9 by blocks (radau, native), CVODE (BDF, exact Jacobians, dense or of a
band; c/stiff.c) and SciPy's Radau. The error is the largest over the states at the end, each relative to its size. The
ratio of a problem is that of the times at the error which CVODE has at rtol 1e-6, by straight lines in the logarithms of
what each gives at several tolerances.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from blocks.compile.toolchain.compiler import FLAGS
from blocks.text.errors import BlocksError

from .measure import BUILD, FOLDER, compiler, on_one_core
from .stiff_problems import PROBLEMS, Problem

__all__ = ["main"]

Array = np.ndarray[Any, Any]
Curve = list[tuple[float, float]]
"""Errors and seconds of a program, from the loosest tolerance to the tightest."""

RTOLS = tuple(10.0 ** (-k / 2) for k in range(6, 19))
WANTED, WANTED_LARGE = 2.0, 1.2
LIBRARIES = ("cvode", "nvecserial", "sunlinsolband", "sunmatrixband", "sunlinsoldense", "sunmatrixdense")


class Cvode:
    """The program in C. flags: of the compiler. Raises RuntimeError where it cannot be built."""

    def __init__(self, name: str, *flags: str) -> None:
        cc = compiler()
        if cc is None:
            raise RuntimeError("there is no C compiler")
        BUILD.mkdir(parents=True, exist_ok=True)
        self.program = BUILD / name
        source = FOLDER / "c" / "stiff.c"
        command = [cc, *flags, "-o", str(self.program), str(source), *(f"-lsundials_{name}" for name in LIBRARIES), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError("SUNDIALS is not installed (libsundials-dev)")

    def run(self, problem: Problem, rtol: float) -> tuple[float, Array]:
        words = [str(self.program), problem.name, repr(rtol), repr(problem.atol * rtol), str(problem.runs)]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"CVODE failed with {problem.name} at {rtol:g}")
        seconds, _, *states = map(float, done.stdout.split())
        return seconds, np.array(states)


def by_blocks(problem: Problem, diagram: Any, rtol: float, runs: int | None = None) -> tuple[float, Array]:
    settings = {"rtol": rtol, "atol": problem.atol * rtol, "stop": problem.stop, "every": problem.stop}
    made = [
        diagram.run(method="radau", engine="native", log=problem.log, **settings) for _ in range(runs or problem.runs)
    ]
    best = min(made, key=lambda results: results.statistics.seconds)
    return best.statistics.seconds, np.concatenate([np.ravel(best[name][-1]) for name in problem.log])


def by_scipy(problem: Problem, diagram: Any, rtol: float) -> tuple[float, Array]:
    """SciPy's Radau, with the same compiled rates as ours are by the reference engine, and its own differences."""
    import time

    from scipy.integrate import solve_ivp

    from blocks.engines.reference.python_code import CompiledPrograms

    plan = diagram.plan()
    program = CompiledPrograms(plan).program("derivatives", plan.derivatives)
    d, s = ((1.0,) * len(row) for row in (plan.discretes, plan.s_start))

    def rates(t: float, x: Array) -> Array:
        return np.array(program(t, x.tolist(), d, s, plan.parameters, (), (), (), (), ()))

    start = np.array([reference.value for reference in ()])
    begun = time.process_time()
    made = solve_ivp(rates, (0.0, problem.stop), start, "Radau", rtol=rtol, atol=problem.atol * rtol)
    return time.process_time() - begun, made.y[:, -1]


def error_of(states: Array, exact: Array) -> float:
    return float(np.max(np.abs(states - exact) / np.maximum(np.abs(exact), 1e-3 * np.max(np.abs(exact)))))


def seconds_at(curve: Curve, error: float) -> float:
    """The time of the straight lines through what a program gives, at an error; NaN beyond their ends."""
    points = sorted((math.log(e), math.log(s)) for e, s in curve)
    best = math.nan
    for (e0, s0), (e1, s1) in zip(points, points[1:], strict=False):
        if e0 <= math.log(error) <= e1:
            there = math.exp(s0 + (s1 - s0) * (math.log(error) - e0) / max(e1 - e0, 1e-12))
            best = there if math.isnan(best) else min(best, there)
    return best


def curves(problem: Problem, cvodes: dict[str, Cvode]) -> tuple[dict[str, Curve], float]:
    """What each program gives, and the error of CVODE at rtol 1e-6. The exact states: ours at 1e-12."""
    diagram = problem.made()
    _, exact = by_blocks(problem, diagram, problem.tight, 1)
    made: dict[str, Curve] = {"blocks": []}
    for rtol in RTOLS:
        seconds, states = by_blocks(problem, diagram, rtol)
        made["blocks"].append((max(error_of(states, exact), 1e-13), seconds))
    at = math.nan
    for name, cvode in cvodes.items():
        made[name] = []
        for rtol in RTOLS[::2]:
            try:
                seconds, states = cvode.run(problem, rtol)
            except RuntimeError:
                continue
            error = max(error_of(states, exact), 1e-13)
            made[name].append((error, seconds))
            if abs(rtol / 1e-6 - 1) < 1e-6 and math.isnan(at):
                at = error
    return made, at


def main() -> None:
    with on_one_core():
        _table()


def _table() -> None:
    try:
        cvodes = {"CVODE": Cvode("cvode", "-O2"), "CVODE, our flags": Cvode("cvode_own", *FLAGS)}
    except RuntimeError as error:
        print(f"without CVODE: {error}")
        cvodes = {}
    ratios: dict[str, list[float]] = {}
    for problem in PROBLEMS:
        made, at = curves(problem, cvodes)
        told = [f"{problem.name:18}"]
        ours = seconds_at(made["blocks"], at)
        for name in cvodes:
            theirs = seconds_at(made[name], at)
            ratios.setdefault(name, []).append(ours / theirs)
            told.append(f"{name} {1e3 * theirs:9.3f} ms  ratio {ours / theirs:6.2f}")
        print("  ".join([*told, f"blocks {1e3 * ours:9.3f} ms at error {at:.1e}"]), flush=True)
    for name, values in ratios.items():
        mean = math.exp(float(np.mean(np.log(values))))
        verdict = "met" if mean <= WANTED else "MISSED"
        large = "met" if values[-1] <= WANTED_LARGE else "MISSED"
        print(f"against {name}: geometric mean {mean:.2f}, goal {WANTED} {verdict}; 1,000 states {values[-1]:.2f}, goal {WANTED_LARGE} {large}")


if __name__ == "__main__":
    main()
