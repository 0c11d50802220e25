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

Exact delays between ticks are copies of (x, d, e) that lag behind (`late_copies`); further states keep their values.

References: T. Chen, B. Francis, Optimal Sampled-Data Control Systems, Springer 1995, chapters 3 and 8 (lifting);
C. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23(3), 1978.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np

from ..compile.plan import Plan
from ..contract.closure import closure
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .late_copies import MOST, Kept, LateCopies, Time, too_long

_MOST = 10_000
"""Ticks in one pattern of several rates."""


class Sampled:
    """The ticks of the places in d that contribute to a model.

    m: dense, by row and column: "x" (rates), "d" (sampled nodes), "y"; "x", "d", "e". names: of its states. inputs:
    names of the inputs. histories: numbers of the exact delays that contribute; for these m has the row and column "h"
    too. dt: the time in s after which the ticks repeat.
    """

    def __init__(
        self,
        plan: Plan,
        slots: Sequence[int],
        m: Mapping[str, Array],
        names: Sequence[str],
        inputs: Sequence[str],
        histories: Sequence[int] = (),
    ) -> None:
        self.plan, self.slots, self.m = plan, list(slots), m
        self.labels = [*names, *(plan.discretes[slot] for slot in self.slots)]
        self.inputs = list(inputs)
        self.nx, self.nd, self.ne = m["xx"].shape[0], len(self.slots), m["xe"].shape[1]
        self.copies = LateCopies(plan, m, histories)
        self.seen, self.node = self.copies.seen, self.copies.node
        self._flows: dict[Time, Array] = {}
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
                message = f"its rates repeat only after {self.period // period} ticks, too many for a model."
                cure = "Choose periods with a shorter common multiple."
                raise AnalysisError(Fault("E703", plan.name, message, cure))
            for k in range(self.period // period):
                ticks.setdefault((offset - first + k * period) % self.period, []).append(number)
        self.ticks: list[tuple[Time, list[int]]] = sorted(ticks.items())
        self.step = math.gcd(self.period, *ticks)
        self.base = float(plan.base)
        self.dt = self.period * self.base

    def model(self, during: Sequence[bool]) -> tuple[dict[str, Array], list[str]]:
        """Matrices of the model, names of its states. during: of each output, whether it is seen at ticks only."""
        due_at = dict(self.ticks)
        kept = self._kept(due_at)
        now = self._begun(kept, self.ne)
        outputs: Array | None = None
        for time, duration in kept.spans:
            kept.set(time, now)
            if outputs is None:
                now[self._e] = np.eye(self.ne, now.shape[1], now.shape[1] - self.ne)
            refreshed, after = self.tick(due_at.get(time, ()))
            if outputs is None:
                outputs = self._seen(refreshed, after, during) @ now[: self.copies.size]
            self._moved(kept, time, duration, after, now)
        assert outputs is not None
        return self._made(kept, now, outputs)

    def lifted(self, during: Sequence[bool]) -> tuple[dict[str, Array], list[str], int]:
        """The same with inputs and outputs at every base step: those of step 0, then those of step 1, ...; and how many
        steps there are.

        Raises AnalysisError (E703) where they are too many.
        """
        n, ne, steps = self.nx + self.nd, self.ne, self.period // self.step
        if (n + steps * ne) * (n + steps * len(self.seen)) > MOST:
            message = f"its pattern of ticks has {steps} base steps: a lifted model of them is too large."
            cure = "Choose periods with a shorter common multiple, or use model()."
            raise AnalysisError(Fault("E703", self.plan.name, message, cure))
        due_at = dict(self.ticks)
        kept = self._kept(range(0, self.period, self.step))
        now = self._begun(kept, steps * ne)
        inputs = now.shape[1] - steps * ne
        outputs = []
        for time, duration in kept.spans:
            kept.set(time, now)
            refreshed, after = self.tick(due_at.get(time, ()))
            if time in kept.instants:
                now[self._e] = np.eye(ne, now.shape[1], inputs + kept.instants[time] * ne)
                outputs.append(self._seen(refreshed, after, during) @ now[: self.copies.size])
            self._moved(kept, time, duration, after, now)
        return *self._made(kept, now, np.vstack(outputs)), steps

    def loop(self) -> tuple[dict[str, Array], list[str], list[tuple[int, float]]]:
        """The loop transfer at some signals, with a value of its own wherever one is read: matrices as of `model`, the
        names of the states, and for each value the number of its signal and its time in the pattern, in s.

        What is read at a tick is the signal before discrete updates, and what acts until the next one is the signal
        behind them: two values where an update changes it, else one. What comes back at a value depends on itself and
        on those before it, so that closing the loop value by value gives the closed loop of the diagram. A signal must
        be held between ticks, or be read at ticks only (see `moving`).

        With delays a signal may also change when a held value arrives behind one. If signals change at such times only,
        the state of the model is the one before the first of them.

        Raises AnalysisError: E703 where there are too many values, E705 where signals take theirs at different times.
        """
        m, due_at, acts = self.m, dict(self.ticks), self._acts
        is_own = np.any(self.seen[:, self.nx : self.nx + self.nd] != 0, axis=1)
        is_own = self._onward(is_own) | ~acts if self.copies.held else np.ones(self.ne, dtype=bool)
        arrivals = self._arrivals()
        values: list[tuple[int, Time]] = []
        numbers: dict[Time, tuple[list[int], list[int]]] = {}  # by instant: of the values at it and behind it
        for time in sorted({*due_at, *arrivals}):
            read = sorted({k for number in due_at.get(time, ()) for part in self.rates[number][2:] for k in part})
            changed = [k for number in due_at.get(time, ()) for k in self.rates[number][3]]
            reads = self._back(np.any(m["de"][read] != 0, axis=0))
            changes = self._onward(np.any(m["yd"][:, changed] != 0, axis=1))
            ticks = is_own & (time in due_at)
            arrives = arrivals.get(time, np.zeros(self.ne, dtype=bool))
            both = np.where(ticks, reads, arrives), ticks & acts & (changes | ~reads)
            numbers[time] = [], []
            for some, place in zip(both, numbers[time], strict=True):
                place += range(len(values), len(values) + np.count_nonzero(some))
                values += [(int(i), time) for i in np.flatnonzero(some)]
        if (self.nx + self.nd + len(values)) ** 2 > MOST:
            message = f"its pattern has {len(values)} ticks: the loop over all of them is too large."
            cure = "Choose periods with a shorter common multiple."
            raise AnalysisError(Fault("E703", self.plan.name, message, cure))
        begin = next((time for time, (at, behind) in numbers.items() if at or behind), 0) if np.any(acts) else 0
        known = {i for i, time in values if time == begin}
        for i in np.flatnonzero(acts).tolist():
            if i not in known:  # what it was before would be a further state
                message = "takes its values at other times than the others: when held values arrive behind a delay."
                cure = "Open the loop before the delays, at signals that are held."
                raise AnalysisError(Fault("E705", self.inputs[i], message, cure))
        kept = self._kept(numbers, begin)
        now = self._begun(kept, len(values))
        inputs, size = now.shape[1] - len(values), self.copies.size
        outputs = np.zeros((len(values), now.shape[1]))
        signal = np.array([i for i, _ in values], dtype=np.intp)
        for time, duration in kept.spans:
            kept.set(time, now)
            at, behind = numbers.get(time, ([], []))
            refreshed, after = self.tick(due_at.get(time, ()))
            self._enter(now, signal[at], inputs + np.array(at, dtype=np.intp))
            outputs[at] = (self.seen @ refreshed @ now[:size])[signal[at]]
            now[:size] = after @ now[:size]
            self._enter(now, signal[behind], inputs + np.array(behind, dtype=np.intp))
            outputs[behind] = (self.seen @ now[:size])[signal[behind]]
            self._moved(kept, time, duration, None, now)
        return *self._made(kept, now, outputs), [(i, float(time) * self.base) for i, time in values]

    def _enter(self, now: Array, signals: Array, columns: Array) -> None:
        """Let inputs be those of some columns from now on."""
        now[self._e.start + signals] = 0.0
        now[self._e.start + signals, columns] = 1.0

    def moving(self) -> list[int]:
        """Find the signals that act and change between ticks, other than when a held value arrives behind a delay.

        A loop that is opened there has no values from tick to tick. The input may be such a change itself: if it comes
        back behind a delay, the closed loop has a path in continuous time from the delay to itself.
        """
        changes = np.any(self.seen[:, self.copies.states | self.copies.inputs] != 0, axis=1)
        return [int(i) for i in np.flatnonzero(self._onward(changes) & self._acts)]

    @property
    def _acts(self) -> Array:
        """Whether each input of a loop acts between ticks."""
        acts = np.any(self.m["xe"] != 0, axis=0)
        return self._back(acts | np.any(self.m["he"] != 0, axis=0) if "he" in self.m else acts)

    @cached_property
    def _at_once(self) -> Array:
        """Whether output i of a loop depends on input j at once, also through other signals; each on itself."""
        links = (self.m["ye"] != 0) | np.eye(self.ne, dtype=bool)
        for _ in range(self.ne):
            links = links @ links
        return np.asarray(links)

    def _onward(self, some: Array) -> Array:
        """The signals of a loop that are among `some`, or depend on one of them at once."""
        return np.asarray(self._at_once @ some)

    def _back(self, some: Array) -> Array:
        """The signals of a loop that are among `some`, or on which one of them depends at once."""
        return np.asarray(some @ self._at_once)

    def _arrivals(self) -> dict[Time, Array]:
        """Find the times in the pattern at which held values arrive behind delays, and the signals that they change."""
        times: dict[Time, Array] = {}
        for lag in self.copies.held:
            for tick, due in self.ticks:
                changed = [k for number in due for part in self.rates[number][2:] for k in part]
                places = [self.copies.place(lag, self.nx + k) for k in changed]
                arrives = np.any(self.seen[:, [place for place in places if place is not None]] != 0, axis=1)
                arrives = self._onward(arrives) & self._acts
                if np.any(arrives):
                    time = (tick + lag) % self.period
                    times[time] = times.get(time, False) | arrives
        return times

    @property
    def _e(self) -> slice:
        """Where the inputs are in the vector."""
        return slice(self.nx + self.nd, self.nx + self.nd + self.ne)

    def _kept(self, instants: Iterable[Time], begin: Time = 0) -> Kept:
        return Kept(self.copies, instants, self.period, begin)

    def _begun(self, kept: Kept, inputs: int) -> Array:
        """Return the vector and what is kept of it, as a map of the states before the pattern and of the inputs.

        Raises AnalysisError (E703) if delays keep too many values.
        """
        rows = self.copies.size + kept.size
        if kept.size and rows * (rows + inputs) > MOST:
            raise too_long(self.plan, rows)
        now = np.zeros((rows, rows - self.ne + inputs))
        before, behind = np.arange(self.nx + self.nd), np.arange(self.nx + self.nd + self.ne, rows)
        now[before, before] = now[behind, behind - self.ne] = 1.0
        return now

    def _moved(self, kept: Kept, time: Time, duration: Time, after: Array | None, now: Array) -> None:
        """Move to the next time by the flow. after: what the instant changes before, if that is still to be done."""
        size = self.copies.size
        if kept.size:
            kept.keep(time, now, now[:size] if after is None else after @ now[:size])
        flow = self.flow(duration)
        now[:size] = (flow if after is None else flow @ after) @ now[:size]

    def _made(self, kept: Kept, now: Array, outputs: Array) -> tuple[dict[str, Array], list[str]]:
        """Matrices and state names of a model, from the maps of states and inputs to states and outputs."""
        rows = [k for k in range(len(now)) if not self._e.start <= k < self._e.stop]
        state, n = now[rows], len(rows)
        used = _used(state[:, :n], outputs[:, :n])
        parts = {"xx": state[np.ix_(used, used)], "xe": state[used, n:], "yx": outputs[:, used], "ye": outputs[:, n:]}
        return parts, [self._label(rows[k], kept) for k in used]

    def _label(self, row: int, kept: Kept) -> str:
        """Return the name of a state: one of the diagram, or of what a delay keeps of it."""
        if row < len(self.labels):
            return self.labels[row]
        names = [*self.labels, *self.inputs]
        if row >= self.copies.size:
            at, number = divmod(row - self.copies.size, len(kept.elements))
            return f"{names[kept.elements[number]]}.kept[{at}]"
        at = max(n for n, first in enumerate(self.copies.first.values()) if first <= row)
        lag = list(self.copies.first)[at]
        return f"{names[self.copies.held[lag][row - self.copies.first[lag]]]}.late[{at}]"

    def _seen(self, refreshed: Array, after: Array, during: Sequence[bool]) -> Array:
        """The outputs at a tick, of (x, d, e) before it."""
        held = np.array(during, dtype=bool)[:, None]
        return np.asarray(np.where(held, self.seen @ refreshed, self.seen @ after))

    def tick(self, due: Sequence[int]) -> tuple[Array, Array]:
        """How a tick of some rates maps (x, d, e): after the sampled outputs, and after the updates."""
        m, nx, node = self.m, self.nx, self.node
        refreshed = np.eye(self.copies.size)
        held = sorted({k for number in due for k in self.rates[number][2]})
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

    def flow(self, duration: Time) -> Array:
        """Return how a time in which nothing happens maps the vector."""
        if duration not in self._flows:
            from scipy.linalg import expm

            self._flows[duration] = np.asarray(expm(self.copies.dynamics * (float(duration) * self.base)))
        return self._flows[duration]


def _used(A: Array, C: Array) -> list[int]:
    """The states that can be seen: what was held is forgotten where it is computed anew at each tick."""
    seen: list[int] = np.nonzero(np.any(C != 0, axis=0))[0].tolist()
    return sorted(closure(seen, lambda row: np.nonzero(A[row])[0].tolist()))
