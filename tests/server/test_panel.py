"""What a page shows of a block."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import blocks
import blocks.server.panel  # its message
from blocks import Block, Case, Diagram, Gain, Input, Parameter, output
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session

PAPER = Path(__file__).resolve().parents[2] / "diagrams/paper/iadrc.json"
EVIL = "</script><img src=x onerror=alert(1)>"


class Tags(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}


def panel_of(source: Any, path: str) -> dict[str, Any]:
    told = answer(source, {"do": "panel", "path": path})
    assert told is not None
    return told


@pytest.fixture(scope="module")
def paper() -> Session:
    return Session(Document(PAPER))


def rows(told: dict[str, Any], title: str = "Parameters") -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in told["rows"].get(title, [])}


def test_a_block_is_told_with_its_equations_its_values_and_where_its_inputs_come_from(paper: Session) -> None:
    told = panel_of(paper, "motor_right")
    assert (told["type"], told["kind"]) == ("PMDCMotor", "block")
    assert "<mfrac>" in told["mathml"]
    assert "domega/dt" in told["mathml"]  # what a screen reader says of the equation
    ra = rows(told)["Ra"]
    assert (ra["doc"], ra["unit"], ra["text"], ra["note"]) == ("armature resistance", "Ohm", "0.1557", "")
    assert ra["knob"] == {
        "name": "motor_right.Ra", "text": "0.1557 Ohm", "was": "0.1557 Ohm", "changed": False, "value": 0.1557,
        "unit": "Ohm", "type": "real", "low": 0.0, "high": 0.3114, "log": False, "choices": [], "why": "",
        "bound": False, "range": ">= 0",
    }  # fmt: skip
    assert (rows(told)["Jeq"]["text"], rows(told)["Jeq"]["knob"]["bound"]) == ("=Jeq", True)
    assert "start value" in rows(told)["omega_start"]["knob"]["why"]
    v = rows(told, "Inputs")["v"]
    assert (v["text"], v["link"], v["unit"]) == ("control_right.u", "control_right", "V")
    assert rows(told, "Outputs")["omega"]["signal"] == "motor_right.omega"
    assert [*rows(told, "Memory")] == ["omega", "i"]


def test_values_are_those_that_the_diagram_is_computed_with(paper: Session) -> None:
    """The flat model is the second witness of numbers that are shown in SI; what is computed follows what is set."""
    for session in (paper, Session(Document(PAPER), Case(parameters={"Jeq": 0.5, "control_right.td.R": 12.0}))):
        compared = 0
        for block in session.document.shown.flatten(parameters=session.values).blocks:
            for name, row in rows(panel_of(session, block.path)).items():
                known, knob = block.resolved.values[name], row["knob"]
                if knob is not None and isinstance(knob["value"], float) and knob["unit"] == known.unit:
                    assert knob["value"] == float(known.value), row
                    compared += 1
        assert compared > 50
        assert rows(panel_of(session, "motor_left"))["Jeq"]["knob"]["value"] == session.values.get("Jeq", 0.2752)


def test_what_is_set_and_no_more_in_the_file_hides_nothing() -> None:
    values = {"gone": 1.0, "Jeq": 0.5, "heading": {"value": 2, "unit": "kg"}}
    told = panel_of(Session(Document(PAPER), Case(parameters=values)), "")
    assert rows(told)["heading"]["knob"]["text"] == "2 kg"
    assert (rows(told)["Jeq"]["knob"]["value"], rows(told)["torque"]["knob"]["value"]) == (0.5, 3.0)


def test_a_diagram_and_a_subdiagram_are_told_with_their_parameters(paper: Session) -> None:
    whole = panel_of(paper, "")
    heading = rows(whole)["heading"]["knob"]
    assert (heading["value"], heading["unit"]) == (45.0, "deg")
    x = rows(whole, "Outputs")["x"]
    assert (x["doc"], x["signal"]) == ("from robot.x", "x")
    inner = panel_of(paper, "robot")
    assert inner["kind"] == "diagram"
    assert rows(inner)["heading"]["text"] == "=heading"
    assert rows(inner, "Inputs")["omega_left"]["link"] == "motor_left"
    deep = panel_of(paper, "control_right.nlsef")
    assert rows(deep, "Inputs")["r1"]["link"] == "control_right.td"


def test_a_block_that_is_not_there_is_refused(paper: Session) -> None:
    for path in ("motor", "motor_right.omega", "control_right.x", "..", "__class__"):
        with pytest.raises(blocks.UsageError, match="E502"):
            panel_of(paper, path)
    with pytest.raises(blocks.UsageError, match="'motor_right'"):
        panel_of(paper, "motor_righ")


class Hostile(Block):
    __doc__ = f"""y = k u {EVIL}

        y = x_{{<img/src=x>}} + k {EVIL}

    {EVIL}: an entry `{EVIL}`

    - a point {EVIL}
    References: {EVIL}
    """
    k = Parameter(1.0, doc=EVIL)
    u = Input(doc=EVIL)

    @output(doc=EVIL)
    def y(k, u):
        return k * u


def test_no_text_of_a_class_or_a_file_becomes_html() -> None:
    diagram = Diagram("hostile", library=[Hostile])
    diagram.parameter("K", 1.0, doc=EVIL)
    block = diagram.add("evil", Hostile(), doc=EVIL)
    diagram.wire(block.u, block.y)  # a loop: a fault
    document = Session(Document(diagram))
    for path in ("", "evil"):
        told = panel_of(document, path)
        found = Tags(told["mathml"] + told["more"])
        assert not found.tags & {"img", "script"}
        assert found.attributes <= {
            "class",
            "role",
            "aria-label",
            "displaystyle",
            "form",
            "width",
            "lspace",
            "rspace",
            "stretchy",
        }
    assert "&lt;/script&gt;" in told["mathml"]
    assert told["doc"] == EVIL


def test_a_diagram_with_faults_is_told_as_far_as_it_can_be() -> None:
    text = """{"format": "blocks-diagram", "version": 3, "name": "f", "doc": ["one", "- two", "three: `four`"],
      "blocks": {"odd": {"type": "Gainn", "parameters": {"k": 2}},
        "sum": {"type": "Sum", "parameters": {"signs": "+-"}}},
      "wires": {"sum.u1": "odd.y"}}"""
    document = Session(Document(Diagram.from_json(text)))
    odd = panel_of(document, "odd")
    assert [fault["code"] for fault in odd["faults"]] == ["E103"]
    assert odd["rows"] == {}
    whole = panel_of(document, "")
    assert whole["mathml"] == "<p>one</p>"
    assert whole["more"] == '<p class="point">two</p><p>three: <code>four</code></p>'
    total = panel_of(document, "sum")
    assert rows(total)["signs"]["text"] == "+-"
    assert rows(total, "Inputs")["u2"]["text"] == "not wired"
    assert {fault["code"] for fault in panel_of(document, "")["faults"]} == {"E101", "E103"}


def test_what_triggers_or_enables_a_part_is_said() -> None:
    inner = Diagram("inner")
    gain = inner.add("g", Gain(k=1.0))
    inner.wire(gain.u, inner.input("u"))
    inner.output("y", gain.y)
    diagram = Diagram("outer")
    diagram.add("slow", inner, trigger={"every": "10 ms"})
    diagram.add("off", inner, enable={"states": "reset"})
    document = Session(Document(diagram))
    assert panel_of(document, "slow")["notes"] == ["Triggered every 10 ms."]
    assert panel_of(document, "off")["notes"] == ["Enabled by its input enable. While disabled: states reset."]
    assert "enable" in rows(panel_of(document, "off"), "Inputs")
