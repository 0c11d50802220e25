"""Expressions are read and computed, and nothing else can be written in them."""

import math
import operator
import time
from collections.abc import Mapping
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from blocks.contract.expressions import FUNCTIONS, Scalar, evaluate, exact_decimal, exact_time, parse
from blocks.text.errors import ModelError

NAMES = {"a": 0.75, "b": -1.5, "kt": 0.0274, "_x1": 12.0}
VALUES = {name: Scalar(value, exact_decimal(value)) for name, value in NAMES.items()}


def value(text: str, **values: float) -> float:
    return evaluate(parse(text), {name: Scalar(x) for name, x in values.items()}).value


def exact(text: str) -> Fraction | None:
    return evaluate(parse(text), VALUES).exact


def outcome(text: str, values: Mapping[str, Scalar]) -> Scalar | ModelError:
    """The value of a text, or the error that refuses it; any other exception fails the test."""
    try:
        return evaluate(parse(text), values)
    except ModelError as error:
        return error


def message(text: str, **values: float) -> str:
    with pytest.raises(ModelError) as caught:
        value(text, **values)
    assert {fault.code for fault in caught.value.faults} == {"E108"}
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1+2*3", 7.0), ("(1+2)*3", 9.0), ("8/4/2", 1.0), ("8-4-2", 2.0), ("2**3**2", 512.0), ("-2**2", -4.0),
        ("2**-1", 0.5), ("2**-1**2", 0.5), ("2*-3", -6.0), ("--3", 3.0), ("-+-3", 3.0), ("2**-1*4", 2.0),
        (" 1\t+\n2 ", 3.0),
        (".5+1.", 1.5), ("1e3", 1000.0), ("1.5E-1", 0.15), ("007", 7.0), ("pi", math.pi), ("2*pi", 2 * math.pi),
        ("sqrt(2)**2", math.sqrt(2) ** 2), ("exp(1)", math.e), ("log(exp(2))", 2.0), ("sin(pi/2)", 1.0),
        ("cos(0)", 1.0),
        ("tan(0)", 0.0), ("asin(1)", math.pi / 2), ("acos(1)", 0.0), ("atan(1)", math.pi / 4),
        ("atan2(-1, -1)", -3 * math.pi / 4),
        ("abs(-2)", 2.0), ("min(3, 1, 2)", 1.0), ("max(3, 1, 2)", 3.0), ("tanh(0)", 0.0), ("-abs(-2)**2", -4.0),
    ],
)  # fmt: skip
def test_arithmetic_is_that_of_python(text: str, expected: float) -> None:
    assert value(text) == expected


def test_names_stand_in_order_of_first_appearance() -> None:
    expression = parse("kt/(La*Jeq*n) + kt*La + sqrt(n)*pi")
    assert expression.names == ("kt", "La", "Jeq", "n")
    assert value("kt/(La*Jeq*n)", kt=6.0, La=0.5, Jeq=2.0, n=3.0) == 2.0


def test_a_single_name_is_told_from_arithmetic() -> None:
    assert parse("Kp").name == "Kp"
    assert parse(" Kp ").name == "Kp"
    assert parse("-Kp").name is None
    assert parse("1*Kp").name is None
    assert parse("pi").name is None
    assert parse("2").name is None


def test_a_bare_name_gives_the_value_unchanged() -> None:
    kp = Scalar(0.1, Fraction(1, 10))
    assert evaluate(parse("Kp"), {"Kp": kp}) is kp


def test_a_name_may_be_that_of_a_function() -> None:
    assert value("min(min, 2)", min=1.0) == 1.0


def test_fractions_are_those_of_the_decimals_as_written() -> None:
    assert evaluate(parse("0.1+0.2"), {}) == Scalar(0.1 + 0.2, Fraction(3, 10))
    assert exact("1/3") == Fraction(1, 3)
    assert exact("-(a-b)*2/abs(b)") == -3
    assert exact("min(1/3, a, 2)") == Fraction(1, 3)
    assert exact("max(1/3, +a)") == Fraction(3, 4)
    assert exact("(2/3)**-2") == Fraction(9, 4)
    assert exact("1.5e-3") == Fraction(3, 2000)
    assert exact("2**64") == 2**64


@pytest.mark.parametrize(
    "text",
    [
        "pi",
        "sqrt(4)",
        "1+sin(0)",
        "2**0.5",
        "1.1**65",
        "1.0000001**64**2",
        "1e-999999999",
        "0e999999999",
        "min(1, pi)",
        "0*pi",
    ],
)
def test_fractions_end_at_anything_irrational_or_long(text: str) -> None:
    assert exact(text) is None


def test_fractions_end_beyond_4096_bits() -> None:
    assert exact("(1/3)**64") == Fraction(1, 3**64)
    assert exact("((1/3)**64)**41") is None
    assert exact("0." + "1" * 990) == Fraction("0." + "1" * 990)
    assert exact("*".join(["1e-300"] * 5)) is None


def test_a_name_without_a_fraction_leaves_the_result_without_one() -> None:
    assert evaluate(parse("2*x"), {"x": Scalar(0.5)}) == Scalar(1.0, None)


def test_a_fraction_that_is_0_where_its_float_is_not_ends_there() -> None:
    assert evaluate(parse("1/(0.1+0.2-0.3)"), {}).exact is None
    assert evaluate(parse("(0.1+0.2-0.3)**-1"), {}).exact is None


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_exact_decimal_of_a_float_is_its_shortest(x: float) -> None:
    assert exact_decimal(x) == Fraction(repr(x))
    assert float(exact_decimal(x)) == x


@given(st.integers(1, 10**6), st.integers(1, 10**6))
def test_the_double_of_a_fraction_is_a_time_of_this_fraction(p: int, q: int) -> None:
    assert exact_time(p / q) == Fraction(p, q)
    assert exact_time(-p / q) == -Fraction(p, q)
    assert exact_time(Fraction(repr(p / q))) == Fraction(p, q)  # as a file has it


@given(st.integers(0, 10**10), st.integers(0, 12))
def test_a_decimal_of_few_digits_is_the_time_that_it_says(digits: int, places: int) -> None:
    decimal = Fraction(digits, 10**places)
    assert exact_time(decimal) == decimal
    assert exact_time(float(decimal)) == decimal


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_the_double_of_a_time_stays(x: float) -> None:
    assert float(exact_time(x)) == x


def test_a_fraction_that_is_no_decimal_is_a_time_as_it_stands() -> None:
    assert exact_time(Fraction(10**12 + 1, 3 * 10**7 + 1)) == Fraction(10**12 + 1, 3 * 10**7 + 1)
    assert exact_time(0.1 + 0.2) == Fraction("0.30000000000000004")


@pytest.mark.parametrize("x", [math.inf, -math.inf, math.nan])
def test_there_is_no_exact_decimal_of_what_is_not_finite(x: float) -> None:
    with pytest.raises(ValueError, match="not a finite number"):
        exact_decimal(x)


two_arguments = ["min", "max", "atan2", "mod"]
one_argument = sorted(set(FUNCTIONS) - {*two_arguments})
leaves = st.one_of(
    st.floats(0, 1e9, allow_nan=False).map(repr),
    st.integers(0, 99).map(lambda n: f"{n}."),
    st.sampled_from(sorted(NAMES)),
    st.just("pi"),
)
expressions = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", " - ", "**"]), inner).map("".join),
        inner.map("({})".format),
        st.tuples(st.sampled_from("+-"), inner).map("".join),
        st.tuples(st.sampled_from(one_argument), inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(st.sampled_from(two_arguments), inner, inner).map(lambda t: f"{t[0]}({t[1]},{t[2]})"),
    ),
    max_leaves=12,
)
PYTHON = {name: getattr(math, name) for name in FUNCTIONS if hasattr(math, name)}
PYTHON |= {"abs": abs, "min": min, "max": max, "mod": operator.mod, "pi": math.pi, "__builtins__": {}}


@given(expressions)
def test_a_random_expression_has_the_value_that_python_gives_it(text: str) -> None:
    try:
        expected = eval(text, PYTHON, NAMES)
    except (ArithmeticError, ValueError, TypeError):
        expected = None
    result = outcome(text, VALUES)
    if isinstance(result, ModelError):
        # Python goes on where a part is complex or infinite; here that is an error at once.
        assert expected is None or is_limit(result)
    else:
        assert result.value == expected


def is_limit(error: ModelError) -> bool:
    """Whether a refusal is one that Python does not make: an infinity, a complex power, or the limits of a text."""
    limits = ("overflow in ", "a power takes a positive base", "nested more than", "characters; the limit")
    return any(limit in str(error) for limit in limits)


numbers = st.decimals(-1000, 1000, places=3).map(lambda d: (f"({d})", Fraction(d)))
rationals = st.recursive(
    numbers,
    lambda inner: st.one_of(
        st.tuples(inner, inner).map(lambda t: (f"({t[0][0]}+{t[1][0]})", t[0][1] + t[1][1])),
        st.tuples(inner, inner).map(lambda t: (f"({t[0][0]} - {t[1][0]})", t[0][1] - t[1][1])),
        st.tuples(inner, inner).map(lambda t: (f"{t[0][0]}*{t[1][0]}", t[0][1] * t[1][1])),
        st.tuples(inner, inner).map(lambda t: (f"max({t[0][0]},{t[1][0]})", max(t[0][1], t[1][1]))),
        inner.map(lambda t: (f"(-{t[0]})", -t[1])),
        st.tuples(inner, st.integers(0, 3)).map(lambda t: (f"({t[0][0]})**{t[1]}", t[0][1] ** t[1])),
    ),
    max_leaves=6,
)


@given(rationals)
def test_a_fraction_is_the_exact_result(pair: tuple[str, Fraction]) -> None:
    text, expected = pair
    result = outcome(text, {})
    if isinstance(result, ModelError):
        # Powers of powers leave the range of floats, and brackets of brackets the limits of a text.
        assert is_limit(result)
    else:
        bits = max(expected.numerator.bit_length(), expected.denominator.bit_length())
        assert result.exact == expected or (result.exact is None and bits > 1000)


@given(st.one_of(st.text(max_size=200), st.text("ab1.e9+-*/(),_ sqrtminpi", max_size=60)))
def test_any_text_is_a_value_or_a_fault(text: str) -> None:
    result = outcome(text, VALUES)
    if isinstance(result, ModelError):
        assert result.code == "E108"
        # One line, however long the text; an expression may read many unknown names, each with a line of its own.
        assert all(len(str(fault)) < 400 for fault in result.faults)
    else:
        assert math.isfinite(result.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "column 1: expected a number, a name or '(', found the end"),
        ("1+", "column 3: expected a number, a name or '(', found the end"),
        ("1 2", "column 3: expected an operator or the end, found '2'"),
        ("(1+2", "column 5: expected an operator or the ')' for the '(' in column 1, found the end"),
        ("1)", "column 2: expected an operator or the end, found ')'"),
        ("sqrt()", "column 6: expected a number, a name or '(', found ')'"),
        ("2R", "Write a product with *."),
        ("2(3)", "Write a product with *."),
        ("a(3)", "column 1: there is no function 'a'"),
        ("sqr(3)", "Did you mean 'sqrt'?"),
        ("1,5", "Write decimals after a point."),
        ("1_000", "Write digits without _."),
        ("2^3", "column 2: '^' is not allowed in an expression. Write a power with **."),
        ("motor.R", "column 6: '.' is not allowed in an expression. A name cannot contain a point"),
        ("a == b", "column 3: '=' is not allowed in an expression."),
        ("a < b", "Use numbers, names, + - * / ** ( ) and abs, acos"),
        ("'a'", "is not allowed in an expression"),
        ("x[0]", "Elements of a vector"),
        ("a // b", "column 4: expected a number"),
        ("sin", "reads 'sin', which is not a known name here. Write the argument of a function in brackets: sin(...)."),
        ("sin(1, 2)", "column 1: sin takes one argument, not 2"),
        ("atan2(1)", "atan2 takes two arguments, not 1"),
        ("min(1)", "min takes two or more arguments, not 1"),
        ("1e400", "column 1: 1e400 is too large"),
        ("0x10", "column 2: expected an operator or the end, found 'x10'"),
        ("__import__(1)", "column 1: there is no function '__import__'"),
    ],
)
def test_what_cannot_be_read_is_named_with_its_column(text: str, expected: str) -> None:
    assert expected in message(text)


def test_digits_that_are_not_ascii_are_refused() -> None:
    assert "is not allowed in an expression" in message("٣")
    assert "is not allowed in an expression" in message("é+1")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kt/n", "E108 '=kt/n', column 3: division by zero in 2.0 / 0.0."),
        ("9**9**9", "column 2: overflow in 9.0 ** 387420489.0."),
        ("1e300*1e300", "column 6: overflow in 1e+300 * 1e+300."),
        ("exp(1000)", "column 1: overflow in exp(1000.0)."),
        ("1+sqrt(n-1)", "column 3: sqrt takes a number that is not negative in sqrt(-1.0)."),
        ("log(n)", "log takes a positive number in log(0.0)."),
        ("asin(kt)", "asin takes a number from -1 to 1 in asin(2.0)."),
        ("(-8)**(1/3)", "a power takes a positive base"),
        ("n**-1", "in 0.0 ** (-1.0)."),
    ],
)
def test_what_cannot_be_computed_is_named_with_its_numbers(text: str, expected: str) -> None:
    assert expected in message(text, kt=2.0, n=0.0)


def test_all_unknown_names_are_reported_at_once() -> None:
    with pytest.raises(ModelError) as caught:
        value("Kpp*speed/Kp", Kp=1.0)
    assert [str(fault) for fault in caught.value.faults] == [
        "E108 '=Kpp*speed/Kp' reads 'Kpp', which is not a known name here. Did you mean 'Kp'?",
        "E108 '=Kpp*speed/Kp' reads 'speed', which is not a known name here. Known: Kp.",
    ]


def test_a_value_that_is_not_finite_is_refused_by_name() -> None:
    assert "reads 'x', which is nan" in message("min(1, x)", x=math.nan)
    assert "reads 'x', which is inf" in message("x", x=math.inf)


def test_a_value_named_pi_is_not_silently_ignored() -> None:
    assert "'pi' is the constant" in message("2*pi", pi=3.0)
    assert value("2*a", a=1.0, pi=3.0) == 2.0


@pytest.mark.parametrize(
    "text",
    ["(" * 51 + "1" + ")" * 51, "-" * 999 + "1", "2**" * 300 + "1", "abs(" * 100 + "1" + ")" * 100, "(" * 1000],
)
def test_deep_nesting_is_a_clear_error(text: str) -> None:
    assert "nested more than 50 deep" in message(text)


def test_nesting_up_to_the_limit_and_long_chains_are_read() -> None:
    assert value("1+(" * 50 + "1" + ")" * 50) == 51.0
    assert value("+".join(["1"] * 500)) == 500.0
    assert len(parse("+".join(["1"] * 500)).steps) == 999


def test_long_texts_are_refused_before_they_are_read() -> None:
    assert "the expression has 20001 characters; the limit is 1000" in message("(" * 10_000 + "1" + ")" * 10_000)


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9",
        "9**9**9**9",
        "1e999999999",
        "1e-999999999",
        "**".join(["1.0000000001"] * 30),
        "*".join(["(1/3)**64"] * 90),
    ],
)
def test_no_expression_burns_time(text: str) -> None:
    start = time.process_time()
    outcome(text, {})
    # Such a text takes milliseconds; computing 9**9**9 as an integer takes minutes.
    assert time.process_time() - start < 1.0
