"""What the ports of blocks carry while a model is mapped, and what one block becomes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from .numbers import Raw

Reading = tuple[str, str]
"""An input of a block of the model: its name and the port, "1", "enable", ...."""


@dataclass(frozen=True, slots=True)
class Rate:
    """When a signal changes. period: 0 for a continuous signal, inf for a constant. json: the period as written."""

    period: float
    offset: float = 0.0
    json: Any = field(default=None, compare=False)

    @property
    def is_sampled(self) -> bool:
        return 0 < self.period < math.inf


CONTINUOUS, CONSTANT = Rate(0.0), Rate(math.inf)


class Field(NamedTuple):
    """A signal of a bus: where its elements begin, how many there are, and the signals in it."""

    name: str
    at: int
    n: int
    fields: tuple[Field, ...]


@dataclass(frozen=True, slots=True)
class Attr:
    """What is known of a signal. n: its elements. rate: None while nothing is known. fields: those of a bus."""

    n: int = 1
    is_bool: bool = False
    rate: Rate | None = None
    fields: tuple[Field, ...] = ()


class Own(NamedTuple):
    """What arrives at an input of the model's block. element: None for all of it."""

    reading: Reading
    element: int | None = None


@dataclass(frozen=True, slots=True)
class Out:
    """An output of a block of the model. elements: the source of each. whole: the source of all of them together.

    A source is a port of the diagram, "gain.y", or, where a block only passes its input on, that input.
    """

    attr: Attr
    elements: tuple[str | Own, ...]
    whole: str | Own | None = None


@dataclass(frozen=True, slots=True)
class Wire:
    """A wire from a source to an input of the diagram. n: its elements, 1 for a scalar; is_vector: "u[0]" at n = 1."""

    sink: str
    source: str | Own
    n: int = 1
    is_bool: bool = False
    is_vector: bool = False


class Note(NamedTuple):
    """A line of the report. kind: "decided", "left out" or "unknown"."""

    kind: str
    what: str
    cure: str


@dataclass(slots=True)
class Part:
    """What a block of the model becomes: blocks of the diagram, the wires that end at them, and its outputs.

    log: inputs whose signals a Scope or a Display shows. outputs: those that a variable or a file takes, by its name.
    stops: inputs that end the run. inner: the system inside; ports: the inputs of it, by the names of its diagram.
    is_late: a sample time was needed that is not known yet.
    """

    blocks: dict[str, dict[str, Any]] = field(default_factory=dict)
    wires: list[Wire] = field(default_factory=list)
    outs: dict[str, Out] = field(default_factory=dict)
    notes: list[Note] = field(default_factory=list)
    log: list[Reading] = field(default_factory=list)
    outputs: dict[str, Reading] = field(default_factory=dict)
    stops: list[Reading] = field(default_factory=list)
    inner: Any = None
    ports: dict[str, str] = field(default_factory=dict)
    is_late: bool = False


def outputs_of(port: str, attr: Attr, *, is_vector: bool = False) -> Out:
    """Return the output of a port of the diagram."""
    if attr.n == 1 and not is_vector:
        return Out(attr, (port,), port)
    return Out(attr, tuple(f"{port}[{i}]" for i in range(attr.n)), port)


def passed_on(reading: Reading, attr: Attr) -> Out:
    """Return the output of a block that passes an input on."""
    return Out(attr, tuple(Own(reading, i) for i in range(attr.n)), Own(reading))


def joined(rates: Mapping[str, Rate | None] | list[Rate | None]) -> Rate | None:
    """Return the rate that a block inherits from its inputs: the fastest, or None where none is known."""
    known = [rate for rate in (rates if isinstance(rates, list) else rates.values()) if rate is not None]
    changing = [rate for rate in known if rate.period != math.inf]
    if changing:
        return min(changing, key=lambda rate: rate.period)
    return CONSTANT if known else None


def rate_of(period: Raw, offset: float) -> Rate:
    """Return a rate by what a model says of it."""
    return Rate(period.value, offset, period.json)
