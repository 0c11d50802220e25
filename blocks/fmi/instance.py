"""One running instance of an FMU, alike for FMI 2 and 3, Model Exchange and Co-Simulation.

    with open_fmu("x.fmu", "CS") as loaded, Instance(loaded, "motor") as one:
        u, y = loaded.description.names["u"], loaded.description.names["y"]
        one.enter_initialization(0.0, stop=2.0)
        one.exit_initialization()
        one.set((u,), (1.5,))
        one.step(0.0, 0.5)
        (value,) = one.get((y,))

Values are Python's numbers and texts in the FMU's own units, all elements of all variables in one row. What the FMU
says is kept and never printed. A warning is remembered in `warnings` (W203), and a step that is not finished (discard)
is a result; every other failure is an error that names the instance, the function, the time and the FMU's own words.
After a fatal error no function of that library is called any more; where the FMU has a process of its own, of that
instance.

The file is longer than others because an instance has all functions of two standards in one place.

References: FMI 2.0.4 and FMI 3.0.2 (states of an instance, allowed calls, meaning of a status).
"""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from operator import index
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from ..text.errors import Fault, FMUError, SimulationError, UsageError
from . import calls
from .calls import Message, Running, running
from .library import claimed
from .loading import Loaded
from .model_description import ModelVariable
from .types import FLOATS, c_type, call_of, full_name, limits_of

if TYPE_CHECKING:
    from .trace import Tracer

PATIENCE = 10.0
"""s; how long a step may stay pending."""

Element = float | int | bool | str

_LARGEST_FLOAT32 = 3.4028235677973366e38  # what is larger is rounded to infinity


class StepResult(NamedTuple):
    """The outcome of a step. last_time: the time that it reached; None where it was discarded and the FMU does not say.

    early: it ended before its end, as was allowed; discarded: it could not be done.
    """

    last_time: float | None
    event_needed: bool = False
    terminate: bool = False
    early: bool = False
    discarded: bool = False


class Events(NamedTuple):
    """The outcome of an update of discrete states. next_time: of the next event, in s; None where there is none."""

    needs_update: bool
    terminate: bool
    nominals_changed: bool
    states_changed: bool
    next_time: float | None


def ended(name: str, place: str, t: float, words: str) -> Fault:
    """That an FMU ended the run, as the standards let it (W206). words: its own, as sentences to append."""
    message = f"{place} ended the run at t = {t:.10g} s.{words}"
    return Fault("W206", name, message, "The results up to this time are valid.")


@dataclass(slots=True, eq=False)
class Saved:
    """A state of an FMU, in its own memory. t: the time of the instance then."""

    state: ctypes.c_void_p
    t: float
    must_terminate: bool


@dataclass(slots=True)
class _VariableGroup:
    """Variables that one call transfers. call: that part of its name, as "Real" or "Float64". places: of their elements
    among those of all variables."""

    call: str
    variables: list[ModelVariable] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    owners: list[ModelVariable] = field(default_factory=list)
    references: Any = None
    buffer: Any = None
    rest: tuple[Any, ...] = ()


class Instance:
    """An instance of what is loaded; freed by `close`, when nobody refers to it, and at the interpreter's exit.

    event_mode, early_return: of FMI 3 Co-Simulation. intermediate(t, instance) is called within steps; what it returns
    is when the step shall end, None: not before its end. intermediate_variables: what it sets and reads. update: the
    address of a function of compiled code in its place.
    log: is given each message; with it the FMU is asked for all messages, else for those about failures.
    timeout: s; how long a step may stay pending. tracer: of the run, which may trace its calls.

    Raises:
        FMUError: E211 where there can be one only, E212 where the FMU gives no instance, E208 for a missing function.
    """

    def __init__(
        self,
        loaded: Loaded,
        name: str,
        *,
        event_mode: bool = False,
        early_return: bool = False,
        intermediate: Callable[[float, Instance], float | None] | None = None,
        intermediate_variables: Sequence[ModelVariable] = (),
        update: int = 0,
        log: Callable[[Message], None] | None = None,
        timeout: float = PATIENCE,
        tracer: Tracer | None = None,
    ) -> None:
        binding = loaded.binding
        self.name, self.place, self.timeout = name, loaded.place, timeout
        self.description, self.interface = binding.description, binding.interface
        self.fmi, self.kind = self.description.fmi, self.interface.kind
        self.event_mode, self.early_return = event_mode, early_return
        traced = None if tracer is None else tracer.of(name, self.description)
        self._raw: Any = running(binding, name, loaded.place, log, traced)
        self._sizes: dict[str, int] = {}
        self._plans: dict[int, tuple[tuple[ModelVariable, ...], list[_VariableGroup], int]] = {}
        self._flags: Any = [ctypes.c_bool() for _ in range(5)]
        self._time: Any = ctypes.c_double()
        self._refs: list[Any] = [ctypes.byref(buffer) for buffer in (*self._flags, self._time)]
        self._is_set_up = False  # whether its experiment is set up

        held = self._raw.held
        held.callback(loaded.again().close)
        # It must not refer to this object, which would then never be freed.
        self._finalizer = weakref.finalize(self, self._raw.end)
        try:
            if self.interface.once_per_process and binding.isolated is None:
                held.enter_context(claimed(loaded.sha256, self.place))
            if intermediate is not None:
                self._raw.intermediate = _weakly(weakref.ref(self), intermediate)
            self._raw.update = update
            references = [variable.reference for variable in intermediate_variables]
            self._raw.begin(event_mode, early_return, references)
        except BaseException:
            self.close()
            raise

    # --- what it is and what it said ----

    @property
    def component(self) -> int:
        """The address of the instance, for calls from compiled code."""
        return self._alive().component  # type: ignore[no-any-return]

    def address(self, name: str) -> int:
        """The address of the function that FMI 3 calls so, as "DoStep". Raises FMUError (E208)."""
        return self._alive().address(full_name(name, self.fmi))  # type: ignore[no-any-return]

    @property
    def messages(self) -> tuple[Message, ...]:
        """The last messages of the FMU."""
        return tuple(self._raw.messages)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """W203, one for each kind of warning that calls gave."""
        return tuple(self._raw.warnings)

    @property
    def t(self) -> float:
        """The time of the last call, in s; not a number before initialization."""
        return self._raw.t  # type: ignore[no-any-return]

    @t.setter
    def t(self, t: float) -> None:
        self._raw.t = t

    @property
    def is_lost(self) -> bool:
        """Whether no function may be called any more, after a fatal error."""
        return self._raw.is_lost  # type: ignore[no-any-return]

    @property
    def words(self) -> str:
        """The FMU's own words at the last call, as they stand in errors."""
        return self._raw.words()  # type: ignore[no-any-return]

    def warn(self, message: str) -> None:
        """Remember a warning (W203)."""
        self._raw.warn(message)

    def _alive(self) -> Any:
        if self._raw.component is None:
            raise ValueError(f"{self.name}: the instance was closed")
        return self._raw

    def call(self, name: str, *arguments: object) -> None:
        """Call the function that FMI 3 calls so, as "SetTime". Raises FMUError (E213) where that does not succeed."""
        raw = self._alive()
        raw._call(full_name(name, self.fmi), raw.component, *arguments)

    def tried(self, name: str, *arguments: object) -> bool:
        """As `call`; False where the FMU discards it."""
        raw = self._alive()
        call = full_name(name, self.fmi)
        status = raw.status(call, raw.component, *arguments)
        if status == calls.DISCARD:
            return False
        if status:
            raw.judge(call, status)
        return True

    def _cannot(self, what: str, cure: str = "Export the model with this capability.") -> FMUError:
        return FMUError(Fault("E215", self.name, f"{self.place} {what}.", cure))

    # --- variables ----

    def size(self, variable: ModelVariable) -> int:
        """The number of elements, with the present structural parameters."""
        if not self._sizes or not variable.dimensions:
            return math.prod(variable.shape)
        return math.prod(self._dimension(dimension) for dimension in variable.dimensions)

    def _dimension(self, dimension: int | str) -> int:
        if isinstance(dimension, int):
            return dimension
        known = self._sizes.get(dimension)
        return int(self.description.names[dimension].start[0]) if known is None else known

    def set(self, variables: Iterable[ModelVariable], values: Iterable[Element]) -> None:
        """Set all elements of the variables. The same tuple of variables is quicker a second time.

        Raises:
            FMUError: E213 where the FMU refuses, E215 for a Binary or a Clock.
            SimulationError: E309 for a number that its type does not hold.
            UsageError: E501 for a value of the wrong kind, or too few or too many.
        """
        groups, n = self._plan(variables)
        row = values if isinstance(values, (tuple, list)) else list(values)
        if len(row) != n:
            message = f"{len(row)} values were given for {n} elements."
            raise UsageError(Fault("E501", self.name, message, "Give one value for each element."))
        for group in groups:
            if group.call in ("Real", "Float64"):
                given = row if len(groups) == 1 else [row[place] for place in group.places]
                try:
                    group.buffer[:] = given
                except TypeError:
                    group.buffer[:] = [self._element(*pair) for pair in zip(group.owners, given, strict=True)]
            else:
                held = (self._element(group.owners[k], row[place]) for k, place in enumerate(group.places))
                group.buffer[:] = list(held)
            self._move("Set", group)

    def get(self, variables: Iterable[ModelVariable]) -> list[Any]:
        """All elements of the variables. Raises FMUError: E213 where the FMU refuses, E215 for a Binary or a Clock."""
        groups, n = self._plan(variables)
        row: list[object] = [None] * n
        for group in groups:
            self._move("Get", group)
            elements: list[Any] = group.buffer[:]
            if group.call == "Boolean":
                elements = [bool(element) for element in elements]
            elif group.call == "String":
                elements = ["" if element is None else element.decode("utf-8", "replace") for element in elements]
            if len(groups) == 1:
                return elements
            for place, value in zip(group.places, elements, strict=True):
                row[place] = value
        return row

    def numbers(self, variables: Sequence[ModelVariable]) -> list[float] | None:
        """As `get`, for variables of numbers; None where the FMU discards it."""
        groups, n = self._plan(variables)
        row = [0.0] * n
        for group in groups:
            if not self.tried(f"Get{group.call}", group.references, *group.rest):
                return None
            if len(groups) == 1:
                return list(map(float, group.buffer))
            for place, value in zip(group.places, group.buffer, strict=True):
                row[place] = float(value)
        return row

    def set_numbers(self, variables: tuple[ModelVariable], values: Sequence[float]) -> None:
        """Set the elements of one variable; whole numbers are cut off, as in C. Raises FMUError (E213)."""
        for group in self._plan(variables)[0]:
            group.buffer[:] = values if variables[0].type in FLOATS else [int(value) for value in values]
            self.call(f"Set{group.call}", group.references, *group.rest)

    def configure(self, variables: Sequence[ModelVariable], values: Sequence[Element]) -> None:
        """Set structural parameters of FMI 3, before initialization: they are sizes of arrays.

        Raises FMUError (E213; E215 for FMI 2)."""
        if self.fmi == 2:
            raise self._cannot("is an FMU of FMI 2, in which arrays have fixed sizes", "Export it as FMI 3.")
        self.call("EnterConfigurationMode")
        self.set(variables, values)
        self.call("ExitConfigurationMode")
        self._sizes.update((variable.name, index(value)) for variable, value in zip(variables, values, strict=True))  # type: ignore[arg-type]
        self._plans.clear()

    def _plan(self, variables: Iterable[ModelVariable]) -> tuple[list[_VariableGroup], int]:
        """The calls that transfer variables, and the number of elements."""
        known = self._plans.get(id(variables))
        if known is not None:
            return known[1], known[2]
        row = tuple(variables)
        groups: dict[str, _VariableGroup] = {}
        n = 0
        for variable in row:
            call = call_of(variable.type, self.fmi)
            if not call:
                what = f"has the {variable.type} {variable.name}, a type that blocks cannot set or read"
                raise self._cannot(what, "Leave it out, or export the model without it.")
            group = groups.setdefault(call, _VariableGroup(call))
            size = self.size(variable)
            group.variables.append(variable)
            group.places.extend(range(n, n + size))
            group.owners.extend([variable] * size)
            n += size
        for group in groups.values():
            count = len(group.variables)
            group.references = (ctypes.c_uint * count)(*(variable.reference for variable in group.variables))
            group.buffer = (c_type(group.call, self.fmi) * len(group.places))()
            group.rest = (count, group.buffer) if self.fmi == 2 else (count, group.buffer, len(group.places))
        filled_groups = [group for group in groups.values() if group.places]
        # A tuple cannot change: its id identifies it as long as it is kept.
        if isinstance(variables, tuple):
            if len(self._plans) > 200:
                self._plans.clear()
            self._plans[id(variables)] = (variables, filled_groups, n)
        return filled_groups, n

    def _move(self, way: str, group: _VariableGroup) -> None:
        raw = self._alive()
        name = f"fmi{self.fmi}{way}{group.call}"
        status = raw.status(name, raw.component, group.references, *group.rest)
        if status:
            raw.judge(name, status, some(group.variables))

    def _element(self, variable: ModelVariable, value: Any) -> Any:
        """A value as its type holds it; ctypes would cut off what is too large."""
        kind = variable.type
        try:
            if kind == "String":
                if not isinstance(value, str) or "\0" in value:
                    raise TypeError
                return value.encode()
            if isinstance(value, str):
                raise TypeError
            if kind == "Boolean":
                return bool(value)
            if kind in FLOATS:
                number = float(value)
                if kind == "Float32" and _LARGEST_FLOAT32 <= abs(number) < math.inf:
                    raise OverflowError
                return number
            whole = int(value) if isinstance(value, float) and value.is_integer() else index(value)
            low, high = limits_of(kind, self.fmi)
            if not low <= whole <= high:
                raise OverflowError
            return whole
        except OverflowError:
            message = f"{variable.name} of {self.place} is of type {kind}, whose range does not include {value!r}."
            raise SimulationError(Fault("E309", self.name, message, "Limit the value with a Saturation.")) from None
        except (TypeError, ValueError):
            message = f"{variable.name} of {self.place} is of type {kind}, but {value!r} is not."
            raise UsageError(Fault("E501", self.name, message, "Give a value of that type.")) from None

    def set_input_derivatives(self, variables: Sequence[ModelVariable], order: int, values: Sequence[float]) -> None:
        """Derivatives of inputs of FMI 2 by time, for the next step. Raises FMUError (E213; E215 in FMI 3)."""
        if self.fmi == 3:
            raise self._cannot("is an FMU of FMI 3, which has no derivatives of inputs", "Use the intermediate update.")
        n = len(variables)
        references = (ctypes.c_uint * n)(*(variable.reference for variable in variables))
        self.call("SetRealInputDerivatives", references, n, (ctypes.c_int * n)(*[order] * n), _doubles(values))

    def directional(
        self, unknowns: Sequence[ModelVariable], knowns: Sequence[ModelVariable], seed: Sequence[float]
    ) -> list[float] | None:
        """The derivative of the unknowns in the direction `seed` of the knowns; None where the FMU discards it. Raises
        FMUError (E213)."""
        sensitivity = (ctypes.c_double * sum(map(self.size, unknowns)))()
        row = _doubles(seed)
        left = (ctypes.c_uint * len(unknowns))(*(unknown.reference for unknown in unknowns))
        right = (ctypes.c_uint * len(knowns))(*(known.reference for known in knowns))
        rest = (row, *self._count(row), sensitivity, *self._count(sensitivity))
        if not self.tried("GetDirectionalDerivative", left, len(left), right, len(right), *rest):
            return None
        return sensitivity[:]

    def _count(self, row: Any) -> tuple[int, ...]:
        """The number of values, which FMI 3 is told and FMI 2 is not."""
        return () if self.fmi == 2 else (len(row),)

    # --- its life ----

    def set_up_experiment(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """Times and tolerance of a run, given before values are set: some FMUs of FMI 2 reset all values to those of
        their description then. (FMI 3 takes them with the initialization only.) Raises FMUError (E213)."""
        self._alive().t = start
        if self.fmi == 2:
            self.call("SetupExperiment", *_experiment(start, stop, tolerance))
        self._is_set_up = True

    def enter_initialization(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """To initialization mode, after `set_up_experiment` with the same. Raises FMUError (E213)."""
        if not self._is_set_up:
            self.set_up_experiment(start, stop, tolerance)
        if self.fmi == 2:
            self.call("EnterInitializationMode")
        else:
            self.call("EnterInitializationMode", *_experiment(start, stop, tolerance))

    def exit_initialization(self) -> None:
        """To event mode where there is one, else to steps. Raises FMUError (E213)."""
        self.call("ExitInitializationMode")
        self._raw.must_terminate = True
        self._raw.has_begun = self.kind == "CS" and not self.event_mode

    def terminate(self) -> None:
        """Ends the run; values can still be read. Raises FMUError (E213)."""
        self._alive().must_terminate = False
        self.call("Terminate")

    def close(self) -> None:
        """Frees the instance, whatever happened before; once more does nothing."""
        self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # --- Co-Simulation ----

    def step(self, t: float, h: float) -> StepResult:
        """A communication step from t to t + h, in s.

        Raises FMUError: E213 where it fails, E214 where it ends early or stays pending and must not."""
        raw = self._alive()
        raw.t = t
        # A saved state may be restored; an FMU that knows that none will be can discard its own.
        forgets = not raw.saved
        if self.fmi == 2:
            return self._step_2(raw, t, h, forgets)
        event, terminate, early = self._flags[:3]
        event.value = terminate.value = early.value = False
        self._time.value = t + h
        refs = self._refs
        status = raw.status("fmi3DoStep", raw.component, t, h, forgets, refs[0], refs[1], refs[2], refs[5])
        if status not in (calls.OK, calls.DISCARD):
            raw.judge("fmi3DoStep", status)
        last = self._time.value
        is_discarded = status == calls.DISCARD
        if early.value or is_discarded:
            if not _within(t, last, h):
                if not is_discarded:
                    raise self.broken(
                        "fmi3DoStep", f"ended at {last:.10g} s, which is outside the step to {t + h:.10g} s"
                    )
                return StepResult(None, event.value, terminate.value, False, True)
            if early.value and not is_discarded and not (self.early_return or terminate.value):
                raise self.broken("fmi3DoStep", f"ended early, at {last:.10g} s, although early return was not allowed")
        elif not (terminate.value and t <= last <= t + h):  # where it ended the run, it names the time
            last = t + h
        if event.value and not self.event_mode:
            raw.warn(f"fmi3DoStep of {self.place} requested event mode{raw.when}, which this run does not use.")
            event.value = False
        raw.t = last
        return StepResult(last, event.value, terminate.value, early.value and not is_discarded, is_discarded)

    def _step_2(self, raw: Running, t: float, h: float, forgets: bool) -> StepResult:
        status = raw.status("fmi2DoStep", raw.component, t, h, forgets)
        if status == calls.PENDING:
            status = calls.settled(raw, self.timeout)
            if status == calls.PENDING:
                raise self.still_pending(self.timeout)
        if status in (calls.OK, calls.WARNING):
            if status:
                raw.judge("fmi2DoStep", status)
            raw.t = t + h
            return StepResult(t + h)
        if status != calls.DISCARD:
            raw.judge("fmi2DoStep", status)
        last = self._asked("fmi2GetRealStatus", 2, ctypes.c_double(math.nan))
        terminate = self._asked("fmi2GetBooleanStatus", 3, ctypes.c_int(0))
        known = last is not None and _within(t, last, h)
        if known:
            raw.t = last
        return StepResult(last if known else None, False, bool(terminate), False, True)

    def _asked(self, name: str, kind: int, value: Any) -> Any:
        """What the FMU reports of a step that it did not finish; None where it reports nothing."""
        raw = self._raw
        words = raw.said_before
        try:
            status = raw.status(name, raw.component, kind, ctypes.byref(value))
        except FMUError:
            return None
        if status == calls.FATAL:
            raw.judge(name, status)
        raw.said_before = words  # the words are still those about the step
        return value.value if status in (calls.OK, calls.WARNING) else None

    def broken(self, name: str, what: str) -> FMUError:
        """The error (E214) of a function that did what the standard does not let it do."""
        raw = self._raw
        raw.has_failed = True
        message = f"{name} of {self.place}{raw.when} {what}.{raw.words()}"
        return FMUError(Fault("E214", self.name, message, "Report it to the FMU's vendor, or try another export."))

    def still_pending(self, seconds: float) -> FMUError:
        """The error (E214) of a step that was not done after so long."""
        self._raw.is_pending = True
        return self.broken("fmi2DoStep", f"stayed pending for {seconds:g} s")

    def enter_step_mode(self) -> None:
        """From event mode to steps, FMI 3. Raises FMUError (E213)."""
        self.call("EnterStepMode")
        self._raw.has_begun = True

    # --- events ----

    def enter_event_mode(self) -> None:
        """Raises FMUError (E213)."""
        self.call("EnterEventMode")

    def update_discrete_states(self) -> Events:
        """One iteration of event mode. Raises FMUError (E213)."""
        if self.fmi == 2:
            from fmpy.fmi2 import fmi2EventInfo

            told = fmi2EventInfo()
            self.call("UpdateDiscreteStates", ctypes.byref(told))
            return Events(
                bool(told.newDiscreteStatesNeeded), bool(told.terminateSimulation),
                bool(told.nominalsOfContinuousStatesChanged), bool(told.valuesOfContinuousStatesChanged),
                told.nextEventTime if told.nextEventTimeDefined else None,
            )  # fmt: skip
        for flag in self._flags:
            flag.value = False
        self.call("UpdateDiscreteStates", *self._refs)
        needs, terminate, nominals, states, has_next = (flag.value for flag in self._flags)
        return Events(needs, terminate, nominals, states, self._time.value if has_next else None)

    # --- Model Exchange ----

    def enter_continuous_mode(self) -> None:
        """From event mode to continuous time. Raises FMUError (E213)."""
        self.call("EnterContinuousTimeMode")
        self._raw.has_begun = True

    def completed_step(self, *, forgets: bool | None = None) -> tuple[bool, bool]:
        """Reports an accepted step; whether event mode and whether the end is asked for. Raises FMUError (E213).

        forgets: whether no saved state will be restored; None: whether there is none."""
        if not self.interface.completed_step:
            return False, False
        raw = self._alive()
        kind = ctypes.c_int if self.fmi == 2 else ctypes.c_bool
        event, terminate = kind(0), kind(0)
        forgets = not raw.saved if forgets is None else forgets
        self.call("CompletedIntegratorStep", forgets, ctypes.byref(event), ctypes.byref(terminate))
        return bool(event.value), bool(terminate.value)

    # --- saved states ----

    def save(self, into: Saved | None = None) -> Saved:
        """The present state of the FMU. into: one that is overwritten.

        It is tried whatever the FMU says of itself. Raises FMUError (E215) where it cannot, E213 after a fatal error.
        """
        raw = self._alive()
        saved = into or Saved(ctypes.c_void_p(), raw.t, raw.must_terminate)
        # Known before the call: whatever comes between, it is freed with the instance.
        raw.saved.add(saved)
        name = full_name("GetFMUState", self.fmi)
        try:
            self._kept(name, ctypes.byref(saved.state))
            if saved.state.value is None:
                raise self._cannot(f"cannot be rolled back: {name} returned nothing", _NO_ROLLBACK)
        except BaseException:
            if saved.state.value is None:
                raw.saved.discard(saved)
            raise
        saved.t, saved.must_terminate = raw.t, raw.must_terminate
        return saved

    def restore(self, saved: Saved) -> None:
        """The state as it was saved; it can be set again. Raises FMUError (E215)."""
        raw = self._alive()
        if saved not in raw.saved:
            raise ValueError(f"{self.name}: the state was forgotten, or is another instance's")
        self._kept(full_name("SetFMUState", self.fmi), saved.state)
        raw.t, raw.must_terminate, raw.has_failed = saved.t, saved.must_terminate, False

    def forget(self, saved: Saved) -> None:
        """Frees a saved state; once more, or after `close`, does nothing. Raises FMUError (E215)."""
        raw = self._raw
        if saved in raw.saved and raw.component is not None:
            raw.saved.discard(saved)
            if raw.is_lost:  # it went with the FMU
                return
            self._kept(full_name("FreeFMUState", self.fmi), ctypes.byref(saved.state))

    def _kept(self, name: str, *arguments: object) -> None:
        raw = self._raw
        failed = raw.has_failed
        try:
            raw._call(name, raw.component, *arguments)
        except FMUError as error:
            if raw.is_lost:
                raise
            # A capability that is not there is no failure of the run.
            raw.has_failed = failed
            raise self.not_rolled_back(error) from None

    def serialized(self) -> bytes:
        """The present state of the FMU, as bytes. Raises FMUError (E213)."""
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        self.call("GetFMUState", ctypes.byref(state))
        try:
            self.call("SerializedFMUStateSize", state, ctypes.byref(size))
            data = (self._byte * size.value)()
            self.call("SerializeFMUState", state, data, size.value)
        finally:
            self.call("FreeFMUState", ctypes.byref(state))
        return bytes(data)

    def deserialize(self, data: bytes) -> None:
        """Back to a state that `serialized` gave. Raises FMUError (E213)."""
        state = ctypes.c_void_p()
        held = (self._byte * len(data)).from_buffer_copy(data)
        self.call("DeserializeFMUState", held, len(data), ctypes.byref(state))
        try:
            self.call("SetFMUState", state)
        finally:
            self.call("FreeFMUState", ctypes.byref(state))

    @property
    def _byte(self) -> Any:
        return ctypes.c_char if self.fmi == 2 else ctypes.c_ubyte

    # --- calls of compiled code, which are told here ----

    def free_state(self, address: int) -> None:
        """Free a state that compiled code saved, where the instance is still there."""
        raw = self._raw
        if raw.component is not None and not raw.is_lost:
            state = ctypes.c_void_p(address)
            raw._quietly(full_name("FreeFMUState", self.fmi), raw.component, ctypes.byref(state))

    def hand_over(self, *, has_begun: bool = False) -> None:
        """Compiled code may end the initialization: the run must be terminated at its end. has_begun: it did."""
        self._raw.must_terminate, self._raw.has_begun = True, has_begun

    def raise_inside(self) -> None:
        """Raise what was raised in a callback, while compiled code called."""
        if self._raw.raised is not None:
            error, self._raw.raised = self._raw.raised, None
            raise error

    def forget_words(self) -> None:
        """What the FMU said until now does not belong to later calls."""
        self._raw.said_before = self._raw.said

    def judge(self, name: str, status: int, t: float, about: str = "", *, has_begun: bool = False) -> None:
        """Take the status that a function, of its full name, gave at t: a warning is remembered. about: the variables.

        Raises FMUError as `call` for every other status but ok."""
        self._raw.t = t
        self._raw.has_begun = self._raw.has_begun or has_begun
        self._raw.judge(name, status, about)

    def excused(self, fault: Fault) -> None:
        """The failure of the last call is none of the run: it is told as this warning."""
        self._raw.has_failed = False
        self._raw.warnings.append(fault)

    def not_rolled_back(self, error: FMUError) -> FMUError:
        """What the error of a call that saves, restores or frees a state means."""
        cause = error.faults[0].message.rstrip(".")
        return self._cannot(f"cannot be rolled back: {cause}", _NO_ROLLBACK)


_NO_ROLLBACK = 'Use the algorithm "jacobi" or "gauss-seidel", and no tolerance of the master (--master).'


def some(variables: Sequence[ModelVariable]) -> str:
    """Variables of a call, for messages."""
    names = [variable.name for variable in variables]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _within(t: float, last: float, h: float) -> bool:
    """Whether a time lies in a step, but for rounding."""
    slack = 1e-9 * abs(h) + 4 * math.ulp(t + h)
    return t - slack <= last <= t + h + slack


def _experiment(start: float, stop: float | None, tolerance: float | None) -> tuple[bool, float, float, bool, float]:
    """The arguments as both standards take them."""
    return tolerance is not None, tolerance or 0.0, start, stop is not None, stop or 0.0


def _doubles(values: Sequence[float]) -> object:
    return (ctypes.c_double * len(values))(*values)


def _weakly(
    ref: weakref.ref[Instance], called: Callable[[float, Instance], float | None]
) -> Callable[[float], float | None]:
    def intermediate(t: float) -> float | None:
        instance = ref()
        return None if instance is None else called(t, instance)

    return intermediate
