"""`blocks fmu run`: the FMU's own names, FMUs without outputs, texts, wrong times, and archives that are no FMU."""

import math
import re
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from blocks import Diagram, FMUError, MatrixGain, ModelError, Results, StateSpace, fmu
from blocks.cli import main
from blocks.compile.coupling import couple
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.given_fmus import INTERFACE, plant

pytestmark = NEEDS_COMPILER
FMUS = Path(__file__).resolve().parents[2] / "fmus"
EVENT = FAULTS.index("event")
Printed = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def ran(printed: Printed, *words: str, status: int = 0) -> tuple[str, str]:
    """What `blocks fmu run plant.fmu` prints with further words: its table, and its messages."""
    assert main(["fmu", "run", "plant.fmu", *words]) == status
    out, err = printed.readouterr()
    return out, err


@pytest.mark.parametrize("kind", ["CS", "ME"])
def test_each_output_is_recorded_once(kind: str, tmp_path: Path, capsys: Printed) -> None:
    path = str(FMUS / "PMDCMotor.fmu")
    assert main(["fmu", "run", path, "--kind", kind, "--stop", "0.1", "--out", "motor.csv"]) == 0
    assert list(Results.load("motor.csv").columns) == ["v", "tau", "omega", "i"]
    table = capsys.readouterr().out
    assert (table.count("  omega  "), table.count("PMDCMotor.omega")) == (1, 0)
    assert main(["fmu", "run", path, "--stop", "0.1", "--log", "PMDCMotor.omega", "--out", "motor.csv"]) == 0
    assert list(Results.load("motor.csv").columns) == ["PMDCMotor.omega"]


def test_the_default_step_is_the_same_by_itself_and_in_a_diagram(tmp_path: Path, capsys: Printed) -> None:
    experiment = '<DefaultExperiment stopTime="2" stepSize="0.02"/>'
    for size, own in (("0.05", ' fixedInternalStepSize="0.05"'), ("0.02", "")):
        plant(
            tmp_path, (INTERFACE, INTERFACE + own), ("<ModelVariables>", f"{experiment}<ModelVariables>")
        )  # fmt: skip
        assert f"every {size} s" in ran(capsys)[0]
        diagram = Diagram.alone(fmu("plant.fmu"))
        (unit,) = couple(diagram.flatten(stop=2)).units
        assert float(unit.step) == float(size)


@pytest.mark.parametrize(
    ("settings", "step"),
    [
        ({"stop": 2}, "1/500"),
        ({"stop": 3}, "1/200"),
        ({"stop": 2, "every": 0.01}, "1/300"),
        ({"stop": 2, "every": 0.003}, "3/1000"),
        ({"every": 0.25}, "1/4"),
        ({}, "1/1000"),
        ({"stop": 2, "master": {"step": 0.01}}, "1/100"),
    ],
)
def test_the_default_step_is_a_part_of_the_run(settings: dict[str, Any], step: str) -> None:
    diagram = Diagram.alone(fmu(str(FMUS / "PMDCMotor.fmu"), kind="CS"))
    (unit,) = couple(diagram.flatten(**settings)).units
    assert unit.step == Fraction(step)


def test_the_names_that_the_fmu_gives_are_taken_by_all_options(capsys: Printed, tmp_path: Path) -> None:
    local = '<Float64 name="c[1].x" valueReference="3"/>'
    own = '<Float64 name="p[2].k" valueReference="5" causality="parameter" variability="tunable" start="1"/>'
    plant(
        tmp_path, ('name="u"', 'name="a[1].b.c"'), ('name="y"', 'name="out[2].y"'),
        ("  </ModelVariables>", f"  {local}{own}</ModelVariables>"),
    )  # fmt: skip
    logged = (word for name in ("a[1].b.c", "out[2].y", "c[1].x") for word in ("--log", name))
    out, err = ran(capsys, "--stop", "1", "--input", "a[1].b.c=2", "--set", "p[2].k=3", *logged)
    assert not err
    ends = re.findall(r"^  (\S+\.?\S*) +- +\S+ +\S+ +(\S+)", out, re.MULTILINE)
    assert ends == [("a_1_b_c", "2"), ("out_2_y", "6"), ("plant.c[1].x", "6")]  # x' = k u


def test_an_fmu_without_outputs_shows_its_local_variables(capsys: Printed, tmp_path: Path) -> None:
    plant(
        tmp_path, (' causality="output"', ""), ('<Output valueReference="2" dependencies=""/>', ""),
        ('<InitialUnknown valueReference="2" dependencies=""/>', ""),
    )  # fmt: skip
    out, err = ran(capsys, "--stop", "1", "--input", "u=2")
    assert err == "plant.fmu has no outputs: its local variables are recorded; --log NAME records other variables.\n"
    assert re.search(r"^  plant\.y .* 2 ", out, re.MULTILINE)


def test_an_input_that_is_a_text_is_set_at_the_start(capsys: Printed, tmp_path: Path) -> None:
    text = '<String name="s" valueReference="9" causality="input" variability="discrete"><Start value="a"/></String>'
    plant(tmp_path, ("  </ModelVariables>", f"  {text}</ModelVariables>"))
    for option, given in (("--input", "s=hello"), ("--input", "s =hello"), ("--set", "s=hello")):
        out, err = ran(capsys, "--stop", "1", option, given)
        assert "set: plant.s_start = hello" in out
        assert not err


@pytest.mark.parametrize(
    ("experiment", "said"),
    [
        ('startTime="5" stopTime="1"', "stopTime 1 is not after startTime 5, and is ignored."),
        ('stopTime="1" stepSize="-0.1"', "stepSize -0.1 is not above 0, and is ignored."),
        ('stopTime="1" tolerance="0"', "tolerance 0 is not above 0, and is ignored."),
        ('stopTime="soon"', "stopTime is not a number, and is ignored."),
    ],
)
def test_a_default_experiment_that_cannot_be_meant_is_named_and_left_out(
    capsys: Printed, tmp_path: Path, experiment: str, said: str
) -> None:
    plant(tmp_path, ("</ModelVariables>", f"</ModelVariables>\n  <DefaultExperiment {experiment}/>"))
    _, err = ran(capsys, "--stop", "6")
    assert re.fullmatch(rf"W201 plant\.fmu\S+ DefaultExperiment: {re.escape(said)}\n", err)


def test_steps_are_told_in_all_their_digits(capsys: Printed, tmp_path: Path) -> None:
    experiment = '<DefaultExperiment stopTime="1" stepSize="0.1000000001"/>'
    plant(
        tmp_path, ("</ModelVariables>", f"</ModelVariables>\n  {experiment}"),
        (' canHandleVariableCommunicationStepSize="true"', ""),
    )  # fmt: skip
    _, err = ran(capsys)
    assert "takes steps of 0.1000000001 s only, and the stop at 1 s is not a multiple of them" in err


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_event_mode_that_an_fmu_declares_and_refuses_is_named(capsys: Printed, tmp_path: Path, engine: str) -> None:
    attributes = 'causality="parameter" variability="fixed"'
    event = f'<Int32 name="fault" valueReference="7" {attributes} start="0"/>'
    when = f'<Float64 name="t_fault" valueReference="8" {attributes} start="1"/>'
    plant(
        tmp_path, (INTERFACE, f'{INTERFACE} hasEventMode="true"'),
        ("  </ModelVariables>", f"  {event}{when}</ModelVariables>"), flags=("-DREFUSES_EVENT_MODE",),
    )  # fmt: skip
    _, err = ran(capsys, "--stop", "3", "--set", f"fault={EVENT}", "--engine", engine, status=4)
    assert "E213 plant: fmi3EnterEventMode of plant.fmu returned an error" in err
    assert "remove hasEventMode from its modelDescription.xml" in err


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_pending_step_of_which_the_fmu_does_not_tell_is_named(tmp_path: Path, engine: str) -> None:
    path = make(tmp_path, fmi=2, name="plant", defines=("REFUSES_STATUS",))
    diagram = Diagram.alone(fmu(path, fault=FAULTS.index("pending forever"), t_fault=0.2))
    said = r"E213 plant: fmi2GetStatus \(about a step that is pending\) of plant\.fmu returned"
    with pytest.raises(FMUError, match=said):
        diagram.run(stop=1, engine=engine)


def test_an_fmu_that_fails_before_its_first_row_has_no_results_that_are_kept(capsys: Printed, tmp_path: Path) -> None:
    make(tmp_path, fmi=3, kind="ME", name="plant", without=("fmi3GetContinuousStateDerivatives",))
    _, err = ran(capsys, "--stop", "1", status=4)
    assert "E208" in err
    assert "kept" not in err


def test_archives_are_named_where_a_diagram_is_meant(capsys: Printed, tmp_path: Path) -> None:
    plant(tmp_path)
    with zipfile.ZipFile(tmp_path / "system.ssp", "w") as archive:
        archive.writestr("SystemStructure.ssd", "<ssd/>")
    for words, said in {
        ("run", "plant.fmu"): "E001 plant.fmu:1:1: is an archive, for example an FMU, .* blocks fmu run X.fmu\\.",
        ("check", "plant.fmu"): "E001 plant.fmu:1:1: is an archive",
        ("run", "system.ssp"): "E001 system.ssp:1:1: is a package of SSP .* Unpack it",
        ("fmu", "run", "system.ssp"): "E202 system.ssp: it is a package of SSP .* Unpack it",
    }.items():
        assert main([*words]) != 0
        out, err = capsys.readouterr()
        assert re.search(said, out + err), out + err


MOTOR = str(FMUS / "PMDCMotor.fmu")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--set", "foo=2"], "E106 foo: the FMU has no such parameter. Parameters: Ra, La, kb, "),
        (["--set", "rA=2"], "Did you mean 'Ra'?"),
        (["--set", "omega=1"], "E106 omega: .* --set omega_start=..."),
        (["--set", "v=1"], "E106 v: .* --input v=..."),
        (["--start", "omega=1"], "E501 --start: .* --set omega_start=1."),
        (["--type", "ME"], "Did you mean '--kind'?"),
        (["--kind", "CS", "--step", "0.01"], "E115 run.step: .* --master step=0.01"),
    ],
)
def test_what_the_fmu_does_not_have_is_refused_with_what_is_meant(words: list[str], says: str, capsys: Printed) -> None:
    assert main(["fmu", "run", MOTOR, "--stop", "1", *words]) == 2
    assert re.search(says.replace("?", "[?]"), capsys.readouterr().err)


def test_an_element_of_an_array_is_set_by_its_name(capsys: Printed) -> None:
    decays = StateSpace(A=[[-1.0, 0.0], [0.0, -2.0]], B=[[0.0], [0.0]], C=[[1.0, 0.0], [0.0, 1.0]])
    Diagram.alone(decays).export("decays.fmu")
    assert main(["fmu", "run", "decays.fmu", "--stop", "1", "--set", "x_start[1]=5", "--out", "y.csv"]) == 0
    assert Results.load("y.csv")["y"][-1].tolist() == pytest.approx([0, 5 * math.exp(-2)], abs=1e-4)


def test_a_figure_shows_outputs_before_inputs(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert main(["fmu", "run", MOTOR, "--stop", "1", "--input", "v=6", "--plot", "x.svg"]) == 0
    text = (tmp_path / "x.svg").read_text(encoding="utf-8")
    assert text.index("omega") < text.index(">tau<") if ">tau<" in text else "omega" in text


def test_elements_of_fmi_2_are_wired_one_by_one(tmp_path: Path) -> None:
    inside = Diagram("vectors")
    gain = inside.add("gain", MatrixGain(K=[[1.0, 0.0], [0.0, 1.0]]))
    inside.wire(gain.u, inside.input("u", size=2, default=[1, 1]))
    inside.output("y", gain.y)
    inside.export("vectors.fmu", fmi=2)
    made = Diagram("ring")
    for name in "ab":
        made.add(name, fmu("vectors.fmu"))
    made.wire("a.u", "b.y")
    with pytest.raises(ModelError) as caught:
        made.check()
    assert "wire a.u[0], a.u[1]." in str(caught.value)
    assert "wire b.y[0], b.y[1]." in str(caught.value)
