"""No silent wrong answer: a misuse is either what was meant, or an error with its code, place, cause and cure."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from blocks import (
    Block,
    Constant,
    Delay,
    Diagram,
    Gain,
    Integrator,
    Logic,
    MassSpringDamper,
    MatrixGain,
    Mux,
    Relay,
    Run,
    Saturation,
    Sine,
    SquareWave,
    StateSpace,
    Sum,
    Switch,
    ZeroOrderHold,
    subdiagram,
)
from blocks.text.errors import BlocksError, UsageError
from blocks.text.explanations import EXPLAINED

SHORT: dict[str, Any] = {"stop": 0.5, "method": "rk4", "step": 0.25}


def pair() -> Diagram:
    """c -> g, not yet wired."""
    d = Diagram("pair")
    d.add("c", Constant(value=3.0))
    d.add("g", Gain(k=2.0))
    return d


def text(call: Callable[[], Any], kind: type[Exception] = BlocksError) -> str:
    """What the refusal of a call says; each fault has a code that is known, a place, and a cause that is a sentence."""
    with pytest.raises(kind) as caught:
        call()
    error = caught.value
    if isinstance(error, BlocksError):
        assert error.faults
        for fault in error.faults:
            assert fault.code in EXPLAINED
            assert fault.place, fault
            assert fault.message.endswith((".", ")", "?")), fault
            assert fault.cure == "" or fault.cure.endswith((".", "?")), fault
        return str(error)
    return str(error.args[0])


# --- inputs that are not wired ---------------------------------------------------------------------------------


def test_an_input_without_a_default_that_is_not_wired_is_refused_with_its_wire() -> None:
    d = pair()
    wanted = 'E101 g.u: input is not wired. Add "g.u": "block.output" to the wires.'
    assert text(d.check) == text(lambda: d.run(**SHORT)) == text(lambda: d.start(**SHORT)) == wanted
    d.add("s", Sum())
    d.wire("s.u1", "c.y")
    assert text(d.check).splitlines() == [wanted, wanted.replace("g.u", "s.u2")], "all of them at once, in order"


def test_an_input_with_a_default_may_stay_unwired_and_has_it() -> None:
    d = pair()
    d.wire("g.u", d.input("r", default=4.0))
    assert set(d.run(**SHORT)["g.y"].tolist()) == {8.0}


def test_an_input_of_a_subdiagram_that_is_not_wired_is_refused_once() -> None:
    part = Diagram("part")
    u = part.input("u")
    for name in ("a", "b"):
        gain = part.add(name, Gain())
        part.wire(gain.u, u)
    d = Diagram("whole")
    d.add("p", part)
    assert text(d.check) == 'E101 p.u: input is not wired. Add "p.u": "block.output" to the wires.'


def test_an_input_of_the_diagram_without_a_value_is_refused_with_how_it_is_given() -> None:
    d = pair()
    d.wire("g.u", d.input("r"))
    cure = 'Give one: --input r=1 (in Python inputs={"r": 1.0}), or a default in the diagram.'
    assert text(lambda: d.run(**SHORT)) == f"E502 r: the input has no value. {cure}"
    assert "Did you mean 'r'?" in text(lambda: d.run(inputs={"R": 1.0}, **SHORT))


# --- names that are misspelt -----------------------------------------------------------------------------------


NO_OTHER = "Only limits such as those of Saturation may be infinite."


@pytest.mark.parametrize(
    ("call", "kind", "parts"),
    [
        (lambda: pair()["g"].yy, AttributeError, ["E105 g:", "no port \"yy\"", "Did you mean 'y'?", "Inputs: u."]),
        (lambda: setattr(pair()["g"], "u", 1.0), AttributeError, ["diagram.wire(g.u, source), not assigned"]),
        (lambda: setattr(pair()["g"], "k", 1.0), AttributeError, ["diagram.set(\"g.k\", value), not assigned"]),
        (lambda: pair()["gg"], KeyError, ["no block 'gg'", "Did you mean 'g'?"]),
        (lambda: Gain(K=1.0), BlocksError, ["E106 Gain.K:", "no such parameter", "Did you mean 'k'?"]),
        (lambda: Gain(bandwidth=1.0), BlocksError, ["E106 Gain.bandwidth:", "Parameters: unit, unit_u, k."]),
        (lambda: Gain(k=1.0).kk, AttributeError, ["Gain has no parameter 'kk'", "Did you mean 'k'?"]),
        (lambda: Gain(k=1.0).u, AttributeError, ["'u' of Gain is an input", "Add the block to a diagram"]),
        (lambda: setattr(Gain(k=1.0), "k", 2.0), AttributeError, ["'k' cannot be set", "Create another block."]),
        (lambda: setattr(Gain(k=1.0), "gain", 2.0), AttributeError, ["'gain' cannot be set", "Create another block."]),
        (lambda: delattr(Gain(k=1.0), "k"), AttributeError, ["'k' cannot be deleted"]),
        (lambda: setattr(Gain, "k", 2.0), AttributeError, ["Gain is declared", "cannot be changed"]),
        (lambda: Gain(2.0), UsageError, ["E501 Gain: takes parameters by name only. Write Gain(k=2.0)."]),
        (lambda: pair().settings(rtoll=1e-3), BlocksError, ["E501 rtoll:", "Did you mean 'rtol'?"]),
        (lambda: pair().add("q", Gain), BlocksError, ["E501 q:", "is a class", "Gain()."]),
    ],
)  # fmt: skip
def test_a_misspelt_name_is_refused_where_it_stands(
    call: Callable[[], Any], kind: type[Exception], parts: list[str]
) -> None:
    said = text(call, kind)
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    ("sink", "source", "parts"),
    [
        ("gg.u", "c.y", ["E105 gg.u: there is no block \"gg\". Did you mean 'g'?"]),
        ("g.uu", "c.y", ["E105 g.uu: g has no input \"uu\". Did you mean 'u'?"]),
        ("g.u", "cc.y", ["E105 g.u: the source \"cc.y\" is not there. Did you mean 'c.y'?"]),
        ("g.u", "c.value", ['E105 g.u: c has no output "value". Outputs: y.']),
        ("g.y", "c.y", ["E112 g.y: 'y' is an output of g, but a wire must end at an input. Inputs: u."]),
        ("g.u", "g.u", ["E112 g.u: 'u' is an input of g, but a wire must begin at an output. Outputs: y."]),
        ("g.k", "c.y", ['E105 g.k: g has no input "k". Inputs: u.']),
        ("g", "c.y", ["E105 g: is a block, not one of its inputs. Inputs: u."]),
    ],
)
def test_a_wire_from_or_to_nowhere_is_refused(sink: str, source: str, parts: list[str]) -> None:
    d = pair()
    d.wire(sink, source)
    said = text(d.check)
    for part in parts:
        assert part in said


# --- parameters ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: ZeroOrderHold(period=0), ["E107 b.period: must be above 0, not 0.0"]),
        (lambda: ZeroOrderHold(period=-1.0), ["E107 b.period: must be above 0, not -1.0"]),
        (lambda: ZeroOrderHold(), ["E107 b.period: must be given: it has no default."]),
        (lambda: SquareWave(duty=1.5), ["E107 b.duty: must be at most 1.0", "not 1.5"]),
        (lambda: Saturation(lower=2.0, upper=1.0), ["E107 b: lower must be below upper", "lower = 2.0, upper = 1.0"]),
        (lambda: Logic(operator="nandd"), ["E107 b.operator: must be one of and, or, nand", "not 'nandd'"]),
        (lambda: Gain(k=math.nan), ["E004 blocks.b.parameters.k: JSON has no nan", "Write a finite number."]),
        (lambda: Gain(k=math.inf), ["E107 b.k: must be finite, not inf."]),
        (lambda: Gain(k="2"), ["E107 b.k: must be a number, not the text '2'."]),
        (lambda: Gain(k=True), ["E107 b.k: must be a number, not True."]),
        (lambda: Gain(k="=Kp"), ["E108 b.k: '=Kp' reads 'Kp', which is not a known name here."]),
        (lambda: Relay(starts_on=1), ["E107 b.starts_on: must be true or false, not 1"]),
        (lambda: Relay(starts_on="yes"), ["E107 b.starts_on:"]),
        (lambda: Delay(samples=1.5, period=1.0), ["E107 b.samples: must be an integer, not 1.5."]),
        (lambda: Delay(samples=True, period=1.0), ["E107 b.samples:"]),
        (lambda: Gain(k=[1.0, 2.0]), ["E110 b.k: has the shape 2, but a scalar is needed.", '"copies": 2']),
        (lambda: MatrixGain(K=[[1.0, 2.0], [3.0]]), ["E107 b.K: must be numbers in rows of equal length"]),
        (lambda: StateSpace(A=[[0]], B=[[1, 2]], C=[[1, 2]]), ["E110 b.C: has the shape 1 x 2, which makes n = 2"]),
        (lambda: Sine(omega={"value": 1, "unit": "m"}), ["E104 b.omega: [m] is given, but [rad/s] is needed"]),
        (lambda: Sine(omega={"value": 1, "unit": "radd/s"}), ["E114 b.omega: the unit 'radd/s' cannot be read"]),
    ],
)  # fmt: skip
def test_a_parameter_that_does_not_fit_is_refused_when_the_block_is_added(
    make: Callable[[], Block], parts: list[str]
) -> None:
    d = Diagram("d")
    said = text(lambda: d.add("b", make()))
    for part in parts:
        assert part in said
    assert d.value.blocks == {}, "nothing was added"


def test_a_value_that_no_diagram_can_hold_is_refused() -> None:
    with pytest.raises(BlocksError, match=r'E501 "1j" is not a value that a diagram can hold\.'):
        Diagram("d").add("b", Gain(k=1j))


def test_what_a_block_was_given_is_its_own() -> None:
    """An array that is changed afterwards changes no block, and neither does what a block gives out."""
    K = np.array([[1.0, 2.0]])
    block = MatrixGain(K=K)
    K[0, 0] = 99.0
    block.K[0][0] = 99.0
    assert block.K == [[1.0, 2.0]]
    with pytest.raises(TypeError):
        block.parameters["K"] = [[99.0]]
    assert Delay(samples=2.0, period=1.0) == Delay(samples=2, period=1.0), "2.0 is an integer"


# --- one block in several places -------------------------------------------------------------------------------


def test_one_block_in_two_diagrams_and_twice_in_one_is_three_blocks() -> None:
    """A block is a value: what runs in one place does not reach the other places, nor the block."""
    block = Integrator(y_start=1.0)
    first, second = Diagram("first"), Diagram("second")
    for d in (first, second):
        d.wire(d.add("x", block).u, d.add("c", Constant(value=1.0)).y)
    first.wire(first.add("z", block).u, "x.y")
    for _ in range(2):
        # Euler from (1, 1) in two steps of 1/4: x = 1.25, 1.5; z = 1.25, 1.5625.
        results = first.run(stop=0.5, method="euler", step=0.25)
        assert [results["x.y"][-1], results["z.y"][-1]] == [1.5, 1.5625]
        assert second.run(stop=1.0, method="euler", step=0.25)["x.y"][-1] == 2.0
    assert block == Integrator(y_start=1.0)
    first_only = first.run(stop=0.5, method="euler", step=0.25, parameters={"z.y_start": 5.0})
    assert [first_only["x.y"][0], first_only["z.y"][0]] == [1.0, 5.0]
    assert text(lambda: first.add("x", block)) == "E109 x: the name is already used by a block. Choose another name."


def test_one_diagram_twice_in_another_is_two_parts() -> None:
    part = Diagram("part")
    part.parameter("k", 2.0)
    gain = part.add("g", Gain(k="=k"))
    part.wire(gain.u, part.input("u"))
    part.output("y", gain.y)
    d = Diagram("whole")
    c, a, b = d.add("c", Constant()), d.add("a", part), d.add("b", subdiagram(part, k=5.0))
    d.wire(a.u, c.y)
    d.wire(b.u, a.y)
    part.add("later", Constant())
    results = d.run(**SHORT)
    assert [results["a.g.y"][-1], results["b.g.y"][-1]] == [2.0, 10.0]
    assert "a.later.y" not in results, "a part is as it was when it was added"


# --- wires -----------------------------------------------------------------------------------------------------


def test_a_second_source_of_one_input_is_refused_and_the_first_one_stays() -> None:
    d = pair()
    other = d.add("other", Constant(value=-7.0))
    d.wire("g.u", "c.y")
    taken = "E109 g.u: is already wired to c.y. Use Sum to add signals, or remove the wire first: "
    taken += 'unwire("g.u").'
    assert text(lambda: d.wire("g.u", other.y)) == taken
    assert text(lambda: d.wire(d["g"].u, d["c"].y)) == taken, "also where it is the same wire again"
    assert d.run(**SHORT)["g.y"][-1] == 6.0


def test_one_output_may_go_to_two_blocks() -> None:
    d = pair()
    d.add("h", Gain(k=-1.0))
    for sink in ("g.u", "h.u"):
        d.wire(sink, "c.y")
    results = d.run(**SHORT)
    assert [results["g.y"][-1], results["h.y"][-1]] == [6.0, -3.0]
    assert "E109 h.u: is already wired to c.y." in text(lambda: d.wire("h.u", "g.y"))


@pytest.mark.parametrize(("whole", "element"), [(0, 1), (1, 0)])
def test_an_input_is_not_wired_as_a_whole_and_by_element(whole: int, element: int) -> None:
    d = Diagram("d")
    vector, one = d.add("vector", Mux()), d.add("one", Constant())
    gain = d.add("gain", MatrixGain(K=[[1.0, 2.0]]))
    d.wire(vector.u1, one.y)
    d.wire(vector.u2, one.y)
    wires = [(gain.u, vector.y), (gain.u[0], one.y)]
    for sink, source in (wires[whole], wires[element]):
        d.wire(sink, source)
    assert "is wired both as a whole and by element. Keep one of the two." in text(d.check)


def test_a_port_of_another_diagram_is_refused_also_where_the_names_are_the_same() -> None:
    ours, theirs = pair(), pair()
    assert text(lambda: ours.wire(ours["g"].u, theirs["c"].y)) == "E105 c.y: belongs to another diagram called pair."
    assert text(lambda: ours.wire(theirs["g"].u, ours["c"].y)) == "E105 g.u: belongs to another diagram called pair."
    assert "belongs to another diagram" in text(lambda: ours.copy().wire(ours["g"].u, "c.y"))
    assert "belongs to another diagram" in text(lambda: ours.output("y", theirs["g"].y))
    assert "belongs to another diagram" in text(lambda: ours.measure("m", "IAE", theirs["g"].y))
    part = Diagram("part")
    inside = part.add("g", Gain())
    part.wire(inside.u, part.input("u"))
    ours.add("p", part)
    assert text(lambda: ours.wire(inside.u, "c.y")) == "E105 g.u: belongs to the diagram part, not to pair."
    assert ours.value.wires == {}


def test_a_wire_that_runs_backwards_is_refused_with_its_turn() -> None:
    d = pair()
    said = text(lambda: d.wire(d["c"].y, d["g"].u))
    assert said == "E112 c.y: is a source, but a wire ends at an input. Put the sink first: wire(g.u, c.y)."


@pytest.mark.parametrize("thing", [1.0, None, True, ["c.y"], Gain()], ids=repr)
def test_a_wire_from_what_is_no_port_is_refused(thing: Any) -> None:
    assert "is not a port. Use block.port, or its name as a text." in text(lambda: pair().wire("g.u", thing))


# --- shapes, units and types -----------------------------------------------------------------------------------


def test_a_number_does_not_become_a_vector_nor_a_vector_a_number() -> None:
    d = pair()
    narrow, wide = d.add("narrow", MatrixGain(K=[[1.0, 2.0]])), d.add("wide", MatrixGain(K=[[1.0], [2.0]]))
    d.wire(narrow.u, "c.y")
    d.add("inner", Diagram.alone(Gain()))
    d.wire("inner.u", wide.y)
    d.wire(wide.u[0], "c.y")
    said = text(d.check)
    assert 'E110 narrow.u: has 2 elements, but c.y is a single value. Wire each element, as in "narrow.u[0]"' in said
    assert 'E110 inner.u: is a single value, but wide.y has 2 elements. Wire one element, as in "wide.y[0]"' in said
    beyond = pair()
    beyond.add("wide", MatrixGain(K=[[1.0], [2.0]]))
    beyond.wire("wide.u[0]", "c.y")
    beyond.wire("g.u", "wide.y[2]")
    assert text(beyond.check) == "E105 g.u: wide.y has 2 elements, so there is no [2]. Elements are counted from 0."


def test_two_quantities_do_not_connect() -> None:
    d = Diagram("d")
    d.wire(d.add("mass", MassSpringDamper()).F, d.add("way", Constant(unit="m")).y)
    assert text(d.check) == (
        "E104 mass.F [N] <- way.y [m]: N and m are different quantities. "
        'Check the wire, or insert a Gain with "unit_u": "m" and "unit": "N".'
    )
    scaled = Diagram("scaled")
    scaled.wire(
        scaled.add("mass", MassSpringDamper()).F,
        scaled.add("force", Constant(unit="N", value={"value": 2.0, "unit": "kN"})).y,
    )
    assert scaled.run(log=["force.y"], **SHORT)["force.y"][-1] == 2000.0


def test_a_number_is_no_bool_but_a_bool_is_0_or_1() -> None:
    d = pair()
    switch = d.add("switch", Switch())
    for port in (switch.u1, switch.u2, switch.control, d["g"].u):
        d.wire(port, "c.y")
    assert text(d.check) == (
        "E104 switch.control: is a bool, but c.y is a number. "
        "Insert a CompareToConstant, which turns a number into a bool. "
        "For a Switch, use SwitchAbove instead: its control is a number."
    )
    counts = pair()
    counts.wire("g.u", counts.input("b", type="bool"))
    assert counts.run(inputs={"b": True}, **SHORT)["g.y"][-1] == 2.0


# --- what is given to a run ------------------------------------------------------------------------------------


def inputs() -> Diagram:
    """Inputs of all kinds, a gain to be set, and a hold."""
    d = Diagram("inputs")
    r = d.input("r", unit="m")
    d.input("b", type="bool")
    d.input("v", size=2)
    d.wire(d.add("g", Gain()).u, r)
    d.wire(d.add("h", ZeroOrderHold(period=0.1)).u, r)
    return d


GIVEN: dict[str, Any] = {"r": 1.0, "b": True, "v": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rr": 1.0}, "E502 rr: the diagram has no such input. Did you mean 'r'?"),
        ({"r": True}, "E502 r: must be a number, not true or false."),
        ({"r": "1"}, "E502 r: must be a number, not the text '1'."),
        ({"r": math.nan}, "E502 r: must be finite."),
        ({"r": {"value": 1, "unit": "s"}}, "E502 r: [s] is given, but [m] is needed: they are different quantities."),
        ({"r": ([0.0, 1.0], [1.0])}, "E502 r: a table needs one value for each time, but has 1 values and 2 times."),
        ({"r": ([1.0, 0.0], [1.0, 2.0])}, "E502 r: the times of a table must be finite and must not decrease."),
        ({"r": ([0.0, 1.0], [1.0, 2.0], "cubic")}, (
            'E502 r: a table must have the form '
            '(t, u) or (t, u, "hold" or "linear").'
        )),
        ({"b": 2}, "E502 b: must be true or false."),
        ({"b": 0.5}, "E502 b: must be true or false."),
        ({"v": [1.0, 2.0, 3.0]}, "E502 v: must be 2 elements."),
        ({"v": [[1.0, 2.0]]}, "E502 v: must be 2 elements."),
    ],
    ids=str,
)  # fmt: skip
def test_an_input_that_does_not_fit_is_refused(wrong: dict[str, Any], said: str) -> None:
    assert text(lambda: inputs().run(inputs={**GIVEN, **wrong}, **SHORT)) == said


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"log": ["g.yy"]}, "E105 run.log: there is no signal \"g.yy\". Did you mean 'g.y'?"),
        ({"log": ["y"]}, "E105 run.log: there is no signal \"y\". Did you mean 'g.y'?"),
        ({"log": ["nothing"]}, 'E105 run.log: there is no signal "nothing". Signals: '),
        ({"parameters": {"g.kk": 1.0}}, "E106 g.kk: there is no such parameter to set. Did you mean 'g.k'?"),
        ({"parameters": {"gg.k": 1.0}}, "E106 gg.k: there is no such parameter to set. Did you mean 'g.k'?"),
        ({"parameters": {"g.k": "high"}}, "E107 g.k: must be a number, not the text 'high'."),
        ({"rtoll": 1e-3}, "E501 rtoll: is not an argument. Did you mean 'rtol'?"),
        ({"method": "rk5"}, "E115 run.method: \"rk5\" is not known. Did you mean 'rk4'?"),
        ({"method": "dopri5"}, "E115 run.step: dopri5 chooses its own steps. Leave the step out, or use rk4"),
        ({"step": -1.0}, "E115 run.step: must be above 0 s, not -1.0."),
        ({"start": 2.0}, "E115 run.stop: is 0.5 s, before the start at 2.0 s."),
        ({"stop": math.nan}, "E115 run.stop:"),
        ({"rtol": 0.0}, "E115 run.rtol: must be a number between 0 and 1"),
        ({"rtol": True}, "E115 run.rtol: must be a number between 0 and 1"),
    ],
    ids=str,
)
def test_a_setting_that_does_not_fit_is_refused(settings: dict[str, Any], part: str) -> None:
    assert part in text(lambda: inputs().run(inputs=GIVEN, **{**SHORT, **settings}))


# --- what is set and read in a run -----------------------------------------------------------------------------


def under_way() -> Run:
    run = inputs().start(inputs=GIVEN, **SHORT)
    run.advance_to(0.25)
    return run


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rr", 1.0, "E502 rr: there is no such input or parameter. Did you mean 'r'?"),
        ("g.kk", 1.0, "E502 g.kk: there is no such input or parameter. Did you mean 'g.k'?"),
        ("g.y", 1.0, "E502 g.y: there is no such input or parameter. Did you mean 'g.k'?"),
        (
            *("g", 1.0),
            "E502 g: there is no such input or parameter. Inputs: r, b, v; "
            "a parameter needs its path, as in motor.Ra.",
        ),
        ("r", True, "E502 r: must be a number, not true or false."),
        ("r", None, "E502 r: must be numbers."),
        ("r", math.inf, "E502 r: must be finite."),
        ("r", {"value": 1.0, "unit": "s"}, "E502 r: [s] is given, but [m] is needed: they are different quantities."),
        ("b", 2, "E502 b: must be true or false."),
        ("v", [1.0], "E502 v: must be 2 elements."),
        ("g.k", True, "E107 g.k: must be a number, not True."),
        ("g.k", math.inf, f"E107 g.k: must be finite, not inf. {NO_OTHER}"),
        ("g.unit", "m", "E117 g.unit: cannot change during a run: g.unit is structural. Start a new run with it."),
        ("h.period", 0.2, "E117 h.period: cannot change during a run: h.period is fixed. Start a new run with it."),
        ("h.y_start", 2.0, "E117 h.y_start: cannot change during a run: h.y starts at it. Start a new run with it."),
    ],
)  # fmt: skip
def test_what_cannot_be_set_is_refused_and_the_run_goes_on_as_it_was(name: str, value: Any, said: str) -> None:
    run = under_way()
    assert text(lambda: run.set(name, value)) == said
    whole = inputs().run(inputs=GIVEN, stops=[0.25], **SHORT)
    assert run.finish().values.tobytes() == whole.values.tobytes()


def test_a_bool_is_set_by_true_or_by_1_and_both_are_the_same() -> None:
    for value, seen in ((True, 1.0), (1, 1.0), (1.0, 1.0), (False, 0.0), (0, 0.0)):
        run = under_way()
        run.set("b", value)
        assert run["b"] == seen


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("g.yy", ['no signal "g.yy"', "Did you mean 'g.y'?"]),
        ("v[2]", ['no signal "v[2]"']),
        ("v[-1]", ['no signal "v[-1]"']),
        ("g.k", ['no signal "g.k"']),
    ],
)
def test_a_signal_that_is_not_there_is_not_read(name: str, parts: list[str]) -> None:
    run = under_way()
    for part in parts:
        assert part in text(lambda: run[name], KeyError)
    said = text(lambda: run.finish()[name], KeyError)
    assert f"no recorded signal '{name}'" in said
    assert re.search(r"Recorded: r, b, v, g\.y, h\.y\.$", said)


def test_a_signal_of_which_nothing_was_recorded_is_not_read_as_zeros() -> None:
    results = inputs().run(inputs=GIVEN, log=["h.y"], **SHORT)
    assert text(lambda: results["g.y"], KeyError).endswith("Recorded: h.y.")
    assert "g.y" not in results


@pytest.mark.parametrize(
    ("measure", "part"),
    [
        (("m", "IAE", "g.yy"), "E105 measures.m: there is no signal \"g.yy\". Did you mean 'g.y'?"),
        (("m", "IAEE", "g.y"), "E116 measures.m: there is no measure \"IAEE\". Did you mean 'IAE'?"),
        (("m", "IAE", "g.y", "rr"), "E105 measures.m: there is no signal \"rr\". Did you mean 'r'?"),
    ],
)
def test_a_measure_of_what_is_not_there_is_refused(measure: tuple[str, ...], part: str) -> None:
    d = inputs()

    def ask() -> None:
        d.measure(*measure)  # which knows the kinds of measures, but not yet all signals
        d.check()

    assert part in text(ask)
