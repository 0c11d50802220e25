"""Linear models with exact delays, which have responses but no finite state space.

jw x = A x + E h + B u,   h = exp(-jw delays) (Fx x + Fh h + Fe u),   y = C x + G h + D u
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..text.arrays import Array
from .realization import Realization, balanced

_CHUNK = 1 << 22  # entries of the matrices that are solved at once


@dataclass(frozen=True, slots=True)
class Rational:
    """A continuous state space by its matrices, as the analyses take it."""

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float = 0.0

    @property
    def nstates(self) -> int:
        return len(self.A)

    @property
    def ninputs(self) -> int:
        return int(self.D.shape[1])


@dataclass(frozen=True)
class DelayedModel:
    """A model by its frequency response: `margins`, `bandwidth`, `peak` and the figures take it, as `response` does.

    matrices: by row and column, "x" (rates, states), "h" (what is delayed, delayed values), "y", "e" (inputs). delays:
    in s, of each h. signals: the names of the inputs and of the outputs in the diagram; units: theirs in SI. name,
    report, hint: as of a `LinearModel`.
    """

    matrices: Mapping[tuple[str, str], Array]
    delays: tuple[float, ...]
    signals: tuple[tuple[str, ...], tuple[str, ...]]
    units: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    dt: float = 0.0
    name: str = ""
    report: tuple[Any, ...] = ()
    hint: str = ""

    def response(self, omega: object) -> Array:
        """(outputs, inputs, frequencies) at omega in rad/s."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        if self.dead_time is not None:
            rational, delay = self.dead_time
            made = rational.at(1j * omega)
            with np.errstate(invalid="ignore"):  # of an integrator, which is infinite at 0
                return np.where(omega == 0, made, made * np.exp(-1j * delay * omega))
        m = self.matrices
        response = np.empty((*m["y", "e"].shape, len(omega)), dtype=complex)
        step = max(1, _CHUNK // (len(m["x", "x"]) + len(self.delays)) ** 2)
        for k in range(0, len(omega), step):
            response[:, :, k : k + step] = self._solved(omega[k : k + step])
        return response

    def _solved(self, omega: Array) -> Array:
        m, lag = self.matrices, np.exp(-1j * np.outer(omega, self.delays))[:, :, None]
        n = len(m["x", "x"])
        whole = np.empty((len(omega), n + len(self.delays), n + len(self.delays)), dtype=complex)
        whole[:, :n, :n] = 1j * omega[:, None, None] * np.eye(n) - m["x", "x"]
        whole[:, :n, n:] = -m["x", "h"]
        whole[:, n:, :n] = -lag * m["h", "x"]
        whole[:, n:, n:] = np.eye(len(self.delays)) - lag * m["h", "h"]
        right = np.empty((len(omega), whole.shape[1], m["y", "e"].shape[1]), dtype=complex)
        right[:, :n], right[:, n:] = m["x", "e"], lag * m["h", "e"]
        seen = np.hstack([m["y", "x"], m["y", "h"]])
        try:
            return np.moveaxis(seen @ np.linalg.solve(whole, right), 0, 2) + m["y", "e"][:, :, None]
        except np.linalg.LinAlgError:  # a pole on the axis, as that of an integrator at 0
            if len(omega) == 1:
                return np.full((*m["y", "e"].shape, 1), np.inf, dtype=complex)
            return np.concatenate([self._solved(omega[k : k + 1]) for k in range(len(omega))], axis=2)

    @property
    def rational(self) -> Rational:
        """The model without its delays."""
        return Rational(*self.at_rest)

    @cached_property
    def dead_time(self) -> tuple[Realization, float] | None:
        """(R, T) where the model is R(s) exp(-s T), of one input and one output; else None.

        All paths from the input to the output have the same delays together.
        """
        m = self.matrices
        if m["y", "e"].shape != (1, 1):
            return None
        n, count = len(m["x", "x"]), len(self.delays)
        # Nodes: states, delayed values, the input, the output. links[i, j]: j acts on i.
        links = np.zeros((n + count + 2,) * 2, dtype=bool)
        rows, columns = {"x": slice(0, n), "h": slice(n, n + count)}, {"x": slice(0, n), "h": slice(n, n + count)}
        rows["y"], columns["e"] = slice(n + count + 1, n + count + 2), slice(n + count, n + count + 1)
        for (row, column), matrix in m.items():
            links[rows[row], columns[column]] = matrix != 0
        lag = np.concatenate([np.zeros(n), self.delays, np.zeros(2)])
        late = {n + count: 0.0}  # how late each node sees the input
        waiting = [n + count]
        while waiting:
            j = waiting.pop()
            for i in np.flatnonzero(links[:, j]).tolist():
                at = late[j] + float(lag[i])
                if i not in late:
                    late[i] = at
                    waiting.append(i)
                elif abs(late[i] - at) > 1e-13 * max(late[i], at):
                    return None
        if not late.get(n + count + 1):
            return None
        return balanced(self.rational), late[n + count + 1]

    def scaled(self, factor: float) -> DelayedModel:
        """All outputs times a factor."""
        matrices = {key: factor * value if key[0] == "y" else value for key, value in self.matrices.items()}
        return replace(self, matrices=matrices)

    @property
    def speeds(self) -> Array:
        """How fast it is, in rad/s: the sizes of the poles without delays, and those of the delays."""
        return np.concatenate([np.abs(np.linalg.eigvals(self.matrices["x", "x"])), 1.0 / np.array(self.delays)])

    @property
    def at_rest(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D with 0 = A x + B u, y = C x + D u where nothing moves."""
        m = self.matrices
        K = np.linalg.inv(np.eye(len(self.delays)) - m["h", "h"])
        x, e = K @ m["h", "x"], K @ m["h", "e"]
        return (
            m["x", "x"] + m["x", "h"] @ x, m["x", "e"] + m["x", "h"] @ e,
            m["y", "x"] + m["y", "h"] @ x, m["y", "e"] + m["y", "h"] @ e,
        )  # fmt: skip
