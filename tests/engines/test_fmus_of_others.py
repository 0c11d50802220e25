"""What FMUs of other tools do within the standard, and what a run makes of it; in both engines.

The FMU is the integrator of support/faulty, x' = k u with y = x + d u, whose values are known in closed form; its
description is changed as other tools write it.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Constant, Diagram, Integrator, Sum, fmu
from blocks.cli import main
from blocks.results.results import Results
from blocks.text.errors import FMUError, ModelError, UsageError
from tests.support.faulty import FAULTS, NEEDS_COMPILER, make
from tests.support.marks import long

pytestmark = NEEDS_COMPILER

EACH = pytest.mark.parametrize("engine", ["reference", "native"])
KINDS = pytest.mark.parametrize("kind", ["CS", "ME"])
BOTH = pytest.mark.parametrize("fmi", [2, 3])
MOSTLY_3 = pytest.mark.parametrize("fmi", [long(2), 3])  # what both versions share
STOP = 1.0  # s


def described(folder: Path, fmi: int, kind: str, *replaced: tuple[str, str], **options: Any) -> Path:
    """The FMU with another description. replaced: patterns and what stands in their places."""
    path = make(folder, fmi=fmi, kind=kind, **options)
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = files["modelDescription.xml"].decode()
    for pattern, new in replaced:
        text, count = re.subn(pattern, new, text)
        assert count == 1, pattern
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {**files, "modelDescription.xml": text.encode()}.items():
            archive.writestr(name, data)
    return path


def start_of(name: str, old: str, new: str) -> tuple[str, str]:
    """A replacement of the start value of a variable."""
    return rf'(name="{name}"[^/]*? )start="{old}"', rf"\1{new}"


def driven(path: Path, kind: str, u: float = 1.0, **given: Any) -> Diagram:
    """The FMU with a constant at its input."""
    made = Diagram("driven")
    source, plant = made.add("source", Constant(value=u)), made.add("plant", fmu(path, kind, **given))
    made.wire(plant.u, source.y)
    return made


def run(diagram: Diagram, engine: str, **settings: Any) -> Results:
    return diagram.run(engine=engine, **{"stop": STOP, "log": ["plant.y"], **settings})


# --- start values that are not finite, or not there ----


@EACH
@KINDS
@MOSTLY_3
@pytest.mark.parametrize("text", ['start="INF"', ""])
def test_what_the_description_cannot_say_the_fmu_keeps_unless_it_is_given(
    text: str, fmi: int, kind: str, engine: str, tmp_path: Path
) -> None:
    changed = [start_of("k", "1", text)]
    if text:
        changed += [start_of("x", "0", 'start="-INF"'), start_of("t_fault", "1", 'start="NaN"')]
        changed += [start_of("d", "0", 'start="0" min="-INF" max="INF"')]
    path = described(tmp_path, fmi, kind, *changed)
    for k, x in ((None, None), (0.0, None), (3.0, 2.0 if text else None)):
        given = {name: value for name, value in (("k", k), ("x_start", x)) if value is not None}
        y = run(driven(path, kind, d=5.0, **given), engine)["plant.y"][-1]
        expected = (0.0 if x is None else x) + (1.0 if k is None else k) * STOP + 5.0
        assert y == pytest.approx(expected, rel=1e-9)


@KINDS
def test_an_input_whose_start_is_not_finite_must_be_wired(kind: str, tmp_path: Path) -> None:
    path = described(tmp_path, 3, kind, start_of("u", "0", 'start="INF"'))
    loose = Diagram("loose")
    loose.add("plant", fmu(path, kind))
    with pytest.raises(ModelError, match=r"E101 plant\.u"):
        loose.check()
    assert run(driven(path, kind, u=2.0), "reference")["plant.y"][-1] == pytest.approx(2.0 * STOP)


def test_what_is_in_such_an_fmu_is_told_as_text_and_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = described(tmp_path, 3, "CS", start_of("k", "1", 'start="INF"'))
    assert main(["fmu", "info", str(path)]) == 0
    assert re.search(r"^  k +inf$", capsys.readouterr().out, re.MULTILINE)
    assert main(["fmu", "info", "--json", str(path)]) == 0  # the start of a Binary stands in it too
    assert '"name": "k"' in capsys.readouterr().out


# --- what an FMU does as it hears of the run ----


@EACH
@KINDS
def test_values_are_set_after_the_call_that_puts_them_back(kind: str, engine: str, tmp_path: Path) -> None:
    """20-sim's FMUs begin anew in fmi2SetupExperiment."""
    path = make(tmp_path, fmi=2, kind=kind, defines=("STARTS_ANEW",))
    y = run(driven(path, kind, k=3.0, x_start=2.0), engine)["plant.y"][-1]
    assert y == pytest.approx(2.0 + 3.0 * STOP, rel=1e-9)


# --- the tolerance of the solver inside ----


@EACH
@BOTH
def test_a_solver_inside_is_told_the_tolerance_that_the_fmu_declares_unless_another_is_given(
    fmi: int, engine: str, tmp_path: Path
) -> None:
    declared = ("<ModelVariables>", '<DefaultExperiment tolerance="1e-4"/><ModelVariables>')
    defines = ("TELLS_TOLERANCE",)
    says = described(tmp_path, fmi, "CS", declared, name="says", defines=defines)
    silent = described(tmp_path, fmi, "CS", name="silent", defines=defines)
    fixed = {"method": "rk4", "step": 0.1}
    for path, settings, told in (
        (says, {}, 1e-4),
        (says, fixed, 1e-4),
        (says, {"rtol": 1e-7}, 1e-7),
        (says, {**fixed, "rtol": 1e-7}, 1e-7),
        (silent, {}, -1.0),  # none
        (silent, {"rtol": 1e-7}, 1e-7),
        (silent, fixed, -1.0),
    ):
        assert run(driven(path, "CS"), engine, **settings)["plant.y"][0] == told, (path.name, settings)


def test_info_check_and_run_agree_on_the_tolerance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    declared = ("<ModelVariables>", '<DefaultExperiment tolerance="1e-4"/><ModelVariables>')
    path = described(tmp_path, 3, "CS", declared, defines=("TELLS_TOLERANCE",))
    made = driven(path, "CS")
    made.settings(stop=1, log=["plant.y"])
    made.save(tmp_path / "driven.json")
    file = str(tmp_path / "driven.json")
    assert main(["fmu", "info", str(path)]) == 0
    assert "meant to be run with: tolerance 0.0001" in capsys.readouterr().out
    assert main(["check", file]) == 0
    assert re.search(r"plant \(FMI 3\): .*; its own tolerance, 0\.0001$", capsys.readouterr().out, re.MULTILINE)
    cases = ([], "(dopri5, rtol 1e-06; FMUs 0.0001)", 1e-4), (["--rtol", "1e-5"], "(dopri5, rtol 1e-05)", 1e-5)
    for words, told, value in cases:
        assert main(["run", file, *words, "-o", str(tmp_path / "rows.csv")]) == 0
        assert told in capsys.readouterr().out
        rows = [line.split(",") for line in (tmp_path / "rows.csv").read_text().splitlines() if line[0].isdigit()]
        assert float(rows[0][1]) == value


# --- an FMU that ends the run ----


def ending(path: Path, kind: str, t: float) -> Diagram:
    """The FMU, which ends the run at t, in a loop with blocks: x' = 1 - z and z' = x: x = sin t and z = 1 - cos t."""
    made = Diagram("ending")
    error = made.add("error", Sum(signs="+-"))
    one, z = made.add("one", Constant(value=1.0)), made.add("z", Integrator())
    plant = made.add("plant", fmu(path, kind, parameters={"fault": FAULTS.index("terminate"), "t_fault": t}))
    made.wire(error.u1, one.y)
    made.wire(error.u2, z.y)
    made.wire(plant.u, error.y)
    made.wire(z.u, plant.y)
    return made


@EACH
@MOSTLY_3
@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "iterated", "controlled"])
@pytest.mark.parametrize("t", [long(0.5), 0.4567])
def test_an_fmu_that_ends_the_run_ends_it_well(t: float, algorithm: str, fmi: int, engine: str, tmp_path: Path) -> None:
    path = make(tmp_path, fmi=fmi)
    master: dict[str, Any] = {"step": 0.01, "order": fmi - 2}  # the FMU of FMI 2 takes no derivatives right
    master |= {"tolerance": 1e-2} if algorithm == "controlled" else {"algorithm": algorithm}
    for every in (None, 0.1):
        under_way = ending(path, "CS", t).start(
            stop=1, every=every, log=["plant.y", "z.y"], engine=engine, master=master
        )  # fmt: skip
        results = under_way.finish()
        (told,) = results.warnings
        assert (told.code, told.place) == ("W206", "plant")
        assert told.message.startswith(f"faulty.fmu ended the run at t = {t:.10g} s.")
        assert "\n" not in str(told)
        assert results.t[-1] == under_way.t == pytest.approx(t, abs=1e-12)
        assert list(results.t) == sorted(results.t)
        assert results["plant.y"][-1] == pytest.approx(np.sin(t), abs=0.02)
        assert results["z.y"][-1] == pytest.approx(1 - np.cos(t), abs=0.02)
        with pytest.raises(UsageError, match=r"E501 ending: the run is over"):
            under_way.advance(0.1)


@BOTH
@KINDS
def test_both_engines_end_a_run_with_the_same_rows(kind: str, fmi: int, tmp_path: Path) -> None:
    path = make(tmp_path, fmi=fmi, kind=kind)
    for t in (0.5, 0.4567):
        found = []
        for engine in ("reference", "native"):
            alone = driven(path, kind, parameters={"fault": FAULTS.index("terminate"), "t_fault": t})
            settings = {"method": "rk4", "step": 0.01, "every": 0.1, "master": {"step": 0.01, "order": 0}}
            results = run(alone, engine, **settings)
            found.append((results.t.tolist(), tuple(map(str, results.warnings))))
            assert results["plant.y"] == pytest.approx(results.t, abs=1e-9)  # x' = 1
            # One for Model Exchange says so at the end of the step in which it was.
            assert results.t[-1] == pytest.approx(t if kind == "CS" else np.ceil(100 * t) / 100, abs=1e-12)
        assert found[0] == found[1]


@EACH
@BOTH
def test_an_fmu_ends_the_run_in_an_event_and_at_the_start(fmi: int, engine: str, tmp_path: Path) -> None:
    # Behind the half of its step, where it asks for inputs and would look at its event too late.
    for t, kind in ((0.4567, "ME"), (0.0, "ME"), (0.4577, "CS"), (0.0, "CS"))[: 2 if fmi == 2 else None]:
        path = make(tmp_path, fmi=fmi, kind=kind, defines=("ENDS_AT_EVENTS",))
        given = {"fault": FAULTS.index("terminate"), "t_fault": t}
        results = run(driven(path, kind, d=5.0, parameters=given), engine, every=0.1)
        assert results.t[-1] == pytest.approx(t, abs=1e-12)
        assert len(results.t) == (1 if t == 0 else 6)
        assert results["plant.y"] == pytest.approx(results.t + 5.0, abs=1e-9)  # x' = 1, y = x + 5 u
        (told,) = [warning for warning in results.warnings if warning.code != "W211"]
        assert told.message.startswith(f"faulty.fmu ended the run at t = {t:g} s.")


@EACH
def test_fmus_for_both_kinds_in_one_run_end_it_well(engine: str, tmp_path: Path) -> None:
    """Of Model Exchange, in a run of which it is a part, the rows go to the last communication point."""
    stepped, asked = make(tmp_path, fmi=3, name="cs"), make(tmp_path, fmi=3, kind="ME", name="me")
    made = ending(asked, "ME", 0.45)
    other = made.add("other", fmu(stepped, "CS"))
    made.wire(other.u, "plant.y")
    results = made.run(stop=1, log=["plant.y"], engine=engine, master={"step": 0.1, "order": 0})
    assert results.t[-1] == pytest.approx(0.4)
    (told,) = [warning for warning in results.warnings if warning.code == "W206"]
    assert told.place == "plant"


@EACH
@BOTH
def test_the_command_line_says_in_one_line_that_an_fmu_ended_the_run(
    fmi: int, engine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ("CS", "ME"):
        path = make(tmp_path, fmi=fmi, kind=kind)
        made = driven(path, kind, parameters={"fault": FAULTS.index("terminate"), "t_fault": 0.5})
        made.save(tmp_path / "driven.json")
        words = ["--stop", "1", "--method", "rk4", "--step", "0.1", "-o", str(tmp_path / "rows.csv")]
        words += ["--log", "plant.y", "--engine", engine] + (["--master", "step=0.1"] if kind == "CS" else [])
        assert main(["run", str(tmp_path / "driven.json"), *words]) == 0
        told = capsys.readouterr()
        (line,) = [line for line in told.err.splitlines() if "W206" in line]
        assert re.match(r"W206 plant: faulty\.fmu ended the run at t = 0\.5 s\.", line)
        assert "0 ... 0.5 s" in told.out
        assert (tmp_path / "rows.csv").read_text().splitlines()[-1].startswith("0.5,0.")


# --- derivatives of inputs that an FMU refuses ----


def curved(path: Path, engine: str) -> Results:
    """The FMU with a parabola at its input, by order 2 in steps of 1 s, for which its derivatives are right."""
    made = Diagram("curved")
    one, line, curve = (made.add(name, block) for name, block in (
        ("one", Constant(value=1.0)), ("line", Integrator(y_start=1.0)), ("curve", Integrator(y_start=1.0)),
    ))  # fmt: skip
    plant = made.add("plant", fmu(path, "CS"))
    made.wire(line.u, one.y)
    made.wire(curve.u, line.y)
    made.wire(plant.u, curve.y)
    return run(made, engine, stop=8, master={"step": 1.0, "order": 2})


@EACH
@pytest.mark.parametrize("lacks", [False, True])
def test_derivatives_that_an_fmu_refuses_are_of_the_next_lower_order(lacks: bool, engine: str, tmp_path: Path) -> None:
    """Truths: the FMU without refusals, which makes nothing of order 2; and one that says that it takes none."""
    whole = make(tmp_path, fmi=2, name="whole")
    none = described(tmp_path, 2, "CS", ('canInterpolateInputs="true"', 'canInterpolateInputs="false"'), name="none")
    line = make(tmp_path, fmi=2, name="line", defines=("TAKES_ORDER=1",))
    if lacks:
        mean = make(tmp_path, fmi=2, name="mean", without=("fmi2SetRealInputDerivatives",))
    else:
        mean = make(tmp_path, fmi=2, name="mean", defines=("TAKES_ORDER=0",))
    begin = "it refuses input derivatives of order"
    for path, truth, told in (
        (line, whole, f"{begin} 2; from here on its inputs go in as straight lines: "),
        (mean, none, f"{begin} 1; from here on its inputs go in by their mean over each step: "),
    ):
        found, expected = curved(path, engine), curved(truth, engine)
        assert np.array_equal(found.values, expected.values)
        assert not expected.warnings
        (warning,) = found.warnings  # once
        assert (warning.code, warning.place) == ("W207", "plant")
        assert warning.message.startswith(told)
        if not lacks or path is line:
            assert f"order {1 + (path is line)} is not supported" in warning.message
        assert warning.cure == f"Set --master order={int(path is line)} to request none."


def test_both_engines_say_the_same_of_what_an_fmu_refuses(tmp_path: Path) -> None:
    for order in (0, 1):
        path = make(tmp_path, fmi=2, name=f"takes{order}", defines=(f"TAKES_ORDER={order}",))
        reference, native = (curved(path, engine) for engine in ("reference", "native"))
        assert reference.warnings == native.warnings
        assert np.allclose(reference.values, native.values, rtol=1e-9)


# --- what failed before the start ----


@EACH
@KINDS
@BOTH
def test_what_fails_in_initialization_is_not_mended_by_smaller_steps(
    fmi: int, kind: str, engine: str, tmp_path: Path
) -> None:
    path = make(tmp_path, fmi=fmi, kind=kind, defines=("FAILS_TO_BEGIN",))
    with pytest.raises(FMUError) as caught:
        run(driven(path, kind), engine)
    (fault,) = caught.value.faults
    assert fault.code == "E213"
    assert f"fmi{fmi}ExitInitializationMode of faulty.fmu returned an error at t = 0 s." in fault.message
    assert "no start values" in fault.message
    assert "Its initialization failed." in fault.message
    told = "Other parameters or start values may help."
    assert fault.cure.startswith(told)


@EACH
@BOTH
def test_what_fails_later_may_be_mended_by_smaller_steps(fmi: int, engine: str, tmp_path: Path) -> None:
    for kind, fault in (("CS", "error"), ("ME", "error in rates")):
        path = make(tmp_path, fmi=fmi, kind=kind)
        given = {"fault": FAULTS.index(fault), "t_fault": 0.5}
        with pytest.raises(FMUError, match=r"E213 .*Smaller steps or other values may help"):
            run(driven(path, kind, parameters=given), engine)


# --- outputs that follow only the ends of steps ----


@EACH
@BOTH
def test_an_output_that_follows_only_where_steps_end_is_told(fmi: int, engine: str, tmp_path: Path) -> None:
    settings = {"method": "rk4", "step": 0.1, "every": 0.05}
    late = run(driven(make(tmp_path, fmi=fmi, kind="ME", name="late", defines=("LAGS",)), "ME"), engine, **settings)
    (told,) = late.warnings
    assert (told.code, told.place) == ("W208", "plant")
    assert told.message.startswith("y of late.fmu is computed only at the ends of steps")
    # x' = 1 and y = x: right where steps end, late between.
    assert late["plant.y"][::2] == pytest.approx(late.t[::2], abs=1e-12)
    assert late["plant.y"][1::2] == pytest.approx(late.t[1::2] - 0.05, abs=1e-12)
    whole = run(driven(make(tmp_path, fmi=fmi, kind="ME", name="whole"), "ME"), engine, **settings)
    assert not whole.warnings
    assert whole["plant.y"] == pytest.approx(whole.t, abs=1e-12)
