"""Arrays of FMI 3: start values, sizes that structural parameters say, other names, and what no wire carries.

The model is y = a u, x' = y, element by element, so that all is known in closed form; FMPy runs the same FMU.
"""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi3 import FMU3Slave

from blocks import Diagram, FMUError, Gain, ModelError, fmu
from blocks.cli import main
from blocks.contract.interface import Value
from blocks.fmi.summary import tell
from blocks.model.fmu_block import fmu_type
from tests.support.arrays import make

pytestmark = [pytest.mark.parametrize("kind", ["CS", "ME"])]
ENGINES = ("reference", "native")
FMPY = {"CS": "CoSimulation", "ME": "ModelExchange"}


def run(d: Diagram, kind: str, engine: str | None = None, **more: Any) -> Any:
    return d.run(stop=2.0, every=0.5, engine=engine, **({"master": {"step": 0.5}} if kind == "CS" else {}), **more)


@pytest.mark.parametrize("engine", ENGINES)
def test_start_values_of_an_array_are_the_defaults_of_the_input(kind: str, engine: str, tmp_path: Path) -> None:
    """So `blocks fmu run` needs no input."""
    path = make(tmp_path)
    d = Diagram.alone(fmu(path, kind=kind))
    assert d.to_json()["inputs"] == {"u": {"default": [3.0, 4.0], "size": 2}}
    assert Diagram.from_json(d.dumps(), folder=d.value.folder).dumps() == d.dumps()
    made = run(d, kind, engine, log=["y", "Arrays.x"])
    rows = simulate_fmu(str(path), fmi_type=FMPY[kind], stop_time=2.0, output_interval=0.5, output=["y"])
    assert made["y"][-1].tolist() == rows["y"][-1].tolist() == [3.0, 8.0]
    assert made["Arrays.x"][-1] == pytest.approx([6.0, 16.0])


def test_an_input_that_is_not_wired_keeps_the_start_values_of_its_array(kind: str, tmp_path: Path) -> None:
    d = Diagram("d")
    one = d.add("one", fmu(make(tmp_path), kind=kind))
    assert run(d, kind)["one.y"][-1].tolist() == [3.0, 8.0]
    d.wire(one.u[1], d.input("v", default=10.0))
    assert run(d, kind)["one.y"][-1].tolist() == [3.0, 20.0]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_structural_parameter_resizes_the_arrays(kind: str, engine: str, tmp_path: Path) -> None:
    d = Diagram.alone(fmu(make(tmp_path), kind=kind, n=3, a=[1.0, 0.0, 100.0]))
    assert d.to_json()["inputs"] == {"u": {"size": 3}}
    made = run(d, kind, engine, inputs={"u": [5.0, 6.0, 7.0]}, log=["y", "Arrays.x", "Arrays.der(x)"])
    assert made["y"][-1].tolist() == [5.0, 0.0, 700.0]
    assert made["Arrays.x"][-1] == pytest.approx([10.0, 0.0, 1400.0])
    assert made["Arrays.der(x)"][0].tolist() == [5.0, 0.0, 700.0]


def test_a_resized_fmu_gives_what_fmpy_gives(kind: str, tmp_path: Path) -> None:
    """FMPy has no call for it, but its instance can be configured."""
    if kind == "ME":
        pytest.skip("FMPy integrates by itself there")
    path = make(tmp_path)
    described = read_model_description(str(path))
    at = {one.name: one.valueReference for one in described.modelVariables}
    slave = FMU3Slave(
        guid=described.instantiationToken, unzipDirectory=extract(str(path)), modelIdentifier="arrays", instanceName="s"
    )
    slave.instantiate()
    slave.enterConfigurationMode()
    slave.setUInt64([at["n"]], [1])
    slave.exitConfigurationMode()
    slave.setFloat64([at["a"]], [0.25])
    slave.setFloat64([at["u"]], [3.0])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for k in range(4):
        slave.doStep(0.5 * k, 0.5)
    theirs = slave.getFloat64([at["x"]], nValues=1)
    slave.terminate()
    slave.freeInstance()
    d = Diagram("d")
    d.add("one", fmu(path, kind=kind, n=1, a=[0.25], isolate=True))
    d.wire("one.u[0]", d.input("u", default=3.0))
    assert run(d, kind, log=["one.x"])["one.x"][-1].tolist() == theirs == [1.5]


def test_a_size_may_come_from_a_file_a_parameter_of_the_diagram_or_the_command_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make(tmp_path)
    document = {
        "format": "blocks-diagram", "version": 3,
        "parameters": {"size": 3},
        "blocks": {"one": {"fmu": "arrays.fmu", "kind": kind, "parameters": {"n": "=size", "a": 2}}},
        "inputs": {"u": {"size": 3, "default": [1, 2, 3]}}, "wires": {"one.u": "u"}, "outputs": {"y": "one.y"},
    }  # fmt: skip
    d = Diagram.from_json(document, folder=tmp_path)
    assert run(d, kind)["y"][-1].tolist() == [2.0, 4.0, 6.0]
    with pytest.raises(ModelError, match=r"one\.u: has 4 elements, but u has 3 elements"):
        run(d, kind, parameters={"size": 4})
    resized = fmu_type(tmp_path / "arrays.fmu", kind).declaration.foreign.resized({"n": Value(1.0)})
    assert pickle.loads(pickle.dumps(resized)) is resized
    words = ["--set", "n=1", "--set", "a=[7]", "--input", "u=[2]", "--stop", "1", "--log", "y", "--kind", kind]
    assert main(["fmu", "run", str(tmp_path / "arrays.fmu"), *words]) == 0
    assert ["y[0]", "-", "14", "14", "14"] in [line.split()[:5] for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"n": 3}, "E107 one.a: must be given: it has no default."),  # its start values are for 2 elements
        ({"n": 3, "a": [1.0, 2.0]}, "E110 one.a: has the shape 2, but 3 is needed."),
        ({"n": 5}, "E107 one.n: must be at most 4.0, not 5.0."),
        ({"n": -1}, "E107 one.n: must be at least 0"),
        ({"n": 1.5}, "E107 one.n: must be an integer, not 1.5."),
        ({"a": [1.0, 2.0, 3.0]}, "E110 one.a: "),
    ],
)
def test_sizes_that_do_not_fit_are_told_before_anything_runs(
    kind: str, parameters: dict[str, Any], says: str, tmp_path: Path
) -> None:
    d = Diagram("d")
    d.add("one", fmu(make(tmp_path), kind=kind))
    document = d.to_json()
    document["blocks"]["one"]["parameters"] = parameters
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document, folder=d.value.folder).check()
    assert [line.startswith(says) for line in str(caught.value).splitlines()] == [True]


@pytest.mark.parametrize("engine", ENGINES)
def test_other_names_of_a_variable_are_recorded_like_it(kind: str, engine: str, tmp_path: Path) -> None:
    names = {"one.body.gain.y": "one.y", "one.body.s": "one.x", "one.body.force": ""}
    d = Diagram("d")
    one = d.add("one", fmu(make(tmp_path), kind=kind))
    d.wire(one.u, d.input("u", size=2))
    inputs = {"u": {"t": [0, 1], "u": [[1, 2], [3, 4]], "interpolation": "hold"}}
    made = run(d, kind, engine, inputs=inputs, log=[*names, "one.y", "one.x", "u"])
    for alias, name in names.items():
        if name:
            assert made[alias].tolist() == made[name].tolist(), alias
    assert made["one.body.force"][-1].tolist() == [3.0, 4.0]
    assert made["one.body.s"][-1] == pytest.approx([4.0, 12.0])
    assert not any(".body." in name for name in run(d, kind, engine, inputs=inputs))  # only where they are named


@pytest.mark.parametrize(
    ("wire", "says"),
    [
        ({"one.blob": "v"}, 'one.blob: "blob" of one has the type Binary in the FMU, which a wire cannot carry.'),
        ({"one.tick": "v"}, 'one.tick: "tick" of one has the type Clock in the FMU, which a wire cannot carry.'),
        ({"gain.u": "one.told"}, 'gain.u: "told" of one has the type Binary in the FMU, which a wire cannot carry.'),
        ({"one.text": "v"}, 'Set its parameter "text_start".'),
    ],
)
def test_a_wire_to_what_no_wire_carries_is_refused_by_name(
    kind: str, wire: dict[str, str], says: str, tmp_path: Path
) -> None:
    more = (
        '<Binary name="blob" valueReference="20" causality="input" variability="discrete"><Start value="00"/></Binary>'
        '<Binary name="told" valueReference="21" causality="output"/>'
        '<Clock name="tick" valueReference="22" causality="input" intervalVariability="triggered"/>'
        '<String name="text" valueReference="23" causality="input"><Start value="a"/></String>'
    )
    d = Diagram("d")
    d.add("one", fmu(make(tmp_path, more), kind=kind))
    d.add("gain", Gain())
    d.input("v", default=1.0)
    d.wire("gain.u", "v")
    run(d, kind)  # what is not wired is left alone
    document = d.to_json()
    document["wires"].update(wire)
    with pytest.raises(ModelError, match="E105") as caught:
        Diagram.from_json(json.dumps(document), folder=d.value.folder).check()
    assert says in str(caught.value)


def test_a_clock_that_somebody_would_have_to_tick_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    more = (
        '<Clock name="sampling" valueReference="20" causality="input" intervalVariability="constant"'
        ' intervalDecimal="0.1"/>'
    )
    path = make(tmp_path, more)
    says = "E205 arrays.fmu: the importing tool must tick its clock 'sampling'."
    with pytest.raises(FMUError) as caught:
        fmu(path, kind=kind)
    assert says in str(caught.value)
    told = tell(path)
    assert says in told.check()
    assert told.errors
    if kind == "CS":  # without event mode, it ticks by itself
        own = make(tmp_path, more, event_mode=False)
        assert run(Diagram.alone(fmu(own, kind=kind)), kind)["y"][-1].tolist() == [3.0, 8.0]
