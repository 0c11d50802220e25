"""A diagram drawn in a real browser: from an empty file to the motor under control, and what must not happen."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.drawing import placed
from blocks import Constant, Diagram, Gain, MatrixGain
from blocks.model.document import dumps
from blocks.server import session
from blocks.server.editor import Editor
from tests.support.hands import Hands, edited_page
from tests.support.places import ROOT

from .test_knobs import Page

pytestmark = pytest.mark.long

MOTOR, PAPER = ROOT / "diagrams/motor_pid.json", ROOT / "diagrams/paper"
HOSTILE = (
    "<img src=x onerror=window.hit=1>", '"><script>window.hit=1</script>', "__proto__", "constructor", "a.b", "../../x",
    "${window.hit=1}", "x" * 400, "\u202egnp.exe",
)  # fmt: skip
WIRES = {
    "control.r": "speed.y", "motor.v": "control.u", "control.y": "motor.omega", "motor.tau": "load.y",
}  # fmt: skip
PARAMETERS = {
    "kp": ("20 V.s/rad", "proportional gain"), "ki": ("30 V/rad", "integral gain"),
    "kd": ("4 V.s2/rad", "derivative gain"), "voltage": ("12 V", "largest voltage, forward and backward"),
    "torque": ("3 N.m", "torque that brakes the motor from 6 s on"),
}  # fmt: skip
MEASURES = (
    "overshoot of=motor.omega against=speed.y from=1 to=6", "settling_time of=motor.omega against=speed.y from=1 to=6",
    "dip=peak of=motor.omega against=speed.y from=6", "ITAE of=motor.omega against=speed.y",
)  # fmt: skip
BLOCKS = {
    "speed": ("step at=1 after=2 unit=rad/s", "wanted speed"),
    "control": ("pid kp==kp ki==ki kd==kd c=1 lower==-voltage upper==voltage unit=rad/s unit_u=V", ""),
    "load": ("step at=6 after==torque unit=N.m", "torque on the wheel"),
    "motor": ("pmdc", ""),
}
LOG = ("speed.y", "motor.omega", "motor.i", "control.u", "load.y")
DOC = "\n".join(json.loads(MOTOR.read_text())["doc"])


def check_and_undo(hands: Hands, empty: bytes, undo: Any) -> None:
    """It is the shipped diagram, but for positions; it runs; undone it is the empty file."""
    path = hands.editor.file
    assert replace(Diagram.load(path).value, layout={}) == replace(Diagram.load(MOTOR).value, layout={})
    runs = [Diagram.load(one).run() for one in (path, MOTOR)]
    assert np.array_equal(runs[0]["motor.omega"], runs[1]["motor.omega"])
    for _ in range(len(hands.editor.done)):
        undo()
    hands.page.until("!document.querySelector('#edits button:not(:disabled)[title^=Undo]')")
    hands.page.until("!document.querySelector('#stage [data-path]')")
    assert path.read_bytes() == empty
    hands.page.assert_clean()


def test_the_motor_under_control_is_drawn_with_the_mouse_alone(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor_pid.json"
    with edited_page(chromium, path) as hands:
        page, empty = hands.page, path.read_bytes()
        for name, (value, doc) in PARAMETERS.items():
            hands.insert(f"parameter {name}={value}")
            hands.button(f"Describe {name}", "#panel")
            hands.said(doc)
        for name, (text, doc) in BLOCKS.items():
            hands.insert(text)
            hands.button("Rename")
            page.until("document.querySelector('.typed')")
            page.type(name)
            hands.done(lambda: page.click("#panel h2"))
            if doc:
                hands.button("Describe")
                hands.said(doc)
        for sink, source in WIRES.items():
            hands.wire(source, sink)
        x, y = hands.box("motor")
        hands.done(lambda: page.drag(x, y, x + 30, y - 40))  # the first move writes all positions
        assert set(json.loads(path.read_text())["layout"]) == set(BLOCKS)
        page.click('#lists [data-signal="motor.omega"]')
        hands.insert("output omega")
        for signal in LOG:
            page.click(f'#lists [data-signal="{signal}"]')
            hands.done(lambda: hands.button("Log"))
        x, y = hands.box("motor")
        page.click_at(x, y + 180)  # nothing
        page.until("document.querySelector('#panel h2').textContent === 'motor_pid'")
        page.evaluate("document.querySelector('#panel details').open = true")
        for what, text in (("stop", "10"), ("every", "0.01")):
            hands.button(f"Change {what}", "#panel")
            hands.said(text)
        for text in MEASURES:
            hands.button("Add a measure", "#panel")
            page.until("document.querySelector('dialog.search')")
            page.type(text.split("=")[1].split()[0] if text.startswith("dip") else text.split()[0])
            page.click("#found [role=option]")
            hands.said(text)
        hands.button("Describe")
        hands.said(DOC)
        hands.button("Run", "#runbar")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        check_and_undo(hands, empty, lambda: hands.button("Undo"))


def test_the_motor_under_control_is_drawn_with_the_keyboard_alone(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor_pid.json"
    with edited_page(chromium, path) as hands:
        page, empty = hands.page, path.read_bytes()

        def say(text: str, *, over: str = "Control+a") -> None:
            page.until("document.querySelector('dialog :is(input, textarea)')")
            page.press(over)
            for k, line in enumerate(text.split("\n")):
                if k:
                    page.press("Enter")
                page.type(line)
            hands.done(lambda: page.press("Control+Enter"))

        for name, (value, doc) in PARAMETERS.items():
            hands.type_block(f"parameter {name}={value}")
            hands.tab_to(f'[aria-label="Describe {name}"]')
            page.press("Enter")
            say(doc)
            hands.tab_to("#view")
        for name, (text, doc) in BLOCKS.items():
            hands.type_block(text)
            page.press("F2")
            page.until("document.querySelector('.typed')")
            page.type(name)
            hands.done(lambda: page.press("Enter"))
            if doc:
                hands.type_block(f"describe {doc}")
        for sink, source in WIRES.items():
            hands.rest()
            page.press("/")
            page.until("document.querySelector('dialog.search li')")
            page.type(source.split(".")[0])
            page.press("Enter", "C")
            page.until("document.querySelector('dialog:is([aria-label^=Port], [aria-label^=Connect])')")
            if page.evaluate("document.querySelector('dialog').ariaLabel").startswith("Port"):
                page.type(source)
                page.press("Enter")
            page.until("document.querySelector('dialog[aria-label^=Connect] li')")
            page.type(sink)
            hands.done(lambda: page.press("Enter"))
        hands.rest()
        page.press("ArrowUp")  # a nudge writes all positions
        page.until("document.querySelector('#stage svg').dataset.origin")
        page.press("/")
        page.until("document.querySelector('dialog.search li')")
        page.type("motor.omega")
        page.press("Enter")
        hands.type_block("output omega")
        runs = (*(f"log {name}" for name in LOG), "stop 10", "every 0.01", *(f"measure {one}" for one in MEASURES))
        for text in runs:
            hands.type_block(text)
        page.press("Escape")
        page.press("d")
        page.until("document.querySelector('dialog.search li')")
        page.type("escribe")
        page.press("Enter")
        page.until("document.querySelector('dialog textarea')")
        say(DOC)
        page.press("Shift+R")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        check_and_undo(hands, empty, lambda: page.press("Control+z"))


def test_what_another_program_or_window_writes_is_shown_and_undone_in_all_windows(
    chromium: Any, tmp_path: Path
) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    with edited_page(chromium, path) as hands, chromium() as other:
        other.open(hands.server.ticket)
        other.until("!document.getElementById('edits').hidden")
        ours = path.read_text()
        path.write_text(ours.replace('"voltage": {"value": 12', '"voltage": {"value": 13'))
        for page in (hands.page, other):
            page.until("document.querySelector('#panel input[aria-label=voltage]').value === '13 V'")
        hands.page.click_at(*hands.box("load"))
        hands.done(lambda: hands.page.press("Delete"))
        other.until("!document.querySelector('#stage [data-path=load]')")
        assert "motor.tau" not in path.read_text()
        undo = "[...document.querySelectorAll('#edits button')].find(one => one.textContent === 'Undo')"
        other.until(f"!{undo}.disabled")
        other.press("Control+z", "Control+z")
        for page in (hands.page, other):
            page.until("document.querySelector('#stage [data-path=load]')")
            page.until("document.querySelector('#panel input[aria-label=voltage]').value === '12 V'")
            page.assert_clean()
        assert path.read_text() == ours


def test_another_diagram_opens_in_a_tab(chromium: Any, tmp_path: Path) -> None:
    Diagram("two").save(tmp_path / "two.json")
    with edited_page(chromium, tmp_path / "one.json") as hands:
        hands.button("Diagrams")
        hands.page.until("document.querySelector('dialog.search li')")
        hands.page.press("Enter")
        limit = time.monotonic() + 20.0
        while not any(one._open.pages for path, one in hands.server._tabs.items() if path.name == "two.json"):
            assert time.monotonic() < limit
            time.sleep(0.05)
        hands.page.assert_clean()


def test_a_command_that_is_killed_in_the_middle_of_gestures_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    path.write_text(dumps(placed(40)))
    killed = """
import sys
from blocks.server import gestures
from blocks.server import session
from blocks.server.editor import Editor
editor = Editor(sys.argv[1])
print("begun", flush=True)
for k in range(10**6):
    editor.edit("move", [{"move": f"law{k % 40}", "to": [k % 977, k % 391]}])
"""
    before = path.read_bytes()
    for delay in (0.05, 0.11, 0.23, 0.31, 0.4):
        command = subprocess.Popen([sys.executable, "-c", killed, path], stdout=subprocess.PIPE, cwd=ROOT)
        assert command.stdout is not None
        command.stdout.readline()
        time.sleep(delay)
        command.kill()
        command.communicate()
        value = Diagram.load(path).value
        assert len(value.blocks) == 200
        assert dumps(value).encode() == path.read_bytes()
    assert path.read_bytes() != before
    Editor(path).edit("move", [{"move": "law0", "to": [1, 2]}])  # what a kill left beside the file is in nobody's way
    assert Diagram.load(path).value.layout["law0"] == [1, 2]


def test_the_robot_of_the_paper_is_edited_run_and_undone(chromium: Any, tmp_path: Path) -> None:
    for file in PAPER.iterdir():
        if file.suffix == ".json":
            (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "iadrc.json"
    before = path.read_bytes()
    with edited_page(chromium, path) as hands:
        page = hands.page
        x, y = hands.box("motor_right")
        hands.done(lambda: page.drag(x, y, x + 40, y + 30))
        page.click('#lists [data-path="motor_right"]')
        page.until("document.querySelector('#panel input[aria-label=\"motor_right.Ra\"]')")
        page.click('#panel input[aria-label="motor_right.Ra"]', count=3)
        page.type("0.2")
        hands.done(lambda: page.press("Tab"))
        assert Diagram.load(path).value.blocks["motor_right"].parameters["Ra"] == 0.2
        page.evaluate("document.getElementById('view').focus()")
        hands.done(lambda: page.press("Control+d"))
        hands.seen("[data-path=motor_right_2]")
        page.press("Control+z")
        page.until("!document.querySelector('#stage [data-path=motor_right_2]')")
        page.click('#runbar input[type="text"]')
        page.type("2")
        hands.button("Run", "#runbar")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        for _ in range(len(hands.editor.done)):
            revision = hands.editor.revision
            hands.button("Undo")
            page.until(f"document.body.dataset.revision > {revision}")
        page.assert_clean()
    assert path.read_bytes() == before


def test_blocks_stand_where_a_double_click_asked_for_them(chromium: Any, tmp_path: Path) -> None:
    with edited_page(chromium, tmp_path / "placed.json") as hands:
        page = hands.page
        x, y = page.center("#view")
        wanted = {"step": x - 250, "sum": x - 60, "pmdc_motor": x + 190}
        for text, at in zip(("step", "sum +-", "dc motor"), wanted.values(), strict=True):
            hands.rest()
            page.click_at(at, y, count=2)
            page.until("document.querySelector('dialog.search li .pictogram')")
            page.type(text)
            hands.done(lambda: page.press("Enter"))
        for name, at in wanted.items():
            hands.seen(f'[data-path="{name}"]')
            assert hands.box(name) == pytest.approx((at, y), abs=10)  # the grid


def test_500_blocks_are_moved_wired_deleted_and_undone(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    path.write_text(dumps(placed(100)))
    before = path.read_bytes()
    with edited_page(chromium, path) as hands:
        page = hands.page
        page.click('#lists [data-path="law0"]')
        for act in (
            lambda: page.press("ArrowRight"), lambda: page.press("Control+d"), lambda: page.press("Delete"),
            lambda: page.press("Control+z"), lambda: page.press("Control+z"), lambda: page.press("Control+z"),
        ):  # fmt: skip
            revision = hands.editor.revision
            page.evaluate("document.getElementById('view').focus()")
            act()
            page.until(f"document.body.dataset.revision > {revision}")
        drawn = page.evaluate("document.querySelector('#stage').querySelectorAll('g[data-path]').length")
        assert drawn == 500
        hands.rest()
        # What was kept of the drawing is what a page that is loaded anew shows.
        shown = "document.querySelector('#stage svg').innerHTML.replace(/ class=\"[^\"]*\"/g, '')"
        kept = page.evaluate(shown)
        page.evaluate("window.old = true, location.reload()")
        page.until("!window.old && document.querySelectorAll('#stage g[data-path]').length === 500")
        hands.rest()
        assert page.evaluate(shown) == kept
        page.assert_clean()
    assert path.read_bytes() == before


@contextmanager
def pressed(page: Any, selector: str) -> Iterator[None]:
    """Hold the button of the mouse on an element."""
    at = page.center(selector)
    page._mouse("mouseMoved", *at)
    page._mouse("mousePressed", *at, button="left", buttons=1, clickCount=1)
    yield
    page._mouse("mouseReleased", *at, button="left", clickCount=1)


def test_a_click_counts_and_what_is_typed_stays_when_the_panel_is_shown_anew(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    with edited_page(chromium, path) as hands:
        page, elsewhere = hands.page, Page()

        def another_window(do: str, **fields: Any) -> None:
            revision = hands.editor.revision
            hands.server._open.received(elsewhere, {"do": do, "id": 0, **fields})
            page.until(f"document.body.dataset.revision > {revision}")

        hands.server._open.connected(elsewhere)
        kd = "#panel [aria-label='Delete kd']"
        page.until(f'document.querySelector("{kd}")')
        with pressed(page, kd):  # the line of this button is another one, and those above it are more
            another_window("put", name="kd", text="5")
            another_window("define", kind="parameter", text="above=1")
            time.sleep(0.3)
        page.until(f'!document.querySelector("{kd}")')
        assert "kd" not in json.loads(path.read_text())["parameters"]
        # A block has knobs, and plain fields while there are faults.
        page.click('#lists [data-path="load"]')
        page.until("document.querySelector('#panel .knob [aria-label=\"load.at\"]')")
        page.click('#panel [aria-label="load.at"]', count=3)
        page.type("7")
        another_window("delete", names=[], sinks=["motor.v"])
        page.until("document.querySelector('#panel .field [aria-label=\"load.at\"]')")
        assert page.evaluate("document.activeElement.ariaLabel + document.activeElement.value") == "load.at7"
        page.type("5")
        page.until("document.querySelector('#panel [aria-label=\"load.at\"]').value === '75'")
        for _ in range(600):
            if json.loads(path.read_text())["blocks"]["load"]["parameters"]["at"] == 75:
                break
            page.evaluate("new Promise(requestAnimationFrame)")
        assert json.loads(path.read_text())["blocks"]["load"]["parameters"]["at"] == 75
        page.assert_clean()


def test_wires_have_one_value_each_when_the_drawing_is_shown_anew(chromium: Any, tmp_path: Path) -> None:
    d = Diagram("vectors")
    double = [[2.0 * (row == column) for column in range(4)] for row in range(4)]
    d.wire(d.add("vector", MatrixGain(K=double)).u, d.input("r", size=4, default=[1.0, 2.0, 3.0, 4.5]))
    for name in ("other", "more"):
        d.wire(d.add(name, MatrixGain(K=[[1.0] * 4])).u, "vector.y")
    d.wire(d.add("gain", Gain(k=1.0)).u, d.add("constant", Constant(value=7.0)).y)
    d.settings(stop=1.0)
    d.save(tmp_path / "vectors.json")
    labels = (
        "[...document.querySelectorAll('#stage g[data-net]')].map(one => [one.dataset.net, one.dataset.sink ?? '', "
        "...[...one.querySelectorAll('.wire-value')].map(text => text.firstChild.data)]).filter(one => one.length > 2)"
    )
    with edited_page(chromium, tmp_path / "vectors.json") as hands:
        page = hands.page

        def shown(constant: str) -> None:
            wanted = [["constant.y", constant], ["r", "1, 2, 3, ..."], ["vector.y", "2, 4, 6, ..."]]
            wanted_text = json.dumps(json.dumps(wanted, separators=(",", ":")))
            told = f"{labels}.map(([net, _, ...texts]) => [net, ...texts]).sort()"
            page.until(f"JSON.stringify({told}) === {wanted_text}")

        def moved(name: str) -> None:
            x, y = hands.box(name)
            hands.done(lambda: page.drag(x, y, x + 40, y + 50))

        hands.button("Run", "#runbar")
        shown("7")
        whole = page.evaluate("[...document.querySelectorAll('.wire-value title')].map(one => one.textContent)")
        assert sorted(whole) == ["r, 4 elements: 1, 2, 3, 4.5", "vector.y, 4 elements: 2, 4, 6, 9"]
        moved("other")  # its wires are others then, those of the other blocks are kept
        shown("7")
        page.click('#lists [data-path="constant"]')
        page.click('#panel [aria-label="constant.value"]', count=3)
        page.type("8")
        hands.done(lambda: page.press("Tab"))
        shown("7")  # of the run that was
        hands.button("Run anew", "#runbar")
        shown("8")
        moved("vector")
        shown("8")
        page.click("#scopes label input[type=checkbox]")
        page.until(f"{labels}.every(([,, text]) => !text)")
        page.assert_clean()


def test_a_name_that_is_refused_can_be_mended_and_a_slider_leaves_no_value_over_the_file(
    chromium: Any, tmp_path: Path
) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    with edited_page(chromium, path) as hands:
        page = hands.page
        hands.type_name("load", "motor")
        page.press("Enter")
        page.until("document.querySelector('.typed[aria-invalid]')")
        assert "E109" in page.text("#edits .refusal")
        page.press("Control+a", "Backspace")
        page.type("brake")
        hands.done(lambda: page.press("Enter"))
        page.until("!document.querySelector('.typed') && document.activeElement.id === 'view'")
        assert {"motor", "brake", "speed", "control"} == set(Diagram.load(path).value.blocks)
        page.press("Control+z", "Escape")
        hands.seen("[data-path=load]")
        hands.button("Run", "#runbar")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        page.until("document.querySelector('#panel [aria-label=\"kp slider\"]')")
        x, y = page.center('#panel [aria-label="kp slider"]')
        hands.done(lambda: page.drag(x, y, x + 40, y, steps=30))
        said = json.loads(path.read_text())["parameters"]["kp"]["value"]
        page.until(f"document.querySelector('#panel input[aria-label=kp]').value.startsWith('{said:g}')")
        assert (said > 25, hands.server._open.values) == (True, {})
        hands.button("Undo")
        page.until("document.querySelector('#panel input[aria-label=kp]').value.startsWith('20 ')")
        assert (path.read_bytes(), hands.server._open.values) == (MOTOR.read_bytes(), {})
        page.assert_clean()


def test_undo_right_after_a_new_name_takes_that_name_back(
    chromium: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = session.answer

    def late(*given: Any) -> Any:
        """Answer long after the page has been shown what changed."""
        told = answer(*given)
        time.sleep(0.5)
        return told

    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    with edited_page(chromium, path) as hands:
        page = hands.page
        hands.type_name("load", "brake")
        monkeypatch.setattr(session, "answer", late)
        page.press("Enter", "Control+z")  # before there is anything to undo
        hands.seen("[data-path=brake]")
        hands.seen("[data-path=load]")
        hands.rest()
        assert path.read_bytes() == MOTOR.read_bytes()
        assert [step.what for step in hands.editor.undone] == ["rename load to brake"]
        hands.type_name("load", "motor")
        page.press("Enter", "Delete")  # a name that is taken: the key is the field's, and deletes no block
        page.until("document.querySelector('.typed[aria-invalid]')")
        page.press("Escape")
        hands.rest()
        assert path.read_bytes() == MOTOR.read_bytes()
        page.assert_clean()


def test_a_block_is_dragged_from_the_list_into_the_drawing(chromium: Any, tmp_path: Path) -> None:
    with edited_page(chromium, tmp_path / "new.json") as hands:
        page = hands.page
        (x, y), aside = page.center("#view"), page.center("#runbar")
        hands.button("Add")
        page.until("document.querySelector('#found [role=option]')")
        page.type("gain 3")
        hands.done(lambda: page.drag(*page.center("#found [role=option]"), x + 100, y + 50))
        hands.seen("[data-path=gain]")
        assert hands.box("gain") == pytest.approx((x + 100, y + 50), abs=10)  # the grid
        assert hands.editor.diagram is not None
        assert hands.editor.diagram.value.blocks["gain"].parameters == {"k": 3}
        hands.button("Add")
        page.until("document.querySelector('#found [role=option]')")
        page.drag(*page.center("#found [role=option]"), *aside)  # no place for a block
        page.until("!document.querySelector('dialog, .dragged')")
        assert len(hands.editor.done) == 1
        page.assert_clean()


def test_hostile_names_and_texts_are_shown_as_texts(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    with edited_page(chromium, path) as hands:
        page = hands.page
        hands.type_block("gain")
        for text in HOSTILE:
            hands.seen(".picked")
            page.evaluate("document.getElementById('view').focus()")
            page.press("F2")
            page.until("document.querySelector('.typed')")
            page.type(text)
            page.press("Enter")
            known = json.dumps(f'#lists [data-path="{text}"]') if text.isidentifier() else "'none'"
            page.until(f"document.querySelector('.typed[aria-invalid]') || document.querySelector({known})")
            if page.evaluate("Boolean(document.querySelector('.typed[aria-invalid]'))"):
                page.press("Escape")  # the field of a name that was refused stays
            page.until("!document.querySelector('.typed')")
            hands.type_block(f"describe {text}")
            page.until(f"document.querySelector('#panel .own')?.textContent === {json.dumps(text)}")
        for text in HOSTILE:
            entries = json.dumps(json.dumps({"blocks": {"b": {"type": text, "doc": text}}}))
            data = f"{{clipboardData: {{getData: () => {entries}}}}}"
            event = f"Object.assign(new Event('paste', {{bubbles: true, cancelable: true}}), {data})"
            page.evaluate(f"document.dispatchEvent({event})")
            hands.rest()
        assert not page.evaluate("window.hit || document.querySelector('#stage script, body img')")
        page.assert_clean()


def test_what_is_typed_into_fields_stays_and_a_fault_stands_beside_its_field(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "tank.json"
    with edited_page(chromium, path) as hands:
        page = hands.page
        hands.type_block("parameter area=2 m2")
        hands.type_block("step at=1 after=0.5 unit=m3/s")
        hands.type_block("tank A==area")
        hands.seen("[data-path=tank].picked")
        page.press("Enter")  # to its values
        page.until("document.activeElement.ariaLabel === 'tank.A'")
        assert page.evaluate("document.activeElement.value") == "=area"
        page.press("Control+a")
        page.type("3 V")
        hands.done(lambda: None)  # without Return
        page.until("document.querySelector('#panel .rows li > .error').innerText.includes('E104')")
        assert page.evaluate("document.activeElement.ariaLabel") == "tank.A"
        page.press("Control+a")
        page.type("=2*area")
        hands.done(lambda: None)
        assert Diagram.load(path).value.blocks["tank"].parameters == {"A": "=2*area"}
        page.press("Escape")
        assert page.evaluate("document.activeElement.id") == "view"
        page.until("document.querySelector('#lists .remedies')")
        hands.button("Connect ...", "#lists")
        page.until("document.querySelector('dialog li')")
        hands.done(lambda: page.press("Enter"))
        page.until("!document.querySelector('#lists .fault')")
        page.press("Control+s")
        page.until("document.querySelector('#edits .refusal').innerText.includes('already')")
        hands.type_block("stop 20")
        page.press("Shift+R")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        page.assert_clean()


def test_a_value_that_nobody_typed_stays_as_it_is_spelled(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    raw = json.loads(MOTOR.read_text())
    raw["blocks"]["speed"]["parameters"] |= {"at": 1, "after": {"value": 200, "unit": "rpm"}}
    raw["blocks"]["free"] = {"type": "TransferFunction", "parameters": {"num": [1], "den": [1.0, 2.50, 1]}}
    raw["wires"]["free.u"] = "speed.y"
    path.write_text(json.dumps(raw))
    with edited_page(chromium, path) as hands:
        page, elsewhere = hands.page, Page()
        hands.server._open.connected(elsewhere)

        def blocks_in_file() -> Any:
            return json.loads(path.read_text())["blocks"]

        def wire_of_the_motor(operation: dict[str, str]) -> None:  # from another window
            revision = hands.editor.revision
            hands.server._open.received(elsewhere, {"do": "edit", "id": 0, "operations": [operation]})
            page.until(f"document.body.dataset.revision > {revision}")

        page.click('#lists [data-path="speed"]')
        for name in ("at", "after"):  # a knob becomes a field while there is a fault, and the field a knob again
            page.until(f"document.querySelector('#panel .knob [aria-label=\"speed.{name}\"]')")
            page.click(f'#panel .knob [aria-label="speed.{name}"]')
            for operation, kind in (
                ({"unwire": "motor.v"}, "field"), ({"wire": "control.u", "to": "motor.v"}, "knob"),
            ):  # fmt: skip
                wire_of_the_motor(operation)
                page.until(f"document.querySelector('#panel .{kind} [aria-label=\"speed.{name}\"]')")
                page.until(f"document.activeElement.ariaLabel === 'speed.{name}'")
                page.press("Tab", "Shift+Tab")
                time.sleep(0.8)  # longer than a typed value waits
        assert blocks_in_file()["speed"]["parameters"] == raw["blocks"]["speed"]["parameters"]
        steps = len(hands.editor.done)
        page.click('#lists [data-path="free"]')
        page.click('#panel [aria-label="free.den[2]"]', count=3)
        page.type("4")
        hands.done(lambda: page.press("Tab"))
        assert "[1.0, 2.5, 4]" in path.read_text()
        assert len(hands.editor.done) == steps + 1
        page.assert_clean()


def test_a_wire_is_hit_by_its_distance_from_the_pointer(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    with edited_page(chromium, path) as hands:
        page = hands.page
        (x0, y0), (x1, _) = hands.port("speed.y", "out"), hands.port("control.r", "in")
        x = x0 + (x1 - x0) / 3  # on the first part of the wire, which is level
        for far, is_met in ((0, True), (1, True), (2, True), (3, True), (5, True), (9, False)):
            for side in (-1, 1):
                page.click_at(x, y0 + side * far)
                head = "speed.y" if is_met else "motor_pid"
                page.until(f"document.querySelector('#panel h2').textContent === '{head}'")
                page.press("Escape")
                page.until("document.querySelector('#panel h2').textContent === 'motor_pid'")
        page.click_at(x, y0 + 3, count=2)  # a scope, and not the list of blocks
        page.until("document.querySelector('.scope')")
        assert not page.evaluate("document.querySelector('dialog')")
        page.assert_clean()


def test_a_block_with_a_fault_keeps_its_ports_and_the_diagram_its_stop_time(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    drawn = """[...document.querySelectorAll('#stage g[data-path]')].map(one => [one.dataset.path, one.dataset.in,
        one.dataset.out, ...[...one.querySelectorAll('.port')].map(text => text.textContent)].join())"""
    stop = "document.querySelector('#runbar label input').placeholder"
    with edited_page(chromium, path) as hands:
        page = hands.page
        hands.rest()
        before, end = page.evaluate(drawn), page.evaluate(stop)
        assert any("u_manual" in one for one in before)
        page.click('#lists [data-path="control"]')
        page.click('#panel [aria-label="control.c"]', count=3)
        page.type("nothing")
        hands.done(lambda: page.press("Enter"))
        page.until("document.querySelector('#lists .fault')")
        hands.rest()
        assert page.evaluate(drawn) == before
        assert (end, page.evaluate(stop)) == ("10 s", "10 s")
        page.assert_clean()


def test_what_is_selected_is_shown_and_what_is_free_is_offered(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / "motor.json"
    path.write_bytes(MOTOR.read_bytes())
    head = "document.querySelector('#panel h2').textContent"
    with edited_page(chromium, path) as hands:
        page = hands.page
        # Outputs that no wire leaves have a stub.
        hands.seen(".free")
        free = page.evaluate("[...document.querySelectorAll('#stage .free')].map(one => one.textContent)")
        assert free == ["motor.i"]
        # The stop time is the file's.
        page.click('#runbar input[type="text"]')
        page.type("2")
        hands.done(lambda: page.press("Tab"))
        assert Diagram.load(path).value.run["stop"] == 2
        page.until("document.querySelector('#runbar input').value === ''")
        assert page.evaluate("document.querySelector('#runbar input').placeholder") == "2 s"
        hands.button("Run", "#runbar")
        page.until("document.getElementById('runbar').dataset.state === 'done'")
        scopes = page.evaluate("document.querySelectorAll('.scope').length")
        # A wire is selected by a click: where it leads and what it carries stand in the panel, and no scope opens.
        (x, y), (x2, _) = hands.port("control.u", "out"), hands.port("motor.v", "in")
        page.click_at((x + x2) / 2, y)
        page.until(f"{head} === 'control.u'")
        told = "[...document.querySelectorAll('#panel .rows .value')].map(one => one.innerText)"
        page.until(f"/^[-0-9.]+$/.test({told}[3])")
        assert page.evaluate(told)[:3] == ["control.u", "motor.vTake off", "V"]
        assert page.evaluate("document.querySelectorAll('.scope').length") == scopes
        page.press("Enter")
        page.until(f"document.querySelectorAll('.scope').length === {scopes + 1}")
        # Several blocks are counted, and marked in the list.
        page.evaluate("document.getElementById('view').focus()")
        page.press("Control+a")
        page.until(f"{head} === '5 selected'")
        assert page.evaluate("document.querySelectorAll('#lists [data-path][aria-current]').length") == 4
        page.click('#lists [data-path="load"]')
        page.until(f"{head} === 'load' && document.getElementById('announcer').textContent === 'load, Step, selected'")
        assert page.evaluate("document.querySelectorAll('#lists [data-path][aria-current]').length") == 1
        # A change by another program is told.
        path.write_text(path.read_text().replace('"value": 4,', '"value": 5,'))
        page.until("document.querySelector('#edits .refusal').textContent.includes('by another program')")
        page.evaluate("document.getElementById('view').focus()")
        hands.type_block("gain 3")
        page.until("document.getElementById('announcer').textContent.includes('E101 gain.u')")
        page.click_at(x + 5, y)
        page.until(f"{head} === 'control.u'")
        hands.done(lambda: page.press("Delete"))  # with faults, too
        assert "motor.v" not in Diagram.load(path).value.wires
        page.assert_clean()
