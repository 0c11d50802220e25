"""What a live diagram shows when its files change, go, or say nothing that can be run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from blocks import BlocksError
from blocks.server import knobs, panel  # noqa: F401  # their messages
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session

GAIN = {"type": "Gain", "parameters": {"k": 0.5}}
LOOP: dict[str, Any] = {
    "format": "blocks-diagram", "version": 3, "name": "loop", "inputs": {"u": {"default": 1.0}},
    "blocks": {"gain": {**GAIN, "variants": {"other": GAIN}}, "inner": {"diagram": "inner.json"}},
    "wires": {"gain.u": "u"}, "run": {"stop": 1},
}  # fmt: skip
INNER = {"format": "blocks-diagram", "version": 3, "blocks": {"one": {"type": "Constant"}}}


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr("blocks.server.session.LOOK", 1e6)  # it does not look by itself
    (tmp_path / "inner.json").write_text(json.dumps(INNER))
    (tmp_path / "loop.json").write_text(json.dumps(LOOP))
    made = Session(Document(tmp_path / "loop.json"))
    yield made
    made.close()


def looked(session: Session) -> list[str]:
    """The codes of its faults after a look at the files."""
    if session.document.has_changed() and session.document.read():
        session.tell_document()
    return [fault.code for fault in session.document.faults]


def test_a_variant_that_the_file_has_lost_is_a_fault_until_it_is_reset(session: Session, tmp_path: Path) -> None:
    answer(session, {"do": "variant", "path": "gain", "name": "other"})
    (tmp_path / "loop.json").write_text(json.dumps({**LOOP, "blocks": {**LOOP["blocks"], "gain": GAIN}}))
    assert looked(session) == ["E122"]
    hello = session.hello()
    assert hello["svg"].startswith("<svg")
    assert hello["document"]["faults"][0]["block"] == "gain"
    assert answer(session, {"do": "panel", "path": "gain"}) is not None
    with pytest.raises(BlocksError, match="E122"):
        answer(session, {"do": "run"})
    answer(session, {"do": "reset", "name": "gain"})
    assert looked(session) == []
    assert session.begin() is session.live


def test_a_file_that_cannot_be_read_is_drawn_as_it_was_and_not_run(session: Session, tmp_path: Path) -> None:
    """As `blocks run` would not run it. A run that goes on does."""
    live = session.begin()
    assert session.document.facts
    (tmp_path / "loop.json").write_bytes(b"\xff")
    assert looked(session) == ["E001"]
    assert session.hello()["svg"].startswith("<svg")
    assert session.document.facts == {}
    for message in ({"do": "run"}, {"do": "set", "name": "gain.k", "value": 2}, {"do": "keep"}):
        with pytest.raises(BlocksError, match=r"E001|faults"):
            answer(session, message)
    assert session.live is live
    revision = session.document.revision
    assert looked(session) == ["E001"]
    assert session.document.revision == revision  # which pages are told once
    live.go()
    assert live.wait(60)
    assert live.state == "done"


def test_a_file_inside_is_missed_and_found_again(session: Session, tmp_path: Path) -> None:
    (tmp_path / "inner.json").unlink()
    assert "E007" in looked(session)
    opened = Document(tmp_path / "loop.json")
    assert "E007" in [fault.code for fault in opened.faults]
    (tmp_path / "inner.json").write_text(json.dumps(INNER))
    assert looked(session) == []
    assert opened.has_changed()
    assert opened.read()
    assert opened.faults == ()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_what_stands_in_place_of_a_file_for_a_while_is_not_waited_for(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    text = path.read_text()
    for replace in (lambda: None, path.mkdir, lambda: os.mkfifo(path)):
        path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)
        replace()
        assert looked(session) == []
        assert session.begin().state == "paused"  # what was read stays open
    path.unlink()
    path.write_text(text.replace("0.5", "0.25"))
    assert session.document.has_changed()
    assert session.document.read()
    assert session.document.facts["gain.k"].was == "0.25"
