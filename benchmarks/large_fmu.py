"""FMUs of many variables: what it takes to read their descriptions, beside FMPy, and to make diagrams of them.

The FMUs are made up: parameters, start values and locals with units and texts, one input and one output; no binary.
"""

from __future__ import annotations

import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = ["main", "save"]

COUNTS = (30_000, 300_000)
GOALS = {"read": 1.0, "info": 1.0, "diagram": 4.0}
"""How much longer than FMPy's reading of the same file."""


def save(path: Path, count: int, fmi: int = 2) -> Path:
    """Writes an FMU of so many variables, 2 at least; of FMI 3, time comes on top."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", "\n".join(_lines(count, fmi)))
    return path


def _lines(count: int, fmi: int) -> Iterator[str]:
    token = "guid" if fmi == 2 else "instantiationToken"
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield f'<fmiModelDescription fmiVersion="{fmi}.0" modelName="many" {token}="{{many}}">'
    yield '<CoSimulation modelIdentifier="many"/>'
    yield '<UnitDefinitions><Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit></UnitDefinitions><ModelVariables>'
    if fmi == 3:
        yield '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>'
    for k in range(count):
        name, cause, value, unit = _variable(k)
        head = f'name="{name}" valueReference="{k + 1}" description="Number {k}" {cause}'
        more = f'{value} unit="{unit}"' if unit else value
        if fmi == 2:
            yield f"<ScalarVariable {head}><Real {more}/></ScalarVariable>"
        else:
            yield f"<Float64 {head} {more}/>"
    yield "</ModelVariables><ModelStructure>"
    if fmi == 2:
        yield '<Outputs><Unknown index="2"/></Outputs><InitialUnknowns><Unknown index="2"/></InitialUnknowns>'
    else:
        yield '<Output valueReference="2"/><InitialUnknown valueReference="2"/>'
    yield "</ModelStructure></fmiModelDescription>"


def _variable(k: int) -> tuple[str, str, str, str]:
    """Name, causality and the like, start, unit."""
    if k < 2:
        return "uy"[k], f'causality="{("input", "output")[k]}" variability="continuous"', ('start="0"', "")[k], ""
    name = f"part{k // 100}.joint{k % 100}"
    return (
        (f"{name}.w", 'variability="continuous"', "", "rad/s"),
        (f"{name}.k", 'causality="parameter" variability="fixed"', f'start="{k}.5"', ""),
        (f"{name}.x", 'variability="continuous" initial="exact"', f'start="{k}.25"', "rad/s"),
    )[k % 3]


def _seconds(what: Callable[[], Any]) -> float:
    """Of this process: other work on the machine does not count."""
    begun = time.process_time()
    what()
    return time.process_time() - begun


def main() -> None:
    from fmpy import read_model_description

    from blocks import Diagram, fmu
    from blocks.fmi.summary import tell
    from blocks.host.gc_pause import paused

    print(f"{'':44}{'FMPy reads':>12}{'blocks':>10}{'ratio':>8}{'us each':>10}  goal")
    with tempfile.TemporaryDirectory() as text:
        for fmi in (2, 3):
            for count in COUNTS:
                # A file of its own for each, for what was read is remembered.
                paths = [save(Path(text) / f"{fmi}-{count}-{k}.fmu", count, fmi) for k in range(3)]

                def diagram(path: Path = paths[2]) -> None:
                    with paused():
                        Diagram.alone(fmu(path)).flatten()

                tasks: dict[str, Callable[[], Any]] = {
                    "read": lambda path=paths[0]: tell(path),
                    "info": lambda path=paths[1]: tell(path).info(),
                    "diagram": diagram,
                }
                theirs = _seconds(lambda path=paths[0]: read_model_description(str(path), validate=False))
                for what, task in tasks.items():
                    ours = _seconds(task)
                    ratio, goal = ours / theirs, GOALS[what]
                    print(f"{f'FMI {fmi}, {count:,} variables: {what}':44}{theirs:10.2f} s{ours:8.2f} s{ratio:8.2f}"
                          f"{1e6 * ours / count:10.1f}  <= {goal:g} {'met' if ratio <= goal else 'MISSED'}",
                          flush=True)  # fmt: skip
