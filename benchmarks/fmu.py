"""Exported diagrams as FMUs, driven from C: a step beyond its mathematics, a controller and its native run, sizes."""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from blocks import Diagram
from blocks.library import FirstOrder

from . import diagrams
from .measure import BUILD, FLAGS, FOLDER, compiler, in_turn, native, on_one_core

__all__ = [
    "Opened",
    "controller",
    "driver",
    "inputs_of",
    "lag",
    "lag_by_hand",
    "main",
    "native_of",
    "opened",
    "read_of",
    "worker",
]

Array = np.ndarray[Any, Any]
RATE = 1000
"""Communication steps per second."""
GAIN, TIME_CONSTANT = 2.0, 0.5
SHOWN = {"control_iadrc": "rk4 1 ms", "control_iadrc_sampled": "sampled at 1 ms"}


def lag() -> Diagram:
    """T x' = k u - x: one state, one input, one output."""
    diagram = Diagram("lag")
    block = diagram.add("lag", FirstOrder(k=GAIN, T=TIME_CONSTANT))
    u = diagram.input("u", default=1.0)
    diagram.wire(block.u, u)
    diagram.output("x", block.y)
    diagram.settings(method="rk4", step=1 / RATE)
    return diagram


def controller(name: str = "control_iadrc_sampled", stop: float = 100.0) -> Diagram:
    """The paper's controller of one wheel, in sampled time, or as differential equations by rk4."""
    diagram = Diagram.load(diagrams.ROOT / "diagrams" / "paper" / f"{name}.json")
    diagram.settings(stop=stop, method="rk4", step=1 / RATE)
    return diagram


def inputs_of(steps: int) -> Array:
    """Wanted and measured speed before each step, shape (steps, 2): another value in every step."""
    t = np.arange(steps) / RATE
    wanted, late = 1.0 + 0.5 * np.sin(0.7 * t), 1.0 + 0.5 * np.sin(0.7 * (t - 0.05))
    return np.column_stack([wanted, late + 0.01 * np.cos(31.0 * t)])


# --- in C ---------------------------------------------------------------------------------------------------------


def driver(fmi: int) -> ctypes.CDLL:
    """c/fmu.c for a version of FMI, built and loaded. Raises RuntimeError where that fails."""
    headers = diagrams.ROOT / "blocks" / "fmi" / "c"
    source = (FOLDER / "c" / "fmu.c").read_text(encoding="utf-8")
    cc = compiler()
    if cc is None:
        raise RuntimeError("there is no C compiler")
    # As the engine: no multiplication is fused with an addition, so that equal operations give equal bits.
    flags = [*FLAGS, "-ffp-contract=off", f"-DFMI={fmi}", f"-I{headers}"]
    texts = [source, *((headers / name).read_text(encoding="utf-8") for name in ("fmi2.h", "fmi3.h")), cc, *flags]
    library = BUILD / f"{hashlib.sha256(chr(0).join(texts).encode()).hexdigest()[:16]}.so"
    if not library.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        made = BUILD / f"{library.stem}.{os.getpid()}"
        command = [cc, *flags, "-o", str(made), str(FOLDER / "c" / "fmu.c"), "-lm", "-ldl"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(done.stderr)
        os.replace(made, library)
    loaded = ctypes.CDLL(str(library))
    number, pointer, whole = ctypes.c_double, ctypes.c_void_p, ctypes.c_long
    flag, row = (ctypes.c_int,), (ctypes.c_int, pointer, pointer)
    for name, result, *kinds in (
        ("fmu_open", pointer, ctypes.c_char_p, ctypes.c_char_p),
        ("fmu_drive", number, pointer, number, whole, whole, *flag, *row, *row),
        ("fmu_lives", number, pointer, whole),
        ("fmu_crowd", number, pointer, whole, number),
        ("by_hand", number, number, number, whole, whole, pointer, pointer),
        ("by_hand_with", number, number, number, whole, whole, pointer, pointer, pointer),
    ):
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, kinds
    return loaded


def _at(values: Array) -> int:
    return int(values.ctypes.data)


@dataclass(frozen=True)
class Opened:
    """An FMU whose library is loaded. keep: what C points to."""

    library: ctypes.CDLL
    address: int
    inputs: Array
    outputs: Array
    names: tuple[str, ...]
    keep: tuple[Any, ...]

    def drive(self, steps: int, u: Array, y: Array | None = None) -> float:
        """Seconds of the communication steps. u (steps, inputs) is set before each step, and y (steps, outputs) read
        after it; None: u[0] stays, and nothing is read."""
        seconds = self.library.fmu_drive(
            self.address, steps / RATE, steps, RATE, y is None, len(self.inputs), _at(self.inputs), _at(u),
            len(self.outputs), _at(self.outputs), 0 if y is None else _at(y),
        )  # fmt: skip
        return _good(seconds)

    def lives(self, count: int) -> float:
        """Seconds to make and free so many instances."""
        return _good(self.library.fmu_lives(self.address, count))

    def crowd(self, count: int) -> float:
        """Bytes that so many instances take at once."""
        return _good(self.library.fmu_crowd(self.address, count, 1.0))


def _good(number: float) -> float:
    if number < 0:
        raise RuntimeError("a call of an FMU failed")
    return float(number)


def opened(diagram: Diagram, fmi: int, folder: Path) -> Opened:
    """A diagram as an FMU in a folder, and its library loaded. Raises RuntimeError where that fails."""
    # Its own folder: a library that is loaded must not be written over.
    folder = Path(tempfile.mkdtemp(dir=folder))
    path = folder / f"{diagram.name}.fmu"
    diagram.export(path, fmi=fmi)
    with zipfile.ZipFile(path) as archive:
        (name,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        library = Path(archive.extract(name, folder))
        description = archive.read("modelDescription.xml").decode()
    (token,) = re.findall(r'(?:guid|instantiationToken)="([^"]*)"', description)
    # Both versions write a variable's attributes into one tag.
    tags = re.findall(r"<(?:ScalarVariable|Float64) ([^>]*)", description)
    variables = [dict(re.findall(r'(\w+)="([^"]*)"', tag)) for tag in tags]
    by_cause = {cause: [one for one in variables if one.get("causality") == cause] for cause in ("input", "output")}
    references = {
        cause: np.array([int(one["valueReference"]) for one in some], dtype=np.uint32)
        for cause, some in by_cause.items()
    }
    names = tuple(one["name"] for one in by_cause["output"])
    loaded, text = driver(fmi), token.encode()
    address = loaded.fmu_open(str(library).encode(), text)
    if not address:
        raise RuntimeError(f"{library} cannot be loaded")
    return Opened(loaded, address, references["input"], references["output"], names, (text,))


def lag_by_hand(steps: int, u: Array | None = None, y: Array | None = None) -> tuple[float, float]:
    """Seconds, and the state at the end, of `lag` written in C."""
    made, x = driver(2), np.zeros(1)
    if u is None or y is None:
        one = np.ones(1)
        return made.by_hand(TIME_CONSTANT, GAIN, steps, RATE, _at(one), _at(x)), float(x[0])
    return made.by_hand_with(TIME_CONSTANT, GAIN, steps, RATE, _at(u), _at(y), _at(x)), float(x[0])


# --- the native run -------------------------------------------------------------------------------------------------


def native_of(name: str, u: Array, names: Sequence[str]) -> tuple[Diagram, dict[str, Any]]:
    """The same controller and the settings with which a run sees what the master sets.

    A tick at the end of a step sees what was set before the step: in sampled time the inputs come one step later.
    """
    steps, diagram = len(u), controller(name, len(u) / RATE)
    t = np.arange(steps + (name == "control_iadrc_sampled")) / RATE
    held = np.concatenate([u[:1], u]) if name == "control_iadrc_sampled" else u
    inputs = {port: (t, held[:, i], "hold") for i, port in enumerate(("r", "y"))}
    return diagram, {"inputs": inputs, "log": list(names), "every": Fraction(1, RATE)}


# --- what is printed --------------------------------------------------------------------------------------------------

HEAD = f"{'':44}{'other min':>11}{'median':>11}{'FMU min':>11}{'median':>11}"


def _overhead(folder: Path, steps: int = 20_000) -> None:
    # Short runs, many of them: one of each is left alone by whatever else runs.
    ones = [opened(lag(), fmi, folder) for fmi in (2, 3)]
    u = np.ascontiguousarray(inputs_of(steps)[:, :1])
    y, other = np.zeros((steps, 1)), np.zeros((steps, 1))
    runs: dict[str, Callable[[], float]] = {
        "by hand": lambda: lag_by_hand(steps)[0],
        "by hand, u, y": lambda: lag_by_hand(steps, u, other)[0],
    }
    for fmi, one in zip((2, 3), ones, strict=True):
        runs[f"FMI {fmi}"] = partial(one.drive, steps, u)
        runs[f"FMI {fmi}, u, y"] = partial(one.drive, steps, u, y)
    made = {name: [1e9 * s / steps for s in seconds] for name, seconds in in_turn(runs, 200).items()}
    print(f"one state, rk4 1 ms, ns for each communication step of 1 ms\n{HEAD}{'beyond':>9}  goal")
    for what, label in (("", "doStep"), (", u, y", "set, doStep, get")):
        theirs = made[f"by hand{what}"]
        for fmi in (2, 3):
            ours = made[f"FMI {fmi}{what}"]
            beyond = min(ours) - min(theirs)
            verdict = "" if what else f"<= 100  {'met' if beyond <= 100 else 'MISSED'}"
            print(f"{f'  FMI {fmi}: {label}':44}{_times(theirs)}{_times(ours)}{beyond:9.1f}  {verdict}")
    apart = np.max(np.abs(y - other))
    print(f"    largest difference {apart:.0e}", flush=True)


def _times(values: Sequence[float], scale: float = 1.0) -> str:
    return f"{scale * min(values):11.4f}{scale * statistics.median(values):11.4f}"


def _controllers(folder: Path, steps: int = 100_000) -> None:
    u = inputs_of(steps)
    for name, label in SHOWN.items():
        ones = {fmi: opened(controller(name), fmi, folder) for fmi in (2, 3)}
        y = {fmi: np.zeros((steps, len(one.outputs))) for fmi, one in ones.items()}
        diagram, settings = native_of(name, u, ones[2].names)
        bare = {"log": list(ones[2].names[:1]), "every": steps / RATE}
        still = {"inputs": {"r": float(u[0, 0]), "y": float(u[0, 1])}}
        runs: dict[str, Callable[[], float]] = {
            "rows": partial(_seconds, diagram, settings),
            "no rows": partial(_seconds, diagram, {**settings, **bare}),
            "still": partial(_seconds, diagram, {**settings, **bare, **still}),
        }
        for fmi, one in ones.items():
            runs[f"FMI {fmi}"] = partial(one.drive, steps, u, y[fmi])
            runs[f"FMI {fmi}, still"] = partial(one.drive, steps, u)
        made = in_turn(runs)
        print(f"{name}, {label}, {steps // RATE} s by steps of 1 ms, two inputs, {len(ones[2].names)} outputs; ms")
        print(f"{HEAD}{'ratio':>9}  goal")
        for fmi in ones:
            for what, other, text, goal in (
                ("", "rows", "native, rows each 1 ms", 1.3),
                ("", "no rows", "native, without rows", None),
                (", still", "still", "native, inputs constant, no rows", None),
            ):
                ours, theirs = made[f"FMI {fmi}{what}"], made[other]
                ratio = min(ours) / min(theirs)
                verdict = "" if goal is None else f"  <= {goal}  {'met' if ratio <= goal else 'MISSED'}"
                print(f"{f'  FMI {fmi} / {text}':44}{_times(theirs, 1e3)}{_times(ours, 1e3)}{ratio:9.2f}{verdict}")
        apart = [np.max(np.abs(read_of(diagram, settings, steps) - one)) for one in y.values()]
        print(f"    FMI 2, 3 and native: largest difference {apart[0]:.0e}, {apart[1]:.0e}", flush=True)


def _seconds(diagram: Diagram, settings: dict[str, Any]) -> float:
    return native(diagram, **settings).seconds


def read_of(diagram: Diagram, settings: dict[str, Any], steps: int) -> Array:
    """What a master reads after each step, of a native run: values before the next inputs, and after the tick."""
    made = native(diagram, **settings)
    t, has_ticks = np.arange(1, steps + 1) / RATE, bool(diagram.plan().rates)
    rows = np.searchsorted(made.t, t, side="right") - 1 if has_ticks else np.searchsorted(made.t, t, side="left")
    return np.asarray(made.values[rows])


def worker(name: str, fmi: str, path: str) -> None:
    """Export once; prints the seconds, without imports. Runs in a process of its own."""
    import blocks.engines.selection
    import blocks.export.exporter  # noqa: F401

    diagram = lag() if name == "lag" else controller(name)
    begun = time.perf_counter()
    diagram.export(path, fmi=int(fmi))
    print(time.perf_counter() - begun)


def _export(folder: Path, repeats: int = 3) -> None:
    code = "import sys; from benchmarks.fmu import worker; worker(*sys.argv[1:])"
    print(f"{'':34}{'export, cold':>14}{'warm':>9}{'KB':>7}{'binary':>8}{'instance':>12}{'1000 instances':>17}")
    for name in ("lag", *SHOWN):
        for fmi in (2, 3):
            took: dict[str, list[float]] = {"cold": [], "warm": []}
            for _ in range(repeats):
                with tempfile.TemporaryDirectory() as cache:
                    for kind in took:
                        arguments = [sys.executable, "-c", code, name, str(fmi), str(folder / "x.fmu")]
                        environment = {**os.environ, "BLOCKS_CACHE_DIR": cache}
                        done = subprocess.run(
                            arguments, cwd=diagrams.ROOT, env=environment, capture_output=True, text=True
                        )
                        if done.returncode:
                            raise RuntimeError(done.stderr)
                        took[kind].append(float(done.stdout))
            one = opened(lag() if name == "lag" else controller(name), fmi, folder)
            with zipfile.ZipFile(folder / "x.fmu") as archive:
                binary = sum(info.file_size for info in archive.infolist() if info.filename.startswith("binaries/"))
            size = (folder / "x.fmu").stat().st_size / 1000
            life = min(one.lives(1000) for _ in range(5)) / 1000
            memory = one.crowd(1000)
            print(f"{f'  {name}, FMI {fmi}':34}{min(took['cold']):12.2f} s{min(took['warm']):7.2f} s{size:7.0f}"
                  f"{binary / 1000:8.0f}{1e6 * life:9.1f} us{memory / 1e6:14.1f} MB"
                  f"  {'met' if size < 300 else 'MISSED'} (< 300 KB)", flush=True)  # fmt: skip


def main() -> None:
    with tempfile.TemporaryDirectory() as text:
        with on_one_core():
            _overhead(Path(text))
            _controllers(Path(text))
        _export(Path(text))
