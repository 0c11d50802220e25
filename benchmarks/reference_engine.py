"""The reference engine on the paper's IADRC robot, against SciPy's RK45 on a hand-written right-hand side.

Both run the same 100 s, restarted at the torque's edges, and keep the states once a second. The error is the largest
over the states and these times, as a part of each state's range, against DOP853 at rtol 1e-11. As two solvers at one
tolerance make different errors, SciPy's time is interpolated to our error (logarithms of both).
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from blocks.compile.plan import Plan

ROOT = Path(__file__).resolve().parent.parent
TIMES = np.arange(0.0, 101.0)
REPEATS = 3


def scipy_run(rtol: float, atol: float) -> tuple[float, int, np.ndarray]:
    """Seconds, right-hand sides and states (times, states) of SciPy's RK45."""
    from scipy.integrate import solve_ivp

    from tests.support import witness_paper as witness

    begun = time.perf_counter()
    x, rows, calls = witness.initial_state("IADRC"), [], 0
    for begin, end in ((0.0, 25.0), (25.0, 50.0), (50.0, 100.0)):
        torque = witness.torque_at(begin)
        inside = TIMES[(begin <= TIMES) & ((end > TIMES) | (end == 100.0))]
        made = solve_ivp(
            lambda t, x, torque=torque: witness.iadrc_rhs(t, x.tolist(), torque),
            (begin, end), x, method="RK45", rtol=rtol, atol=atol, t_eval=np.unique([*inside, end]),
        )  # fmt: skip
        rows += list(made.y.T[: len(inside)])
        x, calls = made.y[:, -1], calls + made.nfev
    return time.perf_counter() - begun, calls, np.array(rows)


def our_run(rtol: float, atol: float, names: tuple[str, ...], plan: Plan) -> tuple[float, int, np.ndarray]:
    """The same of the reference engine. The signals recorded are the states that are ports."""
    from blocks.compile.inputs import read_inputs
    from blocks.engines.driver import Simulation
    from blocks.engines.reference.reference_engine import ReferenceEngine

    settings = plan.settings
    assert settings.stop is not None
    begun = time.perf_counter()
    engine = ReferenceEngine(replace(plan, log=names), read_inputs(plan, {}))
    run = Simulation(engine)
    run.advance_to(settings.stop)
    seconds = time.perf_counter() - begun
    results = run.results()
    # At a jump stand two rows of one time; the last is the right value.
    last = np.searchsorted(results.t, TIMES, side="right") - 1
    return seconds, engine.evaluations, results.values[last]


def main() -> None:
    from blocks import Diagram
    from tests.support import witness_paper as witness

    document = Diagram.load(ROOT / "diagrams/paper/iadrc.json").to_json()
    document.pop("measures")
    diagram = Diagram.from_json(document, folder=ROOT / "diagrams/paper")
    picked = [i for i, name in enumerate(witness.IADRC_NAMES) if not name.endswith(".I")]
    names = tuple(witness.IADRC_NAMES[i] for i in picked)
    exact = witness.solve("IADRC", 1e-11, 1e-13, TIMES)[:, picked]
    span = np.ptp(exact, axis=0)
    span = np.where(span > 0, span, 1.0)

    def error(states: np.ndarray) -> float:
        return float(np.max(np.abs(states - exact) / span))

    print(f"{'':22}{'rtol':>8}{'error':>11}{'rhs':>9}{'s':>8}{'us/rhs':>8}")
    ours: dict[float, tuple[float, float]] = {}
    theirs: dict[float, tuple[float, float]] = {}
    for rtol in (1e-5, 1e-6, 1e-7):
        plan = diagram.plan(rtol=rtol, atol=rtol * 1e-3, every=1.0)
        for label, table, run in (
            ("blocks, reference", ours, lambda r=rtol, p=plan: our_run(r, r * 1e-3, names, p)),
            ("SciPy RK45, by hand", theirs, lambda r=rtol: scipy_run(r, r * 1e-3)),
        ):
            best = min((run() for _ in range(REPEATS)), key=lambda made: made[0])  # type: ignore[no-untyped-call]
            states = best[2] if table is ours else best[2][:, picked]
            table[rtol] = (best[0], error(states))
            print(f"{label:22}{rtol:8.0e}{error(states):11.2e}{best[1]:9d}{best[0]:8.3f}{1e6 * best[0] / best[1]:8.1f}")
    errors, times = (np.log([made[k] for made in theirs.values()]) for k in (1, 0))
    slope, level = np.polyfit(errors, times, 1)
    for rtol, (seconds, made) in ours.items():
        equal = math.exp(level + slope * math.log(made))
        print(
            f"rtol {rtol:.0e}: {seconds / theirs[rtol][0]:.2f} x SciPy at equal tolerances, "
            f"{seconds / equal:.2f} x at equal error"
        )
