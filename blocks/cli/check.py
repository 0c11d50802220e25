"""`blocks check`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ..text.errors import BlocksError, Fault
from .options import takes_library, takes_variants
from .output import counted, emit, fault_entry, fault_lines, printable
from .values import variants_of

if TYPE_CHECKING:
    from ..compile.plan import Plan
    from ..model.trust import Found

__all__ = ["add"]


def add(verbs: Any) -> None:
    check = verbs.add_parser(
        "check",
        help="find all static faults of a diagram",
        description="Check diagrams: all faults, the order of execution, rates, loops. Of a study: the faults of its "
        "file, of its diagrams, and of what it asks of them.",
    )
    check.add_argument("files", metavar="FILE", nargs="+", help="a diagram file (JSON), or a study; again for more")
    takes_variants(check)
    check.add_argument("--json", action="store_true", help="one JSON object per line")
    check.set_defaults(verb=_check)
    takes_library(check)


def _check(options: argparse.Namespace) -> int:
    statuses = []
    for path in options.files:
        if len(options.files) > 1 and not options.json:
            print(printable(path))
        statuses.append(_check_file(path, options))
    return max(statuses)


def _check_file(path: str, options: argparse.Namespace) -> int:
    from ..api.diagram import Diagram
    from ..compile.plan import Plan
    from ..engines.master.report import lines
    from ..engines.selection import check_room
    from ..model.trust import found, to_be_refused

    diagram, plan, flat = None, None, None
    fmus: list[Found] = []
    untrusted: tuple[Fault, ...] = ()
    faults: tuple[Fault, ...]
    try:
        diagram = Diagram.load(path, library=options.library)
        diagram = diagram.with_variants(variants_of(options.variants))
        untrusted = to_be_refused(diagram.value)
        flat = diagram.flatten()
        fmus = found(flat)
        plan = diagram.check()
        faults = plan.warnings
        check_room(plan)
    except BlocksError as error:
        if any(one.code == "E006" and one.path == ("format",) and one.file == path for one in error.faults):
            status = _check_study(path, options)
            if status is not None:
                return status
        faults = (*(plan.warnings if plan is not None else ()), *error.faults)
        if flat is None and diagram is not None:
            try:
                diagram.check()
            except BlocksError as whole:  # what is wrong with the order as well, where only settings are in the way
                faults = whole.faults
    of_fmus = tuple(fault for one in fmus for fault in one.faults)
    status = 2 if any(not fault.is_warning for fault in faults) else 0
    status = status or (4 if any(not fault.is_warning for fault in of_fmus) else 0)
    head = ""
    if isinstance(plan, Plan):
        count = sum(not instance.hidden for instance in plan.instances)
        states = counted(len(plan.states), "state")
        head = f"{plan.name}: {counted(count, 'block')}{_of_them(fmus)}, {states}, {_rates(plan)}"
    elif flat is not None:
        count = sum(not block.hidden for block in flat.blocks)
        head = f"{flat.name}: {counted(count, 'block')}{_of_them(fmus)}"
    elif diagram is not None:
        value = diagram.value
        head = f"{value.name}: {counted(len(value.blocks), 'block')}, {counted(len(value.wires), 'wire')}"
    if options.json:
        for one in fmus:
            emit(one.entry())
    order = () if plan is None or options.json else _order(plan) if isinstance(plan, Plan) else lines(plan)
    told = (*faults, *of_fmus, *untrusted)
    _tell(path, options, [head, *(line for one in fmus for line in one.lines())], told, order)
    return status


def _tell(
    path: str, options: argparse.Namespace, first: Sequence[str], faults: Sequence[Fault], last: Iterable[str] = ()
) -> None:
    """What was found in a file. first: its headline, "" for none, and lines above the faults; last: lines below."""
    errors = sum(not fault.is_warning for fault in faults)
    if options.json:
        for fault in faults:
            emit(fault_entry(fault, path))
        emit({"event": "done", "file": path, "errors": errors, "warnings": len(faults) - errors})
        return
    if first[0]:
        print(printable(first[0]))
    for line in (*first[1:], *fault_lines(faults, sys.stdout), *last):
        print(printable(f"  {line}"))
    print(f"{counted(errors, 'error')}, {counted(len(faults) - errors, 'warning')}")


def _check_study(path: str, options: argparse.Namespace) -> int | None:
    """The exit code for what is a study; None for what is none."""
    from ..studies import study

    loaded, faults = study.checked(path, library=options.library)
    if loaded is None and any(fault.code == "E006" and fault.path == ("format",) for fault in faults):
        return None
    head = ""
    if loaded is not None:
        head = f"{loaded.name}: {counted(len(loaded.runs), 'run')}, {counted(len(loaded.claims), 'claim')}"
    _tell(path, options, [head], faults)
    return 2 if faults else 0


def _of_them(fmus: Sequence[Found]) -> str:
    return f" ({counted(len(fmus), 'FMU')})" if fmus else ""


def _order(plan: Plan) -> Iterator[str]:
    """How a diagram is computed."""
    from ..compile.plan import Loop, Reference
    from ..compile.scheduler import schedule

    program = schedule(plan, [*(Reference("w", i) for i in range(len(plan.outputs))), *plan.derivatives])
    instances = (plan.instances[step.instance] for step in program.order)
    order = list(dict.fromkeys(instance.path for instance in instances if not instance.hidden))
    if order:
        yield f"order: {_chain(order)}"
    for number, rate in enumerate(plan.rates):
        ticked = _at_ticks(plan, number)
        if ticked:
            yield f"at ticks of {plan.tick_time(rate.period):g} s: {_chain(ticked)}"
    loops = [step for step in program.steps if isinstance(step, Loop)]
    for loop in loops:
        names = [plan.node_name(node) for node in loop.nodes]
        yield f"solved together: {', '.join(names)}"
    if not loops:
        yield "no algebraic loop"


def _chain(order: Sequence[str]) -> str:
    return " > ".join(order[:60]) + (f" > ... ({len(order) - 60} more)" if len(order) > 60 else "")


def _at_ticks(plan: Plan, number: int) -> list[str]:
    """The blocks that are computed at the ticks of a rate, in order: those with sampled outputs, each after those that
    it needs, and programs; then all others."""
    from ..compile.tick_stages import stages_of, tick_program

    made: list[int] = []
    for stage in stages_of(plan, frozenset([number])):
        slots = frozenset(slot for slot in stage if slot >= 0)
        nodes = {plan.held_nodes[slot][0] for slot in slots}
        for step in tick_program(plan, sorted(slots)).order:
            made += [step.instance for node in step.nodes if node in nodes]
        made += [plan.steppers[-1 - key].instance for key in sorted(stage, reverse=True) if key < 0]
    made += [node[0] for node, _ in plan.rates[number].nexts]
    return list(dict.fromkeys(plan.instances[k].path for k in made if not plan.instances[k].hidden))


def _rates(plan: Any) -> str:
    rates = ["continuous"] if plan.states or not plan.rates else []
    for rate in plan.rates:
        offset = f" from {plan.tick_time(rate.offset):g} s" if rate.offset else ""
        rates.append(f"{plan.tick_time(rate.period):g} s{offset}")
    return f"{counted(len(rates), 'rate')} ({', '.join(rates)})"
