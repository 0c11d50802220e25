"""Measured signals: a CSV text that a page sends, as a source of rows."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text import units
from ..text.csv_text import read_columns
from ..text.errors import BlocksError, Fault, UsageError

__all__ = ["Measured"]

Array = np.ndarray[Any, Any]
LARGEST = 8 * 2**20
_HEAD = re.compile(r"(.*\S)\s+[\[(]([^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?)[\])]")
_TIMES = ("time", "t")


@dataclass(frozen=True)
class Measured:
    """The columns of a file by name: the first one is the time, `time` or `t`; a head may say a unit: `omega [rpm]`.

    A cell that holds no number is a gap. Files that blocks wrote say their units in their own way.
    """

    t: Array
    values: Array
    columns: Mapping[str, tuple[int, tuple[int, ...], str]]

    def rows(self) -> tuple[Array, Array]:
        return self.t, self.values

    @classmethod
    def read(cls, name: str, text: str) -> Measured:
        """name: of the file. Raises UsageError (E503), with all faults of its heads."""

        def refuse(message: str, cure: str = "") -> UsageError:
            return UsageError(Fault("E503", name, message, cure))

        if len(text) > LARGEST:
            raise refuse(f"is larger than {LARGEST // 2**20} MiB.", "Leave out columns or rows.")
        try:
            heads, table = read_columns(io.StringIO(text.removeprefix("\ufeff"), newline=""), ())
        except ValueError as error:
            raise refuse(str(error)) from None
        named = [_head(head) for head in heads]
        if named[0][0].lower() not in _TIMES:
            raise refuse("has no column 'time' in front.", "The first line is: time,NAME,... or time [ms],NAME [V],...")
        known, faults = _own_units(text), []
        for column, unit in (pair for pair in named if pair[1]):
            try:
                units.parse(unit)
            except BlocksError as error:
                faults += [Fault("E503", f"{name}: {column}", f.message, f.cure) for f in error.faults]
        if named[0][1] and not faults and not units.same_quantity(named[0][1], "s"):
            faults.append(Fault("E503", f"{name}: time", f"is in {named[0][1]}, which is no unit of time."))
        if faults:
            raise UsageError(*faults)
        t = table[:, 0] * units.scale(named[0][1] or "s", "s")
        wrong = np.flatnonzero(~np.isfinite(t) | (np.diff(t, prepend=-np.inf) < 0))
        if len(wrong):
            raise refuse(f"row {wrong[0] + 1}: the time is no number, or lies before that of the row above.")
        if not len(t) or len(named) < 2:
            raise refuse("holds no rows." if not len(t) else "has no column but its times.")
        columns = {}
        for k, (column, unit) in enumerate(named[1:]):
            columns[column] = (k, (), unit or known.get(column) or known.get(column.partition("[")[0], ""))
        if len(columns) < len(named) - 1:
            raise refuse("has two columns of one name.")
        return cls(t, table[:, 1:], columns)


def _head(text: str) -> tuple[str, str]:
    """The name and the unit in a head: "omega [rad/s]"; the number of an element is none: "u[0]"."""
    found = _HEAD.fullmatch(text)
    return (found[1], found[2].strip()) if found else (text, "")


def _own_units(text: str) -> dict[str, str]:
    """The units that a file of blocks says in its comments, by signal."""
    found = re.search(r"^# units: (\{.*\})\s*$", text[:100_000], re.MULTILINE)
    try:
        told = json.loads(found[1]) if found else {}
    except ValueError:
        return {}
    return {name: unit for name, unit in told.items() if isinstance(unit, str)}
