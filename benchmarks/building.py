"""A large diagram built in Python, up to the first steps; its file saved and read; a block removed.

Lags in a chain behind differences and gains, each with numbers of its own. The reference of each time for a block is
that of a small diagram in the same run: nothing may grow faster than the diagram.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from typing import Any

__all__ = ["built", "main"]

COUNTS = (1000, 10_000, 100_000)
GOAL = 25.0  # s of the processor for 100,000 blocks, from nothing to the first steps
LARGEST_REMOVED = 10_000  # blocks of a diagram that loses one: its whole text is written and read


def built(blocks: int) -> Any:
    """A diagram of this many blocks."""
    from blocks import Diagram, FirstOrder, Gain, Sine, Sum

    diagram = Diagram("large")
    gain = diagram.parameter("gain", 0.5)
    last = diagram.add("wave", Sine()).y
    for k in range(blocks // 3):
        error = diagram.add(f"error_{k:06}", Sum(signs="+-"), doc="what is left between the last lag and this one")
        scaled = diagram.add(f"scaled_{k:06}", Gain(k=gain), at=(40.0 + k, 60.0))
        lag = diagram.add(f"first_order_{k:06}", FirstOrder(T=0.5 + 1e-6 * k, k=1 + 1e-6 * k))
        diagram.wire(error.u1, last)
        diagram.wire(error.u2, lag.y)
        diagram.wire(scaled.u, error.y)
        diagram.wire(lag.u, scaled.y)
        last = lag.y
    diagram.output("y", last)
    return diagram


def _timed(work: Callable[..., Any], *arguments: Any, **words: Any) -> tuple[float, Any]:
    """Seconds of the processor, those of the compiler too, and what the work gives."""
    begun = os.times()
    result = work(*arguments, **words)
    ended = os.times()
    return sum(ended[:4]) - sum(begun[:4]), result


def main() -> None:
    from blocks import Diagram

    print("us of the processor for each block; in brackets: x the time of the smallest diagram")
    least: dict[str, float] = {}
    for blocks in COUNTS:
        times: dict[str, float] = {}
        times["built"], diagram = _timed(built, blocks)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "large.json")
            times["first run"], _ = _timed(diagram.run, method="rk4", step=0.01, stop=0.1, engine="native")
            times["saved"], _ = _timed(diagram.save, path)
            times["read"], read = _timed(Diagram.load, path)
            size = os.path.getsize(path)
        if blocks <= LARGEST_REMOVED:
            times["one removed"], _ = _timed(read.remove, "wave")
        each = {name: 1e6 * seconds / blocks for name, seconds in times.items()}
        shown = [f"{name} {us:.0f} ({us / least.setdefault(name, us):.2f})" for name, us in each.items()]
        print(f"  {blocks:6} blocks, {size / 2**20:.1f} MiB: {', '.join(shown)}", flush=True)
    total = times["built"] + times["first run"]
    print(f"  {COUNTS[-1]} blocks from nothing to the first steps: {total:.1f} s, goal {GOAL:.0f} s"
          f" {'met' if total <= GOAL else 'MISSED'}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
