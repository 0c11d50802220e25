"""A case: one value that all verbs of a Diagram take, and one list of its words."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from blocks import Case, Diagram, Gain, Integrator, ModelError, Noise, Normal, Sum, UsageError
from blocks.analysis import SineStream, estimate_response, find_operating_point, limit_cycles, operating_points
from blocks.api.case import ModelWords, Settings, Work
from blocks.cli.options import SETTINGS
from blocks.model.diagram_grammar import RUN


def loop() -> Diagram:
    """x' = k (r - x), with two measures: the integral of the squared error and the total variation."""
    d = Diagram("loop")
    k = d.parameter("k", 2.0)
    r = d.input("r", default=1.0)
    error = d.add("error", Sum(signs="+-"))
    gain = d.add("gain", Gain(k=k))
    x = d.add("x", Integrator())
    d.wire(error.u1, r)
    d.wire(error.u2, x.y)
    d.wire(gain.u, error.y)
    d.wire(x.u, gain.y)
    d.output("y", x.y)
    d.measure("ISE", "ISE", x.y, r)
    d.measure("moved", "total_variation", x.y)
    d.settings(stop=1.0)
    return d


def closed(t: float, k: float = 2.0, r: float = 1.0) -> float:
    return float(r * (1.0 - np.exp(-k * t)))


# --- the value -------------------------------------------------------------------------------------------------


def test_the_words_are_those_of_files_and_of_the_command_line() -> None:
    assert {*Settings.__annotations__} == {*RUN.keys} - {"inputs", "doc"}
    assert {word.replace("-", "_") for word in SETTINGS} <= {*Settings.__annotations__}


def test_a_case_is_frozen_equal_by_value_and_pickled() -> None:
    case = Case(parameters={"k": 3.0}, stop="5 min")
    with pytest.raises(AttributeError, match=r"use case\.updated"):
        case.words = {}  # type: ignore[misc]
    assert case == Case(parameters={"k": 3.0}, stop="300 s").updated(stop="5 min")
    assert pickle.loads(pickle.dumps(case)) == case
    assert repr(Case(stop=2, engine="native")) == "Case(stop=2, engine='native')"


def test_words_on_top_merge_mappings_by_name_and_replace_the_rest() -> None:
    case = Case(parameters={"k": 3.0, "a": 1}, inputs={"r": 2.0}, stop=5, log=["x.y"])
    more = case.updated(parameters={"a": 2}, inputs="r.csv", stop=6, seed=None)
    assert more.words == {"parameters": {"k": 3.0, "a": 2}, "inputs": [{"r": 2.0}, "r.csv"], "stop": 6, "log": ["x.y"]}
    assert case.words == {"parameters": {"k": 3.0, "a": 1}, "inputs": {"r": 2.0}, "stop": 5, "log": ["x.y"]}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d: d.run(stpo=1), "E501 stpo: is not an argument. Did you mean 'stop'?"),
        (lambda d: d.run(5), "E501 case: must be a Case, not int. Examples: run(stop=10), run(Case(stop=10))."),
        (lambda d: Case(budget=1), "E501 budget: is an argument of blocks 0.1. Write max_steps=, "),
        (lambda d: d.run(parameters=[1]), "E501 parameters: must be a mapping of values by path, not list."),
        (lambda d: d.linearizer(held={"r": 1}), "E501 held: is an argument of blocks 0.1. Write inputs=."),
        (lambda d: d.linearize("r", "x.y", outputs=["x.y"]), "E501 outputs: is an argument of blocks 0.1. Write y=."),
        (lambda d: d.sweep({"k": [1]}, budget=5), "E501 budget: is an argument of blocks 0.1. Write max_steps=, "),
        (lambda d: d.sweep({"k": [1]}, resume=False), "E501 resume: is an argument of blocks 0.1. Write restart=True"),
        (lambda d: d.run(held={}), "E501 held: is an argument of blocks 0.1. Write inputs=."),
        (lambda d: d.flatten(settings={"stop": 1}), "E501 settings: is no argument: each setting is one."),
        (lambda d: d.run(measures=5), "E501 measures: must be a list of names of measures, not 5."),
        (lambda d: d.run(measures={"ISE": 1}), "E501 measures: must be a list of names of measures"),
        (lambda d: d.run(variants={"x": 3}), "E501 variants: must be names of variants by path"),
        (lambda d: d.run(parameters={5: 1}), "E501 parameters: must have paths as its names"),
        (lambda d: Case(inputs=5), "E501 inputs: int is neither a mapping of values by name nor the path of a file."),  # type: ignore[arg-type]
        (lambda d: d.prepare(interpolation="x"), "E501 interpolation: must be "),
        (lambda d: d.run(trust=5), "E501 trust: 5 is not a path. Name an FMU, or a folder of FMUs."),
        (lambda d: d.run(resume=False), "E501 resume: must be a snapshot, the path of a saved one, or"),
        (lambda d: d.run(out=5), "E501 out: must be the path of a file, not 5."),
        (lambda d: d.run(progress=5), "E501 progress: must be a function of the time and the stop time."),
        (lambda d: d.prepare().run(5), "E501 case: must be a Case, not int."),
        (lambda d: d.batch(["k"])([[1.0]], budget=5), "E501 budget: is an argument of blocks 0.1. Write max_steps=, "),
        (lambda d: d.batch(["k"])([[1.0]], stop=5), "E501 stop: has no effect here. Leave it out."),
        (lambda d: d.batch(["k"])([[1.0]], thread=5), "E501 thread: is not an argument. Did you mean 'threads'?"),
        (lambda d: d.linearize(inputs=["r"], outputs=["x.y"]), "E501 outputs: is an argument of blocks 0.1. Write y=."),
        (lambda d: d.linearize(inputs=["r"]), 'E501 u: must name a signal. Example: linearize("r", "motor.omega")'),
        (lambda d: d.linearize("r", []), "E501 y: must name a signal."),
        (lambda d: d.linearize("r", "x.y", pade=-1), "E501 pade: must be an order, 1 or more, not -1."),
        (lambda d: d.linearizer(engine="native"), "E501 engine: has no effect here. Leave it out."),
        (lambda d: d.export("x.fmu", inputs={"r": 1}), "E501 inputs: has no effect here. Leave it out."),
        (lambda d: d.flatten(measures=[]), "E501 measures: has no effect here. Leave it out."),
        (lambda d: d.prepare(threads=2), "E501 threads: has no effect here. Leave it out."),
        (
            lambda d: d.tune(minimize="ISE", over={"k": (1, 2)}, method="de"),
            'E501 method: "de" is an optimizer, and method integrates the runs. Write optimizer="de".',
        ),
        (
            lambda d: d.tune(minimize="ISE", over={"k": (1, 2)}, measures=["ISE"]),
            "E501 measures: has no effect here. Leave it out.",
        ),
        (lambda d: d.prepare().run(measures=["ISE"]), "E501 measures: is fixed when the model is prepared."),
        (lambda d: d.run(measures=["IAE"]), "E501 IAE: the diagram has no such measure."),
        (lambda d: d.run(measures="ISE"), "E501 measures: must be a list of texts, not one text."),
    ],
)  # fmt: skip
def test_words_that_have_no_meaning_are_refused_with_what_to_write(call: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        call(loop())
    assert str(caught.value).startswith(message)


def test_names_to_log_are_checked_where_nothing_is_recorded() -> None:
    """Also at the start, from which no run follows; signals that exist change nothing."""
    message = r'E105 run\.log: there is no signal "nope"\. Signals: '
    for at in (None, 0.5):
        with pytest.raises(ModelError, match=message):
            loop().linearize("r", "x.y", at=at, log=["nope"])
        known = loop().linearize("r", "x.y", at=at, log=["x.y"])
        assert np.array_equal(known.A, loop().linearize("r", "x.y", at=at).A)


# --- every verb takes it ---------------------------------------------------------------------------------------


def test_every_verb_takes_a_case_first_among_its_options_and_its_words() -> None:
    verbs: list[Callable[..., Any]] = [
        Diagram.run, Diagram.start, Diagram.prepare, Diagram.batch, Diagram.sweep, Diagram.tune, Diagram.fit,
        Diagram.live, Diagram.linearize, Diagram.linearizer, Diagram.point, Diagram.flatten, Diagram.plan,
        Diagram.check, Diagram.export, find_operating_point, operating_points, limit_cycles, estimate_response,
    ]  # fmt: skip
    for verb in verbs:
        parameters = inspect.signature(verb).parameters
        assert "case" in parameters, verb
        assert parameters["case"].default is None
        assert "parameters" in parameters, verb
        assert not any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters.values()), verb


def test_words_give_the_bits_of_the_case_that_they_make() -> None:
    d, case = loop(), Case(parameters={"k": 3.0}, inputs={"r": 2.0}, stop=0.5, every=0.1, method="rk4", step=0.01)
    words: Any = case.words
    first, second = d.run(case), d.run(**words)
    third = d.run(Case(stop=0.5, every=0.1, method="rk4", step=0.01), parameters={"k": 3.0}, inputs={"r": 2.0})
    assert first["x.y"][-1] == pytest.approx(closed(0.5, 3.0, 2.0), rel=1e-7)
    for other in (second, third, d.prepare(case).run(), d.prepare().run(case), d.start(case).finish()):
        assert np.array_equal(other["x.y"], first["x.y"])
        assert other.measures == first.measures


def test_a_run_takes_the_measures_that_are_chosen() -> None:
    d = loop()
    assert {*d.run(measures=["moved"]).measures} == {"moved"}
    assert {*d.run(Case(measures=[])).measures} == set()
    assert {*d.run().measures} == {"ISE", "moved"}
    assert {*d.prepare(measures=["ISE"]).run().measures} == {"ISE"}


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_inputs_of_a_case_reach_batches_sweeps_and_tunings(engine: str) -> None:
    d, case = loop(), Case(inputs={"r": 2.0}, engine=engine)
    alone = d.run(case, parameters={"k": 3.0})
    assert alone["x.y"][-1] == pytest.approx(closed(1.0, 3.0, 2.0), rel=1e-5)
    batch = d.batch(["k"], case, measures=["ISE", "moved"])
    assert batch([[3.0]]).measures["ISE"][0] == alone.measures["ISE"]
    assert batch.single([3.0]).measures == alone.measures
    sweep = d.sweep({"k": [1.0, 3.0]}, case)
    assert sweep.measures["moved"][1] == alone.measures["moved"]
    assert sweep.single(1).measures == alone.measures
    best = d.tune(case, minimize="abs(moved - 1)", over={"k": (0.1, 3.0)}, optimizer="de", budget=40)
    # |x(1)| = 1 where 2 (1 - exp(-k)) = 1
    assert best.values["k"] == pytest.approx(np.log(2.0), abs=0.05)
    assert best.after["nominal"].measures["moved"] == d.run(case, parameters=best.parameters).measures["moved"]


def test_inputs_over_time_and_from_a_file_reach_the_rows(tmp_path: Any) -> None:
    d, t = loop(), np.array([0.0, 1.0])
    (tmp_path / "r.csv").write_text("time,r\n0,0\n1,1\n")
    ramp = d.run(inputs={"r": (t, t)}).measures["ISE"]
    rows = d.batch(["k"], inputs={"r": (t, t)})
    assert rows([[2.0]]).measures["ISE"][0] == ramp
    assert d.sweep({"k": [2.0]}, inputs=str(tmp_path / "r.csv")).measures["ISE"][0] == ramp
    held = d.run(inputs={"r": (t, t)}, interpolation="hold").measures["ISE"]
    assert d.sweep({"k": [2.0]}, inputs={"r": (t, t)}, interpolation="hold").measures["ISE"][0] == held != ramp


def test_a_case_is_linearized_exported_and_planned_with_its_values(tmp_path: Any) -> None:
    d, case = loop(), Case(parameters={"k": 5.0}, inputs={"r": 2.0}, engine="native", measures=["ISE"])
    assert d.linearize("r", "x.y", case).poles().real.tolist() == pytest.approx([-5.0])
    assert d.linearizer(case).slopes.point.t == 0.0
    assert find_operating_point(d, case)["x.y"] == pytest.approx(2.0)
    assert find_operating_point(d, case, inputs={"r": 3.0})["x.y"] == pytest.approx(3.0)
    [point] = operating_points(d, [0.2], case)
    assert point["x.y"] == pytest.approx(closed(0.2, 5.0, 2.0), rel=1e-5)
    response = estimate_response(d, "r", "x.y", SineStream([5.0]), case)
    assert abs(response.value[0, 0]) == pytest.approx(1 / np.sqrt(2.0), rel=1e-3)
    fmu = d.export(tmp_path / "loop.fmu", case, platforms=())
    assert fmu.path.exists()
    assert d.plan(case).settings.stop == 1


# --- one meaning for each word ---------------------------------------------------------------------------------


def noisy() -> Diagram:
    d = Diagram("noisy")
    noise, x = d.add("noise", Noise(period=0.1)), d.add("x", Integrator())
    gain = d.add("gain", Gain(k=1.0))
    d.wire(gain.u, noise.y)
    d.wire(x.u, gain.y)
    d.measure("ISE", "ISE", x.y, 0.0)
    d.settings(stop=1.0, seed=7)
    return d


def test_the_seed_is_that_of_the_noise_everywhere() -> None:
    d, over = noisy(), {"gain.k": (0.5, 2.0)}
    tuned = d.tune(minimize="ISE", over=over, optimizer="de", budget=8, seed=3)
    assert tuned.before["nominal"].measures == d.run(seed=3).measures != d.run().measures
    other = d.tune(minimize="ISE", over=over, optimizer="de", budget=8, seed=3, search_seed=2)
    assert other.before["nominal"].measures == tuned.before["nominal"].measures
    assert not np.array_equal(other.history.values, tuned.history.values)
    # A sweep begins with the seed of the diagram, as a run does.
    laws = {"gain.k": Normal(1.0, 0.1)}
    rows, same = d.sweep(laws, n=3), d.sweep(laws, n=3, seed=7)
    assert np.array_equal(rows.measures["ISE"], same.measures["ISE"])
    assert rows.measures["ISE"][1] == d.run(seed=int(rows.seeds[1]), parameters={
        "gain.k": float(rows.varied["gain.k"][1])}).measures["ISE"]  # fmt: skip
    assert not np.array_equal(rows.varied["gain.k"], d.sweep(laws, n=3, seed=8).varied["gain.k"])


def test_progress_is_called_with_what_is_done_and_all() -> None:
    d, seen = loop(), list[tuple[float, float]]()
    d.run(progress=lambda t, stop: seen.append((t, stop)), every=0.1)
    assert seen[-1] == (1.0, 1.0)
    assert all(0.0 <= t <= stop == 1.0 for t, stop in seen)
    seen.clear()
    d.sweep({"k": [1, 2, 3]}, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (3, 3)


def test_how_many_runs_are_computed_is_one_value_of_sweeps_and_tunings() -> None:
    names = {*Work.__dataclass_fields__}
    for verb in (Diagram.sweep, Diagram.tune):
        assert names <= {*inspect.signature(verb).parameters}
    assert not names & {*ModelWords.__annotations__}


def test_nothing_that_happens_to_given_values_reaches_a_case() -> None:
    t, u, matrix = np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.eye(2)
    given: dict[str, Any] = {"parameters": {"k": matrix}, "inputs": {"r": (t, u)}, "stops": [0.5], "measures": ["ISE"],
                             "master": {"steps": {"a": 1}}}  # fmt: skip
    case, same = Case(**given), Case(**pickle.loads(pickle.dumps(given)))
    assert case == same
    u[:], matrix[:] = 9.0, 9.0
    given["stops"].append(0.7), given["measures"].append("moved"), given["master"]["steps"].clear()
    given["parameters"].clear()
    assert case == same != Case(**given)
    with pytest.raises(TypeError):
        case.words["stop"] = 3  # type: ignore[index]


def test_an_array_that_changes_after_a_batch_was_made_changes_no_row() -> None:
    d, t, u = loop(), np.array([0.0, 1.0]), np.array([1.0, 2.0])
    batch, alone = d.batch(["k"], inputs={"r": (t, u)}), d.run(inputs={"r": (t, u)})
    u[1] = 50.0
    assert batch([[2.0]]).measures["ISE"][0] == alone.measures["ISE"] == batch.single([2.0]).measures["ISE"]


def test_measures_that_are_added_to_a_list_are_taken_by_the_next_run() -> None:
    d, names = loop(), ["ISE"]
    d.run(measures=names)
    names.append("moved")
    assert {*d.run(measures=names).measures} == {"ISE", "moved"}


@pytest.mark.parametrize(
    ("first", "later", "merged"),
    [
        ({"f.A[0]": 1.0}, {"f.A": [2.0]}, {"f.A": [2.0]}),
        ({"f.A[0]": 1.0, "f.A[1]": 2.0}, {"f.A[1]": 3.0}, {"f.A[0]": 1.0, "f.A[1]": 3.0}),
        ({"f.A": [1.0]}, {"f.A[0]": 2.0}, {"f.A": [1.0], "f.A[0]": 2.0}),
        ({"f_0.T": 1.0, "g.T": 1.0}, {"f_*.T": 3.0}, {"g.T": 1.0, "f_*.T": 3.0}),
        ({"f_*.T": 1.0}, {"f_0.T": 3.0}, {"f_*.T": 1.0, "f_0.T": 3.0}),
        ({"f_0.A[0]": 1.0, "f_0.A[1]": 1.0}, {"f_*.A[1]": 3.0}, {"f_0.A[0]": 1.0, "f_*.A[1]": 3.0}),
        ({"m[1].T": 1.0}, {"m.T": 3.0}, {"m.T": 3.0}),
        ({"m.T": 1.0}, {"m[1].T": 3.0}, {"m.T": 1.0, "m[1].T": 3.0}),
        ({"a.b.T": 1.0}, {"a*.T": 3.0}, {"a.b.T": 1.0, "a*.T": 3.0}),
    ],
)
def test_a_later_layer_replaces_all_that_it_covers(
    first: dict[str, Any], later: dict[str, Any], merged: dict[str, Any]
) -> None:
    assert Case(parameters=first).updated(parameters=later).parameters == merged


def test_a_pattern_on_top_of_a_name_counts_in_runs_and_in_prepared_models() -> None:
    d = loop()
    case, wanted = Case(parameters={"x.y_start": 1.0}), d.run(parameters={"x.y_start": 3.0}).measures
    over: Any = {"parameters": {"x*.y_start": 3.0}}
    assert d.run(case, **over).measures == wanted == d.prepare(case).run(**over).measures
    scenario = d.sweep({"k": [2.0]}, case, scenarios={"far": over["parameters"]})
    assert scenario.measures["ISE"][0] == pytest.approx(wanted["ISE"], rel=1e-12)


def test_a_sweep_and_a_tuning_go_on_only_with_the_inputs_of_their_part(tmp_path: Any) -> None:
    d, vary = loop(), {"k": [1.0, 2.0, 3.0]}

    def stops(done: int, total: int) -> None:
        if 0 < done < total:
            raise KeyboardInterrupt

    out = tmp_path / "s.parquet"
    for inputs in ({"r": 2.0}, {"r": (np.arange(3.0), np.ones(3))}):
        assert d.sweep(vary, out=out, inputs=inputs, progress=stops, threads=1, restart=True).interrupted
        with pytest.raises(UsageError, match=r"E506 .* differs in its inputs"):
            d.sweep(vary, out=out, inputs={"r": 3.0})
        with pytest.raises(UsageError, match=r"E506 .* differs in its inputs"):
            d.sweep(vary, out=out)
        assert len(d.sweep(vary, out=out, inputs=inputs).counts()) == 1
    asked: Any = {"minimize": "ISE", "over": {"k": (1.0, 5.0)}, "optimizer": "de", "budget": 60}
    asked |= {"out": tmp_path / "t.parquet", "threads": 1}

    def later(done: int, total: int) -> None:
        if done > 40:
            raise KeyboardInterrupt

    assert d.tune(inputs={"r": 2.0}, progress=later, **asked).interrupted
    with pytest.raises(UsageError, match=r"E506 .* differs in its inputs"):
        d.tune(inputs={"r": 3.0}, **asked)


def test_points_of_long_inputs_that_differ_in_the_middle_are_told_apart() -> None:
    d, t = loop(), np.linspace(0.0, 1.0, 3000)
    first, second = np.zeros(3000), np.zeros(3000)
    second[100:2000] = 5.0
    points = [d.point(at=0.9, inputs={"r": (t, u)}).outputs for u in (first, second, first)]
    assert np.array_equal(points[0], points[2])
    assert not np.array_equal(points[0], points[1])


def test_a_fit_takes_what_the_data_do_not_determine_from_a_case() -> None:
    d = loop()
    d.output("gained", "gain.y")
    t = np.linspace(0.0, 1.0, 21)
    u = ([0.0, 0.5, 1.0], [0.0, 1.0, 2.0])
    truth = d.run(inputs={"r": u}, interpolation="hold", every=0.05)
    data = {"time": t, "x": truth["x.y"]}
    case = Case(inputs={"r": u}, interpolation="hold", stop=7, every=0.3, log=["gain.y"], parameters={"k": 3.0})
    fit = d.fit(data, case, over={"k": (1.0, 5.0)}, compare={"x.y": "x"})
    assert fit.values["k"] == pytest.approx(2.0, rel=1e-4)
    with pytest.raises(UsageError, match="E501 stop: cannot be given"):
        d.fit(data, over={"k": (1.0, 5.0)}, compare={"x.y": "x"}, stop=1.0)
    with pytest.raises(UsageError, match="E501 inputs: r is given, and the data have a column of it"):
        d.fit({**data, "r": np.ones(21)}, case, over={"k": (1.0, 5.0)}, compare={"x.y": "x"})


def test_an_operating_point_is_used_with_the_case_that_it_was_found_with() -> None:
    d, case = loop(), Case(parameters={"k": 5.0}, inputs={"r": 2.0}, stop=3)
    point = find_operating_point(d, case)
    assert d.linearize("r", "x.y", case, at=point).poles().real.tolist() == pytest.approx([-5.0])
    with pytest.raises(UsageError, match=r"E501 inputs\.r: is a table over time, which has no value at rest"):
        find_operating_point(d, Case(inputs={"r": ([0.0, 1.0], [1.0, 2.0])}))
    with pytest.raises(UsageError, match="the operating point has its inputs"):
        d.linearize("r", "x.y", case, at=point, inputs={"r": 3.0})
