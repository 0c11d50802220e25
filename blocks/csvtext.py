"""Tables of numbers in CSV text: one header line, then rows; lines that begin with # are left out."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from typing import Any

import numpy as np

__all__ = ["read_columns"]

Array = np.ndarray[Any, Any]


def read_columns(lines: Iterable[str]) -> tuple[list[str], Array]:
    """The names in the header, and the numbers, of shape (rows, columns). Raises ValueError with a sentence."""
    reader = csv.reader(lines)
    header: list[str] = []
    rows: list[list[float]] = []
    try:
        for cells in reader:
            if not cells or cells[0].lstrip().startswith("#"):
                continue
            if not header:
                header = [name.strip() for name in cells]
                continue
            try:
                numbers = [_number(cell) for cell in cells]
            except ValueError:
                numbers = []
            if len(numbers) != len(header):
                raise ValueError(f"line {reader.line_num} does not hold {len(header)} numbers.")
            rows.append(numbers)
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num} cannot be read: {error}.") from None
    if len(set(header)) < len(header):
        raise ValueError("has two columns of one name.")
    return header, np.array(rows, dtype=float).reshape(len(rows), len(header))


def _number(cell: str) -> float:
    """The number in a cell. Raises ValueError."""
    if "_" in cell:  # Python would read 1_000
        raise ValueError(cell)
    return float(cell)
