"""Discrete-time models of sampled diagrams: exact, from tick to tick.

Between ticks the states follow dx/dt = A x + Ad d + B e with d and the inputs e constant: one matrix exponential. At a
tick the sampled outputs that are due are computed, each from those before it, then all discrete updates from the values
before. The state of the model is (x, d) just before a tick, its outputs are those just after it; those that are seen
at ticks only (a local of sampled equations) are as these see them, before discrete updates.

One rate: the model's period is that of the rate. Several rates: the pattern of ticks repeats after their least common
multiple H; over it the map is constant, and that is the model, with inputs held over H and outputs at its beginning.
`lifted` keeps all that happens in between: inputs and outputs at every base step of H, stacked.

References: T. Chen, B. Francis, Optimal Sampled-Data Control Systems, Springer 1995, chapters 3 and 8 (lifting);
C. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23(3), 1978.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm

from ..errors import AnalysisError, Fault
from ..plan import Plan

__all__ = ["Sampled"]

Array = np.ndarray[Any, Any]
_MOST = 10_000
"""Ticks in one pattern of several rates."""


class Sampled:
    """The ticks of the places in d that contribute to a model."""

    def __init__(self, plan: Plan, slots: Sequence[int]) -> None:
        self.plan, self.slots = plan, list(slots)
        place = {slot: k for k, slot in enumerate(self.slots)}
        self.rates = [
            (
                rate.period,
                rate.offset,
                [place[slot] for _, slot in rate.outputs if slot in place],
                [place[slot] for _, slot in rate.nexts if slot in place],
            )
            for rate in plan.rates
        ]
        self.rates = [rate for rate in self.rates if rate[2] or rate[3]]
        self.period = math.lcm(*(period for period, *_ in self.rates)) if self.rates else 1
        first = self.rates[0][1] if self.rates else 0
        ticks: dict[int, list[int]] = {}
        for number, (period, offset, *_) in enumerate(self.rates):
            if self.period // period > _MOST:
                message = f"its rates repeat after {self.period // period} ticks only."
                cure = "Choose periods with a shorter common multiple."
                raise AnalysisError(Fault("E703", plan.name, message, cure))
            for k in range(self.period // period):
                ticks.setdefault((offset - first + k * period) % self.period, []).append(number)
        self.ticks = sorted(ticks.items())
        self.base = float(plan.base)

    def model(
        self, m: Mapping[str, Array], names: Sequence[str], during: Sequence[bool]
    ) -> tuple[dict[str, Array], list[str], float]:
        """Matrices of the model, the names of its states, and its period in s.

        m: dense, by row and column: "x" (rates), "d" (sampled nodes), "y"; "x", "d", "e". during: of each output,
        whether it is seen at ticks only.
        """
        nx, nd, ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        before = np.eye(nx + nd + ne)  # rows: x, d, e as they are now, of what they were at the beginning
        outputs: Array | None = None
        times = [time for time, _ in self.ticks]
        for (time, due), until in zip(self.ticks, [*times[1:], self.period], strict=True):
            refreshed, after = self.tick(m, due)
            if outputs is None:
                seen = np.hstack([m["yx"], m["yd"], m["ye"]])
                outputs = np.where(np.array(during, dtype=bool)[:, None], seen @ refreshed, seen @ after) @ before
            before = after @ before
            before = self.flow(m, (until - time) * self.base) @ before
        assert outputs is not None
        kept = _used(before[: nx + nd, : nx + nd], outputs[:, : nx + nd])
        labels = [*names, *(self.plan.discretes[slot] for slot in self.slots)]
        made = {
            "xx": before[np.ix_(kept, kept)],
            "xe": before[np.ix_(kept, range(nx + nd, nx + nd + ne))],
            "yx": outputs[:, kept],
            "ye": outputs[:, nx + nd :],
        }
        return made, [labels[k] for k in kept], self.period * self.base

    def tick(self, m: Mapping[str, Array], due: Sequence[int]) -> tuple[Array, Array]:
        """What a tick of some rates makes of (x, d, e): after the sampled outputs, and after the updates."""
        nx, nd, ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        made = np.eye(nx + nd + ne)
        held = sorted({k for number in due for k in self.rates[number][2]})
        node = np.hstack([m["dx"], m["dd"], m["de"]])
        if held:
            # Sampled outputs that are due see each other's new values.
            own = np.eye(len(held)) - m["dd"][np.ix_(held, held)]
            others = node[held].copy()
            others[:, [nx + k for k in held]] = 0.0
            made[[nx + k for k in held]] = np.linalg.solve(own, others)
        nexts = sorted({k for number in due for k in self.rates[number][3]})
        after = made.copy()
        if nexts:
            after[[nx + k for k in nexts]] = node[nexts] @ made
        return made, after

    def flow(self, m: Mapping[str, Array], duration: float) -> Array:
        """What a time without ticks makes of (x, d, e)."""
        nx, nd, ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        made = np.zeros((nx + nd + ne,) * 2)
        made[:nx] = np.hstack([m["xx"], m["xd"], m["xe"]])
        return np.asarray(expm(made * duration))


def _used(A: Array, C: Array) -> list[int]:
    """The states that can be seen: what was held is forgotten where it is computed anew at each tick."""
    seen = set(np.nonzero(np.any(C != 0, axis=0))[0].tolist())
    waiting = list(seen)
    while waiting:
        row = waiting.pop()
        for k in np.nonzero(A[row])[0].tolist():
            if k not in seen:
                seen.add(k)
                waiting.append(k)
    return sorted(seen)
