"""A run that goes on, and what was set in the session, follow the file through gestures and their undoing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from blocks.server import gestures, knobs  # noqa: F401  # their messages
from blocks.server.editor import Editor
from blocks.server.messages import answer
from blocks.server.session import Session

from .test_editor import Ask


@pytest.fixture
def paused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Ask, Session, Callable[[], float]]]:
    """A gain of kk = 20 V behind a constant, in a run that stands; and what the gain gives in its next step."""
    monkeypatch.setattr("blocks.server.session.LOOK", 1e6)
    session = Session(Editor(tmp_path / "gain.json"))

    def ask(do: str, **fields: object) -> dict[str, object]:
        return answer(session, {"do": do, **fields}) or {}

    def stepped() -> float:
        live = session.live
        assert live is not None
        ask("step")
        live.results()  # which waits for the step
        return float(live.rows()[1][-1, live.columns["gain.y"][0]])

    ask("define", kind="parameter", text="kk=20 V")
    ask("insert", entry={"type": "Gain"}, text="k==kk")
    ask("insert", entry={"type": "Constant"}, text="value=1", sink="gain.u")
    ask("define", kind="entry", text="run.stop=1000")
    ask("run", pace=1.0)
    ask("pause")
    yield ask, session, stepped
    session.close()


def test_a_run_takes_what_is_put_undone_and_done_again_in_the_unit_of_the_file(paused: Any) -> None:
    ask, session, stepped = paused
    assert stepped() == 20.0
    for do, fields, expected in (
        ("put", {"name": "kk", "text": "22 mV"}, 0.022),
        ("put", {"name": "kk", "text": "23"}, 0.023),  # in the unit that stands in the field
        ("undo", {}, 0.022),
        ("undo", {}, 20.0),
        ("redo", {}, 0.022),
        ("undo", {}, 20.0),
        ("put", {"name": "constant.value", "text": "3"}, 60.0),
        ("put", {"name": "constant.value", "text": ""}, 20.0),  # its default is 1
    ):
        assert ask(do, **fields)["later"] == ""
        assert stepped() == pytest.approx(expected, rel=1e-15)
    turned = len(session.live.turned)
    ask("describe", of="kk", text="a gain")
    assert len(session.live.turned) == turned


def test_what_a_run_does_not_take_is_told_for_each_gesture(paused: Any) -> None:
    ask, _, stepped = paused
    assert "cannot be set" in ask("put", name="gain.k", text="=2*kk")["later"]
    assert ask("edit", operations=[{"unwire": "gain.u"}])["later"] == "the diagram has faults."
    assert stepped() == 20.0


def test_a_value_of_the_session_gives_way_to_what_is_written_or_undone(paused: Any) -> None:
    ask, session, stepped = paused
    for text, expected in (("6", 6.0), ("6", 6.0)):  # once it is in the file already
        ask("set", name="kk", value=5)
        assert stepped() == 5.0
        ask("put", name="kk", text=text)
        assert (session.values, stepped()) == ({}, expected)
    ask("stop")
    assert session.live.wait(60.0)
    ask("set", name="kk", value=5)
    ask("undo")
    assert session.values == {}
    ask("run", pace=1.0)
    ask("pause")
    assert stepped() == 20.0
