"""Linear models with exact delays, which have responses but no finite state space.

jw x = A x + E h + B u,   h = exp(-jw delays) (Fx x + Fh h + Fe u),   y = C x + G h + D u
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["DelayedModel"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class DelayedModel:
    """A model by its frequency response: `margins`, `bandwidth`, `peak` and the figures take it, as `response` does.

    matrices: by row and column, "x" (rates, states), "h" (what is delayed, delayed values), "y", "e" (inputs). delays:
    in s, of each h. signals: the names of the inputs and of the outputs in the diagram; units: theirs in SI.
    """

    matrices: Mapping[tuple[str, str], Array]
    delays: tuple[float, ...]
    signals: tuple[tuple[str, ...], tuple[str, ...]]
    units: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    dt: float = 0.0

    def response(self, omega: Any) -> Array:
        """(outputs, inputs, frequencies) at omega in rad/s."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        m, delays = self.matrices, np.array(self.delays)
        n, count = len(m["x", "x"]), len(delays)
        seen, direct = np.hstack([m["y", "x"], m["y", "h"]]), m["y", "e"]
        response = np.empty((*direct.shape, len(omega)), dtype=complex)
        for k, w in enumerate(omega.tolist()):
            lag = np.exp(-1j * w * delays)[:, None]
            whole = np.block(
                [
                    [1j * w * np.eye(n) - m["x", "x"], -m["x", "h"]],
                    [-lag * m["h", "x"], np.eye(count) - lag * m["h", "h"]],
                ]
            )
            right = np.vstack([m["x", "e"].astype(complex), lag * m["h", "e"]])
            try:
                response[:, :, k] = seen @ np.linalg.solve(whole, right) + direct
            except np.linalg.LinAlgError:  # a pole on the axis, as that of an integrator at 0
                response[:, :, k] = np.inf
        return response

    def scaled(self, factor: float) -> DelayedModel:
        """All outputs times a factor."""
        matrices = {key: factor * value if key[0] == "y" else value for key, value in self.matrices.items()}
        return DelayedModel(matrices, self.delays, self.signals, self.units, self.dt)

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
