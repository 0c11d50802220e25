"""Results: signals by name, tables, files; what a caller may and may not do with them."""

import csv
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    BouncingBall,
    Constant,
    Diagram,
    FirstOrder,
    Integrator,
    Product,
    Results,
    SimulationError,
    Sine,
    StateSpace,
    Step,
    UsageError,
)
from blocks.engines.run.recording import CHUNK, Recording
from blocks.model.fingerprint import fingerprint
from blocks.results import plots
from blocks.results.results import Event, Events, Signal, Statistics
from tests.contract.test_types import Cycle

GRAVITY = 9.81


def results(**settings: Any) -> Results:
    diagram = Diagram("shown")
    r = diagram.input("r", unit="V", default=2.0)
    step, x = diagram.add("step", Step(at=0.5, unit="V")), diagram.add("x", Integrator(unit="V.s"))
    diagram.add("s", StateSpace(A=[[0.0, 0.0], [0.0, 0.0]], B=[[1.0], [2.0]], C=[[1.0, 0.0], [0.0, 1.0]]))
    diagram.wire(x.u, r)
    diagram.wire("s.u[0]", step.y)
    return diagram.run(**{"stop": 1.0, "every": 0.25, "jumps": True, **settings})


def test_a_signal_has_its_times_its_unit_and_its_name() -> None:
    made = results()
    x = made["x.y"]
    assert isinstance(x, Signal)
    assert (x.name, x.unit) == ("x.y", "V.s")
    assert np.array_equal(x.t, made.t)
    assert x.tolist() == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.5, 2.0], abs=1e-14)
    assert made["r"].unit == "V"


def test_what_is_computed_from_a_signal_is_plain_numbers() -> None:
    x = results()["x.y"]
    for made in (x + 1, 2 * x, np.sin(x), x[1:] - x[:-1], x @ x, x.max()):
        assert type(made) is not Signal
    assert isinstance(x.mean(), float)
    part = x[1:3]
    assert part.tolist() == pytest.approx([0.5, 1.0])


def test_elements_of_a_vector_have_names() -> None:
    made = results()
    assert made["s.y"].shape == (len(made.t), 2)
    assert np.array_equal(made["s.y[1]"], made["s.y"][:, 1])
    assert made["s.y[1]"].name == "s.y[1]"
    for wrong in ("s.y[2]", "s.y[-1]", "s.y[x]", "x.y[0]", "s.y[", "nothing"):
        with pytest.raises(KeyError):
            made[wrong]


def test_a_name_that_is_not_there_is_told_with_the_nearest() -> None:
    with pytest.raises(KeyError, match=r"no recorded signal 'x\.z'.*Did you mean 'x\.y'.*Recorded: "):
        results()["x.z"]


def test_an_unknown_measure_is_refused_with_the_known_names() -> None:
    some = results().changed(measures={"ITAE": 1.0, "dip": 2.0})
    assert some.measures == {"ITAE": 1.0, "dip": 2.0}
    with pytest.raises(KeyError, match=r"no measure 'IAE'\. Did you mean 'ITAE'\? Measures: ITAE, dip\."):
        some.measures["IAE"]
    with pytest.raises(KeyError, match=r"no measure 3\. Measures: none\."):
        results().measures[3]  # type: ignore[index]
    assert some.measures.get("IAE") is None
    assert pickle.loads(pickle.dumps(some)).measures == some.measures


def test_results_are_a_collection_of_names() -> None:
    made = results(log=["x.y", "step.y"])
    assert list(made) == ["x.y", "step.y"] == list(made.names)
    assert "x.y" in made
    assert "r" not in made
    assert len(made.flat_columns()) == 2


def test_arrays_of_results_cannot_be_changed() -> None:
    made = results()
    for array in (made.t, made.values, made["x.y"], made["s.y"], made["x.y"].t):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    copy = made["x.y"].copy()
    copy[0] = 1.0


def test_results_of_a_run_under_way_do_not_change_when_it_goes_on() -> None:
    diagram = Diagram("on")
    diagram.add("x", Integrator())
    diagram.wire("x.u", diagram.input("r"))
    run = diagram.start(inputs={"r": 1.0}, stop=2.0)
    run.advance(1.0)
    first = run.results
    kept = first.t.copy(), first.values.copy(), first.events
    run.set("r", 5.0)
    run.advance(1.0)
    assert np.array_equal(first.t, kept[0])
    assert np.array_equal(first.values, kept[1])
    assert first.events == kept[2]
    assert len(run.results.t) > len(first.t)


def test_the_summary_has_the_least_the_largest_and_the_last() -> None:
    summary = results().summary()
    assert summary["x.y"] == {"unit": "V.s", "min": 0.0, "max": pytest.approx(2.0), "end": pytest.approx(2.0)}
    assert summary["s.y[1]"]["end"] == pytest.approx(1.0)
    assert list(summary) == [name for name, _, _ in results().flat_columns()]


def test_the_table_has_a_line_for_each_element_and_spark_lines() -> None:
    made = results()
    lines = made.table().splitlines()
    assert lines[0].split() == ["signal", "unit", "min", "max", "end"]
    assert len(lines) == 1 + len(made.flat_columns())
    assert any("▁" in line and "█" in line for line in lines)
    assert "... and 3 more" in made.table(most=len(made.flat_columns()) - 3)
    assert repr(made).startswith(f"<Results of shown: {len(made.columns)} signals, {len(made.t)} rows>\n")


def test_a_csv_file_gives_back_every_double(tmp_path: Path) -> None:
    diagram = Diagram("written")
    diagram.add("s", Sine(omega=7.0))
    made = diagram.run(stop=1.0, every=0.01)
    path = tmp_path / "out.csv"
    made.to_csv(path)
    with open(path, newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["time", "s.y"]
    assert [float(row[0]) for row in rows[1:]] == made.t.tolist()
    assert [float(row[1]) for row in rows[1:]] == made["s.y"].tolist()


@pytest.mark.parametrize("ending", ["csv", "parquet", "mat"])
def test_a_saved_run_comes_back_with_both_sides_of_its_jumps(ending: str, tmp_path: Path) -> None:
    made = results()
    path = tmp_path / f"shown.{ending}"
    made.save(path)
    back = Results.load(path)
    assert (back.diagram, back.columns) == (made.diagram, made.columns)
    assert np.array_equal(back.t, made.t)
    assert np.array_equal(back.values, made.values)
    assert back["step.y"][back.t == 0.5].tolist() == [0.0, 1.0]
    assert (back["s.y[1]"].unit, back["x.y"].unit) == ("", "V.s")
    assert (back.events, back.measures) == ((), {})
    assert back.statistics.engine == "reference"
    with pytest.raises(ValueError, match="read-only"):
        back.values[0] = 1.0


def test_results_know_their_diagram_settings_parameters_and_inputs() -> None:
    diagram = Diagram("known")
    diagram.add("x", Integrator())
    diagram.wire("x.u", diagram.input("r"))
    made = diagram.run(stop=1.0, inputs={"r": 2.0}, parameters={"x.y_start": 3.0})
    assert made.origin is not None
    assert made.origin.sha256 == fingerprint(diagram.value)
    assert made.origin.settings["stop"] == 1.0
    assert made.origin.parameters == {"x.y_start": 3.0}
    assert made.origin.inputs == {"r": 2.0}
    run = diagram.start(inputs={"r": 2.0}, stop=1.0)
    plain = run.results.origin
    assert plain is not None
    assert plain == replace(made.origin, parameters={}, values=plain.values)
    assert plain.values != made.origin.values
    run.set("r", 3.0)
    assert run.results.origin is None


def test_what_is_kept_of_a_failed_run_has_an_origin() -> None:
    diagram = Diagram("escape")
    square, y = diagram.add("square", Product()), diagram.add("y", Integrator(y_start=1.0))
    for sink in (square.u1, square.u2):
        diagram.wire(sink, y.y)
    diagram.wire(y.u, square.y)
    with pytest.raises(SimulationError) as caught:
        diagram.run(stop=2.0)
    assert caught.value.results.origin.sha256 == fingerprint(diagram.value)


def test_events_are_tuples_with_names() -> None:
    made = results()
    assert made.events == (Event(0.5, "step", "edge"),)
    t, block, what = made.events[0]
    assert (t, block, what) == (0.5, "step", "edge")
    assert repr(made.events[0]) == "Event(t=0.5, block='step', what='edge')"


def many() -> tuple[Events, tuple[Event, ...]]:
    told = (("step", "edge"), ("ball", "impact"), ("loop.limit", "upper"))
    events = Events(np.array([0.0, 0.1, 0.1, 0.5, 2.0]), np.array([2, 0, 1, 1, 0]), told)
    return events, tuple(Event(t, *told[k]) for t, k in ((0.0, 2), (0.1, 0), (0.1, 1), (0.5, 1), (2.0, 0)))


def test_events_as_arrays_are_as_good_as_a_tuple_of_them() -> None:
    events, plain = many()
    assert (events == plain, plain == events, events != plain) == (True, True, False)
    assert [*events] == [*plain]
    assert all(type(event) is Event and type(event.t) is float for event in (*events, events[1]))
    assert len(events) == 5
    for index in (0, 3, 4, -1, -5):
        assert events[index] == plain[index]
    for index in (5, -6):
        with pytest.raises(IndexError):
            events[index]
    for part in (slice(2), slice(None, None, -1), slice(1, 4, 2), slice(7, 9)):
        assert events[part] == plain[part]
    assert (repr(events), hash(events)) == (repr(plain), hash(plain))
    assert plain[1] in events
    assert Event(0.1, "ball", "edge") not in events
    assert (events.index(plain[3]), events.count(plain[3])) == (3, 1)
    assert [*reversed(events)] == [*reversed(plain)]
    assert events + plain[:1] == plain + plain[:1]
    assert plain[:1] + events == plain[:1] + plain
    assert events[5:] == ()
    assert pickle.loads(pickle.dumps(events)) == plain


def test_events_differ_by_time_block_what_and_number() -> None:
    events, plain = many()
    assert events != plain[:-1]
    assert events != events[:-1]
    assert events != list(plain)  # nor is a tuple equal to a list
    for k, other in enumerate((Event(0.2, "step", "edge"), Event(0.1, "stop", "edge"), Event(0.1, "step", "end"))):
        assert events != (plain[0], other, *plain[2:]), k
    same = Events(events.t, np.array([0, 1, 2, 2, 1]), (("loop.limit", "upper"), ("step", "edge"), ("ball", "impact")))
    assert events == same, "the order of the table says nothing"
    with pytest.raises(ValueError, match="read-only"):
        events.t[0] = 1.0


def test_an_event_is_made_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def counted(*parts: Any) -> Event:
        made.append(parts)
        return Event(*parts)

    monkeypatch.setattr("blocks.results.results.Event", counted)
    events = Events(np.arange(1e5), np.zeros(100_000, dtype=np.int32), (("a", "b"),))
    whole = Results("d", np.empty(0), np.empty((0, 0)), {}, events)
    assert (len(whole.events), len(whole.events[10:20])) == (100_000, 10)
    assert made == []
    assert whole.events[-1].t == 99_999.0
    assert len(made) == 1


def test_statistics_say_how_a_run_went() -> None:
    statistics = results().statistics
    assert isinstance(statistics, Statistics)
    assert (statistics.method, statistics.engine) == ("dopri5", "reference")
    assert statistics.steps >= 50
    assert statistics.instants == 3  # start, edge, stop
    assert 0 < statistics.seconds < 60


def test_a_run_without_signals_has_rows_of_time() -> None:
    made = results(log=[])
    assert made.values.shape == (len(made.t), 0)
    assert made.summary() == {}
    assert made.table()


def spark_line(t: Any, values: Any) -> str:
    made = Results("d", t, values[:, np.newaxis], {"y": (0, (), "")})
    return made.table().splitlines()[1].split()[-1]


def test_spark_lines_follow_the_signal_over_time() -> None:
    t = np.linspace(0.0, 1.0, 1000)
    assert spark_line(t, t) == "▁▁▂▃▄▅▆▇██" or spark_line(t, t)[0] == "▁"
    assert spark_line(t, t)[-1] == "█"
    assert spark_line(t, np.ones(1000)) == "▄" * 10
    assert spark_line(t, np.full(1000, math.nan)) == "?" * 10
    uneven = np.concatenate([np.linspace(0, 0.01, 999), [1.0]])  # nearly all rows at the beginning
    assert spark_line(uneven, uneven).count("▁") >= 8


def test_a_recording_grows_by_chunks_and_keeps_its_rows() -> None:
    recording = Recording(2)
    for k in range(3 * CHUNK + 7):
        recording.add(float(k), (k + 0.25, -k))
    t, values = recording.arrays()
    assert len(t) == 3 * CHUNK + 7
    assert np.array_equal(t, np.arange(len(t)))
    assert np.array_equal(values, np.column_stack([t + 0.25, -t]))
    assert recording.last == (t[-1], (t[-1] + 0.25, -t[-1]))


def test_a_constant_diagram_has_results() -> None:
    diagram = Diagram("still")
    diagram.add("c", Constant(value=4.0))
    made = diagram.run(stop=1.0, every=0.5)
    assert made.t.tolist() == [0.0, 0.5, 1.0]
    assert made["c.y"].tolist() == [4.0] * 3


def test_a_figure_has_the_size_the_ranges_and_the_labels_that_are_given() -> None:
    made = results()
    figure = made.plot(
        "r", "x.y", size=(3.5, 3), title="a run", xlabel="t", xlim=(0.25, 0.5), ylim=[(0, 4), None], ylabel=["in", None]
    )
    first, second = figure.axes
    assert figure.get_size_inches().tolist() == [3.5, 3.0]
    assert (first.get_ylabel(), second.get_ylabel()) == ("in", "x.y [V.s]")
    assert first.get_xlim() == second.get_xlim() == (0.25, 0.5)
    assert first.get_ylim() == (0, 4)
    assert second.get_ylim()[1] < 1.2  # it follows what is seen
    assert (figure.get_suptitle(), figure.get_supxlabel()) == ("a run", "t")
    assert made.plot("r", ylim=(0, 4), ylabel="all", beside={"b": results()}).axes[0].get_ylim() == (0, 4)


@pytest.mark.parametrize(
    ("look", "message"),
    [
        ({"size": (6,)}, r"E501 plot\(size=\): \(6,\) is not a width and a height in inches, such as \(6, 4\)"),
        ({"size": (0, 4)}, "is not a width"),
        ({"size": (math.inf, 4)}, "is not a width"),
        ({"xlim": (2, 1)}, r"plot\(xlim=\): \(2, 1\) is not the start and the end of the axis"),
        ({"ylim": [(0, 1), (0, 1), (0, 1)]}, "or a list with one for each of 2 panels"),
        ({"ylim": (1, 1)}, "is not the least and the largest value"),
        ({"ylabel": 3}, r"plot\(ylabel=\): 3 is not a text"),
        ({"title": None}, r"plot\(title=\): None is not a text"),
        ({"xlimit": (0, 1)}, r"E501 plot\(xlimit=\): there is no such option\. Did you mean 'xlim'\?"),
    ],
)
def test_a_look_that_no_figure_can_have_is_refused(look: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        results().plot("r", "x.y", **look)


def ball(engine: str, **settings: Any) -> Results:
    """A ball from 2.5 m that keeps 0.9 of its speed: each flight is one step."""
    diagram = Diagram("ball")
    diagram.add("ball", BouncingBall(e=0.9, h_start=2.5))
    return diagram.run(engine=engine, **{"stop": 12, **settings})


def flights(t: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The height of the ball, by the parabola of each flight."""
    begins, speeds = [0.0], [0.0]
    begins.append(math.sqrt(2 * 2.5 / GRAVITY))
    speeds.append(0.9 * math.sqrt(2 * 2.5 * GRAVITY))
    while begins[-1] < t[-1]:
        begins.append(begins[-1] + 2 * speeds[-1] / GRAVITY)
        speeds.append(0.9 * speeds[-1])
    flight = np.maximum(np.searchsorted(begins, t, side="right") - 1, 0)
    since, height = t - np.array(begins)[flight], np.where(flight == 0, 2.5, 0.0)
    return height + np.array(speeds)[flight] * since - GRAVITY * since**2 / 2


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_figure_follows_the_solver_between_the_rows(engine: str) -> None:
    made = ball(engine)
    line = made.plot("ball.h").axes[0].lines[0]
    t, h = line.get_xdata(), line.get_ydata()
    assert np.abs(h - flights(t)).max() < 1e-6
    at = np.linspace(0, 12, 5000)
    assert np.abs(np.interp(at, t, h) - flights(at)).max() < 1e-4  # g (8 ms)^2 / 8: impacts have rows
    assert np.abs(np.interp(at, made.t, made["ball.h"]) - flights(at)).max() > 0.05  # lines from step to step
    smooth = made.smooth()
    rows = np.isin(smooth.t, made.t)
    assert np.array_equal(smooth.t[rows], made.t)
    assert np.array_equal(smooth.values[rows], made.values)
    assert made.smooth((0.0, 0.1)).rows > smooth.rows
    assert np.array_equal(made.smooth((-np.inf, np.inf)).t, smooth.t)


def test_results_whose_run_is_not_repeated_have_their_own_rows(tmp_path: Path) -> None:
    gridded = ball("native", every=0.5)
    assert gridded.smooth() is gridded
    made = ball("native")
    made.save(tmp_path / "ball.csv")
    for each in (pickle.loads(pickle.dumps(made)), Results.load(tmp_path / "ball.csv")):
        assert each.smooth() is each
    # The input of the run is another one by the time of the figure.
    diagram = Diagram("given")
    diagram.wire(diagram.add("x", Integrator()).u, diagram.input("u"))
    table = tmp_path / "u.csv"
    table.write_text("time,u\n0,1\n1,3\n")
    again = diagram.run(stop=1, inputs=table)
    assert again.smooth().rows > again.rows
    table.write_text("time,u\n0,1\n1,4\n")
    assert again.smooth() is again


def test_held_signals_are_drawn_in_steps_and_enumerations_by_name() -> None:
    diagram = Diagram("machine")
    cycle, lag = diagram.add("cycle", Cycle()), diagram.add("lag", FirstOrder(T=1.0))
    diagram.wire(lag.u, cycle.half)
    made = diagram.run(stop=4.2, every=0.7)
    phase, half, smooth = (made.plot(name).axes[0] for name in ("cycle.phase", "cycle.half", "lag.y"))
    assert [text.get_text() for text in phase.get_yticklabels()] == ["IDLE", "RUN", "STOP"]
    for axis, name in ((phase, "cycle.phase"), (half, "cycle.half")):
        t, y = axis.lines[0].get_xdata(), axis.lines[0].get_ydata()
        assert set(y) == set(made[name]), "no value that the signal never has"
        assert not np.any((np.diff(t) > 0) & (np.diff(y) != 0)), "no slopes"
        at = np.linspace(0.01, 4.19, 997)
        np.testing.assert_array_equal(np.interp(at, t, y), made[name][np.searchsorted(made.t, at, side="right") - 1])
    np.testing.assert_array_equal(smooth.lines[0].get_xdata(), made.t)


def test_texts_fit_a_figure_in_a_column_of_a_paper() -> None:
    made = results()
    for size in ((3.5, 3.0), (3.5, 2.0), (2.0, 1.2)):
        figure = made.plot("x.y", size=size, title="a title", ylabel="a long name of a signal [unit]")
        figure.draw_without_rendering()
        label, whole = figure.axes[0].yaxis.label.get_window_extent(), figure.bbox
        title = figure._suptitle.get_window_extent()
        assert 0 <= label.y0 < label.y1 <= whole.y1
        assert label.x0 >= 0
        assert not label.overlaps(title)


def test_pdf_of_a_figure_has_no_fonts_of_type_3(tmp_path: Path) -> None:
    figure = results().plot("x.y")
    figure.savefig(tmp_path / "a.pdf")
    plots.save(figure, tmp_path / "b.pdf")
    for name in ("a.pdf", "b.pdf"):
        text = (tmp_path / name).read_bytes()
        assert b"/Type3" not in text
        assert b"/CIDFontType2" in text
