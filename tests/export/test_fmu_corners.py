"""Exported FMUs find the sides of corners inside loops, by FMPy."""

from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from tests.support.corners import feedback, scalar_case, solution


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_an_fmu_with_a_loop_through_a_table_has_its_solution(kind: str, tmp_path: Path) -> None:
    case = scalar_case("table", 49)
    path = tmp_path / "loop.fmu"
    feedback(("table",)).export(path, parameters=case.values, stop=1.0, loops="solve")
    made = simulate_fmu(str(path), fmi_type=kind, stop_time=1.0, output_interval=0.01, output=["u0.y", "s0.y"])
    known = [solution(case.k, case.functions, u)[0] for u in made["u0.y"]]
    assert np.ptp(made["s0.y"]) > 0.5
    assert made["s0.y"] == pytest.approx(known, abs=1e-12 * max(1.0, case.k))
