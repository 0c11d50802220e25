"""The question at the terminal of `blocks edit`."""

from __future__ import annotations

import os
import sys
from unittest.mock import Mock

import pytest

from blocks.cli import live


@pytest.mark.skipif(sys.platform == "win32", reason="there is no job control")
def test_a_command_in_the_background_reads_from_the_terminal_only_in_the_foreground(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever reads or flushes the terminal in the background is stopped, and the page freezes."""
    in_front = [-1, -1, -1]  # another group, for three looks
    touched: list[str] = []

    def touch(*_: object) -> str:
        assert not in_front
        touched.append("y")
        return "y"

    monkeypatch.setattr(live, "LOOK", 0.0)
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: in_front.pop() if in_front else os.getpgrp())
    monkeypatch.setattr(sys, "stdin", Mock())
    monkeypatch.setattr("termios.tcflush", touch)
    monkeypatch.setattr("builtins.input", touch)
    assert live._says_yes("May it?")
    assert touched == ["y", "y"]
    assert capsys.readouterr().out == "May it? Bring this command to the foreground to answer: fg\n"
