"""Rows in the formats of Arrow: Parquet files, and the parts that runs, sweeps and tunings leave while they go on.

    FILE.parquet.part     an Arrow IPC stream: the schema of the Parquet file, and chunks of rows, each with a note:
                          the CRC-32 of its columns, and of a run the state from which it goes on after the chunk

A chunk counts if all of it is there: the rows that a killed process has left can be read, and continued, up to the
last whole chunk. Columns of a run are `time` and one for each recorded element, as in the Parquet file.
"""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ..host.locks import hold
from ..host.plain_files import opened
from ..text.arrays import Array
from ..text.atomic_write import real, refused
from ..text.errors import Fault, UsageError, did_you_mean
from ..text.printable import legible, one_line
from .table import TIMES, Content, FileTable, Refuse, optional, parsed, refusal, unique, versioned, without_twins

if TYPE_CHECKING:
    from pyarrow import Buffer, RecordBatch, Schema

PART = ".part"
END = 8
"""Bytes of the mark at the end of an IPC stream, which a part does not have."""
GROUP = 2**22
"""Numbers of a row group of a Parquet file, of which so many are in memory at once."""


class Window:
    """What is read of a file: signals by name (None: all), and times from start to stop in s, both included."""

    def __init__(self, signals: Sequence[str] | None, start: float | None, stop: float | None) -> None:
        self.signals = [signals] if isinstance(signals, str) else signals
        self.start, self.stop = -math.inf if start is None else float(start), math.inf if stop is None else float(stop)
        if not self.start <= self.stop:
            message = f"the window ends at {self.stop:g} s, before it begins at {self.start:g} s."
            raise UsageError(Fault("E501", "start", message, "Give a start before the stop."))

    def columns(self, names: Sequence[str], place: str) -> list[int]:
        """The places of the elements that are read. Raises UsageError (E501) for a signal that is not there."""
        if self.signals is None:
            return list(range(len(names)))
        picked: set[int] = set()
        for signal in self.signals:
            found = [k for k, name in enumerate(names) if signal in (name, name.partition("[")[0])]
            if not found:
                cure = did_you_mean(signal[:200], names) or f"Signals: {', '.join(names[:20])}."
                raise UsageError(Fault("E501", place, f"holds no signal {legible(signal)!r}.", cure))
            picked.update(found)
        return sorted(picked)

    def rows(self, t: Array) -> slice:
        """Which rows of non-decreasing times are read."""
        if (self.start == -math.inf and self.stop == math.inf) or not np.all(t[1:] >= t[:-1]):  # which is refused later
            return slice(0, len(t))
        return slice(int(np.searchsorted(t, self.start, "left")), int(np.searchsorted(t, self.stop, "right")))


# --- writing -----------------------------------------------------------------------------------------------------


def schema_of(table: FileTable) -> Schema:
    """The schema of the files of a table, with units, names and metadata."""
    import pyarrow as pa

    described = table.described()
    elements = [("time", "s"), *((name, unit) for name, unit, _ in table.named())]
    # Parquet allows two columns of one name, but hardly any reader does; an input of a diagram may be called time.
    columns = unique((name for name, _ in elements), longest=1000)
    fields = [
        pa.field(column, pa.float64(), metadata={"unit": unit, "signal": name})
        for column, (name, unit) in zip(columns, elements, strict=True)
    ]
    # pandas.read_parquet makes PANDAS_ATTRS the frame's attrs.
    notes = {"blocks": json.dumps(versioned(described)), "PANDAS_ATTRS": json.dumps(described)}
    return pa.schema(fields, metadata=notes)


def write_parquet(stream: object, table: FileTable) -> None:
    """Write a Parquet file; of rows that lie in a part or a file, a group at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = schema_of(table)
    if isinstance(table.values, Stored):
        pieces: Iterable[object] = table.values.tables(schema)
    else:
        columns = [table.t, *(values for _, _, values in table.elements())]
        pieces = [pa.Table.from_arrays([pa.array(np.ascontiguousarray(c)) for c in columns], schema=schema)]
    rows = max(1, GROUP // len(schema))
    waiting, is_empty = schema.empty_table(), True
    with pq.ParquetWriter(stream, schema, write_page_checksum=True) as writer:
        for piece in pieces:
            waiting = pa.concat_tables([waiting, piece])
            while len(waiting) > rows:
                writer.write_table(waiting.slice(0, rows).combine_chunks(), row_group_size=rows)
                waiting, is_empty = waiting.slice(rows), False
        if len(waiting) or is_empty:
            writer.write_table(waiting.combine_chunks(), row_group_size=rows)


def part_of(target: str | Path) -> Path:
    """Return the part of a Parquet file that is being written."""
    return Path(f"{real(Path(target))}{PART}")


def target_of(path: object) -> str | None:
    """Return the Parquet file that a part belongs to; None if the path is not that of a part."""
    text = os.fspath(path) if isinstance(path, (str, Path)) else ""
    return text[: -len(PART)] if text.lower().endswith(f".parquet{PART}") else None


class PartFile:
    """A part that is open for more chunks, and locked as long as it is open.

    length: the bytes up to the end of its last whole chunk; 0 if nothing is written.
    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.stream, self.length = path, stream, 0

    def add_batch(self, batch: RecordBatch, state: bytes | None = None) -> None:
        """Write a chunk, and the state after it. Raises UsageError (E501)."""
        notes = {"crc32": str(checksum(batch)), **({} if state is None else {"state": base64.b64encode(state)})}
        header = header_of(batch.schema)
        try:
            if not self.length:
                self._write(header, 0)
            self._write(_stream_of(batch.schema, batch, notes)[len(header) : -END], self.length)
        except OSError as error:
            raise refused(self.path, error) from None

    def _write(self, message: Any, at: int) -> None:
        self.stream.seek(at)
        self.stream.truncate()  # what follows is no whole chunk
        self.stream.write(message)
        self.stream.flush()
        self.length = self.stream.tell()

    def close(self) -> None:
        """Release the part, so that another run may continue it."""
        with suppress(OSError):  # the failed write was reported already
            self.stream.close()


def created(path: Path) -> BinaryIO:
    """Open the part of a new run, over the part of an earlier one. Raises UsageError (E501)."""
    try:
        return held(path, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise refused(path, error) from None


def held(path: Path, flags: int) -> BinaryIO:
    """Open a file that no other process writes. Raises UsageError (E501), OSError."""
    flags |= getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
    while True:
        stream = open(os.open(path, flags, 0o666), "r+b")  # noqa: SIM115 - it stays open
        if not hold(stream.fileno()):
            stream.close()
            cure = "Wait until it ends, or use another file."
            raise UsageError(Fault("E501", legible(str(path)), "is being written by another run.", cure))
        if os.fstat(stream.fileno()).st_nlink:
            return stream
        stream.close()  # the run that had it has just removed it


def header_of(schema: Schema) -> Buffer:
    """Return the bytes with which a part begins."""
    return _stream_of(schema, None)[:-END]


def _stream_of(schema: object, batch: object, notes: object = None) -> Any:
    """Return the bytes of an IPC stream of one batch, or of none."""
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        if batch is not None:
            writer.write_batch(batch, custom_metadata=notes)
    return memoryview(sink.getvalue())


def checksum(batch: RecordBatch) -> int:
    """Compute the CRC-32 of the columns of a batch: numbers, lists of numbers, texts."""
    import pyarrow as pa

    crc = 0
    for column in batch.columns:
        if pa.types.is_string(column.type):
            crc = zlib.crc32(json.dumps(column.to_pylist()).encode(), crc)
        else:
            crc = zlib.crc32((column.flatten() if pa.types.is_large_list(column.type) else column).to_numpy(), crc)
    return crc


class Part(PartFile):
    """The part of the file of a run, open for more rows: of a new run, or of one that goes on.

    state: what stands behind its last whole chunk (None: nothing).
    """

    def __init__(self, path: Path, stream: BinaryIO, schema: Schema) -> None:
        super().__init__(path, stream)
        self.schema, self.rows, self.first = schema, 0, math.nan
        self.state: bytes | None = None

    @classmethod
    def begun(cls, target: str | Path, table: FileTable, notes: Mapping[str, str]) -> Part:
        """Begin a new one over the part of an earlier run. Raises UsageError (E501).

        table: whose rows will follow. notes: more metadata.
        """
        path = part_of(target)
        schema = schema_of(table)
        part = cls(path, created(path), schema.with_metadata({**schema.metadata, **notes}))
        try:
            if os.fstat(part.stream.fileno()).st_size:
                _chunks(
                    part.stream, refusal(path, "E501", "would be replaced, but ", "Move it away, or use another file.")
                )
            part._write(header_of(part.schema), 0)
        except OSError as error:
            raise refused(path, error) from None
        return part

    @staticmethod
    def check_free(target: str | Path) -> None:
        """Raise UsageError (E501) where another run writes the part of a file."""
        path = part_of(target)
        with suppress(OSError):
            if path.exists():
                held(path, os.O_RDWR).close()

    @classmethod
    def found(cls, path: str | Path) -> Part:
        """Open one that a run has left. Raises UsageError: E506 where nothing can go on from it, E501, E504."""
        optional("pyarrow", legible(str(path)))
        refuse = refusal(path, "E506", otherwise="Start a new run.")
        try:
            opened(path).close()  # no device, no pipe
            stream = held(Path(path), os.O_RDWR)
        except OSError as error:
            raise refuse(f"cannot be read: {error.strerror or error}.") from None
        try:
            schema, chunks = _chunks(stream, refuse)
            part = cls(Path(path), stream, schema)
            for batch, state, part.length in chunks:
                part._count(batch.column(0).to_numpy(), state)
            if not part.rows:
                raise refuse("does not hold a complete chunk of rows.")
            if part.state is None:
                raise refuse("cannot be resumed: FMUs for Co-Simulation and coupled blocks have no saved state.")
        except BaseException:
            stream.close()
            raise
        return part

    @property
    def metadata(self) -> dict[str, Any]:
        found: dict[str, object] = json.loads(self.schema.metadata[b"blocks"])
        return found

    def add(self, rows: Array, state: bytes | None) -> None:
        """Write a chunk of rows (n, 1 + columns), and the state after it. Raises UsageError (E501)."""
        import pyarrow as pa

        columns = [pa.array(np.ascontiguousarray(column)) for column in rows.T]
        self.add_batch(pa.RecordBatch.from_arrays(columns, schema=self.schema), state)
        self._count(rows[:, 0], state)

    def _count(self, t: Array, state: bytes | None) -> None:
        self.first = self.first if self.rows else float(t[0])
        self.rows, self.state = self.rows + len(t), state

    def drop(self) -> None:
        """Remove it: the file that it was a part of is there."""
        self.path.unlink(missing_ok=True)
        self.close()

    __del__ = PartFile.close


# --- reading -----------------------------------------------------------------------------------------------------


def chunks_of(
    stream: BinaryIO, check: Callable[[Any], object], refuse: Refuse, what: str
) -> tuple[object, Iterator[tuple[object, bytes | None, int]]]:
    """Return the schema of a part, and its whole chunks: rows, the state after them, where they end.

    check: raises UsageError or ValueError for the schema of another file. what: the part, for messages.
    """
    import pyarrow as pa

    try:
        reader = pa.ipc.open_stream(stream)
        check(reader.schema)
    except UsageError:
        raise
    except (pa.ArrowException, ValueError, OSError) as error:
        raise refuse(f"is not {what}: {one_line(str(error)).rstrip(' .')}.") from None

    def chunks() -> Iterator[tuple[Any, bytes | None, int]]:
        while True:
            try:
                batch, notes = reader.read_next_batch_with_custom_metadata()
                batch.validate()
                if int(notes[b"crc32"]) != checksum(batch):
                    return
                state = base64.b64decode(notes[b"state"]) if b"state" in notes else None
            except (StopIteration, pa.ArrowException, OSError, ValueError, KeyError, TypeError):
                return  # it is not whole
            yield batch, state, stream.tell()

    return reader.schema, chunks()


def _chunks(stream: BinaryIO, refuse: Refuse) -> tuple[Any, Iterator[tuple[Any, bytes | None, int]]]:
    """Return the schema of the part of a run, and its whole chunks, as `chunks_of` does."""
    import pyarrow as pa

    def check(schema: Schema) -> None:
        metadata = schema.metadata or {}
        if b"blocks" not in metadata or any(field.type != pa.float64() for field in schema):
            raise ValueError("another program wrote it")
        parsed(metadata[b"blocks"], refuse)

    return chunks_of(stream, check, refuse, "a part of a result file")


def read_part(path: Path, refuse: Refuse, window: Window) -> Content:
    """The rows of a part, up to its last whole chunk."""
    import pyarrow as pa

    with opened(path) as stream:
        schema, chunks = _chunks(stream, refuse)
        tables = (pa.Table.from_batches([batch]) for batch, _, _ in chunks)
        names, data, units, metadata = _content(schema, tables, refuse, window)
    return names, data, units, {**metadata, "interrupted": True}


def read_parquet(path: Path, refuse: Refuse, window: Window) -> Content:
    """The rows of a Parquet file; of a window only what has to be read for it."""
    import pyarrow.parquet as pq

    with opened(path) as stream:
        file = pq.ParquetFile(stream, page_checksum_verification=True)  # where its pages have checksums
        return _content(file.schema_arrow, _groups(file, window), refuse, window)


def _groups(file: Any, window: Window) -> Iterator[object]:
    """The row groups that may hold rows of a window, one by one, with the columns that it needs."""
    names = [_name_of(field) for field in file.schema_arrow]
    at = next(k for k, name in enumerate(names) if name in TIMES)  # `_content` has looked for it
    columns = None
    if window.signals is not None:
        others = [name for k, name in enumerate(names) if k != at]
        needed = [(k if k < at else k + 1) for k in window.columns(others, "")]
        columns = [file.schema_arrow[k].name for k in (at, *needed)]
    for group in range(file.num_row_groups):
        known = file.metadata.row_group(group).column(at).statistics
        if known is not None and known.has_min_max and (known.max < window.start or known.min > window.stop):
            continue
        yield file.read_row_group(group, columns=columns)


def _name_of(field: Any) -> str:
    name: bytes = (field.metadata or {}).get(b"signal", field.name.encode())
    return name.decode()


def _content(schema: Schema, tables: Iterable[Any], refuse: Refuse, window: Window) -> Content:
    """What a file holds. tables: with all columns of its schema, or with those of the window."""
    import pyarrow as pa

    whole = schema.metadata or {}
    # A frame of `Results.to_pandas` that pandas wrote has the same in its attrs.
    metadata = parsed(whole.get(b"blocks") or whole.get(b"PANDAS_ATTRS") or b"{}", refuse)
    if b"blocks" not in whole and "engine" not in metadata:
        metadata = {}  # attrs of another program
    named = [(_name_of(field), field) for field in schema]
    for name, field in named:
        if not any(holds(field.type) for holds in (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)):
            raise refuse(f"the column {legible(name)!r} does not hold numbers.")
    at = next((k for k, (name, _) in enumerate(named) if name in TIMES), None)
    if at is None:
        raise refuse("has no column 'time'.")
    time = named.pop(at)[1]
    names = without_twins([name for name, _ in named], refuse)
    picked = [named[k] for k in window.columns(names, legible(str(metadata.get("diagram", "the file"))))]
    units = {name: field.metadata[b"unit"].decode() for name, field in picked if (field.metadata or {}).get(b"unit")}
    pieces = [np.empty((0, 1 + len(picked)))]
    for table in tables:
        rows = window.rows(_numbers(table, time.name))
        if rows.start < rows.stop:
            part = table.slice(rows.start, rows.stop - rows.start)
            pieces.append(np.column_stack([_numbers(part, field.name) for field in (time, *(f for _, f in picked))]))
    return [name for name, _ in picked], np.concatenate(pieces), units, metadata


def _numbers(table: Any, column: str) -> Array:
    import pyarrow as pa

    numbers: Array = table.column(column).cast(pa.float64()).to_numpy()  # a missing number is NaN
    return numbers


# --- rows that stay in their file --------------------------------------------------------------------------------


def _mark(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


class Stored:
    """The rows of a run that lie in a file, and are read when they are asked for: (rows, 1 + elements), time first.

    tail: rows that stand behind those of the part.
    """

    def __init__(self, part: Part, tail: Array) -> None:
        self.path, self.tail = part.path.absolute(), tail
        self.length, self.rows = part.length, part.rows + len(tail)
        self.span = (part.first, float(tail[-1, 0]))
        self._ends: tuple[Array, Array, Array, Array] | None = None
        self._mark: tuple[int, ...] | None = None  # by which the file is known again

    def moved(self, target: str | Path) -> None:
        """All rows are in a Parquet file now."""
        self.path, self.tail = Path(target).absolute(), self.tail[:0]
        self._mark = _mark(self.path)

    def _opened(self) -> Any:
        """The file. Raises UsageError (E501) where another one stands in its place, or none."""
        message = "no longer holds these results: it was removed or overwritten."
        fault = Fault("E501", legible(str(self.path)), message, "Use a separate file for each run.")
        if self._mark is not None and _mark(self.path) != self._mark:
            raise UsageError(fault)
        try:
            return opened(self.path)
        except OSError:
            raise UsageError(fault) from None

    def __call__(self) -> Array:
        """All values: (rows, elements)."""
        return self.block(1, self.tail.shape[1] - 1)

    def times(self) -> Array:
        return self.block(0, 1)[:, 0]

    def block(self, first: int, count: int) -> Array:
        """Columns: (rows, count)."""
        return np.concatenate([np.column_stack(piece) for piece in self.pieces(range(first, first + count))])

    def tables(self, schema: object) -> Iterator[Any]:
        """The rows piece by piece, as tables of a schema."""
        import pyarrow as pa

        for piece in self.pieces(range(self.tail.shape[1])):
            yield pa.Table.from_arrays([pa.array(np.ascontiguousarray(column)) for column in piece], schema=schema)

    def pieces(self, columns: Sequence[int]) -> Iterator[list[Array]]:
        """Some columns of the rows, piece by piece."""
        import pyarrow.parquet as pq

        with self._opened() as stream:
            if target_of(self.path):
                for batch, _, end in _chunks(stream, refusal(self.path))[1]:
                    yield [batch.column(k).to_numpy() for k in columns]
                    if end >= self.length:
                        break
            else:
                file = pq.ParquetFile(stream)
                names = [file.schema_arrow[k].name for k in columns]
                for group in range(file.num_row_groups):
                    table = file.read_row_group(group, columns=names)
                    yield [table.column(name).to_numpy() for name in names]
        if len(self.tail):
            yield [self.tail[:, k] for k in columns]

    def ends(self, times: Array) -> tuple[Array, Array, Array, Array]:
        """Least, largest and last value of each element (elements,), and those at times (times, elements)."""
        if self._ends is None:
            n = self.tail.shape[1] - 1
            low, high, end, at = np.full(n, np.inf), np.full(n, -np.inf), np.empty(n), np.empty((len(times), n))
            for t, *values in self.pieces(range(n + 1)):
                low = np.minimum(low, [column.min() for column in values])
                high = np.maximum(high, [column.max() for column in values])
                end = np.array([column[-1] for column in values])
                places = np.searchsorted(t, times, side="right") - 1
                for k in np.flatnonzero(places >= 0):
                    at[k] = [column[places[k]] for column in values]
            self._ends = low, high, end, at
        return self._ends
