"""`blocks fmt`: the canonical form changes how a file is written, and nothing of what it says."""

from __future__ import annotations

import io
import json
import os
import random
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks import ModelError
from blocks.cli import main
from blocks.model.document import alone, canonical, dumps
from blocks.studies import study
from blocks.text import json_text
from blocks.text.json_document import Document
from tests.support.places import ROOT

SHIPPED = sorted(path for folder in ("diagrams", "tests/support/golden") for path in (ROOT / folder).rglob("*.json"))
SHIPPED = [path for path in SHIPPED if '"format": "blocks-' in path.read_text(encoding="utf-8")[:200]]
SHIPPED = [path for path in SHIPPED if not path.stem.endswith("_v2")]  # read, but not written
STUDIES = [path for path in SHIPPED if '"blocks-study"' in path.read_text(encoding="utf-8")[:200]]

UGLY = """{"wires": {"g.u": "r"}, "x-own": {"b": 1.50, "a": []}, "blocks": {
    "g": {"x-note": "mine", "parameters": {"k": 2.50}, "doc": "", "type": "Gain"}},
  "inputs": {"r": {}}, "measures": {}, "version": 3, "run": {"stop": 1e0, "log": ["g.y"]}, "format": "blocks-diagram"}
"""
FORMATTED = """{
 "format": "blocks-diagram",
 "version": 3,
 "name": "diagram",
 "inputs": {
  "r": {}
 },
 "blocks": {
  "g": {"type": "Gain", "parameters": {"k": 2.50}, "x-note": "mine"}
 },
 "wires": {
  "g.u": "r"
 },
 "run": {"stop": 1e0, "log": ["g.y"]},
 "x-own": {"b": 1.50, "a": []}
}
"""
STUDY = """{"runs": {"a": {"parameters": {"k": 1.0}, "diagram": "d.json"}}, "format": "blocks-study", "x-own": [1],
 "claims": [{"measure": "m", "run": "a"}], "version": 1,
 "figures": [{"panels": [{"lines": [
  {"signal": "g.y", "run": "a"}, {"run": "a", "signal": "r"}],
  "band": [0, 1.0]}], "name": "f"}], "doc": ["one", "two"], "assumed": [], "name": "s"}
"""
FORMATTED_STUDY = """{
 "format": "blocks-study",
 "version": 1,
 "name": "s",
 "doc": [
  "one",
  "two"
 ],
 "runs": {
  "a": {"parameters": {"k": 1.0}, "diagram": "d.json"}
 },
 "assumed": [],
 "claims": [
  {"measure": "m", "run": "a"}
 ],
 "figures": [
  {
   "panels": [
    {
     "lines": [
      {"signal": "g.y", "run": "a"},
      {"run": "a", "signal": "r"}
     ],
     "band": [0, 1.0]
    }
   ],
   "name": "f"
  }
 ],
 "x-own": [1]
}
"""


def canonical_of(path: Path) -> Callable[[Document], str]:
    return study.canonical if path in STUDIES else canonical


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = tmp_path / "d.json"
    made.write_text(UGLY, encoding="utf-8")
    return made


def out_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    told = capsys.readouterr()
    return status, told.out, told.err


# --- what it writes --------------------------------------------------------------------------------------------


def test_a_diagram_gets_its_canonical_form(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path.chmod(0o604)
    assert out_of(capsys, "fmt", str(path)) == (0, f"{path}: formatted\n", "")
    assert path.read_text(encoding="utf-8") == FORMATTED
    assert path.stat().st_mode & 0o777 == 0o604
    assert [entry.name for entry in path.parent.iterdir()] == ["d.json"]


def test_a_study_gets_its_canonical_form(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path.write_text(STUDY, encoding="utf-8")
    assert out_of(capsys, "fmt", str(path)) == (0, f"{path}: formatted\n", "")
    assert path.read_text(encoding="utf-8") == FORMATTED_STUDY


def test_a_canonical_file_is_not_touched(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path.write_text(FORMATTED, encoding="utf-8")
    os.utime(path, ns=(1, 1))
    assert out_of(capsys, "fmt", str(path)) == (0, "", "1 file canonical\n")
    assert path.stat().st_mtime_ns == 1


@pytest.mark.parametrize(
    ("text", "wanted"),
    [(UGLY, FORMATTED), (FORMATTED, FORMATTED), (STUDY, FORMATTED_STUDY), (FORMATTED_STUDY, FORMATTED_STUDY)],
    ids=["diagram", "canonical", "study", "canonical study"],
)
def test_stdin_is_written_to_stdout(
    text: str, wanted: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for check, status, out in ((False, 0, wanted), (True, int(text != wanted), "")):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode()), encoding="utf-8"))
        made = out_of(capsys, "fmt", "-", *(["--check"] if check else []))
        assert made[0] == status
        assert made[1] == (out or ("-: is not canonical\n" if status else ""))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_files_of_this_project_are_canonical(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert canonical_of(path)(json_text.read(text)) == text


def test_check_names_the_files_that_are_not_canonical_and_changes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [str(tmp_path / f"{name}.json") for name in "abc"]
    for name, text in zip(names, (FORMATTED, UGLY, STUDY), strict=True):
        Path(name).write_text(text, encoding="utf-8")
    told = f"{names[1]}: is not canonical\n{names[2]}: is not canonical\n"
    assert out_of(capsys, "fmt", "--check", *names) == (1, told, "")
    assert [Path(name).read_text(encoding="utf-8") for name in names] == [FORMATTED, UGLY, STUDY]
    assert out_of(capsys, "fmt", *names)[0] == 0
    assert out_of(capsys, "fmt", "--check", *names) == (0, "", "3 files canonical\n")


def test_programs_are_told_about_each_file(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = out_of(capsys, "fmt", "--check", "--json", str(path))
    assert (status, err) == (1, "")
    assert [json.loads(line) for line in out.splitlines()] == [
        {"event": "file", "file": str(path), "canonical": False, "version": 3},
        {"event": "done", "files": 1, "changed": 1, "check": True},
    ]


# --- what it leaves alone --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ('"g.u": "r"', '"g.u": "r",', "E001"),
        ('"inputs": {"r": {}}', '"inputs": {"r": {}}, "inputs": {}', "E002"),
        ('"measures"', '"measure"', "E003"),
        ('"g.u": "r"', '"g.u": 7', "E004"),
        ('"version": 3', '"version": 4', "E005"),
        ('"format": "blocks-diagram"', '"format": "diagram"', "E006"),
        ('"type": "Gain"', '"x-type": "Gain"', "E009"),
        ('"g": {', '"a b": {', "E111"),
        ('"type": "Gain"', '"type": "Gain", "variant": "none", "variants": {"a": {"type": "Gain"}}', "E122"),
    ],
)
def test_a_file_whose_structure_has_faults_is_left_alone(
    old: str, new: str, code: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in UGLY
    text = UGLY.replace(old, new)
    path.write_text(text, encoding="utf-8")
    status, out, err = out_of(capsys, "fmt", str(path))
    assert (status, out) == (2, "")
    assert f"{code} {path}:" in err
    assert path.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"type": "Gain"', '"type": "Gian"'),
        ('"g.u": "r"', '"h.u": "r"'),
        ('"r": {}', '"r": {}, "g": {}'),
        ('"measures": {}', '"layout": {"nobody": [1, 2]}'),
        ('"k": 2.50', '"k": "=nobody"'),
        ('"type": "Gain"', '"diagram": "not/there.json"'),
        ('"k": 2.50', '"k": {"csv": "none.csv", "column": "a"}'),
        ('"type": "Gain"', '"fmu": "none.fmu"'),
    ],
)
def test_a_file_that_only_means_something_wrong_is_formatted(
    old: str, new: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in UGLY
    path.write_text(UGLY.replace(old, new), encoding="utf-8")
    assert out_of(capsys, "fmt", str(path)) == (0, f"{path}: formatted\n", "")
    wanted = {"name": "diagram", **json.loads(UGLY.replace(old, new))}
    wanted.pop("measures", None)  # it was empty, as was the text of the block
    assert wanted["blocks"]["g"].pop("doc") == ""
    assert json.loads(path.read_text(encoding="utf-8")) == wanted
    assert main(["check", str(path)]) != 0


def test_a_study_that_only_means_something_wrong_is_formatted_and_one_with_a_wrong_structure_is_not(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path.write_text(STUDY.replace('"run": "a", "signal"', '"run": "nobody", "signal"'), encoding="utf-8")
    assert out_of(capsys, "fmt", str(path))[0] == 0
    assert path.read_text(encoding="utf-8") == FORMATTED_STUDY.replace(
        '"run": "a", "signal"', '"run": "nobody", "signal"'
    )
    for old, new, code in (
        ('"lines"', '"line"', "E003"),
        ('"version": 1', '"version": 2', "E005"),
        ("[0, 1.0]", "5", "E004"),
    ):
        path.write_text(STUDY.replace(old, new), encoding="utf-8")
        status, _, err = out_of(capsys, "fmt", str(path))
        assert status == 2
        assert code in err
        assert path.read_text(encoding="utf-8") == STUDY.replace(old, new)


def test_other_files_are_formatted_beside_one_with_faults(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.json"
    broken.write_text("{", encoding="utf-8")
    status, out, err = out_of(capsys, "fmt", str(tmp_path / "none.json"), str(broken), str(path))
    assert (status, out) == (2, f"{path}: formatted\n")
    assert "E007" in err
    assert "E001" in err
    assert path.read_text(encoding="utf-8") == FORMATTED


def test_links_in_a_circle_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.json").symlink_to("b.json")
    (tmp_path / "b.json").symlink_to("a.json")
    status, _, err = out_of(capsys, "fmt", str(tmp_path / "a.json"))
    assert status == 2
    assert "E007" in err


def test_stdin_stands_alone(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert out_of(capsys, "fmt", "-", str(path))[0] == 2
    assert path.read_text(encoding="utf-8") == UGLY


def test_a_file_that_cannot_be_replaced_is_as_it_was(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    status, _, err = out_of(capsys, "fmt", str(path))
    assert status == 2
    assert "E501" in err
    assert path.read_text(encoding="utf-8") == UGLY
    assert [entry.name for entry in path.parent.iterdir()] == ["d.json"]


# --- any order of keys -----------------------------------------------------------------------------------------


def shuffled(value: Any, rng: random.Random, depth: int) -> Any:
    """A value with the keys of its objects in another order, where the canonical form has an order of its own."""
    if not isinstance(value, dict):
        return value
    entries = list(value.items())
    if depth in (0, 2):
        rng.shuffle(entries)
    return {key: shuffled(item, rng, depth + 1) if key == "blocks" or depth == 1 else item for key, item in entries}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([path for path in SHIPPED if path not in STUDIES]))
def test_the_order_of_sections_and_the_spaces_of_a_file_do_not_matter(seed: int, path: Path) -> None:
    rng = random.Random(seed)
    text = path.read_text(encoding="utf-8")
    # Numbers as texts, so that json keeps their spelling.
    document = json.loads(text, parse_float=lambda word: f"\x00{word}", parse_int=lambda word: f"\x00{word}")
    mixed = json.dumps(shuffled(document, rng, 0), indent=rng.choice([None, 0, 3]), ensure_ascii=rng.random() < 0.5)
    mixed = re.sub(r'"\\u0000([^"]+)"', r"\1", mixed)
    assert canonical(json_text.read(mixed)) == text


def test_what_is_written_is_what_is_read(path: Path) -> None:
    with pytest.raises(ModelError):
        canonical(json_text.read(UGLY.replace("2.50", "null")))
    value, faults = alone(json_text.read(FORMATTED))
    assert faults == []
    assert value == alone(json_text.read(UGLY))[0]
    assert value is not None
    assert dumps(value) == FORMATTED


# --- what happens to a file meanwhile --------------------------------------------------------------------------


def test_a_file_that_another_program_changes_meanwhile_is_left_as_that_left_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.json"
    path.write_text('{"format": "blocks-diagram", "version": 3, "name": "x"}\n', encoding="utf-8")
    changed = '{"format": "blocks-diagram", "version": 3, "name": "y"}\n'
    made = dumps

    def late(value: Any) -> str:
        path.write_text(changed, encoding="utf-8")
        return made(value)

    monkeypatch.setattr("blocks.model.document.dumps", late)
    assert main(["fmt", str(path)]) == 2
    assert "another program changed the file in the meantime" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == changed
    assert [one.name for one in tmp_path.iterdir()] == ["x.json"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may give files to others")
def test_a_file_keeps_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text('{"format": "blocks-diagram", "version": 3, "name": "x"}\n', encoding="utf-8")
    os.chown(path, 1234, 1234)
    path.chmod(0o640)
    assert main(["fmt", str(path)]) == 0
    found = path.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (1234, 1234, 0o640)
