"""What runs cost beyond their engine: with other parameters, times and logs; and going back to a state.

Each row is a run whose model is prepared anew (a copy of the diagram knows nothing of other runs) beside one of a
prepared model, taken in turn: the least of all rounds, less what the engine took.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

from blocks import Diagram

from .diagrams import P1_LOG, p1, p2_flat
from .measure import on_one_core

__all__ = ["main"]

ROUNDS = 150


def main() -> None:
    print(f"{'':44} {'anew':>9} {'prepared':>9} {'ratio':>7}   goal")
    with on_one_core():
        for label, diagram, name, goal in (
            ("P1", p1(), "law.b0", 0.1),
            ("600 blocks", p2_flat(100), "loop7_law.b0", 0.5),
        ):
            diagram.settings(stop=0.01)
            values = itertools.count(1)
            model = diagram.prepare()
            for what, given in (
                ("another parameter", lambda k: {"parameters": {name: 1.755 + 1e-6 * k}}),  # noqa: B023
                ("another stop", lambda k: {"stop": 0.01 + 1e-6 * k}),
                ("another log, compiled before", lambda k: {"log": _log(diagram)[k % 2 :]}),  # noqa: B023
            ):
                _told(f"{label}: {what}", diagram, model.run, given, values, goal)
        _restored()


def _log(diagram: Diagram) -> list[str]:
    return list(P1_LOG) if diagram.name == "p1" else ["loop0_motor.omega", "loop1_motor.omega"]


def _told(
    label: str, diagram: Diagram, run: Callable[..., Any], given: Callable[[int], Any], values: Any, goal: float
) -> None:
    anew, prepared = [], []
    for number in range(ROUNDS):
        if number % 6 == 0:
            anew.append(_beyond(diagram.copy().run, given(next(values))))
        prepared.append(_beyond(run, given(next(values))))
    one, other = 1e3 * min(anew), 1e3 * min(prepared[2:])
    verdict = "met" if other <= goal else "MISSED"
    print(f"{label:44} {one:6.3f} ms {other:6.3f} ms {one / other:6.1f}x   {goal} ms {verdict}")


def _beyond(run: Callable[..., Any], given: dict[str, Any]) -> float:
    begun = time.perf_counter()
    results = run(**given)
    return time.perf_counter() - begun - float(results.statistics.seconds)


def _restored() -> None:
    """To go back to a state with another value, beside a second of P1 from there."""
    run = p1().start()
    run.advance_to(1.0)
    state, times, inside = run.snapshot(), [], []
    for number in range(ROUNDS):
        begun = time.perf_counter()
        run.restore(state)
        run.set("law.b0", 1.7 + 1e-6 * number)
        middle = time.perf_counter()
        run.advance(1.0)
        times.append(middle - begun)
        inside.append(time.perf_counter() - middle)
    least = 1e3 * min(times)
    verdict = "met" if least <= 0.1 else "MISSED"
    print(f"{'P1: restore and set':44} {'':9} {least:6.3f} ms {'':8} 0.1 ms {verdict}")
    print(f"{'    advance by 1 s after it':44} {'':9} {1e3 * min(inside):6.3f} ms")
