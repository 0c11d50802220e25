"""Measures of step responses: those of python-control on the same samples, and what is no step response."""

import math
from typing import Any

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks import Diagram, Mux, Results, SecondOrder, Step, UsageError

Array = Any
ROUNDING = 1e-9
"""In percent: overshoots are differences of numbers near 1."""


def results_of(y: Array, t: Array) -> Results:
    return Results("r", np.asarray(t, dtype=float), np.asarray(y, dtype=float)[:, None], {"y": (0, (), "V")})


def response(d: float = 0.3, at: float = 0.0) -> Results:
    diagram = Diagram("response")
    plant = diagram.add("plant", SecondOrder(d=d, w=2.0))
    diagram.wire(plant.u, diagram.add("step", Step(at=at)).y)
    return diagram.run(stop=12.0 + at, every=0.01, rtol=1e-9)


def test_a_step_response_has_the_measures_of_the_formulas() -> None:
    info = response()["plant.y"].step_info(yfinal=1.0)
    damped = 2.0 * math.sqrt(1 - 0.09)
    overshoot = 100 * math.exp(-math.pi * 0.3 / math.sqrt(1 - 0.09))
    assert info["Overshoot"] == pytest.approx(overshoot, abs=0.01)  # rows are 10 ms apart
    assert info["PeakTime"] == pytest.approx(math.pi / damped, abs=0.01)
    assert info["Peak"] == pytest.approx(1 + overshoot / 100, abs=1e-4)
    assert info["SteadyStateValue"] == 1.0
    assert info["Undershoot"] == 0.0


def test_a_whole_run_is_measured_as_python_control_does() -> None:
    for d in (0.1, 0.3, 1.0, 2.0):
        results = response(d)
        y = np.asarray(results["plant.y"])
        assert results["plant.y"].step_info() == pytest.approx(ct.step_info(y, results.t), abs=ROUNDING)
        words: Any = {"SettlingTimeThreshold": 0.05, "RiseTimeLimits": (0.2, 0.8)}
        theirs = ct.step_info(y, results.t, **words)
        assert results["plant.y"].step_info(**words) == pytest.approx(theirs, abs=ROUNDING)
        theirs = ct.step_info(y, results.t, yfinal=0.9)
        assert results["plant.y"].step_info(yfinal=0.9) == pytest.approx(theirs, abs=ROUNDING, nan_ok=True)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=30),
    st.floats(0.1, 2.0) | st.floats(-2.0, -0.1),
    st.floats(0.01, 0.5),
    st.tuples(st.floats(0.0, 0.4), st.floats(0.5, 1.0)),
)
def test_any_samples_are_measured_as_python_control_does(
    values: list[float], final: float, threshold: float, rise: tuple[float, float]
) -> None:
    y = np.array([0.0, *values, final])
    t = np.cumsum(np.linspace(0.1, 0.3, len(y)))
    words: Any = {"SettlingTimeThreshold": threshold, "RiseTimeLimits": rise}
    ours = results_of(y, t)["y"].step_info(**words)
    assert ours == pytest.approx(ct.step_info(y, t, **words), abs=ROUNDING)


def test_times_count_from_the_start_that_is_given() -> None:
    now, later = response()["plant.y"], response(at=2.0)["plant.y"]
    assert later.step_info(start=2.0) == pytest.approx(now.step_info(), abs=1e-6)
    assert later.step_info()["SettlingTime"] == pytest.approx(now.step_info()["SettlingTime"] + 2.0)


def test_what_is_not_reached_has_no_value() -> None:
    t = np.linspace(0.0, 1.0, 11)
    rising = results_of(t, t)["y"].step_info(yfinal=2.0)
    assert {name for name, value in rising.items() if math.isnan(value)} == {
        "RiseTime", "SettlingTime", "SettlingMin", "SettlingMax",
    }  # fmt: skip
    assert (rising["Overshoot"], rising["Peak"], rising["PeakTime"]) == (0.0, 1.0, 1.0)
    back = results_of(np.sin(np.pi * t).round(12), t)["y"].step_info()
    assert math.isnan(back["Overshoot"])  # no share of 0
    assert (back["Peak"], back["PeakTime"], back["SteadyStateValue"]) == (1.0, 0.5, 0.0)
    lost = results_of([0.0, 1.0, math.nan], [0.0, 1.0, 2.0])["y"].step_info()
    assert math.isnan(lost["RiseTime"])


def test_several_signals_make_a_table_by_element() -> None:
    diagram = Diagram("several")
    plant = diagram.add("plant", SecondOrder(d=0.3))
    mux = diagram.add("mux", Mux())
    diagram.wire(plant.u, diagram.add("step", Step()).y)
    diagram.wire(mux.u1, plant.y)
    diagram.wire(mux.u2, "step.y")
    results = diagram.run(stop=10.0, every=0.1)
    table = results.step_info("plant.y", "mux.y", SettlingTimeThreshold=0.05)
    assert [*table] == ["plant.y", "mux.y[0]", "mux.y[1]"]
    assert table["mux.y[0]"] == table["plant.y"] == results["plant.y"].step_info(SettlingTimeThreshold=0.05)
    assert [*results.step_info()] == [name for name, _, _ in results.flat_columns()]
    with pytest.raises(KeyError, match=r"Did you mean 'plant\.y'\?"):
        results.step_info("plnt.y")


def test_a_vector_and_a_part_of_a_signal_are_refused_with_a_cure() -> None:
    results = results_of([0.0, 1.0, 1.0], [0.0, 1.0, 2.0])
    vector = Results("r", results.t, np.zeros((3, 2)), {"y": (0, (2,), "")})["y"]
    for signal, text in (
        (vector, r"E501 y: is not one whole signal: its shape is \(3, 2\), and it has 3 times\. Use results\["),
        (results["y"][1:], r"E501 y: is not one whole signal: its shape is \(2,\)"),
        (results_of([], [])["y"], r"E501 y: has no rows\."),
    ):
        with pytest.raises(UsageError, match=text):
            signal.step_info()
    with pytest.raises(UsageError, match=r"E501 y: has no row from 3 s on\. Let the run last longer\."):
        results["y"].step_info(start=3.0)
