"""Where a diagram stands: the memory of a Plan at one time, with the values of all outputs.

    point = Point.of(engine)          # of a run of the reference engine, as it stands
    point.moved(x=..., u=...)             # elsewhere, with the sides and the loops that belong there

All numbers are in SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compile.plan import Plan, Reference

if TYPE_CHECKING:
    from ..engines.reference.reference_engine import ReferenceEngine

_PASSES = 20


@dataclass(frozen=True, eq=False)
class Point:
    """Memory as programs read it: (t, x, d, s, p, u, k, h, z, FMUs), and the values of w.

    engine: a run of the reference engine of the same plan, which owns the programs and the FMUs. slopes: what
    `slopes_at` has computed here, kept as long as the point is.
    """

    plan: Plan
    memory: tuple[Any, ...]
    outputs: tuple[float, ...]
    engine: ReferenceEngine
    slopes: list[Any] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def of(cls, engine: ReferenceEngine) -> Point:
        """A run as it stands, where all that happens at its time has happened."""
        u = engine.segment.at(engine.now.t)
        memory = engine.instants.memory(engine.now, u)
        return cls(engine.plan, memory, _outputs(engine, memory), engine)

    def at_start(self, parameters: Sequence[float]) -> Point:
        """The point at the start of a run with another row p, where this one is at a start; there are no FMUs."""
        from ..engines.reference.reference_engine import ReferenceEngine

        given = self.engine
        plan = replace(self.plan, parameters=tuple(parameters))
        engine = ReferenceEngine(plan, given.inputs, compiled=given.compiled, is_silent=True)
        engine.start()
        return Point.of(engine)

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
        values = []
        for row, index in references:
            if row == "k":
                values.append(float(index))
            elif row in ("t", "tick"):
                values.append(float(self.memory[0] if row == "t" else self.memory[6][index]))
            else:
                values.append(float(self.outputs[index] if row == "w" else rows[row][index]))
        return tuple(values)

    @cached_property
    def rates(self) -> tuple[float, ...]:
        """dx/dt here; 0 where a subdiagram is off."""
        plan, program = self.plan, self.engine.compiled.program("rates_of_point", self.plan.derivatives)
        sides = [plan.instances[node.instance].condition for node in plan.derivatives]
        with np.errstate(all="ignore"):
            rates = program(*self.memory)
        return tuple(
            0.0 if side is not None and not self.memory[3][side] else rate
            for side, rate in zip(sides, rates, strict=True)
        )

    def moved(self, **rows: Sequence[float]) -> Point:
        """Another point at the same time, as after a jump there: sides as the crossings have them, loops solved.

        rows: x, d, u, p and h, where they are others.

        Discretes that crossings reset on the way are reset (the index of a table), and so are those that each step
        replaces (what a backlash holds); states stay.
        """
        t, x, d, s, p, u, k, h, z, f = self.memory
        x, d, p, u, h = (rows.pop(name, old) for name, old in zip("xdpuh", (x, d, p, u, h), strict=True))
        assert not rows, f"no rows of memory: {rows}"
        sides, held = tuple(s), tuple(d)
        engine, plan = self.engine, self.plan
        with np.errstate(all="ignore"):
            for _ in range(_PASSES):
                memory = (t, list(x), held, sides, tuple(p), tuple(u), k, tuple(h), z, f)
                if plan.unknowns:
                    z = engine.instants.solutions(*memory)
                    memory = (*memory[:8], z, f)
                values = engine.instants.sides(*memory) if plan.crossings else ()
                now = tuple(float(value >= 0) for value in values)
                after = self._replaced(memory, now)
                if now == sides and after == held:
                    break
                sides, held = now, after
        return replace(self, memory=memory, outputs=_outputs(engine, memory))

    def _replaced(self, memory: tuple[Any, ...], now: tuple[float, ...]) -> tuple[float, ...]:
        """The discretes after the crossings between the old sides and those now, else after what a step replaces."""
        plan, instants, discretes = self.plan, self.engine.instants, list(memory[2])
        ticked = {slot for rate in plan.rates for _, slot in (*rate.outputs, *rate.nexts)}
        for j, (cause, old, new) in enumerate(zip(plan.crossings, memory[3], now, strict=True)):
            reset = instants.resets[j]
            if old != new and reset is not None and cause.direction in ("both", "up" if new else "down"):
                for (_, (row, place)), value in zip(cause.resets, reset(*memory), strict=True):
                    if row == "d" and place not in ticked:
                        discretes[place] = float(value)
        if plan.projections and tuple(discretes) == memory[2]:
            for (node, (row, place)), value in zip(plan.projections, instants.projections(*memory), strict=True):
                side = plan.instances[node.instance].condition
                if row == "d" and (side is None or now[side]):
                    discretes[place] = float(value)
        return tuple(discretes)


def _outputs(engine: ReferenceEngine, memory: tuple[object, ...]) -> tuple[float, ...]:
    asked = tuple(Reference("w", i) for i in range(len(engine.plan.outputs)))
    if asked not in engine.asked:
        engine.asked[asked] = engine.compiled.program("all_outputs", asked)
    return engine.asked[asked](*memory)
