"""Differences of two results, under the name that programs import: `from blocks.compare import compare`."""

from __future__ import annotations

from .results.comparison import TOLERANCE, Comparison, Difference, compare

__all__ = ["TOLERANCE", "Comparison", "Difference", "compare"]
