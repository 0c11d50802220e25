"""Discrete-time models of sampled diagrams: exact, from tick to tick.

Between ticks the states follow dx/dt = A x + Ad d + B e with d and the inputs e constant: one matrix exponential. At a
tick the sampled outputs that are due are computed, each from those before it, then all discrete updates from the values
before. The state of the model is (x, d) just before a tick, its outputs are those just after it; those that are seen
at ticks only (a local of sampled equations) are as these see them, before discrete updates.

One rate: the model's period is that of the rate. Several rates: the pattern of ticks repeats after their least common
multiple H; over it the map is constant, and that is the model, with inputs held over H and outputs at its beginning,
which is a tick of the rate with the smallest offset. `lifted` keeps all that happens in between: inputs and outputs at
every base step of H, stacked; a base step is the largest time of which all periods and offsets are multiples. `loop`
has a value of its input for every tick at which it may change, so that closing it gives the diagram.

References: T. Chen, B. Francis, Optimal Sampled-Data Control Systems, Springer 1995, chapters 3 and 8 (lifting);
C. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23(3), 1978.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..compile.plan import Plan
from ..text.errors import AnalysisError, Fault

__all__ = ["Sampled"]

Array = np.ndarray[Any, Any]
_MOST = 10_000
"""Ticks in one pattern of several rates."""
_MOST_LIFTED = 1 << 24
"""Numbers in a matrix of a lifted model."""


class Sampled:
    """The ticks of the places in d that contribute to a model.

    m: dense, by row and column: "x" (rates), "d" (sampled nodes), "y"; "x", "d", "e". names: of its states. dt: the
    time in s after which the ticks repeat.
    """

    def __init__(self, plan: Plan, slots: Sequence[int], m: Mapping[str, Array], names: Sequence[str]) -> None:
        self.plan, self.slots, self.m = plan, list(slots), m
        self.labels = [*names, *(plan.discretes[slot] for slot in self.slots)]
        self.nx, self.nd, self.ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        self.seen = np.hstack([m["yx"], m["yd"], m["ye"]])
        self._flows: dict[int, Array] = {}
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
        first = min((offset for _, offset, *_ in self.rates), default=0)
        ticks: dict[int, list[int]] = {}
        for number, (period, offset, *_) in enumerate(self.rates):
            if self.period // period > _MOST:
                message = f"its rates repeat after {self.period // period} ticks only."
                cure = "Choose periods with a shorter common multiple."
                raise AnalysisError(Fault("E703", plan.name, message, cure))
            for k in range(self.period // period):
                ticks.setdefault((offset - first + k * period) % self.period, []).append(number)
        self.ticks = sorted(ticks.items())
        self.step = math.gcd(self.period, *ticks)
        self.base = float(plan.base)
        self.dt = self.period * self.base

    def model(self, during: Sequence[bool]) -> tuple[dict[str, Array], list[str]]:
        """Matrices of the model, names of its states. during: of each output, whether it is seen at ticks only."""
        before = np.eye(self.nx + self.nd + self.ne)  # rows: x, d, e now; columns: x, d, e at the beginning
        outputs: Array | None = None
        times = [time for time, _ in self.ticks]
        for (time, due), until in zip(self.ticks, [*times[1:], self.period], strict=True):
            refreshed, after = self.tick(due)
            if outputs is None:
                outputs = self._seen(refreshed, after, during) @ before
            before = self.flow(until - time) @ after @ before
        assert outputs is not None
        return self._made(before, outputs)

    def lifted(self, during: Sequence[bool]) -> tuple[dict[str, Array], list[str], int]:
        """The same with inputs and outputs at every base step: those of step 0, then those of step 1, ...; and how many
        steps there are.

        Raises AnalysisError (E703) where they are too many.
        """
        n, ne, steps = self.nx + self.nd, self.ne, self.period // self.step
        if (n + steps * ne) * (n + steps * len(self.seen)) > _MOST_LIFTED:
            message = f"its pattern of ticks has {steps} base steps: a lifted model of them is too large."
            cure = "Choose periods with a shorter common multiple, or use model()."
            raise AnalysisError(Fault("E703", self.plan.name, message, cure))
        due_at = dict(self.ticks)
        flow = self.flow(self.step)
        state = np.eye(n, n + steps * ne)
        outputs = []
        for k in range(steps):
            now = np.vstack([state, np.eye(ne, n + steps * ne, n + k * ne)])
            refreshed, after = self.tick(due_at.get(k * self.step, ()))
            outputs.append(self._seen(refreshed, after, during) @ now)
            state = (flow @ after @ now)[:n]
        return *self._made(state, np.vstack(outputs)), steps

    def loop(self) -> tuple[dict[str, Array], list[str], list[float]]:
        """The loop transfer at one signal, with a value of its own wherever the signal is read: matrices as of `model`,
        the names of the states, and the times of the values in the pattern, in s.

        What is read at a tick is the signal before discrete updates, and what acts until the next one is the signal
        behind them: two values where an update changes it, else one. What comes back at a value depends on itself and
        on those before it, so that closing the loop value by value gives the closed loop of the diagram. The signal
        must be held between ticks (yx = 0), or be read at ticks only (xe = 0).

        Raises AnalysisError (E703) where there are too many values.
        """
        m, n = self.m, self.nx + self.nd
        acts = bool(np.any(m["xe"] != 0))
        values: list[tuple[int | None, int | None]] = []  # by tick: the numbers of the values at it and behind it
        times: list[float] = []
        for time, due in self.ticks:
            read = sorted({k for number in due for part in self.rates[number][2:] for k in part})
            changed = [k for number in due for k in self.rates[number][3]]
            at = behind = None
            if np.any(m["de"][read] != 0):
                at = len(times)
                times.append(time * self.base)
            if acts and at is not None and not np.any(m["yd"][:, changed] != 0):
                behind = at
            elif acts:
                behind = len(times)
                times.append(time * self.base)
            values.append((at, behind))
        if (n + len(times)) ** 2 > _MOST_LIFTED:
            message = f"its pattern of ticks has {len(times)} of them: the loop over all of them is too large."
            cure = "Choose periods with a shorter common multiple."
            raise AnalysisError(Fault("E703", self.plan.name, message, cure))

        def picked(value: int | None) -> Array:
            row = np.zeros((1, n + len(times)))
            if value is not None:
                row[0, n + value] = 1.0
            return row

        state = np.eye(n, n + len(times))
        outputs = np.zeros((len(times), n + len(times)))
        until = [*(time for time, _ in self.ticks[1:]), self.period]
        for (time, due), end, (at, behind) in zip(self.ticks, until, values, strict=True):
            refreshed, after = self.tick(due)
            now = np.vstack([state, picked(at)])
            if at is not None:
                outputs[at] = (self.seen @ refreshed @ now)[0]
            now = np.vstack([(after @ now)[:n], picked(behind)])
            if behind is not None and behind != at:
                outputs[behind] = (self.seen @ now)[0]
            state = (self.flow(end - time) @ now)[:n]
        return *self._made(state, outputs), times

    def _made(self, state: Array, outputs: Array) -> tuple[dict[str, Array], list[str]]:
        """Matrices and state names of a model, from the maps of states and inputs to states and outputs."""
        n = self.nx + self.nd
        kept = _used(state[:n, :n], outputs[:, :n])
        parts = {"xx": state[np.ix_(kept, kept)], "xe": state[kept, n:], "yx": outputs[:, kept], "ye": outputs[:, n:]}
        return parts, [self.labels[k] for k in kept]

    def _seen(self, refreshed: Array, after: Array, during: Sequence[bool]) -> Array:
        """The outputs at a tick, of (x, d, e) before it."""
        held = np.array(during, dtype=bool)[:, None]
        return np.asarray(np.where(held, self.seen @ refreshed, self.seen @ after))

    def tick(self, due: Sequence[int]) -> tuple[Array, Array]:
        """How a tick of some rates maps (x, d, e): after the sampled outputs, and after the updates."""
        m, nx = self.m, self.nx
        refreshed = np.eye(nx + self.nd + self.ne)
        held = sorted({k for number in due for k in self.rates[number][2]})
        node = np.hstack([m["dx"], m["dd"], m["de"]])
        if held:
            # Sampled outputs that are due see each other's new values.
            own = np.eye(len(held)) - m["dd"][np.ix_(held, held)]
            others = node[held].copy()
            others[:, [nx + k for k in held]] = 0.0
            refreshed[[nx + k for k in held]] = np.linalg.solve(own, others)
        nexts = sorted({k for number in due for k in self.rates[number][3]})
        after = refreshed.copy()
        if nexts:
            after[[nx + k for k in nexts]] = node[nexts] @ refreshed
        return refreshed, after

    def flow(self, duration: int) -> Array:
        """How a time without ticks maps (x, d, e)."""
        if duration not in self._flows:
            from scipy.linalg import expm

            dynamics = np.zeros((self.nx + self.nd + self.ne,) * 2)
            dynamics[: self.nx] = np.hstack([self.m["xx"], self.m["xd"], self.m["xe"]])
            self._flows[duration] = np.asarray(expm(dynamics * (duration * self.base)))
        return self._flows[duration]


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
