"""What a block that an FMU stands behind takes from the FMU's description."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, ModelError, fmu

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g"><CoSimulation modelIdentifier="m"/>
<UnitDefinitions><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
<Unit name="bar"><BaseUnit kg="1" m="-1" s="-2" factor="100000"/></Unit></UnitDefinitions>
<ModelVariables>
<ScalarVariable name="gap" valueReference="0" causality="parameter" variability="tunable">
<Real unit="mm" min="0.6" start="1.5"/></ScalarVariable>
<ScalarVariable name="p" valueReference="1" causality="parameter" variability="tunable">
<Real unit="bar" max="10" start="1"/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    with zipfile.ZipFile(tmp_path / "m.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
    return tmp_path / "m.fmu"


def checked(path: Path, **parameters: Any) -> None:
    d = Diagram("limits")
    d.add("m", fmu(path, kind="CS", **parameters))
    d.check()


@pytest.mark.parametrize(
    "parameters",
    [{}, {"gap": {"value": 0.6, "unit": "mm"}}, {"gap": 0.7}, {"p": {"value": 10, "unit": "bar"}}, {"p": 9}],
)
def test_limits_of_an_fmu_are_in_its_own_units(path: Path, parameters: dict[str, Any]) -> None:
    checked(path, **parameters)


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"gap": {"value": 0.5, "unit": "mm"}}, "m.gap: must be at least 0.6 mm, not 0.0005 m."),
        ({"p": {"value": 11, "unit": "bar"}}, "m.p: must be at most 10.0 bar, not 1100000.0 Pa."),
    ],
)
def test_a_value_beyond_a_limit_of_an_fmu_is_refused(path: Path, parameters: dict[str, Any], says: str) -> None:
    with pytest.raises(ModelError, match="E107") as caught:
        checked(path, **parameters)
    assert says in str(caught.value)
