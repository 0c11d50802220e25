"""Names and paths as messages may show them."""

from __future__ import annotations

from .json_text import quoted

__all__ = ["legible", "one_line"]


def legible(text: str) -> str:
    """A name or a path for a message: as it is, or quoted where it is long or holds what a terminal would obey."""
    return text if len(text) <= 200 and text.isprintable() else quoted(text)


def one_line(text: str) -> str:
    """What another program, or a damaged file, says, for a message: its first 300 characters, ? for what is no letter.

    Of several lines one is made.
    """
    return "".join(char if char.isprintable() else "?" for char in " ".join(text.split())[:300])
