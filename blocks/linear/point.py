"""Where a diagram stands: the memory of a Plan at one time, with the values of all outputs.

    point = Point.of(simulation)          # of a run of the reference engine, as it stands
    point.moved(x=..., u=...)             # elsewhere, with the sides and the loops that belong there

All numbers are in SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..plan import Plan, Reference
from ..run.simulation import Simulation

__all__ = ["Point"]

Array = np.ndarray[Any, Any]
_PASSES = 20


@dataclass(frozen=True, eq=False)
class Point:
    """Memory as programs read it: (t, x, d, s, p, u, k, h, z, FMUs), and the values of w.

    simulation: a run of the reference engine of the same plan, which owns the programs and the FMUs.
    """

    plan: Plan
    memory: tuple[Any, ...]
    outputs: tuple[float, ...]
    simulation: Simulation

    @classmethod
    def of(cls, simulation: Simulation) -> Point:
        """A run as it stands, after all that happens at its time."""
        simulation.value(())
        u = simulation.segment.at(simulation.now.t)
        memory = simulation.instants.memory(simulation.now, u)
        return cls(simulation.plan, memory, _outputs(simulation, memory), simulation)

    @property
    def t(self) -> float:
        """The time in s."""
        return float(self.memory[0])

    @property
    def foreign(self) -> Any:
        """The FMUs, in the order of the Plan."""
        return self.memory[9]

    def values(self, references: Sequence[Reference]) -> tuple[float, ...]:
        """The values of places of memory, those of w included."""
        rows = dict(zip(("x", "d", "s", "p", "u"), self.memory[1:6], strict=True)) | {"h": self.memory[7]}
        made = []
        for row, index in references:
            if row == "k":
                made.append(float(index))
            elif row in ("t", "tick"):
                made.append(float(self.memory[0] if row == "t" else self.memory[6][index]))
            else:
                made.append(float(self.outputs[index] if row == "w" else rows[row][index]))
        return tuple(made)

    def moved(
        self,
        *,
        x: Sequence[float] | None = None,
        d: Sequence[float] | None = None,
        u: Sequence[float] | None = None,
        p: Sequence[float] | None = None,
        is_steady: bool = False,
    ) -> Point:
        """Elsewhere, at the same time: sides as the crossings have them there, loops solved.

        is_steady: delayed values are those that are there now, as after a long rest.
        """
        t, x0, d0, s, p0, u0, k, h, z, f = self.memory
        x, d, u, p = (new if new is not None else old for new, old in ((x, x0), (d, d0), (u, u0), (p, p0)))
        sides, simulation = tuple(s), self.simulation
        plan = self.plan
        rest = (k, tuple(h), z, f)
        outputs: tuple[float, ...] = ()
        with np.errstate(all="ignore"):
            for _ in range(_PASSES):
                memory = (t, list(x), tuple(d), sides, tuple(p), tuple(u), *rest)
                if plan.unknowns:
                    solved = simulation.instants.solutions(*memory)
                    memory = (*memory[:8], solved, f)
                outputs = _outputs(simulation, memory)
                made = replace(self, memory=memory, outputs=outputs)
                values = simulation.instants.sides(*memory) if plan.crossings else ()
                now = tuple(float(value >= 0) for value in values)
                delayed = made.values([history.source for history in plan.histories]) if is_steady else tuple(h)
                if now == sides and delayed == rest[1]:
                    break
                sides, rest = now, (k, delayed, memory[8], f)
        return made


def _outputs(simulation: Simulation, memory: tuple[Any, ...]) -> tuple[float, ...]:
    asked = tuple(("w", i) for i in range(len(simulation.plan.outputs)))
    if asked not in simulation.asked:
        simulation.asked[asked] = simulation.compiled.program("all_outputs", asked)
    return simulation.asked[asked](*memory)
