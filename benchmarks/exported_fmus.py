"""Every diagram of `diagrams/` as an FMU, run by other tools: `python -m benchmarks.exported_fmus [X.json ...]`.

Each is exported in each kind (Co-Simulation, Model Exchange) and version of FMI, and run by FMPy; by fmusim where it
is on the PATH (or `--fmusim PATH`); by ecos (Co-Simulation) and libcosim (Co-Simulation, FMI 2) where ecospy and
libcosimpy are installed (`--python PATH`: that of an environment that has them). All run with the tolerance TOLERANCE;
the largest difference of an output from our own run stands as a part of its range, away from jumps. Inputs that have no
constant value are held at 1. A solver whose own error is more than SAME is asked again with a hundredth of the
tolerance, and this is what counts. Exit code 1 where a difference is larger than SAME, or a tool fails.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from blocks import Diagram
from blocks.model.fmu_block import Foreign, fmu
from blocks.text.errors import BlocksError

from .diagrams import ROOT
from .foreign_fmus import KINDS, Columns, difference
from .peers import SCRIPTS

__all__ = ["main"]

TOLERANCE, SAME = 1e-9, 1e-6
LONGEST, POINTS = 10.0, 500
"""s of a diagram that are run at most, and communication points."""
PATIENCE = 120.0  # s for one run of a tool
FMPY = """
import json, sys, fmpy, numpy as np
a = json.loads(sys.argv[1])
names = ["time", *a["outputs"]]
data = fmpy.simulate_fmu(
    a["path"], stop_time=a["stop"], output_interval=a["step"], fmi_type=a["kind"], output=a["outputs"],
    start_values=a["starts"], relative_tolerance=a["tolerance"], record_events=False,
)
rows = np.column_stack([data[name] for name in names])
np.savetxt(a["out"], rows, delimiter=",", header=",".join(names), comments="")
"""


@dataclass(frozen=True)
class Task:
    """An FMU, how it is run, and the table that the tool writes. outputs: {name: value reference}; starts: {name: value
    in the unit of the file}; times in s.
    """

    path: Path
    kind: str
    stop: float
    step: float
    outputs: dict[str, int]
    starts: dict[str, float]
    references: dict[str, int]
    out: Path


def by_fmpy(task: Task, _: str, tolerance: float) -> list[str]:
    asked = {
        "path": str(task.path), "kind": KINDS[task.kind], "stop": task.stop, "step": task.step,
        "outputs": list(task.outputs), "starts": task.starts, "tolerance": tolerance, "out": str(task.out),
    }  # fmt: skip
    return [sys.executable, "-c", FMPY, json.dumps(asked)]


def by_fmusim(task: Task, program: str, tolerance: float) -> list[str]:
    command = [program, "--interface-type", task.kind.lower(), "--solver", "cvode", "--tolerance", repr(tolerance)]
    command += ["--stop-time", repr(task.stop), "--output-interval", repr(task.step), "--output-file", str(task.out)]
    for name, value in task.starts.items():
        command += ["--start-value", name, repr(value)]
    for name in task.outputs:
        command += ["--output-variable", name]
    return [*command, str(task.path)]


def by_ecos(task: Task, python: str, _: float) -> list[str]:
    asked = {"outputs": list(task.outputs), "starts": task.starts}
    return by_script("run_fmu_ecospy.py", task, python, asked)


def by_libcosim(task: Task, python: str, _: float) -> list[str]:
    starts = {task.references[name]: value for name, value in task.starts.items()}
    return by_script("run_fmu_libcosimpy.py", task, python, {"outputs": task.outputs, "starts": starts})


def by_script(script: str, task: Task, python: str, asked: dict[str, object]) -> list[str]:
    told = [str(task.path), repr(task.stop), repr(task.step), str(task.out), json.dumps(asked)]
    return [python, str(SCRIPTS / script), *told]


Tool = tuple[Callable[[Task, str, float], list[str]], str]


def table(command: list[str], out: Path) -> Columns:
    """The columns of the table that a tool wrote; of several rows at one time the last. Raises RuntimeError."""
    out.unlink(missing_ok=True)
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"longer than {PATIENCE:g} s") from None
    if done.returncode or not out.exists():
        words = (done.stderr or done.stdout).strip().splitlines()
        raise RuntimeError(words[-1][:160] if words else f"exit code {done.returncode}")
    with out.open(encoding="utf-8") as file:
        names = [name.strip().strip('"') for name in file.readline().split(",")]
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    is_last = np.append(np.diff(rows[:, 0]) > 0.0, True)
    return dict(zip(names, rows[is_last].T, strict=True))


def installed(options: argparse.Namespace) -> dict[str, Tool]:
    tools: dict[str, Tool] = {"FMPy": (by_fmpy, "")}
    if options.fmusim:
        tools["fmusim"] = by_fmusim, options.fmusim
    for name, module, by in (("ecos", "ecospy", by_ecos), ("libcosim", "libcosimpy", by_libcosim)):
        if not subprocess.run([options.python, "-c", f"import {module}"], capture_output=True).returncode:
            tools[name] = by, options.python
    return tools


def one(name: str, tool: Tool, task: Task, ours: Columns, foreign: Foreign) -> tuple[float, str]:
    """The difference that counts, inf where there is none; and the words."""
    by, where = tool
    told = []
    for tolerance in (TOLERANCE, TOLERANCE / 100):
        try:
            theirs = table(by(task, where, tolerance), task.out)
        except RuntimeError as error:
            return np.inf, f"{name} FAILED: {error}"
        scaled = {key: values * foreign.scales.get(key, 1.0) for key, values in theirs.items()}
        off, output, points = difference(ours, scaled)
        if points < POINTS:
            return np.inf, f"{name} FAILED: {points} common points"
        told.append(f"{off:.0e}" + (f" at {output}" if off > SAME else ""))
        if off <= SAME or task.kind == "CS":
            break
    return off, f"{name} " + ", more exactly ".join(told)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exported_fmus", description=__doc__)
    parser.add_argument("diagrams", nargs="*", type=Path, metavar="X.json")
    parser.add_argument("--fmusim", default=shutil.which("fmusim"))
    parser.add_argument("--python", default=sys.executable, help="that of an environment with ecospy and libcosimpy")
    options = parser.parse_args(arguments)
    tools = installed(options)
    print("run by", ", ".join(tools), flush=True)
    off: list[float] = []
    refused = 0
    for source in options.diagrams or sorted((ROOT / "diagrams").rglob("*.json")):
        try:
            diagram = Diagram.load(source)
        except BlocksError:
            continue  # a study
        stop = min(float(diagram.value.run.get("stop") or LONGEST), LONGEST)
        given = {name: entry.get("default") for name, entry in diagram.value.inputs.items()}
        given |= diagram.value.run.get("inputs") or {}
        inputs = {name: float(value) if isinstance(value, (int, float)) else 1.0 for name, value in given.items()}
        settings = {"method": "dopri5", "rtol": TOLERANCE, "atol": TOLERANCE / 1000}
        outputs = list(diagram.value.outputs)
        results = diagram.run(stop=stop, every=stop / POINTS, log=outputs, inputs=inputs, **settings)
        ours = {"time": results.t, **{name: np.asarray(results[name], float) for name in outputs}}
        for fmi, kind in ((fmi, kind) for fmi in (2, 3) for kind in KINDS):
            words = []
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "x.fmu"
                try:
                    diagram.export(path, fmi=fmi, kinds=[kind], **settings)
                    foreign = type(fmu(path, kind)).declaration.foreign
                except BlocksError as error:
                    refused += 1
                    print(f"{source.stem:24} FMI {fmi} {kind}  refused: {str(error)[:110]}", flush=True)
                    continue
                assert foreign is not None
                references = {name: variable.reference for name, variable in foreign.variables.items()}
                task = Task(
                    path, kind, stop, stop / POINTS, {name: references[name] for name in outputs},
                    {n: v / foreign.scales.get(n, 1.0) for n, v in inputs.items()}, references,
                    Path(folder) / "rows.csv",
                )  # fmt: skip
                for name, tool in tools.items():
                    if (kind == "CS" or name in ("FMPy", "fmusim")) and (fmi == 2 or name != "libcosim"):
                        one_off, text = one(name, tool, task, ours, foreign)
                        off.append(one_off)
                        words.append(text)
            print(f"{source.stem:24} FMI {fmi} {kind}  {', '.join(words)}", flush=True)
    bad = sum(one > SAME for one in off)
    print(f"{len(off)} runs: largest difference {max(off):.1e} of range, {bad} beyond {SAME:g}; {refused} refused")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
