"""The tables of an FMU for Model Exchange for C (fmu_bridge.h), wherever they are put."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...fmi.model_description import ModelVariable
from ...fmi.types import code_of
from ...text.arrays import Array
from ..fmu_tape import FmuTape
from ..plan import ForeignPart, Plan

MOST_WATCHED = 8
"""Outputs that are looked at where a step is completed: they should be functions of time, states and inputs."""

FOREIGN_CALLS = (
    "SetTime", "SetContinuousStates", "GetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators",
    "CompletedIntegratorStep", "EnterEventMode", "UpdateDiscreteStates", "EnterContinuousTimeMode",
    "ExitInitializationMode",
)  # fmt: skip
"""The functions of a BlocksForeign besides those that move values, by their numbers in C."""
VariableRow = tuple[int, int, int, int, int]
"""Reference, type, where its elements begin, how many, and whether it is held."""


class ForeignTables:
    """The tables of one FMU, as C reads them. place: where each state of the Plan lies in C.

    sizes: fields of a BlocksForeign. used: the variables that are set or read. room: of its scratch. tuned: where
    tunable parameters lie among inputs.
    """

    def __init__(self, plan: Plan, part: ForeignPart, place: Array) -> None:
        tape, foreign = plan.instances[part.instance].tape, part.foreign
        assert isinstance(tape, FmuTape)
        opaque, fmi = tape.opaque, tape.opaque.fmi
        scales, offsets = [scale for *_, scale in opaque.inputs], list(opaque.offsets)
        inputs = [(variable, k) for k, (_, variable, element, _) in enumerate(opaque.inputs) if element == 0]
        rows: list[VariableRow] = [
            _row(variable, fmi, k, math.prod(variable.shape), held=variable.variability != "continuous")
            for variable, k in inputs
        ]
        self.used: list[ModelVariable] = [variable for variable, _ in inputs]
        tunables: list[int] = []
        for name, first, size in part.parameters:
            if name not in part.tunable:
                continue
            variable = foreign.variables[name]
            rows.append(_row(variable, fmi, len(scales), size, held=True))
            self.used.append(variable)
            scale, offset = foreign.affine(name)
            scales += [scale] * size
            offsets += [offset] * size
            tunables += range(first, first + size)
        asked = [item.variable for item in opaque.items if item.variable is not None]
        completes = foreign.interface.completed_step
        watched = [
            v
            for v in foreign.description.variables
            if v.causality == "output" and v.variability == "continuous" and v.type == "Float64" and not v.shape
        ][: MOST_WATCHED if completes and opaque.states else 0]
        self.used += [*asked, *watched]
        nx, nu = len(opaque.states), len(scales)
        self.room = (
            nx + nu + opaque.indicators + sum(math.prod(v.shape) for v in {id(v): v for v in asked}.values()) + 8
        )
        self.factors, self.origins = (
            np.array([*(scale for _, scale in opaque.states), 1.0]),
            np.array([*opaque.origins, 0.0]),
        )
        self.scales, self.offsets = np.array([*scales, 1.0]), np.array([*offsets, 0.0])
        self.variables, self.watched = rows, [_row(v, fmi, 0, 1, held=False) for v in watched]
        self.tunables, self.crossings = tunables, list(part.crossings)
        self.states = [int(place[i]) for i in part.states]
        self.sizes = {
            "nwatched": len(watched), "fmi": fmi, "nx": nx, "nz": opaque.indicators, "nu": nu, "nvariables": len(rows),
            "ntunables": len(tunables), "ncrossings": len(part.crossings), "event": part.event,
            "completes": int(completes),
        }  # fmt: skip
        self.ninputs = nu - len(tunables)
        self.tuned = slice(self.ninputs, nu)


def _row(variable: ModelVariable, fmi: int, first: int, size: int, *, held: bool) -> VariableRow:
    return variable.reference, code_of(variable.type, fmi), first, size, int(held)


def columns(rows: Sequence[VariableRow]) -> list[dict[str, int]]:
    """Return rows as fields of BlocksVariable."""
    return [dict(zip(("reference", "type", "first", "size", "held"), row, strict=True)) for row in rows]
