"""Rows drawn from what is varied: moments, grids, seeds, and what is refused."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from scipy import stats

from blocks import Diagram, Distribution, LogUniform, Normal, Triangular, TruncatedNormal, Uniform, UsageError, each
from blocks.studies import statistics
from blocks.studies.sampling import Rows, rows_of, seed_of, unit_points

DIAGRAMS = Path(__file__).resolve().parents[2] / "diagrams"
LAWS = {
    "normal": (Normal(3, 0.5), stats.norm(3, 0.5)),
    "uniform": (Uniform(-1, 2), stats.uniform(-1, 3)),
    "log": (LogUniform(1, 100), stats.loguniform(1, 100)),
    "triangle": (Triangular(0, 1, 4), stats.triang(0.25, 0, 4)),
    "cut": (TruncatedNormal(1, 0.2, low=0.9), stats.truncnorm(-0.5, math.inf, 1, 0.2)),
    "lognormal": (Distribution("lognorm", s=0.3, scale=2), stats.lognorm(0.3, scale=2)),
}


def drawn(vary: Any, n: int | None = None, sampler: str = "random", seed: int = 1) -> Rows:
    return rows_of(vary, n=n, sampler=sampler, seed=seed, expand=lambda name: [name.replace("*", k) for k in "ab"])


@pytest.mark.parametrize("sampler", ["random", "sobol", "halton", "lhs", "saltelli"])
def test_samples_have_the_moments_of_their_distributions(sampler: str) -> None:
    n = 4096
    rows = drawn({name: law for name, (law, _) in LAWS.items()}, n, sampler)
    assert rows.n == (n if sampler != "saltelli" else n * (len(LAWS) + 2))
    for name, (_, law) in LAWS.items():
        column = rows.columns[name]
        mean, variance, _, kurtosis = (float(x) for x in law.stats("mvsk"))
        # Five standard errors of random rows, which the other samplers keep with ease.
        assert column.mean() == pytest.approx(mean, abs=5 * math.sqrt(variance / n)), name
        bound = 5 * variance * math.sqrt((kurtosis + 2) / n)
        assert column.var() == pytest.approx(variance, abs=bound), name
        assert stats.kstest(column[:n], law.cdf).statistic < 1.95 / math.sqrt(n), name  # one draw in 1000 is beyond
    table = np.column_stack(list(rows.columns.values()))[:n]
    ranks = stats.spearmanr(table).statistic - np.eye(len(LAWS))
    assert np.abs(ranks).max() < 5 / math.sqrt(n), "columns are independent"


def test_even_samplers_have_a_point_in_each_stratum() -> None:
    n = 1024
    for sampler in ("random", "sobol", "halton", "lhs"):
        points, _ = unit_points(n, 3, sampler, 5)
        assert points.min() > 0.0
        assert points.max() < 1.0
        if sampler in ("sobol", "lhs"):
            np.testing.assert_array_equal(np.sort((points * n).astype(int), axis=0), np.arange(n)[:, None] + [0, 0, 0])
        if sampler == "halton":  # base 3 in the second dimension: 1024 of its points lie evenly in 3^6 intervals
            assert set(np.bincount((points[:, 1] * 729).astype(int))) == {1, 2}


def test_more_rows_keep_those_that_were_there() -> None:
    for sampler in ("random", "sobol", "halton"):
        few, many = drawn({"a": Normal(0, 1)}, 16, sampler), drawn({"a": Normal(0, 1)}, 64, sampler)
        np.testing.assert_array_equal(few.columns["a"], many.columns["a"][:16])
        assert not np.array_equal(few.columns["a"], drawn({"a": Normal(0, 1)}, 16, sampler, seed=2).columns["a"])


def test_sobol_points_that_are_not_even_are_told_and_nothing_else_warns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [fault.code for fault in drawn({"a": Uniform(0, 1)}, 1000, "sobol").warnings] == ["W503"]
        assert not drawn({"a": Uniform(0, 1)}, 1024, "sobol").warnings


def test_lists_make_a_grid_and_are_crossed_with_the_draws() -> None:
    grid = drawn({"a": [1, 2, 3], "b": ["x", "y"]})
    assert grid.n == 6
    assert grid.columns["a"].tolist() == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    assert grid.columns["b"].tolist() == ["x", "y"] * 3
    crossed = drawn({"a": Normal(0, 1), "k": np.linspace(1, 3, 3)}, 1000)
    assert crossed.n == 3000
    np.testing.assert_array_equal(crossed.columns["k"], np.repeat([1.0, 2.0, 3.0], 1000))
    np.testing.assert_array_equal(crossed.columns["a"], np.tile(crossed.columns["a"][:1000], 3))
    assert list(crossed.columns) == ["a", "k"]
    assert drawn({}, 7).n == 7, "runs that differ in their seeds alone"


def test_each_draws_a_value_for_each_and_a_pattern_one_for_all() -> None:
    rows = drawn({each("motor_*.Ra"): Uniform(0, 1), "motor_*.n": Uniform(0, 1)}, 8)
    assert list(rows.columns) == ["motor_a.Ra", "motor_b.Ra", "motor_*.n"]
    assert not np.array_equal(rows.columns["motor_a.Ra"], rows.columns["motor_b.Ra"])


def test_tables_are_taken_as_they_are() -> None:
    frame = pandas.DataFrame({"a": [1, 2], "b": [True, False]})
    for table in (frame, frame.to_dict("records")):
        rows = drawn(table)
        assert rows.columns["a"].tolist() == [1.0, 2.0]
        assert rows.columns["b"].tolist() == [True, False]


def test_seeds_of_rows_are_fixed_for_all_time() -> None:
    assert [seed_of(1, 0), seed_of(1, 1), seed_of(2, 0)] == [782636965681290, 2344597681463036, 2315932927185169]
    seeds = {seed_of(seed, i) for seed in range(20) for i in range(500)}
    assert len(seeds) == 10_000
    assert max(seeds) < 2**53


@pytest.mark.parametrize(
    ("vary", "n", "sampler", "said"),
    [
        ({"a": Normal(0, -1)}, 4, "random", "E501 .*no values for these parameters: the deviation -1 is not above 0"),
        ({"a": Uniform(30, 10)}, 4, "random", "these parameters: 30 is not below 10. Give LOW before HIGH"),
        ({"a": Distribution("lognrm", s=1)}, 4, "random", "no such continuous distribution. Did you mean 'lognorm'"),
        ({"a": Distribution("lognorm", r=1)}, 4, "random", "has other parameters: s, loc, scale"),
        ({"a": Triangular(1, 1, 1)}, 4, "random", "has no values"),
        ({"a": Normal(0, 1)}, None, "random", "n: is missing: the number of rows to draw for a"),
        ({"a": 3}, None, "random", "does not give values"),
        ({"a": "123"}, None, "random", "does not give values"),
        ({"a": []}, None, "random", "has no values"),
        ({"a": [1], each("*"): [2]}, None, "random", "a: appears twice"),
        ({"a": Normal(0, 1)}, 4, "sobl", "is not a sampler. Did you mean 'sobol'"),
        ({"a": Normal(0, 1)}, 100, "saltelli", "must be a power of 2, not 100. n=64 makes 192 rows"),
        ({"a": [1, 2]}, 64, "saltelli", "needs a distribution"),
        ({"a": Normal(0, 1)}, 0, "random", "n: must be an integer above 0"),
        ({"a": Normal(0, 1)}, 10**13, "random", "n: asks for"),
        ([{"a": 1}, {"b": 1}], None, "random", "a table whose rows have the same names"),
        ([{"a": 1}], 4, "random", "the table gives the rows"),
    ],
)
def test_what_cannot_be_drawn_is_refused(vary: Any, n: int | None, sampler: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        drawn(vary, n, sampler)


def test_distributions_are_light_values() -> None:
    code = "import sys, blocks; blocks.Normal(1, 2); assert 'scipy' not in sys.modules and 'pandas' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert Normal(1, 2) == Normal(1, 2)
    assert len({Normal(1, 2), Normal(1.0, 2), Uniform(1, 2)}) == 2


# --- statistics ------------------------------------------------------------------------------------------------


def test_the_indices_of_the_ishigami_function_are_the_known_ones() -> None:
    n, a, b = 4096, 7.0, 0.1
    rows = drawn({name: Uniform(-math.pi, math.pi) for name in ("x", "y", "z")}, n, "saltelli")
    x, y, z = rows.columns.values()
    values = np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x)
    indices = statistics.sobol_indices(values, rows.base, 3)
    # Ishigami and Homma, 1990.
    v1, v2 = 0.5 * (1 + b * math.pi**4 / 5) ** 2, a**2 / 8
    v13 = b**2 * math.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    for index, first, whole in zip(indices, (v1, v2, 0), (v1 + v13, v2, v13), strict=True):
        assert index.first == pytest.approx(first / total, abs=0.01)
        assert index.total == pytest.approx(whole / total, abs=0.01)
        assert 0 < index.first_error < 0.05
    theirs = stats.sobol_indices(
        func={"f_A": values[None, :n], "f_B": values[None, n : 2 * n], "f_AB": values[2 * n :].reshape(3, 1, n)}, n=n
    )
    np.testing.assert_allclose([index.first for index in indices], theirs.first_order, rtol=1e-12)
    np.testing.assert_allclose([index.total for index in indices], theirs.total_order, rtol=1e-12)


def test_rows_without_a_number_do_not_count() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=100), rng.normal(size=100)
    y[5] = np.nan
    kept = np.arange(100) != 5
    assert statistics.correlation(x, y) == pytest.approx(stats.pearsonr(x[kept], y[kept]).statistic, rel=1e-12)
    spearman = statistics.correlation(x, y, by_rank=True)
    assert spearman == pytest.approx(stats.spearmanr(x[kept], y[kept]).statistic, rel=1e-12)
    assert math.isnan(statistics.correlation(x, np.ones(100)))
    assert statistics.quantiles(y, np.array([0.5]))[0] == np.median(y[kept])
    assert np.isnan(statistics.quantiles(np.full((3, 2), np.nan), np.array([0.5]))).all()


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize(
    ("law", "plain"),
    [
        (Normal("160 mOhm", "10 mOhm"), Normal(160, 10)),
        (Normal("160 mOhm", {"value": 0.01, "unit": "Ohm"}), Normal(160, 10)),
        (Uniform("150 mOhm", "0.17 Ohm"), Uniform(150, 170)),
        (LogUniform("1 mOhm", "1 Ohm"), LogUniform(1, 1000)),
        (Triangular("1 mOhm", "2 mOhm", "5 mOhm"), Triangular(1, 2, 5)),
        (TruncatedNormal("160 mOhm", "10 mOhm", high="180 mOhm"), TruncatedNormal(160, 10, high=180)),
        (Distribution("lognorm", s=0.3, scale="160 mOhm"), Distribution("lognorm", s=0.3, scale=160)),
    ],
)
def test_numbers_of_distributions_have_units_in_python(law: Distribution, plain: Distribution) -> None:
    points = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(law.ppf(points), plain.ppf(points), rtol=1e-14)
    assert (law.unit, plain.unit) == ("mOhm", "")
    diagram = Diagram.load(DIAGRAMS / "motor_pid.json")
    options: dict[str, Any] = {"n": 3, "seed": 5, "measures": [], "stop": 0.01}
    sweep, other = diagram.sweep({"motor.Ra": law}, **options), diagram.sweep({"motor.Ra": plain}, **options)
    np.testing.assert_allclose(sweep.varied["motor.Ra"], 1e-3 * other.varied["motor.Ra"], rtol=1e-14)
    assert (sweep.units["motor.Ra"], list(sweep.status)) == ("Ohm", ["ok"] * 3)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Normal("160 mOhm", 10), "E501 Normal: '10' needs a unit, because others have one."),
        (lambda: Uniform("1 V", "2 A"), "E501 Uniform: .*different quantities"),
        (lambda: Uniform("low", "high"), "E501 Uniform: 'low' is not a number."),
        (lambda: Triangular(0, None, 1), "E501 Triangular: 'None' is not a number."),
        (lambda: Normal("20 degC", "2 K"), "E501 Normal: .*different zeros"),
        (lambda: Normal("20 mops", "2 mops"), "E501 Normal: '20 mops' is not a number."),
        (lambda: Distribution("lognorm", s="1 V", scale="2 V"), "E501 lognorm: '1 V' must be a number without a unit."),
        (lambda: Distribution("norm", loc=[1]), "E501 norm: '\\[1\\]' is not a number."),
    ],
)
def test_numbers_of_distributions_that_do_not_fit_are_refused(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        make()
