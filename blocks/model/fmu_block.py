"""FMUs as block types: what a description says, as a block class.

    motor = fmu("fmus/PMDCMotor.fmu", kind="CS", Ra=0.2)      # a block like any other

Inputs and outputs become ports, parameters and start values become parameters, and every other variable can be
recorded by its name. Reading a description runs no code of the FMU. Code that calls the binary later finds the FMU
and its variables in `declaration.foreign`.
"""

from __future__ import annotations

import contextlib
import copyreg
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..contract.block import Block, BlockMeta
from ..contract.class_body import RESERVED
from ..contract.enumerations import Enumeration
from ..contract.interface import Value
from ..contract.variables import REQUIRED, Given, Input, Parameter, State, Variable
from ..fmi.description import read_description
from ..fmi.description_variables import LARGEST_ARRAY
from ..fmi.findings import quoted
from ..fmi.library import clock_faults
from ..fmi.model_description import Alias, Description, Interface, ModelVariable
from ..fmi.resizing import resized
from ..fmi.types import FLOATS, INTEGERS
from ..text import units
from ..text.errors import Fault, FMUError, ModelError, UsageError
from ..text.json_number import is_number
from .diagram_grammar import LONGEST_TIMEOUT, TIMEOUT

KINDS = {"CS": "Co-Simulation", "ME": "Model Exchange"}
_TYPES: dict[object, type[Block]] = {}
_LARGEST = 2**53
UNWIRED = ("Clock", "Binary", "String")
"""Types that no port has."""


@dataclass(frozen=True, slots=True, eq=False)
class Foreign:
    """The FMU behind a block class.

    path: of the archive. isolate: whether it runs in a process of its own; timeout: how many seconds a call of it may
    take then. variables: those of the FMU by the name of the block's variable or parameter. scales, offsets: a value in
    SI is scale * number of the FMU + offset; those that are not 1 and not 0. sizes: the values of structural parameters
    that the class was made for, where they differ from the description's; changed: these, and the arrays that they
    size, which are always set.
    """

    kind: str
    path: Path
    description: Description
    described: Description  # as the file has it
    isolate: bool
    timeout: float
    variables: Mapping[str, ModelVariable]
    scales: Mapping[str, float]
    offsets: Mapping[str, float]
    sizes: Mapping[str, int]
    changed: frozenset[str]

    def affine(self, name: str) -> tuple[float, float]:
        """Return the scale and the offset of a variable."""
        return self.scales.get(name, 1.0), self.offsets.get(name, 0.0)

    def own(self, name: str, value: float) -> float:
        """Return a value in SI as a number of the FMU."""
        return (value - self.offsets.get(name, 0.0)) / self.scales.get(name, 1.0)

    def si(self, name: str, number: float) -> float:
        """Return a number of the FMU in SI."""
        value, offset = number * self.scales.get(name, 1.0), self.offsets.get(name, 0.0)
        return value + offset if offset else value

    def keeps(self, name: str, values: Sequence[float]) -> bool:
        """Return whether a variable has these values in SI from its start on, so that it need not be set."""
        variable = self.variables[name]
        start = () if variable.name in self.changed else _start(variable, self.path.name)
        return bool(start) and all(value == self.si(name, float(own)) for value, own in zip(values, start, strict=True))

    def resized(self, values: Mapping[str, Value]) -> type[Block] | None:
        """The block class for given values of structural parameters; None where it is this one.

        Invalid values are left to the checks of parameters.
        """
        sizes = dict(self.sizes)
        for name, value in values.items():
            variable = self.variables.get(name)
            if variable is None or variable.causality != "structuralParameter" or variable.type not in INTEGERS:
                continue
            size, low, high = np.asarray(value.value), variable.low or 0.0, variable.high or LARGEST_ARRAY
            if size.shape == () and size.dtype.kind in "iuf" and max(low, 0) <= size <= high and size == int(size):
                sizes[variable.name] = int(size)
        given = tuple((name, size) for name, size in sizes.items() if self.described.names[name].start != (size,))
        if dict(given) == self.sizes:
            return None
        return fmu_type(self.path, self.kind, isolate=self.isolate, timeout=self.timeout, sizes=given)

    def why_no_port(self, name: str) -> str:
        """Why a variable of the FMU is no port that a wire can name; "" where it is no such variable."""
        variable = self.description.names.get(name)
        if variable is None or variable.type not in UNWIRED:
            return ""
        return f"has the type {variable.type} in the FMU, which a wire cannot carry."

    @property
    def interface(self) -> Interface:
        interface = self.description.interface(self.kind)
        assert interface is not None
        return interface


def fmu(
    path: str | os.PathLike[str],
    kind: str | None = None,
    *,
    isolate: bool = False,
    timeout: float = TIMEOUT,
    parameters: Mapping[str, object] | None = None,
    **named: object,
) -> Block:
    """A block that is an FMU of version 2.0 or 3.0.

    kind: "CS" (Co-Simulation: it brings its own solver) or "ME" (Model Exchange: the solver of the run integrates it);
    None: the one that it has, CS where it has both. isolate: in a process of its own, so that a crash of it is an
    error. timeout: s; how long a call may take then. parameters and further names: values of its parameters and start
    values; those whose names are no words of Python go into `parameters`.

    Raises ModelError (E007), FMUError (E202 to E206; E205 for a kind that it has not), UsageError (E501).
    """
    given = {**(parameters or {}), **named}
    return fmu_type(path, kind, isolate=isolate, timeout=timeout)(**given)


def fmu_type(
    path: str | os.PathLike[str],
    kind: str | None = None,
    *,
    isolate: bool = False,
    timeout: float = TIMEOUT,
    sizes: tuple[tuple[str, int], ...] = (),
) -> type[Block]:
    """The block class of an FMU, made once for each file as it is now. Arguments and errors as of `fmu`.

    sizes: values of structural parameters that differ from the description's.
    """
    if kind is not None and kind not in KINDS:
        raise UsageError(Fault("E501", "kind", f"{kind!r} is not a kind of FMU.", 'Kinds: "CS", "ME".'))
    if not is_number(timeout) or not 0 < timeout <= LONGEST_TIMEOUT:
        raise UsageError(Fault("E501", "timeout", f"must be a time in s above 0, not {timeout!r}."))
    if not isinstance(isolate, bool):
        raise UsageError(Fault("E501", "isolate", f"must be true or false, not {isolate!r}."))
    place = Path(os.path.abspath(path))
    try:
        seen = place.stat()
        stamp = (seen.st_mtime_ns, seen.st_size, seen.st_ino)
    except OSError:
        stamp = (0, 0, 0)  # reading it says what is wrong
    key = (place, stamp, kind, isolate, float(timeout), sizes)
    if key not in _TYPES:
        _TYPES[key] = _FmuBlockBuilder(
            place, read_description(place), kind, isolate, float(timeout), dict(sizes)
        ).made()
    return _TYPES[key]


class _FmuMeta(BlockMeta):
    """The metaclass of FMU blocks. No module names such a class: an unpickled one is made from its file again."""


def _pickled(cls: Any) -> Any:
    foreign = cls.declaration.foreign
    return _unpickled, (foreign.path, foreign.kind, foreign.isolate, foreign.timeout, tuple(foreign.sizes.items()))


def _unpickled(path: Path, kind: str, isolate: bool, timeout: float, sizes: tuple[tuple[str, int], ...]) -> type[Block]:
    return fmu_type(path, kind, isolate=isolate, timeout=timeout, sizes=sizes)


copyreg.pickle(_FmuMeta, _pickled)


class _FmuBlockBuilder:
    def __init__(
        self,
        path: Path,
        description: Description,
        kind: str | None,
        isolate: bool,
        timeout: float,
        sizes: Mapping[str, int],
    ) -> None:
        self.path, self.described, self.sizes = path, description, sizes
        self.description, self.changed = resized(description, sizes) if sizes else (description, frozenset())
        if kind is None:
            kind = next((known for known in KINDS if description.interface(known) is not None), "CS")
        interface = description.interface(kind)
        if interface is None:
            has = (
                ", ".join(KINDS.get(offered.kind, "Scheduled Execution") for offered in description.interfaces)
                or "nothing"
            )
            other = "ME" if kind == "CS" else "CS"
            cure = f'Use kind="{other}" (--kind {other}).' if has in KINDS.values() else "Export it again."
            raise FMUError(Fault("E205", path.name, f"it is an FMU for {has}, not for {KINDS[kind]}.", cure))
        if clocks := clock_faults(description, interface, path.name):
            raise FMUError(*clocks)
        self.kind, self.isolate, self.timeout = kind, isolate, timeout
        self.body: dict[str, Variable] = {}
        self.variables: dict[str, ModelVariable] = {}
        self.scales: dict[str, float] = {}
        self.offsets: dict[str, float] = {}
        self.units: dict[tuple[str, bool], tuple[str, float]] = {}  # those that `unit` has returned, by the FMU's names

    def made(self) -> type[Block]:
        # Inputs and outputs keep their names; whatever else has one of them gets another.
        order = {"input": 0, "output": 1, "parameter": 2, "structuralParameter": 2}
        states = {state.name for state in self.description.structure.states} if self.kind == "ME" else set()
        for variable in sorted(self.description.variables, key=lambda v: order.get(v.causality, 3)):
            self.add(variable, is_state=variable.name in states)
        for variable in self.description.variables:
            for alias in variable.aliases:
                self.alias(alias, variable)
        foreign = Foreign(
            self.kind, self.path, self.description, self.described, self.isolate, self.timeout,
            MappingProxyType(self.variables), MappingProxyType(self.scales), MappingProxyType(self.offsets),
            MappingProxyType(self.sizes), self.changed,
        )  # fmt: skip
        body = {**self.body, "__doc__": self.description.doc, "__module__": __name__}
        return _FmuMeta(self.description.name or self.path.stem, (Block,), body, foreign)  # type: ignore[return-value]

    def add(self, variable: ModelVariable, *, is_state: bool) -> None:
        unit, scale = self.unit(variable)
        start = _start(variable, self.path.name)
        common: dict[str, Any] = {"unit": unit, "doc": variable.doc}
        if variable.causality in ("parameter", "structuralParameter"):
            self.parameter(variable.name, variable, start, common, scale)
            return
        if variable.causality == "independent" or variable.type in UNWIRED:
            if variable.type == "String" and _is_settable(variable):
                self.parameter(f"{variable.name}_start", variable, start, common, scale)
            return
        kind, held = self.type(variable), variable.variability in ("discrete", "constant", "fixed", "tunable")
        shape: tuple[int, ...] = variable.shape
        if variable.causality == "input":
            declared: Variable = Input(_fitting(start, shape) if start else None, shape=shape, type=kind, **common)
        elif is_state:
            nominal = abs(variable.nominal or 0.0) * scale
            nominal = nominal if 0.0 < nominal < math.inf else 1.0
            is_output = variable.causality == "output"
            declared = State(_fitting(start, shape), shape=shape, output=is_output, nominal=nominal, **common)
        else:
            is_local = variable.causality != "output"
            declared = Given(shape=shape, type=kind, is_local=is_local, held=held, **common)
        self.put(variable.name, declared, variable, scale)
        if variable.causality != "input" and _is_settable(variable) and variable.start:
            self.parameter(f"{variable.name}_start", variable, start, common, scale)

    def alias(self, alias: Alias, variable: ModelVariable) -> None:
        """Another name of a variable, to be recorded like it."""
        if variable.causality in ("parameter", "structuralParameter", "independent") or variable.type in UNWIRED:
            return
        unit, scale = self.unit(variable)
        held = variable.variability != "continuous"
        declared = Given(
            shape=variable.shape, type=self.type(variable), is_local=True, held=held, unit=unit,
            doc=alias.doc or variable.doc,
        )  # fmt: skip
        self.put(alias.name, declared, variable, scale)

    def parameter(
        self, name: str, variable: ModelVariable, start: tuple[Any, ...], common: Mapping[str, Any], scale: float
    ) -> None:
        """A parameter or a start value. Where no value is known, the FMU keeps its own."""
        if name in self.body or variable.type in ("Binary", "Clock"):
            return
        is_text = variable.type == "String"
        if is_text and variable.shape:
            return
        is_size = variable.causality == "structuralParameter"
        low = 0.0 if is_size and variable.low is None else variable.low
        default = _fitting(start, variable.shape) if start else ("" if is_text else None)  # None: the FMU keeps its own
        if not start and variable.name in self.changed and self.described.names[variable.name].start:
            default = REQUIRED  # the start values that are known are for another size
        is_unknown = default is None and self.kind == "ME"  # not among the numbers of a Plan
        if is_text:
            parameter = Parameter(default, type="string", structural=True, doc=common["doc"])
        else:
            parameter = Parameter(
                default, type=self.type(variable), shape=variable.shape, unit=common["unit"], doc=common["doc"],
                fixed=is_size or variable.variability != "tunable" or name != variable.name or is_unknown,
                min=_finite(low), max=_finite(variable.high),
            )  # fmt: skip
        self.put(name, parameter, variable, scale)

    def put(self, name: str, declared: Variable, variable: ModelVariable, scale: float) -> None:
        while name in self.body or name in RESERVED:
            name += "_"
        declared.name = name
        self.body[name], self.variables[name] = declared, variable
        if scale != 1.0:
            self.scales[name] = scale
        offset = units.to_si(0.0, self.unit(variable)[0])
        if offset:
            self.offsets[name] = offset

    def unit(self, variable: ModelVariable) -> tuple[str, float]:
        """The unit as blocks writes it, and its factor to SI; where it is not known, the bare number.

        A relative quantity is a difference, which an offset does not move.
        """
        if variable.type not in FLOATS:
            return "", 1.0
        key = variable.unit, variable.relative
        if key not in self.units:
            definition = self.description.units.get(variable.unit)
            self.units[key] = ("", 1.0)
            if definition is not None and definition.text:
                with contextlib.suppress(ModelError):
                    text = units.difference(definition.text) if variable.relative else definition.text
                    self.units[key] = text, units.parse(text).factor
        return self.units[key]

    def type(self, variable: ModelVariable) -> Any:
        """The type of a port: reals, whole numbers, truth, or the members of an enumeration."""
        if variable.type in FLOATS:
            return "real"
        if variable.type in INTEGERS:
            return "int"
        if variable.type == "Boolean":
            return "bool"
        declared = self.description.types.get(variable.declared)
        members = dict(declared.members) if declared is not None else {}
        if not members:
            return "int"
        return Enumeration((declared.name if declared is not None else variable.declared) or "Enumeration", members)


def _is_settable(variable: ModelVariable) -> bool:
    """Whether a start value can be set before initialization."""
    return variable.initial in ("exact", "approx") and variable.variability != "constant"


def _start(variable: ModelVariable, place: str) -> tuple[Any, ...]:
    """The start value for each element; () where there is none, or one that is not finite: the FMU keeps its own."""
    size = math.prod(variable.shape)
    values = variable.start * size if len(variable.start) == 1 else variable.start
    if variable.type in FLOATS and not all(math.isfinite(float(value)) for value in values):
        return ()
    if variable.type in INTEGERS and any(abs(int(value)) > _LARGEST for value in values):
        message = f"{quoted(variable.name)} starts at {values[0]!r}, but blocks cannot hold integers beyond 2^53."
        raise FMUError(Fault("E205", place, message, "Export it with smaller numbers."))
    return values


def _fitting(start: tuple[object, ...], shape: tuple[int, ...]) -> Any:
    if not start:
        return 0.0
    if shape == ():
        return start[0]
    nested: Any = list(start)
    for size in reversed(shape[1:]):
        nested = [nested[k : k + size] for k in range(0, len(nested), size)]
    return nested


def _finite(limit: float | None) -> float | None:
    """A limit for a declaration, in the declared unit; None where it is not finite."""
    return None if limit is None or not math.isfinite(limit) else float(limit)
