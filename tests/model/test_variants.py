"""Variants of blocks and swapping: what is matched, what stays, what the file keeps, and which one runs."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blocks import (
    Block,
    BlocksError,
    Constant,
    Diagram,
    FirstOrder,
    FMUError,
    Gain,
    Input,
    Integrator,
    ModelError,
    Parameter,
    PMDCMotor,
    State,
    Step,
    Sum,
    TransferFunction,
    fmu,
    output,
    subdiagram,
)
from blocks.compile.coupling import Coupling
from blocks.model.diagram_value import BASE
from blocks.model.document import from_document
from blocks.model.fingerprint import fingerprint
from blocks.model.variants import match, port_of, taken
from blocks.results.comparison import compare
from blocks.studies import report, study
from tests.support.places import ROOT

MOTOR = ROOT / "fmus" / "PMDCMotor.fmu"


class Motor(Block):
    """The motor of the library, under other names: a plant as another tool exports it."""

    Ra = Parameter(155.7, unit="mOhm")
    Voltage_ = Input(unit="V")
    load = Input(0.0, unit="N.m")
    w = State(unit="rad/s", output=True)
    I = State(unit="A", output=True)
    hidden = State(unit="1")

    @w.derivative
    def dw(w, I, load):
        return (-0.3922 * 3.0 * w + 1.1882 * I - load / 3.0) / (0.2752 * 3.0)

    @I.derivative
    def dI(w, I, Voltage_, Ra):
        return (-1.185 * 3.0 * w - Ra * I + Voltage_) / 0.82

    @hidden.derivative
    def dhidden(hidden):
        return -hidden

    @output(unit="W")
    def power(Voltage_, I):
        return Voltage_ * I


def loop() -> Diagram:
    made = Diagram("loop", library=Motor)
    made.parameter("Ra", 0.2, unit="Ohm")
    r = made.input("r", unit="V", default=6.0)
    motor = made.add("motor", PMDCMotor(Ra="=Ra"))
    look = made.add("look", Gain(k=1.0, unit="rad/s", unit_u="rad/s"))
    made.wire(motor.v, r)
    made.wire(look.u, motor.omega)
    made.output("speed", motor.omega)
    made.measure("peak", "peak", "motor.omega")
    made.settings(stop=2, log=["motor.omega", "motor.i", "look.y"])
    return made


PORTS = {"v": "Voltage_", "tau": "load", "omega": "w", "i": "I"}


# --- matching --------------------------------------------------------------------------------------------------


def pairs(a: dict[str, str], b: dict[str, str], known: dict[str, str] | None = None) -> list[tuple[str, str, str]]:
    return [(one.name, one.own, one.how) for one in match(a, b, known)]


def test_ports_are_matched_by_name_then_by_spelling_then_by_unit() -> None:
    before = {"v": "V", "omega_r": "rad/s", "tau": "N.m", "free": ""}
    after = {"w": "rpm", "OmegaR": "deg/s", "v": "mV", "load": "N.m", "other": ""}
    assert pairs(before, after) == [("v", "v", "name"), ("omega_r", "OmegaR", "spelling"), ("tau", "load", "unit")]


def test_a_unit_decides_only_where_one_port_is_left_on_both_sides() -> None:
    assert pairs({"a": "V"}, {"x": "V", "y": "V"}) == []
    assert pairs({"a": "V", "b": "V"}, {"x": "V"}) == []
    assert pairs({"a": "V", "b": "V"}, {"b": "V", "y": "mV"}) == [("a", "y", "unit"), ("b", "b", "name")]
    assert pairs({"a": ""}, {"x": ""}) == [], "no unit says nothing"


def test_ports_of_different_quantities_are_no_pair_whatever_their_names() -> None:
    assert pairs({"y": "V"}, {"y": "A"}) == []
    assert pairs({"y": "V", "z": "A"}, {"y": "A"}) == [("z", "y", "unit")]
    assert pairs({"y": ""}, {"y": "A"}) == [("y", "y", "name")], "an unknown unit fits every other"


def test_spellings_that_are_two_of_a_kind_are_no_pair() -> None:
    assert pairs({"u_1": "", "U1": ""}, {"u1": ""}) == []
    assert pairs({"u_1": ""}, {"U1": "", "u1_": ""}) == []


def test_pairs_by_hand_come_first() -> None:
    assert pairs({"a": "", "b": ""}, {"a": "", "b": ""}, {"a": "b"}) == [("a", "b", "choice")]


NAMES = st.dictionaries(st.sampled_from(["a", "A", "a_", "b", "w", "W_1", "w1"]), st.sampled_from(["", "V", "mV", "A"]))


@given(NAMES, NAMES)
def test_no_port_has_two_partners_and_every_common_name_that_fits_is_a_pair(
    a: dict[str, str], b: dict[str, str]
) -> None:
    found = match(a, b)
    assert len({one.name for one in found}) == len(found) == len({one.own for one in found})
    quantity = {"": 0, "V": 1, "mV": 1, "A": 2}
    for one in found:
        first, second = quantity[a[one.name]], quantity[b[one.own]]
        assert not first or not second or first == second
    for name in a.keys() & b.keys():
        first, second = quantity[a[name]], quantity[b[name]]
        if not first or not second or first == second:
            assert (name, name) in [(one.name, one.own) for one in found]


@pytest.mark.parametrize(
    ("port", "own"), [("z", "y"), ("z[2]", "y[2]"), ("a[1]", "b"), ("other", "other"), ("other[0]", "other[0]")]
)
def test_an_element_keeps_its_index(port: str, own: str) -> None:
    assert port_of(port, {"z": "y", "a[1]": "b"}) == own


# --- swap ------------------------------------------------------------------------------------------------------


def test_a_block_in_a_subdiagram_is_swapped_by_its_path(tmp_path: Path) -> None:
    inner = Diagram("inner")
    inner.input("e")
    inner.wire(inner.add("k", Gain(k=2)).u, "e")
    inner.output("y", "k.y")
    middle = Diagram("middle")
    middle.input("e")
    middle.wire(middle.add("control", inner).e, "e")
    middle.output("y", "control.y")
    outer = Diagram("outer")
    outer.wire(outer.add("a", middle).e, outer.add("c", Constant(value=1)).y)
    swap = outer.swap("a.control.k", Gain(k=5), variant="strong")
    assert str(swap).startswith('a.control.k: Gain -> Gain, as the variant "strong", which is the default now')
    ends = [outer.run(stop=1, variants=chosen)["a.y"][-1] for chosen in ({}, {"a.control.k": "base"})]
    assert ends == [5, 2]
    outer.save(tmp_path / "outer.json")
    assert Diagram.load(tmp_path / "outer.json").run(stop=1)["a.y"][-1] == 5
    middle.save(tmp_path / "middle.json")
    linked = Diagram("linked", folder=tmp_path)
    linked.add("m", subdiagram("middle.json"))
    for path, said in (
        ("a.control.q", "E105 q: there is no such block. Blocks: k."),
        ("c.q", "E501 c: is not a subdiagram, so no block in it can be swapped here."),
    ):
        with pytest.raises(BlocksError) as caught:
            outer.swap(path, Gain())
        assert str(caught.value) == said
    with pytest.raises(BlocksError, match=r"E501 m: is a diagram in another file.*Load middle\.json, and swap"):
        linked.swap("m.control", Gain())


def test_a_swap_says_what_it_matched() -> None:
    diagram = loop()
    made = diagram.swap("motor", Motor(), ports={"omega": "w"})
    assert str(made) == "\n".join(
        [
            'motor: PMDCMotor -> Motor, as the variant "Motor", which is the default now',
            "  inputs: v -> Voltage_ (by unit) [V], tau -> load (by unit) [N.m]",
            "  outputs: omega -> w (by choice) [rad/s], i -> I (by spelling) [A]",
            "  only in Motor: power",
            "  parameters kept: Ra",
        ]
    )
    assert made.ports == PORTS
    assert repr(diagram).splitlines()[1] == "  motor: PMDCMotor (variants: base, [Motor])"


def test_the_wires_the_log_and_the_measures_stay_and_the_results_have_the_same_names() -> None:
    diagram = loop()
    before, first = diagram.to_json(), diagram.run(parameters={"Ra": 0.1557})
    diagram.swap("motor", Motor())
    after = diagram.to_json()
    assert {key: value for key, value in after.items() if key != "blocks"} == {
        key: value for key, value in before.items() if key != "blocks"
    }
    second = diagram.run(parameters={"Ra": 0.1557})
    assert list(second.columns) == list(first.columns) == ["motor.omega", "motor.i", "look.y"]
    assert compare(first, second, tolerance=1e-12).is_within
    assert second.measures == pytest.approx(first.measures)
    # A second witness: the other motor in a diagram of its own.
    own = Diagram("own", library=Motor)
    r = own.input("r", unit="V", default=6.0)
    own.wire(own.add("motor", Motor(Ra={"value": 0.1557, "unit": "Ohm"})).Voltage_, r)
    alone = own.run(stop=2)
    assert np.array_equal(alone["motor.w"], second["motor.omega"])


def test_the_block_that_was_there_is_taken_by_the_name_base() -> None:
    diagram = loop()
    first = diagram.run()
    diagram.swap("motor", Motor())
    again = diagram.run(variants={"motor": BASE})
    assert np.array_equal(first.values, again.values)
    assert first.origin is not None
    assert again.origin is not None
    assert first.origin.sha256 == again.origin.sha256, "what was computed is the same diagram"
    assert diagram.run().origin.sha256 != first.origin.sha256  # type: ignore[union-attr]
    assert diagram.with_variants({"motor": BASE}).value.blocks["motor"].variants == {}


def test_the_own_names_of_a_variant_can_be_recorded_and_wired_too() -> None:
    diagram = loop()
    diagram.swap("motor", Motor())
    made = diagram.run(log=["motor.omega", "motor.w", "motor.power"])
    assert np.array_equal(made["motor.omega"], made["motor.w"])
    assert list(diagram.run(log=["motor"]).columns) == ["motor.power", "motor.omega", "motor.i"]
    assert "motor.w" not in diagram.flatten(log=None).log
    motor = diagram["motor"]
    assert {"v", "tau", "omega", "i", "power"} == set(dir(motor))
    diagram.wire(diagram.add("heat", Gain(k=1.0, unit="W", unit_u="W")).u, motor.power)
    diagram.check()
    with pytest.raises(ModelError) as caught:
        diagram.check(variants={"motor": BASE})
    assert caught.value.code == "E105"


def test_a_port_that_is_used_and_has_no_partner_is_told_and_nothing_is_changed() -> None:
    diagram = loop()
    before = diagram.dumps()
    with pytest.raises(ModelError) as caught:
        diagram.swap("motor", FirstOrder())
    assert [str(fault) for fault in caught.value.faults] == [
        "E105 motor: the input v [V] (wires: motor.v) has no counterpart in the new block. "
        "The new block has u. To pair ports with different names, give ports={...}.",
        "E105 motor: the output omega [rad/s] (wires: look.u) has no counterpart in the new block. "
        "The new block has y. To pair ports with different names, give ports={...}.",
        "E105 motor: the output i [A] (run: log) has no counterpart in the new block. "
        "The new block has y. To pair ports with different names, give ports={...}.",
    ]
    assert diagram.dumps() == before
    diagram.settings(log=["look.y"])
    made = diagram.swap(
        "motor", FirstOrder(T=0.5), ports={"v": "u", "omega": "y"}, variant="rough", doc="a first guess"
    )
    assert made.left == ("tau", "i")
    assert made.dropped == (("Ra", "there is none of this name"),)
    assert diagram.run().columns.keys() == {"look.y"}
    assert diagram.to_json()["blocks"]["motor"]["variants"]["rough"]["doc"] == "a first guess"


@pytest.mark.parametrize(
    ("call", "code", "text"),
    [
        (lambda d: d.swap("moter", Motor()), "E105", "Did you mean 'motor'?"),
        (
            lambda d: d.swap("motor", Motor(), ports={"omga": "w"}),
            "E105",
            "has no port \"omga\". Did you mean 'omega'?",
        ),
        (lambda d: d.swap("motor", Motor(), ports={"omega": "x"}), "E105", 'has no output "x".'),
        (lambda d: d.swap("motor", Motor(), variant="base"), "E109", 'the variant "base" exists already'),
        (lambda d: d.swap("motor", Motor(), variant="a b"), "E111", "is not a name"),
        (lambda d: (d.swap("motor", Motor()), d.swap("motor", Motor())), "E109", 'the variant "Motor" exists already'),
        (lambda d: d.swap("motor", PMDCMotor), "E501", "is a class"),
        (lambda d: d.run(variants={"motor": "fmu"}), "E122", "It has none."),
        (lambda d: d.run(variants={"moter": "fmu"}), "E122", "there is no block with this path"),
    ],
)
def test_a_swap_that_cannot_be_meant_is_told(call: Any, code: str, text: str) -> None:
    with pytest.raises(ValueError, match=r"\w") as caught:
        call(loop())
    assert caught.value.code == code  # type: ignore[attr-defined]
    assert text in str(caught.value)


def test_a_parameter_in_another_unit_keeps_its_meaning() -> None:
    diagram = Diagram("d", library=Motor)
    diagram.add("motor", PMDCMotor(Ra=0.25, La=0.5))
    made = diagram.swap("motor", Motor())
    assert diagram.value.blocks["motor"].variants["Motor"].parameters["Ra"] == {"value": 0.25, "unit": "Ohm"}
    assert (made.kept, made.dropped) == (("Ra",), (("La", "there is none of this name"),))
    given = Diagram("d", library=Motor)
    given.add("motor", PMDCMotor(Ra=0.25))
    assert given.swap("motor", Motor(Ra=300.0)).kept == ()


def test_a_value_that_the_other_block_does_not_take_is_told() -> None:
    class Gentle(Block):
        """y = k u, with k up to 1."""

        k = Parameter(1.0, max=1.0)
        u = Input()

        @output
        def y(u, k):
            return k * u

    diagram = Diagram("d", library=Gentle)
    diagram.add("g", Gain(k=3.0))
    made = diagram.swap("g", Gentle())
    assert made.kept == ()
    assert made.dropped[0][0] == "k"
    assert "3" in made.dropped[0][1]
    assert str(made).splitlines()[-1].startswith("  parameter not kept: k: ")


def test_a_vector_keeps_its_elements() -> None:
    diagram = Diagram("d")
    plant = diagram.add("plant", TransferFunction(num=[1.0], den=[1.0, 1.0]))
    diagram.wire(plant.u, diagram.add("one", Step()).y)
    total = diagram.add("sum", Sum(signs="++"))
    diagram.wire(total.u1, plant.y)
    diagram.wire(total.u2, plant.y)
    diagram.settings(stop=1, log=["plant.y", "sum.y"])
    first = diagram.run(rtol=1e-10)
    diagram.swap("plant", FirstOrder(T=1.0))
    assert compare(first, diagram.run(rtol=1e-10), tolerance=1e-8).is_within


def test_a_subdiagram_takes_the_place_of_a_block_and_back() -> None:
    inner = Diagram("two_steps")
    voltage = inner.input("v", unit="V")
    inner.wire(inner.add("half", Gain(k=0.5, unit="rad/s", unit_u="V")).u, voltage)
    inner.output("omega", "half.y")
    inner.output("i", inner.add("none", Constant(value=0.0, unit="A")).y)
    diagram = loop()
    made = diagram.swap("motor", inner)
    assert (made.variant, made.after) == ("two_steps", "two_steps")
    assert float(diagram.run()["motor.omega"][-1]) == 3.0
    again = Diagram.from_json(diagram.dumps())
    assert again.dumps() == diagram.dumps()
    assert float(again.run(stop=1)["motor.omega"][-1]) == 3.0
    assert again.run(variants={"motor": BASE})["motor.omega"][-1] != 3.0
    # And a block in place of the subdiagram, which gives its outputs other names.
    other = Diagram("other")
    other.add("part", inner)
    other.wire("part.v", other.input("v", unit="V", default=2.0))
    other.output("speed", "part.omega")
    other.settings(stop=1, log=["part.omega"])
    assert float(other.run()["part.omega"][-1]) == 1.0
    other.swap("part", Gain(k=2.0, unit="rad/s", unit_u="V"), ports={"v": "u", "omega": "y"})
    assert float(other.run()["part.omega"][-1]) == 4.0


def test_a_variant_of_a_block_in_a_subdiagram_goes_by_its_path(tmp_path: Path) -> None:
    inner = loop()
    inner.swap("motor", Motor(Ra=300.0), variant="own")
    inner.save(tmp_path / "inner.json")
    outer = Diagram("outer", folder=tmp_path, library=Motor)
    for name in ("a", "b"):
        outer.add(name, Diagram.load(tmp_path / "inner.json", library=Motor))
    outer.settings(stop=1, log=["a.motor.omega", "b.motor.omega", "a.speed"])
    for source in (outer, Diagram.from_json(outer.dumps(), library=Motor)):
        made = source.run(variants={"b.motor": BASE})
        assert not np.array_equal(made["a.motor.omega"], made["b.motor.omega"])
        assert np.array_equal(made["a.motor.omega"], made["a.speed"])
    from_file = {"format": "blocks-diagram", "version": 3, "blocks": {k: {"diagram": "inner.json"} for k in ("a", "b")}}
    loaded = Diagram.from_json(from_file, folder=tmp_path, library=Motor)
    made = loaded.run(stop=1, variants={"b.motor": BASE}, log=["a.motor.omega", "b.motor.omega"])
    both = loaded.run(stop=1, log=["a.motor.omega", "b.motor.omega"])
    assert np.allclose(both["a.motor.omega"], both["b.motor.omega"], rtol=0, atol=1e-14)
    assert not np.array_equal(made["a.motor.omega"], made["b.motor.omega"])
    with pytest.raises(ModelError) as caught:
        loaded.check(variants={"c.motor": "own"})
    assert caught.value.faults[0].cure == "Did you mean 'a.motor'?"


def test_choosing_twice_changes_nothing_more() -> None:
    diagram = loop()
    diagram.swap("motor", Motor())
    once = taken(diagram.value)
    assert taken(once) is once
    assert taken(loop().value).blocks.keys() == once.blocks.keys()
    plain = loop().value
    assert taken(plain) is plain


def test_a_diagram_that_grows_without_end_does_not_take_for_ever() -> None:
    value = Diagram("leaf").value
    for _ in range(40):
        outer = Diagram("outer")
        outer._draft.value = replace(
            outer.value,
            blocks={n: replace(loop().value.blocks["motor"], type="", cls=None, diagram=value) for n in "ab"},
        )
        value = outer.value
    outer._draft.value = value
    with pytest.raises(ModelError) as caught:
        outer.check()
    assert caught.value.code == "E008"


# --- files -----------------------------------------------------------------------------------------------------


def document(**motor: Any) -> dict[str, Any]:
    return {
        "format": "blocks-diagram",
        "version": 3,
        "name": "d",
        "blocks": {"one": {"type": "Constant"}, "lag": {"type": "Integrator", **motor}},
        "wires": {"lag.u": "one.y"},
    }


def faults(source: dict[str, Any]) -> list[tuple[str, str]]:
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(source).check()
    return [(fault.code, fault.place) for fault in caught.value.faults]


def test_a_file_keeps_both_and_is_written_back_byte_for_byte() -> None:
    diagram = loop()
    diagram.swap("motor", Motor())
    text = diagram.dumps()
    assert (
        """  "motor": {
   "type": "PMDCMotor",
   "parameters": {"Ra": "=Ra"},
   "variant": "Motor",
   "variants": {
    "Motor": {"type": "Motor", "parameters": {"Ra": "=Ra"}, "ports": {PORTS}}
   }
  },
""".replace("{PORTS}", json.dumps(PORTS))
        in text
    )
    again = Diagram.from_json(text, library=Motor)
    assert again.dumps() == text
    assert again.value == diagram.value
    assert np.array_equal(again.run().values, diagram.run().values)


def test_a_variant_with_a_diagram_in_it_is_opened_up() -> None:
    inner = {"inputs": {"u": {}}, "outputs": {"y": "g.y"}, "blocks": {"g": {"type": "Gain"}}, "wires": {"g.u": "u"}}
    diagram = Diagram.from_json(document(variants={"sub": {"diagram": inner}}))
    text = diagram.dumps()
    assert '      "g": {"type": "Gain"}\n' in text
    assert Diagram.from_json(text).dumps() == text
    assert diagram.run(stop=1, variants={"lag": "sub"})["lag.y"][-1] == 1.0


@pytest.mark.parametrize(
    ("motor", "expected"),
    [
        ({"variant": "x"}, [("E122", "blocks.lag.variant")]),
        ({"variant": 5}, [("E004", "blocks.lag.variant")]),
        ({"variant": "a", "variants": {"b": {"type": "Gain"}}}, [("E122", "blocks.lag.variant")]),
        ({"variants": {"base": {"type": "Gain"}}}, [("E109", "blocks.lag.variants.base")]),
        ({"variants": {"a b": {"type": "Gain"}}}, [("E111", "blocks.lag.variants.a b")]),
        ({"variants": []}, [("E004", "blocks.lag.variants")]),
        ({"variants": {"a": 5}}, [("E004", "blocks.lag.variants.a")]),
        ({"variants": {"a": {}}}, [("E009", "blocks.lag.variants.a")]),
        ({"variants": {"a": {"type": "Gain", "variants": {}}}}, [("E003", "blocks.lag.variants.a.variants")]),
        ({"variants": {"a": {"type": "Gain", "variant": "x"}}}, [("E003", "blocks.lag.variants.a.variant")]),
        ({"variants": {"a": {"type": "Gain", "ports": []}}}, [("E004", "blocks.lag.variants.a.ports")]),
        ({"variants": {"a": {"type": "Gain", "ports": {"u": 1}}}}, [("E004", "blocks.lag.variants.a.ports.u")]),
        ({"ports": {"u": "u"}}, [("E003", "blocks.lag.ports")]),
        # Of a variant that is chosen:
        ({"variant": "a", "variants": {"a": {"type": "Gane"}}}, [("E103", "lag")]),
        ({"variant": "a", "variants": {"a": {"type": "Gain", "parameters": {"kk": 1}}}}, [("E106", "lag.kk")]),
        (
            {"variant": "a", "variants": {"a": {"type": "Gain", "ports": {"u": "uu"}}}},
            [("E105", "lag.uu"), ("E101", "lag.u")],
        ),
    ],
)
def test_faults_of_variants_are_told_in_their_place(motor: dict[str, Any], expected: list[tuple[str, str]]) -> None:
    assert sorted(faults(document(**motor))) == sorted(expected)


def test_a_fault_in_a_variant_stands_where_the_file_has_it(tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    path.write_text(
        """{"format": "blocks-diagram", "version": 3,
 "blocks": {
  "one": {"type": "Constant"},
  "lag": {"type": "Integrator",
   "variants": {
    "fine": {"type": "Gain"},
    "wrong": {"type": "Gain",
     "parameters": {"k": "text"},
     "ports": {"u": "uu"}}}}},
 "wires": {
  "lag.u": "one.y"}}
"""
    )
    diagram = Diagram.load(path)
    diagram.check()
    diagram.check(variants={"lag": "fine"})
    with pytest.raises(ModelError) as caught:
        diagram.check(variants={"lag": "wrong"})
    assert [(fault.code, fault.line) for fault in caught.value.faults] == [("E107", 8)]


def test_a_diagram_that_moves_takes_its_fmus_along(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    diagram = Diagram("d", folder=tmp_path)
    motor = diagram.add("motor", PMDCMotor())
    diagram.wire(motor.v, diagram.add("one", Constant(value=1.0, unit="V")).y)
    diagram.swap("motor", fmu(MOTOR))
    diagram.add("other", fmu(MOTOR))
    diagram.wire("other.v", "one.y")
    diagram.save(tmp_path / "deep" / "d.json")
    loaded = Diagram.load(tmp_path / "deep" / "d.json")
    for entry in (loaded.value.blocks["motor"].variants["fmu"], loaded.value.blocks["other"]):
        assert (tmp_path / "deep" / entry.fmu).resolve() == MOTOR
    loaded.check()


# --- FMUs ------------------------------------------------------------------------------------------------------


def test_the_paper_s_robot_with_fmus_is_what_swap_makes() -> None:
    folder = ROOT / "diagrams" / "paper"
    robot, swapped = Diagram.load(folder / "iadrc.json"), Diagram.load(folder / "iadrc_fmu.json")
    for name in ("motor_right", "motor_left"):
        robot.swap(name, fmu(MOTOR, kind="ME"), variant="me")
        made = robot.swap(name, fmu(MOTOR, kind="CS"))
        assert made.ports == {}
        assert made.kept == ("Jeq",)
        assert {one.how for one in (*made.inputs, *made.outputs)} == {"name"}
    robot.settings(master={"step": 0.001, "algorithm": "gauss-seidel", "order": 2})
    mine, kept = robot.to_json(), swapped.to_json()
    assert {**mine, "name": "", "doc": ""} == {**kept, "name": "", "doc": ""}
    assert isinstance(swapped.check(), Coupling)
    assert swapped.plan(stop=1, variants=dict.fromkeys(("motor_right", "motor_left"), BASE)).states
    back = dict.fromkeys(("motor_right", "motor_left"), BASE)
    first = Diagram.load(folder / "iadrc.json").run(stop=0.5)
    assert np.array_equal(first.values, swapped.run(stop=0.5, variants=back).values)
    assert "PMDCMotor" in swapped.draw()


def test_an_fmu_takes_the_place_of_a_block() -> None:
    diagram = loop()
    made = diagram.swap("motor", fmu(MOTOR, kind="CS", isolate=True, timeout=5.0))
    assert (made.variant, made.kept) == ("fmu", ("Ra",))
    entry = diagram.to_json()["blocks"]["motor"]["variants"]["fmu"]
    assert {key: entry[key] for key in ("kind", "isolate", "timeout", "parameters")} == {
        "kind": "CS",
        "isolate": True,
        "timeout": 5,
        "parameters": {"Ra": "=Ra"},
    }
    flat = Diagram.from_json(diagram.dumps()).flatten()
    foreign = next(block for block in flat.blocks if block.path == "motor").interface.declaration.foreign
    assert (foreign.kind, foreign.isolate, foreign.timeout) == ("CS", True, 5.0)
    assert [name for name in flat.log if name.startswith("motor")] == ["motor.omega", "motor.i"]


def test_integrators_are_swapped_in_a_loop_without_losing_their_start() -> None:
    diagram = Diagram("d")
    first = diagram.add("x", Integrator(y_start=2.0))
    diagram.wire(first.u, diagram.add("minus", Gain(k=-1.0)).y)
    diagram.wire("minus.u", first.y)
    diagram.settings(stop=1, log=["x.y"])
    before = diagram.run()
    diagram.swap("x", Integrator(), variant="again")
    assert np.array_equal(before.values, diagram.run().values)


def test_many_ports_are_matched_at_once() -> None:
    before = {f"port_{k}": "V" for k in range(5000)} | {"alone": "A"}
    after = {f"Port{k}": "mV" for k in range(5000)} | {"current": "mA"}
    found = match(before, after)
    assert len(found) == 5001
    assert (found[7].own, found[7].how, found[-1].own, found[-1].how) == ("Port7", "spelling", "current", "unit")


# --- what results are results of -------------------------------------------------------------------------------


def test_an_fmu_counts_by_its_bytes_and_its_kind(tmp_path: Path) -> None:
    def digest(path: Path, **options: Any) -> str:
        source = document()
        source["blocks"]["motor"] = {"fmu": path.name, "kind": "CS", **options}
        return fingerprint(from_document(source, folder=path.parent))

    paths = [tmp_path / name for name in ("a.fmu", "b.fmu", "c.fmu")]
    for path in paths:
        shutil.copy(MOTOR if path.stem != "c" else ROOT / "fmus" / "PMDCMotor_fmi2.fmu", path)
    assert digest(paths[0]) == digest(paths[1]) == digest(paths[1], isolate=True, timeout=5, doc="a motor")
    assert len({digest(paths[0]), digest(paths[2]), digest(paths[0], kind="ME"), digest(tmp_path / "none.fmu")}) == 4


def test_a_study_chooses_variants(tmp_path: Path) -> None:
    diagram = Diagram("d")
    diagram.add("x", Constant(value=1.0))
    diagram.swap("x", Constant(value=5.0), variant="five")
    diagram.measure("size", "peak", "x.y")
    diagram.settings(stop=1, master={"step": 0.1})
    diagram.save(tmp_path / "d.json")
    source = {
        "format": "blocks-study",
        "version": 1,
        "name": "s",
        "runs": {
            "one": {"diagram": "d.json", "variants": {"x": "base"}},
            "five": {"diagram": "d.json", "settings": {"master": {"step": 0.2, "steps": {"x": 0.1}}}},
        },
        "claims": [{"run": name, "measure": "size"} for name in ("one", "five")],
    }
    (tmp_path / "s.json").write_text(json.dumps(source))
    made = study.run(study.load(tmp_path / "s.json"))
    assert [verdict.value for verdict in made.verdicts] == [1.0, 5.0]
    text = report.write(made, tmp_path / "out", "blocks study s.json", draw=lambda d: d.draw()).read_text()
    assert "With x = base." in text
    assert "With master = step 0.2, steps x 0.1." in text
    source["runs"]["one"]["variants"] = {"x": 5}  # type: ignore[index]
    (tmp_path / "s.json").write_text(json.dumps(source))
    with pytest.raises(ModelError) as caught:
        study.load(tmp_path / "s.json")
    assert (caught.value.code, caught.value.faults[0].place) == ("E004", "runs.one.variants.x")


def test_the_paper_s_robot_runs_with_fmus_as_with_equations() -> None:
    robot = Diagram.load(ROOT / "diagrams" / "paper" / "iadrc_fmu.json")
    swapped = robot.run(stop=2)
    equations = robot.run(stop=2, variants=dict.fromkeys(("motor_right", "motor_left"), BASE))
    made = compare(equations, swapped, tolerance=1e-3)
    assert made.is_within, made
    assert made.only_a == made.only_b == ()
    assert made.worst.relative > 1e-9, "another algorithm: the FMUs did run"


def test_a_trusted_fmu_outside_the_project_runs(tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    shutil.copy(MOTOR, tmp_path / "there" / "m.fmu")
    source = {
        "format": "blocks-diagram",
        "version": 3,
        "inputs": {"v": {"unit": "V", "default": 6}},
        "blocks": {"motor": {"fmu": "../there/m.fmu", "kind": "CS"}},
        "wires": {"motor.v": "v"},
        "run": {"stop": 1, "master": {"step": 0.01}},
    }
    (tmp_path / "here" / "d.json").write_text(json.dumps(source))
    diagram = Diagram.load(tmp_path / "here" / "d.json")
    with pytest.raises(FMUError) as caught:
        diagram.run()
    assert caught.value.code == "E218"
    omega = float(diagram.run(trust=tmp_path / "there")["motor.omega"][-1])
    # A second witness: the motor of the library.
    own = Diagram.alone(PMDCMotor())
    assert omega == pytest.approx(float(own.run(stop=1, inputs={"v": 6.0, "tau": 0.0})["omega"][-1]), rel=1e-5)
    assert float(Diagram.alone(fmu(MOTOR, kind="CS")).run(stop=1, inputs={"v": 6.0})["omega"][-1]) == pytest.approx(
        omega, rel=1e-5
    )
