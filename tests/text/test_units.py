"""Units are read, compared, scaled and multiplied."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from blocks.text import units
from blocks.text.errors import ModelError

SYMBOLS = sorted(units._SYMBOLS)

powers = st.integers(-3, 3).filter(bool)
terms = st.builds(lambda symbol, n: f"{symbol}{n}" if n != 1 else symbol, st.sampled_from(SYMBOLS), powers)
texts = st.builds(
    lambda first, rest: first + "".join(sign + term for sign, term in rest),
    terms,
    st.lists(st.tuples(st.sampled_from("./"), terms), max_size=2),
)


def is_readable(text: str) -> bool:
    try:
        units.parse(text)
    except ModelError:
        return False
    return True


readable = texts.filter(is_readable)


def message(text: str) -> str:
    with pytest.raises(ModelError) as caught:
        units.parse(text)
    assert [fault.code for fault in caught.value.faults] == ["E114"]
    return str(caught.value)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("N", "kg.m/s2"), ("J", "N.m"), ("W", "J/s"), ("V", "W/A"), ("Ohm", "V/A"), ("S", "A/V"), ("C", "A.s"),
        ("F", "C/V"), ("Wb", "V.s"), ("H", "Wb/A"), ("T", "Wb/m2"), ("Pa", "N/m2"), ("Hz", "1/s"), ("W", "kg.m2/s3"),
        ("1/s", "s-1"), ("kg", "1.kg"), ("V/m.s", "(V/m).s"), ("N.m/(rad/s)", "N.m.s/rad"), ("J/kg/K", "J/(kg.K)"),
        ("(m/s)2", "m2/s2"), ("s+2", "s2"), ("m0", "1"),
    ],
)  # fmt: skip
def test_two_texts_of_one_unit_have_one_dimension_and_factor_1(a: str, b: str) -> None:
    assert units.parse(a).dimension == units.parse(b).dimension
    assert units.parse(a).exact == units.parse(b).exact == Fraction(1)
    assert units.parse(a).factor == 1.0


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("mV", "1e-3"), ("kN", "1e3"), ("mOhm", "1e-3"), ("uF", "1e-6"), ("kHz", "1e3"), ("ms", "1e-3"), ("km", "1e3"),
        ("g", "1e-3"), ("mg", "1e-6"), ("t", "1e3"), ("l", "1e-3"), ("mL", "1e-6"), ("bar", "1e5"), ("mbar", "100"),
        ("min", "60"), ("h", "3600"), ("d", "86400"), ("%", "0.01"), ("cd", "1"), ("daN", "10"), ("cm2", "1e-4"),
        ("km/h", "5/18"), ("A.h", "3600"), ("g.mm2", "1e-9"), ("mrad/ms", "1"),
    ],
)  # fmt: skip
def test_a_factor_is_an_exact_fraction_and_its_nearest_float(text: str, factor: str) -> None:
    assert units.parse(text).exact == Fraction(factor)
    assert units.parse(text).factor == float(Fraction(factor))


@pytest.mark.parametrize(
    ("text", "factor"),
    [("deg", math.pi / 180), ("rev", 2 * math.pi), ("rpm", math.pi / 30), ("rpm2", math.pi**2 / 900)],
)
def test_a_factor_with_pi_has_no_exact_fraction(text: str, factor: float) -> None:
    assert units.parse(text).exact is None
    # The reference rounds up to three times, each time by half a unit of the last place.
    assert units.parse(text).factor == pytest.approx(factor, rel=4 * 2**-53, abs=0)


def test_a_dimension_holds_the_exponents_in_the_order_of_the_base() -> None:
    assert units.BASE == ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
    assert units.parse("V.s/rad").dimension == (1, 2, -2, -1, 0, 0, 0, -1)
    assert units.parse("1").dimension == (0,) * 8
    for index, name in enumerate(units.BASE):
        assert units.parse(name).dimension == tuple(int(index == k) for k in range(8))


def test_every_symbol_has_the_dimension_and_the_factor_of_its_coherent_unit() -> None:
    for name, symbol in units._SYMBOLS.items():
        coherent = units.parse(units._text(symbol.coherent))
        assert coherent.dimension == symbol.dimension, name
        assert coherent.exact == 1, name


def test_no_prefix_makes_a_symbol_ambiguous() -> None:
    for prefix in units._PREFIXES:
        for name in SYMBOLS:
            if prefix + name in units._SYMBOLS and name in units._SYMBOLS and prefix + name not in ("kg", "cd", "min"):
                ratio = units._SYMBOLS[prefix + name].rational / units._SYMBOLS[name].rational
                assert ratio == Fraction(10) ** units._PREFIXES[prefix], prefix + name


def test_the_radian_is_not_1() -> None:
    assert not units.same_quantity("rad/s", "Hz")
    assert not units.same_quantity("rad", "1")
    assert units.same_quantity("rpm", "deg/s")
    assert units.same_quantity("%", "1")


def test_an_unknown_unit_fits_every_other() -> None:
    assert units.same_quantity("", "V")
    assert units.same_quantity("V", "")
    assert units.scale("", "mV") == units.scale("mV", "") == 1.0
    assert units.scale_exact("", "rpm") == 1
    assert units.to_si(3.5, "") == 3.5
    assert units.si_text("") == units.product("", "V") == units.quotient("V", "") == units.power("", 2) == ""


def test_scales_between_units_are_exact_where_pi_cancels() -> None:
    assert units.scale("kV", "mV") == 1e6
    assert units.scale("mV", "kV") == 1e-6
    assert units.scale_exact("rpm", "deg/s") == 6
    assert units.scale("rpm", "deg/s") == 6.0
    assert units.scale_exact("rpm", "rad/s") is None
    assert units.scale("rev", "rad") == 2 * math.pi
    assert units.scale_exact("min", "h") == Fraction(1, 60)


def test_different_quantities_have_no_scale() -> None:
    with pytest.raises(ModelError, match="E104 V and rad are different quantities"):
        units.scale("V", "rad")


def test_values_are_scaled_as_decimals_with_one_rounding() -> None:
    assert units.to_si(1200.0, "mOhm") == 1.2
    assert 0.9 * 1e-3 != 0.9e-3
    assert units.to_si(0.9, "mOhm") == 0.9e-3
    assert units.to_si(180.0, "deg") == math.pi
    assert units.to_si(1.0, "rev") == 2 * math.pi
    assert units.to_si(0.3, "ms", exact=Fraction(1, 3)) == 1 / 3000


@given(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([("ms", Fraction(1, 1000), 0), ("km/h", Fraction(5, 18), 0), ("Mm", Fraction(10**6), 0),
                     ("degF", Fraction(5, 9), Fraction("459.67") * 5 / 9)]),
)  # fmt: skip
def test_a_value_in_si_is_the_fraction_of_its_decimal(value: float, unit: tuple[str, Fraction, Fraction]) -> None:
    text, factor, offset = unit
    try:
        expected = float(Fraction(repr(value)) * factor + offset)
    except OverflowError:
        expected = math.copysign(math.inf, value)
    assert units.to_si(value, text) == expected


def test_values_that_need_no_scaling_come_back_as_they_are() -> None:
    assert units.to_si(0.1, "N.m", exact=Fraction(1, 3)) == 0.1
    assert units.to_si(math.inf, "mV") == math.inf
    assert math.isnan(units.to_si(math.nan, "mV"))
    assert math.copysign(1, units.to_si(-0.0, "mV")) == -1
    assert units.to_si(-1e308, "km") == -math.inf


@pytest.mark.parametrize(
    ("unit", "shown"),
    [
        ("mOhm", "Ohm"), ("rpm", "rad/s"), ("deg", "rad"), ("ms", "s"), ("km/h", "m/s"), ("%", "1"), ("L/min", "m3/s"),
        ("1/min", "1/s"), ("kHz", "Hz"), ("g.mm2", "kg.m2"), ("A.h", "A.s"), ("mV.s/rad", "V.s/rad"),
        ("deg/s", "rad/s"), ("rpm/s", "rad/s2"), ("kW.h/(kg.K)", "W.s/(kg.K)"), ("1/rpm", "s/rad"),
        ("N.m/(rad/s)", "N.m/(rad/s)"), ("kN.mm", "kN.mm"), ("Hz", "Hz"), ("J/kg/K", "J/kg/K"),
    ],
)  # fmt: skip
def test_si_values_are_shown_in_a_unit_with_factor_1(unit: str, shown: str) -> None:
    assert units.si_text(unit) == shown


def test_a_coherent_unit_beyond_the_largest_power_is_shown_in_base_units() -> None:
    assert units.si_text("l7/J5") == "m11.s10/kg5"


def test_unit_algebra_gives_short_texts() -> None:
    assert units.quotient("rad", "s") == "rad/s"
    assert units.quotient("rad/s", "s") == "rad/s2"
    assert units.quotient("V", "rad/s") == "V.s/rad"
    assert units.quotient("J", "kg.K") == "J/(kg.K)"
    assert units.quotient("V", "V") == "1"
    assert units.quotient("1", "s") == "1/s"
    assert units.quotient("V", "mV") == "V/mV"
    assert units.power("s", 2) == "s2"
    assert units.power("rad/s", -2) == "s2/rad2"
    assert units.power("V", 0) == "1"
    assert units.product("1", "V") == "V"
    assert units.product("rad/s", "s") == "rad"
    assert units.product("1/s", "V") == "V/s"


def test_unit_algebra_refuses_what_could_not_be_read() -> None:
    with pytest.raises(ModelError, match="the power 21 is beyond 20"):
        units.power("m", 21)


@given(readable, readable)
def test_dimensions_add_up_and_factors_multiply_in_products_and_quotients(a: str, b: str) -> None:
    one, other = units.parse(a), units.parse(b)
    for combine, sign in ((units.product, 1), (units.quotient, -1)):
        try:
            result = combine(a, b)
        except ModelError:
            continue
        unit = units.parse(result)
        assert unit.dimension == tuple(m + sign * n for m, n in zip(one.dimension, other.dimension, strict=True))
        if one.exact is not None and other.exact is not None:
            assert unit.exact == one.exact * other.exact**sign


@given(readable, st.integers(-3, 3))
def test_dimensions_multiply_in_powers(a: str, n: int) -> None:
    try:
        result = units.power(a, n)
    except ModelError:
        return
    assert units.parse(result).dimension == tuple(n * m for m in units.parse(a).dimension)


@given(readable)
def test_a_shown_unit_has_factor_1_and_the_same_dimension(text: str) -> None:
    shown = units.parse(units.si_text(text))
    assert shown.exact == 1
    assert shown.dimension == units.parse(text).dimension


@given(st.floats(-1e15, 1e15, allow_subnormal=False), readable)
def test_a_value_in_si_is_near_the_product_of_floats(value: float, text: str) -> None:
    # Four roundings: the decimal of the value, the factor, the product of floats, and the result.
    expected = value * units.parse(text).factor
    assert units.to_si(value, text) == pytest.approx(expected, rel=4 * 2**-53, abs=1e-300)


@given(st.one_of(st.text(max_size=120), st.text("kgmsAKradNVOh./()-+123 ²µ°%", max_size=30)))
def test_any_text_is_a_unit_or_a_fault(text: str) -> None:
    if is_readable(text):
        unit = units.parse(text)
        assert unit.text == text
        assert 0 < unit.factor < math.inf
    else:
        with pytest.raises(ModelError) as caught:
            units.parse(text)
        assert caught.value.code == "E114"
        assert caught.value.faults[0].cure


@pytest.mark.parametrize(
    ("text", "cure"),
    [
        ("Nm", "'N.m'"), ("V/Nm", "'V/(N.m)'"), ("kWh", "'kW.h'"), ("ohm", "'Ohm'"), ("hz", "'Hz'"), ("Kg", "'kg'"),
        ("sec", "'s'"), ("m^2", "'m2'"), ("m**2", "'m2'"), ("kg*m^2/s", "'kg.m2/s'"), ("m²", "'m2'"), ("N m", "'N.m'"),
        ("N / m", "'N/m'"), ("mΩ", "'mOhm'"), ("µF", "'uF'"), ("°", "'deg'"), ("1/rps", "'1/(rev/s)'"), (" V ", "'V'"),
        ("raad", "'rad'"), ("KHz", "'kHz'"), ("Ohms", "'Ohm'"),
        ("Newton.meter", "'N.m'"), ("s⁻¹", "'s-1'"),
    ],
)  # fmt: skip
def test_a_misspelt_unit_is_answered_with_the_right_one(text: str, cure: str) -> None:
    assert message(text).endswith(f"Did you mean {cure}?")


def test_messages_name_the_place_and_what_is_wrong() -> None:
    assert message("V/xyzzy").startswith("E114 the unit 'V/xyzzy' cannot be read at character 3: 'xyzzy' is not known.")
    assert "of kg m s A K mol cd rad N J W Pa" in message("V/xyzzy")
    assert "at the end: expected a unit" in message("V/")
    assert "at the end: expected ')'" in message("N.m/(rad/s")
    assert "at character 2: expected '.', '/' or the end" in message("m)")
    assert "at character 2: expected '.', '/' or the end" in message("12")
    assert "the power 21 is beyond 20" in message("m21")
    assert "holds the power 40; the limit is 20" in message("m20.m20")
    assert "more than 10 brackets in each other" in message("(" * 11 + "m" + ")" * 11)
    assert "the unit has 10000 characters; the limit is 100" in message("(" * 10_000)
    assert "larger than 1e100 or smaller than 1e-100" in message("Tm20")
    assert "the unit is empty" in message("")


# --- offsets ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value", "si", "difference"),
    [
        ("degC", 20.0, 293.15, "K"),
        ("degC", -273.15, 0.0, "K"),
        ("degF", 212.0, 373.15, "5/9*K"),
        ("K@273.15", 36.6, 309.75, "K"),
        ("bar@1.01325", 1.0, 201325.0, "bar"),
        ("100000*Pa@1.01325", 0.0, 101325.0, "100000*Pa"),
        ("6894.757*Pa", 2.0, 13789.514, "6894.757*Pa"),
    ],
)
def test_a_value_in_a_unit_with_an_offset_counts_from_there(
    text: str, value: float, si: float, difference: str
) -> None:
    assert units.to_si(value, text) == si
    assert units.from_si(si, text) == pytest.approx(value, abs=1e-12)
    assert units.difference(text) == difference
    assert units.difference(difference) == difference
    assert units.has_offset(text) == (difference != text)
    factor, offset = units.affine(text, units.si_text(text))
    assert factor * value + offset == pytest.approx(si, abs=1e-12)


def test_values_are_converted_between_units_with_offsets_exactly() -> None:
    assert units.converted(212.0, "degF", "degC") == 100.0
    assert units.converted(-40.0, "degC", "degF") == -40.0
    assert units.converted(0.5, "bar@1.01325", "kPa") == 151.325
    assert units.converted(3.0, "", "degC") == units.converted(3.0, "degC", "") == 3.0
    assert units.same_quantity("degC", "K")
    assert not units.same_quantity("degC", "rad")
    with pytest.raises(ModelError, match="E104 degC and Pa are different quantities"):
        units.converted(1.0, "degC", "Pa")


@pytest.mark.parametrize("text", ["J/degC", "degC.m", "degC2", "2*degC", "m/(degC)"])
def test_a_unit_with_an_offset_stands_alone(text: str) -> None:
    assert "use degC or degF alone" in message(text)
    with pytest.raises(ModelError, match="E114 'degC' has a factor or an offset"):
        units.quotient("V", "degC")


@pytest.mark.parametrize("text", ["°C", "℃", "celsius"])
def test_other_spellings_of_a_temperature_are_offered_one(text: str) -> None:
    assert "Did you mean 'degC'?" in message(text)


@pytest.mark.parametrize("text", ["K@", "@3", "K@x", "0*m", "-2*m", "2*", "1e999*m", "K@1@2"])
def test_a_number_in_a_unit_that_cannot_be_read_is_refused(text: str) -> None:
    assert message(text)
