"""Tables: numpy's interpolation, closed forms of integrals, corners hit exactly, and CSV columns in files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from blocks import (
    Block,
    Constant,
    Diagram,
    Expression,
    Integrator,
    LookupTable,
    LookupTable2D,
    ModelError,
    Parameter,
    Pulse,
    Ramp,
    Sine,
    Table,
    output,
)
from blocks.contract.table_lookup import pick, search

Array = np.ndarray[Any, Any]


def test_searching_and_picking_on_numbers() -> None:
    points = np.array([1.0, 2.0, 4.0])
    assert search(points, np.array([0.0, 1.0, 1.5, 4.0, 9.0])).tolist() == [0.0, 1.0, 1.0, 3.0, 3.0]
    assert search(points, np.nan) == 3.0
    assert pick(points, np.array([-3.0, 0.0, 1.9, 2.0, 7.0])).tolist() == [1.0, 1.0, 2.0, 4.0, 4.0]
    assert np.isnan(pick(points, np.nan))
    assert pick(np.array([[1.0, 2.0], [3.0, 4.0]]), 2.0) == 3.0


def test_a_table_over_time_is_that_of_numpy_and_its_integral_that_of_the_trapezoid_rule() -> None:
    rng = np.random.default_rng(3)
    times, values = np.cumsum(rng.uniform(0.01, 0.4, 40)), rng.normal(size=40)
    d = Diagram("table")
    table, integral = d.add("table", Table(times=times, values=values)), d.add("integral", Integrator())
    d.wire(integral.u, table.y)
    stop = round(float(times[-1]) + 0.5, 3)
    results = d.run(stop=stop)
    assert results["table.y"] == pytest.approx(np.interp(results.t, times, values), abs=1e-12)
    assert set(times) <= set(results.t)
    expected = values[0] * times[0] + np.trapezoid(values, times) + values[-1] * (stop - times[-1])
    assert results["integral.y"][-1] == pytest.approx(expected, abs=1e-12)


def test_held_values_jump_at_their_times() -> None:
    d = Diagram("held")
    table = d.add("table", Table(times=[0.3, 0.7, 1.1], values=[1.0, -2.0, 5.0], interpolation="hold"))
    integral = d.add("integral", Integrator())
    d.wire(integral.u, table.y)
    results = d.run(stop=2.0)
    assert results["integral.y"][-1] == pytest.approx(0.7 * 1.0 + 0.4 * -2.0 + 0.9 * 5.0, abs=1e-14)
    assert [event.t for event in results.events] == [0.3, 0.7, 1.1]


def test_a_run_that_begins_late_begins_in_the_middle_of_the_table() -> None:
    d = Diagram("late")
    d.add("table", Table(times=[0.0, 1.0, 2.0], values=[0.0, 1.0, 0.0]))
    results = d.run(start=1.5, stop=3.0, every=0.5)
    assert results["table.y"][results.t <= 2.0].tolist() == [0.5, 0.0]


def test_a_table_of_many_points_costs_one_search() -> None:
    times = np.linspace(0.0, 100.0, 20001)
    d = Diagram("long")
    d.add("table", Table(times=times, values=np.sin(times)))
    results = d.run(stop=1.0, every=0.0125)
    assert results["table.y"] == pytest.approx(np.sin(results.t), abs=1e-5)


def looked_up(block: LookupTable, source: Any, **settings: Any) -> Any:
    d = Diagram("lookup")
    table, driver, integral = d.add("table", block), d.add("driver", source), d.add("integral", Integrator())
    d.wire(table.u, driver.y)
    d.wire(integral.u, table.y)
    return d.run(**settings)


POINTS, VALUES = [-0.8, -0.5, 0.1, 0.6], [2.0, -1.0, 0.0, 3.0]


@pytest.mark.parametrize("beyond", ["hold", "linear"])
def test_a_characteristic_of_lines_is_that_of_numpy(beyond: str) -> None:
    results = looked_up(LookupTable(points=POINTS, values=VALUES, beyond=beyond), Sine(omega=3.0), stop=4.0)
    u = np.sin(3.0 * results.t)
    expected = np.interp(u, POINTS, VALUES)
    if beyond == "linear":
        expected = np.where(u < -0.8, 2.0 - 10.0 * (u + 0.8), np.where(u > 0.6, 3.0 + 6.0 * (u - 0.6), expected))
    assert results["table.y"] == pytest.approx(expected, abs=1e-12)


def test_no_step_straddles_a_corner() -> None:
    """The integral over a ramp is that of the lines, although the tolerance is loose."""
    results = looked_up(LookupTable(points=POINTS, values=VALUES), Ramp(before=-1.0, slope=1.0), stop=2.0, rtol=1e-3)
    expected = 0.2 * 2.0 + 0.3 * 0.5 + 0.6 * -0.5 + 0.5 * 1.5 + 0.4 * 3.0
    assert results["integral.y"][-1] == pytest.approx(expected, abs=1e-12)
    assert [event.t for event in results.events if event.block == "table"] == pytest.approx([0.2, 0.5, 1.1, 1.6])


@pytest.mark.parametrize("slope", [1.0, -1.0])
def test_a_staircase_jumps_up_and_down_at_its_points(slope: float) -> None:
    block = LookupTable(points=POINTS, values=VALUES, interpolation="hold")
    results = looked_up(block, Ramp(before=-slope, slope=slope), stop=2.0)
    expected = 0.2 * 2.0 + 0.3 * 2.0 + 0.6 * -1.0 + 0.5 * 0.0 + 0.4 * 3.0
    assert results["integral.y"][-1] == pytest.approx(expected, abs=1e-12)


def test_a_jump_over_several_points_lands_in_the_right_place() -> None:
    for on in (-5.0, -0.8, 0.1, 0.35, 5.0):
        d = Diagram("jump")
        table, driver = d.add("table", LookupTable(points=POINTS, values=VALUES)), d.add("driver", Pulse(height=on))
        d.wire(table.u, driver.y)
        results = d.run(stop=3.0)
        during = (results.t > 1.0) & (results.t < 2.0)
        assert results["table.y"][during] == pytest.approx(np.interp(on, POINTS, VALUES), abs=1e-13)
        assert results["table.y"][-1] == pytest.approx(np.interp(0.0, POINTS, VALUES), abs=1e-13)


def test_a_grid_is_that_of_scipy() -> None:
    rng = np.random.default_rng(5)
    x, y, z = np.array([-1.0, 0.0, 0.5, 2.0]), np.array([0.0, 1.0, 3.0]), rng.normal(size=(4, 3))
    d = Diagram("grid")
    table = d.add("table", LookupTable2D(points1=x, points2=y, values=z))
    a, b = d.add("a", Expression(expression="1.5*sin(3*t) + 0.5")), d.add("b", Expression(expression="t"))
    d.wire(table.u1, a.y)
    d.wire(table.u2, b.y)
    results = d.run(stop=4.0, every=0.01)
    at = np.column_stack([np.clip(1.5 * np.sin(3 * results.t) + 0.5, -1.0, 2.0), np.clip(results.t, 0.0, 3.0)])
    assert results["table.y"] == pytest.approx(RegularGridInterpolator((x, y), z)(at), abs=1e-12)


def test_a_formula_is_what_python_computes() -> None:
    d = Diagram("formula")
    a, b = d.add("a", Sine()), d.add("b", Constant(value=0.5))
    y = d.add("y", Expression(expression="k1*u1**2 - u2/(1 + abs(u1)) + max(u1, u2, t)*pi", k=[3.0]))
    d.wire(y.u1, a.y)
    d.wire(y.u2, b.y)
    results = d.run(stop=3.0, every=0.1)
    u = np.sin(results.t)
    expected = 3.0 * u**2 - 0.5 / (1 + np.abs(u)) + np.maximum(np.maximum(u, 0.5), results.t) * np.pi
    assert results["y.y"] == pytest.approx(expected, rel=1e-14)


def test_np_interp_takes_tables_of_any_size() -> None:
    n = 500

    class Curve(Block):
        """y = a curve over t."""

        x = Parameter(np.linspace(0.0, 1.0, n), shape="n", table=True)
        f = Parameter(np.linspace(0.0, 1.0, n) ** 2, shape="n", table=True)

        @output
        def y(t, x, f):  # type: ignore[no-untyped-def]
            return np.interp(t, x, f) + x[0] + f[-1]

    d = Diagram("curve")
    d.add("curve", Curve())
    results = d.run(stop=1.5, every=0.01)
    assert results["curve.y"] == pytest.approx(np.minimum(results.t, 1.0) ** 2 + 1.0, abs=1e-5)


# --- CSV columns -----------------------------------------------------------------------------------------------


def cycle(tmp_path: Path, text: str = "# a cycle\ntime,speed\n0,0\n1,36\n3,36\n", **column: Any) -> Path:
    (tmp_path / "cycle.csv").write_text(text)
    path = tmp_path / "drive.json"
    speed = {"csv": "cycle.csv", "column": "speed", "unit": "km/h"} | column
    document = {
        "format": "blocks-diagram",
        "version": 3,
        "name": "drive",
        "blocks": {
            "cycle": {
                "type": "Table",
                "parameters": {"unit": "m/s", "times": {"csv": "cycle.csv", "column": "time"}, "values": speed},
            }
        },
        "run": {"stop": 4.0},
    }
    path.write_text(json.dumps(document))
    return path


def test_the_points_of_a_table_can_stand_in_a_file(tmp_path: Path) -> None:
    diagram = Diagram.load(cycle(tmp_path))
    results = diagram.run(every=0.5)
    assert results["cycle.y"] == pytest.approx(np.interp(results.t, [0.0, 1.0, 3.0], [0.0, 10.0, 10.0]), abs=1e-14)
    values = diagram.to_json()["blocks"]["cycle"]["parameters"]["values"]
    assert values == {"csv": "cycle.csv", "column": "speed", "unit": "km/h"}


def test_a_diagram_saved_elsewhere_finds_its_points(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("")
    diagram = Diagram.load(cycle(tmp_path))
    (tmp_path / "deep").mkdir()
    diagram.save(tmp_path / "deep" / "copy.json")
    assert Diagram.load(tmp_path / "deep" / "copy.json").run()["cycle.y"][-1] == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("text", "column", "sentence"),
    [
        ("time,speed\n0,1\n", {"column": "sped"}, "\"cycle.csv\" has no such column. Did you mean 'speed'?"),
        ("time,speed\n0,x\n", {}, "\"cycle.csv\" line 2: 'x' in the column 'speed' is not a number."),
        ("time,speed\n0,1_000\n", {}, "line 2: '1_000' in the column 'speed' is not a number."),
        ("time,speed,speed\n", {}, "has two columns with the same name, 'speed'."),
        ("time;speed\n0;1\n", {}, "separates its columns by ';'. Use commas."),
        ("", {}, '"cycle.csv" is empty.'),
        ("time,speed\n0\n", {}, "line 2: 1 cells for 2 columns."),
        ("time,speed\n0,1\n", {"csv": "../other.csv"}, '"../other.csv" lies outside the project.'),
        ("time,speed\n0,1\n", {"csv": "cycel.csv"}, "does not exist. Did you mean 'cycle.csv'?"),
        ("time,speed\n0,1\n", {"csv": 3}, "must be a text, not the number 3."),
        ("time,speed\n0,1\n", {"unit": "V"}, "E104"),
        ("time,speed\n0,1\n", {"colum": "x"}, 'the key "colum" is not known here.'),
        ("time,speed\n0,1\n0,2\n", {}, "times must increase"),
    ],
)  # fmt: skip
def test_columns_that_cannot_be_read_say_why(tmp_path: Path, text: str, column: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ModelError) as caught:
        Diagram.load(cycle(tmp_path, text, **column)).run()
    assert sentence in str(caught.value)


def test_a_diagram_made_in_python_reads_them_too(tmp_path: Path) -> None:
    cycle(tmp_path)
    d = Diagram("python", folder=tmp_path)
    column = {"csv": "cycle.csv", "column": "time"}
    d.add("table", Table(times=column, values=column))
    assert d.run(stop=5.0)["table.y"][-1] == 3.0
    with pytest.raises(ModelError, match=r'E007 .*"nothing.csv" does not exist'):
        d.add("other", Table(times={"csv": "nothing.csv", "column": "time"}))
