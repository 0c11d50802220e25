"""Sources of FMUs, compiled for this machine: the binary gives what the one that was shipped gives; what is refused."""

from __future__ import annotations

import io
import json
import re
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest

from blocks import CompilerError, FMUError
from blocks.cli import main
from blocks.compile.toolchain.platforms import folder_of, suffix_of, this_platform
from blocks.export.source_fmu import BUILD, compile_sources
from blocks.fmi.binary import functions
from tests.support.places import ROOT

FOLDER = ROOT / "fmus"
FMUS = {2: FOLDER / "PMDCMotor_fmi2.fmu", 3: FOLDER / "PMDCMotor.fmu"}
CONFIGURATION = '<BuildConfiguration modelIdentifier="PMDCMotor">'
SET = '<SourceFileSet language="C11">'


def files_of(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(path: Path, files: Mapping[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def without_binaries(folder: Path, fmi: int, change: Callable[[dict[str, bytes]], None] | None = None) -> Path:
    files = {name: data for name, data in files_of(FMUS[fmi]).items() if not name.startswith("binaries/")}
    if change is not None:
        change(files)
    return packed(folder / "x.fmu", files)


def member(fmi: int) -> str:
    platform = this_platform()
    return f"binaries/{folder_of(platform, fmi)}/PMDCMotor{suffix_of(platform)}"


def rebuilt(files: dict[str, bytes], old: str, new: str) -> None:
    text = files[BUILD].decode()
    assert old in text
    files[BUILD] = text.replace(old, new, 1).encode()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_compiled_fmu_gives_what_the_shipped_one_gives(fmi: int, tmp_path: Path) -> None:
    path = without_binaries(tmp_path, fmi)
    before = files_of(path)
    made = compile_sources(path, path)
    assert made.binaries == (member(fmi),)
    assert str(made) == f"{path}: {member(fmi)}"
    after = files_of(path)
    assert {name: data for name, data in after.items() if name != member(fmi)} == before
    assert list(after)[: len(before)] == list(before), "the others stand where they stood"
    found = [
        fmpy.simulate_fmu(str(one), fmi_type=kind, stop_time=1.0, output_interval=0.01, start_values={"v": 6.0})
        for kind in ("CoSimulation", "ModelExchange")
        for one in (path, FMUS[fmi])
    ]
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[2], found[3])
    assert found[0]["omega"][-1] > 1.0


def test_a_binary_that_is_there_is_replaced_and_the_file_can_go_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "x.fmu"
    shutil.copy(FMUS[3], path)
    before = path.read_bytes()
    compile_sources(path, tmp_path / "y.fmu")
    assert path.read_bytes() == before
    assert files_of(tmp_path / "y.fmu").keys() == files_of(path).keys()
    first = (tmp_path / "y.fmu").read_bytes()
    compile_sources(tmp_path / "y.fmu", tmp_path / "y.fmu")
    assert (tmp_path / "y.fmu").read_bytes() == first
    assert sorted(one.name for one in tmp_path.iterdir()) == ["x.fmu", "y.fmu"], "nothing is left behind"


def test_definitions_of_the_build_description_reach_all_texts(tmp_path: Path) -> None:
    def change(files: dict[str, bytes]) -> None:
        files["sources/model.c"] += (
            b"\n#if ANSWER != 42\n#error no ANSWER\n#endif\n#ifdef MAYBE\n#error MAYBE\n#endif\n"
        )
        files["sources/tables.c"] += b'\n#include "own.h"\n'
        files["sources/more/own.h"] = b"#ifndef ANSWER\n#error no ANSWER\n#endif\n"
        more = '<PreprocessorDefinition name="ANSWER" value="42"/><IncludeDirectory name="more/"/>'
        more += '<PreprocessorDefinition name="MAYBE" optional="true" value="1"/>'
        rebuilt(files, SET, SET + more)

    path = without_binaries(tmp_path, 3, change)
    made = compile_sources(path, path)
    assert made.notes == ("without the optional definition MAYBE",)
    wrong = without_binaries(tmp_path, 3, lambda files: files.update({"sources/model.c": b"#error stop here\n"}))
    with pytest.raises(CompilerError) as caught:
        compile_sources(wrong, wrong)
    assert caught.value.code == "E602"
    assert "stop here" in str(caught.value)
    assert caught.value.faults[0].place == "x.fmu"


def test_a_configuration_for_this_platform_comes_first(tmp_path: Path) -> None:
    def change(files: dict[str, bytes]) -> None:
        own = f'<BuildConfiguration modelIdentifier="PMDCMotor" platform="{this_platform()}">'
        files["sources/own.c"] = b"#ifndef OWN\n#error not by it\n#endif\ntypedef int none;\n"
        define = '<PreprocessorDefinition name="OWN"/><SourceFile name="own.c"/>'
        text = files[BUILD].decode()
        parts = ("fmi3", "fmu", "jacobian", "model", "runtime", "tables")
        names = "".join(f'<SourceFile name="{name}.c"/>' for name in parts)
        first = f"{own}<SourceFileSet>{define}{names}</SourceFileSet></BuildConfiguration>"
        files[BUILD] = text.replace("</fmiBuildDescription>", f"{first}</fmiBuildDescription>").encode()

    path = without_binaries(tmp_path, 3, change)
    assert compile_sources(path, path).binaries == (member(3),)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (SET, '<SourceFileSet language="C++11">', "are written in C++11; blocks compiles C only"),
        (SET, '<SourceFileSet compilerOptions="-fplugin=evil.so">', "requires the compiler options '-fplugin=evil.so'"),
        ('<Library name="m"', '<Library name="lapack"', "needs the library 'lapack'"),
        ('"model.c"', '"modle.c"', "the source 'modle.c' of PMDCMotor is not in the FMU"),
        ('"model.c"', '"model.h"', "model.h of PMDCMotor is not a C file"),
        ('"model.c"', '"../model.c"', "the source '../model.c' of PMDCMotor is not in the FMU"),
        (SET, f'{SET}<PreprocessorDefinition name="A B" value=""/>', "which is not a valid definition in C"),
        (
            SET,
            f'{SET}<PreprocessorDefinition name="A" value="1&#10;#include &lt;x&gt;"/>',
            "not a valid definition in C",
        ),
        (CONFIGURATION, '<BuildConfiguration modelIdentifier="PMDCMotor" platform="z80-cpm">', "how to build"),
        (CONFIGURATION, '<BuildConfiguration modelIdentifier="Other">', "not for"),
    ],
)
def test_what_is_not_supported_is_refused(old: str, new: str, text: str, tmp_path: Path) -> None:
    path = without_binaries(tmp_path, 3, lambda files: rebuilt(files, old, new))
    before = path.read_bytes()
    with pytest.raises(FMUError) as caught:
        compile_sources(path, path)
    assert caught.value.code == "E219"
    assert text in str(caught.value)
    assert path.read_bytes() == before


def test_what_does_not_say_what_is_compiled_is_refused(tmp_path: Path) -> None:
    def bare(files: dict[str, bytes]) -> None:
        for name in [name for name in files if name.startswith("sources/")]:
            del files[name]

    def unlisted(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        files["modelDescription.xml"] = re.sub(r"<SourceFiles>.*?</SourceFiles>", "", text, flags=re.DOTALL).encode()

    for fmi, change, text in (
        (3, bare, "it contains no sources"),
        (3, lambda files: files.pop(BUILD), f"it has no {BUILD}"),
        (2, unlisted, "lists no SourceFiles"),
        (2, lambda files: files.update({"sources/fmi2.c": b"int x;\n"}), "do not define the function fmi2Instantiate"),
    ):
        path = without_binaries(tmp_path, fmi, change)  # type: ignore[arg-type]
        with pytest.raises(FMUError, match=text) as caught:
            compile_sources(path, path)
        assert caught.value.code == "E219"


def test_headers_of_the_standard_and_names_with_a_prefix(tmp_path: Path) -> None:
    source = """
#define FMI2_FUNCTION_PREFIX tiny_
#include "fmi2Functions.h"
#include "../config.h"
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
    const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging) { return CONFIGURED; }
"""
    description = files_of(FMUS[2])["modelDescription.xml"].decode()
    listed = "<SourceFiles><File name='src/tiny.c'/></SourceFiles>"
    description = re.sub(r"<SourceFiles>.*?</SourceFiles>", listed, description, flags=re.DOTALL)
    path = packed(
        tmp_path / "x.fmu",
        {
            "modelDescription.xml": description,
            "sources/src/tiny.c": source,
            "sources/config.h": "#define CONFIGURED 0\n",
            "sources/a note on it.txt": "not compiled",
        },
    )
    compile_sources(path, path)
    data = files_of(path)[member(2)]
    given = functions(io.BytesIO(data), len(data))
    assert given is None or ("fmi2Instantiate" in given and "tiny_fmi2Instantiate" not in given)


def test_blocks_fmu_compile(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = without_binaries(tmp_path, 3)
    assert main(["fmu", "check", str(path)]) == 4
    assert "blocks fmu compile x.fmu" in capsys.readouterr().out
    assert main(["fmu", "compile", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: {member(3)}\n"
    assert main(["fmu", "check", str(path)]) == 0
    capsys.readouterr()
    assert main(["fmu", "compile", str(path), "-o", str(tmp_path / "y.fmu"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "event": "compiled",
        "path": str(tmp_path / "y.fmu"),
        "binaries": [member(3)],
        "notes": [],
    }
    assert main(["fmu", "compile", str(tmp_path / "none.fmu")]) == 2
    assert main(["fmu", "compile", str(path), "-o", str(tmp_path / "no" / "y.fmu")]) == 2
    assert main(["fmu", "compile", str(path), "--platform", "z80-cpm"]) == 2
