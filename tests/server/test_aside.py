"""What is computed aside while gestures go on: it is of the diagram as it stood when it was asked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from blocks.server import deeper, gestures, knobs  # noqa: F401  # the messages that they answer
from blocks.server.editor import Editor
from blocks.server.messages import ASIDE, HANDLERS
from blocks.server.session import Session

from .test_deeper import loop
from .test_knobs import Page

GAINS = [0.5 + 0.25 * k for k in range(8)]
"""Below 6, from where on the loop is not stable: the gain margin is 6/k."""


class Asking(Page):
    """A page that waits for its answers."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session, self.asked, self.has_answer = session, 0, threading.Semaphore(0)
        session.connected(self)

    def ask(self, do: str, **fields: Any) -> int:
        self.asked += 1
        self.session.received(self, {"do": do, "id": self.asked, **fields})
        return self.asked

    def answered(self) -> None:
        self.has_answer.release()

    def answers(self) -> dict[int, dict[str, Any]]:
        """All, by the numbers of the questions."""
        for _ in range(self.asked):
            assert self.has_answer.acquire(timeout=60.0)
        self.session.close()  # after what was answered is sent
        return {told["re"]: told for told in self.got if isinstance(told, dict) and "re" in told}


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Asking]:
    loop(1.0).save(tmp_path / "servo.json")
    session = Session(Editor(tmp_path / "servo.json"))
    yield Asking(session)
    session.close()


def test_an_analysis_is_of_the_diagram_as_it_stood_when_it_was_asked(
    page: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_edited = threading.Event()

    def long(session: Session) -> dict[str, Any]:
        is_edited.wait(60.0)
        return {"is": "long"}

    monkeypatch.setitem(HANDLERS, "long", long)
    monkeypatch.setattr("blocks.server.session.ASIDE", ASIDE | {"long"})
    page.ask("long")
    first = page.ask("response", input="gain.y")
    page.ask("edit", operations=[{"remove": ["blocks", "gain"]}])
    page.ask("undo")
    page.ask("put", name="gain.k", text="3")
    second = page.ask("response", input="gain.y")
    page.ask("set", name="gain.k", value="1.5")
    third = page.ask("response", input="gain.y")
    page.ask("edit", operations=[{"remove": ["blocks", "gain"]}])
    fourth = page.ask("response", input="gain.y")
    while page.session.document.revision < 5:  # the gestures do not wait for what goes on aside
        assert not is_edited.wait(0.01)
    is_edited.set()
    told = page.answers()
    margins = [told[number]["margins"]["gain"] for number in (first, second, third)]
    assert margins == pytest.approx([6.0, 2.0, 4.0])
    assert told[fourth]["is"] == "error"


def test_gestures_that_come_while_analyses_run_change_none_of_them(page: Asking) -> None:
    wanted = {}
    for k in GAINS:
        page.ask("put", name="gain.k", text=repr(k))
        wanted[page.ask("response", input="gain.y")] = 6.0 / k
        page.ask("insert", entry={"type": "Gain"}, text="7", source="plant.y")
        page.ask("set", name="gain2.k", value="8")
        wanted[page.ask("response", input="gain.y")] = 6.0 / k
        page.ask("place", names=["plant"], by=[10.0, 0.0])
        page.ask("undo")
        page.ask("undo")
    told = page.answers()
    assert {number: told[number].get("margins", told[number])["gain"] for number in wanted} == pytest.approx(wanted)
    assert {one["is"] for one in told.values()} == {"edited", "analysis", "set"}
