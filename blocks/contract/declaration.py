"""All that a block class says, put in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .equations import Crossing, EventTime, Local, Output, Requirement, Stepper
from .variables import (
    Algebraic,
    Clock,
    Discrete,
    Equation,
    Given,
    History,
    Input,
    Parameter,
    State,
    Stepped,
    Variable,
)

DESCRIBING = {
    "relay": ("on_at", "off_at", "on", "off"),
    "quantizer": ("interval",),
    "backlash": ("width",),
}
"""The describing functions of blocks that remember their input, with the parameters that each is computed from."""
APART = {
    "gain": ("K", "unit", "unit_u", "u"),
    "gains": ("K", "size", "unit", "unit_u", "u", "index"),
    "reduction": ("kind", "size", "unit", "u"),
    "norm": ("kind", "size", "unit", "u"),
    "dot": ("size", "unit", "u1", "u2"),
}
"""The ways to take blocks over long vectors apart (`model.parts`), with the parameters and inputs that each needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Declaration:
    """All that a block class says, checked, each by its name in the order of the body."""

    name: str
    doc: str
    parameters: Mapping[str, Parameter]
    inputs: Mapping[str, Input]
    states: Mapping[str, State]
    discretes: Mapping[str, Discrete]
    algebraics: Mapping[str, Algebraic]
    histories: Mapping[str, History]
    outputs: Mapping[str, Output]
    stepped: Mapping[str, Stepped]
    stepper: Stepper | None
    locals: Mapping[str, Local]
    crossings: Mapping[str, Crossing]
    event_times: Mapping[str, EventTime]
    equations: tuple[Equation, ...]
    requirements: tuple[Requirement, ...]
    sizes: tuple[str, ...]
    given: Mapping[str, Given]
    foreign: Any = None
    """What stands behind the class where that is an FMU: a `blocks.model.fmu_block.Foreign`."""
    streams: tuple[str, ...] = ()
    """The parameters that hold the number of the block's stream of random numbers."""
    describing: str = ""
    """Which describing function y has of u (`DESCRIBING`), where the block remembers u; "": as its equations say."""
    apart: str = ""
    """The way in which a block over a long vector is taken apart (`APART`); "": it never is."""
    form: Callable[[Mapping[str, Any]], Any] | None = None
    """Gives the class that blocks with given values have, where it follows from them; None where it is this one."""

    @property
    def settable(self) -> Mapping[str, Parameter]:
        """The parameters that a block can be given."""
        if not self.streams:
            return self.parameters
        return {name: parameter for name, parameter in self.parameters.items() if not parameter.stream}

    @property
    def readable(self) -> dict[str, Variable]:
        """What equations may read, besides t, tick and sizes."""
        return {
            **self.parameters,
            **self.inputs,
            **self.states,
            **self.discretes,
            **self.algebraics,
            **self.histories,
            **self.outputs,
            **self.stepped,
            **self.given,
            **self.locals,
            **self.crossings,
        }

    def is_of_ticks(self, local: str) -> bool:
        """Whether a local is read by sampled equations only, maybe through other locals."""
        waiting, seen = [local], {local}
        while waiting:
            name = waiting.pop()
            readers = [equation for equation in self.equations if name in equation.reads]
            if not readers:
                return False
            for reader in readers:
                if {role.kind for role in reader.roles} == {"local"}:
                    if reader.name not in seen:
                        seen.add(reader.name)
                        waiting.append(reader.name)
                elif not all(role.ticks for role in reader.roles):
                    return False
        return True

    def clock_of(self, discrete: str) -> Clock | None:
        """The clock of a ticked discrete."""
        for equation in self.equations:
            for role in equation.roles:
                if role.kind == "next" and role.ticks and role.target is not None and role.target.name == discrete:
                    return role.clock
        return None
