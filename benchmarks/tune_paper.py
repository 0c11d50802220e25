"""Tune the 12 gains of the paper's controller under noise, and judge them under noise that they were not tuned on.

    python -m benchmarks.tune_paper [SEED ...]          optimiser seeds, 1 2 3 unless given; minutes each

The values of diagrams/paper/tuned.json come from it. Every candidate runs three times: without noise,
as the paper does; for 15 s under noise of 1 mrad/s; and without noise with 30 % more inertia.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from blocks import Diagram

DIAGRAM = Path(__file__).resolve().parents[1] / "diagrams" / "paper" / "iadrc_noisy.json"
QUIET = {"period": {"value": 100, "unit": "s"}}
"""One value of the noise, which is 0, in all of the run: no ticks."""
SCENARIOS: dict[str, dict[str, Any]] = {
    "quiet": QUIET,
    "noisy": {"sigma": 0.001, "stop": 15},
    "heavy": {**QUIET, "Jeq": 0.358},
}
PAPER = {
    "k1[0]": 144.6642, "k1[1]": 25.5574, "k2[0]": 8.0475, "k2[1]": 4.8814, "mu[0]": 44.316, "mu[1]": 48.8179,
    "alpha[0]": 0.9675, "alpha[1]": 1.4487, "k3": 0.5308, "mu_integral": 26.1493, "alpha_integral": 3.5032,
    "delta": 3.8831,
}  # fmt: skip
OVER = {
    f"control_*.nlsef.{name}": (
        (value / 2, value * 2) if name.startswith("alpha")
        else (value / 4, value * (4 if name == "delta" else 8))
    )
    for name, value in PAPER.items()
}  # fmt: skip
MINIMIZE = "quiet.ITAE_right + quiet.ITAE_left"
SUBJECT_TO = [
    "noisy.variation_right + noisy.variation_left <= 139",  # the paper's: 151 V
    "heavy.ITAE_right + heavy.ITAE_left <= 1.2",  # 1.95 rad.s
    "quiet.peak_u_right <= 18.5",  # 9.25 V: it may double
]
BUDGET = 600
JUDGED = (31, 32, 33)
"""Seeds of the noise that judges; the tuning knows that of the file alone, 1."""


def judged(diagram: Diagram, parameters: dict[str, Any]) -> dict[str, dict[str, float]]:
    """All measures without noise and, over 100 s, with the noise of each seed."""
    runs = {"quiet": QUIET, **{f"noise {seed}": {"sigma": 0.001, "seed": seed} for seed in JUDGED}}
    return {
        name: dict(diagram.run(parameters={**parameters, **values}, log=[]).measures) for name, values in runs.items()
    }


def main(seeds: list[int]) -> None:
    diagram = Diagram.load(DIAGRAM)
    before = judged(diagram, {})
    for seed in seeds:
        begun = time.perf_counter(), time.process_time()
        tuning = diagram.tune(
            minimize=MINIMIZE, over=OVER, scenarios=SCENARIOS, subject_to=SUBJECT_TO, budget=BUDGET, search_seed=seed
        )
        wall, cpu = time.perf_counter() - begun[0], time.process_time() - begun[1]
        print(f"seed {seed}: {len(tuning.history.objective)} candidates, {wall:.0f} s, CPU {cpu:.0f} s\n{tuning}\n")
        after = judged(diagram, dict(tuning.parameters))
        for name, measures in after.items():
            changes = (f"{key} {value:.4g} ({value / before[name][key] - 1:+.1%})" for key, value in measures.items())
            print(f"  {name}: {', '.join(changes)}")
        print(json.dumps(tuning.parameters), flush=True)


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or [1, 2, 3])
