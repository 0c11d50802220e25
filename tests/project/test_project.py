"""The shape of the project: one public door, light imports, codes that exist, no word that does not belong."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import blocks
from blocks.api import late
from blocks.model import simulink
from blocks.text.explanations import EXPLAINED
from tests.support.places import ROOT

SOURCES = sorted((ROOT / "blocks").rglob("*.py"))


def test_every_public_name_is_there_and_the_list_is_sorted() -> None:
    assert blocks.__all__ == sorted(blocks.__all__)
    for name in blocks.__all__:
        assert getattr(blocks, name) is not None
    assert set(blocks.__all__) <= set(dir(blocks))
    assert set(blocks.library.LIBRARY) <= set(blocks.__all__)
    assert all(getattr(blocks, name) is cls for name, cls in blocks.library.LIBRARY.items())


def test_a_name_that_is_not_there_comes_with_its_equivalent_or_the_nearest_name() -> None:
    """Also in `from blocks import name`, which makes a bare ImportError of an AttributeError."""
    for name, hint in (
        ("Scope", 'The equivalent of "Scope": No block: every signal can be recorded.'),
        ("TransferFcn", 'The equivalent of "Transfer Fcn": `TransferFunction`'),
        ("Stop", 'The equivalent of "Stop Simulation": `"stop_when": "lift.height >= 3"`'),
        ("SecondOrderIntegrator", 'The equivalent of "Integrator, Second-Order": Two `Integrator` blocks'),
        ("TransferFuntion", "Did you mean 'TransferFunction'?"),
    ):
        words = re.escape(f"module 'blocks' has no attribute '{name}'. {hint}")
        with pytest.raises(ImportError, match=words):
            exec(f"from blocks import {name}")
        with pytest.raises(AttributeError, match=words):
            getattr(blocks, name)
        assert not hasattr(blocks, name)
    assert set(simulink.TYPES.values()) <= set(simulink.words())
    from blocks import model  # a module, and "Model" is a term of Simulink

    assert model.__name__ == "blocks.model"
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from blocks import nothing")


def test_names_of_the_analysis_are_offered_where_they_are_missed() -> None:
    with pytest.raises(ImportError, match=r"'margins'\. Write from blocks\.analysis import margins\.$"):
        exec("from blocks import margins")
    with pytest.raises(AttributeError, match=r"Write from blocks\.analysis import bode\."):
        _ = blocks.bode  # type: ignore[attr-defined]
    with pytest.raises(ImportError, match=r"has no attribute 'nyquist_plot'\. Did you mean 'nyquist'\?"):
        exec("from blocks.analysis import nyquist_plot")
    with pytest.raises(ImportError, match=r"has no attribute 'margin'\. Write margins\(loop\)\.$"):
        exec("from blocks.analysis import margin")
    from blocks import compare  # a module, and a function of the analysis
    from blocks.analysis import loop_maps  # a module, beside the function loop_map

    assert (compare.__name__, loop_maps.__name__) == ("blocks.compare", "blocks.analysis.loop_maps")


def test_rooms_above_are_called_by_name_from_one_place() -> None:
    """Imports by name are no way around the floors: rooms stand in api/late.py, modules that users name elsewhere."""
    found = {
        str(path.relative_to(ROOT / "blocks"))
        for path in SOURCES
        if "import_module(" in path.read_text(encoding="utf-8") and path.parent.name not in ("blocks", "cli", "library")
    }
    others = {"analysis/__init__.py", "model/modules.py", "results/table.py", "studies/distributed.py"}
    assert found == {"api/late.py", *others}
    for name, module in late._MODULES.items():
        assert callable(getattr(importlib.import_module(f"blocks.{module}"), name))


def test_importing_blocks_loads_no_heavy_package() -> None:
    heavy = ("numpy", "scipy", "control", "matplotlib", "fmpy")
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
    optional = {"distributed", "fsspec", "pandas", "pyarrow"}  # E504 tells what to install
    assert named == imported - sys.stdlib_module_names - optional - {"blocks"}


def test_diagrams_run_and_are_linearized_where_casadi_is_not_installed() -> None:
    diagram = "d = blocks.Diagram.load('diagrams/analysis/leso_pd.json')"
    run = "d.run(stop=0.01, method='radau', engine='reference'); d.linearize('r', 'motor.omega')"
    code = f"import sys; sys.modules['casadi'] = None; import blocks; {diagram}; {run}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_reference_engine_runs_where_python_has_neither_fcntl_nor_resource(tmp_path: Path) -> None:
    """As in a browser; the truth is the same run where both are."""
    program = """
import importlib, pkgutil, sys
for name in sys.argv[2:]:
    sys.modules[name] = None
import blocks
for module in pkgutil.walk_packages(blocks.__path__, "blocks.") if sys.argv[2:] else ():
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
for file, method in (("motor_pid", "dopri5"), ("paper/iadrc", "radau")):
    results = blocks.Diagram.load(f"diagrams/{file}.json").run(stop=0.01, method=method, engine="reference")
    results.save(f"{sys.argv[1]}-{method}.csv")
"""
    for name, missing in (("with", ()), ("without", ("fcntl", "resource"))):
        command = [sys.executable, "-c", program, str(tmp_path / name), *missing]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
        assert (done.returncode, done.stderr) == (0, "")
    for method in ("dopri5", "radau"):
        ours, theirs = ((tmp_path / f"{name}-{method}.csv").read_bytes() for name in ("without", "with"))
        assert ours == theirs


def test_every_code_that_is_used_is_explained_and_every_one_explained_is_used() -> None:
    used = set()
    for path in SOURCES:
        used |= set(re.findall(r'"([EW][0-9]{3})"', path.read_text(encoding="utf-8")))
    assert used == set(EXPLAINED)


def test_every_module_says_what_it_is() -> None:
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        assert text.startswith(('"""', 'r"""')), path


def test_no_module_prints_or_evaluates_but_the_command_line_and_the_printer() -> None:
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        if "cli" not in path.parts:
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
    assert [line for line in lines if line.startswith("make")] == ["make browser", "make test", "make test-long"]
    assert "export BLOCKS_BROWSER=required" in lines  # a browser that is missing is a failure there
