"""Signals that end a command. The first one ends a run after its step, and what it has computed is written; a second
one ends the command at once, also where the code of an FMU does not come back.

SIGTERM, and SIGHUP where it exists, are heard as Ctrl-C is. Handlers of a program that calls `main` itself stay.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

from ..fmi.patience import pressed_again
from .output import say

INTERRUPTED = 128 + int(signal.SIGINT)
ENDING = tuple(number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None)) is not None)
PATIENCE = 3.0  # s that Python has to end by itself after the second signal
QUIET = 2.0  # s after the first signal without a message


class Heard:
    """The signals since a command began."""

    def __init__(self) -> None:
        self.first = 0
        self.count = 0
        self.passed_on = 0  # how many SIGINTs are from `pass_on`
        self.told = 0.0  # when the last one came
        self.lock = threading.RLock()
        self.source, self.sink = socket.socketpair()
        self.source.setblocking(False)
        self.sink.setblocking(False)

    @property
    def status(self) -> int:
        """The exit code of what was ended by a signal."""
        self.take()
        return 128 + int(self.first or signal.SIGINT)

    def pass_on(self, number: int, frame: Any) -> None:
        """Another signal counts as Ctrl-C, which runs can handle."""
        if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, signal.SIG_DFL, None):  # begun in the background
            if not pressed_again(number, frame):
                raise KeyboardInterrupt
            return
        self.passed_on += 1
        signal.raise_signal(signal.SIGINT)

    def take(self) -> bool:
        """Count what has come; False where no more can come."""
        with self.lock:
            try:
                numbers = self.source.recv(64)
            except BlockingIOError:
                return True
            for number in numbers:
                if number == signal.SIGINT and self.passed_on:
                    self.passed_on -= 1
                elif number == signal.SIGINT or number in ENDING:
                    self.first = self.first or number
                    self.count += 1
                    self.told = time.monotonic()
            return bool(numbers)

    def watch(self) -> None:
        """Count the signals as they come, whatever the main thread is doing."""
        is_told = False
        while True:
            select.select([self.source], [], [], None if not self.count else 0.2)
            if not self.take():
                return
            silent = time.monotonic() - self.told if self.count else 0.0
            if self.count == 1 and silent > QUIET and not is_told:
                is_told = True
                say("interrupted: the run ends after this step; a second Ctrl-C ends it at once")
            if self.count > 1 and silent > PATIENCE:
                end(self.status)


def end(status: int) -> None:
    """End this process without its main thread, which does not return from a call."""
    from ..fmi.archive import drop_folders
    from ..text.atomic_write import drop_parts

    drop_parts()
    drop_folders()
    os._exit(status)


_heard: list[Heard] = []


def end_now() -> None:
    """End this process although a thread does not come back, as in the code of an FMU."""
    end(_heard[-1].status if _heard else INTERRUPTED)


def ended_at_once() -> None:
    """Raise KeyboardInterrupt where a second signal has come."""
    if _heard and _heard[-1].take() and _heard[-1].count > 1:
        raise KeyboardInterrupt


@contextlib.contextmanager
def hearing() -> Iterator[Heard]:
    """Handle signals in this context, in the main thread."""
    heard = Heard()
    thread = threading.Thread(target=heard.watch, daemon=True, name="signals")
    before: dict[int, Any] = {}
    is_main = threading.current_thread() is threading.main_thread()
    earlier = signal.set_wakeup_fd(heard.sink.fileno(), warn_on_full_buffer=False) if is_main else -1
    _heard.append(heard)
    try:
        for number in ENDING if is_main else ():
            if signal.getsignal(number) is signal.SIG_DFL:  # else it is handled already, by nohup for example
                before[number] = signal.signal(number, heard.pass_on)
        thread.start()
        yield heard
    finally:
        _heard.remove(heard)
        for number, handler in before.items():
            signal.signal(number, handler)
        if is_main:
            signal.set_wakeup_fd(earlier)
        heard.sink.close()
        if thread.ident is not None:
            thread.join()
        heard.source.close()
