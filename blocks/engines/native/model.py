"""A Plan as native code: what is emitted, compiled and loaded, and the tables that the runtime reads beside it."""

from __future__ import annotations

import contextlib
import ctypes
import math
import threading
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...compile.c import runtime_layout
from ...compile.c.emit_cache import emitted, plan_key
from ...compile.c.emitted import Emitted
from ...compile.c.runtime_grid import grid_of
from ...compile.c.runtime_tables import RuntimeTables
from ...compile.c.runtime_texts import RUNTIME, loop_units, packaged, stiff_units
from ...compile.plan import Node, Plan, Reference
from ...compile.tableaus import STIFF
from ...compile.toolchain.compiler import TranslationUnit
from ...text.arrays import Array
from ...text.errors import CompilerError
from ..run.measures import Measures
from ..run.step_parts import longest_step
from .code import Code

if TYPE_CHECKING:
    from ...compile.c.lane_code import Machine
    from .carried_order import CarriedOrder

_LOCK = threading.Lock()
MOST_MODELS = 32
_MODELS: dict[object, Model] = {}  # by all of a plan but its values: plans that differ in these alone share one
Entry = tuple[int, int | None, int, Any, int]
"""A part of a run's memory: its place and that of its count, in bytes from the start of the run; its size, kind and
flags."""
EXTRA_FLAGS: tuple[str, ...] = ()  # of the compiler, such as sanitizers in tests
LARGE = 10_000
"""From so many operations on, the equations of one block may be why a compiler fails."""


def model_of(
    plan: Plan, log: tuple[str, ...], method: str, *, lanes: Machine | None = None, is_quick: bool = False
) -> Model:
    """The model of a Plan, made once for plans that differ in values alone. lanes: of what machine its runs are made
    side by side too. is_quick: its code may be one that `Code.hurry` makes faster. Raises CompilerError (E60x)."""
    windows = tuple((spec.type, spec.start, spec.stop, spec.omega) for spec in plan.measures)
    measured, logged = Measures(plan).references, [ref for name in log for ref in plan.signal(name).references]
    digest = plan_key(plan, measured, logged, method)
    key = (digest, windows, EXTRA_FLAGS, lanes)
    with _LOCK:
        model = _MODELS.pop(key, None)
    # Without the lock: compiling takes time, and a fork may come meanwhile.
    if model is None and lanes is None:
        made = emitted(plan, digest, measured=measured, method=method, logged=logged)
        model = Model(plan, made, logged, method, is_quick=is_quick)
    elif model is None:
        from ...compile.c.model_code import emit

        made = emit(plan, measured=measured, method=method, logged=logged, lanes=True)
        model = Model(plan, made, logged, method, lanes)
    elif not is_quick:
        model.optimise()
    with _LOCK:
        _MODELS[key] = model  # the last one used goes last
        while len(_MODELS) > MOST_MODELS:
            del _MODELS[next(iter(_MODELS))]
        return model


class OfSettings(NamedTuple):
    """The values with which all runs of the same settings and nominal sizes begin.

    setup: as C has it. expected: how many rows they record. atol: of each state, in the order of C. ticks: the numbers
    of the first ones.
    """

    settings: object
    nominal: tuple[float, ...]
    setup: object
    expected: int
    atol: Array
    ticks: list[int]


class Model(RuntimeTables):
    """The compiled model of a Plan. lanes: the machine whose lanes run several at once; None: there are none.
    why_no_lanes: they were asked for, and would bring nothing. is_quick: it may begin with quickly compiled code, as
    `Code` says."""

    def __init__(
        self,
        plan: Plan,
        made: Emitted,
        logged: list[Reference],
        method: str,
        lanes: Machine | None = None,
        *,
        is_quick: bool = False,
    ) -> None:
        super().__init__(plan, made, logged)
        headers = packaged(*RUNTIME)
        other, *more = ("fmu_bridge.c", "fmu_bridge.h", "fmu_types.h") if plan.foreign else ("batch.c", "batch.h")
        beside = headers | packaged(*more)
        stiff = ("jacobian.c", *stiff_units(method)) if method in STIFF else ()
        more_units = (*stiff, *loop_units(self.emitted.source))
        units = [
            TranslationUnit("runtime.c", packaged("runtime.c")["runtime.c"], headers, is_shared=True),
            TranslationUnit(other, packaged(other)[other], beside, is_shared=True),
            *(TranslationUnit(name, text, headers, is_shared=True) for name, text in packaged(*more_units).items()),
            TranslationUnit("model.c", self.emitted.source, beside if plan.foreign else headers),
        ]
        self.why_no_lanes, self.lanes = "", lanes
        if lanes is not None:
            from ...compile.c.lane_code import LANE_FILES, why_no_gain

            self.why_no_lanes = why_no_gain(made.sizes)
            self.lanes = None if self.why_no_lanes else lanes
        if self.lanes is not None:
            headers = headers | packaged(*LANE_FILES, "batch.h") | {"lane_machine.h": self.lanes.header()}
            units.append(TranslationUnit("lanes.c", made.lanes, headers))
        guesses = [plan.guesses.get(reference, 0.0) for reference in plan.unknowns]
        begins = _sides(plan)
        sides = [0.0 if isinstance(begin, Node) else float(begin.index) for begin in begins]
        located = [float(isinstance(begin, Reference)) for begin in begins]
        begin = {"z": guesses, "s": sides, "located": located}
        self.begin = tuple((name, np.array(row, dtype=float)) for name, row in begin.items())
        """At the start: where searches begin, the sides of crossings, and which of these are known."""
        self.constants = self.numbers.ctypes.data, self.tables.ctypes.data
        """Where the rows n and c are."""
        self._carried: CarriedOrder | None = None
        self._of_measures: tuple[object, object, Measures] | None = None
        self._of_settings: OfSettings | None = None  # of the last run
        self.spare: list[Any] = []  # memory for rows that no run has now
        self.entries: dict[str, Entry] = {}  # of the memory of its runs; empty before the first of them
        self._plan, self._filled = plan, made.filled
        with _largest_named(plan):
            self.code = Code(units, self._prepare, extra_flags=EXTRA_FLAGS, is_quick=is_quick)

    def _prepare(self, library: ctypes.CDLL) -> None:
        _declare(library, has_batch=not self._plan.foreign, has_lanes=self.lanes is not None)
        if self._filled:
            ctypes.memmove(library["blocks_filled"], self._filled, len(self._filled))
        self.address = ctypes.cast(library["blocks_model"], ctypes.c_void_p).value
        self._of_settings = None  # they name the model
        vars(self).pop("setup", None)

    @property
    def library(self) -> ctypes.CDLL:
        """The compiled code."""
        return self.code.library

    def optimise(self) -> None:
        """Take the optimised code now. Raises CompilerError (E60x)."""
        with _largest_named(self._plan):
            self.code.optimise()

    @cached_property
    def setup(self) -> object:
        """What runs are made of: the tables in their places; the rest is of a run."""
        setup = runtime_layout.BlocksSetup()
        setup.model = self.address
        for entry, values in self.of_setup():
            setattr(setup, entry.name, values.ctypes.data)
            if entry.length:
                setattr(setup, entry.length, len(values))
        setup.nintegers = int(self.has_integers)
        setup.has_windows, setup.has_paths = int(self.has_windows), int(self.has_paths)
        return setup

    def carried_order(self, plan: Plan) -> CarriedOrder:
        """How what a stiff method keeps is ordered, by a Plan that differs in values alone."""
        if self._carried is None:
            from .carried_order import CarriedOrder  # explicit methods carry nothing

            self._carried = CarriedOrder(plan, self.place)
        return self._carried

    def measures_of(self, plan: Plan) -> Measures:
        """The measures of a run that has not begun: they are replaced, never changed, so that runs may share them."""
        last = self._of_measures
        if last is None or last[0] is not plan.measures or last[1] is not plan.settings:
            last = self._of_measures = plan.measures, plan.settings, Measures(plan)
        return last[2]

    def tolerances(self, plan: Plan) -> Array:
        """Return the absolute tolerance of each state, in the order of C."""
        tolerances: Array = plan.settings.atol * np.array(plan.nominal, dtype=float)[self.order]
        return tolerances

    def for_settings(self, plan: Plan) -> OfSettings:
        """Return what runs with the settings of a plan begin with."""
        settings = plan.settings
        last = self._of_settings
        # As in runs with other parameters.
        if last is not None and last.settings is settings and last.nominal is plan.nominal:
            return last
        setup = runtime_layout.BlocksSetup.from_buffer_copy(self.setup)
        setup.rtol, setup.plain_atol = settings.rtol, settings.atol
        start = settings.start
        setup.longest = longest_step(plan)
        setup.end = math.nan if settings.stop is None else float(settings.stop)
        setup.start = float(start)
        setup.base_numerator, setup.base_denominator = plan.base.as_integer_ratio()
        setup.fixed = grid_of(start, settings.step, settings.stop)
        setup.every = grid_of(start, settings.every, settings.stop)
        setup.has_jumps = int(settings.records_jumps)
        setup.ends = -1 if plan.ends is None else plan.ends
        rows: Fraction | int = 256
        if settings.every is not None and settings.stop is not None:
            rows = (settings.stop - start) / settings.every + 64
        # More than that is copied anyway, from chunks that are freed meanwhile.
        expected = int(rows) if rows * 8 * (1 + len(self.logged)) <= 2**26 else 256
        count = start / plan.base
        ticks = [max(0, math.ceil((count - rate.offset) / rate.period)) for rate in plan.rates]
        made = self._of_settings = OfSettings(settings, plan.nominal, setup, expected, self.tolerances(plan), ticks)
        return made


def _sides(plan: Plan) -> list[Node | Reference]:
    """The sides of crossings at the start."""
    if plan.folded is None:
        return list(plan.s_start)
    begins: dict[int, Node | Reference] = {}
    for k, begin in enumerate(plan.folded.plan.s_start):
        begins |= dict.fromkeys(plan.folded.places("s", k), begin)
    return [begins[k] for k in sorted(begins)]


@contextlib.contextmanager
def _largest_named(plan: Plan) -> Iterator[None]:
    """Where the compiler fails, the error also names the largest equations."""
    try:
        yield
    except CompilerError as error:
        fault = error.faults[0]
        largest = max(plan.instances, key=lambda instance: len(instance.tape.nodes), default=None)
        if fault.code != "E602" or largest is None or len(largest.tape.nodes) < LARGE:
            raise
        count = f"{len(largest.tape.nodes):,} operations"
        message = f"{fault.message}The equations of {largest.path} have {count}, maybe too many. Split the block."
        raise CompilerError(replace(fault, message=message)) from None


def _declare(library: ctypes.CDLL, *, has_batch: bool, has_lanes: bool) -> None:
    """Declare the types of its functions. A mismatch of structures is a defect of this package.

    has_batch: one that FMUs take part in has no batch. has_lanes: whether it was compiled with lanes.
    """
    c = ctypes
    sim = c.c_void_p
    for name, result, arguments in (
        ("blocks_new", sim, [sim]),
        ("blocks_free", None, [sim]),
        ("blocks_reset", None, [sim]),
        ("blocks_take_model", None, [sim]),
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
        ("blocks_take_rows", None, [sim, sim, c.c_int64, sim, sim, c.c_int64]),
        ("blocks_rates", None, [sim, c.c_double, sim, sim]),
        ("blocks_list_room", c.c_int, [sim, c.c_int64]),
        ("blocks_past_room", c.c_int, [sim, c.c_int64, c.c_int64]),
        *([("blocks_batch", c.c_int64, [sim, sim, sim])] if has_batch else []),
        *(
            [
                ("blocks_lanes_new", sim, [sim, sim, c.c_int64]),
                ("blocks_lanes", c.c_int64, [sim, sim, sim]),
                ("blocks_lanes_free", None, [sim]),
            ]
            if has_lanes
            else []
        ),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    sizes = [*(c.c_int64 * 3).in_dll(library, "blocks_sizes")]
    if sizes != [c.sizeof(runtime_layout.STRUCTURES[f"Blocks{name}"]) for name in ("Sim", "Setup", "Memory")]:
        raise AssertionError(f"the structures of the runtime do not match its headers: {sizes}")
