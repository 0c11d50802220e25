"""A bare number is in the unit that its place declares, wherever it stands; another unit is said with it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Block, Constant, Diagram, Gain, Input, ModelError, Noise, Parameter, Step, UsageError, output
from blocks.cli import main
from blocks.compile.bindings import bindings


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


# --- units that follow from sizes and from computed values --------------------------------------------------------


class Angles(Block):
    """Angles."""

    a = Parameter([90.0, 30.0], shape="n", unit=lambda n: ("deg",) * n, min=-180.0, max=180.0)

    @output(shape=lambda n: n)
    def y(a):
        return a


class Speed(Block):
    """A speed whose unit follows from a computed default."""

    order = Parameter(1, type="int", structural=True)
    form = Parameter(lambda order: order, type="int", structural=True)
    speed = Parameter(30.0, unit=lambda form: "rpm" if form == 1 else "rad/s")

    @output
    def y(speed):
        return speed


class Pose(Block):
    """An angle and a length."""

    form = Parameter(1, type="int", structural=True)
    a = Parameter([90.0, 2.0], shape=2, unit=lambda form: ("deg", "mm"))

    @output(shape=2)
    def y(a):
        return a


@pytest.mark.parametrize(
    ("block", "wanted"),
    [
        (Angles(), [math.pi / 2, math.pi / 6]),
        (Angles(a=[60.0]), [math.pi / 3]),
        (Angles(a={"value": [1.0], "unit": "rad"}), [1.0]),
        (Speed(), [math.pi]),
        (Speed(speed=60.0), [2 * math.pi]),
        (Speed(form=2), [30.0]),
        (Speed(form=1, speed=60.0), [2 * math.pi]),
        (Speed(order=2, speed=60.0), [60.0]),
        (Pose(), [math.pi / 2, 0.002]),
        (Pose(a=[180.0, 1.0]), [math.pi, 0.001]),
    ],
)
def test_a_bare_number_is_in_its_unit_whatever_the_unit_follows_from(block: Block, wanted: list[float]) -> None:
    """By hand; that of a setting is of the same unit."""
    diagram = Diagram("d")
    diagram.add("s", block)
    flat = diagram.flatten()
    (settled,) = flat.blocks
    name = "speed" if isinstance(block, Speed) else "a"
    assert np.ravel(settled.resolved.values[name].value).tolist() == pytest.approx(wanted, rel=1e-15)
    (setting,) = [one for one in bindings(flat, None) if one.path == f"s.{name}"]
    assert setting.values == pytest.approx(wanted, rel=1e-15)
    if isinstance(block, Angles):
        assert (setting.display, setting.high) == ("deg", pytest.approx(math.pi))


def test_a_range_is_in_the_unit_that_follows_from_a_size() -> None:
    diagram = Diagram("d")
    with pytest.raises(ModelError, match=r"must be at most 180.0 deg, not \[6.28318531 0. *\] rad"):
        diagram.add("s", Angles(a=[360.0, 0.0]))


@pytest.mark.parametrize(
    ("given", "wanted"),
    [({"s.a": [180.0, 60.0]}, [math.pi, math.pi / 3]), ({"s.a[1]": 45.0}, [math.pi / 2, math.pi / 4])],
)
def test_other_values_are_in_the_unit_that_follows_from_a_size(given: Any, wanted: list[float]) -> None:
    diagram = Diagram("d")
    diagram.add("s", Angles())
    settings = {"stop": 0.1, "method": "rk4", "step": 0.1}
    model = diagram.prepare(**settings)
    for made in (diagram.run(parameters=given, **settings), model.run(parameters=given)):
        assert made["s.y"][-1].tolist() == pytest.approx(wanted, rel=1e-15)


FORMULA = """{
  "format": "blocks-diagram", "version": 3, "name": "formula",
  "blocks": {
    "f": {"type": "Expression", "parameters": {
      "k": [],
      "expression": "%s"}}
  }
}"""


@pytest.mark.parametrize(
    ("formula", "place", "message"),
    [
        ("t + 1/0", "6:21 f.expression", "'=t + 1/0', column 6: division by zero in 1.0 / 0.0."),
        ("t*(-8)**0.5", "6:21 f.expression", "a power takes a positive base"),
        ("t +", "6:21 f.expression", "expected a number, a name or '('"),
        ("t + k1", "4:10 f", "k must hold as many constants"),  # of two parameters
    ],
)
def test_what_one_parameter_must_be_is_said_at_its_place(
    formula: str, place: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "formula.json"
    path.write_text(FORMULA % formula, encoding="utf-8")
    with pytest.raises(ModelError) as error:
        Diagram.load(path).run(stop=1.0)
    (fault,) = error.value.faults
    assert (fault.code, f"{fault.line}:{fault.column} {fault.place}") == ("E107", place)
    assert message in fault.message
