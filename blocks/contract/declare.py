"""The block contract: a class body lists variables and pure equations.

    class Lag(Block):
        \"\"\"T dy/dt = k u - y.\"\"\"
        k = Parameter(1.0)
        T = Parameter(1.0, unit="s", positive=True)
        u = Input()
        y = State(output=True)                      # start value: the parameter y_start

        @y.derivative
        def dy(y, u, k, T):
            return (k * u - y) / T

The signature of an equation is its declaration: it reads exactly the names of its arguments, which are variables,
outputs, locals, sides of crossings, and the reserved `t` (the time in s) and `tick` (the number of the tick).
An instance holds parameter values and nothing else. What a class body must not say is refused here, when the
class is declared; what needs numbers (shapes, ranges) is refused when an instance is made or a diagram flattened.

This file is longer than others because the words of the contract belong together.
"""

from __future__ import annotations

import copy
import enum
import inspect
import keyword
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import FunctionType, MappingProxyType
from typing import Any, ClassVar, NoReturn

import numpy as np

from ..text.errors import DeclarationError, Fault, ModelError, UsageError, did_you_mean
from ..text.units import parse as parse_unit
from .enumerations import Enumeration

__all__ = [
    "Algebraic",
    "Block",
    "Crossing",
    "Declaration",
    "Discrete",
    "Equation",
    "EventTime",
    "Given",
    "History",
    "Input",
    "Local",
    "Output",
    "Parameter",
    "Requirement",
    "State",
    "Stepped",
    "Stepper",
    "crossing",
    "event_time",
    "local",
    "output",
    "requires",
    "stepper",
    "wiring",
]

RESERVED = frozenset({"t", "tick", "time", "name", "parameters", "declaration"})
"""Names that equations or users need for something else."""

_PYTHON_SETS = frozenset({
    *("__module__", "__qualname__", "__doc__", "__annotations__", "__annotate__", "__annotate_func__", "__classcell__"),
    *("__conditional_annotations__", "__classdictcell__", "__firstlineno__", "__static_attributes__"),
})  # fmt: skip

REQUIRED: Any = type("Required", (), {"__repr__": lambda self: "REQUIRED"})()
"""The default of a parameter that must be given."""

_VARIADIC = inspect.CO_VARARGS | inspect.CO_VARKEYWORDS

Function = Callable[..., Any]
Shape = int | str | tuple[int | str, ...] | Function


def _refuse(code: str, place: str, message: str, cure: str = "") -> NoReturn:
    raise DeclarationError(Fault(code, place, message, cure))


def arguments(function: Function, place: str) -> tuple[str, ...]:
    """The names that a function of the contract reads: plain arguments, nothing else."""
    if not callable(function):
        _refuse("E405", place, f"{function!r} is not a function.")
    if type(function) is FunctionType and not (function.__defaults__ or function.__kwdefaults__ or function.__dict__):
        # Most are plain functions, whose code tells the names a hundred times faster than inspect.
        code = function.__code__
        if not (code.co_flags & _VARIADIC or code.co_kwonlyargcount or code.co_posonlyargcount):
            return code.co_varnames[: code.co_argcount]
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        _refuse("E405", place, "the names of its arguments cannot be read.", "Wrap it in a def or a lambda.")
    for parameter in parameters:
        if parameter.kind is not parameter.POSITIONAL_OR_KEYWORD or parameter.default is not parameter.empty:
            _refuse(
                "E405",
                place,
                f"argument '{parameter}' is not a plain name: the arguments of an equation are what it reads.",
                "Write each name once, without * or a default.",
            )
    return tuple(parameter.name for parameter in parameters)


# --- variables -------------------------------------------------------------------------------------------------


class Variable:
    """Something with a name in a block class. Frozen once the class is declared."""

    name: str = ""
    kind: ClassVar[str] = ""
    is_declared: bool = False
    type: str
    members: Mapping[str, int] = MappingProxyType({})  # of an enumeration

    def __init__(self, unit: str | Function, shape: Shape, ports: str, doc: str) -> None:
        self.unit, self.shape, self.ports, self.doc = unit, shape, ports, doc

    def __setattr__(self, name: str, value: Any) -> None:
        if self.is_declared:
            raise AttributeError(f"{self!r} is declared and cannot be changed.")
        self.__dict__[name] = value  # an FMU has them by the hundred thousand

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return self
        raise AttributeError(name=self.name, obj=instance)  # Block.__getattr__ says more

    def __repr__(self) -> str:
        return f"<{self.kind} '{self.name}'>"

    def check(self, place: str) -> None:
        """Refuse what can be refused without numbers."""
        if isinstance(self.unit, str):
            try:
                if self.unit:
                    parse_unit(self.unit)
            except ModelError as error:
                fault = error.faults[0]
                _refuse("E405", place, f"unit {fault.message}", fault.cure)
        elif not callable(self.unit):
            _refuse("E405", place, f"unit={self.unit!r} is neither a text nor a function of structural parameters.")
        if self.ports and (self.ports.count("{}") != 1 or not self.ports.replace("{}", "1").isidentifier()):
            _refuse("E405", place, f"ports={self.ports!r} must be a name with {{}} for the number, as in 'u{{}}'.")
        sizes = self.shape if isinstance(self.shape, tuple) else (self.shape,)
        for size in sizes:
            if isinstance(size, bool) or not (
                callable(size)
                or (isinstance(size, int) and size >= 0)
                or (isinstance(size, str) and size.isidentifier() and isinstance(self, Parameter))
            ):
                _refuse(
                    "E405",
                    place,
                    f"shape={self.shape!r} is not a size, a tuple of sizes or a function of structural parameters.",
                )


Kind = str | type[enum.IntEnum] | Enumeration
"""The type of a variable: "real", "int", "bool", or an enumeration."""


def _checked_type(type_: Kind, allowed: tuple[str, ...], what: str) -> tuple[str, Mapping[str, int]]:
    """The type as a text, which two equal types share, and the members of an enumeration."""
    made = Enumeration.of(type_) if isinstance(type_, type) and issubclass(type_, enum.IntEnum) else type_
    if isinstance(made, Enumeration):
        if not made.members:
            _refuse("E405", "", f"the enumeration {made.name} has no members.")
        return made.text, MappingProxyType(dict(made.members))
    if type_ not in allowed:
        cure = f"Use one of {', '.join(repr(one) for one in allowed)}, or an enum.IntEnum."
        _refuse("E405", "", f"type={type_!r} is not a type of {what}.", cure)
    return str(type_), MappingProxyType({})


class Parameter(Variable):
    """A value that does not change by itself.

    default: a number, array, bool or text; a function of other parameters (computed); None (optional, only
        read by computed defaults); left out: must be given.
    structural: fixes the type (sizes, signs, texts, lists of indices): equations see a plain Python value or a tuple.
    fixed: may differ between instances but not change during a run (periods and offsets are so by themselves).
    shape: () or sizes; a text names a size that is taken from the given value and can be read like a structural
        parameter (`num = Parameter([1.0], shape="m")`).
    zeros: the zero pattern of the value fixes the type, so that a zero makes no dependency.
    table: numbers to look up in (`search`, `pick`, `np.interp`), however many; they are fixed.
    min, max, positive: the allowed range; choices: the allowed texts. excludes: a parameter not to be given with it.
    stream: an integer from 0 to 2^52 that tells the block's stream of random numbers from all others. Nobody gives it:
        it follows from the seed of the run and the name of the stream (see `model.streams`).
    """

    kind = "a parameter"

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        unit: str | Function = "",
        shape: Shape = (),
        type: Kind = "real",
        structural: bool = False,
        fixed: bool = False,
        zeros: bool = False,
        table: bool = False,
        min: float | None = None,
        max: float | None = None,
        positive: bool = False,
        choices: tuple[str, ...] = (),
        excludes: str = "",
        stream: bool = False,
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, "", doc)
        if stream:
            others = (default is not REQUIRED, unit, shape != (), type != "real", structural, zeros, table, choices)
            if any(others):
                _refuse("E405", "", "the number of a stream is a real that nobody gives.", "Leave out all but doc=.")
            default, fixed = 0.0, True
        self.stream = stream
        if choices and type == "real":
            type = "string"
        allowed = ("real", "bool", "int", "string") if structural else ("real", "bool", "int")
        if type == "string" and not structural:
            _refuse(
                "E405", "", f"a parameter of type '{type}' fixes the type of its block.", "Declare it structural=True."
            )
        self.type, self.members = _checked_type(type, allowed, "parameters")
        if self.members and structural:
            _refuse("E405", "", "an enumeration does not fix the type of a block.", 'Use choices=("a", "b").')
        self.default, self.structural, self.fixed, self.zeros = _plain(default), structural, fixed or table, zeros
        self.table = table
        if table and (structural or zeros or shape == () or type != "real"):
            _refuse("E405", "", "a table is an array of real numbers.", 'Give it a size, as in shape="n".')
        self.min, self.max, self.positive, self.choices, self.excludes = min, max, positive, choices, excludes
        if structural and not (shape == () or (isinstance(shape, str) and type in ("real", "int"))):
            _refuse(
                "E405",
                "",
                "a structural parameter is one value or a list of numbers.",
                'Give it a size, as in shape="m", or use zeros=True.',
            )

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        return self if instance is None else self.of(instance)

    def of(self, block: Block) -> Any:
        """What a block was given, or the default; None where that is computed or missing."""
        default = None if self.default is REQUIRED or callable(self.default) else self.default
        return copy.deepcopy(block.parameters.get(self.name, default))

    def check(self, place: str) -> None:
        super().check(place)
        plain = not (self.default is REQUIRED or self.default is None or callable(self.default))
        if not isinstance(self.choices, tuple) or not all(isinstance(choice, str) for choice in self.choices):
            _refuse("E405", place, f"choices={self.choices!r} is not a tuple of texts.")
        if self.choices and plain and self.default not in self.choices:
            _refuse("E405", place, f"the default {self.default!r} is not one of {', '.join(self.choices)}.")
        if self.min is not None and self.max is not None and self.min > self.max:
            _refuse("E405", place, f"min={self.min!r} is above max={self.max!r}.", "The smaller one is min.")


class Input(Variable):
    """A value from outside. With a default it may stay unwired."""

    kind = "an input"

    def __init__(
        self,
        default: float | bool | None = None,
        *,
        unit: str | Function = "",
        shape: Shape = (),
        ports: str = "",
        type: Kind = "real",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.type, self.members = _checked_type(type, ("real", "int", "bool"), "inputs")
        self.default = default


class _Memory(Variable):
    """What a run remembers: states and discretes."""

    def __init__(self, start: Any, unit: str | Function, shape: Shape, ports: str, output: bool, doc: str) -> None:
        super().__init__(unit, shape, ports, doc)
        self.start, self.output = start, output
        self.type = "real"
        if ports and not output:
            _refuse("E405", "", "ports= names output ports.", "Add output=True.")

    def initial(self, equation: Function | Equation) -> Equation:
        """Decorator: the value at start, in place of the parameter `<name>_start`."""
        return Equation.of(equation).having(Role("initial", self))

    def _next(self, clock: Clock) -> Callable[[Function | Equation], Equation]:
        return lambda equation: Equation.of(equation).having(Role("next", self, clock=clock))


class State(_Memory):
    """A value with a derivative. `output=True` makes it a port too; it starts at the parameter `<name>_start`.

    nominal: its usual size in SI: a number, or a function of parameters that gives one, or one for each element. The
        solver's absolute tolerance is atol * nominal.
    """

    kind = "a state"

    def __init__(
        self,
        start: float = 0.0,
        *,
        unit: str | Function = "",
        shape: Shape = (),
        output: bool = False,
        ports: str = "",
        nominal: float | Function = 1.0,
        doc: str = "",
    ) -> None:
        super().__init__(start, unit, shape, ports, output, doc)
        self.nominal = nominal
        if callable(nominal):
            return
        if isinstance(nominal, bool) or not isinstance(nominal, (int, float, np.integer, np.floating)):
            cure = "A function of parameters may give one for each element."
            _refuse("E405", "", f"nominal={nominal!r} is neither a number nor a function of parameters.", cure)
        if not 0 < nominal < math.inf:
            _refuse("E405", "", f"nominal={nominal!r} must be above 0 and finite.")

    def derivative(self, equation: Function | Equation) -> Equation:
        """Decorator: the time derivative of this state."""
        return Equation.of(equation).having(Role("derivative", self))

    def next(self, *, every: str) -> Callable[[Function | Equation], Equation]:
        """Decorator: every="step": the value that replaces this one after each accepted step (a projection)."""
        if every != "step":
            cure = "Use a Discrete, or reset the state at an event."
            _refuse("E405", "", f'a state is not replaced at ticks: every={every!r} must be "step".', cure)
        return self._next(Clock(every))


class Discrete(_Memory):
    """A value that changes at instants only: by resets, or by `@d.next(every=...)` at ticks.

    visible: "after" lets unsampled equations read a ticked discrete (they then see its value after the tick).
    """

    kind = "a discrete"

    def __init__(
        self,
        start: float | bool = 0.0,
        *,
        type: Kind = "real",
        unit: str | Function = "",
        shape: Shape = (),
        output: bool = False,
        ports: str = "",
        visible: str = "",
        doc: str = "",
    ) -> None:
        super().__init__(start, unit, shape, ports, output, doc)
        self.type, self.members = _checked_type(type, ("real", "int", "bool"), "discretes")
        if type == "bool":
            self.start = bool(start)
        if visible not in ("", "after"):
            _refuse("E405", "", f'visible={visible!r} must be "after" or left out.')
        self.visible = visible

    def next(self, *, every: Any, offset: Any = 0) -> Callable[[Function | Equation], Equation]:
        """Decorator: the value after each tick, computed from the values before it.

        every="step": after each accepted step of the solver, and at the end of each instant.
        """
        return self._next(Clock(every, offset))


class Algebraic(Variable):
    """A value that an equation 0 = residual determines: `@z.residual` gives what must become 0.

    It is solved by Newton's method, at the start from the parameter `<name>_start`, later from its last value.
    """

    kind = "an algebraic variable"
    type = "real"

    def __init__(
        self,
        start: float = 0.0,
        *,
        unit: str | Function = "",
        shape: Shape = (),
        output: bool = False,
        ports: str = "",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.start, self.output = start, output
        if ports and not output:
            _refuse("E405", "", "ports= names output ports.", "Add output=True.")

    def residual(self, equation: Function | Equation) -> Equation:
        """Decorator: what is 0 where this variable has its value; as many numbers as it has elements."""
        return Equation.of(equation).having(Role("residual", self))


class History(Variable):
    """An input as it was `delay` ago: u(t - delay); before the start `before`.

    delay: a Parameter of the block, or a function of parameters, above 0; it cannot change during a run. before: a
    number, a Parameter, or a function of parameters. What was a jump then is a jump now, at exactly t + delay.
    """

    kind = "a history"
    type = "real"

    def __init__(self, of: Input, *, delay: Any, before: Any = 0.0, doc: str = "") -> None:
        if not isinstance(of, Input) or of.type != "real":
            _refuse("E405", "", f"a history is that of a real Input, not of {of!r}.")
        super().__init__(of.unit, of.shape, "", doc)
        self.of, self.delay, self.before = of, delay, before
        if not (isinstance(delay, Parameter) or callable(delay)):
            _refuse("E405", "", f"delay={delay!r} is not a Parameter or a function of parameters.")
        if not (isinstance(before, (int, float, Parameter)) or callable(before)):
            _refuse("E405", "", f"before={before!r} is not a number, a Parameter or a function of parameters.")


# --- equations -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """When a sampled equation is computed: at offset + tick * every, from t = 0.

    Each is a number, a Parameter of the block, or a function of parameters. every="step" has no ticks: what has it is
    computed after each accepted step.
    """

    every: Any
    offset: Any = 0

    def __post_init__(self) -> None:
        if self.every == "step":
            if self.offset != 0:
                _refuse("E405", "", 'every="step" has no offset.')
            return
        for word, value in (("every", self.every), ("offset", self.offset)):
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (number or isinstance(value, Parameter) or callable(value)):
                _refuse("E405", "", f"{word}={value!r} is not a number, a parameter or a function of parameters.")
            if number and not (math.isfinite(value) and (value > 0 if word == "every" else value >= 0)):
                _refuse(
                    "E405", "", f"{word}={value!r} must be {'above' if word == 'every' else 'at least'} 0, and finite."
                )


@dataclass(frozen=True, slots=True, eq=False)
class Role:
    """What an equation computes: a kind, the variable it is for, and the crossing or event that calls it."""

    kind: str  # output, local, derivative, residual, initial, next, crossing, event_time, reset
    target: Variable | None = None
    cause: Variable | None = None
    clock: Clock | None = None

    @property
    def ticks(self) -> bool:
        """Whether it is computed at ticks."""
        return self.clock is not None and self.clock.every != "step"


class Equation:
    """A pure function of named values, with one role or several."""

    def __init__(self, function: Function, roles: tuple[Role, ...] = (), name: str = "") -> None:
        self.function, self.roles, self.name = function, roles, name or getattr(function, "__name__", "equation")
        self.reads = arguments(function, self.name)

    @classmethod
    def of(cls, equation: Function | Equation) -> Equation:
        return equation if isinstance(equation, Equation) else cls(equation)

    def having(self, role: Role) -> Equation:
        return Equation(self.function, (*self.roles, role), self.name)

    def named(self, name: str) -> Equation:
        return Equation(self.function, self.roles, name)

    def __repr__(self) -> str:
        return f"<equation '{self.name}'>"


class _Computed(Variable):
    """A variable that is an equation."""

    role: ClassVar[str]

    def __init__(self, function: Function, unit: str | Function, shape: Shape, ports: str, doc: str) -> None:
        if isinstance(function, (Equation, Variable)):
            _refuse(
                "E403",
                function.equation.name if isinstance(function, _Computed) else function.name,
                f"is already {function.kind if isinstance(function, Variable) else 'an equation'}.",
                "Stacked decorators are for .derivative, .initial, .next and .reset.",
            )
        super().__init__(unit, shape, ports, doc)
        self.equation = Equation(function)
        self.clock: Clock | None = None


class Output(_Computed):
    """A value for others. Unsampled: at any time. Sampled (`every=`): at its ticks, held in between from `start` on."""

    kind = "an output"
    role = "output"

    def __init__(
        self,
        function: Function,
        *,
        unit: str | Function,
        shape: Shape,
        ports: str,
        type: Kind,
        clock: Clock | None,
        start: Any,
        wiring: bool,
        doc: str,
    ) -> None:
        super().__init__(function, unit, shape, ports, doc)
        self.type, self.members = _checked_type(type, ("real", "int", "bool"), "outputs")
        self.clock, self.start, self.wiring = clock, start, wiring


class Stepped(Variable):
    """An output of a stepper: what its program gave at the last tick, held in between; `start` before the first."""

    kind = "a stepped output"

    def __init__(
        self,
        start: Any = 0.0,
        *,
        unit: str | Function = "",
        shape: Shape = (),
        ports: str = "",
        type: Kind = "real",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.type, self.members = _checked_type(type, ("real", "int", "bool"), "stepped outputs")
        self.start = start


class Given(Variable):
    """What an FMU gives: one of its outputs, or another variable of it that can be recorded (is_local).

    held: it changes at instants only.
    """

    kind = "an output of an FMU"

    def __init__(
        self,
        *,
        unit: str = "",
        shape: tuple[int, ...] = (),
        type: Kind = "real",
        is_local: bool = False,
        held: bool = False,
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, "", doc)
        self.type, self.members = _checked_type(type, ("real", "int", "bool"), "outputs of FMUs")
        self.is_local, self.held = is_local, held


class Local(_Computed):
    """A named part of a block's equations: nonlinear laws of one signal belong here."""

    kind = "a local"
    role = "local"
    type = "real"


class _Cause(_Computed):
    """What makes an instant: a crossing or an event time."""

    def reset(self, target: State | Discrete) -> Callable[[Function | Equation], Equation]:
        """Decorator: the target's value after it fired, computed from the values before."""
        if not isinstance(target, (State, Discrete)):
            _refuse("E405", "", f"a reset is for a State or a Discrete, not for {target!r}.")
        return lambda equation: Equation.of(equation).having(Role("reset", target, cause=self))


class Crossing(_Cause):
    """A side (value >= 0) of a continuous function; equations that read its name see the latched side as a bool."""

    kind = "a crossing"
    role = "crossing"
    type = "bool"

    def __init__(self, function: Function, direction: str, start: bool | None) -> None:
        super().__init__(function, "", (), "", "")
        self.direction, self.start = direction, start


class EventTime(_Cause):
    """The next instant after t (inf: none)."""

    kind = "an event time"
    role = "event_time"
    type = "real"


def output(
    function: Function | None = None,
    *,
    unit: str | Function = "",
    shape: Shape = (),
    ports: str = "",
    type: Kind = "real",
    every: Any = None,
    offset: Any = 0,
    start: Any = 0,
    doc: str = "",
) -> Any:
    """Decorator: an output. With `every` it is sampled: computed at its ticks and held, at first from `start`."""
    if every is None and (offset != 0 or start != 0):
        _refuse("E405", "", "offset= and start= belong to a sampled output.", "Add every=.")
    if every == "step":
        _refuse("E405", "", "an output cannot be sampled at steps.", 'Let it read a Discrete with .next(every="step").')
    clock = None if every is None else Clock(every, offset)

    def declare(function: Function) -> Output:
        return Output(
            function, unit=unit, shape=shape, ports=ports, type=type, clock=clock, start=start, wiring=False, doc=doc
        )

    return declare if function is None else declare(function)


def wiring(function: Function | None = None, *, shape: Shape = (), ports: str = "", doc: str = "") -> Any:
    """Decorator: an output that only re-arranges the elements of inputs. It costs nothing: wires go through it."""

    def declare(function: Function) -> Output:
        return Output(
            function, unit="", shape=shape, ports=ports, type="real", clock=None, start=0, wiring=True, doc=doc
        )

    return declare if function is None else declare(function)


def local(function: Function | None = None, *, unit: str | Function = "", doc: str = "") -> Any:
    """Decorator: a named part of the equations; its shape is what it returns."""

    def declare(function: Function) -> Local:
        return Local(function, unit, (), "", doc)

    return declare if function is None else declare(function)


def crossing(function: Function | None = None, *, direction: str = "both", start: bool | None = None) -> Any:
    """Decorator: a crossing. `direction` ("up", "down", "both") chooses which changes of side fire its resets.

    A crossing that reads its own side (hysteresis) declares the side it starts from with `start`.
    """
    if direction not in ("up", "down", "both"):
        _refuse("E405", "", f'direction={direction!r} must be "up", "down" or "both".')

    def declare(function: Function) -> Crossing:
        return Crossing(function, direction, start)

    return declare if function is None else declare(function)


def event_time(function: Function) -> EventTime:
    """Decorator: a function of t, parameters and discretes that gives the next instant after t, or inf."""
    return EventTime(function, "s", (), "", "")


@dataclass(frozen=True, slots=True, eq=False)
class Stepper:
    """What makes the program of a block that owns its state: a function of parameters, called once for each run."""

    name: str
    function: Function
    reads: tuple[str, ...]
    clock: Clock


def stepper(*, every: Any, offset: Any = 0) -> Callable[[Function], Stepper]:
    """Decorator: a function of parameters that gives an object with hidden state, a program in plain Python.

    At each tick the object's `step(t, **inputs)` is called once with the inputs by name (floats, or arrays for vectors)
    and returns the stepped outputs by name; a single one may be returned as it is. With `save()`, which gives a value
    that JSON can hold, and `restore(value)`, a run of it can be saved.
    """
    clock = Clock(every, offset)
    if every == "step":
        _refuse("E405", "", "a stepper has ticks.", "Use every=period.")
    return lambda function: Stepper(function.__name__, function, arguments(function, function.__name__), clock)


@dataclass(frozen=True, slots=True, eq=False)
class Requirement:
    """A condition over parameters that an instance must meet."""

    message: str
    equation: Equation


def requires(message: str) -> Callable[[Function], Requirement]:
    """Decorator: a condition over parameters; where it is false, `message` says what must hold."""
    if not isinstance(message, str):
        _refuse("E405", "", "requires() takes the sentence that a user reads.", 'As in @requires("a must be below b").')
    return lambda function: Requirement(message, Equation(function))


# --- the class -------------------------------------------------------------------------------------------------


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


class _Body(dict[str, Any]):
    """The namespace of a block class: every name once."""

    def __init__(self, block: str) -> None:
        super().__init__()
        self.block = block

    def __setitem__(self, name: str, value: Any) -> None:
        place = f"{self.block}.{name}"
        if name.startswith("__") and name.endswith("__"):
            if name not in _PYTHON_SETS:
                _refuse("E401", place, "a block has variables and equations, and no methods of its own.")
        else:
            if name in self:
                _refuse("E401", place, "the name stands twice in the class body.", "Give the second another name.")
            if name in RESERVED or keyword.iskeyword(name):
                _refuse("E401", place, "the name is reserved.", "Choose another.")
            if name.startswith("_") or not name.isascii():
                _refuse("E401", place, "names of variables and equations are plain letters, digits and inner _.")
            if not isinstance(value, (Variable, Equation, Requirement, Stepper)) or isinstance(value, Given):
                what = "a function without a role" if inspect.isfunction(value) else f"{type(value).__name__} {value!r}"
                _refuse(
                    "E401",
                    place,
                    f"a class body lists variables and equations, not {what}.",
                    "Decorate it (@output, @local, @x.derivative, ...) or move it out of the class.",
                )
        if isinstance(value, Variable):
            if value.is_declared:
                _refuse("E401", place, f"{value!r} belongs to another class.", "Declare one for each class.")
            if value.name:
                _refuse("E401", place, f"is another name for '{value.name}'.", "Declare it once.")
            value.name = name
        super().__setitem__(name, value)


class BlockMeta(type):
    """Reads a class body once, refuses what it must not say, and keeps the rest as a Declaration."""

    declaration: Declaration

    @classmethod
    def __prepare__(mcs, name: str, bases: tuple[type, ...], /, **options: Any) -> Any:
        return _Body(name) if bases else {}

    def __new__(mcs, name: str, bases: tuple[type, ...], body: Mapping[str, Any], foreign: Any = None) -> BlockMeta:
        if not bases:
            return super().__new__(mcs, name, bases, {**body, "__slots__": ("parameters",)})
        cure = "Derive from Block alone, or put the blocks together in a diagram."
        for base in bases:
            if isinstance(base, BlockMeta) and base.__bases__ != (object,):
                _refuse("E406", name, f"{base.__name__} is a concrete block and cannot be subclassed.", cure)
        if len(bases) > 1:
            _refuse("E406", name, f"derives from {' and '.join(base.__name__ for base in bases)}.", cure)
        made = super().__new__(mcs, name, bases, {**body, "__slots__": ()})
        made.declaration = _declare(name, body.get("__doc__") or "", body, foreign)
        type.__setattr__(made, "__signature__", _signature(made.declaration.settable.values()))
        return made

    def __init__(cls, name: str, bases: tuple[type, ...], body: Mapping[str, Any], foreign: Any = None) -> None:
        super().__init__(name, bases, dict(body))

    def __setattr__(cls, name: str, value: Any) -> None:
        if "declaration" in cls.__dict__:
            raise AttributeError(f"{cls.__name__} is declared; a block class cannot be changed afterwards.")
        super().__setattr__(name, value)

    def __delattr__(cls, name: str) -> None:
        raise AttributeError(f"{cls.__name__} is declared; a block class cannot be changed afterwards.")


def _signature(parameters: Iterable[Parameter]) -> inspect.Signature:
    """What editors complete: every parameter, by keyword."""
    plain = inspect.Parameter
    return inspect.Signature(
        [
            plain(p.name, plain.KEYWORD_ONLY, default=plain.empty if p.default is REQUIRED else p.default)
            for p in parameters
            if p.name.isidentifier() and not keyword.iskeyword(p.name)  # an FMU's own names may be others
        ]
    )


def _plain(value: Any) -> Any:
    """A copy that nobody else holds, in Python's own numbers and lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return {key: _plain(item) for key, item in value.items()} if isinstance(value, dict) else value


class Block(metaclass=BlockMeta):
    """A block: parameter values of a declared type, and nothing else.

    parameters: what was given, by name (numbers, arrays, texts; `"=..."` over the diagram's parameters;
        `{"value": 1200, "unit": "mOhm"}`). Raises ModelError for an unknown name (E106).
    """

    __slots__ = ("parameters",)
    parameters: Mapping[str, Any]

    def __init__(self, *unnamed: Any, **parameters: Any) -> None:
        cls = type(self)
        if cls is Block:
            raise TypeError("Block is what block classes derive from; it has no equations itself.")
        known = cls.declaration.settable
        if unnamed:
            plain = [name for name, parameter in known.items() if not parameter.structural] or [*known]
            example = f"{cls.__name__}({plain[0] if plain else 'k'}={unnamed[0]!r})"
            raise UsageError(Fault("E501", cls.__name__, "takes parameters by name only.", f"As in {example}."))
        faults = [
            Fault(
                "E106",
                f"{cls.__name__}.{name}",
                "there is no such parameter.",
                did_you_mean(name, known) or f"Parameters: {', '.join(known) or 'none'}."
                if name not in cls.declaration.streams
                else f'A stream is named where the block is added: add("x", {cls.__name__}(), {name}="...").',
            )
            for name in parameters
            if name not in known
        ]
        if faults:
            raise ModelError(*faults)
        object.__setattr__(self, "parameters", MappingProxyType(_plain(parameters)))

    def __getattr__(self, name: str) -> Any:
        block, d = type(self).__name__, type(self).declaration
        if name in d.parameters:  # of a start value, which the class body does not name
            return d.parameters[name].of(self)
        variable = {**d.readable, **d.event_times}.get(name)
        if variable is not None:
            raise AttributeError(
                f"'{name}' of {block} is {variable.kind}: a block holds parameter values only. "
                "Add the block to a diagram and take the port of what `add` returns."
            )
        cure = did_you_mean(name, d.parameters) or f"Parameters: {', '.join(d.parameters) or 'none'}."
        raise AttributeError(f"{block} has no parameter '{name}'. {cure}")

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(
            f"{type(self).__name__} holds the parameters it was made with; '{name}' cannot be set. Make another one."
        )

    def __delattr__(self, name: str) -> None:
        raise AttributeError(
            f"{type(self).__name__} holds the parameters it was made with; '{name}' cannot be deleted."
        )

    def __reduce__(self) -> Any:
        return _made, (type(self), dict(self.parameters))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in self.parameters.items())})"

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.parameters == other.parameters

    __hash__ = None  # type: ignore[assignment]


def _made(cls: type[Block], parameters: dict[str, Any]) -> Block:
    """A copied or unpickled block."""
    return cls(**parameters)


def _check_finite(variable: Variable, place: str) -> None:
    """Refuse a default or a start that is no number, nan or infinite: no file could hold it."""
    word = "start" if isinstance(variable, _Memory) else "default"
    given = getattr(variable, word, None)
    numbers = np.array([x for x in np.ravel(np.array(given, dtype=object)) if isinstance(x, (float, np.floating))])
    wrong = numbers[~np.isfinite(numbers.astype(float))]
    if len(wrong):
        cure = "Leave it out, and it must be given." if isinstance(variable, Parameter) else ""
        _refuse("E405", place, f"the {word} is {wrong[0]}, which is no finite number.", cure)


def _declare(name: str, doc: str, body: Mapping[str, Any], foreign: Any = None) -> Declaration:
    """Check a class body and put it in order."""
    groups: dict[type, dict[str, Any]] = {
        kind: {}
        for kind in (
            *(Parameter, Input, State, Discrete, Algebraic, History, Output, Stepped, Given),
            *(Local, Crossing, EventTime),
        )
    }
    equations: list[Equation] = []
    requirements: list[Requirement] = []
    steppers: list[Stepper] = []
    for key, value in body.items():
        if isinstance(value, Variable):
            value.check(f"{name}.{key}")
            if foreign is None:
                _check_finite(value, f"{name}.{key}")
            groups[type(value)][key] = value
            if isinstance(value, _Computed):
                equations.append(value.equation.named(key).having(Role(value.role, value, clock=value.clock)))
        elif isinstance(value, Equation):
            equations.append(value.named(key))
        elif isinstance(value, Requirement):
            requirements.append(value)
        elif isinstance(value, Stepper):
            steppers.append(value)
    parameters = groups[Parameter]
    if foreign is None:  # an FMU says itself which of its start values can be set
        _add_starts(name, parameters, {**groups[State], **groups[Discrete], **groups[Algebraic]}, equations, body)
    sizes = _sizes(name, parameters, body)
    frozen: dict[type, Mapping[str, Any]] = {kind: MappingProxyType(group) for kind, group in groups.items()}
    declaration = Declaration(
        name,
        inspect.cleandoc(doc),
        frozen[Parameter],
        frozen[Input],
        frozen[State],
        frozen[Discrete],
        frozen[Algebraic],
        frozen[History],
        frozen[Output],
        frozen[Stepped],
        steppers[0] if steppers else None,
        frozen[Local],
        frozen[Crossing],
        frozen[EventTime],
        tuple(equations),
        tuple(requirements),
        sizes,
        frozen[Given],
        foreign,
        tuple(key for key, parameter in parameters.items() if parameter.stream),
    )
    if len(steppers) > 1:
        _refuse("E403", f"{name}.{steppers[1].name}", "is a second stepper.", "A block has one at most.")
    if frozen[Stepped] and not steppers:
        _refuse("E403", f"{name}.{next(iter(frozen[Stepped]))}", "has no stepper that gives it.", "Add @stepper.")
    _check_parameters(declaration)
    _check_equations(declaration)
    _check_cycles(declaration)
    for variable in (*declaration.readable.values(), *declaration.event_times.values()):
        variable.is_declared = True
    return declaration


def _add_starts(
    name: str,
    parameters: dict[str, Parameter],
    memories: Mapping[str, State | Discrete | Algebraic],
    equations: Iterable[Equation],
    body: Mapping[str, Any],
) -> None:
    """The parameter `<x>_start` of each algebraic variable, and of each state and discrete without initial equation."""
    initial = {role.target for equation in equations for role in equation.roles if role.kind == "initial"}
    for key, variable in memories.items():
        if variable in initial:
            continue
        start = f"{key}_start"
        if start in body:
            _refuse("E401", f"{name}.{start}", f"is the start value of '{key}' by its name.", "Rename it.")
        made = Parameter(variable.start, unit=variable.unit, shape=variable.shape)
        made.type, made.members = variable.type, variable.members
        made.name = start
        made.doc = f"{'where the search begins for' if isinstance(variable, Algebraic) else 'start value of'} {key}"
        parameters[start] = made


def _sizes(name: str, parameters: Mapping[str, Parameter], body: Mapping[str, Any]) -> tuple[str, ...]:
    """The sizes that parameters name in their shapes."""
    found: dict[str, None] = {}
    for parameter in parameters.values():
        for size in parameter.shape if isinstance(parameter.shape, tuple) else (parameter.shape,):
            if isinstance(size, str):
                if size in body or size in RESERVED:
                    _refuse("E401", f"{name}.{parameter.name}", f"the size '{size}' is also another name.")
                found[size] = None
    return tuple(found)


def _check_parameters(declaration: Declaration) -> None:
    """Functions for defaults, shapes, units and clocks read only what is known when they are called."""
    name, parameters = declaration.name, declaration.parameters
    structural = {key for key, p in parameters.items() if p.structural} | set(declaration.sizes)
    everything = set(parameters) | set(declaration.sizes)

    def check(function: Any, known: set[str], place: str, what: str) -> None:
        if callable(function) and not isinstance(function, Variable):
            for read in arguments(function, place):
                if read not in known:
                    _refuse(
                        "E402",
                        place,
                        f"{what} reads '{read}', which is not {'a structural ' if known is structural else 'a '}"
                        "parameter.",
                        did_you_mean(read, known),
                    )

    def fix(value: Any, place: str, what: str) -> None:
        """Check what gives a time, and keep the parameters that it reads from changing during a run."""
        if isinstance(value, Parameter):
            if parameters.get(value.name) is not value:
                _refuse("E402", place, f"its {what} is {value!r}, which is not a parameter of this block.")
            if value.type not in ("real", "int") or value.shape != () or value.default is None:
                _refuse("E405", place, f"its {what} is {value!r}, which is not a number in every instance.")
            value.fixed = True
        else:
            check(value, everything, place, f"the {what}")
            for read in arguments(value, place) if callable(value) else ():
                if read in parameters:
                    parameters[read].fixed = True

    for key, parameter in parameters.items():
        place = f"{name}.{key}"
        check(parameter.default, everything, place, "the default")
        if callable(parameter.default) and key in arguments(parameter.default, place):
            _refuse("E404", place, "the default reads the parameter itself.")
        if parameter.excludes and parameter.excludes not in parameters:
            _refuse("E402", place, f"excludes '{parameter.excludes}', which is not a parameter.")
        if (
            not parameter.structural
            and parameter.default is None
            and any(key in equation.reads for equation in declaration.equations)
        ):
            _refuse("E405", place, "is optional (None), so only computed defaults may read it.")
    for variable in (*parameters.values(), *declaration.readable.values()):
        place = f"{name}.{variable.name}"
        check(variable.unit, structural, place, "the unit")
        for size in variable.shape if isinstance(variable.shape, tuple) else (variable.shape,):
            check(size, structural, place, "the shape")
        if isinstance(variable, State):
            check(variable.nominal, everything, place, "the nominal")
    for equation in declaration.equations:
        for role in equation.roles:
            for value in (role.clock.every, role.clock.offset) if role.clock and role.ticks else ():
                fix(value, f"{name}.{equation.name}", "clock")
    if declaration.stepper is not None:
        place = f"{name}.{declaration.stepper.name}"
        for value in (declaration.stepper.clock.every, declaration.stepper.clock.offset):
            fix(value, place, "clock")
        for read in declaration.stepper.reads:
            if read not in everything:
                known = did_you_mean(read, everything) or "A stepper is made from parameters; step() gets the inputs."
                _refuse("E402", place, f"reads '{read}', which is not a parameter.", known)
            if read in parameters:
                parameters[read].fixed = True
    for history in declaration.histories.values():
        place = f"{name}.{history.name}"
        if declaration.inputs.get(history.of.name) is not history.of:
            _refuse("E402", place, f"{history.of!r} belongs to another class.")
        fix(history.delay, place, "delay")
        if isinstance(history.before, Parameter) and parameters.get(history.before.name) is not history.before:
            _refuse("E402", place, f"begins with {history.before!r}, which is not a parameter of this block.")
        check(history.before, everything, place, "the value before the start")
    begin: list[Output | Stepped] = [*declaration.outputs.values(), *declaration.stepped.values()]
    for made in begin:
        start = made.start
        if isinstance(start, Parameter) and parameters.get(start.name) is not start:
            _refuse("E402", f"{name}.{made.name}", f"starts at {start!r}, which is not a parameter of this block.")
        check(start, everything, f"{name}.{made.name}", "the start")


_OWNERS = {"derivative": State, "next": Discrete, "initial": (State, Discrete), "reset": (State, Discrete)}


def _check_equations(declaration: Declaration) -> None:
    """Every name an equation reads exists and may be read there; every variable has what it needs, once."""
    name, readable = declaration.name, declaration.readable
    own = {id(v) for v in (*readable.values(), *declaration.event_times.values())}
    seen: set[tuple[str, int, int]] = set()
    changed: set[str] = set()
    for equation in declaration.equations:
        place = f"{name}.{equation.name}"
        if not equation.roles:
            _refuse("E403", place, "an equation without a role.")
        clocks = [role.clock for role in equation.roles if role.clock is not None]
        if any((clock.every, clock.offset) != (clocks[0].every, clocks[0].offset) for clock in clocks):
            _refuse("E405", place, "has two clocks.", "Write one equation for each.")
        for role in equation.roles:
            for variable in (role.target, role.cause):
                if variable is not None and id(variable) not in own:
                    _refuse("E402", place, f"{variable!r} belongs to another class.")
            once = (role.kind, id(role.target), id(role.cause))
            if once in seen:
                target = role.target.name if role.target else ""
                _refuse("E403", place, f"the {role.kind} of '{target}' stands twice.")
            seen.add(once)
            if role.kind in ("derivative", "next", "reset") and role.target is not None:
                changed.add(role.target.name)
        for read in equation.reads:
            _check_read(declaration, equation, read)
    for key, state in declaration.states.items():
        if ("derivative", id(state), id(None)) not in seen and declaration.foreign is None:
            _refuse("E403", f"{name}.{key}", "the state has no derivative.", f"Add @{key}.derivative, or use Discrete.")
    for key, algebraic in declaration.algebraics.items():
        if ("residual", id(algebraic), id(None)) not in seen:
            _refuse("E403", f"{name}.{key}", "the algebraic variable has no residual.", f"Add @{key}.residual.")
    for key in declaration.discretes:
        if key not in changed:
            _refuse("E403", f"{name}.{key}", "the discrete never changes.", "Add .next or a reset, or use Parameter.")
    for requirement in declaration.requirements:
        for read in requirement.equation.reads:
            if read not in declaration.parameters and read not in declaration.sizes:
                _refuse("E402", f"{name}.{requirement.equation.name}", f"reads '{read}', which is not a parameter.")
    for key, variable in {**declaration.states, **declaration.discretes}.items():
        ticked = declaration.clock_of(key) is not None
        if variable.output and ticked and not (isinstance(variable, Discrete) and variable.visible):
            _refuse(
                "E405",
                f"{name}.{key}",
                "a ticked discrete cannot be an output as it is.",
                'Add visible="after", or write a sampled output that reads it.',
            )


def _check_read(declaration: Declaration, equation: Equation, read: str) -> None:
    place = f"{declaration.name}.{equation.name}"
    kinds = {role.kind for role in equation.roles}
    unsampled = {role.kind for role in equation.roles if not role.ticks}
    readable = declaration.readable
    if read == "t" or read in declaration.sizes:
        return
    if read == "tick":
        if unsampled - {"initial"} or unsampled == kinds:
            _refuse("E402", place, "reads 'tick', which only sampled equations have.", "Add every=, or read t.")
        return
    variable = readable.get(read)
    if variable is None:
        extra = " It is an event time, which has no value." if read in declaration.event_times else ""
        known = (*readable, "t", "tick")
        cure = did_you_mean(read, known) or f"Names: {', '.join(known)}."
        _refuse("E402", place, f"reads '{read}', which is no name of this class.{extra}", cure)
    if "event_time" in kinds and not isinstance(variable, (Parameter, Discrete)):
        _refuse("E402", place, f"an event time may read t, parameters and discretes, not {variable!r}.")
    if "event_time" in kinds and isinstance(variable, Parameter):
        variable.fixed = True  # what edges left behind in memory could not follow a change during a run
    if isinstance(variable, Output) and variable.wiring:
        _refuse("E402", place, f"reads '{read}', which is only wiring.")
    wires = isinstance(equation.roles[0].target, Output) and equation.roles[0].target.wiring
    if wires and not (isinstance(variable, Input) or (isinstance(variable, Parameter) and variable.structural)):
        _refuse("E402", place, f"wiring re-arranges inputs only; it cannot read {variable!r}.")
    if isinstance(variable, Crossing) and variable.start is None and variable in [r.target for r in equation.roles]:
        _refuse("E405", place, "reads its own side.", "Say from which side it starts: @crossing(start=False).")
    # A local may serve sampled and unsampled equations alike; where it does, it may not read what they see differently.
    if (
        isinstance(variable, Discrete)
        and not (kinds == {"local"} and declaration.is_of_ticks(equation.name))
        and unsampled & {"output", "local", "derivative", "residual", "crossing", "next"}
        and declaration.clock_of(read) is not None
        and not variable.visible
    ):
        _refuse(
            "E405",
            place,
            f"is unsampled and reads the ticked discrete '{read}'.",
            f'Sample it too (every=), or declare {read} = Discrete(visible="after").',
        )


def _check_cycles(declaration: Declaration) -> None:
    """Locals, outputs and computed defaults must not need themselves."""
    graph: dict[str, tuple[str, ...]] = {}
    for equation in declaration.equations:
        for role in equation.roles:
            if role.kind in ("local", "output") and role.target is not None:
                graph[role.target.name] = equation.reads
    for key, parameter in declaration.parameters.items():
        if callable(parameter.default):
            graph[key] = arguments(parameter.default, key)
    done: set[str] = set()

    def visit(key: str, path: tuple[str, ...]) -> None:
        if key in path:
            cycle = " -> ".join((*path[path.index(key) :], key))
            cure = "" if key in declaration.parameters else "Break the cycle with a State or a Discrete."
            _refuse("E404", f"{declaration.name}.{key}", f"needs itself: {cycle}.", cure)
        if key in done or key not in graph:
            return
        for read in graph[key]:
            visit(read, (*path, key))
        done.add(key)

    for key in graph:
        visit(key, ())
