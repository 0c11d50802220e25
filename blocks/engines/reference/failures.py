"""Failures of a run in words: which value broke first, in the order of computation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...compile.plan import Plan, Reference
from ...compile.scheduler import schedule
from ...text.arrays import Array
from ...text.errors import NOT_FINITE, OVERFLOW, Fault, SimulationError
from .event_update import Instants
from .methods import Trial
from .python_code import CompiledPrograms

Memory = tuple[Any, ...]
"""(t, x, d, s, p, u, k, h, z, FMUs), as programs read it."""


@dataclass(frozen=True)
class Failures:
    """The errors of one Plan; `plan`, `compiled` and `instants` as a run has them, at: memory at other times."""

    plan: Plan
    compiled: CompiledPrograms
    instants: Instants
    at: Callable[[float, Array], Memory]

    def not_finite(self, memory: Memory, verb: str, cure: str = "") -> SimulationError:
        """E303: the first value that is not finite."""
        for reference, value in zip(self.plan.unknowns, self.instants.solutions(*memory), strict=True):
            if not math.isfinite(value):
                return self.instants.unsolved(reference, memory)
        name, what, value, more = self._culprit(memory) or (self.plan.name, "a value ", math.nan, NOT_FINITE)
        message = f"{what}{verb} {value} at t = {memory[0]} s."
        return SimulationError(Fault("E303", name, message, f"{cure} {more}".lstrip()))

    def _culprit(self, memory: Memory) -> tuple[str, str, float, str] | None:
        """The first value that is not finite, in the order of computation: its name, its kind, it, and the cure."""
        plan = self.plan
        for names, values in ((plan.states, memory[1]), (plan.discretes, memory[2])):
            for name, value in zip(names, values, strict=True):
                if not math.isfinite(value):
                    return name, "", value, OVERFLOW
        program = schedule(plan, [*(Reference("w", i) for i in range(len(plan.outputs))), *plan.derivatives])
        nodes = [node for step in program.order for node in step.nodes]
        for node, value in zip(nodes, self.compiled.program("everything", nodes)(*memory), strict=True):
            if not math.isfinite(value):
                what = "its derivative " if node.key.startswith("derivative") else ""
                return plan.node_name(node), what, value, self.compiled.cure([node], memory)
        return None

    def blown_up(self, made: Trial, cure: str) -> SimulationError:
        """E303: the first value that is not finite in the stages of a step."""
        x, t1 = made.x0, made.t0 + made.h
        for i, c in enumerate(made.tableau.c):
            t = made.t0 + c * made.h
            if i > 0:
                x = made.x0 + made.h * (made.tableau.a[i - 1] @ made.k[:i])
            if not np.isfinite(x).all():
                break
            if not np.isfinite(made.k[i]).all():
                memory = self.at(t, x)
                if self.plan.unknowns or self._culprit(memory) is not None:
                    return self.not_finite(memory, "became", cure)
                x = made.k[i]  # the sum of the stage overflowed, but not in the order of terms that it has here
                break
        bad = int(np.nonzero(~np.isfinite(x))[0][0])
        message = f"became {x[bad]} at t = {t1} s."
        return SimulationError(Fault("E303", self.plan.states[bad], message, f"{cure} {OVERFLOW}"))

    def too_small(self, made: Trial, weights: Array) -> SimulationError:
        """E301: a step that was shortened until it could not be any more. weights: what a state may be off by."""
        if not (np.isfinite(made.k).all() and np.isfinite(made.x1).all()):
            return self.blown_up(made, "The step was shortened to the resolution of time.")
        worst = int(np.argmax(np.abs(made.error) / weights))
        message = f"at t = {made.t0} s the step became too small to reach rtol {self.plan.settings.rtol}."
        cure = "The model may jump or chatter here: use a crossing, radau for stiff models, or a larger tolerance."
        return SimulationError(Fault("E301", self.plan.states[worst], message, cure))

    def stiff_failed(self, t: float, x: Array, rates: Array, weights: Array, message: str) -> SimulationError:
        """E308: the stiff method failed at (t, x) with these rates."""
        worst = int(np.argmax(np.abs(rates) / weights))
        step = 16 * math.ulp(t)
        following = self.at(t + step, x + step * rates)
        if self._culprit(following) is not None:
            return self.not_finite(following, "became")
        cause = f"radau failed at t = {t} s, where this state changes fastest: {message}."
        cure = "Raise rtol and atol, or use dopri5."
        if max(abs(x[worst]), weights[worst]) < 100 * step * abs(rates[worst]):
            cure = (
                "It changes by its own size in a moment: the solution probably ends here, as if a state grows without "
                "bound or a divisor passes 0. Limit the state or the divisor, or stop the run earlier."
            )
        return SimulationError(Fault("E308", self.plan.states[worst], cause, cure))
