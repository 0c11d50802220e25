"""E0xx: reading a file."""

from __future__ import annotations

from .explanation import Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {}
