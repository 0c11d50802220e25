"""Which rates tick together, and what is computed together at their ticks."""

from __future__ import annotations

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
