"""Renaming: what refers to a name goes with it, and all other characters of the file stay as they are.

Texts are written with a mark in place of the name that is renamed, wherever it stands: filled with the old name they
are the file before, filled with the new one the file after.
"""

from __future__ import annotations

import json
import os
import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from blocks import BlocksError, Diagram, ModelError, UsageError
from blocks.cli import main
from blocks.editing.renaming import renaming
from blocks.model.document import load, loads
from blocks.text.atomic_write import write_atomically
from blocks.text.errors import Fault
from tests.support.places import ROOT

DIAGRAMS = ROOT / "diagrams"


def renamed(folder: Path, text: str, old: str, new: str, **options: Any) -> str:
    """The text of a file of a project after a renaming."""
    (folder / "pyproject.toml").touch()
    path = folder / "d.json"
    path.write_text(text, encoding="utf-8", newline="")
    made = renaming(path, old, new, **options)
    assert path.read_bytes().decode() == text, "nothing is written but by `write`"
    return made.text


def refused(folder: Path, text: str, old: str, new: str, **options: Any) -> Any:
    with pytest.raises(BlocksError) as caught:
        renamed(folder, text, old, new, **options)
    assert len(caught.value.faults) == 1, str(caught.value)
    return caught.value.faults[0]


# --- one kind of name after the other --------------------------------------------------------------------------

LOOP = r"""
{"format":"blocks-diagram",  "version": 3, "name": "lag", "doc": "lag, r and Kp are words here.",
 "parameters": {"~Kp~": {"value": 2.50, "unit": "", "doc": "Kp"}, "Kp2": "=2*~Kp~", "text": "==Kp"
 , "list": ["=~Kp~", 1e0, "=sin(~Kp~)*pi"], "when": {"value": "=~Kp~/10", "unit": "s"}},
 "inputs": {"^r^": {"default": 1}},
 "outputs": { "<speed>":"[lag].y",	"r_out": "^r^" },
 "blocks": {"[lag]": {"type": "Integrator", "doc": "the lag"},
  "Gain": {"type": "Gain", "parameters": {"k": "= ~Kp~ * Kp2 + ~Kp~"}, "x-note": "Kp lag r speed"},
  "part": {"parameters": {"Kp": "=~Kp~"},
           "trigger": {"every": "=0.1*~Kp~", "offset": {"value": "=0*~Kp~", "unit": "s"}},
           "diagram": {"parameters": {"Kp": 1}, "inputs": {"r": {}}, "outputs": {"speed": "lag.y"},
                       "blocks": {"lag": {"type": "Gain", "parameters": {"k": "=Kp"}}}, "wires": {"lag.u": "r"}}},
  "either": {"type": "Gain", "variant": "lag",
             "variants": {"lag": {"type": "Saturation", "parameters": {"upper": "=9*~Kp~"}}}}},
 "wires": {"[lag].u": "Gain.y", "Gain.u": "^r^", "part.r":"^r^" , "either.u": "[lag].y"},
 "run": {"stop": 1, "step": 0.25, "method": "euler", "inputs": {"^r^": 0.5},
         "log": ["[lag].y", "[lag]", "<speed>", "^r^", "part.lag.y", "part.speed"],
         "master": {"steps": {"[lag]": 0.1}}},
 "measures": {"lag": {"type": "IAE", "of": "[lag].y", "against": "^r^", "from": "=~Kp~/25",
                      "to": {"value": "=~Kp~/2.5", "unit": "s"}},
              "b": {"type": "IAE", "of": "<speed>", "against": "=~Kp~"},
              "c": {"type": "settling_time", "of": "part.lag.y", "against": "part.speed", "band": "=~Kp~/100"}},
 "layout": {"[lag]": [1.0, 20], "^r^": [30, 4e1], "<speed>": [9, 9]},
 "x-own": {"lag": ["lag.y"]}
}
"""
MARKS = {"block": "[]", "input": "^^", "parameter": "~~", "output": "<>"}
NAMES = {"block": "lag", "input": "r", "parameter": "Kp", "output": "speed"}


def filled(text: str, **names: str) -> str:
    """A text with the names of one kind replaced, and the marks taken away."""
    for kind, (left, right) in MARKS.items():
        pattern = rf"{re.escape(left)}({NAMES[kind]}){re.escape(right)}"
        text = re.sub(pattern, names.get(kind, NAMES[kind]), text)
    return text


@pytest.mark.parametrize("kind", NAMES)
def test_a_name_goes_with_all_that_refers_to_it_and_nothing_else_changes(kind: str, tmp_path: Path) -> None:
    Diagram.from_json(filled(LOOP)).check()
    made = renamed(tmp_path, filled(LOOP), NAMES[kind], "fresh_1")
    assert made == filled(LOOP, **{kind: "fresh_1"})
    assert renamed(tmp_path, made, "fresh_1", NAMES[kind]) == filled(LOOP)


INNER = """{"format": "blocks-diagram", "version": 3,
 "parameters": {"Kp": 3, "q": 1}, "inputs": {"r": {"default": 1}}, "outputs": {"speed": "part.<speed>", "deep": "r"},
 "blocks": {
  "lag": {"type": "Gain", "parameters": {"k": "=Kp"}},
  "part": {"parameters": {"~Kp~": "=2*Kp"}, "diagram": {
    "parameters": {"~Kp~": 1, "q": "=~Kp~"}, "inputs": {"^r^": {}, "s": {"default": 0}},
    "outputs": {"<speed>": "[lag].y", "r_too": "^r^", "lag": "sum.y"},
    "blocks": {"[lag]": {"type": "Gain", "parameters": {"k": "=~Kp~"}},
               "sum": {"type": "Sum"}, "deeper": {"parameters": {"Kp": "=~Kp~"}, "diagram": {"parameters": {"Kp": 0}}}},
    "wires": {"[lag].u": "^r^", "sum.u1": "^r^", "sum.u2": "[lag].y"},
    "run": {"log": ["[lag].y", "<speed>"], "inputs": {"^r^": 1}}, "measures": {"lag": {"type": "ISE", "of": "[lag].y"}},
    "layout": {"[lag]": [0, 0], "^r^": [0, 0], "<speed>": [1, 1]}}}
 },
 "wires": {"lag.u": "r", "part.^r^": "lag.y"},
 "run": {"stop": 1, "log": ["part.[lag].y", "part.<speed>", "speed", "part.lag", "part", "part.sum.y"],
   "master": {"steps": {"part.[lag]": 0.1, "lag": 0.1}}},
 "measures": {"m": {"type": "IAE", "of": "part.[lag].y", "against": "part.<speed>"},
              "n": {"type": "IAE", "of": "lag.y", "against": "speed"}}}
"""


@pytest.mark.parametrize("kind", NAMES)
def test_a_name_inside_of_a_subdiagram_is_mended_outside_as_well(kind: str, tmp_path: Path) -> None:
    Diagram.from_json(filled(INNER)).check()
    options = {"kind": "block"} if kind == "block" else {}  # an output of the subdiagram is called `lag` too
    made = renamed(tmp_path, filled(INNER), f"part.{NAMES[kind]}", "fresh", **options)
    assert made == filled(INNER, **{kind: "fresh"})


def test_the_output_of_a_subdiagram_and_its_block_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    fault = refused(tmp_path, filled(INNER), "part.lag", "fresh")
    assert (fault.code, fault.cure) == ("E501", "Choose one: --kind block or --kind output.")
    made = renamed(tmp_path, filled(INNER), "part.lag", "fresh", kind="output")
    was = filled(INNER)
    assert made == was.replace('"lag": "sum.y"', '"fresh": "sum.y"').replace(
        '"part.lag", "part"', '"part.fresh", "part"'
    )


def test_strings_with_escapes_and_lines_of_any_kind_are_edited_in_place(tmp_path: Path) -> None:
    text = (
        '{"format":"blocks-diagram","version":3,\r\n'
        '"blocks":{"\\u006cag":{"type":"G\\u0061in","doc":"\\ud83d\\ude00 \\"lag\\""},\r\n\t"b":{"type":"Gain"}},'
        '"wires":{"b.u":"l\\u0061g.y","l\\u0061\\u0067.u":"\\u0062.y"},"run":{"loops":"solve"}}'
    )
    made = renamed(tmp_path, text, "lag", "x")
    assert made == text.replace("\\u006cag", "x").replace("l\\u0061g", "x").replace("l\\u0061\\u0067", "x")
    assert "\r\n\t" in made


def test_elements_of_vectors_keep_their_indices(tmp_path: Path) -> None:
    text = """{"format": "blocks-diagram", "version": 3, "inputs": {"@": {"size": 2}}, "outputs": {"o": "@[1]"},
     "blocks": {"p": {"type": "StateSpace",
                      "parameters": {"A": [[-1, 0], [1, -2]], "B": [[1, 0], [0, 1]], "C": [[0, 1]]}}},
     "wires": {"p.u[0]": "@[0]", "p.u[1]": "@[1]"}, "run": {"log": ["@", "@[1]", "p.x[0]"]}}"""
    assert renamed(tmp_path, text.replace("@", "u"), "u", "volt") == text.replace("@", "volt")
    assert '"volt.u[0]": "u[0]"' in renamed(tmp_path, text.replace("@", "u"), "p", "volt")


VARIANTS = """{"format": "blocks-diagram", "version": 3,
 "blocks": {
  "source": {"type": "Sine"},
  "plant": {
   "diagram": {"inputs": {"@": {}}, "outputs": {"y": "lag.y"}, "blocks": {"lag": {"type": "Gain"}},
               "wires": {"lag.u": "@"}},
   "variants": {
    "own": {"diagram": {"inputs": {"v": {}}, "outputs": {"w": "lag.y"}, "blocks": {"lag": {"type": "Integrator"}},
                        "wires": {"lag.u": "v"}},
            "ports": {"@": "v", "y": "w"}},
    "same": {"diagram": {"inputs": {"@": {}}, "outputs": {"y": "@"}}},
    "gain": {"type": "Gain", "ports": {"@": "u"}}}}},
 "wires": {"plant.@": "source.y"}, "run": {"log": ["plant.lag.y", "plant.y"]}}
"""


def test_variants_have_the_new_name_of_a_port_as_well(tmp_path: Path) -> None:
    for variant in ("base", "own", "same", "gain"):
        log = ["plant.y"] if variant in ("same", "gain") else ["plant.lag.y"]
        Diagram.from_json(VARIANTS.replace("@", "u")).flatten(variants={"plant": variant}, log=log)
    text = VARIANTS.replace("@", "u")
    assert renamed(tmp_path, text, "plant.u", "volt") == VARIANTS.replace("@", "volt")  # the name u of Gain stays
    assert renamed(tmp_path, text, "plant.lag", "core") == text.replace('"lag"', '"core"').replace("lag.", "core.")
    own = renamed(tmp_path, text, "plant.v", "volt")
    assert own == text.replace('"v"', '"volt"')


def test_a_port_that_a_variant_shares_without_saying_so_is_refused_with_the_cure(tmp_path: Path) -> None:
    text = VARIANTS.replace("@", "u").replace(', "ports": {"u": "u"}', "")
    fault = refused(tmp_path, text, "plant.u", "volt")
    assert (fault.code, fault.place, fault.line) == ("E501", "plant.u", 13)
    assert '"ports": {"u": "u"}' in fault.cure
    renamed(tmp_path, VARIANTS.replace("@", "u"), "plant.u", "volt")  # as the cure says


def test_expressions_are_edited_by_names_and_not_by_letters(tmp_path: Path) -> None:
    text = """{"format": "blocks-diagram", "version": 3, "parameters": {"@": 2, "@1": 3, "sin": 4, "exp": 1},
     "blocks": {"g": {"type": "Gain", "parameters": {"k": "=[@]+@1*sin(@2)/ [@]**[@]-exp( 1e2*[@] )+exp"}}}}"""
    text = text.replace("@2", "[@]").replace('"@":', '"[@]":')
    old = text.replace("[@]", "e").replace("@", "e")
    assert renamed(tmp_path, old, "e", "rate") == text.replace("[@]", "rate").replace("@", "e")
    made = renamed(tmp_path, old, "exp", "power")
    assert "-exp( 1e2*e )+power" in made
    assert '"power": 1' in made


# --- what cannot be had ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("lag", "1st", "E111", "is not a name"),
        ("lag", "part.lag", "E111", "Give the name alone, without its path: lag."),
        ("lag", "Gain", "E109", "is already the name of a block"),
        ("lag", "r", "E109", "is already the name of an input"),
        ("r", "Kp", "E109", "is already the name of a parameter"),
        ("Kp", "lag", "E109", "is already the name of a block"),
        ("speed", "r_out", "E109", "is already the name of an output"),
        ("speed", "r", "E109", "is already the name of an input"),
        ("r", "speed", "E109", "is already the name of an output"),
        ("speed", "time", "E109", "time column of results"),
        ("Kp", "pi", "E109", "constant"),
        ("lag", "lag", "E109", "is already its name"),
        ("lga", "x", "E105", "Did you mean 'lag'?"),
        ("prat.lag", "x", "E105", "Did you mean 'part'?"),
        ("part.lga", "x", "E105", "Did you mean 'lag'?"),
        ("lag.y", "x", "E105", "is not a subdiagram"),
        ("lag", "x\ny", "E111", r"x\ny"),
        ("lag\x1b", "x", "E105", r"\u001b"),
        ("", "x", "E105", "there is no"),
        (".", "x", "E105", "there is no"),
    ],
)
def test_what_cannot_be_renamed_is_told_with_its_cure(
    old: str, new: str, code: str, words: str, tmp_path: Path
) -> None:
    fault = refused(tmp_path, filled(LOOP), old, new)
    assert fault.code == code
    assert words in str(fault)
    assert "\x1b" not in str(fault)
    assert "\n" not in str(fault)


def test_a_name_that_would_make_another_one_mean_something_else_is_refused(tmp_path: Path) -> None:
    text = """{"format": "blocks-diagram", "version": 3, "outputs": {"o": "g.y"}, "blocks": {"g": {"type": "Sine"}%s},
     "run": {"log": ["g", "o"]}, "layout": {"o": [1, 2]%s}}"""
    assert '"o": [1, 2]' in renamed(tmp_path, text % ("", ""), "g", "h")
    # The place of the output would be that of the block, and the log would not name the block any more.
    assert "would then refer to something else" in refused(tmp_path, text % ("", ""), "g", "o").message
    fault = refused(tmp_path, text % ("", ', "g": [0, 0]'), "g", "o")
    assert (fault.code, fault.message) == ("E109", 'would make "o" appear twice.')
    # What is not there yet would be found.
    open_end = (text % (', "h": {"type": "Gain"}', "")).replace('"run"', '"wires": {"h.u": "new.y"}, "run"')
    assert "would then refer to something else" in refused(tmp_path, open_end, "g", "new").message


def test_the_input_of_an_enabled_subdiagram_cannot_take_the_name_of_its_switch(tmp_path: Path) -> None:
    text = """{"format": "blocks-diagram", "version": 3,
     "blocks": {"c": {"type": "Constant"}, "on": {"type": "CompareToConstant"},
     "s": {"diagram": {"inputs": {"u": {}}, "outputs": {"y": "u"}}, "enable": {}}},
     "wires": {"s.u": "c.y", "s.enable": "on.y", "on.u": "c.y"}}"""
    assert '"s.v": "c.y", "s.enable"' in renamed(tmp_path, text, "s.u", "v")
    assert refused(tmp_path, text, "s.u", "enable").code in ("E109", "E501")


def test_what_lies_in_another_file_is_renamed_there(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    inner = (
        '{"format": "blocks-diagram", "version": 3, "blocks": {"w": {"diagram": {"blocks": {"g": {"type": "Sine"}}}}}}'
    )
    (tmp_path / "parts" / "p.json").write_text(inner, encoding="utf-8")
    text = inner.replace('{"type": "Sine"}', '{"diagram": "parts/p.json"}').replace("w", "a").replace('"g"', '"b"')
    fault = refused(tmp_path, text, "a.b.w.g", "h")
    assert fault.code == "E501"
    words = fault.cure.split()
    assert words[:2] == ["blocks", "rename"]
    assert Path(words[2]).resolve() == tmp_path / "parts" / "p.json"
    assert words[3:] == ["w.g", "h"]
    assert refused(tmp_path, text, "a.b.w.x", "h").code == "E105"


def test_a_file_that_is_no_readable_diagram_is_refused(tmp_path: Path) -> None:
    for text, code in [
        ("{", "E001"),
        ('{"a": 1, "a": 2}', "E002"),
        ('{"format": "blocks-study", "version": 1}', "E006"),
        ("[]", "E006"),
    ]:
        assert refused(tmp_path, text, "a", "b").code == code


def test_a_file_with_faults_is_renamed_and_keeps_its_faults(tmp_path: Path) -> None:
    text = """{"format": "blocks-diagram", "version": 3, "blokcs": {},
     "parameters": {"@": "=@ + ", "q": "=@ @", "r": "=@*nobody"},
     "blocks": {"g": {"type": "Nothing", "parameters": {"k": "=@"}}, "h": 5,
                "no name": {"type": "Gain", "parameters": {"k": "=@"}}},
     "wires": {"g": "@", "x.u": "g.y", "g.u": 7}, "measures": {"m": {"of": "g.y", "to": ["=@"]}},
     "layout": {"z": 1}, "run": {"log": 5}}"""
    assert renamed(tmp_path, text.replace("@", "k1"), "k1", "gain") == text.replace("@", "gain")
    # The text of a fault's place may change: its code and its line do not.
    old, new = (codes(text.replace("@", name)) for name in ("k1", "gain"))
    assert old == new
    assert len(old) > 5


def codes(text: str) -> list[tuple[str, int]]:
    with pytest.raises(ModelError) as caught:
        loads(text)
    return [(fault.code, fault.line) for fault in caught.value.faults]


# --- files, commands -------------------------------------------------------------------------------------------


def test_the_command_tells_what_it_changes_and_a_dry_run_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "d.json"
    path.write_text(filled(LOOP), encoding="utf-8")
    path.chmod(0o640)
    assert main(["rename", str(path), "speed", "omega", "--dry-run"]) == 0
    dry = capsys.readouterr()
    assert path.read_text(encoding="utf-8") == filled(LOOP)
    assert main(["rename", str(path), "speed", "omega"]) == 0
    told = capsys.readouterr()
    assert path.read_text(encoding="utf-8") == filled(LOOP, output="omega")
    assert path.stat().st_mode & 0o777 == 0o640
    lines = told.out.splitlines()
    assert lines[0] == f"{path}:6:15: speed -> omega"
    assert lines[-1] == f"{path}: the output speed is omega now, in 4 places"
    assert len(lines) == 5
    assert dry.out == told.out.replace(" is omega", " would be omega")
    assert (dry.err, told.err) == ("", "")


def test_the_command_tells_programs_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.json"
    path.write_text(filled(LOOP), encoding="utf-8")
    assert main(["rename", str(path), "Kp", "gain", "--json", "--dry-run"]) == 0
    *changes, done = map(json.loads, capsys.readouterr().out.splitlines())
    assert done["count"] == LOOP.count("~Kp~")
    assert (done["kind"], done["old"], done["new"], done["written"]) == ("parameter", "Kp", "gain", False)
    assert done["files"] == [str(path)]
    assert {change["event"] for change in changes} == {"change"}
    twice = next(change for change in changes if change["old"] == "= Kp * Kp2 + Kp")
    assert twice["new"] == "= gain * Kp2 + gain"
    lines = filled(LOOP).splitlines()
    assert all(lines[c["line"] - 1][c["column"] :].startswith(c["old"]) for c in changes)


def test_a_refused_renaming_leaves_the_file_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.json"
    path.write_text(filled(LOOP), encoding="utf-8")
    before = os.stat(path).st_mtime_ns
    assert main(["rename", str(path), "lag", "Gain"]) == 2
    assert f"E109 {path}:8:3 Gain: is already the name of a block." in capsys.readouterr().err
    assert os.stat(path).st_mtime_ns == before


PROJECT = {
    "part.json": """{"format": "blocks-diagram", "version": 3, "parameters": {"~k~": 1}, "inputs": {"^u^": {}},
 "outputs": {"<y>": "[g].y"}, "blocks": {"[g]": {"type": "Gain", "parameters": {"k": "=~k~"}}},
 "wires": {"[g].u": "^u^"}}""",
    "sub/middle.json": """{"format": "blocks-diagram", "version": 3, "inputs": {"u": {}}, "outputs": {"y": "p.<y>"},
 "blocks": {"p": {"diagram": "../part.json", "parameters": {"~k~": 5}}, "u2": {"type": "Gain"}},
 "wires": {"p.^u^": "u", "u2.u": "p.<y>"}, "run": {"log": ["p.[g].y"]}}""",
    "top.json": """{"format": "blocks-diagram", "version": 3, "inputs": {"r": {"default": 1}},
 "blocks": {"m": {"diagram": "sub/middle.json"}, "g": {"type": "Gain"}}, "wires": {"m.u": "r", "g.u": "m.y"},
 "run": {"stop": 1, "log": ["m.p.[g].y", "g.y"]}}""",
    "study.json": """{"format": "blocks-study", "version": 1,
 "runs": {"a": {"diagram": "top.json", "parameters": {"m.p.~k~": "=1", "m.p.[g].k": 2},
                "settings": {"log": ["m.p.[g]"]}},
          "b": {"diagram": "sub/middle.json"}},
 "figures": [{"name": "f", "panels": [{"lines": [{"run": "a", "signal": "m.p.[g].y"},
   {"run": "b", "signal": "p.[g].y"}]}]}]}""",
    "broken.json": '{"format": "blocks-diagram", "g": ',
    "list.json": '["g"]',
}
PART = {"block": "g", "input": "u", "parameter": "k", "output": "y"}


def project(folder: Path, **names: str) -> dict[str, str]:
    """A project's files, with other names of one kind."""
    made = {}
    for name, text in PROJECT.items():
        for kind, (left, right) in MARKS.items():
            new = names.get(kind, PART[kind])
            text = re.sub(rf"{re.escape(left)}{PART[kind]}{re.escape(right)}", new, text)
        made[name] = text
    if not names:
        (folder / "pyproject.toml").touch()
        (folder / "sub").mkdir()
        for name, text in made.items():
            (folder / name).write_text(text, encoding="utf-8")
    return made


def read(folder: Path) -> dict[str, str]:
    return {name: (folder / name).read_text(encoding="utf-8") for name in PROJECT}


@pytest.mark.parametrize("kind", PART)
def test_other_files_that_use_the_name_are_told_and_left_alone(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, after = project(tmp_path), project(tmp_path, **{kind: "fresh"})
    assert main(["rename", str(tmp_path / "part.json"), PART[kind], "fresh"]) == 0
    assert read(tmp_path) == before | {"part.json": after["part.json"]}
    told = set()
    for line in capsys.readouterr().err.splitlines():
        line = line.removesuffix(" (--project changes it as well)")
        found = re.fullmatch(r"warning: left unchanged: (.*):(\d+):(\d+): (\S+) -> (\S+)", line)
        assert found is not None
        name, at, column, old, new = found.groups()
        name = os.path.relpath(name, os.path.relpath(tmp_path))
        texts = [one[name].splitlines()[int(at) - 1] for one in (before, after)]
        assert texts[0][int(column) - 1 :].startswith(f'"{old}"')
        assert f'"{new}"' in texts[1]
        told.add((name, int(at), int(column)))
    changed = sum(len(re.findall(r"\bfresh\b", after[name])) for name in ("sub/middle.json", "top.json", "study.json"))
    assert len(told) == changed > 0


@pytest.mark.parametrize("kind", PART)
def test_other_files_are_edited_as_well_where_that_is_asked_for(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project(tmp_path)
    was = Diagram.load(tmp_path / "top.json").run(engine="reference")
    after = project(tmp_path, **{kind: "fresh"})
    assert main(["rename", str(tmp_path / "part.json"), PART[kind], "fresh", "--project"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert read(tmp_path) == after
    files_changed = sum(after[name] != text for name, text in project(tmp_path / "none", x="").items())
    assert f"places of {files_changed} files" in told.out
    now = Diagram.load(tmp_path / "top.json").run(engine="reference")
    assert np.array_equal(was.values, now.values)


def test_a_project_is_edited_as_a_whole_or_not_at_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = project(tmp_path)
    write = write_atomically

    def refuse(path: Any, **options: Any) -> Any:
        if str(path).endswith("study.json"):
            raise UsageError(Fault("E501", str(path), "cannot be written."))
        return write(path, **options)

    monkeypatch.setattr("blocks.editing.edits.write_atomically", refuse)
    assert main(["rename", str(tmp_path / "part.json"), "g", "fresh", "--project"]) == 2
    assert "E501" in capsys.readouterr().err
    assert read(tmp_path) == before
    assert sorted(path.name for path in tmp_path.rglob("*.json")) == sorted(Path(name).name for name in PROJECT)


def test_a_project_in_which_a_name_would_be_lost_is_left_alone(tmp_path: Path) -> None:
    before = project(tmp_path)
    # A variant that has a port of the same name, and does not say so.
    middle = before["sub/middle.json"].replace('{"k": 5}}', '{"k": 5}, "variants": {"v": {"type": "Gain"}}}')
    (tmp_path / "sub" / "middle.json").write_text(middle, encoding="utf-8")
    with pytest.raises(
        UsageError,
        match=r"sub/middle.json:3:12 p.u: is also a port of another file, of a type "
        r"or of an FMU",
    ):
        renaming(tmp_path / "part.json", "u", "fresh", project=True)
    assert renaming(tmp_path / "part.json", "u", "fresh").texts.keys() == {str(tmp_path / "part.json")}


def test_a_large_project_is_looked_through_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project(tmp_path)
    assert renaming(tmp_path / "part.json", "g", "fresh").note == ""
    for bound, most in (("MOST_FILES", 1), ("MOST_FOLDERS", 0), ("MOST_BYTES", 10)):
        with monkeypatch.context() as patch:
            patch.setattr(f"blocks.editing.edits.{bound}", most)
            assert "not all of its files" in renaming(tmp_path / "part.json", "g", "fresh").note


# --- any diagram -----------------------------------------------------------------------------------------------


class Plan:
    """A random diagram as JSON text in which §3§ stands for the name of thing 3, wherever that is meant.

    So the text with another name for one thing is known without knowing what refers to what.
    """

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.kinds: list[str] = []  # of each thing
        self.paths: list[str] = []  # of each thing, with marks
        self.rivals: list[list[int]] = []  # groups of things of different names
        outer: dict[str, Any] = {"format": "blocks-diagram", "version": 3}
        self.signals: list[str] = []
        self.leaves: list[str] = []
        ports = self.body(outer, "", rng.randint(0, 2))
        outer["run"] = {"stop": 0.5, "method": "euler", "step": 0.125, "log": rng.sample(self.signals, 1)}
        outer["run"]["log"] += rng.sample(self.signals, min(4, len(self.signals)))
        outer["run"]["inputs"] = {name: rng.random() for name in ports["input"]}
        if self.leaves:
            outer["run"]["master"] = {"steps": {rng.choice(self.leaves): 0.1}}
        of, against = rng.choice(self.signals), rng.choice(self.signals)
        outer["measures"] = {"a": {"type": "IAE", "of": of, "against": against}}
        begin = self.expression(ports["parameter"], "0*{}")
        outer["measures"]["b"] = {"type": "ISE", "of": of, "from": begin, "to": 0.4}
        self.text = json.dumps(outer, indent=rng.choice([None, 0, 3]), ensure_ascii=False)

    def thing(self, kind: str, prefix: str) -> str:
        self.kinds.append(kind)
        name = f"§{len(self.kinds) - 1}§"
        self.paths.append(prefix + name)
        return name

    def expression(self, parameters: list[str], form: str = "{} + 2*({})/({})") -> Any:
        if not parameters:
            return 0.25
        return "=" + re.sub(r"\{\}", lambda _: self.rng.choice(parameters), form)

    def body(self, value: dict[str, Any], prefix: str, depth: int) -> dict[str, list[str]]:
        rng, first = self.rng, len(self.kinds)
        names = {kind: [self.thing(kind, prefix) for _ in range(rng.randint(least, 2))]
                 for kind, least in (("parameter", 0), ("input", 1), ("output", 1))}  # fmt: skip
        blocks = [self.thing("block", prefix) for _ in range(rng.randint(1, 3))]
        shared = [k for k in range(first, len(self.kinds)) if self.kinds[k] != "output"]
        outputs = [k for k in range(first, len(self.kinds)) if self.kinds[k] in ("output", "input")]
        self.rivals += [shared, outputs]
        known: list[str] = []
        value["parameters"] = {}
        for name in names["parameter"]:
            plain = rng.choice([1.5, {"value": 2, "doc": "Kp"}])
            value["parameters"][name] = plain if rng.random() < 0.5 else self.expression(known)
            known.append(name)
        value["inputs"] = {name: {"default": 0.5} for name in names["input"]}
        sources, wires = list(names["input"]), {}
        value["blocks"] = {}
        for name in blocks:
            entry: dict[str, Any] = {}
            if depth and rng.random() < 0.5:
                entry["diagram"] = {}
                inner = self.body(entry["diagram"], f"{prefix}{name}.", depth - 1)
                entry["parameters"] = {one: self.expression(known) for one in inner["parameter"]}
                wires |= {f"{name}.{one}": rng.choice(sources) for one in inner["input"] if rng.random() < 0.8}
                made = [f"{name}.{one}" for one in inner["output"]]
            else:
                entry |= {"type": "Gain", "parameters": {"k": self.expression(known)}}
                if rng.random() < 0.3:
                    entry["variants"] = {"v": {"type": "Gain", "parameters": {"k": self.expression(known)}}}
                wires[f"{name}.u"] = rng.choice(sources)
                made = [f"{name}.y"]
                self.leaves.append(f"{prefix}{name}")
            value["blocks"][name] = entry
            sources += made
            self.signals += [prefix + one for one in made]
        value["outputs"] = {name: rng.choice(sources) for name in names["output"]}
        if not prefix:
            self.signals += [*names["input"], *names["output"]]
        value["wires"] = wires
        value["layout"] = {name: [rng.randint(0, 9), 1] for name in (*blocks, *names["input"]) if rng.random() < 0.5}
        return names

    def named(self) -> dict[int, str]:
        """Names from a small pool, so that one name means many things, wherever that is allowed."""
        made: dict[int, str] = {}
        for k in range(len(self.kinds)):
            taken = {made.get(other) for group in self.rivals if k in group for other in group}
            made[k] = self.rng.choice(
                [name for name in [*"abcyukv", "Gain", "sin", "x1", "IAE", "type", "value"] if name not in taken]
            )
        return made

    def filled(self, text: str, names: dict[int, str]) -> str:
        return re.sub("§([0-9]+)§", lambda found: names[int(found[1])], text)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), is_fresh=st.booleans())
@example(seed=0, is_fresh=True)
def test_any_name_of_any_diagram_can_be_renamed_and_back(seed: int, is_fresh: bool, tmp_path: Path) -> None:
    rng = random.Random(seed)
    plan = Plan(rng)
    names = plan.named()
    thing = rng.randrange(len(plan.kinds))
    new = "quite_new" if is_fresh else rng.choice(["a", "b", "y", "k", "Gain", "sin"])
    text, kind = plan.filled(plan.text, names), plan.kinds[thing]
    old = plan.filled(plan.paths[thing], names)
    expected = plan.filled(plan.text, {**names, thing: new})
    try:
        made = renamed(tmp_path, text, old, new, kind=kind, elsewhere=False)
    except BlocksError as error:
        if is_fresh or error.code not in ("E109", "E501"):  # a name that is taken, or that would hide another one
            raise
        return
    assert made == expected
    back = old.rpartition(".")[0] + "." + new if "." in old else new
    assert renamed(tmp_path, made, back, names[thing], kind=kind, elsewhere=False) == text
    before, after = (Diagram.from_json(one).run(engine="reference") for one in (text, made))
    assert np.array_equal(before.t, after.t)
    assert np.array_equal(before.values, after.values)
    assert [kept[0] for kept in before.columns.values()] == [kept[0] for kept in after.columns.values()]
    assert [repr(value) for value in before.measures.values()] == [repr(value) for value in after.measures.values()]


@pytest.mark.parametrize(
    "name", ["motor_pid", "paper/adrc", "paper/robot", "paper/iadrc_fmu", "sampled_loop", "adrc/cruise_control"]
)
def test_every_name_of_the_shipped_diagrams_can_be_renamed_and_back(name: str, tmp_path: Path) -> None:
    path = DIAGRAMS / f"{name}.json"
    text, value = path.read_text(encoding="utf-8"), load(path)
    for kind in ("block", "input", "parameter", "output"):
        for old in getattr(value, f"{kind}s"):
            made = renaming(path, old, "fresh_1", kind=kind, elsewhere=False)  # type: ignore[arg-type]
            assert made.text != text
            changed = [(a, b) for a, b in zip(text.splitlines(), made.text.splitlines(), strict=True) if a != b]
            assert all(re.sub(rf"\b{old}\b", "§", a) == re.sub(rf"\b(?:{old}|fresh_1)\b", "§", b) for a, b in changed)


def test_files_that_contain_themselves_in_many_ways_are_followed_once(tmp_path: Path) -> None:
    entry = {"diagram": "d.json", "variants": {f"v{k}": {"diagram": "d.json"} for k in range(20)}}
    log = [".".join(["a"] * count) for count in (1, 5, 29, 20_000)]
    text = json.dumps({"format": "blocks-diagram", "version": 3, "blocks": {"a": entry}, "run": {"log": log}})
    made = renamed(tmp_path, text, "a", "b", elsewhere=False)
    names = [path.count("b") for path in json.loads(made)["run"]["log"]]
    assert names[:3] == [1, 5, 29]
    assert names[3] < 40, "no more than subdiagrams can lie in each other"


def test_what_would_take_too_long_is_refused(tmp_path: Path) -> None:
    variants = {f"v{k}": {"type": "Gain"} for k in range(2_000)}
    blocks = {"a": {"type": "Gain", "variants": variants}}
    document = {"format": "blocks-diagram", "version": 3, "blocks": blocks, "run": {"log": ["a.y"] * 600}}
    assert refused(tmp_path, json.dumps(document), "a", "b").code == "E008"
    (tmp_path / "big.json").write_text(json.dumps(document), encoding="utf-8")
    document["run"] = {}
    path = tmp_path / "d.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    assert "big.json has too many names" in renaming(path, "a", "b").note


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="E007"):
        renaming(tmp_path / "none.json", "a", "b")
    with pytest.raises(UsageError, match="E111"):
        renaming(DIAGRAMS / "motor_pid.json", "motor", "a b")


# --- names that are at fault -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["input", "output"])
def test_a_name_that_is_taken_twice_is_mended_by_renaming(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(
        '{"format": "blocks-diagram", "version": 3, "inputs": {"u": {}}, "outputs": {"u": "g.y"},\n'
        ' "blocks": {"g": {"type": "Gain"}}, "wires": {"g.u": "u"}}\n',
        encoding="utf-8",
    )
    with pytest.raises(ModelError):
        Diagram.load(path).check()
    assert main(["rename", str(path), "u", "w", "--kind", kind]) == 0
    Diagram.load(path).check()


def test_a_parameter_that_a_variant_does_not_share_is_not_taken_for_a_port(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.json").write_text(
        '{"format": "blocks-diagram", "version": 3, "parameters": {"k": 2}, "inputs": {"u": {}},\n'
        ' "outputs": {"y": "g.y"}, "blocks": {"g": {"type": "Gain", "parameters": {"k": "=k"}}}, '
        '"wires": {"g.u": "u"}}\n',
        encoding="utf-8",
    )
    (tmp_path / "top.json").write_text(
        '{"format": "blocks-diagram", "version": 3, "blocks": {"s": {"type": "Step"}, "q": {"diagram": "p.json",\n'
        ' "variants": {"other": {"type": "FirstOrder", "ports": {"u": "u", "k": "k"}}}}}, "wires": {"q.u": "s.y"},\n'
        ' "measures": {"m": {"type": "peak", "of": "q.y"}}}\n',
        encoding="utf-8",
    )
    study = (
        '{"format": "blocks-study", "version": 1,\n'
        ' "runs": {"a": {"diagram": "top.json", "parameters": {"q.k": 4}, "variants": {"q": "other"}}},\n'
        ' "claims": [{"run": "a", "measure": "m"}]}\n'
    )
    (tmp_path / "st.json").write_text(study, encoding="utf-8")
    assert main(["rename", str(tmp_path / "p.json"), "k", "K", "--project"]) == 2
    told = capsys.readouterr().err
    assert "E501" in told
    assert "leave out --project" in told
    assert (tmp_path / "st.json").read_text(encoding="utf-8") == study


def test_the_number_of_copies_follows_its_parameter(tmp_path: Path) -> None:
    lags = {"copies": "=n", "type": "FirstOrder", "parameters": {"T": "=1+index/n"}}
    file = tmp_path / "lags.json"
    head = {"format": "blocks-diagram", "version": 3, "name": "lags", "parameters": {"n": 3}, "inputs": {"u": {}}}
    file.write_text(json.dumps({**head, "blocks": {"lags": lags}, "wires": {"lags.u": "u"}}))
    assert main(["rename", str(file), "n", "count"]) == 0
    assert json.loads(file.read_text())["blocks"]["lags"]["copies"] == "=count"
    assert len(Diagram.load(file).plan().states) == 3


def test_names_of_studies_follow_where_each_copy_gets_a_value(tmp_path: Path) -> None:
    inner = {"parameters": {"T": 1}, "blocks": {"lag": {"type": "FirstOrder"}}, "inputs": {"u": {}},
             "wires": {"lag.u": "u"}}  # fmt: skip
    blocks = {"wave": {"type": "Sine"}, "a": {"copies": 2, "diagram": inner}}
    fleet = {"format": "blocks-diagram", "version": 3, "blocks": blocks, "wires": {"a.u": "wave.y"}, "run": {"stop": 1}}
    given = {"a[*].lag.T": [1, 2], "a[1].lag.k": 2}
    row = {"diagram": "fleet.json", "vary": {"each(a[*].lag.y_start)": [1], "each(a.T)": [2]}}
    study = {"format": "blocks-study", "version": 1, "runs": {"r": {"diagram": "fleet.json", "parameters": given}},
             "sweeps": {"s": row}}  # fmt: skip
    (tmp_path / ".git").mkdir()
    (tmp_path / "study.json").write_text(json.dumps(study))
    file = tmp_path / "fleet.json"
    file.write_text(json.dumps(fleet))
    for old, new in (("a", "robots"), ("robots.lag", "motor"), ("robots.T", "tau")):
        assert main(["rename", "--project", str(file), old, new]) == 0
    renamed = json.loads((tmp_path / "study.json").read_text())
    assert list(renamed["runs"]["r"]["parameters"]) == ["robots[*].motor.T", "robots[1].motor.k"]
    assert list(renamed["sweeps"]["s"]["vary"]) == ["each(robots[*].motor.y_start)", "each(robots.tau)"]
