"""The numbers of a run at a stop, as rows: their kinds and shapes, and which numbers a run can leave there.

Both engines write and read these rows, and so do files of saved states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ...compile.inputs import InputTable, Track
from ...compile.jacobian import PlanJacobian
from ...compile.plan import Plan
from ...compile.tableaus import STIFF
from ...text.arrays import Array
from .measures import Measures
from .snapshot import CARRIED_NUMBERS

MOST_CROSSED = 1000
"""The most times of crossings that are remembered, by which chattering is seen."""


def _any(values: Array) -> bool:
    return True


def _is_number(values: Array) -> object:
    return ~np.isnan(values)


def _is_count(values: Array) -> Array:
    return (values >= 0) & (values < 2**31)


def _is_side(values: Array) -> object:
    return (values == 0.0) | (values == 1.0)


class Row(NamedTuple):
    """The numbers that a row may hold: their shape (None: any length), a test of them, and their kind in numpy."""

    shape: tuple[int | None, ...]
    allowed: Callable[[Array], Any] = np.isfinite
    kind: str = "f8"
    is_optional: bool = False

    def fits(self, values: Array) -> bool:
        """Return whether a row could come from a run."""
        is_alike = values.dtype == np.dtype(self.kind) and values.ndim == len(self.shape)
        pairs = zip(values.shape, self.shape, strict=False)
        return is_alike and all(size is None or n == size for n, size in pairs) and bool(np.all(self.allowed(values)))


def recorded_width(plan: Plan) -> int:
    """Return how many numbers a recorded row has: the time, and the elements of the signals of the log."""
    return 1 + len(plan.columns)


def _table(plan: Plan, method: str) -> dict[str, Row]:
    """The rows of a state of a Plan, by name."""
    nx, crossings, events = len(plan.states), len(plan.crossings), len(plan.events)
    table = {
        "t": Row(()),
        "x": Row((nx,)),
        "d": Row((len(plan.discretes),)),
        "s": Row((len(plan.s_start),), _is_side),
        "z": Row((len(plan.unknowns),)),
        "ticks": Row((len(plan.rates),), lambda n: n >= 0, "i8"),
        "events": Row((events,), _is_number),
        "own": Row((events,), _any),
        "step": Row((), lambda h: np.isfinite(h) & (h >= 0)),
        "error": Row((), lambda error: np.isfinite(error) & (error > 0)),
        "first": Row((nx,), is_optional=True),
        "stiffness": Row((3,), lambda n: _is_count(n[:2]).all() & (n[:2] % 1 == 0).all() & ~np.isinf(n[2])),
        "fixed": Row((), lambda n: n >= 0, "i8"),
        "broken": Row(()),
        "located_t": Row((), _any),
        "located": Row((crossings,), _any),
        "fired": Row((crossings,), _is_number),
        "crossed": Row((None,), lambda t: len(t) <= (MOST_CROSSED if crossings else 0)),
        "parameters": Row((len(plan.parameters),)),
        "recorded": Row((recorded_width(plan),), _any, is_optional=True),
        "between": Row((), lambda n: n >= 0, "i8", is_optional=True),
    }
    if method in STIFF:
        table["carried"] = Row((None,), is_optional=True)
    else:  # the crossings of the step before, of the native engine
        table["before"] = Row((crossings,), _any, is_optional=True)
    if plan.histories:
        table |= {
            "past.starts": Row((None,), _is_number),
            "past.ends": Row((None,), _is_number),
            "past.parts": Row((None, 6, len(plan.histories)), _any),
            "past.breaks": Row((None,)),
            "past.orders": Row((None,), _is_count, "i4"),
            "past.open": Row((), _is_side, "i4"),
            "past.passed": Row((len(plan.histories),), _is_count, "i8"),
            "past.seen": Row((), _is_count, "i4"),
        }
    for k, (_, shape, *_) in enumerate(plan.inputs):
        table |= {
            f"inputs.{k}.t": Row((None,), lambda t: len(t) > 0 and not np.any(np.diff(t) < 0)),
            f"inputs.{k}.u": Row((None, math.prod(shape))),
            f"inputs.{k}.linear": Row((), _is_side, "i4"),
        }
    for name, blank in Measures(plan).rows().items():
        table[name] = Row((None, *blank.shape[1:]) if "path" in name else blank.shape, _any)
    table["measures.known"] = Row((None,), lambda known: len(known) in (0, 1 + 2 * len(plan.measures)))
    return table


def check_rows(rows: Mapping[str, Array], exact: Fraction | None, plan: Plan, method: str) -> None:
    """Raise ValueError if the rows of a state could not come from a run of the Plan."""
    table = _table(plan, method)
    if odd := rows.keys() - table.keys():
        raise ValueError(f"it has no place for the row {min(odd)!r}")
    for name, row in table.items():
        if name not in rows and not row.is_optional:
            raise ValueError(f"it lacks the row '{name}'")
        if name in rows and not row.fits(rows[name]):
            raise ValueError(f"its row '{name}' has another size than its names, or a number that no run leaves there")
    if exact is not None and float(exact) != rows["t"]:
        raise ValueError("its two times differ")
    if ("recorded" in rows) != ("between" in rows):
        raise ValueError("its last recorded row is incomplete")
    for slot, members in plan.integers.items():
        value = float(rows["d"][slot])
        if not (value in members if members else value.is_integer()):
            raise ValueError(f"'{plan.discretes[slot]}' is {value}")
    t = _some_ulp_before(rows["t"])
    ticks = zip(plan.rates, rows["ticks"].tolist(), strict=True)
    if (rows["events"] < t).any() or any(float(rate.offset + n * rate.period) < t for rate, n in ticks):
        raise ValueError("its next event or tick lies before its time")
    if "carried" in rows:
        _check_carried(rows["carried"], plan)
    if plan.histories:
        _check_past(rows, plan)
    if any(len(rows[f"inputs.{k}.t"]) != len(rows[f"inputs.{k}.u"]) for k in range(len(plan.inputs))):
        raise ValueError("one of its inputs is not a table")


def _some_ulp_before(t: Any) -> float:
    """A time before t by more than the ulps by which instants at one time may differ."""
    return float(t) - 1e-12 * max(1.0, abs(float(t)))


def _check_carried(carried: Array, plan: Plan) -> None:
    """Refuse what a stiff method could not have kept: C uses its pivots as places."""
    n = len(plan.states)
    size = CARRIED_NUMBERS + 3 * n + int(PlanJacobian(plan).indptr[-1])
    pivots = carried[size:]
    is_whole = len(carried) == size or (len(pivots) == n and np.array_equal(np.sort(pivots), np.arange(n)))
    if not is_whole or (carried[:CARRIED_NUMBERS] < 0).any():
        raise ValueError("the memory of its method does not fit its states")


def _check_past(rows: Mapping[str, Array], plan: Plan) -> None:
    parts, breaks, passed, t = rows["past.parts"], rows["past.breaks"], rows["past.passed"], float(rows["t"])
    before = _some_ulp_before(t)
    sizes = {len(rows["past.starts"]), len(rows["past.ends"]), len(parts)}
    is_whole = len(sizes) == 1 and 0 < len(breaks) == len(rows["past.orders"])
    if not is_whole or (passed > len(breaks)).any() or (passed.any() and not len(parts)):
        raise ValueError("its past is incomplete")
    pairs = zip(plan.delays, passed.tolist(), strict=True)
    following = [float(breaks[n]) + history.delay for history, n in pairs if n < len(breaks)]
    if (np.diff(breaks) < 0).any() or breaks[-1] > 2 * t - before or any(time < before for time in following):
        raise ValueError("its past breaks at times that are not possible")


def input_rows(inputs: InputTable) -> dict[str, Array]:
    """Return the inputs of a run as rows."""
    rows: dict[str, Array] = {}
    for k, track in enumerate(inputs.tracks):
        linear = np.array(track.linear, dtype=np.int32)
        rows |= {f"inputs.{k}.t": track.t, f"inputs.{k}.u": track.u, f"inputs.{k}.linear": linear}
    return rows


def inputs_of(rows: Mapping[str, Array], count: int) -> InputTable:
    """Return the inputs of rows that `input_rows` gave."""
    return InputTable(
        tuple(
            Track(rows[f"inputs.{k}.t"].copy(), rows[f"inputs.{k}.u"].copy(), bool(rows[f"inputs.{k}.linear"]))
            for k in range(count)
        )
    )
