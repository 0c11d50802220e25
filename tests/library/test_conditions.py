"""Expression with comparisons: a bool whose instants are located, in both engines, in files and in FMUs."""

import math
import operator

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu
from hypothesis import given
from hypothesis import strategies as st

from blocks import Counter, Diagram, Expression, Integrator, Logic, ModelError, Sine, Switch
from blocks.compile.toolchain.compiler import find_compiler
from blocks.contract.expressions import RELATIONS, parse, signals_at

NEEDS_COMPILER = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")
ENGINES = ["reference", pytest.param("native", marks=NEEDS_COMPILER)]
_JOIN = {"and": operator.and_, "or": operator.or_, "not": operator.not_}
_COMPARE = dict(
    zip(RELATIONS, (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne), strict=True)
)
_NUMBERS = {"a": -1.0, "b": 0.0, "c": 2.5}

_sums = st.recursive(
    st.sampled_from(["a", "b", "c", "1", "-a"]),
    lambda inner: st.builds("{} {} {}".format, inner, st.sampled_from("+-*"), inner) | inner.map("({})".format),
    max_leaves=3,
)
_chains = st.builds(
    lambda first, rest: first + "".join(f" {word} {other}" for word, other in rest),
    _sums, st.lists(st.tuples(st.sampled_from(RELATIONS), _sums), min_size=1, max_size=3),
)  # fmt: skip
_truths = st.recursive(
    _chains,
    lambda inner: st.builds("{} {} {}".format, inner, st.sampled_from(["and", "or"]), inner)
    | inner.map("not {}".format) | inner.map("({})".format),
    max_leaves=5,
)  # fmt: skip


def _evaluated(text: str) -> object:
    arithmetic = {"+": operator.add, "-": operator.sub, "*": operator.mul, "neg": operator.neg}
    return parse(text, has_truths=True).folded(
        lambda step: _NUMBERS[step.word] if step.scalar is None else step.scalar.value,
        lambda step, operands: {**arithmetic, **_COMPARE, **_JOIN}[step.word](*operands),
    )


@given(_truths)
def test_comparisons_and_or_not_bind_as_in_python(text):
    assert _evaluated(text) == eval(text, {}, _NUMBERS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u1 and u2 > 1", "column 4: 'and' takes truth values, not numbers. Compare the number, as in x > 0."),
        ("u1 > 0 + (u1 > 2)", "column 8: '+' takes numbers, not truth values. Join comparisons by and, or, not."),
        ("abs(u1 > 0)", "column 1: 'abs' takes numbers, not truth values."),
        ("1 < not (u1 > 2)", "column 3: '<' takes numbers, not truth values."),
        ("u1 = 3", "'=' is not allowed in an expression. Write one = at the start only, and == for equality."),
        ("u1 > 0 and", "column 11: expected a number, a name or '(', found the end."),
    ],
)
def test_a_condition_that_is_none_is_refused_with_its_column(text, message):
    with pytest.raises(ModelError) as refused:
        parse(text, has_truths=True)
    assert message in str(refused.value)


def test_a_parameter_has_no_comparisons():
    with pytest.raises(ModelError, match="'>' is not allowed in an expression"):
        parse("a > 1")


def test_signals_of_a_condition_have_paths_and_elements():
    text = "lift.open and robots[3].motor.i[0] > 2*pi and pose.y[theta] < t or A[1,0] >= max(2, x)"
    assert [name for _, _, name in signals_at(text)] == [
        "lift.open", "robots[3].motor.i[0]", "pose.y[theta]", "A[1,0]", "x",
    ]  # fmt: skip


@pytest.mark.parametrize("engine", ENGINES)
def test_a_condition_changes_at_the_instants_of_its_comparisons(engine):
    d = Diagram("d")
    wave = d.add("wave", Sine())
    inside = d.add("inside", Expression(expression="0.5 <= u1 < k1 or not u1 > -0.5 and t != 3", k=[0.9]))
    outside = d.add("outside", Logic(operator="not"))  # a bool
    d.wire(inside.u1, wave.y)
    d.wire(outside.u1, inside.y)
    results = d.run(stop=7, engine=engine)
    y = results["inside.y"]
    low, high, pi = math.asin(0.5), math.asin(0.9), math.pi
    times = [low, high, pi - high, pi - low, pi + low, 2 * pi - low, 2 * pi + low]
    assert results.t[np.nonzero(np.diff(y))[0]] == pytest.approx(times, abs=1e-14)
    assert np.array_equal(results["outside.y"], 1 - y)


@pytest.mark.parametrize("engine", ENGINES)
def test_equality_of_a_count_is_exact(engine):
    d = Diagram("d")
    count = d.add("count", Counter())
    d.wire(count.u, d.add("wave", Expression(expression="sin(u1) > 0")).y)
    d.wire("wave.u1", d.add("time", Expression(expression="t")).y)
    third = d.add("third", Expression(expression="u1 == 3"))
    d.wire(third.u1, count.y)
    results = d.run(stop=25, engine=engine)
    assert np.array_equal(results["third.y"], results["count.y"] == 3)
    assert results["third.y"].any()


def test_a_condition_has_no_unit():
    d = Diagram("d")
    with pytest.raises(ModelError, match="a condition has no unit"):
        d.add("x", Expression(expression="u1 > 0", unit="m"))


def _switched(*, has_input: bool) -> Diagram:
    """dx/dt = 3u while 0.5 <= u < 0.9, else u; u is an input, or the time."""
    d = Diagram("d")
    u = d.input("u") if has_input else d.add("time", Expression(expression="t")).y
    inside, gain = (
        d.add("inside", Expression(expression="0.5 <= u1 < 0.9")),
        d.add("gain", Expression(expression="3*u1")),
    )
    switch, x = d.add("switch", Switch()), d.add("x", Integrator())
    for sink, source in ((inside.u1, u), (gain.u1, u), (switch.u1, gain.y), (switch.u2, u), (switch.control, inside.y)):
        d.wire(sink, source)
    d.wire(x.u, switch.y)
    d.output("y", x.y)
    return d


def test_a_condition_is_linearized_on_its_side(tmp_path):
    _switched(has_input=True).save(tmp_path / "d.json")
    d = Diagram.load(tmp_path / "d.json")
    assert [d.linearize(u="u", y="x.y", inputs={"u": at}).B[0, 0] for at in (0.2, 0.7, 1.0)] == [1, 3, 1]


@NEEDS_COMPILER
def test_a_condition_is_located_in_exported_fmus(tmp_path):
    d, exact = _switched(has_input=False), 0.5 + (0.9**2 - 0.5**2)
    assert d.run(stop=1)["x.y"][-1] == pytest.approx(exact, rel=1e-12)
    for fmi in (2, 3):
        path = tmp_path / f"d{fmi}.fmu"
        d.export(path, fmi=fmi)
        assert not validate_fmu(str(path))
        for kind in ("CoSimulation", "ModelExchange"):
            rows = simulate_fmu(str(path), fmi_type=kind, stop_time=1, relative_tolerance=1e-9)
            assert rows["y"][-1] == pytest.approx(exact, rel=1e-7)
