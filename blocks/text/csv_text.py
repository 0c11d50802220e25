"""Tables of numbers in CSV text: one header line, then rows; lines that begin with # are left out.

A line `# units: {"omega": "rpm"}` above the header, as result files have it, gives the units of columns.
"""

from __future__ import annotations

import csv
import json
import math
import re
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from .arrays import Array

_UNITS = re.compile(r"[\ufeff \t]*#\s*units:(.*)$", re.DOTALL)


def read_columns(
    lines: Iterable[str],
    wanted: Collection[str] | None = None,
    *,
    most: int | None = None,
    words: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
    units: dict[str, str] | None = None,
) -> tuple[list[str], Array]:
    """The names in the header, and the numbers, of shape (rows, columns).

    wanted: the columns that must hold numbers, all unless given; in others, NaN stands for what is none. most: rows.
    words: for a column the numbers that words in it stand for. units: filled with the units that the text gives.
    Raises ValueError with a sentence.
    """
    reader = csv.reader(lines if units is None else _noting_units(lines, units))
    header: list[str] = []
    numbers = array("d")
    count = 0
    try:
        for cells in reader:
            if not cells or cells[0].lstrip().startswith("#"):
                continue
            if not header:
                header = [name.strip() for name in cells]
                _check_header(header, units or {})
                continue
            if len(cells) != len(header):
                raise ValueError(f"line {reader.line_num}: {len(cells)} cells for {len(header)} columns.")
            count += 1
            if most is not None and count > most:
                raise ValueError(f"has more than {most:,} rows.")
            for name, cell in zip(header, cells, strict=True):
                try:
                    numbers.append(_number_of(cell, name, words.get(name, {})))
                except ValueError as error:
                    if wanted is None or name in wanted:
                        raise ValueError(f"line {reader.line_num}: {error}.") from None
                    numbers.append(math.nan)
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num} cannot be read: {error}.") from None
    if not header:
        raise ValueError("is empty.")
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise ValueError(f"has two columns with the same name, {twice[:40]!r}.")
    return header, np.array(numbers).reshape(count, len(header))


def _check_header(header: Sequence[str], units: Mapping[str, str]) -> None:
    """Raise ValueError if a header names no columns, or not those of the units."""
    if len(header) == 1 and ";" in header[0]:
        raise ValueError("separates its columns by ';'. Use commas.")
    if units and not any(column.partition("[")[0] in units or column in units for column in header):
        names = ", ".join(name[:40] for name in units)
        raise ValueError(f'"# units" names columns that do not exist: {names}. Columns: {", ".join(header[:20])}.')


def _number_of(cell: str, name: str, known: Mapping[str, float]) -> float:
    """Return the number in a cell of a column. known: the numbers of words. Raises ValueError with a clause."""
    try:
        return known[cell.strip()] if cell.strip() in known else _number(cell)
    except ValueError:
        text = f"{cell[:40]!r} in the column {name[:40]!r} is not a number"
        raise ValueError(text + (f", nor one of {', '.join([*known][:20])}" if known else "")) from None


def _noting_units(lines: Iterable[str], found: dict[str, str]) -> Iterator[str]:
    """Yield the lines, and put the units that a comment above the header gives into `found`."""
    is_above = True
    for line in lines:
        is_comment = line.lstrip("\ufeff \t").startswith("#")
        is_above = is_above and (is_comment or not line.strip())
        if is_above and is_comment and (match := _UNITS.match(line)):
            try:
                units = json.loads(match[1])
            except (ValueError, RecursionError):  # a comment of another program
                units = None
            if isinstance(units, dict):
                if bad := next((name for name, unit in units.items() if not isinstance(unit, str)), None):
                    raise ValueError(f'"# units" gives {bad[:40]!r} a unit that is not a text.')
                found.update(units)
            elif match[1].lstrip().startswith("{"):
                raise ValueError('"# units" is not a JSON object. Write # units: {"omega": "rpm"}.')
        yield line


def _number(cell: str) -> float:
    """The number in a cell. Raises ValueError."""
    if "_" in cell or not cell.isascii():  # Python would read 1_000, and digits of other scripts
        raise ValueError(cell)
    return float(cell)
