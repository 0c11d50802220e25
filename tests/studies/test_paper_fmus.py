"""The paper's robot with its motors as FMUs: against the same robot of equations, and as a study."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Results, cli
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.places import ROOT

PAPER = ROOT / "diagrams" / "paper"
TIGHT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11, "stop": 60, "engine": "native"}

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def exact() -> Results:
    return Diagram.load(PAPER / "iadrc.json").run(**TIGHT)


def worst(exact: Results, made: Results) -> dict[str, float]:
    """The largest difference of each signal at common times, as a part of its range."""
    times = np.intersect1d(exact.t, made.t)
    assert len(times) > 5000
    found = {}
    for name in exact:
        rows = [np.asarray(one[name])[np.searchsorted(one.t, times, side="right") - 1] for one in (exact, made)]
        found[name] = float(np.max(np.abs(rows[0] - rows[1])) / (np.ptp(np.asarray(exact[name])) or 1.0))
    return found


def test_motors_of_model_exchange_are_integrated_as_if_they_were_equations(exact: Results) -> None:
    diagram = Diagram.load(PAPER / "iadrc_fmu.json")
    made = diagram.run(**TIGHT, variants={"motor_right": "me", "motor_left": "me"})
    assert max(worst(exact, made).values()) < 1e-6


def test_motors_of_co_simulation_follow_within_1e_5(exact: Results) -> None:
    made = Diagram.load(PAPER / "iadrc_fmu.json").run(**TIGHT)
    off = worst(exact, made)
    # The control law has an infinite slope where its error is 0: there u is late by a part of a communication step.
    names = ("control_right.u", "control_left.u", "control_right.z3", "control_left.z3")
    sharp = {name: off.pop(name) for name in names}
    assert max(off.values()) < 1e-5
    assert max(sharp.values()) < 1e-4


def test_held_inputs_are_first_order(exact: Results) -> None:
    errors = []
    for step in (0.004, 0.002):
        made = Diagram.load(PAPER / "iadrc_fmu.json").run(
            **{**TIGHT, "every": 0.02}, master={"step": step, "algorithm": "jacobi", "order": 0}
        )
        times = np.intersect1d(exact.t, made.t)
        rows = [np.asarray(one["robot.x"])[np.searchsorted(one.t, times)] for one in (exact, made)]
        errors.append(float(np.max(np.abs(rows[0] - rows[1]))))
    assert 1.7 < errors[0] / errors[1] < 2.3


def test_the_study_with_fmus_reproduces_the_paper(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKS_ENGINE", "native")
    study = PAPER.parent / "paper_fmu" / "study.json"
    assert cli.main(["study", str(study), "--out", str(tmp_path)]) == 0
    assert "24 of 24 published numbers reproduced" in capsys.readouterr().out
