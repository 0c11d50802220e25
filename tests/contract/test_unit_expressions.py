"""Units written as what they are: a text parameter of the class, and products, quotients and powers of it."""

import textwrap
from typing import Any

import pytest

from blocks import Block, Diagram, Input, Parameter, State, local, output
from blocks.contract.interface import Interface, Value
from blocks.contract.reads import arguments
from blocks.contract.resolution import resolve
from blocks.contract.tracing import trace
from blocks.text import units
from blocks.text.errors import DeclarationError, ModelError


class Written(Block):
    """All that can be written, beside the functions that mean the same."""

    unit = Parameter("", structural=True, type="string")
    unit_u = Parameter("", structural=True, type="string")
    alone = Parameter(2.0, unit=unit)
    alone_ = Parameter(2.0, unit=lambda unit: unit)
    gain = Parameter(1.0, unit=unit / unit_u)
    gain_ = Parameter(1.0, unit=lambda unit, unit_u: units.quotient(unit, unit_u))
    rate = Parameter(1.0, unit=unit / "s2")
    rate_ = Parameter(1.0, unit=lambda unit: units.quotient(unit, "s2"))
    inverse = Parameter(1.0, unit="1" / unit)
    inverse_ = Parameter(1.0, unit=lambda unit: units.quotient("1", unit))
    square = Parameter(1.0, unit=unit**2)
    square_ = Parameter(1.0, unit=lambda unit: units.power(unit, 2))
    area = Parameter(1.0, unit="m" * unit * "m")
    area_ = Parameter(1.0, unit=lambda unit: units.product(units.product("m", unit), "m"))
    long = Parameter(1.0, unit=(unit_u / unit / "s") ** -2)
    long_ = Parameter(1.0, unit=lambda unit, unit_u: units.power(units.quotient(units.quotient(unit_u, unit), "s"), -2))
    same = Parameter(1.0, unit=unit / unit)
    same_ = Parameter(1.0, unit=lambda unit: units.quotient(unit, unit))
    u = Input(unit=unit_u)
    y = State(unit=unit, output=True)

    @y.derivative
    def dy(u, gain):
        return gain * u

    @local(unit=unit / "s")
    def slope(u, gain):
        return gain * u

    @output(unit=unit / "s")
    def v(slope):
        return slope


@pytest.mark.parametrize("unit", ["", "m", "km/h", "1/s", "N.m/A", "s", "rad/s2"])
@pytest.mark.parametrize("unit_u", ["", "V", "1/s", "mOhm.s"])
def test_an_expression_gives_what_the_function_of_the_units_gives(unit: str, unit_u: str) -> None:
    interface = resolve(Written, {"unit": Value(unit), "unit_u": Value(unit_u)}).interface
    parameters = Written.declaration.parameters
    for name in ("alone", "gain", "rate", "inverse", "square", "area", "long", "same"):
        assert interface.declared_units(parameters[name]) == interface.declared_units(parameters[f"{name}_"]), name
    assert interface.outputs["v"].declared == (units.quotient(unit, "s") if unit else "",)


def test_an_unknown_unit_stays_unknown() -> None:
    interface = resolve(Written, {"unit": Value("m")}).interface
    parameters = Written.declaration.parameters
    assert interface.declared_units(parameters["gain"]) == ("",)
    assert interface.declared_units(parameters["rate"]) == ("m/s2",)


def test_numbers_are_scaled_by_the_unit_that_an_expression_gives() -> None:
    plain, scaled = resolve(Written, {"unit": Value("km")}), resolve(Written, {"unit": Value("m")})
    assert float(plain.values["alone"].value) == 2000.0
    assert float(plain.values["rate"].value) == 1000.0
    assert float(scaled.values["rate"].value) == 1.0
    assert float(plain.values["y_start"].value) == 0.0


def test_an_expression_reads_its_parameters_in_the_order_in_which_they_stand() -> None:
    unit: Any = Written.declaration.parameters["long"].unit
    assert arguments(unit, "") == ("unit_u", "unit")
    assert unit("V", "m") == "m2.s2/V2"
    assert repr(unit) == "<a unit that follows from unit_u, unit>"


def test_the_equations_know_nothing_of_how_units_are_written() -> None:
    class Functions(Block):
        unit = Parameter("", structural=True, type="string")
        k = Parameter(1.0, unit=lambda unit: units.quotient("1", unit))
        u = Input(unit=lambda unit: unit)

        @output
        def y(u, k):
            return k * u

    class Expressions(Block):
        unit = Parameter("", structural=True, type="string")
        k = Parameter(1.0, unit="1" / unit)
        u = Input(unit=unit)

        @output
        def y(u, k):
            return k * u

    tapes = [trace(resolve(cls, {"unit": Value("mm")}).interface) for cls in (Functions, Expressions)]
    assert tapes[0].nodes == tapes[1].nodes
    shapes = [Interface(cls, {"unit": "mm"}, {}).inputs["u"] for cls in (Functions, Expressions)]
    assert shapes[0] == shapes[1]


REFUSED = {
    "a parameter that is no text": (
        'n = Parameter(1, structural=True, type="int")\nk = Parameter(1.0, unit=n)',
        "E405 n: cannot be a unit: a unit must be a structural text.",
    ),
    "arithmetic with a number": (
        'T = Parameter(1.0, unit="s")\nk = Parameter(T / 2)',
        "E405 T: cannot be a unit: a unit must be a structural text.",
    ),
    "arithmetic the other way round": (
        'T = Parameter(1.0, unit="s")\nk = Parameter(2 * T)',
        "E405 T: cannot be a unit",
    ),
    "a power of a number": ("T = Parameter(1.0)\nk = Parameter(T**2)", "E405 T: cannot be a unit"),
    "a unit that does not exist": (
        'unit = Parameter("", structural=True, type="string")\nk = Parameter(1.0, unit=unit / "metre")',
        "E405 the unit 'metre' cannot be read",
    ),
    "the empty unit": (
        'unit = Parameter("", structural=True, type="string")\nk = Parameter(1.0, unit=unit / "")',
        "E405 the unit is empty.",
    ),
    "a unit times a number": (
        'unit = Parameter("", structural=True, type="string")\nk = Parameter(1.0, unit=2 * unit)',
        "E405 2 is not a unit.",
    ),
    "a broken power": (
        'unit = Parameter("", structural=True, type="string")\nk = Parameter(1.0, unit=unit ** 0.5)',
        "E405 the exponent of a unit must be a whole number, not 0.5.",
    ),
    "a parameter of another class": (
        "k = Parameter(1.0, unit=Written.unit)",
        "E402 Bad.k: its unit is of <a parameter 'unit'>, which is not a parameter of this block.",
    ),
    "a quotient of another class": (
        'unit = Parameter("", structural=True, type="string")\nk = Parameter(1.0, unit=unit / Written.unit_u)',
        "E402 Bad.k: its unit is of <a parameter 'unit_u'>, which is not a parameter of this block.",
    ),
    "a parameter without a name": (
        'k = Parameter(1.0, unit=Parameter("", structural=True, type="string"))',
        "E402 Bad.k: its unit is of <a parameter ''>, which is not a parameter of this block.",
    ),
    "an input": ("u = Input()\nk = Parameter(1.0, unit=u)", "E405 Bad.k: unit=<an input 'u'> is neither"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_unit_is_refused(case: str) -> None:
    body, message = REFUSED[case]
    names: dict[str, Any] = {"Block": Block, "Input": Input, "Parameter": Parameter, "Written": Written}
    with pytest.raises(DeclarationError) as caught:
        exec(f"class Bad(Block):\n{textwrap.indent(body, '    ')}", names)
    assert str(caught.value).startswith(message)


def test_the_cure_of_two_quantities_on_one_wire_names_the_parameter_that_gives_the_unit() -> None:
    diagram = Diagram("test")
    block = diagram.add("one", Written(unit="m", unit_u="A"))
    diagram.wire(block.u, diagram.input("u", unit="V"))
    with pytest.raises(ModelError) as caught:
        diagram.run(stop=1.0, inputs={"u": 1.0})
    assert caught.value.faults[0].code == "E104"
    assert 'the "unit_u" of one' in caught.value.faults[0].cure


def test_a_unit_that_cannot_be_read_is_told_when_it_is_given() -> None:
    with pytest.raises(ModelError, match="'metre' is not known"):
        resolve(Written, {"unit": Value("metre")})
