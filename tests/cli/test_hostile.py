"""Files that are broken, or made to do harm, given to commands: each is told with its place, and nothing happens.

Every case of support/hostile.py is given to commands that read it, each in a process of its own (support/watched.py).
They end with the exit code 2 (4 for an FMU alone), say what is wrong, where, and what to do, within 2 s and 500 MB;
they execute nothing, open nothing for writing, and leave the folder as it was.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.hostile import CANARY, CASES, NAMES, TRACE, Hostile
from tests.support.marks import long_but
from tests.support.places import ROOT
from tests.support.watched import Seen, Watch

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is watched as Linux tells it")
MOST = 500 * 2**20  # bytes


def slowness() -> float:
    """How much slower this machine is than one that does this work in 50 ms of its processor; 1 for a faster one."""
    text = json.dumps([{"a": i, "b": str(i)} for i in range(2000)])
    took = []
    for _ in range(5):
        begin = time.process_time()
        for _ in range(40):
            sum(len(entry["b"]) for entry in json.loads(text))
            {i: i * i for i in range(5000)}
        took.append(time.process_time() - begin)
    return max(1.0, min(took) / 0.05)


SLOWEST = 2.0 * slowness()  # s of the processor
# What says by itself what is to be done, or that something else is needed.
PLAIN = re.compile(
    r"must |needed|is not |is no |are no |cannot |does not |not known|already|at most|only |twice|the most|there is no "
    r"|is computed|makes |has no |has two |overflow|deep|exactly one|lies |neither|missing|too |expected |more than "
    r"|line |are not |out of the range|needs |ends before|is {|not both|is empty"
    r"|the limit is |before the start|Use commas"
)


@pytest.fixture(scope="module")
def watch() -> Iterator[Watch]:
    with Watch() as made:
        yield made


def project(folder: Path, case: Hostile) -> Path:
    """A project that holds a case and what it could set off."""
    inside = folder / "project"
    inside.mkdir()
    (inside / "pyproject.toml").touch()
    for name in NAMES:
        (inside / f"{name}.py").write_text(CANARY, encoding="utf-8")
    (folder / "outside.json").write_text("{}", encoding="utf-8")
    case.put(inside)
    return inside


def listed(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Everything below a folder: kind, size and time of change."""
    return {
        path: (found.st_mode, found.st_size, found.st_mtime_ns)
        for root, folders, names in os.walk(folder)
        for path in (os.path.join(root, name) for name in (*folders, *names))
        for found in [os.lstat(path)]
    }


def spoken(text: str) -> list[dict[str, str]]:
    """The faults of a command that has no --json, from its lines."""
    lines = re.findall(r"^(E[0-9]{3}) (.*)$", text, re.MULTILINE)
    return [{"code": code, "file": line, "place": "", "message": line, "cure": line} for code, line in lines]


def asked(watch: Watch, words: list[str], folder: Path, case: Hostile) -> Seen:
    """What a command does; once more where it was slow, which other programs on this machine may have caused."""
    own = {"HOME": str(folder.parent / "home"), "TMPDIR": str(folder.parent / "tmp")}
    for name in own.values():
        Path(name).mkdir(exist_ok=True)
    for _ in range(4):
        seen = watch(words, folder, BLOCKS_CACHE_DIR=str(folder.parent / "cache"), **own)
        if seen.cpu <= SLOWEST:
            break
    return seen


# A file whose name says that it is large: `make test-long` reads it.
LARGE = re.compile(r"\b[0-9]+ MB|million|[0-9]0,000|0 poles|order 1e|1e\+06")
COMMANDS = ("check", "run", "fmu", "study", "compare", "draw", "linearize", "export", "list")


def first_of_each_kind() -> set[str]:
    """Return the names of the first case of each kind of file with its own code, message and command.

    The words before ":" or "at" name the kind: "an FMU in a diagram: a FIFO", "a table at '/etc/passwd'".
    """
    kinds: dict[tuple[str, ...], str] = {}
    for case in CASES:
        if not LARGE.search(case.name):
            kind = re.match(r".*?(?=: | at ')", case.name)
            command = case.reads[0][0] if case.reads[0][0] in COMMANDS else ""
            kinds.setdefault((kind[0] if kind else "", case.code, case.says, command), case.name)
    return set(kinds.values())


FIRST = first_of_each_kind()


@pytest.mark.parametrize(
    "case",
    long_but(CASES, lambda case: case.name in FIRST),
    ids=lambda case: case.name[:60].encode("ascii", "backslashreplace").decode(),
)
def test_a_hostile_file_is_refused_and_does_nothing(case: Hostile, watch: Watch, tmp_path: Path) -> None:
    folder = project(tmp_path, case)
    for name in ("home", "tmp"):
        (tmp_path / name).mkdir()
    before = listed(tmp_path)
    for reads in case.reads:
        words = [*reads, *(["--engine", "reference"] if reads[0] == "run" else [])]
        words += ["--json"] if reads[0] != "draw" else []
        seen = asked(watch, words, folder, case)
        assert seen.status == case.status, seen.said[-3000:]
        assert "Traceback" not in seen.said
        assert all(text.isprintable() for text in seen.said.split("\n")), "what a terminal would obey"
        told = [fault for fault in seen.faults or spoken(seen.err) if fault["code"] == case.code or not case.code]
        assert told, (case.code, seen.said[:1000])
        assert all(
            fault["place"] or fault["file"] or "a.json" in fault["message"] or fault["code"] == "E008" for fault in told
        )
        assert all(fault["cure"] or PLAIN.search(fault["message"]) for fault in told), told
        assert case.says in " ".join(fault["message"] + " " + fault["cure"] for fault in told), told
        assert not any("enough memory" in fault["message"] for fault in told), "it was not foreseen"
        assert all(len(line) < 3000 for line in seen.err.splitlines())
        assert seen.cpu <= SLOWEST
        assert seen.memory <= MOST
        assert seen.deeds == ()
    assert listed(tmp_path) == before, "something was written"
    assert not list(tmp_path.rglob(TRACE))


def test_there_are_many_cases_of_different_names() -> None:
    assert len(CASES) >= 130
    assert len(FIRST) >= 120
    assert {case.code for case in CASES} == {case.code for case in CASES if case.name in FIRST}
    assert len({case.name for case in CASES}) == len(CASES)


HEAVY = (
    "50 MB of spaces",
    "15 MB of opened objects",
    "two million numbers",
    "a circle of three",
    "2^40 blocks by nesting",
    "9**9**9",
    "10,000 brackets",
)


@pytest.mark.long
@pytest.mark.parametrize("case", [case for case in CASES if case.name.endswith(HEAVY)], ids=lambda case: case.name)
def test_the_heaviest_are_refused_by_a_process_that_begins_cold(case: Hostile, tmp_path: Path) -> None:
    folder = project(tmp_path, case)
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "blocks", "check", "a.json"],
        cwd=folder,
        env=surroundings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert case.code in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob(TRACE))


def test_the_watch_sees_what_it_is_there_to_see(watch: Watch, tmp_path: Path) -> None:
    """A command that writes and loads is caught, so that a case which finds nothing says something."""
    (tmp_path / "evil.py").write_text(
        CANARY + "from blocks import Block\nclass Own(Block):\n    pass\n", encoding="utf-8"
    )
    (tmp_path / "a.json").write_text(json.dumps({"format": "blocks-diagram", "version": 3}), encoding="utf-8")
    seen = watch(["check", "a.json", "--library", "evil"], tmp_path)
    assert any("evil.py" in deed for deed in seen.deeds if not deed.startswith("open"))
    assert any(deed.startswith("open for writing") for deed in seen.deeds)
    assert (tmp_path / TRACE).exists()
