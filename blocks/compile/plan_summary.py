"""What is computed, in words: what a diagram became when it was checked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from ..model.copies import alike
from ..text.element_names import whole_of
from ..text.printable import counted
from ..text.rich_output import Part
from .coupling import CoupledUnit, Coupling
from .plan import AlgebraicLoop, Plan, Reference
from .scheduler import schedule
from .tick_stages import stages_of, tick_program

MOST_SHOWN = 60
"""Blocks that a line of an order names."""

_WAYS = {
    "exact": "inputs follow their courses exactly",
    "derivatives": "inputs by their derivatives",
    "intermediate": "inputs by intermediate update",
    "mean": "inputs by their mean over a step (order 2 at best)",
    "hold": "inputs are held",
}


def outline(made: Plan | Coupling) -> Iterator[Part]:
    """A headline, warnings, and how it is computed."""
    if isinstance(made, Plan):
        count = sum(not instance.hidden for instance in made.instances)
        known = list(rates(made))
        rest = f"{counted(len(made.states), 'state')}, {counted(len(known), 'rate')} ({', '.join(known)})"
    else:
        count = sum(not block.hidden for block in made.flat.blocks)
        rest = f"{counted(len(made.units), 'unit')} that a master steps"
    yield f"{made.name}: {counted(count, 'block')}, {rest}"
    yield from (f"  {line}" for line in (*map(str, made.warnings), *order(made)))


def order(made: Plan | Coupling) -> Iterator[str]:
    """How it is computed, in lines."""
    return _blocks(made) if isinstance(made, Plan) else _units(made)


def _units(coupling: Coupling) -> Iterator[str]:
    """Algorithm and units: how far each step goes, how inputs reach each unit, and what cannot go back."""
    master = coupling.settings.master
    control = f", error held to {master.tolerance:g}" if master.tolerance is not None else ""
    yield f"master: {master.algorithm}, inputs of order {master.order}{control}"
    yield from (f"  {unit}" for unit in alike(_told(coupling.units[k], coupling) for k in coupling.order))
    if coupling.measures:
        yield "  measures: of the values at communication points, joined by straight lines; what is between is not seen"


def own_tolerance(unit: CoupledUnit, coupling: Coupling) -> float | None:
    """The tolerance that is given to the solver of an FMU, where it is not that of the run."""
    told = None if unit.foreign is None else coupling.tolerance_of(unit)
    return None if told == coupling.settings.rtol else told


def _told(unit: CoupledUnit, coupling: Coupling) -> str:
    master = coupling.settings.master
    if unit.foreign is None:
        assert unit.plan is not None
        what = ", ".join(instance.path for instance in unit.plan.instances[:5] if not instance.hidden)
        name = unit.path or f"blocks with equations ({what}{', ...' if len(unit.plan.instances) > 5 else ''})"
    else:
        name = f"{unit.path} (FMI {unit.foreign.description.fmi})"
    step = "" if master.tolerance is not None else f"every {float(unit.step):g} s; "
    way = _WAYS[unit.way] if master.order or unit.foreign is None else "inputs are held"
    rest = ""
    if (own := own_tolerance(unit, coupling)) is not None:
        rest = f"; its own tolerance, {own:g}"
    if not unit.can_go_back:
        rest += "; cannot go back"
        if master.algorithm == "iterated":
            rest += ": its inputs are extrapolated, and only the others are iterated"
        elif master.tolerance is not None:
            rest += ": the error is estimated by what was predicted"
    return f"{name}: {step}{way}{rest}"


def _blocks(plan: Plan) -> Iterator[str]:
    program = schedule(plan, [*(Reference("w", i) for i in range(len(plan.outputs))), *plan.derivatives])
    order = _names(plan, (step.instance for step in program.order))
    if order:
        yield f"order: {_chain(order)}"
    for number, rate in enumerate(plan.rates):
        ticked = _names(plan, _at_ticks(plan, number))
        if ticked:
            yield f"at ticks of {plan.tick_time(rate.period):g} s: {_chain(ticked)}"
    loops = [step for step in program.steps if isinstance(step, AlgebraicLoop)]
    for loop in loops:
        names = [plan.node_name(node) for node in loop.nodes]
        yield f"solved together: {', '.join(alike(names))}"
    if not loops:
        yield "no algebraic loop"


def _names(plan: Plan, instances: Iterable[int]) -> list[str]:
    """The blocks in order, copies as one, and one for all parts of a block over long vectors."""
    own = {instance.path for instance in plan.instances if not instance.hidden}
    names = dict.fromkeys(whole_of(plan.instances[k].path, own) for k in instances)
    return alike(name for name in names if name)


def _chain(order: Sequence[str]) -> str:
    more = f" > ... ({len(order) - MOST_SHOWN} more)" if len(order) > MOST_SHOWN else ""
    return " > ".join(order[:MOST_SHOWN]) + more


def _at_ticks(plan: Plan, number: int) -> list[int]:
    """The blocks that are computed at the ticks of a rate, in order: those with sampled outputs, each after those that
    it needs, and programs; then all others."""
    instances: list[int] = []
    for stage in stages_of(plan, frozenset([number])):
        slots = frozenset(slot for slot in stage if slot >= 0)
        nodes = {plan.held_nodes[slot][0] for slot in slots}
        for step in tick_program(plan, sorted(slots)).order:
            instances += [step.instance for node in step.nodes if node in nodes]
        instances += [plan.steppers[-1 - key].instance for key in sorted(stage, reverse=True) if key < 0]
    instances += [node[0] for node, _ in plan.rates[number].nexts]
    return instances


def rates(plan: Plan) -> Iterator[str]:
    """The rates in words."""
    if plan.states or not plan.rates:
        yield "continuous"
    for rate in plan.rates:
        offset = f" from {plan.tick_time(rate.offset):g} s" if rate.offset else ""
        yield f"{plan.tick_time(rate.period):g} s{offset}"
