"""The emitted code of a model, and the rates that tick together with the stages of their ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stage:
    """What is computed together at a tick: the places in d of sampled outputs with their rates, and steppers.

    unit: if not -1, the number of an FMU whose time event comes here. Then `steppers` holds rates, and -1 - the
    numbers of other FMUs, which the event comes before though the inputs of the FMU depend on them.
    """

    slots: tuple[tuple[int, int], ...]
    steppers: tuple[int, ...]
    unit: int = -1


@dataclass(frozen=True, slots=True)
class Clique:
    """Rates that may tick together, some of them or all; the first clique that contains the due ones is run."""

    rates: frozenset[int]
    stages: tuple[Stage, ...]


@dataclass(frozen=True)
class Emitted:
    """A model: its C text, and the data that belongs to it.

    x_order: the Plan's index of each state of the model. numbers, tables: the rows n and c. sizes: the macros
    BLOCKS_..., by their names without the prefix, where they are numbers. lanes: the C text of several runs side by
    side; "": it was not asked for. filled: the row blocks_filled, which the library gets once it is loaded.
    """

    source: str
    x_order: tuple[int, ...]
    numbers: tuple[float, ...]
    tables: tuple[float, ...]
    cliques: tuple[Clique, ...]
    sizes: Mapping[str, int]
    lanes: str = ""
    filled: bytes = b""
