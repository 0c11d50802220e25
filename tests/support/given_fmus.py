"""What must be there before examples about FMUs, runs, compiled code and linear models are run.

GIVEN holds a function by code; it gets the folder in which the example runs, and pytest's monkeypatch. FMUs are made
of the integrator of support/faulty, with a description as short as tools write it; a library is compiled once for each
set of flags.
"""

from __future__ import annotations

import errno
import functools
import os
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace

import pytest

from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain import compiler as driver
from blocks.engines.native import model
from blocks.fmi import isolation
from blocks.fmi.library import folders, suffix
from tests.support.faulty import COMPILER, TOKEN, compiled, make

DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="plant" instantiationToken="{TOKEN}">
  <CoSimulation modelIdentifier="plant" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent"/>
    <Float64 name="u" valueReference="1" causality="input" start="0"/>
    <Float64 name="y" valueReference="2" causality="output"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="2" dependencies=""/>
    <InitialUnknown valueReference="2" dependencies=""/>
  </ModelStructure>
</fmiModelDescription>
"""
INTERFACE = '<CoSimulation modelIdentifier="plant"'
HERE, ENDING = folders(3)[0], suffix()

Given = Callable[[Path, pytest.MonkeyPatch], None]
GIVEN: dict[str, Given] = {}


def given(code: str) -> Callable[[Given], Given]:
    """Says of which code a function makes what must be there."""

    def known(function: Given) -> Given:
        GIVEN[code] = function
        return function

    return known


def plant(
    folder: Path,
    *replaced: tuple[str, str],
    flags: tuple[str, ...] = (),
    files: Mapping[str, bytes] | None = None,
) -> None:
    """plant.fmu, an integrator. replaced: in its description; flags: of its library; files: in place of its library."""
    text = DESCRIPTION
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    if files is None:
        files = {f"binaries/{HERE}/plant{ENDING}": compiled(3, flags).read_bytes()}
    with zipfile.ZipFile(folder / "plant.fmu", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {"modelDescription.xml": text.encode(), **files}.items():
            archive.writestr(name, data)


# --- files that are no FMU for this machine ----


@given("E201")
def for_windows(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, files={"binaries/x86_64-windows/plant.dll": b"MZ"})


@given("E203")
def leads_out(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, files={"resources/../../.bashrc": b"echo hello\n"})


@given("E204")
def cut_in_the_middle(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, ("  </ModelStructure>\n</fmiModelDescription>\n", ""), files={})


@given("E205")
def for_co_simulation(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder)


@given("E206")
def one_name_for_two(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, ('name="u"', 'name="y"'), files={})


@given("E207")
def truncated(folder: Path, patch: pytest.MonkeyPatch) -> None:
    data = compiled(3).read_bytes()
    plant(folder, files={f"binaries/{HERE}/plant{ENDING}": data[: len(data) // 2]})


@functools.cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="blocks-test-given-")


@functools.cache
def _needing(library: str) -> tuple[str, ...]:
    """Flags of a library that needs another one, which is not there."""
    path = Path(_temporary().name, library)
    (path.with_suffix(".c")).write_text("int nothing;\n")
    command = [
        str(COMPILER),
        "-shared",
        "-fPIC",
        f"-Wl,-soname,{library}",
        "-o",
        str(path),
        f"{path.with_suffix('.c')}",
    ]
    subprocess.run(command, check=True)
    return "-Wl,--no-as-needed", str(path)


@given("E208")
def without_its_library(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=_needing("libplantsolver.so.2"))


@given("E209")
def aborts_at_load(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DABORTS_AT_LOAD",))


@given("E210")
def full_disk(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder)
    real = os.open

    def full(file: str | os.PathLike[str], wanted: int, *rest: int, **more: int) -> int:
        if wanted & os.O_CREAT and str(file).endswith(ENDING):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(file, wanted, *rest, **more)

    patch.setattr(os, "open", full)


# --- FMUs that fail ----


@given("E211")
def only_once(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, (INTERFACE, f'{INTERFACE} canBeInstantiatedOnlyOncePerProcess="true"'))


@given("E212")
def of_two_exports(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, (TOKEN, "{2f1b}"))


@given("E213")
def fails(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DBEGINS_WITH=ERRORS",))


@given("E214")
def ends_steps_early(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DBEGINS_WITH=EARLY",))


@given("E215")
def goes_back_at_the_start_only(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, (INTERFACE, f'{INTERFACE} canGetAndSetFMUState="true"'), flags=("-DNO_ROLLBACK_LATER",))


@given("E216")
def crashes(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DBEGINS_WITH=SEGFAULTS",))


@given("E217")
def elsewhere_than_on_linux(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder)
    patch.setattr(isolation, "sys", SimpleNamespace(platform="win32"))


@given("E218")
@given("W205")
def in_a_folder_of_downloads(folder: Path, patch: pytest.MonkeyPatch) -> None:
    (folder / "downloads").mkdir()
    plant(folder / "downloads")


@given("E219")
def in_cpp(folder: Path, patch: pytest.MonkeyPatch) -> None:
    building = (
        '<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="plant"><SourceFileSet'
        ' language="C++14"><SourceFile name="plant.cpp"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>'
    )
    plant(folder, files={"sources/buildDescription.xml": building.encode(), "sources/plant.cpp": b""})


@given("W206")
def ends_the_run(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DBEGINS_WITH=TERMINATES",))


@given("W201")
def unit_of_its_own(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, ('name="y"', 'name="y" unit="rpm"'))


@given("W202")
def needs_a_tool(folder: Path, patch: pytest.MonkeyPatch) -> None:
    named = 'generationTool="PlantStudio 4.1"'
    plant(
        folder,
        ('modelName="plant"', f'modelName="plant" {named}'),
        (INTERFACE, f'{INTERFACE} needsExecutionTool="true"'),
    )


@given("W203")
def warns(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, flags=("-DBEGINS_WITH=WARNS",))


@given("W204")
def says_nothing_of_dependencies(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, (' dependencies=""', ""))


@given("W208")
def lags(folder: Path, patch: pytest.MonkeyPatch) -> None:
    make(folder, fmi=3, kind="ME", name="plant", defines=("LAGS",))


@given("W207")
def refuses_derivatives(folder: Path, patch: pytest.MonkeyPatch) -> None:
    make(folder, fmi=2, name="plant", defines=("TAKES_ORDER=0",))


@given("W211")
def is_for_co_simulation(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder)


@given("W209")
def takes_steps_of_one_size(folder: Path, patch: pytest.MonkeyPatch) -> None:
    make(folder, fmi=2, name="plant", any_step=False)


# --- runs ----


@given("E311")
def little_memory(folder: Path, patch: pytest.MonkeyPatch) -> None:
    patch.setattr("blocks.host.available_memory.available", lambda: 4.0 * 2**30)


# --- compiled code ----


@given("E602")
def sources_with_a_mistake(folder: Path, patch: pytest.MonkeyPatch) -> None:
    building = (
        '<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="plant"><SourceFileSet>'
        '<SourceFile name="plant.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>'
    )
    files = {"sources/buildDescription.xml": building.encode(), "sources/plant.c": b"double k = K_DEFAULT;\n"}
    plant(folder, files=files)


@given("E603")
def nothing_may_be_run_from_the_cache(folder: Path, patch: pytest.MonkeyPatch) -> None:
    def refused(path: str, *rest: object, **more: object) -> None:
        raise OSError(f"{path}: failed to map segment from shared object")

    patch.setattr(model, "_MODELS", {})
    patch.setattr(driver, "_loaded", {})
    patch.setattr(driver, "_Library", refused)


@given("E604")
def nowhere_to_write(folder: Path, patch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> str:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    patch.setattr(model, "_MODELS", {})
    patch.setenv(caches.VARIABLE, str(folder / "cache"))
    patch.setattr(caches, "_temporary", {})
    patch.setattr(caches, "_refused", {})
    patch.setattr(tempfile, "mkdtemp", full)


@given("E605")
def no_compiler(folder: Path, patch: pytest.MonkeyPatch) -> None:
    patch.setattr(model, "_MODELS", {})
    patch.delenv("CC", raising=False)
    patch.setenv("PATH", str(folder))
    patch.setattr(driver, "PACKAGES", ())


# --- linear models ----


@given("E703")
def hides_its_states(folder: Path, patch: pytest.MonkeyPatch) -> None:
    plant(folder, files={})
