"""Differences of two results: by hand, by numpy's interpolation, at jumps, in other units; what cannot be compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blocks import Diagram, Integrator, ModelError, Results, Step, UsageError
from blocks.results.comparison import compare
from blocks.results.provenance import Origin
from blocks.results.results import Statistics

EPS = float(np.finfo(float).eps)


def results(
    t: Sequence[float], *, units: dict[str, str] | None = None, diagram: str = "d", **signals: Sequence[float]
) -> Results:
    """Results with one block per signal: x becomes x.y."""
    columns = {f"{name}.y": (index, (), (units or {}).get(name, "")) for index, name in enumerate(signals)}
    values = np.array(list(signals.values()), dtype=float).T.reshape(len(t), len(signals))
    return Results(diagram, np.array(t, dtype=float), values, columns)


def test_results_are_equal_to_themselves() -> None:
    a = results([0, 1, 2], x=[0, 5, 1], zero=[0, 0, 0])
    made = compare(a, a, tolerance=0.0)
    assert made.is_within
    assert not made.is_interpolated
    assert [(one.name, one.absolute, one.relative, one.t) for one in made.differences] == [
        ("x.y", 0.0, 0.0, 0.0),
        ("zero.y", 0.0, 0.0, 0.0),
    ]


def test_a_known_difference_is_found_at_its_time_and_as_a_part_of_the_range_in_a() -> None:
    a = results([0, 1, 2, 3], x=[-1, 0, 3, 1], y=[0, 0, 0, 8])
    b = results([0, 1, 2, 3], x=[-1, 0.25, 2.5, 1], y=[0, 0, 0.5, 8])
    made = compare(a, b, tolerance=0.1)
    x, y = made.differences
    assert (x.name, x.absolute, x.relative, x.t, x.is_within) == ("x.y", 0.5, 0.125, 2.0, False)
    assert (y.name, y.absolute, y.relative, y.t, y.is_within) == ("y.y", 0.5, 0.0625, 2.0, True)
    assert made.worst is x
    assert made.beyond == (x,)
    assert not made.is_within
    assert compare(a, b, tolerance=0.125).is_within, "the tolerance itself is within"
    assert compare(b, a).differences[0].relative == 0.5 / 3.5, "the range is that of the first"


def test_signals_that_one_of_them_lacks_are_listed_and_do_not_count() -> None:
    made = compare(results([0, 1], x=[0, 1], left=[0, 1]), results([0, 1], right=[5, 5], x=[0, 1]))
    assert (made.only_a, made.only_b) == (("left.y",), ("right.y",))
    assert made.is_within


def test_elements_of_vectors_are_compared_one_by_one() -> None:
    t = np.array([0.0, 1.0])
    a = Results("a", t, np.array([[0.0, 0.0], [1.0, 2.0]]), {"s.y": (0, (2,), "V")})
    b = Results("b", t, np.array([[0.0, 0.0, 7.0], [1.0, 3.0, 7.0]]), {"s.y": (0, (3,), "V")})
    made = compare(a, b)
    assert [one.name for one in made.differences] == ["s.y[0]", "s.y[1]"]
    assert [one.absolute for one in made.differences] == [0.0, 1.0]
    assert made.only_b == ("s.y[2]",)


# --- times -----------------------------------------------------------------------------------------------------


def test_lines_between_rows_are_compared_where_the_times_differ() -> None:
    a = results([0, 2], x=[0, 2])
    b = results([0, 1, 2], x=[0, 1.5, 2])
    made = compare(a, b)
    assert made.is_interpolated
    assert (made.start, made.stop, made.rows) == (0.0, 2.0, 3)
    (x,) = made.differences
    assert (x.absolute, x.relative, x.t) == (0.5, 0.25, 1.0)


def test_only_the_time_that_both_have_is_compared() -> None:
    a = results([0, 4], x=[0, 4])
    b = results([1, 3, 6], x=[1, 3, 100])
    made = compare(a, b)
    assert (made.start, made.stop, made.rows) == (1.0, 4.0, 3)
    (x,) = made.differences
    # At t = 4 s the second lies a third of the way from 3 to 100; the range of the first is 3 there.
    assert x.t == 4.0
    assert x.absolute == pytest.approx(3 + 97 / 3 - 4, abs=8 * EPS * 100)
    assert x.relative == pytest.approx((97 / 3 - 1) / 3, rel=8 * EPS)


def test_both_sides_of_a_jump_are_compared() -> None:
    jump = results([0, 1, 1, 2], x=[0, 0, 4, 4])
    other_rows = results([0, 0.5, 1, 1, 1.5, 2], x=[0, 0, 0, 4, 4, 4])
    assert compare(jump, other_rows, tolerance=0.0).is_within
    assert compare(other_rows, jump, tolerance=0.0).is_within
    ramp = results([0, 0.5, 1, 2], x=[0, 0, 4, 4])
    (left,) = compare(jump, ramp).differences
    assert (left.absolute, left.t) == (4.0, 1.0), "the value before the jump counts"
    late = results([0, 1, 1.5, 2], x=[0, 0, 4, 4])
    (right,) = compare(jump, late).differences
    assert (right.absolute, right.t) == (4.0, 1.0), "the value after the jump counts"


def test_of_several_rows_at_one_time_the_first_and_the_last_count() -> None:
    a = results([0, 1, 1, 1, 2], x=[0, 0, 9, 4, 4])
    b = results([0, 1, 1, 2], x=[0, 0, 4, 4])
    assert compare(a, b, tolerance=0.0).is_within


def test_at_an_end_that_lies_within_the_other_only_the_inner_side_counts() -> None:
    whole = results([0, 1, 1, 2, 2, 3], x=[0, 0, 5, 5, 7, 7])
    part = results([1, 2], x=[5, 5])
    assert compare(whole, part, tolerance=0.0).is_within
    assert compare(part, whole, tolerance=0.0).is_within
    (one,) = compare(results([0, 1, 1], x=[0, 0, 5]), results([0, 0.5, 1, 1], x=[0, 0, 0, 6])).differences
    assert (one.absolute, one.t) == (1.0, 1.0), "a jump at the end of both counts"


def test_one_common_time_is_enough() -> None:
    made = compare(results([0, 1], x=[0, 1]), results([1, 2], x=[3, 3]))
    assert (made.start, made.stop, made.rows) == (1.0, 1.0, 1)
    assert made.differences[0].absolute == 2.0


STEPS = st.lists(st.integers(1, 64), min_size=1, max_size=20)
HEIGHTS = st.integers(-1000, 1000)


@given(steps_a=STEPS, steps_b=STEPS, start=st.integers(-50, 50), data=st.data())
def test_differences_are_those_of_numpys_interpolation(
    steps_a: list[int], steps_b: list[int], start: int, data: Any
) -> None:
    """Without jumps, `np.interp` on all times of both is a second witness."""
    ta = np.concatenate([[0.0], np.cumsum(steps_a)]) / 8.0
    tb = (start + np.concatenate([[0.0], np.cumsum(steps_b)])) / 8.0
    xa, xb = (np.array(data.draw(st.lists(HEIGHTS, min_size=len(t), max_size=len(t))), float) for t in (ta, tb))
    low, high = max(ta[0], tb[0]), min(ta[-1], tb[-1])
    if low > high:
        return
    times = np.union1d(ta, tb)
    times = times[(times >= low) & (times <= high)]
    ya, yb = np.interp(times, ta, xa), np.interp(times, tb, xb)
    far = np.abs(ya - yb)
    (one,) = compare(results(ta, x=xa), results(tb, x=xb)).differences
    # Each interpolated value is rounded a few times, in another order than numpy's.
    slack = 8 * EPS * 1000
    assert one.absolute == pytest.approx(far.max(), abs=2 * slack)
    assert far[np.searchsorted(times, one.t)] == pytest.approx(far.max(), abs=2 * slack)
    spread = ya.max() - ya.min()
    if spread > 1e-3:
        assert one.relative == pytest.approx(far.max() / spread, rel=1e-9, abs=1e-9)


# --- scale -----------------------------------------------------------------------------------------------------


def test_a_constant_is_measured_by_its_magnitude() -> None:
    (one,) = compare(results([0, 1], x=[-5, -5]), results([0, 1], x=[-5, -4])).differences
    assert (one.absolute, one.relative) == (1.0, 0.2)
    almost = results([0, 1], x=[5.0, 5.0 + 8 * EPS])
    assert compare(almost, results([0, 1], x=[5.0, 5.0]), tolerance=1e-14).is_within


def test_where_a_is_zero_throughout_every_difference_is_infinite_but_for_an_absolute_limit() -> None:
    a, b = results([0, 1], x=[0, 0]), results([0, 1], x=[0, 1e-17])
    (one,) = compare(a, b, tolerance=1e9).differences
    assert (one.absolute, one.relative, one.is_within) == (1e-17, math.inf, False)
    assert compare(a, b, tolerance=0.0, absolute=1e-17).is_within
    assert not compare(a, b, tolerance=0.0, absolute=0.9e-17).is_within


def test_numbers_near_the_largest_double_are_compared() -> None:
    a, b = results([0, 1], x=[-1.7e308, 1.7e308]), results([0, 1], x=[1.7e308, 1.7e308])
    (one,) = compare(a, b).differences
    assert (one.absolute, one.relative, one.is_within) == (math.inf, math.inf, False)
    (one,) = compare(a, results([0, 1], x=[-1.7e308, 0.0])).differences
    assert one.relative == pytest.approx(0.5)


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("times", [[0, 1, 2, 3], [0, 1, 2, 2.5, 3]])
def test_what_is_not_finite_is_equal_to_nothing(odd: float, times: list[float]) -> None:
    fine, broken = results(times, x=times), results([0, 1, 2, 3], x=[0, 1, odd, 3])
    for a, b in ((fine, broken), (broken, fine), (broken, broken)):
        made = compare(a, b, tolerance=1e9, absolute=1e9)
        (one,) = made.differences
        assert not made.is_within
        assert math.isnan(one.absolute)
        assert math.isnan(one.relative)
        assert 1 < one.t <= 2
    worse = compare(results([0, 1], x=[0, 0], y=[0, 1]), results([0, 1], x=[1, 1], y=[0, odd]))
    assert worse.differences[0].relative == math.inf
    assert not worse.differences[1].is_within


# --- units -----------------------------------------------------------------------------------------------------


def test_other_units_of_one_quantity_are_converted_to_those_of_a() -> None:
    a = results([0, 1], units={"x": "V"}, x=[0, 2])
    b = results([0, 1], units={"x": "mV"}, x=[0, 1500])
    (one,) = compare(a, b).differences
    assert (one.unit, one.absolute, one.relative) == ("V", 0.5, 0.25)
    (one,) = compare(b, a).differences
    assert (one.unit, one.absolute) == ("mV", 500.0)


def test_an_unknown_unit_fits_every_other() -> None:
    for ours, theirs in (("V", ""), ("", "V")):
        (one,) = compare(
            results([0, 1], units={"x": ours}, x=[0, 2]), results([0, 1], units={"x": theirs}, x=[0, 2])
        ).differences
        assert one.is_within
        assert one.unit == "V"


def test_different_quantities_are_told_all_at_once() -> None:
    a = results([0, 1], units={"x": "V", "y": "m", "z": "furlong"}, x=[0, 1], y=[0, 1], z=[0, 1])
    b = results([0, 1], units={"x": "A", "y": "rad", "z": "m"}, x=[0, 1], y=[0, 1], z=[0, 1])
    with pytest.raises(UsageError) as caught:
        compare(a, b)
    lines = str(caught.value).splitlines()
    assert lines[:2] == [
        "E505 x.y: is in V in A and in A in B, which are different quantities.",
        "E505 y.y: is in m in A and in rad in B, which are different quantities.",
    ]
    assert lines[2].startswith("E505 z.y: cannot be converted: the unit 'furlong' cannot be read")


# --- what cannot be compared -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("a", "b", "options", "said"),
    [
        (
            results([0], x=[0]), results([0], y=[0]), {},
            "E505 compare: A and B have no signal in common. A has x.y; B has y.y.",
        ),
        (
            results([0, 1], x=[0, 0]), results([2, 3], x=[0, 0]), {},
            "E505 compare: A and B have no time in common: A covers 0 ... 1 s, and B covers 2 ... 3 s.",
        ),
        (results([0], x=[0]), results([], diagram="empty", x=[]), {}, "E505 B (empty): holds no rows."),
        (
            results([0], x=[0]), results([0], x=[0]), {"tolerance": -1.0},
            "E501 tolerance: must be a number of at least 0, not -1.0.",
        ),
        (
            results([0], x=[0]), results([0], x=[0]), {"absolute": math.nan},
            "E501 absolute: must be a number of at least 0, not nan.",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_told(a: Results, b: Results, options: dict[str, float], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        compare(a, b, **options)
    assert str(caught.value) == said
    assert not isinstance(caught.value, ModelError)


# --- over all times, and under other names ----------------------------------------------------------------------


def test_the_rmse_and_the_fit_are_integrals_over_time() -> None:
    t = np.linspace(0, 2 * np.pi, 20_001)
    a, b = results(t, x=np.sin(t)), results(t, x=np.sin(t) + 0.1 * np.cos(t))
    made = compare(a, b).differences[0]
    assert made.rmse == pytest.approx(0.1 / math.sqrt(2), rel=1e-6)
    assert made.fit == pytest.approx(90, rel=1e-6)
    # Times that lie closer at one end do not count for more.
    odd = 2 * np.pi * np.linspace(0, 1, 30_001) ** 3
    again = compare(results(odd, x=np.sin(odd)), results(t, x=np.sin(t) + 0.1 * np.cos(t))).differences[0]
    assert (again.rmse, again.fit) == pytest.approx((made.rmse, made.fit), rel=1e-5)


def test_the_two_sides_of_a_jump_count_for_no_time() -> None:
    a = results([0, 1, 1, 2], x=[0, 0, 1, 1])
    late = compare(a, results([0, 1.5, 1.5, 2], x=[0, 0, 1, 1])).differences[0]
    assert (late.absolute, late.t) == (1, 1)
    assert late.rmse == pytest.approx(0.5)  # 1 for a quarter of the time
    assert late.fit == pytest.approx(0)  # as far off as the mean of a is


@pytest.mark.parametrize(
    ("x", "y", "rmse", "fit"),
    [
        ([0, 1e300], [0, 1e300], 0, 100),
        ([0, 1e300], [0, 2e300], 1e300 / math.sqrt(3), 100 * (1 - 2)),
        ([3, 3], [3, 3], 0, 100),
        ([3, 3], [3, 4], 1 / math.sqrt(3), -math.inf),
        ([0, math.nan], [0, 1], math.nan, math.nan),
    ],
)
def test_the_fit_of_large_constant_and_missing_values(x: list[float], y: list[float], rmse: float, fit: float) -> None:
    made = compare(results([0, 1], x=x), results([0, 1], x=y)).differences[0]
    assert (made.rmse, made.fit) == pytest.approx((rmse, fit), nan_ok=True)


def test_signals_may_have_other_names_in_b() -> None:
    a, b = results([0, 1], x=[0, 1], z=[5, 5]), results([0, 1], speed=[0, 2], z=[5, 5], x=[7, 7])
    made = compare(a, b, names={"x.y": "speed.y"})
    assert [(each.name, each.absolute) for each in made.differences] == [("x.y", 1), ("z.y", 0)]
    assert (made.only_a, made.only_b) == ((), ("x.y",))
    assert compare(a, b, names={"x": "speed"}).differences == made.differences  # all outputs of a block
    swapped = compare(a, b, names={"x": "z", "z": "x"})
    assert [each.absolute for each in swapped.differences] == [5, 2]
    for names, said in (({"y": "z"}, 'E501 names: there is no signal "y" in A'), ({"x": "spee"}, "in B. Did you mean")):
        with pytest.raises(UsageError) as caught:
            compare(a, b, names=names)
        assert said in str(caught.value)


# --- what is shown ---------------------------------------------------------------------------------------------


def test_the_table_marks_what_is_beyond() -> None:
    a = results([0, 1], units={"x": "V"}, x=[0, 2], long_name=[0, 1])
    made = compare(a, results([0, 1], units={"x": "V"}, x=[0, 1.5], long_name=[0, 1]))
    assert made.table().splitlines() == [
        "  signal       unit  difference  of range  at t  RMSE     fit",
        "  x.y          V     0.5         0.25      1     0.28868  50 %   ✗",
        "  long_name.y  -     0           0         0     0        100 %",
    ]
    assert repr(made) == f"<Comparison: 2 signals, beyond 1e-06>\n{made.table()}"


def test_notes_say_what_else_is_different() -> None:
    def run(origin: Origin | None, engine: str, diagram: str, interrupted: bool = False) -> Results:
        made = results([0, 1], x=[0, 1])
        return Results(
            diagram, made.t, made.values, made.columns, statistics=Statistics(engine=engine), interrupted=interrupted,
            origin=origin,
        )  # fmt: skip

    one = Origin("a" * 64, {"numpy": "2.1"}, {"method": "rk4", "step": 0.5}, {"m.R": {"value": 2.0, "unit": "Ohm"}})
    two = Origin("b" * 64, {"numpy": "2.1"}, {"method": "dopri5", "rtol": 1e-6}, {}, {"r.csv": {"sha256": "c" * 64}})
    assert compare(run(one, "native", "d"), run(two, "reference", "e", True)).notes == (
        "diagrams: d | e",
        "engines: native | reference",
        "B was interrupted",
        "SHA-256 of the diagrams: aaaaaaaaaaaa | bbbbbbbbbbbb",
        "settings: method rk4 | dopri5",
        "settings: step 0.5 | -",
        "settings: rtol - | 1e-06",
        "parameters: m.R 2.0 Ohm | -",
        "inputs: r.csv - | SHA-256 cccccccccccc",
    )
    assert compare(run(one, "native", "d"), run(one, "native", "d")).notes == ()
    assert compare(run(None, "", "d"), run(one, "", "d")).notes == ()


def test_a_run_is_as_near_to_a_finer_one_as_its_steps_allow() -> None:
    """x' = step at 1/4 s: a ramp, which every method has to a few ulp though their steps differ."""
    diagram = Diagram("ramp")
    step, x = diagram.add("step", Step(at=0.25)), diagram.add("x", Integrator())
    diagram.wire(x.u, step.y)
    made = compare(diagram.run(stop=1.0), diagram.run(stop=1.0, method="rk4", step=0.0625), tolerance=1e-14)
    assert made.is_interpolated
    assert made.is_within, made


def test_files_are_compared_by_their_paths(tmp_path: Path) -> None:
    a, b = results([0, 1, 2], x=[0, 1, 2]), results([0, 1, 2], x=[0, 1, 2.5])
    paths = [tmp_path / "a.csv", str(tmp_path / "b.csv")]
    for one, path in zip((a, b), paths, strict=True):
        one.save(path)
    worst = compare(paths[0], paths[1]).worst
    assert (worst.name, worst.absolute, worst.relative, worst.t) == ("x.y", 0.5, 0.25, 2.0)
    assert compare(a, paths[1]).worst == compare(paths[0], b).worst == worst
    with pytest.raises(UsageError) as caught:
        compare(a, tmp_path / "none.csv")
    assert caught.value.code == "E503"


def test_names_that_pair_no_elements_are_refused_and_hide_no_signal() -> None:
    a, b = results([0, 1], x=[0, 1], z=[5, 5]), results([0, 1], x=[0, 1], w=[5, 5])
    with pytest.raises(UsageError, match=r'E501 names: "x" in A and "w\.y" in B have no elements in common\.'):
        compare(a, b, names={"x": "w.y"})
    for names in (["x.y"], {"x.y": 3}):
        with pytest.raises(UsageError, match="E501 names: must be a mapping from names in A to names in B"):
            compare(a, b, names=names)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="E501 b: must be results or the path of a result file, not Signal"):
        compare(a, b["x.y"])  # type: ignore[arg-type]
