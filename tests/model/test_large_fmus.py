"""FMUs of many variables: the work grows with their number and no faster, and is done once.

Work is counted in calls of functions, of Python and of C, so that nothing here depends on a clock. What is read is
compared with what FMPy reads.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fmpy import read_model_description

from benchmarks.large_fmu import save
from blocks import Diagram, fmu
from blocks.cli import main
from blocks.fmi import description
from blocks.fmi.summary import tell
from tests.support.faulty import NEEDS_COMPILER, make

FMI = pytest.mark.parametrize("fmi", [2, 3])


def counted(what: Callable[[], Any]) -> int:
    """The calls of functions inside."""
    calls = 0

    def hear(_frame: Any, event: str, _argument: Any) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    gc.disable()
    sys.setprofile(hear)
    try:
        what()
    finally:
        sys.setprofile(None)
        gc.enable()
    return calls


@FMI
def test_the_made_up_fmu_is_read_as_fmpy_reads_it(fmi: int, tmp_path: Path) -> None:
    path = save(tmp_path / "x.fmu", 50, fmi)
    mine, theirs = tell(path).description, read_model_description(str(path))
    assert len(mine.variables) == 50 + (fmi == 3)
    assert [v.name for v in mine.variables] == [v.name for v in theirs.modelVariables]
    assert [v.causality for v in mine.variables] == [v.causality for v in theirs.modelVariables]
    assert [v.unit for v in mine.variables] == [v.unit or "" for v in theirs.modelVariables]
    starts = [None if v.start is None else float(v.start) for v in theirs.modelVariables]
    assert [v.start[0] if v.start else None for v in mine.variables] == starts
    assert mine.warnings == ()


@FMI
@pytest.mark.parametrize("what", ["info", "diagram"])
def test_the_work_for_an_fmu_grows_with_its_variables(what: str, fmi: int, tmp_path: Path) -> None:
    def work(count: int) -> int:
        path = save(tmp_path / f"{count}.fmu", count, fmi)
        if what == "info":
            return counted(lambda: tell(path).info())
        return counted(lambda: Diagram.alone(fmu(path)).flatten())

    work(10)  # imports, and what is made once
    few, more, most = (work(count) for count in (1000, 2000, 4000))
    assert most - more == pytest.approx(2 * (more - few), rel=0.1)  # 4 times, if it were quadratic


@NEEDS_COMPILER
def test_a_description_is_read_once_for_a_diagram_and_its_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[str] = []
    real = description.parse

    def parse(text: bytes, file: str) -> Any:
        read.append(file)
        return real(text, file)

    monkeypatch.setattr(description, "parse", parse)
    monkeypatch.setattr(description, "_remembered", {})
    path = make(tmp_path, name="once")
    diagram = Diagram("one")
    diagram.add("plant", fmu(path))
    for _ in range(2):
        diagram.run(stop=0.2, master={"step": 0.1})
    assert read == ["once.fmu/modelDescription.xml"]
    make(tmp_path, fmi=2, name="once")  # another file of that name
    fmu(path)
    assert len(read) == 2


def test_on_a_terminal_a_word_is_said_where_reading_takes_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def slowly(path: str) -> Any:
        time.sleep(0.3)
        return tell(path)

    path = save(tmp_path / "x.fmu", 10)
    monkeypatch.setattr("blocks.cli.output.LONG", 0.01)
    monkeypatch.setattr("blocks.fmi.summary.tell", slowly)
    assert main(["fmu", "info", str(path)]) == 0
    assert "reading" not in capsys.readouterr().err
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["fmu", "info", str(path)]) == 0
    assert f"reading {path}" in capsys.readouterr().err
    assert main(["fmu", "info", str(path), "--json"]) == 0
    assert "reading" not in capsys.readouterr().err
