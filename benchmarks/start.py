"""From a diagram file to the first result with the native engine, with a cold and with a warm cache; and the memory.

Every measurement is a process of its own, which imports all of blocks before its clock starts.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from . import diagrams

__all__ = ["change_worker", "main", "main_memory", "worker"]

CHANGED = {"P1": (0.2, 100.0), "robot": (0.25, 100.0), "600": (0.3, 0.1), "6000": (1.5, 0.1)}
"""Diagrams, with the goal in s of the first run after a change of their structure, and the stop time in s."""


def worker(path: str, signal: str, stop: str) -> None:
    """Load, run, read a signal; prints what it took as JSON. Runs in a process of its own."""
    import importlib
    import pkgutil
    import resource

    import blocks
    from blocks import Diagram

    for module in pkgutil.walk_packages(blocks.__path__, "blocks."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    begun = time.perf_counter()
    diagram = Diagram.load(path)
    loaded = time.perf_counter()
    results = diagram.run(stop=float(stop), engine="native")
    rows = len(results[signal])
    done = time.perf_counter()
    told = {
        "load": loaded - begun,
        "total": done - begun,
        "inside": results.statistics.seconds,
        "rows": rows,
        # Linux counts KiB, macOS bytes.
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024),
    }
    print(json.dumps(told))


def change_worker(name: str, quickly: str) -> None:
    """Run a diagram, add a block to it and run it again; prints what the second run took. In a process of its own."""
    from blocks import Gain, Step
    from blocks.engines.native import code

    code.QUICKLY = quickly == "True"
    with tempfile.TemporaryDirectory() as folder:
        if name in ("P1", "robot"):
            diagram = diagrams.p1() if name == "P1" else diagrams.robot()
        else:
            diagram = diagrams.Diagram.load(diagrams.save_p2(int(name) // 6, Path(folder)))
        stop = CHANGED[name][1]
        diagram.run(stop=stop, engine="native")
        added = diagram.add("added", Gain(k=2.0))
        diagram.wire(added.u, diagram.add("step", Step(at=0.0, after=1.0)).y)
        begun = time.perf_counter()
        diagram.run(stop=stop, engine="native")
        print(time.perf_counter() - begun)


def _show_changes(repeats: int) -> None:
    """The first run after a change, beside the same with optimised code from the start, in turn."""
    code = "import sys; from benchmarks.start import change_worker; change_worker(*sys.argv[1:])"
    for name, (goal, _) in CHANGED.items():
        seconds: dict[bool, list[float]] = {True: [], False: []}
        for _ in range(repeats):
            for quickly, known in seconds.items():
                # The optimised code may still be compiled there.
                with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as cache:
                    done = subprocess.run(
                        [sys.executable, "-c", code, name, str(quickly)],
                        cwd=diagrams.ROOT, env={**os.environ, "BLOCKS_CACHE_DIR": cache},
                        capture_output=True, text=True, check=True,
                    )  # fmt: skip
                    known.append(float(done.stdout.splitlines()[-1]))
        first, beside = statistics.median(seconds[True]), statistics.median(seconds[False])
        verdict = "met" if first <= goal else "MISSED"
        label = f"{name}, first run after a change"
        print(f"{label:38}{first:9.3f} s  optimised {beside:.3f} s  goal {goal:g} s {verdict}", flush=True)


def _measured(path: Path, signal: str, stop: float, cache: Path) -> dict[str, Any]:
    code = "import sys; from benchmarks.start import worker; worker(*sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), signal, repr(stop)],
        cwd=diagrams.ROOT,
        env={**os.environ, "BLOCKS_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    made: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return made


def _cold_and_warm(path: Path, signal: str, stop: float, repeats: int) -> dict[str, list[dict[str, Any]]]:
    made: dict[str, list[dict[str, Any]]] = {"cold": [], "warm": []}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            cache = Path(folder) / "cache"
            for name in ("cold", "warm"):
                made[name].append(_measured(path, signal, stop, cache))
    return made


def _show(label: str, made: list[dict[str, Any]], goal: float, *, beyond: bool) -> None:
    seconds = [one["total"] - (one["inside"] if beyond else 0.0) for one in made]
    least, median, load = min(seconds), statistics.median(seconds), min(one["load"] for one in made)
    verdict = "met" if least <= goal else "MISSED"
    print(f"{label:38}{least:9.3f} s  median {median:.3f}  (load {load:.3f})  goal {goal:g} s {verdict}", flush=True)


def main() -> None:
    _show_changes(5)
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        diagrams.p1().save(folder / "p1.json")
        made = _cold_and_warm(folder / "p1.json", "motor.omega", 100.0, 7)
        _show("P1, cold", made["cold"], 0.7, beyond=False)
        _show("P1, warm", made["warm"], 0.06, beyond=False)
        path = diagrams.save_p2(1000, folder)
        made = _cold_and_warm(path, "loop0.motor.omega", 0.1, 3)
        _show("P2, N = 1000, beyond the run, cold", made["cold"], 3.0, beyond=True)
        _show("P2, N = 1000, beyond the run, warm", made["warm"], 0.8, beyond=True)
        diagrams.p2_flat(1000).save(folder / "flat.json")
        made = _cold_and_warm(folder / "flat.json", "loop0_motor.omega", 0.1, 3)
        _show("the same without subdiagrams, cold", made["cold"], 3.0, beyond=True)
        _show("the same without subdiagrams, warm", made["warm"], 0.8, beyond=True)
        for count in (1250, 2500, 5000, 10_000):
            path = diagrams.save_p2(count, folder)
            cold = _cold_and_warm(path, "loop0.motor.omega", 0.01, 1)["cold"]
            _show(f"P2, N = {count}, beyond the run, cold", cold, 30.0, beyond=True)
            print(f"    {1e3 * (cold[0]['total'] - cold[0]['inside']) / count:.3f} ms for each loop")


def main_memory() -> None:
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        made = _measured(diagrams.save_p2(10_000, folder), "loop0.motor.omega", 1.0, folder / "cache")
        peak = made["peak"] / 2**30
        verdict = "met" if peak <= 1.0 else "MISSED"
        print(f"P2, N = 10000, 1 s, ten signals: peak {peak:.2f} GiB, goal 1 GB {verdict}")
