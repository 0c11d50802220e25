"""Faults of the import that public models showed: each by a small model of our own, with a second witness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, from_simulink
from blocks.simulink import Block, Line, System
from blocks.simulink.importing import Report
from tests.support.simulink_files import block, line, model, system, write_mdl, write_split


def imported(
    folder: Path, blocks: Sequence[Block], lines: Sequence[Line], stop: str = "1", **more: Mapping[str, Any]
) -> tuple[Diagram, Report]:
    settings = {"StopTime": stop, **more.pop("settings", {})}
    drawn = model("found", system(blocks, lines), settings=settings, **more)
    return from_simulink((write_mdl if more.get("defaults") else write_split)(drawn, folder))


def source(value: str = "1") -> Block:
    return block("Constant", "c", 1, {"Value": value}, {"out": 1})


def sink(name: str = "y", sid: int = 99, port: str = "1") -> Block:
    return block("Outport", name, sid, {"Port": port}, {"in": 1})


def chain(folder: Path, *blocks: Block, stop: str = "1") -> tuple[Diagram, Report]:
    """Import blocks in a row, with an Outport "y" behind them."""
    row = [*blocks, sink()]
    lines = [line((a.name, "1"), (b.name, "1")) for a, b in zip(row, row[1:], strict=False)]
    return imported(folder, row, lines, stop)


def at_times(diagram: Diagram, times: Sequence[float], name: str = "y") -> list[float]:
    """Return the values of a signal just after these times, by the value of the last row before or at each."""
    run = diagram.run()
    return [float(run[name][np.searchsorted(run.t, time + 1e-9) - 1]) for time in times]


def test_a_polyval_takes_its_coefficients(tmp_path: Path) -> None:
    diagram, report = chain(tmp_path, source("3"), block("Polyval", "p", 2, {"Coefs": "[2 1 5]"}, {"in": 1, "out": 1}))
    assert report.is_whole
    assert at_times(diagram, [0.0, 1.0]) == [np.polyval([2, 1, 5], 3)] * 2
