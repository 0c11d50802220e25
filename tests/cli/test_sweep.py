"""`blocks sweep`: what is varied on the command line, its table, its objects, and how it is interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Distribution, LogUniform, Normal, Sweep, TruncatedNormal, Uniform, UsageError, each
from blocks.cli import main
from blocks.cli.sweep import scenarios_of, vary_of
from blocks.compile.toolchain.compiler import find_compiler
from tests.support.places import ROOT

MOTOR = str(ROOT / "diagrams" / "motor_pid.json")
NATIVE = pytest.mark.skipif(find_compiler() is None, reason="without a compiler each call begins processes")


def test_what_varies_is_read_from_words() -> None:
    words = [
        "a=1,2,3", "b=linspace:4,20,9", "c=geomspace:1,100,3", "d=normal:0.27,0.02", "e=uniform:-1,1",
        "f=loguniform:1,10", "g=truncatednormal:1,0.1,0.8,1.2", "h=lognorm:s=0.3,scale=2", "each(m_*.Ra)=uniform:1,2",
        "i=true,false", "j=[1,2],[3,4]", "k=150 mOhm,0.2", "l=rk4",
    ]  # fmt: skip
    vary = vary_of(words)
    assert vary.pop("b").tolist() == [4, 6, 8, 10, 12, 14, 16, 18, 20]
    np.testing.assert_allclose(vary.pop("c"), [1, 10, 100], rtol=1e-12)
    assert vary == {
        "a": [1.0, 2.0, 3.0], "d": Normal(0.27, 0.02), "e": Uniform(-1, 1), "f": LogUniform(1, 10),
        "g": TruncatedNormal(1, 0.1, 0.8, 1.2), "h": Distribution("lognorm", s=0.3, scale=2),
        each("m_*.Ra"): Uniform(1, 2), "i": [True, False], "j": [[1.0, 2.0], [3.0, 4.0]],
        "k": [{"value": 0.15 / 1e-3, "unit": "mOhm"}, 0.2], "l": ["rk4"],
    }  # fmt: skip


@pytest.mark.usefixtures("native")
def test_numbers_of_ranges_and_distributions_have_units(capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "a=normal:160 mOhm,10 mOhm", "b=normal:160 mOhm,0.01 Ohm", "c=truncatednormal:160 mOhm,10 mOhm,0 Ohm,inf",
        "d=lognorm:s=0.3,scale=160 mOhm", "e=linspace:100 mOhm,0.2 Ohm,3", "f=truncatednormal:1,2,-inf,3",
        "g=normal:20 degC,2 degC",
    ]  # fmt: skip
    assert vary_of(words) == {
        "a": Normal(160, 10).in_unit("mOhm"), "b": Normal(160, 10).in_unit("mOhm"),
        "c": TruncatedNormal(160, 10, 0).in_unit("mOhm"),
        "d": Distribution("lognorm", s=0.3, scale=160).in_unit("mOhm"),
        "e": [{"value": value, "unit": "mOhm"} for value in (100.0, 150.0, 200.0)],
        "f": TruncatedNormal(1, 2, -np.inf, 3), "g": Normal(20, 2).in_unit("degC"),
    }  # fmt: skip
    rows = ["--n", "3", "--seed", "5", "--measure", "ITAE", "--stop", "0.1", "--vary"]
    drawn = []
    for law in ("motor.Ra=normal:160 mOhm,10 mOhm", "motor.Ra=normal:0.16,0.01"):
        assert main(["sweep", MOTOR, *rows, law]) == 0
        drawn.append(next(line for line in capsys.readouterr().out.splitlines() if "motor.Ra" in line))
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("a", "E501 --vary a: is not NAME=VALUES"),
        ("a=normal:1", "is not normal:MEAN,DEVIATION"),
        ("a=linspace:1,2", "is not linspace:FROM,TO,COUNT"),
        ("a=geomspace:-1,2,3", "with numbers of one sign"),
        ("a=linspace:1,2,2.5", "is not linspace:FROM,TO,COUNT"),
        ("a=lognorm:0.3,2", "does not give values"),
        ("a=10:20:5", "E501 --vary a: '10:20:5' is neither a number nor .* Write a range as linspace:FROM,TO,COUNT"),
        ("a=normal:20,-2", "E501 --vary a: 'normal:20,-2' is not a distribution .*: the deviation -2 is not above 0"),
        ("a=uniform:30,10", "E501 --vary a: 'uniform:30,10' .*: 30 is not below 10. Give LOW before HIGH"),
        ("a=normal:1,200 mOhm", "'1' needs a unit, because others have one"),
        ("a=normal:1 Ohm,b", "'b' is not a number. Write a number in the unit of the parameter, or add a unit"),
        ("a=linspace:1 V,2 V,3 V", "'3 V' must be a number without a unit"),
        ("a=lognorm:s=0.3 V,scale=2 V", "'0.3 V' must be a number without a unit"),
        ("a=normal:20 degC,2 K", "degC and K have different zeros"),
        ("a=normal:1 rpm,1 Ohm", "E501 --vary a: Ohm and rpm are different quantities. Give all numbers in rpm"),
        ("a=1,,2", "E501 --vary a: '1,,2' has no value between two commas"),
        ("a=1,2,", "has no value after its last comma"),
        ("a=[1],,[2]", r"E501 --vary a: '\[1\],,\[2\]' is not a list of vectors"),
        ("a=@x.csv", "E501 --vary a: '@x.csv' is not a list of values: --vary reads no files"),
        ("a=1,two,3", "E501 --vary a: 'two' is a text, and other values are numbers"),
    ],
)
def test_words_that_say_nothing_are_refused(word: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        vary_of([word])
    with pytest.raises(UsageError, match="appears twice"):
        vary_of(["a=1", "a=2"])


def test_scenarios_are_read_from_words() -> None:
    words = ["quiet:", "heavy:load=2,pid.k=[1,2]", "heavy:torque=300 mN.m"]
    assert {name: list(given) for name, given in scenarios_of(words).items()} == {
        "quiet": [], "heavy": ["load", "pid.k", "torque"],
    }  # fmt: skip
    for word in ("noisy", "heavy torque=6", ":torque=6"):
        with pytest.raises(UsageError, match=f"--scenario {word}: is not NAME:SETTINGS. Example: "):
            scenarios_of([word])


def told(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, list[dict[str, Any]]]:
    status = main(["sweep", MOTOR, "--engine", "native", "--json", *words])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@NATIVE
def test_a_sweep_is_that_of_python(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "rows.parquet")
    words = ["--vary", "kp=linspace:10,20,2", "--vary", "motor.Ra=normal:0.16,0.1", "--n", "8", "--sampler", "sobol"]
    more = ["--seed", "1", "--measure", "ITAE", "--log", "motor.omega", "--scenario", "quiet:", "--out", out]
    status, entries = told(capsys, *words, *more, "--scenario", "heavy:torque=6")
    assert status == 0
    sweep = Diagram.load(MOTOR).sweep(
        {"kp": [10, 20], "motor.Ra": Normal(0.16, 0.1)}, n=8, sampler="sobol", seed=1, measures=["ITAE"],
        log=["motor.omega"], scenarios={"quiet": {}, "heavy": {"torque": 6}}, engine="native",
    )  # fmt: skip
    np.testing.assert_array_equal(Sweep.load(out).measures["ITAE"], sweep.measures["ITAE"])
    heavy = next(entry for entry in entries if entry.get("scenario") == "heavy")
    assert heavy["quantiles"]["ITAE"] == sweep["heavy"].quantiles()["ITAE"].tolist()
    assert entries[-1]["event"] == "done"
    assert entries[-1]["counts"] == sweep.counts()


@NATIVE
def test_rows_go_to_a_csv_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rows.csv"
    assert told(capsys, "--vary", "kp=10,20", "--measure", "ITAE", "--out", str(out))[0] == 0
    head, *rows = [line.split(",") for line in out.read_text().splitlines()]
    assert head == ["number", "status", "kp", "ITAE", "message", "steps", "seed"]
    for row, kp in zip(rows, (10, 20), strict=True):
        run = Diagram.load(MOTOR).run(parameters={"kp": kp}, engine="native")
        assert (row[1], float(row[2]), float(row[3])) == ("ok", kp, run.measures["ITAE"])
    status, _ = told(capsys, "--vary", "kp=10,20", "--out", str(tmp_path / "rows.xlsx"))
    assert status == 2


@NATIVE
def test_bands_are_drawn_and_formats_are_checked_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = tmp_path / "bands.png"
    words = ["--vary", "kp=uniform:10,20", "--n", "8", "--log", "motor.omega"]
    assert told(capsys, *words, "--plot", str(figure))[0] == 0
    assert figure.read_bytes().startswith(b"\x89PNG")
    status, entries = told(capsys, *words, "--plot", str(tmp_path / "bands.doc"))
    assert (status, entries[0]["code"]) == (2, "E501")


@NATIVE
def test_a_sweep_without_a_row_that_ran_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    status, entries = told(capsys, "--vary", "motor.Ra=-1,-2")
    assert status == 3
    assert entries[-1]["counts"] == {"refused": 2}
    status, entries = told(capsys, "--vary", "motor.Ra=normal:1,0.1", "--n", "3", "--sampler", "sobol", "--stop", "1")
    assert entries[0]["code"] == "W503"
    status, entries = told(capsys, "--vary", "motor.Ra=1", "--n", "1.5")
    assert (status, entries[0]["place"]) == (2, "--n")
    status, entries = told(capsys, "--vary", "kp=normal:1,0.1")
    assert [entries[0][key] for key in ("place", "cure")] == ["--n", "Example: --n 1000."]
    assert told(capsys, "--vary", "kp=1", "--log", "nope")[1][0]["place"] == "--log"


@NATIVE
@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_keeps_what_is_done_and_the_same_command_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "rows.parquet"
    words = [sys.executable, "-m", "blocks", "sweep", MOTOR, "--vary", "kp=uniform:10,20", "--n", "250"]
    words += ["--engine", "native", "--set", "control.Tf=0.01", "--out", str(out)]
    run = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    part = Path(f"{out}.part")
    while time.monotonic() < deadline and not (part.exists() and part.stat().st_size):
        time.sleep(0.02)
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 130, stderr
    assert "left" in stdout
    assert f"the same command goes on from {out}.part" in stderr
    half = Sweep.load(out)
    assert half.interrupted
    again = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert again.returncode == 0, again.stderr
    assert "rows are there already" in again.stderr
    whole = Sweep.load(out)
    assert whole.counts() == {"ok": 250}
    done = half.status == "ok"
    np.testing.assert_array_equal(half.measures["ITAE"][done], whole.measures["ITAE"][done])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["sweep", MOTOR, "--vary", "kp=1,2", "--anew"], "E501 blocks sweep: --anew is now --restart."),
        (["sweep", MOTOR, "--vary", "kp=1,2", "--budget", "9"], "E501 blocks sweep: --budget is now --max-steps."),
        (
            ["tune", MOTOR, "--minimize", "ITAE", "--over", "kp=1,2", "--anew"],
            "E501 blocks tune: --anew is now --restart.",
        ),
        (
            ["tune", MOTOR, "--minimize", "ITAE", "--over", "kp=1,2", "--method", "de"],
            'E501 --method: "de" is an optimizer, and method integrates the runs. Write --optimizer de.',
        ),
    ],
)
def test_options_that_have_another_name_now_say_so(words: list[str], message: str, capsys: Any) -> None:
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(message)
