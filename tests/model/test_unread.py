"""A varied parameter that nothing reads has a warning (W506), and no other: rows with two values are the witness."""

from typing import Any

import pytest

from blocks import Diagram

pytestmark = pytest.mark.usefixtures("native")  # by the reference engine each call would begin processes

INNER = {
    "name": "inner",
    "parameters": {"used": 1, "unused": 1},
    "inputs": {"u": {}},
    "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=used"}}},
    "wires": {"gain.u": "u"},
    "outputs": {"y": "gain.y"},
}  # fmt: skip
PARAMETERS = {
    "passed": 1, "half": "=halved/2", "halved": 1, "start": 1, "other": 1, "level": 0.4, "late": 0.5, "every": 0.125,
    "period": 0.5, "end": 0.75, "nothing": 1, "lost": 1, "chain": 1, "link": "=2*chain", "base": 1,
}  # fmt: skip
DIAGRAM: dict[str, Any] = {
    "format": "blocks-diagram", "version": 3, "name": "read",
    "parameters": PARAMETERS,
    "inputs": {"r": {"default": 1}},
    "blocks": {
        "sub": {"diagram": INNER, "parameters": {"used": "=passed", "unused": "=lost"}},
        "gain": {
            "type": "Gain", "parameters": {"k": "=half"},
            "variants": {"other": {"type": "Gain", "parameters": {"k": "=other"}}},
        },
        "rest": {"type": "FirstOrder", "parameters": {"T": 1, "y_start": "=start"}},
        "is_on": {"type": "CompareToConstant", "parameters": {"constant": "=base"}},
        "part": {"diagram": INNER, "enable": {}, "parameters": {"used": "=base"}},
        "ticking": {"diagram": INNER, "trigger": {"every": "=period"}, "parameters": {"used": 2}},
        "sum": {"type": "Sum", "parameters": {"signs": "+++++"}},
        "ramp": {"type": "Ramp", "parameters": {"slope": 1}},
    },
    "wires": {
        "sub.u": "ramp.y", "gain.u": "ramp.y", "rest.u": "gain.y", "is_on.u": "ramp.y", "part.u": "ramp.y",
        "part.enable": "is_on.y", "ticking.u": "ramp.y", "sum.u1": "sub.y", "sum.u2": "gain.y", "sum.u3": "rest.y",
        "sum.u4": "part.y", "sum.u5": "ticking.y",
    },
    "outputs": {"y": "sum.y"},
    "measures": {
        "ISE": {"type": "ISE", "of": "sum.y", "from": "=late"},
        "over": {"type": "ISE", "of": "sum.y", "against": "=level"},
    },
    "run": {"stop": 2, "method": "rk4", "step": "=every", "stop_when": "ramp.y > end"},
}  # fmt: skip
READ: list[tuple[str, dict[str, Any], tuple[float, float]]] = [
    ("passed", {}, (1, 2)),
    ("ticking.used", {}, (1, 2)),
    ("halved", {}, (1, 2)),
    ("start", {}, (1, 2)),
    ("other", {"variants": {"gain": "other"}}, (1, 2)),
    ("level", {}, (0.4, 0.5)),
    ("late", {}, (0.5, 0.25)),
    ("every", {}, (0.125, 0.0625)),
    ("period", {}, (0.5, 0.25)),
    ("end", {}, (0.75, 1)),
    ("base", {"stop_when": ""}, (1, 0.5)),
    ("nothing", {"stop_when": "ramp.y > nothing"}, (0.75, 1)),
]


def varied(name: str, values: tuple[float, float], words: dict[str, Any]) -> tuple[bool, list[str]]:
    """Return if two values of a parameter give different rows, and the names in the warnings."""
    batch = Diagram.from_json(DIAGRAM).batch([name], **words)
    rows = batch([[value] for value in values])
    assert set(rows.status) == {"ok"}, rows.messages
    differs = any(column[0] != column[1] for column in rows.measures.values())
    return differs, [fault.place for fault in batch.warnings if fault.code == "W506"]


@pytest.mark.parametrize(("name", "words", "values"), READ)
def test_a_parameter_that_is_read_has_no_warning(name, words, values):
    assert varied(name, values, words) == (True, [])


@pytest.mark.parametrize("name", ["other", "base"])
def test_what_only_another_run_reads_is_read(name):
    assert varied(name, (1, 2), {}) == (False, [])


@pytest.mark.parametrize("name", ["nothing", "lost", "chain", "ticking.unused", "tick*.unused"])
def test_a_parameter_that_nothing_reads_has_a_warning(name):
    assert varied(name, (1, 2), {}) == (False, [name])


def test_a_value_from_outside_may_read_it():
    assert varied("nothing", (1, 2), {"parameters": {"ramp.slope": "=nothing"}}) == (True, [])


def test_a_pattern_that_reaches_a_parameter_that_is_read_has_no_warning():
    assert varied("ticking.*", (1, 2), {}) == (True, [])


def test_sweeps_and_tunings_pass_the_warning_on():
    d = Diagram.from_json(DIAGRAM)
    warnings = d.sweep({"nothing": [1, 2]}).warnings
    assert [str(warning) for warning in warnings] == [
        "W506 nothing: nothing reads this parameter: all its values give the same run. "
        'Where its number belongs, write "=nothing"; or vary another parameter.'
    ]
    tuning = d.tune(over={"nothing": (1, 2)}, minimize="ISE", budget=2)
    assert "W506" in [warning.code for warning in tuning.warnings]
