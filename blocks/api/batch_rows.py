"""The table and the seeds that a batch is given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from ..model.diagram_grammar import LARGEST_SEED
from ..text.arrays import Array
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import counted, legible


def rows_of(columns: Sequence[str], table: Any) -> tuple[Any, Array | None]:
    """Return the rows of a table for a batch with these columns, and the same as (n, columns) if all are plain numbers.

    Raises UsageError (E501).
    """
    if type(table) is np.ndarray and table.dtype == float and table.shape[1:] == (len(columns),):
        return table, table
    rows = _rows(columns, table)
    values = [*chain.from_iterable(rows)]
    is_plain = {*map(type, values)} <= {float, int, np.float64}
    if not is_plain or any(type(x) is int and abs(x) > 2**53 for x in values):
        return rows, None
    return rows, np.array(values, dtype=float).reshape(len(rows), len(columns))


def _rows(columns: Sequence[str], table: Any) -> list[list[object]]:
    if isinstance(table, Mapping) or hasattr(table, "columns"):
        given = list(table)
        for name in columns:
            if name not in given:
                cure = did_you_mean(name, given) or f"Its columns: {', '.join(map(str, given)) or 'none'}."
                raise UsageError(Fault("E501", name, "the table has no such column.", cure))
        extra = [str(name) for name in given if name not in columns]
        if extra:
            message = f"the batch has no column {', '.join(map(legible, extra))}."
            raise UsageError(Fault("E501", "table", message, f"Its columns: {', '.join(columns)}."))
        values = [_listed(name, table[name]) for name in columns]
        if len({len(column) for column in values}) > 1:
            message = "has columns of different lengths."
            raise UsageError(Fault("E501", "table", message, "Give each column a value for each row."))
        return [list(row) for row in zip(*values, strict=True)]
    rows = [_listed(f"row {i}", row) for i, row in enumerate(_listed("table", table))]
    for i, row in enumerate(rows):
        if len(row) != len(columns):
            message = f"row {i} has {len(row)} values, but the batch has {len(columns)} columns."
            raise UsageError(Fault("E501", "table", message, f"The columns: {', '.join(columns)}."))
    return rows


def checked_seeds(given: object, n: int) -> list[int]:
    """Return the seeds of n rows. Raises UsageError (E501)."""
    seeds = _listed("seeds", given.tolist() if isinstance(given, np.ndarray) else given)
    seeds = [seed.item() if isinstance(seed, np.generic) else seed for seed in seeds]
    if len(seeds) != n:
        message = f"has {counted(len(seeds), 'seed')} for {counted(n, 'row')}."
        raise UsageError(Fault("E501", "seeds", message, "Give a seed for each row, or leave seeds out."))
    for i, seed in enumerate(seeds):
        if type(seed) is not int or not 0 <= seed <= LARGEST_SEED:
            message = f"must be integers from 0 to 2^53, but row {i} has {legible(repr(seed))}."
            raise UsageError(Fault("E501", "seeds", message))
    return seeds


def _listed(name: str, given: Any) -> list[Any]:
    """Return what a table, a row or a column holds, one by one. Raises UsageError (E501)."""
    try:
        if isinstance(given, (str, bytes)):
            raise TypeError
        return list(given)
    except TypeError:
        message = f"must be a list or an array, not {legible(repr(given))}."
        cure = "Write a table as a list of rows, or as a mapping of columns."
        raise UsageError(Fault("E501", name, message, cure)) from None
