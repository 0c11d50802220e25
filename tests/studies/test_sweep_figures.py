"""Figures and tables of sweeps: what they show of known rows, and what they say of those that failed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Constant, Diagram, FirstOrder
from blocks.results import plots
from blocks.studies.sampling import Uniform, values_text
from blocks.studies.statistics import correlation
from blocks.studies.sweep import Sweep
from blocks.studies.sweep_figures import column, plot
from blocks.text.errors import UsageError


def made(scenarios: tuple[str, ...] = (), n: int = 200) -> Sweep:
    """A sweep of known numbers; row 7 of each scenario diverged, row 8 ran out of its budget."""
    copies = max(1, len(scenarios))
    rng = np.random.default_rng(2)
    J, case = rng.normal(0.27, 0.02, n), np.array(["a", "b"] * (n // 2), dtype=object)
    t = np.linspace(0.0, 2.0, 41)
    status = np.full(n, "ok", dtype="<U8")
    status[7], status[8] = "diverged", "budget"
    y = J[:, None] * (1.0 - np.exp(-3.0 * t))
    y[7:9, 5:] = np.nan
    y[7, 4] = 1e6
    itae = np.where(status == "ok", 3.0 * J, np.nan)

    def each(values: Any) -> Any:
        return np.concatenate([values] * copies)

    return Sweep(
        "loop_$x", {"Jeq": each(J), "case": each(case)}, {"Jeq": "kg.m2", "ITAE": "m.s2", "plant.y": "m"}, scenarios,
        np.repeat(np.arange(copies), n), each(np.arange(n)), each(np.arange(n)), each(status), ("",) * n * copies,
        each(np.ones(n)), {"ITAE": each(itae), "_gm": each(np.where(J > 0.3, np.inf, J))}, t,
        {"plant.y": each(y), "eso.z": each(np.stack([y, 2 * y], -1))},
    )  # fmt: skip


def texts(figure: Any) -> str:
    import matplotlib.text

    return "\n".join(each.get_text() for each in figure.findobj(matplotlib.text.Text))


def test_bands_are_the_quantiles_of_the_rows_that_ran_and_failed_ones_are_seen_and_counted() -> None:
    sweep = made()
    figure = plot(sweep, ["plant.y", "eso.z[1]"], singles=2)
    first, second = figure.axes
    line = next(line for line in first.lines if line.get_label() == "median")
    good = sweep.signals["plant.y"][sweep.status == "ok"]
    assert np.allclose(line.get_ydata(), np.median(good, axis=0), rtol=1e-14)
    outer = first.collections[2].get_paths()[0].vertices  # after the two of the legend
    low, high = np.quantile(good[:, -1], [0.05, 0.95])
    assert np.isclose(outer[outer[:, 0] == 2.0, 1].min(), low)
    assert np.isclose(outer[outer[:, 0] == 2.0, 1].max(), high)
    assert first.get_ylim()[1] < 1.0  # the row that runs away does not squeeze the others
    shown = texts(figure)
    for said in ("200 runs, of which 1 diverged, 1 over the budget", "plant.y [m]", "eso.z[1]", "failed, up to its end",
                 "single runs", r"loop_\$x"):  # fmt: skip
        assert said in shown
    assert len([line for line in first.lines if line.get_linewidth() == 0.5]) == 2
    assert second.get_xlabel() == "time [s]"


def test_histograms_hold_all_rows_that_have_a_number_and_tell_the_others() -> None:
    sweep = made()
    figure = plot(sweep, "ITAE")
    (axis,) = figure.axes
    steps = [patch for patch in axis.patches if not patch.get_fill()]
    assert sum(sum(patch.get_data().values) for patch in steps) == 198
    assert "2 without a number" in texts(figure)
    share = plot(sweep, "ITAE", kind="ecdf").axes[0].lines[0].get_ydata()
    assert share[-1] == 198 / 200  # of all rows: a limit that 99 % keep is reached at 0.99


def test_scatter_marks_rows_without_a_number_where_they_lie() -> None:
    sweep = made()
    figure = plot(sweep, "ITAE", against=["Jeq", "case"], kind="scatter")
    first, second = figure.axes
    points, crosses = first.lines
    assert len(points.get_xdata()) == 198
    assert sorted(crosses.get_xdata()) == sorted(sweep.varied["Jeq"][7:9])
    assert "rank correlation 1.00" in texts(figure)
    assert correlation(sweep.varied["Jeq"], column(sweep, "ITAE"), by_rank=True) == 1.0
    assert [text.get_text() for text in second.get_xticklabels()] == ["a", "b"]


def test_one_outlier_does_not_take_the_colors_of_a_heat_map() -> None:
    x, y = (each.ravel() for each in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    gm = 1.0 + x
    for outlier, extend in ((5.0, "neither"), (1e6, "max")):
        gm[44] = outlier
        count = {name: np.arange(100) for name in ("number", "seeds", "steps")}
        sweep = replace(made(), varied={"b0": x, "omega_o": y}, measures={"gm": gm}, scenario=np.zeros(100, dtype=int),
                        status=np.full(100, "ok"), messages=("",) * 100, **count)  # fmt: skip
        mesh = plot(sweep, "gm", against=("b0", "omega_o")).axes[0].collections[0]
        assert (mesh.norm.vmin, mesh.norm.vmax, mesh.colorbar.extend) == (1.0, 10.0, extend)


@pytest.mark.parametrize("bins", [0, -3, 2.5, True, 10_000])
def test_a_number_of_bins_is_refused_where_it_is_none(bins: Any) -> None:
    with pytest.raises(UsageError, match="bins: must be an integer from 1 to 1000"):
        made().plot("ITAE", bins=bins)


@pytest.mark.parametrize("is_even", [True, False], ids=["ratios", "distances"])
def test_a_heat_map_has_a_cell_for_each_point_of_a_grid(is_even: bool) -> None:
    a, b = np.arange(1.0, 5.0), np.geomspace(1, 1000, 4) if is_even else np.array([1.0, 2.0, 4.0, 7.0])
    x, y = (each.ravel() for each in np.meshgrid(a, b))
    gm = x * np.log(y + 1)
    gm[3], gm[5] = np.nan, np.inf
    sweep = replace(made(), varied={"b0": x, "omega_o": y}, measures={"gm": gm}, scenario=np.zeros(16, dtype=int),
                    status=np.full(16, "ok"), number=np.arange(16))  # fmt: skip
    axis, *_ = plot(sweep, "gm", against=("b0", "omega_o")).axes
    mesh = axis.collections[0]
    shown = np.ma.filled(mesh.get_array(), np.nan)
    assert shown.shape == (4, 4)
    wanted = np.where(np.isfinite(gm), gm, np.nan).reshape(4, 4)
    assert np.array_equal(shown, wanted, equal_nan=True)
    marks = {line.get_label(): (line.get_xdata()[0], line.get_ydata()[0]) for line in axis.lines}
    assert marks == {"rows without a number": (4.0, b[0]), "no limit": (2.0, b[1])}
    assert (axis.get_yscale() == "log") is is_even


def mapped(a: Any, b: Any) -> Any:
    """The axes of a heat map over a grid of a and b."""
    x, y = (each.ravel() for each in np.meshgrid(a, b))
    n = len(x)
    sweep = replace(made(), varied={"b0": x, "omega_o": y}, measures={"gm": np.log(x * y + 2)}, number=np.arange(n),
                    scenario=np.zeros(n, dtype=int), status=np.full(n, "ok"))  # fmt: skip
    return plot(sweep, "gm", against=("b0", "omega_o")).axes[0]


@pytest.mark.parametrize(
    ("values", "scale", "ticks"),
    [
        (np.geomspace(0.1, 10, 5), "log", "0.1 0.316 1 3.16 10"),
        (np.array([1.0, 2.0, 4.0, 8.0]), "log", "1 2 4 8"),
        (np.array([0.3, 1.0, 3.0]), "log", "0.3 1 3"),
        (np.array([1.0, 10.0, 100.0, 1000.0]), "log", "1 10 100 1000"),
        (np.array([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0]), "log", "0.1 0.2 0.5 1 2 5 10"),
        (np.array([1.0001, 1.0002, 1.0003]), "linear", "1.0001 1.0002 1.0003"),
        (np.array([10.0, 20.0, 40.0, 70.0]), "linear", "10 20 40 70"),
        (np.array([0.0, 0.01, 0.02, 1.0]), "linear", "0 1"),
        (np.geomspace(1, 1e3, 31), "log", "1 10 100 1000"),
    ],
)
def test_a_heat_map_has_its_ticks_on_the_grid(values: Any, scale: str, ticks: str) -> None:
    axis = mapped(values, np.array([1.0, 2.0]))
    assert axis.get_xscale() == scale
    texts = [label.get_text() for label in axis.get_xticklabels()]
    assert set(ticks.split()) <= set(texts)
    assert set(axis.get_xticks()) <= set(values)
    assert len(axis.get_xticks(minor=True)) == 0
    edges = axis.transData.transform(np.column_stack([[*axis.get_xlim()], [1.0, 1.0]]))[:, 0]
    places = axis.transData.transform(np.column_stack([axis.get_xticks(), np.ones(len(texts))]))[:, 0]
    assert np.diff(places).min() >= 0.0899 * (edges[1] - edges[0]), "labels do not overlap"


@pytest.mark.parametrize("is_log", [True, False])
def test_ranges_of_draws_are_even_on_the_axis_on_which_the_draws_are(is_log: bool) -> None:
    draw = np.random.default_rng(1).uniform(0, 5, 400)
    x = np.exp(draw) if is_log else 1 + draw
    sweep = replace(made(), varied={"b0": x, "omega_o": np.arange(400) % 3 + 1.0}, measures={"gm": x},
                    number=np.arange(400), scenario=np.zeros(400, dtype=int), status=np.full(400, "ok"))  # fmt: skip
    axis = plot(sweep, "gm", against=("b0", "omega_o"), bins=6).axes[0]
    assert (axis.get_xscale() == "log") is is_log
    edges = axis.collections[0].get_coordinates()[0, :, 0]
    assert np.ptp(np.diff(np.log(edges) if is_log else edges)) < 1e-12


def test_bands_keep_their_scale_beside_rows_that_run_away() -> None:
    sweep = made(n=40)
    y = sweep.signals["plant.y"].copy()
    y[20:23] = -np.exp(np.linspace(0, 60, 41))  # they reach their end
    figure = plot(replace(sweep, signals={"plant.y": y}), "plant.y")
    low, high = figure.axes[0].get_ylim()
    assert -0.4 < low < 0 < 0.25 < high < 0.6
    assert "values outside of the axes: up to -1.14e+26" in texts(figure)
    assert "outside" not in texts(plot(sweep, "plant.y"))
    still = np.where(np.arange(40) % 10 == 0, 1.0, 0.0)[:, None] * np.ones(41)
    assert plot(replace(sweep, signals={"plant.y": still}), "plant.y").axes[0].get_ylim()[1] >= 1.0


def test_scenarios_stand_beside_each_other_and_all_figures_are_written(tmp_path: Path) -> None:
    sweep = made(("quiet", "heavy"))
    for k, given in enumerate((
        {}, {"what": "ITAE"}, {"what": ["ITAE", "_gm"], "kind": "ecdf"}, {"what": "ITAE", "against": "Jeq"},
        {"what": "ITAE", "against": ["Jeq", "case"]}, {"what": "Jeq"}, {"what": "case"},
    )):  # fmt: skip
        figure = sweep.plot(**given)
        if not k:
            assert plots.svg_text(figure) == plots.svg_text(sweep.plot(**given))
        plots.save(figure, tmp_path / f"{k}.png")
    assert len(sweep.plot("ITAE", against=("Jeq", "case")).axes) == 3  # two maps and their bar
    assert "loop_\\$x, heavy: 200 runs" in texts(sweep["heavy"].plot("ITAE"))
    nothing = sweep.taken(np.flatnonzero(sweep.status == "diverged"))
    for against in (None, "Jeq", ["Jeq", "case"]):
        plots.save(nothing.plot("ITAE", against), tmp_path / "none.png")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"what": "ITEA"}, "Did you mean 'ITAE'?"),
        ({"what": "ITAE", "against": "Jeg"}, "Did you mean 'Jeq'?"),
        ({"what": "ITAE", "kind": "pie"}, "Choose one of: bands"),
        ({"what": "ITAE", "kind": "heat map"}, "needs two names in against="),
        ({"what": "ITAE", "kind": "bands"}, "is not a logged signal"),
        ({"what": "eso.z[2]"}, "eso.z[1]"),
        ({"what": "plant.u"}, "Add a signal to `log` to draw it."),
    ],
)
def test_what_the_sweep_does_not_have_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as refused:
        made().plot(**given)
    assert said in str(refused.value)


def test_tables_tell_means_and_quantiles_by_scenario_and_medians_by_value() -> None:
    sweep = made(("quiet", "heavy"))
    head, rule, first, second, *rest = sweep.markdown(q=[0.5]).splitlines()
    assert head == "| scenario | measure | unit | mean | 50 % | runs | without |"
    assert rule == "|---|---|---|---:|---:|---:|---:|"
    known = 3.0 * sweep["quiet"].varied["Jeq"][sweep["quiet"].status == "ok"]
    assert first == f"| quiet | ITAE | m.s2 | {known.mean():.5g} | {np.median(known):.5g} | 200 | 2 |"
    assert second.startswith("| quiet | _gm |  | ∞ |")
    assert len(rest) == 2
    by = made().markdown(by="case").splitlines()
    assert by[0] == "| case | ITAE [m.s2] | _gm | runs | failed | without |"
    assert [line.split(" | ")[-3:] for line in by[2:]] == [["100", "1", "1 |"], ["100", "1", "1 |"]]
    gm = np.where(np.arange(200) % 4 < 2, np.nan, 2.0)  # runs that reach their end, of loops that are unstable
    unstable = replace(made(), measures={"gm": gm})
    assert [line.split(" | ")[-4:] for line in unstable.markdown(by="case").splitlines()[2:]] == [
        ["2", "100", "1", "50 |"]
    ] * 2
    assert [line.split(" & ")[-3:] for line in unstable.latex(by="case").splitlines()[4:6]] == [
        ["100", "1", r"50 \\"]
    ] * 2
    tex = made().latex(q=[0.05]).splitlines()
    assert tex[0] == r"\begin{tabular}{llrrrr}"
    assert tex[2] == r"measure & unit & mean & 5 \% & runs & without \\"
    assert tex[5].startswith(r"\_gm &  & $\infty$ &")
    assert tex[-1] == r"\end{tabular}"
    with pytest.raises(UsageError, match="is not a varied parameter"):
        sweep.markdown(by="load")


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_endless_values_are_told_as_such_and_not_as_missing_ones() -> None:
    n = 200
    sweep = made(n=n)
    some = np.where(np.arange(n) < 150, np.inf, 2.0)
    some[3] = -np.inf
    grid = {"a": np.arange(n) % 2 + 1.0, "b": np.arange(n) % 3 + 1.0}
    sweep = replace(sweep, measures={"all": np.full(n, np.inf), "some": some}, varied={**sweep.varied, **grid})
    assert "all      ∞    ∞" in sweep.table()
    assert sweep.quantiles("some", q=[0.0, 0.1, 0.5])["some"].tolist() == [-np.inf, 2.0, np.inf]
    assert "| some |  | - | 2 | ∞ | ∞ |" in sweep.markdown()
    assert r"$-\infty$" in sweep.latex(q=[0.0])
    told = texts(sweep.plot(["all", "some"]))
    assert "200 without a limit" in told
    assert "150 without a limit" in told
    assert "no row has a limit" in told
    assert "without a number" not in told
    assert "all: no row has a limit" in texts(sweep.plot("all", against=("a", "b")))
    assert "no row has a limit" in texts(sweep.plot("all", against="a"))
    empty = replace(sweep, measures={"all": np.full(n, np.nan)})
    assert "no row has a number" in texts(empty.plot("all"))


def test_the_values_of_a_range_are_the_axis_of_a_measure_and_draws_are_none() -> None:
    diagram = Diagram("lag")
    diagram.wire(diagram.add("lag", FirstOrder(T=1.0)).u, diagram.add("one", Constant(value=1.0)).y)
    diagram.measure("top", "peak", of="lag.y")
    ranged = diagram.sweep({"lag.T": np.linspace(0.5, 2.0, 5)}, stop=1)
    axis = ranged.plot().axes[0]
    assert (axis.get_xlabel().split(" ")[0], axis.get_ylabel().split(" ")[0]) == ("lag.T", "top")
    x, y = axis.lines[0].get_xdata(), axis.lines[0].get_ydata()
    np.testing.assert_allclose(y, 1 - np.exp(-1 / x), rtol=1e-5)
    drawn = diagram.sweep({"lag.T": Uniform(0.5, 2.0)}, n=12, stop=1).plot(size=(3.5, 2.2), title="")
    assert drawn.axes[0].get_xlabel().startswith("top")
    assert drawn.get_size_inches().tolist() == [3.5, 2.2]


def test_values_of_a_study_are_told_in_words() -> None:
    assert values_text({"normal": [0.16, 0.02]}) == "normal, mean 0.16, deviation 0.02"
    assert values_text({"linspace": [4, 20, 9]}) == "linspace, from 4, to 20, count 9"
    assert values_text({"lognorm": {"s": 0.3, "scale": 2}}) == "lognorm, s 0.3, scale 2"
    assert values_text([1, 2.5, "a"]) == '1, 2.5, "a"'
