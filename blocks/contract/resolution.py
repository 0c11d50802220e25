"""One block with all its numbers: its type, its values, its clocks, its delays.

A block class leaves sizes open (`order`, the length of `num`). `resolve` takes the values that one block was given
and settles everything that does not need equations: sizes, computed defaults, ranges, clocks in exact fractions.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property, lru_cache
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from ..text.arrays import Array, frozen
from ..text.errors import Fault, ModelError, did_you_mean
from ..text.json_number import is_number
from ..text.other_words import parameter_meant
from ..text.printable import counted
from ..text.units import Declared, si_text, single, to_si
from ..text.units import parse as parse_unit
from .captured_values import outside
from .declaration import Declaration
from .equations import Output
from .expressions import exact_decimal, exact_time
from .interface import LARGEST, Interface, Value, not_computed, unit_from
from .reads import arguments
from .sparse import SparseMatrix
from .uses import late_units, sizing, uses
from .variables import NO_LIMIT, REQUIRED, Algebraic, Clock, Discrete, History, Parameter, State, Stepped

LEAST_DELAY = 1e-15  # s
NO_DELAY = "For no delay, leave the block out; in a sweep, begin at a small delay, such as 1 ms."


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
    """
    form = cls.declaration.form
    resolving = _Resolving((form and form(given)) or cls, place)
    # Each step builds on what the earlier ones have settled, so that the first with faults is the last.
    resolving.take(given)
    resolving.stop_at_faults()
    for step in (resolving.default, resolving.shape, resolving.check_ranges, resolving.check_memory):
        step()
        resolving.stop_at_faults()
    resolving.check_requirements()
    interface = resolving.shared()
    clocks, starts, delays = resolving.clocks(), resolving.starts(interface), resolving.delays(interface)
    resolving.stop_at_faults()  # a nominal may need what the requirements say
    nominal = resolving.nominal(interface)
    resolving.stop_at_faults()
    return Resolved(interface, resolving.values, clocks, starts, delays, tuple(nominal))


class _Resolving:
    """One block on its way from given values to a Resolved: the faults so far, the values, the structural ones."""

    def __init__(self, cls: Any, place: str) -> None:
        self.cls = cls
        self.declaration: Declaration = cls.declaration
        self.place = place or self.declaration.name
        self.faults: list[Fault] = []
        self.values: dict[str, Value] = {}
        self.structural: dict[str, Any] = {}

    def fault(self, code: str, name: str, message: str, cure: str = "") -> None:
        self.faults.append(Fault(code, f"{self.place}.{name}" if name else self.place, message, cure))

    def stop_at_faults(self) -> None:
        if self.faults:
            raise ModelError(*self.faults)

    @property
    def known(self) -> dict[str, Any]:
        """The plain values of parameters and sizes by name, as functions of parameters read them."""
        return {**{name: value.value for name, value in self.values.items()}, **self.structural}

    def take(self, given: Mapping[str, Value]) -> None:
        """The values that are given, in the types of their parameters."""
        parameters = self.declaration.parameters
        for name, value in given.items():
            if name not in parameters:
                cure = parameter_meant(name, parameters) or did_you_mean(name, parameters)
                self.fault("E106", name, "there is no such parameter.", cure)
                continue
            try:
                self.values[name] = _typed(parameters[name], value)
            except ValueError as error:
                self.fault("E107", name, str(error), error.cure if isinstance(error, _NoNumber) else "")
        for name, parameter in parameters.items():
            if parameter.excludes:
                both = (given.get(name), given.get(parameter.excludes))
                if all(value is not None and value.value is not None for value in both):
                    message = f"cannot be given together with '{parameter.excludes}'."
                    self.fault("E107", name, message, "Give only one of the two.")
            if parameter.default is REQUIRED and name not in given:
                self.fault("E107", name, "must be given: it has no default.", f'Add "{name}" to its parameters.')
        for name in sorted(sizing(self.declaration) & self.values.keys()) if self.values else ():
            size = self.values[name].value
            if isinstance(size, int) and abs(size) > LARGEST:
                self.fault("E107", name, f"must be at most {LARGEST:,}, not {size:,}: it determines sizes.")

    def default(self) -> None:
        """The values that are not given, and with them all structural values and sizes."""
        late = late_units(self.declaration) - self.values.keys()
        try:
            self.structural = _Defaults(self.declaration, self.values, self.place).filled()
        except ModelError:  # a default may fail because what it is computed from is out of its range
            self.check_given_ranges()
            self.stop_at_faults()
            raise
        for name in late:
            parameter = self.declaration.parameters[name]
            if not callable(parameter.default):
                self.values[name] = _plain_default(parameter, self.interface.declared_units(parameter))

    def check_given_ranges(self) -> None:
        """Check the ranges of what is given, as far as its size and unit depend on nothing else."""
        parameters = self.declaration.parameters
        structural = {name: value.value for name, value in self.values.items() if parameters[name].structural}
        for name, value in self.values.items():
            with contextlib.suppress(ModelError, KeyError):
                if problem := _range_problem(parameters[name], value.value, Interface(self.cls, structural, {})):
                    self.fault("E107", name, problem)

    @cached_property
    def interface(self) -> Interface:
        """The type, but for the zero patterns: shapes and units follow from it."""
        return Interface(self.cls, self.structural, {})

    def shape(self) -> None:
        """Every value in the shape of its parameter."""
        settled = _settled(self.declaration)
        for name, parameter in self.declaration.parameters.items():
            value = self.values[name]
            if parameter.structural or value.value is None or value is settled.get(name):
                continue
            if isinstance(value.value, SparseMatrix):  # sizes follow from it, and the whole matrix may be too large
                continue
            try:
                shape = self.interface.shape(parameter)
            except ModelError as error:
                self.faults += error.faults
                continue
            if value.value.shape == () and parameter.table:
                self.fault("E110", name, "is a table, but a single number is given.", "Give a list.")
            elif value.value.shape == ():  # a scalar fills an array
                self.values[name] = Value(np.broadcast_to(value.value, shape), value.exact, value.unit)
            elif value.value.shape != shape:
                message = f"has the shape {_shape(value.value.shape)}, but {_shape(shape)} is needed."
                self.fault("E110", name, message, "" if shape else _cure_of_list(name, value.value.shape))

    def check_ranges(self) -> None:
        settled = _settled(self.declaration)
        for name, parameter in self.declaration.parameters.items():
            if self.values[name] is settled.get(name):
                continue
            problem = _range_problem(parameter, self.values[name].value, self.interface)
            if problem:
                is_no_delay = any(h.delay is parameter for h in self.declaration.histories.values())
                is_no_delay = is_no_delay and not np.any(self.values[name].value)
                self.fault("E107", name, problem, NO_DELAY if is_no_delay else "")

    def check_memory(self) -> None:
        """Refuse impossible sizes of inputs, states and discretes."""
        d = self.declaration
        for variable in (*d.inputs.values(), *d.states.values(), *d.discretes.values()):
            try:
                self.interface.shape(variable)
            except ModelError as error:
                self.faults += error.faults

    def check_requirements(self) -> None:
        for requirement in self.declaration.requirements:
            known, equation = self.known, requirement.equation
            name = equation.reads[0] if len(equation.reads) == 1 else ""
            try:
                holds = np.all(equation.function(*(known[name] for name in equation.reads)))
            except ModelError as error:  # what it says itself
                first = error.faults[0]
                self.fault("E107", name, f"{requirement.message}: {first.message}", first.cure)
                continue
            except Exception as error:  # a function of the class may raise anything
                self.fault("E107", name, f"{requirement.message} ({type(error).__name__}: {error}).")
                continue
            if not holds:
                shown = ", ".join(f"{name} = {_shown(known[name])}" for name in equation.reads)
                self.fault("E107", name, f"{requirement.message} ({shown}).")

    def shared(self) -> Interface:
        """The type with its zero patterns, the same object for equal types."""
        patterns: dict[str, tuple[Any, ...]] = {
            name: tuple(bool(x) for x in np.ravel(value != 0)) if isinstance(value, np.ndarray) else (value,)
            for name, parameter in self.declaration.parameters.items()
            if parameter.zeros and (value := self.values[name].value) is not None
        }
        return _shared(Interface(self.cls, self.structural, patterns))

    def clocks(self) -> dict[str, tuple[Fraction, Fraction]]:
        """Period and offset of each equation that has ticks, and of the stepper."""
        clocks: dict[str, tuple[Fraction, Fraction]] = {}
        for equation in self.declaration.equations:
            for role in equation.roles:
                if role.clock is None or not role.ticks:
                    continue
                clock = self._clock(equation.name, role.clock)
                if clock is None:
                    continue
                period, offset = clocks[equation.name] = clock
                if period <= 0 or offset < 0:
                    message = f"cannot tick every {float(period)} s from {float(offset)} s on."
                    self.fault(
                        "E107", equation.name, message, "The period must be above 0 s, and the offset 0 s or more."
                    )
        stepper = self.declaration.stepper
        if stepper is not None and (clock := self._clock(stepper.name, stepper.clock)) is not None:
            clocks[stepper.name] = clock
        return clocks

    def _clock(self, name: str, clock: Clock) -> tuple[Fraction, Fraction] | None:
        try:
            every, offset = (_time(part, self.values, self.structural) for part in (clock.every, clock.offset))
        except Exception as error:  # a function of the class may raise anything
            self.faults.append(not_computed("E107", f"{self.place}.{name}", "its clock", error))
            return None
        return every, offset

    def starts(self, interface: Interface) -> dict[str, Array]:
        """What sampled outputs hold before their first tick."""
        starts: dict[str, Array] = {}
        sampled: list[Output | Stepped] = [*self.declaration.outputs.values(), *self.declaration.stepped.values()]
        for variable in sampled:
            if isinstance(variable, Stepped) or variable.clock is not None:
                try:
                    start = _start(variable, variable.start, self.values, self.structural, interface)
                except Exception as error:  # a function of the class may raise anything
                    self.faults.append(not_computed("E110", f"{self.place}.{variable.name}", "its start", error))
                    continue
                starts[variable.name] = start
        return starts

    def delays(self, interface: Interface) -> dict[str, tuple[float, Array]]:
        """The delay of each history, and its values before the start."""
        delays: dict[str, tuple[float, Array]] = {}
        for name, history in self.declaration.histories.items():
            try:
                if isinstance(history.delay, Parameter):  # as the run reads it
                    delay = float(self.values[history.delay.name].value)
                else:
                    delay = float(_time(history.delay, self.values, self.structural))
                before = _start(history, history.before, self.values, self.structural, interface)
            except Exception as error:  # a function of the class may raise anything
                self.faults.append(not_computed("E110", f"{self.place}.{name}", "its delay", error))
                continue
            # No step is longer than a delay: a run of a second would take more than 1e15 of them.
            if not (math.isfinite(delay) and delay >= LEAST_DELAY):
                cure = f"Use a delay of {LEAST_DELAY} s or more."
                self.fault("E107", name, f"a delay of {delay} s is not possible.", cure)
            delays[name] = (delay, before)
        return delays

    def nominal(self, interface: Interface) -> list[float]:
        """The usual size of each element of each state."""
        nominal: list[float] = []
        for name, state in self.declaration.states.items():
            try:
                nominal += _nominal(state, self.values, self.structural, interface)
            except Exception as error:  # a function of the class may raise anything
                self.faults.append(not_computed("E110", f"{self.place}.{name}", "its nominal", error))
        return nominal


def _shared(interface: Interface) -> Interface:
    """The interface of this type that is in use already, if there is one: its ports and shapes are known."""
    # The text distinguishes 1 from True, and 0.0 from -0.0, which are equal. Shapes may depend on values outside.
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
        infinite = text in NO_LIMIT
        super().__init__(f"must be finite, not {text}." if infinite else f"must be a number, not the text {text!r}.")
        self.text = text

    @property
    def cure(self) -> str:
        """What the text was probably meant to be."""
        if self.text in NO_LIMIT:
            return "Only limits such as those of Saturation may be infinite."
        match = re.fullmatch(r"([-+]?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?) *([^\W\d_]\S*|%)?", self.text[:60])
        if re.match(r"[-+]?[0-9]+,[0-9]", self.text[:60]):
            return f"Write decimals after a point: {self.text[:60].replace(',', '.', 1)}."
        if match is None:
            return 'Begin an expression with =, as in "=2*gain".'
        quantity = f'{{"value": {match[1]}, "unit": "{match[2]}"}}'
        return f"Write {quantity}." if match[2] else f"Write it without quotes: {match[1]}."


def _typed(parameter: Parameter, value: Value) -> Value:
    """A given value in the type of its parameter. Raises ValueError with a sentence."""
    raw = value.value
    if raw is None and parameter.default is None:
        return value
    if isinstance(raw, SparseMatrix):
        return _sparse(parameter, value, raw)
    if parameter.type == "string":
        if not isinstance(raw, str):
            raise ValueError(f"must be a text, not {raw!r}.")
        return value
    if parameter.type == "bool":
        flags = _array(raw)
        if flags.dtype != bool or (parameter.structural and flags.ndim):
            raise ValueError(f"must be true or false, not {raw!r}.")
        return Value(bool(raw)) if parameter.structural else Value(frozen(flags.astype(float)))
    if parameter.members:
        return Value(frozen(_members(parameter, raw)))
    if isinstance(raw, str):
        if parameter.is_limit and raw in NO_LIMIT:
            return Value(frozen(np.array(NO_LIMIT[raw])), None, value.unit)
        raise _NoNumber(raw)
    if type(raw) is float and parameter.type == "real" and not parameter.structural and math.isfinite(raw):
        return Value(frozen(np.array(raw)), value.exact, value.unit)
    return _numbers(parameter, value)


def _sparse(parameter: Parameter, value: Value, raw: SparseMatrix) -> Value:
    if not (parameter.zeros and isinstance(parameter.shape, tuple) and len(parameter.shape) == 2):
        raise ValueError("cannot be a sparse matrix.")
    if parameter.sparse:
        return value
    if math.prod(raw.shape) > LARGEST:
        message = f"is {_shape(raw.shape)}, and all of its elements are needed here; the limit is {LARGEST:,}."
        raise ValueError(message)
    return Value(frozen(raw.dense()), None, value.unit)


def _numbers(parameter: Parameter, value: Value) -> Value:
    """A given number, or an array of numbers."""
    raw, is_int = value.value, parameter.type == "int"
    array = _array(raw)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"must be a number, not {raw!r}.")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"must be finite, not {_shown(raw)}.")
    if parameter.structural and array.ndim > (parameter.shape != ()):
        raise ValueError(f"must be {'one number' if parameter.shape == () else 'a list'}, not {_shown(raw)}.")
    if is_int and not all(float(x).is_integer() and abs(float(x)) <= 2**53 for x in array.flat):
        raise ValueError(f"must be {'an integer' if array.ndim == 0 else 'integers'}, not {_shown(raw)}.")
    if not parameter.structural:
        return Value(frozen(array.astype(float)), value.exact, value.unit)
    return Value(_structural(array, int, parameter)) if is_int else Value(
        _structural(array, float, parameter), value.exact, value.unit
    )  # fmt: skip


def _members(parameter: Parameter, raw: object) -> Array:
    """The numbers of members of an enumeration, given by name or by number."""
    known = parameter.members
    names = np.array(raw, dtype=object)
    numbers = np.empty(names.shape)
    for place, item in np.ndenumerate(names):
        if item in known:
            numbers[place] = known[item]
        elif is_number(item) and item in known.values():
            numbers[place] = item
        else:
            raise ValueError(f"must be one of {', '.join(known)}, not {item!r}.")
    return numbers


def _structural(array: Array, kind: type, parameter: Parameter) -> object:
    """A structural value as it fixes a type: a plain number, or a tuple of them."""
    if parameter.shape == ():
        return kind(array)
    return tuple(kind(x) for x in np.atleast_1d(array))


def _array(raw: object) -> Array:
    try:
        array = np.array(raw)
    except ValueError:
        raise ValueError(f"must be numbers in rows of equal length, not {raw!r}.") from None
    whole = array.dtype == object and all(isinstance(x, int) for x in array.flat)  # too long for numpy's integers
    return array.astype(float) if whole else array


class _Defaults:
    """Fills in the defaults, the computed ones last, and infers the sizes.

    values: those that are given; it takes the others. Raises ModelError (E107, E110).
    """

    def __init__(self, declaration: Declaration, values: dict[str, Value], place: str) -> None:
        self.declaration, self.values, self.place = declaration, values, place
        self.sizes: dict[str, int] = {}
        self.makers: dict[str, str] = {}  # the parameter that each size is known from
        self.clashes: list[Fault] = []

    def filled(self) -> dict[str, Any]:
        """The structural values and the sizes."""
        for name in list(self.values):
            self.infer(name)
        self.take_plain()
        self.stop_at_clashes()
        self.take_computed()
        self.clashes += [
            Fault("E110", self.place, f"the size {size} is not known.", "Give an array that determines it.")
            for size in self.declaration.sizes
            if size not in self.sizes
        ]
        self.stop_at_clashes()
        parameters = self.declaration.parameters
        return {**{name: self.values[name].value for name, p in parameters.items() if p.structural}, **self.sizes}

    def stop_at_clashes(self) -> None:
        if self.clashes:
            raise ModelError(*self.clashes)

    def infer(self, name: str) -> None:
        """Take the sizes that follow from the shape of a value."""
        parameter, raw = self.declaration.parameters[name], self.values[name].value
        shape = parameter.shape if isinstance(parameter.shape, tuple) else (parameter.shape,)
        if shape == () or not any(isinstance(size, str) for size in shape) or np.ndim(raw) == 0:
            return
        place, actual_shape = f"{self.place}.{name}", np.shape(raw)
        if np.ndim(raw) != len(shape):
            message = f"has {counted(np.ndim(raw), 'dimension')}, but {len(shape)} are needed."
            self.clashes.append(Fault("E110", place, message))
            return
        for size, actual in zip(shape, actual_shape, strict=True):
            if isinstance(size, str) and self.sizes.setdefault(size, actual) != actual:
                message = f"has the shape {_shape(actual_shape)}, which makes {size} = {actual}, "
                message += f"but {self.makers[size]} makes it {self.sizes[size]}."
                if self.makers[size] == name:
                    message = f"has the shape {_shape(actual_shape)}, but {' x '.join(map(str, shape))} is needed."
                self.clashes.append(Fault("E110", place, message))
            elif isinstance(size, str):
                self.makers.setdefault(size, name)

    def take_plain(self) -> None:
        """Defaults that are values."""
        values, settled = self.values, _settled(self.declaration)
        # Structural values first: the units of the others may follow from them.
        for name, parameter in sorted(self.declaration.parameters.items(), key=lambda item: not item[1].structural):
            if name in settled and name not in values:
                values[name] = settled[name]
            elif name not in values and not callable(parameter.default):
                try:
                    unit = "" if name in late_units(self.declaration) else unit_from(parameter, values)
                    values[name] = _plain_default(parameter, unit)
                except (TypeError, ValueError) as error:
                    place = f"{self.place}.{name}"
                    if isinstance(error, ModelError):  # of its unit
                        raise ModelError(not_computed("E107", place, "the default", error)) from None
                    raise ModelError(Fault("E107", place, f"the default {error}")) from None
                self.infer(name)

    def take_computed(self) -> None:
        """Defaults that are functions; the class has no cycles, so each pass settles one at least."""
        parameters = self.declaration.parameters
        waiting = [name for name in parameters if name not in self.values]
        while waiting:
            rest = [name for name in waiting if not self.compute(name)]
            if len(rest) == len(waiting):
                missing = {r for n in rest for r in arguments(parameters[n].default, n)} - set(self.values)
                message = f"{', '.join(sorted(missing))} cannot be determined."
                raise ModelError(Fault("E110", f"{self.place}.{rest[0]}", message))
            waiting = rest

    def compute(self, name: str) -> bool:
        """Compute one default, where what it reads is known."""
        parameter, place = self.declaration.parameters[name], f"{self.place}.{name}"
        reads = arguments(parameter.default, name)
        known = {**{n: v.value for n, v in self.values.items()}, **self.sizes}
        if not all(read in known for read in reads):
            return False
        try:
            with np.errstate(all="ignore"):
                raw = parameter.default(*(known[read] for read in reads))
        except ModelError as error:
            raise ModelError(not_computed("E107", place, "the default", error)) from error
        except ValueError as error:  # what a class has to say to its user
            raise ModelError(Fault("E107", place, str(error))) from error
        except Exception as error:  # a function of the class may raise anything
            raise ModelError(not_computed("E107", place, "the default", error)) from error
        try:
            self.values[name] = _typed(parameter, Value(raw))
        except ValueError as error:
            raise ModelError(Fault("E107", place, f"the default {error}")) from None
        self.infer(name)
        return True


@lru_cache(maxsize=4096)
def _plain_default(parameter: Parameter, unit: Declared) -> Value:
    """The default of a parameter in its type, where it is a value. Raises TypeError, ValueError."""
    default = Value(None) if parameter.default is None else default_value(parameter, unit)
    return default if default.value is None else _typed(parameter, default)


@cache
def loose(declaration: Declaration) -> Mapping[str, tuple[float, float] | None]:
    """The parameters that change nothing but their own value: real scalars that no function reads before a run.

    By name the bounds, in the declared unit, between which any number is allowed; None where that follows from more.
    """
    d = declaration
    if d.foreign is not None:  # it may have 300,000, and is rarely used twice
        return {}
    read = {use.name for use in uses(d) if use.what != "value"}
    required = {name for requirement in d.requirements for name in requirement.equation.reads}
    bounds: dict[str, tuple[float, float] | None] = {}
    for name, p in d.parameters.items():
        if p.type == "real" and p.shape == () and not (p.members or name in read):
            low, high = (end if limit is None else limit for limit, end in ((p.min, -1e100), (p.max, 1e100)))
            allowed = max(low, 0.0 if p.positive else -1e100), min(high, 1e100)
            is_known = name not in required and (isinstance(p.unit, str) or (p.min is None and p.max is None))
            bounds[name] = allowed if is_known else None
    return bounds


def late_units_of(cls: Any, given: Mapping[str, Value]) -> Mapping[str, Declared]:
    """The declared units of given parameters that follow from sizes or computed defaults.

    given: values; those of these parameters may be in any unit. Of values that `resolve` refuses there are none.
    """
    names = late_units(cls.declaration) & given.keys()
    resolving = _Resolving(cls, "")
    try:
        if names:
            resolving.take(given)
            resolving.stop_at_faults()
            resolving.default()
        units = {name: resolving.interface.declared_units(cls.declaration.parameters[name]) for name in names}
    except ModelError:
        return {}
    return {name: single(unit) or unit for name, unit in units.items()}


def with_numbers(resolved: Resolved, changed: Mapping[str, Value]) -> Resolved | None:
    """The same block with other numbers for loose parameters, in SI; None where they are not allowed."""
    resolving, values = _Resolving(resolved.interface.cls, ""), dict(resolved.values)
    resolving.values, resolving.structural = values, resolved.interface.structural
    for name, value in changed.items():
        parameter = resolving.declaration.parameters[name]
        if not math.isfinite(value.value) or _range_problem(parameter, value.value, resolved.interface):
            return None
        values[name] = _typed(parameter, value)
    resolving.check_requirements()
    return None if resolving.faults else replace(resolved, values=values)


def fits(resolved: Resolved, columns: Mapping[str, Array]) -> bool:
    """Return whether each row of other numbers for some parameters is allowed, and changes nothing else of a block."""
    declaration, values = resolved.interface.declaration, resolved.values
    read = {use.name for use in uses(declaration) if use.what != "value"}
    for name, column in columns.items():
        parameter, first = declaration.parameters[name], values[name].value
        is_plain = parameter.type == "real" and not (parameter.members or declaration.foreign or name in read)
        if not is_plain or column.shape[1:] not in ((), np.shape(first)) or not np.isfinite(column).all():
            return False
        if _range_problem(parameter, column, resolved.interface):
            return False
    known: dict[str, Any] = {name: value.value for name, value in values.items()}
    known |= resolved.interface.structural
    shapes = {name: np.shape(known[name]) for name in columns}
    for requirement in declaration.requirements:
        function, reads = requirement.equation.function, requirement.equation.reads
        for row in zip(*columns.values(), strict=True) if shapes.keys() & {*reads} else ():
            known |= {name: np.broadcast_to(x, shapes[name]) for name, x in zip(columns, row, strict=True)}
            try:
                if not np.all(function(*(known[name] for name in reads))):
                    return False
            except Exception:  # a function of the class may raise anything
                return False
    return True


@cache
def _settled(declaration: Declaration) -> Mapping[str, Value]:
    """The default values of scalars that are valid and do not depend on other values.

    An FMU may have 300,000 of them, and each resolution of its block needs all.
    """
    settled: dict[str, Value] = {}
    for name, parameter in declaration.parameters.items():
        unit, is_scalar = parameter.unit, parameter.shape == () and not parameter.structural
        if is_scalar and type(parameter.default) is float and parameter.type == "real" and isinstance(unit, str):
            with contextlib.suppress(ValueError, ModelError):  # reported where it is used
                value = _typed(parameter, default_value(parameter, unit))
                if not _range_problem(parameter, value.value, None):
                    settled[name] = value
    return settled


def default_value(parameter: Parameter, declared: Declared) -> Value:
    """The plain default of a parameter, given in its declared unit, in SI; exact where decimal and unit are.

    declared: of each element, where they differ; a single number for all of these is in SI.
    """
    raw, unit = parameter.default, single(declared)
    if isinstance(raw, (bool, str)) or parameter.type in ("bool", "string", "int") or parameter.members:
        return Value(raw)
    scaled = bool(unit) and (parse_unit(unit).factor != 1.0 or parse_unit(unit).offset != 0.0)
    if isinstance(raw, float) or np.ndim(raw) == 0:
        exact: Fraction | None = exact_decimal(float(raw))
        if scaled:
            factor = parse_unit(unit).exact
            is_plain = factor is not None and exact is not None and not parse_unit(unit).offset
            exact_si = exact * factor if is_plain else None  # type: ignore[operator]
            return Value(to_si(float(raw), unit), exact_si)
        return Value(float(raw), exact)
    if isinstance(declared, tuple) and not unit:
        pairs = zip(np.ravel(raw).tolist(), declared, strict=True)
        return Value(np.reshape([to_si(float(x), own) if own else float(x) for x, own in pairs], np.shape(raw)))
    return Value(np.vectorize(lambda x: to_si(float(x), unit))(raw) if scaled else raw)


def limits(parameter: Parameter, unit: str) -> tuple[float | None, float | None]:
    """The smallest and the largest value of a parameter in SI, None where there is none. `positive` is apart."""
    # min and max are in the unit of the declaration, the value is in SI.
    low, high = (None if x is None else to_si(float(x), unit) if unit else x for x in (parameter.min, parameter.max))
    return low, high


def _range_problem(parameter: Parameter, raw: object, interface: Interface | None) -> str:
    """The sentence for a value outside the range of its parameter, or "". interface: None if the unit is a text."""
    if raw is None:
        return ""
    if parameter.choices:
        return "" if raw in parameter.choices else f"must be one of {', '.join(parameter.choices)}, not {raw!r}."
    if isinstance(raw, str) or parameter.type == "bool" or parameter.members:
        return ""
    if parameter.min is None and parameter.max is None and not parameter.positive:
        return ""
    unit = str(parameter.unit) if interface is None else interface.declared_unit(parameter)
    low, high = limits(parameter, unit)
    unit = "" if unit == "1" else unit
    numbers, in_unit = np.asarray(raw, dtype=float), f" {unit}" if unit else ""
    if parameter.positive and not (numbers > 0).all():
        return f"must be above 0, not {_shown(raw)}."
    if low is not None and not (numbers >= low).all():
        return f"must be at least {parameter.min}{in_unit}, not {_shown(raw)}{_si(unit)}."
    if high is not None and not (numbers <= high).all():
        return f"must be at most {parameter.max}{in_unit}, not {_shown(raw)}{_si(unit)}."
    return ""


def _si(unit: str) -> str:
    return f" {si_text(unit)}" if unit else ""


def _time(source: Any, values: Mapping[str, Value], structural: Mapping[str, object]) -> Fraction:
    """A time that a class gives as a parameter, a function of parameters or a number, as an exact fraction."""
    if isinstance(source, Parameter):
        return _fraction(values[source.name])
    if callable(source):
        names = arguments(source, "clock")
        known = {**values, **{name: Value(value) for name, value in structural.items()}}
        try:
            time = source(*(_fraction(known[name]) for name in names))
        except Exception:  # a function that fractions do not know, such as math.sqrt of numpy
            time = None
        if isinstance(time, (Fraction, int)):
            return Fraction(time)
        return exact_time(float(source(*(known[name].value for name in names))))
    return exact_time(float(source))


def _fraction(value: Value) -> Fraction:
    return exact_time(float(value.value) if value.exact is None else value.exact)


def _start(
    variable: Output | Stepped | History,
    start: object,
    values: Mapping[str, Value],
    structural: Mapping[str, object],
    interface: Interface,
) -> Array:
    """What a sampled output holds before its first tick, or a history before the start."""
    if isinstance(start, Parameter):
        start = values[start.name].value
    elif callable(start):
        known = {**{name: value.value for name, value in values.items()}, **structural}
        start = start(*(known[name] for name in arguments(start, variable.name)))
    else:  # a plain number is in the declared unit
        shape, declared = interface.shape(variable), interface.declared_units(variable)
        plain = np.ravel(np.broadcast_to(np.asarray(start, dtype=float), shape))
        start = [to_si(float(x), unit) if unit else float(x) for x, unit in zip(plain, declared, strict=True)]
        start = np.reshape(start, shape)
    held = np.ravel(np.broadcast_to(np.asarray(start, dtype=float), interface.shape(variable))).copy()
    if not np.all(np.isfinite(held)):
        raise ValueError(f"{_shown(held)} is not finite")
    return held


def _nominal(
    state: State, values: Mapping[str, Value], structural: Mapping[str, object], interface: Interface
) -> list[float]:
    """The usual size of each element of a state. Raises ValueError with a sentence, and what its function raises."""
    shape = interface.shape(state)
    if not callable(state.nominal):
        return [float(state.nominal)] * math.prod(shape)
    known = {**{name: value.value for name, value in values.items()}, **structural}
    nominals = np.asarray(state.nominal(*(known[name] for name in arguments(state.nominal, state.name))), dtype=float)
    if nominals.shape not in ((), shape):
        raise ValueError(f"it has the shape {_shape(nominals.shape)}, but {_shape(shape)} or one number is needed")
    if not np.all((nominals > 0) & np.isfinite(nominals)):
        raise ValueError(f"{_shown(nominals)} must be above 0 and finite")
    sizes: list[float] = np.ravel(np.broadcast_to(nominals, shape)).tolist()
    return sizes


def _cure_of_list(name: str, shape: tuple[int, ...]) -> str:
    """Return the cure where an array is given for one number."""
    if math.prod(shape) == 1:
        return "Give the number without brackets."
    if len(shape) > 1:
        return "The block that multiplies by a matrix is MatrixGain." if name == "k" else ""
    count = shape[0]
    return f'Give one number, or give the block "copies": {count} (in Python add(..., copies={count})), one for each.'


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) if shape else "a scalar"


def _shown(raw: Any) -> str:
    text = np.array2string(np.asarray(raw), threshold=6) if np.ndim(raw) else f"{raw}"
    return " ".join(text.split())


def memory_start(values: Mapping[str, Value], variable: State | Discrete | Algebraic) -> Array | None:
    """The start value of a state or discrete, flat, or None where an initial equation gives it."""
    value = values.get(f"{variable.name}_start")
    return None if value is None else np.ravel(value.value)
