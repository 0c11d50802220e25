"""Peers on P1 and P2, each in an environment of its own under build/bench-peers: `make bench-peers`.

python -m benchmarks.peers [NAME ...]

All draw the same loop (benchmarks/peer_scripts/problem.py). Adaptive runs ask for rtol 1e-6 and atol 1e-9 where a tool
has both; the error that each really makes stands beside its time. Errors are those of the motor's speed, at the times
that a tool recorded, against a solution at rtol 1e-12 that is restarted at the edges and where the limit is left.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import diagrams
from .measure import Made, on_one_core
from .native_engine import RK4, STEP, p1_programs, p2_programs

__all__ = ["PEERS", "exact_speed", "main"]

Array = np.ndarray[Any, Any]
FOLDER = diagrams.ROOT / "build" / "bench-peers"
SCRIPTS = Path(__file__).resolve().parent / "peer_scripts"
PEERS: dict[str, tuple[str, ...]] = {
    "scipy": ("scipy",),
    "pathsim": ("pathsim",),
    "drake": ("drake",),
    "bdsim": ("bdsim",),
    "jaxonomy": ("jaxonomy", "control"),  # it imports control without asking for it
}
"""What pip installs for each."""
CASES = (
    ("P1 adaptive, 100 s", "adaptive", 1, 100.0, 300.0),
    ("P1 fixed step 1 ms, 100 s", "fixed", 1, 100.0, 300.0),
    ("P2 N = 1, fixed step 1 ms, 10 s", "fixed", 1, 10.0, 300.0),
    ("P2 N = 10, fixed step 1 ms, 10 s", "fixed", 10, 10.0, 300.0),
)
"""Label, kind, loops, stop in s, longest wait in s."""


@dataclass(frozen=True)
class Told:
    """What a script told: seconds of the first run (with building) and of later ones, the error of the speed, and the
    last time in s that was recorded.
    """

    first: float
    again: float
    error: float
    end: float


def exact_speed(stop: float) -> Callable[[Array], Array]:
    """The speed of P1 at times from 0 to `stop`, by DOP853 on equations written out here."""
    from scipy.integrate import solve_ivp

    def control(x: Array) -> float:
        return float(144.0 * (1.0 - x[2]) - 25.0 * x[3] - x[4]) / 1.755

    def rates(t: float, x: Array, d: float, side: int) -> list[float]:
        u, e = 12.0 * side if side else control(x), x[0] - x[2]
        return [
            (-0.3922 * 3.0 * x[0] + 1.1882 * x[1] - d) / (0.2752 * 3.0),
            (-1.185 * 3.0 * x[0] - 0.1557 * x[1] + u) / 0.82,
            x[3] + 30.4 * e,
            x[4] + 1.755 * u + 513.4 * e,
            1570.8 * e,
        ]

    def limit(side: int, direction: int) -> Callable[..., float]:
        """The event at which the control passes the limit on that side."""

        def passed(t: float, x: Array, *_: Any) -> float:
            return control(x) - 12.0 * side

        passed.terminal, passed.direction = True, direction  # type: ignore[attr-defined]
        return passed

    given: dict[str, Any] = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "dense_output": True}
    parts, t, x, side = [], 0.0, np.zeros(5), 1
    for end, d in ((30.0, 0.0), (50.0, 2.0), (stop, 0.0)):
        while t < min(end, stop):
            events = [limit(side, -side)] if side else [limit(1, 1), limit(-1, -1)]
            made = solve_ivp(rates, (t, min(end, stop)), x, args=(d, side), events=events, **given)
            parts.append(made)
            t, x = float(made.t[-1]), made.y[:, -1]
            if made.status == 1:
                side = 0 if side else 1 if len(made.t_events[0]) else -1

    def speed(times: Array) -> Array:
        made = np.empty(len(times))
        for part in reversed(parts):
            inside = times <= part.t[-1]
            made[inside] = part.sol(times[inside])[0]
        return made

    return speed


def _python(name: str) -> Path:
    return FOLDER / name / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def _install(name: str) -> str:
    """An environment with the peer; returns why there is none."""
    mark = FOLDER / name / "installed"
    if mark.exists():
        return ""
    FOLDER.mkdir(parents=True, exist_ok=True)
    pip = [str(_python(name)), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PEERS[name]]
    for command in ([sys.executable, "-m", "venv", "--clear", str(FOLDER / name)], pip):
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=1200)
        except subprocess.TimeoutExpired:
            return "the installation took longer than 20 min"
        if done.returncode:
            return f"cannot be installed: {(done.stderr.strip().splitlines() or ['pip says nothing'])[-1]}"
    listed = subprocess.run([*pip[:3], "list", "--format=json"], capture_output=True, text=True)
    versions = {entry["name"].lower(): entry["version"] for entry in json.loads(listed.stdout)}
    mark.write_text(" ".join(f"{part} {versions.get(part, '?')}" for part in PEERS[name]), encoding="utf-8")
    return ""


def _ask(name: str, kind: str, count: int, stop: float, wait: float) -> Told | str:
    """What a peer's script tells, or why it tells nothing."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "speed.npz"
        command = [str(_python(name)), str(SCRIPTS / f"run_{name}.py"), kind, str(count), repr(stop), str(path)]
        # One thread, as everything here runs on one core.
        env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=wait, env=env)
        except subprocess.TimeoutExpired:
            return f"more than {wait:g} s"
        if done.returncode:
            return (done.stderr.strip().splitlines() or ["no message"])[-1][:90]
        told = json.loads(done.stdout.splitlines()[-1])
        with np.load(path) as made:
            t, w = made["t"], made["w"]
    error = float(np.max(np.abs(w - exact_speed(stop)(np.minimum(t, stop)))))
    return Told(told["first"], told["again"], error, float(t[-1]))


def _ours(kind: str, count: int, stop: float) -> Told:
    """The native engine: the first run includes building the diagram and, with a cold cache, compiling it."""
    begun = time.perf_counter()
    diagram = diagrams.p1() if count == 1 else diagrams.p2(count)
    settings: dict[str, Any] = {"stop": stop, **(RK4 if kind == "fixed" else {})}
    results = diagram.run(engine="native", **settings)
    first = time.perf_counter() - begun
    again = []
    for _ in range(5):
        begun = time.perf_counter()
        results = diagram.run(engine="native", **settings)
        again.append(time.perf_counter() - begun)
    speed = results.values[:, 0]
    return Told(first, min(again), float(np.max(np.abs(speed - exact_speed(stop)(results.t)))), stop)


def _floor(kind: str, count: int, stop: float) -> Made:
    program = p1_programs()["C"] if count == 1 else p2_programs(count)["C"]
    step = STEP if kind == "fixed" else None
    return min((program.run(stop, step=step) for _ in range(9)), key=lambda made: made.seconds)


def main() -> int:
    names = sys.argv[1:] or list(PEERS)
    unknown = [name for name in names if name not in PEERS]
    if unknown:
        print(f"there is no peer {unknown[0]!r}; there are {', '.join(PEERS)}", file=sys.stderr)
        return 2
    there = []
    for name in names:
        why = _install(name)
        print((why and f"{name}: {why}") or (FOLDER / name / "installed").read_text(encoding="utf-8"), flush=True)
        there += [] if why else [name]
    with on_one_core():
        for label, kind, count, stop, wait in CASES:
            floor = _floor(kind, count, stop)
            print(f"\n{label}; C {1e3 * floor.seconds:.3f} ms")
            print(f"  {'':22}{'first s':>10}{'again s':>11}{'x C':>9}{'error':>10}")
            rows: list[tuple[str, Callable[[], Told | str]]] = [
                ("blocks, native", partial(_ours, kind, count, stop)),
                *((name, partial(_ask, name, kind, count, stop, wait)) for name in there),
            ]
            for name, ask in rows:
                told = ask()
                if isinstance(told, str):
                    print(f"  {name:22}{told}", flush=True)
                    continue
                ratio = told.again / floor.seconds
                short = f"  recorded to {told.end:g} s only" if told.end < stop - 0.02 else ""
                figures = f"{told.first:10.3f}{told.again:11.5f}{ratio:9.1f}{told.error:10.1e}"
                print(f"  {name:22}{figures}{short}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
