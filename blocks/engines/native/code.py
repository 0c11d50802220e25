"""Compiled code of a run, which may begin without optimisation and becomes faster on the way."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from ...compile.toolchain import apart
from ...compile.toolchain.compiler import TranslationUnit, build, build_quickly, load
from ...text.errors import CompilerError

QUICKLY = True  # whether runs may begin by code without optimisation; benchmarks of steps say no
PATIENCE = 0.05
"""s; what has run so long without optimisation is worth a compiler's time."""


class Code:
    """The library of some units. prepare: called with each library that is loaded, before it is used.

    is_quick: it may begin with code that is compiled in a quarter to a half of the time, and computes the same bits,
    unless the cache has the optimised one. Raises CompilerError (E60x).
    """

    library: ctypes.CDLL

    def __init__(
        self,
        units: Sequence[TranslationUnit],
        prepare: Callable[[ctypes.CDLL], None],
        *,
        extra_flags: Sequence[str] = (),
        is_quick: bool = False,
    ) -> None:
        self._units, self._prepare, self._extra_flags = units, prepare, extra_flags
        self._slow_seconds = 0.0  # that code without optimisation has run
        self._optimising: Optimising | None = None
        quick = build_quickly(units, extra_flags=extra_flags) if is_quick and QUICKLY else None
        path, is_optimised = quick or (self._built(), True)
        self._take(path, is_optimised=is_optimised)

    def _built(self) -> Path:
        return build(self._units, extra_flags=self._extra_flags)

    def _take(self, path: Path, *, is_optimised: bool = True) -> None:
        """Take the code of a library. Runs under way go on by it, or by the old one, which stays loaded."""
        library = load(path)
        self._prepare(library)
        self.library, self.is_optimised = library, is_optimised

    def optimise(self) -> None:
        """Take the optimised code now. Raises CompilerError (E60x)."""
        if not self.is_optimised:
            self._take(self._built())

    def hurry(self, seconds: float) -> None:
        """Take the optimised code if it is there; begin to make it, in a thread, once the code without optimisation has
        run for a while. seconds: that it has run since this was asked last."""
        if self.is_optimised:
            return
        self._slow_seconds += seconds
        if self._optimising is None or self._optimising.process != os.getpid():  # a fork has no such thread
            if self._slow_seconds >= PATIENCE:
                self._optimising = Optimising(self._units, self._extra_flags)
        elif self._optimising.path is not None:
            try:
                self._take(self._optimising.path)
            except CompilerError:  # the cache was emptied meanwhile
                self._optimising, self._slow_seconds = None, 0.0


class Optimising:
    """A thread that waits for a compiler. path: of the library, once it is there.

    A compiler that fails leaves the slower code. Where this process ends first, the compiler goes on, so that the next
    one finds its code.
    """

    def __init__(self, units: Sequence[TranslationUnit], extra_flags: Sequence[str]) -> None:
        self.path: Path | None = None
        self.process = os.getpid()
        self._thread = threading.Thread(target=self._compile, args=(units, extra_flags), daemon=True)
        self._thread.start()

    def _compile(self, units: Sequence[TranslationUnit], extra_flags: Sequence[str]) -> None:
        # While a process ends, new threads are refused by RuntimeError, closed pipes by ValueError.
        with contextlib.suppress(CompilerError, OSError, RuntimeError, ValueError):
            if not apart.is_possible() or apart.built_apart(units, extra_flags):
                self.path = build(units, extra_flags=extra_flags)
