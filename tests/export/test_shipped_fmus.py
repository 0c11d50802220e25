"""The FMUs in fmus/ are those that `blocks export` makes now."""

from __future__ import annotations

import platform
import re
import shlex
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from blocks import cli
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.places import ROOT

COMMANDS = re.findall(r"^blocks (export .*)$", (ROOT / "fmus" / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
NAMES = [re.search(r"fmus/(\S+)", command)[1] for command in COMMANDS]  # type: ignore[index]


def test_the_readme_tells_how_each_fmu_was_made() -> None:
    assert sorted(NAMES) == sorted(path.name for path in (ROOT / "fmus").glob("*.fmu"))


def again(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Path:
    """The FMU made by its command, in another folder."""
    monkeypatch.chdir(ROOT)
    words = shlex.split(COMMANDS[NAMES.index(name)].replace(f"fmus/{name}", str(folder / name)))
    assert cli.main([*words, *options]) == 0
    return folder / name


@pytest.mark.parametrize("name", NAMES)
def test_its_description_and_sources_are_the_same_bytes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        zipfile.ZipFile(ROOT / "fmus" / name) as kept,
        zipfile.ZipFile(again(name, tmp_path, monkeypatch, "--platform", "none")) as made,
    ):
        files = [path for path in kept.namelist() if not path.startswith("binaries/")]
        assert files == made.namelist()
        for path in files:
            assert kept.read(path) == made.read(path), path


@pytest.mark.parametrize("name", NAMES)
def test_it_is_small_valid_and_holds_a_linux_binary(name: str) -> None:
    path = ROOT / "fmus" / name
    assert path.stat().st_size < 300_000
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        (binary,) = [entry for entry in archive.namelist() if entry.startswith("binaries/")]
        assert Path(binary).parent.name == ("linux64" if "fmi2" in name else "x86_64-linux")


@pytest.mark.skipif(
    not (sys.platform == "linux" and platform.machine() == "x86_64" and find_compiler()),
    reason="the binaries are for linux x86_64, and others are compiled",
)
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("name", NAMES)
def test_its_binary_does_what_one_that_is_made_now_does(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.linspace(0.0, 0.5, 51)
    names = ("v", "tau") if "Motor" in name else ("r", "y")
    rows = np.zeros(len(t), dtype=[("time", float), *((word, float) for word in names)])
    rows["time"], rows[names[0]], rows[names[1]] = t, 1.0 + t, 0.1 * np.sin(20 * t)
    ours, theirs = (
        simulate_fmu(str(path), stop_time=0.5, output_interval=0.01, input=rows, fmi_type=kind)
        for path in (ROOT / "fmus" / name, again(name, tmp_path, monkeypatch))
    )
    assert ours.dtype.names == theirs.dtype.names
    for word in ours.dtype.names:
        assert ours[word] == pytest.approx(theirs[word], rel=1e-9, abs=1e-12)


def test_fmus_carry_the_licence_of_their_code() -> None:
    carried = ROOT / "blocks" / "export" / "c" / "license.txt"
    assert carried.read_bytes() == (ROOT / "LICENSE").read_bytes()
