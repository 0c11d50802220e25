"""Files to be read: plain ones, and nothing that blocks or never ends."""

from __future__ import annotations

import os
import stat
from io import BufferedReader
from pathlib import Path

INHERITED = ("/dev/fd/", "/dev/stdin", "/proc/self/fd/")
"""How the paths of pipes begin that this process inherited."""


def opened(path: str | Path) -> BufferedReader:
    """A plain file, open for reading. Raises OSError, also for a folder, a device, a pipe and a socket.

    A pipe that this process inherited is allowed, too: `--input <(command)`, `--input /dev/stdin`.
    """
    # A pipe would make the call wait for a writer.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISFIFO(mode) and str(path).startswith(INHERITED):
        os.set_blocking(descriptor, True)
    elif not stat.S_ISREG(mode):
        os.close(descriptor)
        what = "it is a folder" if stat.S_ISDIR(mode) else "it is a device or a pipe, not a file"
        raise OSError(0, what, str(path))
    return open(descriptor, "rb")
