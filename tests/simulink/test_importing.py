"""Whole models become diagrams that run as SciPy says; what is missing is told, by the command and by the page too."""

from __future__ import annotations

import base64
import json
import shutil
import types
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.io import savemat
from scipy.linalg import expm

from blocks import (
    Block,
    BlocksError,
    Diagram,
    Input,
    ModelError,
    PMDCMotor,
    Ramp,
    Results,
    UsageError,
    from_simulink,
    output,
)
from blocks.cli import main
from blocks.fmi.description import read_description
from blocks.server import gestures  # noqa: F401  # its messages
from blocks.server.editor import Editor
from blocks.server.messages import answer
from blocks.server.session import Session
from tests.support.places import ROOT
from tests.support.simulink_files import FORMS, block, dc_motor, house, line, model, system
from tests.support.simulink_models import FOLDER, MODELS, write

MOTOR = FOLDER / "motor_pid.slx"
VALUES = FOLDER / "motor_pid.m"


def test_the_files_of_the_examples_are_those_that_are_drawn(tmp_path: Path) -> None:
    write(tmp_path)
    for path in tmp_path.iterdir():
        if path.suffix in (".mdl", ".m"):
            assert path.read_bytes() == (FOLDER / path.name).read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in FOLDER.iterdir()}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("drawn", MODELS, ids=lambda drawn: drawn.__name__)
def test_all_forms_of_a_file_give_the_same_diagram(drawn: object, form: str, tmp_path: Path) -> None:
    assert callable(drawn)
    path = FORMS[form](drawn(), tmp_path)
    first = next(one for one in FOLDER.iterdir() if one.stem == path.stem and one.suffix in (".slx", ".mdl"))
    made, known = from_simulink(path, VALUES), from_simulink(first, VALUES)
    assert made.diagram.to_json() == known.diagram.to_json()
    assert made.report == known.report
    assert made.report.is_whole


def test_the_thermostat_runs_as_scipy_says() -> None:
    diagram, report = from_simulink(FOLDER / "thermostat.mdl")
    assert report.is_whole
    results = diagram.run(every=0.25, rtol=1e-10)
    resistance, capacity, power, on = 4.0, 2.5, 8.0, True  # 20 - 15 is above 1

    def weather(t: float) -> float:
        return 8 + 5 * np.sin(2 * np.pi / 24 * t - np.pi / 2)

    t, room, known = 0.0, 15.0, np.full(len(results.t), np.nan)
    while t < 48:
        edge = 21.0 if on else 19.0

        def reached(t: float, y: np.ndarray, edge: float = edge) -> float:
            return y[0] - edge

        reached.terminal, reached.direction = True, 1 if on else -1  # type: ignore[attr-defined]
        heat = power if on else 0.0
        found = solve_ivp(
            lambda t, y, heat=heat: [(heat - (y[0] - weather(t)) / resistance) / capacity],
            (t, 48), [room], rtol=1e-12, atol=1e-12, events=reached, dense_output=True,
        )  # fmt: skip
        inside = (results.t >= t) & (results.t <= found.t[-1])
        known[inside] = found.sol(results.t[inside])[0]
        t, room, on = found.t[-1], found.y[0, -1], not on
    assert np.abs(results["T_room"] - known).max() < 1e-7
    assert results["T_room"][100:].max() < 21 + 1e-9


def test_the_ball_bounces_as_the_closed_form_says() -> None:
    diagram, report = from_simulink(FOLDER / "bouncing_ball.slx")
    assert report.is_whole
    results = diagram.run(every=0.1)
    g, begun, height, speed, known = 9.81, 0.0, 10.0, 15.0, []
    for t in results.t:
        while True:
            impact = begun + (speed + np.sqrt(speed**2 + 2 * g * height)) / g
            if t <= impact:
                break
            begun, height, speed = impact, 0.0, 0.8 * (g * (impact - begun) - speed)
        known.append(height + speed * (t - begun) - g * (t - begun) ** 2 / 2)
    assert np.abs(results["Height.y"] - np.array(known)).max() < 1e-9


def test_the_motor_with_a_sampled_pid_runs_as_a_difference_equation_says() -> None:
    diagram, report = from_simulink(MOTOR, VALUES)
    assert report.is_whole
    assert diagram.to_json()["parameters"] == {"kp": 0.5, "ki": 3, "Ts": 0.005}
    results = diagram.run(every=0.005)
    period, kp, ki, back, counts = 0.005, 0.5, 3.0, 2.0, 200 / (2 * np.pi)
    r, l, k, j, b = 1.2, 0.01, 0.1, 2e-3, 1e-4
    whole = np.zeros((4, 4))  # i, omega, phi and the voltage, which is held
    whole[0], whole[1], whole[2] = [-r / l, -k / l, 0, 1 / l], [k / j, -b / j, 0, 0], [0, 1, 0, 0]
    step = expm(period * whole)
    x, integral, before, known = np.zeros(4), 0.0, 0.0, []
    for tick in range(len(results.t)):
        known.append(x[1])
        counted = np.floor(counts * x[2] + 0.5)
        speed = (counted - before) / period * 2 * np.pi / 200
        error = (60.0 if tick >= 20 else 0.0) - speed
        wanted = kp * error + integral
        x[3] = np.clip(wanted, -24, 24)
        integral += period * (ki * error + back * (x[3] - wanted))
        before, x = counted, step @ x
    assert np.abs(results["omega"] - np.array(known)).max() < 1e-4
    assert np.abs(results["omega"] - np.array(known))[:40].max() < 1e-6


def test_settings_of_the_solver_are_taken(tmp_path: Path) -> None:
    blocks = [block("Clock", "c", 1, {}, {"out": 1}), block("Outport", "y", 2, {}, {"in": 1})]
    inside = system(blocks, [line(("c", "1"), ("y", "1"))])
    for given, run in {
        ("ode45", "2*T", "1e-8", "auto", "auto"): {"stop": 2, "rtol": 1e-8},
        ("ode15s", "3", "1e-3", "1e-12", "auto"): {"stop": 3, "method": "radau", "atol": 1e-12},
        ("ode4", "3", "1e-3", "auto", "T/10"): {"stop": 3, "method": "rk4", "step": 0.1},
        ("ode1", "inf", "1e-3", "auto", "0.5"): {"stop": 10, "method": "euler", "step": 0.5},
    }.items():
        settings = dict(zip(("SolverName", "StopTime", "RelTol", "AbsTol", "FixedStep"), given, strict=True))
        drawn = model("m", inside, settings=settings, callbacks={"InitFcn": "T = 1;"})
        diagram, report = from_simulink(FORMS["inline"](drawn, tmp_path))
        assert diagram.to_json()["run"] == {**run, "log": ["y"]}
        assert report.is_whole


# --- what is missing -------------------------------------------------------------------------------------------------


def test_unknown_variables_and_what_has_no_equal_are_told(tmp_path: Path) -> None:
    without = from_simulink(MOTOR)
    assert not without.report.is_whole
    assert "no value for kp, ki, Ts" in [entry.what for entry in without.report.of("unknown")]
    diagram, report = from_simulink(FORMS["mdl"](house(), tmp_path))
    missing = {entry.path: entry.what for entry in report.of("left out")}
    assert missing == {"Küche/Comfort": "a MATLAB Function"}
    with pytest.raises(ModelError, match=r"E103 Kueche\.Comfort"):
        diagram.check()
    assert "function u = comfort" in json.dumps(diagram.to_json())

    class ComfortToWrite(Block):
        """Heats while it is too cold."""

        u1 = Input()
        u2 = Input()

        @output
        def y1(u1, u2):
            return u2 - u1

    library = types.ModuleType("own")
    library.ComfortToWrite = ComfortToWrite  # type: ignore[attr-defined]
    Diagram.from_json(diagram.to_json(), library=library).check()


def test_a_library_and_what_is_no_model_are_refused(tmp_path: Path) -> None:
    drawn = model("parts", system([block("Gain", "g", 1)]), "Library")
    with pytest.raises(ModelError, match=r"E010 .*it is a library"):
        from_simulink(FORMS["mdl"](drawn, tmp_path))
    with pytest.raises(ModelError, match="E010"):
        from_simulink(VALUES)
    with pytest.raises(UsageError, match=r"E501 .*cannot be read"):
        from_simulink(MOTOR, tmp_path / "none.mat")
    link = block("Reference", "part", 1, {"SourceBlock": "broken/Part", "SourceType": ""}, {"in": 1, "out": 1})
    choice = block("Selector", "two", 2, {"Indices": "[1 3]"}, {"in": 1, "out": 1})
    blocks = [link, choice, block("Clock", "c", 3, {}, {"out": 1})]
    inside = system(blocks, [line(("c", "1"), ("two", "1"), ("part", "1"))])
    (tmp_path / "broken.mdl").write_text("Library {")
    _, report = from_simulink(FORMS["mdl"](model("m", inside), tmp_path))
    assert {entry.path for entry in report.of("left out")} == {"part", "two"}
    (tmp_path / "bad.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(200))
    with pytest.raises(UsageError, match="-v7"):
        from_simulink(MOTOR, tmp_path / "bad.mat")


def test_variables_come_from_mat_files_too(tmp_path: Path) -> None:
    savemat(tmp_path / "gains.mat", {"kp": 0.5, "ki": 3.0, "Ts": 0.005, "name": "x", "s": {"a": 1.0}})
    made, known = from_simulink(MOTOR, [tmp_path / "gains.mat"]), from_simulink(MOTOR, VALUES)
    assert made.diagram.to_json() == known.diagram.to_json()


def test_variables_stay_tunable_or_the_report_tells_which_do_not(tmp_path: Path) -> None:
    values = {"Numerator": "[Kt]", "Denominator": "[La*Ra, (Ra*La + 2*Ra) Kt^2+Kb]"}
    blocks = [
        block("Step", "step", 1, {"Time": "0"}, {"out": 1}),
        block("TransferFcn", "plant", 2, values, {"in": 1, "out": 1}),
        block("TransferFcn", "fixed", 3, {"Numerator": "1", "Denominator": "conv([1 Ra], 1)"}, {"in": 1, "out": 1}),
        block("Gain", "unknown", 4, {"Gain": "1/m"}, {"in": 1, "out": 1}),
        block("Outport", "y", 5, {}, {"in": 1}),
    ]
    lines = [
        line(("step", "1"), ("plant", "1"), ("fixed", "1"), ("unknown", "1")),
        line(("plant", "1"), ("y", "1")),
    ]
    drawn = model("m", system(blocks, lines), callbacks={"InitFcn": "Kt = 2; La = 1; Ra = 3; Kb = 4;"})
    path = FORMS["mdl"](drawn, tmp_path)
    diagram, report = from_simulink(path, {"m": 5, "Ra": 9})
    parameters = {name: entry.get("parameters") for name, entry in diagram.to_json()["blocks"].items()}
    assert parameters["plant"] == {"num": ["=Kt"], "den": ["=La*Ra", "=(Ra*La+2*Ra)", "=Kt**2+Kb"]}
    assert parameters["unknown"] == {"k": "=1/m"}
    assert [(entry.path, entry.what.partition(" ")[0]) for entry in report.entries] == [("fixed", "Ra")]
    tuned = diagram.run(parameters={"Kt": 4}, stop=20)["y"][-1]
    assert tuned == pytest.approx(4 / (4**2 + 4), abs=1e-6)
    assert [entry.path for entry in from_simulink(path).report.of("unknown")] == ["unknown"]


def test_a_loop_is_solved_and_told(tmp_path: Path) -> None:
    blocks = [
        block("Constant", "c", 1, {"Value": "3"}, {"out": 1}),
        block("Sum", "s", 2, {"Inputs": "+-"}, {"in": 2, "out": 1}),
        block("Gain", "g", 3, {"Gain": "2"}, {"in": 1, "out": 1}),
        block("Outport", "y", 4, {}, {"in": 1}),
    ]
    lines = [line(("c", "1"), ("s", "1")), line(("s", "1"), ("g", "1"), ("y", "1")), line(("g", "1"), ("s", "2"))]
    diagram, report = from_simulink(FORMS["split"](model("loop", system(blocks, lines)), tmp_path))
    assert "loops" in report.of("decided")[-1].what
    assert diagram.run()["y"][-1] == pytest.approx(1.0, abs=1e-9)


def test_files_beside_the_model_are_read(tmp_path: Path) -> None:
    shutil.copy(ROOT / "fmus" / "PMDCMotor.fmu", tmp_path)
    t = np.linspace(0, 2, 5)
    savemat(tmp_path / "volts.mat", {"ans": np.vstack([t, 6 * t])})
    blocks = [
        block(
            "FromFile", "volts", 1, {"FileName": "volts.mat", "OutputAfterFinalValue": "Hold final value"}, {"out": 1}
        ),
        block("FMU", "motor", 2, {"FMUName": "PMDCMotor.fmu"}, {"in": 2, "out": 2}),
        block("ToWorkspace", "log", 3, {"VariableName": "omega"}, {"in": 1}),
    ]
    lines = [line(("volts", "1"), ("motor", "1")), line(("motor", "1"), ("log", "1"))]
    drawn = model("m", system(blocks, lines), settings={"StopTime": "2"})
    diagram, report = from_simulink(FORMS["split"](drawn, tmp_path))
    assert report.is_whole
    alone = Diagram("alone")
    motor = alone.add("motor", PMDCMotor())
    alone.wire(motor.v, alone.add("volts", Ramp(slope=6)).y)
    ports = read_description(ROOT / "fmus" / "PMDCMotor.fmu").variables
    first = next(each.name for each in ports if each.causality == "output")
    known = alone.run(stop=2, rtol=1e-10)[f"motor.{first}"]
    found = diagram.run(trust=tmp_path, master={"step": 0.01, "order": 2})["omega"]
    assert found[-1] == pytest.approx(known[-1], rel=1e-5)
    (tmp_path / "volts.mat").unlink()
    assert {entry.path for entry in from_simulink(tmp_path / "m.slx").report.of("left out")} == {"volts"}


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_command_writes_the_diagram_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "motor.json"
    assert main(["import", str(MOTOR), "-o", str(out), "--workspace", str(VALUES)]) == 0
    assert "motor_pid: 20 blocks taken" in capsys.readouterr().out
    assert Diagram.load(out).to_json() == from_simulink(MOTOR, VALUES).diagram.to_json()
    assert main(["import", str(MOTOR), "-o", str(out)]) == 2  # it is there
    assert "--force" in capsys.readouterr().err
    assert main(["import", str(MOTOR), "-o", str(out), "--force", "--json"]) == 1
    told = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    assert {"taken", "unknown", "done"} <= {each["event"] for each in told}
    assert told[-1] == {"event": "done", "diagram": str(out), "whole": False, "taken": told[-1]["taken"]}
    assert main(["import", str(MOTOR), "-o", "-"]) == 2
    for name in ("motor_pid.slx", "thermostat.mdl"):
        assert main(["run", str(FOLDER / name)]) == 2
        assert f"blocks import {FOLDER / name}" in capsys.readouterr().err
    own = FORMS["split"](dc_motor(), tmp_path)
    before = own.read_bytes()
    assert main(["import", str(own), "-o", str(own), "--force"]) == 2
    assert own.read_bytes() == before
    assert main(["import", str(MOTOR), "-o", str(out), "--force", "--workspace", str(out)]) == 2
    assert main(["import", str(tmp_path / "none.slx")]) == 2
    assert "E007" in capsys.readouterr().err


def test_results_are_compared_with_what_simulink_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = from_simulink(MOTOR, VALUES).diagram.run(every=0.01)
    results.save(tmp_path / "run.parquet")
    t = results.t[:, None]
    signals = [{"values": results["omega"][:, None], "label": "", "blockName": "motor_pid/omega", "dimensions": 1.0}]
    yout = {"time": t, "signals": signals, "blockName": ""}
    voltage = {"time": t, "signals": {"values": results["voltage"][:, None] + 0.001, "label": ""}, "blockName": "m/Log"}
    saved = {"tout": t, "kp": 0.5, "yout": yout, "voltage": voltage}
    savemat(tmp_path / "sim.mat", saved)
    given = ["compare", str(tmp_path / "run.parquet"), str(tmp_path / "sim.mat")]
    assert main(given) == 1
    assert "1 of 2 signals beyond" in capsys.readouterr().out
    assert main([*given, "--tolerance", "1e-3"]) == 0
    savemat(tmp_path / "arrays.mat", {"tout": t, "omega": results["omega"][:, None], "x": "text"})
    assert np.array_equal(Results.load(tmp_path / "arrays.mat")["omega"], results["omega"])
    savemat(tmp_path / "file.mat", {"ans": np.vstack([results.t, results["omega"]])})
    assert np.array_equal(Results.load(tmp_path / "file.mat")["ans"], results["omega"])
    other = {"time": t[1:], "signals": {"values": t[1:], "label": "", "dimensions": 1.0}}
    savemat(tmp_path / "two.mat", saved | {"late": other})
    with pytest.raises(UsageError, match="other times"):
        Results.load(tmp_path / "two.mat")


# --- the page --------------------------------------------------------------------------------------------------------


def test_a_model_that_is_dropped_on_the_page_becomes_a_diagram_beside_it(tmp_path: Path) -> None:
    session = Session(Editor(tmp_path / "own.json"))
    try:
        data = base64.b64encode(FORMS["split"](dc_motor(), tmp_path).read_bytes()).decode()
        told = answer(session, {"do": "import_model", "name": "dc_motor.slx", "text": data})
        assert told is not None
        assert told["diagram"] == "dc_motor.json"
        assert "blocks taken" in str(told["report"])
        answer(session, {"do": "insert", "entry": {"diagram": "dc_motor.json"}})
        assert json.loads((tmp_path / "own.json").read_text())["blocks"]["dc_motor"]["diagram"] == "dc_motor.json"
        wrong = (("dc_motor.slx", data), ("x.fmu", data), ("../y.slx", data), ("z.slx", "?"), ("z.slx", "AAAA"))
        for name, text in wrong:
            with pytest.raises(BlocksError):
                answer(session, {"do": "import_model", "name": name, "text": text})
        assert not (tmp_path / "z.json").exists()
    finally:
        session.close()
