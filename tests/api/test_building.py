"""Building in Python: what is settled once for blocks that are alike, and every fault in its place all the same."""

import contextlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import blocks
from blocks import (
    Block,
    Diagram,
    FirstOrder,
    Gain,
    Input,
    ModelError,
    Noise,
    Parameter,
    PMDCMotor,
    Saturation,
    UsageError,
    output,
    requires,
)
from blocks.contract import resolution
from blocks.model import document as documents
from blocks.model.hierarchy import Hierarchy

# What is refused, each with what it is told: a call on a diagram, then the text.
REFUSED = r"""
add("1a", Gain())
    ModelError: E111 "1a": is not a name. Write "_1a": letters, digits and _, not beginning with a digit.
add("g", Gain())
    ModelError: E109 g: the name is already used by a block. Choose another name.
add("r", Gain())
    ModelError: E109 r: the name is already used by an input. Choose another name.
add("p", Gain())
    ModelError: E109 p: the name is already used by a parameter. Choose another name.
add("a", Gain)
    UsageError: E501 a: Gain is a class, not a block. Add an instance: Gain().
add("a", 3.0)
    UsageError: E501 a: "3.0" is not a block. Add a Block, a Diagram or a subdiagram(...).
add("a", Gain(k="fast"))
    ModelError: E107 a.k: must be a number, not the text 'fast'. Begin an expression with =, as in "=2*gain".
add("a", Gain(k="2,5 mV"))
    ModelError: E107 a.k: must be a number, not the text '2,5 mV'. Write decimals after a point: 2.5 mV.
add("a", PMDCMotor(La="2 mV"))
    ModelError: E104 a.La: [mV] is given, but [H] is needed: they are different quantities. A number without a
    unit is in H.
add("a", Gain(k=True))
    ModelError: E107 a.k: must be a number, not True.
add("a", Gain(k=[1.0, 2.0]))
    ModelError: E110 a.k: has the shape 2, but a scalar is needed. Give one number, or give the block "copies": 2
    (in Python add(..., copies=2)), one for each.
add("a", Gain(k=math.inf))
    ModelError: E107 a.k: must be finite, not inf. Only limits such as those of Saturation may be infinite.
add("a", Gain(k=math.nan))
    ModelError: E004 blocks.a.parameters.k: JSON has no nan. Write a finite number.
add("a", Gain(k=10**400))
    ModelError: E004 blocks.a.parameters.k: an integer is too large: the largest float is 1.8e308.
add("a", Gain(k={"value": 2.0, "unit": "Vv"}))
    ModelError: E114 a.k: the unit 'Vv' cannot be read at character 1: 'Vv' is not known. A unit is a product
    such as 'kg.m2/s3' of kg m s A K mol cd rad N J W Pa Hz C V Ohm S H F Wb T g t l L bar min h d deg rev rpm
    %, with SI prefixes.
add("a", Gain(k={"value": 2.0, "units": "V"}))
    ModelError: E003 blocks.a.parameters.k.units: the key "units" is not known here. Did you mean "unit"?
add("a", Gain(k={"value": 2.0}, unit=3.0))
    ModelError: E107 a.unit: must be a text, not 3.0.
add("a", Gain(unit="Vs"))
    ModelError: E114 a.y: the unit 'Vs' cannot be read at character 1: 'Vs' is not known. Did you mean 'V.s'?
add("a", Gain(k=None))
    ModelError: E004 blocks.a.parameters.k: must be a number, a text, a list, true or false, not null.
add("a", Gain(k="=q"))
    ModelError: E108 a.k: '=q' reads 'q', which is not a known name here. Known: p, text.
add("a", Gain(k="=p +"))
    ModelError: E108 a.k: '=p +', column 4: expected a number, a name or '(', found the end.
add("a", Gain(k="=1/0"))
    ModelError: E108 a.k: '=1/0', column 2: division by zero in 1.0 / 0.0. Check the values that it is
    computed from.
add("a", Gain(k="=text"))
    ModelError: E107 a.k: must be a number, not the text 'word'. Begin an expression with =, as in "=2*gain".
add("a", Gain(k="\ud800"))
    ModelError: E001 blocks.a.parameters.k: \ud800 is one half of a character. Write both halves, as in
    \ud83d\ude00, or the character.
add("a", Gain(k=2.0), doc=3.0)
    ModelError: E004 blocks.a.doc: must be a text or a list of lines, not the number 3.0.
add("a", Gain(k=2.0), doc="\ud800")
    ModelError: E001 blocks.a.doc: \ud800 is one half of a character. Write both halves, as in \ud83d\ude00,
    or the character.
add("a", Gain(k=2.0), stream="left")
    ModelError: E003 a.stream: draws no random numbers, so it has no stream. Leave the stream out.
add("a", Gain(k=2.0), stream="1")
    ModelError: E111 blocks.a.stream: "1" is not the name of a stream. Use a name, or a path such as
    "robot.noise" or "/robot.noise".
add("a", Noise(period=0.1), stream="a b")
    ModelError: E111 blocks.a.stream: "a b" is not the name of a stream. Use a name, or a path such as
    "robot.noise" or "/robot.noise".
add("a", Gain(k=2.0), enable={"states": "held"})
    ModelError: E003 blocks.a.enable: only a subdiagram can be enabled or triggered.
add("a", Gain(k=2.0), at=(1.0, "x"))
    ModelError: E004 layout.a: must be a position [x, y].
add("a", FirstOrder(T=0.0))
    ModelError: E107 a.T: must be above 0, not 0.0.
add("a", FirstOrder(T=-1.0))
    ModelError: E107 a.T: must be above 0, not -1.0.
add("a", FirstOrder(T={"value": -1.0, "unit": "ms"}))
    ModelError: E107 a.T: must be above 0, not -0.001.
add("a", FirstOrder(y_start=[1.0, 2.0]))
    ModelError: E110 a.y_start: has the shape 2, but a scalar is needed. Give one number, or give the block "copies": 2
    (in Python add(..., copies=2)), one for each.
add("a", FirstOrder(T=[[[1.0]]]))
    ModelError: E110 a.T: has the shape 1 x 1 x 1, but a scalar is needed. Give the number without brackets.
add("a", Saturation(lower=1.0, upper=-1.0))
    ModelError: E107 a: lower must be below upper (lower = 1.0, upper = -1.0).
add("a", Saturation(lower=2.0))
    ModelError: E107 a: lower must be below upper (lower = 2.0, upper = 1.0).
add("a", Saturation(lower=1, upper=1))
    ModelError: E107 a: lower must be below upper (lower = 1.0, upper = 1.0).
add("a", Saturation(corners="round"))
    ModelError: E107 a.corners: must be one of located, clipped, not 'round'.
add("a", Sum(signs="+x"))
    ModelError: E107 a.signs: signs must be a text of + and -, one for each input (signs = +x).
add("a", Sum(signs=""))
    ModelError: E107 a.signs: signs must be a text of + and -, one for each input (signs = ).
add("a", Sum(signs=3.0))
    ModelError: E107 a.signs: must be a text, not 3.0.
add("a", TransferFunction(num=[1.0, 2.0], den=[1.0]))
    ModelError: E107 a: num must not have more coefficients than den: the transfer function would not be
    proper (m = 2, k = 1).
add("a", TransferFunction(num=[], den=[1.0]))
    ModelError: E107 a: num and den must not be empty (m = 0, k = 1).
add("a", TransferFunction(num=[1.0], den=[0.0, 1.0]))
    ModelError: E107 a: the first coefficient of den must not be 0 (den = [0. 1.], k = 2).
add("a", TransferFunction(num=[[1.0], [2.0, 3.0]]))
    ModelError: E107 a.num: must be numbers in rows of equal length, not [[1.0], [2.0, 3.0]].
add("a", StateSpace(A=[[1.0, 2.0]], B=[[1.0]], C=[[1.0]]))
    ModelError: E110 a.A: has the shape 1 x 2, but n x n is needed.
add("a", StateSpace(A=[[1.0, "x"]]))
    ModelError: E107 a.A: a list must hold numbers, not the text "x".
add("a", UnitDelay(period=0.0))
    ModelError: E107 a.period: must be above 0, not 0.0.
add("a", UnitDelay(period=-0.1))
    ModelError: E107 a.period: must be above 0, not -0.1.
add("a", UnitDelay(offset=-1.0))
    ModelError: E107 a.period: must be given: it has no default. Add "period" to its parameters.
add("a", TransportDelay(delay=0.0))
    ModelError: E107 a.delay: must be above 0, not 0.0. For no delay, leave the block out; in a sweep, begin at
    a small delay, such as 1 ms.
add("a", PID(lower=1.0, upper=0.0))
    ModelError: E107 a: lower must be below upper (lower = 1.0, upper = 0.0).
add("a", Table(times={"csv": "none.csv", "column": "t"}))
    ModelError: E007 blocks.a.parameters.times: "none.csv" does not exist.
add("a", Relay(on_at=-1.0, off_at=1.0))
    ModelError: E107 a: off_at must not be above on_at (off_at = 1.0, on_at = -1.0).
add("a", MatrixGain(K=[[1.0, 2.0], [3.0]]))
    ModelError: E107 a.K: must be numbers in rows of equal length, not [[1.0, 2.0], [3.0]].
add("a", subdiagram(Diagram("inner"), k=math.nan))
    ModelError: E004 blocks.a.parameters.k: JSON has no nan. Write a finite number.
add("a", subdiagram(Diagram("inner")), enable={"states": "off"})
    ModelError: E004 blocks.a.enable.states: must be "held" or "reset", not "off".
add("a", subdiagram(Diagram("inner")), trigger={"every": 0.1, "direction": "up"})
    ModelError: E009 blocks.a.trigger: a trigger needs either "direction" (for a signal) or "every" (for ticks).
wire(g.y, "r")
    ModelError: E112 g.y: is a source, but a wire ends at an input. Put the sink first: wire(sink, source).
wire(g.y, g.u)
    ModelError: E112 g.y: is a source, but a wire ends at an input. Put the sink first: wire(g.u, g.y).
wire(g.u, other.y)
    ModelError: E105 g.y: belongs to the diagram other, not to x.
wire(3, "r")
    UsageError: E501 wire: "3" is not a port. Use block.port, or its name as a text.
wire("h.u", "r")
    ModelError: E109 h.u: is already wired to r. Use Sum to add signals, or remove the wire first: unwire("h.u").
output("y", g.u)
    ModelError: E112 g.u: is an input, but a wire begins at an output or at an input of the diagram.
parameter("a", math.nan)
    ModelError: E004 parameters.a: JSON has no nan. Write a finite number.
input("a", unit="V", default="x")
    ModelError: E004 inputs.a.default: must be a number, not "x".
"""


def rows() -> list[tuple[str, str]]:
    """The calls with their texts, which may take several lines."""
    table: list[tuple[str, str]] = []
    for line in REFUSED.strip().splitlines():
        if line.startswith(" "):
            call, told = table.pop()
            table.append((call, f"{told} {line.strip()}".strip()))
        else:
            table.append((line, ""))
    return table


GOOD = (
    *(Gain(k=2.0), Gain(k=4.0), FirstOrder(T=2.0), FirstOrder(T=3.0), Saturation(lower=-2.0, upper=2.0)),
    *(Saturation(lower=-2.0), Noise(period=0.1), blocks.TransferFunction(), blocks.UnitDelay(period=0.1)),
    *(blocks.PID(), blocks.Relay(), blocks.Sum(signs="+-"), blocks.StateSpace(A=[[1.0]], B=[[1.0]], C=[[1.0]])),
)


@pytest.mark.parametrize("before", [(), GOOD], ids=["alone", "behind others"])
def test_what_is_refused_is_refused_where_it_is_added(before: tuple[Block, ...]) -> None:
    names = {name: getattr(blocks, name) for name in blocks.__all__}
    assert len(rows()) > 60
    for call, text in rows():
        d = Diagram("x")
        d.parameter("p", 2.0)
        d.parameter("text", "word")
        r = d.input("r")
        g = d.add("g", Gain(k=3.0))
        d.wire("h.u", r)
        for index, block in enumerate(before):
            d.add(f"other{index}", block)
        other = Diagram("other").add("g", Gain())
        count = len(d.value.blocks)
        with pytest.raises(Exception, match="E") as caught:
            eval(f"d.{call}", {**names, "math": math, "d": d, "g": g, "other": other})
        assert f"{type(caught.value).__name__}: {' '.join(str(caught.value).split())}" == " ".join(text.split()), call
        assert len(d.value.blocks) == count
        d.add("a", Gain(k=2.5))


def test_values_that_differ_are_settled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a text is written for a block, nor are its sizes settled anew for another number."""
    counts = {"resolved": 0, "texts": 0}
    resolved, written = resolution.resolve, documents.dumps_document

    def resolving(*given: Any) -> Any:
        counts["resolved"] += 1
        return resolved(*given)

    def writing(*given: Any) -> Any:
        counts["texts"] += 1
        return written(*given)

    monkeypatch.setattr("blocks.model.hierarchy.resolve", resolving)
    monkeypatch.setattr(documents, "dumps_document", writing)
    diagram = Diagram("x")
    for k in range(50):
        diagram.add(f"gain{k}", Gain(k=0.1 + k))
        diagram.add(f"lag{k}", FirstOrder(k=1.0 + k, T=0.1 + k))
        diagram.add(f"limit{k}", Saturation(lower=-1.0 - k, upper=1.0 + k))
    assert counts["texts"] == 0
    assert counts["resolved"] <= 6  # of each type one that is looked at by itself, and one that others are like
    Hierarchy(diagram.value, diagram._draft.resolver, {})
    assert counts["resolved"] <= 9
    assert diagram.to_json()["blocks"]["lag7"]["parameters"] == {"k": 8.0, "T": 7.1}
    assert Diagram.from_json(diagram.dumps()).value == diagram.value


def test_a_block_in_a_file_and_one_in_python_are_the_same() -> None:
    made = Diagram("x")
    odd = {"k": {"value": 1200, "unit": "mOhm"}, "unit": "V", "unit_u": "A"}
    made.add("quantity", Gain(**odd), doc="käse")
    made.add("numbers", blocks.TransferFunction(num=np.array([1.0, -0.0]), den=(1, 1e-07, 2.5)))
    made.add("whole", Gain(k=3))
    made.add("small", Gain(k=5e-324))
    read = Diagram.from_json(made.dumps())
    assert read.dumps() == made.dumps()
    assert [repr(entry.parameters) for entry in read.value.blocks.values()] == [
        repr(entry.parameters) for entry in made.value.blocks.values()
    ]


SIZE, LEAST = 2, 0.0


class Wide(Block):
    """As wide as a global says, with numbers above another one."""

    k = Parameter(1.0, doc="gain")
    u = Input(shape=lambda: SIZE, ports="u{}", doc="input")

    @requires("k must be above the least")
    def is_above(k):
        return k > LEAST

    @output(shape=lambda: SIZE, doc="output")
    def y(u, k):
        return k * u


def test_what_a_class_reads_from_outside_counts_when_a_block_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    diagram = Diagram("x")
    for k in range(3):
        diagram.add(f"before{k}", Wide(k=1.0 + k))
    monkeypatch.setitem(globals(), "LEAST", 5.0)
    with pytest.raises(ModelError, match=r"E107 late\.k: k must be above the least \(k = 2\.5\)"):
        diagram.add("late", Wide(k=2.5))
    diagram.add("late", Wide(k=6.0))
    monkeypatch.setitem(globals(), "SIZE", 3)
    assert dir(diagram.add("wide", Wide(k=7.0))) == ["u1", "u2", "u3", "y"]


def test_a_parameter_of_the_diagram_is_read_as_it_is_then() -> None:
    diagram = Diagram("x")
    diagram.parameter("unit", "V")
    assert diagram.add("a", Gain(k=1.0, unit="=unit")).y.unit == "V"
    with pytest.raises(ModelError, match=r"E108 b\.k: '=late' reads 'late'"):
        diagram.add("b", Gain(k="=late"))
    diagram.parameter("late", 2.0)
    assert diagram.add("b", Gain(k="=late", unit="=unit")).y.unit == "V"
    assert diagram.add("c", Gain(k=3.0, unit="A")).y.unit == "A"


def numbers_of(*added: Block) -> list[resolution.Resolved | None]:
    """What blocks of one diagram have, each as it is opened behind those before it; None where one is refused."""
    diagram = Diagram("x")
    for index, block in enumerate(added):
        with contextlib.suppress(ModelError):
            diagram.add(f"b{index}", block)
    leaves = {leaf.name: leaf.resolved for leaf in Hierarchy(diagram.value, diagram._draft.resolver, {}).leaves}
    return [leaves.get(f"b{index}") for index in range(len(added))]


def shown(one: resolution.Resolved | None) -> Any:
    """All of it, to the last bit."""
    if one is None:
        return None
    values = [(name, repr(v.value), getattr(v.value, "shape", ()), v.exact, v.unit) for name, v in one.values.items()]
    return one.interface.key, values, one.clocks, repr(one.starts), repr(one.delays), one.nominal


def test_a_block_behind_one_that_is_like_it_has_the_numbers_that_it_has_alone() -> None:
    checked = 0
    for name in blocks.__all__:
        cls: Any = getattr(blocks, name)
        declaration = getattr(cls, "declaration", None)
        if declaration is None or declaration.streams:  # whose numbers follow from the names of blocks
            continue
        for key in resolution.loose(declaration):
            given = {other: 0.5 for other, p in declaration.parameters.items() if p.default is resolution.REQUIRED}
            unit = declaration.parameters[key].unit
            numbers: list[Any] = [0.7, 0.1, -3.0, 0.0, 1e300]
            numbers += [{"value": 250, "unit": f"m{unit}"}] if unit in ("s", "V", "A", "m", "rad") else []
            made = [cls(**{**given, key: number}) for number in numbers]
            together = numbers_of(*made)
            assert [shown(one) for one in together] == [shown(numbers_of(one)[0]) for one in made], (name, key)
            checked += sum(one is not None for one in together)
    assert checked > 300


def test_a_diagram_of_one_block_keeps_the_defaults_of_its_inputs() -> None:
    alone = Diagram.alone(PMDCMotor())  # tau is 0 where it is not wired
    results = alone.run(stop=1, inputs={"v": 6.0}, engine="reference")
    given = alone.run(stop=1, inputs={"v": 6.0, "tau": 0.0}, engine="reference")
    assert np.array_equal(results["omega"], given["omega"])
    with pytest.raises(UsageError, match=r"E502 v: the input has no value"):
        alone.run(stop=1)


def test_a_path_that_is_added_as_a_block_is_refused_with_the_call_that_it_needs() -> None:
    made = Diagram("d")
    made.add("m", Gain())
    for act in (made.add, made.swap):
        with pytest.raises(UsageError, match=r"""E501 \w: "x.fmu" is not a block. Write fmu\('x.fmu'\)."""):
            act("n" if act == made.add else "m", "x.fmu")
        with pytest.raises(UsageError, match=r"Write subdiagram\('x.json'\)."):
            act("n" if act == made.add else "m", Path("x.json"))


def test_faults_of_a_diagram_made_in_python_have_no_place_in_a_text_after_a_removal() -> None:
    made = Diagram("d")
    for name in ("a", "b"):
        made.add(name, Gain())
    made.wire("a.u", "b.y")
    made.remove("b")
    with pytest.raises(ModelError, match=r"\AE101 a.u: input is not wired"):
        made.check()


def test_arguments_of_other_tools_are_refused_with_those_of_export() -> None:
    for word, meant in (("version", "fmi"), ("fmi_version", "fmi"), ("kind", "kinds")):
        with pytest.raises(UsageError, match=f"E501 {word}: is not an argument. Did you mean '{meant}'"):
            Diagram("d").export("d.fmu", **{word: 2})  # type: ignore[arg-type]
