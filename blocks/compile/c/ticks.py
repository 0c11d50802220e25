"""Which rates tick together, and what is computed together at their ticks."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Clique", "Stage"]


@dataclass(frozen=True, slots=True)
class Stage:
    """What is computed together at a tick: the places in d of sampled outputs with their rates, and steppers."""

    slots: tuple[tuple[int, int], ...]
    steppers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Clique:
    """Rates that may tick together, some of them or all; the first clique that contains the due ones is run."""

    rates: frozenset[int]
    stages: tuple[Stage, ...]
