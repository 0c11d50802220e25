"""Which rates tick together, and what is computed together at their ticks."""

from __future__ import annotations

from dataclasses import dataclass

from ...text.errors import ModelError
from ..plan import AlgebraicLoop, Plan
from ..tick_stages import coinciding, stages_of, tick_program

__all__ = ["Clique", "Stage", "cliques"]


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


def cliques(plan: Plan) -> list[frozenset[int]]:
    """The sets of rates that have programs, each before its supersets."""
    everything = frozenset(range(len(plan.rates)))
    if _can_tick(plan, everything) and not _is_split(plan, everything):
        return [everything]
    largest = sorted(coinciding(plan.rates), key=sorted)
    rate_sets: dict[frozenset[int], None] = {}
    for clique in largest:
        if not _is_split(plan, clique):
            rate_sets[clique] = None
            continue
        # An algebraic loop through sampled outputs is a different one where not all of them are due.
        members = sorted(clique)
        for bits in range(1, 1 << len(members)):
            rate_sets[frozenset(k for n, k in enumerate(members) if bits >> n & 1)] = None
    return sorted(rate_sets, key=lambda rates: (len(rates), sorted(rates)))


def _can_tick(plan: Plan, rates: frozenset[int]) -> bool:
    try:
        stages_of(plan, rates)
        tick_program(plan, _slots(plan, rates))
    except ModelError:
        return False
    return True


def _slots(plan: Plan, rates: frozenset[int]) -> list[int]:
    """The places in d of the sampled outputs of these rates."""
    return sorted(slot for k in rates for _, slot in plan.rates[k].outputs)


def _is_split(plan: Plan, rates: frozenset[int]) -> bool:
    """Whether an algebraic loop goes through a sampled output, and not all of the rates must be due."""
    if len(rates) < 2:
        return False
    program = tick_program(plan, _slots(plan, rates))
    return any(r.row == "d" for step in program.steps if isinstance(step, AlgebraicLoop) for r in step.unknowns)
