"""Locks of open files: each lasts until its file is closed or its process ends."""

from __future__ import annotations

import contextlib
import sys

LOCKS = False  # Windows has none of this kind, nor has Python in a browser
if sys.platform != "win32":
    with contextlib.suppress(ImportError):
        import fcntl

        LOCKS = True


def lock(handle: int, *, wait: bool = False) -> None:
    """Lock an open file; with wait, as soon as no other process holds it. Raises OSError if one does or none exist."""
    if sys.platform == "win32" or not LOCKS:
        raise OSError("There are no locks.")
    fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)


def hold(handle: int) -> bool:
    """Lock an open file where locks exist. Return False if another process holds it."""
    try:
        lock(handle)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
