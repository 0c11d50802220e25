"""Warnings that point to the line of the user's program that called blocks."""

from __future__ import annotations

import sys
import warnings

_BETWEEN = ("blocks", "contextlib", "functools")


def warn_user(message: str) -> None:
    """Issue a RuntimeWarning at the nearest caller outside of blocks, however many calls lie between."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _BETWEEN:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, RuntimeWarning, stacklevel=level)
