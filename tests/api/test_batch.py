"""Batches: each row is the run that it stands for, bit for bit, whatever runs beside it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.api.batch import BatchRows
from blocks.text.errors import BlocksError
from tests.support.documents import SHIPPED

ROOT = Path(__file__).parents[2]


def same(rows: BatchRows, i: int, diagram: Diagram, **given: Any) -> None:
    """Row i is what a run of a fresh copy gives."""
    fault, results = "", None
    try:
        results = diagram.copy().run(**given)
    except BlocksError as error:
        fault = error.code
    if results is None:
        assert rows.status[i] == ("diverged" if fault.startswith("E3") else "refused")
        assert rows.messages[i].startswith(fault)
        return
    assert rows.status[i] == "ok"
    assert rows.steps[i] == results.statistics.steps + results.statistics.rejected
    for name, column in rows.measures.items():
        assert np.array([column[i]]).tobytes() == np.array([results.measures[name]]).tobytes(), name
    for name, signals in rows.signals.items():
        assert signals[i].tobytes() == results[name].tobytes(), name
    if rows.signals:
        assert rows.t.tobytes() == results.t.tobytes()


def varied(diagram: Diagram) -> dict[str, float]:
    """Some parameters of a diagram that have one number each, with their values."""
    found = {}
    for block in diagram.flatten().blocks:
        for key in block.interface.symbolic_parameters.keys() - {*block.interface.declaration.streams}:
            value = block.resolved.values[key].value
            if not isinstance(value, (str, bool)) and value is not None and not np.ndim(value):
                found[f"{block.path}.{key}"] = float(value)
    names = sorted(found)
    return {name: found[name] for name in names[:: max(1, len(names) // 5)]}


@pytest.mark.parametrize("path", [p for p in SHIPPED if "fmu" not in p.stem], ids=lambda p: p.stem)
def test_a_row_is_the_run_of_its_values(path: Path) -> None:
    """All shipped diagrams: one parameter after the other gets other values, which may be refused or diverge."""
    diagram = Diagram.load(path)
    known, log = varied(diagram), [name for name in diagram.flatten().log if "." in name][:3]
    table = [list(known.values())]
    for k, value in enumerate(known.values()):
        table += [[*table[0][:k], other, *table[0][k + 1 :]] for other in (value * 1.25, value * 0.8 + 1e-3)]
    settings: dict[str, Any] = {"stop": 1.0, "every": 0.125, "log": log}
    rows = diagram.batch(list(known), **settings)(table, threads=2, seeds=range(len(table)))
    for i, row in enumerate(table):
        same(rows, i, diagram, parameters=dict(zip(known, row, strict=True)), seed=i, **settings)
