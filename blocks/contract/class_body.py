"""The body of a block class: read once, every name once, and put in order as a Declaration."""

from __future__ import annotations

import inspect
import keyword
import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from .declaration import Declaration
from .declaration_checks import check_declaration
from .equations import Computed, Crossing, EventTime, Local, Open, Output, Requirement, Stepper
from .inheritance import Entry
from .reads import refuse
from .variables import (
    Algebraic,
    Discrete,
    Equation,
    Given,
    History,
    Input,
    Memory,
    Parameter,
    Role,
    State,
    Stepped,
    Variable,
)

RESERVED = frozenset({"t", "tick", "time", "name", "parameters", "declaration"})
"""Names that equations or users need for something else."""

_PYTHON_SETS = frozenset({
    *("__module__", "__qualname__", "__doc__", "__annotations__", "__annotate__", "__annotate_func__", "__classcell__"),
    *("__conditional_annotations__", "__classdictcell__", "__firstlineno__", "__static_attributes__"),
})  # fmt: skip


class Body(dict[str, Any]):
    """The namespace of a block class: every name once.

    above: what the class takes over by name. is_abstract: whether equations may be left open.
    """

    def __init__(self, block: str, above: Mapping[str, Sequence[Entry]], is_abstract: bool) -> None:
        super().__init__()
        self.block, self.above, self.is_abstract = block, above, is_abstract

    def __setitem__(self, name: str, value: object) -> None:
        place = f"{self.block}.{name}"
        if name.startswith("__") and name.endswith("__"):
            if name not in _PYTHON_SETS:
                refuse("E401", place, "a block class cannot have methods of its own, only variables and equations.")
        else:
            self._check(name, value, place)
        is_placed = any(value is entry.value for entry in self.above.get(name, ()))
        if isinstance(value, (Variable, Open)) and not is_placed:
            if value.is_declared:
                refuse("E401", place, f"{value!r} belongs to another class.", "Declare it in each class.")
            if value.name:
                refuse("E401", place, f"is a second name for '{value.name}'.", "Declare the variable once.")
            value.name = name
        super().__setitem__(name, value)

    def _check(self, name: str, value: object, place: str) -> None:
        if name in self:
            refuse("E401", place, "the name appears twice in the class body.", "Give the second another name.")
        if name in RESERVED or keyword.iskeyword(name):
            refuse("E401", place, "the name is reserved.", "Choose another.")
        if name.startswith("_") or not name.isascii():
            refuse("E401", place, "a name must begin with a letter, and have only ASCII letters, digits and _.")
        is_part = isinstance(value, (Variable, Equation, Requirement, Stepper)) and not isinstance(value, Given)
        if not is_part and not (isinstance(value, Open) and self.is_abstract):
            what = "a function without a role" if inspect.isfunction(value) else f"{type(value).__name__} {value!r}"
            if isinstance(value, Open):
                what = f"{value.kind.kind} without its function"
            refuse(
                "E401",
                place,
                f"a class body may only have variables and equations, not {what}.",
                "Decorate it (@output, @local, @x.derivative, ...) or move it out of the class.",
            )
        if isinstance(value, Computed) and value.fills is not None:
            if value.fills.name != name:
                cure = f"Call it {value.fills.name}."
                refuse("E401", place, f"is another name for '{value.fills.name}', which it gives.", cure)
            if name not in self.above:
                refuse("E402", place, f"gives {value.fills!r}, but does not derive from its class.")


def check_parts(block: str, parts: Mapping[str, object]) -> None:
    """Check each variable of an abstract class by itself, and freeze it."""
    for name, value in parts.items():
        if isinstance(value, (Variable, Open)) and not value.is_declared:
            value.check(f"{block}.{name}")
            if isinstance(value, Variable):
                _check_finite(value, f"{block}.{name}")
            value.is_declared = True


def _check_finite(variable: Variable, place: str) -> None:
    """Refuse a default or a start that is no number, nan or infinite: no file could hold it."""
    word = "start" if isinstance(variable, Memory) else "default"
    given = getattr(variable, word, None)
    if given is None or isinstance(given, (int, str)) or (isinstance(given, float) and math.isfinite(given)):
        return  # as nearly all; arrays would take longer
    numbers = np.array([x for x in np.ravel(np.array(given, dtype=object)) if isinstance(x, (float, np.floating))])
    wrong = numbers[~np.isfinite(numbers.astype(float))]
    if len(wrong):
        cure = "Leave it out: then each block must give a value." if isinstance(variable, Parameter) else ""
        refuse("E405", place, f"the {word} is {wrong[0]}, which is not a finite number.", cure)


def declare(
    name: str,
    doc: str,
    body: Mapping[str, object],
    foreign: object = None,
    describing: str = "",
    apart: str = "",
    form: Any = None,
) -> Declaration:
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
            if isinstance(value, Computed):
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
        describing,
        apart,
        form,
    )
    if len(steppers) > 1:
        refuse("E403", f"{name}.{steppers[1].name}", "is a second stepper.", "Declare one stepper at most.")
    check_declaration(declaration)
    for variable in (*declaration.readable.values(), *declaration.event_times.values()):
        variable.is_declared = True
    return declaration


def _add_starts(
    name: str,
    parameters: dict[str, Parameter],
    memories: Mapping[str, State | Discrete | Algebraic],
    equations: Iterable[Equation],
    body: Mapping[str, object],
) -> None:
    """The parameter `<x>_start` of each algebraic variable, and of each state and discrete without initial equation."""
    initial = {role.target for equation in equations for role in equation.roles if role.kind == "initial"}
    for key, variable in memories.items():
        if variable in initial:
            continue
        start = f"{key}_start"
        if start in body:
            refuse("E401", f"{name}.{start}", f"is reserved for the start value of '{key}'.", "Rename it.")
        parameter = Parameter(variable.start, unit=variable.unit, shape=variable.shape)
        parameter.type, parameter.members = variable.type, variable.members
        parameter.name = start
        parameter.doc = (
            f"{'where the search begins for' if isinstance(variable, Algebraic) else 'start value of'} {key}"
        )
        parameters[start] = parameter


def _sizes(name: str, parameters: Mapping[str, Parameter], body: Mapping[str, object]) -> tuple[str, ...]:
    """The sizes that parameters name in their shapes."""
    sizes: dict[str, None] = {}
    for parameter in parameters.values():
        for size in parameter.shape if isinstance(parameter.shape, tuple) else (parameter.shape,):
            if isinstance(size, str):
                if size in body or size in RESERVED:
                    cure = "Rename one of them."
                    refuse("E401", f"{name}.{parameter.name}", f"the size '{size}' has a name that is in use.", cure)
                sizes[size] = None
    return tuple(sizes)
