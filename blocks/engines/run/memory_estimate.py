"""The memory that a run will take, as far as it is known before it begins, and the error where there is none left.

Rows are known where they stand on a grid, where steps or ticks have a fixed length, and where delays bound the steps.
What follows from the model alone (adaptive steps, events) is watched while it runs: see `available_memory.Watch`.
"""

from __future__ import annotations

from fractions import Fraction

from ...compile.plan import Plan
from ...host import available_memory
from ...text.errors import Fault, SimulationError, UsageError

COPIES = 1.1
"""The recorded rows, and the part of them that is held twice while they become results."""
COPIES_OF_MASTER = 2
"""The same of a master, whose results are a copy."""
FLOAT = 8  # bytes
SMALL = 2**20  # bytes, for which the available memory is not looked up
CURE = "Record fewer signals (--log), or on a coarser grid (--every)."


def check_plan(plan: Plan, begin: Fraction, *, is_native: bool, is_streamed: bool = False) -> None:
    """Raise UsageError (E311) where a run from `begin` on cannot fit into memory."""
    rows, elements = 0 if is_streamed else rows_of(plan, begin), len(plan.columns)
    check(plan.name, rows, elements, _of_past(plan, begin, is_native=is_native))


def check(place: str, rows: int, elements: int, more: float = 0.0, *, copies: float = COPIES) -> None:
    """Raise UsageError (E311) where rows of so many elements cannot be recorded. more: other bytes that are needed."""
    recorded = float(rows) * (1 + elements) * FLOAT * copies
    needed = recorded + more
    if needed <= SMALL or needed <= (there := available_memory.for_recording()):
        return
    what, cure = f"{rows:,} rows of {elements:,} signals need {available_memory.told(recorded)}", CURE
    if more > recorded:
        what, cure = f"the history of the run's steps needs {available_memory.told(more)}", "Use larger steps."
    message = f"{what} of memory, and {available_memory.told(there)} are available."
    raise UsageError(Fault("E311", place, message, cure))


def rows_of(plan: Plan, begin: Fraction) -> int:
    """At least so many rows are recorded; 0 where the run has no end."""
    settings = plan.settings
    if settings.stop is None:
        return 0
    steps = [settings.every] if settings.every is not None else _steps(plan)
    if not steps:
        return 1
    (a, b), (c, d) = (settings.stop - begin).as_integer_ratio(), min(steps).as_integer_ratio()
    return a * d // (b * c) + 1


def _steps(plan: Plan) -> list[Fraction]:
    """Lengths in s that no step is longer than."""
    lengths = [rate.period * plan.base for rate in plan.rates]
    lengths += [plan.settings.step] if plan.settings.step is not None else []
    return lengths + [Fraction(one.delay) for one in plan.delays if one.delay > 0]


def _of_past(plan: Plan, begin: Fraction, *, is_native: bool) -> float:
    """Bytes of what histories remember: a polynomial for each step of the longest delay."""
    stop = plan.settings.stop
    if not plan.histories or stop is None:
        return 0.0
    horizon = min(stop - begin, Fraction(max(one.delay for one in plan.delays)))
    parts, n = horizon / min(_steps(plan), default=horizon), len(plan.histories)
    # What is no longer seen is taken out when it is half; an array of Python has a head, and stands in lists.
    return 2 * float(parts) * (6 * n * FLOAT + (16 if is_native else 250))


def no_room(place: str, t: float, recorded: float) -> SimulationError:
    """The error of a run that ends at t, as its recorded rows (bytes), or its past, leave no memory."""
    message = f"at t = {t} s no memory is left: the recorded rows take {available_memory.told(recorded)}."
    return SimulationError(Fault("E311", place, message, CURE))
