"""The settings of a run: what each may be, and what is said where it is not."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, ModelError, files
from blocks.errors import Fault
from blocks.flatten import flatten
from blocks.jsontext import Number
from blocks.library import LIBRARY
from blocks.settings import RunSettings, read_settings, seconds


def fine(**raw: Any) -> RunSettings:
    made, faults = read_settings(raw)
    assert faults == []
    return made


def refused(key: str, **raw: Any) -> tuple[str, str]:
    """The message and the cure of the only fault, which is one of `key`."""
    _, faults = read_settings(raw)
    assert [fault[0] for fault in faults] == [key]
    return faults[0][2], faults[0][3]


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
        (10**400, "out of the range"),
        ({"value": Number("1e308"), "unit": "min"}, "out of the range"),
        (Number("1e-300"), "out of the range"),
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
    assert refused("stop", start=2, stop=1)[0] == "must not lie before the start at 2.0 s, but is 1.0 s."
    assert refused("stop", stop=-1)[0].startswith("must not lie before the start at 0.0 s")
    assert fine(start=1, stop=1).stop == 1
    assert fine(start=-5, stop=-1).start == -5


def test_more_steps_or_rows_than_can_be_counted_are_refused() -> None:
    assert refused("every", stop=1e15, every=1)[0].startswith("makes 1e+15 of them")
    assert refused("step", stop=1e15, step=1e-15, method="rk4")[1].startswith("Make it")


@pytest.mark.parametrize("key", ["rtol", "atol"])
@pytest.mark.parametrize("value", [0, -1, 1, True, "1e-6", None, [1e-6], float("nan"), {"value": 1}])
def test_a_tolerance_is_a_number_between_0_and_1(key: str, value: Any) -> None:
    assert refused(key, **{key: value})[0].startswith("must be a number between 0 and 1, not ")


def test_a_tolerance_below_the_spacing_of_doubles_is_refused() -> None:
    assert refused("rtol", rtol=1e-15) == ("1e-15 is below what doubles can hold.", "Use 1e-13 or more.")
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
    source = f'{{"format": "blocks-diagram",\n "version": 1,\n "run": {run}}}'
    with pytest.raises(ModelError) as caught:
        flatten(files.loads(source, file="d.json"), LIBRARY.__getitem__, settings=settings)
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
    with pytest.raises(ModelError, match=r"E502 run.inputs.sped: .* Did you mean 'speed'\?"):
        diagram.flatten(settings={"inputs": {"sped": 1}})
