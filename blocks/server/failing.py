"""The block at which a run failed, and the last rows of what comes in there."""

from __future__ import annotations

import math
from typing import Any

from ..model.flatten import Flat
from ..model.wires import BlockSource
from .live_run import LiveRun

__all__ = ["failing_of"]

ROWS = 5
MOST = 8
"""Columns of inputs that are shown."""


def failing_of(live: LiveRun) -> dict[str, Any] | None:
    """The block that the error of a run names, with the recorded signals at its inputs and their last rows.

    None where it names none. What is not recorded is left out; numbers that are not finite are texts.
    """
    flat, place = live.prepared.structure, "" if live.error is None else live.error.faults[0].place
    known = {block.path: block for block in flat.blocks}
    while place and place not in known:
        place = place.rpartition(".")[0]
    if not place:
        return None
    columns: dict[str, int] = {}
    for variable, sources in known[place].sources.items():
        for k, source in enumerate(sources):
            name, column = _column(live, flat, source)
            if column >= 0 and len(columns) < MOST:
                port = f"{variable}[{k}]" if len(sources) > 1 else variable
                columns[f"{port} ({name})"] = column
    t, values = live.rows()
    rows = [[_plain(x) for x in row] for row in values[-ROWS:, [*columns.values()]].tolist()]
    return {"block": place, "signals": list(columns), "t": t[-ROWS:].tolist(), "rows": rows}


def _column(live: LiveRun, flat: Flat, source: Any) -> tuple[str, int]:
    """The name of the signal that an element comes from, and its column; -1 where it is not recorded."""
    if not isinstance(source, BlockSource):
        return "", -1
    for name in live.columns:
        signal = flat.signals.get(name)
        if signal is not None and source in signal.sources:
            element = signal.sources.index(source)
            return name if len(signal.sources) == 1 else f"{name}[{element}]", live.columns[name][0] + element
    return "", -1


def _plain(x: float) -> float | str:
    return x if math.isfinite(x) else str(x)
