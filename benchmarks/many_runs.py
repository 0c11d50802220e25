"""Many runs of the paper's robot with varied inertia: a batch beside single runs, and beside a pool of processes.

`python -m benchmarks.many_runs BASE` measures the runs of another checkout too, in turns. Seconds are those of the
processor, the least of the rounds, per row; two threads are measured by the wall clock, on a machine that is quiet.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from .diagrams import p1

ROOT = Path(__file__).resolve().parent.parent
ROBOT = "diagrams/paper/iadrc.json"
ROUNDS = 5
ROWS = 20
ROBOTS = 64
TINY = 3e-6  # s
GOALS = {"4 lanes": 35 / 15, "8 lanes": 35 / 12}
BARE = """
import json, resource, sys
from blocks import Diagram
robot = Diagram.load("diagrams/paper/iadrc.json")
values = [0.2752 + 0.001 * k for k in range(20)]
robot.run(parameters={"Jeq": values[0]})
for _ in sys.stdin:
    before = resource.getrusage(resource.RUSAGE_SELF)
    for value in values:
        robot.run(parameters={"Jeq": value})
    after = resource.getrusage(resource.RUSAGE_SELF)
    print(json.dumps(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime), flush=True)
"""


def main(base: str = "") -> None:
    from blocks import Diagram

    robot = Diagram.load(ROOT / ROBOT)
    table = [[0.2752 + 0.001 * k] for k in range(ROWS)]
    whole, bare = robot.batch(["Jeq"]), robot.batch(["Jeq"], measures=[])
    short = robot.batch(["Jeq"], stop=0.001)
    many = [[0.2752 + 1e-5 * k] for k in range(2000)]
    share = short(many[:1]).steps[0] / whole(table[:1]).steps[0]  # of the steps of a long row
    other = _Other(Path(base).resolve()) if base else None
    cases: dict[str, Callable[[], Any]] = {
        "batch": lambda: whole(table, threads=1),
        "batch without measures": lambda: bare(table, threads=1),
        "runs, one by one": lambda: [robot.run(parameters={"Jeq": row[0]}) for row in table],
    }
    least = {name: float("inf") for name in (*cases, "base", "row")}
    for case in cases.values():
        case()
    for _ in range(ROUNDS):
        for name, case in cases.items():
            least[name] = min(least[name], _cpu(case) / ROWS)
        least["row"] = min(least["row"], _cpu(lambda: short(many, threads=1)) / len(many))
        if other is not None:
            least["base"] = min(least["base"], other.seconds() / ROWS)
    batch = least["batch"]
    print(f"{'the robot, 100 s, eight measures':44} {1e3 * batch:8.2f} ms a row")
    _ratio("beside the same without measures", batch / least["batch without measures"], 1.3)
    _ratio("beside runs, one by one", batch / least["runs, one by one"], None)
    if other is not None:
        _ratio(f"beside runs of {base} ({1e3 * least['base']:.1f} ms)", batch / least["base"], 0.5)
    beyond = 1e3 * (least["row"] - share * batch)
    print(f"{'a row of 1 ms, beyond its simulation':44} {beyond:8.3f} ms   {_verdict(beyond <= 0.1)} 0.1 ms")
    _threads(whole, table)
    _lanes(robot)
    _tiny()
    _first(robot)
    _pool()


def _threads(whole: Any, table: list[list[float]]) -> None:
    """The wall clock of one thread and of two."""
    one, two = (min(_wall(lambda n=n: whole(table, threads=n)) for _ in range(ROUNDS)) for n in (1, 2))  # type: ignore[misc]
    print(f"{'two threads, by the wall clock':44} {one / two:8.2f} x    {_verdict(one / two >= 1.9)} 1.9 x")


def _lanes(robot: Any) -> None:
    """Robots that differ in four values, on one core: one at a time, and in lanes of this processor and smaller ones.

    Without measures and one at a time is the floor: a loop in C over rows of parameters, with the engine's flags.
    """
    from blocks.compile.c.lane_code import Machine

    own = Machine.own()
    if own is None:
        print("no lanes: they need gcc on Linux and x86-64")
        return
    names = ["Jeq", "torque", "control_*.eso.Ka", "control_*.td.R"]
    draws = np.random.default_rng(1).uniform(-0.1, 0.1, (ROBOTS, len(names)))
    for what, measures in (("no measures", []), ("eight measures", None)):
        batches = {"one at a time": robot.batch(names, measures=measures)}
        for width in (4, 8)[: 1 + (own.width == 8)]:
            with mock.patch.object(Machine, "own", staticmethod(lambda width=width: Machine.of(width))):
                batches[f"{width} lanes"] = robot.batch(names, measures=measures, lanes="fast")
        table = np.array(batches["one at a time"].nominal) * (1 + draws)
        least = dict.fromkeys(batches, float("inf"))
        for _ in range(3):
            for name, batch in batches.items():
                least[name] = min(least[name], _cpu(partial(batch, table, threads=1)) / ROBOTS)
        for name, seconds in least.items():
            print(f"{f'{ROBOTS} robots, {what}, {name}':44} {1e3 * seconds:8.2f} ms a row")
            if name in GOALS:
                _at_least(f"  {name}, beside one at a time", least["one at a time"] / seconds, GOALS[name])


def _tiny() -> None:
    """A row of a model with one state and a measure, in ten steps: what a row costs beyond its simulation."""
    from blocks import Diagram, FirstOrder, Step

    diagram = Diagram("tiny")
    diagram.wire(diagram.add("lag", FirstOrder()).u, diagram.add("step", Step(at=0.0)).y)
    diagram.measure("ISE", "ISE", of="lag.y", against="step.y")
    diagram.settings(stop=1.0, method="rk4", step=0.1)
    for lanes in ("exact", "fast"):
        batch = diagram.batch(["lag.T"], lanes=lanes)
        for n in (10**3, 10**5):
            table = np.linspace(0.3, 0.6, n)[:, None]
            cases: dict[str, Callable[[], Any]] = {
                "batch": lambda batch=batch, table=table: batch(table, threads=1),
                "sweep": lambda lanes=lanes, table=table: diagram.sweep({"lag.T": table[:, 0]}, threads=1, lanes=lanes),
            }
            for name, case in cases.items():
                case()
                seconds = min(_cpu(case) for _ in range(ROUNDS)) / n
                goal = f"   {_verdict(seconds <= TINY)} {1e6 * TINY:.0f} us" if (name, n) != ("sweep", 10**3) else ""
                print(f"{f'a tiny row, {lanes}, {name} of {n}':44} {1e6 * seconds:8.2f} us{goal}")


def _at_least(label: str, ratio: float, goal: float) -> None:
    print(f"{label:44} {ratio:8.2f} x    {_verdict(ratio >= goal)} {goal:.2f} x")


def _first(robot: Any) -> None:
    """From a diagram to its first row, compiled before."""
    seconds = min(_wall(lambda: robot.copy().batch(["Jeq"], stop=0.001)([[0.27]])) for _ in range(ROUNDS))
    print(f"{'from a diagram to its first row':44} {seconds:8.3f} s    {_verdict(seconds <= 0.3)} 0.3 s")


def _pool() -> None:
    """P1 with varied b0, by a batch and by SciPy in a pool: both on all cores, start-up of the pool not counted."""
    values = [1.7 + 0.005 * k for k in range(16)]
    batch = p1().batch(["law.b0"], log=["motor.omega"], every=1.0)
    ours = min(_wall(lambda: batch([[value] for value in values])) for _ in range(ROUNDS))
    found = batch([[value] for value in values]).signals["motor.omega"][:, -1]
    with multiprocessing.get_context("spawn").Pool() as pool:
        pool.map(by_scipy, values[:2])
        begun = time.perf_counter()
        theirs = pool.map(by_scipy, values)
        seconds = time.perf_counter() - begun
    apart = max(abs(a - b) for a, b in zip(found, theirs, strict=True))
    label = "P1, 16 rows: SciPy's RK45 in processes"
    print(f"{label:44} {1e3 * seconds / 16:8.0f} ms a row, {seconds / ours:.0f} x a batch; ends differ by {apart:.0e}")


def by_scipy(b0: float) -> float:
    """The speed of P1 at its end."""
    from scipy.integrate import solve_ivp

    from benchmarks.peer_scripts import problem as p

    def rates(t: float, x: Any, d: float) -> tuple[float, ...]:
        w, i, z1, z2, z3 = x.tolist()
        u = min(max((144.0 * (1.0 - z1) - 25.0 * z2 - z3) / b0, -p.LIMIT), p.LIMIT)
        e = w - z1
        return (
            -0.3922 * w / p.J + 1.1882 * i / (p.J * p.N_GEAR) - d / (p.J * p.N_GEAR),
            -1.185 * p.N_GEAR * w / p.L - 0.1557 * i / p.L + u / p.L,
            z2 + 30.4 * e, z3 + p.B0 * u + 513.4 * e, 1570.8 * e,
        )  # fmt: skip

    x = [0.0] * 5
    for begin, end, d in ((0.0, p.ON, 0.0), (p.ON, p.OFF, p.PULSE), (p.OFF, 100.0, 0.0)):
        x = solve_ivp(rates, (begin, end), x, "RK45", args=(d,), rtol=p.RTOL, atol=p.ATOL).y[:, -1]
    return float(x[0])


def _ratio(label: str, ratio: float, goal: float | None) -> None:
    told = "" if goal is None else f"   {_verdict(ratio <= goal)} {goal} x"
    print(f"{label:44} {ratio:8.2f} x {told}")


def _verdict(is_met: bool) -> str:
    return "met" if is_met else "MISSED"


def _cpu(case: Callable[[], Any]) -> float:
    before = resource.getrusage(resource.RUSAGE_SELF)
    case()
    after = resource.getrusage(resource.RUSAGE_SELF)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _wall(case: Callable[[], Any]) -> float:
    begun = time.perf_counter()
    case()
    return time.perf_counter() - begun


class _Other:
    """Runs of another checkout, in a process of its own."""

    def __init__(self, root: Path) -> None:
        surroundings = {**os.environ, "PYTHONPATH": str(root)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", BARE], cwd=root, env=surroundings, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )  # fmt: skip

    def seconds(self) -> float:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return float(json.loads(self.process.stdout.readline()))


if __name__ == "__main__":
    main(*sys.argv[1:2])
