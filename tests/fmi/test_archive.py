"""The archive of an FMU: what is refused and why, and unpacked folders that nobody finds later."""

from __future__ import annotations

import contextlib
import errno
import gc
import io
import os
import signal
import stat
import struct
import subprocess
import sys
import tempfile
import threading
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blocks.fmi import archive
from blocks.fmi.archive import DESCRIPTION, Archive, unpack
from blocks.text.errors import BlocksError, FMUError, ModelError
from tests.support.places import ROOT

XML = b"<fmiModelDescription/>"
FILES = {DESCRIPTION: XML, "binaries/linux64/x.so": b"\x7fELF" * 50, "resources/table.csv": b"1,2\n" * 99}
FMUS = sorted((ROOT / "fmus").glob("*.fmu"))
ON_POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and locks of POSIX")


def packed(path: Path, files: dict[str, bytes] | None = None, **attributes: int) -> Path:
    """An archive with these files; attributes: external_attr by name of the file, "/" written as "__"."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a name that appears twice
        for name, data in (FILES if files is None else files).items():
            entry = zipfile.ZipInfo(name.removesuffix("#2"), (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = attributes.get(name.replace("/", "__"), 0o600 << 16)
            made.writestr(entry, data)
    return path


def code_of(path: Path) -> tuple[str, str]:
    """Code and text of the error that opening raises."""
    with pytest.raises(BlocksError) as caught, Archive(path) as opened:
        opened.read(DESCRIPTION)
    fault = caught.value.faults[0]
    assert fault.place
    assert fault.message.endswith((".", "?"))
    assert "\n" not in str(fault)
    return caught.value.code, str(caught.value)


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for temporary files, which is empty again after every test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    yield folder
    gc.collect()
    assert list(folder.iterdir()) == []


# --- what an archive holds ----


@pytest.mark.parametrize("path", FMUS, ids=lambda path: path.name)
def test_the_files_are_those_that_zipfile_finds(path: Path, temporary: Path) -> None:
    with zipfile.ZipFile(path) as expected, Archive(path) as opened:
        assert dict(opened.files) == {one.filename: one.file_size for one in expected.infolist()}
        for name in opened.files:
            assert opened.read(name) == expected.read(name)
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("../evil", "leaves the folder"),
        ("resources/../../evil", "leaves the folder"),
        ("/etc/passwd", "absolute"),
        ("C:/evil", "absolute"),
        ("c:evil", "absolute"),
        ("resources\\evil", "backslash"),
        ("..\\evil", "backslash"),
        ("a//b", "not a name"),
        ("./a", "not a name"),
        ("a/\x07", "not a name"),
        ("../", "leaves the folder"),
    ],
)
def test_a_name_that_leaves_the_folder_is_refused(name: str, what: str, tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu", {**FILES, name: b""})
    code, text = code_of(path)
    assert code == "E203"
    assert what in text
    with pytest.raises(FMUError):
        unpack(path)


@pytest.mark.parametrize(
    ("kind", "what"), [(stat.S_IFLNK, "symbolic link"), (stat.S_IFIFO, "neither"), (stat.S_IFCHR, "neither")]
)
def test_an_entry_that_is_no_plain_file_is_refused(kind: int, what: str, tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu", {**FILES, "link": b"/etc/passwd"}, link=(kind | 0o777) << 16)
    code, text = code_of(path)
    assert code == "E203"
    assert what in text


def test_a_name_that_stands_twice_is_refused(tmp_path: Path) -> None:
    code, text = code_of(packed(tmp_path / "x.fmu", {**FILES, f"{DESCRIPTION}#2": b"another"}))
    assert code == "E203"
    assert "appears twice" in text


def test_two_files_of_one_name_and_one_checksum_are_refused_where_their_bytes_differ(tmp_path: Path) -> None:
    one, other = b"plumless", b"buckeroo"  # the known pair of equal CRC-32
    assert zlib.crc32(one) == zlib.crc32(other)
    path = packed(tmp_path / "x.fmu", {**FILES, "resources/a": one, "resources/a#2": other})
    code, text = code_of(path)
    assert code == "E203"
    assert "resources/a: the name appears twice, with different bytes" in text
    with pytest.raises(FMUError):
        unpack(path)


def test_what_is_listed_twice_with_equal_bytes_and_the_folder_itself_are_harmless(tmp_path: Path) -> None:
    named = {**FILES, "./": b"", "resources/table.csv#2": FILES["resources/table.csv"], f"{DESCRIPTION}#2": XML}
    path = packed(tmp_path / "x.fmu", named)
    with zipfile.ZipFile(path) as made:
        assert len(made.infolist()) == 6
    with Archive(path) as opened:
        assert dict(opened.files) == {name: len(data) for name, data in FILES.items()}
        assert opened.read("resources/table.csv") == FILES["resources/table.csv"]
    with unpack(path) as files:
        found = {one.relative_to(files.folder).as_posix() for one in files.folder.rglob("*") if one.is_file()}
        assert found == set(FILES)
        assert (files.resources / "table.csv").read_bytes() == FILES["resources/table.csv"]


def test_one_file_that_the_list_names_twice_is_harmless(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    with zipfile.ZipFile(path, "a") as made:
        made.filelist.append(made.getinfo("resources/table.csv"))
        made._didModify = True  # type: ignore[attr-defined]
    with zipfile.ZipFile(path) as made:
        assert [one.filename for one in made.infolist()].count("resources/table.csv") == 2
    with unpack(path) as files:
        assert (files.resources / "table.csv").read_bytes() == FILES["resources/table.csv"]


def test_a_file_in_the_place_of_a_folder_is_refused(tmp_path: Path) -> None:
    code, text = code_of(packed(tmp_path / "x.fmu", {**FILES, "resources": b"a file"}))
    assert code == "E203"
    assert "folder" in text


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu", {**FILES, "../a": b"", "../b": b"", "/c": b""})
    with pytest.raises(FMUError) as caught:
        Archive(path)
    assert [fault.code for fault in caught.value.faults] == ["E203", "E203"]
    assert "../a and 1 more" in str(caught.value)


def test_too_many_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MAX_FILES", 10)
    code, text = code_of(packed(tmp_path / "x.fmu", {**FILES, **{f"resources/{k}": b"" for k in range(9)}}))
    assert code == "E203"
    assert "12 files; the limit is 10" in text


def test_a_list_of_files_that_is_too_long_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MAX_DIRECTORY", 100)
    code, text = code_of(packed(tmp_path / "x.fmu"))
    assert code == "E203"
    assert "list of its files" in text


def test_a_file_that_grows_a_thousand_times_is_refused(tmp_path: Path) -> None:
    code, text = code_of(packed(tmp_path / "x.fmu", {**FILES, "resources/zeros": bytes(17 * 2**20)}))
    assert code == "E203"
    assert "unpacks from" in text


def test_files_that_are_too_large_together_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "MAX_BYTES", 500)
    assert code_of(packed(tmp_path / "x.fmu"))[0] == "E203"


def test_an_archive_that_is_too_large_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "MAX_FILE", 100)
    path = packed(tmp_path / "x.fmu")
    assert code_of(path)[0] == "E203"
    with pytest.raises(FMUError, match="E203"):
        unpack(path)


def test_a_description_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with Archive(packed(tmp_path / "x.fmu")) as opened, pytest.raises(FMUError, match=r"E203 .* the limit is 5"):
        opened.read(DESCRIPTION, 5)


def central(data: bytes) -> Iterator[int]:
    """Where the entries of the list of files begin."""
    at = data.find(b"PK\1\2")
    while at >= 0:
        yield at
        at = data.find(b"PK\1\2", at + 1)


def test_entries_that_share_bytes_are_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu", {**FILES, "resources/a": b"same" * 9, "resources/b": b"same" * 9})
    data = bytearray(path.read_bytes())
    *_, first, second = central(bytes(data))
    data[second + 42 : second + 46] = data[first + 42 : first + 46]
    path.write_bytes(data)
    code, text = code_of(path)
    assert code == "E203"
    assert "shares bytes" in text


def test_an_entry_that_lies_about_its_size_gives_no_more_than_it_says(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    data = bytearray(path.read_bytes())
    at = next(central(bytes(data)))
    data[at + 24 : at + 28] = struct.pack("<I", 5)
    path.write_bytes(data)
    code, text = code_of(path)
    assert code == "E202"
    assert "damaged" in text


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    data = bytearray(path.read_bytes())
    for at in central(bytes(data)):
        data[at + 8] |= 1
    path.write_bytes(data)
    code, text = code_of(path)
    assert code == "E202"
    assert "encrypted" in text


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused_by_name(method: int, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.fmu", "w", method) as made:
        made.writestr(DESCRIPTION, XML)
    code, text = code_of(tmp_path / "x.fmu")
    assert code == "E202"
    assert {zipfile.ZIP_BZIP2: "bzip2", zipfile.ZIP_LZMA: "lzma"}[method] in text


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "empty"),
        (b"hello", "not a zip archive"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        (b"\n<!DOCTYPE html><html>", "web page"),
        (b"\x1f\x8b" + bytes(200), "not a zip archive"),
    ],
)
def test_what_is_no_archive_is_told_apart(data: bytes, what: str, tmp_path: Path) -> None:
    (tmp_path / "x.fmu").write_bytes(data)
    code, text = code_of(tmp_path / "x.fmu")
    assert code == "E202"
    assert what in text


def test_an_archive_without_a_description_is_no_fmu(tmp_path: Path) -> None:
    assert code_of(packed(tmp_path / "x.fmu", {"a": b""}))[0] == "E202"
    code, text = code_of(packed(tmp_path / "y.fmu", {f"model/{DESCRIPTION}": XML}))
    assert code == "E202"
    assert "lies in the folder model" in text


def test_a_path_that_cannot_be_read_says_so(tmp_path: Path) -> None:
    code, text = code_of(tmp_path / "none.fmu")
    assert code == "E007"
    assert "No such file" in text
    (tmp_path / DESCRIPTION).write_bytes(XML)
    code, text = code_of(tmp_path)
    assert code == "E007"
    assert "pack the content of the folder" in text
    with pytest.raises(ModelError, match="E007"):
        unpack(tmp_path / "none.fmu")
    with pytest.raises(ModelError, match="E007"):
        Archive("x\0.fmu")


@ON_POSIX
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.fmu")
    assert code_of(tmp_path / "x.fmu")[0] == "E007"


def test_every_truncation_gives_an_error(tmp_path: Path) -> None:
    data = packed(tmp_path / "x.fmu").read_bytes()
    for length in range(len(data)):
        (tmp_path / "cut.fmu").write_bytes(data[:length])
        assert code_of(tmp_path / "cut.fmu")[0] == "E202"


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.integers(0, 900), st.binary(min_size=1, max_size=6)), max_size=4))
def test_damaged_archives_give_nothing_but_errors_of_this_package(
    changes: list[tuple[int, bytes]], tmp_path: Path
) -> None:
    path = tmp_path / "x.fmu"
    data = bytearray(packed(path).read_bytes())
    for at, piece in changes:
        data[at : at + len(piece)] = piece
    path.write_bytes(data)
    with contextlib.suppress(BlocksError), unpack(path) as files:
        inside = [one for one in files.folder.rglob("*") if one.is_symlink() or files.folder not in one.parents]
        assert inside == []


# --- unpacked folders ----


def test_what_lies_unpacked_is_what_was_packed_and_private(tmp_path: Path) -> None:
    more = {"sources/model.c": b"int x;", "documentation/index.html": b"", "resources/bin/tool": b"#!"}
    path = packed(tmp_path / "x.fmu", {**FILES, **more}, resources__bin__tool=0o755 << 16)
    with unpack(path) as files:
        there = {one.relative_to(files.folder).as_posix(): one for one in files.folder.rglob("*") if one.is_file()}
        assert {name: one.read_bytes() for name, one in there.items()} == {**FILES, "resources/bin/tool": b"#!"}
        if os.name == "posix":
            assert {stat.S_IMODE(one.stat().st_mode) for one in (files.folder, files.folder.parent)} == {0o700}
            assert stat.S_IMODE(there["resources/table.csv"].stat().st_mode) == 0o600
            assert stat.S_IMODE(there["resources/bin/tool"].stat().st_mode) == 0o700
        assert files.resources == files.folder / "resources"
        kept = files.folder
    assert not kept.exists()
    with pytest.raises(ValueError, match="given back"):
        _ = files.folder
    files.close()


def test_users_of_equal_files_share_a_folder_until_the_last_is_gone(tmp_path: Path) -> None:
    path, copy = packed(tmp_path / "x.fmu"), packed(tmp_path / "copy.fmu")
    first, second = unpack(path), unpack(copy)
    assert first.folder == second.folder
    assert first.sha256 == second.sha256
    folder = first.folder
    first.close()
    assert folder.exists()
    other = unpack(path)
    assert other.folder == folder
    second.close()
    other.close()
    assert not folder.exists()


def test_a_file_that_changed_is_unpacked_anew(tmp_path: Path) -> None:
    with unpack(packed(tmp_path / "x.fmu")) as old:
        packed(tmp_path / "x.fmu", {**FILES, "resources/new": b"1"})
        with unpack(tmp_path / "x.fmu") as new:
            assert new.folder != old.folder
            assert (new.folder / "resources/new").exists()
            assert not (old.folder / "resources/new").exists()


def test_a_handle_that_is_forgotten_gives_its_folder_back(tmp_path: Path) -> None:
    files = unpack(packed(tmp_path / "x.fmu"))
    folder = files.folder
    del files
    gc.collect()
    assert not folder.exists()


def test_a_failure_inside_leaves_nothing_behind(tmp_path: Path, temporary: Path) -> None:
    with pytest.raises(ZeroDivisionError), unpack(packed(tmp_path / "x.fmu")):
        _ = 1 / 0
    assert list(temporary.iterdir()) == []


def test_a_damaged_resource_leaves_nothing_behind(tmp_path: Path, temporary: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    data = bytearray(path.read_bytes())
    at = data.find(b"resources/table.csv") + 20
    data[at : at + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(data)
    with pytest.raises(FMUError, match=r"E202 .*resources/table.csv is damaged"):
        unpack(path)
    gc.collect()
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("stop", [KeyboardInterrupt, MemoryError])
def test_an_interrupt_while_unpacking_leaves_nothing_behind(
    stop: type[BaseException], tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Archive._chunks

    def interrupted(self: Archive, entry: zipfile.ZipInfo) -> Iterator[bytes]:
        if entry.filename.startswith("resources"):
            raise stop
        return whole(self, entry)

    with monkeypatch.context() as patch:
        patch.setattr(Archive, "_chunks", interrupted)
        with pytest.raises(stop):
            unpack(packed(tmp_path / "x.fmu"))
    gc.collect()
    assert list(temporary.iterdir()) == []
    with unpack(tmp_path / "x.fmu") as files:
        assert (files.folder / DESCRIPTION).read_bytes() == XML


@pytest.mark.parametrize(("number", "cure"), [(errno.ENOSPC, "TMPDIR"), (errno.ENAMETOOLONG, "names")])
def test_a_full_disk_is_an_error_with_a_cure(
    number: int, cure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = packed(tmp_path / "x.fmu")
    real: Callable[..., int] = os.open

    def full(file: str | Path, flags: int, *rest: int, **more: int) -> int:
        if flags & os.O_CREAT and str(file).endswith(".so"):
            raise OSError(number, os.strerror(number))
        return real(file, flags, *rest, **more)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", full)
        with pytest.raises(FMUError, match=rf"E210 x\.fmu: .*{cure}"):
            unpack(path)
    gc.collect()


def test_a_missing_temporary_folder_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = packed(tmp_path / "x.fmu")
    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
        with pytest.raises(FMUError, match="E210"):
            unpack(path)
        gc.collect()
    with unpack(path) as files:
        assert files.folder.exists()


def test_threads_unpack_a_file_once_and_leave_nothing(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [packed(tmp_path / f"{k}.fmu", {**FILES, "resources/k": str(k).encode()}) for k in range(3)]
    filled = []
    real = archive._fill
    monkeypatch.setattr(archive, "_fill", lambda *arguments: (filled.append(1), real(*arguments))[1])
    seen: list[str] = []

    def use(seed: int) -> None:
        for k in range(40):
            n = (seed + k) % 3
            with unpack(paths[n]) as files:
                seen.append((files.folder / "resources/k").read_text())
                assert seen[-1] == str(n)

    threads = [threading.Thread(target=use, args=(seed,)) for seed in range(6)]
    with unpack(paths[0]) as held:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert held.folder.exists()
    assert len(seen) == 240
    assert len(filled) < 240
    assert list(temporary.iterdir()) == []


# --- other processes ----


HOLD = """
import sys, time
from blocks.fmi.archive import unpack
files = unpack(sys.argv[1])
print(files.folder, flush=True)
"""


def held(path: Path, more: str) -> tuple[subprocess.Popen[str], Path]:
    """A process that has unpacked a file and goes on with `more`, and its folder."""
    command = [sys.executable, "-c", HOLD + more, str(path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def finished(process: subprocess.Popen[str]) -> int:
    process.communicate(timeout=30)
    return process.returncode


@pytest.mark.parametrize("more", ["", "raise ValueError", "sys.exit(3)"])
def test_the_exit_of_the_interpreter_removes_the_folder(more: str, tmp_path: Path) -> None:
    process, folder = held(packed(tmp_path / "x.fmu"), more)
    finished(process)
    assert folder.name
    assert not folder.exists()


@ON_POSIX
def test_ctrl_c_removes_the_folder(tmp_path: Path) -> None:
    process, folder = held(packed(tmp_path / "x.fmu"), "time.sleep(60)")
    assert folder.exists()
    process.send_signal(signal.SIGINT)
    assert finished(process) == -signal.SIGINT
    assert not folder.exists()


@ON_POSIX
def test_what_a_killed_process_left_is_removed_by_the_next_one_and_a_living_one_keeps_its_own(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    living, kept = held(path, "time.sleep(60)")
    killed, left = held(path, "time.sleep(60)")
    try:
        killed.kill()
        finished(killed)
        assert left.exists()
        with unpack(path) as files:
            assert not left.exists()
            assert kept.exists()
            assert files.folder != kept
    finally:
        living.send_signal(signal.SIGINT)
        finished(living)
    assert not kept.exists()


@ON_POSIX
def test_a_folder_without_a_lock_is_left_alone_until_it_is_old(tmp_path: Path, temporary: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    fresh, old, other = (
        temporary / name for name in (f"blocks-fmu-{'a' * 16}", f"blocks-fmu-{'b' * 16}", "blocks-fmu")
    )
    for folder in (fresh, old, other):
        folder.mkdir()
    os.utime(old, (time.time() - 7200,) * 2)
    unpack(path).close()
    assert (fresh.exists(), old.exists(), other.exists()) == (True, False, True)
    fresh.rmdir()
    other.rmdir()


@ON_POSIX
def test_a_forked_child_leaves_the_folder_of_its_parent_alone(tmp_path: Path) -> None:
    more = """
import os
child = os.fork()
if not child:
    files.close()
    with unpack(sys.argv[1]) as own:
        sys.exit(0 if own.folder != files._shared.path and files._shared.path.exists() else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), files.folder.exists())
"""
    process, folder = held(packed(tmp_path / "x.fmu"), more)
    text, _ = process.communicate(timeout=30)
    assert text.split() == ["0", "True"]
    assert not folder.exists()


def test_data_before_the_archive_is_no_fault(tmp_path: Path) -> None:
    path = packed(tmp_path / "x.fmu")
    path.write_bytes(b"#!/bin/sh\n" + path.read_bytes())
    with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as expected, Archive(path) as opened:
        assert set(opened.files) == set(expected.namelist())
