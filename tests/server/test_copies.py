"""What a page shows of blocks with copies, and how they are turned there."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import blocks.server.knobs
import blocks.server.panel  # noqa: F401  # their messages
from blocks import Diagram
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session
from blocks.server.static_page import page_of
from blocks.text.errors import UsageError

ROOT = Path(__file__).parents[2]
CONSENSUS = ROOT / "diagrams" / "fleet" / "consensus.json"


def fleet() -> Any:
    """The first diagram with copies in the docs."""
    text = (ROOT / "docs" / "diagram_file.md").read_text(encoding="utf-8")
    found = re.search(r":caption: fleet\.json\n\n(.*?)\n```", text, re.DOTALL)
    assert found
    return json.loads(found[1])


def opened(tmp_path: Path, value: Any = None) -> Session:
    path = tmp_path / "fleet.json"
    path.write_text(json.dumps(fleet() if value is None else value), encoding="utf-8")
    return Session(Document(path))


def rows(session: Session, path: str) -> dict[str, dict[str, Any]]:
    told = answer(session, {"do": "panel", "path": path})
    assert told is not None
    return {row["name"]: row for title in ("Parameters", "Inputs") for row in told["rows"][title]}


def test_copies_are_told_by_what_is_written_for_all_of_them_and_each_by_its_own_value(tmp_path: Path) -> None:
    facts = opened(tmp_path).document.facts
    assert [facts[f"robots[{k}].kp"].nominal for k in range(4)] == [20, 21, 22, 23]
    assert (facts["robots.kp"].was, facts["robots.kp"].is_bound) == ("=20+index", True)
    assert facts["robots.kp"].nominal == [20, 21, 22, 23]
    assert (facts["robots[3].omega_start"].raw, facts["robots[3].omega_start"].was) == (0.3, "0.3 rad/s")
    start = facts["robots.omega_start"]
    assert (start.was, start.nominal, start.is_bound) == ("[0, 0.1, 0.2, 0.3] rad/s", [0, 0.1, 0.2, 0.3], False)
    resistance = facts["robots.motor.Ra"]  # nothing is said of it: one value for all
    assert (resistance.raw, resistance.nominal) == (None, facts["robots[2].motor.Ra"].nominal)


def test_copies_inside_of_copies_are_counted_through(tmp_path: Path) -> None:
    value = fleet()
    value["blocks"]["robots"]["diagram"]["blocks"]["lag"] = {
        "type": "Gain", "copies": 3, "parameters": {"k": ["=kp", 2, "=index"]},
    }  # fmt: skip
    value["blocks"]["robots"]["diagram"]["wires"]["lag.u"] = "error.y"
    value["blocks"]["robots"]["diagram"]["blocks"]["lag"]["parameters"]["unit_u"] = "rad/s"
    facts = opened(tmp_path, value).document.facts
    assert facts["robots.lag.k"].nominal == [20, 2, 2, 21, 2, 2, 22, 2, 2, 23, 2, 2]
    assert (facts["robots[1].lag[1].k"].raw, facts["robots[1].lag[0].k"].raw) == (2, "=kp")


def test_the_panel_shows_a_block_with_copies_and_one_of_them(tmp_path: Path) -> None:
    session = opened(tmp_path)
    told = answer(session, {"do": "panel", "path": "robots"})
    assert told is not None
    assert told["notes"] == ["Copies: =n."]
    assert rows(session, "robots")["kp"]["text"] == "=20+index"
    assert rows(session, "robots")["omega_start"]["knob"]["value"] == [0, 0.1, 0.2, 0.3]
    assert rows(session, "robots")["wanted"]["link"] == "speed"
    assert rows(session, "robots[3]")["kp"]["knob"]["value"] == 23
    assert rows(session, "robots[3]")["wanted"]["link"] == "speed"
    assert rows(session, "robots[3].motor")["Ra"]["knob"]["name"] == "robots[3].motor.Ra"
    for path in ("robots[4]", "robots[03]", "speed[0]", "robots[]"):
        with pytest.raises(UsageError, match="E502"):
            answer(session, {"do": "panel", "path": path})


def test_a_value_set_for_all_copies_reaches_each_and_is_kept_in_the_file(tmp_path: Path) -> None:
    session = opened(tmp_path)
    for path, value in (("robots.motor.Ra", "0.5 Ohm"), ("robots.omega_start", [1.0, 2.0, 3.0, 4.0])):
        answer(session, {"do": "set", "name": path, "value": value})
    assert rows(session, "robots.motor")["Ra"]["knob"]["text"] == "0.5 Ohm"
    assert rows(session, "robots[2].motor")["Ra"]["knob"]["value"] == 0.5
    assert rows(session, "robots[2]")["omega_start"]["knob"]["value"] == 3.0
    answer(session, {"do": "keep"})
    kept = json.loads((tmp_path / "fleet.json").read_text(encoding="utf-8"))["blocks"]["robots"]
    assert kept["parameters"]["omega_start"] == [1, 2, 3, 4]
    assert kept["diagram"]["blocks"]["motor"]["parameters"]["Ra"] == {"value": 0.5, "unit": "Ohm"}
    assert session.document.facts["robots[2].motor.Ra"].nominal == 0.5


def test_a_value_set_in_one_copy_acts_there_and_is_not_kept(tmp_path: Path) -> None:
    session = opened(tmp_path)
    answer(session, {"do": "set", "name": "robots[2].motor.Ra", "value": "0.5 Ohm"})
    shown = [rows(session, f"robots[{k}].motor")["Ra"]["knob"]["value"] for k in range(4)]
    assert (shown[2], shown[1] == shown[0] == shown[3] != 0.5) == (0.5, True)
    assert rows(session, "robots.motor")["Ra"]["knob"]["value"] == shown
    with pytest.raises(UsageError, match=r"E501 .*one copy"):
        answer(session, {"do": "keep"})


def test_values_of_copies_are_turned_in_a_run_and_go_back(tmp_path: Path) -> None:
    value = fleet()
    value["blocks"]["robots"]["parameters"]["kp"] = [20, 21, 22, 23]
    session = opened(tmp_path, value)
    live = session.begin("100 ms")
    for path, new in (("robots.kp", 5), ("robots[1].kp", 7), ("robots.motor.Ra", 0.5)):
        assert answer(session, {"do": "set", "name": path, "value": new})["t"] is not None  # type: ignore[index]
    assert [rows(session, f"robots[{k}]")["kp"]["knob"]["value"] for k in range(4)] == [5, 7, 5, 5]
    told = answer(session, {"do": "reset"})
    assert told == {"is": "done", "later": []}
    assert [rows(session, f"robots[{k}]")["kp"]["knob"]["value"] for k in range(4)] == [20, 21, 22, 23]
    assert [live.turned[k].value for k in (-3, -2, -1)] == [[20, 21, 22, 23], 21, 0.1557]


def test_a_page_in_one_file_holds_a_diagram_with_copies() -> None:
    diagram = Diagram.load(CONSENSUS)
    page = page_of(diagram, diagram.run(stop=1))
    found = re.search(r'<script type="application/json" id="content">(.*?)</script>', page, re.DOTALL)
    assert found
    assert "1+cos(2*pi*index/copies)" in found[1]
