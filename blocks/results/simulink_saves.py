"""What Simulink saves in MAT files, as the signals of one table.

To Workspace and Outports save arrays beside `tout`, or structures with time; To File saves a matrix whose first row is
the time. Objects of MATLAB (timeseries, Dataset, SimulationOutput) are closed to SciPy.

Source: MathWorks, Simulink: To Workspace; To File; Model Data Export (documentation of R2024b).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..text.arrays import Array
from ..text.printable import legible
from .table import Refuse

TOUT = "tout"
AS_ARRAYS = 'Save arrays there: t = out.tout; y = out.simout; save("sim.mat", "t", "y", "-v7").'


def opened_saves(variables: Mapping[str, Any], refuse: Refuse) -> dict[str, Any]:
    """Return the variables of a file, those of Simulink as plain ones: `tout`, and arrays by the names of signals.

    Raises:
        UsageError: E503 for objects of MATLAB, and for signals with other times.
    """
    held = {name: value for name, value in variables.items() if not name.startswith("__")}
    if any(type(value).__name__ == "MatlabOpaque" or name == "None" for name, value in held.items()):
        what = "holds an object of MATLAB (a timeseries, Dataset or SimulationOutput), which only MATLAB can read."
        raise refuse(what, AS_ARRAYS)
    found: dict[str, Any] = {}
    times: Array | None = None
    for name, value in held.items():
        if not isinstance(value, dict) or not {"time", "signals"} <= value.keys():
            found[name] = value
            continue
        t = np.asarray(value["time"], float).reshape(-1)
        if times is None:
            times = t
        elif not np.array_equal(t, times):
            cure = "Save it in a file of its own."
            raise refuse(f"the structure {legible(name)!r} has other times than the one before it.", cure)
        found |= _signals(name, value["signals"], len(t))
    if times is not None:
        found.pop(TOUT, None)
        found = {TOUT: times, **found}
    if TOUT not in found:
        return _to_file(found)
    rows = np.size(found[TOUT])
    return {name: value for name, value in found.items() if name == TOUT or _has_rows(value, rows)}


def _has_rows(value: object, rows: int) -> bool:
    """Return whether a variable is a signal; a workspace that is saved whole holds parameters too."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim in (1, 2) and len(value) == rows


def _signals(variable: str, signals: Any, rows: int) -> dict[str, Any]:
    """Return the signals of a structure with time, by the name of the variable, of the line or of the block."""
    listed = [*np.atleast_1d(np.asarray(signals, dtype=object))] if not isinstance(signals, dict) else [signals]
    found: dict[str, Any] = {}
    for k, one in enumerate(listed):
        given = [one.get(key, "") for key in ("label", "blockName")]  # an empty text is an empty array to SciPy
        label, block = (text.strip() if isinstance(text, str) else "" for text in given)
        name = variable if len(listed) == 1 and variable != "yout" else label or block.rpartition("/")[2]
        name = re.sub(r"\W+", "_", name).strip("_") or f"{variable}_{k + 1}"
        values = np.asarray(one["values"])
        if values.ndim == 3 and values.shape[-1] == rows:  # a matrix for each time
            values = np.moveaxis(values, -1, 0).reshape(rows, -1)
        found[name if name not in found else f"{variable}_{k + 1}"] = values
    return found


def _to_file(held: dict[str, Any]) -> dict[str, Any]:
    """Return the time and the rows of a matrix that To File wrote; other variables as they are."""
    if len(held) != 1:
        return held
    name, value = next(iter(held.items()))
    matrix = np.asarray(value)
    is_one = matrix.ndim == 2 and matrix.dtype.kind == "f" and 2 <= len(matrix) < matrix.shape[1]
    if not is_one or np.any(np.diff(matrix[0]) < 0):
        return held
    return {TOUT: matrix[0], name: matrix[1] if len(matrix) == 2 else matrix[1:].T}
