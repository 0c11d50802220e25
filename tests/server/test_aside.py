"""What is computed aside while gestures go on: it is of the diagram as it stood when it was asked."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, Gain, Integrator, Relay, TransferFunction, ZeroOrderHold
from blocks.server import analysis_messages, gestures, knobs  # noqa: F401  # the messages that they answer
from blocks.server.editor import Editor
from blocks.server.messages import ASIDE, HANDLERS
from blocks.server.session import Session

from .test_analysis_messages import loop
from .test_knobs import Page

GAINS = [0.5 + 0.25 * k for k in range(4)]
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


@pytest.mark.parametrize("how", ["cancel", "disconnected", "close"])
def test_an_analysis_ends_when_nobody_waits_for_it_any_more(
    how: str, page: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, simulates, is_over = page.session, threading.Event(), threading.Event()
    check = Session.check_wanted

    def checked(self: Session) -> None:
        if self._job is not None and threading.current_thread() is session._second and simulates_now():
            simulates.set()
            while not self._job.is_dropped:  # as if the run up to there took very long
                assert not is_over.wait(0.01)
        check(self)

    def simulates_now() -> bool:
        return any(frame.name == "_again" for frame in traceback.extract_stack())

    live = session.begin(stop=1.0)
    live.go()
    assert live.wait(60.0)
    monkeypatch.setattr(Session, "check_wanted", checked)
    asked = page.ask("modes", at=0.5)
    assert simulates.wait(60.0)
    if how == "cancel":
        page.ask("cancel", of=asked)
        told = page.answers()[asked]
        assert (told["is"], told["faults"][0]["message"]) == ("error", "was cancelled.")
    elif how == "disconnected":
        session.disconnected(page)
        assert page.has_answer.acquire(timeout=60.0)
        assert not session._aside.qsize()
    session.close()
    is_over.set()


def searched(searches: str) -> Diagram:
    """A loop of two rates, or of a relay, or a servo with a gain."""
    if searches == "servo":
        return loop(1.0)
    made = Diagram(searches)
    made.add("back", Gain(k=-1.0))
    wires = {"back.u": "plant.y"}
    if searches == "relay":
        made.add("plant", TransferFunction(num=[1.0], den=[1.0, 3.0, 3.0, 1.0]))
        made.add("switch", Relay(on_at=0.0, off_at=0.0, on=1.0, off=-1.0))
        wires |= {"switch.u": "back.y", "plant.u": "switch.y"}
    else:
        made.add("plant", Integrator())
        made.add("fast", ZeroOrderHold(period=0.1))
        made.add("slow", ZeroOrderHold(period=0.25))
        wires |= {"fast.u": "back.y", "slow.u": "fast.y", "plant.u": "slow.y"}
    for sink, source in wires.items():
        made.wire(sink, source)
    return made


@pytest.mark.parametrize(
    ("diagram", "message", "search"),
    [
        ("servo", {"do": "response", "input": "gain.y"}, "frequency/margins.py"),
        ("servo", {"do": "response", "input": "r", "output": "angle.y"}, "frequency/figure_curves.py"),
        ("servo", {"do": "modes", "at": "rest"}, "linear/operating_point.py"),
        ("rates", {"do": "response", "input": "back.y"}, "frequency/lifted.py"),
        ("relay", {"do": "cycles", "at": "start"}, "linear/limit_cycles.py"),
    ],
)
def test_a_search_ends_when_it_is_cancelled(
    diagram: str, message: dict[str, Any], search: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched(diagram).save(tmp_path / "searched.json")
    session, searches = Session(Editor(tmp_path / "searched.json")), threading.Event()
    page, check, is_over = Asking(session), Session.check_wanted, threading.Event()

    def checked(self: Session) -> None:
        if any(Path(frame.filename).as_posix().endswith(search) for frame in traceback.extract_stack()):
            searches.set()
            while self._job is not None and not self._job.is_dropped:  # as if the search took very long
                if is_over.wait(0.01):
                    break
        check(self)

    monkeypatch.setattr(Session, "check_wanted", checked)
    asked = page.ask(**message)
    assert searches.wait(60.0)
    page.ask("cancel", of=asked)
    told = page.answers()[asked]
    is_over.set()
    assert (told["is"], told.get("faults", [{}])[0].get("message")) == ("error", "was cancelled.")


def test_what_a_closed_page_asked_for_is_dropped(page: Asking, monkeypatch: pytest.MonkeyPatch) -> None:
    is_closed, computed = threading.Event(), list[str]()

    def long(session: Session, *, name: str) -> dict[str, Any]:
        computed.append(name)
        assert is_closed.wait(60.0)
        return {"is": "long"}

    def save(session: Session) -> None:
        computed.append("save")

    monkeypatch.setitem(HANDLERS, "long", long)
    monkeypatch.setitem(HANDLERS, "save", save)
    monkeypatch.setattr("blocks.server.session.ASIDE", ASIDE | {"long", "save"})
    other = Asking(page.session)
    page.ask("long", name="first")
    for k in range(3):
        other.ask("long", name=f"of the closed page {k}")
    page.ask("long", name="last")
    other.ask("save")  # a file counts, too
    other.ask("put", name="gain.k", text="3")  # a gesture counts, though its page is closed at once
    page.session.disconnected(other)
    assert other.has_answer.acquire(timeout=60.0)  # that of the gesture
    while other in page.session.pages:
        assert not is_closed.wait(0.01)
    is_closed.set()
    assert {one["is"] for one in page.answers().values()} == {"long"}
    assert computed == ["first", "last", "save"]
    assert page.session.document.shown.value.blocks["gain"].parameters["k"] == 3


def test_a_time_that_the_run_did_not_reach_is_refused_at_once(page: Asking) -> None:
    before = page.ask("modes", at=1e9)
    page.ask("step")
    later = page.ask("modes", at=1e9)
    told = page.answers()
    assert [told[number]["faults"][0]["place"] for number in (before, later)] == ["at", "at"]
    assert "no run has reached t = 1e+09 s: it is at" in told[later]["faults"][0]["message"]
