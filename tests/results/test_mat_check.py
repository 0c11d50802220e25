"""MAT files, checked before SciPy reads them: damage that ended the process is refused, and sound files are read."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from blocks import Results, UsageError
from blocks.results import mat_check
from blocks.text.errors import Fault
from tests.support.places import ROOT

DOUBLE, INT32, UINT32, INT8, UINT16, MATRIX, COMPRESSED = 9, 5, 6, 1, 4, 14, 15
CELL, STRUCT, CHAR, NUMBERS = 1, 2, 4, 6
COMPLEX = 1 << 11
TIMES = (0.0, 1.0, 2.0)


# --- files made by hand, as the format's description has them --------------------------------------------------------


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    return struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(kind: int, shape: tuple[int, ...], name: str, *content: bytes, order: str = "<") -> bytes:
    flags = element(UINT32, struct.pack(f"{order}II", kind, 0), order)
    sizes = element(INT32, struct.pack(f"{order}{len(shape)}i", *shape), order)
    return element(MATRIX, flags + sizes + element(INT8, name.encode(), order) + b"".join(content), order)


def doubles(*values: float, kind: int = DOUBLE, order: str = "<") -> bytes:
    return element(kind, struct.pack(f"{order}{len(values)}d", *values), order)


def file(*content: bytes, order: str = "<") -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + (b"\x00\x01IM" if order == "<" else b"\x01\x00MI") + b"".join(content)


def compressed(content: bytes) -> bytes:
    data = zlib.compress(content)
    return struct.pack("<II", COMPRESSED, len(data)) + data


def nested(depth: int) -> bytes:
    """A number in a cell in a cell ..."""
    made, number = b"", matrix(NUMBERS, (1, 1), "", doubles(1.0))
    head = len(matrix(CELL, (1, 1), ""))
    for size in range(len(number) + (depth - 1) * head, len(number) - head, -head):
        inside = matrix(CELL, (1, 1), "")
        made += struct.pack("<II", MATRIX, len(inside) - 8 + size) + inside[8:]
    return made + number


TIME = matrix(NUMBERS, (3, 1), "time", doubles(*TIMES))
LENGTH = struct.pack("<HHi", INT32, 4, 4)

CRASHED = {
    "a type that is none": (
        file(matrix(NUMBERS, (3, 1), "time", doubles(*TIMES, kind=8))),
        "cannot be read: its numbers have the unknown type 8.",
    ),
    "a type beyond all": (
        file(matrix(NUMBERS, (3, 1), "time", doubles(*TIMES, kind=0xFFFF))),
        "cannot be read: its numbers have the unknown type 65535.",
    ),
    "the same, compressed": (
        file(compressed(matrix(NUMBERS, (3, 1), "time", doubles(*TIMES, kind=8)))),
        "cannot be read: its numbers have the unknown type 8.",
    ),
    "an imaginary part": (
        file(matrix(NUMBERS | COMPLEX, (3, 1), "time", doubles(*TIMES), doubles(*TIMES, kind=8))),
        "cannot be read: its numbers have the unknown type 8.",
    ),
    "a text without dimensions": (
        file(TIME, matrix(CHAR, (), "c", element(UINT16, b"a\0"))),
        "cannot be read: a matrix has wrong dimensions.",
    ),
    "cells in cells": (
        file(TIME, nested(20_000)),
        "nests cells and structs more than 64 deep.",
    ),
    "a sparse matrix": (
        file(TIME, matrix(5, (3, 1), "z", element(8, bytes(4)), element(INT32, bytes(8)), doubles(*TIMES))),
        "holds a sparse matrix, which results cannot contain. Save only numbers, text, structs and cells.",
    ),
}
"""What SciPy 1.17 ends the process on, and what is said instead."""

REFUSED = {
    "another order": (file()[:126] + b"XX" + TIME, "is not a MAT file."),
    "a version": (file()[:125] + b"\x07IM" + TIME, "is a MAT file of the unknown version 7."),
    "no matrix": (file(doubles(1.0)), "cannot be read: a matrix is missing or incomplete."),
    "a matrix that is cut off": (
        file(TIME)[:-8],
        "cannot be read: a matrix is missing or incomplete.",
    ),
    "half a tag": (file(TIME) + b"\0\0\0\0", "cannot be read: an element is incomplete."),
    "data beyond the matrix": (
        file(matrix(NUMBERS, (3, 1), "time", struct.pack("<II", DOUBLE, 4096)), TIME),
        "cannot be read: an element is larger than what holds it.",
    ),
    "fewer numbers": (
        file(matrix(NUMBERS, (4, 1), "time", doubles(*TIMES))),
        "cannot be read: the number of elements of a matrix does not match its header.",
    ),
    "a negative size": (
        file(matrix(NUMBERS, (-3, -1), "time", doubles(*TIMES))),
        "cannot be read: a size is negative.",
    ),
    "sizes beyond all": (
        file(TIME, matrix(CELL, (2**30, 2**30), "c")),
        "cannot be read: a matrix has wrong dimensions.",
    ),
    "more than it says": (
        file(matrix(NUMBERS, (3, 1), "time", doubles(*TIMES), doubles(1.0))),
        "cannot be read: the size of a matrix does not match its header.",
    ),
    "no flags": (file(element(MATRIX, doubles(1.0))), "cannot be read: a matrix has no flags."),
    "names without length": (
        file(TIME, matrix(STRUCT, (1, 1), "s", element(INT32, bytes(4)), element(INT8, b"abc\0"))),
        "cannot be read: the fields of a struct have no names.",
    ),
    "a name without end": (
        file(TIME, matrix(STRUCT, (1, 1), "s", LENGTH, element(INT8, b"abcdefgh"), TIME, TIME)),
        "cannot be read: a field's name does not end.",
    ),
    "a class": (file(TIME, matrix(99, (1, 1), "c")), "cannot be read: a matrix has the unknown class 99."),
    "an object": (
        file(TIME, matrix(3, (1, 1), "o")),
        "holds an object, which results cannot contain. Save only numbers, text, structs and cells.",
    ),
    "packed nonsense": (
        file(struct.pack("<II", COMPRESSED, 8) + b"nonsense"),
        "cannot be read: a compressed matrix cannot be unpacked.",
    ),
    "packed in part": (
        file(struct.pack("<II", COMPRESSED, 40) + compressed(TIME)[8:48]),
        "cannot be read: a matrix is missing or incomplete.",
    ),
}

READ = """
import sys
from pathlib import Path
from blocks import Results, UsageError
for path in map(Path, sys.argv[1:]):
    try:
        print(path.stem, list(Results.load(path)), flush=True)
    except UsageError as error:
        print(path.stem, str(error).removeprefix(f"E503 {path}: "), flush=True)
"""


def in_a_process(files: dict[str, bytes], folder: Path) -> dict[str, str]:
    """What reading files says, by name; a process that ends before its time fails here."""
    for name, data in files.items():
        (folder / f"{name.replace(' ', '_')}.mat").write_bytes(data)
    paths = [str(folder / f"{name.replace(' ', '_')}.mat") for name in files]
    ran = subprocess.run(
        [sys.executable, "-X", "utf8", "-W", "ignore", "-c", READ, *paths],
        cwd=ROOT, capture_output=True, text=True, encoding="utf-8", timeout=120, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, f"after {ran.stdout}: {ran.stderr}"
    lines = (line.partition(" ") for line in ran.stdout.splitlines())
    return {name.replace("_", " "): said for name, _, said in lines}


def test_a_damaged_mat_file_is_refused_and_does_not_end_the_process(tmp_path: Path) -> None:
    cases = CRASHED | REFUSED
    told = in_a_process({name: data for name, (data, _) in cases.items()}, tmp_path)
    assert told == {name: said for name, (_, said) in cases.items()}


def test_many_damaged_mat_files_end_no_process(tmp_path: Path) -> None:
    """Bytes that stand for types, classes and sizes are the small ones."""
    draw = np.random.default_rng(7)
    files = {}
    for k in range(300):
        packed = k % 3 == 0
        data = bytearray(b"".join(VARIETY) if packed else file(*VARIETY))
        for _ in range(draw.integers(1, 4)):
            data[draw.integers(0 if packed else 120, len(data))] = draw.choice([draw.integers(0, 24), 0, 128, 255])
        files[str(k)] = file(compressed(bytes(data))) if packed else bytes(data)
    assert len(in_a_process(files, tmp_path)) == 300


def test_compressed_matrices_unpack_to_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.mat"
    path.write_bytes(file(compressed(TIME), compressed(matrix(NUMBERS, (3, 1), "x", doubles(3.0, 4.0, 5.0)))))
    assert Results.load(path)["x"].tolist() == [3.0, 4.0, 5.0]
    monkeypatch.setattr(mat_check, "MOST_UNPACKED", 2 * len(TIME) - 1)
    with pytest.raises(UsageError, match=r"E503 .*unpacks to more than \d+ bytes\. Save it with -v6 in MATLAB\."):
        Results.load(path)


# --- sound files -----------------------------------------------------------------------------------------------------

LONG = "a_field_whose_name_is_as_long_as_MATLAB_allows_it_63_characters"
VARIETY = (
    TIME,
    matrix(CELL, (1, 2), "c", matrix(CHAR, (1, 2), "", element(UINT16, b"a\0b\0")), element(MATRIX, b"")),
    matrix(STRUCT, (1, 1), "s", LENGTH, element(INT8, b"one\0two\0"), TIME, matrix(NUMBERS, (0, 5), "", doubles())),
    matrix(NUMBERS | COMPLEX, (1, 2), "z", doubles(1.0, 2.0), doubles(3.0, 4.0)),
)


def refuse(message: str, cure: str = "") -> UsageError:
    return UsageError(Fault("E503", "x.mat", message, cure))


@pytest.mark.parametrize("do_compression", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "bool"])
def test_numbers_of_every_kind_are_read(kind: str, do_compression: bool, tmp_path: Path) -> None:
    path, block = tmp_path / "x.mat", (np.arange(6).reshape(3, 2) % 2).astype(kind)
    savemat(path, {"time": np.array(TIMES), "x": block}, do_compression=do_compression)
    read = Results.load(path)
    assert read.t.tolist() == list(TIMES)
    assert np.array_equal(read["x"], block)


@pytest.mark.parametrize("do_compression", [False, True])
def test_what_scipy_writes_passes(do_compression: bool) -> None:
    records = np.array([(1.0, "q"), (2.0, "r")], dtype=[("u", object), ("v", object)])
    variables: dict[str, Any] = {
        "z": np.array([1.0, 2.0j]), "z4": np.array([1.0, 2.0j], "c8"), "empty": np.zeros((0, 70_000)),
        "cube": np.zeros((2, 3, 4), "i2"), "word": "Drehzahl in s⁻¹", "words": np.array(["ab", "cd"]), "none": "",
        "cells": np.array([1.0, "x", {"k": 2}, np.array([[]])], dtype=object), "records": records,
        "s": {LONG: 1.0, "inner": {"deeper": {"text": "x" * 500}}}, "nothing": {}, "yes": True,
    }  # fmt: skip
    stream = io.BytesIO()
    savemat(stream, variables, long_field_names=True, do_compression=do_compression)
    mat_check.check(stream.getvalue(), refuse)
    read = loadmat(stream, simplify_cells=True)
    assert read["s"][LONG] == 1.0


def test_a_big_endian_file_is_read(tmp_path: Path) -> None:
    path, order = tmp_path / "x.mat", ">"
    time = matrix(NUMBERS, (3, 1), "t", doubles(*TIMES, order=order), order=order)
    # The small form of an element: size, then type, in halves of four bytes.
    bytes_ = struct.pack(">HH4s", 3, 2, bytes([7, 8, 9]))
    path.write_bytes(file(time, matrix(9, (3, 1), "x", bytes_, order=order), order=order))
    read = Results.load(path)
    assert read.t.tolist() == list(TIMES)
    assert read["x"].tolist() == [7.0, 8.0, 9.0]


def test_files_made_by_hand_pass_where_they_are_sound() -> None:
    for data in (file(), file(*VARIETY), file(*map(compressed, VARIETY)), file(TIME, nested(64))):
        mat_check.check(data, refuse)
        loadmat(io.BytesIO(data))
    with pytest.raises(UsageError, match="more than 64 deep"):
        mat_check.check(file(nested(65)), refuse)


def test_a_file_of_version_4_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    savemat(path, {"time": np.array(TIMES), "x": np.array([3.0, 4.0, 5.0])}, format="4")
    assert Results.load(path)["x"].tolist() == [3.0, 4.0, 5.0]


@pytest.mark.parametrize("name", ["\x1b[2J", "x" * 4000])
def test_a_name_of_a_damaged_file_is_shown_safely(name: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    for content in (matrix(CHAR, (1, 1), name, element(UINT16, b"a\0")), matrix(NUMBERS, (1, 1), name, doubles(1.0))):
        path.write_bytes(file(TIME, content))
        with pytest.raises(UsageError) as caught:
            Results.load(path)
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 500
