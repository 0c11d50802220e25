"""Every function of FMI in every mode, on exported diagrams, under sanitizers."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest
from fmpy import read_model_description

from blocks import Diagram
from tests.support.fmu_drivers import build_driver, faults, run_driver
from tests.support.places import ROOT

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")


@pytest.mark.long
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["bouncing_ball", "motor_pid", "paper/control_iadrc_sampled", "sampled_loop"])
def test_every_call_in_every_mode_is_answered_as_the_standard_says(name: str, version: int, tmp_path: Path) -> None:
    """Allowed or not, with good and bad arguments: an error is returned where it must be, and nothing crashes."""
    place = tmp_path / "x.fmu"
    Diagram.load(ROOT / "diagrams" / f"{name}.json").export(place, fmi=version, platforms=())
    with zipfile.ZipFile(place) as archive:
        archive.extractall(tmp_path)
    found = {"INPUT": -1, "OUTPUT": -1, "STATE": -1, "PARAMETER": -1}
    description = read_model_description(str(place))
    states = [v.derivative for v in description.modelVariables if v.derivative is not None]
    for variable in description.modelVariables:
        if variable.type not in ("Real", "Float64") or variable.dimensions or variable.variability not in (
            "continuous", "tunable"
        ):  # fmt: skip
            continue
        is_state = any(state is variable for state in states)
        kinds = {"input": "INPUT", "output": "OUTPUT", "parameter": "PARAMETER"}
        kind = "STATE" if is_state else kinds.get(variable.causality)
        if kind is not None and found[kind] == -1:
            found[kind] = int(variable.valueReference)
    token = description.guid if version == 2 else description.instantiationToken
    program = build_driver(tmp_path / "sources", version, {"TOKEN": f'"{token}"', **found}, to=tmp_path / "driver")
    lines = run_driver(program)
    assert len(lines) > 500
    asks = version == 3 and found["INPUT"] >= 0
    assert ("asking" in {line.mode for line in lines}) == asks
    assert faults(version, lines) == []
