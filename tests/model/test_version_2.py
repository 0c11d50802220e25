"""PID took its error at u and gave y; files that say so give the numbers of then.

pid_v1.means.json beside the golden file holds three rows of what it gave before, with each variant, and its measures.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, ModelError, UsageError
from blocks.model import document
from blocks.text import json_text
from tests.support.places import GOLDEN

PIDS = GOLDEN / "pid_v1.json"
NAMES = {"direct.y": "direct.u", "filtered.y": "filtered.u", "drive.pid.y": "drive.pid.u"}


def numbers(diagram: Diagram, variant: str) -> dict[str, Any]:
    results = diagram.run(engine="reference", variants={"either": variant})
    rows = {name: np.asarray(results[name])[[3, 17, -1]].tolist() for name in results}
    return rows | {"measures": dict(results.measures)}


@pytest.mark.parametrize("variant", ["base", "slow"])
def test_a_file_of_version_1_gives_the_numbers_of_version_1(variant: str) -> None:
    wanted = json.loads(PIDS.with_suffix(".means.json").read_text(encoding="utf-8"))[variant]
    formatted, version = document.canonical(json_text.read(PIDS.read_bytes()))
    assert version == 1
    for diagram in (Diagram.load(PIDS), Diagram.from_json(formatted)):
        made = numbers(diagram, variant)
        assert list(made) == [NAMES.get(name, name) for name in wanted]
        for name, rows in wanted.items():
            assert made[NAMES.get(name, name)] == pytest.approx(rows, rel=1e-9, abs=1e-12), name


def test_what_is_written_is_short_where_a_sum_gives_the_error_and_complete_elsewhere() -> None:
    text, _ = document.canonical(json_text.read(PIDS.read_bytes()))
    assert document.canonical(json_text.read(text)) == (text, 2)
    made = json.loads(text)
    assert (made["wires"]["direct.r"], made["wires"]["direct.y"]) == ("r", "motor.omega")
    assert (made["wires"]["filtered.r"], made["wires"]["filtered.y"]) == ("filter.y", "filtered_zero.y")
    assert made["blocks"]["filtered_zero"] == {"type": "Constant", "parameters": {"value": 0}}
    assert made["layout"]["filtered_zero"] == [160, 340]
    assert made["blocks"]["direct"]["parameters"] == {
        "kp": "=kp", "ki": 5, "kd": {"value": 40, "unit": "mV.s2/rad"}, "u_start": 0.5, "unit_u": "V", "unit": "rad/s",
        "lower": -3, "upper": 3, "c": 1,
    }  # fmt: skip
    assert made["run"]["log"][:2] == ["direct_control", "direct.u"]
    assert made["outputs"] == {"direct_control": "direct.u"}


OLD = """{"format": "blocks-diagram", "version": 1,
 "blocks": {
  "s": {"type": "Step", "parameters": {"unit": "m"}},
  "sum": {"type": "Sum", "parameters": {"signs": "+-", "unit": "m"}},
  "c": {"type": "PID", "parameters": {"kpp": 2, "unit": "V", "unit_u": "kg"}}
 },
 "wires": {
  "sum.u1": "s.y",
  "c.u": "sum.y"
 },
 "run": {"log": ["c.y", "c.x"]}
}
"""


def test_faults_point_into_the_text_as_it_is() -> None:
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(OLD).check()
    found = {(one.code, one.line, one.column, one.place) for one in caught.value.faults}
    assert ("E106", 5, 39, "c.kpp") in found
    assert ("E104", 9, 10, "c.r [kg] <- sum.y [m]") in found
    assert ("E101", 4, 3, "sum.u2") in found
    assert {one.line for one in caught.value.faults if "c.x" in str(one)} == {11}


@pytest.mark.parametrize(
    ("sum_", "wired"),
    [
        ({"signs": "+-", "unit": "m"}, ("s.y", "p.y")),
        ({"signs": "+-"}, ("sum.y", "c_zero1.y")),  # in another unit wires convert otherwise
        ({"signs": "-+", "unit": "m"}, ("sum.y", "c_zero1.y")),
        ({"signs": "=sign", "unit": "m"}, ("sum.y", "c_zero1.y")),
    ],
    ids=str,
)
def test_r_and_y_are_those_of_a_sum_only_where_that_is_certain(sum_: dict[str, str], wired: tuple[str, str]) -> None:
    made = {
        "format": "blocks-diagram", "version": 1,
        "parameters": {"sign": "+-", "c_zero": 1},
        "blocks": {
            "s": {"type": "Step"}, "p": {"type": "Gain"}, "sum": {"type": "Sum", "parameters": sum_},
            "c": {"type": "PID", "parameters": {"unit_u": "m"}},
        },
        "wires": {"sum.u1": "s.y", "sum.u2": "p.y", "c.u": "sum.y", "p.u": "c.y"},
    }  # fmt: skip
    value = document.loads(json.dumps(made))
    assert (value.wires["c.r"], value.wires["c.y"], value.wires["p.u"]) == (*wired, "c.u")
    assert ("c_zero1" in value.blocks) == (wired[0] == "sum.y")


def test_what_is_no_object_and_what_names_nothing_is_left_alone() -> None:
    for broken in (
        '"blocks": 5, "wires": {"c.u": "s.y"}', '"blocks": {"c": {"type": "PID", "parameters": 3}}, "wires": []',
        '"blocks": {"c": {"type": "PID", "variants": {"a": {"type": "PID", "parameters": {"unit": "=u"}}}}}',
        '"blocks": {"c": {"type": "PID"}}, "wires": {"c.u": 4}, "layout": {"c": "here"}, "run": {"log": [1]}',
    ):  # fmt: skip
        with pytest.raises(ModelError) as caught:
            Diagram.from_json('{"format": "blocks-diagram", "version": 1, ' + broken + "}").check()
        assert caught.value.faults


def test_many_pids_are_brought_up_to_date_in_no_time() -> None:
    blocks: dict[str, Any] = {f"p{k}": {"type": "PID", "parameters": {"unit": "V"}} for k in range(3000)}
    wires = {f"p{k}.u": f"p{k - 1}.y" for k in range(1, 3000)}
    value = document.loads(json.dumps({"format": "blocks-diagram", "version": 1, "blocks": blocks, "wires": wires}))
    assert len(value.blocks) == 3000 + 2999
    assert value.wires["p7.r"] == "p6.u"


@pytest.mark.parametrize(
    ("parameters", "wires", "named"),
    [
        ({}, {"c.r": "s.y", "c.y": "p.y", "p.u": "c.u"}, "wires.c.r"),
        ({"c": 0}, {"c.u": "s.y", "p.u": "c.y"}, "blocks.c.parameters.c"),
        ({"u_start": 1}, {"c.u": "s.y", "p.u": "c.y"}, "blocks.c.parameters.u_start"),
    ],
    ids=str,
)
def test_what_only_version_2_has_is_refused(parameters: dict[str, int], wires: dict[str, str], named: str) -> None:
    blocks = {"s": {"type": "Step"}, "p": {"type": "Gain"}, "c": {"type": "PID", "parameters": parameters}}
    with pytest.raises(ModelError, match='write "version": 2') as caught:  # with a c of 1 it would run otherwise
        document.loads(json.dumps({"format": "blocks-diagram", "version": 1, "blocks": blocks, "wires": wires}))
    assert [(one.code, one.place) for one in caught.value.faults] == [("E005", named)]


def test_a_linear_model_of_an_old_file_does_not_take_the_ports_of_now_for_those_of_then() -> None:
    document = {
        "format": "blocks-diagram",
        "version": 1,
        "inputs": {"r": {}},
        "blocks": {"c": {"type": "PID", "parameters": {"kp": 2.0}}, "e": {"type": "Sum", "parameters": {"signs": "+-"}},
                   "p": {"type": "FirstOrder"}},
        "wires": {"e.u1": "r", "e.u2": "p.y", "c.u": "e.y", "p.u": "c.y"},
        "outputs": {"y": "p.y"},
    }  # fmt: skip
    old = Diagram.from_json(document)
    for asked in ("c.y", "c.u"):
        with pytest.raises(UsageError, match="has a different meaning in version 1"):
            old.linearize("r", asked)
        with pytest.raises(UsageError, match="has a different meaning in version 1"):
            old.linearizer().loop(asked)
    new = Diagram.from_json(old.to_json())
    assert new.linearize("r", "c.u").dcgain() == pytest.approx(2 / 3)  # in a process that has the graph of the old one
    assert old.linearize("r", "y").dcgain() == pytest.approx(2 / 3)
