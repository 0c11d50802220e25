"""Files are whole or absent, whatever ends the process that writes them, and whoever else writes."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, Integrator, Sine, UsageError
from blocks.compile.toolchain.compiler import find_compiler
from blocks.text.atomic_write import drop_parts, write_atomically
from tests.support.places import ROOT, SUPPORT

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="locks and signals as POSIX has them")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD, /proc and /dev/full")
IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0


def parts(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.endswith(".part"))


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)]), **more}


def write(target: Path, text: str) -> None:
    with write_atomically(target) as stream:
        stream.write(text)


def wave(name: str = "wave") -> Diagram:
    diagram = Diagram(name)
    sine, x = diagram.add("sine", Sine()), diagram.add("x", Integrator())
    diagram.wire(x.u, sine.y)
    return diagram


# --- killed at every call ----------------------------------------------------------------------------------------

KILLED = """
    import ctypes, json, os, signal, sys, time
    from pathlib import Path
    from tests.text.test_atomic_write import wave
    from blocks.results import plots
    from blocks.studies import report, study
    from blocks.cli import main
    from blocks.export import source_fmu as compiled
    from blocks.text.atomic_write import write_atomically

    folder = Path(sys.argv[1])
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    diagram = wave()
    diagram.save(folder / "wave.json")
    results = diagram.run(stop=3.0, every=0.01, engine="reference")

    def picture(target):  # it is drawn once: how it is written is what counts
        figure = results.plot()
        plots.save(figure, target)
        drawn = target.read_bytes()
        figure.savefig = lambda stream, **options: stream.write(drawn)
        return lambda: plots.save(figure, target)

    def compiling(target):
        diagram.export(folder / "sources.fmu", platforms=())
        return lambda: compiled.compile_sources(folder / "sources.fmu", target)

    def studying(target):
        run = {"diagram": "wave.json", "settings": {"stop": 1, "every": 0.1}}
        document = {"format": "blocks-study", "version": 1, "name": "study", "runs": {"a": run}}
        (folder / "study.json").write_text(json.dumps({**document, "claims": [], "figures": []}))
        made = study.run(study.load(folder / "study.json"))
        return lambda: report.write(made, folder, "blocks study study.json")

    def state(target):
        run = diagram.start(stop=1.0, engine="reference")
        return lambda: run.save(target)

    def table(target):
        return lambda: results.save(target)

    ways = {
        "x.csv": table, "x.parquet": table, "x.mat": table, "state": state,
        "x.svg": picture, "x.png": picture, "x.pdf": picture,
        "drawn.svg": lambda target: lambda: main(["draw", str(folder / "wave.json"), "-o", str(target)]),
        "x.json": lambda target: lambda: diagram.save(target),
        "x.fmu": lambda target: lambda: diagram.export(target),
        "compiled.fmu": compiling, "report.html": studying,
    }
    for name in sys.argv[2:]:
        target = folder / name
        write = ways[name](target)
        write()
        new, old = target.read_bytes(), b"what was there before"
        with write_atomically(target):
            stale = next(folder.glob(".*.part"))
        seen, left = {"old": 0, "new": 0}, 0
        for n in range(1000):
            target.write_bytes(old) if n % 2 else target.unlink(missing_ok=True)
            before = old if n % 2 else None
            for part in folder.glob(".*.part"):
                part.unlink()
            stale.write_bytes(b"left by another")
            child = os.fork()
            if not child:
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                library.killed_at(n)
                write()
                os._exit(0)
            end = time.monotonic() + 20.0
            while not (ended := os.waitpid(child, os.WNOHANG))[0]:
                if time.monotonic() > end:
                    os.kill(child, signal.SIGKILL)
                    raise SystemExit(f"{name}: a child hangs at call {n}")
                time.sleep(0.0005)
            there = target.read_bytes() if target.exists() else None
            if there != new and there != before:
                raise SystemExit(f"{name}: half a file after call {n}: {there[:100]}")
            seen["new" if there == new else "old"] += 1
            now = len(list(folder.glob(".*.part")))
            left = max(left, now)
            status = os.waitstatus_to_exitcode(ended[1])
            if status == 0:
                break
            if status != -signal.SIGKILL:
                raise SystemExit(f"{name}: status {status} at call {n}")
        print("told", name, n, seen["old"], seen["new"], left, now)
"""
NAMES = (
    ("x.csv", "x.parquet", "x.mat", "state", "x.svg", "x.png", "x.pdf"),
    ("drawn.svg", "x.json", "x.fmu", "compiled.fmu", "report.html"),
)


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("killed") / "killed.so"
    subprocess.run(
        [*compiler.command, "-shared", "-fPIC", "-O1", "-o", str(made), str(SUPPORT / "killed.c"), "-ldl"], check=True
    )
    return made


@LINUX
@pytest.mark.long
@pytest.mark.parametrize("names", NAMES)
def test_a_process_that_is_killed_at_any_call_leaves_the_old_file_or_the_new_one(
    names: tuple[str, ...], shim: Path, tmp_path: Path
) -> None:
    if "x.parquet" in names:
        pytest.importorskip("pyarrow")
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(KILLED), str(tmp_path), *names],
        env=environment(LD_PRELOAD=str(shim), BLOCKS_ENGINE="reference"), capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    told = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("told")]
    assert [name for name, *_ in told] == [*names]
    for kills, old, new, left, last in (map(int, numbers) for _, *numbers in told):
        # What another left is opened, locked, removed, closed; the part is made, locked, looked at, written, synced,
        # gets its mode, is renamed and closed; the folder is opened, synced, closed.
        assert kills >= 15, told
        assert old >= 10, told
        assert new >= 5, told
        assert (left, last) == (1, 0), told


RUN = """
    import sys
    from blocks.cli import main
    sys.exit(main(sys.argv[1:]))
"""


@LINUX
@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "mat"])
def test_a_command_that_is_killed_at_any_moment_leaves_the_old_file_or_the_new_one(ending: str, tmp_path: Path) -> None:
    wave().save(tmp_path / "wave.json")
    target, script = tmp_path / f"target.{ending}", tmp_path / "run.py"
    script.write_text(textwrap.dedent(RUN), encoding="utf-8")
    # So many numbers that it takes long to write them.
    command = [
        sys.executable, str(script), "run", "wave.json", "--stop", "200", "--every", "0.01", "--method", "rk4",
        "--step", "50", "--engine", "reference", "--out", target.name, "--save", "state",
    ]  # fmt: skip

    def begun() -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            command, cwd=tmp_path, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    begin = time.monotonic()
    assert begun().wait() == 0
    took = time.monotonic() - begin
    new, state = target.read_bytes(), (tmp_path / "state").read_bytes()
    some = random.Random(7)
    killed = 0
    for _ in range(6):
        target.write_bytes(b"old")
        (tmp_path / "state").write_bytes(b"old")
        process = begun()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(took * some.uniform(0.4, 1.0))
        process.kill()
        killed += process.wait() == -signal.SIGKILL
        assert target.read_bytes() in (b"old", new)
        assert (tmp_path / "state").read_bytes() in (b"old", state)
    assert killed >= 1
    assert begun().wait() == 0
    assert target.read_bytes() == new
    assert parts(tmp_path) == []


# --- leftovers ---------------------------------------------------------------------------------------------------


@POSIX
def test_what_a_killed_process_left_is_removed_and_a_living_one_is_let_be(tmp_path: Path) -> None:
    target = tmp_path / "x.json"
    text = f"""
        import os, sys, time
        from blocks.text.atomic_write import write_atomically
        with write_atomically({str(target)!r}) as stream:
            stream.write("slow")
            print("begun", flush=True)
            sys.stdin.readline()
    """
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(text)], env=environment(), stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "begun\n"
    assert len(parts(tmp_path)) == 2
    writers[0].kill()
    writers[0].communicate()
    assert len(parts(tmp_path)) == 2
    with write_atomically(target) as stream:
        stream.write("mine")
    assert target.read_text() == "mine"
    assert len(parts(tmp_path)) == 1
    writers[1].communicate("\n")
    assert writers[1].returncode == 0
    assert target.read_text() == "slow"
    assert parts(tmp_path) == []


def test_parts_of_other_files_other_machines_and_other_programs_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = [
        ".other.json.0123456701234567.part", ".x.json.part", ".x.json.abcdefgh.part", ".x.json.0123456701234567.part",
        "x.json.0123456701234567.part",
    ]  # fmt: skip
    for name in others:
        (tmp_path / name).write_text("?")
    with write_atomically(tmp_path / "x.json") as stream:
        stream.write("mine")
    assert sorted([*others, "x.json"]) == sorted(os.listdir(tmp_path))


@POSIX
def test_a_link_in_the_place_of_a_part_is_not_followed(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("precious")
    with write_atomically(tmp_path / "x"):
        (name,) = parts(tmp_path)
    (tmp_path / name).symlink_to(precious)
    with write_atomically(tmp_path / "x") as stream:
        stream.write("mine")
    assert precious.read_text() == "precious"


def test_two_writers_of_one_file_do_not_disturb_each_other(tmp_path: Path) -> None:
    target = tmp_path / "x"
    with write_atomically(target) as outer:
        outer.write("outer")
        with write_atomically(target) as inner:
            inner.write("inner")
        assert target.read_text() == "inner"
    assert target.read_text() == "outer"

    texts = [str(k) * 50_000 for k in range(4)]
    seen: list[str] = []

    def write_often(text: str) -> None:
        for _ in range(15):
            write(target, text)
            seen.append(target.read_text())

    threads = [threading.Thread(target=write_often, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 60
    assert set(seen) <= {*texts}
    assert parts(tmp_path) == []


def test_an_interrupted_writer_leaves_nothing(tmp_path: Path) -> None:
    target = tmp_path / "x"
    target.write_text("old")
    for error in (KeyboardInterrupt, MemoryError, ValueError):

        def fail(error: type[BaseException] = error) -> None:
            with write_atomically(target) as stream:
                stream.write("new" * 10_000)
                raise error

        with pytest.raises(error):
            fail()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["x"]


def test_a_process_that_ends_without_a_word_takes_its_parts_along(tmp_path: Path) -> None:
    with contextlib.suppress(UsageError), write_atomically(tmp_path / "x"):
        assert len(parts(tmp_path)) == 1
        drop_parts()
        assert parts(tmp_path) == []


@pytest.mark.skipif(not hasattr(os, "fchmod"), reason="modes as POSIX has them")
def test_a_file_keeps_its_mode_and_a_new_one_has_that_of_a_new_file(tmp_path: Path) -> None:
    target, plain = tmp_path / "x", tmp_path / "plain"
    plain.write_text("")
    with write_atomically(target) as stream:
        stream.write("1")
    assert target.stat().st_mode == plain.stat().st_mode
    target.chmod(0o640)
    with write_atomically(target) as stream:
        stream.write("2")
    assert target.stat().st_mode & 0o777 == 0o640


@POSIX
def test_data_are_on_the_disk_before_their_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    sync, replace = os.fsync, os.replace
    folder = str(tmp_path)

    def synced(handle: int) -> None:
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "file")
        sync(handle)

    def replaced(*arguments: Any) -> None:
        done.append("name")
        replace(*arguments)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    with write_atomically(tmp_path / "x") as stream:
        stream.write("1")
    assert done == ["file", "name", "folder"] if os.path.isdir("/proc/self/fd") else done[-2:], folder


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS])
def test_a_file_system_that_cannot_sync_serves_as_well(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refuse)
    with write_atomically(tmp_path / "x") as stream:
        stream.write("1")
    assert (tmp_path / "x").read_text() == "1"


# --- what cannot be written --------------------------------------------------------------------------------------

REFUSED = {
    errno.ENOSPC: "No space left on device. Nothing was changed. Make room, or name a file on another disk.",
    errno.EDQUOT: "Disk quota exceeded. Nothing was changed. Make room, or name a file on another disk.",
    errno.EIO: "Input/output error. Nothing was changed.",
    errno.EROFS: "Read-only file system. Nothing was changed. Name a file in a folder that can be written to.",
    errno.EACCES: "Permission denied. Nothing was changed. Name a file that you may write to, in a folder that "
    "you may write to.",
}


@POSIX
@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
@pytest.mark.parametrize("number", REFUSED, ids=errno.errorcode.get)
def test_what_the_system_refuses_is_told_and_leaves_the_old_file(
    number: int, call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "x"
    target.write_text("old")
    if call == "fsync" and number == errno.EROFS:
        pytest.skip("what can only be read is not synced")

    def refuse(*arguments: Any, **more: Any) -> Any:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, refuse)
        with pytest.raises(UsageError) as caught:
            write(target, "new")
    assert str(caught.value) == f"E501 {target}: cannot be written: {REFUSED[number]}"
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["x"]


@POSIX
def test_names_and_places_that_cannot_be_are_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("1")
    for path, why in (
        (tmp_path, "Is a directory. Nothing was changed. Name a file in it."),
        (tmp_path / "none" / "x", "No such file or directory. Nothing was changed. Make the folder, or name another"),
        (tmp_path / "file" / "x", "Not a directory"),
        (tmp_path / ("x" * 300), "File name too long. Nothing was changed. Shorten the name."),
        (tmp_path / "a\0b", "the name holds a NUL"),
    ):
        with pytest.raises(UsageError) as caught, write_atomically(path) as stream:
            stream.write("1")
        assert f"cannot be written: {why}" in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file"]


def test_names_as_long_as_they_may_be_are_written(tmp_path: Path) -> None:
    for name in ("x" * 255, "ü" * 127, "日" * 85, "a" + "😀" * 63):
        with contextlib.suppress(OSError):
            (tmp_path / name).write_text("old")
        if not (tmp_path / name).exists():
            continue  # a system with shorter names
        with write_atomically(tmp_path / name) as stream:
            stream.write("new")
        assert (tmp_path / name).read_text() == "new"


@POSIX
@pytest.mark.skipif(IS_ROOT, reason="root may write everywhere")
def test_a_folder_that_is_read_only_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o555)
    with pytest.raises(UsageError, match="Permission denied"), write_atomically(folder / "x") as stream:
        stream.write("1")


@LINUX
def test_a_device_that_is_full_is_told() -> None:
    with pytest.raises(UsageError, match=r"E501 /dev/full: cannot be written: No space left on device\."):  # noqa: SIM117
        with write_atomically("/dev/full") as stream:
            stream.write("1" * 100_000)


@POSIX
def test_a_lock_of_another_program_does_not_hold_an_edit_up_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    target = tmp_path / "loop.json"
    target.write_text("before")
    monkeypatch.setattr("blocks.text.atomic_write.PATIENCE", 0.1)
    with target.open() as stream:  # who may only read it, may lock it
        fcntl.flock(stream, fcntl.LOCK_SH)
        held = pytest.raises(UsageError, match=r"E501 .*another program has locked it for more than 0\.1 s")
        with held, write_atomically(target, was=b"before") as edited:
            edited.write("after")
        assert (target.read_text(), parts(tmp_path)) == ("before", [])
        monkeypatch.setattr("blocks.text.atomic_write.PATIENCE", 60.0)
        let_go = threading.Timer(0.2, lambda: fcntl.flock(stream, fcntl.LOCK_UN))
        let_go.start()
        with write_atomically(target, was=b"before") as edited:
            edited.write("after")
        let_go.join()
    assert (target.read_text(), parts(tmp_path)) == ("after", [])


@LINUX
def test_the_umask_is_read_without_being_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "umask", lambda _: pytest.fail("another thread would create files with it"))
    write(tmp_path / "a", "a")
    (tmp_path / "b").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


@LINUX
def test_names_beyond_ascii_are_written_where_file_names_are_in_ascii(tmp_path: Path) -> None:
    code = f"""
        import sys
        from blocks.text.atomic_write import write_atomically
        from blocks.text.errors import UsageError
        assert sys.getfilesystemencoding() == "ascii"
        with write_atomically({str(tmp_path)!r} + "/" + sys.argv[1]) as stream:
            stream.write("bytes of the command line")
        try:
            with write_atomically({str(tmp_path)!r} + "/\\xe4.csv") as stream:
                stream.write("no such bytes are known")
        except UsageError as error:
            print(ascii(str(error)))
        """
    command = [sys.executable, "-c", textwrap.dedent(code), "\xf6.csv"]
    ascii_names = environment(LC_ALL="POSIX", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0")
    done = subprocess.run(command, env=ascii_names, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "file names use the encoding ascii here" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["\xf6.csv"]
