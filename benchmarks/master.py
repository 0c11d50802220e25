"""The master algorithm on chains and rings of tiny FMUs, against a master written by hand in C; what loading costs.

The FMUs are c/tiny_fmu.c: y' = 5 (u - y) by Euler steps, one for each doStep ("tiny": next to nothing, so that
what the master costs shows) or 25 ("small": some 40 ns with all calls, as little as a small FMU takes in practice).
In a ring the first instance starts at y = 1; in a chain its input stays at 1. Both masters are Jacobi with held inputs.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from blocks import Diagram
from blocks.compile.toolchain.compiler import FLAGS
from blocks.text.errors import BlocksError

from . import diagrams
from .measure import BUILD, FOLDER, compiler, in_turn, on_one_core

__all__ = ["COUNTS", "RATE", "SHAPES", "STEPS", "Floor", "Ours", "main", "sources", "starts", "tiny", "worker"]

Array = np.ndarray[Any, Any]
HEADERS = diagrams.ROOT / "blocks" / "fmi" / "c"
PLACE = BUILD / "master"
RATE = 1000
"""Communication steps per second."""
STEPS = 10_000
SHAPES = ("chain", "ring")
COUNTS = (2, 10, 100)
INNER = {"tiny": 1, "small": 25}
"""The FMUs by their inner steps."""
MANY = 1000
SHORT, LONGEST = 20, 20.0
"""Steps of the run that tells how long a whole one will take, and the longest whole one in s that is measured."""
TOLERANCE = 1e-12
"""Of the difference of two masters, which may round h differently."""
PLATFORMS = {2: "linux64", 3: "x86_64-linux"}
DESCRIPTIONS = {
    2: """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="tiny" guid="{token}" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="tiny" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input" variability="continuous">
      <Real start="1"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output" variability="continuous" initial="calculated">
      <Real/>
    </ScalarVariable>
    <ScalarVariable name="y0" valueReference="2" causality="parameter" variability="fixed" initial="exact">
      <Real start="0"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies=""/></Outputs>
    <InitialUnknowns><Unknown index="2" dependencies="3"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
""",
    3: """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="tiny" instantiationToken="{token}">
  <CoSimulation modelIdentifier="tiny" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="u" valueReference="0" causality="input" variability="continuous" start="1"/>
    <Float64 name="y" valueReference="1" causality="output" variability="continuous" initial="calculated"/>
    <Float64 name="y0" valueReference="2" causality="parameter" variability="fixed" initial="exact" start="0"/>
    <Float64 name="time" valueReference="3" causality="independent" variability="continuous"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1" dependencies=""/>
    <InitialUnknown valueReference="1" dependencies="2"/>
  </ModelStructure>
</fmiModelDescription>
""",
}  # fmt: skip


# --- the FMUs -----------------------------------------------------------------------------------------------------


def _built(name: str, sources: dict[str, str], defines: Sequence[str]) -> Path:
    """A shared library of C texts, by the flags of the native engine, made once. Raises RuntimeError."""
    cc = compiler()
    if cc is None:
        raise RuntimeError("there is no C compiler")
    headers = [(HEADERS / header).read_text(encoding="utf-8") for header in ("fmi2.h", "fmi3.h")]
    flags = [*FLAGS, "-Wall", "-Wextra", "-fPIC", "-shared", f"-I{HEADERS}", *defines]
    key = hashlib.sha256("\0".join([*sources.values(), *headers, cc, *flags]).encode()).hexdigest()[:16]
    library = PLACE / f"{name}-{key}.so"
    if not library.exists():
        PLACE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=PLACE) as folder:
            for file, text in sources.items():
                (Path(folder) / file).write_text(text, encoding="utf-8")
            command = [cc, *flags, "-o", "made.so", *sources, "-lm", "-ldl"]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            if done.returncode:
                raise RuntimeError(done.stderr)
            os.replace(Path(folder) / "made.so", library)
    return library


def _refusals(version: int, source: str) -> str:
    """C text of the functions of the standard that a source has not; each returns an error, or nothing."""
    header = (HEADERS / f"fmi{version}.h").read_text(encoding="utf-8")
    made = [f'#include "fmi{version}.h"', '#pragma GCC diagnostic ignored "-Wunused-parameter"']
    for result, name, arguments in re.findall(rf"FMI{version}_Export ([\w \*]+?)(fmi\d\w+)\(([^;]*)\);", header):
        if not re.search(rf"\b{name}\(", source):
            value = "NULL" if "Instance" in result else f"fmi{version}Error"
            made.append(f"{result}{name}({arguments}) {{ return {value}; }}")
    return "\n".join(made) + "\n"


def tiny(version: int, variant: str = "", inner: int = 1) -> tuple[Path, Path, str]:
    """The FMU for a version of FMI, its library as it is on the disk, and its token. Another variant, another file."""
    hashed = hashlib.sha256(f"{version}{variant}".encode()).hexdigest()
    token = f"{{7a1c0de0-0000-4000-8000-{hashed[:12]}}}"
    source = (FOLDER / "c" / "tiny_fmu.c").read_text(encoding="utf-8")
    texts = {"tiny.c": source, "refusals.c": _refusals(version, source)}
    library = _built(
        "tiny", texts, [f"-DFMI={version}", f'-DTOKEN="{token}"', f'-DVARIANT="{variant}"', f"-DINNER={inner}"]
    )
    path = library.with_suffix(".fmu")
    if not path.exists():
        made = path.with_suffix(f".{os.getpid()}")
        with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in (
                ("modelDescription.xml", DESCRIPTIONS[version].replace("{token}", token).encode()),
                (f"binaries/{PLATFORMS[version]}/tiny.so", library.read_bytes()),
            ):
                # The same bytes each time: what is kept by an archive's hash is found again.
                info = zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0))
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(info, data)
        os.replace(made, path)
    return path, library, token


def sources(shape: str, count: int) -> Array:
    """Whose output each input takes; -1: nobody's. Shape (count,)."""
    made = np.arange(-1, count - 1, dtype=np.int32)
    made[0] = count - 1 if shape == "ring" else -1
    return made


def starts(shape: str, count: int) -> Array:
    """The start of each y, shape (count,)."""
    made = np.zeros(count)
    made[0] = 1.0 if shape == "ring" else 0.0
    return made


# --- the two masters ----------------------------------------------------------------------------------------------


class Floor:
    """The master by hand, over the library of `tiny`. Raises RuntimeError where it cannot be built or loaded."""

    def __init__(self, version: int, inner: int = 1) -> None:
        path, library, token = tiny(version, inner=inner)
        text = (FOLDER / "c" / "master.c").read_text(encoding="utf-8")
        self._c = ctypes.CDLL(str(_built("master", {"master.c": text}, [f"-DFMI={version}"])))
        pointer, number, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
        for name, result, *kinds in (
            ("master_open", pointer, ctypes.c_char_p, ctypes.c_char_p),
            ("master_close", None, pointer),
            ("master_run", number, pointer, whole, pointer, pointer, whole, whole, pointer, ctypes.c_int),
            ("master_load", number, pointer, whole),
        ):
            function = getattr(self._c, name)
            function.restype, function.argtypes = result, kinds
        self._token, self._library = token.encode(), library
        self._fmu = self._open()
        self.path = path

    def _open(self) -> int:
        fmu = self._c.master_open(str(self._library).encode(), self._token)
        if not fmu:
            raise RuntimeError(f"{self._library} cannot be loaded")
        return int(fmu)

    def runner(self, shape: str, count: int, *, record: bool, steps: int = STEPS) -> tuple[Callable[[], float], Array]:
        """A function that makes a run and returns the seconds of its steps, and where it writes the outputs: at all
        communication points, shape (steps + 1, count), or at the last alone, shape (1, count).
        """
        wires, begin = sources(shape, count), starts(shape, count)
        y = np.zeros((steps + 1 if record else 1, count))

        def run() -> float:
            seconds = self._c.master_run(
                self._fmu, count, wires.ctypes.data, begin.ctypes.data, steps, RATE, y.ctypes.data, record
            )
            if seconds < 0:
                raise RuntimeError("a call of an FMU failed")
            return float(seconds)

        return run, y

    def load(self, count: int) -> float:
        """Seconds to make and initialize so many instances of a library that is loaded."""
        return float(self._c.master_load(self._fmu, count))


@dataclass
class Ours:
    """The same by the native engine. why: it cannot be measured; wall: least seconds of `run` as a whole.

    The seconds that results tell include loading. Each run is followed by a short one, so that it can be taken off.
    """

    path: Path
    shape: str
    count: int
    record: bool
    steps: int = STEPS
    wall: float = float("inf")
    short: list[float] = field(default_factory=list)
    y: Array | None = None
    why: str = ""

    def prepare(self) -> bool:
        """Whether a first, short run works by the native engine, and a whole one would not take too long."""
        try:
            self._run(SHORT)
            ones = [self._run(steps).statistics for steps in (SHORT, 11 * SHORT)]
            each = (ones[1].seconds - ones[0].seconds) / (10 * SHORT)
            if ones[0].engine != "native" or each * self.steps > LONGEST:
                self.why = f"by the {ones[0].engine} engine {1e6 * each / self.count:.1f} us, over {10 * SHORT} steps"
        except (BlocksError, ImportError) as error:
            self.why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        except Exception as error:  # what is being built may fail in any way; the rest can still be measured
            self.why = f"{type(error).__name__}: {(str(error).strip().splitlines() or [''])[0]}"
        return not self.why

    def _run(self, steps: int) -> Any:
        diagram = ring(self.path, self.shape, self.count)
        log = [f"f{i}.y" for i in (range(self.count) if self.record else (self.count - 1,))]
        stop = Fraction(steps, RATE)
        return diagram.run(
            stop=float(stop), log=log, every=Fraction(1, RATE) if self.record else stop, engine="native",
            master={"step": 1 / RATE, "algorithm": "jacobi", "order": 0},
        )  # fmt: skip

    def apart(self, y: Array) -> float:
        """The largest difference from the outputs of the master by hand, in all rows that both have."""
        if self.y is None or (self.record and len(self.y) != self.steps + 1):
            return float("inf")
        rows = self.y[-len(y) :]
        difference = float(np.max(np.abs(rows - y[:, -rows.shape[1] :])))
        return difference if difference == difference else float("inf")

    def __call__(self) -> float:
        begun = time.perf_counter()
        results = self._run(self.steps)
        self.wall = min(self.wall, time.perf_counter() - begun)
        self.y = results.values
        self.short.append(float(self._run(SHORT).statistics.seconds))
        return float(results.statistics.seconds)

    def stepping(self, seconds: Sequence[float]) -> tuple[float, float]:
        """The least time and the median of runs, without what a short run takes as well."""
        scale = self.steps / (self.steps - SHORT)
        return scale * (min(seconds) - min(self.short)), scale * (
            statistics.median(seconds) - statistics.median(self.short)
        )


def ring(path: Path | Sequence[Path], shape: str, count: int) -> Diagram:
    """A chain or ring of so many FMUs, all of one file, or each of its own."""
    from blocks import fmu

    paths = [path] * count if isinstance(path, Path) else path
    diagram = Diagram(shape)
    begin = starts(shape, count)
    made = [diagram.add(f"f{i}", fmu(one, y0=float(begin[i]))) for i, one in enumerate(paths)]
    for i, source in enumerate(sources(shape, count)):
        if source >= 0:
            diagram.wire(made[i].u, made[source].y)
    return diagram


# --- loading ------------------------------------------------------------------------------------------------------


def worker(version: str, *variants: str) -> None:
    """Prints what loading costs, in a process of its own whose cache knows all the files: s of the first file, of a
    diagram with one, with 11 and with 101 instances of it, and with as many new files as are named more.

    Each number is that of making the diagram and of one step of it, so that nothing is left out.
    """
    from blocks import fmu

    def took(paths: Sequence[Path]) -> dict[str, float]:
        begun = time.perf_counter()
        diagram = ring(paths, "chain", len(paths))
        made = time.perf_counter()
        diagram.run(stop=1 / RATE, log=[], engine="native", master={"step": 1 / RATE})
        return {"build": made - begun, "run": time.perf_counter() - made}

    paths = [tiny(int(version), variant)[0] for variant in variants]
    fmu(tiny(int(version))[0])  # imports, outside the clock
    told = {"first": took(paths[:1]), "one": took(paths[:1])}
    for count in (11, 101):
        told[str(count)] = min((took(paths[:1] * count) for _ in range(3)), key=lambda t: t["build"] + t["run"])
    told["new"] = took(paths[1:])
    print(json.dumps(told))


def _loaded(version: int, files: int = 20, repeats: int = 3) -> None:
    """Two processes with one cache: the first probes and compiles, the others are measured."""
    variants = [f"v{i}" for i in range(files + 1)]
    for variant in variants:
        tiny(version, variant)
    code = "import sys; from benchmarks.master import worker; worker(*sys.argv[1:])"
    told = []
    with tempfile.TemporaryDirectory() as cache:
        for _ in range(1 + repeats):
            done = subprocess.run(
                [sys.executable, "-c", code, str(version), *variants],
                cwd=diagrams.ROOT, env={**os.environ, "BLOCKS_CACHE_DIR": cache}, capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode:
                print(f"  FMI {version}: not measured: {(done.stderr.strip().splitlines() or ['?'])[-1][:100]}")
                return
            told.append(json.loads(done.stdout.splitlines()[-1]))

    def least(name: str, part: str | None = None) -> float:
        return float(min(sum(one[name].values()) if part is None else one[name][part] for one in told[1:]))

    for name, seconds, goal in (
        ("another instance", (least("101") - least("11")) / 90, 1.5e-3),
        ("a new file, probed", (least("new") - least("one")) / (files - 1), 8e-3),
    ):
        verdict = f"goal <= {1e3 * goal:g} ms {'met' if seconds <= goal else 'MISSED'}"
        print(f"  FMI {version}: {name:24}{1e3 * seconds:9.3f} ms  {verdict}")
    cold = sum(told[0]["new"].values()) / files
    print(f"  FMI {version}: {'a new file, never seen':24}{1e3 * cold:9.3f} ms")
    print(f"  FMI {version}: {'100 instances: diagram':24}{1e3 * least('101', 'build'):9.3f} ms,"
          f" run of one step {1e3 * least('101', 'run'):.3f} ms", flush=True)  # fmt: skip


# --- what is printed ----------------------------------------------------------------------------------------------

HEAD = (
    f"{'us for each FMU and step':30}{'C min':>9}{'median':>9}{'blocks':>9}{'median':>9}{'ratio':>8}{'median':>8}  goal"
)


def _stepping(version: int, floor: Floor, counts: Sequence[int], steps: int = STEPS, *, judged: bool = True) -> None:
    for shape in SHAPES:
        for count in counts:
            runs: dict[str, Callable[[], float]] = {}
            rows: dict[bool, Array] = {}
            ours = {record: Ours(floor.path, shape, count, record, steps) for record in (False, True)}
            for record, one in ours.items():
                runs[f"C{record}"], rows[record] = floor.runner(shape, count, record=record, steps=steps)
                if one.prepare():
                    runs[f"blocks{record}"] = one
            made = in_turn(runs, at_least=1.0)
            for record, one in ours.items():
                _row(version, made, one, rows[record], 1.3 if judged else None)


def _row(version: int, made: dict[str, list[float]], one: Ours, y: Array, goal: float | None) -> None:
    scale = 1e6 / (one.count * one.steps)
    c = made[f"C{one.record}"]
    label = f"  FMI {version} {one.shape} {one.count}{', recorded' if one.record else ''}"
    text = f"{label:30}{scale * min(c):9.4f}{scale * statistics.median(c):9.4f}"
    seconds = made.get(f"blocks{one.record}")
    if seconds is None:
        print(f"{text}   not measured: {one.why[:90]}", flush=True)
        return
    least, median = one.stepping(seconds)
    ratio, middle = least / min(c), median / statistics.median(c)
    verdict = "" if goal is None else f"<= {goal:g} {'met' if ratio <= goal else 'MISSED'}"
    # What loading differs by from run to run must not pass for a fast or slow master.
    if verdict and statistics.median(one.short) - min(one.short) > 0.3 * abs(least):
        verdict = f"<= {goal:g} TOO NOISY"
    apart = one.apart(y)
    if apart > TOLERANCE:
        verdict = "WRONG VALUES"
    print(f"{text}{scale * least:9.4f}{scale * median:9.4f}{ratio:8.2f}{middle:8.2f}  "
          f"{verdict:18}run as a whole {1e3 * one.wall:.1f} ms; apart {apart:.0e}", flush=True)  # fmt: skip


def main() -> None:
    with on_one_core():
        for name, inner in INNER.items():
            floors = {version: Floor(version, inner) for version in (2, 3)}
            print(f"{name} FMUs, {STEPS} communication steps of 1 ms, Jacobi, inputs held\n{HEAD}")
            for version, floor in floors.items():
                for count in COUNTS:  # of few, more steps: loading differs by more than a short run takes
                    _stepping(version, floor, (count,), STEPS * max(1, 20 // count))
            print(f"{name} FMUs, {MANY} instances, 1000 steps\n{HEAD}")
            for version, floor in floors.items():
                _stepping(version, floor, (MANY,), 1000, judged=False)
    print("making a diagram and one step of it, for each FMU")
    for version in (2, 3):
        in_c = min(Floor(version).load(100) for _ in range(9)) / 100
        print(f"  FMI {version}: {'another instance, in C':24}{1e3 * in_c:9.6f} ms")
        _loaded(version)
