"""Measured signals: a CSV text that a page sends, as a source of rows."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..results.table import TIMES, columns_of, parsed, refusal, sizes_of, without_twins
from ..text import units
from ..text.arrays import Array
from ..text.csv_text import read_columns
from ..text.errors import BlocksError, Fault, UsageError

LARGEST = 8 * 2**20
_HEAD = re.compile(r"(.*\S)\s+[\[(]([^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?)[\])]")
"""A name and a unit: "omega [rad/s]"; the number of an element is none: "u[0]"."""
_DECIMAL_COMMA = re.compile(r'(?:^|(?<=,))"[+-]?\d+,\d+"', re.MULTILINE)
"""A quoted cell that would pass as a gap."""


@dataclass(frozen=True, eq=False)
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
        refuse = refusal(name)
        if len(text) > LARGEST:
            raise refuse(f"exceeds the limit of {LARGEST // 2**20} MiB.", "Leave out columns or rows.")
        if (comma := _DECIMAL_COMMA.search(text)) is not None:
            raise refuse(f"{comma[0]} has a decimal comma. Write a decimal point.")
        try:
            heads, table = read_columns(io.StringIO(text.removeprefix("\ufeff"), newline=""), ())
        except ValueError as error:
            raise refuse(str(error)) from None
        found = [_HEAD.fullmatch(head) for head in heads]
        names = [match[1] if match else head for match, head in zip(found, heads, strict=True)]
        given = {match[1]: match[2].strip() for match in found if match}
        if names[0].lower() not in TIMES:
            raise refuse(
                "must have 'time' as its first column.",
                "Begin the file with the line time,NAME,... or time [ms],NAME [V],...",
            )
        own = re.search(r"^# units: (.*)$", text, re.MULTILINE)
        told, _ = sizes_of({"units": parsed(own[1], refuse)} if own else {}, refuse)
        faults = []
        for column, unit in {**told, **given}.items():
            try:
                units.scale(unit, "s" if column == names[0] else unit)
            except BlocksError as error:
                faults += [Fault("E503", f"{name}: {column}", f.message, f.cure) for f in error.faults]
        if faults:
            raise UsageError(*faults)
        for k, name_ in enumerate(names):  # values that count from an origin, such as degC, become SI
            for table_ in (given, told):
                if k and name_ in table_ and units.has_offset(table_[name_]):
                    factor, offset = units.affine(table_[name_], si := units.si_text(table_[name_]))
                    table[:, k], table_[name_] = table[:, k] * factor + offset, si
                    break
        t = table[:, 0] * units.scale(given.get(names[0], "s"), "s")
        wrong = np.flatnonzero(~np.isfinite(t) | (np.diff(t, prepend=-np.inf) < 0))
        if len(wrong):
            raise refuse(f"row {wrong[0] + 1}: the time is not a number, or lies before the time of the row above.")
        if not table[:, 1:].size:
            raise refuse("has no rows, or no column except the times.")
        return cls(t, table[:, 1:], columns_of(without_twins(names[1:], refuse), given, told, {}))
