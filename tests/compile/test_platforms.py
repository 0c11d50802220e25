"""Shared libraries for FMUs: what each platform's file is, shows and needs; equal bytes everywhere; the same numbers.

What a file holds is read here by the definitions of ELF, PE and Mach-O. Those for other platforms need ziglang.
"""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import blocks
from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain import compiler as driver
from blocks.compile.toolchain import platforms
from blocks.compile.toolchain.compiler import TranslationUnit, build, find_zig, load
from blocks.compile.toolchain.platforms import (
    INSTALL,
    PLATFORMS,
    compiler_for,
    folder_of,
    folders,
    shared_library,
    suffix_of,
    this_platform,
    universal,
)
from blocks.engines.native import code
from blocks.engines.native import model as native_model
from blocks.text.errors import CompilerError, UsageError
from tests.support.places import ROOT

DIAGRAM = ROOT / "diagrams" / "paper" / "iadrc_sampled.json"
HERE = this_platform()
REAL = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
HAS_ZIG = find_zig() is not None

with_compiler = pytest.mark.skipif(REAL is None or os.name != "posix", reason="no C compiler")
with_zig = pytest.mark.skipif(not HAS_ZIG, reason="ziglang is not installed")
on_linux = pytest.mark.skipif(HERE != "x86_64-linux", reason="for x86_64-linux")
# The platforms whose files can be made here.
MADE = [
    pytest.param(name, marks=[with_compiler] if name == HERE else [with_zig, pytest.mark.long]) for name in PLATFORMS
]

# Visible: f. Hidden: `shifted` of another unit. libm: sin, hypot. Division of 128 bits: as in the runtime.
VISIBLE = """#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
"""
OTHER = '#include "given.h"\ndouble shifted(double a) { return a + ADDED; }\n'
UNITS = (
    TranslationUnit("other.c", OTHER, {"given.h": "#define ADDED 3\n"}),
    TranslationUnit(
        "model.c",
        "#include <math.h>\n#include <stdint.h>\n#include <stdlib.h>\n#include <string.h>\n"
        "double shifted(double a);\n"
        f"{VISIBLE}double f(double a)\n"
        "{\n"
        "    char *text = malloc(8);\n"
        "    strcpy(text, strrchr(__FILE__, 'm'));\n"
        "    double value = shifted(sin(a)) + hypot(a, 2.0) + text[0];\n"
        "    free(text);\n"
        "    return value;\n"
        "}\n"
        f"{VISIBLE}uint64_t divided(uint64_t high, uint64_t low, uint64_t by, int what)\n"
        "{\n"
        "    unsigned __int128 n = ((unsigned __int128)high << 64) | low, d = (unsigned __int128)by << 3;\n"
        "    unsigned __int128 made = what & 1 ? n % d : n / d;\n"
        "    return (uint64_t)(what & 2 ? made >> 64 : made);\n"
        "}\n",
    ),
)  # fmt: skip
SHOWN = {"f", "divided"}
# A function that no C library has.
INCOMPLETE = (
    TranslationUnit("model.c", f"double nowhere(double a);\n{VISIBLE}double f(double a) {{ return nowhere(a); }}\n"),
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache of the test's own; but zig keeps what it makes of each platform's C library, which takes minutes."""
    kept = os.environ.get("ZIG_GLOBAL_CACHE_DIR") or str(caches.of_user().folder / "zig")
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", kept)
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(caches, "_refused", {})
    driver._found.cache_clear()
    yield tmp_path / "cache"
    driver._found.cache_clear()


def texts_of_a_diagram(monkeypatch: pytest.MonkeyPatch, path: Path = DIAGRAM) -> tuple[TranslationUnit, ...]:
    """The runtime and an emitted model."""
    seen: list[tuple[TranslationUnit, ...]] = []

    def watched(units: Sequence[TranslationUnit], **options: Any) -> Path:
        seen.append(tuple(units))
        return build(units, **options)

    monkeypatch.setattr(native_model, "_MODELS", {})
    monkeypatch.setattr(code, "QUICKLY", False)
    monkeypatch.setattr(code, "build", watched)
    blocks.Diagram.load(path).run(engine="native", stop=0.05)
    monkeypatch.setattr(code, "build", build)
    return seen[0]


# --- names -----------------------------------------------------------------------------------------------------


def test_folders_are_those_of_fmi_3_and_of_fmi_2() -> None:
    assert list(PLATFORMS) == ["x86_64-linux", "aarch64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin"]
    assert [folder_of(name, 3) for name in PLATFORMS] == list(PLATFORMS)
    of_fmi2 = ["linux64", "aarch64-linux", "win64", "darwin64", "aarch64-darwin"]
    assert [folder_of(name, 2) for name in PLATFORMS] == of_fmi2
    assert [suffix_of(name) for name in PLATFORMS] == [".so", ".so", ".dll", ".dylib", ".dylib"]


def test_this_platform_is_named_as_fmpy_names_it() -> None:
    import fmpy

    assert this_platform() == fmpy.platform_tuple
    if this_platform().startswith("x86"):
        assert folder_of(this_platform(), 2) == fmpy.platform
    assert suffix_of(this_platform()) == fmpy.sharedLibraryExtension


@pytest.mark.parametrize(
    ("machine", "system", "bits", "name", "fmi2"),
    [
        ("AMD64", "win32", 64, "x86_64-windows", "win64"),
        ("AMD64", "win32", 32, "x86-windows", "win32"),
        ("arm64", "darwin", 64, "aarch64-darwin", "aarch64-darwin"),
        ("x86_64", "darwin", 64, "x86_64-darwin", "darwin64"),
        ("aarch64", "linux", 64, "aarch64-linux", "aarch64-linux"),
        ("riscv64", "linux", 64, "riscv64-linux", "riscv64-linux"),
        ("i686", "linux", 32, "x86-linux", "linux32"),
    ],
)
def test_other_machines_are_named_as_fmi_3_does(
    machine: str, system: str, bits: int, name: str, fmi2: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(struct, "calcsize", lambda _: bits // 8)
    assert this_platform() == name
    assert folder_of(name, 3) == name
    assert folder_of(name, 2) == fmi2


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("win64", "Did you mean 'x86_64-windows'?"),
        ("macos", "Did you mean 'aarch64-darwin'?"),
        ("x86-64-linux", "Did you mean 'x86_64-linux'?"),
        ("aarch64_darwin", "Did you mean 'aarch64-darwin'?"),
        ("solaris", "Platforms: x86_64-linux, aarch64-linux, "),
    ],
)
def test_a_name_that_is_no_platform_is_refused_with_the_one_that_is_meant(name: str, hint: str) -> None:
    for asked in (lambda: shared_library(name, UNITS), lambda: folder_of(name, 2), lambda: suffix_of(name)):
        with pytest.raises(UsageError) as caught:
            asked()
        assert caught.value.code == "E501"
        assert f"{name!r} is not a platform. {hint}" in str(caught.value)


def test_in_fmi_2_a_mac_of_either_kind_finds_its_code_where_it_looks() -> None:
    def placed(libraries: Mapping[str, bytes], fmi: int) -> dict[str, bytes]:
        made = list(folders(libraries, fmi))
        assert all(suffix == (".dylib" if "darwin" in folder else ".so") for folder, suffix, _ in made)
        return {folder: data for folder, _, data in made}

    intel, arm = macho(0x01000007, b"intel"), macho(0x0100000C, b"arm")
    both = {"x86_64-darwin": intel, "aarch64-darwin": arm}
    assert placed(both, 3) == both
    assert placed(both, 2) == {"darwin64": universal([intel, arm]), "aarch64-darwin": arm}
    assert placed({"aarch64-darwin": arm}, 2) == {"darwin64": arm, "aarch64-darwin": arm}
    assert placed({"x86_64-linux": b"x", "aarch64-linux": b"a"}, 2) == {"linux64": b"x", "aarch64-linux": b"a"}
    assert placed({"aarch64-linux": b"a"}, 2) == {"linux64": b"a", "aarch64-linux": b"a"}


def macho(cpu: int, more: bytes = b"") -> bytes:
    return struct.pack("<IIIIIIII", 0xFEEDFACF, cpu, 0, 6, 0, 0, 0, 0) + more


def test_a_universal_binary_holds_each_library_at_a_page_of_its_machine(tmp_path: Path) -> None:
    arm, intel = macho(0x0100000C, b"of arm"), macho(0x01000007, b"of intel")
    data = universal([arm, intel])
    assert struct.unpack_from(">II", data) == (0xCAFEBABE, 2)
    found = [struct.unpack_from(">IIIII", data, 8 + 20 * i) for i in range(2)]
    assert [(cpu, page) for cpu, _, _, _, page in found] == [(0x01000007, 12), (0x0100000C, 14)]
    assert all(offset % (1 << page) == 0 for _, _, offset, _, page in found)
    assert [data[offset : offset + size] for _, _, offset, size, _ in found] == [intel, arm]
    lipo = shutil.which("llvm-lipo")
    if lipo:
        (tmp_path / "both.dylib").write_bytes(data)
        done = subprocess.run([lipo, "-archs", tmp_path / "both.dylib"], capture_output=True, text=True)
        assert done.stdout.split() == ["x86_64", "arm64"], done.stderr
    for wrong in ([arm, arm], [b"\x7fELF" + bytes(60)]):
        with pytest.raises(ValueError, match=r"not a library|same architecture"):
            universal(wrong)


# --- compilers -------------------------------------------------------------------------------------------------


def test_without_a_compiler_for_a_platform_the_error_names_it_and_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platforms, "find_zig", lambda: None)
    for name in set(PLATFORMS) - {HERE}:
        with pytest.raises(CompilerError) as caught:
            shared_library(name, UNITS)
        assert caught.value.code == "E605"
        assert str(caught.value).startswith(f"E605 {name}: ")
        assert str(caught.value).endswith(f"Install it: {INSTALL}.")
    monkeypatch.setattr(platforms, "find_compiler", lambda: None)
    with pytest.raises(CompilerError, match="no C compiler was found") as caught:
        shared_library(HERE, UNITS)
    assert caught.value.code == "E605"


@with_compiler
def test_this_platform_s_library_is_of_the_compiler_and_the_flags_of_a_native_run() -> None:
    own, exporting = driver.find_compiler(), compiler_for(HERE)
    assert own is not None
    assert exporting.command == own.command
    assert exporting.compile_flags == own.compile_flags
    assert set(own.link_flags) < set(exporting.link_flags)


def test_where_zig_is_all_there_is_it_also_makes_this_platform_s(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(platforms, "find_compiler", lambda: None)
    zig = driver.Compiler(("/somewhere/zig", "cc"), "ziglang", "clang version 20", "", (), (), ())
    monkeypatch.setattr(platforms, "find_zig", lambda: zig)
    for name, made in PLATFORMS.items():
        compiler = compiler_for(name)
        assert compiler.suffix == made.suffix
        for flags in (compiler.compile_flags, compiler.link_flags):
            assert ("-target", made.target) in itertools.pairwise(flags)
            assert "-mcpu=baseline" in flags
        assert {"-O2", "-g0", "-ffp-contract=off", "-fvisibility=hidden"} < set(compiler.compile_flags)
    if HERE in PLATFORMS:
        assert compiler_for(HERE).command == zig.command


@with_compiler
@on_linux
def test_what_a_library_lacks_is_told_when_it_is_made_and_not_where_it_is_loaded() -> None:
    with pytest.raises(CompilerError, match="nowhere") as caught:
        shared_library(HERE, INCOMPLETE)
    assert caught.value.code == "E602"
    assert caught.value.faults[0].place == HERE
    assert "reference engine" not in str(caught.value)


@with_zig
@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in PLATFORMS if name != HERE])
def test_what_another_platform_s_library_lacks_is_told_when_it_is_made(name: str) -> None:
    with pytest.raises(CompilerError, match="nowhere") as caught:
        shared_library(name, INCOMPLETE)
    assert (caught.value.code, caught.value.faults[0].place) == ("E602", name)


# --- files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MADE)
def test_a_library_shows_what_is_marked_and_needs_the_c_library_alone(name: str) -> None:
    made = read(shared_library(name, UNITS))
    system = PLATFORMS[name].system
    assert made.machine == name.partition("-")[0]
    shown = made.exports - ({"___dso_handle", "__mh_dylib_header"} if system == "darwin" else set())
    assert shown == ({f"_{one}" for one in SHOWN} if system == "darwin" else SHOWN)
    allowed = {
        "linux": r"libc\.so\.6|libm\.so\.6|ld-linux-.*",
        "windows": r"KERNEL32\.dll|api-ms-win-crt-\w+-l1-1-0\.dll|msvcrt\.dll|ucrtbase\.dll",
        "darwin": r"/usr/lib/libSystem\.B\.dylib",
    }
    assert made.needs
    assert [one for one in made.needs if not re.fullmatch(allowed[system], one)] == []
    assert made.is_stripped
    assert made.time == 0
    if name != HERE and system == "linux":
        assert made.versions
        assert max(made.versions) <= (2, 17)
        assert {"sin", "hypot"} <= made.imports  # those of libm, not copies of zig's
    if system == "darwin":
        assert made.oldest == (11, 0)


@pytest.mark.parametrize("name", MADE)
def test_a_library_is_the_same_to_the_byte_from_any_folder_and_cache(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    for user in ("ada", "a folder with a much longer name"):
        place = tmp_path / user
        (place / "tmp").mkdir(parents=True)
        monkeypatch.setenv(caches.VARIABLE, str(place / "cache"))
        monkeypatch.setenv("TMPDIR", str(place / "tmp"))
        monkeypatch.setenv("USER", user)
        monkeypatch.setenv("SOURCE_DATE_EPOCH", str(len(user)))
        monkeypatch.chdir(place)
        made.append(shared_library(name, UNITS))
    assert made[0] == made[1]
    places = [
        tmp_path,
        ROOT,
        Path.home(),
        Path(sys.prefix),
        *(Path(one).parent for one in compiler_for(name).command[:1]),
    ]
    named = [str(one) for one in places if len(str(one)) > len("/usr/bin")]
    assert [one for one in (*named, "ziglang", "site-packages", "tmp-") if one.encode() in made[0]] == []


@pytest.mark.parametrize("name", MADE)
def test_a_library_that_was_made_is_taken_from_the_cache(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_process(*_: object, **__: object) -> None:
        raise AssertionError("a process was started")

    made = shared_library(name, UNITS)
    monkeypatch.setattr(subprocess, "Popen", no_process)
    assert shared_library(name, UNITS) == made


@pytest.mark.parametrize("name", MADE)
def test_the_runtime_and_an_emitted_model_compile_without_warnings(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if REAL is None:
        pytest.skip("no C compiler")
    units = texts_of_a_diagram(monkeypatch)
    wide = TranslationUnit("int128.c", (ROOT / "blocks/compile/toolchain/int128.c").read_text(encoding="utf-8"))
    strict = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-Wno-unused-command-line-argument"]
    compiler = compiler_for(name)
    more = [wide] if "-rtlib=none" in compiler.link_flags else []
    data = build([*units, *more], compiler=compiler, extra_flags=strict).read_bytes()
    shown = {one.removeprefix("_") for one in read(data).exports}
    assert {"blocks_model", "blocks_new", "blocks_advance"} <= shown
    assert shared_library(name, units)


@with_compiler
@on_linux
def test_inside_a_library_that_shows_other_functions_the_runtime_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    units = [
        TranslationUnit(unit.name, "#define BLOCKS_INSIDE 1\n" + unit.text, unit.headers)
        for unit in texts_of_a_diagram(monkeypatch)
    ]
    assert read(shared_library(HERE, [*units, *UNITS[:1]])).exports == set()


# --- numbers ---------------------------------------------------------------------------------------------------


def loaded(data: bytes, path: Path) -> ctypes.CDLL:
    path.write_bytes(data)
    return load(path)


def by_zig(monkeypatch: pytest.MonkeyPatch, units: Sequence[TranslationUnit]) -> bytes:
    """This platform's library by zig, also where another compiler is there."""
    monkeypatch.setattr(platforms, "find_compiler", lambda: None)
    try:
        return shared_library(HERE, units)
    finally:
        monkeypatch.setattr(platforms, "find_compiler", driver.find_compiler)


def check_numbers(library: ctypes.CDLL) -> None:
    f = library.f
    f.restype, f.argtypes = ctypes.c_double, [ctypes.c_double]
    for a in (0.0, 0.5, -2.0, 1e6):
        assert f(a) == math.sin(a) + 3 + math.hypot(a, 2.0) + ord("m")
    divided = library.divided
    divided.restype, divided.argtypes = ctypes.c_uint64, [*[ctypes.c_uint64] * 3, ctypes.c_int]
    random = np.random.default_rng(1)
    for _ in range(2000):
        high, low, by = (int(random.integers(0, 2**64, dtype=np.uint64)) >> int(random.integers(0, 64)) for _ in "nnd")
        n, d = (high << 64) | low, max(by, 1) << 3
        for what, expected in enumerate((n // d, n % d)):
            made = divided(high, low, max(by, 1), what) | divided(high, low, max(by, 1), what | 2) << 64
            assert made == expected, (n, d)


@with_compiler
@on_linux
def test_this_platform_s_library_computes(tmp_path: Path) -> None:
    check_numbers(loaded(shared_library(HERE, UNITS), tmp_path / "own.so"))


@with_zig
@on_linux
def test_zig_s_library_for_this_platform_computes_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = by_zig(monkeypatch, UNITS)
    assert max(read(data).versions) <= (2, 17)
    check_numbers(loaded(data, tmp_path / "zig.so"))


@with_compiler
@with_zig
@on_linux
@pytest.mark.parametrize("path", ["paper/iadrc_sampled.json", "bouncing_ball.json", "motor_pid.json"])
def test_a_run_of_zig_s_code_is_one_of_the_native_engine_to_the_last_bit(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(make: Any) -> Mapping[str, Any]:
        monkeypatch.setattr(native_model, "_MODELS", {})
        monkeypatch.setattr(code, "QUICKLY", False)
        monkeypatch.setattr(code, "build", make)
        results = blocks.Diagram.load(ROOT / "diagrams" / path).run(engine="native", stop=2.0)
        return {"t": results.t, **{name: results[name] for name in results}}

    def made(units: Sequence[TranslationUnit], **_: Any) -> Path:
        place = tmp_path / "zig.so"
        place.write_bytes(by_zig(monkeypatch, units))
        return place

    expected, found = run(build), run(made)
    assert (tmp_path / "zig.so").exists()
    assert expected.keys() == found.keys()
    assert len(expected["t"]) > 100
    for name, values in expected.items():
        assert np.array_equal(values, found[name], equal_nan=True), name


# --- readers ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class File:
    """What a shared library says of itself. versions: of glibc. oldest: of macOS. time: of making, 0 for none."""

    machine: str
    exports: set[str]
    imports: set[str]
    needs: set[str]
    is_stripped: bool
    time: int = 0
    versions: frozenset[tuple[int, ...]] = frozenset()
    oldest: tuple[int, int] = (0, 0)


def read(data: bytes) -> File:
    readers = {b"\x7fELF": read_elf, b"MZ": read_pe, b"\xcf\xfa\xed\xfe": read_macho}
    return next(reader for magic, reader in readers.items() if data.startswith(magic))(data)


def text_at(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()


def read_elf(data: bytes) -> File:
    """System V ABI, chapters 4 and 5; symbol versions by the Linux Standard Base, 10.7."""
    assert data[4:6] == b"\2\1"
    machine = {62: "x86_64", 183: "aarch64"}[struct.unpack_from("<H", data, 18)[0]]
    (at,), (width, count) = struct.unpack_from("<Q", data, 40), struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQII", data, at + width * i) for i in range(count)]
    assert all(offset + size <= len(data) for _, kind, _, _, offset, size, _, _ in sections if kind != 8)
    exports, imports, needs, versions = set(), set(), set(), set()
    for _, kind, _, _, offset, size, link, _ in sections:
        names = sections[link][4] if link < count else 0
        if kind == 6:  # dynamic
            for tag, value in struct.iter_unpack("<QQ", data[offset : offset + size]):
                assert tag not in (15, 29), "a path where libraries are looked for"
                if tag == 1:
                    needs.add(text_at(data, names + value))
        elif kind == 11:  # dynamic symbols
            for name, mark, _, section, _, _ in struct.iter_unpack("<IBBHQQ", data[offset : offset + size]):
                if name and mark >> 4 == 1:
                    (exports if section else imports).add(text_at(data, names + name))
        elif kind == 0x6FFFFFFE:  # needed versions
            place = offset
            while True:
                _, n, _, first, step = struct.unpack_from("<HHIII", data, place)
                inner = place + first
                for _ in range(n):
                    _, _, _, name, more = struct.unpack_from("<IHHII", data, inner)
                    assert text_at(data, names + name).startswith("GLIBC_")
                    versions.add(tuple(map(int, text_at(data, names + name)[6:].split("."))))
                    inner += more
                if not step:
                    break
                place += step
    kinds = {kind for _, kind, *_ in sections}
    return File(machine, exports, imports, needs, not kinds & {2, 7}, versions=frozenset(versions))  # no symbols, notes


def read_pe(data: bytes) -> File:
    """PE Format, Microsoft."""
    (at,) = struct.unpack_from("<I", data, 60)
    assert data[at : at + 4] == b"PE\0\0"
    machine, count, time, symbols, _, size, kind = struct.unpack_from("<HHIIIHH", data, at + 4)
    assert machine == 0x8664
    assert kind & 0x2000  # a DLL
    head = at + 24
    assert struct.unpack_from("<H", data, head)[0] == 0x20B
    parts = [struct.unpack_from("<IIII", data, head + size + 40 * i + 8) for i in range(count)]

    def place(address: int) -> int:
        return next(offset + address - start for extent, start, _, offset in parts if start <= address < start + extent)

    def directory(i: int) -> int:
        (address,) = struct.unpack_from("<I", data, head + 112 + 8 * i)
        return place(address) if address else 0

    table = directory(0)
    stamp, n, names = (struct.unpack_from("<I", data, table + shift)[0] for shift in (4, 24, 32))
    exports = {text_at(data, place(one)) for one in struct.unpack_from(f"<{n}I", data, place(names))}
    imports, needs = set(), set()
    row = directory(1)
    while (entry := struct.unpack_from("<IIIII", data, row))[3]:
        needs.add(text_at(data, place(entry[3])))
        thunk = place(entry[0])
        while (address := struct.unpack_from("<Q", data, thunk)[0]) != 0:
            imports.add(text_at(data, place(address) + 2))
            thunk += 8
        row += 20
    return File("x86_64", exports, imports, needs, symbols == 0 and not directory(6), time=time | stamp)


def read_macho(data: bytes) -> File:
    """<mach-o/loader.h>, Apple."""
    _, cpu, _, kind, count, _, _, _ = struct.unpack_from("<8I", data)
    assert kind == 6  # a dynamic library
    exports, imports, needs, locals_, oldest = set(), set(), set(), set(), (0, 0)
    commands, at = set(), 32
    for _ in range(count):
        command, size = struct.unpack_from("<II", data, at)
        commands.add(command)
        if command == 0x0C:
            needs.add(text_at(data, at + struct.unpack_from("<I", data, at + 8)[0]))
        elif command == 0x02:
            symbols, n, texts, _ = struct.unpack_from("<IIII", data, at + 8)
            for name, mark, _, _, _ in struct.iter_unpack("<IBBHQ", data[symbols : symbols + 16 * n]):
                found = exports if mark & 0x0E else imports
                (found if mark & 1 and not mark & 0x10 else locals_).add(text_at(data, texts + name))
        elif command == 0x32:
            (version,) = struct.unpack_from("<I", data, at + 12)
            oldest = version >> 16, version >> 8 & 0xFF
        elif command == 0x0D:
            assert "/" not in text_at(data, at + struct.unpack_from("<I", data, at + 8)[0])
        at += size
    assert 0x1B in commands, "the loader of macOS wants a UUID"
    machine = {0x01000007: "x86_64", 0x0100000C: "aarch64"}[cpu]
    assert machine == "x86_64" or 0x1D in commands, "Apple silicon wants a signature"
    is_stripped = not {name for name in locals_ if not name.endswith("__thunk")}
    return File(machine, exports, imports, needs, is_stripped, oldest=oldest)
