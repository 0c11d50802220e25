"""How it is measured: C programs built with -O2, all on one core, in turn, least and median of the repetitions."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import shutil
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from blocks.compile.toolchain.compiler import FLAGS as ENGINE_FLAGS
from blocks.engines.native import code

__all__ = ["FOLDER", "Made", "Program", "compiler", "difference", "floors", "in_turn", "line", "native", "on_one_core"]

code.QUICKLY = False  # a step is what is measured, not how soon the first one comes

Array = np.ndarray[Any, Any]
FOLDER = Path(__file__).resolve().parent
BUILD = FOLDER.parent / "build" / "benchmarks"
FLAGS = ("-std=gnu11", "-O2", "-Wall", "-Wextra", "-fPIC", "-shared")
# Those of the engine that change code: of two floors the lower one counts.
AS_ENGINE = tuple(flag for flag in ENGINE_FLAGS if flag.startswith("-f") and flag != "-fvisibility=hidden")
REPEATS = 9


@dataclass(frozen=True)
class Made:
    """What a run gave: the seconds inside it, its steps, and what it recorded: t (rows,), values (rows, signals)."""

    seconds: float
    steps: int
    rejected: int
    t: Array
    values: Array


def compiler() -> str | None:
    """The C compiler: that of the environment variable CC, else cc, gcc or clang."""
    given = os.environ.get("CC", "")
    return next((found for name in (given, "cc", "gcc", "clang") if name and (found := shutil.which(name))), None)


class Program:
    """A C program of benchmarks/c, or the text of one, built and loaded. Raises RuntimeError where that fails."""

    def __init__(self, source: str | Path, signals: int, flags: Sequence[str] = (), **defines: int) -> None:
        text = source.read_text(encoding="utf-8") if isinstance(source, Path) else source
        flags = [*FLAGS, *flags, f"-I{FOLDER / 'c'}", *(f"-D{name}={value}" for name, value in defines.items())]
        headers = "".join(path.read_text(encoding="utf-8") for path in sorted((FOLDER / "c").glob("*.h")))
        cc = compiler()
        if cc is None:
            raise RuntimeError("there is no C compiler")
        key = hashlib.sha256("\0".join([text, headers, cc, *flags]).encode()).hexdigest()[:16]
        BUILD.mkdir(parents=True, exist_ok=True)
        library = BUILD / f"{key}.so"
        if not library.exists():
            written, made = BUILD / f"{key}.c", BUILD / f"{key}.{os.getpid()}"
            written.write_text(text, encoding="utf-8")
            done = subprocess.run([cc, *flags, "-o", str(made), str(written), "-lm"], capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(done.stderr)
            os.replace(made, library)
        self.signals = signals
        self._run = ctypes.CDLL(str(library)).run
        self._run.restype = ctypes.c_double
        self._run.argtypes = [ctypes.c_double] * 3 + [ctypes.c_long] * 4 + [ctypes.c_void_p] * 2
        self._rows = np.zeros((0, 1 + signals))

    def run(
        self,
        stop: float,
        *,
        rtol: float = 1e-6,
        atol: float = 1e-9,
        step: Fraction | None = None,
        every: Fraction = Fraction(1, 100),
    ) -> Made:
        """step: of rk4; None: dopri5."""
        rows = int(stop / every) + 16
        if len(self._rows) != rows:
            self._rows = np.zeros((rows, 1 + self.signals))
        counts = (ctypes.c_long * 3)()
        n, d = (step.numerator, step.denominator) if step is not None else (0, 1)
        seconds = self._run(
            stop, rtol, atol, n, d, every.numerator, every.denominator, self._rows.ctypes.data, ctypes.addressof(counts)
        )
        if seconds < 0:
            raise RuntimeError("the C program failed: its step became too small")
        made = self._rows[: counts[2]]
        return Made(seconds, counts[0], counts[1], made[:, 0], made[:, 1:])


def floors(name: str, source: str | Path, signals: int, **defines: int) -> dict[str, Program]:
    """A C program built as it is, and with the engine's own flags."""
    kinds = {name: (), f"{name} (engine's flags)": AS_ENGINE}
    return {kind: Program(source, signals, flags, **defines) for kind, flags in kinds.items()}


def native(diagram: Any, **settings: Any) -> Made:
    """A run by the native engine; the seconds are those inside it."""
    results = diagram.run(engine="native", **settings)
    seen = results.statistics
    return Made(seen.seconds, seen.steps, seen.rejected, results.t, results.values)


def difference(a: Made, b: Made, every: Fraction = Fraction(1, 100)) -> Array:
    """The largest differences of the signals on the recording grid, right values where they jump: shape (signals,)."""
    end = min(a.t[-1], b.t[-1])
    times = np.array([float(k * every) for k in range(int(end / every) + 1)])
    picked = [made.values[np.searchsorted(made.t, times, side="right") - 1] for made in (a, b)]
    return np.asarray(np.abs(picked[0] - picked[1]).max(axis=0))


@contextlib.contextmanager
def on_one_core() -> Iterator[None]:
    """The last core that this process may use, so that nothing moves it; what it starts inherits that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def in_turn(
    runs: Mapping[str, Callable[[], float]], repeats: int = REPEATS, at_least: float = 2.0
) -> dict[str, list[float]]:
    """Seconds of each, one after the other, `repeats` times and more until `at_least` s are over.

    Each is run once before, uncounted. Where another process takes the core, the least times still compare.
    """
    for run in runs.values():
        run()
    made: dict[str, list[float]] = {name: [] for name in runs}
    begun = time.perf_counter()
    while len(next(iter(made.values()))) < repeats or time.perf_counter() - begun < at_least:
        for name, run in runs.items():
            made[name].append(run())
    return made


def line(label: str, ours: Sequence[float], theirs: Sequence[float], goal: float | None, note: str = "") -> str:
    """One row: least and median in ms of both, their ratios, the goal."""
    least, median = min(ours) / min(theirs), statistics.median(ours) / statistics.median(theirs)
    verdict = "" if goal is None else f"<= {goal:<5g}{'met' if least <= goal else 'MISSED'}"
    times = "".join(f"{1e3 * f(s):11.4f}" for s in (theirs, ours) for f in (min, statistics.median))
    return f"{label:34}{times}{least:8.2f}{median:8.2f}  {verdict:14}{note}"


HEAD = f"{'':34}{'C min ms':>11}{'median':>11}{'native min':>11}{'median':>11}{'ratio':>8}{'median':>8}  goal"
