"""`exit(0)` in the code of an FMU that runs in the process of Python: an error with a code of its own, and what was
computed is written; in both engines, for both kinds and both versions of FMI. The program's own exit stays its own.

Witness: the rows of the same diagram with an FMU that does not fail.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Step, fmu
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.marks import long

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="exit is heard on Linux and macOS")
pytestmark = [NEEDS_COMPILER, LINUX]
ENGINES = pytest.mark.parametrize("engine", ["reference", "native"])
STOP, T_FAULT = 1.0, 0.5  # s
EXITS = FAULTS.index("exit")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, str], Path]:
    """A diagram with a plant x' = u, u = 1, that calls exit(0) from T_FAULT on."""
    made = {}
    for fmi in (2, 3):
        for kind in ("CS", "ME"):
            folder = tmp_path_factory.mktemp(f"{kind}{fmi}")
            path = make(folder, fmi=fmi, kind=kind, name="plant", defines=("EXITS_WITH=0",))
            diagram = Diagram("loop")
            step = diagram.add("r", Step(at=0.0))
            plant = diagram.add("plant", fmu(path, kind, parameters={"t_fault": T_FAULT, "fault": EXITS}))
            diagram.wire(plant.u, step.y)
            settings: dict[str, Any] = {"master": {"step": 0.1}} if kind == "CS" else {}
            diagram.settings(stop=STOP, log=["plant.y"], every=0.1, **settings)
            diagram.save(folder / "loop.json")
            made[fmi, kind] = folder / "loop.json"
    return made


def ended(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A Python process, to its end; its temporary files are in a folder `t`."""
    (folder / "t").mkdir(exist_ok=True)
    environment = {**os.environ, "TMPDIR": str(folder / "t")}
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, env=environment, timeout=60)


@ENGINES
@pytest.mark.parametrize("kind", ["CS", "ME"])
@pytest.mark.parametrize("fmi", [long(2), 3])
def test_a_command_ends_with_an_error_and_keeps_what_was_computed(
    fmi: int, kind: str, engine: str, files: dict[tuple[int, str], Path], tmp_path: Path
) -> None:
    rows = tmp_path / "rows.csv"
    words = ["-m", "blocks", "run", str(files[fmi, kind]), "--engine", engine]
    done = ended(*words, "--out", str(rows), "--json", folder=tmp_path)
    assert done.returncode == 4
    (entry, last) = (json.loads(line) for line in done.stdout.splitlines() if '"fault"' in line or '"done"' in line)
    assert (entry["code"], entry["place"]) == ("E216", "plant")
    assert entry["message"] == "plant.fmu ended the process: its code called exit."
    # An ME FMU is asked within steps, of which the last one went beyond the fault.
    table = np.loadtxt([line for line in rows.read_text().splitlines() if line[0].isdigit()], delimiter=",", ndmin=2)
    assert table[-1, 0] == pytest.approx(0.4) if kind == "CS" else table[-1, 0] <= T_FAULT
    assert len(table) == round(10 * table[-1, 0]) + 1
    assert table[:, 1] == pytest.approx(table[:, 0], abs=1e-9)  # x' = 1
    assert last["t"] == table[-1, 0]
    assert f"Results up to {table[-1, 0]:.10g} s are kept." in entry["cure"]
    assert os.listdir(tmp_path / "t") == []


def test_a_table_is_told_as_after_other_errors(files: dict[tuple[int, str], Path], tmp_path: Path) -> None:
    done = ended("-m", "blocks", "run", str(files[3, "CS"]), folder=tmp_path)
    assert done.returncode == 4
    assert "E216 plant: plant.fmu ended the process: its code called exit." in done.stderr
    assert "plant.y" in done.stdout


def test_the_runs_of_a_study_that_are_done_are_kept(files: dict[tuple[int, str], Path], tmp_path: Path) -> None:
    diagram = files[3, "CS"]
    runs = {"good": {"diagram": diagram.name, "parameters": {"plant.fault": 0}}, "bad": {"diagram": diagram.name}}
    study = diagram.with_name("study.json")
    study.write_text(json.dumps({"format": "blocks-study", "version": 1, "name": "s", "runs": runs}))
    done = ended("-m", "blocks", "study", str(study), "--out", str(tmp_path / "out"), "--json", folder=tmp_path)
    assert done.returncode == 4
    kept, fault = (json.loads(line) for line in done.stdout.splitlines() if '"kept"' in line or '"fault"' in line)
    assert (fault["code"], list(kept["kept"])) == ("E216", ["good"])
    rows = tmp_path / "rows.csv"
    ended("-m", "blocks", "run", str(diagram), "--set", "plant.fault=0", "--out", str(rows), folder=tmp_path)
    assert Path(kept["kept"]["good"]).read_bytes() == rows.read_bytes()


IN_PYTHON = """
import atexit, ctypes, sys
from blocks import Diagram
what, path, engine = sys.argv[1:]
parameters = {} if what == "fmu" else {"plant.fault": 0}
diagram = Diagram.load(path)
run = diagram.start(engine=engine, parameters=parameters)
run.advance_to(0.3)
atexit.register(print, "over", flush=True)
if what == "C":
    ctypes.CDLL(None).exit(7)  # the FMU is loaded and has an instance
if what == "python":
    sys.exit(7)
run.finish()
print("done")
sys.exit(7)
"""


@pytest.mark.parametrize(("kind", "engine"), [("CS", "native"), ("ME", "native"), ("CS", "reference")])
def test_a_program_ends_with_an_error_where_an_fmu_exits(
    kind: str, engine: str, files: dict[tuple[int, str], Path], tmp_path: Path
) -> None:
    done = ended("-c", IN_PYTHON, "fmu", str(files[3, kind]), engine, folder=tmp_path)
    assert done.returncode == 4
    assert done.stdout == ""
    assert done.stderr.startswith("E216 plant: plant.fmu ended the process: its code called exit.")


@pytest.mark.parametrize(("what", "said"), [("python", "over\n"), ("run", "done\nover\n"), ("C", "")])
def test_an_exit_of_the_program_itself_stays_its_own(
    what: str, said: str, files: dict[tuple[int, str], Path], tmp_path: Path
) -> None:
    done = ended("-c", IN_PYTHON, what, str(files[3, "CS"]), "native", folder=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (7, said, "")


def test_a_thread_of_an_fmu_that_exits_is_told_too(tmp_path: Path) -> None:
    """Results need the main thread, which is in the FMU; what is there is the error and the code."""
    code = """
import ctypes, subprocess, sys, threading
from pathlib import Path
from blocks.fmi import exits
folder = Path(sys.argv[1])
text = "#include <stdlib.h>\\nvoid f(void) { exit(0); }"
subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", folder / "f.so"], input=text, text=True, check=True)
exits.watch(folder, "x.fmu")
library = ctypes.CDLL(str(folder / "f.so"))
threading.Thread(target=library.f).start()
threading.Event().wait()
"""
    done = ended("-c", code, str(tmp_path), folder=tmp_path)
    assert done.returncode == 4
    assert done.stderr.startswith("E216 x.fmu: x.fmu ended the process: its code called exit.")


def test_an_exit_while_a_library_loads_or_after_it_is_unloaded_is_told_or_none(tmp_path: Path) -> None:
    code = """
import ctypes, subprocess, sys
from pathlib import Path
from blocks.fmi import exits
folder = Path(sys.argv[1])
text = "#include <stdlib.h>\\n__attribute__((constructor)) static void f(void) { exit(0); }"
subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", folder / "f.so"], input=text, text=True, check=True)
exits.watch(folder, "x.fmu")
if sys.argv[2] == "forgotten":
    exits.forget(folder)
ctypes.CDLL(str(folder / "f.so"))
"""
    for what, status in (("watched", 4), ("forgotten", 0)):
        done = ended("-c", code, str(tmp_path), what, folder=tmp_path)
        assert done.returncode == status
        assert done.stderr.startswith("E216 x.fmu: ") == (status == 4)


def test_a_process_that_an_fmu_forks_ends_with_its_own_code(tmp_path: Path) -> None:
    """It is no run that ends: an FMU may have helpers. One that Python forks is a run of its own."""
    code = """
import ctypes, os, subprocess, sys
from pathlib import Path
from blocks.fmi import exits
folder = Path(sys.argv[1])
text = (
    "#include <stdlib.h>\\n#include <unistd.h>\\n#include <sys/wait.h>\\nvoid f(void) { exit(3); }\\n"
    "int g(void) { int s = 0; pid_t p = fork(); if (!p) exit(3); waitpid(p, &s, 0); return WEXITSTATUS(s); }\\n"
)
subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", folder / "f.so"], input=text, text=True, check=True)
exits.watch(folder, "x.fmu")
library = ctypes.CDLL(str(folder / "f.so"))
print(library.g(), flush=True)
child = os.fork()
if not child:
    library.f()
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = ended("-c", code, str(tmp_path), folder=tmp_path)
    assert done.stdout == "3\n4\n"
    assert done.stderr.count("E216") == 1
