"""A block type with its sizes known: ports, shapes, units, and the values of its parameters.

A block class leaves sizes open (`order`, the length of `num`). `resolve` takes the values that one block was given
and settles everything that does not need equations: sizes, computed defaults, ranges, clocks in exact fractions.
Two blocks with equal `Interface` are of one type, and are traced once.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, lru_cache
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from ..text.errors import Fault, ModelError, did_you_mean
from ..text.expressions import exact_decimal
from ..text.units import parse as parse_unit
from ..text.units import si_text, to_si
from .declaration import Declaration
from .equations import Output
from .outside import outside
from .reads import arguments
from .variables import REQUIRED, Algebraic, Clock, Discrete, History, Parameter, State, Stepped, Variable

__all__ = ["Interface", "Port", "Resolved", "Value", "limits", "resolve"]

Array = np.ndarray[Any, Any]
LEAST_DELAY = 1e-15  # s
# Every element of a state, and every port, is looked at by itself; a matrix is not.
LARGEST, LARGEST_MEMORY, MOST_PORTS = 1_000_000, 20_000, 100_000
"""The most elements of a variable, of a state or a discrete, and of a variable whose elements are ports."""


@dataclass(frozen=True, slots=True)
class Value:
    """A parameter's value in SI: an array, bool, int or text; exact where it is a decimal; its unit ("" unknown)."""

    value: Any
    exact: Fraction | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Port:
    """An input or an output by the name that wires use: elements `first` to `first + size` of a variable."""

    name: str
    variable: str
    shape: tuple[int, ...]
    first: int
    size: int
    units: tuple[str, ...]  # one for each element, in SI
    declared: tuple[str, ...]  # as the class says it
    type: str
    default: tuple[float, ...] | None = None  # of an input: one for each element, in SI

    @property
    def unit(self) -> str:
        """The one unit of all elements, or "" where they differ."""
        return self.units[0] if len(set(self.units)) == 1 else ""

    @property
    def types(self) -> tuple[str, ...]:
        """The type of each element."""
        return _alike(self.type, self.size)


@lru_cache(maxsize=1024)
def _alike(type_: str, size: int) -> tuple[str, ...]:
    return (type_,) * size


class Interface:
    """A block class with its structural values; equal interfaces are one type.

    cls: the block class. structural: its structural values and sizes. patterns: the zero patterns of parameters
    that fix the type, as tuples of bools (True: may differ from 0).
    """

    def __init__(self, cls: Any, structural: Mapping[str, Any], patterns: Mapping[str, tuple[bool, ...]]) -> None:
        self.cls = cls
        self.declaration: Declaration = cls.declaration
        self.structural = dict(structural)
        self.patterns = dict(patterns)
        self._shapes: dict[Variable, tuple[int, ...]] = {}
        self.key = (cls, tuple(sorted(self.structural.items())), tuple(sorted(self.patterns.items())))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Interface) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def name(self) -> str:
        return self.declaration.name

    def _call(self, function: Callable[..., Any]) -> Any:
        return function(*(self.structural[name] for name in arguments(function, self.name)))

    def _computed(self, function: Callable[..., Any], variable: Variable, what: str) -> Any:
        try:
            return self._call(function)
        except Exception as error:  # a function of the class may raise anything
            message = f"{what} cannot be computed: {type(error).__name__}: {error}."
            raise ModelError(Fault("E110", f"{self.name}.{variable.name}", message)) from error

    def shape(self, variable: Variable) -> tuple[int, ...]:
        """The sizes of a variable; () is a scalar. Raises ModelError (E110)."""
        found = self._shapes.get(variable)
        if found is None:
            found = self._shapes[variable] = self._shape(variable)
        return found

    def _shape(self, variable: Variable) -> tuple[int, ...]:
        shape: Any = variable.shape
        if callable(shape):
            shape = self._computed(shape, variable, "the shape")
        sizes: list[int] = []
        for size in shape if isinstance(shape, (tuple, list)) else (shape,):
            if callable(size):
                size = self._computed(size, variable, "the shape")
            elif isinstance(size, str):
                size = self.structural.get(size, size)
            if isinstance(size, bool) or not isinstance(size, (int, np.integer)) or size < 0:
                raise ModelError(
                    Fault("E110", f"{self.name}.{variable.name}", f"the size {size!r} is not an integer from 0 on.")
                )
            sizes.append(int(size))
        most = LARGEST_MEMORY if isinstance(variable, (State, Discrete)) else LARGEST
        most = min(most, MOST_PORTS) if getattr(variable, "ports", "") else most
        if math.prod(sizes) > most:
            message = f"would have {math.prod(sizes):,} elements; {most:,} are the most."
            raise ModelError(Fault("E110", f"{self.name}.{variable.name}", message, "Make the block smaller."))
        return tuple(sizes)

    def declared_units(self, variable: Variable) -> tuple[str, ...]:
        """The unit of each element, as declared."""
        size = math.prod(self.shape(variable))
        unit: Any = variable.unit
        if callable(unit):
            unit = self._computed(unit, variable, "the unit")
        if isinstance(unit, str):
            return (unit,) * size
        if len(unit) != size:
            raise ModelError(
                Fault("E110", f"{self.name}.{variable.name}", f"has {size} elements but {len(unit)} units.")
            )
        return tuple(unit)

    def _ports(self, variable: Any) -> Iterable[Port]:
        shape, declared = self.shape(variable), self.declared_units(variable)
        try:
            si = tuple(si_text(unit) for unit in declared)
        except ModelError as error:
            fault = error.faults[0]
            raise ModelError(Fault("E114", f"{self.name}.{variable.name}", fault.message, fault.cure)) from None
        defaults: tuple[float, ...] | None = None
        if (default := getattr(variable, "default", None)) is not None:
            values = np.broadcast_to(np.asarray(default, dtype=float), shape).reshape(-1).tolist()
            defaults = tuple(to_si(value, u) if u else value for value, u in zip(values, declared, strict=True))
        type_ = variable.type
        if variable.ports:
            for index in range(len(si)):
                name = variable.ports.format(index + 1)
                yield Port(
                    name,
                    variable.name,
                    (),
                    index,
                    1,
                    si[index : index + 1],
                    declared[index : index + 1],
                    type_,
                    None if defaults is None else defaults[index : index + 1],
                )
        else:
            yield Port(variable.name, variable.name, shape, 0, len(si), si, declared, type_, defaults)

    def _named(self, variables: Iterable[Variable]) -> dict[str, Port]:
        made: dict[str, Port] = {}
        for port in (port for variable in variables for port in self._ports(variable)):
            if port.name in made:
                message = f"'{made[port.name].variable}' and '{port.variable}' both have a port of this name."
                raise ModelError(Fault("E109", f"{self.name}.{port.name}", message))
            made[port.name] = port
        return made

    @cached_property
    def inputs(self) -> dict[str, Port]:
        return self._named(self.declaration.inputs.values())

    @cached_property
    def outputs(self) -> dict[str, Port]:
        d = self.declaration
        memories: list[Any] = [*d.states.values(), *d.discretes.values(), *d.algebraics.values()]
        stepped = d.stepped.values()
        given = (made for made in d.given.values() if not made.is_local)
        return self._named([*d.outputs.values(), *stepped, *given, *(memory for memory in memories if memory.output)])

    @cached_property
    def locals(self) -> dict[str, Port]:
        """What is no output of an FMU and can be recorded."""
        d = self.declaration
        states = (state for state in d.states.values() if d.foreign is not None and not state.output)
        return self._named([*(made for made in d.given.values() if made.is_local), *states])

    @cached_property
    def rearranged(self) -> frozenset[str]:
        """The output ports that only rearrange inputs."""
        wiring = {name for name, output in self.declaration.outputs.items() if output.wiring}
        return frozenset(name for name, port in self.outputs.items() if port.variable in wiring)

    @cached_property
    def output_units(self) -> Mapping[str, str]:
        """The unit of each output port."""
        return {name: port.unit for name, port in self.outputs.items()}

    @cached_property
    def symbolic_parameters(self) -> dict[str, Parameter]:
        """The parameters that equations see as values that may change: not the structural, optional, or tables."""
        return {
            name: p
            for name, p in self.declaration.parameters.items()
            if not p.structural and not p.table and p.default is not None
        }

    @cached_property
    def optional_parameters(self) -> dict[str, Parameter]:
        """Those that may have no value."""
        return {name: p for name, p in self.declaration.parameters.items() if p.default is None}

    @cached_property
    def tables(self) -> dict[str, Parameter]:
        """The parameters that equations look up in."""
        return {name: p for name, p in self.declaration.parameters.items() if p.table}


@dataclass(frozen=True)
class Resolved:
    """One block with all its numbers: its type, its parameter values, its clocks in exact fractions, its delays."""

    interface: Interface
    values: Mapping[str, Value]
    clocks: Mapping[str, tuple[Fraction, Fraction]]  # equation -> (period, offset)
    starts: Mapping[str, Array]  # sampled output -> the value held before its first tick
    delays: Mapping[str, tuple[float, Array]]  # history -> its delay in s, and its values before the start
    nominal: tuple[float, ...]  # the usual size of each element of each state, one state after the other


def resolve(cls: Any, given: Mapping[str, Value], place: str = "") -> Resolved:
    """Settle sizes, defaults, ranges and clocks of one block.

    given: values by parameter name, evaluated, in SI. Raises ModelError with every fault found (E106, E107, E110).

    Above 60 lines because the checks follow one another, each on what the earlier ones have settled.
    """
    declaration: Declaration = cls.declaration
    place = place or declaration.name
    faults: list[Fault] = []
    values: dict[str, Value] = {}

    def fault(code: str, name: str, message: str, cure: str = "") -> None:
        faults.append(Fault(code, f"{place}.{name}" if name else place, message, cure))

    for name, value in given.items():
        if name not in declaration.parameters:
            fault("E106", name, "there is no such parameter.", did_you_mean(name, declaration.parameters))
            continue
        try:
            values[name] = _typed(declaration.parameters[name], value)
        except ValueError as error:
            fault("E107", name, str(error), error.cure if isinstance(error, _NoNumber) else "")
    for name, parameter in declaration.parameters.items():
        if parameter.excludes:
            both = (given.get(name), given.get(parameter.excludes))
            if all(value is not None and value.value is not None for value in both):
                fault("E107", name, f"cannot be given together with '{parameter.excludes}'.", "Give one of the two.")
        if parameter.default is REQUIRED and name not in given:
            fault("E107", name, "must be given: it has no default.", f'Add "{name}" to its parameters.')
    for name in sorted(_sizing(declaration) & values.keys()) if values else ():
        if isinstance(values[name].value, int) and abs(values[name].value) > LARGEST:
            fault("E107", name, f"must be at most {LARGEST:,}, not {values[name].value:,}: sizes follow from it.")
    if faults:
        raise ModelError(*faults)
    structural = _defaults(declaration, values, place)
    interface = Interface(cls, structural, {})
    settled = _settled(declaration)
    for name, parameter in declaration.parameters.items():
        value = values[name]
        if parameter.structural or value.value is None or value is settled.get(name):
            continue
        try:
            shape = interface.shape(parameter)
        except ModelError as error:
            faults += error.faults
            continue
        if value.value.shape == () and parameter.table:
            fault("E110", name, "is a table, which a single number does not fill.", "Give a list.")
        elif value.value.shape == ():  # a scalar fills an array
            values[name] = Value(np.broadcast_to(value.value, shape), value.exact, value.unit)
        elif value.value.shape != shape:
            fault("E110", name, f"has the shape {_shape(value.value.shape)}, but {_shape(shape)} is needed.")
    if faults:
        raise ModelError(*faults)
    for name, parameter in declaration.parameters.items():
        if values[name] is settled.get(name):
            continue
        problem = _range_problem(parameter, values[name].value, _unit(parameter, values))
        if problem:
            fault("E107", name, problem)
    if faults:
        raise ModelError(*faults)
    for variable in (*declaration.inputs.values(), *declaration.states.values(), *declaration.discretes.values()):
        try:
            interface.shape(variable)
        except ModelError as error:
            faults += error.faults
    if faults:
        raise ModelError(*faults)
    for requirement in declaration.requirements:
        known = {**{n: v.value for n, v in values.items()}, **structural}
        equation = requirement.equation
        try:
            holds = np.all(equation.function(*(known[name] for name in equation.reads)))
        except ModelError as error:  # what it says itself
            fault("E107", "", f"{requirement.message}: {error.faults[0].message}", error.faults[0].cure)
            continue
        except Exception as error:  # a function of the class may raise anything
            fault("E107", "", f"{requirement.message} ({type(error).__name__}: {error}).")
            continue
        if not holds:
            shown = ", ".join(f"{name} = {_shown(known[name])}" for name in equation.reads)
            fault("E107", "", f"{requirement.message} ({shown}).")
    patterns = {
        name: tuple(bool(x) for x in np.ravel(values[name].value != 0))
        for name, parameter in declaration.parameters.items()
        if parameter.zeros and values[name].value is not None
    }
    interface = _shared(Interface(cls, structural, patterns))
    clocks: dict[str, tuple[Fraction, Fraction]] = {}
    for equation in declaration.equations:
        for role in equation.roles:
            if role.clock is not None and role.ticks:
                try:
                    period, offset = (_exact(word, role.clock, values, structural) for word in ("every", "offset"))
                except Exception as error:  # a function of the class may raise anything
                    fault("E107", equation.name, f"its clock cannot be computed: {type(error).__name__}: {error}.")
                    continue
                if period <= 0 or offset < 0:
                    message = f"ticks every {float(period)} s from {float(offset)} s on are not possible."
                    fault("E107", equation.name, message)
                clocks[equation.name] = (period, offset)
    if declaration.stepper is not None:
        clock, place_ = declaration.stepper.clock, declaration.stepper.name
        try:
            clocks[place_] = _exact("every", clock, values, structural), _exact("offset", clock, values, structural)
        except Exception as error:  # a function of the class may raise anything
            fault("E107", place_, f"its clock cannot be computed: {type(error).__name__}: {error}.")
    starts: dict[str, Array] = {}
    begin: list[Output | Stepped] = [*declaration.outputs.values(), *declaration.stepped.values()]
    for made in begin:
        name = made.name
        if isinstance(made, Stepped) or made.clock is not None:
            try:
                starts[name] = _start(made, made.start, values, structural, interface)
            except Exception as error:  # a function of the class may raise anything
                fault("E110", name, f"its start cannot be computed: {type(error).__name__}: {error}.")
    delays: dict[str, tuple[float, Array]] = {}
    for name, history in declaration.histories.items():
        try:
            delay = float(_time(history.delay, values, structural))
            before = _start(history, history.before, values, structural, interface)
        except Exception as error:  # a function of the class may raise anything
            fault("E110", name, f"its delay cannot be computed: {type(error).__name__}: {error}.")
            continue
        # No step is longer than a delay: a run of a second would take more than 1e15 of them.
        if not (math.isfinite(delay) and delay >= LEAST_DELAY):
            fault("E107", name, f"a delay of {delay} s is not possible.", f"A delay is {LEAST_DELAY} s or more.")
        delays[name] = (delay, before)
    if faults:  # a nominal may need what the requirements say
        raise ModelError(*faults)
    nominal: list[float] = []
    for name, state in declaration.states.items():
        try:
            nominal += _nominal(state, values, structural, interface)
        except Exception as error:  # a function of the class may raise anything
            fault("E110", name, f"its nominal cannot be computed: {type(error).__name__}: {error}.")
    if faults:
        raise ModelError(*faults)
    return Resolved(interface, values, clocks, starts, delays, tuple(nominal))


def _sizing(declaration: Declaration) -> set[str]:
    """The parameters that sizes are computed from."""
    d = declaration
    tables = (d.parameters, d.inputs, d.outputs, d.states, d.discretes)
    shapes = [variable.shape for table in tables for variable in table.values()]
    sizes = [size for shape in shapes for size in (shape if isinstance(shape, (tuple, list)) else (shape,))]
    return {name for size in sizes if callable(size) for name in arguments(size, "the shape")}


def _shared(interface: Interface) -> Interface:
    """The interface of this type that is in use already, if there is one: its ports and shapes are known."""
    # The text tells 1 from True, and 0.0 from -0.0, which are equal. Shapes may follow from what stands outside.
    read = outside(interface.declaration) if _has_functions(interface.declaration) else None
    return _IN_USE.setdefault((interface.key, str(interface.structural), read), interface)


@cache
def _has_functions(declaration: Declaration) -> bool:
    """Whether functions give shapes or units."""
    shapes = (variable.shape for variable in declaration.readable.values())
    sizes = (size for shape in shapes for size in (shape if isinstance(shape, tuple) else (shape,)))
    return any(map(callable, (*sizes, *(variable.unit for variable in declaration.readable.values()))))


_IN_USE: WeakValueDictionary[Any, Interface] = WeakValueDictionary()


class _NoNumber(ValueError):
    """A text where a number is needed."""

    def __init__(self, text: str) -> None:
        super().__init__(f"must be a number, not the text {text!r}.")
        self.text = text

    @property
    def cure(self) -> str:
        """What the text was probably meant to be."""
        found = re.fullmatch(r"([-+]?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?) *([^\W\d_]\S*|%)?", self.text[:60])
        if found is None:
            return 'An expression begins with =, as in "=2*gain".'
        quantity = f'{{"value": {found[1]}, "unit": "{found[2]}"}}'
        return f"Write {quantity}." if found[2] else f"Write it without quotes: {found[1]}."


def _typed(parameter: Parameter, value: Value) -> Value:
    """A given value in the type of its parameter. Raises ValueError with a sentence."""
    raw = value.value
    if raw is None and parameter.default is None:
        return value
    if parameter.type == "string":
        if not isinstance(raw, str):
            raise ValueError(f"must be a text, not {raw!r}.")
        return value
    if parameter.type == "bool":
        flags = _array(raw)
        if flags.dtype != bool or (parameter.structural and flags.ndim):
            raise ValueError(f"must be true or false, not {raw!r}.")
        return Value(bool(raw)) if parameter.structural else Value(_frozen(flags.astype(float)))
    if parameter.members:
        return Value(_frozen(_members(parameter, raw)))
    if isinstance(raw, str):
        raise _NoNumber(raw)
    if type(raw) is float and parameter.type == "real" and not parameter.structural and math.isfinite(raw):
        return Value(_frozen(np.array(raw)), value.exact, value.unit)
    array = _array(raw)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"must be a number, not {raw!r}.")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"must be finite, not {_shown(raw)}.")
    if parameter.structural and array.ndim > (parameter.shape != ()):
        raise ValueError(f"must be {'one number' if parameter.shape == () else 'a list'}, not {_shown(raw)}.")
    if parameter.type == "int":
        if not all(float(x).is_integer() and abs(float(x)) <= 2**53 for x in array.flat):
            raise ValueError(f"must be {'an integer' if array.ndim == 0 else 'integers'}, not {_shown(raw)}.")
        if not parameter.structural:
            return Value(_frozen(array.astype(float)), value.exact, value.unit)
        return Value(_structural(array, int, parameter))
    if parameter.structural:
        return Value(_structural(array, float, parameter), value.exact, value.unit)
    return Value(_frozen(array.astype(float)), value.exact, value.unit)


def _members(parameter: Parameter, raw: Any) -> Array:
    """The numbers of members of an enumeration, given by name or by number."""
    known = parameter.members
    names = np.array(raw, dtype=object)
    made = np.empty(names.shape)
    for place, item in np.ndenumerate(names):
        if item in known:
            made[place] = known[item]
        elif isinstance(item, (int, float)) and not isinstance(item, bool) and item in known.values():
            made[place] = item
        else:
            raise ValueError(f"must be one of {', '.join(known)}, not {item!r}.")
    return made


def _structural(array: Array, kind: type, parameter: Parameter) -> Any:
    """A structural value as it fixes a type: a plain number, or a tuple of them."""
    if parameter.shape == ():
        return kind(array)
    return tuple(kind(x) for x in np.atleast_1d(array))


def _array(raw: Any) -> Array:
    try:
        made = np.array(raw)
    except ValueError:
        raise ValueError(f"must be numbers in rows of equal length, not {raw!r}.") from None
    whole = made.dtype == object and all(isinstance(x, int) for x in made.flat)  # too long for numpy's integers
    return made.astype(float) if whole else made


def _frozen(array: Array) -> Array:
    array.setflags(write=False)
    return array


def _defaults(declaration: Declaration, values: dict[str, Value], place: str) -> dict[str, Any]:
    """Fill in the defaults, the computed ones last, and infer the sizes; returns structural values and sizes."""
    sizes: dict[str, int] = {}
    makers: dict[str, str] = {}  # the parameter that each size is known from
    clash: list[Fault] = []

    def infer(name: str) -> None:
        parameter, raw = declaration.parameters[name], values[name].value
        shape = parameter.shape if isinstance(parameter.shape, tuple) else (parameter.shape,)
        if np.ndim(raw) == 0 or not any(isinstance(size, str) for size in shape):
            return
        if np.ndim(raw) != len(shape):
            clash.append(
                Fault("E110", f"{place}.{name}", f"has {np.ndim(raw)} dimensions, but {len(shape)} are needed.")
            )
            return
        for size, actual in zip(shape, np.shape(raw), strict=True):
            if isinstance(size, str) and sizes.setdefault(size, actual) != actual:
                message = f"has the shape {_shape(np.shape(raw))}, which makes {size} = {actual}, "
                message += f"but {makers[size]} makes it {sizes[size]}."
                if makers[size] == name:
                    message = f"has the shape {_shape(np.shape(raw))}, but {' x '.join(map(str, shape))} is needed."
                clash.append(Fault("E110", f"{place}.{name}", message))
            elif isinstance(size, str):
                makers.setdefault(size, name)

    given = list(values)
    for name in given:
        infer(name)
    settled = _settled(declaration)
    # Structural values first: the units of the others may follow from them.
    for name, parameter in sorted(declaration.parameters.items(), key=lambda item: not item[1].structural):
        if name in settled and name not in values:
            values[name] = settled[name]
        elif name not in values and not callable(parameter.default):
            try:
                made = Value(None) if parameter.default is None else default_value(parameter, _unit(parameter, values))
                values[name] = made if made.value is None else _typed(parameter, made)
            except (TypeError, ValueError) as error:
                raise ModelError(Fault("E107", f"{place}.{name}", f"the default {error}")) from None
            infer(name)
    if clash:
        raise ModelError(*clash)
    waiting = [name for name in declaration.parameters if name not in values]
    while waiting:  # computed defaults; the class has no cycles, so each pass settles one at least
        rest = []
        for name in waiting:
            parameter = declaration.parameters[name]
            reads = arguments(parameter.default, name)
            known = {**{n: v.value for n, v in values.items()}, **sizes}
            if all(read in known for read in reads):
                try:
                    with np.errstate(all="ignore"):
                        raw = parameter.default(*(known[read] for read in reads))
                except ValueError as error:  # what a class has to say to its user
                    raise ModelError(Fault("E107", f"{place}.{name}", str(error))) from error
                except Exception as error:  # a function of the class may raise anything
                    message = f"the default cannot be computed: {type(error).__name__}: {error}."
                    raise ModelError(Fault("E107", f"{place}.{name}", message)) from error
                try:
                    values[name] = _typed(parameter, Value(raw))
                except ValueError as error:
                    raise ModelError(Fault("E107", f"{place}.{name}", f"the default {error}")) from None
                infer(name)
            else:
                rest.append(name)
        if len(rest) == len(waiting):
            missing = {r for n in rest for r in arguments(declaration.parameters[n].default, n)} - set(values)
            raise ModelError(Fault("E110", f"{place}.{rest[0]}", f"{', '.join(sorted(missing))} cannot be known."))
        waiting = rest
    clash += [
        Fault("E110", place, f"the size {size} cannot be known.", "Give an array that has it.")
        for size in declaration.sizes
        if size not in sizes
    ]
    if clash:
        raise ModelError(*clash)
    structural = {name: values[name].value for name, p in declaration.parameters.items() if p.structural}
    return {**structural, **sizes}


@cache
def _settled(declaration: Declaration) -> Mapping[str, Value]:
    """The values of scalars that are not given, with which nothing is wrong and on which nothing else bears.

    An FMU may have 300,000 of them, and each look at its block asks for all.
    """
    made: dict[str, Value] = {}
    for name, parameter in declaration.parameters.items():
        unit, is_scalar = parameter.unit, parameter.shape == () and not parameter.structural
        if is_scalar and type(parameter.default) is float and parameter.type == "real" and isinstance(unit, str):
            with contextlib.suppress(ValueError, ModelError):  # told where it is used
                value = _typed(parameter, default_value(parameter, unit))
                if not _range_problem(parameter, value.value, unit):
                    made[name] = value
    return made


def _unit(parameter: Parameter, values: Mapping[str, Value]) -> str:
    """The declared unit of a parameter, once structural values are known; "" where its elements have several."""
    if isinstance(parameter.unit, str):
        return parameter.unit
    names = arguments(parameter.unit, parameter.name)
    if not all(name in values for name in names):
        return ""
    unit = parameter.unit(*(values[name].value for name in names))
    return unit if isinstance(unit, str) else unit[0] if len(set(unit)) == 1 else ""


def default_value(parameter: Parameter, unit: str) -> Value:
    """The plain default of a parameter, given in its declared unit, in SI; exact where decimal and unit are."""
    raw = parameter.default
    if isinstance(raw, (bool, str)) or parameter.type in ("bool", "string", "int") or parameter.members:
        return Value(raw)
    scaled = bool(unit) and parse_unit(unit).factor != 1.0
    if isinstance(raw, float) or np.ndim(raw) == 0:
        exact: Fraction | None = exact_decimal(float(raw))
        if scaled:
            factor = parse_unit(unit).exact
            exact_si = None if factor is None or exact is None else exact * factor
            return Value(to_si(float(raw), unit), exact_si)
        return Value(float(raw), exact)
    return Value(np.vectorize(lambda x: to_si(float(x), unit))(raw) if scaled else raw)


def limits(parameter: Parameter, values: Mapping[str, Value]) -> tuple[float | None, float | None]:
    """The smallest and the largest value of a parameter in SI, None where there is none. `positive` is apart.

    values: those of its block, from which its unit may follow.
    """
    return _limits(parameter, _unit(parameter, values))


def _limits(parameter: Parameter, unit: str) -> tuple[float | None, float | None]:
    # min and max are in the unit of the declaration, the value is in SI.
    low, high = (None if x is None else to_si(float(x), unit) if unit else x for x in (parameter.min, parameter.max))
    return low, high


def _range_problem(parameter: Parameter, raw: Any, unit: str) -> str:
    if raw is None:
        return ""
    if parameter.choices:
        return "" if raw in parameter.choices else f"must be one of {', '.join(parameter.choices)}, not {raw!r}."
    if isinstance(raw, str) or parameter.type == "bool" or parameter.members:
        return ""
    if parameter.min is None and parameter.max is None and not parameter.positive:
        return ""
    low, high = _limits(parameter, unit)
    unit = "" if unit == "1" else unit
    numbers, in_unit = np.asarray(raw, dtype=float), f" {unit}" if unit else ""
    if parameter.positive and not np.all(numbers > 0):
        return f"must be above 0, not {_shown(raw)}."
    if low is not None and not np.all(numbers >= low):
        return f"must be at least {parameter.min}{in_unit}, not {_shown(raw)}{_si(unit)}."
    if high is not None and not np.all(numbers <= high):
        return f"must be at most {parameter.max}{in_unit}, not {_shown(raw)}{_si(unit)}."
    return ""


def _si(unit: str) -> str:
    return f" {si_text(unit)}" if unit else ""


def _exact(word: str, clock: Clock, values: Mapping[str, Value], structural: Mapping[str, Any]) -> Fraction:
    """A period or an offset as an exact fraction."""
    return _time(clock.every if word == "every" else clock.offset, values, structural)


def _time(source: Any, values: Mapping[str, Value], structural: Mapping[str, Any]) -> Fraction:
    """A time that a class gives as a parameter, a function of parameters or a number, as an exact fraction."""
    if isinstance(source, Parameter):
        return _fraction(values[source.name])
    if callable(source):
        names = arguments(source, "clock")
        known = {**values, **{name: Value(value) for name, value in structural.items()}}
        try:
            made = source(*(_fraction(known[name]) for name in names))
        except Exception:  # a function that fractions do not know, such as math.sqrt of numpy
            made = None
        if isinstance(made, (Fraction, int)):
            return Fraction(made)
        return exact_decimal(float(source(*(known[name].value for name in names))))
    return exact_decimal(float(source))


def _fraction(value: Value) -> Fraction:
    return exact_decimal(float(value.value)) if value.exact is None else value.exact


def _start(
    made: Output | Stepped | History,
    start: Any,
    values: Mapping[str, Value],
    structural: Mapping[str, Any],
    interface: Interface,
) -> Array:
    """What a sampled output holds before its first tick, or a history before the start."""
    if isinstance(start, Parameter):
        start = values[start.name].value
    elif callable(start):
        known = {**{name: value.value for name, value in values.items()}, **structural}
        start = start(*(known[name] for name in arguments(start, made.name)))
    else:  # a plain number is in the declared unit
        shape, declared = interface.shape(made), interface.declared_units(made)
        plain = np.ravel(np.broadcast_to(np.asarray(start, dtype=float), shape))
        start = [to_si(float(x), unit) if unit else float(x) for x, unit in zip(plain, declared, strict=True)]
        start = np.reshape(start, shape)
    held = np.ravel(np.broadcast_to(np.asarray(start, dtype=float), interface.shape(made))).copy()
    if not np.all(np.isfinite(held)):
        raise ValueError(f"{_shown(held)} is not finite")
    return held


def _nominal(
    state: State, values: Mapping[str, Value], structural: Mapping[str, Any], interface: Interface
) -> list[float]:
    """The usual size of each element of a state. Raises ValueError with a sentence, and what its function raises."""
    shape = interface.shape(state)
    if not callable(state.nominal):
        return [float(state.nominal)] * math.prod(shape)
    known = {**{name: value.value for name, value in values.items()}, **structural}
    made = np.asarray(state.nominal(*(known[name] for name in arguments(state.nominal, state.name))), dtype=float)
    if made.shape not in ((), shape):
        raise ValueError(f"it has the shape {_shape(made.shape)}, but {_shape(shape)} or one number is needed")
    if not np.all((made > 0) & np.isfinite(made)):
        raise ValueError(f"{_shown(made)} must be above 0 and finite")
    sizes: list[float] = np.ravel(np.broadcast_to(made, shape)).tolist()
    return sizes


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) if shape else "a scalar"


def _shown(raw: Any) -> str:
    text = np.array2string(np.asarray(raw), threshold=6) if np.ndim(raw) else f"{raw}"
    return " ".join(text.split())


def memory_start(values: Mapping[str, Value], variable: State | Discrete | Algebraic) -> Array | None:
    """The start value of a state or discrete, flat, or None where an initial equation gives it."""
    value = values.get(f"{variable.name}_start")
    return None if value is None else np.ravel(value.value)
