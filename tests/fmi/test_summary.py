"""What `blocks fmu` tells of FMUs, against FMPy's reading of them."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import pytest
from fmpy import read_model_description

from blocks import cli
from blocks.fmi.summary import tell
from tests.support.places import ROOT

FMUS = sorted((ROOT / "fmus").glob("*.fmu"))


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.name)
def test_it_tells_what_fmpy_reads(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fmu", "info", str(path), "--json"]) == 0
    told, known = json.loads(capsys.readouterr().out), read_model_description(str(path))
    assert told["name"] == known.modelName
    assert told["fmi"] == known.fmiVersion
    assert set(told["kinds"]) == {"ME", "CS"}
    assert [v["name"] for v in told["variables"]] == [v.name for v in known.modelVariables]
    assert [v["unit"] for v in told["variables"]] == [v.unit or "" for v in known.modelVariables]
    assert told["states"] == known.numberOfContinuousStates
    assert cli.main(["fmu", "info", str(path), "--all"]) == 0
    text = capsys.readouterr().out
    shown = {line.split()[0].partition("[")[0] for line in text.splitlines() if line.startswith("  ") and line.split()}
    assert {v.name for v in known.modelVariables if v.causality in ("input", "output", "parameter")} <= shown


def test_members_of_enumerations_locals_and_other_names_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What an input may be set to and what can be recorded cannot be guessed."""
    path = tmp_path / "x.fmu"
    text = """<fmiModelDescription fmiVersion="3.0" modelName="x" instantiationToken="{x}">
      <CoSimulation modelIdentifier="x" fixedInternalStepSize="0.1"/>
      <TypeDefinitions><EnumerationType name="Gear"><Item name="Low speed" value="1"/><Item name="High" value="4"/>
      </EnumerationType></TypeDefinitions>
      <ModelVariables>
        <Enumeration name="gear" valueReference="1" causality="input" declaredType="Gear" start="4"/>
        <Float64 name="h" valueReference="2" causality="output"><Alias name="height"/></Float64>
        <Float64 name="inside" valueReference="3"/>
      </ModelVariables><ModelStructure><Output valueReference="2"/></ModelStructure></fmiModelDescription>"""
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("modelDescription.xml", text)
    known = read_model_description(str(path), validate=False)
    (gear,) = (one for one in known.typeDefinitions if one.name == "Gear")
    assert cli.main(["fmu", "info", str(path)]) == 0
    told = capsys.readouterr().out
    assert "  Gear  " + ", ".join(f"{item.name} ({item.value})" for item in gear.items) in told.splitlines()
    assert re.search(r"^  gear +Gear +4$", told, re.MULTILINE)
    assert re.search(r"^  height +another name of h$", told, re.MULTILINE)
    assert "internal step 0.1" in told
    assert "inside" not in told
    assert cli.main(["fmu", "info", str(path), "--all"]) == 0
    assert "locals:\n  inside" in capsys.readouterr().out
    assert cli.main(["fmu", "info", str(path), "--json"]) == 0
    entry = json.loads(capsys.readouterr().out)
    assert entry["enumerations"] == {"Gear": {"Low speed": 1, "High": 4}}
    assert [(v["enumeration"], v["aliases"]) for v in entry["variables"]] == [("Gear", []), ("", ["height"]), ("", [])]


def test_an_fmu_for_other_machines_only_is_told_and_exits_with_4(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(FMUS[0]) as source, zipfile.ZipFile(path, "w") as made:
        for name in source.namelist():
            made.writestr(name.replace("x86_64-linux", "riscv64-plan9").replace("linux64", "plan9"), source.read(name))
    assert cli.main(["fmu", "check", str(path)]) == 4
    text = capsys.readouterr().out
    assert "E201" in text
    assert "riscv64-plan9" in text
    assert [fault.code for fault in tell(path).errors] == ["E201"]


def test_what_is_no_fmu_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.fmu"
    path.write_text("nothing", encoding="utf-8")
    assert cli.main(["fmu", "info", str(path)]) == 4
    assert "E202 x.fmu: this is not a zip archive" in capsys.readouterr().err
    assert cli.main(["fmu", "info", str(tmp_path / "none.fmu")]) == 2
    assert "E007" in capsys.readouterr().err


def test_an_fmu_that_says_that_it_needs_a_program_is_counted_among_the_warnings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(FMUS[0]) as source, zipfile.ZipFile(path, "w") as made:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                data = data.replace(b"modelIdentifier=", b'needsExecutionTool="true" modelIdentifier=')
            made.writestr(name, data)
    assert cli.main(["fmu", "check", str(path)]) == 0
    text = capsys.readouterr().out
    assert (
        text.count(
            "W202 x.fmu: it declares that it needs an external program to run, usually the tool that exported it"
        )
        == 2
    )  # once for each kind
    assert text.endswith("0 errors, 1 warning; nothing was loaded\n")


@pytest.mark.parametrize("others", ["", '<CoSimulation modelIdentifier="m"/>'])
def test_scheduled_execution_alone_is_told_as_nothing_that_runs(
    others: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr(
            "modelDescription.xml",
            f'<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="1">{others}'
            '<ScheduledExecution modelIdentifier="m"/><ModelVariables/><ModelStructure/></fmiModelDescription>',
        )
    assert cli.main(["fmu", "check", str(path)]) == 4
    text = capsys.readouterr().out
    if others:  # what counts is why that does not run
        assert "Scheduled" not in text
        assert "E201" in text
    else:
        assert "x.fmu: Scheduled Execution: cannot run here" in text
        assert "E205 x.fmu: it is for Scheduled Execution only, which blocks does not support. Export it for" in text
        assert text.endswith("1 error, 0 warnings; nothing was loaded\n")
        assert tell(path).entry()["runs"] == {"SE": False}


def test_a_license_is_shown_by_its_first_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.fmu"
    for license, shown in (
        ("MIT", "license MIT"),
        ("Granted to all&#10;provided that", "license Granted to all"),
        ("word " * 300, "license " + "word " * 15 + "..."),
    ):
        text = f"""<fmiModelDescription fmiVersion="3.0" modelName="x" instantiationToken="{{x}}" license="{license}">
          <CoSimulation modelIdentifier="x"/><ModelVariables/><ModelStructure/></fmiModelDescription>"""
        with zipfile.ZipFile(path, "w") as made:
            made.writestr("modelDescription.xml", text)
        assert cli.main(["fmu", "info", str(path)]) == 0
        assert f"  {shown}\n" in capsys.readouterr().out
