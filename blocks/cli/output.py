"""What commands say: text for a person, objects for a program."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TextIO

from ..text.errors import Fault
from .excerpts import Excerpts

__all__ = ["counted", "emit", "fault_entry", "fault_lines", "printable", "say", "silence", "tell_faults", "waiting"]


LONG = 0.7  # s that nobody need be told what is being done
LATE = 30.0  # s


def say(text: str) -> None:
    """Tell a person something. Where that cannot be written, nobody is told, and the work goes on."""
    try:
        print(printable(text), file=sys.stderr, flush=True)
    except OSError:
        silence(sys.stderr)


@contextlib.contextmanager
def waiting(word: str, *, late: str = "", quiet: bool = False) -> Iterator[None]:
    """On a terminal, a word where what is inside takes long; `late`, where it takes very long, elsewhere too."""
    soon, then = threading.Timer(LONG, say, (word,)), threading.Timer(LATE, say, (late,))
    said = [soon] if sys.stderr.isatty() and not quiet else []
    said += [then] if late and not quiet else []
    for one in said:
        one.daemon = True
        one.start()
    try:
        yield
    finally:
        for one in said:
            one.cancel()


def silence(stream: TextIO) -> None:
    """Nothing goes any more to a stream that could not be written: else Python tries it again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def tell_faults(faults: Sequence[Fault], as_json: bool, *, file: str = "") -> None:
    """Faults as text on stderr; with --json also as objects on stdout, where a program looks for them.

    On a terminal the lines that they speak of follow. file: the one that those are about that name none.
    """
    for line in fault_lines(faults, sys.stderr, more=not as_json):
        say(line)
    for fault in faults if as_json else ():
        emit(fault_entry(fault, file))


def fault_lines(faults: Sequence[Fault], stream: TextIO, *, more: bool = True) -> Iterator[str]:
    """A line for each fault. On a terminal: with the lines of the files, and how to read on where `more` is wanted."""
    is_terminal = stream.isatty()
    excerpts = Excerpts()
    for fault in faults:
        yield str(fault)
        if is_terminal:
            yield from excerpts.of(fault)
    codes = list(dict.fromkeys(fault.code for fault in faults if not fault.is_warning))
    if is_terminal and more and codes:
        yield f"`blocks explain {codes[0]}` tells more."


def fault_entry(fault: Fault, file: str = "") -> dict[str, Any]:
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


def emit(entry: Mapping[str, Any]) -> None:
    print(json.dumps(_finite(entry)), flush=True)


def _finite(value: Any) -> Any:
    """JSON knows neither NaN nor infinity: null stands for them."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
