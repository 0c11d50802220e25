"""What comes in from outside: constants, tables held and linear, CSV files, bools; and what is refused."""

import math
from enum import IntEnum
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from blocks import (
    Block,
    Diagram,
    Input,
    Integrator,
    ModelError,
    Results,
    StateSpace,
    TransferFunction,
    UsageError,
    output,
)
from blocks.compile.inputs import read_inputs
from blocks.compile.plan import Plan

TIGHT: dict[str, Any] = {"rtol": 1e-10, "atol": 1e-12}


def integrated(**input_: Any) -> Diagram:
    """dx/dt = r."""
    diagram = Diagram("inputs")
    r, x = diagram.input("r", **input_), diagram.add("x", Integrator())
    diagram.wire(x.u, r)
    return diagram


def right(results: Results, name: str, t: float) -> float:
    k = int(np.searchsorted(results.t, t, side="right")) - 1
    assert results.t[k] == t
    return float(results[name][k])


# --- values over time ------------------------------------------------------------------------------------------


def test_a_constant_holds_at_all_times() -> None:
    assert integrated().run(stop=2.0, inputs={"r": 1.5})["x.y"][-1] == pytest.approx(3.0, abs=1e-14)
    assert integrated(default=-1.0).run(stop=2.0)["x.y"][-1] == pytest.approx(-2.0, abs=1e-14)


METHODS: list[dict[str, Any]] = [{}, {"method": "rk4", "step": 0.4}, {"method": "radau"}]


@pytest.mark.parametrize("settings", METHODS, ids=str)
def test_a_held_table_jumps_at_its_times_and_the_integral_is_exact(settings: dict[str, Any]) -> None:
    t, u = [0.5, 1.25, 1.7], [2.0, -1.0, 4.0]
    results = integrated().run(stop=3.0, inputs={"r": (t, u, "hold")}, **settings)
    assert results["x.y"][-1] == pytest.approx(2.0 * 1.25 - 0.45 + 4.0 * 1.3, abs=1e-12)
    assert results["r"][results.t == 1.25].tolist() == [2.0, -1.0]
    assert right(results, "r", 0.0) == 2.0  # before the first time: its value
    assert right(results, "r", 3.0) == 4.0


@pytest.mark.parametrize("settings", METHODS, ids=str)
def test_a_linear_table_bends_at_its_times_and_the_integral_is_exact(settings: dict[str, Any]) -> None:
    t, u = [0.5, 1.25, 1.7], [2.0, -1.0, 4.0]
    results = integrated().run(stop=3.0, inputs={"r": (t, u)}, **settings)
    assert results["x.y"][-1] == pytest.approx(2.0 * 0.5 + 0.5 * 0.75 + 1.5 * 0.45 + 4.0 * 1.3, abs=1e-12)
    assert np.max(np.abs(results["r"] - np.interp(results.t, t, u))) < 1e-14
    for time in t:
        assert results.t.tolist().count(time) == 1  # a bend is no jump


@pytest.mark.parametrize("settings", METHODS, ids=str)
def test_two_values_at_one_time_are_a_jump_in_a_linear_table(settings: dict[str, Any]) -> None:
    t, u = [0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 3.0, 3.0]
    results = integrated().run(stop=2.0, inputs={"r": (t, u)}, **settings)
    assert results["x.y"][-1] == pytest.approx(0.5 + 3.0, abs=1e-12)
    assert results["r"][results.t == 1.0].tolist() == [1.0, 3.0]


def test_of_several_values_at_one_time_the_last_holds_from_there_on() -> None:
    for interpolation in ("hold", "linear"):
        results = integrated().run(stop=2.0, inputs={"r": ([0, 1, 1, 1, 2], [5, 5, 9, 7, 7], interpolation)})
        assert results["r"][results.t == 1.0].tolist() == [5.0, 7.0]
        assert results["x.y"][-1] == pytest.approx(12.0, abs=1e-12)


def test_a_table_that_begins_or_ends_with_a_jump_begins_and_ends_right() -> None:
    results = integrated().run(stop=1.0, inputs={"r": ([0, 0, 1, 1], [5, 1, 1, 8])})
    assert results["r"][0] == 1.0
    assert results["r"][-2:].tolist() == [1.0, 8.0]
    assert results["x.y"][-1] == pytest.approx(1.0, abs=1e-13)


def test_a_table_of_one_row_is_a_constant() -> None:
    assert integrated().run(stop=1.0, inputs={"r": ([7.0], [3.0])})["x.y"][-1] == pytest.approx(3.0, abs=1e-14)


def test_a_run_that_starts_inside_a_table_reads_it_there() -> None:
    results = integrated().run(start=1.5, stop=2.0, inputs={"r": ([1, 2], [0, 1])})
    assert results["r"][0] == 0.5
    assert results["x.y"][-1] == pytest.approx(0.375, abs=1e-13)


def test_a_table_drives_a_system_as_scipy_does_piece_by_piece() -> None:
    diagram = Diagram("driven")
    r, plant = diagram.input("r"), diagram.add("plant", TransferFunction(num=[3.0], den=[1.0, 0.3, 4.0]))
    diagram.wire(plant.u, r)
    rng = np.random.default_rng(3)
    t, u = np.sort(rng.uniform(0, 10, 30)), rng.normal(size=30)
    for mode in ("hold", "linear"):
        results = diagram.run(stop=10.0, inputs={"r": (t, u, mode)}, **TIGHT)

        def at(time: float, begin: float, mode: str = mode) -> float:
            return float(
                np.interp(time, t, u) if mode == "linear" else u[max(np.searchsorted(t, begin, side="right") - 1, 0)]
            )

        x = np.zeros(2)
        ends = [0.0, *t, 10.0]
        for begin, end in pairwise(ends):

            def rates(time: float, x: Any, begin: float = begin, at: Any = at) -> Any:
                return [x[1], at(time, begin) - 0.3 * x[1] - 4.0 * x[0]]

            x = solve_ivp(rates, (begin, end), x, rtol=1e-11, atol=1e-13).y[:, -1]
        assert results["plant.y"][-1] == pytest.approx(3.0 * x[0], abs=1e-8)


def test_vectors_come_as_rows() -> None:
    diagram = Diagram("vector")
    r = diagram.input("r", size=2)
    system = diagram.add("s", StateSpace(A=[[0.0]], B=[[1.0, 10.0]], C=[[1.0]]))
    diagram.wire(system.u, r)
    assert diagram.run(stop=1.0, inputs={"r": [1.0, 2.0]})["s.y"][-1, 0] == pytest.approx(21.0, abs=1e-12)
    results = diagram.run(stop=1.0, inputs={"r": ([0.0, 1.0], [[0.0, 2.0], [1.0, 2.0]])})
    assert results["s.y"][-1, 0] == pytest.approx(20.5, abs=1e-12)
    assert results["r"][-1].tolist() == [1.0, 2.0]
    assert results["r[1]"][-1] == 2.0


def test_inputs_with_a_unit_are_scaled_to_the_input_s_own() -> None:
    diagram = integrated(unit="V")
    for raw, factor in (
        ({"value": 500, "unit": "mV"}, 0.5),
        ({"t": [0, 1], "u": [500, 500], "unit": "mV"}, 0.5),
        ({"t": [0, 1], "u": [2, 2], "interpolation": "hold"}, 2.0),
    ):
        assert diagram.run(stop=1.0, inputs={"r": raw})["x.y"][-1] == pytest.approx(factor, abs=1e-13)
    with pytest.raises(UsageError, match=r"E502 r: \[s\] is given, but \[V\] is needed"):
        diagram.run(stop=1.0, inputs={"r": {"value": 1, "unit": "s"}})


class Not(Block):
    u = Input(type="bool")

    @output(type="bool")
    def y(u):
        return ~u

    @output
    def number(u):
        return np.where(u, 3.0, -3.0)


def test_bool_inputs_are_held_and_take_bools_only() -> None:
    diagram = Diagram("bools")
    b, block = diagram.input("b", type="bool"), diagram.add("n", Not())
    diagram.wire(block.u, b)
    results = diagram.run(stop=3.0, inputs={"b": ([0, 1, 2], [True, False, True])})
    assert [right(results, "n.y", t) for t in (0.0, 1.0, 2.0, 3.0)] == [0.0, 1.0, 0.0, 0.0]
    assert [right(results, "n.number", t) for t in (0.0, 1.0, 2.0)] == [3.0, -3.0, 3.0]
    assert diagram.run(stop=1.0, inputs={"b": False})["n.y"][0] == 1.0
    assert diagram.run(stop=1.0, inputs={"b": 1})["n.y"][0] == 0.0
    for wrong in (0.5, 2, ([0, 1], [0.0, 0.5])):
        with pytest.raises(UsageError, match="E502 b: must be true or false"):
            diagram.run(stop=1.0, inputs={"b": wrong})
    with pytest.raises(UsageError, match="E502 r: must be a number, not true or false"):
        integrated().run(stop=1.0, inputs={"r": True})


def test_settings_of_a_diagram_may_hold_inputs_and_those_of_a_call_win() -> None:
    diagram = integrated()
    diagram.settings(inputs={"r": {"t": [0, 1], "u": [0, 2]}}, stop=1.0)
    assert diagram.run()["x.y"][-1] == pytest.approx(1.0, abs=1e-13)
    assert Diagram.from_json(diagram.dumps()).run()["x.y"][-1] == pytest.approx(1.0, abs=1e-13)
    assert diagram.run(inputs={"r": 5.0})["x.y"][-1] == pytest.approx(5.0, abs=1e-13)


# --- refusals --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ("1", "must be a number, not the text '1'"),
        (math.nan, "must be finite"),
        (math.inf, "must be finite"),
        ([1.0, 2.0], "must be a single number"),
        (None, "must be numbers"),
        (([0, 1], [1.0]), "needs one value for each time"),
        (([0, 1], [[1.0, 2.0], [1.0, 2.0]]), "a single number for each time"),
        (([1, 0], [1.0, 2.0]), "must not decrease"),
        (([0, math.nan], [1.0, 2.0]), "must be finite"),
        (([0, 1], [1.0, math.nan]), "must be finite"),
        (([], []), "needs one value for each time"),
        (([0, 1], [1.0, 2.0], "cubic"), '"hold" or "linear"'),
        (([0, 1],), '"hold" or "linear"'),
        ({"t": [0, 1]}, '{"t": [...], "u": [...]'),
        ({"t": [0, 1], "u": [0, 1], "mode": "hold"}, '{"t": [...], "u": [...]'),
        ({"t": [0, 1], "u": [0, 1], "interpolation": "cubic"}, '"hold" or "linear"'),
        (([0, "x"], [1.0, 2.0]), "E502 r"),
        (1 + 2j, "must be numbers"),
    ],
)
def test_an_input_that_does_not_fit_is_refused_with_its_name(raw: Any, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        integrated().run(stop=1.0, inputs={"r": raw})
    assert caught.value.code == "E502"
    assert str(caught.value).startswith("E502 r: ")
    assert message in str(caught.value)


def test_all_faults_of_the_inputs_are_told_at_once() -> None:
    diagram = integrated()
    diagram.input("s")
    with pytest.raises(UsageError) as caught:
        diagram.run(stop=1.0, inputs={"r": "x", "rr": 1.0})
    assert [fault.place for fault in caught.value.faults] == ["rr", "r", "s"]
    assert "Did you mean 'r'?" in str(caught.value)
    assert "the input has no value" in str(caught.value)


# --- CSV files -------------------------------------------------------------------------------------------------


def csv(folder: Path, content: str | bytes) -> Path:
    path = folder / "inputs.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_a_csv_file_gives_inputs_by_its_columns(tmp_path: Path) -> None:
    path = csv(tmp_path, "time,r\n0,1\n1,3\n\n2,3\n")
    results = integrated().run(stop=2.0, inputs=path)
    assert results["x.y"][-1] == pytest.approx(5.0, abs=1e-12)
    held = integrated().run(stop=2.0, inputs=str(path), interpolation="hold")
    assert held["x.y"][-1] == pytest.approx(4.0, abs=1e-12)


def test_a_csv_file_may_have_a_byte_order_mark_spaces_and_crlf(tmp_path: Path) -> None:
    path = csv(tmp_path, b"\xef\xbb\xbftime, r\r\n0, 1\r\n1e0 ,3\r\n")
    assert integrated().run(stop=1.0, inputs=path)["x.y"][-1] == pytest.approx(2.0, abs=1e-12)


def test_elements_of_a_vector_are_columns(tmp_path: Path) -> None:
    diagram = Diagram("vector")
    diagram.input("r", size=2)
    path = csv(tmp_path, "time,r[1],r[0]\n0,10,1\n1,20,2\n")
    assert diagram.run(stop=1.0, inputs=path, every=1.0)["r"].tolist() == [[1.0, 10.0], [2.0, 20.0]]


def test_what_a_run_writes_another_reads(tmp_path: Path) -> None:
    first = integrated().run(stop=2.0, inputs={"r": ([0, 1, 1, 2], [0, 1, 5, 4])}, log=["r"])
    first.to_csv(tmp_path / "out.csv")
    second = integrated().run(stop=2.0, inputs=tmp_path / "out.csv")
    assert second["x.y"][-1] == pytest.approx(0.5 + 4.5, abs=1e-12)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("r,time\n1,0\n", "does not begin with a column 'time'"),
        ("time,r\n", "has no rows"),
        ("time,r\n0,1\n1\n", "line 3: 1 cells for 2 columns"),
        ("time,r\n0,1\n1,2,3\n", "line 3: 3 cells for 2 columns"),
        ("time,r\n0,one\n", "line 2: 'one' in the column 'r' is not a number"),
        ("time,r,r\n0,1,2\n", "two columns with the same name"),
        ("time,r,rr\n0,1,2\n", "column 'rr' is not an input of the diagram. Did you mean 'r'?"),
        ("time,q9\n0,1\n", "column 'q9' is not an input of the diagram. Inputs: r."),
        ("time,r\n0,nan\n", "must be finite"),
        ("time,r\n1,0\n0,0\n", "must not decrease"),
        (b"time,r\n0,\xff\n", "cannot be read"),
        ("time,r\n1000,0\n2000,1\n", "begins at 1000 s, after the end of the run at 1 s. Its times"),
    ],
)
def test_a_bad_csv_file_is_refused_with_its_line(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        integrated().run(stop=1.0, inputs=csv(tmp_path, content))
    assert caught.value.code == "E502"
    assert message in str(caught.value)


def test_members_and_bools_in_a_csv_file_go_by_word_or_number(tmp_path: Path) -> None:
    made = Diagram("words")
    made.input("gear", type=IntEnum("Gear", {"Low speed": 1, "High": 4}))
    made.input("on", type="bool")
    rows = {"words": "0,Low speed,false\n1,High,true\n", "numbers": "0,1,0\n1,4,1\n"}
    runs = [
        made.run(stop=2.0, every=0.5, inputs=csv(tmp_path, f"time,gear,on\n{text}"), log=["gear", "on"])
        for text in rows.values()
    ]
    for name, first, last in (("gear", 1, 4), ("on", 0, 1)):
        assert runs[0][name].tolist() == runs[1][name].tolist()
        assert (runs[0][name][0], runs[0][name][-1]) == (first, last)
    with pytest.raises(UsageError, match="'Fast' in the column 'gear' is not a number, nor one of Low speed, High"):
        made.run(stop=2.0, inputs=csv(tmp_path, "time,gear,on\n0,Fast,true\n"))


def test_a_csv_file_that_begins_with_the_end_is_taken(tmp_path: Path) -> None:
    path = csv(tmp_path, "time,r\n1,3\n2,1\n")
    assert integrated().run(stop=1.0, inputs=path)["x.y"][-1] == pytest.approx(3.0, abs=1e-12)


def test_a_csv_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"E502 .*none\.csv: cannot be read: No such file"):
        integrated().run(stop=1.0, inputs=tmp_path / "none.csv")


def test_lines_are_counted_as_an_editor_counts_them(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="line 5: 'x' in the column 'time' is not a number"):
        integrated().run(stop=1.0, inputs=csv(tmp_path, "time,r\n0,1\n\n1,2\nx,y\n"))


# --- the table itself ------------------------------------------------------------------------------------------


def seconds(most: float) -> st.SearchStrategy[float]:
    """Times between which a slope is no larger than doubles are: numpy.interp, the witness, computes it."""
    return st.floats(-most, most).filter(lambda t: t == 0.0 or abs(t) > 1e-200)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(seconds(100), st.floats(-1e6, 1e6)), min_size=1, max_size=12),
    st.lists(seconds(120), min_size=1, max_size=5),
    st.booleans(),
)
def test_a_segment_is_the_table_everywhere(rows: list[tuple[float, float]], times: list[float], linear: bool) -> None:
    rows = sorted(rows, key=lambda row: row[0])
    t, u = [row[0] for row in rows], [row[1] for row in rows]
    table = read_inputs(_PLAN, {"r": (t, u, "linear" if linear else "hold")})
    for time in (*times, *t):
        k = max(int(np.searchsorted(t, time, side="right")) - 1, 0)
        expected = np.interp(time, t, u) if linear and time not in t else u[k]
        scale = max(map(abs, u))
        assert table.segment(time).at(time)[0] == pytest.approx(expected, abs=1e-12 * scale)
        following = table.next_break(time)
        assert following > time
        if math.isfinite(following):
            before = table.segment(time).at(following)[0]
            j = int(np.searchsorted(t, following, side="left"))
            assert before == (u[j] if linear and time >= t[0] else u[k])


_PLAN: Plan = integrated().plan()


# --- matrices --------------------------------------------------------------------------------------------------


class Applied(Block):
    """y = M v."""

    M = Input(shape=(2, 3))
    v = Input(shape=3)

    @output(shape=2)
    def y(M, v):  # type: ignore[no-untyped-def]
        return M @ v


MATRIX = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_an_input_may_be_a_matrix(engine: str, tmp_path: Path) -> None:
    d = Diagram.alone(Applied())
    assert d.to_json()["inputs"] == {"M": {"size": [2, 3]}, "v": {"size": 3}}
    v = [1.0, -1.0, 0.5]
    expected = (np.array(MATRIX) @ v).tolist()
    assert d.run(stop=1.0, engine=engine, inputs={"M": MATRIX, "v": v})["y"][-1].tolist() == expected
    twice = (2 * np.array(MATRIX)).tolist()
    table = {"t": [0, 1], "u": [MATRIX, twice], "interpolation": "hold"}
    made = d.run(stop=2.0, engine=engine, inputs={"M": table, "v": v}, every=1.0)
    assert made["y"][[0, -1]].tolist() == [expected, [2 * one for one in expected]]
    assert made["M"][-1].tolist() == twice
    made.to_csv(tmp_path / "M.csv")
    assert "M[1,2]" in (tmp_path / "M.csv").read_text(encoding="utf-8")
    path = csv(tmp_path, 'time,"M[0,0]","M[0,1]","M[0,2]","M[1,0]","M[1,1]","M[1,2]"\n0,1,2,3,4,5,6\n')
    assert d.run(stop=1.0, engine=engine, inputs=[path, {"v": v}])["y"][-1].tolist() == expected
    with pytest.raises(UsageError, match="E502 M: must be 2 x 3 elements"):
        d.run(stop=1.0, engine=engine, inputs={"M": MATRIX[0], "v": v})


def test_a_matrix_may_have_a_default_for_each_element() -> None:
    d = Diagram("d", library=Applied)
    p = d.add("p", Applied())
    d.wire(p.M, d.input("M", size=(2, 3), default=MATRIX))
    d.wire(p.v, d.input("v", size=3, default=[1, 0, 0]))
    assert Diagram.from_json(d.dumps(), library=Applied).run(stop=1.0)["p.y"][-1].tolist() == [1.0, 4.0]
    document = d.to_json()
    for default in ([1, 2], [[1, 2, 3], [4, 5]], [[1, 2, 3], 4], [[1, 2, "3"], [4, 5, 6]]):
        document["inputs"]["M"]["default"] = default
        with pytest.raises(ModelError, match=r"E004 (<text>:1:\d+ )?inputs\.M\.default"):
            Diagram.from_json(document, library=Applied)
