"""Harmonic balance: the response of a diagram with its nonlinear laws to a sine of a given amplitude.

    response = linearizer.harmonic_response("r", ["motor.omega"], omega, amplitude=0.1)    # .value: complex

Every law on the way is taken out of the diagram; the rest is linear, and for a sine at each law's place

    s = G_sr r + G_sn n,      n_k = N_k(s) s_k        (the fundamental of what the law gives)

is solved for the amplitudes and phases s, frequency by frequency. Harmonics that come back around a loop are left out:
the rest of the diagram is taken to be a low-pass. Laws of several signals are integrated over the phases of these. Laws
that are not odd about the operating point, which must be one of rest, move the means of what they read.

References: [1] A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design,
McGraw-Hill 1968; K. J. Astrom, R. M. Murray, Feedback Systems, section 10.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..frequency.delayed import DelayedModel
from ..frequency.response import poles, response
from ..frequency.systems import frd
from ..model.values import in_si
from ..text.arrays import Array
from ..text.errors import AnalysisError, Fault, UsageError
from ..text.printable import counted
from ..text.rich_output import Part, Shown
from .linearization import Linearization
from .signals import Names, listed, place, places
from .sinusoidal_gains import Laws, Rest, gain_matrix
from .transfer import Transfer

_CLOSE = 1e-10
_ROUNDS = 200
_LEAST, _MOST = 1e-12, 1e5
"""The range of amplitudes in a search, relative to the signal without the laws."""
MOST = 40
"""Signals that a Linearizer names."""


@dataclass(frozen=True)
class HarmonicResponse:
    """Fundamentals for a sine of one amplitude at `input`: value (outputs, frequencies), relative to that sine.

    omega: rad/s. amplitudes, means: by the signal of each law, its amplitude and its mean at each frequency.
    """

    input: str
    outputs: tuple[str, ...]
    amplitude: float
    omega: Array
    value: Array
    amplitudes: dict[str, Array]
    means: dict[str, Array]
    dt: float
    balance: Balance

    def response(self, omega: object) -> Array:
        """(outputs, 1, frequencies) at other frequencies, solved anew."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if omega.shape == self.omega.shape and np.array_equal(omega, self.omega):
            return self.value[:, None, :]
        return self.balance.at(self.amplitude, omega).value[:, None, :]

    def frd(self) -> object:
        """A control.FrequencyResponseData."""
        return frd(self.value[:, None, :], self.omega, inputs=[self.input], outputs=self.outputs, dt=self.dt)


class Balance:
    """A diagram from one input to some outputs, with its laws taken out. Arguments as of `Linearizer.model`."""

    def __init__(self, linearizer: Linearization, input: str, outputs: Names, *, openings: Names = ()) -> None:
        graph = linearizer.graph
        self.linearizer, self.input = linearizer, place(graph, input)
        self.outputs = tuple(spot for name in listed(outputs) for spot in places(graph, name))
        self.openings = tuple(spot for name in listed(openings) for spot in places(graph, name))
        nodes = linearizer.nonlinear_nodes([self.input], self.outputs, self.openings)
        self.laws = Laws(linearizer, nodes)
        cut = linearizer.with_gains({(node, slot): 0.0 for node, slots in nodes.items() for slot in slots})
        self.model = cut.injected([self.input], self.outputs, self.openings, self.laws.nodes, self.laws.slots)
        n, laws, slots = len(self.outputs), len(self.laws.nodes), len(self.laws.slots)
        self.laws.rest = Rest.of(self.model, range(1, 1 + laws), range(n, n + slots))

    def at(self, amplitude: float, omega: object) -> HarmonicResponse:
        """The response at each omega in rad/s, in this order; of several solutions, each continues the one before.

        amplitude: in SI.

        At 0 it is the limit for a very slow sine: real, or inf behind an integrator. Raises UsageError (E501), and
        AnalysisError: E704 (a law that moves the mean), E706 (no solution).
        """
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if not (np.isfinite(amplitude) and amplitude > 0):
            raise UsageError(Fault("E501", "amplitude", f"must be above 0, not {amplitude}."))
        if not (np.isfinite(omega) & (omega >= 0)).all():
            raise UsageError(Fault("E501", "omega", "must be numbers in rad/s, 0 or more."))
        values, sizes, means = self._at(float(amplitude), np.where(omega > 0, omega, self._slow))
        rests = np.nonzero(omega == 0)[0]
        if len(rests):
            faster = self._at(float(amplitude), np.array([4.0 * self._slow]))[0]
            for k in rests.tolist():
                grows = np.abs(values[:, k]) > 2.0 * np.abs(faster[:, 0])
                values[:, k] = np.where(grows, np.copysign(np.inf, values[:, k].real), values[:, k].real)
        amplitudes, middles = (dict(zip(self.laws.names, rows, strict=True)) for rows in (sizes, means))
        names = tuple(spot.name for spot in self.outputs)
        return HarmonicResponse(
            self.input.name, names, float(amplitude), omega, values, amplitudes, middles,
            float(self.model.dt or 0.0), self,
        )  # fmt: skip

    @cached_property
    def _slow(self) -> float:
        """A frequency in rad/s far below all others."""
        return 1e-8 * float(np.min(speeds(self.model), initial=1.0))

    def _at(self, amplitude: float, omega: Array) -> tuple[Array, Array, Array]:
        """Values, (outputs, frequencies), and the amplitudes and means of the laws' signals."""
        G = response(self.model, omega)
        n, m = len(self.outputs), len(self.laws.nodes)
        values = np.empty((n, len(omega)), dtype=complex)
        sizes, means = np.empty((2, len(self.laws.slots), len(omega)))
        near: Solution | None = None
        for k, w in enumerate(omega.tolist()):
            if m == 0:
                values[:, k] = G[:n, 0, k]
                continue
            near = solved(self.laws, G[n:, 0, k] * amplitude, G[n:, 1:, k], near, f"{w:g} rad/s")
            values[:, k] = G[:n, 0, k] + G[:n, 1:, k] @ near[1] / amplitude
            sizes[:, k], means[:, k] = np.abs(near[0]), self.laws.means(near[0])
        return values, sizes, means


def speeds(model: Transfer | DelayedModel) -> Array:
    """How fast the modes of a model are, in rad/s; without those of integrators."""
    if isinstance(model, DelayedModel):
        sizes = model.speeds
    else:
        eigenvalues = np.asarray(poles(model), dtype=complex)
        if model.dt:
            with np.errstate(all="ignore"):
                eigenvalues = np.log(eigenvalues) / float(model.dt)
        sizes = np.abs(eigenvalues)
    return np.asarray(sizes[np.isfinite(sizes) & (sizes > 1e-9)])


Solution = tuple[Array, Array]
"""The phasors of the signals, s, and those of what the laws give, n."""


def solved(laws: Laws, free: Array, G: Array, near: Solution | None, where: str) -> Solution:
    """s and n with s = free + G n, n = laws(s).

    near: a solution nearby, which this one continues where there are several. Raises AnalysisError (E706).
    """
    scale = float(np.max(np.abs(free), initial=0.0))
    if scale == 0.0:
        return np.zeros(len(free), dtype=complex), np.zeros(len(laws.nodes), dtype=complex)
    if len(free) == 1:
        return _of_one_signal(laws, free, G, near, where)
    solution = _near(laws, free, G, near) or _followed(laws, free, G, 1e3) or _followed(laws, free, G, 1e-3)
    if solution is None:
        raise _without(laws, where)
    return solution


def _without(laws: Laws, where: str) -> AnalysisError:
    message = f"no amplitudes were found at {where} that satisfy all laws and the rest of the diagram."
    cure = "Try another amplitude. If a law jumps, the diagram may slide along the jump, or oscillate by itself."
    return AnalysisError(Fault("E706", laws.names[0], message, cure))


def _of_one_signal(laws: Laws, free: Array, G: Array, near: Solution | None, where: str) -> Solution:
    """All laws read one signal: its amplitude a is a root of |a (1 - G N(a))| = |free|; all roots are found.

    A balance at which more amplitude would need less excitation is unstable [1, chapter 3]; of the others, the one that
    continues `near` is taken, else the smallest. An amplitude of practically 0 belongs to a law that is steep or jumps
    there, and holds its signal.
    """
    from scipy.optimize import brentq

    scale = float(abs(free[0]))

    def needed(a: float) -> float:
        return float(abs(a * (1.0 - G[0] @ laws.gains(a)))) - scale

    grid, gains = laws.table(_LEAST * scale, _MOST * scale)
    gap = np.abs(grid * (1.0 - G[0] @ gains)) - scale
    roots = [float(brentq(needed, *ends, xtol=1e-300, rtol=1e-14)) for ends in _rising(needed, grid, gap)]
    if not roots and not gap[0] >= 0:
        bad = grid[np.isnan(gap)]
        if len(bad):
            laws.gains(float(min(bad, key=lambda a: abs(math.log(a / scale)))))  # which says why
        raise _without(laws, where)
    if gap[0] >= 0:
        roots.insert(0, float(grid[0]))
    last = float(abs(near[0][0])) if near is not None else 0.0
    a = min(roots, key=lambda a: abs(math.log(a / last))) if last > 0 else roots[0]
    N = laws.gains(a)
    s = free / (1.0 - G[0] @ N)
    return s, N * s


def _rising(f: Callable[[float], float], grid: Array, values: Array) -> list[tuple[float, float]]:
    """Intervals in which f rises through 0, two crossings within one step of the grid included."""
    from scipy.optimize import minimize_scalar

    intervals = [
        (float(grid[k]), float(grid[k + 1])) for k in np.nonzero((values[:-1] < 0) & (values[1:] >= 0))[0].tolist()
    ]
    middle, before, after = values[1:-1], values[:-2], values[2:]
    reach = np.fmax(np.abs(middle - before), np.abs(middle - after))
    low = (middle > 0) & (middle <= before) & (middle <= after)
    high = (middle < 0) & (middle >= before) & (middle >= after)
    for k in (np.nonzero((low | high) & (np.abs(middle) < reach))[0] + 1).tolist():
        sign, ends = math.copysign(1.0, values[k]), (float(grid[k - 1]), float(grid[k + 1]))
        precise = {"xatol": 1e-9 * ends[0]}
        turn = minimize_scalar(lambda a, sign=sign: sign * f(a), bounds=ends, method="bounded", options=precise).x
        if sign * f(turn) < 0:
            intervals.append((float(turn), ends[1]) if sign > 0 else (ends[0], float(turn)))
    return sorted(intervals)


def _near(laws: Laws, free: Array, G: Array, near: Solution | None) -> Solution | None:
    """A solution found from one nearby, or from the signals without the laws; None where there is none.

    By repeated linear solutions with the gains at the last amplitudes, which converge fast where the laws are mild; by
    Newton's method where they do not.
    """
    m = len(free)
    s = free if near is None else np.linalg.solve(np.eye(m) - G @ gain_matrix(laws, *near), free)
    tiny = _LEAST * float(np.max(np.abs(free)))
    s = np.where(np.abs(s) > tiny, s, tiny)
    step, change, n = 1.0, np.inf, laws.fundamentals(s)
    for _ in range(_ROUNDS if near is None else _ROUNDS // 5):
        moved = np.linalg.solve(np.eye(m) - G @ gain_matrix(laws, s, n), free)
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
    return _by_newton(laws, free, G, s, (1.0, 1.1, 0.9)) if near is None else _by_newton(laws, free, G, near[0], (1.0,))


def _by_newton(laws: Laws, free: Array, G: Array, begin: Array, turns: Sequence[float]) -> Solution | None:
    """By Newton's method with differences, from some phasors and multiples of them."""
    from scipy.optimize import root

    size = np.fmax(np.abs(begin), _LEAST * float(np.max(np.abs(free))))

    def unpacked(v: Array) -> Array:
        half = len(v) // 2
        return np.asarray((v[:half] + 1j * v[half:]) * size)

    def residual(v: Array) -> Array:
        now = unpacked(v)
        gap = (now - free - G @ laws.fundamentals(now)) / size
        return np.concatenate([gap.real, gap.imag])

    at = np.concatenate([(begin / size).real, (begin / size).imag])
    for turn in turns:
        solution = root(residual, turn * at, method="hybr", options={"xtol": 1e-12})
        if np.max(np.abs(solution.fun)) < 1e-7:
            phasors = unpacked(solution.x)
            return phasors, laws.fundamentals(phasors)
    return None


def _followed(laws: Laws, free: Array, G: Array, part: float) -> Solution | None:
    """A solution followed from an excitation `part` times as large, in steps that halve where it is lost.

    Laws that saturate or jump matter little to a large excitation, and laws that grow to a small one.
    """
    now, factor = _near(laws, part * free, G, None), 0.5 if part > 1.0 else 2.0
    while now is not None and part != 1.0 and abs(math.log(factor)) > 0.05:
        further = max(1.0, part * factor) if part > 1.0 else min(1.0, part * factor)
        s, n = now
        solution = _near(laws, further * free, G, (s * further / part, n * further / part))
        if solution is None:
            factor = math.sqrt(factor)
        else:
            part, now = further, solution
    return now if part == 1.0 else None


class Linearizer(Linearization, Shown):
    """Slopes at a point, wired anew for each transfer that is asked for.

    amplitude: by signal, the amplitude of a sine there: laws of that signal are replaced by their describing functions.
    sigma: the same with the standard deviation of a Gaussian signal. Plain numbers are in the declared unit of the
    signal; quantities such as "2 rpm" are in their own. overrides: by the path of a block, a linear model
    in its place (of python-control, or a matrix of gains), from its inputs to its outputs as declared. Raises
    UsageError (E501) and AnalysisError (E704) where they do not fit.
    """

    def parts(self) -> Iterator[Part]:
        """Where it stands, what has no slope there, and the signals that it can be asked for."""
        plan, point = self.plan, self.slopes.point
        yield f"<Linearizer of {plan.name} at t = {point.t:g} s: {counted(len(plan.states), 'state')}>"
        inputs = ", ".join(known.name for known in plan.inputs)
        yield f"  inputs: {inputs or 'none'}"
        yield f"  signals: {', '.join(list(plan.signals)[:MOST])}{', ...' if len(plan.signals) > MOST else ''}"
        laws = dict.fromkeys(f"{plan.node_name(self.graph.nodes[law.node])} ({law.kind})" for law in self.slopes.laws)
        yield from [f"  no slope here: {', '.join(laws)}"] if laws else []

    def harmonic_response(
        self, input: str, outputs: Names, omega: object, *, amplitude: object, openings: Names = ()
    ) -> HarmonicResponse:
        """The fundamentals of `outputs` for a sine of an amplitude at `input`, by harmonic balance; omega: in rad/s.

        amplitude: a number in the declared unit of `input`, or a quantity such as "2 rpm". Raises AnalysisError: E704
        (a law that moves the mean), E706 (no solution).
        """
        balance = Balance(self, input, outputs, openings=openings)
        return balance.at(in_si(amplitude, balance.input.declared, "amplitude", is_difference=True), omega)
