"""`blocks plot` and `results.plot(beside=...)`: several results in one figure."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from blocks import Results, UsageError
from blocks.cli import main
from blocks.results.results import Results as Made
from tests.support.places import ROOT

T = np.array([0.0, 1.0, 2.0])


def made(unit: str, scale: float = 1.0, name: str = "motor.omega") -> Results:
    values = scale * np.array([[0.0, 5.0], [1.0, 6.0], [3.0, 7.0]])
    return Made("run", T, values, {name: (0, (), unit), "motor.i": (1, (), "A")})


def test_results_are_drawn_over_each_other_in_the_units_of_the_first() -> None:
    figure = made("rad/s").plot(label="rad", beside={"rpm": made("rpm", 30 / np.pi), "plain": made("", 2.0)})
    speed, current = figure.axes
    assert speed.get_ylabel() == "motor.omega [rad/s]"
    assert current.get_ylabel() == "motor.i [A]"
    rad, rpm, plain = (line.get_ydata() for line in speed.lines)
    np.testing.assert_allclose(rpm, rad, rtol=1e-14)
    np.testing.assert_array_equal(plain, 2 * rad)  # an unknown unit is taken as it is
    assert [text.get_text() for text in speed.get_legend().get_texts()] == ["rad", "rpm", "plain"]
    # Patterns, for greyscale.
    assert len({str((line.get_linestyle(), line._dash_pattern)) for line in speed.lines}) == 3


def test_results_that_cannot_be_drawn_over_each_other_are_refused() -> None:
    first = made("rad/s")
    with pytest.raises(UsageError, match=r"E505 motor.omega: has the unit rad/s in run and V in b: they are different"):
        first.plot("motor.omega", beside={"b": made("V")})
    with pytest.raises(UsageError, match="E501 b: there is no signal"):
        first.plot("motor.omega", beside={"b": made("Pa", name="pump.p")})
    assert [axis.get_ylabel() for axis in first.plot(beside={"b": made("Pa", name="pump.p")}).axes] == ["motor.i [A]"]
    with pytest.raises(UsageError, match='E501 plot: two results have the label "run"'):
        first.plot(beside={"run": first})
    with pytest.raises(UsageError, match="E501 plot: 7 results are too many for one figure; it has 6"):
        first.plot(beside={f"b{k}": first for k in range(6)})


def test_the_command_names_files_in_the_legend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    made("rad/s").save(a)
    made("rpm", 10.0).save(b)
    out = tmp_path / "x.svg"

    def drawn() -> list[str]:
        return re.findall(r"<!-- (.*?) -->", out.read_text(encoding="utf-8"))

    assert main(["plot", str(a), f"with limits={b}", "--signal", "motor.om*", "-o", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert {"a", "with limits", "motor.omega [rad/s]"} <= set(drawn())
    assert "motor.i [A]" not in drawn()
    assert main(["plot", str(a), str(b), "-o", str(out)]) == 0
    assert {"a", "b", "motor.omega [rad/s]", "motor.i [A]"} <= set(drawn())
    capsys.readouterr()
    for command, told in [
        (["--signal", "pump.*", "-o", str(out)], "E501 --signal pump.*: matches no signal of a. Signals: "
            "motor.omega, "),
        ([f"a={b}", "-o", str(out)], "E501 FILE: two files have the same name in the legend. Rename one: NAME=FILE."),
        (["-o", str(b)], "E501"),
    ]:
        assert main(["plot", str(a), *command]) == 2
        assert capsys.readouterr().err.startswith(told)


def test_the_ending_says_that_a_drawing_is_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    motor = str(ROOT / "diagrams" / "motor_pid.json")
    page, plain = tmp_path / "a.html", tmp_path / "b.html"
    assert main(["draw", motor, "-o", str(page)]) == main(["draw", motor, "--html", "-o", str(plain)]) == 0
    assert page.read_bytes().startswith(b"<!doctype html>")
    assert page.stat().st_size == plain.stat().st_size
    assert main(["draw", motor, "-o", str(tmp_path / "a.pdf")]) == 2
    assert "Name it FILE.svg, or FILE.html for a page." in capsys.readouterr().err


def test_the_size_of_a_figure_is_given_in_inches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "a.csv", tmp_path / "a.svg"
    made("rad/s").save(file)
    assert main(["plot", str(file), "-o", str(out), "--size", "3.5x2.2"]) == 0
    assert 'width="252pt" height="158.4pt"' in out.read_text(encoding="utf-8")  # 72 points an inch
    assert main(["plot", str(file), "-o", str(out), "--size", "9 cm"]) == 2
    assert "E501 --size 9 cm: is not a width and a height from 0.5 to 100 inches" in capsys.readouterr().err
