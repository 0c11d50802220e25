"""E6xx: compiled code."""

from __future__ import annotations

from .explanation import Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {}
