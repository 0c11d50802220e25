"""Result files: recorded signals with their units and origin as CSV, Parquet and MAT, the format by the file's ending.

All three hold the time in s as `time`, one column for each recorded element (in a MAT file one matrix for each signal),
every double as it is, and what is known about the run ("metadata") as one object:

    CSV      lines `# key: JSON` in front of the table
    Parquet  the key `blocks` of the schema's metadata; each column has its `unit` and `signal`
    MAT      the struct `blocks`: `json` (the object's text), and by variable `names` and `units`

The same results give the same bytes: a file has no time stamp. A table of another program can be read too, where a
column `time` or `t` stands in front (CSV) or anywhere (Parquet, MAT), and so can what Simulink saves in MAT files.

Pandas, pyarrow and SciPy are loaded when used.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import importlib.util
import io
import json
import math
import mmap
import os
import re
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import numpy as np

from ..host.plain_files import INHERITED, opened
from ..text.arrays import Array
from ..text.atomic_write import known_ending, write_atomically
from ..text.errors import Fault, UsageError
from ..text.printable import legible, one_line
from .arrow import PART, Stored, Window, read_parquet, read_part, target_of, write_parquet
from .mat_check import check
from .simulink_saves import TOUT, opened_saves
from .table import (
    TIMES,
    VERSION,
    Content,
    FileTable,
    Refuse,
    columns_of,
    optional,
    parsed,
    refusal,
    sizes_of,
    unique,
    versioned,
    without_twins,
)

FORMATS = (".csv", ".parquet", ".mat")
FIRST_LINE = f"# blocks results {VERSION}"
ROWS = 4096
"""Rows of a CSV file that are made at once."""
MANY = 2**18
"""Numbers of a CSV file from which on pyarrow, where it is installed, is loaded to write or read them."""
# MATLAB's namelengthmax; its keywords cannot be names.
LONGEST_IDENTIFIER = 63
KEYWORDS = (
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while",
)  # fmt: skip
# MAT files begin with a text of this many bytes; SciPy puts the date there.
MAT_TITLE = b"MATLAB 5.0 MAT-file, written by blocks".ljust(116)


def check_format(path: str | Path) -> str:
    """The format of a path by its ending. Raises UsageError: E501 for another ending, E504 for a missing package."""
    ending = known_ending(path, FORMATS, "result files")
    if ending == ".parquet":
        optional("pyarrow", legible(str(path)))
    return ending


# --- writing ---------------------------------------------------------------------------------------------------


def write(path: str | Path, table: FileTable) -> None:
    """Write a table in the format of the path's ending; the file is replaced as a whole.

    Raises UsageError: E501 for an ending that is no format and for what cannot be written, E504 for a missing package.
    """
    ending = check_format(path)
    if ending != ".parquet" and isinstance(table.values, Stored):
        table = replace(table, t=table.values.times(), values=table.values())
    with write_atomically(path) as stream:
        if ending == ".csv":
            write_csv(stream, table, metadata=True)
        elif ending == ".parquet":
            write_parquet(stream.buffer, table)
        else:
            stream.buffer.write(MAT_TITLE)
            stream.buffer.write(_mat_bytes(path, table)[len(MAT_TITLE) :])


def write_csv(stream: TextIO, table: FileTable, *, metadata: bool) -> None:
    """Write a table as CSV. metadata: with the lines `# key: JSON` in front."""
    if metadata:
        lines = (f"# {key}: {json.dumps(value)}\n" for key, value in table.described().items())
        stream.writelines([FIRST_LINE + "\n", *lines])
    elements = table.elements()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time", *(name for name, _, _ in elements)])
    columns = [table.t, *(values for _, _, values in elements)]
    rows = ROWS
    texts: Callable[[Array], object] = _texts
    if len(table.t) * len(columns) >= MANY and _has_arrow():
        rows, texts = MANY // len(columns) + 1, _texts_by_arrow
    for first in range(0, len(table.t), rows):  # Python numbers take four times the memory
        part = [texts(column[first : first + rows]) for column in columns]
        if texts is _texts:
            writer.writerows(zip(*part, strict=True))
        else:
            stream.write(_lines(part))


def _texts(values: Array) -> list[str]:
    return [repr(value) for value in values.tolist()]


def _has_arrow() -> bool:
    return importlib.util.find_spec("pyarrow") is not None


def _texts_by_arrow(values: Array) -> object:
    """The same as an array of Arrow: its decimals are the shortest, too, and repr writes some of them otherwise."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if values.dtype != np.float64:
        return pa.array(_texts(values))
    texts = pc.cast(pa.array(values), pa.string())
    size = np.abs(values)
    with np.errstate(invalid="ignore"):  # NaN that signals
        whole = (size < 1e10) & (values == np.trunc(values))  # 1, which repr writes as 1.0
    # Arrow writes exponents below 1e-6 and from 1e10 on, even of one digit; repr below 1e-4 and from 1e16 on, of two.
    alike = whole | (size >= 1e-4) & (size < 1e10) | (size < 1e-9) | (size >= 1e16) | np.isnan(values)
    if whole.any():
        numbers = pc.binary_join_element_wise(texts.filter(pa.array(whole)), ".0", "")
        texts = pc.replace_with_mask(texts, pa.array(whole), numbers)
    if not alike.all():
        texts = pc.replace_with_mask(texts, pa.array(~alike), pa.array(_texts(values[~alike])))
    return texts


def _lines(columns: Sequence[object]) -> str:
    """Lines of a CSV file, of arrays of Arrow that hold texts of numbers."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    lines, plain = io.BytesIO(), arrow_csv.WriteOptions(include_header=False, quoting_style="none")
    arrow_csv.write_csv(pa.table(list(columns), [str(k) for k in range(len(columns))]), lines, plain)
    return lines.getvalue().decode("ascii")


def _mat_bytes(path: str | Path, table: FileTable) -> memoryview:
    from scipy.io import savemat

    described = table.described()
    variables = identifiers(table.columns)
    contents: dict[str, object] = {"time": table.t}
    for name, (first, shape, _) in table.columns.items():
        contents[variables[name]] = table.values[:, first : first + math.prod(shape)]
    contents["blocks"] = {
        "json": json.dumps(versioned(described)),
        "names": {variables[name]: name for name in table.columns},
        "units": {variables[name]: unit for name, (_, _, unit) in table.columns.items()},
    }
    stream = io.BytesIO()
    try:
        savemat(stream, contents, long_field_names=True, oned_as="column")
    except Exception as error:  # a matrix of more than 4 GiB, which the format cannot hold, has an error of its own
        raise UsageError(Fault("E501", legible(str(path)), f"cannot be written: {error}.", "Use .parquet.")) from None
    return stream.getbuffer()


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """A MATLAB variable for each signal: motor.omega -> motor_omega.

    At most 63 letters, digits and _, the first a letter, no keyword, each once (b_2 where b is taken).
    """
    names = list(names)
    plain = [re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_") for name in names]
    plain = [text if text[:1].isalpha() else f"x{text}" for text in plain]
    variables = unique(["time", "blocks", *KEYWORDS, *plain], longest=LONGEST_IDENTIFIER)
    return dict(zip(names, variables[-len(names) :] if names else [], strict=True))


# --- reading ---------------------------------------------------------------------------------------------------


def read(
    path: str | Path, signals: Sequence[str] | None = None, start: float | None = None, stop: float | None = None
) -> FileTable:
    """The table of a result file, or of the part of one; maybe of some signals and times only.

    Raises UsageError: E501 (a signal that is not there), E503 for what is no result file, E504.
    """
    is_part, window = target_of(path) is not None, Window(signals, start, stop)
    ending = PART if is_part else check_format(path)
    if is_part:
        optional("pyarrow", legible(str(path)))

    refuse = refusal(path)
    try:
        if ending in (".parquet", PART):
            read_rows = read_part if is_part else read_parquet
            names, data, units, metadata = read_rows(Path(path), refuse, window)
        else:
            names, data, units, metadata = (_read_csv if ending == ".csv" else _read_mat)(Path(path), refuse)
            picked = window.columns(names, legible(str(path)))
            names, rows = [names[k] for k in picked], window.rows(data[:, 0])
            if signals is not None or rows != slice(0, len(data)):
                data = data[rows][:, [0, *(k + 1 for k in picked)]]
    except UsageError:
        raise
    except Exception as error:  # a broken file may raise anything in the packages that read it
        said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise refuse(f"cannot be read: {one_line(said).rstrip(' .') or type(error).__name__}.") from None
    if metadata.get("version", VERSION) != VERSION:
        cure = "Use a newer release of blocks."
        raise refuse(f"is of version {legible(str(metadata['version']))}; this release reads version {VERSION}.", cure)
    t = data[:, 0]
    if not np.all(np.isfinite(t)) or np.any(np.diff(t) < 0):
        raise refuse("the times must be finite and must not decrease.")
    known, sizes = sizes_of(metadata, refuse)
    columns = columns_of(names, units, known, sizes)
    rest = {k: v for k, v in metadata.items() if k not in ("format", "version", "units", "sizes")}
    return FileTable(t.copy(), data[:, 1:].copy(), columns, rest)


def _read_csv(path: Path, refuse: Refuse) -> Content:
    metadata: dict[str, object] = {}
    with opened(path) as raw, io.TextIOWrapper(raw, encoding="utf-8-sig", newline="") as stream:
        line, skipped, above = stream.readline(), 0, 0
        ours = re.fullmatch(r"# blocks results ([0-9]{1,9})\s*", line)
        while line.startswith("#"):
            key, _, text = line[1:].strip().partition(":")
            if ours:  # comments of other programs are skipped
                with contextlib.suppress(ValueError):
                    metadata[key] = json.loads(text)
            above += len(line.encode())
            line, skipped = stream.readline(), skipped + 1
        metadata |= {"version": int(ours[1])} if ours else {}
        header = [name.strip() for name in next(csv.reader([line]), [])]
        if not header or header[0] not in TIMES:
            cure = "Begin the first line after comments with: time,NAME,..."
            raise refuse("does not begin with a column 'time'.", cure)
        many = _many_rows(path, skipped, len(header))
        if many is not None:
            return without_twins(header[1:], refuse), many, {}, metadata
        many = _many_rows(path, above + len(line.encode()), len(header))
        if many is not None:
            return without_twins(header[1:], refuse), many, {}, metadata
        rows = csv.reader(stream)
        data = array("d")
        for row in rows:
            try:
                numbers = [float(cell) for cell in row]
            except ValueError:
                numbers = []
            # Python takes 1_000 for a number.
            if row and (len(numbers) != len(header) or any("_" in cell for cell in row)):
                raise refuse(f"line {rows.line_num + skipped + 1} does not hold {len(header)} numbers.")
            data.extend(numbers)
    return without_twins(header[1:], refuse), np.array(data).reshape(-1, len(header)), {}, metadata


def _many_rows(path: Path, above: int, width: int) -> Array | None:
    """The rows of a large CSV file by pyarrow, below so many bytes of comments and header.

    None where the file is small, or where pyarrow is not there or finds a fault: Python tells where it is.
    """
    if str(path).startswith(INHERITED) or os.path.getsize(path) < 8 * MANY or not _has_arrow():
        return None
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in range(width)]
    convert = arrow_csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=[])
    with opened(path) as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        above += len(codecs.BOM_UTF8) if data[:3] == codecs.BOM_UTF8 else 0
        if data.find(b"(", above) >= 0:  # nan(1) is a number for pyarrow
            return None
        stream.seek(above)
        try:
            table = arrow_csv.read_csv(stream, arrow_csv.ReadOptions(column_names=names), convert_options=convert)
        except pa.ArrowException:
            return None
        return np.column_stack([column.to_numpy() for column in table.columns])


def _read_mat(path: Path, refuse: Refuse) -> Content:
    from scipy.io import loadmat

    with opened(path) as stream:
        data = stream.read()
    check(data, refuse)  # SciPy reads the same bytes, even if the file changes
    variables = loadmat(io.BytesIO(data), simplify_cells=True)
    own = variables.pop("blocks", {})
    own = own if isinstance(own, dict) else {}
    variables = variables if own else opened_saves(variables, refuse)
    metadata = parsed(str(own.get("json", "{}")), refuse)
    spelled = own.get("names", {})
    time = next((name for name in (*TIMES, TOUT) if name in variables), None)
    if time is None:
        raise refuse("has no variable 'time'.")
    t = _numbers(variables.pop(time), time, refuse).reshape(-1)
    sizes = sizes_of(metadata, refuse)[1]
    names: list[str] = []
    columns: list[Array] = [t]
    for variable, value in variables.items():
        if variable.startswith("__"):
            continue
        name, block = str(spelled.get(variable, variable)), _numbers(value, variable, refuse)
        size = sizes.get(name)
        if block.ndim < 2 and block.size == len(t) * (size or 1):  # SciPy drops dimensions of 1
            block = block.reshape((len(t), size) if size else t.shape)
        if block.ndim not in (1, 2) or len(block) != len(t):
            shape = " x ".join(map(str, block.shape)) or "1"
            raise refuse(f"the variable {legible(variable)!r} is {shape}, but there are {len(t)} times.")
        if block.ndim == 2:
            names += [f"{name}[{i}]" for i in range(block.shape[1])]
            sizes[name] = block.shape[1]
            columns += list(block.T)
        else:
            names.append(name)
            columns.append(block)
    metadata["sizes"] = sizes
    return without_twins(names, refuse), np.column_stack(columns), {}, metadata


def _numbers(value: object, name: str, refuse: Refuse) -> Array:
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "biuf":
        raise refuse(f"the variable {legible(name)!r} does not hold real numbers.")
    return numbers.astype(float)
