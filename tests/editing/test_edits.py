"""Edits of files by operations: what changes, what stays, what is refused, and that nothing is half written."""

from __future__ import annotations

import copy
import io
import itertools
import json
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks import BlocksError, Diagram, edit_file
from blocks.cli import main
from blocks.editing import edits
from blocks.editing.operations import OPERATIONS
from blocks.editing.renaming import flat_of
from blocks.model import document as documents
from blocks.studies.study import load
from blocks.text import json_document
from blocks.text.errors import Fault, UsageError
from blocks.text.json_text import read
from tests.support.marks import long_but
from tests.support.places import ROOT

GROUPED = (
    "iadrc.json", "platoon.json", "robot.json", "control_iadrc_sampled.json", "motor_pid.json", "iadrc_fmu.json"
)  # fmt: skip
DIAGRAMS = sorted(path for path in (ROOT / "diagrams").rglob("*.json") if '"blocks-diagram"' in path.read_text())
LOOP = """\
{
 "format": "blocks-diagram",
 "version": 3,
 "name": "loop",
 "parameters": {
  "k": 2.50,
  "twice": "=2*k"
 },
 "inputs": {
  "r": {"default": 1}
 },
 "outputs": {
  "y": "lag.y",
  "u": "gain.y"
 },
 "blocks": {
  "error": {"type": "Sum", "parameters": {"signs": "+-"}},
  "gain": {"type": "Gain", "parameters": {"k": "=twice"}},
  "lag": {"type": "FirstOrder", "parameters": {"T": 0.50}}
 },
 "wires": {
  "error.u1": "r",
  "error.u2": "lag.y",
  "gain.u": "error.y",
  "lag.u": "gain.y"
 },
 "run": {"stop": 2, "log": ["lag", "gain.y", "error.y"]},
 "measures": {
  "itae": {"type": "ITAE", "of": "lag.y", "against": "r"},
  "effort": {"type": "ISU", "of": "gain.y"}
 },
 "layout": {
  "error": [40, 40],
  "gain": [140, 40],
  "lag": [240, 41]
 }
}
"""


def project(folder: Path, **files: Any) -> Path:
    """A project with files of JSON; the path of the first one."""
    (folder / "pyproject.toml").touch()
    for name, value in files.items():
        text = value if isinstance(value, str) else json.dumps(value)
        (folder / f"{name}.json").write_text(text, encoding="utf-8", newline="")
    return folder / f"{next(iter(files))}.json"


def edited(folder: Path, text: str, *operations: dict[str, Any], **options: Any) -> str:
    path = project(folder, d=text)
    edit = edit_file(path, operations, **options)
    assert path.read_text() == text, "nothing is written but by `write`"
    assert edit.undone.texts == edit.were
    return edit.texts.get(str(path), text)


def lines(text: str, *gone: str, **new: str) -> str:
    """The lines of a text but for some that are gone."""
    return "".join(line for line in text.splitlines(keepends=True) if not any(word in line for word in gone))


def refused(folder: Path, text: str, *operations: Any, **options: Any) -> Fault:
    path = project(folder, d=text)
    with pytest.raises(BlocksError) as caught:
        edit_file(path, operations, **options)
    assert path.read_text() == text
    return caught.value.faults[0]


# --- one operation after the other -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("operation", "old", "new"),
    [
        ({"set": "blocks.lag.parameters.T", "to": 0.25}, "0.50", "0.25"),
        ({"set": ["blocks", "lag", "parameters", "T"], "to": 0.25}, "0.50", "0.25"),
        ({"set": "blocks.lag.parameters.T", "to": 0.5}, "", ""),
        ({"set": "run.method", "to": "rk4"}, '"stop": 2, ', '"stop": 2, "method": "rk4", '),
        ({"set": 'wires["lag.u"]', "to": "error.y"}, '"lag.u": "gain.y"', '"lag.u": "error.y"'),
        ({"set": "doc", "to": "A loop."}, ' "parameters": {\n  "k"', ' "doc": "A loop.",\n "parameters": {\n  "k"'),
        ({"set": "run.master.step", "to": 0.1}, '"error.y"]}', '"error.y"], "master": {"step": 0.1}}'),
        ({"add": "run.log", "value": "r"}, '"error.y"]', '"error.y", "r"]'),
        ({"add": "run.log[0]", "value": "r"}, '["lag"', '["r", "lag"'),
        (
            {"add": "blocks.free", "value": {"type": "Gain", "parameters": {"k": 1e0}}},
            '0.50}}\n', '0.50}},\n  "free": {"type": "Gain", "parameters": {"k": 1.0}}\n',
        ),
        ({"remove": "run.log[1]"}, '"gain.y", ', ""),
        ({"remove": "run.log[1]", "was": "gain.y"}, '"gain.y", ', ""),
        ({"remove": "blocks.lag.parameters.T", "was": 0.5}, ', "parameters": {"T": 0.50}', ""),
        ({"remove": "blocks.lag.parameters.T"}, ', "parameters": {"T": 0.50}', ""),
        ({"wire": "lag.y", "to": "gain.k"}, '"gain.y"\n },\n "run"', '"gain.y",\n  "gain.k": "lag.y"\n },\n "run"'),
        ({"unwire": "lag.u"}, ',\n  "lag.u": "gain.y"', ""),
        ({"move": "lag", "to": [240, 50.5]}, "[240, 41]", "[240, 50.5]"),
        ({"move": "r", "to": [0, 1]}, "[240, 41]", '[240, 41],\n  "r": [0, 1]'),
        ({"rename": "measures.itae", "to": "error"}, '"itae"', '"error"'),
        ({"rename": 'wires["lag.u"]', "to": "lag.x"}, '"lag.u"', '"lag.x"'),
    ],
)  # fmt: skip
def test_one_operation(operation: dict[str, Any], old: str, new: str, tmp_path: Path) -> None:
    assert LOOP.count(old) == 1 or not old
    assert edited(tmp_path, LOOP, operation) == LOOP.replace(old, new)


def test_what_is_removed_is_what_was_meant(tmp_path: Path) -> None:
    with pytest.raises(BlocksError, match=r'log\[0\]: is now "lag", not "gain.y". Check the present value'):
        edited(tmp_path, LOOP, {"remove": "run.log[0]", "was": "gain.y"})


def test_what_is_removed_goes_with_all_that_means_it(tmp_path: Path) -> None:
    text = lines(LOOP, '"gain.u"', '"lag.u"', '"gain": [', '"effort"', '"gain": {', '"u": "gain')
    text = text.replace('"gain.y", ', "").replace('"r"},\n }', '"r"}\n }').replace('lag.y",\n }', 'lag.y"\n }')
    text = text.replace('"error.y",\n }', "").replace('lag.y",\n },', 'lag.y"\n },')
    assert edited(tmp_path, LOOP, {"remove": "blocks.gain"}) == text.replace('"y": "lag.y",', '"y": "lag.y"')


@pytest.mark.parametrize(
    ("gone", "values"),
    [
        ("parameters.k", {"parameters": {"twice": "=2*2.50"}}),
        ("parameters.twice", {"gain": "=2*k"}),
        ("parameters", {"gain": "=2*2.50"}),
    ],
)
def test_a_parameter_leaves_its_value_where_it_was_read(gone: str, values: dict[str, Any], tmp_path: Path) -> None:
    new = edited(tmp_path, LOOP, {"remove": gone})
    value = json.loads(new)
    assert value.get("parameters") == values.get("parameters", {"k": 2.5} if gone != "parameters" else None)
    assert value["blocks"]["gain"]["parameters"]["k"] == values.get("gain", "=twice")
    assert Diagram.from_json(new).run().measures == Diagram.from_json(LOOP).run().measures


def test_a_parameter_with_a_unit_leaves_its_number_in_si(tmp_path: Path) -> None:
    text = json.dumps(NOISY, indent=1)
    value = json.loads(edited(tmp_path, text, {"remove": "parameters.k"}))
    assert value["parameters"] == {"b": "=0.2/2"}
    assert value["blocks"]["src"]["parameters"] == {"value": {"value": 200, "unit": "mV"}}
    row = text.replace('"=b"', '"=k"')  # where no unit can stand
    assert '"=0.2"' in edited(tmp_path, row, {"remove": "parameters.k"})


def test_what_would_compute_something_else_is_refused(tmp_path: Path) -> None:
    block = {"type": "Constant", "parameters": {"value": "=k"}}
    inner = {"parameters": {"k": 1}, "outputs": {"y": "g.y"}, "blocks": {"g": block}}
    text = json.dumps(
        {"format": "blocks-diagram", "version": 3, "blocks": {"part": {"diagram": inner, "parameters": {"k": 5}}}}
    )
    fault = refused(tmp_path, text, {"in": "part", "remove": "parameters.k"})
    assert fault.code == "E501"
    assert "which would change their values" in fault.message
    value = json.loads(text)
    value["parameters"] = {"h": {"value": "=2*3", "unit": "mV"}}
    value["blocks"]["part"]["parameters"]["k"] = "=h*2"
    assert "which cannot hold its value" in refused(tmp_path, json.dumps(value), {"remove": "parameters.h"}).message


STUDY = {
    "format": "blocks-study", "version": 1,
    "runs": {"one": {"diagram": "d.json", "parameters": {"lag.T": 1}}, "two": {"diagram": "d.json"}},
    "claims": [
        {"run": "one", "measure": "itae"}, {"runs": ["one", "two"], "measure": "effort", "as": "reduction"},
        {"run": "two", "measure": "effort"},
    ],
    "figures": [
        {"name": "a", "panels": [{"lines": [{"run": "one", "signal": "lag.y"}, {"run": "two", "signal": "gain.y"}]}]},
        {"name": "b", "panels": [{"lines": [{"run": "one", "signal": "gain.y"}]}]},
    ],
}  # fmt: skip


@pytest.mark.parametrize("whole", [False, True])
def test_other_files_are_told_or_edited(whole: bool, tmp_path: Path) -> None:
    path = project(tmp_path, d=LOOP, study=STUDY)
    edit = edit_file(path, [{"remove": "blocks.gain"}], project=whole)
    study = [text for name, text in edit.texts.items() if name.endswith("study.json")]
    assert bool(study) == whole
    assert bool(edit.elsewhere) != whole
    if whole:
        new = json.loads(study[0])
        assert [figure["name"] for figure in new["figures"]] == ["a"]  # a panel without a line goes, and its figure
        assert new["figures"][0]["panels"][0]["lines"] == [{"run": "one", "signal": "lag.y"}]
        assert [claim["measure"] for claim in new["claims"]] == ["itae"]  # the measure of gain.y is gone as well


def test_a_claim_about_two_diagrams_means_the_measures_of_both(tmp_path: Path) -> None:
    study = {**STUDY, "runs": {"one": {"diagram": "d.json"}, "two": {"diagram": "e.json"}}, "figures": []}
    path = project(tmp_path, d=LOOP, e=LOOP, study=study)
    edit = edit_file(path, [{"rename": "measures.effort", "to": "isu"}], project=True)
    assert len(edit.texts) == 3
    assert edit.texts == {name: text.replace('"effort"', '"isu"') for name, text in edit.were.items()}
    edit = edit_file(path, [{"remove": "measures.effort"}], project=True)
    study_now = json.loads(next(text for name, text in edit.texts.items() if "study" in name))
    assert [claim["run"] for claim in study_now["claims"]] == ["one", "two"]  # two has a measure of its own
    edit = edit_file(path, [{"remove": "measures.effort"}])
    assert [json.loads(change.old)["measure"] for change in edit.elsewhere] == ["effort"]


def test_a_run_of_a_study_goes_and_is_renamed_with_what_names_it(tmp_path: Path) -> None:
    path = project(tmp_path, study=STUDY, d=LOOP)
    new = json.loads(next(iter(edit_file(path, [{"remove": "runs.two"}]).texts.values())))
    assert [claim["measure"] for claim in new["claims"]] == ["itae"]
    assert len(new["figures"][0]["panels"][0]["lines"]) == 1
    new = json.loads(next(iter(edit_file(path, [{"rename": "runs.two", "to": "late"}]).texts.values())))
    assert json.dumps(new) == json.dumps(STUDY).replace('"two"', '"late"')


def test_a_measure_is_renamed_in_the_claims_about_it(tmp_path: Path) -> None:
    path = project(tmp_path, d=LOOP, study=STUDY)
    edit = edit_file(path, [{"rename": "measures.effort", "to": "isu"}], project=True)
    texts = {Path(name).name: text for name, text in edit.texts.items()}
    assert texts["d.json"] == LOOP.replace('"effort"', '"isu"')
    assert texts["study.json"] == json.dumps(STUDY).replace('"effort"', '"isu"')


VARIED = LOOP.replace(
    '  "lag": {"type": "FirstOrder", "parameters": {"T": 0.50}}\n',
    '  "lag": {\n   "type": "FirstOrder",\n   "variant": "slow",\n   "variants": {\n'
    '    "slow": {"type": "FirstOrder", "parameters": {"T": 2}}\n   }\n  }\n',
)


def test_variants_are_renamed_and_removed_with_the_choices_of_them(tmp_path: Path) -> None:
    study = {**STUDY, "runs": {"one": {"diagram": "d.json", "variants": {"lag": "slow"}}, "two": {"diagram": "d.json"}}}
    path = project(tmp_path, d=VARIED, study=study)
    edit = edit_file(path, [{"rename": "blocks.lag.variants.slow", "to": "old"}], project=True)
    assert sorted(text.count('"slow"') for text in edit.were.values()) == [1, 2]
    assert edit.texts == {name: text.replace('"slow"', '"old"') for name, text in edit.were.items()}
    edit = edit_file(path, [{"remove": "blocks.lag.variants.slow"}], project=True)
    assert edit.texts[str(path)] == LOOP.replace(', "parameters": {"T": 0.50}', "")
    changed = next(text for name, text in edit.texts.items() if "study" in name)
    assert "variants" not in json.loads(changed)["runs"]["one"]


# --- several blocks --------------------------------------------------------------------------------------------

NOISY = {
    "format": "blocks-diagram", "version": 3, "parameters": {"k": {"value": 200, "unit": "mV"}, "b": "=k/2"},
    "inputs": {"r": {"size": 2, "default": [1, 2], "unit": "V"}},
    "outputs": {"y": "sum.y"},
    "blocks": {
        "noise": {"type": "Noise", "parameters": {"period": 0.1}},
        "gain": {"type": "MatrixGain", "parameters": {"K": [["=b", 2]], "unit": "V", "unit_u": "V"}},
        "sum": {"type": "Sum", "parameters": {"signs": "++"}},
        "lag": {"type": "FirstOrder"},
        "src": {"type": "Constant", "parameters": {"value": "=k"}},
    },
    "wires": {"gain.u": "r", "sum.u1": "noise.y", "sum.u2": "lag.y", "lag.u": "src.y"},
    "run": {"stop": 2, "every": 0.05, "log": ["sum.y", "noise.y", "lag", "gain.y"], "seed": 3},
    "measures": {"m": {"type": "ISE", "of": "sum.y"}},
}  # fmt: skip


def results_of(text: str) -> tuple[list[Any], dict[str, float]]:
    results = Diagram.from_json(text).run()
    return [np.asarray(results[name]) for name in results], dict(results.measures)


@pytest.mark.parametrize(
    "names", [["noise"], ["noise", "sum"], ["gain"], ["lag", "sum", "src"], ["noise", "gain", "sum", "lag", "src"]]
)
def test_a_group_computes_what_its_blocks_did_and_can_be_undone(names: list[str], tmp_path: Path) -> None:
    text = json.dumps(NOISY, indent=1)
    new = edited(tmp_path, text, {"group": names, "as": "part"})
    assert [*json.loads(new)["blocks"]["part"]["diagram"]["blocks"]] == names
    again = edited(tmp_path, new, {"ungroup": "part"})
    told = [results_of(each) for each in (text, new, again)]
    for other in told[1:]:
        assert len(told[0][0]) == len(other[0])
        for a, b in zip(told[0][0], other[0], strict=True):
            np.testing.assert_array_equal(a, b)
        assert told[0][1] == other[1]
    value = json.loads(again)
    for section in ("inputs", "outputs", "parameters", "wires", "run", "measures"):
        assert value[section] == NOISY[section], section  # type: ignore[index]
    assert {**value["blocks"]} == {
        name: {**entry, "stream": "/noise"} if name == "noise" and name in names else entry
        for name, entry in NOISY["blocks"].items()  # type: ignore[attr-defined]
    }


def test_a_group_in_a_subdiagram_of_a_file_is_told_where_its_names_are_used(tmp_path: Path) -> None:
    outer = {
        "format": "blocks-diagram", "version": 3,
        "blocks": {"part": {"diagram": "d.json", "parameters": {"k": 3}}},
        "run": {"stop": 1, "log": ["part.lag.y", "part.gain", "part.y"]},
    }  # fmt: skip
    path = project(tmp_path, top=outer, d=LOOP)
    edit = edit_file(path, [{"in": "part", "group": ["gain", "lag"], "as": "plant"}], project=True)
    texts = {Path(name).name: json.loads(text) for name, text in edit.texts.items()}
    assert texts["top.json"]["run"]["log"] == ["part.plant.lag.y", "part.plant.gain", "part.y"]
    assert texts["d.json"]["outputs"] == {"y": "plant.y", "u": "plant.gain_y"}
    before = Diagram.load(path).run()
    edit.write()
    after = Diagram.load(path).run()
    for name, other in (("part.lag.y", "part.plant.lag.y"), ("part.gain.y", "part.plant.gain.y"), ("part.y",) * 2):
        np.testing.assert_array_equal(np.asarray(before[name]), np.asarray(after[other]))
    edit.undone.write()
    assert path.read_text() == json.dumps(outer)
    assert (tmp_path / "d.json").read_text() == LOOP


@pytest.mark.parametrize("name", long_but([path.name for path in DIAGRAMS], lambda name: name in GROUPED))
def test_any_blocks_of_the_shipped_diagrams_can_be_grouped_and_ungrouped(name: str, tmp_path: Path) -> None:
    path = next(path for path in DIAGRAMS if path.name == name)
    chance = random.Random(name)
    entries = json.loads(path.read_text()).get("blocks", {})
    blocks = [name for name, entry in entries.items() if entry.get("type") != "Noise"]
    for _ in range(3):
        some = chance.sample(blocks, min(len(blocks), chance.randint(1, 4)))
        edit = edit_file(path, [{"group": some, "as": "some_blocks"}])  # it compares the flat diagrams
        text = edit.texts[str(path)]
        assert documents.canonical(read(text)) == text
        again = edit_file(path, [{"ungroup": "some_blocks"}], text=text).texts[str(path)]
        assert documents.canonical(read(again)) == again
        now, was = json.loads(again), json.loads(path.read_text())
        for section in ("parameters", "inputs", "outputs", "wires", "measures", "run"):
            assert now.get(section) == was.get(section), section


@pytest.mark.parametrize("ports", [None, {"y": "y"}])
def test_swap_does_what_the_diagram_does(ports: Any, tmp_path: Path) -> None:
    path = project(tmp_path, d=LOOP)
    operation: dict[str, Any] = {"swap": "lag", "for": {"type": "Gain", "parameters": {"k": 4}}, "as": "static"}
    new = edited(tmp_path, LOOP, operation | ({"ports": ports} if ports else {}))
    diagram = Diagram.load(path)
    from blocks import Gain

    diagram.swap("lag", Gain(k=4), variant="static", ports=ports)
    assert documents.loads(new).blocks["lag"] == documents.from_document(diagram.to_json()).blocks["lag"]
    assert documents.canonical(read(new)) == new


def test_an_fmu_takes_the_place_of_a_motor_with_its_wires(tmp_path: Path) -> None:
    path = ROOT / "diagrams" / "motor_pid.json"
    edit = edit_file(path, [{"swap": "motor", "for": {"fmu": "../fmus/PMDCMotor.fmu"}}])
    entry = json.loads(edit.texts[str(path)])["blocks"]["motor"]
    assert entry["variants"] == {entry["variant"]: {"fmu": "../fmus/PMDCMotor.fmu"}}


def test_pasted_entries_get_names_that_are_free(tmp_path: Path) -> None:
    copy_of = {
        "parameters": {"k": 2.5, "twice": 7}, "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=twice*k"}},
        "lag": {"type": "FirstOrder"}, "fresh": {"type": "Gain"}},
        "wires": {"gain.u": "lag.y", "fresh.u": "gain.y", "lag.u": "r"}, "layout": {"gain": [1, 2]},
    }  # fmt: skip
    new = read(edited(tmp_path, LOOP, {"paste": copy_of, "by": [10, 20]})).value
    assert new["parameters"] == {"k": 2.5, "twice": "=2*k", "twice_2": 7}  # k is the same, and shared
    assert new["blocks"]["gain_2"] == {"type": "Gain", "parameters": {"k": "=twice_2*k"}}
    assert {sink: new["wires"][sink] for sink in list(new["wires"])[4:]} == {
        "gain_2.u": "lag_2.y", "fresh.u": "gain_2.y", "lag_2.u": "r",
    }  # fmt: skip
    assert new["layout"]["gain_2"] == [11, 22]


# --- several files ---------------------------------------------------------------------------------------------


def test_operations_reach_the_file_of_a_subdiagram_and_other_files(tmp_path: Path) -> None:
    top = {"format": "blocks-diagram", "version": 3, "blocks": {"part": {"diagram": "d.json"}}}
    path = project(tmp_path, top=top, d=LOOP, study=STUDY)
    operations = [
        {"in": "part", "set": "blocks.lag.parameters.T", "to": 9},
        {"file": "study.json", "set": "runs.one.parameters", "to": {"k": 1}},
    ]
    edit = edit_file(path, operations)
    assert sorted(Path(name).name for name in edit.texts) == ["d.json", "study.json"]
    edit.write()
    assert (tmp_path / "d.json").read_text() == LOOP.replace("0.50", "9")
    assert json.loads((tmp_path / "study.json").read_text())["runs"]["one"]["parameters"] == {"k": 1}


def test_an_edit_that_is_written_already_stays_where_it_is_written_again(tmp_path: Path) -> None:
    path = project(tmp_path, d=LOOP, e=LOOP)
    edit = edit_file(path, [{"file": f"{name}.json", "set": "run.stop", "to": 7} for name in "de"])
    edit.write()
    with pytest.raises(UsageError):
        edit.write()
    assert [(tmp_path / f"{name}.json").read_text() for name in "de"] == list(edit.texts.values())


def test_files_that_are_named_are_edited_and_no_others(tmp_path: Path) -> None:
    outer = {
        "format": "blocks-diagram", "version": 3, "blocks": {"part": {"diagram": "d.json"}},
        "run": {"log": ["part.y", "part.u"]},
    }  # fmt: skip
    path = project(tmp_path, top=outer, d=LOOP, other=outer)
    edit = edit_file(path, [{"in": "part", "remove": "outputs.u"}])
    assert json.loads(edit.texts[str(path)])["run"]["log"] == ["part.y"]
    assert [Path(change.file).name for change in edit.elsewhere] == ["other.json"]


def test_entries_that_move_up_in_a_list_are_not_told_as_changed(tmp_path: Path) -> None:
    path = project(tmp_path, study=json.dumps(STUDY, indent=2), d=LOOP)
    edit = edit_file(path, [{"remove": "runs.two"}])
    assert {change.new for change in edit.changes} == {""}
    kept = next(iter(edit.texts.values()))
    assert json.dumps(STUDY["claims"][0], indent=2).replace("\n", "\n    ") in kept


@pytest.mark.parametrize(
    ("operation", "code"),
    [
        ({"set": "blocks.gain.parameters.q", "to": 3}, "E106"),
        ({"set": "blocks.gain.parameters.k", "to": "=q"}, "E108"),
        ({"wire": "lag.u", "to": "gain.y"}, "E112"),
        ({"add": "run.log", "value": "error.z"}, "E105"),
        ({"remove": "wires[\"lag.u\"]"}, "E101"),
        ({"move": "gain", "to": [1, 2]}, ""),
    ],
)
def test_new_faults_are_told_and_refused_only_if_wanted(
    operation: Any, code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = project(tmp_path, d=LOOP, ops=[operation])
    assert [fault.code for fault in edit_file(path, [operation]).faults] == [code] * bool(code)
    assert edit_file(path, [operation], check=False).faults == ()
    ops = str(tmp_path / "ops.json")
    assert main(["apply", str(path), ops, "--strict"]) == (2 if code else 0)
    assert (path.read_text() == LOOP) == bool(code)
    assert main(["apply", str(path), ops]) == 0
    assert code in capsys.readouterr().err
    assert path.read_text() != LOOP


@pytest.mark.parametrize("how", ["changed", "refused"])
def test_all_files_are_written_or_none(how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = project(tmp_path, d=LOOP, e=LOOP, f=LOOP)
    operations = [{"file": f"{name}.json", "set": "run.stop", "to": 7} for name in "def"]
    edit = edit_file(path, operations)
    if how == "changed":
        (tmp_path / "f.json").write_text(LOOP + " ")
    else:
        real = edits.write_atomically

        def refuse(file: str, **options: Any) -> Any:
            if Path(file).name == "f.json":
                raise UsageError(Fault("E501", file, "cannot be written."))
            return real(file, **options)

        monkeypatch.setattr(edits, "write_atomically", refuse)
    with pytest.raises(UsageError):
        edit.write()
    assert [(tmp_path / f"{name}.json").read_text() for name in "de"] == [LOOP, LOOP]
    assert (tmp_path / "f.json").read_text() == LOOP + (" " if how == "changed" else "")


# --- what is refused -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("operation", "code", "word"),
    [
        ({"set": "blocks.log.parameters.T", "to": 1}, "E105", 'Did you mean "lag"?'),
        ({"set": "blocks.lag.parameters.T"}, "E009", '"to" is missing'),
        ({"set": "run[", "to": 1}, "E105", "is not a place"),
        ({"set": "", "to": 1}, "E004", "empty"),
        ({"set": "run.stop.x", "to": 1}, "E105", "which cannot hold entries"),
        ({"set": "blocks.lag.doc", "to": True}, "E004", "after the edit"),
        ({"set": "run.log[7]", "to": "r"}, "E105", "3 entries"),
        ({"set": "version", "to": 4}, "E005", "after the edit"),
        ({"set": "run.stop", "to": float("nan")}, "E004", "finite"),
        ({"add": "blocks.lag", "value": {"type": "Gain"}}, "E109", "exists already"),
        ({"add": "blocks.a b", "value": {"type": "Gain"}}, "E105", "is not a place"),
        ({"add": ["blocks", "a b"], "value": {"type": "Gain"}}, "E111", "is not a name"),
        ({"add": "blocks.x", "value": {"tipe": "Gain"}}, "E009", "after the edit"),
        ({"add": "run.log[9]", "value": "r"}, "E105", "entries"),
        ({"remove": "wires.lag.u"}, "E105", 'Write wires["lag.u"].'),
        ({"remove": "format"}, "E009", "after the edit"),
        ({"rename": "blocks.lag", "to": "gain"}, "E109", "is already the name of a block"),
        ({"rename": "blocks.lag", "to": "1"}, "E111", "is not a name"),
        ({"rename": "run.log[0]", "to": "x"}, "E501", "has no name"),
        ({"rename": "measures.itae", "to": "effort"}, "E109", "is already the name of a measure"),
        ({"wire": "lg.y", "to": "gain.k"}, "E105", "Did you mean 'lag'?"),
        ({"wire": "lag.y", "to": "lag"}, "E501", "is a block"),
        ({"wire": "lag.y", "to": "lag.u"}, "E109", "is already driven by"),
        ({"unwire": "lag.v"}, "E105", "Did you mean 'lag.u'?"),
        ({"move": "nothing", "to": [1, 2]}, "E105", "there is no block"),
        ({"move": "lag", "to": [1]}, "E004", "position"),
        ({"group": [], "as": "x"}, "E009", "empty"),
        ({"group": ["lag", "x"], "as": "x"}, "E105", "there is no block"),
        ({"group": ["lag"], "as": "gain"}, "E109", "another block"),
        ({"group": ["lag"], "as": "k"}, "E109", "another parameter"),
        ({"ungroup": "lag"}, "E501", "is not a subdiagram"),
        ({"swap": "lag", "for": {"type": "Constant"}}, "E105", "no counterpart"),
        ({"swap": "lag", "for": {"type": "Nothing"}}, "E103", "Nothing"),
        ({"paste": {"run": {"stop": 1}}}, "E003", "run"),
        ({"sett": "run.stop", "to": 1}, "E004", 'Did you mean "set"?'),
        ({"set": "run.stop", "to": 1, "x": 2}, "E003", "not known here"),
        ({"in": "part", "set": "run.stop", "to": 1}, "E105", "there is no block"),
        ({"in": "lag", "set": "run.stop", "to": 1}, "E105", "is a FirstOrder, not a subdiagram"),
        ({"file": "../other.json", "set": "run.stop", "to": 1}, "E007", "outside"),
        ({"file": "none.json", "set": "run.stop", "to": 1}, "E007", "does not exist"),
        (["set"], "E004", "is not an operation"),
        ({"set": 'x["\\x"]', "to": 1}, "E105", "is not a place"),
        ({"set": 'x["a\nb"]', "to": 1}, "E105", "is not a place"),
        ({"set": ["run", "log", 1e300], "to": "r"}, "E004", "from 0 to 1,000,000"),
        ({"file": "a\0b", "set": "run.stop", "to": 1}, "E007", ""),
        ({"set": "parameters.k.unit", "to": "V"}, "E105", "parameters.k is the number 2.50"),
        ({"set": "blocks[0]", "to": 1}, "E105", "blocks is not a list"),
        ({"remove": "lag"}, "E105", "Did you mean blocks.lag?"),
    ],
)
def test_what_cannot_be_done_is_told(operation: Any, code: str, word: str, tmp_path: Path) -> None:
    fault = refused(tmp_path, LOOP, operation)
    assert fault.code == code
    assert word in str(fault)


def within(*, doc: str = "", **inner: Any) -> str:
    """A diagram with an inline subdiagram."""
    part: dict[str, Any] = {"diagram": {"blocks": {"a": {"type": "Constant"}, "b": {"type": "Gain"}}, **inner}}
    part |= {"doc": doc} if doc else {}
    return json.dumps({"format": "blocks-diagram", "version": 3, "blocks": {"p": part}})


@pytest.mark.parametrize(
    ("operation", "section", "entry"),
    [
        ({"wire": "a.y", "to": "b.u"}, "wires", {"b.u": "a.y"}),
        ({"move": "a", "to": [1, 2]}, "layout", {"a": [1, 2]}),
        ({"set": "outputs.y", "to": "b.y"}, "outputs", {"y": "b.y"}),
        ({"add": "parameters.k", "value": 1}, "parameters", {"k": 1}),
        ({"paste": {"wires": {"b.u": "a.y"}}}, "wires", {"b.u": "a.y"}),
    ],
)
def test_sections_are_made_in_a_subdiagram_too(operation: Any, section: str, entry: Any, tmp_path: Path) -> None:
    new = json.loads(edited(tmp_path, within(), {"in": "p"} | operation))
    assert new["blocks"]["p"]["diagram"][section] == entry


@pytest.mark.parametrize("lost", [{"doc": "block"}, {"measures": {"m": {"type": "ISU", "of": "b.y"}}}, {"x-own": 1}])
def test_what_ungrouping_would_lose_is_told(lost: Any, tmp_path: Path) -> None:
    fault = refused(tmp_path, within(**lost), {"ungroup": "p"})
    assert (fault.code, fault.line) == ("E501", 1)
    assert f'"{next(iter(lost))}", which would be lost' in fault.message


@pytest.mark.parametrize(
    "wrong",
    [
        {"wires": {"a.u": 5}}, {"wires": {"a.u": {}}}, {"layout": {"a": 5}}, {"layout": {"a": ["x", 1]}},
        {"blocks": {"a": 5}},
    ],
)
@pytest.mark.parametrize(
    "operation", [{"group": ["a"], "as": "q"}, {"ungroup": "p"}, {"swap": "a", "for": {"type": "Step"}}]
)
def test_what_moves_blocks_needs_a_file_in_order(wrong: Any, operation: Any, tmp_path: Path) -> None:
    value = {"format": "blocks-diagram", "version": 3, "blocks": {"a": {"type": "Gain"}, "p": {"diagram": {}}}, **wrong}
    assert refused(tmp_path, json.dumps(value), operation).code.startswith("E0")


@pytest.mark.parametrize("name", ["blocks", "diagram", "variants"])
def test_a_subdiagram_may_be_called_as_the_words_of_the_file(name: str, tmp_path: Path) -> None:
    noise = {"type": "Noise", "parameters": {"period": 0.1}}
    inner = {"blocks": {"n": noise, "g": {"type": "Gain"}}, "wires": {"g.u": "n.y"}}
    text = json.dumps(
        {"format": "blocks-diagram", "version": 3, "blocks": {name: {"diagram": inner}},
         "run": {"stop": 1, "log": [f"{name}.g.y"]}}
    )  # fmt: skip
    new = edited(tmp_path, text, {"in": name, "group": ["n"], "as": "q"}, {"in": name, "rename": "blocks.g", "to": "h"})
    np.testing.assert_array_equal(*(results_of(each)[0][0] for each in (text, new)))
    assert '"variant": "Step"' in edited(tmp_path, text, {"in": name, "swap": "n", "for": {"type": "Step"}})


def test_random_numbers_stay_where_streams_are_named_and_where_files_are_used(tmp_path: Path) -> None:
    noise = {"type": "Noise", "parameters": {"period": 0.1}}
    value = {
        "format": "blocks-diagram", "version": 3, "blocks": {"n": {**noise, "stream": "x"}, "h": {"type": "Gain"}},
        "outputs": {"y": "n.y"}, "run": {"stop": 1, "log": ["n.y"]},
    }  # fmt: skip
    text = json.dumps(value)
    group = {"group": ["n"], "as": "p"}
    new = edited(tmp_path, text, group)  # h has no wire yet: it cannot run, and nothing can be compared
    wire = {"add": "wires", "value": {"h.u": "n.y"}}, {"wire": "p.y", "to": "h.u"}
    runs = [results_of(edited(tmp_path, each, one))[0][0] for each, one in zip((text, new), wire, strict=True)]
    np.testing.assert_array_equal(*runs)
    again = {"group": ["m"], "as": "p"}
    assert '"/x"' in edited(tmp_path, text, {"rename": "blocks.n", "to": "m"}, again, {"ungroup": "p"}, again)
    project(tmp_path, d=text, top={**value, "blocks": {"p": {"diagram": "d.json"}}, "outputs": {}, "run": {}})
    with pytest.raises(UsageError, match="which would change in the diagrams that use"):
        edit_file(tmp_path / "top.json", [{"in": "p", **group}])


def test_pasted_ports_and_measures_get_free_names_too(tmp_path: Path) -> None:
    given = {
        "inputs": {"r": {"default": 2}, "gain": {}}, "blocks": {"g": {"type": "Gain"}},
        "wires": {"g.u": "r", "g.k": "gain"}, "outputs": {"y": "g.y"},
        "measures": {"itae": {"type": "ISE", "of": "g.y"}}, "layout": {"r": [0, 0], "g": [1, 1]},
    }  # fmt: skip
    new = json.loads(edited(tmp_path, LOOP, {"paste": given, "by": [5, 5]}))
    assert list(new["inputs"]) == ["r", "r_2", "gain_2"]
    assert list(new["outputs"]) == ["y", "u", "y_2"]
    assert new["measures"]["itae_2"] == {"type": "ISE", "of": "g.y"}
    assert (new["wires"]["g.u"], new["wires"]["g.k"]) == ("r_2", "gain_2")
    assert new["layout"]["g"] == [6, 6]
    assert '"g": [6, 6]' in json.dumps(new)


def test_a_text_with_escapes_takes_no_time(tmp_path: Path) -> None:
    text = LOOP.replace('"name": "loop",', '"name": "loop",\n "doc": ' + json.dumps("ab" * 20_000 + "\n") + ",")
    before = time.process_time()
    edited(tmp_path, text, {"set": "doc", "to": "ba" * 20_000 + "\n"}, {"set": "doc", "to": "b" * 40_000 + "\n"})
    assert time.process_time() - before < 30


def test_studies_of_another_version_and_blocks_of_studies_are_refused(tmp_path: Path) -> None:
    assert refused(tmp_path, json.dumps({**STUDY, "version": 9}), {"set": "title", "to": "x"}).code == "E005"
    for operation in ({"move": "a", "to": [1, 2]}, {"wire": "a.y", "to": "b.u"}, {"in": "a", "set": "x", "to": 1}):
        assert "is a study" in refused(tmp_path, json.dumps(STUDY), operation).message


def test_what_is_no_list_is_told(tmp_path: Path) -> None:
    path = project(tmp_path, d=LOOP)
    for wrong in (None, 5, "[]", {"set": "run.stop", "to": 1}):
        with pytest.raises(UsageError, match="must be a list of operations"):
            edit_file(path, wrong)  # type: ignore[arg-type]
    broken = LOOP.replace('["lag", "gain.y", "error.y"]', "5")
    assert refused(tmp_path, broken, {"add": "run.log", "value": "r"}).code == "E109"


def test_a_later_operation_that_is_refused_says_which_and_nothing_is_done(tmp_path: Path) -> None:
    fault = refused(tmp_path, LOOP, {"set": "run.stop", "to": 1}, {"unwire": "x"})
    assert "operation 2 (unwire): " in fault.message


def test_faults_that_were_there_do_not_hinder_an_edit(tmp_path: Path) -> None:
    broken = LOOP.replace('"stop": 2', '"stpo": 2')
    assert edited(tmp_path, broken, {"move": "lag", "to": [1, 2]}) == broken.replace("[240, 41]", "[1, 2]")
    assert edited(tmp_path, broken, {"remove": "run.stpo"}) == broken.replace('"stpo": 2, ', "")


# --- any list of edits -----------------------------------------------------------------------------------------


def model_edit(value: Any, operation: dict[str, Any]) -> None:
    """The same on plain dicts, in place, told by the words of the operation alone."""
    name = next(iter(operation))
    if name in ("wire", "unwire", "move"):
        section, key = ("layout", operation["move"]) if name == "move" else ("wires", operation.get("to", ""))
        if name == "unwire":
            del value["wires"][operation["unwire"]]
            if not value["wires"]:
                del value["wires"]
        else:
            value.setdefault(section, {})[key] = operation["to"] if name == "move" else operation["wire"]
        return
    *around, last = operation[name]
    for step in around:
        value = value.setdefault(step, {}) if isinstance(value, dict) else value[step]
    if name == "remove":
        del value[last]
    else:
        value[last] = copy.deepcopy(operation["value" if name == "add" else "to"])


def any_operation(value: Any, chance: random.Random) -> dict[str, Any]:
    blocks, number = list(value["blocks"]), chance.choice([1, 2.5, -3, 1e-7])
    text = json.dumps(value)
    name = next(f"new_{k}" for k in itertools.count() if f"new_{k}" not in text)
    wires = list(value.get("wires", {}))
    choices: list[dict[str, Any]] = [
        {"add": ["blocks", name], "value": {"type": "Gain", "parameters": {"k": number}}},
        {"set": ["blocks", chance.choice(blocks), "doc"], "to": chance.choice(["", "a \"text\"", ["é", "\\"]])},
        {"set": ["run", "stop"], "to": number},
        {"add": ["parameters", name], "value": {"value": number, "unit": "V"}},
        {"add": ["measures", name], "value": {"type": "ISE", "of": f"{chance.choice(blocks)}.y"}},
        {"move": chance.choice(blocks), "to": [chance.randrange(500), number]},
        {"wire": f"{chance.choice(blocks)}.y", "to": f"{chance.choice(blocks)}.{name}"},
        {"set": ["x-own"], "to": {"a": [number, None, {"b": True}]}},
    ]
    if wires:
        choices.append({"unwire": chance.choice(wires)})
        choices.append({"set": ["wires", chance.choice(wires)], "to": f"{chance.choice(blocks)}.y"})
    return chance.choice(choices)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(DIAGRAMS), st.randoms(use_true_random=False), st.booleans())
def test_any_list_of_edits_does_what_it_says_and_is_undone_to_the_same_bytes(
    path: Path, chance: random.Random, is_canonical: bool
) -> None:
    text = path.read_text()
    value = json.loads(text)
    if not is_canonical:
        layout = {"indent": chance.choice([None, 0, 2, 4, "\t"]), "ensure_ascii": chance.random() < 0.5}
        text = json.dumps(value, separators=chance.choice([(",", ":"), (" , ", " : ")]), **layout)
        text = text.replace("\n", chance.choice(["\n", "\r\n"]))
    operations = []
    expected = copy.deepcopy(value)
    for _ in range(chance.randrange(1, 6)):
        operation = any_operation(expected, chance)
        model_edit(expected, operation)
        operations.append(operation)
    edit = edit_file(path, operations, text=text)
    new = edit.texts.get(str(path), text)
    assert json.loads(new) == expected
    undone = edit.undone
    assert undone.texts.get(str(path), text) == text
    if is_canonical and not any(operation.get("to") in ("", []) for operation in operations):
        assert documents.canonical(read(new)) == new
        assert list(json.loads(new)) == list(documents.DIAGRAM.ordered(json.loads(new)))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(DIAGRAMS), st.randoms(use_true_random=False))
def test_after_removing_any_entries_nothing_names_them(path: Path, chance: random.Random) -> None:
    value = json.loads(path.read_text())
    sections = [key for key in ("blocks", "inputs", "outputs", "parameters", "measures", "wires") if value.get(key)]
    section = chance.choice(sections)
    name = chance.choice(list(value[section]))
    try:
        text = edit_file(path, [{"remove": [section, name]}]).texts[str(path)]
    except UsageError as error:
        if section == "parameters" and "which cannot hold its value" in str(error):  # as b0 in "=1/b0"
            return
        raise
    assert documents.canonical(read(text)) == text
    new = json.loads(text)
    assert name not in new.get(section, {})
    if section == "blocks":
        for other in ("wires", "outputs"):
            table = new.get(other, {})
            assert not [entry for entry in (*table, *table.values()) if entry.split(".")[0].split("[")[0] == name and (
                other == "wires" or entry in table.values()
            )]


# --- the command -----------------------------------------------------------------------------------------------


def test_the_command_writes_tells_and_reads_stdin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    project(tmp_path, d=LOOP, ops=[{"set": "run.stop", "to": 7}, {"unwire": "lag.u"}])
    assert main(["apply", "d.json", "ops.json", "--dry-run"]) == 0
    assert "d.json would be edited, by 2 operations" in capsys.readouterr().out
    assert (tmp_path / "d.json").read_text() == LOOP
    assert main(["apply", "d.json", "ops.json"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out == [
        'd.json:25:3: - "lag.u": "gain.y"', "d.json:27:18: 2 -> 7", "d.json is edited, by 2 operations",
    ]  # fmt: skip
    assert '"stop": 7' in (tmp_path / "d.json").read_text()
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b'[{"set": "run.stop", "to": 7}]')))
    assert main(["apply", "d.json", "-", "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert done == {
        "event": "done", "operations": 1, "files": [], "written": True, "note": "",
    }  # fmt: skip
    assert main(["apply", "d.json", "none.json"]) == 2


def test_every_operation_has_a_text_in_the_docs() -> None:
    text = (ROOT / "docs" / "diagram_file.md").read_text()
    for name, operation in OPERATIONS.items():
        row = next(line for line in text.splitlines() if line.startswith(f'| `{{"{name}":'))
        assert operation.kind.doc in row
        for field in (field for field in operation.kind.fields if field.required):
            assert f'"{field.key}":' in row


def test_a_file_beyond_the_limit_of_texts_is_edited_like_a_small_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vector gives copies to what it reaches, a fault is told as it is, a block gets a variant, a name changes."""
    path, study = tmp_path / "d.json", tmp_path / "s.json"
    blocks = {
        "pair": {"type": "Constant", "copies": 2, "parameters": {"value": 1}}, "gain": {"type": "Gain"},
        "part": {"diagram": "part.json"},
    }  # fmt: skip
    document = {"format": "blocks-diagram", "version": 3, "name": "d", "parameters": {"K": 2}, "blocks": blocks}
    path.write_text(json.dumps({**document, "doc": "x" * 400}))
    (tmp_path / "part.json").write_text(json.dumps({**document, "name": "part", "blocks": {}, "doc": "y" * 400}))
    asked = {"format": "blocks-study", "version": 1, "name": "s", "runs": {"d": {"diagram": "d.json"}}}
    study.write_text(json.dumps({**asked, "doc": "z" * 600}))
    every: list[list[dict[str, Any]]] = [
        [{"wire": "pair.y", "to": "gain.u"}],
        [{"set": "blocks.gain.parameters.k", "to": "=nope"}, {"set": "parameters.K", "in": "part", "to": 3}],
        [{"swap": "gain", "for": {"type": "Saturation"}}],
        [{"rename": "parameters.K", "to": "K2"}],
    ]

    def told() -> list[Any]:
        made = [edit_file(path, operations) for operations in every]
        faults = flat_of(path.read_text(), str(path), ())
        return [[(edit.texts, edit.faults) for edit in made], faults, load(study).runs]

    wanted = told()
    assert '"copies": 2' in str(wanted[0][0][0]).partition('"gain"')[2]
    assert [fault.code for fault in wanted[0][1][1]] == ["E108"]
    monkeypatch.setattr(json_document, "LARGEST_TEXT", 300)
    assert told() == wanted
