"""`blocks live` and `blocks edit`: a diagram in the browser."""

from __future__ import annotations

import argparse
import contextlib
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from ..text.errors import Fault, UsageError
from .option_values import assignments, case_of
from .options import (
    Verbs,
    takes_engine,
    takes_inputs,
    takes_json,
    takes_library,
    takes_parameters,
    takes_trust,
    takes_variants,
)  # fmt: skip
from .output import emit, printable
from .stop_signals import INTERRUPTED, end_now

LOOK = 0.5
"""Seconds between two looks at whether Ctrl-C was pressed, which Windows does not tell who waits for a question."""


def add(verbs: Verbs) -> None:
    live = verbs.add_parser(
        "live",
        help="draw and run a diagram in the browser",
        description="Draw a diagram in the browser, run it there, and change its parameters while it runs. This "
        "command is the server, for this machine only; Ctrl-C ends it.",
    )
    live.add_argument("diagram", metavar="DIAGRAM", help="a diagram file (JSON)")
    _takes(live)
    live.set_defaults(verb=_live, edit=False)
    edit = verbs.add_parser(
        "edit",
        help="draw a diagram in the browser, and run it there",
        description="Edit a diagram file in the browser: each change is written to the file at once, and can be "
        "undone. It can run there, too. This command is the server, for this machine only; Ctrl-C ends it.",
    )
    what = "a diagram file (JSON), created if it does not exist (default: the newest diagram in this folder and below)"
    edit.add_argument("diagram", metavar="DIAGRAM", nargs="?", help=what)
    _takes(edit)
    edit.set_defaults(verb=_live, edit=True)


def _takes(live: argparse.ArgumentParser) -> None:
    live.add_argument("--port", metavar="N", type=int, default=0, help="port of 127.0.0.1 (default: a free one)")
    live.add_argument("--no-browser", action="store_true", help="print the address, and do not open a browser")
    takes_parameters(live)
    takes_inputs(live)
    takes_variants(live)
    takes_engine(live)
    takes_trust(live)
    takes_json(live, "print the address as a JSON object, and do not open a browser")
    live.add_argument("--host", help=argparse.SUPPRESS)
    takes_library(live)


def _live(options: argparse.Namespace) -> int:
    if options.host is not None:
        port = options.port or 8000
        cure = f"To reach it from another machine: ssh -L {port}:127.0.0.1:{port} HOST there, and --port {port} here."
        raise UsageError(
            Fault(
                "E501",
                f"--host {options.host}",
                "is refused: the server accepts connections from this machine only.",
                cure,
            )
        )
    if options.diagram is None:
        options.diagram = _newest()
    # What cannot be is told before there is an address.
    if options.edit and not os.path.exists(options.diagram):
        from ..server.editor import write_blank

        write_blank(Path(options.diagram))
    if not os.path.isfile(options.diagram):
        from ..api.diagram import Diagram

        Diagram.load(options.diagram)
    from ..server.live_server import LiveServer

    case = case_of(argparse.Namespace(**{**vars(options), "input": ()}))

    questions: queue.SimpleQueue[tuple[str, Callable[[bool], None]]] = queue.SimpleQueue()

    def asks(question: str, answer: Callable[[bool], None]) -> None:
        questions.put((question, answer))

    server = LiveServer(
        options.diagram,
        case.updated(inputs=assignments("--input", options.input, "r=1.5 rad/s")),
        library=options.library,
        asks=asks if sys.stdin.isatty() and sys.stdout.isatty() and not options.json else None,
        port=options.port,
        edit=options.edit,
    )
    # Before the diagram is read, which takes longer: a page that comes early waits.
    if options.json:
        emit({"event": "live", "url": server.url})
    else:
        how = "is edited" if options.edit else "is live"
        print(printable(f"{options.diagram} {how} at {server.url} (Ctrl-C ends it)"), flush=True)
    try:
        server.start()
        if not options.no_browser and not options.json and _has_screen():
            threading.Thread(target=_open, args=(server.ticket,), daemon=True).start()
        while True:
            with contextlib.suppress(queue.Empty):
                question, answer = questions.get(timeout=LOOK)
                answer(_says_yes(question))
    except KeyboardInterrupt:  # as other signals come here, too
        return INTERRUPTED
    finally:
        try:
            server.stop()
        except KeyboardInterrupt:
            end_now()


def _says_yes(question: str) -> bool:
    """Whether the user at the terminal answers yes to a question, after what was typed before it was asked is gone."""
    if sys.platform != "win32":
        import termios

        if _is_behind():
            print(printable(f"{question} Bring this command to the foreground to answer: fg"), flush=True)
        while _is_behind():
            time.sleep(LOOK)
        with contextlib.suppress(termios.error):
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
    try:
        return input(printable(f"{question} [y/N] ")).strip().lower() in ("y", "yes")
    except (EOFError, OSError):  # OSError: the terminal is gone
        print(flush=True)
        return False


def _is_behind() -> bool:
    """Return whether this command is in the background of its shell, which stops it if it reads from the terminal."""
    if sys.platform == "win32":
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp()
    except OSError:  # the terminal is gone
        return False


def _newest() -> str:
    """The diagram of this folder that was written last. Raises UsageError (E501) where there is none."""
    from ..server.palette import diagrams_in

    found = [*diagrams_in(Path())]
    if not found:
        raise UsageError(
            Fault("E501", "edit", "finds no diagram in this folder.", "Name a file to create: blocks edit new.json")
        )
    return str(max(found, key=lambda path: path.stat().st_mtime))


def _has_screen() -> bool:
    """Whether a browser can open a window: one that runs in the terminal would take it from this command."""
    return sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")))


def _open(url: str) -> None:
    import webbrowser

    webbrowser.open(url)
