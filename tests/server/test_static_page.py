"""The page in one file: it holds the run, asks for nothing, and offers nothing that needs a server."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram
from blocks.server.curves import thinned
from blocks.server.static_page import page_of

MOTOR = Path(__file__).parents[2] / "diagrams" / "motor_pid.json"


def content_of(page: str) -> Any:
    found = re.search(r'<script type="application/json" id="content">(.*?)</script>', page, re.DOTALL)
    assert found
    return json.loads(found[1])


def test_the_file_holds_the_rows_of_the_run_and_names_no_other_file() -> None:
    diagram = Diagram.load(MOTOR)
    results = diagram.run()
    page = page_of(diagram, results)
    rows = content_of(page)["rows"]
    assert np.array_equal(np.frombuffer(base64.b64decode(rows["t"]), "<f8"), results.t)
    values = np.frombuffer(base64.b64decode(rows["values"]), "<f4").reshape(-1, len(results.t))
    for name, column in zip(rows["columns"], values, strict=True):
        assert np.array_equal(column, np.float32(results[name]))
        assert rows["units"][name] == results.columns[name][2]
    assert "default-src 'none'" in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL))
    assert not re.search(r"^\s*import\b", page, re.MULTILINE)


def test_thinned_rows_keep_a_spike_of_one_row() -> None:
    t = np.linspace(0.0, 1.0, 100_001)
    values = np.zeros((len(t), 2))
    values[77_777] = 5.0, -3.0
    few, rows = thinned(t, values, 1000)
    assert len(few) < 4100
    assert (rows[:, 0].max(), rows[:, 1].min()) == (5.0, -3.0)
    assert abs(few[np.argmax(rows[:, 0])] - t[77_777]) <= 2e-3


@pytest.mark.long
def test_it_opens_a_scope_and_has_no_control_that_needs_a_server(chromium: Any, tmp_path: Path) -> None:
    diagram = Diagram.load(MOTOR)
    file = tmp_path / "motor.html"
    file.write_text(page_of(diagram, diagram.run()), encoding="utf-8")
    with chromium() as page:
        page.open(file.as_uri())
        page.until("document.querySelector('#scopes canvas')")
        page.until("document.querySelector('#stage svg [data-path]')")
        page.click("#lists [data-path]")
        page.until("document.querySelector('#panel h2')")
        assert page.evaluate("document.querySelectorAll('#panel input, #panel select, #runbar button').length") == 0
        offered = page.evaluate(
            "[...document.querySelectorAll('button')].filter((one) => one.checkVisibility())"
            ".map((one) => one.innerText.trim())"
        )
        assert not {"Run", "Save", "Script", "Keep", "Analyze", "Measured CSV"} & {*offered}
        page.assert_clean()
