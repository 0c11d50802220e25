"""FMUs in units with a factor and an offset, beside the numbers that FMPy gets from the same FMU."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
import pytest

from blocks import Block, Constant, Diagram, Input, ModelError, Parameter, State, fmu, output

UNITS = {
    "degC": '<BaseUnit K="1" offset="273.15"/>',
    "degF": '<BaseUnit K="1" factor="0.5555555555555556" offset="255.3722222222222"/>',
    "barg": '<BaseUnit kg="1" m="-1" s="-2" factor="100000" offset="101325"/>',
    "psi": '<BaseUnit kg="1" m="-1" s="-2" factor="6894.757293168361"/>',
}
SI = {
    "degC": lambda x: x + 273.15,
    "degF": lambda x: (x + 459.67) * 5.0 / 9.0,
    "barg": lambda x: 1e5 * x + 101325.0,
    "psi": lambda x: 6894.757293168361 * x,
}


class Room(Block):
    """dx/dt = (T + dT - x)/2, in numbers whose units the description of the FMU says."""

    T = Input(20.0)
    dT = Input(2.0)
    p = Input(1.0)
    setpoint = Parameter(15.0, min=-50.0, max=100.0)
    x = State(18.0, output=True)

    @x.derivative
    def dx(T, dT, x):
        return (T + dT - x) / 2.0

    @output
    def error(T, setpoint):
        return T - setpoint

    @output
    def level(p):
        return 2.0 * p

    @output
    def wanted(setpoint):
        return 1.0 * setpoint


def with_units(path: Path, units: Mapping[str, str], relative: set[str]) -> Path:
    """Return an FMU whose variables have units. relative: quantities that are differences."""
    with zipfile.ZipFile(path) as old:
        files = {name: old.read(name) for name in old.namelist()}
    text = files["modelDescription.xml"].decode()
    made = "".join(f'<Unit name="{name}">{UNITS[name]}</Unit>' for name in sorted({*units.values()}))
    assert "<UnitDefinitions>" in text
    text = text.replace("<UnitDefinitions>", f"<UnitDefinitions>{made}")
    for name, unit in units.items():
        words = f'unit="{unit}"' + (' relativeQuantity="true"' if name in relative else "")
        text, n = re.subn(rf'(<Float64 name="{name}"|name="{name}"[^>]*>\s*<Real)', rf"\1 {words}", text)
        assert n == 1
    files["modelDescription.xml"] = text.encode()
    changed = path.with_name(f"units_{path.name}")
    with zipfile.ZipFile(changed, "w") as new:
        for name, data in files.items():
            new.writestr(name, data)
    return changed


@pytest.fixture(scope="module", params=[2, 3])
def room(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return an FMU without units, for FMPy, and the same with units."""
    plain = tmp_path_factory.mktemp("room") / f"room{request.param}.fmu"
    diagram = Diagram.alone(Room(), "room")
    diagram.settings(rtol=1e-9, atol=1e-9)
    diagram.export(plain, fmi=request.param)
    units = {
        "T": "degC", "dT": "degC", "p": "barg", "setpoint": "degC", "x_start": "degF", "x": "degC", "error": "degC",
        "level": "psi", "wanted": "degF",
    }  # fmt: skip
    return plain, with_units(plain, units, {"dT", "error"})


def theirs(path: Path, kind: str, setpoint: float, x_start: float, **inputs: float) -> dict[str, float]:
    """Return what FMPy gets at 1 s, in the numbers of the FMU."""
    start = {"setpoint": setpoint, "x_start": x_start, **inputs}
    wanted = ("x", "error", "level", "wanted")
    result = fmpy.simulate_fmu(
        str(path), fmi_type={"ME": "ModelExchange", "CS": "CoSimulation"}[kind], stop_time=1.0, output_interval=0.01,
        relative_tolerance=1e-9, start_values=start, output=wanted,
    )  # fmt: skip
    return {name: float(result[name][-1]) for name in wanted}


@pytest.mark.parametrize("kind", ["CS", "ME"])
@pytest.mark.parametrize("engine", ["native", "reference"])
def test_numbers_of_an_fmu_are_converted_by_factor_and_offset(
    room: tuple[Path, Path], kind: str, engine: str
) -> None:
    plain, path = room
    right = theirs(plain, kind, 30.0, 25.0, T=21.5, dT=3.0, p=0.5)
    diagram = Diagram("one")
    diagram.add("one", fmu(path, kind, parameters={"setpoint": "86 degF"}))
    for name, value, unit in (("T", {"value": 21.5, "unit": "degC"}, "K"), ("dT", 3.0, "K"), ("p", 150 + 1.325, "kPa")):
        source = diagram.add(f"of_{name}", Constant(value=value, unit=unit))
        diagram.wire(f"one.{name}", source.y)
    settings: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-9, "master": {"step": 0.01}}
    given = {"one.x_start": 25}  # degF, as FMPy is given 25
    results = diagram.run(stop=1, engine=engine, parameters=given, **settings)
    ours = {name: float(results[f"one.{name}"][-1]) for name in right}
    si = {"x": SI["degC"](right["x"]), "error": right["error"], "level": SI["psi"](right["level"]),
          "wanted": SI["degF"](right["wanted"])}  # fmt: skip
    assert ours == pytest.approx(si, rel=1e-7)


def test_values_that_are_given_plainly_are_in_the_unit_of_the_fmu(room: tuple[Path, Path], tmp_path: Path) -> None:
    _, path = room
    diagram = Diagram("one")
    diagram.add("one", fmu(path, "CS"))
    setpoint, T = "one.setpoint", "one.T"
    inside = fmu(path, "CS")
    port = type(inside).declaration.inputs["T"]
    assert port.unit == "degC"
    value = diagram.input("T", unit="degC", default=21.5)
    diagram.wire(T, value)
    signal = "one.error"
    for parameters, inputs, error in (
        ({}, {}, 6.5), ({setpoint: 10}, {}, 11.5), ({setpoint: "50 degF"}, {"T": "294.65 K"}, 11.5),
        ({setpoint: {"value": 283.15, "unit": "K"}}, {"T": "70.7 degF"}, 11.5), ({}, {"T": 25}, 10.0),
    ):  # fmt: skip
        results = diagram.run(stop=0.1, parameters=parameters, inputs=inputs, master={"step": 0.05})
        assert results[signal][-1] == pytest.approx(error, abs=1e-9)
    with pytest.raises(ModelError, match=r"E107 .*must be at least -50.0 degC, not 222.15 K"):
        diagram.run(stop=0.1, parameters={setpoint: -51})
    table = tmp_path / "T.csv"
    for units, number in (("", 25), ('# units: {"T": "K"}\n', 298.15), ('# units: {"T": "degF"}\n', 77)):
        table.write_text(f"{units}time,T\n0,{number}\n", encoding="utf-8")
        results = diagram.run(stop=0.1, inputs=table, master={"step": 0.05})
        assert results[signal][-1] == pytest.approx(10.0, abs=1e-9)
    run = diagram.start(stop=1, master={"step": 0.05})
    run.advance_to(0.2)
    run.set("T", 40)
    run.set(setpoint, "30 degC")
    run.advance_to(0.4)
    assert run[signal] == pytest.approx(10.0, abs=1e-9)


def test_what_an_fmu_starts_with_is_not_moved(room: tuple[Path, Path]) -> None:
    plain, path = room
    results = Diagram.alone(fmu(path, "CS"), "one").run(stop=1, rtol=1e-9, master={"step": 0.01})
    block = next(name for name in results if name.endswith(".x")).rpartition(".x")[0]
    right = theirs(plain, "CS", 15.0, 18.0, T=20.0, dT=2.0, p=1.0)
    assert results[f"{block}.x"][-1] == pytest.approx(SI["degC"](right["x"]), rel=1e-7)
    assert results[f"{block}.error"][-1] == pytest.approx(5.0, abs=1e-9)


def test_check_tells_the_offset(room: tuple[Path, Path]) -> None:
    from blocks.model.trust import found

    _, path = room
    lines = [line for each in found(Diagram.alone(fmu(path), "one").flatten()) for line in each.lines()]
    assert any("is in degC in the FMU, in K here: scaled by 1 and moved by 273.15" in line for line in lines)
