"""What must be there before an example of an explanation is run.

GIVEN holds a function by code; it gets the folder in which the example runs, and pytest's monkeypatch.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def a_large_file(folder: Path, patch: pytest.MonkeyPatch) -> None:
    (folder / "measured.json").write_bytes(b" " * 80_000_000)


def no_pyarrow(folder: Path, patch: pytest.MonkeyPatch) -> None:
    patch.setitem(sys.modules, "pyarrow", None)
    patch.setitem(sys.modules, "pyarrow.parquet", None)


def a_fault_of_blocks(folder: Path, patch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise KeyError("omega")

    patch.setattr("blocks.api.diagram.Diagram.load", fail)


GIVEN: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {
    "E008": a_large_file,
    "E504": no_pyarrow,
    "E901": a_fault_of_blocks,
}
