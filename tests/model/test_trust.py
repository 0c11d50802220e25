"""FMUs of a diagram before it runs: whom they are trusted by, and what `blocks check` tells of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from blocks import Diagram, FMUError, Gain, ModelError, UsageError, fmu
from blocks.cli import main
from blocks.fmi import library, loading
from blocks.model.trust import check_trust, found, to_be_refused
from tests.support.places import ROOT

MOTOR = ROOT / "fmus" / "PMDCMotor.fmu"


@pytest.fixture(autouse=True)
def no_binary_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in this file runs an FMU: neither here nor in a process that tries it."""

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("a binary is loaded")

    # `loading` has a name of its own for it, which would stay the refusal were it imported within a test.
    for module, name in ((library, "load"), (library, "_probe"), (loading, "load")):
        monkeypatch.setattr(module, name, refuse)


def project(tmp_path: Path, name: str = "project", *, mark: str = "pyproject.toml") -> Path:
    folder = tmp_path / name
    (folder / "diagrams").mkdir(parents=True)
    (folder / "fmus").mkdir()
    if mark:
        (folder / mark).mkdir() if mark == ".git" else (folder / mark).touch()
    shutil.copy(MOTOR, folder / "fmus" / "m.fmu")
    return folder


def write(path: Path, fmu_path: str, **options: Any) -> Path:
    source = {
        "format": "blocks-diagram",
        "version": 3,
        "name": path.stem,
        "inputs": {"v": {"unit": "V", "default": 6}},
        "outputs": {"omega": "motor.omega"},
        "blocks": {"motor": {"fmu": fmu_path, "kind": "CS", **options}},
        "wires": {"motor.v": "v"},
        "run": {"stop": 1},
    }
    path.write_text(json.dumps(source))
    return path


def refused(diagram: Diagram, **given: Any) -> str:
    with pytest.raises(FMUError) as caught:
        diagram.run(**given)
    assert {fault.code for fault in caught.value.faults} == {"E218"}
    assert caught.value.exit_status == 4
    return str(caught.value)


# --- trust -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mark", ["pyproject.toml", ".git"])
def test_an_fmu_of_the_project_is_trusted(tmp_path: Path, mark: str) -> None:
    folder = project(tmp_path, mark=mark)
    check_trust(Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu")).value)


def test_an_fmu_outside_the_project_runs_only_where_it_is_trusted(tmp_path: Path) -> None:
    here, there = project(tmp_path), project(tmp_path, "other")
    diagram = Diagram.load(write(here / "diagrams" / "d.json", "../../other/fmus/m.fmu"))
    text = refused(diagram)
    assert '"../../other/fmus/m.fmu" lies outside the project' in text
    assert f"--trust {there / 'fmus' / 'm.fmu'}, or trust= in Python" in text
    assert f"{here / 'diagrams' / 'd.json'}:1:" in text
    for trust in (there, there / "fmus", there / "fmus" / "m.fmu", str(there), [here, there / "fmus"]):
        check_trust(diagram.value, trust)
    refused(diagram, trust=here / "fmus")
    refused(diagram, trust=(there / "diagrams",))
    refused(diagram, trust=[])
    with pytest.raises(UsageError, match="does not exist"):
        diagram.run(trust=there / "fmu")
    with pytest.raises(UsageError, match="is not a path"):
        diagram.run(trust=[5])


def test_a_name_that_begins_like_the_project_is_not_in_it(tmp_path: Path) -> None:
    here = project(tmp_path)
    project(tmp_path, "project_2")
    refused(Diagram.load(write(here / "diagrams" / "d.json", "../../project_2/fmus/m.fmu")))


def test_without_a_project_the_file_s_own_folder_counts(tmp_path: Path) -> None:
    folder = project(tmp_path, mark="")
    refused(Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu")))
    check_trust(Diagram.load(write(folder / "d.json", "fmus/m.fmu")).value)


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_a_link_leads_where_it_leads(tmp_path: Path) -> None:
    here, there = project(tmp_path), project(tmp_path, "other")
    (here / "fmus" / "link.fmu").symlink_to(there / "fmus" / "m.fmu")
    (here / "more").symlink_to(there / "fmus")
    (tmp_path / "into").symlink_to(here)
    for path in ("../fmus/link.fmu", "../more/m.fmu"):
        refused(Diagram.load(write(here / "diagrams" / "d.json", path)))
        check_trust(Diagram.load(here / "diagrams" / "d.json").value, there)
    # A diagram that is reached through a link belongs to the project that it leads to, and so do its FMUs.
    write(here / "diagrams" / "d.json", "../fmus/m.fmu")
    check_trust(Diagram.load(tmp_path / "into" / "diagrams" / "d.json").value)
    write(here / "diagrams" / "d.json", str(tmp_path / "into" / "fmus" / "m.fmu"))
    check_trust(Diagram.load(here / "diagrams" / "d.json").value)


def test_neither_home_nor_what_is_above_it_is_a_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, home = project(tmp_path, mark=""), tmp_path
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    (home / ".git").mkdir()
    shutil.copy(MOTOR, home / "m.fmu")
    text = refused(Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu")))
    assert f"outside the project {folder / 'diagrams'} ({home} is not a project, because it is the home folder)" in text
    for name in ("m.fmu", "project/fmus/m.fmu"):
        diagram = Diagram.load(write(home / "d.json", name))
        assert f"lies in no project ({home} is not a project, because it is the home folder)" in refused(diagram)
        check_trust(diagram.value, home)


@pytest.mark.skipif(os.name == "nt", reason="rights stand in lists there")
@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o702])
def test_a_folder_that_others_may_write_to_is_no_project(tmp_path: Path, mode: int) -> None:
    folder = project(tmp_path)
    diagram = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu"))
    check_trust(diagram.value)
    folder.chmod(mode)
    text = refused(diagram)
    assert (
        f"outside the project {folder / 'diagrams'} ({folder} is not a project, because it is writable by other users)"
    ) in text
    check_trust(diagram.value, folder)
    (folder / "diagrams").chmod(mode)
    assert "lies in no project" in refused(diagram)


@pytest.mark.skipif(os.name == "nt", reason="rights stand in lists there")
def test_an_fmu_in_a_folder_of_the_project_that_others_may_write_to_is_not_trusted(tmp_path: Path) -> None:
    folder = project(tmp_path)
    diagram = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu"))
    (folder / "diagrams").chmod(0o777)
    check_trust(diagram.value)  # it is the FMU whose code runs
    (folder / "fmus").chmod(0o777)
    text = refused(diagram)
    assert f"lies in {folder / 'fmus'}, which is writable by other users, and running it runs its code" in text
    check_trust(diagram.value, folder / "fmus" / "m.fmu")
    (folder / "fmus" / "m").mkdir()
    shutil.move(folder / "fmus" / "m.fmu", folder / "fmus" / "m" / "m.fmu")
    refused(Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m/m.fmu")))


@pytest.mark.skipif(os.name == "nt", reason="rights stand in lists there")
def test_a_folder_of_a_group_is_a_project_where_the_group_is_its_owner_s_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = project(tmp_path)
    diagram = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu"))
    folder.chmod(0o770)
    for name, members, is_own in (("me", [], True), ("me", ["me"], True), ("me", ["you"], False), ("us", [], False)):
        monkeypatch.setattr("pwd.getpwuid", lambda _: SimpleNamespace(pw_name="me"))
        monkeypatch.setattr("grp.getgrgid", lambda _, n=name, m=members: SimpleNamespace(gr_name=n, gr_mem=m))
        if is_own:
            check_trust(diagram.value)
        else:
            refused(diagram)


def test_run_names_the_fmus_of_a_folder_the_first_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BLOCKS_CACHE_DIR", str(tmp_path / "cache"))
    folder = project(tmp_path)
    shutil.copy(MOTOR, folder / "fmus" / "n.fmu")
    path = write(folder / "diagrams" / "d.json", "../fmus/m.fmu")
    path.write_text(path.read_text().replace('"blocks": {', '"blocks": {"n": {"fmu": "../fmus/n.fmu", "kind": "CS"}, '))

    def said() -> list[str]:
        main(["run", str(path)])
        return [line for line in capsys.readouterr().err.splitlines() if "first time" in line]

    assert said() == [f"loading FMUs from a folder for the first time: n.fmu, m.fmu of {folder / 'fmus'}"]
    assert said() == []
    assert main(["doctor", "--clear-cache"]) == 0
    assert len(said()) == 1


def test_whoever_hands_over_an_fmu_in_python_has_named_it(tmp_path: Path) -> None:
    there = project(tmp_path, "other")
    diagram = Diagram("d", folder=project(tmp_path))
    diagram.add("motor", fmu(there / "fmus" / "m.fmu", kind="CS"))
    check_trust(diagram.value)
    diagram.save(tmp_path / "project" / "diagrams" / "d.json")
    loaded = Diagram.load(tmp_path / "project" / "diagrams" / "d.json")
    refused(loaded, inputs={})
    loaded.swap("motor", fmu(there / "fmus" / "m.fmu", kind="CS"))
    check_trust(loaded.with_variants({}).value)
    refused(loaded, variants={"motor": "base"})


def test_fmus_of_variants_and_subdiagrams_count_where_they_are_taken(tmp_path: Path) -> None:
    here = project(tmp_path)
    project(tmp_path, "other")
    outside = {"fmu": "../../other/fmus/m.fmu", "kind": "CS"}
    inner = Diagram.load(write(here / "diagrams" / "inner.json", "../fmus/m.fmu", variants={"other": outside}))
    check_trust(inner.with_variants({}).value)
    text = refused(inner, variants={"motor": "other"})
    assert "E218" in text
    outer = {
        "format": "blocks-diagram",
        "version": 3,
        "blocks": {"a": {"diagram": "inner.json"}, "b": {"diagram": "inner.json"}},
        "run": {"stop": 1},
    }
    diagram = Diagram.from_json(outer, folder=here / "diagrams")
    check_trust(diagram.with_variants({}).value)
    with pytest.raises(FMUError) as caught:
        diagram.run(variants={"b.motor": "other"})
    assert [fault.place for fault in caught.value.faults] == ["b.motor"]


def test_a_run_that_is_not_trusted_ends_with_4_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    here = project(tmp_path)
    there = project(tmp_path, "other")
    path = write(here / "diagrams" / "d.json", "../../other/fmus/m.fmu")
    assert main(["run", str(path)]) == 4
    assert "E218 " in capsys.readouterr().err
    assert main(["run", str(path), "--trust", str(there / "nothing")]) == 2
    for command in (["check", str(path)], ["draw", str(path), "-o", str(tmp_path / "d.svg")]):
        assert main(command) == 0, "nothing of it runs"


# --- what check tells ------------------------------------------------------------------------------------------


def changed(path: Path, change: Callable[[str], str], drop: str = "") -> None:
    """An FMU with another description, and without the files that begin with `drop`."""
    with zipfile.ZipFile(path) as old:
        files = {name: old.read(name) for name in old.namelist() if not (drop and name.startswith(drop))}
    files["modelDescription.xml"] = change(files["modelDescription.xml"].decode()).encode()
    with zipfile.ZipFile(path, "w") as new:
        for name, data in files.items():
            new.writestr(name, data)


def in_millivolts(text: str) -> str:
    unit = '<Unit name="mV"><BaseUnit kg="1" m="2" s="-3" A="-1" factor="0.001"/></Unit>'
    text = text.replace("<UnitDefinitions>", f"<UnitDefinitions>{unit}")
    made = re.sub(r'(name="v" [^>]*unit=")V"', r'\1mV"', text)
    assert made != text
    return made


def test_check_tells_kind_platform_and_scaling(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = project(tmp_path)
    changed(folder / "fmus" / "m.fmu", in_millivolts)
    path = write(folder / "diagrams" / "d.json", "../fmus/m.fmu", isolate=True, timeout=5)
    assert main(["check", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "d: 1 block (1 FMU)",
        "  motor: m.fmu, FMI 3.0, Co-Simulation, should run here, in a process of its own (timeout 5 s)",
        "    v is in mV in the FMU, in V here: scaled by 0.001",
    ]
    assert lines[-1] == "0 errors, 0 warnings"
    assert main(["check", str(path), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == {
        "event": "fmu",
        "block": "motor",
        "fmu": str(folder / "diagrams" / ".." / "fmus" / "m.fmu").replace("diagrams/../", ""),
        "fmi": "3.0",
        "kind": "CS",
        "isolate": True,
        "runs": True,
        "scaled": [{"port": "v", "unit": "mV", "si": "V", "scale": 0.001}],
    }


def test_check_tells_that_an_fmu_is_for_other_machines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = project(tmp_path)
    changed(folder / "fmus" / "m.fmu", lambda text: text, drop="binaries/")
    path = write(folder / "diagrams" / "d.json", "../fmus/m.fmu")
    assert main(["check", str(path)]) == 4
    out = capsys.readouterr().out
    assert "motor: m.fmu, FMI 3.0, Co-Simulation, cannot run here" in out
    assert "E201 motor: m.fmu: it holds no binaries" in out
    assert "It contains sources. Run: blocks fmu compile m.fmu" in out
    assert out.endswith("1 error, 0 warnings\n")
    assert found(Diagram.load(path).flatten())[0].faults[0].code == "E201"


def test_wiring_faults_around_an_fmu_are_told_as_any_other(tmp_path: Path) -> None:
    folder = project(tmp_path)
    diagram = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu", parameters={"Rb": 1}))
    diagram.add("gain", Gain(k=1.0, unit="A", unit_u="V"))
    diagram.wire("gain.u", "motor.omega")
    with pytest.raises(ModelError) as caught:
        diagram.check()
    assert {(fault.code, fault.place) for fault in caught.value.faults} == {
        ("E106", "motor.Rb"),
        ("E104", "gain.u [V] <- motor.omega [rad/s]"),
    }
    missing = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/n.fmu"))
    with pytest.raises(ModelError) as caught:
        missing.check()
    assert [(fault.code, fault.place) for fault in caught.value.faults] == [("E007", "motor")]


def test_an_fmu_is_listed_as_a_block_type_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", str(MOTOR)]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^  omega +rad/s +speed of the wheel$", out, re.MULTILINE)
    assert re.search(r"^  Ra +Ohm +0\.1557", out, re.MULTILINE)
    assert main(["list", str(MOTOR), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["outputs"][0]["name"] == "omega"


def test_an_fmu_is_drawn_with_its_ports(tmp_path: Path) -> None:
    folder = project(tmp_path)
    drawn = Diagram.load(write(folder / "diagrams" / "d.json", "../fmus/m.fmu")).draw()
    for text in (">m<", ">omega<", ">tau<"):
        assert text in drawn
    assert "E118" not in drawn


# --- an FMU by itself ------------------------------------------------------------------------------------------


def test_an_fmu_alone_is_a_diagram_with_its_ports(tmp_path: Path) -> None:
    path = tmp_path / "m.fmu"
    shutil.copy(MOTOR, path)

    def renamed(text: str) -> str:
        text = text.replace('modelName="PMDCMotor"', 'modelName="Drives.Motor 2"').replace(
            'name="tau"', 'name="load.tau"'
        )
        return re.sub(r'(name="v" [^>]*start=")0[^"]*"', r'\g<1>250"', in_millivolts(text))

    changed(path, renamed)
    diagram = Diagram.alone(fmu(path, kind="CS"))
    value = diagram.value
    assert (value.name, list(value.blocks)) == ("Drives_Motor_2", ["Drives_Motor_2"])
    assert {name: (entry.get("unit"), float(entry["default"])) for name, entry in value.inputs.items()} == {
        "v": ("mV", 250.0),
        "load_tau": ("N.m", 0.0),
    }
    assert dict(value.wires) == {"Drives_Motor_2.v": "v", "Drives_Motor_2.load.tau": "load_tau"}
    assert dict(value.outputs) == {"omega": "Drives_Motor_2.omega", "i": "Drives_Motor_2.i"}
    flat = diagram.flatten()
    assert [one.default for one in flat.inputs] == [(0.25,), (0.0,)]
    assert Diagram.from_json(diagram.dumps(), folder=value.folder).flatten().outputs == ("omega", "i")


def test_blocks_fmu_run_runs_that_diagram_as_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Any, Diagram]] = []
    kept = "blocks.cli.fmu.run_diagram"
    monkeypatch.setattr(kept, lambda options, made, **_: seen.append((options, made())) or 0)
    words = ["--kind", "cs", "--isolate", "--stop", "2", "--set", "Ra=0.2", "--set", "PMDCMotor.La=1", "--input", "v=6"]
    assert main(["fmu", "run", str(MOTOR), *words, "-o", "x.csv", "--master", "step=0.01"]) == 0
    options, diagram = seen[0]
    assert options.parameters == ["PMDCMotor.Ra=0.2", "PMDCMotor.La=1"]
    assert (options.stop, options.input, options.out, options.master) == ("2", ["v=6"], "x.csv", ["step=0.01"])
    entry = diagram.value.blocks["PMDCMotor"]
    assert dict(entry.options) == {"kind": "CS", "isolate": True}
    assert dict(diagram.value.run) == {"start": 0}
    assert main(["fmu", "run", str(ROOT / "fmus" / "IADRC.fmu"), "--kind", "CS"]) == 0
    assert seen[1][1].to_json()["run"] == {"start": 0}  # the step is the default of any diagram
    assert main(["fmu", "run", str(MOTOR), "--kind", "SE"]) == 2


def test_a_variant_is_chosen_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = str(ROOT / "diagrams" / "paper" / "iadrc_fmu.json")
    back = ["--variant", "motor_right=base", "--variant", "motor_left=base"]
    assert main(["check", robot]) == 0
    assert "iadrc_fmu: 18 blocks (2 FMUs)" in capsys.readouterr().out
    assert main(["check", robot, *back]) == 0
    assert "iadrc_fmu: 18 blocks, 22 states" in capsys.readouterr().out
    assert main(["run", robot, *back, "--stop", "0.2", "-o", str(tmp_path / "a.csv")]) == 0
    assert main(["run", robot.replace("_fmu", ""), "--stop", "0.2", "-o", str(tmp_path / "b.csv")]) == 0
    assert main(["compare", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"), "--tolerance", "0"]) == 0
    capsys.readouterr()
    for svg, more in (("a.svg", []), ("b.svg", back)):
        assert main(["draw", robot, "-o", str(tmp_path / svg), *more]) == 0
    assert (tmp_path / "a.svg").read_text() != (tmp_path / "b.svg").read_text()
    for words, code, text in (
        (["--variant", "motor_right"], 2, "is not BLOCK=NAME"),
        (["--variant", "motor_right=base", "--variant", "motor_right=fmu"], 2, "chooses a second variant"),
        (["--variant", "motor_right=fmi"], 2, 'E122 motor_right: there is no variant "fmi". Did you mean "fmu"?'),
        (["--variant", "robot.motor=fmu"], 2, "there is no block with this path"),
    ):
        assert main(["run", robot, *words]) == code
        assert text in capsys.readouterr().err
    assert main(["export", robot, "-o", str(tmp_path / "x.fmu"), "--kind", "ME"]) == 2
    assert "E606 iadrc_fmu: has FMUs for Co-Simulation inside" in capsys.readouterr().err


def test_check_warns_of_what_run_refuses_and_says_how_to_trust_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project, away = tmp_path / "project", tmp_path / "away"
    project.mkdir()
    away.mkdir()
    (project / "pyproject.toml").write_text("")
    for folder in (project, away):
        shutil.copy(MOTOR, folder / MOTOR.name)
    blocks = {"near": {"fmu": MOTOR.name}, "far": {"fmu": f"../away/{MOTOR.name}"}}
    text = {"format": "blocks-diagram", "version": 3, "blocks": blocks, "run": {"stop": 0.01, "log": ["far.omega"]}}
    for entry in blocks.values():
        entry["kind"] = "ME"
    made = project / "two.json"
    made.write_text(json.dumps({**text, "inputs": {"v": {"default": 1}, "tau": {"default": 0}},
        "wires": {f"{block}.{name}": name for block in blocks for name in ("v", "tau")}}))  # fmt: skip
    (warning,) = to_be_refused(Diagram.load(made).value)
    assert (warning.code, warning.place) == ("W205", "far")
    assert main(["check", str(made)]) == 0
    told = capsys.readouterr().out
    assert f"W205 {made}:1:" in told
    assert f"--trust {away / MOTOR.name}" in told
    assert "0 errors, 1 warning" in told
    assert main(["run", str(made)]) == 4
    assert "E218" in capsys.readouterr().err
