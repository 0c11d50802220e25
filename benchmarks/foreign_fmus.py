"""FMUs of other tools, each run here and by FMPy: `python -m benchmarks.foreign_fmus [FOLDER or X.fmu ...]`.

Without an argument: what PyPI's pythonfmu and pythonfmu3 make, and the FMUs in `fmus/`. Each kind of each FMU
(Co-Simulation, Model Exchange) is run by both, each in a process of its own, with the times and start values that the
FMU brings and nothing wired, at the same points; the largest difference of an output stands as a part of the range
that FMPy's values have. Where an output jumps, the points at both sides are left out: two solvers that meet an instant
in another rounding stand on its two sides. A line is one run. Exit code 1 where values differ, or FMPy runs what we
neither run nor refuse with a code.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import re
import subprocess
import sys
import tempfile
import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .diagrams import ROOT

__all__ = ["KINDS", "beside", "difference", "made_here", "main"]

KINDS = {"CS": "CoSimulation", "ME": "ModelExchange"}
POINTS, MOST_POINTS, PATIENCE = 200, 2000, 60.0
"""Communication points where the FMU names no step; points of one run at most; s that one run may take."""
SAME = {"CS": 1e-9, "ME": 1e-5}
"""Part of the range up to which values are the same: of Co-Simulation the calls are the same, of Model Exchange the
solvers differ (both run at RTOL).
"""
RTOL = 1e-8
MOST_LOCALS = 20  # that are compared of an FMU without outputs
NEAR = 1e-8  # s within which two rows are of one time
SLAVES = {
    "pythonfmu": """
        from pythonfmu import Fmi2Causality, Fmi2Slave, Real

        class Lag(Fmi2Slave):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.u, self.y = 1.0, 0.0
                self.register_variable(Real("u", causality=Fmi2Causality.input))
                self.register_variable(Real("y", causality=Fmi2Causality.output))

            def do_step(self, current_time, step_size):
                self.y += step_size * (self.u - self.y)
                return True
        """,
    "pythonfmu3": """
        from pythonfmu3 import CoSimulation, Fmi3Causality, Fmi3SlaveBase, Fmi3StepResult, Fmi3Variability, Float64

        class Lag3(CoSimulation, Fmi3SlaveBase):
            def __init__(self, **kwargs):
                super().__init__(**kwargs)
                self.time, self.u, self.y = 0.0, 1.0, 0.0
                self.register_variable(Float64("time", causality=Fmi3Causality.independent,
                                               variability=Fmi3Variability.continuous))
                self.register_variable(Float64("u", causality=Fmi3Causality.input))
                self.register_variable(Float64("y", causality=Fmi3Causality.output))

            def do_step(self, current_time, step_size):
                self.y += step_size * (self.u - self.y)
                return Fmi3StepResult(status=0)
        """,
}

Columns = dict[str, Any]


def made_here(folder: Path) -> list[Path]:
    """The FMUs that PyPI's packages make, and those that ship."""
    for package, text in SLAVES.items():
        source = folder / f"{package}_lag.py"
        source.write_text(textwrap.dedent(text), encoding="utf-8")
        command = [sys.executable, "-m", package, "build", "-f", str(source), "-d", str(folder)]
        subprocess.run(command, check=True, capture_output=True)
    return [*sorted(folder.glob("*.fmu")), *sorted((ROOT / "fmus").glob("*.fmu"))]


# --- one run, in a process of its own ----


def times(description: Any, kind: str) -> tuple[float, float, float]:
    """Start, stop and step in s of the run: those of the FMU's default experiment where it has them."""
    given = description.defaultExperiment
    start, stop, step = (
        float(text) if given is not None and text is not None else None
        for text in ((given.startTime, given.stopTime, given.stepSize) if given is not None else (None, None, None))
    )
    start = start or 0.0
    if stop is None or not start < stop < math.inf:
        stop = start + 1.0
    if kind == "ME" or not step or step > stop - start:
        step = (stop - start) / POINTS
    last = start + min(round((stop - start) / step), MOST_POINTS) * step
    return start, stop if abs(last - stop) < NEAR else last, step


def compared(description: Any) -> list[str]:
    """The outputs that are numbers; of an FMU that has none the first locals."""
    numbers = [
        v
        for v in description.modelVariables
        if v.type not in ("String", "Binary", "Clock") and not v.dimensions and v.variability != "constant"
    ]
    outputs = [v.name for v in numbers if v.causality == "output"]
    return outputs or [v.name for v in numbers if v.causality == "local"][:MOST_LOCALS]


def child(tool: str, path: str, kind: str, out: str) -> int:
    """Run the FMU by "FMPy" or "blocks", and write the columns."""
    import fmpy

    description = fmpy.read_model_description(path, validate=False)
    names, (start, stop, step) = compared(description), times(description, kind)
    columns: Columns
    if tool == "FMPy":
        data = fmpy.simulate_fmu(
            path, validate=False, start_time=start, stop_time=stop, output_interval=step, fmi_type=KINDS[kind],
            output=names, relative_tolerance=RTOL if kind == "ME" else None, record_events=False, timeout=PATIENCE,
        )  # fmt: skip
        columns = {name: data[name].astype(float) for name in ("time", *names)}
    else:
        from blocks import Diagram
        from blocks.model.fmu_block import fmu

        block = fmu(path, kind)
        diagram = Diagram.alone(block)
        (place,) = diagram.value.blocks
        settings: dict[str, Any] = {"master": {"step": step}} if kind == "CS" else {"rtol": RTOL, "atol": RTOL}
        log = [f"{place}.{name}" for name in names]
        results = diagram.run(start=start, stop=stop, every=step, log=log, **settings)
        foreign = type(block).declaration.foreign
        assert foreign is not None
        # Values are in SI here, and in the unit of the file there.
        columns = {n: np.asarray(results[f"{place}.{n}"], float) / foreign.scales.get(n, 1.0) for n in names}
        columns["time"] = results.t
    np.savez(out, **columns)
    return 0


# --- side by side ----


def one(tool: str, path: Path, kind: str, folder: Path) -> tuple[Columns | None, str]:
    """Columns by name, with "time"; or None and the reason."""
    out = folder / "columns.npz"
    out.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.foreign_fmus", "--one", tool, str(path), kind, str(out)]
    limit = PATIENCE + 30
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace", timeout=limit)
    except subprocess.TimeoutExpired:
        return None, f"took longer than {limit:g} s"
    if done.returncode or not out.exists():
        said = [line for line in done.stderr.splitlines() if line.strip()]
        # The last error of the trace, with the lines that go on after it.
        head = next((at for at in range(len(said) - 1, -1, -1) if not said[at].startswith(" ")), -1)
        return None, " ".join(said[head:])[:300] if said else f"exit code {done.returncode}"
    with np.load(out) as data:
        return {key: data[key] for key in data.files}, ""


def difference(ours: Columns, theirs: Columns) -> tuple[float, str, int]:
    """Largest difference as a part of the range of their values, of which output, and how many points were compared.

    The range is a thousandth of the largest value at least: solvers keep their tolerance of a value, not of its range.
    Left out are points beside a jump: where a value moves by much more than it does elsewhere.
    """
    at = np.searchsorted(ours["time"], theirs["time"] - NEAR)
    here = at < len(ours["time"])
    here[here] &= np.abs(ours["time"][at[here]] - theirs["time"][here]) < 2 * NEAR
    worst, where = 0.0, ""
    for name in (key for key in theirs if key in ours and key != "time"):
        a, b = ours[name][at[here]], theirs[name][here]
        if not len(a):
            break
        size = float(np.max(np.abs(b)))
        span = max(float(np.ptp(b)), 1e-3 * size) or 1.0
        moved = np.abs(np.diff(b, prepend=b[:1]))
        jumped = moved > 20 * np.median(moved) + 1e-3 * span
        beside_jump = jumped | np.roll(jumped, -1) | np.roll(jumped, 1)
        off = np.where(np.isnan(a) & np.isnan(b), 0.0, np.abs(a - b) / span)
        kept = off[~beside_jump] if not beside_jump.all() else off
        largest = float(np.max(np.where(np.isnan(kept), math.inf, kept)))
        if largest > worst:
            worst, where = largest, name
    return worst, where, int(here.sum())


def beside(path: Path) -> Iterator[tuple[str, str, str, str]]:
    """Version of FMI, kind, verdict and words of each kind of an FMU.

    Verdicts: "same", "differs", "only blocks", "only FMPy", "neither", "no value", or the code by which we refuse it.
    """
    import fmpy

    try:
        description = fmpy.read_model_description(str(path), validate=False)
    except Exception as error:  # what FMPy cannot read, nobody can compare
        yield "?", "-", "neither", f"FMPy: {type(error).__name__}: {str(error)[:120]}"
        return
    version = description.fmiVersion[:3]
    kinds = {"CS": description.coSimulation, "ME": description.modelExchange}
    if not any(kinds.values()):
        yield version, "-", "neither", "neither Co-Simulation nor Model Exchange"
    for kind in (kind for kind, has in kinds.items() if has):
        with tempfile.TemporaryDirectory() as folder:
            theirs, reason = one("FMPy", path, kind, Path(folder))
            ours, refused = one("blocks", path, kind, Path(folder))
        if ours is None or theirs is None:
            code = re.search(r"\bE\d{3}\b", refused)
            verdict = "neither" if ours is None and theirs is None else "only blocks"
            if ours is None and theirs is not None:
                verdict = code[0] if code else "only FMPy"
            words = [f"{tool}: {text}" for tool, text in (("blocks", refused), ("FMPy", reason)) if text]
            yield version, kind, verdict, "; ".join(words)
            continue
        worst, where, points = difference(ours, theirs)
        if len(theirs) == 1 or points < 2:
            why = "it has no output or local that is a single number" if points > 1 else "no rows at the same times"
            yield version, kind, "no value", f"both run; {why}"
        else:
            verdict = "same" if worst <= SAME[kind] else "differs"
            place = f" at {where}" if verdict == "differs" else ""
            yield version, kind, verdict, f"{worst:.1e} of range{place}, {len(theirs) - 1} variables, {points} points"


def main(arguments: list[str] | None = None) -> int:
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["--one"]:
        return child(*given[1:5])
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foreign_fmus", description=__doc__)
    parser.add_argument("places", nargs="*", type=Path, metavar="FOLDER or X.fmu")
    parser.add_argument("--json", type=Path, help="write the table as JSON as well")
    options = parser.parse_args(given)
    counts: Counter[str] = Counter()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        named = [sorted(place.rglob("*.fmu")) if place.is_dir() else [place] for place in options.places]
        paths = [path for found in named for path in found] or made_here(Path(folder))
        for path in paths:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
            for version, kind, verdict, words in beside(path):
                counts[verdict] += 1
                rows.append((path.name, digest, version, kind, verdict, words))
                print(f"{path.stem[:44]:44} {digest} {version:3} {kind:2}  {verdict:11}  {words}", flush=True)
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()), f"({len(paths)} FMUs)")
    if options.json:
        names = ("fmu", "sha256", "fmi", "kind", "verdict", "words")
        made = [dict(zip(names, row, strict=True)) for row in rows]
        options.json.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    return 1 if counts["differs"] or counts["only FMPy"] else 0


if __name__ == "__main__":
    sys.exit(main())
