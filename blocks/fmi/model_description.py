"""What the description of an FMU says, alike for FMI 2.0 and 3.0: frozen values, cross references by name.

Types are those of FMI 3, as `types` has them; all variables of FMI 2 are scalars.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any

from ..text.errors import Fault

Value = float | int | bool | str | bytes


@dataclass(frozen=True, slots=True)
class Interface:
    """One way to run an FMU, and what it can do then. kind: "ME", "CS" or "SE" (scheduled execution)."""

    kind: str
    identifier: str
    """The name of the binary, without its ending."""
    needs_tool: bool = False
    """It says that it needs another program; some that say so do not."""
    once_per_process: bool = False
    own_memory: bool = False
    """FMI 2: it does not use the importer's allocator."""
    saves: bool = False
    serializes: bool = False
    directional: bool = False
    adjoint: bool = False
    per_element: bool = False
    """Dependencies are given for elements of arrays by another file."""
    completed_step: bool = False
    """ME: each accepted step must be reported to it."""
    evaluates_discrete_states: bool = False
    any_step: bool = False
    """CS: communication steps may differ."""
    fixed_step: float | None = None
    input_derivatives: bool = False
    """CS of FMI 2: it takes derivatives of inputs."""
    output_order: int = 0
    """CS: the highest derivative of outputs that it gives."""
    smoothness: int = 0
    intermediate_update: bool = False
    early_return: bool = False
    early_return_after_update: bool = False
    event_mode: bool = False
    asynchronous: bool = False
    sources: tuple[str, ...] = ()
    """FMI 2: files in `sources` to compile."""


@dataclass(frozen=True, slots=True)
class Experiment:
    """What the FMU is meant to be run with, in s; None where it does not say."""

    start: float | None = None
    stop: float | None = None
    tolerance: float | None = None
    step: float | None = None


@dataclass(frozen=True, slots=True)
class Display:
    """Another unit: a value in it is factor * value + offset, or factor / value."""

    name: str
    factor: float = 1.0
    offset: float = 0.0
    inverse: bool = False


@dataclass(frozen=True, slots=True)
class UnitDefinition:
    """A unit of an FMU: a value in SI is factor * value + offset.

    text: the same unit as `blocks.text.units` writes it; "" where it has none (the quantity is not known).
    si: the SI unit of the quantity as `blocks.text.units` writes it; "" where the quantity is not known.
    exponents: of the base units in the order of `blocks.text.units.BASE`, as the file has them; None where it has none.
    """

    name: str
    text: str = ""
    si: str = ""
    factor: float = 1.0
    offset: float = 0.0
    exponents: tuple[int, ...] | None = None
    displays: tuple[Display, ...] = ()


@dataclass(frozen=True, slots=True)
class Type:
    """A named type; its attributes hold for its variables that have none of their own. members: of an enumeration."""

    name: str
    type: str
    doc: str = ""
    quantity: str = ""
    unit: str = ""
    display: str = ""
    relative: bool = False
    unbounded: bool = False
    low: float | None = None
    high: float | None = None
    nominal: float | None = None
    members: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Alias:
    """Another name of a variable (FMI 3)."""

    name: str
    doc: str = ""
    display: str = ""


@dataclass(frozen=True, slots=True)
class Clock:
    """When a clock of FMI 3 ticks; times in s, or counts of 1/resolution s."""

    interval: str
    deactivatable: bool = False
    priority: int | None = None
    period: float | None = None
    shift: float = 0.0
    has_fractions: bool = False
    resolution: int | None = None
    period_count: int | None = None
    shift_count: int = 0


@dataclass(frozen=True, slots=True)
class ModelVariable:
    """A variable. Names in `derivative_of`, `previous`, `clocks` and `dimensions` are those of other variables."""

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str
    """exact, approx, calculated, or "" (the independent variable, clocks)."""
    start: tuple[Value, ...] = ()
    """In C order; one value of an array stands for all of its elements; () where there is none."""
    low: float | None = None
    high: float | None = None
    nominal: float | None = None
    unit: str = ""
    """A key of Description.units."""
    display: str = ""
    declared: str = ""
    """A key of Description.types."""
    doc: str = ""
    quantity: str = ""
    relative: bool = False
    unbounded: bool = False
    derivative_of: str = ""
    reinit: bool = False
    """A state that the FMU may set anew at events."""
    dimensions: tuple[int | str, ...] = ()
    """Sizes, or the structural parameters and constants that hold them."""
    shape: tuple[int, ...] = ()
    """With the start values of the structural parameters; () for a scalar."""
    previous: str = ""
    clocks: tuple[str, ...] = ()
    set_once: bool = False
    """An input that may be set only once at an instant."""
    intermediate: bool = False
    """It can be set and read in an intermediate update."""
    aliases: tuple[Alias, ...] = ()
    clock: Clock | None = None
    mime: str = ""
    max_bytes: int | None = None
    """Of a binary value."""
    line: int = 0


_Unfrozen: Any = make_dataclass(
    "ModelVariable",
    [(attribute.name, attribute.type, field(default=attribute.default)) for attribute in fields(ModelVariable)],
    slots=True,
)


def variable_of(*values: object, **more: object) -> ModelVariable:
    """As ModelVariable(...), seven times faster: a frozen class sets its fields one by one, past its own check. An
    FMU may have 300,000 variables."""
    variable = _Unfrozen(*values, **more)
    variable.__class__ = ModelVariable
    return variable  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Unknown:
    """What a variable depends on; None: on all inputs, states and whatever else may count.

    kinds: for each dependency dependent, constant, fixed, tunable or discrete.
    """

    variable: ModelVariable
    dependencies: tuple[ModelVariable, ...] | None = None
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Structure:
    """What depends on what. states: the states whose derivatives `derivatives` are, in that order."""

    outputs: tuple[Unknown, ...] = ()
    derivatives: tuple[Unknown, ...] = ()
    states: tuple[ModelVariable, ...] = ()
    clocked_states: tuple[Unknown, ...] = ()
    initial: tuple[Unknown, ...] = ()
    indicators: tuple[Unknown, ...] = ()
    """FMI 3; FMI 2 gives their number only."""


@dataclass(frozen=True, slots=True)
class Category:
    """A kind of log messages."""

    name: str
    doc: str = ""


@dataclass(frozen=True, slots=True)
class Description:
    """modelDescription.xml. names: the variable of each name and of each alias.

    aliases: the leading variable's name for each other name of the same value; leading is the one that can be set, else
    the first. warnings: what breaks the standard and does not matter here.
    """

    fmi: int
    version: str
    name: str
    token: str
    interfaces: tuple[Interface, ...]
    variables: tuple[ModelVariable, ...]
    structure: Structure
    names: Mapping[str, ModelVariable]
    aliases: Mapping[str, str]
    units: Mapping[str, UnitDefinition]
    types: Mapping[str, Type]
    experiment: Experiment = Experiment()
    indicators: int = 0
    """How many event indicators there are."""
    categories: tuple[Category, ...] = ()
    doc: str = ""
    author: str = ""
    model_version: str = ""
    copyright: str = ""
    license: str = ""
    tool: str = ""
    date: str = ""
    convention: str = "flat"
    warnings: tuple[Fault, ...] = ()

    def interface(self, kind: str) -> Interface | None:
        """The interface of a kind ("ME", "CS", "SE"); None where the FMU does not have it."""
        return next((interface for interface in self.interfaces if interface.kind == kind), None)
