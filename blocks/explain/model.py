"""E1xx, W1xx: the model."""

from __future__ import annotations

from .explanation import Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {}
