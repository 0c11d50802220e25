"""Which engine the tests run by: the reference engine, which is the meaning, unless the environment says otherwise.

`make test` runs the tests that say what happens in a run once more with BLOCKS_ENGINE=native. Code compiled for tests
stays apart from the user's.
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("BLOCKS_ENGINE", "reference")
os.environ.setdefault("BLOCKS_CACHE_DIR", str(Path(__file__).resolve().parent.parent / "build" / "test-cache"))
