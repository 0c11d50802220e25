"""The command line: output, exit codes, and what stays behind after a failure."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Results, __version__
from blocks.cli import main
from blocks.cli.output import Excerpts
from blocks.model.document import from_document
from blocks.model.fingerprint import fingerprint
from blocks.text.errors import Fault, ModelError
from blocks.text.quantity_text import value_in
from tests.support.places import ROOT

DIAGRAMS = ROOT / "diagrams"
BALL = str(DIAGRAMS / "bouncing_ball.json")
MOTOR = str(DIAGRAMS / "motor_pid.json")


def write(path: Path, **parts: Any) -> str:
    path.write_text(
        json.dumps({"format": "blocks-diagram", "version": 3, "name": path.stem, **parts}), encoding="utf-8"
    )
    return str(path)


def rows_of(path: Path) -> list[list[str]]:
    """The header and the rows of a result file, without its comments."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.reader(line for line in lines if not line.startswith("#")))


def test_run_prints_a_table_with_spark_lines_and_measures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", MOTOR]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^motor_pid  dopri5 rtol 1e-06 atol 1e-09  reference  0 ... 10 s$", out, re.MULTILINE)
    assert re.search(r"motor\.omega +rad/s +0 +2\.03\d* +2\.000\d* +[▁▂▃▄▅▆▇█]{10}", out)
    assert "settling_time" in out


def test_run_with_json_ends_with_one_line_that_holds_everything(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("blocks.cli.output.SOON", math.inf)  # a busy machine shows no progress
    assert main(["run", MOTOR, "--json"]) == 0
    captured = capsys.readouterr()
    done = json.loads(captured.out.splitlines()[-1])
    assert done["event"] == "done"
    assert done["t"] == 10.0
    assert done["steps"] > 50
    assert done["seconds"] > 0
    assert done["signals"]["motor.omega"]["unit"] == "rad/s"
    assert set(done["signals"]["motor.omega"]) == {"unit", "min", "max", "end"}
    assert set(done["measures"]) == {"overshoot", "settling_time", "dip", "ITAE"}
    assert captured.err == ""


def test_json_has_null_where_a_measure_has_no_value(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", MOTOR, "--json", "--stop", "5"]) == 0
    *warnings, done = map(json.loads, capsys.readouterr().out.splitlines())
    assert done["measures"]["dip"] is None
    assert {"event": "fault", "code": "W301", "place": "measures.dip"}.items() <= warnings[-1].items()


LOG = ["--log", "motor.omega", "--log", "speed.y"]


def test_out_writes_time_and_every_recorded_element(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "x.csv"
    assert main(["run", MOTOR, "--out", str(target), "--every", "0.5", "--jumps", *LOG]) == 0
    assert target.read_text(encoding="utf-8").startswith("# blocks results 1\n")
    rows = rows_of(target)
    assert rows[0] == ["time", "motor.omega", "speed.y"]
    assert [float(row[0]) for row in rows[1:4]] == [0.0, 0.5, 1.0]
    assert rows[3][2] == "0.0"
    assert rows[4] == [rows[3][0], rows[3][1], "2.0"], "a jump stands as two rows of one time"
    assert os.listdir(tmp_path) == ["x.csv"]
    assert main(["run", MOTOR, "--out", str(target), "--every", "0.5", *LOG]) == 0
    assert rows_of(target)[1:] == [rows[1], rows[2], *rows[4:]], "unless jumps are asked for, its value after is enough"
    capsys.readouterr()


def test_set_takes_numbers_units_and_paths(capsys: pytest.CaptureFixture[str]) -> None:
    ends = []
    for options in (["--set", "motor.Ra=2"], ["--set", "motor.Ra=2000 mOhm"], []):
        assert main(["run", MOTOR, "--json", "--stop", "3", *options]) == 0
        done = json.loads(capsys.readouterr().out.splitlines()[-1])  # after W301: the windows of measures end later
        ends.append(done["signals"]["motor.i"]["max"])
    assert ends[0] == ends[1] != ends[2]


@pytest.mark.parametrize(
    ("text", "value"),
    [("2", 2.0), ("+1", 1.0), (".5", 0.5), ("1.", 1.0), ("-1e-3", -1e-3), ("007", 7.0),
     ("true", True), ("fhan", "fhan"),
     ("[1, 2]", [1.0, 2.0]), ("=a", "=a")],
)  # fmt: skip
def test_values_on_the_command_line(text: str, value: Any) -> None:
    assert value_in(text) == value


@pytest.mark.parametrize("text", ["200 mOhm", "200mOhm", " 200  mOhm "])
def test_values_with_units_on_the_command_line(text: str) -> None:
    assert value_in(text) == {"value": 200.0, "unit": "mOhm"}


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--set", "motor.Rx=1"], "E106", "motor.Ra"),
        (["--set", "motor.Ra"], "E501", "NAME=VALUE"),
        (["--set", "control.kp=1"], "E117", "Set the parameters that it is computed from"),
        (["--set", "motor.Ra=2 V"], "E104", "different quantities"),
        (["--set", "motor.Ra=much"], "E107", "number"),
        (["--set", "motor.Ra=1 furlong"], "E114", "furlong"),
        (["--set", "motor.Ra=1,5"], "E501", "Write 1.5, or [1,5] for several values."),
        (["--set", "motor.Ra=1,5 Ohm"], "E501", "the decimal separator is a point. Write 1.5 Ohm."),
        (["--set", "motor.Ra=1,2,3"], "E501", "Write [1,2,3] for several values."),
        (["--stop", "1,5"], "E501", "--stop: '1,5' is not a number: the decimal separator is a point. Write 1.5."),
        (["--method", "rk5"], "E115", "rk4"),
        (["--method", "rk4"], "E115", "--step"),
        (["--step", "0.1"], "E115", "dopri5"),
        (["--stop", "soon"], "E501", "--stop"),
        (["--stop", "-1"], "E115", "stop"),
        (["--rtol", "2"], "E115", "rtol"),
        (["--every", "0"], "E115", "every"),
        (["--log", "motor.omga"], "E105", "motor.omega"),
        (["--input", "nothing.csv"], "E502", "nothing.csv"),
        (["--library", "no_such_module"], "E501", "no_such_module"),
        (["--out", "no/such/folder/x.csv"], "E501", "Nothing was run"),
        (
            ["--out", "x.txt"],
            "E501",
            "x.txt: the ending '.txt' is not a format of result files. Use .csv, .parquet or .mat.",
        ),
        (["--plot", "x.jpg"], "E501", "x.jpg: the ending '.jpg' is not a format of pictures. Use .svg, .png or .pdf."),
        (["--plot", "x"], "E501", "x: a name without ending is not a format of pictures. Use .svg, .png or .pdf."),
        (
            ["--plot", "no/such/folder/x.svg"],
            "E501",
            "--plot no/such/folder/x.svg: the folder no/such/folder does not exist",
        ),
    ],
)
def test_what_cannot_be_meant_is_told_with_a_cure(
    options: list[str],
    code: str,
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", MOTOR, *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(code)
    assert said in captured.err
    assert os.listdir(tmp_path) == []


def test_a_missing_file_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(DIAGRAMS / "motor_pdi.json")]) == 2
    err = capsys.readouterr().err
    assert "E007" in err
    assert "motor_pid.json" in err


def test_a_numerical_failure_keeps_what_was_computed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # y' = y^2 from 1: y = 1/(1 - t) escapes at t = 1.
    path = write(
        tmp_path / "escape.json",
        blocks={"square": {"type": "Product"}, "y": {"type": "Integrator", "parameters": {"y_start": 1}}},
        wires={"square.u1": "y.y", "square.u2": "y.y", "y.u": "square.y"},
        run={"stop": 2, "every": 0.1},
    )
    target = tmp_path / "out.csv"
    assert main(["run", path, "--json", "--out", str(target)]) == 3
    captured = capsys.readouterr()
    assert re.search(r"^E30[13] ", captured.err, re.MULTILINE)  # progress may come before
    assert "are kept" in captured.err
    fault, done = (json.loads(line) for line in captured.out.splitlines())
    assert fault["code"] in captured.err
    assert 0.9 <= done["t"] <= 1.0 + 1e-9
    rows = rows_of(target)
    row = next(row for row in rows[1:] if row[0] == "0.9")
    assert float(row[rows[0].index("y.y")]) == pytest.approx(10.0, rel=1e-4)


@pytest.mark.skipif(os.name == "nt", reason="Windows sends Ctrl-C to whole consoles")
def test_ctrl_c_keeps_what_was_computed(tmp_path: Path) -> None:
    path = write(
        tmp_path / "long.json",
        blocks={"wave": {"type": "Sine", "parameters": {"omega": 100}}, "y": {"type": "Integrator"}},
        wires={"y.u": "wave.y"},
        run={"stop": 6000, "every": 1, "method": "euler", "step": 0.03},
    )
    target = tmp_path / "out.csv"
    process = subprocess.Popen(
        [sys.executable, "-m", "blocks", "run", path, "--json", "--out", str(target), "--engine", "reference"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    assert process.stderr is not None
    begun = process.stderr.readline()  # it tells how far it is
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    done = json.loads(out.splitlines()[-1])
    assert done["interrupted"] is True
    assert 0 < done["t"] < 6000
    err = begun + err
    assert "interrupted at t" in err
    rows = rows_of(target)
    assert float(rows[-1][0]) == done["t"]
    assert sorted(os.listdir(tmp_path)) == ["long.json", "out.csv"]


def test_input_files_feed_the_inputs_of_a_diagram(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "follow.json",
        inputs={"r": {"unit": "m"}},
        blocks={"y": {"type": "Integrator"}},
        wires={"y.u": "r"},
        run={"stop": 2},
    )
    table = tmp_path / "r.csv"
    table.write_text("time,r\n0,0\n1,1\n2,0\n", encoding="utf-8")
    for options, end in (([], 1.0), (["--hold"], 1.0), (["--hold", "--stop", "1"], 0.0), (["--stop", "1"], 0.5)):
        assert main(["run", path, "--json", "--input", str(table), *options]) == 0
        assert json.loads(capsys.readouterr().out)["signals"]["y.y"]["end"] == pytest.approx(end, abs=1e-9)
    assert main(["run", path]) == 2
    assert "E502 r: the input has no value" in capsys.readouterr().err


def test_check_tells_order_and_rates(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DIAGRAMS / "sampled_loop.json")]) == 0
    out = capsys.readouterr().out
    assert "2 rates (continuous, 0.1 s)" in out
    assert "order: " in out
    assert "no algebraic loop" in out
    assert out.endswith("0 errors, 0 warnings\n")


def test_check_tells_all_faults_with_their_places(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "broken.json"
    path.write_text(
        '{"format": "blocks-diagram", "version": 3, "name": "broken",\n'
        ' "blocks": {"a": {"type": "Gain"},\n'
        '            "b": {"type": "Gian"}},\n'
        ' "wires": {"a.x": "b.y"}}\n',
        encoding="utf-8",
    )
    assert main(["check", str(path)]) == 2
    out = capsys.readouterr().out
    assert "E103" in out
    assert f"{path}:3:" in out
    assert "Did you mean 'Gain'?" in out
    assert "E105" in out
    assert main(["check", str(path), "--json"]) == 2
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1] == {"event": "done", "file": str(path), "errors": len(lines) - 1, "warnings": 0}
    assert {"code", "place", "message", "cure", "line", "column"} <= set(lines[0])


def test_check_shows_an_algebraic_loop_edge_by_edge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "loop.json",
        inputs={"r": {"default": 1}},
        blocks={"sum": {"type": "Sum", "parameters": {"signs": "+-"}}, "gain": {"type": "Gain"}},
        wires={"sum.u1": "r", "sum.u2": "gain.y", "gain.u": "sum.y"},
    )
    assert main(["check", path]) == 2
    out = capsys.readouterr().out
    assert "E102" in out
    assert "sum.y -> gain.y -> sum.y" in out or "gain.y -> sum.y -> gain.y" in out


def test_list_says_that_adrc_is_a_function(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "ADRC"]) == 2
    told = capsys.readouterr().err
    assert "is a function that makes a diagram" in told
    assert "`blocks new FILE --adrc`" in told


def test_list_names_every_block_and_tells_about_one(capsys: pytest.CaptureFixture[str]) -> None:
    from blocks.library import LIBRARY

    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in LIBRARY)
    for name in LIBRARY:
        assert main(["list", name]) == 0
        assert capsys.readouterr().out.startswith(f"{name}: ")
        assert main(["list", name, "--json"]) == 0
        entry = json.loads(capsys.readouterr().out)
        assert entry["type"] == name
        assert all(p["doc"] for p in (*entry["parameters"], *entry["inputs"], *entry["outputs"]))
    assert main(["list", "Gian"]) == 2
    assert "Did you mean 'Gain'?" in capsys.readouterr().err
    assert main(["list", "measures"]) == 0
    assert "ITAE" in capsys.readouterr().out
    assert main(["list", "logic"]) == 0
    out = capsys.readouterr().out
    assert "SwitchAbove" in out
    assert "Gain" not in out


def test_list_finds_types_by_what_they_say_and_by_the_words_of_simulink(capsys: pytest.CaptureFixture[str]) -> None:
    from blocks.api.catalog import words
    from blocks.library import LIBRARY

    assert all(set(word.blocks) <= set(LIBRARY) for word in words().values())
    searches = [("rate limit", "RateLimiter"), ("bandwidth observer", "LESO"), ("white noise", "Noise")]
    for text, first in [*searches, ("dead time", "TransportDelay")]:
        assert main(["list", "--search", text]) == 0
        assert first in capsys.readouterr().out.split()[:8], text
    assert main(["list", "to workspace"]) == 0
    assert capsys.readouterr().out.startswith("Simulink's To Workspace: No block: name the signals by `log`")
    assert main(["list", "Scope", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["simulink"] == "Scope"
    assert main(["list", "--search", "scope"]) == 0
    assert "Simulink's Scope: No block" in capsys.readouterr().out
    assert main(["list", "--search", "state machine"]) == 0
    assert "documentation: cookbook.md#a-state-machine" in capsys.readouterr().out
    for wrong in (["--search", "zzz"], ["--search", " "], ["Gain", "--search", "gain"]):
        assert main(["list", *wrong]) == 2
        assert capsys.readouterr().err.startswith(f"E501 --search {wrong[-1]}".strip())


def test_control_characters_in_names_do_not_reach_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "evil.json", blocks={"a": {"type": "Ga\x1b[31min"}})
    assert main(["check", path]) == 2
    captured = capsys.readouterr()
    assert "\x1b" not in captured.out + captured.err


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--version", "--help"):
        with pytest.raises(SystemExit) as stopped:
            main([option])
        assert stopped.value.code == 0
    assert __version__ in capsys.readouterr().out


def test_own_blocks_come_from_a_module_in_the_current_folder(tmp_path: Path) -> None:
    (tmp_path / "my_blocks.py").write_text(
        "from blocks import Block, Input, output\n"
        "class Twice(Block):\n"
        "    '''y = 2 u.'''\n"
        "    u = Input()\n"
        "    @output\n"
        "    def y(u):\n"
        "        return 2 * u\n",
        encoding="utf-8",
    )
    path = write(
        tmp_path / "own.json",
        blocks={"one": {"type": "Constant"}, "two": {"type": "Twice"}},
        wires={"two.u": "one.y"},
        run={"stop": 1},
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "blocks", "run", Path(path).name, "--library", "my_blocks", "--json"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout)["signals"]["two.y"]["end"] == 2.0
    # Without it the type is unknown, and nothing is imported that the file could name.
    assert main(["run", path]) == 2


def test_draw_writes_an_svg(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "motor.svg"
    assert main(["draw", MOTOR, "-o", str(target)]) == 0
    text = target.read_text(encoding="utf-8")
    assert text.startswith("<svg")
    assert "PMDCMotor" in text
    capsys.readouterr()
    assert main(["draw", MOTOR]) == 0
    assert capsys.readouterr().out.strip() == text.strip()
    assert main(["draw", MOTOR, "--depth", "0"]) == 2


def test_a_faulty_diagram_is_drawn_with_its_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "faulty.json", blocks={"a": {"type": "Gian"}, "b": {"type": "Gain"}})
    assert main(["draw", path]) == 0
    out = capsys.readouterr().out
    assert "E103" in out
    assert "E101" in out


def test_constants_can_be_given_for_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "follow.json",
        inputs={"r": {"unit": "m/s"}},
        blocks={"y": {"type": "Integrator"}},
        wires={"y.u": "r"},
        run={"stop": 2},
    )
    for given, end in (("r=1.5", 3.0), ("r=100 cm/s", 2.0)):
        assert main(["run", path, "--json", "--input", given]) == 0
        assert json.loads(capsys.readouterr().out)["signals"]["y.y"]["end"] == pytest.approx(end)


def test_out_can_be_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", MOTOR, "--out", "-", "--log", "motor.omega", "--every", "1"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("time,motor.omega\n0.0,0.0\n")
    assert "motor_pid" in captured.err


# --- blocks run --plot -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "head"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF-"), ("PNG", b"\x89PNG")]
)
def test_plot_draws_in_the_format_of_its_ending(
    ending: str, head: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, table = tmp_path / f"x.{ending}", tmp_path / "x.csv"
    pictures = []
    for _ in range(2):
        assert main(["run", MOTOR, "--stop", "3", "--plot", str(target), "--out", str(table)]) == 0
        assert capsys.readouterr().out.endswith(f"rows in {table}\n  figure in {target}\n")
        pictures.append(target.read_bytes())
    assert pictures[0].startswith(head)
    assert pictures[0] == pictures[1], "one run gives the same picture each time"
    assert {entry.name for entry in tmp_path.iterdir()} == {target.name, table.name}


def drawn(path: Path) -> list[str]:
    """What is written in an SVG: matplotlib puts the text of each label into a comment."""
    return re.findall(r"<!-- (.*?) -->", path.read_text(encoding="utf-8"))


def test_plot_shows_four_signals_or_those_of_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "x.svg"
    names = ["speed.y", "motor.omega", "motor.i", "control.u", "load.y"]
    assert main(["run", MOTOR, "--stop", "3", "--plot", str(target)]) == 0
    assert [name for name in names if any(name in text for text in drawn(target))] == names[:4]
    logged = [word for name in names for word in ("--log", name)]
    assert main(["run", MOTOR, "--stop", "3", "--plot", str(target), *logged]) == 0
    assert [name for name in names if any(name in text for text in drawn(target))] == names
    capsys.readouterr()


def test_plot_refuses_too_many_signals_and_none_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(
        tmp_path / "wide.json",
        blocks={f"c{i}": {"type": "Constant"} for i in range(25)},
        run={"stop": 1},
    )
    target = tmp_path / "x.svg"
    logged = [word for i in range(25) for word in ("--log", f"c{i}.y")]
    assert main(["run", path, "--plot", str(target), *logged]) == 2
    said = f"E501 --plot {target}: 25 signals do not fit into one figure: the limit is 24. "
    said += "Choose fewer signals: --log SIGNAL.\n"
    assert capsys.readouterr().err == said
    assert main(["run", path, "--plot", str(target), *logged[:-2]]) == 0
    capsys.readouterr()  # a slow machine tells how far a run is
    target.unlink()
    silent = write(tmp_path / "silent.json", blocks={"c": {"type": "Constant"}}, run={"stop": 1, "log": []})
    assert main(["run", silent, "--plot", str(target)]) == 2
    assert capsys.readouterr().err == f"E501 --plot {target}: no signal is recorded. Choose signals: --log SIGNAL.\n"
    assert not target.exists()


def test_a_run_that_fails_is_drawn_up_to_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "escape.json",
        blocks={"square": {"type": "Product"}, "y": {"type": "Integrator", "parameters": {"y_start": 1}}},
        wires={"square.u1": "y.y", "square.u2": "y.y", "y.u": "square.y"},
        run={"stop": 2},
    )
    assert main(["run", path, "--plot", str(tmp_path / "x.svg")]) == 3
    assert (tmp_path / "x.svg").exists()
    capsys.readouterr()


# --- result files and blocks compare ---------------------------------------------------------------------------


def test_out_writes_the_format_of_its_ending_with_units_and_origin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read = []
    for ending in ("csv", "parquet", "mat"):
        target = tmp_path / f"x.{ending}"
        assert main(["run", MOTOR, "--stop", "3", "--set", "motor.Ra=200 mOhm", "--out", str(target)]) == 0
        read.append(Results.load(target))
    assert all(one.columns == read[0].columns and one.origin == read[0].origin for one in read)
    assert all((one.values == read[0].values).all() and (one.t == read[0].t).all() for one in read)
    assert read[0]["motor.i"].unit == "A"
    origin = read[0].origin
    assert origin is not None
    assert origin.sha256 == fingerprint(Diagram.load(MOTOR).value)
    assert origin.versions["blocks"] == __version__
    assert origin.settings["stop"] == 3.0
    assert origin.parameters == {"motor.Ra": {"value": 200.0, "unit": "mOhm"}}
    capsys.readouterr()


def test_a_missing_package_is_told_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    target = tmp_path / "x.parquet"
    assert main(["run", MOTOR, "--out", str(target)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(
        f"E504 {target}: this needs the package pyarrow, which is not installed. Install it: pip"
    )
    assert list(tmp_path.iterdir()) == []


def test_out_and_input_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "follow.json",
        inputs={"r": {"unit": "m"}},
        blocks={"y": {"type": "Integrator"}},
        wires={"y.u": "r"},
        run={"stop": 2},
    )
    table = tmp_path / "r.csv"
    assert main(["run", path, "--input", "r=1.5", "--log", "r", "--out", str(table)]) == 0
    assert main(["run", path, "--json", "--input", str(table)]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["signals"]["y.y"]["end"] == pytest.approx(3.0)
    again = tmp_path / "again.csv"
    assert main(["run", path, "--input", str(table), "--hold", "--out", str(again)]) == 0
    origin = Results.load(again).origin
    assert origin is not None
    assert origin.inputs == {"r.csv": {"sha256": hashlib.sha256(table.read_bytes()).hexdigest()}}
    assert origin.settings["interpolation"] == "hold"
    capsys.readouterr()


A = """\
# blocks results 1
# diagram: "first"
# units: {"m.w": "rad/s", "m.i": "A"}
time,m.w,m.i
0.0,0.0,1.0
1.0,4.0,1.0
2.0,2.0,3.0
"""


def pair(tmp_path: Path, b: str) -> list[str]:
    (tmp_path / "a.csv").write_text(A, encoding="utf-8")
    (tmp_path / "b.csv").write_text(b, encoding="utf-8")
    return [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")]


def test_compare_prints_a_table_and_a_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = pair(tmp_path, "time,m.i,m.w,extra\n0,1,0,9\n2,3,2,9\n")
    assert main(["compare", a, b]) == 1
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.splitlines() == [
        f"{a}  first  0 ... 2 s  3 rows",
        f"{b}  b  0 ... 2 s  2 rows",
        "  the times differ: compared by linear interpolation at 3 times of 0 ... 2 s",
        "  diagrams: first | b",
        "  signal  unit   difference  of range  at t  RMSE     fit",
        "  m.w     rad/s  3           0.75      1     1.7321   -66.41 %  ✗",
        "  m.i     A      1           0.5       1     0.57735  10.56 %   ✗",
        f"  only in {b}: extra",
        "2 of 2 signals beyond 1e-06 of the range in the first file; the worst is m.w",
    ]
    assert main(["compare", a, b, "--tolerance", "0.75"]) == 0
    assert capsys.readouterr().out.endswith("\n2 signals within 0.75 of the range in the first file\n")
    assert main(["compare", a, b, "--tolerance", "0.5", "--absolute", "2.9"]) == 1
    assert main(["compare", a, b, "--tolerance", "0.5", "--absolute", "3"]) == 0
    capsys.readouterr()


def test_compare_with_json_has_a_line_for_each_signal_and_one_for_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = pair(tmp_path, "time,m.w,m.i\n0,0,1\n1,3,nan\n2,2,3\n")
    assert main(["compare", a, b, "--json"]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[:2] == [
        {
            "event": "signal", "signal": "m.w", "unit": "rad/s", "difference": 1.0, "relative": 0.25, "t": 1.0,
            "rmse": pytest.approx(3**-0.5), "fit": pytest.approx(100 - 100 * (0.8 / 2.6) ** 0.5), "within": False,
        },
        {
            "event": "signal", "signal": "m.i", "unit": "A", "difference": None, "relative": None, "t": 1.0,
            "rmse": None, "fit": None, "within": False,
        },
    ]  # fmt: skip
    assert lines[2] == {
        "event": "done", "within": False, "beyond": 2, "worst": "m.i", "tolerance": 1e-06, "absolute": 0.0,
        "start": 0.0, "stop": 2.0, "times": 3, "interpolated": False, "only_a": [], "only_b": [],
        "notes": ["diagrams: first | b"],
    }  # fmt: skip


def test_compare_takes_names_that_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = pair(tmp_path, "time,speed,m.i\n0,0,1\n1,4,1\n2,2,3\n")
    assert main(["compare", a, b, "--rename", "m.w=speed"]) == 0
    assert capsys.readouterr().out.endswith("\n2 signals within 1e-06 of the range in the first file\n")
    for wrong, said in (("m.w", 'E501 --rename: "m.w" is not a pair of names.'), ("m.w=sped", "Did you mean 'speed'?")):
        assert main(["compare", a, b, "--rename", wrong]) == 2
        assert said in capsys.readouterr().err


def test_the_three_formats_of_one_run_are_equal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [str(tmp_path / f"x.{ending}") for ending in ("csv", "parquet", "mat")]
    for path in paths:
        assert main(["run", MOTOR, "--stop", "3", "--out", path]) == 0
    capsys.readouterr()
    for other in paths[1:]:
        assert main(["compare", paths[0], other, "--tolerance", "0"]) == 0
        out = capsys.readouterr().out
        assert out.endswith("5 signals within 0 of the range in the first file\n")
        assert len(out.splitlines()) == 2 + 6 + 1, "nothing else is different"


def test_another_tolerance_of_the_run_is_told_and_its_differences_are_small(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = str(tmp_path / "a.mat"), str(tmp_path / "b.parquet")
    assert main(["run", MOTOR, "--stop", "3", "--log", "motor.omega", "--out", a]) == 0
    tight = ["--rtol", "1e-9", "--atol", "1e-12"]
    assert main(["run", MOTOR, "--stop", "3", "--log", "motor.omega", "--out", b, *tight]) == 0
    capsys.readouterr()
    assert main(["compare", a, b, "--tolerance", "0"]) == 1
    assert "  settings: rtol 1e-06 | 1e-09\n  settings: atol 1e-09 | 1e-12\n" in capsys.readouterr().out
    # The first run was made with rtol 1e-6 of each step; what the steps leave adds up to less than a hundred of it.
    assert main(["compare", a, b, "--tolerance", "1e-4"]) == 0
    capsys.readouterr()


@pytest.mark.parametrize(
    ("b", "options", "said"),
    [
        ("time,q\n0,0\n", [], "E505 compare: A and B have no signal in common. A has m.w, m.i; B has q."),
        (
            *("time,m.w\n5,0\n", []),
            "E505 compare: A and B have no time in common: A covers 0 ... 2 s, and B covers 5 ... 5 s.",
        ),
        ("time,m.w\n", [], "E505 B (b): holds no rows."),
        ("time,m.w\n0,x\n", [], "line 2 does not hold 2 numbers."),
        (
            '# blocks results 1\n# units: {"m.w": "V"}\ntime,m.w\n0,0\n', [],
            "E505 m.w: is in rad/s in A and in V in B, which are different quantities.",
        ),
        ("time,m.w\n0,0\n", ["--tolerance", "-1"], "E501 tolerance: must be a number of at least 0, not -1.0."),
        ("time,m.w\n0,0\n", ["--tolerance", "few"], "E501 --tolerance: 'few' is not a number."),
        ("time,m.w\n0,0\n", ["--absolute", "1 mV"], "E501 --absolute: '1 mV' must be a number without a unit."),
    ],
)  # fmt: skip
def test_compare_refuses_what_cannot_be_compared(
    b: str, options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *pair(tmp_path, b), *options]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.endswith(f"{said}\n")
    assert main(["compare", *pair(tmp_path, b), *options, "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["event"] == "fault"


def test_compare_refuses_what_is_no_result_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, _ = pair(tmp_path, "")
    assert main(["compare", a, str(tmp_path / "none.csv")]) == 2
    assert capsys.readouterr().err == f"E503 {tmp_path / 'none.csv'}: cannot be read: No such file or directory.\n"
    assert main(["compare", a, MOTOR]) == 2
    said = "the ending '.json' is not a format of result files. Use .csv, .parquet or .mat."
    assert capsys.readouterr().err == f"E501 {MOTOR}: {said}\n"


# --- the master ------------------------------------------------------------------------------------------------


def test_settings_of_the_master_are_given_one_by_one(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", MOTOR, "--stop", "0.1", "--master", "couple=each", "--master", "step=0.01"]
    assert main(words) == 0
    assert re.search(
        r"^motor_pid  jacobi, order 1, every 0\.01 s \(dopri5, rtol 1e-06\)  reference  0 \.\.\. 0\.1 s$",
        capsys.readouterr().out,
        re.M,
    )
    assert main([*words, "--master", "steps.motor=5 ms", "--master", "algorithm=gauss-seidel"]) == 0
    for item, text in (
        ("step", "is not NAME=VALUE"),
        ("step=0.02", "gives step a second value"),
        ("speed.motor=1", "To set the step of one block, write steps.BLOCK=0.001."),
        (
            "algorithm=gauss_seidel",
            'E115 run.master.algorithm: "gauss_seidel" is not known. Did you mean "gauss-seidel"?',
        ),
        ("stpe=1", 'E115 run.master: "stpe" is not known. Did you mean "step"?'),
        ("steps.moter=1", "Did you mean 'motor'?"),
        ("order=3", "must be an integer from 0 to 2, not 3."),
    ):
        assert main([*words, "--master", item]) == 2
        assert text in capsys.readouterr().err


# --- what a terminal shows -------------------------------------------------------------------------------------

BROKEN = """{"format": "blocks-diagram", "version": 3, "name": "broken",
 "blocks": {
  "a": {"type": "Gian"},
  "b": {"type": "Gain", "parametres": {"k": 1}}
 },
 "wires": {
  "b.w": "a.y"
 }
}
"""


def on_a_terminal(*words: str) -> tuple[int, str]:
    """The exit code of a command whose output goes to a terminal, and what stands there."""
    pty = pytest.importorskip("pty")
    told: list[bytes] = []
    here, there = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-m", "blocks", *words], stdin=subprocess.DEVNULL, stdout=there, stderr=there
    ) as command:
        os.close(there)
        with contextlib.suppress(OSError):  # how the end of a terminal is told
            while piece := os.read(here, 65536):
                told.append(piece)
    os.close(here)
    return command.returncode, b"".join(told).decode().replace("\r\n", "\n")


def marked(told: str) -> list[tuple[int, str]]:
    """The number of each line that is shown, and what is marked in it."""
    lines = told.splitlines()
    found = []
    for shown, mark in pairwise(lines):
        if "^" in mark:
            found.append((int(shown.partition("|")[0]), shown[mark.index("^") : mark.rindex("^") + 1]))
    return found


def test_a_terminal_shows_the_faulty_lines_and_a_file_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken.json"
    path.write_text(BROKEN)
    code, told = on_a_terminal("check", str(path))
    assert code == 2
    assert marked(told) == [(3, '"Gian"'), (4, '"parametres"'), (7, '"b.w"')]
    assert "`blocks explain E103` explains it." in told
    assert main(["check", str(path)]) == 2
    assert "|" not in capsys.readouterr().out


def test_the_lines_of_other_commands_stand_on_stderr(tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text(BROKEN)
    code, told = on_a_terminal("run", str(path))
    assert code == 2
    assert marked(told) == [(3, '"Gian"'), (4, '"parametres"'), (7, '"b.w"')]


def test_a_faulty_line_is_shown_as_far_as_it_fits_and_obeys_no_escape(tmp_path: Path) -> None:
    long = tmp_path / "long.json"
    text = '{"format": "blocks-diagram", "version": 3, "doc": "' + 300 * "\u00e9\u202e" + '", "bolcks": {}}'
    long.write_text(text, encoding="utf-8")
    fault = Fault("E003", "bolcks", "the key is not known", file=str(long), line=1, column=text.index('"bolcks"') + 1)
    shown, mark = Excerpts().of(fault)
    assert len(shown) < 120
    assert "\u202e" not in shown
    assert shown[mark.index("^") : mark.rindex("^") + 1] == '"bolcks"'


def test_a_line_that_is_no_longer_there_is_not_shown(tmp_path: Path) -> None:
    path = tmp_path / "short.json"
    path.write_text("{}")
    for file, line, column in ((path, 2, 1), (path, 1, 9), (tmp_path / "none", 1, 1), (tmp_path, 1, 1)):
        assert not list(Excerpts().of(Fault("E003", "", "", file=str(file), line=line, column=column)))


# --- faults of structure and of meaning at once ----------------------------------------------------------------


def test_faults_of_structure_and_of_meaning_are_told_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken.json"
    path.write_text(BROKEN)
    assert main(["check", str(path)]) == 2
    codes = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  E")]
    assert codes == ["E103", "E003", "E105"]


def faults_of(read: Callable[[], Any]) -> tuple[Fault, ...]:
    try:
        read()
    except ModelError as error:
        return error.faults
    return ()


def test_what_follows_from_a_fault_of_structure_is_not_told_beside_it() -> None:
    """Each value of a whole diagram is replaced by one of another kind: only that is told."""
    path = ROOT / "diagrams" / "paper" / "iadrc.json"
    document = json.loads(path.read_text())

    def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        yield at
        for key, entry in value.items() if isinstance(value, dict) else ():
            yield from places(entry, (*at, key))

    count = 0
    for place in list(places(document))[1:]:
        for wrong in (5, [1], {"zz": 1}, "a b", None):
            damaged = json.loads(json.dumps(document))
            inside = damaged
            for key in place[:-1]:
                inside = inside[key]
            inside[place[-1]] = wrong
            alone = faults_of(lambda: from_document(damaged, folder=path.parent))  # noqa: B023
            if alone:
                assert faults_of(lambda: Diagram.from_json(damaged, folder=path.parent)) == alone, place  # noqa: B023
                count += 1
    assert count > 300


# --- errors of the command line, and of blocks itself ----------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rnu", "x.json"], "'rnu' is not a command. Did you mean 'run'?"),
        (["run"], "the following arguments are required: DIAGRAM. `blocks run --help`"),
        (["run", "x.json", "y.json"], "blocks run: 'y.json' is one argument more than the command takes."),
        (["run", "x.json", "--stpo", "3"], "--stpo is not an option of this command. Did you mean '--stop'?"),
        (["run", "x.json", "--engine", "natve"], "'natve' is not a value of --engine. Did you mean 'native'?"),
        (["draw", "x.json", "--depth", "many"], "invalid int value: 'many'."),
        (["fmu", "chek", "x.fmu"], "'chek' is not a command. Did you mean 'check'?"),
    ],
)
def test_a_command_line_that_cannot_be_meant_is_told_with_the_nearest_word(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    told = capsys.readouterr().err
    assert told.startswith("E501 blocks")
    assert said in told
    assert len(told.splitlines()) == 1


def test_a_fault_of_blocks_itself_has_a_code_and_a_trace_only_where_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise KeyError("omega\x1b[2J")

    monkeypatch.setattr("blocks.api.diagram.Diagram.load", fail)
    assert main(["check", "x.json"]) == 70
    told = capsys.readouterr().err
    assert told.startswith("E901 blocks itself failed (KeyError: 'omega")
    assert "\x1b" not in told
    assert "Traceback" not in told
    assert main(["check", "x.json", "--debug"]) == 70
    assert "Traceback" in capsys.readouterr().err
    assert main(["--debug", "check", "x.json", "--json"]) == 70
    out, err = capsys.readouterr()
    assert json.loads(out)["code"] == "E901"
    assert "Traceback" in err


def test_debug_shows_where_an_error_of_a_model_comes_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.json"
    assert main(["run", str(path)]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["run", "--debug", str(path)]) == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"), [(MemoryError(), "E008"), (PermissionError(13, "Permission denied", "x.json"), "E501")]
)
def test_what_the_system_refuses_is_told_without_a_trace(
    error: Exception, code: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    monkeypatch.setattr("blocks.api.diagram.Diagram.load", fail)
    assert main(["check", "x.json"]) == 2
    told = capsys.readouterr().err
    assert told.startswith(code)
    assert "Traceback" not in told


# --- several files, and studies --------------------------------------------------------------------------------


def test_check_takes_several_files_and_studies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "broken.json"
    broken.write_text(BROKEN)
    paper = str(DIAGRAMS / "paper" / "study.json")
    assert main(["check", MOTOR, paper]) == 0
    told = capsys.readouterr().out
    assert "motor_pid: 4 blocks" in told
    assert "paper: 8 runs, 27 claims" in told
    assert main(["check", MOTOR, str(broken), BALL]) == 2
    told = capsys.readouterr().out
    assert [line for line in told.splitlines() if line.endswith(".json")] == [MOTOR, str(broken), BALL]
    assert main(["check", "--json", str(broken), MOTOR]) == 2
    done = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(entry["file"], entry["errors"]) for entry in done if entry["event"] == "done"] == [
        (str(broken), 3),
        (MOTOR, 0),
    ]


def test_check_of_a_study_tells_what_its_diagrams_would_refuse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "study.json"
    runs = {"a": {"diagram": MOTOR, "parameters": {"kpp": 1}}}
    path.write_text(json.dumps({"format": "blocks-study", "version": 1, "runs": runs, "claims": []}))
    assert main(["check", str(path)]) == 2
    assert "E106" in capsys.readouterr().out
    path.write_text(json.dumps({"format": "blocks-studie", "version": 1}))
    assert main(["check", str(path)]) == 2
    assert "E006" in capsys.readouterr().out


def test_a_wrong_setting_hides_no_loop_and_a_misspelt_key_is_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(
        tmp_path / "loop.json",
        blocks={"r": {"type": "Step"}, "e": {"type": "Sum", "parameters": {"signs": "+-"}}, "k": {"type": "Gain"}},
        wires={"e.u1": "r.y", "e.u2": "k.y", "k.u": "e.y"},
        run={"method": "ode45"},
        measures={"m": {"type": "overshoot", "of": "k.y", "agianst": "r.y"}},
    )
    assert main(["check", path]) == 2
    told = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  E")]
    assert told == ["E115", "E003"]  # a misspelt key is no missing one
    path = path_without(path, "measures")
    assert main(["check", path]) == 2
    told_text = capsys.readouterr().out
    assert [line.split()[0] for line in told_text.splitlines() if line.startswith("  E")] == ["E115", "E102"]
    assert 'The nearest method is "dopri5".' in told_text


def path_without(path: str, section: str) -> str:
    """The same diagram without a section."""
    document = json.loads(Path(path).read_text())
    del document[section]
    Path(path).write_text(json.dumps(document))
    return path


def test_the_order_tells_what_ticks_compute(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DIAGRAMS / "sampled_loop.json")]) == 0
    told = capsys.readouterr().out
    assert "  order: reference > plant > error > gain\n" in told
    assert "  at ticks of 0.1 s: sampler > delay\n" in told


HELD = """
from blocks import Block, Input, Parameter, Stepped, stepper


class Twice:
    def step(self, t, u):
        return 2 * u


class Program(Block):
    \"\"\"y = 2 u at ticks, by a program.\"\"\"

    period = Parameter(0.1, unit="s")
    u = Input()
    y = Stepped()

    @stepper(every=period)
    def program():
        return Twice()
"""


@pytest.mark.parametrize("declared", list(permutations(["sp", "filter", "v", "late"])), ids=" ".join)
def test_the_order_at_ticks_is_that_of_the_wires_however_blocks_are_declared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], declared: tuple[str, ...]
) -> None:
    """sp -> gain -> filter -> v at one tick; late gives what it held, and so comes wherever it stands."""
    hold = {"type": "ZeroOrderHold", "parameters": {"period": 0.1}}
    blocks = {
        "sp": hold,
        "filter": {"type": "DiscreteTransferFunction", "parameters": {"num": [1, 0], "den": [1, -0.5], "period": 0.1}},
        "v": {"type": "DiscretePID", "parameters": {"kp": 2, "ki": 1, "period": 0.1}},
        "late": {"type": "UnitDelay", "parameters": {"period": 0.1}},
    }
    path = write(
        tmp_path / "ticks.json",
        inputs={"r": {}},
        blocks={**{name: blocks[name] for name in declared}, "gain": {"type": "Gain"}, "p": {"type": "FirstOrder"}},
        wires={"sp.u": "r", "gain.u": "sp.y", "filter.u": "gain.y", "v.r": "filter.y", "v.y": "p.y",
               "late.u": "v.u", "p.u": "late.y"},
        run={"stop": 1},
    )  # fmt: skip
    assert main(["check", path]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "at ticks of 0.1 s: " in line]
    order = line.partition(": ")[2].split(" > ")
    assert sorted(order) == ["filter", "late", "sp", "v"]
    assert [name for name in order if name != "late"] == ["sp", "filter", "v"]


def test_programs_stand_in_the_order_at_ticks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "programs_of_ticks.py").write_text(HELD, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    hold = {"type": "ZeroOrderHold", "parameters": {"period": 0.1}}
    path = write(
        tmp_path / "ticks.json",
        inputs={"r": {}},
        blocks={"last": hold, "program": {"type": "Program"}, "first": hold},
        wires={"first.u": "r", "program.u": "first.y", "last.u": "program.y"},
        run={"stop": 1},
    )
    assert main(["check", path, "--library", "programs_of_ticks"]) == 0
    assert "  at ticks of 0.1 s: first > program > last\n" in capsys.readouterr().out


def test_a_quantizer_in_a_servo_is_taken_as_a_gain_where_the_command_line_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """3/(s (s + 1)) in unity feedback: a phase margin of 32.0994 deg, from |L| = 1 at w^2 (w^2 + 1) = 9."""
    path = write(
        tmp_path / "servo.json",
        inputs={"r": {}},
        blocks={
            "e": {"type": "Sum", "parameters": {"signs": "+-"}},
            "q": {"type": "Quantizer", "parameters": {"interval": 0.1}},
            "p": {"type": "TransferFunction", "parameters": {"num": [3], "den": [1, 1, 0]}},
        },
        wires={"e.u1": "r", "e.u2": "q.y", "q.u": "p.y", "p.u": "e.y"},
    )
    crossover = math.sqrt((math.sqrt(37.0) - 1.0) / 2.0)
    known = 90.0 - math.degrees(math.atan(crossover))
    assert main(["linearize", path, "--loop", "e.y"]) == 2
    told = capsys.readouterr().err
    assert (
        "E705 e.y: a signal that enters there does not come back. q.y passes nothing on at its operating point" in told
    )
    assert "or --override q=1, or its describing function" in told
    assert "or --amplitude q.u=A." in told
    for options, gain in ((["--override", "q=1"], 1.0), (["--override", "q=[[0.5]]"], 0.5)):
        assert main(["linearize", path, "--loop", "e.y", "--json", *options]) == 0
        made = json.loads(capsys.readouterr().out)["margins"]
        w = made["crossover"]
        assert w**2 * (w**2 + 1.0) == pytest.approx((3.0 * gain) ** 2, rel=1e-9)
        if gain == 1.0:
            assert made["phase_deg"] == pytest.approx(known, rel=1e-9)
    assert main(["linearize", path, "--from", "r", "--to", "p.y"]) == 0
    assert "--override q=1" not in capsys.readouterr().out  # before the quantizer there is a transfer
    assert main(["linearize", path, "--from", "r", "--to", "q.y"]) == 0
    told = capsys.readouterr().out
    assert "--override q=1" in told
    for option, says in (("q", "is not NAME=VALUE"), ("q=x", "is not a number"), ("k=1", "there is no such block")):
        assert main(["linearize", path, "--loop", "e.y", "--override", option]) == 2
        assert says in capsys.readouterr().err
    assert main(["linearize", path, "--loop", "r"]) == 2
    assert "it is not part of a loop. Open the loop at a signal that feeds back to itself." in capsys.readouterr().err


def test_linearize_opens_a_loop_at_several_signals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = "diagrams/analysis/satellite.json"
    channels = ["--loop", "k.y[0]", "--loop", "k.y[1]"]
    assert main(["linearize", path, *channels, "--plot", str(tmp_path / "both.svg")]) == 0
    told = capsys.readouterr()
    assert "disk margin     0.099751 at 0.049876 rad/s: gain x 0.90499 to 1.105 and phase +-5.7106 deg" in told.out
    assert "W701" not in told.err
    assert "S of satellite: loop at k.y[0], k.y[1]" in (tmp_path / "both.svg").read_text()
    assert main(["linearize", path, *channels, "--json"]) == 0
    one = json.loads(capsys.readouterr().out)
    assert main(["linearize", path, "--loop", "k.y", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == one
    found = one["margins"]
    w = math.sqrt(101) - 10
    assert found["disk"] == pytest.approx(2 * math.sqrt((w * w + 1) / ((w + 20) ** 2 + 1)), rel=1e-9)
    assert found["alone"]["k.y[1]"]["phase_deg"] == pytest.approx(90.0)
    assert np.abs([complex(*f) for f in found["worst"].values()]) == pytest.approx(np.ones(2), rel=1e-6)
    assert (found["stable"], found["border"], one["bandwidth"]) == (True, False, None)
    for kind, status in (("poles", 0), ("sigma", 0), ("bode", 2), ("step", 2)):
        drawn = str(tmp_path / f"{kind}.svg")
        assert main(["linearize", path, *channels, "--plot", drawn, "--figure", kind]) == status
    capsys.readouterr()
    assert main(["linearize", path, "--loop", "k.y[0]", "--loop", "k.y[0]"]) == 2
    assert "E501 k.y[0]: appears twice" in capsys.readouterr().err


@pytest.mark.filterwarnings("always:W701")
def test_linearize_warns_once_of_a_channel_that_is_fragile_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, drawn = "diagrams/analysis/satellite.json", str(tmp_path / "one.svg")
    assert main(["linearize", path, "--loop", "k.y[0]", "--plot", drawn]) == 0
    told = capsys.readouterr()
    assert told.err.count("W701 k.y[0]: this margin is of one channel alone.") == 1
    assert "phase margin    90 deg" in told.out


def test_linearize_keeps_the_dead_time_of_a_loop_exact_without_pade(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """4 e^(-0.2 s)/(s + 1) in unity feedback: |L| = 1 at sqrt(15), and a Smith predictor with delays on two ways."""
    path = write(
        tmp_path / "late.json",
        inputs={"r": {}},
        blocks={
            "e": {"type": "Sum", "parameters": {"signs": "+-"}},
            "late": {"type": "TransportDelay", "parameters": {"delay": 0.2}},
            "p": {"type": "TransferFunction", "parameters": {"num": [4], "den": [1, 1]}},
        },
        wires={"e.u1": "r", "e.u2": "p.y", "late.u": "e.y", "p.u": "late.y"},
    )
    w = math.sqrt(15.0)
    phase = math.pi - math.atan(w) - 0.2 * w
    assert main(["linearize", path, "--loop", "e.y", "--json"]) == 0
    seen = json.loads(capsys.readouterr().out)
    assert (seen["dead_time"], seen["poles"], seen["dc_gain"]) == (0.2, [[-1.0, 0.0]], 4.0)
    assert seen["margins"]["stable"] is True
    assert seen["margins"]["phase_deg"] == pytest.approx(math.degrees(phase), rel=1e-12)
    assert seen["margins"]["delay"] == pytest.approx(phase / w, rel=1e-12)
    assert main(["linearize", path, "--loop", "e.y", "--json", "--pade", "4"]) == 0
    fitted = json.loads(capsys.readouterr().out)
    assert "dead_time" not in fitted
    assert len(fitted["poles"]) == 5
    assert fitted["margins"]["phase_deg"] == pytest.approx(seen["margins"]["phase_deg"], rel=1e-5)
    assert main(["linearize", path, "--loop", "e.y", "--plot", str(tmp_path / "late.svg")]) == 0
    assert "loop at e.y: 1 state, dead time 0.2 s" in capsys.readouterr().out
    for kind in ("step", "poles"):
        drawn = str(tmp_path / f"{kind}.svg")
        assert main(["linearize", path, "--loop", "e.y", "--plot", drawn, "--figure", kind]) == 2
        assert "E707 e.y: the loop has exact delays, but this figure needs a state space." in capsys.readouterr().err
    path = write(
        tmp_path / "smith.json",
        inputs={"r": {}},
        blocks={
            "e": {"type": "Sum", "parameters": {"signs": "+--"}},
            "pi": {"type": "TransferFunction", "parameters": {"num": [2, 1], "den": [1, 0]}},
            "p": {"type": "FirstOrder"},
            "late": {"type": "TransportDelay", "parameters": {"delay": 1.0}},
            "model": {"type": "FirstOrder"},
            "short": {"type": "TransportDelay", "parameters": {"delay": 0.9}},
            "rest": {"type": "Sum", "parameters": {"signs": "+-"}},
        },
        wires={
            "e.u1": "r", "e.u2": "late.y", "e.u3": "rest.y", "pi.u": "e.y", "p.u": "pi.y", "late.u": "p.y",
            "model.u": "pi.y", "short.u": "model.y", "rest.u1": "model.y", "rest.u2": "short.y",
        },
    )  # fmt: skip
    assert main(["linearize", path, "--loop", "pi.y"]) == 0
    shown = capsys.readouterr().out
    assert "loop at pi.y: exact delays of 1 s, 0.9 s on several ways" in shown
    assert "closed loop     stability unknown with delays on several ways; --pade 3 decides it by Padé models" in shown
    assert main(["linearize", path, "--loop", "pi.y", "--json"]) == 0
    seen = json.loads(capsys.readouterr().out)
    assert (seen["poles"], seen["dead_time"], seen["margins"]["stable"]) == (None, None, None)


def test_units_that_are_the_parameter_s_or_the_case_s_fault_are_told_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(
        tmp_path / "units.json",
        parameters={"T": {"value": 1, "unit": "S"}, "k": {"value": 1, "unit": "V"}},
        blocks={
            "s": {"type": "Step", "parameters": {"unit": "rad/s"}},
            "late": {"type": "Step", "parameters": {"at": "=T"}},
            "e": {"type": "Sum", "parameters": {"signs": "+", "unit": "rad"}},
            "m": {"type": "PMDCMotor", "parameters": {"Ra": "=k"}},
        },
        wires={"e.u1": "s.y", "m.v": "e.y"},
    )
    assert main(["check", path]) == 2
    told = capsys.readouterr().out
    assert "Did you mean [s]?" in told
    assert "Correct the unit of k" in told
    assert 'Check the wire and the "unit" of e, or insert a Gain' in told


def test_no_command_at_all_prints_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "usage: blocks" in capsys.readouterr().err


def test_explain_takes_several_codes_and_beginnings(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "E101", "e102"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("E101: ")
    assert "\nE102: " in told
    assert main(["explain", "E10"]) == 0
    assert [line[:4] for line in capsys.readouterr().out.splitlines()] == [f"E10{k}" for k in range(1, 10)]


def test_a_slip_of_the_text_hides_no_fault_of_meaning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slip.json"
    text = """{
 // my diagram
 "format": "blocks-diagram", "version": 3,
 "blocks": {"g": {"type": "Gian"}, "h": {"type": "Gain", "parameters": {"kk": 1}}},
 "wires": {"h.u": "zzz.y"}, "bogus": 1
}
"""
    for slipped in (text, "\ufeff" + text, text.replace('"bogus": 1', '"bogus": 1,')):
        path.write_text(slipped, encoding="utf-8")
        assert main(["check", str(path)]) == 2
        told = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  E")]
        assert [code for code in told if code != "E001"] == ["E103", "E106", "E105", "E003"]


def test_a_study_with_slips_is_told_as_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "study.json"
    path.write_text(
        '\ufeff{"format": "blocks-study", "version": 1, // mine\n "runs": {"a": {"diagram": 5}}, "bogus": 2}',
        encoding="utf-8",
    )
    assert main(["check", str(path)]) == 2
    told = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  E")]
    assert sorted(told) == ["E001", "E001", "E003", "E004"]


def test_faults_of_files_that_cannot_be_read_name_them_as_objects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = str(tmp_path / "gone.json")
    for verb in ("check", "fmt"):
        assert main([verb, "--json", gone, MOTOR]) == 2
        first = json.loads(capsys.readouterr().out.splitlines()[0])
        assert (first["code"], first["file"]) == ("E007", gone)


@pytest.mark.skipif(not os.path.exists("/dev/stdin"), reason="no such name here")
def test_an_input_may_come_through_a_pipe_that_the_command_was_given(tmp_path: Path) -> None:
    path = write(
        tmp_path / "double.json",
        inputs={"u": {}},
        blocks={"g": {"type": "Gain", "parameters": {"k": 2}}},
        wires={"g.u": "u"},
        run={"stop": 1, "every": 0.5},
    )
    made = subprocess.run(
        [sys.executable, "-m", "blocks", "run", path, "--input", "/dev/stdin", "--log", "g.y", "--out", "-"],
        input="time,u\n0,1\n1,3\n",
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line for line in made.stdout.splitlines() if not line.startswith("#")]
    assert rows == ["time,g.y", "0.0,2.0", "0.5,4.0", "1.0,6.0"]


def test_an_error_of_the_system_that_names_no_file_is_not_one_of_stdout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for error, said in (
        (OSError(24, "Too many open files"), "Too many open files"),
        (BrokenPipeError(32, "Broken pipe"), "Broken pipe"),
    ):

        def refuse(*_: Any, error: OSError = error, **__: Any) -> None:
            raise error

        monkeypatch.setattr(Diagram, "load", refuse)
        assert main(["run", "x.json"]) == 2, "also not what `| head` ends"
        told = f"E501 the operating system refused: {said}. Run it again with --debug to see where.\n"
        assert capsys.readouterr().err == told


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_stdout_that_is_full_or_closed_or_left_is_told_as_such(unbuffered: str) -> None:
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    command = [sys.executable, "-m", "blocks", "list"]
    with open("/dev/full", "wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, cwd=ROOT, env=environment, text=True)
    assert done.returncode == 2
    assert done.stderr == "E501 stdout: cannot be written: No space left on device.\n"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, cwd=ROOT, env=environment, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


# --- progress ---------------------------------------------------------------------------------------------------


def test_progress_tells_how_long_the_rest_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    from blocks.cli.output import Progress

    shown = Progress(quiet=True)
    for share, seconds, told in [
        (0.25, 10.0, "30 s left"), (0.5, 119.0, "119 s left"), (0.1, 60.0, "9 min left"), (0.01, 150.0, "4.1 h left"),
        (0.0, 1.0, ""), (1.0, 5.0, "0 s left"),
    ]:  # fmt: skip
        monkeypatch.setattr(Progress, "seconds", seconds)
        assert shown.left(share) == told


def test_parameters_come_from_a_csv_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "values.csv"
    path.write_text("name,value,unit\nmotor.Ra,200,mOhm\n\n# gains\n kp , 25\n", encoding="utf-8-sig")
    lines = []
    for given in ([f"@{path}"], ["motor.Ra=200 mOhm", "kp=25"]):
        options = [word for item in given for word in ("--set", item)]
        assert main(["run", MOTOR, *options, "--json"]) == 0
        lines.append(json.loads(capsys.readouterr().out.splitlines()[-1])["signals"])
    assert lines[0] == lines[1]
    for text, said in (
        ("motor.Ra", ":1: is not a name, a value and maybe a unit. Write one row for each value: motor.Ra,200,mOhm"),
        ("kp,1\nkp,2", f"E501 {path}:2:1 --set kp=2: gives kp a second value."),
        ('# gains\nkp,"1,2"', f"E501 {path}:2:1 --set kp: '1,2' is not a number"),
        ("kp,2\nkq,1", f"E106 {path}:2:1 kq"),
        ("kp,2\n\nmotor.*a,-1", f"E107 {path}:3:1 motor.Ra: must be at least 0.0 Ohm"),
        ("name,value\nki,3,V", f"E104 {path}:2:1 ki: [V] is given, but [V/rad] is needed"),
    ):
        path.write_text(text, encoding="utf-8")
        assert main(["run", MOTOR, "--set", f"@{path}"]) == 2
        assert said in capsys.readouterr().err
    for missing in (tmp_path / "no.csv", tmp_path):
        assert main(["run", MOTOR, "--set", f"@{missing}"]) == 2
        assert f"E501 --set @{missing}: cannot be read" in capsys.readouterr().err
