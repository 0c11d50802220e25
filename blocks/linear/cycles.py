"""Limit cycles by harmonic balance, with their stability; cycles of two periods of sampled diagrams.

The first law of the loop is given a sine A sin(omega t), and the rest of the diagram, its other laws included, gives
back L(A, omega) of it. Where L = 1 the oscillation keeps itself up [1]. A little more amplitude changes the exponent
jw + sigma of what keeps itself up; where sigma is then below 0, the cycle is stable (Loeb's criterion).

Of a sampled diagram the fastest oscillation, from period to period, has the sign of its signals change each time: there
a law is (f(b + A) - f(b - A))/2, exactly, so that such a cycle and its stability are exact too.

References: [1] A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design,
McGraw-Hill 1968, chapter 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import AnalysisError, Fault
from .balance import Laws, solved, speeds
from .linearizer import Linearizer
from .response import response

__all__ = ["LimitCycle", "limit_cycles"]

Array = np.ndarray[Any, Any]
_GRID = 161


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """An oscillation that keeps itself up.

    omega: in rad/s. amplitudes: by the signal of each law, in SI. stable: whether it comes back after a small change.
    kind: "harmonic balance", or "two periods" (of a sampled diagram; exact).
    """

    omega: float
    amplitudes: dict[str, float]
    stable: bool
    kind: str

    @property
    def period(self) -> float:
        """In s."""
        return 2.0 * math.pi / self.omega


def limit_cycles(
    linearizer: Linearizer,
    *,
    omega: tuple[float, float] | None = None,
    amplitude: tuple[float, float] = (1e-9, 1e3),
) -> tuple[LimitCycle, ...]:
    """The limit cycles of a diagram around its operating point, by frequency.

    omega: where to look, in rad/s (from the poles, unless given). amplitude: of the first law's signal, in SI.
    Raises AnalysisError: E704 (a law that moves the mean), E705 (no law in a loop).
    """
    nodes = linearizer.nonlinear_nodes((), ())
    cut = linearizer.with_gains({(node, slot): 0.0 for node, slots in nodes.items() for slot in slots})
    laws = Laws(linearizer, nodes)
    name = linearizer.graph.plan.name
    if not laws.nodes:
        message = "no law that bends is in a loop, so that nothing keeps an oscillation at one amplitude."
        raise AnalysisError(Fault("E705", name, message, "See its poles: linearize."))
    model = cut.injected((), (), (), laws.nodes, laws.slots)
    made: list[LimitCycle] = []
    if model.dt:
        made += _of_two_periods(laws, model, amplitude)
    low, high = omega if omega is not None else _range(model)
    if model.dt:
        high = min(high, 0.98 * math.pi / model.dt)
    made += _by_balance(laws, model, (low, high), amplitude)
    return tuple(sorted(made, key=lambda cycle: cycle.omega))


def _range(model: Any) -> tuple[float, float]:
    sizes = speeds(model)
    if not len(sizes):
        sizes = np.array([1.0])
    return float(sizes.min()) / 30, float(sizes.max()) * 30


class _Lead:
    """What comes back to the first signal that a law reads, of what it is given. Laws of it alone lead."""

    def __init__(self, laws: Laws, model: Any) -> None:
        self.laws, self.model = laws, model
        self.own = [k for k, span in enumerate(laws.spans) if span == [0]]
        others = [k for k in range(len(laws.items)) if k not in self.own]
        if not self.own or any(0 in laws.spans[k] for k in others):
            message = "is a law of several signals, from which a limit cycle cannot be followed."
            raise AnalysisError(Fault("E704", laws.items[0].name, message, "Write it as locals of one signal each."))
        self.others, self.rest = others, _Rest(laws, others)

    def back(self, A: float, G: Array) -> tuple[complex, Array]:
        """L, and all signals. G: (signals, laws) at a frequency."""
        laws = self.laws
        given = np.array([laws.one(laws.items[k], np.array([complex(A)])) for k in self.own])
        free = G[:, self.own] @ given
        if not self.others:
            return free[0] / A, np.array([complex(A)])
        s, n = solved(self.rest, free[1:], G[1:, self.others], None, "a limit cycle")
        return (free[0] + G[0, self.others] @ n) / A, np.array([complex(A), *s])


class _Rest(Laws):
    """The laws that do not read the first signal, of the other signals."""

    def __init__(self, laws: Laws, others: list[int]) -> None:
        self.items, self.nodes = [laws.items[k] for k in others], [laws.nodes[k] for k in others]
        self.slots, self.names = laws.slots[1:], laws.names[1:]
        self.spans = [[at - 1 for at in laws.spans[k]] for k in others]
        self._table = {}


def _by_balance(laws: Laws, model: Any, omega: tuple[float, float], amplitude: tuple[float, float]) -> list[LimitCycle]:
    from scipy.optimize import root

    lead = _Lead(laws, model)
    alone = not lead.others
    count_a = _GRID if alone else 41
    grid_w = np.geomspace(*omega, _GRID)
    grid_a = np.geomspace(*amplitude, count_a)
    G = response(model, grid_w)
    table = np.full((count_a, len(grid_w)), np.nan, dtype=complex)
    if alone:
        gains = np.array([_gains(laws, A) for A in grid_a])
        table = gains @ G[0]
    else:
        for i, A in enumerate(grid_a):
            for k in range(len(grid_w)):
                try:
                    table[i, k] = lead.back(float(A), G[:, :, k])[0]
                except AnalysisError as error:
                    if error.code != "E706":
                        raise
    gap = table - 1.0
    found: list[LimitCycle] = []

    def at(v: Array) -> complex:
        w = math.exp(v[1])
        return complex(lead.back(math.exp(v[0]), response(model, np.array([w]))[:, :, 0])[0])

    for i, k in _cells(gap):
        begin = np.log([grid_a[i] * grid_a[i + 1], grid_w[k] * grid_w[k + 1]]) / 2

        def residual(v: Array) -> Array:
            value = at(v) - 1.0
            return np.array([value.real, value.imag])

        try:
            made = root(residual, begin, method="hybr", options={"xtol": 1e-13})
        except AnalysisError:
            continue
        A, w = np.exp(made.x).tolist()
        inside = amplitude[0] <= A <= amplitude[1] and 0.99 * omega[0] <= w <= 1.01 * omega[1]
        if np.max(np.abs(made.fun)) > 1e-8 or not inside:
            continue
        if any(abs(w - other.omega) < 1e-6 * w and abs(A - first(other)) < 1e-6 * A for other in found):
            continue
        s = lead.back(A, response(model, np.array([w]))[:, :, 0])[1]
        e = 1e-5
        more, faster = np.array([e, 0.0]), np.array([0.0, e])
        by_a = (at(made.x + more) - at(made.x - more)) / (2 * e * A)
        by_w = (at(made.x + faster) - at(made.x - faster)) / (2 * e * w)
        stable = (by_a / by_w).imag < 0
        found.append(LimitCycle(w, dict(zip(laws.names, np.abs(s).tolist(), strict=True)), bool(stable), _BALANCE))
    return found


_BALANCE, _TWO = "harmonic balance", "two periods"


def first(cycle: LimitCycle) -> float:
    """The amplitude of the first law's signal."""
    return next(iter(cycle.amplitudes.values()))


def _gains(laws: Laws, A: float) -> Array:
    """The gains of all laws of one signal; NaN where the amplitude does not reach what they need."""
    made = np.full(len(laws.items), math.nan, dtype=complex)
    for k, law in enumerate(laws.items):
        try:
            made[k] = laws.one(law, np.array([complex(A)])) / A
        except AnalysisError:
            if not law.remembers:
                raise
    return made


def _cells(gap: Array) -> list[tuple[int, int]]:
    """Cells of the grid around which the gap turns, or in which both of its parts change their signs."""
    corners = np.stack([gap[:-1, :-1], gap[1:, :-1], gap[1:, 1:], gap[:-1, 1:]])
    with np.errstate(invalid="ignore"):
        fine = np.isfinite(corners).all(axis=0)
        real = (corners.real.min(axis=0) <= 0) & (corners.real.max(axis=0) >= 0)
        imag = (corners.imag.min(axis=0) <= 0) & (corners.imag.max(axis=0) >= 0)
    return [(int(i), int(k)) for i, k in np.argwhere(fine & real & imag)]


def _of_two_periods(laws: Laws, model: Any, amplitude: tuple[float, float]) -> list[LimitCycle]:
    """Cycles in which the signal of all laws changes its sign from one period to the next."""
    from scipy.optimize import brentq

    if len(laws.slots) != 1 or any(law.remembers for law in laws.items):
        return []
    bias = laws.items[0].inputs[0]
    matrix = np.asarray(model.A, dtype=float)
    G = model.C @ np.linalg.solve(-np.eye(len(matrix)) - matrix, model.B) + model.D

    def gap(log_a: float) -> float:
        A = math.exp(log_a)
        both = np.array([bias + A, bias - A])
        return float(G[0] @ [-np.diff(law(both))[0] / (2 * A) for law in laws.items]) - 1.0

    grid = np.log(np.geomspace(min(amplitude[0], 1e-15), amplitude[1], 400))
    values = np.array([gap(a) for a in grid])
    found = []
    for a, b, left, right in zip(grid, grid[1:], values, values[1:], strict=False):
        if left * right < 0 and np.isfinite([left, right]).all():
            A = math.exp(brentq(gap, a, b, xtol=1e-14, rtol=8.9e-16))
            found.append(LimitCycle(math.pi / model.dt, {laws.names[0]: A}, _is_stable(laws, model, bias, A), _TWO))
    return found


def _is_stable(laws: Laws, model: Any, bias: float, A: float) -> bool:
    """Whether the map over two periods, with the slopes of the laws at both ends, contracts."""
    matrix = np.asarray(model.A, dtype=float)
    whole = np.eye(len(matrix))
    for at in (bias + A, bias - A):
        h = 1e-6 * A
        slopes = np.array([np.diff(law(np.array([at - h, at + h])))[0] / (2 * h) for law in laws.items])
        fed = float(model.D[0] @ slopes)
        whole = (matrix + np.outer(model.B @ slopes, model.C[0]) / (1.0 - fed)) @ whole
    return bool(np.max(np.abs(np.linalg.eigvals(whole))) < 1.0)
