"""A block type with its sizes known: its ports, shapes and units.

A block class leaves sizes open (`order`, the length of `num`); its structural values settle them. Two blocks with equal
`Interface` are of one type, and are traced once. `resolution` makes it from the values that one block was given.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..text.errors import Fault, ModelError
from ..text.printable import counted, quoted
from ..text.units import Declared, OfUnits, difference, has_offset, si_text, single, to_si
from .declaration import Declaration
from .reads import arguments
from .variables import Discrete, Parameter, State, Variable

# Every element of a state, and every port, is looked at by itself; a matrix is not.
LARGEST, LARGEST_MEMORY, MOST_PORTS = 1_000_000, 20_000, 100_000
"""The most elements of a variable, of a state or a discrete, and of a variable whose elements are ports."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,199}", re.ASCII).fullmatch


@dataclass(frozen=True, slots=True)
class Value:
    """A parameter's value in SI: an array, bool, int or text; exact where it is a decimal; its unit ("" unknown)."""

    value: Any
    exact: Fraction | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Port(OfUnits):
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
    def types(self) -> tuple[str, ...]:
        """The type of each element."""
        return _alike(self.type, self.size)


@lru_cache(maxsize=1024)
def _alike(type_: str, size: int) -> tuple[str, ...]:
    return (type_,) * size


def check_differences(units: Iterable[str], place: str) -> None:
    """Refuse a unit with an offset that a block is given: its amplitudes and slopes are differences (E114)."""
    for unit in dict.fromkeys(units):
        if unit and has_offset(unit):
            message = f"the unit {unit!r} has an offset, but the values of this block are differences, which have none."
            cure = f"Use {difference(unit)!r}; values can still be given in {unit}."
            raise ModelError(Fault("E114", place, message, cure))


def not_computed(code: str, place: str, what: str, error: Exception) -> Fault:
    """Return the fault of a value whose function raised an error; a ModelError has a code and a sentence already."""
    if isinstance(error, ModelError):
        return replace(error.faults[0], place=place)
    return Fault(code, place, f"{what} cannot be computed: {type(error).__name__}: {error}.")


def unit_from(parameter: Parameter, known: Mapping[str, Value]) -> Declared:
    """Return the declared unit of a parameter, or of each element. known: the values that it follows from."""
    if isinstance(parameter.unit, str):
        return parameter.unit
    unit = parameter.unit(*(known[name].value for name in arguments(parameter.unit, parameter.name)))
    return unit if isinstance(unit, str) else tuple(unit)


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
        self.key = (cls.declaration, tuple(sorted(self.structural.items())), tuple(sorted(self.patterns.items())))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Interface) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def name(self) -> str:
        return self.declaration.name

    def _call(self, function: Callable[..., object]) -> Any:
        return function(*(self.structural[name] for name in arguments(function, self.name)))

    def _computed(self, function: Callable[..., object], variable: Variable, what: str) -> object:
        try:
            return self._call(function)
        except Exception as error:  # a function of the class may raise anything
            raise ModelError(not_computed("E110", f"{self.name}.{variable.name}", what, error)) from error

    def shape(self, variable: Variable) -> tuple[int, ...]:
        """The sizes of a variable; () is a scalar. Raises ModelError (E110)."""
        sizes = self._shapes.get(variable)
        if sizes is None:
            sizes = self._shapes[variable] = self._shape(variable)
        return sizes

    def _shape(self, variable: Variable) -> tuple[int, ...]:
        shape: object = variable.shape
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
                    Fault("E110", f"{self.name}.{variable.name}", f"a size must be an integer from 0 on, not {size!r}.")
                )
            sizes.append(int(size))
        most = LARGEST_MEMORY if isinstance(variable, (State, Discrete)) else LARGEST
        most = min(most, MOST_PORTS) if getattr(variable, "ports", "") else most
        if math.prod(sizes) > most:
            message = f"would have {math.prod(sizes):,} elements; the limit is {most:,}."
            raise ModelError(Fault("E110", f"{self.name}.{variable.name}", message, "Make the block smaller."))
        return tuple(sizes)

    def declared_units(self, variable: Variable) -> tuple[str, ...]:
        """The unit of each element, as declared."""
        size = math.prod(self.shape(variable))
        unit: Any = variable.unit
        if callable(unit):
            unit = self._computed(unit, variable, "the unit")
            check_differences((unit,) if isinstance(unit, str) else unit, f"{self.name}.{variable.name}")
        if isinstance(unit, str):
            return (unit,) * size
        if len(unit) != size:
            raise ModelError(
                Fault("E110", f"{self.name}.{variable.name}", f"has {size} elements but {len(unit)} units.")
            )
        return tuple(unit)

    def declared_unit(self, variable: Variable) -> str:
        """Return the one declared unit of all elements; "" if they differ."""
        return variable.unit if isinstance(variable.unit, str) else single(self.declared_units(variable))

    def memory_units(self, name: str) -> tuple[str, ...]:
        """Return the declared unit of each element of a state or a discrete; nothing if there is none of this name."""
        memory: dict[str, Variable] = {**self.declaration.states, **self.declaration.discretes}
        return self.declared_units(memory[name]) if name in memory else ()

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
        if names := self._element_names(variable, len(si)):
            for index, name in enumerate(names):
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

    def _element_names(self, variable: Variable, size: int) -> Sequence[str]:
        """Return the names of the ports of the elements of a variable; none if the whole variable is one port."""
        if isinstance(variable.ports, str):
            return [variable.ports.format(index + 1) for index in range(size)] if variable.ports else ()
        names = self._given_names(variable)
        place, cure = f"{self.name}.{variable.ports.name}", 'Give one name for each element, as in "a, b".'
        if wrong := [name for name in names if not _NAME(name)]:
            raise ModelError(Fault("E110", place, f"{quoted(wrong[0])} cannot be the name of a port.", cure))
        if names and len(names) != size:
            elements = f"{variable.name} has {counted(size, 'element')}"
            raise ModelError(Fault("E110", place, f"has {counted(len(names), 'name')}, but {elements}.", cure))
        return names

    def _given_names(self, variable: Variable) -> list[str]:
        """Return the names of the ports of a variable that the block was given."""
        text = "" if isinstance(variable.ports, str) else self.structural[variable.ports.name]
        return [name.strip() for name in text.split(",")] if text else []

    def _named(self, variables: Iterable[Variable]) -> dict[str, Port]:
        ports: dict[str, Port] = {}
        for port in (port for variable in variables for port in self._ports(variable)):
            if port.name in ports:
                message = f"'{ports[port.name].variable}' and '{port.variable}' both have a port of this name."
                raise ModelError(Fault("E109", f"{self.name}.{port.name}", message))
            ports[port.name] = port
        return ports

    @cached_property
    def inputs(self) -> dict[str, Port]:
        return self._named(self.declaration.inputs.values())

    @cached_property
    def outputs(self) -> dict[str, Port]:
        d = self.declaration
        memories: list[Any] = [*d.states.values(), *d.discretes.values(), *d.algebraics.values()]
        stepped = d.stepped.values()
        given = (signal for signal in d.given.values() if not signal.is_local)
        taken = {name for variable in (*d.inputs.values(), *d.outputs.values()) for name in self._given_names(variable)}
        # A plant with an output "x" is common: then the vector of its states has no port, but keeps its paths.
        shown = (memory for memory in memories if memory.output and memory.name not in taken)
        ports = self._named([*d.outputs.values(), *stepped, *given, *shown])
        for name in taken & (ports.keys() & self.inputs.keys() | d.parameters.keys()):
            what = "a parameter" if name in d.parameters else "both an input and an output"
            cure = "Choose another name."
            raise ModelError(Fault("E109", f"{self.name}.{name}", f"is the name of {what}.", cure))
        return ports

    @cached_property
    def locals(self) -> dict[str, Port]:
        """Variables of an FMU that are no outputs and can be recorded."""
        d = self.declaration
        states = (state for state in d.states.values() if d.foreign is not None and not state.output)
        return self._named([*(signal for signal in d.given.values() if signal.is_local), *states])

    @cached_property
    def rearranged(self) -> frozenset[str]:
        """The output ports that only rearrange inputs."""
        wiring = {name for name, output in self.declaration.outputs.items() if output.wiring}
        return frozenset(name for name, port in self.outputs.items() if port.variable in wiring)

    @cached_property
    def input_units(self) -> Mapping[str, str]:
        """The unit of each input port."""
        return {name: port.unit for name, port in self.inputs.items()}

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
