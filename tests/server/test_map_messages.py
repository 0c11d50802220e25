"""The map of a loop in a page: points by single reports of the loop; what it chooses; the cross that is dragged."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    ADRC,
    Block,
    Case,
    Diagram,
    DiscreteADRC,
    Input,
    Parameter,
    State,
    Step,
    TransferFunction,
    output,
)
from blocks.analysis import loop_map, loop_report
from blocks.server import gestures, knobs, map_messages, panel  # noqa: F401  # the messages that they answer
from blocks.server.editor import Editor
from blocks.server.messages import answer
from blocks.server.open_document import Document
from blocks.server.session import Session
from blocks.text.errors import UsageError
from tests.support.browser import DEADLINE
from tests.support.hands import edited_page
from tests.support.places import ROOT

Ask = Callable[..., Any]
C, O = "control.omega_c", "control.omega_o"


def loop(control: Any = None) -> Diagram:
    d = Diagram("loop")
    control = ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0) if control is None else control
    d.add("control", control)
    plant = d.add("plant", TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5]))
    d.wire("control.r1" if isinstance(control, DiscreteADRC) else "control.r", d.add("wanted", Step(at=0.5)).y)
    d.wire("control.y", plant.y)
    d.wire(plant.u, "control.u")
    d.settings(stop=20.0)
    return d


@pytest.fixture
def asking() -> Iterator[Callable[..., tuple[Ask, Session]]]:
    sessions = []

    def of(source: Any, **words: Any) -> tuple[Ask, Session]:
        session = Session(source if isinstance(source, Document) else Document(source), Case(**words))
        sessions.append(session)
        return lambda do, **fields: answer(session, {"do": do, **fields}), session

    yield of
    for session in sessions:
        session.close()


@pytest.mark.parametrize(
    ("least", "most", "value", "expected"),
    [(1.0, None, 2.0, [1.0, 10.0]), (None, 1.23456, 1.0, [0.2, 1.23456]), (None, None, -2.0, [-10.0, -0.4])],
)
def test_the_range_that_the_page_begins_with_is_one_that_may_be_set(
    asking: Any, least: float | None, most: float | None, value: float, expected: list[float]
) -> None:
    class Proportional(Block):
        kp = Parameter(1.0, min=least, max=most)
        ki = Parameter(1.0)
        r, y = Input(), Input()
        z = State(0.0)

        @z.derivative  # type: ignore[untyped-decorator]
        def dz(r: Any, y: Any, ki: Any) -> Any:
            return ki * (r - y)

        @output  # type: ignore[untyped-decorator]
        def u(r: Any, y: Any, z: Any, kp: Any) -> Any:
            return kp * (r - y) + z

    ask, _ = asking(loop(Proportional(kp=value)))
    told = ask("loop_map")
    assert told["map"]["over"]["control.kp"] == expected
    assert np.isfinite(np.array(told["tables"][0], dtype=float)).any() or value < 0


def test_the_points_of_a_map_are_what_single_reports_of_the_loop_say(asking: Any) -> None:
    ask, session = asking(loop())
    told = ask("loop_map", limits={"Ms": 1.55, "phase_deg": 40.0})
    chosen = told["map"]
    assert (chosen["control"], chosen["output"]) == ("control.u", "plant.y")
    assert chosen["over"] == {C: [0.8, 20.0], O: [4.0, 100.0]}  # by factors of 5 around 4 and 20
    assert [one["value"] for one in chosen["present"]] == [4.0, 20.0]
    names = [name for name, _, _ in chosen["measures"]]
    tables = dict(zip(names, told["tables"], strict=True))
    x, y = told["axes"]
    assert (len(x), len(y)) == (40, 40)
    assert x[1] / x[0] == pytest.approx(25 ** (1 / 39))
    for i, k in ((0, 39), (13, 20), (39, 0)):
        known = loop_report(loop(), "control.u", "plant.y", parameters={C: x[i], O: y[k]})
        for name in ("gain", "phase_deg", "delay", "Ms", "Mt", "crossover"):
            assert tables[name][k][i] == pytest.approx(getattr(known.margins, name), rel=1e-4), name
        assert tables["noise"][k][i] == pytest.approx(known.peak_noise[0], rel=1e-4)
        is_within = known.margins.Ms <= 1.55 and known.margins.phase_deg >= 40.0
        assert (told["slack"][k][i] >= 0) == is_within
    inside = np.array(told["slack"]) >= 0
    least = np.where(inside, np.array(tables["disturbance"]), np.inf)
    k, i = np.unravel_index(int(least.argmin()), least.shape)
    assert told["best"]["point"] == [x[i], y[k]]
    assert told["best"]["at"] == [tables[name][k][i] for name in names]
    # The same map is known; the page has its tables. Another value of the loop makes it another map.
    session.values[C] = 5.0
    as_typed = {C: [0.8, 20], O: [4, 100]}
    again = ask("loop_map", over=as_typed, control="control.u", output="plant.y", have=told["number"])
    assert "tables" not in again
    assert [one["value"] for one in again["map"]["present"]] == [5.0, 20.0]
    session.values["control.b0"] = 3.0
    other = ask("loop_map", over=chosen["over"], control="control.u", output="plant.y", have=told["number"])
    known = loop_report(loop(), "control.u", "plant.y", parameters={C: x[13], O: y[20], "control.b0": 3.0})
    assert other["tables"][names.index("Ms")][20][13] == pytest.approx(known.margins.Ms, rel=1e-4)


def test_a_sampled_loop_has_fewer_points_of_the_same_numbers(asking: Any) -> None:
    made = loop(DiscreteADRC(period=0.02, b0=2.0, omega_c=4.0, omega_o=20.0))
    told = asking(made)[0]("loop_map")
    assert "12 x 12 points" in told["notes"][0]
    x, y = told["axes"]
    assert len(x) == len(y) == 12
    known = loop_map(made, "control.u", "plant.y", over={C: x[3:6], O: y[5:8]})
    assert told["tables"][5][5][3] == pytest.approx(known.measures["Ms"][0, 0], rel=1e-4)


def test_what_gives_the_gains_of_a_controller_is_chosen_in_their_place(asking: Any) -> None:
    told = asking(ROOT / "diagrams" / "motor_pid.json")[0]("loop_map")
    assert [*told["map"]["over"]] == ["kp", "ki"]  # control.kp is "=kp"
    assert told["best"]["at"][0] is None  # there is no gain margin: any gain is stable
    near = asking(ROOT / "diagrams" / "paper" / "iadrc.json")[0]("loop_map", near="control_left")
    assert near["map"]["control"] == "control_left.u"
    assert {fault["code"] for fault in near["faults"]} == {"E701"}
    assert "slider" in near["faults"][0]["cure"]
    assert near["laws"]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"over": {C: []}}, "names 1 parameters"),
        ({"over": {C: [], "control.omega": []}}, "Did you mean 'control.omega_"),
        ({"over": {C: [], "plant.den": []}}, "not a single number"),
        ({"over": {C: [4.0, 1.0], O: []}}, "must be"),
        ({"limits": {"Msx": 1.0}}, "Did you mean 'Ms'"),
        ({"best": "most"}, "not a measure"),
        ({"control": "nothing.u"}, "nothing"),
    ],
)
def test_what_makes_no_map_is_refused(asking: Any, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as refused:
        asking(loop())[0]("loop_map", **fields)
    assert said in str(refused.value)


def test_a_diagram_without_a_controller_and_a_signal_in_no_loop_are_refused_in_words(asking: Any) -> None:
    told = asking(loop())[0]("loop_map", control="wanted.y")
    assert "E705" in [fault["code"] for fault in told["faults"]]
    assert "number" not in told
    with pytest.raises(UsageError, match="no block with an output u"):
        asking(ROOT / "diagrams" / "quarter_car.json")[0]("loop_map")


def test_a_map_ends_where_nobody_waits_and_where_another_is_asked(asking: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    ask, session = asking(loop())
    monkeypatch.setattr(Session, "is_outdated", True)
    with pytest.raises(UsageError, match="another request stopped this one"):
        ask("loop_map")
    monkeypatch.setattr(session, "_job", type("Job", (), {"is_dropped": True, "message": {"do": "loop_map"}})())
    with pytest.raises(UsageError, match="was cancelled"):
        ask("loop_map")


def test_two_pages_that_ask_at_once_both_get_their_map_and_one_that_asks_again_the_later_one() -> None:
    class Client:
        """A page that keeps the answers it gets."""

        def __init__(self) -> None:
            self.told: dict[int, dict[str, Any]] = {}

        def send(self, message: dict[str, Any] | bytes, slot: str = "") -> bool:
            if isinstance(message, dict) and "re" in message:
                self.told[message["re"]] = message
            return True

        def answered(self) -> None:
            """Do nothing: there is no limit of questions."""

        def wait(self, number: int) -> dict[str, Any]:
            limit = time.monotonic() + DEADLINE
            while number not in self.told and time.monotonic() < limit:
                time.sleep(0.01)
            return self.told[number]

    session, one, other = Session(Document(loop()), Case()), Client(), Client()
    try:
        for client in (one, other):
            session.connected(client)
        session.received(one, {"do": "loop_map", "id": 1})
        session.received(other, {"do": "loop_map", "id": 1})
        assert one.wait(1)["tables"] == other.wait(1)["tables"]
        session.received(one, {"do": "loop_map", "id": 2, "over": {C: [1.0, 9.0], O: [4.0, 90.0]}})
        session.received(one, {"do": "loop_map", "id": 3, "over": {C: [2.0, 9.0], O: [4.0, 90.0]}})
        assert one.wait(3)["axes"][0][0] == pytest.approx(2.0)
        assert "another request stopped this one" in str(one.wait(2)["faults"])
    finally:
        session.close()


def test_several_values_are_written_as_one_step(asking: Any, tmp_path: Path) -> None:
    loop().save(tmp_path / "loop.json")
    before = (tmp_path / "loop.json").read_bytes()
    editor = Editor(tmp_path / "loop.json")
    ask, session = asking(editor)
    ask("set", name=C, value=7.0)
    ask("put_all", values={C: "6", O: "31"})
    assert (len(editor.done), session.values) == (1, {})
    now = Diagram.load(tmp_path / "loop.json")
    at = loop_map(now, "control.u", "plant.y", over={C: [1.0, 2.0, 3.0], O: [1.0, 2.0, 3.0]}).present
    assert at == (6.0, 31.0)
    with pytest.raises(UsageError, match="no such block"):
        ask("put_all", values={C: "5", "other.k": "1"})
    assert Diagram.load(tmp_path / "loop.json").value == now.value  # all of it or nothing
    ask("undo")
    assert (tmp_path / "loop.json").read_bytes() == before


PLACE = """((x, y) => { const plane = document.querySelector('#analysis .plane'), m = plane.getScreenCTM();
  plane.scrollIntoView({block: 'nearest'});
  const at = new DOMPoint(x, y).matrixTransform(plane.getScreenCTM()); return [at.x, at.y]; })"""
CROSS = (
    """(t => t.match(/[\\d.]+/g).map(Number))(document.querySelector('#analysis .cross').getAttribute('transform'))"""
)


@pytest.mark.long
def test_the_cross_is_dragged_during_a_run_the_scope_answers_and_one_undo_takes_it_back(
    chromium: Any, tmp_path: Path
) -> None:
    loop().save(tmp_path / "loop.json")
    before = (tmp_path / "loop.json").read_bytes()
    with edited_page(chromium, tmp_path / "loop.json") as hands:
        page, session = hands.page, hands.server._open
        hands.button("Analysis", "#drawing")
        page.click('[data-what="map"]')
        page.until("document.querySelector('#analysis .cross:not([hidden])')")
        page.evaluate("document.documentElement.style.setProperty('--analysis', '480px')")
        page.click('#lists [data-signal="plant.y"]')
        page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).value = '1'")
        page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).onchange()")
        page.evaluate("[...document.querySelectorAll('button')].find(one => one.textContent === 'Run').click()")
        page.until("document.getElementById('runbar').dataset.state === 'running'")
        page.until("document.querySelector('#scopes canvas')")
        was = page.evaluate(CROSS)
        x, y = page.evaluate(f"{PLACE}({was[0]}, {was[1]})")
        # By 1/4 of the axes to the right and up: by 25**(1/4) in both.
        wide, high = page.evaluate(
            "(b => [b.width, b.height])(document.querySelector('#analysis .frame').getBoundingClientRect())"
        )
        hands.done(lambda: page.drag(x, y, x + wide / 4, y - high / 4))
        live = session.running
        # The run needs some time of its own to move away from the other, however slow the machine is.
        limit = time.monotonic() + DEADLINE
        while live.t < max(0.5, live.turned[-1].t) + 0.5 and time.monotonic() < limit:
            time.sleep(0.01)
        turned = {each.name: each.value for each in live.turned}
        for name, was_value in ((C, 4.0), (O, 20.0)):
            assert turned[name] == pytest.approx(was_value * 25**0.25, rel=0.02)
        assert len({each.value for each in live.turned if each.name == C}) > 2  # also on the way there
        written = json.loads((tmp_path / "loop.json").read_text())
        assert written["blocks"]["control"]["parameters"][C.split(".")[1]] == turned[C]
        words = page.text("#analysis .point")
        assert f"{C} = {turned[C]:.4g}" in words
        # What the page reads off the map is what the loop has there.
        known = loop_report(Diagram.load(tmp_path / "loop.json"), "control.u", "plant.y")
        for name in ("Ms", "phase_deg", "delay"):
            shown = float(page.text(f'#analysis [data-of="{name}"]'))
            assert shown == pytest.approx(getattr(known.margins, name), rel=0.01), name
        page.press("Control+z")  # the cross has the focus
        limit = time.monotonic() + DEADLINE
        while hands.editor.done and time.monotonic() < limit:
            page.evaluate("new Promise(requestAnimationFrame)")
        assert (tmp_path / "loop.json").read_bytes() == before
        page.until(f"(now => Math.hypot(now[0] - {was[0]}, now[1] - {was[1]}) < 1)({CROSS})")
        assert {each.name: each.value["value"] for each in live.turned[-2:]} == {C: 4.0, O: 20.0}
        # An arrow key moves it too, and only the parameter along its axis.
        page.evaluate("document.querySelector('#analysis .cross').focus()")
        hands.done(lambda: page.press("ArrowRight"))
        assert live.turned[-1].name == C
        assert hands.editor.done[-1].what == f"set {C}"
        page.until(f"({CROSS})[0] > {was[0]} + 1")
        page.evaluate("[...document.querySelectorAll('button')].find(one => one.textContent === 'Stop').click()")
        page.until("document.getElementById('runbar').dataset.state === 'stopped'")
        page.assert_clean()
        results = live.results()
    # Until the cross was moved, the scope shows the run with the gains of the file; from then on another one.
    still = loop().run(stop=results.t[-1], every=0.001)
    away = np.abs(np.asarray(results["plant.y"]) - np.interp(results.t, still.t, np.asarray(still["plant.y"])))
    first = live.turned[0].t
    assert away[results.t < first].max(initial=0.0) < 1e-4
    assert away[results.t > first].max() > 1e-3
