"""The equations of a block class that are variables themselves, and the decorators that declare equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from .reads import Function, arguments, refuse
from .variables import AnyUnit, Clock, Discrete, Equation, Kind, Ports, Role, Shape, State, Variable, checked_type

__all__ = [
    "Computed",
    "Crossing",
    "EventTime",
    "Local",
    "Open",
    "Output",
    "Requirement",
    "Stepper",
    "crossing",
    "event_time",
    "local",
    "output",
    "requires",
    "stepper",
    "wiring",
]


class Computed(Variable):
    """A variable that is an equation."""

    role: ClassVar[str]
    fills: Open | None = None  # what an abstract class has left open

    def __init__(self, function: Function, unit: AnyUnit, shape: Shape, ports: Ports, doc: str) -> None:
        if isinstance(function, (Equation, Variable)):
            refuse(
                "E403",
                function.equation.name if isinstance(function, Computed) else function.name,
                f"is already {function.kind if isinstance(function, Variable) else 'an equation'}.",
                "Stacked decorators are for .derivative, .initial, .next and .reset.",
            )
        super().__init__(unit, shape, ports, doc)
        self.equation = Equation(function)
        self.clock: Clock | None = None


class Open:
    """An output, a local or a crossing without its function, as an abstract class may leave it.

    It is the decorator that takes the function and gives the variable.
    """

    name = ""
    is_declared = False

    def __init__(self, kind: type[Computed], make: Callable[[Function], Computed]) -> None:
        self.kind, self.make = kind, make

    def __call__(self, function: Function | None = None, **given: object) -> Computed:
        if given or function is None:
            message = f"takes a function and nothing else{', not ' + ', '.join(given) if given else ''}."
            refuse("E405", self.name, message, "The abstract class sets unit, shape and clock.")
        computed = self.make(function)
        if self.name:
            computed.fills = self
        return computed

    def check(self, place: str) -> None:
        """Refuse what can be refused without numbers, as `Variable.check`."""
        self.make(lambda: 0.0).check(place)

    def __repr__(self) -> str:
        return f"<{self.kind.kind} '{self.name}', left open>"


class Output(Computed):
    """A value for others. Unsampled: at any time. Sampled (`every=`): at its ticks, held in between from `start` on."""

    kind = "an output"
    role = "output"

    def __init__(
        self,
        function: Function,
        *,
        unit: AnyUnit,
        shape: Shape,
        ports: Ports,
        type: Kind,
        clock: Clock | None,
        start: object,
        wiring: bool,
        doc: str,
    ) -> None:
        super().__init__(function, unit, shape, ports, doc)
        self.type, self.members = checked_type(type, ("real", "int", "bool"), "outputs")
        self.clock, self.start, self.wiring = clock, start, wiring


class Local(Computed):
    """A named part of a block's equations: nonlinear laws of one signal belong here."""

    kind = "a local"
    role = "local"
    type = "real"


class _Cause(Computed):
    """What makes an instant: a crossing or an event time."""

    def reset(self, target: State | Discrete) -> Callable[[Function | Equation], Equation]:
        """Decorator: the target's value after it fired, computed from the values before."""
        if not isinstance(target, (State, Discrete)):
            refuse("E405", "", f"reset() needs a State or a Discrete, not {target!r}.")
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
    unit: AnyUnit = "",
    shape: Shape = (),
    ports: Ports = "",
    type: Kind = "real",
    every: object = None,
    offset: object = 0,
    start: object = 0,
    doc: str = "",
) -> Any:
    """Decorator: an output. With `every` it is sampled: computed at its ticks and held, at first from `start`."""
    if every is None and (offset != 0 or start != 0):
        refuse("E405", "", "offset= and start= are for sampled outputs.", "Add every=.")
    if every == "step":
        refuse("E405", "", "an output cannot be sampled at steps.", 'Let it read a Discrete with .next(every="step").')
    clock = None if every is None else Clock(every, offset)

    def declare(function: Function) -> Output:
        return Output(
            function, unit=unit, shape=shape, ports=ports, type=type, clock=clock, start=start, wiring=False, doc=doc
        )

    return Open(Output, declare) if function is None else declare(function)


def wiring(function: Function | None = None, *, shape: Shape = (), ports: Ports = "", doc: str = "") -> Any:
    """Decorator: an output that only re-arranges the elements of inputs. It costs nothing: wires go through it."""

    def declare(function: Function) -> Output:
        return Output(
            function, unit="", shape=shape, ports=ports, type="real", clock=None, start=0, wiring=True, doc=doc
        )

    return Open(Output, declare) if function is None else declare(function)


def local(
    function: Function | None = None, *, unit: AnyUnit = "", doc: str = "", type: object = None, shape: object = None
) -> Any:
    """Decorator: a named part of the equations; its shape and its type are those of what it returns.

    Raises DeclarationError (E405) if a type or a shape is given.
    """
    for word, given in (("type", type), ("shape", shape)):
        if given is not None:
            message = f"a local takes its {word} from the value that its function returns."
            refuse("E405", "local", message, f"Leave {word}= out.")

    def declare(function: Function) -> Local:
        return Local(function, unit, (), "", doc)

    return Open(Local, declare) if function is None else declare(function)


def crossing(function: Function | None = None, *, direction: str = "both", start: bool | None = None) -> Any:
    """Decorator: a crossing. `direction` ("up", "down", "both") chooses which changes of side fire its resets.

    A crossing that reads its own side (hysteresis) declares the side it starts from with `start`.
    """
    if direction not in ("up", "down", "both"):
        refuse("E405", "", f'direction={direction!r} must be "up", "down" or "both".')

    def declare(function: Function) -> Crossing:
        return Crossing(function, direction, start)

    return Open(Crossing, declare) if function is None else declare(function)


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


def stepper(*, every: object, offset: object = 0) -> Callable[[Function], Stepper]:
    """Decorator: a function of parameters that gives an object with hidden state, a program in plain Python.

    At each tick the object's `step(t, **inputs)` is called once with the inputs by name (floats, or arrays for vectors)
    and returns the stepped outputs by name; a single one may be returned as it is. With `save()`, which gives a value
    that JSON can hold, and `restore(value)`, a run of it can be saved.
    """
    clock = Clock(every, offset)
    if every == "step":
        refuse("E405", "", "a stepper needs ticks.", "Add every=period.")
    return lambda function: Stepper(function.__name__, function, arguments(function, function.__name__), clock)


@dataclass(frozen=True, slots=True, eq=False)
class Requirement:
    """A condition over parameters that an instance must meet."""

    message: str
    equation: Equation


def requires(message: str) -> Callable[[Function], Requirement]:
    """Decorator: a condition over parameters; where it is false, `message` says what must hold."""
    if not isinstance(message, str):
        cure = 'Write, for example, @requires("a must be below b").'
        refuse("E405", "", "requires() needs the sentence that a user reads.", cure)
    return lambda function: Requirement(message, Equation(function))
