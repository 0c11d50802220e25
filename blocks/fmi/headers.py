"""The headers of the standard, as C texts."""

from __future__ import annotations

from pathlib import Path


def standard_headers(fmi: int) -> dict[str, str]:
    name = f"fmi{fmi}.h"
    return {name: (Path(__file__).parent / "c" / name).read_text(encoding="utf-8")}
