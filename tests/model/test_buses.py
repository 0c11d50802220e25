"""Buses: vectors whose elements have names, which Mux gives and wires carry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import Constant, Diagram, Gain, ModelError, Mux, Selector, Sine, Sum


def document(**changes: Any) -> dict[str, Any]:
    """A pose that goes into a subdiagram, where its parts are taken by name."""
    made: dict[str, Any] = {
        "format": "blocks-diagram", "version": 3, "name": "bus",
        "outputs": {"heading": "pose.y[theta]"},
        "blocks": {
            "x": {"type": "Constant", "parameters": {"value": 3, "unit": "m"}},
            "y": {"type": "Constant", "parameters": {"value": 4, "unit": "m"}},
            "theta": {"type": "Ramp", "parameters": {"unit": "rad"}},
            "pose": {"type": "Mux", "parameters": {"names": "x, y, theta"}},
            "turned": {"type": "Selector", "parameters": {"elements": [2, 0], "size": 3}},
            "inner": {"diagram": {
                "inputs": {"p": {"size": 2}}, "outputs": {"same": "p", "angle": "g.y"},
                "blocks": {"g": {"type": "Gain", "parameters": {"k": 2, "unit_u": "rad"}}},
                "wires": {"g.u": "p[theta]"},
            }},
            "far": {"type": "Gain", "parameters": {"unit_u": "m", "unit": "m"}},
        },
        "wires": {
            "pose.u1": "x.y", "pose.u2": "y.y", "pose.u3": "theta.y", "turned.u": "pose.y", "inner.p": "turned.y",
            "far.u": "inner.same[x]",
        },
        "run": {"stop": 1, "log": ["pose.y[theta]", "turned.y[theta]", "far.y", "inner.angle", "heading", "pose.y"]},
        "measures": {"turn": {"type": "peak", "of": "pose.y[theta]"}},
    }  # fmt: skip
    return made | changes


@pytest.mark.parametrize("engine", ["reference", "native"])
def test_elements_of_a_bus_are_named_wherever_it_arrives(engine: str, tmp_path: Path) -> None:
    results = Diagram.from_json(document()).run(engine=engine)
    for name in ("pose.y[theta]", "turned.y[theta]", "heading"):
        assert results[name][-1] == pytest.approx(1.0, rel=1e-12)
        assert results[name].unit == "rad"
    assert results["inner.angle"][-1] == pytest.approx(2.0, rel=1e-12)
    assert results["far.y"][-1] == 3.0
    assert np.asarray(results["pose.y"])[-1] == pytest.approx([3.0, 4.0, 1.0])
    assert results.measures["turn"] == pytest.approx(1.0, rel=1e-12)
    results.to_csv(tmp_path / "bus.csv")
    assert "turned.y[theta]" in (tmp_path / "bus.csv").read_text(encoding="utf-8").splitlines()[0]


def test_a_bus_is_the_vector_that_it_was() -> None:
    """The same bits as by numbers."""
    by_number = json.loads(json.dumps(document()).replace("[theta]", "[2]"))
    by_number["blocks"]["pose"]["parameters"] = {"size": 3}
    by_number["wires"]["far.u"] = "inner.same[1]"
    by_number["blocks"]["inner"]["diagram"]["wires"]["g.u"] = "p[0]"
    by_number["run"]["log"][1] = "turned.y[0]"
    ours, theirs = (Diagram.from_json(one).run() for one in (document(), by_number))
    assert np.array_equal(ours.values, theirs.values)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("pose.y[thet]", "E105 far.u: pose.y has no element \"thet\". Did you mean 'theta'? Elements: x, y, theta."),
        ("x.y[theta]", (
            'x.y has no element "theta". Its elements have no names. Use a number, as in "x.y[0]", '
            'or give names with the parameter "names" of a Mux; blocks with equations pass none on.'
        )),
        ("pose.z[theta]", 'E105 far.u: pose has no output "z".'),
        ("nobody.y[theta]", 'E105 far.u: the source "nobody.y[theta]" is not there.'),
        ("pose.y[theta]", "E104 far.u [m] <- pose.y[theta] [rad]: m and rad are different quantities."),
    ],
)  # fmt: skip
def test_a_name_that_is_not_there_is_told(text: str, said: str) -> None:
    made = document()
    made["wires"]["far.u"] = text
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(made).check()
    assert said in str(caught.value)


@pytest.mark.parametrize("names", ["x, x", "x", "x, 2", "x, a b", "x,,y", " , "])
def test_names_are_one_for_each_input_and_differ(names: str) -> None:
    with pytest.raises(ModelError, match=r"E107 .*names must be one for each input, different"):
        Diagram("d").add("bus", Mux(names=names, size=2))


def test_a_bus_in_python() -> None:
    d = Diagram("d")
    bus, part, out = d.add("bus", Mux(names="a, b")), d.add("part", Selector(elements=[1], size=2)), d.add("g", Gain())
    total = d.add("total", Sum())
    d.wire(bus.u1, d.add("one", Sine()).y)
    d.wire(bus.u2, d.add("two", Constant(value=5.0)).y)
    d.wire(part.u, bus.y)
    d.wire(out.u, part.y["b"])
    d.wire(total.u1, bus.y["a"])
    d.wire(total.u2, out.y)
    results = d.run(stop=1.0, log=["total.y", "bus.y[b]"])
    assert results["total.y"][-1] == pytest.approx(5.0 + np.sin(1.0), rel=1e-9)
    assert d.to_json()["wires"]["g.u"] == "part.y[b]"
    assert list(d.run(stop=1.0, log=[bus.y["b"]])) == ["bus.y[b]"]
    for wrong in ("", "a b", "a]", "0x"):
        with pytest.raises(IndexError, match="the name of an element of a bus"):
            _ = bus.y[wrong]


def test_results_tell_how_an_element_is_recorded_under_its_name() -> None:
    results = Diagram.from_json(document()).run(log=["pose.y"])
    assert results["pose.y[2]"][-1] == pytest.approx(1.0, rel=1e-12)
    with pytest.raises(KeyError, match=r"by number\. Use pose.y\[0\] to pose.y\[2\], or, .* add 'pose.y\[th"):
        _ = results["pose.y[theta]"]


def test_a_bus_passes_the_gates_of_a_subdiagram_and_variants_have_names_of_their_own() -> None:
    made = document()
    made["blocks"]["up"] = {"type": "CompareToConstant", "parameters": {"constant": 0.5}}
    made["blocks"]["inner"]["diagram"]["inputs"] = {"p": {"size": 2}}
    made["blocks"]["inner"]["enable"] = {"states": "held", "outputs": "held"}
    made["blocks"]["pose"]["variants"] = {"plain": {"type": "Mux", "parameters": {"size": 3}}}
    made["blocks"]["one"] = {"type": "Constant", "parameters": {"value": 1}}
    made["wires"] |= {"up.u": "one.y", "inner.enable": "up.y"}
    assert Diagram.from_json(made).run()["far.y"][-1] == 3.0
    made["blocks"]["pose"]["variant"] = "plain"
    with pytest.raises(ModelError, match=r'far.u: inner.same has no element "x". Its elements have no names'):
        Diagram.from_json(made).check()
