"""The binary of an FMU: which fits, what it says of itself, and every way in which it does not load, as an error."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import struct
import subprocess
import sys
import time
import zipfile
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks.compile.toolchain.cache import Cache
from blocks.compile.toolchain.platforms import PLATFORMS, folder_of, suffix_of, this_platform
from blocks.fmi import library
from blocks.fmi.archive import DESCRIPTION, Archive, unpack
from blocks.fmi.binary import Binary, functions, inspect
from blocks.fmi.description import parse
from blocks.fmi.library import binaries, claimed, faults, find, folders, function, load, suffix, this_machine, unload
from blocks.text.errors import FMUError
from tests.support.places import ROOT

GCC = shutil.which("gcc")
ON_LINUX = pytest.mark.skipif(not sys.platform.startswith("linux") or not GCC, reason="gcc and ELF")
FMUS = sorted((ROOT / "fmus").glob("*.fmu"))
XML = (
    '<fmiModelDescription fmiVersion="{fmi}.0" modelName="m" guid="1" instantiationToken="1" generationTool="Tool 1">'
    '<CoSimulation modelIdentifier="m" needsExecutionTool="{tool}"/><ModelVariables/><ModelStructure/>'
    "</fmiModelDescription>"
)


def described(fmi: int = 2, tool: str = "false") -> bytes:
    return XML.format(fmi=fmi, tool=tool).encode()


def compiled(folder: Path, code: str, *flags: str, name: str = "m") -> Path:
    """A shared library of C code."""
    folder.mkdir(exist_ok=True)
    source, path = folder / f"{name}.c", folder / f"{name}.so"
    source.write_text(code)
    subprocess.run([str(GCC), "-shared", "-fPIC", "-o", str(path), str(source), *flags], check=True)
    source.unlink()
    return path


def code_of(path: Path, **options: Any) -> tuple[str, str]:
    """Code and text of the error that loading raises."""
    with pytest.raises(FMUError) as caught:
        load(path, place="x.fmu", **options)
    (fault,) = caught.value.faults
    assert fault.place == "x.fmu"
    assert fault.cure
    assert str(fault).isprintable()
    return fault.code, str(fault)


class Tally:
    """How often another process was started, while notes are kept in memory."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.probes, self.text = 0, ""
        real = library._probe

        def counted(*arguments: Any) -> None:
            self.probes += 1
            real(*arguments)

        monkeypatch.setattr(library, "_probe", counted)

    def read_note(self, name: str) -> str:
        return self.text

    def write_note(self, name: str, text: str) -> None:
        self.text = text


@pytest.fixture(autouse=True)
def forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that has loaded nothing yet."""
    monkeypatch.setattr(library, "_loaded", {})
    monkeypatch.setattr(library, "_tried", set())


# --- which one fits ----


def test_the_names_of_this_machine_are_those_that_the_exporter_writes() -> None:
    assert this_machine() == this_platform()
    if this_machine() in PLATFORMS:
        for fmi in (2, 3):
            assert folders(fmi)[0] == folder_of(this_machine(), fmi)
        assert suffix() == suffix_of(this_machine())


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.name)
@pytest.mark.skipif(this_machine() != "x86_64-linux", reason="the binaries are for x86_64-linux")
def test_the_fmus_of_the_repository_load_and_step_functions_are_there(path: Path) -> None:
    with Archive(path) as archive:
        mine = parse(archive.read(DESCRIPTION))
        assert faults(archive, mine, "CS") == faults(archive, mine, "ME") == ()
        interface = mine.interface("CS")
        assert interface is not None
        member = find(archive.files, mine, interface, path.name)
    with unpack(path) as files:
        loaded = load(files.folder / member, place=path.name)
        assert isinstance(loaded, ctypes.CDLL)
        prefix = f"fmi{mine.fmi}"
        version = function(loaded, f"{prefix}GetVersion", path.name)
        version.restype = ctypes.c_char_p
        assert version().decode() == mine.version
        assert function(loaded, f"{prefix}DoStep", path.name)
        with pytest.raises(FMUError, match=rf"E208 {re.escape(path.name)}: .* lacks the function {prefix}DoSteps,"):
            function(loaded, f"{prefix}DoSteps", path.name)
        unload(loaded)
    assert str(files._shared.made[0]) not in Path("/proc/self/maps").read_text()
    assert not files._shared.made[0].exists()


@pytest.mark.parametrize(
    ("machine", "fmi", "expected"),
    [
        ("x86_64-linux", 2, ("linux64", "x86_64-linux")),
        ("x86_64-linux", 3, ("x86_64-linux", "linux64")),
        ("x86_64-windows", 2, ("win64", "x86_64-windows")),
        ("x86-windows", 2, ("win32", "x86-windows")),
        ("aarch64-linux", 2, ("aarch64-linux", "linux64")),
        ("aarch64-darwin", 2, ("aarch64-darwin", "darwin64")),
        ("aarch64-darwin", 3, ("aarch64-darwin", "darwin64")),
        ("riscv64-linux", 2, ("riscv64-linux",)),
    ],
)
def test_folders_are_looked_for_by_the_names_of_both_standards(
    machine: str, fmi: int, expected: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library, "this_machine", lambda: machine)
    assert folders(fmi) == expected


@pytest.mark.parametrize(
    ("files", "what"),
    [
        (["resources/a"], "it holds no binaries; this machine is linux64."),
        (["binaries/win64/m.dll"], "it holds binaries for win64 only; this machine is linux64. Export it"),
        (
            ["binaries/win64/m.dll", "binaries/darwin64/m.dylib", "sources/m.c"],
            (
                "binaries for darwin64, win64 only; this machine is linux64. "
                "It contains sources. Run: blocks fmu compile x.fmu"
            ),
        ),
        (
            ["binaries/linux64/n.so"],
            ("binaries/linux64 does not hold m.so, the binary that its modelIdentifier names; it holds n.so."),
        ),
        (["binaries/linux64/m.dll"], "binaries/linux64 does not hold m.so, the binary that its modelIdentifier names."),
    ],
)
def test_no_fitting_binary_is_an_error_that_says_what_there_is(
    files: list[str], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library, "this_machine", lambda: "x86_64-linux")
    mine = parse(described())
    with pytest.raises(FMUError) as caught:
        find(dict.fromkeys(files, 1), mine, mine.interfaces[0], "x.fmu")
    assert caught.value.code == "E201"
    assert what in str(caught.value)


def test_a_folder_of_the_other_standard_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "this_machine", lambda: "x86_64-linux")
    for fmi, name in ((2, "x86_64-linux"), (3, "linux64")):
        mine = parse(described(fmi))
        member = f"binaries/{name}/m.so"
        assert find({member: 1, "binaries/win64/m.dll": 1}, mine, mine.interfaces[0], "x.fmu") == member
    assert binaries({"binaries/win64/m.dll": 1, "binaries/win64/a/b.dll": 1, "binaries/readme": 1, "x": 1}) == {
        "win64": ("m.dll", "a/b.dll")
    }


def archived(folder: Path, data: bytes, description: bytes | None = None, **more: bytes) -> Archive:
    path = folder / "x.fmu"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr(DESCRIPTION, description or described())
        made.writestr(f"binaries/{folders(2)[0]}/m{suffix()}", data)
        for name, inner in more.items():
            made.writestr(f"binaries/{folders(2)[0]}/{name}", inner)
    return Archive(path)


@ON_LINUX
def test_what_speaks_against_an_fmu_is_told_without_loading_it(tmp_path: Path) -> None:
    good = compiled(tmp_path, "__attribute__((constructor)) void f(void) { *(volatile int *)0 = 0; }").read_bytes()
    told = []
    other = good[:18] + struct.pack("<H", 183) + good[20:]
    for data, description, kind in (
        (good, described(), "CS"),
        (good, described(), "ME"),
        (good, described(tool="true"), "CS"),
        (good[:-100], described(), "CS"),
        (other, described(), "CS"),
        (b"", described(), "CS"),
        (b"MZ" + bytes(58) + struct.pack("<I4sH", 64, b"PE\0\0", 0x8664), described(), "CS"),
    ):
        with archived(tmp_path, data, description) as archive:
            told.append([str(fault) for fault in faults(archive, parse(description), kind)])
    assert told[0] == []
    assert told[1] == ["E205 x.fmu: it is an FMU for Co-Simulation, not for Model Exchange. Choose another kind."]
    assert told[2][0].startswith(
        "W202 x.fmu: it declares that it needs an external program to run, usually the tool that exported it (Tool 1)."
    )
    assert "E207 x.fmu: binaries/" in told[3][0]
    assert "truncated" in told[3][0]
    assert "is built for aarch64-linux; this Python is" in told[4][0]
    assert "it is empty" in told[5][0]
    assert "is built for x86_64-windows" in told[6][0]


@ON_LINUX
def test_a_missing_library_is_named_without_loading_anything(tmp_path: Path) -> None:
    needed = compiled(tmp_path, "int g(void) { return 1; }", "-Wl,-soname,libnowhere_7.so", name="libnowhere_7")
    user = compiled(tmp_path, "int g(void); int f(void) { return g(); }", str(needed))
    description = described()
    with archived(tmp_path, user.read_bytes()) as archive:
        (fault,) = faults(archive, parse(description), "CS")
        assert fault.code == "E208"
        assert "needs the library libnowhere_7.so, which this machine does not have" in fault.message
    with archived(tmp_path, user.read_bytes(), **{"libnowhere_7.so": needed.read_bytes()}) as archive:
        assert faults(archive, parse(description), "CS") == ()


@ON_LINUX
@pytest.mark.parametrize("tags", ["--enable-new-dtags", "--disable-new-dtags"])  # RUNPATH, RPATH
def test_a_library_is_looked_for_along_rpath_and_runpath_as_the_loader_looks(tmp_path: Path, tags: str) -> None:
    # A library needs libmid_6 along its path, and that one libend_6, for which it names no folder.
    parts, apart = tmp_path / "parts", tmp_path / "apart"
    end = compiled(parts, "int e(void) { return 1; }", "-Wl,-soname,libend_6.so", name="libend_6")
    code = "int e(void); int g(void) { return e(); }"
    mid = compiled(parts, code, str(end), "-Wl,-soname,libmid_6.so", name="libmid_6")
    apart.mkdir()
    shutil.copy(end, apart)
    tried = (  # the path, and what lies in which folder of the archive
        ("$ORIGIN", ".", []),
        ("$ORIGIN/../lib", "../lib", []),
        ("${ORIGIN}/../lib:/nowhere", "../lib", [mid, end]),
        (f"$ORIGIN/../lib:{apart}", "../lib", [mid]),
        ("/nowhere/lib", ".", [mid, end]),
        ("/nowhere", ".", [mid]),
    )
    told = []
    for k, (path, folder, held) in enumerate(tried):
        flags = (f"-Wl,{tags}", f"-Wl,-rpath,{path}", f"-L{parts}", "-Wl,--allow-shlib-undefined")
        user = compiled(tmp_path, "int g(void); int f(void) { return g(); }", str(mid), *flags)
        root, at = tmp_path / str(k), f"binaries/{folders(2)[0]}"
        files = {f"{at}/m.so": user, **{os.path.normpath(f"{at}/{folder}/{one.name}"): one for one in held}}
        with zipfile.ZipFile(tmp_path / "x.fmu", "w") as made:
            made.writestr(DESCRIPTION, described())
            for name, one in files.items():
                made.write(one, name)
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(one, root / name)
        with Archive(tmp_path / "x.fmu") as archive:
            found = " ".join(map(str, faults(archive, parse(described()), "CS")))
        try:  # the truth is the system's loader
            load(root / at / "m.so", place="x.fmu")
            theirs = ""
        except FMUError as error:
            theirs = str(error)
        mine = set(re.findall(r"needs the library (lib\w+)", found))
        told.append(mine)
        assert mine == set(re.findall(r"needs the library (lib\w+)", theirs)), path
    assert told[:2] == [{"libmid_6"}, {"libmid_6"}]
    assert told[-1] == {"libend_6"}


# --- what a binary says of itself ----


def inspected(path: Path) -> Binary:
    with open(path, "rb") as stream:
        return inspect(stream, path.stat().st_size)


def elves() -> list[Path]:
    """Shared libraries of many makers: those of the packages that are installed."""
    import casadi
    import numpy
    import scipy

    found: list[Path] = []
    for package in (numpy, scipy, casadi):
        libraries = sorted(Path(str(package.__file__)).parent.rglob("*.so*"), key=lambda one: one.name)
        found += [one for one in libraries if one.is_file() and one.stat().st_size < 20_000_000][:6]
    return found


@ON_LINUX
@pytest.mark.skipif(shutil.which("readelf") is None, reason="readelf")
def test_needed_libraries_and_paths_are_those_that_readelf_prints() -> None:
    for path in elves():
        printed = subprocess.run(["readelf", "-dW", str(path)], capture_output=True, text=True, check=True).stdout
        mine = inspected(path)
        assert mine.problem == "", path
        assert mine.machines == (this_machine(),)
        assert list(mine.needed) == re.findall(r"\(NEEDED\).*\[(.*)\]", printed)
        paths = [one for line in re.findall(r"\((?:RPATH|RUNPATH)\).*\[(.*)\]", printed) for one in line.split(":")]
        assert list(mine.paths) == paths


@ON_LINUX
@pytest.mark.skipif(shutil.which("nm") is None, reason="nm")
def test_functions_are_those_that_nm_prints() -> None:
    for path in elves()[:4]:
        printed = subprocess.run(["nm", "-D", "--defined-only", str(path)], capture_output=True, text=True, check=True)
        names = {line.split()[-1].partition("@")[0] for line in printed.stdout.splitlines()}
        with open(path, "rb") as stream:
            mine = functions(stream, path.stat().st_size)
        assert mine is not None
        # nm leaves out a few that are nothing to call, such as names of versions.
        assert names <= mine
        assert all(not name.startswith("Py") or name in names for name in mine)
    assert functions(BytesIO(b"MZ"), 2) is None
    assert functions(BytesIO(b"\x7fELF"), 4) is None


@ON_LINUX
def test_every_truncation_of_a_library_is_seen_before_it_is_loaded(tmp_path: Path) -> None:
    data = compiled(tmp_path, "int f(int x) { return x; }", "-O1").read_bytes()
    assert inspect(BytesIO(data), len(data)).problem == ""
    for length in {*range(0, 200), *range(200, len(data), 13), len(data) - 1}:
        assert inspect(BytesIO(data[:length]), length).problem, length


@ON_LINUX
def test_a_truncated_library_is_an_error_and_python_lives_on(tmp_path: Path) -> None:
    path = compiled(tmp_path, "int f(int x) { return x; }")
    data = path.read_bytes()
    for length in (0, 10, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        assert code_of(path)[0] == "E207"


@pytest.mark.parametrize(
    ("data", "machines"),
    [
        (b"MZ" + bytes(58) + struct.pack("<I4sH", 64, b"PE\0\0", 0x14C), ("x86-windows",)),
        (b"MZ" + bytes(58) + struct.pack("<I4sH", 64, b"PE\0\0", 0xAA64), ("aarch64-windows",)),
        (struct.pack("<II", 0xFEEDFACF, 0x0100000C) + bytes(60), ("aarch64-darwin",)),
        (
            struct.pack(">II", 0xCAFEBABE, 2) + struct.pack(">10I", 0x01000007, 3, 0, 0, 0, 12, 0, 0, 0, 0),
            ("x86_64-darwin", "aarch32-darwin"),
        ),
    ],
)  # fmt: skip
def test_libraries_of_other_systems_are_told_by_their_machine(data: bytes, machines: tuple[str, ...]) -> None:
    assert inspect(BytesIO(data), len(data)) == Binary(machines)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "empty"),
        (b"hello", "not a shared library"),
        (b"MZ", "truncated"),
        (b"MZ" + bytes(200), "not a shared library"),
        (struct.pack(">II", 0xCAFEBABE, 52), "not a shared library"),  # a Java class
        (struct.pack(">II", 0xCAFEBABE, 2), "truncated"),
    ],
)
def test_what_is_no_library_is_told(data: bytes, what: str) -> None:
    assert what in inspect(BytesIO(data), len(data)).problem


@ON_LINUX
def test_a_program_and_an_object_file_are_no_libraries(tmp_path: Path) -> None:
    source = tmp_path / "m.c"
    source.write_text("int main(void) { return 0; }")
    for name, flags in (("a program", ("-no-pie",)), ("an object file", ("-c",))):
        subprocess.run([str(GCC), *flags, "-o", str(tmp_path / "m.so"), str(source)], check=True)
        code, text = code_of(tmp_path / "m.so")
        assert code == "E207"
        assert f"it is {name}, not a shared library" in text


@settings(max_examples=300, deadline=None)
@given(
    changes=st.lists(st.tuples(st.integers(0, 400), st.binary(min_size=1, max_size=8)), max_size=5),
    tail=st.integers(0, 300),
)
def test_damaged_headers_raise_nothing(changes: list[tuple[int, bytes]], tail: int) -> None:
    head = struct.pack("<16sHHIQQQIHHHHHH", b"\x7fELF\2\1\1", 3, 62, 1, 0, 64, 176, 0, 64, 56, 2, 64, 1, 0)
    segments = struct.pack("<IIQQQQQQ", 1, 5, 0, 0, 0, 400, 400, 4096)
    segments += struct.pack("<IIQQQQQQ", 2, 6, 240, 240, 240, 48, 48, 8)
    dynamic = struct.pack("<6Q", 5, 300, 1, 1, 0, 0)
    data = bytearray((head + segments + bytes(64) + dynamic + b"\0libx.so\0".rjust(40, b"\0")).ljust(400, b"\0"))
    for at, piece in changes:
        data[at : at + len(piece)] = piece
    data = data[: len(data) - tail]
    assert isinstance(inspect(BytesIO(data), len(data)), Binary)
    functions(BytesIO(data), len(data))


# --- loading ----

AT_LOAD = "__attribute__((constructor)) static void at_load(void)"


@ON_LINUX
@pytest.mark.parametrize(
    ("body", "what"),
    [
        ("*(volatile int *)0 = 0;", "crashed (SIGSEGV) while it was loading"),
        (
            'fputs("out of luck\\n", stderr); abort();',
            ("crashed (SIGABRT) while it was loading. It printed: out of luck"),
        ),
        ("exit(0);", "ended the process (exit status 0) while it was loading"),
        ("_exit(7);", "ended the process (exit status 7) while it was loading"),
        ("raise(SIGKILL);", "crashed (SIGKILL)"),
    ],
)
def test_a_library_that_ends_its_process_is_an_error(body: str, what: str, tmp_path: Path) -> None:
    head = "#include <stdio.h>\n#include <stdlib.h>\n#include <signal.h>\n#include <unistd.h>\n"
    path = compiled(tmp_path, f"{head}{AT_LOAD} {{ {body} }}")
    for _ in range(2):
        code, text = code_of(path)
        assert code == "E209"
        assert what in text


def _runs(command: bytes) -> bool:
    """Whether a process of this machine was started by `command`."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if path.read_bytes().startswith(command):
                return True
    return False


@ON_LINUX
def test_a_library_that_hangs_is_an_error_and_no_process_stays(tmp_path: Path) -> None:
    mark = f"61{os.getpid()}"  # s, which no other process sleeps
    body = f'if (!fork()) {{ execlp("sleep", "sleep", "{mark}", NULL); }} for (;;) pause();'
    path = compiled(tmp_path, f"#include <unistd.h>\n#include <stddef.h>\n{AT_LOAD} {{ {body} }}")
    begun = time.monotonic()
    code, text = code_of(path, timeout=1.0)
    assert code == "E209"
    assert "m.so did not load within 1 s: it hangs, or it is slow." in text
    assert text.endswith('process with more time: "isolate": true, "timeout": 60.')
    assert library.TIMEOUT == 10.0
    assert time.monotonic() - begun < 20
    # The kernel ends the killed child in its own time, which is not that of whoever killed it.
    while _runs(b"sleep\0" + mark.encode()) and time.monotonic() - begun < 30:
        time.sleep(0.02)
    assert not _runs(b"sleep\0" + mark.encode())


@ON_LINUX
def test_an_interrupt_while_a_library_is_tried_leaves_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = compiled(tmp_path, f"#include <unistd.h>\n{AT_LOAD} {{ for (;;) pause(); }}")
    started: list[subprocess.Popen[bytes]] = []
    real = subprocess.Popen

    class Interrupted(real):  # type: ignore[valid-type, misc]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            started.append(self)

        def communicate(self, *_: Any, **__: Any) -> Any:
            raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        load(path, place="x.fmu")
    assert [process.returncode for process in started] == [-9]


@ON_LINUX
def test_all_missing_libraries_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    needed = [
        compiled(tmp_path, f"int {name}(void) {{ return 1; }}", f"-Wl,-soname,lib{name}_9.so", name=f"lib{name}_9")
        for name in ("aa", "bb")
    ]
    path = compiled(folder, "int aa(void), bb(void); int f(void) { return aa() + bb(); }", *map(str, needed))
    code, text = code_of(path)
    assert code == "E208"
    assert "m.so needs libraries libaa_9.so, libbb_9.so, which this machine does not have." in text
    shutil.copy(needed[0], folder)
    assert "m.so needs the library libbb_9.so" in code_of(path)[1]
    # Beside it they are found, though it does not say that they lie there.
    shutil.copy(needed[1], folder)
    assert function(load(path, place="x.fmu"), "f", "x.fmu")() == 2


@ON_LINUX
def test_neighbors_of_neighbors_are_found_too_and_unloaded_with_them(tmp_path: Path) -> None:
    inner = compiled(tmp_path, "int g(void) { return 41; }", "-Wl,-soname,libin_8.so", name="libin_8")
    outer = compiled(
        tmp_path, "int g(void); int h(void) { return g(); }", str(inner), "-Wl,-soname,libout_8.so", name="libout_8"
    )
    path = compiled(tmp_path, "int h(void); int f(void) { return h() + 1; }", str(outer))
    loaded = load(path, place="x.fmu")
    assert function(loaded, "f", "x.fmu")() == 42
    assert "libin_8.so" in Path("/proc/self/maps").read_text()
    unload(loaded)
    assert "libin_8.so" not in Path("/proc/self/maps").read_text()
    assert str(path) not in Path("/proc/self/maps").read_text()


@ON_LINUX
def test_a_missing_symbol_is_named(tmp_path: Path) -> None:
    code, text = code_of(compiled(tmp_path, "int nobody_has_this(void); int f(void) { return nobody_has_this(); }"))
    assert code == "E208"
    assert "m.so needs the symbol nobody_has_this, which no library on this machine has." in text


@ON_LINUX
def test_a_library_for_another_processor_is_an_error(tmp_path: Path) -> None:
    path = compiled(tmp_path, "int f(void) { return 1; }")
    data = bytearray(path.read_bytes())
    data[18:20] = struct.pack("<H", 243)
    path.write_bytes(data)
    code, text = code_of(path)
    assert code == "E207"
    assert "m.so is built for riscv64-linux; this Python is" in text


def test_a_file_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    code, text = code_of(tmp_path / "m.so")
    assert code == "E207"
    assert "No such file" in text


@ON_LINUX
def test_what_a_library_prints_while_it_is_tried_is_not_shown(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = compiled(tmp_path, f'#include <stdio.h>\n{AT_LOAD} {{ puts("{{}}hello"); fflush(stdout); }}')
    load(path, place="x.fmu")
    assert capfd.readouterr().out == "{}hello\n"  # from this process, once


@ON_LINUX
def test_a_library_is_tried_once_and_remembered_by_its_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tally = Tally(monkeypatch)
    first, again = compiled(tmp_path / "a", "int f(void) { return 1; }"), tmp_path / "b" / "m.so"
    again.parent.mkdir()
    shutil.copy(first, again)
    for path in (first, first, again):
        load(path, place="x.fmu", notes=tally)
    assert tally.probes == 1
    assert re.fullmatch("[0-9a-f]{64}\n", tally.text)
    # Another process knows it from the notes; without them it is tried again.
    library._loaded.clear()
    library._tried.clear()
    load(first, place="x.fmu", notes=tally)
    assert tally.probes == 1
    library._loaded.clear()
    load(first, place="x.fmu")
    assert tally.probes == 2
    # Other bytes beside it are another case, unless this process has loaded the file already.
    (first.parent / "data.txt").write_text("1")
    (again.parent / "data.txt").write_text("1")
    load(first, place="x.fmu", notes=tally)
    assert tally.probes == 2
    load(again, place="x.fmu", notes=tally)
    assert tally.probes == 3


@ON_LINUX
def test_what_failed_is_not_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tally = Tally(monkeypatch)
    path = compiled(tmp_path, "int missing_one(void); int f(void) { return missing_one(); }")
    for _ in range(2):
        code_of(path, notes=tally)
    assert tally.probes == 2
    assert tally.text == ""


@ON_LINUX
def test_the_notes_are_those_of_the_cache_of_compiled_code(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    cache = Cache(folder)
    load(compiled(tmp_path / "m", "int f(void) { return 1; }"), place="x.fmu", notes=cache)
    assert len(cache.read_note(library.NOTE).split()) == 1
    assert [one.name for one in folder.iterdir()] == [library.NOTE]


def test_notes_stay_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "REMEMBERED", 3)
    tally = Tally(monkeypatch)
    tally.text = "junk ../.. \n"
    for k in range(5):
        library._remember(tally, f"{k:064x}")
    assert tally.text.split() == [f"{k:064x}" for k in (2, 3, 4)]


@ON_LINUX
@pytest.mark.parametrize("how", ["frozen", "embedded"])
def test_without_an_interpreter_to_start_it_is_loaded_at_once(
    how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = compiled(tmp_path, "int f(void) { return 1; }")
    if how == "frozen":
        monkeypatch.setattr(sys, "frozen", True, raising=False)
    else:
        monkeypatch.setattr(sys, "executable", "")
    monkeypatch.setattr(subprocess, "Popen", None)
    assert load(path, place="x.fmu")


@pytest.mark.parametrize(
    ("text", "code", "what"),
    [
        ("libq.so.3: cannot open shared object file: No such file or directory", "E208", "library libq.so.3,"),
        ("Error loading shared library libq.so.3: No such file or directory (needed by m.so)", "E208", "libq.so.3,"),
        ("dlopen(m.so, 6): Library not loaded: @rpath/libq.dylib\n  Referenced from: x", "E208", "@rpath/libq.dylib"),
        ("/lib/libc.so.6: version `GLIBC_2.38' not found (required by m.so)", "E208", "needs GLIBC_2.38 of libc.so.6"),
        ("/x/m.so: undefined symbol: foo, version BAR", "E208", "the symbol foo,"),
        ("Error relocating /x/m.so: foo: symbol not found", "E208", "the symbol foo,"),
        ("dlopen(m.so): Symbol not found: _foo\n Expected in: flat", "E208", "the symbol foo,"),
        ("dlopen(m.so): symbol not found in flat namespace '_foo'", "E208", "the symbol foo,"),
        ("/x/m.so: failed to map segment from shared object", "E210", "noexec"),
        ("Could not find module 'm.dll' (or one of its dependencies)", "E208", "is missing"),
        ("/x/m.so: cannot allocate memory in static TLS block", "E208", "m.so: cannot allocate memory in static TLS"),
    ],
)
def test_what_loaders_say_becomes_a_sentence(text: str, code: str, what: str) -> None:
    error = library.refused(text, Path("/x/m.so"), "x.fmu")
    assert error.code == code
    assert what in str(error)
    assert str(error).isprintable()


def test_an_fmu_that_can_be_there_once_is_there_once() -> None:
    with claimed("a" * 64, "x.fmu"):
        with pytest.raises(FMUError, match=r"E211 y.fmu: .*isolate"), claimed("a" * 64, "y.fmu"):
            pass
        with claimed("b" * 64, "z.fmu"):
            pass
    with claimed("a" * 64, "x.fmu"):
        pass


@ON_LINUX
def test_a_process_without_ldconfig_says_nothing_about_missing_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library._system_libraries.cache_clear()

    def none(*_: Any, **__: Any) -> Any:
        raise FileNotFoundError

    monkeypatch.setattr(library, "subprocess", SimpleNamespace(run=none, SubprocessError=subprocess.SubprocessError))
    assert library._is_known_here("libnowhere.so")
    library._system_libraries.cache_clear()
