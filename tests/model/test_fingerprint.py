"""The fingerprint of a diagram: what changes it, and what does not."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, Gain, subdiagram
from blocks.model.fingerprint import fingerprint

PART = {
    "format": "blocks-diagram",
    "version": 3,
    "name": "part",
    "parameters": {"k": 2},
    "inputs": {"u": {}},
    "outputs": {"y": "gain.y"},
    "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=k"}}},
    "wires": {"gain.u": "u"},
}
WHOLE = {
    "format": "blocks-diagram",
    "version": 3,
    "name": "whole",
    "inputs": {"r": {"default": 1}},
    "blocks": {"part": {"diagram": "part.json", "parameters": {"k": 3}}},
    "wires": {"part.u": "r"},
    "run": {"stop": 1},
}


def changed(document: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """The document with another value at a path of keys."""
    made = json.loads(json.dumps(document))
    *above, key = path.split("/")
    place = made
    for step in above:
        place = place.setdefault(step, {})
    place[key] = value
    return dict(made)


def sha(tmp_path: Path, whole: dict[str, Any] = WHOLE, part: dict[str, Any] = PART) -> str:
    (tmp_path / "part.json").write_text(json.dumps(part), encoding="utf-8")
    (tmp_path / "whole.json").write_text(json.dumps(whole), encoding="utf-8")
    return fingerprint(Diagram.load(tmp_path / "whole.json").value)


def test_a_fingerprint_is_the_sha_256_of_the_diagram_with_its_subdiagrams(tmp_path: Path) -> None:
    """Written out by hand: numbers by their value, the subdiagram in place of its path."""
    part = {
        "name": "part",
        "parameters": {"k": 2.0},
        "inputs": {"u": {}},
        "outputs": {"y": "gain.y"},
        "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=k"}}},
        "wires": {"gain.u": "u"},
    }
    whole = {
        "format": "blocks-diagram",
        "version": 1,  # whatever the version of the format: old results stay comparable
        "name": "whole",
        "inputs": {"r": {"default": 1.0}},
        "blocks": {"part": {"diagram": part, "parameters": {"k": 3.0}}},
        "wires": {"part.u": "r"},
        "run": {"stop": 1.0},
    }
    assert sha(tmp_path) == hashlib.sha256(json.dumps(whole).encode()).hexdigest()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("run/stop", 2),
        ("inputs/r/default", 1.5),
        ("blocks/part/parameters/k", 3.0000000000000004),
        ("name", "other"),
        ("measures/m", {"type": "peak", "of": "part.y"}),
        ("parameters/doc", 1),
    ],
)
def test_what_a_number_may_depend_on_changes_the_fingerprint(path: str, value: Any, tmp_path: Path) -> None:
    assert sha(tmp_path, changed(WHOLE, path, value)) != sha(tmp_path)


@pytest.mark.parametrize(("path", "value"), [("parameters/k", 4), ("blocks/gain/parameters/k", 2)])
def test_so_does_a_subdiagram_in_a_file_of_its_own(path: str, value: Any, tmp_path: Path) -> None:
    assert sha(tmp_path, part=changed(PART, path, value)) != sha(tmp_path)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("doc", "What it is."),
        ("layout/part", [3, 4]),
        ("blocks/part/doc", "A part."),
        ("inputs/r/doc", "Aim."),
        ("run/doc", "Short."),
        ("run/stop", 1.0),
        ("x-note", "kept"),
        ("blocks/part/x-note", "kept"),
        ("inputs/r/x-note", "kept"),
        ("run/x-note", "kept"),
        ("$schema", "diagram-3.schema.json"),
    ],
)
def test_documentation_layout_and_spelling_do_not(path: str, value: Any, tmp_path: Path) -> None:
    assert sha(tmp_path, changed(WHOLE, path, value)) == sha(tmp_path)
    assert sha(tmp_path, part=changed(PART, "doc", "A part.")) == sha(tmp_path)


def test_a_diagram_made_in_python_has_the_fingerprint_of_its_file(tmp_path: Path) -> None:
    part = Diagram("part")
    k = part.parameter("k", 2, doc="gain")
    gain = part.add("gain", Gain(k=k))
    part.wire(gain.u, part.input("u"))
    part.output("y", gain.y)
    whole = Diagram("whole")
    made = whole.add("part", subdiagram(part, k=3), at=(1, 2))
    whole.wire(made.u, whole.input("r", default=1))
    whole.settings(stop=1)
    assert fingerprint(whole.value) == sha(tmp_path)


def test_a_column_of_a_csv_file_counts_by_its_numbers(tmp_path: Path) -> None:
    column = {"csv": "data.csv", "column": "v", "doc": "measured"}
    found = []
    for text in ("v\n1\n2\n", "# note\nw,v\n0,1\n0,2\n", "v\n1\n3\n"):
        (tmp_path / "data.csv").write_text(text, encoding="utf-8")
        found.append(sha(tmp_path, changed(WHOLE, "parameters/table", column)))
    assert found[0] == found[1] == sha(tmp_path, changed(WHOLE, "parameters/table", [1, 2]))
    assert found[2] != found[0]
