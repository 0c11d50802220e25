"""The shims of traces in C, under the sanitizers: odd texts, arrays beyond what is shown, calls within a call.

What they make of a run: tests/engines/test_fmu_trace.py.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.support.faulty import COMPILER, HEADERS, NEEDS_COMPILER
from tests.support.places import SUPPORT

pytestmark = NEEDS_COMPILER
CALLS = 1 + 20 * (2 + 5) + 2000
WIDEST = 60_000
"""Characters of a line: 100 values, with their names."""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("driver") / "driver"
    sources = [SUPPORT / "trace_driver.c", *(HEADERS / name for name in ("trace.c", "trace2.c", "trace3.c"))]
    flags = ["-std=c11", "-g", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{HEADERS}"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    assert COMPILER is not None
    subprocess.run([COMPILER, *flags, *map(str, sources), "-lm", "-o", str(program)], check=True)
    return program


def traces(driver: Path, file: Path, form: str) -> tuple[list[str], list[str]]:
    """The lines of the file, and those that a function was given."""
    done = subprocess.run([str(driver), str(file), form], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return file.read_bytes().decode().split("\n"), done.stdout.decode().split("\n")


def test_lines_of_json_are_json(driver: Path, tmp_path: Path) -> None:
    kept, given = traces(driver, tmp_path / "c.jsonl", "JSON")
    for lines in (kept, given):
        assert lines.pop() == ""
        rows = [json.loads(line, parse_constant=lambda word: pytest.fail(word)) for line in lines]
        assert max(map(len, lines)) < WIDEST
        steps = [row for row in rows if row.get("call") == "fmi3DoStep"]
        assert {row["status"] for row in steps} == {"status 7"}
        sets = [row for row in rows if row.get("within") == steps[0]["n"]]
        assert [row["n"] for row in sets] == [*range(steps[0]["n"] + 1, steps[0]["n"] + 6)]
        assert sets[-1]["given"]["u"] == "Infinity"
        assert sets[-1]["given"]["reference 99"] == 0.1
        assert sets[2]["given"]["u"][-1] == "300 more"
        texts = next(row["gives"] for row in rows if row.get("call") == "fmi3GetString")
        assert texts["u"] == ""
        assert texts["reference 0"].endswith('\n\x1b[31m"\\')
        assert len(texts) == 101
    numbers = [row["n"] for line in given if "n" in (row := json.loads(line)) and "call" in row]
    assert sorted(numbers) == [*range(1, CALLS + 1)]


def test_lines_of_text_hold_nothing_that_a_terminal_obeys(driver: Path, tmp_path: Path) -> None:
    for lines in traces(driver, tmp_path / "c.log", "TEXT"):
        assert all(line.isprintable() for line in lines)
        assert max(map(len, lines)) < WIDEST
        (step, *_) = (line for line in lines if "fmi3DoStep" in line)
        assert 'status 7  a\\"b\\u000a[0]  fmi3DoStep  t = 0, h = 0.1' in step
        assert any("log warning (odd\\u000a): text \\ufffd \\u0009 \\u009b ..." in line for line in lines)
