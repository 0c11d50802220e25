"""What commands say: text for a person, objects for a program."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import TextIO

from ..text.errors import Fault
from ..text.json_line import json_line

SOON = 0.5  # s before progress is shown
LONG = 0.7  # s before a message says what is being done
LATE = 30.0  # s


def say(text: str) -> None:
    """Print a message on stderr. Where it cannot be written, it is dropped, and the work goes on."""
    try:
        print(printable(text), file=sys.stderr, flush=True)
    except OSError:
        silence(sys.stderr)


@contextlib.contextmanager
def waiting(word: str, *, late: str = "", quiet: bool = False) -> Iterator[None]:
    """On a terminal, a word where the body takes long; `late`, where it takes very long, also without a terminal."""
    soon, then = threading.Timer(LONG, say, (word,)), threading.Timer(LATE, say, (late,))
    said = [soon] if sys.stderr.isatty() and not quiet else []
    said += [then] if late and not quiet else []
    for timer in said:
        timer.daemon = True
        timer.start()
    try:
        yield
    finally:
        for timer in said:
            timer.cancel()


class Progress:
    """A bar on stderr where it is a terminal and the work takes more than half a second; else a line per 10 %."""

    def __init__(self, quiet: bool) -> None:
        self.is_bar = sys.stderr.isatty() and not quiet
        self.begun = self.shown = self.said = time.perf_counter()
        self.tenth = 0
        self.is_drawn = False

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.perf_counter() - self.begun

    def left(self, share: float) -> str:
        """How long the rest takes if it goes on as up to a share: "12 s left"; "" where nothing is known."""
        whole = round(self.seconds * (1 - share) / share) if share > 0 else -1
        if whole < 0:
            return ""
        return f"{f'{whole} s' if whole < 120 else _minutes(whole)} left"

    def is_due(self) -> bool:
        """Whether it is time to show something again."""
        now = time.perf_counter()
        if now - self.shown < 0.1 or now - self.begun < SOON:
            return False
        self.shown = now
        return True

    def show(self, share: float, beside: str, line: str) -> None:
        """Show how much is done, from 0 to 1. beside: stands beside a bar; line: in a line of its own."""
        if self.is_bar:
            bar = "█" * int(30 * share) + "░" * (30 - int(30 * share))
            text = f"\r {bar} {share:4.0%}  {beside}  [Ctrl-C keeps the results so far]\x1b[K"
            print(text, end="", file=sys.stderr, flush=True)
            self.is_drawn = True
        elif int(10 * share) > self.tenth or self.shown - self.said > 10:
            self.tenth, self.said = int(10 * share), self.shown
            say(f"{int(100 * share)} %  {line}")

    def clear(self) -> None:
        if self.is_drawn:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _minutes(seconds: int) -> str:
    return f"{seconds // 60} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def silence(stream: TextIO) -> None:
    """Send to nowhere what goes to a stream that could not be written: else Python tries it again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def tell_faults(faults: Sequence[Fault], as_json: bool, *, file: str = "") -> None:
    """Faults as text on stderr; with --json also as objects on stdout, where a program looks for them.

    On a terminal the lines that they point to follow. file: the file of those that name none.
    """
    for line in fault_lines(faults, sys.stderr, more=not as_json):
        say(line)
    for fault in faults if as_json else ():
        emit(fault_entry(fault, file))


def fault_lines(faults: Sequence[Fault], stream: TextIO, *, more: bool = True) -> Iterator[str]:
    """Return a line for each fault. On a terminal, add lines of the files and, if `more`, how to learn more."""
    is_terminal = stream.isatty()
    excerpts = Excerpts()
    for fault in faults:
        yield str(fault)
        if is_terminal:
            yield from excerpts.of(fault)
    codes = list(dict.fromkeys(fault.code for fault in faults if not fault.is_warning))
    if is_terminal and more and codes:
        yield f"`blocks explain {codes[0]}` explains it."


def fault_entry(fault: Fault, file: str = "") -> dict[str, object]:
    return {
        "event": "fault",
        "code": fault.code,
        "place": fault.place,
        "message": fault.message,
        "cure": fault.cure,
        "file": fault.file or file,
        "line": fault.line,
        "column": fault.column,
    }


def printable(text: str) -> str:
    """Names from files may hold control characters, which a terminal would obey."""
    return "".join(c if c.isprintable() or c == "\n" else f"\\x{ord(c):02x}" for c in text)


def emit(entry: Mapping[str, object]) -> None:
    print(json_line(entry), flush=True)


LARGEST = 16 * 2**20  # bytes, as much as a diagram file may have
MOST = 50
WIDTH = 100  # characters of a line
BEFORE = 40  # of them before the place, where a line is longer

# What stands at a place: a string, or a word, or one character.
_token = re.compile(r'"(?:[^"\\]|\\.)*"|[\w.+-]+|.', re.DOTALL).match


class Excerpts:
    """The lines of files that faults point to, as a terminal shows them; each file is read once.

    12 |   "motor.v": "control.w",
       |              ^^^^^^^^^^^
    """

    def __init__(self) -> None:
        self._files: dict[str, list[str]] = {}
        self._count = 0

    def of(self, fault: Fault) -> Iterator[str]:
        """Two lines for a fault whose line is known: what stands there, and where."""
        if not fault.line or self._count >= MOST:
            return
        lines = self._lines(fault.file)
        if fault.line > len(lines):
            return
        line, at = lines[fault.line - 1], fault.column - 1
        if not 0 <= at <= len(line):
            return
        self._count += 1
        token = _token(line, at)
        length = len(token[0]) if token else 1
        first = max(0, at - BEFORE) if len(line) > WIDTH else 0
        shown = "".join(c if c.isprintable() else " " for c in line[first : first + WIDTH])
        cut = "..." if first else ""
        shown = f"{cut}{shown}{'...' if first + WIDTH < len(line) else ''}"
        mark = " " * (at - first + len(cut)) + "^" * max(1, min(length, WIDTH - (at - first)))
        margin = max(4, len(str(fault.line)))
        yield f"  {fault.line:{margin}} | {shown}"
        yield f"  {'':{margin}} | {mark}"

    def _lines(self, file: str) -> list[str]:
        if file not in self._files:
            try:
                with open(file, "rb") as stream:
                    data = stream.read(LARGEST + 1)
                # The lines of the reader: they end at \n alone.
                self._files[file] = [] if len(data) > LARGEST else data.decode("utf-8", "replace").split("\n")
            except (OSError, ValueError):
                self._files[file] = []
        return self._files[file]
