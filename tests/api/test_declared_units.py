"""Plain numbers about a thing are in its declared unit, and texts with a unit are taken."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import blocks
from blocks import Diagram, ModelError, UsageError
from blocks.analysis import find_operating_point, limit_cycles, observer_report
from blocks.cli import main
from blocks.contract.sparse import SparseMatrix
from blocks.model.document import dumps, from_document, self_contained
from blocks.model.values import value_of

RPM = math.pi / 30.0
# The describing function of a saturation for twice its limit.
HALF_SATURATED = 2.0 / math.pi * (math.asin(0.5) + 0.5 * math.sqrt(0.75))
WAYS = [2.0, "2 rpm", {"value": 12.0, "unit": "deg/s"}]


def saturated() -> Diagram:
    """Return a saturation at 1 rpm behind an input in rpm."""
    diagram = Diagram("saturated")
    u = diagram.input("u", unit="rpm", default=0)
    law = diagram.add("law", blocks.Saturation(lower=-1, upper=1, unit="rpm"))
    diagram.wire(law.u, u)
    diagram.output("y", law.y)
    return diagram


@pytest.mark.parametrize("amplitude", WAYS)
@pytest.mark.parametrize("name", ["u", "law.u"])
def test_an_amplitude_is_in_the_unit_of_its_signal(amplitude: Any, name: str) -> None:
    model = saturated().linearizer(amplitude={name: amplitude}).transfer("u", "y")
    assert float(model.D[0, 0]) == pytest.approx(HALF_SATURATED, rel=1e-9)
    response = saturated().linearizer().harmonic_response("u", "y", [1.0], amplitude=amplitude)
    assert response.value[0, 0] == pytest.approx(HALF_SATURATED, rel=1e-9)
    assert response.response([2.0])[0, 0, 0] == pytest.approx(HALF_SATURATED, rel=1e-9)
    assert response.amplitude == pytest.approx(2.0 * RPM)


def test_an_amplitude_of_another_quantity_is_refused() -> None:
    with pytest.raises(UsageError, match=r"E501 amplitude of u: \[V\] is given, but \[rpm\] is needed"):
        saturated().linearizer(amplitude={"u": "2 V"})
    with pytest.raises(UsageError, match=r"E501 amplitude of law.u: \[V\] is given, but \[rpm\] is needed"):
        saturated().linearizer(amplitude={"*.u": "2 V"})


@pytest.mark.parametrize("name", ["law.u", "*.u"])
def test_a_signal_without_a_unit_takes_an_amplitude_with_any_unit(name: str) -> None:
    diagram = Diagram("bare")
    diagram.wire(diagram.add("law", blocks.Saturation(lower=-RPM, upper=RPM)).u, diagram.input("u", default=0))
    diagram.output("y", "law.y")
    for amplitude in ("2 rpm", 2.0 * RPM):  # plain numbers are in SI
        model = diagram.linearize("u", "y", amplitude={name: amplitude})
        assert float(model.D[0, 0]) == pytest.approx(HALF_SATURATED, rel=1e-9)


@pytest.mark.parametrize("limits", [None, (0.1, 1e4), ("0.01 rad/s", "1e4 rpm")])
def test_the_amplitudes_of_limit_cycles_are_in_the_unit_of_the_law(limits: Any) -> None:
    diagram = Diagram("cycle")
    plant = diagram.add("plant", blocks.TransferFunction(num=[1.0], den=[1.0, 2.0, 1.0, 0.0], unit="rpm"))
    law = diagram.add("law", blocks.Relay(on_at=0.0, off_at=0.0, on=1.0, off=-1.0, unit_u="rpm"))
    minus = diagram.add("minus", blocks.Gain(k=-1.0))
    diagram.wire(law.u, plant.y)
    diagram.wire(minus.u, law.y)
    diagram.wire(plant.u, minus.y)
    (cycle,) = limit_cycles(diagram, amplitude=limits)
    assert cycle.omega == pytest.approx(1.0, rel=1e-6)  # |G(j)| = 1/2, and N = 4/(pi A)
    A = cycle.amplitudes["law.u"]
    assert pytest.approx(2.0 / math.pi, rel=1e-6) == A
    with pytest.raises(UsageError, match="must be two limits above 0"):
        limit_cycles(diagram, amplitude=("2 rpm", "1 rpm"))
    assert not limit_cycles(diagram, amplitude=(f"{A * 1.1} rad/s", "1e4 rpm"))
    assert not limit_cycles(diagram, amplitude=(A / RPM * 1.1, 1e4))
    assert limit_cycles(diagram, amplitude=(A / RPM * 0.9, 1e4))


@pytest.mark.parametrize("wanted", WAYS)
def test_outputs_and_states_of_an_operating_point_are_in_their_units(wanted: Any) -> None:
    diagram = Diagram("point")
    u = diagram.input("u", unit="rpm")
    lag = diagram.add("lag", blocks.FirstOrder(unit="rpm", T=0.5))
    diagram.wire(lag.u, u)
    diagram.output("y", lag.y)
    for given in ({"outputs": {"y": wanted}}, {"states": {"lag.y": wanted}}, {"outputs": {"lag.y": (wanted, wanted)}}):
        point = find_operating_point(diagram, inputs={"u": None}, **given)
        assert point["lag.y"] == pytest.approx(2.0 * RPM, rel=1e-9)
        assert point["u"] == pytest.approx(2.0 * RPM, rel=1e-9)
    assert find_operating_point(diagram, inputs={"u": wanted})["y"] == pytest.approx(2.0 * RPM, rel=1e-9)
    moving = find_operating_point(diagram, inputs={"u": None}, states={"lag.y": 0.0}, steady={"lag.y": 4.0})
    assert moving["u"] == pytest.approx(2.0 * RPM, rel=1e-9)  # dy/dt = (u - y)/T, 4 rpm per second


def test_the_amplitudes_of_an_observer_take_units() -> None:
    diagram = Diagram("observer")
    diagram.add("eso", blocks.SMESO())
    for name in ("y", "u"):
        diagram.wire(f"eso.{name}", diagram.input(name, default=0))
    plain, quantity = (observer_report(diagram, "eso", amplitudes=[a]) for a in (0.1, "0.1"))
    assert str(plain) == str(quantity)


@pytest.mark.parametrize("u", [*WAYS, {"t": [0, 1], "u": [2, 2]}, ([0, 1], ["2 rpm", "12 deg/s"])])
def test_inputs_of_a_run_are_in_their_units(u: Any) -> None:
    assert saturated().run(stop=1, inputs={"u": u})["u"] == pytest.approx(2.0 * RPM)


def test_elements_of_a_vector_may_have_units_of_their_own() -> None:
    diagram = Diagram("vector")
    diagram.input("u", unit="rpm", size=2)
    value = diagram.run(stop=1, inputs={"u": ["12 deg/s", 3]})["u"][-1]
    assert value == pytest.approx([2.0 * RPM, 3.0 * RPM])
    run = diagram.start(stop=1, inputs={"u": [0, 0]})
    run.set("u", [1, "12 deg/s"])
    assert run["u"] == pytest.approx([RPM, 2.0 * RPM])


@pytest.mark.parametrize(
    ("units", "si"),
    [
        ('# units: {"u": "deg/s"}\n', math.pi / 15),
        ('# written by hand\n# units: {"x":"V","u":"rad/s"}\n', 12.0),
        ('# units: {"u": ""}\n', 12 * RPM),
        ("# units: SI\n", 12 * RPM),
        ("", 12 * RPM),
    ],
)  # fmt: skip
def test_a_csv_file_that_gives_units_is_converted(units: str, si: float, tmp_path: Path) -> None:
    path = tmp_path / "u.csv"
    path.write_text(f"{units}time,u\n0,12\n1,12\n", encoding="utf-8")
    assert saturated().run(stop=1, inputs=path)["u"] == pytest.approx(si)


def test_a_csv_file_gives_units_to_times_and_elements_and_may_not_give_others(tmp_path: Path) -> None:
    diagram = Diagram("vector")
    diagram.input("u", unit="rpm", size=2)
    path = tmp_path / "u.csv"
    path.write_text('# units: {"time": "ms", "u[1]": "deg/s"}\ntime,u[0],u[1]\n0,0,0\n1000,2,12\n', encoding="utf-8")
    assert diagram.run(stop=0.5, inputs=path)["u"][-1] == pytest.approx([RPM, RPM])
    for units in ('{"u": "V"}', '{"u[0]": "V"}', '{"time": "V"}'):
        path.write_text(f"# units: {units}\ntime,u[0],u[1]\n0,0,0\n1,2,12\n", encoding="utf-8")
        with pytest.raises(UsageError, match=r"E502 .*different quantities"):
            diagram.run(stop=0.5, inputs=path)


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ('{"v": "deg/s"}', '"# units" names columns that do not exist: v. Columns: time, u.'),
        ('{"u": 3}', "\"# units\" gives 'u' a unit that is not a text."),
        ("{u: deg/s}", '"# units" is not a JSON object.'),
    ],
)
def test_units_of_a_csv_file_that_cannot_be_meant_are_refused(units: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "u.csv"
    path.write_text(f"# units: {units}\ntime,u\n0,12\n1,12\n", encoding="utf-8")
    with pytest.raises(UsageError, match=re.escape(said)):
        saturated().run(stop=1, inputs=path)


def test_what_a_run_records_of_an_input_drives_another_run_alike(tmp_path: Path) -> None:
    first = saturated().run(stop=1, every=0.1, inputs={"u": ([0, 1], [0, 5])}, log=["u"])
    first.save(tmp_path / "u.csv")
    again = saturated().run(stop=1, every=0.1, inputs=tmp_path / "u.csv", log=["u"])
    assert np.allclose(again["u"], first["u"], rtol=1e-13, atol=0)


def lag(k: float = 3.0) -> Diagram:
    diagram = Diagram("lag")
    diagram.parameter("k", k, unit="rpm")
    step = diagram.add("step", blocks.Step(after="=k", unit="rpm"))
    plant = diagram.add("plant", blocks.FirstOrder(unit="rpm", T=0.5))
    diagram.wire(plant.u, step.y)
    diagram.measure("largest", "peak", of="plant.y")
    diagram.settings(stop=2.0)
    return diagram


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("units", [None, "rpm", "deg/s"])
@pytest.mark.parametrize("kind", ["file", "mapping"])
def test_measured_data_are_in_the_unit_of_the_signal_or_their_own(units: str | None, kind: str, tmp_path: Path) -> None:
    t = np.linspace(0, 2, 21)
    y = 5.0 * (1.0 - np.exp(-t / 0.5)) * (6.0 if units == "deg/s" else 1.0)  # 1 rpm is 6 deg/s
    data: Any = {"time": t, "y": y if units is None else {"value": y, "unit": units}}
    if kind == "file":
        head = f'# units: {{"y": "{units}"}}\n' if units else ""
        rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), y.tolist(), strict=True))
        data = tmp_path / "data.csv"
        data.write_text(f"{head}time,y\n{rows}", encoding="utf-8")
    for bounds in ((1.0, 9.0), ("6 deg/s", "9 rpm")):
        fit = lag().fit(data, over={"k": bounds}, compare={"plant.y": "y"})
        assert fit.values["k"] == pytest.approx(5.0, rel=1e-4)


@pytest.mark.usefixtures("native")
def test_limits_and_bounds_of_a_tuning_take_units() -> None:
    options: dict[str, Any] = {"minimize": "-largest", "optimizer": "de", "budget": 40, "search_seed": 1}
    plain = lag().tune(over={"k": (1, 9)}, subject_to=[f"largest <= {5 * RPM!r}"], **options)
    quantity = lag().tune(over={"k": ("6 deg/s", "9 rpm")}, subject_to=["largest <= 5 rpm"], **options)
    assert quantity.values == plain.values
    assert quantity.is_feasible
    with pytest.raises(UsageError, match=r'subject_to\[0\]: "5 V" limits a measure in rad/s'):
        lag().tune(over={"k": (1, 9)}, subject_to=["largest <= 5 V"], **options)
    with pytest.raises(UsageError, match="E501 k: V and rpm are different quantities"):
        lag().tune(over={"k": ("1 V", 9)}, **options)


@pytest.mark.usefixtures("native")
def test_the_command_line_takes_units_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saturated().save(path := tmp_path / "saturated.json")
    outputs = []
    for amplitude in ("2", "2 rpm", "12 deg/s"):
        words = ["linearize", str(path), "--from", "u", "--to", "y", "--json", "--amplitude", f"law.u={amplitude}"]
        assert main(words) == 0
        outputs.append(capsys.readouterr().out)
    gains = [out[: out.index("described")] if "described" in out else out for out in outputs]
    assert gains[0] == gains[1] == gains[2]
    lag().save(path := tmp_path / "lag.json")
    words = ["tune", str(path), "--minimize", "largest", "--over", "k=6 deg/s,9 rpm", "--budget", "4", "--json"]
    assert main([*words, "--subject-to", "largest >= 2 rpm"]) in (0, 1)


@pytest.mark.parametrize("default", ["30 rpm", {"value": 30, "unit": "rpm"}, {"value": 180, "unit": "deg/s"}])
@pytest.mark.parametrize("unit", ["rpm", "rad/s", "deg/s"])
def test_a_default_of_an_input_may_have_a_unit_of_its_own(default: Any, unit: str) -> None:
    diagram = Diagram("d")
    diagram.output("y", diagram.input("u", unit=unit, default=default))
    again = Diagram.from_json(json.loads(diagram.dumps()))
    for each in (diagram, again):
        assert each.run(stop=1)["u"][0] == pytest.approx(30 * RPM, rel=1e-15)


def test_a_default_of_elements_may_have_a_unit() -> None:
    diagram = Diagram("d")
    diagram.output("y", diagram.input("u", unit="K", size=2, default={"value": [20, 100], "unit": "degC"}))
    results = diagram.run(stop=1)
    assert [results["u[0]"][0], results["u[1]"][0]] == [293.15, 373.15]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"unit": "rad/s", "default": {"value": 30, "unit": "V"}}, r"E104 u: \[V\] is given, but \[rad/s\] is needed"),
        ({"unit": "rad/s", "default": {"value": 30, "unit": "rmp"}}, "E114 u: the unit 'rmp' cannot be read"),
        ({"unit": "rad/s", "default": "30 rpm"}, r'"30 rpm"\. Write \{"value": 30, "unit": "rpm"\}\.'),
        ({"type": "bool", "default": {"value": True}}, "E004 inputs.u.default: must be true or false"),
        ({"size": 2, "default": {"value": [1, 2, 3]}}, "E004 inputs.u.default.value: must be one value for all"),
    ],
)
def test_a_default_that_does_not_fit_is_refused(entry: dict[str, Any], said: str) -> None:
    document = {"format": "blocks-diagram", "version": 3, "inputs": {"u": entry}, "run": {"stop": 1}}
    with pytest.raises(ModelError, match=said):
        Diagram.from_json(document).run()


@pytest.mark.parametrize("value", ["30 rpm", {"value": 30, "unit": "rpm"}])
def test_inputs_in_the_settings_of_a_diagram_take_units(value: Any) -> None:
    diagram = Diagram("d")
    diagram.output("y", diagram.input("u", unit="rad/s"))
    diagram.settings(stop=1, inputs={"u": value})
    assert diagram.run()["u"][0] == pytest.approx(30 * RPM, rel=1e-15)


def test_a_text_for_an_input_in_a_file_is_refused_with_the_quantity_to_write() -> None:
    document: dict[str, Any] = {"format": "blocks-diagram", "version": 3, "inputs": {"u": {"unit": "rad/s"}}}
    with pytest.raises(ModelError, match=r'run\.inputs\.u: .* Write \{"value": 30, "unit": "rpm"\}\.'):
        Diagram.from_json({**document, "run": {"inputs": {"u": "30 rpm"}}})


@pytest.mark.parametrize(("beside", "si"), [({}, 36.0), ({"unit": "m/s"}, 129.6)])
def test_a_column_for_a_parameter_is_in_the_unit_that_its_file_gives(
    beside: dict[str, str], si: float, tmp_path: Path
) -> None:
    (tmp_path / "cycle.csv").write_text('# units: {"speed": "km/h"}\ntime,speed\n0,129.6\n1,129.6\n', encoding="utf-8")
    column = {"csv": "cycle.csv", "column": "speed", **beside}
    blocks_ = {"table": {"type": "Table", "parameters": {"times": [0, 1], "values": column, "unit": "m/s"}}}
    path = tmp_path / "d.json"
    path.write_text(json.dumps({"format": "blocks-diagram", "version": 3, "blocks": blocks_}), encoding="utf-8")
    diagram = Diagram.load(path)
    results = diagram.run(stop=1)
    assert results["table.y"][0] == pytest.approx(si, rel=1e-15)
    # The text without other files means the same.
    whole = Diagram.from_json(json.loads(dumps(self_contained(diagram.value))))
    assert whole.run(stop=1)["table.y"][0] == results["table.y"][0]


def test_edges_of_a_matrix_follow_the_unit_of_their_file(tmp_path: Path) -> None:
    text = '# units: {"value": "mOhm"}\nrow,column,value\n0,0,2000\n'
    (tmp_path / "edges.csv").write_text(text, encoding="utf-8")
    parameters = {"R": {"csv": "edges.csv", "shape": [1, 1]}}
    document = {"format": "blocks-diagram", "version": 3, "parameters": parameters}
    raw = from_document(document, folder=tmp_path).parameters["R"]
    matrix = value_of(raw, "Ohm", {}).value
    assert isinstance(matrix, SparseMatrix)
    assert matrix.values.tolist() == [2.0]
