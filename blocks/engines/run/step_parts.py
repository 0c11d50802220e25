"""A step in parts: so short that each phase that a signal depends on, and the signal itself, are seen in each.

The solver's steps follow the states, and ignore signals that no state depends on. Each accepted step is looked
through from left to right. A part is taken where no phase makes more than a quarter of a turn in it, and where the
polynomial through five values of each signal predicts it at further points; else it is halved. The solver's steps do
not depend on it.

See docs/semantics.md, "Inside a step". The twin in C is `next_part` in runtime.c.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...compile.motion import Motion
from ...compile.plan import Plan
from ...text.arrays import Array
from ...text.errors import Fault
from .history import Past

Values = Callable[[float], Any]
"""The values of signals or phases where a share, from 0 to 1, of a piece of a step has gone by."""

CHECKS = (0.118034, 0.763932, 0.367879, 0.118034, 0.763932)
"""Irrational, so that no signal whose values repeat from node to node repeats there too."""
_DEEPEST = 24  # so many times a piece of a step is halved at most
_MOST_TRIED, _MOST_SPLIT = 2**20, 4096  # in one piece: tries in all, and halvings that lead to nothing
_MOST_TOLD = 2**10  # tries once it is reported that not all is seen
_PAST = 8  # parts of the past that stand for a turn


def longest_step(plan: Plan) -> float:
    """The longest step of an adaptive method: a fiftieth of the run, as longer steps may miss what happens.

    Without states there is no error to estimate, so that signals of time alone need shorter ones.
    """
    settings = plan.settings
    if settings.stop is None or settings.stop <= settings.start:
        return math.inf
    return float(settings.stop - settings.start) / (50 if plan.states else 1000)


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a piece of a step: from `begin` to `end`, shares of it, and the values (5, n) at the nodes."""

    begin: float
    end: float
    table: Array


@dataclass(slots=True)
class Unseen:
    """The first thing that was not seen: when, and its phase k as k, or its value k as -1 - k. rows: see below."""

    t: float = math.nan
    what: int = 0
    rows: int = 0


LEFT_OUT, BETWEEN_ROWS = 1, 2
"""Of a recording: rows inside steps are left out, as they would be too many; or a grid has less than two for a turn."""
_TELLS = {
    "crossings": "its crossings may be missed",
    "measured": "its measures may be wrong",
    "remembered": "its delayed value may be wrong",
    "logged": "the recorded rows do not show this",
    "projections": 'values that are updated after each step (every="step") may be wrong',
}
_SLOWER = 'Use a fixed step shorter than its period ("method": "rk4"), or a shorter run, or replace it by its mean.'


def unseen_faults(plan: Plan, motions: Mapping[str, Motion], unseen: Mapping[str, Unseen]) -> tuple[Fault, ...]:
    """What a run has not seen, as warnings (W304), by looks."""
    values = {
        "crossings": [f"{plan.instances[cause.instance].path}.{cause.name}" for cause in plan.crossings],
        "measured": [f"measures.{spec.name}" for spec in plan.measures for _ in range(2)],  # of, and against
        "remembered": [history.name for history in plan.histories],
    }
    faults = []
    for name, first in unseen.items():
        if math.isnan(first.t):
            continue
        phases = motions[name].phases
        if first.what < 0:
            place = values[name][-1 - first.what]
        elif first.what < len(phases):
            place = plan.instances[phases[first.what][0]].path
        else:
            place = plan.histories[motions[name].histories[first.what - len(phases)]].name
        turns = "turns by more than half a turn between rows" if first.rows == BETWEEN_ROWS else "turns too fast"
        what = "rows between the steps are left out" if first.rows == LEFT_OUT else _TELLS[name]
        cure = "Record it with a shorter `every`, or not at all." if first.rows else _SLOWER
        faults.append(Fault("W304", place, f"{turns} from t = {first.t:.6g} s on: {what}.", cure))
    return tuple(faults)


@dataclass(slots=True)
class Look:
    """How the parts of steps are found for some signals.

    nodes: of the polynomials; None: phases alone count. checks: where these are compared, and whether values that keep
    far from 0 are left out. spans, sizes: the polynomials may be off by spans of what a value moves in the part, and
    sizes of `atol + rtol |value|`. most: how much of a turn a part may have.
    """

    motion: Motion
    nodes: Array | None
    checks: tuple[float, ...] = ()
    spans: float = 0.0
    sizes: float = 1.0
    atol: float = 0.0
    rtol: float = 0.0
    most: float = 0.25
    ignores_far: bool = False
    all_bent: bool = False
    unseen: Unseen = field(default_factory=Unseen)
    bent: Array = field(init=False)
    weights: list[Array] = field(init=False)

    def __post_init__(self) -> None:
        self.bent = np.array(self.motion.bent, dtype=bool)
        if self.all_bent:
            self.bent[:] = True
        if not self.bent.any():
            self.checks = ()
        self.weights = []
        if self.nodes is not None:
            nodes = self.nodes
            for theta in self.checks:
                pairs = [(node, np.delete(nodes, k)) for k, node in enumerate(nodes)]
                self.weights.append(np.array([np.prod((theta - others) / (node - others)) for node, others in pairs]))

    @property
    def turns(self) -> bool:
        """Whether anything that the signals depend on has a phase."""
        return bool(self.motion.phases or self.motion.histories)

    def parts(self, t0: float, t1: float, values: Values, phases: Values, first: Array | None = None) -> Iterator[Part]:
        """The parts of the piece from t0 to t1, from left to right. first: the values at its begin, where known."""
        k = level = tried = split = 0
        begun: Array | None = None  # the phases at the begin of the part
        table = np.empty((5, len(self.bent)))
        least = 64 * math.ulp(max(abs(t0), abs(t1)))
        most = _MOST_TRIED if math.isnan(self.unseen.t) else _MOST_TOLD
        while True:
            width = math.ldexp(1.0, -level)
            begin, end = k * width, (k + 1) * width
            is_last = level >= _DEEPEST or (t1 - t0) * width <= least or tried >= most
            tried += 1
            last: Array | None = None
            if self.turns:
                begun = np.asarray(phases(begin)) if begun is None else begun
                middle, last = np.asarray(phases(begin + 0.5 * width)), np.asarray(phases(end))
                turned = np.abs(middle - begun) + np.abs(last - middle)
                turns = float(np.nanmax(turned, initial=0.0))
                if turns > self.most and is_last:
                    fastest = int(np.nanargmax(turned))
                    # The past has short parts where it bends or where instants are close: these are resolved.
                    if fastest < len(self.motion.phases) or tried > most:
                        self.not_seen(t0 + begin * (t1 - t0), fastest)
                elif turns > self.most:
                    while turns > self.most and level < _DEEPEST:
                        level, k, turns = level + 1, 2 * k, turns / 2
                    continue
            if self.nodes is not None:
                first = np.asarray(values(begin)) if first is None else first
                table[0] = first
                for i in range(1, 5):
                    table[i] = values(end if i == 4 else begin + float(self.nodes[i]) * width)
                if not is_last and split <= _MOST_SPLIT:
                    missed = self._missed(table, begin, end, values)
                    if missed >= 0:
                        split += 1
                        if split > _MOST_SPLIT:
                            self.not_seen(t0 + begin * (t1 - t0), -1 - missed)
                        level, k = level + 1, 2 * k
                        continue
                    split = max(split - 2, 0)  # what can be resolved goes on; noise, of which no part ever is, ends
            yield Part(begin, end, table)
            if end == 1.0:
                return
            begun, first = last, table[4].copy()
            k += 1
            while level and not k & 1:
                k, level = k >> 1, level - 1

    def _missed(self, table: Array, begin: float, end: float, values: Values) -> int:
        """A value that the polynomials miss by more than they may; or -1."""
        if not self.checks:
            return -1
        low, high = table.min(axis=0), table.max(axis=0)
        size = np.maximum(np.abs(low), np.abs(high))
        allowed = self.spans * (high - low) + self.sizes * (self.atol + self.rtol * size)
        for theta, weights in zip(self.checks, self.weights, strict=True):
            given = np.asarray(values(begin + theta * (end - begin)))
            missed = self.bent & (np.abs(weights @ table - given) > allowed)  # NaN is for others to see
            if missed.any() and self.ignores_far:
                is_one_sided = ((low > 0) == (high > 0)) & ((given > 0) == (low > 0))
                least = np.minimum(np.minimum(np.abs(low), np.abs(high)), np.abs(given))
                missed &= ~(is_one_sided & (least > 3 * (high - low)))
            if missed.any():
                return int(np.argmax(missed))
        return -1

    def not_seen(self, t: float, what: int, rows: int = 0) -> None:
        """Note the first time at which something was not seen."""
        if math.isnan(self.unseen.t):
            self.unseen.t, self.unseen.what, self.unseen.rows = t, what, rows

    def past_turns(self, past: Past | None, t: float) -> list[float]:
        """For each delay that is read, how many parts of the past have gone by, as turns."""
        return [] if past is None else [past.part_at(i, t) / _PAST for i in self.motion.histories]
