"""The page of a live diagram in a real browser: what a user does, and what must not happen."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Gain, Integrator, Ramp, Sqrt, Step
from blocks.fmi.callbacks import instances
from blocks.server.live_server import LiveServer
from blocks.server.static_page import page_of

pytestmark = pytest.mark.long
PAPER = Path(__file__).resolve().parents[2] / "diagrams/paper/iadrc.json"


@contextmanager
def served(source: str | Path | Diagram) -> Iterator[LiveServer]:
    server = LiveServer(source).start()
    try:
        yield server
    finally:
        server.stop()


def shown(page: Any, url: str) -> None:
    page.open(url)
    page.until("document.querySelector('#stage svg [data-path]')")


def press(page: Any, name: str) -> None:
    """Click at the button of this name, when it is enabled."""
    found = f"[...document.querySelectorAll('button')].find(one => one.textContent.trim() === {json.dumps(name)})"
    page.until(f"(one => one && !one.disabled && one.checkVisibility())({found})")
    page.evaluate(f"{found}.setAttribute('data-pressed', {json.dumps(name)})")
    page.click(f'[data-pressed="{name}"]')


def standing(page: Any, word: str) -> None:
    """Wait until the run is in this state."""
    page.until(f"document.getElementById('runbar').dataset.state === {json.dumps(word)}")


def test_the_papers_robot_is_drawn_run_paused_turned_and_replayed(chromium: Any, native: None) -> None:
    with served(PAPER) as server, chromium() as page:
        session = server._open
        shown(page, server.url)
        # At rest the page holds the drawing of `blocks draw`, whose style sheet the page adopts; values have a place.
        page.evaluate("document.querySelectorAll('#stage .wire-value:empty').forEach(one => one.remove())")
        page.evaluate("document.querySelectorAll('#stage .opens').forEach(one => one.classList.remove('opens'))")
        drawn = json.dumps(Diagram.load(PAPER).draw())
        text = f"new DOMParser().parseFromString({drawn}.replace(/<style>.*?<.style>/s, ''), 'image/svg+xml')"
        parts = "(svg => [svg.cloneNode(), ...svg.children])"
        same = "(a, b) => a.length === b.length && a.every((one, k) => one.isEqualNode(b[k]))"
        shown_now = "document.querySelector('#stage svg')"
        assert page.evaluate(f"({same})({parts}({text}.documentElement), {parts}({shown_now}))")

        page.click('#lists [data-signal="motor_right.omega"]')
        page.until("document.querySelector('#scopes canvas')")
        page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).value = '10'")
        page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).onchange()")
        press(page, "Run")
        standing(page, "running")
        press(page, "Pause")
        standing(page, "paused")
        assert 0.0 < session.running.t < 100.0

        page.click('#lists [data-path="motor_right"]')
        slider = '#panel input[type="range"][aria-label="motor_right.Ra slider"]'
        page.until(f"document.querySelector('{slider}')")
        page.click(slider)  # its middle
        page.press("ArrowRight", "ArrowRight", "ArrowRight")
        page.until("document.querySelector('#knobs tbody tr')")
        page.until("document.querySelector('#knobs').textContent.includes('motor_right.Ra')")
        page.evaluate("[...document.querySelectorAll('#runbar select')].at(-1).value = ''")
        press(page, "Resume")
        standing(page, "done")
        assert session.running.turned

        page.evaluate("document.querySelector('#knobs details').open = true")
        press(page, "Script that repeats this run")
        script = page.until("document.querySelector('dialog textarea')?.value")
        page.assert_clean()
        results = session.running.results()
    again: dict[str, Any] = {}
    exec(compile(script, "replay.py", "exec"), again)
    made = next(value for value in again.values() if type(value).__name__ == "Results")
    assert made.t.tobytes() == results.t.tobytes()
    for name in made.names:
        assert np.asarray(made[name]).tobytes() == np.asarray(results[name]).tobytes(), name


def test_a_robot_with_fmus_for_co_simulation_runs_takes_values_and_is_replayed(chromium: Any, native: None) -> None:
    with served(PAPER.with_name("iadrc_fmu.json")) as server, chromium() as page:
        session = server._open
        shown(page, server.url)
        page.click('#runbar input[type="text"]')  # the stop time
        page.type("2")
        page.evaluate("document.activeElement.blur()")
        page.press(".")
        standing(page, "paused")
        page.until("document.getElementById('runbar').textContent.includes('communication points')")
        assert session.running.t == 0.001
        page.click('#lists [data-path="motor_left"]')
        knob = '#panel input[aria-label="motor_left.Ra"]'
        page.until(f"document.querySelector('{knob}')")
        page.evaluate(f"document.querySelector('{knob}').select()")
        page.click(knob, count=3)
        page.type("0.3")
        page.press("Enter")
        page.until("document.querySelector('#knobs').textContent.includes('motor_left.Ra')")
        page.click('#lists [data-signal="motor_left.omega"]')
        page.until("document.querySelector('#scopes canvas')")
        press(page, "Resume")
        standing(page, "done")
        page.assert_clean()
        live = session.running
        assert [(each.t, each.name) for each in live.turned] == [(0.001, "motor_left.Ra")]
        assert not instances()
        results, script = live.results(), live.script(PAPER.with_name("iadrc_fmu.json"), variants=session.chosen)
    again: dict[str, Any] = {}
    exec(script, again)
    assert again["results"].t.tobytes() == results.t.tobytes()
    assert again["results"].values.tobytes() == results.values.tobytes()
    plain = Diagram.load(PAPER.with_name("iadrc_fmu.json")).run(stop=2, log=results.names)
    assert again["results"].values.tobytes() != plain.values.tobytes()


def test_a_run_that_fails_shows_the_block_and_its_last_inputs(chromium: Any, tmp_path: Path) -> None:
    d = Diagram("fails")
    d.wire(d.add("root", Sqrt()).u, d.add("ramp", Ramp(slope=-1.0, before=1.0)).y)
    d.wire(d.add("x", Integrator()).u, "root.y")
    d.settings(stop=3.0, method="rk4", step=0.01)
    d.save(tmp_path / "fails.json")
    with served(tmp_path / "fails.json") as server, chromium() as page:
        shown(page, server.url)
        press(page, "Run")
        standing(page, "failed")
        page.until('document.querySelector(\'#stage [data-path="root"].failing, #stage [data-path="x"].failing\')')
        told = page.text("#failure")
        assert "E303" in told
        assert "The last steps of what" in told
        page.assert_clean()


def test_five_hundred_blocks_are_drawn_found_and_selected(chromium: Any, tmp_path: Path) -> None:
    d = Diagram("chain")
    d.add("g0", Step())
    for k in range(1, 500):
        d.wire(d.add(f"g{k}", Gain(k=1.0)).u, f"g{k - 1}.y")
    d.settings(stop=1.0)
    d.save(tmp_path / "chain.json")
    with served(tmp_path / "chain.json") as server, chromium() as page:
        shown(page, server.url)
        assert page.evaluate("document.querySelectorAll('#stage g[data-path]').length") == 500
        page.press("/")
        page.until("document.querySelector('dialog input')")
        page.type("g437")
        page.until("document.querySelector('#found li')?.textContent.includes('g437')")
        page.press("Enter")
        page.until("document.querySelector('#stage [data-path=\"g437\"].selected')")
        box, view = page.evaluate(
            "['#stage .selected', '#view'].map(one => document.querySelector(one).getBoundingClientRect().toJSON())"
        )
        assert view["left"] <= box["left"] < box["right"] <= view["right"]
        page.assert_clean()


MARKUP = "<img src=x onerror=alert(1)><script>alert(2)</script>\"'&{{7*7}}</title><svg onload=alert(3)>"


def test_hostile_texts_stay_texts(chromium: Any, tmp_path: Path) -> None:
    d = Diagram("evil")
    d.wire(d.add("x", Integrator()).u, d.add("g", Gain(k=1.0)).y)
    d.wire("g.u", d.add("s", Step()).y)
    d.settings(stop=1.0)
    d.save(tmp_path / "plain.json")
    document = json.loads((tmp_path / "plain.json").read_text())
    document["doc"] = MARKUP
    for block in document["blocks"].values():
        block["doc"] = MARKUP
    document["blocks"]["g"]["x-note"] = MARKUP
    path = tmp_path / "<img src=x onerror=alert(4)>.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with served(path) as server, chromium() as page:
        shown(page, server.url)
        page.click('#lists [data-path="g"]')
        page.until("document.getElementById('panel').innerText.includes('onerror=alert(1)')")
        page.click('#lists [data-signal="g.y"]')
        press(page, "Run")
        standing(page, "done")
        # A file whose faults quote what stands in it.
        document["blocks"]["g"]["parameters"] = {MARKUP: 1}
        document["blocks"][MARKUP] = {"type": MARKUP}
        path.write_text(json.dumps(document), encoding="utf-8")
        page.until("document.querySelector('#lists .fault')")
        assert page.evaluate("document.querySelectorAll('img, svg script, [onerror], [onload]').length") == 0
        page.assert_clean()
    static = tmp_path / "evil.html"
    document = json.loads((tmp_path / "plain.json").read_text()) | {"doc": MARKUP}
    static.write_text(page_of(Diagram.from_json(json.dumps(document))), encoding="utf-8")
    with chromium() as page:
        page.open(static.as_uri())
        page.until("document.getElementById('panel').innerText.includes('onerror=alert(1)')")
        page.assert_clean()


def test_a_file_that_changes_is_shown_and_a_broken_one_does_no_harm(chromium: Any, tmp_path: Path) -> None:
    d = Diagram("changes")
    d.wire(d.add("x", Integrator()).u, d.add("s", Step()).y)
    d.settings(stop=1.0)
    path = tmp_path / "changes.json"
    d.save(path)
    before = path.read_text()
    with served(path) as server, chromium() as page:
        shown(page, server.url)
        page.click('#lists [data-path="x"]')
        page.click('#lists [data-signal="x.y"]')
        page.click('[title="Zoom in (+)"]')
        place = "document.getElementById('stage').style.transform"
        looked = page.until(f"{place}.includes('scale(2)') && {place}")
        path.write_text(before[: len(before) // 2])
        page.until("document.querySelector('#lists .fault')")
        assert page.evaluate("document.querySelectorAll('#stage g[data-path]').length") == 2
        d.wire(d.add("late", Gain(k=2.0)).u, "x.y")
        d.save(path)
        page.until("document.querySelector('#stage [data-path=\"late\"]') && !document.querySelector('#lists .fault')")
        assert page.evaluate(place) == looked
        assert page.evaluate("document.querySelector('#stage g.selected[data-path]').dataset.path") == "x"
        assert page.evaluate("document.querySelectorAll('#scopes canvas').length") > 0
        page.assert_clean()


@contextmanager
def command(path: Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`blocks live` in a process, and the address that it prints."""
    words = [sys.executable, "-m", "blocks", "live", str(path), "--no-browser", "--port", str(port)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as live:
        try:
            assert live.stdout is not None
            line = live.stdout.readline()
            yield live, next(word for word in line.split() if word.startswith("http"))
        finally:
            live.kill()


def test_a_page_outlives_its_server_and_tells_another_one_apart(chromium: Any, native: None) -> None:
    with chromium() as page:
        with command(PAPER) as (live, url):
            shown(page, url)
            page.click('#lists [data-signal="x"]')
            press(page, "Run")
            standing(page, "done")
            page.until("document.querySelector('#scopes canvas')")
            live.kill()
            page.until("!document.getElementById('gone').hidden")
        assert "server" in page.text("#gone")
        assert page.evaluate("document.querySelectorAll('#stage g[data-path]').length") > 10  # what was shown stays
        assert page.evaluate("document.getElementById('runbar').dataset.state") == "done"
        page.click('#lists [data-path="robot"]')
        assert page.evaluate("document.querySelector('#stage .selected').dataset.path") == "robot"
        port = int(url.split(":")[2].split("/")[0])
        with command(PAPER, port) as (_, again):
            shown(page, again)
            assert page.evaluate("document.getElementById('runbar').dataset.state") == "none"
        page.assert_clean("WebSocket", "Failed to load resource")


@pytest.mark.parametrize(("size", "dark", "zoom"), [((1280, 800), False, 1.0), ((1366, 768), True, 2.0)])
def test_a_screen_reader_meets_names_and_landmarks(
    chromium: Any, size: tuple[int, int], dark: bool, zoom: float
) -> None:
    with served(PAPER) as server, chromium(width=size[0], height=size[1], dark=dark, zoom=zoom) as page:
        shown(page, server.url)
        page.evaluate("document.querySelector('#lists [data-path=\"motor_right\"]').click()")
        page.evaluate("document.querySelector('#lists [data-signal=\"motor_right.omega\"]').click()")
        page.until("document.querySelector('#panel input[type=range]') && document.querySelector('#scopes canvas')")
        nodes = page.accessible()
        roles = {"button", "textbox", "slider", "combobox", "checkbox", "searchbox", "spinbutton", "link"}
        assert [node for node in nodes if node["role"] in roles and not node["name"].strip()] == []
        named = {(node["role"], node["name"]) for node in nodes}
        assert {role for role, _ in named} >= {"banner", "navigation", "main", "complementary", "list", "heading"}
        # Nothing lies outside of the window but what can be scrolled to.
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        page.assert_clean()
