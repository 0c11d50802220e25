"""Version 3 of diagrams: a number that a measure takes off is in the declared unit of its signal."""

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


def test_check_warns_of_each_number_that_would_change_and_of_no_other() -> None:
    changing = Diagram.from_json(speed(2, 30)).flatten().warnings
    assert [(fault.code, fault.place) for fault in changing] == [("W104", "measures.error")]
    for version, against, unit in (
        (3, 30, "rpm"), (2, 0, "rpm"), (2, 30, "rad/s"), (2, 30, ""), (2, "=30", "rpm"), (2, "n.y", "rpm"),
        (2, {"value": 3, "unit": "rpm"}, "rpm"),
    ):  # fmt: skip
        assert not Diagram.from_json(speed(version, against, unit)).flatten().warnings


def test_fmt_gives_such_a_number_its_unit_and_results_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "speed.json"
    path.write_text(json.dumps(speed(2, 30.5)), encoding="utf-8")
    before = Diagram.load(path).run().measures["error"]
    assert main(["fmt", "--check", str(path)]) == 1
    assert "is not canonical, of version 2" in capsys.readouterr().out
    assert main(["fmt", str(path)]) == 0
    assert "converted from version 2 to 3" in capsys.readouterr().out
    written = json.loads(path.read_text(encoding="utf-8"))
    assert same(written, speed(3, {"value": 30.5, "unit": "rad/s"}))
    assert Diagram.load(path).run().measures["error"] == before
    assert main(["fmt", "--check", str(path)]) == 0


def test_fmt_leaves_a_file_whose_numbers_stay_and_one_with_faults_in_version_2(tmp_path: Path) -> None:
    path = tmp_path / "speed.json"
    for document in (speed(2, 30, "rad/s"), speed(2, 30, "bananas")):
        path.write_text(json.dumps(document), encoding="utf-8")
        assert main(["fmt", str(path)]) == 0
        assert same(json.loads(path.read_text(encoding="utf-8")), document)


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
    assert diagram.to_json()["version"] == (3 if against == 30 else 2)


def test_a_number_that_is_added_to_an_older_file_leaves_the_others_as_they_are() -> None:
    diagram = Diagram.from_json(speed(2, 30))
    diagram.measure("new", "peak", of="n.y", against=30)
    for each in (diagram, Diagram.from_json(diagram.to_json())):
        assert each.run().measures == pytest.approx({"error": abs(100 * RPM - 30), "new": 70 * RPM}, rel=1e-13)


def test_copies_that_are_added_to_an_older_file_leave_its_numbers_as_they_are() -> None:
    diagram = Diagram.from_json(speed(2, 30))
    diagram.add("more", blocks.Constant(), copies=2)
    written = diagram.to_json()
    assert written["version"] == 3
    for each in (diagram, Diagram.from_json(written)):
        assert each.run().measures["error"] == pytest.approx(abs(100 * RPM - 30), rel=1e-14)


def test_pasted_copies_leave_the_numbers_of_an_older_file_as_they_are(tmp_path: Path) -> None:
    path, operations = tmp_path / "speed.json", tmp_path / "operations.json"
    path.write_text(json.dumps(speed(2, 30)), encoding="utf-8")
    pasted = {"blocks": {"more": {"type": "Constant", "copies": 2}}}
    operations.write_text(json.dumps([{"paste": pasted}]), encoding="utf-8")
    assert main(["apply", str(path), str(operations)]) == 0
    written = json.loads(path.read_text(encoding="utf-8"))
    assert (written["version"], written["measures"]["error"]["against"]) == (3, {"value": 30, "unit": "rad/s"})


def test_the_same_number_in_both_versions_is_of_two_diagrams_for_results() -> None:
    old, new = (Diagram.from_json(speed(version, 30)).value for version in (2, 3))
    assert fingerprint(old) != fingerprint(new)
    old, new = (Diagram.from_json(speed(version, "=30")).value for version in (2, 3))
    assert fingerprint(old) == fingerprint(new)


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


@pytest.mark.parametrize(("key", "code"), [("against", "E105"), ("from", "E116"), ("to", "E116")])
def test_a_text_with_a_unit_in_an_older_file_is_refused_with_the_quantity_to_write(key: str, code: str) -> None:
    document = speed(2, 0)
    document["measures"]["error"][key] = "30 rpm"
    with pytest.raises(ModelError, match=rf'{code} measures\.error: .* Write \{{"value": 30, "unit": "rpm"\}}\.'):
        error(document)


def test_a_file_whose_signals_are_not_known_is_formatted_with_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "d.json"
    document = speed(2, 30)
    document["blocks"]["n"] = {"type": "MyOwn"}
    path.write_text(json.dumps(document), encoding="utf-8")
    assert main(["fmt", str(path)]) == 0
    told = capsys.readouterr()
    assert "d.json: formatted" in told.out
    assert "W104" in told.err
    assert "stays at version 2" in told.err
    assert "because of E103 n." in told.err
    assert json.loads(path.read_text(encoding="utf-8"))["version"] == 2
