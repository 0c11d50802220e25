"""Checks of a diagram: its flat form, the order in which it is computed, or all of its faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from ..compile.coupling import Coupling, couple
from ..compile.plan import Plan
from ..compile.plan_builder import plan
from ..compile.plan_summary import outline
from ..model.diagram_value import DiagramValue, beside
from ..model.flat_block import FlatBlock
from ..model.flatten import Flat, flatten, is_stepped
from ..model.hierarchy import Resolver
from ..model.raw_values import raw_of
from ..model.varied import given_values
from ..text.errors import Fault, ModelError
from .case import Case


def flat_of(
    value: DiagramValue, resolver: Resolver, case: Case, *, inputs: Mapping[str, object] | None = None
) -> Flat:
    """Return a diagram without hierarchy, as a case has it. inputs: in the form of files, to be checked too.

    Raises ModelError with all faults, UsageError (E501).
    """
    value = case.of(value)
    overrides = {name: raw_of(raw) for name, raw in given_values(value, resolver, case.parameters).items()}
    settings = case.settings if inputs is None else {**case.settings, "inputs": inputs}
    return flatten(value, resolver, overrides=overrides, settings=settings)


def coupled_block(flat: Flat) -> FlatBlock | None:
    """Return the first block that a master steps."""
    return next(filter(is_stepped, flat.one_of_each), None)


def instead_of_steps(block: FlatBlock) -> str:
    """Return how a block that a master steps becomes one with equations."""
    if block.interface.declaration.foreign.description.interface("ME") is None:
        return "The FMU is for Co-Simulation only: export it for Model Exchange"
    return 'Import it as "kind": "ME"'


def single_plan(flat: Flat) -> Plan:
    """Return the plan of a diagram. Raises ModelError (E118) if a master steps it."""
    coupled = coupled_block(flat)
    if coupled is not None:
        message = "is a Co-Simulation FMU, which a master steps, so the diagram has no single system of equations."
        cure = f"{instead_of_steps(coupled)}, or choose another variant."
        raise ModelError(Fault("E118", coupled.path, message, cure))
    return plan(flat)


def exportable(flat: Flat) -> Plan | Coupling:
    """Return what a diagram becomes as an FMU; a Coupling computes all outputs."""
    found = couple(flat)
    if isinstance(found, Plan):
        return found
    outputs = tuple(name for name in flat.outputs if name not in flat.log)
    return couple(replace(flat, log=(*flat.log, *outputs))) if outputs else found


def checked(value: DiagramValue, resolver: Resolver, case: Case) -> Plan | Coupling:
    """Return the Plan of a diagram, or the Coupling if it needs a master. Raises ModelError with every static fault."""
    try:
        return replace(couple(flat_of(value, resolver, case)), outline=outline)
    except ModelError as error:
        if any(fault.path[:1] != ("run",) for fault in error.faults):
            raise
        # What is wrong with the settings hides nothing of what is wrong with the order of the blocks.
        loops = {key: raw for key, raw in value.run.items() if key == "loops" and raw == "solve"}
        try:
            couple(flat_of(replace(value, run=loops), resolver, case))
        except ModelError as further:
            raise ModelError(*error.faults, *further.faults) from None
        raise


def faults_beside(error: ModelError, flattened: Callable[[], Flat]) -> list[Fault]:
    """Find faults in the meaning of a diagram with structural faults, without their consequences.

    Without it, a user would mend one half of the faults only to be shown the other one.
    """
    try:
        flattened()
    except ModelError as further:
        return beside(further.faults, error.faults)
    except Exception:  # what is half read may make anything fail: then only the faults of the structure count
        return []
    return []
