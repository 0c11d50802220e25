"""Goto and From across systems, whose signals are led through ports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blocks import from_simulink
from tests.support.simulink_files import FORMS, block, line, model, system


def _goto(tag: str, sid: int, seen: str = "global") -> object:
    return block("Goto", f"Goto{sid}", sid, {"GotoTag": tag, "TagVisibility": seen}, {"in": 1})


def _from(tag: str, sid: int) -> object:
    return block("From", f"From{sid}", sid, {"GotoTag": tag}, {"out": 1})


@pytest.mark.parametrize("form", ["mdl", "split"])
def test_tags_cross_systems_upwards_downwards_and_sideways(form: str, tmp_path: Path) -> None:
    """Sub A gives tag a from two levels down; sub B takes a and b two levels down, twice; the top takes a."""
    giving = system(
        [
            block("Clock", "t", 11, {}, {"out": 1}),
            block("Gain", "3t", 12, {"Gain": "3"}, {"in": 1, "out": 1}),
            _goto("a", 13),
        ],
        [line(("t", "1"), ("3t", "1")), line(("3t", "1"), ("Goto13", "1"))],
    )
    first = system([block("SubSystem", "deep", 21, {}, {}, inside=giving)])
    taking = system(
        [
            _from("a", 31), _from("b", 32), _from("a", 33),
            block("Sum", "s", 34, {"Inputs": "+-+"}, {"in": 3, "out": 1}),
            block("Outport", "y", 35, {"Port": "1"}, {"in": 1}),
        ],
        [line(("From31", "1"), ("s", "1")), line(("From32", "1"), ("s", "2")), line(("From33", "1"), ("s", "3")),
         line(("s", "1"), ("y", "1"))],
    )  # fmt: skip
    second = system(
        [
            block("SubSystem", "deep", 41, {}, {"out": 1}, inside=taking),
            block("Outport", "y", 42, {"Port": "1"}, {"in": 1}),
        ],
        [line(("deep", "1"), ("y", "1"))],
    )
    outside = system(
        [
            block("SubSystem", "A", 1, {}, {}, inside=first),
            block("SubSystem", "B", 2, {}, {"out": 1}, inside=second),
            block("Constant", "c", 3, {"Value": "[1 2]"}, {"out": 1}), _goto("b", 4),
            _from("a", 5), block("Outport", "direct", 6, {"Port": "1"}, {"in": 1}),
            block("Outport", "sum", 7, {"Port": "2"}, {"in": 1}),
        ],
        [line(("c", "1"), ("Goto4", "1")), line(("From5", "1"), ("direct", "1")), line(("B", "1"), ("sum", "1"))],
    )  # fmt: skip
    diagram, report = from_simulink(FORMS[form](model("tags", outside, settings={"StopTime": "2"}), tmp_path))
    assert report.is_whole
    results = diagram.run(every=0.5, engine="reference")
    assert np.allclose(results["direct"], 3 * results.t, atol=1e-12)
    assert np.allclose(results["sum"], 6 * results.t[:, None] - [1, 2], atol=1e-12)


def test_a_local_tag_and_one_without_a_goto_stay_where_they_are(tmp_path: Path) -> None:
    inside = system([_from("here", 11), _from("none", 12), block("Outport", "y", 13, {}, {"in": 1})],
                    [line(("From11", "1"), ("y", "1"))])  # fmt: skip
    outside = system(
        [
            block("Constant", "c", 1, {"Value": "5"}, {"out": 1}), _goto("here", 2, "local"),
            block("SubSystem", "sub", 3, {}, {"out": 1}, inside=inside), block("Outport", "y", 4, {}, {"in": 1}),
        ],
        [line(("c", "1"), ("Goto2", "1")), line(("sub", "1"), ("y", "1"))],
    )  # fmt: skip
    _, report = from_simulink(FORMS["mdl"](model("local", outside), tmp_path))
    assert {entry.path for entry in report.of("left out")} == {"sub/From11", "sub/From12"}
