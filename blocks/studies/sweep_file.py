"""Files of sweeps: Parquet, a row for each run; and the part of one that is under way.

Columns: `number`, `scenario`, what was varied, the measures, `status`, `message`, `steps`, `seed`, and of each signal a
list of numbers for each row, time after time. The key `blocks` of the schema's metadata holds the times of these, the
scenarios, and what the sweep is of; each column has its `unit`, `name` and `kind`. A part has the same columns: chunks
of rows in an Arrow IPC stream, as `results.arrow` keeps those of runs.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..host.plain_files import opened
from ..model.raw_values import raw_of
from ..results.arrow import PartFile, chunks_of, created, part_of, target_of
from ..results.provenance import Origin
from ..results.table import Refuse, optional, parsed, refusal, unique
from ..text.arrays import Array
from ..text.atomic_write import known_ending, refused, write_atomically
from ..text.errors import Fault, UsageError
from ..text.printable import legible, one_line

FORMAT, VERSION = "blocks sweep", 1
PARTIAL = "a partial sweep file"


def check_target(target: str | Path) -> None:
    """Refuse a file that could not be written once all rows are done. Raises UsageError (E501, E504)."""
    known_ending(target, (".parquet",), "sweeps")
    optional("pyarrow", legible(str(target)))
    if os.path.isdir(target):
        raise refused(target, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))


def write(path: str | Path, sweep: Mapping[str, Any], told: Mapping[str, Any] | None = None) -> None:
    """Write a sweep, by its fields. told: what it is of, for the metadata. Raises UsageError (E501, E504)."""
    known_ending(path, (".parquet",), "sweeps")
    optional("pyarrow", legible(str(path)))
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_batches([_rows_of(sweep, told or {})])
    with write_atomically(path) as stream:
        pq.write_table(table, stream.buffer, write_page_checksum=True)


def read(path: str | Path) -> dict[str, Any]:
    """The fields of the sweep of a file, of the part of one, or of a folder of files that workers wrote.

    Raises UsageError (E503, E504).
    """
    optional("pyarrow", legible(str(path)))
    import pyarrow as pa
    import pyarrow.parquet as pq

    refuse = refusal(path)
    if os.path.isdir(path):
        return _read_folder(Path(path), refuse)
    try:
        with opened(path) as stream:
            if target_of(path) is None:
                table = pq.ParquetFile(stream, page_checksum_verification=True).read()
            else:
                schema, chunks = chunks_of(stream, lambda schema: _notes(schema, refuse), refuse, PARTIAL)
                table = pa.Table.from_batches([batch for batch, _, _ in chunks], schema)
        return _sweep_of(table, refuse)
    except UsageError:
        raise
    except (pa.ArrowException, OSError, LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise refuse(f"is not a sweep file: {one_line(said).rstrip(' .')}.") from None


def _read_folder(folder: Path, refuse: Refuse) -> dict[str, Any]:
    """The rows of all files of a folder, in their order; those that are missing are left out."""
    files = sorted(folder.glob("rows-*.parquet"))
    if not files:
        raise refuse("holds no rows of a sweep (rows-*.parquet).", "Name a file, or a folder that workers wrote.")
    pieces = [read(file) for file in files]
    first = next((piece for piece in pieces if len(piece["t"])), pieces[0])
    shapes = {name: values.shape[1:] for name, values in first["signals"].items()}
    for file, piece in zip(files, pieces, strict=True):
        if not len(piece["t"]):  # none of its rows was run
            piece["signals"] = {name: np.full((len(piece["number"]), *shape), np.nan) for name, shape in shapes.items()}
            piece["t"] = first["t"]
        is_same = all(list(piece[key]) == list(first[key]) for key in ("varied", "measures", "signals", "scenarios"))
        if not (is_same and piece["name"] == first["name"] and np.array_equal(piece["t"], first["t"])):
            raise refuse(f"holds files of several sweeps: {file.name} differs.", "Load a single file of the folder.")
    number, scenario = (np.concatenate([piece[key] for piece in pieces]) for key in ("number", "scenario"))
    _, rows = np.unique(np.stack([scenario, number]), axis=1, return_index=True)

    def joined(columns: list[Array]) -> Array:
        made = np.concatenate(columns)[rows]
        is_plain = made.dtype == object and all(type(item) is float for item in made)
        return made.astype(float) if is_plain else made

    whole = dict(first)
    for key in ("scenario", "number", "seeds", "status", "steps"):
        whole[key] = joined([piece[key] for piece in pieces])
    for key in ("varied", "measures", "signals"):
        whole[key] = {name: joined([piece[key][name] for piece in pieces]) for name in first[key]}
    messages = [message for piece in pieces for message in piece["messages"]]
    whole["messages"] = tuple(messages[k] for k in rows.tolist())
    whole["interrupted"] = any(piece["interrupted"] for piece in pieces)
    return whole


def read_rows(stream: BinaryIO, path: str, told: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a piece of a sweep, but for its signals. Raises UsageError (E506) where it is none of this one."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    refuse = _in_the_way(path)
    try:
        file = pq.ParquetFile(stream)
        _check_same(_notes(file.schema_arrow, refuse), told, refuse)
        names = [field.name for field in file.schema_arrow if field.metadata[b"kind"] != b"signal"]
        return _sweep_of(file.read(columns=names), refuse)
    except (pa.ArrowException, OSError) as error:
        raise refuse(f"is not a sweep file: {one_line(str(error)).rstrip(' .')}.") from None


def _check_same(notes: Mapping[str, Any], told: Mapping[str, Any], refuse: Refuse) -> None:
    """Refuse what is there of another sweep."""
    was, ours = _key(notes), _key(json.loads(json.dumps(told)))
    different = [name for name in sorted({*was, *ours}) if was.get(name) != ours.get(name)]
    if different:
        if "n" in different and "varied rows" in different:
            different.remove("varied rows")  # they are others with another n
        cure = (
            "Repeat the call with which it was started, or replace the file (restart=True, --restart)."
        )
        raise refuse(f"belongs to a sweep that differs in its {', '.join(different)}.", cure)


def _in_the_way(path: str | Path) -> Refuse:
    cure = "Move the file away, or name another file."
    return refusal(path, "E506", "cannot be continued, because it ", cure)


def _rows_of(sweep: Mapping[str, Any], told: Mapping[str, Any]) -> Any:
    """The rows of a sweep as a record batch of Arrow."""
    import pyarrow as pa

    count = len(sweep["number"])
    names = np.array(sweep["scenarios"] or ("",), dtype=object)
    columns: list[tuple[str, str, Any]] = [
        ("number", "", pa.array(sweep["number"])),
        ("scenario", "", pa.array(names[sweep["scenario"]], pa.string())),
        ("status", "", pa.array(sweep["status"].astype(object), pa.string())),
        ("message", "", pa.array(sweep["messages"], pa.string())),
        ("steps", "", pa.array(sweep["steps"])),
        ("seed", "", pa.array(sweep["seeds"])),
    ]
    for kind, table in (("varied", sweep["varied"]), ("measure", sweep["measures"])):
        for name, column in table.items():
            is_plain = column.dtype.kind == "f"
            texts = None if is_plain else [json.dumps(raw_of(item)) for item in column.tolist()]
            columns.append((name, kind, pa.array(column) if is_plain else pa.array(texts, pa.string())))
    for name, values in sweep["signals"].items():
        flat = np.ascontiguousarray(values).reshape(count, -1)
        offsets = pa.array(np.arange(count + 1, dtype=np.int64) * flat.shape[1])
        columns.append((name, "signal", pa.LargeListArray.from_arrays(offsets, pa.array(flat.reshape(-1)))))
    fields = []
    # A measure may be called as a parameter is.
    for key, (name, kind, column) in zip(unique((c[0] for c in columns), longest=1000), columns, strict=True):
        unit = sweep["units"].get(name, "") if kind else ""
        fields.append(pa.field(key, column.type, metadata={"name": name, "kind": kind, "unit": unit}))
    shapes = {name: list(values.shape[2:]) for name, values in sweep["signals"].items()}
    notes = {
        "format": FORMAT, "version": VERSION, "diagram": sweep["name"], "scenarios": list(sweep["scenarios"]),
        "base": sweep["base"], "warnings": [[f.code, f.place, f.message, f.cure] for f in sweep["warnings"]],
        "t": sweep["t"].tolist(), "shapes": shapes, **({"lanes": sweep["lanes"]} if sweep.get("lanes") else {}), **told,
    }  # fmt: skip
    schema = pa.schema(fields, metadata={"blocks": json.dumps(notes)})
    return pa.RecordBatch.from_arrays([column for _, _, column in columns], schema=schema)


def _sweep_of(table: Any, refuse: Refuse) -> dict[str, Any]:
    """The fields of the sweep of a table of Arrow."""
    notes = _notes(table.schema, refuse)
    units: dict[str, str] = {}
    kinds: dict[str, dict[str, Array]] = {"": {}, "varied": {}, "measure": {}, "signal": {}}
    for field, column in zip(table.schema, table.columns, strict=True):
        name, kind = field.metadata[b"name"].decode(), field.metadata[b"kind"].decode()
        if field.metadata[b"unit"]:
            units[name] = field.metadata[b"unit"].decode()
        if kind == "signal":
            numbers = [np.empty(0), *(chunk.flatten().to_numpy() for chunk in column.chunks)]
            made = np.concatenate(numbers).reshape(len(table), len(notes["t"]), *notes["shapes"][name])
        elif field.type == "string":
            texts = column.to_pylist()
            made = np.empty(len(table), dtype=object)
            made[:] = [json.loads(text) for text in texts] if kind else texts
        else:
            made = column.to_numpy().copy()
        kinds[kind][name] = made
    plain = kinds[""]
    scenarios = tuple(notes["scenarios"])
    index = {name: k for k, name in enumerate(scenarios)}
    return {
        "name": str(notes["diagram"]),
        "varied": kinds["varied"],
        "units": units,
        "scenarios": scenarios,
        "scenario": np.array([index.get(name, 0) for name in plain["scenario"]], dtype=np.int64),
        "number": plain["number"],
        "seeds": plain["seed"],
        "status": plain["status"].astype("<U8"),
        "messages": tuple(plain["message"].tolist()),
        "steps": plain["steps"],
        "measures": kinds["measure"],
        "t": np.array(notes["t"], dtype=float),
        "signals": kinds["signal"],
        "interrupted": bool((plain["status"] == "left").any()),
        "base": int(notes["base"]),
        "warnings": tuple(Fault(*each) for each in notes["warnings"]),
        "lanes": str(notes.get("lanes", "")),
    }


def _notes(schema: Any, refuse: Refuse) -> dict[str, Any]:
    notes = parsed((schema.metadata or {}).get(b"blocks", b"{}"), refuse)
    if notes.get("format") != FORMAT:
        raise refuse("is not a sweep file.", "To read the results of one run, use Results.load.")
    if notes.get("version") != VERSION:
        raise refuse(f"has the version {notes.get('version')}, but this release of blocks reads version {VERSION}.")
    return notes


def told_of(origin: Origin | None, key: Mapping[str, Any]) -> dict[str, Any]:
    """What a sweep is of, for the metadata of its files. origin: of a run; key: what else the rows follow from."""
    texts = {name: repr(value) for name, value in key.items()}
    return {"origin": {} if origin is None else origin.told(), "key": texts}


def _key(told: Mapping[str, Any]) -> dict[str, Any]:
    """By what a sweep is known again, as messages name it."""
    origin = told.get("origin", {})
    known = {name: origin.get(name) for name in ("settings", "parameters", "inputs", "equations", "values")}
    known |= {"diagram": origin.get("sha256"), "release of blocks": origin.get("versions", {}).get("blocks")}
    return {**known, **told.get("key", {})}


class SweepPart(PartFile):
    """The file of a sweep that is under way.

    told: what it is of. restart: replace a part that is there. found: the fields of the chunks that are there.
    Raises UsageError: E501 where it cannot be written, E504, E506 where it is of another sweep.
    """

    def __init__(self, target: str | Path, told: Mapping[str, Any], *, restart: bool) -> None:
        check_target(target)
        path = part_of(target)
        super().__init__(path, created(path))
        self.target, self.told = target, told
        try:
            self.found = self._pieces(restart) if os.fstat(self.stream.fileno()).st_size else []
        except BaseException:
            self.stream.close()
            raise

    def _pieces(self, restart: bool) -> list[dict[str, Any]]:
        """The chunks that are there already, where they are of this sweep."""
        import pyarrow as pa

        refuse = _in_the_way(self.path)
        schema, chunks = chunks_of(self.stream, lambda schema: _notes(schema, refuse), refuse, PARTIAL)
        if restart:
            return []
        _check_same(_notes(schema, refuse), self.told, refuse)
        pieces = []
        for batch, _, self.length in chunks:
            pieces.append(_sweep_of(pa.Table.from_batches([batch]), refuse))
        return pieces

    def add(self, sweep: Mapping[str, Any]) -> None:
        """Write rows that are done, by the fields of a sweep. Raises UsageError (E501)."""
        self.add_batch(_rows_of(sweep, self.told))

    def end(self, sweep: Mapping[str, Any]) -> None:
        """Write the whole file. The part goes, unless the sweep was interrupted and can go on from it."""
        write(self.target, sweep, self.told)
        if not sweep["interrupted"]:
            self.path.unlink(missing_ok=True)

    def close(self) -> None:
        """Release the part, so that another sweep may continue it; remove one without rows."""
        with suppress(OSError):  # the failed write was reported already
            if not os.fstat(self.stream.fileno()).st_size:
                self.path.unlink(missing_ok=True)
        super().close()
