"""What FMUs of other tools do within the standard, and what a run makes of it; in both engines.

The FMU is the integrator of support/faulty, x' = k u with y = x + d u, whose values are known in closed form; its
description is changed as other tools write it.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import pytest

from blocks import Constant, Diagram, fmu
from blocks.cli import main
from blocks.results.results import Results
from blocks.text.errors import FMUError, ModelError
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make

pytestmark = NEEDS_COMPILER

EACH = pytest.mark.parametrize("engine", ["reference", "native"])
KINDS = pytest.mark.parametrize("kind", ["CS", "ME"])
BOTH = pytest.mark.parametrize("fmi", [2, 3])
STOP = 1.0  # s


def described(folder: Path, fmi: int, kind: str, *replaced: tuple[str, str], **options: Any) -> Path:
    """The FMU with another description. replaced: patterns and what stands in their places."""
    path = make(folder, fmi=fmi, kind=kind, **options)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = files["modelDescription.xml"].decode()
    for pattern, new in replaced:
        text, count = re.subn(pattern, new, text)
        assert count == 1, pattern
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {**files, "modelDescription.xml": text.encode()}.items():
            archive.writestr(name, data)
    return path


def start_of(name: str, old: str, new: str) -> tuple[str, str]:
    """A replacement of the start value of a variable."""
    return rf'(name="{name}"[^/]*? )start="{old}"', rf"\1{new}"


def driven(path: Path, kind: str, u: float = 1.0, **given: Any) -> Diagram:
    """The FMU with a constant at its input."""
    made = Diagram("driven")
    source, plant = made.add("source", Constant(value=u)), made.add("plant", fmu(path, kind, **given))
    made.wire(plant.u, source.y)
    return made


def run(diagram: Diagram, engine: str, **settings: Any) -> Results:
    return diagram.run(engine=engine, **{"stop": STOP, "log": ["plant.y"], **settings})


# --- start values that are not finite, or not there ----


@EACH
@KINDS
@BOTH
@pytest.mark.parametrize("text", ['start="INF"', ""])
def test_what_the_description_cannot_say_the_fmu_keeps_unless_it_is_given(
    text: str, fmi: int, kind: str, engine: str, tmp_path: Path
) -> None:
    changed = [start_of("k", "1", text)]
    if text:
        changed += [start_of("x", "0", 'start="-INF"'), start_of("t_fault", "1", 'start="NaN"')]
        changed += [start_of("d", "0", 'start="0" min="-INF" max="INF"')]
    path = described(tmp_path, fmi, kind, *changed)
    for k, x in ((None, None), (0.0, None), (3.0, 2.0 if text else None)):
        given = {name: value for name, value in (("k", k), ("x_start", x)) if value is not None}
        y = run(driven(path, kind, d=5.0, **given), engine)["plant.y"][-1]
        expected = (0.0 if x is None else x) + (1.0 if k is None else k) * STOP + 5.0
        assert y == pytest.approx(expected, rel=1e-9)


@KINDS
def test_an_input_whose_start_is_not_finite_must_be_wired(kind: str, tmp_path: Path) -> None:
    path = described(tmp_path, 3, kind, start_of("u", "0", 'start="INF"'))
    loose = Diagram("loose")
    loose.add("plant", fmu(path, kind))
    with pytest.raises(ModelError, match=r"E101 plant\.u"):
        loose.check()
    assert run(driven(path, kind, u=2.0), "reference")["plant.y"][-1] == pytest.approx(2.0 * STOP)


def test_what_is_in_such_an_fmu_is_told_as_text_and_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = described(tmp_path, 3, "CS", start_of("k", "1", 'start="INF"'))
    assert main(["fmu", "info", str(path)]) == 0
    assert re.search(r"^  k +inf$", capsys.readouterr().out, re.MULTILINE)
    assert main(["fmu", "info", "--json", str(path)]) == 0  # the start of a Binary stands in it too
    assert '"name": "k"' in capsys.readouterr().out


# --- the tolerance of the solver inside ----


@EACH
@BOTH
def test_a_solver_inside_is_told_the_tolerance_that_the_fmu_declares_unless_another_is_given(
    fmi: int, engine: str, tmp_path: Path
) -> None:
    declared = ("<ModelVariables>", '<DefaultExperiment tolerance="1e-4"/><ModelVariables>')
    defines = ("TELLS_TOLERANCE",)
    says = described(tmp_path, fmi, "CS", declared, name="says", defines=defines)
    silent = described(tmp_path, fmi, "CS", name="silent", defines=defines)
    fixed = {"method": "rk4", "step": 0.1}
    for path, settings, told in (
        (says, {}, 1e-4),
        (says, fixed, 1e-4),
        (says, {"rtol": 1e-7}, 1e-7),
        (says, {**fixed, "rtol": 1e-7}, 1e-7),
        (silent, {}, -1.0),  # none
        (silent, {"rtol": 1e-7}, 1e-7),
        (silent, fixed, -1.0),
    ):
        assert run(driven(path, "CS"), engine, **settings)["plant.y"][0] == told, (path.name, settings)


def test_info_check_and_run_agree_on_the_tolerance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    declared = ("<ModelVariables>", '<DefaultExperiment tolerance="1e-4"/><ModelVariables>')
    path = described(tmp_path, 3, "CS", declared, defines=("TELLS_TOLERANCE",))
    made = driven(path, "CS")
    made.settings(stop=1, log=["plant.y"])
    made.save(tmp_path / "driven.json")
    file = str(tmp_path / "driven.json")
    assert main(["fmu", "info", str(path)]) == 0
    assert "meant to be run with: tolerance 0.0001" in capsys.readouterr().out
    assert main(["check", file]) == 0
    assert re.search(r"plant \(FMI 3\): .*; its own tolerance, 0\.0001$", capsys.readouterr().out, re.MULTILINE)
    cases = ([], "(dopri5, rtol 1e-06; FMUs 0.0001)", 1e-4), (["--rtol", "1e-5"], "(dopri5, rtol 1e-05)", 1e-5)
    for words, told, value in cases:
        assert main(["run", file, *words, "-o", str(tmp_path / "rows.csv")]) == 0
        assert told in capsys.readouterr().out
        rows = [line.split(",") for line in (tmp_path / "rows.csv").read_text().splitlines() if line[0].isdigit()]
        assert float(rows[0][1]) == value


# --- what failed before the start ----


@EACH
@KINDS
@BOTH
def test_what_fails_in_initialization_is_not_mended_by_smaller_steps(
    fmi: int, kind: str, engine: str, tmp_path: Path
) -> None:
    path = make(tmp_path, fmi=fmi, kind=kind, defines=("FAILS_TO_BEGIN",))
    with pytest.raises(FMUError) as caught:
        run(driven(path, kind), engine)
    (fault,) = caught.value.faults
    assert fault.code == "E213"
    assert f"fmi{fmi}ExitInitializationMode of faulty.fmu gave an error at t = 0 s." in fault.message
    assert "no start values" in fault.message
    told = "Its initialization failed: read what it said; other parameters or start values may help."
    assert fault.cure.startswith(told)


@EACH
@BOTH
def test_what_fails_later_may_be_mended_by_smaller_steps(fmi: int, engine: str, tmp_path: Path) -> None:
    for kind, fault in (("CS", "error"), ("ME", "error in rates")):
        path = make(tmp_path, fmi=fmi, kind=kind)
        given = {"fault": FAULTS.index(fault), "t_fault": 0.5}
        with pytest.raises(FMUError, match=r"E213 .*smaller steps or other values may help"):
            run(driven(path, kind, parameters=given), engine)
