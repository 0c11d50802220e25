"""E7xx: linear models and frequency responses."""

from __future__ import annotations

from .explanation import Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {}
