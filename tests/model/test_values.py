"""A bare number is in the unit that its place declares, wherever it stands; another unit is said with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from blocks import Block, Constant, Diagram, Gain, Input, ModelError, Noise, Parameter, Step, UsageError, output
from blocks.cli import main


def end(diagram: Diagram, signal: str, **how: Any) -> float:
    return float(diagram.run(stop=1.0, **how)[signal][-1])


def through_gain(**declared: Any) -> Diagram:
    diagram = Diagram("through")
    source = diagram.input("i", **declared)
    gain = diagram.add("gain", Gain())
    diagram.wire(gain.u, source)
    return diagram


@pytest.mark.parametrize(
    ("inputs", "value"),
    [
        ({}, 0.003),
        ({"i": 4.0}, 0.004),
        ({"i": {"value": 4.0, "unit": "V"}}, 4.0),
        ({"i": ([0.0, 1.0], [4.0, 4.0])}, 0.004),
        ({"i": {"t": [0.0, 1.0], "u": [4.0, 4.0], "unit": "V"}}, 4.0),
    ],
)
def test_run_inputs(inputs: dict[str, Any], value: float) -> None:
    diagram = through_gain(unit="mV", default=3.0)
    assert end(diagram, "gain.y", inputs=inputs) == pytest.approx(value, rel=1e-15)


def test_run_inputs_set_by_hand_and_read_from_csv(tmp_path: Path) -> None:
    diagram = through_gain(unit="mV", default=3.0)
    run = diagram.start()
    run.set("i", 5.0)
    assert run["gain.y"] == pytest.approx(0.005, rel=1e-15)
    (tmp_path / "i.csv").write_text("time,i\n0,4\n1,4\n", encoding="utf-8")
    assert end(diagram, "gain.y", inputs=tmp_path / "i.csv") == pytest.approx(0.004, rel=1e-15)


@pytest.mark.parametrize(
    ("block", "value"),
    [
        (Constant(unit="mV"), 1e-3),
        (Constant(unit="mV", value=1.0), 1e-3),
        (Step(unit="rpm", at=0.5), 0.10471975511965977),
        (Step(unit="rpm", at=0.5, after=1), 0.10471975511965977),
    ],
)
def test_defaults_whose_unit_follows_from_a_parameter(block: Block, value: float) -> None:
    diagram = Diagram("one")
    diagram.add("block", block)
    assert end(diagram, "block.y") == pytest.approx(value, rel=1e-15)


def test_the_deviation_of_noise() -> None:
    plain, milli = Diagram("a"), Diagram("b")
    plain.add("noise", Noise(unit="V"))
    milli.add("noise", Noise(unit="mV"))
    assert end(milli, "noise.y") == pytest.approx(1e-3 * end(plain, "noise.y"), rel=1e-12)


def test_defaults_of_inputs_starts_of_outputs_and_ranges() -> None:
    class Mixed(Block):
        """y = u, and a held value."""

        unit = Parameter("mV", type="string", structural=True)
        low = Parameter(20.0, unit=lambda unit: unit, min=10.0)
        u = Input(3.0, unit="mV")

        @output(unit="V")
        def y(u):
            return u

        @output(unit="mV", every=1.0, offset=5.0, start=7.0)
        def held(u):
            return u

    diagram = Diagram("mixed")
    diagram.add("block", Mixed())
    assert end(diagram, "block.y") == pytest.approx(3e-3, rel=1e-15)
    assert end(diagram, "block.held") == pytest.approx(7e-3, rel=1e-15)
    with pytest.raises(ModelError, match=r"E107 .*at least 10"):
        diagram.add("other", Mixed(low=9.0))


def test_a_results_file_does_not_replace_what_the_run_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "through.json"
    through_gain(unit="V", default=1.0).save(path)
    before = path.read_bytes()
    assert main(["run", str(path), "--stop", "1", "--out", str(path)]) == 2
    assert "is also an input of this command" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_a_name_is_given_one_value(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "through.json"
    through_gain(unit="V").save(path)
    assert main(["run", str(path), "--stop", "1", "--input", "i=1", "--input", "i=2"]) == 2
    assert "a second value" in capsys.readouterr().err
    with pytest.raises(UsageError, match="E502"):
        through_gain(unit="V").run(stop=1.0)
