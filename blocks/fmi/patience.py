"""Ctrl-C while compiled code runs that calls back into Python: it waits until that code has returned.

Nothing can be raised through the code of an FMU. Python looks for signals where a function begins; so one that came in
the meantime would be raised at the first line of what the FMU calls, before any `try`, and be lost there with a trace.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from .callbacks import is_called

_waiting: list[Callable[[int, FrameType | None], None]] = []


@contextmanager
def patient(is_inside: Callable[[], bool] = lambda: False) -> Iterator[Callable[[], None]]:
    """Ctrl-C within is raised when the yielded function is called; a second one at once, but not through an FMU.

    is_inside: whether one may be raised at once, as while a program of the user's runs. In other threads, and where
    Ctrl-C has another handler, this changes nothing.
    """
    pressed: list[int] = []

    def press(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        if (len(pressed) > 1 or is_inside()) and not is_called(frame):
            raise KeyboardInterrupt

    def look_up() -> None:
        if pressed:
            raise KeyboardInterrupt

    with _heard_by(press):
        yield look_up


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ctrl-C within is not raised at all: what ends FMUs and removes their folders comes to its own end.

    Much of that is done in finalizers, and what is raised there is lost, with a trace.
    """
    with _heard_by(lambda number, frame: None):
        yield


@contextmanager
def _heard_by(press: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    before: Any = signal.getsignal(signal.SIGINT)
    is_raised = before is signal.default_int_handler
    # Ignored, as in the background of a shell: SIGTERM may still come.
    if threading.current_thread() is not threading.main_thread() or not (is_raised or before is signal.SIG_IGN):
        yield
        return
    _waiting.append(press)
    if is_raised:
        signal.signal(signal.SIGINT, press)
    try:
        yield
    finally:
        if is_raised:
            signal.signal(signal.SIGINT, before)
        _waiting.remove(press)


def pressed_again(number: int, frame: FrameType | None) -> bool:
    """Another signal counts as Ctrl-C for what is patient now; False where nothing is."""
    if _waiting:
        _waiting[-1](number, frame)
    return bool(_waiting)
