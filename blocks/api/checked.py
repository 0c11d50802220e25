"""A diagram file that is looked through without being run: its faults, its FMUs, and how it is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..compile.coupling import Coupling
from ..compile.plan import Plan
from ..compile.plan_summary import order, rates
from ..engines.selection import check_room
from ..model.block_types import Library
from ..model.trust import Found, found, to_be_refused
from ..text.errors import BlocksError, Fault
from .diagram import Diagram


@dataclass(frozen=True)
class Checked:
    """What is found in a diagram file.

    name, blocks: its name and number of blocks, where it could be read. wires: how many, where the diagram
    could not be flattened. states, rates: how many states there are, and the rates in words, where one solver computes
    it all. faults: of the diagram; untrusted: of FMUs that would be refused when it is run. is_diagram: False for a
    file of another format. plan: what is computed, where that is known.
    """

    name: str = ""
    blocks: int | None = None
    wires: int | None = None
    states: int | None = None
    rates: tuple[str, ...] = ()
    fmus: tuple[Found, ...] = ()
    faults: tuple[Fault, ...] = ()
    untrusted: tuple[Fault, ...] = ()
    is_diagram: bool = True
    plan: Plan | Coupling | None = None

    def order(self) -> Iterator[str]:
        """How it is computed, in lines; none where that is not known."""
        if self.plan is not None:
            yield from order(self.plan)


def checked(path: str | Path, *, library: Library, variants: Callable[[], Mapping[str, str]]) -> Checked:
    """All that is found in a file. variants: gives the chosen ones, as the file's own faults come before theirs."""
    diagram, plan, flat = None, None, None
    fmus: list[Found] = []
    untrusted: tuple[Fault, ...] = ()
    faults: tuple[Fault, ...]
    try:
        diagram = Diagram.load(path, library=library)
        diagram = diagram.with_variants(variants())
        untrusted = to_be_refused(diagram.value)
        flat = diagram.flatten()
        fmus = found(flat)
        plan = diagram.check()
        faults = plan.warnings
        check_room(plan)
    except BlocksError as error:
        is_other = any(
            fault.code == "E006" and fault.path == ("format",) and fault.file == path for fault in error.faults
        )
        faults = (*(plan.warnings if plan is not None else ()), *error.faults)
        if is_other:
            return Checked(faults=faults, is_diagram=False)
        if flat is None and diagram is not None:
            try:
                diagram.check()
            except BlocksError as further:  # what is wrong with the order as well, where only settings are in the way
                faults = further.faults
    whole = Checked(fmus=tuple(fmus), faults=faults, untrusted=untrusted, plan=plan)
    if isinstance(plan, Plan):
        count = sum(not instance.hidden for instance in plan.instances)
        return replace(whole, name=plan.name, blocks=count, states=len(plan.states), rates=tuple(rates(plan)))
    if flat is not None:
        return replace(whole, name=flat.name, blocks=sum(not block.hidden for block in flat.blocks))
    if diagram is not None:
        value = diagram.value
        return replace(whole, name=value.name, blocks=len(value.blocks), wires=len(value.wires))
    return whole
