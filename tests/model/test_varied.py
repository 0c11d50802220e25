"""An element of a vector is set by its name in runs, in prepared models and on the command line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, FirstOrder, LookupTable, MatrixGain, ModelError, Ramp, TransferFunction, UsageError, fmu
from blocks.cli import main
from blocks.compile.toolchain.compiler import find_compiler
from blocks.engines.driver import Simulation

native = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


def tables() -> Diagram:
    """Two tables over time, of values of the diagram and of its own, and a matrix that may change in a run."""
    diagram = Diagram("tables")
    diagram.parameter("k", [1, 2, 3])
    diagram.parameter("length", [1, 2, 3], unit="mm")
    time = diagram.add("time", Ramp(slope=1.0))
    for name, values in (("own", [4, 5, 6]), ("bound", "=k"), ("lengths", "=length")):
        unit = "m" if name == "lengths" else ""
        table = diagram.add(name, LookupTable(points=[0, 1, 2], values=values, unit=unit))
        diagram.wire(table.u, time.y)
    matrix = diagram.add("matrix", MatrixGain(K=[[1.0, 2.0], [3.0, 4.0]]))
    diagram.wire(matrix.u, diagram.input("u", size=2, default=[1, 1]))
    return diagram


GRID: dict[str, Any] = {"stop": 2, "every": 1.0, "log": ["own.y", "bound.y", "lengths.y"]}


@pytest.mark.parametrize(
    ("given", "name", "values"),
    [
        ({"own.values[2]": 7}, "own.y", [4, 5, 7]),
        ({"k[1]": 7}, "bound.y", [1, 7, 3]),
        ({"k[0]": 8, "k[2]": 9}, "bound.y", [8, 2, 9]),
        ({"k": [9, 9, 9], "k[1]": 7}, "bound.y", [9, 7, 9]),
        ({"k[1]": 7, "k": np.array([9.0, 9.0, 9.0])}, "bound.y", [9, 7, 9]),
        ({"length[1]": 7}, "lengths.y", [1e-3, 7e-3, 3e-3]),
        ({"length[1]": "7 cm"}, "lengths.y", [1e-3, 7e-2, 3e-3]),
        ({"o*.values[0]": -1}, "own.y", [-1, 5, 6]),
    ],
)
def test_an_element_is_set_in_a_run_and_in_a_prepared_model(given: Any, name: str, values: list[float]) -> None:
    diagram = tables()
    assert diagram.run(parameters=given, **GRID)[name].tolist() == pytest.approx(values)
    assert diagram.prepare(**GRID).run(parameters=given)[name].tolist() == pytest.approx(values)
    assert diagram.prepare(parameters=given, **GRID).run()[name].tolist() == pytest.approx(values)
    assert diagram.flatten(parameters=given).blocks


def test_elements_of_a_run_are_set_on_top_of_those_of_the_prepared_model() -> None:
    model = tables().prepare(parameters={"k[0]": 5}, **GRID)
    assert model.run(parameters={"k[1]": 7})["bound.y"].tolist() == [5, 7, 3]
    assert model.run(parameters={"k[0]": 6})["bound.y"].tolist() == [6, 2, 3]
    assert model.run(parameters={"k": [7, 8, 9]})["bound.y"].tolist() == [7, 8, 9]
    assert model.run()["bound.y"].tolist() == [5, 2, 3]


@native
def test_rows_of_a_batch_keep_the_elements_that_all_rows_are_given() -> None:
    given: dict[str, Any] = {"parameters": {"k[0]": 5}, "engine": "native", "log": ["bound.y"], "stop": 2, "every": 1.0}
    rows = tables().batch(["k[1]"], **given)([[7], [8]])
    assert rows.signals["bound.y"].tolist() == [[5, 7, 3], [5, 8, 3]]
    for name in ("k", "k[0]"):
        with pytest.raises(UsageError, match="varies from row to row, and has a value for all rows"):
            tables().batch([name], **given)


@native
def test_a_fit_keeps_the_elements_that_are_given() -> None:
    t = np.linspace(0, 2, 41)
    data = {"time": t, "y": np.interp(t, [0, 1, 2], [5.0, 7.0, 3.0])}
    fit = tables().fit(data, over={"k[1]": (0.5, 9)}, compare={"bound.y": "y"}, parameters={"k[0]": 5}, engine="native")
    assert fit.values["k[1]"] == pytest.approx(7, abs=1e-5)
    assert fit.deviations["bound.y"] < 1e-6


def test_an_element_is_set_while_a_run_goes_on_and_when_it_is_resumed() -> None:
    diagram = tables()
    run = diagram.start(parameters={"own.values[0]": 1, "matrix.K[0,1]": 5}, stop=2, log=["own.y", "matrix.y"])
    assert run["matrix.y"].tolist() == [6, 7]
    run.set("matrix.K[1,0]", 10)
    run.advance(0.5)
    assert run["matrix.y"].tolist() == [6, 14], "what was set before stays"
    with pytest.raises(UsageError, match="E502"):
        run.set("matrix.Q[0]", 1)
    on = diagram.run(resume=run.snapshot(), parameters={"own.values[1]": 51, "matrix.K[1,1]": 1}, stop=1, every=0.5,
                     log=["own.y", "matrix.y"])  # fmt: skip
    assert on["own.y"].tolist() == [26, 51]
    assert on["matrix.y"][-1].tolist() == [6, 11]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("k[3]", r"E501 k\[3\]: k has no element \[3\]. It has \[0\] to \[2\]"),
        ("q[0]", r"E106 q\[0\]: there is no such parameter"),
        ("own.value[0]", "Did you mean 'own.values'"),
        ("bound.values[0]", "E117 bound.values: is computed from other parameters"),
    ],
)
def test_an_element_that_is_not_there_is_refused(name: str, said: str) -> None:
    with pytest.raises((ModelError, UsageError), match=said):
        tables().run(parameters={name: 1}, **GRID)


def bound() -> Diagram:
    """A lag whose time constant is that of the diagram."""
    made = Diagram("lag")
    made.parameter("delay", 0.2, unit="s")
    made.add("plant", FirstOrder(T="=delay"))
    made.wire(made["plant"].u, made.input("u", default=1.0))
    made.measure("end", "peak", of="plant.y")
    return made


RUNS: dict[str, Callable[[Diagram, str], Any]] = {
    "run": lambda made, name: made.run(parameters={name: 0.5}, stop=1),
    "prepare": lambda made, name: made.prepare().run(parameters={name: 0.5}, stop=1),
    "batch": lambda made, name: made.batch([name], stop=1),
    "sweep": lambda made, name: made.sweep({name: [0.1, 0.2]}, stop=1),
    "tune": lambda made, name: made.tune(minimize="end", over={name: (0.1, 1.0)}, budget=3, stop=1),
    "fit": lambda made, name: made.fit(
        {"time": [0.0, 0.5, 1.0], "y": [0.0, 0.9, 1.0]}, over={name: (0.1, 1.0)}, compare={"plant.y": "y"}
    ),
}


@pytest.mark.parametrize("by", RUNS)
@pytest.mark.parametrize("name", ["plant.T", "*.T", "all.plant.T"])
def test_a_bound_parameter_is_refused_before_anything_runs(by: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = bound()
    if name.startswith("all"):
        made = Diagram("outer")
        made.add("all", bound(), copies=2)
        made.wire("all.u", made.input("u", default=1.0))
        made.measure("end", "peak", of="all[0].plant.y")
    monkeypatch.setattr(Simulation, "advance_to", lambda *_: pytest.fail("a run began"))
    refusal = r'E117 (all\.)?plant.T: is computed from other parameters \("=delay"\), so it cannot be set itself'
    with pytest.raises(ModelError, match=refusal):
        RUNS[by](made, name)


NO_NUMBERS: tuple[Any, ...] = ("x", "=length", [1, 2], None, True, {"value": [1], "unit": ""})


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_an_element_takes_a_number_only(value: Any) -> None:
    with pytest.raises(ModelError, match=r"E10[78] k\[0\]: "):
        tables().flatten(parameters={"k[0]": value})


@native
def test_rows_whose_element_is_no_number_are_refused() -> None:
    rows = tables().batch(["k[0]"], engine="native", **GRID)([*([value] for value in NO_NUMBERS), [2.0]])
    assert rows.status.tolist() == ["refused"] * len(NO_NUMBERS) + ["ok"]
    assert all("k[0]" in message for message in rows.messages[:-1])


def test_an_element_of_what_differs_between_copies_is_refused() -> None:
    cell = Diagram("cell")
    cell.parameter("k", [1.0, 2.0])
    table = cell.add("table", LookupTable(points=[0, 1], values="=k"))
    cell.wire(table.u, cell.add("time", Ramp(slope=1.0)).y)
    fleet = Diagram("fleet")
    fleet.add("cells", cell, copies=3)
    with pytest.raises(UsageError, match=r"the elements of cells\[2\].k are not known: .* differs between copies"):
        fleet.flatten(parameters={"cells[2].k": [9, 9], "cells[2].k[1]": 8})


def test_the_command_sets_an_element(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tables.json"
    diagram = tables()
    diagram.measure("end", "peak", "own.y")
    diagram.save(path)
    assert main(["run", str(path), "--stop", "2", "--set", "own.values[2]=7", "--json"]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert events[-1]["measures"]["end"] == 7


def test_a_batch_beside_a_list_of_lists_for_copies_in_copies_is_made() -> None:
    wheel = {
        "parameters": {"p": 1.0, "q": 1.0}, "inputs": {"u": {}}, "outputs": {"y": "gain.y"},
        "blocks": {"gain": {"type": "Gain", "parameters": {"k": "=p*q"}}}, "wires": {"gain.u": "u"},
    }  # fmt: skip
    robot = {
        "inputs": {"u": {}}, "blocks": {"wheels": {"copies": 2, "diagram": wheel}}, "wires": {"wheels.u": "u"},
        "outputs": {"y": "wheels.y"},
    }  # fmt: skip
    document = {
        "format": "blocks-diagram", "version": 3, "name": "robots", "inputs": {"u": {"default": 1.0}},
        "blocks": {"robots": {"copies": 3, "diagram": robot}}, "wires": {"robots.u": "u"},
    }  # fmt: skip
    diagram = Diagram.from_json(json.dumps(document))
    given = {"robots.wheels.p": [[1, 2], [3, 4], [5, 6]]}
    grid: dict[str, Any] = {"stop": 0.1, "every": 0.1, "log": ["robots.y"], "engine": "reference"}
    batch = diagram.batch(["robots.wheels.q"], parameters=given, **grid)
    rows = batch([[10.0]])
    assert rows.signals["robots.y"][0, -1].tolist() == [[10, 20], [30, 40], [50, 60]]


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU of FMI 2, with parameters such as "tf.den[1]", and of copies "lags[1].T" and "lags[1].y_start"."""
    inside = Diagram("plant")
    inside.input("u", default=1.0)
    tf = inside.add("tf", TransferFunction(num=[1], den=[1, 1.2, 1]))
    lags = inside.add("lags", FirstOrder(T=[0.1, 0.2]), copies=2)
    inside.wire(tf.u, "u")
    inside.wire(lags.u, "u")
    inside.output("y", tf.y)
    inside.output("z", lags.y)
    path = tmp_path_factory.mktemp("plant") / "plant.fmu"
    inside.export(path, fmi=2)
    return path


def around(path: Path, kind: str = "CS", **own: float) -> Diagram:
    made = Diagram("around")
    made.wire(made.add("o", fmu(path, kind=kind, parameters=own)).u, made.input("u", default=1.0))
    made.measure("end", "peak", of="o.y")
    return made


def step_response(zeta: float, t: float) -> float:
    """Of 1/(s^2 + 2 zeta s + 1), below critical damping."""
    w = math.sqrt(1 - zeta**2)
    return 1 - math.exp(-zeta * t) * (math.cos(w * t) + zeta / w * math.sin(w * t))


OF_THE_FMU = {"o.tf.den[1]": 0.6, "o.lags[1].T": 0.5, "o.lags[1].y_start": 2.0}
RUN: dict[str, Any] = {"stop": 3, "rtol": 1e-9, "log": ["o.y", "o.z[1]"]}


@native
@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_a_parameter_of_an_fmu_whose_name_has_brackets_is_set_like_any_other(plant: Path, kind: str) -> None:
    made = around(plant, kind)
    expected = [step_response(0.3, 3.0), 1 + math.exp(-3 / 0.5)]

    def ends(results: Any) -> list[float]:
        return [results["o.y"][-1], results["o.z[1]"][-1]]

    assert ends(made.run(parameters=OF_THE_FMU, **RUN)) == pytest.approx(expected, abs=1e-5)
    assert ends(made.prepare(**RUN).run(parameters=OF_THE_FMU)) == pytest.approx(expected, abs=1e-5)
    assert ends(made.prepare(parameters={"o.tf.den[1]": 9.0} | OF_THE_FMU, **RUN).run()) == pytest.approx(
        expected, abs=1e-5
    )
    own = {name.removeprefix("o."): value for name, value in OF_THE_FMU.items()}
    assert ends(around(plant, kind, **own).run(**RUN)) == ends(made.run(parameters=OF_THE_FMU, **RUN))
    swept = made.sweep({name: [value] for name, value in OF_THE_FMU.items()}, **RUN)
    assert swept.signals["o.y"][0, -1] == pytest.approx(expected[0], abs=1e-5)


@native
def test_a_pattern_matches_parameters_whose_names_have_brackets(plant: Path) -> None:
    made = around(plant)
    alike = made.run(parameters={"o.lags[0].T": 0.7, "o.lags[1].T": 0.7}, stop=1)
    for pattern in ("o.lags[*].T", "o.*.T", "*.lags*.T"):
        assert made.run(parameters={pattern: 0.7}, stop=1)["o.z[0]"].tolist() == alike["o.z[0]"].tolist()
        assert made.batch([pattern], stop=1).targets == (("o.lags[0].T", "o.lags[1].T"),)
    assert made.batch(["o.t*.den[1]"], stop=1).targets == (("o.tf.den[1]",),)


@native
def test_parameters_with_brackets_of_fmus_in_copies(plant: Path) -> None:
    made = Diagram("fleet")
    made.wire(made.add("o", fmu(plant, kind="ME"), copies=2).u, made.input("u", default=1.0))
    found = made.run(parameters={"o[1].tf.den[1]": 0.6}, stop=3, rtol=1e-9)["o.y"][-1]
    assert found.tolist() == pytest.approx([step_response(0.6, 3.0), step_response(0.3, 3.0)], abs=1e-6)
    both = made.run(parameters={"o.tf.den[1]": 0.6}, stop=3, rtol=1e-9)["o.y"][-1]
    assert both.tolist() == pytest.approx([step_response(0.3, 3.0)] * 2, abs=1e-6)


@native
def test_a_tuned_parameter_with_brackets_is_written_into_the_file(plant: Path) -> None:
    file = plant.with_name("around.json")
    around(plant).save(file)
    made = Diagram.load(file)
    made.measure("overshoot", "peak", of="o.y")
    tuned = made.tune(minimize="overshoot", over={"o.tf.den[1]": (1.3, 1.9)}, budget=4, stop=5)
    tuned.write(file)
    value = Diagram.load(file).value.blocks["o"].parameters["tf.den[1]"]
    assert value == pytest.approx(tuned.values["o.tf.den[1]"])
    with pytest.raises(UsageError, match=r"E106 o.tf.den\[7\]: there is no such parameter. Did you mean 'o.tf.den\["):
        made.tune(minimize="overshoot", over={"o.tf.den[7]": (1.3, 1.9)}, budget=3, stop=5)


@native
def test_a_parameter_with_brackets_is_set_while_a_run_goes_on(plant: Path) -> None:
    for kind in ("CS", "ME"):
        run = around(plant, kind).start(stop=30)
        run.advance(1)
        run.set("o.tf.den[2]", 0.5)
        run.advance_to(30)
        assert run["o.y"] == pytest.approx(2.0, abs=1e-4), "the static gain is 1/den[2]"
        assert run.given == {"o.tf.den[2]": "0.5"}


@native
def test_commands_set_parameters_with_brackets(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    end = step_response(0.3, 3.0)
    file = plant.with_name("of_commands.json")
    around(plant).save(file)
    assert main(["fmu", "run", str(plant), "--stop", "3", "--input", "u=1", "--set", "tf.den[1]=0.6", "--json"]) == 0
    assert main(["run", str(file), "--stop", "3", "--set", "o.tf.den[1]=0.6", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["measures"]["end"] == pytest.approx(end, abs=1e-4)
    assert main(["sweep", str(file), "--stop", "3", "--vary", "o.tf.den[1]=0.6", "--json"]) == 0
    swept = json.loads(capsys.readouterr().out.splitlines()[0])
    assert swept["quantiles"]["end"] == pytest.approx([end] * 3, abs=1e-4)
    study = plant.with_name("study.json")
    case = {"parameters": {"o.tf.den[1]": 0.6}, "settings": {"stop": 3}}
    study.write_text(
        json.dumps({
            "format": "blocks-study", "version": 1, "name": "damped", "runs": {"one": {"diagram": file.name, **case}},
            "sweeps": {"many": {"diagram": file.name, "vary": {"o.tf.den[1]": [0.6, 1.2]}, "settings": {"stop": 3}}},
            "claims": [
                {"run": "one", "measure": "end", "at_most": end + 1e-4, "expect": "holds"},
                {"sweep": "many", "measure": "end", "statistic": "mean", "at_most": end, "expect": "holds"},
            ],
        })
    )  # fmt: skip
    assert main(["study", str(study), "--out", str(plant.parent)]) == 0, "more damping, a lower mean"
