"""What a page turns: values of the session, of its runs, and of the file."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

import blocks.server.knobs
import blocks.server.panel  # noqa: F401  # their messages
from blocks import Diagram
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session
from blocks.text.errors import ModelError, UsageError

from .test_browser import served

ROOT = Path(__file__).parents[2]
Do = Callable[..., dict[str, Any]]

LOOP = """{
 "format": "blocks-diagram",
 "version": 3,
 "name": "loop",
 "parameters": {
  "T":   {"value": 2000,  "unit": "ms", "doc": "time constant"}
 },
 "inputs": {
  "u": {"unit": "V", "default": 1.50},
  "d": {"unit": "V"}
 },
 "blocks": {
  "sum":  {"type": "Sum"},
  "gain": {"type": "Gain", "parameters": {"k": 0.50},
   "variants": {"other": {"type": "Gain", "parameters": {"k": 7}}}},
  "lag": {"type": "TransferFunction", "parameters": {"num": [1,  2], "den": [3, 2,   1]}}
 },
 "wires": {"sum.u1": "u", "sum.u2": "d", "gain.u": "sum.y", "lag.u": "gain.y"},
 "run": {"stop": 1, "method": "rk4", "step": 0.01, "inputs": {"d": {"value": 200, "unit": "mV"}}}
}
"""


class Page:
    """A client that remembers what it was sent."""

    def __init__(self) -> None:
        self.got: list[Any] = []

    def send(self, message: Any, slot: str = "") -> bool:
        self.got.append(message)
        return True

    def answered(self) -> None:
        pass


@pytest.fixture
def opened() -> Iterator[Callable[[Any], Session]]:
    made: list[Session] = []

    def open_(source: Any) -> Session:
        made.append(Session(Document(source)))
        return made[-1]

    yield open_
    for session in made:
        session.close()


@pytest.fixture
def loop(tmp_path: Path, opened: Callable[[Any], Session]) -> tuple[Path, Session, Do]:
    path = tmp_path / "loop.json"
    path.write_text(LOOP)
    session = opened(path)
    return path, session, asking(session)


def asking(session: Session) -> Do:
    def do(what: str, **fields: Any) -> dict[str, Any]:
        told = answer(session, {"do": what, **fields})
        assert told is not None
        return told

    return do


def ended(session: Session) -> Any:
    """Run to the end; the results."""
    live = session.live or session.begin()
    live.go()
    until = monotonic() + 60.0
    while live.state not in ("done", "failed") and monotonic() < until:
        sleep(0.005)
    assert live.state == "done"
    return live.results()


def stood(live: Any) -> None:
    """Wait until a run stands."""
    until = monotonic() + 60.0
    while live.state == "running" and monotonic() < until:
        sleep(0.001)
    assert live.state == "paused"


def test_keep_changes_the_characters_of_the_values_alone(loop: tuple[Path, Session, Do]) -> None:
    path, session, do = loop
    page = Page()
    session.connected(page)
    until = monotonic() + 60.0
    while not page.got and monotonic() < until:
        sleep(0.005)
    do("set", name="T", value=1250)
    do("set", name="gain.k", value="0.75")
    do("set", name="u", value="2500 mV")
    do("set", name="d", value=0.3)  # a slider has the declared unit, and the file keeps its own
    do("set", name="lag.den", value=["3", "4", "1"])
    kept = do("keep")
    new = LOOP.replace("2000", "1250").replace("0.50}", "0.75}").replace("1.50", "2.5").replace("200,", "300,")
    assert path.read_text() == new.replace("[3, 2,   1]", "[3, 4,   1]")
    assert len(kept["kept"]) == 5
    assert not session.values
    assert not session.inputs
    assert session.document.facts["T"].was == "1250 ms"
    assert [message["is"] for message in page.got[-2:]] == ["changed", "document"]
    assert not session.document.has_changed(), "no echo of one's own edit"


def test_a_unit_is_kept_and_a_default_becomes_an_entry(tmp_path: Path, opened: Callable[[Any], Session]) -> None:
    path = tmp_path / "motor_pid.json"
    shutil.copy(ROOT / "diagrams" / "motor_pid.json", path)
    old = path.read_text()
    session = opened(path)
    do = asking(session)
    do("set", name="motor.Ra", value="200 mOhm")
    do("set", name="voltage", value="10000 mV")
    do("set", name="kp", value=25)
    with pytest.raises(ModelError, match="is computed from other parameters"):
        do("set", name="control.kp", value=25)
    do("keep", names=["voltage", "motor.Ra"])
    new = old.replace('"value": 12,', '"value": 10,').replace(
        '"motor": {"type": "PMDCMotor"}',
        '"motor": {"type": "PMDCMotor", "parameters": {"Ra": {"value": 200, "unit": "mOhm"}}}',
    )
    assert path.read_text() == new
    assert list(session.values) == ["kp"]
    do("keep")
    assert path.read_text() == new.replace('"kp": {"value": 20,', '"kp": {"value": 25,')


def test_values_in_a_unit_with_an_offset_are_shown_in_the_declared_one(opened: Callable[[Any], Session]) -> None:
    diagram = Diagram("warm")
    diagram.parameter("T", 293.15, unit="K")
    diagram.output("y", diagram.input("hot", unit="K", default="20 degC"))
    diagram.output("z", diagram.input("cold", unit="degC", default="300 K"))
    session = opened(diagram)
    assert [session.document.facts[name].was for name in ("hot", "cold")] == ["293.15 K", "26.85 degC"]
    assert asking(session)("set", name="T", value="25 degC")["text"] == "298.15 K"


def test_keep_refuses_a_file_that_changed_and_one_that_would_say_something_else(
    tmp_path: Path, loop: tuple[Path, Session, Do], opened: Callable[[Any], Session]
) -> None:
    path, session, do = loop
    do("set", name="gain.k", value=2)
    path.write_text(LOOP.replace("2000", "1999"))
    with pytest.raises(UsageError, match="changed since it was read"):
        do("keep")
    assert path.read_text() == LOOP.replace("2000", "1999")
    assert session.values == {"gain.k": 2}
    shutil.copytree(ROOT / "diagrams" / "paper", tmp_path / "paper")
    before = (tmp_path / "paper" / "control_iadrc.json").read_bytes()
    do = asking(opened(tmp_path / "paper" / "iadrc.json"))
    do("set", name="control_left.nlsef.k1", value=[100, 2])
    with pytest.raises(UsageError, match="share a file"):
        do("keep")
    assert (tmp_path / "paper" / "control_iadrc.json").read_bytes() == before
    with pytest.raises(UsageError, match="has no file"):
        asking(opened(Diagram.load(path)))("keep")


def test_values_of_a_file_inside_go_there_and_are_read_again(
    tmp_path: Path, opened: Callable[[Any], Session]
) -> None:
    shutil.copytree(ROOT / "diagrams" / "paper", tmp_path / "paper")
    path, inner = tmp_path / "paper" / "wheel_iadrc.json", tmp_path / "paper" / "control_iadrc.json"
    old, before = inner.read_text(), path.read_bytes()
    session = opened(path)
    do = asking(session)
    name = "control.td.R"
    do("set", name=name, value=12)
    (change,) = do("keep")["kept"]
    assert (change["new"], inner.read_text().count("12"), path.read_bytes()) == ("12", old.count("12") + 1, before)
    assert (session.values, session.document.facts[name].was, session.document.has_changed()) == ({}, "12 1/s", False)
    inner.write_text(old)
    assert session.document.has_changed()
    assert session.document.read()
    assert session.document.facts[name].was == "16.8199 1/s"


def test_bad_values_leave_that_of_before(loop: tuple[Path, Session, Do]) -> None:
    _, session, do = loop
    do("set", name="gain.k", value=3)
    for name, value, code in (
        ("T", "2 kg", "E104"), ("T", "much", ""), ("T", "", "E501"), ("gain.kk", 1, "E502"), ("u", "2 A", "E502"),
        ("lag.den", "[1,", "E001"), ("gain.k", {"value": 1}, "E501"),
    ):  # fmt: skip
        with pytest.raises((UsageError, ModelError)) as caught:
            do("set", name=name, value=value)
        assert code in ("", caught.value.code), caught.value
    assert (session.values, session.inputs) == ({"gain.k": 3}, {})
    live = session.begin()
    with pytest.raises(UsageError, match="E117"):
        do("set", name="lag.den", value=[1, 2, 3, 4])
    assert (live.state, do("knobs", names=["lag.den"])["knobs"][0]["changed"]) == ("paused", False)
    do("set", name="lag.num", value=[1, 3], anew=True)
    assert session.values["lag.num"] == [1, 3]


def test_values_of_the_session_are_those_of_the_next_run(loop: tuple[Path, Session, Do]) -> None:
    path, session, do = loop
    do("set", name="gain.k", value=3)
    do("set", name="u", value="2 V")
    do("set", name="lag.den", value=[5, 4, 3, 2])
    do("variant", path="gain", name="other")
    live = ended(session)
    given: dict[str, Any] = {"gain.k": 3, "lag.den": [5, 4, 3, 2]}
    run = Diagram.load(path).run(parameters=given, inputs={"u": 2.0}, variants={"gain": "other"}, log=["lag.y"])
    assert np.array_equal(live["lag.y"], run["lag.y"])
    do("reset")
    assert do("knobs", names=[])["changed"] == []
    assert (session.values, session.inputs, session.document.variants) == ({}, {}, {})
    session.begin()
    assert np.array_equal(ended(session)["lag.y"], Diagram.load(path).run(log=["lag.y"])["lag.y"])


def test_a_variant_is_kept_with_the_values_of_its_parameters(loop: tuple[Path, Session, Do]) -> None:
    path, _, do = loop
    do("variant", path="gain", name="other")
    assert do("knobs", names=["gain.k"])["knobs"][0]["text"] == "7"
    do("set", name="gain.k", value=8)
    do("keep", names=["gain.k"])
    new = Diagram.load(path).to_json()["blocks"]["gain"]
    assert (new["variant"], new["variants"]["other"]["parameters"], new["parameters"]) == (
        "other", {"k": 8}, {"k": 0.5},
    )  # fmt: skip


def test_what_was_turned_is_listed_and_reset_in_the_run(loop: tuple[Path, Session, Do]) -> None:
    _, session, do = loop
    session.begin()
    told = do("set", name="T", value=1000)
    assert (told["text"], told["t"]) == ("1000 ms", 0.0)
    do("set", name="u", value=1)
    do("reset", name="T")
    told = do("knobs", names=["T", "u", "d", "gain.k"])
    assert told["turned"] == [[0, 0.0, "T", "1000 ms"], [0, 0.0, "u", "1 V"], [0, 0.0, "T", "2000 ms"]]
    assert do("knobs", names=[], since=2)["turned"] == told["turned"][2:]
    assert told["changed"] == [["u", "1 V", "1.50 V"]]
    T, u, d, k = told["knobs"]
    assert (T["value"], T["unit"], T["low"], T["high"], T["changed"]) == (2000.0, "ms", 0.0, 4000.0, False)
    assert (u["value"], u["changed"], k["text"], d["text"], d["value"]) == (1, True, "0.50", "0.2 V", 0.2)


def test_the_script_of_a_run_that_was_turned_gives_the_same_bits(loop: tuple[Path, Session, Do]) -> None:
    _, session, do = loop
    do("set", name="lag.den", value=[5, 4, 3])
    do("set", name="d", value="0.1 V")
    do("variant", path="gain", name="other")
    live = session.begin("1500 ms")
    for k in range(3):
        for _ in range(40):
            live.step()
            stood(live)
        do("set", name="T", value=1000 + 100 * k)
        do("set", name="u", value=f"{1 + k} V")
        do("set", name="gain.k", value=[7.5, 8.25, 1e-3][k])
    do("reset", name="gain.k")
    do("variant", path="gain", name="base")  # of the next run
    whole = ended(session)
    known: dict[str, Any] = {}
    exec(do("script")["text"], known)
    again = known["results"]
    assert [*again] == [*whole]
    assert again.t.tobytes() == whole.t.tobytes()
    assert again.values.tobytes() == whole.values.tobytes()
    assert whole.t[-1] == 1.5


def test_a_run_that_fails_tells_its_block_and_what_came_in(opened: Callable[[Any], Session]) -> None:
    entry = {"type": "Integrator", "parameters": {"y_start": 1}}
    square = {"type": "Product"}
    inner = {"outputs": {"y": "x.y"}, "blocks": {"x": entry, "square": square}}
    inner["wires"] = {"x.u": "square.y", "square.u1": "x.y", "square.u2": "x.y"}
    file = {"format": "blocks-diagram", "version": 3, "name": "f", "blocks": {"in": {"diagram": inner}}}
    session = opened(Diagram.from_json({**file, "run": {"stop": 2}}))
    live = session.begin()
    live.go()
    assert live.wait(60.0)
    told = session.run_told()
    assert (told["state"], told["start"], told["stop"], told["faults"][0]["block"]) == ("failed", 0.0, 2.0, "in.x")
    failing = told["failing"]
    assert (failing["block"], failing["signals"][0], len(failing["t"])) == ("in.x", "in.square.y", len(failing["rows"]))
    rows = live.results()
    assert [row[0] for row in failing["rows"]] == rows["in.square.y"][-len(failing["t"]) :].tolist()


@pytest.mark.long
def test_the_robot_is_slid_turned_kept_and_replayed_in_the_browser(tmp_path: Path, chromium: Any) -> None:
    shutil.copytree(ROOT / "diagrams" / "paper", tmp_path / "paper")
    path = tmp_path / "paper" / "iadrc.json"
    with served(path) as server, chromium() as page:
        page.open(server.url)
        page.until("document.querySelector('#panel .knob')")
        session = server._open
        page.click("[aria-label='Put torque on the board']")
        page.evaluate("document.querySelector('#runbar select').value = '10'")
        page.press(" ")
        page.until("document.querySelector('#runbar .told').textContent.startsWith('running')")
        x, y = page.center(".board input[type=range]")
        page.drag(x, y, x + 40, y)
        page.until("document.querySelector('.changes').textContent.includes('torque')")
        slider = "document.querySelector('.board input[type=range]')"
        assert page.evaluate(f"{slider}.getAttribute('aria-valuetext')").endswith(" N.m")
        # A value counts without Return, with a unit; a bad one is refused where it stands, and the run goes on.
        fill(page, "#board-torque", "3500 mN.m")
        page.until("document.querySelector('.changes').textContent.includes('= 3.5 N.m')")
        fill(page, "#board-torque", "2 kg")
        page.until("document.querySelector('.board .error').textContent.includes('E104')")
        fill(page, "#panel-heading", "30 deg")
        page.until("document.querySelector('#panel .error button')?.textContent === 'Run anew with heading = 30 deg'")
        page.evaluate("document.activeElement.blur()")
        page.press(" ")
        page.until("document.querySelector('#runbar .told').textContent.startsWith('paused')")
        assert session.values["torque"] == {"value": 3500, "unit": "mN.m"}
        rows = session.running.results()
        known: dict[str, Any] = {}
        exec(asking(session)("script")["text"], known)
        assert known["results"].values.tobytes() == rows.values.tobytes()
        page.click("#panel .error button")
        page.until("document.querySelector('#runbar .told').textContent.startsWith('running')")
        assert session.running.prepared.parameters["heading"] == {"value": 30, "unit": "deg"}
        page.click(".changes [aria-label^='Keep torque']")
        page.until("!document.querySelector('.changes').textContent.includes('torque')")
        assert '"torque": {"value": 3.5, "unit": "N.m"' in path.read_text()
        page.assert_clean()


@pytest.mark.long
def test_typed_values_stay_elements_have_fields_and_expressions_follow(tmp_path: Path, chromium: Any) -> None:
    path = tmp_path / "loop.json"
    text = LOOP.replace('"parameters": {\n', '"parameters": {"K": 2, "L": "=3*K",\n', 1)
    path.write_text(text)
    with served(path) as server, chromium() as page:
        page.open(server.url)
        page.until("document.querySelector('#panel-K')")
        fill(page, "#panel-K", "4")
        page.until("document.querySelector('.changes').textContent.includes('K = 4 (file: 2)')")
        page.until("document.querySelector('#panel [aria-label=L] .unit').textContent.trim() === '12'")
        fill(page, "#panel-K", "much")
        page.until("document.querySelector('#panel .error').textContent")
        path.write_text(text.replace('"name": "loop"', '"name": "loop", "doc": "read again"'))
        page.until("document.querySelector('#panel .doc').innerText.includes('read again')")
        typed = "document.querySelector('#panel-K').value"
        assert page.evaluate(f"{typed} === 'much' && document.activeElement.id === 'panel-K'")
        page.press("Escape")
        assert page.evaluate(typed) == "4"
        page.click('#lists [data-path="lag"]')
        page.until("document.querySelector('[aria-label=\"lag.den[1]\"]')")
        fill(page, '[aria-label="lag.den[1]"]', "2.5")
        page.press("Tab")
        page.until("document.querySelector('.changes').textContent.includes('lag.den = [3, 2.5, 1]')")
        assert server._open.values == {"K": 4, "lag.den": [3, 2.5, 1]}
        page.assert_clean()


def fill(page: Any, selector: str, text: str) -> None:
    page.evaluate(f"document.querySelector({selector!r}).select()")
    page.call("Input.insertText", text=text)
