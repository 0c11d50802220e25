"""Copies: a fleet of the paper's robots: from its file to the first step, a further start, memory, the time of a step.

Starts are measured in processes of their own; steps are rk4 of 1 ms, against one robot and a loop over robots in
C. Then the same starts with radau, and its steps, of robots and of stiff oscillators that are coupled or not. At last
what it costs that all copies share their steps: relays that switch at different times.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from fractions import Fraction
from typing import Any

from . import diagrams
from .measure import FOLDER, Program, native, on_one_core

__all__ = ["fleet", "main", "relays", "worker"]

COUNTS = (1, 10, 100, 1000, 10_000)
GOALS = {1000: (1.0, 0.3, None), 10_000: (8.0, 0.5, 2e9)}
"""By the number of robots: s from the file to the first step, s of a further start, bytes."""
STACK = 2**29  # of the thread that runs the C program, which has all states on its stack


def fleet(count: int, *, differ: bool = False, method: str = "rk4") -> dict[str, Any]:
    """A document with so many robots; differ: each has a load and a start of its own."""
    robots: dict[str, Any] = {"copies": count, "diagram": "iadrc.json"}
    if differ:
        robots["parameters"] = {"torque": "=3*index/copies", "heading": "=0.1*index"}
    run: dict[str, Any] = {"stop": 1, "method": method, "every": 0.01, "log": ["robots.omega_right[0]"]}
    run |= {"step": 0.001} if method == "rk4" else {}
    return {"format": "blocks-diagram", "version": 3, "name": "fleet", "blocks": {"robots": robots}, "run": run}


def worker(path: str) -> None:
    """Load, start, do one step; start once more. Prints what it took as JSON. Runs in a process of its own."""
    import resource

    import blocks.api.run
    import blocks.engines.native.native_engine  # noqa: F401
    from blocks import Diagram

    begun, start = time.perf_counter(), _processor()
    diagram = Diagram.load(path)
    diagram.start(engine="native").advance(0.001)
    first, middle = time.perf_counter(), _processor()
    diagram.copy().start(engine="native")
    second = time.perf_counter()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    times = {"first": first - begun, "second": second - first}
    print(json.dumps({**times, "cpu": middle - start, "cpu_2": _processor() - middle, "peak": peak}))


def _processor() -> float:
    """Seconds of the processor so far, those of the compiler too."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _started(count: int, **how: Any) -> dict[str, float]:
    """The least of three processes, each with a cache that knows the runtime and no diagram."""
    made: list[dict[str, float]] = []
    folder = diagrams.ROOT / "diagrams" / "paper"
    with tempfile.NamedTemporaryFile("w", suffix=".json", dir=folder) as file, tempfile.TemporaryDirectory() as cache:
        for k in range(4):
            # Another name is another text, which is compiled anew.
            json.dump({**fleet(count, **how), "name": f"fleet_{k}"}, file)
            file.flush()
            code = "import sys; from benchmarks.fleet import worker; worker(sys.argv[1])"
            done = subprocess.run(
                [sys.executable, "-c", code, file.name], cwd=diagrams.ROOT, capture_output=True, text=True, check=True,
                env={**os.environ, "BLOCKS_CACHE_DIR": cache},
            )  # fmt: skip
            made.append(json.loads(done.stdout.splitlines()[-1]))
            file.seek(0)
            file.truncate()
    return {key: min(one[key] for one in made[1:]) for key in made[0]}


def _in_c(count: int, stop: float) -> float:
    """ns for each right-hand side and robot of the loop in C."""
    program = Program(FOLDER / "c" / "robot.c", 16, ROBOTS=count)
    seconds: list[float] = []

    def run() -> None:
        seconds.extend(program.run(stop, step=Fraction(1, 1000)).seconds for _ in range(3))

    before = threading.stack_size(STACK)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    threading.stack_size(before)
    return 1e9 * min(seconds) / (4 * 1000 * stop * count)


def _tell_start(count: int, what: str, **how: Any) -> float:
    """Print what a start takes; return the seconds of the processor of a further one."""
    made = _started(count, **how)
    pairs = zip((made["first"], made["second"], made["peak"]), GOALS.get(count, (None, None, None)), strict=True)
    told = ["" if goal is None else " met" if value <= goal else " MISSED" for value, goal in pairs]
    print(f"  {f'{count} {what}':48} {made['first']:6.2f} s{told[0]}  {made['second']:6.3f} s{told[1]}"
          f"  {made['peak'] / 1e6:6.0f} MB{told[2]}; of the processor {made['cpu']:.2f} and {made['cpu_2']:.2f} s",
          flush=True)  # fmt: skip
    return made["cpu_2"]


def main() -> None:
    from blocks import Diagram

    print("from the file to the first step, with a cache that does not know the diagram; a further start; memory")
    _tell_start(100, "robots")
    for count in (1000, 10_000):
        alike = _tell_start(count, "robots")
        differ = _tell_start(count, "robots, each with its own numbers", differ=True)
        print(f"  {'':48} {differ / alike:6.2f} x equal robots for a further start", flush=True)
    for count in (1000, 10_000):
        _tell_start(count, "robots by radau, each with its own numbers", differ=True, method="radau")
    print("ns for each right-hand side and robot, rk4")
    folder = diagrams.ROOT / "diagrams" / "paper"
    alone = 0.0
    with on_one_core():
        for count in COUNTS:
            stop = max(0.02, min(20.0, 200.0 / count))
            diagram = Diagram.from_json(fleet(count), folder=folder)
            diagram.run(stop=0.02, engine="native")
            ours = min(native(diagram, stop=stop).seconds for _ in range(3)) * 1e9 / (4 * 1000 * stop * count)
            alone = alone or ours
            verdict = "met" if ours <= 1.2 * alone else "MISSED"
            theirs = _in_c(count, stop)
            print(f"  {count:6} {ours:6.0f} ns  {ours / alone:5.2f} x one, goal 1.2 {verdict:6}  C {theirs:6.0f} ns"
                  f"  {ours / theirs:5.2f} x C", flush=True)  # fmt: skip
        _stiff()
        _relays()


def cells(count: int, adjacency: Any = None) -> dict[str, Any]:
    """Stiff oscillators, each with its own damping; adjacency: of those that pull each other."""
    from blocks import graph

    each = {"mu": "=50+50*index/copies", "x_start": "=2-index/copies"}
    blocks: dict[str, Any] = {"cells": {"type": "VanDerPol", "copies": count, "parameters": each}}
    wires = {}
    if adjacency is not None:
        pull = (-5.0 * graph.laplacian(adjacency)).tocoo()
        edges = [[int(i), int(j), float(k)] for i, j, k in zip(pull.row, pull.col, pull.data, strict=True)]
        blocks["mix"] = {"type": "MatrixGain", "parameters": {"K": {"edges": edges, "shape": [count, count]}}}
        wires = {"mix.u": "cells.x", "cells.u": "mix.y"}
    run = {"stop": 1, "method": "radau", "every": 1, "log": ["cells.x[0]"]}
    return {"format": "blocks-diagram", "version": 3, "name": "cells", "blocks": blocks, "wires": wires, "run": run}


def _stiff() -> None:
    from blocks import Diagram, graph

    print("us of the processor for each step of radau and copy, to the first step before")
    robots = [(f"{n} robots", fleet(n, differ=True, method="radau")) for n in (10, 100, 1000)]
    links = {"alone": None, "in a ring": graph.ring(1000), "in a grid of 40 by 25": graph.grid(40, 25)}
    coupled = [(f"1000 cells {name}", cells(1000, adjacency)) for name, adjacency in links.items()]
    one = 0.0
    for what, document in (*robots, *coupled):
        diagram = Diagram.from_json(document, folder=diagrams.ROOT / "diagrams" / "paper")
        begun = _processor()
        diagram.start(engine="native").advance(1e-6)
        first = _processor() - begun
        seconds = []
        for _ in range(3):
            begun = time.process_time()
            steps = diagram.run(engine="native").statistics.steps
            seconds.append(time.process_time() - begun)
        each = 1e6 * min(seconds) / (steps * int(what.split()[0]))
        one = one or each
        ratio = f"  {each / one:5.2f} x ten robots" if "robots" in what else ""
        print(f"  {what:32} {each:6.2f} us  {steps:6} steps  first {first:5.2f} s{ratio}", flush=True)


def relays(count: int) -> dict[str, Any]:
    """Lags under relays that switch at times of their own: 20 times each in 10 s."""
    loop = {
        "parameters": {"phase": 0},
        "outputs": {"y": "lag.y"},
        "blocks": {
            "wave": {"type": "Sine", "parameters": {"omega": 6.283185307179586, "phase": "=phase"}},
            "relay": {"type": "Relay", "parameters": {"on_at": 0.1, "off_at": -0.1}},
            "lag": {"type": "FirstOrder", "parameters": {"T": 0.5}},
        },
        "wires": {"relay.u": "wave.y", "lag.u": "relay.y"},
    }
    blocks = {"loops": {"copies": count, "diagram": loop, "parameters": {"phase": "=6.283185307179586*index/copies"}}}
    run = {"stop": 10, "every": 0.1, "log": ["loops.y[0]"]}
    return {"format": "blocks-diagram", "version": 3, "name": "relays", "blocks": blocks, "run": run}


def _relays() -> None:
    from blocks import Diagram

    print("relays that switch at different times, 20 times each in 10 s, dopri5")
    one = 0.0
    for count in (1, 10, 100, 1000):
        diagram = Diagram.from_json(relays(count))
        results = diagram.run(engine="native")
        seconds, steps, events = results.statistics.seconds, results.statistics.steps, len(results.events)
        one = one or seconds
        each = 1e6 * seconds / (steps * count)
        print(f"  {count:6} {seconds:8.4f} s  {steps:7} steps  {events:6} events  {each:6.3f} us a step and copy"
              f"  {seconds / (one * count):6.1f} x as long as runs one by one", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
