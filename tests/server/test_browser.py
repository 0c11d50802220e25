"""The page of a live diagram in a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram
from blocks.server.document import Document
from blocks.server.session import Session
from blocks.server.transport import Transport, new_token

pytestmark = pytest.mark.long
PAPER = Path(__file__).resolve().parents[2] / "diagrams/paper/iadrc.json"


@contextmanager
def served(source: str | Path | Diagram) -> Iterator[tuple[str, Session]]:
    """The address of a diagram's page, and its session."""
    session = Session(Document(source))
    transport = Transport(new_token(), session.received, session.connected, session.disconnected)
    transport.start()
    try:
        yield transport.url, session
    finally:
        transport.stop()
        session.close()


def button(name: str) -> str:
    """JavaScript that gives the button with this name."""
    return f"[...document.querySelectorAll('button')].find(one => one.textContent.trim() === {name!r})"


def test_the_papers_robot_is_drawn_run_and_paused(chromium: Any) -> None:
    with served(PAPER) as (url, session), chromium() as page:
        page.open(url)
        page.until("document.querySelector('#drawing svg [data-path]')")
        page.evaluate(f"{button('Run')}.click()")
        page.until("document.querySelector('#runbar output').textContent.startsWith('running')")
        page.evaluate(f"{button('Pause')}.click()")
        page.until("document.querySelector('#runbar output').textContent.startsWith('paused')")
        assert session.running.state == "paused"
        page.assert_clean()
