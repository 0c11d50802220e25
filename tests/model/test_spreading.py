"""A wire from a vector to scalar ports gives the blocks copies, which the file holds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from blocks import (
    Constant,
    Demux,
    Diagram,
    Gain,
    Input,
    Integrator,
    ModelError,
    Mux,
    Saturation,
    StateSpace,
    Sum,
    Switch,
    TransportDelay,
    UnitDelay,
    UsageError,
    ZeroOrderHold,
    output,
)
from blocks.contract.block import Block
from blocks.editing.applying import edit_file


def with_vector(**inputs: object) -> Diagram:
    diagram = Diagram("vectors")
    diagram.input("r", size=3, default=[1, 2, 3], **inputs)  # type: ignore[arg-type]
    return diagram


@pytest.mark.parametrize(
    "block",
    [Saturation(lower=-1, upper=2), UnitDelay(period=0.1), ZeroOrderHold(period=0.1), Integrator(),
     TransportDelay(delay=0.1), Gain(k=2)],
    ids=lambda block: type(block).__name__,
)  # fmt: skip
def test_a_vector_gives_copies_to_a_block_with_scalar_ports(block: Block) -> None:
    diagram = with_vector()
    handle = diagram.add("b", block)
    diagram.wire(handle.u, "r")
    assert diagram.value.blocks["b"].copies == 3
    by_hand = with_vector()
    by_hand.add("b", block, copies=3)
    by_hand.wire("b.u", "r")
    assert diagram.dumps() == by_hand.dumps()  # the file says all
    got = diagram.run(stop=1, log=["b.y"])["b.y"]
    for k in range(3):  # each element is what a block of its own gives
        alone = Diagram("alone")
        alone.input("r", default=k + 1)
        alone.wire(alone.add("b", block).u, "r")
        assert np.array_equal(got[:, k], alone.run(stop=1, log=["b.y"])["b.y"])


def test_blocks_behind_a_vector_follow_in_any_order_of_wiring() -> None:
    def build(order: list[int]) -> Diagram:
        diagram = with_vector()
        for name, block in (("a", Integrator()), ("b", Gain(k=2)), ("sum", Sum(signs="+-")), ("out", Demux(size=3))):
            diagram.add(name, block)
        wires = [("a.u", "r"), ("b.u", "a.y"), ("sum.u1", "b.y"), ("sum.u2", "r"), ("out.u", "sum.y")]
        for k in order:
            diagram.wire(*wires[k])
        return diagram

    forwards, backwards = build([0, 1, 2, 3, 4]), build([4, 3, 2, 1, 0])
    assert [forwards.value.blocks[name].copies for name in ("a", "b", "sum", "out")] == [3, 3, 3, None]
    assert forwards.value.blocks == backwards.value.blocks
    end = forwards.run(stop=1, log=["out.y3"])["out.y3"][-1]
    assert end == pytest.approx(2 * 3 - 3)  # 2 times the integral of 3, less 3


def test_a_scalar_beside_a_vector_reaches_all_copies() -> None:
    diagram = with_vector()
    switch = diagram.add("s", Switch())
    one = diagram.add("one", Constant(value=7))
    for port in diagram["s"].__dir__():
        if port != "y":
            diagram.wire(getattr(switch, port), "r" if port == "u1" else one.y if port == "u2" else _false(diagram))
    assert diagram.value.blocks["s"].copies == 3
    assert list(diagram.run(stop=1, log=["s.y"])["s.y"][-1]) == [7, 7, 7]


def _false(diagram: Diagram) -> object:
    return diagram.input("flag", type="bool", default=False)


def test_copies_follow_the_expression_of_their_source() -> None:
    diagram = Diagram("n")
    n = diagram.parameter("n", 4)
    source = diagram.add("source", Constant(value=2), copies=n)
    gain = diagram.add("gain", Gain(k=3))
    diagram.wire(gain.u, source.y)
    assert diagram.value.blocks["gain"].copies == "=n"
    assert list(diagram.run(stop=1, log=["gain.y"])["gain.y"][-1]) == [6] * 4


def test_blocks_that_take_vectors_or_have_copies_stay_as_they_are() -> None:
    diagram = with_vector()
    diagram.add("mux", Mux(size=2))
    diagram.add(
        "plant", StateSpace(A=[[-1, 0, 0], [0, -1, 0], [0, 0, -1]], B=np.eye(3), C=np.eye(3), D=np.zeros((3, 3)))
    )
    diagram.add("two", Gain(k=1), copies=2)
    diagram.add("inner", Diagram.alone(Gain(k=2)))
    diagram.add("one", Gain(k=1))
    diagram.wire("mux.u1", "r")
    diagram.wire("plant.u", "r")
    diagram.wire("two.u", "r")
    diagram.wire("inner.u", "r")
    diagram.wire("one.u", "r[1]")
    assert [diagram.value.blocks[name].copies for name in ("mux", "plant", "two", "inner", "one")] == [
        None, None, 2, None, None,
    ]  # fmt: skip
    with pytest.raises(ModelError, match=r'inner\.u: is a single value, but r has 3 elements.* "copies": 3'):
        diagram.check()


def test_an_edit_of_a_file_gives_the_same_copies(tmp_path: Path) -> None:
    diagram = with_vector()
    diagram.add("gain", Gain(k=2))
    diagram.add("hold", ZeroOrderHold(period=0.1))
    diagram.wire("hold.u", "gain.y")
    outer = Diagram("outer")
    outer.add("part", diagram)
    path = tmp_path / "loop.json"
    outer.save(path)
    before = path.read_text(encoding="utf-8")
    edit_file(path, [{"wire": "r", "to": "gain.u", "in": "part"}]).write()
    blocks = json.loads(path.read_text(encoding="utf-8"))["blocks"]["part"]["diagram"]["blocks"]
    assert (blocks["gain"]["copies"], blocks["hold"]["copies"]) == (3, 3)
    assert edit_file(path, [{"set": "name", "to": "x"}]).undone is not None
    diagram.wire("gain.u", "r")
    outer = Diagram("outer")
    outer.add("part", diagram)
    assert json.loads(path.read_text(encoding="utf-8")) == outer.to_json()
    assert before.count("copies") == 0


def test_a_vector_of_one_element_is_wired_by_its_element(tmp_path: Path) -> None:
    diagram = Diagram("loop")
    plant = diagram.add("plant", StateSpace(A=[[-1]], B=[[1]], C=[[1]]))
    step, gain = diagram.add("step", Constant(value=3)), diagram.add("gain", Gain(k=2))
    before = diagram.copy()
    diagram.wire(plant.u, step.y)
    diagram.wire(gain.u, plant.y)
    assert diagram.to_json()["wires"] == {"plant.u[0]": "step.y", "gain.u": "plant.y[0]"}
    assert diagram.value.blocks["gain"].copies is None
    assert diagram.run(stop=30, log=["gain.y"])["gain.y"][-1] == pytest.approx(6)
    with pytest.raises(ModelError, match=r"E109 plant\.u\[0\]: is already wired to step\.y\."):
        diagram.wire(plant.u, step.y)
    before.save(tmp_path / "loop.json")
    edits = [{"wire": "step.y", "to": "plant.u"}, {"wire": "plant.y", "to": "gain.u"}]
    edit_file(tmp_path / "loop.json", edits).write()
    assert Diagram.load(tmp_path / "loop.json").value.wires == diagram.value.wires


def test_a_wire_can_be_removed_and_an_input_wired_again() -> None:
    diagram = with_vector()
    gain, one = diagram.add("gain", Gain(k=2)), diagram.add("one", Constant(value=1))
    diagram.wire(gain.u, one.y)
    with pytest.raises(ModelError, match=r'E109 gain\.u: is already wired to one\.y\..*unwire\("gain\.u"\)'):
        diagram.wire(gain.u, "r")
    diagram.unwire(gain.u)
    diagram.wire(gain.u, "r")
    assert list(diagram.run(stop=1, log=["gain.y"])["gain.y"][-1]) == [2, 4, 6]
    with pytest.raises(UsageError, match=r"E501 gain\.w: is not wired\. Did you mean 'gain\.u'\?"):
        diagram.unwire("gain.w")


def test_what_is_removed_takes_everything_with_it_that_refers_to_it() -> None:
    diagram = Diagram("loop")
    k = diagram.parameter("k", 3)
    step, gain, other = diagram.add("step", Constant(value=1)), diagram.add("gain", Gain(k=k)), diagram.add("o", Gain())
    diagram.wire(gain.u, step.y)
    diagram.wire(other.u, gain.y)
    diagram.output("y", gain.y)
    diagram.measure("area", "IAE", of=gain.y)
    diagram.settings(stop=2, log=["gain.y", "step.y"])
    diagram.remove("k")  # expressions keep its value
    assert diagram.to_json()["blocks"]["gain"]["parameters"] == {"k": 3}
    diagram.remove("gain")
    rest = diagram.to_json()
    assert list(rest["blocks"]) == ["step", "o"]
    assert rest["run"] == {"stop": 2, "log": ["step.y"]}
    assert not {"wires", "outputs", "measures", "parameters"} & rest.keys()
    diagram.add("gain", Gain(k=5))  # the name is free again
    with pytest.raises(UsageError, match=r"E501 stp: there is nothing of this name to remove\. Did you mean 'step'\?"):
        diagram.remove("stp")


def test_removing_keeps_block_types_that_only_python_knows() -> None:
    class Twice(Block):
        """Twice the input."""

        u = Input()

        @output
        def y(u: float) -> float:
            return 2 * u

    diagram = Diagram("own")
    diagram.add("a", Twice())
    diagram.add("b", Twice())
    diagram.wire("b.u", "a.y")
    diagram.input("r", default=1)
    diagram.wire("a.u", "r")
    diagram.remove("b")
    assert diagram.run(stop=1, log=["a.y"])["a.y"][-1] == 2
