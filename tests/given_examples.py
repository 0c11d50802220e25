"""What must be there before an example of an explanation is run.

GIVEN holds a function by code; it gets the folder in which the example runs, and pytest's monkeypatch.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


def a_large_file(folder: Path, patch: pytest.MonkeyPatch) -> None:
    (folder / "measured.json").write_bytes(b" " * 20_000_000)


GIVEN: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {
    "E008": a_large_file,
}
