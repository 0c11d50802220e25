"""Diagrams built in Python: one statement per line of the file, and an error for each that cannot be meant."""

import copy
import json
import pickle
import sys
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks import (
    LESO,
    PID,
    Block,
    BouncingBall,
    Constant,
    Demux,
    Diagram,
    Gain,
    Input,
    Integrator,
    ModelError,
    Mux,
    Parameter,
    PMDCMotor,
    Step,
    Sum,
    TransferFunction,
    UsageError,
    ZeroOrderHold,
    output,
    subdiagram,
)
from blocks.model.block_types import library_types
from tests.support.places import ROOT

FOLDER = ROOT / "diagrams"
DIAGRAMS = sorted(path for path in FOLDER.rglob("*.json") if '"blocks-diagram"' in path.read_text(encoding="utf-8"))


class Shifted(Block):
    """y = u + shift."""

    shift = Parameter(1.0)
    still = Parameter(0.0, fixed=True)
    u = Input()

    @output
    def y(u, shift, still):
        return u + shift + still


def loop() -> Diagram:
    """A motor under a PID, with a parameter, an input and a measure."""
    made = Diagram("speed_loop")
    kp = made.parameter("kp", 2.0, unit="V.s/rad", doc="gain")
    r = made.input("r", unit="rad/s")
    control = made.add("control", PID(kp=kp, ki=5, unit="rad/s", unit_u="V"))
    motor = made.add("motor", PMDCMotor(), at=(340, 80), doc="the plant")
    made.wire(control.r, r)
    made.wire(control.y, motor.omega)
    made.wire(motor.v, control.u)
    made.output("speed", motor.omega)
    made.measure("ITAE", "ITAE", motor.omega, r, start=0.1)
    made.settings(stop=1.0, rtol=1e-6, log=[motor.omega, "control.u"])
    return made


LOOP = """\
{
 "format": "blocks-diagram",
 "version": 3,
 "name": "speed_loop",
 "parameters": {
  "kp": {"value": 2.0, "unit": "V.s/rad", "doc": "gain"}
 },
 "inputs": {
  "r": {"unit": "rad/s"}
 },
 "outputs": {
  "speed": "motor.omega"
 },
 "blocks": {
  "control": {"type": "PID", "parameters": {"kp": "=kp", "ki": 5, "unit": "rad/s", "unit_u": "V"}},
  "motor": {"type": "PMDCMotor", "doc": "the plant"}
 },
 "wires": {
  "control.r": "r",
  "control.y": "motor.omega",
  "motor.v": "control.u"
 },
 "run": {"stop": 1.0, "rtol": 1e-06, "log": ["motor.omega", "control.u"]},
 "measures": {
  "ITAE": {"type": "ITAE", "of": "motor.omega", "against": "r", "from": 0.1}
 },
 "layout": {
  "motor": [340, 80]
 }
}
"""


def message(error: type[Exception], call: Any) -> str:
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


# --- the twin --------------------------------------------------------------------------------------------------


def test_a_diagram_that_is_built_equals_the_one_that_is_loaded() -> None:
    assert loop().dumps() == LOOP
    assert loop().value == Diagram.from_json(LOOP).value
    assert Diagram.from_json(LOOP).dumps() == LOOP


@pytest.mark.parametrize("path", DIAGRAMS, ids=lambda path: path.stem)
def test_a_dict_makes_the_same_diagram_and_the_same_dict(path: Path) -> None:
    source = json.loads(path.read_text(encoding="utf-8"))
    made = Diagram.from_json(source, folder=path.parent)
    assert made.to_json() == source
    assert made.value == Diagram.load(path).value
    assert made.flatten().signals.keys() == Diagram.load(path).flatten().signals.keys()


def test_text_bytes_and_dict_are_read_alike() -> None:
    assert Diagram.from_json(LOOP.encode()).value == Diagram.from_json(json.loads(LOOP)).value


def test_a_saved_diagram_is_loaded_again(tmp_path: Path) -> None:
    loop().save(tmp_path / "loop.json")
    assert (tmp_path / "loop.json").read_text(encoding="utf-8") == LOOP
    assert Diagram.load(tmp_path / "loop.json").value == loop().value


def test_numbers_of_numpy_and_others_are_those_of_a_file() -> None:
    made = Diagram("d")
    made.parameter("a", np.float64(0.5))
    made.parameter("b", np.array([[1, 2], [3, 4]]))
    made.parameter("c", Fraction(1, 4))
    made.parameter("d2", Decimal("0.1"))
    made.parameter("e", np.bool_(True))
    made.parameter("f", (1, "=a"))
    made.parameter("g", {"value": 5, "unit": "mV"}, doc="d")
    made.add("k", Constant(value=np.int64(3)))
    assert made.to_json()["parameters"] == {
        "a": 0.5,
        "b": [[1, 2], [3, 4]],
        "c": 0.25,
        "d2": 0.1,
        "e": True,
        "f": [1, "=a"],
        "g": {"value": 5, "unit": "mV", "doc": "d"},
    }


def test_what_is_built_one_by_one_can_be_read_in_between() -> None:
    made = Diagram("d")
    values = [made.value]
    for k in range(3):
        made.add(f"c{k}", Constant())
        values.append(made.value)
    assert [len(value.blocks) for value in values] == [0, 1, 2, 3]


def test_a_parameter_of_none_is_not_given() -> None:
    made = Diagram("d")
    made.add("e", LESO(bandwidth=None))
    assert made.to_json()["blocks"]["e"] == {"type": "LESO"}


# --- ports -----------------------------------------------------------------------------------------------------


def test_ports_complete_and_show_their_units() -> None:
    motor = Diagram("d").add("motor", PMDCMotor())
    assert dir(motor) == ["i", "omega", "tau", "v"]
    assert repr(motor) == "<block motor: inputs v [V], tau [N.m]; outputs omega [rad/s], i [A]>"
    assert repr(motor.omega) == "<output motor.omega [rad/s]>"
    assert str(motor.v) == "motor.v"


def test_a_misspelt_port_lists_those_that_exist() -> None:
    motor = Diagram("d").add("motor", PMDCMotor())
    text = message(AttributeError, lambda: motor.omga)
    assert text.startswith("E105 motor: there is no port \"omga\". Did you mean 'omega'?")
    assert text.endswith("Inputs: v [V], tau [N.m]. Outputs: omega [rad/s], i [A].")
    assert not hasattr(motor, "__array__")


def test_a_port_is_not_assigned() -> None:
    motor = Diagram("d").add("motor", PMDCMotor())
    with pytest.raises(AttributeError, match=r"wired by diagram.wire\(motor.v, source\)"):
        motor.v = 1.0


def test_elements_of_ports_are_counted_from_zero() -> None:
    made = Diagram("d")
    vector = made.input("v", size=3)
    demux = made.add("demux", Demux())
    made.wire(demux.u[0], vector[2])
    made.wire(demux.u[1], vector[0])
    assert made.to_json()["wires"] == {"demux.u[0]": "v[2]", "demux.u[1]": "v[0]"}
    made.check()
    for wrong in (lambda: vector[-1], lambda: vector[0][0]):
        with pytest.raises(IndexError, match="give the index of an element, 0 or more"):
            wrong()
    with pytest.raises(TypeError, match=r"its elements are v\[0\]"):
        list(vector)


def test_ports_follow_sizes_and_parameters_of_the_diagram() -> None:
    made = Diagram("d")
    n = made.parameter("n", 3)
    assert dir(made.add("mux", Mux(size=n))) == ["u1", "u2", "u3", "y"]
    assert dir(made.add("sum", Sum(signs="+-+-"))) == ["u1", "u2", "u3", "u4", "y"]


def test_handles_are_copied_and_blocks_pickled() -> None:
    handle = Diagram("d").add("g", Gain())
    assert copy.copy(handle).u == handle.u
    assert pickle.loads(pickle.dumps(PMDCMotor(Ra=0.2))) == PMDCMotor(Ra=0.2)


def test_a_port_with_an_underscore_in_front_is_found() -> None:
    inner = Diagram("inner")
    inner.input("_u")
    assert str(Diagram("d").add("s", inner)._u) == "s._u"


def test_a_block_that_is_there_is_found_by_name() -> None:
    made = Diagram.from_json(LOOP)
    assert str(made["motor"].omega) == "motor.omega"
    text = message(KeyError, lambda: made["moter"])
    assert "there is no block 'moter'. Did you mean 'motor'?" in text
    assert "Blocks: none." in message(KeyError, lambda: Diagram("d")["x"])


# --- misuse ----------------------------------------------------------------------------------------------------


def test_wires_are_written_sink_first() -> None:
    made = Diagram("d")
    r, gain, other = made.input("r"), made.add("gain", Gain()), made.add("other", Gain())
    assert "Put the sink first: wire(gain.u, r)." in message(ModelError, lambda: made.wire(r, gain.u))
    assert "but a wire ends at an input." in message(ModelError, lambda: made.wire(gain.y, other.y))
    assert "E112 other.u: is an input" in message(ModelError, lambda: made.wire(gain.u, other.u))
    assert "E112 other.u: is an input" in message(ModelError, lambda: made.output("o", other.u))


def test_ports_of_another_diagram_are_refused() -> None:
    made, other, twin = Diagram("d"), Diagram("other"), Diagram("d")
    gain = made.add("gain", Gain())
    foreign, same = other.add("gain", Gain()), twin.add("gain", Gain())
    assert "belongs to the diagram other, not to d." in message(ModelError, lambda: made.wire(gain.u, foreign.y))
    assert "belongs to the diagram other, not to d." in message(ModelError, lambda: made.wire(foreign.u, gain.y))
    assert "belongs to another diagram called d." in message(ModelError, lambda: made.wire(gain.u, same.y))
    assert "belongs to the diagram other" in message(ModelError, lambda: made.measure("m", "IAE", foreign.y))


def test_a_second_source_is_refused() -> None:
    made = Diagram("d")
    gain, a, b = made.add("gain", Gain()), made.add("a", Constant()), made.add("b", Constant())
    made.wire(gain.u, a.y)
    text = message(ModelError, lambda: made.wire("gain.u", b.y))
    cure = 'Use Sum to add signals, or remove the wire first: unwire("gain.u").'
    assert text == f"E109 gain.u: is already wired to a.y. {cure}"


def test_names_are_taken_once() -> None:
    made = Diagram("d")
    made.parameter("p", 1)
    made.input("i")
    made.add("b", Constant())
    made.output("o", "b.y")
    for name, what in (("p", "a parameter"), ("i", "an input"), ("b", "a block")):
        for call in (
            lambda name=name: made.add(name, Constant()),
            lambda name=name: made.input(name),
            lambda name=name: made.parameter(name, 1),
        ):
            assert message(ModelError, call) == f"E109 {name}: the name is already used by {what}. Choose another name."
    assert "already used by an output" in message(ModelError, lambda: made.output("o", "b.y"))
    assert "already used by an output" in message(ModelError, lambda: made.input("o"))
    assert "already used by an input" in message(ModelError, lambda: made.output("i", "b.y"))
    made.add("o", Constant())
    made.output("b", "b.y")


@pytest.mark.parametrize("name", ["", "a b", "1a", "größe", "a.b", "a\x1b", 5, None, "x" * 201, "a\n"])
def test_what_is_no_name_is_refused(name: Any) -> None:
    made = Diagram("d")
    for call in (
        lambda: Diagram(name),
        lambda: made.add(name, Constant()),
        lambda: made.input(name),
        lambda: made.parameter(name, 1),
        lambda: made.output(name, "c.y"),
        lambda: made.measure(name, "IAE", "c.y"),
    ):
        text = message(ModelError, call)
        assert "E111" in text
        assert text.isprintable()
        assert len(text) < 200
    assert made.value == Diagram("d").value


def test_a_class_is_not_a_block() -> None:
    text = message(UsageError, lambda: Diagram("d").add("g", Gain))  # type: ignore[arg-type]
    assert text == "E501 g: Gain is a class, not a block. Add an instance: Gain()."


@pytest.mark.parametrize("thing", [5, "Gain", None, [Gain()], Diagram])
def test_what_is_no_block_is_refused(thing: Any) -> None:
    assert "E501" in message(UsageError, lambda: Diagram("d").add("g", thing))


@pytest.mark.parametrize(
    "wrong",
    [
        {"k": object()},
        {"k": float("nan")},
        {"k": float("inf")},
        {"k": {"value": 1, "units": "V"}},
        {"k": {"unit": "V"}},
        {"k": 1 + 2j},
        {"k": {1, 2}},
        {"k": [1, None]},
        {"k": 10**400},
        {"k": "="},
        {"k": "=zz"},
        {"k": [1, 2, 3]},
        {"unit": 5},
        {"unit": "furlong"},
    ],
)
def test_a_value_that_no_file_could_hold_is_refused_and_nothing_is_added(wrong: dict[str, Any]) -> None:
    made = Diagram("d")
    text = message((ModelError, UsageError), lambda: made.add("g", Gain(**wrong)))  # type: ignore[arg-type]
    assert len(text) < 600
    assert made.value.blocks == {}


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": 0},
        {"size": 2.5},
        {"size": True},
        {"default": "1"},
        {"default": True},
        {"default": float("nan")},
        {"type": "enum"},
        {"type": "bool", "default": 1.0},
        {"type": "bool", "unit": "V"},
        {"unit": 5},
        {"doc": 5},
    ],
)
def test_an_input_is_checked_like_that_of_a_file(wrong: dict[str, Any]) -> None:
    made = Diagram("d")
    assert "E004 inputs.u" in message(ModelError, lambda: made.input("u", **wrong))
    assert made.value.inputs == {}


def test_positions_are_two_numbers() -> None:
    made = Diagram("d")
    for wrong in (5, (1,), (1, 2, 3), ("a", "b"), (1, float("inf"))):
        with pytest.raises(ModelError, match="E004"):
            made.add("g", Gain(), at=wrong)  # type: ignore[arg-type]
    made.add("g", Gain(), at=np.array([1.5, 2]))  # type: ignore[arg-type]
    assert made.to_json()["layout"] == {"g": [1.5, 2.0]}


def test_settings_are_those_of_a_run() -> None:
    made = Diagram("d")
    text = message(UsageError, lambda: made.settings(stopp=1))
    assert text == "E501 stopp: is not an argument. Did you mean 'stop'?"
    assert "not an argument" in message(UsageError, lambda: made.run(toll=1))
    assert "not an argument" in message(UsageError, lambda: made.plan(raw=1))
    assert "E501 d: the run has no stop time." in message(UsageError, made.run)
    assert "E501 interpolation" in message(UsageError, lambda: made.run(stop=1, interpolation="cubic"))
    assert "E115 run.stop" in message(ModelError, lambda: made.run(stop="1"))  # type: ignore[arg-type]


def test_measures_are_checked() -> None:
    made = loop()
    assert "the name is already used by a measure" in message(
        ModelError, lambda: made.measure("ITAE", "IAE", "motor.omega")
    )
    assert "E116 measures.m" in message(ModelError, lambda: made.measure("m", "IEA", "motor.omega"))
    assert "m" not in made.to_json()["measures"]


# --- blocks and subdiagrams ------------------------------------------------------------------------------------


def test_one_block_in_two_places_is_fine_because_it_is_a_value() -> None:
    gain = Gain(k=2)
    made, other = Diagram("d"), Diagram("other")
    for diagram in (made, other):
        r = diagram.input("r", default=1)
        for name in ("a", "b"):
            diagram.wire(diagram.add(name, gain).u, r)
    assert made.plan().parameters == other.plan().parameters == (2.0, 2.0)


def test_a_diagram_is_a_block_as_it_is_when_it_is_added() -> None:
    inner = Diagram("inner")
    k = inner.parameter("k", 1)
    u = inner.input("u", unit="V")
    gain = inner.add("g", Gain(k=k))
    inner.wire(gain.u, u)
    inner.output("y", gain.y)
    outer = Diagram("outer")
    a = outer.add("a", subdiagram(inner, k=3))
    assert (dir(a), repr(a.u)) == (["u", "y"], "<input a.u [V]>")
    outer.wire(a.u, outer.input("r"))
    inner.add("later", Gain())
    outer.check()
    assert outer.plan().parameters == (3.0,)
    assert Diagram.from_json(outer.to_json()).to_json() == outer.to_json()
    assert "E106 b.q" in message(ModelError, lambda: (outer.add("b", subdiagram(inner, q=1)), outer.check()))


def test_a_file_is_a_block_from_the_diagrams_folder_on(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    inner = Diagram("inner")
    inner.wire(inner.add("g", Gain()).u, inner.input("u"))
    inner.output("y", "g.y")
    inner.save(tmp_path / "parts" / "inner.json")
    outer = Diagram("outer", folder=tmp_path)
    part = outer.add("s", subdiagram("parts/inner.json"))
    outer.wire(part.u, outer.input("r"))
    outer.check()
    assert outer.to_json()["blocks"]["s"] == {"diagram": "parts/inner.json"}
    assert "E007" in message(ModelError, lambda: outer.add("t", subdiagram("parts/iner.json")))
    # One diagram inside another, and saved elsewhere: the path leads to the same file.
    (tmp_path / "deep").mkdir()
    around = Diagram("around", folder=tmp_path / "deep")
    around.wire(around.add("o", outer).r, around.input("r"))
    assert around.to_json()["blocks"]["o"]["diagram"]["blocks"]["s"]["diagram"] == "../parts/inner.json"
    (tmp_path / "pyproject.toml").touch()
    around.save(tmp_path / "deep" / "around.json")
    Diagram.load(tmp_path / "deep" / "around.json").check()


def test_blocks_of_ones_own_run_and_are_found_again_by_their_library() -> None:
    made = Diagram("d")
    made.wire(made.add("s", Shifted(shift=2)).u, made.input("r", default=1))
    made.output("y", "s.y")
    assert made.run(stop=1)["s.y"][-1] == 3.0
    assert "E103" in message(ModelError, lambda: Diagram.from_json(made.to_json()).check())
    for library in ([Shifted], Shifted, sys.modules[__name__], [sys.modules[__name__]]):
        Diagram.from_json(made.to_json(), library=library).check()


def test_a_library_that_is_none_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty_library.py").write_text("x = 1\n")
    (tmp_path / "broken_library.py").write_text("1 / 0\n")
    for library, part in (
        ("no_such_library", "cannot be imported: ModuleNotFoundError"),
        (["empty_library"], "contains no block class"),
        ("broken_library", "cannot be imported: ZeroDivisionError"),
        ("my/library.py", "Use library, with PYTHONPATH=my in the environment."),
        ([5], "contains no block class"),
        (int, "contains no block class"),
    ):
        text = message(UsageError, lambda library=library: Diagram("d", library=library))
        assert text.startswith("E501")
        assert part in text
    assert "Gain" in library_types()


# --- runs ------------------------------------------------------------------------------------------------------


def stepped(**settings: Any) -> Any:
    made = Diagram("d")
    k = made.parameter("k", 2)
    r = made.input("r", unit="V", default=1)
    gain = made.add("gain", Gain(k=k, unit="V", unit_u="V"))
    hold = made.add("hold", ZeroOrderHold(period=0.5))
    mux = made.add("mux", Mux())
    integrator = made.add("x", Integrator())
    lag = made.add("lag", TransferFunction(num=[1, 0], den=[1, 1]))
    made.wire(gain.u, r)
    made.wire(hold.u, gain.y)
    made.wire(mux.u1, r)
    made.wire(mux.u2, gain.y)
    made.wire(integrator.u, gain.y)
    made.wire(lag.u, r)
    made.measure("m", "IAE", "gain.y", "=k*3") if settings.pop("measured", False) else None
    return made, made.start(**{"method": "rk4", "step": 0.25, "stop": 4, **settings})


def test_signals_are_read_by_name() -> None:
    _, run = stepped()
    assert (run["gain.y"], run["mux.y[1]"]) == (2.0, 2.0)
    assert run["mux.y"].tolist() == [1.0, 2.0]
    text = message(KeyError, lambda: run["gain.z"])
    assert text.replace("\\", "")[1:-1] == "there is no signal \"gain.z\". Did you mean 'gain.y'?"
    for wrong in ("mux.y[2]", "mux.y[-1]", "mux.y[0]]", "gain.y[0]", "mux.y[", "", "k", "\x1b"):
        assert "there is no signal" in message(KeyError, lambda wrong=wrong: run[wrong])


def test_inputs_and_tunable_parameters_are_set_in_a_run() -> None:
    _, run = stepped()
    run.set("r", 3)
    assert (run["gain.y"], run.t) == (6.0, 0.0)
    run.set("r", {"value": 500, "unit": "mV"})
    assert run["gain.y"] == 1.0
    run.set("k", 4)
    assert run["gain.y"] == 2.0
    run.advance(1)
    run.set("r", 1)
    run.set("lag.den", [1, 2])
    run.advance_to(2)
    assert run["x.y"] == pytest.approx(2 * 1 + 4 * 1)


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("gain.k", 3, "E117 gain.k: is computed from other parameters"),
        ("gain.unit", "A", "gain.unit is structural"),
        ("mux.size", 3, "E101 mux.u3"),
        ("hold.period", 1, "E117 hold.period: cannot change during a run: hold.period is fixed."),
        ("hold.y_start", 1, "hold.y starts at it"),
        ("x.y_start", 1, "x.y_start is a start value"),
        ("lag.num", [0, 1], "the zeros in the parameters of lag define its structure"),
        ("lag.num", [1], "E117 lag.num"),
        ("r", "x", "E502 r"),
        ("r", None, "E502 r"),
        ("r", [1, 2], "E502 r"),
        ("r", True, "E502 r"),
        ("r", float("nan"), "E502 r"),
        ("r", {"value": 1, "unit": "A"}, "E502 r"),
        ("r", {"unit": "V"}, "E502 r"),
        ("kk", 1, "E502 kk: there is no such input or parameter."),
        ("rr", 1, "Did you mean 'r'?"),
        ("k", "x", "E107"),
        ("k", "=zz", "E108"),
        ("k", None, "E107"),
        ("k", [1, 2], "E110"),
        ("k", object(), "E501"),
    ],
)
def test_what_cannot_be_set_in_a_run_is_refused_and_nothing_changes(name: str, value: Any, part: str) -> None:
    _, run = stepped()
    run.advance(0.5)
    before = (run["gain.y"], run["x.y"], run["hold.y"])
    assert part in message((UsageError, ModelError), lambda: run.set(name, value))  # type: ignore[arg-type]
    assert (run["gain.y"], run["x.y"], run["hold.y"]) == before
    run.advance(0.5)


def test_a_fixed_parameter_and_what_a_measure_reads_are_not_set() -> None:
    made = Diagram("d")
    made.wire(made.add("s", Shifted()).u, made.input("r", default=0))
    run = made.start(stop=1)
    run.set("s.shift", 5)
    assert run["s.y"] == 5.0
    assert "s.still is fixed" in message(UsageError, lambda: run.set("s.still", 1))
    _, run = stepped(measured=True)
    assert "a measure depends on it" in message(UsageError, lambda: run.set("k", 5))


def test_a_structural_parameter_is_not_set() -> None:
    made = Diagram("d")
    made.add("s", Step(unit="V"))
    run = made.start(stop=1)
    assert "s.unit is structural" in message(UsageError, lambda: run.set("s.unit", "A"))


def test_a_change_of_the_diagram_after_the_start_does_not_reach_the_run() -> None:
    made, run = stepped()
    made.add("later", Gain())  # its input is not wired
    made.parameter("late", 5)
    run.set("k", 5)
    assert run["gain.y"] == 5.0
    run.advance(1)
    assert "E502" in message(UsageError, lambda: run.set("late", 1))
    assert "later.y" not in run.finish().names


@pytest.mark.parametrize("wrong", [-1, "1", None, float("nan"), float("inf"), True, {"value": 1, "unit": "V"}, 10**400])
def test_time_goes_forward_by_a_time(wrong: Any) -> None:
    _, run = stepped()
    assert "E501 advance" in message(UsageError, lambda: run.advance(wrong))
    assert run.t == 0.0


def test_going_back_is_refused() -> None:
    _, run = stepped()
    run.advance(0.1)
    run.advance({"value": 200, "unit": "ms"})
    run.advance(0)
    assert run.t == 0.3
    assert message(UsageError, lambda: run.advance_to(0.2)) == "E501 advance_to: t = 0.2 s lies before 0.3 s."
    run.advance_to(0.3)


def test_finish_needs_an_end() -> None:
    _, run = stepped(stop=None)
    run.advance(1)
    assert "has no stop time" in message(UsageError, run.finish)
    assert run.results.t[-1] == 1.0


def test_a_bouncing_ball_takes_its_parameters_by_path() -> None:
    made = Diagram("d")
    made.add("ball", BouncingBall(e=0.5))
    low, high = (made.run(stop=1, parameters={"ball.h_start": h})["ball.h"] for h in (1, {"value": 200, "unit": "cm"}))
    assert (low[0], high[0]) == (1.0, 2.0)
    assert "E106 ball.hstart" in message(ModelError, lambda: made.run(stop=1, parameters={"ball.hstart": 1}))


def test_a_diagram_shows_what_it_holds() -> None:
    assert repr(loop()) == ("<Diagram speed_loop: 2 blocks, 3 wires>\n  control: PID\n  motor: PMDCMotor")


@pytest.mark.parametrize(
    ("section", "value"),
    [("wires", [["g.u", "u"]]), ("blocks", [{"type": "Gain"}]), ("inputs", ["u"]), ("parameters", 1)],
)
def test_what_follows_from_a_section_that_could_not_be_read_is_not_told(section: str, value: Any) -> None:
    document = {
        "format": "blocks-diagram",
        "version": 3,
        "parameters": {"k": 1},
        "inputs": {"u": {}},
        "blocks": {"g": {"type": "Gain", "parameters": {"k": "=k"}}},
        "wires": {"g.u": "u"},
        section: value,
    }
    with pytest.raises(ModelError) as caught:
        Diagram.from_json(document)
    assert [(fault.code, fault.place) for fault in caught.value.faults] == [("E004", section)]
