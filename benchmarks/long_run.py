"""A long run: 10^8 steps of rk4 with ticks. Memory stays flat, and the last tick falls on its exact time."""

from __future__ import annotations

import json
import subprocess
import sys
from fractions import Fraction

from . import diagrams

__all__ = ["last_tick", "main", "worker"]

STEPS = (10**6, 10**8)
PERIOD = Fraction(7, 1000)


def last_tick(steps: int) -> float:
    """The time of the last tick in so many steps of 1 ms, as the nearest double."""
    return float(Fraction(steps, 1000) // PERIOD * PERIOD)


def worker(steps: str) -> None:
    """Runs in a process of its own; prints what it took as JSON."""
    import resource

    run = diagrams.long_run(int(steps)).start(engine="native")
    results = run.finish()
    told = {
        "seconds": results.statistics.seconds,
        "steps": results.statistics.steps,
        "tick": float(run["clock.y"]),
        "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024),
    }
    print(json.dumps(told))


def main() -> None:
    peaks = []
    for steps in STEPS:
        code = "import sys; from benchmarks.long_run import worker; worker(sys.argv[1])"
        done = subprocess.run(
            [sys.executable, "-c", code, str(steps)], cwd=diagrams.ROOT, capture_output=True, text=True
        )
        if done.returncode:
            raise RuntimeError(done.stderr)
        made = json.loads(done.stdout.splitlines()[-1])
        peaks.append(made["peak"] / 2**20)
        exact = "exact" if made["tick"] == last_tick(steps) else f"NOT {last_tick(steps)!r}"
        each = 1e9 * made["seconds"] / made["steps"]
        print(
            f"{made['steps']:>10} steps: {made['seconds']:8.3f} s, {each:6.1f} ns each, peak "
            f"{peaks[-1]:.0f} MiB, last tick {made['tick']!r} {exact}"
        )
    print(f"memory {'flat' if peaks[-1] < peaks[0] + 16 else 'GROWS'}: {peaks[-1] - peaks[0]:+.1f} MiB")
