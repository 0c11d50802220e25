"""What is seen inside an accepted step: parts of it that are short enough for it (`engines.run.step_parts`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ...compile.motion import Motions, looked_at
from ...compile.plan import Plan, Reference
from ...text.arrays import Array
from ...text.errors import Fault
from ..run.history import NODES
from ..run.snapshot import Snapshot
from ..run.step_parts import CHECKS, Look, Part, unseen_faults
from ..run.step_polynomial import NODES as LOBATTO
from ..run.step_polynomial import Interpolant
from .python_code import CompiledPrograms, Evaluator


class InsideStep:
    """How the signals of a run are looked at inside its steps.

    at: memory, as programs read it, at another time and other states of the step.
    """

    def __init__(
        self,
        plan: Plan,
        compiled: CompiledPrograms,
        measured: list[Reference],
        logged: list[Reference],
        at: Callable[[float, Array], tuple[object, ...]],
    ) -> None:
        self.plan, self.compiled, self.at = plan, compiled, at
        self.looked_at = looked_at(plan, measured, logged)
        self.motions = Motions(plan)
        self.looks: dict[str, tuple[Look, Evaluator]] = {}

    def look(self, name: str) -> tuple[Look, Evaluator]:
        """How signals are looked at, and the program of their phases."""
        if name not in self.looks:
            settings = self.plan.settings
            motion, rtol = self.motions.of(self.looked_at[name]), settings.rtol
            tolerance: dict[str, Any] = {"atol": settings.atol, "rtol": rtol}
            count = motion.checks(name)
            if name == "crossings":
                look = Look(motion, NODES, CHECKS[:count], spans=1e-3, ignores_far=True, **tolerance)
            elif name == "measured":
                look = Look(motion, LOBATTO, CHECKS[2 : 2 + count], spans=10 * rtol, **tolerance)
            elif name == "remembered":
                look = Look(motion, NODES, CHECKS[:count], sizes=0.1, all_bent=True, **tolerance)
            else:
                look = Look(motion, None, most=0.125 if name == "logged" else 0.25)
            self.looks[name] = look, self.compiled.program(f"{name}_phases", motion.phases)
        return self.looks[name]

    def parts(
        self,
        name: str,
        now: Snapshot,
        dense: Interpolant,
        t0: float,
        t1: float,
        values: Callable[[float, Array], object],
        *,
        x1: Array | None = None,
        first: Array | None = None,
    ) -> Iterator[Part]:
        """The parts of a piece of the step that begins now. x1: the states at its end, where it is that of the step."""
        look, program = self.look(name)
        h = t1 - t0

        def at(theta: float) -> tuple[float, Array]:
            t = t0 if theta == 0.0 else t1 if theta == 1.0 else t0 + theta * h
            if t == now.t:
                return t, now.x
            if theta == 1.0 and x1 is not None:
                return t, x1
            return t, dense(np.array([((t0 - dense.t0) + theta * h) / dense.h]))[0]

        def phases(theta: float) -> tuple[float, ...]:
            t, x = at(theta)
            return (*program(*self.at(t, x)), *look.past_turns(now.past, t))

        return look.parts(t0, t1, lambda theta: values(*at(theta)), phases, first)

    def unseen(self) -> tuple[Fault, ...]:
        """What was not seen (W304)."""
        by_look = {name: look.unseen for name, (look, _) in self.looks.items()}
        if all(math.isnan(unseen.t) for unseen in by_look.values()):
            return ()
        return unseen_faults(self.plan, {name: look.motion for name, (look, _) in self.looks.items()}, by_look)


def in_time(parts: Iterable[Part], t0: float, t1: float) -> Iterator[tuple[float, float, Array]]:
    """Parts by their times: begin, end, and the values at the nodes."""
    begin = t0
    for part in parts:
        end = t1 if part.end == 1.0 else t0 + part.end * (t1 - t0)
        yield begin, end, part.table
        begin = end
