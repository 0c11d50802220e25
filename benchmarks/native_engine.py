"""The native engine against hand-written C: the paper's robot, P1, P2, and loops that are each wired in another way."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from . import diagrams, irregular
from .measure import FOLDER, HEAD, Made, Program, difference, floors, in_turn, line, native, on_one_core

__all__ = ["main_irregular", "main_p1", "main_p2", "main_robot", "p1_programs", "p2_programs", "robot_programs"]

STEP = Fraction(1, 1000)
RK4: dict[str, Any] = {"method": "rk4", "step": 0.001}
Run = Callable[[], Made]


def p1_programs() -> dict[str, Program]:
    """P1 in C, in four ways, each by two sets of flags: see benchmarks/c/p1.c. The first is the fastest."""
    kinds = {"": (0, 0), ", divisions": (0, 1), ", located": (1, 0), ", located, divisions": (1, 1)}
    path = FOLDER / "c" / "p1.c"
    made: dict[str, Program] = {}
    for kind, (located, divided) in kinds.items():
        made |= floors(f"C{kind}", path, len(diagrams.P1_LOG), LOCATED=located, DIVIDED=divided)
    return made


def p2_programs(count: int) -> dict[str, Program]:
    """P2 in C. For one loop the first is that of P1: scalars are faster than arrays of one."""
    path, signals = FOLDER / "c" / "p2.c", len(diagrams.p2_log(count))
    made: dict[str, Program] = {}
    for kind, divided in (("", 0), (", divisions", 1)):
        made |= floors(f"C{kind}", path, signals, N=count, DIVIDED=divided)
    fastest = ("C", "C (engine's flags)")
    return made if count > 1 else made | {name: p1_programs()[name] for name in fastest}


def robot_programs() -> dict[str, Program]:
    """The robot in C: with the equations of the blocks, and with others that are equal to them."""
    path = FOLDER / "c" / "robot.c"
    return floors("C", path, 16, ALGEBRA=0) | floors("C, other algebra", path, 16, ALGEBRA=1)


def _seconds(name: str, run: Run, kept: dict[str, Made]) -> float:
    kept[name] = run()
    return kept[name].seconds


def _measured(runs: Mapping[str, Run], repeats: int = 9) -> tuple[dict[str, list[float]], dict[str, Made]]:
    """Seconds of each, and what the last runs gave."""
    kept: dict[str, Made] = {}
    return in_turn({name: partial(_seconds, name, run, kept) for name, run in runs.items()}, repeats), kept


def _compared(
    label: str, runs: Mapping[str, Run], goal: float, exact: Made, picked: list[int], most: float | None = None
) -> None:
    """A table: the runs called native... against those called C..., and what they gave.

    The goal is for pairs that do the same: native against C, or where the C programs locate crossings as the diagram
    does, against that; and "native, clipped" against C. picked: the signals whose errors are shown. most: the largest
    error allowed of the first of them.
    """
    print(f"{label}\n{HEAD}")
    made, kept = _measured(runs)
    theirs = [name for name in runs if name.startswith("C")]
    for ours in (name for name in runs if name.startswith("native")):
        alike = "C, located" if ours == "native" and "C, located" in theirs else "C"
        for name in theirs if ours == "native" else theirs[:2]:
            is_alike = name.removesuffix(" (engine's flags)") == alike and ours != "native, measures"
            print(line(f"  {ours} / {name}", made[ours], made[name], goal if is_alike else None))
    for name, one in kept.items():
        errors = difference(one, exact)[picked]
        verdict = "" if most is None else f" of {most:g} {'met' if errors[0] <= most else 'MISSED'}"
        shown = " ".join(f"{error:.1e}" for error in errors)
        print(f"    {name:26}{one.steps:8} steps {one.rejected:5} rejected  errors {shown}{verdict}", flush=True)


def _exact(diagram: Any) -> Made:
    """The reference engine at tight tolerances."""
    results = diagram.run(engine="reference", method="dopri5", rtol=1e-12, atol=1e-14)
    return Made(0.0, 0, 0, results.t, results.values)


def main_robot() -> None:
    diagram, measured = diagrams.robot(), diagrams.robot(measures=True)
    programs, exact = robot_programs(), _exact(diagram)
    picked = [1, 2, 10]  # both wheels' speeds, and the error of the heading
    with on_one_core():
        for label, step, settings in (
            ("dopri5, rtol 1e-6, atol 1e-9, 100 s, rows each 10 ms", None, {}),
            ("rk4 1 ms, 100 s, rows each 10 ms", STEP, RK4),
        ):
            runs: dict[str, Run] = {name: partial(made.run, 100.0, step=step) for name, made in programs.items()}
            runs["native"] = partial(native, diagram, **settings)
            runs["native, measures"] = partial(native, measured, **settings)
            _compared(label, runs, 1.15, exact, picked)


def main_p1() -> None:
    diagram, clipped, programs = diagrams.p1(), diagrams.p1("clipped"), p1_programs()
    exact = _exact(diagram)
    with on_one_core():
        for label, step, settings, most in (
            ("dopri5, rtol 1e-6, atol 1e-9, 100 s, rows each 10 ms", None, {}, 5e-5),
            ("rk4 1 ms, 100 s, rows each 10 ms", STEP, RK4, 3e-6),
        ):
            runs: dict[str, Run] = {name: partial(made.run, 100.0, step=step) for name, made in programs.items()}
            runs["native"] = partial(native, diagram, **settings)
            runs["native, clipped"] = partial(native, clipped, **settings)
            _compared(label, runs, 1.15, exact, [0], most)
        _call(diagram)


def _call(diagram: Any) -> None:
    """What a run costs in Python beyond what it costs inside the engine."""
    beyond, inside = [], []
    for _ in range(50):
        begun = time.perf_counter()
        results = diagram.run(engine="native")
        speed = np.asarray(results["motor.omega"])
        wall = time.perf_counter() - begun
        assert len(speed) > 1
        inside.append(results.statistics.seconds)
        beyond.append(wall - results.statistics.seconds)
    low, middle = 1e3 * min(beyond), 1e3 * statistics.median(beyond)
    verdict = "met" if low <= 0.1 else "MISSED"
    print(f"one call of run, results as arrays: {low:.3f} ms (median {middle:.3f}) beyond the engine's own time")
    print(f"    of {1e3 * min(inside):.3f} ms; goal 0.1 ms {verdict}")


def main_p2() -> None:
    witness = p1_programs()["C"].run(10.0, step=STEP)
    with on_one_core():
        print(f"rk4 1 ms, rows each 10 ms; per loop and 10 s\n{HEAD}")
        for count in (1, 10, 100, 1000, 10_000):
            diagram, clipped = diagrams.p2(count), diagrams.p2(count, "clipped")
            stop = 10.0 if count < 10_000 else 1.0  # the time of a step does not change
            runs: dict[str, Run] = {
                name: partial(made.run, stop, step=STEP) for name, made in p2_programs(count).items()
            }
            runs["native"] = partial(native, diagram, stop=stop)
            runs["native, clipped"] = partial(native, clipped, stop=stop)
            made, kept = _measured(runs, 7)
            each = {name: [s / count * 10.0 / stop for s in seconds] for name, seconds in made.items()}
            goal = 1.2 if count <= 1000 else 2.5
            print(line(f"  N = {count}: native, clipped / C", each["native, clipped"], each["C"], goal))
            print(line("    the same / C (engine's flags)", each["native, clipped"], each["C (engine's flags)"], goal))
            for name in ("C", "C, divisions"):
                print(line(f"  N = {count}: native / {name}", each["native"], each[name], None))
            for name, one in kept.items():
                # All loops are alike, so that the speed of P1 is that of each.
                speeds = one.values[:, :1] if one.values.shape[1] == 3 and count == 1 else one.values
                apart = max(_apart(one.t, column, witness) for column in speeds.T)
                print(f"    {name:26}{one.steps:8} steps  differs from P1 by {apart:.0e}", flush=True)


def _apart(t: Any, speed: Any, witness: Made) -> float:
    one = Made(0.0, 0, 0, t, speed[:, None])
    return float(difference(one, Made(0.0, 0, 0, witness.t, witness.values[:, :1]))[0])


def main_irregular(count: int = 200) -> None:
    diagram, programs = irregular.draw(count), floors("C", irregular.program(count), 10)
    with on_one_core():
        runs: dict[str, Run] = {name: partial(made.run, 5.0, step=STEP) for name, made in programs.items()}
        made, kept = _measured(runs | {"native": partial(native, diagram)})
    print(f"{count} loops, rk4 1 ms, 5 s, rows each 10 ms\n{HEAD}")
    for name in programs:
        print(line(f"  native / {name}", made["native"], made[name], 1.5))
    apart = difference(kept["C"], kept["native"]).max()
    print(f"    {kept['C'].steps} and {kept['native'].steps} steps, largest difference {apart:.0e}")
