"""The shape of the project: one public door, light imports, codes that exist, no word that does not belong."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib

import pytest

import blocks
from blocks.text.errors import CODES
from tests.support.places import ROOT

SOURCES = sorted((ROOT / "blocks").rglob("*.py"))


def test_every_public_name_is_there_and_the_list_is_sorted() -> None:
    assert blocks.__all__ == sorted(blocks.__all__)
    for name in blocks.__all__:
        assert getattr(blocks, name) is not None
    assert set(blocks.__all__) <= set(dir(blocks))
    assert set(blocks.library.LIBRARY) <= set(blocks.__all__)
    assert all(getattr(blocks, name) is cls for name, cls in blocks.library.LIBRARY.items())


def test_importing_blocks_loads_no_heavy_package() -> None:
    heavy = ("numpy", "scipy", "casadi", "control", "matplotlib", "fmpy")
    code = f"import sys, blocks; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("engine", ["reference", "auto"])
def test_running_a_diagram_without_fmus_loads_neither_figures_nor_linear_analysis_nor_fmpy(engine: str) -> None:
    run = f"from blocks import Diagram; Diagram.load('diagrams/motor_pid.json').run(stop=0.01, engine={engine!r})"
    code = f"import sys; {run}; print([name for name in ('control', 'matplotlib', 'fmpy') if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_a_plain_installation_brings_what_the_package_imports() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {re.split(r"[<>=!~\[; ]", text)[0] for text in project["dependencies"]}
    imported = set()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(str(node.module).partition(".")[0])
    optional = {"pandas", "pyarrow"}  # E504 tells what to install
    assert named == imported - sys.stdlib_module_names - optional - {"blocks"}


def test_listing_and_checking_structure_do_not_load_casadi() -> None:
    flatten = "from blocks import Diagram; Diagram.load('diagrams/paper/iadrc.json').flatten()"
    code = f"import sys; {flatten}; print('casadi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "False"


def test_every_code_that_is_used_is_explained_and_every_one_explained_is_used() -> None:
    used = set()
    for path in SOURCES:
        if path.name != "errors.py":
            used |= set(re.findall(r'"([EW][0-9]{3})"', path.read_text(encoding="utf-8")))
    assert used == set(CODES)


def test_every_module_says_what_it_is() -> None:
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        assert text.startswith(('"""', 'r"""')), path


def test_no_module_prints_or_evaluates_but_the_command_line_and_the_printer() -> None:
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if not {"cli", "explanations"} & set(path.parts):  # the examples of explanations are texts
            assert not re.search(r"^\s*print\(", text, re.MULTILINE), path
        if path.name != "python_code.py":
            assert not re.search(r"\b(eval|exec)\(", text), path


def test_tests_that_take_long_are_left_out_by_themselves_and_run_by_the_pipeline() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    assert "-m 'not long'" in options["addopts"]
    assert [marker.partition(":")[0] for marker in options["markers"]] == ["long"]
    rules = dict(re.findall(r"^(\S+):.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert "-m long" not in rules["pytest"] + rules["native"]
    assert "-m long" in rules["long"]
    assert "-m long" in rules["native-long"]
    lines = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("make")] == ["make test", "make test-long"]
