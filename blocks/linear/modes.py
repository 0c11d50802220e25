"""Modes of a diagram whose laws have the gains of an amplitude, and how they move with the amplitude.

    x' = A x + B n,   s = C x + D n,   n = N(s) s         (x' = dx/dt, or the next x)

For an oscillation s of some size each law has a gain, so that the diagram is linear, with modes. A mode with the shape
of that oscillation persists, apart from its growth; where the growth passes 0, the oscillation sustains itself.

Reference: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, McGraw-Hill
1968, chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..text.arrays import Array
from .transfer import Transfer

Gains = Callable[[Array], Array]
"""Of the phasors of the signals, a matrix N with n = N s. Raises Resting."""
_ROUNDS = 15
_SHAPED = 1e-6
"""How closely a mode must have the shape that its gains belong to."""
_OFTEN = 4
"""After how many amplitudes new modes are looked for."""
_TRIES = 100
_SEEN = 1e-9
"""The least share of the first signal in a mode that is followed."""


class Resting(Exception):
    """An amplitude is too small for a law with memory to respond: it passes on no oscillation."""


@dataclass(frozen=True)
class Mode:
    """A mode: its pole (s, or z), its growth in 1/s and its frequency in rad/s, and the phasors of the signals."""

    pole: complex
    growth: float
    omega: float
    s: Array


@dataclass(frozen=True)
class LinearRest:
    """The rest of a diagram, from what some laws give to what they read."""

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float

    @classmethod
    def of(cls, model: Transfer, laws: Sequence[int], slots: Sequence[int]) -> LinearRest:
        """Some columns and rows of a model."""
        A, B, C, D = (np.asarray(m, dtype=float) for m in (model.A, model.B, model.C, model.D))
        return cls(A, B[:, laws], C[slots], D[np.ix_(slots, laws)], float(model.dt or 0.0))

    def closed(self, N: Array) -> tuple[Array, Array]:
        """A and C with gains in the place of the laws."""
        inverse = np.linalg.inv(np.eye(len(self.C)) - self.D @ N)
        return self.A + self.B @ N @ inverse @ self.C, inverse @ self.C

    def modes(self, N: Array) -> list[Mode]:
        A, C = self.closed(N)
        poles, shapes = np.linalg.eig(A)
        return [self.mode(pole, C @ shapes[:, k]) for k, pole in enumerate(poles.tolist())]

    def mode(self, pole: complex, s: Array) -> Mode:
        if not self.dt:
            return Mode(pole, pole.real, pole.imag, s)
        with np.errstate(divide="ignore"):
            return Mode(pole, float(np.log(abs(pole))) / self.dt, float(np.angle(pole)) / self.dt, s)


@dataclass(frozen=True)
class GrowthZero:
    """Where the growth of a mode passes 0: between two amplitudes, the mode at each; is_down: it falls."""

    before: Mode
    after: Mode
    amplitudes: tuple[float, float]

    @property
    def is_down(self) -> bool:
        return self.before.growth > 0


def groups(model: Transfer, spans: Sequence[Sequence[int]]) -> list[tuple[list[int], list[int]]]:
    """Laws that act on each other by loops, with the signals that they read: their numbers."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    A, B, C, D = (np.asarray(m) != 0 for m in (model.A, model.B, model.C, model.D))
    n, p, m = len(A), B.shape[1], len(C)
    whole = np.zeros((n + p + m,) * 2, dtype=bool)  # whole[i, j]: j acts on i; states, laws, signals
    whole[:n, :n], whole[:n, n : n + p], whole[n + p :, :n], whole[n + p :, n : n + p] = A, B, C, D
    for law, span in enumerate(spans):
        whole[n + law, [n + p + slot for slot in span]] = True
    _, label = connected_components(csr_array(whole), directed=True, connection="strong")
    loops = []
    for own in dict.fromkeys(label[n : n + p].tolist()):
        laws = [k for k in range(p) if label[n + k] == own]
        slots = [k for k in range(m) if label[n + p + k] == own]
        if slots:
            loops.append((laws, slots))
    return loops


def crossings(loop: LinearRest, gains: Gains, grid: Array, is_wanted: Callable[[Mode], bool]) -> Iterator[GrowthZero]:
    """All crossings of the modes that are wanted, over a grid of amplitudes of the first signal."""
    followed: list[Mode] = []
    last = float(grid[0])
    for k, amplitude in enumerate(grid.tolist()):
        now: list[Mode] = []
        for mode in followed:
            next_mode = _shaped(loop, gains, mode.s * (amplitude / last), mode.pole, amplitude)
            if next_mode is None or not is_wanted(next_mode) or any(_same(next_mode, other) for other in now):
                continue
            now.append(next_mode)
            if mode.growth * next_mode.growth < 0:
                yield GrowthZero(mode, next_mode, (last, amplitude))
        if k % _OFTEN == 0 or not now or len(now) < len(followed):
            now += _further(loop, gains, now, amplitude, is_wanted)
        followed, last = now, amplitude


def _further(
    loop: LinearRest, gains: Gains, known: Sequence[Mode], amplitude: float, is_wanted: Callable[[Mode], bool]
) -> list[Mode]:
    """Modes at an amplitude beside those that are known."""
    begin = known[0].s if known else np.full(len(loop.C), amplitude, dtype=complex)
    try:
        seeds = loop.modes(gains(begin))
    except Resting:
        return []
    modes: list[Mode] = []
    for seed in seeds:
        if not is_wanted(seed) or any(_same(seed, other) for other in (*known, *modes)):
            continue
        if not abs(seed.s[0]) > _SEEN * np.max(np.abs(seed.s)):
            continue
        mode = _shaped(loop, gains, seed.s * (amplitude / seed.s[0]), seed.pole, amplitude)
        if mode is not None and is_wanted(mode) and not any(_same(mode, other) for other in (*known, *modes)):
            modes.append(mode)
    return modes


def _same(mode: Mode, other: Mode) -> bool:
    return abs(mode.pole - other.pole) < 1e-6 * abs(mode.pole)


def _shaped(loop: LinearRest, gains: Gains, s: Array, pole: complex, amplitude: float) -> Mode | None:
    """A mode near a pole that has the shape that its gains belong to; None where none is found."""
    step, change = 1.0, np.inf
    try:
        for _ in range(_ROUNDS):
            mode = min(loop.modes(gains(s)), key=lambda mode: abs(mode.pole - pole))
            if not abs(mode.s[0]) > _SEEN * np.max(np.abs(mode.s)):
                return None
            moved, pole = mode.s * (amplitude / mode.s[0]), mode.pole
            now = float(np.max(np.abs(moved - s)) / np.max(np.abs(moved)))
            if now < _SHAPED:
                return loop.mode(pole, moved)
            if now > 0.9 * change:
                step = max(0.5 * step, 0.1)
            s, change = s + step * (moved - s), now
        return _by_newton(loop, gains, s * (amplitude / s[0]), pole)
    except (Resting, np.linalg.LinAlgError):
        return None


def _by_newton(loop: LinearRest, gains: Gains, begin: Array, pole: complex) -> Mode | None:
    """The mode near a pole and a shape, by Newton's method on s = G(pole) N(s) s."""
    from scipy.optimize import root

    first, size, scale, m = begin[0], np.fmax(np.abs(begin[1:]), _SEEN * abs(begin[0])), abs(pole), len(begin)
    identity = np.eye(len(loop.A))

    def unpacked(v: Array) -> tuple[Array, complex]:
        return np.array([first, *((v[2 : m + 1] + 1j * v[m + 1 :]) * size)]), complex(v[0], v[1]) * scale

    def residual(v: Array) -> Array:
        s, at = unpacked(v)
        n = gains(s) @ s
        gap = (s - loop.C @ np.linalg.solve(at * identity - loop.A, loop.B @ n) - loop.D @ n) / np.array(
            [abs(first), *size]
        )
        return np.concatenate([gap.real, gap.imag])

    others = begin[1:] / size
    solution = root(
        residual,
        [pole.real / scale, pole.imag / scale, *others.real, *others.imag],
        method="hybr",
        options={"maxfev": _TRIES},
    )
    if not np.max(np.abs(solution.fun)) < 1e-6:
        return None
    s, at = unpacked(solution.x)
    return loop.mode(at, s)
