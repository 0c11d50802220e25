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
from typing import Any, NamedTuple, Self

from ..text.errors import Fault, FMUError, SimulationError, UsageError
from . import calls
from .calls import Message, Running, running
from .library import claimed, function
from .loading import Loaded, open_fmu
from .schema import CALLS, FLOATS, INTEGERS, Variable

__all__ = ["PATIENCE", "Ended", "Events", "Instance", "Loaded", "Message", "Saved", "Step", "ended", "open_fmu", "some"]

PATIENCE = 10.0
"""s; how long a step may stay pending."""

Element = float | int | bool | str

_OF_3 = {
    "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Int8": ctypes.c_int8, "UInt8": ctypes.c_uint8,
    "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16, "Int32": ctypes.c_int32, "UInt32": ctypes.c_uint32,
    "Int64": ctypes.c_int64, "UInt64": ctypes.c_uint64, "Boolean": ctypes.c_bool, "String": ctypes.c_char_p,
}  # fmt: skip
_OF_2 = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int, "String": ctypes.c_char_p}
_LARGEST_FLOAT32 = 3.4028235677973366e38  # what is larger is rounded to infinity


class Step(NamedTuple):
    """What a step came to. last_time: up to where it went; None where it was discarded and the FMU does not say.

    early: it ended before its end, as was allowed; discarded: it could not be done.
    """

    last_time: float | None
    event_needed: bool = False
    terminate: bool = False
    early: bool = False
    discarded: bool = False


class Events(NamedTuple):
    """What an update of discrete states came to. next_time: of the next event, in s; None where there is none."""

    needs_update: bool
    terminate: bool
    nominals_changed: bool
    states_changed: bool
    next_time: float | None


class Ended(FMUError):
    """An FMU ended the run, inside of a run that only others can end: no failure. It holds what `ended` says."""


def ended(name: str, place: str, t: float, words: str) -> Fault:
    """That an FMU ended the run, as the standards let it (W206). words: its own, as sentences to append."""
    message = f"{place} ended the run at t = {t:.10g} s.{words}"
    return Fault("W206", name, message, "What was computed up to there holds.")


@dataclass(slots=True, eq=False)
class Saved:
    """A state of an FMU, in its own memory. t: of the instance then."""

    state: ctypes.c_void_p
    t: float
    must_terminate: bool


@dataclass(slots=True)
class _Group:
    """Variables that one call moves. places: of the elements among those of all variables."""

    type: str
    call: str
    variables: list[Variable] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    owners: list[Variable] = field(default_factory=list)
    references: Any = None
    buffer: Any = None
    rest: tuple[Any, ...] = ()


class Instance:
    """An instance of what is loaded; freed by `close`, when nobody refers to it, and at the interpreter's exit.

    event_mode, early_return: of FMI 3 Co-Simulation. intermediate(t, instance) is called within steps; what it returns
    is when the step shall end, None: not before its end. intermediate_variables: what it sets and reads. update: the
    address of a function of compiled code in its place.
    log: hears each message; with it the FMU is asked for all that it can say, else for what tells of failures.
    timeout: s; how long a step may stay pending.

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
        intermediate_variables: Sequence[Variable] = (),
        update: int = 0,
        log: Callable[[Message], None] | None = None,
        timeout: float = PATIENCE,
    ) -> None:
        binding = loaded.binding
        self.name, self.place, self.timeout = name, loaded.place, timeout
        self.description, self.interface = binding.description, binding.interface
        self.fmi, self.kind = self.description.fmi, self.interface.kind
        self.event_mode, self.early_return = event_mode, early_return
        self._raw: Any = running(binding, name, loaded.place, log)
        self._prefix = f"fmi{self.fmi}"
        self._sizes: dict[str, int] = {}
        self._plans: dict[int, tuple[tuple[Variable, ...], list[_Group], int]] = {}
        self._flags: Any = [ctypes.c_bool() for _ in range(5)]
        self._time: Any = ctypes.c_double()
        self._refs: list[Any] = [ctypes.byref(one) for one in (*self._flags, self._time)]
        self._vectors: dict[str, Any] = {}
        self._is_set_up = False  # whether it knows of its run

        held = self._raw.held
        held.callback(loaded.again().close)
        # It must not know this object, which else would never be forgotten.
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
        """Of the function of that name, as "fmi3DoStep". Raises FMUError (E208)."""
        found = ctypes.cast(function(self._alive().binding.library, name, self.place), ctypes.c_void_p).value
        assert found is not None
        return found

    @property
    def messages(self) -> tuple[Message, ...]:
        """The last that the FMU said."""
        return tuple(self._raw.messages)

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """W203, one for each kind of warning that calls gave."""
        return tuple(self._raw.warnings)

    @property
    def t(self) -> float:
        """The time of the last call, in s; not a number before initialization."""
        return self._raw.t  # type: ignore[no-any-return]

    @property
    def words(self) -> str:
        """The FMU's own words at the last call, as they stand in errors."""
        return self._raw.words()  # type: ignore[no-any-return]

    def _alive(self) -> Any:
        if self._raw.component is None:
            raise ValueError(f"{self.name}: the instance was closed")
        return self._raw

    def _do(self, name: str, *arguments: Any) -> None:
        """A call that must succeed."""
        raw = self._alive()
        raw._call(self._prefix + name, raw.component, *arguments)

    def _cannot(self, what: str, cure: str = "Export the model so that the FMU can do it.") -> FMUError:
        return FMUError(Fault("E215", self.name, f"{self.place} {what}.", cure))

    # --- variables ----

    def size(self, variable: Variable) -> int:
        """The number of elements, with the structural parameters as they are."""
        if not self._sizes or not variable.dimensions:
            return math.prod(variable.shape)
        return math.prod(self._dimension(one) for one in variable.dimensions)

    def _dimension(self, one: int | str) -> int:
        if isinstance(one, int):
            return one
        known = self._sizes.get(one)
        return int(self.description.names[one].start[0]) if known is None else known

    def set(self, variables: Iterable[Variable], values: Iterable[Element]) -> None:
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
            if group.type == "Float64":
                given = row if len(groups) == 1 else [row[place] for place in group.places]
                try:
                    group.buffer[:] = given
                except TypeError:
                    group.buffer[:] = [self._element(*one) for one in zip(group.owners, given, strict=True)]
            else:
                held = (self._element(group.owners[k], row[place]) for k, place in enumerate(group.places))
                group.buffer[:] = list(held)
            self._move("Set", group)

    def get(self, variables: Iterable[Variable]) -> list[Any]:
        """All elements of the variables. Raises FMUError: E213 where the FMU refuses, E215 for a Binary or a Clock."""
        groups, n = self._plan(variables)
        row: list[Any] = [None] * n
        for group in groups:
            self._move("Get", group)
            found: list[Any] = group.buffer[:]
            if group.type == "Boolean":
                found = [bool(one) for one in found]
            elif group.type == "String":
                found = ["" if one is None else one.decode("utf-8", "replace") for one in found]
            if len(groups) == 1:
                return found
            for place, value in zip(group.places, found, strict=True):
                row[place] = value
        return row

    def configure(self, variables: Sequence[Variable], values: Sequence[Element]) -> None:
        """Set structural parameters of FMI 3, before initialization: they are sizes of arrays.

        Raises FMUError (E213; E215 for FMI 2)."""
        if self.fmi == 2:
            raise self._cannot("is of FMI 2, where arrays have fixed sizes")
        self._do("EnterConfigurationMode")
        self.set(variables, values)
        self._do("ExitConfigurationMode")
        self._sizes.update((variable.name, index(value)) for variable, value in zip(variables, values, strict=True))  # type: ignore[arg-type]
        self._plans.clear()
        self._vectors.clear()

    def _plan(self, variables: Iterable[Variable]) -> tuple[list[_Group], int]:
        """The calls that move variables, and the number of elements."""
        known = self._plans.get(id(variables))
        if known is not None:
            return known[1], known[2]
        row = tuple(variables)
        groups: dict[str, _Group] = {}
        n = 0
        for variable in row:
            if variable.type not in _OF_3 and variable.type != "Enumeration":
                what = f"has the {variable.type} {variable.name}, which is not moved"
                raise self._cannot(what, "Leave it out, or export the model without it.")
            kind = CALLS[variable.type] if self.fmi == 2 else variable.type
            kind = "Int64" if kind == "Enumeration" else kind
            group = groups.setdefault(kind, _Group(self._type(kind), kind))
            size = self.size(variable)
            group.variables.append(variable)
            group.places.extend(range(n, n + size))
            group.owners.extend([variable] * size)
            n += size
        for kind, group in groups.items():
            found: Any = (_OF_2 if self.fmi == 2 else _OF_3)[kind]
            count = len(group.variables)
            group.references = (ctypes.c_uint * count)(*(one.reference for one in group.variables))
            group.buffer = (found * len(group.places))()
            group.rest = (count, group.buffer) if self.fmi == 2 else (count, group.buffer, len(group.places))
        made = [group for group in groups.values() if group.places]
        # What cannot change is known by what it is, as long as it is kept.
        if isinstance(variables, tuple):
            if len(self._plans) > 200:
                self._plans.clear()
            self._plans[id(variables)] = (variables, made, n)
        return made, n

    def _type(self, kind: str) -> str:
        return {"Real": "Float64", "Integer": "Int32"}.get(kind, kind)

    def _move(self, way: str, group: _Group) -> None:
        raw = self._alive()
        name = f"{self._prefix}{way}{group.call}"
        status = raw.status(name, raw.component, group.references, *group.rest)
        if status:
            raw.judge(name, status, some(group.variables))

    def _element(self, variable: Variable, value: Any) -> Any:
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
            low, high = INTEGERS["Int64" if kind == "Enumeration" and self.fmi == 3 else kind.replace(*_MEMBER)]
            if not low <= whole <= high:
                raise OverflowError
            return whole
        except OverflowError:
            message = f"{variable.name} of {self.place} is of type {kind}, which does not hold {value!r}."
            raise SimulationError(Fault("E309", self.name, message, "Limit the value.")) from None
        except (TypeError, ValueError):
            message = f"{variable.name} of {self.place} is of type {kind}, and {value!r} is not."
            raise UsageError(Fault("E501", self.name, message, "Give a value of that type.")) from None

    def set_input_derivatives(self, variables: Sequence[Variable], order: int, values: Sequence[float]) -> None:
        """Derivatives of inputs of FMI 2 by time, for the next step. Raises FMUError (E213; E215 in FMI 3)."""
        if self.fmi == 3:
            raise self._cannot("is of FMI 3, which has no derivatives of inputs", "Use the intermediate update.")
        n = len(variables)
        references = (ctypes.c_uint * n)(*(one.reference for one in variables))
        self._do("SetRealInputDerivatives", references, n, (ctypes.c_int * n)(*[order] * n), _doubles(values))

    def output_derivatives(self, variables: Sequence[Variable], order: int) -> list[float]:
        """Derivatives of outputs at the end of the last step. Raises FMUError (E213)."""
        n = len(variables)
        references = (ctypes.c_uint * n)(*(one.reference for one in variables))
        orders, row = (ctypes.c_int * n)(*[order] * n), (ctypes.c_double * sum(map(self.size, variables)))()
        if self.fmi == 2:
            self._do("GetRealOutputDerivatives", references, n, orders, row)
        else:
            self._do("GetOutputDerivatives", references, n, orders, row, len(row))
        return row[:]

    def directional(
        self, unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float]
    ) -> list[float]:
        """The derivative of the unknowns in the direction `seed` of the knowns. Raises FMUError (E213)."""
        found = (ctypes.c_double * sum(map(self.size, unknowns)))()
        row = _doubles(seed)
        left = (ctypes.c_uint * len(unknowns))(*(one.reference for one in unknowns))
        right = (ctypes.c_uint * len(knowns))(*(one.reference for one in knowns))
        if self.fmi == 2:
            self._do("GetDirectionalDerivative", left, len(left), right, len(right), row, found)
        else:
            rest = (row, len(row), found, len(found))
            self._do("GetDirectionalDerivative", left, len(left), right, len(right), *rest)
        return found[:]

    # --- its life ----

    def set_up_experiment(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """What a run will be, told before values are set: some FMUs of FMI 2 put all values back to those of their
        description then. (FMI 3 tells it with the initialization alone.) Raises FMUError (E213)."""
        self._alive().t = start
        if self.fmi == 2:
            self._do("SetupExperiment", *_experiment(start, stop, tolerance))
        self._is_set_up = True

    def enter_initialization(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """To initialization mode, after `set_up_experiment` with the same. Raises FMUError (E213)."""
        if not self._is_set_up:
            self.set_up_experiment(start, stop, tolerance)
        if self.fmi == 2:
            self._do("EnterInitializationMode")
        else:
            self._do("EnterInitializationMode", *_experiment(start, stop, tolerance))

    def exit_initialization(self) -> None:
        """To event mode where there is one, else to steps. Raises FMUError (E213)."""
        self._do("ExitInitializationMode")
        self._raw.must_terminate = True
        self._raw.has_begun = self.kind == "CS" and not self.event_mode

    def terminate(self) -> None:
        """Ends the run; values can still be read. Raises FMUError (E213)."""
        self._alive().must_terminate = False
        self._do("Terminate")

    def reset(self) -> None:
        """Back to how it was when it was made, also after an error. Raises FMUError (E213)."""
        raw = self._alive()
        raw.must_terminate = raw.has_begun = self._is_set_up = False
        self._do("Reset")
        raw.t, raw.has_failed = math.nan, False

    def close(self) -> None:
        """Frees the instance, whatever happened before; once more does nothing."""
        self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # --- Co-Simulation ----

    def step(self, t: float, h: float) -> Step:
        """A communication step from t to t + h, in s.

        Raises FMUError: E213 where it fails, E214 where it ends early or stays pending and must not."""
        raw = self._alive()
        raw.t = t
        # A state of before may be set again; an FMU that knows that none will be can forget.
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
                    raise self._broken(
                        "fmi3DoStep", f"ended at {last:.10g} s, which is not in the step to {t + h:.10g} s"
                    )
                return Step(None, event.value, terminate.value, False, True)
            if early.value and not is_discarded and not (self.early_return or terminate.value):
                raise self._broken("fmi3DoStep", f"ended early, at {last:.10g} s, which was not allowed")
        else:
            last = t + h
        if event.value and not self.event_mode:
            raw.warn(f"fmi3DoStep of {self.place} asked for event mode{raw.when}, which is not used.")
            event.value = False
        raw.t = last
        return Step(last, event.value, terminate.value, early.value and not is_discarded, is_discarded)

    def _step_2(self, raw: Running, t: float, h: float, forgets: bool) -> Step:
        status = raw.status("fmi2DoStep", raw.component, t, h, forgets)
        if status == calls.PENDING:
            status = calls.settled(raw, self.timeout)
            if status == calls.PENDING:
                raw.has_failed = True
                raise self._broken("fmi2DoStep", f"stayed pending for {self.timeout:g} s")
        if status in (calls.OK, calls.WARNING):
            if status:
                raw.judge("fmi2DoStep", status)
            raw.t = t + h
            return Step(t + h)
        if status != calls.DISCARD:
            raw.judge("fmi2DoStep", status)
        last = self._asked("fmi2GetRealStatus", 2, ctypes.c_double(math.nan))
        terminate = self._asked("fmi2GetBooleanStatus", 3, ctypes.c_int(0))
        known = last is not None and _within(t, last, h)
        if known:
            raw.t = last
        return Step(last if known else None, False, bool(terminate), False, True)

    def _asked(self, name: str, kind: int, value: Any) -> Any:
        """What the FMU tells of a step that it did not finish; None where it does not tell."""
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

    def _broken(self, name: str, what: str) -> FMUError:
        raw = self._raw
        raw.has_failed = True
        message = f"{name} of {self.place}{raw.when} {what}.{raw.words()}"
        return FMUError(Fault("E214", self.name, message, "Tell its maker; another export may do better."))

    def enter_step_mode(self) -> None:
        """From event mode to steps, FMI 3. Raises FMUError (E213)."""
        self._do("EnterStepMode")
        self._raw.has_begun = True

    # --- events ----

    def enter_event_mode(self) -> None:
        """Raises FMUError (E213)."""
        self._do("EnterEventMode")

    def update_discrete_states(self) -> Events:
        """One iteration of event mode. Raises FMUError (E213)."""
        if self.fmi == 2:
            from fmpy.fmi2 import fmi2EventInfo

            told = fmi2EventInfo()
            self._do("NewDiscreteStates", ctypes.byref(told))
            return Events(
                bool(told.newDiscreteStatesNeeded), bool(told.terminateSimulation),
                bool(told.nominalsOfContinuousStatesChanged), bool(told.valuesOfContinuousStatesChanged),
                told.nextEventTime if told.nextEventTimeDefined else None,
            )  # fmt: skip
        for flag in self._flags:
            flag.value = False
        self._do("UpdateDiscreteStates", *self._refs)
        needs, terminate, nominals, states, has_next = (flag.value for flag in self._flags)
        return Events(needs, terminate, nominals, states, self._time.value if has_next else None)

    # --- Model Exchange ----

    def enter_continuous_mode(self) -> None:
        """From event mode to continuous time. Raises FMUError (E213)."""
        self._do("EnterContinuousTimeMode")
        self._raw.has_begun = True

    def set_time(self, t: float) -> None:
        """Raises FMUError (E213)."""
        self._alive().t = t
        self._do("SetTime", t)

    def _vector(self, what: str) -> Any:
        """The buffer of that vector."""
        found = self._vectors.get(what)
        if found is None:
            if what == "indicators":
                of = [one.variable for one in self.description.structure.indicators]
                n = self.description.indicators if self.fmi == 2 else sum(map(self.size, of))
            else:
                n = sum(map(self.size, self.description.structure.states))
            found = self._vectors[what] = (ctypes.c_double * n)()
        return found

    def _read(self, what: str, name: str) -> list[float]:
        row = self._vector(what)
        if len(row):
            self._do(name, row, len(row))
        return row[:]  # type: ignore[no-any-return]

    def set_states(self, x: Sequence[float]) -> None:
        """Raises FMUError (E213), UsageError (E501) for another number of states."""
        row = self._vector("states")
        if len(x) != len(row):
            message = f"{len(x)} values were given for {len(row)} continuous states."
            raise UsageError(Fault("E501", self.name, message, "Give one value for each state."))
        if len(row):
            row[:] = x if isinstance(x, (list, tuple)) else [float(one) for one in x]
            self._do("SetContinuousStates", row, len(row))

    def states(self) -> list[float]:
        """Raises FMUError (E213)."""
        return self._read("states", "GetContinuousStates")

    def rates(self) -> list[float]:
        """The derivatives of the states by time. Raises FMUError (E213)."""
        return self._read("rates", "GetDerivatives" if self.fmi == 2 else "GetContinuousStateDerivatives")

    def nominals(self) -> list[float]:
        """Magnitudes of the states. Raises FMUError (E213)."""
        return self._read("nominals", "GetNominalsOfContinuousStates")

    def indicators(self) -> list[float]:
        """What changes its sign at an event. Raises FMUError (E213)."""
        return self._read("indicators", "GetEventIndicators")

    def completed_step(self) -> tuple[bool, bool]:
        """Tell of an accepted step: whether event mode and whether the end is asked for. Raises FMUError (E213)."""
        if not self.interface.completed_step:
            return False, False
        raw = self._alive()
        kind = ctypes.c_int if self.fmi == 2 else ctypes.c_bool
        event, terminate = kind(0), kind(0)
        self._do("CompletedIntegratorStep", not raw.saved, ctypes.byref(event), ctypes.byref(terminate))
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
        name = "fmi2GetFMUstate" if self.fmi == 2 else "fmi3GetFMUState"
        try:
            self._kept(name, ctypes.byref(saved.state))
            if saved.state.value is None:
                raise self._cannot(f"cannot be rolled back: {name} gave nothing", _NO_ROLLBACK)
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
        self._kept("fmi2SetFMUstate" if self.fmi == 2 else "fmi3SetFMUState", saved.state)
        raw.t, raw.must_terminate, raw.has_failed = saved.t, saved.must_terminate, False

    def forget(self, saved: Saved) -> None:
        """Frees a saved state; once more, or after `close`, does nothing. Raises FMUError (E215)."""
        raw = self._raw
        if saved in raw.saved and raw.component is not None:
            raw.saved.discard(saved)
            if raw.is_lost:  # it went with the FMU
                return
            self._kept("fmi2FreeFMUstate" if self.fmi == 2 else "fmi3FreeFMUState", ctypes.byref(saved.state))

    def _kept(self, name: str, *arguments: Any) -> None:
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

    def not_rolled_back(self, error: FMUError) -> FMUError:
        """What the error of a call that saves, restores or frees a state means."""
        cause = error.faults[0].message.rstrip(".")
        return self._cannot(f"cannot be rolled back: {cause}", _NO_ROLLBACK)


_NO_ROLLBACK = 'Use the algorithm "jacobi" or "gauss-seidel", and no tolerance of the master (--master).'
_MEMBER = ("Enumeration", "Int32")


def some(variables: Sequence[Variable]) -> str:
    """Variables of a call, for messages."""
    names = [variable.name for variable in variables]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _within(t: float, last: float, h: float) -> bool:
    """Whether a time lies in a step, but for rounding."""
    slack = 1e-9 * abs(h) + 4 * math.ulp(t + h)
    return t - slack <= last <= t + h + slack


def _experiment(start: float, stop: float | None, tolerance: float | None) -> tuple[bool, float, float, bool, float]:
    """As both standards take it."""
    return tolerance is not None, tolerance or 0.0, start, stop is not None, stop or 0.0


def _doubles(values: Sequence[float]) -> Any:
    return (ctypes.c_double * len(values))(*values)


def _weakly(
    ref: weakref.ref[Instance], called: Callable[[float, Instance], float | None]
) -> Callable[[float], float | None]:
    def intermediate(t: float) -> float | None:
        instance = ref()
        return None if instance is None else called(t, instance)

    return intermediate
