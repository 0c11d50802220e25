"""Values of MATLAB's expressions against the documentation of MATLAB, NumPy and Python's own arithmetic."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blocks.simulink.matlab import Value, assignments, evaluate, names_in
from blocks.simulink.matlab_functions import FUNCTIONS, NoValue, scalar

KNOWN: dict[str, Value] = {
    "f": scalar(50.0),
    "v": np.array([[1.0, 2.0, 3.0]]),
    "A": np.array([[1.0, 2.0], [3.0, 4.0]]),
    "p": {"m": scalar(2.0), "in": {"r": scalar(7.0)}},
    "name": "motor",
}


def value(text: str) -> Any:
    """Return a value as nested lists; a matrix of 1 x 1 as a number."""
    found = evaluate(text, KNOWN)
    if isinstance(found, str):
        return found
    assert isinstance(found, np.ndarray)
    assert found.ndim == 2
    return found.item() if found.size == 1 else found.tolist()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2*pi*f", 100 * math.pi),
        ("  1e3 ", 1000.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("1d-3", 1e-3),
        ("0x1F", 31.0),
        ("1/0", math.inf),
        ("-inf", -math.inf),
        ("eps", 2.0**-52),
        ("-2^2", -4.0),
        ("2^-1", 0.5),
        ("2^3^2", 64.0),
        ("-2^-2", -0.25),
        ("~1 == 0", True),
        ("!0", True),
        ("3 > 2 > 1", False),
        ("1 | 0 & 0", True),
        ("1 + 1:3", [[2.0, 3.0]]),
        ("1:0", [[]]),
        ("5:-2:0", [[5.0, 3.0, 1.0]]),
        ("[1 -2]", [[1.0, -2.0]]),
        ("[1 - 2]", -1.0),
        ("[1 , -2]", [[1.0, -2.0]]),
        ("[f' v]", [[50.0, 1.0, 2.0, 3.0]]),
        ("[f (1)]", [[50.0, 1.0]]),
        ("[v(1) 4]", [[1.0, 4.0]]),
        ("[1 2\n3 4]", [[1.0, 2.0], [3.0, 4.0]]),
        ("[1 2 ... a comment\n 3]", [[1.0, 2.0, 3.0]]),
        ("[1 2;]", [[1.0, 2.0]]),
        ("[1 2];", [[1.0, 2.0]]),
        ("[]", []),
        ("[A; v(1:2)]", [[1.0, 2.0], [3.0, 4.0], [1.0, 2.0]]),
        ("[1 2; 3 4]'", [[1.0, 3.0], [2.0, 4.0]]),
        ("v.^2", [[1.0, 4.0, 9.0]]),
        ("1./v(1:2)", [[1.0, 0.5]]),
        ("A^2", [[7.0, 10.0], [15.0, 22.0]]),
        ("A*A", [[7.0, 10.0], [15.0, 22.0]]),
        ("A.*A", [[1.0, 4.0], [9.0, 16.0]]),
        ("v' + v(1:2)", [[2.0, 3.0], [3.0, 4.0], [4.0, 5.0]]),
        ("v(end)", 3.0),
        ("v(end-1:end)", [[2.0, 3.0]]),
        ("v([1 1 3])", [[1.0, 1.0, 3.0]]),
        ("v([1; 3])", [[1.0, 3.0]]),
        ("A(3)", 2.0),
        ("A([1 2; 3 4])", [[1.0, 3.0], [2.0, 4.0]]),
        ("A(:, end)", [[2.0], [4.0]]),
        ("A(2, :)", [[3.0, 4.0]]),
        ("A(:)'", [[1.0, 3.0, 2.0, 4.0]]),
        ("v(v > 1)", [[2.0, 3.0]]),
        ("A(A > 1)'", [[3.0, 2.0, 4.0]]),
        ("p.m*p.in.r", 14.0),
        ("name", "motor"),
        ("'it''s'", "it's"),
        ('"a ""b"""', 'a "b"'),
        ("['a' 'bc']", "abc"),
        ("ones(2, 3)", [[1.0] * 3] * 2),
        ("zeros(1, 0)", [[]]),
        ("eye(2)", [[1.0, 0.0], [0.0, 1.0]]),
        ("true", True),
        ("false(1, 2)", [[False, False]]),
        ("sum(A)", [[4.0, 6.0]]),
        ("sum(A, 2)", [[3.0], [7.0]]),
        ("sum(v)", 6.0),
        ("max([1 5 3])", 5.0),
        ("max(v, 2)", [[2.0, 2.0, 3.0]]),
        ("min(A)", [[1.0, 2.0]]),
        ("round(-2.5)", -3.0),
        ("fix(-2.5)", -2.0),
        ("mod(-1, 3)", 2.0),
        ("mod(5, 0)", 5.0),
        ("rem(-1, 3)", -1.0),
        ("uint8(300)", 255.0),
        ("int8(-1.5)", -2.0),
        ("single(0.1)", float(np.float32(0.1))),
        ("length([1 2; 3 4; 5 6])", 3.0),
        ("size(A)", [[2.0, 2.0]]),
        ("diag([1 2])", [[1.0, 0.0], [0.0, 2.0]]),
        ("conv([1 2], [1 3])", [[1.0, 5.0, 6.0]]),
        ("reshape(1:4, 2, 2)", [[1.0, 3.0], [2.0, 4.0]]),
        ("repmat([1 2], 2, 1)", [[1.0, 2.0], [1.0, 2.0]]),
        ("linspace(0, 1, 3)", [[0.0, 0.5, 1.0]]),
    ],
)
def test_an_expression_has_the_value_of_the_documentation(text: str, expected: object) -> None:
    assert value(text) == expected


def test_division_of_matrices_solves_equations() -> None:
    a, b = np.array([[4.0, 1.0], [2.0, 3.0]]), np.array([[1.0], [2.0]])
    known: dict[str, Value] = {"a": a, "b": b}
    left, right = evaluate("a\\b", known), evaluate("b'/a", known)
    assert isinstance(left, np.ndarray)
    assert isinstance(right, np.ndarray)
    np.testing.assert_allclose(a @ left, b, rtol=1e-15)
    np.testing.assert_allclose(right @ a, b.T, rtol=1e-15)


def test_a_range_is_symmetric_and_meets_its_end() -> None:
    """As MathWorks describes it: counted from both ends, so that 0:0.1:0.3 ends with 0.3 itself."""
    assert value("0:0.1:0.3")[0] == [0.0, 0.1, 0.3 - 0.1, 0.3]
    tenths = np.array(value("-1:0.1:1")[0])
    assert tenths.size == 21
    assert tenths[10] == 0.0
    assert (tenths == -tenths[::-1]).all()
    assert value("1:0.1:1.95")[0][-1] == pytest.approx(1.9, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "why", "name"),
    [
        ("", "it ends too early", ""),
        ("1 +", "it ends too early", ""),
        ("(1", r"'\)' is missing", ""),
        ("[1 2", r"'\]' is missing", ""),
        ("1 2", "'2' is not expected here", ""),
        ("'open", "a text has no closing quote", ""),
        ("1 # 2", "'#' is not expected here", ""),
        ("2*kp", "kp has no value", "kp"),
        ("p.q", "p has no field q", "p.q"),
        ("rand(2)", "rand has no value", "rand"),
        ("sqrt(-1)", "complex numbers", ""),
        ("(-8)^(1/3)", "complex numbers", ""),
        ("3i", "complex numbers", ""),
        ("2*j", "complex numbers", "j"),
        ("{1, 2}", "a cell array is not supported", ""),
        ("@(x) x", "a handle of a function is not supported", ""),
        ("v(4)", "an index is not within 1 to 3", ""),
        ("v(0)", "an index is not within 1 to 3", ""),
        ("v(1.5)", "an index is no whole number", ""),
        ("A(1, 1, 1)", "three dimensions", ""),
        ("'a' + 1", "a text is used as a number", ""),
        ("p + 1", "a structure is used as a number", ""),
        ("[1 2; 3]", "differ in length", ""),
        ("v + [1 2]", "it cannot be computed", ""),
        ("v*v", "it cannot be computed", ""),
        ("sin(1, 2, 3, 4)", "it cannot be computed", ""),
        ("ones(1e4)", "more than 1,000,000 elements", ""),
        ("1:1e9", "more than 1,000,000 elements", ""),
        ("0:nan:1", "finite numbers", ""),
        ("2^[1 2]", "power of a matrix", ""),
        ("(" * 100 + "1" + ")" * 100, "more than 60 deep", ""),
        ("-" * 100 + "1", "more than 60 deep", ""),
        ("1" * 1_000_001, "more than 1,000,000 characters", ""),
    ],
)
def test_what_has_no_value_says_why(text: str, why: str, name: str) -> None:
    with pytest.raises(NoValue, match=why) as caught:
        evaluate(text, KNOWN)
    assert caught.value.name == name


def test_names_are_those_of_variables() -> None:
    assert names_in("kp*sin(w*t) + p.gain(end) - [kp pi]") == ["kp", "w", "t", "p"]


CODE = """\
% the plant
m = 2;  c = m/4  % friction
A = [1 2
     3 4];
if c > 1
  m = 5; if m, c = 3; end
end
k = 3, p.m = 1; p.l = p.m*2;
x(2) = 4;
[q, r] = deal(1, 2);
%{
z = 3
%}
load('values.mat')
s = 'it''s'; t = "a"; clc; B = A';
for i = 1:3, y = i; end
w = unknown + 1;
c = 7;
"""


def test_plain_assignments_are_read_and_the_rest_is_listed() -> None:
    found, rest = assignments(CODE, {"x": scalar(1.0), "q": scalar(1.0), "y": scalar(1.0), "old": scalar(8.0)})
    assert set(found) == {"A", "B", "k", "p", "s", "t", "c", "old"}
    assert found["p"] == {"m": scalar(1.0), "l": scalar(2.0)}
    assert np.array_equal(np.array(found["B"]), [[1.0, 3.0], [2.0, 4.0]])
    assert (found["s"], found["t"], found["c"]) == ("it's", "a", scalar(7.0))
    assert [(one.line, one.text, one.why) for one in rest] == [
        (5, "if c > 1 m = 5; if m, c = 3; end end", "it is no plain assignment"),
        (9, "x(2) = 4", "it is no plain assignment"),
        (10, "[q, r] = deal(1, 2)", "it is no plain assignment"),
        (14, "load('values.mat')", "it is no plain assignment"),
        (16, "for i = 1:3, y = i; end", "it is no plain assignment"),
        (17, "w = unknown + 1", "unknown has no value"),
    ]


@pytest.mark.parametrize(
    "code", ["a = 2; if b, a = 3; end", "a = 2; a = f(1);", "a = 2; a(3) = 1;", "a = 2; [a, b] = g;", "a = 2; clear a",
             "a = 2; a.b.c = h;", "a = 2; clear", "a = 2; for a = 1:3, end", "a = 1; a = {1};"],
)  # fmt: skip
def test_a_variable_that_may_have_changed_has_no_value(code: str) -> None:
    assert "a" not in assignments(code, {})[0]


def test_a_line_that_cannot_be_read_is_left_out() -> None:
    found, rest = assignments("a = 1;\nb = 'open\nc = 2;\na = 3 # 4\nd = [1 2\n#\n", {"b": scalar(1.0)})
    assert found == {"c": scalar(2.0)}
    assert [one.line for one in rest] == [2, 4, 5]


@pytest.mark.parametrize(
    "text",
    [
        "ones(1e6, 1) + ones(1, 1e6)", "ones(1e6, 1)*ones(1, 1e6)", "kron(ones(1e3), ones(1e3))",
        "max(ones(1e6, 1), ones(1, 1e6))",
        "conv(ones(1, 1e6), ones(1, 1e6))", "inv(ones(1000))", "ones(1000)^3", "ones(1000)/ones(1000)",
        "repmat(1, 1e5, 1e5)",
        "diag(ones(1e5, 1))", "linspace(0, 1, 1e12)", "mod(ones(1e6, 1), ones(1, 1e6))",
        "[" + "ones(1000) " * 1000 + "]", "+".join(["ones(1000)"] * 1000), "zeros(1e400)", "1:1e300", "eye(1e9)(1)",
        "reshape(ones(1000), 1e9, 1)", "int8(" * 50 + "ones(1000)" + ")" * 50,
    ],
)  # fmt: skip
def test_what_would_fill_the_memory_has_no_value_at_once(text: str) -> None:
    with pytest.raises(NoValue):
        evaluate(text, {})
    x = "x(ones(1e6, 1), ones(1e6, 1))"
    with pytest.raises(NoValue, match="more than 1,000,000 elements"):
        evaluate(x, {"x": scalar(1.0)})


def test_scripts_of_any_size_are_read_at_once() -> None:
    for text in (
        "%{\n" * 100_000,
        "a = 1;\n" * 60_000,
        "[" * 300_000,
        "'" * 99_999,
        "if 1\n" * 50_000,
        "x = [1 ...\n" * 20_000,
    ):
        assignments(text, {})
    _, rest = assignments("x = ones(1000);\n" * 1000, {})
    assert "elements are computed" in rest[-1].why


def test_assignments_leave_what_was_given() -> None:
    given_values: dict[str, Value] = {"p": {"m": scalar(1.0)}}
    found, _ = assignments("p.m = 2; q = 3;", given_values)
    assert found["p"] == {"m": scalar(2.0)}
    assert given_values == {"p": {"m": scalar(1.0)}}


_NUMBERS = st.integers(1, 9).map(str) | st.sampled_from(["0.5", "1e2", "2.25"])
_EXPRESSIONS = st.recursive(
    _NUMBERS,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/"]), inner).map(" ".join),
        inner.map("({})".format),
        inner.map("-({})".format),
    ),
    max_leaves=12,
)


@given(_EXPRESSIONS)
@settings(max_examples=200, deadline=None)
def test_arithmetic_is_that_of_python(text: str) -> None:
    try:
        expected = float(eval(text))
    except ZeroDivisionError:
        return
    assert value(text) == expected


@given(st.text("12.ax'\"()[]{};:,+-*/^~=&|<>% \n@#!", max_size=40))
@settings(max_examples=500, deadline=None)
def test_any_text_has_a_value_or_a_reason(text: str) -> None:
    with contextlib.suppress(NoValue):
        evaluate(text, KNOWN)
    found, rest = assignments(text, KNOWN)
    assert isinstance(found, dict)
    assert all(one.why and one.line >= 1 for one in rest)


@given(
    st.sampled_from(sorted(FUNCTIONS)),
    st.lists(st.sampled_from(["1", "[]", "v", "A", "A > 2", "'t'", "-0.5"]), max_size=3),
)
@settings(max_examples=400, deadline=None)
def test_a_function_of_anything_has_a_value_or_a_reason(name: str, arguments: list[str]) -> None:
    with contextlib.suppress(NoValue):
        assert isinstance(evaluate(f"{name}({', '.join(arguments)})", KNOWN), (np.ndarray, str))
