"""`Diagram.set`: another value of a parameter after the block was added; runs that are given it are the witness."""

from typing import Any

import numpy as np
import pytest

from blocks import BlocksError, Constant, Diagram, FirstOrder, Gain, PMDCMotor, Step, fmu, subdiagram


def inner(name: str = "inner") -> Diagram:
    d = Diagram(name)
    d.parameter("k", 2.0)
    gain = d.add("gain", Gain(k="=k"))
    lag = d.add("lag", FirstOrder(T=0.5))
    d.wire(gain.u, d.input("u"))
    d.wire(lag.u, gain.y)
    d.output("y", lag.y)
    return d


def outer() -> Diagram:
    d = Diagram("outer")
    d.parameter("height", 3.0, unit="V", doc="of the step")
    source = d.add("source", Step(after="=height", unit="V"))
    motor = d.add("motor", PMDCMotor())
    d.wire(motor.v, source.y)
    d.add("sub", inner())
    d.wire("sub.u", source.y)
    d.add("subs", subdiagram(inner("many")), copies=2)
    d.wire("subs.u[0]", source.y)
    d.wire("subs.u[1]", source.y)
    return d


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("motor.Ra", 0.3), ("motor.Ra", "300 mOhm"), ("motor.omega_start", {"value": 30, "unit": "rpm"}), ("height", 5),
        ("height", "500 mV"), ("source.at", np.float64(0.25)), ("sub.k", 5.0), ("sub.lag.T", "100 ms"), ("subs.k", 4.0),
        ("subs.lag.T", 0.25), ("subs.k", [1.0, 3.0]), ("*.lag.T", 0.25),
    ],
)  # fmt: skip
def test_a_run_after_it_is_the_run_that_is_given_the_value(name: str, value: object) -> None:
    words: dict[str, Any] = {"stop": 1, "every": 0.125, "engine": "reference"}
    words["log"] = ["motor.omega", "sub.y", "subs.y"]
    d, other = outer(), outer()
    given = other.run(parameters={name: value}, **words)
    before = d.run(**words)
    d.set(name, value)
    after = Diagram.from_json(d.dumps()).run(**words)
    assert any(not np.array_equal(after[key], before[key]) for key in after.names)
    assert all(np.array_equal(after[key], given[key]) for key in after.names)
    assert other.value == outer().value


def test_a_parameter_of_the_diagram_keeps_its_unit_and_its_text() -> None:
    d = outer()
    d.set("height", "500 mV")
    assert d.value.parameters["height"] == {"value": 0.5, "unit": "V", "doc": "of the step"}
    d.set("source.after", 7)  # in place of an expression
    assert d.run(stop=1, engine="reference")["source.y"][-1] == 7.0


def test_the_variant_that_is_chosen_changes_and_the_block_keeps_the_rest() -> None:
    d = Diagram("d")
    gain = d.add("gain", Gain(k=2.0), doc="one")
    d.wire(gain.u, d.add("one", Constant(value=1.0)).y)
    d.swap("gain", Gain(k=3.0), variant="other")
    d.set("gain.k", 5.0)
    ends = [d.run(stop=1, variants=v, engine="reference")["gain.y"][-1] for v in ({}, {"gain": "base"})]
    assert (ends, d.value.blocks["gain"].doc) == ([5.0, 2.0], "one")


def test_an_fmu_keeps_its_file_and_its_kind() -> None:
    d = Diagram("d")
    d.add("motor", fmu("fmus/PMDCMotor.fmu", kind="ME", Ra=0.2))
    d.set("motor.kb", 0.3)
    entry = d.value.blocks["motor"]
    assert (dict(entry.parameters), dict(entry.options)) == ({"Ra": 0.2, "kb": 0.3}, {"kind": "ME"})


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("motor.Rq", 1, "E106 motor.Rq: there is no such parameter to set. Did you mean 'motor.Ra'?"),
        ("moto.Ra", 1, "E106 moto.Ra: there is no such parameter to set. Did you mean 'motor.Ra'?"),
        ("*.Rq", 1, "E106 *.Rq: there is no such parameter to set."),
        ("motor", 1, "E106 motor: there is no such parameter to set."),
        ("subs[1].k", 1, "E106 subs[1].k: there is no such parameter to set."),
        ("motor.Ra", "3 V", "E104 motor.Ra: [V] is given, but [Ohm] is needed"),
        ("motor.Ra", -1, "E107 motor.Ra: must be at least 0.0 Ohm, not -1.0 Ohm."),
        ("motor.Ra", "=nothing", "E108 motor.Ra:"),
        ("height", "3 s", "E104 height:"),
        ("sub.lag.T", -1, "E107 lag.T: must be above 0"),
        ("motor.Ra", object(), "E501"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(name: str, value: object, told: str) -> None:
    d = outer()
    with pytest.raises(BlocksError) as caught:
        d.set(name, value)
    assert str(caught.value).startswith(told)
    assert d.value == outer().value
