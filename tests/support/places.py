"""Where things lie in the checkout."""

from __future__ import annotations

from pathlib import Path

__all__ = ["DIAGRAMS", "FMUS", "GOLDEN", "PAPER", "ROOT", "SUPPORT"]

SUPPORT = Path(__file__).resolve().parent
ROOT = SUPPORT.parents[1]
DIAGRAMS, FMUS, PAPER, GOLDEN = ROOT / "diagrams", ROOT / "fmus", ROOT / "diagrams" / "paper", SUPPORT / "golden"
