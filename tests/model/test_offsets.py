"""Units with an offset in diagrams: values may be given in degC, and differences are in K."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import blocks
from blocks import Block, Diagram, Input, ModelError, Parameter, State, UsageError, output
from blocks.analysis import find_operating_point
from blocks.results.comparison import compare


class Body(Block):
    """Newton's law of cooling, in SI: dT/dt = (around - T)/tau."""

    around = Input(20.0, unit="degC")
    tau = Parameter(10.0, unit="s")
    cold = Parameter(-5.0, unit="degC", min=-273.15)
    T = State(50.0, unit="degC", output=True)

    @T.derivative
    def dT(around, T, tau):
        return (around - T) / tau

    @output(unit="K")
    def above(T, cold):
        return T - cold


def body() -> Diagram:
    diagram = Diagram("body")
    diagram.add("body", Body())
    diagram.settings(stop=10, rtol=1e-10, atol=1e-10)
    return diagram


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize(
    ("parameters", "start", "cold"),
    [
        ({}, 323.15, 268.15),
        ({"body.T_start": 40}, 313.15, 268.15),
        ({"body.T_start": "104 degF", "body.cold": "270 K"}, 313.15, 270.0),
        ({"body.T_start": {"value": 0.31315, "unit": "kK"}, "body.cold": "0 degC"}, 313.15, 273.15),
    ],
)  # fmt: skip
def test_declared_temperatures_are_converted_once(
    parameters: dict[str, Any], start: float, cold: float, engine: str
) -> None:
    results = body().run(parameters=parameters, engine=engine)
    end = 293.15 + (start - 293.15) * np.exp(-1.0)
    assert results["body.T"][[0, -1]] == pytest.approx([start, end], rel=1e-9)
    assert results["body.above"][-1] == pytest.approx(end - cold, rel=1e-9)
    assert results["body.T"].unit == "K"


def test_limits_are_in_the_unit_and_faults_name_it() -> None:
    with pytest.raises(ModelError, match=r"E107 body.cold: must be at least -273.15 degC"):
        body().run(parameters={"body.cold": -300})


def test_a_value_in_degrees_is_taken_where_kelvin_are_declared() -> None:
    diagram = Diagram("kelvin")
    diagram.add("room", blocks.Constant(value="25 degC", unit="K"))
    diagram.parameter("T0", 77, unit="degF")
    diagram.add("other", blocks.Constant(value="=T0", unit="K"))
    results = diagram.run(stop=1)
    assert results["room.y"][-1] == results["other.y"][-1] == 298.15
    again = Diagram.from_json(diagram.to_json()).run(stop=1)
    assert again["room.y"][-1] == 298.15
    assert diagram.run(stop=1, parameters={"T0": 25 * 1.8 + 32})["other.y"][-1] == pytest.approx(298.15, rel=1e-15)


@pytest.mark.parametrize("block", [
    blocks.Sine(unit="degC", amplitude=5.0), blocks.Integrator(unit="degC"), blocks.Gain(unit_u="degC", unit="V"),
    blocks.Noise(unit="degC"), blocks.Constant(unit="degC"),
])  # fmt: skip
def test_a_block_is_in_kelvin_as_its_amplitudes_and_slopes_are_differences(block: Block) -> None:
    diagram = Diagram("refused")
    with pytest.raises(ModelError, match=r"E114 .*degC"):
        diagram.add("one", block)


def test_inputs_measures_and_operating_points_take_degrees(tmp_path: Path) -> None:
    diagram = body()
    around = diagram.input("around", unit="degC", default=20)
    diagram.wire("body.around", around)
    diagram.measure("far", "peak", of="body.T", against=20)
    assert diagram.run().measures["far"] == pytest.approx(30.0, rel=1e-9)
    path = tmp_path / "u.csv"
    for units, number in (("", 10), ('# units: {"around": "degF"}\n', 50), ('# units: {"around": "K"}\n', 283.15)):
        path.write_text(f"{units}time,around\n0,{number}\n", encoding="utf-8")
        assert diagram.run(inputs=path)["around"][-1] == pytest.approx(283.15, rel=1e-14)
    for given in (10, "10 degC", "283.15 K", ([0, 1], ["50 degF", "50 degF"])):
        assert diagram.run(inputs={"around": given})["around"][-1] == pytest.approx(283.15, rel=1e-14)
    point = find_operating_point(diagram, inputs={"around": None}, outputs={"body.T": 35})
    assert point["around"] == pytest.approx(308.15, rel=1e-9)
    # A rate and an amplitude are differences.
    point = find_operating_point(diagram, inputs={"around": 20}, steady={"body.T": 3.0})
    assert point["body.T"] == pytest.approx(293.15 - 30.0, rel=1e-9)


@pytest.mark.usefixtures("native")
def test_a_limit_of_a_measure_is_a_difference(tmp_path: Path) -> None:
    diagram = body()
    diagram.measure("far", "peak", of="body.T", against=20)
    options: dict[str, Any] = {"minimize": "far", "over": {"body.tau": (5, 20)}, "budget": 3, "optimizer": "de"}
    with pytest.raises(
        UsageError,
        match=r"E501 .*degC has an offset, but measures are differences, which have "
        r"none. Write K",
    ):
        diagram.tune(subject_to=["far <= 40 degC"], **options)
    assert diagram.tune(subject_to=["far <= 40 K"], **options).is_feasible


def test_results_in_degrees_are_compared_as_temperatures(tmp_path: Path) -> None:
    for name, unit, values in (("a", "K", (273.15, 283.15)), ("b", "degC", (0.0, 10.0))):
        rows = "".join(f"{t},{x}\n" for t, x in enumerate(values))
        text = f'# blocks results 1\n# units: {{"T": "{unit}"}}\ntime,T\n{rows}'
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
    assert compare(tmp_path / "a.csv", tmp_path / "b.csv").differences[0].absolute == pytest.approx(0.0, abs=1e-12)


def test_an_exported_fmu_shows_degrees_beside_kelvin(tmp_path: Path) -> None:
    import fmpy

    diagram = body()
    around = diagram.input("around", unit="degC", default=20)
    diagram.wire("body.around", around)
    diagram.export(tmp_path / "body.fmu", fmi=2)
    with zipfile.ZipFile(tmp_path / "body.fmu") as archive:
        assert archive.read("modelDescription.xml")
    description = fmpy.read_model_description(str(tmp_path / "body.fmu"))
    (unit,) = (unit for unit in description.unitDefinitions if unit.name == "K")
    (shown,) = unit.displayUnits
    assert (shown.name, float(shown.factor), float(shown.offset)) == ("degC", 1.0, -273.15)
    (variable,) = (v for v in description.modelVariables if v.name == "around")
    assert (variable.unit, float(variable.start)) == ("K", 293.15)
