"""The variables of a block class, and what ties an equation to them: its role and its clock."""

from __future__ import annotations

import copy
import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ..text.errors import ModelError
from ..text.json_number import is_number
from ..text.units import parse as parse_unit
from .enumerations import Enumeration
from .reads import Function, arguments, refuse
from .sparse import edges_of
from .unit_expression import UnitExpression

# Far beyond every signal, and its square is still a finite number.
UNLIMITED = 1e100
NO_LIMIT: Mapping[str, float] = MappingProxyType({"inf": UNLIMITED, "-inf": -UNLIMITED})
"""The words that a limit accepts besides numbers, and the numbers that equations get for them."""
REQUIRED: object = type("Required", (), {"__repr__": lambda self: "REQUIRED"})()
"""The default of a parameter that must be given."""

Shape = int | str | tuple[int | str, ...] | Function


AnyUnit: TypeAlias = "str | Function | Parameter"
"""What `unit=` takes: a text, a unit parameter of the class or an expression of some, or a function."""
Ports: TypeAlias = "str | Parameter"
"""The values of `ports=`: a name with {} for the number, or a structural text of the class that lists the names."""


class Variable:
    """Something with a name in a block class. Frozen once the class is declared."""

    name: str = ""
    kind: ClassVar[str] = ""
    is_declared: bool = False
    type: str
    members: Mapping[str, int] = MappingProxyType({})  # of an enumeration

    def __init__(self, unit: AnyUnit, shape: Shape, ports: Ports, doc: str) -> None:
        self.unit: str | Function = unit.as_unit() if isinstance(unit, Parameter) else unit
        self.shape, self.ports, self.doc = shape, ports, doc

    def __setattr__(self, name: str, value: object) -> None:
        if self.is_declared:
            raise AttributeError(f"{self!r} is declared and cannot be changed.")
        super().__setattr__(name, value)

    def __get__(self, instance: object, owner: object = None) -> Any:
        if instance is None:
            return self
        raise AttributeError(name=self.name, obj=instance)  # Block.__getattr__ says more

    def __repr__(self) -> str:
        return f"<{self.kind} '{self.name}'>"

    def copied(self) -> Any:
        """A copy for another class, which may still change it."""
        variable = copy.copy(self)
        object.__setattr__(variable, "is_declared", False)
        return variable

    def check(self, place: str) -> None:
        """Refuse what can be refused without numbers."""
        if isinstance(self.unit, str):
            try:
                if self.unit:
                    parse_unit(self.unit)
            except ModelError as error:
                fault = error.faults[0]
                refuse("E405", place, f"unit {fault.message}", fault.cure)
        elif not callable(self.unit):
            refuse("E405", place, f"unit={self.unit!r} is neither a text nor a function of structural parameters.")
        if isinstance(self.ports, Parameter):
            if self.ports.type != "string":
                refuse("E405", place, f"ports={self.ports!r} is not a text.", 'Declare it with type="string".')
        elif self.ports and (self.ports.count("{}") != 1 or not self.ports.replace("{}", "1").isidentifier()):
            refuse("E405", place, f"ports={self.ports!r} must be a name with {{}} for the number, as in 'u{{}}'.")
        sizes = self.shape if isinstance(self.shape, tuple) else (self.shape,)
        for size in sizes:
            if isinstance(size, bool) or not (
                callable(size)
                or (isinstance(size, int) and size >= 0)
                or (isinstance(size, str) and size.isidentifier() and isinstance(self, Parameter))
            ):
                refuse(
                    "E405",
                    place,
                    f"shape={self.shape!r} is not a size, a tuple of sizes or a function of structural parameters.",
                )


Kind = str | type[enum.IntEnum] | Enumeration
"""The type of a variable: "real", "int", "bool", or an enumeration."""


def checked_type(type_: Kind, allowed: tuple[str, ...], what: str) -> tuple[str, Mapping[str, int]]:
    """The type as a text, which two equal types share, and the members of an enumeration."""
    resolved_type = Enumeration.of(type_) if isinstance(type_, type) and issubclass(type_, enum.IntEnum) else type_
    if isinstance(resolved_type, Enumeration):
        if not resolved_type.members:
            refuse("E405", "", f"the enumeration {resolved_type.name} has no members.")
        return resolved_type.text, MappingProxyType(dict(resolved_type.members))
    if type_ not in allowed:
        cure = f"Use one of {', '.join(repr(word) for word in allowed)}, or an enum.IntEnum."
        refuse("E405", "", f"type={type_!r} is not a type of {what}.", cure)
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
    sparse: a matrix that may be given by its edges (`sparse.SparseMatrix`).
    table: numbers to look up in (`search`, `pick`, `np.interp`), however many; they are fixed.
    min, max, positive: the allowed range; choices: the allowed texts. excludes: a parameter not to be given with it.
    is_limit: inf and -inf ("inf" and "-inf" in files) may be given, for no limit; equations see UNLIMITED.
    stream: an integer from 0 to 2^52 that identifies the block's stream of random numbers. It is never given:
        it follows from the seed of the run and the name of the stream (see `model.streams`).
    """

    kind = "a parameter"

    def __init__(
        self,
        default: object = REQUIRED,
        *,
        unit: AnyUnit = "",
        shape: Shape = (),
        type: Kind = "real",
        structural: bool = False,
        fixed: bool = False,
        zeros: bool = False,
        sparse: bool = False,
        table: bool = False,
        min: float | None = None,
        max: float | None = None,
        positive: bool = False,
        choices: tuple[str, ...] = (),
        excludes: str = "",
        is_limit: bool = False,
        stream: bool = False,
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, "", doc)
        if stream:
            others = (default is not REQUIRED, unit, shape != (), type != "real", structural, zeros, table, choices)
            if any(others):
                message = "the number of a stream is a real that blocks computes."
                refuse("E405", "", message, "Leave out all arguments but doc=.")
            default, fixed = 0.0, True
        self.stream = stream
        if choices and type == "real":
            type = "string"
        allowed = ("real", "bool", "int", "string") if structural else ("real", "bool", "int")
        if type == "string" and not structural:
            refuse(
                "E405", "", f"a parameter of type '{type}' fixes the type of its block.", "Declare it structural=True."
            )
        self.type, self.members = checked_type(type, allowed, "parameters")
        self.default, self.structural, self.fixed, self.zeros = plain_value(default), structural, fixed or table, zeros
        self.table, self.sparse, self.is_limit = table, sparse, is_limit
        if is_limit and isinstance(self.default, float) and math.isinf(self.default):
            self.default = f"{self.default:f}"  # as a file has it
        self.min, self.max, self.positive, self.choices, self.excludes = min, max, positive, choices, excludes
        self._check_form()

    def _check_form(self) -> None:
        """Refuse arguments that do not fit each other. Raises DeclarationError (E405)."""
        shape, is_single, is_plain = self.shape, self.shape == (), not (self.structural or self.zeros)
        is_real, is_numeric = self.type == "real", self.type in ("real", "int")
        is_sized = is_single or (isinstance(shape, str) and is_numeric)
        is_matrix = isinstance(shape, tuple) and len(shape) == 2
        for is_wrong, message, cure in (
            (self.structural and self.members, "an enumeration cannot be structural.", 'Use choices=("a", "b").'),
            (
                self.is_limit and not (is_plain and not self.table and is_single and is_real),
                "is_limit= is for one real number that is not structural.", "Leave is_limit= out.",
            ),
            (
                self.sparse and not (self.zeros and is_matrix),
                "only a matrix with structural zeros can be sparse.", "Add zeros=True and its sizes.",
            ),
            (
                self.table and not (is_plain and not is_single and is_real),
                "a table must be an array of real numbers.", 'Give it a size, as in shape="n".',
            ),
            (
                self.structural and not is_sized, "a structural parameter must be one value or a list of numbers.",
                'Give it a size, as in shape="m", or use zeros=True.',
            ),
        ):  # fmt: skip
            if is_wrong:
                refuse("E405", "", message, cure)

    def __get__(self, instance: object, owner: object = None) -> Any:
        return self if instance is None else self.of(instance)

    def of(self, block: Any) -> Any:
        """What a block was given, or the default; None where that is computed or missing."""
        default = None if self.default is REQUIRED or callable(self.default) else self.default
        return copy.deepcopy(block.parameters.get(self.name, default))

    def as_unit(self) -> UnitExpression:
        """The unit that this text names. Raises DeclarationError (E405) for a parameter that is no text."""
        if self.type != "string":
            cure = 'Declare it Parameter("", structural=True, type="string"), or write a function of parameters.'
            refuse("E405", self.name, "cannot be a unit: a unit must be a structural text.", cure)
        return UnitExpression((self,), lambda known: known[self.name])

    def __mul__(self, other: object) -> UnitExpression:
        return self.as_unit() * other

    def __rmul__(self, other: object) -> UnitExpression:
        return self.as_unit().__rmul__(other)

    def __truediv__(self, other: object) -> UnitExpression:
        return self.as_unit() / other

    def __rtruediv__(self, other: object) -> UnitExpression:
        return self.as_unit().__rtruediv__(other)

    def __pow__(self, exponent: int) -> UnitExpression:
        return self.as_unit() ** exponent

    def check(self, place: str) -> None:
        super().check(place)
        plain = not (self.default is REQUIRED or self.default is None or callable(self.default))
        if not isinstance(self.choices, tuple) or not all(isinstance(choice, str) for choice in self.choices):
            refuse("E405", place, f"choices={self.choices!r} is not a tuple of texts.")
        if self.choices and plain and self.default not in self.choices:
            refuse("E405", place, f"the default {self.default!r} is not one of {', '.join(self.choices)}.")
        if self.min is not None and self.max is not None and self.min > self.max:
            refuse("E405", place, f"min={self.min!r} is above max={self.max!r}.", "Swap them.")


class Input(Variable):
    """A value from outside. With a default it may stay unwired."""

    kind = "an input"

    def __init__(
        self,
        default: float | bool | None = None,
        *,
        unit: AnyUnit = "",
        shape: Shape = (),
        ports: Ports = "",
        type: Kind = "real",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.type, self.members = checked_type(type, ("real", "int", "bool"), "inputs")
        self.default = default


class Memory(Variable):
    """What a run remembers: states and discretes."""

    def __init__(self, start: object, unit: AnyUnit, shape: Shape, ports: Ports, output: bool, doc: str) -> None:
        super().__init__(unit, shape, ports, doc)
        self.start, self.output = start, output
        self.type = "real"
        if ports and not output:
            refuse("E405", "", "ports= names output ports.", "Add output=True.")

    def initial(self, equation: Function | Equation) -> Equation:
        """Decorator: the value at start, in place of the parameter `<name>_start`."""
        return Equation.of(equation).having(Role("initial", self))

    def _next(self, clock: Clock) -> Callable[[Function | Equation], Equation]:
        return lambda equation: Equation.of(equation).having(Role("next", self, clock=clock))


class State(Memory):
    """A value with a derivative. `output=True` makes it a port too; it starts at the parameter `<name>_start`.

    nominal: its usual size in SI: a number, or a function of parameters that gives one, or one for each element. The
        solver's absolute tolerance is atol * nominal.
    """

    kind = "a state"

    def __init__(
        self,
        start: float = 0.0,
        *,
        unit: AnyUnit = "",
        shape: Shape = (),
        output: bool = False,
        ports: Ports = "",
        nominal: float | Function = 1.0,
        doc: str = "",
    ) -> None:
        super().__init__(start, unit, shape, ports, output, doc)
        self.nominal = nominal
        if callable(nominal):
            return
        if isinstance(nominal, bool) or not isinstance(nominal, (int, float, np.integer, np.floating)):
            cure = "A function of parameters may return one for each element."
            refuse("E405", "", f"nominal={nominal!r} is neither a number nor a function of parameters.", cure)
        if not 0 < nominal < math.inf:
            refuse("E405", "", f"nominal={nominal!r} must be above 0 and finite.")

    def derivative(self, equation: Function | Equation) -> Equation:
        """Decorator: the time derivative of this state."""
        return Equation.of(equation).having(Role("derivative", self))

    def next(self, *, every: str) -> Callable[[Function | Equation], Equation]:
        """Decorator: every="step": the value that replaces this one after each accepted step (a projection)."""
        if every != "step":
            cure = "Use a Discrete, or reset the state at an event."
            refuse("E405", "", f'a state is not replaced at ticks: every={every!r} must be "step".', cure)
        return self._next(Clock(every))


class Discrete(Memory):
    """A value that changes at instants only: by resets, or by `@d.next(every=...)` at ticks.

    visible: "after" lets unsampled equations read a ticked discrete (they then see its value after the tick).
    """

    kind = "a discrete"

    def __init__(
        self,
        start: float | bool = 0.0,
        *,
        type: Kind = "real",
        unit: AnyUnit = "",
        shape: Shape = (),
        output: bool = False,
        ports: Ports = "",
        visible: str = "",
        doc: str = "",
    ) -> None:
        super().__init__(start, unit, shape, ports, output, doc)
        self.type, self.members = checked_type(type, ("real", "int", "bool"), "discretes")
        if type == "bool":
            self.start = bool(start)
        if visible not in ("", "after"):
            refuse("E405", "", f'visible={visible!r} must be "after" or left out.')
        self.visible = visible

    def next(self, *, every: object, offset: object = 0) -> Callable[[Function | Equation], Equation]:
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
        unit: AnyUnit = "",
        shape: Shape = (),
        output: bool = False,
        ports: Ports = "",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.start, self.output = start, output
        if ports and not output:
            refuse("E405", "", "ports= names output ports.", "Add output=True.")

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

    def __init__(self, of: Input, *, delay: object, before: object = 0.0, doc: str = "") -> None:
        if not isinstance(of, Input) or of.type != "real":
            refuse("E405", "", f"a history needs a real Input, not {of!r}.")
        super().__init__(of.unit, of.shape, "", doc)
        self.of, self.delay, self.before = of, delay, before
        if not (isinstance(delay, Parameter) or callable(delay)):
            refuse("E405", "", f"delay={delay!r} is not a Parameter or a function of parameters.")
        if not (isinstance(before, (int, float, Parameter)) or callable(before)):
            refuse("E405", "", f"before={before!r} is not a number, a Parameter or a function of parameters.")


class Stepped(Variable):
    """An output of a stepper: what its program gave at the last tick, held in between; `start` before the first."""

    kind = "a stepped output"

    def __init__(
        self,
        start: object = 0.0,
        *,
        unit: AnyUnit = "",
        shape: Shape = (),
        ports: Ports = "",
        type: Kind = "real",
        doc: str = "",
    ) -> None:
        super().__init__(unit, shape, ports, doc)
        self.type, self.members = checked_type(type, ("real", "int", "bool"), "stepped outputs")
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
        self.type, self.members = checked_type(type, ("real", "int", "bool"), "outputs of FMUs")
        self.is_local, self.held = is_local, held


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
                refuse("E405", "", 'every="step" cannot have an offset.')
            return
        for word, value in (("every", self.every), ("offset", self.offset)):
            number = is_number(value)
            if not (number or isinstance(value, Parameter) or callable(value)):
                refuse("E405", "", f"{word}={value!r} is not a number, a parameter or a function of parameters.")
            if number and not (math.isfinite(value) and (value > 0 if word == "every" else value >= 0)):
                refuse(
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


def plain_value(value: object) -> Any:
    """A copy that nobody else holds, in Python's own numbers and lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if hasattr(value, "tocoo"):
        return edges_of(value)
    if isinstance(value, (list, tuple)):
        return [plain_value(item) for item in value]
    return {key: plain_value(item) for key, item in value.items()} if isinstance(value, dict) else value
