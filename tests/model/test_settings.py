"""The settings of a run: what each may be, and what is said where it is not."""

from dataclasses import replace
from enum import IntEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, ModelError, Sine, UsageError
from blocks.library import LIBRARY
from blocks.model import document
from blocks.model.flatten import flatten
from blocks.model.settings import MasterSettings, RunSettings, read_settings, seconds
from blocks.text.errors import Fault
from blocks.text.json_number import Number


def fine(**raw: Any) -> RunSettings:
    made, faults = read_settings(raw)
    assert faults == []
    return made


def refused(key: str, **raw: Any) -> tuple[str, str]:
    """The message and the cure of the only fault, which is one of `key`."""
    _, faults = read_settings(raw)
    assert [fault[0] for fault in faults] == [key]
    return faults[0][2], faults[0][3]


class Seconds(float):
    """A number of a class of one's own."""


def test_numbers_of_other_classes_are_numbers() -> None:
    made = fine(stop=Seconds(2.0), rtol=np.float32(0.5), seed=IntEnum("Seeds", {"FIRST": 3})(3))
    assert (float(made.stop or 0), made.rtol, made.seed) == (2.0, 0.5, 3)
    assert "must be" in refused("seed", seed=True)[0]


def test_without_settings_the_defaults_hold() -> None:
    made = fine()
    assert (made.start, made.stop, made.method, made.step, made.rtol, made.atol) == (
        0,
        None,
        "dopri5",
        None,
        1e-6,
        1e-9,
    )
    assert (made.every, made.stops, made.inputs, made.log) == (None, (), {}, None)


@pytest.mark.parametrize(
    ("raw", "exact"),
    [
        (Number("0.1"), Fraction(1, 10)),
        (Number("1e-7"), Fraction(1, 10**7)),
        (0.1, Fraction(1, 10)),
        (np.float64(0.1), Fraction(1, 10)),
        (np.int64(3), Fraction(3)),
        (3, Fraction(3)),
        (Fraction(1, 3), Fraction(1, 3)),
        ({"value": Number("2.5"), "unit": "ms"}, Fraction(1, 400)),
        ({"value": 2, "unit": "min"}, Fraction(120)),
        ({"value": 2}, Fraction(2)),
    ],
)
def test_a_time_is_exact(raw: Any, exact: Fraction) -> None:
    assert seconds(raw) == exact


@pytest.mark.parametrize(
    ("raw", "part"),
    [
        ("1", 'not "1".'),
        (True, "not true."),
        (None, "not null."),
        ([1], "not a list."),
        ({}, "not null."),
        ({"value": 1, "unit": 5}, "a text as its unit, not 5."),
        ({"value": 1, "unit": "m"}, "not a number of m."),
        ({"value": 1, "unit": "sek"}, "sek"),
        ({"value": {"value": 1}}, "not an object."),
        ({"value": 1, "unit": "s.rev/rad"}, "without pi"),
        (float("inf"), "finite"),
        (float("nan"), "finite"),
        (10**400, "outside the range"),
        ({"value": Number("1e308"), "unit": "min"}, "outside the range"),
        (Number("1e-300"), "outside the range"),
        ("x" * 100_000, "..."),
        (1 + 2j, "must be a time"),
    ],
)
def test_what_is_no_time_is_a_value_error_with_a_short_sentence(raw: Any, part: str) -> None:
    with pytest.raises(ValueError, match=r"\w") as caught:
        seconds(raw)
    assert part in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("key", ["step", "every"])
@pytest.mark.parametrize("value", [0, -1, -0.0, {"value": -1, "unit": "ms"}])
def test_a_step_is_above_zero(key: str, value: Any) -> None:
    raw = {key: value, **({"method": "rk4"} if key == "step" else {})}
    assert refused(key, **raw)[0].startswith("must be above 0 s")


def test_the_end_does_not_lie_before_the_start() -> None:
    assert refused("stop", start=2, stop=1)[0] == "is 1.0 s, before the start at 2.0 s."
    assert refused("stop", stop=-1)[0].endswith("before the start at 0.0 s.")
    assert fine(start=1, stop=1).stop == 1
    assert fine(start=-5, stop=-1).start == -5


def test_more_steps_or_rows_than_can_be_counted_are_refused() -> None:
    assert refused("every", stop=1e15, every=1)[0].startswith("gives 1e+15 rows; the limit is 1e+09")
    assert refused("step", stop=1e15, step=1e-15, method="rk4")[1].startswith("Make it")


@pytest.mark.parametrize("key", ["rtol", "atol"])
@pytest.mark.parametrize("value", [0, -1, 1, True, "1e-6", None, [1e-6], float("nan"), {"value": 1}])
def test_a_tolerance_is_a_number_between_0_and_1(key: str, value: Any) -> None:
    assert refused(key, **{key: value})[0].startswith("must be a number between 0 and 1, not ")


def test_a_tolerance_below_the_spacing_of_doubles_is_refused() -> None:
    assert refused("rtol", rtol=1e-15) == ("1e-15 is below the precision of a double.", "Use 1e-13 or more.")
    assert fine(atol=1e-300).atol == 1e-300


@pytest.mark.parametrize("value", [5, None, True, ["rk4"], {"rk4": 1}, "RK4", "x" * 100_000])
def test_an_unknown_method_is_refused(value: Any) -> None:
    message, cure = refused("method", method=value)
    assert message.endswith(" is not known.")
    assert len(message) < 100
    assert cure


def test_a_method_is_guessed() -> None:
    assert refused("method", method="dopri") == ('"dopri" is not known.', "Did you mean 'dopri5'?")


def test_a_fixed_step_method_needs_a_step_and_the_others_take_none() -> None:
    assert refused("method", method="rk4")[1] == 'Set "step" (--step).'
    assert refused("step", method="radau", step=0.1)[1] == "Leave the step out, or use rk4 or euler."
    assert fine(method="euler", step=0.1).is_fixed_step


def test_another_method_takes_the_step_of_the_file_away() -> None:
    made, faults = read_settings({"method": "rk4", "step": 0.1}, method="dopri5")
    assert (faults, made.step, made.method) == ([], None, "dopri5")
    _, faults = read_settings({"method": "rk4", "step": 0.1}, method="dopri5", step=0.2)
    assert [fault[0] for fault in faults] == ["step"]
    made, faults = read_settings({"method": "rk4", "step": 0.1}, method="euler")
    assert (faults, made.step) == ([], Fraction(1, 10))


def test_an_override_that_is_none_is_none() -> None:
    assert read_settings({"stop": 2, "log": ["a"]}, stop=None, log=None)[0].stop == 2


def test_stops_are_sorted_and_each_once() -> None:
    assert fine(stops=[3, {"value": 1, "unit": "min"}, 1, 1.0]).stops == (1, 3, 60)
    assert refused("stops", stops=5)[0] == "must be a list of times, not 5."
    assert refused("stops", stops="12")[0] == 'must be a list of times, not "12".'
    assert refused("stops", stops=[1, "2"])[0] == 'must be a time in s, not "2".'


@pytest.mark.parametrize("value", ["a", 5, True, {"a": 1}, ["a", 1], None])
def test_the_log_is_a_list_of_names(value: Any) -> None:
    assert refused("log", log=value)[0].startswith("must be a list of signal names, not ")


def test_an_empty_log_records_nothing() -> None:
    assert fine(log=[]).log == ()


@pytest.mark.parametrize("value", [5, "r", [1], None, True])
def test_inputs_are_an_object(value: Any) -> None:
    assert refused("inputs", inputs=value)[0].startswith("must be an object of values by input name, not ")


def test_loops_are_errors_or_solved() -> None:
    assert read_settings({})[0].loops == "error"
    assert read_settings({"loops": "solve"}) == (replace(read_settings({})[0], loops="solve"), [])
    assert fine(loops="error")
    assert refused("loops", loops=5)[0] == "5 is not known."


def test_all_faults_are_told_at_once() -> None:
    _, faults = read_settings({"stop": "x", "rtol": 2, "method": "m", "stops": 1, "log": 1, "inputs": 1, "loops": 1})
    assert [fault[0] for fault in faults] == ["stop", "stops", "rtol", "method", "loops", "inputs", "log"]


# --- in a diagram ----------------------------------------------------------------------------------------------


def faults_of(run: str, **settings: Any) -> tuple[Fault, ...]:
    source = f'{{"format": "blocks-diagram",\n "version": 3,\n "run": {run}}}'
    with pytest.raises(ModelError) as caught:
        flatten(document.loads(source, file="d.json"), LIBRARY.__getitem__, settings=settings)
    return caught.value.faults


def test_a_setting_of_the_file_is_refused_in_its_place() -> None:
    made = faults_of('{"stop": "1",\n  "rtol": 5}')
    assert [(f.code, f.place, f.file, f.line, f.column) for f in made] == [
        ("E115", "run.stop", "d.json", 3, 18),
        ("E115", "run.rtol", "d.json", 4, 11),
    ]


def test_a_setting_of_the_caller_has_no_place_in_the_file() -> None:
    (fault,) = faults_of('{"stop": 1, "rtol": 1e-3}', rtol=7)
    assert (fault.code, fault.place, fault.file, fault.line) == ("E115", "run.rtol", "", 0)


def test_an_input_of_the_run_that_does_not_exist_is_refused() -> None:
    (fault,) = faults_of('{"inputs": {"r": 1}}')
    assert (fault.code, fault.place, fault.line, fault.cure) == ("E502", "run.inputs.r", 3, "Inputs: none.")
    diagram = Diagram("d")
    diagram.input("speed")
    diagram.settings(inputs={"sped": 1})
    with pytest.raises(ModelError, match=r"E502 run.inputs.sped: .* Did you mean 'speed'\?"):
        diagram.flatten()
    other = Diagram("d")
    other.input("speed")
    with pytest.raises(UsageError, match=r"E502 sped: .* Did you mean 'speed'\?"):
        other.prepare(inputs={"sped": 1})


# --- the master ------------------------------------------------------------------------------------------------


def test_without_settings_of_the_master_the_defaults_hold() -> None:
    assert fine().master == MasterSettings(None, {}, "jacobi", 1, None, "together", 20)
    assert fine(master={}).master == fine(master={"x-own": 1}).master == MasterSettings()


def test_settings_of_the_master_are_read_exactly() -> None:
    made = fine(
        stop=1,
        master={
            "step": Number("1e-3"),
            "steps": {"motor": {"value": Number("2"), "unit": "ms"}, "a.b": Fraction(1, 3)},
            "algorithm": "gauss-seidel",
            "order": Number("2"),
            "tolerance": Number("1e-6"),
            "couple": "each",
            "iterations": np.int64(7),
        },
    ).master
    steps = {"motor": Fraction(1, 500), "a.b": Fraction(1, 3)}
    assert made == MasterSettings(Fraction(1, 1000), steps, "gauss-seidel", 2, 1e-6, "each", 7)
    assert isinstance(made.order, int)


@pytest.mark.parametrize(
    ("raw", "key", "message"),
    [
        (5, "master", "must be an object of settings, not 5."),
        ([1], "master", "must be an object of settings, not a list."),
        ({"stpe": 1}, "master", '"stpe" is not known.'),
        ({"step": 0}, "master.step", "must be above 0 s, not 0.0."),
        ({"step": None}, "master.step", "must be a time in s, not null."),
        ({"step": "1 ms"}, "master.step", 'must be a time in s, not "1 ms".'),
        ({"step": 1e-17}, "master.step", "gives 1e+17 steps; the limit is 9.01e+15."),
        ({"steps": 3}, "master.steps", "must be an object of steps by block, not 3."),
        ({"steps": {"m": -1}}, "master.steps", '"m" must be above 0 s, not -1.0.'),
        ({"steps": {"m": True}}, "master.steps", '"m" must be a time in s, not true.'),
        ({"algorithm": "jakobi"}, "master.algorithm", '"jakobi" is not known.'),
        ({"algorithm": None}, "master.algorithm", "null is not known."),
        ({"couple": True}, "master.couple", "true is not known."),
        ({"order": 3}, "master.order", "must be an integer from 0 to 2, not 3."),
        ({"order": 1.5}, "master.order", "must be an integer from 0 to 2, not 1.5."),
        ({"order": True}, "master.order", "must be an integer from 0 to 2, not true."),
        ({"order": float("nan")}, "master.order", "must be an integer from 0 to 2, not nan."),
        ({"iterations": 0}, "master.iterations", "must be an integer from 1 to 10,000, not 0."),
        ({"tolerance": 0}, "master.tolerance", "must be a number between 0 and 1, not 0."),
        ({"tolerance": "x"}, "master.tolerance", 'must be a number between 0 and 1, not "x".'),
        ({"tolerance": None}, "master.tolerance", "must be a number between 0 and 1, not null."),
    ],
)
def test_a_setting_of_the_master_that_is_wrong_is_told(raw: Any, key: str, message: str) -> None:
    assert refused(key, stop=1, master=raw)[0] == message


@pytest.mark.parametrize("step", [0.01, 5])
def test_a_number_in_place_of_the_settings_of_the_master_is_refused_with_what_is_meant(step: float) -> None:
    diagram = Diagram("d")
    diagram.add("wave", Sine())
    with pytest.raises(ModelError, match=rf'E115 run\.master: .* not {step}\. As in \{{"step": {step}\}}\.'):
        diagram.run(stop=1, master=step)


def test_the_master_s_words_are_guessed() -> None:
    assert refused("master", master={"stpe": 1})[1] == 'Did you mean "step"?'
    assert refused("master.algorithm", master={"algorithm": "gauss_seidel"})[1] == 'Did you mean "gauss-seidel"?'
    assert refused("master.couple", master={"couple": 1})[1] == 'Use "together" or "each".'


def test_a_setting_of_the_master_on_top_replaces_that_one_only() -> None:
    raw = {"master": {"step": 0.1, "order": 2, "steps": {"a": 1, "b": 2}}}
    made, faults = read_settings(raw, master={"step": 0.2, "steps": {"b": 3}})
    assert faults == []
    assert made.master == MasterSettings(Fraction(1, 5), {"a": Fraction(1), "b": Fraction(3)}, order=2)
    assert read_settings(raw, master={"step": None, "tolerance": None})[0].master.step is None
    assert read_settings(raw, master=None)[0].master.order == 2


LAG = {
    "format": "blocks-diagram",
    "version": 3,
    "blocks": {"one": {"type": "Constant"}, "lag": {"type": "Integrator"}},
    "wires": {"lag.u": "one.y"},
}


def _lag(**master: Any) -> Diagram:
    return Diagram.from_json({**LAG, "run": {"stop": 1, "master": master}})


def test_a_file_keeps_the_settings_of_the_master() -> None:
    diagram = _lag(step=0.001, steps={"lag": 0.002}, algorithm="iterated")
    assert Diagram.from_json(diagram.dumps()).dumps() == diagram.dumps()
    settings = diagram.plan().settings.master
    assert (settings.step, settings.steps, settings.algorithm) == (
        Fraction(1, 1000),
        {"lag": Fraction(1, 500)},
        "iterated",
    )
    again = diagram.plan(master={"algorithm": "jacobi"}).settings.master
    assert again == replace(settings, algorithm="jacobi")
    diagram.settings(master={"step": 0.5})
    assert diagram.to_json()["run"]["master"] == {"step": 0.5}


def test_faults_of_the_master_stand_where_the_file_has_them(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(_lag(order=5, steps={"lga": 1}).dumps())
    with pytest.raises(ModelError) as caught:
        Diagram.load(path).plan()
    assert [(f.code, f.place, f.path) for f in caught.value.faults] == [
        ("E115", "run.master.order", ("run", "master", "order")),
        ("E115", "run.master.steps", ("run", "master", "steps", "lga")),
    ]
    assert caught.value.faults[1].cure == "Did you mean 'lag'?"
    assert all(fault.line for fault in caught.value.faults)
    with pytest.raises(ModelError) as caught:
        _lag().plan(master={"order": 5})
    assert [(f.code, f.line) for f in caught.value.faults] == [("E115", 0)]
    for wrong, code in (({"oder": 1}, "E003"), (5, "E004")):
        with pytest.raises(ModelError) as caught:
            Diagram.from_json({**_lag().to_json(), "run": {"master": wrong}})
        assert caught.value.code == code


def test_the_origin_of_results_tells_the_master_where_it_is_set() -> None:
    assert not any(key.startswith("master") for key in _lag().run().origin.settings)
    told = _lag(step=0.5, steps={"lag": 0.25}, couple="together").run().origin.settings
    assert {key: value for key, value in told.items() if key.startswith("master")} == {
        "master.step": 0.5,
        "master.steps": {"lag": 0.25},
    }
