"""The README's files, commands and Python run as they stand, and print what it says.

`UPDATE_README=1 python -m pytest tests/project/test_readme.py` writes what they print now into it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from tests.support.samples import FENCE, ROOT, Page, workplace

README = ROOT / "README.md"


def test_the_readme_shows_real_commands_and_real_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names: dict[str, object] = {}
    exec("import numpy as np; from blocks import *", names)
    page = Page(README, update=bool(os.environ.get("UPDATE_README")), names=names)
    with workplace(tmp_path, monkeypatch):
        page.run()
    assert page.checked >= 8
    if page.update:
        README.write_text(page.text, encoding="utf-8")
        pytest.skip("README.md was written anew")


def test_the_ball_of_the_readme_bounces_when_that_of_the_library_does() -> None:
    import numpy as np

    from blocks import Block, Diagram, Discrete, Parameter, State, crossing

    text = README.read_text(encoding="utf-8")
    body = next(m["body"] for m in FENCE.finditer(text) if m["body"].startswith("class Ball"))
    names = {
        "np": np,
        "Block": Block,
        "Discrete": Discrete,
        "Parameter": Parameter,
        "State": State,
        "crossing": crossing,
    }
    exec(compile(body, "README.md", "exec"), names)
    times = []
    for cls in (names["Ball"], __import__("blocks").BouncingBall):
        diagram = Diagram("ball")
        diagram.add("ball", cls())
        times.append([event.t for event in diagram.run(stop=4.0).events])
    assert len(times[0]) > 20
    assert times[0] == pytest.approx(times[1], abs=1e-9)


def test_the_readme_names_every_block_of_the_library() -> None:
    from blocks.library import LIBRARY

    table = README.read_text(encoding="utf-8").partition("## The library")[2].partition("\n## ")[0]
    rows = [row.partition(";")[0].split(",") for row in re.findall(r"\| \w[\w ]* \| (.*) \|", table)]
    named = [word.strip() for row in rows for word in row]
    assert sorted(named) == sorted(LIBRARY)
