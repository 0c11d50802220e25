"""The page in a browser: moving in the drawing, the panel, the lists; by keyboard alone, and as it is heard."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram
from tests.server.test_browser import PAPER, served

pytestmark = pytest.mark.long
HEADING = "document.querySelector('#panel h2')?.innerText"
PLACE = "document.getElementById('stage').style.transform"
FAULTY = {
    "format": "blocks-diagram", "version": 3, "name": "faulty",
    "doc": "</script><img src=x onerror=document.title='evil'>",
    "blocks": {
        "step": {"type": "Step", "doc": "<img src=x onerror=document.title='evil'>"},
        "sum": {"type": "Sum", "parameters": {"signs": "+-"}},
        "inner": {"diagram": {"blocks": {"odd": {"type": "Gainn"}}}},
    },
    "wires": {"sum.u1": "step.y"},
}  # fmt: skip


def drawn(page: Any, url: str) -> None:
    page.open(url)
    page.until("!!document.querySelector('#stage svg [data-path]')")
    page.until(f"!!({HEADING})")


def opened(page: Any, level: str) -> None:
    page.until(f"[...document.querySelectorAll('.path li')].slice(1).map(one => one.innerText).join('.') === {level!r}")


LINES = "[...one.childNodes].forEach(part => part.nodeType === Node.TEXT_NODE && part.remove());"
"""The page keeps no ends of lines between the elements of a drawing."""


def test_the_drawing_is_the_one_of_blocks_draw(chromium: Any) -> None:
    with served(PAPER) as server, chromium() as page:
        drawn(page, server.url)
        made = page.evaluate(
            "(() => { const one = document.querySelector('#stage svg').cloneNode(true);"
            " one.querySelectorAll('.wire-value').forEach(text => text.remove());"  # at the cursor of the scopes
            f" {LINES}"
            " const svg = new XMLSerializer().serializeToString(one); return svg; })()"
        )
        # The style sheet is taken out of it, as the policy of the page wants, and adopted by the page.
        before, style, after = re.split(r"<style>(.*?)</style>", Diagram.load(PAPER).draw())
        wanted, asked, adopted = page.evaluate(
            "(() => { const sheet = new CSSStyleSheet();"
            " const rules = of => [...of.cssRules].map(rule => rule.cssText).join('');"
            f" sheet.replaceSync({json.dumps(style)}); const one = new DOMParser().parseFromString("
            f"{json.dumps(before + after)}, 'image/svg+xml').documentElement; {LINES}"
            " return [new XMLSerializer().serializeToString(one),"
            " rules(sheet), rules(document.adoptedStyleSheets[0])]; })()"
        )
        assert made == wanted
        assert adopted == asked != ""
        page.assert_clean()


def test_the_whole_of_it_by_keyboard_alone(chromium: Any) -> None:
    with served(PAPER) as server, chromium() as page:
        drawn(page, server.url)
        page.press("/")
        page.until("document.activeElement.role === 'combobox'")
        page.type("nlsef")
        page.press("ArrowDown", "Enter")  # the second one that is found
        opened(page, "control_left")
        page.until(f"{HEADING} === 'nlsef'")
        assert page.evaluate("document.activeElement.id") == "view"
        page.press("Backspace")
        opened(page, "")
        page.until(f"{HEADING} === 'control_left'")  # what was left stays selected
        page.press("Shift+ArrowRight")
        page.until(f"{HEADING} === 'motor_left'")
        before = page.evaluate(PLACE)
        page.press("ArrowLeft", "+")
        page.until(f"{PLACE} !== {before!r}")
        page.press("0")
        page.until(f"{PLACE} === {before!r}")
        page.evaluate("document.querySelector('#lists [data-path=motor_left]').focus()")
        page.press("ArrowDown", "Enter")
        page.until(f"{HEADING} === 'robot'")
        page.press("ArrowRight")
        opened(page, "robot")
        page.press("?")
        page.until("document.querySelector('dialog h2')?.innerText === 'Keys'")
        page.press("Escape")
        page.until("!document.querySelector('dialog')")
        page.assert_clean()


def test_every_stop_of_the_tab_key_has_a_name_and_is_seen(chromium: Any) -> None:
    with served(PAPER) as server, chromium(width=1280, height=720) as page:
        drawn(page, server.url)
        page.evaluate("document.querySelector('#lists [data-path=motor_right]').click()")
        page.until(f"{HEADING} === 'motor_right'")
        page.evaluate("document.body.focus()")
        seen = []
        for _ in range(200):
            page.press("Tab")
            told = page.evaluate(
                "(one => one === document.body ? '' : one.closest('[id]')?.id ?? 'bar')(document.activeElement)"
            )
            if not told:
                break
            # That of the drawing is a border above it.
            shown = page.evaluate(
                "[getComputedStyle(document.activeElement).outlineStyle,"
                " getComputedStyle(document.activeElement, '::after').borderTopStyle]"
            )
            assert shown != ["none", "none"], page.evaluate("document.activeElement.outerHTML")
            seen.append(told)
        for pane in ("lists", "drawing", "view"):
            assert pane in seen, seen
        nodes = page.accessible()
        roles = {node["role"] for node in nodes}
        assert {"banner", "navigation", "main", "complementary", "region", "heading", "list", "button"} <= roles
        bare = [node for node in nodes if node.get("focusable") and not node["name"] and node["role"] != "RootWebArea"]
        assert bare == []
        page.assert_clean()


def test_pan_zoom_fit_and_a_double_click_by_mouse(chromium: Any) -> None:
    with served(PAPER) as server, chromium(width=1440, height=900) as page:
        drawn(page, server.url)
        fitted = page.evaluate(PLACE)
        x, y = page.center("#view")
        page.drag(x, y, x + 100, y + 50)
        page.until(f"{PLACE} !== {fitted!r}")
        moved = page.evaluate(PLACE)
        page.wheel(x, y, dy=-120, modifiers="Control")
        page.until(f"{PLACE} !== {moved!r}")
        page.press("f")
        page.until(f"{PLACE} === {fitted!r}")
        page.click('#stage [data-path="robot"]', count=2)
        opened(page, "robot")
        page.click(".path li button")
        opened(page, "")
        page.until(f"{HEADING} === 'robot'")
        page.assert_clean()


def test_another_text_in_the_file_is_shown_and_view_level_and_selection_stay(chromium: Any, tmp_path: Path) -> None:
    for name in ("iadrc.json", "control_iadrc.json", "robot.json"):
        (tmp_path / name).write_bytes((PAPER.parent / name).read_bytes())
    file = tmp_path / "iadrc.json"
    with served(file) as server, chromium() as page:
        drawn(page, server.url)
        page.evaluate("document.querySelector('#lists [data-path=motor_right]').click()")
        page.until(f"{HEADING} === 'motor_right'")
        fitted = page.evaluate(PLACE)
        page.press("+")
        page.until(f"{PLACE} !== {fitted!r}")
        place = page.evaluate(PLACE)
        file.write_text(file.read_text().replace('"motor_right": {"type"', '"motor_right": {"doc": "mended", "type"'))
        page.until("document.querySelector('#panel .own')?.innerText === 'mended'")
        assert page.evaluate(PLACE) == place
        assert page.evaluate("document.querySelector('#stage .selected').dataset.path") == "motor_right"
        page.until("document.getElementById('announcer').textContent.includes('read again')")
        page.assert_clean()


def test_faults_lead_to_their_blocks_and_hostile_texts_stay_texts(chromium: Any, tmp_path: Path) -> None:
    file = tmp_path / "faulty.json"
    file.write_text(json.dumps(FAULTY))
    with served(file) as server, chromium(dark=True, width=1280, height=720) as page:
        drawn(page, server.url)
        page.until("document.querySelectorAll('#lists .fault').length === 2")
        page.evaluate(
            "[...document.querySelectorAll('#lists .fault')].find(one => one.innerText.includes('E103')).click()"
        )
        opened(page, "inner")
        page.until(f"{HEADING} === 'odd'")
        assert "E103" in page.text("#panel .faults")
        page.press("Backspace")
        opened(page, "")
        page.until("document.querySelector('#lists [data-path=step]') !== null")
        page.evaluate("document.querySelector('#lists [data-path=step]').click()")
        page.until("document.querySelector('#panel .own')?.innerText.startsWith('<img')")
        assert page.evaluate("document.querySelectorAll('img, #panel script').length") == 0
        assert page.evaluate("document.title") == "faulty - blocks"
        page.assert_clean()


def test_at_200_percent_nothing_is_cut_off_sideways(chromium: Any) -> None:
    with served(PAPER) as server, chromium(width=1280, height=720, zoom=2.0) as page:
        drawn(page, server.url)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        page.click("#panel h2")
        page.assert_clean()
