"""A Simulink model that is dropped on the page of the editor."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.hands import edited_page
from tests.support.simulink_models import FOLDER

DROP = """((name, text) => { const list = new DataTransfer();
  list.items.add(new File([Uint8Array.from(atob(text), (one) => one.charCodeAt(0))], name));
  const view = document.getElementById('view'), { left, top } = view.getBoundingClientRect();
  const at = { clientX: left + 200, clientY: top + 200, bubbles: true };
  view.dispatchEvent(new DragEvent('drop', { dataTransfer: list, ...at }));
})"""


@pytest.mark.long
def test_a_model_that_is_dropped_is_a_block_and_the_page_says_what_was_decided(chromium: Any, tmp_path: Path) -> None:
    with edited_page(chromium, tmp_path / "own.json") as hands:
        data = base64.b64encode((FOLDER / "bouncing_ball.slx").read_bytes()).decode()
        hands.done(lambda: hands.page.evaluate(f"{DROP}('bouncing_ball.slx', '{data}')"))
        hands.seen('[data-path="bouncing_ball"]')
        hands.page.until("document.body.innerText.includes('its value at the start is that of its input')")
        hands.page.assert_clean()
    written = json.loads((tmp_path / "own.json").read_text())
    assert written["blocks"]["bouncing_ball"]["diagram"] == "bouncing_ball.json"
    assert (tmp_path / "bouncing_ball.json").is_file()
