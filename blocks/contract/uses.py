"""The uses of the parameters of a block type besides its equations: they decide how far another value reaches.

The table tells which blocks differ in a number alone, which values need a Plan of their own, and when a parameter may
be set.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

from .declaration import Declaration
from .equations import Output
from .reads import arguments
from .variables import Clock, Parameter, Stepped

TUNABLE, FIXED, CONSTANT = range(3)
"""When a parameter may be set: at any time, before the start only, never."""


class Use(NamedTuple):
    """A use of a parameter.

    what: "value" where only its own value counts: a start value, or a number from which a program is made; "nominal"
    where the usual size of a state follows; "delay" where a delay does; "more" where anything else follows.
    level, why: when it may be set.
    """

    name: str
    what: str
    level: int = TUNABLE
    why: str = ""


@lru_cache(maxsize=256)
def uses(declaration: Declaration) -> tuple[Use, ...]:
    """Find the uses of all parameters of a block type."""
    found = (_of_parameters, _of_clocks, _of_memory, _of_starts, _of_rest)
    return tuple(use for part in found for use in part(declaration) if use.name in declaration.parameters)


@lru_cache(maxsize=256)
def sizing(declaration: Declaration) -> frozenset[str]:
    """Find the parameters that sizes are computed from."""
    d = declaration
    tables = (d.parameters, d.inputs, d.outputs, d.states, d.discretes)
    shapes = [variable.shape for table in tables for variable in table.values()]
    sizes = [size for shape in shapes for size in (shape if isinstance(shape, (tuple, list)) else (shape,))]
    return frozenset(name for size in sizes if callable(size) for name in arguments(size, "the shape"))


@lru_cache(maxsize=256)
def late_units(declaration: Declaration) -> frozenset[str]:
    """Find the parameters whose units follow from sizes or from computed defaults."""
    if declaration.foreign is not None:  # it may have 300,000, and their units are texts
        return frozenset()
    known = {name for name, parameter in declaration.parameters.items() if not callable(parameter.default)}
    units = {name: parameter.unit for name, parameter in declaration.parameters.items() if callable(parameter.unit)}
    return frozenset(name for name, unit in units.items() if not known.issuperset(arguments(unit, name)))


def _of_parameters(declaration: Declaration) -> Iterator[Use]:
    for name, parameter in declaration.parameters.items():
        if parameter.type == "string" or parameter.structural:
            yield Use(name, "more", CONSTANT, "it fixes the type of the block")
        elif parameter.stream:
            yield Use(name, "value", CONSTANT, "it follows from the name of the stream and the seed of the run")
        elif parameter.table:
            yield Use(name, "more", CONSTANT, "it is a table")
        elif parameter.zeros:
            yield Use(name, "more", CONSTANT, "which elements are 0 fixes the type of the block")


def _of_clocks(declaration: Declaration) -> Iterator[Use]:
    for role in (role for equation in declaration.equations for role in equation.roles if role.clock is not None):
        for name in _times(role.clock):
            yield Use(name, "more", CONSTANT, "ticks depend on it") if role.ticks else Use(name, "more")
    stepper = declaration.stepper
    if stepper is not None:
        for name in _times(stepper.clock):
            yield Use(name, "more", CONSTANT, "a stepper is made from it")
        for name in stepper.reads:
            yield Use(name, "value", CONSTANT, "a stepper is made from it")


def _of_memory(declaration: Declaration) -> Iterator[Use]:
    for history in declaration.histories.values():
        for source, what, why in (
            (history.delay, "delay", "a delay depends on it"),
            (history.before, "more", f"{history.name} holds it before the start"),
        ):
            # A run reads a parameter when it begins; what a function gives is computed before.
            for name in _read(source):
                yield Use(name, what, FIXED if isinstance(source, Parameter) else CONSTANT, why)
    sampled: list[Output | Stepped] = [output for output in declaration.outputs.values() if output.clock is not None]
    for held in (*sampled, *declaration.stepped.values()):
        for name in _read(held.start):
            yield Use(name, "more", CONSTANT, f"{held.name} holds it before the first tick")


def _of_starts(declaration: Declaration) -> Iterator[Use]:
    for name in declaration.algebraics:
        yield Use(f"{name}_start", "value", CONSTANT, "a search begins there")
    for name in (*declaration.states, *declaration.discretes):
        yield Use(f"{name}_start", "value", FIXED, "it is a start value")
    for name, parameter in declaration.parameters.items():
        if parameter.fixed:
            yield Use(name, "value", FIXED, "event times depend on it")


def _of_rest(declaration: Declaration) -> Iterator[Use]:
    """Find what fixes nothing in a run, but changes more than a number."""
    for name in sizing(declaration):
        yield Use(name, "more")
    for state in declaration.states.values():
        for name in _read(state.nominal):
            yield Use(name, "nominal")
    for variable in declaration.readable.values():
        for word in ("default", "start", "before", "delay", "unit"):
            for name in _read(getattr(variable, word, None)):
                yield Use(name, "more")


def _times(clock: Clock | None) -> tuple[str, ...]:
    return () if clock is None else (*_read(clock.every), *_read(clock.offset))


def _read(source: object) -> tuple[str, ...]:
    """Find the parameters from which something is taken."""
    if isinstance(source, Parameter):
        return (source.name,)
    return arguments(source, "it") if callable(source) else ()
