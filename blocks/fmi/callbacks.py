"""What FMUs call: their messages and intermediate updates, through one function of each kind for all instances.

The functions stay as long as the process, for an FMU may still say something while it is freed. Which instance speaks
is told by a number that it was given. Nothing that happens in there can be raised through the FMU's own code: it is put
off until the FMU has come back.
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

__all__ = ["Called", "callbacks_of_2", "callbacks_of_3", "is_called"]


class Called:
    """What an instance is for the FMU. raised: what was put off. intermediate: gives the time of an early return."""

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


def _found(number: int | None, name: bytes | None) -> Called | None:
    """The instance that speaks. Some FMUs of FMI 2 do not hand the number on; then the name must do."""
    found = _all.get(number or 0)
    if found is None and name:
        same = [one for one in list(_all.values()) if one.fmi == 2 and one.name.encode() == name]
        found = same[0] if len(same) == 1 else None
    return found


def _hear_2(number: int | None, name: bytes | None, status: int, category: bytes | None, text: bytes | None) -> None:
    one = None
    try:
        one = _found(number, name)
        if one is not None:
            one.hear(status, category, text)
    except BaseException as error:
        _put_off(one, error)


def _hear_3(number: int | None, status: int, category: bytes | None, text: bytes | None) -> None:
    _hear_2(number, None, status, category, text)


def _update_3(
    number: int | None, t: float, set_: bool, get: bool, finished: bool, may: bool, early: Any, at: Any
) -> None:
    one = None
    try:
        early[0] = False
        one = _all.get(number or 0)
        if one is not None and one.intermediate is not None and one.raised is None:
            asked = one.intermediate(t)
            if asked is not None and may:
                early[0], at[0] = True, asked
    except BaseException as error:
        _put_off(one, error)
        if may:
            early[0], at[0] = True, t


def _put_off(one: Called | None, error: BaseException) -> None:
    if one is not None and one.raised is None:
        one.raised = error


_CODES = {function.__code__ for function in (_hear_2, _hear_3, _update_3)}


def is_called(frame: FrameType | None) -> bool:
    """Whether the code of an FMU is on the way to a frame: what is raised there is lost."""
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
def _logger_of_2() -> Any:
    from fmpy import fmi2

    return fmi2.fmi2CallbackLoggerTYPE(_hear_2)


def callbacks_of_2(number: int) -> Any:
    """The callbacks. stepFinished is none: steps are done when they return."""
    import fmpy
    from fmpy import fmi2

    made = fmi2.fmi2CallbackFunctions()
    made.logger = _logger_of_2()
    # The functions of C themselves: nothing of Python is in the way when an FMU frees its memory, at whatever time.
    made.allocateMemory = ctypes.cast(fmpy.calloc, fmi2.fmi2CallbackAllocateMemoryTYPE)
    made.freeMemory = ctypes.cast(fmpy.free, fmi2.fmi2CallbackFreeMemoryTYPE)
    made.componentEnvironment = number
    formatted = _formatting()
    if formatted is not None:
        formatted(ctypes.byref(made))
    return made


@lru_cache(maxsize=1)
def _formatting() -> Any:
    """FMPy's function that puts itself before a logger and formats what comes as to printf; None where there is none.

    It knows one logger in a process, the last. A copy of its library for this package alone keeps what FMPy's own
    users hear apart from what is heard here.
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
    found = library.addLoggerProxy
    found.argtypes, found.restype = [ctypes.c_void_p], None
    return found
