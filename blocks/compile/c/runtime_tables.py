"""What the C runtime reads besides the code of a model: a Plan as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from ...host.gc_pause import paused
from ...text.arrays import Array
from ..firing_order import order_of
from ..fmu_tape import FmuTape
from ..folding import Folded
from ..plan import FiringOrder, History, Node, Plan, Reference
from . import runtime_layout
from .emitted import Emitted


class SetupTable(NamedTuple):
    """A table of BlocksSetup: its field, and what is in it.

    kind: the type of its entries in C. length: the field that says how many there are; "": none does. in_fmus: whether
    exported FMUs have it; they have no blocks with a step of their own, and no measures.
    """

    name: str
    kind: str
    length: str = ""
    in_fmus: bool = True


SETUP = (
    SetupTable("causes", "BlocksCause", "ncauses"),
    SetupTable("resets", "BlocksReset", "nresets"),
    SetupTable("waits", "BlocksWait", "nwaits"),
    SetupTable("waits_for", "int32_t"),
    SetupTable("beside", "BlocksBeside", "nbeside"),
    SetupTable("rates", "BlocksRate"),
    SetupTable("cliques", "BlocksClique", "ncliques"),
    SetupTable("stages", "BlocksStage"),
    SetupTable("slots", "BlocksSlot"),
    SetupTable("nexts", "BlocksSlot", "nnexts"),
    SetupTable("enabled", "BlocksEnabled", "nenabled"),
    SetupTable("projections", "BlocksProjection"),
    SetupTable("histories", "BlocksHistory"),
    SetupTable("order", "int32_t"),
    SetupTable("anew_places", "int32_t"),
    SetupTable("inside_events", "int32_t"),
    SetupTable("integers", "int32_t"),
    SetupTable("member_counts", "int32_t"),
    SetupTable("members", "double"),
    SetupTable("steppers", "BlocksStepper", "nsteppers", in_fmus=False),
    SetupTable("stage_steppers", "int32_t", in_fmus=False),
    SetupTable("stepper_slots", "int32_t", in_fmus=False),
    SetupTable("anew_steppers", "int32_t", in_fmus=False),
    SetupTable("measures", "BlocksMeasure", "nmeasures", in_fmus=False),
)


MEASURES = {
    "ISE": 0, "ISU": 0, "mean_square": 0, "RMS": 0, "IAE": 1, "ITAE": 2, "THD": 3, "peak": 4, "total_variation": 5,
    "overshoot": 6, "settling_time": 7, "rise_time": 8, "zero_crossings": 9, "steady_state_error": 10, "end_time": 10,
}  # fmt: skip
"""What the runtime takes in for each type of measure, as runtime.h numbers it."""


class RuntimeTables:
    """All tables that do not depend on the settings of a run."""

    def __init__(self, plan: Plan, made: Emitted, logged: list[Reference]) -> None:
        self.emitted, self.logged = made, logged
        self.order = np.array(self.emitted.x_order, dtype=np.intp)
        self.place = np.empty(len(self.order), dtype=np.intp)  # the place in the model of each state of the plan
        self.place[self.order] = np.arange(len(self.order))
        self.numbers = np.array(self.emitted.numbers, dtype=float)
        self.tables = np.array(self.emitted.tables, dtype=float)
        self.columns = {reference: column for column, reference in reversed(list(enumerate(self.logged)))}
        self._tables(plan)

    @paused()
    def _tables(self, plan: Plan) -> None:
        """What the runtime reads: causes and their resets, rates and their stages, gates, projections, histories."""
        self._of_causes(plan)
        self._of_waits(order_of(plan))
        self._of_ticks(plan)
        self._of_steppers(plan)
        self._of_enabled(plan)
        self.projections = _table(
            [
                (0 if row == "x" else 1, int(self.place[at]) if row == "x" else at, side)
                for side, row, at in _projections(plan)
            ],
            runtime_layout.PROJECTION,
        )
        self.histories = _table([_numbers(one) for one in plan.histories], runtime_layout.HISTORY)
        self._of_integers(plan)
        measures = [(spec.start, spec.stop, spec.omega, MEASURES[spec.type]) for spec in plan.measures]
        self.measures = _table(measures, runtime_layout.MEASURE)
        self.has_windows = bool(np.isfinite(self.measures["low"]).any() or np.isfinite(self.measures["high"]).any())
        self.has_paths = any(spec.type in ("settling_time", "rise_time") for spec in plan.measures)

    def of_setup(self) -> Iterator[tuple[SetupTable, Array]]:
        """What stands in a BlocksSetup."""
        for entry in SETUP:
            yield entry, self.listed if entry.name == "order" else getattr(self, entry.name)

    def _of_causes(self, plan: Plan) -> None:
        """What happens at instants, and what it resets."""
        if plan.folded is not None:
            self._of_causes_of_copies(plan, plan.folded)
            return
        causes = [*plan.crossings, *plan.events]
        instances = plan.instances
        ranks: dict[int, dict[str, int]] = {}

        def rank(node: Node) -> tuple[int, int]:
            tape = instances[node.instance].tape
            known = ranks.setdefault(id(tape), {key: k for k, key in enumerate(tape.results)})
            return node.instance, known[node.key]

        rows: list[tuple[int, ...]] = []
        resets: list[tuple[tuple[int, int], tuple[int, ...]]] = []
        first = 0
        for number, cause in enumerate(causes):
            instance = instances[cause.instance]
            told = not instance.hidden or bool(instance.told_as)
            direction = {"": 0, "up": 1, "down": 2, "both": 3}[cause.direction]
            is_foreign = int(isinstance(instance.tape, FmuTape))
            on = _condition(plan, cause.instance)
            rows.append((direction, len(cause.resets), first, on, int(told), is_foreign))
            first += len(cause.resets)
            for k, (node, (row, place)) in enumerate(cause.resets):
                at = int(self.place[place]) if row == "x" else place
                resets.append((rank(node), (number, k, 0 if row == "x" else 1, at)))
        resets.sort()
        self.causes = _table(rows, runtime_layout.CAUSE)
        self.resets = _table([reset for _, reset in resets], runtime_layout.RESET)
        self.listed = np.array(sorted(range(len(causes)), key=lambda i: rank(causes[i].node)), dtype=np.int32)
        self.told_as = tuple(
            (instances[cause.instance].told_as or instances[cause.instance].path, cause.name) for cause in causes
        )

    def _of_causes_of_copies(self, plan: Plan, folded: Folded) -> None:
        """The same where they are known of one copy."""
        one, first = folded.plan, len(plan.crossings)
        ranks = {id(i.tape): {key: k for k, key in enumerate(i.tape.results)} for i in one.instances}
        kinds = [("s", one.crossings, 0), ("e", one.events, first)]
        number_of = [
            (folded.places(row, k), begin, cause) for row, causes, begin in kinds for k, cause in enumerate(causes)
        ]
        count = first + len(plan.events)
        rows: list[Any] = [()] * count
        told: list[Any] = [()] * count
        resets: list[tuple[Any, tuple[int, ...]]] = []
        listed: list[tuple[Any, int]] = []
        for places, begin, cause in number_of:
            direction = {"": 0, "up": 1, "down": 2, "both": 3}[cause.direction]
            known = ranks[id(one.instances[cause.instance].tape)]
            pairs = [(known[node.key], folded.places(row, at), row == "x") for node, (row, at) in cause.resets]
            for lane, place in enumerate(places):
                number = begin + place
                # Blocks of one copy stand before those of the next one, and other blocks between fleets.
                order = folded.order(cause.instance, lane)
                rows[number] = direction, len(pairs), 0, -1, 1, 0
                told[number] = folded.path(cause.instance, lane), cause.name
                listed.append(((order, known[cause.node.key]), number))
                for k, (rank, own, is_state) in enumerate(pairs):
                    at = int(self.place[own[lane]]) if is_state else own[lane]
                    resets.append(((order, rank, number, k), (number, k, 0 if is_state else 1, at)))
        begin = 0
        for number, row in enumerate(rows):
            rows[number] = (*row[:2], begin, *row[3:])
            begin += row[1]
        self.causes = _table(rows, runtime_layout.CAUSE)
        self.resets = _table([reset for _, reset in sorted(resets)], runtime_layout.RESET)
        self.listed = np.array([number for _, number in sorted(listed)], dtype=np.int32)
        self.told_as = tuple(told)

    def _of_waits(self, order: FiringOrder) -> None:
        """Which causes wait for which."""
        waits = order.waits
        ends = accumulate(len(wait.needed) for wait in waits)
        rows = [(wait.cause, end - len(wait.needed), len(wait.needed)) for wait, end in zip(waits, ends, strict=True)]
        self.waits = _table(rows, runtime_layout.WAIT)
        self.waits_for = np.array([number for wait in waits for number in wait.needed], dtype=np.int32)
        self.beside = _table([*order.beside], runtime_layout.BESIDE)

    def _of_ticks(self, plan: Plan) -> None:
        """Rates, and what is computed where some of them tick together."""
        self.rates = _table([(rate.period, rate.offset) for rate in plan.rates], runtime_layout.RATE)
        of_slot = _conditions(plan)
        self.masks = [
            np.array([rate in clique.rates for rate in range(len(plan.rates))] or [False], dtype=np.uint8)
            for clique in self.emitted.cliques
        ]
        slots: list[tuple[int, int, int]] = []
        steppers: list[int] = []
        stages: list[tuple[int, ...]] = []
        cliques: list[tuple[int, ...]] = []
        for clique, mask in zip(self.emitted.cliques, self.masks, strict=True):
            cliques.append((len(stages), len(clique.stages), mask.ctypes.data))
            for stage in clique.stages:
                outputs, numbers = stage.slots, stage.steppers
                stages.append((len(slots), len(outputs), len(steppers), len(numbers), stage.unit))
                slots += [(slot, rate, of_slot.get(slot, -1)) for slot, rate in outputs]
                steppers += numbers
        self.cliques = _table(cliques, runtime_layout.CLIQUE)
        self.stages = _table(stages, runtime_layout.STAGE)
        self.slots = _table(slots, runtime_layout.SLOT)
        nexts = [(slot, k, of_slot.get(slot, -1)) for k, slot in _nexts(plan)]
        self.nexts = _table(nexts, runtime_layout.SLOT)
        self.stage_steppers = np.array(steppers, dtype=np.int32)

    def _of_steppers(self, plan: Plan) -> None:
        """Blocks with a step of their own, and the slots of their outputs."""
        parts: list[tuple[int, ...]] = []
        places: list[int] = []
        for part in plan.steppers:
            inputs = sum(len(references) for _, references, _ in part.inputs)
            given = [slot for _, own, _ in part.outputs for slot in own]
            parts.append((part.rate, _condition(plan, part.instance), inputs, len(given), len(places)))
            places += given
        self.steppers = _table(parts, runtime_layout.STEPPER)
        self.stepper_slots = np.array(places, dtype=np.int32)

    def _of_enabled(self, plan: Plan) -> None:
        """Enabled subdiagrams, and what in them begins anew."""
        enabled: list[tuple[int, ...]] = []
        anew: list[tuple[int, int]] = []
        inside: list[int] = []
        again: list[int] = []
        for gate in plan.enabled:
            events = [i for i, cause in enumerate(plan.events) if cause.node.instance in gate.instances]
            own = [n for n, part in enumerate(plan.steppers) if part.instance in gate.anew]
            firsts = (len(gate.resets), len(anew), len(events), len(inside), len(own), len(again))
            enabled.append((gate.side, gate.time, *firsts, int(bool(gate.anew))))
            anew += [(0, int(self.place[place])) if row == "x" else (1, place) for row, place in gate.resets]
            inside += events
            again += own
        self.enabled = _table(enabled, runtime_layout.ENABLED)
        self.anew_places = np.array(anew, dtype=np.int32).reshape(-1, 2)
        self.inside_events = np.array(inside, dtype=np.int32)
        self.anew_steppers = np.array(again, dtype=np.int32)

    def _of_integers(self, plan: Plan) -> None:
        """Which memory holds integers, and which of them are members of an enumeration."""
        members: list[float] = []
        self.integers = np.zeros(max(len(plan.discretes), 1), dtype=np.int32)
        self.member_counts = np.zeros_like(self.integers)
        for slot, known in plan.integers.items():
            self.integers[slot] = 2 + len(members) if known else 1
            self.member_counts[slot] = len(known)
            members += sorted(known)
        self.members = np.array(members, dtype=float)
        self.has_integers = bool(plan.integers)


def _conditions(plan: Plan) -> dict[int, int]:
    """By place in d the side that says whether what is computed at its ticks is on; where it is always, nothing."""
    if plan.folded is not None:  # which has no enabled subdiagrams
        return {}
    nodes = (pair for rate in plan.rates for pair in (*rate.outputs, *rate.nexts))
    return {slot: _condition(plan, node.instance) for node, slot in nodes}


def _nexts(plan: Plan) -> Iterator[tuple[int, int]]:
    """The places in d that are replaced at ticks, each with its rate."""
    own = plan if plan.folded is None else plan.folded.plan
    for k, rate in enumerate(own.rates):
        slots = [slot for _, slot in rate.nexts]
        yield from ((k, s) for s in (slots if plan.folded is None else plan.folded.in_order("d", slots)))


def _projections(plan: Plan) -> Iterator[tuple[int, str, int]]:
    """What is replaced after each step: the side that says whether it is on, the row and the place."""
    if plan.folded is None:
        yield from ((_condition(plan, node.instance), *place) for node, place in plan.projections)
        return
    references = [place for _, place in plan.folded.plan.projections]
    instances = [node.instance for node, _ in plan.folded.plan.projections]
    rows: dict[int, tuple[int, str, int]] = {}
    for (row, at), numbers in zip(references, plan.folded.spread(instances), strict=True):
        rows |= {k: (-1, row, place) for k, place in zip(numbers, plan.folded.places(row, at), strict=True)}
    yield from (rows[k] for k in sorted(rows))


def _condition(plan: Plan, instance: int) -> int:
    """The side that says whether a block is on; -1: always."""
    side = plan.instances[instance].condition
    return -1 if side is None else side


def _numbers(of: History) -> tuple[float, ...]:
    """Return a history as C has it: its delay and what is before, as numbers and as places in p."""
    pair = of.delay, of.before
    numbers = [0.0 if one.row == "p" else one.index for one in pair]
    places = [one.index if one.row == "p" else -1 for one in pair]
    return (*numbers, *places, int(of.echoes))


def _table(rows: Sequence[tuple[object, ...]], kind: np.dtype[np.void]) -> Array:
    return np.array(rows, dtype=kind)
