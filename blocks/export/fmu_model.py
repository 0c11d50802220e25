"""What an FMU says about itself, apart from the version of FMI: variables, their dependencies, the experiment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class ExportedVariable:
    """One variable: a scalar, or an array in C order.

    reference: the value reference of the first element; those of the others follow. type: "real", "int", "bool",
    "enum" or "text". unit: in SI, as the library writes units ("rad/s", "" for none); display: the unit in which users
    give it, "" where that is the same. start: one value for each element, in SI, where the standard wants one.
    derivative_of: the reference of the state whose derivative by time this is. is_state: whether it is a continuous
    state. members: of an enumeration, names by value; enumeration: its name, "" where it has none. low, high: None
    where there is no bound.
    """

    name: str
    reference: int
    causality: str  # "parameter", "calculatedParameter", "input", "output", "local", "independent"
    variability: str  # "constant", "fixed", "tunable", "discrete", "continuous"
    initial: str = ""  # "exact", "calculated"; "" where the standard has none (inputs, the independent variable)
    type: str = "real"
    shape: tuple[int, ...] = ()
    unit: str = ""
    display: str = ""
    start: tuple[float, ...] | tuple[str, ...] = ()
    nominal: float | None = None
    low: float | None = None
    high: float | None = None
    doc: str = ""
    derivative_of: int | None = None
    is_state: bool = False
    members: Mapping[int, str] = field(default_factory=dict)
    enumeration: str = ""


Dependencies = Mapping[int, tuple[int, ...] | None]
"""For the value reference of an element: those of the elements that it depends on; None: not known, perhaps on all."""


@dataclass(frozen=True, slots=True)
class Abilities:
    """What an FMU with others inside can do: save and serialize its state, take steps of any length.

    once_per_process: whether there can be one instance only.
    """

    saves: bool
    serializes: bool
    any_step: bool
    once_per_process: bool


@dataclass(frozen=True, slots=True)
class Model:
    """All that a modelDescription.xml says.

    identifier: the base name of files, a C identifier. token: GUID or instantiation token. kinds: "CS", "ME". outputs,
    derivatives, initial_unknowns: references of elements in order, with what they depend on; those of states come from
    `derivatives` and `derivative_of`. indicators: references of event indicators, in order; of these, FMI 2 knows the
    number only. start, stop, step, tolerance: the default experiment (None: not given). step: of a fixed-step method.
    needs_completed_step: whether Model Exchange must report completed steps. sources: the files of sources/ to compile.
    has_events: whether a communication step may meet an event (a tick, a crossing, an event time). container: of one
    with FMUs inside, what it can do. inside: of these, the path, what they say of themselves, and the license.
    """

    name: str
    identifier: str
    token: str
    doc: str
    version: str  # of the exporting tool
    kinds: tuple[str, ...]
    variables: tuple[ExportedVariable, ...]
    outputs: Dependencies
    derivatives: Dependencies
    initial_unknowns: Dependencies
    indicators: tuple[int, ...] = ()
    start: float = 0.0
    stop: float | None = None
    tolerance: float | None = None
    step: float | None = None
    needs_completed_step: bool = False
    has_events: bool = True
    sources: tuple[str, ...] = ()
    container: Abilities | None = None
    inside: tuple[tuple[str, str, str], ...] = ()
