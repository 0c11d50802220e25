"""Stiff models against CVODE in C and SciPy, at equal error.

    python -m benchmarks stiff                   # the table
    python -m benchmarks.stiff --plot FILE.svg   # work and precision of each problem

Each problem is run at tolerances from 1e-3 to 1e-8 by blocks (radau, native), CVODE (BDF, exact Jacobians, dense or of
a band; c/stiff.c) and SciPy's Radau. The error is the largest over the states at the end, each relative to its size.
The ratio of a problem is that of the times at the error which CVODE has at rtol 1e-6, by straight lines in the
logarithms of what each gives at several tolerances. The program with CVODE is built by -O2 and by the engine's flags.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import math
import subprocess
import time
from typing import Any

import numpy as np

from blocks.compile.toolchain.compiler import FLAGS

from .measure import BUILD, FOLDER, compiler, on_one_core
from .stiff_problems import PROBLEMS, Problem

__all__ = ["main"]

Array = np.ndarray[Any, Any]
Curve = list[tuple[float, float]]
"""Errors and seconds of a program, from the loosest tolerance to the tightest."""

RTOLS = tuple(10.0 ** (-k / 2) for k in range(6, 17))
COMPARED = 1e-6
GOAL, GOAL_LARGE = 2.0, 1.2
LEAST = 1e-12  # of errors: that of the states that count as exact
LIBRARIES = ("cvode", "nvecserial", "sunlinsolband", "sunmatrixband", "sunlinsoldense", "sunmatrixdense")


class Cvode:
    """The program in C. flags: of the compiler. Raises RuntimeError where it cannot be built."""

    def __init__(self, name: str, *flags: str) -> None:
        cc = compiler()
        if cc is None:
            raise RuntimeError("there is no C compiler")
        BUILD.mkdir(parents=True, exist_ok=True)
        self.program = BUILD / name
        libraries = [f"-lsundials_{library}" for library in LIBRARIES]
        command = [cc, *flags, "-o", str(self.program), str(FOLDER / "c" / "stiff.c"), *libraries, "-lm"]
        if subprocess.run(command, capture_output=True, text=True).returncode:
            raise RuntimeError("SUNDIALS is not installed (libsundials-dev)")

    def run(self, problem: Problem, rtol: float) -> tuple[float, Array]:
        words = [str(self.program), problem.name, repr(rtol), repr(problem.atol * rtol), str(problem.runs)]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"CVODE failed with {problem.name} at {rtol:g}")
        seconds, _, *states = map(float, done.stdout.split())
        return seconds, np.array(states)


def by_blocks(problem: Problem, diagram: Any, rtol: float, runs: int) -> tuple[float, Array]:
    settings = {"rtol": rtol, "atol": problem.atol * rtol, "stop": problem.stop, "every": problem.stop}
    least = math.inf
    for _ in range(runs):
        run = diagram.start(method="radau", engine="native", log=problem.log, **settings)
        begun = time.process_time()
        results = run.finish()
        spent = time.process_time() - begun  # of the processor, which others may hold; with what Python does around it
        least = min(least, spent, results.statistics.seconds)
    return least, np.concatenate([np.ravel(results[name][-1]) for name in problem.log])


def by_scipy(problem: Problem, rtol: float) -> tuple[float, Array]:
    from scipy.integrate import solve_ivp

    def rates(t: float, x: Array) -> Array:
        return np.array(problem.rates(t, x))

    begun, span, atol = time.process_time(), (0.0, problem.stop), problem.atol * rtol
    made = solve_ivp(rates, span, problem.start, "Radau", rtol=rtol, atol=atol, max_step=problem.stop / 50)
    return time.process_time() - begun, made.y[:, -1]


def error_of(problem: Problem, states: Array, exact: Array) -> float:
    sizes = np.maximum(np.abs(exact), problem.floor * np.max(np.abs(exact)))
    return max(float(np.max(np.abs(states - exact) / sizes)), LEAST)


def seconds_at(curve: Curve, error: float) -> float:
    """The least time of the straight lines through what a program gives, at an error; NaN beyond their ends."""
    found = []
    for (e0, s0), (e1, s1) in itertools.pairwise(sorted(curve)):
        if e0 <= error <= e1:
            share = math.log(error / e0) / max(math.log(e1 / e0), 1e-12)
            found.append(s0 * (s1 / s0) ** share)
    return min(found, default=math.nan)


def exact_of(problem: Problem, diagram: Any) -> Array:
    return by_blocks(problem, diagram, problem.tight, 1)[1]


def curve_of_blocks(problem: Problem, diagram: Any, exact: Array) -> Curve:
    made = [by_blocks(problem, diagram, rtol, problem.runs) for rtol in RTOLS]
    return [(error_of(problem, states, exact), seconds) for seconds, states in made]


def main() -> None:
    with on_one_core():
        _table()


def _table() -> None:
    try:
        program, same = Cvode("cvode", "-O2"), Cvode("cvode_same", *FLAGS)
    except RuntimeError as error:
        print(f"without CVODE: {error}")
        program = same = None
    ratios, others = [], []
    for problem in PROBLEMS:
        diagram = problem.made()
        exact = exact_of(problem, diagram)
        curve = curve_of_blocks(problem, diagram, exact)
        if program is None or same is None:
            error, ours = curve[6]
            theirs, states = by_scipy(problem, COMPARED)
            told = f"blocks {1e3 * ours:9.3f} ms at error {error:.1e}, SciPy {theirs:.3f} s"
            print(f"{problem.name:18} {told}", flush=True)
            continue
        theirs, states = program.run(problem, COMPARED)
        error, other = error_of(problem, states, exact), same.run(problem, COMPARED)[0]
        ours = seconds_at(curve, error)
        if math.isnan(ours):  # it is nowhere as inexact: at its loosest tolerance
            ours = curve[0][1]
        ratios.append(ours / theirs)
        others.append(ours / other)
        told = f"CVODE {1e3 * theirs:9.3f} ms, error {error:.1e}; blocks {1e3 * ours:9.3f} ms"
        print(f"{problem.name:18} {told}: ratio {ratios[-1]:.2f}, by the engine's flags {others[-1]:.2f}", flush=True)
    for name, values in (("-O2", ratios), ("the engine's flags", others)) if ratios else ():
        mean = math.exp(float(np.mean(np.log(values))))
        verdicts = ["met" if value <= goal else "MISSED" for value, goal in ((mean, GOAL), (values[-1], GOAL_LARGE))]
        told = f"geometric mean {mean:.2f}, goal {GOAL} {verdicts[0]}"
        print(f"against CVODE by {name}: {told}; 1,000 states {values[-1]:.2f}, goal {GOAL_LARGE} {verdicts[1]}")


def plot(path: str) -> None:
    """Work and precision of each problem, as a figure."""
    import matplotlib.pyplot as plt

    plt.rcParams["svg.fonttype"] = "none"  # texts as texts: a third of the bytes
    program = Cvode("cvode", "-O2")
    figure, axes = plt.subplots(2, 5, figsize=(11, 5), layout="constrained")
    for ax, problem in zip(axes.ravel(), PROBLEMS, strict=True):
        diagram = problem.made()
        exact = exact_of(problem, diagram)
        curves = {"blocks": curve_of_blocks(problem, diagram, exact), "CVODE": [], "SciPy Radau": []}
        for rtol in RTOLS[::2]:
            with contextlib.suppress(RuntimeError):  # at a loose tolerance it may fail
                seconds, states = program.run(problem, rtol)
                curves["CVODE"].append((error_of(problem, states, exact), seconds))
            if problem.in_scipy and rtol > 1e-7:
                seconds, states = by_scipy(problem, rtol)
                curves["SciPy Radau"].append((error_of(problem, states, exact), seconds))
        for (name, curve), marker in zip(curves.items(), "os^", strict=True):
            if curve:
                ax.loglog(*zip(*curve, strict=True), marker + "-", markersize=3, linewidth=1, label=name)
        ax.set_title(problem.name, fontsize=9)
        ax.invert_xaxis()
        ax.tick_params(labelsize=7, which="both")
        ax.grid(visible=True, linewidth=0.3)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    figure.supxlabel("error at the end", fontsize=9)
    figure.supylabel("time in s", fontsize=9)
    figure.savefig(path, metadata={"Date": None} if path.endswith(".svg") else None)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--plot", metavar="FILE")
    options = parser.parse_args()
    if options.plot:
        with on_one_core():
            plot(options.plot)
    else:
        main()
