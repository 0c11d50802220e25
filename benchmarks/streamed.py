"""Rows that go to a file: 10^8 numbers, killed in the middle, read and gone on from; CSV; the memory of a recording."""

from __future__ import annotations

import filecmp
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from blocks import Diagram, Integrator, Results, Sine

from . import diagrams

__all__ = ["main", "recording", "waves"]

SIGNALS = 10
ROWS = 10**7
CODE = """
import json, resource, sys, time
from benchmarks.streamed import {name}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
made = {name}(*map(int, sys.argv[1:]))
seen = resource.getrusage(resource.RUSAGE_SELF)
unit = 1 if sys.platform == "darwin" else 1024
print(json.dumps([seen.ru_utime + seen.ru_stime, seen.ru_maxrss * unit, (seen.ru_maxrss - before) * unit, made]))
"""


def waves(signals: int, rows: int) -> Diagram:
    """So many recorded signals, so many steps of 1 ms."""
    d = Diagram("waves")
    for k in range(signals - 1):
        d.add(f"s{k}", Sine(omega=0.01 * (k + 1)))
    d.wire(d.add("x", Integrator()).u, "s0.y")
    d.settings(stop=rows / 1000, method="rk4", step=0.001)
    return d


def recording(signals: int, rows: int) -> int:
    """A run in memory; the bytes of its results."""
    results = waves(signals, rows).run()
    return int(results.t.nbytes + results.values.nbytes)


def csv(signals: int, rows: int) -> list[float]:
    """Seconds of the processor that a CSV file takes to be written and read."""
    t = np.arange(rows) * 1e-3
    values = np.stack([np.sin((k + 1) / 100 * t + k) for k in range(signals)], axis=1)
    results = Results("waves", t, values, {f"s{k}": (k, (), "") for k in range(signals)})
    with tempfile.TemporaryDirectory() as folder:
        path, times = Path(folder) / "x.csv", [time.process_time()]
        results.save(path)
        times.append(time.process_time())
        back = Results.load(path)
        times.append(time.process_time())
    assert back.values.tobytes() == values.tobytes()
    return [times[1] - times[0], times[2] - times[1]]


def _measured(name: str, *arguments: int) -> Any:
    """CPU time in s and peak of memory, of a process of its own; by how much the peak rose; what it gave."""
    command = [sys.executable, "-c", CODE.format(name=name), *map(str, arguments)]
    done = subprocess.run(command, cwd=diagrams.ROOT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def _command(folder: Path, *arguments: str, until: tuple[Path, float] | None = None) -> tuple[float, float]:
    """`blocks run`: CPU time in s and peak of memory. until: it is killed when a file has so many bytes."""
    environment = {**os.environ, "PYTHONPATH": str(diagrams.ROOT)}
    command = [sys.executable, "-m", "blocks", "run", "waves.json", *arguments]
    run = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while until is not None and not (until[0].exists() and until[0].stat().st_size > until[1]):
        time.sleep(0.001)
    if until is not None:
        run.kill()
    _, status, seen = os.wait4(run.pid, 0)
    run.returncode = os.waitstatus_to_exitcode(status)
    if (run.returncode == 0) is (until is not None):
        raise RuntimeError(f"the run ended with {run.returncode}")
    return seen.ru_utime + seen.ru_stime, float(seen.ru_maxrss * (1 if sys.platform == "darwin" else 1024))


def main() -> None:
    seconds, _, risen, size = _measured("recording", 100, 10**6)  # first: a peak is inherited from this process
    print(f"10^6 rows x 100 in memory: {seconds:.1f} s of CPU, peak {risen / size:.2f} times the data (goal 1.1)")
    print(f"{ROWS * SIGNALS:.0e} numbers into a Parquet file")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        part, files = folder / "x.parquet.part", (folder / "whole.parquet", folder / "x.parquet")
        waves(SIGNALS, ROWS).save(folder / "waves.json")
        seconds, peak = _command(folder, "--out", "whole.parquet")
        print(f"  whole    {seconds:6.1f} s of CPU, peak {peak / 1e6:4.0f} MB (goal 500)")
        seconds, peak = _command(folder, "--out", "x.parquet", until=(part, 4 * ROWS * SIGNALS))
        left_size = part.stat().st_size / 1e6
        print(f"  killed   {seconds:6.1f} s of CPU, peak {peak / 1e6:4.0f} MB, {left_size:.0f} MB left")
        begun = time.process_time()
        left = Results.load(part, signals=["x.y"], start=1000.0, stop=1001.0)
        print(f"  read     {time.process_time() - begun:6.1f} s of CPU: {left.rows} rows of what is left")
        seconds, peak = _command(folder, "--resume", "x.parquet.part")
        same = "equal" if filecmp.cmp(*files, shallow=False) else "NOT EQUAL"
        print(f"  gone on  {seconds:6.1f} s of CPU, peak {peak / 1e6:4.0f} MB, the file is {same}")
        begun = time.process_time()
        window = Results.load(files[1], signals=["x.y"], start=1000.0, stop=1001.0)
        read = "equal" if window.values.tobytes() == left.values.tobytes() else "NOT EQUAL"
        print(f"  read     {time.process_time() - begun:6.3f} s of CPU: the same rows of the file, {read}")
    written, read_again = _measured("csv", 10, 10**6)[3]
    print(f"10^6 rows x 10 as CSV: written in {written:.2f} s (goal 2), read in {read_again:.2f} s of CPU")
