"""FMUs inside an FMU: what a step of one of them costs there, against the native master of a run.

Rings of the tiny FMUs of `master`, with held inputs. Both step by the same C; the container takes all steps in one
communication step of its own.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import fmpy
from fmpy import fmi2, fmi3

from blocks import Diagram

from .master import RATE, STEPS, Ours, ring, tiny
from .measure import in_turn, on_one_core

__all__ = ["main"]

COUNTS = (2, 5, 20, 100)
GOAL = 1.2


def _stepper(path: Path, fmi: int) -> Callable[[], float]:
    """Return a function that measures all steps of a new instance of a container together."""
    description = fmpy.read_model_description(str(path), validate=False)
    folder = fmpy.extract(str(path))
    kind = fmi2.FMU2Slave if fmi == 2 else fmi3.FMU3Slave

    def run() -> float:
        one = kind(
            guid=description.guid, unzipDirectory=folder, instanceName="one",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        one.instantiate()
        if fmi == 2:
            one.setupExperiment(startTime=0.0)
            one.enterInitializationMode()
        else:
            one.enterInitializationMode(startTime=0.0)
        one.exitInitializationMode()
        begun = time.perf_counter()
        one.doStep(0.0, STEPS / RATE)
        seconds = time.perf_counter() - begun
        one.terminate()
        one.freeInstance()
        return seconds

    return run


def _exported(diagram: Diagram, count: int, fmi: int, folder: Path) -> Path:
    last = f"f{count - 1}.y"
    diagram.output("y", last)
    diagram.settings(
        stop=STEPS / RATE, every=STEPS / RATE, log=[last], master={"step": 1 / RATE, "algorithm": "jacobi", "order": 0}
    )
    path = folder / f"ring{count}_{fmi}.fmu"
    diagram.export(path, fmi=fmi)
    return path


def main() -> None:
    print(f"{'us for each FMU and step':26}{'master':>9}{'median':>9}{'container':>11}{'median':>9}{'ratio':>8}  goal")
    with on_one_core(), tempfile.TemporaryDirectory() as place:
        for fmi in (2, 3):
            inside, _, _ = tiny(fmi)
            for count in COUNTS:
                ours = Ours(inside, "ring", count, False, STEPS)
                if not ours.prepare():
                    print(f"  FMI {fmi} {count:4}   not measured: {ours.why[:80]}")
                    continue
                stepper = _stepper(_exported(ring(inside, "ring", count), count, fmi, Path(place)), fmi)
                made = in_turn({"master": ours, "container": stepper}, at_least=1.0)
                scale = 1e6 / (count * STEPS)
                least, median = ours.stepping(made["master"])
                there = made["container"]
                ratio = min(there) / least
                print(f"  FMI {fmi} {count:4} FMUs        {scale * least:9.4f}{scale * median:9.4f}"
                      f"{scale * min(there):11.4f}{scale * statistics.median(there):9.4f}{ratio:8.2f}"
                      f"  <= {GOAL} {'met' if ratio <= GOAL else 'MISSED'}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
