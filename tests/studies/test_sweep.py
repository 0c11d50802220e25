"""Sweeps: the same bits in any order and after any interruption, and what becomes of rows that fail."""

from __future__ import annotations

import csv
import math
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from blocks import (
    Case,
    Constant,
    Diagram,
    FirstOrder,
    Gain,
    Integrator,
    ModelError,
    Noise,
    Normal,
    Power,
    Product,
    Step,
    Sweep,
    TransferFunction,
    Uniform,
    UsageError,
    each,
)
from blocks.studies import sweep_run
from blocks.studies.sampling import seed_of

pytestmark = pytest.mark.usefixtures("native")  # by the reference engine each call would begin processes
VARY: dict[Any, Any] = {"k": Normal(2.0, 0.3), "lag_*.T": [0.5, 1.0]}
asked: dict[str, Any] = {
    "n": 6, "seed": 3, "log": ["out.y"], "every": 0.25, "threads": 1, "engine": "native",
    "scenarios": {"quiet": {}, "loud": {"noise.deviation": 3}},
}  # fmt: skip


def noisy() -> Diagram:
    """Two lags behind noise, and a gain; peak and ITAE of what comes out."""
    diagram = Diagram("noisy")
    k = diagram.parameter("k", 2.0, unit="V")
    source = diagram.add("noise", Noise(period=0.1))
    first = diagram.add("lag_a", FirstOrder(T=0.5))
    second = diagram.add("lag_b", FirstOrder(T=0.5))
    out = diagram.add("out", Gain(k=k, unit="V"))
    diagram.wire(first.u, source.y)
    diagram.wire(second.u, first.y)
    diagram.wire(out.u, second.y)
    diagram.measure("top", "peak", out.y)
    diagram.measure("ITAE", "ITAE", out.y)
    diagram.settings(stop=1, method="rk4", step=0.05, log=["out.y"])
    return diagram


def assert_same(a: Sweep, b: Sweep) -> None:
    """All rows are equal, to the last bit."""
    pandas.testing.assert_frame_equal(a.to_pandas(), b.to_pandas(), check_exact=True)
    np.testing.assert_array_equal(a.t, b.t)
    assert list(a.signals) == list(b.signals)
    for name, values in a.signals.items():
        np.testing.assert_array_equal(values, b.signals[name])


@pytest.fixture(scope="module")
def whole() -> Sweep:
    made: Sweep = noisy().sweep(VARY, **asked)
    return made


def test_a_row_is_the_run_of_its_values_and_its_seed(whole: Sweep) -> None:
    assert len(whole) == 24
    assert whole.counts() == {"ok": 24}
    assert whole.signals["out.y"].shape == (24, 5)
    for i in (0, 7, 23):
        given = {"k": whole.varied["k"][i], **{f"lag_{x}.T": whole.varied["lag_*.T"][i] for x in "ab"}}
        if whole.scenario[i] == 1:
            given["noise.deviation"] = 3
        number = int(whole.number[i])
        results = noisy().run(parameters=given, seed=seed_of(3, number), every=0.25, engine="native")
        again = whole.single(i)
        for name, column in whole.measures.items():
            assert column[i] == results.measures[name] == again.measures[name]
        np.testing.assert_array_equal(whole.signals["out.y"][i], results["out.y"])
    quiet, loud = whole["quiet"], whole["loud"]
    np.testing.assert_array_equal(quiet.seeds, loud.seeds)
    np.testing.assert_array_equal(quiet.varied["k"], loud.varied["k"])
    assert loud.single(3).measures["top"] == whole.single(15).measures["top"]


def test_neither_order_nor_chunks_nor_threads_change_a_bit(whole: Sweep) -> None:
    batch = noisy().batch(
        list(whole.varied), log=["out.y"], every=0.25, engine="native", parameters={"noise.deviation": 3}
    )
    loud = whole["loud"]
    order = np.random.default_rng(1).permutation(12)
    table = np.column_stack(list(loud.varied.values()))
    for threads in (1, 2):
        for rows in (order, order[:5], order[11:]):
            made = batch(table[rows], seeds=loud.seeds[rows], threads=threads)
            np.testing.assert_array_equal(made.signals["out.y"], loud.signals["out.y"][rows])
            for name, column in loud.measures.items():
                np.testing.assert_array_equal(made.measures[name], column[rows])


def test_files_hold_all_of_a_sweep(whole: Sweep, tmp_path: Path) -> None:
    whole.save(tmp_path / "a.parquet")
    loaded = Sweep.load(tmp_path / "a.parquet")
    assert_same(loaded, whole)
    assert loaded.units["k"] == "V"
    assert loaded.scenarios == ("quiet", "loud")
    with pytest.raises(UsageError, match="does not contain the diagram"):
        loaded.single(0)
    frame = pandas.read_parquet(tmp_path / "a.parquet")
    np.testing.assert_array_equal(frame["ITAE"], whole.measures["ITAE"])
    np.testing.assert_array_equal(np.stack(frame["out.y"]), whole.signals["out.y"])


def test_a_table_of_a_sweep_is_csv_with_every_digit(whole: Sweep, tmp_path: Path) -> None:
    whole.to_csv(tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[:3] == ["scenario", "number", "status"]
    assert [row["scenario"] for row in rows] == [whole.scenarios[k] for k in whole.scenario]
    for name, column in {**whole.varied, **whole.measures, "seed": whole.seeds, "steps": whole.steps}.items():
        np.testing.assert_array_equal([float(row[name]) for row in rows], column)
    assert "out.y" not in rows[0]
    with pytest.raises(UsageError, match=r"E501 .*a\.txt: the ending '\.txt' is not a format of tables. Use \.csv"):
        whole.to_csv(tmp_path / "a.txt")


KILLED = """
import os, sys
sys.path.insert(0, {root!r})
from blocks.studies import sweep_run
from tests.studies.test_sweep import noisy, VARY, asked

sweep_run.CHUNK = 0.0  # a row at a time

def progress(done, total):
    if done > 13:
        os.kill(os.getpid(), {signal})
noisy().sweep(VARY, **asked, out={out!r}, progress=progress)
"""


def test_a_sweep_that_was_killed_goes_on_to_the_same_bytes(whole: Sweep, tmp_path: Path) -> None:
    root = str(Path(__file__).parents[2])
    out, other = tmp_path / "a.parquet", tmp_path / "b.parquet"
    code = KILLED.format(root=root, signal=int(signal.SIGKILL), out=str(out))
    assert subprocess.run([sys.executable, "-c", code], cwd=root).returncode == -signal.SIGKILL
    left = Sweep.load(f"{out}.part")
    assert 0 < len(left) < 24
    with open(f"{out}.part", "ab") as stream:
        stream.write(b"\xff\xff\xff\xff half a chunk")
    told: list[int] = []
    gone_on = noisy().sweep(VARY, **asked, out=out, progress=lambda done, total: told.append(done))
    assert told[0] == len(left)
    assert_same(gone_on, whole)
    noisy().sweep(VARY, **asked, out=other)
    assert out.read_bytes() == other.read_bytes()
    assert not list(tmp_path.glob("*.part"))


def interrupt(after: int) -> Callable[[int, int], None]:
    def progress(done: int, total: int) -> None:
        if done >= after:
            raise KeyboardInterrupt

    return progress


def test_ctrl_c_keeps_what_is_done_and_the_sweep_goes_on_from_it(
    whole: Sweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep_run, "CHUNK", 0.0)
    out = tmp_path / "a.parquet"
    half = noisy().sweep(VARY, **asked, out=out, progress=interrupt(9))
    assert half.interrupted
    assert half.counts()["left"] >= 14
    assert Sweep.load(out).interrupted
    assert_same(noisy().sweep(VARY, **asked, out=out), whole)
    assert not Sweep.load(out).interrupted
    assert not Path(f"{out}.part").exists()


def test_a_part_of_another_sweep_is_not_gone_on_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_run, "CHUNK", 0.0)
    out = tmp_path / "a.parquet"
    noisy().sweep(VARY, **asked, out=out, progress=interrupt(9))
    for change, word in (
        ({"seed": 4}, "varied rows"),
        ({"n": 5}, r"its n\. "),
        ({"every": 0.5}, "settings"),
        ({"scenarios": {"quiet": {}}}, "scenarios"),
        ({"measures": ["ITAE"]}, "measures"),
    ):
        with pytest.raises(UsageError, match=f"E506 .*differs in .*{word}"):
            noisy().sweep(VARY, **{**asked, **change}, out=out)
    anew = noisy().sweep(VARY, **{**asked, "seed": 4}, out=out, restart=True)
    assert anew.counts() == {"ok": 24}
    Path(f"{out}.part").write_text("not ours")
    with pytest.raises(UsageError, match="cannot be continued"):
        noisy().sweep(VARY, **asked, out=out, restart=True)
    assert Path(f"{out}.part").read_text() == "not ours"


def test_refused_rows_leave_the_others_untouched() -> None:
    bad = noisy().sweep({"lag_a.T": [0.5, -1.0, 0.7], "k": [1.0]}, engine="native")
    rows = [{"lag_a.T": T, "k": 1.0} for T in (0.5, 0.6, 0.7)]
    good = noisy().sweep(rows, engine="native")
    assert bad.status.tolist() == ["ok", "refused", "ok"]
    assert "lag_a.T" in bad.messages[1]
    assert np.isnan(bad.measures["top"][1])
    for i in (0, 2):
        assert bad.measures["top"][i] == good.measures["top"][i]
    assert "1 refused; for example row 1: E107 lag_a.T" in bad.table()


def test_each_has_a_column_for_each() -> None:
    sweep = noisy().sweep({each("lag_*.T"): Uniform(0.2, 0.4)}, n=3, engine="native")
    assert list(sweep.varied) == ["lag_a.T", "lag_b.T"]
    assert sweep.units["lag_a.T"] == "s"
    assert noisy().sweep({}, n=3, engine="native").measures["top"].std() > 0, "seeds alone"


def test_the_dataset_has_dimensions_and_units(whole: Sweep) -> None:
    pytest.importorskip("xarray")
    data = whole.to_xarray()
    assert data["out.y"].dims == ("scenario", "row", "time")
    assert data["out.y"].attrs["units"] == "V"
    assert data["k"].attrs["units"] == "V"
    np.testing.assert_array_equal(data["ITAE"].sel(scenario="loud"), whole["loud"].measures["ITAE"])
    np.testing.assert_array_equal(data["time"], whole.t)
    assert whole["loud"].to_xarray()["ITAE"].dims == ("scenario", "row")


def test_a_measure_may_be_called_as_a_parameter_is(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    diagram = noisy()
    diagram.measure("k", "peak", "out.y")
    diagram.measure("status", "peak", "out.y", stop=0.5)
    sweep = diagram.sweep({"k": [1.0, 2.0]}, engine="native")
    for table in (sweep.to_pandas(), sweep.to_xarray()):
        assert list(np.asarray(table["k"])) == [1.0, 2.0]
        assert list(np.asarray(table["k_2"])) == list(sweep.measures["k"])
        assert list(np.asarray(table["status"])) == ["ok", "ok"]
    sweep.save(tmp_path / "a.parquet")
    assert_same(Sweep.load(tmp_path / "a.parquet"), sweep)


def test_statistics_are_of_one_scenario(whole: Sweep) -> None:
    with pytest.raises(UsageError, match=r'sweep\["quiet"\].quantiles\(\)'):
        whole.quantiles()
    loud = whole["loud"]
    assert loud.quantiles("top", q=[0.5])["top"][0] == np.median(loud.measures["top"])
    assert loud.quantiles("out.y")["out.y"].shape == (3, 5)
    assert set(loud.correlations()) == {"top", "ITAE"}
    with pytest.raises(UsageError, match="not drawn for Sobol"):
        loud.sobol()
    with pytest.raises(KeyError, match=r"Did you mean 'loud'\? Scenarios: quiet, loud"):
        whole["lod"]
    with pytest.raises(KeyError, match="Did you mean 'top'"):
        loud.quantiles("topp")


def test_sobol_indices_of_a_diagram_that_multiplies() -> None:
    """y = a^2 * b, of a and b uniform in 0 ... 1: the shares of the variance follow from E and Var of a^2 and b."""
    diagram = Diagram("product")
    inner = diagram.add("b", Gain(k=1.0))
    diagram.wire(inner.u, diagram.add("one", Constant(value=1.0)).y)
    square = diagram.add("square", Power(exponent=2.0))
    diagram.wire(square.u, diagram.add("a", Constant(value=1.0)).y)
    product = diagram.add("product", Product())
    diagram.wire(product.u1, inner.y)
    diagram.wire(product.u2, square.y)
    diagram.measure("y", "peak", product.y)
    diagram.settings(stop=1, method="euler", step=1)
    vary = {"a.value": Uniform(0, 1), "b.k": Uniform(0, 1)}
    sweep = diagram.sweep(vary, n=1024, sampler="saltelli", engine="native")
    assert len(sweep) == 4096
    np.testing.assert_allclose(sweep.measures["y"], sweep.varied["a.value"] ** 2 * sweep.varied["b.k"], rtol=1e-12)
    e, v = (1 / 3, 1 / 2), (4 / 45, 1 / 12)  # of a^2 and of b
    whole = v[0] * v[1] + v[0] * e[1] ** 2 + v[1] * e[0] ** 2
    assert "variance of  from     first" in sweep.table()
    assert sweep.taken(np.arange(9)).base == 0
    few = diagram.sweep(vary, n=1, sampler="saltelli", engine="native").table()
    assert "nan" not in few
    assert "variance of  from     first  total\n" in few
    for name, k in (("a.value", 0), ("b.k", 1)):
        index = sweep.sobol()["y"][name]
        assert index.first == pytest.approx(v[k] * e[1 - k] ** 2 / whole, abs=0.03)
        assert index.total == pytest.approx((v[k] * e[1 - k] ** 2 + v[0] * v[1]) / whole, abs=0.03)


def test_what_is_not_installed_is_told_with_its_cure(
    whole: Sweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "xarray", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)
    for use in (whole.to_pandas, whole.to_xarray, lambda: whole.save(tmp_path / "a.parquet")):
        with pytest.raises(UsageError, match=r'E504 .* pip install \w+; or .* "\.\[tables\]"'):
            use()
    assert "quiet.ITAE" in whole.table()


def test_arguments_that_cannot_be_meant(tmp_path: Path) -> None:
    for given, said in (
        ({"scenarios": {"loud": {"k": 3}}}, "E501 k: varies from row to row, and has a value for all rows"),
        ({"scenarios": {"loud": 3}}, "scenarios.loud: must be a mapping from parameters to values"),
        ({"out": tmp_path / "a.csv"}, "E501 .*a.csv.*is not a format of sweeps. Use .parquet"),
        ({"measures": ["tip"]}, "no such measure. Did you mean 'top'"),
    ):
        with pytest.raises(UsageError, match=said):
            noisy().sweep(VARY, n=2, **given)


def test_values_with_units_are_numbers_in_that_of_the_parameter() -> None:
    given = [{"value": 1500, "unit": "mV"}, 2.5, {"value": 0.003, "unit": "kV"}]
    sweep = noisy().sweep({"k": given}, stop=0.2)
    assert sweep.varied["k"].tolist() == [1.5, 2.5, 3.0]
    assert sweep.units["k"] == "V"
    same = noisy().sweep({"k": [1.5, 2.5, 3.0]}, stop=0.2)
    np.testing.assert_array_equal(sweep.measures["ITAE"], same.measures["ITAE"])
    assert sweep.correlations()["ITAE"]["k"] > 0.9
    with pytest.raises(ModelError, match="E104 k: A and V are different quantities"):
        noisy().sweep({"k": [{"value": 1, "unit": "A"}]}, stop=0.2)


def test_values_with_units_are_in_si_where_the_parameter_has_no_unit_of_its_own() -> None:
    diagram = Diagram("lag")
    diagram.add("step", Step())
    diagram.add("lag", TransferFunction(num=[1.0], den=[1.0, 1.0]))
    diagram.wire("lag.u", "step.y")
    diagram.measure("peak", "peak", "lag.y")
    given = [{"value": 500, "unit": "ms"}, {"value": 2, "unit": "s"}]
    sweep = diagram.sweep({"lag.den[0]": given}, stop=1.0)
    assert sweep.varied["lag.den[0]"].tolist() == [0.5, 2.0]
    assert sweep.measures["peak"] == pytest.approx([1 - math.exp(-2), 1 - math.exp(-0.5)], rel=1e-5)
    with pytest.raises(ModelError, match=r"E104 lag\.den\[0\]: V and s are different quantities"):
        diagram.sweep({"lag.den[0]": [given[0], {"value": 1, "unit": "V"}]}, stop=1.0)


def test_the_files_of_a_folder_are_one_sweep(whole: Sweep, tmp_path: Path) -> None:
    for low, high in ((5, 24), (0, 5), (3, 8)):  # also rows that two files hold
        whole.taken(np.arange(low, high)).save(tmp_path / f"rows-0-{low:09d}-{high - 1:09d}.parquet")
    assert_same(Sweep.load(tmp_path), whole)
    noisy().sweep({"k": [1.0]}, stop=0.1).save(tmp_path / "rows-1-000000000-000000000.parquet")
    with pytest.raises(UsageError, match=r"E503 .*several sweeps: rows-1-.* differs"):
        Sweep.load(tmp_path)
    with pytest.raises(UsageError, match=r"E503 .*holds no rows of a sweep"):
        Sweep.load(tmp_path.parent / tmp_path.name / "..")


def test_inputs_from_a_file_and_from_arrays_are_those_of_all_rows(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    path.write_text("time,u\n0,0\n1,1\n", encoding="utf-8")
    diagram = Diagram("driven")
    area = diagram.add("area", Integrator())
    diagram.wire(area.u, diagram.input("u"))
    t, u = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    for inputs in (path, {"u": (t, u)}):
        sweep = diagram.sweep({"area.y_start": [1.0, 2.0]}, stop=1.0, log=["area.y"], inputs=inputs)
        assert sweep.signals["area.y"][:, -1] == pytest.approx([1.5, 2.5], rel=1e-9)


def test_a_scenario_may_be_a_case_with_variants_and_inputs(tmp_path: Path) -> None:
    diagram = noisy()
    diagram.input("r", default=1)
    diagram.add("more", Gain(k=1))
    diagram.wire("more.u", "r")
    diagram.measure("more_top", "peak", "more.y")
    diagram.swap("lag_b", Gain(), variant="none")
    diagram.swap("out", Gain(k="=2*k"), variant="twice")
    base = {"lag_b": "base", "out": "base"}
    scenarios = {
        "plain": Case(variants=base),
        "short": Case(variants={**base, "lag_b": "none"}, inputs={"r": 3}),
        "strong": Case(variants={**base, "out": "twice"}, parameters={"noise.deviation": 2}),
    }
    options: dict[str, Any] = {"n": 3, "seed": 5, "threads": 1}
    made = diagram.sweep({"lag_a.T": Uniform(0.3, 0.7)}, scenarios=scenarios, out=tmp_path / "s.parquet", **options)
    assert made.scenarios == ("plain", "short", "strong")
    for row in range(9):
        case = scenarios[made.scenarios[made.scenario[row]]]
        number = int(made.number[row])
        alone = diagram.run(
            case.updated(parameters={"lag_a.T": made.varied["lag_a.T"][row]}), seed=seed_of(5, number), log=[]
        )
        assert {name: column[row] for name, column in made.measures.items()} == dict(alone.measures)
    assert made["short"].measures["more_top"].tolist() == [3, 3, 3]
    again = diagram.sweep({"lag_a.T": Uniform(0.3, 0.7)}, scenarios=scenarios, out=tmp_path / "s.parquet", **options)
    assert_same(again, made)
    # Another input is another sweep: no row of the file is taken for it.
    scenarios["short"] = scenarios["short"].updated(inputs={"r": 4})
    other = diagram.sweep({"lag_a.T": Uniform(0.3, 0.7)}, scenarios=scenarios, out=tmp_path / "t.parquet", **options)
    assert other["short"].measures["more_top"].tolist() == [4, 4, 4]


@pytest.mark.parametrize(
    ("scenario", "said"),
    [
        (3, "must be a mapping from parameters to values, or a Case."),
        (Case(stop=2), "cannot have its own stop. Scenarios differ in parameters, inputs, interpolation, variants"),
        (Case(inputs="a.csv"), "has inputs from a file."),
        (Case(variants={"out": "long"}), "E122"),
    ],
)
def test_a_scenario_that_cannot_be_run_beside_others_is_refused(scenario: Any, said: str) -> None:
    with pytest.raises((UsageError, ModelError), match=said):
        noisy().sweep({"k": [1, 2]}, scenarios={"a": {}, "b": scenario})
