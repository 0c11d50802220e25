"""Equations become tapes that say exactly what they compute and what they depend on."""

import math
import os
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blocks.contract.block import Block
from blocks.contract.equations import crossing, event_time, local, output, wiring
from blocks.contract.interface import Interface, Value
from blocks.contract.resolution import resolve
from blocks.contract.scalars import OPERATIONS
from blocks.contract.table_lookup import pick, search
from blocks.contract.tape import Tape
from blocks.contract.tracing import trace
from blocks.contract.variables import Discrete, Input, Parameter, State
from blocks.text.errors import DeclarationError
from tests.support.on_numbers import numeric
from tests.support.places import ROOT

C = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "pow": np.power,
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "asinh": np.arcsinh,
    "acosh": np.arccosh, "atanh": np.arctanh, "fmin": np.minimum, "fmax": np.maximum, "lt": np.less,
    "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "and": np.logical_and, "or": np.logical_or,
    "not": np.logical_not, "choose": lambda c, a, b: a if c else b,
}  # fmt: skip
"""What the operations of a tape mean."""


def operation(op: str) -> Any:
    return C[op] if op in C else vars(np)[op]


def on_tape(tape: Tape, values: dict[str, Any]) -> dict[str, Any]:
    """Every result of a tape, computed node by node."""
    made: list[Any] = []
    with np.errstate(all="ignore"):
        for node in tape.nodes:
            if node.op == "argument":
                argument = tape.arguments[int(node.value)]
                given = np.ravel(values.get(argument.name, np.nan))
                made.append(np.float64(given[argument.element % len(given)]))
            elif node.op == "constant":
                made.append(np.float64(node.value))
            else:
                made.append(np.float64(operation(node.op)(*(made[n] for n in node.operands))))
    return {key: np.array([made[n] for n in result.nodes]) for key, result in tape.results.items()}


def interface(cls: Any, **given: Any) -> Interface:
    return resolve(cls, {name: Value(value) for name, value in given.items()}).interface


def dependencies(tape: Tape, key: str) -> list[set[str]]:
    """For each element the arguments it depends on, as "name" or "name[1]"."""
    arguments = tape.arguments
    sizes = {a.name: sum(1 for b in arguments if b.name == a.name) for a in arguments}
    texts = [a.name if sizes[a.name] == 1 else f"{a.name}[{a.element}]" for a in arguments]
    return [{texts[k] for k in tape.arguments_of(n)} for n in tape.results[key].nodes]


def law(function: Callable[..., Any], **options: Any) -> Any:
    """A block with the inputs u, w, the vector v, and one output."""

    class Law(Block):
        k = Parameter(2.0)
        n = Parameter(3, structural=True, type="int")
        u = Input()
        w = Input()
        v = Input(shape=lambda n: n)
        p = Input(type="bool")
        points = Parameter([0.0, 1.0, 3.0], shape="m", table=True)
        y = output(function, **options)

    return Law


def refusal(cls: Any, **given: Any) -> str:
    with pytest.raises(DeclarationError) as caught:
        trace(interface(cls, **given))
    assert [fault.code for fault in caught.value.faults] == ["E407"]
    return str(caught.value)


def only(value: dict[str, Any], key: str = "output:y") -> list[float]:
    return [float(x) for x in value[key]]


class Everything(Block):
    """All kinds of equations at once."""

    k = Parameter(2.0)
    A = Parameter([[0.0, 1.0], [0.5, 0.0]], shape=("n", "n"), zeros=True)
    Ts = Parameter(0.1)
    u = Input()
    go = Input(type="bool")
    x = State(shape=lambda n: n)
    c = Discrete(visible="after")
    d = Discrete(type="bool")

    @local
    def g(x, u):
        return np.tanh(x) * u

    @x.derivative
    def dx(A, x, g, side):
        return A @ x + np.where(side, g, -g)

    @x.initial
    def x0(k):
        return k

    @c.next(every=Ts)
    def dc(c, tick, held):
        return c + tick + held

    @output(every=Ts, start=1.0)
    def held(c, t):
        return c * t

    @output
    def y(x, k, held):
        return k * x[0] + held

    @output(type="bool")
    def is_on(go, d):
        return go & ~d

    @crossing
    def side(x):
        return x[1] - 1.0

    @event_time
    def edge(t, k):
        return np.where(t < k, k, np.inf)

    @side.reset(d)
    def dd(d):
        return ~d

    @edge.reset(x)
    def jump(x):
        return -x


EVERYTHING = {
    "t": 0.25, "tick": 3, "k": 2.0, "A": [[0.0, 1.0], [0.5, 0.0]], "Ts": 0.1, "c_start": 0.0, "d_start": False,
    "u": 1.5, "go": True, "x": [0.3, -0.4], "c": 4.0, "d": True, "y": 0.0, "held": 7.0, "is_on": False, "side": False,
}  # fmt: skip


# --- the tape --------------------------------------------------------------------------------------------------


def test_every_role_has_a_result_and_the_tape_computes_what_the_functions_compute() -> None:
    made = interface(Everything)
    tape = trace(made)
    assert list(tape.results) == [
        "local:g", "derivative:x", "initial:x", "next:c", "output:held", "output:y", "output:is_on", "crossing:side",
        "event_time:edge", "reset:d:side", "reset:x:edge",
    ]  # fmt: skip
    expected, actual = numeric(made, EVERYTHING), on_tape(tape, EVERYTHING)
    assert expected.keys() == actual.keys()
    for key, value in expected.items():
        np.testing.assert_allclose(actual[key], value, rtol=1e-14)
    assert (tape.results["next:c"].clock, tape.results["output:held"].clock) == ("dc", "held")
    assert tape.results["reset:d:side"].cause == "side"


def test_arguments_say_of_what_kind_they_are() -> None:
    kinds = {a.name: a.kind for a in trace(interface(Everything)).arguments}
    assert kinds == {
        "t": "time", "tick": "tick", "k": "parameter", "A": "parameter", "Ts": "parameter", "c_start": "parameter",
        "d_start": "parameter", "u": "input", "go": "input", "x": "state", "c": "discrete", "d": "discrete",
        "held": "held", "y": "output", "is_on": "output", "side": "side",
    }  # fmt: skip


def test_each_node_needs_only_earlier_ones_and_each_is_needed() -> None:
    tape = trace(interface(Everything))
    count = len(tape.arguments)
    assert [node.op for node in tape.nodes[:count]] == ["argument"] * count
    for index, node in enumerate(tape.nodes):
        assert all(operand < index for operand in node.operands)
        assert node.op in {*OPERATIONS, "argument", "constant"}
    results = [n for result in tape.results.values() for n in result.nodes]
    assert set(tape.needed(results)) | set(range(count)) == set(range(len(tape.nodes)))
    assert tape.needed([]) == []


def test_equal_nodes_are_one() -> None:
    tape = trace(interface(law(lambda u, w: np.sin(u + w) * np.cos(u + w) + np.sin(u + w))))
    ops = [tape.nodes[n].op for n in tape.needed(tape.results["output:y"].nodes) if tape.nodes[n].op != "argument"]
    assert sorted(ops) == ["add", "add", "cos", "mul", "sin"]
    assert len(tape.results["phase"].nodes) == 1


def test_a_type_is_traced_once() -> None:
    count = []

    def f(u, k):
        count.append(1)
        return k * u

    cls = law(f)
    first = trace(interface(cls))
    assert trace(interface(cls, k=5.0)) is first
    assert trace(interface(cls, n=2)) is not first
    assert len(count) == 4  # an equation that changes what stands outside is tried twice


def test_a_local_is_computed_once() -> None:
    count = []

    class Shared(Block):
        u = Input()

        @local
        def g(u):
            count.append(1)
            return [u, 2.0 * u]

        @output
        def a(g):
            return (g * 2.0)[1]

        @output
        def b(g, h):
            return g[0] + h

        @local
        def h(g):
            return g[1]

    made = interface(Shared)
    tape = trace(made)
    assert len(count) == 2  # as the count stands outside, everything is tried twice
    assert on_tape(tape, {"u": 3.0})["local:g"].tolist() == [3.0, 6.0]
    assert numeric(made, {"u": 3.0})["output:a"].tolist() == on_tape(tape, {"u": 3.0})["output:a"].tolist() == [12.0]


def test_equations_from_lambdas_have_the_names_of_their_variables() -> None:
    class Lambdas(Block):
        u = Input()
        g = local(lambda u: u + 1.0)
        h = local(lambda g: 2.0 * g)
        y = output(lambda h: h, every=0.1)
        z = output(lambda g: g, every=0.2)

    resolved = resolve(Lambdas, {})
    assert [float(resolved.clocks[name][0]) for name in ("y", "z")] == [0.1, 0.2]
    tape = trace(resolved.interface)
    assert [tape.results[f"output:{name}"].clock for name in "yz"] == ["y", "z"]
    assert on_tape(tape, {"u": 2.0})["output:y"] == [6.0]


def test_one_equation_fills_targets_of_several_shapes() -> None:
    class Jumps(Block):
        a = State(shape=2)
        b = State(shape=3)
        c = State()

        @a.derivative
        @b.derivative
        @c.derivative
        def still():
            return 0.0

        @crossing
        def hit(c):
            return c

        @hit.reset(a)
        @hit.reset(b)
        @hit.reset(c)
        def zero(c):
            return -c

    tape = trace(interface(Jumps))
    assert [len(tape.results[f"reset:{name}:hit"].nodes) for name in "abc"] == [2, 3, 1]


# --- sparsity --------------------------------------------------------------------------------------------------


def test_each_element_depends_on_exactly_what_it_reads() -> None:
    tape = trace(interface(law(lambda v, u, n: np.stack([v[0], v[2] * u, np.zeros(n)[0]]), shape=3)))
    assert dependencies(tape, "output:y") == [{"v[0]"}, {"v[2]", "u"}, set()]


def test_a_zero_of_a_pattern_makes_no_dependency() -> None:
    class Linear(Block):
        A = Parameter([[0.0, 1.0], [0.0, 0.0]], shape=("n", "n"), zeros=True)
        x = State(shape=lambda n: n)

        @x.derivative
        def dx(A, x):
            return A @ x

    assert dependencies(trace(interface(Linear)), "derivative:x") == [{"A[1]", "x[1]"}, set()]
    full = trace(interface(Linear, A=[[1.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0]]))
    assert dependencies(full, "derivative:x") == [{"A[0]", "A[2]", "x[0]", "x[2]"}, set(), {"A[7]", "x[1]"}]


@pytest.mark.parametrize(
    ("function", "reads"),
    [
        (lambda u, w: u + 0.0 * w, {"u"}),
        (lambda u, w: u - 0 * np.sin(w), {"u"}),
        (lambda u, w: u * (0.0 / w + 1.0), {"u"}),
        (lambda u, w: np.where(True, u, w), {"u"}),
        (lambda u, w: np.where(np.array(False), u, w), {"w"}),
        (lambda u, w: np.where(w > 0, u, u), {"u"}),
        (lambda u, w, n: np.where((w > 0) & (n > 5), w, u), {"u"}),
        (lambda u, w, n: np.where((w > 0) | (n < 5), u, w), {"u"}),
        (lambda u, w: (2.0 + 0 * w - 2.0) * w + u, {"u"}),
        (lambda u, w: u - w + w, {"u", "w"}),
        (lambda u, w: u / u * w, {"u", "w"}),
        (lambda v: np.sum(v * np.array([0.0, 1.0, 0.0])), {"v[1]"}),
        (lambda v: np.roll(v, 1)[0], {"v[2]"}),
    ],
)
def test_a_zero_and_a_settled_choice_make_no_dependency(function: Any, reads: set[str]) -> None:
    tape = trace(interface(law(function)))
    assert dependencies(tape, "output:y") == [reads]
    assert {node.op for node in tape.nodes} <= {*OPERATIONS, "argument", "constant"}


# --- meaning ---------------------------------------------------------------------------------------------------

INF, NAN = np.inf, np.nan
CHOICES = {
    "comparison": lambda u, w, k: np.where(u < w, u, k),
    "comparison turned round": lambda u, w, k: np.where(u > w, u, k),
    "negated comparison": lambda u, w, k: np.where(~(u < w), u, k),
    "twice negated": lambda u, w, k: np.where(~~(u < w), u, k),
    "bool": lambda u, p: np.where(p, u, 1.0),
    "negated bool": lambda u, p, w: np.where(~p, u, w),
    "then zero": lambda u, p: np.where(p, u, 0.0),
    "else zero": lambda u, p: np.where(p, 0.0, u),
    "zero and one": lambda p: np.where(p, 0.0, 1.0),
    "one and zero": lambda p: np.where(p, 1.0, 0.0),
    "inf not taken": lambda u, w: np.where(u < w, u, INF),
    "nan not taken": lambda u, w: np.where(u < w, NAN, u),
    "division not taken": lambda u, w: np.where(w == 0, 0.0, u / w),
    "root not taken": lambda u: np.where(u > 0, np.sqrt(u), -np.sqrt(-u)),
    "logarithm of zero": lambda u: np.where(u > 0, u * np.log(u), 0.0),
    "nested in then": lambda u, w, p: np.where(p, np.where(u < w, u, w), np.where(u < 0, 1.0, 2.0)),
    "nested in else": lambda u, w: np.where(u < -1, -1.0, np.where(u < 1, u, np.where(u < 2, w, 5.0))),
    "nested condition": lambda u, w, p: np.where(np.where(p, u < w, u > w), u, w),
    "of bools": lambda u, w, p: np.where(np.where(p, u < w, False), 1.0, 2.0),
    "sum of halves": lambda u, w, p: np.where(p, u, 0.0) + np.where(~p, w, 0.0),
    "difference of choices": lambda u, w, p: np.where(p, u, w) - np.where(~p, w, 0.0),
    "twice the same": lambda u, w, p: np.where(p, u, w) + np.where(p, u, w),
    "negative": lambda u, w, p: -np.where(p, -u, -w),
    "of a product": lambda u, w, p: 2.0 * np.where(p, u, w) * np.where(p, w, u),
    "of equal branches": lambda u, w: np.where(u < w, u, u),
    "conjunction": lambda u, w, p: np.where((u < w) & p & (u != 0), u, w),
    "disjunction": lambda u, w, p: np.where((u < w) | ~p | (u == w), u, w),
    "exclusive": lambda u, w, p: np.where((u < w) ^ p, u, w),
    "constant condition": lambda u, w: np.where(np.array([True, False]), u, w)[1],
    "same comparison": lambda u: np.where(u == u, 1.0, 2.0),
    "other comparison": lambda u: np.where(u != u, 1.0, 2.0),
}


@pytest.mark.parametrize("name", CHOICES)
def test_choices_take_one_branch_and_nothing_of_the_other(name: str) -> None:
    made = interface(law(CHOICES[name]))
    tape = trace(made)
    assert not any(node.op == "if_else_zero" for node in tape.nodes)
    for u in (-3.0, -0.5, 0.0, 0.5, 3.0, INF, NAN):
        for w in (-1.0, 0.0, 0.5, 2.0, -INF):
            for p in (False, True):
                values = {"u": u, "w": w, "p": p, "k": 2.0}
                with np.errstate(all="ignore"):
                    expected = only(numeric(made, values))
                assert only(on_tape(tape, values)) == pytest.approx(expected, nan_ok=True, rel=1e-15), values


@pytest.mark.parametrize(
    ("function", "u", "expected"),
    [
        (lambda u: np.sqrt(u) ** 2, -4.0, NAN),
        (lambda u: u / u, 0.0, NAN),
        (lambda u: u - u, INF, NAN),
        (lambda u: np.where(u == u, 1.0, 0.0), NAN, 0.0),
        (lambda u: np.log(np.exp(u)), 1000.0, INF),
        (lambda u: (u + 1e16) - 1e16, 1.0, 0.0),
        (lambda u: u * 1e308 * 10.0 / 1e309, 1.0, NAN),
        (lambda u: np.minimum(u, INF), NAN, NAN),
        (lambda u: np.maximum(u, 0.0), NAN, NAN),
        (lambda u: np.clip(u, 0.0, 1.0), NAN, NAN),
        (lambda u: np.sign(u), NAN, NAN),
        (lambda u: np.sign(u), -0.0, 0.0),
        (lambda u: np.arctan2(0.0 - u, -1.0), 0.0, math.pi),
        (lambda u: np.abs(u) ** 0.84 * np.sign(u), -2.0, -(2.0**0.84)),
        (lambda u: 0.0 * u, INF, 0.0),  # a zero makes no dependency, and so no NaN either
        (lambda u: u + 0.0, INF, INF),
        (lambda u: np.exp(-1.0 / u), 0.0, 0.0),
    ],
)
def test_operations_keep_their_meaning_where_numbers_are_not_finite(function: Any, u: float, expected: float) -> None:
    tape = trace(interface(law(function)))
    assert only(on_tape(tape, {"u": u})) == pytest.approx([expected], nan_ok=True, rel=1e-15)


def test_small_powers_are_products() -> None:
    tape = trace(interface(law(lambda u, w: u**2 + u**3 + u**-1 + u**0.5 + u**w)))
    ops = [node.op for node in tape.nodes]
    assert (ops.count("pow"), ops.count("sqrt"), ops.count("div")) == (1, 1, 1)


UNARY = [
    *("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "fabs", "sign", "floor", "ceil", "neg"),
]
BINARY = ["add", "sub", "mul", "div", "pow", "atan2", "hypot", "fmod", "copysign", "fmin", "fmax"]
COMPARISONS = ["lt", "le", "eq", "ne"]
LOGIC = ["and", "or"]


def test_every_operation_of_a_tape_comes_from_one_function_of_numpy() -> None:
    laws = {
        **{op: law((lambda f: lambda u: f(u))(operation(op))) for op in UNARY},
        **{op: law((lambda f: lambda u, w: f(u, w))(operation(op))) for op in BINARY},
        **{op: law((lambda f: lambda u, w: f(u, w))(operation(op)), type="bool") for op in COMPARISONS},
        **{op: law((lambda f: lambda u, p: f(u < 0, p))(operation(op)), type="bool") for op in LOGIC},
        "not": law(lambda p: ~p, type="bool"),
        "choose": law(lambda u, w, p: np.where(p, u, w)),
        "search": law(lambda u, points: search(points, u)),
        "pick": law(lambda u, points: pick(points, u)),
        "constant": law(lambda: 1.0),
        "argument": law(lambda u: u),
    }
    assert laws.keys() == {*OPERATIONS, "argument", "constant"} - {"min", "max"}
    for op, cls in laws.items():
        tape = trace(interface(cls))
        assert tape.nodes[tape.results["output:y"].nodes[0]].op == op


# --- tables ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "function",
    [
        lambda u, points: pick(points, search(points, u) - 1.0),
        lambda u, points: np.interp(u, points, points) + points[-1],
        lambda u, w, points: search(points, pick(points, u) + search(points, w)) * w,
        lambda v, points: np.sum(search(points, v)),
        lambda u, points: pick(points, np.where(u > 1.0, np.nan, u)),
    ],
)
def test_what_is_looked_up_is_the_same_on_numbers_and_on_the_tape(function: Any) -> None:
    made = resolve(law(function), {})
    tape, table = trace(made.interface), made.values["points"].value
    assert sum(argument.kind == "table" for argument in tape.arguments) == 1
    for u in (-1.0, 0.0, 0.5, 1.0, 2.9, 3.0, 1e9):
        values = {"u": u, "w": 1.0 - u, "v": np.array([u, 1.0, -u]), "p": True, "k": 2.0, "points": table}
        ours = numeric(made.interface, {**values, "t": 0.0, "tick": 0})["output:y"]
        theirs: list[Any] = []
        for node in tape.nodes:
            argument = tape.arguments[int(node.value)] if node.op == "argument" else None
            if argument is not None:
                given = values.get(argument.name, 0.0)
                theirs.append(table if argument.kind == "table" else np.float64(np.ravel(given)[argument.element]))
            elif node.op == "constant":
                theirs.append(np.float64(node.value))
            elif node.op in ("search", "pick"):
                x, points = (theirs[n] for n in node.operands)
                theirs.append(search(points, x) if node.op == "search" else pick(points, x))
            else:
                theirs.append(np.float64(operation(node.op)(*(theirs[n] for n in node.operands))))
        np.testing.assert_array_equal([theirs[n] for n in tape.results["output:y"].nodes], np.ravel(ours))


def test_equal_lookups_are_one_and_depend_on_what_is_looked_for() -> None:
    tape = trace(interface(law(lambda u, points: search(points, u) + 2.0 * search(points, u))))
    assert [node.op for node in tape.nodes].count("search") == 1
    assert dependencies(tape, "output:y") == [{"u", "points"}]


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (lambda points: np.sum(points), "np.sum cannot take a table. Read it with pick, search or np.interp."),
        (lambda points, u: points * u, "np.multiply cannot take a table."),
        (lambda points: points, "a table is not an array of numbers."),
        (lambda points, u: points[u], "this is not a way to read a table. Use pick(table, index)"),
        (lambda points: points[3], "index 3 of a table of 3"),
        (lambda points, u: search(points, u > 0), "a bool cannot be an index of a table."),
        (lambda points, u: np.interp(u, points, [1.0, 2.0, 3.0]), "both tables or both arrays"),
    ],
)
def test_a_table_is_only_looked_up_in(function: Any, text: str) -> None:
    assert text in refusal(law(function))


# --- what is refused -------------------------------------------------------------------------------------------


def test_a_refusal_names_the_block_the_equation_the_cause_and_the_cure() -> None:
    text = refusal(law(lambda u: 1.0 if u > 0 else 0.0))
    assert text.startswith(f"E407 {__file__}:")
    assert " Law.y: cannot be traced: a symbol is neither true nor false" in text
    assert "Use np.where" in text


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (lambda v: np.linalg.inv(v[:, None] * v), "np.linalg.inv cannot be traced. Write it with"),
        (lambda v: np.sort(v)[0], "np.sort cannot be traced"),
        (lambda u: math.sin(u), "Use np.sin"),
        (lambda u: min(u, 1.0), "np.minimum"),
        (lambda u: [0.0] * int(u), "np.floor"),
        (lambda u: np.add.accumulate([u, u])[u], "not"),
        (lambda v, u: v[u], "np.interp"),
        (lambda v: v[v > 0], "np.where"),
        (lambda u: None, "return"),
        (lambda u: "text", "not a number"),
        (lambda u: u * 1j, "not a real number"),
        (lambda u: {"y": u}, "not a real number"),
        (lambda u: 1.0 / 0, "ZeroDivisionError: "),
        (lambda u: [][0], "IndexError: list index out of range"),
        (lambda u: {}["gain"], "KeyError: 'gain'"),
        (lambda u: u.magnitude, "a symbol has no attribute 'magnitude'"),
        (lambda v: v, "returns the shape (3,), but 'y' has the shape ()"),
        (lambda u: [u], "returns the shape (1,), but 'y' has the shape ()"),
        (lambda u: [[u, 1.0], [2.0]], "cannot be traced"),
    ],
)
def test_what_cannot_be_traced_is_refused(function: Any, text: str) -> None:
    assert text in refusal(law(function))


def test_item_assignment_is_refused_with_its_cure() -> None:
    def f(u):
        z = np.zeros(3)
        z[0] = u
        return z

    text = refusal(law(f, shape=3))
    assert "Law.y" in text
    assert "np.stack instead of item assignment" in text


@pytest.mark.parametrize(
    ("function", "options", "text"),
    [
        (lambda v: v[:2], {"shape": 3}, "returns the shape (2,), but 'y' has the shape (3,)"),
        (lambda v: v, {"shape": (3, 1)}, "returns the shape (3,), but 'y' has the shape (3, 1)"),
        (lambda u: u, {"type": "bool"}, "'y' is a bool, but the equation returns a number"),
        (lambda u: 1.0, {"type": "bool"}, "'y' is a bool, but the equation returns a number"),
        (lambda u, w: (u > 0) * 1.0, {"type": "bool"}, "'y' is a bool"),
    ],
)
def test_shapes_and_types_must_be_those_of_the_variable(function: Any, options: Any, text: str) -> None:
    assert text in refusal(law(function, **options))


def test_a_scalar_fills_an_array_and_a_list_is_an_array() -> None:
    filled = trace(interface(law(lambda u: 2.0 * u, shape=(2, 2))))
    assert only(on_tape(filled, {"u": 3.0})) == [6.0] * 4
    listed = trace(interface(law(lambda u, v: [u, v[0], 1], shape=3)))
    assert only(on_tape(listed, {"u": 3.0, "v": [4.0, 5.0, 6.0]})) == [3.0, 4.0, 1.0]
    true = trace(interface(law(lambda: True, type="bool")))
    assert only(on_tape(true, {})) == [1.0]


def test_sides_and_event_times_are_numbers() -> None:
    class Side(Block):
        u = Input()

        @crossing
        def c(u):
            return u > 0

    class Edge(Block):
        @event_time
        def e(t):
            return t < 1.0

    assert "Return a difference" in refusal(Side)
    assert "Edge.e: cannot be traced: an event time is a time" in refusal(Edge)


def test_an_exception_of_an_equation_stays_the_cause() -> None:
    def f(u):
        raise LookupError("no such table")

    with pytest.raises(DeclarationError, match=r"Law\.y: cannot be traced: LookupError: no such table") as caught:
        trace(interface(law(f)))
    assert isinstance(caught.value.__cause__, LookupError)


def test_a_fault_in_a_local_names_the_local() -> None:
    class Local(Block):
        u = Input()

        @output
        def y(g):
            return g

        @local
        def g(u):
            return float(u)

    with pytest.raises(DeclarationError, match=r"E407 .* Local\.g: "):
        trace(interface(Local))


# --- the witness on numbers ------------------------------------------------------------------------------------


def test_the_witness_hands_out_numbers_of_numpy_that_cannot_be_changed() -> None:
    def f(v):
        v += 1.0
        return v

    with pytest.raises(DeclarationError, match="read-only"):
        numeric(interface(law(f, shape=3)), {"v": [1.0, 2.0, 3.0]})
    with np.errstate(all="ignore"):
        assert only(numeric(interface(law(lambda u: 1 / u)), {"u": 0})) == [math.inf]
    assert only(numeric(interface(law(lambda p: ~p, type="bool")), {"p": 1.0})) == [0.0]


def test_wiring_is_no_result() -> None:
    class Mux(Block):
        u = Input(shape=2, ports="u{}")

        @wiring(shape=2)
        def y(u):
            return u

    made = interface(Mux)
    assert trace(made).results == numeric(made, {"u": [1.0, 2.0]}) == {}


# --- sameness --------------------------------------------------------------------------------------------------


def test_tapes_are_the_same_in_every_process() -> None:
    program = textwrap.dedent(
        """
        from tests.contract.test_tape import Everything, interface
        from blocks.contract.tracing import trace
        tape = trace(interface(Everything))
        print(repr((tape.arguments, tape.nodes, list(tape.results.items()))))
        """
    )
    root = ROOT
    texts = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(root)},
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(texts) == 1


@pytest.fixture
def _hasty_threads() -> Iterator[None]:
    """Threads take turns so often that they meet everywhere."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("_hasty_threads")
@pytest.mark.parametrize("_", range(5))
def test_threads_may_trace_the_same_and_different_types(_: int) -> None:
    def body(k: int) -> Any:
        return law(lambda u, w, v, n: np.tanh(u * (k + 1.0)) + np.sum(v) ** (n + 1) + np.where(u < w, k + 0.5, u))

    classes = [body(k) for k in range(6)]
    bad = law(lambda u: float(u))
    made: list[list[Any]] = [[] for _ in range(8)]
    start = threading.Barrier(8)

    def work(index: int) -> None:
        start.wait()
        for n in (1, 2, 3):
            for cls in classes:
                made[index].append(trace(interface(cls, n=n)))
            with pytest.raises(DeclarationError):
                trace(interface(bad, n=n))

    threads = [threading.Thread(target=work, args=(index,)) for index in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [len(tapes) for tapes in made] == [18] * 8
    for tapes in made[1:]:
        assert all(a is b for a, b in zip(tapes, made[0], strict=True))
    values = {"u": 0.3, "w": 0.5, "v": [1.0, 2.0, 3.0]}
    for cls, tape in zip(classes, made[0][12:], strict=True):
        assert only(on_tape(tape, values)) == pytest.approx(only(numeric(interface(cls), values)), rel=1e-14)


def test_an_equation_that_cannot_be_traced_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "blocks_of_a_file.py"
    path.write_text(
        textwrap.dedent("""\
        from blocks import Block, Input, output

        class Rectifier(Block):
            u = Input()

            @output
            def y(u):
                v = 2 * u
                return v if v > 0 else 0

        class Twice(Block):
            u = Input()

            @output
            def y(u):
                return [u, u]
        """)
    )
    made: dict[str, Any] = {}
    exec(compile(path.read_text(), str(path), "exec"), made)
    for name, line, word in (("Rectifier", 9, "v > 0"), ("Twice", 14, "@output")):
        with pytest.raises(DeclarationError) as caught:
            trace(interface(made[name]))
        fault = caught.value.faults[0]
        assert (fault.code, fault.file, fault.line) == ("E407", str(path), line)
        if name == "Rectifier":
            assert path.read_text().splitlines()[line - 1][fault.column - 1 :].startswith(word)
