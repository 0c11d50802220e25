"""The paper's robot: published and converged numbers, and an independent solution of its equations."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Results
from blocks.cli import main
from tests.support import witness_paper as witness
from tests.support.marks import long
from tests.support.places import ROOT

PAPER = ROOT / "diagrams" / "paper"

# The converged columns of the paper's replication, by two other implementations (RK4 2 ms and DOP853 1e-9).
CONVERGED = {
    "adrc": {
        "OPI_x": 1.15322e-3, "OPI_y": 1.65705e-3, "OPI_theta": 5.49236e-6, "ITAE_right": 7.35662, "ISU_right": 1396.346,
        "ITAE_left": 0.442886, "ISU_left": 1367.458, "peak_e_theta": 10.354e-3,
    },
    "iadrc": {
        "OPI_x": 5.25912e-4, "OPI_y": 7.39638e-4, "OPI_theta": 1.66940e-6, "ITAE_right": 1.76854, "ISU_right": 1407.362,
        "ITAE_left": 0.145736, "ISU_left": 1372.040, "peak_e_theta": 3.305e-3,
    },
}  # fmt: skip


def run_json(name: str, *options: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["run", str(PAPER / f"{name}.json"), "--json", *options]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", [long("adrc"), "iadrc"])
def test_the_command_gives_all_eight_measures_of_a_column(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    done = run_json(name, "--engine", "auto", capsys=capsys)
    assert done["event"] == "done"
    assert done["t"] == 100.0
    assert set(done["measures"]) == set(CONVERGED[name])
    for measure, value in CONVERGED[name].items():
        assert done["measures"][measure] == pytest.approx(value, rel=2e-3), measure
    # The witness is converged to more digits than the table prints.
    for measure, value in witness.CONVERGED[name.upper()].items():
        assert done["measures"][measure] == pytest.approx(value, rel=1e-5), measure


@cache
def by_seconds(name: str) -> Results:
    """A column of the paper, in rows of 1 s."""
    log = ["control_right.u", "control_left.u", "motor_right.omega"]
    if name == "iadrc":
        log += ["matched_right.total", "matched_right.d", "control_right.disturbance"]
    return Diagram.load(PAPER / f"{name}.json").run(every=1.0, log=log)


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("name", [long("adrc"), "iadrc"])
def test_the_steady_controls_are_those_of_the_equilibrium(name: str) -> None:
    results = by_seconds(name)

    def at(signal: str, t: float) -> float:
        return float(results[signal][np.searchsorted(results.t, t, side="right") - 1])

    # At rest w = 1: i = (Beq n + tau/n)/kt and u = kb n + Ra i.
    Ra, kb, kt, n, Beq = 0.1557, 1.185, 1.1882, 3.0, 0.3922
    free, loaded = (kb * n + Ra * (Beq * n + torque / n) / kt for torque in (0.0, 3.0))
    assert at("control_right.u", 24) == pytest.approx(3.7092, abs=5e-5)
    assert at("control_right.u", 49) == pytest.approx(3.8402, abs=5e-5)
    assert at("control_right.u", 24) == pytest.approx(free, abs=5e-5)
    assert at("control_right.u", 49) == pytest.approx(loaded, abs=5e-5)
    assert at("control_left.u", 49) == pytest.approx(free, abs=5e-5)


@pytest.mark.long
def test_the_improved_controller_agrees_with_dop853_on_independent_equations() -> None:
    times = np.arange(0.0, 100.0, 0.5)
    states = witness.solve("IADRC", 1e-11, 1e-13, times)
    names = [n for n in witness.IADRC_NAMES if not n.endswith(".I")]
    results = Diagram.load(PAPER / "iadrc.json").run(rtol=1e-10, atol=1e-12, every=0.5, log=[*names, "control_right.u"])
    rows = np.searchsorted(results.t, times, side="right") - 1
    for name in names:
        exact = states[:, witness.IADRC_NAMES.index(name)]
        scale = np.ptp(exact) or np.max(np.abs(exact))  # the reference's heading is constant
        assert scale > 0
        assert np.max(np.abs(results[name][rows] - exact)) <= 1e-6 * scale, name
    u = np.array([witness.signals("control_right.u", t, x) for t, x in zip(times, states, strict=True)])
    assert np.max(np.abs(results["control_right.u"][rows] - u)) <= 1e-6 * np.ptp(u)


@pytest.mark.usefixtures("native")
def test_theorem_1_gives_what_the_observer_estimates() -> None:
    results = by_seconds("iadrc")
    before, under = (np.searchsorted(results.t, t, side="right") - 1 for t in (24, 49))
    assert results["matched_right.total"][under] == pytest.approx(-3.8402, abs=1e-4)
    assert results["matched_right.d"][under] == pytest.approx(0.9835, abs=1e-4)
    assert results["matched_right.d"][before] == 0.0
    for row in (before, under):
        assert results["control_right.disturbance"][row] == pytest.approx(results["matched_right.total"][row], abs=1e-4)


def test_parameters_of_the_diagram_do_what_they_say() -> None:
    diagram = Diagram.load(PAPER / "iadrc.json")
    short: dict[str, Any] = {"stop": 30.0, "every": 0.5, "engine": "auto"}
    plain = diagram.run(**short)
    without = diagram.run(**short, parameters={"torque": 0.0})
    assert np.ptp(without["heading_error.y"]) < 1e-9 < np.ptp(plain["heading_error.y"])
    later = diagram.run(**short, parameters={"torque_on": 28.0})
    assert later.events[-1].t == 28.0
    turned = diagram.run(**short, parameters={"heading": {"value": 90, "unit": "deg"}})
    assert abs(turned["reference.x"][-1]) < 1e-12
    heavy, nominal = (diagram.flatten(parameters={"Jeq": value}) for value in (0.5, 0.2752))
    changed = {
        ours.path
        for ours, theirs in zip(heavy.blocks, nominal.blocks, strict=True)
        for name, value in ours.resolved.values.items()
        if not np.array_equal(value.value, theirs.resolved.values[name].value)
    }
    assert changed == {"motor_left", "motor_right", "matched_right"}, "the controllers keep the nominal b0"


def test_the_torque_edges_are_hit_exactly() -> None:
    results = Diagram.load(PAPER / "adrc.json").run(stop=60.0, every=1.0, log=["disturbance.y"], engine="auto")
    jumps = [
        t
        for t, a, b in zip(results.t[1:], results["disturbance.y"][:-1], results["disturbance.y"][1:], strict=True)
        if a != b
    ]
    assert jumps == [25.0, 50.0]


@pytest.mark.parametrize("name", ["adrc", "iadrc"])
def test_what_was_assumed_stands_in_the_file(name: str) -> None:
    doc = " ".join(json.loads((PAPER / f"{name}.json").read_text(encoding="utf-8"))["doc"])
    for word in ("3 N.m", "25", "30 s", "45 deg", "assumed"):
        assert word in doc or word.replace("assumed", "Assumed") in doc, word
