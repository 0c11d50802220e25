"""From a diagram to blocks, numbers and sources: what the wires mean, and every fault with its place and its cure."""

import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks import Block, Diagram, Input, ModelError, Parameter, output, wiring
from blocks.library import LIBRARY
from blocks.model.block_signals import element_of
from blocks.model.diagram_value import BlockEntry, DiagramValue
from blocks.model.document import from_document, load, loads
from blocks.model.flatten import Flat, flatten
from blocks.model.hierarchy import DiagramScope, spelling
from blocks.model.values import Column
from blocks.model.wires import BlockSource, InputSource, Source, ValueSource
from blocks.text.errors import Fault
from blocks.text.json_number import Number
from tests.support.places import ROOT

GAIN = {"type": "Gain"}
CONSTANT = {"type": "Constant"}
FOLDER = ROOT / "diagrams"


class Relay(Block):
    """y = u where on, else 0."""

    u = Input()
    on = Input(type="bool")

    @output
    def y(u, on):
        return np.where(on, u, 0.0)


class Negative(Block):
    """Whether u is below 0."""

    u = Input()

    @output(type="bool")
    def y(u):
        return u < 0


class Labels(Block):
    """Parameters of every kind."""

    label = Parameter("none", structural=True, type="string")
    count = Parameter(1, structural=True, type="int")
    flag = Parameter(False, type="bool")
    flags = Parameter([False, True], shape=2, type="bool")
    optional = Parameter(None)
    used = Parameter(lambda optional: 7.0 if optional is None else optional)
    matrix = Parameter([[1.0, 2.0], [3.0, 4.0]], shape=("n", "n"))

    @output(shape=lambda count: count)
    def y(flag, flags, used, matrix, count):
        return np.ones(count) * used


class Swap(Block):
    """[y0, y1] = [u1, u0]."""

    u = Input(shape=2)

    @wiring(shape=2)
    def y(u):
        return u[::-1]


class Doubled(Block):
    """Wiring that computes, which wiring must not."""

    u = Input(shape=2)

    @wiring(shape=2)
    def y(u):
        return 2 * u


class Zeros(Block):
    """Wiring that makes numbers up."""

    u = Input(shape=2)

    @wiring(shape=2)
    def y(u):
        return np.zeros(2)


class Shorter(Block):
    """Wiring that gives another size than it says."""

    u = Input(shape=2)

    @wiring(shape=2)
    def y(u):
        return u[:1]


class Fussy(Block):
    """An input with a default in millivolts, and a unit that follows from a parameter."""

    unit = Parameter("", structural=True, type="string")
    k = Parameter(1.0, unit=lambda unit: unit)
    u = Input(unit=lambda unit: unit)

    @output
    def y(u, k):
        return k * u


TYPES = {**LIBRARY, **{cls.__name__: cls for cls in (Relay, Negative, Labels, Swap, Doubled, Zeros, Shorter, Fussy)}}


def resolver(name: str) -> Any:
    if name not in TYPES:
        raise KeyError(*TYPES)
    return TYPES[name]


def document(**sections: Any) -> dict[str, Any]:
    return {"format": "blocks-diagram", "version": 3, "name": "d", **sections}


def flat(parameters: dict[str, Any] | None = None, /, **sections: Any) -> Flat:
    return flatten(from_document(document(**sections)), resolver, overrides=parameters)


def faults(parameters: dict[str, Any] | None = None, /, **sections: Any) -> tuple[Fault, ...]:
    with pytest.raises(ModelError) as caught:
        flat(parameters, **sections)
    return caught.value.faults


def only(parameters: dict[str, Any] | None = None, /, **sections: Any) -> Fault:
    made = faults(parameters, **sections)
    assert len(made) == 1, "\n".join(map(str, made))
    return made[0]


def told(fault: Fault) -> tuple[str, str, str, str]:
    return fault.code, fault.place, fault.message, fault.cure


def in_text(source: str) -> list[tuple[str, str, int, int]]:
    """(code, place, line, column) of the faults of a text."""
    with pytest.raises(ModelError) as caught:
        flatten(loads(source, file="d.json"), resolver)
    assert {fault.file for fault in caught.value.faults} == {"d.json"}
    return [(fault.code, fault.place, fault.line, fault.column) for fault in caught.value.faults]


def value_of(made: Flat, path: str) -> Any:
    block, _, name = path.rpartition(".")
    value = next(one.resolved.values[name] for one in made.blocks if one.path == block).value
    return value.tolist() if isinstance(value, np.ndarray) else value


def source_of(made: Flat, path: str) -> tuple[Any, ...]:
    """The sources of an input variable, by the paths of the blocks that they come from."""
    block, _, name = path.rpartition(".")
    sources = next(one.sources[name] for one in made.blocks if one.path == block)

    def shown(source: Source) -> str:
        match source:
            case BlockSource(block, variable, element):
                return f"{made.blocks[block].path}.{variable}[{element}]"
            case InputSource(element):
                return f"input {element}"
        return f"value {source.value}"

    return tuple(map(shown, sources))


# --- unwired inputs and unknown names --------------------------------------------------------------------------


def test_an_unwired_input_is_told_with_the_source_of_its_name() -> None:
    path = FOLDER / "paper" / "control_iadrc.json"
    source = json.loads(path.read_text(encoding="utf-8"))
    del source["wires"]["nlsef.z3"]
    fault = only(**{key: source[key] for key in ("parameters", "inputs", "outputs", "blocks", "wires")})
    assert told(fault) == ("E101", "nlsef.z3", "input is not wired.", 'Did you mean "nlsef.z3": "eso.z3"?')


def test_a_source_of_another_quantity_is_not_offered() -> None:
    motor = {"type": "PMDCMotor"}
    inputs = {"v": {"unit": "rad"}}
    assert only(inputs=inputs, blocks={"motor": motor}).cure == 'Add "motor.v": "block.output" to the wires.'
    inputs = {"v": {"unit": "mV"}}
    assert only(inputs=inputs, blocks={"motor": motor}).cure == 'Did you mean "motor.v": "v"?'


def test_a_source_whose_name_says_nothing_is_not_offered() -> None:
    pid = {"type": "PID", "parameters": {"unit": "rad/s", "unit_u": "V"}}
    step, none = {"type": "Step", "parameters": {"unit": "rad/s"}}, 'Add "pid.y": "block.output" to the wires.'
    wires = {"pid.r": "step.y"}
    assert only(blocks={"pid": pid, "step": step}, wires=wires).cure == none  # which is what it is compared with
    inputs = {"r": {"unit": "rad/s"}, "y": {"unit": "rad/s"}}
    assert only(blocks={"pid": pid}, inputs=inputs, wires={"pid.r": "r"}).cure == 'Did you mean "pid.y": "y"?'
    assert only(blocks={"pid": pid}, inputs=inputs, wires={"pid.r": "y"}).cure == none
    several = {**json.loads((FOLDER / "paper" / "control_iadrc.json").read_text(encoding="utf-8"))}
    several["blocks"]["other"], several["wires"] = several["blocks"]["eso"], {**several["wires"]}
    del several["wires"]["nlsef.z3"]
    several["wires"] |= {sink.replace("eso.", "other.", 1): source for sink, source in several["wires"].items()
                         if sink.startswith("eso.")}  # fmt: skip
    fault = only(**{key: several[key] for key in ("parameters", "inputs", "outputs", "blocks", "wires")})
    assert fault.cure == 'Add "nlsef.z3": "block.output" to the wires.'  # there are two


def test_an_input_with_a_default_may_stay_unwired() -> None:
    made = flat(blocks={"motor": {"type": "PMDCMotor"}}, inputs={"v": {}}, wires={"motor.v": "v"})
    assert source_of(made, "motor.tau") == ("value 0.0",)


def test_an_unknown_type_is_told_with_the_nearest_and_at_its_line() -> None:
    fault = only(blocks={"g": {"type": "Gian"}})
    cure = "Did you mean 'Gain'? `blocks list` shows the types; --library adds your own."
    assert told(fault) == ("E103", "g", 'there is no block type "Gian".', cure)
    assert "--library" in only(blocks={"g": {"type": "Zzzzzz"}}).cure
    source = '{"format": "blocks-diagram", "version": 3,\n "blocks": {\n  "g": {"type": "Gian"}}}'
    assert in_text(source) == [("E103", "g", 3, 17)]


def test_an_fmu_that_is_not_there_is_told_with_its_block() -> None:
    document = {"format": "blocks-diagram", "version": 3, "name": "d", "blocks": {"g": {"fmu": "a.fmu"}}}
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document).flatten()
    assert [(fault.code, fault.place) for fault in caught.value.faults] == [("E007", "g")]


def test_an_unknown_parameter_is_told_with_the_nearest_or_all() -> None:
    assert told(only(blocks={"m": {"type": "Step", "parameters": {"befor": 1}}})) == (
        "E106",
        "m.befor",
        "Step has no parameter of this name.",
        "Did you mean 'before'?",
    )
    assert only(blocks={"m": {"type": "Step", "parameters": {"zzz": 1}}}).cure.startswith(
        "Parameters of Step: unit, at,"
    )


def test_a_misspelt_parameter_that_must_be_given_is_told_once() -> None:
    fault = only(
        blocks={"z": {"type": "ZeroOrderHold", "parameters": {"perod": 1}}}, inputs={"u": {}}, wires={"z.u": "u"}
    )
    assert (fault.code, fault.place, fault.cure) == ("E106", "z.perod", "Did you mean 'period'?")
    assert only(blocks={"z": {"type": "ZeroOrderHold"}}).message == "must be given: it has no default."


def test_an_unknown_parameter_of_a_subdiagram_is_told() -> None:
    inner = {"parameters": {"gain": 1}}
    fault = only(blocks={"s": {"diagram": inner, "parameters": {"gian": 1}}})
    assert told(fault) == ("E106", "s.gian", "there is no such parameter.", "Did you mean 'gain'?")


def test_a_wire_to_or_from_an_unknown_block_is_told_with_the_nearest() -> None:
    made = faults(inputs={"r": {}}, blocks={"gain": GAIN}, wires={"gian.u": "r", "gain.u": "rr", "gain2.u": "gain.y"})
    assert [(f.code, f.place, f.cure) for f in made] == [
        ("E105", "gian.u", "Did you mean 'gain'?"),
        ("E105", "gain.u", "Did you mean 'r'?"),
        ("E105", "gain2.u", "Did you mean 'gain'?"),
    ]


def test_an_unknown_port_is_told_with_those_that_exist() -> None:
    wires = {"motor.volt": "motor.omga", "motor.v": "motor.zzz"}
    made = faults(blocks={"motor": {"type": "PMDCMotor"}}, wires=wires)
    assert [told(f) for f in made] == [
        ("E105", "motor.volt", 'motor has no output "omga".', "Did you mean 'omega'? Outputs: omega [rad/s], i [A]."),
        ("E105", "motor.volt", 'motor has no input "volt".', "Inputs: v [V], tau [N.m]."),
        ("E105", "motor.v", 'motor has no output "zzz".', "Outputs: omega [rad/s], i [A]."),
    ]


def test_a_wire_to_or_from_a_whole_block_is_told() -> None:
    made = faults(blocks={"g": GAIN, "h": GAIN}, wires={"g": "h.y", "h.u": "g"}, inputs={"u": {}})
    assert [(f.place, f.message) for f in made][:2] == [
        ("g", "is a block, not one of its inputs."),
        ("h.u", "g is a block, not a signal."),
    ]


def test_a_parameter_as_a_source_is_told_with_how_it_is_meant() -> None:
    fault = only(parameters={"k": 1}, blocks={"g": GAIN}, wires={"g.u": "k"})
    assert told(fault) == (
        "E105",
        "g.u",
        'the source "k" is a parameter, not a signal.',
        'Use a Constant with "value": "=k".',
    )


def test_a_wire_to_an_output_or_an_input_of_the_diagram_is_told() -> None:
    made = faults(inputs={"r": {}}, outputs={"y": "r"}, wires={"y": "r", "r": "r"})
    assert [told(f) for f in made] == [
        ("E105", "y", "is an output of the diagram, not an input of a block.", 'Move it to "outputs".'),
        ("E105", "r", "is an input of the diagram, but a wire must end at an input of a block.", ""),
    ]


def test_a_wire_that_is_written_backwards_is_told_with_its_turn() -> None:
    """One fault, and no second one that the input of g is not wired."""
    fault = only(blocks={"a": CONSTANT, "g": GAIN}, wires={"a.y": "g.u"})
    assert told(fault) == (
        "E112",
        "a.y",
        "a.y is an output, and g.u is an input.",
        'Write the input first: "g.u": "a.y".',
    )


def test_a_wire_between_two_inputs_or_two_outputs_is_told_with_what_there_is() -> None:
    made = faults(blocks={"a": CONSTANT, "g": GAIN}, wires={"a.y": "a.y", "g.u": "g.u"})
    assert [told(f) for f in made] == [
        ("E112", "a.y", "'y' is an output of a, but a wire must end at an input.", "Inputs: none."),
        ("E112", "g.u", "'u' is an input of g, but a wire must begin at an output.", "Outputs: y."),
    ]


def test_names_with_dots_do_not_reach_into_subdiagrams() -> None:
    inner = {"inputs": {"u": {}}, "outputs": {"y": "g.y"}, "blocks": {"g": GAIN}, "wires": {"g.u": "u"}}
    made = faults(blocks={"s": {"diagram": inner}}, wires={"s.g.u": "s.g.y"}, inputs={"u": {}})
    assert [(f.code, f.message) for f in made] == [
        ("E105", 's has no output "g.y".'),
        ("E105", 's has no input "g.u".'),
        ("E101", "input is not wired."),
    ]


# --- units, shapes and types -----------------------------------------------------------------------------------


def test_different_quantities_are_told_with_both_ends() -> None:
    source = (
        '{"format": "blocks-diagram", "version": 3,\n'
        ' "blocks": {"motor": {"type": "PMDCMotor"}, "kin": {"type": "Constant", "parameters": {"unit": "rad"}}},\n'
        ' "wires": {\n'
        '  "motor.v": "kin.y"}}'
    )
    assert in_text(source) == [("E104", "motor.v [V] <- kin.y [rad]", 4, 14)]
    fault = only(**{key: json.loads(source)[key] for key in ("blocks", "wires")})
    assert str(fault) == (
        "E104 motor.v [V] <- kin.y [rad]: V and rad are different quantities. "
        'Check the wire, or insert a Gain with "unit_u": "rad" and "unit": "V".'
    )


def test_units_of_one_quantity_fit_because_all_is_si_inside() -> None:
    made = flat(
        inputs={"r": {"unit": "mV", "default": 1200}}, blocks={"motor": {"type": "PMDCMotor"}}, wires={"motor.v": "r"}
    )
    assert (made.inputs[0].unit, made.inputs[0].default) == ("V", (1.2,))
    assert made.signals["r"].unit == "V"


def test_an_unknown_unit_of_an_input_or_a_block_is_told() -> None:
    assert only(inputs={"r": {"unit": "Volt"}}).code == "E114"
    fault = only(blocks={"s": {"type": "Sum", "parameters": {"unit": "furlong"}}})
    assert (fault.code, fault.place.split(".")[0]) == ("E114", "s")
    fault = only(blocks={"g": {"type": "Gain", "parameters": {"unit": "furlong", "k": 2}}})
    assert (fault.code, fault.place.split(".")[0]) == ("E114", "g")


def test_shapes_that_do_not_fit_are_told_with_both() -> None:
    blocks = {"m": {"type": "Mux"}, "g": GAIN, "d": {"type": "Demux", "parameters": {"size": 3}}, "c": CONSTANT}
    wires = {"m.u1": "c.y", "m.u2": "c.y", "g.u": "m.y", "d.u": "m.y"}
    made = faults(blocks=blocks, wires=wires)
    assert [told(f) for f in made] == [
        ("E110", "g.u", "is a single value, but m.y has 2 elements.",
         'Wire one element, as in "m.y[0]", or give the block "copies": 2.'),
        ("E110", "d.u", "has 3 elements, but m.y has 2 elements.", ""),
    ]
    plant = {"type": "StateSpace", "parameters": {"A": [[0]], "B": [[1]], "C": [[1]]}}
    made = faults(blocks={"p": plant, "c": CONSTANT, "g": GAIN}, wires={"p.u": "c.y", "g.u": "p.y"})
    assert [told(f)[1:] for f in made] == [
        ("p.u", "has 1 element, but c.y is a single value.", 'Wire its element: "p.u[0]".'),
        ("g.u", "is a single value, but p.y has 1 element.", 'Wire its element: "p.y[0]".'),
    ]
    fault = only(blocks={"d": blocks["d"], "c": CONSTANT}, wires={"d.u": "c.y"})
    assert told(fault)[2:] == (
        "has 3 elements, but c.y is a single value.",
        'Wire each element, as in "d.u[0]", or use a Mux.',
    )


def test_a_number_does_not_feed_a_bool_but_a_bool_is_0_or_1() -> None:
    blocks = {"c": CONSTANT, "r": {"type": "Relay"}, "n": {"type": "Negative"}}
    fault = only(blocks=blocks, wires={"r.u": "c.y", "r.on": "c.y", "n.u": "c.y"})
    assert told(fault)[:3] == ("E104", "r.on", "is a bool, but c.y is a number.")
    made = flat(blocks=blocks, wires={"r.u": "n.y", "r.on": "n.y", "n.u": "c.y"})
    assert source_of(made, "r.u") == ("n.y[0]",)


def test_a_bool_stays_one_through_mux_demux_and_borders() -> None:
    inner = {"inputs": {"on": {"type": "bool"}}, "outputs": {"on": "d.y2"}, "blocks": {}, "wires": {}}
    inner["blocks"] = {"m": {"type": "Mux"}, "d": {"type": "Demux"}, "c": CONSTANT}
    inner["wires"] = {"m.u1": "c.y", "m.u2": "on", "d.u": "m.y"}
    inner["outputs"] = {"through": "d.y2"}
    blocks = {"c": CONSTANT, "n": {"type": "Negative"}, "s": {"diagram": inner}, "r": {"type": "Relay"}}
    made = flat(blocks=blocks, wires={"n.u": "c.y", "s.on": "n.y", "r.u": "c.y", "r.on": "s.through"})
    assert source_of(made, "r.on") == ("n.y[0]",)
    assert made.signals["s.through"].type == "bool"
    assert made.signals["s.m.y"].type == "real"


# --- elements --------------------------------------------------------------------------------------------------


def test_elements_are_wired_one_by_one() -> None:
    blocks = {"d": {"type": "Demux"}, "g": GAIN}
    made = flat(inputs={"v": {"size": 3}}, blocks=blocks, wires={"d.u[1]": "v[0]", "d.u[0]": "v[2]", "g.u": "d.y2"})
    assert source_of(made, "d.u") == ("input 2", "input 0")
    assert source_of(made, "g.u") == ("input 0",)


def test_an_element_that_is_not_wired_is_told() -> None:
    fault = only(inputs={"v": {"size": 3}}, blocks={"d": {"type": "Demux"}}, wires={"d.u[1]": "v[0]"})
    assert told(fault)[:3] == ("E101", "d.u[0]", "this element of the input is not wired.")


@pytest.mark.parametrize("wires", [{"d.u": "v", "d.u[0]": "v[0]"}, {"d.u[0]": "v[0]", "d.u": "v"}])
def test_an_input_is_not_wired_as_a_whole_and_by_element(wires: dict[str, str]) -> None:
    fault = only(inputs={"v": {"size": 2}}, blocks={"d": {"type": "Demux"}}, wires=wires)
    assert (fault.code, fault.place, fault.cure) == ("E109", [*wires][1], "Keep one of the two.")


def test_elements_out_of_range_and_of_single_values_are_told() -> None:
    blocks = {"d": {"type": "Demux"}, "g": GAIN, "h": GAIN, "k": GAIN}
    wires = {"d.u[2]": "r", "g.u[0]": "r", "h.u": "r[0]", "k.u": "v[7]"}
    made = faults(inputs={"r": {}, "v": {"size": 3}}, blocks=blocks, wires=wires)
    assert [told(f) for f in made] == [
        ("E105", "d.u[2]", "'u' has 2 elements, so there is no [2].", "Elements are counted from 0."),
        ("E105", "g.u[0]", "'u' is a single value, so there is no [0].", 'Write "g.u".'),
        ("E105", "h.u", "r is a single value, so there is no [0].", 'Write "r".'),
        ("E105", "k.u", "v has 3 elements, so there is no [7].", "Elements are counted from 0."),
    ]


@pytest.mark.parametrize("text", ["d.u[00]", "d.u[01]", "d.u[-1]", "d.u[]", "d.u[0 ]", "d.u[0][0]", "d.u[99999999999]"])
def test_an_element_has_one_spelling(text: str) -> None:
    made = faults(inputs={"v": {"size": 2}}, blocks={"d": {"type": "Demux"}}, wires={"d.u[0]": "v[0]", text: "v[1]"})
    assert (made[0].code, made[0].place) == ("E105", text)


# --- wiring blocks and borders ---------------------------------------------------------------------------------


def test_mux_and_demux_dissolve_and_keep_the_units() -> None:
    blocks = {
        "a": {"type": "Constant", "parameters": {"unit": "V"}},
        "b": {"type": "Constant", "parameters": {"unit": "rad"}},
        "m": {"type": "Mux"},
        "w": {"type": "Swap"},
        "d": {"type": "Demux"},
        "motor": {"type": "PMDCMotor"},
    }
    wires = {"m.u1": "a.y", "m.u2": "b.y", "w.u": "m.y", "d.u": "w.y", "motor.v": "d.y2"}
    made = flat(blocks=blocks, wires=wires)
    assert source_of(made, "motor.v") == ("a.y[0]",)
    assert made.signals["m.y"].units == ("V", "rad")
    assert made.signals["w.y"].units == ("rad", "V")
    assert (made.signals["m.y"].unit, made.signals["d.y1"].unit) == ("", "rad")
    fault = only(blocks=blocks, wires={**wires, "motor.v": "d.y1"})
    assert fault.place == "motor.v [V] <- d.y1 [rad]"


@pytest.mark.parametrize("name", ["Doubled", "Zeros", "Shorter"])
def test_wiring_that_does_more_than_wire_is_told(name: str) -> None:
    made = faults(inputs={"v": {"size": 2}}, blocks={"w": {"type": name}}, wires={"w.u": "v"})
    assert [(f.code, f.place) for f in made] == [("E110", "w.y")]


def nested(depth: int, **more: Any) -> dict[str, Any]:
    """A chain of subdiagrams, a Gain in the innermost; each passes k on."""
    body: dict[str, Any] = {"blocks": {"g": {"type": "Gain", "parameters": {"k": "=k"}}}, "wires": {"g.u": "u"}}
    body |= {"outputs": {"y": "g.y"}, "inputs": {"u": {}}, "parameters": {"k": 1}, **more}
    for _ in range(depth):
        body = {
            "parameters": {"k": 1},
            "inputs": {"u": {}},
            "outputs": {"y": "s.y"},
            "blocks": {"s": {"diagram": body, "parameters": {"k": "=k*2"}}},
            "wires": {"s.u": "u"},
        }
    return body


def test_subdiagrams_in_subdiagrams_dissolve() -> None:
    made = flat(inputs={"r": {}}, blocks={"s": {"diagram": nested(3), "parameters": {"k": 5}}, "h": GAIN},
                wires={"s.u": "r", "h.u": "s.y"})  # fmt: skip
    assert [block.path for block in made.blocks] == ["s.s.s.s.g", "h"]
    assert source_of(made, "s.s.s.s.g.u") == ("input 0",)
    assert source_of(made, "h.u") == ("s.s.s.s.g.y[0]",)
    assert value_of(made, "s.s.s.s.g.k") == 40.0
    assert made.signals["s.s.y"].sources == made.signals["s.s.s.s.g.y"].sources


def test_a_fault_deep_inside_has_its_whole_path_and_its_line() -> None:
    source = json.dumps(document(inputs={"r": {}}, blocks={"s": {"diagram": nested(2)}}, wires={"s.u": "r"}), indent=1)
    line = 1 + [*source.splitlines()].index(next(one for one in source.splitlines() if "Gain" in one))
    assert in_text(source.replace("Gain", "Gian")) == [("E103", "s.s.s.g", line, 21)]


def test_subdiagrams_more_than_thirty_deep_are_refused() -> None:
    from blocks import Diagram

    inner = Diagram("inner")
    for _ in range(31):
        outer = Diagram("outer")
        outer.add("s", inner)
        inner = outer
    with pytest.raises(ModelError, match=r"E008 .*more than 30 deep"):
        inner.check()


def test_an_input_of_a_subdiagram_must_be_wired_also_where_nothing_reads_it() -> None:
    fault = only(blocks={"s": {"diagram": {"inputs": {"u": {}}}}})
    assert told(fault)[:3] == ("E101", "s.u", "input is not wired.")


def test_an_unwired_input_of_a_subdiagram_is_told_once_however_many_read_it() -> None:
    inner = {
        "inputs": {"u": {}},
        "blocks": {"g": GAIN, "h": GAIN},
        "wires": {"g.u": "u", "h.u": "u"},
        "outputs": {"z": "u"},
    }
    assert only(blocks={"s": {"diagram": inner}}).place == "s.u"


def test_the_default_of_a_subdiagrams_input_is_in_its_unit_and_whole_for_vectors() -> None:
    inner = {
        "inputs": {"v": {"unit": "mV", "default": 1200}, "w": {"size": 2, "default": 3}},
        "blocks": {"motor": {"type": "PMDCMotor"}, "d": {"type": "Demux"}},
        "wires": {"motor.v": "v", "d.u": "w"},
        "outputs": {"first": "d.y1"},
    }
    made = flat(blocks={"s": {"diagram": inner}})
    assert source_of(made, "s.motor.v") == ("value 1.2",)
    assert made.signals["s.first"].sources == (ValueSource(3.0),)
    made = flat(blocks={"s": {"diagram": inner}}, inputs={"r": {"unit": "V"}}, wires={"s.v": "r", "s.w[1]": "r"})
    assert source_of(made, "s.motor.v") == ("input 0",)
    assert source_of(made, "s.d.u") == ("value 3.0", "input 0")


def test_a_border_checks_units_and_shapes() -> None:
    inner = {"inputs": {"u": {"unit": "V"}, "v": {"size": 2}}}
    made = faults(inputs={"r": {"unit": "A"}}, blocks={"s": {"diagram": inner}}, wires={"s.u": "r", "s.v": "r"})
    assert [(f.code, f.place) for f in made] == [("E104", "s.u [V] <- r [A]"), ("E110", "s.v")]


def test_a_border_without_a_unit_lets_the_unit_through() -> None:
    inner = {"inputs": {"u": {}}, "outputs": {"y": "u"}}
    blocks = {"s": {"diagram": inner}, "motor": {"type": "PMDCMotor"}}
    fault = only(inputs={"r": {"unit": "A"}}, blocks=blocks, wires={"s.u": "r", "motor.v": "s.y"})
    assert fault.place == "motor.v [V] <- s.y [A]"


# --- circles ---------------------------------------------------------------------------------------------------


THROUGH = {"diagram": {"inputs": {"u": {}}, "outputs": {"y": "u"}}}


@pytest.mark.parametrize(
    ("blocks", "wires", "chain"),
    [
        ({"s": THROUGH}, {"s.u": "s.y"}, "s.y -> s.u -> s.y"),
        ({"m": {"type": "Mux"}}, {"m.u1": "m.y[0]", "m.u2": "r"}, "m.y -> m.y"),
        (
            {"m": {"type": "Mux"}, "d": {"type": "Demux"}},
            {"m.u1": "d.y2", "m.u2": "r", "d.u": "m.y"},
            "d.y2 -> m.y -> d.y2",
        ),
        (
            {"a": THROUGH, "m": {"type": "Mux", "parameters": {"size": 1}}},
            {"a.u": "m.y[0]", "m.u1": "a.y"},
            "m.y -> a.u -> a.y -> m.y",
        ),
    ],
)
def test_wires_in_a_circle_are_told_with_the_circle(blocks: Any, wires: Any, chain: str) -> None:
    fault = only(inputs={"r": {}}, blocks=blocks, wires=wires)
    assert fault.code == "E102"
    circle = fault.message.removeprefix("wires form a circle that contains no value: ").removesuffix(".").split(" -> ")
    assert circle[0] == circle[-1]
    expected = chain.split(" -> ")[:-1]
    turns = [[*expected[k:], *expected[:k]] for k in range(len(expected))]
    assert circle[:-1] in turns


def test_a_long_chain_of_wiring_needs_no_recursion() -> None:
    count = 2000
    blocks: dict[str, Any] = {}
    wires = {}
    for k in range(count):
        blocks |= {f"m{k}": {"type": "Mux"}, f"d{k}": {"type": "Demux"}}
        wires |= {f"d{k}.u": f"m{k}.y"} | {f"m{k}.u{j}": f"d{k - 1}.y{j}" if k else "r" for j in (1, 2)}
    made = flat(inputs={"r": {}}, outputs={"y": f"d{count - 1}.y2"}, blocks=blocks, wires=wires)
    assert made.signals["y"].sources == (InputSource(0),)
    fault = only(
        outputs={"y": f"d{count - 1}.y2"}, inputs={"r": {}}, blocks=blocks, wires={**wires, "m0.u1": f"d{count - 1}.y1"}
    )
    assert fault.code == "E102"
    assert len(fault.message) < 500


# --- parameters ------------------------------------------------------------------------------------------------


def constant(value: Any, unit: str = "") -> dict[str, Any]:
    return {"type": "Constant", "parameters": {"value": value, "unit": unit}}


def test_a_bare_number_is_in_the_declared_unit_and_a_quantity_in_its_own() -> None:
    blocks = {"a": constant(3, "mV"), "b": constant({"value": 1200, "unit": "mOhm"}, "Ohm"), "c": constant(90, "deg")}
    made = flat(blocks=blocks)
    assert [value_of(made, f"{name}.value") for name in "abc"] == [0.003, 1.2, np.pi / 2]


def test_a_quantity_of_another_kind_is_told() -> None:
    fault = only(blocks={"a": constant({"value": 1, "unit": "V"}, "Ohm")})
    assert told(fault) == (
        "E104",
        "a.value",
        "[V] is given, but [Ohm] is needed: they are different quantities.",
        "A number without a unit is in Ohm.",
    )


def test_bound_parameters_follow_in_chains_and_in_any_order() -> None:
    parameters = {"c": "=b*2", "b": "=a+1", "a": 3}
    assert value_of(flat(parameters=parameters, blocks={"k": constant("=c")}), "k.value") == 8.0


def test_a_bare_reference_is_checked_against_its_unit_and_an_expression_is_in_si() -> None:
    parameters = {"R": {"value": 1200, "unit": "mOhm"}}
    made = flat(parameters=parameters, blocks={"a": constant("=R", "Ohm"), "b": constant("=R*2", "mOhm")})
    assert [value_of(made, f"{name}.value") for name in "ab"] == [1.2, 2.4]
    fault = only(parameters=parameters, blocks={"a": constant("=R", "V")})
    assert told(fault)[:3] == (
        "E104",
        "a.value",
        "R [Ohm] is given, but [V] is needed: they are different quantities.",
    )


def test_cycles_of_parameters_are_told_once_with_the_cycle() -> None:
    fault = only(parameters={"a": "=b", "b": "=c+1", "c": "=a", "d": "=a"}, blocks={"k": constant("=d")})
    assert fault.code == "E108"
    assert fault.message.startswith("needs itself: ")
    cycle = fault.message.removeprefix("needs itself: ").removesuffix(".").split(" -> ")
    assert cycle[0] == cycle[-1] == fault.place
    assert "".join(cycle[:-1]) in ("abc", "bca", "cab")
    assert only(parameters={"a": "=a+1"}).message == "needs itself: a -> a."


@pytest.mark.parametrize(
    ("raw", "part"),
    [
        ("=a+", "column 3: expected a number"),
        ("=", "expected a number"),
        ("=zz", "reads 'zz', which is not a known name here"),
        ("=1/0", "division by zero"),
        ("=v+1", "'v' is a list, not a number."),
        ("=t+1", "'t' is the text \"abc\", not a number."),
        ("=f*2", "'f' is true, not a number."),
        ("=" + "(" * 500, "nested"),
        ("=" + "a+" * 600 + "a", "the limit is 1000"),
    ],
)
def test_an_expression_that_cannot_be_computed_is_told(raw: str, part: str) -> None:
    parameters = {"a": 1, "v": [1, 2], "t": "abc", "f": True}
    fault = only(parameters=parameters, blocks={"k": constant(raw)})
    assert (fault.code, fault.place) == ("E108", "k.value")
    assert part in fault.message


def test_what_depends_on_a_fault_is_not_told_again() -> None:
    parameters = {"a": "=1/0", "b": "=a", "c": "=b*2", "d": ["=c", 1]}
    fault = only(parameters=parameters, blocks={"k": constant("=c"), "m": constant("=b")}, outputs={"y": "k.y"})
    assert fault.place == "a"


def test_vectors_texts_and_bools_are_passed_whole() -> None:
    blocks = {
        "e": {"type": "LESO", "parameters": {"gains": "=gains"}},
        "l": {"type": "Labels", "parameters": {"label": "=name", "flag": "=on", "matrix": "=matrix"}},
    }
    parameters = {"gains": [1, "=2*a", 3], "a": 4, "name": "V", "on": True, "matrix": [[1, 2], ["=a", 4]]}
    made = flat(parameters=parameters, inputs={"u": {}}, blocks=blocks, wires={"e.y": "u", "e.u": "u"})
    assert value_of(made, "e.gains") == [1.0, 8.0, 3.0]
    assert (value_of(made, "l.label"), value_of(made, "l.flag")) == ("V", 1.0)
    assert value_of(made, "l.matrix") == [[1.0, 2.0], [4.0, 4.0]]


def test_a_list_that_holds_an_expression_is_bound_and_waits_for_what_it_reads() -> None:
    sections = {"parameters": {"v": {"value": [1, ["=a"]]}, "a": "=b+1", "b": 1}}
    assert (
        only({"v": [1]}, **sections).message == 'is computed from other parameters ("=a"), so it cannot be set itself.'
    )
    assert only(parameters={"v": [1, "=w"], "w": "=v"}).message.startswith("needs itself: ")


def test_lists_of_bools_and_none_reach_a_block() -> None:
    made = flat(blocks={"l": {"type": "Labels", "parameters": {"flags": [True, False], "label": "==x"}}})
    assert (value_of(made, "l.flags"), value_of(made, "l.label")) == ([1.0, 0.0], "=x")
    assert value_of(made, "l.used") == 7.0


def test_two_equals_signs_begin_a_text() -> None:
    assert value_of(flat(blocks={"l": {"type": "Labels", "parameters": {"label": "==a"}}}), "l.label") == "=a"
    assert (
        value_of(
            flat(parameters={"p": "==a"}, blocks={"l": {"type": "Labels", "parameters": {"label": "=p"}}}), "l.label"
        )
        == "=a"
    )


def test_a_size_may_be_a_parameter() -> None:
    parameters = {"n": 3}
    blocks = {"e": {"type": "LESO", "parameters": {"order": "=n", "bandwidth": 5}}}
    made = flat(
        parameters=parameters, inputs={"u": {}}, blocks=blocks, wires={"e.y": "u", "e.u": "u"}, outputs={"y": "e.z4"}
    )
    assert len(value_of(made, "e.gains")) == 4
    made = flat({"n": 2}, parameters=parameters, inputs={"u": {}}, blocks=blocks, wires={"e.y": "u", "e.u": "u"})
    assert len(value_of(made, "e.gains")) == 3
    fault = only(parameters={"n": 2.5}, inputs={"u": {}}, blocks=blocks, wires={"e.y": "u", "e.u": "u"})
    assert (fault.code, fault.place) == ("E107", "e.order")


@pytest.mark.parametrize(
    ("raw", "code", "part"),
    [
        ("abc", "E107", "not the text"),
        (True, "E107", "must be a number"),
        ([1, 2], "E110", "shape"),
        ([1, [2]], "E107", "rows of equal length"),
        ([[[]]], "E110", "shape"),
        ({"value": "abc", "unit": "V"}, "E107", 'the text "abc" cannot have the unit [V].'),
        ({"value": True, "unit": "V"}, "E107", "true cannot have the unit [V]."),
        ({"value": 1, "unit": "Volt"}, "E114", "Volt"),
        ({"value": 1e308, "unit": "TV"}, "E107", "overflows"),
        (["a"], "E107", 'a list must hold numbers, not the text "a".'),
        ([True, True], "E107", "must be a number"),
        (["=t"], "E107", "a list must hold numbers"),
    ],
)
def test_a_value_of_the_wrong_kind_is_told(raw: Any, code: str, part: str) -> None:
    fault = only(parameters={"t": "abc"}, blocks={"k": constant(raw, "V")})
    assert (fault.code, fault.place) == (code, "k.value")
    assert part in fault.message


def test_one_unit_for_elements_of_different_quantities_is_told() -> None:
    def observer(gains: Any) -> dict[str, Any]:
        wires = {"e.y": "u", "e.u": "u"}
        return {"inputs": {"u": {}}, "wires": wires, "blocks": {"e": {"type": "LESO", "parameters": {"gains": gains}}}}

    assert only(**observer({"value": [1, 2, 3], "unit": "1/s"})).code == "E104"
    assert only(**observer("=g"), parameters={"g": {"value": [1, 2, 3], "unit": "V"}}).code == "E104"
    assert only(**observer([1, 2])).message == "has 2 elements, but 3 are needed."
    assert value_of(flat(**observer("=g"), parameters={"g": [1, 2, 3]}), "e.gains") == [1.0, 2.0, 3.0]


def test_a_text_with_a_unit_as_a_parameter_is_told() -> None:
    assert only(parameters={"a": {"value": "abc", "unit": "V"}}).place == "a"
    assert only(parameters={"a": {"value": 1, "unit": "Volt"}}).code == "E114"


def test_parameters_of_subdiagrams_take_values_in_their_unit() -> None:
    inner = {"parameters": {"R": {"value": 1, "unit": "mOhm"}}, "blocks": {"k": constant("=R", "Ohm")}}

    def given(raw: Any) -> dict[str, Any]:
        return {
            "blocks": {"s": {"diagram": inner, "parameters": {"R": raw}}},
            "parameters": {"r": {"value": 2, "unit": "Ohm"}},
        }

    assert value_of(flat(**given(5)), "s.k.value") == 0.005
    assert value_of(flat(**given("=r")), "s.k.value") == 2.0
    assert value_of(flat(**given("=r/2")), "s.k.value") == 1.0
    assert only(**given({"value": 1, "unit": "V"})).place == "s.R"
    assert only(**given("=R")).code == "E108"  # a subdiagram sees only what it is given, and so does the other side


def test_a_wrong_unit_of_a_subdiagrams_parameter_is_told_once() -> None:
    inner = {"parameters": {"R": {"value": 1, "unit": "Ohmm"}}, "blocks": {"k": constant("=R")}}
    assert only(blocks={"s": {"diagram": inner, "parameters": {"R": 1}}}).place == "s.R"


def test_a_period_stays_exact_through_units_and_expressions() -> None:
    from fractions import Fraction

    blocks = {"z": {"type": "ZeroOrderHold", "parameters": {"period": "=T/3", "offset": {"value": 100, "unit": "ms"}}}}
    made = flat(parameters={"T": {"value": 0.1, "unit": "min"}}, inputs={"u": {}}, blocks=blocks, wires={"z.u": "u"})
    assert [*made.blocks[0].resolved.clocks.values()] == [(Fraction(2), Fraction(1, 10))]


# --- overrides -------------------------------------------------------------------------------------------------


def test_parameters_are_set_by_path_on_every_level() -> None:
    inner = {"parameters": {"k": 1, "size": 2}, "blocks": {"c": constant("=k"), "l": {"type": "Labels"}}}
    sections = {
        "parameters": {"k": 1},
        "blocks": {"s": {"diagram": inner}, "c": constant("=k"), "p": constant(1, "mV")},
    }
    overrides = {"k": 2, "s.k": {"value": 3}, "s.l.count": 4, "p.value": {"value": 1, "unit": "V"}, "s.l.label": "=k"}
    with pytest.raises(ModelError, match=r"E107 s\.l\.label"):
        flat(overrides, **sections)
    del overrides["s.l.label"]
    made = flat(overrides, **sections)
    assert [value_of(made, path) for path in ("c.value", "s.c.value", "p.value")] == [2.0, 3.0, 1.0]
    assert made.signals["s.l.y"].shape == (4,)


def test_an_override_may_be_an_expression_over_later_parameters() -> None:
    made = flat({"a": "=2*b"}, parameters={"a": 1, "b": 5}, blocks={"c": constant("=a")})
    assert value_of(made, "c.value") == 10.0


def test_what_is_bound_cannot_be_set() -> None:
    inner = {"parameters": {"k": 1, "j": "=k"}, "blocks": {"c": constant("=j")}}
    sections = {"parameters": {"b": "=1+1"}, "blocks": {"s": {"diagram": inner, "parameters": {"k": "=b"}}}}
    for path, bound in (("b", "=1+1"), ("s.k", "=b"), ("s.j", "=k"), ("s.c.value", "=j")):
        fault = only({path: 1}, **sections)
        assert told(fault) == (
            "E117",
            path,
            f'is computed from other parameters ("{bound}"), so it cannot be set itself.',
            "Set the parameters that it is computed from.",
        )


def test_what_does_not_exist_cannot_be_set() -> None:
    made = faults({"c.valu": 1, "c": 1, "zzz": 1, "c\x1b.k": 1}, blocks={"c": constant(1)})
    assert [(f.code, f.place) for f in made] == [
        ("E106", "c.valu"),
        ("E106", "c"),
        ("E106", "zzz"),
        ("E106", '"c\\u001b.k"'),
    ]
    assert made[0].cure == "Did you mean 'c.value'?"


def test_a_wrong_override_has_no_place_in_the_file() -> None:
    value = loads(json.dumps(document(parameters={"a": 1}, blocks={"c": constant("=a")})), file="d.json")
    with pytest.raises(ModelError) as caught:
        flatten(value, resolver, overrides={"a": {"value": 1, "unit": "Volt"}})
    (fault,) = caught.value.faults
    assert (fault.code, fault.place, fault.file, fault.line) == ("E114", "a", "", 0)


# --- names that are recorded -----------------------------------------------------------------------------------


LOGGED = {
    "inputs": {"r": {}},
    "blocks": {"s": {"diagram": nested(1)}, "d": {"type": "Demux"}, "s2": GAIN},
    "wires": {"s.u": "r", "d.u[0]": "r", "d.u[1]": "s.y", "s2.u": "s.y"},
    "outputs": {"out": "d.y1"},
}


def test_without_a_log_all_is_recorded() -> None:
    made = flat(**LOGGED)
    assert made.log == ("r", "s.s.g.y", "d.y1", "d.y2", "s2.y", "out", "s.y", "s.s.y")


@pytest.mark.parametrize(
    ("log", "recorded"),
    [
        (["d.y2", "r"], ("d.y2", "r")),
        (["d"], ("d.y1", "d.y2")),
        (["s"], ("s.s.g.y", "s.y", "s.s.y")),
        (["s.s"], ("s.s.g.y", "s.s.y")),
        (["out", "out", "d"], ("out", "d.y1", "d.y2")),
        ([], ()),
    ],
)
def test_the_log_takes_signals_and_blocks(log: list[str], recorded: tuple[str, ...]) -> None:
    assert flat(**LOGGED, run={"log": log}).log == recorded


def test_an_element_of_a_signal_is_recorded() -> None:
    made = flat(inputs={"v": {"size": 3, "unit": "V"}}, run={"log": ["v[2]"]})
    assert made.log == ("v[2]",)
    signal = element_of("v[2]", made.signals)
    assert signal is not None
    assert (signal.sources, signal.shape, signal.unit) == ((InputSource(2),), (), "V")
    assert [element_of(name, made.signals) for name in ("v[3]", "v[-1]", "v[02]", "v[2][0]", "w[0]")] == [None] * 5


@pytest.mark.parametrize("name", ["", "s2.u", "d.y3", "s.", ".", "d.", "k", "s.u", "out[0]", "v\x07"])
def test_what_cannot_be_recorded_is_told(name: str) -> None:
    fault = only(**LOGGED, run={"log": [name]})
    assert (fault.code, fault.place) == ("E105", "run.log")
    assert str(fault).isprintable()


def test_a_name_that_no_other_fault_explains_is_told_beside_other_faults() -> None:
    blocks = {"a": {"type": "Gian"}, "b": GAIN, "c": CONSTANT}
    made = faults(
        blocks=blocks, wires={}, run={"log": ["a.y", "b.z", "c.y"]}, measures={"m": {"type": "IAE", "of": "a.y"}}
    )
    assert [(f.code, f.place) for f in made] == [("E103", "a"), ("E101", "b.u"), ("E105", "run.log")]


def test_names_that_results_could_not_tell_apart_are_refused() -> None:
    assert told(only(inputs={"u": {}}, outputs={"u": "u"}))[:3] == ("E109", "u", "is also the name of an input.")
    assert only(inputs={"time": {}}).message == "is the name that results give to their times."
    assert only(inputs={"u": {}}, outputs={"time": "u"}).code == "E109"


@pytest.mark.parametrize("name", ["class", "t", "tick", "lambda", "_", "__init__", "x" * 200, "parameters", "name"])
def test_any_identifier_is_a_name(name: str) -> None:
    inner = {
        "inputs": {name: {}},
        "outputs": {"y": f"{name}2.y"},
        "blocks": {f"{name}2": GAIN},
        "wires": {f"{name}2.u": name},
    }
    if len(name) < 200:
        made = flat(inputs={name: {}}, blocks={"s": {"diagram": inner}}, wires={f"s.{name}": name})
        assert source_of(made, f"s.{name}2.u") == ("input 0",)
    else:
        assert flat(blocks={name: CONSTANT}).log == (f"{name}.y",)


# --- measures --------------------------------------------------------------------------------------------------


def measured(parameters: Any = (), **measure: Any) -> dict[str, Any]:
    blocks = {"a": constant(1, "V"), "b": constant(1, "A"), "m": {"type": "Mux"}, "n": constant(2, "V")}
    return {
        "parameters": {"on": {"value": 1, "unit": "min"}, "level": {"value": 1, "unit": "mV"}, "label": "x"},
        "blocks": blocks,
        "wires": {"m.u1": "a.y", "m.u2": "b.y"},
        "measures": {"q": measure},
    }


def test_a_measure_knows_its_signals_and_its_window() -> None:
    made = flat(**measured(type="IAE", of="a.y", against="n.y", **{"from": 1, "to": "=on"})).measures[0]
    assert (made.name, made.type, made.of, made.against, made.start, made.stop) == ("q", "IAE", "a.y", "n.y", 1.0, 60.0)
    made = flat(**measured(type="peak", of="m.y[1]")).measures[0]
    assert (made.of, made.against, made.start, made.stop) == ("m.y[1]", 0.0, -np.inf, np.inf)


@pytest.mark.parametrize(
    ("raw", "value"), [(2, 2.0), ({"value": 5, "unit": "mV"}, 0.005), ("=level", 0.001), ("=2*level", 0.002)]
)
def test_a_measure_may_be_taken_against_a_number(raw: Any, value: float) -> None:
    assert flat(**measured(type="settling_time", of="a.y", against=raw, band=0.05)).measures[0].against == value


@pytest.mark.parametrize(
    ("measure", "code", "part"),
    [
        ({"type": "ITEA", "of": "a.y"}, "E116", "Did you mean 'ITAE'?"),
        ({"type": "zzz", "of": "a.y"}, "E116", "Measures: ITAE, IAE"),
        ({"type": "IAE", "of": "a.z"}, "E105", "there is no signal \"a.z\". Did you mean 'a.y'?"),
        ({"type": "IAE", "of": "a.y", "against": "zz"}, "E105", 'there is no signal "zz".'),
        (
            {"type": "IAE", "of": "m.y"},
            "E110",
            'm.y has 2 elements, but a measure needs one. Measure one element, as in "m.y[0]".',
        ),
        ({"type": "IAE", "of": "a.y", "against": "b.y"}, "E104", "a.y [V] and b.y [A] are different quantities."),
        (
            {"type": "IAE", "of": "a.y", "against": {"value": 1, "unit": "A"}},
            "E104",
            "[A] is given, but [V] is needed",
        ),
        ({"type": "IAE", "of": "a.y", "against": True}, "E116", '"against" must be a number.'),
        ({"type": "IAE", "of": "a.y", "against": "=label"}, "E116", '"against" must be a number.'),
        ({"type": "IAE", "of": "a.y", "against": [1]}, "E116", '"against" must be a number.'),
        ({"type": "IAE", "of": "a.y", "from": "1"}, "E116", '"from" must be a number.'),
        ({"type": "IAE", "of": "a.y", "from": {"value": 1, "unit": "V"}}, "E104", "[V] is given, but [s] is needed"),
        ({"type": "IAE", "of": "a.y", "from": 2, "to": 2}, "E116", "the window ends before it begins."),
        ({"type": "IAE", "of": "a.y", "to": "=zz"}, "E108", "'zz', which is not a known name here"),
        ({"type": "IAE", "of": "a.y", "band": 0.1}, "E116", "IAE has no band."),
        ({"type": "settling_time", "of": "a.y", "against": 1, "band": 0}, "E116", "between 0 and 1, not 0.0."),
        ({"type": "settling_time", "of": "a.y", "against": 1, "band": -1}, "E116", "between 0 and 1"),
        (
            {"type": "overshoot", "of": "a.y"},
            "E116",
            'overshoot needs the target value. Add "against": a number or a signal.',
        ),
    ],
)
def test_a_measure_that_cannot_be_taken_is_told(measure: dict[str, Any], code: str, part: str) -> None:
    fault = only(**measured(**measure))
    assert (fault.code, fault.place) == (code, "measures.q")
    assert part in f"{fault.message} {fault.cure}"


# --- all at once -----------------------------------------------------------------------------------------------


def test_all_faults_of_a_file_are_told_once_in_the_order_of_the_text() -> None:
    source = "\n".join(
        [
            '{"format": "blocks-diagram", "version": 3,',
            ' "parameters": {"a": "=b", "p": {"value": 1, "unit": "Vv"}},',
            ' "outputs": {"o": "g.z"},',
            ' "blocks": {',
            '  "g": {"type": "Gain"},',
            '  "h": {"type": "Gian"},',
            '  "c": {"type": "Constant", "parameters": {"valeu": 1}}},',
            ' "wires": {',
            '  "h.u": "c.y",',
            '  "q.u": "c.y"},',
            ' "run": {"stop": -1, "log": ["g.q", "h.y"]},',
            ' "measures": {"m": {"type": "IAE", "of": "h.y"}, "n": {"type": "AE", "of": "c.x"}}}',
        ]
    )
    assert in_text(source) == [
        ("E108", "a", 2, 22),
        ("E114", "p", 2, 54),
        ("E105", "o", 3, 19),
        ("E101", "g.u", 5, 3),
        ("E103", "h", 6, 17),
        ("E106", "c.valeu", 7, 44),
        ("E105", "q.u", 10, 3),
        ("E115", "run.stop", 11, 18),
        ("E105", "run.log", 11, 30),
        ("E116", "measures.n", 12, 64),
        ("E105", "measures.n", 12, 76),
    ]


def test_what_is_wrong_in_a_file_that_is_used_twice_is_told_once(tmp_path: Path) -> None:
    inner = document(inputs={"u": {}}, blocks={"g": {"type": "Gian"}, "h": GAIN})
    (tmp_path / "inner.json").write_text(json.dumps(inner))
    outer = document(inputs={"u": {}}, blocks={f"s{k}": {"diagram": "inner.json"} for k in range(3)})
    outer["wires"] = {f"s{k}.u": "u" for k in range(3)}
    (tmp_path / "outer.json").write_text(json.dumps(outer))
    with pytest.raises(ModelError) as caught:
        flatten(load(tmp_path / "outer.json"), resolver)
    assert [(f.code, f.place) for f in caught.value.faults] == [("E103", "s0.g"), ("E101", "s0.h.u")]


def test_values_that_differ_between_uses_are_told_for_each() -> None:
    inner = {"parameters": {"T": 1}, "inputs": {"u": {}}, "blocks": {}, "wires": {"z.u": "u"}}
    inner["blocks"] = {"z": {"type": "ZeroOrderHold", "parameters": {"period": "=T"}}}
    blocks = {f"s{k}": {"diagram": inner, "parameters": {"T": -k}} for k in range(3)}
    made = faults(inputs={"u": {}}, blocks=blocks, wires={f"s{k}.u": "u" for k in range(3)})
    assert [f.place for f in made] == ["s0.z.period", "s1.z.period", "s2.z.period"]


def test_a_thousand_faults_are_enough_and_come_soon() -> None:
    begun = time.process_time()
    made = faults(blocks={f"g{k}": GAIN for k in range(20_000)}, wires={f"g{k}.u": f"gg{k}.yy" for k in range(20_000)})
    assert len(made) == 1001
    assert (made[-1].code, made[-1].cure) == ("E008", "Correct these first.")
    assert time.process_time() - begun < 60


@pytest.mark.long
def test_the_time_grows_with_the_size_and_not_with_its_square() -> None:
    def seconds_for(count: int) -> float:
        blocks = {f"g{k}": {"type": "Gain", "parameters": {"k": k, "unit": "V"}} for k in range(count)}
        wires = {f"g{k}.u": f"g{k - 1}.y" if k else "r" for k in range(count)}
        parameters = {f"p{k}": f"=p{k + 1}+1" if k + 1 < count else 1 for k in range(count)}
        value = from_document(document(inputs={"r": {}}, parameters=parameters, blocks=blocks, wires=wires))
        begun = time.process_time()
        flatten(value, resolver)
        return time.process_time() - begun

    seconds_for(100)
    assert seconds_for(20_000) < 30 * max(seconds_for(2_000), 0.05)


# --- random wirings --------------------------------------------------------------------------------------------


INNER = [
    {"inputs": {"u": {}}, "outputs": {"y": "u"}},
    {
        "inputs": {"u": {"size": 2}},
        "outputs": {"y": "d.y1", "z": "u"},
        "blocks": {"d": {"type": "Demux"}},
        "wires": {"d.u": "u"},
    },
    nested(2),
    {
        "inputs": {"u": {"unit": "V", "default": 1}},
        "outputs": {"y": "g.y"},
        "blocks": {"g": GAIN},
        "wires": {"g.u": "u"},
    },
]
kinds = st.one_of(
    st.sampled_from(["Gain", "Sum", "Mux", "Demux", "Swap", "Integrator", "Constant", "Relay", "Negative"]).map(
        lambda name: {"type": name}
    ),
    st.sampled_from(INNER).map(lambda inner: {"diagram": inner}),
)
ports = st.sampled_from(["u", "u1", "u2", "u[0]", "u[1]", "y", "y1", "y2", "y[0]", "y[1]", "z", "on"])
ends = st.one_of(
    st.builds("b{}.{}".format, st.integers(0, 5), ports), st.sampled_from(["r", "v", "v[0]", "v[1]", "b0"])
)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(kinds, max_size=6), st.dictionaries(ends, ends, max_size=12), st.dictionaries(st.sampled_from("ab"), ends)
)
def test_a_random_wiring_is_flat_or_faulty(chosen: list[Any], wires: dict[str, str], outputs: dict[str, str]) -> None:
    blocks = {f"b{k}": block for k, block in enumerate(chosen)}
    sections = {"inputs": {"r": {}, "v": {"size": 2}}, "blocks": blocks, "wires": wires, "outputs": outputs}
    told: tuple[Fault, ...] = ()
    made = None
    try:
        made = flat(**sections)
    except ModelError as error:
        told = error.faults
    assert len(set(told)) == len(told)
    assert all(fault.code in {"E101", "E102", "E104", "E105", "E109", "E110", "E112"} for fault in told)
    for block in made.blocks if made is not None else ():
        for source in itertools.chain.from_iterable(block.sources.values()):
            if isinstance(source, BlockSource):
                origin = made.blocks[source.block].interface.declaration
                assert source.variable not in origin.outputs or not origin.outputs[source.variable].wiring


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_wiring_that_fits_is_flat(data: st.DataObject) -> None:
    """Gains and sums behind each other, in any order of the file, some in subdiagrams."""
    count = data.draw(st.integers(1, 8))
    blocks: dict[str, Any] = {}
    wires = {}
    known = ["r"]
    for k in range(count):
        kind = data.draw(st.sampled_from(["Gain", "Sum", "nested"]))
        blocks[f"b{k}"] = {"diagram": nested(2)} if kind == "nested" else {"type": kind}
        for port in ("u1", "u2") if kind == "Sum" else ("u",):
            wires[f"b{k}.{port}"] = data.draw(st.sampled_from(known))
        known.append(f"b{k}.y")
    order = data.draw(st.permutations(list(blocks)))
    made = flat(inputs={"r": {}}, blocks={name: blocks[name] for name in order}, wires=wires)
    assert len(made.blocks) == count


# --- blocks that are written alike -----------------------------------------------------------------------------


def test_blocks_that_are_written_alike_share_their_numbers() -> None:
    blocks = {f"g{k}": {**GAIN, "parameters": {"k": {"value": 2, "unit": "mOhm"}, "unit": "Ohm"}} for k in range(3)}
    blocks["other"] = {**GAIN, "parameters": {"k": {"value": 0.0020, "unit": "Ohm"}, "unit": "Ohm"}}
    made = flat(blocks={**blocks, "c": CONSTANT}, wires={f"{name}.u": "c.y" for name in blocks})
    resolved = {block.path: block.resolved for block in made.blocks}
    assert resolved["g0"] is resolved["g1"] is resolved["g2"]
    assert resolved["other"].interface is resolved["g0"].interface
    assert resolved["other"].values["k"].value == resolved["g0"].values["k"].value == 0.002


def test_the_same_expression_is_another_number_in_another_diagram() -> None:
    inner = {
        "parameters": {"k": 1},
        "outputs": {"y": "c.y"},
        "blocks": {"c": {"type": "Constant", "parameters": {"value": "=k"}}},
    }
    given = {"a": 3, "b": 4, "d": 3}
    made = flat(blocks={name: {"diagram": inner, "parameters": {"k": value}} for name, value in given.items()})
    assert [value_of(made, f"{name}.c.value") for name in given] == [3.0, 4.0, 3.0]


@pytest.mark.parametrize("wrong", [{"k": "text"}, {"kk": 1}, {"k": {"value": 1, "unit": "nonsense"}}, {"k": "=lost"}])
def test_each_of_two_faulty_blocks_that_are_written_alike_is_told(wrong: dict[str, Any]) -> None:
    blocks = {name: {**GAIN, "parameters": wrong} for name in ("a", "b")}
    told = faults(blocks={**blocks, "c": CONSTANT}, wires={"a.u": "c.y", "b.u": "c.y"})
    assert [fault.place.partition(".")[0] for fault in told] == ["a", "b"]


def test_a_fault_in_a_block_is_told_in_each_diagram_that_writes_it_alike() -> None:
    blocks = {"g": {**GAIN, "parameters": {"kk": 1}}, "c": CONSTANT}
    inner = {"blocks": blocks, "wires": {"g.u": "c.y"}}
    told = faults(blocks={"a": {"diagram": inner}, "b": {"diagram": inner}})
    assert [fault.place for fault in told] == ["a.g.kk", "b.g.kk"]


def test_a_stream_is_refused_at_every_block_that_draws_no_numbers() -> None:
    blocks = {"a": GAIN, "b": {**GAIN, "stream": "left"}, "c": CONSTANT}
    told = faults(blocks=blocks, wires={"a.u": "c.y", "b.u": "c.y"})
    assert [(fault.code, fault.place) for fault in told] == [("E003", "b.stream")]


def test_what_is_spelled_apart_is_apart() -> None:
    raws = json.loads('[1, 1.0, true, "1", "=1", [1], [true], {"value": 1}, 0.0, -0.0]', parse_float=Number,
                      parse_int=Number)  # fmt: skip
    scope = DiagramScope("", None, DiagramValue(), 0, 0)
    keys = [spelling(BlockEntry(type="X", parameters={"k": raw}), scope) for raw in raws]
    assert None not in keys
    assert len(set(keys)) == len(raws)
    assert spelling(BlockEntry(type="X", parameters={"k": Number("1")}), scope) == keys[0]
    other = DiagramScope("", None, DiagramValue(), 1, 0)
    again = [spelling(BlockEntry(type="X", parameters={"k": raw}), other) for raw in raws]
    assert [key == one for key, one in zip(keys, again, strict=True)] == [raw != "=1" for raw in raws]
    # What no text holds, such as the numbers of a file, is like nothing else.
    assert spelling(BlockEntry(type="X", parameters={"k": [Column({"csv": "a.csv"}, [1.0])]}), scope) is None
    assert spelling(BlockEntry(type="X", parameters={"k": np.zeros(2)}), scope) is None


@pytest.mark.parametrize(
    ("value", "cure"),
    [
        ("2", "Write it without quotes: 2."),
        ("-1.5e-3", "Write it without quotes: -1.5e-3."),
        ("200 ms", 'Write {"value": 200, "unit": "ms"}.'),
        ("12V", 'Write {"value": 12, "unit": "V"}.'),
        ("2*gain", 'Begin an expression with =, as in "=2*gain".'),
        ("fast", 'Begin an expression with =, as in "=2*gain".'),
    ],
)
def test_a_text_in_place_of_a_number_is_told_with_what_was_meant(value: str, cure: str) -> None:
    fault = only(blocks={"g": {"type": "Gain", "parameters": {"k": value}}}, inputs={"u": {}}, wires={"g.u": "u"})
    assert told(fault) == ("E107", "g.k", f"must be a number, not the text {value!r}.", cure)


def test_a_parameter_that_must_be_given_says_where() -> None:
    assert only(blocks={"z": {"type": "ZeroOrderHold"}}).cure == 'Add "period" to its parameters.'


def test_matrices_that_do_not_fit_are_told_with_both_and_their_sizes() -> None:
    parameters = {"A": [[0, 1], [0, 0]], "B": [[0], [1], [2]], "C": [[1, 0]], "D": [[0]]}
    fault = only(blocks={"s": {"type": "StateSpace", "parameters": parameters}})
    assert told(fault)[:3] == ("E110", "s.B", "has the shape 3 x 1, which makes n = 3, but A makes it 2.")


def test_a_block_of_a_subdiagram_is_reached_through_it_alone() -> None:
    inner = {"inputs": {"u": {}}, "outputs": {"y": "g.y"}, "blocks": {"g": GAIN}, "wires": {"g.u": "u"}}
    made = faults(blocks={"s": {"diagram": inner}}, wires={"s.g.u": "s.y"}, outputs={"y": "s.g.y"})
    assert [f.cure for f in made if f.code == "E105"] == [
        "A wire into a subdiagram must end at one of its inputs: u.",
        "A wire from a subdiagram must begin at one of its outputs: y.",
    ]
