"""How much memory there is: what the system has left, and what limits leave of it to this process."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import math
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

resource: Any = None
with contextlib.suppress(ImportError):  # Windows, and Python in a browser, have no such limits
    import resource

LEAST = 32 * 2**20
"""Bytes that a run leaves free, for what is done with the results."""
INTERVAL = 0.1  # s between two looks
COUNTS = 64  # more than host_statistics64 gives
NONE = 2**60  # bytes; a larger limit is none


class NoRoom(MemoryError):
    """A run that would soon take more memory than there is, and is better ended while it can be."""


class Watch:
    """Looks now and then whether a run may go on."""

    def __init__(self) -> None:
        self.next = time.perf_counter() + INTERVAL

    def look(self, recorded: float, copies: float) -> None:
        """recorded: bytes of the rows; so many times that is needed for results of them. Raises NoRoom where that
        would be more than `for_recording` gave.
        """
        now = time.perf_counter()
        if now < self.next:
            return
        self.next = now + INTERVAL
        # copies * recorded = 2/3 (recorded + available), as `for_recording` has it.
        if available() < max((1.5 * copies - 1.0) * recorded, LEAST):
            raise NoRoom


def for_recording() -> float:
    """How many bytes a run may take for its rows and for making results of them; inf where that is unknown.

    Two thirds of what there is: the rest is for what is done with the results, and for others.
    """
    return available() * 2 / 3


def told(size: float) -> str:
    """A number of bytes for people."""
    for unit, name in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size / 1e3:.3g} kB"


def available() -> float:
    """Bytes that this process may still take without swapping; inf where that is not known."""
    return max(0.0, min((_system(), *_limits()), default=math.inf))


def _system() -> float:
    """What the system has left."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, ValueError, KeyError, IndexError):
            return _linux(int(time.perf_counter() / INTERVAL))
        return math.inf
    if sys.platform == "win32":
        return _windows()
    return _mac() if sys.platform == "darwin" else math.inf


@functools.lru_cache(maxsize=1)
def _linux(interval: int) -> float:
    """interval: its number, as many short runs need not read this again. Raises as files and their contents do."""
    with open("/proc/meminfo", "rb") as stream:
        lines = dict(line.split(b":") for line in stream if line.count(b":") == 1)
    if b"MemAvailable" in lines:
        return 1024.0 * int(lines[b"MemAvailable"].split()[0])
    return 1024.0 * sum(int(lines[name].split()[0]) for name in (b"MemFree", b"Cached"))


def _windows() -> float:
    class Status(ctypes.Structure):  # MEMORYSTATUSEX
        _fields_ = [
            ("length", ctypes.c_uint32), ("load", ctypes.c_uint32),
            *((name, ctypes.c_uint64) for name in (
                "total", "left", "total_page", "left_page", "total_virtual", "left_virtual", "left_extended",
            )),
        ]  # fmt: skip

    status = Status(length=ctypes.sizeof(Status))
    kernel = getattr(ctypes, "windll", None)
    if kernel is None or not kernel.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return math.inf
    # What is committed must fit into memory and page files together.
    return float(min(status.left, status.left_page))


def _mac() -> float:
    """Free and inactive pages, by host_statistics64(HOST_VM_INFO64)."""
    try:
        system = ctypes.CDLL(None)
        system.mach_host_self.restype = ctypes.c_uint32
        pages, count = (ctypes.c_uint32 * COUNTS)(), ctypes.c_uint32(COUNTS)
        if system.host_statistics64(system.mach_host_self(), 4, pages, ctypes.byref(count)):
            return math.inf
        return float((pages[0] + pages[2]) * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def _limits() -> Iterator[float]:
    """What each limit leaves that holds for this process, or for a control group that it is in."""
    if resource is None:
        return
    limits = []
    for name, field in (("RLIMIT_AS", 0), ("RLIMIT_DATA", 5)):
        kind = getattr(resource, name, None)
        if kind is not None and (limit := resource.getrlimit(kind)[0]) != resource.RLIM_INFINITY:
            limits.append((limit, field))
    if limits:
        with contextlib.suppress(OSError, ValueError, IndexError):
            with open("/proc/self/statm", "rb") as stream:
                pages = stream.read().split()
            for limit, field in limits:
                yield float(limit) - int(pages[field]) * resource.getpagesize()
    for group in _groups(os.getpid()):
        with contextlib.suppress(OSError, ValueError, KeyError):
            yield group.left()


class _ControlGroup:
    """A control group with a limit of memory."""

    def __init__(self, folder: Path, limit: str, used: str, cached: bytes) -> None:
        self.limit, self.used, self.stat, self.cached = folder / limit, folder / used, folder / "memory.stat", cached

    def left(self) -> float:
        """Bytes. Files that are cached make room when it is needed. Raises OSError, ValueError where nothing is set."""
        limit = int(self.limit.read_bytes())  # "max" is no number
        if limit > NONE:
            raise ValueError("no limit")
        lines = dict(line.split(b" ", 1) for line in self.stat.read_bytes().splitlines())
        return float(limit) - int(self.used.read_bytes()) + int(lines.get(self.cached, 0))


@functools.lru_cache(maxsize=1)
def _groups(process: int) -> tuple[_ControlGroup, ...]:
    """The groups of a process that have a limit, up to the outermost one that is seen from here."""
    return tuple(_found(Path("/")))


def _found(root: Path) -> Iterator[_ControlGroup]:
    """root: of the file system."""
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        _, kinds, path = line.split(":", 2)
        if kinds and "memory" not in kinds.split(","):
            continue
        top = root / "sys/fs/cgroup" / ("memory" if kinds else "")
        names = ("memory.max", "memory.current", b"inactive_file")
        if kinds:
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", b"total_inactive_file")
        # In a container the path may be that of the host, which is not seen from inside.
        inner = Path(*Path(path).parts[1:])
        for folder in (inner, *inner.parents) if inner.parts else (inner,):
            group = _ControlGroup(top / folder, *names)
            with contextlib.suppress(OSError, ValueError, KeyError):
                group.left()
                yield group
