"""`blocks new`: what it makes runs and passes its tests at once."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from blocks.cli import FIRST_STEPS, main

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_new_project_runs_and_is_canonical(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its files are those that --dry-run names, its commands do what they say, the editor's schema knows its block."""
    assert main(["new", "plant_7", "--dry-run"]) == 0
    planned = re.findall(r"^  (\S+)$", capsys.readouterr().out, re.MULTILINE)
    assert os.listdir(tmp_path) == []
    assert main(["new", "plant_7"]) == 0
    printed = capsys.readouterr().out
    assert "blocks run diagrams/loop.json --library plant_7" in printed
    assert printed.endswith("\n  python -m pip install pytest\n  python -m pytest\n")
    folder = tmp_path / "plant_7"
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()) == planned
    assert not any("NAME" in path.name or "NAME" in path.read_text(encoding="utf-8") for path in folder.rglob("*.*y*"))

    settings = json.loads((folder / ".vscode/settings.json").read_text(encoding="utf-8"))
    schema = json.loads((folder / settings["json.schemas"][0]["url"]).read_text(encoding="utf-8"))
    assert '"Cart"' in json.dumps(schema)
    loop = str(folder / "diagrams/loop.json")
    assert main(["fmt", "--check", loop]) == 0
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(json.loads(Path(loop).read_text(encoding="utf-8")), schema)


@pytest.mark.long
def test_all_that_the_first_steps_and_the_readme_of_a_new_project_say_works(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(command: str, folder: Path) -> None:
        words = re.findall(r'"[^"]*"|\S+', command)
        words = [word.strip('"') for word in words]
        words = [sys.executable, *(["-m", *words] if words[0] == "blocks" else words[1:])]
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout, done.stderr)

    folder = tmp_path / "robot"
    commands = re.findall(r"^  (blocks .*?)(?:   .*)?$", FIRST_STEPS, re.MULTILINE)
    run(commands[0], tmp_path)
    assert len(commands) == 5
    readme = "".join((folder / place).read_text(encoding="utf-8") for place in ("README.md", "fmus/README.md"))
    told = re.findall(r"^    ((?:blocks|python) .*)$", readme, re.MULTILINE)
    assert len(told) == 7
    for command in (*commands[1:], *told):
        run(command, folder)
    assert (folder / "loop.svg").is_file()
    assert (folder / "fmus/Cart.fmu").is_file()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "My-Plant",
            "My-Plant: cannot name a Python module: use small letters, digits and _, and begin with a letter.",
        ),
        ("class", "class: cannot name a Python module"),
        ("math", "math: is the name of an existing Python module."),
        ("numpy", "numpy: is the name of an existing Python module."),
        ("full", "full: exists, and is not empty. Choose another name. Nothing was written."),
        ("file", "file: exists, and is a file."),
    ],
)
def test_a_name_or_a_place_that_is_taken_is_refused(
    name: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine", encoding="utf-8")
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    assert main(["new", name]) == 2
    assert capsys.readouterr().err.startswith(f"E501 {told}")
    assert sorted(os.listdir(tmp_path)) == ["file", "full"]
    assert os.listdir(tmp_path / "full") == ["notes.txt"]
