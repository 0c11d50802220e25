"""Result files: CSV, Parquet and MAT as other programs read them, and back; what is refused, and how."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.io import loadmat, savemat

from blocks import Constant, Diagram, Results, StateSpace, Step, UsageError
from blocks.results import files
from blocks.results.files import FORMATS, KEYWORDS, identifiers
from blocks.results.provenance import Origin
from blocks.results.results import Statistics

ORIGIN = Origin(
    sha256="ab12",
    versions={"blocks": "0.1.0"},
    settings={"start": 0.0, "stop": 2.0, "method": "rk4"},
    parameters={"motor.Ra": {"value": 200.0, "unit": "mOhm"}},
    inputs={"r.csv": {"sha256": "cd34"}},
)


def made() -> Results:
    """Three signals, one of them a vector, with a jump at t = 1 s."""
    t = np.array([0.0, 1.0, 1.0, 2.0])
    values = np.array(
        [[0.1, 1.0, -1.0, math.nan], [0.2, 1.0, -2.0, math.inf], [0.3, 5.0, -3.0, -0.0], [0.4, 5.0, -4.0, 5e-324]]
    )
    columns = {"motor.omega": (0, (), "rad/s"), "s.y": (1, (2,), "V"), "load.y": (3, (), "")}
    return Results("motor", t, values, columns, statistics=Statistics(method="rk4"), origin=ORIGIN)


def assert_same(one: Results, other: Results) -> None:
    """Equal bit by bit, NaN and the sign of zero included."""
    assert one.diagram == other.diagram
    assert one.origin == other.origin
    assert one.columns == other.columns
    assert one.t.tobytes() == other.t.tobytes()
    assert one.values.shape == other.values.shape
    both_nan = np.isnan(one.values) & np.isnan(other.values)
    assert np.all(both_nan | (one.values.view(np.int64) == other.values.view(np.int64)))


# --- what is in a file -----------------------------------------------------------------------------------------


def test_a_csv_file_says_what_it_is_in_comments(tmp_path: Path) -> None:
    made().save(tmp_path / "x.csv")
    assert (tmp_path / "x.csv").read_text(encoding="utf-8").splitlines() == [
        "# blocks results 1",
        '# diagram: "motor"',
        '# engine: "reference"',
        '# sha256: "ab12"',
        '# versions: {"blocks": "0.1.0"}',
        '# settings: {"start": 0.0, "stop": 2.0, "method": "rk4"}',
        '# parameters: {"motor.Ra": {"value": 200.0, "unit": "mOhm"}}',
        '# inputs: {"r.csv": {"sha256": "cd34"}}',
        '# units: {"motor.omega": "rad/s", "s.y": "V", "load.y": ""}',
        '# sizes: {"s.y": 2}',
        "time,motor.omega,s.y[0],s.y[1],load.y",
        "0.0,0.1,1.0,-1.0,nan",
        "1.0,0.2,1.0,-2.0,inf",
        "1.0,0.3,5.0,-3.0,-0.0",
        "2.0,0.4,5.0,-4.0,5e-324",
    ]


def test_pandas_reads_the_csv_file(tmp_path: Path) -> None:
    made().save(tmp_path / "x.csv")
    frame = pandas.read_csv(tmp_path / "x.csv", comment="#", index_col="time")
    # The default reader of older releases is off by a few ulp, and takes the least doubles for 0.
    pandas.testing.assert_frame_equal(frame, made().to_pandas(), rtol=1e-15, atol=1e-300)


def test_xarray_holds_each_signal_with_its_dimensions_and_its_unit() -> None:
    results = made()
    data = results.to_xarray()
    assert list(data.data_vars) == list(results.names)
    assert data["s.y"].dims == ("time", "s.y_1")
    assert data["s.y"].attrs["units"] == "V"
    assert "units" not in data["load.y"].attrs
    for name in results.names:
        np.testing.assert_array_equal(data[name].values, results[name])
    np.testing.assert_array_equal(data["time"].values, results.t)
    assert data.attrs["diagram"] == "motor"
    assert json.loads(data.attrs["parameters"]) == {"motor.Ra": {"value": 200.0, "unit": "mOhm"}}
    data["s.y"].values[0] = -1.0
    assert results["s.y"][0, 0] == 1.0  # the dataset is a copy


def test_pandas_reads_the_parquet_file(tmp_path: Path) -> None:
    made().save(tmp_path / "x.parquet")
    frame = pandas.read_parquet(tmp_path / "x.parquet")
    assert list(frame.columns) == ["time", "motor.omega", "s.y[0]", "s.y[1]", "load.y"]
    pandas.testing.assert_frame_equal(frame.set_index("time"), made().to_pandas(), check_exact=True)
    assert frame.attrs["units"] == {"motor.omega": "rad/s", "s.y": "V", "load.y": ""}
    assert frame.attrs["parameters"] == {"motor.Ra": {"value": 200.0, "unit": "mOhm"}}
    assert frame["time"].tolist() == [0.0, 1.0, 1.0, 2.0]


def test_a_parquet_file_has_units_and_origin_in_its_schema(tmp_path: Path) -> None:
    made().save(tmp_path / "x.parquet")
    schema = pq.read_schema(tmp_path / "x.parquet")
    told = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert told == {"time": "s", "motor.omega": "rad/s", "s.y[0]": "V", "s.y[1]": "V", "load.y": ""}
    whole = json.loads(schema.metadata[b"blocks"])
    assert (whole["format"], whole["version"], whole["diagram"]) == ("blocks results", 1, "motor")
    assert (whole["sha256"], whole["settings"]) == ("ab12", {"start": 0.0, "stop": 2.0, "method": "rk4"})


def test_scipy_reads_the_mat_file(tmp_path: Path) -> None:
    made().save(tmp_path / "x.mat")
    read = loadmat(tmp_path / "x.mat")
    assert {name for name in read if not name.startswith("__")} == {"time", "motor_omega", "s_y", "load_y", "blocks"}
    assert np.array_equal(read["time"], [[0.0], [1.0], [1.0], [2.0]])
    assert np.array_equal(read["motor_omega"], [[0.1], [0.2], [0.3], [0.4]])
    assert np.array_equal(read["s_y"], [[1.0, -1.0], [1.0, -2.0], [5.0, -3.0], [5.0, -4.0]])
    about = read["blocks"][0, 0]
    assert about["names"][0, 0]["motor_omega"] == ["motor.omega"]
    assert about["units"][0, 0]["s_y"] == ["V"]
    assert json.loads(about["json"][0])["sha256"] == "ab12"
    assert read["__header__"] == b"MATLAB 5.0 MAT-file, written by blocks"


@pytest.mark.parametrize("ending", FORMATS)
def test_the_same_run_gives_the_same_bytes(ending: str, tmp_path: Path) -> None:
    diagram = Diagram("twice")
    diagram.add("s", Step(at=0.5))
    for name in ("a", "b"):
        diagram.run(stop=1.0).save(tmp_path / f"{name}{ending}")
    assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()


@pytest.mark.parametrize("kind", ["bits", "edges", "decimals", "whole", "int", "bool"])
def test_pyarrow_writes_the_decimals_of_repr(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng, shape = np.random.default_rng(1), (5000, 4)
    bounds = np.concatenate([10.0 ** np.arange(-323, 309), 2.0 ** np.arange(-1074, 1024), [0.0, 1.0, np.nan, np.inf]])
    near = np.concatenate([bounds, np.nextafter(bounds, 0.0), np.nextafter(bounds[:-4], np.inf)])
    values = {
        "bits": rng.integers(0, 2**64, shape, dtype=np.uint64).view(float),
        "edges": rng.choice(np.concatenate([near, -near]), shape),
        "decimals": np.round(rng.standard_normal(shape), 3) * 10.0 ** rng.integers(-12, 19, shape),
        "whole": rng.integers(-(10**6), 10**6, shape) * 10.0 ** rng.integers(0, 14, shape),
        "int": rng.integers(-5, 5, shape),
        "bool": rng.integers(0, 2, shape) == 1,
    }[kind]
    results = Results("x", np.arange(5000) * 1e-3, values, {f"s{k}": (k, (), "") for k in range(4)})
    monkeypatch.setattr(files, "MANY", 1)
    stream = io.StringIO()
    results.write_csv(stream)
    rows = zip(results.t.tolist(), values.tolist(), strict=True)
    assert stream.getvalue().splitlines()[1:] == [",".join(map(repr, (t, *row))) for t, row in rows]


def test_pyarrow_reads_the_doubles_that_python_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(1).integers(0, 2**64, (5000, 2), dtype=np.uint64).view(float)
    path = tmp_path / "x.csv"
    Results("x", np.arange(5000.0), values, {"a": (0, (), "V"), "b": (1, (), "")}, origin=ORIGIN).save(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    monkeypatch.setattr(files, "MANY", 1)
    assert files._many_rows(path, path.read_bytes().index(b"b\n") + 2 - 3, 3) is not None
    read = Results.load(path)
    monkeypatch.setattr(files, "MANY", 2**40)
    assert_same(read, Results.load(path))


@pytest.mark.parametrize("line", ["3,nan(1)", "3,1_0", "3", "3,", "3,x", "3,4,5"])
def test_a_fault_in_a_large_csv_file_is_told_as_in_a_small_one(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.csv").write_text(f"# of another program\ntime,a\n0,1\n\n{line}\n4,5\n", encoding="utf-8")
    monkeypatch.setattr(files, "MANY", 1)
    with pytest.raises(UsageError, match=r"E503 .*: line 5 does not hold 2 numbers\."):
        Results.load(tmp_path / "x.csv")


# --- there and back --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", FORMATS)
def test_what_was_saved_comes_back_bit_by_bit(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"x{ending}"
    made().save(path)
    back = Results.load(path)
    assert_same(back, made())
    assert (back.statistics.method, back.statistics.engine) == ("rk4", "reference")
    back.save(tmp_path / f"again{ending}")
    assert (tmp_path / f"again{ending}").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("ending", [".CSV", ".Parquet", ".MAT"])
def test_the_case_of_an_ending_does_not_matter(ending: str, tmp_path: Path) -> None:
    made().save(tmp_path / f"x{ending}")
    assert_same(Results.load(tmp_path / f"x{ending}"), made())


SHAPES = st.lists(st.sampled_from([(), (1,), (2,), (3,)]), max_size=4)


@pytest.mark.parametrize("ending", FORMATS)
@settings(max_examples=30, deadline=None)
@given(shapes=SHAPES, rows=st.sampled_from([0, 1, 2, 3]), draw=st.data())
def test_any_shape_comes_back(
    ending: str, shapes: list[tuple[int, ...]], rows: int, draw: Any, tmp_path_factory: Any
) -> None:
    width = sum(shape[0] if shape else 1 for shape in shapes)
    values = draw.draw(arrays.arrays(float, (rows, width), elements=st.floats(allow_subnormal=True)))
    columns, first = {}, 0
    for index, shape in enumerate(shapes):
        columns[f"b.y{index}"] = (first, shape, "V" if index % 2 else "")
        first += shape[0] if shape else 1
    shown = Results("shapes", np.arange(rows) / 3.0, values, columns)
    path = tmp_path_factory.mktemp("shapes") / f"x{ending}"
    shown.save(path)
    assert_same(Results.load(path), shown)


@pytest.mark.parametrize("ending", FORMATS)
def test_one_element_of_a_vector_stays_one_signal(ending: str, tmp_path: Path) -> None:
    diagram = Diagram("element")
    diagram.add("s", StateSpace(A=[[0.0]], B=[[0.0]], C=[[1.0], [2.0]], x_start=[3.0]))
    diagram.add("u", Constant(value=0.0))
    diagram.wire("s.u[0]", "u.y")
    shown = diagram.run(stop=1.0, every=0.5, log=["s.y[1]", "u.y"])
    shown.save(tmp_path / f"x{ending}")
    back = Results.load(tmp_path / f"x{ending}")
    assert list(back) == ["s.y[1]", "u.y"]
    assert back["s.y[1]"].tolist() == [6.0] * 3


@pytest.mark.parametrize("ending", FORMATS)
def test_a_signal_may_be_called_time(ending: str, tmp_path: Path) -> None:
    columns = {"time": (0, (), "h"), "t": (1, (), "")}
    shown = Results("named", np.array([0.0, 1.0]), np.array([[7.0, 1.0], [8.0, 2.0]]), columns)
    path = tmp_path / f"x{ending}"
    shown.save(path)
    assert_same(Results.load(path), shown)
    if ending == ".parquet":
        assert list(pandas.read_parquet(path).columns) == ["time", "time_2", "t"]


def test_interrupted_results_stay_so(tmp_path: Path) -> None:
    shown = Results("cut", np.array([0.0]), np.array([[1.0]]), {"a.y": (0, (), "")}, interrupted=True)
    for ending in FORMATS:
        shown.save(tmp_path / f"x{ending}")
        assert Results.load(tmp_path / f"x{ending}").interrupted


# --- names for MATLAB ------------------------------------------------------------------------------------------


def test_variables_are_identifiers_each_once() -> None:
    long = "very.long." + "x" * 80
    names = ["a.b_c", "a_b.c", "_x", "2x.y", "end", "time", "blocks", "s.y[1]", "A.b_c", long + ".y", long + ".z", "é"]
    given = identifiers(names)
    assert list(given) == names
    assert list(given.values()) == [
        "a_b_c", "a_b_c_2", "x", "x2x_y", "end_2", "time_2", "blocks_2", "s_y_1", "A_b_c",
        "very_long_" + "x" * 53, "very_long_" + "x" * 51 + "_2", "x_2",
    ]  # fmt: skip
    for variable in given.values():
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", variable)
        assert variable not in KEYWORDS


def test_odd_names_come_back_from_a_mat_file(tmp_path: Path) -> None:
    long = "sub." * 30
    names = ["end", "a.b_c", "a_b.c", "_hidden.y", f"{long}y", f"{long}z"]
    columns = {name: (index, (), "m") for index, name in enumerate(names)}
    shown = Results("odd", np.array([0.0, 1.0]), np.arange(12.0).reshape(2, 6), columns)
    shown.save(tmp_path / "x.mat")
    assert_same(Results.load(tmp_path / "x.mat"), shown)


# --- tables of other programs ----------------------------------------------------------------------------------


def test_a_bare_csv_table_is_read(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(
        "# by a data logger, 3.5 kHz\n# version: 7\n# units: [1]\nt, w ,i\n0,1,2\n\n0.5,nan,4\n", encoding="utf-8"
    )
    read = Results.load(path)
    assert (read.diagram, list(read), read.origin) == ("measured", ["w", "i"], None)
    assert read["i"].tolist() == [2.0, 4.0]
    assert math.isnan(read["w"][1])
    assert read["i"].unit == ""


def test_a_frame_that_pandas_wrote_is_read_with_its_units(tmp_path: Path) -> None:
    made().to_pandas().to_parquet(tmp_path / "x.parquet")
    assert_same(Results.load(tmp_path / "x.parquet"), made())


def test_a_parquet_file_of_another_program_is_read(tmp_path: Path) -> None:
    table = pa.table({"n": pa.array([1, None, 3]), "time": pa.array([0, 1, 2]), "on": pa.array([True, False, True])})
    table = table.replace_schema_metadata({"PANDAS_ATTRS": '{"units": 3, "version": "2"}'})
    pq.write_table(table, tmp_path / "x.parquet")
    read = Results.load(tmp_path / "x.parquet")
    assert read.t.tolist() == [0.0, 1.0, 2.0]
    assert read["on"].tolist() == [1.0, 0.0, 1.0]
    assert np.array_equal(read["n"], [1.0, math.nan, 3.0], equal_nan=True)


def test_a_mat_file_of_another_program_is_read(tmp_path: Path) -> None:
    matrix = np.arange(6.0).reshape(3, 2)
    savemat(tmp_path / "x.mat", {"t": np.arange(3), "w": np.array([1.0, 2.0, 3.0]), "xy": matrix}, oned_as="row")
    read = Results.load(tmp_path / "x.mat")
    assert read.t.tolist() == [0.0, 1.0, 2.0]
    assert read["w"].tolist() == [1.0, 2.0, 3.0]
    assert np.array_equal(read["xy"], matrix)


# --- what is refused -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x.txt", "x.txt: the ending '.txt' is not a format of result files. Use .csv, .parquet or .mat."),
        ("x", "x: a name without ending is not a format of result files. Use .csv, .parquet or .mat."),
    ],
)
def test_another_ending_is_refused(name: str, said: str, tmp_path: Path) -> None:
    for verb in (made().save, Results.load):
        with pytest.raises(UsageError, match="E501") as caught:
            verb(tmp_path / name)
        assert str(caught.value).endswith(said)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_told_with_its_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pandas", "pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    path = tmp_path / "x.parquet"
    with pytest.raises(UsageError) as caught:
        made().save(path)
    assert str(caught.value) == (
        f"E504 {path}: this needs the package pyarrow, which is not installed. "
        'Install it: pip install pyarrow; or in a clone of blocks: pip install -e ".[tables]".'
    )
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(UsageError, match="E504 to_xarray: this needs the package xarray, which is not installed"):
        made().to_xarray()
    with pytest.raises(UsageError, match="E504 to_pandas: this needs the package pandas, which is not installed"):
        made().to_pandas()
    assert list(tmp_path.iterdir()) == []
    made().save(tmp_path / "x.csv")
    made().save(tmp_path / "x.mat")


BROKEN_CSV = [
    ("", "does not begin with a column 'time'. Begin the first line after comments with: time,NAME,..."),
    ("# blocks results 1\n", (
        "does not begin with a column 'time'. Begin the "
        "first line after comments with: time,NAME,..."
    )),
    ("x,y\n1,2\n", "does not begin with a column 'time'. Begin the first line after comments with: time,NAME,..."),
    ("# a\ntime,x\n0,1\n1\n", "line 4 does not hold 2 numbers."),
    ("time,x\n0,one\n", "line 2 does not hold 2 numbers."),
    ("time,x\n0,1\n1,1_000\n", "line 3 does not hold 2 numbers."),
    (
        '# blocks results 1\n# sizes: {"x": true}\ntime,x[0]\n0,1\n',
        "its entry sizes does not have the form that blocks writes. Correct or remove the entry sizes.",
    ),
    ("time,x,x\n0,1,2\n", "has two columns with the name 'x'."),
    ("time,x\n1,1\n0,2\n", "the times must be finite and must not decrease."),
    ("time,x\nnan,1\n", "the times must be finite and must not decrease."),
    (
        "# blocks results 2\ntime,x\n0,1\n",
        "is of version 2; this release reads version 1. Use a newer release of blocks.",
    ),
    (
        "# blocks results 1\n# units: [1]\ntime,x\n0,1\n",
        "its entry units does not have the form that blocks writes. Correct or remove the entry units.",
    ),
    (
        '# blocks results 1\n# sizes: {"x": "y"}\ntime,x\n0,1\n',
        "its entry sizes does not have the form that blocks writes. Correct or remove the entry sizes.",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), BROKEN_CSV)
def test_a_broken_csv_file_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        Results.load(path)
    assert str(caught.value) == f"E503 {path}: {said}"


def test_sizes_that_do_not_fit_the_columns_change_nothing(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    for sizes in ('{"x": 3}', '{"x": -1}', '{"x": 0}', '{"y": 2}'):
        path.write_text(f"# blocks results 1\n# sizes: {sizes}\ntime,x[0],x[1]\n0,1,2\n", encoding="utf-8")
        assert list(Results.load(path)) == ["x[0]", "x[1]"]


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_that_is_something_else_is_refused(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"x{ending}"
    with pytest.raises(UsageError, match=r"E503 .*: cannot be read: No such file or directory\."):
        Results.load(path)
    path.write_bytes(b"\x00\xff\xfe PAR1 nonsense" * 50)
    with pytest.raises(UsageError, match="E503"):
        Results.load(path)
    made().save(path)
    path.write_bytes(path.read_bytes()[:-40])
    if ending != ".csv":  # a table that ends early is a table
        with pytest.raises(UsageError, match=r"E503 .*cannot be read"):
            Results.load(path)


def test_a_parquet_file_with_a_bit_that_changed_is_refused_or_gives_the_same(tmp_path: Path) -> None:
    """The truth is what was written: no change of one bit in the file is read as other numbers."""
    t = np.arange(500) * 1e-3
    results = Results("d", t, np.sin(t)[:, np.newaxis], {"s.y": (0, (), "")}, statistics=Statistics(method="rk4"))
    path = tmp_path / "x.parquet"
    results.save(path)
    group = pq.ParquetFile(path).metadata.row_group(0)
    end = 4 + sum(group.column(k).total_compressed_size for k in range(2))  # of the pages; the schema follows
    written, refused = path.read_bytes(), 0
    for place in range(4, end, 37):
        path.write_bytes(written[:place] + bytes([written[place] ^ 16]) + written[place + 1 :])
        try:
            read = Results.load(path)
        except UsageError:
            refused += 1
        else:
            assert np.array_equal(read.t, t)
            assert np.array_equal(read["s.y"], np.sin(t))
    assert refused > 100


def test_a_parquet_file_of_others_with_and_without_checksums_is_read(tmp_path: Path) -> None:
    path, table = tmp_path / "x.parquet", pa.table({"time": [0.0, 1.0], "x": [1.0, 2.0]})
    for is_checked in (False, True):
        pq.write_table(table, path, write_page_checksum=is_checked)
        assert Results.load(path)["x"].tolist() == [1.0, 2.0]
    path.write_bytes(path.read_bytes().replace(np.array([1.0, 2.0]).tobytes(), np.array([1.0, 3.0]).tobytes()))
    with pytest.raises(UsageError, match=r"E503 .*(CRC|checksum)"):
        Results.load(path)


def test_columns_that_hold_no_numbers_are_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time": [0.0], "word": ["1.5"]}), tmp_path / "x.parquet")
    with pytest.raises(UsageError, match=r"E503 .*the column 'word' does not hold numbers\."):
        Results.load(tmp_path / "x.parquet")
    pq.write_table(pa.table({"x": [0.0]}), tmp_path / "x.parquet")
    with pytest.raises(UsageError, match=r"E503 .*has no column 'time'\."):
        Results.load(tmp_path / "x.parquet")


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"x": [1.0, 2.0]}, "has no variable 'time'."),
        ({"time": [0.0, 1.0], "x": [1.0, 2.0, 3.0]}, "the variable 'x' is 3, but there are 2 times."),
        ({"time": [0.0, 1.0], "x": np.ones((3, 2))}, "the variable 'x' is 3 x 2, but there are 2 times."),
        ({"time": [0.0, 1.0], "x": "text"}, "the variable 'x' does not hold real numbers."),
        ({"time": [0.0, 1.0], "x": [1.0, 2.0j]}, "the variable 'x' does not hold real numbers."),
        ({"time": [0.0], "x": [1.0], "blocks": {"json": "{"}}, "its metadata do not have the form that blocks writes."),
    ],
)
def test_a_mat_file_that_does_not_fit_is_refused(variables: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    savemat(path, variables)
    with pytest.raises(UsageError) as caught:
        Results.load(path)
    assert str(caught.value) == f"E503 {path}: {said}"


def test_a_mat_file_of_version_7_3_is_refused_with_its_cure(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    # The head that MATLAB puts in front of HDF5: version 0x0200.
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(116) + b"\0" * 8 + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + b"\0" * 500)
    with pytest.raises(
        UsageError, match=r"is a MAT file of version 7\.3, which blocks cannot read\. Save it with -v7 in MATLAB\."
    ):
        Results.load(path)


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_is_replaced_as_a_whole_or_not_at_all(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"x{ending}"
    path.write_text("old")

    def full(*arguments: Any, **options: Any) -> None:
        raise OSError(28, "No space left on device")

    broken = {".csv": "blocks.results.files.csv.writer", ".parquet": "pyarrow.parquet.ParquetWriter"}
    monkeypatch.setattr(broken.get(ending, "blocks.results.files._mat_bytes"), full)
    with pytest.raises(UsageError, match=r"E501 .*cannot be written: No space left on device\. Nothing was changed\."):
        made().save(path)
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


# --- pandas ----------------------------------------------------------------------------------------------------


def test_a_frame_has_times_as_its_index_and_units_in_its_attrs() -> None:
    shown = made()
    frame = shown.to_pandas()
    assert frame.index.name == "time"
    assert frame.index.tolist() == [0.0, 1.0, 1.0, 2.0]
    assert list(frame.columns) == ["motor.omega", "s.y[0]", "s.y[1]", "load.y"]
    assert frame.loc[1.0, "s.y[0]"].tolist() == [1.0, 5.0], "both sides of the jump"
    assert frame.attrs["units"] == {"motor.omega": "rad/s", "s.y": "V", "load.y": ""}
    assert frame.attrs["diagram"] == "motor"
    frame.iloc[0, 0] = 99.0
    assert shown["motor.omega"][0] == 0.1


def test_to_csv_writes_a_bare_table(tmp_path: Path) -> None:
    made().to_csv(tmp_path / "x.csv")
    with open(tmp_path / "x.csv", newline="") as stream:
        assert next(csv.reader(stream)) == ["time", "motor.omega", "s.y[0]", "s.y[1]", "load.y"]


def test_a_size_beyond_the_columns_makes_no_vector(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text('# blocks results 1\n# sizes: {"a": 100000000000000}\ntime,a[0]\n0,1\n')
    assert list(Results.load(path)) == ["a[0]"]
