"""The controller that `ADRC` makes: against the files of diagrams/adrc, formulas and controllers built by hand."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import ADRC, NESO, SMESO, Diagram, Expression, ScheduledESO, Step, TransferFunction, UsageError, subdiagram
from blocks.analysis import adrc_gains, bandwidth_gains, controller
from blocks.cli import main
from blocks.library.adrc import ContinuousObserver
from tests.support.places import ROOT

GIVEN: dict[str, Any] = {"b0": 2.0, "omega_c": 4.0, "omega_o": 20.0, "lower": -5.0, "upper": 8.0}
POINTS = (0.03j, 0.7j, 4.0j, 25.0j, 300.0j)


def loop_of(control: Any, order: int = 2) -> Diagram:
    d = Diagram("loop")
    c, r = d.add("control", control), d.add("r", Step(at=0.5))
    plant = d.add("plant", TransferFunction(num=[2.0], den=[1.0, 1.0, 0.5, 0.3][: order + 1]))
    d.wire(c.r, r.y)
    d.wire(c.y, plant.y)
    d.wire(plant.u, c.u)
    return d


@pytest.mark.parametrize("order", [1, 2, 3])
def test_it_is_the_controller_of_the_repository(order: int) -> None:
    own = loop_of(ADRC(order, **GIVEN), order).run(stop=4.0)
    file = loop_of(subdiagram(ROOT / "diagrams" / "adrc" / f"adrc_{order}.json", **GIVEN), order).run(stop=4.0)
    for name in ("plant.y", "control.u", f"control.z{order + 1}"):
        assert (own[name] == file[name]).all()


@pytest.mark.parametrize("by", ["output", "error"])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_both_kinds_have_the_same_feedback(order: int, by: str) -> None:
    source = ADRC(order, b0=3.0, omega_c=4.0, omega_o=20.0, by=by).source
    assert isinstance(source, Diagram)
    made = source.linearize("y", "u", inputs={"r": 0.0, "y": 0.0})
    feedback = controller(order, adrc_gains(order, 4.0), bandwidth_gains(order, 20.0), 3.0).feedback
    assert [-made(s) for s in POINTS] == pytest.approx([feedback(s) for s in POINTS], rel=1e-9)
    to_u = source.linearize("r", "u", inputs={"r": 0.0, "y": 0.0})
    if by == "error":
        assert [to_u(s) for s in POINTS] == pytest.approx([feedback(s) for s in POINTS], rel=1e-9)
    else:
        assert to_u(1e9j) == pytest.approx(4.0**order / 3.0, rel=1e-6)


@pytest.mark.parametrize(
    ("words", "blocks"),
    [
        ({"observer": "reduced"}, {"eso": "ReducedESO"}),
        ({"observer": "generalized"}, {"eso": "GeneralizedESO"}),
        ({"observer": "cascade"}, {"eso": "CascadeESO"}),
        ({"observer": NESO}, {"eso": "NESO"}),
        ({"observer": SMESO}, {"eso": "SMESO"}),
        ({"by": "error"}, {"error": "Sum"}),
        ({"delay": 0.02}, {"late": "TransportDelay"}),
        ({"filter": "5 ms"}, {"filter": "FirstOrder"}),
        ({"derivatives": 1}, {}),
    ],
)
def test_each_form_brings_the_plant_to_the_wanted_value(words: dict[str, Any], blocks: dict[str, str]) -> None:
    d = loop_of(ADRC(2, **GIVEN, **words))
    if "derivatives" in words:
        d.wire("control.r2", d.add("still", Expression(expression="0*t")).y)
    flat = {block.path: block.interface.declaration.name for block in d.flatten().blocks}
    for name, kind in blocks.items():
        assert flat[f"control.{name}"] == kind
    results = d.run(stop=8.0, every=0.1)
    assert results["plant.y"][-1] == pytest.approx(1.0, abs=1e-3)
    assert results["control.u"].max() <= 8.0


def test_its_numbers_are_parameters_and_the_observer_follows_the_loop() -> None:
    d = loop_of(ADRC(2, b0=2.0, omega_c="4 rad/s"))
    other = loop_of(ADRC(2, b0=2.0, omega_c=6.0, omega_o=30.0))
    changed = d.run(stop=3.0, every=0.1, parameters={"control.omega_c": 6.0})
    assert (changed["plant.y"] == other.run(stop=3.0, every=0.1)["plant.y"]).all()
    swept = d.sweep({"control.omega_c": [2.0, 6.0]}, stop=3.0, every=0.1, log=["plant.y"])
    assert swept.signals["plant.y"][1][-1] == changed["plant.y"][-1]


def test_plain_numbers_are_in_the_declared_units() -> None:
    """The same controller in rad and V, and in deg and mV: b0 in deg/s2 for 1 mV, limits in mV."""

    def run(unit: str, unit_u: str, **words: Any) -> Any:
        d = Diagram("units")
        control = d.add("control", ADRC(2, unit=unit, unit_u=unit_u, omega_c=4.0, omega_o=20.0, **words))
        wanted = d.add("wanted", Step(at=0.5, unit="rad"))
        plant = d.add("plant", TransferFunction(num=[5.0], den=[1.0, 0.8, 4.0], unit="rad", unit_u="V"))
        d.wire(control.r, wanted.y)
        d.wire(control.y, plant.y)
        d.wire(plant.u, control.u)
        return d.run(stop=3.0, every=0.1)

    own = run("rad", "V", b0=5.0, lower=-1.2, upper=1.2)
    assert own["plant.y"].max() > 0.9
    other = run("deg", "mV", b0=math.degrees(5.0) / 1000, lower=-1200.0, upper=1200.0)
    texts = run("deg", "mV", b0="5 rad/(V.s2)", lower="-1.2 V", upper="1.2 V")
    for found in (other, texts):
        assert found["plant.y"] == pytest.approx(own["plant.y"], rel=1e-6, abs=1e-9)


def test_the_observer_gets_what_the_delayed_plant_gets() -> None:
    d = loop_of(ADRC(2, **GIVEN, delay=0.1))
    results = d.run(stop=2.0, every=0.01, log=["control.late.y", "control.limit.y"])
    assert results["control.late.y"][110:] == pytest.approx(results["control.limit.y"][100:-10], abs=1e-3)
    assert (results["control.late.y"][:10] == 0.0).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"order": 0}, "ADRC order"),
        ({"order": True}, "ADRC order"),
        ({"order": 2.0}, "ADRC order"),
        ({"observer": "lineal"}, "Did you mean 'linear'?"),
        ({"observer": 3}, "or a block class"),
        ({"observer": Step}, "Step is no observer of order 2: it has y"),
        ({"observer": ScheduledESO}, "ScheduledESO is no observer of order 2: it has bandwidth"),
        ({"b0": "2 Hz", "unit": "rad", "unit_u": "V"}, "different quantities"),
        ({"by": "both"}, '"output" or "error"'),
        ({"derivatives": 2}, "from 0 to 1"),
        ({"omega_c": "fast"}, "ADRC omega_c"),
        ({"omega_o": "4 m"}, "different quantities"),
        ({"delay": []}, "ADRC delay"),
        ({"delay": True}, "ADRC delay"),
        ({"b0": 0.0}, "ADRC b0: must be other than 0"),
        ({"omega_c": 0.0}, "ADRC omega_c: must be above 0"),
        ({"omega_o": -3.0}, "ADRC omega_o: must be above 0"),
        ({"filter": 0.0}, "ADRC filter: must be above 0"),
        ({"lower": "low", "unit_u": "V"}, "ADRC lower: must be a number, or a quantity in V"),
        ({"derivatives": 1, "by": "error"}, "estimates them"),
    ],
)
def test_what_cannot_be_is_refused(words: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError) as refused:
        ADRC(**words)
    assert refused.value.code == "E501"
    assert said in str(refused.value)


def test_an_observer_without_a_bandwidth_leaves_no_dead_parameter() -> None:
    class Fixed(ContinuousObserver):
        """A LESO at -20."""

        @ContinuousObserver.z.derivative  # type: ignore[untyped-decorator]
        def dz(z: Any, u: Any, e: Any, b0: Any) -> Any:
            return np.array([z[1] + 60.0 * e, z[2] + b0 * u + 1200.0 * e, 8000.0 * e])

    control = ADRC(2, b0=2.0, omega_c=4.0, observer=Fixed)
    known = loop_of(ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0)).run(stop=2.0, every=0.1)
    assert loop_of(control).run(stop=2.0, every=0.1)["plant.y"] == pytest.approx(known["plant.y"], abs=1e-6)
    assert "omega_o" not in control.source.value.parameters  # type: ignore[union-attr]
    with pytest.raises(UsageError, match="E501 ADRC omega_o: would do nothing: Fixed has no parameter bandwidth"):
        ADRC(2, b0=2.0, omega_c=4.0, omega_o=20.0, observer=Fixed)


def test_the_command_writes_it_as_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "control.json"
    assert main(["new", str(file), "--adrc", "reduced", "--order", "1", "--by", "error", "--unit", "rad"]) == 0
    assert '{"diagram": "control.json"' in capsys.readouterr().out
    made = loop_of(subdiagram(file, **GIVEN), 1).run(stop=2.0)
    own = loop_of(ADRC(1, **GIVEN, observer="reduced", by="error"), 1).run(stop=2.0)
    assert np.array_equal(made["plant.y"], own["plant.y"])
    for arguments, said in (
        ([str(file), "--adrc"], "exists"),
        ([str(tmp_path / "control"), "--adrc"], ".json"),
        ([str(tmp_path / "other.json"), "--adrc", "fast"], "observer"),
        ([str(tmp_path / "project"), "--order", "2"], "--adrc"),
        ([str(tmp_path / "project"), "--unit-u", "V"], "--unit-u"),
    ):
        assert main(["new", *arguments]) == 2
        assert said in capsys.readouterr().err
    assert main(["new", str(tmp_path / "dry.json"), "--adrc", "--dry-run"]) == 0
    assert not (tmp_path / "dry.json").exists()
