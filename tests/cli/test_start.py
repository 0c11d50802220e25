"""What a command does not load: the time from the command line to the first answer is mostly imports."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TELLS = """
import atexit, sys
atexit.register(lambda: print(*sorted(sys.modules), file=sys.stderr))
from blocks.cli import main
sys.exit(main(sys.argv[1:]))
"""
HEAVY = {"control", "matplotlib", "pandas", "pyarrow", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.sparse"}


def loaded(*arguments: str, status: int = 0) -> set[str]:
    """The modules that a command has loaded at its end."""
    done = subprocess.run(
        [sys.executable, "-c", TELLS, *arguments],
        cwd=ROOT, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONUTF8": "1"},
    )  # fmt: skip
    assert done.returncode == status, done.stderr
    return set(done.stderr.splitlines()[-1].split())


@pytest.mark.parametrize("arguments", [("nonsense",), ("run",), ("linearize", "x.json", "--nosuch")])
def test_a_word_that_is_no_command_or_option_is_refused_before_numpy(arguments: tuple[str, ...]) -> None:
    modules = loaded(*arguments, status=2)
    assert "numpy" not in modules
    assert not {name for name in modules if name.startswith(("blocks.model", "blocks.api", "blocks.library."))}
    assert arguments[0] != "nonsense" or "blocks.cli.run" not in modules


@pytest.mark.parametrize("form", [(), ("--json",)], ids=["text", "json"])
@pytest.mark.parametrize("what", [("--loop", "control.u"), ("--from=r", "--to=motor.omega")], ids=["loop", "path"])
def test_margins_and_poles_as_text_need_neither_python_control_nor_scipy(
    what: tuple[str, ...], form: tuple[str, ...]
) -> None:
    modules = loaded("linearize", "diagrams/analysis/leso_pd.json", *what, *form)
    assert "blocks.frequency.margins" in modules
    assert not HEAVY & modules


def test_a_wrong_signal_is_refused_without_scipy() -> None:
    modules = loaded("linearize", "diagrams/analysis/leso_pd.json", "--loop", "contrl.u", status=2)
    assert "scipy" not in modules
    assert "blocks.frequency.margins" not in modules


def test_a_run_loads_one_engine_and_nothing_of_fmus_or_figures() -> None:
    modules = loaded("run", "diagrams/bouncing_ball.json", "--engine", "native")
    own = {name for name in modules if name.startswith("blocks.")}
    assert "blocks.engines.native.native_engine" in own
    assert not {name for name in own if name.startswith(("blocks.engines.reference", "blocks.engines.master"))}
    assert not {name for name in own if name.startswith(("blocks.linear", "blocks.frequency", "blocks.draw"))}
    of_fmus = ("archive", "model_description", "description", "library", "instance")
    assert not own & {f"blocks.fmi.{name}" for name in of_fmus}
    assert not (HEAVY | {"scipy", "importlib.metadata", "jsonschema"}) & modules


def test_a_command_loads_the_modules_of_no_other_command() -> None:
    modules = loaded("explain", "E101")
    assert "numpy" not in modules
    assert {name for name in modules if name.startswith("blocks.cli.")} <= {
        f"blocks.cli.{name}" for name in ("explain", "options", "output", "stop_signals", "option_values")
    }


def test_fmus_for_co_simulation_alone_need_no_other_engine() -> None:
    text = "from blocks import Diagram, fmu; d = Diagram('d'); d.add('m', fmu('fmus/PMDCMotor.fmu', 'CS')); "
    text += "d.run(stop=1, engine='native')"
    done = subprocess.run(
        [sys.executable, "-c", f"{text}; import sys; print(*sys.modules)"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    own = set(done.stdout.split())
    assert "blocks.engines.master.native_master" in own
    engines = {"blocks.engines.native.native_engine", "blocks.engines.reference.reference_engine"}
    assert not own & {*engines, "blocks.compile.c.model_code"}


def test_a_run_loads_the_modules_of_its_own_blocks_alone() -> None:
    modules = loaded("check", "diagrams/paper/iadrc.json")
    assert "blocks.library.adrc" in modules
    assert not {"blocks.library.flight", "blocks.library.tables", "blocks.library.power"} & modules


def test_a_diagram_whose_code_is_cached_is_not_emitted_again() -> None:
    loaded("run", "diagrams/paper/iadrc.json", "--engine", "native", "--stop", "0.1")
    modules = loaded("run", "diagrams/paper/iadrc.json", "--engine", "native", "--stop", "0.1")
    assert "blocks.engines.native.model" in modules
    assert not {name for name in modules if name.startswith("blocks.compile.c.") and name.endswith("_code")}
    assert "blocks.editing.applying" not in modules
