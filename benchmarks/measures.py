"""What measures cost: the paper's robot without any, with the paper's eight, and with one of each type."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from math import tau
from typing import Any

from . import diagrams
from .measure import in_turn, on_one_core

__all__ = ["main"]

ERROR, SPEED, CONTROL = "heading_error.y", "motor_right.omega", "control_right.u"
ALONE: dict[str, tuple[str, Any]] = {
    "ITAE": (SPEED, "speed.y"), "IAE": (SPEED, "speed.y"), "ISE": (SPEED, "speed.y"), "ISU": (CONTROL, None),
    "mean_square": ("robot.x", "reference.x"), "peak": (ERROR, None), "overshoot": (SPEED, "speed.y"),
    "settling_time": (SPEED, "speed.y"), "total_variation": (CONTROL, None), "RMS": (ERROR, None),
    "rise_time": (SPEED, "speed.y"), "steady_state_error": (SPEED, "speed.y"), "THD": (CONTROL, None),
    "zero_crossings": (ERROR, None),
}  # fmt: skip
GOAL = 1.3


def main() -> None:
    made = {"none": diagrams.robot(), "the paper's eight": diagrams.robot(measures=True)}
    for kind, (of, against) in ALONE.items():
        made[kind] = diagrams.robot()
        made[kind].measure(kind, kind, of, against, omega=tau if kind == "THD" else None)
    with on_one_core():
        for label, settings in (
            ("dopri5, rtol 1e-6, atol 1e-9, 100 s, rows each 10 ms", {}),
            ("rk4 1 ms, 100 s, rows each 10 ms", {"method": "rk4", "step": 0.001}),
        ):
            runs = {name: partial(_seconds, diagram, **settings) for name, diagram in made.items()}
            _compared(label, runs)


def _seconds(diagram: Any, **settings: Any) -> float:
    """Of the processor: ratios of some percent are lost in what else the machine does."""
    begun = time.process_time()
    diagram.run(engine="native", **settings)
    return time.process_time() - begun


def _compared(label: str, runs: dict[str, Callable[[], float]]) -> None:
    print(f"{label}\n{'':24}{'min ms':>10}{'median':>10}{'ratio':>8}{'median':>8}")
    times = in_turn(runs)
    base = times["none"]
    for name, seconds in times.items():
        least, median = min(seconds) / min(base), statistics.median(seconds) / statistics.median(base)
        verdict = f"  <= {GOAL} {'met' if least <= GOAL else 'MISSED'}" if " " in name else ""
        row = f"{1e3 * min(seconds):10.2f}{1e3 * statistics.median(seconds):10.2f}{least:8.2f}{median:8.2f}"
        print(f"  {name:22}{row}{verdict}", flush=True)
