"""E2xx, W2xx: FMUs."""

from __future__ import annotations

from .explanation import Explanation

__all__ = ["EXPLAINED"]

EXPLAINED: dict[str, Explanation] = {}
