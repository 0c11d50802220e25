"""What must be there before an example of an explanation is run.

GIVEN holds a function by code; it gets the folder in which the example runs, and pytest's monkeypatch.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram
from blocks.engines.run.saved_state import packed
from blocks.text.explanations import explained


def a_large_file(folder: Path, patch: pytest.MonkeyPatch) -> None:
    (folder / "measured.json").write_bytes(b" " * 20_000_000)


def no_pyarrow(folder: Path, patch: pytest.MonkeyPatch) -> None:
    patch.setitem(sys.modules, "pyarrow", None)
    patch.setitem(sys.modules, "pyarrow.parquet", None)


def an_old_state(folder: Path, patch: pytest.MonkeyPatch) -> None:
    run = Diagram.from_json(json.loads(explained("W302")[1].example.files["growth.json"])).start()
    run.advance_to(0.25)
    (folder / "old.state").write_bytes(packed(replace(run.snapshot(), equations=None)))


def a_fault_of_blocks(folder: Path, patch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise KeyError("omega")

    patch.setattr("blocks.api.diagram.Diagram.load", fail)


GIVEN: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {
    "E008": a_large_file,
    "E504": no_pyarrow,
    "E901": a_fault_of_blocks,
    "W302": an_old_state,
}
