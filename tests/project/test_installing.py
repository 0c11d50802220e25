"""The wheel holds what is needed and no more, and runs by itself; text files are the same on every system.

`python -m benchmarks.installing` installs it with what it depends on, for every supported Python.
"""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from benchmarks import installing
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.places import ROOT

IN_GIT = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="these files come without git")


@IN_GIT
@pytest.mark.long
def test_the_wheel_is_whole_and_runs_without_the_checkout(tmp_path: Path) -> None:
    wheel = installing.build_wheel(tmp_path)
    assert wheel.name.endswith("-py3-none-any.whl")
    assert wheel.stat().st_size < 3e6
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if name.startswith("blocks/")}
        archive.extractall(tmp_path / "site")
    listed = subprocess.run(["git", "ls-files", "blocks"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert held == set(listed.stdout.split())
    runner = tmp_path / "runner.py"
    place = str(tmp_path / "site")
    runner.write_text(
        f"import sys\nsys.path.insert(0, {place!r})\nfrom blocks.cli import main\n"
        f"assert main.__code__.co_filename.startswith({place!r})\nsys.exit(main())\n"
    )
    if find_compiler() is not None:
        assert installing.try_commands([sys.executable, runner], tmp_path / "work") == len(installing.COMMANDS)


@IN_GIT
def test_text_has_the_same_line_ends_on_every_system() -> None:
    """Digests and golden files count bytes: git must not write others where a system has other line ends."""
    assert "* text=auto eol=lf" in (ROOT / ".gitattributes").read_text(encoding="utf-8")
    told = subprocess.run(["git", "ls-files", "--eol"], cwd=ROOT, capture_output=True, text=True, check=True)
    odd = [line for line in told.stdout.splitlines() if line.startswith(("i/crlf", "i/mixed"))]
    assert odd == []
