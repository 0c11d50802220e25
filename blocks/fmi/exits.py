"""`exit` in the code of an FMU that runs in this process: it ends Python too, with the FMU's exit code, say 0.

`exit` does not return. But C first calls what is registered with `atexit`, on the stack of its caller: so the FMU is
reported, what was computed is written, and the process ends with the code of an error. The stack itself shows whether
an FMU called: so calls of FMUs cost nothing more, and those that compiled code makes count too. An exit of the
program itself does not come here: Python ends before it, and unregisters the hook.

A process that an FMU forks may end in any way, for no run ends with it.

Not caught: `_exit`, `quick_exit` and signals, and any exit on systems other than Linux with glibc and macOS. Where an
FMU has a process of its own (`isolation`), all of these are errors.

References: Itanium C++ ABI, 3.3.6 (__cxa_atexit, __cxa_finalize); backtrace(3), dladdr(3).
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

from ..text.errors import Fault, FMUError
from .callbacks import instances, is_called

DEEPEST = 1000
"""Functions on the stack that are looked at."""

_watched: dict[str, str] = {}  # the folders of FMUs that run in this process, and what these are called in messages
_python = [os.getpid()]  # the process of this Python: one that an FMU forks is its own, and not known here
if sys.platform != "win32":
    os.register_at_fork(after_in_child=lambda: _python.__setitem__(0, os.getpid()))
_tellers: list[tuple[int, Callable[[FMUError], int]]] = []


class Ended(FMUError):
    """An FMU ended the run inside code that cannot end it: no failure. It holds the fault of `fmi.instance.ended`."""


@contextlib.contextmanager
def telling(tell: Callable[[FMUError], int]) -> Iterator[None]:
    """Within, `tell` is called where an FMU ends this process; it returns the exit code. That FMU is called no more."""
    entry = os.getpid(), tell
    _tellers.append(entry)
    try:
        yield
    finally:
        _tellers.remove(entry)


def watch(folder: Path, place: str) -> None:
    """From now on an exit in a library of that folder is reported as one of the FMU `place`."""
    if _hook() is not None:
        _watched[os.path.realpath(folder)] = place


def forget(folder: Path) -> None:
    _watched.pop(os.path.realpath(folder), None)


class _Symbol(ctypes.Structure):
    """Dl_info: the library and the function that an address lies in."""

    _fields_ = [
        ("library", ctypes.c_char_p), ("base", ctypes.c_void_p), ("name", ctypes.c_char_p), ("at", ctypes.c_void_p),
    ]  # fmt: skip


@lru_cache(maxsize=1)
def _hook() -> object:
    """What C calls at an exit, registered once and kept; None where that cannot be."""
    c = ctypes.CDLL(None)
    try:
        if sys.platform != "darwin":
            c["gnu_get_libc_version"]  # other libraries of C do not take back what was registered
        register, take_back, _ = c["__cxa_atexit"], c["__cxa_finalize"], c.backtrace
    except AttributeError:
        return None
    hook = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_at_exit)
    mine = ctypes.cast(hook, ctypes.c_void_p)  # by which it is known
    _libraries()  # whatever is loaded for looking at stacks is loaded now
    if register(hook, None, mine):
        return None

    def end() -> None:
        _watched.clear()  # taking it back calls it
        take_back(mine)

    atexit.register(end)
    return hook


def _libraries() -> Iterator[str]:
    """The files that the functions on the stack come from, the innermost first."""
    c = ctypes.CDLL(None)
    addresses, symbol = (ctypes.c_void_p * DEEPEST)(), _Symbol()
    for k in range(c.backtrace(addresses, DEEPEST)):
        if c.dladdr(ctypes.c_void_p(addresses[k]), ctypes.byref(symbol)) and symbol.library:
            yield os.fsdecode(symbol.library)


def _at_exit(_: object) -> None:
    # An exit in a callback of this program is its own.
    if not _watched or os.getpid() != _python[0] or is_called(sys._getframe()):
        return
    folder = next((watched for library in _libraries() if (watched := _folder_of(library))), "")
    if not folder:
        return
    status = FMUError.exit_status
    try:
        error = _error(folder)
        mine = [tell for process, tell in _tellers if process == os.getpid()]
        try:
            status = (mine or [_tell])[-1](error)
        except BaseException:
            _tell(error)
    finally:
        _end(status or FMUError.exit_status)


def _folder_of(library: str) -> str:
    path = os.path.realpath(library)
    return next((folder for folder in _watched if path.startswith(folder + os.sep)), "")


def _error(folder: str) -> FMUError:
    """The error (E216); after that no function of the FMU is called any more."""
    ended = [instance for instance in instances() if os.path.realpath(instance.binding.folder) == folder]
    for instance in ended:
        instance.lose()
    place = _watched[folder]
    names = {instance.name for instance in ended}
    message = f"{place} ended the process: its code called exit."
    cure = 'Run it in its own process: "isolate": true (--isolate).'
    return FMUError(Fault("E216", names.pop() if len(names) == 1 else place, message, cure))


def _tell(error: FMUError) -> int:
    with contextlib.suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"{error}\n")
    return error.exit_status


def _end(status: int) -> None:
    from ..text.atomic_write import drop_parts
    from .archive import drop_folders

    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    with contextlib.suppress(Exception):
        drop_parts()
        drop_folders()
        ctypes.CDLL(None).fflush(None)
    os._exit(status)
