"""What a person gives as text: numbers with units, and patterns of signals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from blocks import LESO, Constant, Diagram, FirstOrder, Gain, ModelError, PMDCMotor, Step, UsageError, subdiagram


def motor(La: Any) -> Diagram:
    d = Diagram("drive")
    d.parameter("load", 0.1, unit="N.m")
    d.parameter("mode", "slow")
    d.input("extra", unit="V", default=0.0)
    d.add("source", Step(at=0.1, after=6, unit="V"))
    d.add("motor", PMDCMotor(La=La))
    d.add("motor_2", PMDCMotor())
    d.add("torque", Constant(value="=load", unit="N.m"))
    d.wire("motor.v", "source.y")
    d.wire("motor.tau", "torque.y")
    d.wire("motor_2.v", "extra")
    d.settings(stop="500 ms", every=0.01)
    return d


@pytest.mark.usefixtures("native")
def test_a_number_with_a_unit_is_a_quantity_wherever_a_value_is_given() -> None:
    d, quantity = motor("2 mH"), {"value": 2, "unit": "mH"}
    assert d.value.blocks["motor"].parameters["La"] == quantity
    assert d.value.run["stop"] == {"value": 500, "unit": "ms"}
    other = motor(0.001)
    expected = other.run(parameters={"motor.La": quantity, "load": 0.2})["motor.omega"]

    assert np.array_equal(d.run(parameters={"load": "200 mN.m"})["motor.omega"], expected)
    given = {"motor.La": "2 mH", "load": "0.2 N.m"}
    assert np.array_equal(other.run(parameters=given, stop="0.5 s")["motor.omega"], expected)
    assert np.array_equal(other.prepare(parameters=given).run()["motor.omega"], expected)
    model = other.prepare()
    for _ in range(2):  # the second one binds values anew
        assert np.array_equal(model.run(parameters=given)["motor.omega"], expected)
    rows = other.batch(["motor.La", "load"], log=["motor.omega"])([["2 mH", "20 N.cm"], [0.002, 0.2]])
    assert np.array_equal(rows.signals["motor.omega"][0], rows.signals["motor.omega"][1])
    run = other.start()
    run.set("motor.La", "2 mH")
    run.set("extra", "3000 mV")
    run.advance("10 ms")
    assert run.given == {"motor.La": "2 mH"}
    assert (run.t, run["extra"]) == (0.01, 3.0)
    assert other.run(inputs={"extra": "3 kV"})["extra"][0] == 3000.0
    outer = Diagram("outer")
    outer.add("drive", subdiagram(other, load="1 N.m", mode="2 mH"))
    assert outer.value.blocks["drive"].parameters == {"load": {"value": 1, "unit": "N.m"}, "mode": "2 mH"}
    assert outer.flatten(parameters={"drive.motor.La": "2 mH"}).blocks[1].resolved.values["La"].value == 0.002


def gains(*values: Any) -> Diagram:
    """An observer with gains in 1/s, 1/s2 and 1/s3."""
    d = Diagram("observer")
    d.add("eso", LESO(gains=list(values), unit="rad/s", unit_u="V"))
    d.add("y", Step(at=0.1, unit="rad/s"))
    d.add("u", Constant(value=0.5, unit="V"))
    d.wire("eso.y", "y.y")
    d.wire("eso.u", "u.y")
    d.settings(stop=0.5, every=0.05, log=["eso.z3"])
    return d


@pytest.mark.usefixtures("native")
@pytest.mark.parametrize("given", [600, "600 1/s2", "0.0006 1/ms2", {"value": 600, "unit": "1/s2"}])
def test_an_element_is_set_in_its_own_unit_where_units_differ(given: Any) -> None:
    d, name = gains(30, 500, 1500), "eso.gains[1]"
    expected = gains(30, 600, 1500).run()["eso.z3"]
    assert np.array_equal(d.run(parameters={name: given})["eso.z3"], expected)
    assert np.array_equal(d.prepare().run(parameters={name: given})["eso.z3"], expected)
    rows = d.batch([name], log=["eso.z3"])([[given], [500.0]])
    assert np.array_equal(rows.signals["eso.z3"][0], expected)
    assert np.array_equal(rows.signals["eso.z3"][1], d.run()["eso.z3"])
    assert d.sweep({name: [given]}).units[name] == "1/s2"
    run = d.start()
    run.set(name, given)
    run.advance_to(0.5)
    assert np.array_equal(run["eso.z3"], expected[-1])
    assert run.given == {"eso.gains": "[30 1/s, 600 1/s2, 1500 1/s3]"}


def test_an_element_takes_no_other_quantity_than_its_own() -> None:
    with pytest.raises(ModelError, match=r"E104 eso.gains\[1\]: \[1/s\] is given, but \[1/s2\] is needed"):
        gains(30, 500, 1500).run(parameters={"eso.gains[1]": "600 1/s"})


@pytest.mark.usefixtures("native")
def test_a_single_number_that_fills_an_array_shows_how_many_elements_it_fills() -> None:
    d = gains(30, 500, 1500)
    run = d.start(parameters={"eso.gains": 20})
    assert run.given == {"eso.gains": "20 (all 3 elements)"}
    run.advance_to(0.5)
    assert np.array_equal(run["eso.z3"], gains(20, 20, 20).run()["eso.z3"][-1])
    assert d.sweep({"eso.gains": [20, 30]}).units["eso.gains"] == ""
    assert d.start(parameters={"eso.b0": 2}).given == {"eso.b0": "2 rad/(s3.V)"}


@pytest.mark.usefixtures("native")
def test_a_sweep_tells_quantities_in_the_unit_of_the_parameter() -> None:
    d = motor(0.001)
    d.measure("peak", "peak", "motor.omega")
    sweep = d.sweep({"motor.La": ["2 mH", "3 mH", 0.004]})
    assert sweep.varied["motor.La"].tolist() == [0.002, 0.003, 0.004]


def test_a_text_stays_a_text_where_the_parameter_is_one() -> None:
    d = Diagram("texts")
    d.add("gain", Gain(k=2.0))
    d.input("u", default=0.0)
    d.wire("gain.u", "u")
    d.parameter("mode", "slow")
    with pytest.raises(ModelError, match="not the text"):
        d.run(stop=1, parameters={"gain.k": "2"})
    assert d.start(stop=1, parameters={"mode": "2 mH"}).prepared.parameters == {"mode": "2 mH"}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("2 mX", "E114 motor.La: the unit 'mX' cannot be read at character 1: 'mX' is not known."),
        ("2 V", "E104 motor.La: [V] is given, but [H] is needed: they are different quantities."),
        ("2,5 mH", "E107 motor.La: must be a number, not the text '2,5 mH'. Write decimals after a point: 2.5 mH."),
        ("big", "E107 motor.La: must be a number, not the text 'big'."),
        ("=nothing", "E108 motor.La:"),
    ],
)
def test_what_cannot_be_read_is_told_with_its_cure(given: str, told: str) -> None:
    with pytest.raises((ModelError, UsageError)) as caught:
        motor(0.001).run(parameters={"motor.La": given})
    assert str(caught.value).startswith(told)


# --- patterns of signals -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("log", "signals"),
    [
        (["motor*.omega"], ["motor.omega", "motor_2.omega"]),
        (["motor.*", "source.y"], ["motor.omega", "motor.i", "source.y"]),
        (["mot*_2"], ["motor_2.omega", "motor_2.i"]),  # no signal: all outputs of the blocks
        (["*"], ["extra"]),
        (["motor.omega", "*.omega"], ["motor.omega", "motor_2.omega"]),
    ],
)
def test_a_pattern_records_what_it_names(log: list[str], signals: list[str]) -> None:
    d = motor(0.001)
    assert list(d.run(log=log, stop=0.01)) == signals
    assert d.batch(["load"], log=log, stop=0.01).signals == tuple(signals)


def test_a_pattern_reaches_into_subdiagrams_name_by_name() -> None:
    d = Diagram("outer")
    inner = Diagram("inner")
    inner.wire("lag.u", inner.input("u"))
    inner.add("lag", FirstOrder(T=1.0))
    inner.output("y", "lag.y")
    d.add("left", inner)
    d.add("right", inner)
    d.wire("left.u", d.input("u", default=1.0))
    d.wire("right.u", "left.y")
    assert list(d.run(stop=1, log=["*.y"])) == ["left.y", "right.y"]
    assert list(d.run(stop=1, log=["*.lag.y"])) == ["left.lag.y", "right.lag.y"]
    d.settings(log=["le*.y"], stop=1)
    assert list(d.run()) == ["left.y"]


def test_a_pattern_that_names_nothing_is_refused_with_the_signals() -> None:
    with pytest.raises(ModelError) as caught:
        motor(0.001).run(log=["motor.*", "pump*.w"])
    told = 'E105 run.log: no signal or block matches "pump*.w". Signals: extra, source.y, motor.omega, motor.i, '
    assert str(caught.value).startswith(told)
