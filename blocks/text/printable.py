"""Names and paths as messages may show them."""

from __future__ import annotations

from .json_text import quoted

__all__ = ["legible"]


def legible(text: str) -> str:
    """A name or a path for a message: as it is, or quoted where it is long or holds what a terminal would obey."""
    return text if len(text) <= 200 and text.isprintable() else quoted(text)
