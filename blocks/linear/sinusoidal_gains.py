"""What the laws of a diagram do to sines, and to the means of what they read.

A law that is not odd about where it stands moves the mean of what it gives. The rest of the diagram passes that on to
the laws, which then work about other values b. These are found first: they depend on the amplitudes, not on the
frequency.

    0 = A x + B (mean of n - n at rest),   b = (b at rest) + C x + D (mean of n - n at rest)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from ..frequency import quadrature
from ..frequency.delayed import DelayedModel
from ..frequency.realization import Realization
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault
from .linearization import Linearization
from .nonlinearities import StaticLaw
from .transfer import Transfer

Answer = Callable[[int, Array], tuple[complex, float]]
"""From the number of a law and the means of its signals: the phasor and the mean of what it gives."""
PER_DECADE = 24
"""Amplitudes of a grid on which gains are kept."""
MOVED = 1e-7
"""How far a law may move a mean without effect, relative to what it gives."""
NEAR = 1e-3
"""The same, where a thousandth is enough."""
_NOISE = 1e-11
"""The rounding error of a mean, relative to the mean."""
_ROUNDS = 15


@dataclass(frozen=True)
class Rest:
    """The diagram without its laws, at rest: 0 = A x + B n, s = C x + D n."""

    A: Array
    B: Array
    C: Array
    D: Array

    @classmethod
    def of(cls, model: Transfer | DelayedModel, laws: Sequence[int], slots: Sequence[int]) -> Rest:
        """From the inputs and outputs of a model with these numbers."""
        if isinstance(model, DelayedModel):
            A, B, C, D = model.at_rest
        else:
            A, B, C, D = (np.asarray(m, dtype=float) for m in (model.A, model.B, model.C, model.D))
            A = A - np.eye(len(A)) if model.dt else A
        whole = Realization(A, B[:, list(laws)], C[list(slots)], D[np.ix_(list(slots), list(laws))], 0.0)
        seen = whole.visible()
        return cls(seen.a, seen.b, seen.c, seen.d)


def _go_on() -> None:
    pass


class Laws:
    """The laws that are taken out of a diagram, and what they do to sines around the operating point.

    slots: one for each signal that a law reads; spans: of each law, which of these signals it reads. rest: what is left
    of the diagram; without it no mean may move. check: called before laws are evaluated; what it raises ends a search.
    """

    def __init__(
        self, linearizer: Linearization, nodes: dict[int, tuple[int, ...]], check: Callable[[], None] | None = None
    ) -> None:
        self.check = check or _go_on
        slopes, graph = linearizer.slopes, linearizer.graph
        self.items = [StaticLaw(slopes, node, slots) for node, slots in nodes.items()]
        self.nodes = list(nodes)
        at: dict[int, int] = {}  # by the column that is read
        self.slots: list[int] = []
        self.spans: list[list[int]] = []
        for slots in nodes.values():
            for slot in slots:
                if at.setdefault(int(graph.selects[slot]), len(self.slots)) == len(self.slots):
                    self.slots.append(slot)
            self.spans.append([at[int(graph.selects[slot])] for slot in slots])
        self.names = [graph.slot_name(slot) for slot in self.slots]
        self._begin()

    def _begin(self) -> None:
        self.rest: Rest | None = None
        self.biases = np.zeros(len(self.slots))
        for law, span in zip(self.items, self.spans, strict=True):
            self.biases[span] = law.inputs
        self.values = np.array([float(law(*map(np.atleast_1d, law.inputs))[0]) for law in self.items])
        self.remembers = np.array([bool(law.remembers) for law in self.items])
        self._single: dict[tuple[int, int], tuple[complex, float]] = {}
        self._whole: dict[float, Array] = {}

    def some(self, laws: Sequence[int], slots: Sequence[int]) -> Laws:
        """Some of the laws, which read some of the signals; others rest."""
        subset, place = copy(self), {slot: k for k, slot in enumerate(slots)}
        subset.items, subset.nodes, subset.spans = [], [self.nodes[k] for k in laws], []
        subset.slots, subset.names = [self.slots[k] for k in slots], [self.names[k] for k in slots]
        for k in laws:
            law, span = self.items[k], self.spans[k]
            own = [i for i, at in enumerate(span) if at in place]
            whole = len(own) == len(span)
            subset.items.append(law if whole else StaticLaw(law.slopes, law.node, [law.slots[i] for i in own]))
            subset.spans.append([place[span[i]] for i in own])
        subset._begin()
        return subset

    # --- sines -----------------------------------------------------------------------------------------------------

    def fundamentals(self, s: Array) -> Array:
        """The phasors of what the laws give for the phasors of their signals. Raises AnalysisError (E704)."""
        return self.balanced(self.sines(s), np.abs(s))[0]

    def means(self, s: Array) -> Array:
        """The means about which the signals oscillate."""
        return self.balanced(self.sines(s), np.abs(s))[1]

    def sines(self, s: Array) -> Answer:
        """What the laws give for sines."""
        return lambda k, b: self.one(self.items[k], s[self.spans[k]], b)

    def one(self, law: StaticLaw, s: Array, b: Array) -> tuple[complex, float]:
        """The phasor and the mean of what a law gives."""
        self.check()
        if not s.any():
            return 0.0, float(law(*map(np.atleast_1d, b))[0])
        if len(s) == 1:
            described = law.described(abs(complex(s[0])), float(b[0]))
            return complex(described.gain) * complex(s[0]), float(described.mean)
        with law.named():
            whole = quadrature.fundamental(lambda u: law(*u), s, b, switches=lambda u: law.switches(*u))
        return complex(whole.harmonics[0]), float(whole.mean)

    def gains(self, a: float) -> Array:
        """What each law gives for a sine of amplitude a, over a: of laws that all read one signal."""
        return self.fundamentals(np.array([complex(a)])) / a

    def table(self, low: float, high: float) -> tuple[Array, Array]:
        """Amplitudes on a grid from low to high, and the gains at them, (laws, amplitudes), of laws of one signal.

        NaN where there are none: an amplitude is too small for a law with memory, or a mean is not held.
        """
        numbers = range(math.floor(PER_DECADE * math.log10(low)), math.ceil(PER_DECADE * math.log10(high)) + 1)
        sizes = [10.0 ** (number / PER_DECADE) for number in numbers]
        # Where a law with memory begins to respond, so that no solution lies between there and the grid.
        sizes += [a for law in self.items if sizes[0] < (a := (1.0 + 1e-9) * law.least()) < sizes[-1]]
        sizes = sorted(set(sizes))
        for a in reversed(sizes):  # what is known of the breaks for one amplitude serves for smaller ones
            if a not in self._whole:
                try:
                    self._whole[a] = self.gains(a)
                except AnalysisError:
                    self._whole[a] = np.full(len(self.items), math.nan, dtype=complex)
        return np.array(sizes), np.array([self._whole[a] for a in sizes]).T

    def about(self, s: Array) -> Array:
        """The fundamentals to a thousandth, of laws of one signal by their gains on a grid of amplitudes."""
        self.check()
        phasors, means = [], []
        for k, (law, span) in enumerate(zip(self.items, self.spans, strict=True)):
            a = float(abs(s[span[0]]))
            if len(span) > 1 or a == 0.0:
                n, mean = self.one(law, s[span], self.biases[span])
            else:
                x = PER_DECADE * math.log10(a)
                low = math.floor(x)
                try:
                    (lower, mean), (upper, other) = self._tabled(k, low), self._tabled(k, low + 1)
                    n, mean = (
                        ((low + 1 - x) * lower + (x - low) * upper) * complex(s[span[0]]),
                        max(mean, other, key=abs),
                    )
                except AnalysisError:  # at a neighbor that is too small for a law with memory
                    n, mean = self.one(law, s[span], self.biases[span])
            phasors.append(n)
            means.append(mean)
        shift = np.where(self.remembers, 0.0, np.array(means) - self.values)
        if (np.abs(shift) > self._unheard(np.array(phasors), NEAR)).any():
            return self.balanced(self.sines(s), np.abs(s), part=NEAR)[0]
        return np.array(phasors)

    def _tabled(self, k: int, number: int) -> tuple[complex, float]:
        """The gain of a law at an amplitude of the grid, and the mean of what it gives."""
        if (k, number) not in self._single:
            a = 10.0 ** (number / PER_DECADE)
            n, mean = self.one(self.items[k], np.array([complex(a)]), self.biases[self.spans[k]])
            self._single[k, number] = n / a, mean
        return self._single[k, number]

    # --- means -----------------------------------------------------------------------------------------------------

    def balanced(self, answer: Answer, sizes: Array, *, part: float = MOVED) -> tuple[Array, Array]:
        """What the laws give about the means at which they and the rest agree, and these means.

        sizes: of the signals' oscillations about them. part: how far a mean may move, relative to these. By Newton's
        method from the operating point, with differences. Raises AnalysisError (E704) where no means are found.
        """

        def at(b: Array) -> tuple[Array, Array]:
            self.check()
            answers = [answer(k, b[span]) for k, span in enumerate(self.spans)]
            return np.array([n for n, _ in answers], dtype=complex), np.array([mean for _, mean in answers])

        n, means = at(self.biases)
        reference = np.where(self.remembers, means, self.values)  # which side a relay rests on is chance
        shift = means - reference
        moved = np.abs(shift) > self._unheard(n, part)
        if not moved.any():
            return n, self.biases
        rest = self.rest
        if rest is not None:
            count, size = len(n), len(rest.A)
            steps = 1e-4 * np.fmax(sizes, 1e-9 * np.abs(self.biases))
            x, given, b = np.zeros(size), np.zeros(count), self.biases  # given: how far the means of the laws move
            for _ in range(_ROUNDS):
                slopes = np.zeros((count, len(b)))
                for k, span in enumerate(self.spans):
                    for i, slot in enumerate(span):
                        if (h := steps[slot]) > 0:
                            apart = h * (np.arange(len(span)) == i)
                            slopes[k, slot] = (answer(k, b[span] + apart)[1] - answer(k, b[span] - apart)[1]) / (
                                2.0 * h
                            )
                whole = np.block([[rest.A, rest.B], [-slopes @ rest.C, np.eye(count) - slopes @ rest.D]])
                gap = np.concatenate([rest.A @ x + rest.B @ given, given - (means - reference)])
                step, is_solved = _solved(whole, -gap)
                change = rest.C @ step[:size] + rest.D @ step[size:]
                # No step moves a mean by more than a few sizes of its signal.
                reach = np.max(np.abs(change) / np.fmax(3.0 * sizes + np.abs(b - self.biases), 1e-300), initial=1.0)
                x, given = x + step[:size] / reach, given + step[size:] / reach
                b = self.biases + rest.C @ x + rest.D @ given
                n, means = at(b)
                agrees = np.all(np.abs(given - (means - reference)) <= self._unheard(n, NEAR))
                if is_solved and agrees and np.all(np.abs(change) <= part * sizes + _NOISE * np.abs(b)):
                    return n, b
        bad = int(np.argmax(np.where(moved, np.abs(shift), -1.0)))
        told = float(shift[bad] + reference[bad])
        message = f"shifts the mean: its mean is {told:.6g} for a sine, but {reference[bad]:.6g} at rest."
        cure = "Choose a point about which the law is odd, give a smaller amplitude, or estimate the response."
        raise AnalysisError(Fault("E704", self.items[bad].name, message, cure))

    def _unheard(self, n: Array, part: float) -> Array:
        """How far the mean of what each law gives may move: relative to all that is added up behind it."""
        sizes = np.abs(n)
        if self.rest is not None:
            into = np.abs(np.vstack([self.rest.B, self.rest.D]))
            with np.errstate(divide="ignore", invalid="ignore"):
                beside = np.where(into > 0, (into @ sizes)[:, None] / into, np.inf)
            sizes = np.min(beside, axis=0, initial=np.inf)
        return np.asarray(part * sizes + _NOISE * np.abs(self.values))


def _solved(matrix: Array, right: Array) -> tuple[Array, bool]:
    """The least-squares solution, with rows and columns scaled alike, and whether it solves the system."""
    rows = np.max(np.abs(matrix), axis=1)
    rows = np.where(rows > 0, rows, 1.0)
    columns = np.max(np.abs(matrix / rows[:, None]), axis=0)
    columns = np.where(columns > 0, columns, 1.0)
    scaled, wanted = matrix / rows[:, None] / columns, right / rows
    solution = np.linalg.lstsq(scaled, wanted, rcond=1e-9)[0]
    return solution / columns, bool(np.max(np.abs(scaled @ solution - wanted)) <= NEAR * np.max(np.abs(wanted)))


def gain_matrix(laws: Laws, s: Array, n: Array) -> Array:
    """A matrix with n = gains s: of each law, its answer shared out to its signals by their sizes."""
    gains = np.zeros((len(n), len(s)), dtype=complex)
    for k, span in enumerate(laws.spans):
        own = s[span]
        total = float(np.sum(np.abs(own) ** 2))
        if total > 0:
            gains[k, span] = n[k] * np.conj(own) / total
    return gains
