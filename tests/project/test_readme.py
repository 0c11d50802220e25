"""The README's Python and commands run as they stand and print what it says; its pictures are what its commands make.

`UPDATE_README=1 python -m pytest tests/project/test_readme.py -m ""` writes what they print and draw now.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from tests.support.places import ROOT
from tests.support.samples import Page, assert_same, run_command, workplace

README = ROOT / "README.md"
STATIC = ROOT / "docs" / "_static"
UPDATE = bool(os.environ.get("UPDATE_README"))
PICTURE = re.compile(
    r"^<!-- picture: (?:(?P<command>blocks .*?)(?: -> )?)?(?P<file>\S+\.(?:svg|png)) -->$", re.MULTILINE
)
"""A command and the file that it writes, which stands last; a file alone is made by a command that the page shows."""


def test_the_readme_shows_real_commands_output_and_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Page(README, update=UPDATE)
    with workplace(tmp_path, monkeypatch):
        page.run()
        for picture in PICTURE.finditer(page.text):
            name = Path(picture["file"]).name
            if picture["command"] and "blocks study" not in picture["command"]:
                run_command(picture["command"] + " " + picture["file"])
                assert Path(name).is_file(), picture[0]
            if UPDATE and Path(name).is_file():
                shutil.copy(name, STATIC / name)
    assert page.checked >= 5
    if UPDATE:
        README.write_text(page.text, encoding="utf-8")


def test_the_readme_is_short_and_its_pictures_and_links_are_there() -> None:
    text = README.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    shown = {Path(name).name for name in re.findall(r"docs/_static/\S+?\.(?:svg|png)", text)}
    assert shown == {Path(picture["file"]).name for picture in PICTURE.finditer(text)}
    for name in (*re.findall(r"\]\(([^)#]+)", text), *(f"docs/_static/{name}" for name in shown)):
        assert (ROOT / name).exists(), name
    for name in shown:
        if name.endswith(".svg"):  # pages may be dark; a figure of matplotlib has a face, a drawing its ground
            assert 'class="bg"' in (STATIC / name).read_text(encoding="utf-8"), name


@pytest.mark.long
def test_the_demo_prints_what_the_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of `make demo`, as they stand in the Makefile."""
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ndemo:")[2].partition("\n\n")[0]
    with workplace(tmp_path, monkeypatch):
        printed = [
            line for command in re.findall(r"-m (blocks .*)", recipe) for line in run_command(command).splitlines()
        ]
        name = "fig7_heading.png"
        assert (tmp_path / "out" / "paper" / name).is_file()
    (shown,) = re.findall(r"^```text\n(run .*?)^```$", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    at = 0
    for line in shown.splitlines():
        if line == "...":
            continue
        while not printed[at].startswith(line[:30].rstrip()):
            at += 1
        assert_same(printed[at], line)
