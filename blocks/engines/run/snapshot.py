"""Everything that changes during a run, as one frozen value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ...compile.plan import Plan
from ...text.arrays import Array, frozen
from .history import Past

CARRIED_NUMBERS = 5
"""With so many single numbers begins what a stiff method keeps; the polynomial, slopes and pivots follow."""


def told_method(method: str, stiff_from: float) -> str:
    """A method in words: of auto, what it has decided so far."""
    if method != "auto":
        return method
    return "auto: dopri5" if math.isnan(stiff_from) else f"auto: radau from {stiff_from:.6g} s on"


@dataclass(frozen=True, slots=True)
class MethodMemory:
    """What a method keeps from step to step: the proposed step (0: none yet), the last error, the rates at t.

    carried: of a stiff method, all else (`Carried.row` of reference/stiff.py, in the native engine followed by its
    pivots); it counts while there are rates at t. stiffness: of auto, how many steps say that the run is stiff, how
    many since then that it is not, and since when it is (NaN: it is not).
    """

    h: float = 0.0
    error: float = 1e-4
    first: Array | None = None
    carried: Array | None = None
    stiffness: tuple[float, float, float] = (0.0, 0.0, math.nan)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A run at time t. It is replaced, never changed.

    exact: t as a fraction, where t is a tick, a stop or a grid point. x: states. d: discretes and held outputs.
    s: latched sides (0 or 1). ticks: the number of the next tick of each rate. events: the next time of each event.
    own: the time at which each event fired last (it may differ from that of its instant by some ulp). fixed: the number
    of the next point of the fixed-step grid. past: what histories remember (None without them). z: the last
    solutions of algebraic loops.
    """

    t: float
    exact: Fraction | None
    x: Array
    d: tuple[float, ...]
    s: tuple[float, ...]
    ticks: tuple[int, ...]
    events: tuple[float, ...]
    own: tuple[float, ...]
    memory: MethodMemory
    fixed: int = 1
    past: Past | None = None
    z: tuple[float, ...] = ()

    def delayed(self, t: float) -> tuple[float, ...]:
        """What the histories give at t."""
        return () if self.past is None else self.past.values(t)

    def rows(self) -> dict[str, Array]:
        """Return the same as rows of a saved state; `exact` is apart."""
        memory = self.memory
        kept = {"first": memory.first, "carried": memory.carried}
        return {
            "t": np.array(self.t),
            "x": self.x,
            "d": np.array(self.d),
            "s": np.array(self.s),
            "z": np.array(self.z),
            "ticks": np.array(self.ticks, dtype=np.int64),
            "events": np.array(self.events),
            "own": np.array(self.own),
            "step": np.array(memory.h),
            "error": np.array(memory.error),
            **{name: row for name, row in kept.items() if row is not None},
            "stiffness": np.array(memory.stiffness),
            "fixed": np.array(self.fixed, dtype=np.int64),
            **({} if self.past is None else self.past.rows()),
        }

    @classmethod
    def of_rows(cls, rows: Mapping[str, Array], exact: Fraction | None, plan: Plan) -> Snapshot:
        """Return the snapshot of rows that `rows` gave."""
        hits, calm, since = rows["stiffness"].tolist()
        first, carried = (frozen(rows[name].copy()) if name in rows else None for name in ("first", "carried"))
        memory = MethodMemory(float(rows["step"]), float(rows["error"]), first, carried, (hits, calm, since))
        d, s, z, ticks, events, own = (
            tuple(rows[name].tolist()) for name in ("d", "s", "z", "ticks", "events", "own")
        )
        past = Past.of_rows(rows, plan) if plan.histories else None
        x = frozen(rows["x"].copy())
        return cls(float(rows["t"]), exact, x, d, s, ticks, events, own, memory, int(rows["fixed"]), past, z)
