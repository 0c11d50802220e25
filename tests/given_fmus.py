"""What must be there before an example of an explanation is run: FMUs, and machines that lack something.

GIVEN holds a function by code; it gets the folder in which the example runs, and pytest's monkeypatch.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

GIVEN: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {}
