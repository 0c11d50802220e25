"""The examples of explanations, run as they stand."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from blocks.cli import main
from blocks.text.errors import BlocksError
from blocks.text.explanations.explanation import Example
from tests.support import given_examples, given_fmus
from tests.support.places import ROOT

GIVEN = {**given_examples.GIVEN, **given_fmus.GIVEN}
"""What makes the things that lie beside an example: by code, a function of the folder and of pytest's monkeypatch."""


class Ran:
    """What an example printed, line by line, and how it ended: an exit status, or the exception."""

    def __init__(self, lines: list[str], status: int | None = None, error: BlocksError | None = None) -> None:
        self.lines, self.status, self.error = lines, status, error


def command(text: str, patch: pytest.MonkeyPatch) -> Ran:
    """Run one command line, before which the environment may be set as in a shell: CC=false blocks doctor."""
    words = shlex.split(text)
    while re.fullmatch(r"[A-Z_]+=.*", words[0]):
        patch.setenv(*words.pop(0).split("=", 1))
    assert words[0] == "blocks"
    with printed() as out, warnings.catch_warnings():
        warnings.simplefilter("always")
        try:
            status = main(words[1:])
        except SystemExit as ended:  # argparse
            status = int(ended.code or 0)
    return Ran(out.getvalue().splitlines(), status)


def script(text: str) -> Ran:
    """Run a script; an exception of blocks is told as at the end of a traceback."""
    error = None
    with printed() as out, warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: print(message)
        try:
            exec(compile(text, "example.py", "exec"), {"__name__": "__main__"})
        except BlocksError as raised:
            error = raised
            print(raised)
    return Ran(out.getvalue().splitlines(), None, error)


@contextlib.contextmanager
def printed() -> Iterator[io.StringIO]:
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
        yield stream


def run(example: Example, patch: pytest.MonkeyPatch) -> Ran:
    """Run an example in the current folder."""
    for name, text in example.files.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(text, encoding="utf-8")
    if example.kind == "diagram":
        Path("loop.json").write_text(example.text, encoding="utf-8")
        return command("blocks check loop.json", patch)
    return command(example.text, patch) if example.kind == "shell" else script(example.text)


SOURCES = ROOT / "blocks"
