"""Everything that a value depends on, now or later: the memory that can still change it."""

from __future__ import annotations

from collections.abc import Iterable

from ..contract.closure import closure
from .plan import Node, Plan, Reference


class Upstream:
    """The memory of a Plan that values depend on, through rates, ticks, resets, sides and delays as well.

    What is not upstream of a value never changes it: neither its course nor a jump of it.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.written_by: dict[Reference, list[Node]] = {}
        self.read_by: dict[Reference, list[Reference]] = {}
        for place, node in enumerate(plan.derivatives):
            self._writes(Reference("x", place), node)
        for rate in plan.rates:
            for node, place in (*rate.outputs, *rate.nexts):
                self._writes(Reference("d", place), node)
        for place, cause in enumerate(plan.crossings):
            self._writes(Reference("s", place), cause.node)
        for cause in (*plan.crossings, *plan.events):
            for node, reference in cause.resets:
                self._writes(reference, node, cause.node)
        for node, reference in plan.projections:
            self._writes(reference, node)
        for place, history in enumerate(plan.histories):
            self._reads(Reference("h", place), [history.source])
        for part in plan.enabled:
            side = Reference("s", part.side)
            for reference in (*part.resets, Reference("d", part.time)):
                self._reads(reference, [side])
        for stepper in plan.steppers:
            read = [reference for _, references, _ in stepper.inputs for reference in references]
            for _, places, _ in stepper.outputs:
                for place in places:
                    self._reads(Reference("d", place), read)
        self.foreign = {  # an FMU's outputs depend on all that it knows
            part.instance: [*part.inputs, *(Reference("x", place) for place in part.states)] for part in plan.foreign
        }

    def _writes(self, reference: Reference, *nodes: Node) -> None:
        self.written_by.setdefault(reference, []).extend(nodes)

    def _reads(self, reference: Reference, read: list[Reference]) -> None:
        self.read_by.setdefault(reference, []).extend(read)

    def of(self, begin: Iterable[Reference]) -> frozenset[Reference]:
        """Return all memory that some values depend on, these included."""
        return frozenset(closure(begin, self._before))

    def _before(self, reference: Reference) -> list[Reference]:
        nodes = self.written_by.get(reference, [])
        if reference.row == "w":
            nodes = [self.plan.outputs[reference.index]]
        reached = [*self.read_by.get(reference, ())]
        for node in nodes:
            condition = self.plan.instances[node.instance].condition
            reached += self.plan.bind(node) + self.foreign.get(node.instance, [])
            reached += [] if condition is None else [Reference("s", condition)]
        return reached


def at_once(plan: Plan, begin: Iterable[Reference]) -> set[Reference]:
    """Return all memory and all unsampled outputs that values depend on at one time, these included."""
    return closure(begin, lambda value: plan.bind(plan.outputs[value.index]) if value.row == "w" else ())


def changed_by(plan: Plan) -> list[frozenset[Reference]]:
    """Return the memory that each rate, crossing, event time and break of a delay changes, in this order."""
    rates = [[Reference("d", place) for _, place in (*rate.outputs, *rate.nexts)] for rate in plan.rates]
    for stepper in plan.steppers:
        rates[stepper.rate] += [Reference("d", place) for _, places, _ in stepper.outputs for place in places]
    crossings = ([Reference("s", j), *(r for _, r in cause.resets)] for j, cause in enumerate(plan.crossings))
    events = ([r for _, r in cause.resets] for cause in plan.events)
    histories = ([Reference("h", i)] for i in range(len(plan.histories)))
    return [frozenset(changed) for changed in (*rates, *crossings, *events, *histories)]


def remembers_inputs(plan: Plan) -> bool:
    """Return whether a delay remembers anything that follows an input of the diagram."""
    sources = [history.source for history in plan.histories]
    return bool(sources) and any(row == "u" for row, _ in Upstream(plan).of(sources))
