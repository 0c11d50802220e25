"""The compiler driver and the cache: what is compiled again and what is not, who may share it, and what goes wrong."""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import platform
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from blocks.compile.c.runtime_texts import packaged
from blocks.compile.toolchain import cache as caches
from blocks.compile.toolchain import compiler as driver
from blocks.compile.toolchain.cache import Cache
from blocks.compile.toolchain.compiler import Compiler, TranslationUnit, build, find_compiler, load
from blocks.text.errors import CompilerError
from blocks.text.explanations import EXPLAINED
from tests.support.places import ROOT
from tests.support.processes import lives

REAL = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
POSIX = os.name == "posix"

pytestmark = pytest.mark.skipif(REAL is None or not POSIX, reason="no C compiler")

VISIBLE = '__attribute__((visibility("default"))) '


def runtime(add: int = 3) -> TranslationUnit:
    text = '#include "given.h"\ndouble shifted(double a) { return a + ADDED; }\n'
    return TranslationUnit("runtime.c", text, {"given.h": f"#define ADDED {add}\n"}, is_shared=True)


def model(factor: float = 2.0) -> TranslationUnit:
    text = f"#include <math.h>\ndouble shifted(double a);\n{VISIBLE}double f(double a)\n"
    return TranslationUnit("model.c", text + f"{{ return shifted(sin(a) * {factor!r}); }}\n")


def value(path: Path, a: float) -> float:
    f = load(path).f
    f.restype, f.argtypes = ctypes.c_double, [ctypes.c_double]
    return float(f(a))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache of the test's own, and nothing remembered from before."""
    monkeypatch.setenv(caches.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(caches, "_refused", {})
    driver._found.cache_clear()
    yield tmp_path / "cache"
    driver._found.cache_clear()


@pytest.fixture
def logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """$CC is a compiler that writes a line for each time it is run."""
    log = tmp_path / "log"
    script(tmp_path / "cc", f'echo "$@" >> {log}\nexec {REAL} "$@"', monkeypatch)
    log.touch()
    return log


def script(path: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))


def lines(log: Path) -> list[str]:
    """The commands since the last call."""
    made = log.read_text(encoding="utf-8").splitlines()
    log.write_text("", encoding="utf-8")
    return made


def no_process(*_: object, **__: object) -> None:
    raise AssertionError("a process was started")


# --- building --------------------------------------------------------------------------------------------------


def test_two_units_become_one_library_that_computes() -> None:
    path = build([runtime(), model()])
    for a in (0.0, 0.5, -2.0):
        assert value(path, a) == math.sin(a) * 2.0 + 3
    assert load(path) is load(path)


def test_what_is_in_the_cache_starts_no_process_also_in_a_new_one(logged: Path) -> None:
    path = build([runtime(), model()])
    assert lines(logged)
    code = (
        "import subprocess\n"
        "from tests.compile import test_compiler as t\n"
        "subprocess.Popen = t.no_process\n"
        "path = t.build([t.runtime(), t.model()]); print(path); print(t.value(path, 0.5))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.split() == [str(path), repr(math.sin(0.5) * 2 + 3)], done.stderr
    assert lines(logged) == []


def test_a_shared_unit_is_compiled_once_for_all_models(logged: Path) -> None:
    def compiled() -> list[str]:
        return sorted(line.split(" -c ")[1].split()[0] for line in lines(logged) if " -c " in line)

    build([runtime(), model(2.0)])
    assert compiled() == ["0/runtime.c", "1/model.c"]
    path = build([runtime(), model(5.0)])
    assert compiled() == ["1/model.c"]
    assert value(path, 0.5) == math.sin(0.5) * 5.0 + 3
    path = build([runtime(4), model(5.0)])  # only a header of it differs
    assert compiled() == ["0/runtime.c", "1/model.c"]
    assert value(path, 0.5) == math.sin(0.5) * 5.0 + 4


def test_units_are_compiled_at_the_same_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each waits for the other one to have begun; one after the other they would wait in vain.
    meet = tmp_path / "meet"
    meet.mkdir()
    wait = (
        f'case "$*" in *" -c "*) touch {meet}/$$; n=0\n'
        f"while [ $(ls {meet} | wc -l) -lt 2 ]; do n=$((n+1)); [ $n -gt 400 ] && exit 7; sleep 0.05; done;; esac\n"
    )
    script(tmp_path / "cc", f'{wait}exec {REAL} "$@"', monkeypatch)
    assert value(build([runtime(), model()]), 0.0) == 3.0


def test_flags_text_name_compiler_and_surroundings_make_another_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    units = [runtime(), model()]
    plain = build(units)
    others = [build(units, extra_flags=["-O0"]), build([*units, TranslationUnit("more.c", "int more;\n")])]
    script(tmp_path / "cc", f'exec {REAL} "$@"', monkeypatch)
    others.append(build(units))
    script(tmp_path / "cc", f'exec {REAL}  "$@"', monkeypatch)  # the same path, another program
    driver._found.cache_clear()
    others.append(build(units))
    monkeypatch.setenv("CPATH", str(tmp_path))
    others.append(build(units))
    assert len({plain, *others}) == 1 + len(others)
    assert build(units) == others[-1]


def test_where_one_text_ends_belongs_to_the_key() -> None:
    assert driver._digest(["ab", "c"]) != driver._digest(["a", "bc"])
    assert driver._digest(["1:a"]) != driver._digest(["", "a"])


def test_flags_keep_sums_and_products_apart_and_names_hidden() -> None:
    # a*a - b with one rounding is 2^-60 here; with two it is 0. On x86 the compiler must be told that it may.
    text = f"int hidden(void) {{ return 1; }}\n{VISIBLE}double f(double a) {{ return a * a - (1.0 + 0x1p-29); }}\n"
    fused = ["-mfma"] if platform.machine() == "x86_64" and " fma " in Path("/proc/cpuinfo").read_text() else []
    compiler = find_compiler()
    assert compiler is not None
    assert "-ffp-contract=off" in compiler.compile_flags
    assert not {"-ffast-math", "-Ofast"} & set(compiler.compile_flags)
    path = build([TranslationUnit("model.c", text)], extra_flags=fused)
    assert value(path, 1.0 + 2.0**-30) == 0.0
    if fused:
        assert (
            value(build([TranslationUnit("model.c", text)], extra_flags=[*fused, "-ffp-contract=fast"]), 1.0 + 2.0**-30)
            == 2.0**-60
        )
    with pytest.raises(CompilerError, match=r"E603 .*lacks the function hidden"):
        _ = load(path).hidden


@pytest.mark.parametrize("name", ["../model.c", "/tmp/x.c", "a b.c", "-o.c", "x;y.c", "", "a//b.c", "a/../b.c"])
def test_a_name_that_is_no_plain_file_name_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="not the name of a file"):
        TranslationUnit(name, "")
    with pytest.raises(ValueError, match="not the name of a file"):
        TranslationUnit("model.c", "", {name: ""})
    with pytest.raises(ValueError, match="not the name of a C file"):
        TranslationUnit("model.h", "")


def test_a_sanitizer_finds_what_is_undefined(tmp_path: Path) -> None:
    text = f"#include <limits.h>\n{VISIBLE}double f(double a) {{ int i = INT_MAX; return i + (int)a; }}\n"
    try:
        path = build([TranslationUnit("model.c", text)], extra_flags=["-fsanitize=undefined"])
    except CompilerError as error:
        pytest.skip(f"no sanitizer: {error}")
    code = "import sys; from tests.compile import test_compiler as t; t.value(t.Path(sys.argv[1]), 1.0)"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=ROOT)
    assert "signed integer overflow" in done.stderr
    assert build([TranslationUnit("model.c", text)]) != path


def test_the_package_s_own_c_texts_are_read_by_name() -> None:
    text = (ROOT / "blocks/compile/c/runtime/model.h").read_text(encoding="utf-8")
    assert packaged("model.h") == {"model.h": text}


# --- the compiler ----------------------------------------------------------------------------------------------


def test_cc_may_hold_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", f"{REAL} -DADDED=7")
    text = f"{VISIBLE}double f(double a) {{ return a + ADDED; }}\n"
    assert value(build([TranslationUnit("model.c", text)]), 1.0) == 8.0
    compiler = find_compiler()
    assert compiler is not None
    assert (compiler.origin, compiler.command[1:]) == ("$CC", ("-DADDED=7",))


def test_cc_may_be_a_path_with_a_space_or_lie_below_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "my tools"
    place.mkdir()
    script(place / "cc", f'exec {REAL} "$@"', monkeypatch)
    assert value(build([runtime(), model()]), 0.0) == 3.0
    monkeypatch.chdir(place)
    monkeypatch.setenv("CC", "sh ./cc")
    assert value(build([runtime(), model(4.0)]), 0.0) == 3.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("no-such-compiler -O1", "'no-such-compiler -O1': there is no such program."),
        ("false", "'false' does not work: --version ended with 1."),
        ("cc 'open", "cannot be read: No closing quotation."),
    ],
)
def test_a_cc_that_does_not_work_is_an_error(text: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", text)
    for _ in range(2):
        with pytest.raises(CompilerError) as caught:
            find_compiler()
        assert caught.value.code == "E601"
        assert caught.value.faults[0].place == "$CC"
        assert says in str(caught.value)
    assert caught.value.exit_status == 2


def test_a_cc_that_answers_and_compiles_nothing_is_told_apart_from_bad_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    body = 'case "$1" in --version) echo mine 1.0;; *) echo cannot find cc1 >&2; exit 3;; esac'
    script(tmp_path / "cc", body, monkeypatch)
    with pytest.raises(CompilerError, match="cannot find cc1") as caught:
        build([runtime(), model()])
    assert caught.value.code == "E601"
    monkeypatch.setenv("CC", "true")  # it ends well and makes nothing
    with pytest.raises(CompilerError, match="printed nothing") as caught:
        build([runtime(), model()])
    assert caught.value.code == "E601"


def test_bad_code_is_told_with_the_messages_and_kept(folder: Path) -> None:
    with pytest.raises(CompilerError) as caught:
        build([runtime(), TranslationUnit("model.c", "int f(void) { return wrong_name; }\n" + "int g = ;\n" * 2000)])
    assert caught.value.code == "E602"
    text = str(caught.value)
    assert "wrong_name" in text
    assert text.splitlines()[-1] == "--engine reference runs the diagram without a compiler."
    assert len(text) < 3000
    (kept,) = folder.glob("failed-*")
    assert str(kept) in text
    assert "wrong_name" in (kept / "1" / "model.c").read_text(encoding="utf-8")
    assert not list(folder.glob("tmp-*"))
    assert caches.size().entries == 1


def test_without_any_compiler_there_is_a_reason_and_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(driver, "PACKAGES", ())
    assert find_compiler() is None
    with pytest.raises(CompilerError, match="no C compiler was found") as caught:
        build([model()])
    assert caught.value.code == "E605"


def test_a_cc_on_the_path_that_is_broken_is_passed_over(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script(tmp_path / "cc", "exit 1", monkeypatch)
    script(tmp_path / "clang", f'exec {REAL} "$@"', monkeypatch)
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    compiler = find_compiler()
    assert compiler is not None
    assert compiler.origin == "clang"


def test_a_package_s_compiler_is_the_last_resort(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    place = tmp_path / "packages" / "ziglang"
    place.mkdir(parents=True)
    (place / "__init__.py").touch()
    # Not a real zig: it hands over what gcc understands as well.
    body = f'shift; for a; do shift; case "$a" in -mcpu=*) ;; *) set -- "$@" "$a";; esac; done; exec {REAL} "$@"'
    script(place / "zig", body, monkeypatch)
    monkeypatch.delenv("CC")
    monkeypatch.syspath_prepend(str(place.parent))
    monkeypatch.setattr(driver, "NAMES", ())
    compiler = find_compiler()
    assert compiler is not None
    assert compiler.command == (str(place / "zig"), "cc")
    assert "-mcpu=baseline" in compiler.compile_flags
    assert "-mcpu=baseline" in compiler.link_flags
    assert value(build([runtime(), model(6.0)]), 0.5) == math.sin(0.5) * 6.0 + 3


def test_the_version_is_asked_once_and_again_when_the_program_changes(logged: Path) -> None:
    first = find_compiler()
    assert sum(line == "--version" for line in lines(logged)) == 1
    driver._found.cache_clear()  # as in another process
    assert find_compiler() == first
    assert lines(logged) == []
    place = logged.parent / "cc"
    os.utime(place, ns=(1, 1))
    driver._found.cache_clear()
    second = find_compiler()
    assert sum(line == "--version" for line in lines(logged)) == 1
    assert first is not None
    assert second is not None
    assert first.version == second.version != ""
    assert first.identity != second.identity


# --- the cache -------------------------------------------------------------------------------------------------


def test_the_folder_is_private_and_where_the_environment_says(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = build([runtime(), model()])
    assert path.parent.parent == folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    monkeypatch.delenv(caches.VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert caches.of_user().folder == tmp_path / "xdg" / "blocks" / "native"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    assert caches.of_user().folder == tmp_path / "home" / ".cache" / "blocks" / "native"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert caches.of_user().folder == tmp_path / "home" / "Library" / "Caches" / "blocks" / "native"


@pytest.mark.parametrize("mode", [0o777, 0o720, 0o702])
def test_code_from_a_folder_that_others_may_write_to_is_not_loaded(mode: int, folder: Path) -> None:
    path = build([runtime(), model()])
    folder.chmod(mode)
    place = caches.of_user()
    assert place.is_temporary
    assert "other users" in place.reason
    made = build([runtime(), model()])
    assert made != path
    assert made.parent.parent == place.folder
    assert stat.S_IMODE(place.folder.stat().st_mode) == 0o700
    folder.chmod(0o700)
    assert build([runtime(), model()]) == path


def test_a_folder_of_another_user_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir(mode=0o700)
    other = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: other)
    assert "belongs to another user" in caches.of_user().reason


def test_a_temporary_folder_goes_with_its_process_and_not_with_a_forked_child(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    code = (
        "import os, sys\n"
        "from blocks.compile.toolchain import cache\n"
        "place = cache.of_user(); print(place.folder, place.is_temporary, flush=True)\n"
        "child = os.fork()\n"
        "if not child: sys.exit(0)\n"
        "os.waitpid(child, 0); print(place.folder.is_dir())"
    )
    surroundings = {**os.environ, caches.VARIABLE: str(tmp_path / "file" / "cache")}  # cannot be made
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=surroundings)
    place, is_temporary, still_there = done.stdout.split()
    assert (is_temporary, still_there) == ("True", "True")
    assert not Path(place).exists()


@pytest.mark.parametrize("damage", ["truncated", "changed", "no check", "odd check", "no library", "empty"])
def test_a_damaged_entry_is_made_again(
    damage: str, folder: Path, logged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = build([runtime(), model()])
    whole = path.read_bytes()
    check = path.parent / "check"
    if damage == "truncated":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "changed":
        path.write_bytes(whole[:200] + bytes([whole[200] ^ 1]) + whole[201:])
        os.utime(path, ns=(2, 2))
    elif damage == "no check":
        check.unlink()
    elif damage == "odd check":
        check.write_bytes(b"\xff\x00 what")
    elif damage == "no library":
        path.unlink()
    else:
        shutil.rmtree(path.parent)
        path.parent.mkdir()
    lines(logged)
    if damage in ("truncated", "changed"):
        monkeypatch.setattr(caches, "_whole", {})  # as another process finds it
    assert build([runtime(), model()]) == path
    assert sum(" -c " in line for line in lines(logged)) == 1
    assert hashlib.sha256(path.read_bytes()).hexdigest() == check.read_text(encoding="ascii").split()[0]
    assert not list(folder.glob("tmp-*"))
    assert value(path, 0.0) == 3.0


def test_a_library_that_cannot_be_loaded_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "library.so"
    path.write_bytes(b"no library")
    with pytest.raises(CompilerError) as caught:
        load(path)
    assert str(caught.value).startswith(f"E603 {path}: cannot be loaded: ")
    assert str(caught.value).count(str(path)) == 1
    assert "Empty the cache (`blocks doctor --clear-cache`), or set" in str(caught.value)


def test_a_folder_from_which_nothing_may_be_run_is_told_with_its_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: str) -> None:
        raise OSError(f"{path}: failed to map segment from shared object")

    monkeypatch.setattr(driver, "_Library", refused)
    with pytest.raises(CompilerError, match=r"E603 .*failed to map segment.*BLOCKS_CACHE_DIR.*noexec"):
        load(tmp_path / "library.so")


def test_processes_that_build_the_same_at_once_agree(folder: Path, tmp_path: Path) -> None:
    code = (
        "import sys, time\n"
        "from tests.compile import test_compiler as t\n"
        "while time.time() < float(sys.argv[1]): pass\n"
        "for k in range(3): path = t.build([t.runtime(), t.model(float(k))]); print(path, t.value(path, 0.5))"
    )
    begin = str(time.time() + 2.0)
    command = [sys.executable, "-c", code, begin]
    running = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) for _ in range(4)
    ]
    said = [process.communicate() for process in running]
    assert [err for _, err in said] == [""] * 4
    assert len({out for out, _ in said}) == 1
    values = [float(line.split()[1]) for line in said[0][0].splitlines()]
    assert values == [math.sin(0.5) * k + 3 for k in range(3)]
    assert caches.size().entries == 4  # three libraries and the object that they share
    assert not list(folder.glob("tmp-*"))


def entries(place: Cache, tmp_path: Path, count: int, length: int = 100) -> list[str]:
    """Entries 0, 1, ..., the first used longest ago."""
    file = tmp_path / "file.so"
    file.write_bytes(bytes(length))
    keys = [hashlib.sha256(b"%d" % i).hexdigest() for i in range(count)]
    now = time.time()
    for i, key in enumerate(keys):
        place.store(key, file)
        os.utime(place.folder / key, (now - 1000 + i, now - 1000 + i))
    return keys


def test_what_was_not_used_for_longest_goes_first(tmp_path: Path, folder: Path) -> None:
    folder.mkdir()
    keys = entries(Cache(folder), tmp_path, 6)
    place = Cache(folder, max_entries=4)
    assert place.find(keys[0]) is not None  # used now
    place.trim()
    assert [key for key in keys if (folder / key).exists()] == [keys[0], *keys[3:]]


def test_bytes_are_bounded_too_but_the_newest_stays(tmp_path: Path, folder: Path) -> None:
    folder.mkdir()
    keys = entries(Cache(folder), tmp_path, 5, length=10_000)
    assert Cache(folder).size().bytes == pytest.approx(5 * 10_000, rel=0.02)
    Cache(folder, max_bytes=25_000).trim()
    assert [key for key in keys if (folder / key).exists()] == keys[3:]
    (tmp_path / "file.so").write_bytes(bytes(30_000))
    key = "f" * 64
    Cache(folder).store(key, tmp_path / "file.so")
    Cache(folder, max_bytes=25_000).trim(keep=key)
    assert [path.name for path in folder.iterdir()] == [key]


def test_a_build_keeps_the_limits(folder: Path) -> None:
    folder.mkdir(mode=0o700)
    place = Cache(folder, max_entries=3)
    paths = [build([runtime(), model(float(k))], cache=place) for k in range(4)]
    assert place.size().entries == 3
    assert paths[-1].exists()
    assert not paths[0].exists()


def test_sizes_are_read_after_one_build_in_16(tmp_path: Path, folder: Path) -> None:
    folder.mkdir()
    keys = entries(Cache(folder), tmp_path, 5, length=10_000)
    place = Cache(folder, max_bytes=25_000)
    for digit in "123456789abcdef":
        place.make_room(digit * 64)
    assert all((folder / key).exists() for key in keys)
    place.make_room("0" * 64)
    assert [key for key in keys if (folder / key).exists()] == keys[3:]


def test_clearing_takes_entries_and_nothing_else(folder: Path) -> None:
    build([runtime(), model()])
    (folder / "letter.txt").write_text("mine", encoding="utf-8")
    (folder / "photos").mkdir()
    (folder / "tmp-12345678").mkdir()  # somebody is at work
    (folder / "tmp-abcdefgh").mkdir()
    os.utime(folder / "tmp-abcdefgh", (1, 1))  # left behind
    gone = caches.clear()
    assert gone.entries == 2
    assert gone.bytes > 1000
    assert caches.size() == caches.Size(0, 0)
    assert sorted(path.name for path in folder.iterdir()) == ["letter.txt", "photos", "tmp-12345678"]
    assert value(build([runtime(), model()]), 0.0) == 3.0


def test_a_cache_that_is_full_gives_way_to_a_temporary_folder(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = f'case "$PWD" in {folder}/*) echo "cc1: No space left on device" >&2; exit 1;; esac; exec {REAL} "$@"'
    script(tmp_path / "cc", body, monkeypatch)
    path = build([runtime(), model()])
    assert folder not in path.parents
    assert value(path, 0.0) == 3.0
    assert "cannot be written to" in caches.of_user().reason
    assert build([runtime(), model()]) == path


def test_a_disk_without_room_for_the_compiler_s_own_words_is_full_too(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler says nothing: what it is to say has no room either. Its folder stands for a full disk."""
    body = f'case "$PWD" in {folder}/*) ln -s /dev/full probe; exit 1;; esac; exec {REAL} "$@"'
    script(tmp_path / "cc", body, monkeypatch)
    path = build([runtime(), model()])
    assert folder not in path.parents
    assert value(path, 0.0) == 3.0
    assert caches.of_user().reason == f"{folder} cannot be written to: No space left on device"


@pytest.mark.parametrize("at", ["--version", "-c"])
def test_a_compiler_that_hangs_is_stopped_with_all_that_it_started(
    at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sleep that its shell started would keep the pipe of --version open, and live on."""
    pids = tmp_path / "pids"
    body = f'case "$*" in *{at}*) sleep 100 & echo $! >> {pids}; wait;; esac; exec {REAL} "$@"'
    script(tmp_path / "cc", body, monkeypatch)
    for limit in ("LIMIT", "TRIAL", "ANSWER"):
        monkeypatch.setattr(driver, limit, 0.5)
    begun = time.monotonic()
    with pytest.raises(CompilerError) as caught:
        build([runtime(), model()])
    assert time.monotonic() - begun < 60  # it sleeps for 100 s
    assert caught.value.code == "E601"
    said = "--version did not answer within 0.5 s" if at == "--version" else "it did not finish within 0.5 s"
    assert said in str(caught.value)
    end = time.monotonic() + 20.0  # what was killed ends in the kernel's own time
    while any(map(lives, map(int, pids.read_text().split()))) and time.monotonic() < end:
        time.sleep(0.01)
    assert not any(map(lives, map(int, pids.read_text().split())))


def test_a_compiler_that_hangs_at_one_text_is_told_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script(tmp_path / "cc", f'case "$*" in *model.c*) sleep 100;; esac; exec {REAL} "$@"', monkeypatch)
    monkeypatch.setattr(driver, "LIMIT", 1.0)
    with pytest.raises(CompilerError, match="did not finish within 1 s, and was stopped") as caught:
        build([runtime(), model()])
    assert caught.value.code == "E602"


def test_a_cache_that_cannot_be_written_gives_way_but_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = build([runtime(), model()])
    make = caches.tempfile.mkdtemp

    def refuse(prefix: str, dir: Path | None = None) -> str:
        if dir == folder:
            raise PermissionError(13, "Permission denied")
        return make(prefix=prefix, dir=dir)

    monkeypatch.setattr(caches.tempfile, "mkdtemp", refuse)
    assert build([runtime(), model()]) == path
    other = build([runtime(), model(9.0)])
    assert folder not in other.parents
    assert value(other, 0.5) == math.sin(0.5) * 9.0 + 3


def test_where_nothing_can_be_written_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(prefix: str, dir: Path | None = None) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caches, "_temporary", {})
    monkeypatch.setattr(caches.tempfile, "mkdtemp", refuse)
    with pytest.raises(CompilerError, match="No space left on device") as caught:
        build([runtime(), model()])
    assert caught.value.code == "E604"


def test_a_hit_reads_each_text_once_and_no_file_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    units = [runtime(), TranslationUnit("model.c", model().text + "/*" + "x" * 1_000_000 + "*/\n")]
    path = build(units)
    build(units)
    monkeypatch.setattr(subprocess, "Popen", no_process)
    monkeypatch.setattr(caches, "_digest", no_process)  # this process knows the library already
    assert build(units) == path


def test_codes_of_this_module_are_known() -> None:
    assert {f"E60{i}" for i in range(1, 6)} <= set(EXPLAINED)
    assert isinstance(find_compiler(), Compiler)
