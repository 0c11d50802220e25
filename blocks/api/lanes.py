"""Whether rows of a batch run side by side in the lanes of vectors, as `lanes="fast"` asks for, and what is told of it.

Rows that run so agree with runs of their own within the tolerance of the run, and not bit for bit: functions as sin and
pow are those of vectors, which round otherwise. Where a diagram has what lanes do not have, its rows run as ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..compile.c.lane_code import Machine, why_no_lanes
from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..engines.selection import compiled_model
from ..model.study_grammar import LANES
from ..text.errors import CompilerError, Fault, UsageError, did_you_mean
from ..text.printable import legible


@dataclass(frozen=True, slots=True)
class Lanes:
    """machine: whose lanes they are; None: there are none. why: they were asked for, and are not there, in words."""

    machine: Machine | None = None
    why: str = ""

    @classmethod
    def asked(cls, lanes: str, plan: Plan | Coupling, engine: str | None, why_not_threads: str) -> Lanes:
        """Those of the rows of a Plan. why_not_threads: why threads do not run them. Raises UsageError (E501)."""
        if lanes not in LANES:
            cure = did_you_mean(str(lanes), LANES) or f"Choose one of: {', '.join(LANES)}."
            raise UsageError(Fault("E501", "lanes", f"{legible(repr(lanes))} is not a value of lanes.", cure))
        if lanes == "exact":
            return cls()
        why = (why_no_lanes(plan) if isinstance(plan, Plan) else "") or why_not_threads
        if why:
            return cls(None, why)
        found = cls(Machine.own())
        why = found.model(plan, engine)[1]
        return cls(None, why) if why else found

    def model(self, plan: Plan | Coupling, engine: str | None) -> tuple[Any, str]:
        """Return the compiled model of a Plan, and why it has no lanes.

        The model is None if another engine runs the Plan. The reason is "" if there are lanes, or if none are wanted.
        """
        if self.machine is None or not isinstance(plan, Plan):
            return compiled_model(plan, engine=engine), ""
        why = why_no_lanes(plan)
        if not why:
            try:
                model = compiled_model(plan, engine=engine, lanes=self.machine)
                return model, "" if model is None else model.why_no_lanes
            except CompilerError:
                why = "the compiler rejected the code for lanes"
        return compiled_model(plan, engine=engine), why

    @property
    def width(self) -> int:
        return 1 if self.machine is None else self.machine.width

    @property
    def told(self) -> str:
        """What they are, for the origin of results; "": rows are exact."""
        return "" if self.machine is None else self.machine.told

    @property
    def warnings(self) -> tuple[Fault, ...]:
        return (no_lanes("these rows", self.why),) if self.why else ()


def no_lanes(rows: str, why: str) -> Fault:
    """Return the warning that a run was to use lanes and cannot."""
    return Fault("W504", "lanes", f"cannot be used for {rows}: {why}.", "The results are those of lanes=\"exact\".")
