"""An FMU for Model Exchange between instants: a function of time, states and inputs, which are set where they changed.

Numbers are in SI; those of the FMU differ by a factor and an offset. FMI has z > 0 for the upper side of an indicator,
and the engines value >= 0, so that a 0 is reported as the smallest number below.

References: FMI 2.0.4, 3 (Model Exchange); FMI 3.0.2, 3.
"""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import accumulate

import numpy as np

from ...compile.fmu_tape import FmuTape, OpaqueItem, Request
from ...compile.plan import ForeignPart, Plan
from ...fmi.instance import Instance
from ...fmi.model_description import ModelVariable

LEAST = 5e-324


class FmuValues(ABC):
    """What the solver asks one FMU, while it has an instance."""

    def __init__(self, plan: Plan, part: ForeignPart) -> None:
        self.part = part
        tape = plan.instances[part.instance].tape
        assert isinstance(tape, FmuTape)
        self.tape, self.opaque = tape, tape.opaque
        self.foreign = part.foreign
        self.interface = part.foreign.interface
        opaque = tape.opaque
        n = len(opaque.states)
        self.factors = np.array([scale for _, scale in opaque.states], dtype=float)
        self.origins = np.array(opaque.origins, dtype=float)
        self.x_c, self.z_c = (ctypes.c_double * n)(), (ctypes.c_double * opaque.indicators)()
        self.n, self.nz = n, opaque.indicators
        # Inputs as the FMU has them: the elements of a variable side by side.
        self.variables: list[
            tuple[ModelVariable, int, int]
        ] = []  # with where its elements begin, and how many there are
        for k, (_, variable, element, _) in enumerate(opaque.inputs):
            if element == 0:
                self.variables.append((variable, k, math.prod(variable.shape)))
        self.single = [(variable,) for variable, _, _ in self.variables]
        self.is_held = [variable.variability != "continuous" for variable, _, _ in self.variables]
        self.known: dict[int, tuple[Sequence[OpaqueItem], tuple[ModelVariable, ...], dict[int, int]]] = {}
        self.instance: Instance | None = None
        self.mode = ""
        self.forget()

    def forget(self) -> None:
        """Nothing is known to be set."""
        self.t = math.nan
        self.x: list[float] = [math.nan] * self.n
        self.u: list[float] = [math.nan] * len(self.opaque.inputs)
        self.had: list[list[float] | None] = [None] * len(self.variables)  # the inputs as the FMU has them
        self.is_stale = False  # whether the FMU has other states than x says
        self.has_rates = False  # whether its derivatives were asked for since something was set
        self.next_event = math.inf

    @property
    def one(self) -> Instance:
        """Its instance."""
        assert self.instance is not None
        return self.instance

    @abstractmethod
    def derived(self, pairs: Sequence[tuple[OpaqueItem, int]], point: Sequence[float]) -> list[float]:
        """Partial derivatives of what the FMU gives by arguments."""

    def point(self) -> list[float]:
        """The values of all arguments, as they are set."""
        point = [self.t] * len(self.tape.arguments)
        for k, (argument, _) in enumerate(self.opaque.states):
            point[argument] = self.x[k]
        for k, (argument, *_) in enumerate(self.opaque.inputs):
            point[argument] = self.u[k]
        return point

    def values(self, request: Request, t: float, *given: float) -> tuple[float, ...]:
        """What is asked for, in SI; NaN where the FMU discards what was set."""
        if not self.set_point(
            t,
            [(k, given[place - 1]) for place, k in request.states],
            [(k, given[place - 1]) for place, k in request.inputs],
        ):
            return (math.nan,) * len(request.items)
        return self.read(request.items, given)

    def set_point(self, t: float, states: Sequence[tuple[int, float]], inputs: Sequence[tuple[int, float]]) -> bool:
        """Set what changed: time, and states and inputs by their numbers; False where the FMU discards it."""
        one, fine = self.one, True
        if self.mode == "continuous":
            if t != self.t:
                one.t = t
                fine = one.tried("SetTime", t)
                self.t, self.has_rates = t, False
            x = self.x
            changed = False
            for k, value in states:
                if x[k] != value:
                    x[k] = value
                    changed = True
            if changed or self.is_stale:
                fine = self._put_states() and fine
        for k, value in inputs:
            if self.u[k] != value:
                self.u[k] = value
        self._put_inputs()
        return fine

    def _put_states(self) -> bool:
        self.x_c[:] = ((np.array(self.x) - self.origins) / self.factors).tolist()
        self.has_rates = False
        self.is_stale = self.n > 0 and not self.one.tried("SetContinuousStates", self.x_c, self.n)
        return not self.is_stale

    def _put_inputs(self) -> None:
        """Set given inputs that the FMU does not have yet; held ones wait for its next event."""
        one = self.one
        for number, (_, first, size) in enumerate(self.variables):
            values = self.u[first : first + size]
            if values == self.had[number] or any(v != v for v in values):
                continue
            if self.is_held[number] and self.mode == "continuous":
                continue
            scales = [self.opaque.inputs[first + e][3] for e in range(size)]
            offsets = self.opaque.offsets[first : first + size]
            own = [(v - o) / s for v, s, o in zip(values, scales, offsets, strict=True)]
            one.set_numbers(self.single[number], own)
            self.had[number], self.has_rates = values, False

    def _ask_for_rates(self) -> bool:
        """Read derivatives into x_c; False where they are discarded."""
        self.has_rates = self.one.tried("GetContinuousStateDerivatives", self.x_c, self.n)
        return self.has_rates

    def _asked(self, items: Sequence[OpaqueItem]) -> tuple[tuple[ModelVariable, ...], dict[int, int]]:
        """The variables behind items, and by their ids where the elements of each begin in the row of all."""
        known = self.known.get(id(items))
        if known is None:
            variables = {id(item.variable): item.variable for item in items if item.variable is not None}
            sizes = [math.prod(variable.shape) for variable in variables.values()]
            first = dict(zip(variables, accumulate(sizes, initial=0), strict=False))
            known = items, tuple(variables.values()), first
            if isinstance(items, tuple):  # the items of a request, which stay
                self.known[id(items)] = known
        return known[1], known[2]

    def read(self, items: Sequence[OpaqueItem], given: Sequence[float] = ()) -> tuple[float, ...]:
        """Items at the point that is set, in SI; NaN where the FMU discards it. given: values of the arguments."""
        one, fine = self.one, True
        kinds = {item.kind for item in items}
        derivatives: Sequence[float] = ()
        # There are FMUs that compute their values only where they are asked for derivatives.
        is_before = "value" in kinds and self.mode == "continuous" and self.n > 0 and not self.has_rates
        if "derivative" in kinds or is_before:
            fine = self._ask_for_rates()
            derivatives = list(self.x_c)
        indicators: Sequence[float] = ()
        if "indicator" in kinds:
            fine = one.tried("GetEventIndicators", self.z_c, self.nz) and fine
            indicators = list(self.z_c)
        states: Sequence[float] = ()
        if "state" in kinds:
            fine = one.tried("GetContinuousStates", self.x_c, self.n) and fine
            states = list(self.x_c)
        values: Sequence[float] | None = ()
        first: Mapping[int, int] = {}  # of the elements of each variable
        if "value" in kinds:
            variables, first = self._asked(items)
            values = one.numbers(variables)
        if not fine or values is None:
            return (math.nan,) * len(items)
        partials: dict[OpaqueItem, float] = {}
        if "partial" in kinds:
            asked = list(dict.fromkeys(item for item in items if item.of is not None))
            pairs = [(item.of, item.index) for item in asked if item.of is not None]
            partials.update(zip(asked, self.derived(pairs, self.point()), strict=True))
        readings = []
        for item in items:
            match item.kind:
                case "derivative":
                    readings.append(derivatives[item.index] * item.scale)
                case "indicator":
                    z = indicators[item.index]
                    readings.append(z if z != 0.0 else -LEAST)
                case "state":
                    readings.append(item.si(states[item.index]))
                case "event_time":
                    readings.append(self.next_event)
                case "given":
                    readings.append(given[item.index - 1])
                case "number":
                    readings.append(item.scale)
                case "partial":
                    readings.append(partials[item])
                case _:
                    readings.append(item.si(values[first[id(item.variable)] + item.index]))
        return tuple(readings)
