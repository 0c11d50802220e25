"""A Plan as native code: what is emitted, compiled and loaded, and the tables that the runtime reads beside it."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...compile.c.emit_cache import emitted, plan_key
from ...compile.c.model_code import Emitted
from ...compile.plan import Node, Plan, Reference
from ...compile.toolchain.compiler import Unit, build, load
from ...text.errors import CompilerError
from ...text.gc_pause import paused
from ..run.measures import Measures
from . import runtime_layout
from .runtime_texts import packaged

__all__ = ["MOST", "RUNTIME", "Model", "Tables", "model_of"]

Array = np.ndarray[Any, Any]

MOST = 2**53  # beyond it, doubles do not hold every integer
_LOCK = threading.Lock()
MOST_MODELS = 32
_MODELS: dict[Any, Model] = {}  # by all of a plan but its values: those of plans that differ in these alone are one
EXTRA_FLAGS: tuple[str, ...] = ()  # of the compiler, such as sanitizers in tests
LARGE = 10_000
"""Operations in the equations of one block from which on they may be what a compiler fails at."""
RUNTIME = ("runtime.h", "model.h", "steps.h")


def model_of(plan: Plan, log: tuple[str, ...], method: str) -> Model:
    """The model of a Plan, made once for plans that differ in values alone. Raises CompilerError (E60x)."""
    windows = tuple((spec.type, spec.start, spec.stop) for spec in plan.measures)
    measured, logged = Measures(plan).references, [ref for name in log for ref in plan.signal(name).references]
    digest = plan_key(plan, measured, logged, method)
    key = (digest, windows, EXTRA_FLAGS)
    with _LOCK:
        made = _MODELS.pop(key, None)
    # Without the lock: compiling takes time, and a fork may come meanwhile.
    made = made or Model(plan, emitted(plan, digest, measured=measured, method=method, logged=logged), logged)
    with _LOCK:
        _MODELS[key] = made  # the last one used goes last
        while len(_MODELS) > MOST_MODELS:
            del _MODELS[next(iter(_MODELS))]
        return made


class Tables:
    """What the runtime reads beside a model: all tables that do not depend on the settings of a run."""

    def __init__(self, plan: Plan, made: Emitted, logged: list[Reference]) -> None:
        self.emitted, self.logged = made, logged
        self.order = np.array(self.emitted.x_order, dtype=np.intp)
        self.place = np.empty(len(self.order), dtype=np.intp)  # of each state of the plan, its place in the model
        self.place[self.order] = np.arange(len(self.order))
        self.numbers = np.array(self.emitted.numbers, dtype=float)
        self.tables = np.array(self.emitted.tables, dtype=float)
        self.columns = {reference: column for column, reference in reversed(list(enumerate(self.logged)))}
        self._tables(plan)

    @paused()
    def _tables(self, plan: Plan) -> None:
        """What the runtime reads: causes and their resets, rates and their stages, gates, projections, histories."""
        causes = [*plan.crossings, *plan.events]
        instances = plan.instances
        ranks: dict[int, dict[str, int]] = {}

        def rank(node: Node) -> tuple[int, int]:
            tape = instances[node.instance].tape
            known = ranks.setdefault(id(tape), {key: k for k, key in enumerate(tape.results)})
            return node.instance, known[node.key]

        def condition(instance: int) -> int:
            side = instances[instance].condition
            return -1 if side is None else side

        rows: list[tuple[int, ...]] = []
        resets: list[tuple[tuple[int, int], tuple[int, ...]]] = []
        first = 0
        for number, cause in enumerate(causes):
            instance = instances[cause.instance]
            told = not instance.hidden or bool(instance.told_as)
            direction = {"": 0, "up": 1, "down": 2, "both": 3}[cause.direction]
            is_foreign = int(instance.tape.opaque is not None)
            rows.append((direction, len(cause.resets), first, condition(cause.instance), int(told), is_foreign))
            first += len(cause.resets)
            for k, (node, (row, place)) in enumerate(cause.resets):
                at = int(self.place[place]) if row == "x" else place
                resets.append((rank(node), (number, k, 0 if row == "x" else 1, at)))
        resets.sort()
        self.causes = _table(rows, runtime_layout.CAUSE)
        self.resets = _table([reset for _, reset in resets], runtime_layout.RESET)
        self.listed = np.array(sorted(range(len(causes)), key=lambda i: rank(causes[i].node)), dtype=np.int32)
        self.told_as = [
            (instances[cause.instance].told_as or instances[cause.instance].path, cause.name) for cause in causes
        ]
        self.rates = _table([(rate.period, rate.offset) for rate in plan.rates], runtime_layout.RATE)
        # Ticks.
        of_slot = {slot: node.instance for rate in plan.rates for node, slot in (*rate.outputs, *rate.nexts)}
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
                stages.append((len(slots), len(outputs), len(steppers), len(numbers)))
                slots += [(slot, rate, condition(of_slot[slot])) for slot, rate in outputs]
                steppers += numbers
        self.cliques = _table(cliques, runtime_layout.CLIQUE)
        self.stages = _table(stages, runtime_layout.STAGE)
        self.slots = _table(slots, runtime_layout.SLOT)
        nexts = [(slot, k, condition(node.instance)) for k, rate in enumerate(plan.rates) for node, slot in rate.nexts]
        self.nexts = _table(nexts, runtime_layout.SLOT)
        self.stage_steppers = np.array(steppers, dtype=np.int32)
        parts: list[tuple[int, ...]] = []
        places: list[int] = []
        for part in plan.steppers:
            inputs = sum(len(references) for _, references, _ in part.inputs)
            given = [slot for _, own, _ in part.outputs for slot in own]
            parts.append((part.rate, condition(part.instance), inputs, len(given), len(places)))
            places += given
        self.steppers = _table(parts, runtime_layout.STEPPER)
        self.stepper_slots = np.array(places, dtype=np.int32)
        # Subdiagrams that are enabled.
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
        self.projections = _table(
            [
                (0 if row == "x" else 1, int(self.place[at]) if row == "x" else at, condition(node.instance))
                for node, (row, at) in plan.projections
            ],
            runtime_layout.PROJECTION,
        )
        self.histories = _table([(h.delay, h.before, int(h.echoes)) for h in plan.histories], runtime_layout.HISTORY)
        members: list[float] = []
        self.integers = np.zeros(max(len(plan.discretes), 1), dtype=np.int32)
        self.member_counts = np.zeros_like(self.integers)
        for slot, known in plan.integers.items():
            self.integers[slot] = 2 + len(members) if known else 1
            self.member_counts[slot] = len(known)
            members += sorted(known)
        self.members = np.array(members, dtype=float)
        self.has_integers = bool(plan.integers)
        windows = [(spec.start, spec.stop) for spec in plan.measures]
        self.has_windows = any(np.isfinite(edge) for window in windows for edge in window)
        self.windows = _table(windows, runtime_layout.WINDOW)


class Model(Tables):
    """The compiled model of a Plan."""

    def __init__(self, plan: Plan, made: Emitted, logged: list[Reference]) -> None:
        super().__init__(plan, made, logged)
        headers = packaged(*RUNTIME)
        runtime = Unit("runtime.c", packaged("runtime.c")["runtime.c"], headers, is_shared=True)
        model = Unit("model.c", self.emitted.source, headers)
        units = [runtime, model]
        if plan.foreign:
            headers |= packaged("fmu_bridge.h")
            units = [runtime, Unit("fmu_bridge.c", packaged("fmu_bridge.c")["fmu_bridge.c"], headers, is_shared=True)]
            units.append(Unit("model.c", self.emitted.source, headers))
        self.library = _prepared(load(_built(plan, units)))
        self.address = ctypes.cast(self.library["blocks_model"], ctypes.c_void_p).value

    def fill(self, setup: runtime_layout.Setup) -> None:
        """The tables in their places."""
        setup.model = self.address
        for count, table in (
            ("ncauses", self.causes), ("nresets", self.resets), ("ncliques", self.cliques), ("nstages", self.stages),
            ("nslots", self.slots), ("nnexts", self.nexts), ("nsteppers", self.steppers), ("nenabled", self.enabled),
            ("nwindows", self.windows),
        ):  # fmt: skip
            setattr(setup, count, len(table))
        setup.nintegers = int(self.has_integers)
        for name in (
            "causes", "resets", "rates", "cliques", "stages", "slots", "nexts", "stage_steppers", "steppers",
            "stepper_slots", "enabled", "anew_places", "inside_events", "anew_steppers", "projections", "histories",
            "integers", "member_counts", "members", "windows",
        ):  # fmt: skip
            setattr(setup, name, getattr(self, name).ctypes.data)
        setup.order = self.listed.ctypes.data
        setup.measured_count = len(self.windows)
        setup.has_windows = int(self.has_windows)


def _built(plan: Plan, units: Sequence[Unit]) -> Path:
    """The library of a model. Of one that the compiler cannot make, the largest equations are named as well."""
    try:
        return build(units, extra_flags=EXTRA_FLAGS)
    except CompilerError as error:
        fault = error.faults[0]
        largest = max(plan.instances, key=lambda one: len(one.tape.nodes), default=None)
        if fault.code != "E602" or largest is None or len(largest.tape.nodes) < LARGE:
            raise
        count = f"{len(largest.tape.nodes):,} operations"
        message = f"{fault.message}The equations of {largest.path} have {count}, maybe too many: split the block."
        raise CompilerError(replace(fault, message=message)) from None


def _table(rows: Sequence[tuple[Any, ...]], kind: np.dtype[np.void]) -> Array:
    return np.array(rows, dtype=kind)


def _prepared(library: ctypes.CDLL) -> ctypes.CDLL:
    """The library with the types of its functions. A mismatch of structures is a defect of this package."""
    c = ctypes
    sim = c.c_void_p
    for name, result, arguments in (
        ("blocks_new", sim, [sim]),
        ("blocks_free", None, [sim]),
        ("blocks_reset", None, [sim]),
        ("blocks_start", c.c_int, [sim]),
        ("blocks_begin", c.c_int, [sim]),
        ("blocks_advance", c.c_int, [sim, c.c_double, c.c_int64, c.c_int32]),
        ("blocks_settle", c.c_int, [sim]),
        ("blocks_is_due", c.c_int, [sim]),
        ("blocks_keep_left", c.c_int, [sim]),
        ("blocks_reload", None, [sim]),
        ("blocks_rows", None, [sim]),
        ("blocks_logged", c.c_int, [sim, sim]),
        ("blocks_record", c.c_int, [sim]),
        ("blocks_rates", None, [sim, c.c_double, sim, sim]),
        ("blocks_size", c.c_int64, [c.c_int32]),
        ("blocks_past_room", c.c_int, [sim, c.c_int64, c.c_int64]),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    sizes = [library.blocks_size(k) for k in (0, 1, 3)]
    if sizes != [c.sizeof(runtime_layout.Sim), c.sizeof(runtime_layout.Setup), c.sizeof(runtime_layout.Memory)]:
        raise AssertionError(f"the structures of the runtime and of runtime_layout.py differ: {sizes}")
    return library
