"""What FMUs call: their messages and intermediate updates, through one function of each kind for all instances.

The functions stay as long as the process, for an FMU may still say something while it is freed. The instance
that speaks is known by a number that it was given. Nothing that happens in there can be raised through the FMU's own
code: it is deferred until the FMU has returned.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import sys
import weakref
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import Any


class Called:
    """An instance as its FMU calls it. raised: what was deferred. intermediate: gives the time of an early return."""

    fmi: int

    def __init__(self, name: str) -> None:
        self.name = name
        self.raised: BaseException | None = None
        self.intermediate: Callable[[float], float | None] | None = None
        self.number = next(_numbers)
        _all[self.number] = self

    def hear(self, status: int, category: bytes | None, text: bytes | None) -> None:
        raise NotImplementedError


_numbers = itertools.count(1)
_all: weakref.WeakValueDictionary[int, Called] = weakref.WeakValueDictionary()


def instances() -> list[Any]:
    """All instances that there are."""
    return list(_all.values())


def _found(number: int | None, name: bytes | None) -> Called | None:
    """The instance that speaks. Some FMUs of FMI 2 do not hand the number on; then the name must do."""
    instance = _all.get(number or 0)
    if instance is None and name:
        same = [candidate for candidate in instances() if candidate.fmi == 2 and candidate.name.encode() == name]
        instance = same[0] if len(same) == 1 else None
    return instance


def _hear_2(number: int | None, name: bytes | None, status: int, category: bytes | None, text: bytes | None) -> None:
    instance = None
    try:
        instance = _found(number, name)
        if instance is not None:
            instance.hear(status, category, text)
    except BaseException as error:
        _put_off(instance, error)


def _hear_3(number: int | None, status: int, category: bytes | None, text: bytes | None) -> None:
    _hear_2(number, None, status, category, text)


def _update_3(
    number: int | None, t: float, set_: bool, get: bool, finished: bool, may: bool, early: Any, at: Any
) -> None:
    instance = None
    try:
        early[0] = False
        instance = _all.get(number or 0)
        if instance is not None and instance.intermediate is not None and instance.raised is None:
            asked = instance.intermediate(t)
            if asked is not None and may:
                early[0], at[0] = True, asked
    except BaseException as error:
        _put_off(instance, error)
        if may:
            early[0], at[0] = True, t


def _put_off(instance: Called | None, error: BaseException) -> None:
    if instance is not None and instance.raised is None:
        instance.raised = error


_CODES = {function.__code__ for function in (_hear_2, _hear_3, _update_3)}


def is_called(frame: FrameType | None) -> bool:
    """Whether a frame was reached from the code of an FMU: what is raised there is lost."""
    while frame is not None:
        if frame.f_code in _CODES:
            return True
        frame = frame.f_back
    return False


@lru_cache(maxsize=1)
def callbacks_of_3() -> tuple[Any, Any]:
    from fmpy import fmi3

    return fmi3.fmi3LogMessageCallback(_hear_3), fmi3.fmi3IntermediateUpdateCallback(_update_3)


@lru_cache(maxsize=1)
def _logger_of_2() -> object:
    from fmpy import fmi2

    return fmi2.fmi2CallbackLoggerTYPE(_hear_2)


def callbacks_of_2(number: int) -> Any:
    """The callbacks. stepFinished is none: steps are done when they return."""
    import fmpy
    from fmpy import fmi2

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = _logger_of_2()
    # The functions of C themselves: nothing of Python is in the way when an FMU frees its memory, at whatever time.
    callbacks.allocateMemory = ctypes.cast(fmpy.calloc, fmi2.fmi2CallbackAllocateMemoryTYPE)
    callbacks.freeMemory = ctypes.cast(fmpy.free, fmi2.fmi2CallbackFreeMemoryTYPE)
    callbacks.componentEnvironment = number
    formatted = _formatting()
    if formatted is not None:
        formatted(ctypes.byref(callbacks))
    return callbacks


@lru_cache(maxsize=1)
def _formatting() -> Any:
    """FMPy's function that wraps a logger and formats messages as printf does; None where there is none.

    It knows one logger in a process, the last. A copy of its library for this package alone keeps these
    messages apart from those for FMPy's other users.
    """
    try:
        from fmpy import logging
    except (ImportError, OSError, AttributeError):
        return None
    library = None
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            memory = os.memfd_create("blocks-fmi2-logging")
            os.write(memory, Path(logging.logging._name).read_bytes())
            # It stays open: a second library under the same name would be taken for this one.
            library = ctypes.CDLL(f"/proc/self/fd/{memory}")
    if library is None:
        return logging.addLoggerProxy
    add_proxy = library.addLoggerProxy
    add_proxy.argtypes, add_proxy.restype = [ctypes.c_void_p], None
    return add_proxy
