"""FMUs for Model Exchange in a run: what happens to them at instants, and how they begin, end and are kept.

Between instants an FMU is a function of time, states and inputs (`fmu_values`), which may be derived by them
(`fmu_derivatives`). What is hidden in it changes in `event` only, and at the start.

References: FMI 2.0.4, 3 (Model Exchange); FMI 3.0.2, 3.
"""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ...compile.c.foreign_tables import MOST_WATCHED
from ...compile.plan import ForeignPart, Plan
from ...fmi.exits import Ended
from ...fmi.instance import Instance, Saved, ended
from ...fmi.isolation import CompileC
from ...fmi.library import Notes
from ...fmi.loading import open_fmu
from ...fmi.model_description import ModelVariable
from ...fmi.trace import Tracer
from ...text.arrays import Array
from ...text.errors import Fault, FMUError, SimulationError, UsageError
from .fmu_derivatives import FmuDerivatives
from .saved_state import restoring

MOST_UPDATES = 100
"""Event iterations of one FMU at one instant."""
MOST_LOOKS, LAGS = 1000, 3
"""Completed steps at which outputs are looked at; how often one must lag for a report."""


class ModelExchangeUnit(FmuDerivatives):
    """One FMU of one run. Its instance is there from `begin` or `restore` on."""

    def __init__(
        self,
        plan: Plan,
        part: ForeignPart,
        notes: Notes | None = None,
        compiled: CompileC | None = None,
        tracer: Tracer | None = None,
    ) -> None:
        super().__init__(plan, part)
        self.settings, self.notes, self.compiled, self.tracer = plan.settings, notes, compiled, tracer
        self.held = [
            k
            for (_, first, size), is_held in zip(self.variables, self.is_held, strict=True)
            for k in range(first, first + size)
            if is_held
        ]
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
        self.is_inside = False  # whether it is a part of a larger run, which it cannot end at any time
        self.epoch = 0
        self.begin_anew()

    def begin_anew(self) -> None:
        """Nothing is known to be set, and nothing has happened."""
        self.forget()
        self.seen: tuple[float, ...] | None = None  # the inputs at the last accepted step or event
        self.parameters: tuple[float, ...] | None = None  # as they were set
        self.asks = False
        self.over: Fault | None = None  # the warning that it ended the run (W206)
        self.waits = False  # for the turn of its time event in an instant
        self.is_late = False  # whether that came before something that its inputs depend on
        self.looks = 0
        self.followed = [math.nan] * len(self.watched)  # as they were when the last step was completed
        self.lags = [0] * len(self.watched)  # how often one changed only by that

    # --- the beginning and the end --------------------------------------------------------------------------------

    def open(self) -> Instance:
        """A new instance, in place of the one that there was."""
        self.close()
        self.begin_anew()
        foreign = self.foreign
        own: dict[str, Any] = {}
        if foreign.isolate:
            own = {"isolate": True, "timeout": foreign.timeout, "compiled": self.compiled}
        with open_fmu(foreign.path, "ME", notes=self.notes, **own) as loaded:
            self.instance = Instance(loaded, self.part.path, tracer=self.tracer)
        return self.instance

    def close(self) -> None:
        instance, self.instance = self.instance, None
        if instance is not None:
            instance.close()

    def begin(self, plan: Plan, t: float) -> None:
        """Up to initialization mode."""
        one, settings = self.open(), self.settings
        experiment = t, None if settings.stop is None else float(settings.stop), settings.rtol
        one.set_up_experiment(*experiment)
        self.set_parameters(plan, is_first=True)
        one.enter_initialization(*experiment)
        one.hand_over()
        self.mode, self.t = "initialization", t

    def set_parameters(self, plan: Plan, *, is_first: bool) -> None:
        """Parameters and start values that differ from what the FMU has, or from what was set before."""
        one, known, now = self.one, self.parameters, plan.parameters
        sizes: list[tuple[ModelVariable, list[float]]] = []
        others: list[tuple[ModelVariable, list[float]]] = []
        for name, first, size in self.part.parameters if is_first else self.tunable:
            variable = self.foreign.variables[name]
            values = list(now[first : first + size])
            if known is None:
                start = [float(v) for v in variable.start]
                start = start * size if len(start) == 1 else start
                is_told = [self.foreign.si(name, v) for v in start] == values or (not start and not any(values))
                if is_told and variable.name not in self.foreign.changed:
                    continue
            elif list(known[first : first + size]) == values:
                continue
            numbers = [self.foreign.own(name, v) for v in values]
            if variable.causality == "structuralParameter":
                sizes.append((variable, numbers))
            else:
                others.append((variable, numbers))
        if sizes:  # first, as the others may be arrays of these sizes
            one.call("EnterConfigurationMode")
            for variable, numbers in sizes:
                one.set_numbers((variable,), numbers)
            one.call("ExitConfigurationMode")
        for variable, numbers in others:
            one.set_numbers((variable,), numbers)
        if is_first:
            for name, given in self.part.optional:
                one.set_numbers((self.foreign.variables[name],), [self.foreign.own(name, v) for v in given])
            for name, text in self.part.texts:
                variable = self.foreign.variables[name]
                if not variable.start or variable.start[0] != text:
                    one.set((variable,), (text,))
        self.parameters = now

    def _take_states(self) -> None:
        """Take over the states that were read into x_c."""
        x = np.array(self.x_c) * self.factors
        self.x = (x + self.origins if self.origins.any() else x).tolist()

    def started(self) -> list[float]:
        """The end of the initialization: events, then continuous time. Returns the states."""
        self.one.exit_initialization()
        self.seen = tuple(self.u)
        self.mode = "event"  # until its turn in the first instant
        return self._states()

    # --- steps and events -------------------------------------------------------------------------------------------

    def stand(self, t: float, x: Sequence[float], inputs: Sequence[float]) -> None:
        """Set an accepted time. Raises FMUError where the FMU refuses it."""
        if not self.set_point(t, list(enumerate(x)), list(enumerate(inputs))):
            message = f"{self.foreign.path.name} discards the end of an accepted step, at t = {t} s."
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
        before = self._looked_at()
        enter, terminate = self.one.completed_step(forgets=True)
        if before is not None:
            self._compare(before)
        if terminate:
            self.end(t)
            return True
        self.asks = self.asks or enter
        return self.asks

    def _looked_at(self) -> list[float] | None:
        """Outputs before a step is completed: some FMUs compute them only then, and inside it they are older."""
        if not self.watched or self.looks >= MOST_LOOKS:
            return None
        self.looks += 1
        if not self.has_rates and not self._ask_for_rates():
            return None
        return self.one.numbers(self.watched)

    def _compare(self, before: list[float]) -> None:
        after = self.one.numbers(self.watched)
        for k, (old, new) in enumerate(zip(before, after or before, strict=True)):
            self.lags[k] += old == self.followed[k] and old != new
            self.followed[k] = new

    @property
    def lagging(self) -> Fault | None:
        """The warning that outputs follow only the ends of steps (W208)."""
        names = [variable.name for variable, lags in zip(self.watched, self.lags, strict=True) if lags >= LAGS]
        if not names:
            return None
        which = f"{', '.join(names)} of {self.foreign.path.name}"
        message = f"{which} is computed only at the ends of steps; between them it keeps an older value."
        cure = "Use fixed steps that end at the rows (--method rk4 --step H), or record without a grid (every)."
        return Fault("W208", self.part.path, message, cure)

    @property
    def late(self) -> Fault | None:
        """The warning that it ticked before something that its inputs depend on (W210)."""
        if not self.is_late:
            return None
        message = f"{self.foreign.path.name} is in a loop with blocks that tick at its events, and is updated first."
        cure = "If it samples its inputs, it is one sample late: use a block instead, or choose other tick times."
        return Fault("W210", self.part.path, message, cure)

    def has_event(self, inputs: tuple[float, ...], plan: Plan) -> bool:
        """Whether it asked for an event, or was given other inputs or parameters at an instant."""
        known = self.parameters
        if self.over is not None or self.waits:
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
        if self.mode != "event":
            self.stand(t, x, self.seen if self.seen is not None else inputs)
            self.one.enter_event_mode()
            self.mode = "event"
        for k, value in enumerate(inputs):
            self.u[k] = value
        self._put_inputs()
        self.set_parameters(plan, is_first=False)
        self.seen = tuple(inputs)
        return self._updated()

    def _updated(self) -> list[float]:
        """New discrete states until nothing is new; then continuous time."""
        one, t = self.one, self.t
        for _ in range(MOST_UPDATES):
            told = one.update_discrete_states()
            if told.terminate:
                self.end(t)
            following = math.inf if told.next_time is None else told.next_time
            # A next event that is not ahead is one that is now.
            if self.over is not None or (not told.needs_update and following > t):
                break
        else:
            message = f"at t = {t} s the event iteration of {self.foreign.path.name} does not end."
            raise SimulationError(Fault("E305", self.part.path, message, "Report it to the FMU's vendor."))
        self.next_event, self.asks = math.inf if self.over is not None else following, False
        self.has_rates = False
        if self.over is None:
            one.enter_continuous_mode()
            self.mode = "continuous"
        self.epoch += 1
        return self._states()

    def _states(self) -> list[float]:
        """The states as the FMU has them."""
        if self.n:
            self.one.call("GetContinuousStates", self.x_c, self.n)
            self._take_states()
        bad = next((value for value in self.x if not math.isfinite(value)), None)
        if bad is not None:
            message = f"a state of {self.foreign.path.name} is {bad} after an event at t = {self.t} s."
            cure = "Try other inputs, or report it to the FMU's vendor."
            raise SimulationError(Fault("E303", self.part.path, message, cure))
        return list(self.x)

    def end(self, t: float) -> None:
        """The FMU ended the run at t. Raises Ended inside of another run."""
        words = self.one.words if self.one.messages else ""
        self.over = ended(self.part.path, self.foreign.path.name, t, words)
        if self.is_inside:
            raise Ended(self.over)

    # --- going back -----------------------------------------------------------------------------------------------

    def keep(self) -> Any:
        """All that is hidden, to go back to in this run. Raises FMUError (E215) where the FMU cannot."""
        own = (self.mode, self.x, self.u, self.had, self.seen, self.parameters, self.asks, self.next_event, self.epoch)
        return self.one.save(), self.t, *map(_copied, own)

    def go_back(self, kept: Any) -> None:
        saved, t, *own = kept
        self.one.restore(saved)
        self.mode, self.x, self.u, self.had, self.seen, self.parameters, self.asks, self.next_event, self.epoch = map(
            _copied, own
        )
        # All is set again; in event mode the time is that of the state.
        self.t, self.is_stale = t if self.mode == "event" else math.nan, True

    def drop(self, kept: Any) -> None:
        saved: Saved = kept[0]
        if self.instance is not None:
            self.instance.forget(saved)

    # --- saving ---------------------------------------------------------------------------------------------------

    def saved(self) -> dict[str, Any]:
        """All that is hidden, as JSON holds it. Raises UsageError (E506) where the FMU cannot give it."""
        if not (self.interface.saves and self.interface.serializes):
            message = f"the state of {self.foreign.path.name} cannot be saved: the FMU does not support it."
            raise UsageError(Fault("E506", self.part.path, message, "Export it with serializable states."))
        try:
            data = self.one.serialized()
        except FMUError as error:
            message = f"the state of {self.foreign.path.name} cannot be saved: {error.faults[0].message}"
            raise UsageError(Fault("E506", self.part.path, message, error.faults[0].cure)) from None
        seen = [*(self.seen or ()), self.next_event]
        return {
            "state": base64.b64encode(data).decode(),
            "numbers": base64.b64encode(struct.pack(f"<{len(seen)}d", *seen)).decode(),
        }

    def restore(self, plan: Plan, kept: Mapping[str, Any], t: float) -> None:
        """Restore it as it was saved, in a new instance. Raises UsageError (E506)."""
        self.begin(plan, t)
        one = self.one
        one.exit_initialization()
        with restoring(self.part.path, f"the state of {self.foreign.path.name}"):
            numbers = base64.b64decode(kept["numbers"], validate=True)
            *seen, self.next_event = struct.unpack(f"<{len(self.u) + 1}d", numbers)
            one.deserialize(base64.b64decode(kept["state"], validate=True))
        self.mode, self.t, self.is_stale = "continuous", math.nan, True
        if self.n:
            one.call("GetContinuousStates", self.x_c, self.n)
            self._take_states()
        self.u = list(seen)
        self.had = [None] * len(self.variables)
        for number, (_, first, size) in enumerate(self.variables):
            if self.is_held[number]:
                self.had[number] = self.u[first : first + size]
        self.seen = tuple(seen)
        self.parameters = plan.parameters


class Foreigns:
    """The FMUs of a run, in the order of the Plan."""

    def __init__(self, units: Sequence[ModelExchangeUnit] = ()) -> None:
        self.units = tuple(units)

    @classmethod
    def of(
        cls,
        plan: Plan,
        notes: Notes | None = None,
        compiled: CompileC | None = None,
        tracer: Tracer | None = None,
    ) -> Foreigns:
        """The FMUs of a Plan. notes: where it is remembered which libraries loaded. compiled: what compiles the
        processes of isolated FMUs. tracer: of the run."""
        return cls([ModelExchangeUnit(plan, part, notes, compiled, tracer) for part in plan.foreign])

    def __len__(self) -> int:
        return len(self.units)

    def __getitem__(self, k: int) -> ModelExchangeUnit:
        return self.units[k]

    def __iter__(self) -> Iterator[ModelExchangeUnit]:
        return iter(self.units)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """Their warnings."""
        told = [w for unit in self.units if unit.instance is not None for w in unit.instance.warnings]
        own = (fault for unit in self.units for fault in (unit.lagging, unit.late))
        return (*told, *(fault for fault in own if fault is not None))

    @property
    def over(self) -> Fault | None:
        """The warning that one of them ended the run (W206)."""
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
            unit.set_point(unit.t, (), list(enumerate(inputs[first : first + n])))
            first += n

    def unsettled(self, t: float) -> SimulationError:
        message = f"at t = {t} s no start values were found: the states of FMUs and their inputs depend on each other."
        return SimulationError(Fault("E307", self.units[0].part.path, message, "Set the start values of its states."))

    def started(self, x: Array) -> Array:
        """The states after initialization."""
        states = x.copy()
        for unit in self.units:
            states[list(unit.part.states)] = unit.started()
        return states

    def saved(self) -> tuple[Any, ...]:
        return tuple(unit.saved() for unit in self.units)

    def restore(self, plan: Plan, kept: Sequence[Any], t: float) -> None:
        for unit, blob in zip(self.units, kept, strict=True):
            unit.restore(plan, blob, t)

    @property
    def can_go_back(self) -> bool:
        """Whether all of them can go back."""
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


def _copied(value: object) -> Any:
    return list(value) if isinstance(value, list) else value
