"""Saved states taken apart and put together again, to damage them."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["damaged"]

Rows = dict[str, Any]


def damaged(path: Path, made: Path, damage: Callable[[dict[str, Any], Rows], None]) -> Path:
    """Write a state whose tree of JSON and whose rows of numbers were changed by `damage`."""
    with zipfile.ZipFile(path) as archive:
        tree, data = json.loads(archive.read("state.json")), archive.read("rows")
    rows, first = Rows(), 0
    for name, (kind, shape) in tree["rows"].items():
        rows[name] = np.frombuffer(data, kind, math.prod(shape), first).reshape(shape).copy()
        first += rows[name].nbytes
    damage(tree, rows)
    if isinstance(tree.get("rows"), dict):
        tree["rows"] = {name: [row.dtype.str, list(row.shape)] for name, row in rows.items()}
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("state.json", json.dumps(tree))
        archive.writestr("rows", b"".join(row.tobytes() for row in rows.values()))
    return made
