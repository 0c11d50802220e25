"""Discrete-time models of sampled diagrams: exact, from tick to tick.

Between ticks the states follow dx/dt = A x + Ad d + B e with d and the inputs e constant: one matrix exponential. At a
tick the sampled outputs that are due are computed, each from those before it, then all discrete updates from the values
before. The state of the model is (x, d) just before a tick, its outputs are those just after it; those that are seen
at ticks only (a local of sampled equations) are as these see them, before discrete updates.

One rate: the model's period is that of the rate. Several rates: the pattern of ticks repeats after their least common
multiple H; over it the map is constant, and that is the model, with inputs held over H and outputs at its beginning,
which is a tick of the rate with the smallest offset. `lifted` keeps all that happens in between: inputs and outputs at
every base step of H, stacked; a base step is the largest time of which all periods and offsets are multiples. `loop`
has a value of its input for every tick at which it may change, so that what it is when it is closed is the diagram.

References: T. Chen, B. Francis, Optimal Sampled-Data Control Systems, Springer 1995, chapters 3 and 8 (lifting);
C. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23(3), 1978.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm

from ..compile.plan import Plan
from ..text.errors import AnalysisError, Fault

__all__ = ["Sampled"]

Array = np.ndarray[Any, Any]
_MOST = 10_000
"""Ticks in one pattern of several rates."""
_MOST_LIFTED = 1 << 24
"""Numbers in a matrix of a lifted model."""


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

    def model(
        self, m: Mapping[str, Array], names: Sequence[str], during: Sequence[bool]
    ) -> tuple[dict[str, Array], list[str], float]:
        """Matrices of the model, the names of its states, and its period in s.

        m: dense, by row and column: "x" (rates), "d" (sampled nodes), "y"; "x", "d", "e". during: of each output,
        whether it is seen at ticks only.
        """
        size = m["xx"].shape[0] + len(self.slots) + m["xe"].shape[1]
        before = np.eye(size)  # rows: x, d, e as they are now, of what they were at the beginning
        outputs: Array | None = None
        times = [time for time, _ in self.ticks]
        flows: dict[int, Array] = {}
        for (time, due), until in zip(self.ticks, [*times[1:], self.period], strict=True):
            refreshed, after = self.tick(m, due)
            if outputs is None:
                outputs = _seen(m, refreshed, after, during) @ before
            if until - time not in flows:
                flows[until - time] = self.flow(m, (until - time) * self.base)
            before = flows[until - time] @ after @ before
        assert outputs is not None
        made, labels = self._made(before, outputs, m, names)
        return made, labels, self.period * self.base

    def lifted(
        self, m: Mapping[str, Array], names: Sequence[str], during: Sequence[bool]
    ) -> tuple[dict[str, Array], list[str], float, int]:
        """The same with inputs and outputs at every base step: those of step 0, then those of step 1, ...; and how many
        steps there are.

        Raises AnalysisError (E703) where they are too many.
        """
        nx, nd, ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        n, steps = nx + nd, self.period // self.step
        if (n + steps * ne) * (n + steps * len(m["yx"])) > _MOST_LIFTED:
            message = f"its pattern of ticks has {steps} base steps: a lifted model of them is too large."
            cure = "Choose periods with a shorter common multiple, or use model()."
            raise AnalysisError(Fault("E703", self.plan.name, message, cure))
        due_at = dict(self.ticks)
        flow = self.flow(m, self.step * self.base)
        state = np.eye(n, n + steps * ne)
        outputs = []
        for k in range(steps):
            now = np.vstack([state, np.eye(ne, n + steps * ne, n + k * ne)])
            refreshed, after = self.tick(m, due_at.get(k * self.step, ()))
            outputs.append(_seen(m, refreshed, after, during) @ now)
            state = (flow @ after @ now)[:n]
        made, labels = self._made(state, np.vstack(outputs), m, names)
        return made, labels, self.period * self.base, steps

    def loop(self, m: Mapping[str, Array], names: Sequence[str]) -> tuple[dict[str, Array], list[str], list[float]]:
        """The loop transfer at one signal, which has a value of its own wherever one is read: matrices as of `model`,
        the names of the states, and the times of the values in the pattern, in s.

        What is read at a tick is the signal before discrete updates, and what acts until the next one is the signal
        behind them: two values where an update changes it, else one. What comes back at a value depends on itself and
        on those before it, so that closing the loop value by value gives the closed loop of the diagram. The signal
        must be held between ticks (yx = 0), or be read at ticks only (xe = 0).

        Raises AnalysisError (E703) where there are too many values.
        """
        n = m["xx"].shape[0] + len(self.slots)
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

        seen = np.hstack([m["yx"], m["yd"], m["ye"]])
        state = np.eye(n, n + len(times))
        outputs = np.zeros((len(times), n + len(times)))
        flows: dict[int, Array] = {}
        until = [*(time for time, _ in self.ticks[1:]), self.period]
        for (time, due), end, (at, behind) in zip(self.ticks, until, values, strict=True):
            refreshed, after = self.tick(m, due)
            now = np.vstack([state, picked(at)])
            if at is not None:
                outputs[at] = (seen @ refreshed @ now)[0]
            now = np.vstack([(after @ now)[:n], picked(behind)])
            if behind is not None and behind != at:
                outputs[behind] = (seen @ now)[0]
            if end - time not in flows:
                flows[end - time] = self.flow(m, (end - time) * self.base)
            state = (flows[end - time] @ now)[:n]
        made, labels = self._made(state, outputs, m, names)
        return made, labels, times

    def _made(
        self, state: Array, outputs: Array, m: Mapping[str, Array], names: Sequence[str]
    ) -> tuple[dict[str, Array], list[str]]:
        """Matrices and states of a model: what the states and the outputs are of states and inputs at the beginning."""
        n = m["xx"].shape[0] + len(self.slots)
        kept = _used(state[:n, :n], outputs[:, :n])
        labels = [*names, *(self.plan.discretes[slot] for slot in self.slots)]
        made = {
            "xx": state[np.ix_(kept, kept)],
            "xe": state[kept, n:],
            "yx": outputs[:, kept],
            "ye": outputs[:, n:],
        }
        return made, [labels[k] for k in kept]

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


def _seen(m: Mapping[str, Array], refreshed: Array, after: Array, during: Sequence[bool]) -> Array:
    """The outputs at a tick, of (x, d, e) before it."""
    seen = np.hstack([m["yx"], m["yd"], m["ye"]])
    return np.asarray(np.where(np.array(during, dtype=bool)[:, None], seen @ refreshed, seen @ after))


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
