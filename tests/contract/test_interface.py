"""A block's sizes, values and clocks are settled exactly, and equal types are one."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from blocks import Diagram, Gain
from blocks.contract.block import Block
from blocks.contract.equations import crossing, output, requires, wiring
from blocks.contract.interface import Interface, Value
from blocks.contract.resolution import Resolved, default_value, memory_start, resolve
from blocks.contract.variables import Discrete, Input, Parameter, State
from blocks.text.errors import ModelError


class Observer(Block):
    """Sizes from a structural parameter, a computed default, ports by element."""

    order = Parameter(2, structural=True, type="int", min=1)
    bandwidth = Parameter(None, unit="rad/s", excludes="gains")
    gains = Parameter(
        shape=lambda order: order + 1,
        default=lambda order, bandwidth: (
            [1.0] * (order + 1) if bandwidth is None else bandwidth ** np.arange(order + 1)
        ),
    )
    total = Parameter(lambda gains, scale: scale * np.sum(gains))
    scale = Parameter(lambda order: 2.0 * order)
    y = Input(unit="m")
    w = Input(0.0, shape=(2, 2), unit=lambda order: ["V", "mV", "A", "rpm"])
    z = State(shape=lambda order: order + 1, output=True, ports="z{}")

    @z.derivative
    def dz(z, y, gains, total):
        return gains * (y - z[0]) / total

    @output(type="bool")
    def ready(z):
        return z[0] > 0


class Matrices(Block):
    """Sizes from the values themselves."""

    A = Parameter([[0.0, 1.0], [0.0, 0.0]], shape=("n", "n"), zeros=True)
    B = Parameter([[0.0], [1.0]], shape=("n", "m"), zeros=True)
    D = Parameter(0.0, shape=(1, "m"))
    x = State(shape=lambda n: n)

    @x.derivative
    def dx(A, x, B, m):
        return A @ x + np.sum(B)


class Kinds(Block):
    """One parameter of each kind."""

    real = Parameter(1.0, unit="ms", min=0.5, max=2000.0)
    gain = Parameter(1.0, positive=True)
    flag = Parameter(False, type="bool")
    flags = Parameter(True, type="bool", shape=2)
    count = Parameter(3, structural=True, type="int")
    factor = Parameter(0.5, structural=True)
    switch = Parameter(False, type="bool", structural=True)
    word = Parameter("a", choices=("a", "b"), structural=True)
    needed = Parameter()
    lower = Parameter(-1.0)
    upper = Parameter(1.0)
    vector = Parameter(0.0, shape=3)

    @requires("lower must be below upper")
    def ordered(lower, upper):
        return lower < upper


class Clocks(Block):
    """Periods and offsets in every form."""

    period = Parameter(100, unit="ms")
    slow = Parameter(1.0)
    n = Parameter(3, structural=True, type="int")
    u = Input()
    d = Discrete(visible="after")

    a = output(lambda u: u, every=0.1, offset=0.05)
    b = output(lambda u: u, every=period, start=7.0)
    c = output(lambda u: [u, u], every=lambda period, n: n * period, offset=lambda period: period / 3, shape=2)
    e = output(lambda u: u, every=lambda slow: np.sqrt(slow) / 4, start=slow)
    f = output(lambda u: [u, u], every=1, shape=2, start=lambda slow, n: [slow, n])

    @d.next(every=lambda period: 2 * period)
    def update(d, tick):
        return d + tick


def given(**values: Any) -> dict[str, Value]:
    return {name: Value(value) for name, value in values.items()}


def resolved(cls: Any, **values: Any) -> Resolved:
    return resolve(cls, given(**values))


def faults(cls: Any, **values: Any) -> list[str]:
    with pytest.raises(ModelError) as caught:
        resolve(cls, given(**values), "loop.block")
    return [str(fault) for fault in caught.value.faults]


def value(made: Resolved, name: str) -> Any:
    found = made.values[name].value
    return found.tolist() if isinstance(found, np.ndarray) else found


# --- values ----------------------------------------------------------------------------------------------------


def test_values_get_the_type_of_their_parameter() -> None:
    made = resolved(Kinds, needed=4, flag=True, flags=[True, False], count=5.0, factor=2, switch=np.True_, word="b")
    assert {name: value(made, name) for name in Kinds.declaration.parameters} == {
        "real": 0.001, "gain": 1.0, "flag": 1.0, "flags": [1.0, 0.0], "count": 5, "factor": 2.0, "switch": True,
        "word": "b", "needed": 4.0, "lower": -1.0, "upper": 1.0, "vector": [0.0, 0.0, 0.0],
    }  # fmt: skip
    assert [type(made.values[name].value) for name in ("count", "factor", "switch")] == [int, float, bool]
    assert made.interface.structural == {"count": 5, "factor": 2.0, "switch": True, "word": "b"}
    assert "count" not in made.interface.symbolic_parameters
    assert "flag" in made.interface.symbolic_parameters


def test_values_can_not_be_changed_and_are_shared_with_nobody() -> None:
    numbers = np.array([1.0, 2.0, 3.0])
    made = resolved(Kinds, needed=1.0, vector=numbers)
    numbers[0] = 9.0
    assert value(made, "vector") == [1.0, 2.0, 3.0]
    for name in ("vector", "flags", "gain"):
        with pytest.raises(ValueError, match="read-only"):
            made.values[name].value[...] = 0.0


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"gain": 0.0}, "E107 loop.block.gain: must be above 0, not 0.0."),
        ({"gain": -1.0}, "must be above 0, not -1.0."),
        ({"gain": math.nan}, "must be finite, not nan."),
        ({"gain": math.inf}, "must be finite, not inf."),
        ({"gain": "1"}, "must be a number, not the text '1'."),
        ({"gain": None}, "must be a number, not None."),
        ({"gain": True}, "must be a number, not True."),
        ({"gain": 1j}, "must be a number, not 1j."),
        ({"gain": {}}, "must be a number, not {}."),
        ({"vector": ["1", "2", "3"]}, "must be a number, not ['1', '2', '3']."),
        ({"vector": [1.0, [2.0]]}, "must be numbers in rows of equal length, not [1.0, [2.0]]."),
        ({"vector": [True, False, True]}, "must be a number, not [True, False, True]."),
        ({"vector": [1.0, math.nan, 2.0]}, "must be finite, not [ 1. nan 2.]."),
        ({"vector": [1.0, 2.0]}, "E110 loop.block.vector: has the shape 2, but 3 is needed."),
        ({"vector": [[1.0, 2.0, 3.0]]}, "has the shape 1 x 3, but 3 is needed."),
        ({"gain": [1.0]}, "has the shape 1, but a scalar is needed."),
        ({"real": 0.0004}, "must be at least 0.5 ms, not 0.0004 s."),
        ({"real": 3.0}, "must be at most 2000.0 ms, not 3.0 s."),
        ({"flag": 1.0}, "must be true or false, not 1.0."),
        ({"switch": [False]}, "must be true or false, not [False]."),
        ({"flag": "true"}, "must be true or false, not 'true'."),
        ({"switch": 0}, "must be true or false, not 0."),
        ({"count": 2.5}, "must be an integer, not 2.5."),
        ({"count": 2**60}, "must be an integer, not 1152921504606846976."),
        ({"count": [1]}, "must be one number, not [1]."),
        ({"count": math.nan}, "must be finite, not nan."),
        ({"count": True}, "must be a number, not True."),
        ({"factor": [1.0]}, "must be one number, not [1.]."),
        ({"factor": math.inf}, "must be finite, not inf."),
        ({"word": "c"}, "must be one of a, b, not 'c'."),
        ({"word": 1.0}, "must be a text, not 1.0."),
        ({"lower": 2.0}, "E107 loop.block: lower must be below upper (lower = 2.0, upper = 1.0)."),
        ({"gian": 2.0}, "E106 loop.block.gian: there is no such parameter. Did you mean 'gain'?"),
    ],
)
def test_a_value_that_is_not_allowed_is_told(values: dict[str, Any], text: str) -> None:
    (message,) = faults(Kinds, needed=1.0, **values)
    assert text in message


def test_all_values_that_are_not_allowed_are_told_at_once() -> None:
    assert faults(Kinds, gain="x", flag=2.0) == [
        "E107 loop.block.gain: must be a number, not the text 'x'. Begin an expression with =, as in \"=2*gain\".",
        "E107 loop.block.flag: must be true or false, not 2.0.",
        'E107 loop.block.needed: must be given: it has no default. Add "needed" to its parameters.',
    ]
    assert [text[:24] for text in faults(Kinds, needed=1.0, gain=0.0, real=0.0)] == [
        "E107 loop.block.real: mu",
        "E107 loop.block.gain: mu",
    ]


def test_without_a_place_faults_name_the_class() -> None:
    with pytest.raises(ModelError, match=r"E107 Kinds\.needed: must be given"):
        resolve(Kinds, {})


def test_two_parameters_that_exclude_each_other_are_not_given_together() -> None:
    assert faults(Observer, bandwidth=2.0, gains=[1.0, 2.0, 3.0]) == [
        "E107 loop.block.bandwidth: cannot be given together with 'gains'. Give only one of the two."
    ]
    assert value(resolved(Observer, bandwidth=None, gains=[1.0, 2.0, 3.0]), "gains") == [1.0, 2.0, 3.0]


def test_integers_too_long_for_numpy_are_numbers() -> None:
    assert value(resolved(Kinds, needed=10**30), "needed") == 1e30


# --- defaults --------------------------------------------------------------------------------------------------


def test_defaults_are_computed_from_each_other() -> None:
    made = resolved(Observer, bandwidth=2.0, order=3)
    assert value(made, "gains") == [1.0, 2.0, 4.0, 8.0]
    assert value(made, "scale") == 6.0
    assert value(made, "total") == 90.0
    assert value(resolved(Observer, scale=1.0), "total") == 3.0
    assert value(resolved(Observer), "bandwidth") is None


def test_a_computed_default_that_fails_is_told() -> None:
    class Failing(Block):
        n = Parameter(1, structural=True, type="int")
        a = Parameter(None)
        b = Parameter(lambda n, a: [1.0, 2.0][n] if a is None else a * None)
        c = Parameter(lambda b: 1.0 / (b - 5.0))

    assert faults(Failing, n=2) == [
        "E107 loop.block.b: the default cannot be computed: IndexError: list index out of range."
    ]
    assert "TypeError" in faults(Failing, a=1.0)[0]
    assert faults(Failing, b=5.0) == ["E107 loop.block.c: the default must be finite, not inf."]


def test_a_default_that_is_not_allowed_is_told() -> None:
    class Wrong(Block):
        a = Parameter("text")

    class Below(Block):
        a = Parameter(-1.0, positive=True)

    assert faults(Wrong) == ["E107 loop.block.a: the default must be a number, not the text 'text'."]
    assert faults(Below) == ["E107 loop.block.a: must be above 0, not -1.0."]
    assert resolved(Below, a=1.0)


def test_defaults_are_in_the_unit_of_their_declaration() -> None:
    made = default_value(Parameter(100, unit="ms"), "ms")
    assert (made.value, made.exact) == (0.1, Fraction(1, 10))
    assert default_value(Parameter([1.0, 2.0], unit="mm", shape=2), "mm").value.tolist() == [0.001, 0.002]
    assert default_value(Parameter(30.0, unit="rpm"), "rpm").exact is None
    assert default_value(Parameter(30.0, unit="rpm"), "rpm").value == pytest.approx(math.pi, rel=1e-15)


def test_a_requirement_that_cannot_be_computed_is_told() -> None:
    class Strange(Block):
        a = Parameter(None)

        @requires("a must be above 1")
        def above(a):
            return a > 1

    assert "a must be above 1 (TypeError: " in faults(Strange)[0]
    assert resolved(Strange, a=2.0)


# --- sizes -----------------------------------------------------------------------------------------------------


def test_sizes_come_from_the_values() -> None:
    made = resolved(Matrices, A=np.eye(3), B=np.ones((3, 2)))
    assert made.interface.structural == {"n": 3, "m": 2}
    assert made.interface.shape(Matrices.x) == (3,)
    assert value(made, "D") == [[0.0, 0.0]]
    assert resolved(Matrices).interface.structural == {"n": 2, "m": 1}


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"A": [[1.0, 2.0]]}, "E110 loop.block.A: has the shape 1 x 2, but n x n is needed."),
        ({"A": np.eye(3)}, "E110 loop.block.B: has the shape 2 x 1, which makes n = 2, but A makes it 3."),
        (
            {"A": np.eye(2), "B": np.ones((3, 1))},
            "E110 loop.block.B: has the shape 3 x 1, which makes n = 3, but A makes it 2.",
        ),
        ({"A": [1.0, 2.0]}, "E110 loop.block.A: has 1 dimension, but 2 are needed."),
        ({"D": [[1.0, 2.0]]}, "E110 loop.block.B: has the shape 2 x 1, which makes m = 1, but D makes it 2."),
        ({"D": [[1.0], [2.0]]}, "E110 loop.block.D: has the shape 2 x 1, but 1 x 1 is needed."),
    ],
)
def test_sizes_that_contradict_each_other_are_told(values: dict[str, Any], text: str) -> None:
    assert text in faults(Matrices, **values)


class Sized(Block):
    size = Parameter(1.0)
    sizes = Parameter([1.0, 2.0], shape="n")
    x = State(shape=lambda n: n, nominal=lambda sizes, size: sizes * size)
    y = State(unit="km", nominal=lambda n: 10.0**-n)
    z = State(shape=2, nominal=lambda size: size)
    plain = State(shape=(1, 2), nominal=3)

    @x.derivative
    def dx(x):
        return -x

    @y.derivative
    def dy(y):
        return -y

    @z.derivative
    def dz(z):
        return -z

    @plain.derivative
    def dplain(plain):
        return -plain


def test_the_nominal_of_a_state_is_a_number_or_what_its_function_gives_for_the_parameters() -> None:
    assert resolved(Sized).nominal == (1.0, 2.0, 0.01, 1.0, 1.0, 3.0, 3.0)
    assert resolved(Sized, size=0.5, sizes=[8.0]).nominal == (4.0, 0.1, 0.5, 0.5, 3.0, 3.0)


class OneForTwo(Block):
    n = Parameter(2, type="int", structural=True)
    x = State(shape=2, nominal=lambda n: np.ones(n))

    @x.derivative
    def dx(x):
        return -x


def test_a_nominal_that_is_no_size_is_refused_where_it_stands() -> None:
    told = "E110 loop.block.{}: its nominal cannot be computed: ValueError: {} must be above 0 and finite."
    both = [told.format("x", "[-1. -2.]"), told.format("z", "-1.0")]
    assert faults(Sized, size=-1.0) == both
    assert faults(Sized, sizes=[1.0, 0.0]) == [told.format("x", "[1. 0.]")]
    assert resolved(OneForTwo).nominal == (1.0, 1.0)
    shape = "it has the shape {}, but 2 or one number is needed."
    for n in (1, 3):
        (fault,) = faults(OneForTwo, n=n)
        assert fault == f"E110 loop.block.x: its nominal cannot be computed: ValueError: {shape.format(n)}"


def test_a_size_that_nothing_tells_is_told() -> None:
    class Unknown(Block):
        a = Parameter(1.0, shape="n")

    assert faults(Unknown) == ["E110 loop.block: the size n is not known. Give an array that determines it."]
    assert resolved(Unknown, a=[1.0, 2.0]).interface.structural == {"n": 2}


def test_a_shape_that_is_no_size_is_told() -> None:
    class Wide(Block):
        n = Parameter(2, structural=True, type="int")
        a = Parameter(1.0, shape=lambda n: 6 / n)
        b = Parameter(1.0, shape=(lambda n: n - 3, 2))
        c = Parameter(1.0, shape=lambda n: [1.0, 2.0][n])

    assert faults(Wide) == [
        "E110 Wide.a: a size must be an integer from 0 on, not 3.0.",
        "E110 Wide.b: a size must be an integer from 0 on, not -1.",
        "E110 Wide.c: the shape cannot be computed: IndexError: list index out of range.",
    ]


def test_shapes_may_be_integers_of_numpy_and_lists() -> None:
    class Plain(Block):
        n = Parameter(2, structural=True, type="int")
        u = Input(shape=lambda n: np.int64(n))
        v = Input(shape=lambda n: [n, 3])
        w = Input(shape=(lambda n: n, 2))

    made = resolved(Plain).interface
    assert [made.shape(v) for v in (Plain.u, Plain.v, Plain.w)] == [(2,), (2, 3), (2, 2)]
    assert all(type(size) is int for size in made.shape(Plain.u))


# --- ports -----------------------------------------------------------------------------------------------------


def test_ports_tell_their_element_shape_unit_and_type() -> None:
    made = resolved(Observer).interface
    assert list(made.inputs) == ["y", "w"]
    assert list(made.outputs) == ["ready", "z1", "z2", "z3"]
    w = made.inputs["w"]
    assert (w.shape, w.size, w.units, w.default) == ((2, 2), 4, ("V", "V", "A", "rad/s"), (0.0,) * 4)
    assert (w.declared, w.unit) == (("V", "mV", "A", "rpm"), "")
    z2 = made.outputs["z2"]
    assert (z2.variable, z2.shape, z2.first, z2.size, z2.unit) == ("z", (), 1, 1, "")
    assert (made.outputs["ready"].type, made.inputs["y"].unit, made.inputs["y"].default) == ("bool", "m", None)


def test_units_must_be_as_many_as_the_elements_and_readable() -> None:
    class Few(Block):
        u = Input(shape=3, unit=lambda: ["V", "A"])

    class Bad(Block):
        u = Input(unit=lambda: "parsec2x")

    class Failing(Block):
        u = Input(unit=lambda: 1 / 0)

    with pytest.raises(ModelError, match=r"E110 Few\.u: has 3 elements but 2 units\."):
        _ = resolved(Few).interface.inputs
    with pytest.raises(ModelError, match=r"E114 Bad\.u: .*parsec2x"):
        _ = resolved(Bad).interface.inputs
    with pytest.raises(ModelError, match=r"E110 Failing\.u: the unit cannot be computed: ZeroDivisionError"):
        _ = resolved(Failing).interface.inputs


def test_two_ports_of_one_name_are_told() -> None:
    class Twice(Block):
        u1 = Input()
        u = Input(shape=2, ports="u{}")

    with pytest.raises(ModelError, match=r"E109 Twice\.u1: 'u1' and 'u' both have a port of this name\."):
        _ = resolved(Twice).interface.inputs


class Rig(Block):
    """Ports that the block is given the names of."""

    inputs = Parameter("", structural=True, type="string")
    outputs = Parameter("", structural=True, type="string")
    u = Input(shape=2, unit=lambda: ["V", "A"], ports=inputs)
    x = State(shape=2, output=True)

    @x.derivative
    def dx(u):
        return u

    @output(shape=2, ports=outputs)
    def y(x):
        return x


def test_names_that_a_block_is_given_are_ports_of_its_elements() -> None:
    rig = resolved(Rig, inputs="F, d", outputs="p,v").interface
    assert [(port.name, port.variable, port.first, port.shape, port.unit) for port in rig.inputs.values()] == [
        ("F", "u", 0, (), "V"),
        ("d", "u", 1, (), "A"),
    ]
    assert [*rig.outputs] == ["p", "v", "x"]
    assert [*resolved(Rig).interface.inputs, *resolved(Rig).interface.outputs] == ["u", "y", "x"]
    # Names of one side may be the variables of the other.
    assert [*resolved(Rig, inputs="y, w", outputs="u, v").interface.inputs] == ["y", "w"]


def test_a_state_gives_way_to_a_port_that_is_given_its_name() -> None:
    assert [*resolved(Rig, outputs="x, v").interface.outputs] == ["x", "v"]
    assert [*resolved(Rig, inputs="v, x").interface.outputs] == ["y"]


@pytest.mark.parametrize(
    ("inputs", "outputs", "text"),
    [
        ("a", "", "E110 Rig.inputs: has 1 name, but u has 2 elements. Give one name for each element"),
        ("", "a, b, c", "E110 Rig.outputs: has 3 names, but y has 2 elements."),
        ("a, 1b", "", 'E110 Rig.inputs: "1b" cannot be the name of a port.'),
        ("a, ", "", 'E110 Rig.inputs: "" cannot be the name of a port.'),
        ("a, a", "", "E109 Rig.a: 'u' and 'u' both have a port of this name."),
        ("a, b", "a, c", "E109 Rig.a: is the name of both an input and an output. Choose another name."),
        ("y, b", "", "E109 Rig.y: is the name of both an input and an output."),
        ("inputs, b", "", "E109 Rig.inputs: is the name of a parameter."),
    ],
)
def test_given_names_that_cannot_be_ports_are_refused(inputs: str, outputs: str, text: str) -> None:
    rig = resolved(Rig, inputs=inputs, outputs=outputs).interface
    with pytest.raises(ModelError) as caught:
        _ = rig.outputs
    assert str(caught.value).startswith(text)


def test_an_abstract_block_may_have_the_names_of_ports() -> None:
    class Named(Block, abstract=True):
        names = Parameter("", structural=True, type="string")
        u = Input(shape=2, ports=names)

    class Adder(Named):
        @output
        def y(u):
            return u[0] + u[1]

    assert [*resolved(Adder, names="a, b").interface.inputs] == ["a", "b"]


def test_wiring_is_an_output_port() -> None:
    class Swap(Block):
        u = Input(shape=2)

        @wiring(shape=2, ports="y{}")
        def y(u):
            return u[::-1]

    assert list(resolved(Swap).interface.outputs) == ["y1", "y2"]


# --- types -----------------------------------------------------------------------------------------------------


def test_equal_types_are_equal_and_others_are_not() -> None:
    one, two = resolved(Observer, gains=[1.0, 2.0, 3.0]).interface, resolved(Observer).interface
    assert one == two
    assert hash(one) == hash(two)
    assert one != resolved(Observer, order=3).interface
    assert one != resolved(Matrices).interface
    assert one != "Observer"
    assert len({one, two}) == 1


def test_the_order_in_which_values_are_given_does_not_make_a_type() -> None:
    A, B = np.ones((2, 2)), np.ones((2, 1))
    one, two = resolved(Matrices, A=A, B=B).interface, resolved(Matrices, B=B, A=A).interface
    assert one == two
    assert hash(one) == hash(two)


def test_zeros_of_a_pattern_make_a_type_and_values_do_not() -> None:
    plain = resolved(Matrices).interface
    assert plain.patterns == {"A": (False, True, False, False), "B": (False, True)}
    assert plain == resolved(Matrices, A=[[0.0, 7.0], [0.0, -0.0]]).interface
    assert plain != resolved(Matrices, A=[[0.0, 7.0], [1e-300, 0.0]]).interface
    assert plain == resolved(Matrices, D=3.0).interface


def test_an_interface_can_be_made_by_hand() -> None:
    assert Interface(Observer, {"order": 2}, {}) == resolved(Observer).interface
    assert Interface(Observer, {"order": 2}, {}).name == "Observer"


# --- clocks ----------------------------------------------------------------------------------------------------


def test_clocks_are_exact_fractions() -> None:
    clocks = resolved(Clocks).clocks
    assert clocks == {
        "a": (Fraction(1, 10), Fraction(1, 20)),
        "b": (Fraction(1, 10), 0),
        "c": (Fraction(3, 10), Fraction(1, 30)),
        "e": (Fraction(1, 4), 0),
        "f": (1, 0),
        "update": (Fraction(1, 5), 0),
    }
    assert all(isinstance(x, Fraction) for clock in clocks.values() for x in clock)


def test_given_periods_are_exact() -> None:
    assert resolved(Clocks, period=0.3).clocks["b"][0] == Fraction(3, 10)
    assert resolved(Clocks, period=0.3).clocks["update"][0] == Fraction(3, 5)
    third = resolve(Clocks, {"period": Value(1 / 3, Fraction(1, 3), "s")})
    assert (third.clocks["b"][0], third.clocks["c"]) == (Fraction(1, 3), (1, Fraction(1, 9)))
    assert resolved(Clocks, n=7, period=1e-3).clocks["c"][0] == Fraction(7, 1000)


def test_a_clock_that_cannot_tick_is_told() -> None:
    class Fails(Block):
        Ts = Parameter(1.0)
        a = output(lambda: 0.0, every=Ts)
        b = output(lambda: 0.0, every=lambda Ts: 1 / (Ts - 2.0), offset=lambda Ts: -Ts)

    assert faults(Fails, Ts=-1.0) == [
        (
            "E107 loop.block.a: cannot tick every -1.0 s from 0.0 s on. "
            "The period must be above 0 s, and the offset 0 s or more."
        ),
        (
            "E107 loop.block.b: cannot tick every -0.3333333333333333 s from "
            "1.0 s on. The period must be above 0 s, and the offset 0 s or more."
        ),
    ]
    assert faults(Fails, Ts=3.0) == [
        (
            "E107 loop.block.b: cannot tick every 1.0 s from -3.0 s on. "
            "The period must be above 0 s, and the offset 0 s or more."
        )
    ]
    assert "loop.block.b: its clock cannot be computed: " in faults(Fails, Ts=2.0)[0]


# --- starts ----------------------------------------------------------------------------------------------------


def test_a_sampled_output_is_held_from_its_start() -> None:
    starts = resolved(Clocks, slow=2.0).starts
    assert {name: start.tolist() for name, start in starts.items()} == {
        "a": [0.0], "b": [7.0], "c": [0.0, 0.0], "e": [2.0], "f": [2.0, 3.0],
    }  # fmt: skip


def test_a_start_that_does_not_fit_is_told() -> None:
    class Long(Block):
        y = output(lambda: [0.0, 0.0], every=1, shape=2, start=[1.0, 2.0, 3.0])
        z = output(lambda: 0.0, every=1, start=lambda: math.inf)

    wide, infinite = faults(Long)
    assert "E110 loop.block.y: its start cannot be computed: ValueError: " in wide
    assert "E110 loop.block.z: its start cannot be computed: ValueError: [inf] is not finite." in infinite


def test_memories_start_at_their_parameter_or_by_their_equation() -> None:
    class Memories(Block):
        a = State(2.0, unit="mm")
        b = Discrete(True, type="bool")
        c = State(1.0, shape=2)
        e = State()

        @a.derivative
        @c.derivative
        @e.derivative
        @e.initial
        def zero():
            return 0.0

        @crossing
        def hit(a):
            return a

        @hit.reset(b)
        def b0():
            return False

    made = resolved(Memories, c_start=[3.0, 4.0])
    found = [memory_start(made.values, v) for v in (Memories.a, Memories.b, Memories.c, Memories.e)]
    assert [None if x is None else x.tolist() for x in found] == [[0.002], [1.0], [3.0, 4.0], None]


def test_equal_types_share_their_interface_and_zeros_of_two_signs_do_not() -> None:
    class Signed(Block):
        """y = its structural number."""

        level = Parameter(0.0, structural=True)
        scale = Parameter(1.0)

        @output
        def y(scale):
            return scale

    def made(level: float, scale: float) -> Interface:
        return resolve(Signed, {"level": Value(level), "scale": Value(scale)}).interface

    assert made(0.0, 2.0) is made(0.0, 3.0)
    positive, negative = made(0.0, 1.0), made(-0.0, 1.0)
    assert math.copysign(1.0, positive.structural["level"]) == 1.0
    assert math.copysign(1.0, negative.structural["level"]) == -1.0
    assert positive == negative


@pytest.mark.parametrize("values", [{"unit_u": "degC", "unit": "degC"}, {"unit_u": "degC", "unit": "V"}])
def test_a_default_in_a_unit_that_is_refused_has_the_code_of_that(values: dict[str, str]) -> None:
    with pytest.raises(ModelError) as caught:
        Diagram.alone(Gain(**values)).flatten()
    (fault,) = caught.value.faults
    assert (fault.code, fault.place) == ("E114", "Gain.k")
    assert "E1" not in fault.message
    assert fault.cure == "Use K, the unit of differences."
