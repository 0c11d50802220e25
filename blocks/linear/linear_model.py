"""Linear models as users get them: state spaces of python-control that also say how they came about."""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np

from ..frequency.systems import label
from ..text.arrays import Array
from .transfer import LoopOfRates, Transfer


def _labels(names: Sequence[str]) -> list[str]:
    """Labels, each one once: "a.b_c" and "a_b.c" would be the same."""
    labels: list[str] = []
    for name in names:
        text, count = label(name), 1
        while text in labels:
            text, count = f"{label(name)}_{count + 1}", count + 1
        labels.append(text)
    return labels


class LinearModel(control.StateSpace):  # type: ignore[misc]
    """dx/dt = A x + B u, y = C x + D u (or x(k+1) = ... where dt is a period in s), in SI units.

    Its labels are the diagram's names with "_" for ".", which python-control refuses: "motor_omega". signals: the
    names of the inputs and of the outputs in the diagram. report: what each block gave. units: of the inputs and of
    the outputs in SI, "" where unknown. hint: what to ask for where nothing comes out because laws on the way, such as
    a quantizer, pass nothing on where they stand; "" else. fragile: of a loop at one element of a vector, what
    `margins` asks for a warning that all elements together bear far less; else None.
    """

    def __init__(self, transfer: Transfer) -> None:
        labels = [_labels(texts) for texts in (transfer.states, *transfer.signals)]
        matrices = transfer.A, transfer.B, transfer.C, transfer.D
        super().__init__(
            *matrices, transfer.dt, states=labels[0], inputs=labels[1], outputs=labels[2], name=transfer.name or None,
            remove_useless_states=False,
        )  # fmt: skip
        self.signals = (tuple(transfer.signals[0]), tuple(transfer.signals[1]))
        self.report, self.units = transfer.report, (tuple(transfer.units[0]), tuple(transfer.units[1]))
        self.hint, self.fragile = transfer.hint, transfer.fragile

    def closed(self) -> LinearModel:
        """Of a loop transfer L: T = L/(1 + L), or of a matrix (I + L)^-1 L."""
        A, B, C, D = (np.asarray(m, dtype=float) for m in (self.A, self.B, self.C, self.D))
        loop = Transfer(A, B, C, D, self.dt, self.state_labels, self.signals, self.units, report=self.report)
        return LinearModel(loop.closed())


class LiftedModel(LinearModel):
    """A discrete-time model over the period of several rates, with the inputs and outputs of its base steps stacked.

    steps: how many base steps there are; dt is their time together. Of step k: inputs "r@k", outputs "y@k".
    """

    def __init__(self, transfer: Transfer, steps: int) -> None:
        super().__init__(transfer)
        self.steps = steps

    def fundamental(self, omega: object) -> Array:
        """The response at the frequency of the input: complex, (outputs, inputs, frequencies), omega in rad/s.

        The inputs are sines that are held over each base step h, and the outputs at base steps are decomposed into
        sines. From one at omega, a diagram of several rates makes others too, at omega + 2 pi k/dt, which are left out
        here (at multiples of pi/dt one is at -omega, and the response to a real sine depends on its phase). The
        fundamental of an output that is held over each base step is (1 - exp(-j omega h))/(j omega h) times this.
        """
        from ..frequency.realization import balanced, variable

        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        whole = balanced(self).at(variable(omega, float(self.dt)))
        n, m = (size // self.steps for size in whole.shape[:2])
        parts = whole.reshape(self.steps, n, self.steps, m, len(omega))
        turns = np.exp(1j * np.outer(np.arange(self.steps), omega * self.dt / self.steps))
        return np.asarray(np.einsum("kw,knjmw,jw->nmw", turns.conj(), parts, turns) / self.steps)


class LiftedLoop(LinearModel):
    """The loop transfer at one signal of a diagram of several rates, over the period after which its ticks repeat.

    Its inputs are the values that the signal takes within this period, in turn: "g.y@0", "g.y@1", ...; its outputs are
    what comes back at each. With negative feedback of each to itself it is the closed loop of the diagram, so that
    `margins` and `closed` are those of the diagram: with one input held over the whole period they would not be.
    point: the signal; times: of the values, in s from the beginning of the period; dt is the whole of it.
    """

    def __init__(self, transfer: LoopOfRates) -> None:
        super().__init__(transfer)
        self.point, self.times = transfer.point, transfer.times


def state_space(transfer: Transfer) -> LinearModel:
    """A model as python-control has it."""
    return LiftedLoop(transfer) if isinstance(transfer, LoopOfRates) else LinearModel(transfer)
