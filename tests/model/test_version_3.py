"""Version 3 of diagrams, which is written, and version 2, which is read: the units of numbers beside `against`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

import blocks
from blocks import Diagram, ModelError
from blocks.cli import main
from blocks.model.fingerprint import fingerprint
from blocks.text.json_edits import same

RPM = math.pi / 30.0


def speed(version: int, against: Any, unit: str = "rpm") -> dict[str, Any]:
    """Return a diagram whose signal is 100 in a unit, and the measure |100 - against|."""
    return {
        "format": "blocks-diagram",
        "version": version,
        "name": "speed",
        "blocks": {"n": {"type": "Constant", "parameters": {"value": 100, "unit": unit}}},
        "run": {"stop": 1},
        "measures": {"error": {"type": "peak", "of": "n.y", "against": against}},
    }


def error(document: dict[str, Any], **options: Any) -> float:
    return Diagram.from_json(document).run(**options).measures["error"]


@pytest.mark.parametrize(
    ("version", "against", "unit", "si"),
    [
        (2, 30, "rpm", 100 * RPM - 30),
        (3, 30, "rpm", 70 * RPM),
        (3, "30 rpm", "rpm", 70 * RPM),
        (3, {"value": 0.5, "unit": "rev/s"}, "rpm", 70 * RPM),
        (2, {"value": 30, "unit": "rpm"}, "rpm", 70 * RPM),
        (2, {"value": 30}, "rpm", 100 * RPM - 30),
        (2, {"value": 30, "unit": ""}, "rpm", 100 * RPM - 30),
        (2, "30 rpm", "rpm", 70 * RPM),
        (3, "=30", "rpm", 100 * RPM - 30),
        (3, {"value": "=30", "unit": "rpm"}, "rpm", 100 * RPM - 30),
        (2, 30, "%", 29.0),
        (3, 30, "%", 0.7),
        (3, 30, "1", 70.0),
        (3, 30, "", 70.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_plain_number_is_in_the_declared_unit_of_the_signal(
    version: int, against: Any, unit: str, si: float, engine: str
) -> None:
    assert error(speed(version, against, unit), engine=engine) == pytest.approx(abs(si), rel=1e-14)


def test_a_signal_has_the_unit_of_its_port_wherever_it_is_named() -> None:
    document = speed(3, 30)
    document["blocks"] = {
        "part": {
            "diagram": {
                "inputs": {"u": {"unit": "deg/s"}},
                "outputs": {"n": "n.y", "both": "both.y", "back": "u"},
                "blocks": document["blocks"] | {"both": {"type": "Mux", "parameters": {"names": "n, i"}}},
                "wires": {"both.u1": "n.y", "both.u2": "u"},
            },
        },
        "w": {"type": "Constant", "parameters": {"value": 10, "unit": "rpm"}},
        "fleet": {"type": "Constant", "copies": 3, "parameters": {"value": "=index", "unit": "rpm"}},
    }
    document["wires"] = {"part.u": "w.y"}
    document["outputs"] = {"out": "part.n"}
    of = {
        "part.n.y": 70 * RPM, "part.n": 70 * RPM, "out": 70 * RPM, "part.both[n]": 70 * RPM, "part.both[1]": 5 * RPM,
        "part.back": 5 * RPM, "w.y": 20 * RPM, "fleet.y[2]": abs(2 - 30 * RPM), "fleet[2].y": abs(2 - 30 * RPM),
    }  # fmt: skip
    document["measures"] = {f"m{k}": {"type": "peak", "of": name, "against": 30} for k, name in enumerate(of)}
    measured = Diagram.from_json(document).run().measures
    assert list(measured.values()) == pytest.approx(list(of.values()), rel=1e-13)


@pytest.mark.parametrize("text", ["30", "30.50", "-3E+1", "1e-300", "0", "-0.0", "0.100000000000000005551115"])
@pytest.mark.parametrize("unit", ["rpm", "bananas"])  # an unknown unit hides no number
def test_fmt_writes_version_3_and_numbers_keep_their_value_and_their_spelling(
    text: str, unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "speed.json"
    path.write_text(json.dumps(speed(2, 77, unit)).replace("77", text), encoding="utf-8")
    before = Diagram.load(path).run().measures if unit == "rpm" else None
    assert main(["fmt", "--check", str(path)]) == 1
    assert "is not canonical, of version 2" in capsys.readouterr().out
    assert main(["fmt", str(path)]) == 0
    assert "converted from version 2 to 3" in capsys.readouterr().out
    assert same(json.loads(path.read_text(encoding="utf-8")), speed(3, f"={text}", unit))
    assert main(["fmt", "--check", str(path)]) == 0
    if unit == "rpm":
        assert Diagram.load(path).flatten().measures[0].against == float(text)
        assert Diagram.load(path).run().measures == before


def test_all_that_writes_a_diagram_writes_version_3(tmp_path: Path) -> None:
    old = {**speed(2, 30), "blocks": {"more": {"type": "Gain", "copies": 2}, "part": {"diagram": speed_part()}}}
    read = Diagram.from_json(old)
    read.save(tmp_path / "saved.json")
    saved = json.loads((tmp_path / "saved.json").read_text(encoding="utf-8"))
    for written in (read.to_json(), json.loads(read.dumps()), saved):
        assert written["version"] == 3
        assert written["measures"]["error"]["against"] == "=30"
        assert written["blocks"]["part"]["diagram"]["measures"]["error"]["against"] == "=30"
    assert main(["new", str(tmp_path / "project")]) == 0
    files = [*(tmp_path / "project").rglob("*.json")]
    diagrams = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    assert {file["version"] for file in diagrams if file.get("format") == "blocks-diagram"} == {3}
    assert Diagram("made").to_json()["version"] == 3


def speed_part() -> dict[str, Any]:
    """Return the diagram of `speed` as a subdiagram."""
    return {key: value for key, value in speed(2, 30).items() if key in ("blocks", "measures")}


def test_an_edit_leaves_the_version_of_a_file_and_its_numbers(tmp_path: Path) -> None:
    path, operations = tmp_path / "speed.json", tmp_path / "operations.json"
    path.write_text(json.dumps(speed(2, 30)), encoding="utf-8")
    before = Diagram.load(path).run().measures["error"]
    pasted = {"blocks": {"more": {"type": "Constant", "copies": 2}}}
    operations.write_text(json.dumps([{"paste": pasted}, {"rename": "blocks.n", "to": "speed"}]), encoding="utf-8")
    assert main(["apply", str(path), str(operations)]) == 0
    written = json.loads(path.read_text(encoding="utf-8"))
    assert (written["version"], written["measures"]["error"]["against"]) == (2, 30)
    assert (written["blocks"]["more"]["copies"], [*written["blocks"]]) == (2, ["speed", "more"])
    assert Diagram.load(path).run().measures["error"] == before


def made() -> Diagram:
    diagram = Diagram("speed")
    diagram.add("n", blocks.Constant(value=100, unit="rpm"))
    diagram.settings(stop=1)
    return diagram


@pytest.mark.parametrize("against", [30, "30 rpm", {"value": 180, "unit": "deg/s"}])
def test_a_diagram_made_in_python_has_the_new_meaning_and_keeps_it_in_its_file(against: Any, tmp_path: Path) -> None:
    diagram = made()
    diagram.measure("error", "peak", of="n.y", against=against)
    diagram.save(tmp_path / "speed.json")
    for each in (diagram, Diagram.load(tmp_path / "speed.json"), Diagram.from_json(diagram.to_json())):
        assert each.run().measures["error"] == pytest.approx(70 * RPM, rel=1e-14)


def test_a_number_that_is_added_to_an_older_file_leaves_the_others_as_they_are() -> None:
    diagram = Diagram.from_json(speed(2, 30))
    diagram.measure("new", "peak", of="n.y", against=30)
    for each in (diagram, Diagram.from_json(diagram.to_json())):
        assert each.run().measures == pytest.approx({"error": abs(100 * RPM - 30), "new": 70 * RPM}, rel=1e-13)


def test_the_same_number_in_both_versions_is_of_two_diagrams_for_results() -> None:
    old, new = (Diagram.from_json(speed(version, 30)).value for version in (2, 3))
    assert fingerprint(old) != fingerprint(new)
    same_meaning = Diagram.from_json(speed(3, "=30")).value
    assert fingerprint(old) == fingerprint(same_meaning)


def test_a_unit_of_another_quantity_is_refused() -> None:
    with pytest.raises(ModelError, match=r"E104 .*measures.error: \[V\] is given, but \[rpm\] is needed"):
        Diagram.from_json(speed(3, "30 V")).flatten()


def test_the_window_of_a_measure_takes_texts_with_a_unit() -> None:
    document = speed(3, 0)
    document["blocks"]["n"] = {"type": "Ramp", "parameters": {"slope": 1}}
    document["measures"]["error"] |= {"from": "250 ms", "to": "500 ms"}
    assert error(document) == pytest.approx(0.5, abs=1e-12)
    document["measures"]["error"] |= {"from": "2 V"}
    with pytest.raises(ModelError, match=r"E104 measures\.error: \[V\] is given, but \[s\] is needed"):
        error(document)
