"""Harmonic balance: the response of a diagram with its nonlinear laws to a sine of a given amplitude.

    balance = Balance(linearizer, "r", ["motor.omega"])
    made = balance.at(amplitude, omega)          # .value: complex, (outputs, frequencies)

Every law on the way is taken out of the diagram; the rest is linear, and for a sine at each law's place

    s = G_sr r + G_sn n,      n_k = N_k(s) s_k        (the fundamental of what the law gives)

is solved for the amplitudes and phases s, frequency by frequency. Harmonics that come back around a loop are left out:
the rest of the diagram is taken to be a low-pass. Laws of several signals are integrated over the phases of these.

References: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, McGraw-Hill
1968; K. J. Astrom, R. M. Murray, Feedback Systems, section 10.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import AnalysisError, Fault, UsageError
from . import quadrature
from .laws import StaticLaw
from .linearizer import Linearizer, Names, listed
from .names import place, places
from .response import response

__all__ = ["Balance", "HarmonicResponse", "Laws"]

Array = np.ndarray[Any, Any]
SHIFT = 1e-3
"""How far a law may move the mean, of what it does to the sine."""
_CLOSE = 1e-10
_ROUNDS = 200


@dataclass(frozen=True)
class HarmonicResponse:
    """Fundamentals for a sine of an amplitude at `input`: value (outputs, frequencies), of what is put in.

    omega: rad/s. amplitudes: by the signal of each law, its amplitude at each frequency.
    """

    input: str
    outputs: tuple[str, ...]
    amplitude: float
    omega: Array
    value: Array
    amplitudes: dict[str, Array]
    dt: float
    balance: Balance

    def response(self, omega: Any) -> Array:
        """(outputs, 1, frequencies) at other frequencies, solved anew."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if omega.shape == self.omega.shape and np.array_equal(omega, self.omega):
            return self.value[:, None, :]
        return self.balance.at(self.amplitude, omega).value[:, None, :]

    def frd(self) -> Any:
        """A control.FrequencyResponseData."""
        from .frd import frd

        return frd(self.value[:, None, :], self.omega, inputs=[self.input], outputs=self.outputs, dt=self.dt)


class Laws:
    """The laws that are taken out of a diagram, and what they do to sines around the operating point.

    slots: one for each signal that a law reads; spans: of each law, which of these signals it reads.
    """

    def __init__(self, linearizer: Linearizer, nodes: dict[int, tuple[int, ...]]) -> None:
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

    def fundamentals(self, s: Array) -> Array:
        """The phasors of what the laws give for the phasors of their signals. Raises AnalysisError (E704)."""
        return np.array([self.one(law, s[span]) for law, span in zip(self.items, self.spans, strict=True)])

    def one(self, law: StaticLaw, s: Array) -> complex:
        sizes = np.abs(s)
        if not sizes.any():
            return 0.0
        if len(s) == 1:
            made = law.described(float(sizes[0]))
            self._check(law, float(made.mean), abs(made.gain) * float(sizes[0]))
            return complex(made.gain) * complex(s[0])
        whole = quadrature.fundamental(lambda u: law(*u), s, np.array(law.inputs), switches=lambda u: law.switches(*u))
        value = complex(whole.harmonics[0])
        self._check(law, float(whole.mean), abs(value))
        return value

    def _check(self, law: StaticLaw, mean: float, size: float) -> None:
        if law.remembers:
            return
        rest = float(law(*(np.array([x]) for x in law.inputs))[0])
        if abs(mean - rest) > SHIFT * size + 1e-12 * abs(rest):
            message = f"moves the mean: for a sine it gives {mean:.6g} in the middle, and {rest:.6g} at rest."
            cure = "A harmonic balance needs laws that are odd about the operating point; estimate the response."
            raise AnalysisError(Fault("E704", law.name, message, cure))


class Balance:
    """A diagram from one input to some outputs, its laws apart. Arguments as of `Linearizer.model`."""

    def __init__(self, linearizer: Linearizer, input: str, outputs: Names, *, openings: Names = ()) -> None:
        graph = linearizer.graph
        self.linearizer, self.input = linearizer, place(graph, input)
        self.outputs = tuple(spot for name in listed(outputs) for spot in places(graph, name))
        self.openings = tuple(spot for name in listed(openings) for spot in places(graph, name))
        nodes = linearizer.nonlinear_nodes([self.input], self.outputs, self.openings)
        self.laws = Laws(linearizer, nodes)
        cut = linearizer.with_gains({(node, slot): 0.0 for node, slots in nodes.items() for slot in slots})
        self.model = cut.injected([self.input], self.outputs, self.openings, self.laws.nodes, self.laws.slots)

    def at(self, amplitude: float, omega: Any) -> HarmonicResponse:
        """Raises AnalysisError: E704 (a law that moves the mean), E706 (no solution)."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if not (np.isfinite(amplitude) and amplitude > 0):
            raise UsageError(Fault("E501", "amplitude", f"{amplitude} is not above 0."))
        G = response(self.model, omega)
        n, m = len(self.outputs), len(self.laws.nodes)
        values = np.empty((n, len(omega)), dtype=complex)
        sizes = np.empty((len(self.laws.slots), len(omega)))
        gains: Array | None = None
        for k, w in enumerate(omega.tolist()):
            if m == 0:
                values[:, k] = G[:n, 0, k]
                continue
            s, given = solved(self.laws, G[n:, 0, k] * amplitude, G[n:, 1:, k], gains, f"{w:g} rad/s")
            values[:, k] = G[:n, 0, k] + G[:n, 1:, k] @ given / amplitude
            sizes[:, k] = np.abs(s)
            gains = _gains(self.laws, s, given)
        names = tuple(spot.name for spot in self.outputs)
        amplitudes = {name: sizes[i] for i, name in enumerate(self.laws.names)}
        return HarmonicResponse(
            self.input.name, names, float(amplitude), omega, values, amplitudes, float(self.model.dt or 0.0), self
        )


def _gains(laws: Laws, s: Array, n: Array) -> Array:
    """A matrix with n = gains s: of each law, its answer shared out to its signals by their sizes."""
    made = np.zeros((len(n), len(s)), dtype=complex)
    for k, span in enumerate(laws.spans):
        own = s[span]
        total = float(np.sum(np.abs(own) ** 2))
        if total > 0:
            made[k, span] = n[k] * np.conj(own) / total
    return made


def solved(laws: Laws, free: Array, G: Array, gains: Array | None, where: str) -> tuple[Array, Array]:
    """s and n with s = free + G n, n = laws(s).

    By repeated linear solutions with the gains that belong to the last amplitudes, which soon settle where the laws
    are mild; by Newton's method with differences where they do not. Raises AnalysisError (E706).
    """
    m = len(free)
    scale = float(np.max(np.abs(free), initial=0.0))
    if scale == 0.0:
        return np.zeros(m, dtype=complex), np.zeros(len(laws.nodes), dtype=complex)
    s = free if gains is None else np.linalg.solve(np.eye(m) - G @ gains, free)
    tiny = 1e-12 * scale
    s = np.where(np.abs(s) > tiny, s, tiny)
    step, change, n = 1.0, np.inf, laws.fundamentals(s)
    for _ in range(_ROUNDS):
        matrix = np.eye(m) - G @ _gains(laws, s, n)
        moved = np.linalg.solve(matrix, free)
        now = float(np.max(np.abs(moved - s) / np.fmax(np.abs(moved), tiny)))
        if now < _CLOSE:
            return moved, laws.fundamentals(moved)
        if now > 0.9 * change:
            step = max(0.5 * step, 0.05)
        change = now
        s = s + step * (moved - s)
        n = laws.fundamentals(s)
        if step < 0.06 and now > 1e-2:
            break
    return _by_newton(laws, free, G, s, where)


def _by_newton(laws: Laws, free: Array, G: Array, s: Array, where: str) -> tuple[Array, Array]:
    from scipy.optimize import root

    size = np.fmax(np.abs(s), 1e-12 * float(np.max(np.abs(free))))

    def unpacked(v: Array) -> Array:
        half = len(v) // 2
        return (v[:half] + 1j * v[half:]) * size

    def residual(v: Array) -> Array:
        now = unpacked(v)
        gap = (now - free - G @ laws.fundamentals(now)) / size
        return np.concatenate([gap.real, gap.imag])

    begin = np.concatenate([(s / size).real, (s / size).imag])
    for turn in (1.0, 1.1, 0.9, 2.0, 0.5):
        made = root(residual, turn * begin, method="hybr", options={"xtol": 1e-12})
        if np.max(np.abs(made.fun)) < 1e-7:
            found = unpacked(made.x)
            return found, laws.fundamentals(found)
    message = f"no amplitudes were found at {where} at which all laws and the rest of the diagram agree."
    cure = "Try another amplitude; where a law jumps, there may be a limit cycle in the place of a response."
    raise AnalysisError(Fault("E706", laws.names[0], message, cure))
