"""FMUs for Model Exchange in a run: what the solver asks them, and what happens to them at instants.

Between instants an FMU is a function: time, states and inputs are set where they changed, and its derivatives, outputs
and event indicators are read. What is hidden in it changes in `event` only, and at the start. All numbers here are in
SI; those of the FMU differ by a factor. FMI has z > 0 for the upper side of an indicator, and the engines value >= 0,
so that a 0 is told as the smallest number below.

References: FMI 2.0.4, 3 (Model Exchange); FMI 3.0.2, 3.
"""

from __future__ import annotations

import base64
import ctypes
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...compile.fmu_tape import Request
from ...compile.plan import ForeignPart, Plan
from ...contract.tape import Opaque, OpaqueItem
from ...fmi.instance import Ended, Instance, Saved, ended, open_fmu
from ...fmi.isolation import Compiled
from ...fmi.library import Notes
from ...fmi.schema import CALLS, Variable
from ...model.settings import RunSettings
from ...text.errors import Fault, FMUError, SimulationError, UsageError

__all__ = ["Foreigns", "Unit"]

Array = np.ndarray[Any, Any]
MOST_UPDATES = 100
MOST_LOOKS, MOST_WATCHED, LAGS = 1000, 8, 3
"""Completed steps at which outputs are looked at, and how many outputs; how often one must lag for that to be told."""
"""Event iterations of one FMU at one instant."""
LEAST = 5e-324
DISCARD = 2
_ROOT = math.sqrt(float(np.finfo(float).eps))
_AGREES = 1e-3
"""How far a directional derivative may be from a quotient of differences, of the larger of the two."""

_C3 = {
    "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Int8": ctypes.c_int8, "UInt8": ctypes.c_uint8,
    "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16, "Int32": ctypes.c_int32, "UInt32": ctypes.c_uint32,
    "Int64": ctypes.c_int64, "UInt64": ctypes.c_uint64, "Boolean": ctypes.c_bool, "Enumeration": ctypes.c_int64,
}  # fmt: skip
_C2 = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}


class Calls:
    """The functions of one instance, those of FMI 2 and 3 alike. A status that is no success raises FMUError, but
    `discard` of what is asked in a trial is told as False."""

    def __init__(self, raw: Any, fmi: int) -> None:
        self.raw, self.fmi = raw, fmi

    def __call__(self, name: str, *arguments: Any) -> None:
        call = f"fmi{self.fmi}{name}"
        status = self.raw.status(call, self.raw.component, *arguments)
        if status:
            self.raw.judge(call, status)

    def tried(self, name: str, *arguments: Any) -> bool:
        call = f"fmi{self.fmi}{name}"
        status = self.raw.status(call, self.raw.component, *arguments)
        if status == DISCARD:
            return False
        if status:
            self.raw.judge(call, status)
        return True

    def kind(self, variable: Variable) -> tuple[str, Any]:
        """The part of a call's name, and the C type, of a variable."""
        if self.fmi == 2:
            word = CALLS[variable.type]
            return word, _C2[word]
        return ("Int64" if variable.type == "Enumeration" else variable.type), _C3[variable.type]

    def set(self, variable: Variable, values: Sequence[float]) -> None:
        word, kind = self.kind(variable)
        reference, n = (ctypes.c_uint * 1)(variable.reference), len(values)
        numbers = [float(v) for v in values] if kind in (ctypes.c_double, ctypes.c_float) else [int(v) for v in values]
        more = () if self.fmi == 2 else (n,)
        self(f"Set{word}", reference, 1, (kind * n)(*numbers), *more)

    def set_text(self, variable: Variable, text: str) -> None:
        reference, value = (ctypes.c_uint * 1)(variable.reference), (ctypes.c_char_p * 1)(text.encode())
        self("SetString", reference, 1, value, *(() if self.fmi == 2 else (1,)))

    def get(self, variables: Sequence[tuple[Variable, int]]) -> list[list[float]] | None:
        """The elements of variables of one type; None: discarded. variables: with their sizes."""
        word, kind = self.kind(variables[0][0])
        references = (ctypes.c_uint * len(variables))(*(variable.reference for variable, _ in variables))
        total = sum(size for _, size in variables)
        values = (kind * total)()
        if not self.tried(f"Get{word}", references, len(variables), values, *(() if self.fmi == 2 else (total,))):
            return None
        made, first = [], 0
        for _, size in variables:
            made.append([float(v) for v in values[first : first + size]])
            first += size
        return made


class Unit:
    """One FMU of one run. Its instance is there from `begin` or `restore` on."""

    def __init__(
        self, plan: Plan, part: ForeignPart, settings: RunSettings, notes: Notes | None = None,
        compiled: Compiled | None = None,
    ) -> None:  # fmt: skip
        self.part, self.settings, self.notes, self.compiled = part, settings, notes, compiled
        tape = plan.instances[part.instance].tape
        assert tape.opaque is not None
        self.tape, self.opaque = tape, tape.opaque
        self.foreign = part.foreign
        self.interface = part.foreign.interface
        opaque: Opaque = tape.opaque
        n = len(opaque.states)
        self.factors = np.array([scale for _, scale in opaque.states], dtype=float)
        self.x_c, self.z_c = (ctypes.c_double * n)(), (ctypes.c_double * opaque.indicators)()
        self.n, self.nz = n, opaque.indicators
        # Inputs as the FMU has them: the elements of a variable side by side.
        self.variables: list[tuple[Variable, int, int]] = []  # with where its elements begin, and how many there are
        for k, (_, variable, element, _) in enumerate(opaque.inputs):
            if element == 0:
                self.variables.append((variable, k, math.prod(variable.shape)))
        self.is_held = [variable.variability != "continuous" for variable, _, _ in self.variables]
        self.held = [
            k
            for (_, first, size), is_held in zip(self.variables, self.is_held, strict=True)
            for k in range(first, first + size)
            if is_held
        ]
        self.sizes = {
            id(item.variable): math.prod(item.variable.shape) for item in opaque.items if item.variable is not None
        }
        self.tunable = [(name, first, size) for name, first, size in part.parameters if name in part.tunable]
        self.completes = self.interface.completed_step
        # Outputs that should be functions of time, states and inputs.
        self.watched = [
            v
            for v in self.foreign.description.variables
            if v.causality == "output" and v.variability == "continuous" and v.type == "Float64" and not v.shape
        ][:MOST_WATCHED]
        if not (self.completes and self.n):
            self.watched = []
        self.instance: Instance | None = None
        self.call: Calls | None = None
        self.mode = ""
        self.is_reliable: bool | None = None  # whether directional derivatives are what differences are
        self.is_inside = False  # of a run that others belong to, which this cannot end at any time
        self.epoch = 0
        self.forget()

    def forget(self) -> None:
        """Nothing is known to be set."""
        self.t = math.nan
        self.x: list[float] = [math.nan] * self.n
        self.u: list[float] = [math.nan] * len(self.opaque.inputs)
        self.had: list[list[float] | None] = [None] * len(self.variables)  # the inputs as the FMU has them
        self.seen: tuple[float, ...] | None = None  # the inputs at the last accepted step or event
        self.parameters: tuple[float, ...] | None = None  # as they were set
        self.asks = False
        self.over: Fault | None = None  # that it ended the run (W206)
        self.is_stale = False  # whether the FMU has other states than x says
        self.has_rates = False  # whether its derivatives were asked for since something was set
        self.next_event = math.inf
        self.looks = 0
        self.followed = [math.nan] * len(self.watched)  # as they were when the last step was completed
        self.lags = [0] * len(self.watched)  # how often one changed only by that

    # --- the beginning and the end --------------------------------------------------------------------------------

    def open(self) -> Calls:
        """A new instance, in place of the one that there was."""
        self.close()
        self.forget()
        foreign = self.foreign
        own: dict[str, Any] = {}
        if foreign.isolate:
            own = {"isolate": True, "timeout": foreign.timeout, "compiled": self.compiled}
        with open_fmu(foreign.path, "ME", notes=self.notes, **own) as loaded:
            self.instance = Instance(loaded, self.part.path)
        self.call = Calls(self.instance._raw, self.foreign.description.fmi)
        return self.call

    def close(self) -> None:
        instance, self.instance, self.call = self.instance, None, None
        if instance is not None:
            instance.close()

    def begin(self, plan: Plan, t: float) -> None:
        """Up to initialization mode."""
        call = self.open()
        self.raw.t = t
        settings = self.settings
        stop = settings.stop
        ends = (1, float(stop)) if stop is not None else (0, 0.0)
        is_fmi2 = self.foreign.description.fmi == 2
        if is_fmi2:  # before values are set: some FMUs put them back here
            call("SetupExperiment", 1, settings.rtol, t, *ends)
        self.set_parameters(plan, is_first=True)
        if is_fmi2:
            call("EnterInitializationMode")
        else:
            call("EnterInitializationMode", True, settings.rtol, t, bool(ends[0]), ends[1])
        self.raw.must_terminate = True
        self.mode, self.t = "initialization", t

    @property
    def raw(self) -> Any:
        assert self.call is not None
        return self.call.raw

    def set_parameters(self, plan: Plan, *, is_first: bool) -> None:
        """Parameters and start values that differ from what the FMU has, or from what was set before."""
        call, known, now = self.call, self.parameters, plan.parameters
        assert call is not None
        sizes: list[tuple[Variable, list[float]]] = []
        others: list[tuple[Variable, list[float]]] = []
        for name, first, size in self.part.parameters if is_first else self.tunable:
            variable = self.foreign.variables[name]
            scale = self.foreign.scales.get(name, 1.0)
            values = list(now[first : first + size])
            if known is None:
                start = [float(v) for v in variable.start]
                start = start * size if len(start) == 1 else start
                is_told = [v * scale for v in start] == values or (not start and not any(values))
                if is_told and variable.name not in self.foreign.changed:
                    continue
            elif list(known[first : first + size]) == values:
                continue
            numbers = [v / scale for v in values]
            if variable.causality == "structuralParameter":
                sizes.append((variable, numbers))
            else:
                others.append((variable, numbers))
        if sizes:  # first, as the others may be arrays of these sizes
            call("EnterConfigurationMode")
            for variable, numbers in sizes:
                call.set(variable, numbers)
            call("ExitConfigurationMode")
        for variable, numbers in others:
            call.set(variable, numbers)
        if is_first:
            for name, given in self.part.optional:
                scale = self.foreign.scales.get(name, 1.0)
                call.set(self.foreign.variables[name], [v / scale for v in given])
            for name, text in self.part.texts:
                variable = self.foreign.variables[name]
                if not variable.start or variable.start[0] != text:
                    call.set_text(variable, text)
        self.parameters = now

    def started(self) -> list[float]:
        """The end of the initialization: events, then continuous time. Returns the states."""
        call = self.call
        assert call is not None
        call("ExitInitializationMode")
        self.seen = tuple(self.u)
        self.mode = "event"
        return self._updated()

    # --- between instants -------------------------------------------------------------------------------------------

    def values(self, request: Request, t: float, *given: float) -> tuple[float, ...]:
        """What is asked for, in SI; NaN where the FMU discards what was set."""
        if not self._set(
            t,
            [(k, given[place - 1]) for place, k in request.states],
            [(k, given[place - 1]) for place, k in request.inputs],
        ):
            return (math.nan,) * len(request.items)
        return self._read(request.items, given)

    def _set(self, t: float, states: Sequence[tuple[int, float]], inputs: Sequence[tuple[int, float]]) -> bool:
        call = self.call
        assert call is not None
        fine = True
        if self.mode == "continuous":
            if t != self.t:
                self.raw.t = t
                fine = call.tried("SetTime", t)
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
        return self._put_inputs() and fine

    def _put_states(self) -> bool:
        call = self.call
        assert call is not None
        self.x_c[:] = (np.array(self.x) / self.factors).tolist()
        self.has_rates = False
        self.is_stale = self.n > 0 and not call.tried("SetContinuousStates", self.x_c, self.n)
        return not self.is_stale

    def _put_inputs(self) -> bool:
        """Inputs that were given and that the FMU has not yet; held ones wait for its next event."""
        call, fine = self.call, True
        assert call is not None
        for number, (variable, first, size) in enumerate(self.variables):
            values = self.u[first : first + size]
            if values == self.had[number] or any(v != v for v in values):
                continue
            if self.is_held[number] and self.mode == "continuous":
                continue
            scales = [self.opaque.inputs[first + e][3] for e in range(size)]
            call.set(variable, [v / s for v, s in zip(values, scales, strict=True)])
            self.had[number], self.has_rates = values, False
        return fine

    def _ask_for_rates(self) -> bool:
        """Derivatives into x_c; False where they are discarded."""
        assert self.call is not None
        word = "GetDerivatives" if self.foreign.description.fmi == 2 else "GetContinuousStateDerivatives"
        self.has_rates = self.call.tried(word, self.x_c, self.n)
        return self.has_rates

    def _read(self, items: Sequence[OpaqueItem], given: Sequence[float] = ()) -> tuple[float, ...]:
        call, fine = self.call, True
        assert call is not None
        kinds = {item.kind for item in items}
        derivatives: Sequence[float] = ()
        # There are FMUs that compute their values only where they are asked for derivatives.
        is_before = "value" in kinds and self.mode == "continuous" and self.n > 0 and not self.has_rates
        if "derivative" in kinds or is_before:
            fine = self._ask_for_rates()
            derivatives = list(self.x_c)
        indicators: Sequence[float] = ()
        if "indicator" in kinds:
            fine = call.tried("GetEventIndicators", self.z_c, self.nz) and fine
            indicators = list(self.z_c)
        states: Sequence[float] = ()
        if "state" in kinds:
            fine = call.tried("GetContinuousStates", self.x_c, self.n) and fine
            states = list(self.x_c)
        values: dict[int, list[float]] = {}
        if "value" in kinds:
            groups: dict[str, dict[int, Variable]] = {}
            for item in items:
                if item.variable is not None:
                    groups.setdefault(call.kind(item.variable)[0], {})[id(item.variable)] = item.variable
            for group in groups.values():
                found = call.get([(variable, self.sizes[key]) for key, variable in group.items()])
                if found is None:
                    fine = False
                    break
                values.update(zip(group, found, strict=True))
        if not fine:
            return (math.nan,) * len(items)
        partials: dict[OpaqueItem, float] = {}
        if "partial" in kinds:
            asked = list(dict.fromkeys(item for item in items if item.of is not None))
            pairs = [(item.of, item.index) for item in asked if item.of is not None]
            partials.update(zip(asked, self.derived(pairs, self.point()), strict=True))
        made = []
        for item in items:
            match item.kind:
                case "derivative":
                    made.append(derivatives[item.index] * item.scale)
                case "indicator":
                    z = indicators[item.index]
                    made.append(z if z != 0.0 else -LEAST)
                case "state":
                    made.append(states[item.index] * item.scale)
                case "event_time":
                    made.append(self.next_event)
                case "given":
                    made.append(given[item.index - 1])
                case "number":
                    made.append(item.scale)
                case "partial":
                    made.append(partials[item])
                case _:
                    made.append(values[id(item.variable)][item.index] * item.scale)
        return tuple(made)

    # --- steps and events -------------------------------------------------------------------------------------------

    def stand(self, t: float, x: Sequence[float], inputs: Sequence[float]) -> None:
        """At a time for good. Raises FMUError where the FMU refuses it."""
        if not self._set(t, list(enumerate(x)), list(enumerate(inputs))):
            message = f"{self.foreign.path.name} discards what an accepted step came to, at t = {t} s."
            raise FMUError(Fault("E213", self.part.path, message, "Use smaller steps or tolerances."))

    def completed(self, t: float, x: Sequence[float], inputs: Sequence[float]) -> bool:
        """An accepted step; whether the FMU asks for an event, or ended the run. Raises Ended inside of another run."""
        self.stand(t, x, inputs)
        seen = list(inputs)
        for k in self.held if self.seen is not None else ():  # what it was given at its last event
            seen[k] = self.seen[k]  # type: ignore[index]
        self.seen = tuple(seen)
        if not self.completes:
            return False
        call = self.call
        assert call is not None
        kind = ctypes.c_int if self.foreign.description.fmi == 2 else ctypes.c_bool
        enter, terminate = kind(), kind()
        before = self._looked_at()
        call("CompletedIntegratorStep", True, ctypes.byref(enter), ctypes.byref(terminate))
        if before is not None:
            self._compare(before)
        if terminate.value:
            self.end(t)
            return True
        self.asks = self.asks or bool(enter.value)
        return self.asks

    def _looked_at(self) -> list[list[float]] | None:
        """Outputs before a step is completed: some FMUs compute them only then, and inside it they are older."""
        call = self.call
        assert call is not None
        if not self.watched or self.looks >= MOST_LOOKS:
            return None
        self.looks += 1
        if not self.has_rates and not self._ask_for_rates():
            return None
        return call.get([(variable, 1) for variable in self.watched])

    def _compare(self, before: list[list[float]]) -> None:
        assert self.call is not None
        after = self.call.get([(variable, 1) for variable in self.watched])
        for k, ((old,), (new,)) in enumerate(zip(before, after or before, strict=True)):
            self.lags[k] += old == self.followed[k] and old != new
            self.followed[k] = new

    @property
    def lagging(self) -> Fault | None:
        """That outputs follow only the ends of steps (W208)."""
        names = [variable.name for variable, lags in zip(self.watched, self.lags, strict=True) if lags >= LAGS]
        if not names:
            return None
        which = f"{', '.join(names)} of {self.foreign.path.name}"
        message = f"{which} follows only where steps end, and is older inside of them."
        cure = "Use fixed steps that meet the rows (--method rk4 --step H), or no grid (every), or ask its maker."
        return Fault("W208", self.part.path, message, cure)

    def has_event(self, inputs: tuple[float, ...], plan: Plan) -> bool:
        """Whether it asked for an event, or was given other inputs or parameters at an instant."""
        known = self.parameters
        if self.over is not None:
            return False
        if self.asks or inputs != self.seen:
            return True
        return (
            known is not plan.parameters
            and known is not None
            and any(
                known[first : first + size] != plan.parameters[first : first + size] for _, first, size in self.tunable
            )
        )

    def event(self, t: float, x: Sequence[float], inputs: Sequence[float], plan: Plan) -> list[float]:
        """Event mode, and back. Returns the states. Raises SimulationError (E305, E306), FMUError (E213), Ended."""
        call = self.call
        assert call is not None
        self.stand(t, x, self.seen if self.seen is not None else inputs)
        call("EnterEventMode")
        self.mode = "event"
        for k, value in enumerate(inputs):
            self.u[k] = value
        self._put_inputs()
        self.set_parameters(plan, is_first=False)
        self.seen = tuple(inputs)
        return self._updated()

    def _updated(self) -> list[float]:
        """New discrete states until nothing is new; then continuous time."""
        call, t = self.call, self.t
        assert call is not None
        assert self.instance is not None
        for _ in range(MOST_UPDATES):
            told = self.instance.update_discrete_states()
            if told.terminate:
                self.end(t)
            following = math.inf if told.next_time is None else told.next_time
            # A next event that is not ahead is one that is now.
            if self.over is not None or (not told.needs_update and following > t):
                break
        else:
            message = f"at t = {t} s the event iteration of {self.foreign.path.name} does not end."
            raise SimulationError(Fault("E305", self.part.path, message, "Tell its maker."))
        self.next_event, self.asks = math.inf if self.over is not None else following, False
        self.has_rates = False
        if self.over is None:
            call("EnterContinuousTimeMode")
            self.mode, self.raw.has_begun = "continuous", True
        self.epoch += 1
        if self.n:
            call("GetContinuousStates", self.x_c, self.n)
            self.x = (np.array(self.x_c) * self.factors).tolist()
        bad = next((value for value in self.x if not math.isfinite(value)), None)
        if bad is not None:
            message = f"a state of {self.foreign.path.name} is {bad} after an event at t = {t} s."
            raise SimulationError(Fault("E303", self.part.path, message, "Tell its maker; other inputs may help."))
        return list(self.x)

    def end(self, t: float) -> None:
        """The FMU ended the run at t. Raises Ended inside of another run."""
        words = self.raw.words() if self.raw.messages else ""
        self.over = ended(self.part.path, self.foreign.path.name, t, words)
        if self.is_inside:
            raise Ended(self.over)

    # --- derivatives ------------------------------------------------------------------------------------------------

    def partials(self, pairs: Sequence[tuple[tuple[str, int], int]], point: Sequence[float]) -> list[float]:
        """Partial derivatives of results by arguments, where the values of all arguments are known."""
        return self.derived([(self.item(*result), argument) for result, argument in pairs], point)

    def point(self) -> list[float]:
        """The values of all arguments, as they are set."""
        made = [self.t] * len(self.tape.arguments)
        for k, (argument, _) in enumerate(self.opaque.states):
            made[argument] = self.x[k]
        for k, (argument, *_) in enumerate(self.opaque.inputs):
            made[argument] = self.u[k]
        return made

    def derived(self, pairs: Sequence[tuple[OpaqueItem, int]], point: Sequence[float]) -> list[float]:
        """Partial derivatives of what the FMU gives by arguments."""
        t = point[0]
        states = [(k, point[a]) for k, (a, _) in enumerate(self.opaque.states)]
        inputs = [(k, point[a]) for k, (a, *_) in enumerate(self.opaque.inputs)]
        columns: dict[int, list[int]] = {}
        for number, (_, argument) in enumerate(pairs):
            columns.setdefault(argument, []).append(number)
        made = [math.nan] * len(pairs)
        items = [item for item, _ in pairs]
        if not self._set(t, states, inputs):
            return made
        exact = self.interface.directional and self.is_reliable is not False
        if exact:
            self._directional(columns, items, made)
        missing = {a: [k for k in numbers if math.isnan(made[k])] for a, numbers in columns.items()}
        if exact and self.is_reliable is None:
            check = list(made)
            self._differences(columns, items, check, point, states, inputs)
            sizes = [max(abs(a), abs(b)) for a, b in zip(made, check, strict=True) if a == a and b == b]
            largest = max(sizes, default=0.0)
            apart = (
                abs(a - b) > _AGREES * max(abs(a), abs(b)) + 1e-5 * largest
                for a, b in zip(made, check, strict=True)
                if a == a and b == b
            )
            self.is_reliable = not any(apart)
            if not self.is_reliable:
                message = "its directional derivatives are not what differences give; these are used."
                self.raw.warn(message)
                return check
        if any(missing.values()):
            self._differences({a: k for a, k in missing.items() if k}, items, made, point, states, inputs)
        return made

    def has_directional(self, item: OpaqueItem) -> bool:
        """Whether the FMU may be asked for directional derivatives of it: outputs and derivatives, not other locals."""
        if item.kind != "value" or item.variable is None or item.variable.causality == "output":
            return True
        rates = (unknown.variable.reference for unknown in self.foreign.description.structure.derivatives)
        return item.variable.reference in rates

    def exact(self, pairs: Sequence[tuple[tuple[str, int], int]], point: Sequence[float]) -> list[float]:
        """As `partials`, by directional derivatives alone; NaN where the FMU gives none."""
        columns: dict[int, list[int]] = {}
        for number, (_, argument) in enumerate(pairs):
            columns.setdefault(argument, []).append(number)
        made = [math.nan] * len(pairs)
        states = [(k, point[a]) for k, (a, _) in enumerate(self.opaque.states)]
        inputs = [(k, point[a]) for k, (a, *_) in enumerate(self.opaque.inputs)]
        if self._set(point[0], states, inputs):
            self._directional(columns, [self.item(*result) for result, _ in pairs], made)
        return made

    def item(self, key: str, element: int) -> OpaqueItem:
        node = self.tape.nodes[self.tape.results[key].nodes[element]]
        if node.op == "argument":
            return OpaqueItem("given", int(node.value))
        return self.opaque.items[int(node.value)]

    def _directional(self, columns: Mapping[int, list[int]], items: Sequence[OpaqueItem], made: list[float]) -> None:
        """By the FMU's own directional derivatives; what it has none of stays NaN."""
        call = self.call
        assert call is not None
        structure = self.foreign.description.structure
        fmi2 = self.foreign.description.fmi == 2
        for argument, numbers in columns.items():
            known = self._seed(argument)
            for k in numbers:
                if items[k].kind == "given":
                    made[k] = float(items[k].index == argument)
            wanted: dict[int, tuple[Variable, int]] = {}
            for k in numbers:
                item = items[k]
                variable = item.variable
                first = 0
                if item.kind == "derivative":
                    for number, unknown in enumerate(structure.derivatives):
                        size = math.prod(structure.states[number].shape)
                        if first <= item.index < first + size:
                            variable = unknown.variable
                            break
                        first += size
                elif item.kind == "indicator" and not fmi2:
                    for unknown in structure.indicators:
                        size = math.prod(unknown.variable.shape)
                        if first <= item.index < first + size:
                            variable = unknown.variable
                            break
                        first += size
                if variable is not None and variable.type == "Float64" and self.has_directional(item):
                    wanted[k] = variable, item.index - (first if item.kind != "value" else 0)
            if not wanted or known is None:
                continue
            variable_in, element_in, scale_in = known
            distinct = {id(variable): variable for variable, _ in wanted.values()}
            sizes = [math.prod(variable.shape) for variable in distinct.values()]
            unknowns = (ctypes.c_uint * len(distinct))(*(variable.reference for variable in distinct.values()))
            knowns = (ctypes.c_uint * 1)(variable_in.reference)
            n_in = math.prod(variable_in.shape)
            seed, out = (ctypes.c_double * n_in)(), (ctypes.c_double * sum(sizes))()
            seed[element_in] = 1.0
            if fmi2:
                fine = call.tried("GetDirectionalDerivative", unknowns, len(distinct), knowns, 1, seed, out)
            else:
                fine = call.tried(
                    "GetDirectionalDerivative", unknowns, len(distinct), knowns, 1, seed, n_in, out, sum(sizes)
                )
            if not fine:
                continue
            begins = dict(zip(distinct, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
            for k, (variable, element) in wanted.items():
                made[k] = out[begins[id(variable)] + element] * items[k].scale / scale_in

    def _seed(self, argument: int) -> tuple[Variable, int, float] | None:
        """The variable behind an argument that is derived by, its element, and its scale."""
        for place, variable, element, scale in self.opaque.inputs:
            if place == argument:
                return (variable, element, scale) if variable.type == "Float64" else None
        first = 0
        for variable in self.foreign.description.structure.states:
            for element in range(math.prod(variable.shape)):
                place, scale = self.opaque.states[first]
                if place == argument:
                    return variable, element, scale
                first += 1
        return None

    def _differences(
        self,
        columns: Mapping[int, list[int]],
        items: Sequence[OpaqueItem],
        made: list[float],
        point: Sequence[float],
        states: list[tuple[int, float]],
        inputs: list[tuple[int, float]],
    ) -> None:
        """Quotients of differences, of several columns at once where no result needs two of them."""
        t = point[0]
        wanted = sorted({k for numbers in columns.values() for k in numbers})
        distinct = list(dict.fromkeys(items[k] for k in wanted))
        place = {item: n for n, item in enumerate(distinct)}
        self._set(t, states, inputs)
        base = self._read(distinct, point[1:])
        groups: list[tuple[set[int], list[int]]] = []
        for argument, numbers in columns.items():
            rows = {place[items[k]] for k in numbers}
            free = next((group for group in groups if not group[0] & rows), None)
            if free is None:
                groups.append((rows, [argument]))
            else:
                free[0].update(rows)
                free[1].append(argument)
        nominal = {a: size for (a, _), size in zip(self.opaque.states, self.part.nominal, strict=True)}
        for _, arguments in groups:
            for sign in (1.0, -1.0):
                moved = list(point)
                for a in arguments:
                    moved[a] += sign * _ROOT * max(abs(point[a]), nominal.get(a, 1.0))
                near = [(k, moved[a]) for k, (a, _) in enumerate(self.opaque.states)]
                fine = self._set(t, near, [(k, moved[a]) for k, (a, *_) in enumerate(self.opaque.inputs)])
                there = self._read(distinct, moved[1:]) if fine else (math.nan,) * len(distinct)
                is_whole = True
                for a in arguments:
                    for k in columns[a]:
                        n = place[items[k]]
                        made[k] = (there[n] - base[n]) / (moved[a] - point[a])
                        is_whole = is_whole and math.isfinite(made[k])
                if is_whole:
                    break
        self._set(t, states, inputs)

    @property
    def byte(self) -> Any:
        return ctypes.c_char if self.foreign.description.fmi == 2 else ctypes.c_ubyte

    # --- going back -----------------------------------------------------------------------------------------------

    def keep(self) -> Any:
        """All that is hidden, to go back to in this run. Raises FMUError (E215) where the FMU cannot."""
        assert self.instance is not None
        own = (self.mode, self.x, self.u, self.had, self.seen, self.parameters, self.asks, self.next_event, self.epoch)
        return self.instance.save(), *map(_copied, own)

    def go_back(self, kept: Any) -> None:
        assert self.instance is not None
        saved, *own = kept
        self.instance.restore(saved)
        self.mode, self.x, self.u, self.had, self.seen, self.parameters, self.asks, self.next_event, self.epoch = map(
            _copied, own
        )
        self.t, self.is_stale = math.nan, True  # so that all is set again

    def drop(self, kept: Any) -> None:
        saved: Saved = kept[0]
        if self.instance is not None:
            self.instance.forget(saved)

    # --- saving ---------------------------------------------------------------------------------------------------

    def saved(self) -> dict[str, Any]:
        """All that is hidden, as JSON holds it. Raises UsageError (E506) where the FMU cannot give it."""
        call = self.call
        assert call is not None
        if not (self.interface.saves and self.interface.serializes):
            message = f"the state of {self.foreign.path.name} cannot be saved: the FMU does not offer it."
            raise UsageError(Fault("E506", self.part.path, message, "Export it with serializable states."))
        word = "FMUstate" if self.foreign.description.fmi == 2 else "FMUState"
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        try:
            call(f"Get{word}", ctypes.byref(state))
            try:
                call(f"Serialized{word}Size", state, ctypes.byref(size))
                data = (self.byte * size.value)()
                call(f"Serialize{word}", state, data, size.value)
            finally:
                call(f"Free{word}", ctypes.byref(state))
        except FMUError as error:
            message = f"the state of {self.foreign.path.name} cannot be saved: {error.faults[0].message}"
            raise UsageError(Fault("E506", self.part.path, message, error.faults[0].cure)) from None
        seen = [*(self.seen or ()), self.next_event]
        return {
            "state": base64.b64encode(bytes(data)).decode(),
            "numbers": base64.b64encode(struct.pack(f"<{len(seen)}d", *seen)).decode(),
        }

    def restore(self, plan: Plan, kept: Mapping[str, Any], t: float) -> None:
        """As it was when it was saved, in a new instance."""
        self.begin(plan, t)
        call = self.call
        assert call is not None
        call("ExitInitializationMode")
        word = "FMUstate" if self.foreign.description.fmi == 2 else "FMUState"
        serialize = "DeSerialize" if self.foreign.description.fmi == 2 else "Deserialize"
        data = base64.b64decode(kept["state"])
        state = ctypes.c_void_p()
        call(f"{serialize}{word}", (self.byte * len(data)).from_buffer_copy(data), len(data), ctypes.byref(state))
        try:
            call(f"Set{word}", state)
        finally:
            call(f"Free{word}", ctypes.byref(state))
        numbers = base64.b64decode(kept["numbers"])
        *seen, self.next_event = struct.unpack(f"<{len(numbers) // 8}d", numbers)
        self.mode, self.t, self.is_stale = "continuous", math.nan, True
        if self.n:
            call("GetContinuousStates", self.x_c, self.n)
            self.x = (np.array(self.x_c) * self.factors).tolist()
        self.u = list(seen)
        self.had = [None] * len(self.variables)
        for number, (_, first, size) in enumerate(self.variables):
            if self.is_held[number]:
                self.had[number] = self.u[first : first + size]
        self.seen = tuple(seen)
        self.parameters = plan.parameters


class Foreigns:
    """The FMUs of a run, in the order of the Plan."""

    def __init__(self, units: Sequence[Unit] = ()) -> None:
        self.units = tuple(units)

    @classmethod
    def of(
        cls, plan: Plan, settings: RunSettings, notes: Notes | None = None, compiled: Compiled | None = None
    ) -> Foreigns:
        """Those of a Plan. notes: where it is remembered which libraries loaded. compiled: what compiles the processes
        of those that are isolated."""
        return cls([Unit(plan, part, settings, notes, compiled) for part in plan.foreign])

    def __len__(self) -> int:
        return len(self.units)

    def __getitem__(self, k: int) -> Unit:
        return self.units[k]

    def __iter__(self) -> Iterator[Unit]:
        return iter(self.units)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What they warned of."""
        told = [w for unit in self.units if unit.instance is not None for w in unit.instance.warnings]
        return (*told, *(fault for unit in self.units if (fault := unit.lagging) is not None))

    @property
    def over(self) -> Fault | None:
        """That one of them ended the run (W206)."""
        return next((unit.over for unit in self.units if unit.over is not None), None)

    @property
    def events(self) -> int:
        """How many events there were."""
        return sum(unit.epoch for unit in self.units)

    def begin(self, plan: Plan, t: float) -> None:
        for unit in self.units:
            unit.begin(plan, t)

    def initialized(self, inputs: Sequence[float]) -> None:
        """All inputs in initialization mode."""
        first = 0
        for unit in self.units:
            n = len(unit.opaque.inputs)
            unit._set(unit.t, (), list(enumerate(inputs[first : first + n])))
            first += n

    def unsettled(self, t: float) -> SimulationError:
        message = f"at t = {t} s no start values were found: states of FMUs and their inputs need each other."
        return SimulationError(Fault("E307", self.units[0].part.path, message, "Set the start values of its states."))

    def started(self, x: Array) -> Array:
        """The states after initialization."""
        made = x.copy()
        for unit in self.units:
            made[list(unit.part.states)] = unit.started()
        return made

    def saved(self) -> tuple[Any, ...]:
        return tuple(unit.saved() for unit in self.units)

    def restore(self, plan: Plan, kept: Sequence[Any], t: float) -> None:
        for unit, blob in zip(self.units, kept, strict=True):
            unit.restore(plan, blob, t)

    @property
    def can_go_back(self) -> bool:
        """Whether all of them say so."""
        return all(unit.interface.saves for unit in self.units)

    def keep(self) -> Any:
        """All that is hidden in them, to go back to in this run. Raises FMUError (E215) where one cannot."""
        return [unit.keep() for unit in self.units]

    def go_back(self, kept: Any) -> None:
        for unit, own in zip(self.units, kept, strict=True):
            unit.go_back(own)

    def drop(self, kept: Any) -> None:
        """What was kept is not needed any more."""
        for unit, own in zip(self.units, kept, strict=True):
            unit.drop(own)

    def close(self) -> None:
        for unit in self.units:
            unit.close()


def _copied(value: Any) -> Any:
    return list(value) if isinstance(value, list) else value
