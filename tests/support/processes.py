"""Processes that a test has started, as Linux tells them."""

from __future__ import annotations

import contextlib
from pathlib import Path

__all__ = ["children", "lives", "maps"]


def children() -> set[int]:
    """All processes of this one, zombies too."""
    found: set[int] = set()
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            found |= {int(word) for word in (task / "children").read_text().split()}
    return found


def lives(process: int) -> bool:
    """Whether there is such a process that has not ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def maps(process: int, name: str) -> bool:
    """Whether a process has loaded a file whose path holds `name`."""
    with contextlib.suppress(OSError):
        return name in Path(f"/proc/{process}/maps").read_text()
    return False
